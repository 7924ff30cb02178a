"""Chance islands beyond the other eye's frame go; islands that look like background, and large ones, stay."""

from __future__ import annotations

import numpy as np

from stereorelight.stereo.beyond import ISLAND_PX, without_islands

HEIGHT, WIDTH = 60, 120
NEAR_PX, FAR_PX = 30.0, 4.0
ISLAND = np.s_[20:30, 4:12]


def scene(island_colour: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Near ground from column 30 on, where the other eye's frame begins for it, and an island of something far before that."""
    disparity = np.full((HEIGHT, WIDTH), NEAR_PX, np.float32)
    disparity[ISLAND] = FAR_PX
    large = np.zeros((HEIGHT, WIDTH), np.bool_)
    large[:, int(NEAR_PX) :] = True
    firm = large.copy()
    firm[ISLAND] = True
    picture = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    picture[ISLAND] = island_colour
    return firm, large, disparity, picture


def test_an_island_like_the_ground_beside_it_is_chance() -> None:
    firm, large, disparity, picture = scene(104)
    out = without_islands(firm, large, disparity, picture)
    assert not out[ISLAND].any()
    assert np.array_equal(out, large)


def test_an_island_of_another_colour_stays() -> None:
    firm, large, disparity, picture = scene(160)
    assert np.array_equal(without_islands(firm, large, disparity, picture), firm)


def test_an_island_that_is_nearer_or_not_beyond_the_frame_stays() -> None:
    firm, large, disparity, picture = scene(104)
    disparity[ISLAND] = NEAR_PX + 4
    assert np.array_equal(without_islands(firm, large, disparity, picture), firm)
    firm, large, disparity, picture = scene(104)
    disparity[large] = FAR_PX + 3  # this ground would land within the other eye's frame, were it to go on to an island that starts at column 14
    disparity[:5][large[:5]] = NEAR_PX  # as near ground elsewhere does
    firm[ISLAND], firm[20:30, 14:22] = False, True
    disparity[20:30, 14:22] = FAR_PX
    assert np.array_equal(without_islands(firm, large, disparity, picture), firm)


def test_without_islands_nothing_changes() -> None:
    _, large, disparity, picture = scene(104)
    assert without_islands(large, large, disparity, picture) is large
    assert ISLAND_PX > 40
