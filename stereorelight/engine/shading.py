"""Shading of a depth, its slope in every cell, and the linear system of a joint fit, in row-blocked kernels.

In: v = -log Z (H, W) float32, the rays of its pixels, and the light of each material.  A cell lies between four pixels, (H - 1, W - 1);
arrays of cells are (H, W) with a last row and column that count nothing.  Out: what the light makes of each cell, and a symmetric
system of 13 entries a row (seven kept) whose unknown is a correction of v.

The normal needs only the slopes of v: with p, q its derivatives along the ray slopes x, y, N ~ (-p, q, 1 - x p - y q) (scene frame).
Blocks of rows are fixed and touch only their own rows; sums are taken block by block in order: any number of threads, the same bits."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32
LINKS = 7  # (0,0) (0,1) (0,2) (1,-1) (1,0) (1,1) (2,0): the rest of a symmetric 13-point row


@njit(cache=True, nogil=True, error_model="numpy")
def _shade_row(v0, v1, X, Y, Jpu, Jpv, Jqu, Jqv, labels, light, floor, logS, gu, gv, nx, ny, nz):
    """One row of cells.  p = Jpu v_u + Jpv v_v, and so on; gu, gv: d log S / d v_u, d v_v.  floor: radiance not believed below."""
    n = v0.size - 1
    half = f4(0.5)
    for i in range(n):
        du = half * (v0[i + 1] - v0[i] + v1[i + 1] - v1[i])
        dv = half * (v1[i] - v0[i] + v1[i + 1] - v0[i + 1])
        p = Jpu[i] * du + Jpv[i] * dv
        q = Jqu[i] * du + Jqv[i] * dv
        mz = f4(1) - X[i] * p - Y[i] * q
        inv = f4(1) / math.sqrt(p * p + q * q + mz * mz)
        x, y, z = -p * inv, q * inv, mz * inv
        nx[i], ny[i], nz[i] = x, y, z
        k = labels[i]
        if k < 0:
            logS[i] = gu[i] = gv[i] = f4(0)
            continue
        c = light[k]
        S = (
            c[0]
            + c[1] * x
            + c[2] * y
            + c[3] * z
            + c[4] * x * y
            + c[5] * y * z
            + c[6] * x * z
            + c[7] * (x * x - y * y)
            + c[8] * (f4(3) * z * z - f4(1))
        )
        low = floor[k]
        if not low < S:
            logS[i] = math.log(low)
            gu[i] = gv[i] = f4(0)
            continue
        logS[i] = math.log(S)
        s = inv / S
        sx = (c[1] + c[4] * y + c[6] * z + f4(2) * c[7] * x) * s
        sy = (c[2] + c[4] * x + c[5] * z - f4(2) * c[7] * y) * s
        sz = (c[3] + c[5] * y + c[6] * x + f4(6) * c[8] * z) * s
        along = sx * x + sy * y + sz * z
        sx, sy, sz = sx - along * x, sy - along * y, sz - along * z
        gp = -sx - X[i] * sz
        gq = sy - Y[i] * sz
        gu[i] = gp * Jpu[i] + gq * Jqu[i]
        gv[i] = gp * Jpv[i] + gq * Jqv[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _shade(first, end, v, rays, labels, light, floor, logS, gu, gv, N):
    H = v.shape[0]
    for y in range(first, end):
        if y + 1 >= H:
            logS[y], gu[y], gv[y] = f4(0), f4(0), f4(0)
            N[:, y] = N[:, y - 1]
            continue
        _shade_row(
            v[y], v[y + 1], rays[0, y], rays[1, y], rays[2, y], rays[3, y], rays[4, y], rays[5, y], labels[y], light, floor,
            logS[y], gu[y], gv[y], N[0, y], N[1, y], N[2, y],
        )  # fmt: skip
        logS[y, -1] = gu[y, -1] = gv[y, -1] = f4(0)
        N[:, y, -1] = N[:, y, -2]


def shade(v: Float32, rays: Float32, labels: npt.NDArray[np.int16], light: Float32, floor: Float32) -> tuple[Float32, Float32, Float32, Float32]:
    """Log shading, its derivatives by the slopes of v (per pixel), and normals (3, H, W) of every cell.

    rays : (6, H, W): x, y, then dp/dv_u, dp/dv_v, dq/dv_u, dq/dv_v.  labels : (H, W) int16 into light (M, 9); -1 has no light.
    """
    logS, gu, gv = np.empty_like(v), np.empty_like(v), np.empty_like(v)
    N = np.empty((3, *v.shape), np.float32)
    in_row_blocks(lambda a, b: _shade(a, b, v, rays, labels, light, floor, logS, gu, gv, N), v.shape[0])
    return logS, gu, gv, N


@njit(cache=True, nogil=True, error_model="numpy")
def _cell_row(A, B, first, w, gu, gv, cross, turn, du, dv, n):
    """Add one row of cells to the row of pixels above it (first) or below it."""
    half = f4(0.5)
    for i in range(n - 1):
        h = half * turn[i]
        plus, minus = h * (du[i] + dv[i]), h * (du[i] - dv[i])
        k00, k01 = half * (-gu[i] - gv[i]), half * (gu[i] - gv[i])
        k10, k11 = half * (-gu[i] + gv[i]), half * (gu[i] + gv[i])
        t, c = w[i], cross[i]
        if first:
            A[0, i] += t * k00 * k00 + c + h
            A[0, i + 1] += t * k01 * k01 + c + h
            A[1, i] += t * k00 * k01 - c
            A[4, i] += t * k00 * k10 - c
            A[4, i + 1] += t * k01 * k11 - c
            A[5, i] += t * k00 * k11 + c - h
            A[3, i + 1] += t * k01 * k10 + c - h
            s = t * B[i]
            A[7, i] += s * k00 - plus
            A[7, i + 1] += s * k01 + minus
        else:
            A[0, i] += t * k10 * k10 + c + h
            A[0, i + 1] += t * k11 * k11 + c + h
            A[1, i] += t * k10 * k11 - c
            s = t * B[i]
            A[7, i] += s * k10 - minus
            A[7, i + 1] += s * k11 + plus


@njit(cache=True, nogil=True, error_model="numpy")
def _bend_row(A, bx, byu, by, byd, n):
    """Second differences: bx along the row, by of the rows above, here and below, each centred on its pixel."""
    for i in range(n):
        d = f4(4) * (bx[i] + by[i]) + byu[i] + byd[i]
        if i > 0:
            d += bx[i - 1]
        if i + 1 < n:
            d += bx[i + 1]
            A[1, i] -= f4(2) * (bx[i] + bx[i + 1])
            A[2, i] += bx[i + 1]
        A[0, i] += d
        A[4, i] -= f4(2) * (by[i] + byd[i])
        A[6, i] += byd[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _assemble(first, end, w, r, gu, gv, cross, turn, du, dv, bx, by, data, pull, A, rhs):
    H, W = w.shape
    zero = np.zeros(W, np.float32)
    T = np.empty((8, W + 2), np.float32)
    for y in range(first, end):
        T[:] = f4(0)
        for i in range(W):
            T[0, i] = data[y, i]
            T[7, i] = data[y, i] * pull[y, i]
        if y + 1 < H:
            _cell_row(T, r[y], True, w[y], gu[y], gv[y], cross[y], turn[y], du[y], dv[y], W)
        if y > 0:
            _cell_row(T, r[y - 1], False, w[y - 1], gu[y - 1], gv[y - 1], cross[y - 1], turn[y - 1], du[y - 1], dv[y - 1], W)
        _bend_row(T, bx[y], by[y - 1] if y > 0 else zero, by[y], by[y + 1] if y + 1 < H else zero, W)
        for k in range(7):
            A[k, y] = T[k, :W]
        rhs[y] = T[7, :W]


def assemble(
    *,
    data: Float32, pull: Float32, shading: Float32, left: Float32, gu: Float32, gv: Float32, turn: Float32, du: Float32, dv: Float32,
    bends: tuple[Float32, Float32, Float32],
) -> tuple[Float32, Float32]:  # fmt: skip
    """The system whose solution makes a sum of squares least: A (7, H, W) and its right side (H, W).

    data (x - pull)^2 + shading (gu x_u + gv x_v - left)^2 + turn ((x_u - du)^2 + (x_v - dv)^2) + bends (x_uu^2, x_vv^2, x_uv^2).
    bends must be 0 where a neighbour is missing; weights of cells are 0 in the last row and column.
    """
    bx, by, cross = bends
    A = np.empty((LINKS, *data.shape), np.float32)
    rhs = np.empty_like(data)
    given = (shading, left, gu, gv, cross, turn, du, dv, bx, by, data, pull, A, rhs)
    in_row_blocks(lambda a, b: _assemble(a, b, *given), data.shape[0])
    return A, rhs


@njit(cache=True, nogil=True, error_model="numpy")
def _bends(first, end, v, okx, oky, okc, inv, lam, wx, wy, wc):
    """Weights of the second differences: lam where a surface is smooth, falling with the bend beyond 1 / sqrt(inv); 0 across an edge."""
    H, W = v.shape
    for y in range(first, end):
        for i in range(W):
            wx[y, i] = f4(0)
            wy[y, i] = f4(0)
            wc[y, i] = f4(0)
        for i in range(1, W - 1):
            b = v[y, i - 1] - f4(2) * v[y, i] + v[y, i + 1]
            wx[y, i] = okx[y, i] * okx[y, i - 1] * lam / math.sqrt(f4(1) + b * b * inv)
        if 0 < y < H - 1:
            for i in range(W):
                b = v[y - 1, i] - f4(2) * v[y, i] + v[y + 1, i]
                wy[y, i] = oky[y, i] * oky[y - 1, i] * lam / math.sqrt(f4(1) + b * b * inv)
        if y < H - 1:
            for i in range(W - 1):
                b = v[y, i] - v[y, i + 1] - v[y + 1, i] + v[y + 1, i + 1]
                wc[y, i] = okc[y, i] * f4(2) * lam / math.sqrt(f4(1) + b * b * inv)


def bend_weights(v: Float32, okx: Float32, oky: Float32, okc: Float32, *, free: float) -> tuple[Float32, Float32, Float32]:
    """Weights of second differences along x, along y, and across cells; `free`: the bend from which they matter less.

    okx, oky, okc : 1 where a pixel and its right, its lower neighbour, a whole cell, are of one surface, else 0.
    """
    out = np.empty_like(v), np.empty_like(v), np.empty_like(v)
    inv = f4(1 / free**2)
    in_row_blocks(lambda a, b: _bends(a, b, v, okx, oky, okc, inv, f4(1), *out), v.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _rest(first, end, A, rhs, v, out):
    H, W = v.shape
    for y in range(first, end):
        for i in range(W):
            s = np.float64(rhs[y, i]) - np.float64(A[0, y, i]) * np.float64(v[y, i])
            for k in range(1, 7):
                dy = 0 if k < 3 else (1 if k < 6 else 2)
                dx = k if k < 3 else (k - 4 if k < 6 else 0)
                if y + dy < H and 0 <= i + dx < W:
                    s -= np.float64(A[k, y, i]) * np.float64(v[y + dy, i + dx])
                if y - dy >= 0 and 0 <= i - dx < W:
                    s -= np.float64(A[k, y - dy, i - dx]) * np.float64(v[y - dy, i - dx])
            out[y, i] = s


def rest(A: Float32, rhs: Float32, v: Float32) -> Float32:
    """rhs - A v, summed in double: v is large beside what is sought of it."""
    out = np.empty_like(v)
    in_row_blocks(lambda a, b: _rest(a, b, A, rhs, v, out), v.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _times_row(out, n, x, xu, xuu, xd, xdd, a0, a1, a2, a3, a4, a5, a6, u3, u4, u5, uu6):
    for i in range(2, n - 2):
        s = a0[i] * x[i] + a1[i] * x[i + 1] + a1[i - 1] * x[i - 1] + a2[i] * x[i + 2] + a2[i - 2] * x[i - 2]
        s += a3[i] * xd[i - 1] + a4[i] * xd[i] + a5[i] * xd[i + 1] + a6[i] * xdd[i]
        s += u3[i + 1] * xu[i + 1] + u4[i] * xu[i] + u5[i - 1] * xu[i - 1] + uu6[i] * xuu[i]
        out[i] = s


@njit(cache=True, nogil=True, error_model="numpy")
def _times(first, end, block, A, x, out, dots):
    """out = A x on padded pictures (two pixels around); dots[block] = x . out."""
    W = x.shape[1]
    total = 0.0
    for y in range(first + 2, end + 2):
        _times_row(
            out[y], W, x[y], x[y - 1], x[y - 2], x[y + 1], x[y + 2],
            A[0, y], A[1, y], A[2, y], A[3, y], A[4, y], A[5, y], A[6, y], A[3, y - 1], A[4, y - 1], A[5, y - 1], A[6, y - 2],
        )  # fmt: skip
        row = 0.0
        for i in range(2, W - 2):
            row += np.float64(x[y, i] * out[y, i])
        total += row
    dots[block] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _advance(first, end, block, alpha, x, r, d, Ad, inv, z, dots):
    """x += alpha d, r -= alpha A d, z = inv r; dots[block] = r . z."""
    W = x.shape[1]
    total = 0.0
    a = f4(alpha)
    for y in range(first + 2, end + 2):
        row = 0.0
        for i in range(2, W - 2):
            x[y, i] += a * d[y, i]
            t = r[y, i] - a * Ad[y, i]
            r[y, i] = t
            s = inv[y, i] * t
            z[y, i] = s
            row += np.float64(t * s)
        total += row
    dots[block] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(first, end, beta, d, z):
    b = f4(beta)
    for y in range(first + 2, end + 2):
        for i in range(2, d.shape[1] - 2):
            d[y, i] = z[y, i] + b * d[y, i]


ROWS = 32  # of a block whose dot products are summed together


def _advanced(alpha: float, x: Float32, r: Float32, d: Float32, Ad: Float32, inv: Float32, z: Float32, dots: Float64, a: int, b: int, k: int) -> None:
    _advance(a, b, k, alpha, x, r, d, Ad, inv, z, dots)


def _turned(beta: float, d: Float32, z: Float32, a: int, b: int) -> None:
    _turn(a, b, beta, d, z)


def solve(A: Float32, rhs: Float32, *, steps: int) -> Float32:
    """x (H, W) after `steps` of conjugate gradients on A x = rhs, preconditioned by the diagonal, from zero."""
    h = rhs.shape[0]
    A = np.pad(A, ((0, 0), (2, 2), (2, 2)))
    inv = np.pad((1 / np.maximum(A[0, 2:-2, 2:-2], f4(1e-20))).astype(np.float32), 2)
    r = np.pad(rhs, 2)
    x, d, z, Ad = (np.zeros_like(r) for _ in range(4))
    dots = np.zeros(-(-h // ROWS))

    def total(run: Callable[[int, int, int], None]) -> float:
        in_row_blocks(lambda a, b: run(a, b, a // ROWS), h, block_rows=ROWS)
        return float(dots.sum())

    rz = total(lambda a, b, k: _advance(a, b, k, 0.0, x, r, d, Ad, inv, z, dots))
    first = rz
    d[:] = z
    for _ in range(steps):
        if rz <= 1e-10 * first or rz <= 0:
            break
        dAd = total(lambda a, b, k: _times(a, b, k, A, d, Ad, dots))
        if not dAd > 0:
            break
        new = total(partial(_advanced, rz / dAd, x, r, d, Ad, inv, z, dots))
        in_row_blocks(partial(_turned, new / rz, d, z), h, block_rows=ROWS)
        rz = new
    return np.ascontiguousarray(x[2:-2, 2:-2])
