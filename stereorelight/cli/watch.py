"""A run with its progress on stderr: a bar on a terminal, a line a frame elsewhere."""

from __future__ import annotations

import sys
from pathlib import Path

from stereorelight.cli.progress import Bar
from stereorelight.shot.frame import Event
from stereorelight.shot.run import RunSummary, run_shot
from stereorelight.shot.steps import STEPS


def watched_run(shot: Path, *, frames: str | None = None, force: bool = False, workers: int = 1) -> RunSummary:
    """`run_shot` with a progress bar."""
    with Bar(shot.name, total=len(STEPS)) as bar:

        def show(event: Event) -> None:
            if event.state == "begins":
                bar.note(f"{event.frame} {event.step}", total=event.frames * len(STEPS))
            else:
                bar.note(f"{event.frame} {event.step}", advance=1, total=event.frames * len(STEPS))
            if event.state == "done" and event.frames > 1 and not sys.stderr.isatty():
                print(f"{event.frame} {event.step}: {event.seconds:.1f} s", file=sys.stderr, flush=True)

        return run_shot(shot, frames=frames, force=force, workers=workers, on_event=show)
