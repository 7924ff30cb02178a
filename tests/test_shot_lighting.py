"""Lights of a shot file over a shot: keys, mattes, picture points, gobos, poses and the comp, from file to picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.errors import PassError, PlateError, RigError, ShotError
from stereorelight.footage.exr import write_exr
from stereorelight.footage.frames import read_frame
from stereorelight.footage.stills import write_still
from stereorelight.shot.lighting import Lighting, lighting_of, matte_channel
from stereorelight.shot.run import run_shot
from stereorelight.shot.schema import read_light_file, read_shot
from stereorelight.shot.synthetic import write_shot
from stereorelight.surface.position import position_from_depth

SIZE = (96, 64)
CAMERA = Camera.from_fov(50, SIZE)
LAMP = '[[lights]]\nname = "lamp"\ntype = "point"\nposition_m = [0.3, 0.2, -1]\nspecular = 0.2\n'


def wall(z: float = 2.0) -> dict[str, np.ndarray]:
    Z = np.full(SIZE[::-1], z, np.float32)
    N = np.zeros((*Z.shape, 3), np.float32)
    N[..., 2] = 1
    return {"Z": Z, "P": position_from_depth(Z, CAMERA), "N": N}


PLATE = np.random.default_rng(0).uniform(0.1, 0.9, (*SIZE[::-1], 3)).astype(np.float32)


def lighting(folder: Path, text: str, **more: object) -> Lighting:
    (folder / "lights.toml").write_text(text)
    return lighting_of(read_light_file(folder / "lights.toml"), **({"numbers": [], "plate": lambda n: PLATE} | more))  # type: ignore[arg-type]


def test_a_matte_file_holds_the_light(tmp_path: Path) -> None:
    painted = np.zeros((*SIZE[::-1], 3), np.uint8)
    painted[:, 40:] = 255
    write_still(tmp_path / "m.0007.png", painted)
    lit = lighting(tmp_path, LAMP + 'matte = "right"\n[[mattes]]\nname = "right"\nfile = "m.####.png"\n').lit(
        7, plate=PLATE, passes=wall(), camera=CAMERA
    )
    assert (lit.layers["light_lamp_diffuse"][:, :40] == 0).all()
    assert (lit.layers["light_lamp_diffuse"][:, 40:] > 0).all()
    np.testing.assert_allclose(lit.beauty, PLATE + sum(lit.layers.values()), rtol=1e-6)


def test_mattes_combine_and_move_by_keys(tmp_path: Path) -> None:
    text = LAMP + (
        'matte = "both"\n[[mattes]]\nname = "near"\ntype = "depth"\nfar_m = { keys = [[1, 1.0], [3, 3.0]] }\n'
        '[[mattes]]\nname = "left"\ntype = "plane"\npoint_m = [0, 0, 0]\nnormal = [-1, 0, 0]\n'
        '[[mattes]]\nname = "both"\ntype = "multiply"\nof = ["near", "left"]\n'
    )
    made = lighting(tmp_path, text)
    dark, bright = (made.lit(n, plate=PLATE, passes=wall(1.9), camera=CAMERA).layers["light_lamp_diffuse"] for n in (1, 2))
    assert (dark == 0).all()
    assert (bright[:, :48] > 0).all()
    assert (bright[:, 48:] == 0).all()


def test_light_alone_has_its_matte_in_alpha_and_a_fade_is_kept(tmp_path: Path) -> None:
    text = LAMP + 'matte = "left"\n[[mattes]]\nname = "left"\ntype = "plane"\npoint_m = [0, 0, 0]\nnormal = [-1, 0, 0]\n'
    passes = wall() | {"confidence": np.full(SIZE[::-1], 0.25, np.float32)}
    made = lighting(tmp_path, text + '[relight]\nmode = "light_only"\nfade = 1.0\n')
    lit = made.lit(1, plate=PLATE, passes=passes, camera=CAMERA)
    assert lit.alpha is not None
    assert lit.trust is not None
    np.testing.assert_allclose(lit.trust, 0.5, atol=1e-6)
    np.testing.assert_allclose(lit.alpha[:, :48], 0.5, atol=1e-6)
    assert (lit.alpha[:, 48:] == 0).all()
    plain = lighting(tmp_path, text).lit(1, plate=PLATE, passes=passes, camera=CAMERA)
    assert plain.alpha is None
    assert plain.trust is None
    np.testing.assert_allclose(lit.layers["light_lamp_diffuse"], 0.5 * plain.layers["light_lamp_diffuse"], rtol=1e-5)
    np.testing.assert_allclose(lit.beauty, sum(lit.layers.values()), rtol=1e-6)
    assert list(lit.passes())[:3] == ["beauty", "alpha", "matte_trust"]
    with pytest.raises(PassError, match="confidence or N_sigma"):
        made.lit(1, plate=PLATE, passes=wall(), camera=CAMERA)


def test_multiply_makes_gains_of_the_layers(tmp_path: Path) -> None:
    lit = lighting(tmp_path, LAMP + '[relight]\nmode = "multiply"\nplate_gain = 0.5\n').lit(1, plate=PLATE, passes=wall(), camera=CAMERA)
    np.testing.assert_allclose(lit.beauty, PLATE * (0.5 + sum(lit.layers.values())), rtol=1e-5)


def test_no_lights_is_the_plate_bit_for_bit(tmp_path: Path) -> None:
    for mode in ("add", "multiply"):
        lit = lighting(tmp_path, f'lights = []\n[relight]\nmode = "{mode}"\n').lit(1, plate=PLATE, passes=wall(), camera=CAMERA)
        assert lit.beauty.tobytes() == PLATE.tobytes()


def test_a_highlight_that_goes_out_keeps_its_layer(tmp_path: Path) -> None:
    made = lighting(tmp_path, LAMP.replace("specular = 0.2", "specular = { keys = [[1, 0.0], [5, 1.0]] }"))
    first, last = (made.lit(n, plate=PLATE, passes=wall(), camera=CAMERA).layers for n in (1, 5))
    assert list(first) == list(last)
    assert (first["light_lamp_specular"] == 0).all()
    assert last["light_lamp_specular"].max() > 0


def test_a_gobo_is_thrown_by_its_spot_alone(tmp_path: Path) -> None:
    gobo = np.zeros((32, 32, 3), np.uint8)
    gobo[:, 16:, 0] = 255
    write_still(tmp_path / "gobo.png", gobo)
    spot = '[[lights]]\nname = "window"\ntype = "spot"\nposition_m = [0, 0, 0]\ndirection = [0, 0, -1]\ncone_deg = 70\ngobo = "gobo.png"\n'
    lit = lighting(tmp_path, spot + LAMP).lit(1, plate=PLATE, passes=wall(), camera=CAMERA)
    thrown = lit.layers["light_window_diffuse"]
    assert thrown[32, 20].max() == 0
    assert thrown[32, 60, 0] > 0
    assert thrown[32, 60, 1] == 0
    without = lighting(tmp_path, LAMP).lit(1, plate=PLATE, passes=wall(), camera=CAMERA)
    np.testing.assert_array_equal(lit.layers["light_lamp_diffuse"], without.layers["light_lamp_diffuse"])


def moving_card(n: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A textured card 1 m away that goes right by 3 px a frame, before a textured wall at 3 m."""
    import cv2

    rng = np.random.default_rng(3)
    back, card = (cv2.GaussianBlur(rng.uniform(0, 1, (64, w, 3)).astype(np.float32), (0, 0), 1.5) for w in (96, 36))
    plate, Z = back.copy(), np.full((64, 96), 3.0, np.float32)
    at = 20 + 3 * n
    plate[14:50, at : at + 36], Z[14:50, at : at + 36] = card[14:50], 1.0
    N = np.zeros((64, 96, 3), np.float32)
    N[..., 2] = 1
    return plate, {"Z": Z, "P": position_from_depth(Z, CAMERA), "N": N}


