"""Normals from depth: a robust local plane fit on inverse depth, or the paper's differences of positions.

In: Z (H, W), metres along the optical axis, and the camera of the plate that Z lies on.
Out: N (H, W, 3) float32, unit, scene frame (x right, y up, the camera looks down -z), facing the camera; NaN where unknown.

Along the ray (x, y, 1) a plane n . P = c is met at 1/Z = (n . (x, y, 1)) / c: inverse depth is affine in the ray's slopes for any
lens, so a plane fitted to it has no bias on planes, however steep or distorted."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera, RectifiedRig
from stereorelight.engine import planes
from stereorelight.errors import PassError, nearest_hint
from stereorelight.surface.position import checked_depth, position_from_depth, ray_slopes

Method = Literal["plane", "difference"]
RADII_PX = (1, 2, 4, 8, 16, 32)
# Measured over expected error, on synthetic shots: fits finer than this are somewhat better than they look, coarse ones as they look.
SIGMA_FINE_DEG, SIGMA_COARSE_DEG = 8.0, 16.0
SIGMA_FINE_GAIN, SIGMA_COARSE_GAIN = 0.82, 1.05
# Of depth that matching has smoothed, whose windows agree better than they are right: log(N_sigma, degrees) as always, log of the windows' own
# disagreement, radians, log of Z_sigma over a pixel's width, log of how far the surface faces the camera (one, as geometry has it: the fit left
# free takes too little of it for floors), and log of the windows' half-width.
FITTED = (4.713, 0.5, 0.694, 1.0, -0.868)
FITTED_LEAST_DEG = 0.25  # joins it in square: renders are truer than any rig, whose rows and lenses tilt a surface by as much
FITTED_MOST_DEG = 55.0  # normals of which nothing is known are off by no more than this, two times in three
LEAST_ERROR = 1e-4  # radians, and metres per metre
LEAST_FACING = 0.05


def _facing(normals: Float64, towards: Float64) -> Float32:
    """Unit (H, W, 3) float32, turned so that N . towards > 0; NaN where the length or the side is unknown."""
    length = np.sqrt((normals * normals).sum(axis=-1))
    side = (normals * towards).sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where((length > 0) & (side != 0), np.sign(side) / length, np.nan)
    return np.ascontiguousarray(normals * scale[..., None], dtype=np.float32)


def _by_difference(Z: npt.ArrayLike, camera: Camera) -> Float32:
    """The paper's equations 3-5, the last row and column from the difference before them."""
    P = position_from_depth(Z, camera).astype(np.float64)
    if min(P.shape[:2]) < 2:
        raise PassError(f"normals need at least 2x2 pixels, got {P.shape[1]}x{P.shape[0]}")
    across = np.diff(P, axis=1)
    down = np.diff(P, axis=0)
    across = np.concatenate([across, across[:, -1:]], axis=1)
    down = np.concatenate([down, down[-1:]], axis=0)
    return _facing(np.cross(across, down), -P)


def normals_from_depth(
    Z: npt.ArrayLike,
    camera: Camera,
    *,
    method: Method = "plane",
    radii_px: tuple[int, ...] = RADII_PX,
    confidence: npt.ArrayLike | None = None,
    noise_per_m: float = 0.0,
) -> Float32:
    """N (H, W, 3) float32, unit, scene frame of the camera, facing it (N . V > 0 with V towards the camera); NaN where Z is.

    method      : "plane", edge-aware plane fits on inverse depth at several scales, the scale chosen by the data's own noise;
                  "difference", the paper's forward differences of P (equations 3-5), which show noise and wall off depth edges.
    radii_px    : half-widths of the windows tried, growing; the last one only judges the one before it.
    confidence  : (H, W) in 0..1, weighs the neighbours; 0 leaves one out.  NaN counts as 0.
    noise_per_m : what 1/Z is at least off by (standard deviation), 1/metres: sigma_px / (fx baseline_m).  0 trusts the data.
    Raises      : PassError for wrong shapes, types and Z that is not positive.
    """
    return normals_and_sigma(Z, camera, method=method, radii_px=radii_px, confidence=confidence, noise_per_m=noise_per_m)[0]


