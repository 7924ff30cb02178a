"""Rectification: two calibrated eyes onto one pair of rows, with maps both ways.

In: a `Rig` and original plates (H, W, 3).  Out: a `Rectification`: the rectified rig, and the same plates on it.
Frames: camera frames (x right, y down, z forward).  Pixels: (0, 0) is the centre of the top-left pixel.
The rotations are OpenCV's (`stereoRectify`, Bouguet); the frames are our own choice: each holds its eye's whole plate, so
that every original pixel can be given a depth, and keeps its own cx, so that converged rigs stay small."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera, Eye, RectifiedRig, Rig
from stereorelight.engine.resample import EVEN, LANCZOS, resample
from stereorelight.errors import PlateError, RigError

FINER = 1.1  # of the plate's own resolution: resampling to the same one costs a tenth of the depth's accuracy
LARGEST_GROWTH = 1.6  # a rectified frame wider than this share of the plate belongs to a lens too wide to rectify whole


@dataclass(frozen=True, kw_only=True, eq=False)
class Rectification:
    """The rectified rig and the way there and back.

    original : the rig that was shot.      rig : the rectified one.
    identity : the plates are rectified already; nothing is resampled.
    """

    original: Rig
    rig: RectifiedRig
    identity: bool
    _maps: dict[str, Float32] = field(default_factory=dict, repr=False)
    _stretch: dict[Eye, Float64] = field(default_factory=dict, repr=False)

    def _cameras(self, eye: Eye) -> tuple[Camera, Camera, Float64]:
        if eye == "left":
            return self.original.left, self.rig.left, self.rig.R_rectified_left
        return self.original.right, self.rig.right, self.rig.R_rectified_right

    def original_from_rectified(self, eye: Eye) -> Float32:
        """(h, w, 2) original pixel of every rectified pixel; NaN beyond the lens model's reach."""
        if eye not in self._maps:
            source, target, R = self._cameras(eye)
            self._maps[eye] = source.project(target.rays(target.pixel_grid()) @ R).astype(np.float32)
        return self._maps[eye]

    def rectified_from_original(self, eye: Eye) -> Float32:
        """(H, W, 2) rectified pixel of every original pixel."""
        key = f"{eye} back"
        if key not in self._maps:
            source, target, R = self._cameras(eye)
            self._maps[key] = target.project(source.rays(source.pixel_grid()) @ R.T).astype(np.float32)
        return self._maps[key]

    def original_over_rectified_depth(self, eye: Eye) -> Float64:
        """(H, W) by how much Z along the original optical axis exceeds Z along the rectified one, per original pixel."""
        if eye not in self._stretch:
            source, _, R = self._cameras(eye)
            self._stretch[eye] = 1 / (source.rays(source.pixel_grid()) @ R[2])
        return self._stretch[eye]

    def step(self, eye: Eye) -> float:
        """How many pixels of the plate lie from one rectified pixel to the next, about the middle of the plate; 1 where nothing is resampled."""
        if self.identity:
            return 1.0
        source, target, R = self._cameras(eye)
        middle = (np.array(source.size) - 1) / 2
        pixels = target.project(source.rays(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])) @ R.T)
        return float(1 / np.sqrt(abs(np.linalg.det(pixels[1:] - pixels[0]))))

    def upright(self, picture: Float32, eye: Eye) -> Float32:
        """The eye's picture as its camera describes it: a mirrored eye is flipped back left-right."""
        return np.ascontiguousarray(picture[:, ::-1]) if self.original.mirrored == eye else picture

    def rectify(self, picture: Float32, eye: Eye, *, to_match: bool = False) -> Float32:
        """An upright plate (H, W, C) on the rectified frame; NaN where the plate does not reach.

        to_match : a little softer, and as soft everywhere, wherever the plate's pixels fall on the frame's.
        Raises : PlateError when the plate is not the camera's size.
        """
        camera = self.original.camera(eye)
        if picture.shape[:2] != camera.size_hw:
            came = f"{picture.shape[1]}x{picture.shape[0]}"
            raise PlateError(
                f"{eye} plate is {came}, but the rig was calibrated at {camera.size[0]}x{camera.size[1]}; use plates of that size, or scale the rig"
            )
        picture = as_float32(picture, f"{eye} plate", channels=picture.shape[2] if picture.ndim == 3 else None)
        if self.identity:
            return picture
        return resample(picture, self.original_from_rectified(eye), EVEN if to_match else LANCZOS)


