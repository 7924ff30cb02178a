"""Both eyes of a shot: the same plates however they are stored, the right moments together, and what differs told in words."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.colour import encode
from stereorelight.footage.exr import write_exr
from stereorelight.footage.eyes import Eyes, open_eyes
from stereorelight.footage.stills import write_still
from tests.stereo_files import above, beside, exr, movie, picture, pictures, rgb_movie

COUNT = 4
FFV1 = 1.5 / 3504
SIXTEEN_BIT = 2**-15
PRORES = 0.03  # 4:2:2 at the border of a small picture; the mean is a twentieth of it


def check(eyes: Eyes, *, within: float, first: int = 1, eye_of: tuple[str, str] = ("left", "right")) -> None:
    """Every frame of both eyes is the picture that was put in."""
    assert eyes.frames == tuple(range(first, first + COUNT))
    for k, number in enumerate(eyes.frames):
        np.testing.assert_allclose(encode(eyes.left.read(number), "sRGB"), picture(eye_of[0], k), atol=within)
        np.testing.assert_allclose(encode(eyes.right.read(eyes.right_frame(number)), "sRGB"), picture(eye_of[1], k), atol=within)


def sequence(folder: Path, name: str, frames: list[np.ndarray], first: int = 1001) -> str:
    for number, frame in enumerate(frames, start=first):
        write_still(folder / f"{name}.{number}.png", frame, bits=16)
    return str(folder / f"{name}.####.png")


def two_movies(d: Path) -> tuple[Eyes, float]:
    return open_eyes(movie(d / "l.mkv", pictures("left", COUNT)), movie(d / "r.mkv", pictures("right", COUNT))), FFV1


def two_prores(d: Path) -> tuple[Eyes, float]:
    left, right = (movie(d / f"{eye}.mov", pictures(eye, COUNT), codec="prores") for eye in ("left", "right"))
    return open_eyes(left, right), PRORES


def view_movies(d: Path) -> tuple[Eyes, float]:
    for eye in ("left", "right"):
        movie(d / f"a_{eye}.mkv", pictures(eye, COUNT))
    return open_eyes(d / "a_%V.mkv"), FFV1


def packed_beside(d: Path) -> tuple[Eyes, float]:
    return open_eyes(movie(d / "a.mkv", beside(pictures("left", COUNT), pictures("right", COUNT))), layout="side-by-side"), FFV1


def packed_above(d: Path) -> tuple[Eyes, float]:
    path = movie(d / "a.mkv", above(pictures("left", COUNT), pictures("right", COUNT)))
    return open_eyes(path, path, layout="top-bottom"), FFV1


def two_tracks(d: Path) -> tuple[Eyes, float]:
    path = rgb_movie(d / "a.mkv", [pictures("left", COUNT), pictures("right", COUNT)])
    return open_eyes(path, colour_space="sRGB"), SIXTEEN_BIT


def tagged_beside(d: Path) -> tuple[Eyes, float]:
    path = rgb_movie(d / "a.mkv", [beside(pictures("left", COUNT), pictures("right", COUNT))], words={"stereo_mode": "left_right"})
    return open_eyes(path, colour_space="sRGB"), SIXTEEN_BIT


def tagged_right_first(d: Path) -> tuple[Eyes, float]:
    path = rgb_movie(d / "a.mkv", [beside(pictures("right", COUNT), pictures("left", COUNT))], words={"stereo_mode": "right_left"})
    return open_eyes(path, colour_space="sRGB"), SIXTEEN_BIT


def tagged_right_above(d: Path) -> tuple[Eyes, float]:
    path = rgb_movie(d / "a.mkv", [above(pictures("right", COUNT), pictures("left", COUNT))], words={"stereo_mode": "bottom_top"})
    return open_eyes(path, colour_space="sRGB"), SIXTEEN_BIT


STORED: list[Callable[[Path], tuple[Eyes, float]]] = [
    two_movies,
    two_prores,
    view_movies,
    packed_beside,
    packed_above,
    two_tracks,
    tagged_beside,
    tagged_right_first,
    tagged_right_above,
]


@pytest.mark.parametrize("stored", STORED, ids=lambda stored: stored.__name__)
def test_every_movie_gives_the_same_plates(tmp_path: Path, stored: Callable[[Path], tuple[Eyes, float]]) -> None:
    eyes, within = stored(tmp_path)
    check(eyes, within=within)
    assert (eyes.left.rate, eyes.shift) == (24, 0)
    assert len({eyes.left.digest(1), eyes.right.digest(1), eyes.left.digest(2)}) == 3


@pytest.mark.parametrize("pattern", ["a_%V.####.png", "a_%v.####.png", "two"])
def test_sequences_give_the_same_plates(tmp_path: Path, pattern: str) -> None:
    for eye in ("left", "right"):
        for name in (eye, eye[0]):
            sequence(tmp_path, f"a_{name}", pictures(eye, COUNT))
    eyes = open_eyes(tmp_path / "a_left.%04d.png", tmp_path / "a_right.%04d.png") if pattern == "two" else open_eyes(tmp_path / pattern)
    check(eyes, within=2 / 65535, first=1001)


def test_a_packed_sequence_and_multi_view_exrs(tmp_path: Path) -> None:
    left, right = pictures("left", COUNT), pictures("right", COUNT)
    check(open_eyes(sequence(tmp_path, "p", beside(left, right)), layout="side-by-side"), within=2 / 65535, first=1001)
    for k, (a, b) in enumerate(zip(left, right)):
        exr(tmp_path / f"v.{1001 + k}.exr", {"left": a, "right": b})
    eyes = open_eyes(tmp_path / "v.####.exr", colour_space="sRGB")
    check(eyes, within=1e-5, first=1001)
    single = open_eyes(tmp_path / "v.1001.exr")
    np.testing.assert_array_equal(single.right.read(), right[0])
    assert single.frames == ()


def test_notes_say_how_the_eyes_were_found(tmp_path: Path) -> None:
    two, tagged = (tmp_path / name for name in "ab")
    two.mkdir(), tagged.mkdir()
    assert "left eye in track 0 and the right eye in track 1" in two_tracks(two)[0].notes[0]
    assert "side-by-side, right eye first" in tagged_right_first(tagged)[0].notes[0]


def test_eyes_are_exchanged_on_demand(tmp_path: Path) -> None:
    left, right = movie(tmp_path / "l.mkv", pictures("left", COUNT)), movie(tmp_path / "r.mkv", pictures("right", COUNT))
    eyes = open_eyes(left, right, swap=True)
    check(eyes, within=FFV1, eye_of=("right", "left"))
    assert eyes.notes == ("the eyes are exchanged, as told",)
    packed = movie(tmp_path / "p.mkv", beside(pictures("left", COUNT), pictures("right", COUNT)))
    check(open_eyes(packed, layout="side-by-side", swap=True), within=FFV1, eye_of=("right", "left"))


def test_each_eye_has_its_space(tmp_path: Path) -> None:
    path = movie(tmp_path / "l.mkv", pictures("left", COUNT))
    shutil.copy(path, tmp_path / "r.mkv")
    eyes = open_eyes(path, tmp_path / "r.mkv", colour_space="sRGB", right_colour_space="rec709")
    a, b = eyes.left.read(1), eyes.right.read(1)
    np.testing.assert_allclose(encode(a, "sRGB"), encode(b, "rec709"), atol=1e-5)
    swapped = open_eyes(path, tmp_path / "r.mkv", colour_space="sRGB", right_colour_space="rec709", swap=True)
    assert (swapped.left.colour_space, swapped.right.colour_space) == ("rec709", "sRGB")


# Time


def coded(
    d: Path, starts: tuple[str | None, str | None], *, firsts: tuple[int, int] = (0, 0), counts: tuple[int, int] = (6, 6), **how: object
) -> Eyes:
    """Two movies; their pictures are numbered by the moment that they show."""
    settings = {key: how.pop(key) for key in ("rate",) if key in how}
    paths = [
        movie(d / f"{eye}.mov", pictures(eye, count, first=first), codec="prores", timecode=start, **settings)  # type: ignore[arg-type]
        for eye, start, first, count in zip(("left", "right"), starts, firsts, counts)
    ]
    return open_eyes(*paths, **how)  # type: ignore[arg-type]


def moments(eyes: Eyes) -> list[tuple[int, int]]:
    """Which moment each eye shows, frame by frame."""

    def moment(plate: np.ndarray, eye: str) -> int:
        return int(np.argmin([np.abs(encode(plate, "sRGB") - picture(eye, k)).mean() for k in range(12)]))

    return [(moment(eyes.left.read(n), "left"), moment(eyes.right.read(eyes.right_frame(n)), "right")) for n in eyes.frames]


@pytest.mark.parametrize("sync", ["auto", "timecode"])
def test_a_right_eye_that_starts_two_frames_later(tmp_path: Path, sync: str) -> None:
    eyes = coded(tmp_path, ("01:00:00:00", "01:00:00:02"), firsts=(0, 2), sync=sync)
    assert (eyes.shift, eyes.frames) == (-2, (3, 4, 5, 6))
    assert moments(eyes) == [(2, 2), (3, 3), (4, 4), (5, 5)]
    assert eyes.notes == ("paired by time code: the right movie starts 2 frames later",)
    assert eyes.left.timecode(3) == eyes.right.timecode(eyes.right_frame(3)) == "01:00:00:02"


def test_a_right_eye_that_starts_earlier_counted_from_another_number(tmp_path: Path) -> None:
    eyes = coded(tmp_path, ("01:00:00:01", "01:00:00:00"), firsts=(1, 0), first_frame=1001)
    assert (eyes.shift, eyes.frames[0]) == (1, 1001)
    assert all(a == b for a, b in moments(eyes))
    assert eyes.notes == ("paired by time code: the right movie starts 1 frame earlier",)


def test_time_code_over_midnight(tmp_path: Path) -> None:
    eyes = coded(tmp_path, ("23:59:59:22", "00:00:00:00"), firsts=(0, 2))
    assert eyes.shift == -2
    assert all(a == b for a, b in moments(eyes))


def test_the_same_time_code_needs_no_words(tmp_path: Path) -> None:
    eyes = coded(tmp_path, ("01:00:00:00", "01:00:00:00"))
    assert (eyes.shift, eyes.notes, len(eyes.frames)) == (0, (), 6)


def test_time_codes_that_do_not_overlap(tmp_path: Path) -> None:
    eyes = coded(tmp_path, ("01:00:00:00", "05:00:00:00"))
    assert (eyes.shift, eyes.frames) == (0, (1, 2, 3, 4, 5, 6))
    assert "01:00:00:00 and 05:00:00:00 do not overlap: the eyes are paired from their first frames" in eyes.notes[0]
    with pytest.raises(PlateError, match=r"right\.mov: time code runs from 05:00:00:00, the left eye's from 01:00:00:00.*sync = \"frames\""):
        open_eyes(tmp_path / "left.mov", tmp_path / "right.mov", sync="timecode")


def test_time_codes_that_touch_a_long_movie_only(tmp_path: Path) -> None:
    """The right movie is long, but it starts after the left one has ended."""
    eyes = coded(tmp_path, ("01:00:00:00", "01:00:00:05"), counts=(4, 8), frames="1-4")
    assert eyes.shift == 0
    assert "do not overlap" in eyes.notes[0]


def test_frames_on_demand_whatever_time_code_says(tmp_path: Path) -> None:
    eyes = coded(tmp_path, ("01:00:00:00", "01:00:00:02"), sync="frames")
    assert (eyes.shift, eyes.notes, eyes.frames) == (0, (), (1, 2, 3, 4, 5, 6))


def test_time_code_that_is_not_there(tmp_path: Path) -> None:
    eyes = coded(tmp_path, ("01:00:00:00", None))
    assert (eyes.shift, eyes.notes) == (0, ())
    with pytest.raises(PlateError, match=r"right\.mov: carries no time code; use sync = \"frames\""):
        open_eyes(tmp_path / "left.mov", tmp_path / "right.mov", sync="timecode")
    with pytest.raises(PlateError, match=r"right\.mov: carries no time code"):
        open_eyes(tmp_path / "right.mov", tmp_path / "left.mov", sync="timecode")


def test_exr_sequences_pair_by_time_code_where_asked(tmp_path: Path) -> None:
    for eye, start in (("left", 0), ("right", 2)):
        for k in range(5):
            plate = picture(eye, start + k)
            header = {"timeCode": f"01:00:00:{start + k:02d}", "framesPerSecond": Fraction(24)}
            write_exr(tmp_path / f"{eye}.{k + 1}.exr", {c: plate[..., i] for i, c in enumerate("RGB")}, attributes=header)
    names = tmp_path / "left.#.exr", tmp_path / "right.#.exr"
    assert open_eyes(*names).shift == 0
    eyes = open_eyes(*names, sync="timecode")
    assert (eyes.shift, eyes.frames) == (-2, (3, 4, 5))
    assert eyes.notes == ("paired by time code: the right sequence starts 2 frames later",)
    np.testing.assert_array_equal(eyes.right.read(eyes.right_frame(3)), picture("right", 2))


@pytest.mark.parametrize("late", [2, -1])
def test_a_right_eye_that_is_late(tmp_path: Path, late: int) -> None:
    """Late by two: its picture of a moment comes two frames after the left eye's."""
    eyes = coded(tmp_path, (None, None), firsts=(2, 2 - late), right_late_frames=late)
    assert all(a == b for a, b in moments(eyes))
    assert len(eyes.frames) == 6 - abs(late)
    assert f"taken {abs(late)} frame{'s' * (abs(late) > 1)} {'later' if late > 0 else 'earlier'}" in eyes.notes[0]


