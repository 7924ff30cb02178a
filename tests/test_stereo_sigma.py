"""What depth says of its own error, on pairs that had no part in the fit of what it says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from stereorelight.compare.motorcycle import motorcycle
from stereorelight.compare.normals import angle_deg
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo.depth import recover
from stereorelight.stereo.proxy import grain_of
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.refine import clumped
from stereorelight.surface.normals import normals_and_sigma, normals_from_depth
from stereorelight.synth.render import render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named
from tests.benchmarks.bench_depth import pair_of_plates
from tests.benchmarks.bench_depth_scenes import coded, grained

Judged = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # error of disparity and what is told of it, px; the same of normals, degrees


def judged(left: np.ndarray, right: np.ndarray, rectified, Z: np.ndarray, N: np.ndarray, seen: np.ndarray) -> Judged:
    rig = rectified.rig
    found = recover(left, right, rectified).frame
    per = rig.left.fx * rig.baseline_m
    normals, sigma = normals_and_sigma(
        found["Z"], rig.left, confidence=found["confidence"], noise_per_m=MATCH_NOISE_PX / per, Z_sigma=found["Z_sigma"]
    )
    assert sigma is not None
    assert np.isfinite(sigma[np.isfinite(normals[..., 0])]).all()
    angle = angle_deg(normals, N)
    known = seen & np.isfinite(angle) & np.isfinite(sigma)
    return np.abs(per / found["Z"] - per / Z)[known], found["disparity_sigma"][known], angle[known], sigma[known]


def in_five(error: np.ndarray, sigma: np.ndarray) -> list[float]:
    """What 68 % of the errors stay within over what was told, in five bins of what was told."""
    edges = np.quantile(sigma, np.linspace(0, 1, 6))
    bins = [(sigma >= low) & (sigma <= high) for low, high in pairwise(edges)]
    return [float(np.quantile(error[one], 0.683) / sigma[one].mean()) for one in bins]


@pytest.fixture(scope="module")
def real() -> dict[float, Judged]:
    left, right, rectified = pair_of_plates()
    pair, rng = motorcycle(), np.random.default_rng(7)
    rig = rectified.rig
    per = rig.left.fx * rig.baseline_m
    Z = np.where(np.isfinite(pair.disparity), per / (pair.disparity + rig.doffs_px), np.nan).astype(np.float32)
    N = normals_from_depth(Z, rig.left, noise_per_m=0.1 / per)  # the scanned truth is rough by itself
    seen = pair.nonoccluded & np.isfinite(Z)
    pairs = {0.0: (left, right), 0.01: (grained(left, 0.01, rng), grained(right, 0.01, rng))}
    other = np.random.default_rng(3)
    pairs[0.02] = (grained(left, 0.02, other), grained(right, 0.02, other))
    return {share: judged(*plates, rectified, Z, N, seen) for share, plates in pairs.items()}


@pytest.mark.parametrize("grain", [0.0, 0.01, 0.02])
def test_sigma_of_normals_is_their_error_on_a_real_pair(real, grain) -> None:
    _, _, angle, sigma = real[grain]
    ratios = in_five(angle, sigma)
    assert min(ratios) > 1 / 1.3, ratios
    assert max(ratios) < 1.3, ratios
    assert np.quantile(sigma, 0.9) > 10 * np.quantile(sigma, 0.1), "or the bins would prove nothing"


def test_sigma_is_the_error_on_rendered_scenes_without_a_part_in_the_fit(real) -> None:
    """A card and a box before walls, clean and with 1 % of grain, and Motorcycle, in one heap: normals within 30 % in each of five bins."""
    heap = [real[0.0], real[0.01]]
    for name in ("two_planes", "box"):
        rig = parallel_rig((320, 180))
        shot = render(scene_named(name), rig, samples=2)
        for noise in (0.0, 0.01):
            rng = np.random.default_rng(1)
            plates = [
                coded(shot.frame(e)["plate"] + noise * rng.standard_normal(shot.left["plate"].shape).astype(np.float32)) for e in ("left", "right")
            ]
            heap.append(judged(*plates, rectification(rig), shot.left["Z"], shot.left["N"], shot.left["flags"] == 0))
    few = [[a[:: max(1, a.size // 20_000)] for a in one] for one in heap]  # every pair counts alike
    error, told, angle, sigma = (np.concatenate(part) for part in zip(*few, strict=True))
    ratios = in_five(angle, sigma)
    assert min(ratios) > 1 / 1.3, ratios
    assert max(ratios) < 1.3, ratios
    ratios = in_five(error, told)
    assert min(ratios) > 0.5, ratios
    assert max(ratios) < 1.6, ratios


def test_errors_that_hang_together_are_told_from_noise() -> None:
    rng = np.random.default_rng(2)
    weight = np.full((203, 301), 4, np.float32)
    white = (2 * rng.standard_normal(weight.shape)).astype(np.float32)  # its variance is its weight
    alone = clumped(weight, white)
    assert alone.shape == weight.shape
    assert np.median(alone) == pytest.approx(1, abs=0.25)
    together = clumped(weight, np.kron(white[::4, ::4], np.ones((4, 4), np.float32))[:203, :301].copy())
    assert np.median(together) == pytest.approx(16, rel=0.3)


def test_grain_is_measured_under_any_ramp() -> None:
    y, x = np.mgrid[:203, :301].astype(np.float32)
    noise = np.random.default_rng(3).standard_normal(x.shape).astype(np.float32)
    assert grain_of(20 + 0.3 * x + 0.2 * y + 0.001 * x * y) < 0.05
    assert grain_of(20 + 0.3 * x + 0.2 * y + 3 * noise) == pytest.approx(3, rel=0.1)
    assert grain_of(np.zeros((2, 2), np.float32)) == 0
