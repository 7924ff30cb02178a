"""Lights with a size against sums over their surface, float64: diffuse to 1e-3, horizon and nearness included; highlights in energy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera
from stereorelight.errors import ShotError
from stereorelight.light.lights import Light, PointLight, RectLight, SphereLight, lights_from_dicts, to_dict
from stereorelight.light.shade import light_layers, relight_fused
from tests.test_light_exact import plane
from tests.test_light_layers import camera_of, rotation, scene, total

Array = np.ndarray
quick = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**31)


def lit(P: Array, N: Array, light: Light, part: str = "diffuse") -> Array:
    shape = (1, -1, 3)
    p, n = (np.ascontiguousarray(v.reshape(shape), np.float32) for v in (P, N))
    return light_layers(p, n, np.ones_like(p), [light])[f"light_a_{part}"][0, :, 0].astype(np.float64)


def around(seed: int, centre: Array, nearest: float, count: int = 12) -> tuple[Array, Array]:
    """Places at most 3 m from a light, in front of the camera, with normals of all kinds."""
    rng = np.random.default_rng(seed)
    way, N = rng.normal(size=(2, count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    P = centre + way * rng.uniform(nearest, 3, (count, 1))
    return P.astype(np.float32), (N / np.linalg.norm(N, axis=1, keepdims=True)).astype(np.float32)


def by_cone(P: Array, N: Array, centre: Array, radius: float, n: int = 1500) -> Array:
    """Irradiance / pi of a ball of radiance 1 / radius^2: the sum over the cone that it fills."""
    wanted = []
    cos_phi = np.cos((np.arange(n) + 0.5) / n * 2 * np.pi)
    for p, normal in zip(P.astype(float), N.astype(float)):
        to = centre - p
        d = np.linalg.norm(to)
        s2 = (radius / d) ** 2
        u = (np.arange(n) + 0.5) / n
        theta = np.arcsin(np.sqrt(s2)) * u
        c = to @ normal / d
        cosines = np.cos(theta)[:, None] * c + np.sin(theta)[:, None] * np.sqrt(max(0, 1 - c * c)) * cos_phi
        E = (np.maximum(cosines, 0) * np.sin(theta)[:, None]).sum() * np.arcsin(np.sqrt(s2)) / n * 2 * np.pi / n
        wanted.append(E / np.pi / radius**2)
    return np.array(wanted)


@pytest.mark.parametrize("radius", [0.02, 0.3, 0.9])
def test_diffuse_of_a_ball(radius: float) -> None:
    centre = np.array([0.3, 0.4, -4.0])
    P, N = around(3, centre, radius * 1.02)
    got = lit(P, N, SphereLight(name="a", position_m=tuple(centre), radius_m=radius))
    wanted = by_cone(P, N, centre, radius)
    np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-6 * wanted.max())


@pytest.mark.parametrize("radius", [0.002, 0.05, 0.5])
def test_a_ball_sets_behind_the_horizon(radius: float) -> None:
    """From wholly above to wholly below, where every term of the formula nearly cancels."""
    d = 1.0
    sines = np.linspace(-1.1, 1.1, 12) * radius
    N = np.stack([np.sqrt(1 - sines**2), np.zeros_like(sines), sines], axis=1)
    P = np.tile(np.array([0, 0, -2.0]), (12, 1))
    centre = np.array([0, 0, -2.0 + d])
    got = lit(P, N, SphereLight(name="a", position_m=tuple(centre), radius_m=radius))
    wanted = by_cone(P, N.astype(np.float32), centre, radius, 3000)
    np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-3 * wanted.max() * 0.2)
    assert got[0] == 0


def by_area(P: Array, N: Array, light: RectLight, n: int = 1200) -> Array:
    """Irradiance / pi by the sum over the rectangle's surface."""
    w, h = light.size_m
    u, v = light.sides
    s = (np.arange(n) + 0.5) / n - 0.5
    x, y = np.meshgrid(s * w, s * h)
    places = np.array(light.position_m) + x[..., None] * u + y[..., None] * v
    wanted = []
    for p, normal in zip(P.astype(float), N.astype(float)):
        to = places - p
        d2 = (to * to).sum(axis=-1)
        E = (np.maximum(to @ normal, 0) * np.maximum(-(to @ light.shines_to), 0) / d2**2).mean() * w * h
        wanted.append(E * np.pi / (w * h) / np.pi)
    return np.array(wanted)


