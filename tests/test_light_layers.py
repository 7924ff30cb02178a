"""The laws of light as properties, the kernel against the NumPy reference, missing pixels, threads and refusals."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba import njit

from stereorelight import comp
from stereorelight.camera import Camera
from stereorelight.engine import (
    area_rows,
    ball_rows,
    dot_lights,
    eights,
    fastmath,
    light_rows,
    light_table,
    lobe_rows,
    march,
    march_rays,
    march_tops,
    other_lights,
    plain_lights,
    rows,
    spread,
    stream,
)
from stereorelight.engine import light as engine
from stereorelight.errors import PassError, ShotError
from stereorelight.light.lights import DirectionalLight, Light, PointLight, SpotLight
from stereorelight.light.shade import light_layers, relight_fused, relight_with_layers
from stereorelight.surface.position import position_from_depth
from tests.reference_light import reference_layers

REFERENCE = 5e-5  # of the layer's largest value: what float32 may be off the float64 reference
FLOAT = 2e-6
H, W = 7, 19
Array = np.ndarray


def scene(seed: int, height: int = H, width: int = W) -> tuple[Array, Array, Array]:
    """P in front of the camera, N facing it, albedo; all float32."""
    rng = np.random.default_rng(seed)
    P = rng.uniform((-2, -2, -5), (2, 2, -1), (height, width, 3))
    N = rng.normal(size=P.shape) - 0.8 * P
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    N *= np.where((N * P).sum(axis=-1, keepdims=True) > 0, -1, 1)
    return P.astype(np.float32), N.astype(np.float32), rng.uniform(0, 1.5, P.shape).astype(np.float32)


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Rounded, so that no layer is so dark that float32 runs out of digits."""
    return st.floats(low, high).map(lambda v: round(v, 3))


vectors = st.tuples(numbers(-3, 3), numbers(-3, 3), numbers(-3, 3))
directions = vectors.filter(lambda v: np.linalg.norm(v) > 0.1)
common = {
    "intensity": numbers(0, 8),
    "exposure": numbers(-2, 2),
    "color": st.tuples(numbers(0, 1), numbers(0, 2), numbers(0, 1)),
    "diffuse": numbers(0, 1),
    "specular": st.sampled_from([0.0, 0.5]),
    "exponent": st.one_of(numbers(1, 200), st.integers(1, 200)),
    "specular_tint": st.tuples(numbers(0, 1), numbers(0, 1), numbers(0, 1)),
    "normalised": st.booleans(),
    "wrap": st.sampled_from([0.0, 0.3, 1.0]),
}
# Farther than 1 cm from every surface: the reference knows no nearest distance.
places = st.tuples(numbers(-3, 3), numbers(-3, 3), numbers(-0.5, 2))
falls = {"position_m": places, "attenuation": st.sampled_from(["inverse_square", "linear", "none"])}
lights_ = st.one_of(
    st.builds(PointLight, name=st.just("a"), **common, **falls),
    st.builds(PointLight, name=st.just("a"), **common, position_m=places, attenuation=st.just("radius"), radius_m=numbers(2, 6)),
    st.builds(SpotLight, name=st.just("a"), **common, **falls, direction=directions, cone_deg=numbers(1, 170), penumbra_deg=numbers(2, 60)),
    st.builds(DirectionalLight, name=st.just("a"), **common, aim=directions),
    st.builds(DirectionalLight, name=st.just("a"), **common, azimuth_deg=numbers(-180, 180), elevation_deg=numbers(-90, 90)),
)
several = st.lists(lights_, min_size=1, max_size=4).map(lambda found: [dataclasses.replace(x, name=f"l{k}") for k, x in enumerate(found)])
seeds = st.integers(0, 2**31)
quick = settings(max_examples=40, deadline=None)


def without_end(light: Light) -> Light:
    """A spot as the point light that it is without its cone, and a light that ends at its radius as one that never does.

    Where the last sliver of either is all that anything sees, a layer's largest value says nothing of the light: a thousandth of what it
    gives without an end does."""
    if isinstance(light, SpotLight):
        light = PointLight(**{f.name: getattr(light, f.name) for f in dataclasses.fields(PointLight)})
    if isinstance(light, PointLight) and light.attenuation == "radius":
        light = dataclasses.replace(light, attenuation="inverse_square", radius_m=None)
    return light


def total(layers: dict[str, Array]) -> Array:
    return np.sum([layer.astype(np.float64) for layer in layers.values()], axis=0)


