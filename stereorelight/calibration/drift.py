"""A rig that moved since it was calibrated, mended from what the two eyes see.

In: the stale `Rig` and `Matches` of one frame or of many.  Out: a `Drift`: by how much the right eye turned and zoomed
against the rig, how sure that is, and the vertical error before and after; `apply` makes the mended rig.
Frames: camera frame (x right, y down, z forward).  pitch > 0 looks up, yaw > 0 looks right, roll > 0 turns the eye clockwise
as seen from behind it; the eye turns about its own centre.  Pixels are those of the left plate, after rectification.

Only rows speak (an epipolar residual): pitch, roll and zoom move rows everywhere.  Yaw moves them only by perspective, as
x y, and shifts disparity, which nothing here can know: it is freed only where the rows of held-out parts of the frame demand
it.  The direction of the baseline moves rows in step with disparity and is freed in the same way.  What stays held is said.
Uncalibrated rectification (`stereoRectifyUncalibrated`) is not used: it leaves two to five times the error, and no rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.features import SIGMA_FLOOR_PX, Matches
from stereorelight.calibration.robust import Fit, fitted
from stereorelight.camera import Rig
from stereorelight.errors import PlateError, RigError

LEAST_MATCHES = 60  # fewer do not tell a rig that moved from a few wrong matches
NAMES = ("pitch_deg", "yaw_deg", "roll_deg", "zoom_percent", "rise_deg", "forward_deg")
# What a rig may have moved by, one sigma, before anything is seen: far wider than a knock on set, narrow enough to hold what rows cannot tell.
PRIOR_SIGMA = np.array([1.0, 1.0, 1.0, 2.0, 1.0, 1.0])
FREE_ALWAYS = (0, 2, 3)
OPTIONS = ((1,), (4, 5))  # yaw; then the baseline's direction
SURE_SIGMAS = 4.0  # an option is taken from here on, and only where held-out rows gain by it
# Of mean held-out error: less is not worth a shift of disparity; a sensor that sits low can look like a turned baseline on a slanted wall.
GAIN_PX = 0.02
GAIN_BASELINE_PX = 0.05
AROUND_SIGMA = np.array([0.3, 0.02, 0.3, 0.5, 0.02, 0.02])  # of one frame about its shot: what rows hardly tell stays with the shot
CELLS = (8, 6)  # columns and rows of the map, and of the clusters
LEAST_IN_CELL = 4
FURTHEST_DEG, FURTHEST_PERCENT = 5.0, 10.0  # beyond this the rig is another rig


@dataclass(frozen=True, kw_only=True, eq=False)
class VerticalError:
    """How far rows disagree after rectification, px of the left plate.

    median, mean, p95 : of |y_right - y_left| over the matches.
    map               : (6, 8) signed median in each part of the left plate, NaN where fewer than four matches lie.
    """

    median: float
    mean: float
    p95: float
    map: Float64
    matches: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Drift:
    """By how much the right eye stands off its rig.

    pitch_deg, yaw_deg, roll_deg : turns of the right eye about its own centre; see the module.
    zoom                         : factor on the right focal length (against the left one: which eye's ring moved cannot be known).
    rise_deg, forward_deg        : turn of the baseline: right eye higher, right eye further forward.
    sigmas                       : one standard deviation of each, by name (`zoom` as a factor).
    held                         : names that the footage does not tell and that stay with the rig (or with the shot).
    yaw_sigma_free_deg           : how well the rows would have told yaw, had it been freed.
    matches                      : matches that took part;  rejected: those left out as wrong.
    before, after                : vertical error of these matches with the stale rig and with the mended one; None for a drift
                                   made of others (smoothed, keyed).
    held_out_before, held_out_after : median |dy| px on parts of the frame that the solve did not see.
    """

    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    zoom: float = 1.0
    rise_deg: float = 0.0
    forward_deg: float = 0.0
    sigmas: Mapping[str, float]
    held: tuple[str, ...] = ()
    yaw_sigma_free_deg: float = math.nan
    matches: int = 0
    rejected: int = 0
    before: VerticalError | None = None
    after: VerticalError | None = None
    held_out_before: float = math.nan
    held_out_after: float = math.nan

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Pitch, yaw, roll."""
        return self.pitch_deg, self.yaw_deg, self.roll_deg

    @property
    def values(self) -> Float64:
        """(6,) in the order of `NAMES`; zoom in per cent of change."""
        return np.array([self.pitch_deg, self.yaw_deg, self.roll_deg, 100 * (self.zoom - 1), self.rise_deg, self.forward_deg])

    def words(self) -> str:
        """The drift in one line, with what it does not know."""
        s = self.sigmas
        said = [
            f"{name} {value:+.3f} ± {s[f'{name}_deg']:.3f} deg"
            for name, value in (("pitch", self.pitch_deg), ("yaw", self.yaw_deg), ("roll", self.roll_deg))
            if f"{name}_deg" not in self.held
        ]
        said.append(f"zoom {100 * (self.zoom - 1):+.3f} ± {100 * s['zoom']:.3f} %")
        if "rise_deg" not in self.held:
            said.append(f"baseline {self.rise_deg:+.2f} deg up, {self.forward_deg:+.2f} deg forward")
        if "yaw_deg" in self.held:
            said.append(f"yaw not told by this footage (rows would tell it to ± {self.yaw_sigma_free_deg:.2f} deg only)")
        return ", ".join(said)


def _drift_of(values: Float64, sigmas: Float64, **more: Any) -> Drift:
    v = [float(x) for x in values]
    said = dict(zip(NAMES, (float(s) for s in sigmas)))
    said["zoom"] = said.pop("zoom_percent") / 100
    return Drift(pitch_deg=v[0], yaw_deg=v[1], roll_deg=v[2], zoom=1 + v[3] / 100, rise_deg=v[4], forward_deg=v[5], sigmas=said, **more)


def _turn(pitch_deg: float, yaw_deg: float, roll_deg: float) -> Float64:
    """(3, 3) from the turned eye to the eye as it stood: yaw after pitch after roll."""
    a, b, c = np.radians([pitch_deg, yaw_deg, roll_deg])
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    turned: Float64 = about_y @ about_x @ about_z
    return turned


def _pose(rig: Rig, values: Float64) -> tuple[Float64, Float64]:
    """R_right_left and the right eye's centre (left camera frame) after a drift."""
    c = rig.right_centre_m
    length = float(np.linalg.norm(c))
    x = c / length
    down = np.cross((0.0, 0.0, 1.0), x)
    down /= np.linalg.norm(down)
    moved = x - math.tan(math.radians(values[4])) * down + math.tan(math.radians(values[5])) * np.cross(x, down)
    return _turn(*values[:3]).T @ rig.R_right_left, moved * (length / np.linalg.norm(moved))


def _zoomed(rig: Rig, zoom: float) -> Rig:
    K = np.array(rig.right.K)
    K[0, 0] *= zoom
    K[1, 1] *= zoom
    return replace(rig, right=replace(rig.right, K=K))


def apply(rig: Rig, drift: Drift) -> Rig:
    """The mended rig: the right eye turned and zoomed as it now stands.  Raises RigError where no rig can stand so."""
    if not any(drift.values):
        return rig
    R, centre = _pose(rig, drift.values)
    moved = _zoomed(rig, drift.zoom)
    return replace(moved, R_right_left=R, t_right_left_m=-R @ centre)


def _rows_apart(left_rays: Float64, right_rays: Float64, R_right_left: Float64, centre: Float64, focal_px: float) -> Float64:
    """(n,) y_right - y_left in pixels on the rectified pair that this pose makes; x along the baseline, z midway between the eyes."""
    x = centre / np.linalg.norm(centre)
    y = np.cross(np.array([0.0, 0.0, 1.0]) + R_right_left[2], x)
    y /= np.linalg.norm(y)
    yz = np.stack([y, np.cross(x, y)])
    a, b = left_rays @ yz.T, right_rays @ (R_right_left @ yz.T)
    apart: Float64 = focal_px * (b[:, 0] / b[:, 1] - a[:, 0] / a[:, 1])
    return apart


def rows_apart(rig: Rig, left_px: npt.ArrayLike, right_px: npt.ArrayLike) -> Float64:
    """(n,) y_right - y_left after rectification by `rig`, px of the left plate, of points (n, 2) on the original plates.

    NaN where a lens model does not reach.
    """
    return _rows_apart(rig.left.rays(left_px), rig.right.rays(right_px), rig.R_right_left, rig.right_centre_m, rig.left.fy)


def _cells(matches: Matches) -> npt.NDArray[np.intp]:
    share = np.clip((matches.left + 0.5) / matches.size, 0, 1 - 1e-9)
    column, row = np.floor(share * CELLS).astype(np.intp).T
    return row * CELLS[0] + column


def error_of(apart_px: Float64, matches: Matches, keep: Bool | None = None) -> VerticalError:
    """The figures and the map of vertical distances `apart_px` (n,), of the matches in `keep`."""
    keep = np.isfinite(apart_px) if keep is None else keep & np.isfinite(apart_px)
    dy, cell = apart_px[keep], _cells(matches)[keep]
    grid = np.full(CELLS[0] * CELLS[1], np.nan)
    for k in np.unique(cell):
        inside = dy[cell == k]
        if len(inside) >= LEAST_IN_CELL:
            grid[k] = np.median(inside)
    if not len(dy):
        return VerticalError(median=math.nan, mean=math.nan, p95=math.nan, map=grid.reshape(CELLS[::-1]), matches=0)
    size = np.abs(dy)
    return VerticalError(
        median=float(np.median(size)),
        mean=float(size.mean()),
        p95=float(np.percentile(size, 95)),
        map=grid.reshape(CELLS[::-1]),
        matches=len(dy),
    )


def vertical_error(rig: Rig, matches: Matches) -> VerticalError:
    """How far rows disagree with `rig` taken as it stands, over all matches."""
    return error_of(rows_apart(rig, matches.left, matches.right), matches)


def _checked(matches: Matches, rig: Rig, least: int) -> None:
    if matches.size != rig.left.size:
        (w, h), (a, b) = matches.size, rig.left.size
        raise PlateError(f"plates are {w}x{h}, but the rig was calibrated at {a}x{b}; use plates of that size, or scale the rig")
    if len(matches) < least:
        raise PlateError(
            f"only {len(matches)} matches between the eyes, and mending a rig needs {least}; "
            "take a frame with more texture and light, solve the shot as a whole, or recalibrate with a board"
        )


def solve_drift(rig: Rig, matches: Matches, *, around: Drift | None = None, least: int = LEAST_MATCHES) -> Drift:
    """By how much the right eye moved since `rig` was calibrated, by robust least squares on rows.

    around : the drift of the whole shot, for one frame of it: what rows hardly tell (yaw, baseline) then stays with the shot.
    Raises : PlateError under `least` matches or for plates that are not the rig's size; RigError where the rows ask for a rig
             that is no longer this one.
    """
    _checked(matches, rig, least)
    left_rays, focal = rig.left.rays(matches.left), rig.left.fy
    right_straight: dict[float, Float64] = {}

    def right_rays(zoom_percent: float) -> Float64:
        if zoom_percent not in right_straight:
            if len(right_straight) > 8:
                right_straight.clear()
            right_straight[zoom_percent] = _zoomed(rig, 1 + zoom_percent / 100).right.rays(matches.right)
        return right_straight[zoom_percent]

    keep: Bool = np.isfinite(np.concatenate([left_rays, right_rays(0.0)], axis=1)).all(axis=1)
    sigma, cluster = np.maximum(matches.sigma_px, SIGMA_FLOOR_PX), _cells(matches)

    def residuals(values: Float64) -> Float64:
        return np.nan_to_num(_rows_apart(left_rays, right_rays(float(values[3])), *_pose(rig, values), focal))

    base = np.zeros(6) if around is None else around.values
    prior_sigma = PRIOR_SIGMA if around is None else AROUND_SIGMA

    def solve(free: tuple[int, ...], among: Bool) -> tuple[Fit, Float64]:
        index = list(free)

        def some(v: Float64) -> Float64:
            values = base.copy()
            values[index] = v
            return residuals(values)

        fit = fitted(some, sigma=sigma, prior=base[index], prior_sigma=prior_sigma[index], cluster=cluster, keep=among)
        values = base.copy()
        values[index] = fit.values
        return fit, values

    def held_out(free: tuple[int, ...]) -> Float64:
        """(n,) residuals of each match under the solve that did not see its part of the frame."""
        column, row = cluster % CELLS[0], cluster // CELLS[0]
        odd = (column + row) % 2 == 1
        apart = np.full(len(matches), np.nan)
        parts: tuple[Bool, Bool] = odd, np.logical_not(odd)
        for part in parts:
            if (keep & part).sum() >= least // 4 and (keep & ~part).any():
                apart[keep & ~part] = residuals(solve(free, keep & part)[1])[keep & ~part]
        return apart

    free = FREE_ALWAYS
    fit, values = solve(free, keep)
    apart = held_out(free)
    yaw_sigma = math.nan
    for option in OPTIONS:
        if around is not None and any(NAMES[k] in around.held for k in option):
            continue
        wider = tuple(sorted((*free, *option)))
        tried, tried_values = solve(wider, keep)
        place = [wider.index(k) for k in option]
        if option == (1,):
            yaw_sigma = float(tried.sigmas[place[0]])
        sure = (np.abs(tried.values[place] - base[list(option)]) > SURE_SIGMAS * tried.sigmas[place]).any()
        if around is None and not sure:
            continue
        tried_apart = held_out(wider)
        gain = GAIN_PX if option == (1,) else GAIN_BASELINE_PX
        small = np.abs(tried_values[list(option)]).max() < FURTHEST_DEG
        if small and (around is not None or _mean(tried_apart[fit.inlier]) < _mean(apart[fit.inlier]) - gain):
            free, fit, values, apart = wider, tried, tried_values, tried_apart
    if np.abs(values[:3]).max() > FURTHEST_DEG or abs(values[3]) > FURTHEST_PERCENT:
        raise RigError(
            f"the rows ask for a right eye turned by {np.abs(values[:3]).max():.1f} deg and zoomed by {values[3]:+.1f} %: that is another rig; "
            "check that plates and rig belong together, or recalibrate"
        )
    sigmas = prior_sigma.copy() if around is None else np.array([around.sigmas.get(n, around.sigmas["zoom"] * 100) for n in NAMES])
    sigmas[list(free)] = fit.sigmas
    before, after = residuals(np.zeros(6)), residuals(values)
    return _drift_of(
        values,
        sigmas,
        held=tuple(name for k, name in enumerate(NAMES) if k not in free),
        yaw_sigma_free_deg=yaw_sigma,
        matches=int(fit.inlier.sum()),
        rejected=int(len(matches) - fit.inlier.sum()),
        before=error_of(before, matches, fit.inlier),
        after=error_of(after, matches, fit.inlier),
        held_out_before=_median(before[fit.inlier]),
        held_out_after=_median(apart[fit.inlier]),
    )


def _median(apart: Float64) -> float:
    known = np.abs(apart[np.isfinite(apart)])
    return float(np.median(known)) if len(known) else math.nan


def _mean(apart: Float64) -> float:
    known = np.abs(apart[np.isfinite(apart)])
    return float(known.mean()) if len(known) else math.inf


def smoothed(drifts: Sequence[Drift | None], *, window: int = 9) -> list[Drift]:
    """Per-frame drifts without their noise: a knock stays a knock, a wrong frame goes, a missing one (None) is bridged.

    window : frames that speak for one, odd.  About the weighted median of the window, frames within three sigma are averaged
             (Tukey's biweight), nearer ones and surer ones counting more.
    Raises : PlateError where no frame has a drift; RigError for a window that is none.
    """
    if window < 1 or window % 2 == 0:
        raise RigError(f"window must be an odd number of frames, got {window}")
    known = [(k, drift) for k, drift in enumerate(drifts) if drift is not None]
    if not known:
        raise PlateError("no frame of the shot has matches enough to mend the rig; recalibrate with a board")
    at = np.array([k for k, _ in known])
    values = np.stack([drift.values for _, drift in known])
    sigmas = np.stack([_sigmas(drift) for _, drift in known])
    out: list[Drift] = []
    for k in range(len(drifts)):
        half = max(window // 2, int(np.abs(at - k).min()))
        near = np.abs(at - k) <= half
        weight = 1 - (np.abs(at[near] - k) / (half + 1.0)) ** 2
        answer, spread_of = np.empty(6), np.empty(6)
        for c in range(6):
            answer[c], spread_of[c] = _biweight(values[near, c], sigmas[near, c], weight)
        nearest = known[int(np.abs(at - k).argmin())][1]
        out.append(_drift_of(answer, spread_of, held=nearest.held, yaw_sigma_free_deg=nearest.yaw_sigma_free_deg, matches=nearest.matches))
    return out


def _sigmas(drift: Drift) -> Float64:
    return np.array([drift.sigmas["zoom"] * 100 if name == "zoom_percent" else drift.sigmas[name] for name in NAMES])


def _biweight(values: Float64, sigmas: Float64, weight: Float64) -> tuple[float, float]:
    """Robust mean and its sigma; where two levels meet, the level that more of the weight stands on."""
    order = np.argsort(values, kind="stable")
    middle = float(values[order][np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)])
    scale = max(float(np.median(sigmas)), 1e-9)
    far = np.abs(values - middle) / (3 * scale)
    w = weight * np.clip(1 - far**2, 0, None) ** 2 / np.maximum(sigmas, 1e-9) ** 2
    return float((w * values).sum() / w.sum()), float(np.sqrt((w**2 * sigmas**2).sum()) / w.sum())


def keyed(keys: Mapping[int, Drift], frame: int) -> Drift:
    """The drift at `frame` between the drifts of given frames: linear between two, held before the first and after the last."""
    if not keys:
        raise PlateError("no key frame has a drift; name frames that show texture in both eyes")
    frames = sorted(keys)
    if frame in keys:
        return keys[frame]
    if frame <= frames[0] or frame >= frames[-1]:
        return replace(keys[frames[0] if frame <= frames[0] else frames[-1]], before=None, after=None)
    after = next(k for k in frames if k > frame)
    before = max(k for k in frames if k < frame)
    share = (frame - before) / (after - before)
    a, b = keys[before], keys[after]
    return _drift_of(
        (1 - share) * a.values + share * b.values,
        np.sqrt(((1 - share) * _sigmas(a)) ** 2 + (share * _sigmas(b)) ** 2),
        held=tuple(name for name in a.held if name in b.held),
        yaw_sigma_free_deg=max(a.yaw_sigma_free_deg, b.yaw_sigma_free_deg),
        matches=min(a.matches, b.matches),
    )
