"""The smoothest surface that agrees with scattered evidence: a thin plate per surface, cut at depth edges.

In: a disparity (H, W) px, the weight (inverse variance, 1/px^2) of what is known per pixel, weight times (what is known
minus the disparity), and the bend (px/px^2) that surfaces are expected to have.  Out: the correction (H, W) px.
It minimises the sum of weight (d - known)^2 + (d_xx^2 + 2 d_xy^2 + d_yy^2) / bend^2, so the width over which evidence is
averaged follows from the evidence itself, (bend^2 weight)^(-1/4) px: small where there is much, wide where there is little.
Second differences larger than `cut` are depth edges and bind nothing.  Bends have tails, most of a face being smooth and its lids and lips
sharp, and a crease bends one way alone: below `cut` each second difference is bound less the more the surface bends there.
Solved from coarse to fine (each level half the
size of the one before) by conjugate gradients with the diagonal as preconditioner.  All sums have a fixed order: the same
bits come whatever the number of threads."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import kernel
from stereorelight.engine.pyramid import block_rows, carry, double, halve
from stereorelight.engine.turns import shared, together, turns_of

f4 = np.float32
STEP = 6  # cuts: disparities side by side that differ by more are of two surfaces
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
def _link_row(up, me, down, stiff, cut, tail, across, along, lx, ly, lxy):
    """How stiff each bend is; `across`, `along` : 0 on rows that have no bend across them (the first and the last), no twist (the last)."""
    W = me.size
    for x in range(1, W - 1):
        b = me[x - 1] - f4(2) * me[x] + me[x + 1]
        lx[x] = stiff[x] / (f4(1) + tail * stiff[x] * b * b) if abs(b) < cut else f4(0)
    lx[0], lx[W - 1] = f4(0), f4(0)
    for x in range(W):
        b = up[x] - f4(2) * me[x] + down[x]
        ly[x] = across * stiff[x] / (f4(1) + tail * stiff[x] * b * b) if abs(b) < cut else f4(0)
    for x in range(W - 1):
        b = me[x] - me[x + 1] - down[x] + down[x + 1]
        lxy[x] = along * stiff[x] / (f4(1) + tail * stiff[x] * b * b) if abs(b) < cut else f4(0)
    lxy[W - 1] = f4(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _links(begin, end, d, stiff, cut, tail, lx, ly, lxy):
    H = d.shape[0]
    for y in range(begin, end):
        across, along = f4(0 < y < H - 1), f4(y < H - 1)
        _link_row(d[max(y - 1, 0)], d[y], d[min(y + 1, H - 1)], stiff[y], cut, tail, across, along, lx[y], ly[y], lxy[y])


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


@njit(cache=True, nogil=True, error_model="numpy")
def _halve_all(begin, end, d, weight, pull, stiff, half_d, half_weight, half_pull, half_stiff):
    """A coarse pixel is four fine ones whose bends are four times larger: weight x 4, stiffness x 4 / 16."""
    halve(begin, end, d, f4(0.25), f4(1), half_d)
    halve(begin, end, weight, f4(1), f4(0), half_weight)
    halve(begin, end, pull, f4(1), f4(0), half_pull)
    halve(begin, end, stiff, f4(0.0625), f4(0), half_stiff)


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_rows(begin, end, a, b, out):
    for y in range(begin, end):
        _sum_row(a[y], b[y], out[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _stiffen(begin, end, bend, out):
    """One over the square; `out` may be `bend`."""
    for y in range(begin, end):
        for x in range(out.shape[1]):
            out[y, x] = f4(1) / (bend[y, x] * bend[y, x])


@njit(cache=True, nogil=True, error_model="numpy")
def _clear(begin, end, out):
    out[begin:end] = f4(0)


@njit(nogil=True, error_model="numpy")
def _of_level(full, coarse, size):
    """A map of a level, `size` as in `_correct`: the full size has its own, all others lie one behind another."""
    h, w, place = size[1], size[2], size[3]
    return full if size[0] == 0 else coarse[place : place + h * w].reshape(h, w)


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(turns, step, dots, d, u, pull, weight, stiff, work, cut, tail, rows, steps):
    """So many steps of conjugate gradients towards (weight + plate) u = pull - plate d; `u` is where to start, and is overwritten.

    work : nine of H W or more.   dots : (steps, H), at the first row of each block.   Returns the next step of the kernel.
    """
    H, W = d.shape
    n = H * W
    lx, ly, lxy = work[0][:n].reshape(H, W), work[1][:n].reshape(H, W), work[2][:n].reshape(H, W)
    inverse, r, force = work[3][:n].reshape(H, W), work[4][:n].reshape(H, W), work[5][:n].reshape(H, W)
    p, before = work[6][:n].reshape(H, W), work[7][:n].reshape(H, W)
    for begin, end in shared(turns, step, H, rows):
        _links(begin, end, d, stiff, cut, tail, lx, ly, lxy)
    step += 1
    for begin, end in shared(turns, step, H, rows):
        _diagonal(begin, end, weight, lx, ly, lxy, inverse)
    step += 1
    for begin, end in shared(turns, step, H, rows):
        _clear(begin, end, before)
    step += 1
    left = dots[step]
    for begin, end in shared(turns, step, H, rows):
        _begin(begin, end, d, u, pull, weight, lx, ly, lxy, inverse, r, left)
    step += 1
    was, beta = left[:H:rows].sum(), f4(0)
    for _ in range(steps):
        if not was > 0:
            break
        met = dots[step]
        for begin, end in shared(turns, step, H, rows):
            _push(begin, end, beta, inverse, r, before, weight, lx, ly, lxy, p, force, met)
        step += 1
        product = met[:H:rows].sum()
        if not product > 0:
            break
        left = dots[step]
        for begin, end in shared(turns, step, H, rows):
            _step(begin, end, f4(was / product), p, force, inverse, u, r, left)
        step += 1
        now = left[:H:rows].sum()
        beta, was = f4(now / was), now
        before, p = p, before
    return step


@njit(cache=True, nogil=True, error_model="numpy")
def _correct(turns, dots, sizes, d, weight, pull, bend, stiff, out, coarse, work, cut, tail, finest, steps):
    """`plate_correction`, by all threads together.

    sizes : (levels, 5) of each level its number, height, width, place in `coarse`, and rows of a block.
    coarse : five of the pixels of all levels but the first: disparity, weight, pull, stiffness and correction.   work : nine of H W.
    """
    step, levels = np.int64(0), len(sizes)
    H, W, rows = sizes[0, 1], sizes[0, 2], sizes[0, 4]
    if bend.shape == d.shape:
        for begin, end in shared(turns, step, H, rows):
            _stiffen(begin, end, bend, stiff)
        step += 1
    else:
        h, w = (H + 1) // 2, (W + 1) // 2
        half = work[0][: h * w].reshape(h, w)
        for begin, end in shared(turns, step, h, rows):
            double(begin, end, bend, f4(0), half)
        step += 1
        for begin, end in shared(turns, step, H, rows):
            double(begin, end, half, f4(0), stiff)
            _stiffen(begin, end, stiff, stiff)
        step += 1
    for level in range(1, levels):
        fine, half = sizes[level - 1], sizes[level]
        whole = _of_level(d, coarse[0], fine), _of_level(weight, coarse[1], fine), _of_level(pull, coarse[2], fine), _of_level(stiff, coarse[3], fine)
        small = _of_level(d, coarse[0], half), _of_level(weight, coarse[1], half), _of_level(pull, coarse[2], half), _of_level(stiff, coarse[3], half)
        for begin, end in shared(turns, step, half[1], half[4]):
            _halve_all(begin, end, *whole, *small)
        step += 1
    for level in range(levels - 1, -1, -1):
        size, rows = sizes[level], sizes[level, 4]
        here, u = _of_level(d, coarse[0], size), _of_level(out, coarse[4], size)
        if level == levels - 1:
            for begin, end in shared(turns, step, size[1], rows):
                _clear(begin, end, u)
            step += 1
        else:
            below = sizes[level + 1]
            h, w = below[1], below[2]
            surface, solved, moved = work[8][: h * w].reshape(h, w), _of_level(d, coarse[0], below), _of_level(out, coarse[4], below)
            for begin, end in shared(turns, step, h, below[4]):
                _sum_rows(begin, end, solved, moved, surface)
            step += 1
            for begin, end in shared(turns, step, size[1], rows):
                carry(begin, end, surface, moved, here, cut, f4(STEP) * cut * f4(min(2**level, LOOSER)), u)
            step += 1
        if level >= finest:
            of_level = _of_level(pull, coarse[2], size), _of_level(weight, coarse[1], size), _of_level(stiff, coarse[3], size)
            # A bend of one surface is four times as large on a grid of half the size, and the stiffness a quarter.
            loose, less = cut * f4(min(2**level, LOOSER)), tail / f4(4**level)
            step = _solve(turns, step, dots, here, u, *of_level, work, loose, less, rows, steps)


def _room(maps: int, pixels: int) -> tuple[Float32, ...]:
    """Each of its own: one large array would go back to the system after every call (memory.py)."""
    return tuple(np.empty(pixels, np.float32) for _ in range(maps))


def plate_correction(
    d: Float32, weight: Float32, pull: Float32, bend: Float32, *, cut: float, tail: float = 0.0, levels: int = 5, steps: int = 10, finest: int = 0
) -> Float32:
    """What to add to `d` so that it is the smoothest surface that agrees with the evidence; (H, W) float32 px.

    d      : (H, W) px, finite.   weight : (H, W) > 0, 1/px^2.   pull : (H, W), weight times (what is known - d).
    bend   : > 0, expected second difference, px, (H, W) or at a quarter of the size, rounded up.   cut : second difference that is an edge, px.
    tail   : of bends: one of `d` that is b times as large as expected is bound 1 + tail b^2 times less.  0 for none.
    levels : of the pyramid.      steps  : of conjugate gradients at each.   finest : the last level that is solved, 0 the full size; what it
             found is carried on to the full size as it is, a third of the time at 1.
    """
    sizes = [(0, *d.shape, 0, block_rows(d.shape))]
    while len(sizes) < levels and min(sizes[-1][1:3]) >= 8:
        _, h, w, place, _ = sizes[-1]
        shape = ((h + 1) // 2, (w + 1) // 2)
        sizes.append((len(sizes), *shape, place + h * w if len(sizes) > 1 else 0, block_rows(shape)))
    most = 2 + len(sizes) * (7 + 2 * steps)
    coarse, work = _room(5, sum(h * w for _, h, w, _, _ in sizes[1:])), _room(9, d.size)
    dots, out, stiff = np.zeros((most, d.shape[0]), np.float64), np.empty_like(d), np.empty_like(d)
    flat = np.array(sizes, np.int64)
    tuning = f4(cut), f4(tail), min(finest, len(sizes) - 1), steps
    together(_correct, turns_of(most), dots, flat, d, weight, pull, bend, stiff, out, coarse, work, *tuning)
    return out
