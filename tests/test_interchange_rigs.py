"""Rigs of other packages: the same rig back from every dialect, their own files read as they write them, a clear word for the rest."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera, Rig
from stereorelight.errors import OutputError, RigError
from stereorelight.interchange.meshroom import meshroom_from_rig
from stereorelight.interchange.parts import rotation_from_vector, vector_from_rotation
from stereorelight.interchange.rig_files import DIALECTS, read_any_rig, read_rig_file, write_rig_as
from stereorelight.interchange.yaml_text import parse_yaml

TEXT_DIGITS = 1e-12  # repr keeps every bit; what is left is rounding in R^T R
LENSES = {
    "none": ("brown", ()),
    "radial": ("brown", (-0.12, 0.03, 0.0, 0.0, -0.002)),
    "brown4": ("brown", (-0.12, 0.03, 1e-4, -2e-4)),
    "brown5": ("brown", (-0.12, 0.03, 1e-4, -2e-4, -0.002)),
    "rational": ("rational", (0.2, -0.1, 1e-4, -2e-4, 0.02, 0.3, -0.05, 0.01)),
    "fisheye": ("fisheye", (0.02, -0.003, 0.001, -0.0002)),
}
SAYS = {
    "opencv": set(LENSES),
    "kalibr": {"none", "brown4", "fisheye"},
    "mrcal": {"none", "radial", "brown4", "brown5", "rational"},
    "ros": set(LENSES),
    "meshroom": {"none", "radial", "brown4", "brown5", "fisheye"},
    "stereorelight": set(LENSES),
}


def rig_with(lens: str, *, vector: tuple[float, float, float] = (0.011, -0.034, 0.007), other_size: bool = False) -> Rig:
    model, c = LENSES[lens]
    R = rotation_from_vector(vector)
    left = Camera(size=(1920, 1080), K=[[1812.25, 0, 949.125], [0, 1809.5, 551.0625], [0, 0, 1]], model=model, distortion=c)
    right = Camera(
        size=(1280, 720) if other_size else (1920, 1080),
        K=[[1799.1, 0, 640.3 if other_size else 971.7], [0, 1800.9, 355.2 if other_size else 530.3], [0, 0, 1]],
        model=model,
        distortion=c,
    )
    return Rig(left=left, right=right, R_right_left=R, t_right_left_m=-R @ np.array([0.0653, 0.0011, -0.0023]))


def padded(camera: Camera) -> list[float]:
    return (list(camera.distortion) + [0.0] * 8)[:8]


def assert_same(a: Rig, b: Rig, tolerance: float = TEXT_DIGITS) -> None:
    for x, y in ((a.left, b.left), (a.right, b.right)):
        assert x.size == y.size
        assert np.allclose(x.K, y.K, rtol=tolerance, atol=0)
        assert padded(x) == padded(y)
        assert (x.model == "fisheye") == (y.model == "fisheye")
    assert np.abs(a.R_right_left - b.R_right_left).max() <= tolerance
    assert np.abs(a.t_right_left_m - b.t_right_left_m).max() <= tolerance


def written(folder: Path, text: str, name: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_same_rig_comes_back_or_the_dialect_says_why_not(dialect: str, lens: str, tmp_path: Path) -> None:
    for other_size in (False, True):
        rig = rig_with(lens, other_size=other_size)
        target = tmp_path / f"rig_{other_size}.txt"
        if lens not in SAYS[dialect]:
            with pytest.raises(RigError, match=r"cannot say a (brown|rational|fisheye) lens .*; .*(calibrate|write)"):
                write_rig_as(target, rig, dialect)
            assert not list(tmp_path.iterdir())
            continue
        files = write_rig_as(target, rig, dialect)
        assert {read_rig_file(f).dialect for f in files} == {dialect}
        assert_same(read_any_rig(files), rig)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(vector=st.tuples(*[st.floats(-0.5, 0.5)] * 3), dialect=st.sampled_from(DIALECTS))
def test_any_toe_in_and_roll_comes_back(vector: tuple[float, float, float], dialect: str, tmp_path: Path) -> None:
    rig = rig_with("brown4", vector=vector)
    assert_same(read_any_rig(write_rig_as(tmp_path / "rig", rig, dialect, force=True)), rig)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, 3.0, math.pi - 1e-9, math.pi])
def test_rotation_vectors_are_exact_from_nothing_to_half_a_turn(angle: float) -> None:
    for axis in ((1, 0, 0), (0.6, -0.8, 0), (0.48, 0.6, 0.64)):
        R = rotation_from_vector(np.array(axis) * angle)
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
        assert np.abs(rotation_from_vector(vector_from_rotation(R)) - R).max() < 1e-14


def test_opencv_itself_reads_and_writes_the_same(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    rig = rig_with("rational")
    for suffix in ("yml", "json"):
        (path,) = write_rig_as(tmp_path / f"ours.{suffix}", rig, "opencv")
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        assert np.array_equal(storage.getNode("M1").mat(), rig.left.K)
        assert np.array_equal(storage.getNode("D2").mat().ravel(), rig.right.distortion)
        assert np.array_equal(storage.getNode("R").mat(), rig.R_right_left)
        assert np.array_equal(storage.getNode("T").mat(), rig.t_right_left_m[:, None])
        storage.release()
        theirs = [str(tmp_path / f"{name}.{suffix}") for name in ("intrinsics", "extrinsics")]
        out = cv2.FileStorage(theirs[0], cv2.FILE_STORAGE_WRITE)
        for key, value in (("M1", rig.left.K), ("D1", rig.left.distortion), ("M2", rig.right.K), ("D2", rig.right.distortion)):
            out.write(key, np.atleast_2d(np.array(value)))
        out.release()
        out = cv2.FileStorage(theirs[1], cv2.FILE_STORAGE_WRITE)
        for key, value in (("R", rig.R_right_left), ("T", rig.t_right_left_m[:, None]), ("R1", np.eye(3)), ("P1", np.eye(3, 4)), ("Q", np.eye(4))):
            out.write(key, np.array(value))
        out.release()
        with pytest.raises(RigError, match="size of the picture"):
            read_any_rig(theirs)
        assert_same(read_any_rig(theirs, size=(1920, 1080)), rig, 1e-15)


def test_opencv_projects_as_the_rig_it_was_given(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    rig = rig_with("brown5")
    points = np.random.default_rng(4).uniform((-0.4, -0.2, 1), (0.4, 0.2, 3), (50, 3))
    (path,) = write_rig_as(tmp_path / "rig.yml", rig, "opencv")
    f = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    K, D, R, T = (f.getNode(key).mat() for key in ("M2", "D2", "R", "T"))
    px, _ = cv2.projectPoints(points, cv2.Rodrigues(R)[0], T, K, D)
    ours = rig.right.project(points @ rig.R_right_left.T + rig.t_right_left_m)
    assert np.abs(px[:, 0] - ours).max() < 1e-9


KALIBR = """cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.07]
  - [-1.0, 0.0, 0.0, -0.02]
  - [0.0, 0.0, 1.0, 0.004]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2834, 0.0739, 0.00019, 1.762e-05]
  distortion_model: radtan
  intrinsics: [458.65, 457.29, 367.21, 248.37]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -8.1e-05
