"""Tones of one eye given to the other: by what both of them see, not by what either sees alone."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.stereo.proxy import Proxy, matching_proxy
from stereorelight.stereo.tones import FEWEST_PAIRS

SHAPE = (240, 400)
SHIFT = 12
QUANTUM = 0.5  # grey levels: of the table's own steps, and of what grain leaves of them
TILT = 0.01  # of a curve, over 20 grey levels


def pair(gain: tuple[float, float, float] = (1, 1, 1), alone: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """A wall 12 px off of itself, and at the left eye's left end `alone` px of bright ground that the right one does not see."""
    rng = np.random.default_rng(7)
    wall = (0.15 + 0.35 * rng.random((*SHAPE, 3))).astype(np.float32)
    left, right = wall.copy(), np.roll(wall, -SHIFT, axis=1)
    left[:, :alone] = 0.42 + 0.06 * rng.random((SHAPE[0], alone, 3))
    return left, (right * np.float32(gain)).astype(np.float32)


def seen(alone: int = 60) -> np.ndarray:
    both = np.ones(SHAPE, np.bool_)
    both[:, : max(alone, SHIFT)] = False
    return both


def curve(proxy: Proxy) -> np.ndarray:
    """Grey of the left eye less that of the right one at the same points, at the grey levels of the left."""
    both = seen()
    y, x = np.nonzero(both)
    left, right = proxy.left_grey[y, x], proxy.right_grey[y, x - SHIFT]
    bins = np.digitize(left, np.linspace(*np.quantile(left, (0.02, 0.98)), 9))
    return np.array([np.mean((left - right)[bins == k]) for k in range(1, 9)])


@pytest.mark.parametrize("gain", [(1, 1, 1), (1.75, 1.6, 1.4), (0.6, 0.7, 0.65)])
def test_tones_are_those_of_what_both_eyes_see(gain: tuple[float, float, float]) -> None:
    proxy = matching_proxy(*pair(gain))
    tilted, mended = curve(proxy), curve(proxy.toned(np.full(SHAPE, SHIFT, np.float32), seen()))
    assert np.abs(tilted).max() > 2 * QUANTUM  # else nothing is asked
    assert np.abs(mended).max() < QUANTUM


def test_noise_tilts_no_tones() -> None:
    rng = np.random.default_rng(3)
    grainy = [(p + 0.02 * rng.standard_normal(p.shape)).astype(np.float32) for p in pair()]
    proxy = matching_proxy(*grainy, even=False)
    table = proxy.toned(np.full(SHAPE, SHIFT, np.float32), seen()).tones
    assert table is not None
    inner = slice(1700, 2700)  # the middle half of the wall's levels
    slope = np.polyfit(np.arange(4096)[inner], table.tables[1][1, inner] * 4095 / 255, 1)[0]
    assert slope == pytest.approx(1, abs=TILT)


def test_either_eye_leads() -> None:
    proxy = matching_proxy(*pair((1.5, 1.5, 1.5)))
    turned = proxy.flipped()
    both = np.zeros(SHAPE, np.bool_)
    both[:, ::-1][:, 60 - SHIFT : -SHIFT] = True
    mended = turned.toned(np.full(SHAPE, SHIFT, np.float32), both)
    y, x = np.nonzero(both)
    left, right = mended.left_grey[y, x], mended.right_grey[y, x - SHIFT]
    assert np.abs(left - right).mean() < QUANTUM
    again = turned.flipped()
    assert again.tones is not None
    assert proxy.tones is not None
    assert np.array_equal(again.tones.levels[0], proxy.tones.levels[0])


def test_few_points_say_nothing() -> None:
    proxy = matching_proxy(*pair())
    few = np.zeros(SHAPE, np.bool_)
    few.ravel()[50_000 : 50_000 + FEWEST_PAIRS // 2] = True
    assert proxy.toned(np.full(SHAPE, SHIFT, np.float32), few) is proxy
