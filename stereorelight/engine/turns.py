"""Steps over a picture that threads go through together inside one kernel, without Python between them.

In: a kernel of many steps, each over blocks that know nothing of each other.  Out: the same bits whatever the number of threads.
To share out one step's rows from Python costs a fifth of a millisecond: threads are woken, and wait for the interpreter and for each other.  A
solver has hundreds of steps, half of them shorter than that.  So every thread calls the same kernel with the same arrays, takes blocks of a step
as long as there are any (`shared`), and goes on to the next step once all of them are done, whoever did them.  A thread may come late or never: it
holds nothing up but the blocks that it took.  What must be known to all, such as a sum, is written block by block into a place that belongs to the
step, and added up by every thread alike."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from stereorelight.arrays import Int64
from stereorelight.engine.rows import row_threads

LINE = 8  # counters of a cache line: what threads count apart lies apart
GIVEN_UP = 1 << 60  # more blocks than any step has
SPINS = 256  # looks at a counter before the core is offered to others
_YIELD = "SwitchToThread" if sys.platform == "win32" else "sched_yield"


@intrinsic
def _offer_core(typingctx):
    """Let whoever wants this core have it."""

    def body(context, builder, signature, args):
        builder.call(cgutils.get_or_insert_function(builder.module, ir.FunctionType(ir.IntType(32), []), _YIELD), [])
        return context.get_dummy_value()

    return types.void(), body


@intrinsic
def _added(typingctx, counters, i):
    """counters[i] before one was added to it, by one thread at a time; what this thread wrote is there for whoever sees the new number."""

    def body(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", builder.gep(data, [args[1]]), ir.Constant(ir.IntType(64), 1), "seq_cst")

    return types.int64(counters, types.intp), body


@intrinsic
def _seen(typingctx, counters, i):
    """counters[i] as other threads left it, and with it what they wrote before."""

    def body(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.load_atomic(builder.gep(data, [args[1]]), "acquire", 8)

    return types.int64(counters, types.intp), body


@njit(nogil=True, error_model="numpy")
def shared(turns, step, height, rows):
    """Blocks (first, end) of `rows` of the `height` rows of a kernel's step that are this thread's to do; ends once everybody's are done."""
    taken, done = 2 * LINE * step, 2 * LINE * step + LINE
    blocks = (height + rows - 1) // rows
    block = _added(turns, taken)
    while block < blocks:
        yield block * rows, min((block + 1) * rows, height)
        _added(turns, done)
        block = _added(turns, taken)
    spins = 0
    while _seen(turns, done) < blocks:
        spins += 1
        if spins > SPINS:
            _offer_core()


def turns_of(steps: int) -> Int64:
    """Counters for a kernel of at most so many steps; they serve one call."""
    return np.zeros(2 * LINE * steps, np.int64)


def _part(run: Callable[..., Any], turns: Int64, given: tuple[Any, ...]) -> None:
    try:
        run(turns, *given)
    except BaseException:
        turns[:] = GIVEN_UP  # all steps look done, so that nobody waits for what this thread took
        raise


def together(run: Callable[..., Any], turns: Int64, *given: Any) -> None:
    """Call the kernel `run(turns, *given)` on this thread and on as many others as `threads.set_threads` allows; done once this one is.

    Raises : what any of them raised.
    """
    helpers: list[Future[None]] = []
    with contextlib.suppress(RuntimeError):  # the interpreter is ending
        helpers += [row_threads().submit(_part, run, turns, given) for _ in range(numba.get_num_threads() - 1)]
    _part(run, turns, given)
    for helper in helpers:
        if not helper.cancel() and turns[0] >= GIVEN_UP:  # one that has not begun has nothing left to do, nor has one that has
            helper.result()
