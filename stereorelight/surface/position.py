"""Position from depth: where the camera frame meets the scene frame, and the only place where it does.

In: Z (H, W), metres along the optical axis, and the camera of the plate that Z lies on.  Out: P (H, W, 3), metres.
Frames: camera frame (x right, y down, z forward) in, scene frame (x right, y up, the camera looks down -z) out.
Pixels: (0, 0) is the centre of the top-left pixel.  Unknown Z gives unknown P: NaN."""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, RigError

SCENE_FROM_CAMERA = np.array([1.0, -1.0, -1.0])  # half a turn about x; its own inverse


def scene_from_camera(vectors: npt.ArrayLike) -> Float64:
    """Camera-frame points or directions (..., 3) in the scene frame: y and z change sign."""
    scene: Float64 = np.asarray(vectors, dtype=np.float64) * SCENE_FROM_CAMERA
    return scene


def camera_from_scene(vectors: npt.ArrayLike) -> Float64:
    """Scene-frame points or directions (..., 3) in the camera frame; the inverse of `scene_from_camera`."""
    camera: Float64 = np.asarray(vectors, dtype=np.float64) * SCENE_FROM_CAMERA
    return camera


@functools.lru_cache(maxsize=4)
def _rays(size: tuple[int, int], K: bytes, model: str, distortion: tuple[float, ...]) -> Float64:
    # Keyed by value: every frame of a shot, and every copy of its camera, shares one undistortion of the lens.
    matrix = np.frombuffer(K).reshape(3, 3)
    camera = Camera(size=size, K=matrix, model=model, distortion=distortion)  # type: ignore[arg-type]
    rays = np.ascontiguousarray(camera.rays(camera.pixel_grid())[..., :2])
    rays.setflags(write=False)
    return rays


def ray_slopes(camera: Camera) -> Float64:
    """(H, W, 2) float64, read-only: x/z and y/z of the ray through every pixel centre, camera frame, lens undone.

    NaN beyond the lens model's reach.  Kept for the last few cameras, since a shot asks for the same one every frame.
    """
    return _rays(camera.size, camera.K.tobytes(), camera.model, camera.distortion)


def checked_depth(Z: npt.ArrayLike, camera: Camera) -> Float32:
    """Z as (H, W) float32 of the camera's size, NaN or > 0.  Raises PassError otherwise."""
    depth = as_float32(Z, "Z", size_hw=camera.size_hw)
    with np.errstate(invalid="ignore"):
        off = np.isinf(depth) | (depth <= 0)
    if off.any():
        raise PassError(f"Z must be > 0 metres or NaN, got {float(depth[off][0]):g} at {int(off.sum())} pixels; missing is NaN, never 0 or infinity")
    return depth


def position_from_depth(Z: npt.ArrayLike, camera: Camera) -> Float32:
    """P (H, W, 3) float32, scene frame of the camera, metres: exact unprojection, lens distortion and all.

    Z       : (H, W) float, metres along the optical axis (not ray length), on the plate that `camera` describes.
    Returns : P = (x Z, -y Z, -Z) with (x, y, 1) the ray through the pixel's centre; NaN where Z is, or the lens has no ray.
    Raises  : PassError for a wrong shape or type, and for Z that is not positive.
    """
    depth = checked_depth(Z, camera)
    rays = ray_slopes(camera)
    P = np.empty((*depth.shape, 3), dtype=np.float32)
    P[..., 0] = rays[..., 0] * depth
    P[..., 1] = rays[..., 1] * -depth
    P[..., 2] = np.where(np.isnan(rays[..., 0]), np.nan, -depth)
    return P


def paper_position(Z: npt.ArrayLike, fov_deg: float, *, aspect: float | None = None) -> Float32:
    """(H, W, 3) float32: the paper's equations 1 and 2 exactly as printed, for comparison only; never used by a step.

    fov_deg : horizontal field of view, degrees.
    aspect  : the paper's `ar`; width / height where None.
    Px = sin(fov/2) - x sin(fov/2) / width, Py = sin(fov/2) ar - y sin(fov/2) ar / height, Pz = Z, with x and y whole columns and rows.
    Errata: a pinhole needs tan for sin; a factor 2 is missing, so the frame covers only one side of the axis; Px and Py are
    never multiplied by Z; x grows to the left; `ar` should divide; equation 2 is printed as Px.  See `position_from_depth`.
    """
    depth = as_float32(Z, "Z")
    if not 0 < fov_deg < 180:
        raise RigError(f"fov_deg must lie between 0 and 180, got {fov_deg:g}")
    height, width = depth.shape
    ar = width / height if aspect is None else aspect
    reach = math.sin(math.radians(fov_deg) / 2)
    P = np.empty((height, width, 3), dtype=np.float32)
    P[..., 0] = reach - np.arange(width) * reach / width
    P[..., 1] = (reach * ar - np.arange(height) * reach * ar / height)[:, None]
    P[..., 2] = depth
    return P
