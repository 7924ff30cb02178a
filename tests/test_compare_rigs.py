"""Two rigs apart: nothing between equal ones, and the exact size of every difference that was made."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.camera import Camera, Rig
from stereorelight.compare.rigs import compare_rigs, eye_difference, pair_difference, spread
from stereorelight.errors import RigError
from stereorelight.interchange.parts import rotation_from_vector
from stereorelight.synth.rigs import RIGS, parallel_rig, rig_named

SIZE = (640, 360)
ROUNDING = 1e-9


def with_left(rig: Rig, **changes: object) -> Rig:
    return replace(rig, left=replace(rig.left, **changes))  # type: ignore[arg-type]


def moved(camera: Camera, cx: float) -> np.ndarray:
    K = camera.K.copy()
    K[0, 2] += cx
    return K


def turned_right(rig: Rig, deg: float) -> Rig:
    """The right eye turned about its own centre, so that it looks further right."""
    a = math.radians(deg)
    yaw = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    R = yaw.T @ rig.R_right_left
    return replace(rig, R_right_left=R, t_right_left_m=-R @ rig.right_centre_m)


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_is_no_distance_from_itself(name: str) -> None:
    rig = rig_named(name, SIZE)
    found = compare_rigs(rig, rig)
    for eye in (found.left, found.right):
        assert np.nanmax(np.abs(eye.apart_px)) < 1e-6  # undoing a lens is exact to 1e-9 of the focal length
        assert np.linalg.norm(eye.turn_deg) < 1e-7
    for pair in found.pairs:
        assert np.nanmax(np.abs(pair.vertical_px)) < 1e-5
        assert np.nanmax(np.abs(pair.disparity_px)) < 1e-5
        assert spread(pair.depth_mm).cover_percent > 50
    assert (found.turn_deg, found.lean_deg) == pytest.approx((0, 0), abs=1e-6)
    assert found.words == ()


@pytest.mark.parametrize("name", ["parallel", "distorted"])
def test_a_principal_point_that_moved_says_so_and_is_mostly_a_turn(name: str) -> None:
    rig = rig_named(name, SIZE)
    found = compare_rigs(with_left(rig, K=moved(rig.left, 1.0)), rig)
    assert np.abs(found.left.apart_px - (1.0, 0.0)).max() < 1e-6
    assert spread(found.left.apart_px).mean == pytest.approx(1.0, abs=1e-6)
    assert spread(found.left.turned_px).p95 < 0.15
    assert abs(found.left.turn_deg[1]) == pytest.approx(math.degrees(1 / rig.left.fx), rel=0.1)
    assert spread(found.right.apart_px).largest < 1e-6


@given(cx=st.floats(-5, 5), zoom=st.floats(0.97, 1.03), k1=st.floats(-0.05, 0.05), nudge=st.sampled_from(np.vstack([np.eye(3), -np.eye(3)]).tolist()))
def test_the_fitted_turn_is_the_best_one(cx: float, zoom: float, k1: float, nudge: list[float]) -> None:
    truth = rig_named("distorted", (320, 180)).left
    K = moved(truth, cx)
    K[[0, 1], [0, 1]] *= zoom
    result = replace(truth, K=K, distortion=(truth.distortion[0] + k1, *truth.distortion[1:]))
    found = eye_difference(result, truth, columns=9)

    def squares(turn_deg: np.ndarray) -> float:
        rays = truth.rays(found.pixels) @ rotation_from_vector(np.radians(turn_deg).tolist()).T
        return float(np.square(result.project(rays) - found.pixels).sum())

    assert squares(found.turn_deg) == pytest.approx(np.square(found.turned_px).sum(), abs=1e-9)
    assert squares(found.turn_deg + 1e-3 * np.array(nudge)) >= squares(found.turn_deg) - 1e-9
    assert spread(found.turned_px).mean <= spread(found.apart_px).largest + ROUNDING


@pytest.mark.parametrize("deg", [0.05, -0.2])
@pytest.mark.parametrize("distance_m", [0.8, 3.0])
def test_a_yaw_of_the_right_eye_shifts_disparity_by_its_formula(deg: float, distance_m: float) -> None:
    truth = parallel_rig(SIZE)
    found = pair_difference(turned_right(truth, deg), truth, distance_m)
    f, cx, b = truth.left.fx, truth.left.cx, truth.baseline_m
    x_left = (np.linspace(0, SIZE[0] - 1, 33) - cx) / f
    x_right = x_left - b / distance_m
    # The result takes each right ray for turned by the angle.
    expected = f * (x_right - np.tan(np.arctan(x_right) + math.radians(deg)))
    middle = found.disparity_px[found.disparity_px.shape[0] // 2]
    seen = np.isfinite(middle)
    assert seen.sum() > 20
    assert np.abs(middle - expected)[seen].max() < 1e-6
    depth = 1000 * (f * b / (f * b / distance_m + expected) - distance_m)
    assert np.abs(found.depth_mm[found.depth_mm.shape[0] // 2] - depth)[seen].max() < 1e-3
    whole = compare_rigs(turned_right(truth, deg), truth)
    assert whole.turn_deg == pytest.approx(abs(deg), abs=ROUNDING)
    assert whole.lean_deg == pytest.approx(0, abs=1e-6)


def test_rows_show_a_pitch_with_its_sign() -> None:
    """The result believes that the right eye looks up by a: then what the truth's right eye sees lies higher, in its rows, than it is."""
    truth = parallel_rig(SIZE)
    a = math.radians(0.1)
    R = np.array([[1, 0, 0], [0, math.cos(a), math.sin(a)], [0, -math.sin(a), math.cos(a)]])
    result = replace(truth, R_right_left=R, t_right_left_m=-R @ truth.right_centre_m)
    found = pair_difference(result, truth, 2.0)
    middle = spread(found.vertical_px).middle
    assert abs(middle) == pytest.approx(truth.left.fx * math.tan(a), rel=0.02)
    up = result.right.project(R @ np.array([0.0, 0.0, 2.0]))  # where a level ray lands in an eye that does look up: lower down
    assert (middle < 0) == (up[1] > truth.right.cy)


