"""Which lens model each eye needs, and whether the board is true: chosen by views that the solve has not seen.

In: `StereoViews`.  Out: a `Choice`, with every candidate's figures.
A model with more parameters always has the lower RMS.  What counts is the error on views left out: the lens and the board's
shape come from the others, only the left-out board's pose is fitted.  Among models that are as good within one standard error
the one with the fewest parameters is taken (the one-standard-error rule), and one that folds over or has a pole within the
frame and a tenth of overscan is not taken at all while another is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.answer import EYES, NOTHING_KNOWN, Calibration, Known
from stereorelight.calibration.bundle import Fit, fit
from stereorelight.calibration.outliers import BAD_CORNER, boards_placed, robust_sigma
from stereorelight.calibration.projection import camera_of, checked_lens
from stereorelight.calibration.sightings import StereoViews
from stereorelight.calibration.solve import solve_eye, solve_rig
from stereorelight.camera import Eye
from stereorelight.errors import RigError

CANDIDATES = ("brown4", "brown5", "fisheye", "rational")  # fewest parameters first
BOARDS = ("true", "free")  # taken as drawn, or every corner found where it is
OVERSCAN = 0.1  # of the frame, on each side
OVERSCAN_PRICE = 0.05  # how much more held-out error a lens may have that is sound over the overscan too
FOLDS = 6
FEWEST_VIEWS_FOR_SHAPE = 8  # a board's own shape takes many views to tell from the lenses
MOST_CORNERS_FOR_SHAPE = 200
ONE_STANDARD_ERROR = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """One model tried.  `held_out_px` is the RMS over left-out views, `rms_px` over the views themselves; both robust.

    by_view : (V,) mean squared held-out error of each view, NaN where it shows no board.
    usable  : the model is one to one over the frame and its overscan; `reason` says why not.
    """

    name: str
    parameters: int
    rms_px: float
    held_out_px: float
    by_view: Float64
    usable: bool
    reason: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """The lens of each eye and whether the board's own shape is solved ("true" or "free"), with what was tried."""

    lenses: tuple[str, str]
    board: str
    tried: tuple[tuple[Candidate, ...], tuple[Candidate, ...]]
    boards: tuple[Candidate, ...]


def folds_of(usable: Bool, folds: int) -> list[Bool]:
    """Masks (V,) of the views left out, fold by fold; each usable view is left out once, neighbours in different folds."""
    views = np.flatnonzero(usable)
    number = np.arange(len(views)) % max(min(folds, len(views)), 1)
    out = []
    for k in range(int(number.max(initial=-1)) + 1):
        mask = np.zeros(len(usable), dtype=bool)
        mask[views[number == k]] = True
        out.append(mask)
    return out


def held_out_squares(found: Fit, folds: int = FOLDS) -> Float64:
    """(V,) mean squared error of each view's corners, in sigmas of the weights, under the rig of the other folds' views."""
    seen = found.problem.seen
    in_view: Bool = np.asarray(seen.any(axis=(0, 2)))
    sigma = max(robust_sigma(found), 1e-12)
    by_view = np.full(len(in_view), np.nan)
    for out in folds_of(in_view, folds):
        trained = fit(found.problem.without_views(out), found.state, scale=BAD_CORNER * sigma, steps=25)
        placed = boards_placed(found.problem.without_views(~out), trained.state, sigma)
        squared = (placed.residual_px**2).sum(axis=-1) * found.problem.weight**2
        clipped = np.where(seen, np.minimum(squared, (BAD_CORNER * sigma) ** 2), 0.0)
        by_view[out] = clipped.sum(axis=(0, 2))[out] / seen.sum(axis=(0, 2))[out]
    return by_view


def _overscan_problem(found: Fit, lens: str, size: tuple[int, int]) -> tuple[bool, str]:
    """Whether the lens is one to one over the frame (False: refused), and what is wrong over the overscan."""
    w, h = size
    x, y = round(OVERSCAN * w), round(OVERSCAN * h)
    try:
        camera = camera_of(found.state.intrinsics[0], lens, size)
    except RigError:
        return False, "folds over inside the frame"
    try:
        camera.cropped(-x, -y, (w + 2 * x, h + 2 * y))
    except RigError:
        return True, f"folds over within {OVERSCAN:.0%} of overscan"
    return True, ""


def eye_candidates(
    views: StereoViews, eye: Eye, size: tuple[int, int], *, candidates: Sequence[str] = CANDIDATES, focal_px: tuple[float, float] | None = None
) -> tuple[Candidate, ...]:
    """Every candidate lens of one eye with its held-out error.  Raises RigError where too few views show the board."""
    out = []
    for name in candidates:
        found = solve_eye(views, eye, size, name, focal_px=focal_px)
        inside, reason = _overscan_problem(found, name, size)
        by_view = held_out_squares(found) if inside else np.full(len(views), np.nan)
        out.append(
            Candidate(
                name=name,
                parameters=4 + checked_lens(name)[1],
                rms_px=float(np.sqrt(np.nanmedian((found.residual_px**2).sum(axis=-1)) / np.log(2))),
                held_out_px=float(np.sqrt(np.nanmean(by_view))) if inside else float("inf"),
                by_view=by_view,
                usable=inside and not reason,
                reason=reason,
            )
        )
    return tuple(out)


