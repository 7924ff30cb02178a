"""Disparity and depth against truth: bad pixels, averages, quantiles and cover, over named regions, in pixels, metres and per cent.

In: (H, W) float arrays, NaN where unknown.  Out: frozen figures with `.to_dict()` and `.text()`, or tallies of a frame that add up over
a shot (compare/tally.py).  Only pixels with known truth count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import RectifiedRig
from stereorelight.compare.edges import near_edges
from stereorelight.compare.figures import Figure, align, tables_of
from stereorelight.compare.normals import WINDOW_PX, NormalFigures, depth_normal_tally, disparity_normal_tally, normal_figures_of
from stereorelight.compare.tally import Groups, RegionFigures, Tally, tallied
from stereorelight.errors import PassError

BAD_PX = (0.5, 1.0, 2.0, 4.0)
BAD_M = (0.01, 0.05, 0.1)
BAD_PERCENT = (1.0, 2.0, 5.0)
JUMP_PX = 2.0  # disparity step between neighbours that makes a depth edge
JUMP_Z = 0.05  # of Z: what no surface but a grazing one does between neighbours at any sensible focal length
EDGE_BAND_PX = 4  # how far from such a step a pixel is "near an edge"
BINS_M = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
BINS_PX = (-32.0, 0.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)
DISTANCES = "_by_distance"  # what the group of bins adds to a group's name
TABLES = {"disparity": "disparity", "metres": "depth", "percent": "depth of Z", "points": "3-D point"}
PREFIXES = {"points": "point_"}


@dataclass(frozen=True, kw_only=True)
class DisparityFigures:
    """Figures by region (`all`, `nonoccluded`, `near_edges`, `flat`) and by distance, pixels; and normals of the disparity where a rig was
    given."""

    regions: Mapping[str, RegionFigures]
    normals: NormalFigures | None = None
    by_distance: Mapping[str, RegionFigures] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {name: r.to_dict() for name, r in self.regions.items()}
        if self.by_distance:
            out["by_distance"] = {name: r.to_dict() for name, r in self.by_distance.items()}
        return out | ({"normals": self.normals.to_dict()} if self.normals else {})

    def figures(self) -> list[Figure]:
        """Every figure with its table, region and name."""
        out = _rows("disparity", self.regions) + _rows(f"disparity{DISTANCES}", self.by_distance)
        return out + (self.normals.figures("normals of the disparity") if self.normals else [])

    def text(self) -> str:
        """A calm table, one region a line."""
        lines = [align(rows) for rows in tables_of(f for f in self.figures() if not f.name.startswith("normal_"))]
        return "\n\n".join(lines) + (f"\n{self.normals.text()}" if self.normals else "")


@dataclass(frozen=True, kw_only=True)
class DepthFigures:
    """Figures of Z by region: metres, per cent of the true Z, the distance of the 3-D points, and pixels of disparity where a rig was given.

    points      : metres between the points; where the rays are known.
    by_distance : the bins of true Z, for `metres` and `percent`.
    normals     : of the depth itself, where the rays are known and no rectified rig says more.
    """

    metres: Mapping[str, RegionFigures]
    percent: Mapping[str, RegionFigures]
    disparity: DisparityFigures | None = None
    points: Mapping[str, RegionFigures] = field(default_factory=dict)
    by_distance: Mapping[str, Mapping[str, RegionFigures]] = field(default_factory=dict)
    normals: NormalFigures | None = None

    def to_dict(self) -> dict[str, Any]:
        groups = {"metres": self.metres, "percent": self.percent, "points": self.points}
        out: dict[str, Any] = {name: {region: r.to_dict() for region, r in group.items()} for name, group in groups.items() if group}
        out["by_distance"] = {name: {region: r.to_dict() for region, r in group.items()} for name, group in self.by_distance.items()}
        if self.disparity:
            out["disparity"] = self.disparity.to_dict()
        return out | ({"normals": self.normals.to_dict()} if self.normals else {})

    def figures(self) -> list[Figure]:
        """Every figure with its table, region and name."""
        out = [*(self.disparity.figures() if self.disparity else []), *_rows("metres", self.metres), *_rows("percent", self.percent)]
        out += _rows("points", self.points)
        for name, group in self.by_distance.items():
            out += _rows(f"{name}{DISTANCES}", group)
        return out + (self.normals.figures("normals of the depth") if self.normals else [])

    def text(self) -> str:
        """Calm tables, one region a line."""
        lines = [align(rows) for rows in tables_of(f for f in self.figures() if not f.name.startswith("normal_"))]
        normals = self.normals or (self.disparity.normals if self.disparity else None)
        return "\n\n".join(lines) + (f"\n\n{normals.text()}" if normals else "")


def _rows(group: str, regions: Mapping[str, RegionFigures]) -> list[Figure]:
    base = group.removesuffix(DISTANCES)
    table = TABLES[base] + (" by distance" if base != group else "")
    return [f for name, r in regions.items() for f in r.figures(table, name, prefix=PREFIXES.get(base, ""))]


def _mask(mask: npt.ArrayLike | None, name: str, shape: tuple[int, ...]) -> Bool | None:
    if mask is None:
        return None
    m = np.asarray(mask)
    if m.dtype != np.bool_ or m.shape != shape:
        raise PassError(f"{name} must be bool of shape {shape}, got {m.dtype} {m.shape}")
    return m


def checked_pair(result: npt.ArrayLike, truth: npt.ArrayLike, what: str) -> tuple[Float64, Float64]:
    """Both as float64, NaN where unknown.  Raises PassError for sizes that differ, and where nothing is known or nothing overlaps."""
    t = as_float32(truth, f"true {what}")
    r = as_float32(result, f"{what} to judge", size_hw=(t.shape[0], t.shape[1]))
    a, b = (np.where(np.isfinite(x), x, np.nan).astype(np.float64) for x in (r, t))
    if np.isnan(b).all():
        raise PassError(f"true {what} is unknown at every pixel: nothing to compare with")
    if np.isnan(a).all():
        raise PassError(f"{what} to judge is unknown at every pixel: nothing to compare")
    if not (np.isfinite(a) & np.isfinite(b)).any():
        raise PassError(f"{what} and its truth have no known pixel in common; do they belong to the same frame and eye?")
    return a, b


def _regions(known: Bool, nonoccluded: Bool | None, edges: Bool) -> dict[str, Bool]:
    seen = known if nonoccluded is None else known & nonoccluded
    regions = {"all": known} if nonoccluded is None else {"all": known, "nonoccluded": seen}
    return regions | {"near_edges": seen & edges, "flat": seen & ~edges}


def bins_of(values: npt.NDArray[Any], edges: tuple[float, ...], unit: str) -> dict[str, Bool]:
    """The pixels of each bin that is not empty, by names such as `1-2m`; the outer ones are open: `under0.5m`, `over100m`."""
    lows, highs = (-np.inf, *edges), (*edges, np.inf)
    names = [f"under{edges[0]:g}{unit}", *(f"{a:g}-{b:g}{unit}" for a, b in pairwise(edges)), f"over{edges[-1]:g}{unit}"]
    with np.errstate(invalid="ignore"):
        masks = {name: np.asarray((values >= a) & (values < b)) for name, a, b in zip(names, lows, highs)}
    return {name: mask for name, mask in masks.items() if mask.any()}


def disparity_tallies(
    result: npt.ArrayLike,
    truth: npt.ArrayLike,
    *,
    nonoccluded: npt.ArrayLike | None = None,
    rig: RectifiedRig | None = None,
    thresholds: tuple[float, ...] = BAD_PX,
) -> Groups:
    """The tallies behind `disparity_figures`: groups disparity, disparity_by_distance, normals."""
    a, b = checked_pair(result, truth, "disparity")
    mask = _mask(nonoccluded, "nonoccluded", b.shape)
    error = np.abs(a - b)
    regions = _regions(np.isfinite(b), mask, near_edges(b, jump=JUMP_PX, band_px=EDGE_BAND_PX))
    bins = bins_of(b, BINS_PX, "px") if rig is None else bins_of(rig.depth_from_disparity(b), BINS_M, "m")
    groups: Groups = {
        "disparity": tallied(error, regions, unit="px", thresholds=thresholds),
        f"disparity{DISTANCES}": tallied(error, bins, unit="px", thresholds=thresholds),
    }
    if rig is not None:
        groups["normals"] = {"all": disparity_normal_tally(result, truth, rig, nonoccluded=mask)}
    return groups


def depth_tallies(
    Z: npt.ArrayLike,
    Z_true: npt.ArrayLike,
    *,
    rig: RectifiedRig | None = None,
    nonoccluded: npt.ArrayLike | None = None,
    rays: Float32 | None = None,
    bins_m: tuple[float, ...] = BINS_M,
) -> Groups:
    """The tallies behind `depth_figures`: groups metres, percent, points, disparity, each also by distance, and normals."""
    a, b = checked_pair(Z, Z_true, "Z")
    if np.nanmin(b) <= 0:
        raise PassError(f"true Z must be > 0 metres, got {float(np.nanmin(b)):g}; missing is NaN, never 0")
    mask = _mask(nonoccluded, "nonoccluded", b.shape)
    error = np.abs(a - b)
    regions = _regions(np.isfinite(b), mask, near_edges(np.log(b), jump=JUMP_Z, band_px=EDGE_BAND_PX))
    bins = bins_of(b, bins_m, "m")
    groups: Groups = {}
    for name, values, unit, thresholds in (("metres", error, "m", BAD_M), ("percent", 100 * error / b, "%", BAD_PERCENT)):
        groups[name] = tallied(values, regions, unit=unit, thresholds=thresholds)
        groups[f"{name}{DISTANCES}"] = tallied(values, bins, unit=unit, thresholds=thresholds)
    if rays is not None:
        if rays.shape != (*b.shape, 2):
            raise PassError(f"rays must have shape {(*b.shape, 2)}, got {rays.shape}")
        apart = error * np.sqrt(1 + np.einsum("hwc,hwc->hw", rays, rays, dtype=np.float64))
        groups["points"] = tallied(apart, regions, unit="m", thresholds=BAD_M)
    if rig is not None:
        on_rig = b.shape == rig.left.size_hw
        pair = (np.asarray(rig.disparity_from_depth(z), dtype=np.float32) for z in (a, b))
        seen = disparity_tallies(*pair, nonoccluded=mask, rig=rig if on_rig else None)
        groups |= {k: v for k, v in seen.items() if k != f"disparity{DISTANCES}"}
        px = np.abs(rig.disparity_from_depth(a) - rig.disparity_from_depth(b))
        groups[f"disparity{DISTANCES}"] = tallied(px, bins, unit="px", thresholds=BAD_PX)
    elif rays is not None and min(b.shape) >= WINDOW_PX:
        groups["normals"] = {"all": depth_normal_tally(a, b, rays, nonoccluded=mask)}
    return groups


def disparity_figures_of(groups: Groups) -> DisparityFigures:
    """The figures of tallies, of one frame or of many."""
    return DisparityFigures(
        regions=_told(groups["disparity"]),
        normals=normal_figures_of(groups["normals"]["all"]) if "normals" in groups else None,
        by_distance=_told(groups.get(f"disparity{DISTANCES}", {})),
    )


def depth_figures_of(groups: Groups) -> DepthFigures:
    """The figures of tallies, of one frame or of many."""
    return DepthFigures(
        metres=_told(groups["metres"]),
        percent=_told(groups["percent"]),
        points=_told(groups.get("points", {})),
        by_distance={name: _told(groups[f"{name}{DISTANCES}"]) for name in ("metres", "percent")},
        disparity=disparity_figures_of(groups) if "disparity" in groups else None,
        normals=normal_figures_of(groups["normals"]["all"]) if "normals" in groups and "disparity" not in groups else None,
    )


def _told(tallies: Mapping[str, Tally]) -> dict[str, RegionFigures]:
    return {name: tally.figures() for name, tally in tallies.items()}


def disparity_figures(
    result: npt.ArrayLike,
    truth: npt.ArrayLike,
    *,
    nonoccluded: npt.ArrayLike | None = None,
    rig: RectifiedRig | None = None,
    thresholds: tuple[float, ...] = BAD_PX,
) -> DisparityFigures:
    """How far a disparity is from the truth, pixels.

    result, truth : (H, W) float, NaN (or inf) where unknown.
    nonoccluded   : (H, W) bool, pixels that the other eye sees too; adds the region of that name, and near_edges and flat (within
                    EDGE_BAND_PX of a truth step of more than JUMP_PX, and not) then lie inside it.
    rig           : adds the normal figures of `disparity_normal_figures`, and bins of distance in place of bins of disparity.
    Raises        : PassError for sizes that differ, and where nothing is known or nothing overlaps.
    """
    return disparity_figures_of(disparity_tallies(result, truth, nonoccluded=nonoccluded, rig=rig, thresholds=thresholds))


def depth_figures(
    Z: npt.ArrayLike,
    Z_true: npt.ArrayLike,
    *,
    rig: RectifiedRig | None = None,
    nonoccluded: npt.ArrayLike | None = None,
    rays: Float32 | None = None,
    bins_m: tuple[float, ...] = BINS_M,
) -> DepthFigures:
    """How far a depth is from the truth: metres, per cent of the true Z, and disparity pixels where the `rig` that saw it is given.

    Z, Z_true : (H, W) float, metres, NaN where unknown; the same plate.
    rig       : the rectified rig; both depths must then lie on its left view for the normal figures to be right.
    rays      : (H, W, 2) of the plate's camera (`Camera.ray_grid`): adds the distance of the 3-D points, and normals of the depth.
    bins_m    : edges of the bins of true Z.
    Raises    : PassError for sizes that differ, and where nothing is known or nothing overlaps.
    """
    return depth_figures_of(depth_tallies(Z, Z_true, rig=rig, nonoccluded=nonoccluded, rays=rays, bins_m=bins_m))
