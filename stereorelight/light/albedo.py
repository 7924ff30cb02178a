"""The plate without its own light: albedo by division, within stated limits; and the plate's exposure.

In: the plate, a `PlateLighting`, N, P, the lamp's shadow, how far N may be off.  Out: albedo (H, W, 3), linear.
Where the light is dim or its normal unsure, a division says little: there brightness leans on what its surroundings turned out to
be, and colour stays the plate's own."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.errors import ShotError
from stereorelight.light.plate_lighting import PlateLighting

MOST_GAIN = 8.0
LEAST_SIGMA_DEG = 2.0  # of any normal: the model of the light is no better
MODEL_ERROR = 0.05  # of `level`: bounce and what else no model holds
SPREAD = 0.35  # how far albedo may be expected to lie from that of its surroundings, of its logarithm
SURROUNDINGS = 0.02  # of the frame's width
SHADOW_EDGE_PX = 1.5  # a shadow's edge is known to within so much


def _even(a: Float64, sigma: float) -> Float64:
    found: Float64 = ndimage.gaussian_filter(a, sigma, mode="nearest", truncate=3.0)
    return found


def albedo_of(
    plate: npt.ArrayLike,
    light: PlateLighting,
    N: npt.ArrayLike,
    P: npt.ArrayLike | None = None,
    *,
    visible: npt.ArrayLike | None = None,
    N_sigma: npt.ArrayLike | None = None,
    confidence: npt.ArrayLike | None = None,
    most_gain: float = MOST_GAIN,
) -> Float32:
    """(H, W, 3): what is left of `plate` when `light` is divided out; `plate / light.level` where nothing was told.

    N, P       : (H, W, 3), unit and metres; where N is NaN the light of the surroundings counts.
    visible    : (H, W), share of the lamp that arrives; None: all of it.
    N_sigma    : (H, W) degrees, standard deviation of N; None or NaN: 2.   confidence : (H, W), 0..1; where it is low, surroundings count.
    most_gain  : >= 1; a surface is made at most so many times brighter than `plate / level` is.
    Returns    : not clipped above 1; NaN of the plate stays in its own pixel.
    Raises     : PassError for arrays that do not fit, ShotError for the gain.
    """
    if not 1 <= most_gain <= 1000:
        raise ShotError(f"albedo_gain must be a number, 1 ... 1000, got {most_gain!r}")
    picture = as_float32(plate, "plate", channels=3)
    size_hw = (picture.shape[0], picture.shape[1])
    n = as_float32(N, "N", channels=3, size_hw=size_hw).astype(np.float64)
    if not light.told:
        return (picture / np.float32(light.level)).astype(np.float32)
    p = None if P is None else as_float32(P, "P", channels=3, size_hw=size_hw).astype(np.float64)
    known: Bool = np.asarray(np.isfinite(n if p is None else n + p).all(axis=-1), np.bool_)
    given = np.ones(size_hw, np.float32) if visible is None else as_float32(visible, "visible", size_hw=size_hw)
    arrives: Float64 = np.nan_to_num(given.astype(np.float64), nan=1.0)
    soft = _even(np.asarray(arrives), SHADOW_EDGE_PX)
    near = SURROUNDINGS * size_hw[1]
    n0 = np.where(known[..., None], n, (0.0, 0.0, 1.0))
    p0 = None if p is None else np.where(known[..., None], p, light.centre_m)
    E = light.irradiance(n0, p0, soft).astype(np.float64)
    if not known.all():
        share = _even(known.astype(np.float64), near) + 1e-9
        around = np.stack([_even(np.where(known, E[..., c], 0.0), near) / share for c in range(3)], axis=-1)
        E = np.where(known[..., None], E, np.where(share[..., None] > 1e-3, around, light.level))
    E = np.maximum(E, light.level / most_gain)
    raw = picture / E
    grey_E, grey = E.mean(axis=-1), np.nan_to_num(picture.mean(axis=-1).astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    # How far E may be off: by its normal, by where the shadow ends, by what the model leaves out.
    sigma_deg = np.full(size_hw, LEAST_SIGMA_DEG)
    if N_sigma is not None:
        told = as_float32(N_sigma, "N_sigma", size_hw=size_hw).astype(np.float64)
        sigma_deg = np.maximum(np.where(np.isfinite(told), told, 45.0), LEAST_SIGMA_DEG)
    lamp = float(light.lamp.mean())
    full = light.irradiance(n0, p0).astype(np.float64).mean(axis=-1)
    bare = light.irradiance(n0, p0, np.zeros(size_hw)).astype(np.float64).mean(axis=-1)
    across = np.sqrt(np.maximum(1 - ((full - bare) / max(lamp, 1e-9)) ** 2, 0.04))  # how fast the cosine changes with the angle
    spread = np.maximum(lamp, light.level / 2) * across * np.radians(sigma_deg)
    wide = _even(arrives, 3 * SHADOW_EDGE_PX)
    unsure = (full - bare) * np.sqrt(np.maximum(wide * (1 - wide), 0))
    off = np.sqrt(spread**2 + unsure**2 + (MODEL_ERROR * light.level) ** 2) / grey_E
    weight = 1 / (1 + (off / SPREAD) ** 2)
    if confidence is not None:
        weight = weight * np.clip(np.nan_to_num(as_float32(confidence, "confidence", size_hw=size_hw), nan=0.0), 0, 1)
    weight = np.where(known, weight, 0.0)
    bright = grey > 1e-6 * light.level
    logs = np.log(np.where(bright, grey, 1.0) / grey_E)
    held = weight**2 * bright
    share = _even(held, near)
    middle = float(np.average(logs[held > 0], weights=held[held > 0])) if (held > 0).any() else 0.0
    expected = (_even(held * logs, near) + 1e-4 * middle) / (share + 1e-4)
    lean = np.exp(np.where(bright, (1 - weight) * (expected - logs), 0.0))
    most = picture * (most_gain / light.level)  # no leaning beyond the stated gain either
    leaned = raw * lean[..., None]
    found: Float32 = np.where((picture > 0) & (leaned > most), most, leaned).astype(np.float32)
    return found


def exposure_of(plate: npt.ArrayLike, albedo: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> float:
    """What a white surface reads where the plate is brightly lit: the strength that a new light needs to sit in the plate's own range.

    The 90th percentile of grey plate over grey albedo, where `weight` (H, W) is above a half of its largest; exactly 1 where albedo is the plate.
    Raises : ShotError where no pixel says anything.
    """
    picture, colour = as_float32(plate, "plate", channels=3), as_float32(albedo, "albedo", channels=3)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = picture.mean(axis=-1, dtype=np.float64) / colour.mean(axis=-1, dtype=np.float64)
    good = np.isfinite(ratio) & (ratio > 0) & (np.nan_to_num(colour.mean(axis=-1)) > 1e-4)
    if weight is not None:
        held = np.nan_to_num(as_float32(weight, "weight", size_hw=(picture.shape[0], picture.shape[1])), nan=0.0)
        good &= held > 0.5 * float(held.max())
    if not good.any():
        raise ShotError("match_exposure: no pixel has both a plate and an albedo above 0")
    found = float(np.percentile(ratio[good], 90))
    return found if math.isfinite(found) else 1.0