cam1:
  T_cn_cnm1:
  - [0.99999, 0.0, 0.004472125, -0.11]
  - [0.0, 1.0, 0.0, 0.0004]
  - [-0.004472125, 0.0, 0.99999, -0.0008]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.2836, 0.0745,
    -0.0001, -3.55e-05]
  distortion_model: radtan
  intrinsics: [457.58, 456.13, 379.99, 255.23]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""


def test_a_camchain_as_kalibr_writes_it(tmp_path: Path) -> None:
    file = read_rig_file(written(tmp_path, KALIBR, "camchain.yaml"))
    assert (file.dialect, file.evidence) == ("kalibr", "cam0 with a camera_model")
    rig = read_any_rig(file.path)
    assert rig.left.size == (752, 480)
    assert rig.left.K.tolist() == [[458.65, 0, 367.21], [0, 457.29, 248.37], [0, 0, 1]]
    assert rig.right.distortion == (-0.2836, 0.0745, -0.0001, -3.55e-05)
    assert rig.t_right_left_m.tolist() == [-0.11, 0.0004, -0.0008]
    assert rig.R_right_left[0, 2] == pytest.approx(0.004472125, abs=1e-6)


def test_kalibr_cameras_in_the_other_order_are_put_right(tmp_path: Path) -> None:
    text = KALIBR.replace("0.004472125, -0.11]", "0.004472125, 0.11]")
    rig = read_any_rig(written(tmp_path, text, "camchain.yaml"))
    assert rig.left.fx == 457.58  # cam1 stands to the left
    assert rig.right_centre_m[0] == pytest.approx(0.11, abs=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("camera_model: pinhole", "camera_model: omni", r"camera_model 'omni' cannot be said"),
        ("distortion_model: radtan", "distortion_model: fov", r"distortion_model 'fov' cannot be said"),
        ("intrinsics: [458.65,", "intrinsics: [", r"cam0 intrinsics must be 4 numbers, got 3"),
        ("-0.11]", "-110.0]", r"apart, which cannot be metres.*0.001 for millimetres"),
        ("  T_cn_cnm1:", "  T_other:", r"cam1: key 'T_cn_cnm1' is missing"),
        ("cam1:", "cam7x:", r"two cameras is wanted, got cam0"),
        ("[457.58, 456.13, 379.99, 255.23]", "[457.58, 456.13", r"bracket|not understood"),
        ("  resolution: [752, 480]", "\tresolution: [752, 480]", r"line \d+: a tab"),
    ],
)
def test_what_a_camchain_cannot_say_is_said(old: str, new: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(RigError, match=words) as found:
        read_any_rig(written(tmp_path, KALIBR.replace(old, new), "camchain.yaml"))
    assert "camchain.yaml" in str(found.value)
    assert "\n" not in str(found.value)


MRCAL = """# generated on 2024-01-01
{
    'lensmodel':  '%s',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 1761.18, 1761.25, 1965.7, 1087.5,
                    -0.0126, 0.0359, -0.000254, 0.000527, 0.0196, 0.0148, -0.0562, 0.05,%s],
    'valid_intrinsics_region': [ [ 0., 0. ], [ 3999., 0. ], [ 3999., 2199. ] ],

    # extrinsics are rt_fromref
    'extrinsics': [ %s],

    'imagersize': [ 4000, 2200,],

    'optimization_inputs': b'P)h>@6aWAK2ml36Ls'
}
"""


def test_cameramodels_as_mrcal_writes_them(tmp_path: Path) -> None:
    """The right camera's pose against a reference that is not the left camera: 0.2 m to the right, turned by a right angle both."""
    turn = f"0, {math.pi / 2}, 0, "
    left = written(tmp_path, MRCAL % ("LENSMODEL_OPENCV8", "", turn + "0.5, 0, 1"), "a.cameramodel")
    right = written(tmp_path, MRCAL % ("LENSMODEL_OPENCV12", " 0, 0, 0, 0,", turn + "0.3, 0, 1"), "b.cameramodel")
    assert read_rig_file(left).dialect == "mrcal"
    rig = read_any_rig([left, right])
    assert (rig.left.model, rig.left.distortion[7], rig.right.model) == ("rational", 0.05, "rational")
    assert np.allclose(rig.R_right_left, np.eye(3), atol=1e-15)
    assert np.allclose(rig.right_centre_m, (0.2, 0, 0), atol=1e-15)
    with pytest.raises(RigError, match="swapped"):
        read_any_rig([right, left])
    with pytest.raises(RigError, match="one file for each eye"):
        read_any_rig([left])
    prism = written(tmp_path, MRCAL % ("LENSMODEL_OPENCV12", " 0, 0, 0.01, 0,", turn + "0.3, 0, 1"), "c.cameramodel")
    with pytest.raises(RigError, match="thin prism"):
        read_any_rig([left, prism])
    splined = written(tmp_path, MRCAL % ("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=18_fov_x_deg=150", "", "0,0,0,0,0,0"), "d.cameramodel")
    with pytest.raises(RigError, match="mrcal-convert-lensmodel"):
        read_any_rig([left, splined])
    with pytest.raises(RigError, match="plain values only"):
        read_any_rig(written(tmp_path, "{'lensmodel': __import__('os').getcwd()}", "e.cameramodel"))


ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo/%s
camera_matrix:
  rows: 3
  cols: 3
  data: [ 438.78, 0.     , 305.59,
          0.    , 438.85, 243.74,
          0.    , 0.     , 1. ]
distortion_model: %s
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.65, 0., 322.79, %s, 0., 393.65, 241.09, 0., 0., 0., 1., 0.]
"""


def test_camera_infos_as_ros_writes_them(tmp_path: Path) -> None:
    left = written(tmp_path, ROS % ("left", "plumb_bob", "0."), "left.yaml")
    right = written(tmp_path, ROS % ("right", "plumb_bob", "-35.4285"), "right.yaml")
    rig = read_any_rig([left, right])
    assert rig.baseline_m == pytest.approx(0.09, abs=1e-12)
    assert rig.left.distortion == (-0.361976, 0.110510, 0.001014, 0.000505, 0.0)
    with pytest.raises(RigError, match="no baseline"):
        read_any_rig([left, left])
    with pytest.raises(RigError, match="'thin_prism' with 5 coefficients cannot be said"):
        read_any_rig([left, written(tmp_path, ROS % ("right", "thin_prism", "-35."), "odd.yaml")])


def test_what_ros_gets_is_a_true_rectification(tmp_path: Path) -> None:
    """Points projected as stereo_image_proc does it: the same row in both eyes, and P[0, 3] gives the disparity."""
    rig = rig_with("brown5")
    tables = [read_rig_file(f).table for f in write_rig_as(tmp_path / "info.yaml", rig, "ros")]
    R, P = ([np.reshape(t[key]["data"], (3, -1)) for t in tables] for key in ("rectification_matrix", "projection_matrix"))
    X = np.random.default_rng(1).uniform((-0.4, -0.2, 1), (0.4, 0.2, 3), (50, 3))
    rectified = X @ R[0].T
    assert np.allclose((X @ rig.R_right_left.T + rig.t_right_left_m) @ R[1].T, rectified + (P[1][0, 3] / P[1][0, 0], 0, 0), atol=1e-12)


def sfm(**changes: str) -> str:
    words = {
        "version": '["1", "2", "8"]',
        "type": "pinhole",
        "distortionType": "radialk3",
        "params": '"0.1", "0.05", "-0.001"',
        "ratio": "1",
    } | changes
    intrinsic = f"""{{"intrinsicId": "7", "width": "4000", "height": "2000", "sensorWidth": "36", "sensorHeight": "24", "serialNumber": "", "type":
      "{words["type"]}", "initialFocalLength": "-1", "focalLength": "27", "pxFocalLength": "3000", "pixelRatio": "{words["ratio"]}",
      "pixelRatioLocked": "true", "principalPoint": ["-26", "16"], "distortionParams": [{words["params"]}], "undistortionParams": "",
      "distortionType": "{words["distortionType"]}", "locked": "false"}}"""
    view = '{{"viewId": "{0}", "poseId": "{0}", "intrinsicId": "7", "path": "{0}.png", "width": "4000", "height": "2000", "metadata": ""}}'
    pose = (
        '{{"poseId": "{0}", "pose": {{"transform": {{"rotation": ["0", "0", "1", "0", "1", "0", "-1", "0", "0"], "center": {1}}}, "locked": "0"}}}}'
    )
    views, poses = ", ".join(view.format(n) for n in "12"), ", ".join((pose.format(1, '["0", "0", "0.5"]'), pose.format(2, '["0", "0", "0.4"]')))
    return f'{{"version": {words["version"]}, "views": [{views}], "intrinsics": [{intrinsic}], "poses": [{poses}]}}'


def test_an_sfm_as_meshroom_writes_it(tmp_path: Path) -> None:
    """Rotation column by column: R = [[0, 0, -1], [0, 1, 0], [1, 0, 0]], so world -z is the cameras' x: the second stands to the right."""
    rig = read_any_rig(written(tmp_path, sfm(), "cameras.sfm"))
    assert rig.left.distortion == (0.1, 0.05, 0.0, 0.0, -0.001)
    assert rig.left.K.tolist() == [[3000, 0, 1974], [0, 3000, 1016], [0, 0, 1]]
    assert np.allclose(rig.right_centre_m, (0.1, 0, 0), atol=1e-12)
    assert read_any_rig(tmp_path / "cameras.sfm", unit_m=3.0).baseline_m == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("changes", "K"),
    [
        ({"ratio": "2"}, (3000, 6000, 1974, 1016)),
        ({"ratio": "2", "version": '["1", "2", "4"]'}, (3000, 1500, 1974, 1016)),  # held the focal lengths' ratio
        ({"ratio": "2", "version": '["1", "1", "0"]', "type": "radial3"}, (3000, 3000, -26, 16)),  # from the corner then
    ],
)
def test_older_sfms_mean_what_they_meant(changes: dict[str, str], K: tuple[float, ...], tmp_path: Path) -> None:
    left = read_any_rig(written(tmp_path, sfm(**changes, params='"0.0", "0.0", "0.0"') if "params" not in changes else sfm(**changes), "a.sfm")).left
    assert (left.fx, left.fy, left.cx, left.cy) == K


