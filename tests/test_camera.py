"""Cameras and rigs: projection and its inverse, edges that stay under scaling, disparity and depth, and every refusal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.camera import Camera, RectifiedRig, Rig
from stereorelight.errors import RigError

SIZE = (160, 120)
K = np.array([[300.0, 0, 81.2], [0, 295.0, 57.7], [0, 0, 1]])
LENSES: dict[str, dict[str, Any]] = {
    "pinhole": {},
    "brown4": {"distortion": (-0.25, 0.1, 0.002, -0.003)},
    "brown5": {"distortion": (0.2, -0.1, 0.002, -0.003, 0.02)},
    "rational": {"model": "rational", "distortion": (0.3, 0.05, 0.001, -0.002, 0.01, 0.5, 0.1, 0.02)},
    "fisheye": {"model": "fisheye", "distortion": (0.05, -0.02, 0.004, -0.001)},
}
CAMERAS = {name: Camera(size=SIZE, K=K, **lens) for name, lens in LENSES.items()}
PIXEL = 1e-6  # px: a lens is undone to 1e-9 of normalised units, at fx 300
AXIS = st.floats(-0.4, 0.4)


def rotation(x: float, y: float, z: float) -> npt.NDArray[np.float64]:
    """From three angles, radians."""
    cx, sx, cy, sy, cz, sz = math.cos(x), math.sin(x), math.cos(y), math.sin(y), math.cos(z), math.sin(z)
    Rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    Rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def refusal(make: Any, *args: Any, **given: Any) -> str:
    with pytest.raises(RigError) as caught:
        make(*args, **given)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# ---- one camera


def test_pinhole_by_hand() -> None:
    camera = CAMERAS["pinhole"]
    u, v = camera.project((0.5, -0.2, 2.0))
    assert (u, v) == pytest.approx((81.2 + 300 * 0.25, 57.7 - 295 * 0.1), abs=1e-12)
    assert camera.unproject((81.2, 57.7), 3.0) == pytest.approx((0, 0, 3))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (300, 295, 81.2, 57.7)
    assert camera.size_hw == (120, 160)


@pytest.mark.parametrize("name", CAMERAS)
@given(Z=st.floats(1e-3, 1e5))
def test_project_undoes_unproject(name: str, Z: float) -> None:
    camera = CAMERAS[name]
    pixels = camera.pixel_grid()[::7, ::7]
    points = camera.unproject(pixels, np.full(pixels.shape[:2], Z))
    assert np.array_equal(points[..., 2], np.full(pixels.shape[:2], Z))  # Z is the distance along the axis, not along the ray
    assert np.abs(camera.project(points) - pixels).max() < PIXEL


@pytest.mark.parametrize("name", CAMERAS)
def test_grids(name: str) -> None:
    camera = CAMERAS[name]
    grid = camera.pixel_grid()
    assert grid.shape == (120, 160, 2)
    assert tuple(grid[5, 9]) == (9, 5)
    rays = camera.ray_grid()
    assert rays.dtype == np.float32
    assert rays.flags.c_contiguous
    assert np.array_equal(rays, camera.rays(grid)[..., :2].astype(np.float32))
    assert np.array_equal(camera.rays(grid)[..., 2], np.ones((120, 160)))


def test_behind_the_camera_is_unknown() -> None:
    assert np.isnan(CAMERAS["brown5"].project([(0.1, 0.1, -1.0), (0.1, 0.1, 0.0), (0.1, 0.1, np.nan)])).all()


def test_beyond_the_lens_is_unknown() -> None:
    camera = Camera(size=SIZE, K=K, distortion=(-0.3, 0, 0, 0))  # folds at a radius of 1.054
    assert np.isfinite(camera.project((1.04, 0, 1))).all()
    assert np.isnan(camera.project((1.07, 0, 1))).all()
    assert np.isnan(camera.project((3, 2, 1))).all()


@pytest.mark.parametrize("name", CAMERAS)
@given(width=st.integers(1, 500), height=st.integers(1, 500))
def test_scaled_keeps_pixel_edges(name: str, width: int, height: int) -> None:
    camera = CAMERAS[name]
    smaller = camera.scaled((width, height))
    points = camera.unproject(camera.pixel_grid()[::30, ::30], np.full((4, 6), 2.0))
    s = np.array([width / SIZE[0], height / SIZE[1]])
    expected = (camera.project(points) + 0.5) * s - 0.5
    assert np.abs(smaller.project(points) - expected).max() < 1e-9
    assert smaller.size == (width, height)
    assert (smaller.model, smaller.distortion) == (camera.model, camera.distortion)
    # The frame's own corners are corners again: the outer edge of the first and of the last pixel.
    assert smaller._normalised([(-0.5, -0.5), (width - 0.5, height - 0.5)]) == pytest.approx(
        camera._normalised([(-0.5, -0.5), (SIZE[0] - 0.5, SIZE[1] - 0.5)]), abs=1e-12
    )


@given(width=st.integers(1, 500), height=st.integers(1, 500))
def test_scaling_back_is_the_same_camera(width: int, height: int) -> None:
    camera = CAMERAS["brown5"]
    assert np.allclose(camera.scaled((width, height)).scaled(SIZE).K, camera.K, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("name", CAMERAS)
def test_cropped_shifts_pixels(name: str) -> None:
    camera = CAMERAS[name]
    window = camera.cropped(12, -5, (100, 110))
    points = camera.unproject(camera.pixel_grid()[::30, ::30], np.full((4, 6), 2.0))
    assert np.abs(window.project(points) - (camera.project(points) - (12, -5))).max() < 1e-9
    assert window.size == (100, 110)


def test_pose_survives_scale_and_crop() -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(0.1, 0.2, 0.3), (1, 2, 3)
    camera = replace(CAMERAS["brown4"], world_from_camera=pose)
    for other in (camera.scaled((80, 60)), camera.cropped(1, 2, (50, 40)), camera.undistorted()):
        assert np.array_equal(other.world_from_camera, pose)


def test_undistorted_is_a_pinhole() -> None:
    assert CAMERAS["brown5"].distorts
    assert CAMERAS["fisheye"].distorts
    assert Camera(size=SIZE, K=K, model="fisheye").distorts  # a fisheye bends also with every parameter at zero
    for camera in (CAMERAS["brown5"].undistorted(), CAMERAS["fisheye"].undistorted(), Camera(size=SIZE, K=K, distortion=(0, 0, 0, 0))):
        assert not camera.distorts
        assert camera.project((0.5, -0.2, 2.0)) == pytest.approx((156.2, 28.2), abs=1e-12)


@given(fov=st.floats(0.5, 175), width=st.integers(1, 4000), height=st.integers(1, 4000), aspect=st.floats(0.25, 4))
def test_from_fov_spans_the_outer_edges(fov: float, width: int, height: int, aspect: float) -> None:
    camera = Camera.from_fov(fov, (width, height), pixel_aspect=aspect)
    left, right, top, bottom = camera.rays([(-0.5, 0), (width - 0.5, 0), (0, -0.5), (0, height - 0.5)])
    assert math.degrees(math.atan(right[0])) == pytest.approx(fov / 2, rel=1e-9)
    assert left[0] == pytest.approx(-right[0], rel=1e-9)
    assert bottom[1] == pytest.approx(-top[1], rel=1e-9)
    assert camera.fy == pytest.approx(camera.fx * aspect)  # a pixel `aspect` times as wide as high


def test_camera_is_frozen_and_its_matrices_too() -> None:
    given = K.copy()
    camera = Camera(size=SIZE, K=given)
    given[0, 0] = 1
    assert camera.fx == 300
    with pytest.raises(AttributeError):
        camera.size = (1, 1)  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1


def with_k(row: int, column: int, value: float) -> npt.NDArray[np.float64]:
    k = K.copy()
    k[row, column] = value
    return k


def pose_with(block: npt.ArrayLike, last: npt.ArrayLike = (0, 0, 0, 1)) -> npt.NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3], pose[3] = block, last
    return pose


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"size": (0, 120)}, "at least 1"),
        ({"size": (-160, 120)}, "at least 1"),
        ({"size": (160.5, 120)}, "whole numbers"),
        ({"size": (math.inf, 120)}, "[width, height]"),
        ({"size": (math.nan, 120)}, "[width, height]"),
        ({"size": 160}, "[width, height]"),
        ({"size": (160, 120, 3)}, "[width, height]"),
        ({"size": ("160", "120")}, "whole numbers"),
        ({"size": "wide"}, "[width, height]"),
        ({"K": np.eye(4)}, "shape (3, 3), got (4, 4)"),
        ({"K": [300, 80, 60]}, "shape (3, 3), got (3,)"),
        ({"K": [[1, 2], [3]]}, "numbers"),
        ({"K": "K"}, "numbers"),
        ({"K": [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]}, "numbers"),
        ({"K": with_k(0, 0, math.nan)}, "K holds a value that is not finite"),
        ({"K": with_k(0, 2, math.inf)}, "K holds a value that is not finite"),
        ({"K": with_k(0, 0, -300)}, "'mirrored', not by a sign"),
        ({"K": with_k(1, 1, 0)}, "focal lengths must be > 0"),
        ({"K": with_k(0, 1, 0.5)}, "without skew"),
        ({"K": with_k(1, 0, 0.5)}, "without skew"),
        ({"K": with_k(2, 2, 2)}, "without skew"),
        ({"K": K.T}, "without skew"),
        ({"model": "broun"}, "did you mean 'brown'"),
        ({"distortion": (0.1,)}, "takes 0 or 4 or 5 parameters, got 1"),
        ({"distortion": (0.1, math.nan, 0, 0)}, "not finite"),
        ({"world_from_camera": np.eye(3)}, "shape (4, 4), got (3, 3)"),
        ({"world_from_camera": pose_with(2 * np.eye(3))}, "not a rotation"),
        ({"world_from_camera": pose_with(np.diag([1, 1, -1]))}, "reflection"),
        ({"world_from_camera": pose_with(np.eye(3), (1, 2, 3, 1))}, "row 0 0 0 1"),
        ({"world_from_camera": np.full((4, 4), math.nan)}, "not finite"),
    ],
)
def test_camera_refused(changes: Mapping[str, Any], words: str) -> None:
    assert words in refusal(Camera, **{"size": SIZE, "K": K, **changes})


@pytest.mark.parametrize(
    ("lens", "reach"),
    [
        ({"distortion": (-0.3, 0.0, 0.0, 0.0)}, 1.05 * (1 - 0.3 * 1.05**2)),
        ({"distortion": (-0.9, 0.35, 0.0, 0.0, 0.0)}, 0.45),  # grows again beyond its fold: the corners have an answer, a wrong one
        ({"model": "fisheye", "distortion": (-0.3, 0.0, 0.0, 0.0)}, 0.70),
    ],
)
def test_lens_that_folds_inside_the_frame_is_refused(lens: dict[str, Any], reach: float) -> None:
    corner = math.hypot(80, 60)
    inside, outside = corner / (reach * 0.9), corner / (reach * 1.15)
    centred = lambda f: np.array([[f, 0, 79.5], [0, f, 59.5], [0, 0, 1]])  # noqa: E731
    Camera(size=SIZE, K=centred(inside), **lens)
    words = refusal(Camera, size=SIZE, K=centred(outside), **lens)
    assert "folds over inside the frame, at pixel" in words
    assert "simpler lens model" in words


@pytest.mark.parametrize("fov", [0, -10, 180, 200, math.nan, math.inf])
def test_from_fov_refused(fov: float) -> None:
    assert "between 0 and 180" in refusal(Camera.from_fov, fov, (10, 10))


@pytest.mark.parametrize("aspect", [0, -1, math.nan, math.inf])
def test_from_fov_aspect_refused(aspect: float) -> None:
    refusal(Camera.from_fov, 60, (10, 10), pixel_aspect=aspect)


def test_empty_scale_and_crop_refused() -> None:
    refusal(CAMERAS["pinhole"].scaled, (0, 10))
    refusal(CAMERAS["pinhole"].cropped, 0, 0, (10, 0))


# ---- two eyes

EYE = CAMERAS["pinhole"]
RIG: dict[str, Any] = {"left": EYE, "right": EYE, "R_right_left": np.eye(3), "t_right_left_m": (-0.065, 0, 0)}


@given(x=AXIS, y=AXIS, z=AXIS, b=st.floats(1e-3, 10))
def test_right_centre_is_where_the_right_eye_stands(x: float, y: float, z: float, b: float) -> None:
    R, centre = rotation(x, y, z), np.array([b, 0.2 * b, -0.1 * b])
    rig = Rig(**{**RIG, "R_right_left": R, "t_right_left_m": -R @ centre})
    assert rig.right_centre_m == pytest.approx(centre, rel=1e-9, abs=1e-12)
    assert rig.baseline_m == pytest.approx(np.linalg.norm(centre))
    assert np.array_equal(rig.R_right_left, R)


def test_rig_hands_out_its_eyes() -> None:
    rig = Rig(**{**RIG, "right": CAMERAS["brown5"]})
    assert rig.camera("left") is EYE
    assert rig.camera("right") is CAMERAS["brown5"]


def test_matrix_printed_with_five_digits_becomes_a_rotation() -> None:
    R = np.round(rotation(0.1, -0.2, 0.05), 5)
    rig = Rig(**{**RIG, "R_right_left": R, "t_right_left_m": -R @ (0.065, 0, 0)})
    assert np.abs(rig.R_right_left @ rig.R_right_left.T - np.eye(3)).max() < 1e-14
    assert np.abs(rig.R_right_left - R).max() < 1e-5


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"R_right_left": 1.001 * np.eye(3)}, "not a rotation"),
        ({"R_right_left": np.zeros((3, 3))}, "3x3 matrix that the calibration wrote"),
        ({"R_right_left": np.diag([-1, 1, 1])}, "said by 'mirrored', not by R"),
        ({"R_right_left": [0.1, 0.2, 0.3]}, "shape (3, 3), got (3,)"),
        ({"R_right_left": np.full((3, 3), math.nan)}, "not finite"),
        ({"R_right_left": None}, "R_right_left"),
        ({"t_right_left_m": (0, 0, 0)}, "two eyes at one place"),
        ({"t_right_left_m": (-0.065, 0)}, "shape (3,), got (2,)"),
        ({"t_right_left_m": [[-0.065], [0], [0]]}, "shape (3,), got (3, 1)"),
        ({"t_right_left_m": (math.inf, 0, 0)}, "not finite"),
        ({"t_right_left_m": ("a", 0, 0)}, "numbers"),
        ({"t_right_left_m": (0.065, 0, 0)}, "are left and right swapped?"),
        ({"t_right_left_m": (-0.01, 0.065, 0)}, "mainly to the right"),
        ({"t_right_left_m": (0, -0.065, 0)}, "mainly to the right"),
        ({"t_right_left_m": (-0.01, 0, 0.065)}, "check t_right_left_m"),
        ({"mirrored": "top"}, "null, 'left' or 'right'"),
        ({"mirrored": True}, "null, 'left' or 'right'"),
        ({"mirrored": ["left"]}, "null, 'left' or 'right'"),
    ],
)
def test_rig_refused(changes: Mapping[str, Any], words: str) -> None:
    assert words in refusal(Rig, **{**RIG, **changes})


def test_swapping_the_eyes_of_a_good_rig_is_noticed() -> None:
    R = rotation(0.02, 0.1, -0.01)
    good = Rig(**{**RIG, "R_right_left": R, "t_right_left_m": -R @ (0.065, 0.002, 0.004)})
    swapped = {"left": good.right, "right": good.left, "R_right_left": R.T, "t_right_left_m": -R.T @ good.t_right_left_m}
    assert "are left and right swapped?" in refusal(Rig, **swapped)


# ---- rectified eyes


def rectified(doffs_px: float = 0.0, baseline_m: float = 0.065) -> RectifiedRig:
    right = replace(EYE, K=np.array([[300.0, 0, 81.2 + doffs_px], [0, 295.0, 57.7], [0, 0, 1]]))
    return RectifiedRig(left=EYE, right=right, baseline_m=baseline_m)


@given(Z=st.floats(1e-2, 1e4), doffs=st.floats(-200, 200), b=st.floats(1e-3, 5))
def test_disparity_and_depth_are_inverses(Z: float, doffs: float, b: float) -> None:
    rig = rectified(doffs, b)
    # d + doffs loses digits where doffs is far larger than fx b / Z.
    slack = 1e-12 * (1 + abs(doffs) * Z / (300 * b))
    assert float(rig.depth_from_disparity(rig.disparity_from_depth(Z))) == pytest.approx(Z, rel=slack)
    assert rig.doffs_px == pytest.approx(doffs, abs=1e-12)


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), Z=st.floats(0.3, 50), doffs=st.floats(-60, 60))
def test_a_point_seen_by_both_eyes(x: float, y: float, Z: float, doffs: float) -> None:
    """Disparity is x_left - x_right of one point in space, of either sign, and gives its Z back."""
    rig = rectified(doffs)
    left, right = rig.left.project((x, y, Z)), rig.right.project((x - rig.baseline_m, y, Z))
    assert left[1] == pytest.approx(right[1], abs=1e-9)
    assert float(rig.disparity_from_depth(Z)) == pytest.approx(left[0] - right[0], abs=1e-9)
    assert float(rig.depth_from_disparity(left[0] - right[0])) == pytest.approx(Z, rel=1e-8)


def test_negative_disparities_lie_beyond_the_convergence() -> None:
    rig = rectified(doffs_px=10.0)
    near, far = rig.disparity_from_depth([0.5, 10.0])
    assert near > 0 > far
    assert rig.depth_from_disparity([near, far]) == pytest.approx([0.5, 10.0])


def test_what_is_not_in_front_is_unknown() -> None:
    rig = rectified(doffs_px=10.0)
    assert np.isnan(rig.depth_from_disparity([-10.0, -11.0, np.nan, -np.inf])).all()
    assert np.isnan(rig.disparity_from_depth([0.0, -1.0, np.nan])).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"baseline_m": 0.0}, "must be > 0"),
        ({"baseline_m": -0.065}, "are left and right swapped?"),
        ({"baseline_m": math.nan}, "must be > 0"),
        ({"baseline_m": math.inf}, "baseline_m"),
        ({"left": CAMERAS["brown5"]}, "rectify the plates first"),
        ({"right": CAMERAS["fisheye"]}, "rectify the plates first"),
        ({"right": replace(EYE, K=with_k(0, 0, 301))}, "is the pair rectified?"),
        ({"right": replace(EYE, K=with_k(1, 1, 296))}, "is the pair rectified?"),
        ({"right": replace(EYE, K=with_k(1, 2, 58))}, "is the pair rectified?"),
        ({"right": replace(EYE, size=(160, 121))}, "is the pair rectified?"),
        ({"R_rectified_left": 2 * np.eye(3)}, "R_rectified_left is not a rotation"),
        ({"R_rectified_right": np.diag([1, -1, 1])}, "R_rectified_right is a reflection"),
    ],
)
def test_rectified_rig_refused(changes: Mapping[str, Any], words: str) -> None:
    assert words in refusal(RectifiedRig, **{"left": EYE, "right": EYE, "baseline_m": 0.065, **changes})


def test_rectified_eyes_may_differ_in_width() -> None:
    RectifiedRig(left=EYE, right=replace(EYE, size=(200, 120)), baseline_m=0.065)
