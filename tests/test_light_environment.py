"""Light from all around: against the float64 reference and closed answers; furnaces, turns, seams, missing pixels, threads, refusals."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from stereorelight import comp
from stereorelight.camera import Camera
from stereorelight.engine import environment as engine
from stereorelight.engine import environment_rows, environment_vector, fastmath, rows
from stereorelight.errors import PassError, ShotError
from stereorelight.light import environment_filter as filters
from stereorelight.light import spherical_harmonics as harmonics
from stereorelight.light.environment import Environment, environment_layers, level_of
from stereorelight.light.environment_maps import directions, solid_angles
from stereorelight.light.environment_settings import EnvironmentSettings, environment_from_dict, turn
from stereorelight.light.fresnel import dielectric, refracted
from stereorelight.light.skies import gradient, sky, studio
from stereorelight.passes import Frame
from stereorelight.surface.position import position_from_depth
from tests.reference_environment import look, reference_layers, unit, ways

Array = np.ndarray
REFERENCE = 5e-5  # of the layer's largest value
H, W = 7, 19
ALL = EnvironmentSettings(reflection=1, refraction=1)
quick = settings(max_examples=40, deadline=None)
seeds = st.integers(0, 2**31)


def scene(seed: int, height: int = H, width: int = W) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    P = rng.uniform((-2, -2, -5), (2, 2, -1), (height, width, 3))
    N = rng.normal(size=P.shape) - 0.8 * P
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    N *= np.where((N * P).sum(axis=-1, keepdims=True) > 0, -1, 1)
    return P.astype(np.float32), N.astype(np.float32), rng.uniform(0, 1.5, P.shape).astype(np.float32)


def sphere(size: int = 64) -> tuple[Array, Array, Array]:
    """A unit sphere that fills the frame, 50 m away, NaN round it."""
    x, y = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, 1 - (np.arange(size) + 0.5) / size * 2)
    z2 = 1 - x * x - y * y
    N = np.where(z2[..., None] > 1e-3, np.stack([x, y, np.sqrt(np.maximum(z2, 0))], axis=-1), np.nan)
    return (N + (0, 0, -50)).astype(np.float32), N.astype(np.float32), np.ones_like(N, np.float32)


def even(value: float = 1.0, height: int = 16) -> Environment:
    return Environment(np.full((height, 2 * height, 3), value, np.float32))


def rotation(seed: int) -> Array:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


# ---- the kernel against the reference


@quick
@example(seed=7835, ior=0.402, mixed=False, blend=0.0, away=False)
@example(seed=369, ior=0.4, mixed=False, blend=0.0, away=False)
@example(seed=548068912, ior=0.451, mixed=False, blend=0.0, away=True)
@given(seed=seeds, ior=st.floats(0.4, 3).map(lambda v: round(v, 3)), mixed=st.booleans(), blend=st.sampled_from([0.0, 0.3, 0.75]), away=st.booleans())
def test_kernel_agrees_with_the_reference(seed: int, ior: float, mixed: bool, blend: float, away: bool) -> None:
    P, N, albedo = scene(seed)
    if away:
        N = -N
    rng = np.random.default_rng(seed)
    maps = [rng.uniform(0, 1, (n, 2 * n, 3)).astype(np.float32) for n in (8, 16, 8)]
    M = rotation(seed)
    numbers = np.zeros(engine.NUMBERS, np.float32)
    numbers[:9] = M.reshape(-1)
    numbers[engine.IOR], numbers[engine.MIXED], numbers[engine.BLEND] = ior, mixed, blend
    numbers[engine.DIFFUSE :] = 1
    got = [np.empty_like(P) for _ in range(3)]
    soft, sharp, rough = (engine.padded(m) for m in maps)
    engine.shade(P, N, albedo, None, numbers, soft=soft, sharp=sharp, rough=rough, diffuse=got[0], reflection=got[1], refraction=got[2])
    exact = [a.astype(np.float64) for a in (P, N, albedo)]
    want = reference_layers(*exact, soft=maps[0], sharp=maps[1], rough=maps[2], blend=blend, ior=float(np.float32(ior)), mixed=mixed, M=M)
    # Near the critical angle Fresnel's share and the bent ray turn without bound with the cosine of incidence, and near the map's poles the azimuth
    # does with the way; for the bent ray one multiplies the other.  Where that is more than twentyfold float32 can say no more.
    _, R, T, inside2 = ways(*exact[:2], float(np.float32(ior)))
    bend = np.sqrt(np.abs(inside2[..., 0])) * min(ior, 1) ** 2
    for found, (name, layer), way in zip(got, want.items(), (exact[1], R, T), strict=True):
        pole = np.sqrt(np.maximum(1 - (unit(way) @ M[1]) ** 2, 0))
        calm = (pole * bend if name == "env_refraction" else np.minimum(pole, bend)) > 1 / 20
        assert calm.mean() > 0.6, name
        np.testing.assert_allclose(found[calm], layer[calm], atol=REFERENCE * max(layer.max(), 1), rtol=0, err_msg=name)


@pytest.mark.parametrize("ior", [0.5, 1 / 1.5, 1.0, 1.33, 1.5, 2.42, 10.0])
def test_fresnel_is_the_exact_formula(ior: float) -> None:
    """The strip is one row of normals that turn from the eye, total reflection included; closed values at the ends."""
    angle = np.linspace(0, math.pi / 2 - 1e-3, 400)
    N = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)[None].astype(np.float32)
    P = np.broadcast_to(np.float32((0, 0, -2)), N.shape)
    made = EnvironmentSettings(diffuse=0, reflection=1, refraction=1, ior=ior)
    layers = environment_layers(P, N, np.ones_like(N), even(), made)
    share = layers["env_reflection"][0, :, 0]
    want = dielectric(N[0, :, 2].astype(np.float64), ior)
    calm = np.abs(ior**2 - 1 + N[0, :, 2].astype(np.float64) ** 2) > 1e-4
    # Beside the critical angle the formula itself turns one unit in the last place of the cosine into more than 3e-6.
    unit = [dielectric(np.clip(N[0, :, 2].astype(np.float64) + step, 1e-9, 1), ior) for step in (-(2.0**-23), 2.0**-23)]
    assert (np.abs(share - want)[calm] <= 3e-6 + np.abs(unit[1] - unit[0])[calm]).all()
    assert share[0] == pytest.approx(((ior - 1) / (ior + 1)) ** 2, abs=1e-6)
    if ior < 1:
        beyond = angle > math.asin(ior) + 1e-3
        assert beyond.any()
        assert (share[beyond] == 1).all()
        assert (layers["env_refraction"][0, beyond] == 0).all()
    both = layers["env_reflection"] + layers["env_refraction"]
    np.testing.assert_allclose(both, 1, atol=1e-6)  # glass in a furnace cannot be seen


def test_brewsters_angle_and_grazing() -> None:
    c = math.cos(math.atan(1.5))
    assert dielectric(c, 1.5) == pytest.approx(0.5 * ((1 - 1.5**2) / (1 + 1.5**2)) ** 2, rel=1e-12)  # no parallel part at all
    assert dielectric(0.0, 1.5) == 1
    assert dielectric(0.0, 1.0) == 0
    T = refracted((0.0, 0.0, 1.0), (math.sin(0.5), 0, math.cos(0.5)), 1.5)
    assert math.hypot(T[0], T[1]) * 1.5 == pytest.approx(math.sin(0.5), rel=1e-12)  # Snell
    assert np.isnan(refracted((0.0, 0.0, 1.0), (math.sin(1.2), 0, math.cos(1.2)), 0.6)).all()


# ---- furnaces and closed answers


@pytest.mark.parametrize("roughness", [0.0, 0.05, 0.2, 0.33, 0.6, 1.0])
def test_white_furnace(roughness: float) -> None:
    P, N, albedo = sphere(33)
    made = EnvironmentSettings(reflection=1, refraction=1, fresnel=False, roughness=roughness)
    known = np.isfinite(N[..., 0])
    for name, layer in environment_layers(P, N, albedo, even(), made).items():
        assert np.abs(layer[known] - 1).max() < 1e-5, name
        assert (layer[~known] == 0).all()


def test_irradiance_of_an_even_map_is_that_map() -> None:
    for method in ("exact", "harmonics"):
        P, N, albedo = sphere(33)
        layer = environment_layers(P, N, albedo, even(0.7), EnvironmentSettings(diffuse_method=method))["env_diffuse"]
        assert np.abs(layer[np.isfinite(N[..., 0])] - 0.7).max() < 1e-4


def test_irradiance_of_half_a_sky() -> None:
    """Light 1 from x > 0: (1 + N.x) / 2."""
    for axis in range(3):
        half = (directions(128)[..., axis : axis + 1] > 0) * np.ones(3, np.float32)
        P, N, albedo = sphere(65)
        layer = environment_layers(P, N, albedo, Environment(half), EnvironmentSettings())["env_diffuse"]
        assert np.nanmax(np.abs(layer[..., 0] - (1 + N[..., axis]) / 2)[np.isfinite(N[..., 0])]) < 2e-3


def test_irradiance_of_a_gradient_both_ways() -> None:
    environment = Environment(gradient(128, slope=(0.3, 0.5, -0.2)))
    P, N, albedo = sphere(65)
    for method in ("exact", "harmonics"):
        layer = environment_layers(P, N, albedo, environment, EnvironmentSettings(diffuse_method=method))["env_diffuse"]
        want = 1 + 2 / 3 * (N @ (0.3, 0.5, -0.2))
        assert np.nanmax(np.abs(layer[..., 0] - want)[np.isfinite(want)]) < 3e-4


@pytest.mark.parametrize("where", [(10, 17), (64, 5), (120, 250), (1, 0)])
def test_irradiance_of_a_sun_of_one_pixel(where: tuple[int, int]) -> None:
    light = np.zeros((128, 256, 3), np.float32)
    light[where] = 1e4
    towards = directions(128)[where]
    d = directions(40).reshape(1, -1, 3)
    found = look(Environment(light).irradiance.astype(np.float64), d)[0, :, 0]
    want = 1e4 * solid_angles(128)[where[0]] * np.maximum(d[0] @ towards, 0) / math.pi
    assert np.abs(found - want).max() < 0.01 * want.max()


@pytest.mark.parametrize("index", range(1, len(filters.ROUGHNESS)))
def test_levels_are_the_integral(index: int) -> None:
    """Against the sum over every pixel of the map, with the lobe in the textbook's letters."""
    light = studio(256)
    level = filters.level(light, index)
    d, weights = directions(256).reshape(-1, 3), np.repeat(solid_angles(256), 512)
    fine = light.reshape(-1, 3).astype(np.float64)
    a2 = filters.ROUGHNESS[index] ** 4
    for way in ((0, 1, 0), (0.6, 0.2, -0.7), (-0.3, -0.9, 0.2)):
        R = np.array(way) / np.linalg.norm(way)
        NL = np.maximum(d @ R, 0)
        NH2 = (1 + d @ R) / 2
        D = a2 / (math.pi * (NH2 * (a2 - 1) + 1) ** 2)
        k = D * NL * weights
        want = (k[:, None] * fine).sum(0) / k.sum()
        got = look(level.astype(np.float64), R[None])[0]
        # The sum over pixels is itself coarse where the lobe is hardly wider than one.
        assert np.abs(got - want).max() < {1: 0.03, 2: 0.01, 3: 0.01}.get(index, 0.004) * level.max()


