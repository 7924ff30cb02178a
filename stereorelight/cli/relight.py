"""`stereorelight relight`: a plate and its passes under new lights."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option, out_option, report, space_option

MODES = ("add", "multiply", "light_only")  # of comp.py, which numpy comes with


@click.command("relight")
@click.argument("plate")
@click.argument("passes")
@click.option("--lights", "lights_path", required=True, type=FILE, metavar="lights.toml", help="The lights: [[lights]] tables.")
@out_option
@click.option("--preview", metavar="FILE.png", help="Also write the relit plate as a picture to look at; with a fade FILE.trust.png, too.")
@click.option("--plate-gain", type=click.FloatRange(min=0), help="What is left of the plate's own light.  [default: the light file's, else 1]")
@click.option("--mode", type=click.Choice(MODES), help="How light and plate come together.  [default: the light file's, else add]")
@click.option(
    "--fade", type=click.FloatRange(0, 1), help="Take light away where depth and normals are not trusted.  [default: the light file's, else 0]"
)
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The camera of a renderer's passes, so that their axes can be found ...")
@click.option("--eye", type=click.Choice(["left", "right"]), default="left", show_default=True, help="Which eye of the rig.")
@click.option("--fov-deg", type=float, metavar="DEG", help="... or a centred pinhole of this horizontal field of view.")
@click.option("--unit", metavar="UNIT", help="What one unit of a renderer's P is: m, cm, mm, ft, in, km, or a number of metres.  [default: m]")
@click.option("--axes", metavar="AXES", help="Where x, y and z of a renderer's P and N point, such as right,down,forward.")
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
    plate_gain: float | None,
    mode: str | None,
    fade: float | None,
    rig_path: Path | None,
    eye: Literal["left", "right"],
    fov_deg: float | None,
    unit: str | None,
    axes: str | None,
    colour: str,
    frames: str | None,
    colour_space: str,
    force: bool,
    as_json: bool,
) -> None:
    """PLATE under the lights of a file, with the P and N of PASSES.exr.

    Writes the relit plate as RGB and every layer of light beside it.
    """
    import numpy as np

    from stereorelight.arrays import Float32
    from stereorelight.cli.common import outputs_for
    from stereorelight.cli.progress import Bar
    from stereorelight.errors import PassError
    from stereorelight.files import refuse_overwrite
    from stereorelight.footage.clip import open_clip
    from stereorelight.footage.eyes import plate_frames
    from stereorelight.footage.frames import read_frame, write_frame
    from stereorelight.footage.preview import confidence_picture, plate_picture
    from stereorelight.footage.sequence import Sequence
    from stereorelight.footage.stills import write_still
    from stereorelight.interchange.rigs import read_rig
    from stereorelight.passes import Frame
    from stereorelight.shot.depths import read_surface
    from stereorelight.shot.lighting import lighting_of
    from stereorelight.shot.pairs import FLIPPED
    from stereorelight.shot.plate_light import Reference
    from stereorelight.shot.schema import read_light_file
    from stereorelight.shot.steps import plate_light_figures, relight_figures
    from stereorelight.shot.truths import Stated, unit_of

    stated = Stated(metres=None if unit is None else unit_of(unit), axes=axes)
    seen_by = None if rig_path is None else read_rig(rig_path).camera(eye)
    knobs = {key: value for key, value in (("plate_gain", plate_gain), ("mode", mode), ("fade", fade)) if value is not None}
    setup = read_light_file(lights_path).with_relight(**knobs)
    pictures, surfaces = open_clip(plate, colour_space=colour_space), Sequence.parse(passes)
    numbers = plate_frames(pictures, surfaces, frames)
    flipped = FLIPPED in read_frame(surfaces.path(numbers[0])).metadata if any(track.moving.stuck for track in setup.lights) else False

    def upright(number: int | None) -> Float32:
        light_on = pictures.read(number)
        return np.ascontiguousarray(light_on[:, ::-1]) if flipped else light_on

    def reference() -> Reference:
        """The frame that speaks for the plate's own light, whichever frames are asked for: the one named, else the middle one."""
        both = plate_frames(pictures, surfaces, None)
        number = setup.relight.albedo_frame if setup.relight.albedo_frame in both else both[len(both) // 2]
        frame = read_frame(surfaces.path(number))
        light_on = pictures.read(number)
        light_on = np.ascontiguousarray(light_on[:, ::-1]) if frame.metadata.get(FLIPPED) else light_on
        camera = None if frame.camera is None else lighting.camera(frame.camera, number)
        held = lighting.mattes(number, frame, camera, {name.removeprefix("matte_"): frame[name] for name in frame if name.startswith("matte_")})
        return Reference(number=number, plate=light_on, passes=frame, camera=camera, mattes=held)

    lighting = lighting_of(setup, numbers=pictures.frames, plate=upright, reference=(reference, lambda: None))
    lighting.check(numbers)
    paths = outputs_for(out, numbers, force=force)
    previews = outputs_for(preview, numbers, force=force) if preview else [None] * len(numbers)
    trusts = [path and path.with_name(f"{path.stem}.trust.png") for path in previews] if setup.relight.fade > 0 else [None] * len(numbers)
    for trust_path in filter(None, trusts):
        refuse_overwrite(trust_path, force=force)
    results = []
    with Bar("relight", total=len(numbers)) as bar:
        for number, path, picture, doubt in zip(numbers, paths, previews, trusts):
            bar.note(path.name)
            frame = read_surface(surfaces.path(number), camera=seen_by, fov_deg=fov_deg, stated=stated)
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
            camera = None if frame.camera is None else lighting.camera(frame.camera, number)
            mattes = {name.removeprefix("matte_"): frame[name] for name in frame if name.startswith("matte_")}
            lit = lighting.lit(number, plate=light_on, passes=frame, camera=camera, given=mattes)
            relit = Frame(passes=lit.passes(), camera=camera, eye=frame.eye, number=number, metadata=frame.metadata)
            write_frame(path, relit, half=colour == "half", force=force, timecode=pictures.timecode(number), rate=pictures.rate)
            if picture:
                write_still(picture, plate_picture(lit.beauty), force=force)
            if doubt and lit.trust is not None:
                write_still(doubt, confidence_picture(lit.trust), force=force)
            results.append({"frame": number, "file": str(path), **relight_figures(lit.layers, lit.beauty), **plate_light_figures(lit)})
            if said := frame.metadata.get("passes_are"):
                results[-1]["passes_are"] = said
            bar.note(path.name, advance=1)
    first = results[0]
    where = first["file"] if len(results) == 1 else f"{len(results)} frames, first {first['file']}"
    found = f"{first['passes_are']}\n" if "passes_are" in first else ""
    report({"frames": results}, f"{found}relight: {len(setup.lights)} lights, largest value {first['largest']} -> {where}", as_json=as_json)
