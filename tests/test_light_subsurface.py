"""Scattering under the surface: the published profile on a slab, even light stays even, nothing crosses a depth edge, and off is off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import integrate

from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError
from stereorelight.light.diffusion import STUFFS, profile, profile_within, scatter_shape
from stereorelight.light.lights import PointLight
from stereorelight.light.materials import Material
from stereorelight.light.shade import light_layers
from stereorelight.light.subsurface import _through, scatter_layers, scattered, scatters
from stereorelight.shot.lighting import Lighting
from stereorelight.shot.schema import read_light_file
from stereorelight.surface.position import position_from_depth

SKIN = scatter_shape("skin", None) or (0.0, 0.0, 0.0)
FEW = 2e-6  # float32 sums of a few hundred weights


def slab(size: tuple[int, int] = (120, 90), *, fov_deg: float = 4.0, z_m: float = 1.0, tilt_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """P and N of a flat thing."""
    camera = Camera.from_fov(fov_deg, size)
    t = np.tan(np.radians(tilt_deg))
    Z = (z_m / (1 - camera.ray_grid()[..., 0].astype(float) * t)).astype(np.float32)
    P = position_from_depth(Z, camera)
    n = np.array([np.sin(np.radians(tilt_deg)), 0, np.cos(np.radians(tilt_deg))], np.float32)
    return P, np.broadcast_to(n, P.shape).copy()


@pytest.mark.parametrize("d", [0.1, 1.0, 7.3])
def test_the_profile_integrates_to_one_and_is_its_own_integral(d: float) -> None:
    total = integrate.quad(lambda r: 2 * np.pi * r * float(profile(r, d)), 0, 100 * d, limit=200)[0]
    assert total == pytest.approx(1, abs=1e-6)
    for r in (0.3 * d, d, 4 * d):
        assert integrate.quad(lambda s: 2 * np.pi * s * float(profile(s, d)), 0, r)[0] == pytest.approx(float(profile_within(r, d)), abs=1e-9)


def test_presets_are_the_measured_ones() -> None:
    """Mean free paths as the tables of renderers print them, from Jensen's coefficients; albedo orders red over blue in skin."""
    for name, path in (("skin", (3.67, 1.37, 0.68)), ("skin_light", (4.82, 1.69, 1.09)), ("marble", (8.51, 5.57, 3.95))):
        np.testing.assert_allclose(STUFFS[name].path_mm, path, rtol=0.006)
    assert SKIN[0] > 2 * SKIN[1] > 2 * SKIN[2] > 0
    np.testing.assert_allclose(scatter_shape("skin", 7.34), 2 * np.array(SKIN), rtol=0.01)
    assert scatter_shape(None, None) is None
    assert scatter_shape("skin", 0) is None
    assert scatter_shape(None, (0, 0, 0)) is None


@pytest.mark.parametrize(("tilt_deg", "within"), [(0.0, 0.01), (50.0, 0.05)])
def test_weights_sum_to_one_before_they_are_made_to(tilt_deg: float, within: float) -> None:
    """On a slab that is wide enough the sum over pixels is the profile's integral, near cells and far, for every channel."""
    P, N = slab(tilt_deg=tilt_deg)
    _, total = _through(np.ones_like(P), P, N, np.ones(P.shape[:2], np.float32), np.array([0.45, 0.2, 0.1]))
    assert np.abs(total[40:-40, 50:-50] - 1).max() < within


def test_a_spot_on_a_slab_falls_as_the_published_profile() -> None:
    """A lit disc of 2 mm on a slab of 0.35 mm pixels: what comes out at every distance against the convolution done by integration."""
    P, N = slab((150, 110), fov_deg=3.0)
    d = (1.6, 1.05, 0.7)
    # The disc keeps clear of symmetry: its centre is no pixel's.
    r = np.hypot(P[..., 0] - 0.0011, P[..., 1] + 0.0007) * 1000
    pixel = float(np.diff(P[55, :, 0]).mean()) * 1000
    lit = np.clip((2.0 - r) / pixel + 0.5, 0, 1).astype(np.float32)
    made, total = _through(np.repeat(lit[..., None], 3, axis=2), P, N, np.ones(P.shape[:2], np.float32), np.array(d))
    made *= total * (4 * np.pi / (lit.sum() * pixel**2))  # as the weights were, without regard to where the picture ends
    far = np.arange(0.05, 40, 0.1)
    phi = (np.arange(720) + 0.5) * np.pi / 720
    for channel, length in enumerate(d):
        truth = np.array([_from_disc(q, 2.0, length, phi) for q in far])
        expected, peak = np.interp(r, far, truth), truth.max()
        assert np.abs(made[..., channel] - expected).max() < 0.04 * peak  # on the rim, which pixels blur
        off = (np.abs(r - 2) > 0.7) & (expected > 3e-3 * peak)  # the last tail, of whole cells, is off by up to a quarter
        assert off.sum() > 1500
        assert np.abs(made[..., channel] - expected)[off].max() < 0.015 * peak
        ratio = made[..., channel][off] / expected[off]
        assert np.abs(np.median(ratio) - 1) < 0.03
        assert np.abs(np.average(ratio, weights=expected[off]) - 1) < 0.01
        assert np.percentile(np.abs(ratio - 1), 95) < 0.08


