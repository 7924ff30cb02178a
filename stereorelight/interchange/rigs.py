"""`rig.json`: the two calibrated eyes as a file, read and written; `read_rig` takes other packages' files too (rig_files.py).

Format in docs/conventions.md.  Everything that no rig can be is refused with the file, the key and the remedy."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError, nearest_hint
from stereorelight.files import write_text

VERSION = 1
FOREIGN_LINE = re.compile(r"^%YAML|^\s*[\w.-]+\s*:(\s|$)", re.MULTILINE)
FOREIGN_TABLE = re.compile(r"['\"]lens_?model['\"]\s*:")
RIG_KEYS = ("version", "left", "right", "R_right_left", "t_right_left_m", "mirrored", "quality")
CAMERA_KEYS = ("size", "K", "model", "distortion")


def _checked_keys(table: Any, known: tuple[str, ...], required: tuple[str, ...], where: str) -> Mapping[str, Any]:
    if not isinstance(table, dict):
        raise RigError(f"{where} must be a table of keys, got {type(table).__name__}")
    for key in table:
        if key not in known:
            raise RigError(f"{where}: unknown key {key!r}{nearest_hint(str(key), known)}")
    for key in required:
        if key not in table:
            raise RigError(f"{where}: key {key!r} is missing; it needs {', '.join(required)}")
    return table


def _camera_from_dict(table: Any, where: str) -> Camera:
    t = _checked_keys(table, CAMERA_KEYS, ("size", "K"), where)
    try:
        return Camera(size=t["size"], K=t["K"], model=t.get("model", "brown"), distortion=t.get("distortion", ()))
    except RigError as error:
        raise RigError(f"{where}: {error}") from None


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    """Size, K, model and distortion of `camera` as plain lists (its pose travels elsewhere)."""
    return {"size": list(camera.size), "K": camera.K.tolist(), "model": camera.model, "distortion": list(camera.distortion)}


def rig_from_dict(table: Any) -> Rig:
    """A `Rig` from the tables of a rig.json.  Raises RigError."""
    t = _checked_keys(table, RIG_KEYS, ("left", "right", "R_right_left", "t_right_left_m"), "rig")
    version = t.get("version", VERSION)
    if version != VERSION:
        raise RigError(f"rig version must be {VERSION}, got {version!r}; was it written by a newer stereorelight?")
    quality = t.get("quality") or {}
    if not isinstance(quality, dict):
        raise RigError(f"quality must be a table of keys, got {type(quality).__name__}")
    return Rig(
        left=_camera_from_dict(t["left"], "left"),
        right=_camera_from_dict(t["right"], "right"),
        R_right_left=t["R_right_left"],
        t_right_left_m=t["t_right_left_m"],
        mirrored=t.get("mirrored"),
        quality=quality,
    )


def rig_to_dict(rig: Rig) -> dict[str, Any]:
    """The tables of a rig.json; `rig_from_dict` gives the same rig back bit for bit."""
    return {
        "version": VERSION,
        "left": camera_to_dict(rig.left),
        "right": camera_to_dict(rig.right),
        "R_right_left": rig.R_right_left.tolist(),
        "t_right_left_m": rig.t_right_left_m.tolist(),
        "mirrored": rig.mirrored,
        "quality": rig.quality,
    }


def files_of(path: str | Path) -> tuple[Path, ...]:
    """The file that `path` names, or the two, left before right, where its name holds %V (left, right) or %v (l, r)."""
    path = Path(path)
    for sign, words in (("%V", ("left", "right")), ("%v", ("l", "r"))):
        if sign in path.name:
            return tuple(path.with_name(path.name.replace(sign, word)) for word in words)
    return (path,)


def is_ours(table: Mapping[str, Any]) -> bool:
    """Whether a table wants to be one of ours, keys misspelt or missing included."""
    return "R_right_left" in table or {"left", "right", "version"} <= set(table)


def _is_foreign_text(text: str) -> bool:
    """Whether a text is another package's, not JSON: "key: value" lines, or mrcal's Python table."""
    head = text.lstrip()[:1]
    return FOREIGN_TABLE.search(text) is not None if head == "{" else FOREIGN_LINE.search(text) is not None


def read_rig(path: str | Path) -> Rig:
    """The rig in file `path`: ours, or another package's, told by what it holds.

    path   : with %V or %v in its name two files, one an eye, as mrcal and ROS have them.
    Raises : RigError naming the file.
    """
    path = Path(path)
    if len(files_of(path)) > 1:
        return _foreign(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
        if _is_foreign_text(text):
            return _foreign(path)
        table = json.loads(text)
    except FileNotFoundError:
        raise RigError(f"{path}: rig file missing; give its path by --rig or in the shot file, or write one as calib/README.md shows") from None
    except OSError as error:
        raise RigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except json.JSONDecodeError as error:
        raise RigError(f"{path}: not valid JSON at line {error.lineno}, column {error.colno}: {error.msg}") from None
    except UnicodeDecodeError:
        raise RigError(f"{path}: not a text file; a rig file is JSON, or another package's text") from None
    except (ValueError, RecursionError):  # a number of thousands of digits, brackets thousands deep
        raise RigError(f"{path}: not a rig file; a number or a nesting in it is beyond reading") from None
    if isinstance(table, dict) and table and not is_ours(table):
        return _foreign(path)
    try:
        return rig_from_dict(table)
    except RigError as error:
        raise RigError(f"{path}: {error}") from None


def _foreign(path: Path) -> Rig:
    # Imported here, since the dialects need this module; and most rigs are ours.
    from stereorelight.interchange.rig_files import read_any_rig

    return read_any_rig(path)


def write_rig(path: str | Path, rig: Rig, *, force: bool = False) -> Path:
    """Write `rig` as JSON, whole or not at all.  Raises OutputError."""
    return write_text(path, json.dumps(rig_to_dict(rig), indent=2) + "\n", force=force)
