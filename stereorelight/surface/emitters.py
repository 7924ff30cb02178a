"""What casts shadows: the shape of a light, and nothing else of it.

Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.errors import ShotError

Vector = tuple[float, float, float]
Shape = Literal["place", "direction", "ball", "rectangle"]
GOLDEN = (0.7548776662466927, 0.5698402909980532)  # of the plane: steps that spread any number of points evenly (Roberts 2018)


@dataclass(frozen=True, kw_only=True)
class Emitter:
    """Where light comes from.

    shape       : "place" and "ball" by `position_m`; "direction" by `towards`; "rectangle" by both, `towards` its shining side.
    position_m  : of its centre.      towards : unit vector: to a light far away, or out of a rectangle's front.
    radius_m    : of a ball; 0 is a place.
    angle_deg   : full angle under which a light far away is seen; the sun's is 0.53.
    side_u_m, side_v_m : half of a rectangle's width and height, as vectors.
    """

    name: str
    shape: Shape
    position_m: Vector = (0.0, 0.0, 0.0)
    towards: Vector = (0.0, 0.0, 1.0)
    radius_m: float = 0.0
    angle_deg: float = 0.0
    side_u_m: Vector = (0.0, 0.0, 0.0)
    side_v_m: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for key, value in (("radius_m", self.radius_m), ("angle_deg", self.angle_deg)):
            if not (math.isfinite(value) and value >= 0):
                raise ShotError(f"light {self.name!r}: {key} must be a number, at least 0, got {value!r}")
        if self.angle_deg >= 180:
            raise ShotError(f"light {self.name!r}: angle_deg must stay below 180, got {self.angle_deg:g}")

    @property
    def is_hard(self) -> bool:
        """Whether it has no size, and so casts no soft edge."""
        if self.shape == "direction":
            return self.angle_deg == 0
        return self.shape == "place" or (self.shape == "ball" and self.radius_m == 0)


def spread(count: int) -> Float64:
    """(count, 2) points spread over the unit square, always the same."""
    points: Float64 = (0.5 + np.arange(1, count + 1)[:, None] * np.array(GOLDEN)) % 1.0
    return points


def on_disc(square: Float64) -> Float64:
    """Points (..., 2) of the unit square on the unit disc, evenly: Shirley and Chiu's concentric map."""
    a, b = 2 * square[..., 0] - 1, 2 * square[..., 1] - 1
    wide = np.abs(a) > np.abs(b)
    r = np.where(wide, a, b)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.where(wide, np.pi / 4 * np.nan_to_num(b / a), np.pi / 2 - np.pi / 4 * np.nan_to_num(a / b))
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)


def across(way: Float64) -> tuple[Float64, Float64]:
    """Two unit vectors (..., 3) at right angles to unit vectors `way` and to each other (Duff et al. 2017)."""
    x, y, z = way[..., 0], way[..., 1], way[..., 2]
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    u = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    v = np.stack([b, sign + y * y * a, -y], axis=-1)
    return u, v


def towards_light(emitter: Emitter, P: Float64, square: Float64) -> tuple[Float64, Float64]:
    """(directions (n, 3) unit, distances (n,)) from points P (n, 3) to the place on the light that `square` (n, 2) picks; inf far away.

    A ball is sampled over the disc that is seen of it; a point inside it sees its centre."""
    if emitter.shape == "direction":
        centre = np.broadcast_to(np.array(emitter.towards), P.shape)
        if emitter.angle_deg > 0:
            u, v = across(np.array(emitter.towards))
            disc = on_disc(square) * math.tan(math.radians(emitter.angle_deg) / 2)
            centre = centre + disc[:, :1] * u + disc[:, 1:] * v
            centre = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
        return centre, np.full(len(P), np.inf)
    target = np.broadcast_to(np.array(emitter.position_m), P.shape)
    if emitter.shape == "rectangle":
        s = 2 * square - 1
        target = target + s[:, :1] * np.array(emitter.side_u_m) + s[:, 1:] * np.array(emitter.side_v_m)
    elif emitter.radius_m > 0:
        way = target - P
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            sine = np.where(distance > emitter.radius_m, emitter.radius_m / distance, 0.0)
            way = np.where(distance > 0, way / distance, np.array([0.0, 0.0, 1.0]))
        u, v = across(way)
        # The disc where the tangents touch: it stands nearer than the centre, and is a little smaller than the ball.
        disc = on_disc(square) * (emitter.radius_m * np.sqrt(1 - sine**2)) * (sine > 0)
        target = target - way * (emitter.radius_m * sine) + disc[:, :1] * u + disc[:, 1:] * v
    way = target - P
    distance = np.linalg.norm(way, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(distance[:, None] > 1e-9, way / distance[:, None], np.array([0.0, 0.0, 1.0]))
    return unit, distance
