"""Windows fused into row kernels say what OpenCV's box filter says, to the borders, however small the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.engine.photometric import held_evidence, photometric_evidence
from stereorelight.engine.windows import less_local_means

f4 = np.float32
SIZES = [(40, 53), (3, 20), (20, 3), (1, 9), (9, 1)]


@pytest.mark.parametrize("size", SIZES)
def test_less_local_means(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    a, b, trust = (rng.random(size, dtype=f4) for _ in range(3))
    got_a, got_b = less_local_means(a, b, trust, least=0.4)
    assert np.abs(got_a - (a - cv2.blur(a, (7, 7)))).max() < 1e-5
    assert np.abs(got_b - np.where(trust > f4(0.4), b - cv2.blur(b, (7, 7)), 0)).max() < 1e-5


@pytest.mark.parametrize("size", SIZES)
def test_held_evidence_is_evidence_by_local_noise_and_a_prior(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    d, matched = (rng.uniform(0, 5, size).astype(f4) for _ in range(2))
    residual, rate = (rng.normal(0, 3, size).astype(f4) for _ in range(2))
    trust = rng.choice([0.02, 0.1, 1.0], size).astype(f4)
    got = held_evidence(d, residual, rate, trust, matched, most2=20.0, floor2=0.5, grain2=2.0, unseen=0.02, priors=(0.001, 0.03))
    noise2 = np.maximum(cv2.blur(np.minimum(residual**2, f4(20)), (9, 9)), f4(0.5))
    weight, pull = photometric_evidence(d, residual, rate, noise2, cv2.blur(rate * rate, (9, 9)), trust, grain2=2.0)
    prior = np.where(trust <= f4(0.02), f4(0.001), f4(0.03))
    for mine, theirs in zip(got, (weight + prior, pull + prior * (matched - d))):
        assert np.abs(mine - theirs).max() < 1e-4 * np.abs(theirs).max()
