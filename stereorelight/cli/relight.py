"""`stereorelight relight`: a plate and its passes under new lights."""

from __future__ import annotations

from pathlib import Path

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option, out_option, report, space_option


@click.command("relight")
@click.argument("plate")
@click.argument("passes")
@click.option("--lights", "lights_path", required=True, type=FILE, metavar="lights.toml", help="The lights: [[lights]] tables.")
@out_option
@click.option("--preview", metavar="FILE.png", help="Also write the relit plate as a picture to look at.")
@click.option("--plate-gain", type=click.FloatRange(min=0), default=1.0, show_default=True, help="What is left of the plate's own light.")
@click.option("--colour", type=click.Choice(["half", "float"]), default="half", show_default=True, help="Precision of the colour layers.")
@frames_option
@space_option
@force_option
@json_option
def command(
    plate: str,
    passes: str,
    lights_path: Path,
    out: str,
    preview: str | None,
    plate_gain: float,
    colour: str,
    frames: str | None,
    colour_space: str,
    force: bool,
    as_json: bool,
) -> None:
    """PLATE under the lights of a file, with the P and N of PASSES.exr.

    Writes the relit plate as RGB and every light's diffuse and specular layer.
    """
    import numpy as np

    from stereorelight.cli.common import outputs_for
    from stereorelight.cli.progress import Bar
    from stereorelight.comp import relight
    from stereorelight.errors import PassError
    from stereorelight.footage.clip import open_clip
    from stereorelight.footage.eyes import plate_frames
    from stereorelight.footage.frames import read_frame, write_frame
    from stereorelight.footage.preview import plate_picture
    from stereorelight.footage.sequence import Sequence
    from stereorelight.footage.stills import write_still
    from stereorelight.light.shade import light_layers
    from stereorelight.passes import Frame
    from stereorelight.shot.pairs import FLIPPED
    from stereorelight.shot.schema import read_lights
    from stereorelight.shot.steps import relight_figures

    lights = read_lights(lights_path)
    pictures, surfaces = open_clip(plate, colour_space=colour_space), Sequence.parse(passes)
    numbers = plate_frames(pictures, surfaces, frames)
    paths = outputs_for(out, numbers, force=force)
    previews = outputs_for(preview, numbers, force=force) if preview else [None] * len(numbers)
    results = []
    with Bar("relight", total=len(numbers)) as bar:
        for number, path, picture in zip(numbers, paths, previews):
            bar.note(path.name)
            frame = read_frame(surfaces.path(number))
            light_on = pictures.read(number)
            if frame.metadata.get(FLIPPED):
                light_on = np.ascontiguousarray(light_on[:, ::-1])
            for name in ("P", "N"):
                if name not in frame:
                    raise PassError(f"{surfaces.path(number)}: has no pass {name!r}; make it with `stereorelight passes`")
            if light_on.shape[:2] != frame.size_hw:
                sizes = [f"{h}x{w}" for w, h in (light_on.shape[:2], frame.size_hw)]
                raise PassError(
                    f"{surfaces.path(number)}: is {sizes[1]}, but the plate {pictures.name(number)} is {sizes[0]}; use passes of this plate"
                )
            layers = light_layers(frame["P"], frame["N"], light_on, lights, camera=frame.camera)
            beauty = relight(light_on, layers, plate_gain=plate_gain)
            relit = Frame(passes={"beauty": beauty, **layers}, camera=frame.camera, eye=frame.eye, number=number, metadata=frame.metadata)
            write_frame(path, relit, half=colour == "half", force=force, timecode=pictures.timecode(number), rate=pictures.rate)
            if picture:
                write_still(picture, plate_picture(beauty), force=force)
            results.append({"frame": number, "file": str(path), **relight_figures(layers, beauty)})
            bar.note(path.name, advance=1)
    first = results[0]
    where = first["file"] if len(results) == 1 else f"{len(results)} frames, first {first['file']}"
    report({"frames": results}, f"relight: {len(lights)} lights, largest value {first['largest']} -> {where}", as_json=as_json)
