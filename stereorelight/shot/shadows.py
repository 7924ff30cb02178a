"""The shadows of a frame: what of the surface room stands for each light, and how its shadow joins the light's layers.

In: a frame's passes and camera, [shadows] and [occlusion], and lights.  Out: by light, the factor of its layers, and the shadow kept apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64
from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SphereLight, SpotLight, in_camera
from stereorelight.passes import Flag
from stereorelight.shot.setup import OcclusionTable, ShadowsTable
from stereorelight.surface.closing import thickness_of_matte
from stereorelight.surface.emitters import Emitter, Vector
from stereorelight.surface.occlusion import Occlusion, ambient_occlusion
from stereorelight.surface.visibility import Method, ShadowScene

MM = 1e-3


def _vector(v: Float64) -> Vector:
    return float(v[0]), float(v[1]), float(v[2])


def emitter_of(light: Light) -> Emitter:
    """Where `light`, which is in the scene frame of the camera, shines from.  Raises ShotError."""
    if isinstance(light, DirectionalLight):
        return Emitter(name=light.name, shape="direction", towards=_vector(-light.shines_to), angle_deg=light.shadow_angle_deg)
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
    if isinstance(light, PointLight):
        shape = "ball" if light.shadow_radius_m > 0 else "place"
        return Emitter(name=light.name, shape=shape, position_m=light.position_m, radius_m=light.shadow_radius_m)  # type: ignore[arg-type]
    raise ShotError(f'light {light.name!r}: a light of type {type(light).__name__} casts no shadow; set shadow = "off"')


@dataclass(frozen=True, kw_only=True)
class CastShadow:
    """A light's shadow, (H, W) each.

    factor : of its layers.   lit : the shadow kept apart, 1 where all of it arrives.   unknown : what of `lit` the camera cannot know.
    """

    factor: Float32
    lit: Float32
    unknown: Float32


def cast(
    light: Light, scene: ShadowScene, *, method: Method | None = None, samples: int | None = None, matte: npt.ArrayLike | None = None
) -> CastShadow:
    """The shadow of `light` on the surface, by the light's own keys.

    method, samples : instead of the light's own; a light whose shadow is off is cast by rays.
    matte : (H, W) of the light; no rays are sent where it is 0.
    """
    placed = in_camera(light, scene.camera.world_from_camera)
    how: Method = method or ("march" if light.shadow == "march" else "rays")
    asked = _asked(placed, scene, matte)
    found = scene.shadow(emitter_of(placed), method=how, samples=samples or light.shadow_samples, bias_m=light.shadow_bias_m, asked=asked)
    lit = found.lit if asked is None else np.where(asked > 0, found.lit, np.float32(1))
    lit = 1 - np.float32(light.shadow_density) * (1 - lit)
    # Beyond the terminator, wrapped light has no shadow but its own falling off.
    factor = np.where(_turned_away(placed, scene), np.float32(1), lit) if light.wrap > 0 else lit
    return CastShadow(factor=factor, lit=lit, unknown=np.float32(light.shadow_density) * found.unknown)


def _asked(light: Light, scene: ShadowScene, matte: npt.ArrayLike | None) -> Float32 | None:
    """(H, W) 1 where the light reaches at all, or None for everywhere."""
    where = None if matte is None else np.nan_to_num(np.asarray(matte, dtype=np.float32)) > 0
    if isinstance(light, SpotLight):
        towards = scene.P - np.array(light.position_m, np.float32)
        along = towards @ light.shines_to.astype(np.float32)
        edge = np.radians(light.cone_deg / 2 + light.penumbra_deg) + 1e-3
        inside = along >= np.cos(min(edge, np.pi)) * np.linalg.norm(towards, axis=-1)
        where = inside if where is None else where & inside
    return None if where is None else where.astype(np.float32)


def _turned_away(light: Light, scene: ShadowScene) -> npt.NDArray[np.bool_]:
    towards: Any = -light.shines_to if isinstance(light, DirectionalLight) else np.array(getattr(light, "position_m", (0, 0, 0))) - scene.P
    away: npt.NDArray[np.bool_] = (np.asarray(towards, np.float32) * scene.N).sum(axis=-1) <= 0
    return away


@dataclass(kw_only=True, eq=False)
class Casting:
    """A frame's surface, as it casts shadows; it is put together when the first light asks.

    passes : P, N; Z, Z_sigma and flags as far as there are any.     mattes : by name, for [shadows] matte.
    """

    shadows: ShadowsTable
    passes: Mapping[str, npt.NDArray[Any]]
    camera: Camera | None
    mattes: Mapping[str, Float32]

    @cached_property
    def scene(self) -> ShadowScene:
        """Raises PassError, ShotError."""
        P, N, camera = self.passes["P"], self.passes["N"], self.camera
        if camera is None:
            raise PassError('shadows need the camera that saw the passes; make them with `stereorelight passes --rig`, or set shadow = "off"')
        Z = self.passes["Z"] if "Z" in self.passes else -P[..., 2]
        flags = self.passes.get("flags")
        nothing = np.zeros(Z.shape, bool) if flags is None else (flags & Flag.TOO_FAR) != 0
        if self.shadows.outside == "open":
            nothing = ~np.isfinite(Z)
        return ShadowScene(
            Z=Z,
            N=N,
            camera=camera,
            Z_sigma=self.passes.get("Z_sigma"),
            thickness_m=self._thickness(Z, camera),
            open=nothing,
            outside_open=self.shadows.outside == "open",
        )

    def _thickness(self, Z: Float32, camera: Camera) -> float | Float32:
        told = self.shadows
        if isinstance(told.thickness, (int, float)):
            return float(told.thickness) * MM
        if told.thickness == "thin":
            return 0.0
        if told.matte is None:
            raise ShotError('[shadows] thickness = "matte" needs the subject\'s matte; add matte = "NAME"')
        if told.matte not in self.mattes:
            raise ShotError(f"[shadows] matte {told.matte!r} is missing{nearest_hint(told.matte, self.mattes) or '; there are none'}")
        return thickness_of_matte(Z, self.mattes[told.matte], camera)

    def cast(self, light: Light) -> CastShadow:
        return cast(light, self.scene, matte=None if light.matte is None else self.mattes[light.matte])

    def occlusion(self, table: OcclusionTable | None) -> Occlusion:
        """Ambient occlusion and bent normals by [occlusion], or by its defaults."""
        told = table or OcclusionTable()
        return ambient_occlusion(self.scene, radius_m=told.radius_m, falloff=told.falloff, samples=told.samples)


def shadow_layers(names: Sequence[str], thrown: Mapping[str, CastShadow], size_hw: tuple[int, int]) -> dict[str, Float32]:
    """`shadow_<name>` and `shadow_<name>_unknown` of every light that casts one on any frame; one that is off on this frame leaves all light."""
    layers: dict[str, Float32] = {}
    for name in names:
        shadow = thrown.get(name)
        layers[f"shadow_{name}"] = np.ones(size_hw, np.float32) if shadow is None else shadow.lit
        layers[f"shadow_{name}_unknown"] = np.zeros(size_hw, np.float32) if shadow is None else shadow.unknown
    return layers
