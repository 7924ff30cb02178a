"""The comp: what goes in comes out, layer by layer, to float precision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.comp import faded, light_alpha, relight, trust
from stereorelight.errors import PassError, ShotError
from stereorelight.light.lights import DirectionalLight, PointLight
from stereorelight.light.shade import light_layers

FLOAT_EPSILON = float(np.finfo(np.float32).eps)


def pictures(seed: int, count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).uniform(-0.5, 4, (count, 5, 8, 3)).astype(np.float32))


def test_no_layers_is_the_plate_bit_for_bit() -> None:
    plate = pictures(0, 1)[0]
    plate[0, 0] = (np.nan, np.inf, -0.0)
    beauty = relight(plate, {})
    assert beauty is not plate
    assert beauty.tobytes() == plate.tobytes()
    beauty[:] = 0
    assert plate[1, 1, 1] != 0


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(0, 9), gain=st.tuples(*[st.sampled_from([0.0, 0.3, 1.0, 2.5])] * 3))
def test_beauty_is_the_sum(seed: int, count: int, gain: tuple[float, float, float]) -> None:
    plate, *layers = pictures(seed, count + 1)
    named = {f"light_{k}_diffuse": layer for k, layer in enumerate(layers)}
    beauty = relight(plate, named, plate_gain=gain)
    terms = [plate.astype(np.float64) * np.float32(gain), *(layer.astype(np.float64) for layer in layers)]
    bound = FLOAT_EPSILON * (count + 1) * np.abs(terms).sum(axis=0)
    assert (np.abs(beauty - np.sum(terms, axis=0)) <= bound).all()
    assert beauty.dtype == np.float32
    assert np.array_equal(relight(plate, dict(reversed(named.items())), plate_gain=gain), beauty)  # no order but the names'


def test_what_goes_in_stays_as_it_was() -> None:
    plate, layer = pictures(1, 2)
    before = plate.copy(), layer.copy()
    relight(plate, {"light_a_diffuse": layer}, plate_gain=0.5)
    assert np.array_equal(plate, before[0])
    assert np.array_equal(layer, before[1])


@pytest.mark.parametrize("gain", [-1, float("nan"), float("inf"), (1, 2), "x", (1, -1, 1)])
def test_gain_is_checked(gain: object) -> None:
    with pytest.raises(ShotError, match="plate_gain must be"):
        relight(pictures(2, 1)[0], {}, plate_gain=gain)  # type: ignore[arg-type]


def test_a_layer_of_another_size_is_refused_by_name() -> None:
    plate, layer = pictures(3, 2)
    with pytest.raises(PassError, match=r"light_key_diffuse must have shape \(5, 8, 3\), got \(4, 8, 3\)"):
        relight(plate, {"light_key_diffuse": layer[:4]})


def surface() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A wall 2 m away, its plate, and a pixel that nobody knows."""
    plate = pictures(4, 1)[0]
    P = np.full((5, 8, 3), -2.0, np.float32)
    P[..., :2] = np.random.default_rng(1).uniform(-1, 1, (5, 8, 2))
    N = np.zeros_like(P)
    N[..., 2] = 1
    P[2, 3] = np.nan
    return plate, P, N


LIGHTS = [PointLight(name="a", position_m=(0, 0, -1), color=(1, 0.5, 0.2)), DirectionalLight(name="b", azimuth_deg=40)]


def test_multiply_is_add_where_nothing_shines() -> None:
    """A gain on the plate is the same light on white; only highlights tell them apart."""
    plate, P, N = surface()
    white = light_layers(P, N, np.ones_like(plate), LIGHTS)
    own = light_layers(P, N, plate, LIGHTS)
    gained = relight(plate, white, plate_gain=0.4, mode="multiply")
    np.testing.assert_allclose(gained, relight(plate, own, plate_gain=0.4), rtol=1e-5, atol=1e-6)
    black = np.zeros_like(plate)
    shiny = {"light_a_specular": np.ones_like(plate)}
    assert (relight(black, shiny, mode="multiply") == 0).all()
    assert (relight(black, shiny) == 1).all()


def test_light_alone_is_what_add_puts_on_the_plate() -> None:
    plate, *layers = pictures(5, 4)
    named = {f"light_{k}_diffuse": layer for k, layer in enumerate(layers)}
    alone = relight(plate, named, plate_gain=0.3, mode="light_only")
    np.testing.assert_allclose(plate * np.float32(0.3) + alone, relight(plate, named, plate_gain=0.3), atol=1e-5)
    plate[0, 0] = np.nan
    assert np.isfinite(relight(plate, named, mode="light_only")).all()
    assert (relight(plate, {}, mode="light_only") == 0).all()


def test_no_layers_is_the_plate_bit_for_bit_as_a_gain_too() -> None:
    plate = pictures(0, 1)[0]
    assert relight(plate, {}, mode="multiply").tobytes() == plate.tobytes()


def test_an_unknown_mode_is_told() -> None:
    with pytest.raises(ShotError, match="did you mean 'multiply'"):
        relight(pictures(0, 1)[0], {}, mode="multipli")  # type: ignore[arg-type]


def test_alpha_is_where_light_may_fall() -> None:
    _, P, _ = surface()
    left, right = np.zeros((5, 8), np.float32), np.zeros((5, 8), np.float32)
    left[:, :4], right[:, 2:6] = 0.5, 0.5
    alpha = light_alpha(P, [left, right])
    assert alpha[0].tolist() == [0.5, 0.5, 0.75, 0.75, 0.5, 0.5, 0, 0]
    assert alpha[2, 3] == 0
    assert light_alpha(P, [left, None])[0].tolist() == [1.0] * 8
    assert (light_alpha(P, []) == 0).all()
    assert (light_alpha(P, [None], trust=left)[:, :4].max(), light_alpha(P, [None], trust=left)[:, 4:].max()) == (0.5, 0)


def test_trust_fades_by_its_knob_alone() -> None:
    confidence = np.array([[0.0, 0.25, 0.5, 1.0, np.nan]], np.float32)
    sigma = np.array([[5.0, 5.0, 5.0, 30.0, 5.0]], np.float32)
    assert (trust(confidence, sigma, fade=0) == 1).all()
    np.testing.assert_allclose(trust(confidence)[0], [0, 0.5, 1, 1, 0], atol=1e-6)
    np.testing.assert_allclose(trust(confidence, sigma)[0], [0, 0.5, 1, 0.5, 0], atol=1e-6)
    np.testing.assert_allclose(trust(N_sigma=sigma, fade=0.5)[0], [1, 1, 1, 0.75, 1], atol=1e-6)
    layer = {"light_a_diffuse": np.ones((1, 5, 3), np.float32)}
    np.testing.assert_allclose(faded(layer, trust(confidence))["light_a_diffuse"][0, :, 1], [0, 0.5, 1, 1, 0], atol=1e-6)
    with pytest.raises(PassError, match="confidence or N_sigma"):
        trust()
    with pytest.raises(ShotError, match=r"fade must be a number, 0 \.\.\. 1"):
        trust(confidence, fade=1.5)