@pytest.mark.parametrize(("distortion", "params"), [("radialk3pt", '"0", "0", "0"'), ("3deradial4", '"0"'), ("fisheye1", '"0.9"')])
def test_lenses_that_only_meshroom_has_are_refused(distortion: str, params: str, tmp_path: Path) -> None:
    with pytest.raises(RigError, match=rf"pinhole/{distortion} cannot be said in a rig; solve with radialk3"):
        read_any_rig(written(tmp_path, sfm(distortionType=distortion, params=params), "a.sfm"))


def test_meshrooms_half_pixel(tmp_path: Path) -> None:
    """AliceVision undistorts pixel (x, y) from coordinates (x, y) about width / 2 + offset: its arithmetic, done here by hand,
    must send a ray to the very pixel that our camera sends it to."""
    rig = rig_with("brown5")
    (path,) = write_rig_as(tmp_path / "a.sfm", rig, "meshroom")
    t = read_rig_file(path).table["intrinsics"][0]
    w, h, f = float(t["width"]), float(t["height"]), float(t["focalLength"]) / float(t["sensorWidth"]) * float(t["width"])
    k1, k2, k3, t1, t2 = map(float, t["distortionParams"])
    x, y = 0.31, -0.17
    r2 = x * x + y * y
    g = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * g + t2 * (r2 + 2 * x * x) + 2 * t1 * x * y
    v = y * g + t1 * (r2 + 2 * y * y) + 2 * t2 * x * y
    px = u * f + float(t["principalPoint"][0]) + w / 2, v * f * float(t["pixelRatio"]) + float(t["principalPoint"][1]) + h / 2
    assert np.allclose(rig.left.project([x, y, 1.0]), px, atol=1e-9)
    centred = Camera.from_fov(40, (1920, 1080))
    text = meshroom_from_rig(Rig(left=centred, right=centred, R_right_left=np.eye(3), t_right_left_m=[-0.06, 0, 0]))
    assert '"-0.5",\n                "-0.5"' in text


