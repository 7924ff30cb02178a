"""Mattes that help the matcher: a card before a wall of its own colour, a reflection that is nowhere, and what a bad matte is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stereorelight.cli import main
from stereorelight.errors import PlateError
from stereorelight.footage.frames import read_frame
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Flag
from stereorelight.stereo.depth import recover
from stereorelight.stereo.hints import Hints, on_matte_edge
from stereorelight.stereo.rectify import rectification
from stereorelight.synth.rigs import parallel_rig

cv2 = pytest.importorskip("cv2")
WIDTH, HEIGHT = 320, 200
NEAR_PX, FAR_PX = 30, 14
CARD = (slice(50, 150), slice(130, 230))


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Both plates, disparity and the card's matte.  Card and wall have the same texture, which fades out about the card's sides."""
    rng = np.random.default_rng(3)
    wide = cv2.GaussianBlur(rng.random((HEIGHT, WIDTH + 200)).astype(np.float32), (0, 0), 1.0) - 0.5
    wall, card = 0.4 + 0.6 * wide[:, :WIDTH], 0.4 + 0.6 * wide[:, 150 : 150 + WIDTH]
    x = np.arange(WIDTH)
    for picture, plain in ((wall, (np.abs(x - 130) < 16) | (np.abs(x - 230) < 16)), (card, (np.abs(x - 130) < 12) | (np.abs(x - 230) < 12))):
        picture[:, plain] = 0.4
    wall_right = np.full((HEIGHT, WIDTH), 0.4, np.float32)
    wall_right[:, : WIDTH - FAR_PX] = wall[:, FAR_PX:]
    left, right, truth = wall.copy(), wall_right.copy(), np.full((HEIGHT, WIDTH), FAR_PX, np.float32)
    matte = np.zeros((HEIGHT, WIDTH), np.float32)
    matte[CARD] = 1
    left[CARD], truth[CARD] = card[CARD], NEAR_PX
    rows, columns = CARD
    right[rows, columns.start - NEAR_PX : columns.stop - NEAR_PX] = card[CARD]
    grain = 0.003 * rng.standard_normal((2, HEIGHT, WIDTH)).astype(np.float32)
    eyes = (np.repeat((p + g)[..., None], 3, axis=2) for p, g in zip((left, right), grain, strict=True))
    return (*eyes, truth, matte)  # type: ignore[return-value]


@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_depth_steps_on_the_mattes_edge(quality: str) -> None:
    from stereorelight.stereo.settings import DepthSettings

    left, right, truth, matte = scene()
    rectified = rectification(parallel_rig((WIDTH, HEIGHT)))
    settings = DepthSettings(quality=quality)
    edge = np.zeros((HEIGHT, WIDTH), np.bool_)
    edge[60:140, 118:142] = edge[60:140, 218:242] = True  # both sides of the card, where neither has texture

    def wrong(hints: Hints | None) -> float:
        found = recover(left, right, rectified, settings=settings, hints=hints).rectified["disparity"]
        return float(np.mean(np.abs(found - truth)[edge] > 2))

    without, told = wrong(None), wrong(Hints(subject=matte))
    assert without > 0.2  # nothing but the matte can tell
    assert told < (0.1 if quality == "draft" else 0.05)


def test_what_is_ignored_goes_on_as_what_lies_beside_it() -> None:
    left, right, _, _ = scene()
    spot = (slice(60, 84), slice(20, 60))  # a highlight on the wall that the eyes see twice as near
    pattern = np.random.default_rng(8).random((24, 40, 1)).astype(np.float32)
    left[spot] = pattern
    right[60:84, 20 - 18 : 60 - 18] = pattern[:, :]
    rectified = rectification(parallel_rig((WIDTH, HEIGHT)))
    matte = np.zeros((HEIGHT, WIDTH), np.float32)
    matte[spot] = 1
    without, told = recover(left, right, rectified), recover(left, right, rectified, hints=Hints(ignore=matte))
    inside = (slice(62, 82), slice(24, 56))
    assert np.median(np.abs(without.rectified["disparity"] - 18)[inside]) < 0.5  # matched as it seems
    assert np.abs(told.rectified["disparity"] - FAR_PX)[inside].max() < 1
    assert ((told.rectified["flags"][inside] & Flag.FILLED) != 0).all()
    assert told.rectified["confidence"][inside].mean() < without.rectified["confidence"][inside].mean() - 0.1  # a guess, though a right one here
    away = np.ones((HEIGHT, WIDTH), np.bool_)
    away[40:104, :90] = False
    assert np.median(np.abs(told.rectified["disparity"] - without.rectified["disparity"])[away]) < 0.01


