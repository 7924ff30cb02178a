"""Where the camera stands on every frame: our JSON, or Nuke's .chan.

Out: `Poses`: (4, 4) world from the scene frame of the camera (x right, y up, it looks down -z), metres.
JSON: {"version": 1, "unit_m": 1.0, "axes": "scene" | "opencv", "up": "y" | "z" | "-y", "frames": {"1001": POSE, ...}}, or
"pose": POSE instead of "frames" for a camera that stands still.  A POSE is {"world_from_camera": 4x4}, for column vectors, or
{"position": [x, y, z]} with "rotation_deg" (and "rotation_order", ZXY where left out), "quaternion_wxyz", or no turn at all.
axes : of the camera that was written: "scene" looks down -z, y up (Nuke, Blender, USD, Maya); "opencv" down +z, y down.
up   : which way is up in the file's world; the world is turned to y up: (x, y, z) of a z-up world is (x, z, -y) of ours."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Eye, Rig
from stereorelight.errors import RigError, nearest_hint
from stereorelight.files import write_text
from stereorelight.interchange.chan import chan_rows, chan_text
from stereorelight.interchange.parts import numbers
from stereorelight.interchange.turns import checked_order, rotation_of, rotation_of_quaternion

VERSION = 1
FLIP = np.diag([1.0, -1.0, -1.0])  # camera frame <-> scene frame
AXES = ("scene", "opencv")
UPS: Mapping[str, Float64] = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": FLIP,
}
KEYS = ("version", "unit_m", "axes", "up", "frames", "pose")
POSE_KEYS = ("world_from_camera", "position", "rotation_deg", "rotation_order", "quaternion_wxyz")
NOT_RIGID = 1e-4  # what a matrix printed with five digits may be off by


@dataclass(frozen=True, kw_only=True, eq=False)
class Poses:
    """Poses of a camera.

    frames : frame number to (4, 4) world from scene-frame camera, metres.
    still  : the pose on every frame, for a camera that does not move; then `frames` is empty.
    name   : of the file, for complaints.
    """

    frames: Mapping[int, Float64]
    still: Float64 | None = None
    name: str = "poses"

    def at(self, frame: int | None) -> Float64:
        """(4, 4) on `frame`; None, a single picture, takes the only one.  Raises RigError naming the frames that there are."""
        if self.still is not None:
            return self.still
        if frame is None and len(self.frames) == 1:
            return next(iter(self.frames.values()))
        if frame is None or frame not in self.frames:
            have = sorted(self.frames)
            span = f"{have[0]}" if len(have) == 1 else f"{len(have)} frames, {have[0]} to {have[-1]}"
            what = "a picture without a number" if frame is None else f"frame {frame}"
            raise RigError(f"{self.name}: has no pose for {what}; it has {span}: export the camera on every frame, or shift it by shift_frames")
        return self.frames[frame]

    def shifted(self, by: int) -> Poses:
        """The same poses, each `by` frames later."""
        return Poses(frames={frame + by: pose for frame, pose in self.frames.items()}, still=self.still, name=self.name)


def _pose(R: Float64, t: Float64) -> Float64:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, t
    pose.setflags(write=False)
    return pose


def _rigid(matrix: Float64, where: str) -> Float64:
    """`matrix` (4, 4), after checking that it only turns and moves."""
    if not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-9):
        if np.allclose(matrix[:, 3], (0, 0, 0, 1), atol=1e-9):
            raise RigError(f"{where}: the position stands in the last row; transpose the matrix: ours are for column vectors")
        raise RigError(f"{where}: must end in the row 0 0 0 1")
    R = matrix[:3, :3]
    scale = float(np.cbrt(abs(np.linalg.det(R))))
    if scale > 1e-9 and abs(scale - 1) > NOT_RIGID and np.abs(R @ R.T / scale**2 - np.eye(3)).max() < NOT_RIGID:
        raise RigError(f"{where}: is scaled by {scale:.6g}; a camera has no scale: freeze it, or say the unit by unit_m")
    if np.abs(R @ R.T - np.eye(3)).max() > NOT_RIGID:
        raise RigError(f"{where}: is no rotation: its axes are not at right angles")
    if np.linalg.det(R) < 0:
        raise RigError(f"{where}: is a reflection, not a rotation; is one axis the wrong way round?")
    return matrix


def _known(table: Any, known: tuple[str, ...], where: str) -> Mapping[str, Any]:
    if not isinstance(table, dict):
        raise RigError(f"{where} must be a table of keys, got {type(table).__name__}")
    for key in table:
        if key not in known:
            raise RigError(f"{where}: unknown key {key!r}{nearest_hint(str(key), known)}")
    return table


def _pose_from(table: Any, where: str) -> Float64:
    """(4, 4) of a POSE, in the file's own unit and axes."""
    t = _known(table, POSE_KEYS, where)
    turns = [key for key in ("rotation_deg", "quaternion_wxyz") if key in t]
    if "world_from_camera" in t:
        if len(t) > 1:
            raise RigError(f"{where}: world_from_camera says everything; remove {next(k for k in t if k != 'world_from_camera')}")
        return _rigid(np.array(numbers(t["world_from_camera"], f"{where}: world_from_camera", 16)).reshape(4, 4), f"{where}: world_from_camera")
    if "position" not in t:
        raise RigError(f"{where}: holds no world_from_camera and no position; give one of them")
    if len(turns) > 1:
        raise RigError(f"{where}: give rotation_deg or quaternion_wxyz, not both")
    R = np.eye(3)
    if turns == ["rotation_deg"]:
        angles = numbers(t["rotation_deg"], f"{where}: rotation_deg", 3)
        R = rotation_of(angles, checked_order(t.get("rotation_order", "ZXY")))
    elif turns:
        R = rotation_of_quaternion(numbers(t["quaternion_wxyz"], f"{where}: quaternion_wxyz", 4))
    return _pose(R, np.array(numbers(t["position"], f"{where}: position", 3)))


