"""Rectification: known rigs in, agreeing rows and the stated disparity out; plates there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera, Rig
from stereorelight.errors import PlateError, RigError
from stereorelight.stereo.rectify import rectification

SIZE = (96, 64)


def turn(x_deg: float, y_deg: float, z_deg: float) -> np.ndarray:
    x, y, z = np.radians((x_deg, y_deg, z_deg))
    Rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    Ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    Rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def rig(angles=(0.5, 3.0, -0.4), centre=(0.065, 0.003, -0.002), distortion=(-0.12, 0.02, 0.001, -0.001), zoom=1.01, mirrored=None) -> Rig:
    K = np.array([[120.0, 0, 47.0], [0, 121.0, 30.5], [0, 0, 1]])
    R = turn(*angles)
    right = Camera(size=SIZE, K=K * np.array([[zoom], [zoom], [1]]), distortion=distortion)
    return Rig(
        left=Camera(size=SIZE, K=K, distortion=distortion), right=right, R_right_left=R, t_right_left_m=-R @ np.array(centre), mirrored=mirrored
    )


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.floats(-2, 2)] * 3), st.floats(0.02, 0.3), st.floats(-0.01, 0.01), st.integers(0, 2**31))
def test_rows_agree_and_disparity_is_inverse_depth(angles, x, y, seed) -> None:
    shot = rig(angles=angles, centre=(x, y, 0.3 * y))
    rectified = rectification(shot).rig
    points = np.random.default_rng(seed).uniform((-0.3, -0.2, 1.0), (0.3, 0.2, 5.0), (50, 3))
    left = points @ rectified.R_rectified_left.T
    right = (points @ shot.R_right_left.T + shot.t_right_left_m) @ rectified.R_rectified_right.T
    a, b = rectified.left.project(left), rectified.right.project(right)
    assert np.abs(a[:, 1] - b[:, 1]).max() < 1e-9
    assert np.abs((a - b)[:, 0] - rectified.disparity_from_depth(left[:, 2])).max() < 1e-9
    assert np.abs(rectified.depth_from_disparity((a - b)[:, 0]) - left[:, 2]).max() < 1e-9


def test_every_left_pixel_has_a_place_and_finds_its_way_back() -> None:
    r = rectification(rig())
    there = r.rectified_from_original("left")
    w, h = r.rig.left.size
    assert np.isfinite(there).all()
    assert there.min() >= -0.5
    assert (there[..., 0] <= w - 0.5).all()
    assert (there[..., 1] <= h - 0.5).all()
    rays = r.rig.left.rays(there.astype(np.float64)) @ r.rig.R_rectified_left
    assert np.abs(r.original.left.project(rays) - r.original.left.pixel_grid()).max() < 1e-4


def test_depth_stretch_is_exact() -> None:
    r = rectification(rig())
    rays = r.original.left.rays(r.original.left.pixel_grid())
    Z = 1.7 + 0.2 * rays[..., 0]
    Z_rectified = ((rays * Z[..., None]) @ r.rig.R_rectified_left.T)[..., 2]
    assert np.abs(Z_rectified * r.original_over_rectified_depth("left") - Z).max() < 1e-12


def test_a_rectified_pair_is_left_alone_bit_for_bit() -> None:
    K = np.array([[120.0, 0, 47.0], [0, 120.0, 30.5], [0, 0, 1]])
    shifted = K + np.array([[0, 0, 9.5], [0, 0, 0], [0, 0, 0]])
    shot = Rig(left=Camera(size=SIZE, K=K), right=Camera(size=SIZE, K=shifted), R_right_left=np.eye(3), t_right_left_m=np.array([-0.1, 0, 0]))
    r = rectification(shot)
    plate = np.random.default_rng(1).random((SIZE[1], SIZE[0], 3), dtype=np.float32)
    assert r.identity
    assert r.rig.doffs_px == 9.5
    assert np.array_equal(r.rectify(plate, "right"), plate)


def test_a_smooth_plate_survives_rectification() -> None:
    shot = rig()
    r = rectification(shot)

    def scene(rays: np.ndarray) -> np.ndarray:
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
        return np.stack([0.5 + 0.3 * np.sin(20 * x), 0.5 + 0.3 * np.cos(25 * y), 0.5 + 0.2 * np.sin(15 * (x + y))], axis=-1).astype(np.float32)

    shown = r.rectify(scene(shot.left.rays(shot.left.pixel_grid())), "left")
    wanted = scene(r.rig.left.rays(r.rig.left.pixel_grid()) @ r.rig.R_rectified_left)
    inside = np.isfinite(shown).all(axis=2)
    inside[:4] = inside[-4:] = inside[:, :4] = inside[:, -4:] = False  # the border is repeated, not known
    assert inside.mean() > 0.6
    assert np.median(np.abs(shown - wanted)[inside]) < 1e-3


def test_upright_flips_the_mirrored_eye_only() -> None:
    r = rectification(rig(mirrored="right"))
    plate = np.arange(SIZE[0] * SIZE[1] * 3, dtype=np.float32).reshape(SIZE[1], SIZE[0], 3)
    assert np.array_equal(r.upright(plate, "left"), plate)
    assert np.array_equal(r.upright(plate, "right"), plate[:, ::-1])
    assert np.array_equal(r.upright(r.upright(plate, "right"), "right"), plate)


def test_a_plate_of_another_size_is_refused_with_both_sizes() -> None:
    r = rectification(rig())
    with pytest.raises(PlateError, match="right plate is 48x32, but the rig was calibrated at 96x64"):
        r.rectify(np.zeros((32, 48, 3), np.float32), "right")


def test_eyes_that_look_apart_are_refused() -> None:
    with pytest.raises(RigError, match="turned"):
        rectification(rig(angles=(0, 60, 0), distortion=()))
