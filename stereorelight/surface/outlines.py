"""Normals beside outlines: a surface that is seen to turn away as it nears its outline has turned away altogether at it.

In: a matched Z with its doubt, and normals fitted to it.  Out: normals, changed on the near side of depth edges alone, over a few pixels.

Windows of plane fits cannot follow a limb to its rim, where the normal turns by 50 degrees within the last pixels.  But where a smooth surface ends
in an outline of its own, the line of sight grazes it there (Koenderink 1984); and of a limb that is round, s, the part of its unit normal that
points out of it across the picture, rises in a straight line to 1 on the outline: s = 1 - t / R, t pixels inside.  A card's edge and the far edge of
a table are no such rims: s must be large where windows still know it, and must have risen on the way there as it would on a limb."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.surface.position import checked_depth, ray_slopes

f4 = np.float32
REACH_PX = 7.0  # inside an outline, where windows of normals are not cut by it
DEEP_PX = 2.5 * REACH_PX  # farther inside, to see that the surface turns
STEEP = 6.0  # slope between neighbours that is two surfaces (81 deg)
GENTLE = 2.5  # mean slope over some pixels that is one (68 deg); twice that within the last ones
EDGE_SIGMAS = 3.0  # and what the depth's own doubt may add to either
ALONG_PX = 2.0  # over which the direction of an outline is evened
FACING_OUT = (0.6, 0.85)  # s at REACH_PX: of no rim, and of a rim
TURNING = (0.3, 0.65)  # rise of s from DEEP_PX to REACH_PX over that of a limb: flat, and a limb
SURER = 0.4  # of N_sigma, by which rims are then less far off: on five scenes
FULL = 1 / 3  # of the way in from the outline: no window knows better up to there

Index = npt.NDArray[np.intp]


def _steps_out(v: Float32, doubt: Float32, known: Bool, focal: float) -> tuple[Float32, Float32]:
    """(H, W) steps along x and y out of a near pixel to neighbours that are another surface behind it; 0 and 0 elsewhere."""
    limit = f4(STEEP / focal) + f4(EDGE_SIGMAS) * doubt
    x, y = np.zeros_like(v), np.zeros_like(v)
    for out, axis in ((x, 1), (y, 0)):
        a, b = (np.moveaxis(v, axis, 0)[s] for s in (np.s_[:-1], np.s_[1:]))
        la, lb = (np.moveaxis(limit, axis, 0)[s] for s in (np.s_[:-1], np.s_[1:]))
        both = np.moveaxis(known, axis, 0)[:-1] & np.moveaxis(known, axis, 0)[1:]
        fall, least = b - a, np.maximum(la, lb)  # v = -log Z is larger nearer by
        steps = np.moveaxis(out, axis, 0)
        steps[:-1] += both & (fall < -least)
        steps[1:] -= both & (fall > least)
    return x, y


def _rising(a: Float64, low: float, high: float) -> Float64:
    t = np.clip((a - low) / (high - low), 0, 1)
    smooth: Float64 = t * t * (3 - 2 * t)
    return smooth


def _unit(a: Float64) -> Float64:
    unit: Float64 = a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-9)
    return unit


def normals_to_the_rim(N: npt.ArrayLike, Z: npt.ArrayLike, camera: Camera, *, Z_sigma: npt.ArrayLike) -> tuple[Float32, Float32]:
    """N (H, W, 3) with limbs turned away at their outlines, and (H, W) 0..1 how much of each is of that; as given elsewhere, bit for bit.

    N       : (H, W, 3) unit, scene frame, of plane fits; NaN where unknown.
    Z       : (H, W) metres; Z_sigma (H, W) its standard deviation, metres: steps that doubt explains are no outlines.
    Raises  : PassError for wrong shapes and types.
    """
    given = as_float32(N, "N", channels=3, size_hw=camera.size_hw)
    depth = checked_depth(Z, camera)
    sigma = as_float32(Z_sigma, "Z_sigma", size_hw=camera.size_hw)
    known = np.asarray(np.isfinite(depth) & np.isfinite(sigma))
    safe = np.where(known, depth, f4(1))
    v, doubt = -np.log(safe).astype(np.float32), np.where(known, sigma / safe, f4(0)).astype(np.float32)
    focal = float(camera.fx)
    out_x, out_y = _steps_out(v, doubt, known, focal)
    rim = (out_x != 0) | (out_y != 0)
    result, shares = given.copy(), np.zeros_like(v)
    if not rim.any():
        return result, shares
    distance, (rows, columns) = ndimage.distance_transform_edt(~rim, return_indices=True)
    y, x = np.nonzero((distance <= REACH_PX) & known & np.isfinite(given).all(axis=-1))
    by, bx = rows[y, x], columns[y, x]
    gx, gy = (ndimage.gaussian_filter(a, ALONG_PX)[by, bx].astype(np.float64) for a in (out_x, out_y))
    length = np.hypot(gx, gy)
    gx, gy = gx / np.maximum(length, 1e-6), gy / np.maximum(length, 1e-6)
    t = 0.5 - (x - bx) * gx - (y - by) * gy
    ok = (length > 1e-6) & (t >= 0.4) & (t < REACH_PX)

    def inside(pixels: float) -> tuple[Index, Index, Bool]:
        """The pixel so far inside the outline, and whether it is one."""
        u, w = np.rint(bx - gx * (pixels - 0.5)).astype(np.intp), np.rint(by - gy * (pixels - 0.5)).astype(np.intp)
        there = (u >= 0) & (u < v.shape[1]) & (w >= 0) & (w < v.shape[0])
        return np.clip(w, 0, v.shape[0] - 1), np.clip(u, 0, v.shape[1] - 1), there

    def alike(a: tuple[Index, Index], b: tuple[Index, Index], pixels: npt.ArrayLike, slope: float) -> Bool:
        """Whether two pixels so far apart are of one surface."""
        return np.asarray(np.abs(v[a] - v[b]) <= np.asarray(pixels) * slope / focal + EDGE_SIGMAS * doubt[by, bx])

    qy, qx, q_ok = inside(REACH_PX)
    ry, rx, r_ok = inside(DEEP_PX)
    ok &= q_ok & r_ok & known[qy, qx] & known[ry, rx] & (distance[qy, qx] >= 0.7 * REACH_PX)
    ok &= alike((y, x), (by, bx), distance[y, x] + 1, 2 * GENTLE) & alike((qy, qx), (by, bx), REACH_PX, 2 * GENTLE)
    ok &= alike((ry, rx), (qy, qx), DEEP_PX - REACH_PX, GENTLE)
    sure, deep = given[qy, qx].astype(np.float64), given[ry, rx].astype(np.float64)
    ok &= np.isfinite(sure).all(axis=-1) & np.isfinite(deep).all(axis=-1)
    y, x, gx, gy, t, sure, deep = (a[ok] for a in (y, x, gx, gy, t, sure, deep))
    if y.size == 0:
        return result, shares
    rays = ray_slopes(camera)[y, x].astype(np.float64)
    back = _unit(np.stack([-rays[:, 0], rays[:, 1], np.ones_like(t)], axis=-1))
    out = np.stack([gx, -gy, np.zeros_like(t)], axis=-1)
    out = _unit(out - (out * back).sum(axis=-1, keepdims=True) * back)
    s, s_deep = (sure * out).sum(axis=-1), (deep * out).sum(axis=-1)
    rise = (s - s_deep) / np.maximum(1 - s, 0.02) / (DEEP_PX / REACH_PX - 1)
    share = _rising(s, *FACING_OUT) * _rising(rise, *TURNING) * np.clip((1 - t / REACH_PX) / (1 - FULL), 0, 1)
    risen = np.clip(1 - t / REACH_PX * (1 - s), 0, 1)
    turned = risen[:, None] * out + np.sqrt(1 - risen * risen)[:, None] * _unit(sure - s[:, None] * out)
    here = share > 0
    y, x, share, turned = y[here], x[here], share[here], turned[here]
    result[y, x] = _unit((1 - share[:, None]) * given[y, x] + share[:, None] * turned)
    shares[y, x] = share
    return result, shares
