"""How light spreads in stuff: Burley's normalised diffusion in millimetres, and measured stuffs.

In: distances and lengths, mm.  Out: the profile, its integral, and its length for a preset's name.
R(r) = (e^(-r/d) + e^(-r/3d)) / (8 pi d r), whose integral over the plane is 1 for every d (Christensen and Burley, Approximate
Reflectance Profiles for Efficient Subsurface Scattering, 2015)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.checks import Vector, is_number

LONGEST_MM = 1000.0


@dataclass(frozen=True, kw_only=True)
class Stuff:
    """Measured per mm in red, green, blue: reduced scattering, absorption; and the albedo that they make."""

    scatters: Vector
    absorbs: Vector
    albedo: Vector

    @property
    def path_mm(self) -> Float64:
        """(3,) diffuse mean free path, 1 / sqrt(3 absorbs (absorbs + scatters)), mm."""
        a, s = np.array(self.absorbs), np.array(self.scatters)
        found: Float64 = 1 / np.sqrt(3 * a * (a + s))
        return found


# Jensen, Marschner, Levoy and Hanrahan, A Practical Model for Subsurface Light Transport (2001), figure 5: Skin1, Skin2, Marble,
# Whole milk.  No table of that kind holds wax; it is given milk's, fat in small drops, which looks like it.
STUFFS: Mapping[str, Stuff] = MappingProxyType(
    {
        "skin": Stuff(scatters=(0.74, 0.88, 1.01), absorbs=(0.032, 0.17, 0.48), albedo=(0.44, 0.22, 0.13)),
        "skin_light": Stuff(scatters=(1.09, 1.59, 1.79), absorbs=(0.013, 0.070, 0.145), albedo=(0.63, 0.44, 0.34)),
        "marble": Stuff(scatters=(2.19, 2.62, 3.00), absorbs=(0.0021, 0.0041, 0.0071), albedo=(0.83, 0.79, 0.75)),
        "wax": Stuff(scatters=(2.55, 3.21, 3.77), absorbs=(0.0011, 0.0024, 0.014), albedo=(0.91, 0.88, 0.76)),
    }
)
PLAIN_ALBEDO = 0.5  # of stuff that is known by its lengths alone


def shape_mm(path_mm: npt.ArrayLike, albedo: npt.ArrayLike = PLAIN_ALBEDO) -> Float64:
    """The profile's d of diffuse mean free paths, mm: path / (3.5 + 100 (albedo - 0.33)^4), the paper's searchlight fit, equation 8."""
    found: Float64 = np.asarray(path_mm, np.float64) / (3.5 + 100 * (np.asarray(albedo, np.float64) - 0.33) ** 4)
    return found


def profile(r_mm: npt.ArrayLike, d_mm: float) -> Float64:
    """R(r), per mm2, of light that comes out r mm (> 0) away from where it went in.  Raises ShotError unless d_mm > 0."""
    d, r = _positive(d_mm), np.asarray(r_mm, np.float64)
    found: Float64 = (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * math.pi * d * r)
    return found


def profile_within(r_mm: npt.ArrayLike, d_mm: float) -> Float64:
    """The share of light that comes out within r mm (>= 0).  Raises ShotError unless d_mm > 0."""
    d, r = _positive(d_mm), np.asarray(r_mm, np.float64)
    found: Float64 = 1 - 0.25 * np.exp(-r / d) - 0.75 * np.exp(-r / (3 * d))
    return found


def _positive(d_mm: float) -> float:
    if not is_number(d_mm) or not math.isfinite(d_mm) or d_mm <= 0:
        raise ShotError(f"a diffusion profile needs a length d_mm above 0, got {d_mm!r}; without scattering there is no profile")
    return float(d_mm)


def scatter_shape(scatter: str | None, scatter_mm: float | Sequence[float] | None, owner: str = "scattering") -> Vector | None:
    """d of red, green and blue in mm, of a preset's name and lengths; None where nothing scatters.

    scatter    : a name of `STUFFS`, or None.
    scatter_mm : diffuse mean free path, mm: three numbers; or one, for all three, or for the longest of a preset whose proportions stay.
                 0 is off.  None is the preset's own.
    Raises     : ShotError naming `owner`, for unknown names and for lengths that are negative or no numbers.
    """
    if scatter is not None and scatter not in STUFFS:
        raise ShotError(f"{owner}: scatter {scatter!r} is unknown{nearest_hint(str(scatter), list(STUFFS))}; there are: {', '.join(STUFFS)}")
    if scatter is None and scatter_mm is None:
        return None
    stuff = STUFFS.get(scatter or "")
    paths = np.ones(3) if stuff is None else stuff.path_mm
    if scatter_mm is not None:
        values: list[Any] = list(scatter_mm) if isinstance(scatter_mm, (list, tuple, np.ndarray)) else [scatter_mm]
        if len(values) not in (1, 3) or not all(is_number(v) and math.isfinite(v) and 0 <= v <= LONGEST_MM for v in values):
            raise ShotError(
                f"{owner}: scatter_mm must be a length of 0 ... {LONGEST_MM:g} mm, or three of them, got {scatter_mm!r}; skin's are 3.7, 1.4, 0.7"
            )
        paths = np.array(values, np.float64) if len(values) == 3 else paths * float(values[0]) / paths.max()
    d = shape_mm(paths, PLAIN_ALBEDO if stuff is None else stuff.albedo)
    return (float(d[0]), float(d[1]), float(d[2])) if d.max() > 0 else None
