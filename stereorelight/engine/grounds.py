"""Plain ground and its planes: where it is, what a plane says of it, and what of that the other eye is told.

In: pictures, labels (H, W) int32, planes and disparities, px.  Out: maps of the same size."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.rows import in_pieces

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def _level(first, end, picture, most2, out):
    H, W, channels = picture.shape
    for y in range(first, end):
        above, below = picture[max(y - 1, 0)], picture[min(y + 1, H - 1)]
        row = picture[y]
        for x in range(W):
            a, b = max(x - 1, 0), min(x + 1, W - 1)
            steepest = f4(0)
            for c in range(channels):
                across = (above[b, c] - above[a, c]) + f4(2) * (row[b, c] - row[a, c]) + (below[b, c] - below[a, c])
                down = (below[a, c] - above[a, c]) + f4(2) * (below[x, c] - above[x, c]) + (below[b, c] - above[b, c])
                steepest = max(steepest, across * across + down * down)
            out[y, x] = steepest < most2


def level(picture: Float32, most: float) -> Bool:
    """(H, W) bool: no channel of a picture (H, W, C) changes by `most` or more per px, by Sobel's mask."""
    out = np.empty(picture.shape[:2], np.bool_)
    in_pieces(lambda first, end: _level(first, end, picture, f4(64 * most**2), out), picture.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _planar(first, end, label, planes, disparity, out):
    for y in range(first, end):
        for x in range(label.shape[1]):
            k = label[y, x]
            d = planes[k, 0] * f4(x) + planes[k, 1] * f4(y) + planes[k, 2]
            out[y, x] = d if d == d else disparity[y, x]


def planar(label: np.ndarray, planes: Float32, disparity: Float32) -> Float32:
    """`disparity`, but a x + b y + c where the label of a pixel has a plane (a, b, c).

    label : (H, W) int32.   planes : (n, 3), a row of NaN where a label has none.
    """
    out = np.empty(disparity.shape, np.float32)
    in_pieces(lambda first, end: _planar(first, end, label, planes, disparity, out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _told(first, end, disparity, where, out):
    W = disparity.shape[1]
    nearest = np.empty(W, np.float32)
    for y in range(first, end):
        nearest[:] = -np.inf
        for x in range(W):
            d = disparity[y, x]
            if where[y, x] and d == d:
                k = int(np.floor(f4(x) - d + f4(0.5)))
                if 0 <= k < W and d > nearest[k]:
                    nearest[k] = d
        for k in range(W):
            if nearest[k] > -np.inf:
                out[y, k] = nearest[k]


def told_other(right: Float32, disparity: Float32, where: Bool) -> Float32:
    """The right eye's disparity with what the left eye's says `where` (H, W) it was changed, at the pixels that these land on."""
    out = right.copy()
    in_pieces(lambda first, end: _told(first, end, disparity, where, out), right.shape[0])
    return out
