"""Meshroom's sfm (AliceVision sfmData JSON): two views with their intrinsics and poses, in and out.

In: the parsed JSON.  Out: a `Rig`, and its text.
A pose holds R (column by column) and the centre C: x_camera = R (X - C), camera frame x right, y down, z forward as ours.
Lens: radialk1, radialk3 and brown (k1 k2 k3 t1 t2) are our brown, fisheye our fisheye; the others (radialk3pt, fisheye1, the 3DE
ones) cannot be said in a rig.  fx = focalLength / sensorWidth * width; fy by the pixel's ratio, which files before 1.2.5 hold
upside down.

**The half pixel**: principalPoint is measured from (width / 2, height / 2), and AliceVision's own image coordinates have whole
numbers at pixel *centres*: its undistortion and its features sample pixel (x, y) at exactly (x, y).  So cx = width / 2 + offset in
our pixels too, and a lens centred in the frame has offset -0.5, not 0.
Source: AliceVision's sfmDataIO (file versions to 1.2.14) and camera/README."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, LensModel, Rig
from stereorelight.errors import RigError
from stereorelight.interchange.parts import fisheye_coefficients, intrinsic, numbers, opencv_coefficients, required, rig_of, table_of, whole

SENSOR_MM = 36.0  # AliceVision's own default; only focalLength / sensorWidth counts
OLD_TYPES = {"pinhole": "none", "radial1": "radialk1", "radial3": "radialk3", "brown": "brown", "fisheye4": "fisheye", "fisheye": "fisheye"}
PARAMETERS = {"none": (0,), "radialk1": (1,), "radialk3": (3,), "brown": (5,), "fisheye": (4,)}


def _lens(t: Mapping[str, Any], where: str) -> tuple[LensModel, tuple[float, ...]]:
    kind = str(t.get("type", "pinhole")).lower()
    name = str(t["distortionType"]).lower() if "distortionType" in t and kind == "pinhole" else OLD_TYPES.get(kind, kind)
    undone = str(t.get("undistortionType", "none")).lower()
    if name not in PARAMETERS or undone != "none":
        raise RigError(
            f"{where}: lens {kind}/{name if undone == 'none' else undone} cannot be said in a rig; "
            "solve with radialk3, brown or fisheye (fisheye4) in Meshroom"
        )
    c = numbers(t.get("distortionParams"), f"{where} distortionParams", PARAMETERS[name])
    if name == "fisheye":
        return "fisheye", tuple(c)
    if name == "none":
        return "brown", ()
    k1, k2, k3, t1, t2 = [*c, *[0.0] * (5 - len(c))]
    return "brown", (k1, k2, t1, t2, k3)


def _camera(t: Mapping[str, Any], version: tuple[int, ...], where: str) -> Camera:
    w, h = whole(required(t, "width", where), where), whole(required(t, "height", where), where)
    x, y = numbers(required(t, "principalPoint", where), f"{where} principalPoint", 2)
    if version >= (1, 2, 1):
        x, y = x + w / 2, y + h / 2
    if version < (1, 2, 2):
        f = numbers(required(t, "pxFocalLength", where), f"{where} pxFocalLength", (1, 2))
        fx, fy = f[0], f[-1]
    else:
        (mm, sensor, ratio) = numbers([required(t, "focalLength", where), t.get("sensorWidth", SENSOR_MM), t.get("pixelRatio", 1.0)], where, 3)
        if min(mm, sensor, ratio) <= 0:
            raise RigError(f"{where}: focalLength, sensorWidth and pixelRatio must be > 0; has Meshroom solved this camera?")
        fx = mm / sensor * w
        fy = fx * ratio if version >= (1, 2, 5) else fx / ratio
    model, c = _lens(t, where)
    return Camera(size=(w, h), K=intrinsic(fx, fy, x, y), model=model, distortion=c)


def _pose(transform: Any, where: str) -> tuple[Float64, Float64]:
    """R and t that take world points to the camera."""
    t = table_of(transform, where)
    R = np.array(numbers(required(t, "rotation", where), f"{where} rotation", 9)).reshape(3, 3).T
    return R, -R @ np.array(numbers(required(t, "center", where), f"{where} center", 3))


def _listed(table: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    values = table.get(key) or []
    if not isinstance(values, list):
        raise RigError(f"{key!r} must be a list")
    return [table_of(v, key) for v in values]


def rig_from_meshroom(table: Any, *, unit_m: float | None = None) -> Rig:
    """The rig of an sfm: its one rig of two cameras, or its two solved views.  Raises RigError.

    unit_m : metres in one unit of the file.  Meshroom's scale is free: a solve without a known distance is not in metres.
    """
    t = table_of(table, "sfm")
    version = tuple(int(v) for v in numbers(required(t, "version", "sfm"), "version", 3))
    intrinsics = {str(i.get("intrinsicId")): i for i in _listed(t, "intrinsics")}
    poses = {str(p.get("poseId")): table_of(p.get("pose"), "pose").get("transform") for p in _listed(t, "poses")}
    rigs, views = _listed(t, "rigs"), _listed(t, "views")
    found: list[tuple[str, Any]] = []  # intrinsicId and transform of each eye
    if len(rigs) == 1 and len(rigs[0].get("subPoses") or []) == 2:
        for n, sub in enumerate(_listed(rigs[0], "subPoses")):
            if sub.get("status") == "uninitialized":
                raise RigError("the rig in the file is not solved yet; give the file that StructureFromMotion wrote")
            view = next((v for v in views if str(v.get("rigId")) == str(rigs[0].get("rigId")) and str(v.get("subPoseId")) == str(n)), None)
            if view is None:
                raise RigError(f"no view belongs to camera {n} of the rig")
            found.append((str(view.get("intrinsicId")), sub.get("pose")))
    else:
        found = [(str(v.get("intrinsicId")), poses[str(v.get("poseId"))]) for v in views if str(v.get("poseId")) in poses]
        if len(found) != 2:
            raise RigError(f"{len(found)} solved views and no rig of two cameras: which are the eyes? Keep two views, or solve with a rig")
    eyes = []
    for n, (key, transform) in enumerate(found):
        if key not in intrinsics:
            raise RigError(f"intrinsic {key!r} of view {n} is missing")
        eyes.append((_camera(intrinsics[key], version, f"intrinsic {key}"), *_pose(transform, f"pose of view {n}")))
    (a, R_a, t_a), (b, R_b, t_b) = eyes
    R = R_b @ R_a.T
    return rig_of(a, b, R, t_b - R @ t_a, unit_m=unit_m, any_order=True)


def _texts(values: Any) -> list[str]:
    return [repr(float(v)) for v in np.ravel(values)]


def _intrinsic(camera: Camera, key: str) -> dict[str, Any]:
    w, h = camera.size
    if camera.model == "fisheye":
        lens, c = "fisheye", fisheye_coefficients(camera)
    else:
        k1, k2, p1, p2, k3 = opencv_coefficients(camera, (5,), "Meshroom", "calibrate with 5 parameters (brown) or as fisheye, or write ST-maps")
        radial = p1 == p2 == 0
        lens, c = ("radialk3", [k1, k2, k3]) if radial else ("brown", [k1, k2, k3, p1, p2])
    return {
        "intrinsicId": key,
        "width": str(w),
        "height": str(h),
        "sensorWidth": repr(SENSOR_MM),
        "sensorHeight": repr(SENSOR_MM * h / w),
        "serialNumber": f"stereorelight-{key}",
        "type": "pinhole",
        "initializationMode": "calibrated",
        "initialFocalLength": repr(SENSOR_MM * camera.fx / w),
        "focalLength": repr(SENSOR_MM * camera.fx / w),
        "pixelRatio": repr(camera.fy / camera.fx),
        "pixelRatioLocked": "true",
        "principalPoint": _texts((camera.cx - w / 2, camera.cy - h / 2)),
        "distortionInitializationMode": "calibrated",
        "distortionParams": _texts(c),
        "undistortionOffset": ["0", "0"],
        "undistortionParams": "",
        "distortionType": lens,
        "undistortionType": "none",
        "locked": "true",
    }


def meshroom_from_rig(rig: Rig, *, pictures: tuple[str, str] = ("left.png", "right.png")) -> str:
    """The rig as an sfm of version 1.2.8: two views, the left camera at the origin, metres; `pictures` are the views' paths."""
    centres = (np.zeros(3), rig.right_centre_m)
    eyes = list(zip((rig.left, rig.right), (np.eye(3), rig.R_right_left), centres, pictures))
    table: dict[str, Any] = {"version": ["1", "2", "8"], "views": [], "intrinsics": [], "poses": []}
    for n, (camera, R, centre, picture) in enumerate(eyes):
        key = str(n + 1)
        ids = {"viewId": key, "poseId": key, "intrinsicId": key}
        table["views"].append(ids | {"path": picture, "width": str(camera.size[0]), "height": str(camera.size[1]), "metadata": ""})
        table["intrinsics"].append(_intrinsic(camera, key))
        transform = {"rotation": _texts(R.T), "center": _texts(centre)}
        table["poses"].append({"poseId": key, "pose": {"transform": transform, "locked": "1"}})
    return json.dumps(table, indent=4) + "\n"
