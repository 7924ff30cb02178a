"""The ST-maps of a rig as EXR files: undistort and redistort of each eye, and rectify with its way back.

In: a `Rig`.  Out: 32-bit float ZIP files of bare R, G, B, A, the words of each header saying what it is fed with and what it gives.
Pixels and values: interchange/stmap.py."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from stereorelight.arrays import Float32, Float64
from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError
from stereorelight.files import refuse_overwrite
from stereorelight.footage.exr import write_exr
from stereorelight.interchange.rigs import camera_to_dict
from stereorelight.interchange.stmap import st_map, undistortion
from stereorelight.shot.pairs import EYES, FLIPPED
from stereorelight.stereo.rectify import rectification

NAMES = ("undistort", "redistort")
RECTIFY_NAMES = ("rectify", "unrectify")


@dataclass(frozen=True, kw_only=True)
class MapFile:
    """One map written: the format that it must be fed with, and the format of its result, (width, height)."""

    path: Path
    fed: tuple[int, int]
    gives: tuple[int, int]
    margin: tuple[int, int] | None = None

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        margin = None if self.margin is None else list(self.margin)
        return {"file": str(self.path), "source_size": list(self.fed), "size": list(self.gives), "margin_px": margin}


def write_stmaps(path: str | Path, rig: Rig, *, overscan: float | None = None, rectify: bool = False, force: bool = False) -> tuple[MapFile, ...]:
    """Write NAME_left_undistort.exr, NAME_left_redistort.exr and the right eye's, for NAME.exr.

    overscan : as in `undistortion`.      rectify : also NAME_left_rectify.exr and NAME_left_unrectify.exr, and the right eye's.
    Raises   : RigError, OutputError before anything is written.
    """
    path = Path(path)
    if path.suffix.lower() != ".exr":
        raise RigError(f"{path}: ST-maps are EXR files; name it such as {path.stem or 'lens'}.exr")
    names = NAMES + (RECTIFY_NAMES if rectify else ())
    targets = {(eye, name): path.with_name(f"{path.stem}_{eye}_{name}.exr") for eye in EYES for name in names}
    for target in targets.values():
        refuse_overwrite(target, force=force)
    lenses = {eye: undistortion(rig.camera(eye), overscan=overscan) for eye in EYES}
    flats = _flats(rig) if rectify else {}
    files = []
    for (eye, name), target in targets.items():
        plate, canvas = lenses[eye].plate, lenses[eye].canvas
        margin = lenses[eye].margin if name in NAMES else None
        if name == "undistort":
            st, source, result = lenses[eye].undistort_map(), plate, canvas
        elif name == "redistort":
            st, source, result = lenses[eye].redistort_map(), canvas, plate
        else:
            flat, R = flats[eye]
            source, result = (plate, flat) if name == "rectify" else (flat, plate)
            st = st_map(result, source, R.T if name == "rectify" else R)
        _write(target, st, _words(eye, name, source, result, margin, flipped=rig.mirrored == eye), force=force)
        files.append(MapFile(path=target, fed=source.size, gives=result.size, margin=margin))
    return tuple(files)


def _flats(rig: Rig) -> dict[str, tuple[Camera, Float64]]:
    """Each eye's rectified camera, and the rotation to it from the eye's own frame."""
    flat = rectification(rig).rig
    return {"left": (flat.left, flat.R_rectified_left), "right": (flat.right, flat.R_rectified_right)}


def _words(eye: str, name: str, source: Camera, result: Camera, margin: tuple[int, int] | None, *, flipped: bool) -> dict[str, str]:
    words = {
        "stereorelight/stmap": f"{name} of the {eye} eye: R = (x + 0.5) / width, G = (y + 0.5) / height of the source, from the bottom left",
        "stereorelight/stmap_source_size": f"{source.size[0]} {source.size[1]}",
        "stereorelight/camera": json.dumps(camera_to_dict(result)),
    }
    if margin is not None:
        words["stereorelight/stmap_margin_px"] = f"{margin[0]} {margin[1]}"
    if flipped:
        words["stereorelight/" + FLIPPED] = "yes"
    return words


def _write(path: Path, st: Float32, words: dict[str, str], *, force: bool) -> None:
    write_exr(path, {name: st[..., i] for i, name in enumerate("RGBA")}, metadata=words, force=force)
