"""Corners and views that do not fit: found against a robust solution, and named with the reason.

In: a `Problem` and a robust `Fit` of it.  Out: which corners to keep (2, V, n), and an `Outlier` for everything else.
Pixels; sigmas are those of a weighted residual along one axis, from the median, so that bad corners do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.answer import EYES, Outlier
from stereorelight.calibration.bundle import Fit, Problem, State, fit

CAUCHY = 3.0  # sigmas at which a corner's pull is halved, while it is not yet known which corners are bad
BAD_CORNER = 5.0  # sigmas; of a million good corners four are farther off
BAD_VIEW = 5.0  # times the usual median error
BAD_VIEW_PX = 0.5  # and by no less than this: a board held in the hand flexes by less, and such views are kept
BAD_SHARE = 0.4  # of a view's corners: with more of them twice as far off as a bad corner the view is bad
RAYLEIGH_MEDIAN = 1.1774  # median length of a 2-D error with unit sigma along each axis


def robust_sigma(fit: Fit) -> float:
    """One sigma of a weighted residual along one axis, from the median, so that bad corners do not count."""
    length = np.linalg.norm(fit.residual_px, axis=-1) * fit.problem.weight
    known = fit.problem.seen
    return float(np.median(length[known]) / RAYLEIGH_MEDIAN) if known.any() else 0.0


def boards_placed(problem: Problem, state: State, sigma: float) -> Fit:
    """The boards' poses with everything else held, robustly: where left-out views stand, and what their errors are."""
    held = replace(problem, free=np.zeros_like(problem.free), expected_sigma=np.full_like(problem.expected_sigma, np.inf), baseline=None)
    return fit(held, state, scale=max(CAUCHY * sigma, 1e-9), steps=30)


def marked(problem: Problem, found: Fit, sigma: float, names: tuple[str, ...]) -> tuple[Bool, tuple[Outlier, ...]]:
    """Which corners to keep (2, V, n), and the others with their reasons, judged against a robust solution."""
    placed = boards_placed(problem, found.state, sigma)
    length = np.linalg.norm(placed.residual_px, axis=-1)
    seen = problem.seen
    bad = seen & (length * problem.weight > BAD_CORNER * sigma)
    kept, outliers = seen & ~bad, []
    for v in range(seen.shape[1]):
        wrong = [e for e in (0, 1) if seen[e, v].any() and _whole_view_bad(length[e, v], problem.weight[e, v], seen[e, v], sigma)]
        reason = ""
        if wrong and seen[:, v].any(axis=1).all():
            wrong, reason = _whose_fault(problem, placed.state, sigma, v)
        for e in (0, 1):
            if not seen[e, v].any():
                continue
            if e in wrong:
                kept[e, v] = False
                why = reason or "most of its corners do not fit the board"
                outliers.append(Outlier(view=v, name=names[v], eye=EYES[e], ids=(), error_px=_length_rms(length[e, v][seen[e, v]]), reason=why))
            elif bad[e, v].any():
                ids = tuple(int(i) for i in np.flatnonzero(bad[e, v]))
                why = f"farther than {BAD_CORNER:g} sigma from where the board has them"
                outliers.append(Outlier(view=v, name=names[v], eye=EYES[e], ids=ids, error_px=_length_rms(length[e, v][bad[e, v]]), reason=why))
    return kept, tuple(outliers)


def _length_rms(length: Float64) -> float:
    return float(np.sqrt((length**2).mean()))


def _whole_view_bad(length: Float64, weight: Float64, seen: Bool, sigma: float) -> bool:
    off = (length * weight)[seen]
    gross = (off > 2 * BAD_CORNER * sigma).mean() > BAD_SHARE or np.median(off) > BAD_VIEW * RAYLEIGH_MEDIAN * sigma
    return bool(gross and np.median(length[seen]) > BAD_VIEW_PX)


def _whose_fault(problem: Problem, state: State, sigma: float, v: int) -> tuple[list[int], str]:
    """Each eye's picture of view v against the board on its own: which eyes to leave out, and why."""
    alone = []
    for e in (0, 1):
        weight = np.zeros_like(problem.weight)
        weight[e, v] = problem.weight[e, v]
        own = boards_placed(replace(problem, weight=weight), state, sigma)
        length = np.linalg.norm(own.residual_px[e, v], axis=-1)
        alone.append(_whole_view_bad(length, weight[e, v], own.problem.seen[e, v], sigma))
    if alone[0] != alone[1]:
        return [alone.index(True)], f"the {EYES[alone.index(True)]} eye's corners do not fit the board, the other eye's do"
    if alone[0]:
        return [0, 1], "neither eye's corners fit the board"
    return [0, 1], "each eye's corners fit the board, but not together: the board or the rig moved, or the eyes are not of the same moment"
