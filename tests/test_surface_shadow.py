"""Shadows of the seen surface against ray-traced truth, and against what geometry says."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.engine import raycast
from stereorelight.surface.emitters import Emitter
from stereorelight.surface.visibility import ShadowScene
from stereorelight.synth.lights import Light
from stereorelight.synth.render import FLIP, SELF_M
from stereorelight.synth.scenes import scene_named

SIZE = (480, 270)
KEY = Light(name="key", position_m=(-0.8, 0.9, 0.2))


@cache
def truth(name: str, light: Light) -> tuple[ShadowScene, np.ndarray, np.ndarray]:
    """The exact surface, which of its pixels face the light, and which of those it reaches past the whole scene."""
    camera = Camera.from_fov(40, SIZE)
    tables = scene_named(name).tables()
    ways = camera.rays(camera.pixel_grid().reshape(-1, 2)) @ FLIP
    t, hit = raycast.first_hits(tables.objects, tables.primitives, np.zeros((1, 3)), ways)
    points = t[:, None] * ways
    normals = raycast.surface_at(tables.objects, tables.primitives, tables.materials, points, hit)[0]
    starts = np.broadcast_to(light.ray_starts(points), points.shape)
    along = points - starts
    with np.errstate(invalid="ignore"):
        facing = (normals * along).sum(axis=-1) < 0
        limits = np.where(facing, 1 - SELF_M / np.linalg.norm(along, axis=-1), 0)
    lit = facing & ~raycast.blocked(tables.objects, tables.primitives, starts, along, limits)
    shape = camera.size_hw
    Z = t.reshape(shape).astype(np.float32)
    scene = ShadowScene(Z=Z, N=normals.reshape(*shape, 3).astype(np.float32), camera=camera, open=np.isnan(Z))
    return scene, facing.reshape(shape), lit.reshape(shape)


def emitter(light: Light) -> Emitter:
    if light.type == "directional":
        x, y, z = -light.shines_to
        return Emitter(name=light.name, shape="direction", towards=(x, y, z))
    return Emitter(name=light.name, shape="place", position_m=light.position_m)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


LIGHTS = {
    "sphere": KEY,
    "box": KEY,
    "bust": Light(name="side", position_m=(0.5, 0.2, -0.3)),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_exact_depth_casts_the_traced_shadow(name: str) -> None:
    scene, facing, lit = truth(name, LIGHTS[name])
    found = scene.shadow(emitter(LIGHTS[name]), method="rays")
    known = facing & (found.unknown < 0.5)
    assert known.sum() > 0.3 * facing.sum()
    assert iou(~lit[known], found.lit[known] < 0.5) >= 0.97


@pytest.mark.parametrize("name", LIGHTS)
def test_march_and_rays_agree(name: str) -> None:
    scene, facing, _ = truth(name, LIGHTS[name])
    rays, marched = (scene.shadow(emitter(LIGHTS[name]), method=method) for method in ("rays", "march"))
    assert ((rays.lit > 0.5) == (marched.lit > 0.5))[facing].mean() >= 0.99
