"""`stereorelight depth`: two plates and a rig to Z, confidence and reasons on the original plate."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from stereorelight.cli.common import (
    force_option,
    frames_option,
    json_option,
    out_option,
    pairing_options,
    report,
    rig_option,
    space_option,
)


@click.command("depth")
@click.argument("left")
@click.argument("right", required=False)
@rig_option
@out_option
@click.option(
    "--eye",
    type=click.Choice(["left", "right", "both"]),
    default="left",
    show_default=True,
    help="Whose plate the result lies on; both need %V (left, right) or %v (l, r) in --out.",
)
@click.option("--quality", default="standard", show_default=True, help="draft, standard or fine.")
@click.option("--matcher", default="sgbm", show_default=True, metavar="NAME", help="sgbm, onnx:model.onnx, or a registered name.")
@click.option("--near", "near_m", type=float, metavar="M", help="Nearest distance to search, metres; found from the plates when left out.")
@click.option("--far", "far_m", type=float, metavar="M", help="Farthest one.")
@click.option("--subject", metavar="FILE-or-PATTERN", help="A matte on the upright left plate: depth steps on its edge.")
@click.option("--ignore", metavar="FILE-or-PATTERN", help="A matte of what no depth may be read from: a reflection, a flare.")
@pairing_options
@frames_option
@space_option
@force_option
@json_option
def command(
    left: str,
    right: str | None,
    rig_path: Path,
    out: str,
    eye: Literal["left", "right", "both"],
    quality: str,
    matcher: str,
    near_m: float | None,
    far_m: float | None,
    subject: str | None,
    ignore: str | None,
    layout: str,
    sync: str,
    right_late_frames: int,
    frames: str | None,
    colour_space: str,
    force: bool,
    as_json: bool,
) -> None:
    """Z of LEFT and RIGHT on the original plate of one eye.

    LEFT and RIGHT are pictures, movies, or patterns such as plates/left.####.exr; LEFT alone where one file holds both
    eyes.  Writes an EXR with Z (metres along the optical axis), confidence and flags.
    """
    from dataclasses import replace

    from stereorelight.camera import Eye
    from stereorelight.cli.common import outputs_for
    from stereorelight.cli.progress import Bar
    from stereorelight.errors import ShotError
    from stereorelight.footage.frames import write_frame
    from stereorelight.interchange.rigs import read_rig
    from stereorelight.shot.hints import read_hints
    from stereorelight.shot.pairs import flip_word, noise_word, pairs, read_upright, recover_pair
    from stereorelight.shot.steps import depth_figures
    from stereorelight.stereo.matchers import check_matcher
    from stereorelight.stereo.rectify import rectification
    from stereorelight.stereo.settings import DepthSettings

    settings = DepthSettings(quality=quality, near_m=near_m, far_m=far_m, matcher=matcher)
    check_matcher(matcher)
    rectified = rectification(read_rig(rig_path))
    found = pairs(left, right, frames=frames, layout=layout, sync=sync, right_late_frames=right_late_frames, colour_space=colour_space)
    eyes: tuple[Eye, ...] = ("left", "right") if eye == "both" else (eye,)
    if eye == "both" and "%V" not in out and "%v" not in out:
        raise ShotError(f"--out {out} is one name for two eyes; give %V for the eye, such as z.%V.exr")
    if (subject or ignore) and eye != "left":
        raise ShotError(f"--subject and --ignore are mattes of the left plate, and cannot help --eye {eye}; leave one of them out")
    paths = {one: outputs_for(out.replace("%V", one).replace("%v", one[0]), [pair.number for pair in found], force=force) for one in eyes}
    results = []
    with Bar("depth", total=len(found)) as bar:
        for index, pair in enumerate(found):
            bar.note(pair.name)
            plates = read_upright(pair, rectified)
            for one in eyes:
                frame = recover_pair(pair, plates, rectified, settings=settings, eye=one, hints=read_hints(subject, ignore, pair.number)).frame
                clip, number = pair.clip(one)
                named = replace(frame, number=pair.number, metadata=flip_word(rectified, one) | noise_word(rectified))
                write_frame(paths[one][index], named, force=force, timecode=clip.timecode(number), rate=clip.rate)
                results.append({"frame": pair.number, "eye": one, "file": str(paths[one][index]), **depth_figures(frame)})
            bar.note(pair.name, advance=1)
    first = results[0]
    where = first["file"] if len(results) == 1 else f"{len(results)} files, first {first['file']}"
    middle = f", median {first['median_m']:g} m" if "median_m" in first else ""
    report({"frames": results}, f"depth: cover {first['cover_percent']:g} %{middle} -> {where}", as_json=as_json)
