"""Positions: exact unprojection for every lens, and the one door between the camera frame and the scene frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera
from stereorelight.errors import PassError, RigError
from stereorelight.surface.position import camera_from_scene, paper_position, position_from_depth, scene_from_camera

K = np.array([[90.0, 0, 47.3], [0, 88.0, 30.1], [0, 0, 1]])
CAMERAS = {
    "pinhole": Camera(size=(96, 64), K=K),
    "brown": Camera(size=(96, 64), K=K, distortion=(-0.21, 0.06, 0.001, -0.002, 0.01)),
    "rational": Camera(size=(96, 64), K=K, model="rational", distortion=(0.3, 0.05, 0.001, -0.001, 0.01, 0.45, 0.1, 0.01)),
    "fisheye": Camera(size=(96, 64), K=K, model="fisheye", distortion=(0.02, -0.01, 0.003, -0.001)),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_positions_project_back_to_their_pixels(name: str) -> None:
    camera = CAMERAS[name]
    Z = np.random.default_rng(1).uniform(0.3, 20, camera.size_hw).astype(np.float32)
    P = position_from_depth(Z, camera)
    assert P.dtype == np.float32
    assert P.flags.c_contiguous
    np.testing.assert_array_equal(P[..., 2], -Z)
    # float32 P: half a unit in the last place is 6e-8 of its value, times fx 90 px
    assert np.abs(camera.project(camera_from_scene(P)) - camera.pixel_grid()).max() < 1e-3


@pytest.mark.parametrize("name", CAMERAS)
def test_positions_match_the_analytic_plane(name: str) -> None:
    camera = CAMERAS[name]
    rays = camera.rays(camera.pixel_grid())
    normal, offset = np.array([0.3, -0.2, 1.0]), 3.0
    points = rays * (offset / (rays @ normal))[..., None]
    P = position_from_depth(points[..., 2], camera)
    assert np.abs(P - scene_from_camera(points)).max() < 1e-5  # metres


def test_up_is_up_and_the_camera_looks_down_minus_z() -> None:
    P = position_from_depth(np.full((64, 96), 2.0), CAMERAS["pinhole"])
    assert P[0, 0, 0] < 0 < P[0, -1, 0]
    assert P[0, 0, 1] > 0 > P[-1, 0, 1]
    assert (P[..., 2] == -2).all()


@given(st.lists(st.tuples(*[st.floats(-100, 100)] * 3), min_size=1, max_size=5))
@settings(max_examples=30, deadline=None)
def test_frames_meet_in_a_rotation_that_undoes_itself(points: list[tuple[float, float, float]]) -> None:
    p = np.array(points)
    np.testing.assert_array_equal(camera_from_scene(scene_from_camera(p)), p)
    assert np.linalg.det(scene_from_camera(np.eye(3))) == 1  # a mirror would turn normals inside out


def test_unknown_depth_is_unknown_position() -> None:
    Z = np.full((64, 96), 2.0, dtype=np.float32)
    Z[10, 20] = np.nan
    P = position_from_depth(Z, CAMERAS["brown"])
    assert np.isnan(P[10, 20]).all()
    assert np.isfinite(P).sum() == 3 * (Z.size - 1)


def test_depth_that_is_not_positive_is_refused() -> None:
    for bad in (0.0, -1.0, np.inf):
        Z = np.full((64, 96), 2.0, dtype=np.float32)
        Z[3, 4] = bad
        with pytest.raises(PassError, match="missing is NaN"):
            position_from_depth(Z, CAMERAS["pinhole"])
    with pytest.raises(PassError, match="shape"):
        position_from_depth(np.ones((4, 5), np.float32), CAMERAS["pinhole"])


def test_paper_equations_as_printed() -> None:
    """Worked by hand from equations 1-2, misprints and all; the exact position differs from them everywhere."""
    P = paper_position(np.full((2, 4), 5.0, np.float32), 60)
    s = math.sin(math.radians(30))
    np.testing.assert_allclose(P[0, :, 0], [s, s * 3 / 4, s / 2, s / 4], rtol=1e-6)
    np.testing.assert_allclose(P[:, 0, 1], [2 * s, s], rtol=1e-6)
    np.testing.assert_array_equal(P[..., 2], 5)
    exact = position_from_depth(np.full((2, 4), 5.0), Camera.from_fov(60, (4, 2)))
    assert np.abs(np.abs(exact[..., :2]) - np.abs(P[..., :2])).min() > 0.1
    with pytest.raises(RigError, match="fov_deg"):
        paper_position(np.ones((2, 4), np.float32), 180)
