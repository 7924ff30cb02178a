"""What grain does between pixels: how far matches are drawn to half pixels (pixel locking), and what of a slope is grain.

In: how far apart on its plate a picture's pixels were taken, `step` in plate pixels; 1 for the plate itself, whose grain is white.
Out: tables by fraction of a pixel, (FRACTIONS + 1,) float32, and how rough grain is.
A rectified picture finer than its plate holds none of the finest grain: what is there hangs together from pixel to pixel, changes less
between them, and looks calmer than it is to a mask that knows no ramps."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.resample import EVEN, LOBES

FRACTIONS = 1024  # steps of the tables
POLE = np.float32(np.sqrt(3.0) - 2.0)  # of the cubic spline's recursive filter (Unser 1999)
REACH = 20  # pixels to each side that a spline's value still hangs on
# Evidence counts less the more the eyes differ (engine/photometric.py): E[k e^2] / (E[k] E[e^2]) of normal e and k = 1 / (1 + e^2/9)^2.
ROBUST_SHARE = 0.733
Tables = tuple[Float32, Float32, Float32]


@lru_cache(maxsize=64)
def grain_correlation(step: float) -> Float64:
    """Correlation of a picture's grain along a row or column, at 0, 1, 2 ... pixels, (2 REACH,): of white grain looked up by
    `resample` with its EVEN kernel."""
    rho = np.zeros(2 * REACH)
    rho[0] = 1
    if step == 1:
        return rho
    steps = len(EVEN) - 1
    kernel = np.concatenate([EVEN[:-1, j] for j in range(2 * LOBES - 1, -1, -1)])  # from -LOBES to LOBES, `steps` to a pixel
    for k in range(1, rho.size):
        shift = round(k * step * steps)
        rho[k] = (kernel[shift:] * kernel[: kernel.size - shift]).sum() / (kernel * kernel).sum() if shift < kernel.size else 0
    return rho


def roughness(step: float, *, apart: int = 1) -> float:
    """The size of the mask 1 -2 1, -2 4 -2, 1 -2 1 on grain, over that on white grain of the same strength; its taps `apart` px."""
    rho = grain_correlation(step)
    return float((6 - 8 * rho[apart] + 2 * rho[2 * apart]) / 6)


@lru_cache(maxsize=64)
def locking_tables(step: float) -> Tables:
    """What interpolation by a cubic spline does to grain of variance one, by fraction of a pixel.

    pull  : half the covariance of an interpolated value and its slope, over `noise`: grain is least half way between pixels, so that is
            where it draws a match to; of it, what is left under weights that count large differences less.
    rate  : variance of the mean of both eyes' slopes, over `noise`.
    noise : variance of (pixel minus value).
    """
    n = 2 * REACH + 1
    z = float(POLE)
    # The cardinal spline's coefficients are a two-sided decaying power of the pole.
    c = np.array([6 * -z / (1 - z * z) * z ** abs(k - REACH) for k in range(n)])
    t = np.linspace(0, 1, FRACTIONS + 1)
    s = 1 - t
    value = (s**3 / 6, (4 - 6 * t**2 + 3 * t**3) / 6, (4 - 6 * s**2 + 3 * s**3) / 6, t**3 / 6)
    slope = (-(s**2) / 2, (3 * t**2 - 4 * t) / 2, (4 * s - 3 * s**2) / 2, t**2 / 2)
    weights, slopes = (np.stack([sum(c[k + j - 1] * b[j] for j in range(4)) for k in range(1, n - 2)]) for b in (value, slope))
    lags = np.abs(np.subtract.outer(np.arange(n - 3), np.arange(n - 3)))
    hangs = grain_correlation(step)[lags]
    noise = 1 + (weights * (hangs @ weights)).sum(axis=0)
    covariance = (weights * (hangs @ slopes)).sum(axis=0)
    steep = (slopes * (hangs @ slopes)).sum(axis=0)
    pull, rate = ROBUST_SHARE * 0.5 * covariance / noise, 0.25 * (steep + steep[0]) / noise
    return pull.astype(np.float32), rate.astype(np.float32), noise.astype(np.float32)
