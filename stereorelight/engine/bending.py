"""The smoothest surface that agrees with scattered evidence: a thin plate per surface, cut at depth edges.

In: a disparity (H, W) px, the weight (inverse variance, 1/px^2) of what is known per pixel, weight times (what is known
minus the disparity), and the bend (px/px^2) that surfaces are expected to have.  Out: the correction (H, W) px.
It minimises the sum of weight (d - known)^2 + (d_xx^2 + 2 d_xy^2 + d_yy^2) / bend^2, so the width over which evidence is
averaged follows from the evidence itself, (bend^2 weight)^(-1/4) px: small where there is much, wide where there is little.
Second differences larger than `cut` are depth edges and bind nothing.  Solved from coarse to fine (each level half the
size of the one before) by conjugate gradients with the diagonal as preconditioner.  All sums have a fixed order: the same
bits come whatever the number of threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32
SMALL = 250_000  # pixels of a picture that is not worth sharing out to threads: a pass over it takes less than a millisecond
ROWS = 40  # rows of a block
LOOSER = 4  # how much larger a bend may be on a coarse grid before it counts as an edge: bends grow by 4 a level, steps do not


def _in_blocks(run: Callable[[int, int], None], like: Float32) -> None:
    if like.size <= SMALL:
        run(0, like.shape[0])
    else:
        in_row_blocks(run, like.shape[0], block_rows=ROWS)


@njit(cache=True, nogil=True, error_model="numpy")
def _bend_row(up, me, down, lx, ly, lxy, first, last, qx, qy, qxy):
    W = me.size
    qx[0], qx[W - 1], qxy[W - 1] = f4(0), f4(0), f4(0)
    for x in range(1, W - 1):
        qx[x] = lx[x] * (me[x - 1] - f4(2) * me[x] + me[x + 1])
    for x in range(W):
        qy[x] = f4(0) if first or last else ly[x] * (up[x] - f4(2) * me[x] + down[x])
    for x in range(W - 1):
        qxy[x] = f4(0) if last else f4(2) * lxy[x] * (me[x] - me[x + 1] - down[x] + down[x + 1])


@njit(cache=True, nogil=True, error_model="numpy")
def _back_row(w, u, qx, above, qy, below, crossed, qxy, first, last, out):
    """Row of the plate's force: the adjoint of the second differences, plus weight times u."""
    W = u.size
    out[0] = w[0] * u[0] + qx[1] - f4(2) * qx[0]
    out[W - 1] = w[W - 1] * u[W - 1] + qx[W - 2] - f4(2) * qx[W - 1]
    for x in range(1, W - 1):
        out[x] = w[x] * u[x] + qx[x - 1] - f4(2) * qx[x] + qx[x + 1]
    for x in range(W):
        out[x] += qxy[x] - f4(2) * qy[x]
    for x in range(1, W):
        out[x] -= qxy[x - 1]
    if not first:
        for x in range(W):
            out[x] += above[x] - crossed[x]
        for x in range(1, W):
            out[x] += crossed[x - 1]
    if not last:
        for x in range(W):
            out[x] += below[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _dot_row(a, b):
    """Sum of a b, eight sums at a time: one alone waits for itself at every pixel."""
    n = a.size
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    whole = n - n % 8
    for x in range(0, whole, 8):
        s0 += np.float64(a[x] * b[x])
        s1 += np.float64(a[x + 1] * b[x + 1])
        s2 += np.float64(a[x + 2] * b[x + 2])
        s3 += np.float64(a[x + 3] * b[x + 3])
        s4 += np.float64(a[x + 4] * b[x + 4])
        s5 += np.float64(a[x + 5] * b[x + 5])
        s6 += np.float64(a[x + 6] * b[x + 6])
        s7 += np.float64(a[x + 7] * b[x + 7])
    for x in range(whole, n):
        s0 += np.float64(a[x] * b[x])
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7))


