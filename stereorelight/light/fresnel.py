"""How much a smooth dielectric sends back, exactly; the formula in float64 that the kernel is judged by.

In: cosines of the angle between normal and ray; refractive index of the far side over that of the near side.
Out: shares of the light, both polarisations averaged."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError


def dielectric(cosine: npt.ArrayLike, ior: float) -> Float64:
    """Fresnel's reflectance, 1 where all light is reflected (ior < 1, beyond the critical angle).

    cosine : |N.V|, 0..1, any shape.
    ior    : 1.33 water, 1.5 glass, 2.42 diamond; below 1 from the dense side: 1 / 1.5 out of glass.
    Raises : ShotError for an ior that is not above 0.
    Snell and Fresnel: r_s = (c - n t) / (c + n t), r_p = (n c - t) / (n c + t), t the cosine inside; F = (r_s^2 + r_p^2) / 2.
    """
    if not ior > 0:
        raise ShotError(f"ior must be above 0, got {ior:g}; glass is 1.5")
    c = np.clip(np.abs(np.asarray(cosine, dtype=np.float64)), 0, 1)
    t2 = 1 - (1 - c * c) / ior**2
    t = np.sqrt(np.maximum(t2, 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        r_s, r_p = (c - ior * t) / (c + ior * t), (ior * c - t) / (ior * c + t)
    return np.where(t2 < 0, 1.0, np.nan_to_num((r_s**2 + r_p**2) / 2, nan=0.0))  # 0 / 0 where nothing differs and the ray grazes


def refracted(N: npt.ArrayLike, V: npt.ArrayLike, ior: float) -> Float64:
    """(..., 3) the way on of a ray that came from the eye, behind one smooth surface; NaN under total reflection.  N, V unit, V to the eye."""
    n, v = np.asarray(N, dtype=np.float64), np.asarray(V, dtype=np.float64)
    c = (n * v).sum(axis=-1, keepdims=True)
    n, c = np.where(c < 0, -n, n), np.abs(c)
    inside = 1 - (1 - c * c) / ior**2
    with np.errstate(invalid="ignore"):
        way: Float64 = (-v + c * n) / ior - np.sqrt(np.where(inside < 0, np.nan, inside)) * n
    return way
