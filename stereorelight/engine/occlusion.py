"""What one eye sees and the other does not, row by row, from a disparity map.

In: disparity (H, W) float32, x_left - x_right in pixels, finite.  Out: masks and filled disparities of the same size."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.rows import in_pieces

f4 = np.float32
STEP_PX = f4(1)  # between neighbours of one surface, and a steep one by this more per px
STEEPEST = f4(0.3)
FEWEST = 10  # columns that a line is fitted to
FARTHEST = f4(8)  # of what part of the width the first source may lie within the other eye's frame


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
def _borders(disparity, source, reach, start, level, slope):
    """Of each row: its first source, and the line through the sources that go on from there without a step."""
    H, W = disparity.shape
    for y in range(H):
        start[y], slope[y] = 0, f4(np.nan)
        while start[y] < W and not source[y, start[y]]:
            start[y] += 1
        if start[y] == 0 or start[y] == W:
            start[y] = 0
            continue
        b = start[y]
        before, n, u, d, uu, ud = b, f4(0), f4(0), f4(0), f4(0), f4(0)
        for x in range(b, min(b + min(max(b, FEWEST), reach), W)):
            if not source[y, x]:
                continue
            if abs(disparity[y, x] - disparity[y, before]) > STEP_PX + STEEPEST * f4(x - before):
                break
            before, k, value = x, f4(x - b), disparity[y, x]
            n, u, d, uu, ud = n + f4(1), u + k, d + value, uu + k * k, ud + k * value
        if n >= FEWEST:
            steep = (n * ud - u * d) / (n * uu - u * u)
            level[y] = (d - steep * u) / n
            if f4(b) - level[y] <= f4(W) / FARTHEST:  # it lies there in the other eye's frame
                slope[y] = steep


@njit(cache=True, nogil=True, error_model="numpy")
def _continued(start, level, slope, rows, out):
    H = out.shape[0]
    slopes, levels = np.empty(2 * rows + 1, np.float32), np.empty(2 * rows + 1, np.float32)
    for y in range(H):
        if slope[y] != slope[y]:
            continue
        m, reach = 0, min(rows, y, H - 1 - y)  # as many above as below, since the ground may slope that way, too
        for z in range(y - reach, y + reach + 1):
            there = level[z] + slope[z] * f4(start[y] - start[z])
            if abs(there - level[y]) <= STEP_PX + f4(0.5):  # another surface has no say, nor has a row without a line
                slopes[m], levels[m] = slope[z], there
                m += 1
        if 2 * m > reach:
            steep, here = min(max(np.median(slopes[:m]), -STEEPEST), STEEPEST), np.median(levels[:m])
            for x in range(start[y]):
                out[y, x] = here + steep * f4(x - start[y])


def continued(behind: Float32, disparity: Float32, source: Bool, *, reach: int = 64, rows: int = 8) -> Float32:
    """`behind`, but before each row's first `source` the line on which the sources after it lie: ground beyond the other eye's frame goes on as it
    slopes.

    The line is fitted to as many columns as it is to go on for, `reach` at most, up to a step; its slope is the median of those of the rows
    about it that lie on the same surface, `rows` either way.  Where there is no such line, nothing changes; nor where the first source lies more
    than an eighth of the width within the other eye's frame, too far to go on from.
    """
    H = disparity.shape[0]
    start, level, slope = np.zeros(H, np.int32), np.zeros(H, np.float32), np.empty(H, np.float32)
    _borders(disparity, source, reach, start, level, slope)
    out = behind.copy()
    _continued(start, level, slope, rows, out)
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
