"""Normals: exact on planes through any lens, true up to depth edges, calm under noise, and laws that hold for every surface."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera, RectifiedRig
from stereorelight.errors import PassError
from stereorelight.surface.normals import normals_and_sigma, normals_from_depth, normals_from_disparity
from stereorelight.surface.position import position_from_depth, scene_from_camera

# float32 Z is off by 3e-8 of itself; over the 2 px of the smallest window at fx 300 that is 3e-8 * 300 / 2 = 5e-6 rad a tap.
FLOAT32_DEG = 0.01
SIZE = (160, 120)
K = np.array([[300.0, 0, 81.2], [0, 295.0, 57.7], [0, 0, 1]])
CAMERAS = {
    "pinhole": Camera(size=SIZE, K=K),
    "brown": Camera(size=SIZE, K=K, distortion=(-0.25, 0.1, 0.002, -0.003, 0.02)),
    "fisheye": Camera(size=SIZE, K=K, model="fisheye", distortion=(0.05, -0.02, 0.004, -0.001)),
}


def plane(camera: Camera, normal: npt.ArrayLike, distance_m: float = 2.0) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Z, and the unit scene-frame normal, of the plane n . X = distance_m n_z (camera frame, crossing the axis at distance_m)."""
    n = np.asarray(normal, dtype=np.float64)
    n = n / np.linalg.norm(n)
    Z = distance_m * n[2] / (camera.rays(camera.pixel_grid()) @ n)
    return Z, scene_from_camera(-n if n[2] > 0 else n)