def test_a_solved_rig_of_meshroom_is_read(tmp_path: Path) -> None:
    text = sfm().replace('"poseId": "1", "intrinsicId"', '"rigId": "9", "subPoseId": "0", "intrinsicId"')
    text = text.replace('"poseId": "2", "intrinsicId"', '"rigId": "9", "subPoseId": "1", "intrinsicId"')
    subs = '{"status": "estimated", "pose": {"rotation": [1,0,0,0,1,0,0,0,1], "center": [0,0,0]}}, {"status": "estimated", "pose": '
    subs += '{"rotation": [1,0,0,0,1,0,0,0,1], "center": ["0.07", "0", "0"]}}'
    rig = read_any_rig(written(tmp_path, text[:-1] + f', "rigs": [{{"rigId": "9", "subPoses": [{subs}]}}]}}', "a.sfm"))
    assert np.allclose(rig.right_centre_m, (0.07, 0, 0))


def test_scripts_own_opencv_files(tmp_path: Path) -> None:
    """One file an eye with generic names and one with the pose, in millimetres; a fisheye that says so."""
    eye = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    eye += "   data: [ {0}, 0., 319.5, 0., {0}, 239.5,\n       0., 0., 1. ]\n{1}dist_coeffs: !!opencv-matrix\n   rows: 1\n   cols: 4\n   dt: d\n"
    eye += "   data: [ 1.0000000000000000e-02, -.002, 0., 0. ]\navg_reprojection_error: 2.5e-01 # pixels\n"
    pose = "%YAML:1.0\nR: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: f\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\nT: [-65., 0., 0.]\n"
    files = [written(tmp_path, eye.format(500.5, ""), "l.yml"), written(tmp_path, eye.format(600.5, ""), "r.yml"), written(tmp_path, pose, "p.yml")]
    with pytest.raises(RigError, match="cannot be metres"):
        read_any_rig(files)
    rig = read_any_rig(files, unit_m=0.001)
    assert (rig.left.fx, rig.right.fx, rig.baseline_m, rig.left.model) == (500.5, 600.5, 0.065, "brown")
    files[0] = written(tmp_path, eye.format(500.5, "model: fisheye\n"), "l.yml")
    assert read_any_rig(files, unit_m=0.001).left.model == "fisheye"
    with pytest.raises(RigError, match="rotation 'R' between the eyes is missing"):
        read_any_rig(files[:2])


