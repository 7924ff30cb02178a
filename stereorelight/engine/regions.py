"""Regions of a disparity that hang together, and what each of their places would cost at every other disparity.

In: a disparity (H, W) float32 on a grid of places, NaN where unknown; two rectified pictures in grey, rows agreeing.  Out: labels, and costs."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, Int32

f4 = np.float32
PARTS = 4  # of a pixel, in which disparities are tried
WINDOW = 3  # px either way of a place that is compared
ABOUT = 3  # parts of a pixel either way: of them the best speaks for a whole-pixel shift


@njit(cache=True, nogil=True)
def _regions(disparity, step, label, stack):
    H, W = disparity.shape
    count = 0
    for start in range(H * W):
        y, x = start // W, start % W
        if label[y, x] >= 0 or disparity[y, x] != disparity[y, x]:
            continue
        label[y, x], stack[0], left = count, start, 1
        while left > 0:
            left -= 1
            y, x = stack[left] // W, stack[left] % W
            for side in range(4):
                v, u = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
                if 0 <= v < H and 0 <= u < W and label[v, u] < 0 and abs(disparity[v, u] - disparity[y, x]) <= step:
                    label[v, u], stack[left] = count, v * W + u
                    left += 1
        count += 1
    return count


def regions(disparity: Float32, *, step: float) -> tuple[Int32, int]:
    """(H, W) int32 labels from 0, -1 where `disparity` is NaN, and how many there are: neighbours within `step` px lie in one region."""
    label = np.full(disparity.shape, -1, np.int32)
    return label, int(_regions(disparity, f4(step), label, np.empty(disparity.size, np.int32)))


@njit(cache=True, nogil=True, error_model="numpy")
def _between(row, first, part, out):
    """The row at the columns first + k - part / PARTS, by Catmull and Rom's cubic; as at its ends beyond them."""
    last = row.size - 1
    t = f4(1) - f4(part) / f4(PARTS)
    a, b = f4(-0.5) * t * (f4(1) - t) ** 2, f4(1) + t * t * (f4(1.5) * t - f4(2.5))
    c, d = t * (f4(0.5) + t * (f4(2) - f4(1.5) * t)), f4(0.5) * t * t * (t - f4(1))
    for k in range(out.size):
        j = first + k
        if 2 <= j < last:
            out[k] = a * row[j - 2] + b * row[j - 1] + c * row[j] + d * row[j + 1]
        else:
            p, q, r, s = min(max(j - 2, 0), last), min(max(j - 1, 0), last), min(max(j, 0), last), min(max(j + 1, 0), last)
            out[k] = a * row[p] + b * row[q] + c * row[r] + d * row[s]


@njit(cache=True, nogil=True, error_model="numpy")
def _costs(left, right, y, x, low, cost, room):
    """cost[part, i]: variance of what is left between the eyes about (y, x) at the disparity low + i + part / PARTS; inf where that leaves the
    frame."""
    shifted, total, squares = room
    last, count = right.shape[1] - 1, cost.shape[1]
    n = f4((2 * WINDOW + 1) ** 2)
    for part in range(PARTS):
        total[:], squares[:] = f4(0), f4(0)
        for v in range(y - WINDOW, y + WINDOW + 1):
            _between(right[v], x - low - count - WINDOW + 1, part, shifted)  # the last of `count` disparities first
            for u in range(2 * WINDOW + 1):
                here, there = left[v, x - WINDOW + u], shifted[u : u + count]
                for i in range(count):
                    off = here - there[i]
                    total[i] += off
                    squares[i] += off * off
        for i in range(count):
            k = count - 1 - i
            place = f4(x - low - i) - f4(part) / f4(PARTS)
            inside = place >= WINDOW and place + WINDOW <= last
            cost[part, i] = max((squares[k] - total[k] * total[k] / n) / n, f4(0)) if inside else f4(np.inf)


@njit(cache=True, nogil=True, error_model="numpy")
def _about(cost, at):
    """The least cost within `ABOUT` parts of a pixel of `at`, in parts of a pixel from the first, by the parabola through three of them."""
    least, best = f4(np.inf), -1
    for j in range(max(at - ABOUT, 0), min(at + ABOUT + 1, cost.size)):
        value = cost[j % PARTS, j // PARTS]
        if value < least:
            least, best = value, j
    if 0 < best < cost.size - 1:
        before, after = cost[(best - 1) % PARTS, (best - 1) // PARTS], cost[(best + 1) % PARTS, (best + 1) // PARTS]
        bend = before - f4(2) * least + after
        if f4(0) < bend < f4(np.inf) and before >= least and after >= least:
            least = max(least - (before - after) ** 2 / (f4(8) * bend), f4(0))
    return least


@njit(cache=True, nogil=True)
def _room(count):
    return np.empty(count + 2 * WINDOW, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _shifted(left, right, ys, xs, disparity, low, count, out):
    cost, room = np.empty((PARTS, count), np.float32), _room(count)
    most = out.shape[1] // 2
    for i in range(ys.size):
        _costs(left, right, ys[i], xs[i], low, cost, room)
        here = int(np.rint((disparity[i] - f4(low)) * f4(PARTS)))
        for k in range(-most, most + 1):
            out[i, most + k] = _about(cost, here + PARTS * k)


@njit(cache=True, nogil=True, error_model="numpy")
def _nearby(left, right, ys, xs, disparity, out):
    count = 2 * (ABOUT // PARTS + 2)
    cost, room = np.empty((PARTS, count), np.float32), _room(count)
    for i in range(ys.size):
        out[i] = f4(np.inf)
        if disparity[i] == disparity[i]:
            low = int(np.floor(disparity[i])) - count // 2
            _costs(left, right, ys[i], xs[i], low, cost, room)
            out[i] = _about(cost, int(np.rint((disparity[i] - f4(low)) * f4(PARTS))))


def costs_at(left: Float32, right: Float32, ys: Int32, xs: Int32, disparity: Float32) -> Float32:
    """(n,): what each place costs at `disparity`, or within `ABOUT` parts of a pixel of it; inf where that leaves the frame or is NaN."""
    out = np.empty(ys.size, np.float32)
    _nearby(left, right, ys, xs, disparity, out)
    return out


def shifted_costs(left: Float32, right: Float32, ys: Int32, xs: Int32, disparity: Float32, low: int, count: int) -> Float32:
    """(n, 2 count - 1): what each place costs with its disparity more by 1 - count, ..., 0, ..., count - 1 px, the best within `ABOUT` parts of a
    pixel; inf where that lies outside low <= d < low + count or leaves the frame.

    left, right : (H, W) grey.   ys, xs, disparity : (n,) places on the left picture, `WINDOW` px and more from its borders, and what was matched
                  there.
    The cost is the variance of what is left between the eyes about the place: a shift of whole pixels, rounded, is compared at its best parts
    of a pixel, so that none is better for falling on whole ones.
    """
    out = np.empty((ys.size, 2 * count - 1), np.float32)
    _shifted(left, right, ys, xs, disparity, low, count, out)
    return out
