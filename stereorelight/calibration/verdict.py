"""The verdict: figures of a calibration put into words, each with what to shoot again.

In: a `Calibration`, its `Quality` and maps.  Out: `Advice`, in the order in which a person should read it."""

from __future__ import annotations

from typing import Any

import numpy as np

from stereorelight.arrays import Float64, Int32
from stereorelight.calibration import validate as v
from stereorelight.calibration.answer import EYES, Calibration
from stereorelight.calibration.uncertainty import standard_errors
from stereorelight.camera import Eye

TILT = "shoot 10 more views with the board turned by 30 to 45 degrees: left, right, up, down and towards the frame's corners"


def judge(calibration: Calibration, quality: v.Quality, maps: dict[Eye, Float64], cover: dict[Eye, Int32]) -> tuple[v.Advice, ...]:
    """Every judged property of the calibration."""
    out: list[v.Advice | None] = [_views(calibration), _held_out(quality)]
    if calibration.known.rig is None:
        out += [_focal(calibration, quality), *(_frame(eye, maps[eye], cover[eye]) for eye in EYES), _size(calibration)]
    out += [_left_out(calibration), _excess(calibration), _board(calibration, quality), _depth(quality)]
    return tuple(a for a in out if a is not None)


def _level(value: float, warn: float, bad: float) -> v.Level:
    return "good" if value <= warn else "warn" if value <= bad else "bad"


def _views(c: Calibration) -> v.Advice:
    paired, all_views = int(c.paired.sum()), len(c.views)
    words = f"{paired} of {all_views} views show the board to both eyes and fit"
    if c.known.rig is not None:
        level: v.Level = "good" if paired >= 3 else "warn"
        return v.Advice(name="views", level=level, words=words, remedy="" if level == "good" else "shoot at least three views", value=paired)
    level = "good" if paired >= v.GOOD_VIEWS else "warn" if paired >= v.FEW_VIEWS else "bad"
    remedy = "" if level == "good" else f"shoot {max(20 - paired, 5)} more: every part of the frame, tilted 30 to 45 degrees"
    return v.Advice(name="views", level=level, words=words, remedy=remedy, value=paired)


def _held_out(q: v.Quality) -> v.Advice:
    mean, high = q.held_out_mean_px, q.held_out_95_px
    if not np.isfinite(mean):
        words = "the lens cannot be held without some of the views" if len(q.held_out_px) else "too few views to leave any out"
        return v.Advice(name="held-out", level="bad", words=words, remedy="shoot 20 views that fill the frame, its corners too")
    worst = int(np.nanargmax(q.held_out_by_view_px))
    words = f"rows of a view that the solve has not seen agree to {mean:.3f} px (95 %: {high:.3f})"
    level = _level(mean, v.GOOD_VERTICAL_PX, v.BAD_VERTICAL_PX)
    remedy = (
        "" if level == "good" else f"look at view {worst + 1} first: {q.held_out_by_view_px[worst]:.2f} px; hold the board still, lock focus and zoom"
    )
    return v.Advice(name="held-out", level=level, words=words, remedy=remedy, value=mean)


def _focal(c: Calibration, q: v.Quality) -> v.Advice:
    errors = standard_errors(c)
    share = max(errors[f"{eye}.{f}"] / getattr(c.rig.camera(eye), f) for eye in EYES for f in ("fx", "fy"))
    tilts = q.tilt_deg[np.isfinite(q.tilt_deg)]
    tilted = float(np.percentile(tilts, 75)) if len(tilts) else 0.0
    flat = tilted < v.LITTLE_TILT_DEG
    level = _level(share, v.SURE_FOCAL, v.UNSURE_FOCAL)
    if flat and level != "bad":
        level = "bad" if share > v.SURE_FOCAL else "warn"
    words = f"the focal length is known to {100 * share:.2f} % (one sigma); three quarters of the boards are tilted by less than {tilted:.0f} degrees"
    if flat:
        words += ", and frontal boards do not show the focal length"
    remedy = TILT if level != "good" or tilted < v.GOOD_TILT_DEG else ""
    if level == "good" and remedy:
        level = "note"
    return v.Advice(name="focal", level=level, words=words, remedy=remedy, value=share)


def _frame(eye: Eye, sigma: Float64, counts: Int32) -> v.Advice:
    hit = counts > 0
    share, worst = float(hit.mean()), float(np.nanmax(sigma))
    empty = _empty_places(hit)
    levels = (_level(worst, v.SURE_CORNER_PX, v.UNSURE_CORNER_PX), _level(-share, -v.GOOD_COVERAGE, -v.POOR_COVERAGE))
    level = max(levels, key=v.LEVELS.index)
    if levels[0] == "good" and level != "good":
        level = "note"  # the frame is not covered, yet the lens is known there
    words = f"{eye} eye: corners seen in {share:.0%} of the frame; a pixel is known to {np.nanmedian(sigma):.2f} px, at worst to {worst:.2f} px"
    if empty:
        words += f"; none in the {', '.join(empty)}"
    remedy = (
        "" if level == "good" else f"shoot views with the board in the {', '.join(empty) or 'corners of the frame'}, tilted, right out to the edge"
    )
    return v.Advice(name=f"frame {eye}", level=level, words=words, remedy=remedy, value=worst)


