"""Transfer curves: there and back again, monotone, and the values that the standards print."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.errors import ShotError
from stereorelight.footage.colour import decode, encode, known_spaces, space_of_file

FLOAT32_STEP = 4 * float(np.finfo(np.float32).eps)  # one rounding to float32 on the way, steepened by a power of at most 2.4
# IEC 61966-2-1 decodes 0.04045 and the next value to linear values 6.2 steps apart: those between have no code, and return as a neighbour.
SRGB_GAP = 8 * float(np.finfo(np.float32).eps)
UNDERFLOW = 1e-15  # below it x ** 2.4 leaves float32's normal numbers
VALUES = hnp.arrays(np.float32, 20, elements=st.floats(-100, 100, width=32))


def tolerance(space: str, there: object) -> float:
    return SRGB_GAP if space == "sRGB" and there is encode else FLOAT32_STEP


@pytest.mark.parametrize("space", known_spaces())
@settings(max_examples=50, deadline=None)
@given(values=VALUES)
def test_round_trip_keeps_every_value(space: str, values: np.ndarray) -> None:
    for there, back in ((encode, decode), (decode, encode)):
        returned = back(there(values, space), space)
        assert returned.dtype == np.float32
        assert np.allclose(returned, values, rtol=tolerance(space, there), atol=UNDERFLOW)
        assert np.array_equal(there(-values, space), -there(values, space))


@pytest.mark.parametrize("space", known_spaces())
def test_round_trip_holds_where_branches_meet(space: str) -> None:
    joins = np.array([0.04045, 0.0031308, 0.018053968510807, 4.5 * 0.018053968510807], np.float32)
    near = (joins[:, None].astype(np.float64) * (1 + np.linspace(-1e-5, 1e-5, 2001))).astype(np.float32)
    for there, back in ((encode, decode), (decode, encode)):
        assert np.allclose(back(there(near, space), space), near, rtol=tolerance(space, there), atol=0)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("space", known_spaces())
def test_every_code_value_returns_exactly(space: str, bits: int) -> None:
    codes = np.arange(2**bits) / (2**bits - 1)
    back = encode(decode(codes.astype(np.float32), space), space)
    assert np.array_equal(np.rint(back.astype(np.float64) * (2**bits - 1)), np.arange(2**bits))


@pytest.mark.parametrize("space", known_spaces())
def test_monotone_and_without_a_step_where_branches_meet(space: str) -> None:
    x = np.linspace(-0.1, 1, 110_001)  # steps of 1e-5; no curve is steeper than 2.4 here
    y = decode(x, space).astype(np.float64)
    assert (np.diff(y) >= 0).all()
    assert np.diff(y).max() < 2.5e-5
    assert decode(np.array([0.0, 1.0]), space).tolist() == [0, 1]
    assert np.isnan(decode(np.array([np.nan]), space)).all()


def test_values_of_the_standards() -> None:
    assert decode(np.array([0.5]), "sRGB")[0] == pytest.approx(0.2140411, abs=1e-6)
    assert encode(np.array([0.18]), "rec709")[0] == pytest.approx(1.099 * 0.18**0.45 - 0.099, abs=2e-4)  # the standard prints three digits
    assert decode(np.array([0.5]), "gamma2.2")[0] == pytest.approx(0.5**2.2)


def test_names() -> None:
    assert decode(np.array([0.5]), "srgb") == decode(np.array([0.5]), "sRGB")
    with pytest.raises(ShotError, match="did you mean 'sRGB'"):
        decode(np.array([0.5]), "sRBG")
    assert space_of_file("a.exr", is_float=False) == "linear"
    assert space_of_file("a.tif", is_float=True) == "linear"
    assert space_of_file("a.tif", is_float=False) == "sRGB"
    assert space_of_file("a.exr", is_float=True, space="rec709") == "rec709"