def test_a_matte_without_a_step_moves_nothing() -> None:
    flat = np.tile(np.linspace(10, 14, WIDTH, dtype=np.float32), (HEIGHT, 1))
    _, _, _, matte = scene()
    moved, changed = on_matte_edge(flat, np.ones(flat.shape, np.bool_), matte > 0.5)
    assert not changed.any()
    np.testing.assert_array_equal(moved, flat)


def test_the_right_eye_has_mattes_of_its_own() -> None:
    left, right, _, matte = scene()
    rectified = rectification(parallel_rig((WIDTH, HEIGHT)))
    of_right = np.zeros_like(matte)
    of_right[50:150, 130 - NEAR_PX : 230 - NEAR_PX] = 1
    edge = np.zeros((HEIGHT, WIDTH), np.bool_)
    edge[60:140, 118 - NEAR_PX : 142 - NEAR_PX] = edge[60:140, 218 - NEAR_PX : 242 - NEAR_PX] = True
    truth = np.where(of_right > 0, NEAR_PX, FAR_PX)
    error = [
        np.mean(np.abs(recover(left, right, rectified, eye="right", hints=hints).rectified["disparity"] - truth)[edge] > 2)
        for hints in (None, Hints(subject=of_right))
    ]
    assert error[1] < 0.05 < error[0]


@pytest.mark.parametrize(("matte", "words"), [(np.ones((10, 10), np.float32), "10x10"), (np.full((HEIGHT, WIDTH), np.nan, np.float32), "not finite")])
def test_a_bad_matte_is_told(matte: np.ndarray, words: str) -> None:
    left, right, _, _ = scene()
    with pytest.raises(PlateError, match=words):
        recover(left, right, rectification(parallel_rig((WIDTH, HEIGHT))), hints=Hints(ignore=matte))


def _filed(folder: Path) -> Path:
    left, right, _, matte = scene()
    for name, picture in (("left", left), ("right", right)):
        write_still(folder / f"{name}.png", np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8))
    write_still(folder / "card.png", np.repeat((255 * matte).astype(np.uint8)[..., None], 3, axis=2))
    write_rig(folder / "rig.json", parallel_rig((WIDTH, HEIGHT)))
    shot = folder / "shot.toml"
    shot.write_text(
        'version = 1\n[plates]\nleft = "left.png"\nright = "right.png"\n[rig]\nfile = "rig.json"\n[depth]\nsubject = "card.png"\n'
        '[[lights]]\nname = "key"\ntype = "point"\nposition_m = [0, 0, 0]\n'
    )
    return shot


def test_a_shot_names_its_mattes_and_runs_again_when_one_changes(tmp_path: Path) -> None:
    shot = _filed(tmp_path)
    run = CliRunner().invoke(main, ["run", str(shot)])
    assert run.exit_code == 0, run.output
    depth = next((tmp_path / "out" / "depth").glob("*.exr"))
    first = read_frame(depth)["Z"].copy()
    write_still(tmp_path / "card.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8), force=True)
    again = CliRunner().invoke(main, ["run", str(shot)])
    assert again.exit_code == 0, again.output
    assert (read_frame(depth)["Z"] != first).mean() > 0.005
    (tmp_path / "card.png").unlink()
    gone = CliRunner().invoke(main, ["run", str(shot)])
    assert gone.exit_code == 1
    assert "card.png" in gone.output
    assert "depth.subject" in gone.output


def test_the_command_takes_mattes_of_the_left_plate(tmp_path: Path) -> None:
    _filed(tmp_path)
    arguments = ["depth", *(str(tmp_path / n) for n in ("left.png", "right.png")), "--rig", str(tmp_path / "rig.json")]
    told = CliRunner().invoke(main, [*arguments, "--out", str(tmp_path / "z.exr"), "--subject", str(tmp_path / "card.png")])
    assert told.exit_code == 0, told.output
    refused = CliRunner().invoke(main, [*arguments, "--out", str(tmp_path / "r.exr"), "--eye", "right", "--ignore", str(tmp_path / "card.png")])
    assert refused.exit_code == 1
    assert "left plate" in refused.output
