"""The light that is already there: its direction, the albedo under it, a person moved into another light, and plates that tell nothing."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy import ndimage

from stereorelight.errors import PassError, ShotError
from stereorelight.light.albedo import albedo_of, exposure_of
from stereorelight.light.estimate import estimate_lighting
from stereorelight.light.plate_lighting import PlateLighting
from stereorelight.shot.depths import surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.shot.plate_light import Reference, divided, estimated, shadow_of
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from tests.plate_lit import AMBIENT, bust_under, random_albedo, towards_key

EXACT_DEG, RECOVERED_DEG = 10.0, 15.0
EXACT_RMS, RECOVERED_RMS = 0.15, 0.25
LEVEL = 0.36


def off_deg(light: PlateLighting, name: str) -> float:
    assert light.told, light.words
    return float(np.degrees(np.arccos(np.clip(np.dot(towards_key(name, light.centre_m), light.towards), -1, 1))))


@lru_cache(maxsize=4)
def recovered(name: str) -> Reference:
    """The bust's passes from its two plates."""
    lit = bust_under(name, 480)
    depth = recover(lit.frame["plate"], lit.right, rectification(lit.rig)).frame
    surface = surface_of(depth, noise_per_m=MATCH_NOISE_PX / (lit.rig.left.fx * lit.rig.baseline_m))
    more = {key: depth[key] for key in ("confidence", "flags", "Z_sigma")}
    return Reference(number=None, plate=lit.frame["plate"], passes={**surface, **more}, camera=lit.rig.left)


def exact(name: str, plate: np.ndarray | None = None) -> Reference:
    lit = bust_under(name)
    return Reference(number=None, plate=lit.frame["plate"] if plate is None else plate, passes=lit.frame, camera=lit.rig.left)


@lru_cache(maxsize=4)
def told(name: str) -> PlateLighting:
    """The light of the bust's own plate, by its subject."""
    return estimated(exact(name), matte=bust_under(name).subject.astype(np.float32), albedo_level=LEVEL)


@pytest.mark.parametrize(("name", "seed"), [("lamp", 1), ("right", 2)])
def test_direction_of_plates_with_random_albedo_exact_normals(name: str, seed: int) -> None:
    lit = bust_under(name)
    plate = lit.E * random_albedo(lit.subject.shape, seed)
    light = estimated(exact(name, plate), matte=lit.subject.astype(np.float32), albedo_level=0.36)
    assert off_deg(light, name) < EXACT_DEG
    assert light.sigma_deg < 30


@pytest.mark.parametrize("name", ["lamp"])
def test_direction_with_recovered_normals(name: str) -> None:
    lit = bust_under(name, 480)
    seen = recovered(name)
    for plate in (seen.plate, lit.E * random_albedo(lit.subject.shape, 3)):
        frame = Reference(number=None, plate=plate, passes=seen.passes, camera=seen.camera)
        light = estimated(frame, matte=lit.subject.astype(np.float32), albedo_level=0.36)
        assert off_deg(light, name) < RECOVERED_DEG


def test_clipping_grain_and_highlights_do_not_turn_the_light() -> None:
    """A fifth of the subject clipped, 3 % grain, and a gloss of 0.4 on everything."""
    lit = bust_under("right")
    rng = np.random.default_rng(5)
    plate = lit.E * random_albedo(lit.subject.shape, 6) + 6 * lit.shine
    plate = np.minimum(plate, np.percentile(plate[lit.subject], 80)) * (1 + 0.03 * rng.standard_normal(plate.shape).astype(np.float32))
    light = estimated(exact("right", np.minimum(plate, plate.max() * 0.9)), matte=lit.subject.astype(np.float32), albedo_level=LEVEL)
    assert off_deg(light, "right") < EXACT_DEG


def moved_error(seen: Reference, a: str, b: str, width: int) -> float:
    """Relative RMS over the subject of the plate under `a`, divided and put under `b`, against the render under `b`; no blur, no fitted scale.

    Its median albedo is told: a plate cannot say it."""
    before, after = bust_under(a, width), bust_under(b, width)
    level = float(np.median(before.frame["albedo"].mean(axis=-1)[before.subject]))
    light = estimated(seen, matte=before.subject.astype(np.float32), albedo_level=level)
    albedo = divided(light, seen.plate, seen.passes, seen.camera, most_gain=8.0)
    made = albedo * after.E + after.shine
    inside = ndimage.binary_erosion(before.subject, iterations=2) & np.isfinite(made).all(axis=-1)
    assert inside.sum() > 0.9 * before.subject.sum()
    truth = after.frame["plate"]
    untouched = float(np.sqrt(((seen.plate - truth)[inside] ** 2).mean() / (truth[inside] ** 2).mean()))
    error = float(np.sqrt(((made - truth)[inside] ** 2).mean() / (truth[inside] ** 2).mean()))
    assert error < 0.6 * untouched
    return error


@pytest.mark.parametrize(("a", "b"), [("lamp", "right"), ("right", "lamp")])
def test_moved_into_another_light_exact_normals(a: str, b: str) -> None:
    assert moved_error(exact(a), a, b, 320) < EXACT_RMS


@pytest.mark.parametrize(("a", "b"), [("lamp", "right")])
def test_moved_into_another_light_recovered_normals(a: str, b: str) -> None:
    assert moved_error(recovered(a), a, b, 480) < RECOVERED_RMS


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_a_plate_without_shading_is_said_to_have_none(seed: int | None) -> None:
    """The bust's own plate, and two of random albedo."""
    lit = bust_under("even")
    plate = lit.frame["plate"] if seed is None else 0.6 * random_albedo(lit.subject.shape, seed)
    light = estimated(exact("even", plate), matte=lit.subject.astype(np.float32), albedo_level=0.4)
    assert not light.told
    assert light.towards is None
    assert "none told" in light.words
    even = albedo_of(plate, light, lit.frame["N"], lit.frame["P"])
    np.testing.assert_allclose(even * light.level, plate, rtol=1e-5)


