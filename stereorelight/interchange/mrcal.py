"""mrcal's .cameramodel: one file an eye, a Python table of plain values.

In: the files' texts, left and right.  Out: a `Rig`, and the two texts.
Pixels and frames are ours.  intrinsics are fx fy cx cy and then OpenCV's coefficients; extrinsics are `rt_cam_ref`, the rotation
vector and the translation that take reference points to the camera, metres.  LENSMODEL_PINHOLE and _OPENCV4, 5, 8 and 12 (whose
last four must be zero) can be said in a rig; splined, CAHVOR and fisheye-like models cannot.
Source: mrcal's documentation, "Camera model representation in memory and on disk" and "Lens models"."""

from __future__ import annotations

import ast
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError
from stereorelight.interchange.parts import (
    intrinsic,
    numbers,
    opencv_coefficients,
    opencv_lens,
    required,
    rig_of,
    rotation_from_vector,
    table_of,
    vector_from_rotation,
    whole,
)

LENSES = {"LENSMODEL_PINHOLE": 0, "LENSMODEL_OPENCV4": 4, "LENSMODEL_OPENCV5": 5, "LENSMODEL_OPENCV8": 8, "LENSMODEL_OPENCV12": 12}


def parse_cameramodel(text: str) -> Any:
    """The table that `text` says; nothing in it is run.  Raises RigError."""
    try:
        return ast.literal_eval(text.strip())
    except SyntaxError as error:
        raise RigError(f"not a cameramodel: line {error.lineno} is not understood; is the file whole?") from None
    except (ValueError, TypeError, RecursionError, MemoryError):
        raise RigError("not a cameramodel: it must hold plain values only") from None


def camera_from_mrcal(table: Any, where: str) -> tuple[Camera, Float64, Float64]:
    """Camera, and R and t that take reference points to it.  Raises RigError."""
    t = table_of(table, where)
    name = t.get("lensmodel") or t.get("lens_model")
    if name not in LENSES:
        raise RigError(
            f"{where}: lens model {str(name)[:60]!r} cannot be said in a rig; fit LENSMODEL_OPENCV8 to it with mrcal-convert-lensmodel first"
        )
    values = numbers(required(t, "intrinsics", where), f"{where} intrinsics of {name}", 4 + LENSES[name])
    w, h = numbers(required(t, "imagersize", where), f"{where} imagersize", 2)
    pose = t.get("extrinsics", t.get("rt_cam_ref"))
    if pose is None:
        raise RigError(f"{where}: key 'extrinsics' is missing; is the file whole?")
    rt = numbers(pose, f"{where} extrinsics", 6)
    model, c = opencv_lens(values[4:], f"{where} {name}")
    fx, fy, cx, cy = values[:4]
    camera = Camera(size=(whole(w, where), whole(h, where)), K=intrinsic(fx, fy, cx, cy), model=model, distortion=c)
    return camera, rotation_from_vector(rt[:3]), np.array(rt[3:])


def rig_from_mrcal(left: Any, right: Any, *, unit_m: float | None = None) -> Rig:
    """The rig of two cameramodels that share one reference frame.  Raises RigError."""
    (a, R_a, t_a), (b, R_b, t_b) = camera_from_mrcal(left, "left"), camera_from_mrcal(right, "right")
    R = R_b @ R_a.T
    return rig_of(a, b, R, t_b - R @ t_a, unit_m=unit_m)


def _text(camera: Camera, rt: Any) -> str:
    c = opencv_coefficients(camera, (0, 4, 5, 8), "mrcal", "calibrate as rational, or write a kalibr or opencv file")
    name = next(key for key, n in LENSES.items() if n == len(c))
    row = ", ".join(repr(float(v)) for v in (camera.fx, camera.fy, camera.cx, camera.cy, *c))
    pose = ", ".join(repr(float(v)) for v in rt)
    return (
        f"{{\n    'lensmodel':  '{name}',\n\n    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n    'intrinsics': [ {row},],\n\n"
        f"    # extrinsics are rt_fromref\n    'extrinsics': [ {pose},],\n\n    'imagersize': [ {camera.size[0]}, {camera.size[1]},]\n}}\n"
    )


def mrcal_from_rig(rig: Rig) -> tuple[str, str]:
    """Left and right .cameramodel; the reference is the left eye.  Raises RigError for a fisheye."""
    rt = [*vector_from_rotation(rig.R_right_left), *rig.t_right_left_m]
    return _text(rig.left, [0.0] * 6), _text(rig.right, rt)
