"""Windows fused into row kernels say what OpenCV's box filter says of what is seen, to the borders, however small the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.engine.evidence import held_evidence, left_over
from stereorelight.engine.locking import locking_tables
from stereorelight.engine.photometric import photometric_evidence, row_splines, spline_residual
from stereorelight.engine.pyramid import halved
from stereorelight.engine.windows import Seen, less_local_means

f4 = np.float32
TABLES = locking_tables(0.9)
SIZES = [(40, 53), (3, 20), (20, 3), (1, 9), (9, 1)]


def mean_of(a: np.ndarray, here: np.ndarray, width: int) -> np.ndarray:
    """Mean over the seen pixels of a square; 0 where there is none."""
    total, count = (cv2.blur(b.astype(np.float64), (width, width)) for b in (a * here, here))
    return total / np.maximum(count, 1e-9)


@pytest.mark.parametrize("size", SIZES)
def test_less_local_means(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    seen = Seen.where(rng.random(size) > 0.4)
    a, b = (rng.random(size, dtype=f4) * seen.here for _ in range(2))
    for mine, given in zip(less_local_means(a, b, seen), (a, b), strict=True):
        assert np.abs(mine - seen.here * (given - mean_of(given, seen.here, 7))).max() < 1e-5


def test_what_is_not_seen_says_nothing_of_what_lies_beside_it() -> None:
    """A difference of exposure over what is seen leaves nothing, whatever stands in the ground beside it that is not."""
    here = np.ones((30, 40), np.bool_)
    here[:, 20:] = False
    seen = Seen.where(here)
    a, b = (np.where(here, f4(v), f4(0)) for v in (5, -3))
    for mine in less_local_means(a, b, seen):
        assert np.abs(mine).max() < 1e-5


@pytest.mark.parametrize("size", SIZES)
def test_held_evidence_is_evidence_by_local_noise_and_a_prior(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    d, matched = (rng.uniform(0, 5, size).astype(f4) for _ in range(2))
    trust = rng.choice([0.02, 0.1, 1.0], size).astype(f4)
    seen = Seen.where(trust > f4(0.02))
    residual, rate = (rng.normal(0, 3, size).astype(f4) * seen.here for _ in range(2))
    *got, small = held_evidence(d, residual, rate, trust, seen, matched, most2=20.0, floor2=0.5, grain2=2.0, tables=TABLES, priors=(0.001, 0.03))
    noise2 = np.maximum(mean_of(np.minimum(residual**2, f4(20)), seen.here, 9), 0.5).astype(f4)
    weight, pull = photometric_evidence(d, residual, rate, noise2, mean_of(rate * rate, seen.here, 9).astype(f4), trust, grain2=2.0, tables=TABLES)
    prior = np.where(seen.here > 0, f4(0.03), f4(0.001))
    for mine, theirs in zip(got, (weight + prior, pull + prior * (matched - d))):
        assert np.abs(mine - theirs).max() < 1e-4 * np.abs(theirs).max()
    np.testing.assert_array_equal(small, halved(halved(got[0])))


def test_what_is_left_over_is_the_difference_less_its_local_means() -> None:
    rng = np.random.default_rng(2)
    left, right, d = (rng.uniform(0, 9, (40, 53)).astype(f4) for _ in range(3))
    seen = Seen.where(rng.random((40, 53)) > 0.2)
    splines = row_splines(left), row_splines(right)
    wanted = less_local_means(*spline_residual(left, *splines, d, seen.here), seen)
    for mine, theirs in zip(left_over(left, *splines, d, seen), wanted, strict=True):
        np.testing.assert_array_equal(mine, theirs)
