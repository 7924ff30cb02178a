"""Environments made by formula, for tests, pictures and trying things out: lat-long (H, 2H, 3) float32, scene-linear, y up.

No photograph is needed to see what a material does.  Directions as in light/environment_maps.py: -z is the middle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64
from stereorelight.light.environment_maps import directions


def _lamp(d: Float64, towards: Sequence[float], half_deg: tuple[float, float], soft_deg: float) -> Float64:
    """A soft-edged rectangle of light (1 inside), as wide and high as the angles say, seen in the direction `towards`."""
    ahead = np.array(towards) / np.linalg.norm(towards)
    right = np.cross(ahead, (0.0, 1.0, 0.0) if abs(ahead[1]) < 0.99 else (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    forward = d @ ahead
    lamp = (forward > 0).astype(np.float64)
    for axis, half in ((right, half_deg[0]), (up, half_deg[1])):
        off = np.degrees(np.arctan2(np.abs(d @ axis), np.maximum(forward, 1e-9)))
        t = np.clip((half + soft_deg - off) / soft_deg, 0, 1)
        lamp = lamp * (t * t * (3 - 2 * t))
    return lamp


def studio(height: int = 256) -> Float32:
    """A dark grey room with a warm key box at the left, a cool one at the right, a strip above, and a lit floor."""
    d = directions(height)
    y = d[..., 1:2]
    light = 0.035 + 0.03 * np.clip(y, 0, 1) + np.where(y < 0, 0.10 * np.clip(-y, 0, 1) ** 0.5 * (1.0, 0.92, 0.84), 0.0)
    lines = 0.5 + 0.5 * np.cos(np.arctan2(d[..., 0], -d[..., 2]) * 24)
    light = light + 0.05 * (lines**24)[..., None] * np.clip(1 - np.abs(y) * 1.4, 0, 1)  # posts along the wall
    light = light + 9.0 * _lamp(d, (-1, 0.55, 0.75), (17, 24), 2)[..., None] * (1.0, 0.90, 0.76)
    light = light + 4.0 * _lamp(d, (1, 0.25, 0.2), (9, 30), 2)[..., None] * (0.72, 0.86, 1.0)
    light = light + 6.0 * _lamp(d, (-0.1, 1, -0.45), (30, 6), 2)[..., None]
    return np.ascontiguousarray(light, dtype=np.float32)


def sky(height: int = 256, *, sun: Sequence[float] = (0.5, 0.6, 0.6), sun_deg: float = 3.0, strength: float = 600.0) -> Float32:
    """A clear sky over brown ground, with a sun of `sun_deg` across in the direction `sun`."""
    d = directions(height)
    y = d[..., 1:2]
    to_sun = d @ (np.array(sun) / np.linalg.norm(sun))
    up = np.clip(y, 0, 1)
    blue = (1 - up**0.45) * (0.95, 0.93, 0.88) + up**0.45 * (0.16, 0.32, 0.72)
    glow = np.clip(to_sun, 0, 1)[..., None] ** 40 * (1.2, 1.0, 0.7)
    ground = (0.16, 0.12, 0.085) * (0.6 + 0.4 * np.clip(1 + 4 * y, 0, 1))
    edge = np.clip(y * height / 4 + 0.5, 0, 1)  # the horizon over a few pixels
    light = ground * (1 - edge) + (blue + glow) * edge
    off = np.degrees(np.arccos(np.clip(to_sun, -1, 1)))
    light = light + strength * np.clip((sun_deg / 2 - off) * height / 180 + 0.5, 0, 1)[..., None] * (1.0, 0.93, 0.82)
    return np.ascontiguousarray(light, dtype=np.float32)


def gradient(height: int, *, mean: npt.ArrayLike = (1.0, 1.0, 1.0), slope: npt.ArrayLike = (0.0, 0.5, 0.0)) -> Float32:
    """mean + slope . d, whose irradiance / pi is mean + 2/3 slope . N exactly."""
    light = np.asarray(mean, dtype=np.float64) + (directions(height) @ np.asarray(slope, dtype=np.float64))[..., None]
    return np.ascontiguousarray(light, dtype=np.float32)
