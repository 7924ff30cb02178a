"""The judge of the environment kernel: the paper's section 6 in plain float64 NumPy, axes put right.

In: P, N, albedo (H, W, 3) in the scene frame, lat-long maps.  Out: layers as `environment_layers` names them."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def unit(a: Array) -> Array:
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def look(latlong: Array, d: Array) -> Array:
    """Bilinear, going round in azimuth, and over the poles to the other side."""
    h, w = latlong.shape[:2]
    x, y, z = np.moveaxis(unit(d), -1, 0)
    u = (0.5 + np.arctan2(x, -z) / (2 * np.pi)) * w - 0.5
    v = np.arccos(np.clip(y, -1, 1)) / np.pi * h - 0.5
    u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
    p, q = (u - u0)[..., None], (v - v0)[..., None]

    def row(k: Array) -> Array:
        turn = np.where((k < 0) | (k >= h), w // 2, 0)
        k = np.clip(k, 0, h - 1)
        return latlong[k, (u0 + turn) % w] * (1 - p) + latlong[k, (u0 + 1 + turn) % w] * p

    return row(v0) * (1 - q) + row(v0 + 1) * q


def fresnel(c: Array, n: float) -> Array:
    """Snell and Fresnel as the textbooks print them."""
    inner = np.sqrt(np.maximum(1 - (1 - c**2) / n**2, 0))
    with np.errstate(invalid="ignore"):
        s = ((c - n * inner) / (c + n * inner)) ** 2
        p = ((n * c - inner) / (n * c + inner)) ** 2
    return np.where(1 - (1 - c**2) / n**2 < 0, 1.0, (s + p) / 2)


def ways(P: Array, N: Array, ior: float) -> tuple[Array, Array, Array, Array]:
    """Cosine of incidence (H, W, 1), ways of the mirrored and of the bent ray (H, W, 3), and the square of the bent one's cosine."""
    N, V = unit(N), unit(-P)
    towards = np.where((N * V).sum(-1, keepdims=True) < 0, -N, N)
    c = np.clip((towards * V).sum(-1, keepdims=True), 0, 1)
    inside2 = 1 - (1 - c**2) / ior**2
    return c, 2 * c * towards - V, (-V + c * towards) / ior - np.sqrt(np.maximum(inside2, 0)) * towards, inside2


def reference_layers(
    P: Array, N: Array, albedo: Array, *, soft: Array, sharp: Array, rough: Array, blend: float, ior: float, mixed: bool, M: Array
) -> dict[str, Array]:
    """M: map from camera.  Strengths 1, tints white."""
    c, R, T, inside2 = ways(P, N, ior)
    F = fresnel(c, ior) if mixed else np.ones_like(c)
    through = np.where(inside2 < 0, 0.0, 1 - F if mixed else 1.0)

    def seen(d: Array) -> Array:
        return look(sharp, d @ M.T) * (1 - blend) + look(rough, d @ M.T) * blend

    return {"env_diffuse": albedo * look(soft, unit(N) @ M.T), "env_reflection": F * seen(R), "env_refraction": through * seen(T)}