@pytest.mark.parametrize("size", [(0.05, 0.02), (0.6, 0.6), (2.0, 0.1), (1.5, 2.5)])
def test_diffuse_of_a_rectangle(size: tuple[float, float]) -> None:
    light = RectLight(name="a", position_m=(0.2, 0.1, -4), size_m=size, direction=(0.3, -0.2, -1), roll_deg=30)
    P, N = around(5, np.array(light.position_m), 0.3, count=40)
    got, wanted = lit(P, N, light), by_area(P, N, light, 500)
    assert (wanted > 0).sum() > 5
    np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4 * wanted.max())


def test_an_endless_wall_of_light_and_the_back_of_one() -> None:
    P, N = np.array([[0, 0, -3.0], [0, 0, -3.0]]), np.array([[0, 0, 1.0], [1.0, 0, 0]])
    wall = RectLight(name="a", position_m=(0, 0, -2.9), size_m=(1000, 1000), direction=(0, 0, -1), intensity=1e6 / np.pi)
    np.testing.assert_allclose(lit(P, N, wall), [1, 0.5], rtol=1e-3)
    away = dataclasses.replace(wall, direction=(0, 0, 1), specular=1)
    assert (lit(P, N, away) == 0).all()
    assert (lit(P, N, away, "specular") == 0).all()


@pytest.mark.parametrize("model", ["phong", "ggx"])
@pytest.mark.parametrize("part", ["diffuse", "specular"])
def test_a_small_light_is_a_point(part: str, model: str) -> None:
    P = plane(n=21)
    N = np.broadcast_to([0, 0, 1.0], P.shape)
    settings_ = {"name": "a", "position_m": (0.2, 0.3, -1.0), "specular": 1.0, "exponent": 20, "model": model, "roughness": 0.6}
    want = lit(P, N, PointLight(**settings_), part)
    ball = lit(P, N, SphereLight(**settings_, radius_m=1e-4), part)
    np.testing.assert_allclose(ball, want, rtol=1e-3, atol=1e-3 * want.max())
    flat = lit(P, N, RectLight(**settings_, size_m=(1e-3, 1e-3), direction=(0, 0, -1)), part)
    to = np.array(settings_["position_m"]) - P.reshape(-1, 3)
    np.testing.assert_allclose(flat, want * to[:, 2] / np.linalg.norm(to, axis=1), rtol=2e-3, atol=1e-3 * want.max())


@pytest.mark.parametrize("radius", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("exponent", [5, 100])
def test_phongs_highlight_of_a_ball_on_its_axis(radius: float, exponent: int) -> None:
    """Seen along the mirrored axis: the sum of the lobe over the ball's disc, exactly."""
    light = SphereLight(name="a", position_m=(0, 0, 0), radius_m=radius, specular=1, exponent=exponent)
    got = lit(np.array([[0, 0, -1.5]]), np.array([[0, 0, 1.0]]), light, "specular")[0]
    n = 20000
    sigma = np.arcsin(radius / 1.5)
    theta = (np.arange(n) + 0.5) / n * sigma
    wanted = (np.cos(theta) ** exponent * np.sin(theta)).sum() * sigma / n * 2 / radius**2
    np.testing.assert_allclose(got, wanted, rtol=1e-3)


areas = st.one_of(
    st.builds(
        SphereLight,
        name=st.just("a"),
        position_m=st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-0.5, 2)),
        radius_m=st.floats(0.05, 0.4),
        specular=st.just(0.5),
        model=st.sampled_from(["phong", "ggx"]),
        rim=st.sampled_from([0.0, 0.5]),
    ),
    st.builds(
        RectLight,
        name=st.just("a"),
        position_m=st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-0.5, 2)),
        size_m=st.tuples(st.floats(0.1, 2), st.floats(0.1, 2)),
        direction=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-2, -0.5)),
        roll_deg=st.floats(-90, 90),
        specular=st.just(0.5),
        model=st.sampled_from(["phong", "ggx"]),
    ),
)


