"""The smoothest surface that agrees with scattered evidence: a thin plate per surface, cut at depth edges.

In: a disparity (H, W) px, the weight (inverse variance, 1/px^2) of what is known per pixel, weight times (what is known
minus the disparity), and the bend (px/px^2) that surfaces are expected to have.  Out: the correction (H, W) px.
It minimises the sum of weight (d - known)^2 + (d_xx^2 + 2 d_xy^2 + d_yy^2) / bend^2, so the width over which evidence is
averaged follows from the evidence itself, (bend^2 weight)^(-1/4) px: small where there is much, wide where there is little.
Second differences larger than `cut` are depth edges and bind nothing.  Solved from coarse to fine (each level half the
size of the one before) by conjugate gradients with the diagonal as preconditioner.  All sums have a fixed order: the same
bits come whatever the number of threads."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import kernel, log2
from stereorelight.engine.pyramid import carried_up, halved, in_blocks

f4 = np.float32
LOOSER = 4  # how much larger a bend may be on a coarse grid before it counts as an edge: bends grow by 4 a level, steps do not


_leaf = kernel(fastmath=False, noalias=True)  # a row: nothing that it writes overlaps anything else that it is given


@_leaf
def _bend_row(up, me, down, lx, ly, lxy, qx, qy, qxy):
    """The bends of a row, each times its stiffness; the links are 0 where there is none."""
    W = me.size
    for x in range(1, W - 1):
        qx[x] = lx[x] * (me[x - 1] - f4(2) * me[x] + me[x + 1])
        qy[x] = ly[x] * (up[x] - f4(2) * me[x] + down[x])
        qxy[x] = f4(2) * lxy[x] * (me[x] - me[x + 1] - down[x] + down[x + 1])
    qx[0], qx[W - 1] = f4(0), f4(0)
    for x in (0, W - 1):
        qy[x] = ly[x] * (up[x] - f4(2) * me[x] + down[x])
    qxy[0] = f4(2) * lxy[0] * (me[0] - me[min(1, W - 1)] - down[0] + down[min(1, W - 1)])
    qxy[W - 1] = f4(0)


@_leaf
def _back_row(w, u, qx, above, qy, below, crossed, qxy, out):
    """Row of the plate's force: the adjoint of the second differences, plus weight times u."""
    W = u.size
    for x in range(1, W - 1):
        bent = qx[x - 1] - f4(2) * qx[x] + qx[x + 1] + (above[x] - f4(2) * qy[x] + below[x])
        out[x] = w[x] * u[x] + bent + (qxy[x] - qxy[x - 1] - crossed[x] + crossed[x - 1])
    out[0] = w[0] * u[0] - f4(2) * qx[0] + qx[min(1, W - 1)] + (above[0] - f4(2) * qy[0] + below[0]) + qxy[0] - crossed[0]
    e, i = W - 1, max(W - 2, 0)
    out[e] = w[e] * u[e] + qx[i] - f4(2) * qx[e] + (above[e] - f4(2) * qy[e] + below[e]) + (qxy[e] - qxy[i] - crossed[e] + crossed[i])


@_leaf
def _back(me, w, u, ring, nothing, out):
    """Row `me` of the plate's force and weight times u; `ring` (3, 3, W) holds the bends of the rows about it by row modulo 3."""
    H = w.shape[0]
    i, j, k = (me + 2) % 3, me % 3, (me + 1) % 3
    above, crossed = (ring[1, i], ring[2, i]) if me > 0 else (nothing, nothing)
    below = ring[1, k] if me < H - 1 else nothing
    _back_row(w[me], u, ring[0, j], above, ring[1, j], below, crossed, ring[2, j], out)


@_leaf
def _direction_row(inverse, r, beta, before, out):
    for x in range(r.size):
        out[x] = inverse[x] * r[x] + beta * before[x]


@_leaf
def _product_row(a, b, total):
    for x in range(a.size):
        total[x] += a[x] * b[x]


@_leaf
def _sum(total):
    s = 0.0
    for x in range(total.size):
        s += np.float64(total[x])
    return s