def size_of(light: Light, P: Array, N: Array, albedo: Array) -> float:
    """What its light is measured by: its largest value, or a thousandth of that without an end."""
    return max(total(light_layers(P, N, albedo, [light])).max(), 1e-3 * total(light_layers(P, N, albedo, [without_end(light)])).max())


LAST_SLIVER = PointLight(
    name="l0", color=(1.0, 0.0, 0.0), diffuse=0.0, specular=0.5, exponent=1.0, specular_tint=(1.0, 0.0, 0.0), normalised=False,
    position_m=(-2.0, -0.625, 1.512), attenuation="radius", radius_m=2.594,
)  # fmt: skip


@quick
@given(seed=seeds, lights=several)
@example(seed=807, lights=[LAST_SLIVER])
def test_kernel_agrees_with_the_reference(seed: int, lights: list[Light]) -> None:
    P, N, albedo = scene(seed)
    got = light_layers(P, N, albedo, lights)
    N64 = N.astype(np.float64)
    want = reference_layers(P.astype(np.float64), N64 / np.linalg.norm(N64, axis=-1, keepdims=True), albedo.astype(np.float64), lights)
    assert list(got) == list(want)
    bare = reference_layers(P.astype(np.float64), N64, albedo.astype(np.float64), [without_end(light) for light in lights])
    for name, layer in want.items():
        largest = max(layer.max(), 1e-3 * bare[name].max())
        np.testing.assert_allclose(got[name], layer, atol=REFERENCE * largest + 1e-30, rtol=0, err_msg=name)


@quick
@given(seed=seeds, lights=several)
def test_lights_add_up(seed: int, lights: list[Light]) -> None:
    P, N, albedo = scene(seed)
    together = light_layers(P, N, albedo, lights)
    for light in lights:
        for name, layer in light_layers(P, N, albedo, [light]).items():
            assert np.array_equal(layer, together[name])  # a light does not know of the others
    twice = [*lights, *(dataclasses.replace(x, name=f"{x.name}_again") for x in lights)]
    want = 2 * total(together)
    np.testing.assert_allclose(total(light_layers(P, N, albedo, twice)), want, rtol=FLOAT, atol=FLOAT * want.max())
    brighter = [dataclasses.replace(x, exposure=x.exposure + 1) for x in lights]
    np.testing.assert_allclose(total(light_layers(P, N, albedo, brighter)), want, rtol=FLOAT, atol=FLOAT * want.max())


@quick
@given(seed=seeds, light=lights_, scale=st.sampled_from([0.5, 2.0, 3.0]))
def test_a_larger_scene_with_stronger_lights_looks_the_same(seed: int, light: Light, scale: float) -> None:
    P, N, albedo = scene(seed)
    larger = light
    if isinstance(light, PointLight):
        power = {"linear": 1, "none": 0}.get(light.attenuation, 2)
        radius = None if light.radius_m is None else scale * light.radius_m
        x, y, z = (scale * v for v in light.position_m)
        larger = dataclasses.replace(light, position_m=(x, y, z), intensity=light.intensity * scale**power, radius_m=radius)
    before, after = total(light_layers(P, N, albedo, [light])), total(light_layers(np.float32(scale) * P, N, albedo, [larger]))
    np.testing.assert_allclose(after, before, atol=REFERENCE * size_of(light, P, N, albedo) + 1e-30)


def rotation(a: float, b: float, c: float) -> Array:
    q = np.array([1.0, a, b, c]) / np.linalg.norm([1.0, a, b, c])
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@quick
@given(seed=seeds, light=lights_, turn=vectors)
def test_turning_everything_about_the_eye_changes_nothing(seed: int, light: Light, turn: tuple[float, float, float]) -> None:
    P, N, albedo = scene(seed)
    R = rotation(*turn)
    pose = np.eye(4)
    pose[:3, :3] = R.T
    camera = Camera(size=(W, H), K=np.array([[20.0, 0, 9], [0, 20, 3], [0, 0, 1]]), world_from_camera=pose)
    turned = light_layers(
        (P @ R.T).astype(np.float32), (N @ R.T).astype(np.float32), albedo, [dataclasses.replace(light, space="world")], camera=camera
    )
    want = total(light_layers(P, N, albedo, [light]))
    np.testing.assert_allclose(total(turned), want, atol=2 * REFERENCE * size_of(light, P, N, albedo) + 1e-30)


