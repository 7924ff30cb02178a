"""Flicker is what the answer does that the scene does not: known noise in, its size out; motion and the scene's own change count nothing."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.compare.flicker import flicker_figures
from stereorelight.errors import PassError

H, W = 60, 90
Y, X = np.mgrid[0:H, 0:W].astype(np.float32)


def still() -> np.ndarray:
    return np.zeros((H, W, 2), np.float32)


def leaning(degrees: float) -> np.ndarray:
    """(H, W, 3) normals turned about y by so much."""
    a = np.radians(degrees)
    return np.broadcast_to(np.array([np.sin(a), 0, np.cos(a)], np.float32), (H, W, 3)).copy()


def test_what_stands_still_does_not_flicker() -> None:
    Z = 2 + 0.01 * X
    got = flicker_figures([Z, Z, Z], [still(), still()], N=[leaning(5)] * 3)
    assert got.pairs == 2
    assert got.Z_percent.rms == 0
    assert got.N_deg is not None
    assert got.N_deg.rms < 1e-4
    assert got.Z_percent.pixels == 2 * H * W
    assert "flicker over 2 pairs" in got.text()


def test_noise_comes_out_with_its_size() -> None:
    rng = np.random.default_rng(0)
    frames = [(2 * (1 + 0.01 * rng.standard_normal((H, W)))).astype(np.float32) for _ in range(4)]
    got = flicker_figures(frames, [still()] * 3, N=[leaning(0), leaning(3), leaning(0), leaning(3)])
    assert got.Z_percent.rms == pytest.approx(np.sqrt(2), rel=0.03)
    assert got.N_deg is not None
    assert got.N_deg.median == pytest.approx(3, abs=1e-3)


def test_motion_is_followed_between_pixels_and_off_the_frame() -> None:
    """A slope that moves by (1.5, -0.25) px is no flicker; what leaves the frame, or is not found again, is left out."""
    way = np.broadcast_to(np.array([1.5, -0.25], np.float32), (H, W, 2)).copy()
    a, b = 2 + 0.01 * X + 0.005 * Y, 2 + 0.01 * (X - 1.5) + 0.005 * (Y + 0.25)
    way[:, -2:], way[0] = np.nan, np.nan
    got = flicker_figures([a, b], [way])
    assert got.Z_percent.rms < 1e-3
    assert got.Z_percent.pixels == (H - 1) * (W - 2)
    assert got.N_deg is None
    unknown = b.copy()
    unknown[10:20] = np.nan
    assert flicker_figures([a, unknown], [way]).Z_percent.cover_percent < 90


def test_surfaces_are_not_mixed_between_pixels() -> None:
    """An edge between 1 m and 3 m that moves by half a pixel: every pixel finds its own surface, but for the one that lies between."""
    way = np.broadcast_to(np.array([0.4, 0.0], np.float32), (H, W, 2)).copy()
    Z = np.where(X < 40, np.float32(1), np.float32(3))
    assert flicker_figures([Z, Z], [way]).Z_percent.rms == 0


def test_the_truths_own_change_is_taken_off() -> None:
    true = [np.full((H, W), z, np.float32) for z in (2.0, 1.9, 1.8)]
    Z = [true[0], true[1] * 1.01, true[2]]
    turning = [leaning(10 * k) for k in range(3)]
    plain = flicker_figures(Z, [still()] * 2, N=turning)
    told = flicker_figures(Z, [still()] * 2, N=turning, true_Z=true, true_N=turning)
    assert plain.Z_percent.mean > 3
    assert told.Z_percent.mean == pytest.approx(1, rel=0.06)
    assert plain.N_deg is not None
    assert told.N_deg is not None
    assert plain.N_deg.median == pytest.approx(10, abs=1e-3)
    assert told.N_deg.rms < 1e-3
    half = [np.asarray(X < 45)] * 3
    assert flicker_figures(Z, [still()] * 2, mask=half).Z_percent.pixels == H * W


def test_what_does_not_fit_is_refused() -> None:
    Z = np.ones((H, W), np.float32)
    with pytest.raises(PassError, match="two frames or more"):
        flicker_figures([Z], [])
    with pytest.raises(PassError, match="needs 1 motions, got 2"):
        flicker_figures([Z, Z], [still()] * 2)
    with pytest.raises(PassError, match="motion must have shape"):
        flicker_figures([Z, Z], [still()[:-1]])
    assert flicker_figures([Z, Z], [still() * np.nan]).to_dict()["Z_percent"]["median"] is None
