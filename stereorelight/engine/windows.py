"""Means over square windows, for kernels that go on with them row by row; beyond the frame the picture is mirrored, its border not repeated.

In: maps (H, W) float32.  Out: rows (W,) float32.  Every sum has the same order whatever the rows that are shared out together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.fastmath import kernel
from stereorelight.engine.rows import in_pieces

f4 = np.float32
_leaf = kernel(fastmath=False, noalias=True)


@njit(cache=True, nogil=True, error_model="numpy")
def mirrored(k, n):
    """The place in 0..n - 1 that stands for k."""
    if n == 1:
        return 0
    while k < 0 or k >= n:
        k = -k if k < 0 else 2 * n - 2 - k
    return k


@_leaf
def _sum_7(a, b, c, d, e, f, g, out):
    for x in range(a.size):
        out[x] = ((a[x] + b[x]) + (c[x] + d[x])) + ((e[x] + f[x]) + g[x])


@_leaf
def _sum_squares_9(a, b, c, d, e, f, g, h, i, cap, out):
    for x in range(a.size):
        p = (min(a[x] * a[x], cap) + min(b[x] * b[x], cap)) + (min(c[x] * c[x], cap) + min(d[x] * d[x], cap))
        q = (min(e[x] * e[x], cap) + min(f[x] * f[x], cap)) + (min(g[x] * g[x], cap) + min(h[x] * h[x], cap))
        out[x] = (p + q) + min(i[x] * i[x], cap)


@njit(cache=True, nogil=True, error_model="numpy")
def _mirror_ends(wide, radius):
    """The ends of a row that has `radius` places before and after it."""
    n = wide.size - 2 * radius
    for k in range(1, radius + 1):
        wide[radius - k] = wide[radius + mirrored(-k, n)]
        wide[radius + n - 1 + k] = wide[radius + mirrored(n - 1 + k, n)]


@_leaf
def _across_7(a, per, out):
    for x in range(out.size):
        out[x] = per[x] * (((a[x] + a[x + 1]) + (a[x + 2] + a[x + 3])) + ((a[x + 4] + a[x + 5]) + a[x + 6]))


@_leaf
def _across_9(a, per, out):
    for x in range(out.size):
        p, q = (a[x] + a[x + 1]) + (a[x + 2] + a[x + 3]), (a[x + 4] + a[x + 5]) + (a[x + 6] + a[x + 7])
        out[x] = per[x] * ((p + q) + a[x + 8])


@njit(cache=True, nogil=True, error_model="numpy")
def row_sum_7(a, y, per, wide, out):
    """Sum over the 7 x 7 about each pixel of row y, times `per` (W,); `wide` is W + 6 places to work in."""
    H, W = a.shape
    r = a[mirrored(y - 3, H)], a[mirrored(y - 2, H)], a[mirrored(y - 1, H)], a[mirrored(y + 1, H)], a[mirrored(y + 2, H)], a[mirrored(y + 3, H)]
    _sum_7(r[0], r[1], r[2], a[y], r[3], r[4], r[5], wide[3 : 3 + W])
    _mirror_ends(wide, 3)
    _across_7(wide, per, out)


@njit(cache=True, nogil=True, error_model="numpy")
def row_sum_square_9(a, y, cap, per, wide, out):
    """Sum over the 9 x 9 about each pixel of row y of the square, or of `cap` where that is less, times `per` (W,); `wide` is W + 8 places to
    work in."""
    H, W = a.shape
    r = a[mirrored(y - 4, H)], a[mirrored(y - 3, H)], a[mirrored(y - 2, H)], a[mirrored(y - 1, H)]
    s = a[mirrored(y + 1, H)], a[mirrored(y + 2, H)], a[mirrored(y + 3, H)], a[mirrored(y + 4, H)]
    _sum_squares_9(r[0], r[1], r[2], r[3], a[y], s[0], s[1], s[2], s[3], cap, wide[4 : 4 + W])
    _mirror_ends(wide, 4)
    _across_9(wide, per, out)


@njit(cache=True, nogil=True, error_model="numpy")
def _counted(first, end, seen, per_7, per_9):
    W = seen.shape[1]
    wide_7, wide_9, one = np.empty(W + 6, np.float32), np.empty(W + 8, np.float32), np.ones(W, np.float32)
    for y in range(first, end):
        row_sum_7(seen, y, one, wide_7, per_7[y])
        row_sum_square_9(seen, y, f4(1), one, wide_9, per_9[y])
        for x in range(W):
            per_7[y, x] = f4(1) / max(per_7[y, x], f4(1))
            per_9[y, x] = f4(1) / max(per_9[y, x], f4(1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """Which pixels may be looked at, and one over how many of them each window holds; every array (H, W).

    here : 1 or 0.   per_7, per_9 : of the 7 x 7 and the 9 x 9 about each pixel; 1 where there is none.
    """

    here: Float32
    per_7: Float32
    per_9: Float32

    @classmethod
    def where(cls, seen: Bool) -> Seen:
        here = seen.astype(np.float32)
        per_7, per_9 = np.empty_like(here), np.empty_like(here)
        in_pieces(lambda first, end: _counted(first, end, here, per_7, per_9), here.shape[0])
        return cls(here=here, per_7=per_7, per_9=per_9)


@_leaf
def _minus(a, mean, seen, out):
    for x in range(a.size):
        out[x] = (a[x] - mean[x]) * seen[x]


@njit(cache=True, nogil=True, error_model="numpy")
def less_means(first, end, a, b, seen, per, out_a, out_b):
    """Rows of `less_local_means`."""
    W = a.shape[1]
    wide, mean = np.empty(W + 6, np.float32), np.empty(W, np.float32)
    for y in range(first, end):
        row_sum_7(a, y, per[y], wide, mean)
        _minus(a[y], mean, seen[y], out_a[y])
        row_sum_7(b, y, per[y], wide, mean)
        _minus(b[y], mean, seen[y], out_b[y])


def less_local_means(a: Float32, b: Float32, seen: Seen) -> tuple[Float32, Float32]:
    """Two maps, 0 where nothing is `seen`, less their means over what is seen of the 7 x 7 about each pixel; 0 where nothing is."""
    out_a, out_b = np.empty_like(a), np.empty_like(b)
    in_pieces(lambda first, end: less_means(first, end, a, b, seen.here, seen.per_7, out_a, out_b), a.shape[0])
    return out_a, out_b
