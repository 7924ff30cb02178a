"""Nuke's .chan camera files: one line a frame, `frame tx ty tz rx ry rz [vertical field of view]`.

In: text.  Out: frame to position and angles as they stand there; or the text of a file.
Axes are Nuke's, and ours right of Z: x right, y up, the camera looks down -z; angles in degrees, lengths in the scene's own unit.
The file does not say in which order the angles turn; Nuke's own default is ZXY: about z first, then x, then y."""

from __future__ import annotations

import math
from collections.abc import Mapping

from stereorelight.arrays import Float64
from stereorelight.errors import RigError
from stereorelight.interchange.turns import angles_of

Row = tuple[int, tuple[float, float, float], tuple[float, float, float]]


def chan_rows(text: str) -> list[Row]:
    """(frame, position in the file's unit, angles in degrees) of each line.  Raises RigError naming the line."""
    rows: list[Row] = []
    seen: dict[int, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise RigError(
                f"line {number}: must be numbers: frame tx ty tz rx ry rz, and perhaps the field of view; got {line.strip()[:60]!r}"
            ) from None
        if len(numbers) not in (7, 8):
            raise RigError(f"line {number}: must hold 7 or 8 numbers, frame tx ty tz rx ry rz and perhaps the field of view, got {len(numbers)}")
        if not all(math.isfinite(x) for x in numbers):
            raise RigError(f"line {number}: holds a value that is not finite")
        frame = numbers[0]
        if frame != int(frame):
            raise RigError(f"line {number}: frame {frame:g} is not a whole number; export the camera on whole frames")
        if int(frame) in seen:
            raise RigError(f"line {number}: frame {int(frame)} stands at line {seen[int(frame)]} already")
        seen[int(frame)] = number
        rows.append((int(frame), (numbers[1], numbers[2], numbers[3]), (numbers[4], numbers[5], numbers[6])))
    if not rows:
        raise RigError("holds no frame; a .chan file has a line a frame: frame tx ty tz rx ry rz")
    return rows


def chan_text(poses: Mapping[int, Float64], *, unit_m: float = 1.0, order: str = "ZXY", vertical_fov_deg: float | None = None) -> str:
    """The .chan text of poses (4, 4), scene-frame camera to world, metres, by frame; `chan_rows` reads it back to rounding.

    unit_m           : metres in one unit of the other package.
    vertical_fov_deg : written as the last column where given; Nuke wants it for a camera.
    """
    lines = []
    for frame in sorted(poses):
        pose = poses[frame]
        numbers = [*(pose[:3, 3] / unit_m), *angles_of(pose[:3, :3], order)]
        if vertical_fov_deg is not None:
            numbers.append(vertical_fov_deg)
        lines.append("\t".join([str(frame), *(f"{float(x):.12g}" for x in numbers)]))
    return "\n".join(lines) + "\n"
