"""PFM, the portable float map of the stereo benchmarks, to arrays and back.

In, out: (H, W) or (H, W, 3) float32, the top row first.  In the file the bottom row comes first, and a negative scale means
little-endian.  Values pass through untouched; infinity is what Middlebury writes for unknown."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import PassError, PlateError
from stereorelight.files import write_whole
from stereorelight.footage.source import check_file

HEADER = re.compile(rb"(PF|Pf)\s+(\d+)\s+(\d+)\s+([-+.\deE]+)[ \t\r]*\n")
LARGEST_SIDE = 32768


def read_pfm(path: str | Path) -> Float32:
    """(H, W), or (H, W, 3) of a colour file.  Raises PlateError when the file is missing, no PFM, or cut short."""
    path = Path(path)
    check_file(path)
    data = path.read_bytes()
    found = HEADER.match(data)
    try:
        scale = float(found[4]) if found else 0.0
    except ValueError:
        scale = 0.0
    if not found or scale == 0:
        raise PlateError(f"{path}: is not a PFM file: it must begin with Pf or PF, width, height and scale; export it again")
    width, height, channels = int(found[2]), int(found[3]), 3 if found[1] == b"PF" else 1
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise PlateError(f"{path}: damaged: its header claims {width} x {height} pixels; export it again")
    wanted, came = width * height * channels * 4, len(data) - found.end()
    if came < wanted:
        raise PlateError(f"{path}: truncated PFM: {came} of {wanted} bytes of pixels; copy or export it again")
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4", width * height * channels, found.end())
    shaped = values.reshape((height, width, 3) if channels == 3 else (height, width))[::-1]
    return np.ascontiguousarray(shaped, dtype=np.float32)


def write_pfm(path: str | Path, values: npt.ArrayLike, *, force: bool = False) -> Path:
    """Write (H, W) or (H, W, 3) as little-endian PFM.  Raises PassError for other shapes, OutputError when it cannot be written."""
    a = np.asarray(values, dtype="<f4")
    if a.ndim not in (2, 3) or 0 in a.shape or (a.ndim == 3 and a.shape[2] != 3):
        raise PassError(f"a PFM holds (H, W) or (H, W, 3), got {a.shape}")
    header = f"{'PF' if a.ndim == 3 else 'Pf'}\n{a.shape[1]} {a.shape[0]}\n-1.0\n".encode()
    return write_whole(path, lambda temporary: _put(temporary, header + np.ascontiguousarray(a[::-1]).tobytes()), force=force)


def _put(path: Path, data: bytes) -> None:
    path.write_bytes(data)
