"""Kalibr's camchain.yaml: two pinhole cameras and the pose of the second against the first.

In: the parsed YAML.  Out: a `Rig`, and its text.  Pixels and frames are ours: (0, 0) at the pixel's centre, x right, y down, z forward.
radtan is brown with k1 k2 p1 p2; equidistant is our fisheye; omni, ds, eucm and fov cannot be said here.
T_cn_cnm1 takes points of the camera before to this one, metres.  Which eye is the left one the file does not say: the one that
stands to the left.  Source: Kalibr's wiki, "Yaml formats" and "Supported models"."""

from __future__ import annotations

from typing import Any

import numpy as np

from stereorelight.camera import Camera, LensModel, Rig
from stereorelight.errors import RigError
from stereorelight.interchange.parts import fisheye_coefficients, intrinsic, numbers, opencv_coefficients, required, rig_of, table_of, whole

LENSES: dict[str, LensModel] = {"radtan": "brown", "equidistant": "fisheye", "equi": "fisheye", "none": "brown"}


def _camera(table: Any, where: str) -> Camera:
    t = table_of(table, where)
    projection, lens = str(required(t, "camera_model", where)).lower(), str(t.get("distortion_model", "none")).lower()
    if projection != "pinhole":
        raise RigError(
            f"{where}: camera_model {projection!r} cannot be said in a rig; calibrate with pinhole-radtan or, for a wide lens, pinhole-equi"
        )
    if lens not in LENSES:
        raise RigError(f"{where}: distortion_model {lens!r} cannot be said in a rig; calibrate with radtan or equidistant")
    fx, fy, cx, cy = numbers(required(t, "intrinsics", where), f"{where} intrinsics", 4)
    w, h = numbers(required(t, "resolution", where), f"{where} resolution", 2)
    c = () if lens == "none" else tuple(numbers(required(t, "distortion_coeffs", where), f"{where} distortion_coeffs", 4))
    return Camera(size=(whole(w, where), whole(h, where)), K=intrinsic(fx, fy, cx, cy), model=LENSES[lens], distortion=c)


def rig_from_kalibr(table: Any, *, unit_m: float | None = None) -> Rig:
    """The rig of a camchain with two cameras.  Raises RigError."""
    t = table_of(table, "camchain")
    cameras = sorted(key for key in t if str(key).startswith("cam") and str(key)[3:].isdigit())
    if len(cameras) != 2:
        raise RigError(f"a camchain of two cameras is wanted, got {', '.join(cameras) or 'none'}; keep cam0 and cam1 of the pair")
    first, second = (_camera(t[key], key) for key in cameras)
    T = np.array(numbers(required(t[cameras[1]], "T_cn_cnm1", cameras[1]), f"{cameras[1]} T_cn_cnm1", 16)).reshape(4, 4)
    return rig_of(first, second, T[:3, :3], T[:3, 3], unit_m=unit_m, any_order=True)


def _row(values: Any) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def kalibr_from_rig(rig: Rig) -> str:
    """The rig as camchain.yaml, cam0 the left eye.  Raises RigError for a lens that needs more than k1 k2 p1 p2."""
    lines = []
    for name, other, camera in (("cam0", 1, rig.left), ("cam1", 0, rig.right)):
        lines.append(f"{name}:")
        if name == "cam1":
            lines.append("  T_cn_cnm1:")
            lines += [f"  - {_row([*R, t])}" for R, t in zip(rig.R_right_left, rig.t_right_left_m)] + ["  - [0.0, 0.0, 0.0, 1.0]"]
        fisheye = camera.model == "fisheye"
        remedy = "calibrate with 4 parameters (k1 k2 p1 p2) or as fisheye, or write an opencv file"
        c = fisheye_coefficients(camera) if fisheye else opencv_coefficients(camera, (4,), "Kalibr", remedy)
        lines += [
            f"  cam_overlaps: [{other}]",
            "  camera_model: pinhole",
            f"  distortion_coeffs: {_row(c)}",
            f"  distortion_model: {'equidistant' if fisheye else 'radtan'}",
            f"  intrinsics: {_row((camera.fx, camera.fy, camera.cx, camera.cy))}",
            f"  resolution: [{camera.size[0]}, {camera.size[1]}]",
            f"  rostopic: /{name}/image_raw",
        ]
    return "\n".join(lines) + "\n"