def test_a_late_eye_of_a_sequence(tmp_path: Path) -> None:
    left = sequence(tmp_path, "left", pictures("left", 5))
    right = sequence(tmp_path, "right", pictures("right", 5))
    eyes = open_eyes(left, right, right_late_frames=1)
    assert (eyes.frames, eyes.right_frame(1001)) == ((1001, 1002, 1003, 1004), 1002)
    assert open_eyes(left, right, right_late_frames=1, frames="1002-1003").frames == (1002, 1003)
    with pytest.raises(
        PlateError, match=r"right\.####\.png: has no frame 1006 to go with 1005 of the left eye; it has 1001-1005\. Give --frames 1001-1004"
    ):
        open_eyes(left, right, right_late_frames=1, frames="1001-1005")


# What differs between the eyes


def test_rates_that_differ(tmp_path: Path) -> None:
    left = movie(tmp_path / "l.mkv", pictures("left", COUNT))
    right = movie(tmp_path / "r.mkv", pictures("right", COUNT), rate=Fraction(25))
    with pytest.raises(PlateError, match=r"r\.mkv: runs at 25 frames a second, but .*l\.mkv at 24; conform"):
        open_eyes(left, right)


def test_frame_counts_that_differ(tmp_path: Path) -> None:
    left, right = movie(tmp_path / "l.mkv", pictures("left", 5)), movie(tmp_path / "r.mkv", pictures("right", 3))
    with pytest.raises(PlateError, match=r"r\.mkv: holds 3 frames, but .*l\.mkv 5\. Give --frames 1-3"):
        open_eyes(left, right)
    assert open_eyes(left, right, frames="1-3").frames == (1, 2, 3)
    with pytest.raises(PlateError, match=r"r\.mkv: has no frame 4; it has 1-3\. Give --frames 1-3"):
        open_eyes(left, right, frames="1-4")
    with pytest.raises(PlateError, match=r"l\.mkv: has no frame 7; it has 1-5"):
        open_eyes(left, right, frames="7-8")


