"""`[[repairs]]` of a shot file: made on one frame, held on the others, noted in the receipt, redone only where asked."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereorelight.errors import PassError, PlateError, ShotError
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Flag, Frame
from stereorelight.shot.run import run_shot
from stereorelight.synth.rigs import parallel_rig

SIZE = (128, 80)
SHOT = """
[plates]
left = "left.####.png"
right = "right.####.png"
[depth]
quality = "draft"
near_m = 0.8
far_m = 5.0
[output]
previews = false
"""


def wall(rng: np.random.Generator, shape: tuple[int, int], level: float = 90.0) -> np.ndarray:
    """Soft blotches about a level, 8 bit."""
    blotches = cv2.GaussianBlur(rng.standard_normal((*shape, 3)).astype(np.float32), (0, 0), 1.5)
    return np.rint(np.clip(level + 25 * blotches / blotches.std(), 0, 255)).astype(np.uint8)


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    """A wall at 3 px, and a card at 7 px that moves right by 3 px a frame; five frames from 11."""
    rng = np.random.default_rng(4)
    back, card = wall(rng, (80, 240)), wall(rng, (40, 40), 160.0)
    write_rig(tmp_path / "rig.json", parallel_rig(SIZE))
    for n in range(5):
        for eye, wall_at, card_at in (("left", 40, 40 + 3 * n), ("right", 43, 33 + 3 * n)):
            picture = back[:, wall_at : wall_at + SIZE[0]].copy()
            picture[20:60, card_at : card_at + 40] = card
            write_still(tmp_path / f"{eye}.{11 + n:04d}.png", picture)
    matte = np.zeros(SIZE[::-1], np.uint8)
    matte[20:60, 40:80] = 255
    write_still(tmp_path / "card.png", np.repeat(matte[..., None], 3, axis=2))
    (tmp_path / "shot.toml").write_text(SHOT)
    return tmp_path / "shot.toml"


def repaired_by(shot: Path, table: str, **options: object) -> dict[int, Frame]:
    shot.write_text(SHOT + table)
    run_shot(shot, **options)
    return {n: read_frame(found[0]) for n in range(11, 16) if (found := list(shot.parent.glob(f"out/depth/*.{n:04d}.exr")))}


def held(frame: Frame) -> np.ndarray:
    return (frame["flags"] & Flag.REPAIRED) != 0


def card_of(n: int) -> np.ndarray:
    truth = np.zeros(SIZE[::-1], bool)
    truth[20:60, 40 + 3 * (n - 11) : 80 + 3 * (n - 11)] = True
    return truth


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


CARD = '[[repairs]]\nname = "card"\nkind = "constant"\nmatte = "card.png"\ndistance_m = 1.5\n'


def test_a_fix_painted_on_one_frame_goes_with_the_card(shot) -> None:
    frames = repaired_by(shot, CARD + "frame = 11\n")
    for n, frame in frames.items():
        assert overlap(held(frame), card_of(n)) > 0.93, n
        assert (frame["Z"][held(frame)] == np.float32(1.5)).all()
    assert overlap(card_of(11), card_of(15)) < 0.6, "or it would prove nothing"
    receipt = json.loads(next(shot.parent.glob("out/receipts/*.0013.json")).read_text())
    assert receipt["steps"]["depth"]["figures"]["repairs"][0]["name"] == "card"


def test_it_goes_back_in_time_too_and_any_part_of_the_shot_gives_the_same(shot) -> None:
    whole = repaired_by(shot, CARD.replace("card.png", "late.png") + "frame = 15\n") if write_late(shot) else {}
    assert overlap(held(whole[11]), card_of(11)) > 0.9
    again = repaired_by(shot, CARD.replace("card.png", "late.png") + "frame = 15\n", frames="12", force=True)
    np.testing.assert_array_equal(again[12]["Z"], whole[12]["Z"])


def write_late(shot: Path) -> bool:
    write_still(shot.parent / "late.png", np.repeat(card_of(15)[..., None].astype(np.uint8) * 255, 3, axis=2))
    return True


def test_a_fix_without_a_frame_stays_where_it_is(shot) -> None:
    for frame in repaired_by(shot, CARD).values():
        np.testing.assert_array_equal(held(frame), card_of(11))


def test_frames_limit_a_fix(shot) -> None:
    frames = repaired_by(shot, CARD + 'frames = "12-13"\n')
    assert [n for n, frame in frames.items() if held(frame).any()] == [12, 13]


def test_a_matte_sequence_says_itself_where_it_is(shot) -> None:
    for n in range(11, 16):
        write_still(shot.parent / f"m.{n:04d}.png", np.repeat(card_of(n)[..., None].astype(np.uint8) * 255, 3, axis=2))
    for n, frame in repaired_by(shot, CARD.replace("card.png", "m.####.png")).items():
        np.testing.assert_array_equal(held(frame), card_of(n))


def test_pins_keep_what_they_add_as_the_card_moves(shot) -> None:
    plain = repaired_by(shot, "", frames="11-15")
    table = '[[repairs]]\nname = "tape"\nkind = "pins"\nmatte = "card.png"\npins = [[60, 40, 1.2]]\nframe = 11\n'
    pinned = repaired_by(shot, table)
    before, after = 1 / float(plain[11]["Z"][40, 60]), 1 / float(pinned[11]["Z"][40, 60])
    assert after == pytest.approx(1 / 1.2, rel=0.01)
    shift = 1 / float(pinned[15]["Z"][40, 72]) - 1 / float(plain[15]["Z"][40, 72])
    assert shift == pytest.approx(after - before, rel=0.05)


def test_the_clean_plate_fills_what_the_card_hides(shot) -> None:
    clean = Frame(passes={"Z": np.full(SIZE[::-1], 3.75, np.float32)})
    write_frame(shot.parent / "clean.exr", clean)
    frames = repaired_by(shot, '[[repairs]]\nname = "set"\nkind = "clean_plate"\ndepth = "clean.exr"\n', frames="11")
    taken = held(frames[11])
    assert (frames[11]["Z"][taken] == 3.75).all()
    assert taken[:, 30:38].mean() > 0.5, "the strip that the card hides from the right eye"
    assert not taken[30:50, 50:75].any()


def test_a_polygon_is_a_matte_and_only_depth_and_after_are_done_again(shot) -> None:
    repaired_by(shot, CARD)
    table = CARD.replace('matte = "card.png"', "polygon = [[50, 30], [69, 30], [69, 49], [50, 49]]")
    frames = repaired_by(shot, table)
    assert held(frames[11]).sum() == 20 * 20
    shot.write_text(SHOT + table)
    assert run_shot(shot).done == 0
    (shot.parent / "card.png").unlink()
    assert run_shot(shot).done == 0, "a matte that no repair names any more"


@pytest.mark.parametrize(
    ("table", "error", "words"),
    [
        (CARD.replace("card.png", "crad.png"), PlateError, "crad.png: file missing; repair 'card'"),
        (CARD + "frame = 99\n", ShotError, "frame 99 is not in the shot, which has 0011-0015"),
        (CARD + CARD, ShotError, "two repairs share this name"),
        (CARD.replace("distance_m = 1.5", ""), ShotError, "needs distance_m"),
        (CARD.replace("constant", "constnat"), ShotError, "did you mean 'constant'"),
        (CARD.replace('matte = "card.png"', "polygon = [[1, 1], [2, 2]]"), ShotError, "three corners or more"),
        (CARD.replace('"card.png"', '"small.png"'), PlateError, "small.png: matte of repair 'card' is 8x8 pixels, the plate 128x80"),
        (CARD.replace('"card.png"', '"black.png"'), PassError, "frame 0011: repair card: its matte is empty"),
    ],
)
def test_what_cannot_be_is_said(shot, table, error, words) -> None:
    write_still(shot.parent / "small.png", np.full((8, 8, 3), 255, np.uint8))
    write_still(shot.parent / "black.png", np.zeros((80, 128, 3), np.uint8))
    with pytest.raises(error, match=words):
        repaired_by(shot, table)


def test_a_cut_ends_what_can_be_carried(shot) -> None:
    rng = np.random.default_rng(9)
    for eye in ("left", "right"):
        write_still(shot.parent / f"{eye}.0013.png", wall(rng, (80, 128)), force=True)
    with pytest.raises(ShotError, match=r"cannot be carried to frame 0013: .* end its `frames` at the cut"):
        repaired_by(shot, CARD + "frame = 11\n")
    assert len(list(shot.parent.glob("out/depth/*.exr"))) == 2, "what came before the cut stays"
