"""A progress bar on stderr for whatever takes longer than a second, and nothing for what does not."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PATIENCE_S = 1.0


class Bar:
    """`with Bar("depth", total=10) as bar: bar.step("1001")`.  Silent where stderr is no terminal."""

    def __init__(self, title: str, total: int) -> None:
        self.title, self.total = title, total
        self._lock = threading.Lock()
        self._done, self._note, self._closed = 0, "", False
        self._progress: Progress | None = None
        self._task: TaskID | None = None
        self._timer = threading.Timer(PATIENCE_S, self._show)
        self._timer.daemon = True

    def __enter__(self) -> Bar:
        self._timer.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._timer.cancel()
        with self._lock:
            self._closed = True
            if self._progress:
                self._progress.stop()

    def note(self, text: str, *, advance: int = 0, total: int | None = None) -> None:
        """Say what is being done now, and how many steps more are finished."""
        with self._lock:
            self._done += advance
            self._note = text
            self.total = total or self.total
            self._refresh()

    def _show(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        with self._lock:
            console = Console(stderr=True)
            if self._closed or not console.is_terminal:
                return
            # markup=False: a file name may hold [brackets].
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(bar_width=28),
                TimeElapsedColumn(),
                TextColumn("{task.fields[note]}", markup=False),
            )
            self._progress = Progress(*columns, console=console, transient=True)
            self._task = self._progress.add_task(self.title, total=self.total, note=self._note)
            self._progress.start()
            self._refresh()

    def _refresh(self) -> None:
        if self._progress and self._task is not None:
            self._progress.update(self._task, completed=self._done, total=self.total, note=self._note)
