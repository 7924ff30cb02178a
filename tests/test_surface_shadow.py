"""Shadows of the seen surface against ray-traced truth, and against what geometry says."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import cv2
import numba
import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.engine import raycast
from stereorelight.errors import PassError, ShotError
from stereorelight.footage.curves import decode, encode
from stereorelight.shot.depths import surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.surface.emitters import Emitter, across, on_disc, spread
from stereorelight.surface.mesh import Links
from stereorelight.surface.occlusion import ambient_occlusion
from stereorelight.surface.visibility import ShadowScene
from stereorelight.synth.lights import Light
from stereorelight.synth.render import FLIP, render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scene import Tables
from stereorelight.synth.scenes import scene_named

SIZE = (480, 270)
SELF_M = 2e-6  # a ray that ends on a surface must not find that surface
KEY = Light(name="key", position_m=(-0.8, 0.9, 0.2))


@cache
def exact_surface(name: str, size: tuple[int, int]) -> tuple[Tables, np.ndarray, np.ndarray, ShadowScene]:
    """A scene's tables, the points and normals that a camera's pixels meet, (n, 3), and the exact surface; whatever the light."""
    camera = Camera.from_fov(40, size)
    tables = scene_named(name).tables()
    ways = camera.rays(camera.pixel_grid().reshape(-1, 2)) @ FLIP
    t, hit = raycast.first_hits(tables.objects, tables.primitives, np.zeros((1, 3)), ways, empty=tables.empty)
    points = t[:, None] * ways
    normals = raycast.surface_at(tables.objects, tables.primitives, tables.materials, points, hit)[0]
    shape = camera.size_hw
    Z = t.reshape(shape).astype(np.float32)
    scene = ShadowScene(Z=Z, N=normals.reshape(*shape, 3).astype(np.float32), camera=camera, open=np.isnan(Z))
    return tables, points, normals, scene


@cache
def truth(name: str, light: Light, size: tuple[int, int] = SIZE) -> tuple[ShadowScene, np.ndarray, np.ndarray]:
    """The exact surface, which of its pixels face the light, and which of those it reaches past the whole scene."""
    tables, points, normals, scene = exact_surface(name, size)
    starts = np.broadcast_to(light.ray_starts(points), points.shape)
    along = points - starts
    with np.errstate(invalid="ignore"):
        facing = (normals * along).sum(axis=-1) < 0
        limits = np.where(facing, 1 - SELF_M / np.linalg.norm(along, axis=-1), 0)
    lit = facing & ~raycast.blocked(tables.objects, tables.primitives, starts, along, limits, empty=tables.empty)
    shape = scene.camera.size_hw
    return scene, facing.reshape(shape), lit.reshape(shape)


def emitter(light: Light) -> Emitter:
    if light.type == "directional":
        x, y, z = -light.shines_to
        return Emitter(name=light.name, shape="direction", towards=(x, y, z))
    return Emitter(name=light.name, shape="place", position_m=light.position_m)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


LIGHTS = {
    "sphere": KEY,
    "box": KEY,
    "bust": Light(name="side", position_m=(0.5, 0.2, -0.3)),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_exact_depth_casts_the_traced_shadow(name: str) -> None:
    scene, facing, lit = truth(name, LIGHTS[name])
    found = scene.shadow(emitter(LIGHTS[name]), method="rays")
    known = facing & (found.unknown < 0.5)
    assert known.sum() > 0.3 * facing.sum()
    assert iou(~lit[known], found.lit[known] < 0.5) >= 0.97


@pytest.mark.slow
def test_matched_depth_casts_the_traced_shadow() -> None:
    """The bust from two 8-bit plates at 960 x 540, lamps from in front, raking along the face, and from straight above.

    Over all that faces the lamp in truth and the camera can know; a found normal that has turned away is no shadow."""
    size = (960, 540)
    rig = parallel_rig(size)
    shot = render(scene_named("bust"), rig, samples=2, shadows=False)  # what is matched has no need of them
    plates = [decode(np.rint(255 * encode(shot.frame(eye)["plate"], "sRGB")) / 255, "sRGB").astype(np.float32) for eye in ("left", "right")]
    depth = recover(*plates, rectification(rig)).frame
    surface = surface_of(depth, noise_per_m=MATCH_NOISE_PX / (rig.left.fx * rig.baseline_m))
    scene = ShadowScene(Z=surface["Z"], N=surface["N"], camera=rig.left, Z_sigma=depth["Z_sigma"])
    for place in ((-0.8, 0.9, 0.2), (0.5, 0.2, -0.3), (0.9, 0.15, -1.25), (-0.7, 0.1, -1.3), (0.0, 1.2, -1.2)):
        lamp = Light(name="lamp", position_m=place)
        _, facing, lit = truth("bust", lamp, size)
        found = scene.shadow(emitter(lamp))
        known = facing & (found.unknown < 0.5)
        assert known.sum() > 0.15 * facing.sum()
        assert iou(~lit[known], found.lit[known] < 0.5) >= 0.85, place


@pytest.mark.parametrize("method", ["march", "rays"])
def test_a_found_normal_that_has_turned_away_is_no_shadow(method: str) -> None:
    """N tells how much light a pixel takes, the surface what stops it: with normals that have turned 10 degrees away from the lamp, a shadow stays
    what it was. Exact normals are believed: there, what turns away is dark."""
    exact, facing, lit = truth("sphere", KEY)
    L = np.array(KEY.position_m, np.float32) - exact.P
    L /= np.linalg.norm(L, axis=-1, keepdims=True)
    N = exact.N - np.float32(np.tan(np.radians(10))) * L  # as a far terminator sees it: turned about the axis square to both
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    turned = facing & ((N * L).sum(axis=-1) < 0) & ((exact.N * L).sum(axis=-1) > 0.03)
    assert (turned & lit).sum() > 200
    sigma = np.full_like(exact.Z, 1e-5)
    found, believed = (ShadowScene(Z=exact.Z, N=N, camera=exact.camera, Z_sigma=s).shadow(emitter(KEY), method=method) for s in (sigma, None))  # type: ignore[arg-type]
    assert (believed.lit[turned] == 0).all()
    known = turned & (found.unknown < 0.5)
    assert ((found.lit > 0.5) == lit)[known].mean() > 0.95


def test_smooth_errors_of_depth_lift_no_ray() -> None:
    """Matched depth is off by whole places: a doubt of 5 mm that leaves the surface smooth costs a thin card none of its shadow."""
    on = (abs(U - 80) <= 15) & (abs(V - 45) <= 10)
    Z = np.where(on, np.float32(1.98), WALL)  # a card 2 cm before the wall
    links = Links(across=(on[:, 1:] == on[:, :-1]), down=(on[1:] == on[:-1]))
    wanted = shadowed(Z, links, None)
    assert wanted.sum() > 15
    assert (shadowed(Z, links, np.full_like(Z, 0.005)) & wanted).sum() > 0.9 * wanted.sum()


def shadowed(Z: np.ndarray, links: Links, sigma: np.ndarray | None) -> np.ndarray:
    scene = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, Z_sigma=sigma, outside_open=True)
    scene.__dict__["links"], scene.__dict__["casts"] = links, np.ones(Z.shape, bool)
    low = Emitter(name="low", shape="direction", towards=(0.98, 0.0, 0.199))
    return scene.shadow(low).lit < 0.5


@pytest.mark.parametrize("name", LIGHTS)
def test_march_and_rays_agree(name: str) -> None:
    scene, facing, _ = truth(name, LIGHTS[name])
    rays, marched = (scene.shadow(emitter(LIGHTS[name]), method=method) for method in ("rays", "march"))
    assert ((rays.lit > 0.5) == (marched.lit > 0.5))[facing].mean() >= 0.99


CAMERA = Camera.from_fov(40, (160, 90))
WALL = np.full(CAMERA.size_hw, 2.0, np.float32)
TO_CAMERA = np.broadcast_to(np.float32([0, 0, 1]), (*CAMERA.size_hw, 3))
V, U = np.mgrid[0:90, 0:160]
METHODS = ("march", "rays")


def card_scene(**more: object) -> tuple[ShadowScene, np.ndarray]:
    """A card of 31 x 21 pixels at 1.5 m before a wall at 2 m, and where it is."""
    on = (abs(U - 80) <= 15) & (abs(V - 45) <= 10)
    Z = np.where(on, np.float32(1.5), WALL)
    return ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, outside_open=True, **more), on  # type: ignore[arg-type]


SUN = Emitter(name="sun", shape="direction", towards=(0.6, 0.0, 0.8))


@pytest.mark.parametrize("method", METHODS)
def test_a_card_throws_its_shadow_where_geometry_says(method: str) -> None:
    """The sun stands to the right at 3:4, so the shadow lies 0.375 m to the left, and as much of it is seen as the card does not hide."""
    scene, on = card_scene()
    found = scene.shadow(SUN, method=method)
    left, right = ((80 + side - CAMERA.cx) / CAMERA.fx * 1.5 - 0.375 for side in (-15.5, 15.5))
    x, y = (U - CAMERA.cx) / CAMERA.fx * 2.0, (V - CAMERA.cy) / CAMERA.fy * 2.0
    low, high = ((45 + side - CAMERA.cy) / CAMERA.fy * 1.5 for side in (-10.5, 10.5))
    wanted = (x > left) & (x < right) & (y > low) & (y < high) & ~on
    assert iou(wanted, found.lit < 0.5) > 0.97
    assert (found.lit[on] == 1).all(), "nothing stands before the card"


@pytest.mark.parametrize("method", METHODS)
def test_what_lies_behind_the_card_is_unknown_until_it_has_a_thickness(method: str) -> None:
    thin, on = card_scene()
    thick, _ = card_scene(thickness_m=0.6)
    a, b = (scene.shadow(SUN, method=method) for scene in (thin, thick))
    behind = (a.unknown > 0.5) & (a.lit > 0.5)
    assert behind.sum() > 100, "rays that pass behind the card"
    assert not behind[on].any()
    assert (b.lit[behind] < 0.5).mean() > 0.95, "a thing 0.6 m deep reaches the wall and stops them"
    assert (b.unknown > 0.5).sum() < 0.05 * behind.sum()
    assert ((a.unknown <= a.lit) & (a.unknown >= 0)).all()


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_each_thing_is_as_thick_as_is_said_of_it(method: str, bent: bool) -> None:
    """Two cards, one above the other: the upper one reaches back to the wall, the lower one is a sheet."""
    upper, lower = ((abs(U - 80) <= 15) & (abs(V - v) <= 10) for v in (25, 65))
    Z = np.where(upper | lower, np.float32(1.5), WALL)
    camera = Camera(size=CAMERA.size, K=CAMERA.K, model="brown", distortion=(-0.02, 0, 0, 0)) if bent else CAMERA
    thick = np.where(upper, np.float32(0.6), np.float32(0))
    mixed, thin, solid_ = (
        ShadowScene(Z=Z, N=TO_CAMERA, camera=camera, outside_open=True, thickness_m=t).shadow(SUN, method=method)  # type: ignore[arg-type]
        for t in (thick, 0.0, 0.6)
    )
    behind = (thin.lit > 0.5) & (thin.unknown > 0.5) & (solid_.lit < 0.5)
    assert (mixed.lit < 0.5)[behind & (V < 40)].mean() > 0.97
    assert ((mixed.lit > 0.5) & (mixed.unknown > 0.5))[behind & (V > 50)].mean() > 0.97
    assert min((behind & (V < 40)).sum(), (behind & (V > 50)).sum()) > 50


@pytest.mark.parametrize("method", METHODS)
def test_a_ray_that_leaves_the_frame_among_things_is_unknown(method: str) -> None:
    on = (abs(U - 80) <= 15) & (abs(V - 45) <= 10)
    Z = np.where(on, np.float32(1.5), WALL)
    low = Emitter(name="low", shape="direction", towards=(0.995, 0.0, 0.0999))
    strict = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA).shadow(low, method=method)
    told_open = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, outside_open=True).shadow(low, method=method)
    assert strict.unknown[10, 150] == 1
    assert told_open.unknown[10, 150] == 0
    assert strict.lit[10, 150] == told_open.lit[10, 150] == 1


@pytest.mark.parametrize("method", METHODS)
def test_a_soft_edge_is_as_wide_as_geometry_says(method: str) -> None:
    """A sun of 20 degrees behind a card's edge 0.5 m before the wall: the light rises over the sun's width on the wall, by its disc's own area."""
    edge = U < 80
    Z = np.where(edge, np.float32(1.5), WALL)
    sun = Emitter(name="sun", shape="direction", towards=(-0.6, 0.0, 0.8), angle_deg=20.0)
    found = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, outside_open=True).shadow(sun, method=method, samples=64)
    x = (U[45] - CAMERA.cx) / CAMERA.fx * 2.0
    limit = (79.5 - CAMERA.cx) / CAMERA.fx * 1.5
    ways = np.random.default_rng(0).uniform(-1, 1, (20000, 2))
    ways = ways[(ways**2).sum(-1) < 1] * np.tan(np.radians(10))
    dirs = np.array([-0.6, 0, 0.8]) + ways[:, :1] * np.array([0.8, 0, 0.6]) + ways[:, 1:] * np.array([0.0, 1, 0])
    weight = np.maximum(dirs[:, 2], 0)
    seen = np.array([(weight * (at + 0.5 * dirs[:, 0] / dirs[:, 2] > limit)).sum() / weight.sum() for at in x])
    open_wall = (U[45] >= 80) & (U[45] < 155)
    assert np.abs(found.lit[45] - seen)[open_wall].mean() < 0.02
    assert np.abs(found.lit[45] - seen)[open_wall].max() < 0.12


