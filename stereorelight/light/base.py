"""What every light has, and what it refuses: name, strength, colour, surface model, shadow and space.

Units: intensity 1 makes a white card that faces the light at 1 m read exactly 1.0 (linear).  Metres, degrees; colours are linear.
Frames: `space = "camera"` is the scene frame of the camera (x right, y up, the camera looks down -z), `"world"` the frame
that `Camera.world_from_camera` leads to.  The kinds of light, and how a file names them, are in lights.py."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.diffusion import scatter_shape
from stereorelight.light.kelvin import COLDEST_K, HOTTEST_K, kelvin_color

Vector = tuple[float, float, float]
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
