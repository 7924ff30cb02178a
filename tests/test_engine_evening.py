"""Evening out and roughness against plain NumPy: over the ends of rows, strips and blocks, and where pixels are unknown."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.evening import ALIKE, FLAT, REACH, STEP, evened, roughness

FOCAL_PX = 400.0


def bumpy(size_hw: tuple[int, int]) -> tuple[Float32, Float32]:
    """P and N of a wall with steps in it, rough by a tenth of a pixel, with holes in either."""
    rng = np.random.default_rng(size_hw[1])
    y, x = np.mgrid[0 : size_hw[0], 0 : size_hw[1]]
    Z = 2 + 0.3 * (x // 40 % 2) + rng.normal(0, 2e-3, size_hw)
    P = np.stack([x / FOCAL_PX * Z, -y / FOCAL_PX * Z, -Z], axis=-1).astype(np.float32)
    N = rng.normal([0, 0, 2], 0.5, P.shape)
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    P[rng.random(size_hw) < 0.05] = np.nan
    N[rng.random(size_hw) < 0.05] = np.nan
    return P, N.astype(np.float32)


def neighbours(P: Float32, N: Float32) -> list[tuple[int, int, Float64, Float64, Float64]]:
    """For each of 5 x 5: its place, how far it stands off each pixel's plane, the sum of its distances along the axes, and N . N'."""
    wide = [np.pad(a.astype(np.float64), ((REACH, REACH), (REACH, REACH), (0, 0)), constant_values=np.nan) for a in (P, N)]
    h, w = P.shape[:2]
    found = []
    for dy in range(2 * REACH + 1):
        for dx in range(2 * REACH + 1):
            q, m = (a[dy : dy + h, dx : dx + w] for a in wide)
            found.append((dy, dx, np.abs(((q - P) * N).sum(-1)), np.abs(q - P).sum(-1), (m * N).sum(-1)))
    return found


@pytest.mark.parametrize("size_hw", [(1, 1), (3, 2), (18, 40), (17, 259)])
def test_evened_is_the_mean_over_one_surface(size_hw: tuple[int, int]) -> None:
    P, N = bumpy(size_hw)
    values = np.random.default_rng(0).random((3, *size_hw)).astype(np.float32)
    wide = np.pad(values.astype(np.float64), ((0, 0), (REACH, REACH), (REACH, REACH)))
    total, summed = np.zeros(size_hw), np.zeros(values.shape)
    for dy, dx, off, away, same in neighbours(P, N):
        with np.errstate(invalid="ignore"):
            one_surface = (off <= FLAT * (away - P[..., 2] / FOCAL_PX)) & (same >= ALIKE)
        count = one_surface * 0.5 ** ((dy in (0, 2 * REACH)) + (dx in (0, 2 * REACH)))
        total += count
        summed += count * wide[:, dy : dy + size_hw[0], dx : dx + size_hw[1]]
    want = np.where(total > 0, summed / np.maximum(total, 0.1), values)
    np.testing.assert_allclose(evened(values, P, N, FOCAL_PX), want, atol=1e-6)
    assert (total > 1).any() == (min(size_hw) > 1)


@pytest.mark.parametrize("size_hw", [(1, 1), (18, 40), (17, 259)])
def test_roughness_is_what_neighbours_stand_off_the_plane(size_hw: tuple[int, int]) -> None:
    P, N = bumpy(size_hw)
    near = []
    for _, _, off, away, _ in neighbours(P, N):
        with np.errstate(invalid="ignore"):
            near.append(np.where(off <= STEP * (away - P[..., 2] / FOCAL_PX), off, np.nan))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        count = np.isfinite(near).sum(axis=0)
        want = np.where(count > 1, np.sqrt(np.nansum(np.square(near), axis=0) / np.maximum(count - 1, 1)), 0)
    np.testing.assert_allclose(roughness(P, N, FOCAL_PX), want, rtol=1e-4, atol=1e-7)
