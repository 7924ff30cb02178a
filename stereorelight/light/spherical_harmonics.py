"""Light in nine numbers a channel: real spherical harmonics up to the second order, and the irradiance they give.

In: a lat-long map (H, 2H, 3).  Out: coefficients (9, 3), or light at directions.  Frame: that of the map (y up).
Source: Ramamoorthi and Hanrahan 2001; a Lambert surface keeps the bands 0, 1, 2 with the weights 1, 2/3, 1/4 (as radiance)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.light.environment_maps import directions, solid_angles

LAMBERT = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 0.25, 0.25, 0.25, 0.25, 0.25])
TERMS = 9
FINE = 128


def basis(d: npt.ArrayLike) -> Float64:
    """(..., 9) orthonormal: 1, y, z, x, xy, yz, 3 z^2 - 1, xz, x^2 - y^2, each with its factor; d (..., 3) unit."""
    x, y, z = np.moveaxis(np.asarray(d, dtype=np.float64), -1, 0)
    a, b, c = 0.5 / np.sqrt(np.pi), np.sqrt(0.75 / np.pi), np.sqrt(3.75 / np.pi)
    even = [c * x * y, c * y * z, c / np.sqrt(12) * (3 * z * z - 1), c * x * z, c / 2 * (x * x - y * y)]
    return np.stack([np.full_like(x, a), b * y, b * z, b * x, *even], axis=-1)


def coefficients(latlong: npt.ArrayLike) -> Float64:
    """(9, 3) coefficients of the light of a lat-long map, by its pixels' solid angles."""
    light = np.asarray(latlong, dtype=np.float64)
    if light.shape[0] < FINE:  # the basis changes across a large pixel
        times = -(-FINE // light.shape[0])
        light = np.repeat(np.repeat(light, times, axis=0), times, axis=1)
    found = np.zeros((TERMS, light.shape[2]))
    weights = solid_angles(light.shape[0])
    d = directions(light.shape[0])
    for row, weight in enumerate(weights):  # row by row: the basis of a whole map is nine times its size
        found += weight * basis(d[row]).T @ light[row]
    return found


def irradiance(c: npt.ArrayLike, d: npt.ArrayLike) -> Float64:
    """(..., 3) what a white Lambert card that faces d reads: irradiance / pi, to the second order."""
    light: Float64 = basis(d) @ (LAMBERT[:, None] * np.asarray(c, dtype=np.float64))
    return light


def radiance(c: npt.ArrayLike, d: npt.ArrayLike) -> Float64:
    """(..., 3) the light itself as far as nine terms tell it."""
    light: Float64 = basis(d) @ np.asarray(c, dtype=np.float64)
    return light
