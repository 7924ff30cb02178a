"""The seen points as a cloud: one eye's, or both eyes' brought together.

In: Z (H, W) of each eye on its own plate, its camera, and what goes with it.  Out: a `Cloud`, scene frame of the left camera, metres.
Where both eyes see a point it is one point, at the mean of both weighted by their variances, along the left eye's ray; what one eye
alone sees is kept; a point of the right eye that the left one looks through is a mistake of one of them, and is left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, RigError
from stereorelight.surface.position import SCENE_FROM_CAMERA, checked_depth, position_from_depth

ALIKE_SIGMAS = 3.0  # two eyes' depths within so many standard deviations of their difference are one surface ...
ALIKE_SHARE = 0.005  # ... and always within this share of the distance


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenBy:
    """What one eye saw: Z (H, W) metres on the plate that `camera` describes, and as far as known its standard deviation (metres),
    confidence 0..1, colour (H, W, 3) linear, and normals (H, W, 3) in the scene frame of that camera."""

    Z: npt.ArrayLike
    camera: Camera
    Z_sigma: npt.ArrayLike | None = None
    confidence: npt.ArrayLike | None = None
    colour: npt.ArrayLike | None = None
    N: npt.ArrayLike | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """points (n, 3) float32, metres; normals and colours (n, 3), sigma_m and confidence (n,), where they are known."""

    points: Float32
    normals: Float32 | None = None
    colours: Float32 | None = None
    sigma_m: Float32 | None = None
    confidence: Float32 | None = None

    def __len__(self) -> int:
        return len(self.points)


def cloud_of(eye: SeenBy, *, least_confidence: float = 0.0) -> Cloud:
    """One eye's known points, row by row, in the scene frame of its own camera.

    least_confidence : points below it are left out.
    Raises           : PassError where no point is left, and for arrays that do not fit.
    """
    Z = checked_depth(eye.Z, eye.camera)
    size_hw = eye.camera.size_hw
    P = position_from_depth(Z, eye.camera)
    kept = np.isfinite(P).all(axis=-1)
    sure = None if eye.confidence is None else as_float32(eye.confidence, "confidence", size_hw=size_hw)
    if sure is not None:
        kept &= np.nan_to_num(sure) >= least_confidence
    if not kept.any():
        raise PassError("the surface has no known point" + (f" of confidence {least_confidence:g} and more" if least_confidence > 0 else ""))

    def taken(values: npt.ArrayLike | None, name: str, channels: int | None) -> Float32 | None:
        return None if values is None else np.nan_to_num(as_float32(values, name, channels=channels, size_hw=size_hw)[kept])

    return Cloud(
        points=P[kept],
        normals=taken(eye.N, "N", 3),
        colours=taken(eye.colour, "colour", 3),
        sigma_m=taken(eye.Z_sigma, "Z_sigma", None),
        confidence=taken(sure, "confidence", None),
    )


def merged(left: SeenBy, right: SeenBy, left_from_right: npt.ArrayLike, *, least_confidence: float = 0.0) -> Cloud:
    """Both eyes' points in the scene frame of the left camera.

    left_from_right : (4, 4) rigid, scene frame of the right camera to that of the left one.
    Raises          : PassError, RigError.
    """
    pose = np.asarray(left_from_right, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-4:
        raise RigError("left_from_right must be a 4x4 rotation and translation without scale")
    other = cloud_of(right, least_confidence=least_confidence)
    points = other.points @ pose[:3, :3].T + pose[:3, 3]
    camera = left.camera
    depth = checked_depth(left.Z, camera).copy()
    sigma = np.full(depth.shape, 0.0, np.float32) if left.Z_sigma is None else np.nan_to_num(as_float32(left.Z_sigma, "Z_sigma"))
    pixel = camera.project(points * SCENE_FROM_CAMERA)
    with np.errstate(invalid="ignore"):
        inside = (pixel > -0.5).all(axis=-1) & (pixel[:, 0] < camera.size[0] - 0.5) & (pixel[:, 1] < camera.size[1] - 0.5)
    at = np.rint(np.where(inside[:, None], pixel, 0)).astype(np.int64)
    seen = np.where(inside, depth[at[:, 1], at[:, 0]], np.nan)
    z = -points[:, 2]
    own = np.zeros(len(points)) if other.sigma_m is None else other.sigma_m.astype(np.float64)
    spread = np.hypot(own, sigma[at[:, 1], at[:, 0]])
    with np.errstate(invalid="ignore"):
        same = np.abs(z - seen) <= np.maximum(ALIKE_SIGMAS * spread, ALIKE_SHARE * seen)
        new = np.isnan(seen) | (~same & (z > seen))
    depth = _averaged(depth, sigma, z[same], own[same], at[same])
    first = cloud_of(replace(left, Z=depth), least_confidence=least_confidence)

    def joined(a: Float32 | None, b: Float32 | None) -> Float32 | None:
        return None if a is None or b is None else np.concatenate([a, b[new]])

    turned = None if other.normals is None else (other.normals @ pose[:3, :3].T).astype(np.float32)
    return Cloud(
        points=np.concatenate([first.points, points[new].astype(np.float32)]),
        normals=joined(first.normals, turned),
        colours=joined(first.colours, other.colours),
        sigma_m=joined(first.sigma_m, other.sigma_m),
        confidence=joined(first.confidence, other.confidence),
    )


def _averaged(depth: Float32, sigma: Float32, z: Float64, own: Float64, at: npt.NDArray[np.int64]) -> Float32:
    """The left depth averaged with the right eye's points that fall onto its pixels, each by 1 / variance."""
    least = 1e-6
    weight = 1 / np.maximum(sigma.astype(np.float64), least) ** 2
    total, sum_ = weight.copy(), weight * np.nan_to_num(depth.astype(np.float64))
    more = 1 / np.maximum(own, least) ** 2
    np.add.at(total, (at[:, 1], at[:, 0]), more)
    np.add.at(sum_, (at[:, 1], at[:, 0]), more * z)
    return np.where(np.isfinite(depth), sum_ / total, np.nan).astype(np.float32)
