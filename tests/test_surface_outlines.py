"""Normals beside outlines: limbs turn away at their rims, and nothing else does."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from stereorelight.camera import Camera
from stereorelight.errors import PassError
from stereorelight.surface.normals import normals_and_sigma
from stereorelight.surface.outlines import normals_to_the_rim

SIZE, FOCAL = (240, 180), 800.0
CAMERA = Camera(size=SIZE, K=np.array([[FOCAL, 0, 119.5], [0, FOCAL, 89.5], [0, 0, 1]]))
NOISE_PX, PX_M = 0.01, FOCAL * 0.065  # of matched depth, from pixel to pixel
WALL_M = 2.0

Floats = npt.NDArray[np.float64]


def angle_deg(a: npt.ArrayLike, b: npt.ArrayLike) -> Floats:
    p, q = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(p, q), axis=-1), (p * q).sum(-1)))


def met(kind: str) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Z and N (scene frame) of a ball, or of a standing limb, of 0.1 m radius at 1.5 m before a wall; and where it is."""
    rays = CAMERA.rays(CAMERA.pixel_grid())
    x, y = rays[..., 0], rays[..., 1]
    centre, radius = 1.5, 0.1
    flat = y * y if kind == "ball" else 0 * y
    a, b, c = x * x + flat + 1, centre, centre**2 - radius**2  # |(x, y, 1) Z - (0, 0, centre)| = radius
    root = b * b - a * c
    hit = root > 0
    Z = np.where(hit, (b - np.sqrt(np.where(hit, root, 0))) / a, WALL_M)
    out = np.stack([x * Z, -(y if kind == "ball" else 0 * y) * Z, centre - Z], -1)
    N = np.where(hit[..., None], out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-9), [0.0, 0.0, 1.0])
    return Z, N, hit


def sigma_m(Z: npt.ArrayLike, px: float = 0.03) -> npt.NDArray[np.float32]:
    return (np.asarray(Z) ** 2 / PX_M * px).astype(np.float32)


def noisy(Z: Floats) -> npt.NDArray[np.float32]:
    from scipy import ndimage

    noise = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=Z.shape), 2.0)
    return (PX_M / (PX_M / Z + 0.02 * noise / noise.std())).astype(np.float32)


@pytest.mark.parametrize("kind", ["ball", "limb"])
def test_a_limb_turns_away_at_its_rim(kind: str) -> None:
    from scipy import ndimage

    Z, N, hit = met(kind)
    depth = noisy(Z)
    given, _ = normals_and_sigma(depth, CAMERA, noise_per_m=NOISE_PX / PX_M, Z_sigma=sigma_m(depth))
    found, share = normals_to_the_rim(given, depth, CAMERA, Z_sigma=sigma_m(depth))
    depth_in = ndimage.distance_transform_edt(hit)
    rim = hit & (depth_in <= 3)
    before, after = angle_deg(given, N)[rim], angle_deg(found, N)[rim]
    assert np.median(before) > 8
    assert np.median(after) < 0.45 * np.median(before)
    assert np.quantile(after, 0.9) < np.quantile(before, 0.9)
    assert (share[rim] > 0).mean() > 0.8
    np.testing.assert_array_equal(found[share == 0], given[share == 0])
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-5)
    assert not share[~hit].any()  # the wall behind stays flat
    assert not share[depth_in > 8].any()


@pytest.mark.parametrize("lean", [0.0, 0.8, 1.8])
def test_the_edges_of_flat_things_stay_flat(lean: float) -> None:
    """A card that faces the camera, one that leans, and a table seen along its top: no rim, however much it faces out."""
    y = CAMERA.rays(CAMERA.pixel_grid())[..., 1]
    Z = 1.2 / (1 + lean * (y + 0.02))
    Z = np.where((np.abs(y) < 0.06) & (Z < 1.8), Z, WALL_M)
    depth = noisy(Z)
    given, _ = normals_and_sigma(depth, CAMERA, noise_per_m=NOISE_PX / PX_M, Z_sigma=sigma_m(depth))
    _, share = normals_to_the_rim(given, depth, CAMERA, Z_sigma=sigma_m(depth))
    assert (share > 0.2).mean() < 0.002


def test_steps_that_doubt_explains_are_no_outlines() -> None:
    Z, _, _ = met("ball")
    depth = noisy(Z)
    given, _ = normals_and_sigma(depth, CAMERA)
    doubt = np.full(Z.shape, 0.3, np.float32)
    np.testing.assert_array_equal(normals_to_the_rim(given, depth, CAMERA, Z_sigma=doubt)[0], given)
    holes = depth.copy()
    holes[60:90, 100:130] = np.nan
    found, share = normals_to_the_rim(normals_and_sigma(holes, CAMERA)[0], holes, CAMERA, Z_sigma=sigma_m(Z))
    assert share[55:95, 95:135].max() == 0  # unknown ground is no surface behind
    assert np.isnan(found[60:90, 100:130]).all()
    with pytest.raises(PassError, match="Z_sigma"):
        normals_to_the_rim(given, depth, CAMERA, Z_sigma=doubt[1:])
