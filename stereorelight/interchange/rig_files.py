"""Rigs of other packages: any file in, whatever it is; any dialect out, exactly or not at all.

In: one path or several.  Out: a `Rig`, and the dialect with the reason why it was taken for that.
A file is told by what it holds, not by its suffix.  No dialect but ours knows a mirrored eye: its camera describes the
flipped-back picture there too, which `flipped_back=True` acknowledges."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereorelight.camera import Rig
from stereorelight.errors import RigError, nearest_hint
from stereorelight.files import refuse_overwrite, write_text
from stereorelight.interchange.kalibr import kalibr_from_rig, rig_from_kalibr
from stereorelight.interchange.meshroom import meshroom_from_rig, rig_from_meshroom
from stereorelight.interchange.mrcal import mrcal_from_rig, parse_cameramodel, rig_from_mrcal
from stereorelight.interchange.opencv import opencv_from_rig, rig_from_opencv, says_rig
from stereorelight.interchange.rigs import files_of, is_ours, rig_from_dict, write_rig
from stereorelight.interchange.ros import rig_from_ros, ros_from_rig
from stereorelight.interchange.yaml_text import parse_yaml

DIALECTS = ("stereorelight", "opencv", "kalibr", "mrcal", "ros", "meshroom")
PAIRS = ("mrcal", "ros")  # one file an eye
LARGEST_BYTES = 512 << 20  # an sfm with its structure; anything larger is no rig file


@dataclass(frozen=True, kw_only=True)
class RigFile:
    """One file understood.

    dialect : of DIALECTS.     evidence : the words in it that say so.     table : what it holds, parsed.
    """

    path: Path
    dialect: str
    evidence: str
    table: Any


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise RigError(f"{path}: {path.stat().st_size >> 20} MiB is no rig file")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise RigError(f"{path}: rig file missing") from None
    except OSError as error:
        raise RigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise RigError(f"{path}: not a text file; wanted a rig in one of the dialects {', '.join(DIALECTS)}") from None


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise RigError(f"not valid JSON at line {error.lineno}: {error.msg}") from None
    except (ValueError, RecursionError):
        raise RigError("a number or a nesting in it is beyond reading") from None


def _parsed(text: str) -> Any:
    head = text.lstrip()[:1]
    if not head:
        raise RigError("is empty")
    if "lensmodel" in text or "lens_model" in text:
        lines = (line.strip() for line in text.splitlines())
        if next((line for line in lines if line and not line.startswith("#")), "").startswith("{"):
            return parse_cameramodel(text)
    return _json(text) if head == "{" else parse_yaml(text)


def _told(table: Any) -> tuple[str, str]:
    if isinstance(table, dict):
        keys = {str(k) for k in table}
        if is_ours(table):
            return "stereorelight", "keys left, right, R_right_left"
        if keys & {"lensmodel", "lens_model"} and "intrinsics" in keys:
            return "mrcal", "keys lensmodel and intrinsics"
        if {"views", "intrinsics"} <= keys or {"version", "poses"} <= keys:
            return "meshroom", "keys views, intrinsics, poses"
        if {"camera_matrix", "projection_matrix"} <= keys or {"camera_matrix", "rectification_matrix"} <= keys:
            return "ros", "keys camera_matrix, rectification_matrix, projection_matrix"
        cameras = [k for k in keys if k.startswith("cam") and isinstance(table[k], dict) and "camera_model" in table[k]]
        if cameras:
            return "kalibr", f"{min(cameras)} with a camera_model"
        if says_rig(table):
            return "opencv", "a camera matrix, or R and T, by OpenCV's names"
    raise RigError(f"holds no rig that is known; wanted one of the dialects {', '.join(DIALECTS)}")


def read_rig_file(path: str | Path) -> RigFile:
    """One file, parsed, and what it is.  Raises RigError naming the file."""
    path = Path(path)
    text = _text(path)
    try:
        table = _parsed(text)
        dialect, evidence = _told(table)
    except RigError as error:
        raise RigError(f"{path}: {error}") from None
    return RigFile(path=path, dialect=dialect, evidence=evidence, table=table)


def read_any_rig(
    paths: str | Path | Sequence[str | Path],
    *,
    size: tuple[int, int] | None = None,
    unit_m: float | None = None,
    told: Callable[[RigFile], None] | None = None,
) -> Rig:
    """The rig that `paths` say in whatever dialect.

    paths  : one file, or several that belong together: mrcal and ROS have one an eye, LEFT before RIGHT; OpenCV any split.
             %V in a name stands for left and right, %v for l and r: two files.
    size   : (width, height) of the pictures, for OpenCV files that do not say it.
    unit_m : metres in one unit of the file (0.001 for millimetres, the board's square for squares); None takes metres, and
             refuses a baseline that no rig has.  Our own files are always in metres.
    told   : called with each file, for a line of words about what it was taken for.
    Raises : RigError naming the file, what is missing or cannot be said, and the remedy.
    """
    given = [paths] if isinstance(paths, (str, Path)) else list(paths)
    listed = [file for path in given for file in files_of(path)]
    if not listed:
        raise RigError("no rig file given")
    files = [read_rig_file(path) for path in listed]
    for file in files:
        if told is not None:
            told(file)
    names = ", ".join(str(file.path) for file in files)
    dialects = sorted({file.dialect for file in files})
    if len(dialects) > 1:
        # A pair of ROS files looks like OpenCV's own to those who keep R and T in a file of their own.
        if dialects != ["opencv", "ros"]:
            raise RigError(f"{names}: files of different dialects ({', '.join(dialects)}); give those of one rig")
        dialects = ["opencv"]
    dialect, tables = dialects[0], [file.table for file in files]
    wanted = 2 if dialect in PAIRS else 1
    if dialect != "opencv" and len(tables) != wanted:
        each = "one file for each eye, LEFT and RIGHT (rig_%V.yaml says rig_left.yaml and rig_right.yaml)"
        what = each if wanted == 2 else "one file for both eyes"
        raise RigError(f"{names}: {dialect} wants {what}, got {len(tables)}")
    try:
        if dialect == "opencv":
            return rig_from_opencv(tables, size=size, unit_m=unit_m)
        if dialect == "kalibr":
            return rig_from_kalibr(tables[0], unit_m=unit_m)
        if dialect == "meshroom":
            return rig_from_meshroom(tables[0], unit_m=unit_m)
        if dialect == "stereorelight":
            return rig_from_dict(tables[0])
        return (rig_from_mrcal if dialect == "mrcal" else rig_from_ros)(tables[0], tables[1], unit_m=unit_m)
    except RigError as error:
        raise RigError(f"{names}: {error}") from None


def write_rig_as(path: str | Path, rig: Rig, dialect: str, *, flipped_back: bool = False, force: bool = False) -> tuple[Path, ...]:
    """Write `rig` in `dialect`, exactly, or raise RigError with what the dialect lacks and what would do.

    path         : the file; for mrcal and ros, which have one an eye, NAME.ext becomes NAME_left.ext and NAME_right.ext.
                   opencv writes JSON where the suffix is .json and YAML else.
    flipped_back : a mirrored eye's plates will be flipped back left-right before the other package sees them; without it a
                   mirrored rig is refused, for no other dialect can say it.
    Returns      : the files written.  Raises RigError, OutputError.
    """
    path = Path(path)
    if dialect not in DIALECTS:
        raise RigError(f"dialect {dialect!r} is unknown{nearest_hint(dialect, DIALECTS)}")
    if dialect == "stereorelight":
        return (write_rig(path, rig, force=force),)
    if rig.mirrored is not None and not flipped_back:
        raise RigError(
            f"{dialect} cannot say that the {rig.mirrored} eye is mirrored; flip its plates back left-right for the other package, "
            "and say so (--flipped-back)"
        )
    texts: tuple[str, ...]
    targets: tuple[Path, ...]
    if dialect in PAIRS:
        texts = mrcal_from_rig(rig) if dialect == "mrcal" else ros_from_rig(rig)
        targets = tuple(path.with_name(f"{path.stem}_{eye}{path.suffix}") for eye in ("left", "right"))
    else:
        if dialect == "opencv":
            text = opencv_from_rig(rig, as_json=path.suffix.lower() == ".json")
        else:
            text = kalibr_from_rig(rig) if dialect == "kalibr" else meshroom_from_rig(rig)
        texts, targets = (text,), (path,)
    for target in targets:
        refuse_overwrite(target, force=force)
    return tuple(write_text(target, text, force=force) for target, text in zip(targets, texts))
