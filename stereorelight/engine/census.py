"""A census of each pixel's neighbourhood: which of its neighbours are brighter, alike or darker (after Zabih and Woodfill 1994).

In: a grey picture (H, W) float32.  Out: (H, W) uint64, two bits a neighbour."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import kernel
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32
u4 = np.uint32
REACH = 2  # px of the window
CENSUS_STEPS = 2 * ((2 * REACH + 1) ** 2 - 1)  # that two pixels can be apart


_leaf = kernel(fastmath=False, noalias=True)


@_leaf
def _census_two(row, a, b, alike, out):
    """Four more bits of each word of a row: `a`, `b` are its neighbours' rows, shifted."""
    for x in range(row.size):
        p, q = a[x] - row[x], b[x] - row[x]
        first = (u4(p > alike) << u4(1)) | u4(p > -alike)
        out[x] = (out[x] << u4(4)) | (first << u4(2)) | (u4(q > alike) << u4(1)) | u4(q > -alike)


@_leaf
def _census_five(row, a, b, c, d, e, alike, out):
    """Ten more bits."""
    for x in range(row.size):
        p, q, r, s, t = a[x] - row[x], b[x] - row[x], c[x] - row[x], d[x] - row[x], e[x] - row[x]
        first = (u4(p > alike) << u4(3)) | (u4(p > -alike) << u4(2)) | (u4(q > alike) << u4(1)) | u4(q > -alike)
        then = (u4(r > alike) << u4(3)) | (u4(r > -alike) << u4(2)) | (u4(s > alike) << u4(1)) | u4(s > -alike)
        out[x] = (out[x] << u4(10)) | (first << u4(6)) | (then << u4(2)) | (u4(t > alike) << u4(1)) | u4(t > -alike)


@_leaf
def _words(high, low, out):
    for x in range(out.size):
        out[x] = (np.uint64(high[x]) << np.uint64(24)) | np.uint64(low[x])


@njit(cache=True, nogil=True, error_model="numpy")
def census_rows(first, end, grey, alike, out):
    """Rows of `census`."""
    H, W = out.shape
    wide = np.empty((2 * REACH + 1, W + 2 * REACH), np.float32)  # the rows about one, the border repeated
    high, low = np.empty(W, np.uint32), np.empty(W, np.uint32)  # 24 bits each: half as wide, twice as many at once
    for y in range(first, end):
        for j in range(2 * REACH + 1):
            row = grey[min(max(y + j - REACH, 0), H - 1)]
            wide[j, :REACH], wide[j, REACH : REACH + W], wide[j, REACH + W :] = row[0], row, row[W - 1]
        high[:], low[:] = u4(0), u4(0)
        me = wide[REACH, REACH : REACH + W]
        for j in (0, 1):
            a, b, c, d, e = wide[j, 0:W], wide[j, 1 : W + 1], wide[j, 2 : W + 2], wide[j, 3 : W + 3], wide[j, 4 : W + 4]
            _census_five(me, a, b, c, d, e, alike, high)
        _census_two(me, wide[2, 0:W], wide[2, 1 : W + 1], alike, high)
        _census_two(me, wide[2, 3 : W + 3], wide[2, 4 : W + 4], alike, low)
        for j in (3, 4):
            a, b, c, d, e = wide[j, 0:W], wide[j, 1 : W + 1], wide[j, 2 : W + 2], wide[j, 3 : W + 3], wide[j, 4 : W + 4]
            _census_five(me, a, b, c, d, e, alike, low)
        _words(high, low, out[y])


def census(grey: Float32, *, alike: float) -> npt.NDArray[np.uint64]:
    """(H, W) uint64: of each of 24 neighbours whether it is brighter, alike (within `alike` grey levels) or darker, two bits each.

    The bits that differ between two such words are the steps that the answers are apart.
    """
    out = np.empty(grey.shape, np.uint64)
    in_row_blocks(lambda a, b: census_rows(a, b, grey, f4(alike), out), grey.shape[0])
    return out
