"""The time offset between the eyes: found to a twentieth of a frame, or said to be unknowable."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32
from stereorelight.health.sync import SyncMeasure, SyncMeter, judge_sync

W, H = 480, 270
rng = np.random.default_rng(7)
PLATE = np.exp(0.5 * sum(cv2.GaussianBlur(rng.standard_normal((420, 760)).astype(np.float32), (0, 0), s) * s for s in (1.5, 4, 10)))


def view(t: float, kind: str, disparity: float, row: float, seed: int) -> Float32:
    """A wall at the moment t; "sway" moves in both directions, "even" along rows at one speed."""
    x, y = {"sway": (40 + 2.5 * t, 50 + 9 * np.sin(0.55 * t)), "even": (40 + 3 * t, 50.0), "still": (60.0, 50.0)}[kind]
    M = np.array([[1, 0, x + disparity], [0, 1, y - row]], np.float64)
    grey = cv2.warpAffine(PLATE, M, (W, H), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    noisy = 0.2 * grey * (1 + 0.01 * np.random.default_rng(seed).standard_normal((H, W)))
    return np.repeat(noisy[..., None], 3, axis=2).astype(np.float32)


def measured(kind: str, offset: float) -> SyncMeasure:
    meter = SyncMeter()
    for t in range(16):
        meter.add(1001 + t, view(t, kind, 0, 0, t), view(t - offset, kind, 12, 0.5, 100 + t))
    return meter.measure()


@pytest.mark.parametrize("offset", [0.0, 0.35, -0.6, 2.35])
def test_offset_is_found_with_rows_half_a_pixel_off(offset: float) -> None:
    found = measured("sway", offset)
    assert found.known
    assert abs(found.offset_frames - offset) <= 0.05
    assert judge_sync(found).level == ("good" if offset == 0 else "bad" if abs(offset) > 0.5 else "warn")


@pytest.mark.parametrize("kind", ["still", "even"])
def test_what_cannot_be_known_is_not_guessed(kind: str) -> None:
    found = measured(kind, 0.35)
    assert not found.known
    assert judge_sync(found).level == "unknown"