STUCK = LAMP.replace("[0.3, 0.2, -1]", "{ pixel = [47, 30], frame = 3, offset_m = [0, 0.1, 0.4] }")


def test_a_light_goes_with_what_its_pixel_shows(tmp_path: Path) -> None:
    """Picked on frame 3, the light stands over the same spot of the card on frames before and after, whatever is asked first."""
    made = lighting(tmp_path, STUCK, numbers=range(6), plate=lambda n: moving_card(n)[0])
    made.check(range(6))
    for n in (5, 0, 3, 4):
        _, passes = moving_card(n)
        light = made.lights(n, passes["P"], CAMERA)[0]
        true = CAMERA.unproject([47 + 3 * (n - 3), 30], 1.0) * (1, -1, -1) + (0, 0.1, 0.4)
        np.testing.assert_allclose(light.position_m, true, atol=0.006)  # type: ignore[attr-defined]
    again = lighting(tmp_path, STUCK, numbers=range(6), plate=lambda n: moving_card(n)[0])
    _, passes = moving_card(5)
    assert again.lights(5, passes["P"], CAMERA) == made.lights(5, passes["P"], CAMERA)


def test_what_a_stuck_light_depends_on_is_in_its_key(tmp_path: Path) -> None:
    made = lighting(tmp_path, STUCK, numbers=range(6), plate=lambda n: moving_card(n)[0], digest=lambda n: f"plate {n}")
    assert made.key(5) == [[], None, [["plate 3", "plate 4", "plate 5"]]]
    assert made.key(3) is None
    assert lighting(tmp_path, LAMP).key(5) is None


