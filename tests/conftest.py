"""What holds for every test: how hypothesis looks for examples, one BLAS thread, as calibration has it, and no more threads than cores.

What was installed is tested, with the kernels that it has compiled, as long as it is what stands in this tree.
A change must land or fail by itself, so the examples are the same on every run; `pytest -m hypothesis --hypothesis-profile=search` draws
new ones."""

from __future__ import annotations

import filecmp
import os
import sys
from importlib.machinery import PathFinder
from pathlib import Path

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits


def _import_installed() -> None:
    root = Path(__file__).resolve().parents[1]
    here = list(sys.path)
    elsewhere = [path for path in here if Path(path or ".").resolve() != root]
    found = PathFinder.find_spec("stereorelight", elsewhere)
    if found is None or found.origin is None:
        return
    installed, tree = Path(found.origin).parent, root / "stereorelight"
    files = [file.relative_to(tree) for file in tree.rglob("*") if file.is_file() and "__pycache__" not in file.parts]
    if all((installed / file).is_file() and filecmp.cmp(installed / file, tree / file, shallow=False) for file in files):
        sys.path[:] = elsewhere
        import stereorelight  # noqa: F401  # its modules will come from where it does

        sys.path[:] = here


_import_installed()
from stereorelight.threads import set_threads, usable_cores  # noqa: E402

settings.register_profile("search", deadline=None, max_examples=500)
settings.register_profile("stereorelight", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("stereorelight")
threadpool_limits(1, user_api="blas")
SHARE = max(1, usable_cores() // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Test processes share the cores: with as many threads each as there are cores they wait for one another."""
    set_threads(SHARE)
