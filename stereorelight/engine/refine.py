"""Robust local planes in a disparity map: each pixel keeps the plane of the surface that it lies on.

In: disparity (H, W) float32 pixels with a weight per pixel (0 = unknown).  Out: value and both slopes (px per px).
A plane in space is a plane in disparity, so slanted walls stay exact; a re-weighted fit (Welsch-like, compact support)
leaves out whatever lies off the plane, so that actor and wall are never mixed.  Rows are independent: the same bits come
whatever the number of threads."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.rows import in_pieces

Planes = tuple[Float32, Float32, Float32]  # value, slope along x, slope along y
f4 = np.float32
ROUND = 1.27  # of the radius, squared: a window as large as its square's inner disc and a little more, alike in all directions
BLOCK = 512  # pixels of a row worked on at a time: eleven float32 strips of this length stay in the first-level cache
# No fast mathematics: the loops are elementwise and need none to become vectors, and with it numba's disk cache has been
# seen to give other last digits than the compilation that filled it.


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh(z, q, t, c0, a, b, n, dx, dy, inv_tau2, w, wd):
    """Weight w, and weight times difference wd, of the neighbours (dx, dy) of a strip of pixels."""
    for i in range(n):
        d = z[i] - c0[i]
        r = d - a[i] * dx - b[i] * dy
        k = f4(1) - r * r * inv_tau2
        k = k if k > f4(0) else f4(0)
        k = q[i] * k * k
        w[i] = k
        wd[i] = k * (t[i] - c0[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _add_weights(w, n, dx, S, SX, SXX):
    for i in range(n):
        S[i] += w[i]
        SX[i] += w[i] * dx
        SXX[i] += w[i] * (dx * dx)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_values(wd, n, dx, SZ, SZX):
    for i in range(n):
        SZ[i] += wd[i]
        SZX[i] += wd[i] * dx


@njit(cache=True, nogil=True, error_model="numpy")
def _add_row(dy, n, R, RX, RXX, S, SX, SXX):
    for i in range(n):
        S[i] += R[i]
        SX[i] += RX[i]
        SXX[i] += RXX[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _add_row_y(dy, n, R, RX, SY, SXY, SYY):
    for i in range(n):
        SY[i] += R[i] * dy
        SXY[i] += RX[i] * dy
        SYY[i] += R[i] * (dy * dy)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_row_z(dy, n, RZ, RZX, SZ, SZX, SZY):
    for i in range(n):
        SZ[i] += RZ[i]
        SZX[i] += RZX[i]
        SZY[i] += RZ[i] * dy


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(c0, a, b, x0, n, ridge, S, SX, SY, SXX, SXY, SYY, SZ, SZX, SZY, value, slope_x, slope_y):
    for i in range(n):
        s = S[i]
        inv = f4(1) / (s if s > f4(1e-6) else f4(1))
        mx, my, mz = SX[i] * inv, SY[i] * inv, SZ[i] * inv
        cxx, cyy, cxy = SXX[i] * inv - mx * mx + ridge, SYY[i] * inv - my * my + ridge, SXY[i] * inv - mx * my
        czx, czy = SZX[i] * inv - mz * mx, SZY[i] * inv - mz * my
        det = f4(1) / (cxx * cyy - cxy * cxy)
        p, q = (czx * cyy - czy * cxy) * det, (czy * cxx - czx * cxy) * det
        enough = s > f4(1.5)
        value[x0 + i] = c0[i] + mz - p * mx - q * my if enough else c0[i]
        slope_x[x0 + i] = p if enough else a[i]
        slope_y[x0 + i] = q if enough else b[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _planes(first, end, z, q, t, value, slope_x, slope_y, radius, stride, inv_tau2, ridge, out_value, out_x, out_y):
    H, W = z.shape
    T = np.empty((16, BLOCK), np.float32)
    reach2 = ROUND * radius * radius
    for y in range(first, end):
        for x0 in range(0, W, BLOCK):
            n = min(BLOCK, W - x0)
            T[:9] = f4(0)
            c0, a, b = value[y, x0 : x0 + n], slope_x[y, x0 : x0 + n], slope_y[y, x0 : x0 + n]
            for dy in range(-radius, radius + 1, stride):
                yy = y + dy
                if yy < 0 or yy >= H:
                    continue
                T[9:14] = f4(0)
                for dx in range(-radius, radius + 1, stride):
                    i0, i1 = max(0, -dx - x0), min(n, W - dx - x0)
                    if i1 <= i0 or dx * dx + dy * dy > reach2:
                        continue
                    m, j0, fdx = i1 - i0, x0 + dx + i0, f4(dx)
                    _weigh(
                        z[yy, j0 : j0 + m],
                        q[yy, j0 : j0 + m],
                        t[yy, j0 : j0 + m],
                        c0[i0:i1],
                        a[i0:i1],
                        b[i0:i1],
                        m,
                        fdx,
                        f4(dy),
                        inv_tau2,
                        T[14],
                        T[15],
                    )
                    _add_weights(T[14], m, fdx, T[9, i0:], T[10, i0:], T[11, i0:])
                    _add_values(T[15], m, fdx, T[12, i0:], T[13, i0:])
                _add_row(f4(dy), n, T[9], T[10], T[11], T[0], T[1], T[3])
                _add_row_y(f4(dy), n, T[9], T[10], T[2], T[4], T[5])
                _add_row_z(f4(dy), n, T[12], T[13], T[6], T[7], T[8])
            _solve(c0, a, b, x0, n, ridge, T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], out_value[y], out_x[y], out_y[y])


def _rows(given: tuple[Any, ...], first: int, end: int) -> None:
    _planes(first, end, *given)


def robust_planes(
    disparity: Float32,
    weight: Float32,
    *,
    radius: int = 6,
    stride: int = 2,
    tau_px: float = 1.5,
    passes: int = 2,
    slopes: tuple[Float32, ...] | None = None,
    target: Float32 | None = None,
) -> Planes:
    """Per pixel the plane through its own surface: (value, d/dx, d/dy), each (H, W) float32.

    disparity : (H, W) px, finite everywhere; `weight` (H, W) >= 0 says how far to believe each pixel.
    radius    : half the window, px.  stride: every how many pixels it is sampled (neighbours say nearly the same).
    tau_px    : distance off the plane at which a neighbour stops counting; the first pass takes twice that.
    target    : what the planes are fitted to, when it is not the disparity that says who belongs to which plane.
    """
    value = disparity
    slope_x, slope_y = slopes if slopes is not None else (np.zeros_like(disparity), np.zeros_like(disparity))
    for k in range(passes):
        tau = tau_px * (2 if k == 0 and slopes is None else 1)
        result = (np.empty_like(disparity), np.empty_like(disparity), np.empty_like(disparity))
        given = (
            disparity,
            weight,
            disparity if target is None else target,
            value,
            slope_x,
            slope_y,
            radius,
            stride,
            f4(1 / tau**2),
            f4(0.05),
            *result,
        )
        in_pieces(partial(_rows, given), disparity.shape[0])
        value, slope_x, slope_y = result
    return value, slope_x, slope_y


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(v, a, b, here, n, dx, dy, weight, inv_tau2, S, SV, SA, SB):
    """Add what the planes of the pixels at (dx, dy) say at a strip of pixels."""
    for i in range(n):
        value = v[i] - a[i] * dx - b[i] * dy
        r = value - here[i]
        k = f4(1) - r * r * inv_tau2
        k = k if k > f4(0) else f4(0)
        w = weight * k * k
        S[i] += w
        SV[i] += w * value
        SA[i] += w * a[i]
        SB[i] += w * b[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _divide(S, SV, SA, SB, n, value, slope_x, slope_y):
    for i in range(n):
        inv = f4(1) / S[i]
        value[i] = SV[i] * inv
        slope_x[i] = SA[i] * inv
        slope_y[i] = SB[i] * inv


@njit(cache=True, nogil=True, error_model="numpy")
def _blend(first, end, value, slope_x, slope_y, inv_tau2, out_value, out_x, out_y):
    H, W = value.shape
    T = np.empty((4, W), np.float32)
    for y in range(first, end):
        T[:] = f4(0)
        for dy in range(-1, 2):
            yy = y + dy
            if yy < 0 or yy >= H:
                continue
            for dx in range(-1, 2):
                i0, i1 = max(0, -dx), min(W, W - dx)
                m, j0 = i1 - i0, i0 + dx
                if m <= 0:
                    continue
                weight = f4((2 - abs(dx)) * (2 - abs(dy)))
                v, a, b = value[yy, j0 : j0 + m], slope_x[yy, j0 : j0 + m], slope_y[yy, j0 : j0 + m]
                _gather(v, a, b, value[y, i0:i1], m, f4(dx), f4(dy), weight, inv_tau2, T[0, i0:], T[1, i0:], T[2, i0:], T[3, i0:])
        _divide(T[0], T[1], T[2], T[3], W, out_value[y], out_x[y], out_y[y])


def blended(planes: Planes, *, tau_px: float) -> Planes:
    """Each plane averaged with those of its eight neighbours that agree with it to `tau_px`.

    A fit that samples every other pixel leaves neighbours with nothing in common; a 1-2-1 blend gives each sampling phase
    the same weight, so that no grid shows under a raking light.
    """
    result = (np.empty_like(planes[0]), np.empty_like(planes[0]), np.empty_like(planes[0]))
    given = (*planes, f4(1 / tau_px**2), *result)
    in_pieces(lambda first, end: _blend(first, end, *given), planes[0].shape[0])
    return result