def _already_rectified(rig: Rig) -> bool:
    a, b = rig.left, rig.right
    x, y, z = rig.t_right_left_m
    return bool(
        np.abs(rig.R_right_left - np.eye(3)).max() < 1e-12
        and max(abs(y), abs(z)) < 1e-12 * abs(x)
        and not a.distorts
        and not b.distorts
        and (a.fx, a.fy, a.cy, a.size) == (b.fx, b.fy, b.cy, b.size)
    )


def _extent(camera: Camera, R: Float64, focal: tuple[float, float]) -> tuple[float, float, float, float]:
    """Bounding box (u0, v0, u1, v1) of the camera's outer pixel edges, in rectified pixels about a principal point at 0."""
    w, h = camera.size
    t = np.linspace(-0.5, 0.5, 65)
    u, v = (t + 0.5) * w - 0.5, (t + 0.5) * h - 0.5
    border = np.concatenate([np.stack(e, -1) for e in [(u, 0 * t - 0.5), (u, 0 * t + h - 0.5), (0 * t - 0.5, v), (0 * t + w - 0.5, v)]])
    rays = camera.rays(border) @ R.T
    rays = rays[np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.05)]
    if len(rays) < 8:
        raise RigError("the eyes look too far apart to be rectified; check R_right_left")
    uv = rays[:, :2] / rays[:, 2:] * focal
    (u0, v0), (u1, v1) = uv.min(axis=0), uv.max(axis=0)
    return float(u0), float(v0), float(u1), float(v1)


def _exact_rotations(rig: Rig, R_rectified_left: Float64) -> tuple[Float64, Float64]:
    """The same rotations to the last digit: OpenCV takes any turn below 1e-5 rad for none, which costs 1e-4 px of row."""
    x = rig.right_centre_m / rig.baseline_m
    y = np.cross(R_rectified_left[2], x)
    y /= np.linalg.norm(y)
    R_left = np.stack([x, y, np.cross(x, y)])
    return R_left, R_left @ rig.R_right_left.T


def rectification(rig: Rig) -> Rectification:
    """Rectify `rig`: rows agree, each frame holds its eye's whole plate, a little finer than the left plate itself.

    Raises : RigError when the eyes look too far apart for one picture plane.
    """
    if _already_rectified(rig):
        return Rectification(original=rig, rig=RectifiedRig(left=rig.left, right=rig.right, baseline_m=rig.baseline_m), identity=True)
    none = np.zeros(5)
    R_opencv = cv2.stereoRectify(rig.left.K, none, rig.right.K, none, rig.left.size, rig.R_right_left, rig.t_right_left_m[:, None])[0]
    R_left, R_right = _exact_rotations(rig, R_opencv)
    angle = np.degrees(np.arccos(np.clip((np.trace(rig.R_right_left) - 1) / 2, -1, 1)))
    if angle > 45:
        raise RigError(f"the eyes are turned {angle:.0f} degrees against each other; one picture plane cannot hold both: check R_right_left")
    focal = (rig.left.fx * FINER, rig.left.fy * FINER)
    u0, v0, u1, v1 = _extent(rig.left, R_left, focal)
    p0, q0, p1, q1 = _extent(rig.right, R_right, focal)
    v0, v1 = min(v0, q0), max(v1, q1)
    w_left, h_left = rig.left.size
    limit_w, limit_h = LARGEST_GROWTH * FINER * w_left, LARGEST_GROWTH * FINER * h_left
    width = int(np.ceil(min(max(u1 - u0, p1 - p0), limit_w)))
    height = int(np.ceil(min(v1 - v0, limit_h)))

    def centred(low: float, high: float, size: int) -> float:
        """Principal point that puts the middle of low..high in the middle of `size` pixels."""
        return (size - 1) / 2 - (low + high) / 2

    cy = centred(v0, v1, height)
    left = Camera(size=(width, height), K=np.array([[focal[0], 0, centred(u0, u1, width)], [0, focal[1], cy], [0, 0, 1]]))
    right = Camera(size=(width, height), K=np.array([[focal[0], 0, centred(p0, p1, width)], [0, focal[1], cy], [0, 0, 1]]))
    rectified = RectifiedRig(left=left, right=right, baseline_m=rig.baseline_m, R_rectified_left=R_left, R_rectified_right=R_right)
    return Rectification(original=rig, rig=rectified, identity=False)
