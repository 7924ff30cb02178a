"""Depth edges put on picture edges: each doubtful pixel joins the surface beside it that looks like it.

In: disparity (H, W) px, a zone of doubtful pixels about jumps, and the picture (H, W, 3) uint8.  Out: disparity (H, W)."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.support_vector import PLACES, weighted_median

f4 = np.float32
i4 = np.int32


@njit(cache=True, nogil=True, error_model="numpy")
def _joined(first, end, disparity, zone, picture, radius, jump, decay, decisive, out):
    H, W = disparity.shape
    for y in range(first, end):
        for x in range(W):
            d = disparity[y, x]
            out[y, x] = d
            if not zone[y, x]:
                continue
            y0, y1, x0, x1 = y - radius, y + radius + 1, x - radius, x + radius + 1
            y0, x0 = y0 if y0 >= 0 else y & 1, x0 if x0 >= 0 else x & 1
            y1, x1 = min(y1, H), min(x1, W)
            low, high = f4(np.inf), f4(-np.inf)
            for j in range(y0, y1, 2):
                for i in range(x0, x1, 2):
                    if not zone[j, i]:
                        low, high = min(low, disparity[j, i]), max(high, disparity[j, i])
            if not high - low > jump:  # one surface, or nothing to join
                continue
            middle = f4(0.5) * (low + high)
            far_weight, far_sum, near_weight, near_sum = f4(0), f4(0), f4(0), f4(0)
            b, g, r = f4(picture[y, x, 0]), f4(picture[y, x, 1]), f4(picture[y, x, 2])
            for j in range(y0, y1, 2):
                for i in range(x0, x1, 2):
                    if zone[j, i]:
                        continue
                    other = (abs(f4(picture[j, i, 0]) - b) + abs(f4(picture[j, i, 1]) - g) + abs(f4(picture[j, i, 2]) - r)) * decay
                    apart = f4((j - y) * (j - y) + (i - x) * (i - x))
                    weight = f4(1) / ((f4(1) + other * other) * (f4(1) + apart))
                    if disparity[j, i] < middle:
                        far_weight += weight
                        far_sum += weight * disparity[j, i]
                    else:
                        near_weight += weight
                        near_sum += weight * disparity[j, i]
            to_near = d >= middle
            if near_weight > decisive * far_weight:
                to_near = True
            elif far_weight > decisive * near_weight:
                to_near = False
            side_weight, side_sum = (near_weight, near_sum) if to_near else (far_weight, far_sum)
            # A pixel that lies on its side already keeps its own value: only ramps and strays move.
            if side_weight > f4(0) and abs(d - side_sum / side_weight) > jump:
                out[y, x] = side_sum / side_weight


def joined_to_sides(
    disparity: Float32, zone: Bool, picture: UInt8, *, radius_px: int = 6, jump_px: float = 1.5, tone_levels: float = 16.0, decisive: float = 4.0
) -> Float32:
    """Every pixel of `zone` takes the disparity of the near or the far side about it, never one between.

    The side that looks like the pixel wins where it does so by `decisive`; else the pixel keeps the side that it leaned to.
    radius_px   : even; how far to look for the two sides, every other pixel.
    tone_levels : difference of tone, grey levels, at which likeness falls to a half.
    """
    out = np.empty_like(disparity)
    given = (disparity, zone, picture, radius_px, f4(jump_px), f4(1 / (3 * tone_levels)), f4(decisive), out)
    in_row_blocks(lambda first, end: _joined(first, end, *given), disparity.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _two_sides(first, end, disparity, zone, ramp, low, high, picture, radius, jump, decay, near, far, likeness):
    H, W = disparity.shape
    for y in range(first, end):
        for x in range(W):
            near[y, x] = far[y, x] = np.nan
            likeness[y, x] = f4(0)
            if not zone[y, x] or not high[y, x] - low[y, x] > jump:  # one surface, or nothing to join
                continue
            y0, y1, x0, x1 = y - radius, min(y + radius + 1, H), x - radius, min(x + radius + 1, W)
            y0, x0 = y0 if y0 >= 0 else y & 1, x0 if x0 >= 0 else x & 1
            middle = f4(0.5) * (low[y, x] + high[y, x])
            far_weight, far_sum, near_weight, near_sum = f4(0), f4(0), f4(0), f4(0)
            b, g, r = f4(picture[y, x, 0]), f4(picture[y, x, 1]), f4(picture[y, x, 2])
            for j in range(y0, y1, 2):
                for i in range(x0, x1, 2):
                    if ramp[j, i] or (j == y and i == x):  # no pixel speaks for itself
                        continue
                    other = (abs(f4(picture[j, i, 0]) - b) + abs(f4(picture[j, i, 1]) - g) + abs(f4(picture[j, i, 2]) - r)) * decay
                    apart = f4((j - y) * (j - y) + (i - x) * (i - x))
                    weight = f4(1) / ((f4(1) + other * other) * (f4(1) + apart))
                    if disparity[j, i] < middle:
                        far_weight += weight
                        far_sum += weight * disparity[j, i]
                    else:
                        near_weight += weight
                        near_sum += weight * disparity[j, i]
            if near_weight > f4(0) and far_weight > f4(0):
                near[y, x], far[y, x] = near_sum / near_weight, far_sum / far_weight
                likeness[y, x] = np.log(near_weight / far_weight)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _unlike(row, other, steep, other_steep, x, d, cap, W):
    """Difference of colour and of horizontal slope between a pixel of one row and where it lands on the other, each up to `cap`."""
    u = min(max(f4(x) - d, f4(0)), f4(W - 1))
    k = int(u)
    t, n = u - f4(k), min(k + 1, W - 1)
    colour = f4(0)
    for c in range(3):
        a, b = f4(other[k, c]), f4(other[n, c])
        colour += abs(f4(row[x, c]) - (a + t * (b - a)))
    slope = abs(steep[x] - (other_steep[k] + t * (other_steep[n] - other_steep[k])))
    return min(colour * f4(1 / 3), cap) + min(slope, cap)


@njit(cache=True, nogil=True, error_model="numpy")
def _preference(first, end, disparity, near, far, left, right, left_steep, right_steep, cap, out):
    W = disparity.shape[1]
    front = np.empty(W, np.float32)
    for y in range(first, end):
        front[:] = -np.inf
        for x in range(W):
            k = int(np.floor(f4(x) - disparity[y, x] + f4(0.5)))
            if 0 <= k < W and disparity[y, x] > front[k]:
                front[k] = disparity[y, x]
        for x in range(W):
            out[y, x] = f4(0)
            if near[y, x] != near[y, x]:
                continue
            k = int(np.floor(f4(x) - far[y, x] + f4(0.5)))
            # Ground that the other eye cannot see looks like nothing there: that is no evidence against it.
            hidden = k < 0 or k >= W or front[k] > far[y, x] + f4(1)
            a = _unlike(left[y], right[y], left_steep[y], right_steep[y], x, near[y, x], cap, W)
            b = _unlike(left[y], right[y], left_steep[y], right_steep[y], x, far[y, x], cap, W)
            out[y, x] = min(b - a, f4(0)) if hidden else b - a


@njit(cache=True, nogil=True, error_model="numpy")
def _sided(first, end, disparity, near, far, likeness, preference, picture, decay, space, radius, gain, lean, jump, out):
    H, W = disparity.shape
    for y in range(first, end):
        for x in range(W):
            d = disparity[y, x]
            out[y, x] = d
            if near[y, x] != near[y, x]:
                continue
            b, g, r = f4(picture[y, x, 0]), f4(picture[y, x, 1]), f4(picture[y, x, 2])
            total = f4(0)
            for j in range(y - radius if y >= radius else y & 1, min(y + radius + 1, H), 2):
                for i in range(x - radius if x >= radius else x & 1, min(x + radius + 1, W), 2):
                    if preference[j, i] == f4(0):
                        continue
                    other = (abs(f4(picture[j, i, 0]) - b) + abs(f4(picture[j, i, 1]) - g) + abs(f4(picture[j, i, 2]) - r)) * decay
                    total += preference[j, i] / (f4(1) + other * other) * space[j - y + radius, i - x + radius]
            to_near = d >= f4(0.5) * (near[y, x] + far[y, x])
            score = gain * total + likeness[y, x] + (lean if to_near else -lean)
            side = near[y, x] if score > f4(0) else far[y, x]
            # A pixel that lies on its side already keeps its own value.
            if abs(d - side) > jump:
                out[y, x] = side


def weighed_sides(
    disparity: Float32,
    zone: Bool,
    ramp: Bool,
    low: Float32,
    high: Float32,
    left: UInt8,
    right: UInt8,
    left_steep: Float32,
    right_steep: Float32,
    *,
    radius_px: int = 6,
    jump_px: float = 1.5,
    tone_levels: float = 8.0,
    cap_levels: float = 15.0,
    gain: float = 0.1,
    lean: float = 0.5,
) -> Float32:
    """Every pixel of `zone` takes the side of the edge that both pictures speak for, never a value between.

    Three things vote, as logarithms of odds: how much the pixel looks like either side's pixels (as in `joined_to_sides`); which of the
    two disparities makes the other eye look alike, summed over neighbours of the pixel's own colour; and the side it leaned to.
    ramp            : pixels on the step itself, which belong to no side.   low, high: (H, W) least and greatest disparity within
                      `radius_px` of all others.
    left, right     : (H, W, 3) pictures; left_steep, right_steep: (H, W) their horizontal slope, grey levels a pixel.
    radius_px       : even; how far to look for the two sides.   tone_levels: as in `joined_to_sides`.
    cap_levels      : a difference larger than this is a difference.   gain: odds per grey level.   lean: odds of the side it leaned to.
    """
    near, far, likeness, preference, out = (np.empty_like(disparity) for _ in range(5))
    decay = f4(1 / (3 * tone_levels))
    half = 4
    square = (np.arange(-half, half + 1) ** 2)[:, None] + np.arange(-half, half + 1) ** 2
    space = np.exp(-2 * square / half**2).astype(np.float32)
    rows = disparity.shape[0]
    sides = (near, far)
    in_row_blocks(lambda a, b: _two_sides(a, b, disparity, zone, ramp, low, high, left, radius_px, f4(jump_px), decay, *sides, likeness), rows)
    in_row_blocks(lambda a, b: _preference(a, b, disparity, *sides, left, right, left_steep, right_steep, f4(cap_levels), preference), rows)
    tuning = (decay, space, half, f4(gain), f4(lean), f4(jump_px))
    in_row_blocks(lambda a, b: _sided(a, b, disparity, *sides, likeness, preference, left, *tuning, out), rows)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _outlines(first, end, disparity, where, picture, weights, out):
    H, W = disparity.shape
    values, shares = np.empty(PLACES, np.float32), np.empty(PLACES, np.float32)  # 25 of them used
    for y in range(first, end):
        for x in range(W):
            out[y, x] = disparity[y, x]
            if not where[y, x]:
                continue
            values[:], shares[:] = f4(np.inf), f4(0)
            n, total = 0, f4(0)
            b, g, r = i4(picture[y, x, 0]), i4(picture[y, x, 1]), i4(picture[y, x, 2])
            for j in range(max(y - 2, 0), min(y + 3, H)):
                for i in range(max(x - 2, 0), min(x + 3, W)):
                    apart = max(abs(i4(picture[j, i, 0]) - b), max(abs(i4(picture[j, i, 1]) - g), abs(i4(picture[j, i, 2]) - r)))
                    values[n], shares[n] = disparity[j, i], weights[apart]
                    total += shares[n]
                    n += 1
            out[y, x] = weighted_median(values, shares, f4(0.5) * total)


def outlined(disparity: Float32, where: Bool, picture: UInt8, *, tone_levels: float = 12.0) -> Float32:
    """Each pixel of `where` takes the median of the 5 x 5 about it, those that look like it counting most: an outline becomes a line,
    and a thin thing of its own colour stays.

    tone_levels : difference of colour, grey levels of the channel that differs most, at which a neighbour counts 1/e.
    """
    weights = np.exp(-np.arange(256, dtype=np.float32) / np.float32(tone_levels))
    out = np.empty_like(disparity)
    in_row_blocks(lambda first, end: _outlines(first, end, disparity, where, picture, weights, out), disparity.shape[0])
    return out
