"""Tone levels: the square root of light, unknown pixels from the nearest known one, and tables on to 8 bits."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.engine.tone import LEVELS, levels, median_twist, through_tables

f4 = np.float32
TOP = LEVELS - 1


@given(linear=hnp.arrays(f4, (3, 7, 3), elements=st.floats(-2, 20, width=32)), white=st.floats(0.1, 10))
def test_levels_are_the_square_root_of_light_in_bgr(linear: npt.NDArray[np.float32], white: float) -> None:
    level, known = levels(linear, white=white)
    exact = np.sqrt(np.clip(linear.astype(np.float64) / white, 0, 1)) * TOP
    assert known.all()
    assert level.dtype == np.uint16
    assert np.abs(level[..., ::-1] - exact).max() <= 0.5 + 2e-3  # rounding, and float32 on the way to it


def test_ends() -> None:
    level, _ = levels(np.array([[[0, 1, 0.25], [-1, 4, 1e-9]]], f4), white=1.0)
    assert level.tolist() == [[[round(TOP / 2), TOP, 0], [0, TOP, 0]]]


@given(a=st.floats(0, 2, width=32), b=st.floats(0, 2, width=32))
def test_brighter_is_never_darker(a: float, b: float) -> None:
    level, _ = levels(np.array([[[a] * 3, [b] * 3]], f4), white=1.0)
    assert (level[0, 0] <= level[0, 1]).all() if a <= b else (level[0, 0] >= level[0, 1]).all()


@given(data=st.data(), bad=st.sampled_from([np.nan, np.inf, -np.inf]))
def test_unknown_pixels_take_the_nearest_known_one_of_their_row(data: st.DataObject, bad: float) -> None:
    h, w = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 14))
    unknown = data.draw(hnp.arrays(np.bool_, (h, w)))
    clean = np.random.default_rng(0).random((h, w, 3)).astype(f4)
    holed = clean.copy()
    holed[unknown, data.draw(st.integers(0, 2))] = bad  # one bad channel makes the pixel unknown
    level, known = levels(holed, white=1.0)
    right, _ = levels(clean, white=1.0)
    assert np.array_equal(known, ~unknown)
    assert np.array_equal(level[known], right[known])
    for y, x in zip(*np.nonzero(unknown)):
        there = np.flatnonzero(known[y])
        if there.size:
            away = np.abs(there - x)
            nearest = there[away == away.min()]
            assert any(np.array_equal(level[y, x], right[y, k]) for k in nearest)


def test_a_picture_with_nothing_known() -> None:
    level, known = levels(np.full((2, 3, 3), np.nan, f4), white=1.0)
    assert not known.any()
    assert not level.any()


@given(seed=st.integers(0, 50))
def test_tables(seed: int) -> None:
    rng = np.random.default_rng(seed)
    level = rng.integers(0, LEVELS, (5, 20, 3)).astype(np.uint16)
    tables = rng.uniform(0, 255, (3, LEVELS)).astype(f4)
    bgr, grey = through_tables(level, tables)
    exact = np.stack([tables[c][level[..., c]] for c in range(3)], axis=-1).astype(np.float64)
    assert np.array_equal(bgr, np.floor(exact.astype(f4) + f4(0.5)).astype(np.uint8))
    assert np.abs(grey - exact @ (0.114, 0.587, 0.299)).max() < 1e-4


@pytest.mark.parametrize("value", [0.0, 127.5, 254.5, 255.0])
def test_ends_of_the_tables_do_not_wrap(value: float) -> None:
    bgr, grey = through_tables(np.full((1, 1, 3), TOP, np.uint16), np.full((3, LEVELS), value, f4))
    assert (bgr == min(int(value + 0.5), 255)).all()
    assert grey[0, 0] == pytest.approx(value, abs=1e-4)


def test_sixteen_levels_to_a_grey_level_keep_a_ramp_without_gaps() -> None:
    ramp = np.repeat(np.linspace(0, 1, 20000, dtype=f4)[None, :, None] ** 2, 3, axis=2)
    level, _ = levels(ramp, white=1.0)
    assert len(np.unique(level)) == LEVELS
    tables = np.tile(np.linspace(0, 255, LEVELS, dtype=f4), (3, 1))
    assert len(np.unique(through_tables(level, tables)[0])) == 256


@pytest.mark.parametrize("size", [(3, 3), (40, 31), (41, 30)])
def test_median_twist_is_the_median_of_the_mask(size) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (*size, 3)).astype(np.uint8)
    mask = cv2.filter2D(picture[..., 1], cv2.CV_32F, np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], f4))
    assert median_twist(picture, 1) == np.median(np.abs(mask[1:-1:2, 1:-1:2]))


def test_a_picture_too_small_for_the_mask_has_no_twist() -> None:
    assert np.isnan(median_twist(np.zeros((2, 9, 3), np.uint8), 1))
