"""GGX against its own formula and in a white furnace, rims, materials by matte, kelvin, solo and groups."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from stereorelight import comp
from stereorelight.errors import PassError, ShotError
from stereorelight.light.kelvin import LUMINANCE, kelvin_color
from stereorelight.light.lights import DirectionalLight, Light, PointLight, SphereLight, lights_from_dicts, to_dict
from stereorelight.light.materials import Material, glow_table, materials_from_dicts
from stereorelight.light.shade import group_layers, light_layers, relight_fused
from stereorelight.surface.position import position_from_depth
from tests.test_light_layers import camera_of, scene, total

Array = np.ndarray
H, W = 7, 19


def reference_ggx(P: Array, N: Array, light: PointLight, alpha: float, fresnel: object, f0: float) -> Array:
    """pi f N.L / d^2 in float64 (Walter et al. 2007, Heitz 2014), times the toolkit's own compensation."""
    V = -P / np.linalg.norm(P, axis=-1, keepdims=True)
    L = np.array(light.position_m) - P
    d = np.linalg.norm(L, axis=-1, keepdims=True)
    L = L / d
    Hv = (L + V) / np.linalg.norm(L + V, axis=-1, keepdims=True)
    nl, nv, nh, vh = ((a * b).sum(axis=-1) for a, b in ((N, L), (N, V), (N, Hv), (V, Hv)))
    D = alpha**2 / (np.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
    G1l, G1v = (np.sqrt(c * c * (1 - alpha**2) + alpha**2) for c in (nl, nv))
    vis = 0.5 / (nl * G1v + nv * G1l)
    table = np.array(glow_table(alpha, 2049))
    glow = np.interp(np.sqrt(nv), np.linspace(0, 1, 2049), table) if f0 else 0
    lobe = np.pi * D * vis * fresnel(vh) * np.maximum(nl, 0) * (1 + f0 * glow)  # type: ignore[operator]
    return np.where(nl > 0, lobe / d[..., 0] ** 2, 0)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("how", ["f0", "ior"])
def test_ggx_is_its_formula(roughness: float, how: str) -> None:
    P, N, albedo = scene(1)
    light = PointLight(name="a", position_m=(0.5, 1, 0), specular=1, model="ggx", roughness=roughness, **{how: 0.3 if how == "f0" else 1.5})  # type: ignore[arg-type]
    got = light_layers(P, N, albedo, [light])["light_a_specular"][..., 0]

    def schlick(c: Array) -> Array:
        return 0.3 + 0.7 * (1 - c) ** 5

    def exact(c: Array) -> Array:
        ct = np.sqrt(1 - (1 - c * c) / 1.5**2)
        return (((c - 1.5 * ct) / (c + 1.5 * ct)) ** 2 + ((1.5 * c - ct) / (1.5 * c + ct)) ** 2) / 2

    f0 = 0.3 if how == "f0" else 0.04
    wanted = reference_ggx(P.astype(float), N.astype(float), light, roughness**2, schlick if how == "f0" else exact, f0)
    seen = -(P * N).sum(axis=-1) / np.linalg.norm(P, axis=-1) > 0.02  # beyond, the table of the compensation is coarse
    np.testing.assert_allclose(got[seen], wanted[seen], rtol=1e-3, atol=1e-4 * wanted.max())


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("view_deg", [0, 45, 75, 85])
def test_white_furnace(roughness: float, view_deg: float) -> None:
    """Light of 1 from every side on a surface that absorbs nothing: 1 comes back, within 1 %.

    Directions round the mirrored view by the lobe's own width, so that the sum is sharp where the lobe is."""
    view = np.radians(view_deg)
    V = np.array([np.sin(view), 0, np.cos(view)])
    alpha = max(roughness**2, 0.002)
    n, m = 300, 200
    # Half vectors by D cos, then mirrored: dw_L = 4 V.H dw_H.
    u = (np.arange(n) + 0.5) / n
    phi = (np.arange(m) + 0.5) / m * 2 * np.pi
    theta = np.arctan(alpha * np.sqrt(u / (1 - u)))
    weight = 1 / (alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2) * np.cos(theta)) / (n * m)
    Hs = np.stack(
        [np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi), np.broadcast_to(np.cos(theta)[:, None], (n, m))], axis=-1
    )
    vh = Hs @ V
    Ls = 2 * vh[..., None] * Hs - V
    used = (vh > 0) & (Ls[..., 2] > 0)
    # Every L becomes +z by a rotation of its own; the light is then one directional light for a whole picture of N and V.
    L = Ls[used]
    axis = np.array([0, 0, 1.0])
    half = L + axis
    half /= np.linalg.norm(half, axis=1, keepdims=True)

    def turned(v: Array) -> Array:
        return 2 * (half @ v)[:, None] * half - v

    P = -turned(V)[None].astype(np.float32)
    N = turned(axis)[None].astype(np.float32)
    light = DirectionalLight(name="a", aim=(0, 0, -1), diffuse=0, specular=1, model="ggx", roughness=roughness, f0=1)
    radiance = light_layers(P, N, np.ones_like(P), [light])["light_a_specular"][0, :, 0] / np.pi
    assert float((radiance * (4 * vh * weight[:, None])[used]).sum()) == pytest.approx(1, abs=0.01)


