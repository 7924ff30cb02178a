"""Ambient occlusion and bent normals, from rays on the seen surface.

In: a `ShadowScene`.  Out: ao (H, W) 0..1, the share of the light from all around that arrives, and bent (H, W, 3), the unit mean
direction of what is open.
Frame: scene frame of the camera, metres.

Rays go out by the cosine, so that each counts for the same light.  What they meet blocks them the less the farther away it is, and not at
all beyond a radius.  What no camera saw blocks nothing.  The mean direction is reckoned from the blocked ones, for the mean of all of them
is known: a pixel that is all open has its normal exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.errors import ShotError
from stereorelight.surface.emitters import across, on_disc
from stereorelight.surface.visibility import MOST_SAMPLES, RAYS_AT_ONCE, ShadowScene, kinds, spread_pattern

MEAN = 2 / 3  # length of the mean direction of a hemisphere by the cosine


@dataclass(frozen=True, kw_only=True, eq=False)
class Occlusion:
    """ao : (H, W) float32, 0..1, 1 is open.   bent : (H, W, 3) float32, unit.  NaN where the surface is unknown."""

    ao: Float32
    bent: Float32


def ambient_occlusion(scene: ShadowScene, *, radius_m: float = 0.5, falloff: float = 1.0, samples: int = 16) -> Occlusion:
    """Ambient occlusion and bent normals.

    radius_m : what is farther away blocks nothing, > 0.
    falloff  : what is met at distance d still lets (d / radius_m)^falloff through; 0 blocks all of it.
    samples  : rays a pixel; 4 x 4 neighbours take different ones and are evened out together.
    Raises   : ShotError for a setting out of range.
    """
    if not (np.isfinite(radius_m) and radius_m > 0):
        raise ShotError(f"occlusion: radius_m must be greater than 0, got {radius_m:g}; it is how far away things still darken")
    if not 0 <= falloff <= 10:
        raise ShotError(f"occlusion: falloff must lie in 0 ... 10, got {falloff:g}")
    if not 1 <= samples <= MOST_SAMPLES:
        raise ShotError(f"occlusion: samples must lie in 1 ... {MOST_SAMPLES}, got {samples}")
    h, w = scene.Z.shape
    N, P = scene.N.reshape(-1, 3), scene.P.reshape(-1, 3)
    lift = scene.clear.reshape(-1)
    known = np.isfinite(P + N).all(axis=-1) & np.isfinite(lift)
    pixels = np.flatnonzero(known)
    disc = on_disc(spread_pattern(samples))
    up = np.sqrt(np.maximum(1 - (disc**2).sum(axis=-1), 0))
    kind = kinds((h, w)).reshape(-1)
    lost = np.zeros((h * w, 4), np.float32)  # the share that is blocked, and the sum of its directions
    for first in range(0, len(pixels), RAYS_AT_ONCE):
        at = pixels[first : first + RAYS_AT_ONCE]
        n = N[at].astype(np.float64)
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        u, v = across(n)
        starts = P[at] + n * lift[at, None]
        for sample in range(samples):
            d, z = disc[kind[at], sample], up[kind[at], sample]
            ways = d[:, :1] * u + d[:, 1:] * v + z[:, None] * n
            far = scene.first_hits(starts, ways, radius_m)
            blocked = np.where(far < radius_m, 1 - (np.maximum(far, 0) / radius_m) ** falloff if falloff > 0 else 1.0, 0.0)
            lost[at, 0] += blocked
            lost[at, 1:] += blocked[:, None] * ways
    lost /= samples
    even = np.moveaxis(scene.evened(lost.T.reshape(4, h, w)), 0, -1)
    there = known.reshape(h, w)
    ao = np.where(there, np.clip(1 - even[..., 0], 0, 1), np.float32(np.nan)).astype(np.float32)
    way = MEAN * scene.N - even[..., 1:]
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Where next to nothing is open there is no direction but N; between the two the lines run together.
        bent = np.where(length > 1e-3, way / length, scene.N)
    bent = np.where(there[..., None], bent, np.float32(np.nan))
    return Occlusion(ao=ao, bent=np.ascontiguousarray(bent, dtype=np.float32))
