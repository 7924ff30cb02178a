"""Corners to a hundredth of a pixel: the two edges that cross there fitted to the picture's own levels.

In: a grey picture (H, W) float32 in 8-bit levels as encoded, and corners as a detector gave them (pixels).  Out: `Refined`.
The board's own geometry says how each window lies (pitch, perspective, the lens's bend of the edges) and what else is in it
(markers are left out).  Motion during the exposure is fitted where the edges say that there is some.  The picture's tone from
black to white and the blur's tail are fitted to all corners together, whatever curve the camera recorded.  See engine/corner_model.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.calibration.board import APRILGRID_BORDER_BITS, Board
from stereorelight.engine.corner_model import NO_TONE
from stereorelight.engine.corners import fit_corners

REACH = {"chessboard": 0.5, "charuco": 0.6, "aprilgrid": 0.27}  # half the window, in squares
FIRST_REACH = {"chessboard": 0.38, "charuco": 0.3, "aprilgrid": 0.24}
MOST_RADIUS_PX = 24.0  # a wider window costs more than it tells
CUBIC_FROM, QUADRATIC_FROM = 24, 12  # corners that carry the lens's bend
BLUR_FOR_MOTION_PX = 1.35  # s above which movement is tried
TRIED_FOR_MOTION = 16
MOTION_PAYS = 0.97  # of the squared residual
FURTHEST, FURTHEST_PX = 0.1, (1.5, 6.0)  # of a square, and in pixels: how far a detector may have been off
CLIP_LEVELS = 1.0  # an 8-bit picture clips within a level of its ends
FEWEST_SHARED, TRIED_FOR_SHARED, SHARED_TURNS = 12, 24, 3
MOST_CLIPPED = 0.1  # of the pixels about the board
QUANTUM = 0.29  # levels, of 8 bits
SHARED_WIDTH = np.array([1.0, 3.0])  # how large the blur's tail and the tone's factor may be expected
SHARED_MOST = np.array([2.0, 8.0])
# The tail that leaves the smallest residual overshoots, since the series is cut short after it: of discs, Gaussians and bare pixels,
# this share of it leaves corners truest.
TAIL_SHARE = 0.6
NEIGHBOUR_PX = 0.5  # a corner may stand so far off the smooth grid before it is doubted, or 8 times the rest


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """px (n, 2); sigma_px (n,) one axis, NaN where the detector's own corner stayed; refined (n,);
    blur_px: sigma of the picture's blur along its longest and shortest direction; motion_px: movement during exposure;
    contrast: white less black, 8-bit levels; bright_first: whether the quadrant right and below of a corner is the bright one, (n,) +1, -1 or 0;
    rms: what the model left, levels."""

    px: Float64
    sigma_px: Float64
    refined: Bool
    blur_px: tuple[float, float]
    motion_px: tuple[float, float]
    contrast: float
    bright_first: Float64
    rms: float


def grid_map(board_xy: Float64, px: Float64, at: Float64 | None = None) -> Float64:
    """(n, 2) pixels of board places `at` by one smooth map (homography, then a polynomial for the lens) through all corners."""
    import cv2

    at = board_xy if at is None else at
    middle = board_xy.mean(axis=0)
    scale = max(float(np.ptp(board_xy, axis=0).max()) / 2, 1e-9)
    a, b = (board_xy - middle) / scale, (at - middle) / scale
    H, _ = cv2.findHomography(a, px, 0)
    if H is None:
        return np.full((len(at), 2), np.nan)

    def flat(p: Float64) -> Float64:
        q = np.concatenate([p, np.ones((len(p), 1))], axis=1) @ H.T
        return q[:, :2] / q[:, 2:]

    degree = 3 if len(a) >= CUBIC_FROM else 2 if len(a) >= QUADRATIC_FROM else 0
    if degree and min(len(np.unique(np.round(a[:, 0], 6))), len(np.unique(np.round(a[:, 1], 6)))) <= degree:
        degree = 0
    if not degree:
        return flat(b)
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]

    def terms(p: Float64) -> Float64:
        return np.asarray(np.stack([p[:, 0] ** i * p[:, 1] ** j for i, j in powers], axis=1), np.float64)

    off = px - flat(a)
    keep = np.ones(len(a), bool)
    weights: Float64 = np.zeros((len(powers), 2))
    for _ in range(3):  # a corner that fits nothing must not bend the rest
        weights = np.asarray(np.linalg.lstsq(terms(a[keep]), off[keep], rcond=None)[0], np.float64)
        left = np.linalg.norm(off - terms(a) @ weights, axis=1)
        keep = left <= max(4 * float(np.median(left)), 0.02)
        if keep.sum() < len(powers) + 4:
            break
    smooth: Float64 = flat(b) + terms(b) @ weights
    return smooth


def local_shapes(board: Board, ids: np.ndarray, px: Float64) -> tuple[Float64, Float64]:
    """(n, 2, 2) squares per pixel and (n, 2) curvature of the two edges (1/px) at each corner."""
    xy, s = board.points_m[ids, :2], board.square_m
    h = 0.35 * s
    steps = [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)]
    there = grid_map(xy, px, np.concatenate([xy + h * np.array(step) for step in steps]))
    at = dict(zip(steps, there.reshape(len(steps), len(xy), 2)))
    across: Float64 = (at[1, 0] - at[-1, 0]) * (s / h / 2)  # pixels per square along the board's x
    down: Float64 = (at[0, 1] - at[0, -1]) * (s / h / 2)
    J = np.stack([across, down], axis=-1)
    shapes = np.asarray(np.linalg.inv(J), np.float64)
    bend_x = (at[1, 0] - 2 * at[0, 0] + at[-1, 0]) * (s / h) ** 2
    bend_y: Float64 = (at[0, 1] - 2 * at[0, 0] + at[0, -1]) * (s / h) ** 2
    n1, n2 = (shapes[:, k] / np.linalg.norm(shapes[:, k], axis=1, keepdims=True) for k in (0, 1))
    bends = np.stack([-np.sum(n1 * bend_y, axis=1) / np.sum(down**2, axis=1), -np.sum(n2 * bend_x, axis=1) / np.sum(across**2, axis=1)], axis=-1)
    return shapes, bends


def bright_quadrants(board: Board, ids: np.ndarray) -> Float64:
    """(n,) +1 where the quadrant right and below of a corner is white on this board, -1 where it is black."""
    nx, _ = board.grid
    odd = ids % 2 if board.kind == "aprilgrid" else (ids % nx + ids // nx) % 2
    signs: Float64 = np.where(odd == 1, 1.0, -1.0)
    return signs


def clean_depths(board: Board, ids: np.ndarray) -> Float64:
    """(n, 4) squares of clean ground around each corner in its quadrants (- -, + -, - +, + +): what lies deeper is a marker."""
    depths = np.full((len(ids), 4), 9.0)
    if board.kind == "charuco" and board.marker_m is not None:
        rim = (1 - board.marker_m / board.square_m) / 2
        nx, _ = board.grid
        white_right_below = (ids % nx + ids // nx) % 2 == 1  # black squares have an even sum; this one is (column + 1, row + 1)
        depths[white_right_below[:, None] & np.array([True, False, False, True])] = rim
        depths[~white_right_below[:, None] & np.array([False, True, True, False])] = rim
    if board.kind == "aprilgrid":
        from stereorelight.calibration.board import marker_bits

        border = APRILGRID_BORDER_BITS / len(marker_bits(board, 0))
        inside = np.array([3, 2, 0, 1])  # the tag lies right and below of its first corner
        depths[np.arange(len(ids)), inside[ids % 4]] = border
    return depths


def refine_corners(
    grey: Float32,
    board: Board,
    ids: np.ndarray,
    px: Float64,
    *,
    reach: float | None = None,
    low: float = 0.0,
    high: float = 255.0,
) -> Refined:
    """Every corner fitted to the picture.  Where a fit does not settle the detector's corner stays, with sigma NaN.

    grey : (H, W) float32, 8-bit levels as encoded (the model takes up the curve).  ids: rows of board.points_m.  px: (n, 2) starts.
    low, high : levels at which the picture clips.
    """
    wide = REACH[board.kind] if reach is None else reach
    near = min(wide, FIRST_REACH[board.kind])
    px = np.asarray(px, np.float64)
    depths = clean_depths(board, ids)
    fixed: dict[str, Any] = {"low": low + CLIP_LEVELS, "high": high - CLIP_LEVELS, "most_radius_px": MOST_RADIUS_PX}
    shapes, bends = local_shapes(board, ids, px)
    pitch = float(np.median(1 / np.linalg.norm(shapes, axis=2)))
    furthest_px = float(np.clip(FURTHEST * pitch, *FURTHEST_PX))
    fit = fit_corners(
        grey, px, shapes, 0 * bends, depths, blur=(1.0, 1.0), margin_px=1.5, reach=max(near, 4.5 / pitch), furthest_px=furthest_px, **fixed
    )
    good = np.isfinite(fit[:, 0])
    if good.sum() < 4:
        nothing = np.full(len(px), np.nan)
        return Refined(
            px=px,
            sigma_px=nothing,
            refined=good & False,
            blur_px=(np.nan, np.nan),
            motion_px=(0, 0),
            contrast=np.nan,
            bright_first=0 * nothing,
            rms=np.nan,
        )
    now = _sane(board, ids, px, fit)
    s1, s2 = np.nanmedian(fit[:, 7]), np.nanmedian(fit[:, 8])
    motion = (0.0, 0.0)
    if max(s1, s2) > BLUR_FOR_MOTION_PX:
        motion, blur = _motion(grey, now, shapes, bends, depths, float(s1), float(s2), near, fit, furthest_px, fixed)
    if motion == (0.0, 0.0):
        blur = (float(s1), float(s2))

    def fitted(rows: npt.NDArray[np.int64], shared: Float64 | None = None) -> Float64:
        shapes, bends = local_shapes(board, ids, now)
        margin = 1.3 * max(blur) + 0.5 + 0.4 * float(np.hypot(*motion))
        # The next edges stand one square away: their blur must stay out of the window.
        clear = 1.0 if board.spacing is None else board.spacing
        here = min(wide, max(0.7 * near, clear - margin / pitch))
        return fit_corners(
            grey,
            now[rows],
            shapes[rows],
            bends[rows],
            depths[rows],
            blur=blur,
            motion=motion,
            margin_px=margin,
            reach=max(here, 4.5 / pitch),
            furthest_px=furthest_px,
            tone=tone_table(factors[1]),
            tail=TAIL_SHARE * factors[0],
            noise=noise,
            own_bend=not together,
            shared=shared,
            **fixed,
        )

    # Where whites or blacks clip, the ends between which the tone lies are not seen.
    together = good.sum() >= FEWEST_SHARED and _clipped_share(grey, now, low, high) < MOST_CLIPPED
    factors, noise = np.zeros(2), 0.0
    if together:
        few = np.flatnonzero(good)
        few = few[:: max(1, len(few) // TRIED_FOR_SHARED)]
        for _ in range(SHARED_TURNS):
            shared = np.zeros((len(few), 2, 3))
            some = fitted(few, shared)
            now[few] = np.where(np.isfinite(some[:, :1]), some[:, :2], now[few])
            every, prior = shared.sum(axis=0), 1 / SHARED_WIDTH**2
            factors = factors + np.linalg.solve(every[:, :2] + np.diag(prior), every[:, 2] - prior * factors)
            factors = np.clip(factors, -SHARED_MOST, SHARED_MOST)
            noise = picture_noise(grey, now)
    all_rows = np.arange(len(px))
    for _ in range(2):
        fit = fitted(all_rows)
        now = _sane(board, ids, px, fit)
    good = np.isfinite(fit[:, 0]) & (np.abs(now - fit[:, :2]).max(axis=1) == 0)
    if not good.any():
        nothing = np.full(len(px), np.nan)
        return Refined(
            px=px, sigma_px=nothing, refined=good, blur_px=(np.nan, np.nan), motion_px=(0, 0), contrast=np.nan, bright_first=0 * nothing, rms=np.nan
        )
    s = np.median(fit[good, 7]) / np.sqrt(2), np.median(fit[good, 8]) / np.sqrt(2)
    path = (
        np.median(fit[good, 14:16] * np.sign(fit[good, 14:16] @ np.array(motion) + 1e-300)[:, None], axis=0) if motion != (0.0, 0.0) else np.zeros(2)
    )
    along = float(np.sqrt(max(s) ** 2 + path @ path / 12))
    return Refined(
        px=np.where(good[:, None], fit[:, :2], px),
        sigma_px=np.where(good, np.sqrt((fit[:, 2] ** 2 + fit[:, 3] ** 2) / 2), np.nan),
        refined=good,
        blur_px=(along, float(min(s))),
        motion_px=(float(path[0]), float(path[1])),
        contrast=float(2 * np.median(np.abs(fit[good, 10]))),
        bright_first=np.where(good, np.sign(fit[:, 10]), 0.0),
        rms=float(np.median(fit[good, 16])),
    )


def _about(grey: Float32, px: Float64) -> Float32:
    (x0, y0), (x1, y1) = np.floor(px.min(axis=0)).astype(int), np.ceil(px.max(axis=0)).astype(int) + 1
    return grey[max(y0, 0) : max(y1, 3), max(x0, 0) : max(x1, 3)]


def _clipped_share(grey: Float32, px: Float64, low: float, high: float) -> float:
    part = _about(grey, px)
    return float(np.mean((part <= low + CLIP_LEVELS) | (part >= high - CLIP_LEVELS)))


def picture_noise(grey: Float32, px: Float64) -> float:
    """Levels of noise, one sigma, about corners `px`: the median of a filter that flat ground and gradients leave at 0 (Immerkaer 1996)."""
    import cv2

    mask = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6
    return max(float(np.median(np.abs(cv2.filter2D(_about(grey, px), -1, mask)))) / 0.6745, QUANTUM)


def tone_table(factor: float) -> Float64:
    """(TONE_STEPS + 1, 2) an edge's tone at p = -1..1 and its slope by `factor`: the logarithm of light that goes from 1 to e^factor.

    0 is linear; a power of light, as of sRGB, and an S-shaped curve have the tone of a logarithm, if of another range, to a hundredth."""
    t = (NO_TONE[:, 0] + 1) / 2

    def bent(f: float) -> Float64:
        if abs(f) < 1e-6:
            return NO_TONE[:, 0]
        tone: Float64 = 2 * np.log1p(np.expm1(f) * t) / f - 1
        return tone

    h = 0.02
    return np.ascontiguousarray(np.stack([bent(factor), (bent(factor + h) - bent(factor - h)) / (2 * h)], axis=-1))


def _motion(
    grey: Float32,
    px: Float64,
    shapes: Float64,
    bends: Float64,
    depths: Float64,
    s1: float,
    s2: float,
    near: float,
    plain: Float64,
    furthest_px: float,
    fixed: dict[str, Any],
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The exposure's path and the blur besides it, where a path explains the corners better than blur alone; else zero."""
    n1, n2 = (np.median(shapes[:, k] / np.linalg.norm(shapes[:, k], axis=1, keepdims=True), axis=0) for k in (0, 1))
    few = np.flatnonzero(np.isfinite(plain[:, 18]))
    few = few[:: max(1, len(few) // TRIED_FOR_MOTION)]  # the whole picture moves alike: some corners tell
    px, shapes, bends, depths, plain = px[few], shapes[few], bends[few], depths[few], plain[few]
    rest = 0.8 * min(s1, s2, 1.6)
    # An even path of length m across an edge spreads it like a Gaussian of variance m^2 / 12; s^2 is twice a variance.
    m1, m2 = (np.sqrt(max(6 * (s * s - rest * rest), 1e-3)) for s in (s1, s2))
    best, best_cost = ((0.0, 0.0), (s1, s2)), np.inf
    for sign in (1, -1):
        path = np.linalg.solve(np.stack([n1, n2]), [m1, sign * m2])
        fit = fit_corners(
            grey,
            px,
            shapes,
            bends,
            depths,
            blur=(rest, rest),
            motion=(float(path[0]), float(path[1])),
            margin_px=1.5,
            reach=near,
            furthest_px=furthest_px,
            **fixed,
        )
        both = np.isfinite(fit[:, 18]) & np.isfinite(plain[:, 18])
        if both.sum() < 4:
            continue
        cost = float(np.median(fit[both, 18] / plain[both, 18]))
        if cost < min(best_cost, MOTION_PAYS):
            m = np.median(fit[both, 14:16] * np.sign(fit[both, 14:16] @ path)[:, None], axis=0)
            s = float(np.median(fit[both, 7]))
            best, best_cost = ((float(m[0]), float(m[1])), (s, s)), cost
    return best


def _sane(board: Board, ids: np.ndarray, px: Float64, fit: Float64) -> Float64:
    """The fitted corners where they lie on the smooth grid of all, else the detector's."""
    now = np.where(np.isfinite(fit[:, :1]), fit[:, :2], px)
    off = np.linalg.norm(now - grid_map(board.points_m[ids, :2], now), axis=1)
    doubted = off > max(NEIGHBOUR_PX, 8 * float(np.median(off)))
    result: Float64 = np.where(doubted[:, None], px, now)
    return result
