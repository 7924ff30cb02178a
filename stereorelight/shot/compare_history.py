"""What a comparison found the times before: a small JSON file beside its report.

In: figures of a run.  Out: `REPORT.history.json`, the oldest run first, and rows and curves for the page.  A run is kept whatever its
gates say; a history that cannot be read is an error, never begun anew."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stereorelight import __version__
from stereorelight.compare.figures import Curve, Measured, number, plain
from stereorelight.errors import OutputError
from stereorelight.files import write_text

MOST_RUNS = 500
SHOWN = 12  # runs in the page's table
FIRST = ("bad2", "bad5%", "average_px", "average_%", "average_m", "cover", "normal_median", "normal_under11.25")  # columns, where they exist
COLUMNS = 6


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run: when (UTC, ISO 8601), of which version, what against what, and its figures of region "all" by name."""

    when: str
    what: str
    result: str
    truth: str
    figures: Mapping[str, float | None]
    version: str = __version__


def history_path(page: Path) -> Path:
    """Where the history of the report `page` is kept."""
    return page.with_suffix(".history.json")


def run_of(measured: Measured, *, when: str, result: str, truth: str) -> Run:
    """A run to be kept."""
    figures = {f.name: plain(f.value) for f in measured.figures if f.region == "all"}
    return Run(when=when, what=measured.what, result=result, truth=truth, figures=figures)


def read_history(page: Path) -> list[Run]:
    """The runs before.  Raises OutputError where the file is no history."""
    path = history_path(page)
    if not path.exists():
        return []
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        return [
            Run(when=r["when"], what=r["what"], result=r["result"], truth=r["truth"], figures=dict(r["figures"]), version=r["version"])
            for r in told["runs"]
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: is no history of comparisons ({error}); move it away, or choose another --out") from None


def write_history(page: Path, runs: Sequence[Run]) -> Path:
    """Keep the runs, the last MOST_RUNS of them."""
    told = {"runs": [vars(run) for run in runs[-MOST_RUNS:]]}
    return write_text(history_path(page), json.dumps(told, indent=1, allow_nan=False) + "\n", force=True)


def _columns(runs: Sequence[Run]) -> list[str]:
    names = dict.fromkeys(name for run in runs[-1:] for name in run.figures if name != "pixels")
    return [*(n for n in FIRST if n in names), *(n for n in names if n not in FIRST)][:COLUMNS]


def history_rows(runs: Sequence[Run]) -> list[list[str]]:
    """The last runs as a table, the newest first; empty where there is only one."""
    if len(runs) < 2:
        return []
    columns = _columns(runs)
    rows = [["when", *columns, "result"]]
    for run in reversed(runs[-SHOWN:]):
        values = (run.figures.get(name) for name in columns)
        rows.append([run.when, *("-" if v is None else number(v, 3) for v in values), run.result])
    return rows


def history_curves(runs: Sequence[Run]) -> list[Curve]:
    """A curve for each of the first columns; empty where there is only one run."""
    if len(runs) < 2:
        return []
    nothing = float("nan")

    def line(name: str) -> tuple[list[float], list[float]]:
        return [float(i + 1) for i in range(len(runs))], [nothing if (v := run.figures.get(name)) is None else v for run in runs]

    return [Curve(title=f"{name}, run by run", lines={name: line(name)}, x_label="run", y_label=name) for name in _columns(runs)[:4]]