def sphere(camera: Camera, centre: npt.ArrayLike, radius_m: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Z and scene-frame normals of a sphere, NaN off it; centre in the camera frame."""
    rays, c = camera.rays(camera.pixel_grid()), np.asarray(centre, dtype=np.float64)
    a, b = (rays * rays).sum(-1), rays @ c
    with np.errstate(invalid="ignore"):
        Z = (b - np.sqrt(b * b - a * (c @ c - radius_m**2))) / a
    return Z, scene_from_camera((rays * Z[..., None] - c) / radius_m)


def angle_deg(a: npt.ArrayLike, b: npt.ArrayLike) -> npt.NDArray[np.float64]:
    p, q = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(p, q), axis=-1), (p * q).sum(-1)))


def noisy(Z: npt.NDArray[np.float64], sigma_px: float, fx_b: float, seed: int = 3) -> npt.NDArray[np.float64]:
    """Z as a stereo rig sees it: white noise on the disparity."""
    return fx_b / (fx_b / Z + np.random.default_rng(seed).normal(scale=sigma_px, size=Z.shape))


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("normal", [(0, 0, 1), (0.5, -0.3, 1), (-1.6, 0.4, 1)])
def test_planes_are_exact_through_any_lens(name: str, normal: tuple[float, float, float]) -> None:
    Z, true = plane(CAMERAS[name], normal)
    N = normals_from_depth(Z, CAMERAS[name])
    assert N.dtype == np.float32
    assert N.flags.c_contiguous
    assert angle_deg(N, true).max() < FLOAT32_DEG


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.2, 50))
@settings(max_examples=25, deadline=None)
def test_any_plane_in_front_of_the_camera_is_exact(slope_x: float, slope_y: float, distance_m: float) -> None:
    camera = CAMERAS["brown"]
    Z, true = plane(camera, (slope_x, slope_y, 1), distance_m)
    Z[Z <= 0] = np.nan  # where the plane has gone behind the camera
    assert np.nanmax(angle_deg(normals_from_depth(Z, camera), true)) < FLOAT32_DEG


@pytest.mark.parametrize("method", ["plane", "difference"])
@pytest.mark.parametrize("name", CAMERAS)
def test_a_sphere_is_true_away_from_its_edge(name: str, method: str) -> None:
    camera = CAMERAS[name]
    Z, true = sphere(camera, (0.02, -0.03, 1.5), 0.25)
    N = normals_from_depth(Z, camera, method=method)  # type: ignore[arg-type]
    facing = (true * -position_from_depth(Z, camera)).sum(-1) / np.linalg.norm(position_from_depth(Z, camera), axis=-1)
    inner = facing > 0.4  # the silhouette has no neighbours on its far side
    assert inner.sum() > 2000
    assert np.median(angle_deg(N, true)[inner]) < (0.3 if method == "plane" else 1.0)
    assert np.isnan(N[np.isnan(Z)]).all()
    if method == "plane":  # a difference also needs the pixels to the right and below
        assert np.isfinite(N[np.isfinite(Z)]).all()


def test_no_wall_is_invented_between_actor_and_background() -> None:
    """Two slanted planes, one before the other: right normals up to the last pixel on both sides, where differences see a wall."""
    camera = CAMERAS["pinhole"]
    near, near_normal = plane(camera, (0.6, 0.2, 1), 1.0)
    far, far_normal = plane(camera, (-0.4, 0.5, 1), 3.0)
    column, row = np.meshgrid(np.arange(160), np.arange(120))
    actor = np.hypot(column - 80, row - 60) < 35
    true = np.where(actor[..., None], near_normal, far_normal)
    Z = np.where(actor, near, far)
    angle = angle_deg(normals_from_depth(Z, camera), true)
    # A pixel of a round outline may have no 3x3 window on its own side; the rest is exact.
    assert np.percentile(angle, 99.5) < FLOAT32_DEG
    walls = angle_deg(normals_from_depth(Z, camera, method="difference"), true) > 20
    assert walls.sum() > 100
    assert (angle > 20).sum() < 0.1 * walls.sum()


def test_the_edge_stays_clean_under_noise() -> None:
    camera = CAMERAS["pinhole"]
    near, near_normal = plane(camera, (0.6, 0.2, 1), 1.0)
    far, far_normal = plane(camera, (-0.4, 0.5, 1), 3.0)
    column = np.arange(160)[None]
    actor = np.broadcast_to((column > 40) & (column < 110), near.shape)
    Z = noisy(np.where(actor, near, far), 0.1, 300 * 0.1)
    angle = angle_deg(normals_from_depth(Z, camera), np.where(actor[..., None], near_normal, far_normal))
    band = np.zeros(near.shape, dtype=bool)
    for edge in (41, 110):
        band[:, edge - 4 : edge + 4] = True
    assert np.median(angle[band & actor]) < 2
    assert np.median(angle[band & ~actor]) < 6  # three times as far: nine times the noise in Z


def test_a_crease_is_kept() -> None:
    """A box corner: both sides exact up to the row beside it."""
    camera = CAMERAS["pinhole"]
    left, left_normal = plane(camera, (0.8, 0, 1), 2.0)
    right, right_normal = plane(camera, (-0.8, 0, 1), 2.0)
    Z, side = np.maximum(left, right), (left > right)[..., None]
    angle = angle_deg(normals_from_depth(Z, camera), np.where(side, left_normal, right_normal))
    assert (angle > FLOAT32_DEG).mean() < 2 / 160


@pytest.mark.parametrize(("sigma_px", "bound_deg"), [(0.05, 0.5), (0.25, 2.0), (1.0, 8.0)])
def test_noise_makes_the_window_grow(sigma_px: float, bound_deg: float) -> None:
    camera = CAMERAS["pinhole"]
    Z, true = plane(camera, (0.4, 0.2, 1))
    seen = noisy(Z, sigma_px, 300 * 0.2)
    fitted = np.median(angle_deg(normals_from_depth(seen, camera), true))
    assert fitted < bound_deg
    assert fitted < 0.05 * np.median(angle_deg(normals_from_depth(seen, camera, method="difference"), true))


def test_the_window_stays_small_where_there_is_shape() -> None:
    """Ripples of 12 px, exact Z: a window that does not follow the data would smooth them away."""
    camera = CAMERAS["pinhole"]
    u = camera.pixel_grid()[..., 0]
    Z = 2 + 0.01 * np.sin(u * 2 * np.pi / 12)
    P = position_from_depth(Z, camera).astype(np.float64)
    slope = np.gradient(P[..., 2], axis=1) / np.gradient(P[..., 0], axis=1)
    true = np.stack([-slope, 0 * slope, np.ones_like(slope)], -1)
    wide = normals_from_depth(Z, camera, radii_px=(8, 16))
    angle, blurred = angle_deg(normals_from_depth(Z, camera), true), angle_deg(wide, true)
    assert np.median(angle[:, 4:-4]) < 5  # the normal swings by 38 degrees within 3 px
    assert np.median(blurred[:, 4:-4]) > 20


def test_unknown_neighbours_do_not_spoil_and_unknown_pixels_stay_unknown() -> None:
    camera = CAMERAS["brown"]
    Z, true = plane(camera, (0.5, 0.3, 1))
    hole = np.random.default_rng(5).random(Z.shape) < 0.4
    Z[hole] = np.nan
    N = normals_from_depth(Z, camera)
    assert np.isnan(N[hole]).all()
    assert np.isfinite(N[~hole]).mean() > 0.98
    assert np.nanmax(angle_deg(N, true)) < FLOAT32_DEG


def test_nothing_known_or_too_little() -> None:
    camera = Camera(size=(5, 4), K=np.array([[5.0, 0, 2], [0, 5, 1.5], [0, 0, 1]]))
    assert np.isnan(normals_from_depth(np.full((4, 5), np.nan, np.float32), camera)).all()
    lone = np.full((4, 5), np.nan, np.float32)
    lone[2, 2] = 1
    assert np.isnan(normals_from_depth(lone, camera)).all()
    assert np.isfinite(normals_from_depth(np.ones((4, 5), np.float32), camera)).all()


def test_confidence_leaves_neighbours_out() -> None:
    camera = CAMERAS["pinhole"]
    Z, true = plane(camera, (0.5, 0.3, 1))
    bad = np.random.default_rng(6).random(Z.shape) < 0.1
    Z[bad] *= 1.3
    trusted = angle_deg(normals_from_depth(Z, camera, confidence=(~bad).astype(np.float32)), true)[~bad]
    assert trusted.max() < FLOAT32_DEG
    assert np.median(angle_deg(normals_from_depth(Z, camera), true)[~bad]) > 10 * np.median(trusted)


def test_spikes_do_not_speak_for_their_neighbours_but_wires_stay() -> None:
    camera = CAMERAS["pinhole"]
    far, far_normal = plane(camera, (0.4, 0.3, 1), 3.0)
    Z = far.copy()
    spikes = np.random.default_rng(8).random(Z.shape) < 0.01
    Z[spikes] *= 0.7
    assert np.percentile(angle_deg(normals_from_depth(Z, camera), far_normal)[~spikes], 99) < FLOAT32_DEG
    near, near_normal = plane(camera, (-0.5, 0.4, 1), 1.5)
    wire = np.zeros(Z.shape, dtype=bool)
    wire[:, 80:83] = True  # the thinnest that a 3x3 window can lie in
    angle = angle_deg(normals_from_depth(np.where(wire, near, far), camera), np.where(wire[..., None], near_normal, far_normal))
    assert np.percentile(angle, 99) < FLOAT32_DEG


def test_a_scene_twice_as_large_has_the_same_normals() -> None:
    camera = CAMERAS["pinhole"]
    Z, _ = sphere(camera, (0, 0, 1.5), 0.3)
    Z = noisy(np.where(np.isnan(Z), 4.0, Z), 0.1, 30).astype(np.float32)
    np.testing.assert_array_equal(normals_from_depth(2 * Z, camera), normals_from_depth(Z, camera))


def test_normals_turn_with_the_scene() -> None:
    """A scene mirrored left-right, or turned by half a turn about the axis, has its normals mirrored or turned."""
    camera = Camera(size=(96, 64), K=np.array([[150.0, 0, 47.5], [0, 150, 31.5], [0, 0, 1]]))
    Z, _ = sphere(camera, (0.1, -0.05, 1.5), 0.4)
    Z = noisy(np.where(np.isnan(Z), 3.0, Z), 0.05, 15).astype(np.float32)
    N = normals_from_depth(Z, camera)
    mirrored = normals_from_depth(Z[:, ::-1], camera)[:, ::-1] * (-1, 1, 1)
    turned = normals_from_depth(Z[::-1, ::-1], camera)[::-1, ::-1] * (-1, -1, 1)
    # Sums run the other way, so weights differ in their last digits.
    assert np.percentile(angle_deg(mirrored, N), 99) < 0.1
    assert np.percentile(angle_deg(turned, N), 99) < 0.1


@given(st.integers(0, 10**6), st.sampled_from(["plane", "difference"]))
@settings(max_examples=20, deadline=None)
def test_normals_are_unit_and_face_the_camera_whatever_the_depth(seed: int, method: str) -> None:
    camera = Camera(size=(40, 30), K=np.array([[30.0, 0, 19.5], [0, 30, 14.5], [0, 0, 1]]))
    Z = np.exp(np.random.default_rng(seed).normal(size=(30, 40))).astype(np.float32)
    N = normals_from_depth(Z, camera, method=method).astype(np.float64)  # type: ignore[arg-type]
    assert np.isfinite(N).mean() > 0.9
    V = -position_from_depth(Z, camera).astype(np.float64)
    assert np.nanmin((N * V).sum(-1)) > -1e-6
    assert np.nanmax(np.abs(np.linalg.norm(N, axis=-1) - 1)) < 1e-5


def test_disparity_and_depth_give_the_same_normals() -> None:
    """1/Z is affine in disparity, offset of the principal points and all."""
    left = CAMERAS["pinhole"]
    right = Camera(size=SIZE, K=np.array([[300.0, 0, 91.2], [0, 295.0, 57.7], [0, 0, 1]]))
    rig = RectifiedRig(left=left, right=right, baseline_m=0.1)
    Z, true = plane(left, (0.5, -0.3, 1))
    disparity = rig.disparity_from_depth(Z).astype(np.float32)
    disparity[5, 6] = -1000  # behind the rig: no depth, so no normal
    N = normals_from_disparity(disparity, rig)
    assert np.isnan(N[5, 6]).all()
    assert np.nanmedian(angle_deg(N, true)) < FLOAT32_DEG
    seen = noisy(Z, 0.2, 30)
    both = normals_from_disparity(rig.disparity_from_depth(seen).astype(np.float32), rig), normals_from_depth(seen, left)
    assert np.median(angle_deg(*both)) < 0.05


def test_steps_of_a_coarse_disparity_do_not_band_when_their_size_is_told() -> None:
    """Disparity in sixteenths of a pixel is stairs; told so, the window outgrows them."""
    camera = CAMERAS["pinhole"]
    rig = RectifiedRig(left=camera, right=camera, baseline_m=0.1)
    Z, true = plane(camera, (0.15, 0.1, 1))
    stairs = (np.round(rig.disparity_from_depth(Z) * 16) / 16).astype(np.float32)
    told = angle_deg(normals_from_disparity(stairs, rig, noise_px=1 / 16), true)
    assert np.median(told) < 1
    assert np.median(told) <= np.median(angle_deg(normals_from_disparity(stairs, rig), true))


def test_threads_do_not_change_the_answer() -> None:
    import numba

    camera = CAMERAS["pinhole"]
    Z, _ = plane(camera, (0.4, 0.2, 1))
    Z = noisy(Z, 0.2, 30)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = normals_from_depth(Z, camera)
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
        together = normals_from_depth(Z, camera)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(alone, together)


def test_bad_input_is_named() -> None:
    camera = CAMERAS["pinhole"]
    Z = np.full((120, 160), 2.0, np.float32)
    with pytest.raises(PassError, match="did you mean 'plane'"):
        normals_from_depth(Z, camera, method="plain")  # type: ignore[arg-type]
    with pytest.raises(PassError, match="confidence must have shape"):
        normals_from_depth(Z, camera, confidence=np.ones((3, 3), np.float32))
    with pytest.raises(PassError, match="radii_px"):
        normals_from_depth(Z, camera, radii_px=(4, 2))
    with pytest.raises(PassError, match="missing is NaN"):
        normals_from_depth(0 * Z, camera)
    with pytest.raises(PassError, match="shape"):
        normals_from_depth(Z[1:], camera)


@pytest.mark.parametrize("noise", [0.002, 0.01, 0.05])
def test_sigma_is_the_error_of_the_normals(noise: float) -> None:
    """A ball before a wall, its inverse depth blurred noise of any strength: sigma says it in all five bins."""
    camera = Camera.from_fov(40, (240, 180))
    slopes = camera.ray_grid().astype(np.float64)
    rays = np.concatenate([slopes, np.ones((180, 240, 1))], axis=-1)
    centre, radius = np.array([0.0, 0.0, 1.5]), 0.35
    along, square = rays @ centre, (rays**2).sum(axis=-1)
    inside = along**2 - square * (centre @ centre - radius**2)
    ball = inside > 0
    Z = np.where(ball, (along - np.sqrt(np.maximum(inside, 0))) / square, 3.0)
    true = np.where(ball[..., None], (rays * Z[..., None] - centre) / radius * (1, -1, -1), (0.0, 0.0, 1.0))
    grain = np.random.default_rng(11).standard_normal(Z.shape)
    soft = sum(np.roll(grain, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)) / 3  # neighbours agree, as in matching
    N, sigma = normals_and_sigma((1 / (1 / Z + noise * soft / Z.mean())).astype(np.float32), camera)
    assert sigma is not None
    assert np.isfinite(sigma[np.isfinite(N[..., 0])]).all()
    angle = angle_deg(N, true)
    edges = np.quantile(sigma, np.linspace(0, 1, 6))
    bins = [(sigma >= low) & (sigma <= high) for low, high in pairwise(edges)]
    ratios = [float(np.quantile(angle[one], 0.683) / sigma[one].mean()) for one in bins]
    assert min(ratios) > 0.6, ratios
    assert max(ratios) < 1.3, ratios
    assert np.mean(ratios) == pytest.approx(1, abs=0.3), ratios
    assert sigma[bins[4]].mean() > 2 * sigma[bins[0]].mean(), "or the bins would prove nothing"


def test_differences_say_no_sigma() -> None:
    camera = Camera.from_fov(40, (20, 10))
    assert normals_and_sigma(np.ones((10, 20), np.float32), camera, method="difference")[1] is None