def test_mirrored_rigs_are_never_written_in_silence(tmp_path: Path) -> None:
    rig = rig_with("brown4")
    rig = Rig(left=rig.left, right=rig.right, R_right_left=rig.R_right_left, t_right_left_m=rig.t_right_left_m, mirrored="right")
    for dialect in DIALECTS[1:]:
        with pytest.raises(RigError, match="cannot say that the right eye is mirrored"):
            write_rig_as(tmp_path / "rig", rig, dialect)
        assert_same(read_any_rig(write_rig_as(tmp_path / "rig", rig, dialect, flipped_back=True, force=True)), rig)
    assert read_any_rig(write_rig_as(tmp_path / "rig.json", rig, "stereorelight")).mirrored == "right"


def test_nothing_is_overwritten_and_no_half_pair_is_left(tmp_path: Path) -> None:
    (tmp_path / "rig_right.yaml").write_text("mine")
    with pytest.raises(OutputError, match=r"rig_right\.yaml: exists already"):
        write_rig_as(tmp_path / "rig.yaml", rig_with("none"), "ros")
    assert [p.name for p in tmp_path.iterdir()] == ["rig_right.yaml"]
    with pytest.raises(RigError, match="did you mean 'meshroom'"):
        write_rig_as(tmp_path / "rig", rig_with("none"), "mashroom")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "   \n",
        "{",
        "[1, 2",
        "a: [1, {b: 2}",
        "- - - - x",
        "hello",
        "{}",
        "[]",
        "a: &x 1",
        "k: |\n  text",
        '{"views": [], "intrinsics": 3, "version": [1,2,8]}',
    ]
    + ['{"version": ["1","2","8"], "poses": [{"poseId": "1"}]}', "cam0: {camera_model: pinhole}", "M1: {data: [a, b]}", "R: [1]\nT: [1]", "[" * 5000]
    + ["a:\n    b: 1\n  c: 2", '"k: 1', "{'lensmodel': 'LENSMODEL_PINHOLE', 'intrinsics': 3}", "camera_matrix: 1\nprojection_matrix: 2"],
)
def test_broken_files_are_one_clear_line(text: str, tmp_path: Path) -> None:
    path = written(tmp_path, text, "broken.txt")
    with pytest.raises(RigError, match=r"broken\.txt: ") as found:
        read_any_rig(path)
    assert "\n" not in str(found.value)
    assert len(str(found.value)) < 600


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 1200), junk=st.text(max_size=3), dialect=st.sampled_from(DIALECTS))
def test_cut_or_spoilt_files_never_crash(cut: int, junk: str, dialect: str, tmp_path: Path) -> None:
    for path in (files := write_rig_as(tmp_path / "rig", rig_with("brown4"), dialect, force=True)):
        text = path.read_text()
        path.write_text(text[: cut % len(text)] + junk + ("" if cut % 2 else text[cut % len(text) + 1 :]))
    try:
        read_any_rig(files)
    except RigError as error:
        assert "\n" not in str(error)  # noqa: PT017


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="rig file missing"):
        read_any_rig(tmp_path / "none.yaml")
    (tmp_path / "x.yaml").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(RigError, match="not a text file"):
        read_any_rig(tmp_path / "x.yaml")
    a, _ = write_rig_as(tmp_path / "m", rig_with("none"), "mrcal")
    (c,) = write_rig_as(tmp_path / "k", rig_with("none"), "kalibr")
    with pytest.raises(RigError, match=r"different dialects \(kalibr, mrcal\)"):
        read_any_rig([a, c])
    with pytest.raises(RigError, match="one file for both eyes"):
        read_any_rig([c, c])


def test_plain_yaml() -> None:
    text = "a: 1\nb: {c: [1., -.5e3, x y], 'd e': true}\n"
    text += 'list:\n- k: 1\n  l: ~\n- - 2\n  - 3\n-\n  m: "# no comment: here" # one\nempty:\nend: 10:30 # time\n'
    assert parse_yaml(text) == {
        "a": 1,
        "b": {"c": [1.0, -500.0, "x y"], "d e": True},
        "list": [{"k": 1, "l": None}, [2, 3], {"m": "# no comment: here"}],
        "empty": None,
        "end": "10:30",
    }
