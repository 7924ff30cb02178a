"""`stereorelight run`: a shot file from plates to relit pictures."""

from __future__ import annotations

from pathlib import Path

import click

from stereorelight.cli.common import frames_option, json_option, report


@click.command("run")
@click.argument("shot", metavar="SHOT.toml", type=click.Path(path_type=Path))
@frames_option
@click.option("--force", is_flag=True, help="Do every step again, and replace files that are not this shot's own.")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes that share the frames.")
@json_option
def command(shot: Path, frames: str | None, workers: int, force: bool, as_json: bool) -> None:
    """Depth, P and N, light layers and the relit plate of a shot.

    Only what changed since the last run is done again; a run that was stopped goes on where it was.
    """
    from stereorelight.cli.watch import watched_run

    summary = watched_run(shot, frames=frames, force=force, workers=workers)
    many = f"{len(summary.frames)} frames" if len(summary.frames) > 1 else summary.frames[0]
    text = f"run: {many}: {summary.done} steps done, {summary.stood} stood unchanged, {summary.seconds:.1f} s; results in {summary.folder}"
    report(summary.to_dict(), text, as_json=as_json)
