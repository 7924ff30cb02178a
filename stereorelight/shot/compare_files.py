"""What a comparison leaves behind: its page, its history, its gates.

In: a `Measured` of whatever kind.  Out: the page and its history on disk, and the verdicts.  Every kind of comparison ends here."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from stereorelight.compare.figures import Measured
from stereorelight.compare.gate import Verdict, parse_gate, verdicts
from stereorelight.files import refuse_overwrite, write_text
from stereorelight.shot.compare_history import history_path, read_history, run_of, write_history
from stereorelight.shot.compare_page import compare_page


def check_page(page: Path | None, *, force: bool) -> None:
    """Raise OutputError before any work is done, where the page may not be written or its history cannot be read."""
    if page is not None:
        refuse_overwrite(page, force=force)
        read_history(page)


def gate_verdicts(gate: str | None, measured: Measured) -> tuple[Verdict, ...]:
    """The verdicts of "bad2<3,normal_median<6" on these figures.  Raises ShotError where a gate is none, or names no figure."""
    return () if gate is None else verdicts(parse_gate(gate), measured.figures)


def write_page(page: Path, measured: Measured, *, result: str, truth: str = "", found: Sequence[Verdict] = (), force: bool = False) -> list[Path]:
    """The page and its history, with the runs before on it.  Raises OutputError."""
    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    runs = [*read_history(page), run_of(measured, when=when, result=result, truth=truth)]
    alike = [run for run in runs if run.what == measured.what]
    write_text(page, compare_page(measured, result=result, truth=truth, verdicts=found, history=alike, made=when), force=force)
    write_history(page, runs)
    return [page, history_path(page)]
