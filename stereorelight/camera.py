"""Cameras and rigs as numbers: project, unproject, scale, crop.

In, out: pixels (u, v) with (0, 0) at the centre of the top-left pixel; points in metres.
Frames: the camera frame (x right, y down, z forward).  `a_b` reads "a from b": `R_right_left` takes
left-camera points to right-camera points.  The scene frame (y up, looks down -z) begins in surface/position.py.
Lens models and their parameter order are OpenCV's: brown (k1 k2 p1 p2 [k3]), rational (k1 k2 p1 p2 k3 k4 k5 k6),
fisheye (k1 k2 k3 k4, Kannala-Brandt).  Derivations: docs/conventions.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from stereorelight import lens
from stereorelight.arrays import Float32, Float64
from stereorelight.errors import RigError

LensModel = Literal["brown", "rational", "fisheye"]
Eye = Literal["left", "right"]
ROTATION_TOLERANCE = 1e-4  # what a matrix printed with five digits may be off by


def _matrix(value: Any, shape: tuple[int, ...], name: str) -> Float64:
    try:
        m = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RigError(f"{name} must be {shape} numbers, got {value!r}") from None
    if m.shape != shape:
        raise RigError(f"{name} must have shape {shape}, got {m.shape}")
    if not np.isfinite(m).all():
        raise RigError(f"{name} holds a value that is not finite")
    m.setflags(write=False)
    return m


def _rotation(value: Any, name: str) -> Float64:
    R = _matrix(value, (3, 3), name)
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > ROTATION_TOLERANCE:
        raise RigError(f"{name} is not a rotation: R R^T is off the identity by {off:.2g}; use the 3x3 matrix that the calibration wrote")
    if np.linalg.det(R) < 0:
        raise RigError(f"{name} is a reflection (determinant -1), not a rotation; a mirrored eye is said by 'mirrored', not by R")
    if off < 1e-12:  # a rotation to rounding stays as it is, so that a rig comes back from its file bit for bit
        return R
    u, _, vt = np.linalg.svd(R)
    nearest: Float64 = u @ vt
    nearest.setflags(write=False)
    return nearest


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """One calibrated eye: picture size, intrinsic matrix, lens and pose.

    size             : (width, height) in pixels.
    K                : (3, 3), [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], pixels.
    model, distortion: lens model and its parameters in OpenCV's order; () is a perfect pinhole.
    world_from_camera: (4, 4) pose, scene-frame camera (y up, looks down -z) to world, metres; identity by default.
    Raises           : RigError for anything that no camera can be.
    """

    size: tuple[int, int]
    K: Float64
    model: LensModel = "brown"
    distortion: tuple[float, ...] = ()
    world_from_camera: Float64 = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        put = object.__setattr__
        try:
            w, h = (int(n) for n in self.size)
        except (TypeError, ValueError, OverflowError):
            raise RigError(f"size must be [width, height] in pixels, got {self.size!r}") from None
        if w < 1 or h < 1 or (w, h) != tuple(self.size):
            raise RigError(f"size must be two whole numbers of at least 1, got {list(self.size)}")
        put(self, "size", (w, h))
        K = _matrix(self.K, (3, 3), "K")
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise RigError(
                f"focal lengths must be > 0 pixels, got fx {K[0, 0]:g}, fy {K[1, 1]:g}; a mirrored eye is said by 'mirrored', not by a sign"
            )
        if K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0.0, 0.0, 1.0)):
            raise RigError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] without skew")
        put(self, "K", K)
        put(self, "distortion", lens.checked_parameters(self.model, self.distortion))
        pose = _matrix(self.world_from_camera, (4, 4), "world_from_camera")
        if not np.allclose(pose[3], (0, 0, 0, 1)):
            raise RigError("world_from_camera must end in the row 0 0 0 1; it is a 4x4 matrix for column vectors")
        _rotation(pose[:3, :3], "world_from_camera")
        put(self, "world_from_camera", pose)
        border = self._border_pixels()
        bad = ~np.isfinite(lens.undistort(self._normalised(border), self.model, self.distortion)).all(axis=-1)
        if bad.any():
            u, v = border[np.argmax(bad)]
            raise RigError(
                f"lens distortion {list(self.distortion)} folds over inside the frame, at pixel ({u:.0f}, {v:.0f}); "
                "calibrate with a simpler lens model or with views that reach the corners"
            )

    @classmethod
    def from_fov(cls, fov_deg: float, size: tuple[int, int], *, pixel_aspect: float = 1.0) -> Camera:
        """A centred pinhole known only by its horizontal field of view, as in the paper's equations 1-2.

        fov_deg : full horizontal angle between the outer *edges* of the frame, degrees.
        """
        if not 0 < fov_deg < 180:
            raise RigError(f"fov_deg must lie between 0 and 180, got {fov_deg:g}")
        w, h = size
        fx = w / 2 / math.tan(math.radians(fov_deg) / 2)
        return cls(size=size, K=np.array([[fx, 0, (w - 1) / 2], [0, fx * pixel_aspect, (h - 1) / 2], [0, 0, 1]]))

    @property
    def size_hw(self) -> tuple[int, int]:
        """(H, W), as NumPy shapes have it."""
        return self.size[1], self.size[0]

    @property
    def fx(self) -> float:
        return float(self.K[0, 0])

    @property
    def fy(self) -> float:
        return float(self.K[1, 1])

    @property
    def cx(self) -> float:
        return float(self.K[0, 2])

    @property
    def cy(self) -> float:
        return float(self.K[1, 2])

    @property
    def distorts(self) -> bool:
        """Whether the lens bends anything; a fisheye always does."""
        return self.model == "fisheye" or any(self.distortion)

    def _border_pixels(self) -> Float64:
        w, h = self.size
        t = np.linspace(0, 1, 17)
        u, v = t * (w - 1), t * (h - 1)
        edges = [(u, 0 * t), (u, 0 * t + h - 1), (0 * t, v), (0 * t + w - 1, v)]
        return np.concatenate([np.stack(e, axis=-1) for e in edges])

    def _normalised(self, pixels: npt.ArrayLike) -> Float64:
        p = np.asarray(pixels, dtype=np.float64)
        return (p - (self.cx, self.cy)) / (self.fx, self.fy)

    def project(self, points_m: npt.ArrayLike) -> Float64:
        """Pixels (..., 2) of camera-frame points (..., 3).  NaN behind the camera and beyond the lens model's reach."""
        p = np.asarray(points_m, dtype=np.float64)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        bent = lens.distort(p[..., :2] / z[..., None], self.model, self.distortion)
        return bent * (self.fx, self.fy) + (self.cx, self.cy)

    def rays(self, pixels: npt.ArrayLike) -> Float64:
        """Camera-frame directions (..., 3) with z = 1 through pixels (..., 2); NaN beyond the lens model's reach."""
        straight = lens.undistort(self._normalised(pixels), self.model, self.distortion)
        return np.concatenate([straight, np.ones_like(straight[..., :1])], axis=-1)

    def unproject(self, pixels: npt.ArrayLike, Z_m: npt.ArrayLike) -> Float64:
        """Camera-frame points (..., 3) at distance `Z_m` along the optical axis through pixels (..., 2)."""
        points: Float64 = self.rays(pixels) * np.asarray(Z_m, dtype=np.float64)[..., None]
        return points

    def pixel_grid(self) -> Float64:
        """(H, W, 2) pixel coordinates (u, v) of every pixel centre."""
        w, h = self.size
        return np.stack(np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64)), axis=-1)

    def ray_grid(self) -> Float32:
        """(H, W, 2) float32: x/z and y/z of the ray through every pixel centre, lens undone."""
        return np.ascontiguousarray(self.rays(self.pixel_grid())[..., :2], dtype=np.float32)

    def scaled(self, size: tuple[int, int]) -> Camera:
        """The camera of the same picture resized to `size`; pixel *edges* stay: cx' = (cx + 0.5) s - 0.5."""
        sx, sy = size[0] / self.size[0], size[1] / self.size[1]
        K = np.array([[self.fx * sx, 0, (self.cx + 0.5) * sx - 0.5], [0, self.fy * sy, (self.cy + 0.5) * sy - 0.5], [0, 0, 1]])
        return replace(self, size=size, K=K)

    def cropped(self, x: int, y: int, size: tuple[int, int]) -> Camera:
        """The camera of the window whose top-left pixel is (x, y); negative values add overscan."""
        K = np.array([[self.fx, 0, self.cx - x], [0, self.fy, self.cy - y], [0, 0, 1]])
        return replace(self, size=size, K=K)

    def undistorted(self) -> Camera:
        """The same camera with a perfect lens."""
        return replace(self, model="brown", distortion=())


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """Two calibrated eyes.  A mirrored eye's camera describes its flipped-back picture.

    R_right_left, t_right_left_m : x_right = R x_left + t, camera frames, metres.
    mirrored                     : the eye shot through a beam-splitter mirror, or None.
    quality                      : what the calibration said of itself; carried, never read.
    """

    left: Camera
    right: Camera
    R_right_left: Float64
    t_right_left_m: Float64
    mirrored: Eye | None = None
    quality: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "R_right_left", _rotation(self.R_right_left, "R_right_left"))
        object.__setattr__(self, "t_right_left_m", _matrix(self.t_right_left_m, (3,), "t_right_left_m"))
        if self.mirrored not in (None, "left", "right"):
            raise RigError(f"mirrored must be null, 'left' or 'right', got {self.mirrored!r}")
        x, y, z = self.right_centre_m
        if np.linalg.norm(self.t_right_left_m) < 1e-6:
            raise RigError("t_right_left_m is zero: two eyes at one place give no depth")
        if abs(x) <= max(abs(y), abs(z)):
            where = f"({x:.4g}, {y:.4g}, {z:.4g})"
            raise RigError(f"the right eye stands at {where} m from the left one: it must be mainly to the right; check t_right_left_m")
        if x < 0:
            raise RigError(f"the right eye stands {-x:.4g} m to the LEFT of the left eye; are left and right swapped?")

    @property
    def right_centre_m(self) -> Float64:
        """(3,) where the right eye stands, in the left camera frame, metres."""
        centre: Float64 = -self.R_right_left.T @ self.t_right_left_m
        return centre

    @property
    def baseline_m(self) -> float:
        """Distance between the two eyes, metres."""
        return float(np.linalg.norm(self.t_right_left_m))

    def camera(self, eye: Eye) -> Camera:
        return self.left if eye == "left" else self.right