@njit(cache=True, nogil=True, error_model="numpy")
def _push(begin, end, beta, inverse, r, before, w, lx, ly, lxy, p, force, dots):
    """The next direction, p = inverse r + beta before, what it meets, weight p plus the plate's force on p, and their product.

    A few rows at a time: the direction, its bends, and what they do to the row between.
    """
    H, W = r.shape
    rows, ring, nothing = np.empty((4, W), np.float32), np.empty((3, 3, W), np.float32), np.zeros(W, np.float32)
    total = np.zeros(W, np.float32)
    known = max(begin - 2, 0)  # rows of the direction before this one are known
    for y in range(max(begin - 1, 0), min(end, H - 1) + 1):
        while known <= min(y + 1, H - 1):
            _direction_row(inverse[known], r[known], beta, before[known], rows[known % 4])
            if begin <= known < end:
                p[known] = rows[known % 4]
            known += 1
        up, down, k = max(y - 1, 0) % 4, min(y + 1, H - 1) % 4, y % 3
        _bend_row(rows[up], rows[y % 4], rows[down], lx[y], ly[y], lxy[y], ring[0, k], ring[1, k], ring[2, k])
        me = y - 1
        if begin <= me < end:
            _back(me, w, rows[me % 4], ring, nothing, force[me])
            _product_row(rows[me % 4], force[me], total)
    if end == H:
        _back(H - 1, w, rows[(H - 1) % 4], ring, nothing, force[H - 1])
        _product_row(rows[(H - 1) % 4], force[H - 1], total)
    dots[begin] = _sum(total)


@_leaf
def _sum_row(a, b, out):
    for x in range(a.size):
        out[x] = a[x] + b[x]


