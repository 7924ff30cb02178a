"""`stereorelight check`: what is wrong with the plates, before an hour of processing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option, pairing_options, report, space_option

if TYPE_CHECKING:
    from stereorelight.shot.check import Health

STYLE = {"good": "green", "note": "blue", "unknown": "magenta", "warn": "yellow", "bad": "red"}


@click.command("check")
@click.argument("left", metavar="SHOT.toml | LEFT")
@click.argument("right", required=False)
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The two cameras; without it rows are judged as shot, and nothing in metres.")
@pairing_options
@frames_option
@space_option
@click.option(
    "--subject", "subject_m", type=click.FloatRange(min=0, min_open=True), metavar="M", help="How far the subject is; measured when left out."
)
@click.option("--every", type=click.IntRange(min=1), default=1, show_default=True, help="Look at each N-th frame only.")
@click.option("--report", "page", type=FILE, metavar="FILE.html", help="Also write one page with pictures and curves.")
@click.option("--fail-on", type=click.Choice(["warn", "bad"]), help="Exit with 1 where the verdict is this grave; for scripts.")
@force_option
@json_option
def command(
    left: str,
    right: str | None,
    rig_path: Path | None,
    layout: str,
    sync: str,
    right_late_frames: int,
    frames: str | None,
    colour_space: str,
    subject_m: float | None,
    every: int,
    page: Path | None,
    fail_on: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """Plate health of a shot, or of LEFT and RIGHT.

    Measures what spoils depth: eyes swapped, mirrored, out of step or out of line; zoom, roll and focus; exposure, colour,
    grain and clipping; frozen, dropped and damaged frames.  Says what it found, how much, and what to do.
    """
    from stereorelight.cli.progress import Bar
    from stereorelight.files import refuse_overwrite, write_text
    from stereorelight.health.finding import LEVELS
    from stereorelight.shot.check import check_plates, check_shot
    from stereorelight.shot.check_page import check_page

    if page is not None:
        refuse_overwrite(page, force=force)
    with Bar("check", total=1) as bar:

        def show(name: str, done: int, total: int) -> None:
            bar.note(name, advance=1 if done else 0, total=total)

        if left.endswith(".toml"):
            if right is not None:
                raise click.UsageError("a shot file names both plates itself; leave RIGHT out")
            health = check_shot(left, rig_path=rig_path, frames=frames, subject_m=subject_m, every=every, on_frame=show)
        else:
            health = check_plates(
                left,
                right,
                rig_path=rig_path,
                frames=frames,
                subject_m=subject_m,
                every=every,
                on_frame=show,
                layout=layout,
                sync=sync,
                right_late_frames=right_late_frames,
                colour_space=colour_space,
            )
    values = health.to_dict()
    if page is not None:
        write_text(page, check_page(health), force=force)
        values["report"] = str(page)
    if not as_json:
        _print_table(health)
    report(values, f"check: {health.level}: {health.words}" + (f" -> {page}" if page else ""), as_json=as_json)
    if fail_on and LEVELS.index(health.level) >= LEVELS.index("warn" if fail_on == "warn" else "bad"):
        raise SystemExit(1)


def _print_table(health: Health) -> None:
    """Findings as a table on stdout; words are wrapped to the terminal, markup in file names is not read as such."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, show_edge=False)
    table.add_column("level", no_wrap=True)
    table.add_column("looked at", no_wrap=True)
    table.add_column("size", justify="right", no_wrap=True)
    table.add_column("found, and what to do")
    for finding in health.findings:
        size = "" if finding.value is None else f"{finding.value:.3g} {finding.unit}".strip()
        words = Text(finding.words)
        if finding.remedy:
            words.append(f"\n{finding.remedy}", style="dim")
        table.add_row(Text(finding.level, style=STYLE[finding.level]), finding.name.replace("_", " "), size, words)
    console = Console()
    console.print(table)
    if health.prediction:
        told = Table(box=None, pad_edge=False, show_edge=False, title="what these plates will give", title_justify="left")
        for title in health.prediction[0]:
            told.add_column(title)
        for row in health.prediction[1:]:
            told.add_row(*row)
        console.print(told)
