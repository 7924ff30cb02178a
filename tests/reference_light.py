"""The judge of the fast kernel: the paper's section 5 in plain NumPy, equation by equation.

In: P, N, albedo (H, W, 3) in the scene frame, lights in camera space.  Out: layers as `light_layers` names them.
It works in the type of P: float64 to judge, float32 to be timed as a compositor would write it.  No masks for missing pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stereorelight.light.lights import DirectionalLight, Light, PointLight, SpotLight

Array = np.ndarray


def dot(a: Array, b: Array) -> Array:
    return (a * b).sum(axis=-1, keepdims=True)


def normalize(a: Array) -> Array:
    return a / np.sqrt(dot(a, a))


def light_vector(light: Light, P: Array) -> tuple[Array, Array]:
    """(L, d): unit vector towards the light and distance in metres."""
    if isinstance(light, DirectionalLight):
        if light.aim is not None:
            L = -np.array(light.aim)
        else:
            t, p = math.radians(light.azimuth_deg or 0), math.radians(light.elevation_deg or 0)
            Lx = math.sin(t) * math.cos(p)  # equation 7
            Ly = math.sin(p)  # equation 8
            Lz = math.cos(p) * math.cos(t)  # equation 9
            L = np.array([Lx, Ly, Lz])
        L = np.broadcast_to(normalize(L).astype(P.dtype), P.shape)
        return L, np.ones_like(P[..., :1])
    assert isinstance(light, PointLight)
    L = np.array(light.position_m, P.dtype) - P  # equations 6 and 10
    d = np.sqrt(dot(L, L))
    return L / d, d


def attenuation(light: Light, d: Array) -> Array:
    """By the length of L; the paper leaves the law open."""
    if not isinstance(light, PointLight) or light.attenuation == "none":
        return np.ones_like(d)
    if light.attenuation == "linear":
        return 1 / d
    if light.attenuation == "inverse_square":
        return 1 / d**2
    assert light.radius_m is not None
    return np.clip(1 - (d / light.radius_m) ** 4, 0, None) ** 2 / d**2


def cone(light: Light, L: Array) -> Array:
    """Full inside the cone angle, smooth over the cone delta angle (equation 10's text)."""
    if not isinstance(light, SpotLight):
        return np.ones_like(L[..., :1])
    axis = np.array(light.direction if light.direction is not None else np.array(light.aim_m) - light.position_m)
    off_axis = np.degrees(np.arccos(np.clip(dot(-L, normalize(axis).astype(L.dtype)), -1, 1)))
    t = np.clip((light.cone_deg / 2 + light.penumbra_deg - off_axis) / max(light.penumbra_deg, 1e-9), 0, 1)
    return t * t * (3 - 2 * t)


def reference_layers(P: Array, N: Array, albedo: Array, lights: Sequence[Light], mattes: dict[str, Array] | None = None) -> dict[str, Array]:
    layers = {}
    V = normalize(-P)
    for light in lights:
        L, d = light_vector(light, P)
        strength = attenuation(light, d) * cone(light, L) * (light.intensity * 2**light.exposure)
        if light.matte is not None:
            strength = strength * mattes[light.matte][..., None]
        colour = strength * np.array(light.color, P.dtype)
        NL = dot(N, L)
        lambert = np.maximum(0, (NL + light.wrap) / (1 + light.wrap))  # N . L, clamped
        layers[f"light_{light.name}_diffuse"] = albedo * lambert * light.diffuse * colour
        if light.specular > 0:
            R = 2 * NL * N - L
            lobe = np.maximum(0, dot(R, V)) ** light.exponent  # equation 11 with I towards the eye
            lobe = np.where(NL > 0, lobe, 0) * ((light.exponent + 2) / 2 if light.normalised else 1)
            layers[f"light_{light.name}_specular"] = lobe * light.specular * colour * np.array(light.specular_tint, P.dtype)
    return layers


def reference_relight(plate: Array, P: Array, N: Array, lights: Sequence[Light]) -> Array:
    beauty = plate.copy()
    for layer in reference_layers(P, N, plate, lights).values():
        beauty = beauty + layer
    return beauty
