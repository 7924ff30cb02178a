"""Transfer functions by exact formula: encoded picture values to linear and back.

In, out: float32 arrays of any shape; 1.0 is display or reference white.  Values below 0 are mirrored and values above 1
follow the same formula, so that nothing is clipped and the round trip returns what went in.
Sources: IEC 61966-2-1 (sRGB), ITU-R BT.709-6 section 1.2 (camera curve, the same in BT.2020).  Each curve lives here and
nowhere else; camera logs and primaries are OpenColorIO's, in footage/colour.py."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64
from stereorelight.errors import ShotError, nearest_hint

# BT.709's constants to the digits at which its two branches meet, so that the curve has an inverse.
BT709_ALPHA, BT709_BETA = 1.09929682680944, 0.018053968510807

# The standard's two branches leave a gap of 2.4e-9 where they meet at 0.04045; its middle tells them apart after rounding to float32.
SRGB_JOIN = (0.04045 / 12.92 + ((0.04045 + 0.055) / 1.055) ** 2.4) / 2


@dataclass(frozen=True)
class Curve:
    """A transfer function on values >= 0, both ways."""

    decode: Callable[[Float64], Float64]
    encode: Callable[[Float64], Float64]


def _power(gamma: float) -> Curve:
    return Curve(lambda e: np.power(e, gamma), lambda l: np.power(l, 1 / gamma))


def _srgb_decode(e: Float64) -> Float64:
    return np.where(e <= 0.04045, e / 12.92, np.power((e + 0.055) / 1.055, 2.4))


def _srgb_encode(l: Float64) -> Float64:
    return np.where(l <= SRGB_JOIN, l * 12.92, 1.055 * np.power(l, 1 / 2.4) - 0.055)


def _rec709_decode(e: Float64) -> Float64:
    return np.where(e < 4.5 * BT709_BETA, e / 4.5, np.power((e + (BT709_ALPHA - 1)) / BT709_ALPHA, 1 / 0.45))


def _rec709_encode(l: Float64) -> Float64:
    return np.where(l < BT709_BETA, l * 4.5, BT709_ALPHA * np.power(l, 0.45) - (BT709_ALPHA - 1))


CURVES: Mapping[str, Curve] = MappingProxyType(
    {
        "linear": Curve(lambda e: e, lambda l: l),
        "sRGB": Curve(_srgb_decode, _srgb_encode),
        "rec709": Curve(_rec709_decode, _rec709_encode),
        "gamma2.2": _power(2.2),
        "gamma2.4": _power(2.4),
    }
)


def known_spaces() -> tuple[str, ...]:
    """The names that `decode` and `encode` take."""
    return tuple(CURVES)


def checked_curve(name: str) -> str:
    """`name` as the registry spells it, whatever its case.  Raises ShotError with the nearest name."""
    for known in CURVES:
        if known.lower() == str(name).lower():
            return known
    raise ShotError(f"colour_space {name!r} is unknown{nearest_hint(str(name), [*CURVES, 'auto'])}")


def _apply(curve: Callable[[Float64], Float64], values: npt.ArrayLike) -> Float32:
    v = np.asarray(values, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.ascontiguousarray(np.copysign(curve(np.abs(v)), v), dtype=np.float32)


def decode(encoded: npt.ArrayLike, space: str) -> Float32:
    """Linear float32 of `encoded`, same shape and primaries; NaN stays NaN.  Raises ShotError for an unknown curve."""
    name = checked_curve(space)
    if name == "linear":
        return np.ascontiguousarray(encoded, dtype=np.float32)
    return _apply(CURVES[name].decode, encoded)


def encode(linear: npt.ArrayLike, space: str) -> Float32:
    """The inverse of `decode`, to float32 precision.  Raises ShotError for an unknown curve."""
    name = checked_curve(space)
    if name == "linear":
        return np.ascontiguousarray(linear, dtype=np.float32)
    return _apply(CURVES[name].encode, linear)
