"""A surface as a file of points or triangles, from the passes of a frame or of both eyes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight import __version__
from stereorelight.arrays import Float32
from stereorelight.camera import Rig
from stereorelight.errors import PassError, PlateError, ShotError
from stereorelight.footage.curves import encode
from stereorelight.footage.frames import read_frame
from stereorelight.footage.plates import read_plate
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.interchange.ply import write_ply
from stereorelight.interchange.rigs import read_rig
from stereorelight.passes import Frame
from stereorelight.shot.frame import prepare
from stereorelight.shot.job import FrameJob
from stereorelight.shot.pairs import FLIPPED
from stereorelight.surface.cloud import SeenBy, cloud_of, merged
from stereorelight.surface.mesh import beside_nearer, links_of, mesh_from_depth, solid, without
from stereorelight.synth.render import world_from_eye

COMMENTS = ("stereorelight " + __version__, "metres; x right, y up, the camera at 0 0 0 looks down -z")


def read_surface(path: Path) -> Frame:
    """A frame of `path` that holds Z and the camera that saw it.  Raises PlateError, PassError."""
    frame = read_frame(path)
    if "Z" not in frame and "P" in frame:
        frame = frame.with_passes(Z=-frame["P"][..., 2])
    if "Z" not in frame:
        raise PassError(f"{path}: has no pass Z, only {', '.join(frame)}; give a file that `depth`, `passes` or `run` wrote")
    if frame.camera is None:
        raise PassError(f"{path}: does not say which camera saw it; make it anew with `stereorelight passes --rig`")
    return frame


def write_surface(
    path: Path,
    frame: Frame,
    *,
    plate: Float32 | None = None,
    mesh: bool = True,
    least_confidence: float = 0.0,
    thickness_m: float = 0.0,
    force: bool = False,
) -> tuple[int, int]:
    """Write a frame's surface as PLY; how many points and triangles it has.

    plate       : (H, W, 3) linear, for colours, which are written as sRGB shows them.     mesh : triangles too, cut at depth edges.
    thickness_m : how far behind what is seen of it a thing goes on, and is closed there; 0 leaves a sheet.
    """
    assert frame.camera is not None
    Z = np.array(frame["Z"])
    if least_confidence > 0 and "confidence" in frame:
        Z[np.nan_to_num(frame["confidence"]) < least_confidence] = np.nan
    triangles = None
    if mesh:
        sigma = frame.passes.get("Z_sigma")
        links = links_of(Z, frame.camera, Z_sigma=sigma)
        casts = np.isfinite(Z) if sigma is None else np.isfinite(Z) & solid(links) & ~beside_nearer(Z, links, within_px=1)
        made = mesh_from_depth(np.where(casts, Z, np.nan), frame.camera, thickness_m=thickness_m, links=without(links, ~casts))
        used, triangles = np.unique(made.triangles, return_inverse=True)
        triangles = triangles.reshape(-1, 3).astype(np.int32)
        points = made.vertices[used]
        pixel = made.pixel[used]
        behind = (used >= len(made.vertices) // 2) if thickness_m > 0 else np.zeros(len(used), bool)
    else:
        cloud = cloud_of(SeenBy(Z=Z, camera=frame.camera))
        points, pixel = cloud.points, np.flatnonzero(np.isfinite(Z))
        behind = np.zeros(len(points), bool)
    normals = None if "N" not in frame else np.nan_to_num(frame["N"].reshape(-1, 3)[pixel]) * np.where(behind, -1, 1)[:, None].astype(np.float32)
    sure = None if "confidence" not in frame else np.nan_to_num(frame["confidence"].reshape(-1)[pixel])
    colours = None if plate is None else encode(plate.reshape(-1, 3)[pixel], "sRGB")
    write_ply(path, points, normals=normals, colours=colours, confidence=sure, triangles=triangles, comments=COMMENTS, force=force)
    return len(points), 0 if triangles is None else len(triangles)


def write_merged(path: Path, left: Frame, right: Frame, rig: Rig, *, least_confidence: float = 0.0, force: bool = False) -> int:
    """Write both eyes' points, brought together, as PLY; how many there are."""
    level = replace(rig, left=replace(rig.left, world_from_camera=np.eye(4)))

    def seen(frame: Frame) -> SeenBy:
        assert frame.camera is not None
        more = {name: frame.passes.get(name) for name in ("Z_sigma", "confidence", "N")}
        return SeenBy(Z=frame["Z"], camera=frame.camera, **more)

    cloud = merged(seen(left), seen(right), world_from_eye(level, "right"), least_confidence=least_confidence)
    write_ply(path, cloud.points, normals=cloud.normals, confidence=cloud.confidence, comments=COMMENTS, force=force)
    return len(cloud)


