"""How sure a calibration is: of its parameters, of pixels over the frame, of depth in millimetres and of normals in degrees.

In: a `Calibration`.  Out: standard errors, maps over a coarse grid of the frame, and an answer at each distance.
Everything is propagated from the solve's covariance with exact derivatives, to first order.
Frames: camera frames (x right, y down, z forward).  Pixels: (0, 0) is the centre of the top-left pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stereorelight.arrays import Float64, Int32
from stereorelight.calibration.answer import EYES, Calibration
from stereorelight.calibration.bundle import POSE, shared_slices
from stereorelight.calibration.covariance import covariance_of
from stereorelight.calibration.projection import intrinsics_of, project
from stereorelight.camera import Eye

GRID = (33, 25)  # columns and rows of the maps
COVERAGE_GRID = (12, 9)
DISPARITY_SIGMA_PX = 0.25  # of a good match; what the rig cannot help
NORMAL_WINDOW_PX = 15  # side of the window that a normal is fitted over
CORRELATION_PX = 3  # neighbouring disparities within so many pixels share their error


def standard_errors(calibration: Calibration) -> dict[str, float]:
    """One sigma of each of the rig's unknowns: pixels, lens parameters, degrees for `turn`, metres for `shift`; and of the baseline."""
    sigma = np.sqrt(np.maximum(np.diag(calibration.covariance), 0))
    out = {n: float(np.degrees(s)) if n.startswith("turn") else float(s) for n, s in zip(calibration.names, sigma)}
    t = calibration.rig.t_right_left_m
    at = shared_slices(calibration.lenses)["shift"]
    along = t / np.linalg.norm(t)
    out["baseline"] = float(np.sqrt(along @ calibration.covariance[at, at] @ along))
    return out


def frame_grid(size: tuple[int, int], grid: tuple[int, int] = GRID) -> Float64:
    """(rows, columns, 2) pixels spread over the frame, its outermost pixels included."""
    w, h = size
    return np.stack(np.meshgrid(np.linspace(0, w - 1, grid[0]), np.linspace(0, h - 1, grid[1])), axis=-1)


def coverage(calibration: Calibration, eye: Eye, grid: tuple[int, int] = COVERAGE_GRID) -> Int32:
    """(rows, columns) how many of the corners that the solve used fell into each cell of the frame."""
    e = EYES.index(eye)
    px = calibration.views.px[e][calibration.kept[e]]
    w, h = calibration.rig.camera(eye).size
    counts, _, _ = np.histogram2d(px[:, 1], px[:, 0], bins=(grid[1], grid[0]), range=((-0.5, h - 0.5), (-0.5, w - 0.5)))
    return counts.astype(np.int32)


def _cross(points: Float64, rows: Float64) -> Float64:
    """rows . (w x points), as rows (..., 2, 3) on w."""
    return np.cross(points[..., None, :], rows)


def projection_sigma(calibration: Calibration, eye: Eye, *, distance_m: float = np.inf, grid: tuple[int, int] = GRID) -> Float64:
    """(rows, columns) one sigma, pixels, along the worse direction, of where a point in space is seen by the eye.

    distance_m : along the optical axis; infinite for far things.
    A lens and the boards' poses can move together without any corner noticing.  What counts is where a point fixed to the boards
    is seen, so the mean move of the boards' poses is undone (as mrcal has it: https://mrcal.secretsauce.net/uncertainty.html)."""
    found, e = calibration.fit, EYES.index(eye)
    at, views = shared_slices(calibration.lenses), np.flatnonzero(found.problem.seen.any(axis=(0, 2)))
    camera, state = calibration.rig.camera(eye), found.state
    rays = camera.rays(frame_grid(camera.size, grid)).reshape(-1, 3)
    far = not np.isfinite(distance_m)
    points = rays if far else rays * distance_m
    _, by_point, by_lens = project(points, intrinsics_of(camera), calibration.lenses[e])
    G = np.zeros((len(points), 2, len(found.problem.free)))
    G[..., at[EYES[e]]] = by_lens
    in_left = points
    if e == 1:
        turned = points if far else points - state.t_right_left_m
        in_left = turned @ state.R_right_left
        G[..., at["turn"]] += _cross(turned, by_point)
        if not far:
            G[..., at["shift"]] += by_point
        by_point = by_point @ state.R_right_left
    normal = found.normal
    pp = np.linalg.inv(normal.pp[views])
    own = np.zeros((len(points), 2, 2))
    for inverse, sp, t in zip(pp, normal.sp[views], state.t_m[views]):
        D = np.zeros((len(points), 2, POSE))
        D[..., :3] = _cross(in_left - (0 if far else t), by_point)
        if not far:
            D[..., 3:] = by_point
        D /= len(views)
        G -= D @ (inverse @ sp.T)
        own += D @ inverse @ D.transpose(0, 2, 1)
    total = G @ covariance_of(found) @ G.transpose(0, 2, 1) + own
    worst: Float64 = np.sqrt(np.maximum(np.linalg.eigvalsh(np.nan_to_num(total, nan=0.0))[:, -1], 0)).reshape(grid[1], grid[0])
    return np.where(np.isfinite(rays[:, 0]).reshape(worst.shape), worst, np.nan)


