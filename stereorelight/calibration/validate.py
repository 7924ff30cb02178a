"""Is the calibration good enough?  Held-out error, halves against each other, squares measured, and a verdict in words.

In: a `Calibration`.  Out: a `Quality`: figures, `Advice` with what to shoot again, and the rig with its quality filled in.
Pixels: vertical errors are counted on a rectified pair whose focal length is the mean of the two eyes' own.
Nothing here trusts the RMS: it falls with every parameter added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.answer import EYES, Calibration
from stereorelight.calibration.bundle import Fit, State, fit
from stereorelight.calibration.lens_choice import folds_of
from stereorelight.calibration.projection import camera_of, rotation
from stereorelight.calibration.uncertainty import GRID, DepthAnswer, answers, coverage, frame_grid, projection_sigma, standard_errors
from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError

IntArray = npt.NDArray[np.intp]
Level = Literal["good", "note", "warn", "bad"]
LEVELS: tuple[Level, ...] = ("good", "note", "warn", "bad")
MOST_FOLDS = 30  # up to so many views each is left out by itself
DISTANCES_M = (0.5, 1.0, 2.0, 4.0)
GOOD_VIEWS, FEW_VIEWS = 15, 8
GOOD_TILT_DEG, LITTLE_TILT_DEG = 25.0, 12.0
SURE_FOCAL, UNSURE_FOCAL = 0.002, 0.01  # one sigma as a share of the focal length: 2 mm and 10 mm at a metre
GOOD_VERTICAL_PX, BAD_VERTICAL_PX = 0.2, 0.6  # held out, mean: what a matcher that searches along rows does not feel, and does
SURE_CORNER_PX, UNSURE_CORNER_PX = 0.5, 2.0  # one sigma of projection anywhere in the frame
GOOD_COVERAGE, POOR_COVERAGE = 0.6, 0.35  # share of the frame's cells in which a corner was seen
SMALL_BOARD = 0.08  # of the frame's area, the median view
BIG_EXCESS = 3.0


@dataclass(frozen=True, kw_only=True)
class Advice:
    """One judged property: `name` for scripts, how grave, what was found, what to shoot again ("" where nothing)."""

    name: str
    level: Level
    words: str
    remedy: str = ""
    value: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Quality:
    """What a calibration is worth.

    held_out_px          : (n,) |vertical error| of every corner, good or bad, of the views used, each under a rig that its view
                           had no part in.  held_out_all_px: also of views that were left out whole.
    held_out_by_view_px  : (V,) its mean; NaN where only one eye saw the board.
    halves_px            : left and right (rows, columns): by how many pixels odd and even views' solves disagree; None where too few.
    square_spread        : sd of triangulated distances between neighbouring corners, as a share of the square; against the plan, and
                           against the board's own shape as solved.
    """

    held_out_px: Float64
    held_out_all_px: Float64
    held_out_by_view_px: Float64
    halves_px: tuple[Float64, Float64] | None
    square_spread: float
    square_spread_own: float
    square_mean: float
    tilt_deg: Float64
    answers: tuple[DepthAnswer, ...]
    advice: tuple[Advice, ...]
    figures: dict[str, Any]

    @property
    def verdict(self) -> Level:
        return max((a.level for a in self.advice), key=LEVELS.index, default="good")

    @property
    def held_out_mean_px(self) -> float:
        return float(self.held_out_px.mean()) if len(self.held_out_px) else float("nan")

    @property
    def held_out_95_px(self) -> float:
        return float(np.percentile(self.held_out_px, 95)) if len(self.held_out_px) else float("nan")


def _turned_half(R: Float64) -> Float64:
    """The rotation by half of R's angle."""
    angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    length = np.linalg.norm(axis)
    return rotation(axis / length * angle / 2) if length > 1e-12 else np.eye(3)


def rectifying(R_right_left: Float64, t_right_left_m: Float64) -> tuple[Float64, Float64]:
    """Rotations of the left and the right eye onto rows that agree (Bouguet): each by half, then x along the baseline."""
    half = _turned_half(R_right_left)
    t = half.T @ t_right_left_m
    x = -t / np.linalg.norm(t)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    base = np.stack([x, y, np.cross(x, y)])
    return base @ half, base @ half.T


