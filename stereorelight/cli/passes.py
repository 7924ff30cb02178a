"""`stereorelight passes`: P and N from any Z pass, ours or a renderer's."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option, out_option, report


@click.command("passes")
@click.argument("depth")
@out_option
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The camera that saw Z: one eye of a rig; else the file's own ...")
@click.option("--eye", type=click.Choice(["left", "right"]), help="Which eye; the file's own where it says so.")
@click.option("--fov-deg", type=float, metavar="DEG", help="... or a centred pinhole of this horizontal field of view.")
@click.option("--layer", metavar="NAME", help="The channel or layer that holds the depth; Z, depth.Z and their like are found.")
@click.option("--unit", metavar="UNIT", help="What one unit of it is: m, cm, mm, ft, in, km, or a number of metres.  [default: m]")
@click.option("--ray-length", is_flag=True, help="It holds the distance from the camera, not along the optical axis: --depth-is ray.")
@click.option(
    "--depth-is", metavar="KIND", help="z, ray, inverse, normalised ..., as `compare --truth-is`; found from the file's P and N where it can be."
)
@click.option("--near", "near_m", type=float, metavar="M", help="The near end of a normalised depth, metres ...")
@click.option("--far", "far_m", type=float, metavar="M", help="... and its far end.")
@click.option("--axes", metavar="AXES", help="Where x, y and z of the file's own P and N point, such as right,down,forward.")
@click.option("--method", type=click.Choice(["plane", "difference"]), default="plane", show_default=True, help="How N is found.")
@frames_option
@force_option
@json_option
def command(
    depth: str,
    out: str,
    rig_path: Path | None,
    eye: Literal["left", "right"] | None,
    fov_deg: float | None,
    layer: str | None,
    unit: str | None,
    ray_length: bool,
    depth_is: str | None,
    near_m: float | None,
    far_m: float | None,
    axes: str | None,
    method: Literal["plane", "difference"],
    frames: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """Z, P and N of DEPTH: an EXR, ours or a renderer's, a PFM or a 16-bit PNG.

    P is in metres in the scene frame of the camera: x right, y up, the camera looks down -z.  N is unit and faces the
    camera.
    """
    if rig_path and fov_deg is not None:
        raise click.UsageError("give the camera by --rig or by --fov-deg, not both")
    if ray_length and depth_is not in (None, "ray"):
        raise click.UsageError(f"--ray-length says ray, --depth-is {depth_is}")

    from dataclasses import replace

    from stereorelight.cli.common import outputs_for
    from stereorelight.cli.progress import Bar
    from stereorelight.footage.frames import write_frame
    from stereorelight.footage.sequence import Sequence
    from stereorelight.interchange.rigs import read_rig
    from stereorelight.shot.depths import read_depth, surface_of
    from stereorelight.shot.steps import surface_figures
    from stereorelight.shot.truths import Stated, kind_of, unit_of

    stated = Stated(
        kind="ray" if ray_length else None if depth_is is None else kind_of(depth_is),
        metres=None if unit is None else unit_of(unit),
        near_m=near_m,
        far_m=far_m,
        axes=axes,
    )

    given = Sequence.parse(depth)
    if frames:
        given = given.with_frames(frames)
    numbers: list[int | None] = list(given.frames) or [None]
    paths = outputs_for(out, numbers, force=force)
    camera = read_rig(rig_path).camera(eye or "left") if rig_path else None
    results = []
    with Bar("passes", total=len(numbers)) as bar:
        for number, path in zip(numbers, paths):
            source = given.path(number)
            bar.note(source.name)
            found = read_depth(source, layer=layer, camera=camera, fov_deg=fov_deg, eye=eye, stated=stated)
            frame = replace(surface_of(found, method=method), number=number)
            write_frame(path, frame, force=force)
            told = {"depth_is": found.metadata["depth_is"]} if "depth_is" in found.metadata else {}
            results.append({"frame": number, "file": str(path), **surface_figures(frame), **told})
            bar.note(source.name, advance=1)
    first = results[0]
    where = first["file"] if len(results) == 1 else f"{len(results)} frames, first {first['file']}"
    text = f"passes: P covers {first['P_cover_percent']:g} %, N {first['N_cover_percent']:g} % -> {where}"
    if "depth_is" in first:
        text = f"{first['depth_is']}\n{text}"
    report({"frames": results}, text, as_json=as_json)