def test_roughness_runs_through_the_levels() -> None:
    assert level_of(0) == (0, 0)
    assert level_of(1) == (8, 0)
    assert level_of(1 / 4) == (4, 0)
    assert level_of(5 / 16) == (4, 0.5)
    sharpness = [float(filters.level(studio(64), k).std()) for k in range(len(filters.ROUGHNESS))]
    assert sharpness == sorted(sharpness, reverse=True)
    mean = [float((filters.level(studio(64), k)[..., 0] * solid_angles(filters.level(studio(64), k).shape[0])[:, None]).sum()) for k in (0, 3, 6, 8)]
    np.testing.assert_allclose(mean, mean[0], rtol=3e-3)  # a convolution moves light and makes none


def test_harmonics_know_a_gradient() -> None:
    c = harmonics.coefficients(gradient(64, mean=(1, 2, 3), slope=(0.1, 0.2, 0.3)))
    d = directions(8)
    np.testing.assert_allclose(harmonics.radiance(c, d), np.array([1, 2, 3]) + (d @ (0.1, 0.2, 0.3))[..., None], atol=2e-3)
    gram = np.einsum("hwa,hwb,h->ab", harmonics.basis(directions(128)), harmonics.basis(directions(128)), solid_angles(128))
    np.testing.assert_allclose(gram, np.eye(9), atol=1e-3)


