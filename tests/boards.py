"""Pictures of boards with corners known exactly, for tests: area sampling through the real camera model.

Nothing here knows how corners are found: each pixel is the mean of many rays through its area onto the board's own
rectangles; soft focus is a disc, motion a box along a line, both in scene-linear light; then exposure, clipping, the sRGB
curve, noise, 8 bits, JPEG.  Board and camera frames as in calibration/board.py and camera.py; R, t take board points to the camera."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from stereorelight.arrays import Float64
from stereorelight.calibration.board import Board
from stereorelight.calibration.corners import Detection
from stereorelight.camera import Camera

SAMPLES, STEP = 144, 89  # a rank-1 lattice over the pixel: no row of samples lies along an edge
RAY_GRID_PX = 8  # rays are smooth: exact on this grid, bicubic between


def board_pose(
    board: Board, camera: Camera, *, at_px: tuple[float, float], distance_m: float, tilt_deg: tuple[float, float] = (0, 0), roll_deg: float = 0
) -> tuple[Float64, Float64]:
    """R, t that put the board's middle at pixel `at_px`, `distance_m` along the axis, turned about its own x, y and then z axes."""
    a, b, c = (math.radians(v) for v in (*tilt_deg, roll_deg))
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    R = about_z @ about_y @ about_x
    x0, y0, x1, y1 = board.extent_m
    middle = camera.rays(np.array(at_px, dtype=float)) * distance_m
    return R, middle - R @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])


def true_corners(board: Board, camera: Camera, R: Float64, t: Float64) -> Float64:
    """(n, 2) pixels of every corner; NaN outside the frame."""
    px = camera.project(board.points_m @ np.asarray(R).T + t)
    w, h = camera.size
    inside = (px[:, 0] > -0.5) & (px[:, 0] < w - 0.5) & (px[:, 1] > -0.5) & (px[:, 1] < h - 0.5)
    return np.where(inside[:, None], px, np.nan)


def render_board(
    board: Board,
    camera: Camera,
    R: Float64,
    t: Float64,
    *,
    white: float = 0.75,
    black: float = 0.03,
    surround: float = 0.2,
    shading: tuple[float, float] = (0.15, -0.1),
    exposure: float = 1.0,
    defocus_px: float = 0.7,
    motion_px: tuple[float, float] = (0.0, 0.0),
    noise: float = 0.0,
    jpeg: int | None = None,
    linear: bool = False,
    deep: bool = False,
    mirrored: bool = False,
    seed: int = 0,
    samples: tuple[int, int] = (SAMPLES, STEP),
) -> tuple[Any, Float64]:
    """The board as this camera sees it: (H, W) uint8 (`deep`: uint16) sRGB (or linear) and its true corners (n, 2), NaN outside the frame.

    white, black, surround : reflectances.  shading: change of light from edge to edge of the frame, along x and y.
    defocus_px             : radius of the disc that each point becomes.  motion_px: movement during exposure.
    noise                  : standard deviation in 8-bit levels.  jpeg: quality.  mirrored: as a beam-splitter's eye records it.
    samples                : rays a pixel and their lattice's step, neighbouring Fibonacci numbers; fewer where corners need not be true to 0.01 px.
    """
    R, t = np.asarray(R, dtype=float), np.asarray(t, dtype=float)
    light = _linear(board, camera, R, t, white, black, surround, samples)
    w, h = camera.size
    light *= 1 + shading[0] * (np.arange(w) / w - 0.5) + shading[1] * (np.arange(h) / h - 0.5)[:, None]
    if defocus_px > 0.05:
        light = cv2.filter2D(light, -1, disc(defocus_px), borderType=cv2.BORDER_REFLECT)
    if math.hypot(*motion_px) > 0:
        light = cv2.filter2D(light, -1, streak(motion_px), borderType=cv2.BORDER_REFLECT)
    seen = np.clip(light * exposure, 0, 1)
    if not linear:
        seen = np.where(seen <= 0.0031308, seen * 12.92, 1.055 * np.power(seen, 1 / 2.4, where=seen > 0, out=np.zeros_like(seen)) - 0.055)
    white_code = 65535 if deep else 255
    level = seen * white_code + noise * white_code / 255 * np.random.default_rng(seed).standard_normal(seen.shape)
    picture: Any = np.clip(np.rint(level), 0, white_code).astype(np.uint16 if deep else np.uint8)
    if jpeg is not None:
        picture = cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], cv2.IMREAD_GRAYSCALE)
    corners = true_corners(board, camera, R, t)
    if mirrored:
        return np.ascontiguousarray(picture[:, ::-1]), np.stack([w - 1 - corners[:, 0], corners[:, 1]], axis=-1)
    return picture, corners


def disc(radius_px: float) -> Float64:
    """A disc's share of each pixel, (n, n), sum 1."""
    r = math.ceil(radius_px + 0.5)
    fine = (np.arange((2 * r + 1) * 16) + 0.5) / 16 - r - 0.5
    inside = (fine[:, None] ** 2 + fine**2 <= radius_px**2).astype(float)
    share: Float64 = inside.reshape(2 * r + 1, 16, 2 * r + 1, 16).mean(axis=(1, 3))
    return share / share.sum()


