"""Array types, and the check that every public door makes on what comes in.

Shapes are (H, W) or (H, W, C), C-contiguous; pictures and passes are float32; geometry is float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.errors import PassError

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
UInt8 = npt.NDArray[np.uint8]
UInt16 = npt.NDArray[np.uint16]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]


def as_float32(array: Any, name: str, *, channels: int | None = None, size_hw: tuple[int, int] | None = None) -> Float32:
    """`array` as C-contiguous float32, after checking that it is what `name` must be.

    channels : 3 for (H, W, 3), 2 for (H, W, 2), None for (H, W).
    size_hw  : (H, W) that it must have, or None for any.
    Raises   : PassError naming the pass, what was wanted and what came.
    """
    a = np.asarray(array)
    wanted = "(H, W)" if channels is None else f"(H, W, {channels})"
    if size_hw is not None:
        wanted = wanted.replace("H, W", f"{size_hw[0]}, {size_hw[1]}")
    if not np.issubdtype(a.dtype, np.floating):
        remedy = "divide by 16 first: OpenCV matchers return int16 sixteenths" if a.dtype == np.int16 else "convert it to float32 first"
        raise PassError(f"{name} must be float, got {a.dtype}; {remedy}")
    fits = a.ndim == (2 if channels is None else 3) and (channels is None or a.shape[2] == channels)
    if not fits or (size_hw is not None and a.shape[:2] != tuple(size_hw)):
        raise PassError(f"{name} must have shape {wanted}, got {a.shape}")
    if 0 in a.shape:
        raise PassError(f"{name} is empty: shape {a.shape}")
    return np.ascontiguousarray(a, dtype=np.float32)