def _frame_number(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise RigError(f"frames: {word!r} is no frame number") from None


def _in_world(pose: Float64, unit_m: float, axes: str, up: str) -> Float64:
    """A file's pose in ours: metres, y up, the camera looks down -z."""
    turn = UPS[up]
    R = turn @ pose[:3, :3]
    return _pose(R @ FLIP if axes == "opencv" else R, turn @ pose[:3, 3] * unit_m)


def _unit(value: Any) -> float:
    (unit,) = numbers([value], "unit_m", 1)
    if not (math.isfinite(unit) and unit > 0):
        raise RigError(f"unit_m must be > 0 metres, got {unit:g}")
    return unit


def poses_from_dict(table: Any, *, name: str = "poses") -> Poses:
    """Poses from the tables of our JSON.  Raises RigError."""
    t = _known(table, KEYS, "poses")
    if t.get("version", VERSION) != VERSION:
        raise RigError(f"version must be {VERSION}, got {t['version']!r}; was it written by a newer stereorelight?")
    axes, up, unit = t.get("axes", "scene"), t.get("up", "y"), _unit(t.get("unit_m", 1.0))
    for key, word, known in (("axes", axes, AXES), ("up", up, UPS)):
        if word not in known:
            raise RigError(f"{key} {word!r} is unknown{nearest_hint(str(word), known)}")
    if ("frames" in t) == ("pose" in t):
        raise RigError("give frames, or pose for a camera that stands still, one of them")
    if "pose" in t:
        return Poses(frames={}, still=_in_world(_pose_from(t["pose"], "pose"), unit, axes, up), name=name)
    if not isinstance(t["frames"], dict) or not t["frames"]:
        raise RigError('frames must be a table of frame number to pose: {"1001": {"position": [0, 0, 0]}}')
    frames = {_frame_number(word): _in_world(_pose_from(pose, f"frame {word}"), unit, axes, up) for word, pose in t["frames"].items()}
    return Poses(frames=frames, name=name)


def poses_from_chan(text: str, *, unit_m: float = 1.0, order: str = "ZXY", name: str = "poses") -> Poses:
    """Poses from the text of a .chan file.  Raises RigError naming the line."""
    unit, order = _unit(unit_m), checked_order(order)
    return Poses(frames={frame: _pose(rotation_of(angles, order), np.array(place) * unit) for frame, place, angles in chan_rows(text)}, name=name)


def read_poses(path: str | Path, *, unit_m: float | None = None, order: str | None = None) -> Poses:
    """The poses in file `path`: JSON, or .chan where its name ends in that.

    unit_m : metres in one unit of a .chan file, which does not say it itself (0.01 for centimetres, as Maya has them); 1 where None.
    order  : of a .chan file's angles; Nuke's own ZXY where None.
    Raises : RigError naming the file.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix.lower() == ".chan":
            return poses_from_chan(text, unit_m=1.0 if unit_m is None else unit_m, order=order or "ZXY", name=str(path))
        for key, value in (("unit_m", unit_m), ("rotation_order", order)):
            if value is not None:
                raise RigError(f"{key} belongs to a .chan file; a JSON of poses says it itself")
        return poses_from_dict(json.loads(text), name=str(path))
    except FileNotFoundError:
        raise RigError(f"{path}: file of camera poses missing") from None
    except OSError as error:
        raise RigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise RigError(f"{path}: not a text file; camera poses are JSON or Nuke's .chan") from None
    except json.JSONDecodeError as error:
        raise RigError(f"{path}: not valid JSON at line {error.lineno}: {error.msg}; a Nuke camera file ends in .chan") from None
    except RecursionError:
        raise RigError(f"{path}: a nesting in it is beyond reading") from None
    except RigError as error:
        raise RigError(f"{path}: {error}") from None


def write_poses(path: str | Path, poses: Poses, *, force: bool = False) -> Path:
    """Write poses as our JSON, every digit kept; or as .chan (metres, ZXY) where the name ends in that.  Raises OutputError, RigError."""
    path = Path(path)
    if path.suffix.lower() == ".chan":
        if poses.still is not None:
            raise RigError(f"{path}: a .chan file has a line a frame, and this camera stands still without any; write JSON")
        return write_text(path, chan_text(poses.frames), force=force)
    table: dict[str, Any] = {"version": VERSION}
    if poses.still is not None:
        table["pose"] = {"world_from_camera": poses.still.tolist()}
    else:
        table["frames"] = {str(frame): {"world_from_camera": poses.frames[frame].tolist()} for frame in sorted(poses.frames)}
    return write_text(path, json.dumps(table, indent=1) + "\n", force=force)


def of_left_eye(pose: Float64, eye: Eye, rig: Rig | None) -> Float64:
    """World from the left eye's scene frame, where `pose` is that of `eye`; the right one needs the rig."""
    if eye == "left":
        return pose
    if rig is None:
        raise RigError("the pose of the right eye says where the left one stands only through the rig; give the left eye's, or the rig")
    left_right = _pose(FLIP @ rig.R_right_left @ FLIP, FLIP @ rig.t_right_left_m)  # right from left, both scene frames
    return _rigid(pose @ left_right, "world from the left eye")
