"""Mattes by name: from a file's channel, by Z, by position, by normal, and by combining others.

In: a frame's Z, P and N, and the camera.  Out: (H, W) float32 in 0..1 by name, for the `matte` of a light, a material or
the environment.  Every matte is 1 where it holds fully and falls to 0 over its softness, outside, by a smoothstep; 0 is a
hard edge.  Frame: scene frame of the camera (x right, y up, the camera looks down -z), or the world with `space = "world"`;
metres and degrees.  What is not known (NaN) is 0, inverted or not: light that would go there is not cast."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.light.base import FARTHEST_M, NAME, SPACES
from stereorelight.light.checks import Checked, Vector, checked_keys

MATTES: dict[str, type[Matte]] = {}  # by the word that `type` holds in a file
PASSES = {"P": 3, "N": 3, "Z": None}


@dataclass(frozen=True, kw_only=True)
class Matte(Checked):
    """What every matte has.

    name   : letters, digits and _; what a light's `matte` says.
    invert : 1 where it would be 0.
    Raises : ShotError naming the matte, the key, what was wanted, what came, and the remedy.
    """

    what: ClassVar[str] = "matte"
    kind: ClassVar[str] = ""
    reads: ClassVar[tuple[str, ...]] = ()  # passes

    name: str
    invert: bool = False

    def __init_subclass__(cls) -> None:
        if cls.kind:
            MATTES[cls.kind] = cls

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not NAME.fullmatch(self.name):
            raise ShotError(f"matte {self.name!r}: name must be a letter followed by letters, digits and _; rename it")
        self._flag("invert")

    def _metres(self, key: str, low: float = 0.0) -> None:
        self._number(key, low=low, high=FARTHEST_M)

    @property
    def needs(self) -> tuple[str, ...]:
        """The mattes that it is made of."""
        return ()


@dataclass(frozen=True, kw_only=True)
class FileMatte(Matte):
    """A channel of a picture.

    file    : a picture or pattern; read by the shot, which knows its folder.
    channel : of it, such as "A" or "actor.R"; left out: `matte_*` or alpha where there is one, else the mean of the picture.
    """

    kind: ClassVar[str] = "file"

    file: str
    channel: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("file", "channel"):
            value = getattr(self, key)
            if (value is not None or key == "file") and (not isinstance(value, str) or not value):
                raise self._error(key, "must be a text", repr(value))


@dataclass(frozen=True, kw_only=True)
class DepthMatte(Matte):
    """Between two distances along the optical axis, metres; one of them may be left out."""

    kind: ClassVar[str] = "depth"
    reads: ClassVar[tuple[str, ...]] = ("Z",)

    near_m: float | None = None
    far_m: float | None = None
    softness_m: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._metres("softness_m")
        for key in ("near_m", "far_m"):
            if getattr(self, key) is not None:
                self._metres(key)
        if self.near_m is None and self.far_m is None:
            raise self._error("near_m or far_m", "must be given", "neither", "the matte holds between them")
        if self.near_m is not None and self.far_m is not None and self.near_m > self.far_m:
            raise self._error("near_m", "must not be beyond far_m", f"{self.near_m:g} and {self.far_m:g}", "swap them")


@dataclass(frozen=True, kw_only=True)
class _PlaceMatte(Matte):
    """A matte in space.  space : "camera" or "world"."""

    reads: ClassVar[tuple[str, ...]] = ("P",)

    softness_m: float = 0.0
    space: Literal["camera", "world"] = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._metres("softness_m")
        self._word("space", SPACES)


@dataclass(frozen=True, kw_only=True)
class SphereMatte(_PlaceMatte):
    """Inside a sphere."""

    kind: ClassVar[str] = "sphere"

    centre_m: Vector
    radius_m: float

    def __post_init__(self) -> None:
        super().__post_init__()
        self._vector("centre_m")
        self._metres("radius_m")


@dataclass(frozen=True, kw_only=True)
class BoxMatte(_PlaceMatte):
    """Inside a box: its centre, its whole size along its own axes, and its turn (about x, y, z; z first, then x, then y)."""

    kind: ClassVar[str] = "box"

    centre_m: Vector
    size_m: Vector
    turn_deg: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._vector("centre_m")
        self._vector("size_m", low=0, remedy="it is the whole size, [wide, high, deep]")
        self._vector("turn_deg", low=-360, high=360)


@dataclass(frozen=True, kw_only=True)
class PlaneMatte(_PlaceMatte):
    """On one side of a plane: the side that `normal` points to."""

    kind: ClassVar[str] = "plane"

    point_m: Vector
    normal: Vector

    def __post_init__(self) -> None:
        super().__post_init__()
        self._vector("point_m")
        self._direction("normal", "it points to the side that the matte holds: [0, 1, 0] is above")


@dataclass(frozen=True, kw_only=True)
class FacingMatte(Matte):
    """Where the surface faces a direction: N within `angle_deg` of it."""

    kind: ClassVar[str] = "facing"
    reads: ClassVar[tuple[str, ...]] = ("N",)

    direction: Vector
    angle_deg: float = 45.0
    softness_deg: float = 0.0
    space: Literal["camera", "world"] = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._direction("direction", "[0, 1, 0] is what faces up")
        self._number("angle_deg", low=0, high=180)
        self._number("softness_deg", low=0, high=180)
        self._word("space", SPACES)


@dataclass(frozen=True, kw_only=True)
class CombinedMatte(Matte):
    """Others together: kind "multiply" is where all of them hold, "screen" where any of them does."""

    of: tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        names = list(self.of) if isinstance(self.of, (list, tuple)) else []
        if not names or not all(isinstance(n, str) for n in names):
            raise self._error("of", 'must be names of mattes, ["actor", "near"]', repr(self.of))
        object.__setattr__(self, "of", tuple(names))

    @property
    def needs(self) -> tuple[str, ...]:
        return self.of


@dataclass(frozen=True, kw_only=True)
class MultiplyMatte(CombinedMatte):
    """Where all of them hold."""

    kind: ClassVar[str] = "multiply"


@dataclass(frozen=True, kw_only=True)
class ScreenMatte(CombinedMatte):
    """Where any of them holds: 1 less the product of what each leaves."""

    kind: ClassVar[str] = "screen"


def matte_from_dict(table: Mapping[str, Any], label: str) -> Matte:
    """A matte from a plain `[[mattes]]` table; `type` may be left out where `file` says it.  Raises ShotError that begins with `label`."""
    word = table.get("type", "file" if "file" in table else None)
    if word is None:
        raise ShotError(f"{label}: type is missing; add type = {' or '.join(repr(k) for k in MATTES)}")
    cls = MATTES.get(word) if isinstance(word, str) else None
    if cls is None:
        raise ShotError(f"{label}: type {word!r} is unknown{nearest_hint(str(word), MATTES)}")
    checked_keys(table, cls, label)
    return cls(**{f.name: table[f.name] for f in fields(cls) if f.name in table})


def checked_mattes(mattes: Sequence[Matte], given: Sequence[str] = ()) -> None:
    """Names differ, and what is combined stands before.  given : names that are there already.  Raises ShotError."""
    known = list(given)
    for matte in mattes:
        if matte.name in known:
            raise ShotError(f"matte {matte.name!r}: name is taken by an earlier matte; rename one")
        for name in matte.needs:
            if name not in known:
                later = any(name == other.name for other in mattes)
                why = "; it stands further down: put it before" if later else nearest_hint(name, known) or "; no matte stands before"
                raise ShotError(f"matte {matte.name!r}: of {name!r} is unknown{why}")
        known.append(matte.name)


Read = Callable[[FileMatte], npt.ArrayLike]


def matte_arrays(
    mattes: Sequence[Matte],
    passes: Mapping[str, npt.ArrayLike],
    *,
    camera: Camera | None = None,
    read: Read | None = None,
    given: Mapping[str, npt.ArrayLike] | None = None,
) -> dict[str, Float32]:
    """Every matte of a frame by its name: those given, and then `mattes` in their order.

    passes  : Z (H, W), P and N (H, W, 3), as far as the mattes need them.
    camera  : its pose places what stands in the world; without one, world = camera.
    read    : gives the channel of a file matte, (H, W).
    Returns : (H, W) float32, 0..1, never NaN.
    Raises  : PassError for a pass that is missing or of another size, ShotError for names that do not fit.
    """
    checked_mattes(mattes, list(given or {}))
    pose = np.eye(4) if camera is None else camera.world_from_camera
    known: dict[str, Float64] = {}
    size_hw: tuple[int, int] | None = None
    for name, array in (given or {}).items():
        known[name] = _checked(name, array, size_hw)
        size_hw = (known[name].shape[0], known[name].shape[1])
    taken: dict[str, Float32] = {}
    for matte in mattes:
        for key in matte.reads:
            if key not in taken:
                if key not in passes:
                    raise PassError(f"matte {matte.name!r}: needs the pass {key}, which is not there; there are: {', '.join(passes)}")
                taken[key] = as_float32(passes[key], key, channels=PASSES[key], size_hw=size_hw)
                size_hw = (taken[key].shape[0], taken[key].shape[1])
        if isinstance(matte, FileMatte):
            if read is None:
                raise ShotError(f"matte {matte.name!r}: of a file, and nobody reads files here; give it as an array")
            made = _checked(matte.name, read(matte), size_hw)
        elif isinstance(matte, CombinedMatte):
            parts = [known[name] for name in matte.of]
            made = np.prod(parts, axis=0) if isinstance(matte, MultiplyMatte) else 1 - np.prod([1 - part for part in parts], axis=0)
        else:
            made = _shape(matte, taken, pose)
        size_hw = (made.shape[0], made.shape[1])
        known[matte.name] = 1 - made if matte.invert else made
    return {name: np.nan_to_num(array, nan=0.0).astype(np.float32) for name, array in known.items()}


def _checked(name: str, array: npt.ArrayLike, size_hw: tuple[int, int] | None) -> Float64:
    a = as_float32(array, f"matte {name!r}", size_hw=size_hw).astype(np.float64)
    with np.errstate(invalid="ignore"):
        off = (a < 0) | (a > 1)
    if off.any():
        raise PassError(f"matte {name!r} must lie in 0 ... 1, got {float(a[off][0]):.4g} at {int(off.sum())} pixels; divide 8-bit values by 255")
    return a


def _fallen(beyond: npt.ArrayLike, softness: float) -> Float64:
    """1 where `beyond` (what is outside, >= 0 there) is at most 0, down to 0 at `softness`."""
    out = np.asarray(beyond, dtype=np.float64)
    t = np.clip(out / softness, 0, 1) if softness > 0 else np.where(np.isnan(out), np.nan, (out > 0).astype(np.float64))
    fallen: Float64 = 1 - t * t * (3 - 2 * t)
    return fallen


def _shape(matte: Matte, passes: Mapping[str, Float32], pose: Float64) -> Float64:
    if isinstance(matte, DepthMatte):
        Z = passes["Z"].astype(np.float64)
        nearer = -np.inf if matte.near_m is None else matte.near_m - Z
        farther = -np.inf if matte.far_m is None else Z - matte.far_m
        return _fallen(np.where(np.isfinite(Z), np.maximum(nearer, farther), np.nan), matte.softness_m)
    if isinstance(matte, FacingMatte):
        N = passes["N"].astype(np.float64)
        way = np.array(matte.direction) / np.linalg.norm(matte.direction)
        if matte.space == "world":
            way = way @ pose[:3, :3]
        length = np.linalg.norm(N, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = np.where(length > 0.1, N @ way / length, np.nan)
            angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        return _fallen(angle - matte.angle_deg, matte.softness_deg)
    P = passes["P"].astype(np.float64)
    P = np.where(np.isfinite(P).all(axis=-1, keepdims=True), P, np.nan)
    if getattr(matte, "space", "camera") == "world":
        P = P @ pose[:3, :3].T + pose[:3, 3]
    if isinstance(matte, SphereMatte):
        return _fallen(np.linalg.norm(P - matte.centre_m, axis=-1) - matte.radius_m, matte.softness_m)
    if isinstance(matte, PlaneMatte):
        normal = np.array(matte.normal) / np.linalg.norm(matte.normal)
        return _fallen(-((P - matte.point_m) @ normal), matte.softness_m)
    if isinstance(matte, BoxMatte):
        out = np.abs((P - matte.centre_m) @ _turn(matte.turn_deg)) - np.array(matte.size_m) / 2
        # Outside, the distance to the box, so that its corners are round.
        away = np.linalg.norm(np.maximum(out, 0), axis=-1)
        return _fallen(np.where(away > 0, away, out.max(axis=-1)), matte.softness_m)
    raise ShotError(f"matte {matte.name!r}: a matte of type {type(matte).__name__} cannot be made")


def _turn(degrees: Vector) -> Float64:
    """(3, 3) of a box's turn: about z, then x, then y."""
    (cx, sx), (cy, sy), (cz, sz) = ((math.cos(math.radians(d)), math.sin(math.radians(d))) for d in degrees)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    turned: Float64 = about_y @ about_x @ about_z
    return turned


def known_mattes(names: Sequence[str | None], mattes: Sequence[str], owner: str) -> None:
    """Raises ShotError where one of `names` is no matte."""
    for name in names:
        if name is not None and name not in mattes:
            raise ShotError(f"{owner}: matte {name!r} is missing{nearest_hint(name, mattes) or '; there are none'}")
