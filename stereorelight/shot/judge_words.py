"""Tallies as figures, curves, maps and pictures of a comparison's page.

In: tallies of a frame or of a shot, and the arrays of one frame.  Out: what a `Measured` holds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.compare.depth import TABLES, depth_figures_of, disparity_figures_of
from stereorelight.compare.figures import Blink, Curve, ErrorMap, Figure
from stereorelight.compare.normals import normal_figures_of
from stereorelight.compare.tally import Groups
from stereorelight.footage.preview import colour_table, depth_picture, depth_range, normals_picture

if TYPE_CHECKING:
    from stereorelight.shot.judge_frame import Look

MAP_PX, MAP_PERCENT, MAP_DEG = 4.0, 5.0, 30.0  # fixed, so that two pages can be compared
UNKNOWN = (40, 40, 40)


def figures_of(what: str, groups: Groups) -> tuple[list[Figure], dict[str, Any]]:
    """The figures, and the same nested as JSON has them."""
    if what == "normals":
        regions = {name: normal_figures_of(tally) for name, tally in groups["normals"].items()}
        nested: dict[str, Any] = regions["all"].to_dict() | {"regions": {name: told.to_dict() for name, told in regions.items()}}
        return [f for name, told in regions.items() for f in told.figures("normals", name)], nested
    figures = disparity_figures_of(groups) if what == "disparity" else depth_figures_of(groups)
    return figures.figures(), figures.to_dict()


def curves_of(what: str, groups: Groups) -> list[Curve]:
    """How many pixels lie within which error, by region, one drawing a group."""
    names = {"normals": ("normals",), "disparity": ("disparity", "normals")}.get(what, ("disparity", "percent", "points", "normals"))
    out = []
    for name in names:
        if not (tallies := {region: t for region, t in groups.get(name, {}).items() if t.answered}):
            continue
        unit = next(iter(tallies.values())).unit
        title = f"{TABLES.get(name, name)}: share of the pixels within an error; without an answer they are never within"
        lines = {region: t.curve() for region, t in tallies.items()}
        out.append(Curve(title=title, lines=lines, x_label=f"error, {unit}", y_label="% of pixels", log_x=True, y_range=(0.0, 100.0)))
    return out


def maps_of(what: str, look: Look) -> tuple[tuple[ErrorMap, ...], tuple[Blink, ...]]:
    """The maps and the pictures that blink, of one frame."""
    maps: list[ErrorMap] = []
    if what == "normals":
        maps.append(ErrorMap(title="Angle to the true normal", error=_f32(look.angle), known=look.known, scale=MAP_DEG, unit="deg", sequential=True))
        pictures = [normals_picture(_f32(N)) for N in (look.truth, look.result)]
        return tuple(maps), (Blink(title="Normals", truth=pictures[0], result=pictures[1]),)
    if look.px is not None:
        title = "Disparity, result less truth: red is nearer than the truth"
        maps.append(ErrorMap(title=title, error=_f32(look.px), known=look.known, scale=MAP_PX, unit="px"))
    if what == "disparity":
        pictures = _disparity_pictures(look.truth, look.result)
        return tuple(maps), (Blink(title="Disparity, bright is near", truth=pictures[0], result=pictures[1]),)
    percent = 100 * (look.result - look.truth) / look.truth
    maps.append(
        ErrorMap(title="Z, result less truth: red is farther than the truth", error=_f32(percent), known=look.known, scale=MAP_PERCENT, unit="%")
    )
    near, far = depth_range(_f32(look.truth))
    pictures = [depth_picture(_f32(Z), near=near, far=far) for Z in (look.truth, look.result)]
    return tuple(maps), (Blink(title=f"Z, bright is near: {near:.3g} to {far:.3g} m", truth=pictures[0], result=pictures[1]),)


def _f32(values: Any) -> Float32:
    return np.asarray(values, np.float32)


def _disparity_pictures(truth: Any, result: Any) -> list[UInt8]:
    low, high = (float(v) for v in np.nanpercentile(truth, (1, 99)))
    out = []
    for d in (truth, result):
        share = np.clip(np.nan_to_num((d - low) / max(high - low, 1e-6)), 0, 1)
        picture = colour_table()[np.rint(share * 255).astype(np.uint8)]
        picture[~np.isfinite(d)] = UNKNOWN
        out.append(picture)
    return out