@njit(cache=True, nogil=True, error_model="numpy")
def _force(begin, end, w, u, lx, ly, lxy, out, dots):
    """weight u plus the plate's force on u: bends of a few rows at a time, and what they do to the rows between."""
    H, W = u.shape
    qx, qy, qxy = np.zeros((3, W), np.float32), np.zeros((3, W), np.float32), np.zeros((3, W), np.float32)
    for y in range(max(begin - 1, 0), min(end, H - 1) + 1):
        _bend_row(u[max(y - 1, 0)], u[y], u[min(y + 1, H - 1)], lx[y], ly[y], lxy[y], y == 0, y == H - 1, qx[y % 3], qy[y % 3], qxy[y % 3])
        me = y - 1  # its bends, and those of the rows above and below, are known
        if begin <= me < end:
            up = max(me - 1, 0) % 3
            _back_row(w[me], u[me], qx[me % 3], qy[up], qy[me % 3], qy[y % 3], qxy[up], qxy[me % 3], me == 0, False, out[me])
            dots[me] = _dot_row(u[me], out[me])
    if end == H:
        me, up = H - 1, max(H - 2, 0) % 3
        _back_row(w[me], u[me], qx[me % 3], qy[up], qy[me % 3], qy[me % 3], qxy[up], qxy[me % 3], me == 0, True, out[me])
        dots[me] = _dot_row(u[me], out[me])