# ---- directions, turns, seams


def mirror_at(d: tuple[float, float, float], environment: Environment, **more: object) -> Array:
    """What a mirror straight ahead shows that sends the eye's ray towards d."""
    R = np.array(d, float) / np.linalg.norm(d)
    N = R + (0, 0, 1.0)
    N /= np.linalg.norm(N)
    P = np.array([[[0, 0, -2.0]]])
    made = EnvironmentSettings(diffuse=0, reflection=1, fresnel=False, **more)
    return environment_layers(P, N[None, None], np.ones((1, 1, 3)), environment, made)["env_reflection"][0, 0]


def marked() -> Environment:
    """Each of six directions in its own colour: right red, left cyan, up green, down magenta, ahead blue, behind yellow."""
    d = directions(32)
    return Environment((0.5 + 0.5 * d).astype(np.float32) ** 2)


@pytest.mark.parametrize(
    ("d", "place"), [((1, 0, 0.01), (0.5, 0.75)), ((-1, 0, 0.01), (0.5, 0.25)), ((0.001, 1, 0.001), (0.0, None)), ((0, 0, 1), (0.5, 0.0))]
)
def test_directions_stand_where_the_page_says(d: tuple[float, float, float], place: tuple[float, float | None]) -> None:
    light = marked()
    row, column = place
    h, w = 32, 64
    at = light.latlong[min(int(row * h), h - 1), int((column or 0) * w) % w]
    assert np.abs(mirror_at(d, light) - at).max() < 0.06


