"""Disparities in whole sixteenths of a pixel, as OpenCV has them, and back.

In, out: (H, W) float32 px, NaN where there is none; int16 sixteenths, `NOWHERE` where there is none."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.rows import in_pieces

f4 = np.float32
Int16 = npt.NDArray[np.int16]
NOWHERE = -32768
MOST = 32_000


@njit(cache=True, nogil=True, error_model="numpy")
def _coded(first, end, disparity, out):
    for y in range(first, end):
        for x in range(disparity.shape[1]):
            d = np.rint(disparity[y, x] * f4(16))
            out[y, x] = np.int16(min(max(d, f4(-MOST)), f4(MOST))) if d == d else np.int16(NOWHERE)


def coded(disparity: Float32) -> Int16:
    """The nearest sixteenths; `MOST` at most, either way."""
    out = np.empty(disparity.shape, np.int16)
    in_pieces(lambda first, end: _coded(first, end, disparity, out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _pixels(first, end, sixteenths, lowest, sign, out):
    for y in range(first, end):
        for x in range(out.shape[1]):
            d = sixteenths[y, x]
            out[y, x] = sign * (f4(d) * f4(1 / 16)) if d >= lowest else f4(np.nan)


def as_pixels(sixteenths: Int16, lowest_px: int, *, sign: int = 1) -> Float32:
    """In pixels, NaN below `lowest_px`; times `sign`."""
    out = np.empty(sixteenths.shape, np.float32)
    in_pieces(lambda first, end: _pixels(first, end, sixteenths, 16 * lowest_px, f4(sign), out), sixteenths.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _kept(first, end, disparity, sixteenths, out):
    for y in range(first, end):
        for x in range(out.shape[1]):
            out[y, x] = disparity[y, x] if sixteenths[y, x] != NOWHERE else f4(np.nan)


def kept(disparity: Float32, sixteenths: Int16) -> Float32:
    """The disparity as it was, NaN where the sixteenths are `NOWHERE`."""
    out = np.empty_like(disparity)
    in_pieces(lambda first, end: _kept(first, end, disparity, sixteenths, out), disparity.shape[0])
    return out