@quick
@given(seed=seeds, light=lights_)
def test_a_light_behind_every_surface_adds_nothing(seed: int, light: Light) -> None:
    P, _, albedo = scene(seed)
    N = np.broadcast_to(np.float32((0, 0, 1)), P.shape)
    moved: Light = dataclasses.replace(light, wrap=0)
    if isinstance(light, PointLight):
        moved = dataclasses.replace(light, wrap=0, position_m=(0, 0, -5.5))
    elif isinstance(light, DirectionalLight):
        moved = DirectionalLight(name="a", aim=(0.3, 0.2, 1), specular=1)
    for layer in light_layers(P, N, albedo, [moved]).values():
        assert (layer == 0).all()


# ---- missing, damaged and extreme pixels


def spoilt(seed: int = 5) -> tuple[Array, Array, Array, Array]:
    P, N, albedo = scene(seed, 9, 70)
    bad = np.zeros(P.shape[:2], bool)
    for row, (what, value) in enumerate([(P, np.nan), (P, np.inf), (P, -np.inf), (N, np.nan), (N, np.inf), (N, 0), (P, 0), (P, 3e38)]):
        what[row, 5 + row] = value
        bad[row, 5 + row] = True
    P[8, 3, 1] = np.nan
    N[8, 69, 2] = np.nan
    bad[8, [3, 69]] = True
    return P, N, albedo, bad


ALL_KINDS = (
    PointLight(name="p", position_m=(1, 1, 0), specular=0.5, wrap=0.5),
    PointLight(name="q", position_m=(1, 1, 0), wrap=1, attenuation="radius", radius_m=9),
    SpotLight(name="s", position_m=(0, 1, 0), aim_m=(0, 0, -3), cone_deg=80, penumbra_deg=20, specular=0.5, wrap=0.5, matte="skin"),
    DirectionalLight(name="d", azimuth_deg=20, elevation_deg=30, specular=0.2, wrap=0.2),
    PointLight(name="m", position_m=(1, 1, 0), wrap=1, matte="skin"),
)


def test_missing_pixels_are_dark_and_the_others_do_not_notice() -> None:
    P, N, albedo, bad = spoilt()
    matte = np.ones(bad.shape, np.float32)
    whole = light_layers(*scene(5, 9, 70), ALL_KINDS, mattes={"skin": matte})
    for name, layer in light_layers(P, N, albedo, ALL_KINDS, mattes={"skin": matte}).items():
        assert (layer[bad] == 0).all(), name
        assert np.array_equal(layer[~bad], whole[name][~bad]), name
        assert np.isfinite(layer).all()


def test_a_damaged_albedo_or_matte_stays_in_its_own_pixel() -> None:
    P, N, albedo = scene(6)
    matte = np.ones((H, W), np.float32)
    whole = light_layers(P, N, albedo, ALL_KINDS, mattes={"skin": matte})
    albedo[2, 3] = np.nan
    albedo[4, 5, 0] = np.inf
    matte[1, 1] = np.nan
    for name, layer in light_layers(P, N, albedo, ALL_KINDS, mattes={"skin": matte}).items():
        assert np.isfinite(layer).all()
        same = np.ones((H, W), bool)
        same[[2, 4, 1], [3, 5, 1]] = False
        assert np.array_equal(layer[same], whole[name][same])
    assert (light_layers(P, N, albedo, ALL_KINDS, mattes={"skin": matte})["light_s_diffuse"][1, 1] == 0).all()


def test_a_light_on_the_surface_or_inside_it_is_finite() -> None:
    P = np.full((3, 3, 3), (0.0, 0.0, -2.0), np.float32)
    N = np.full((3, 3, 3), (0.0, 0.0, 1.0), np.float32)
    for z in (-2.0, -1.9999, -2.0001, -2.5):
        for extra in ({}, {"wrap": 1.0}):
            light = PointLight(name="a", position_m=(0, 0, z), specular=1, **extra)
            layers = light_layers(P, N, np.ones_like(P), [light])
            assert all(np.isfinite(layer).all() and (layer >= 0).all() and layer.max() <= 1e4 for layer in layers.values())
            if z <= -2 and not extra:
                assert all((layer == 0).all() for layer in layers.values())


