"""Disparity and depth against truth: bad pixels, averages, quantiles and cover, over named regions.

In: (H, W) float arrays, NaN where unknown.  Out: frozen figures with `.to_dict()` and `.text()`.
Only pixels with known truth count.  A pixel without an answer counts as bad and as infinitely wrong in the quantiles, so that
matching less never looks better; average and RMS are over the answered pixels, and `cover_percent` says how many those are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64, as_float32
from stereorelight.camera import RectifiedRig
from stereorelight.compare.edges import near_edges
from stereorelight.compare.normals import NormalFigures, disparity_normal_figures
from stereorelight.errors import PassError

BAD_PX = (0.5, 1.0, 2.0, 4.0)
BAD_M = (0.01, 0.05, 0.1)
BAD_PERCENT = (1.0, 2.0, 5.0)
QUANTILES = (50, 90, 95, 99)
JUMP_PX = 2.0  # disparity step between neighbours that makes a depth edge
EDGE_BAND_PX = 4  # how far from such a step a pixel is "near an edge"


@dataclass(frozen=True, kw_only=True)
class RegionFigures:
    """Figures of one region.

    unit          : px, m or % (of the true Z).
    pixels        : how many pixels of the region have known truth.
    cover_percent : share of those that have an answer.
    bad_percent   : threshold to share of those that are off by more, or have no answer.
    average, rms  : of the absolute error, over answered pixels; NaN where there is none.
    quantiles     : q to the error that q % of the pixels stay within; inf where so many have no answer.
    """

    unit: str
    pixels: int
    cover_percent: float
    bad_percent: Mapping[float, float]
    average: float
    rms: float
    quantiles: Mapping[int, float]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, None where there is none; keys such as bad2_percent, average_px, A90_px."""
        unit = {"%": "percent"}.get(self.unit, self.unit)
        out: dict[str, Any] = {"pixels": self.pixels, "cover_percent": self.cover_percent}
        out |= {f"bad{threshold:g}{'' if unit == 'px' else unit}_percent": share for threshold, share in self.bad_percent.items()}
        out |= {f"average_{unit}": self.average, f"rms_{unit}": self.rms}
        out |= {f"A{q}_{unit}": value for q, value in self.quantiles.items()}
        return {key: (None if isinstance(value, float) and not np.isfinite(value) else value) for key, value in out.items()}


def region_figures(error: Float64, region: Bool, *, unit: str, thresholds: tuple[float, ...]) -> RegionFigures:
    """Figures of absolute `error` (H, W), NaN where there is no answer, over the pixels of `region`."""
    e = error[region]
    answered = e[np.isfinite(e)]
    ranked = np.sort(np.where(np.isfinite(e), e, np.inf))
    n = e.size
    # The smallest error that at least q % of the pixels stay within; no interpolation, so that inf stays inf.
    at = {q: float(ranked[max(int(np.ceil(q / 100 * n)) - 1, 0)]) if n else float("nan") for q in QUANTILES}
    return RegionFigures(
        unit=unit,
        pixels=n,
        cover_percent=100 * answered.size / n if n else float("nan"),
        bad_percent={t: 100 * float((ranked > t).sum()) / n if n else float("nan") for t in thresholds},
        average=float(answered.mean()) if answered.size else float("nan"),
        rms=float(np.sqrt((answered**2).mean())) if answered.size else float("nan"),
        quantiles=at,
    )


def _table(title: str, regions: Mapping[str, RegionFigures]) -> str:
    rows: list[list[str]] = []
    for name, r in regions.items():
        bad = [f"bad{t:g}{'' if r.unit == 'px' else r.unit}" for t in r.bad_percent]
        head = [
            title,
            "pixels",
            "cover %",
            *[f"{b} %" if r.unit == "px" else b for b in bad],
            f"avg {r.unit}",
            "rms",
            *[f"A{q}" for q in r.quantiles],
        ]
        if not rows:
            rows.append(head)
        figures = [r.cover_percent, *r.bad_percent.values()]
        errors = [r.average, r.rms, *r.quantiles.values()]
        rows.append([name, str(r.pixels), *[number(v, 2) for v in figures], *[number(v, 3) for v in errors]])
    return align(rows)


