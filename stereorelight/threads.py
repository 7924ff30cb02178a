"""The one place that says how many threads numba, OpenCV and BLAS take, so that none takes every core twice."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

from stereorelight.errors import ShotError


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def set_threads(count: int | None = None) -> int:
    """Give numba's kernels and OpenCV `count` threads each (default: every usable core).  Returns the count."""
    count = usable_cores() if count is None else count
    if count < 1:
        raise ShotError(f"threads must be at least 1, got {count}")
    import cv2
    import numba

    cv2.setNumThreads(count)
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    return count


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra on one thread: for many small matrices that is three times faster, and the bits do not depend on the machine."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