def test_mattes_hold_the_light() -> None:
    P, N, albedo = scene(7)
    matte = np.linspace(0, 1, H * W, dtype=np.float32).reshape(H, W)
    light = PointLight(name="a", position_m=(0, 0, 0), specular=0.4)
    free = light_layers(P, N, albedo, [light])
    held = light_layers(P, N, albedo, [dataclasses.replace(light, matte="skin")], mattes={"skin": matte, "unused": matte[:2]})
    for name in free:
        np.testing.assert_allclose(held[name], free[name] * matte[..., None], rtol=FLOAT)


def test_lights_that_are_off_leave_no_layers() -> None:
    P, N, albedo = scene(8)
    on, off = PointLight(name="a", position_m=(0, 0, 0)), PointLight(name="b", position_m=(0, 0, 0), enabled=False)
    assert list(light_layers(P, N, albedo, [off, on])) == ["light_a_diffuse"]
    assert light_layers(P, N, albedo, [off]) == {}


# ---- the fused way


def camera_of(height: int, width: int, distortion: tuple[float, ...] = ()) -> Camera:
    f = 0.9 * width
    return Camera(size=(width, height), K=np.array([[f, 0, width / 2 - 3], [0, f, height / 2 + 1], [0, 0, 1]]), distortion=distortion)


@pytest.mark.parametrize("width", [19, 64, 2131])  # one vector, whole vectors, and more than one strip
@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.001)])
def test_fused_equals_layers_and_comp(width: int, distortion: tuple[float, ...]) -> None:
    height = 21
    camera = camera_of(height, width, distortion)
    _, N, plate = scene(9, height, width)
    rng = np.random.default_rng(1)
    Z = rng.uniform(1, 5, camera.size_hw).astype(np.float32)
    Z[3, 4], Z[5, 6], N[7, 8] = np.nan, np.inf, np.nan
    matte = rng.uniform(0, 1, Z.shape).astype(np.float32)
    gain = (0.5, 1.0, 0.25)
    got = relight_fused(plate, Z, N, camera, ALL_KINDS, plate_gain=gain, mattes={"skin": matte})
    P = position_from_depth(np.where(np.isinf(Z), np.nan, Z), camera)
    want = comp.relight(plate, light_layers(P, N, plate, ALL_KINDS, mattes={"skin": matte}, camera=camera), plate_gain=gain)
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=5e-6 * want.max())
    for y, x in ((3, 4), (5, 6), (7, 8)):
        np.testing.assert_array_equal(got[y, x], plate[y, x] * np.float32(gain))
    albedo = plate[::-1].copy()
    got = relight_fused(plate, Z, N, camera, ALL_KINDS[:2], albedo=albedo, rays=camera.ray_grid())
    want = comp.relight(plate, light_layers(P, N, albedo, ALL_KINDS[:2]))
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=5e-6 * want.max())


def test_picture_and_layers_from_one_pass_are_those_of_two() -> None:
    camera = camera_of(21, 70)
    _, N, plate = scene(9, 21, 70)
    Z = np.random.default_rng(1).uniform(1, 5, camera.size_hw).astype(np.float32)
    matte = np.linspace(0, 1, Z.size, dtype=np.float32).reshape(Z.shape)
    for lights in (ALL_KINDS, ALL_KINDS[:1]):
        beauty, layers = relight_with_layers(plate, Z, N, camera, lights, plate_gain=0.5, mattes={"skin": matte})
        assert np.array_equal(beauty, relight_fused(plate, Z, N, camera, lights, plate_gain=0.5, mattes={"skin": matte}))
        want = light_layers(position_from_depth(Z, camera), N, plate, lights, mattes={"skin": matte})
        assert list(layers) == list(want)
        for name, layer in want.items():
            np.testing.assert_allclose(layers[name], layer, rtol=1e-4, atol=5e-6 * layer.max())
        np.testing.assert_allclose(beauty, comp.relight(plate, layers, plate_gain=0.5), rtol=1e-5, atol=FLOAT * beauty.max())
    room = np.full_like(plate, 7)
    assert relight_fused(plate, Z, N, camera, ALL_KINDS[:1], plate_gain=0.5, out=room) is room
    assert np.array_equal(room, beauty)
    assert relight_fused(plate, Z, N, camera, [], out=room).tobytes() == plate.tobytes()
    for wrong in (plate, room[:, :, :2], room.astype(np.float64), room[::-1]):
        with pytest.raises(PassError, match="out must"):
            relight_fused(plate, Z, N, camera, ALL_KINDS[:1], out=wrong)
    beauty, layers = relight_with_layers(plate, Z, N, camera, [])
    assert beauty.tobytes() == plate.tobytes()
    assert not layers