def test_a_baseline_off_by_a_per_cent_puts_everything_a_per_cent_off() -> None:
    truth = rig_named("hard", SIZE)
    result = replace(truth, t_right_left_m=1.01 * truth.t_right_left_m)
    found = compare_rigs(result, truth, distances_m=(1.0, 4.0))
    for pair in found.pairs:
        assert np.nanmax(np.abs(pair.depth_mm - 10 * pair.distance_m)) < 1e-3
        assert np.nanmax(np.abs(pair.vertical_px)) < 1e-5
    assert found.baseline_mm[0] == pytest.approx(1.01 * found.baseline_mm[1])
    assert found.turn_deg == pytest.approx(0, abs=1e-6)


def test_plates_of_another_size_and_what_cannot_be_compared() -> None:
    rig = rig_named("distorted", SIZE)
    half = replace(rig, left=rig.left.scaled((320, 180)), right=rig.right.scaled((320, 180)))
    found = compare_rigs(half, rig)
    assert spread(found.left.apart_px).largest < 1e-6
    assert "left eye was calibrated at 320x180" in found.words[0]
    assert "mirrored differs" in compare_rigs(replace(rig, mirrored="left"), rig).words[0]
    with pytest.raises(RigError, match="320x320 and 640x360: of one rig they have one shape"):
        compare_rigs(replace(rig, left=rig.left.cropped(0, 0, (320, 320))), rig)
    with pytest.raises(RigError, match="distance must be > 0"):
        compare_rigs(rig, rig, distances_m=(0.0,))


def test_what_the_right_eye_cannot_see_has_no_answer() -> None:
    rig = parallel_rig(SIZE, fov_deg=40, baseline_m=0.3)
    found = pair_difference(rig, rig, 0.5)
    share = 0.3 / 0.5 / (2 * math.tan(math.radians(20)))
    assert spread(found.depth_mm).cover_percent == pytest.approx(100 * (1 - share), abs=4)
    nothing = pair_difference(rig, rig, 0.2)
    assert spread(nothing.depth_mm).to_dict("mm")["mean_mm"] is None
