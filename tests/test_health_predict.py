"""The prediction against a simulation, and the range against a known scene."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.camera import Camera, RectifiedRig
from stereorelight.health.predict import RAYLEIGH_MEDIAN, judge_prediction, predict, slope_sigma
from stereorelight.health.range import judge_range, measure_range

CAMERA = Camera.from_fov(40, (1920, 1080))
RIG = RectifiedRig(left=CAMERA, right=CAMERA, baseline_m=0.065)


@pytest.mark.parametrize("window", [9, 17])
def test_normal_noise_is_what_a_simulation_gives(window: int) -> None:
    sigma, distance = 2.0, 1.5  # well above the floor, which is not of grain
    v, u = np.mgrid[:window, :window] - (window - 1) / 2
    noise = np.random.default_rng(0).normal(0, sigma, (4000, window * window))
    a, b = (noise @ k.ravel() / (k * k).sum() for k in (u, v))
    np.testing.assert_allclose(a.std(), slope_sigma(sigma, window), rtol=0.05)
    q = CAMERA.fx * RIG.baseline_m / distance
    angle = np.degrees(np.arctan(np.hypot(a, b) * CAMERA.fx / q))
    said = np.degrees(np.arctan(RAYLEIGH_MEDIAN * slope_sigma(sigma, window) * CAMERA.fx / q))
    np.testing.assert_allclose(np.median(angle), said, rtol=0.2)
    found = predict(RIG, distance, grain=sigma / np.sqrt(2), texture=1.0, window_px=window)
    np.testing.assert_allclose(found.normal_deg, np.median(angle), rtol=0.2)


def test_recommended_baseline_and_distance_give_what_is_wanted() -> None:
    said = predict(RIG, 3.0, grain=0.02, texture=0.02)
    wider = RectifiedRig(left=CAMERA, right=CAMERA, baseline_m=said.baseline_for_m)
    assert predict(wider, 3.0, grain=0.02, texture=0.02).normal_deg == pytest.approx(5, rel=1e-6)
    assert predict(RIG, said.distance_for_m, grain=0.02, texture=0.02).normal_deg == pytest.approx(5, rel=1e-6)
    assert judge_prediction(predict(RIG, 0.6, grain=0.001, texture=0.05)).level == "good"


def test_range_says_near_far_and_behind() -> None:
    Z = np.random.default_rng(0).uniform(1.2, 3.0, 4000)
    d = RIG.disparity_from_depth(Z).astype(np.float32)
    clean = measure_range(d, RIG, near_m=1.0, far_m=4.0)
    assert clean.nearest_m == pytest.approx(1.2, rel=0.02)
    assert clean.farthest_m == pytest.approx(3.0, rel=0.02)
    assert judge_range([clean], near_m=1.0, far_m=4.0).level == "good"
    assert judge_range([measure_range(d, RIG, near_m=1.5)], near_m=1.5).level == "bad"
    assert judge_range([measure_range(-d, RIG)]).level == "bad"
    assert judge_range([measure_range(d[:3], RIG)]).level == "unknown"
