"""Maps in and painted light: probes and chrome balls become the lat-long they came from; what no map is gets refused; matcap and toon."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.errors import PassError, ShotError
from stereorelight.light.environment import Environment, environment_for
from stereorelight.light.environment_ball import find_ball
from stereorelight.light.environment_maps import angular_place, ball_place, cleaned, directions, latlong_from, latlong_place, solid_angles
from stereorelight.light.environment_settings import EnvironmentSettings
from stereorelight.light.matcap import lit_sphere, outline, toon
from stereorelight.light.skies import gradient, sky, studio
from tests.reference_environment import look

Array = np.ndarray
LIGHT = gradient(64, slope=(0.4, 0.3, -0.3)).astype(np.float64)


def probe_of(light: Array, size: int) -> Array:
    """Debevec's light probe, by his own formula: the angle off -z is pi times the radius."""
    u, v = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, 1 - (np.arange(size) + 0.5) / size * 2)
    r, theta = np.hypot(u, v), np.arctan2(v, u)
    phi = np.pi * np.minimum(r, 1)
    d = np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), -np.cos(phi)], axis=-1)
    return np.where(r[..., None] <= 1.02, look(light, d), np.nan).astype(np.float32)


def ball_of(light: Array, size: tuple[int, int], circle: tuple[float, float, float], angle_deg: float = 0.0, back: float = 0.05) -> Array:
    """A photograph of a chrome ball: rays of a pinhole (or parallel ones) traced to a sphere and mirrored."""
    x, y = np.meshgrid(np.arange(size[0], dtype=float), np.arange(size[1], dtype=float))
    u, v = (x - circle[0]) / circle[2], (circle[1] - y) / circle[2]
    hit = u * u + v * v < 1
    if angle_deg == 0:
        way = np.broadcast_to((0.0, 0.0, -1.0), (*u.shape, 3))
        N = np.stack([u, v, np.sqrt(np.maximum(1 - u * u - v * v, 0))], axis=-1)
    else:
        half = math.radians(angle_deg) / 2
        way = np.stack([u * math.tan(half), v * math.tan(half), -np.ones_like(u)], axis=-1)
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        eye = np.array([0, 0, 1 / math.sin(half)])
        b = way @ eye
        t = -b - np.sqrt(np.maximum(b * b - (eye @ eye - 1), 0))
        N = eye + t[..., None] * way
    R = way - 2 * (way * N).sum(-1, keepdims=True) * N
    return np.where(hit[..., None], look(light, R), back).astype(np.float32)


@given(d=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: math.hypot(*v) > 0.1))
@settings(max_examples=50, deadline=None)
def test_places_and_directions_agree(d: tuple[float, float, float]) -> None:
    unit = np.array(d) / np.linalg.norm(d)
    height = 4096
    column, row = np.rint(latlong_place(unit, height)).astype(int)
    azimuth, polar = (column % (2 * height) + 0.5) / height * math.pi - math.pi, (np.clip(row, 0, height - 1) + 0.5) / height * math.pi
    back = np.array([math.sin(polar) * math.sin(azimuth), math.cos(polar), -math.sin(polar) * math.cos(azimuth)])
    assert np.linalg.norm(back - unit) < 2e-3


def test_the_paper_with_its_axes_put_right() -> None:
    np.testing.assert_allclose(latlong_place([(0, 0, -1), (1, 0, 0), (-1, 0, 0)], 50), [(49.5, 24.5), (74.5, 24.5), (24.5, 24.5)], atol=1e-9)
    np.testing.assert_allclose(latlong_place([(0, 1, -1e-9), (0, -1, -1e-9)], 50)[:, 1], [-0.5, 49.5], atol=1e-6)
    np.testing.assert_allclose(angular_place([(0, 0, -1), (1, 0, 0), (0, 1, 0)], 100), [(49.5, 49.5), (74.5, 49.5), (49.5, 24.5)], atol=1e-9)
    circle = (49.5, 49.5, 50.0)
    r = math.sin(math.pi / 4) * 50
    np.testing.assert_allclose(ball_place([(0, 0, 1), (1, 0, 0), (0, 1, 0)], circle), [(49.5, 49.5), (49.5 + r, 49.5), (49.5, 49.5 - r)], atol=1e-9)
    assert solid_angles(16).sum() * 32 == pytest.approx(4 * math.pi)


def test_a_light_probe_becomes_its_map() -> None:
    made = latlong_from(probe_of(LIGHT, 400), kind="angular", height=64)
    off = np.abs(made - LIGHT)
    assert off.max() < 5e-3
    assert latlong_from(probe_of(LIGHT, 100), kind="angular").shape == (50, 100, 3)


@pytest.mark.parametrize(("angle_deg", "hidden"), [(0.0, 20.0), (8.0, 26.0), (30.0, 38.0)])
def test_a_chrome_ball_becomes_its_map(angle_deg: float, hidden: float) -> None:
    circle = (210.4, 190.7, 150.2)
    made = latlong_from(ball_of(LIGHT, (440, 400), circle, angle_deg), kind="mirror_ball", circle=circle, angle_deg=angle_deg, height=64)
    off_axis = np.degrees(np.arccos(-directions(64)[..., 2]))  # straight behind the ball nothing is seen but the rim
    assert np.abs(made - LIGHT)[off_axis > hidden].max() < 2e-3
    assert np.abs(made - LIGHT).max() < 0.3


