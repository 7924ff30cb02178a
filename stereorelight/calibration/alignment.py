"""How two raw plates lie against each other, without a rig: vertical shift, roll, zoom, and which way round each picture is.

In: upright scene-linear plates, or `Matches`.  Out: an `Alignment` and a `Handedness`.
Pixels and degrees, about the middle of the picture; right against left.  Roll is said of the picture: > 0 where the right
picture is turned clockwise (the eye itself then rolled the other way)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.calibration.drift import GAIN_PX, LEAST_MATCHES, VerticalError, _cells, error_of
from stereorelight.calibration.features import SIGMA_FLOOR_PX, Matches, match_points
from stereorelight.calibration.robust import Fit, fitted
from stereorelight.camera import Rig
from stereorelight.errors import PlateError

# One sigma before anything is seen: shift (share of the height), roll (rad), zoom, and keystone, bow (rad, by picture widths) and the
# rows' share in disparity, which only a converged, pitched or tilted rig has.
PRIOR_SIGMA = np.array([0.05, 0.05, 0.05, 0.1, 0.02, 0.02])
LOOK_SIDE_PX = 960  # which way round a picture is shows on a small one


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment:
    """Right picture against left, about the middle.

    vertical_px   : > 0 where the right picture's content lies lower, at the middle of the frame.
    roll_deg      : > 0 where the right picture is turned clockwise.
    zoom          : size of the right picture over that of the left.
    keystone_px   : rows' difference in the corners through convergence (x y), largest in the frame.
    *_sigma       : one standard deviation.
    before, after : |dy| as the plates lie, and with all of this taken out.
    """

    vertical_px: float
    roll_deg: float
    zoom: float
    keystone_px: float
    vertical_sigma: float
    roll_sigma: float
    zoom_sigma: float
    matches: int
    before: VerticalError
    after: VerticalError


def relative_alignment(matches: Matches, *, least: int = LEAST_MATCHES) -> Alignment:
    """Shift, roll and zoom of the right plate against the left one, from rows alone, by robust least squares.

    y_right - y_left = shift + roll x + zoom y + keystone x y + bow y^2 + share (disparity - its median), with x, y those of the
    right plate from the middle.  Small angles: good to a hundredth of themselves up to 2 degrees and 2 %.
    Raises : PlateError under `least` matches.
    """
    if len(matches) < least:
        raise PlateError(
            f"only {len(matches)} matches between the eyes, and comparing their rows needs {least}; "
            "take a frame with more texture and light, and check that both plates show the scene"
        )
    w, h = matches.size
    x, y = ((matches.right - ((w - 1) / 2, (h - 1) / 2)) / w).T
    disparity = matches.left[:, 0] - matches.right[:, 0]
    columns = np.stack([np.full(len(x), float(h)), w * x, w * y, w * x * y, w * y * y, disparity - np.median(disparity)], axis=1)
    apart = matches.right[:, 1] - matches.left[:, 1]

    def fit_with(count: int) -> tuple[Fit, Float64]:
        fit = fitted(
            lambda values: apart - columns[:, :count] @ values,
            sigma=np.maximum(matches.sigma_px, SIGMA_FLOOR_PX),
            prior=np.zeros(count),
            prior_sigma=PRIOR_SIGMA[:count],
            cluster=_cells(matches),
        )
        return fit, apart - columns[:, :count] @ fit.values

    fit, rest = fit_with(5)
    wider, wider_rest = fit_with(6)
    # On a slanted wall disparity runs like x and y: its share is taken only where it explains what they cannot.
    if np.abs(wider_rest[fit.inlier]).mean() < np.abs(rest[fit.inlier]).mean() - GAIN_PX:
        fit, rest = wider, wider_rest
    shift, roll, zoom, keystone = fit.values[:4]
    return Alignment(
        vertical_px=float(shift * h),
        roll_deg=math.degrees(roll),
        zoom=1 + float(zoom),
        keystone_px=float(abs(keystone) * h / 4),
        vertical_sigma=float(fit.sigmas[0] * h),
        roll_sigma=math.degrees(fit.sigmas[1]),
        zoom_sigma=float(fit.sigmas[2]),
        matches=int(fit.inlier.sum()),
        before=error_of(apart, matches, fit.inlier),
        after=error_of(rest, matches, fit.inlier),
    )


@dataclass(frozen=True, kw_only=True)
class Handedness:
    """Which way round the eyes are against each other.

    as_is, mirrored : matches that agree on one geometry, as the plates are and with the right one flipped left-right; both with
                      the right one turned by 180 degrees first where it is upside down.
    upside_down     : hardly anything matches until the right plate is turned by 180 degrees.
    in_front        : with a rig: share of the matches in front of the rig after the flip; tells which eye is mirrored. NaN without.
    """

    as_is: int
    mirrored: int
    upside_down: bool
    in_front: float = math.nan


def _smaller(plate: Float32) -> Float32:
    """Every k-th pixel's block mean, no longer than LOOK_SIDE_PX."""
    step = -(-max(plate.shape[:2]) // LOOK_SIDE_PX)
    if step == 1:
        return plate
    h, w = plate.shape[0] // step * step, plate.shape[1] // step * step
    return np.ascontiguousarray(plate[:h, :w].reshape(h // step, step, w // step, step, 3).mean(axis=(1, 3)), dtype=np.float32)


def handedness(left: Float32, right: Float32, *, rig: Rig | None = None, as_is: Matches | None = None) -> Handedness:
    """Whether one eye is mirrored or upside down against the other: which pairing gives the matches.

    rig   : tells, where its eyes do not converge much, which eye is the mirrored one.
    as_is : the matches of the plates as they are, where they have been found already.
    """
    small = _smaller(left), _smaller(right)
    plain = as_is if as_is is not None else match_points(*small)
    flipped = match_points(small[0], np.ascontiguousarray(small[1][:, ::-1]))
    upside_down = False
    if max(len(plain), len(flipped)) < LEAST_MATCHES:
        turned = [match_points(small[0], np.ascontiguousarray(other)) for other in (small[1][::-1, ::-1], small[1][::-1])]
        upside_down = max(map(len, turned)) > max(LEAST_MATCHES, 4 * len(plain), 4 * len(flipped))
        if upside_down:
            plain, flipped = turned
    in_front = math.nan
    if rig is not None and not upside_down and len(flipped) > max(len(plain), LEAST_MATCHES // 2):
        scale = np.array(left.shape[1::-1]) / small[0].shape[1::-1]
        p, q = ((points + 0.5) * scale - 0.5 for points in (flipped.left, flipped.right))
        in_front = float((convergence_deg(rig, p, q) > 0).mean())
    return Handedness(as_is=len(plain), mirrored=len(flipped), upside_down=upside_down, in_front=in_front)


def convergence_deg(rig: Rig, left_px: Float64, right_px: Float64) -> Float64:
    """(n,) angle at which the two rays of each match close in on each other along the baseline; < 0 where they meet behind the rig."""
    x = rig.right_centre_m / rig.baseline_m
    a, b = rig.left.rays(left_px), rig.right.rays(right_px) @ rig.R_right_left
    angles: Float64 = np.degrees(
        np.arctan2(a @ x, np.linalg.norm(a - (a @ x)[:, None] * x, axis=1)) - np.arctan2(b @ x, np.linalg.norm(b - (b @ x)[:, None] * x, axis=1))
    )
    return angles


def behind_rig(rig: Rig, matches: Matches, *, tolerance_deg: float) -> Bool:
    """(n,) which matches lie behind the rig by more than a stale yaw of `tolerance_deg` could put them there."""
    return convergence_deg(rig, matches.left, matches.right) < -tolerance_deg