def number(value: float, digits: int) -> str:
    """`value` with `digits` decimals, or a dash where there is none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def align(rows: list[list[str]]) -> str:
    """Rows of words as a table: the first column to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(w.ljust(widths[i]) if i == 0 else w.rjust(widths[i]) for i, w in enumerate(row)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


@dataclass(frozen=True, kw_only=True)
class DisparityFigures:
    """Figures by region (`all`, `nonoccluded`, `near_edges`, `flat`), pixels; and normals of the disparity where a rig was given."""

    regions: Mapping[str, RegionFigures]
    normals: NormalFigures | None = None

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {name: r.to_dict() for name, r in self.regions.items()}
        return out | ({"normals": self.normals.to_dict()} if self.normals else {})

    def text(self) -> str:
        """A calm table, one region a line."""
        lines = [_table("disparity", self.regions)]
        return "\n".join(lines + ([self.normals.text()] if self.normals else []))


@dataclass(frozen=True, kw_only=True)
class DepthFigures:
    """Figures of Z by region: metres, per cent of the true Z, and pixels of disparity where a rig was given."""

    metres: Mapping[str, RegionFigures]
    percent: Mapping[str, RegionFigures]
    disparity: DisparityFigures | None = None

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {
            "metres": {name: r.to_dict() for name, r in self.metres.items()},
            "percent": {name: r.to_dict() for name, r in self.percent.items()},
        }
        return out | ({"disparity": self.disparity.to_dict()} if self.disparity else {})

    def text(self) -> str:
        """Calm tables, one region a line."""
        lines = [_table("depth", self.metres), _table("depth of Z", self.percent)]
        return "\n\n".join(lines + ([self.disparity.text()] if self.disparity else []))


def _mask(mask: npt.ArrayLike | None, name: str, shape: tuple[int, ...]) -> Bool | None:
    if mask is None:
        return None
    m = np.asarray(mask)
    if m.dtype != np.bool_ or m.shape != shape:
        raise PassError(f"{name} must be bool of shape {shape}, got {m.dtype} {m.shape}")
    return m


def _pair(result: npt.ArrayLike, truth: npt.ArrayLike, what: str) -> tuple[Float64, Float64]:
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
    rig           : adds the normal figures of `disparity_normal_figures`.
    Raises        : PassError for sizes that differ, and where nothing is known or nothing overlaps.
    """
    a, b = _pair(result, truth, "disparity")
    mask = _mask(nonoccluded, "nonoccluded", b.shape)
    error = np.abs(a - b)
    regions = _regions(np.isfinite(b), mask, near_edges(b, jump=JUMP_PX, band_px=EDGE_BAND_PX))
    return DisparityFigures(
        regions={name: region_figures(error, region, unit="px", thresholds=thresholds) for name, region in regions.items()},
        normals=None if rig is None else disparity_normal_figures(result, truth, rig, nonoccluded=mask),
    )


def depth_figures(
    Z: npt.ArrayLike,
    Z_true: npt.ArrayLike,
    *,
    rig: RectifiedRig | None = None,
    nonoccluded: npt.ArrayLike | None = None,
) -> DepthFigures:
    """How far a depth is from the truth: metres, per cent of the true Z, and disparity pixels where the `rig` that saw it is given.

    Z, Z_true : (H, W) float, metres, NaN where unknown; the same plate.
    rig       : the rectified rig; both depths must then lie on its left view for the normal figures to be right.
    Raises    : PassError for sizes that differ, and where nothing is known or nothing overlaps.
    """
    a, b = _pair(Z, Z_true, "Z")
    if np.nanmin(b) <= 0:
        raise PassError(f"true Z must be > 0 metres, got {float(np.nanmin(b)):g}; missing is NaN, never 0")
    mask = _mask(nonoccluded, "nonoccluded", b.shape)
    error = np.abs(a - b)
    # A step of 5 % between neighbours: what no surface but a grazing one does at any sensible focal length.
    regions = _regions(np.isfinite(b), mask, near_edges(np.log(b), jump=0.05, band_px=EDGE_BAND_PX))
    disparity = None
    if rig is not None:
        pair = (np.asarray(rig.disparity_from_depth(z), dtype=np.float32) for z in (a, b))
        on_rig = b.shape == rig.left.size_hw
        disparity = disparity_figures(*pair, nonoccluded=nonoccluded, rig=rig if on_rig else None)
    return DepthFigures(
        metres={name: region_figures(error, region, unit="m", thresholds=BAD_M) for name, region in regions.items()},
        percent={name: region_figures(100 * error / b, region, unit="%", thresholds=BAD_PERCENT) for name, region in regions.items()},
        disparity=disparity,
    )