@pytest.mark.parametrize("circle", [(210.4, 190.7, 150.2), (150.0, 240.5, 90.0), (300.3, 120.0, 60.5)])
@pytest.mark.parametrize("light", ["studio", "sky"])
def test_a_ball_is_found(circle: tuple[float, float, float], light: str) -> None:
    picture = ball_of({"studio": studio, "sky": sky}[light](64).astype(np.float64), (440, 400), circle)
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:400, 0:440]
    back = 0.12 + 0.05 * np.sin(x / 31 + y / 47) + rng.normal(0, 0.004, (400, 440))  # an uneven, grainy wall
    outside = np.hypot(x - circle[0], y - circle[1]) > circle[2]
    picture = np.where(outside[..., None], back[..., None], picture).astype(np.float32)
    found = find_ball(picture)
    assert math.dist(found[:2], circle[:2]) < 0.02 * circle[2]
    assert abs(found[2] - circle[2]) < 0.02 * circle[2]
    environment = Environment.from_picture(picture, kind="mirror_ball", find_circle=True, height=32)
    assert environment.latlong.shape == (32, 64, 3)


def test_no_ball_is_said() -> None:
    with pytest.raises(PassError, match="circle_px"):
        find_ball(np.full((80, 90, 3), 0.5, np.float32))
    rng = np.random.default_rng(1)
    with pytest.raises(PassError, match="circle_px"):
        find_ball(rng.uniform(0, 1, (100, 120, 3)).astype(np.float32))
    with pytest.raises(PassError, match="circle_px"):
        find_ball(np.ones((10, 10, 3), np.float32))


@pytest.mark.parametrize(
    ("shape", "options", "words"),
    [
        ((10, 10, 3), {}, "twice as wide as high; is it angular"),
        ((10, 20, 3), {"kind": "angular"}, "square"),
        ((10, 20, 3), {"kind": "mirror_ball"}, "circle"),
        ((0, 0, 3), {}, "empty"),
        ((10, 20), {}, "shape"),
        ((10, 20, 3), {"kind": "cube"}, "kind 'cube' is unknown"),
        ((40, 40, 3), {"kind": "mirror_ball", "circle": (20, 20, 30)}, "does not lie in the picture"),
        ((40, 40, 3), {"kind": "mirror_ball", "angle_deg": 180}, "angle_deg"),
        ((4, 40000, 3), {}, "scale it down"),
    ],
)
def test_what_is_no_map_is_refused(shape: tuple[int, ...], options: dict[str, object], words: str) -> None:
    with pytest.raises(PassError, match=words):
        latlong_from(np.ones(shape, np.float32), **options)  # type: ignore[arg-type]


def test_light_that_cannot_be_is_refused_or_clamped() -> None:
    good = np.ones((8, 16, 3), np.float32)
    for value, words in ((np.inf, "1 pixels are infinite"), (np.nan, "1 pixels are not numbers"), (-50.0, "1 pixels are negative")):
        bad = good.copy()
        bad[2, 3, 1] = value
        with pytest.raises(PassError, match=words):
            latlong_from(bad, name="studio.exr")
        made = latlong_from(bad, bad_values="clamp")
        assert np.isfinite(made).all()
        assert made[2, 3, 1] == (1 if value == np.inf else 0)
    ringing = good.copy()
    ringing[1, 1] = -0.01
    assert latlong_from(ringing)[1, 1].tolist() == [0, 0, 0]  # less than a hundredth of the light
    assert cleaned(good, "a") is good
    # Corners of a probe hold anything.
    assert np.isfinite(latlong_from(probe_of(LIGHT, 64), kind="angular")).all()


def test_odd_sizes_are_made_even() -> None:
    assert latlong_from(np.ones((100, 201, 3), np.float32)).shape == (100, 200, 3)
    np.testing.assert_allclose(latlong_from(gradient(128, slope=(0.3, 0.2, 0.1)), height=32), gradient(32, slope=(0.3, 0.2, 0.1)), atol=2e-3)


def test_settings_make_the_environment() -> None:
    made = EnvironmentSettings(file="probe.exr", kind="angular", bad_values="clamp")
    assert np.array_equal(environment_for(made, probe_of(LIGHT, 64)).latlong, latlong_from(probe_of(LIGHT, 64), kind="angular"))
    with pytest.raises(PassError, match=r"probe\.exr: is 64x32"):
        environment_for(made, np.ones((32, 64, 3), np.float32))


def test_the_environment_is_seen_where_it_stands() -> None:
    light = Environment(gradient(64, slope=(0.3, 0.2, -0.4)))
    np.testing.assert_allclose(light.seen((0, 0, -5.0))[0], 1.4, atol=2e-3)
    np.testing.assert_allclose(light.seen((1.0, 0, 0), rotation_deg=(90, 0, 0))[0], 1.4, atol=2e-3)  # what lay ahead went right


