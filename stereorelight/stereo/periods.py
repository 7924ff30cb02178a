"""Walls that repeat: what was matched a period off is found, and where it belongs.

In: a pair in grey and the disparity of its left eye.  Out: a guide for matching once more.
On tiles, bricks, blinds a wrong disparity costs a pixel hardly more than the right one, and less wherever it falls on whole pixels and the right
one does not; so strips of the wall lie a period off, both eyes agreeing.  No pixel can tell.  But all of a region's pixels together can: what little
the tiles differ by is on the side of the right one at nearly every place, once parts of a pixel are compared fairly."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, Int32
from stereorelight.engine.regions import WINDOW, costs_at, regions, shifted_costs

PITCH_PX = 4  # between the places that are looked at
STEP_PX = 1.5  # from one to the next, where a region goes on
INNER = (3, 3)  # places: about one that speaks for its region all belong to it, or what stands beside it would speak
FEWEST, FIRST_LOOK, MOST = 16, 40, 400  # places of a region that are asked
ASKED = 0.15  # share of them that a shift must keep within the frame and the range
SOFT_PX = 0.8  # of blur, before parts of a pixel are compared
LEAST_PX = 3  # of a period
SUSPECT = 0.35  # share of the first places that a shift is better for, by which more are asked
SIGNIFICANT = 4.0  # standard deviations of the places' vote, were it chance, by which a region is moved
REPEATS = 0.5  # of what shifts cost in the middle: a shift that costs less is a period
AS_WELL = 1.1  # of what a place costs: it goes on in the region beside it, a period away, where that costs less
LEAST_SHARE = 0.01  # of all places, that matching again is worth
LEAST_COST = 1e-3  # grey levels squared


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """The grid of places and its regions.

    disparity : (h, w) px.   label : (h, w) int32, the region of each, -1 where nothing was matched.
    by        : (n + 1,) px by which each region is to move; the last is of no region.
    clear     : (n + 1,) regions whose own places agree on that.
    periods   : (n, 2 count - 1), shifts by 1 - count ... count - 1 px by which a region looks much the same.
    """

    disparity: Float32
    label: Int32
    by: Float32
    clear: Bool
    periods: Bool

    @property
    def surface(self) -> Float32:
        """(h, w) px: where places of clear regions belong; NaN elsewhere."""
        return np.where(self.clear[self.label], self.disparity + self.by[self.label], np.float32(np.nan))


def _at_px(rows: np.ndarray, columns: np.ndarray, size_hw: tuple[int, int]) -> tuple[Int32, Int32, Bool]:
    """Pixels of places, and which of them lie far enough from the borders to be compared."""
    y, x = (PITCH_PX // 2 + PITCH_PX * a.astype(np.int32) for a in (rows, columns))
    return y, x, (y >= WINDOW) & (y < size_hw[0] - WINDOW) & (x >= WINDOW) & (x < size_hw[1] - WINDOW)


def _vote(left: Float32, right: Float32, ys: Int32, xs: Int32, disparity: Float32, low: int, count: int) -> tuple[int | None, Bool]:
    """Whole pixels by which a region is better off, 0 where it lies well, None where its places do not agree; and its periods."""
    for most in (FIRST_LOOK, MOST):
        some = np.linspace(0, ys.size - 1, min(most, ys.size)).astype(np.intp)
        costs = shifted_costs(left, right, ys[some], xs[some], disparity[some], low, count)
        costs, here = np.log(costs + np.float32(LEAST_COST)), np.log(costs[:, [count - 1]] + np.float32(LEAST_COST))
        both = np.isfinite(costs) & np.isfinite(here)
        asked = both.sum(axis=0)
        could = asked >= max(ASKED * some.size, FEWEST)
        could[count - LEAST_PX : count - 1 + LEAST_PX] = False
        if not could.any():
            return 0, could
        more = np.where(both, costs - np.where(both, here, 0), 0)
        share, mean = (np.where(could, a.sum(axis=0) / np.maximum(asked, 1), 0) for a in (more < 0, more))
        periods = could & (mean < REPEATS * np.median(mean[could]))
        best = int(share.argmax())
        if share[best] < SUSPECT:
            return 0, periods
    if share[best] < 0.5 + SIGNIFICANT / 2 / np.sqrt(asked[best]):
        return None, periods
    good = np.flatnonzero(share >= share[best] - 0.05)  # a period that is no whole number is about as good at two
    best = int(good[mean[good].argmin()])
    return (best - (count - 1) if mean[best] < 0 else None), periods


def _judged(left: Float32, right: Float32, disparity: Float32, low: int, count: int) -> Places:
    places = np.ascontiguousarray(disparity[PITCH_PX // 2 :: PITCH_PX, PITCH_PX // 2 :: PITCH_PX])
    label, n = regions(places, step=STEP_PX)
    named = label.astype(np.float32)
    inner = (cv2.erode(named, np.ones(INNER)) == named) & (cv2.dilate(named, np.ones(INNER)) == named) & (label >= 0)
    rows, columns = np.nonzero(inner)
    ys, xs, fits = _at_px(rows, columns, (left.shape[0], left.shape[1]))
    of, ys, xs = label[rows, columns][fits], ys[fits], xs[fits]
    order, size = np.argsort(of, kind="stable"), np.bincount(of, minlength=n)
    start = np.concatenate([[0], np.cumsum(size)])
    by, clear, periods = np.zeros(n + 1, np.float32), np.zeros(n + 1, np.bool_), np.zeros((n, 2 * count - 1), np.bool_)
    for k in np.flatnonzero(size >= FEWEST):
        y, x = (a[order[start[k] : start[k + 1]]] for a in (ys, xs))
        shift, periods[k] = _vote(left, right, y, x, disparity[y, x], low, count)
        clear[k], by[k] = shift is not None, shift or 0
    return Places(disparity=places, label=label, by=by, clear=clear, periods=periods)


def _beside(left: Float32, right: Float32, p: Places, count: int) -> Float32:
    """(h, w) px: where places of no clear region belong: a period away, in the nearest such region to a side of them, if they would be about
    as well off there; NaN elsewhere."""
    surface = p.surface
    rows, columns = np.nonzero(np.isfinite(p.disparity) & np.isnan(surface))
    ys, xs, fits = _at_px(rows, columns, (left.shape[0], left.shape[1]))
    rows, columns, ys, xs = rows[fits], columns[fits], ys[fits], xs[fits]
    here = p.disparity[rows, columns]
    least, best = AS_WELL * costs_at(left, right, ys, xs, here), np.full(here.shape, np.nan, np.float32)
    index = np.arange(surface.size).reshape(surface.shape)
    for turn in range(4):
        known, order = np.rot90(np.isfinite(surface), turn), np.rot90(index, turn)
        last = np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), -1), axis=1)
        nearest = np.rot90(np.where(last < 0, -1, np.take_along_axis(order, np.maximum(last, 0), axis=1)), -turn)[rows, columns]
        there, of = surface.ravel()[nearest], p.label.ravel()[nearest]
        with np.errstate(invalid="ignore"):
            away = np.nan_to_num(np.rint(here - there)).astype(np.intp)
        fits = (nearest >= 0) & (np.abs(away) < count - 1)
        at = count - 1 + np.where(fits, away, 0)
        fits &= p.periods[of, at - 1] | p.periods[of, at] | p.periods[of, at + 1]
        cost = np.full(here.shape, np.inf, np.float32)
        cost[fits] = costs_at(left, right, ys[fits], xs[fits], there[fits])
        least, best = np.where(cost < least, cost, least), np.where(cost < least, there, best)
    out = np.full(surface.shape, np.nan, np.float32)
    out[rows, columns] = best
    return out


def moved(left: Float32, right: Float32, disparity: Float32, low: int, count: int) -> Float32 | None:
    """(H, W) px: where what was matched a period off belongs, NaN elsewhere; None: too little is off to match again.

    left, right : (H, W) grey.   disparity : (H, W) of the left eye, NaN where unmatched.   low, count : whole disparities that were searched.
    A region moves where most of its places are better off by one shift, by far more of them than by chance; what lies in no such region, between
    the wall's strips, goes on in the one beside it if that repeats by as much as lies between them.
    """
    left, right = (cv2.GaussianBlur(eye, (3, 3), SOFT_PX) for eye in (left, right))
    p = _judged(left, right, disparity, low, count)
    if not p.periods.any():
        return None
    there = np.where(p.by[p.label] != 0, p.surface, _beside(left, right, p, count))
    if np.count_nonzero(np.isfinite(there)) < LEAST_SHARE * there.size:
        return None
    nearest = np.ix_(*(np.minimum(np.arange(m) // PITCH_PX, k - 1) for m, k in zip(disparity.shape, there.shape, strict=True)))
    was = p.disparity[nearest]
    with np.errstate(invalid="ignore"):
        same: Bool = np.abs(disparity - was) <= STEP_PX
    return np.where(same, disparity + (there - p.disparity)[nearest], there[nearest])
