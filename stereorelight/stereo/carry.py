"""Carrying what was painted on one frame to others: where each pixel was, by optical flow from frame to frame.

In: the left plates of neighbouring frames.  Out: `Carried`, for each pixel of the frame now the place on the frame where the
paint lies.  Places are composed and the paint is looked up once, so that it stays as sharp as it was painted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8

AGREES_PX = 1.0  # flow there and back
LEAST_SHARE = 0.2  # of agreeing pixels below which nothing was carried: a cut
LEAST_ALIKE = 0.5  # correlation of the pictures, finely, where flow agrees: below it they show different things
FINE_PX = 9
OUTLINE_PX, PLAIN = 8, 0.07  # how far an outline may be drawn, and the contrast (of white 1) that is an edge


@dataclass(frozen=True, kw_only=True, eq=False)
class Carried:
    """places : (H, W, 2), x and y on the painted frame; points (n, 2): where the painted points lie now."""

    places: Float32
    points: Float32


def _grid(shape: tuple[int, ...]) -> Float32:
    return np.stack(np.meshgrid(np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32)), axis=-1)


def nothing_carried(shape: tuple[int, int], points: Float32) -> Carried:
    """The painted frame itself."""
    return Carried(places=_grid(shape), points=np.asarray(points, dtype=np.float32).reshape(-1, 2))


def flow_picture(plate: Float32, white: float) -> UInt8:
    """A scene-linear plate as flow wants it: grey, coded by its square root."""
    grey = np.nan_to_num(plate).mean(axis=-1) / np.float32(white)
    return np.rint(255 * np.sqrt(np.clip(grey, 0, 1))).astype(np.uint8)


def white_of(plate: Float32) -> float:
    """What counts as white in `plate`."""
    light = plate[np.isfinite(plate).all(axis=-1)].mean(axis=-1)
    return max(1.25 * float(np.quantile(light, 0.99)), 1e-6) if light.size else 1.0


def _look_up(values: Float32, at: Float32) -> Float32:
    return cv2.remap(values, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _from_nearest(values: Float32, good: Bool) -> Float32:
    """`values` of the nearest good pixel."""
    if good.all():
        return values
    _, labels = cv2.distanceTransformWithLabels((~good).view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    number = np.zeros(int(labels.max()) + 1, np.intp)
    number[labels[good]] = np.flatnonzero(good)
    return values.reshape(-1, values.shape[-1])[number[labels]]


def _alike(then: UInt8, now: UInt8, places: Float32, good: Bool) -> float:
    """Correlation of what is finer than a few pixels, between the frame now and the one before brought onto it."""
    a, b = now.astype(np.float32), _look_up(then.astype(np.float32), places)
    fine_a, fine_b = (p - cv2.blur(p, (FINE_PX, FINE_PX)) for p in (a, b))
    fine_a, fine_b = fine_a[good], fine_b[good]
    power = float(np.sqrt((fine_a**2).mean() * (fine_b**2).mean()))
    return float((fine_a * fine_b).mean()) / power if power > 0.25 else 1.0


def carry(before: Carried, then: UInt8, now: UInt8) -> Carried | None:
    """One frame on, or back: what is known of frame `then`, for frame `now`.  None where the two share nothing: a cut."""
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    back, there = dis.calc(now, then, None), dis.calc(then, now, None)
    grid = _grid(now.shape)
    good = np.linalg.norm(back + _look_up(there, grid + back), axis=-1) <= AGREES_PX
    if good.mean() < LEAST_SHARE or _alike(then, now, grid + back, good) < LEAST_ALIKE:
        return None
    # Where flow does not agree (ground that opens up), the nearest ground that does moves along.
    back = _from_nearest(back, good)
    places = _look_up(before.places, grid + back)
    points = before.points
    if len(points):
        moved = _look_up(there, np.ascontiguousarray(points[None]))[0]
        points = (points + moved).astype(np.float32)
    return Carried(places=places, points=points)


def polygon_matte(corners: Sequence[Sequence[float]], size_hw: tuple[int, int]) -> Float32:
    """(H, W) 0 or 1 from corners (x, y) in pixels; (0, 0) is the centre of the first pixel, as everywhere."""
    mask: UInt8 = np.zeros(size_hw, np.uint8)
    cv2.fillPoly(mask, [np.rint(np.array(corners) * 16).astype(np.int32)], 1, shift=4)  # in sixteenths of a pixel
    return mask.astype(np.float32)


def carried_matte(matte: Float32, carried: Carried, now: UInt8) -> Float32:
    """A painted matte (H, W) on the frame `now`, its outline drawn to the picture's own edge where there is one (guided
    filter, He et al. 2010): flow is off by a pixel or two at outlines, frame after frame."""
    moved = _look_up(np.ascontiguousarray(matte, dtype=np.float32), carried.places)
    return np.clip(cv2.ximgproc.guidedFilter(now.astype(np.float32) / 255, moved, OUTLINE_PX, PLAIN**2), 0, 1)