def depth_rows(calibration: Calibration, distance_m: float, grid: tuple[int, int] = GRID) -> tuple[Float64, Float64]:
    """d Z / d (the rig's unknowns), (rows, columns, S), at the left eye's pixels, and their x/z, y/z (rows, columns, 2).

    A point at Z on the ray of a left pixel is seen at some right pixel.  With both pixels held and the rig moved, the two rays
    meet elsewhere, nearest along the line that the point draws in the right picture.  NaN where the right eye does not see it."""
    rig, at = calibration.rig, shared_slices(calibration.lenses)
    rays = rig.left.rays(frame_grid(rig.left.size, grid))
    left = rays * distance_m
    right = left @ rig.R_right_left.T + rig.t_right_left_m
    _, by_left, by_left_lens = project(left, intrinsics_of(rig.left), calibration.lenses[0])
    seen, by_right, by_right_lens = project(right, intrinsics_of(rig.right), calibration.lenses[1])
    out = np.zeros((*rays.shape[:2], at["rig"].stop))
    per_Z = by_right @ rig.R_right_left @ rays[..., None]  # (..., 2, 1): along the epipolar line
    weight = -np.swapaxes(per_Z, -1, -2) / np.maximum((per_Z**2).sum(axis=-2, keepdims=True), 1e-300)
    ray_moves = -np.linalg.solve(by_left[..., :2], by_left_lens)  # of X, Y at Z fixed, pixel held
    out[..., at["left"]] = (weight @ by_right @ rig.R_right_left[:, :2] @ ray_moves)[..., 0, :]
    out[..., at["right"]] = (weight @ by_right_lens)[..., 0, :]
    out[..., at["turn"]] = (weight @ _cross(right - rig.t_right_left_m, by_right))[..., 0, :]
    out[..., at["shift"]] = (weight @ by_right)[..., 0, :]
    w, h = rig.right.size
    outside = ~((seen > -0.5) & (seen < (w - 0.5, h - 0.5))).all(axis=-1) | ~np.isfinite(rays[..., 0])
    out[outside] = np.nan
    return out, rays[..., :2]


@dataclass(frozen=True, kw_only=True)
class DepthAnswer:
    """What the rig is good for at one distance.  One sigma, the median over the part of the frame that both eyes see.

    depth_rig_mm, normal_rig_deg     : from the calibration: the same on every frame, a bias.   depth_rig_worst_mm is the frame's worst.
    depth_match_mm, normal_match_deg : from matching the pictures, at `disparity_sigma_px`; the rig cannot help it.
    depth_mm, normal_deg             : both together.
    seen_share                       : of the left frame that the right eye sees at that distance.
    """

    distance_m: float
    disparity_sigma_px: float
    depth_rig_mm: float
    depth_rig_worst_mm: float
    depth_match_mm: float
    depth_mm: float
    normal_rig_deg: float
    normal_match_deg: float
    normal_deg: float
    seen_share: float

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def _sigma(rows: Float64, covariance: Float64) -> Float64:
    return np.sqrt(np.maximum(np.einsum("...i,ij,...j->...", rows, covariance, rows), 0))


def depth_sigma_mm(calibration: Calibration, distance_m: float, grid: tuple[int, int] = GRID) -> Float64:
    """(rows, columns) one sigma of Z in millimetres that comes from the calibration, over the left frame; NaN where one eye sees."""
    return _sigma(depth_rows(calibration, distance_m, grid)[0], calibration.covariance) * 1000


def answer_at(
    calibration: Calibration, distance_m: float, *, disparity_sigma_px: float = DISPARITY_SIGMA_PX, window_px: int = NORMAL_WINDOW_PX
) -> DepthAnswer:
    """How exact depth and normals will be at a distance along the optical axis.

    A wall that faces the eye is tilted by the slope of its depth error: by d(dZ)/dx / Z for x = X / Z."""
    rows, xy = depth_rows(calibration, distance_m)
    C = calibration.covariance
    depth = _sigma(rows, C) * 1000
    dx, dy = np.gradient(xy[..., 0], axis=1), np.gradient(xy[..., 1], axis=0)
    tilt = np.hypot(
        _sigma(np.gradient(rows, axis=1) / dx[..., None], C) / distance_m, _sigma(np.gradient(rows, axis=0) / dy[..., None], C) / distance_m
    )
    rig = calibration.rig
    match = 1000 * distance_m**2 / (rig.left.fx * rig.baseline_m) * disparity_sigma_px
    # The slope of a plane fitted to w x w independent values has sigma sqrt(12 / (w^2 (w^2 - 1))); along x and along y.
    slope = disparity_sigma_px * CORRELATION_PX * np.sqrt(12 / (window_px**2 * (window_px**2 - 1.0)))
    tilt_match = float(np.degrees(np.arctan(np.sqrt(2) * slope * distance_m / rig.baseline_m)))
    seen = np.isfinite(depth)
    depth_rig, worst = (float(np.median(depth[seen])), float(depth[seen].max())) if seen.any() else (float("nan"), float("nan"))
    known = np.isfinite(tilt)
    tilt_rig = float(np.degrees(np.arctan(np.median(tilt[known])))) if known.any() else float("nan")
    return DepthAnswer(
        distance_m=distance_m,
        disparity_sigma_px=disparity_sigma_px,
        depth_rig_mm=depth_rig,
        depth_rig_worst_mm=worst,
        depth_match_mm=float(match),
        depth_mm=float(np.hypot(depth_rig, match)),
        normal_rig_deg=tilt_rig,
        normal_match_deg=tilt_match,
        normal_deg=float(np.hypot(tilt_rig, tilt_match)),
        seen_share=float(seen.mean()),
    )


def answers(calibration: Calibration, distances_m: Sequence[float], *, disparity_sigma_px: float = DISPARITY_SIGMA_PX) -> tuple[DepthAnswer, ...]:
    """`answer_at` every distance."""
    return tuple(answer_at(calibration, float(d), disparity_sigma_px=disparity_sigma_px) for d in distances_m)
