"""Robust planes: exact on a plane, sharp at a step, calm under noise, and the same bits whatever the threads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.engine.refine import blended, robust_planes

HW = (48, 64)
RADIUS = 6
FLOAT32 = 5e-5  # px, at disparities of 100 px
# The fit holds slopes to zero with a weight of 0.05 against a window's variance of about 9 px^2: 0.6 % of the slope.
RIDGE = 0.008


def plane(a: float, b: float, c: float, hw: tuple[int, int] = HW) -> npt.NDArray[np.float32]:
    x, y = np.meshgrid(np.arange(hw[1]), np.arange(hw[0]))
    return (c + a * x + b * y).astype(np.float32)


def ones(hw: tuple[int, int] = HW) -> npt.NDArray[np.float32]:
    return np.ones(hw, np.float32)


@given(a=st.floats(-0.15, 0.15), b=st.floats(-0.15, 0.15), c=st.floats(-80, 80))
def test_exact_on_a_plane(a: float, b: float, c: float) -> None:
    d = plane(a, b, c)
    value, slope_x, slope_y = robust_planes(d, ones(), radius=RADIUS)
    inside = (slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS))
    assert np.abs(value - d)[inside].max() < FLOAT32
    assert np.abs(slope_x - a)[inside].max() < RIDGE * abs(a) + FLOAT32
    assert np.abs(slope_y - b)[inside].max() < RIDGE * abs(b) + FLOAT32
    # At the frame's border the window is one-sided: what the ridge takes off the slope shows over half a window.
    assert np.abs(value - d).max() < 3 * RIDGE * RADIUS / 2 * (abs(a) + abs(b)) + FLOAT32


@pytest.mark.parametrize("c", [0.0, 7.25, -31.5])
def test_exact_on_a_plain_wall_up_to_the_border(c: float) -> None:
    value, slope_x, slope_y = robust_planes(plane(0, 0, c), ones())
    assert (value == c).all()
    assert not slope_x.any()
    assert not slope_y.any()


@given(step=st.floats(4, 60), a=st.floats(-0.05, 0.05), seed=st.integers(0, 50))
def test_a_step_between_two_planes_stays_sharp(step: float, a: float, seed: int) -> None:
    """Every pixel, those beside the edge too, keeps the plane of its own side."""
    edge = 30 + np.random.default_rng(seed).integers(-2, 3, HW[0])[:, None]
    front = np.arange(HW[1]) < edge
    d = np.where(front, plane(a, 0.02, 10 + step), plane(-0.02, a, 10))
    value, _, _ = robust_planes(d, ones(), radius=RADIUS, tau_px=1.0)
    assert np.abs(value - d).max() < 3 * RIDGE * RADIUS * 0.1
    # What a plain mean over the window does there: half the step.
    assert (value[front] > value[~front].max()).mean() > 0.99


@pytest.mark.parametrize(("a", "b"), [(0.05, -0.03), (0.3, -0.2)])
def test_noise_goes_and_the_plane_stays(a: float, b: float) -> None:
    """On a steep plane too, where a window spans more than `tau_px`: who belongs is asked of the plane, not of the value."""
    true = plane(a, b, 20)
    noisy = true + np.random.default_rng(1).normal(scale=0.3, size=HW).astype(np.float32)
    value, slope_x, _ = robust_planes(noisy, ones(), radius=RADIUS, passes=3)
    inside = (slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS))
    # 33 samples a window: 0.3 / sqrt(33) = 0.052, and a little for those that are weighed down.
    assert (value - true)[inside].std() < 0.3 / np.sqrt(33) * 1.3
    assert abs((value - true)[inside].mean()) < 0.02
    assert (slope_x - a)[inside].std() < 0.3 / np.sqrt(33 * 9) * 1.6


def test_outliers_are_left_out() -> None:
    true = plane(0.05, -0.03, 20)
    rng = np.random.default_rng(2)
    bad = rng.random(HW) < 0.2
    given = true + np.where(bad, rng.choice([-30, 25], HW), 0).astype(np.float32)
    value, _, _ = robust_planes(given, ones(), radius=RADIUS)
    inside = np.zeros(HW, bool)
    inside[RADIUS:-RADIUS, RADIUS:-RADIUS] = True
    # Its own far neighbours are no help to an outlier, which keeps what it has; nobody else hears of it.
    assert np.abs(value - true)[inside & ~bad].max() < 0.01


@given(junk=st.floats(-1000, 1000))
def test_a_pixel_without_weight_is_not_heard(junk: float) -> None:
    weight = ones()
    weight[20:24, 30:34] = 0
    d = plane(0.02, 0.03, 5)
    other = d.copy()
    other[20:24, 30:34] = junk
    known = weight > 0
    for one, two in zip(robust_planes(d, weight), robust_planes(other, weight)):
        assert np.array_equal(one[known], two[known])


def test_where_nothing_is_known_all_stays() -> None:
    d = np.random.default_rng(3).normal(size=HW).astype(np.float32)
    value, slope_x, slope_y = robust_planes(d, 0 * ones())
    assert np.array_equal(value, d)
    assert not slope_x.any()
    assert not slope_y.any()


def test_target_is_fitted_where_disparity_says_who_belongs() -> None:
    front = np.arange(HW[1]) < 30
    d = np.where(front, plane(0, 0, 20), plane(0, 0, 10))
    target = d + np.where(front, 0.25, -0.125).astype(np.float32)
    value, _, _ = robust_planes(d, ones(), target=target, passes=1, slopes=(0 * d, 0 * d))
    assert np.abs(value - target).max() < FLOAT32


@pytest.mark.parametrize("hw", [(1, 1), (1, 9), (9, 1), (5, 513), (17, 600)])
def test_any_size(hw: tuple[int, int]) -> None:
    """Rows longer than one strip, and pictures smaller than one window."""
    d = plane(0.02, 0.1, 3, hw)
    value, slope_x, slope_y = robust_planes(d, ones(hw))
    assert np.isfinite([value, slope_x, slope_y]).all()
    assert np.abs(value - d).max() < 0.05


def test_a_strips_seam_does_not_show() -> None:
    """The same surface gives the same plane left and right of pixel 512."""
    d = np.tile(np.sin(np.arange(64) * 2 * np.pi / 64).astype(np.float32), (20, 10))  # 64 px period: 512 is eight of them
    value, slope_x, _ = robust_planes(d, ones(d.shape))
    # The kernel sums in a different order at a strip's end.
    assert np.abs(value[:, 448:576] - value[:, 128:256]).max() < FLOAT32
    assert np.abs(slope_x[:, 448:576] - slope_x[:, 128:256]).max() < FLOAT32


def test_same_bits_on_one_thread_and_two() -> None:
    rng = np.random.default_rng(4)
    d, weight = rng.normal(size=(70, 530)).astype(np.float32), rng.random((70, 530)).astype(np.float32)
    before, results = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            planes = robust_planes(d, weight)
            results.append([*planes, *blended(planes, tau_px=1.0)])
    finally:
        numba.set_num_threads(before)
    for one, two in zip(*results):
        assert one.tobytes() == two.tobytes()


@given(a=st.floats(-0.2, 0.2), b=st.floats(-0.2, 0.2), c=st.floats(-80, 80))
def test_blending_a_plane_changes_nothing(a: float, b: float, c: float) -> None:
    planes = (plane(a, b, c), np.full(HW, a, np.float32), np.full(HW, b, np.float32))
    for before, after in zip(planes, blended(planes, tau_px=0.5)):
        assert np.abs(after - before).max() < FLOAT32


def test_blending_evens_out_a_grid_and_leaves_a_step() -> None:
    x, y = np.meshgrid(np.arange(HW[1]), np.arange(HW[0]))
    step = np.where(x < 30, 20.0, 10.0)
    grid = (0.05 * (-1.0) ** (x + y)).astype(np.float32)
    value, _, _ = blended(((step + grid).astype(np.float32), 0 * grid, 0 * grid), tau_px=1.0)
    assert np.abs(value - step)[1:-1].max() < 0.05
    inside = (np.abs(x - 29.5) > 1) & (x > 0) & (x < HW[1] - 1) & (y > 0) & (y < HW[0] - 1)
    assert np.abs(value - step)[inside].max() < 0.005


FRESH_AND_CACHED = """
import hashlib, numpy as np
from stereorelight.engine.refine import blended, robust_planes
rng = np.random.default_rng(0)
d, w = rng.random((40, 90), dtype=np.float32) * 3, rng.random((40, 90), dtype=np.float32)
planes = robust_planes(d, w, radius=4, stride=2, tau_px=0.5)
print(hashlib.sha256(b"".join(a.tobytes() for a in (*planes, *blended(planes, tau_px=0.5)))).hexdigest())
"""


@pytest.mark.slow
def test_compiled_and_cached_kernels_give_the_same_bits(tmp_path: Path) -> None:
    """With fast mathematics the process that compiled gave other last digits than those that loaded its cache."""
    runs = [
        subprocess.run(
            [sys.executable, "-c", FRESH_AND_CACHED], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert runs[0] == runs[1]