def test_a_rim_is_its_formula_and_part_of_the_specular_layer() -> None:
    P, N, albedo = scene(2)
    light = PointLight(name="a", position_m=(0.5, 1, 0), rim=0.7, rim_power=2.5, rim_color=(1, 0.5, 0))
    layers = light_layers(P, N, albedo, [light])
    nv = -(P * N).sum(axis=-1) / np.linalg.norm(P, axis=-1)
    wanted = layers["light_a_diffuse"] / albedo * 0.7 * np.array((1, 0.5, 0)) * ((1 - np.clip(nv, 0, 1)) ** 2.5)[..., None]
    np.testing.assert_allclose(layers["light_a_specular"], wanted, atol=2e-5 * wanted.max())
    camera = camera_of(H, W)
    Z = np.full((H, W), 2, np.float32)
    fused = relight_fused(albedo, Z, N, camera, [light])
    np.testing.assert_allclose(fused, comp.relight(albedo, light_layers(position_from_depth(Z, camera), N, albedo, [light])), rtol=1e-4, atol=1e-5)


LIGHTS: tuple[Light, ...] = (
    PointLight(name="p", position_m=(1, 1, 0), specular=0.5),
    SphereLight(name="q", position_m=(-1, 1, 0), radius_m=0.2),
)
METAL = Material(name="metal", matte="left", model="ggx", roughness=0.4, f0=0.9, specular=1, diffuse=0)
DULL = Material(name="dull", matte="soft", model="lambert")


def test_materials_hold_in_their_mattes_and_blend_between() -> None:
    P, N, albedo = scene(3)
    left = np.zeros((H, W), np.float32)
    left[:, :7] = 1
    soft = np.random.default_rng(0).uniform(0, 1, (H, W)).astype(np.float32)
    mattes = {"left": left, "soft": soft}
    got = light_layers(P, N, albedo, LIGHTS, mattes=mattes, materials=[METAL, DULL])
    assert list(got) == ["light_p_diffuse", "light_p_specular", "light_q_diffuse", "light_q_specular"]
    plain = light_layers(P, N, albedo, LIGHTS)
    metal = light_layers(P, N, albedo, [METAL.under(light) for light in LIGHTS])
    dull = light_layers(P, N, albedo, [DULL.under(light) for light in LIGHTS])
    dark = np.zeros_like(albedo)
    for name, layer in got.items():
        below = np.where(left[..., None] == 1, metal[name], plain.get(name, dark))
        wanted = below * (1 - soft[..., None]) + dull.get(name, dark) * soft[..., None]
        np.testing.assert_allclose(layer, wanted, atol=1e-5 * max(wanted.max(), 1))
    camera = camera_of(H, W)
    Z = np.full((H, W), 2, np.float32)
    here = position_from_depth(Z, camera)
    want = albedo + total(light_layers(here, N, albedo, LIGHTS, mattes=mattes, materials=[METAL, DULL]))
    np.testing.assert_allclose(relight_fused(albedo, Z, N, camera, LIGHTS, mattes=mattes, materials=[METAL, DULL]), want, rtol=1e-4, atol=1e-5)
    nothing = light_layers(P, N, albedo, LIGHTS, mattes={"left": np.full((H, W), np.nan), "soft": 0 * soft}, materials=[METAL, DULL])
    for name, layer in plain.items():
        np.testing.assert_allclose(nothing[name], layer, rtol=1e-6)


