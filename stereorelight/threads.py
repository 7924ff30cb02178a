"""The one place that says how many threads numba and OpenCV take, so that neither takes every core twice."""

from __future__ import annotations

import os

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
