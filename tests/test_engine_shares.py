"""Curves by equal shares, from counts, and counts of points that both eyes see."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.engine.shares import counts_of, counts_of_pairs, equal_shares
from stereorelight.engine.tone import LEVELS

SIZE = (83, 61)


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(100, 3000, (*SIZE, 3)).astype(np.uint16)


def test_counts_are_those_of_every_step() -> None:
    a = picture(0)
    for step in (1, 3):
        for c in range(3):
            np.testing.assert_array_equal(counts_of(a, step=step)[c], np.bincount(a[::step, ::step, c].ravel(), minlength=LEVELS))


@pytest.mark.parametrize("step", [1, 2, 7, 200])
def test_pairs_are_where_the_disparity_says(step: int) -> None:
    left, right = picture(1), picture(2)
    rng = np.random.default_rng(3)
    disparity, seen = rng.uniform(-9, 30, SIZE).astype(np.float32), rng.random(SIZE) > 0.3
    mine, theirs = counts_of_pairs(left, right, disparity, seen, step=step)
    wanted = np.zeros((2, 3, LEVELS), np.int64)
    for y in range(0, SIZE[0], step):
        for x in range(0, SIZE[1], step):
            lands = round(x - float(disparity[y, x]))
            if seen[y, x] and 0 <= lands < SIZE[1]:
                for c in range(3):
                    wanted[0, c, left[y, x, c]] += 1
                    wanted[1, c, right[y, lands, c]] += 1
    np.testing.assert_array_equal((mine, theirs), wanted)


def test_a_curve_gives_the_other_distribution_back() -> None:
    """Numbers through a rising curve, counted: the curve is found again where there are any."""
    a = np.random.default_rng(4).integers(200, 3500, (400, 300, 3)).astype(np.uint16)
    b = np.rint(0.7 * a + 300).astype(np.uint16)
    curves = equal_shares(counts_of(a), counts_of(b))
    at = np.arange(250, 3450)
    assert np.abs(curves[:, at] - (0.7 * at + 300)).max() < 8