def test_a_frame_that_one_sequence_lacks(tmp_path: Path) -> None:
    left, right = (sequence(tmp_path, eye, pictures(eye, 3)) for eye in ("left", "right"))
    (tmp_path / "right.1002.png").unlink()
    with pytest.raises(PlateError, match=r"right\.1002\.png: frame missing; left has 1001-1003\. Give --frames 1001"):
        open_eyes(left, right)


def test_files_that_do_not_hold_two_eyes(tmp_path: Path) -> None:
    path = movie(tmp_path / "a.mkv", pictures("left", COUNT))
    with pytest.raises(PlateError, match=r"a\.mkv: is given for both eyes, but has one video track and no stereo tag.*side-by-side"):
        open_eyes(path)
    write_still(tmp_path / "a.png", picture("left"))
    with pytest.raises(PlateError, match=r"a\.png: is given for both eyes; name the right plate"):
        open_eyes(tmp_path / "a.png")
    write_exr(tmp_path / "a.exr", {c: picture("left")[..., k] for k, c in enumerate("RGB")})
    with pytest.raises(PlateError, match=r"a\.exr: is given for both eyes, but has one view; name the right plate"):
        open_eyes(tmp_path / "a.exr")


def test_a_layout_for_two_files(tmp_path: Path) -> None:
    left, right = (movie(tmp_path / f"{eye}.mkv", pictures(eye, COUNT)) for eye in ("left", "right"))
    with pytest.raises(PlateError, match=r"right\.mkv: is named for one eye, but the layout side-by-side is of one file that holds both"):
        open_eyes(left, right, layout="side-by-side")