def normals_and_sigma(
    Z: npt.ArrayLike,
    camera: Camera,
    *,
    method: Method = "plane",
    radii_px: tuple[int, ...] = RADII_PX,
    confidence: npt.ArrayLike | None = None,
    noise_per_m: float = 0.0,
    Z_sigma: npt.ArrayLike | None = None,
) -> tuple[Float32, Float32 | None]:
    """`normals_from_depth`, and how far N is expected to be off: (H, W) float32 degrees, NaN where N is; None for "difference".

    It is the angle that 68 % of normals like it stay within, read from the depth itself: windows of one scale disagree with those
    of the next by their noise and by the shape that they cannot follow.  What all windows share, such as a depth that is wrong
    as a whole or a wrong surface behind an edge, it cannot know; that is what the confidence of Z is for.
    Z_sigma : (H, W) metres, the standard deviation of a Z that was smoothed or fitted, as recovered depth is: its windows agree
              better than they are right, and the angle is told wider by what that was measured to be.
    """
    if method == "difference":
        return _by_difference(Z, camera), None
    if method != "plane":
        raise PassError(f"normals method {method!r} is unknown{nearest_hint(method, ('plane', 'difference'))}")
    depth = checked_depth(Z, camera)
    rays = ray_slopes(camera)
    N, error, radius = _by_planes(1 / depth.astype(np.float64), rays, confidence, radii_px, noise_per_m)
    if Z_sigma is None:
        return N, _as_sigma(error)
    tilt = camera.fx * as_float32(Z_sigma, "Z_sigma", size_hw=camera.size_hw) / depth
    told = np.where(np.isfinite(tilt), told_deg(what_normals_know(N, error, radius, tilt, rays)), _as_sigma(error))
    return N, told.astype(np.float32)


def what_normals_know(N: Float32, error: Float32, radius: Float32, tilt: Float32, rays: Float64) -> tuple[npt.NDArray[np.floating], ...]:
    """The logarithms that `FITTED` weighs, each (H, W): of the windows' disagreement, of `tilt`, which is Z_sigma over a pixel's width, of how far
    the surface faces the camera, and of the windows' half-width.  The tilt is an error that hangs together over some pixels: the wider the
    window beside that, the less of it the normal takes."""
    facing = (N[..., 2] - N[..., 0] * rays[..., 0] + N[..., 1] * rays[..., 1]) / np.sqrt(1 + (rays * rays).sum(axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        pairs = zip((error, tilt, facing, radius), (LEAST_ERROR, LEAST_ERROR, LEAST_FACING, 1.0), strict=True)
        return tuple(np.log(np.maximum(value, least)) for value, least in pairs)


def told_deg(known: tuple[npt.NDArray[np.floating], ...], coefficients: tuple[float, ...] = FITTED) -> Float32:
    """`N_sigma`, degrees, by what `what_normals_know`."""
    always, *shares = coefficients
    log: npt.NDArray[np.floating] | float = always
    for share, value in zip(shares, known, strict=True):
        log = log + share * value
    with np.errstate(invalid="ignore"):
        told: Float32 = np.hypot(FITTED_MOST_DEG * -np.expm1(-np.exp(log) / FITTED_MOST_DEG), FITTED_LEAST_DEG).astype(np.float32)
    return told


def _as_sigma(error: Float32) -> Float32:
    """Degrees from the fit's own expected error, in radians, as measured against truth (docs/depth.md)."""
    degrees = np.degrees(error)
    gain = np.interp(degrees, (SIGMA_FINE_DEG, SIGMA_COARSE_DEG), (SIGMA_FINE_GAIN, SIGMA_COARSE_GAIN))
    return np.minimum(degrees * gain, 90).astype(np.float32)


def normals_from_disparity(
    disparity: npt.ArrayLike,
    rig: RectifiedRig,
    *,
    radii_px: tuple[int, ...] = RADII_PX,
    confidence: npt.ArrayLike | None = None,
    noise_px: float = 0.0,
) -> Float32:
    """The plane fit straight on a rectified disparity, (H, W) pixels on the left view, NaN where unknown.

    A plane in space is a plane in disparity, so this is `normals_from_depth` without the way through Z; N is in the scene frame of
    the rectified left camera.  noise_px : what the disparity is at least off by, pixels.
    """
    d = as_float32(disparity, "disparity", size_hw=rig.left.size_hw)
    inverse = (d.astype(np.float64) + rig.doffs_px) / (rig.left.fx * rig.baseline_m)
    inverse[~(np.isfinite(inverse) & (inverse > 0))] = np.nan
    return _by_planes(inverse, ray_slopes(rig.left), confidence, radii_px, noise_px / (rig.left.fx * rig.baseline_m))[0]


def _by_planes(
    inverse: Float64, rays: Float64, confidence: npt.ArrayLike | None, radii_px: tuple[int, ...], noise: float
) -> tuple[Float32, Float32, Float32]:
    h, w = inverse.shape
    if len(radii_px) < 2 or any(not isinstance(r, int | np.integer) for r in radii_px) or radii_px[0] < 1 or list(radii_px) != sorted(set(radii_px)):
        raise PassError(f"radii_px must be at least two growing whole numbers from 1, got {radii_px!r}")
    if not noise >= 0:
        raise PassError(f"noise must be >= 0, got {noise!r}")
    weight = np.ones((h, w)) if confidence is None else as_float32(confidence, "confidence", size_hw=(h, w)).astype(np.float64)
    return planes.plane_normals(inverse, rays, weight, tuple(int(r) for r in radii_px), float(noise))