@pytest.mark.parametrize("exponent", [1, 2, 3, 5, 8, 21, 32, 77, 100, 127])
@pytest.mark.parametrize("width", [19, 64, 600])
def test_one_light_alone_is_what_it_is_among_others(exponent: int, width: int) -> None:
    """Lights whose highlights bear dot products have a loop of their own; beside a light with a window, of no strength, they have another."""
    _, N, plate = scene(9, 9, width)
    Z = np.random.default_rng(1).uniform(1, 5, (9, width)).astype(np.float32)
    Z[3, 4], Z[5, 6], N[7, 8], plate[2, 2] = np.nan, np.inf, np.nan, np.nan
    matte = np.linspace(0, 1, Z.size, dtype=np.float32).reshape(Z.shape)
    off = PointLight(name="off", position_m=(0, 0, 0), intensity=0, attenuation="radius", radius_m=9)
    kinds = (
        PointLight(name="a", position_m=(1, 1, 0), specular=0.5, exponent=exponent, wrap=0.3),
        PointLight(name="a", position_m=(0, 0, 0), specular=0.5, exponent=exponent, matte="skin", attenuation="linear"),
        DirectionalLight(name="a", azimuth_deg=20, elevation_deg=10, specular=1, exponent=exponent),
        PointLight(name="a", position_m=(1, 1, 0), exponent=exponent + 0.5),
    )
    for camera in (camera_of(9, width), camera_of(9, width, (-0.2, 0.05, 0.001, -0.001))):
        for light in kinds:
            alone, among = (relight_fused(plate, Z, N, camera, lights, plate_gain=0.5, mattes={"skin": matte}) for lights in ([light], [light, off]))
            assert np.nanmax(np.abs(among - 0.5 * plate)) > 0.01
            np.testing.assert_allclose(alone, among, rtol=2e-6, atol=REFERENCE * 0.1 * np.nanmax(among))
            for y, x in ((3, 4), (5, 6), (7, 8)):
                np.testing.assert_array_equal(alone[y, x], plate[y, x] * np.float32(0.5))
            assert np.isnan(alone[2, 2]).all()
            assert np.isfinite(alone).sum() == alone.size - 3


@pytest.mark.parametrize("width", [19, 64, 2131])
@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.001)])
def test_several_lights_together_are_their_layers(width: int, distortion: tuple[float, ...]) -> None:
    """Lights that bear dot products, one without a highlight and one through a matte: picture and layers from one pass, against layers from P."""
    camera = camera_of(9, width, distortion)
    _, N, plate = scene(9, 9, width)
    rng = np.random.default_rng(2)
    Z, matte = (rng.uniform(low, 5, (9, width)).astype(np.float32) for low in (1, -1))
    matte = np.clip(matte, 0, 1)
    Z[3, 4], N[7, 8], plate[2, 2], matte[1, 1] = np.nan, np.inf, np.nan, np.nan
    lights = [
        PointLight(name="a", position_m=(1, 1, 0), specular=0.5, exponent=21, matte="skin"),
        DirectionalLight(name="b", azimuth_deg=20, elevation_deg=10, wrap=0.4, color=(1, 0.5, 0.2)),
        PointLight(name="c", position_m=(-1, 0, 0), specular=0.5, exponent=64, attenuation="none"),
    ]
    beauty, layers = relight_with_layers(plate, Z, N, camera, lights, mattes={"skin": matte})
    assert np.array_equal(beauty, relight_fused(plate, Z, N, camera, lights, mattes={"skin": matte}), equal_nan=True)
    want = light_layers(position_from_depth(Z, camera), N, plate, lights, mattes={"skin": matte})
    assert list(layers) == list(want)
    for name, layer in want.items():
        np.testing.assert_allclose(layers[name], layer, rtol=1e-4, atol=REFERENCE * layer.max())
        assert not layers[name][3, 4].any()
    assert not layers["light_a_diffuse"][1, 1].any()
    np.testing.assert_allclose(beauty, comp.relight(plate, layers), rtol=1e-5, atol=FLOAT * np.nanmax(beauty))
    assert np.isfinite(beauty).sum() == beauty.size - 3


