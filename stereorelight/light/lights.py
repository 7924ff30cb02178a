"""Lights as values: point, directional, spot, ball and rectangle, each refused when made where it could not exist.

Units: intensity 1 makes a white card that faces the light at 1 m read exactly 1.0 (linear); a directional light has no
distance, and its facing card reads 1.0 anywhere.  A light with a size has a radiance such that radiance times its area as seen
head on is pi times its strength: on its axis and from afar it reads as the point light does, whatever its size.  Metres, degrees; colours are linear.
Frames: `space = "camera"` is the scene frame of the camera (x right, y up, the camera looks down -z), `"world"` the frame
that `Camera.world_from_camera` leads to.  Source: the paper's section 5, equations 6-11; errata in docs/paper.md."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.diffusion import scatter_shape
from stereorelight.light.kelvin import COLDEST_K, HOTTEST_K, kelvin_color

Vector = tuple[float, float, float]
Attenuation = Literal["inverse_square", "linear", "none", "radius"]
ATTENUATIONS = ("inverse_square", "linear", "none", "radius")
SPACES = ("camera", "world")
SHADOWS = ("off", "march", "rays")
Model = Literal["phong", "ggx", "lambert"]
MODELS = ("phong", "ggx", "lambert")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
FARTHEST_M = 1e6  # farther away, a light is directional for every purpose, and float32 runs out of digits
STRONGEST = 1e12  # of intensity * 2^exposure; keeps every layer finite
LIGHTS: dict[str, type[Light]] = {}  # by the word that `type` holds in a file


@dataclass(frozen=True, kw_only=True)
class Light:
    """What every light has.

    name           : letters, digits and _; names its layers `light_<name>_diffuse` and `light_<name>_specular`.
    intensity      : >= 0, times 2^exposure (exposure in stops).
    color          : linear tint, >= 0.
    kelvin         : colour temperature instead of `color`; luminance 1, 6504 K is white (light/kelvin.py).
    enabled        : False leaves the light and its layers out.
    solo           : where any enabled light is solo, only solo lights shine and have layers.
    group          : name of the group that its layers are summed up in, or None.
    matte          : name of the matte that it shines through, or None.
    diffuse        : strength of the Lambert part, >= 0.
    specular       : strength of the highlight, >= 0; at 0 there is no specular layer.
    exponent       : of Phong's lobe, >= 1; what the paper calls roughness.
    specular_tint  : linear tint of the highlight alone, >= 0.
    normalised     : scale the lobe by (exponent + 2) / 2: with strength 1, lit and seen head on, the highlight then
                     sends back as much light as a white card, whatever its exponent.
    scatter        : what is under the surface: a name of light/diffusion.py, such as "skin"; None for nothing.
    scatter_mm     : how far light spreads in it, mm: one number or three (light/diffusion.py); 0 is off, None the preset's own.
    wrap           : 0..1, how far the light reaches round the surface: max(0, (N.L + wrap) / (1 + wrap)).
    model          : of the surface: "phong", "ggx" (Smith height-correlated, what bounces between facets given back), or "lambert",
                     which has no highlight.
    roughness      : 0..1 of GGX, alpha = roughness^2; below 0.045 as 0.045.
    f0, ior        : what GGX reflects head on, with Schlick's formula (default 0.04); or its index of refraction, with the exact one.
    rim            : strength of a rim, rim_color * (1 - N.V)^rim_power times the light that arrives; part of the specular layer.
    space          : "camera" or "world".
    shadow         : "off", "march" (through the depth, fast) or "rays" (exact, for finals).
    shadow_samples : rays to a light with a size, 1 ... 1024.     shadow_density : 1 is a full shadow, 0 none.
    shadow_bias_m  : metres added to what a ray starts off the surface by, which the depth's own sigma sets; may be negative.
    Raises         : ShotError naming the light, the key, what was wanted, what came, and the remedy.
    """

    kind: ClassVar[str] = "light"

    name: str
    intensity: float = 1.0
    exposure: float = 0.0
    color: Vector = (1.0, 1.0, 1.0)
    kelvin: float | None = None
    enabled: bool = True
    solo: bool = False
    group: str | None = None
    matte: str | None = None
    diffuse: float = 1.0
    specular: float = 0.0
    exponent: float = 32.0
    specular_tint: Vector = (1.0, 1.0, 1.0)
    normalised: bool = False
    model: Model = "phong"
    roughness: float = 0.5
    f0: float | None = None
    ior: float | None = None
    rim: float = 0.0
    rim_power: float = 3.0
    rim_color: Vector = (1.0, 1.0, 1.0)
    scatter: str | None = None
    scatter_mm: float | Vector | None = None
    wrap: float = 0.0
    space: Literal["camera", "world"] = "camera"
    shadow: Literal["off", "march", "rays"] = "off"
    shadow_samples: int = 16
    shadow_density: float = 1.0
    shadow_bias_m: float = 0.0

    def __init_subclass__(cls) -> None:
        LIGHTS[cls.kind] = cls

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not NAME.fullmatch(self.name):
            raise ShotError(f"light {self.name!r}: name must be a letter followed by letters, digits and _, since it names the layers; rename it")
        self._number("intensity", low=0, remedy="to darken, set the plate's gain below 1")
        self._number("exposure", low=-64, high=64)
        if self.strength > STRONGEST:
            raise self._error("intensity", f"must stay below {STRONGEST:g} with its exposure", f"{self.strength:g}", "lower intensity or exposure")
        self._number("diffuse", low=0, high=1e6)
        self._number("specular", low=0, high=1e6)
        self._number("exponent", low=1, high=1e5, remedy="it is Phong's exponent: 10 is dull, 200 is glossy")
        self._number("wrap", low=0, high=1)
        self._vector("color", low=0, high=1e6)
        self._vector("specular_tint", low=0, high=1e6)
        if self.kelvin is not None:
            self._number("kelvin", low=COLDEST_K, high=HOTTEST_K, remedy="tungsten is 3200, daylight 5600")
            if self.color != (1.0, 1.0, 1.0):
                raise self._error("kelvin", "must stand alone, without color", "both", "remove one of them")
        self._word("model", MODELS)
        self._number("roughness", low=0, high=1, remedy="0 is a mirror, 1 is dull; Phong's is `exponent`")
        for key, low, high in (("f0", 0.0, 1.0), ("ior", 1.0, 10.0)):
            if getattr(self, key) is not None:
                self._number(key, low=low, high=high)
        if self.f0 is not None and self.ior is not None:
            raise self._error("f0", "must stand alone, without ior", "both", "remove one of them")
        self._number("rim", low=0, high=1e6)
        self._number("rim_power", low=1, high=100)
        self._vector("rim_color", low=0, high=1e6)
        scatter_shape(self.scatter, self.scatter_mm, f"light {self.name!r}")
        if self.scatter_mm is not None and not isinstance(self.scatter_mm, (int, float)):
            self._vector("scatter_mm", low=0)
        self._flag("solo")
        if self.group is not None and (not isinstance(self.group, str) or not NAME.fullmatch(self.group)):
            raise self._error("group", "must be a name of letters, digits and _", repr(self.group), "leave it out for no group")
        self._flag("enabled")
        self._flag("normalised")
        self._word("space", SPACES)
        self._word("shadow", SHADOWS)
        if not isinstance(self.shadow_samples, (int, np.integer)) or isinstance(self.shadow_samples, bool) or not 1 <= self.shadow_samples <= 1024:
            raise self._error("shadow_samples", "must be a whole number in 1 ... 1024", repr(self.shadow_samples))
        self._number("shadow_density", low=0, high=1)
        self._number("shadow_bias_m", low=-1, high=1)
        if self.matte is not None and (not isinstance(self.matte, str) or not NAME.fullmatch(self.matte)):
            raise self._error("matte", "must be the name of a matte", repr(self.matte), "leave it out for no matte")

    @property
    def strength(self) -> float:
        """intensity * 2^exposure."""
        return float(self.intensity * 2.0**self.exposure)

    @property
    def tint(self) -> Vector:
        """Its colour, by `color` or `kelvin`."""
        return self.color if self.kelvin is None else kelvin_color(self.kelvin)

    @property
    def shines(self) -> bool:
        """Whether it has a specular layer of its own accord."""
        return (self.specular > 0 and self.model != "lambert") or self.rim > 0

    def _error(self, key: str, wanted: str, came: str, remedy: str = "") -> ShotError:
        return ShotError(f"light {self.name!r}: {key} {wanted}, got {came}" + (f"; {remedy}" if remedy else ""))

    def _number(self, key: str, *, low: float = -math.inf, high: float = math.inf, remedy: str = "") -> None:
        value = getattr(self, key)
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or not low <= value <= high:
            span = f"{low:g} ... {high:g}" if math.isfinite(high) else (f"at least {low:g}" if math.isfinite(low) else "finite")
            wanted = f"must be a number, {span}" if math.isinf(high) else f"must be a number in {span}"
            raise self._error(key, wanted, repr(value), remedy)
        object.__setattr__(self, key, float(value))

    def _vector(self, key: str, *, low: float = -math.inf, high: float = math.inf, remedy: str = "") -> None:
        value = getattr(self, key)
        span = f" in {low:g} ... {high:g}" if math.isfinite(low) else f" within {high:g}"
        try:
            if isinstance(value, (str, Mapping)) or any(isinstance(v, (bool, str)) for v in value):
                raise TypeError
            x, y, z = (float(v) for v in value)
        except (TypeError, ValueError):
            raise self._error(key, "must be three numbers, [x, y, z]", repr(value), remedy) from None
        if not all(math.isfinite(v) and low <= v <= high for v in (x, y, z)):
            raise self._error(key, f"must be three numbers{span}", f"[{x:g}, {y:g}, {z:g}]", remedy)
        object.__setattr__(self, key, (x, y, z))

    def _place(self, key: str) -> None:
        self._vector(key, low=-FARTHEST_M, high=FARTHEST_M, remedy="a light that far away is a directional one")

    def _direction(self, key: str) -> None:
        self._vector(key, low=-FARTHEST_M, high=FARTHEST_M)
        if math.hypot(*getattr(self, key)) < 1e-6:
            raise self._error(key, "must not be zero", "no direction", "it is the way the light travels: [0, 0, -1] shines away from the camera")

    def _flag(self, key: str) -> None:
        if not isinstance(getattr(self, key), (bool, np.bool_)):
            raise self._error(key, "must be true or false", repr(getattr(self, key)))

    def _word(self, key: str, known: Sequence[str]) -> None:
        value = getattr(self, key)
        if value not in known:
            raise ShotError(f"light {self.name!r}: {key} {value!r} is unknown{nearest_hint(str(value), known)}")


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
