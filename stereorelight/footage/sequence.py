"""Sequences of numbered pictures: patterns, frames on disk, frame ranges.

In: "plates/shot.left.####.exr", "shot.%04d.exr", "shot.%V.####.exr", or one picture.  Out: the frames that exist and their paths.
Frames are whole numbers; a single picture has none."""

from __future__ import annotations

import re
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from pathlib import Path

from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.source import not_there

COUNTER = re.compile(r"#+|%(0?)(\d*)d")
MOST_FRAMES = 1_000_000


def frame_range(text: str) -> tuple[int, ...]:
    """Frames of "1001-1010", "1001-1010x2" or "1001-1003,1007", sorted, each once.  Raises ShotError."""
    frames: set[int] = set()
    for piece in text.split(","):
        found = re.fullmatch(r"\s*(-?\d+)\s*(?:-\s*(-?\d+)\s*(?:x\s*(\d+)\s*)?)?", piece)
        if not found:
            raise ShotError(f"frames {text!r} are not frame numbers; write for example 1001-1010 or 1001-1005,1009")
        first = int(found[1])
        last, step = int(found[2] or first), int(found[3] or 1)
        if last < first or step < 1:
            raise ShotError(f"frames {piece.strip()!r} run backwards or stand still; write the lower frame first and a step of at least 1")
        if (last - first) // step > MOST_FRAMES:
            raise ShotError(f"frames {piece.strip()!r} are more than {MOST_FRAMES}; is a digit too many in it?")
        frames.update(range(first, last + 1, step))
    return tuple(sorted(frames))


def frames_text(frames: Many[int]) -> str:
    """The shortest "1001-1004,1007" that `frame_range` reads back."""
    runs: list[list[int]] = []
    for frame in sorted(set(frames)):
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    return ",".join(f"{a}-{b}" if b > a else str(a) for a, b in runs)


@dataclass(frozen=True, kw_only=True)
class Sequence:
    """A picture, or numbered pictures of one pattern.

    pattern : the path, with its counter if it has one and the view already written out.
    frames  : sorted frame numbers, empty for a single picture.
    """

    pattern: str
    frames: tuple[int, ...] = ()

    @classmethod
    def parse(cls, text: str | Path, *, view: str | None = None, must_exist: bool = True) -> Sequence:
        """The sequence that `text` names, with the frames found on disk.

        view       : what %V becomes ("left"), and by its first letter %v ("l").
        must_exist : False for a sequence that is yet to be written: it has no frames until `with_frames`.
        Raises     : PlateError when there is no such file, or no frame of the pattern.
        """
        pattern = str(text)
        if "%V" in pattern or "%v" in pattern:
            if not view:
                raise PlateError(f"{pattern}: %V stands for the eye; give the left and right plates by name or name the view")
            pattern = pattern.replace("%V", view).replace("%v", view[0])
        folder, name = Path(pattern).parent, Path(pattern).name
        counters = list(COUNTER.finditer(name))
        if COUNTER.search(str(folder)) or len(counters) > 1:
            raise PlateError(f"{pattern}: a pattern takes one frame counter (#### or %04d), in the file's name")
        if not counters:
            if must_exist and not Path(pattern).is_file():
                what = "is a folder; give a picture, or a pattern such as name.####.exr" if Path(pattern).is_dir() else not_there(Path(pattern))
                raise PlateError(f"{pattern}: {what}")
            return cls(pattern=pattern)
        if not must_exist:
            return cls(pattern=pattern)
        if not folder.is_dir():
            raise PlateError(f"{pattern}: there is no folder {folder}")
        head, tail = name[: counters[0].start()], name[counters[0].end() :]
        digits = re.compile(re.escape(head) + r"(-?\d+)" + re.escape(tail))
        hits = [int(m[1]) for entry in folder.iterdir() if (m := digits.fullmatch(entry.name))]
        found = cls(pattern=pattern, frames=tuple(sorted(set(hits))))
        # "shot.7.exr" is no frame of "shot.####.exr": only numbers padded as the pattern says.
        found = replace(found, frames=tuple(f for f in found.frames if found.path(f).is_file()))
        if not found.frames:
            raise PlateError(f"{pattern}: no frame of this pattern exists in {folder}; check the name and the number of digits")
        return found

    @property
    def is_single(self) -> bool:
        """Whether this is one picture without a counter."""
        return COUNTER.search(Path(self.pattern).name) is None

    def path(self, frame: int | None = None) -> Path:
        """The file of `frame`; a single picture is the same file for every frame."""
        if self.is_single:
            return Path(self.pattern)
        if frame is None:
            raise PlateError(f"{self.pattern}: is a sequence; say which frame")

        def number(m: re.Match[str]) -> str:
            width = len(m[0]) if m[0][0] == "#" else int(m[2] or 0)
            return f"{frame:0{width}d}" if m[0][0] == "#" or m[1] else f"{frame:{width or 1}d}"

        name = Path(self.pattern).name
        return Path(self.pattern).with_name(COUNTER.sub(number, name))

    def with_frames(self, frames: str | Many[int]) -> Sequence:
        """The same pattern with these frames, whether they exist or not."""
        if self.is_single:
            raise PlateError(f"{self.pattern}: is a single picture and has no frames; leave --frames out, or give a pattern such as name.####.exr")
        wanted = frame_range(frames) if isinstance(frames, str) else tuple(sorted(set(frames)))
        return replace(self, frames=wanted)


def common_frames(left: Sequence, right: Sequence, wanted: str | Many[int] | None = None) -> tuple[int, ...]:
    """The frames to work on: all of both eyes, or `wanted`; empty for two single pictures.

    Raises : PlateError naming the first frame that one eye lacks, what there is, and the frames that would do.
    """
    if left.is_single != right.is_single:
        raise PlateError(
            f"{left.path() if left.is_single else right.path()}: is a single picture, but the other eye is a sequence; give both eyes alike"
        )
    if left.is_single:
        if wanted:
            left.with_frames(wanted)
        return ()
    frames = frame_range(wanted) if isinstance(wanted, str) else tuple(sorted(set(wanted or (*left.frames, *right.frames))))
    have_left, have_right = set(left.frames), set(right.frames)
    for frame in frames:
        for eye, have, other, others in ((left, have_left, "right", right.frames), (right, have_right, "left", left.frames)):
            if frame in have:
                continue
            both = sorted(have_left & have_right & set(frames))
            whole = next((i for i, (a, b) in enumerate(zip(both, frames)) if a != b), len(both))
            remedy = f"Give --frames {frames_text(both[:whole] or both)}, or restore the frame" if both else "Restore the frame"
            raise PlateError(f"{eye.path(frame).name}: frame missing; {other} has {frames_text(others)}. {remedy}")
    return frames
