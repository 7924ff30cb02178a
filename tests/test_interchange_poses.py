"""Camera poses: what goes in comes out in metres and our axes; a world light stays on the set while the camera moves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError
from stereorelight.interchange.poses import FLIP, Poses, of_left_eye, poses_from_chan, poses_from_dict, read_poses, write_poses
from stereorelight.interchange.turns import ORDERS, angles_of, rotation_of
from stereorelight.light.lights import SpotLight
from stereorelight.light.shade import light_layers
from stereorelight.synth.render import render, world_from_eye
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named


def pose(angles: tuple[float, float, float], place: tuple[float, float, float], order: str = "ZXY") -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation_of(angles, order), place
    return made


@pytest.mark.parametrize("order", ORDERS)
def test_angles_and_rotations_are_inverse(order: str) -> None:
    for angles in np.random.default_rng(0).uniform(-89, 89, (20, 3)):
        np.testing.assert_allclose(angles_of(rotation_of(angles, order), order), angles, atol=1e-9)
    for tilt in (90, -90):  # two axes together: another triple, the same rotation
        angles = [0.0, 0.0, 0.0]
        angles["XYZ".index(order[1])], angles["XYZ".index(order[2])] = tilt, 30
        R = rotation_of(angles, order)
        np.testing.assert_allclose(rotation_of(angles_of(R, order), order), R, atol=1e-9)


def test_zxy_rolls_then_tilts_then_pans() -> None:
    """Nuke's default: a camera panned 90 degrees left looks down -x, whatever its tilt; tilted up it looks up."""
    looks = rotation_of((30, 90, 50), "ZXY") @ (0, 0, -1)
    np.testing.assert_allclose(looks, (-np.cos(np.radians(30)), 0.5, 0), atol=1e-12)


def test_chan_is_read_in_its_unit_and_order() -> None:
    poses = poses_from_chan("# a camera\n1001 100 150 -20  0 90 0  35.2\n1002 0 0 0 30 0 0\n", unit_m=0.01)
    np.testing.assert_allclose(poses.at(1001)[:3, 3], (1.0, 1.5, -0.2))
    np.testing.assert_allclose(poses.at(1001)[:3, :3] @ (0, 0, -1), (-1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(poses.at(1002)[:3, :3] @ (0, 0, -1), (0, 0.5, -np.sqrt(0.75)), atol=1e-12)


@pytest.mark.parametrize("suffix", ["json", "chan"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    frames = {n: pose((5.0 * n, -70 + n, 3), (0.1 * n, 2, -n)) for n in range(1, 5)}
    path = write_poses(tmp_path / f"camera.{suffix}", Poses(frames=frames))
    again = read_poses(path)
    assert list(again.frames) == list(frames)
    for n, matrix in frames.items():
        np.testing.assert_allclose(again.at(n), matrix, atol=1e-9)


def test_ways_to_say_one_pose() -> None:
    """A matrix, angles, a quaternion; an OpenCV camera; a world whose z is up; centimetres: the same pose."""
    R = rotation_of((20, 30, 40), "ZXY")
    true = np.eye(4)
    true[:3, :3], true[:3, 3] = R, (1, 2, 3)
    w = np.sqrt(1 + np.trace(R)) / 2
    quaternion = [w, *(np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w))]
    opencv = true.copy()
    opencv[:3, :3] = R @ FLIP
    z_up = np.eye(4)
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # our y is its z
    z_up[:3, :3], z_up[:3, 3] = turn @ R, turn @ (1, 2, 3)
    said = [
        {"pose": {"world_from_camera": true.tolist()}},
        {"pose": {"position": [1, 2, 3], "rotation_deg": [20, 30, 40]}},
        {"pose": {"position": [1, 2, 3], "quaternion_wxyz": quaternion}},
        {"axes": "opencv", "pose": {"world_from_camera": opencv.tolist()}},
        {"up": "z", "pose": {"world_from_camera": z_up.tolist()}},
        {"unit_m": 0.01, "frames": {"7": {"position": [100, 200, 300], "rotation_deg": angles_of(R, "XYZ"), "rotation_order": "xyz"}}},
    ]
    for table in said:
        np.testing.assert_allclose(poses_from_dict(json.loads(json.dumps(table))).at(7), true, atol=1e-12)


def test_the_right_eyes_pose_says_the_left_ones() -> None:
    rig = parallel_rig((64, 48))
    rig = replace(rig, left=replace(rig.left, world_from_camera=pose((5, 40, 2), (1, 2, 3))), R_right_left=rotation_of((1, 2, 0.5), "XYZ"))
    np.testing.assert_allclose(of_left_eye(world_from_eye(rig, "right"), "right", rig), rig.left.world_from_camera, atol=1e-9)
    with pytest.raises(RigError, match="only through the rig"):
        of_left_eye(np.eye(4), "right", None)


STRETCHED = np.diag([1.0, 2.0, 1.0, 1.0]).tolist()
ROW_VECTORS = pose((0, 0, 0), (1, 2, 3)).T.tolist()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "give frames, or pose"),
        ({"frames": {}}, "must be a table of frame number"),
        ({"frames": {"a": {"position": [0, 0, 0]}}}, "'a' is no frame number"),
        ({"pose": {"position": [0, 0]}}, "must be 3 numbers"),
        ({"pose": {"positon": [0, 0, 0]}}, "did you mean 'position'"),
        ({"pose": {"position": [0, 0, 0], "rotation_deg": [0, 0, 0], "rotation_order": "YYX"}}, "rotation order 'YYX' is unknown"),
        ({"pose": {"world_from_camera": STRETCHED}}, "is no rotation"),
        ({"pose": {"world_from_camera": np.diag([2.0, 2, 2, 1]).tolist()}}, "is scaled by 2"),
        ({"pose": {"world_from_camera": np.diag([1.0, 1, -1, 1]).tolist()}}, "is a reflection"),
        ({"pose": {"world_from_camera": ROW_VECTORS}}, "transpose the matrix"),
        ({"axes": "nuke", "pose": {"position": [0, 0, 0]}}, "axes 'nuke' is unknown"),
        ({"unit_m": 0, "pose": {"position": [0, 0, 0]}}, "unit_m must be > 0"),
        ({"version": 2, "pose": {"position": [0, 0, 0]}}, "newer stereorelight"),
    ],
)
def test_what_no_camera_can_be_is_told(tmp_path: Path, table: dict, words: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(table))
    with pytest.raises(RigError, match=words) as told:
        read_poses(path)
    assert str(path) in str(told.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no frame"),
        ("1 2 3\n", "line 1: must hold 7 or 8"),
        ("1 0 0 0 0 0 x\n", "line 1: must be numbers"),
        ("1 0 0 0 0 0 nan\n", "not finite"),
    ]
    + [("1.5 0 0 0 0 0 0\n", "whole number"), ("1 0 0 0 0 0 0\n1 0 0 0 0 0 0\n", "line 2: frame 1 stands at line 1")],
)
def test_a_bad_chan_is_told_by_its_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "c.chan").write_text(text)
    with pytest.raises(RigError, match=words):
        read_poses(tmp_path / "c.chan")


