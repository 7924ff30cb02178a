"""Light layers against closed formulas: a card, a plane, a sphere and a box under every kind of light."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stereorelight.light.lights import DirectionalLight, PointLight, SpotLight
from stereorelight.light.shade import light_layers

EXACT = 1e-3  # relative, what the project promises; float32 gives 1e-6 and the tests below ask for it where it matters
FLOAT = 5e-6
Array = np.ndarray


def layer(P: Array, N: Array, light: object, part: str = "diffuse", albedo: float = 1.0) -> Array:
    P = np.asarray(P, np.float32)
    layers = light_layers(P, np.broadcast_to(np.asarray(N, np.float32), P.shape), np.full(P.shape, albedo, np.float32), [light])  # type: ignore[list-item]
    return layers[f"light_a_{part}"].astype(np.float64)


def plane(distance: float = 3.0, half: float = 2.0, n: int = 65) -> Array:
    """A card at z = -distance that faces the camera, x to the right, y up."""
    x, y = np.meshgrid(np.linspace(-half, half, n), np.linspace(half, -half, n))
    return np.stack([x, y, np.full_like(x, -distance)], axis=-1)


def sphere(n: int = 97, radius: float = 0.5, distance: float = 4.0) -> tuple[Array, Array]:
    """The visible side of a ball on the axis, along the rays of a pinhole, float64; NaN beside it."""
    reach = radius / math.sqrt(distance**2 - radius**2)
    x, y = np.meshgrid(np.linspace(-reach, reach, n), np.linspace(reach, -reach, n))
    ray = np.stack([x, y, -np.ones_like(x)], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    centre = np.array([0, 0, -distance])
    b = ray @ centre
    root = b * b - (distance**2 - radius**2)
    with np.errstate(invalid="ignore"):
        t = b - np.sqrt(root)
    P = t[..., None] * ray
    return P, (P - centre) / radius


@pytest.mark.parametrize("part", ["diffuse", "specular"])
@pytest.mark.parametrize(
    "light",
    [
        PointLight(name="a", position_m=(0, 0, 0), specular=1),
        SpotLight(name="a", position_m=(0, 0, 0), aim_m=(0, 0, -1), specular=1),
        DirectionalLight(name="a", specular=1),
        PointLight(name="a", position_m=(0, 0, 0), wrap=1, specular=1, exposure=3, intensity=0.125),
        *(PointLight(name="a", position_m=(0, 0, 0), attenuation=law, specular=1) for law in ("linear", "none")),
    ],
)
def test_a_card_at_one_metre_reads_exactly_one(light: object, part: str) -> None:
    card = np.full((5, 37, 3), (0.0, 0.0, -1.0))
    assert (layer(card, (0, 0, 1), light, part) == 1.0).all()


def test_a_radius_keeps_one_at_one_metre_but_for_its_window() -> None:
    card = np.full((1, 1, 3), (0.0, 0.0, -1.0))
    light = PointLight(name="a", position_m=(0, 0, 0), attenuation="radius", radius_m=2)
    np.testing.assert_allclose(layer(card, (0, 0, 1), light), (1 - 1 / 16) ** 2, rtol=FLOAT)


@pytest.mark.parametrize(("law", "power"), [("inverse_square", 2), ("linear", 1), ("none", 0)])
def test_point_light_over_a_plane(law: str, power: int) -> None:
    P, h = plane(), 0.7
    r2 = P[..., 0] ** 2 + P[..., 1] ** 2 + h * h
    wanted = h / np.sqrt(r2) / np.sqrt(r2) ** power
    light = PointLight(name="a", position_m=(0, 0, -3 + h), attenuation=law)  # type: ignore[arg-type]
    np.testing.assert_allclose(layer(P, (0, 0, 1), light)[..., 1], wanted, rtol=FLOAT)


def test_radius_ends_the_light_exactly() -> None:
    P = plane()
    light = PointLight(name="a", position_m=(0, 0, -2.5), attenuation="radius", radius_m=1.0)
    d = np.linalg.norm(P - light.position_m, axis=-1)
    got = layer(P, (0, 0, 1), light)[..., 0]
    assert (got[d > 1.0001] == 0).all()
    wanted = np.clip(1 - d**4, 0, None) ** 2 * 0.5 / d**3
    np.testing.assert_allclose(got, wanted, atol=FLOAT * wanted.max())
    assert got[d < 0.99].min() > 0


def test_spot_on_a_plane() -> None:
    h = 2.0
    P = plane(half=1.2, n=241)
    light = SpotLight(name="a", position_m=(0, 0, -3 + h), aim_m=(0, 0, -3), cone_deg=30, penumbra_deg=10, attenuation="none")
    off_axis = np.degrees(np.arctan2(np.hypot(P[..., 0], P[..., 1]), h))
    got = layer(P, (0, 0, 1), light)[..., 2] / np.cos(np.radians(off_axis))
    np.testing.assert_allclose(got[off_axis <= 15], 1, rtol=FLOAT)
    assert (got[off_axis > 25.001] == 0).all()
    t = np.clip((25 - off_axis) / 10, 0, 1)
    np.testing.assert_allclose(got, t * t * (3 - 2 * t), atol=FLOAT)


@pytest.mark.parametrize("cone_deg", [0.5, 3.0, 90.0, 178.0])
def test_a_hard_spot_is_a_step(cone_deg: float) -> None:
    angles = np.radians(cone_deg / 2 + np.array([-0.05, -0.01, 0.01, 0.05]))
    P = np.stack([np.sin(angles), np.zeros(4), -np.cos(angles)], axis=-1)[None] * 2.0
    light = SpotLight(name="a", position_m=(0, 0, 0), direction=(0, 0, -1), cone_deg=cone_deg, penumbra_deg=0, attenuation="none", wrap=1)
    got = layer(P, (0, 0, 1), light)[0, :, 0]
    assert (got[:2] > 0.4).all()
    assert (got[2:] == 0).all()


@pytest.mark.parametrize("aim", [(0, 0, -1), (1, -2, -1), (-0.5, 0.2, 0.3)])
def test_sphere_under_a_directional_light(aim: tuple[float, float, float]) -> None:
    P, N = sphere()
    wanted = np.clip(-(N @ (np.array(aim) / np.linalg.norm(aim))), 0, None)
    got = layer(P, N, DirectionalLight(name="a", aim=aim), albedo=0.5)[..., 0]
    on = np.isfinite(P[..., 0])
    np.testing.assert_allclose(got[on], 0.5 * wanted[on], atol=FLOAT)
    assert (got[~on] == 0).all()


@pytest.mark.parametrize("exponent", [1, 8, 200, 5000])
def test_highlight_of_a_light_at_the_eye(exponent: float) -> None:
    """With the light at the eye, R.V = cos(2 alpha) where alpha is the angle between normal and view."""
    P, N = sphere()
    cos = -np.einsum("hwc,hwc->hw", N, P) / np.linalg.norm(P, axis=-1)
    wanted = np.clip(2 * cos * cos - 1, 0, None) ** exponent
    light = PointLight(name="a", position_m=(0, 0, 0), attenuation="none", diffuse=0, specular=0.8, exponent=exponent, specular_tint=(1, 0.5, 0))
    got = layer(P, N, light, "specular")
    on = np.isfinite(P[..., 0])
    np.testing.assert_allclose(got[on, 0], 0.8 * wanted[on], atol=5e-5)
    np.testing.assert_allclose(got[on, 1], 0.4 * wanted[on], atol=5e-5)
    assert (got[..., 2] == 0).all()
    assert (layer(P, N, light) == 0).all()


@pytest.mark.parametrize("exponent", [1, 10, 300])
def test_normalised_phong_sends_back_what_a_white_card_does(exponent: float) -> None:
    """The eye goes round the hemisphere over a patch lit head on; what leaves it, against the white card's pi."""
    polar = (np.arange(2000) + 0.5) / 2000 * np.pi / 2
    view = np.stack([np.sin(polar), np.zeros_like(polar), np.cos(polar)], axis=-1)
    light = DirectionalLight(name="a", aim=(0, 0, -1), specular=1, exponent=exponent, normalised=True)
    radiance = layer(-view[None], (0, 0, 1), light, "specular")[0, :, 0]
    energy = (radiance * np.cos(polar) * 2 * np.pi * np.sin(polar)).sum() * (np.pi / 2 / 2000)
    np.testing.assert_allclose(energy, np.pi, rtol=EXACT)


