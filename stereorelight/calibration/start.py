"""Starting values for the solver: focal length, board poses and the pose between the eyes, from nothing but corners.

In: corners of the views of one eye, (V, n, 2) pixels, NaN where unseen.  Out: intrinsics, poses left-camera-from-board.
A board is flat, so rays of its corners and points on it are related by a homography, whatever the lens, once the lens is
undone.  Trial focal lengths of two plain projections, perspective and equidistant, are tried in turn and the one is kept
whose poses reproject best: it needs no guess from the user, stands strong distortion, and never diverges."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.projection import NEAREST, camera_of, checked_lens, project

FEWEST_CORNERS = 6  # in one view of one eye: fewer say next to nothing beside the six unknowns of the board's pose
TRIALS = tuple(float(f) for f in np.geomspace(0.25, 12.0, 20))  # focal lengths in units of the frame's width
WIDEST = 1.5  # widths: an equidistant lens of a longer focal length is a perspective one
DRAWS, TRIAL_DRAWS = 200, 60  # of four corners: for a pose, and to judge a trial; half of the corners gross, 98 of 100 trials meet four good ones
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


def _homography(points_m: Float64, flat: Float64, gross: float, draws: int = DRAWS) -> Float64 | None:
    known = np.isfinite(flat).all(axis=-1)
    if known.sum() < FEWEST_CORNERS:
        return None
    H, _ = cv2.findHomography(points_m[known, :2], flat[known], cv2.RANSAC, gross, maxIters=draws)
    return H if H is not None and np.isfinite(H).all() else None


def _rigid(H: Float64, points_m: Float64) -> tuple[Float64, Float64, Bool]:
    """The rigid poses nearest to homographies H (..., 3, 3) from the board to rays (Zhang 2000): R (..., 3, 3), t (..., 3), and which have one."""
    a, b = np.linalg.norm(H[..., 0], axis=-1), np.linalg.norm(H[..., 1], axis=-1)
    H = H * (2 / np.maximum(a + b, 1e-300))[..., None, None]
    behind = H[..., 2, :] @ np.array([*points_m[:, :2].mean(axis=0), 1]) < 0
    H = np.where(behind[..., None, None], -H, H)
    square = np.cross(H[..., 0], H[..., 1])
    known = np.linalg.norm(square, axis=-1) > 1e-9
    both = np.where(known[..., None, None], np.stack([H[..., 0], H[..., 1], square], axis=-1), np.eye(3))
    u, _, vt = np.linalg.svd(both)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt, H[..., 2], known


def poses(points_m: Float64, rays: Float64, draws: int = DRAWS) -> tuple[Float64, Float64, Bool]:
    """R (V, 3, 3), t (V, 3) of the boards from x/z, y/z (V, n, 2) of their corners, and which views (V,) could be placed."""
    found = [_homography(points_m, view, GROSS, draws) for view in rays]
    H = np.stack([np.full((3, 3), np.nan) if h is None else h for h in found]) if found else np.empty((0, 3, 3))
    R, t, known = _rigid(np.nan_to_num(H), points_m)
    known &= np.isfinite(H).all(axis=(1, 2))
    return np.where(known[:, None, None], R, np.eye(3)), np.where(known[:, None], t, (0.0, 0.0, 1.0)), known


def first_guess(points_m: Float64, px: Float64, size: tuple[int, int], lens: str) -> tuple[Float64, Float64, Float64, Bool]:
    """Intrinsics (4 + k,) of lens `lens` (its parameters all 0), R, t of the boards, and which views could be placed."""
    model, count = checked_lens(lens)
    w, h = size
    some = px[_some_views(px)]
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    (score, focal), is_wide = _best_narrow(points_m, some, centre, w), False
    for f in TRIALS:
        if f <= WIDEST and (found := _wide_misfit(points_m, some, np.array([f * w, f * w, *centre]), score)) < score:
            score, focal, is_wide = found, f * w, True
    plain = np.array([focal, focal, *centre])
    R, t, known = poses(points_m, _plain_rays(px, plain, is_wide))
    intrinsics = np.append(plain, np.zeros(count))
    if count and is_wide != (model == "fisheye"):
        # k1 of the other family that bends as the plain projection does to third order, tan a = a + a^3 / 3; the whole of it
        # would fold a wide brown or rational lens over inside the frame.
        intrinsics[4] = -0.2 if is_wide else 1 / 3
    return intrinsics, R, t, known


def _best_narrow(points_m: Float64, px: Float64, centre: Float64, width: int) -> tuple[float, float]:
    """Median misfit and focal length, in pixels, of the best perspective lens among the trials; inf and `width` where none places half of the views.

    It needs one homography a view, whatever its focal length."""
    flat = [_homography(points_m, view - centre, GROSS * width) for view in px]
    placed = [(H, view) for H, view in zip(flat, px) if H is not None]
    if len(placed) * 2 < len(px) or not placed:
        return np.inf, float(width)
    focal = np.array(TRIALS) * width
    H = np.stack([H for H, _ in placed])[None] * np.stack([1 / focal, 1 / focal, np.ones_like(focal)], axis=-1)[:, None, :, None]
    R, t, known = _rigid(H, points_m)
    there = points_m @ R.swapaxes(-1, -2) + t[..., None, :]
    seen = there[..., :2] / np.maximum(there[..., 2:], NEAREST) * focal[:, None, None, None] + centre
    off = np.where(known[..., None], np.linalg.norm(seen - np.stack([view for _, view in placed]), axis=-1), np.nan)
    scores = [float(np.nanmedian(o)) if 2 * k.sum() >= len(px) else np.inf for o, k in zip(off, known)]
    return min(*zip(scores, focal.tolist()), (np.inf, float(width)))


def _wide_misfit(points_m: Float64, px: Float64, plain: Float64, most: float) -> float:
    """Median misfit in pixels of an equidistant lens; inf where fewer than half of the views could be placed, or once it must be above `most`.

    Each focal length asks for a homography a view of its own, which takes nearly all of the time where the lens is not of this kind."""
    lens = np.append(plain, [0.0] * 4)
    half = np.isfinite(px[..., 0]).sum() / 2
    off: list[Float64] = []
    for view, rays in zip(px, _plain_rays(px, plain, True)):
        R, t, known = poses(points_m, rays[None], TRIAL_DRAWS)
        if known[0]:
            off.append(np.linalg.norm(project(points_m @ R[0].T + t[0], lens, "fisheye")[0] - view, axis=-1))
        if sum(int((o > most).sum()) for o in off) > half:
            return np.inf
    return float(np.nanmedian(np.concatenate(off))) if off and 2 * len(off) >= len(px) else np.inf


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