def rectified_corners(cameras: tuple[Camera, Camera], R: Float64, t: Float64, px: Float64) -> Float64:
    """(2, ..., 2) normalised coordinates of corners px (2, ..., 2) on the rectified pair."""
    turned = [camera.rays(p) @ turn.T for camera, turn, p in zip(cameras, rectifying(R, t), px)]
    return np.stack([p[..., :2] / p[..., 2:] for p in turned])


def _cameras(calibration: Calibration, state: State) -> tuple[Camera, Camera]:
    left, right = (camera_of(i, lens, calibration.rig.camera(eye).size) for i, lens, eye in zip(state.intrinsics, calibration.lenses, EYES))
    return left, right


def _mean_focal(cameras: Sequence[Camera]) -> float:
    return float(np.mean([(c.fx + c.fy) / 2 for c in cameras]))


def vertical_errors(calibration: Calibration, state: State) -> Float64:
    """(V, n) rows of left corners minus rows of right ones on the rectified pair, pixels; NaN where not both are known."""
    cameras = _cameras(calibration, state)
    bent = rectified_corners(cameras, state.R_right_left, state.t_right_left_m, calibration.views.px)
    return (bent[0, ..., 1] - bent[1, ..., 1]) * _mean_focal(cameras)


def held_out(calibration: Calibration, *, most_folds: int = MOST_FOLDS) -> Float64:
    """(V, n) vertical error of every corner seen by both eyes under a rig solved without its view; NaN elsewhere.

    All corners and views that were given count, those that the solve left out too."""
    problem = calibration.fit.problem
    paired: Bool = np.asarray(np.isfinite(calibration.views.px[..., 0]).any(axis=2).all(axis=0))
    out = np.full(calibration.views.px.shape[1:3], np.nan)
    if paired.sum() < 2:
        return out
    for fold in folds_of(paired, most_folds):
        again = fit(problem.without_views(fold), calibration.fit.state, steps=25)
        try:
            out[fold] = vertical_errors(calibration, again.state)[fold]
        except RigError:  # without these views the lens folds over inside the frame: the others do not hold it
            out[fold] = np.inf
    out[~np.isfinite(calibration.views.px[..., 0]).all(axis=0)] = np.nan
    return out


def halves(calibration: Calibration) -> tuple[Float64, Float64] | None:
    """(rows, columns) a eye: by how many pixels the odd views' lens and the even views' disagree; None where views are too few.

    The two camera frames may be turned against each other, which no picture can tell: the turn that fits the middle of the
    frame best is undone first."""
    views = np.flatnonzero(calibration.kept.any(axis=(0, 2)))
    if len(views) < 8 or calibration.known.rig is not None:
        return None
    cameras = []
    for part in (0, 1):
        out = np.ones(len(calibration.views), dtype=bool)
        out[views[part::2]] = False
        try:
            cameras.append(_cameras(calibration, fit(calibration.fit.problem.without_views(out), calibration.fit.state).state))
        except RigError:
            return None
    left, right = (_disagreement(odd, even) for odd, even in zip(*cameras))
    return left, right


