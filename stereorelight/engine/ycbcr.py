"""Video planes to RGB in one pass: chroma brought to full size, matrix, range, and if wanted a curve and a 3x3 matrix after it.

In: planes of whole numbers (rows, stride), as a decoder leaves them.  Out: (H, W, 3) float32.
Arithmetic is strict (no fast-math): black, white and greys come back exactly, and the bits do not depend on the machine."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32
BLOCK_ROWS = 24  # even, so that a block of 4:2:0 begins with a pair of rows


@njit(cache=True, nogil=True, error_model="numpy")
def _level(n, plane, zero, span, row):
    for i in range(n):
        row[i] = (f4(plane[i]) - zero) / span


@njit(cache=True, nogil=True, error_model="numpy")
def _two_levels(n, first, second, weight, zero, span, row):
    """The mean of two rows, `weight` of it the second."""
    for i in range(n):
        a = f4(first[i]) - zero
        row[i] = (a + weight * (f4(second[i]) - zero - a)) / span


@njit(cache=True, nogil=True, error_model="numpy")
def _widened(n, row, before, after, wide):
    """A row of half the samples at full width: even pixels take `before` of the sample on their left, odd ones `after` of the next."""
    # row[0] and row[n + 1] repeat the border.
    for i in range(n):
        here = row[i + 1]
        wide[2 * i] = here + before * (row[i] - here)
        wide[2 * i + 1] = here + after * (row[i + 2] - here)


@njit(cache=True, nogil=True, error_model="numpy")
def _matrix(n, luma, blue, red, r_cr, g_cb, g_cr, b_cb, r, g, b):
    for i in range(n):
        y = luma[i]
        r[i] = y + r_cr * red[i]
        g[i] = y - g_cb * blue[i] - g_cr * red[i]
        b[i] = y + b_cb * blue[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _curve(n, pairs, low, per_step, row, steps, found, halves):
    """`row` through a curve sampled evenly; beyond its ends the outer steps go on straight.

    pairs : `pairs_of` the curve.  steps (n,) int32 and found (n,) int64 are scratch, halves is found's memory as float32.
    """
    last = f4(pairs.shape[0] - 1)
    # Three loops: the first and the last become vector code, and the look-up between them is one load a sample.
    for i in range(n):
        t = (row[i] - low) * per_step
        inside = t if t > f4(0) else f4(0)
        step = np.int32(inside if inside < last else last)
        steps[i] = step
        row[i] = t - f4(step)
    for i in range(n):
        found[i] = pairs[np.uint32(steps[i])]
    for i in range(n):
        row[i] = halves[2 * i] + row[i] * halves[2 * i + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _interleaved(n, r, g, b, out):
    for i in range(n):
        out[3 * i] = r[i]
        out[3 * i + 1] = g[i]
        out[3 * i + 2] = b[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _interleaved_matrix(n, r, g, b, m, out):
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]
    for i in range(n):
        x, y, z = r[i], g[i], b[i]
        out[3 * i] = m00 * x + m01 * y + m02 * z
        out[3 * i + 1] = m10 * x + m11 * y + m12 * z
        out[3 * i + 2] = m20 * x + m21 * y + m22 * z


@njit(cache=True, nogil=True, error_model="numpy")
def _finished(n, r, g, b, pairs, low, per_step, m, steps, found, halves, out):
    if pairs.shape[0]:
        _curve(n, pairs, low, per_step, r, steps, found, halves)
        _curve(n, pairs, low, per_step, g, steps, found, halves)
        _curve(n, pairs, low, per_step, b, steps, found, halves)
    if m.shape[0] == 3:
        _interleaved_matrix(n, r, g, b, m, out)
    else:
        _interleaved(n, r, g, b, out)


@njit(cache=True, nogil=True, error_model="numpy")
def _chroma(y, n, plane, rows, halved, above, below, before, after, zero, span, row, wide):
    """Row `y` of a chroma plane at full width, in `wide`; `row` is scratch."""
    inner = row[1:]
    if halved[0]:
        k = y // 2
        other, weight = (max(k - 1, 0), above) if y % 2 == 0 else (min(k + 1, rows - 1), below)
        _two_levels(n, plane[k], plane[other], weight, zero, span, inner)
    else:
        _level(n, plane[y], zero, span, inner)
    if halved[1]:
        row[0], row[n + 1] = row[1], row[n]
        _widened(n, row, before, after, wide)
    else:
        for i in range(n):
            wide[i] = inner[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _from_ycbcr(first, end, luma, blue, red, halved, siting, zeros, spans, weights, pairs, low, per_step, m, out):
    W = out.shape[1] // 3
    H = out.shape[0]
    n = (W + 1) // 2 if halved[1] else W
    rows = (H + 1) // 2 if halved[0] else H
    room = W + 4
    line, l, cb, cr = np.empty(room, f4), np.empty(room, f4), np.empty(room, f4), np.empty(room, f4)
    r, g, b = np.empty(room, f4), np.empty(room, f4), np.empty(room, f4)
    steps, found = np.empty(room, np.int32), np.empty(room, np.int64)
    halves = found.view(np.float32)
    above, below, before, after = siting
    for y in range(first, end):
        _level(W, luma[y], zeros[0], spans[0], l)
        _chroma(y, n, blue, rows, halved, above, below, before, after, zeros[1], spans[1], line, cb)
        _chroma(y, n, red, rows, halved, above, below, before, after, zeros[1], spans[1], line, cr)
        _matrix(W, l, cb, cr, weights[0], weights[1], weights[2], weights[3], r, g, b)
        _finished(W, r, g, b, pairs, low, per_step, m, steps, found, halves, out[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _from_rgb(first, end, red, green, blue, zero, span, pairs, low, per_step, m, out):
    W = out.shape[1] // 3
    r, g, b = np.empty(W, f4), np.empty(W, f4), np.empty(W, f4)
    steps, found = np.empty(W, np.int32), np.empty(W, np.int64)
    halves = found.view(np.float32)
    for y in range(first, end):
        _level(W, red[y], zero, span, r)
        _level(W, green[y], zero, span, g)
        _level(W, blue[y], zero, span, b)
        _finished(W, r, g, b, pairs, low, per_step, m, steps, found, halves, out[y])


NO_PAIRS, NO_MATRIX = np.zeros(0, np.int64), np.zeros((1, 3), np.float32)
_made: dict[int, tuple[weakref.ref[Any], npt.NDArray[np.int64]]] = {}


def pairs_of(table: Float32) -> npt.NDArray[np.int64]:
    """(n - 1,) int64 of n samples: each sample and the rise to the next, two float32 side by side, so that one load brings both.

    Those of a read-only table are kept as long as the table lives."""
    kept = _made.get(id(table))
    if kept is not None and kept[0]() is table:
        return kept[1]
    values = np.ascontiguousarray(table, np.float32)
    sides = np.empty((len(values) - 1, 2), np.float32)
    sides[:, 0], sides[:, 1] = values[:-1], np.diff(values)
    pairs = sides.view(np.int64)[:, 0]
    if not table.flags.writeable:
        key = id(table)
        _made[key] = (weakref.ref(table, lambda _: _made.pop(key, None)), pairs)
    return pairs


def planes_to_rgb(
    planes: tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]],
    out: Float32,
    *,
    levels: tuple[float, float, float, float],
    weights: tuple[float, float, float, float] | None,
    halved: tuple[bool, bool] = (False, False),
    siting: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.5),
    curve: tuple[float, float, Float32] | None = None,
    matrix: Float32 | None = None,
) -> Float32:
    """Fill `out` (H, W, 3) float32 from three planes (rows, stride) of uint8 or uint16, C-contiguous, stride >= width.

    levels  : code of black, codes from black to white, code of neutral chroma, codes from -0.5 to 0.5 of chroma.
    weights : of Cr in R, of Cb and of Cr in G (taken away), of Cb in B; None where the planes are R, G, B.
    halved  : whether chroma has half the rows, half the columns.
    siting  : weight of the chroma row above in even rows and of the one below in odd rows, of the sample on the left in even
              columns and of the one on the right in odd columns.
    curve   : (low, high, values (n,) float32), by linear interpolation; beyond the ends the outer steps go on straight.
    matrix  : (3, 3) float32, applied after the curve.
    """
    low, per_step, pairs = f4(0), f4(1), NO_PAIRS
    if curve is not None:
        pairs = pairs_of(curve[2])
        low, per_step = f4(curve[0]), f4(len(pairs) / (curve[1] - curve[0]))
    m = NO_MATRIX if matrix is None else np.ascontiguousarray(matrix, np.float32)
    flat = out.reshape(out.shape[0], -1)
    black, white, neutral, chroma = (f4(v) for v in levels)
    if weights is None:

        def run(first: int, end: int) -> None:
            _from_rgb(first, end, *planes, black, white, pairs, low, per_step, m, flat)
    else:
        sides = tuple(f4(v) for v in siting)
        factors = tuple(f4(v) for v in weights)

        def run(first: int, end: int) -> None:
            zeros, spans = (black, neutral), (white, chroma)
            _from_ycbcr(first, end, *planes, halved, sides, zeros, spans, factors, pairs, low, per_step, m, flat)

    in_row_blocks(run, out.shape[0], block_rows=BLOCK_ROWS)
    return out