def rugged(width: int = 331, slant: float = 0.0) -> ShadowScene:
    """A wavy wall, boxes far before it, a hole and an open corner; no whole number of blocks wide.  `slant`: metres farther away a pixel."""
    camera = Camera.from_fov(50, (width, 180))
    v, u = np.mgrid[0:180, 0:width].astype(np.float32)
    Z = 3 + slant * u + 0.2 * np.sin(u / 20) + 0.1 * np.cos(v / 15)
    Z = np.where((u % 80 < 9) & (v % 60 < 11), 1.2 + u / 400, Z)
    Z[130:140, 50:70] = Z[:20, :30] = np.nan
    N = np.broadcast_to(np.float32([0.8, 0, 0.6]), (180, width, 3))
    open_ = np.zeros(Z.shape, bool)
    open_[:20, :30] = True
    return ShadowScene(Z=Z, N=N, camera=camera, thickness_m=0.1, open=open_)


@pytest.mark.parametrize("steps", [9, 48, 512])
@pytest.mark.parametrize(
    "lamp",
    [
        Emitter(name="sun", shape="direction", towards=(0.6, 0.0, 0.8), angle_deg=4.0),
        Emitter(name="rake", shape="direction", towards=(0.95, 0.24, 0.2)),
        Emitter(name="from behind", shape="direction", towards=(0.7, 0.1, -0.7)),
        Emitter(name="ball", shape="ball", position_m=(0.5, 0.3, -0.5), radius_m=0.1),
        Emitter(name="point", shape="place", position_m=(1.0, 1.0, 0.0)),
    ],
)
def test_passing_over_looks_changes_no_bit(lamp: Emitter, steps: int) -> None:
    """The march passes over looks where all is in front of everything about: told that nothing is known of what is about, it takes them all."""
    dark = 0.0
    for make in (rugged, lambda: rugged(slant=0.03), lambda: card_scene()[0]):
        scene, slow = make(), make()
        slow.__dict__["grid"] = dataclasses.replace(slow.grid, tops=np.full_like(slow.grid.tops, 1e30))
        found, every = (s.shadow(lamp, method="march", samples=5, steps=steps) for s in (scene, slow))
        np.testing.assert_array_equal(found.lit, every.lit)
        np.testing.assert_array_equal(found.unknown, every.unknown)
        dark += float((found.lit < 0.5).mean())
    assert 0.02 < dark < 2.9


