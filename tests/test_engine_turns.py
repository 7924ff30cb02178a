"""Steps that threads go through together: every block once and in order of steps, whoever comes late or fails."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numba
import numpy as np
import pytest
from numba import njit

from stereorelight.engine.rows import row_threads
from stereorelight.engine.turns import shared, together, turns_of

STEPS = 60


@pytest.fixture(autouse=True)
def _counts_restored() -> Iterator[None]:
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


@njit(nogil=True)
def _smoothed(turns, values, sums, steps):
    """Every step needs its neighbours' rows of the step before, and the sum of all of them."""
    H = values.shape[1]
    step, total = np.int64(0), values[0].sum()
    for k in range(steps):
        for first, end in shared(turns, step, H, 7):
            for y in range(first, end):
                values[k + 1, y] = 0.5 * (values[k, max(y - 1, 0)] + values[k, min(y + 1, H - 1)]) + 1 / total
            sums[k, first // 7] = values[k + 1, first:end].sum()
        step += 1
        total = sums[k].sum()


@pytest.mark.parametrize("height", [0, 1, 6, 7, 8, 100])
@pytest.mark.parametrize("threads", [1, 2])
def test_each_step_sees_all_of_the_one_before(height: int, threads: int) -> None:
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    values, sums = np.zeros((STEPS + 1, height)), np.zeros((STEPS, -(-height // 7)))
    values[0] = np.random.default_rng(0).uniform(1, 2, height)
    wanted = values[0]
    for _ in range(3):
        together(_smoothed, turns_of(STEPS), values, sums, STEPS)
        wanted = values[0]
        for k in range(STEPS):
            padded = np.pad(wanted, 1, mode="edge") if height else np.zeros(2)
            wanted = 0.5 * (padded[:-2] + padded[2:]) + 1 / max(wanted.sum(), 1e-300)
            np.testing.assert_allclose(values[k + 1], wanted, rtol=1e-12)


def test_whoever_comes_late_or_never_holds_nothing_up() -> None:
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one core")
    numba.set_num_threads(2)
    let_go = threading.Event()
    busy = [row_threads().submit(let_go.wait, 60) for _ in range(numba.config.NUMBA_NUM_THREADS)]
    values, sums = np.ones((STEPS + 1, 50)), np.zeros((STEPS, 8))
    together(_smoothed, turns_of(STEPS), values, sums, STEPS)
    assert np.isfinite(values).all()
    assert (values[-1] > 1).all()
    let_go.set()
    assert all(one.result() for one in busy)


def test_many_callers_at_once() -> None:
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    results: list[np.ndarray] = []

    def caller() -> None:
        for _ in range(50):
            values, sums = np.ones((STEPS + 1, 50)), np.zeros((STEPS, 8))
            together(_smoothed, turns_of(STEPS), values, sums, STEPS)
            results.append(values[-1])

    callers = [threading.Thread(target=caller) for _ in range(4)]
    for one in callers:
        one.start()
    for one in callers:
        one.join()
    assert len(results) == 200
    assert all(np.array_equal(one, results[0]) for one in results)


def test_who_fails_is_not_waited_for() -> None:
    numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
    first, failed = threading.Lock(), []

    def run(turns: np.ndarray, values: np.ndarray, sums: np.ndarray) -> None:
        with first:
            if not failed:
                failed.append(threading.get_ident())
                turns[0] += 1  # it took a block and never gives it back
                raise MemoryError("no room")
        _smoothed(turns, values, sums, STEPS)

    with pytest.raises(MemoryError, match="no room"):
        together(run, turns_of(STEPS), np.ones((STEPS + 1, 50)), np.zeros((STEPS, 8)))
    assert len(failed) == 1
