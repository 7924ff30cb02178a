"""The pictures of the plate health page: what a person looks at to believe the figures.

In: the plates of one frame, the frames looked at, and the findings.  Out: (caption, (H, W, 3) uint8), sRGB."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, UInt8
from stereorelight.footage.preview import anaglyph, plate_picture, shrunk
from stereorelight.health.finding import Finding
from stereorelight.shot.check_look import Look, rectified_points
from stereorelight.stereo.rectify import Rectification

WIDTH_PX = 720
LINES = 12  # across both eyes, to hold rows against each other
LINE = (255, 210, 60)
LOW, MIDDLE, HIGH, UNKNOWN = (70, 120, 235), (245, 245, 245), (225, 70, 55), (60, 60, 60)


def rows_picture(left: Float32, right: Float32, *, width_px: int = WIDTH_PX) -> UInt8:
    """Both eyes side by side with lines across: the same point must lie on the same line."""
    eyes = [shrunk(plate_picture(plate), width_px // 2) for plate in (left, right)]
    height = min(eye.shape[0] for eye in eyes)
    picture = np.concatenate([eye[:height] for eye in eyes], axis=1)
    for k in range(1, LINES):
        picture[round(k * height / LINES)] = LINE
    return picture


def map_picture(cells: npt.ArrayLike, limit: float, shape_hw: tuple[int, int]) -> UInt8:
    """(rows, columns) signed cells as colour: blue is -limit or less, white 0, red +limit or more, gray unknown."""
    values = np.asarray(cells, dtype=np.float64)
    share = np.clip(values / max(limit, 1e-9), -1, 1)
    low, middle, high = (np.array(c, np.float64) for c in (LOW, MIDDLE, HIGH))
    t = np.abs(np.nan_to_num(share))[..., None]
    colour = np.where(np.nan_to_num(share)[..., None] < 0, low, high) * t + middle * (1 - t)
    colour[np.isnan(values)] = UNKNOWN
    height = max(1, round(shape_hw[0] * WIDTH_PX / shape_hw[1]))
    rows = np.minimum(np.arange(height) * values.shape[0] // height, values.shape[0] - 1)
    columns = np.minimum(np.arange(WIDTH_PX) * values.shape[1] // WIDTH_PX, values.shape[1] - 1)
    return np.rint(colour[rows][:, columns]).astype(np.uint8)


def pictures_of(
    sample: tuple[Float32, Float32], looks: Sequence[Look], findings: Sequence[Finding], rectified: Rectification | None
) -> tuple[tuple[str, UInt8], ...]:
    """Plates with lines across, an anaglyph, and the maps of what differs between the eyes."""
    if rectified is None:
        views, how = sample, "as shot"
    else:
        views, how = (rectified.rectify(sample[0], "left"), rectified.rectify(sample[1], "right")), "rectified"
    made = [(f"Left and right {how}, first frame looked at: a point lies on one line in both", rows_picture(*views))]
    if views[0].shape == views[1].shape:
        shown = [shrunk(plate_picture(view), WIDTH_PX) for view in views]
        shift = _middle_disparity(looks, rectified) * shown[0].shape[1] / views[0].shape[1]
        made.append(
            (f"Red-cyan anaglyph, {how}, the median distance in the plane of the screen", anaglyph(shown[0], shown[1], shift_px=round(shift)))
        )
    size = sample[0].shape[:2]
    vertical = next((f.details.get("map_px") for f in findings if f.name == "vertical" and f.details.get("map_px") is not None), None)
    if vertical is not None:
        cells = np.array(vertical, dtype=np.float64)
        limit = max(1.0, float(np.nanmax(np.abs(cells), initial=0.0)))
        made.append(
            (f"Vertical misalignment over the left plate: blue -{limit:.2g} px, white none, red +{limit:.2g} px", map_picture(cells, limit, size))
        )
    local = [one.exposure.local_stops for one in looks if one.exposure is not None]
    if local:
        cells = _mean(np.stack(local)[..., 1])
        made.append(("Local light, right against left, after the overall gain: blue -0.5 stops, red +0.5 stops", map_picture(cells, 0.5, size)))
    focus = [one.focus.local_px for one in looks if one.focus is not None]
    if focus:
        made.append(
            (
                "Focus: blue where the left eye is softer, red where the right one is, 2 px at full colour",
                map_picture(_mean(np.stack(focus)), 2.0, size),
            )
        )
    return tuple(made)


def _middle_disparity(looks: Sequence[Look], rectified: Rectification | None) -> float:
    """Median disparity of the first frame looked at, px of the views shown; 0 where nothing matches."""
    matches = looks[0].matches
    if len(matches) == 0:
        return 0.0
    left, right = (matches.left, matches.right) if rectified is None else rectified_points(rectified, matches)
    middle = float(np.median(left[:, 0] - right[:, 0]))
    return min(max(middle, -matches.size[0] / 3), matches.size[0] / 3)


def _mean(stack: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Mean over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(stack)
    count = known.sum(axis=0)
    total = np.where(known, stack, 0).sum(axis=0, dtype=np.float64)
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
