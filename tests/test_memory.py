"""Freed memory stays: arrays that come and go cost no page faults, in any thread; the environment's own settings are left alone."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from stereorelight.memory import keep_freed

COME_AND_GO = """
import resource
import numpy as np
import stereorelight.engine.rows
from stereorelight.engine.rows import in_row_blocks
from stereorelight.threads import set_threads
set_threads(2)
def once():
    arrays = [np.ones(2_000_000 // 4, np.float32) for _ in range(12)]
    in_row_blocks(lambda first, end: np.ones(2_000_000 // 4, np.float32), 160)
once(); once(); once()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    once()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
PAGES = 10 * 22 * 2_000_000 // 4096  # that ten times touch


def faults(**environment: str) -> int:
    env = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    done = subprocess.run([sys.executable, "-c", COME_AND_GO], env=env | environment, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(not keep_freed(), reason="another C library than glibc, or settings of its own")
def test_arrays_that_come_and_go_cost_no_page_faults() -> None:
    assert faults() < 0.05 * PAGES  # a thread that first makes an array still gets its first pages


@pytest.mark.skipif(not keep_freed(), reason="another C library than glibc, or settings of its own")
def test_the_environment_has_the_last_word() -> None:
    assert faults(MALLOC_TRIM_THRESHOLD_="131072") > 0.2 * PAGES
