"""A printed board as a camera sees it: every pixel the mean of many rays onto the board's own rectangles.

In: the black rectangles (n, 4) of a board, metres in its own frame (x right, y down, z away from the viewer, on its face z = 0), a camera
and R, t that take board points to the camera frame.  Out: (H, W) linear light.
A session is a list of such poses, spread over the frame, near and far, and tilted as a good operator tilts a board."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.camera import Camera

WHITE, BLACK, SURROUND = 0.72, 0.03, 0.18  # reflectances
FALL = (0.15, -0.10)  # how the light changes from edge to edge of the frame, along x and y
SIDE = 6  # rays along each side of a pixel that holds an edge
# Where the board's middle goes, as a share of the frame; the share of the frame's width that it takes; its tilts about x and y, degrees.
PLACES = ((0.5, 0.5), (0.3, 0.35), (0.7, 0.35), (0.3, 0.65), (0.7, 0.65), (0.5, 0.3), (0.5, 0.7), (0.34, 0.5), (0.66, 0.5))
SHARES = (0.62, 0.45, 0.52, 0.38, 0.75)
TILTS = ((0, 0), (0, 36), (0, -36), (34, 0), (-34, 0), (24, 28), (-24, 28), (24, -28), (-24, -28), (12, 40), (-12, -40))


def board_poses(extent_m: tuple[float, float, float, float], camera: Camera, views: int, *, seed: int = 0) -> list[tuple[Float64, Float64]]:
    """R, t of each of `views` poses before `camera`; the same for the same seed.

    extent_m : (x0, y0, x1, y1) of the board in its own frame.
    """
    rng = np.random.Generator(np.random.Philox(key=[seed, 7]))
    x0, y0, x1, y1 = extent_m
    w, h = camera.size
    out = []
    for n in range(views):
        nudge = rng.uniform(-1, 1, 6)
        place, share, tilt = PLACES[n % len(PLACES)], SHARES[n % len(SHARES)], TILTS[n % len(TILTS)]
        a, b, c = (math.radians(v) for v in (tilt[0] + 3 * nudge[0], tilt[1] + 3 * nudge[1], 8 * nudge[2]))
        about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
        about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
        about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
        R = about_z @ about_y @ about_x
        distance = camera.fx * (x1 - x0) / (share * w) * (1 + 0.05 * nudge[3])
        # High boards in wide frames: all of it stays in the picture.
        distance = max(distance, camera.fy * (y1 - y0) / (0.8 * h))
        at = np.array([(place[0] + 0.02 * nudge[4]) * w, (place[1] + 0.02 * nudge[5]) * h])
        out.append((R, camera.rays(at) * distance - R @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])))
    return out


def board_picture(
    rectangles_m: npt.NDArray[np.float64], extent_m: tuple[float, float, float, float], rim_m: float, camera: Camera, R: Float64, t: Float64
) -> Float64:
    """(H, W) linear light of the board in even surroundings, exact to 1 / 36 of a step in the pixels that an edge passes.

    rim_m : white round the black.
    """
    w, h = camera.size
    rows = rectangles_m.round(12)
    xs, ys = np.unique(rows[:, [0, 2]]), np.unique(rows[:, [1, 3]])
    dark: Bool = np.zeros((len(ys) + 1, len(xs) + 1), np.bool_)
    for x0, y0, x1, y1 in rows:
        dark[np.searchsorted(ys, y0) + 1 : np.searchsorted(ys, y1) + 1, np.searchsorted(xs, x0) + 1 : np.searchsorted(xs, x1) + 1] = True
    x0, y0, x1, y1 = extent_m
    n, along = R[:, 2], float(R[:, 2] @ t)  # the board's plane: n . P = along

    def seen(pixels: Float64) -> Float64:
        rays = camera.rays(pixels)
        with np.errstate(invalid="ignore", divide="ignore"):
            depth = along / (rays @ n)
            point = rays * depth[..., None] - t
            x, y = point @ R[:, 0], point @ R[:, 1]
            paper = (depth > 0) & (x > x0 - rim_m) & (x < x1 + rim_m) & (y > y0 - rim_m) & (y < y1 + rim_m)
        at = np.searchsorted(ys, np.nan_to_num(y)), np.searchsorted(xs, np.nan_to_num(x))
        return np.where(paper, np.where(dark[at], BLACK, WHITE), SURROUND)

    corners = seen(np.stack(np.meshgrid(np.arange(w + 1) - 0.5, np.arange(h + 1) - 0.5), axis=-1))
    four = np.stack([corners[:-1, :-1], corners[1:, :-1], corners[:-1, 1:], corners[1:, 1:]])
    picture: Float64 = four[0].copy()
    mixed = np.pad(four.max(axis=0) > four.min(axis=0), 1)
    near = np.logical_or.reduce([mixed[j : j + h, i : i + w] for j in range(3) for i in range(3)])
    v, u = np.nonzero(near)
    steps = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    total = np.zeros(len(v))
    for dv in steps:
        for du in steps:
            total += seen(np.stack([u + du, v + dv], axis=-1))
    picture[v, u] = total / SIDE**2
    return picture * (1 + FALL[0] * (np.arange(w) / w - 0.5) + FALL[1] * (np.arange(h) / h - 0.5)[:, None])
