"""ROS camera_info YAML: one file an eye, as camera_calibration and stereo_image_proc write and read them.

In: the two parsed tables.  Out: a `Rig`, and the two texts.
Pixels and frames are ours.  The pair's pose is said through the rectification alone: with x_rectified = R x for each eye and
P[0, 3] = fx' Tx, the right eye's origin stands at -Tx on the rectified x axis, so
    R_right_left = R_r^T R_l        t_right_left = R_r^T (Tx_r - Tx_l, Ty_r - Ty_l, 0)
plumb_bob is brown, rational_polynomial rational, equidistant (also spelt fisheye) our fisheye.
Source: the comments of sensor_msgs/CameraInfo; REP 104."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError
from stereorelight.interchange.parts import (
    fisheye_coefficients,
    intrinsic,
    numbers,
    opencv_coefficients,
    opencv_lens,
    required,
    rig_of,
    table_of,
    whole,
)

BROWN, RATIONAL, FISHEYE = ("plumb_bob", "plumb bob", ""), ("rational_polynomial",), ("equidistant", "fisheye")


def _matrix(table: Mapping[str, Any], key: str, where: str, count: int | tuple[int, ...] | None) -> list[float]:
    value = required(table, key, where)
    return numbers(value.get("data") if isinstance(value, dict) else value, f"{where} {key}", count)


def _camera(table: Any, where: str) -> tuple[Camera, Float64, Float64]:
    """Camera, R and (Tx, Ty, 0) of one eye."""
    t = table_of(table, where)
    K = np.array(_matrix(t, "camera_matrix", where, 9)).reshape(3, 3)
    name = str(t.get("distortion_model") or "").lower()
    c = _matrix(t, "distortion_coefficients", where, None)
    if name in BROWN + RATIONAL:
        model, lens = opencv_lens(c, where)
    elif name in FISHEYE and len(c) == 4:
        model, lens = "fisheye", tuple(c)
    else:
        raise RigError(
            f"{where}: distortion_model {name!r} with {len(c)} coefficients cannot be said in a rig; "
            "calibrate with plumb_bob, rational_polynomial or equidistant"
        )
    size = whole(required(t, "image_width", where), where), whole(required(t, "image_height", where), where)
    R = np.array(_matrix(t, "rectification_matrix", where, 9)).reshape(3, 3)
    P = np.array(_matrix(t, "projection_matrix", where, 12)).reshape(3, 4)
    if P[0, 0] <= 0 or P[1, 1] <= 0:
        raise RigError(f"{where}: projection_matrix has no focal length; was the camera calibrated as one of a pair?")
    return Camera(size=size, K=K, model=model, distortion=lens), R, np.array([P[0, 3] / P[0, 0], P[1, 3] / P[1, 1], 0.0])


def rig_from_ros(left: Any, right: Any, *, unit_m: float | None = None) -> Rig:
    """The rig of a left and a right camera_info.  Raises RigError."""
    (a, R_a, T_a), (b, R_b, T_b) = _camera(left, "left"), _camera(right, "right")
    T = T_b - T_a
    if not T.any():
        raise RigError("projection_matrix holds no baseline (its fourth column is zero in both eyes); calibrate the two as a stereo pair")
    return rig_of(a, b, R_b.T @ R_a, R_b.T @ T, unit_m=unit_m)


def _rectified(rig: Rig) -> tuple[Float64, Float64, Float64]:
    """R of the left eye, R of the right eye, and a K for both: x along the baseline, z between the two optical axes."""
    x = rig.right_centre_m / rig.baseline_m
    z = np.array([0.0, 0.0, 1.0]) + rig.R_right_left[2]
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    R_left = np.stack([x, y, np.cross(x, y)])
    a, b = rig.left, rig.right
    f = (a.fx + a.fy + b.fx + b.fy) / 4
    return R_left, R_left @ rig.R_right_left.T, intrinsic(f, f, (a.cx + b.cx) / 2, (a.cy + b.cy) / 2)


def _block(key: str, values: Any, rows: int) -> list[str]:
    flat = [float(v) for v in np.ravel(values)]
    return [f"{key}:", f"  rows: {rows}", f"  cols: {len(flat) // rows}", f"  data: [{', '.join(map(repr, flat))}]"]


def ros_from_rig(rig: Rig) -> tuple[str, str]:
    """Left and right camera_info YAML.  R and P are a rectification of the pair in one frame of the left picture's size."""
    R_left, R_right, K = _rectified(rig)
    texts = []
    for name, camera, R, tx in (("left", rig.left, R_left, 0.0), ("right", rig.right, R_right, -rig.baseline_m)):
        if camera.model == "fisheye":
            lens, c = "equidistant", fisheye_coefficients(camera)
        else:
            c = opencv_coefficients(camera, (5, 8), "ROS", "write an opencv file")
            lens = "plumb_bob" if len(c) == 5 else "rational_polynomial"
        lines = [f"image_width: {camera.size[0]}", f"image_height: {camera.size[1]}", f"camera_name: {name}"]
        lines += _block("camera_matrix", camera.K, 3) + [f"distortion_model: {lens}"] + _block("distortion_coefficients", c, 1)
        lines += _block("rectification_matrix", R, 3) + _block("projection_matrix", np.hstack([K, [[K[0, 0] * tx], [0], [0]]]), 3)
        texts.append("\n".join(lines) + "\n")
    return texts[0], texts[1]
