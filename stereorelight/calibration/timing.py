"""Whether two eyes' views of a board are of the same moments, and how fast the board moves.

In: `Detection`s of each eye by frame number, corner order agreed.  Out: frames by which the right eye runs late, pixels a frame.
Asked of the epipolar geometry of all corners (views.epipolar_px): no camera has to be known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.calibration.board import Board
from stereorelight.calibration.corners import Detection, turned, turns
from stereorelight.calibration.views import FEWEST_TOGETHER, epipolar_px, reflected

TIME_GAIN = 0.6  # an offset in time must leave this much less than none
LEAST_GAIN_PX = 0.1  # and be better by at least this
MOST_LATE = 4.0  # frames over which corners are taken to move evenly


def time_offset(left: Mapping[int, Detection], right: Mapping[int, Detection], *, most: int = 8) -> tuple[int, Mapping[int, float]]:
    """By how many frames the right eye runs late (right frame = left frame + offset), and the epipolar error of each offset in pixels.

    0 where no other offset leaves clearly less, so also for stills and for a board that never moves."""
    errors: dict[int, float] = {}
    for offset in range(-most, most + 1):
        both = [f for f in left if f + offset in right]
        if len(both) >= max(FEWEST_TOGETHER, 0.5 * min(len(left), len(right))):
            value = epipolar_px([left[f] for f in both], [right[f + offset] for f in both])
            if math.isfinite(value):
                errors[offset] = value
    if not errors:
        return 0, errors
    best = min(errors, key=lambda k: (errors[k], abs(k)))
    return (best if errors[best] < TIME_GAIN * errors.get(0, math.inf) else 0), errors


def movement_px(detections: Mapping[int, Detection]) -> dict[int, float]:
    """Pixels a frame by which the board moves about each frame (the larger of before and after); NaN where no neighbour saw it."""
    speed = {}
    for f, d in detections.items():
        steps = []
        for near in (f - 1, f + 1):
            if near in detections:
                _, i, j = np.intersect1d(d.ids, detections[near].ids, return_indices=True)
                if len(i):
                    steps.append(float(np.linalg.norm(d.px[i] - detections[near].px[j], axis=1).mean()))
        speed[f] = max(steps) if steps else math.nan
    return speed


@dataclass(frozen=True, kw_only=True)
class Late:
    """By how many frames the right eye runs late (0.0 where that cannot be told), and the epipolar error with and without, pixels."""

    frames: float
    error_px: float
    error_in_step_px: float


def velocity_px(now: Detection, later: Detection, board: Board, *, mirrored: bool = False) -> tuple[Float64, Float64]:
    """Which corners of `now` are in the next frame's `later` too (k,), as places in now.ids, and how far they moved (k, 2).

    mirrored : this eye is the mirrored one, and `now` has been flipped back."""
    if mirrored:
        later = reflected(later, board) if board.kind == "chessboard" else later.flipped()
    ways = [turned(later, board, k) for k in range(0, 4, 4 // turns(board))] if turns(board) > 1 else [later]
    best: tuple[Float64, Float64] | None = None
    for way in ways:
        _, i, j = np.intersect1d(now.ids, way.ids, return_indices=True)
        step = way.px[j] - now.px[i]
        if best is None or np.abs(step).sum() < np.abs(best[1]).sum():
            best = np.asarray(i), step
    assert best is not None
    return best


def right_late(left: Mapping[int, Detection], right: Mapping[int, Detection], moves: Mapping[int, tuple[Float64, Float64]]) -> Late:
    """By how much the right eye runs late, parts of a frame too, from how its corners move (`velocity_px` by frame).

    A right eye that is d frames late shows a corner where it will have moved on from in d frames: put there by its own movement, it
    meets the left eye's epipolar line."""
    both = [f for f in left if f in right and f in moves and len(moves[f][0])]
    ours, theirs, steps = [], [], []
    for f in both:
        i, step = moves[f]
        moving = np.zeros(len(right[f]), bool)
        moving[i] = True
        part = right[f].where(moving)
        ours.append(left[f])
        theirs.append(part)
        steps.append(step)
    if len(both) < FEWEST_TOGETHER:
        return Late(frames=0.0, error_px=math.nan, error_in_step_px=math.nan)

    def error(late: float) -> float:
        return epipolar_px(ours, [replace(d, px=d.px + late * step) for d, step in zip(theirs, steps)])

    in_step = error(0.0)
    best, least = 0.0, in_step
    for width, spacing in ((MOST_LATE, 0.25), (0.25, 0.05)):
        for late in np.arange(best - width, best + width + spacing / 2, spacing):
            tried = error(float(late))
            if tried < least:
                best, least = float(late), tried
    if not (least < TIME_GAIN * in_step and in_step - least > LEAST_GAIN_PX):
        best, least = 0.0, in_step
    return Late(frames=round(best, 2), error_px=least, error_in_step_px=in_step)
