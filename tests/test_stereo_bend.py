"""How far a surface is expected to bend: a wall less than is guessed before anything is known, what stands before it as far as is seen."""

from __future__ import annotations

import numpy as np

from stereorelight.engine.bending import plate_correction
from stereorelight.engine.pyramid import doubled
from stereorelight.stereo.refine import BEND, CUT_PX, bends_seen, expected_bend

SIZE = (400, 480)
WEIGHT = 10.0  # 1/px^2: a pixel knows its disparity to 0.3 px


def bend_of(true: np.ndarray) -> np.ndarray:
    """(H / 4, W / 4), found in three rounds from evidence of `WEIGHT` with white noise."""
    asked = true + np.random.default_rng(0).standard_normal(SIZE).astype(np.float32) / np.float32(np.sqrt(WEIGHT))
    weight = np.full(SIZE, WEIGHT, np.float32)
    mean = np.full((SIZE[0] // 4, SIZE[1] // 4), WEIGHT, np.float32)
    bend, d = np.full_like(mean, BEND), true.copy()
    for _ in range(3):
        full = doubled(doubled(bend, (SIZE[0] // 2, SIZE[1] // 2)), SIZE)
        d = d + plate_correction(d, weight, weight * (asked - d), full, cut=CUT_PX, steps=8)
        bend = expected_bend(bends_seen(d), mean, bend)
    return bend


def test_a_wall_is_expected_to_bend_less_than_anything_is() -> None:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    wall = 20 + np.float32(0.01) * x + np.float32(0.02) * y
    assert bend_of(wall).max() < 0.5 * BEND
    # A ball before it, 3 px of relief over 20 px: it bends by 3 / 20^2 = 0.0075 px at its top and more about it; the corner is wall still.
    found = bend_of(wall + 3 * np.exp(-((x - 240) ** 2 + (y - 200) ** 2) / np.float32(2 * 20**2)))
    assert found[50, 60] > 0.0075
    assert np.median(found[:15, :15]) < 0.5 * BEND
