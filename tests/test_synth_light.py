"""The synthetic plates: light as written down, flips, noise, motion, and the same bits every time."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from stereorelight.errors import RigError, ShotError
from stereorelight.synth.lights import Light
from stereorelight.synth.render import render
from stereorelight.synth.rigs import mirrored_rig, parallel_rig, rectified_rig, rig_named
from stereorelight.synth.scene import Material, Object, Scene
from stereorelight.synth.scenes import scene_named

SIZE = (64, 36)
FLOAT32 = 2e-7
WHITE = Material(color=(1.0, 1.0, 1.0))
CARD = Object(name="card", kind="plane", material=WHITE, origin_m=(0.0, 0.0, -2.0))


def lit(scene: Scene, *lights: Light, **options: object) -> np.ndarray:
    rig = parallel_rig((65, 65), fov_deg=30)
    return render(scene, rig, lights=lights, samples=1, **options).left["plate"]  # type: ignore[arg-type]


def test_a_white_card_at_one_metre_reads_one() -> None:
    card = Scene(name="card", objects=(CARD,))
    for light in (
        Light(name="a", type="point", position_m=(0, 0, -1)),
        Light(name="a", type="spot", position_m=(0, 0, -1), direction=(0, 0, -3)),
        Light(name="a", type="directional", direction=(0, 0, -0.2)),
    ):
        np.testing.assert_allclose(lit(card, light)[32, 32], 1.0, rtol=FLOAT32)
    far = Light(name="a", type="point", position_m=(0, 0, 0), intensity=3.0, color=(1, 0.5, 0))
    np.testing.assert_allclose(lit(card, far)[32, 32], (0.75, 0.375, 0), rtol=FLOAT32)


def test_a_spot_falls_to_nothing_over_its_penumbra() -> None:
    card = Scene(name="card", objects=(CARD,))
    spot = Light(name="a", type="spot", position_m=(0, 0, -1), cone_deg=20, penumbra_deg=5)
    made = render(card, parallel_rig((65, 65), fov_deg=30), lights=(spot,), samples=1).left
    x, y = made["P"][..., 0].astype(float), made["P"][..., 1].astype(float)
    off = np.degrees(np.arctan(np.hypot(x, y)))
    share = made["plate"][..., 0] / np.cos(np.radians(off)) ** 3  # cosine, and distance squared
    np.testing.assert_allclose(share[off < 10], 1.0, rtol=1e-5)
    assert (share[off > 15] == 0).all()
    s = (15 - off) / 5
    ring = (off > 10) & (off < 15)
    np.testing.assert_allclose(share[ring], (s * s * (3 - 2 * s))[ring], atol=1e-5)


def test_the_plate_is_the_sum_of_its_layers() -> None:
    scene = scene_named("bust")
    made = render(scene, parallel_rig(SIZE), samples=1)
    for frame in (made.left, made.right):
        total = frame["albedo"] * np.float32(made.ambient)
        for light in made.lights:
            arrives = frame[f"matte_lit_{light.name}"][..., None]
            total = total + arrives * (frame[f"light_{light.name}_diffuse"] + frame[f"light_{light.name}_specular"])
        np.testing.assert_allclose(frame["plate"], total, atol=1e-6)
    assert any(0.02 < made.left[f"matte_lit_{light.name}"].mean() < 0.98 for light in made.lights)


def test_two_lights_are_the_sum_of_each() -> None:
    scene = replace(scene_named("sphere"), ambient=(0.0, 0.0, 0.0))
    a = Light(name="a", position_m=(-0.5, 0.7, 0))
    b = Light(name="b", type="directional", direction=(-1, -0.3, -1), intensity=0.4)
    np.testing.assert_allclose(lit(scene, a, b), lit(scene, a) + lit(scene, b), atol=1e-6)
    assert not lit(scene).any()


@pytest.mark.parametrize(("z", "radius"), [(-1.5, 0.2), (-2.46, 0.04), (-2.49, 0.01)])
def test_shadow_of_a_sphere_is_the_analytic_ellipse(z: float, radius: float) -> None:
    """Wall at 2.5 m: in shadow where the line to the light passes through the ball; also of balls that touch the wall."""
    ball = Object(name="ball", kind="sphere", material=WHITE, origin_m=(0.0, 0.0, z), size=(radius,))
    wall = Object(name="wall", kind="plane", material=WHITE, origin_m=(0.0, 0.0, -2.5))
    scene = Scene(name="s", objects=(wall, ball))
    light = Light(name="key", position_m=(0.9, 0.2, 0.4))
    rig = parallel_rig((320, 200), fov_deg=min(45.0, 300 * radius))
    made = render(scene, rig, lights=(light,), samples=1)
    on_wall = made.objects["left"] == 0
    P, source, centre = made.left["P"].astype(float), np.array(light.position_m), np.array([0, 0, z])
    along = P - source
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    clearance = np.linalg.norm(np.cross(along, centre - source), axis=-1) - radius
    sure = on_wall & (np.abs(clearance) > 1e-6)
    np.testing.assert_array_equal(made.left["matte_lit_key"][sure] == 0, clearance[sure] < 0)
    assert 300 < (made.left["matte_lit_key"][on_wall] == 0).sum() < on_wall.sum() / 2
    open_ = render(scene, rig, lights=(light,), samples=1, shadows=False)
    assert (open_.left["matte_lit_key"] == 1).all()


def test_one_lit_layer_by_hand() -> None:
    """Lambert and Phong on the slanted wall against the textbook formula, from the passes themselves."""
    light = Light(name="key", position_m=(-0.3, 0.4, -0.2), intensity=0.9, color=(1, 0.8, 0.6))
    shiny = Object(name="wall", kind="plane", material=replace(WHITE, specular=0.4, exponent=12.0), origin_m=(0, 0, -2.0))
    frame = render(Scene(name="s", objects=(shiny,)), parallel_rig(SIZE), lights=(light,), samples=1).left
    P, N = frame["P"].astype(float), frame["N"].astype(float)
    to_light = np.array(light.position_m) - P
    r2 = (to_light**2).sum(-1, keepdims=True)
    L = to_light / np.sqrt(r2)
    V = -P / np.linalg.norm(P, axis=-1, keepdims=True)
    cosine = (N * L).sum(-1, keepdims=True)
    E = 0.9 * np.array([1, 0.8, 0.6]) / r2
    np.testing.assert_allclose(frame["light_key_diffuse"], cosine * E, rtol=1e-5)
    np.testing.assert_allclose(frame["light_key_specular"], 0.4 * ((2 * cosine * N - L) * V).sum(-1, keepdims=True).clip(0) ** 12 * E, atol=1e-6)


def test_a_mirrored_eye_records_a_flipped_plate() -> None:
    plain = render(scene_named("box"), parallel_rig(SIZE), samples=2)
    for eye in ("left", "right"):
        made = render(scene_named("box"), mirrored_rig(SIZE, eye=eye), samples=2)
        np.testing.assert_array_equal(made.recorded_plate(eye), plain.frame(eye)["plate"][:, ::-1])
        assert made.recorded_plate(eye).flags.c_contiguous
        other = "left" if eye == "right" else "right"
        np.testing.assert_array_equal(made.recorded_plate(other), plain.frame(other)["plate"])
        for name in plain.frame(eye):
            np.testing.assert_array_equal(made.frame(eye)[name], plain.frame(eye)[name])


def test_the_plate_is_averaged_and_the_truth_is_not() -> None:
    one, many = (render(scene_named("two_planes", texture=0), parallel_rig(SIZE), samples=n) for n in (1, 4))
    np.testing.assert_array_equal(one.left["Z"], many.left["Z"])
    np.testing.assert_array_equal(one.left["albedo"], many.left["albedo"])
    edge = one.left["plate"] != many.left["plate"]
    assert edge.any()
    a, b = one.left["plate"][18, :, 0], many.left["plate"][18, :, 0]
    assert a.min() - 1e-3 <= b.min()
    assert b.max() <= a.max() + 1e-3


def test_the_same_bits_whatever_the_threads() -> None:
    scene, rig = scene_named("bust"), rig_named("hard", SIZE)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
        first = render(scene, rig, samples=2, noise_sigma=0.01, frame=3)
        numba.set_num_threads(1)
        second = render(scene, rig, samples=2, noise_sigma=0.01, frame=3)
    finally:
        numba.set_num_threads(threads)
    for eye in ("left", "right"):
        for name in first.frame(eye):
            assert first.frame(eye)[name].tobytes() == second.frame(eye)[name].tobytes(), name


def test_noise_is_on_the_plate_alone_and_new_each_frame() -> None:
    scene, rig = scene_named("plane"), parallel_rig((200, 120))
    clean, a, b = (render(scene, rig, samples=1, noise_sigma=s, frame=f) for s, f in ((0, 0), (0.02, 0), (0.02, 1)))
    assert abs((a.left["plate"] - clean.left["plate"]).std() / 0.02 - 1) < 0.02
    assert abs(np.corrcoef((a.left["plate"] - clean.left["plate"]).ravel(), (b.left["plate"] - clean.left["plate"]).ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef((a.left["plate"] - clean.left["plate"]).ravel(), (a.right["plate"] - clean.right["plate"]).ravel())[0, 1]) < 0.02
    np.testing.assert_array_equal(a.left["Z"], clean.left["Z"])


def test_the_head_turns_and_takes_its_skin_along() -> None:
    rig = parallel_rig((96, 54))
    still, moved = (render(scene_named("bust", frame=f, motion=True), rig, samples=1, lights=()) for f in (0, 6))
    rest = render(scene_named("bust", frame=6), rig, samples=1, lights=())
    np.testing.assert_array_equal(still.left["Z"], rest.left["Z"])
    skin = still.objects["left"] == still.object_names.index("skin")
    assert (still.left["Z"] != moved.left["Z"])[skin].mean() > 0.9
    room = (still.objects["left"] == still.object_names.index("back_wall")) & (moved.objects["left"] == still.objects["left"])
    np.testing.assert_array_equal(still.left["albedo"][room], moved.left["albedo"][room])
    assert abs(np.median(still.left["albedo"][skin]) - np.median(moved.left["albedo"][skin])) < 0.02


def test_texture_is_a_dial() -> None:
    rig = parallel_rig((96, 54))
    spread = []
    for texture in (0.0, 0.2, 1.0):
        made = render(scene_named("slanted", texture=texture), rig, samples=1, lights=()).left["albedo"]
        spread.append(float(made.std(axis=(0, 1)).mean() / made.mean()))
    assert spread[0] < 1e-4  # one colour, to float32's own mean
    assert spread[2] == pytest.approx(5 * spread[1], rel=0.05)


def test_nonsense_is_refused() -> None:
    scene, rig = scene_named("plane"), parallel_rig(SIZE)
    with pytest.raises(ShotError, match="did you mean 'bust'"):
        scene_named("burst")
    with pytest.raises(RigError, match="did you mean 'toed-in'"):
        rig_named("toedin", SIZE)
    with pytest.raises(ShotError, match="samples"):
        render(scene, rig, samples=0)
    with pytest.raises(ShotError, match="noise_sigma"):
        render(scene, rig, noise_sigma=-1)
    with pytest.raises(ShotError, match="share a name"):
        render(scene, rig, lights=(Light(name="a"), Light(name="a")))
    with pytest.raises(ShotError, match="type 'laser' is unknown"):
        Light(name="a", type="laser")  # type: ignore[arg-type]
    with pytest.raises(ShotError, match="letters"):
        Light(name="a b")
    with pytest.raises(RigError, match="not rectified"):
        rectified_rig(rig_named("hard", SIZE))