def test_a_frame_without_a_pose_is_told() -> None:
    poses = poses_from_chan("3 0 0 0 0 0 0\n4 0 0 0 0 0 0\n", name="c.chan")
    with pytest.raises(RigError, match=r"c.chan: has no pose for frame 5; it has 2 frames, 3 to 4"):
        poses.at(5)
    assert poses.shifted(1).at(5) is poses.at(4)


PLACES = [(0.0, 0.0, 0.0), (0.15, 0.05, -0.1), (0.3, 0.0, 0.1)]


def moved(rig: Rig, n: int) -> Rig:
    return replace(rig, left=replace(rig.left, world_from_camera=pose((2.0 * n, 4.0 * n, 3.0 * n), PLACES[n])))


def test_a_world_light_stays_on_the_set_while_the_camera_moves() -> None:
    """The value of one surface point under a world light is the same on every frame of a moving camera."""
    rig, scene = parallel_rig((192, 128)), scene_named("sphere")
    key = SpotLight(name="key", position_m=(0.8, 0.9, -0.6), aim_m=(0, 0, -2), cone_deg=50, penumbra_deg=20, intensity=4, space="world")
    lit, cameras, shots = [], [], []
    for n in range(len(PLACES)):
        shot = render(scene, moved(rig, n), lights=(), samples=1, shadows=False).left
        camera = shot.camera
        assert isinstance(camera, Camera)
        layers = light_layers(shot["P"], shot["N"], np.ones_like(shot["P"]), [key], camera=camera)
        lit.append(layers["light_key_diffuse"][..., 0])
        cameras.append(camera)
        shots.append(shot)
    P = shots[0]["P"].astype(np.float64)
    compared = 0
    for y, x in np.argwhere(lit[0] > 0.05 * lit[0].max())[::37]:
        values = [lit[0][y, x]]
        for n in (1, 2):
            here = (P[y, x] - cameras[n].world_from_camera[:3, 3]) @ cameras[n].world_from_camera[:3, :3]
            u, v = cameras[n].project(here @ FLIP)
            if not (1 <= u < 190 and 1 <= v < 126):
                continue
            i, j = int(v), int(u)
            patch = shots[n]["Z"][i : i + 2, j : j + 2]
            if np.ptp(patch) > 0.02 or abs(patch.mean() + here[2]) > 0.01:
                continue  # an edge, or hidden on this frame
            a, b = u - j, v - i
            corner = lit[n][i : i + 2, j : j + 2]
            values.append(float((1 - b) * ((1 - a) * corner[0, 0] + a * corner[0, 1]) + b * ((1 - a) * corner[1, 0] + a * corner[1, 1])))
        compared += len(values) - 1
        np.testing.assert_allclose(values, values[0], rtol=0.01, atol=1e-3 * float(lit[0].max()))
    assert compared > 200
    stuck = light_layers(shots[2]["P"], shots[2]["N"], np.ones_like(P), [replace(key, space="camera")], camera=cameras[2])["light_key_diffuse"]
    assert np.abs(stuck[..., 0] - lit[2]).max() > 0.2 * lit[2].max(), "or it would prove nothing"
