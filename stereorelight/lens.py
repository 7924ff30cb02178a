"""Lens distortion on normalised coordinates (x/z, y/z), both ways, in plain NumPy.

In, out: (..., 2) float64.  NaN where the model cannot say: beyond the radius at which the distorted radius stops
growing (the fold), or beyond a pole of the rational model.  Models: OpenCV's brown and rational (Brown 1966 and the
rational radial term), and fisheye (Kannala and Brandt 2006)."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.errors import RigError, nearest_hint

COUNTS = {"brown": (0, 4, 5), "rational": (0, 8), "fisheye": (0, 4)}
NEWTON_STEPS = 30
CONVERGED = 1e-12  # normalised units, before the last step: straight points come back to 1e-9 also where the lens is flat
FARTHEST = 10.0  # radius up to which a brown or rational lens is searched for its fold: 84 degrees off axis
START_CONVERGED = 1e-3  # Newton in two dimensions goes on from here


def checked_parameters(model: str, distortion: Sequence[float]) -> tuple[float, ...]:
    """`distortion` as floats, after checking model and count.  Raises RigError."""
    if not isinstance(model, str) or model not in COUNTS:
        raise RigError(f"lens model {model!r} is unknown{nearest_hint(str(model), COUNTS)}")
    try:
        values = tuple(float(v) for v in np.ravel(distortion))
    except (TypeError, ValueError, OverflowError):
        raise RigError(f"distortion must be numbers, got {distortion!r}") from None
    if len(values) not in COUNTS[model]:
        wanted = " or ".join(str(n) for n in COUNTS[model])
        raise RigError(f"lens model {model!r} takes {wanted} parameters, got {len(values)}")
    if not all(math.isfinite(v) for v in values):
        raise RigError("distortion holds a value that is not finite")
    return values


def _coefficients(distortion: Sequence[float]) -> list[float]:
    return list(distortion) + [0.0] * (8 - len(distortion))


def _radial(r2: Float64, k: Sequence[float]) -> tuple[Float64, Float64]:
    """g(r^2) and dg/d(r^2) of the brown and rational models; k in OpenCV's order."""
    k1, k2, _, _, k3, k4, k5, k6 = k
    top = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    low = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    dtop = k1 + r2 * (2 * k2 + r2 * 3 * k3)
    dlow = k4 + r2 * (2 * k5 + r2 * 3 * k6)
    return top / low, (dtop * low - top * dlow) / (low * low)


@functools.lru_cache(maxsize=64)
def fold_radius(model: str, distortion: tuple[float, ...]) -> float:
    """Undistorted radius (tan of the angle off axis) up to which the model is one to one; inf where it always is."""
    if model == "fisheye":
        theta = np.linspace(0, math.pi / 2 - 1e-6, 4000)
        k1, k2, k3, k4 = distortion or (0.0,) * 4
        t2 = theta * theta
        grows = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4))) > 0
        return math.inf if grows.all() else float(math.tan(theta[max(int(np.argmin(grows)) - 1, 0)]))
    k = _coefficients(distortion)
    r = np.linspace(0, FARTHEST, 20001)
    r2 = r * r
    with np.errstate(all="ignore"):
        g, dg = _radial(r2, k)
        low = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        grows = (g + 2 * r2 * dg > 0) & (low > 0)
    return math.inf if grows.all() else float(r[max(int(np.argmin(grows)) - 1, 0)])


