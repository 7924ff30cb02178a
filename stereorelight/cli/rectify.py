"""`stereorelight rectify`: two plates onto one pair of rows."""

from __future__ import annotations

from pathlib import Path

import click

from stereorelight.cli.common import force_option, frames_option, json_option, pairing_options, report, rig_option, space_option


@click.command("rectify")
@click.argument("left")
@click.argument("right", required=False)
@rig_option
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), metavar="DIR", help="Folder for the rectified plates and their rig.")
@pairing_options
@frames_option
@space_option
@force_option
@json_option
def command(
    left: str,
    right: str | None,
    rig_path: Path,
    folder: Path,
    layout: str,
    sync: str,
    right_late_frames: int,
    frames: str | None,
    colour_space: str,
    force: bool,
    as_json: bool,
) -> None:
    """LEFT and RIGHT with their lenses undone and their rows aligned.

    Writes left and right as scene-linear EXR (NaN where a plate does not reach) and rig.json, the rig of the rectified
    plates.
    """
    from stereorelight.cli.progress import Bar
    from stereorelight.files import refuse_overwrite
    from stereorelight.footage.frames import write_frame
    from stereorelight.interchange.rigs import read_rig, write_rig
    from stereorelight.passes import Frame
    from stereorelight.shot.judge import rig_of_rectified
    from stereorelight.shot.pairs import EYES, pairs, read_upright
    from stereorelight.stereo.rectify import rectification

    rectified = rectification(read_rig(rig_path))
    found = pairs(left, right, frames=frames, layout=layout, sync=sync, right_late_frames=right_late_frames, colour_space=colour_space)

    def target(eye: str, number: int | None) -> Path:
        return folder / (f"{eye}.exr" if number is None else f"{eye}.{number:04d}.exr")

    files = [target(eye, pair.number) for pair in found for eye in EYES]
    for file in [*files, folder / "rig.json"]:
        refuse_overwrite(file, force=force)
    with Bar("rectify", total=len(found)) as bar:
        for pair in found:
            bar.note(pair.name)
            plates = read_upright(pair, rectified)
            for eye, plate in zip(EYES, plates):
                frame = Frame(passes={"plate": rectified.rectify(plate, eye)}, eye=eye, number=pair.number)
                write_frame(target(eye, pair.number), frame, force=force)
            bar.note(pair.name, advance=1)
    write_rig(folder / "rig.json", rig_of_rectified(rectified.rig), force=force)
    w, h = rectified.rig.left.size
    many = f"{len(found)} frames" if len(found) > 1 else found[0].name
    report(
        {"folder": str(folder), "size": [w, h], "files": [str(f) for f in files], "rig": str(folder / "rig.json")},
        f"rectify: {many}, {w}x{h} -> {folder}",
        as_json=as_json,
    )
