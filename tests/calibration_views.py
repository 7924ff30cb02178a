"""Views of boards for tests of the solve: corners projected through a known rig, with noise; no pictures."""

from __future__ import annotations

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.calibration.projection import rotation
from stereorelight.calibration.sightings import Corners, StereoViews
from stereorelight.camera import Camera, Eye, Rig

SIZE = (1280, 960)


def board(columns: int = 11, rows: int = 8, square_m: float = 0.03) -> Float64:
    """(n, 3) corners, x right, y down."""
    x, y = np.meshgrid(np.arange(columns) * square_m, np.arange(rows) * square_m)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)


def camera(f: float, cx: float, cy: float, *lens: float, model: str = "brown", size: tuple[int, int] = SIZE) -> Camera:
    return Camera(size=size, K=np.array([[f, 0, cx], [0, f * 1.001, cy], [0, 0, 1]]), model=model, distortion=lens)  # type: ignore[arg-type]


def rig(left: Camera, right: Camera, turn_deg: tuple[float, float, float], *, mirrored: Eye | None = None) -> Rig:
    R = rotation(np.radians(turn_deg))
    return Rig(left=left, right=right, R_right_left=R, t_right_left_m=-R @ np.array([0.12, 0.002, -0.003]), mirrored=mirrored)


PLAIN = (-0.1, 0.05, 0.001, -0.0005)
RIGS = {
    "toed-in": rig(camera(1400, 645, 470, *PLAIN), camera(1405, 631, 484, *PLAIN), (0.3, 6.0, 0.5)),
    "unequal": rig(camera(1300, 645, 470, *PLAIN), camera(1800, 650, 490, -0.2, 0.1, 0.0, 0.001), (-0.4, 2.0, 0.2)),
    "distorted": rig(
        camera(900, 645, 470, -0.28, 0.09, 0.001, -0.0005, -0.012), camera(905, 631, 484, -0.28, 0.09, 0.0, 0.0004, -0.012), (0.3, 2.0, -0.5)
    ),
    "fisheye": rig(
        camera(620, 645, 470, 0.03, -0.01, 0.002, 0.0, model="fisheye"),
        camera(622, 631, 484, 0.03, -0.01, 0.002, 0.0, model="fisheye"),
        (0.3, 2.0, -0.5),
    ),
}
LENS = {"toed-in": "brown4", "unequal": "brown4", "distorted": "brown5", "fisheye": "fisheye"}


def views_of(
    truth: Rig,
    *,
    count: int = 20,
    noise_px: float = 0.02,
    tilt_deg: tuple[float, float] = (30, 45),
    seed: int = 0,
    points_m: Float64 | None = None,
    plan_m: Float64 | None = None,
) -> StereoViews:
    """`count` views of a board in both eyes, a third of the frame wide, spread over the frame, with Gaussian noise.

    plan_m : what the board is taken for, where it is not what it is (`points_m`)."""
    rng = np.random.default_rng(seed)
    points = board() if points_m is None else points_m
    width = float(np.ptp(points[:, 0]))
    eyes: tuple[list[Corners | None], list[Corners | None]] = ([], [])
    w, h = truth.left.size
    while len(eyes[0]) < count:
        about, tilt, roll = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(*tilt_deg)), rng.normal() * 0.2
        R = rotation(np.array([np.cos(about), np.sin(about), 0]) * tilt) @ rotation(np.array([0, 0, roll]))
        Z = truth.left.fx * width / (w * rng.uniform(0.3, 0.6))
        centre = truth.left.unproject(np.array([rng.uniform(0.15, 0.85) * w, rng.uniform(0.15, 0.85) * h]), Z)
        left = (points - points.mean(axis=0)) @ R.T + centre
        seen = [truth.left.project(left), truth.right.project(left @ truth.R_right_left.T + truth.t_right_left_m)]
        if all(np.isfinite(px).all() and (px > 5).all() and (px < np.array(truth.left.size) - 6).all() for px in seen):
            for eye, px in zip(eyes, seen):
                eye.append(Corners(ids=np.arange(len(points)), px=px + rng.normal(size=px.shape) * noise_px))
    return StereoViews(points_m=points if plan_m is None else plan_m, left=eyes[0], right=eyes[1], mirrored=truth.mirrored)


def turned_by_deg(R: Float64, other: Float64) -> float:
    """Angle between two rotations, degrees; exact for small ones."""
    off = R @ other.T
    return float(np.degrees(np.linalg.norm([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2))
