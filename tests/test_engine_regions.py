"""Regions of a disparity, and what shifting a place would cost, against the plain loops that the kernels stand for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.engine.regions import ABOUT, PARTS, WINDOW, costs_at, regions, shifted_costs

f4 = np.float32
LOW, COUNT = -6, 24


@given(d=hnp.arrays(f4, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.sampled_from([0.0, 1.0, 2.0, 5.0, float("nan")])))
def test_regions_hang_together_and_are_as_large_as_can_be(d: np.ndarray) -> None:
    label, count = regions(d, step=1.0)
    assert np.array_equal(label < 0, np.isnan(d))
    assert set(np.unique(label[label >= 0])) == set(range(count))
    for a, b, p, q in ((label[1:], label[:-1], d[1:], d[:-1]), (label[:, 1:], label[:, :-1], d[:, 1:], d[:, :-1])):
        near = np.abs(p - q) <= 1
        assert (a[near] == b[near]).all()
    for one in range(count):
        values = np.unique(d[label == one])
        assert values.size == 1 or np.diff(values).max() <= 1


def pictures(seed: int, true: float) -> tuple[np.ndarray, np.ndarray]:
    """Two smooth pictures, the same but for `true` px along the row."""
    rng = np.random.default_rng(seed)
    x, y = np.arange(-40, 120), np.arange(30)[:, None]
    waves = [(rng.uniform(0.1, 0.7), rng.uniform(-0.5, 0.5), rng.uniform(0, 6), rng.uniform(5, 20)) for _ in range(12)]
    eyes = [sum(a * np.cos(u * (x + shift) + v * y + p) for u, v, p, a in waves).astype(f4)[:, 40:120] for shift in (0.0, true)]
    return np.ascontiguousarray(eyes[0]), np.ascontiguousarray(eyes[1])


@pytest.mark.parametrize("true", [3.0, 3.5, -2.25])
def test_the_true_disparity_costs_next_to_nothing(true: float) -> None:
    left, right = pictures(1, true)
    ys, xs = (a.ravel().astype(np.int32) for a in np.mgrid[WINDOW : 30 - WINDOW : 4, 30:60:5])
    found = np.round(true) + np.zeros(ys.size, f4)
    costs = shifted_costs(left, right, ys, xs, found, LOW, COUNT)
    assert costs.shape == (ys.size, 2 * COUNT - 1)
    here = costs[:, COUNT - 1]
    assert here.max() < 1.0
    assert (np.delete(costs, range(COUNT - 3, COUNT + 2), axis=1) > 20 * here.max()).all()
    np.testing.assert_array_equal(costs_at(left, right, ys, xs, found), here)


def by_loops(left: np.ndarray, right: np.ndarray, y: int, x: int) -> np.ndarray:
    """The variance at each part of a pixel from `LOW`, by Catmull and Rom's cubic in double precision; inf beyond the frame."""
    costs = []
    for at in LOW + np.arange(COUNT * PARTS) / PARTS:
        window = np.empty((2 * WINDOW + 1, 2 * WINDOW + 1))
        for v, u in np.ndindex(window.shape):
            where = x - WINDOW + u - at
            j, t = int(np.floor(where)), where % 1
            taps = right[y - WINDOW + v, np.clip(np.arange(j - 1, j + 3), 0, right.shape[1] - 1)].astype(float)
            weights = (-t / 2 + t * t - t**3 / 2, 1 - 2.5 * t * t + 1.5 * t**3, t / 2 + 2 * t * t - 1.5 * t**3, (t**3 - t * t) / 2)
            window[v, u] = left[y - WINDOW + v, x - WINDOW + u] - taps @ weights
        inside = x - WINDOW - at >= 0 and x + WINDOW - at <= right.shape[1] - 1
        costs.append(window.var() if inside else np.inf)
    return np.array(costs)


def least_about(costs: np.ndarray, at: int) -> float:
    """The bottom of the parabola through the least cost within `ABOUT` parts and its two neighbours, where it opens upwards."""
    near = [j for j in range(at - ABOUT, at + ABOUT + 1) if 0 <= j < costs.size]
    if not near or not np.isfinite(costs[near]).any():
        return float("inf")
    j = near[int(np.argmin(costs[near]))]
    if 0 < j < costs.size - 1 and np.isfinite(costs[[j - 1, j + 1]]).all() and costs[j] <= min(costs[j - 1], costs[j + 1]):
        a, b, c = np.polyfit([-1, 0, 1], costs[j - 1 : j + 2], 2)
        return float(max(c - b * b / (4 * a), 0)) if a > 1e-9 else float(costs[j])
    return float(costs[j])


def test_costs_are_their_definition() -> None:
    rng = np.random.default_rng(2)
    left, right = (cv2.GaussianBlur(rng.uniform(0, 255, (12, 60)).astype(f4), (3, 3), 0.8) for _ in range(2))
    ys, xs = np.array([4, 7, 5, 8], np.int32), np.array([5, 30, 55, 41], np.int32)
    found = np.array([2.25, -5.5, 16.75, 0.0], f4)
    costs = shifted_costs(left, right, ys, xs, found, LOW, COUNT)
    for i, y in enumerate(ys):
        every = by_loops(left, right, int(y), int(xs[i]))
        expected = [least_about(every, round(PARTS * (float(found[i]) - LOW + k))) for k in range(1 - COUNT, COUNT)]
        np.testing.assert_allclose(costs[i], expected, rtol=1e-3)


def test_nothing_known_costs_everything() -> None:
    left, right = pictures(3, 0.0)
    at = np.array([10], np.int32)
    assert np.isinf(costs_at(left, right, at, at, np.array([np.nan], f4)))
    assert np.isinf(costs_at(left, right, at, at, np.array([40.0], f4)))  # beyond the frame
