"""The disparity range of a shot against what the rig and the shot file expect.

In: a disparity (H, W) or sparse disparities (n,), rectified pixels, x_left - x_right, NaN where unknown; the rectified rig.
Out: nearest and farthest distance, and what lies outside of where it may."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.camera import RectifiedRig
from stereorelight.errors import PassError
from stereorelight.health.finding import Finding, Level

TAIL = 0.005  # share of matches at either end that may be wrong
LEAST_MATCHES = 50
BEHIND_PX = 1.0  # beyond infinity by more than a match's own error
BEHIND_WARN, BEHIND_BAD = 0.02, 0.4  # share behind infinity: a stale rig; eyes swapped
OUTSIDE_WARN, OUTSIDE_BAD = 0.01, 0.10  # share outside near_m..far_m: what is outside is matched wrongly or not at all
WIDE_PERCENT = 30.0  # of the width: a spread that matching searches only slowly, with much that one eye alone sees


@dataclass(frozen=True, kw_only=True)
class RangeMeasure:
    """One frame's range; NaN where it could not be measured.

    nearest_m, farthest_m : distances that hold all but 0.5 % of the matches at either end; farthest inf beyond infinity's last quarter pixel.
    low_px, high_px       : the same as disparities;  low_percent, high_percent : of the frame's width.
    behind                : share behind infinity, where no point can be.
    too_near, too_far     : share outside near_m and far_m; 0 where none is given.
    """

    number: int | None
    nearest_m: float
    farthest_m: float
    low_px: float
    high_px: float
    low_percent: float
    high_percent: float
    behind: float
    too_near: float
    too_far: float
    matches: int


def measure_range(
    disparity_px: npt.ArrayLike, rig: RectifiedRig, *, near_m: float | None = None, far_m: float | None = None, number: int | None = None
) -> RangeMeasure:
    """The range of one frame.

    disparity_px : any shape, pixels of the rectified rig, believed matches; NaN is left out.
    near_m, far_m: what the shot expects.     Raises : PassError when the disparity is not float.
    """
    d = np.asarray(disparity_px)
    if not np.issubdtype(d.dtype, np.floating):
        raise PassError(f"disparity must be float pixels, got {d.dtype}; OpenCV matchers return int16 sixteenths: divide by 16 first")
    d = d[np.isfinite(d)].astype(np.float64)
    nan = float("nan")
    if d.size < LEAST_MATCHES:
        return RangeMeasure(
            number=number, nearest_m=nan, farthest_m=nan, low_px=nan, high_px=nan, low_percent=nan, high_percent=nan,
            behind=nan, too_near=nan, too_far=nan, matches=int(d.size),
        )  # fmt: skip
    infinity, width = -rig.doffs_px, rig.left.size[0]
    low, high = (float(q) for q in np.quantile(d, (TAIL, 1 - TAIL)))
    far_px = -np.inf if far_m is None else float(rig.disparity_from_depth(far_m))
    near_px = np.inf if near_m is None else float(rig.disparity_from_depth(near_m))
    return RangeMeasure(
        number=number,
        nearest_m=float(rig.depth_from_disparity(high)),
        farthest_m=float(rig.depth_from_disparity(low)) if low - infinity > 0.25 else float("inf"),
        low_px=low,
        high_px=high,
        low_percent=100 * low / width,
        high_percent=100 * high / width,
        behind=float(np.mean(d < infinity - BEHIND_PX)),
        too_near=float(np.mean(d > near_px + BEHIND_PX)),
        too_far=float(np.mean(d < far_px - BEHIND_PX)),
        matches=int(d.size),
    )


def judge_range(measures: Sequence[RangeMeasure], *, near_m: float | None = None, far_m: float | None = None) -> Finding:
    """One finding "range" for a shot; its value is the nearest distance in metres."""
    known = [m for m in measures if m.matches >= LEAST_MATCHES]
    frames = tuple((m.number, m.nearest_m) for m in measures)
    if not known:
        words = "The range of distances could not be measured: hardly anything matches between the eyes."
        return Finding(name="range", level="unknown", words=words, unit="m", frames=frames, remedy="Look at sync, vertical and focus first.")

    # Of a shot the worst frame decides, but one frame alone may hold a wrong match: a tenth of the frames must say so.
    def of_frames(values: list[float]) -> float:
        return float(np.quantile(values, 0.9))

    behind, too_near, too_far = (of_frames([getattr(m, name) for m in known]) for name in ("behind", "too_near", "too_far"))
    # A behind-infinity tail has no distance: its nearest value may be NaN.
    near = [m.nearest_m for m in known if np.isfinite(m.nearest_m)]
    nearest = float(min(near)) if near else float("nan")
    farthest = float(max(m.farthest_m for m in known))
    low, high = min(m.low_percent for m in known), max(m.high_percent for m in known)
    far_words = "infinity" if not np.isfinite(farthest) else f"{farthest:.2f} m"
    span = f"The scene reaches from {nearest:.2f} m to {far_words}, disparities {low:+.1f} to {high:+.1f} % of the width"
    level: Level = "good"
    remedy = ""
    if behind >= BEHIND_WARN:
        level = "bad" if behind >= BEHIND_BAD else "warn"
        words = f"{100 * behind:.0f} % of the matches lie behind infinity, where nothing can be."
        remedy = (
            "Exchange the eyes."
            if behind >= BEHIND_BAD
            else "The eyes have turned since the rig was calibrated: calibrate again, or turn on drift mending."
        )
    elif max(too_near, too_far) >= OUTSIDE_WARN:
        level = "bad" if max(too_near, too_far) >= OUTSIDE_BAD else "warn"
        which = (
            f"{100 * too_near:.0f} % of the matches are nearer than near_m = {near_m:g} m"
            if near_m is not None and too_near >= too_far
            else f"{100 * too_far:.0f} % of the matches are farther than far_m = {far_m or float('nan'):g} m"
        )
        words = f"{span}; {which}."
        remedy = f"Set near_m to {0.95 * nearest:.2f}" + (
            f" and far_m to {1.1 * farthest:.2f}." if np.isfinite(farthest) else " and leave far_m out."
        )
    elif high - low > WIDE_PERCENT:
        level, words = "note", f"{span}: a wide spread, with much that only one eye sees."
        remedy = "Bring the cameras closer together, or step back."
    else:
        words = f"{span}."
    details = {"farthest_m": farthest, "behind": behind, "too_near": too_near, "too_far": too_far, "low_percent": low, "high_percent": high}
    return Finding(name="range", level=level, value=nearest, unit="m", words=words, remedy=remedy, frames=frames, details=details)
