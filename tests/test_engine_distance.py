"""Disparity to Z in one pass: the formula of docs/conventions.md, and what has no Z says so everywhere at once."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.engine.distance import distances

f4 = np.float32
HW = (37, 23)
FAR, GUESS = 16, 8


@pytest.mark.parametrize("stretched", [False, True])
def test_the_formula_and_its_gaps(stretched: bool) -> None:
    rng = np.random.default_rng(0)
    disparity, sigma, sure = (rng.uniform(low, high, HW).astype(f4) for low, high in ((-4, 20), (0.01, 1), (0, 1)))
    disparity[3] = np.nan
    flags = rng.choice([0, 1, GUESS], HW).astype(np.uint16)
    stretch = rng.uniform(0.9, 1.1, HW) if stretched else np.ones(1)
    got_flags, got_sure, got_sigma = flags.copy(), sure.copy(), sigma.copy()
    Z, Z_sigma = distances(
        disparity, got_flags, got_sure, got_sigma, per=60.0, doffs=3.0, stretch=stretch, smallest=0.25, far_flag=FAR, dropped=GUESS
    )
    off = disparity.astype(np.float64) + 3
    far = off < 0.25
    here = ~far & np.isfinite(disparity) & (flags != GUESS)
    assert np.array_equal(got_flags, np.where(far, flags | FAR, flags))
    assert np.allclose(Z[here], (60 / off * stretch)[here], rtol=1e-6)
    assert np.allclose(Z_sigma[here], (60 / off**2 * stretch * sigma)[here], rtol=1e-5)
    assert np.array_equal(got_sure, np.where(here, sure, 0))
    for a, kept in ((Z, None), (Z_sigma, None), (got_sigma, sigma)):
        assert np.isnan(a[~here]).all()
        assert kept is None or np.array_equal(a[here], kept[here])