@quick
@given(seed=seeds, light=areas)
def test_a_larger_scene_and_a_turned_one_look_the_same(seed: int, light: Light) -> None:
    P, N, albedo = scene(seed)
    assert isinstance(light, (SphereLight, RectLight))
    x, y, z = light.position_m
    before = total(light_layers(P, N, albedo, [light]))
    assert np.isfinite(before).all()
    assert (before >= 0).all()
    size = {"radius_m": 2 * light.radius_m} if isinstance(light, SphereLight) else {"size_m": (2 * light.size_m[0], 2 * light.size_m[1])}
    larger = dataclasses.replace(light, position_m=(2 * x, 2 * y, 2 * z), intensity=4, **size)
    np.testing.assert_allclose(total(light_layers(2 * P, N, albedo, [larger])), before, atol=2e-5 * before.max() + 1e-30)
    R, pose = rotation(0.3, -0.5, 0.2), np.eye(4)
    pose[:3, :3] = R.T
    camera = Camera(size=(19, 7), K=np.array([[20.0, 0, 9], [0, 20, 3], [0, 0, 1]]), world_from_camera=pose)
    world = dataclasses.replace(light, space="world")
    turned = light_layers((P @ R.T).astype(np.float32), (N @ R.T).astype(np.float32), albedo, [world], camera=camera)
    np.testing.assert_allclose(total(turned), before, atol=3e-4 * before.max() + 1e-30)


BOTH = (
    SphereLight(name="ball", position_m=(0.5, 1, -1), radius_m=0.3, specular=0.5, model="ggx", rim=0.2),
    RectLight(name="sheet", position_m=(-1, 1, 0), size_m=(1, 0.4), aim_m=(0, 0, -3), specular=0.5),
)


def test_fused_equals_layers_and_missing_pixels_stay_alone() -> None:
    camera = camera_of(21, 70)
    _, N, plate = scene(9, 21, 70)
    Z = np.random.default_rng(1).uniform(1, 5, camera.size_hw).astype(np.float32)
    P = camera.ray_grid() * Z[..., None]
    P = np.dstack([P[..., 0], -P[..., 1], -Z]).astype(np.float32)
    layers = light_layers(P, N, plate, BOTH)
    beauty = relight_fused(plate, Z, N, camera, BOTH)
    np.testing.assert_allclose(beauty, plate + total(layers), rtol=1e-4, atol=5e-5)
    bad = P.copy()
    bad[3, 5], bad[10, 69, 1] = np.nan, np.inf
    for name, layer in light_layers(bad, N, plate, BOTH).items():
        assert (layer[3, 5] == 0).all()
        assert (layer[10, 69] == 0).all()
        same = np.isfinite(bad).all(axis=-1)
        assert np.array_equal(layer[same], layers[name][same])
    cut = light_layers(P[4:, 13:57], N[4:, 13:57], plate[4:, 13:57], BOTH)
    assert all(np.array_equal(layer[4:, 13:57], cut[name]) for name, layer in layers.items())


@pytest.mark.parametrize("z", [-1.5, -1.9, -2.0, -2.05, -3.0])
def test_a_light_round_a_surface_or_behind_it_is_finite(z: float) -> None:
    P, N = np.array([[0, 0, -2.0], [0.1, 0, -2.0]]), np.array([[0, 0, 1.0], [0, 0, 1.0]])
    for model in ("phong", "ggx"):
        ball = SphereLight(name="a", position_m=(0, 0, z), radius_m=0.2, specular=1, model=model)  # type: ignore[arg-type]
        sheet = RectLight(name="a", position_m=(0, 0, z), size_m=(0.5, 0.5), direction=(0, 0, -1), specular=1, model=model)  # type: ignore[arg-type]
        for light in (ball, sheet):
            for part in ("diffuse", "specular"):
                got = lit(P, N, light, part)
                assert np.isfinite(got).all()
                assert (got >= 0).all()
                assert z != -3 or (got == 0).all()
        assert (lit(P, N, ball) <= 1 / 0.04 * 1.0001).all()


def test_tables_and_refusals() -> None:
    assert lights_from_dicts([to_dict(light) for light in BOTH]) == BOTH
    ball = {"type": "sphere", "name": "a", "position_m": [0, 0, 0], "radius_m": 0.2}
    sheet = {"type": "rect", "name": "a", "position_m": [0, 0, 0], "size_m": [1, 1], "direction": [0, 0, -1]}
    for table, words in (
        ({**ball, "radius_m": 0}, "radius_m must be a number"),
        ({**ball, "wrap": 0.5}, "wrap belongs to lights without a size"),
        ({**ball, "attenuation": "none"}, "attenuation belongs to"),
        ({k: v for k, v in ball.items() if k != "radius_m"}, "radius_m is missing"),
        ({**sheet, "size_m": [1, -1]}, "size_m must be two numbers"),
        ({**sheet, "size_m": 1}, "size_m must be two numbers"),
        ({**sheet, "up": [0, 0, 0]}, "up must not be zero"),
        ({**sheet, "aim_m": [0, 0, -1]}, "aim_m or direction"),
    ):
        with pytest.raises(ShotError, match=words):
            lights_from_dicts([table])