@dataclass(frozen=True, kw_only=True, eq=False)
class RectifiedRig:
    """Two pinholes whose rows agree: same fx, fy, cy and height; the right one `baseline_m` along +x.

    R_rectified_left, R_rectified_right : from each original camera frame to its rectified one.
    """

    left: Camera
    right: Camera
    baseline_m: float
    R_rectified_left: Float64 = field(default_factory=lambda: np.eye(3))
    R_rectified_right: Float64 = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        if not 0 < self.baseline_m < math.inf:
            raise RigError(f"baseline_m must be > 0, got {self.baseline_m:g}; are left and right swapped?")
        a, b = self.left, self.right
        if a.distorts or b.distorts:
            raise RigError("a rectified camera has no lens distortion; rectify the plates first")
        if not np.allclose((a.fx, a.fy, a.cy, a.size[1]), (b.fx, b.fy, b.cy, b.size[1]), rtol=1e-9, atol=1e-6):
            raise RigError("rectified eyes must share fx, fy, cy and height; is the pair rectified?")
        object.__setattr__(self, "R_rectified_left", _rotation(self.R_rectified_left, "R_rectified_left"))
        object.__setattr__(self, "R_rectified_right", _rotation(self.R_rectified_right, "R_rectified_right"))

    @property
    def doffs_px(self) -> float:
        """cx_right - cx_left: what must be added to a disparity before it is inverse depth."""
        return self.right.cx - self.left.cx

    def depth_from_disparity(self, disparity_px: npt.ArrayLike) -> Float64:
        """Z = fx b / (d + cx_right - cx_left), metres; NaN where that is not in front of the rig."""
        q = np.asarray(disparity_px, dtype=np.float64) + self.doffs_px
        with np.errstate(invalid="ignore", divide="ignore"):
            depth: Float64 = np.where(q > 0, self.left.fx * self.baseline_m / q, np.nan)
        return depth

    def disparity_from_depth(self, Z_m: npt.ArrayLike) -> Float64:
        """d = fx b / Z - (cx_right - cx_left), pixels; the inverse of `depth_from_disparity`."""
        Z = np.asarray(Z_m, dtype=np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            disparity: Float64 = np.where(Z > 0, self.left.fx * self.baseline_m / Z - self.doffs_px, np.nan)
        return disparity