def test_plain_lights_do_not_wait_for_the_kernel_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """That kernel takes most of a minute to compile."""

    def never(*args: object) -> None:
        raise AssertionError("the kernel of other lights was asked")

    monkeypatch.setattr(engine.other, "other_lights", never)
    camera = camera_of(H, W)
    P, N, plate = scene(3)
    relight_with_layers(plate, -P[..., 2], N, camera, ALL_KINDS, mattes={"skin": plate[..., 0] / 2})
    light_layers(P, N, plate, ALL_KINDS, mattes={"skin": plate[..., 0] / 2})
    with pytest.raises(AssertionError, match="was asked"):
        relight_fused(plate, -P[..., 2], N, camera, [dataclasses.replace(ALL_KINDS[0], rim=1)])


def test_plain_and_other_lights_add_up_in_one_picture() -> None:
    camera = camera_of(21, 70)
    _, N, plate = scene(9, 21, 70)
    Z = np.random.default_rng(1).uniform(1, 5, camera.size_hw).astype(np.float32)
    albedo = plate[::-1].copy()
    lights = [
        *ALL_KINDS[:2],
        dataclasses.replace(ALL_KINDS[3], name="rim", rim=0.5),
        PointLight(name="g", position_m=(1, 0, 0), model="ggx", specular=1),
    ]
    for own in (None, albedo):
        beauty, layers = relight_with_layers(plate, Z, N, camera, lights, plate_gain=0.5, albedo=own)
        np.testing.assert_allclose(beauty, comp.relight(plate, layers, plate_gain=0.5), rtol=1e-5, atol=FLOAT * beauty.max())
        for light in lights:
            for name, layer in relight_with_layers(plate, Z, N, camera, [light], albedo=plate if own is None else own)[1].items():
                np.testing.assert_allclose(layer, layers[name], rtol=1e-5, atol=FLOAT * layer.max())


