"""Colour and exposure of one eye against the other: for the whole frame, per channel, and as a map.

In: scene-linear plates (H, W, 3), NaN = unknown, and where the same surface points lie in both (points in pixels of each plate,
or the disparity of a rectified pair).  Out: right = gain * left + offset per channel; differences in stops, log2(right / left),
so +0.2 reads "the right eye is 0.2 stops brighter".  Only matched patches are compared: what one eye alone sees, what shines
like a mirror, and what is clipped in either eye has no say.  Without matches the tones of the frames are compared instead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.errors import PassError
from stereorelight.health.clipping import clipped_mask
from stereorelight.health.picture import GREY, as_plate

PATCH_PX = 9  # a side: takes grain down nine times, and is smaller than what most disparities are constant over
MAP_CELLS = (6, 8)  # rows, columns of the map
CELL_PATCHES = 6  # patches that a cell of the map wants before it is believed
LEAST_PATCHES = 60  # as many matches as drift needs; fewer say nothing about a frame
GRID_PATCHES = 12_000  # patches looked at where a dense disparity is given
NEAR_CLIP = 0.9  # patches brighter than this share of the clip level are left out: grain clips there unseen
OFFSET_SIGMAS = 4.0  # a veil is believed when it lies so many standard errors from none ...
OFFSET_SHARE = 0.01  # ... and is at least this share of the plate's median light
QUANTILES = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class ExposureDifference:
    """right = gain * left + offset, per channel, scene-linear.

    gain_error    : one standard error of each gain, as a share of it.
    median        : median light of the left patches per channel, to hold the offset against.
    local_stops   : (rows, columns, 3) float32, log2(right / left) of each cell after gain and offset; NaN where too few patches lie.
    shading_stops : from end to end of a smooth (quadratic) field through the grey patches; NaN without matches.
    shading_error : its standard error.
    patches       : patch pairs that had a say;  method: "matches", or "tones" where no matches were given.
    """

    gain: tuple[float, float, float]
    offset: tuple[float, float, float]
    gain_error: tuple[float, float, float]
    median: tuple[float, float, float]
    local_stops: Float32
    shading_stops: float
    shading_error: float
    patches: int
    method: Literal["matches", "tones"]

    @property
    def stops(self) -> float:
        """log2 of the gain of green, the channel that white balance leaves alone: the exposure difference."""
        return float(np.log2(self.gain[1]))

    @property
    def cast(self) -> tuple[float, float, float]:
        """Each channel's gain over that of green, minus 1: +0.06 in red is a 6 % red cast of the right eye."""
        return (self.gain[0] / self.gain[1] - 1, 0.0, self.gain[2] / self.gain[1] - 1)


def _patches(plate: Float32, points: Float64, side: int) -> tuple[Float64, Bool]:
    """(n, 3) means of patches about `points` (n, 2), and which are whole: known, inside, and well under the clip level."""
    import cv2

    clipped, levels = clipped_mask(plate)
    good = np.isfinite(plate).all(axis=2) & ~clipped
    clean = np.where(good[..., None], plate, np.float32(0))
    blur = cv2.blur(clean, (side, side), borderType=cv2.BORDER_REPLICATE)
    whole = cv2.blur(good.astype(np.float32), (side, side), borderType=cv2.BORDER_CONSTANT)
    at = points.astype(np.float32).reshape(-1, 1, 2)
    means: list[Float32] = []
    wholes: list[Float32] = []
    for first in range(0, len(at), 30_000):  # cv2.remap takes 32767 rows at most
        part = at[first : first + 30_000]
        means.append(cv2.remap(blur, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0])
        wholes.append(cv2.remap(whole, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)[:, 0])
    value = np.concatenate(means).astype(np.float64)
    usable = np.concatenate(wholes) > 0.999
    for c, level in enumerate(levels):
        if np.isfinite(level):
            usable &= value[:, c] < NEAR_CLIP * level
    return value, usable & (value > 0).all(axis=1)


