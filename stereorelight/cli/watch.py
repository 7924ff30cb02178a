"""A run with its progress on stderr: a bar on a terminal, a line a frame elsewhere."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import click

from stereorelight.cli.progress import Bar
from stereorelight.shot.ahead import compiling_ahead
from stereorelight.shot.frame import Event
from stereorelight.shot.run import RunSummary, run_shot
from stereorelight.shot.steps import STEPS


def watched_run(shot: Path, *, frames: str | None = None, force: bool = False, workers: int = 1) -> RunSummary:
    """`run_shot` with its progress shown."""
    steps: dict[str, int] = defaultdict(int)
    seconds: dict[str, float] = defaultdict(float)
    with compiling_ahead(), Bar(shot.name, total=len(STEPS)) as bar:

        def show(event: Event) -> None:
            bar.note(f"{event.frame} {event.step}", advance=int(event.state != "begins"), total=event.frames * event.steps)
            steps[event.frame] += event.state != "begins"
            seconds[event.frame] += event.seconds
            if steps[event.frame] == event.steps and event.frames > 1 and not sys.stderr.isatty():
                click.echo(f"frame {event.frame}: {seconds[event.frame]:.1f} s", err=True)

        return run_shot(shot, frames=frames, force=force, workers=workers, on_event=show)
