"""Sixteenths of a pixel there and back, and what has none."""

from __future__ import annotations

import numpy as np

from stereorelight.engine.occlusion import background, beside, completed, lands_on_plate
from stereorelight.engine.sixteenths import MOST, NOWHERE, as_pixels, coded, kept

SIZE = (37, 53)


def some(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    d = rng.uniform(-40, 90, SIZE).astype(np.float32)
    d[rng.random(SIZE) < 0.2] = np.nan
    d[5] = np.nan
    return d


def test_coded_is_the_nearest_sixteenth_or_nowhere() -> None:
    d = some()
    d[0, :2] = 1e5, -1e5
    codes = coded(d)
    np.testing.assert_array_equal(codes == NOWHERE, np.isnan(d))
    known = ~np.isnan(d)
    known[0, :2] = False
    np.testing.assert_array_equal(codes[known], np.rint(d[known] * 16).astype(np.int16))
    assert codes[0, :2].tolist() == [MOST, -MOST]


def test_pixels_are_sixteenths_from_the_lowest_on() -> None:
    codes = np.arange(-200, 200, dtype=np.int16).reshape(20, 20)
    for sign in (1, -1):
        np.testing.assert_array_equal(as_pixels(codes, -3, sign=sign), np.where(codes >= -48, sign * codes.astype(np.float32) / 16, np.nan))


def test_kept_and_completed() -> None:
    d, other = some(), np.full(SIZE, 7, np.float32)
    codes = coded(d)
    codes[3, :10] = NOWHERE
    left = kept(d, codes)
    np.testing.assert_array_equal(left, np.where(codes == NOWHERE, np.nan, d))
    np.testing.assert_array_equal(completed(left, other), np.where(np.isnan(left), other, left))


def test_beside_is_the_background_of_what_is_known() -> None:
    d = some()
    known = np.isfinite(d)
    np.testing.assert_array_equal(beside(d), background(np.where(known, d, np.float32(0)), known))


def test_what_lands_on_the_plate() -> None:
    rng = np.random.default_rng(1)
    d, known = rng.uniform(-20, 60, SIZE).astype(np.float32), rng.random(SIZE) > 0.2
    lands = np.floor(np.arange(SIZE[1], dtype=np.float32) - d + np.float32(0.5)).astype(int)
    within = (lands >= 0) & (lands < SIZE[1])
    wanted = within & np.take_along_axis(known, np.where(within, lands, 0), axis=1)
    np.testing.assert_array_equal(lands_on_plate(d, known), wanted)
