"""Painted light by table: lit spheres, toon ramps and ink lines over a shot, each a layer `paint_<name>` of its own.

In: `[[painted]]` tables; then a frame's N, P, the plate, and for a toon ramp the shading of its lights.  Out: (H, W, 3) float32,
linear, exactly 0 where N is missing.  How each looks is in `matcap`; the paper's section 6 asks for the lit sphere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.base import NAME
from stereorelight.light.checks import Checked, Vector, checked_keys, is_number
from stereorelight.light.matcap import lit_sphere, outline, toon

PAINTS: dict[str, type[Paint]] = {}  # by the word that `type` holds in a file
PREFIX = "paint_"


@dataclass(frozen=True, kw_only=True)
class Paint(Checked):
    """What every painted layer has.

    name    : letters, digits and _; the layer is `paint_<name>`.
    matte   : name of the matte that holds it, or None.      enabled : False leaves it out.
    Raises  : ShotError naming the table, the key, what was wanted, what came, and the remedy.
    """

    what: ClassVar[str] = "painted"
    kind: ClassVar[str] = ""

    name: str
    matte: str | None = None
    enabled: bool = True

    def __init_subclass__(cls) -> None:
        if cls.kind:
            PAINTS[cls.kind] = cls

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not NAME.fullmatch(self.name):
            raise ShotError(f"painted {self.name!r}: name must be a letter followed by letters, digits and _; it names the layer")
        if self.matte is not None and (not isinstance(self.matte, str) or not NAME.fullmatch(self.matte)):
            raise self._error("matte", "must be the name of a matte", repr(self.matte), "leave it out for no matte")
        self._flag("enabled")

    @property
    def layer(self) -> str:
        return PREFIX + self.name


@dataclass(frozen=True, kw_only=True)
class _Toned(Paint):
    """exposure : stops.   tint : linear.   on_plate : multiply with the plate's own colour."""

    exposure: float = 0.0
    tint: Vector = (1.0, 1.0, 1.0)
    on_plate: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._number("exposure", low=-64, high=32)
        self._vector("tint", low=0)
        self._flag("on_plate")

    @property
    def strength(self) -> Float32:
        """(3,) tint * 2^exposure."""
        return (np.array(self.tint) * 2.0**self.exposure).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class LitSphere(_Toned):
    """A picture of a painted or photographed sphere, looked up along N.

    file   : the picture or pattern; the sphere touches its four edges.
    facing : "camera", the paper's: the sphere's middle is N along the camera's axis; "ray": N towards the eye, wherever in the frame.
    """

    kind: ClassVar[str] = "lit_sphere"

    file: str
    facing: Literal["camera", "ray"] = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.file, str) or not self.file:
            raise self._error("file", "must be the name of a picture", repr(self.file))
        self._word("facing", ("camera", "ray"))


