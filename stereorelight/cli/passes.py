"""`stereorelight passes`: P and N from any Z pass, ours or a renderer's."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option, out_option, report

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}


@click.command("passes")
@click.argument("depth")
@out_option
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The camera that saw Z: one eye of a rig; else the file's own ...")
@click.option("--eye", type=click.Choice(["left", "right"]), help="Which eye; the file's own where it says so.")
@click.option("--fov-deg", type=float, metavar="DEG", help="... or a centred pinhole of this horizontal field of view.")
@click.option("--layer", metavar="NAME", help="The channel or layer that holds the depth; Z, depth.Z and their like are found.")
@click.option("--unit", type=click.Choice(list(METRES)), default="m", show_default=True, help="What one unit of it is.")
@click.option("--ray-length", is_flag=True, help="It holds the distance from the camera, not along the optical axis.")
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
    unit: str,
    ray_length: bool,
    method: Literal["plane", "difference"],
    frames: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """Z, P and N of DEPTH.exr.

    P is in metres in the scene frame of the camera: x right, y up, the camera looks down -z.  N is unit and faces the
    camera.
    """
    if rig_path and fov_deg is not None:
        raise click.UsageError("give the camera by --rig or by --fov-deg, not both")

    from dataclasses import replace

    from stereorelight.cli.common import outputs_for
    from stereorelight.cli.progress import Bar
    from stereorelight.footage.frames import write_frame
    from stereorelight.footage.sequence import Sequence
    from stereorelight.interchange.rigs import read_rig
    from stereorelight.shot.depths import read_depth, surface_of
    from stereorelight.shot.steps import surface_figures

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
            found = read_depth(source, layer=layer, metres=METRES[unit], camera=camera, fov_deg=fov_deg, ray_length=ray_length, eye=eye)
            frame = replace(surface_of(found, method=method), number=number)
            write_frame(path, frame, force=force)
            results.append({"frame": number, "file": str(path), **surface_figures(frame)})
            bar.note(source.name, advance=1)
    first = results[0]
    where = first["file"] if len(results) == 1 else f"{len(results)} frames, first {first['file']}"
    text = f"passes: P covers {first['P_cover_percent']:g} %, N {first['N_cover_percent']:g} % -> {where}"
    report({"frames": results}, text, as_json=as_json)
