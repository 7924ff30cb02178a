"""How a surface bends and leans, pixel by pixel.

In: a disparity (H, W) float32 px.  Out: maps of the same size.  Second differences of `cut` or more are depth edges, which say nothing."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import kernel, log2
from stereorelight.engine.pyramid import double, halve, in_blocks
from stereorelight.engine.turns import shared, together, turns_of

f4 = np.float32
ROWS = 16  # of a block that a thread takes
_leaf = kernel(fastmath=False, noalias=True)  # a row: nothing that it writes overlaps anything else that it is given


@_leaf
def _energy_row(up, me, down, cut, floor, inner, logs, counts):
    """`inner` : 0 on the first row and the last, where bends are not known."""
    W = me.size
    for x in range(1, W - 1):
        xx, yy = me[x - 1] - f4(2) * me[x] + me[x + 1], up[x] - f4(2) * me[x] + down[x]
        xy = me[x] - me[x + 1] - down[x] + down[x + 1]
        known = inner if max(max(abs(xx), abs(yy)), abs(xy)) < cut else f4(0)
        logs[x] = known * f4(np.log(2)) * log2(xx * xx + f4(2) * xy * xy + yy * yy + floor)
        counts[x] = known
    for x in (0, W - 1):
        logs[x], counts[x] = f4(0), f4(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _energy(begin, end, d, cut, floor, logs, counts):
    H = d.shape[0]
    for y in range(begin, end):
        _energy_row(d[max(y - 1, 0)], d[y], d[min(y + 1, H - 1)], cut, floor, f4(0 < y < H - 1), logs[y], counts[y])


def bend_energy(d: Float32, *, cut: float, floor: float = 1e-10) -> tuple[Float32, Float32]:
    """Logarithm of d_xx^2 + 2 d_xy^2 + d_yy^2 per pixel (H, W), px^2, and 1 where it is known: not at edges, where it is 0 and 0."""
    logs, counts = np.empty_like(d), np.empty_like(d)
    in_blocks(lambda begin, end: _energy(begin, end, d, f4(cut), f4(floor), logs, counts), d)
    return logs, counts


@njit(cache=True, nogil=True, error_model="numpy")
def _energies(turns, d, cut, looser, floor, room, out):
    """`bend_energies`, by all threads together.   room : the maps that are made on the way."""
    H, half_h, h, eighth_h = d.shape[0], room[2].shape[0], out.shape[2], room[8].shape[0]
    quarter = f4(0.25)
    logs, counts, half, half_logs, half_counts, shrunk_logs, shrunk_counts, fourth, eighth, eighth_logs, eighth_counts = room
    step = np.int64(0)
    for begin, end in shared(turns, step, H, ROWS):
        _energy(begin, end, d, cut, floor, logs, counts)
    step += 1
    for begin, end in shared(turns, step, half_h, ROWS):
        halve(begin, end, logs, quarter, f4(0), shrunk_logs)
        halve(begin, end, counts, quarter, f4(0), shrunk_counts)
        halve(begin, end, d, quarter, f4(1), half)
    step += 1
    for begin, end in shared(turns, step, half_h, ROWS):
        _energy(begin, end, half, cut * min(f4(2), looser), floor, half_logs, half_counts)
    step += 1
    for begin, end in shared(turns, step, h, ROWS):
        halve(begin, end, shrunk_logs, quarter, f4(0), out[0, 0])
        halve(begin, end, shrunk_counts, quarter, f4(0), out[1, 0])
        halve(begin, end, half_logs, quarter, f4(0), out[0, 1])
        halve(begin, end, half_counts, quarter, f4(0), out[1, 1])
        halve(begin, end, half, quarter, f4(1), fourth)
    step += 1
    for begin, end in shared(turns, step, h, ROWS):
        _energy(begin, end, fourth, cut * min(f4(4), looser), floor, out[0, 2], out[1, 2])
    step += 1
    for begin, end in shared(turns, step, eighth_h, ROWS):
        halve(begin, end, fourth, quarter, f4(1), eighth)
    step += 1
    for begin, end in shared(turns, step, eighth_h, ROWS):
        _energy(begin, end, eighth, cut * min(f4(8), looser), floor, eighth_logs, eighth_counts)
    step += 1
    for begin, end in shared(turns, step, h, ROWS):
        double(begin, end, eighth_logs, f4(0), out[0, 3])
        double(begin, end, eighth_counts, f4(0), out[1, 3])


def bend_energies(d: Float32, *, cut: float, looser: float = 4, floor: float = 1e-10) -> Float32:
    """What `bend_energy` says of `d` and of it at a half, a quarter and an eighth of its size, all on the quarter-size grid: (2, 4, h, w), means
    of the logarithms and of where they are known.

    looser : how many times `cut` a bend may be at most on coarser grids, where those of surfaces are larger.
    """
    h, w = d.shape
    out = np.empty((2, 4, (h + 3) // 4, (w + 3) // 4), np.float32)
    half, fourth = ((h + 1) // 2, (w + 1) // 2), (out.shape[2], out.shape[3])
    eighth = ((fourth[0] + 1) // 2, (fourth[1] + 1) // 2)
    room = tuple(np.empty(size, np.float32) for size in (d.shape, d.shape, half, half, half, half, half, fourth, eighth, eighth, eighth))
    together(_energies, turns_of(8), d, f4(cut), f4(looser), f4(floor), room, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _slope_row(before, me, after, cut, out):
    for x in range(me.size):
        a, b = me[x] - before[x], after[x] - me[x]
        flatter = a if abs(a) < abs(b) else b
        out[x] = f4(0.5) * (a + b) if abs(a - b) < cut else flatter


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(begin, end, d, cut, out_x, out_y):
    H, W = d.shape
    before, after = np.empty(W, np.float32), np.empty(W, np.float32)
    for y in range(begin, end):
        me, up, down = d[y], d[max(y - 1, 0)], d[min(y + 1, H - 1)]
        for x in range(W):
            before[x] = me[x - 1] if x > 0 else f4(2) * me[0] - me[min(1, W - 1)]
            after[x] = me[x + 1] if x < W - 1 else f4(2) * me[W - 1] - me[max(W - 2, 0)]
        _slope_row(before, me, after, cut, out_x[y])
        for x in range(W):
            before[x] = up[x] if y > 0 else f4(2) * me[x] - down[x]
            after[x] = down[x] if y < H - 1 else f4(2) * me[x] - up[x]
        _slope_row(before, me, after, cut, out_y[y])


def slopes(d: Float32, *, cut: float) -> tuple[Float32, Float32]:
    """d/dx and d/dy (H, W): the mean of the differences on either side, or the flatter one where they differ by `cut`, an edge."""
    out_x, out_y = np.empty_like(d), np.empty_like(d)
    in_blocks(lambda begin, end: _slopes(begin, end, d, f4(cut), out_x, out_y), d)
    return out_x, out_y