def test_march_gives_the_same_bits_on_any_number_of_threads() -> None:
    scene = rugged()
    before = numba.get_num_threads()
    try:
        found = []
        for count in (1, 2, 1):
            numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
            found.append(scene.shadow(SUN, method="march"))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(found[0].lit, found[1].lit)
    np.testing.assert_array_equal(found[0].unknown, found[2].unknown)


def test_soft_shadows_keep_their_pattern_and_know_no_frame() -> None:
    scene, _ = card_scene()
    lamp = Emitter(name="lamp", shape="rectangle", position_m=(0.5, 0.2, -0.5), towards=(0, 0, -1), side_u_m=(0.2, 0, 0), side_v_m=(0, 0.1, 0))
    for method in METHODS:
        one, two = (scene.shadow(lamp, method=method) for _ in range(2))  # type: ignore[arg-type]
        np.testing.assert_array_equal(one.lit, two.lit)
    march, rays = (scene.shadow(lamp, method=method).lit for method in ("march", "rays"))
    assert np.abs(march - rays).mean() < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_noise_that_sigma_tells_of_makes_no_acne(method: str) -> None:
    """A wall whose depth is off by 2 mm, and says so, in a raking light: it stays lit, and without sigma it does not."""
    rng = np.random.default_rng(0)
    noise = np.kron(rng.normal(0, 0.002, (45, 80)), np.ones((2, 2)))
    Z = (WALL + noise).astype(np.float32)
    raking = Emitter(name="rake", shape="direction", towards=(0.966, 0.0, 0.259))
    told = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, Z_sigma=np.full_like(Z, 0.002)).shadow(raking, method=method)
    silent = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA).shadow(raking, method=method, bias_m=-1.0)
    assert (told.lit < 0.5).mean() < 0.02
    assert method == "march" or (silent.lit < 0.5).mean() > 0.3  # the march always allows for the steps between its cells