def test_a_point_that_is_lost_is_told_and_a_dark_light_need_not_be_found(tmp_path: Path) -> None:
    def plate(n: int) -> np.ndarray:
        return np.random.default_rng(n).uniform(0, 1, (64, 96, 3)).astype(np.float32)

    made = lighting(tmp_path, STUCK, numbers=range(6), plate=plate)
    with pytest.raises(ShotError, match=r"light 'lamp' on frame 5: the point \(47, 30\) of frame 3 cannot be tracked to frame 4"):
        made.lights(5, wall()["P"], CAMERA)
    keyed = STUCK + 'intensity = { keys = [[1, 1.0], [5, 0.0]], ease = "step" }\n'
    assert lighting(tmp_path, keyed, numbers=range(6), plate=plate).lights(5, wall()["P"], CAMERA)[0].strength == 0
    with pytest.raises(ShotError, match=r"light 'lamp': frame 3 of its pixel is not in the shot, which has 5-9"):
        lighting(tmp_path, STUCK, numbers=range(5, 10)).check([5])


def test_the_camera_moves_and_a_world_light_stays(tmp_path: Path) -> None:
    """A wall in the world, a light in the world, and a camera that backs off by half a metre: the same light on the same spot."""
    poses = {"frames": {"11": {"position": [0, 0, 0]}, "12": {"position": [0, 0, 0.5]}}}
    (tmp_path / "camera.json").write_text(json.dumps(poses))
    text = LAMP + 'space = "world"\n[camera]\nfile = "camera.json"\nshift_frames = -10\n'
    made = lighting(tmp_path, text)
    white = np.ones_like(PLATE)
    values = []
    for n, z in ((1, 2.0), (2, 2.5)):
        camera = made.camera(CAMERA, n)
        lit = made.lit(n, plate=white, passes=wall(z), camera=camera)
        assert camera.world_from_camera[2, 3] == z - 2
        values.append(lit.layers["light_lamp_diffuse"][31:33, 47:49].mean())
    assert values[0] == pytest.approx(values[1], rel=1e-3)
    with pytest.raises(RigError, match="has no pose for frame 3"):
        made.check([1, 2, 3])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LAMP + 'matte = "actor"\n', r"shot.toml:\d+: light 'lamp': matte 'actor' is missing; there are none"),
        (LAMP + 'matte = "wal"\n[[mattes]]\nname = "wall"\ntype = "depth"\nfar_m = 2\n', "did you mean 'wall'"),
        ('[[mattes]]\nname = "a"\ntype = "depth"\nfar = 2\n', r"shot.toml:7: matte 'a': key 'far' is unknown; did you mean 'far_m'"),
        ('[[mattes]]\nname = "a"\ntype = "multiply"\nof = ["b"]\n', "matte 'a': of 'b' is unknown; no matte stands before"),
        ("[relight]\nfade = 2\n", "relight.fade = 2"),
        ('[relight]\nmode = "ad"\n', "did you mean 'add'"),
        ('[camera]\nfil = "x"\n', "unknown key 'fil'; did you mean 'file'"),
        ('[[mattes]]\nname = "a"\ntype = "sphere"\nradius_m = 1\ncentre_m = { pixel = [1, 2] }\n', "cannot go with a pixel"),
    ],
)
def test_what_cannot_be_is_told_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "shot.toml"
    path.write_text('[plates]\nleft = "a.####.png"\nright = "b.####.png"\n' + text)
    with pytest.raises(ShotError, match=words):
        read_shot(path)


