"""How far a surface is expected to bend: a wall less than is guessed before anything is known, what stands before it as far as is seen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stereorelight.engine.bending import plate_correction
from stereorelight.engine.pyramid import doubled
from stereorelight.stereo import refine
from stereorelight.stereo.proxy import matching_proxy
from stereorelight.stereo.refine import BEND, CUT_PX, EFFORTS, bends_seen, expected_bend

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


def test_a_pixel_that_shows_both_sides_of_an_outline_moves_neither() -> None:
    """A card before a wall, its upright outlines a part of a pixel from where pixels end, another part in either eye."""
    rng, finer, (h, w) = np.random.default_rng(3), 8, (96, 192)
    card_px, wall_px, left_edge, right_edge = 20.5, 6.25, 90.4, 150.7

    def painted(tone: float) -> np.ndarray:
        grain = cv2.GaussianBlur(rng.normal(0, 1, (h, (w + 60) * finer)).astype(np.float32), (0, 0), 1.5 * finer, sigmaY=1.5)
        return tone + 12 * grain / grain.std()

    card, wall = painted(150), painted(70)
    at = np.arange(w * finer) / finer

    def eye(shift: float) -> np.ndarray:
        def seen(paint: np.ndarray, px: float) -> np.ndarray:
            return paint[:, np.rint((at + px * shift) * finer).astype(int)]

        on_card = (at + card_px * shift >= left_edge) & (at + card_px * shift < right_edge)
        fine = np.where(on_card, seen(card, card_px), seen(wall, wall_px))
        grey = fine.reshape(h, w, finer).mean(axis=2) / 255
        return np.repeat(grey[..., None], 3, axis=2).astype(np.float32)

    proxy = matching_proxy(eye(0), eye(1))
    x = np.arange(w)
    inside = (x >= left_edge) & (x < right_edge)
    true = np.broadcast_to(np.where(inside, card_px, wall_px).astype(np.float32), (h, w)).copy()
    hidden = (x < left_edge) & (x >= left_edge - (card_px - wall_px))
    trust = np.where(hidden | (x < card_px), np.float32(0.02), np.float32(1)) * np.ones((h, 1), np.float32)
    rims = inside & ((x < left_edge + 3) | (x > right_edge - 3))
    off = {}
    for share in (EFFORTS["fine"].mixed, 1.0):
        found = refine.photometric_surface(proxy, true, trust, effort=replace(EFFORTS["fine"], mixed=share)).disparity
        off[share] = np.abs(found - true)[8:-8, rims].mean()
    assert off[EFFORTS["fine"].mixed] < 0.3 * off[1.0]
