"""Grain between pixels, of plates and of what was resampled from them, against grain that is drawn and looked at."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.engine.locking import grain_correlation, locking_tables, roughness
from stereorelight.engine.photometric import photometric_evidence, row_splines, spline_residual
from stereorelight.engine.resample import EVEN, resample
from stereorelight.stereo.proxy import grain_of, matching_proxy

STEPS = (1.0, 0.909, 0.8)
f4 = np.float32


def grain(step: float, seed: int, *, sigma: float = 4.0, size: int = 500) -> np.ndarray:
    """Grain about grey 100, looked up `step` plate pixels apart, and not at the plate's own pixels in any row."""
    plate = np.random.default_rng(seed).normal(100, sigma, (size, size, 1)).astype(f4)
    if step == 1:
        return plate[..., 0]
    v, u = np.mgrid[0 : size * 0.95 : step, 0 : size * 0.95 : step]
    return resample(plate, np.stack([5.3 + u + 0.003 * v, 5.1 + v - 0.004 * u], axis=-1).astype(f4), EVEN)[20:-20, 20:-20, 0]


@pytest.mark.parametrize("step", STEPS)
def test_resampled_grain_hangs_together_as_told(step: float) -> None:
    """The correlation of looked-up white noise, lag by lag, rows and columns."""
    rho = grain_correlation(step)
    assert rho[0] == 1
    seen = grain(step, 1) - 100.0
    power = (seen * seen).mean()
    for lag in range(1, 6):
        for a, b in ((seen[:, lag:], seen[:, :-lag]), (seen[lag:], seen[:-lag])):
            assert (a * b).mean() / power == pytest.approx(rho[lag], abs=0.015)


@pytest.mark.parametrize("step", STEPS)
def test_grain_is_told_as_strong_as_it_is(step: float) -> None:
    """The mask sees resampled grain at half of its strength and less."""
    grey = grain(step, 2)
    assert grain_of(grey, step) == pytest.approx(grey.std(), rel=0.1)
    assert roughness(1.0) == 1
    if step < 1:
        assert grain_of(grey) < 0.8 * grey.std()
    light = np.repeat((grey[..., None] / 255) ** 2, 3, axis=-1).astype(f4)
    pair = matching_proxy(light, light, steps=(step, step))
    assert pair.noise() == pytest.approx(pair.left[..., 1].std(), rel=0.1)
    assert pair.flipped().steps == (step, step)


@pytest.mark.parametrize("step", STEPS)
def test_grain_alone_pulls_nowhere(step: float) -> None:
    """Two pictures of nothing but grain: without the correction matches are drawn to half pixels."""
    left, right = grain(step, 3), grain(step, 4)
    tables = locking_tables(step)
    for fraction in (0.2, 0.35, 0.65, 0.8):
        d = np.full_like(left, 5 + fraction)
        residual, rate = (a[:, 8:-8] for a in spline_residual(left, row_splines(left), row_splines(right), d))
        residual, rate = residual - residual.mean(), rate - rate.mean()
        noise2 = np.full_like(residual, float((residual * residual).mean()))
        given = (d[:, 8:-8], residual, rate, noise2, np.full_like(noise2, 1e9), np.ones_like(noise2))
        weight, pull = photometric_evidence(*given, tables=tables)
        _, drawn = photometric_evidence(*given, grain2=0.0)
        assert abs(pull.sum()) < 0.12 * abs(drawn.sum())
        assert abs(drawn.sum() / weight.sum()) > 0.015
        assert float(noise2[0, 0] / left.var()) == pytest.approx(tables[2][round(1024 * (1 - fraction))], rel=0.03)
        told = tables[1][round(1024 * (1 - fraction))] * noise2[0, 0]
        assert float((rate * rate).mean()) == pytest.approx(told, rel=0.05)
