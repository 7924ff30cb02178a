"""Starting values for the solver: focal length, board poses and the pose between the eyes, from nothing but corners.

In: corners of the views of one eye, (V, n, 2) pixels, NaN where unseen.  Out: intrinsics, poses left-camera-from-board.
A board is flat, so rays of its corners and points on it are related by a homography, whatever the lens, once the lens is
undone.  Trial focal lengths of two plain projections, perspective and equidistant, are tried in turn and the one is kept
whose poses reproject best: it needs no guess from the user, stands strong distortion, and never diverges."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.projection import camera_of, checked_lens, project

FEWEST_CORNERS = 6  # in one view of one eye: fewer say next to nothing beside the six unknowns of the board's pose
TRIALS = tuple(float(f) for f in np.geomspace(0.25, 12.0, 20))  # focal lengths in units of the frame's width
WIDEST = 1.5  # widths: an equidistant lens of a longer focal length is a perspective one
GROSS = 0.01  # of the focal length: a corner farther off its board's homography is not that corner


def usable(px: Float64) -> Bool:
    """(V,) views that show enough corners to place the board."""
    enough: Bool = np.isfinite(px[..., 0]).sum(axis=-1) >= FEWEST_CORNERS
    return enough


def _plain_rays(px: Float64, intrinsics: Float64, wide: bool) -> Float64:
    """x/z, y/z of pixels through a plain lens, perspective or equidistant; NaN at and beyond 80 degrees."""
    p = (px - intrinsics[2:4]) / intrinsics[:2]
    if not wide:
        return p
    theta = np.linalg.norm(p, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.where(theta < np.radians(80), p * np.tan(theta) / np.maximum(theta, 1e-12), np.nan)


Placed = Sequence[tuple[Float64, Float64] | None]


def pose_from_rays(points_m: Float64, rays: Float64) -> tuple[Float64, Float64] | None:
    """R, t (camera from board) from board points (n, 3) and their x/z, y/z (n, 2); None where too few are known."""
    H = _homography(points_m, rays, GROSS)
    return None if H is None else _pose(H, points_m)


def _homography(points_m: Float64, flat: Float64, gross: float) -> Float64 | None:
    known = np.isfinite(flat).all(axis=-1)
    if known.sum() < FEWEST_CORNERS:
        return None
    H, _ = cv2.findHomography(points_m[known, :2], flat[known], cv2.RANSAC, gross, maxIters=200)
    return H if H is not None and np.isfinite(H).all() else None


def _pose(H: Float64, points_m: Float64) -> tuple[Float64, Float64] | None:
    """The rigid pose nearest to homography H from the board to rays (Zhang 2000)."""
    H = H * (2 / max(float(np.linalg.norm(H[:, 0]) + np.linalg.norm(H[:, 1])), 1e-300))
    if H[2] @ np.array([*points_m[:, :2].mean(axis=0), 1]) < 0:
        H = -H
    both = np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])])
    if not np.linalg.norm(both[:, 2]) > 1e-9:
        return None
    u, _, vt = np.linalg.svd(both)
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt, H[:, 2]


def poses(points_m: Float64, rays: Float64) -> tuple[Float64, Float64, Bool]:
    """R (V, 3, 3), t (V, 3) of the boards from x/z, y/z (V, n, 2) of their corners, and which views (V,) could be placed."""
    views = len(rays)
    R, t, known = np.tile(np.eye(3), (views, 1, 1)), np.tile([0.0, 0.0, 1.0], (views, 1)), np.zeros(views, dtype=bool)
    for v in range(views):
        pose = pose_from_rays(points_m, rays[v])
        if pose is not None:
            R[v], t[v] = pose
            known[v] = True
    return R, t, known


def first_guess(points_m: Float64, px: Float64, size: tuple[int, int], lens: str) -> tuple[Float64, Float64, Float64, Bool]:
    """Intrinsics (4 + k,) of lens `lens` (its parameters all 0), R, t of the boards, and which views could be placed."""
    model, count = checked_lens(lens)
    w, h = size
    some = px[_some_views(px)]
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    flat = [H for view in some if (H := _homography(points_m, view - centre, GROSS * w)) is not None]
    best = np.inf, float(w), False
    for f in TRIALS:
        # A perspective lens needs one homography whatever its focal length; an equidistant one a new one each time.
        narrow = [_pose(np.diag([1 / (f * w), 1 / (f * w), 1]) @ H, points_m) for H in flat]
        plain = np.array([f * w, f * w, *centre])
        wide: Placed = [pose_from_rays(points_m, rays) for rays in _plain_rays(some, plain, True)] if f <= WIDEST else [None]
        for is_wide, found in ((False, narrow), (True, wide)):
            score = _misfit(points_m, some, plain, is_wide, found)
            if score < best[0]:
                best = score, f * w, is_wide
    _, focal, is_wide = best
    plain = np.array([focal, focal, *centre])
    R, t, known = poses(points_m, _plain_rays(px, plain, is_wide))
    intrinsics = np.append(plain, np.zeros(count))
    if count and is_wide != (model == "fisheye"):
        # k1 of the other family that bends as the plain projection does to third order, tan a = a + a^3 / 3; the whole of it
        # would fold a wide brown or rational lens over inside the frame.
        intrinsics[4] = -0.2 if is_wide else 1 / 3
    return intrinsics, R, t, known


def _misfit(points_m: Float64, px: Float64, plain: Float64, is_wide: bool, found: Placed) -> float:
    """Median distance between corners seen and reprojected, pixels; inf where fewer than half of the views could be placed."""
    lens, intrinsics = ("fisheye", np.append(plain, [0.0] * 4)) if is_wide else ("pinhole", plain)
    off = [np.linalg.norm(project(points_m @ R.T + t, intrinsics, lens)[0] - view, axis=-1) for (R, t), view in _placed(found, px)]
    if len(off) * 2 < len(px) or not off:
        return np.inf
    return float(np.nanmedian(np.concatenate(off)))


def _placed(found: Placed, px: Float64) -> list[tuple[tuple[Float64, Float64], Float64]]:
    return [(pose, view) for pose, view in zip(found, px) if pose is not None]


def _some_views(px: Float64, most: int = 8) -> npt.NDArray[np.intp]:
    """Indices of up to `most` usable views, evenly spread over the shot."""
    views = np.flatnonzero(usable(px))
    return views[np.unique(np.linspace(0, len(views) - 1, min(most, len(views))).round().astype(int))] if len(views) else views


def between_eyes(left: tuple[Float64, Float64], right: tuple[Float64, Float64], both: Bool) -> tuple[Float64, Float64]:
    """R, t (right from left) on which the views of mask `both` agree best: their medoid, so that no bad view counts.

    left, right : R (V, 3, 3), t (V, 3) of the boards in either camera frame."""
    R = right[0][both] @ left[0][both].transpose(0, 2, 1)
    t = right[1][both] - np.einsum("vij,vj->vi", R, left[1][both])
    turn = np.arccos(np.clip((np.einsum("vij,wij->vw", R, R) - 1) / 2, -1, 1))
    shift = np.linalg.norm(t[:, None] - t[None], axis=-1) / max(float(np.median(np.linalg.norm(left[1][both], axis=-1))), 1e-12)
    best = int(np.argmin(np.sum(np.minimum(turn + shift, 1.0), axis=1)))
    return R[best], t[best]


def nearest_poses(points_m: Float64, px: Float64, intrinsics: Float64, lens: str, size: tuple[int, int]) -> tuple[Float64, Float64, Bool]:
    """Poses (V, 3, 3), (V, 3) of the boards through a lens that is known already, and which views could be placed."""
    return poses(points_m, camera_of(intrinsics, lens, size).rays(px)[..., :2])
