"""Grain and focus: known noise and known blur go in, the same come out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.errors import PassError
from stereorelight.health.grain import grain, judge_grain

SIZE_IN_TIME = 0.03
SIZE_IN_ONE = 0.12  # texture everywhere always adds a little


def street() -> Float32:
    v = motorcycle().left.astype(np.float32) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)


def room(height: int = 270, width: int = 480) -> Float32:
    """Soft walls with some texture and edges, out of thin air."""
    rng = np.random.default_rng(11)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    light = 0.05 + 0.4 * x / width + 0.1 * y / height
    fine = cv2.GaussianBlur(rng.standard_normal((height, width), dtype=np.float32), (0, 0), 1.0)
    light[: height // 3] *= 1 + 0.3 * fine[: height // 3]
    light[:, width // 2 :: 37] *= 0.4
    return np.ascontiguousarray(light[..., None] * np.array([1.0, 0.9, 0.7], np.float32))


def noisy(plate: Float32, sigma: Float32 | float, seed: int) -> Float32:
    return (plate + sigma * np.random.default_rng(seed).standard_normal(plate.shape, dtype=np.float32)).astype(np.float32)


@pytest.mark.parametrize("sigma", [0.003, 0.01, 0.03])
def test_known_grain_comes_out(sigma: float) -> None:
    found = grain(noisy(room(), sigma, 1))
    assert found.sigma(0.18) == pytest.approx((sigma,) * 3, rel=SIZE_IN_ONE)
    timed = grain(noisy(room(), sigma, 1), following=noisy(room(), sigma, 2))
    assert timed.method == "frames"
    assert timed.sigma(0.18) == pytest.approx((sigma,) * 3, rel=SIZE_IN_TIME)
    assert timed.fineness > 0.9


@pytest.mark.parametrize("sigma", [0.005, 0.01, 0.03])
def test_on_a_real_plate_the_grain_adds_in_quadrature(sigma: float) -> None:
    plate = street()
    own, found = grain(plate).percent, grain(noisy(plate, sigma, 1)).percent
    assert np.sqrt(found**2 - own**2) == pytest.approx(100 * sigma / 0.18, rel=SIZE_IN_ONE)
    assert grain(noisy(plate, sigma, 1), following=noisy(plate, sigma, 2)).percent == pytest.approx(100 * sigma / 0.18, rel=SIZE_IN_TIME)


def test_photon_noise_grows_with_the_light() -> None:
    plate = room()
    sigma = np.sqrt(2e-5 + 5e-4 * plate).astype(np.float32)
    for found in (grain(noisy(plate, sigma, 1)), grain(noisy(plate, sigma, 1), following=noisy(plate, sigma, 2))):
        for light in (0.1, 0.18, 0.5):
            assert found.sigma(light)[1] == pytest.approx(np.sqrt(2e-5 + 5e-4 * light), rel=SIZE_IN_ONE)


def test_enlarged_grain_is_measured_in_time_and_named() -> None:
    def lumps(seed: int) -> Float32:
        white = np.random.default_rng(seed).standard_normal((270, 480, 3), dtype=np.float32)
        soft = cv2.GaussianBlur(white, (0, 0), 0.8)
        return room() + soft * np.float32(0.01 / soft.std())

    found = grain(lumps(1), following=lumps(2))
    assert found.method == "frames"
    assert found.sigma(0.18) == pytest.approx((0.01,) * 3, rel=SIZE_IN_ONE)
    finding = judge_grain([(1, found)])
    assert "correlated" in finding.words
    assert finding.level == "note"


def test_what_moves_is_no_grain() -> None:
    plate = room()
    moved = plate.copy()
    moved[:, 100:300] = np.roll(plate, 7, axis=1)[:, 100:300] * np.float32(1.2)
    found = grain(noisy(plate, 0.01, 1), following=noisy(moved, 0.01, 2))
    assert found.sigma(0.18) == pytest.approx((0.01,) * 3, rel=SIZE_IN_ONE)
    repeated = grain(noisy(plate, 0.01, 1), following=noisy(plate, 0.01, 1))
    assert (repeated.method, repeated.sigma(0.18)[1]) == ("picture", pytest.approx(0.01, rel=SIZE_IN_ONE))


def test_clipped_and_unknown_areas_have_no_say() -> None:
    plate = np.minimum(noisy(room(), 0.01, 1), np.float32(0.3))
    plate[:80, :100] = np.nan
    assert grain(plate).sigma(0.18)[1] == pytest.approx(0.01, rel=SIZE_IN_ONE)
    with pytest.raises(PassError, match="want 40"):
        grain(np.full((64, 64, 3), np.nan, np.float32))


def test_the_eyes_are_judged_against_each_other() -> None:
    quiet, loud, pushed = (grain(noisy(room(), sigma, 1)) for sigma in (0.004, 0.01, 0.02))
    assert judge_grain([(1, quiet)], [(1, quiet)]).level == "good"
    apart = judge_grain([(1, quiet)], [(1, loud)])
    assert apart.level == "warn"
    assert apart.details["ratio"] == pytest.approx(2.5, rel=0.1)
    assert "right eye has 2." in apart.words
    assert judge_grain([(1, pushed)], [(1, pushed)]).value == pytest.approx(100 * 0.02 / 0.18, rel=SIZE_IN_ONE)
    assert judge_grain([(1, pushed)]).remedy
    assert judge_grain([]).level == "unknown"
