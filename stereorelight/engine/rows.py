"""Rows of a picture shared out to threads.

The blocks of rows are fixed, so the answer is the same bits whatever the number of threads; the kernels release the GIL
and touch nothing but their own rows, so any number of callers may run at once.  numba's own thread pool is left out:
two callers inside its `workqueue` layer abort the process."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

import numba

from stereorelight.memory import keep_freed

First = TypeVar("First")
Second = TypeVar("Second")
BLOCK_ROWS = 16

keep_freed()  # whoever works on rows makes arrays of pictures


@functools.cache
def row_threads() -> ThreadPoolExecutor:
    """Threads that stay: a recovery of depth shares out rows hundreds of times, and starting threads took a tenth of it."""
    return ThreadPoolExecutor(max_workers=max(1, numba.config.NUMBA_NUM_THREADS), thread_name_prefix="rows")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=row_threads.cache_clear)  # a forked child has none of its parent's threads


def _shared_out(run: Callable[[int, int], None], height: int, take: Callable[[int, int], int], block_rows: int) -> None:
    """Call `run(first, end)` for all rows; `take(blocks left, threads)` says how many blocks are taken together."""
    blocks = -(-height // block_rows)
    count = min(numba.get_num_threads(), blocks)
    taken, next_block = 0, threading.Lock()
    problems: list[BaseException] = []

    def work() -> None:
        nonlocal taken
        while not problems:
            with next_block:
                first, many = taken, take(blocks - taken, count) if taken < blocks else 0
                taken += many
            if many == 0:
                return
            try:
                run(first * block_rows, min((first + many) * block_rows, height))
            except BaseException as problem:
                problems.append(problem)

    helpers: list[Future[None]] = []
    with contextlib.suppress(RuntimeError):  # where the interpreter is ending, no other thread takes new work
        helpers += [row_threads().submit(work) for _ in range(count - 1)]
    work()
    for helper in helpers:
        if not helper.cancel():  # one that never began, as where a pool's own thread asks for rows, is not waited for
            helper.result()
    if problems:
        raise problems[0]


def in_row_blocks(run: Callable[[int, int], None], height: int, *, block_rows: int = BLOCK_ROWS) -> None:
    """Call `run(first, end)` for every block of rows, on as many threads as `threads.set_threads` allows.

    Raises : the first exception that any block raised.
    """
    _shared_out(run, height, lambda left, threads: 1, block_rows)


def in_pieces(run: Callable[[int, int], None], height: int, *, block_rows: int = BLOCK_ROWS) -> None:
    """`in_row_blocks` for rows that know nothing of each other and take equally long: half of a thread's share of what is left at a time.

    Between two pieces a thread waits for the interpreter, as long as some ten rows take.
    """
    _shared_out(run, height, lambda left, threads: max(1, left // (2 * threads)), block_rows)


def at_once(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """What both functions return, the second called by another thread meanwhile where `threads.set_threads` allows more than one.

    For work that shares out none of its own.  Raises : what either raised, the first one's before the second one's.
    """
    if numba.get_num_threads() < 2:
        return first(), second()
    try:
        helper = row_threads().submit(second)
    except RuntimeError:  # the interpreter is ending
        return first(), second()
    try:
        mine = first()
    finally:
        begun = not helper.cancel()
        if begun:
            wait([helper])
    return mine, helper.result() if begun else second()
