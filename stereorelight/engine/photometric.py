"""What the two pictures say about a disparity: brightness residual, and how fast it changes with disparity.

In: grey pictures (H, W) float32, rows agreeing, and a disparity (H, W) px.  Out: (H, W) float32 each."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32


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
    in_row_blocks(lambda first, end: _residual(first, end, left, right, disparity, residual, rate), left.shape[0])
    return residual, rate


@njit(cache=True, nogil=True, error_model="numpy")
def _measured(first, end, disparity, residual, local, rate, trust, inv_noise2, inv_outlier2, prior, target, weight):
    W = disparity.shape[1]
    for y in range(first, end):
        for x in range(W):
            e, g = residual[y, x] - local[y, x], rate[y, x]
            k = f4(1) / (f4(1) + e * e * inv_outlier2)
            k = k * k * inv_noise2
            w = prior + g * g * k
            target[y, x] = disparity[y, x] + g * e * k / w
            weight[y, x] = w * trust[y, x]


def measured_disparity(
    disparity: Float32, residual: Float32, local: Float32, rate: Float32, trust: Float32, *, noise: float, outlier: float, prior: float
) -> tuple[Float32, Float32]:
    """The disparity that each pixel's brightness asks for, and its weight (inverse variance, 1/px^2, times trust).

    local   : (H, W) local mean of the residual, taken off: a difference of exposure is no disparity.
    noise   : standard deviation of the residual, grey levels.   outlier: residual at which a pixel counts a quarter.
    prior   : weight of the disparity as it was, 1/px^2.
    """
    target, weight = np.empty_like(disparity), np.empty_like(disparity)
    given = (f4(1 / noise**2), f4(1 / outlier**2), f4(prior), target, weight)
    in_row_blocks(lambda first, end: _measured(first, end, disparity, residual, local, rate, trust, *given), disparity.shape[0])
    return target, weight


@njit(cache=True, nogil=True, error_model="numpy")
def _believed(first, end, coefficients, confirmed, unseen, matched, flow, disparity, texture, unlike, spread, low, high, out):
    W = disparity.shape[1]
    for y in range(first, end):
        for x in range(W):
            d = disparity[y, x]
            moved = abs(matched[y, x] - d)
            found = moved == moved
            t = coefficients[0]
            t += coefficients[1] if confirmed[y, x] else f4(0)
            t += coefficients[2] if abs(flow[y, x] - d) <= f4(1) else f4(0)  # false for NaN
            t += coefficients[3] * (min(moved, f4(3)) if found else f4(0))
            t += f4(0) if found else coefficients[4]
            t += coefficients[5] * np.log(f4(1) + texture[y, x])
            t += coefficients[6] * np.log(f4(1) + unlike[y, x])
            t += coefficients[7] * min(spread[y, x], f4(6)) / f4(6)
            t += coefficients[8] if unseen[y, x] else f4(0)
            out[y, x] = min(max(f4(1) / (f4(1) + np.exp(-t)), low), high)


def believed(
    coefficients: Float32,
    confirmed: Bool,
    unseen: Bool,
    matched: Float32,
    flow: Float32,
    disparity: Float32,
    texture: Float32,
    unlike: Float32,
    spread: Float32,
    *,
    low: float,
    high: float,
) -> Float32:
    """The logistic weighing of the evidence that stereo/confidence.py names; every array (H, W)."""
    out = np.empty_like(disparity)
    given = (coefficients, confirmed, unseen, matched, flow, disparity, texture, unlike, spread, f4(low), f4(high), out)
    in_row_blocks(lambda first, end: _believed(first, end, *given), disparity.shape[0])
    return out
