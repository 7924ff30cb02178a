"""Exact picture look-ups at real-valued pixels (OpenCV's `remap` rounds its maps to 1/32 px, which shows in disparity).

In: pictures (H, W, C) float32 and maps (h, w, 2) float32 of source pixels (u, v).  Out: (h, w, C) float32."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, Int32
from stereorelight.engine.rows import in_pieces

f4 = np.float32


LOBES = 3  # of the sinc on either side
CUTOFF = 0.8  # of the finest detail that pixels hold: what is finer comes through on pixels, and not between them
STEPS = 8192  # fractions of a pixel in the table: looking up the nearest moves a sample by at most 1/16384 px


def _sinc_table(cutoff: float) -> Float32:
    """Weights (STEPS + 1, 6) of the six pixels about each fraction, of a sinc under Lanczos' window; each row sums to one, so plain areas
    stay plain."""
    x = np.linspace(0, 1, STEPS + 1)[:, None] + (LOBES - 1) - np.arange(2 * LOBES)
    weights = np.sinc(cutoff * x) * np.sinc(x / LOBES) * (np.abs(x) < LOBES)
    weights[np.abs(weights) < 1e-12] = 0  # the sinc of a whole number: a whole position gives its pixel exactly
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


LANCZOS = _sinc_table(1.0)
EVEN = _sinc_table(CUTOFF)


@njit(cache=True, nogil=True, error_model="numpy")
def _windowed_sinc(first, end, picture, pixels, table, out):
    H, W, C = picture.shape
    w = pixels.shape[1]
    for y in range(first, end):
        for x in range(w):
            u, v = pixels[y, x, 0], pixels[y, x, 1]
            # NaN and everything outside the outer pixel edges is unknown.
            if not (u >= f4(-0.5) and v >= f4(-0.5) and u <= f4(W - 0.5) and v <= f4(H - 0.5)):
                for c in range(C):
                    out[y, x, c] = np.nan
                continue
            x0, y0 = int(np.floor(u)), int(np.floor(v))
            wx, wy = table[int((u - x0) * STEPS + 0.5)], table[int((v - y0) * STEPS + 0.5)]
            for c in range(C):
                total = f4(0)
                for j in range(2 * LOBES):
                    yy = min(max(y0 + 1 - LOBES + j, 0), H - 1)
                    row = f4(0)
                    for i in range(2 * LOBES):
                        row += wx[i] * picture[yy, min(max(x0 + 1 - LOBES + i, 0), W - 1), c]
                    total += wy[j] * row
                out[y, x, c] = total


def resample(picture: Float32, pixels: Float32, kernel: Float32 = LANCZOS) -> Float32:
    """`picture` at `pixels`; the border is repeated, and beyond the frame is NaN.

    kernel : LANCZOS, of three lobes, true to detail and exact on whole pixels; or EVEN, which lets detail through alike wherever pixels fall,
             for what is to be compared with another picture.
    """
    out = np.empty((*pixels.shape[:2], picture.shape[2]), np.float32)
    in_pieces(lambda first, end: _windowed_sinc(first, end, picture, pixels, kernel, out), pixels.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _on_planes(first, end, value, slope_x, slope_y, pixels, apart, out, nearest):
    H, W = value.shape
    w = pixels.shape[1]
    for y in range(first, end):
        for x in range(w):
            u, v = pixels[y, x, 0], pixels[y, x, 1]
            out[y, x], nearest[y, x] = np.nan, -1
            if not (u >= f4(-0.5) and v >= f4(-0.5) and u < f4(W - 0.5) and v < f4(H - 0.5)):
                continue
            xn, yn = min(int(np.floor(u + f4(0.5))), W - 1), min(int(np.floor(v + f4(0.5))), H - 1)
            nearest[y, x] = yn * W + xn
            here = value[yn, xn] + slope_x[yn, xn] * (u - f4(xn)) + slope_y[yn, xn] * (v - f4(yn))
            if not np.isfinite(here):
                continue
            x0, y0 = min(max(int(np.floor(u)), 0), max(W - 2, 0)), min(max(int(np.floor(v)), 0), max(H - 2, 0))
            total, weight = f4(0), f4(0)
            for j in range(min(2, H)):
                for i in range(min(2, W)):
                    xx, yy = x0 + i, y0 + j
                    du, dv = u - f4(xx), v - f4(yy)
                    d = value[yy, xx] + slope_x[yy, xx] * du + slope_y[yy, xx] * dv
                    k = max(f4(1) - abs(du), f4(0)) * max(f4(1) - abs(dv), f4(0))
                    if abs(d - here) < apart:  # false for NaN
                        total += k * d
                        weight += k
            out[y, x] = total / weight if weight > f4(0) else here


def on_planes(value: Float32, slopes: tuple[Float32, Float32], pixels: Float32, *, apart: float) -> tuple[Float32, Int32]:
    """A map of local planes, looked up at `pixels` (h, w, 2) without ever mixing two surfaces.

    Each pixel's nearest plane is followed to the real position and averaged with those of the four neighbours that agree
    to within `apart`.  Returns (h, w) values and (h, w) flat index of the nearest pixel, -1 outside the map.
    """
    out, nearest = np.empty(pixels.shape[:2], np.float32), np.empty(pixels.shape[:2], np.int32)
    in_pieces(lambda first, end: _on_planes(first, end, value, *slopes, pixels, f4(apart), out, nearest), pixels.shape[0])
    return out, nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _doubled_planes(first, end, value, slope_x, slope_y, out):
    H, W = value.shape
    for y in range(first, end):
        row = min(y // 2, H - 1)  # an odd last row or column repeats the one before
        down = f4(0.5) if y % 2 or y >= 2 * H else f4(-0.5)
        for x in range(out.shape[1]):
            column = min(x // 2, W - 1)
            across = f4(0.5) if x % 2 or x >= 2 * W else f4(-0.5)
            out[y, x] = f4(2) * value[row, column] + across * slope_x[row, column] + down * slope_y[row, column]


def doubled_planes(disparity: Float32, slopes: tuple[Float32, Float32], size_hw: tuple[int, int]) -> Float32:
    """A half-size disparity in full-size pixels: each pixel's plane at the four that it was; slopes are px per px at either size."""
    out = np.empty(size_hw, np.float32)
    in_pieces(lambda first, end: _doubled_planes(first, end, disparity, *slopes, out), size_hw[0])
    return out
