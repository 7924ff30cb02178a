"""A shot from its plates to the relit picture, frame by frame, doing only what changed.

In: a shot file.  Out: the output folder with depth/, passes/, relit/, previews/, a receipt a frame and run.json.
A script that asks for several workers needs the usual `if __name__ == "__main__":`, since each starts as a new Python."""

from __future__ import annotations

import functools
import json
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from stereorelight.errors import OutputError, ShotError
from stereorelight.files import make_folder, write_text
from stereorelight.shot.frame import Event, FrameResult, Prepared, prepare, run_frame
from stereorelight.shot.mend import Mends, mends_of
from stereorelight.shot.pairs import Pair
from stereorelight.shot.receipt import versions
from stereorelight.shot.reviews import write_reviews
from stereorelight.threads import set_threads, usable_cores

RUN_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """What a run did.

    folder : the output folder.           frames : names of the frames, in order.
    done   : steps that were done.        stood  : steps that stood from an earlier run.
    movies : review movies and sheets that were written.
    figures: frame to step to figures, those that stood included.
    """

    folder: Path
    frames: tuple[str, ...]
    done: int
    stood: int
    seconds: float
    movies: int
    figures: dict[str, dict[str, Any]]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "folder": str(self.folder),
            "frames": list(self.frames),
            "steps_done": self.done,
            "steps_stood": self.stood,
            "movies_written": self.movies,
            "seconds": round(self.seconds, 3),
            "figures": self.figures,
        }


class RunRecord:
    """run.json: what holds for the whole shot, such as the range of the depth previews, which must not pump."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data: dict[str, Any] = {"version": RUN_VERSION}
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(data, dict) and data.get("version") == RUN_VERSION:
                self.data = data
        except NotADirectoryError:
            raise OutputError(f"{path.parent}: a file stands where a folder is needed; choose another output folder") from None
        except (OSError, ValueError):
            pass

    def put(self, **values: Any) -> None:
        """Set keys, and write the file where that changed anything."""
        new = self.data | values
        if new != self.data or not self.path.exists():
            self.data = new
            write_text(self.path, json.dumps(self.data, indent=2) + "\n", force=True)


def _writable(folder: Path) -> None:
    """Find out before any work whether results can be written; leaves nothing behind."""
    existed = folder.exists()
    make_folder(folder)
    try:
        write_text(folder / ".writable", "", force=True).unlink()
    finally:
        if not existed:
            folder.rmdir()


def run_shot(
    path: str | Path,
    *,
    frames: str | None = None,
    force: bool = False,
    workers: int = 1,
    on_event: Callable[[Event], None] = lambda event: None,
) -> RunSummary:
    """Run the shot in file `path`.

    frames   : "1001-1010" to run a part; the shot file's frames otherwise.
    force    : do every step again, and replace files that no run of this shot wrote.
    workers  : processes that share the frames, and the cores; the results are the same for any number.
    on_event : is told what begins and what is done.
    Raises   : ShotError, RigError, PlateError, OutputError; what is finished by then stays.
    """
    started = time.monotonic()
    if workers < 1:
        raise ShotError(f"workers must be at least 1, got {workers}")
    ready = prepare(path, frames)
    folder = ready.shot.folder
    _writable(folder)
    record = RunRecord(folder / "run.json")
    ready = replace(
        ready, mends=mends_of(ready.shot, ready.rectification, told=lambda name, done, total: on_event(_aside(name, "mend the rig", total)))
    )
    noted = dict(record.data.get("preview_range") or {})

    def one(pair: Pair) -> FrameResult:
        return run_frame(ready, pair, noted=noted, note=lambda new: record.put(preview_range=new), force=force, on_event=on_event)

    if workers == 1 or len(ready.pairs) == 1:
        results = [one(pair) for pair in ready.pairs]
    else:
        # The first frame here: it settles the preview range for all the others.
        results = [one(ready.pairs[0])]
        ready.near.forget()
        results += run_in_processes(ready, path, noted=noted, force=force, workers=workers, on_event=on_event)
    record.put(shot=ready.shot.path.name, name=ready.shot.name, versions=dict(versions()))
    movies, written = write_reviews(
        ready, record.data.get("movies") or {}, force=force, note=lambda name: on_event(_aside(name, "write", len(ready.pairs)))
    )
    record.put(movies=movies)
    return RunSummary(
        folder=folder,
        frames=tuple(result.frame for result in results),
        done=sum(result.done for result in results),
        movies=written,
        stood=sum(result.stood for result in results),
        seconds=time.monotonic() - started,
        figures={result.frame: result.figures for result in results},
    )


def run_in_processes(
    ready: Prepared, path: str | Path, *, noted: dict[str, Any], force: bool, workers: int, on_event: Callable[[Event], None]
) -> list[FrameResult]:
    """The frames after the first one, on `workers` processes.  An error of one stops those that have not begun.

    A process takes frames in a row, so that what it found of a frame serves the next ones.
    """
    rest, count = ready.pairs[1:], len(ready.pairs)
    workers = min(workers, len(rest))
    length = _row_length(len(rest), workers, ready.near.window)
    rows = [rest[k : k + length] for k in range(0, len(rest), length)]
    threads = max(1, usable_cores() // workers)
    # Spawned, not forked: numba's and OpenCV's threads do not survive a fork.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin_worker, initargs=(threads,)) as pool:
        waiting = {pool.submit(_row_in_worker, str(path), row, noted, force, ready.mends): row for row in rows}
        results: dict[Pair, FrameResult] = {}
        try:
            for future in as_completed(waiting):
                for pair, result in zip(waiting[future], future.result()):
                    results[pair] = result
                    for step, seconds in result.seconds.items():
                        on_event(Event(frames=count, steps=len(result.figures), frame=result.frame, step=step, state="done", seconds=seconds))
        except BrokenProcessPool:
            raise OutputError("a worker was ended from outside, perhaps for want of memory; run again with fewer --workers") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    return [results[pair] for pair in rest]


def _row_length(frames: int, workers: int, window: int) -> int:
    """How many frames a process takes in a row: one where frames stand alone, else enough that both ends cost little."""
    return 1 if window == 0 else max(1, min(-(-frames // workers), 8 * window))


def _aside(name: str, what: str, total: int) -> Event:
    """What is told of work that is no step of a frame: mending the rig, writing movies."""
    return Event(frames=total, steps=1, frame=name, step=what, state="begins")


def _begin_worker(threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer; a frame that has begun is finished
    set_threads(threads)


@functools.lru_cache(maxsize=1)
def _prepared_once(path: str) -> Prepared:
    return prepare(path)


def _row_in_worker(path: str, row: Sequence[Pair], noted: dict[str, Any], force: bool, mends: Mends) -> list[FrameResult]:
    ready = replace(_prepared_once(path), mends=mends)
    return [run_frame(ready, pair, noted=dict(noted), note=lambda new: None, force=force) for pair in row]
