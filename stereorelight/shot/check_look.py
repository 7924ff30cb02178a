"""One frame of a pair looked at closely: every measurement that plate health takes of it.

In: upright scene-linear plates of one moment, and of the next one where there is one.  Out: a `Look`.
A measurement that a frame does not allow (too few matches, no texture) is left out of it; the judges say so."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.calibration.alignment import behind_rig
from stereorelight.calibration.drift import VerticalError, vertical_error
from stereorelight.calibration.features import Matches, match_points
from stereorelight.camera import Rig
from stereorelight.errors import PassError, PlateError
from stereorelight.health.alignment import Strips, occlusion_votes
from stereorelight.health.blur import MotionBlur, motion_blur
from stereorelight.health.clipping import Clipping, clipping
from stereorelight.health.exposure import ExposureDifference, exposure_difference
from stereorelight.health.focus import FocusDifference, focus_difference
from stereorelight.health.grain import Grain, grain
from stereorelight.health.range import RangeMeasure, measure_range
from stereorelight.stereo.order import one_picture
from stereorelight.stereo.rectify import Rectification

LEAST_MATCHES = 60
STALE_DEG = 0.3  # a yaw by which a rig may have moved without its matches being called "behind the rig"
GREY = np.array([0.25, 0.5, 0.25], np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What was measured on one frame; None where the frame does not allow it."""

    number: int | None
    matches: Matches
    one_picture: bool = False
    vertical: VerticalError | None = None
    behind: float = float("nan")
    behind_exchanged: float = float("nan")
    range: RangeMeasure | None = None
    distances_m: Float64
    strips: Strips
    clipping: tuple[Clipping, Clipping]
    exposure: ExposureDifference | None = None
    grain: tuple[Grain | None, Grain | None] = (None, None)
    focus: FocusDifference | None = None
    blur: MotionBlur | None = None
    light: float = float("nan")
    texture: float = float("nan")


def rectified_points(rectification: Rectification, matches: Matches) -> tuple[Float64, Float64]:
    """The matches as (n, 2) pixels of the rectified left and right view."""
    rig, original = rectification.rig, rectification.original
    if rectification.identity:
        return matches.left, matches.right
    left = rig.left.project(original.left.rays(matches.left) @ np.asarray(rig.R_rectified_left).T)
    right = rig.right.project(original.right.rays(matches.right) @ np.asarray(rig.R_rectified_right).T)
    return left, right


def texture_of(plate: Float32) -> tuple[float, float]:
    """(light, texture): median grey, and the rms slope of grey along the row over the frame, grain taken out; per pixel."""
    g = plate @ GREY
    g = g[np.isfinite(g).all(axis=1)] if not np.isfinite(g).all() else g
    if g.size == 0:
        return float("nan"), float("nan")
    # Slopes over two and over four pixels carry the same grain and different texture: their difference is free of grain.
    wide = float(np.mean(np.square(g[:, 4:] - g[:, :-4])))
    near = float(np.mean(np.square(g[:, 2:] - g[:, :-2])))
    return float(np.median(g)), float(np.sqrt(max(wide - near, 0.0) / 12))


def look(
    number: int | None,
    plates: tuple[Float32, Float32],
    *,
    following: tuple[Float32, Float32] | None = None,
    rectification: Rectification | None = None,
    near_m: float | None = None,
    far_m: float | None = None,
) -> Look:
    """Measure one frame.

    plates    : upright, scene-linear (H, W, 3).     following : those of the frame after, for grain and motion.
    Raises    : PlateError for a plate without any light.
    """
    left, right = plates
    rig: Rig | None = None if rectification is None else rectification.original
    matches = match_points(left, right, rig=rig)
    p, q = (matches.left, matches.right) if len(matches) >= LEAST_MATCHES else (None, None)
    grains = tuple(_grain(plate, None if following is None else following[eye]) for eye, plate in enumerate(plates))
    exposure = focus = None
    with contextlib.suppress(PassError):
        exposure = exposure_difference(left, right, points_left=p, points_right=q)
    if exposure is None:
        with contextlib.suppress(PassError):
            exposure = exposure_difference(left, right)
    with contextlib.suppress(PassError):
        focus = focus_difference(left, right, points_left=p, points_right=q, left_grain=grains[0], right_grain=grains[1])
    blur = None
    if following is not None:
        with contextlib.suppress(PassError):
            blur = motion_blur(left, following[0])
    vertical, ranged, distances = None, None, np.empty(0)
    behind = exchanged = float("nan")
    if rig is not None and rectification is not None and len(matches):
        with contextlib.suppress(PlateError):
            vertical = vertical_error(rig, matches)
        a, b = rectified_points(rectification, matches)
        disparity = a[:, 0] - b[:, 0]
        ranged = measure_range(disparity, rectification.rig, near_m=near_m, far_m=far_m, number=number)
        distances = np.asarray(rectification.rig.depth_from_disparity(disparity.astype(np.float32)), np.float64)
        distances = distances[np.isfinite(distances) & (distances > 0)]
        turned = Matches(left=matches.right, right=matches.left, sigma_px=matches.sigma_px, size=matches.size)
        behind = float(behind_rig(rig, matches, tolerance_deg=STALE_DEG).mean())
        exchanged = float(behind_rig(rig, turned, tolerance_deg=STALE_DEG).mean()) if rig.left.size == rig.right.size else float("nan")
    light, texture = texture_of(left)
    return Look(
        number=number,
        matches=matches,
        one_picture=one_picture(left, right),
        vertical=vertical,
        strips=occlusion_votes(left, right, matches.left, matches.right),
        behind=behind,
        behind_exchanged=exchanged,
        range=ranged,
        distances_m=distances,
        clipping=(clipping(left), clipping(right)),
        exposure=exposure,
        grain=(grains[0], grains[1]),
        focus=focus,
        blur=blur,
        light=light,
        texture=texture,
    )


def _grain(plate: Float32, following: Float32 | None) -> Grain | None:
    with contextlib.suppress(PassError):
        return grain(plate, following=following)
    return None
