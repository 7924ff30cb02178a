"""Equal shares: the curve that gives one set of numbers the distribution of another, by counting.

In: tone levels, 0 to `LEVELS` - 1, of three channels.  Out: how many pixels have each, (3, LEVELS), and curves from one count to another."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32, Float64, Int64, UInt16
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.tone import LEVELS

QUANTILES = 256
BANDS = 4  # of rows that are counted each for itself


@njit(cache=True, nogil=True, error_model="numpy")
def _count(step, picture, counts):
    H, W = picture.shape[:2]
    for y in range(0, H, step):
        for x in range(0, W, step):
            for c in range(3):
                counts[c, picture[y, x, c]] += 1


def counts_of(picture: UInt16, *, step: int = 1) -> Int64:
    """(3, LEVELS) pixels of each level in every `step`-th row and column of (H, W, 3)."""
    counts = np.zeros((3, LEVELS), np.int64)
    _count(step, picture, counts)
    return counts


@njit(cache=True, nogil=True, error_model="numpy")
def _count_pairs(first, end, step, left, right, disparity, seen, mine, theirs):
    W = seen.shape[1]
    for row in range(first, end):
        y = row * step
        for x in range(0, W, step):
            if seen[y, x]:
                # The nearest pixel and no value between two: what is interpolated is calmer, and its distribution narrower.
                lands = int(np.rint(x - np.float64(disparity[y, x])))
                if 0 <= lands < W:
                    for c in range(3):
                        mine[c, left[y, x, c]] += 1
                        theirs[c, right[y, lands, c]] += 1


def counts_of_pairs(left: UInt16, right: UInt16, disparity: Float32, seen: Bool, *, step: int) -> tuple[Int64, Int64]:
    """Pixels of each level, (3, LEVELS) of either eye, among points that both see: every `step`-th row and column of the left eye where `seen`,
    and where a disparity (H, W) px puts them in the right one."""
    rows = -(-seen.shape[0] // step)
    each = max(1, -(-rows // BANDS))
    mine, theirs = (np.zeros((BANDS, 3, LEVELS), np.int64) for _ in range(2))

    def count(first: int, end: int) -> None:
        band = first // each
        _count_pairs(first, end, step, left, right, disparity, seen, mine[band], theirs[band])

    in_row_blocks(count, rows, block_rows=each)
    return mine.sum(axis=0), theirs.sum(axis=0)


@njit(cache=True, nogil=True, error_model="numpy")
def _level_at(counts, share):
    """Levels below which these shares of what was counted lie."""
    upto = np.cumsum(counts)
    return np.interp(share, upto / upto[-1] + np.arange(LEVELS) * 1e-12, np.arange(LEVELS).astype(np.float64))


@njit(cache=True, nogil=True, error_model="numpy")
def _equal_shares(mine, theirs, out):
    at = np.linspace(0, 1, QUANTILES)
    for c in range(3):
        # Rising positions for np.interp: equal quantiles (clipped areas) are set apart by far less than a level.
        positions = _level_at(mine[c], at) + np.arange(QUANTILES) * 1e-6
        out[c] = np.interp(np.arange(LEVELS).astype(np.float64), positions, _level_at(theirs[c], at))


def equal_shares(mine: Int64, theirs: Int64) -> Float64:
    """(3, LEVELS) levels of theirs, by level of mine: curves that give one set of counted pixels the distribution of the other, channel by
    channel."""
    out = np.empty((3, LEVELS))
    _equal_shares(mine, theirs, out)
    return out