def distort(straight: Float64, model: str, distortion: tuple[float, ...]) -> Float64:
    """Where the lens puts the normalised point `straight` (..., 2)."""
    p = np.asarray(straight, dtype=np.float64)
    if model != "fisheye" and not any(distortion):
        return p.copy()
    x, y = p[..., 0], p[..., 1]
    r2 = x * x + y * y
    reach = fold_radius(model, distortion)
    if model == "fisheye":
        r = np.sqrt(r2)
        k1, k2, k3, k4 = distortion or (0.0,) * 4
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        factor = np.where(r > 1e-12, bent / np.maximum(r, 1e-12), 1.0)
        out = p * factor[..., None]
    else:
        k = _coefficients(distortion)
        with np.errstate(all="ignore"):
            g, _ = _radial(r2, k)
        p1, p2 = k[2], k[3]
        out = np.stack([x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=-1)
    out[r2 > reach * reach] = np.nan
    return out


def undistort(bent: Float64, model: str, distortion: tuple[float, ...]) -> Float64:
    """The normalised point (..., 2) that the lens puts at `bent`, by Newton's method, to 1e-9."""
    p = np.asarray(bent, dtype=np.float64)
    if model != "fisheye" and not any(distortion):
        return p.copy()
    if model == "fisheye":
        return _undistort_fisheye(p, distortion)
    k = _coefficients(distortion)
    p1, p2 = k[2], k[3]
    xd, yd = p[..., 0], p[..., 1]
    reach = fold_radius(model, distortion)
    start = _radial_start(np.hypot(xd, yd), k, min(reach, FARTHEST))
    x, y = xd * start, yd * start
    error = np.full(x.shape, np.inf)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            r2 = x * x + y * y
            g, dg = _radial(r2, k)
            ex = x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - xd
            ey = y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - yd
            error = np.abs(ex) + np.abs(ey)
            if not (error > CONVERGED).any():
                break
            a = g + 2 * x * x * dg + 2 * p1 * y + 6 * p2 * x
            b = 2 * x * y * dg + 2 * p1 * x + 2 * p2 * y
            d = g + 2 * y * y * dg + 6 * p1 * y + 2 * p2 * x
            det = a * d - b * b
            x = x - (d * ex - b * ey) / det
            y = y - (a * ey - b * ex) / det
        known = (error < 1e-7) & (x * x + y * y <= reach * reach)
    return np.where(known[..., None], np.stack([x, y], axis=-1), np.nan)


def _radial_start(bent: Float64, k: Sequence[float], reach: float) -> Float64:
    """Factor from the bent radius to the straight one, the tangential terms aside.

    Bracketed within the fold, or Newton can land on the far branch, and beside a pole on none."""
    low, high = np.zeros_like(bent), np.full_like(bent, reach)
    r = np.minimum(bent, 0.9 * reach)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            g, dg = _radial(r * r, k)
            f = r * g - bent
            if not (np.abs(f) > START_CONVERGED).any():
                break
            low, high = np.where(f <= 0, r, low), np.where(f >= 0, r, high)
            step = r - f / (g + 2 * r * r * dg)
            r = np.where((step >= low) & (step <= high), step, (low + high) / 2)
    factor: Float64 = r / np.maximum(bent, 1e-12)
    return factor


def _undistort_fisheye(p: Float64, distortion: tuple[float, ...]) -> Float64:
    k1, k2, k3, k4 = distortion or (0.0,) * 4
    bent = np.sqrt((p * p).sum(axis=-1))
    reach = min(math.atan(fold_radius("fisheye", distortion)), math.pi / 2 - 1e-6)
    # The angle is bracketed: coefficients of both signs send plain Newton steps out of the model's reach.
    low, high = np.zeros_like(bent), np.full_like(bent, reach)
    theta = np.minimum(bent, 0.9 * reach)
    f = np.full_like(bent, np.inf)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            t2 = theta * theta
            f = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) - bent
            df = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
            if not (np.abs(f) > CONVERGED).any():
                break
            low, high = np.where(f <= 0, theta, low), np.where(f >= 0, theta, high)
            step = theta - f / df
            theta = np.where((step >= low) & (step <= high), step, (low + high) / 2)
        known = np.abs(f) < 1e-7
        factor = np.where(bent > 1e-12, np.tan(theta) / np.maximum(bent, 1e-12), 1.0)
    return np.where(known[..., None], p * factor[..., None], np.nan)
