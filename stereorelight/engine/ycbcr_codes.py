"""RGB to video planes in one pass: matrix, chroma thinned, range, and each sample rounded once.

In: (H, W, 3) float32 or float64, finite.  Out: planes of uint8 or uint16.  Float64 within and no fast-math, so that the codes are
those of the formula written out, whatever the machine."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.engine.rows import in_row_blocks

BLOCK_ROWS = 24  # even, so that a block begins with a pair of rows


@njit(cache=True, nogil=True, error_model="numpy")
def _coded(n, values, span, zero, top, codes):
    """The nearest codes, halves up, held within 0..top."""
    for i in range(n):
        whole = math.floor(values[i] * span + (zero + 0.5))
        whole = whole if whole > 0.0 else 0.0
        codes[i] = np.int32(whole if whole < top else top)


@njit(cache=True, nogil=True, error_model="numpy")
def _split(n, row, kr, kg, kb, blue_span, red_span, y, blue, red):
    for i in range(n):
        r, g, b = np.float64(row[3 * i]), np.float64(row[3 * i + 1]), np.float64(row[3 * i + 2])
        luma = kr * r + kg * g + kb * b
        y[i] = luma
        blue[i] = (b - luma) / blue_span
        red[i] = (r - luma) / red_span


@njit(cache=True, nogil=True, error_model="numpy")
def _thin_row(n, row, cosited, thin):
    """Half the samples of a row: 1 2 1 about every even one, or the mean of an even one and the next; the border is repeated."""
    half = (n + 1) // 2
    if cosited:
        thin[0] = 0.25 * row[0] + 0.5 * row[0] + 0.25 * row[min(1, n - 1)]
        for i in range(1, n // 2):
            thin[i] = 0.25 * row[2 * i - 1] + 0.5 * row[2 * i] + 0.25 * row[2 * i + 1]
    else:
        for i in range(n // 2):
            thin[i] = 0.5 * (row[2 * i] + row[2 * i + 1])
    if n % 2:
        last = row[n - 1]
        before = row[n - 2] if n > 1 else last
        thin[half - 1] = 0.25 * before + 0.5 * last + 0.25 * last if cosited else 0.5 * (last + last)


@njit(cache=True, nogil=True, error_model="numpy")
def _thin_rows(n, above, here, below, cosited, thin):
    if cosited:
        for i in range(n):
            thin[i] = 0.25 * above[i] + 0.5 * here[i] + 0.25 * below[i]
    else:
        for i in range(n):
            thin[i] = 0.5 * (here[i] + below[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _to_ycbcr(first, end, rgb, luma, cb, cr, halved, cosited, matrix, levels, top):
    H, W = luma.shape
    kr, kg, kb, blue_span, red_span = matrix
    black, white, neutral, chroma = levels
    n = cb.shape[1]
    y = np.empty(W)
    whole = np.empty((2, W))
    # Chroma of the rows above, here and below, as wide as the planes.
    blue, red = np.empty((3, n)), np.empty((3, n))
    line = np.empty(n)
    step = 2 if halved[0] else 1
    for start in range(first, end, step):
        for k in range(-1 if halved[0] and cosited[0] else 0, step):
            at = min(max(start + k, 0), H - 1)
            _split(W, rgb[at], kr, kg, kb, blue_span, red_span, y, whole[0], whole[1])
            if k >= 0 and start + k < H:
                _coded(W, y, white, black, top, luma[at])
            if halved[1]:
                _thin_row(W, whole[0], cosited[1], blue[k + 1])
                _thin_row(W, whole[1], cosited[1], red[k + 1])
            else:
                blue[k + 1, :] = whole[0]
                red[k + 1, :] = whole[1]
        if halved[0]:
            _thin_rows(n, blue[0], blue[1], blue[2], cosited[0], line)
            _coded(n, line, chroma, neutral, top, cb[start // 2])
            _thin_rows(n, red[0], red[1], red[2], cosited[0], line)
            _coded(n, line, chroma, neutral, top, cr[start // 2])
        else:
            _coded(n, blue[1], chroma, neutral, top, cb[start])
            _coded(n, red[1], chroma, neutral, top, cr[start])


@njit(cache=True, nogil=True, error_model="numpy")
def _to_rgb(first, end, rgb, red, green, blue, zero, span, top):
    W = red.shape[1]
    for y in range(first, end):
        _coded(W, rgb[y, 0::3], span, zero, top, red[y])
        _coded(W, rgb[y, 1::3], span, zero, top, green[y])
        _coded(W, rgb[y, 2::3], span, zero, top, blue[y])


def rgb_to_planes(
    rgb: npt.NDArray[Any],
    *,
    bits: int,
    levels: tuple[float, float, float, float],
    weights: tuple[float, float] | None,
    halved: tuple[bool, bool] = (False, False),
    cosited: tuple[bool, bool] = (False, True),
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Y, Cb, Cr planes of (H, W, 3) float32 or float64, uint8 for 8 bits and uint16 above; R, G, B planes where `weights` is None.

    levels  : code of black, codes from black to white, code of neutral chroma, codes from -0.5 to 0.5 of chroma.
    weights : Kr and Kb.
    halved  : whether chroma has half the rows, half the columns, rounded up.
    cosited : whether a chroma sample lies on the even row, on the even column; else halfway to the next.
    """
    H, W = rgb.shape[:2]
    kind = np.uint8 if bits == 8 else np.uint16
    size = (-(-H // 2) if halved[0] else H, -(-W // 2) if halved[1] else W)
    planes = (np.empty((H, W), kind), np.empty(size, kind), np.empty(size, kind))
    flat, top = np.ascontiguousarray(rgb).reshape(H, -1), float(2**bits - 1)
    if weights is None:

        def run(first: int, end: int) -> None:
            _to_rgb(first, end, flat, *planes, levels[0], levels[1], top)
    else:
        kr, kb = weights
        matrix = (kr, 1 - kr - kb, kb, 2 * (1 - kb), 2 * (1 - kr))

        def run(first: int, end: int) -> None:
            _to_ycbcr(first, end, flat, *planes, halved, cosited, matrix, levels, top)

    in_row_blocks(run, H, block_rows=BLOCK_ROWS)
    return planes
