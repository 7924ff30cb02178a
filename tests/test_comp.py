"""The comp: what goes in comes out, layer by layer, to float precision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.comp import relight
from stereorelight.errors import PassError, ShotError

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
