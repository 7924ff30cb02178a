"""Walls that repeat: what lies a period off is moved, what lies well is left alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.stereo.match import match
from stereorelight.stereo.periods import moved
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.semi_global import DisparityRange

H, W = 160, 320
PERIOD = 10.4  # px, no whole number: a disparity a period off falls on other parts of a pixel
SEARCH = DisparityRange(low=4, count=48)
f4 = np.float32


def wall(grain: float, noise: float, seed: int = 0) -> tuple[Proxy, np.ndarray]:
    """Tiles all alike but for a grain of some grey levels, on a wall whose disparity goes from 22 to 27 px, drawn at 4 x 4 points a pixel."""
    rng = np.random.default_rng(seed)
    finer = 4
    X, Y = np.meshgrid((np.arange(W * finer) + 0.5) / finer - 0.5, (np.arange(H * finer) + 0.5) / finer - 0.5)
    slope = 5 / W
    speck = cv2.GaussianBlur(rng.standard_normal((H * finer, (W + 80) * finer)).astype(f4), (0, 0), 1.2 * finer)
    speck *= grain / speck.std()

    def painted(x: np.ndarray) -> np.ndarray:
        u, v = x % PERIOD - PERIOD / 2, Y % PERIOD - PERIOD / 2
        joint = np.maximum(np.abs(u), np.abs(v)) > 0.38 * PERIOD
        dot = u * u + v * v < (0.2 * PERIOD) ** 2
        tile = np.where(joint, 150, np.where(dot, 70, 115)).astype(f4)
        return tile + cv2.remap(speck, ((x + 40.5) * finer - 0.5).astype(f4), ((Y + 0.5) * finer - 0.5).astype(f4), cv2.INTER_LINEAR)

    eyes = []
    for x in (X, (X + 22) / (1 - slope)):
        light = cv2.resize(painted(x), (W, H), interpolation=cv2.INTER_AREA)
        eyes.append(np.clip(np.rint(light + noise * rng.standard_normal(light.shape)), 0, 255).astype(f4))
    coded = [np.ascontiguousarray(np.repeat(eye[..., None], 3, axis=2)).astype(np.uint8) for eye in eyes]
    known = np.ones((H, W), np.bool_)
    proxy = Proxy(left=coded[0], right=coded[1], left_grey=eyes[0], right_grey=eyes[1], left_known=known, right_known=known)
    return proxy, np.tile(22 + slope * np.arange(W), (H, 1)).astype(f4)


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("periods", [1, -1])
def test_a_strip_that_lies_a_period_off_is_moved_back(periods: int, noise: float) -> None:
    proxy, truth = wall(grain=4.0, noise=noise)
    found = truth.copy()
    found[:, 120:180] += periods * PERIOD
    there = moved(proxy.left_grey, proxy.right_grey, found, SEARCH.low, SEARCH.count)
    assert there is not None
    strip = np.zeros((H, W), np.bool_)
    strip[:, 120:180] = True
    assert np.isnan(there[~strip]).all()
    assert np.isfinite(there[strip]).mean() > 0.95
    assert np.nanmax(np.abs(there - truth)) < 0.75


def test_what_lies_well_is_left_alone() -> None:
    proxy, truth = wall(grain=4.0, noise=2.0)
    assert moved(proxy.left_grey, proxy.right_grey, truth, SEARCH.low, SEARCH.count) is None


def test_thin_things_before_the_wall_stay_before_it() -> None:
    """Bars of three px, six px before the wall, which is no period of it: what is looked at about them is wall for the most part."""
    proxy, truth = wall(grain=4.0, noise=0.0)
    left, right, found = proxy.left_grey.copy(), proxy.right_grey.copy(), truth.copy()
    for x in range(201, 290, 24):
        near = round(float(truth[0, x])) + 6
        left[:, x : x + 3], right[:, x - near : x - near + 3], found[:, x : x + 3] = 40, 40, near
    bars = found != truth
    found[:, 120:180] += PERIOD
    there = moved(left, right, found, SEARCH.low, SEARCH.count)
    assert there is not None
    assert np.isfinite(there[:, 120:180]).mean() > 0.95
    assert np.isnan(there[bars]).all()


def test_noise_is_left_alone() -> None:
    """No wall: two eyes that share nothing, in twenty draws of which none may move a region."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        left, right = (rng.uniform(0, 255, (H, W)).astype(f4) for _ in range(2))
        flat = np.full((H, W), 20, f4)
        assert moved(left, right, flat, SEARCH.low, SEARCH.count) is None


def test_nothing_matched_is_nothing_to_move() -> None:
    proxy, _ = wall(grain=4.0, noise=0.0)
    assert moved(proxy.left_grey, proxy.right_grey, np.full((H, W), np.nan, f4), SEARCH.low, SEARCH.count) is None


@pytest.mark.parametrize(("noise", "led", "most"), [(0.0, True, 0.09), (1.0, True, 0.09), (0.0, False, 0.14), (1.0, False, 0.2)])
def test_a_wall_that_repeats_is_matched_where_it_is(noise: float, led: bool, most: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles that differ by one grey level: alone on it, a pixel is wrong as often as not."""
    proxy, truth = wall(grain=1.2, noise=noise, seed=3)
    seen = np.arange(W) > 30  # the right eye sees no further to the left

    def wrong() -> float:
        off = np.abs(match(proxy, SEARCH, led=led).left - truth)[:, seen]
        return float(np.mean(~(off <= 1)))

    found = wrong()
    monkeypatch.setattr("stereorelight.stereo.match.PERIOD_ROUNDS", 0)
    assert found < most
    assert found < 0.65 * wrong()