@pytest.mark.parametrize("method", METHODS)
def test_acne_stands_where_sigma_is_not_told_and_is_gone_with_it(method: str) -> None:
    """A wall whose depth is off by 4 mm over some 3 pixels, as matching errs, under a lamp at 8 degrees; nothing but Z_sigma differs."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=WALL.shape), (0, 0), 1.0)
    Z = (WALL + 0.004 / noise.std() * noise).astype(np.float32)
    raking = Emitter(name="rake", shape="direction", towards=(math.cos(math.radians(8)), 0.0, math.sin(math.radians(8))))
    told, silent = (ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, Z_sigma=s).shadow(raking, method=method) for s in (np.full_like(Z, 0.004), None))  # type: ignore[arg-type]
    assert (told.lit < 0.5).mean() < 0.01
    assert (silent.lit < 0.5).mean() > 0.03


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("place", [(0.0, 0.0, -2.0), (0.0, 0.0, -3.0), (0.0, 0.0, -1.4999), (0.0, 0.0, 0.0)])
def test_lights_in_and_behind_the_surface_have_an_answer(method: str, place: tuple[float, float, float]) -> None:
    scene, _ = card_scene()
    for emitter_ in (Emitter(name="a", shape="place", position_m=place), Emitter(name="b", shape="ball", position_m=place, radius_m=0.1)):
        found = scene.shadow(emitter_, method=method)
        for layer in (found.lit, found.unknown):
            assert np.isfinite(layer).all()
            assert ((layer >= 0) & (layer <= 1)).all()


def test_unknown_pixels_and_bad_settings() -> None:
    Z = WALL.copy()
    Z[40:50, 70:90] = np.nan
    scene = ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA)
    for method in METHODS:
        assert np.isfinite(scene.shadow(SUN, method=method).lit).all()  # type: ignore[arg-type]
    with pytest.raises(PassError, match="no known pixel"):
        ShadowScene(Z=Z * np.nan, N=TO_CAMERA, camera=CAMERA)
    with pytest.raises(PassError, match="thickness"):
        ShadowScene(Z=Z, N=TO_CAMERA, camera=CAMERA, thickness_m=-1.0)
    with pytest.raises(ShotError, match="did you mean 'march'"):
        scene.shadow(SUN, method="martch")  # type: ignore[arg-type]
    with pytest.raises(ShotError, match="shadow_samples"):
        scene.shadow(SUN, samples=0)
    with pytest.raises(ShotError, match="radius_m"):
        Emitter(name="a", shape="ball", radius_m=-1.0)
    for settings in ({"radius_m": 0.0}, {"radius_m": float("nan")}, {"falloff": -1.0}, {"samples": 0}):
        with pytest.raises(ShotError, match="occlusion"):
            ambient_occlusion(scene, **settings)


def test_a_lens_that_bends_casts_the_same_shadow() -> None:
    """The march goes through the depth with the lens undone; rays never knew of it."""
    bent = Camera(size=(240, 136), K=np.array([[300.0, 0, 118], [0, 300, 69], [0, 0, 1]]), model="brown", distortion=(-0.25, 0.06, 0.001, -0.001))
    tables = scene_named("sphere").tables()
    ways = bent.rays(bent.pixel_grid().reshape(-1, 2)) @ FLIP
    t, hit = raycast.first_hits(tables.objects, tables.primitives, np.zeros((1, 3)), ways)
    normals = raycast.surface_at(tables.objects, tables.primitives, tables.materials, t[:, None] * ways, hit)[0]
    N = normals.reshape(*bent.size_hw, 3).astype(np.float32)
    scene = ShadowScene(Z=t.reshape(bent.size_hw).astype(np.float32), N=N, camera=bent)
    march, rays = (scene.shadow(emitter(KEY), method=method).lit > 0.5 for method in ("march", "rays"))
    assert 0.02 < (~rays).mean() < 0.9
    assert (march == rays).mean() > 0.985


@pytest.mark.parametrize("name", ["bust", "table"])
def test_ambient_occlusion_and_bent_normals_against_traced_truth(name: str) -> None:
    scene, _, _ = truth(name, KEY)
    radius, count, step = 0.3, 256, 7
    found = ambient_occlusion(scene, radius_m=radius)
    tables = scene_named(name).tables()
    P, N = (a[2::step, 2::step].reshape(-1, 3).astype(np.float64) for a in (scene.P, scene.N))
    known = np.isfinite(P).all(axis=-1)
    P, N = P[known], N[known]
    u, v = across(N)
    lost, way = np.zeros(len(P)), np.zeros((len(P), 3))
    shift = np.random.default_rng(0).random((len(P), 2))  # of the whole even set: places drawn one by one left an error of 0.02 in the truth
    for at in spread(count):
        disc = on_disc((at + shift) % 1)
        ways = disc[:, :1] * u + disc[:, 1:] * v + np.sqrt(np.maximum(1 - (disc**2).sum(-1), 0))[:, None] * N
        t, hit = raycast.first_hits(tables.objects, tables.primitives, P + 1e-5 * N, ways, limits=np.full(len(P), radius), empty=tables.empty)
        blocked = np.where(hit >= 0, 1 - t / radius, 0.0)
        lost += blocked
        way += blocked[:, None] * ways
    ao, bent = 1 - lost / count, 2 / 3 * N - way / count
    bent /= np.linalg.norm(bent, axis=-1, keepdims=True)
    own_ao = found.ao[2::step, 2::step].reshape(-1)[known]
    own_bent = found.bent[2::step, 2::step].reshape(-1, 3)[known]
    shaded = ao < 0.95
    angle = np.degrees(np.arccos(np.clip((own_bent * bent).sum(axis=-1), -1, 1)))
    assert shaded.mean() > 0.1
    assert np.abs(own_ao - ao).mean() <= 0.03
    assert np.abs(own_ao - ao)[shaded].mean() <= 0.03
    assert np.median(angle) <= 5
    assert np.median(angle[shaded]) <= 5


def test_an_open_wall_is_open() -> None:
    found = ambient_occlusion(ShadowScene(Z=WALL, N=TO_CAMERA, camera=CAMERA), radius_m=1.0)
    assert (found.ao == 1).all()
    np.testing.assert_array_equal(found.bent, TO_CAMERA)
