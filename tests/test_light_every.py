"""Ball, wall and box under every kind of light and on every material, against what is worked out by hand in float64.

Geometry in closed form; lights with a size by summing over what shines; GGX by its formula and its own compensation.  Phong's highlights
of lights with a size are held in test_light_highlights.py; those of GGX are an approximation (docs/limits.md), held where they grow small."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SphereLight, SpotLight
from stereorelight.light.shade import light_layers
from stereorelight.synth.scene import rotation
from tests.test_light_area import by_area, by_cone
from tests.test_light_materials import reference_ggx

ANALYTIC = 1e-3
CAMERA = Camera.from_fov(50, (36, 24))
Array = np.ndarray


def rays() -> Array:
    return (CAMERA.rays(CAMERA.pixel_grid().reshape(-1, 2)) * (1, -1, -1)).reshape(*CAMERA.size_hw, 3)


def ball() -> tuple[Array, Array]:
    d, centre = rays(), np.array([0.1, 0.0, -1.6])
    a, b = (d**2).sum(axis=-1), d @ centre
    inside = b * b - a * (centre @ centre - 0.45**2)
    t = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, np.nan)
    P = t[..., None] * d
    return P, (P - centre) / 0.45


def wall() -> tuple[Array, Array]:
    d, n = rays(), rotation(x_deg=-15, y_deg=30)[:, 2]
    P = (np.array([0, 0, -1.6]) @ n / (d @ n))[..., None] * d
    return P, np.broadcast_to(n, P.shape)


def box() -> tuple[Array, Array]:
    R, centre, half = rotation(x_deg=20, y_deg=35), np.array([0, 0, -1.7]), np.array([0.4, 0.3, 0.35])
    d, o = rays() @ R, -centre @ R
    with np.errstate(divide="ignore"):
        near, far = (-np.sign(d) * half - o) / d, (np.sign(d) * half - o) / d
    t, axis = near.max(axis=-1), near.argmax(axis=-1)
    hit = t < far.min(axis=-1)
    N = -np.sign(np.take_along_axis(d, axis[..., None], axis=-1)) * np.eye(3)[axis]
    return np.where(hit, t, np.nan)[..., None] * rays(), np.where(hit[..., None], N @ R.T, np.nan)


SHAPES = {"ball": ball, "wall": wall, "box": box}
LIGHTS: dict[str, Light] = {
    "point": PointLight(name="a", position_m=(0.7, 0.6, -0.5), intensity=2, color=(1, 0.5, 0.25)),
    "directional": DirectionalLight(name="a", azimuth_deg=35, elevation_deg=25, intensity=0.8),
    "spot": SpotLight(name="a", position_m=(0.7, 0.6, -0.5), aim_m=(0, 0, -1.5), cone_deg=20, penumbra_deg=15, exposure=1),
    "sphere": SphereLight(name="a", position_m=(0.7, 0.6, -0.5), radius_m=0.25),
    "rect": RectLight(name="a", position_m=(0.7, 0.6, -0.5), aim_m=(0, 0, -1.6), size_m=(0.5, 0.3), roll_deg=20),
}


def arriving(light: Light, P: Array) -> tuple[Array, Array]:
    """Unit vectors to a light without size, and what a white card that faces it reads."""
    strength = light.strength
    if isinstance(light, DirectionalLight):
        return np.broadcast_to(-light.shines_to, P.shape), np.full(P.shape[:-1], strength)
    assert isinstance(light, PointLight)
    L = np.array(light.position_m) - P
    d = np.linalg.norm(L, axis=-1)
    L, E = L / d[..., None], strength / d**2
    if isinstance(light, SpotLight):
        off = np.degrees(np.arccos(np.clip(-(L @ light.shines_to), -1, 1)))
        t = np.clip((light.cone_deg / 2 + light.penumbra_deg - off) / light.penumbra_deg, 0, 1)
        E = E * t * t * (3 - 2 * t)
    return L, E


def diffuse(light: Light, P: Array, N: Array) -> Array:
    """What a white card along N reads."""
    if isinstance(light, SphereLight):
        return light.strength * by_cone(P, N, np.array(light.position_m), light.radius_m, 500)
    if isinstance(light, RectLight):
        return light.strength * by_area(P, N, light, 80)
    L, E = arriving(light, P)
    found: Array = np.maximum((N * L).sum(axis=-1), 0) * E
    return found


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("shape", SHAPES)
def test_diffuse(shape: str, kind: str) -> None:
    P, N = SHAPES[shape]()
    light = LIGHTS[kind]
    albedo = np.random.default_rng(1).uniform(0.1, 1, P.shape).astype(np.float32)
    got = light_layers(P.astype(np.float32), N.astype(np.float32), albedo, [light])["light_a_diffuse"]
    known = np.isfinite(P).all(axis=-1)
    assert known.mean() > 0.2
    wanted = albedo[known] * np.array(light.color) * diffuse(light, P[known], N[known])[:, None]
    np.testing.assert_allclose(got[known], wanted, rtol=ANALYTIC, atol=1e-5 * wanted.max())
    assert (wanted > 0.01 * wanted.max()).mean() > 0.1
    assert (got[~known] == 0).all()


@pytest.mark.parametrize("model", ["phong", "ggx", "lambert"])
@pytest.mark.parametrize("kind", ["point", "directional", "spot"])
@pytest.mark.parametrize("shape", SHAPES)
def test_specular(shape: str, kind: str, model: str) -> None:
    P, N = SHAPES[shape]()
    light = dataclasses.replace(LIGHTS[kind], model=model, specular=0.7, exponent=4.0, roughness=0.45, f0=0.2 if model == "ggx" else None)
    layers = light_layers(P.astype(np.float32), N.astype(np.float32), np.ones(P.shape, np.float32), [light])
    if model == "lambert":
        assert list(layers) == ["light_a_diffuse"]
        return
    known = np.isfinite(P).all(axis=-1)
    P, N, got = P[known], N[known], layers["light_a_specular"][known]
    L, E = arriving(light, P)
    if model == "phong":
        V = -P / np.linalg.norm(P, axis=-1, keepdims=True)
        nl = (N * L).sum(axis=-1)
        lobe = np.where(nl > 0, np.maximum(((2 * nl[:, None] * N - L) * V).sum(axis=-1), 0) ** 4, 0)
    else:
        # The formula wants a place and divides by its distance: one metre along L from every point.
        lobe = np.concatenate(
            [
                reference_ggx(p[None], n[None], PointLight(name="x", position_m=tuple(p + way)), 0.45**2, lambda c: 0.2 + 0.8 * (1 - c) ** 5, 0.2)
                for p, n, way in zip(P, N, L)
            ]
        )
    wanted = 0.7 * (lobe * E)[:, None] * np.array(light.color)
    seen = -(P * N).sum(axis=-1) / np.linalg.norm(P, axis=-1) > 0.05
    np.testing.assert_allclose(got[seen], wanted[seen], rtol=ANALYTIC, atol=1e-4 * wanted.max())
    assert wanted.max() > 1e-3
