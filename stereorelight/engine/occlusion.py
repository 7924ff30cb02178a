"""What one eye sees and the other does not, row by row, from a disparity map.

In: disparity (H, W) float32, x_left - x_right in pixels, finite.  Out: masks and filled disparities of the same size."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.rows import in_pieces

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def _unseen(first, end, disparity, by, out):
    W = disparity.shape[1]
    nearest = np.empty(W + 4, np.float32)  # two places before the row and two after it, for what lands outside
    for y in range(first, end):
        nearest[:] = -np.inf
        for x in range(W):
            d = disparity[y, x]
            k = min(max(int(np.floor(f4(x) - d)), -2), W) + 2
            for i in (k, k + 1):  # a surface covers both pixels that it falls between
                nearest[i] = d if d > nearest[i] else nearest[i]
        for x in range(W):
            d = disparity[y, x]
            k = int(np.floor(f4(x) - d + f4(0.5)))
            out[y, x] = (k < 0) | (k >= W) | (nearest[min(max(k, -2), W) + 2] > d + by)


def unseen(disparity: Float32, *, by_px: float = 1.0) -> Bool:
    """(H, W) bool: pixels that land outside the right eye's frame, or where a surface nearer by more than `by_px` lands too."""
    out = np.empty(disparity.shape, np.bool_)
    in_pieces(lambda first, end: _unseen(first, end, disparity, f4(by_px), out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _behind(first, end, disparity, source, out):
    W = disparity.shape[1]
    before = np.empty(W, np.float32)
    for y in range(first, end):
        last = f4(np.inf)
        for x in range(W):
            if source[y, x]:
                last = disparity[y, x]
            before[x] = last
        last = f4(np.inf)
        for x in range(W - 1, -1, -1):
            if source[y, x]:
                last = disparity[y, x]
            farther = min(before[x], last)
            out[y, x] = farther if farther < f4(np.inf) else disparity[y, x]


def background(disparity: Float32, source: Bool) -> Float32:
    """(H, W) what lies behind each pixel: the farther of the nearest `source` values on either side of it on its row.

    Ground that only one eye sees belongs to what lies behind, so it is never a blend of actor and wall.  A row without
    any source keeps its own values.
    """
    out = np.empty(disparity.shape, np.float32)
    in_pieces(lambda first, end: _behind(first, end, disparity, source, out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _beside(first, end, disparity, out):
    W = disparity.shape[1]
    before = np.empty(W, np.float32)
    for y in range(first, end):
        last = f4(np.inf)
        for x in range(W):
            d = disparity[y, x]
            last = d if d == d else last
            before[x] = last
        last = f4(np.inf)
        for x in range(W - 1, -1, -1):
            d = disparity[y, x]
            last = d if d == d else last
            farther = min(before[x], last)
            out[y, x] = farther if farther < f4(np.inf) else f4(0)


def beside(disparity: Float32) -> Float32:
    """`background` of a disparity that is NaN where it is no source; 0 on a row without any."""
    out = np.empty(disparity.shape, np.float32)
    in_pieces(lambda first, end: _beside(first, end, disparity, out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _completed(first, end, disparity, other, out):
    for y in range(first, end):
        for x in range(out.shape[1]):
            out[y, x] = disparity[y, x] if disparity[y, x] == disparity[y, x] else other[y, x]


def completed(disparity: Float32, other: Float32) -> Float32:
    """`disparity`, and `other` where it is NaN."""
    out = np.empty(disparity.shape, np.float32)
    in_pieces(lambda first, end: _completed(first, end, disparity, other, out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _lands(first, end, disparity, known, out):
    W = disparity.shape[1]
    for y in range(first, end):
        for x in range(W):
            k = int(np.floor(f4(x) - disparity[y, x] + f4(0.5)))
            out[y, x] = 0 <= k < W and known[y, k]


def lands_on_plate(disparity: Float32, right_known: Bool) -> Bool:
    """(H, W) bool: what is seen there lies within the right eye's plate, where that is known."""
    out = np.empty(disparity.shape, np.bool_)
    in_pieces(lambda first, end: _lands(first, end, disparity, right_known, out), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _consistent(first, end, left, right, within, out):
    W = left.shape[1]
    for y in range(first, end):
        for x in range(W):
            d = left[y, x]
            out[y, x] = False
            if d == d:
                k = int(np.floor(f4(x) - d + f4(0.5)))
                if 0 <= k < W:
                    out[y, x] = abs(d - right[y, k]) <= within  # false for NaN


def consistent(left_px: Float32, right_px: Float32, *, within_px: float = 1.0) -> Bool:
    """(H, W) bool: the right eye's disparity, looked up where the left pixel lands, says the same to `within_px`."""
    out = np.empty(left_px.shape, np.bool_)
    in_pieces(lambda first, end: _consistent(first, end, left_px, right_px, f4(within_px), out), left_px.shape[0])
    return out