def _grid_points(disparity: Float32, side: int) -> tuple[Float64, Float64]:
    """Points of an even grid where `disparity` (H, W) is known and nearly constant over a patch, in left and right pixels."""
    import cv2

    filled = np.where(np.isfinite(disparity), disparity, np.float32(1e6))
    box = np.ones((side, side), np.uint8)
    flat = (cv2.dilate(filled, box) - cv2.erode(filled, box) < 1.0) & (filled < 1e5)
    step = max(2, int(np.sqrt(disparity.size / GRID_PATCHES)))
    keep = np.zeros_like(flat)
    keep[step // 2 :: step, step // 2 :: step] = True
    y, x = np.nonzero(flat & keep)
    left = np.stack([x, y], axis=1).astype(np.float64)
    right = left.copy()
    right[:, 0] -= disparity[y, x]
    return left, right


def _line(x: Float64, y: Float64) -> tuple[float, float, float, float]:
    """(gain, offset, standard error of gain, of offset) of y = gain x + offset, robustly, for errors that grow with the light.

    Tukey's weights about a start from the median ratio.  Errors stand on both axes alike, so x is replaced by the light both
    agree on (x + y / g) / 2 in the weights: a patch is never kept or dropped for being dark in one eye only.
    """
    floor = 0.05 * float(np.median(x))
    ratio = float(np.exp(np.median(np.log(y / x))))
    gain, offset = ratio, 0.0
    gain_variance = offset_variance = float("inf")
    for _ in range(25):
        light = np.maximum((x + np.maximum(y - offset, 0) / gain) / 2, 0) + floor
        residual = (y - gain * x - offset) / (gain * light)
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-6)
        u = residual / (4.685 * spread)
        weight = np.where(np.abs(u) < 1, (1 - u * u) ** 2, 0) / light**2
        sw, sx, sy = weight.sum(), (weight * x).sum(), (weight * y).sum()
        sxx, sxy = (weight * x * x).sum(), (weight * x * y).sum()
        determinant = sw * sxx - sx * sx
        if not determinant > 1e-12 * sw * sxx:  # one tone only: no offset can be told from a gain
            return ratio, 0.0, spread / np.sqrt(len(x)), np.inf
        new = (sw * sxy - sx * sy) / determinant, (sxx * sy - sx * sxy) / determinant
        still = abs(new[0] - gain) < 1e-6 * gain
        gain, offset = max(new[0], 1e-6), new[1]
        gain_variance, offset_variance = (float(v / determinant) * (gain * spread) ** 2 for v in (sw, sxx))
        if still:
            break
    return float(gain), float(offset), float(np.sqrt(gain_variance)), float(np.sqrt(offset_variance))


def _ratio(x: Float64, y: Float64) -> tuple[float, float]:
    """(gain, its standard error) of y = gain x: the robust centre of log(y / x), brighter patches weighing more."""
    log = np.log(y / x)
    trust = x / (x + float(np.median(x)))
    centre = float(np.median(log))
    for _ in range(25):
        spread = max(1.4826 * float(np.median(np.abs(log - centre))), 1e-7)
        u = (log - centre) / (4.685 * spread)
        weight = trust * np.where(np.abs(u) < 1, (1 - u * u) ** 2, 0)
        new = float((weight * log).sum() / weight.sum())
        if abs(new - centre) < 1e-8:
            break
        centre = new
    return float(np.exp(centre)), float(spread / np.sqrt(weight.sum() / trust.mean()) * np.exp(centre))


def _gain_offset(x: Float64, y: Float64) -> tuple[float, float, float]:
    """(gain, offset, error of gain as a share): an offset only where it is sure, since a needless one loosens the gain."""
    gain, offset, error, offset_error = _line(x, y)
    if abs(offset) > OFFSET_SIGMAS * offset_error and abs(offset) > OFFSET_SHARE * float(np.median(x)):
        return gain, offset, error / gain
    gain, error = _ratio(x, y)
    return gain, 0.0, error / gain


def _terms(at: Float64) -> Float64:
    """(n, 6) quadratic terms of positions (n, 2) in -1..1."""
    x, y = at[:, 0], at[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _field(at: Float64, log: Float64, known_cells: Float64) -> tuple[float, float]:
    """(span, its standard error) of the robust quadratic through `log` (n,) at `at`, over `known_cells` (m, 2)."""
    terms = _terms(at)
    weight: Float64 = np.ones(len(log))
    fit: Float64 = np.zeros(6)
    spread = 0.0
    for _ in range(12):
        normal = (terms * weight[:, None]).T @ terms + 1e-9 * np.eye(6)
        fit = np.asarray(np.linalg.solve(normal, terms.T @ (weight * log)), dtype=np.float64)
        residual = log - terms @ fit
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-7)
        u = residual / (4.685 * spread)
        weight = np.asarray(np.where(np.abs(u) < 1, (1 - u * u) ** 2, 0), dtype=np.float64)
    over = _terms(known_cells)
    value = over @ fit
    ends = over[int(np.argmax(value))] - over[int(np.argmin(value))]
    normal = (terms * weight[:, None]).T @ terms + 1e-9 * np.eye(6)
    error = spread * float(np.sqrt(max(ends @ np.linalg.solve(normal, ends), 0.0)))
    return float(value.max() - value.min()), error


