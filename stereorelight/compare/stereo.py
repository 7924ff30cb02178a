"""Do both eyes of a relit pair tell of one world?  The right eye's picture carried to the left one's pixels, and what is left between them.

In: pictures (H, W, 3) of both eyes, linear, Z (H, W) metres of each eye, and the `Rig` (flipped-back pictures).  Out: figures, and a
`Measured`.  Matte light looks the same from both eyes; highlights and rims do not, and are to be left out of the pictures first.

A pixel of the left eye is carried by its Z into the right one, where the picture is read between the four pixels about it, of those that
lie as deep as the point itself does.  What the right eye does not see has no answer and does not count; `seen` says how much that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import Rig
from stereorelight.compare.figures import ErrorMap, Figure, Measured
from stereorelight.errors import PassError

ONE_SURFACE = 0.02  # of Z: farther off, what the right eye has there is something else
LEAST_WEIGHT = 0.5  # of the four pixels read between: fewer are the edge of something
MAP_SCALE = 0.10  # of the picture's RMS: full colour of the map


@dataclass(frozen=True, kw_only=True)
class StereoFigures:
    """What is left between the eyes, of the pixels that both see.

    seen_percent : share of the left eye's known pixels that the right eye sees.
    relative_rms_percent : RMS of left - right over the RMS of the left picture.
    median_percent, p95_percent : of |left - right| over the mean of the left picture, per pixel, mean of the channels.
    gain : what the right eye's light is of the left one's, by least squares.
    """

    pixels: int
    seen_percent: float
    relative_rms_percent: float
    median_percent: float
    p95_percent: float
    gain: float

    def figures(self, region: str) -> list[Figure]:
        """The same as figures of a row."""
        return [
            Figure(name="pixels", value=float(self.pixels), digits=0, high_is_good=True, table="both eyes", region=region),
            Figure(name="seen", value=self.seen_percent, unit="%", digits=1, high_is_good=True, table="both eyes", region=region),
            Figure(name="eyes_rms", value=self.relative_rms_percent, unit="%", digits=2, column="relative RMS", table="both eyes", region=region),
            Figure(name="eyes_median", value=self.median_percent, unit="%", digits=2, column="median", table="both eyes", region=region),
            Figure(name="eyes_p95", value=self.p95_percent, unit="%", digits=2, column="95 %", table="both eyes", region=region),
            Figure(name="eyes_gain", value=self.gain, digits=4, column="gain", table="both eyes", region=region),
        ]


def carried(right: npt.ArrayLike, Z_left: npt.ArrayLike, Z_right: npt.ArrayLike, rig: Rig) -> Float32:
    """(H, W, C) the right eye's picture on the left one's pixels; NaN where the right eye does not see the point.

    right : (h, w, C) float.   Z_left, Z_right : each eye's own Z on its own plate, metres.
    Raises: PassError for sizes that are not the cameras'.
    """
    Z = as_float32(Z_left, "Z of the left eye", size_hw=rig.left.size_hw).astype(np.float64)
    Z_there = as_float32(Z_right, "Z of the right eye", size_hw=rig.right.size_hw).astype(np.float64)
    picture = np.asarray(right, dtype=np.float32)
    if picture.ndim != 3 or picture.shape[:2] != rig.right.size_hw:
        raise PassError(f"the right eye's picture must have shape {(*rig.right.size_hw, 3)}, got {picture.shape}")
    points = rig.left.unproject(rig.left.pixel_grid(), Z) @ rig.R_right_left.T + rig.t_right_left_m
    px = rig.right.project(points)
    h, w = rig.right.size_hw
    with np.errstate(invalid="ignore"):
        inside = np.isfinite(px).all(axis=-1) & (px[..., 0] > -0.5) & (px[..., 1] > -0.5) & (px[..., 0] < w - 0.5) & (px[..., 1] < h - 0.5)
    out = np.full((*Z.shape, picture.shape[2]), np.nan, np.float32)
    u, v, deep = px[inside][:, 0], px[inside][:, 1], points[inside][:, 2]
    i, j = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    total, weight = np.zeros((len(u), picture.shape[2])), np.zeros(len(u))
    for dj in (0, 1):
        for di in (0, 1):
            column, row = np.clip(i + di, 0, w - 1), np.clip(j + dj, 0, h - 1)
            value = picture[row, column].astype(np.float64)
            share = (1 - np.abs(u - i - di)) * (1 - np.abs(v - j - dj))
            with np.errstate(invalid="ignore"):
                one = (np.abs(Z_there[row, column] - deep) < ONE_SURFACE * deep) & np.isfinite(value).all(axis=-1)
            share = np.where(one, share, 0)
            total += share[:, None] * np.where(one[:, None], value, 0)
            weight += share
    out[inside] = np.where((weight > LEAST_WEIGHT)[:, None], total / np.maximum(weight, 1e-9)[:, None], np.nan)
    return out


def _told(a: Float64, b: Float64, region: Bool) -> StereoFigures:
    both = region & np.isfinite(b).all(axis=-1)
    p, q = a[both], b[both]
    n, all_of = int(both.sum()), int(region.sum())
    nothing = float("nan")
    power, mean = (float((p * p).mean()), float(np.abs(p).mean())) if n else (0.0, 0.0)
    off = np.abs(p - q).mean(axis=-1) if n else np.empty(0)
    return StereoFigures(
        pixels=n,
        seen_percent=100 * n / all_of if all_of else nothing,
        relative_rms_percent=100 * float(((p - q) ** 2).mean() / power) ** 0.5 if power > 0 else nothing,
        median_percent=100 * float(np.median(off)) / mean if mean > 0 else nothing,
        p95_percent=100 * float(np.quantile(off, 0.95)) / mean if mean > 0 else nothing,
        gain=float((p * q).mean()) / power if power > 0 else nothing,
    )


def stereo_figures(left: npt.ArrayLike, right: npt.ArrayLike, Z_left: npt.ArrayLike, Z_right: npt.ArrayLike, rig: Rig) -> StereoFigures:
    """What is left between two eyes' pictures of one world; see the module.

    left, right : (H, W, 3) of each eye, NaN where unknown, highlights left out.   Z_left, Z_right : (H, W) of each eye.
    Raises      : PassError for sizes that do not fit, and where the eyes have no pixel in common.
    """
    a = as_float32(left, "the left eye's picture", channels=3, size_hw=rig.left.size_hw).astype(np.float64)
    found = carried(right, Z_left, Z_right, rig).astype(np.float64)
    known: Bool = np.asarray(np.isfinite(a).all(axis=-1) & np.isfinite(np.asarray(Z_left)))
    if not (known & np.isfinite(found).all(axis=-1)).any():
        raise PassError("the eyes have no pixel in common: are the depths of each eye's own plate, and is the rig theirs?")
    return _told(a, found, known)


def stereo_measured(
    left: npt.ArrayLike,
    right: npt.ArrayLike,
    Z_left: npt.ArrayLike,
    Z_right: npt.ArrayLike,
    rig: Rig,
    *,
    lights: Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]] | None = None,
) -> Measured:
    """All that can be said of a relit pair: the picture, and every light by itself.

    lights : by name, (left, right) matte layers (H, W, 3).   The rest as in `stereo_figures`.
    """
    figures: list[Figure] = []
    maps: list[ErrorMap] = []
    stereo_figures(left, right, Z_left, Z_right, rig)  # that they have something in common
    for name, (a, b) in {"picture": (left, right), **(lights or {})}.items():
        mine = as_float32(a, f"{name} of the left eye", channels=3, size_hw=rig.left.size_hw).astype(np.float64)
        theirs = carried(b, Z_left, Z_right, rig).astype(np.float64)
        known: Bool = np.asarray(np.isfinite(mine).all(axis=-1) & np.isfinite(np.asarray(Z_left)))
        told = _told(mine, theirs, known)
        figures += told.figures("all" if name == "picture" else name)
        rms = float(np.sqrt(np.nanmean(mine[known] ** 2))) if known.any() else 0.0
        if rms > 0:
            error = (theirs - mine).mean(axis=-1).astype(np.float32)
            maps.append(ErrorMap(title=f"{name}: right eye less left", error=error, known=known, scale=MAP_SCALE * rms, unit="linear"))
    return Measured(what="stereo", figures=tuple(figures), maps=tuple(maps))