def _noted(path: Path, points: int, triangles: int) -> dict[str, Any]:
    return {"file": str(path), "points": points, "triangles": triangles}


def export_surface(
    source: Path,
    path: Path,
    *,
    plate: str | None = None,
    mesh: bool = True,
    least_confidence: float = 0.0,
    thickness_m: float = 0.0,
    force: bool = False,
) -> dict[str, Any]:
    """The surface of a file with Z, coloured by the picture `plate`; its file and figures.  Raises PassError, PlateError."""
    frame = read_surface(source)
    picture = None
    if plate is not None:
        picture = read_plate(plate)
        if frame.metadata.get(FLIPPED):
            picture = np.ascontiguousarray(picture[:, ::-1])
        if picture.shape[:2] != frame.size_hw:
            (h, w), (a, b) = frame.size_hw, picture.shape[:2]
            raise PlateError(f"{plate}: is {b}x{a} pixels, {source} {w}x{h}; give the plate that the depth lies on")
    figures = write_surface(path, frame, plate=picture, mesh=mesh, least_confidence=least_confidence, thickness_m=thickness_m, force=force)
    return _noted(path, *figures)


def export_merged(left: Path, right: Path, rig_path: Path, path: Path, *, least_confidence: float = 0.0, force: bool = False) -> dict[str, Any]:
    """Both eyes' points, brought together by the rig.  Raises PassError, PlateError, RigError."""
    one, other = read_surface(left), read_surface(right)
    if (one.eye, other.eye) != ("left", "right"):
        raise PassError(f"{left}, {right}: are of the {one.eye} and the {other.eye} eye; give the left eye's file, then the right one's")
    return _noted(path, write_merged(path, one, other, read_rig(rig_path), least_confidence=least_confidence, force=force), 0)


def export_shot(
    shot: Path,
    path: Path,
    *,
    frames: str | None = None,
    mesh: bool = True,
    least_confidence: float = 0.0,
    thickness_m: float = 0.0,
    force: bool = False,
) -> list[dict[str, Any]]:
    """The surface of every frame that a run of the shot made, coloured by its plate.  Raises ShotError, PlateError and what the shot raises."""
    ready = prepare(shot, frames)
    pattern = Pattern.parse(str(path), must_exist=False)
    if len(ready.pairs) > 1 and pattern.is_single:
        raise ShotError(f"{path}: the shot has {len(ready.pairs)} frames; give a pattern such as NAME.####.ply, or --frames with one")
    made = []
    for pair in ready.pairs:
        job = FrameJob(shot=ready.shot, rectification=ready.rigs.of(pair), pair=pair)
        if not job.passes_path.is_file():
            raise PlateError(f"{job.passes_path}: file missing; run the shot first: stereorelight run {shot}")
        more = {name: job.depth[name] for name in ("Z_sigma", "confidence") if name in job.depth}
        frame = job.surface.with_passes(**more)
        target = path if pattern.is_single else pattern.path(pair.number)
        figures = write_surface(target, frame, plate=job.plate, mesh=mesh, least_confidence=least_confidence, thickness_m=thickness_m, force=force)
        made.append(_noted(target, *figures))
    return made
