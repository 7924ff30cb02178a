"""The light of a plate is one that lamps can make, and what given normals are told to be off by is held against the plate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from stereorelight.engine import shading as engine
from stereorelight.surface.cast_light import lamps, least_of, uneven
from stereorelight.surface.plate_light import basis, fit_light, plate_light
from stereorelight.surface.shading_fit import _doubted
from stereorelight.surface.shading_levels import cells_of, levels_of
from tests.test_surface_shading import CAMERA, CLOTH, WINDOW_PX, lit, waves

KEY = np.array([-0.5, 0.55, 0.67])


def sphere(n: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """(n, n, 3) normals of a ball seen from far away, and where it is."""
    y, x = np.mgrid[1 : -1 : n * 1j, -1 : 1 : n * 1j]
    inside = x * x + y * y < 0.9
    N = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0.05))], -1)
    return N / np.linalg.norm(N, axis=-1, keepdims=True), inside


def test_a_lamp_is_the_cosine_to_its_second_order() -> None:
    rng = np.random.default_rng(0)
    N = rng.standard_normal((4000, 3))
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    made = basis(N) @ lamps()
    # No surface is lit by less than nothing: -0.03 is what three orders leave of a lamp behind it.
    assert made.min() > -0.07
    assert made.max() == pytest.approx(1 / 4 + 1 / 2 + 10 / 32, abs=0.01)
    assert np.mean(made, axis=0) == pytest.approx(1 / 4, abs=0.02)
    even = 4 * lamps().mean(axis=1)
    np.testing.assert_allclose(even, np.eye(9)[0], atol=2e-3)
    assert even @ uneven() @ even == pytest.approx(1, abs=0.01)
    assert 16 * lamps()[:, 7] @ uneven() @ lamps()[:, 7] == pytest.approx(9, rel=0.02)


def test_lamps_come_back_and_what_no_lamps_make_does_not() -> None:
    N, inside = sphere()
    B = basis(N[inside])
    true = lamps()[:, [20, 77]] @ np.array([0.8, 0.3])
    np.testing.assert_allclose(least_of(B.T @ B, B.T @ (B @ true)), true, atol=1e-3)
    sharper = true.copy()
    sharper[4:] *= 3  # than the cosine
    found = least_of(B.T @ B, B.T @ (B @ sharper))
    everywhere = basis(np.concatenate([N[inside], -N[inside]]))
    assert (everywhere @ found).min() > -0.1 * (everywhere @ found).max()
    assert (everywhere @ sharper).min() < -0.2 * (everywhere @ sharper).max()


def test_light_of_normals_that_are_off_stays_a_light() -> None:
    """Where a ball's normals are off by 7 degrees and turn to 45 alone, nine free numbers go far below nothing beyond: lamps do not."""
    N, inside = sphere()
    plate = np.repeat((0.15 + 0.5 * np.maximum(N @ (KEY / np.linalg.norm(KEY)), 0))[..., None], 3, -1)
    tilt = np.stack([ndimage.gaussian_filter(np.random.default_rng(k).standard_normal(inside.shape), 9.0) for k in (1, 2)], -1)
    told = N.copy()
    told[..., :2] += 0.09 * tilt / tilt.std()
    told /= np.linalg.norm(told, axis=-1, keepdims=True)
    found = plate_light(plate.astype(np.float32), told.astype(np.float32), (inside & (N[..., 2] > 0.7)).astype(np.float32))
    made = basis(N[inside]) @ found.coefficients[0]
    assert found.explained[0] > 0.5
    assert made.min() > 0
    assert made.max() < 2.0 * plate.max()


def test_an_exact_light_is_not_evened_out() -> None:
    N, inside = sphere()
    true = lamps()[:, [20, 77]] @ np.array([0.8, 0.3]) + 0.4 * np.eye(9)[0]
    c, left, explained = fit_light(np.log(basis(N) @ true), N, inside.astype(np.float64), 12.0)
    assert explained > 0.99
    assert left < 0.01
    np.testing.assert_allclose((basis(N) @ c)[inside], (basis(N) @ true)[inside], rtol=0.1)


@pytest.mark.parametrize(("told_deg", "least", "most"), [(12.0, 0.6, 1.0), (48.0, 0.03, 0.25)])
def test_normals_told_too_wide_are_believed_more(told_deg: float, least: float, most: float) -> None:
    """Normals of the cloth that are off by 12 degrees over some pixels together, told so and told four times as far off."""
    Z, N = waves()
    rng = np.random.default_rng(5)
    tilt = np.stack([ndimage.gaussian_filter(rng.standard_normal(Z.shape), WINDOW_PX) for _ in range(2)], -1)
    off = N.copy()
    off[..., :2] += np.tan(np.radians(12.0 / 1.51)) * tilt / tilt.std()
    off /= np.linalg.norm(off, axis=-1, keepdims=True)
    plate, every = lit(N, CLOTH), np.ones(Z.shape, bool)
    # Their slopes' variance as `levels_of` has it of both doubts: one and the same here.
    sigma = np.full(Z.shape, np.radians(told_deg / 1.51) * 12 / (np.sqrt(2) * CAMERA.fx), np.float32)
    level = levels_of(
        plate, -np.log(Z).astype(np.float32), sigma, off.astype(np.float32), np.full(Z.shape, told_deg / 1.51, np.float32), every, every, CAMERA
    )[0]
    light = plate_light(plate, N.astype(np.float32), np.ones(Z.shape, np.float32), labels=level.labels)
    table, floor = light.coefficients.astype(np.float32), light.floor.astype(np.float32)
    _, gu, gv, _ = engine.shade(level.v, level.rays, level.cells, table, floor)
    share = _doubted(level, level.cells, cells_of(level.grey), light, (gu * gu + gv * gv) / np.float32(level.focal**2))
    assert least < share[0] <= most, share
