"""Rigs for the synthetic shots: a perfect pair, and each way in which a real one is not perfect.

Camera frames: x right, y down, z forward.  Metres, degrees, pixels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, Eye, RectifiedRig, Rig
from stereorelight.errors import RigError, nearest_hint

BARREL = (-0.15, 0.03, 0.0008, -0.0006)  # brown k1 k2 p1 p2: a plain 35 mm cine zoom at its wide end
EXACT = 1e-9


def turn(*, pitch_deg: float = 0.0, yaw_deg: float = 0.0, roll_deg: float = 0.0) -> Float64:
    """(3, 3) world (left camera) from right camera, camera frame: yaw > 0 looks right, pitch > 0 looks up, roll about z."""
    a, b, c = math.radians(pitch_deg), math.radians(yaw_deg), math.radians(roll_deg)
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    turned: Float64 = about_y @ about_x @ about_z
    return turned


def rig_at(left: Camera, right: Camera, centre_m: tuple[float, float, float], R_left_right: Float64, *, mirrored: Eye | None = None) -> Rig:
    """A rig by where the right eye stands and how it is turned, both seen from the left camera."""
    R = R_left_right.T
    return Rig(left=left, right=right, R_right_left=R, t_right_left_m=-R @ np.array(centre_m), mirrored=mirrored)


def parallel_rig(size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065) -> Rig:
    """Two equal pinholes side by side: rectified as they stand."""
    camera = Camera.from_fov(fov_deg, size)
    return rig_at(camera, camera, (baseline_m, 0.0, 0.0), np.eye(3))


def toed_in_rig(size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065, convergence_m: float = 1.5) -> Rig:
    """The right eye turned in so that the optical axes cross at `convergence_m` straight ahead of the left eye.

    Points nearer than that have positive disparity in the plates as shot, points behind it negative.
    """
    camera = Camera.from_fov(fov_deg, size)
    inward_deg = math.degrees(math.atan2(baseline_m, convergence_m))
    return rig_at(camera, camera, (baseline_m, 0.0, 0.0), turn(yaw_deg=-inward_deg))


def distorted_rig(size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065) -> Rig:
    """Parallel, both lenses bending (brown), each in its own way, with unequal focal lengths and principal points."""
    left, right = _real_lenses(size, fov_deg)
    return rig_at(left, right, (baseline_m, 0.0, 0.0), np.eye(3))


def mirrored_rig(size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065, eye: Eye = "right") -> Rig:
    """Parallel, one eye shot through a beam-splitter: its recorded plate is flipped left-right."""
    return replace(parallel_rig(size, fov_deg=fov_deg, baseline_m=baseline_m), mirrored=eye)


def offset_rig(
    size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065, up_mm: float = 3.0, roll_deg: float = 0.4, pitch_deg: float = 0.2
) -> Rig:
    """Parallel but carelessly mounted: the right eye sits `up_mm` higher and is a little rolled and pitched."""
    camera = Camera.from_fov(fov_deg, size)
    return rig_at(camera, camera, (baseline_m, -up_mm / 1000, 0.0), turn(pitch_deg=pitch_deg, roll_deg=roll_deg))


def hard_rig(size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065, convergence_m: float = 1.5) -> Rig:
    """Everything at once: toed in, distorted, unequal lenses, vertically offset, rolled, right eye mirrored."""
    left, right = _real_lenses(size, fov_deg)
    inward_deg = math.degrees(math.atan2(baseline_m, convergence_m))
    turned = turn(yaw_deg=-inward_deg, pitch_deg=0.25, roll_deg=0.4)
    return rig_at(left, right, (baseline_m, -0.003, 0.002), turned, mirrored="right")


def _real_lenses(size: tuple[int, int], fov_deg: float) -> tuple[Camera, Camera]:
    camera = Camera.from_fov(fov_deg, size)
    w, h = size

    def lens(zoom: float, right_share: float, down_share: float, bend: float) -> Camera:
        K = np.array([[camera.fx * zoom, 0, camera.cx + right_share * w], [0, camera.fy * zoom, camera.cy + down_share * h], [0, 0, 1]])
        return Camera(size=size, K=K, distortion=tuple(bend * k for k in BARREL))

    return lens(1.0, 0.004, -0.006, 1.0), lens(1.006, -0.005, 0.005, 0.96)


RIGS = {
    "parallel": parallel_rig,
    "toed-in": toed_in_rig,
    "mirrored": mirrored_rig,
    "distorted": distorted_rig,
    "offset": offset_rig,
    "hard": hard_rig,
}


def rig_named(name: str, size: tuple[int, int], *, fov_deg: float = 40.0, baseline_m: float = 0.065) -> Rig:
    """One of `RIGS` by name.  Raises RigError with the nearest known name."""
    if name not in RIGS:
        raise RigError(f"rig {name!r} is unknown{nearest_hint(name, RIGS)}")
    return RIGS[name](size, fov_deg=fov_deg, baseline_m=baseline_m)


def is_rectified(rig: Rig) -> bool:
    """Whether the plates are rectified as shot: same K up to cx, no rotation, baseline along x, perfect lenses."""
    a, b = rig.left, rig.right
    same = np.allclose((a.fx, a.fy, a.cy, a.size[1]), (b.fx, b.fy, b.cy, b.size[1]), rtol=EXACT, atol=EXACT)
    square = np.abs(rig.R_right_left - np.eye(3)).max() < EXACT and np.abs(rig.t_right_left_m[1:]).max() < EXACT
    return bool(same and square and not a.distorts and not b.distorts)


def rectified_rig(rig: Rig) -> RectifiedRig:
    """`rig` as a `RectifiedRig` where it is one already.  Raises RigError where the plates need rectification."""
    if not is_rectified(rig):
        raise RigError("the rig is not rectified as it stands (rotation, lens distortion or unequal eyes); rectify the plates first")
    return RectifiedRig(left=rig.left, right=rig.right, baseline_m=rig.baseline_m)
