"""OpenCV's own files, YAML and JSON as `cv2.FileStorage` writes them.

In: parsed tables of one or more files.  Out: a `Rig`, and its text.
Pixels and frames are ours.  There is no one layout: the stereo sample writes M1 D1 M2 D2 to one file and R T to another, without
the picture's size; scripts write camera_matrix and dist_coeffs one file an eye.  Keys are told by their letters alone, whatever
their case and underscores; R and T are x_right = R x_left + T in the unit of the board's squares.
Source: OpenCV's documentation of FileStorage and stereoCalibrate, samples/cpp/stereo_calib.cpp."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stereorelight.camera import Camera, LensModel, Rig
from stereorelight.errors import RigError
from stereorelight.interchange.parts import fisheye_coefficients, numbers, opencv_coefficients, opencv_lens, rig_of, table_of, whole

NAMES = {
    "K": ("m", "k", "cameramatrix", "cammatrix", "intrinsicmatrix", "intrinsics", "intrinsic", "mtx", "cm", "cam"),
    "D": ("d", "distcoeffs", "distcoeff", "distortioncoefficients", "distortioncoeffs", "distortion", "dist", "distcoefficients", "dc"),
    "width": ("imagewidth", "width", "w"),
    "height": ("imageheight", "height", "h"),
    "size": ("imagesize", "size", "imgsize", "resolution"),
    "model": ("model", "distortionmodel", "cameramodel", "lensmodel"),
    "fisheye": ("fisheye", "fisheyemodel", "isfisheye"),
}
ROTATION = ("r", "rot", "rotation", "rotationmatrix", "stereor", "rrightleft", "rstereo")
TRANSLATION = ("t", "trans", "translation", "translationvector", "stereot", "trightleftm", "tstereo")
EYES = {"1": 0, "2": 1, "l": 0, "r": 1, "left": 0, "right": 1}


def _letters(key: str) -> str:
    return re.sub(r"[^a-z0-9]", "", str(key).lower())


def _meaning(key: str) -> tuple[str, int | None] | None:
    """What a key says, and of which eye (None: of the file's one camera, or of both)."""
    word = _letters(key)
    if word in ROTATION:
        return "R", None
    if word in TRANSLATION:
        return "T", None
    for what, names in NAMES.items():
        if word in names:
            return what, None
        for name in names:
            for eye, index in EYES.items():
                if word in (name + eye, eye + name) and not (len(eye) == 1 and not eye.isdigit() and len(name) == 1 and word == eye + name):
                    return what, index
    return None


def _values(value: Any) -> Any:
    return value.get("data") if isinstance(value, dict) else value


def _flattened(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with eyes' own tables ("left": {...}) brought up, their name after the key."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict) and "data" not in value:
            eye = _letters(key).replace("camera", "").replace("cam", "") or _letters(key)
            out |= {f"{inner}_{eye}" if eye in EYES else inner: v for inner, v in value.items()}
        else:
            out[key] = value
    return out


def says_rig(table: Any) -> bool:
    """Whether any key of `table` is one that OpenCV's calibration files have."""
    if not isinstance(table, dict):
        return False
    found = {m[0] for m in map(_meaning, _flattened(table)) if m}
    return bool(found & {"K"} or {"R", "T"} <= found)


def rig_from_opencv(tables: Sequence[Any], *, size: tuple[int, int] | None = None, unit_m: float | None = None) -> Rig:
    """The rig that one or more files say together; files of one eye each come left, right.

    size   : of the pictures, where the files do not say it.      unit_m : metres in one unit of T; None takes metres.
    Raises : RigError naming what is missing.
    """
    eyes: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
    shared: dict[str, Any] = {}
    alone = 0
    for table in tables:
        found = [(_meaning(key), value) for key, value in _flattened(table_of(table, "file")).items()]
        single = any(m == ("K", None) for m, _ in found)
        if single and alone == 2:
            raise RigError("three files with a camera matrix each; give the left eye's, the right eye's, and the one with R and T")
        for meaning, value in found:
            if meaning is None or value is None:
                continue
            what, eye = meaning
            home = shared if what in "RT" else eyes[eye] if eye is not None else eyes[alone] if single else shared
            home.setdefault(what, _values(value))
        alone += single
    for what, name in (("R", "rotation 'R'"), ("T", "translation 'T'")):
        if what not in shared:
            raise RigError(f"{name} between the eyes is missing; give the file with the pose too (the stereo sample writes extrinsics.yml)")
    cameras = [_camera(shared | eye, name, size) for name, eye in zip(("left", "right"), eyes)]
    R = numbers(shared["R"], "R", (3, 9))
    if len(R) == 3:
        raise RigError("R is a rotation vector; write the 3x3 matrix (cv2.Rodrigues)")
    return rig_of(cameras[0], cameras[1], R, shared["T"], unit_m=unit_m)


def _camera(found: Mapping[str, Any], where: str, size: tuple[int, int] | None) -> Camera:
    for what, name in (("K", "camera matrix"), ("D", "distortion coefficients")):
        if what not in found:
            raise RigError(
                f"{where}: the {name} is missing; known names are such as M1, K1, cameraMatrix1, D1, distCoeffs1, with 2 for the right eye"
            )
    w, h = found.get("width"), found.get("height")
    if w is None and "size" in found:
        w, h = numbers(found["size"], f"{where} size", 2)
    if w is None or h is None:
        if size is None:
            raise RigError(f"{where}: the file does not say the size of the picture; give it: export --size 1920x1080")
        w, h = size
    c = numbers(found["D"], f"{where} distortion")
    word, flag = _letters(found.get("model", "")), found.get("fisheye")
    fisheye = word in ("fisheye", "equidistant", "equi", "kannalabrandt") or flag in (1, True, "true", "1")
    model: LensModel
    if fisheye:
        if len(c) != 4:
            raise RigError(f"{where}: a fisheye has 4 distortion coefficients, got {len(c)}")
        model, lens = "fisheye", tuple(c)
    elif word in ("", "brown", "rational", "plumbbob", "rationalpolynomial", "pinhole", "radtan", "standard"):
        model, lens = opencv_lens(c, where)
    else:
        raise RigError(f"{where}: lens model {found['model']!r} cannot be said in a rig; use OpenCV's own model or its fisheye")
    K = np.array(numbers(found["K"], f"{where} camera matrix", 9)).reshape(3, 3)
    return Camera(size=(whole(w, where), whole(h, where)), K=K, model=model, distortion=lens)


def _contents(rig: Rig) -> dict[str, Any]:
    out: dict[str, Any] = {}
    same = rig.left.size == rig.right.size
    for n, camera in (("1", rig.left), ("2", rig.right)):
        tail = "" if same else n
        out |= {f"image_width{tail}": camera.size[0], f"image_height{tail}": camera.size[1]}
    for n, camera in (("1", rig.left), ("2", rig.right)):
        fisheye = camera.model == "fisheye"
        c = fisheye_coefficients(camera) if fisheye else opencv_coefficients(camera, (5, 8), "OpenCV", "")
        out |= {f"model{n}": camera.model, f"M{n}": camera.K, f"D{n}": np.array([c])}
    return out | {"R": rig.R_right_left, "T": rig.t_right_left_m[:, None]}


def _digits(m: Any) -> str:
    return ", ".join(repr(float(v)) for v in np.ravel(m))


def opencv_from_rig(rig: Rig, *, as_json: bool = False) -> str:
    """The rig as `cv2.FileStorage` reads it: image_width, image_height, model1, M1, D1, model2, M2, D2, R, T (metres)."""
    if as_json:
        table = {
            key: {"type_id": "opencv-matrix", "rows": v.shape[0], "cols": v.shape[1], "dt": "d", "data": v.ravel().tolist()}
            if isinstance(v, np.ndarray)
            else v
            for key, v in _contents(rig).items()
        }
        return json.dumps(table, indent=4) + "\n"
    lines = ["%YAML:1.0", "---"]
    for key, v in _contents(rig).items():
        if isinstance(v, np.ndarray):
            lines += [f"{key}: !!opencv-matrix", f"   rows: {v.shape[0]}", f"   cols: {v.shape[1]}", "   dt: d", f"   data: [ {_digits(v)} ]"]
        else:
            lines.append(f'{key}: "{v}"' if isinstance(v, str) else f"{key}: {v}")
    return "\n".join(lines) + "\n"
