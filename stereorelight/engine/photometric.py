"""What the two pictures say about a disparity: brightness residual, and how fast it changes with disparity.

In: grey pictures (H, W) float32, rows agreeing, and a disparity (H, W) px.  Out: (H, W) float32 each."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import kernel
from stereorelight.engine.locking import FRACTIONS, POLE, Tables, locking_tables
from stereorelight.engine.rows import in_pieces

f4 = np.float32
i4 = np.int32
_leaf = kernel(fastmath=False, noalias=True)
PLACED2 = f4(0.05**2)  # px^2: how well a pixel's own place is known at all, between lenses, samples and splines


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _at(row, x, W):
    """Catmull-Rom value and slope of a row at x, the border repeated."""
    x = min(max(x, f4(0)), f4(W - 1))
    k = int(x)
    t = x - f4(k)
    a, b, c, d = row[max(k - 1, 0)], row[k], row[min(k + 1, W - 1)], row[min(k + 2, W - 1)]
    c1, c2, c3 = f4(0.5) * (c - a), a - f4(2.5) * b + f4(2) * c - f4(0.5) * d, f4(0.5) * (d - a) + f4(1.5) * (b - c)
    return b + t * (c1 + t * (c2 + t * c3)), c1 + t * (f4(2) * c2 + t * f4(3) * c3)


@njit(cache=True, nogil=True, error_model="numpy")
def _residual(first, end, left, right, disparity, residual, rate):
    W = left.shape[1]
    for y in range(first, end):
        row, other = left[y], right[y]
        for x in range(W):
            value, slope = _at(other, f4(x) - disparity[y, x], W)
            here = f4(0.5) * (row[min(x + 1, W - 1)] - row[max(x - 1, 0)])
            residual[y, x] = row[x] - value
            # Both eyes' slopes: the mean is right to second order where either alone is right to first.
            rate[y, x] = f4(-0.5) * (slope + here)


def brightness_residual(left: Float32, right: Float32, disparity: Float32) -> tuple[Float32, Float32]:
    """left - right(x - d), grey levels, and the change of right(x - d) per pixel of disparity."""
    residual, rate = np.empty_like(left), np.empty_like(left)
    in_pieces(lambda first, end: _residual(first, end, left, right, disparity, residual, rate), left.shape[0])
    return residual, rate


@njit(cache=True, nogil=True, error_model="numpy")
def _spline_row(row, pole, out):
    """Coefficients of the cubic spline through a row, mirrored at both ends."""
    n = row.size
    total, power = row[0], pole
    for k in range(1, min(n, 16)):
        total += power * row[k]
        power *= pole
    out[0] = total
    for k in range(1, n):
        out[k] = row[k] + pole * out[k - 1]
    out[n - 1] = pole / (pole * pole - f4(1)) * (out[n - 1] + pole * out[max(n - 2, 0)])
    for k in range(n - 2, -1, -1):
        out[k] = pole * (out[k + 1] - out[k])
    for k in range(n):
        out[k] *= f4(6)


@njit(cache=True, nogil=True, error_model="numpy")
def _splines(first, end, picture, pole, out):
    for y in range(first, end):
        _spline_row(picture[y], pole, out[y])


def row_splines(picture: Float32) -> Float32:
    """(H, W) coefficients of the cubic spline through each row: between pixels it keeps detail that shorter cubics lose."""
    out = np.empty_like(picture)
    in_pieces(lambda first, end: _splines(first, end, picture, POLE, out), picture.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _with_ends(row, out):
    """A row with its neighbours mirrored at both ends: one place before it, two after it."""
    W = row.size
    out[0], out[1 : W + 1] = row[min(1, W - 1)], row
    out[W + 1], out[W + 2] = row[max(W - 2, 0)], row[max(W - 3, 0)]


@_leaf
def _difference_row(row, own, other, d, seen, residual, rate):
    W = row.size
    for x in range(W):
        u = min(max(f4(x) - d[x], f4(0)), f4(W - 1))
        k = i4(u)
        t = u - f4(k)
        s = f4(1) - t
        c0, c1, c2, c3 = other[k], other[k + 1], other[k + 2], other[k + 3]
        value = s * s * s * c0 + (f4(4) - f4(6) * t * t + f4(3) * t * t * t) * c1 + (f4(4) - f4(6) * s * s + f4(3) * s * s * s) * c2 + t * t * t * c3
        slope = -s * s * c0 + (f4(3) * t * t - f4(4) * t) * c1 + (f4(4) * s - f4(3) * s * s) * c2 + t * t * c3
        here = own[x + 2] - own[x]
        residual[x] = seen[x] * (row[x] - f4(1 / 6) * value)
        # Both eyes' slopes: the mean is right to second order where either alone is right to first.
        rate[x] = f4(-0.25) * seen[x] * (slope + here)


@njit(cache=True, nogil=True, error_model="numpy")
def differences(first, end, left, left_spline, right_spline, disparity, seen, residual, rate):
    """Rows of `spline_residual`."""
    W = left.shape[1]
    own, other = np.empty(W + 3, np.float32), np.empty(W + 3, np.float32)
    for y in range(first, end):
        _with_ends(left_spline[y], own)
        _with_ends(right_spline[y], other)
        _difference_row(left[y], own, other, disparity[y], seen[y], residual[y], rate[y])


def spline_residual(
    left: Float32, left_spline: Float32, right_spline: Float32, disparity: Float32, seen: Float32 | None = None
) -> tuple[Float32, Float32]:
    """left - right(x - d), grey levels, and the change of right(x - d) per pixel of disparity; pictures as `row_splines` gives them.

    seen : (H, W), 1 or 0: both are 0 where it is."""
    residual, rate = np.empty_like(left), np.empty_like(left)
    given = (left, left_spline, right_spline, disparity, np.ones_like(left) if seen is None else seen, residual, rate)
    in_pieces(lambda first, end: differences(first, end, *given), left.shape[0])
    return residual, rate


@_leaf
def evidence_row(disparity, residual, rate, left2, floor2, rate2, trust, grain2, locking, steepness, noise, weight, pull):
    """A row of `photometric_evidence`."""
    for x in range(disparity.size):
        u = f4(x) - disparity[x]
        t = i4((u - np.floor(u)) * f4(FRACTIONS))
        e, g, n2 = residual[x], rate[x], max(left2[x], floor2)
        k = f4(1) / (f4(1) + e * e / (f4(9) * n2))
        k *= k
        # Of the squared slope, this share is texture; the rest is noise and says nothing.
        real = f4(1) - n2 * steepness[t] / max(rate2[x], f4(1e-6))
        real = min(max(real, f4(0.03)), f4(1))
        k *= trust[x] * real
        # Only grain, new in every pixel, draws to half pixels: no floor of the noise does, and nothing else that the eyes differ by.
        white = min(grain2 * noise[t], left2[x]) / n2
        w = g * g / n2 * k * real
        # However steep a pixel is, it is no surer than its place: one edge says no more than some texture.
        least = f4(1) / (f4(1) + PLACED2 * w)
        weight[x] = w * least
        pull[x] = (g * e / n2 - (locking[t] * white if g != f4(0) else f4(0))) * k * least


@njit(cache=True, nogil=True, error_model="numpy")
def _evidence(first, end, disparity, residual, rate, noise2, rate2, trust, grain2, locking, steepness, noise, weight, pull):
    for y in range(first, end):
        evidence_row(disparity[y], residual[y], rate[y], noise2[y], f4(0), rate2[y], trust[y], grain2, locking, steepness, noise, weight[y], pull[y])


def photometric_evidence(
    disparity: Float32,
    residual: Float32,
    rate: Float32,
    noise2: Float32,
    rate2: Float32,
    trust: Float32,
    *,
    grain2: float = np.inf,
    tables: Tables | None = None,
) -> tuple[Float32, Float32]:
    """What each pixel's brightness says of its disparity: weight (inverse variance, 1/px^2) and weight times (asked - had).

    residual, rate : as `spline_residual` gives them, less their local means: a difference of exposure is no disparity.
    noise2, rate2  : (H, W) local mean squares of both, grey levels squared; noise2 > 0.   trust : (H, W) 0..1.
    grain2         : variance of either picture's white grain, grey levels squared; all of the noise is, where that is no less.
    tables         : of `locking_tables`; left out, those of white grain.
    A residual three times the local noise counts a quarter, and no pixel is surer of its place than `PLACED2`.  What noise alone adds to the
    slope, and the pull of grain towards half pixels, are taken off.
    """
    weight, pull = np.empty_like(disparity), np.empty_like(disparity)
    given = (disparity, residual, rate, noise2, rate2, trust, f4(grain2), *(tables or locking_tables(1.0)), weight, pull)
    in_pieces(lambda first, end: _evidence(first, end, *given), disparity.shape[0])
    return weight, pull