def streak(motion_px: tuple[float, float]) -> Float64:
    """A straight even movement's share of each pixel, (n, n), sum 1, symmetric about its middle."""
    r = math.ceil(math.hypot(*motion_px) / 2 + 1)
    kernel = np.zeros((2 * r + 1, 2 * r + 1))
    for s in (np.arange(512) + 0.5) / 512 - 0.5:
        x, y = s * motion_px[0] + r, s * motion_px[1] + r
        ix, iy = int(x), int(y)
        fx, fy = x - ix, y - iy
        kernel[iy : iy + 2, ix : ix + 2] += np.outer([1 - fy, fy], [1 - fx, fx])
    return kernel / kernel.sum()


def _linear(board: Board, camera: Camera, R: Float64, t: Float64, white: float, black: float, surround: float, samples: tuple[int, int]) -> Float64:
    w, h = camera.size
    u, v = np.arange(-2 * RAY_GRID_PX, w + 3 * RAY_GRID_PX, RAY_GRID_PX), np.arange(-2 * RAY_GRID_PX, h + 3 * RAY_GRID_PX, RAY_GRID_PX)
    rays = camera.rays(np.stack(np.meshgrid(u, v), axis=-1))
    assert np.isfinite(rays).all(), "this lens folds just outside the frame; take a milder one"
    ray_x, ray_y = RectBivariateSpline(v, u, rays[..., 0]), RectBivariateSpline(v, u, rays[..., 1])
    n, along = R[:, 2], R[:, 2] @ t  # the board's plane: n . P = along
    x0, y0, x1, y1 = board.extent_m
    q = 1.5 * board.quiet_m
    # Reflectance between all lines of the board: beyond its paper, on the paper, in its dark rectangles.
    xs = np.unique([x0 - q, x1 + q, *board.rectangles_m[:, [0, 2]].round(12).ravel()])
    ys = np.unique([y0 - q, y1 + q, *board.rectangles_m[:, [1, 3]].round(12).ravel()])
    tone = np.full((len(ys) + 1, len(xs) + 1), surround)
    tone[1:-1, 1:-1] = white
    for left, top, right, bottom in board.rectangles_m.round(12):
        tone[np.searchsorted(ys, top) + 1 : np.searchsorted(ys, bottom) + 1, np.searchsorted(xs, left) + 1 : np.searchsorted(xs, right) + 1] = black
    flat = tone.ravel()

    def shade(rx: Float64, ry: Float64) -> Float64:
        depth = along / (n[0] * rx + n[1] * ry + n[2])
        x, y = (depth * (R[0, k] * rx + R[1, k] * ry + R[2, k]) - t @ R[:, k] for k in (0, 1))
        found: Float64 = flat[np.searchsorted(ys, y) * tone.shape[1] + np.searchsorted(xs, x)]
        return np.where(depth > 0, found, surround)

    corner_u, corner_v = np.arange(w + 1) - 0.5, np.arange(h + 1) - 0.5
    coarse = shade(ray_x(corner_v, corner_u), ray_y(corner_v, corner_u))
    four = np.stack([coarse[:-1, :-1], coarse[1:, :-1], coarse[:-1, 1:], coarse[1:, 1:]])
    mixed = cv2.dilate((four.max(axis=0) > four.min(axis=0)).astype(np.uint8), np.ones((3, 3))) > 0
    picture: Float64 = four[0].copy()
    rows, columns = np.nonzero(mixed)
    total = np.zeros(len(rows))
    # Within a pixel the rays are straight to 1e-5 px: their slopes at its centre do.
    grid_u, grid_v = np.arange(w), np.arange(h)
    bundles = [[f(grid_v, grid_u, dx=a, dy=b)[rows, columns] for a, b in ((0, 0), (0, 1), (1, 0))] for f in (ray_x, ray_y)]
    count, step = samples
    for k in range(count):
        du, dv = (k + 0.5) / count - 0.5, (k * step % count + 0.5) / count - 0.5
        total += shade(*(at + du * per_u + dv * per_v for at, per_u, per_v in bundles))
    picture[rows, columns] = total / count
    return picture


def seen(board: Board, camera: Camera, R: Float64, t: Float64, *, noise_px: float = 0.02, mirrored: bool = False, seed: int = 0) -> Detection | None:
    """A detection without a picture: the true corners with noise, as `corners.detect` would hand them on.  None where too few are in the frame."""
    px = true_corners(board, camera, R, t)
    ids = np.flatnonzero(np.isfinite(px[:, 0]))
    if len(ids) < 6 or (board.kind == "chessboard" and len(ids) < len(px)):
        return None
    noisy = px[ids] + np.random.default_rng(seed).normal(0, noise_px, (len(ids), 2))
    found = Detection(
        ids=ids,
        px=noisy,
        sigma_px=np.full(len(ids), noise_px),
        refined=np.ones(len(ids), bool),
        blur_px=(0.6, 0.6),
        motion_px=(0.0, 0.0),
        sharpness=0.8,
        contrast=150.0,
        size=camera.size,
    )
    return found.flipped() if mirrored else found