@pytest.mark.parametrize(("azimuth", "elevation"), [(30, 0), (-50, 35), (170, 10)])
def test_box_under_the_papers_angles(azimuth: float, elevation: float) -> None:
    """Three faces of a box: each one flat value, the component of L along it."""
    faces = np.array([[(1, 0, 0), (0, 1, 0), (0, 0, 1)]], dtype=np.float64)
    P = np.array([[(0.5, 0, -3), (0, 0.5, -3), (0, 0, -2.5)]])
    t, p = math.radians(azimuth), math.radians(elevation)
    L = np.array([math.sin(t) * math.cos(p), math.sin(p), math.cos(p) * math.cos(t)])
    got = layer(P, faces, DirectionalLight(name="a", azimuth_deg=azimuth, elevation_deg=elevation))[0, :, 0]
    np.testing.assert_allclose(got, np.clip(L, 0, None), atol=1e-6)


def test_wrap_reaches_round_the_sphere() -> None:
    P, N = sphere()
    on = np.isfinite(P[..., 0])
    got = layer(P, N, DirectionalLight(name="a", aim=(-1, 0, 0), wrap=0.5))[..., 0]
    np.testing.assert_allclose(got[on], np.clip((N[on][:, 0] + 0.5) / 1.5, 0, None), atol=FLOAT)
    assert got[on & (N[..., 0] < -0.1)].max() > 0.1