def test_materials_are_refused_by_name() -> None:
    assert materials_from_dicts([{"name": "metal", "matte": "left", "model": "ggx", "roughness": 0.4, "f0": 0.9, "specular": 1, "diffuse": 0}]) == (
        METAL,
    )
    for table, words in (
        ({"name": "a", "matte": "m", "roughnes": 1}, "material 'a'.*'roughnes'.*did you mean 'roughness'"),
        ({"name": "a", "matte": "m", "roughness": 2}, "material 'a'.*roughness"),
        ({"name": "a", "matte": "m", "model": "gx"}, "material 'a'.*'gx'.*did you mean 'ggx'"),
        ({"name": "a", "matte": "m", "f0": 0.1, "ior": 1.5}, "material 'a'.*without ior"),
        ({"name": "a"}, "material 'a': matte is missing"),
        ({"name": "a", "matte": 3}, "material 'a': matte"),
    ):
        with pytest.raises(ShotError, match=words):
            materials_from_dicts([table])
    with pytest.raises(ShotError, match="taken"):
        materials_from_dicts([{"name": "a", "matte": "m"}, {"name": "a", "matte": "n"}])
    P, N, albedo = scene(4)
    with pytest.raises(ShotError, match="material 'metal': matte 'left' is missing"):
        light_layers(P, N, albedo, LIGHTS, materials=[METAL])
    with pytest.raises(PassError, match="matte 'left' must have shape"):
        light_layers(P, N, albedo, LIGHTS, materials=[METAL], mattes={"left": np.ones((2, 2), np.float32)})


def test_kelvin() -> None:
    np.testing.assert_allclose(kelvin_color(6504), 1, atol=1e-6)
    for k in (1700, 2222, 3200, 4000, 4500, 5000, 5600, 9000, 25000):
        assert LUMINANCE @ np.array(kelvin_color(k)) == pytest.approx(1)
    # CIE illuminant A is a black body at 2856 K: x 0.44757, y 0.40745, brought into Rec.709.
    rgb = np.linalg.solve(
        np.array(
            [[0.4123907993, 0.3575843394, 0.1804807884], [0.2126390059, 0.7151686788, 0.0721923154], [0.0193308187, 0.1191947798, 0.9505321522]]
        ),
        np.array([0.44757 / 0.40745, 1, (1 - 0.44757 - 0.40745) / 0.40745]),
    )
    np.testing.assert_allclose(kelvin_color(2856), rgb, atol=0.01)
    warm = [kelvin_color(k) for k in np.linspace(1700, 25000, 200)]
    assert all(a[0] >= b[0] - 1e-9 and a[2] <= b[2] + 1e-9 for a, b in itertools.pairwise(warm))
    light = PointLight(name="a", position_m=(0, 0, 0), kelvin=3200)
    assert lights_from_dicts([to_dict(light)]) == (light,)
    got = light_layers(np.full((1, 1, 3), (0, 0, -1.0)), np.full((1, 1, 3), (0, 0, 1.0)), np.ones((1, 1, 3)), [light])["light_a_diffuse"]
    np.testing.assert_allclose(got[0, 0], kelvin_color(3200), rtol=1e-5)
    with pytest.raises(ShotError, match="kelvin must stand alone"):
        dataclasses.replace(light, color=(1, 0, 0))
    with pytest.raises(ShotError, match="kelvin must be a number"):
        dataclasses.replace(light, kelvin=100)


def test_solo_and_groups() -> None:
    P, N, albedo = scene(5)
    a, b = (dataclasses.replace(light, group="set") for light in LIGHTS)
    layers = light_layers(P, N, albedo, [a, b])
    groups = group_layers(layers, [a, b])
    np.testing.assert_allclose(groups["group_set"], total(layers), rtol=1e-5, atol=1e-6)
    only = light_layers(P, N, albedo, [a, dataclasses.replace(b, solo=True)])
    assert list(only) == ["light_q_diffuse"]
    assert list(light_layers(P, N, albedo, [a, dataclasses.replace(b, solo=True, enabled=False)])) == ["light_p_diffuse", "light_p_specular"]