@_leaf
def _left_row(pull, force, inverse, r, total):
    for x in range(r.size):
        r[x] = pull[x] - force[x]
        total[x] += inverse[x] * r[x] * r[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _begin(begin, end, d, u, pull, w, lx, ly, lxy, inverse, r, dots):
    """What is left to do: r = pull - weight u - the plate's force on d + u; and the sum of inverse r r."""
    H, W = r.shape
    rows, ring, nothing = np.empty((4, W), np.float32), np.empty((3, 3, W), np.float32), np.zeros(W, np.float32)
    force, total = np.empty(W, np.float32), np.zeros(W, np.float32)
    known = max(begin - 2, 0)
    for y in range(max(begin - 1, 0), min(end, H - 1) + 1):
        while known <= min(y + 1, H - 1):
            _sum_row(d[known], u[known], rows[known % 4])
            known += 1
        up, down, k = max(y - 1, 0) % 4, min(y + 1, H - 1) % 4, y % 3
        _bend_row(rows[up], rows[y % 4], rows[down], lx[y], ly[y], lxy[y], ring[0, k], ring[1, k], ring[2, k])
        me = y - 1
        if begin <= me < end:
            _back(me, w, u[me], ring, nothing, force)
            _left_row(pull[me], force, inverse[me], r[me], total)
    if end == H:
        _back(H - 1, w, u[H - 1], ring, nothing, force)
        _left_row(pull[H - 1], force, inverse[H - 1], r[H - 1], total)
    dots[begin] = _sum(total)


@_leaf
def _step_row(alpha, p, force, inverse, u, r, total):
    for x in range(r.size):
        u[x] += alpha * p[x]
        r[x] -= alpha * force[x]
        total[x] += inverse[x] * r[x] * r[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _step(begin, end, alpha, p, force, inverse, u, r, dots):
    total = np.zeros(r.shape[1], np.float32)
    for y in range(begin, end):
        _step_row(alpha, p[y], force[y], inverse[y], u[y], r[y], total)
    dots[begin] = _sum(total)


@_leaf
def _link_row(up, me, down, stiff, cut, across, along, lx, ly, lxy):
    """Where bends bind; `across`, `along` : 0 on rows that have no bend across them (the first and the last), no twist (the last)."""
    W = me.size
    for x in range(1, W - 1):
        lx[x] = stiff[x] if abs(me[x - 1] - f4(2) * me[x] + me[x + 1]) < cut else f4(0)
    lx[0], lx[W - 1] = f4(0), f4(0)
    for x in range(W):
        ly[x] = across * stiff[x] if abs(up[x] - f4(2) * me[x] + down[x]) < cut else f4(0)
    for x in range(W - 1):
        lxy[x] = along * stiff[x] if abs(me[x] - me[x + 1] - down[x] + down[x + 1]) < cut else f4(0)
    lxy[W - 1] = f4(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _links(begin, end, d, stiff, cut, lx, ly, lxy):
    H = d.shape[0]
    for y in range(begin, end):
        across, along = f4(0 < y < H - 1), f4(y < H - 1)
        _link_row(d[max(y - 1, 0)], d[y], d[min(y + 1, H - 1)], stiff[y], cut, across, along, lx[y], ly[y], lxy[y])


@_leaf
def _diagonal_row(w, lx, above, ly, below, crossed, lxy, out):
    W = w.size
    for x in range(1, W - 1):
        along, across = f4(4) * lx[x] + lx[x - 1] + lx[x + 1], f4(4) * ly[x] + above[x] + below[x]
        out[x] = f4(1) / (w[x] + along + across + f4(2) * (lxy[x] + lxy[x - 1] + crossed[x] + crossed[x - 1]) + f4(1e-9))
    for x, i in ((0, min(1, W - 1)), (W - 1, max(W - 2, 0))):
        twist = lxy[0] + crossed[0] if x == 0 else lxy[i] + crossed[i]
        out[x] = f4(1) / (w[x] + lx[i] + f4(4) * ly[x] + above[x] + below[x] + f4(2) * twist + f4(1e-9))


@njit(cache=True, nogil=True, error_model="numpy")
def _diagonal(begin, end, w, lx, ly, lxy, out):
    H, W = w.shape
    nothing = np.zeros(W, np.float32)
    for y in range(begin, end):
        above, crossed = (ly[y - 1], lxy[y - 1]) if y > 0 else (nothing, nothing)
        _diagonal_row(w[y], lx[y], above, ly[y], ly[y + 1] if y < H - 1 else nothing, crossed, lxy[y], out[y])


def _solved(d: Float32, weight: Float32, pull: Float32, stiff: Float32, u: Float32, *, cut: float, steps: int) -> Float32:
    """So many steps of conjugate gradients towards (weight + plate) u = pull - plate d; `u` is where to start, and is overwritten."""
    links = tuple(np.empty_like(d) for _ in range(3))
    inverse, r, p, before, force = (np.empty_like(d) for _ in range(5))
    dots = np.zeros(d.shape[0], np.float64)  # at the first row of each block
    in_blocks(lambda first, end: _links(first, end, d, stiff, f4(cut), *links), d)
    in_blocks(lambda first, end: _diagonal(first, end, weight, *links, inverse), d)
    in_blocks(lambda first, end: _begin(first, end, d, u, pull, weight, *links, inverse, r, dots), d)
    left, beta = float(dots.sum()), f4(0)
    before[:] = 0
    for _ in range(steps):
        if not left > 0:
            break
        in_blocks(partial(_spread, _push, (beta, inverse, r, before, weight, *links, p, force, dots)), d)
        met = float(dots.sum())
        if not met > 0:
            break
        in_blocks(partial(_spread, _step, (f4(left / met), p, force, inverse, u, r, dots)), d)
        after = float(dots.sum())
        beta, left = f4(after / left), after
        before, p = p, before
    return u


def _spread(run: Any, given: tuple[Any, ...], first: int, end: int) -> None:
    run(first, end, *given)


def plate_correction(
    d: Float32, weight: Float32, pull: Float32, bend: Float32, *, cut: float, levels: int = 5, steps: int = 10, finest: int = 0
) -> Float32:
    """What to add to `d` so that it is the smoothest surface that agrees with the evidence; (H, W) float32 px.

    d      : (H, W) px, finite.   weight : (H, W) > 0, 1/px^2.   pull : (H, W), weight times (what is known - d).
    bend   : (H, W) > 0, expected second difference, px.   cut : second difference that is an edge, px.
    levels : of the pyramid.      steps  : of conjugate gradients at each.   finest : the last level that is solved, 0 the full size; what it
             found is carried on to the full size as it is, a third of the time at 1.
    """
    stiff: Float32 = np.reciprocal(bend * bend)
    pyramid = [(d, weight, pull, stiff)]
    for _ in range(levels - 1):
        d, weight, pull, stiff = pyramid[-1]
        if min(d.shape) < 8:
            break
        # A coarse pixel is four fine ones whose bends are four times larger: weight x 4, stiffness x 4 / 16.
        pyramid.append((halved(d, surface=True), halved(weight, times=1.0), halved(pull, times=1.0), halved(stiff, times=0.0625)))
    finest = min(finest, len(pyramid) - 1)
    coarse = pyramid[-1][0]
    u = np.zeros_like(coarse)
    for level in range(len(pyramid) - 1, -1, -1):
        d, weight, pull, stiff = pyramid[level]
        if level < finest:
            u, coarse = carried_up(coarse, u, d, cut), d
            continue
        start = u if d is coarse else carried_up(coarse, u, d, cut)
        u = _solved(d, weight, pull, stiff, start, cut=cut * min(2**level, LOOSER), steps=steps)
        coarse = d
    return u


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