def test_one_picture_and_many(tmp_path: Path) -> None:
    write_still(tmp_path / "a.png", picture("left"))
    right = sequence(tmp_path, "right", pictures("right", 2))
    with pytest.raises(PlateError, match=r"a\.png: is a single picture, but the other eye is a sequence; give both eyes alike"):
        open_eyes(tmp_path / "a.png", right)
    with pytest.raises(PlateError, match=r"a\.png: is a single picture, but the other eye is a movie"):
        open_eyes(movie(tmp_path / "m.mkv", pictures("left", 2)), tmp_path / "a.png")
    write_still(tmp_path / "b.png", picture("right"))
    with pytest.raises(PlateError, match=r"a\.png: is a single picture and has no frames"):
        open_eyes(tmp_path / "a.png", tmp_path / "b.png", frames="1-2")
    with pytest.raises((PlateError, ShotError), match=r"single picture"):
        open_eyes(tmp_path / "a.png", tmp_path / "b.png", right_late_frames=1)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"sync": "timecod"}, r"sync 'timecod' is unknown.*'timecode'"),
        ({"layout": "sbs"}, r"layout 'sbs' is unknown"),
        ({"frames": "4-1"}, "backwards"),
        ({"matrix": "bt70"}, "bt70"),
        ({"levels": "wide"}, "wide"),
    ],
)
def test_settings_that_cannot_be(tmp_path: Path, settings: dict[str, str], words: str) -> None:
    left, right = (movie(tmp_path / f"{eye}.mkv", pictures(eye, 2)) for eye in ("left", "right"))
    with pytest.raises((PlateError, ShotError), match=words):
        open_eyes(left, right, **settings).left.read(1)


def test_a_missing_eye_is_named(tmp_path: Path) -> None:
    left = movie(tmp_path / "l.mkv", pictures("left", 2))
    with pytest.raises(PlateError, match=r"gone\.mkv: there is no such file"):
        open_eyes(left, tmp_path / "gone.mkv")
    shutil.copy(left, tmp_path / "a_left.mkv")
    with pytest.raises(PlateError, match=r"a_right\.mkv: there is no such file"):
        open_eyes(tmp_path / "a_%V.mkv")