def _disagreement(one: Camera, other: Camera) -> Float64:
    grid = frame_grid(one.size)
    rays = one.rays(grid)
    there = other.rays(grid)
    inner = (slice(GRID[1] // 5, -(GRID[1] // 5)), slice(GRID[0] // 5, -(GRID[0] // 5)))
    a, b = (r[inner].reshape(-1, 3) / np.linalg.norm(r[inner].reshape(-1, 3), axis=1, keepdims=True) for r in (rays, there))
    u, _, vt = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return np.linalg.norm(other.project(rays @ turn.T) - grid, axis=-1)


def corners_in_space(calibration: Calibration, state: State | None = None) -> Float64:
    """(V, n, 3) corners triangulated from both eyes alone, rectified left frame, metres; NaN where not both see them."""
    state = calibration.fit.state if state is None else state
    bent = rectified_corners(_cameras(calibration, state), state.R_right_left, state.t_right_left_m, calibration.views.px)
    Z = np.linalg.norm(state.t_right_left_m) / (bent[0, ..., 0] - bent[1, ..., 0])
    return np.stack([bent[0, ..., 0] * Z, bent[:, ..., 1].mean(axis=0) * Z, Z], axis=-1)


def neighbours(points_m: Float64) -> tuple[IntArray, IntArray]:
    """Pairs of corners that are one square apart, as two index arrays."""
    apart = np.linalg.norm(points_m[:, None] - points_m[None], axis=-1)
    pitch = np.median(np.where(apart > 0, apart, np.inf).min(axis=1))
    i, j = np.nonzero(np.triu(np.abs(apart - pitch) < 0.01 * pitch))
    return i, j


def squares(calibration: Calibration) -> tuple[float, float, float]:
    """Mean and sd of triangulated square sides over the plan's, and their sd over the sides of the board as solved."""
    points = corners_in_space(calibration)
    i, j = neighbours(calibration.views.points_m)
    side = np.linalg.norm(points[:, i] - points[:, j], axis=-1)
    share = side / np.linalg.norm(calibration.views.points_m[i] - calibration.views.points_m[j], axis=-1)
    own = side / np.linalg.norm(calibration.board_m[i] - calibration.board_m[j], axis=-1)
    known = np.isfinite(share) & calibration.paired[:, None]
    if not known.any():
        return float("nan"), float("nan"), float("nan")
    return float(share[known].mean()), float(share[known].std()), float(own[known].std())


def tilts_deg(found: Fit) -> Float64:
    """(V,) angle between each board and the left picture's plane; NaN for views not used."""
    used = found.problem.seen.any(axis=(0, 2))
    return np.where(used, np.degrees(np.arccos(np.clip(np.abs(found.state.R[:, 2, 2]), 0, 1))), np.nan)


def validate(calibration: Calibration, *, distances_m: Sequence[float] = DISTANCES_M, disparity_sigma_px: float = 0.25) -> Quality:
    """Everything that says how good a calibration is, and what to shoot again."""
    from stereorelight.calibration.verdict import judge

    errors = np.abs(held_out(calibration))
    used = errors[calibration.paired]
    by_view = np.array([row[~np.isnan(row)].mean() if not np.isnan(row).all() else np.nan for row in errors])
    mean, spread, own = squares(calibration)
    quality = Quality(
        held_out_px=used[~np.isnan(used)],
        held_out_all_px=errors[~np.isnan(errors)],
        held_out_by_view_px=by_view,
        halves_px=halves(calibration),
        square_spread=spread,
        square_spread_own=own,
        square_mean=mean,
        tilt_deg=tilts_deg(calibration.fit),
        answers=answers(calibration, distances_m, disparity_sigma_px=disparity_sigma_px),
        advice=(),
        figures={},
    )
    maps = {eye: projection_sigma(calibration, eye) for eye in EYES}
    cover = {eye: coverage(calibration, eye) for eye in EYES}
    advice = judge(calibration, quality, maps, cover)
    return replace(quality, advice=advice, figures=_figures(calibration, quality, maps))


def _figures(calibration: Calibration, quality: Quality, maps: dict[Any, Float64]) -> dict[str, Any]:
    """Plain numbers for `Rig.quality` and for scripts."""
    paired: Bool = calibration.paired
    return {
        "views": len(calibration.views),
        "views_paired": int(paired.sum()),
        "corners": int(np.isfinite(calibration.views.px[..., 0]).sum()),
        "corners_left_out": int(np.isfinite(calibration.views.px[..., 0]).sum() - calibration.kept.sum()),
        "lenses": list(calibration.lenses),
        "board": "free" if calibration.fit.problem.free_board else "true",
        "rms_px": calibration.rms_px,
        "rms_all_px": calibration.rms_all_px,
        "rms_before_px": calibration.rms_before_px,
        "corner_sigma_px": calibration.sigma_px,
        "view_excess": calibration.view_excess,
        "held_out_vertical_px": quality.held_out_mean_px,
        "held_out_vertical_95_px": quality.held_out_95_px,
        "held_out_vertical_all_px": float(quality.held_out_all_px.mean()) if len(quality.held_out_all_px) else float("nan"),
        "square_spread": quality.square_spread,
        "square_spread_own": quality.square_spread_own,
        "projection_sigma_px": {eye: {"median": float(np.nanmedian(m)), "worst": float(np.nanmax(m))} for eye, m in maps.items()},
        "standard_errors": standard_errors(calibration),
        "depth": [answer.to_dict() for answer in quality.answers],
    }


def with_quality(rig: Rig, quality: Quality) -> Rig:
    """The rig, carrying what its calibration says of itself."""
    words = [{"name": a.name, "level": a.level, "words": a.words, "remedy": a.remedy} for a in quality.advice]
    return replace(rig, quality={"verdict": quality.verdict, "advice": words, **_plain(quality.figures)})


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