def test_the_middle_of_the_map_is_straight_ahead() -> None:
    """Light passes straight through ior 1: the middle column stands on the camera's axis, +x right of it, +y above."""
    light = sky(64, sun=(0, 0, -1), sun_deg=20)
    N = np.full((1, 3, 3), (0, 0, 1), np.float32)
    P = np.array([[(0, 0, -2), (2, 0, -2), (0, 2, -2)]], np.float32)
    seen = environment_layers(P, N, np.ones_like(P), Environment(light), EnvironmentSettings(diffuse=0, refraction=1, ior=1))["env_refraction"][0]
    np.testing.assert_allclose(seen[0], light[31:33, 63:65].mean(axis=(0, 1)), rtol=1e-5)
    np.testing.assert_allclose(seen[1], look(light.astype(float), np.array([[1.0, 0, -1]]))[0], rtol=1e-4)
    np.testing.assert_allclose(seen[1], light[31:33, 79:81].mean(axis=(0, 1)), rtol=0.02)  # an eighth of the width to the right
    np.testing.assert_allclose(seen[2], light[15:17, 63:65].mean(axis=(0, 1)), rtol=0.02)


def test_rotation_says_what_it_does() -> None:
    ahead = np.array([0, 0, -1.0])
    np.testing.assert_allclose(turn((90, 0, 0)) @ ahead, (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(turn((0, 90, 0)) @ ahead, (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(turn((0, 0, 90)) @ (0, 1, 0), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(turn((90, 30, 0)) @ ahead, turn((90, 0, 0)) @ (turn((0, 30, 0)) @ ahead), atol=1e-12)
    # A quarter turn is a quarter of the map's columns, to float precision.
    light = Environment(np.random.default_rng(0).uniform(0, 1, (16, 32, 3)).astype(np.float32))
    rolled = Environment(np.roll(light.latlong, 8, axis=1))
    P, N, albedo = scene(3)
    a = environment_layers(P, N, albedo, light, dataclasses.replace(ALL, rotation_deg=(90, 0, 0)))
    b = environment_layers(P, N, albedo, rolled, ALL)
    for name, layer in a.items():
        np.testing.assert_allclose(layer, b[name], atol=REFERENCE)


@quick
@given(seed=seeds)
def test_turning_world_and_camera_together_changes_nothing(seed: int) -> None:
    P, N, albedo = scene(seed)
    light = Environment(studio(32))
    pose = np.eye(4)
    pose[:3, :3] = rotation(seed)
    pose[:3, 3] = 1, 2, 3
    camera = Camera(size=(W, H), K=np.array([[20.0, 0, 9], [0, 20, 3], [0, 0, 1]]), world_from_camera=pose)
    held = environment_layers(P, N, albedo, light, dataclasses.replace(ALL, space="camera"), camera=camera)
    want = environment_layers(P, N, albedo, light, ALL)
    for name in want:
        assert np.array_equal(held[name], want[name])  # a map of the camera does not know of the world
    # The same surface, seen by the turned camera: the world's light falls as it did on it.
    R = pose[:3, :3]
    still = environment_layers(P @ R.astype(np.float32), N @ R.astype(np.float32), albedo, light, ALL, camera=camera)
    for name in want:
        np.testing.assert_allclose(still[name], want[name], atol=4 * REFERENCE * max(float(want[name].max()), 1.0))


def test_no_seam_and_calm_poles() -> None:
    light = Environment(np.random.default_rng(1).uniform(0.2, 1, (16, 32, 3)).astype(np.float32))
    for height in (0.0, 0.4, -0.7):
        a, b = mirror_at((1e-6, height, 1), light), mirror_at((-1e-6, height, 1), light)
        np.testing.assert_allclose(a, b, atol=1e-4)
    for y in (1, -1):
        row = light.latlong[0 if y > 0 else -1]
        for x, z in ((0, 0), (1e-8, 1e-8), (-1e-5, 1e-6)):
            got = mirror_at((x, y, z), light)
            assert np.isfinite(got).all()
            assert (got >= row.min(axis=0) - 1e-5).all()
            assert (got <= row.max(axis=0) + 1e-5).all()


# ---- strengths, tints, sums


def test_strengths_tints_and_exposure_are_factors() -> None:
    P, N, albedo = scene(4)
    light = Environment(studio(32))
    plain = environment_layers(P, N, albedo, light, ALL)
    made = dataclasses.replace(
        ALL, diffuse=0.5, reflection=2, refraction=3, exposure=1, tint=(1, 0.5, 0.25), reflection_tint=(0.5, 1, 1), refraction_tint=(1, 1, 0)
    )
    found = environment_layers(P, N, albedo, light, made)
    for name, factor in (("env_diffuse", (1, 0.5, 0.25)), ("env_reflection", (2, 2, 1)), ("env_refraction", (6, 3, 0))):
        np.testing.assert_allclose(found[name], plain[name] * np.array(factor), rtol=2e-6, atol=1e-7)
    for key, name in (("diffuse", "env_diffuse"), ("reflection", "env_reflection"), ("refraction", "env_refraction")):
        assert name not in environment_layers(P, N, albedo, light, dataclasses.replace(ALL, **{key: 0.0}))
    assert environment_layers(P, N, albedo, light, dataclasses.replace(ALL, enabled=False)) == {}


def test_the_sum_of_the_layers_is_the_beauty_and_frames_take_them() -> None:
    P, N, albedo = scene(5)
    layers = environment_layers(P, N, albedo, Environment(studio(32)), ALL)
    beauty = comp.relight(albedo, layers)
    np.testing.assert_allclose(beauty, albedo + sum(layer.astype(np.float64) for layer in layers.values()), rtol=1e-6)
    assert set(Frame(passes={"beauty": beauty, **layers})) == {"beauty", "env_diffuse", "env_reflection", "env_refraction"}


def test_mattes_hold_every_layer() -> None:
    P, N, albedo = scene(7)
    matte = np.linspace(0, 1, H * W, dtype=np.float32).reshape(H, W)
    matte[2, 3] = np.nan
    light = Environment(studio(32))
    free = environment_layers(P, N, albedo, light, ALL)
    for name, layer in environment_layers(P, N, albedo, light, dataclasses.replace(ALL, matte="glass"), mattes={"glass": matte}).items():
        np.testing.assert_allclose(layer, free[name] * np.nan_to_num(matte)[..., None], rtol=2e-6, atol=1e-8)


# ---- the plate behind glass


def plate_scene(distortion: tuple[float, ...] = ()) -> tuple[Camera, Array, Array, Array]:
    camera = Camera(size=(80, 60), K=np.array([[90.0, 0, 40], [0, 90, 29], [0, 0, 1]]), distortion=distortion)
    y, x = np.mgrid[0:60, 0:80]
    plate = np.stack([x / 80, y / 60, 0.5 + 0 * x], axis=-1).astype(np.float32)
    P = position_from_depth(np.full((60, 80), 2.0, np.float32), camera)
    N = np.full_like(P, (0, 0, 1))
    return camera, P, N, plate


@pytest.mark.parametrize("distortion", [(), (-0.15, 0.02, 0.001, -0.001)])
def test_glass_that_bends_nothing_shows_the_plate(distortion: tuple[float, ...]) -> None:
    camera, P, N, plate = plate_scene(distortion)
    N[:] = (0.3, 0.2, 0.93)
    for ior, thickness in ((1.0, 0.5), (1.5, 0.0)):
        made = EnvironmentSettings(diffuse=0, refraction=1, fresnel=False, backdrop="plate", ior=ior, thickness_m=thickness)
        seen = environment_layers(P, N, plate, None, made, camera=camera, plate=plate)["env_refraction"]
        np.testing.assert_allclose(seen, plate, atol=1e-4)


def test_a_slab_shifts_the_plate_by_snells_law() -> None:
    camera, P, N, plate = plate_scene()
    made = EnvironmentSettings(diffuse=0, refraction=1, fresnel=False, backdrop="plate", ior=1.5, thickness_m=0.4)
    seen = environment_layers(P, N, plate, None, made, camera=camera, plate=plate)["env_refraction"]
    y, x = 15, 65
    slope = (x - 40) / 90, (y - 29) / 90
    s = math.hypot(*slope)
    inside = math.tan(math.asin(math.sin(math.atan(s)) / 1.5))
    depth = 2 + 0.4 * math.cos(math.atan(inside))
    radius = (2 * s + 0.4 * math.sin(math.atan(inside))) / depth
    want = (slope[0] / s * radius * 90 + 40) / 80, (slope[1] / s * radius * 90 + 29) / 60
    np.testing.assert_allclose(seen[y, x, :2], want, atol=1e-4)


def test_a_damaged_plate_behind_glass_stays_where_it_is_seen() -> None:
    camera, P, N, plate = plate_scene()
    plate[10, 10] = np.nan
    plate[40, 70, 1] = np.inf
    P[5, 5], N[6, 6] = np.nan, np.nan
    made = EnvironmentSettings(diffuse=0, refraction=1, backdrop="plate", thickness_m=3)
    seen = environment_layers(P, N, plate, None, made, camera=camera, plate=plate)["env_refraction"]
    assert np.isfinite(seen).all()
    assert (seen[[5, 6], [5, 6]] == 0).all()
    assert (np.abs(seen[..., 2]) < 1e-6).sum() < 30


# ---- missing pixels, threads


def test_missing_pixels_are_dark_and_the_others_do_not_notice() -> None:
    light = Environment(studio(32))
    made = dataclasses.replace(ALL, roughness=0.3)
    P, N, albedo = scene(5, 9, 70)
    whole = environment_layers(P, N, albedo, light, made)
    bad = np.zeros((9, 70), bool)
    spoils = [(P, np.nan), (P, np.inf), (P, -np.inf), (N, np.nan), (N, np.inf), (N, 0), (P, 0), (P, 3e38), (N, 3e38)]
    for row, (what, value) in enumerate(spoils):
        what[row, 5 + row] = value
        what[row, 69, 1] = np.nan
        bad[row, [5 + row, 69]] = True
    for name, layer in environment_layers(P, N, albedo, light, made).items():
        assert (layer[bad] == 0).all(), name
        assert np.array_equal(layer[~bad], whole[name][~bad]), name
    albedo[0, 0, 1], albedo[3, 69], albedo[8, 8] = np.nan, np.inf, -np.inf
    layer = environment_layers(P, N, albedo, light, made)["env_diffuse"]
    assert np.isfinite(layer).all()
    assert layer[0, 0, 1] == 0
    assert layer[0, 0, 0] == whole["env_diffuse"][0, 0, 0]


def test_the_same_bits_whatever_the_number_of_threads_and_wherever_a_row_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    P, N, albedo = scene(10, 61, 90)
    light = Environment(studio(32))
    made = dataclasses.replace(ALL, roughness=0.3, matte="m")
    results = []
    for count in (1, 2, 5):
        monkeypatch.setattr(rows.numba, "get_num_threads", lambda count=count: count)
        results.append(environment_layers(P, N, albedo, light, made, mattes={"m": albedo[..., 0] / 2}))
    window = (slice(13, 50), slice(13, 57))
    cut = environment_layers(P[window], N[window], albedo[window], light, made, mattes={"m": albedo[window][..., 0] / 2})
    for name, layer in results[0].items():
        assert all(np.array_equal(layer, other[name]) for other in results[1:])
        assert np.array_equal(layer[window], cut[name])


def test_wide_rows_go_through_in_strips() -> None:
    P, N, albedo = scene(11, 2, engine.STRIP + 77)
    light = Environment(studio(32))
    whole = environment_layers(P, N, albedo, light, ALL)
    for part in (slice(0, engine.STRIP), slice(engine.STRIP, None)):
        for name, layer in environment_layers(P[:, part], N[:, part], albedo[:, part], light, ALL).items():
            assert np.array_equal(layer, whole[name][:, part])


def test_two_callers_at_once() -> None:
    P, N, albedo = scene(11, 100, 100)
    light = Environment(studio(32))
    want = environment_layers(P, N, albedo, light, ALL)
    fresh = Environment(studio(32))
    wrong: list[int] = []

    def call() -> None:
        for k in range(5):
            found = environment_layers(P, N, albedo, fresh, ALL)
            if not all(np.array_equal(found[name], layer) for name, layer in want.items()):
                wrong.append(k)

    callers = [threading.Thread(target=call) for _ in range(3)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert not wrong


def test_the_cached_kernels_are_those_of_todays_files() -> None:
    """numba hashes a kernel's own file only: with another of these files the disk cache would go on with the old mathematics."""
    held = (
        (fastmath, "FASTMATH", environment_rows), (environment_vector, "VECTOR4", environment_rows), (environment_rows, "LEAVES", engine),
    )  # fmt: skip
    for module, name, holder in held:
        found = hashlib.sha256(Path(module.__file__).read_text(encoding="utf-8").encode()).hexdigest()[:16]
        assert found == getattr(holder, name), f'{module.__name__} has changed: set {name} = "{found}" in {holder.__name__}'


# ---- refusals


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"fil": "a.exr"}, ["environment", "'fil'", "did you mean 'file'"]),
        ({"kind": "latlon"}, ["kind 'latlon'", "did you mean 'latlong'"]),
        ({"ior": 0}, ["ior", "0.1 ... 10", "glass 1.5"]),
        ({"roughness": 1.5}, ["roughness", "0 ... 1"]),
        ({"rotation_deg": 90}, ["rotation_deg", "yaw, pitch, roll"]),
        ({"rotation_deg": [0, 0, float("nan")]}, ["rotation_deg"]),
        ({"diffuse": -1}, ["diffuse"]),
        ({"tint": [1, -1, 1]}, ["tint"]),
        ({"exposure": 60}, ["exposure", "stops"]),
        ({"space": "object"}, ["space 'object'"]),
        ({"fresnel": 1}, ["fresnel", "true or false"]),
        ({"backdrop": "plates"}, ["did you mean 'plate'"]),
        ({"matte": "a b"}, ["matte"]),
        ({"find_circle": True}, ["latlong"]),
        ({"kind": "mirror_ball", "find_circle": True, "circle_px": [1, 2, 3]}, ["find_circle", "both"]),
        ({"file": ""}, ["file"]),
        ({"thickness_m": -1}, ["thickness_m"]),
        ({"bad_values": "ignore"}, ["bad_values"]),
    ],
)
def test_bad_settings_are_refused_in_one_line(table: dict[str, object], words: list[str]) -> None:
    with pytest.raises(ShotError) as error:
        environment_from_dict(table)
    assert all(word in str(error.value) for word in words), str(error.value)
    assert "\n" not in str(error.value)


def test_a_table_becomes_settings() -> None:
    made = environment_from_dict({"file": "a.exr", "rotation_deg": [90, 0, 0], "ior": 1.33, "tint": [1, 1, 0.5]})
    assert made == EnvironmentSettings(file="a.exr", rotation_deg=(90, 0, 0), ior=1.33, tint=(1, 1, 0.5))
    assert made.needs_map
    assert not EnvironmentSettings(diffuse=0, refraction=1, backdrop="plate").needs_map


def test_bad_input_is_refused_by_name() -> None:
    P, N, albedo = scene(12)
    light = even()
    with pytest.raises(PassError, match=r"N must have shape"):
        environment_layers(P, N[..., 0], albedo, light, ALL)
    with pytest.raises(PassError, match=r"P must have shape \(7, 19, 3\), got \(6, 19, 3\)"):
        environment_layers(P[:-1], N, albedo, light, ALL)
    with pytest.raises(ShotError, match="there is no map"):
        environment_layers(P, N, albedo, None, ALL)
    with pytest.raises(ShotError, match="needs the plate"):
        environment_layers(P, N, albedo, light, dataclasses.replace(ALL, backdrop="plate"))
    with pytest.raises(ShotError, match=r"matte 'skin' is missing.*did you mean 'skins'"):
        environment_layers(P, N, albedo, light, dataclasses.replace(ALL, matte="skin"), mattes={"skins": albedo[..., 0]})
    with pytest.raises(PassError, match=r"matte 'skin' must lie in 0 ... 1"):
        environment_layers(P, N, albedo, light, dataclasses.replace(ALL, matte="skin"), mattes={"skin": albedo[..., 0] * 255})
    with pytest.raises(PassError, match=r"\(H, 2H, 3\)"):
        Environment(np.ones((4, 4, 3), np.float32))
