"""Means over square windows, for kernels that go on with them row by row; beyond the frame the picture is mirrored, its border not repeated.

In: maps (H, W) float32.  Out: rows (W,) float32.  Every sum has the same order whatever the rows that are shared out together."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import kernel
from stereorelight.engine.rows import in_row_blocks

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
def _across_7(a, out):
    for x in range(out.size):
        out[x] = f4(1 / 49) * (((a[x] + a[x + 1]) + (a[x + 2] + a[x + 3])) + ((a[x + 4] + a[x + 5]) + a[x + 6]))


@_leaf
def _across_9(a, out):
    for x in range(out.size):
        p, q = (a[x] + a[x + 1]) + (a[x + 2] + a[x + 3]), (a[x + 4] + a[x + 5]) + (a[x + 6] + a[x + 7])
        out[x] = f4(1 / 81) * ((p + q) + a[x + 8])


@njit(cache=True, nogil=True, error_model="numpy")
def row_mean_7(a, y, wide, out):
    """Mean of the 7 x 7 about each pixel of row y; `wide` is W + 6 places to work in."""
    H, W = a.shape
    r = a[mirrored(y - 3, H)], a[mirrored(y - 2, H)], a[mirrored(y - 1, H)], a[mirrored(y + 1, H)], a[mirrored(y + 2, H)], a[mirrored(y + 3, H)]
    _sum_7(r[0], r[1], r[2], a[y], r[3], r[4], r[5], wide[3 : 3 + W])
    _mirror_ends(wide, 3)
    _across_7(wide, out)


@njit(cache=True, nogil=True, error_model="numpy")
def row_mean_square_9(a, y, cap, wide, out):
    """Mean over the 9 x 9 about each pixel of row y of the square, or of `cap` where that is less; `wide` is W + 8 places to work in."""
    H, W = a.shape
    r = a[mirrored(y - 4, H)], a[mirrored(y - 3, H)], a[mirrored(y - 2, H)], a[mirrored(y - 1, H)]
    s = a[mirrored(y + 1, H)], a[mirrored(y + 2, H)], a[mirrored(y + 3, H)], a[mirrored(y + 4, H)]
    _sum_squares_9(r[0], r[1], r[2], r[3], a[y], s[0], s[1], s[2], s[3], cap, wide[4 : 4 + W])
    _mirror_ends(wide, 4)
    _across_9(wide, out)


@_leaf
def _minus(a, mean, out):
    for x in range(a.size):
        out[x] = a[x] - mean[x]


@_leaf
def _minus_where(a, mean, trust, least, out):
    for x in range(a.size):
        out[x] = a[x] - mean[x] if trust[x] > least else f4(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _less_means(first, end, a, b, trust, least, out_a, out_b):
    W = a.shape[1]
    wide, mean = np.empty(W + 6, np.float32), np.empty(W, np.float32)
    for y in range(first, end):
        row_mean_7(a, y, wide, mean)
        _minus(a[y], mean, out_a[y])
        row_mean_7(b, y, wide, mean)
        _minus_where(b[y], mean, trust[y], least, out_b[y])


def less_local_means(a: Float32, b: Float32, trust: Float32, *, least: float) -> tuple[Float32, Float32]:
    """Two maps less their means over 7 x 7; the second is 0 where `trust` is `least` or less."""
    out_a, out_b = np.empty_like(a), np.empty_like(b)
    in_row_blocks(lambda first, end: _less_means(first, end, a, b, trust, f4(least), out_a, out_b), a.shape[0])
    return out_a, out_b
