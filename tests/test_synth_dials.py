"""The dials of synthetic shots: each does what it says, by as much as it says, and the same every time."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stereorelight.calibration.board import parse_board
from stereorelight.calibration.drift import Drift, apply
from stereorelight.cli.group import main
from stereorelight.compare.rigs import compare_rigs
from stereorelight.errors import ShotError
from stereorelight.interchange.poses import read_poses
from stereorelight.interchange.rigs import read_rig
from stereorelight.passes import Flag
from stereorelight.shot.synthetic import FIRST_FRAME, write_session, write_shot
from stereorelight.synth.board_view import BLACK, WHITE, board_picture, board_poses
from stereorelight.synth.bounce import evened, gathered
from stereorelight.synth.dials import Dials, bent, knocked, recorded, softened, swayed
from stereorelight.synth.lights import Light
from stereorelight.synth.render import render
from stereorelight.synth.rigs import parallel_rig, rig_named
from stereorelight.synth.scene import Material, Object, Scene, rotation
from stereorelight.synth.scenes import scene_named

SIZE = (96, 64)


def test_grain_is_as_strong_as_it_says_new_each_frame_and_the_same_again() -> None:
    grey = np.full((200, 300, 3), 0.25, np.float32)
    dials = Dials(grain=0.01, photon_grain=0.001, seed=3)
    first = recorded(grey, "left", dials, frame=4)
    assert (first - grey).std() == pytest.approx(math.sqrt(0.01**2 + 0.001 * 0.25), rel=0.01)
    assert abs((first - grey).mean()) < 3e-4
    np.testing.assert_array_equal(first, recorded(grey, "left", dials, frame=4))
    for other in (
        recorded(grey, "right", dials, frame=4),
        recorded(grey, "left", dials, frame=5),
        recorded(grey, "left", replace(dials, seed=4), frame=4),
    ):
        assert abs(np.corrcoef((first - grey).ravel(), (other - grey).ravel())[0, 1]) < 0.02


def test_focus_exposure_and_colour_are_those_of_the_dials() -> None:
    spot = np.zeros((41, 41, 3))
    spot[20, 20] = 1
    x = np.arange(41) - 20
    for sigma in (0.5, 1.5, 3.0):
        soft = softened(spot, sigma)[..., 0]
        assert soft.sum() == pytest.approx(1, abs=1e-9)
        assert (soft.sum(axis=0) * x**2).sum() == pytest.approx(sigma**2 + 1 / 12, rel=0.03)  # of the Gaussian, and of the pixel itself
    grey = np.full((*SIZE, 3), 0.2, np.float32)
    dials = Dials(exposure_stops=0.5, cast=(1.1, 1.0, 0.9))
    np.testing.assert_array_equal(recorded(grey, "left", dials), grey)
    np.testing.assert_allclose(recorded(grey, "right", dials), grey * np.array([1.1, 1.0, 0.9]) * 2**0.5, rtol=1e-6)
    np.testing.assert_array_equal(recorded(grey, "right", Dials()), grey)


def test_a_knock_is_a_drift_as_mending_finds_it() -> None:
    rig = rig_named("toed-in", SIZE)
    dials = Dials(pitch_deg=0.3, yaw_deg=-0.2, roll_deg=0.5, zoom_percent=0.4)
    drift = Drift(pitch_deg=0.3, yaw_deg=-0.2, roll_deg=0.5, zoom=1.004, sigmas={}, held=())
    wanted, found = apply(rig, drift), knocked(rig, dials)
    np.testing.assert_allclose(found.R_right_left, wanted.R_right_left, atol=1e-12)
    np.testing.assert_allclose(found.t_right_left_m, wanted.t_right_left_m, atol=1e-12)
    np.testing.assert_allclose(found.right.K, wanted.right.K, atol=1e-9)
    raised = knocked(rig, Dials(rise_mm=3))
    np.testing.assert_allclose(raised.right_centre_m - rig.right_centre_m, (0, -0.003, 0), atol=1e-12)
    assert knocked(rig, Dials()) is rig
    assert bent(parallel_rig(SIZE), Dials(bend=-0.1)).right.distortion[0] == -0.1


def test_a_late_eye_shows_an_earlier_frame() -> None:
    rig = parallel_rig(SIZE)
    at = {f: scene_named("sphere", frame=f, motion=True) for f in (3, 2.65)}
    late = render(at[3], rig, samples=1, right=(at[2.65], rig))
    then = render(at[2.65], rig, samples=1)
    now = render(at[3], rig, samples=1)
    np.testing.assert_array_equal(late.right["plate"], then.right["plate"])
    np.testing.assert_array_equal(late.left["plate"], now.left["plate"])
    assert (late.right["plate"] != now.right["plate"]).any()


def test_a_moving_camera_leaves_the_world_where_it_is() -> None:
    rig, scene = parallel_rig(SIZE), scene_named("box")
    for frame in (0, 7, 20.5):
        moved = swayed(rig, frame)
        shot = render(scene, moved, samples=1, lights=())
        world = shot.left["P"].astype(float) @ moved.left.world_from_camera[:3, :3].T + moved.left.world_from_camera[:3, 3]
        wall = shot.objects["left"] == shot.object_names.index("wall")
        np.testing.assert_allclose(world[wall][:, 2], -2.5, atol=2e-6)
    np.testing.assert_array_equal(swayed(rig, 0).left.world_from_camera, np.eye(4))


def test_a_shot_with_faults_says_what_is_true(tmp_path: Path) -> None:
    dials = Dials(roll_deg=0.5, exposure_stops=0.2, grain=0.002, right_late_frames=0.5, bend=-0.05)
    write_shot(tmp_path, "sphere", size=SIZE, samples=1, frames=2, dials=dials, motion="both")
    calibrated, stands = read_rig(tmp_path / "rig.json"), read_rig(tmp_path / "truth" / "rig.json")
    assert calibrated.left.distortion[0] == -0.05
    np.testing.assert_allclose(stands.R_right_left, knocked(calibrated, dials).R_right_left, atol=1e-12)
    poses = read_poses(tmp_path / "camera.json")
    np.testing.assert_allclose(poses.at(FIRST_FRAME + 1), swayed(calibrated, 1).left.world_from_camera, atol=1e-12)
    assert 'file = "camera.json"' in (tmp_path / "shot.toml").read_text()


def test_a_board_is_true_to_its_corners() -> None:
    """Each corner of the chessboard part lies where the four pixels about it are half dark: no corner finder judges itself here."""
    board = parse_board("charuco:7x5:0.040:0.030:DICT_5X5_100")
    camera = parallel_rig((320, 200)).left
    R, t = board_poses(board.extent_m, camera, 4)[3]
    picture = board_picture(board.rectangles_m, board.extent_m, board.quiet_m, camera, R, t)
    assert BLACK * 0.8 < picture.min() < BLACK * 1.2
    assert WHITE * 0.9 < picture.max() < WHITE * 1.15
    corners = camera.project(board.points_m @ R.T + t)
    for u, v in corners:
        if 8 < u < 311 and 8 < v < 191:
            i, j = round(u), round(v)
            around = picture[j - 2 : j + 3, i - 2 : i + 3]
            assert around.min() < 0.2 * WHITE
            assert around.max() > 0.8 * WHITE
            assert around.mean() == pytest.approx((WHITE + BLACK) / 2, rel=0.35)


@pytest.mark.slow
def test_a_session_calibrates_to_its_own_rig(tmp_path: Path) -> None:
    """Board pictures through `calibrate` give back the rig that took them: pixels over the frame, rows, baseline."""
    spec = "charuco:7x5:0.040:0.030:DICT_5X5_100"
    write_session(tmp_path, board=spec, views=6, size=(400, 250), rig="toed-in", dials=Dials(grain=0.002))
    plates = [str(tmp_path / "plates" / f"{eye}.####.png") for eye in ("left", "right")]
    told = CliRunner().invoke(main, ["calibrate", *plates, "--board", spec, "--out", str(tmp_path / "found.json"), "--lens", "brown4", "--json"])
    assert told.exit_code == 0, told.output
    apart = compare_rigs(read_rig(tmp_path / "found.json"), read_rig(tmp_path / "rig.json"), distances_m=(1.0,))
    assert np.nanmean(np.abs(apart.pairs[0].vertical_px)) < 0.03
    assert np.nanmean(np.abs(apart.pairs[0].disparity_px)) < 0.05
    assert apart.baseline_mm[0] == pytest.approx(apart.baseline_mm[1], rel=1e-3)
    assert apart.turn_deg < 0.05


def box(albedo: float) -> Scene:
    """A closed room of 2 m, its walls facing in."""
    card = Material(color=(albedo, albedo, albedo))
    turns = ({}, {"y_deg": 180.0}, {"y_deg": 90.0}, {"y_deg": -90.0}, {"x_deg": 90.0}, {"x_deg": -90.0})
    walls = []
    for n, turned in enumerate(turns):
        R = rotation(**turned)
        back = -R[:, 2]
        walls.append(
            Object(
                name=f"wall_{n}",
                kind="plane",
                material=card,
                origin_m=(float(back[0]), float(back[1]), float(back[2])),
                R_world_object=R,
                size=(1.0, 1.0),
            )
        )
    return Scene(name="box", objects=tuple(walls), ambient=(0.8, 0.4, 0.2))


def test_two_bounces_in_a_closed_room() -> None:
    """Each bounce takes the albedo of the walls off the flat light at the end: plate = albedo^3 ambient, whatever the rays."""
    rig = parallel_rig((32, 20), fov_deg=60.0)
    shot = render(box(0.5), rig, lights=(), samples=1, bounce=3)
    np.testing.assert_allclose(shot.left["plate"], np.broadcast_to(0.125 * np.array([0.8, 0.4, 0.2]), shot.left["plate"].shape), rtol=1e-4)
    np.testing.assert_array_equal(shot.left["plate"], shot.left["light_indirect"])


def test_a_wall_gathers_half_of_what_the_floor_before_it_sends() -> None:
    """Form factor of an endless floor for a small upright patch: 1/2.  The sun shines straight down; nothing else gives light."""
    floor = Object(name="floor", kind="plane", material=Material(color=(0.6, 0.6, 0.6)), origin_m=(0, -1, 0), R_world_object=rotation(x_deg=-90.0))
    tables = Scene(name="s", objects=(floor,)).tables()
    points = np.tile([[0.0, 0.0, 0.0]], (400, 1))
    sun = Light(name="sun", type="directional", direction=(0.0, -1.0, 0.0))
    found = gathered(tables, points, np.tile([[0.0, 0.0, 1.0]], (400, 1)), (sun,), (0.0, 0.0, 0.0), 8)
    np.testing.assert_allclose(found.mean(axis=0), 0.3, rtol=0.02)
    up = gathered(tables, points[:4], np.tile([[0.0, 1.0, 0.0]], (4, 1)), (sun,), (0.0, 0.0, 0.0), 8)
    assert not up.any()


def test_evening_out_keeps_to_one_surface() -> None:
    light = np.zeros((9, 9, 3))
    light[:, 5:] = 1
    objects = np.where(np.arange(9)[None] < 5, 0, 1).repeat(9, axis=0)
    normals = np.tile([0.0, 0.0, 1.0], (9, 9, 1))
    np.testing.assert_array_equal(evened(light, objects, normals, np.ones((9, 9))), light)
    mixed = evened(light, np.zeros((9, 9), int), normals, np.ones((9, 9)))
    assert 0 < mixed[4, 4, 0] < 1


def test_the_same_bounces_every_time() -> None:
    a, b = (render(scene_named("box"), parallel_rig((48, 32)), samples=1, bounce=2).left["plate"] for _ in range(2))
    assert a.tobytes() == b.tobytes()


def test_an_area_light_is_a_point_light_from_afar_and_soft_near_by() -> None:
    wall = Object(name="wall", kind="plane", material=Material(color=(1, 1, 1)), origin_m=(0.0, 0.0, -2.0))
    card = Object(name="card", kind="plane", material=Material(color=(1, 1, 1)), origin_m=(0.0, 0.0, -1.6), size=(0.1, 2.0))
    place = {"position_m": (0.0, 0.0, 1.0), "direction": (0.0, 0.0, -1.0), "intensity": 9.0}
    small = Light(name="a", type="area", side_u_m=(0.001, 0, 0), side_v_m=(0, 0.001, 0), **place)  # type: ignore[arg-type]
    large = Light(name="b", type="area", side_u_m=(0.3, 0, 0), side_v_m=(0, 0.3, 0), **place)  # type: ignore[arg-type]
    rig = parallel_rig((96, 24), fov_deg=30.0)
    open_ = render(Scene(name="s", objects=(wall,)), rig, lights=(small,), samples=1).left
    cosine = 3 / np.linalg.norm(open_["P"].astype(float) - (0, 0, 1), axis=-1)
    np.testing.assert_allclose(open_["plate"][..., 0], cosine**4, rtol=1e-4)
    shares = [
        render(Scene(name="s", objects=(wall, card)), rig, lights=(light,), samples=1).left[f"matte_lit_{light.name}"] for light in (small, large)
    ]
    soft = [((s > 0.02) & (s < 0.98)).sum() for s in shares]
    assert soft[1] > soft[0] + 100
    assert (render(scene_named("plane"), rig, samples=1).left["flags"] & Flag.TOO_FAR == 0).all()


def test_dials_refuse_nonsense_and_the_command_says_so(tmp_path: Path) -> None:
    for words, changed in (
        ("grain", {"grain": -1.0}),
        ("blur_px", {"blur_px": (0.0, 80.0)}),
        ("cast", {"cast": (0.0, 1.0, 1.0)}),
        ("finite", {"roll_deg": math.nan}),
        ("another rig", {"roll_deg": 40.0}),
        ("bend", {"bend": 0.9}),
        ("exposure", {"exposure_stops": 30.0}),
    ):
        with pytest.raises(ShotError, match=words):
            Dials(**changed)  # type: ignore[arg-type]
    with pytest.raises(ShotError, match="did you mean 'camera'"):
        write_shot(tmp_path / "a", "plane", size=SIZE, motion="camerra")  # type: ignore[arg-type]
    with pytest.raises(ShotError, match="stands still"):
        write_session(tmp_path / "b", dials=Dials(right_late_frames=1))
    with pytest.raises(ShotError, match="views"):
        write_session(tmp_path / "b", views=0)
    with pytest.raises(ShotError, match="bends by itself"):
        bent(rig_named("distorted", SIZE), Dials(bend=0.1))
    with pytest.raises(ShotError, match="bounce"):
        render(scene_named("plane"), parallel_rig(SIZE), bounce=-1)
    run = CliRunner().invoke(main, ["synth", "plane", "--out", str(tmp_path / "c"), "--size", "64x48", "--cast", "1,1"])
    assert run.exit_code == 2
    assert "1.08,1,0.97" in run.output
    assert not (tmp_path / "a").exists()


def test_the_command_takes_every_dial(tmp_path: Path) -> None:
    words = "synth plane --size 64x48 --samples 1 --frames 2 --motion camera --noise 0.001 --photon-grain 0.0001 --blur 0.4,0.8"
    words += " --exposure 0.2 --cast 1.1,1,0.9"
    words += " --pitch 0.1 --yaw 0.1 --roll 0.3 --zoom 0.2 --rise 1 --bend -0.05 --late 0.5 --seed 2 --json"
    told = CliRunner().invoke(main, [*words.split(), "--out", str(tmp_path / "s")])
    assert told.exit_code == 0, told.output
    files = {Path(f).name for f in json.loads(told.output[told.output.index("{") :])["files"]}
    assert {"shot.toml", "rig.json", "camera.json", "left.1002.png", "plane.1001.exr"} <= files