def _empty_places(hit: Any) -> list[str]:
    """Which ninths of the frame hold hardly any corner, in words."""
    rows, columns = hit.shape
    names = []
    for i, down in enumerate(("top", "middle", "bottom")):
        for j, across in enumerate(("left", "centre", "right")):
            cell = hit[i * rows // 3 : (i + 1) * rows // 3, j * columns // 3 : (j + 1) * columns // 3]
            if cell.mean() < 0.25:
                names.append("centre" if down == "middle" and across == "centre" else f"{down} {across}")
    return names


def _size(c: Calibration) -> v.Advice:
    areas = []
    for e, eye in enumerate(EYES):
        w, h = c.rig.camera(eye).size
        for view, kept in zip(c.views.px[e], c.kept[e]):
            if kept.sum() >= 6:
                span = view[kept].max(axis=0) - view[kept].min(axis=0)
                areas.append(float(span[0] * span[1] / (w * h)))
    share = float(np.median(areas)) if areas else 0.0
    small = share < v.SMALL_BOARD
    words = f"the board fills {share:.0%} of the frame in the middling view"
    remedy = "bring the board nearer until it fills a quarter of the frame, or use a larger one" if small else ""
    return v.Advice(name="board size", level="warn" if small else "good", words=words, remedy=remedy, value=share)


def _left_out(c: Calibration) -> v.Advice:
    whole = [o for o in c.outliers if not o.ids]
    corners = sum(len(o.ids) for o in c.outliers)
    total = int(np.isfinite(c.views.px[..., 0]).sum())
    views = sorted({o.view for o in whole})
    words = f"RMS {c.rms_px:.3f} px without the {corners} bad corners and {len(views)} bad views, {c.rms_all_px:.3f} px with all {total} corners"
    if whole:
        words += f"; view {whole[0].name}: {whole[0].reason}"
    apart = [o for o in whole if "not together" in o.reason]
    share = len(views) / max(len(c.views), 1)
    level: v.Level = "good" if not whole and corners < 0.02 * total else "note" if share <= 0.1 and corners < 0.05 * total else "warn"
    if share > 1 / 3:
        level = "bad"
    remedy = ""
    if apart:
        remedy = "check that the eyes run in step (genlock, or a clap in both movies), and hold the board still for every view"
    elif level in ("warn", "bad"):
        remedy = "look at these pictures: blur, a hand over the board, glare, or the wrong board"
    return v.Advice(name="left out", level=level, words=words, remedy=remedy, value=float(corners))


def _excess(c: Calibration) -> v.Advice | None:
    if c.view_excess < v.BIG_EXCESS:
        return None
    words = f"views disagree {c.view_excess:.1f} times more than their corners scatter; the stated uncertainty allows for it"
    remedy = "glue the board to glass or aluminium, lock focus, zoom and stabiliser, and hold it still: eyes a moment apart see it in two places"
    return v.Advice(name="views disagree", level="note", words=words, remedy=remedy, value=c.view_excess)


def _board(c: Calibration, q: v.Quality) -> v.Advice | None:
    if not np.isfinite(q.square_spread):
        return None
    words = f"squares measured by the rig spread by {100 * q.square_spread:.2f} %"
    if c.fit.problem.free_board:
        stray = c.board_m - c.views.points_m
        i, j = v.neighbours(c.views.points_m)
        side = float(np.linalg.norm(c.views.points_m[i] - c.views.points_m[j], axis=-1).mean())
        flat, across = (float(np.sqrt((part**2).mean())) / side for part in (stray[:, :2], stray[:, 2]))
        words += f"; the board itself is off its plan by {100 * flat:.2f} % of a square in its plane and {100 * across:.2f} % across it"
        words += ", and was solved for"
    return v.Advice(name="squares", level="good", words=words, value=q.square_spread)


def _depth(q: v.Quality) -> v.Advice | None:
    known = [a for a in q.answers if np.isfinite(a.depth_rig_mm)]
    if not known:
        return None
    rig_bound = [a for a in known if a.depth_rig_mm > a.depth_match_mm]
    words = "; ".join(
        f"at {a.distance_m:g} m depth is known to {a.depth_mm:.3g} mm ({a.depth_rig_mm:.2g} from the rig), normals to {a.normal_deg:.2g} degrees "
        f"({a.normal_rig_deg:.2g} from the rig)"
        for a in known
    )
    level: v.Level = "warn" if rig_bound else "good"
    remedy = "the rig, not the matching, limits depth: shoot more tilted views that fill the frame" if rig_bound else ""
    return v.Advice(name="depth", level=level, words=words, remedy=remedy, value=known[0].depth_mm)
