"""What the commands share: options, the pairing of frames with outputs, and the one report."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from stereorelight.errors import ShotError
from stereorelight.files import refuse_overwrite

FILE = click.Path(path_type=Path)

out_option = click.option("--out", required=True, metavar="FILE-or-PATTERN", help="Where results go; a pattern such as name.####.exr for a sequence.")
rig_option = click.option("--rig", "rig_path", required=True, type=FILE, metavar="rig.json", help="The two cameras.")
frames_option = click.option("--frames", metavar="A-B", help="Part of a sequence, such as 1001-1010.")
space_option = click.option("--colour-space", default="auto", show_default=True, help="How the plates are coded.")
force_option = click.option("--force", is_flag=True, help="Replace files that exist.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")
eye_option = click.option("--eye", type=click.Choice(["left", "right"]), default="left", show_default=True, help="Whose plate the result lies on.")

layout_option = click.option(
    "--layout",
    default="auto",
    show_default=True,
    metavar="HOW",
    help="How one file holds both eyes: side-by-side, side-by-side-half, top-bottom, top-bottom-half; give it as LEFT alone.",
)
sync_option = click.option(
    "--sync", default="auto", show_default=True, help="Pair movies by timecode or frames; auto: by time code where both carry one."
)
late_option = click.option(
    "--right-late", "right_late_frames", type=int, default=0, show_default=True, metavar="N", help="The right camera is N whole frames behind."
)


def pairing_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that say how pictures of the two eyes belong together."""
    return layout_option(sync_option(late_option(command)))


def say(text: str, *, as_json: bool = False) -> None:
    """A line for people: on stdout, or on stderr where stdout belongs to JSON."""
    click.echo(text, err=as_json)


def report(values: dict[str, Any], text: str, *, as_json: bool) -> None:
    """The result of a command, as one JSON object or as words."""
    click.echo(json.dumps(values, allow_nan=False) if as_json else text)


def outputs_for(out: str, numbers: Sequence[int | None], *, force: bool) -> list[Path]:
    """One output path a frame, none of which may exist yet.  Raises OutputError, and ShotError where a pattern is needed."""
    from stereorelight.footage.sequence import Sequence as Pattern

    pattern = Pattern.parse(out, must_exist=False)
    if pattern.is_single and len(numbers) > 1:
        path = Path(out)
        raise ShotError(f"--out {out} is one file, but there are {len(numbers)} frames; give a pattern such as {path.stem}.####{path.suffix}")
    if not pattern.is_single and None in numbers:
        raise ShotError(f"--out {out} is a pattern, but the plates are single pictures; give one file name")
    paths = [pattern.path(number) for number in numbers]
    for path in paths:
        refuse_overwrite(path, force=force)
    return paths
