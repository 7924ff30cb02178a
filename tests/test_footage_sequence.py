"""Sequences: patterns find exactly their frames, and a missing frame is named with the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.sequence import Sequence, common_frames, frame_range, frames_text


def touch(folder: Path, pattern: str, frames: range | list[int]) -> None:
    for frame in frames:
        (folder / pattern.format(frame)).touch()


@settings(max_examples=50, deadline=None)
@given(st.sets(st.integers(0, 3000), min_size=1))
def test_frames_written_out_are_read_back(frames: set[int]) -> None:
    assert frame_range(frames_text(tuple(frames))) == tuple(sorted(frames))


def test_frame_ranges() -> None:
    assert frame_range("1001-1003,1007, 1002") == (1001, 1002, 1003, 1007)
    assert frame_range("1-9x4") == (1, 5, 9)
    assert frame_range("-2-1") == (-2, -1, 0, 1)
    for wrong in ("", "a", "1-", "5-1", "1-2-3", "1,,2", "1-5x0", "1-99999999"):
        with pytest.raises(ShotError):
            frame_range(wrong)


@pytest.mark.parametrize("pattern", ["shot.####.exr", "shot.%04d.exr"])
def test_a_pattern_finds_its_frames(tmp_path: Path, pattern: str) -> None:
    touch(tmp_path, "shot.{:04d}.exr", [1010, 999, 1001, 12345])
    for other in ("shot.7.exr", "shot.00999.exr", "shot.1002.png", "xshot.1003.exr", "shot.10a4.exr", "shotx1005.exr"):
        (tmp_path / other).touch()
    (tmp_path / "shot.1006.exr").mkdir()
    found = Sequence.parse(tmp_path / pattern)
    assert found.frames == (999, 1001, 1010, 12345)
    assert found.path(999) == tmp_path / "shot.0999.exr"
    assert not found.is_single
    assert found.with_frames("1001-1003").frames == (1001, 1002, 1003)


def test_unpadded_and_view_tokens(tmp_path: Path) -> None:
    touch(tmp_path, "left_l_{}.png", range(8, 12))
    found = Sequence.parse(tmp_path / "%V_%v_%d.png", view="left")
    assert found.frames == (8, 9, 10, 11)
    assert found.path(8).name == "left_l_8.png"
    with pytest.raises(PlateError, match="%V stands for the eye"):
        Sequence.parse(tmp_path / "%V_%d.png")


def test_a_single_picture(tmp_path: Path) -> None:
    (tmp_path / "left 2.png").touch()
    one = Sequence.parse(tmp_path / "left 2.png")
    assert one.is_single
    assert one.frames == ()
    assert one.path() == one.path(7) == tmp_path / "left 2.png"
    with pytest.raises(PlateError, match="single picture"):
        one.with_frames("1-2")


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(PlateError, match="no such file"):
        Sequence.parse(tmp_path / "a.png")
    with pytest.raises(PlateError, match="no frame of this pattern"):
        Sequence.parse(tmp_path / "a.####.png")
    with pytest.raises(PlateError, match="no folder"):
        Sequence.parse(tmp_path / "plates" / "a.####.png")
    with pytest.raises(PlateError, match="folder; give a picture"):
        Sequence.parse(tmp_path)
    with pytest.raises(PlateError, match="one frame counter"):
        Sequence.parse(tmp_path / "a.##.##.png")
    assert Sequence.parse(tmp_path / "a.####.png", must_exist=False).with_frames("1-2").path(2).name == "a.0002.png"


def test_a_gap_in_one_eye_is_named_with_the_remedy(tmp_path: Path) -> None:
    touch(tmp_path, "shot.left.{}.exr", range(1001, 1011))
    touch(tmp_path, "shot.right.{}.exr", [*range(1001, 1007), 1008, 1009, 1010])
    left, right = (Sequence.parse(tmp_path / "shot.%V.####.exr", view=eye) for eye in ("left", "right"))
    with pytest.raises(PlateError) as told:
        common_frames(left, right)
    assert str(told.value) == "shot.right.1007.exr: frame missing; left has 1001-1010. Give --frames 1001-1006, or restore the frame"
    assert common_frames(left, right, "1001-1006") == tuple(range(1001, 1007))
    with pytest.raises(PlateError, match=r"shot\.left\.1011\.exr: frame missing"):
        common_frames(left, right, "1010-1011")


def test_single_pictures_and_mixtures(tmp_path: Path) -> None:
    for name in ("l.png", "r.png"):
        (tmp_path / name).touch()
    touch(tmp_path, "s.{:04d}.png", [1])
    left, right, many = (Sequence.parse(tmp_path / name) for name in ("l.png", "r.png", "s.####.png"))
    assert common_frames(left, right) == ()
    with pytest.raises(PlateError, match=r"l\.png: is a single picture"):
        common_frames(left, many)
