"""Rows of a picture shared out to threads.

The blocks of rows are fixed, so the answer is the same bits whatever the number of threads; the kernels release the GIL
and touch nothing but their own rows, so any number of callers may run at once.  numba's own thread pool is left out:
two callers inside its `workqueue` layer abort the process."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numba

BLOCK_ROWS = 16


def in_row_blocks(run: Callable[[int, int], None], height: int, *, block_rows: int = BLOCK_ROWS) -> None:
    """Call `run(first, end)` for every block of rows, on as many threads as `threads.set_threads` allows.

    Raises : the first exception that any block raised.
    """
    starts = iter(range(0, height, block_rows))
    next_block = threading.Lock()
    problems: list[BaseException] = []

    def work() -> None:
        while not problems:
            with next_block:
                first = next(starts, None)
            if first is None:
                return
            try:
                run(first, min(first + block_rows, height))
            except BaseException as problem:
                problems.append(problem)

    count = min(numba.get_num_threads(), -(-height // block_rows))
    helpers = [threading.Thread(target=work, daemon=True) for _ in range(count - 1)]
    for helper in helpers:
        helper.start()
    work()
    for helper in helpers:
        helper.join()
    if problems:
        raise problems[0]