def _from_disc(q: float, radius: float, d: float, phi: np.ndarray) -> float:
    """At q from a disc's centre, in polar coordinates about the point: R(s) s ds dphi, whose integral is known."""
    inside = radius**2 - (q * np.sin(phi)) ** 2
    half = np.sqrt(np.maximum(inside, 0))
    near, away = np.maximum(q * np.cos(phi) - half, 0), np.maximum(q * np.cos(phi) + half, 0)
    share = np.where(inside > 0, profile_within(away, d) - profile_within(near, d), 0)
    return float(share.mean())


def test_even_light_stays_even_whatever_the_surface() -> None:
    rng = np.random.default_rng(1)
    P, N = slab((60, 40), tilt_deg=30.0)
    P = P * (1 + 0.002 * rng.standard_normal(P.shape[:2])[..., None]).astype(np.float32)
    P[:, 25:] *= 1.3
    P[5:9, 10:20] = np.nan
    share = rng.random(P.shape[:2]).astype(np.float32)
    share[20:25] = 0
    light = np.broadcast_to(np.array([0.3, 2.0, 5.0], np.float32), P.shape).copy()
    for given in (None, share):
        np.testing.assert_allclose(scattered(light, P, N, SKIN, share=given), light, rtol=FEW)


def test_nothing_crosses_a_depth_edge() -> None:
    """A lit card 8 mm before a dark one, nearer than light spreads: not a trace goes over; without the step it does."""
    P, N = slab((80, 60))
    light = np.zeros_like(P)
    light[:, :40] = 1
    step = P.copy()
    step[:, 40:] *= 1.008
    made = scattered(light, step, N, (3.0, 3.0, 3.0))
    assert (made[:, 40:] == 0).all()
    np.testing.assert_allclose(made[:, :40], 1, rtol=FEW)
    assert (scattered(light, P, N, (3.0, 3.0, 3.0))[:, 40:44] > 0.15).all()


def test_an_edge_that_ends_is_not_gone_round_in_a_straight_line() -> None:
    """Behind a slit whose walls stand apart, light comes only by way of the surface."""
    P, N = slab((81, 61))
    P[10:50, 38:43] *= 0.9  # a bar that stands off the slab, 40 rows high
    light = np.zeros_like(P)
    light[28:33, 30:38] = 1
    made = scattered(light, P, N, (0.8, 0.8, 0.8))
    assert (made[28:33, 43:47] == 0).all()
    assert (made[28:33, 26:30] > 0.005).all()


def test_zero_is_off_bit_for_bit_and_channels_are_apart() -> None:
    P, N = slab((40, 30))
    light = np.random.default_rng(2).random(P.shape, dtype=np.float32)
    np.testing.assert_array_equal(scattered(light, P, N, (0, 0, 0)), light)
    made = scattered(light, P, N, (1.0, 0, 0))
    np.testing.assert_array_equal(made[..., 1:], light[..., 1:])
    assert np.abs(made[..., 0] - light[..., 0]).max() > 0.1
    both = scattered(np.stack([light, 2 * light]), P, N, SKIN)
    np.testing.assert_allclose(both[1], 2 * both[0], rtol=FEW)