def simplest(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate with the fewest parameters whose held-out error is the best one's within a standard error.

    Where that one folds over in the overscan, the best that does not is taken instead, if it costs no more than `OVERSCAN_PRICE`."""
    inside = [c for c in candidates if np.isfinite(c.held_out_px)]
    if not inside:
        raise RigError("every lens model folds over inside the frame; shoot views that reach the frame's corners, and check the board's spec")
    chosen = _within_one_error(inside)
    if not chosen.usable:
        whole = [c for c in inside if c.usable and c.held_out_px <= chosen.held_out_px * (1 + OVERSCAN_PRICE)]
        chosen = _within_one_error(whole) if whole else chosen
    return chosen


def _within_one_error(pool: Sequence[Candidate]) -> Candidate:
    best = min(pool, key=lambda c: c.held_out_px)
    for candidate in sorted(pool, key=lambda c: (c.parameters, c.held_out_px)):
        worse = candidate.by_view - best.by_view
        known = worse[np.isfinite(worse)]
        if known.mean() <= ONE_STANDARD_ERROR * known.std(ddof=1) / np.sqrt(len(known)):
            return candidate
    return best


def choose(
    views: StereoViews,
    sizes: tuple[tuple[int, int], tuple[int, int]],
    known: Known = NOTHING_KNOWN,
    *,
    candidates: Sequence[str] = CANDIDATES,
    boards: Sequence[str] = BOARDS,
) -> tuple[Choice, Calibration]:
    """The lens of each eye, whether the board's own shape pays, and the rig solved with them.

    candidates : lens models to try; one alone is taken as it is.   boards : "true" and "free", or one of them alone.
    Raises     : RigError where the views cannot give a rig, with what to shoot.
    """
    for name in candidates:
        checked_lens(name)
    tried: list[tuple[Candidate, ...]] = []
    lenses = []
    for e, eye in enumerate(EYES):
        fixed = known.rig is not None or len(candidates) == 1
        own = () if fixed else eye_candidates(views, eye, sizes[e], candidates=candidates, focal_px=known.focal_px[e])
        tried.append(own)
        lenses.append(candidates[0] if fixed else simplest(own).name)
    first = _solved(views, sizes, _ranked(lenses, tried), known, boards[0] == "free")
    if len(boards) == 1 or int(first.paired.sum()) < FEWEST_VIEWS_FOR_SHAPE or len(views.points_m) > MOST_CORNERS_FOR_SHAPE:
        return Choice(lenses=first.lenses, board=boards[0], tried=(tried[0], tried[1]), boards=()), first
    solved = {boards[0]: first, **{b: solve_rig(views, sizes, first.lenses, known, free_board=b == "free") for b in boards[1:]}}
    judged = []
    for board, one in solved.items():
        by_view = held_out_squares(one.fit) * (one.sigma_px * one.view_excess) ** 2  # square pixels, so that all compare
        parameters = int(one.fit.problem.free.sum())
        held_out = float(np.sqrt(np.nanmean(by_view)))
        judged.append(Candidate(name=board, parameters=parameters, rms_px=one.rms_px, held_out_px=held_out, by_view=by_view, usable=True))
    # No parsimony here: how far the board may stray is learned, so a true one costs nothing, while one taken for true that is not
    # biases the lenses by several of their stated sigmas.
    board = min(judged, key=lambda c: c.held_out_px).name
    return Choice(lenses=first.lenses, board=board, tried=(tried[0], tried[1]), boards=tuple(judged)), solved[board]


def _ranked(lenses: Sequence[str], tried: Sequence[tuple[Candidate, ...]]) -> list[tuple[str, str]]:
    """The chosen pair of lenses, then pairs of the next best, simplest first, should that one fold over in the joint solve."""
    others = [[lens, *(c.name for c in own if np.isfinite(c.held_out_px) and c.name != lens)] for lens, own in zip(lenses, tried)]
    pairs = [(a, b) for a in others[0] for b in others[1]]
    return sorted(pairs, key=lambda pair: others[0].index(pair[0]) + others[1].index(pair[1]))


def _solved(
    views: StereoViews, sizes: tuple[tuple[int, int], tuple[int, int]], pairs: list[tuple[str, str]], known: Known, free_board: bool
) -> Calibration:
    for number, pair in enumerate(pairs):
        try:
            return solve_rig(views, sizes, pair, known, free_board=free_board)
        except RigError as error:
            if "folds over" not in str(error) or number + 1 == len(pairs):
                raise
    raise RigError("no lens model was given to try")
