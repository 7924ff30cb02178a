"""The settings of light that comes from all around, as the `[environment]` table of a shot file holds them.

Degrees, metres, stops; colours linear.  Refused when made where they could not be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.base import NAME, SPACES, STRONGEST
from stereorelight.light.checks import Checked, Vector, is_number
from stereorelight.light.environment_maps import KINDS, MapKind


@dataclass(frozen=True, kw_only=True)
class EnvironmentSettings(Checked):
    """What the environment does to a shot.

    file         : the map; None where Python code brings it.
    kind         : "latlong", "angular" (light probe) or "mirror_ball" (photograph of a chrome ball).
    circle_px    : of a ball or probe in its picture: centre x, y, radius, pixels; None is the inscribed circle.
    find_circle  : look for the ball in the picture instead.
    ball_angle_deg : full angle under which the camera saw the ball; 0 is from far away.
    bad_values   : "refuse" maps that hold NaN, infinity or much negative light, or "clamp" them.
    rotation_deg : yaw, pitch, roll of the map.  Yaw takes what lies ahead (-z) to the right (+x), pitch takes it up, roll tips what is
                   above to the right; roll first, then pitch, then yaw.
    space        : "world": it stays put while the camera moves; "camera": it goes with the camera.
    exposure     : stops.   tint : of everything, linear.
    diffuse      : strength of albedo * irradiance along N; 0 leaves the layer out.
    diffuse_method : "exact" convolution, or "harmonics" of second order: smoother, and under hard light a few per cent off.
    reflection, refraction : their strengths; 0 leaves the layer out.
    reflection_tint, refraction_tint : linear.
    fresnel      : True mixes both by the exact dielectric formula; False gives each its whole strength.
    ior          : of the material against air, 0.1 ... 10; glass 1.5.
    roughness    : 0 mirror ... 1 of GGX, alpha = roughness^2.
    backdrop     : what refraction shows: "environment", or the "plate" behind the surface.
    thickness_m  : with the plate: how far the refracted ray goes on before it meets what the plate shows.
    matte        : name of the matte that holds it, or None.
    occlusion    : whether the surface keeps light from itself: diffuse along bent normals times ambient occlusion, reflection by what of it is open.
    enabled      : False leaves every layer out.
    """

    what = "environment"

    file: str | None = None
    kind: MapKind = "latlong"
    circle_px: Vector | None = None
    find_circle: bool = False
    ball_angle_deg: float = 0.0
    bad_values: Literal["refuse", "clamp"] = "refuse"
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    space: Literal["camera", "world"] = "world"
    exposure: float = 0.0
    tint: Vector = (1.0, 1.0, 1.0)
    diffuse: float = 1.0
    diffuse_method: Literal["exact", "harmonics"] = "exact"
    reflection: float = 0.0
    reflection_tint: Vector = (1.0, 1.0, 1.0)
    refraction: float = 0.0
    refraction_tint: Vector = (1.0, 1.0, 1.0)
    fresnel: bool = True
    ior: float = 1.5
    roughness: float = 0.0
    backdrop: Literal["environment", "plate"] = "environment"
    thickness_m: float = 0.1
    matte: str | None = None
    occlusion: bool = False
    enabled: bool = True

    def __post_init__(self) -> None:
        if self.file is not None and (not isinstance(self.file, str) or not self.file):
            raise self._error("file", "must be the name of a picture", repr(self.file))
        self._word("kind", KINDS)
        self._flag("find_circle")
        if self.circle_px is not None:
            self._vector("circle_px", remedy="it is [x, y, radius] in pixels")
        if self.kind == "latlong" and (self.circle_px is not None or self.find_circle):
            raise self._error("circle_px and find_circle", "belong to balls and probes", "kind 'latlong'", "change kind, or remove them")
        if self.circle_px is not None and self.find_circle:
            raise self._error("find_circle", "must be false where circle_px is given", "both", "remove one of them")
        self._number("ball_angle_deg", low=0, high=169, remedy="2 asin(radius / distance) of the ball")
        self._word("bad_values", ("refuse", "clamp"))
        self._vector("rotation_deg", low=-3600, high=3600, remedy="it is [yaw, pitch, roll] in degrees")
        self._word("space", SPACES)
        self._number("exposure", low=-64, high=64)
        if 2.0**self.exposure > STRONGEST:
            raise self._error("exposure", f"must stay below {math.log2(STRONGEST):.0f} stops", f"{self.exposure:g}")
        for key in ("tint", "reflection_tint", "refraction_tint"):
            self._vector(key, low=0)
        for key in ("diffuse", "reflection", "refraction"):
            self._number(key, low=0, high=1e6)
        self._word("diffuse_method", ("exact", "harmonics"))
        self._flag("fresnel")
        self._number("ior", low=0.1, high=10, remedy="water 1.33, glass 1.5, diamond 2.42")
        self._number("roughness", low=0, high=1, remedy="0 is a mirror")
        self._word("backdrop", ("environment", "plate"))
        self._number("thickness_m", low=0, high=1e3)
        if self.matte is not None and (not isinstance(self.matte, str) or not NAME.fullmatch(self.matte)):
            raise self._error("matte", "must be the name of a matte", repr(self.matte), "leave it out for no matte")
        self._flag("occlusion")
        self._flag("enabled")

    def _error(self, key: str, wanted: str, came: str, remedy: str = "") -> ShotError:
        return ShotError(f"environment: {key} {wanted}, got {came}" + (f"; {remedy}" if remedy else ""))

    def _word(self, key: str, known: Sequence[str]) -> None:
        if getattr(self, key) not in known:
            raise ShotError(f"environment: {key} {getattr(self, key)!r} is unknown{nearest_hint(str(getattr(self, key)), known)}")

    @property
    def strength(self) -> Float64:
        """(3,) tint * 2^exposure."""
        return np.array(self.tint) * 2.0**self.exposure

    @property
    def needs_map(self) -> bool:
        """Whether any layer looks at the map."""
        return self.enabled and (self.diffuse > 0 or self.reflection > 0 or (self.refraction > 0 and self.backdrop == "environment"))


def environment_from_dict(table: Mapping[str, Any]) -> EnvironmentSettings:
    """The settings of a file's `[environment]` table.  Raises ShotError with the nearest known key."""
    if not isinstance(table, Mapping):
        raise ShotError(f"environment must be a table of keys, got {table!r}; begin it with [environment]")
    known = [f.name for f in fields(EnvironmentSettings)]
    for key in table:
        if key not in known:
            raise ShotError(f"environment: key {key!r} is unknown{nearest_hint(str(key), known)}")
    return EnvironmentSettings(**table)


def turn(rotation_deg: Sequence[float]) -> Float64:
    """(3, 3) R, direction in the world = R times direction in the map."""
    if len(rotation_deg) != 3 or not all(is_number(v) and math.isfinite(v) for v in rotation_deg):
        raise ShotError(f"rotation_deg must be [yaw, pitch, roll] in degrees, got {rotation_deg!r}")
    yaw, pitch, roll = (math.radians(v) for v in rotation_deg)
    cy, sy, cp, sp, cr, sr = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    by_yaw = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    by_pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    by_roll = np.array([[cr, sr, 0], [-sr, cr, 0], [0, 0, 1]])
    found: Float64 = by_yaw @ by_pitch @ by_roll
    return found
