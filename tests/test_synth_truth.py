"""The synthetic shots: what is worked out by hand must come out of the ray caster."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from stereorelight.camera import Camera, Eye, Rig
from stereorelight.engine import raycast, solids, texture
from stereorelight.engine.solids import field
from stereorelight.passes import Flag
from stereorelight.synth.render import FLIP, Shot, render
from stereorelight.synth.rigs import RIGS, is_rectified, parallel_rig, rectified_rig, rig_named
from stereorelight.synth.scene import Material, Object, Primitive, Scene, ball, ellipsoid, limb, ring, rotation
from stereorelight.synth.scenes import scene_named, scenes

SIZE = (96, 64)
METRES = 1e-6  # float32 passes hold 2.4e-7 m at 3 m
DEGREES = 0.01  # float32 unit vectors hold about 1e-5 degrees
EYES: tuple[Eye, Eye] = ("left", "right")


def shot(name: str, rig: Rig) -> Shot:
    return render(scene_named(name), rig, samples=1, lights=())


def world_rays(rig: Rig, eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) and directions (H, W, 3) in the world: the judge's own way from pixel to ray."""
    R, centre = (np.eye(3), np.zeros(3)) if eye == "left" else (rig.R_right_left.T, rig.right_centre_m)
    rays = np.einsum("ij,hwj->hwi", R, rig.camera(eye).rays(rig.camera(eye).pixel_grid()))
    return centre * (1, -1, -1), rays * (1, -1, -1)


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("rig_name", RIGS)
def test_slanted_plane_is_exact(rig_name: str, eye: Eye) -> None:
    rig = rig_named(rig_name, SIZE)
    frame = shot("slanted", rig).frame(eye)
    normal = rotation(x_deg=-15, y_deg=35)[:, 2]
    origin, rays = world_rays(rig, eye)
    t = ((np.array([0, 0, -1.5]) - origin) @ normal) / (rays @ normal)
    np.testing.assert_allclose(frame["Z"], t, atol=METRES)
    to_eye = np.eye(3) if eye == "left" else FLIP @ rig.R_right_left @ FLIP
    assert angle_deg(frame["N"].astype(float), to_eye @ normal).max() < DEGREES
    P = rig.camera(eye).unproject(rig.camera(eye).pixel_grid(), t) * (1, -1, -1)
    np.testing.assert_allclose(frame["P"], P, atol=METRES)
    assert not frame["flags"][SIZE[1] // 2, SIZE[0] // 2]


@pytest.mark.parametrize("rig_name", ["parallel", "distorted", "hard"])
def test_sphere_is_exact(rig_name: str) -> None:
    rig = rig_named(rig_name, SIZE)
    for eye in EYES:
        made = shot("sphere", rig)
        frame, ball = made.frame(eye), made.objects[eye] == made.object_names.index("ball")
        origin, rays = world_rays(rig, eye)
        centre = np.array([0, 0, -1.5])
        a, b, c = (rays**2).sum(-1), rays @ (origin - centre), ((origin - centre) ** 2).sum() - 0.25**2
        inside = b * b - a * c
        np.testing.assert_array_equal(ball, inside > 0)
        t = (-b - np.sqrt(np.where(ball, inside, 0))) / a
        np.testing.assert_allclose(frame["Z"][ball], t[ball], atol=METRES)
        N = (origin + t[..., None] * rays - centre) / 0.25
        to_eye = np.eye(3) if eye == "left" else FLIP @ rig.R_right_left @ FLIP
        assert angle_deg(frame["N"].astype(float), N @ to_eye.T)[ball].max() < DEGREES
        assert (np.einsum("hwc,hwc->hw", frame["N"], -frame["P"]) > 0).all()


def test_disparity_is_the_rigs_own() -> None:
    rig = parallel_rig(SIZE)
    shifted = Camera(size=SIZE, K=rig.right.K + np.array([[0, 0, 7.25], [0, 0, 0], [0, 0, 0]]))
    rig = replace(rig, right=shifted)
    made = shot("two_planes", rig)
    rectified = rectified_rig(rig)
    np.testing.assert_allclose(made.left["disparity"], rig.left.fx * 0.065 / made.left["Z"].astype(float) - 7.25, atol=2e-5)
    np.testing.assert_allclose(rectified.depth_from_disparity(made.left["disparity"]), made.left["Z"], rtol=1e-5)
    assert "disparity" not in shot("two_planes", rig_named("toed-in", SIZE)).left


@pytest.mark.parametrize("rig_name", ["parallel", "hard"])
def test_both_eyes_see_the_same_surface(rig_name: str) -> None:
    """Left P, carried into the right eye and cast again from there at its own exact pixel, meets the same point and albedo."""
    rig = rig_named(rig_name, (160, 90))
    scene = scene_named("bust")
    made = render(scene, rig, samples=1, lights=())
    tables = scene.tables()
    seen = made.left["flags"] == 0
    assert 0.5 < seen.mean() < 0.99
    in_left = rig.left.unproject(rig.left.pixel_grid(), made.left["Z"].astype(float))[seen]
    in_right = in_left @ rig.R_right_left.T + rig.t_right_left_m
    rays = rig.right.rays(rig.right.project(in_right))
    origin, directions = rig.right_centre_m[None] @ FLIP, rays @ rig.R_right_left @ FLIP
    t, hit = raycast.first_hits(tables.objects, tables.primitives, origin, directions)
    np.testing.assert_array_equal(hit, made.objects["left"][seen])
    _, albedo, _ = raycast.surface_at(tables.objects, tables.primitives, tables.materials, origin + t[:, None] * directions, hit)
    # Z left the renderer as float32: a ray that grazes the surface moves by that over the sine of the angle.
    facing = np.abs(np.einsum("nc,nc->n", made.left["N"][seen], -made.left["P"][seen])) / np.linalg.norm(made.left["P"][seen], axis=-1) > 0.2
    assert np.abs(t - in_right[:, 2])[facing].max() < 2e-6
    assert np.abs(albedo - made.left["albedo"][seen])[facing].max() < 2e-3


@pytest.mark.parametrize("rig_name", ["parallel", "hard"])
def test_occlusion_against_brute_force(rig_name: str) -> None:
    """The judge walks from the point to the other eye in steps of 0.5 mm and asks the field itself whether it is inside."""
    rig = rig_named(rig_name, (120, 68))
    scene = scene_named("bust")
    made = render(scene, rig, samples=1, lights=())
    tables, names = scene.tables(), made.object_names
    rng = np.random.default_rng(3)
    flags = made.left["flags"]
    hidden, open_ = (flags & Flag.OCCLUDED) > 0, flags == 0
    picks = [tuple(p) for mask in (hidden, open_) for p in rng.permutation(np.argwhere(mask))[:60]]
    round_things = [names.index(n) for n in ("skin", "hair", "shirt")]
    target = rig.right_centre_m @ FLIP
    judged = 0
    for v, u in picks:
        start = made.left["P"][v, u].astype(float)
        along = (target - start) / np.linalg.norm(target - start)
        path = start + np.arange(0.002, np.linalg.norm(target - start), 0.0005)[:, None] * along
        clearance = np.inf  # least value of any field on the way: the walk begins 2 mm off the surface that it leaves
        for n, thing in enumerate(scene.objects):
            R, origin = tables.objects[n, 4:13].reshape(3, 3), tables.objects[n, 13:16]
            local = (path - origin) @ R.T
            if n in round_things:
                local = local[np.linalg.norm(local - tables.objects[n, 17:20], axis=-1) < tables.objects[n, 16]]
                clearance = min([clearance, *(field(tables.objects, n, tables.primitives, *p) for p in local)])
            elif thing.kind == "box":
                clearance = min(clearance, (np.abs(local) - thing.size).max(axis=-1).min())
            elif thing.kind == "sphere":
                clearance = min(clearance, (np.linalg.norm(local, axis=-1) - thing.size[0]).min())
        if abs(clearance) > 1e-4:  # nearer than this the judge's own steps may pass a graze by
            judged += 1
            assert (clearance < 0) == hidden[v, u], (v, u, clearance)
    assert judged > 0.9 * len(picks)


def test_out_of_view_is_the_other_frame() -> None:
    rig = rig_named("parallel", SIZE)
    made = shot("plane", rig)
    u = np.arange(SIZE[0]) - rig.left.fx * 0.065 / 2.0
    np.testing.assert_array_equal(made.left["flags"], np.broadcast_to(np.where(u < -0.5, Flag.OUT_OF_VIEW, 0), (SIZE[1], SIZE[0])))
    np.testing.assert_array_equal(made.right["flags"], made.left["flags"][:, ::-1])


def test_card_hides_a_strip_of_the_wall() -> None:
    """A card at 1.2 m before a wall at 2 m hides fx b (1/1.2 - 1/2) pixels of it, left of the card in the left eye."""
    rig = parallel_rig((640, 64))
    made = shot("two_planes", rig)
    row = (made.left["flags"][32] & Flag.OCCLUDED) > 0
    assert abs(row.sum() - rig.left.fx * 0.065 * (1 / 1.2 - 1 / 2.0)) <= 1
    card = made.objects["left"][32] == made.object_names.index("card")
    assert np.flatnonzero(row)[-1] + 1 == np.flatnonzero(card)[0]


@pytest.mark.parametrize("name", scenes())
def test_every_scene_and_eye_is_whole(name: str) -> None:
    made = render(scene_named(name), rig_named("hard", (64, 36)), samples=1)
    for eye in EYES:
        frame = made.frame(eye)
        assert frame.eye == eye
        assert frame.camera is made.rig.camera(eye)
        for key in ("plate", "Z", "P", "N", "albedo"):
            assert np.isfinite(frame[key]).all(), key
        assert (np.einsum("hwc,hwc->hw", frame["N"], -frame["P"]) > 0).mean() > 0.999


def solid(*parts: Primitive, **more: object) -> Scene:
    thing = Object(name="solid", kind="solid", material=Material(color=(0.5, 0.5, 0.5)), size=(0.4,), primitives=parts, origin_m=CENTRE, **more)  # type: ignore[arg-type]
    return Scene(name="solid", objects=(thing,))


CENTRE = (0.05, -0.02, -1.5)


@pytest.mark.parametrize("radii", [(0.2, 0.2, 0.2), (0.24, 0.11, 0.16)])
def test_traced_ellipsoid_is_the_analytic_one(radii: tuple[float, float, float]) -> None:
    """Sphere tracing and differenced normals against the closed form, in a turned frame, with a cut that lies outside."""
    rig = rig_named("hard", SIZE)
    turned = rotation(x_deg=20, y_deg=-30, z_deg=10)
    scene = solid(ellipsoid((0, 0, 0), radii), ball((0.6, 0, 0), 0.1, blend_m=0.02, cut=True), R_world_object=turned)
    for eye in EYES:
        frame = render(scene, rig, samples=1).frame(eye)
        origin, rays = world_rays(rig, eye)
        o, d = turned.T @ (origin - CENTRE) / radii, rays @ turned / radii
        a, b, c = (d**2).sum(-1), d @ o, (o**2).sum() - 1
        inside = b * b - a * c
        hit = np.isfinite(frame["Z"])
        sure = np.abs(inside) > 1e-6
        np.testing.assert_array_equal(hit[sure], inside[sure] > 0)
        np.testing.assert_array_equal((frame["flags"] & Flag.TOO_FAR) > 0, ~hit)
        hit &= sure
        t = (-b - np.sqrt(np.maximum(inside, 0))) / a
        np.testing.assert_allclose(frame["Z"][hit], t[hit], atol=METRES)
        N = (o + t[..., None] * d) / radii @ turned.T
        N = (N / np.linalg.norm(N, axis=-1, keepdims=True))[hit]
        to_eye = np.eye(3) if eye == "left" else FLIP @ rig.R_right_left @ FLIP
        assert angle_deg(frame["N"][hit].astype(float), N @ to_eye.T).max() < DEGREES


def test_traced_limb_and_ring_lie_on_their_surfaces() -> None:
    rig = parallel_rig(SIZE)
    frame = render(solid(limb((-0.2, 0, 0), (0.2, 0, 0), 0.08)), rig, samples=1).left
    p = frame["P"].astype(float) - CENTRE
    axis = np.stack([np.clip(p[..., 0], -0.2, 0.2), 0 * p[..., 0], 0 * p[..., 0]], axis=-1)
    hit = np.isfinite(frame["Z"])
    assert hit.mean() > 0.1
    np.testing.assert_allclose(np.linalg.norm(p - axis, axis=-1)[hit], 0.08, atol=METRES)
    assert angle_deg(frame["N"].astype(float), (p - axis) / 0.08)[hit].max() < DEGREES
    frame = render(solid(ring((0, 0, 0), 0.2, 0.05, x_deg=90)), rig, samples=1).left
    p = frame["P"].astype(float) - CENTRE
    flat = p * (1, 1, 0)
    core = flat / np.linalg.norm(flat, axis=-1, keepdims=True) * 0.2
    hit = np.isfinite(frame["Z"])
    assert hit.mean() > 0.1
    np.testing.assert_allclose(np.linalg.norm(p - core, axis=-1)[hit], 0.05, atol=METRES)
    assert angle_deg(frame["N"].astype(float), (p - core) / 0.05)[hit].max() < DEGREES


def test_leaving_out_far_shapes_changes_nothing() -> None:
    """The field skips shapes that cannot matter; with every bound lifted it must return the same bits."""
    tables = scene_named("bust").tables()
    every = tables.primitives.copy()
    every[:, 19] = 1e6
    rng = np.random.default_rng(1)
    for n, thing in enumerate(scene_named("bust").objects):
        if thing.kind == "solid":
            for p in rng.uniform(-0.25, 0.25, (3000, 3)) + thing.bound_m:
                assert field(tables.objects, n, tables.primitives, *p) == field(tables.objects, n, every, *p)


def test_rigs_stand_as_they_say() -> None:
    toed = rig_named("toed-in", SIZE)
    np.testing.assert_allclose(toed.right.project(toed.R_right_left @ (0, 0, 1.5) + toed.t_right_left_m), (toed.right.cx, toed.right.cy), atol=1e-9)
    near, far = (toed.left.cx - toed.right.project(toed.R_right_left @ (0, 0, z) + toed.t_right_left_m)[0] for z in (1.2, 2.0))
    assert near > 0 > far
    for name in RIGS:
        rig = rig_named(name, SIZE)
        assert rig.right_centre_m[0] == pytest.approx(0.065)
        assert is_rectified(rig) == (name in ("parallel", "mirrored"))
    for name in ("offset", "hard"):
        assert rig_named(name, SIZE).right_centre_m[1] == pytest.approx(-0.003)  # camera frame: y down, so higher
    assert rig_named("hard", SIZE).mirrored == "right"


@pytest.mark.parametrize(("kernel", "name", "source"), [(solids, "TEXTURE", texture), (raycast, "TEXTURE", texture), (raycast, "SOLIDS", solids)])
def test_the_cached_kernels_are_made_of_todays_sources(kernel: ModuleType, name: str, source: ModuleType) -> None:
    found = hashlib.sha256(Path(str(source.__file__)).read_bytes()).hexdigest()[:16]
    assert found == getattr(kernel, name), f'{source.__file__} has changed: set {name} = "{found}" in {kernel.__file__}'


def test_tables_of_empty_space_change_no_hit() -> None:
    """Primary and shadow rays of the bust with its tables of empty space and without: one object, one place."""
    tables = scene_named("bust").tables()
    camera = parallel_rig((120, 68)).left
    directions = camera.rays(camera.pixel_grid().reshape(-1, 2)) @ FLIP
    plain, hit = raycast.first_hits(tables.objects, tables.primitives, np.zeros((1, 3)), directions)
    t, same = raycast.first_hits(tables.objects, tables.primitives, np.zeros((1, 3)), directions, empty=tables.empty)
    np.testing.assert_array_equal(hit, same)
    np.testing.assert_allclose(t, plain, atol=1e-11)
    light = np.array([[-0.75, 0.75, -0.55]])
    along = plain[:, None] * directions - light
    limits = np.full(len(along), 1 - 1e-5)
    dark, dark_too = (raycast.blocked(tables.objects, tables.primitives, light, along, limits, empty=e) for e in (None, tables.empty))
    np.testing.assert_array_equal(dark, dark_too)
    assert 0.01 < dark.mean() < 0.5