# ---- painted light


def painted(size: int = 64) -> Array:
    """Red tells right, green tells up."""
    x, y = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, 1 - (np.arange(size) + 0.5) / size * 2)
    return np.stack([x + 1, y + 1, 0 * x + 0.5], axis=-1).astype(np.float32)


def some_normals() -> tuple[Array, Array]:
    rng = np.random.default_rng(0)
    P = rng.uniform((-2, -2, -5), (2, 2, -1), (9, 11, 3)).astype(np.float32)
    N = rng.normal(size=P.shape) * 0.4 + (0, 0, 1)
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    N[..., 2] = np.abs(N[..., 2])
    return P, N.astype(np.float32)


def test_a_lit_sphere_is_looked_up_along_the_normal() -> None:
    P, N = some_normals()
    N[0, 0], N[1, 1] = np.nan, 0
    inside = np.hypot(N[..., 0], N[..., 1]) < 0.97
    got = lit_sphere(N, painted())
    np.testing.assert_allclose(got[inside & (N[..., 2] > 0)][:, :2], 1 + N[inside & (N[..., 2] > 0)][:, :2], atol=1e-5)
    assert (got[[0, 1], [0, 1]] == 0).all()
    # Facing the eye is the middle of the sphere, wherever in the frame.
    V = -P / np.linalg.norm(P, axis=-1, keepdims=True)
    np.testing.assert_allclose(lit_sphere(V, painted(), P=P, facing="ray"), np.broadcast_to((1, 1, 0.5), P.shape), atol=1e-5)
    P[2, 2] = np.nan
    assert (lit_sphere(V, painted(), P=P, facing="ray")[2, 2] == 0).all()
    away = np.array([[[0.6, 0, -0.8]]], np.float32)
    assert lit_sphere(away, painted())[0, 0, 0] > 1.98  # from the rim
    with pytest.raises(PassError, match="needs P"):
        lit_sphere(N, painted(), facing="ray")
    with pytest.raises(ShotError, match="facing"):
        lit_sphere(N, painted(), facing="eye")  # type: ignore[arg-type]
    with pytest.raises(PassError, match="sphere holds"):
        lit_sphere(N, np.full((4, 4, 3), np.nan, np.float32))


def test_toon_has_flat_tones() -> None:
    shading = np.array([[0.0, 0.2, 0.5, 2.0, np.nan]], np.float32)
    np.testing.assert_allclose(toon(shading)[0, :, 0], [0.08, 0.35, 0.7, 1.0, 0], atol=1e-6)
    np.testing.assert_allclose(toon(np.repeat(shading[..., None], 3, axis=2), softness=0), toon(shading, softness=0))
    np.testing.assert_allclose(toon(shading, steps=[0.3], colours=[(0, 0, 1), (1, 0, 0)], softness=0)[0, :2], [(0, 0, 1), (0, 0, 1)])
    ramp = toon(np.linspace(0, 1, 300, dtype=np.float32)[None])[0, :, 0]
    assert (np.diff(ramp) >= -1e-6).all()
    for bad in ({"steps": [0.5, 0.2], "colours": [0, 1, 2]}, {"steps": [0.5]}, {"steps": [0.5], "colours": [0, -1]}, {"softness": -1}):
        with pytest.raises(ShotError, match="toon"):
            toon(shading, **bad)  # type: ignore[arg-type]


def test_an_outline_is_where_the_surface_turns_away() -> None:
    P = np.array([[(0, 0, -2), (0, 0, -2), (0, 0, -2)]], np.float32)
    N = np.array([[(0, 0, 1), (1, 0, 0), (np.nan, 0, 1)]], np.float32)
    assert outline(P, N)[0].tolist() == [0, 1, 0]


def test_ink_goes_round_what_stands_before_and_not_over_a_slanted_floor() -> None:
    """A card at 1 m before a wall at 2 m, and a floor at a grazing angle: ink on the card's own rim, none on wall and floor."""
    from stereorelight.camera import Camera

    camera = Camera.from_fov(50, (48, 40))
    d = camera.rays(camera.pixel_grid().reshape(-1, 2)).reshape(40, 48, 3) * (1, -1, -1)
    floor = np.array([0, 1.0, 0])
    t = np.minimum(2.0, np.where(d[..., 1] < 0, -0.5 / np.minimum(d[..., 1], -1e-9), np.inf))
    N = np.where((t < 2)[..., None], floor, (0, 0, 1.0))
    t[8:20, 10:30], N[8:20, 10:30] = 1.0, (0, 0, 1)
    P = (t[..., None] * d).astype(np.float32)
    line = outline(P, N, width=0.0, softness=0.0, jump=0.1)
    card = np.zeros((40, 48), bool)
    card[8:20, 10:30] = True
    rim = card.copy()
    rim[9:19, 11:29] = False
    assert (line[rim] > 0.99).all()
    assert (line[10:18, 12:28] == 0).all()
    assert (line[~card] == 0).all()
    assert (outline(P, N, width=0.0, softness=0.0) == 0).all()
    P[0, 0] = np.nan
    assert np.isfinite(outline(P, N, jump=0.1)).all()