def test_files_that_are_not_there_or_of_another_size_are_told(tmp_path: Path) -> None:
    text = LAMP + 'matte = "m"\n[[mattes]]\nname = "m"\nfile = "m.png"\n'
    with pytest.raises(PlateError, match=r"m\.png: file missing; .*lights\.toml names it"):
        lighting(tmp_path, text).check([1])
    write_still(tmp_path / "m.png", np.zeros((4, 6, 3), np.uint8))
    with pytest.raises(PlateError, match="matte 'm' is 6x4 pixels, the plate 96x64"):
        lighting(tmp_path, text).lit(1, plate=PLATE, passes=wall(), camera=CAMERA)


def test_channels_of_pictures_are_found(tmp_path: Path) -> None:
    planes = {name: np.full((4, 6), value, np.float32) for name, value in (("R", 0.1), ("G", 0.2), ("B", 0.3), ("A", 0.4), ("actor.Y", 1.001))}
    write_exr(tmp_path / "a.exr", planes)
    for channel, value in (("G", 0.2), ("actor", 1.0), ("actor.Y", 1.0), (None, 0.4)):
        np.testing.assert_allclose(matte_channel(tmp_path / "a.exr", channel), value)
    with pytest.raises(PlateError, match=r"has no channel 'actr'; did you mean 'actor\.Y'"):
        matte_channel(tmp_path / "a.exr", "actr")
    write_exr(tmp_path / "b.exr", {k: v for k, v in planes.items() if k in "RGB"})
    np.testing.assert_allclose(matte_channel(tmp_path / "b.exr", None), 0.2, rtol=1e-6)
    write_still(tmp_path / "c.png", np.full((4, 6, 3), 51, np.uint8))
    np.testing.assert_allclose(matte_channel(tmp_path / "c.png", "R"), 0.2)


def test_a_run_writes_alpha_trust_and_pose(tmp_path: Path) -> None:
    """The whole way through a shot file, and a changed pose redoes light alone."""
    write_shot(tmp_path, "sphere", size=SIZE, samples=1)
    path = tmp_path / "shot.toml"
    text = (
        path.read_text()
        .replace("[relight]", '[relight]\nmode = "light_only"\nfade = 0.8')
        .replace("[surface]", '[camera]\nfile = "c.json"\n\n[surface]')
    )
    path.write_text(text)
    (tmp_path / "c.json").write_text(json.dumps({"pose": {"position": [0, 1, 0]}}))
    run_shot(path)
    relit = read_frame(tmp_path / "out" / "relit" / "sphere.exr")
    assert {"alpha", "matte_trust", "beauty", "light_key_diffuse"} <= set(relit)
    assert relit.camera is not None
    assert relit.camera.world_from_camera[1, 3] == 1
    assert (tmp_path / "out" / "previews" / "sphere.trust.png").is_file()
    assert relit["matte_trust"].min() >= 0.2 - 1e-6
    done = []
    (tmp_path / "c.json").write_text(json.dumps({"pose": {"position": [0, 2, 0]}}))
    run_shot(path, on_event=lambda event: done.append(event.step) if event.state == "done" else None)
    assert done == ["relight", "relit previews"]