def test_a_scene_twice_as_large_scatters_half_as_wide() -> None:
    P, N = slab((60, 40))
    light = np.random.default_rng(3).random(P.shape, dtype=np.float32)
    near = scattered(light, P, N, (1.0, 0.5, 0.2))
    np.testing.assert_allclose(scattered(light, 2 * P, N, (2.0, 1.0, 0.4)), near, rtol=2e-5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda P, N: profile(1.0, -1.0), "above 0, got -1.0"),
        (lambda P, N: profile_within(1.0, 0.0), "above 0"),
        (lambda P, N: scattered(P, P, N, (1, -1, 1)), "at least 0 mm"),
        (lambda P, N: scattered(P, P, N, (1, float("nan"), 1)), "at least 0 mm"),
        (lambda P, N: PointLight(name="a", position_m=(0, 0, 0), scatter="skn"), "did you mean 'skin'"),
        (lambda P, N: PointLight(name="a", position_m=(0, 0, 0), scatter_mm=-2), "light 'a': scatter_mm must be a length"),
        (lambda P, N: Material(name="m", matte="f", scatter_mm=(1.0, 2.0)), "material 'm': scatter_mm must be a length"),
    ],
)
def test_what_cannot_be_is_told(make: object, words: str) -> None:
    P, N = slab((8, 6))
    with pytest.raises(ShotError, match=words):
        make(P, N)  # type: ignore[operator]


def test_arrays_that_do_not_fit_are_told() -> None:
    P, N = slab((8, 6))
    with pytest.raises(PassError, match="irradiance must be"):
        scattered(np.ones((5, 8, 3), np.float32), P, N, SKIN)
    with pytest.raises(PassError, match=r"share must lie in 0 \.\.\. 1"):
        scattered(P, P, N, SKIN, share=np.full(P.shape[:2], 2.0))
    nowhere = np.full_like(P, np.nan)
    light = np.ones_like(P)
    np.testing.assert_array_equal(scattered(light, nowhere, N, SKIN), light)


def test_materials_scatter_in_their_matte_and_lights_elsewhere() -> None:
    P, N = slab((60, 40))
    matte = np.zeros(P.shape[:2], np.float32)
    matte[:, :30] = 1
    lamp = PointLight(name="lamp", position_m=(0, 0, -0.9))
    skin = Material(name="skin", matte="face", scatter="skin")
    assert not scatters(lamp)
    assert scatters(lamp, [skin])
    layers = {"light_lamp_diffuse": np.random.default_rng(4).random(P.shape, dtype=np.float32), "light_lamp_specular": np.ones_like(P)}
    made = scatter_layers(layers, P, N, [lamp], materials=[skin], mattes={"face": matte})
    np.testing.assert_array_equal(made["light_lamp_specular"], layers["light_lamp_specular"])
    np.testing.assert_array_equal(made["light_lamp_diffuse"][:, 30:], layers["light_lamp_diffuse"][:, 30:])
    np.testing.assert_allclose(made["light_lamp_diffuse"][:, :30], scattered(layers["light_lamp_diffuse"], P, N, SKIN, share=matte)[:, :30], rtol=FEW)


LAMP = '[[lights]]\nname = "lamp"\ntype = "point"\nposition_m = [0.02, 0, -0.95]\n'


def lit(folder: Path, text: str, plate: np.ndarray, P: np.ndarray, N: np.ndarray) -> dict[str, np.ndarray]:
    (folder / "lights.toml").write_text(text)
    made = Lighting(setup=read_light_file(folder / "lights.toml")).lit(None, plate=plate, passes={"P": P, "N": N}, camera=None)
    return made.layers


def test_a_light_file_scatters_light_and_not_texture(tmp_path: Path) -> None:
    P, N = slab((60, 40))
    plate = np.random.default_rng(5).random(P.shape, dtype=np.float32) + 0.1
    hard = lit(tmp_path, LAMP, plate, P, N)["light_lamp_diffuse"]
    off = lit(tmp_path, LAMP + 'scatter = "skin"\nscatter_mm = 0\n', plate, P, N)["light_lamp_diffuse"]
    np.testing.assert_array_equal(off, hard)
    soft = lit(tmp_path, LAMP + 'scatter = "skin"\n', plate, P, N)["light_lamp_diffuse"]
    white = light_layers(P, N, np.ones_like(plate), [PointLight(name="lamp", position_m=(0.02, 0, -0.95))])["light_lamp_diffuse"]
    np.testing.assert_allclose(soft, scattered(white, P, N, SKIN) * plate, rtol=1e-5)
    solo = lit(tmp_path, LAMP + 'scatter = "skin"\n' + LAMP.replace('"lamp"', '"sun"') + "solo = true\n", plate, P, N)
    assert list(solo) == ["light_sun_diffuse"]