def _from_tones(left: Float32, right: Float32) -> ExposureDifference:
    """Quantiles of each channel against each other; clipped tops are cut off from both by the same share."""
    import cv2

    gains, errors, medians = [], [], []
    samples = []
    for plate in (left, right):
        clipped, _ = clipped_mask(plate)
        good: Float32 = np.asarray(np.isfinite(plate).all(axis=2), dtype=np.float32)
        size = (max(plate.shape[1] // 4, 8), max(plate.shape[0] // 4, 8))
        share: Float32 = cv2.resize(good, size, interpolation=cv2.INTER_AREA)
        mean: Float32 = cv2.resize(np.where(good[..., None] > 0, plate, np.float32(0)), size, interpolation=cv2.INTER_AREA)
        samples.append((mean[share > 0.99], float((clipped & (good > 0)).sum() / max(good.sum(), 1))))
    (mine, my_clip), (theirs, their_clip) = samples
    if min(len(mine), len(theirs)) < LEAST_PATCHES:
        raise PassError(f"too few known pixels to compare tones: {len(mine)} and {len(theirs)} blocks of 4 x 4, want {LEAST_PATCHES}")
    top = min(0.97, 1 - 1.5 * max(my_clip, their_clip) - 0.02)
    if top < 0.3:
        raise PassError(f"{max(my_clip, their_clip):.0%} of a plate is clipped: exposure cannot be compared; check the plates' colour space")
    at = np.linspace(0.05, top, QUANTILES)
    for c in range(3):
        x, y = (np.quantile(tones[:, c].astype(np.float64), at) for tones in (mine, theirs))
        fine = (x > 0) & (y > 0)
        if fine.sum() < QUANTILES // 4:
            raise PassError("a plate is black nearly everywhere; exposure cannot be compared")
        gain, error = _ratio(x[fine], y[fine])  # no offset: parallax alone would make one up
        error /= gain
        gains.append(gain)
        errors.append(max(error, 0.02))  # parallax shows each eye something the other lacks: tones are never surer than this
        medians.append(float(np.median(x[fine])))
    return ExposureDifference(
        gain=(gains[0], gains[1], gains[2]),
        offset=(0.0, 0.0, 0.0),
        gain_error=(errors[0], errors[1], errors[2]),
        median=(medians[0], medians[1], medians[2]),
        local_stops=np.full((*MAP_CELLS, 3), np.nan, np.float32),
        shading_stops=float("nan"),
        shading_error=float("nan"),
        patches=len(mine),
        method="tones",
    )


def exposure_difference(
    left: Float32,
    right: Float32,
    *,
    points_left: Float64 | None = None,
    points_right: Float64 | None = None,
    disparity: Float32 | None = None,
    patch_px: int = PATCH_PX,
) -> ExposureDifference:
    """How the right plate differs from the left in light and colour.

    left, right  : (H, W, 3) scene-linear.
    points_left, points_right : (n, 2) pixels (x, y) of the same surface points; or
    disparity    : (H, W) px of a rectified pair on the left plate, NaN where unmatched or occluded.
    Neither      : tones are compared; good to a few per cent, and no map.
    Raises       : PassError where fewer than 60 whole, unclipped patches are left.
    """
    left, right = as_plate(left, "left plate"), as_plate(right, "right plate")
    if disparity is not None:
        d = as_float32(disparity, "disparity", size_hw=(left.shape[0], left.shape[1]))
        at_left, at_right = _grid_points(d, patch_px)
    elif points_left is not None and points_right is not None:
        at_left, at_right = np.asarray(points_left, np.float64), np.asarray(points_right, np.float64)
        if at_left.shape != at_right.shape or at_left.ndim != 2 or at_left.shape[1] != 2:
            raise PassError(f"points_left and points_right must both have shape (n, 2), got {at_left.shape} and {at_right.shape}")
    else:
        return _from_tones(left, right)
    x, usable = _patches(left, at_left, patch_px)
    y, usable_right = _patches(right, at_right, patch_px)
    usable &= usable_right
    if usable.sum() < LEAST_PATCHES:
        raise PassError(f"only {int(usable.sum())} unclipped matched patches to compare exposure by, want {LEAST_PATCHES}; leave the matches out")
    x, y, at_left = x[usable], y[usable], at_left[usable]
    fits = [_gain_offset(x[:, c], y[:, c]) for c in range(3)]
    gain, offset = np.array([f[0] for f in fits]), np.array([f[1] for f in fits])
    log = np.log2(np.maximum((y - offset) / gain, 1e-9) / x)
    height, width = left.shape[:2]
    rows, columns = MAP_CELLS
    row = np.clip((at_left[:, 1] + 0.5) / height * rows, 0, rows - 1).astype(int)
    column = np.clip((at_left[:, 0] + 0.5) / width * columns, 0, columns - 1).astype(int)
    local = np.full((rows, columns, 3), np.nan, np.float32)
    centres = []
    for r, c in set(zip(row.tolist(), column.tolist())):
        here = (row == r) & (column == c)
        if here.sum() >= CELL_PATCHES:
            local[r, c] = np.median(log[here], axis=0)
            centres.append([(2 * c + 1) / columns - 1, (2 * r + 1) / rows - 1])
    span, error = float("nan"), float("nan")
    if len(centres) >= 12:  # twice the terms of the field
        at = np.stack([2 * (at_left[:, 0] + 0.5) / width - 1, 2 * (at_left[:, 1] + 0.5) / height - 1], axis=1)
        span, error = _field(at, log @ np.array(GREY), np.array(centres))
    median = np.median(x, axis=0)
    return ExposureDifference(
        gain=(fits[0][0], fits[1][0], fits[2][0]),
        offset=(fits[0][1], fits[1][1], fits[2][1]),
        gain_error=(fits[0][2], fits[1][2], fits[2][2]),
        median=(float(median[0]), float(median[1]), float(median[2])),
        local_stops=local,
        shading_stops=span,
        shading_error=error,
        patches=int(usable.sum()),
        method="matches",
    )