def test_other_lights_alone_make_the_picture_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plate is not gone over by the other kernel first; what is NaN in it stays NaN, what is not lit stays the plate."""

    def never(*args: object) -> None:
        raise AssertionError("the kernel of plain lights was asked")

    monkeypatch.setattr(engine.plain, "plain_lights", never)
    camera = camera_of(21, 70)
    _, N, plate = scene(9, 21, 70)
    Z = np.random.default_rng(1).uniform(1, 5, camera.size_hw).astype(np.float32)
    Z[4], plate[7] = np.nan, np.nan
    light = PointLight(name="g", position_m=(1, 0, 0), model="ggx", specular=1)
    for own in (None, plate[::-1].copy()):
        beauty, layers = relight_with_layers(plate, Z, N, camera, [light], plate_gain=0.5, albedo=own)
        np.testing.assert_allclose(beauty, comp.relight(plate, layers, plate_gain=0.5), rtol=1e-6)
        np.testing.assert_array_equal(beauty[4], plate[4] * np.float32(0.5))
        assert np.isnan(beauty[7]).all()
        assert (beauty[8] > plate[8] * np.float32(0.5)).any()


def test_fused_without_lights_is_the_plate_bit_for_bit() -> None:
    camera = camera_of(H, W)
    P, N, plate = scene(3)
    plate[0, 0] = (np.nan, -0.0, -3.0)
    off = PointLight(name="a", position_m=(0, 0, 0), enabled=False)
    for lights in ([], [off]):
        got = relight_fused(plate, -P[..., 2], N, camera, lights)
        assert got is not plate
        assert got.tobytes() == plate.tobytes()
    halved = relight_fused(plate, -P[..., 2], N, camera, [], plate_gain=0.5)
    np.testing.assert_array_equal(halved, comp.relight(plate, {}, plate_gain=0.5))


def test_a_damaged_plate_stays_in_its_own_pixel() -> None:
    camera = camera_of(H, W)
    P, N, plate = scene(4)
    whole = relight_fused(plate, -P[..., 2], N, camera, ALL_KINDS[:2])
    plate[2, 2] = np.nan
    got = relight_fused(plate, -P[..., 2], N, camera, ALL_KINDS[:2])
    assert np.isnan(got[2, 2]).all()
    got[2, 2] = whole[2, 2]
    assert np.array_equal(got, whole)


# ---- threads


def test_the_same_bits_whatever_the_number_of_threads_and_wherever_a_row_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    P, N, albedo = scene(10, 133, 90)
    results = []
    for count in (1, 2, 5):
        monkeypatch.setattr(rows.numba, "get_num_threads", lambda count=count: count)
        results.append(light_layers(P, N, albedo, ALL_KINDS, mattes={"skin": albedo[..., 0] / 2}))
    window = (slice(30, 101), slice(13, 57))
    cut = light_layers(P[window], N[window], albedo[window], ALL_KINDS, mattes={"skin": albedo[window][..., 0] / 2})
    for name, layer in results[0].items():
        assert all(np.array_equal(layer, other[name]) for other in results[1:])
        assert np.array_equal(layer[window], cut[name])


def test_two_callers_at_once() -> None:
    P, N, albedo = scene(11, 200, 160)
    camera = camera_of(200, 160)
    want = relight_fused(albedo, -P[..., 2], N, camera, ALL_KINDS[:2])
    wrong: list[int] = []

    def call() -> None:
        for k in range(15):
            if not np.array_equal(relight_fused(albedo, -P[..., 2], N, camera, ALL_KINDS[:2]), want):
                wrong.append(k)

    callers = [threading.Thread(target=call) for _ in range(3)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert not wrong


def test_a_problem_in_a_block_reaches_the_caller() -> None:
    def run(first: int, end: int) -> None:
        if first <= 40 < end:
            raise ValueError("block")

    with pytest.raises(ValueError, match="block"):
        rows.in_row_blocks(run, 100)


def test_kernels_work_where_nothing_can_be_cached(monkeypatch: pytest.MonkeyPatch) -> None:
    njit = fastmath.njit

    def refuses_cache(**options: object) -> object:
        if options.pop("cache", False):
            raise RuntimeError("cannot cache function: no locator available")
        return njit(**options)

    monkeypatch.setattr(fastmath, "njit", refuses_cache)
    assert fastmath.kernel()(lambda x: x + 1)(1) == 2


@pytest.mark.parametrize("width", [1, 7, 61])
def test_layers_past_the_caches_hold_the_same_bits(monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    """Large layers are streamed to memory line by line: rows that begin and end anywhere in a line, with a rim on top, and nothing beside them."""
    rng = np.random.default_rng(width)
    P = rng.uniform(-1, 1, (19, width, 3)).astype(np.float32) - np.float32([0, 0, 3])
    N, albedo = rng.normal(size=P.shape).astype(np.float32), rng.uniform(0, 1, P.shape).astype(np.float32)
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    lights = [PointLight(name="a", position_m=(1, 1, 0), specular=0.3, rim=0.5), DirectionalLight(name="b", azimuth_deg=30)]
    found = []
    for least in (0, 1 << 40):
        monkeypatch.setattr(engine, "STREAM_BYTES", least)
        found.append(light_layers(P, N, albedo, lights))
    assert len(found[0]) == 3
    for name, layer in found[1].items():
        np.testing.assert_array_equal(found[0][name], layer)
        assert layer.any()


@pytest.mark.parametrize("exponent", [1, 2, 7, 32, 64, 65, 127])
def test_one_light_alone_keeps_its_highlight_exact(exponent: int) -> None:
    """Its loop takes R.V straight from dot products, up to an exponent that bears what they lose; beyond it, it is not asked."""
    camera = Camera.from_fov(50, (256, 64))
    rng = np.random.default_rng(exponent)
    light = PointLight(name="a", position_m=(1, 1, 0), specular=1, exponent=exponent)
    Z = rng.uniform(1, 5, camera.size_hw).astype(np.float32)
    P = position_from_depth(Z, camera).astype(np.float64)
    towards, back = np.array(light.position_m) - P, -P
    half = towards / np.linalg.norm(towards, axis=-1, keepdims=True) + back / np.linalg.norm(back, axis=-1, keepdims=True)
    half = half / np.linalg.norm(half, axis=-1, keepdims=True) + 0.3 / exponent**0.5 * rng.normal(size=half.shape)  # within the highlight
    N = (half / np.linalg.norm(half, axis=-1, keepdims=True)).astype(np.float32)
    plate = np.zeros_like(N)
    want = reference_layers(P, N.astype(np.float64), plate.astype(np.float64), [light])["light_a_specular"]
    apart = np.abs(relight_fused(plate, Z, N, camera, [light]) - want)
    assert want.max() > 0.1
    assert apart.max() < 3e-5 * want.max()


def test_the_cached_kernels_are_those_of_todays_files() -> None:
    """numba hashes a kernel's own file only: with another fastmath.py the disk cache would go on with the old mathematics."""
    pairs = (
        (fastmath, "FASTMATH", light_rows),
        (fastmath, "FASTMATH", area_rows),
        (light_rows, "LEAVES", dot_lights),
        (light_rows, "LEAVES", plain_lights),
        (eights, "EIGHTS", dot_lights),
        (light_table, "TABLE", dot_lights),
        (spread, "SPREAD", dot_lights),
        (eights, "EIGHTS", plain_lights),
        (dot_lights, "DOTS", plain_lights),
        (light_table, "TABLE", plain_lights),
        (light_rows, "LEAVES", other_lights),
        (plain_lights, "PLAIN", other_lights),
        (light_table, "TABLE", other_lights),
        (area_rows, "AREA_LEAVES", other_lights),
        (fastmath, "FASTMATH", lobe_rows),
        (lobe_rows, "LOBES", ball_rows),
        (lobe_rows, "LOBE_LEAVES", other_lights),
        (ball_rows, "BALL_LEAVES", other_lights),
        (fastmath, "FASTMATH", stream),
        (eights, "EIGHTS", spread),
        (fastmath, "FASTMATH", spread),
        (spread, "SPREAD", plain_lights),
        (stream, "STREAM", plain_lights),
        (stream, "STREAM", other_lights),
        (fastmath, "FASTMATH", march_rays),
        (march_rays, "LEAVES", march),
        (march_tops, "TOPS", march),
    )
    for module, name, holder in pairs:
        found = hashlib.sha256(Path(module.__file__).read_text(encoding="utf-8").encode()).hexdigest()[:16]
        assert found == getattr(holder, name), f'{module.__name__} has changed: set {name} = "{found}" in {holder.__name__}'