@dataclass(frozen=True, kw_only=True)
class Toon(_Toned):
    """The shading of lights, cut into flat tones.

    of       : names of the lights whose diffuse shading counts; empty for all of them.
    steps    : rising levels of shading at which the tone changes.     softness : of the change, as much shading.
    tones    : one more than steps; numbers, or colours of three.
    replaces : the lights that it is made of have no layers of their own.
    """

    kind: ClassVar[str] = "toon"

    of: tuple[str, ...] = ()
    steps: tuple[float, ...] = (0.08, 0.35, 0.75)
    tones: tuple[Any, ...] = (0.08, 0.35, 0.7, 1.0)
    softness: float = 0.04
    on_plate: bool = True
    replaces: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("of", "steps", "tones"):
            value = getattr(self, key)
            if not isinstance(value, Sequence) or isinstance(value, str):
                raise self._error(key, "must be a list", repr(value))
            object.__setattr__(self, key, tuple(value))
        if not all(isinstance(light, str) and NAME.fullmatch(light) for light in self.of):
            raise self._error("of", "must be names of lights", repr(list(self.of)), "leave it out for all of them")
        if not all(is_number(step) for step in self.steps):
            raise self._error("steps", "must be numbers", repr(list(self.steps)))
        colours = [list(t) if isinstance(t, Sequence) and not isinstance(t, str) else [t] * 3 for t in self.tones]
        if not all(len(c) == 3 and all(is_number(v) for v in c) for c in colours):
            raise self._error("tones", "must be numbers or colours of three", repr(list(self.tones)))
        object.__setattr__(self, "tones", tuple(tuple(float(v) for v in c) for c in colours))
        self._number("softness", low=0, high=1e5)
        self._flag("replaces")
        try:
            toon(np.zeros((1, 1), np.float32), steps=self.steps, colours=self.tones, softness=self.softness)
        except ShotError as error:
            raise ShotError(f"painted {self.name!r}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Outline(Paint):
    """Ink where the surface turns away from the eye: it covers what is beneath, so its layer takes that light away.

    width    : N.V below which there is ink.      softness : of its edge, as much N.V.     color : of the ink, linear.
    jump     : ink on the nearer side of jumps in depth by this share of the distance; 0 for none.
    """

    kind: ClassVar[str] = "outline"

    width: float = 0.25
    softness: float = 0.1
    jump: float = 0.0
    color: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._number("width", low=0, high=1)
        self._number("softness", low=0, high=1)
        self._number("jump", low=0, high=10)
        self._vector("color", low=0)


def painted_from_dict(table: Mapping[str, Any], label: str) -> Paint:
    """The painted layer of a file's `[[painted]]` table.  Raises ShotError with the nearest known word."""
    kind = table.get("type", LitSphere.kind if "file" in table else None)
    if kind not in PAINTS:
        told = f"type {kind!r} is unknown{nearest_hint(str(kind), PAINTS)}" if kind is not None else f"type is missing; known: {', '.join(PAINTS)}"
        raise ShotError(f"{label}: {told}")
    checked_keys(table, PAINTS[kind], label)
    return PAINTS[kind](**{key: value for key, value in table.items() if key != "type"})


def toned(
    paint: LitSphere | Toon,
    picture: npt.ArrayLike,
    *,
    P: npt.ArrayLike,
    N: npt.ArrayLike,
    plate: npt.ArrayLike,
) -> Float32:
    """(H, W, 3): the layer of a lit sphere or a toon ramp, without its matte.

    picture : of a lit sphere, the sphere (h, w, 3); of a toon ramp, the shading (H, W) or (H, W, 3).
    plate   : (H, W, 3), what `on_plate` multiplies with.
    """
    albedo = plate if paint.on_plate else None
    if isinstance(paint, LitSphere):
        found = lit_sphere(N, picture, P=P, facing=paint.facing, albedo=albedo)
    else:
        found = toon(picture, steps=paint.steps, colours=paint.tones, softness=paint.softness, albedo=albedo)
        # Unlit is a tone, but nothing is painted where nobody knows a surface.
        found[~(np.isfinite(np.asarray(N)) & np.isfinite(np.asarray(P))).all(axis=-1)] = 0
    found *= paint.strength
    return found


def inked(paint: Outline, beneath: npt.ArrayLike, *, P: npt.ArrayLike, N: npt.ArrayLike, matte: npt.ArrayLike | None = None) -> Float32:
    """(H, W, 3): what turns `beneath` (H, W, 3) into ink along the outline when it is added; below 0 where it takes light away."""
    line = outline(P, N, width=paint.width, softness=paint.softness, jump=paint.jump)
    if matte is not None:
        line = line * np.nan_to_num(np.asarray(matte, dtype=np.float32))
    under = np.asarray(beneath, dtype=np.float32)
    return line[..., None] * np.where(np.isfinite(under), np.array(paint.color, np.float32) - under, np.float32(0))


def replaced(paints: Sequence[Paint], lights: Sequence[str]) -> set[str]:
    """The names out of `lights` that have no layers of their own, since a toon ramp stands for them."""
    return {name for paint in paints if isinstance(paint, Toon) and paint.replaces for name in (paint.of or lights)}
