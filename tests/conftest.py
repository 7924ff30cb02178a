"""What holds for every test: how hypothesis looks for examples, one BLAS thread, as calibration has it, and no more threads than cores.

A change must land or fail by itself, so the examples are the same on every run; `pytest -m hypothesis --hypothesis-profile=search` draws
new ones."""

from __future__ import annotations

import os

import cv2
from hypothesis import settings
from threadpoolctl import threadpool_limits

from stereorelight.threads import usable_cores

settings.register_profile("search", deadline=None, max_examples=500)
settings.register_profile("stereorelight", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("stereorelight")
threadpool_limits(1, user_api="blas")
# Test processes share the cores: twice as many threads of OpenCV's as cores cost half as much again.
cv2.setNumThreads(max(1, usable_cores() // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))
