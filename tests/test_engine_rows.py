"""Rows shared out to threads: each once, errors come back, callers do not disturb one another; and the thread counts."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import cv2
import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.engine.rows import at_once, in_pieces, in_row_blocks
from stereorelight.errors import ShotError
from stereorelight.threads import set_threads, usable_cores


@pytest.fixture(autouse=True)
def _counts_restored() -> Iterator[None]:
    for_numba, for_opencv = numba.get_num_threads(), cv2.getNumThreads()
    yield
    numba.set_num_threads(for_numba)
    cv2.setNumThreads(for_opencv)


@given(height=st.integers(0, 200), block=st.integers(1, 40))
def test_every_row_once(height: int, block: int) -> None:
    seen: list[tuple[int, int]] = []
    in_row_blocks(lambda first, end: seen.append((first, end)), height, block_rows=block)
    assert sorted(seen) == [(first, min(first + block, height)) for first in range(0, height, block)]


@given(height=st.integers(0, 200), block=st.integers(1, 40))
def test_pieces_are_whole_blocks_and_every_row_is_in_one(height: int, block: int) -> None:
    seen: list[tuple[int, int]] = []
    in_pieces(lambda first, end: seen.append((first, end)), height, block_rows=block)
    seen.sort()
    assert [first for first, _ in seen] == [0, *(end for _, end in seen[:-1])][: len(seen)]
    assert all(first % block == 0 and (end % block == 0 or end == height) for first, end in seen)
    assert (seen[-1][1] if seen else 0) == height


@pytest.mark.parametrize("threads", [1, 2])
def test_the_first_error_comes_back_and_work_stops(threads: int) -> None:
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    ran: list[int] = []

    def run(first: int, end: int) -> None:
        ran.append(first)
        if first == 32:
            raise ValueError("row 32")

    with pytest.raises(ValueError, match="row 32"):
        in_row_blocks(run, 16 * 1000)
    # The other thread may run on until it sees the flag; with one thread nothing follows.
    assert len(ran) == 3 if threads == 1 else len(ran) < 1000


def test_no_more_threads_than_allowed() -> None:
    numba.set_num_threads(1)
    names: set[int] = set()
    in_row_blocks(lambda first, end: names.add(threading.get_ident()), 160)
    assert names == {threading.get_ident()}


def test_callers_at_once_do_not_disturb_one_another() -> None:
    out = np.zeros((6, 400), np.int64)

    def caller(k: int) -> None:
        def run(first: int, end: int) -> None:
            out[k, first:end] += np.arange(first, end) + k

        in_row_blocks(run, 400)

    helpers = [threading.Thread(target=caller, args=(k,)) for k in range(6)]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        helper.join()
    assert np.array_equal(out, np.arange(400) + np.arange(6)[:, None])


def test_rows_within_rows_do_not_wait_for_each_other() -> None:
    out = np.zeros((40, 40), np.int64)

    def outer(first: int, end: int) -> None:
        for row in range(first, end):
            in_row_blocks(lambda a, b, row=row: out[row].__setitem__(slice(a, b), np.arange(a, b) + row), 40, block_rows=1)

    done = threading.Thread(target=lambda: in_row_blocks(outer, 40, block_rows=1), daemon=True)
    done.start()
    done.join(timeout=60)
    assert not done.is_alive()
    assert np.array_equal(out, np.arange(40) + np.arange(40)[:, None])


def test_a_forked_child_has_threads_of_its_own() -> None:
    in_row_blocks(lambda first, end: None, 160)
    child = os.fork()
    if child == 0:
        rows: list[int] = []
        in_row_blocks(lambda first, end: rows.extend(range(first, end)), 160)
        os._exit(0 if sorted(rows) == list(range(160)) else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_set_threads_sets_both() -> None:
    assert set_threads(1) == 1
    assert numba.get_num_threads() == 1
    assert cv2.getNumThreads() == 1
    assert set_threads() == usable_cores() >= 1
    assert numba.get_num_threads() == min(usable_cores(), numba.config.NUMBA_NUM_THREADS)


def test_more_threads_than_cores_is_no_error() -> None:
    assert set_threads(999) == 999
    assert numba.get_num_threads() == numba.config.NUMBA_NUM_THREADS


@pytest.mark.parametrize("count", [0, -1])
def test_no_threads_is_refused(count: int) -> None:
    with pytest.raises(ShotError, match="at least 1"):
        set_threads(count)


@pytest.mark.parametrize("threads", [1, 2])
def test_two_at_once_give_both_answers_and_every_error(threads: int) -> None:
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    assert at_once(lambda: 1, lambda: "b") == (1, "b")
    for first, second in ((0, 1), (1, 0), (0, 0)):
        with pytest.raises(ZeroDivisionError):
            at_once(lambda a=first: 1 // a, lambda b=second: 1 // b)


def test_two_at_once_run_at_once_and_within_each_other() -> None:
    """Each waits for the other to begin; then a pool whose threads are all taken still answers."""
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one core")
    numba.set_num_threads(2)
    meet = threading.Barrier(2, timeout=20)
    at_once(meet.wait, meet.wait)

    def deep(level: int) -> int:
        return sum(at_once(lambda: deep(level - 1), lambda: deep(level - 1))) if level else 1

    assert deep(5) == 32
