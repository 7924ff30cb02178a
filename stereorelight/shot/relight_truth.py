"""Does a relit plate look as it would have, had the light been there?  Light added to a recovered surface, against the exact render.

In: the passes that were found, the exact ones, and lights.  Out: what each light adds, how far that is from the truth, and how much of it
depth, normals, shadow and albedo each caused: each is put right in turn, and each is put wrong alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.camera import Camera
from stereorelight.compare.picture import BLUR_PX, light_figures
from stereorelight.errors import ShotError
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SpotLight
from stereorelight.light.materials import Material
from stereorelight.light.shade import light_layers
from stereorelight.shot.shadows import cast
from stereorelight.surface.position import position_from_depth
from stereorelight.surface.visibility import ShadowScene
from stereorelight.synth import lights as true_lights

PARTS = ("depth", "normals", "shadow", "albedo")


@dataclass(frozen=True, kw_only=True, eq=False)
class Parts:
    """What light is added to: Z (H, W) metres, N and albedo (H, W, 3), and by light name the share (H, W) of it that arrives.

    shadows : empty for none."""

    Z: Float32
    N: Float32
    albedo: Float32
    shadows: Mapping[str, Float32]

    def with_part(self, part: str, other: Parts) -> Parts:
        """The same with one of `PARTS` taken from `other`."""
        names = {"depth": "Z", "normals": "N", "shadow": "shadows", "albedo": "albedo"}
        if part not in names:
            raise ShotError(f"part {part!r} is unknown; there are {', '.join(PARTS)}")
        return replace(self, **{names[part]: getattr(other, names[part])})


@dataclass(frozen=True, kw_only=True)
class ErrorSplit:
    """Relative RMS of light alone, per cent.

    found, exact : of everything as found, and of everything exact (what sampling at pixel centres leaves).
    mended       : with one part exact and the rest as found, by part.   alone : with one part as found and the rest exact.
    """

    found: float
    exact: float
    mended: Mapping[str, float]
    alone: Mapping[str, float]

    def to_dict(self) -> dict[str, object]:
        return {"found": self.found, "exact": self.exact, "mended": dict(self.mended), "alone": dict(self.alone)}


def true_light(light: Light) -> true_lights.Light:
    """One of our lights as the renderer takes it, for truth.  Raises ShotError for one that it cannot render."""
    same = {"name": light.name, "intensity": light.strength, "color": light.tint}

    def vector(v: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float, float]:
        return float(v[0]), float(v[1]), float(v[2])

    if isinstance(light, DirectionalLight):
        return true_lights.Light(type="directional", direction=vector(light.shines_to), **same)  # type: ignore[arg-type]
    if isinstance(light, RectLight):
        u, v = light.sides
        return true_lights.Light(
            type="area",
            position_m=light.position_m,
            direction=vector(light.shines_to),
            side_u_m=vector(u * light.size_m[0] / 2),
            side_v_m=vector(v * light.size_m[1] / 2),
            **same,  # type: ignore[arg-type]
        )
    if isinstance(light, SpotLight):
        return true_lights.Light(
            type="spot",
            position_m=light.position_m,
            direction=vector(light.shines_to),
            cone_deg=light.cone_deg,
            penumbra_deg=light.penumbra_deg,
            **same,  # type: ignore[arg-type]
        )
    if isinstance(light, PointLight) and light.attenuation == "inverse_square":
        return true_lights.Light(type="point", position_m=light.position_m, **same)  # type: ignore[arg-type]
    raise ShotError(f"light {light.name!r}: a {light.kind} light as it is set has no exact render; take a point, directional, spot or rect light")


def cast_shares(
    lights: Sequence[Light], Z: Float32, N: Float32, camera: Camera, *, Z_sigma: Float32 | None = None, samples: int = 16
) -> dict[str, Float32]:
    """The share (H, W) of each light that arrives at a surface, by its own shadows."""
    scene = ShadowScene(Z=Z, N=N, camera=camera, Z_sigma=Z_sigma)
    return {light.name: cast(light, scene, samples=samples).factor for light in lights}


def added_light(
    parts: Parts,
    camera: Camera,
    lights: Sequence[Light],
    *,
    materials: Sequence[Material] = (),
    mattes: Mapping[str, Float32] | None = None,
) -> dict[str, Float32]:
    """What each light adds, (H, W, 3), by its name: diffuse and specular together."""
    P = position_from_depth(parts.Z, camera)
    layers = light_layers(P, parts.N, parts.albedo, lights, mattes=mattes, materials=materials, camera=camera, shadows=parts.shadows or None)
    out: dict[str, Float32] = {}
    for light in lights:
        diffuse, specular = (layers.get(f"light_{light.name}_{kind}") for kind in ("diffuse", "specular"))
        if diffuse is not None:
            out[light.name] = diffuse if specular is None else diffuse + specular
    return out


def error_split(
    found: Parts,
    exact: Parts,
    truth: Float32,
    light: Light,
    camera: Camera,
    *,
    region: Bool,
    materials: Sequence[Material] = (),
    mattes: Mapping[str, Float32] | None = None,
    blur_px: float = BLUR_PX,
) -> ErrorSplit:
    """What of one light's error comes from where.

    truth  : (H, W, 3) what the light adds, exactly, with its shadow where `exact` holds one.
    region : (H, W) bool, where to look.
    """

    def error(parts: Parts) -> float:
        added = added_light(parts, camera, [light], materials=materials, mattes=mattes)[light.name]
        return light_figures(added, truth, region=region, blur_px=blur_px).relative_rms_percent

    parts = [part for part in PARTS if part != "shadow" or exact.shadows]
    return ErrorSplit(
        found=error(found),
        exact=error(exact),
        mended={part: error(found.with_part(part, exact)) for part in parts},
        alone={part: error(exact.with_part(part, found)) for part in parts},
    )
