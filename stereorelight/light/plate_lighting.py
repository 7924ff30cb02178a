"""The light of a plate as a value: from all around to the second order, and one lamp; what it makes of a surface, and a picture of it.

Frame: scene frame of the camera (x right, y up, the camera looks down -z), or the world; metres.  Colours scene-linear."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64
from stereorelight.light.checks import Vector
from stereorelight.light.environment_maps import directions
from stereorelight.light.spherical_harmonics import basis


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateLighting:
    """Light of a plate, as a surface of albedo 1 reads it there.

    around    : (9, 3) of the quadratics of N (`spherical_harmonics.basis`, irradiance / pi itself, not radiance).
    lamp      : (3,) what a surface that faces the lamp reads of it at `centre_m`; 0 where no lamp is told.
    towards   : unit vector to the main light, from `centre_m`; None where nothing is told.
    place_m   : where the lamp stands; None where it is far away.
    centre_m  : of the ground that told it.
    level     : what a surface that faces the main light reads, grey: the plate's own exposure.
    explained : share of the robust variance of log brightness, on ground that had no part in the fit; 0 for none.
    residual  : robust spread of what is left of log brightness: texture, mostly.
    sigma_deg : how far the direction moves when a part of the plate is left out.
    told      : False where the plate has no shading to tell light by; everything reads `level` then.
    """

    around: Float64
    lamp: Float64
    level: float
    towards: Vector | None = None
    place_m: Vector | None = None
    centre_m: Vector = (0.0, 0.0, 0.0)
    explained: float = 0.0
    residual: float = 0.0
    sigma_deg: float = 180.0
    told: bool = False

    @property
    def words(self) -> str:
        """One line for people."""
        if not self.told or self.towards is None:
            return "light of the plate: none told; its shading does not say where light came from"
        x, y, z = self.towards
        where = f"{math.degrees(math.atan2(x, z)):+.0f} deg to the right, {math.degrees(math.asin(y)):+.0f} deg up"
        share = float(self.lamp.mean()) / max(float(self.lamp.mean()) + float(self.around[0].mean() * basis((0, 0, 1))[0]), 1e-9)
        kind = f"a lamp, {100 * share:.0f} % of it" if self.lamp.max() > 0 else "soft"
        return f"light of the plate: from {where} (+- {self.sigma_deg:.0f} deg), {kind}; explains {100 * self.explained:.0f} % of the plate's shading"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for receipts."""
        return {
            "told": self.told,
            "towards": None if self.towards is None else [round(v, 4) for v in self.towards],
            "place_m": None if self.place_m is None else [round(v, 4) for v in self.place_m],
            "sigma_deg": round(self.sigma_deg, 2),
            "level": round(self.level, 5),
            "explained": round(self.explained, 4),
            "residual": round(self.residual, 4),
            "lamp": [round(float(v), 5) for v in self.lamp],
            "around": [[round(float(v), 5) for v in row] for row in self.around],
        }

    def irradiance(self, N: npt.ArrayLike, P: npt.ArrayLike | None = None, visible: npt.ArrayLike | None = None) -> Float32:
        """(..., 3) what a white surface of normal N at P reads, at least a fiftieth of `level`; `visible` (...) is the lamp's shadow."""
        n = np.asarray(N, np.float64)
        E = basis(n) @ self.around
        if self.lamp.max() > 0 and self.towards is not None:
            S = lamp_term(n, None if P is None else np.asarray(P, np.float64), self.towards, self.place_m, self.centre_m)
            E = E + (S if visible is None else S * np.asarray(visible, np.float64))[..., None] * self.lamp
        found: Float32 = np.maximum(E, self.level / 50).astype(np.float32)
        return found

    def moved(self, pose: npt.ArrayLike) -> PlateLighting:
        """The same light in another frame: `pose` (4, 4) takes points of this one to points of that one."""
        M = np.asarray(pose, np.float64)
        R, t = M[:3, :3], M[:3, 3]
        if not self.told or np.array_equal(M, np.eye(4)):
            return self
        n = _sphere(200)
        around = np.asarray(np.linalg.lstsq(basis(n @ R.T), basis(n) @ self.around, rcond=None)[0], np.float64)

        def turned(v: Vector | None, shift: Float64 | float) -> Vector | None:
            return None if v is None else as_vector(R @ np.array(v) + shift)

        centre = turned(self.centre_m, t) or (0.0, 0.0, 0.0)
        return replace(self, around=around, towards=turned(self.towards, 0.0), place_m=turned(self.place_m, t), centre_m=centre)

    def ball(self, size_px: int = 256) -> Float32:
        """(size, size, 3) a white ball in this light as the camera would see it from afar, scene-linear; 0 beside it."""
        at = (np.arange(size_px) + 0.5) * 2 / size_px - 1
        x, y = np.meshgrid(at, -at)
        r2 = x * x + y * y
        N = np.stack([x, y, np.sqrt(np.maximum(1 - r2, 0))], axis=-1)
        found: Float32 = (self.irradiance(N) * (r2 <= 1)[..., None]).astype(np.float32)
        return found

    def latlong(self, height: int = 64) -> Float32:
        """(height, 2 height, 3) what a white card reads that faces each direction; rows and columns as light/environment_maps.py has them."""
        return self.irradiance(directions(height))


def _sphere(count: int) -> Float64:
    """(count, 3) unit vectors, evenly."""
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])


def as_vector(v: npt.ArrayLike) -> Vector:
    x, y, z = np.asarray(v, np.float64)
    return float(x), float(y), float(z)


def lamp_term(N: Float64, P: Float64 | None, towards: Vector, place: Vector | None, centre: Vector) -> Float64:
    """(...) cosine to the lamp, and its distance's square against that from `centre`."""
    if place is None or P is None:
        facing: Float64 = np.maximum(N @ np.array(towards), 0)
        return facing
    way = np.array(place) - P
    d2 = (way * way).sum(axis=-1)
    near: Float64 = np.maximum((N * way).sum(axis=-1), 0) / np.sqrt(d2) * float(((np.array(place) - centre) ** 2).sum()) / d2
    return near
