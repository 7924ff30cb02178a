"""The shadows of a shot's lights: what of the surface room stands for each light, and how its shadow joins the light's layers.

In: lights in any space, and a `ShadowScene` of the frame.  Out: by light name, (H, W) factors for `light_layers`, and what nobody can know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SphereLight, in_camera
from stereorelight.surface.emitters import Emitter, Vector
from stereorelight.surface.visibility import Method, Shadow, ShadowScene


def _vector(v: Float64) -> Vector:
    return float(v[0]), float(v[1]), float(v[2])


def emitter_of(light: Light) -> Emitter:
    """Where `light`, which is in the scene frame of the camera, shines from.  Raises ShotError."""
    if isinstance(light, DirectionalLight):
        return Emitter(name=light.name, shape="direction", towards=_vector(-light.shines_to))
    if isinstance(light, SphereLight):
        return Emitter(name=light.name, shape="ball", position_m=light.position_m, radius_m=light.radius_m)
    if isinstance(light, RectLight):
        u, v = light.sides
        return Emitter(
            name=light.name,
            shape="rectangle",
            position_m=light.position_m,
            towards=_vector(light.shines_to),
            side_u_m=_vector(u * light.size_m[0] / 2),
            side_v_m=_vector(v * light.size_m[1] / 2),
        )
    assert isinstance(light, PointLight)
    return Emitter(name=light.name, shape="place", position_m=light.position_m)


@dataclass(frozen=True, kw_only=True)
class CastShadow:
    """A light's shadow: `factor` multiplies its layers, `lit` is the shadow kept apart, `unknown` what the camera cannot know; (H, W) each."""

    factor: Float32
    lit: Float32
    unknown: Float32


def cast(light: Light, scene: ShadowScene, *, method: Method = "rays", samples: int = 16, density: float = 1.0, bias_m: float = 0.0) -> CastShadow:
    """The shadow of one light on the surface that casts it.

    density : 1 is a full shadow, 0 none.
    """
    placed = in_camera(light, scene.camera.world_from_camera)
    found: Shadow = scene.shadow(emitter_of(placed), method=method, samples=samples, bias_m=bias_m)
    lit = 1 - np.float32(density) * (1 - found.lit)
    factor = lit
    if light.wrap > 0:  # beyond the terminator the wrapped light is its own shade
        factor = np.where(_turned_away(placed, scene), np.float32(1), lit)
    return CastShadow(factor=factor, lit=lit, unknown=np.float32(density) * found.unknown)


def _turned_away(light: Light, scene: ShadowScene) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    N = scene.N
    if isinstance(light, DirectionalLight):
        away: np.ndarray[tuple[int, ...], np.dtype[np.bool_]] = N @ (-light.shines_to).astype(np.float32) <= 0
        return away
    assert isinstance(light, PointLight)
    return ((np.array(light.position_m, np.float32) - scene.P) * N).sum(axis=-1) <= 0


def cast_all(lights: Sequence[Light], scene: ShadowScene, *, method: Method = "rays", samples: int = 16) -> dict[str, CastShadow]:
    """The shadow of every light, by name."""
    return {light.name: cast(light, scene, method=method, samples=samples) for light in lights}
