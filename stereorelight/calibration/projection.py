"""Projection with exact derivatives, for the solver: the formulas of lens.py, differentiated by hand.

In: camera-frame points (..., 3), metres; intrinsics (4 + k,) as fx fy cx cy and the lens parameters in OpenCV's order.
Out: pixels (..., 2), and their derivatives by the point (..., 2, 3) and by the intrinsics (..., 2, 4 + k).
Frames: camera frame (x right, y down, z forward).  Pixels: (0, 0) is the centre of the top-left pixel.
Unlike lens.py nothing is NaN beyond a fold: a solver has to find its way back from there; the result is checked by `Camera`."""

from __future__ import annotations

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, LensModel
from stereorelight.errors import RigError, nearest_hint

# The lens models that a calibration can try, simplest first: the model of lens.py and the number of its parameters.
LENSES: dict[str, tuple[LensModel, int]] = {
    "pinhole": ("brown", 0),
    "brown4": ("brown", 4),
    "brown5": ("brown", 5),
    "fisheye": ("fisheye", 4),
    "rational": ("rational", 8),
}
NEAREST = 1e-6  # metres: what a bad step put behind the eye is projected from here, far outside the frame


def checked_lens(name: str) -> tuple[LensModel, int]:
    """The model and the number of parameters of lens `name`.  Raises RigError."""
    if name not in LENSES:
        raise RigError(f"lens {name!r} cannot be calibrated{nearest_hint(str(name), LENSES)}")
    return LENSES[name]


def lens_of(camera: Camera) -> str:
    """The name in `LENSES` of the lens that `camera` has."""
    if camera.model == "brown":
        return {0: "pinhole", 4: "brown4", 5: "brown5"}[len(camera.distortion)]
    return camera.model


def intrinsics_of(camera: Camera) -> Float64:
    """fx fy cx cy and the lens parameters of `camera`."""
    missing = checked_lens(lens_of(camera))[1] - len(camera.distortion)  # a fisheye or rational lens may be written without any
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion, *[0.0] * missing])


def camera_of(intrinsics: Float64, lens: str, size: tuple[int, int]) -> Camera:
    """The camera of the intrinsics; RigError where the lens folds over inside the frame."""
    fx, fy, cx, cy = intrinsics[:4]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Camera(size=size, K=K, model=checked_lens(lens)[0], distortion=tuple(intrinsics[4:]))


def project(points_m: Float64, intrinsics: Float64, lens: str) -> tuple[Float64, Float64, Float64]:
    """Pixels (..., 2) of points (..., 3), d pixels / d point (..., 2, 3), d pixels / d intrinsics (..., 2, 4 + k)."""
    model, count = checked_lens(lens)
    z = np.maximum(points_m[..., 2], NEAREST)
    x, y = points_m[..., 0] / z, points_m[..., 1] / z
    fx, fy, cx, cy = intrinsics[:4]
    k = intrinsics[4:]
    by_lens = np.zeros((*x.shape, 2, 4 + count))
    if count == 0:
        bx, by = x, y
        xx, xy, yx, yy = np.ones_like(x), np.zeros_like(x), np.zeros_like(x), np.ones_like(x)
    elif model == "fisheye":
        bx, by, (xx, xy, yx, yy) = _fisheye(x, y, k, by_lens)
    else:
        bx, by, (xx, xy, yx, yy) = _brown(x, y, k, by_lens)
    pixels = np.stack([fx * bx + cx, fy * by + cy], axis=-1)
    by_lens[..., 0, 4:] *= fx
    by_lens[..., 1, 4:] *= fy
    by_lens[..., 0, 0], by_lens[..., 1, 1] = bx, by
    by_lens[..., 0, 2] = by_lens[..., 1, 3] = 1
    by_point = np.empty((*x.shape, 2, 3))
    by_point[..., 0, 0], by_point[..., 0, 1] = fx * xx / z, fx * xy / z
    by_point[..., 1, 0], by_point[..., 1, 1] = fy * yx / z, fy * yy / z
    by_point[..., 2] = -(by_point[..., 0] * x[..., None] + by_point[..., 1] * y[..., None])
    return pixels, by_point, by_lens


def _brown(x: Float64, y: Float64, k: Float64, by_lens: Float64) -> tuple[Float64, Float64, tuple[Float64, ...]]:
    """Brown and rational: the bent point and its derivatives; those by the lens parameters go into `by_lens`."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.append(k, np.zeros(8 - len(k)))
    r2 = x * x + y * y
    low = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    g = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / low
    dg = (k1 + r2 * (2 * k2 + r2 * 3 * k3) - g * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / low
    bx = x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    by = y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    powers = (r2, r2**2, r2**3)
    radial = [powers[0] / low, powers[1] / low, None, None, powers[2] / low, *(-g * p / low for p in powers)]
    for i in range(len(k)):
        by_i = radial[i]
        if by_i is not None:
            by_lens[..., 0, 4 + i], by_lens[..., 1, 4 + i] = x * by_i, y * by_i
    by_lens[..., 0, 6], by_lens[..., 1, 6] = 2 * x * y, r2 + 2 * y * y
    by_lens[..., 0, 7], by_lens[..., 1, 7] = r2 + 2 * x * x, 2 * x * y
    cross = 2 * x * y * dg + 2 * p1 * x + 2 * p2 * y
    return bx, by, (g + 2 * x * x * dg + 2 * p1 * y + 6 * p2 * x, cross, cross, g + 2 * y * y * dg + 6 * p1 * y + 2 * p2 * x)


def _fisheye(x: Float64, y: Float64, k: Float64, by_lens: Float64) -> tuple[Float64, Float64, tuple[Float64, ...]]:
    """Kannala and Brandt: the bent point and its derivatives; those by the lens parameters go into `by_lens`."""
    r2 = x * x + y * y
    r = np.sqrt(np.maximum(r2, 1e-16))  # at the axis the ratios below have their limits to rounding
    theta = np.arctan(r)
    t2 = theta * theta
    g = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r
    dtheta = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    dg = (dtheta / (1 + r2) - g) / np.maximum(r2, 1e-8)  # (dg/dr) / r
    for i in range(4):
        by_k = theta * t2 ** (i + 1) / r
        by_lens[..., 0, 4 + i], by_lens[..., 1, 4 + i] = x * by_k, y * by_k
    return x * g, y * g, (g + x * x * dg, x * y * dg, x * y * dg, g + y * y * dg)


def rotation(vector: Float64) -> Float64:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), radians (Rodrigues)."""
    v = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    W = np.zeros((*v.shape, 3))
    W[..., 0, 1], W[..., 0, 2], W[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    W[..., 1, 0], W[..., 2, 0], W[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    # sin(a)/a and (1 - cos(a))/a^2 without loss near zero
    first, second = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    R: Float64 = np.eye(3) + first * W + second * (W @ W)
    return R
