"""The synthetic shots: what is worked out by hand must come out of the ray caster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereorelight.camera import Camera, Eye, Rig
from stereorelight.synth.render import FLIP, Shot, render
from stereorelight.synth.rigs import RIGS, parallel_rig, rectified_rig, rig_named
from stereorelight.synth.scene import rotation
from stereorelight.synth.scenes import scene_named

SIZE = (96, 64)
METRES = 1e-6  # float32 passes hold 2.4e-7 m at 3 m
DEGREES = 0.01  # float32 unit vectors hold about 1e-5 degrees
EYES: tuple[Eye, Eye] = ("left", "right")


def shot(name: str, rig: Rig) -> Shot:
    return render(scene_named(name), rig, samples=1, lights=())


def world_rays(rig: Rig, eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) and directions (H, W, 3) in the world: the judge's own way from pixel to ray."""
    R, centre = (np.eye(3), np.zeros(3)) if eye == "left" else (rig.R_right_left.T, rig.right_centre_m)
    rays = np.einsum("ij,hwj->hwi", R, rig.camera(eye).rays(rig.camera(eye).pixel_grid()))
    return centre * (1, -1, -1), rays * (1, -1, -1)


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("rig_name", RIGS)
def test_slanted_plane_is_exact(rig_name: str, eye: Eye) -> None:
    rig = rig_named(rig_name, SIZE)
    frame = shot("slanted", rig).frame(eye)
    normal = rotation(x_deg=-15, y_deg=35)[:, 2]
    origin, rays = world_rays(rig, eye)
    t = ((np.array([0, 0, -1.5]) - origin) @ normal) / (rays @ normal)
    np.testing.assert_allclose(frame["Z"], t, atol=METRES)
    to_eye = np.eye(3) if eye == "left" else FLIP @ rig.R_right_left @ FLIP
    assert angle_deg(frame["N"].astype(float), to_eye @ normal).max() < DEGREES
    P = rig.camera(eye).unproject(rig.camera(eye).pixel_grid(), t) * (1, -1, -1)
    np.testing.assert_allclose(frame["P"], P, atol=METRES)
    assert not frame["flags"][SIZE[1] // 2, SIZE[0] // 2]


@pytest.mark.parametrize("rig_name", ["parallel", "distorted", "hard"])
def test_sphere_is_exact(rig_name: str) -> None:
    rig = rig_named(rig_name, SIZE)
    for eye in EYES:
        made = shot("sphere", rig)
        frame, ball = made.frame(eye), made.objects[eye] == made.object_names.index("ball")
        origin, rays = world_rays(rig, eye)
        centre = np.array([0, 0, -1.5])
        a, b, c = (rays**2).sum(-1), rays @ (origin - centre), ((origin - centre) ** 2).sum() - 0.25**2
        inside = b * b - a * c
        np.testing.assert_array_equal(ball, inside > 0)
        t = (-b - np.sqrt(np.where(ball, inside, 0))) / a
        np.testing.assert_allclose(frame["Z"][ball], t[ball], atol=METRES)
        N = (origin + t[..., None] * rays - centre) / 0.25
        to_eye = np.eye(3) if eye == "left" else FLIP @ rig.R_right_left @ FLIP
        assert angle_deg(frame["N"].astype(float), N @ to_eye.T)[ball].max() < DEGREES
        assert (np.einsum("hwc,hwc->hw", frame["N"], -frame["P"]) > 0).all()


def test_disparity_is_the_rigs_own() -> None:
    rig = parallel_rig(SIZE)
    shifted = Camera(size=SIZE, K=rig.right.K + np.array([[0, 0, 7.25], [0, 0, 0], [0, 0, 0]]))
    rig = replace(rig, right=shifted)
    made = shot("two_planes", rig)
    rectified = rectified_rig(rig)
    np.testing.assert_allclose(made.left["disparity"], rig.left.fx * 0.065 / made.left["Z"].astype(float) - 7.25, atol=2e-5)
    np.testing.assert_allclose(rectified.depth_from_disparity(made.left["disparity"]), made.left["Z"], rtol=1e-5)
    assert "disparity" not in shot("two_planes", rig_named("toed-in", SIZE)).left