@njit(cache=True, nogil=True, error_model="numpy")
def _add_row(alpha, p, u):
    for x in range(p.size):
        u[x] += alpha * p[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _scale_row(inverse, r, z):
    for x in range(r.size):
        z[x] = inverse[x] * r[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _step(begin, end, alpha, p, ap, inverse, u, r, z, dots):
    # One loop of six arrays does not become vectors: too many of them might overlap.
    for y in range(begin, end):
        _add_row(alpha, p[y], u[y])
        _add_row(-alpha, ap[y], r[y])
        _scale_row(inverse[y], r[y], z[y])
        dots[y] = _dot_row(r[y], z[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _turn_row(beta, z, p):
    for x in range(p.size):
        p[x] = z[x] + beta * p[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(begin, end, beta, z, p):
    for y in range(begin, end):
        _turn_row(beta, z[y], p[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _link_row(up, me, down, stiff, cut, first, last, lx, ly, lxy):
    W = me.size
    lx[0], lx[W - 1], lxy[W - 1] = f4(0), f4(0), f4(0)
    for x in range(1, W - 1):
        lx[x] = stiff[x] if abs(me[x - 1] - f4(2) * me[x] + me[x + 1]) < cut else f4(0)
    for x in range(W):
        ly[x] = f4(0) if first or last or not abs(up[x] - f4(2) * me[x] + down[x]) < cut else stiff[x]
    for x in range(W - 1):
        lxy[x] = f4(0) if last or not abs(me[x] - me[x + 1] - down[x] + down[x + 1]) < cut else stiff[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _links(begin, end, d, stiff, cut, lx, ly, lxy):
    H = d.shape[0]
    for y in range(begin, end):
        _link_row(d[max(y - 1, 0)], d[y], d[min(y + 1, H - 1)], stiff[y], cut, y == 0, y == H - 1, lx[y], ly[y], lxy[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _diagonal_row(w, lx, above, ly, below, crossed, lxy, first, last, out):
    W = w.size
    for x in range(W):
        out[x] = w[x] + f4(4) * lx[x] + f4(4) * ly[x] + f4(2) * lxy[x] + f4(1e-9)
    for x in range(1, W):
        out[x] += lx[x - 1] + f4(2) * lxy[x - 1]
    for x in range(W - 1):
        out[x] += lx[x + 1]
    if not first:
        for x in range(W):
            out[x] += above[x] + f4(2) * crossed[x]
        for x in range(1, W):
            out[x] += f4(2) * crossed[x - 1]
    if not last:
        for x in range(W):
            out[x] += below[x]
    for x in range(W):
        out[x] = f4(1) / out[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _diagonal(begin, end, w, lx, ly, lxy, out):
    H = w.shape[0]
    for y in range(begin, end):
        up, down = max(y - 1, 0), min(y + 1, H - 1)
        _diagonal_row(w[y], lx[y], ly[up], ly[y], ly[down], lxy[up], lxy[y], y == 0, y == H - 1, out[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _halve_row(a, b, times, lean, out):
    W = a.size
    for x in range(W // 2):
        out[x] = times * (a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1])
    if W % 2:
        end, inner = a[W - 1] + b[W - 1], a[max(W - 2, 0)] + b[max(W - 2, 0)]
        out[W // 2] = times * (f4(2) * end + lean * (end - inner))


@njit(cache=True, nogil=True, error_model="numpy")
def _halve(begin, end, a, times, lean, out):
    H, W = a.shape
    beyond = np.empty(W, np.float32)
    for y in range(begin, end):
        if 2 * y + 1 < H:
            _halve_row(a[2 * y], a[2 * y + 1], times, lean, out[y])
        else:
            for x in range(W):
                beyond[x] = a[H - 1, x] + lean * (a[H - 1, x] - a[max(H - 2, 0), x])
            _halve_row(a[H - 1], beyond, times, lean, out[y])


def halved(a: Float32, *, times: float = 0.25, surface: bool = False) -> Float32:
    """(H, W) at half the size, rounded up: the four pixels' sum times `times`.

    surface : an odd last row or column goes on as it leans; else it counts twice.
    """
    out = np.empty(((a.shape[0] + 1) // 2, (a.shape[1] + 1) // 2), np.float32)
    _in_blocks(lambda begin, end: _halve(begin, end, a, f4(times), f4(surface), out), out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _double_row(near, far, own, other, lean, out):
    """A row between two coarse rows, `own` of the nearer and `other` of the farther; beyond the ends as the row leans."""
    W, n = near.size, out.size
    for x in range(W):
        me = own * near[x] + other * far[x]
        inner = own * near[min(1, W - 1)] + other * far[min(1, W - 1)]
        left = own * near[x - 1] + other * far[x - 1] if x > 0 else me + lean * (me - inner)
        out[2 * x] = f4(0.75) * me + f4(0.25) * left
        if 2 * x + 1 < n:
            inner = own * near[max(W - 2, 0)] + other * far[max(W - 2, 0)]
            right = own * near[x + 1] + other * far[x + 1] if x < W - 1 else me + lean * (me - inner)
            out[2 * x + 1] = f4(0.75) * me + f4(0.25) * right


@njit(cache=True, nogil=True, error_model="numpy")
def _double(begin, end, a, lean, out):
    h = a.shape[0]
    for y in range(begin, end):
        near = y // 2
        far = near + 1 if y % 2 else near - 1
        if 0 <= far < h:
            _double_row(a[near], a[far], f4(0.75), f4(0.25), lean, out[y])
        else:  # beyond the ends: 1.25 of the last row less 0.25 of the one before it
            inner = min(max(2 * near - far, 0), h - 1)
            _double_row(a[near], a[inner], f4(1) + f4(0.25) * lean, f4(-0.25) * lean, lean, out[y])


def doubled(a: Float32, shape: tuple[int, int], *, surface: bool = False) -> Float32:
    """The inverse of `halved`, linear between the cells' centres; beyond the outer ones constant, or a `surface` as it leans."""
    out = np.empty(shape, np.float32)
    _in_blocks(lambda begin, end: _double(begin, end, a, f4(surface), out), out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _start_row(surface, correction, d, apart, out):
    for x in range(d.size):
        smooth = surface[x] - d[x]
        out[x] = smooth if abs(smooth - correction[x]) < apart else correction[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _start(begin, end, surface, correction, d, apart, out):
    for y in range(begin, end):
        _start_row(surface[y], correction[y], d[y], apart, out[y])


def _finer(coarse: Float32, correction: Float32, d: Float32, apart: float) -> Float32:
    """Where to start on a finer grid: the coarse surface itself where it is this pixel's surface, else its correction."""
    out = np.empty_like(d)
    surface, moved = doubled(coarse + correction, d.shape, surface=True), doubled(correction, d.shape)
    _in_blocks(lambda begin, end: _start(begin, end, surface, moved, d, f4(apart), out), d)
    return out


class _Plate:
    """The linear system of one level: weight and stiffness about a disparity."""

    def __init__(self, d: Float32, weight: Float32, stiff: Float32, cut: float) -> None:
        self.like = d
        self.weight = weight
        self.links = tuple(np.empty_like(d) for _ in range(3))
        self.dots = np.empty(d.shape[0], np.float64)
        _in_blocks(lambda begin, end: _links(begin, end, d, stiff, f4(cut), *self.links), self.like)

    def force(self, weight: Float32, u: Float32, out: Float32) -> float:
        """weight u + plate u into `out`; returns u . out."""
        _in_blocks(lambda begin, end: _force(begin, end, weight, u, *self.links, out, self.dots), self.like)
        return float(self.dots.sum())

    def _advance(self, alpha: np.float32, vectors: tuple[Float32, ...], begin: int, end: int) -> None:
        _step(begin, end, alpha, *vectors, self.dots)

    def _turn(self, beta: np.float32, z: Float32, p: Float32, begin: int, end: int) -> None:
        _turn(begin, end, beta, z, p)

    def solve(self, b: Float32, u: Float32, steps: int) -> Float32:
        """So many steps of conjugate gradients towards (weight + plate) u = b; `u` is overwritten."""
        inverse, ap, z = np.empty_like(u), np.empty_like(u), np.empty_like(u)
        _in_blocks(lambda begin, end: _diagonal(begin, end, self.weight, *self.links, inverse), self.like)
        self.force(self.weight, u, ap)
        r = b - ap
        z = inverse * r
        p = z.copy()
        vectors = (p, ap, inverse, u, r, z)
        _in_blocks(partial(self._advance, f4(0), vectors), self.like)
        rz = float(self.dots.sum())
        for _ in range(steps):
            if not rz > 0:
                break
            pap = self.force(self.weight, p, ap)
            if not pap > 0:
                break
            alpha = f4(rz / pap)
            _in_blocks(partial(self._advance, alpha, vectors), self.like)
            after = float(self.dots.sum())
            beta, rz = f4(after / rz), after
            _in_blocks(partial(self._turn, beta, z, p), self.like)
        return u


def plate_correction(d: Float32, weight: Float32, pull: Float32, bend: Float32, *, cut: float, levels: int = 5, steps: int = 10) -> Float32:
    """What to add to `d` so that it is the smoothest surface that agrees with the evidence; (H, W) float32 px.

    d      : (H, W) px, finite.   weight : (H, W) > 0, 1/px^2.   pull : (H, W), weight times (what is known - d).
    bend   : (H, W) > 0, expected second difference, px.   cut : second difference that is an edge, px.
    levels : of the pyramid.      steps  : of conjugate gradients at each.
    """
    stiff: Float32 = np.reciprocal(bend * bend)
    pyramid = [(d, weight, pull, stiff)]
    for _ in range(levels - 1):
        d, weight, pull, stiff = pyramid[-1]
        if min(d.shape) < 8:
            break
        # A coarse pixel is four fine ones whose bends are four times larger: weight x 4, stiffness x 4 / 16.
        pyramid.append((halved(d, surface=True), halved(weight, times=1.0), halved(pull, times=1.0), halved(stiff, times=0.0625)))
    u: Float32 | None = None
    coarse = d
    for level in range(len(pyramid) - 1, -1, -1):
        d, weight, pull, stiff = pyramid[level]
        plate = _Plate(d, weight, stiff, cut * min(2**level, LOOSER))
        b = np.empty_like(d)
        plate.force(np.zeros_like(d), d, b)
        u = plate.solve(pull - b, np.zeros_like(d) if u is None else _finer(coarse, u, d, cut), steps)
        coarse = d
    assert u is not None
    return u


@njit(cache=True, nogil=True, error_model="numpy")
def _energy_row(up, me, down, cut, floor, first, last, logs, counts):
    W = me.size
    for x in range(W):
        logs[x], counts[x] = f4(0), f4(0)
    if first or last:
        return
    for x in range(1, W - 1):
        xx, yy = me[x - 1] - f4(2) * me[x] + me[x + 1], up[x] - f4(2) * me[x] + down[x]
        xy = me[x] - me[x + 1] - down[x] + down[x + 1]
        if abs(xx) < cut and abs(yy) < cut and abs(xy) < cut:
            logs[x] = np.log(xx * xx + f4(2) * xy * xy + yy * yy + floor)
            counts[x] = f4(1)


@njit(cache=True, nogil=True, error_model="numpy")
def _energy(begin, end, d, cut, floor, logs, counts):
    H = d.shape[0]
    for y in range(begin, end):
        _energy_row(d[max(y - 1, 0)], d[y], d[min(y + 1, H - 1)], cut, floor, y == 0, y == H - 1, logs[y], counts[y])


def bend_energy(d: Float32, *, cut: float, floor: float = 1e-10) -> tuple[Float32, Float32]:
    """Logarithm of d_xx^2 + 2 d_xy^2 + d_yy^2 per pixel (H, W), px^2, and 1 where it is known: not at edges, where it is 0 and 0."""
    logs, counts = np.empty_like(d), np.empty_like(d)
    _in_blocks(lambda begin, end: _energy(begin, end, d, f4(cut), f4(floor), logs, counts), d)
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
    _in_blocks(lambda begin, end: _slopes(begin, end, d, f4(cut), out_x, out_y), d)
    return out_x, out_y
