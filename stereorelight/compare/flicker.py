"""Flicker: what depth and normals do from frame to frame that the scene does not.

In: Z (H, W) metres and N (H, W, 3) of frames in a row, and the motion (H, W, 2) px, (x, y), from each frame to the next, NaN where a
pixel is not found again.  Out: residuals along the motion: of Z in per cent of Z, of N in degrees.

The residual of two frames holds the scene's own change too: a face that comes nearer, a head that turns.  With the truth of both
frames that is taken off, and what is left is the change of the error alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.compare.normals import angle_deg
from stereorelight.errors import PassError

APART = 0.03  # of Z: pixels that differ by more are two surfaces, and are not mixed when one is read between pixels


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Residuals of a quantity over all pixels of all pairs of frames that are found again.

    pixels : how many those are.   cover_percent : share of them that have a value in both frames.
    median, mean, rms : of the residual's size; NaN where there is none.
    """

    pixels: int
    cover_percent: float
    median: float
    mean: float
    rms: float

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, None where there is none."""
        values = {"pixels": self.pixels, "cover_percent": self.cover_percent, "median": self.median, "mean": self.mean, "rms": self.rms}
        return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()}


@dataclass(frozen=True, kw_only=True)
class FlickerFigures:
    """pairs : of frames in a row.   Z_percent : of Z, per cent.   N_deg : of N, degrees; None where no N was given."""

    pairs: int
    Z_percent: Residuals
    N_deg: Residuals | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return {"pairs": self.pairs, "Z_percent": self.Z_percent.to_dict(), "N_deg": None if self.N_deg is None else self.N_deg.to_dict()}

    def text(self) -> str:
        """One calm line."""
        told = f"flicker over {self.pairs} pairs of frames: Z median {self.Z_percent.median:.3f} %, rms {self.Z_percent.rms:.3f}"
        normals = "" if self.N_deg is None else f"; N median {self.N_deg.median:.2f} deg, rms {self.N_deg.rms:.2f}"
        return f"{told}{normals}; cover {self.Z_percent.cover_percent:.1f} % of {self.Z_percent.pixels}"


def _corners(motion: Float32) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Float64]:
    """Rows, columns (4, n) and weights (4, n) of the pixels about where each found pixel goes; outside the frame weighs nothing."""
    h, w = motion.shape[:2]
    y, x = np.nonzero(np.isfinite(motion).all(axis=-1))
    u, v = x + motion[y, x, 0].astype(np.float64), y + motion[y, x, 1].astype(np.float64)
    i, j = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    rows, columns = np.stack([j, j, j + 1, j + 1]), np.stack([i, i + 1, i, i + 1])
    weight = (1 - np.abs(u - columns)) * (1 - np.abs(v - rows))
    weight[(rows < 0) | (rows >= h) | (columns < 0) | (columns >= w)] = 0
    return np.clip(rows, 0, h - 1), np.clip(columns, 0, w - 1), weight


def _one_surface(Z: Float32, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp], weight: Float64) -> Float64:
    """The weights (4, n), 0 where a corner is not of the surface of the heaviest known one; they sum to one, or to 0 where nothing is known."""
    values = Z[rows, columns].astype(np.float64)
    weight = np.where(np.isfinite(values), weight, 0)
    here = np.take_along_axis(values, weight.argmax(axis=0)[None], axis=0)
    with np.errstate(invalid="ignore"):
        weight = np.where(np.abs(values - here) <= APART * here, weight, 0)
    total = weight.sum(axis=0)
    return weight / np.where(total > 0, total, np.nan)


def _read(value: npt.NDArray[Any], rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp], weight: Float64) -> Float64:
    """`value` at the corners, weighed; (n,) or (n, 3)."""
    corners = value[rows, columns].astype(np.float64)
    w = weight[..., None] if corners.ndim == 3 else weight
    out: Float64 = np.where(w > 0, w * corners, np.where(np.isnan(w), np.nan, 0.0)).sum(axis=0)
    return out


def residual(
    a: tuple[Float32, Float32 | None],
    b: tuple[Float32, Float32 | None],
    motion: Float32,
    *,
    truth: tuple[tuple[Float32, Float32 | None], tuple[Float32, Float32 | None]] | None = None,
) -> tuple[Float32, Float32 | None]:
    """(H, W) residual of Z in per cent and of N in degrees between two frames (Z, N), on the first one's pixels; NaN where unknown.

    motion : (H, W, 2) px from a to b, NaN where a pixel is not found again.
    truth  : (Z, N) of both frames; its own change is then taken off.
    """
    Z = a[0]
    found = np.isfinite(motion).all(axis=-1)
    rows, columns, weight = _corners(motion)
    surface = b[0] if truth is None else truth[1][0]  # what one surface is, the truth knows best
    weight = _one_surface(surface, rows, columns, weight)
    here = Z[found].astype(np.float64)
    change = _read(b[0], rows, columns, weight) - here
    if truth is not None:
        change -= _read(truth[1][0], rows, columns, weight) - truth[0][0][found]
    Z_percent = np.full(Z.shape, np.nan, np.float32)
    Z_percent[found] = 100 * np.abs(change) / here
    if a[1] is None or b[1] is None:
        return Z_percent, None
    later, now = _read(b[1], rows, columns, weight), a[1][found].astype(np.float64)
    N_deg = np.full(Z.shape, np.nan, np.float32)
    if truth is None or truth[0][1] is None or truth[1][1] is None:
        angle = angle_deg(later, now)
        N_deg[found] = np.where(np.isfinite(later).all(axis=-1) & np.isfinite(now).all(axis=-1), angle, np.nan)
    else:
        turned = (later - _read(truth[1][1], rows, columns, weight)) - (now - truth[0][1][found])
        N_deg[found] = np.degrees(np.linalg.norm(turned, axis=-1))
    return Z_percent, N_deg


def picture_residual(a: Float32, b: Float32, motion: Float32) -> Float32:
    """(H, W) change of a scene-linear picture (H, W, 3) along the motion, per cent of its mean light, on the first frame's pixels.

    The mean over the channels of the size of the difference; NaN where a pixel is not found again or either picture is unknown.
    """
    found = np.isfinite(motion).all(axis=-1)
    rows, columns, weight = _corners(motion)
    total = weight.sum(axis=0)
    weight = weight / np.where(total > 0.5, total, np.nan)
    out = np.full(a.shape[:2], np.nan, np.float32)
    known = np.isfinite(a)
    level = float(np.abs(a[known]).mean()) if known.any() else 0.0
    if level > 0:
        out[found] = 100 * np.abs(_read(b, rows, columns, weight) - a[found]).mean(axis=-1) / level
    return out


def _figures(maps: Sequence[Float32], found: Sequence[Bool]) -> Residuals:
    all_of = np.concatenate([m[f] for m, f in zip(maps, found)]) if maps else np.empty(0, np.float32)
    told = all_of[np.isfinite(all_of)].astype(np.float64)
    nothing = float("nan")
    return Residuals(
        pixels=all_of.size,
        cover_percent=100 * told.size / all_of.size if all_of.size else nothing,
        median=float(np.median(told)) if told.size else nothing,
        mean=float(told.mean()) if told.size else nothing,
        rms=float(np.sqrt((told**2).mean())) if told.size else nothing,
    )


def flicker_figures(
    Z: Sequence[npt.ArrayLike],
    motions: Sequence[npt.ArrayLike],
    *,
    N: Sequence[npt.ArrayLike] | None = None,
    true_Z: Sequence[npt.ArrayLike] | None = None,
    true_N: Sequence[npt.ArrayLike] | None = None,
    mask: Sequence[npt.ArrayLike] | None = None,
) -> FlickerFigures:
    """The flow-warped residuals of frames in a row.

    Z, N    : of each of n frames.   motions : n - 1, from each frame to the next, NaN where a pixel is not found again.
    true_Z, true_N : the truth of each frame, whose own change is taken off.   mask : (H, W) bool of each frame, what to judge of it.
    Raises  : PassError for shapes that do not fit, or fewer than two frames.
    """
    if len(Z) < 2:
        raise PassError(f"flicker needs two frames or more, got {len(Z)}")
    for name, given, wanted in (("motions", motions, len(Z) - 1), ("N", N, len(Z)), ("true_Z", true_Z, len(Z)), ("true_N", true_N, len(Z))):
        if given is not None and len(given) != wanted:
            raise PassError(f"flicker of {len(Z)} frames needs {wanted} {name}, got {len(given)}")
    size = as_float32(Z[0], "Z").shape

    def passes(k: int, depth: Sequence[npt.ArrayLike], normals: Sequence[npt.ArrayLike] | None) -> tuple[Float32, Float32 | None]:
        return (
            as_float32(depth[k], "Z", size_hw=(size[0], size[1])),
            None if normals is None else as_float32(normals[k], "N", channels=3, size_hw=(size[0], size[1])),
        )

    Z_maps: list[Float32] = []
    N_maps: list[Float32] = []
    found: list[Bool] = []
    for k, motion in enumerate(motions):
        way = as_float32(motion, "motion", channels=2, size_hw=(size[0], size[1]))
        true = None if true_Z is None else (passes(k, true_Z, true_N), passes(k + 1, true_Z, true_N))
        Z_map, N_map = residual(passes(k, Z, N), passes(k + 1, Z, N), way, truth=true)
        judged: Bool = np.asarray(np.isfinite(way).all(axis=-1))
        found.append(judged if mask is None else judged & np.asarray(mask[k], np.bool_))
        Z_maps.append(Z_map)
        if N_map is not None:
            N_maps.append(N_map)
    return FlickerFigures(pairs=len(Z) - 1, Z_percent=_figures(Z_maps, found), N_deg=_figures(N_maps, found) if N_maps else None)