def test_a_flat_wall_tells_nothing_and_neither_does_a_black_or_empty_plate() -> None:
    N = np.zeros((60, 80, 3), np.float32)
    N[..., 2] = 1
    plate = random_albedo((60, 80), 4, patches=60)
    for picture in (plate, np.zeros_like(plate), np.full_like(plate, np.nan)):
        light = estimate_lighting(picture, N)
        assert not light.told
        assert np.isfinite(light.level)
        assert light.level > 0
    assert not estimate_lighting(plate, np.full_like(N, np.nan)).told


def test_strength_and_tint_of_the_light_scale_and_nothing_else() -> None:
    """A plate twice as bright has light twice as strong, from the same side; albedo is the same."""
    lit = bust_under("right")
    weight = lit.subject.astype(np.float32)
    once = estimate_lighting(lit.frame["plate"], lit.frame["N"], weight=weight, model="harmonics")
    twice = estimate_lighting(2 * lit.frame["plate"], lit.frame["N"], weight=weight, model="harmonics")
    np.testing.assert_allclose(twice.towards, once.towards, atol=1e-4)
    np.testing.assert_allclose(twice.around, 2 * once.around, rtol=1e-3, atol=1e-4)
    assert twice.level == pytest.approx(2 * once.level, rel=1e-3)


def test_light_moved_with_the_camera_lights_the_same() -> None:
    light = told("lamp")
    a, b = np.radians(40), np.radians(-25)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, (0.3, -0.2, 1.0)
    N, P = bust_under("lamp").frame["N"].astype(float), bust_under("lamp").frame["P"].astype(float)
    there = light.moved(pose).irradiance(N @ R.T, P @ R.T + pose[:3, 3])
    np.testing.assert_allclose(there, light.irradiance(N, P), rtol=1e-4, atol=1e-5)
    back = light.moved(pose).moved(np.linalg.inv(pose))
    np.testing.assert_allclose(back.towards, light.towards, atol=1e-9)


def test_the_ball_and_the_map_show_the_light() -> None:
    light = told("right")
    ball = light.ball(65)
    assert (ball[0, 0] == 0).all()
    brightest = np.unravel_index(ball.mean(axis=-1).argmax(), (65, 65))
    at = np.array([brightest[1] - 32, 32 - brightest[0]]) / 32.5
    np.testing.assert_allclose(at, np.array(light.towards)[:2], atol=0.15)
    assert light.latlong(16).shape == (16, 32, 3)
    assert "deg to the right" in light.words


def test_gain_is_bounded_and_unknown_normals_take_what_is_around() -> None:
    lit = bust_under("right")
    light = told("right")
    plate = lit.frame["plate"]
    for gain in (1.0, 2.0, 8.0):
        albedo = albedo_of(plate, light, lit.frame["N"], lit.frame["P"], most_gain=gain)
        assert (albedo <= plate / light.level * gain * (1 + 1e-4)).all()
    hole = lit.frame["N"].copy()
    hole[80:100, 120:160] = np.nan
    albedo = albedo_of(plate, light, hole, lit.frame["P"])
    assert np.isfinite(albedo).all()
    broken = plate.copy()
    broken[10, 20] = np.nan
    albedo = albedo_of(broken, light, lit.frame["N"], lit.frame["P"])
    assert np.isnan(albedo[10, 20]).all()
    assert np.isfinite(albedo).sum() == albedo.size - 3


def test_exposure_puts_a_light_of_one_into_the_plates_range() -> None:
    lit = bust_under("right")
    assert exposure_of(lit.frame["plate"], lit.frame["plate"]) == 1.0
    dim = np.float32(0.03) * lit.frame["plate"]
    level = exposure_of(dim, lit.frame["albedo"], lit.subject.astype(np.float32))
    facing = float(np.percentile(lit.E.mean(axis=-1)[lit.subject], 90))
    assert level == pytest.approx(0.03 * facing, rel=0.1)
    with pytest.raises(ShotError, match="no pixel has both"):
        exposure_of(dim, np.zeros_like(dim))


def test_settings_and_arrays_that_cannot_be_are_told() -> None:
    lit = bust_under("right")
    plate, N = lit.frame["plate"], lit.frame["N"]
    with pytest.raises(ShotError, match="did you mean 'harmonics'"):
        estimate_lighting(plate, N, model="harmonic")  # type: ignore[arg-type]
    with pytest.raises(ShotError, match="albedo_level must be a number"):
        estimate_lighting(plate, N, albedo_level=0)
    with pytest.raises(ShotError, match="weight must be at least 0"):
        estimate_lighting(plate, N, weight=-np.ones(plate.shape[:2]))
    with pytest.raises(PassError, match="N"):
        estimate_lighting(plate, N[:-1])
    with pytest.raises(ShotError, match="albedo_gain"):
        albedo_of(plate, estimate_lighting(plate * 0, N), N, most_gain=0.5)


def test_shadows_of_the_plates_lamp_come_from_its_depth() -> None:
    lit = bust_under("right")
    arrives = shadow_of(lit.frame["Z"], lit.frame["N"], lit.rig.left)(tuple(towards_key("right", (0, 0, 0))), None)
    truth = lit.frame["matte_lit_k"]
    facing = lit.subject & (lit.frame["light_k_diffuse"].mean(axis=-1) > 0)
    assert (np.abs(arrives - truth)[facing] < 0.5).mean() > 0.93
    assert AMBIENT < 0.2
