"""What brightness says of disparity: a smooth texture, shifted by a known amount, leads a wrong disparity to the truth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.engine.belief import believed, deviation
from stereorelight.engine.photometric import brightness_residual, photometric_evidence, row_splines, spline_residual

f4 = np.float32
HW = (12, 96)
INSIDE = (slice(None), slice(30, -30))  # away from the ends, where x - d leaves the row
CUBIC = 0.05  # grey levels of 100: what a cubic loses of a wave of 12 px
NOISE = 1.0  # grey levels


def texture(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Grey levels of a smooth, unrepeating row."""
    return 128 + 40 * np.sin(2 * np.pi * x / 23 + 0.4) + 25 * np.sin(2 * np.pi * x / 14.3)


def pair(true: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Left and right picture of a wall at disparity `true`: left(x) = right(x - true)."""
    x = np.tile(np.arange(HW[1], dtype=np.float64), (HW[0], 1))
    return texture(x).astype(f4), texture(x + true).astype(f4)


def full(value: float) -> npt.NDArray[np.float32]:
    return np.full(HW, value, f4)


def asked(left: npt.NDArray[np.float32], right: npt.NDArray[np.float32], d: npt.NDArray[np.float32], local: float = 0.0) -> npt.NDArray[np.float32]:
    """The disparity that each pixel's brightness asks for; `local` is the local mean of the residual."""
    residual, rate = spline_residual(left, row_splines(left), row_splines(right), d)
    weight, pull = photometric_evidence(d, residual - f4(local), rate, full(NOISE**2), full(1e6), full(1))
    return d + pull / np.maximum(weight, f4(1e-6))


def test_splines_pass_through_every_pixel() -> None:
    rng = np.random.default_rng(0)
    left, right = (rng.random(HW, dtype=f4) * 255 for _ in range(2))
    residual, _ = spline_residual(left, row_splines(left), row_splines(right), full(3))
    assert np.abs(residual[:, 3:] - (left[:, 3:] - right[:, :-3])).max() < 1e-3


def test_splines_keep_detail_that_shorter_cubics_lose() -> None:
    """A wave of 4 px, half a pixel off: the error of interpolation is under a quarter of Catmull and Rom's."""
    x = np.tile(np.arange(HW[1], dtype=np.float64), (HW[0], 1))
    left, right = (np.asarray(100 * np.cos(np.pi / 2 * (x + s)), f4) for s in (0, 0.5))
    ours, _ = spline_residual(left, row_splines(left), row_splines(right), full(0.5))
    theirs, _ = brightness_residual(left, right, full(0.5))
    assert np.abs(ours[INSIDE]).max() < 0.25 * np.abs(theirs[INSIDE]).max()


@given(true=st.floats(-20, 20))
def test_no_residual_at_the_truth(true: float) -> None:
    left, right = pair(true)
    residual, rate = brightness_residual(left, right, full(true))
    assert np.abs(residual[INSIDE]).max() < 10 * CUBIC
    x = np.tile(np.arange(HW[1], dtype=np.float64), (HW[0], 1))
    slope = (texture(x + 1e-4) - texture(x - 1e-4)) / 2e-4
    assert np.abs(rate + slope)[INSIDE].max() < 0.05 * np.abs(slope).max()  # brightness falls with disparity where it rises with x


def test_the_rate_is_the_mean_of_both_eyes() -> None:
    left, right = pair(4.0)
    _, rate = brightness_residual(left, right, full(4.0 + 1.5))
    x = np.tile(np.arange(HW[1], dtype=np.float64), (HW[0], 1))
    slope = [(texture(at + 1e-4) - texture(at - 1e-4)) / 2e-4 for at in (x, x - 1.5)]
    assert np.abs(slope[0] - slope[1])[INSIDE].max() > 10  # either alone would be far off
    assert np.abs(rate + (slope[0] + slope[1]) / 2)[INSIDE].max() < 1.0


@given(true=st.floats(-15, 15), off=st.floats(-0.8, 0.8))
def test_a_wrong_disparity_is_led_to_the_truth(true: float, off: float) -> None:
    left, right = pair(true)
    d = full(true + off)
    for _ in range(4):
        d = asked(left, right, d)
    x = np.arange(HW[1], dtype=np.float64)
    steep = np.zeros(HW, bool)
    steep[INSIDE] = np.abs(texture(x + 0.5) - texture(x - 0.5))[INSIDE[1]] > 6
    assert steep.sum() > 100
    assert np.abs(d - true)[steep].max() < 0.05
    assert np.median(np.abs(d - true)[steep]) < 0.01


def test_one_step_goes_most_of_the_way() -> None:
    left, right = pair(5.3)
    x = np.arange(HW[1], dtype=np.float64)
    steep = np.abs(texture(x + 0.5) - texture(x - 0.5)) > 8
    steep[:30] = steep[-30:] = False
    assert np.median(np.abs(asked(left, right, full(5.6)) - 5.3)[:, steep]) < 0.03


def test_an_exposure_difference_is_no_disparity() -> None:
    left, right = pair(5.3)
    d = full(5.6)
    assert np.abs(asked(left + f4(7), right, d, local=7.0) - asked(left, right, d)).max() < 0.01


def test_plain_ground_asks_for_nothing() -> None:
    wall, d = full(90), full(4.25)
    residual, rate = spline_residual(wall, row_splines(wall), row_splines(wall), d)
    weight, pull = photometric_evidence(d, residual, np.where(np.abs(rate) < 1e-3, f4(0), rate), full(1), full(0), full(0.5))
    assert not weight.any()
    assert not pull.any()


@given(e=st.floats(-60, 60), g=st.floats(0.5, 30), trust=st.floats(0, 1), noise=st.floats(0.2, 5))
def test_evidence_is_its_formula(e: float, g: float, trust: float, noise: float) -> None:
    """At a whole disparity, where noise pulls nowhere, on texture far above the noise; no pixel is surer of its place than 0.05 px."""

    def plain(v: float) -> npt.NDArray[np.float32]:
        return np.full((1, 1), v, f4)

    weight, pull = photometric_evidence(plain(-3), plain(e), plain(g), plain(noise**2), plain(1e9), plain(trust))
    k = trust / (1 + (e / (3 * noise)) ** 2) ** 2 / noise**2
    held = 1 / (1 + 0.05**2 * g * g * k)
    assert weight[0, 0] == pytest.approx(g * g * k * held, rel=1e-3, abs=1e-6)
    assert pull[0, 0] == pytest.approx(g * e * k * held, rel=1e-3, abs=1e-6)
    assert weight[0, 0] < 1.001 / 0.05**2


def test_noise_alone_pulls_nowhere() -> None:
    """Two pictures of nothing but noise: without the correction matches are drawn to half pixels (pixel locking)."""
    rng = np.random.default_rng(3)
    left, right = (rng.normal(100, 4, (400, 400)).astype(f4) for _ in range(2))
    for fraction in (0.25, 0.75):
        d = np.full_like(left, 5 + fraction)
        residual, rate = spline_residual(left, row_splines(left), row_splines(right), d)
        noise2, rate2 = (np.full_like(d, float((a * a).mean())) for a in (residual, rate))
        weight, pull = photometric_evidence(d, residual, rate, noise2, np.full_like(d, 1e9), np.ones_like(d))
        naive = float((residual * rate).sum() / (rate * rate).sum())
        assert abs(pull.sum() / weight.sum()) < 0.35 * abs(naive)
        assert abs(naive) > 0.05
        weight, _ = photometric_evidence(d, residual, rate, noise2, rate2, np.ones_like(d))
        assert weight.mean() < 0.1 * float((rate * rate / noise2).mean())  # and says hardly anything


def test_a_floor_of_noise_draws_nowhere() -> None:
    """Clean, soft pictures under a floor of noise: only grain draws to half pixels, and here is none to be taken off."""
    left, right = (128 + (p - 128) / 20 for p in pair(5.2))
    d = full(5.2)
    residual, rate = spline_residual(left, row_splines(left), row_splines(right), d)
    off = {}
    for grain2 in (0.0, np.inf):
        weight, pull = photometric_evidence(d, residual, rate, full(0.5), full(1e6), full(1), grain2=grain2)
        off[grain2] = abs(float(pull[INSIDE].sum() / weight[INSIDE].sum()))
    assert off[0.0] < 0.002
    assert off[np.inf] > 0.1


def test_rows_end_in_their_last_pixel() -> None:
    """Beyond the row the border is repeated: no pixel reads another row's grey."""
    left = np.arange(4 * 9, dtype=f4).reshape(4, 9)
    for d, end in ((full(0)[:4, :9] + 100, 0), (full(0)[:4, :9] - 100, -1)):
        residual, _ = brightness_residual(left, left, np.ascontiguousarray(d))
        assert np.array_equal(residual, left - left[:, end][:, None])


@given(seed=st.integers(0, 99))
def test_believed_is_the_logistic_weighing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hw = (4, 5)
    c = rng.normal(size=17).astype(f4)
    confirmed, agrees, rims, walls = ((rng.random(hw) < 0.5).astype(f4) for _ in range(4))
    near, flow_near, alone, led = (rng.random(hw).astype(f4) for _ in range(4))
    spread, sigma, misfit, texture, uneven = (rng.gamma(2, 3, hw).astype(f4) for _ in range(5))
    edge = np.minimum(spread, 6) / 6
    t = c[0] + c[1] * confirmed + c[2] * agrees + c[3] * edge + c[4] * np.log(np.maximum(sigma, 1e-3) / 0.03)
    t = t + c[5] * near + c[6] * flow_near + c[7] * edge * near + c[8] * edge * flow_near + c[9] * np.log1p(misfit) + c[10] * alone
    t = t + c[11] * np.log(0.1 + texture) + c[12] * np.log(0.02 + uneven) + c[13] * rims
    t = t + c[14] * np.log(0.1 + led) + c[15] * walls + c[16] * near * np.log(0.1 + led)
    p = 1 / (1 + np.exp(-t))
    out = believed(c, confirmed, agrees, near, flow_near, spread, sigma, misfit, alone, texture, uneven, rims, led, walls, floors=(0.6, 0.3))
    floor2 = (0.6 - 0.3 * alone) ** 2
    assert out == pytest.approx(np.sqrt((p**2 + floor2) / (1 + floor2)), abs=1e-5)
    assert out.min() >= 0.28
    assert out.max() <= 1


@given(seed=st.integers(0, 99))
def test_deviation_is_the_product_of_powers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sigma, clumped = (rng.gamma(2, s, (4, 5)).astype(f4) for s in (0.05, 0.5))
    confidence, alone = (rng.random((4, 5)).astype(f4) for _ in range(2))
    c = (0.8, 0.84, 0.67, 0.18, 2.9, 0.8)
    log = c[0] + c[1] * np.log(np.maximum(sigma, 1e-3) / 0.03) + c[2] * np.log((1.005 - confidence) / 0.02)
    log += c[3] * np.log(np.maximum(clumped, 0.05) / 0.5) + c[4] * alone * np.maximum(c[5] - confidence, 0)
    told = deviation(c, sigma, confidence, clumped, alone, sigma_px=0.03, doubt=0.02, clumps=0.5, least_clumped=0.05, most_px=16)
    np.testing.assert_allclose(told, np.minimum(0.03 * np.exp(log), 16), rtol=1e-5)