GLASS = '[environment]\nfile = "sky.exr"\nreflection = 0.5\nexposure = { keys = [[1, 0.0], [3, 1.0]] }\n'


def sky(folder: Path) -> None:
    light = np.ones((16, 32, 3), np.float32)
    light[:8] = 2.0
    write_exr(folder / "sky.exr", {c: light[..., k] for k, c in enumerate("RGB")})


def test_the_environment_lights_by_keys_mattes_and_pose(tmp_path: Path) -> None:
    """Layers of its own, a stop more on frame 3; turned by the camera's pose in the world, held by a matte; and the sum is the beauty."""
    sky(tmp_path)
    write_poses = json.dumps(
        {"frames": {"1": {"position": [0, 0, 0]}, "3": {"position": [5, 5, 5]}, "4": {"position": [0, 0, 0], "rotation_deg": [90, 0, 0]}}}
    )
    (tmp_path / "c.json").write_text(write_poses)
    made = lighting(tmp_path, LAMP + GLASS + '[camera]\nfile = "c.json"\n')
    made.check([1, 3, 4])
    one, three, four = (made.lit(n, plate=PLATE, passes=wall(), camera=made.camera(CAMERA, n)) for n in (1, 3, 4))
    assert list(one.layers) == list(three.layers) == ["light_lamp_diffuse", "light_lamp_specular", "env_diffuse", "env_reflection"]
    np.testing.assert_allclose(three.layers["env_diffuse"], 2 * one.layers["env_diffuse"], rtol=1e-5)
    # Facing the horizon a card sees as much of either half; a camera that looks straight up sees a wall that faces down.
    np.testing.assert_allclose(one.layers["env_diffuse"] / PLATE, 1.5, rtol=0.02)
    np.testing.assert_allclose(four.layers["env_diffuse"] / PLATE, 2 * 1.0, rtol=0.05)
    np.testing.assert_allclose(one.beauty, PLATE + sum(one.layers.values()), rtol=1e-6)
    held = lighting(tmp_path, GLASS + 'matte = "left"\n[[mattes]]\nname = "left"\ntype = "plane"\npoint_m = [0, 0, 0]\nnormal = [-1, 0, 0]\n')
    layers = held.lit(1, plate=PLATE, passes=wall(), camera=CAMERA).layers
    assert (layers["env_diffuse"][:, :48] > 0).all()
    assert (layers["env_diffuse"][:, 48:] == 0).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[environment]\nfil = "sky.exr"\n', r"lights.toml:2: environment: key 'fil' is unknown; did you mean 'file'"),
        ("[environment]\nexposure = 0\n", "environment: file is missing"),
        ('[environment]\nfile = "sky.exr"\nior = { keys = [[1, 1.5], [2, 20.0]] }\n', r"lights.toml:3: environment: ior must be a number"),
        ('[environment]\nfile = "none.exr"\n', r"none\.exr: file missing"),
        ("[relight]\n", "table 'lights' is missing"),
    ],
)
def test_environments_that_cannot_be_are_told(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises((ShotError, PlateError), match=words):
        lighting(tmp_path, text).check([1])


def test_the_plate_behind_glass_is_no_gain(tmp_path: Path) -> None:
    text = '[environment]\ndiffuse = 0\nrefraction = 1\nbackdrop = "plate"\n'
    lit = lighting(tmp_path, text).lit(1, plate=PLATE, passes=wall(), camera=CAMERA)
    assert list(lit.layers) == ["env_refraction"]
    assert lit.layers["env_refraction"].max() > 0.3
    with pytest.raises(ShotError, match="cannot gain"):
        lighting(tmp_path, text + '[relight]\nmode = "multiply"\n').lit(1, plate=PLATE, passes=wall(), camera=CAMERA)


SURFACES = (
    '[[mattes]]\nname = "left"\ntype = "plane"\npoint_m = [0, 0, 0]\nnormal = [-1, 0, 0]\n'
    '[[materials]]\nname = "lacquer"\nmatte = "left"\nmodel = "ggx"\nroughness = { keys = [[1, 0.2], [9, 0.6]] }\nspecular = 1.0\n'
)


def test_a_material_shines_in_its_matte_alone(tmp_path: Path) -> None:
    dull = LAMP.replace("specular = 0.2", "specular = 0.0").replace("[0.3, 0.2, -1]", "[0, 0, -1]")
    made = lighting(tmp_path, dull + SURFACES)
    first, last = (made.lit(n, plate=PLATE, passes=wall(), camera=CAMERA).layers["light_lamp_specular"] for n in (1, 9))
    assert (first[:, 48:] == 0).all()
    assert first[:, :48].max() > 2 * last[:, :48].max() > 0
    path = tmp_path / "shot.toml"
    path.write_text('[plates]\nleft = "a.####.png"\nright = "b.####.png"\n' + SURFACES.replace('matte = "left"', 'matte = "lft"'))
    with pytest.raises(ShotError, match=r"material 'lacquer': matte 'lft' is missing; did you mean 'left'"):
        read_shot(path)
    with pytest.raises(ShotError, match=r"lights\.toml:\d+: material 'lacquer': roughness .* 0 \.\.\. 1"):
        lighting(tmp_path, dull + SURFACES.replace("0.6]", "1.6]"))


def test_solo_and_groups(tmp_path: Path) -> None:
    """A solo light stands alone while it is on; a group is the sum of its lights, and no part of the beauty."""
    fill = LAMP.replace("lamp", "fill") + 'group = "set"\n'
    key = LAMP.replace("lamp", "key") + 'group = "set"\n'
    lit = lighting(tmp_path, fill + key + LAMP).lit(1, plate=PLATE, passes=wall(), camera=CAMERA)
    np.testing.assert_allclose(lit.passes()["group_set"], sum(lit.layers[n] for n in lit.layers if "lamp" not in n), rtol=1e-5)
    np.testing.assert_allclose(lit.beauty, PLATE + sum(lit.layers.values()), rtol=1e-5)
    solo = lighting(tmp_path, fill + key + 'solo = true\nenabled = { keys = [[1, true], [5, false]], ease = "step" }\n')
    on, off = (solo.lit(n, plate=PLATE, passes=wall(), camera=CAMERA).layers for n in (1, 5))
    assert list(on) == list(off)
    assert (on["light_fill_diffuse"] == 0).all()
    assert (off["light_fill_diffuse"] > 0).all()
    assert (off["light_key_diffuse"] == 0).all()
    always = lighting(tmp_path, fill + key + "solo = true\n")
    assert always.setup.layer_names == ["light_key_diffuse", "light_key_specular"]


def test_lights_with_a_size_go_with_keys_points_and_mattes(tmp_path: Path) -> None:
    soft = LAMP.replace('type = "point"', 'type = "rect"').replace("[0.3, 0.2, -1]", "{ pixel = [48, 32], offset_m = [0, 0, 0.8] }")
    text = soft + "size_m = { keys = [[1, [0.1, 0.1]], [9, [0.8, 0.4]]] }\ndirection = [0, 0, -1]\n"
    made = lighting(tmp_path, text)
    small, large = (made.lit(n, plate=PLATE, passes=wall(), camera=CAMERA).layers["light_lamp_diffuse"] / PLATE for n in (1, 9))
    assert small[32, 48, 0] > large[32, 48, 0] > 0
