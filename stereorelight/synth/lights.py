"""Known lights of the synthetic plates, in plain float64: the truth that a relit picture is held against.

In: points, normals and albedo in world coordinates (scene frame of the left camera, y up), metres.  Out: linear RGB.
Units: intensity 1 makes a white card that faces the light at 1 m read exactly 1.0; inverse square.  A directional light
has no distance: intensity 1 makes a facing card read 1.0 anywhere.  An area light shines from the front of a rectangle as paper would,
such that a card on its axis reads, from afar, what it would of a point light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError, nearest_hint

Vector = tuple[float, float, float]
TYPES = ("point", "directional", "spot", "area")
GOLDEN = (0.7548776662466927, 0.5698402909980532)  # steps that spread any number of points evenly over a square (Roberts 2018)
FAR_M = 50.0  # where the rays towards a directional light start; beyond every scene here


@dataclass(frozen=True, kw_only=True)
class Light:
    """One light.

    position_m   : where a point or spot light stands.
    direction    : where a directional or spot light shines *to*; any length but zero.
    cone_deg     : full angle of a spot's cone, inside which it shines at full strength ...
    penumbra_deg : ... and the further angle on each side over which it falls smoothly to nothing.
    side_u_m, side_v_m : of an area light: half of its width and of its height, as vectors at right angles to `direction`.
    """

    name: str
    type: Literal["point", "directional", "spot", "area"] = "point"
    position_m: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (0.0, 0.0, -1.0)
    cone_deg: float = 40.0
    penumbra_deg: float = 5.0
    color: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    side_u_m: Vector = (0.0, 0.0, 0.0)
    side_v_m: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.type not in TYPES:
            raise ShotError(f"light {self.name!r}: type {self.type!r} is unknown{nearest_hint(str(self.type), TYPES)}")
        if not math.hypot(*self.direction) > 0:
            raise ShotError(f"light {self.name!r}: direction must not be zero")
        if not self.name.replace("_", "").isalnum() or not self.name.isascii():
            raise ShotError(f"light {self.name!r}: a name is letters, digits and _ only; it names layers")
        if not 0 < self.cone_deg < 180 or not 0 <= self.penumbra_deg < 90:
            raise ShotError(f"light {self.name!r}: cone_deg must lie in 0..180 and penumbra_deg in 0..90")

    @property
    def shines_to(self) -> Float64:
        """(3,) unit vector along `direction`."""
        unit: Float64 = np.array(self.direction) / math.hypot(*self.direction)
        return unit

    def places(self, count: int, *, turn: int = 0) -> tuple[Vector, ...]:
        """Where it shines from: `count` places spread evenly over an area light, others for every `turn`; one place for the rest."""
        if self.type != "area":
            return (self.position_m,)
        square = (0.5 + np.arange(1 + turn * count, 1 + (turn + 1) * count)[:, None] * np.array(GOLDEN)) % 1.0 * 2 - 1
        spread = np.array(self.position_m) + square[:, :1] * np.array(self.side_u_m) + square[:, 1:] * np.array(self.side_v_m)
        return tuple((float(x), float(y), float(z)) for x, y, z in spread)

    def at(self, place: Vector) -> Light:
        """The same light as if it all came from one of its places."""
        return replace(self, position_m=place)

    def ray_starts(self, points: Float64) -> Float64:
        """Where shadow rays to `points` (n, 3) start: (1, 3) for one place, (n, 3) for a directional light."""
        if self.type == "directional":
            start: Float64 = points - FAR_M * self.shines_to
            return start
        return np.array([self.position_m], dtype=np.float64)


def incoming(light: Light, points: Float64) -> tuple[Float64, Float64]:
    """(L, E): unit vectors (n, 3) towards the light, and the linear RGB (n, 3) that a white card facing it would read."""
    color = np.array(light.color) * light.intensity
    if light.type == "directional":
        return np.broadcast_to(-light.shines_to, points.shape), np.broadcast_to(color, points.shape)
    towards = np.array(light.position_m) - points
    distance = np.linalg.norm(towards, axis=-1, keepdims=True)
    towards = towards / distance
    strength = 1.0 / distance**2
    if light.type == "spot":
        off_axis = np.degrees(np.arccos(np.clip(-(towards @ light.shines_to), -1.0, 1.0)))[..., None]
        edge = light.cone_deg / 2
        s = np.clip((edge + light.penumbra_deg - off_axis) / max(light.penumbra_deg, 1e-9), 0.0, 1.0)
        strength = strength * s * s * (3 - 2 * s)
    elif light.type == "area":  # all of it from its middle; `places` spreads it
        strength = strength * np.maximum(-(towards @ light.shines_to), 0.0)[..., None]
    return towards, strength * color


def shade(light: Light, points: Float64, normals: Float64, views: Float64, albedo: Float64, specular: Float64) -> tuple[Float64, Float64]:
    """(diffuse, specular) RGB (n, 3) of one light without its shadow: Lambert, and Phong where `specular` has strength.

    views    : unit vectors (n, 3) towards the eye.
    specular : (n, 2) strength and exponent.
    """
    L, E = incoming(light, points)
    cosine = np.einsum("nc,nc->n", normals, L)
    lit = np.maximum(cosine, 0.0)[:, None]
    diffuse: Float64 = albedo * lit * E
    mirrored = 2 * cosine[:, None] * normals - L
    lobe = np.maximum(np.einsum("nc,nc->n", mirrored, views), 0.0) ** specular[:, 1]
    shine: Float64 = np.where(cosine > 0, specular[:, 0] * lobe, 0.0)[:, None] * E
    return diffuse, shine
