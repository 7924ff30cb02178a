"""What several test processes need and takes long to make: made by the one that comes first, while the others wait, then read by all."""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

try:
    import fcntl
except ImportError:  # not on Windows: there, each process makes its own
    fcntl = None  # type: ignore[assignment]

T = TypeVar("T")


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], T]) -> T:
    """What `make` returns, given an empty folder that the processes of this test run share; nobody may write there afterwards."""
    base = factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ and fcntl is not None else base
    folder, value = shared / name, shared / f"{name}.pickle"
    with open(shared / f"{name}.lock", "w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        if not value.exists():
            shutil.rmtree(folder, ignore_errors=True)  # of one that failed half-way
            folder.mkdir()
            value.write_bytes(pickle.dumps(make(folder)))
        found: T = pickle.loads(value.read_bytes())
        return found
