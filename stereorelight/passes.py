"""The frame of named passes: the one value that travels between steps, checked once when it is made.

Shapes: (H, W) or (H, W, 3) float32, flow (H, W, 2), flags (H, W) uint16.  Lengths in metres.  P and N are in the scene
frame of the camera (x right, y up, the camera looks down -z).  Missing is NaN; `flags` says why."""

from __future__ import annotations

import enum
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import as_float32
from stereorelight.camera import Camera, Eye
from stereorelight.errors import PassError, nearest_hint

UNIT_TOLERANCE = 2e-3  # what a half-float normal may be off unit length by


class Flag(enum.IntFlag):
    """Why a pixel is missing, or why its value is only a guess.  Reasons, never arithmetic."""

    OUT_OF_VIEW = 1  # the other eye's frame ends before it
    OCCLUDED = 2  # something nearer hides it from the other eye
    UNMATCHED = 4  # no consistent match was found
    FILLED = 8  # the value is a guess from its surroundings
    TOO_FAR = 16  # nearer to infinity than the disparity can tell
    TOO_NEAR = 32  # nearer than the searched range
    BAD_PLATE = 64  # the plate itself is NaN or infinite there
    REPAIRED = 128  # a person said so


@dataclass(frozen=True)
class Role:
    """What a pass must be: channel count, whether it is colour, lowest and highest value, and its meaning."""

    channels: int | None
    meaning: str
    colour: bool = False
    low: float = -np.inf
    high: float = np.inf
    unit_length: bool = False


ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "Z": Role(None, "distance along the optical axis, metres", low=float(np.finfo(np.float32).tiny)),
        "disparity": Role(None, "x_left - x_right on the rectified pair, pixels"),
        "confidence": Role(None, "share of such pixels within 1 px of truth", low=0, high=1),
        "flags": Role(None, "reason bits, see Flag"),
        "disparity_sigma": Role(None, "standard deviation of the disparity, pixels", low=0),
        "Z_sigma": Role(None, "standard deviation of Z, metres", low=0),
        "N_sigma": Role(None, "standard deviation of N's direction, degrees", low=0),
        "P": Role(3, "position, scene frame of the camera, metres"),
        "N": Role(3, "unit normal, scene frame of the camera, faces the camera", unit_length=True),
        "plate": Role(3, "the plate, scene-linear", colour=True),
        "beauty": Role(3, "the relit plate, scene-linear", colour=True),
        "alpha": Role(None, "where light may fall, of light alone", low=0, high=1),
        "albedo": Role(3, "surface colour under white light of 1", colour=True),
        "occlusion": Role(None, "share of the hemisphere that is open", low=0, high=1),
        "ao": Role(None, "ambient occlusion: the share of the light from all around that arrives", low=0, high=1),
        "bent": Role(3, "mean direction of what is open, unit, scene frame of the camera"),
        "flow": Role(2, "motion to the next frame as (x, y), pixels"),
    }
)
PREFIXED_ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "light_": Role(3, "one light's layer", colour=True),
        "env_": Role(3, "one layer of the environment's light", colour=True),
        "paint_": Role(3, "one painted layer; an ink line's takes light away", colour=True),
        "group_": Role(3, "the sum of a group of lights' layers", colour=True),
        "matte_": Role(None, "a matte", low=0, high=1),
        "shadow_": Role(None, "the share of a light that arrives, or that nobody can know of", low=0, high=1),
    }
)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def role_of(name: str) -> Role:
    """The role of pass `name`.  Raises PassError with the nearest known name."""
    if name in ROLES:
        return ROLES[name]
    for prefix, role in PREFIXED_ROLES.items():
        if name.startswith(prefix) and len(name) > len(prefix) and NAME.fullmatch(name):
            return role
    raise PassError(f"pass {name!r} is unknown{nearest_hint(name, [*ROLES, 'light_<name>_diffuse', 'matte_<name>'])}")


def _checked(name: str, array: Any, size_hw: tuple[int, int] | None) -> npt.NDArray[Any]:
    role = role_of(name)
    if name == "flags":
        flags = np.asarray(array)
        if flags.ndim != 2 or not np.issubdtype(flags.dtype, np.integer) or (size_hw and flags.shape != size_hw):
            raise PassError(f"flags must be whole numbers of shape {size_hw or '(H, W)'}, got {flags.dtype} {flags.shape}")
        if flags.size == 0:
            raise PassError(f"flags is empty: shape {flags.shape}")
        if flags.min() < 0 or flags.max() > 65535:
            raise PassError(f"flags must lie in 0 ... 65535, got {flags.min()} ... {flags.max()}")
        return np.ascontiguousarray(flags, dtype=np.uint16)
    a = as_float32(array, name, channels=role.channels, size_hw=size_hw)
    if role.colour:
        return a
    with np.errstate(invalid="ignore"):  # NaN is passed over
        lowest, highest = float(np.fmin.reduce(a, axis=None)), float(np.fmax.reduce(a, axis=None))
    if np.isinf(lowest) or np.isinf(highest):
        raise PassError(f"{name} holds infinity at {int(np.isinf(a).sum())} values; missing is NaN")
    if lowest < role.low or highest > role.high:
        with np.errstate(invalid="ignore"):
            off = (a < role.low) | (a > role.high)
        hint = "; missing is NaN, never 0" if name == "Z" else ""
        raise PassError(f"{name} must lie in {role.low:.3g} ... {role.high:.3g}, got {float(a[off][0]):.4g} at {int(off.sum())} pixels{hint}")
    if role.unit_length:
        length2 = np.einsum("hwc,hwc->hw", a, a)
        off = np.abs(length2 - 1) > 2 * UNIT_TOLERANCE
        if off.any():
            length = float(np.sqrt(length2[off][0]))
            raise PassError(f"{name} must be unit vectors or NaN, got length {length:.4g} at {int(off.sum())} pixels; is it coded 0..1?")
    return a


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame(Mapping[str, npt.NDArray[Any]]):
    """Passes of one picture of one eye: `frame["Z"]`, `"N" in frame`, `frame.with_passes(N=...)`.

    passes   : name to array; every array has the camera's (or the first pass's) size.  Raises PassError otherwise.
    camera   : the camera of the plate that the passes lie on, or None where nothing needs one.
    eye      : whose plate that is.
    metadata : words that travel into the header of a file.
    """

    passes: Mapping[str, npt.NDArray[Any]]
    camera: Camera | None = None
    eye: Eye = "left"
    number: int | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.passes:
            raise PassError("a frame needs at least one pass")
        size_hw = self.camera.size_hw if self.camera else None
        checked: dict[str, npt.NDArray[Any]] = {}
        for name, array in self.passes.items():
            checked[name] = _checked(name, array, size_hw)
            size_hw = size_hw or (int(checked[name].shape[0]), int(checked[name].shape[1]))
        object.__setattr__(self, "passes", MappingProxyType(checked))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        try:
            return self.passes[name]
        except KeyError:
            raise PassError(f"pass {name!r} is missing; there are: {', '.join(self.passes)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self.passes

    def get(self, name: str, default: Any = None) -> Any:
        """The pass, or `default` where there is none."""
        return self.passes.get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self.passes)

    def __len__(self) -> int:
        return len(self.passes)

    @property
    def size_hw(self) -> tuple[int, int]:
        first = next(iter(self.passes.values()))
        return int(first.shape[0]), int(first.shape[1])

    def with_passes(self, **new: npt.NDArray[Any]) -> Frame:
        """A new frame with these passes added or replaced."""
        return Frame(passes={**self.passes, **new}, camera=self.camera, eye=self.eye, number=self.number, metadata=self.metadata)