# ---- small mathematics


@functools.cache
def _uncached(leaf: Callable[..., float]) -> Callable[..., float]:
    """`leaf` as the kernels have it, compiled now."""
    compiled: Callable[..., float] = njit(fastmath=fastmath.FAST, error_model="numpy")(leaf.py_func)  # type: ignore[attr-defined]
    return compiled


@quick
@given(h=st.one_of(st.floats(0, 1, width=32), st.floats(0, 2**-10, width=32)), n=numbers(1, 5000))
def test_power(h: float, n: float) -> None:
    power = _uncached(fastmath.power_below_one)
    want = (1 - np.float64(h)) ** np.float64(n)
    assert abs(power(np.float32(h), np.float32(n)) - want) <= 4e-6 * want + 1e-9


def test_angle_of_chord() -> None:
    angle = _uncached(fastmath.angle_of_chord)
    for a in [*np.geomspace(1e-5, 3.1, 60), np.pi]:
        assert abs(angle(np.float32(4 * np.sin(a / 2) ** 2)) - a) <= 4e-7 * a / max(np.cos(a / 2), 1e-3)


# ---- refusals


def test_bad_input_is_refused_by_name() -> None:
    P, N, albedo = scene(12)
    camera = camera_of(H, W)
    skin = PointLight(name="key", position_m=(0, 0, 0), matte="skin")
    with pytest.raises(PassError, match=r"P must have shape \(7, 19, 3\), got \(6, 19, 3\)"):
        light_layers(P[:-1], N, albedo, [])
    with pytest.raises(PassError, match="albedo must be float"):
        light_layers(P, N, albedo.astype(np.uint8), [])
    with pytest.raises(ShotError, match=r"'key'.*matte 'skin' is missing.*did you mean 'skins'"):
        light_layers(P, N, albedo, [skin], mattes={"skins": albedo[..., 0]})
    with pytest.raises(ShotError, match=r"'key'.*matte 'skin' is missing"):
        light_layers(P, N, albedo, [skin])
    with pytest.raises(PassError, match=r"matte 'skin' must have shape \(7, 19\)"):
        light_layers(P, N, albedo, [skin], mattes={"skin": albedo[:3, :, 0]})
    with pytest.raises(PassError, match=r"matte 'skin' must lie in 0 ... 1, got 255"):
        light_layers(P, N, albedo, [skin], mattes={"skin": np.full((H, W), 255.0)})
    with pytest.raises(ShotError, match=r"'key'.*taken"):
        light_layers(P, N, albedo, [skin, skin], mattes={"skin": np.ones((H, W))})
    with pytest.raises(PassError, match="Z must have shape"):
        relight_fused(albedo, P, N, camera, [skin])
    with pytest.raises(PassError, match="plate must have shape"):
        relight_fused(albedo[:3], -P[..., 2], N, camera, [])
    with pytest.raises(ShotError, match="plate_gain must be at least 0, got -1"):
        relight_fused(albedo, -P[..., 2], N, camera, [], plate_gain=-1)
