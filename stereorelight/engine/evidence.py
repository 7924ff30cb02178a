"""What the pictures ask of a surface, round after round: what is left between them, and what that is worth.

In: grey pictures (H, W) float32, rows agreeing, their row splines, a disparity (H, W) px, and what is seen of it.  Out: (H, W) float32."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.locking import Tables
from stereorelight.engine.photometric import differences, evidence_row
from stereorelight.engine.pyramid import halve
from stereorelight.engine.rows import BLOCK_ROWS
from stereorelight.engine.turns import shared, together, turns_of
from stereorelight.engine.windows import Seen, less_means, row_sum_square_9

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def _left_over(turns, left, left_spline, right_spline, disparity, here, per_7, differ, change, residual, rate):
    H = left.shape[0]
    step = np.int64(0)
    for first, end in shared(turns, step, H, BLOCK_ROWS):
        differences(first, end, left, left_spline, right_spline, disparity, here, differ, change)
    step += 1
    for first, end in shared(turns, step, H, BLOCK_ROWS):
        less_means(first, end, differ, change, here, per_7, residual, rate)


def left_over(left: Float32, left_spline: Float32, right_spline: Float32, disparity: Float32, seen: Seen) -> tuple[Float32, Float32]:
    """`spline_residual` of what is `seen`, less its local means: a difference of brightness over a neighbourhood is exposure, not disparity."""
    differ, change, residual, rate = (np.empty_like(left) for _ in range(4))
    together(_left_over, turns_of(2), left, left_spline, right_spline, disparity, seen.here, seen.per_7, differ, change, residual, rate)
    return residual, rate


@njit(cache=True, nogil=True, error_model="numpy")
def _held(first, end, disparity, residual, rate, trust, seen, per, matched, tuning, locking, steepness, noise, weight, pull):
    usual9, floor2, grain2, prior_unseen, prior_seen = tuning
    W = disparity.shape[1]
    wide, noise2, rate2 = np.empty(W + 8, np.float32), np.empty(W, np.float32), np.empty(W, np.float32)
    for y in range(first, end):
        row_sum_square_9(residual, y, usual9, per[y], wide, noise2)
        row_sum_square_9(rate, y, f4(np.inf), per[y], wide, rate2)
        evidence_row(disparity[y], residual[y], rate[y], noise2, floor2, rate2, trust[y], grain2, locking, steepness, noise, weight[y], pull[y])
        for x in range(W):
            prior = prior_seen if seen[y, x] > 0 else prior_unseen
            weight[y, x] += prior
            pull[y, x] += prior * (matched[y, x] - disparity[y, x])


@njit(cache=True, nogil=True, error_model="numpy")
def _held_evidence(turns, disparity, residual, rate, trust, seen, per, matched, tuning, locking, steepness, noise, weight, pull, half, quarter):
    step = np.int64(0)
    for first, end in shared(turns, step, disparity.shape[0], BLOCK_ROWS):
        _held(first, end, disparity, residual, rate, trust, seen, per, matched, tuning, locking, steepness, noise, weight, pull)
    step += 1
    for first, end in shared(turns, step, half.shape[0], BLOCK_ROWS):
        halve(first, end, weight, f4(0.25), f4(0), half)
    step += 1
    for first, end in shared(turns, step, quarter.shape[0], BLOCK_ROWS):
        halve(first, end, half, f4(0.25), f4(0), quarter)


def held_evidence(
    disparity: Float32,
    residual: Float32,
    rate: Float32,
    trust: Float32,
    seen: Seen,
    matched: Float32,
    *,
    most2: float,
    floor2: float,
    grain2: float,
    tables: Tables,
    priors: tuple[float, float],
) -> tuple[Float32, Float32, Float32]:
    """`photometric_evidence`, with the noise of the pictures measured over what is `seen` of 9 x 9, held to a disparity that was `matched`;
    and the weight once more, at a quarter of the size, each pixel the mean of sixteen.

    residual, rate : 0 where nothing is seen.
    most2, floor2  : grey levels squared; a square that counts no more than that for the noise, and what the noise is at least.
    grain2         : variance of either picture's grain, grey levels squared.   tables: of `locking_tables`, what that grain does.
    priors         : weight of the matched disparity, 1/px^2, where nothing is seen, and elsewhere.
    """
    h, w = disparity.shape
    weight, pull = np.empty_like(disparity), np.empty_like(disparity)
    half, quarter = np.empty(((h + 1) // 2, (w + 1) // 2), np.float32), np.empty(((h + 3) // 4, (w + 3) // 4), np.float32)
    tuning = tuple(f4(a) for a in (most2, floor2, grain2, *priors))
    given = (disparity, residual, rate, trust, seen.here, seen.per_9, matched, tuning, *tables, weight, pull, half, quarter)
    together(_held_evidence, turns_of(3), *given)
    return weight, pull, quarter
