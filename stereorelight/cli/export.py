"""`stereorelight export`: a rig in another package's words, or as ST-maps; foreign rigs in ours; and the seen surface as PLY."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stereorelight.cli.common import FILE, force_option, json_option, report, say

if TYPE_CHECKING:
    from stereorelight.camera import Rig

TARGETS = ("stereorelight", "opencv", "kalibr", "mrcal", "ros", "meshroom", "stmap", "ply")


@click.command("export")
@click.argument("source", nargs=-1, required=True, type=FILE, metavar="RIG... | SHOT.toml | PASSES.exr")
@click.option(
    "--to",
    "target",
    required=True,
    type=click.Choice(TARGETS),
    help="The package; stereorelight: our own rig.json; stmap: EXR maps for Nuke; ply: the surface.",
)
@click.option("--out", "path", required=True, type=FILE, metavar="FILE", help="mrcal, ros and stmap write NAME_left and NAME_right for NAME.")
@click.option("--size", metavar="WxH", help="Size of the pictures, where the source does not say it (OpenCV).")
@click.option(
    "--unit", "unit_m", type=click.FloatRange(min=0, min_open=True), metavar="M", help="Metres in one unit of the source: 0.001 for millimetres."
)
@click.option("--flipped-back", is_flag=True, help="The mirrored eye's plates will be flipped back before the other package sees them.")
@click.option("--overscan", type=float, metavar="SHARE", help="stmap: add so much of the plate on each side; what holds every pixel when left out.")
@click.option("--rectify", is_flag=True, help="stmap: also maps to the rectified pair and back.")
@click.option("--points", is_flag=True, help="ply: points alone, without triangles.")
@click.option(
    "--thickness",
    "thickness_mm",
    type=click.FloatRange(min=0),
    default=0.0,
    metavar="MM",
    help="ply: close things so far behind what is seen of them; 0 leaves a sheet.",
)
@click.option("--plate", metavar="FILE", help="ply: the plate that colours the points of PASSES.exr; a shot knows its own.")
@click.option("--min-confidence", type=click.FloatRange(0, 1), default=0.0, help="ply: leave out what depth is less sure of.")
@click.option("--rig", "rig_path", type=FILE, metavar="RIG", help="ply: with LEFT.exr RIGHT.exr, both eyes' points brought together.")
@click.option("--frames", metavar="A-B", help="ply: frames of a shot; FILE is then a pattern.")
@force_option
@json_option
def command(
    source: tuple[Path, ...],
    target: str,
    path: Path,
    size: str | None,
    unit_m: float | None,
    flipped_back: bool,
    overscan: float | None,
    rectify: bool,
    points: bool,
    thickness_mm: float,
    plate: str | None,
    min_confidence: float,
    rig_path: Path | None,
    frames: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """The rig of RIG or of a shot, for other software.

    RIG is a file of ours, OpenCV, Kalibr, mrcal, ROS or Meshroom, told by what it holds; two files, LEFT and RIGHT, where
    there is one an eye.  What the other package cannot say is refused.

    --to ply writes the surface that a Z or P pass shows, cut at depth edges; a shot's own, once it has been run.
    """
    of_surface = points or thickness_mm or plate or min_confidence or rig_path or frames
    if target == "ply":
        _surface(source, path, points, thickness_mm, plate, min_confidence, rig_path, frames, force=force, as_json=as_json)
        return
    if of_surface:
        raise click.UsageError("--points, --thickness, --plate, --min-confidence, --rig and --frames belong to --to ply")
    if target != "stmap" and (overscan is not None or rectify):
        raise click.UsageError("--overscan and --rectify belong to --to stmap")
    rig = _rig(source, _size(size), unit_m, as_json=as_json)
    values: dict[str, Any] = {"to": target}
    if target == "stmap":
        from stereorelight.shot.stmaps import write_stmaps

        maps = write_stmaps(path, rig, overscan=overscan, rectify=rectify, force=force)
        values["files"] = [m.to_dict() for m in maps]
        margin = next(m.margin for m in maps if m.margin is not None)
        words = f", {len(maps)} maps; the left canvas is {maps[0].gives[0]}x{maps[0].gives[1]}, {margin[0]} and {margin[1]} px about the plate"
        if rig.mirrored:
            words += f"; for the {rig.mirrored} eye's plates flipped back left-right"
        written = maps[0].path
    else:
        from stereorelight.interchange.rig_files import write_rig_as

        files = write_rig_as(path, rig, target, flipped_back=flipped_back, force=force)
        values["files"] = [str(f) for f in files]
        words, written = (f" and {files[1].name}" if len(files) > 1 else ""), files[0]
    report(values, f"export: {target} -> {written}{words}", as_json=as_json)


def _rig(source: tuple[Path, ...], size: tuple[int, int] | None, unit_m: float | None, *, as_json: bool) -> Rig:
    from stereorelight.interchange.rig_files import read_any_rig

    if len(source) == 1 and source[0].suffix.lower() == ".toml":
        from stereorelight.shot.schema import read_shot

        shot = read_shot(source[0])
        source = (shot.resolved(shot.tables.rig.file),)
    return read_any_rig(source, size=size, unit_m=unit_m, told=lambda f: say(f"{f.path}: {f.dialect} ({f.evidence})", as_json=as_json))


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    if not (m := re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text.strip())):
        raise click.UsageError(f"--size must be such as 1920x1080, got {text!r}")
    return int(m[1]), int(m[2])


def _surface(
    source: tuple[Path, ...],
    path: Path,
    points: bool,
    thickness_mm: float,
    plate: str | None,
    least: float,
    rig_path: Path | None,
    frames: str | None,
    *,
    force: bool,
    as_json: bool,
) -> None:
    from stereorelight.shot.clouds import export_merged, export_shot, export_surface

    if thickness_mm and (points or len(source) == 2):
        raise click.UsageError("--thickness closes triangles: give one file or a shot, without --points")
    if source[0].suffix.lower() == ".toml":
        if len(source) > 1 or plate or rig_path:
            raise click.UsageError("a shot stands alone, and knows its own plates and rig")
        made = export_shot(source[0], path, frames=frames, mesh=not points, least_confidence=least, thickness_m=thickness_mm * 1e-3, force=force)
    elif len(source) == 2:
        if rig_path is None or plate:
            raise click.UsageError("LEFT.exr RIGHT.exr need --rig, which says how the eyes stand, and take no --plate")
        made = [export_merged(source[0], source[1], rig_path, path, least_confidence=least, force=force)]
    elif len(source) == 1 and rig_path is None and frames is None:
        made = [export_surface(source[0], path, plate=plate, mesh=not points, least_confidence=least, thickness_m=thickness_mm * 1e-3, force=force)]
    else:
        raise click.UsageError("--to ply takes PASSES.exr, or LEFT.exr RIGHT.exr with --rig, or SHOT.toml")
    first = made[0]
    where = str(first["file"]) if len(made) == 1 else f"{len(made)} files, first {first['file']}"
    report({"to": "ply", "files": made}, f"export: {first['points']} points, {first['triangles']} triangles -> {where}", as_json=as_json)
