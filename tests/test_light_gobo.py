"""A gobo lies where a slide would throw it; a stuck light stands on the surface under its pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError
from stereorelight.light.animate import Stuck
from stereorelight.light.gobo import gobo_factor
from stereorelight.light.lights import SpotLight, in_camera
from stereorelight.light.place import place_of, point_in_space
from stereorelight.surface.position import position_from_depth

CAMERA = Camera.from_fov(60, (96, 96))
WALL = position_from_depth(np.full((96, 96), 2.0, np.float32), CAMERA)
AT_EYE = SpotLight(name="s", position_m=(0, 0, 0), direction=(0, 0, -1), cone_deg=60, penumbra_deg=0)


def slide(h: int = 16, w: int = 16) -> np.ndarray:
    """A ramp to the right in red and one downwards in green."""
    u, v = np.meshgrid((np.arange(w) + 0.5) / w, (np.arange(h) + 0.5) / h)
    return np.stack([u, v, np.full_like(u, 0.5)], axis=-1).astype(np.float32)


def test_from_the_eye_the_slide_is_the_picture() -> None:
    """A spot at the camera whose cone is the field of view throws the slide pixel onto pixel, upright and unmirrored."""
    seen = gobo_factor(WALL, AT_EYE, slide(96, 96))
    np.testing.assert_allclose(seen, slide(96, 96), atol=1e-4)


def test_the_depth_of_the_wall_does_not_matter_from_the_eye() -> None:
    Z = np.random.default_rng(0).uniform(1, 5, (96, 96)).astype(np.float32)
    np.testing.assert_allclose(gobo_factor(position_from_depth(Z, CAMERA), AT_EYE, slide()), gobo_factor(WALL, AT_EYE, slide()), atol=1e-4)


def test_a_turn_is_clockwise_seen_from_the_spot() -> None:
    seen = gobo_factor(WALL, replace(AT_EYE, gobo_turn_deg=90), slide(96, 96))
    np.testing.assert_allclose(seen, np.rot90(slide(96, 96), -1), atol=1e-4)


def test_the_penumbra_is_covered_and_a_wide_slide_is_dark_above() -> None:
    narrow = replace(AT_EYE, cone_deg=40, penumbra_deg=10)
    np.testing.assert_allclose(gobo_factor(WALL, narrow, slide()), gobo_factor(WALL, AT_EYE, slide()), atol=1e-6)
    wide = gobo_factor(WALL, AT_EYE, np.ones((24, 48), np.float32))
    assert (wide[24:72] == 1).all()
    assert (wide[:23] == 0).all()
    assert (wide[73:] == 0).all()


def test_a_spot_in_the_world_keeps_its_slide_on_the_wall() -> None:
    """The same surface points see the same slide wherever the camera stands."""
    angle = np.radians(20)
    pose = np.array([[np.cos(angle), 0, np.sin(angle), 0.5], [0, 1, 0, 0.1], [-np.sin(angle), 0, np.cos(angle), 0.2], [0, 0, 0, 1]])
    world = WALL @ pose[:3, :3].T + pose[:3, 3]
    spot = SpotLight(name="s", position_m=(0.4, 1.2, 0), aim_m=tuple(world[48, 48]), cone_deg=50, space="world", gobo_turn_deg=15)
    there = gobo_factor(WALL, spot, slide(), camera=replace(CAMERA, world_from_camera=pose))
    here = gobo_factor(world.astype(np.float32), spot, slide())
    assert there.max() > 0.5
    np.testing.assert_allclose(there, here, atol=2e-4)
    assert in_camera(spot, pose).space == "camera"


def test_what_is_behind_or_unknown_is_dark() -> None:
    P = WALL.copy()
    P[0, 0] = np.nan
    P[1, 1] = (0, 0, 3)
    seen = gobo_factor(P, AT_EYE, np.ones((4, 4), np.float32))
    assert (seen[0, 0] == 0).all()
    assert (seen[1, 1] == 0).all()
    assert (gobo_factor(P, replace(AT_EYE, direction=(0, 1, 0)), slide()) >= 0).all()  # straight up is no trouble


def test_gobos_that_cannot_be_are_told() -> None:
    with pytest.raises(ShotError, match="narrow the cone"):
        gobo_factor(WALL, replace(AT_EYE, cone_deg=170), slide())
    with pytest.raises(PassError, match="gobo of light 's' must hold values of at least 0"):
        gobo_factor(WALL, AT_EYE, slide() - 1)
    with pytest.raises(ShotError, match="gobo must be the file of a picture"):
        replace(AT_EYE, gobo=3)  # type: ignore[arg-type]


def test_a_point_is_found_on_its_surface_at_an_edge() -> None:
    """A pixel on the near side of an edge gives the near surface, noise averaged, on its own ray."""
    rng = np.random.default_rng(0)
    Z = np.where(np.arange(96) < 50, 1.0, 3.0)[None, :] * np.ones((96, 1))
    P = position_from_depth((Z * (1 + 0.004 * rng.standard_normal(Z.shape))).astype(np.float32), CAMERA)
    P[40:42, 44:46] = np.nan
    for x, z in ((48.3, 1.0), (51.0, 3.0)):
        true = CAMERA.unproject([x, 40.6], z) * (1, -1, -1)
        np.testing.assert_allclose(point_in_space(P, (x, 40.6)), true, rtol=0.002, atol=2e-4)


def test_offsets_go_along_the_axes_of_the_lights_space() -> None:
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # panned 90 degrees to the left
    pose[:3, 3] = (1, 2, 3)
    stuck = Stuck(pixel=(47.5, 47.5), offset_m=(0, 0, 0.5))
    np.testing.assert_allclose(place_of(stuck, WALL, (47.5, 47.5), "camera", pose), (0, 0, -1.5), atol=1e-5)
    np.testing.assert_allclose(place_of(stuck, WALL, (47.5, 47.5), "world", pose), (-1, 2, 3.5), atol=1e-5)


def test_a_point_without_a_place_is_told() -> None:
    with pytest.raises(ShotError, match="has left the picture"):
        point_in_space(WALL, (200, 10))
    P = WALL.copy()
    P[:20, :20] = np.nan
    with pytest.raises(ShotError, match="nothing is known of the depth"):
        point_in_space(P, (5, 5))
