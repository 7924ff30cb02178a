"""Focus between the eyes: a known blur goes in, the same comes out, with and without matches, under grain."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32, Float64
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.errors import PassError
from stereorelight.health.focus import FocusDifference, focus_difference, judge_focus

SIZE = 0.10


def linear(picture: np.ndarray) -> Float32:
    v = picture.astype(np.float32) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)


@pytest.fixture(scope="module")
def pair() -> tuple[Float32, Float32, Float64, Float64]:
    real = motorcycle()
    y, x = np.nonzero(real.nonoccluded)
    chosen = np.random.default_rng(0).choice(len(x), 700, replace=False)
    left = np.stack([x[chosen], y[chosen]], axis=1).astype(np.float64)
    right = left - np.stack([real.disparity[y[chosen], x[chosen]], np.zeros(700)], axis=1)
    return linear(real.left), linear(real.right), left, right


def noisy(plate: Float32, sigma: float, seed: int) -> Float32:
    return (plate + np.float32(sigma) * np.random.default_rng(seed).standard_normal(plate.shape, dtype=np.float32)).astype(np.float32)


def blurred(plate: Float32, sigma: float) -> Float32:
    return cv2.GaussianBlur(plate, (0, 0), sigma)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("grain", [0.0, 0.01])
@pytest.mark.parametrize("matched", [True, False])
def test_a_known_blur_comes_out(pair: tuple[Float32, Float32, Float64, Float64], sigma: float, grain: float, matched: bool) -> None:
    left, right, at_left, at_right = pair
    points = {"points_left": at_left, "points_right": at_right} if matched else {}
    # a gain on top changes nothing
    found = focus_difference(noisy(left, grain, 1), noisy(blurred(right, sigma) * np.float32(1.15), grain, 2), **points)
    assert found.sigma_px == pytest.approx(sigma, rel=SIZE)
    finding = judge_focus([(1, found)])
    assert finding.level == ("bad" if sigma > 2.5 else "warn")
    assert "right eye is softer" in finding.words
    assert "Refocus the right" in finding.remedy


def test_the_other_eye_has_the_other_sign(pair: tuple[Float32, Float32, Float64, Float64]) -> None:
    left, right, at_left, at_right = pair
    found = focus_difference(blurred(left, 1.5), right, points_left=at_left, points_right=at_right)
    assert found.sigma_px == pytest.approx(-1.5, rel=SIZE)
    assert "left eye is softer" in judge_focus([(None, found)]).words


@pytest.mark.parametrize("grain", [0.0, 0.005, 0.02])
def test_equally_sharp_eyes_raise_nothing(pair: tuple[Float32, Float32, Float64, Float64], grain: float) -> None:
    left, right, at_left, at_right = pair
    for points in ({}, {"points_left": at_left, "points_right": at_right}):
        found = focus_difference(noisy(left, grain, 1), noisy(right * np.float32(0.8), grain, 2), **points)
        assert abs(found.sigma_px) < 0.4
        finding = judge_focus([(1, found)])
        assert finding.level == "good", finding.words


def test_more_grain_in_one_eye_is_not_sharpness(pair: tuple[Float32, Float32, Float64, Float64]) -> None:
    left, right, at_left, at_right = pair
    found = focus_difference(noisy(left, 0.003, 1), noisy(right, 0.015, 2), points_left=at_left, points_right=at_right)
    assert judge_focus([(1, found)]).level == "good"


def test_unequal_grain_does_not_hide_a_blur(pair: tuple[Float32, Float32, Float64, Float64]) -> None:
    left, right, at_left, at_right = pair
    found = focus_difference(noisy(left, 0.003, 1), noisy(blurred(right, 1.0), 0.02, 2), points_left=at_left, points_right=at_right)
    assert found.sigma_px == pytest.approx(1.0, rel=SIZE)


def test_a_tilted_plane_of_focus_is_mapped(pair: tuple[Float32, Float32, Float64, Float64]) -> None:
    left, right, at_left, at_right = pair
    tilted = right.copy()
    for first in range(0, right.shape[1], 40):  # from sharp at the left edge to 2 px at the right
        sigma = 2 * first / right.shape[1]
        if sigma > 0.3:
            tilted[:, first : first + 40] = blurred(right, sigma)[:, first : first + 40]
    found = focus_difference(left, tilted, points_left=at_left, points_right=at_right)
    columns = np.nanmedian(found.local_px, axis=0)
    assert np.all(np.diff(columns) > 0)
    assert columns[-1] > 1.2
    finding = judge_focus([(1, found)])
    assert "tilted" in finding.words
    assert "from the left to the right" in finding.words
    assert finding.level == "warn"


def test_nothing_to_see_is_said() -> None:
    flat = np.full((200, 200, 3), 0.2, np.float32)
    with pytest.raises(PassError):
        focus_difference(noisy(flat, 0.01, 1), noisy(flat, 0.01, 2))
    assert judge_focus([]).level == "unknown"
    sure = FocusDifference(variance_px2=0.04, error_px2=0.01, local_px=np.full((3, 4), np.nan, np.float32), tiles=50)
    assert judge_focus([(1, sure)]).level == "good"
