"""Lights as values: point, directional, spot, ball and rectangle, each refused when made where it could not exist.

Units: intensity 1 makes a white card that faces the light at 1 m read exactly 1.0 (linear); a directional light has no
distance, and its facing card reads 1.0 anywhere.  A light with a size has a radiance such that radiance times its area as seen
head on is pi times its strength: on its axis and from afar it reads as the point light does, whatever its size.  Metres, degrees; colours are linear.
Frames: `space = "camera"` is the scene frame of the camera (x right, y up, the camera looks down -z), `"world"` the frame
that `Camera.world_from_camera` leads to.  Source: the paper's section 5, equations 6-11; errata in docs/paper.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.base import FARTHEST_M, Vector
from stereorelight.light.base import LIGHTS as LIGHTS
from stereorelight.light.base import Light as Light

Attenuation = Literal["inverse_square", "linear", "none", "radius"]
ATTENUATIONS = ("inverse_square", "linear", "none", "radius")


@dataclass(frozen=True, kw_only=True)
class PointLight(Light):
    """A light that shines from one place (equation 6).

    position_m  : where it is, metres.
    attenuation : "inverse_square" 1 / d^2, "linear" 1 / d, "none" 1, or "radius": inverse square times
                  (1 - (d / radius_m)^4)^2, which ends smoothly and exactly at radius_m.  d in metres; nearer than
                  1 cm counts as 1 cm, so that a light on the surface stays finite.
    radius_m    : only with attenuation "radius".
    shadow_radius_m : of the ball that its shadow is cast from, for soft edges; its light stays that of a point.
    """

    kind: ClassVar[str] = "point"

    position_m: Vector
    attenuation: Attenuation = "inverse_square"
    radius_m: float | None = None
    shadow_radius_m: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._place("position_m")
        self._word("attenuation", ATTENUATIONS)
        self._number("shadow_radius_m", low=0, high=FARTHEST_M)
        if self.attenuation == "radius":
            self._number("radius_m", low=0.02, high=FARTHEST_M, remedy="the distance in metres at which the light ends")
        elif self.radius_m is not None:
            raise self._error("radius_m", "belongs to attenuation 'radius'", f"attenuation {self.attenuation!r}", "change one or remove the other")


@dataclass(frozen=True, kw_only=True)
class SpotLight(PointLight):
    """A point light behind a cone (equation 10).

    aim_m or direction : the point that it looks at, or the way that its light travels; exactly one of them.
    cone_deg           : full angle of the cone inside which it shines at full strength, in (0, 180].
    penumbra_deg       : the further angle on each side over which it falls to nothing, the paper's cone delta;
                         a smoothstep of the angle off the axis.  0 is a hard edge.
    gobo, gobo_turn_deg: file of a picture thrown through the cone, and how far it is turned (light/gobo.py); layers are
                         multiplied by it where they are put together, in the shot.
    """

    kind: ClassVar[str] = "spot"

    cone_deg: float = 40.0
    penumbra_deg: float = 5.0
    aim_m: Vector | None = None
    direction: Vector | None = None
    gobo: str | None = None
    gobo_turn_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._number("gobo_turn_deg", low=-360, high=360)
        if self.gobo is not None and (not isinstance(self.gobo, str) or not self.gobo):
            raise self._error("gobo", "must be the file of a picture", repr(self.gobo))
        self._number("cone_deg", low=0.01, high=180, remedy="it is the full angle of the cone in degrees")
        self._number("penumbra_deg", low=0, high=90)
        if (self.aim_m is None) == (self.direction is None):
            came = "neither" if self.aim_m is None else "both"
            raise self._error("aim_m or direction", "must be given, one of them", came, "aim_m = [x, y, z] is the point that it looks at")
        if self.direction is not None:
            self._direction("direction")
        else:
            self._place("aim_m")
            if math.dist(self.aim_m or (0, 0, 0), self.position_m) < 1e-6:
                raise self._error("aim_m", "must not be where the light is", f"{list(self.position_m)} for both", "move one of them")

    @property
    def shines_to(self) -> Float64:
        """(3,) unit vector along which the light travels."""
        way = np.array(self.direction) if self.direction is not None else np.array(self.aim_m) - self.position_m
        unit: Float64 = way / np.linalg.norm(way)
        return unit


@dataclass(frozen=True, kw_only=True)
class DirectionalLight(Light):
    """A light so far away that only its direction counts (equations 7-9).

    azimuth_deg, elevation_deg : where the light comes from; azimuth to the right (+x), elevation up (+y).  0 and 0 is a
                                 light at the camera that shines into the scene.
    aim                        : instead of them, the way that the light travels.
    shadow_angle_deg           : full angle under which it is seen, for soft edges of its shadow; the sun's is 0.53.
    """

    kind: ClassVar[str] = "directional"

    azimuth_deg: float | None = None
    elevation_deg: float | None = None
    aim: Vector | None = None
    shadow_angle_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._number("shadow_angle_deg", low=0, high=170)
        for key, reach in (("azimuth_deg", 360.0), ("elevation_deg", 90.0)):
            if getattr(self, key) is not None:
                if self.aim is not None:
                    raise self._error("aim", f"must stand alone, without {key}", "both", "remove one of them")
                self._number(key, low=-reach, high=reach)
        if self.aim is not None:
            self._direction("aim")

    @property
    def shines_to(self) -> Float64:
        """(3,) unit vector along which the light travels: against equations 7-9, L = (sin t cos p, sin p, cos p cos t)."""
        if self.aim is not None:
            unit: Float64 = np.array(self.aim) / np.linalg.norm(self.aim)
            return unit
        t, p = math.radians(self.azimuth_deg or 0.0), math.radians(self.elevation_deg or 0.0)
        return -np.array([math.sin(t) * math.cos(p), math.sin(p), math.cos(p) * math.cos(t)])


@dataclass(frozen=True, kw_only=True)
class SphereLight(Light):
    """A ball that shines alike on all sides; inverse square, softened by its size.

    position_m : of its centre.     radius_m : > 0.  A surface inside the ball is lit as one that touches it.
    Until the horizon of the surface cuts into the ball, its diffuse light is exactly that of a point light at its centre.
    """

    kind: ClassVar[str] = "sphere"

    position_m: Vector
    radius_m: float

    def __post_init__(self) -> None:
        super().__post_init__()
        self._place("position_m")
        self._number("radius_m", low=1e-4, high=FARTHEST_M)
        _refuse_wrap(self)


@dataclass(frozen=True, kw_only=True)
class RectLight(Light):
    """A flat rectangle that shines from its front alone, as paper would (by the cosine of the angle off its axis).

    position_m         : of its centre.     size_m : (width, height), metres, along the sides that `up` makes level and upright.
    aim_m or direction : the point that it looks at, or the way that its light travels; exactly one of them.
    up, roll_deg       : what its height points to, as far as its aim allows; turned clockwise as seen from behind it.
    """

    kind: ClassVar[str] = "rect"

    position_m: Vector
    size_m: tuple[float, float]
    aim_m: Vector | None = None
    direction: Vector | None = None
    up: Vector = (0.0, 1.0, 0.0)
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._place("position_m")
        try:
            if isinstance(self.size_m, (str, Mapping)) or any(isinstance(v, (bool, str)) for v in self.size_m):
                raise TypeError
            w, h = (float(v) for v in self.size_m)
        except (TypeError, ValueError):
            raise self._error("size_m", "must be two numbers, [width, height]", repr(self.size_m)) from None
        if not all(1e-4 <= v <= FARTHEST_M for v in (w, h)):
            raise self._error("size_m", f"must be two numbers in 0.0001 ... {FARTHEST_M:g}", f"[{w:g}, {h:g}]")
        object.__setattr__(self, "size_m", (w, h))
        if (self.aim_m is None) == (self.direction is None):
            came = "neither" if self.aim_m is None else "both"
            raise self._error("aim_m or direction", "must be given, one of them", came, "aim_m is a point to look at")
        if self.direction is not None:
            self._direction("direction")
        else:
            self._place("aim_m")
            if math.dist(self.aim_m or (0, 0, 0), self.position_m) < 1e-6:
                raise self._error("aim_m", "must not be where the light is", f"{list(self.position_m)} for both", "move one of them")
        self._direction("up")
        self._number("roll_deg", low=-3600, high=3600)
        _refuse_wrap(self)

    @property
    def shines_to(self) -> Float64:
        """(3,) unit vector along which the light travels."""
        way = np.array(self.direction) if self.direction is not None else np.array(self.aim_m) - self.position_m
        unit: Float64 = way / np.linalg.norm(way)
        return unit

    @property
    def sides(self) -> tuple[Float64, Float64]:
        """Unit vectors along its width and its height."""
        forward, up = self.shines_to, np.array(self.up) / np.linalg.norm(self.up)
        if abs(forward @ up) > 0.9999:  # straight up or down: any upright will do, so long as it is always the same
            up = np.array([0.0, 0.0, -1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        turn = math.radians(self.roll_deg)
        return math.cos(turn) * right - math.sin(turn) * up, math.cos(turn) * up + math.sin(turn) * right


def _refuse_wrap(light: Light) -> None:
    if light.wrap:
        raise ShotError(f"light {light.name!r}: wrap belongs to lights without a size, got {light.wrap:g}; make this one larger instead")


def lights_from_dicts(tables: Sequence[Mapping[str, Any]]) -> tuple[Light, ...]:
    """The lights of a file's `[[lights]]` tables, in order: keys as in the classes, and `type`, one of LIGHTS.

    Raises : ShotError for a table that is no light, with the nearest known key or word; and for two lights of one name.
    """
    lights: list[Light] = []
    for index, table in enumerate(tables):
        light = _light_from_dict(table, index)
        if any(light.name == other.name for other in lights):
            raise ShotError(f"light {light.name!r}: name is taken by an earlier light; names must differ, since they name the layers")
        lights.append(light)
    return tuple(lights)


# What one kind of light calls by another name than its sisters do.
ANOTHER_NAME = {("directional", "direction"): "aim", ("spot", "aim"): "direction", ("rect", "aim"): "direction"}


def _light_from_dict(table: Mapping[str, Any], index: int) -> Light:
    if not isinstance(table, Mapping):
        raise ShotError(f"light number {index + 1} must be a table of keys, got {table!r}; begin each light with [[lights]]")
    label = f"light {table['name']!r}" if "name" in table else f"light number {index + 1}"
    if "type" not in table:
        raise ShotError(f'{label}: type is missing; add type = "point", "directional", "spot", "sphere" or "rect"')
    cls = LIGHTS.get(table["type"]) if isinstance(table["type"], str) else None
    if cls is None:
        raise ShotError(f"{label}: type {table['type']!r} is unknown{nearest_hint(str(table['type']), LIGHTS)}")
    known = {f.name: f for f in fields(cls)}
    for key in table:
        if key not in known and key != "type":
            own = ANOTHER_NAME.get((cls.kind, key))
            if own:
                raise ShotError(f"{label}: {key} of a {cls.kind} light is called {own}; rename it")
            homes = [kind for kind, other in LIGHTS.items() if key in {f.name for f in fields(other)}]
            if homes:
                raise ShotError(f"{label}: {key} belongs to {' and '.join(homes)} lights, not to a {cls.kind} one; remove it, or change type")
            raise ShotError(f"{label}: key {key!r} is unknown{nearest_hint(key, [*known, 'type'])}")
    for key, f in known.items():
        if f.default is MISSING and key not in table:
            example = {"name": '"key"', "radius_m": "0.2", "size_m": "[width, height]"}.get(key, "[x, y, z]")
            raise ShotError(f"{label}: {key} is missing; add {key} = {example}")
    return cls(**{key: value for key, value in table.items() if key != "type"})


def to_dict(light: Light) -> dict[str, Any]:
    """`light` as a table for `lights_from_dicts`: its type, its name, and everything that is not the default."""
    table: dict[str, Any] = {"type": light.kind, "name": light.name}
    for f in fields(light):
        value = getattr(light, f.name)
        if f.name != "name" and value != f.default:
            table[f.name] = list(value) if isinstance(value, tuple) else value
    return table


def in_camera(light: Light, world_from_camera: npt.ArrayLike) -> Light:
    """`light` in the scene frame of the camera that stands at `world_from_camera`; a light in camera space stays as it is.

    world_from_camera : (4, 4) rigid pose, scene-frame camera to world, metres (`Camera.world_from_camera`).
    Raises            : ShotError where the pose is not rigid.
    """
    if light.space == "camera":
        return light
    pose = np.asarray(world_from_camera, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-4:
        raise ShotError(f"light {light.name!r}: world_from_camera must be a 4x4 rotation and translation without scale; use Camera.world_from_camera")
    R, t = pose[:3, :3].T, pose[:3, 3]

    def vector(v: npt.ArrayLike) -> Vector:
        x, y, z = R @ np.asarray(v, dtype=np.float64)
        return float(x), float(y), float(z)

    if isinstance(light, SpotLight):
        return replace(light, space="camera", position_m=vector(light.position_m - t), aim_m=None, direction=vector(light.shines_to))
    if isinstance(light, RectLight):
        aim, up = vector(light.shines_to), vector(light.sides[1])
        return replace(light, space="camera", position_m=vector(light.position_m - t), aim_m=None, direction=aim, up=up, roll_deg=0.0)
    if isinstance(light, (PointLight, SphereLight)):
        return replace(light, space="camera", position_m=vector(light.position_m - t))
    if isinstance(light, DirectionalLight):
        return replace(light, space="camera", azimuth_deg=None, elevation_deg=None, aim=vector(light.shines_to))
    raise ShotError(f"light {light.name!r}: a light of type {type(light).__name__} has no place in the world")
