"""Where a point of the picture is in space, for lights that go with it.

In: P (H, W, 3), the scene frame of the camera, metres, and where the point lies on the picture of this frame, pixels.
Out: its place, from the surface round about it, so that one pixel's noise does not shake the light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64, as_float32
from stereorelight.errors import ShotError
from stereorelight.light.animate import Stuck
from stereorelight.light.checks import Vector

REACH_PX = 4  # of the window about the point
SAME_SURFACE = 0.03  # share of its distance within which a neighbour belongs to the same thing
LEAST_KNOWN = 5  # pixels of the window that must be known


def point_in_space(P: npt.ArrayLike, pixel: tuple[float, float], *, reach_px: int = REACH_PX) -> Float64:
    """(3,) place of `pixel`: on its own ray, at the middle distance of what is about it on the same surface.

    Raises : ShotError where the pixel is outside the picture or nothing about it is known.
    """
    places = as_float32(P, "P", channels=3)
    h, w = places.shape[:2]
    x, y = pixel
    if not (-0.5 <= x <= w - 0.5 and -0.5 <= y <= h - 0.5):
        raise ShotError(f"the point ({x:.1f}, {y:.1f}) has left the picture, which is {w} x {h} pixels")
    j, i = min(max(round(x), 0), w - 1), min(max(round(y), 0), h - 1)
    near = (slice(max(i - reach_px, 0), i + reach_px + 1), slice(max(j - reach_px, 0), j + reach_px + 1))
    window = places[near].reshape(-1, 3).astype(np.float64)
    rows, columns = np.mgrid[near]
    away = np.hypot(rows.ravel() - y, columns.ravel() - x)
    known = np.isfinite(window).all(axis=-1) & (away <= reach_px + 0.5)
    if int(known.sum()) < LEAST_KNOWN:
        raise ShotError(f"nothing is known of the depth about the point ({x:.1f}, {y:.1f})")
    window, away = window[known], away[known]
    Z = -window[:, 2]
    # What the point itself lies on is told by the nearest pixels; an edge through the window must not draw it away.
    seed = float(np.median(Z[np.argsort(away, kind="stable")[:LEAST_KNOWN]]))
    same = np.abs(Z - seed) <= SAME_SURFACE * seed
    # x/z and y/z are affine in the pixel nearly enough over a few pixels, lens or no lens; so is 1/z on a plane.
    design = np.stack([np.ones(len(Z)), columns.ravel()[known] - x, rows.ravel()[known] - y], axis=1)[same]
    rays = window[same, :2] / Z[same, None]
    slope_x, slope_y = (float(np.linalg.lstsq(design, rays[:, k], rcond=None)[0][0]) for k in (0, 1))
    middle = float(np.median(Z[same]))
    return np.array([slope_x * middle, slope_y * middle, -middle])


def place_of(stuck: Stuck, P: npt.ArrayLike, pixel: tuple[float, float], space: str, world_from_camera: npt.ArrayLike) -> Vector:
    """Where a stuck light stands, in `space`: the point under `pixel` on this frame, and its offset along that space's axes.

    world_from_camera : (4, 4) pose of the camera on this frame.
    """
    place = point_in_space(P, pixel)
    if space == "world":
        pose = np.asarray(world_from_camera, dtype=np.float64)
        place = pose[:3, :3] @ place + pose[:3, 3]
    x, y, z = place + np.array(stuck.offset_m)
    return float(x), float(y), float(z)
