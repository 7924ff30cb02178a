"""Kernels compiled ahead: while a first run matches its first pair, other processes compile what its later steps need.

In: nothing but the machine.  Out: kernels in numba's cache on disk, where the run finds them once it gets there.
Compiling takes a core minutes, once, and numba compiles one kernel at a time in a process.  So each `Stage` goes through tiny pictures
in the way a run does, which compiles what a run calls.  A stage is left out where its last kernel is in the cache already."""

from __future__ import annotations

import contextlib
import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.threads import usable_cores

SIZE_HW = (48, 64)


def _bends() -> None:
    from stereorelight.engine.bending import plate_correction
    from stereorelight.engine.bends import slopes
    from stereorelight.stereo.refine import bends_seen

    flat, ones = np.zeros(SIZE_HW, np.float32), np.ones((SIZE_HW[0] // 4, SIZE_HW[1] // 4), np.float32)
    plate_correction(flat, flat + 1, flat, ones, cut=1.0, steps=1)
    bends_seen(flat)
    slopes(flat, cut=1.0)


def _normals() -> None:
    from stereorelight.camera import Camera
    from stereorelight.surface.normals import normals_and_sigma

    h, w = SIZE_HW
    flat, camera = np.ones(SIZE_HW, np.float32), Camera(size=(w, h), K=np.array([[w, 0, w / 2], [0, w, h / 2], [0, 0, 1]], np.float64))
    normals_and_sigma(flat, camera, confidence=flat, noise_per_m=0.01, Z_sigma=0.01 * flat)


def _lights() -> None:
    from stereorelight.light.lights import PointLight
    from stereorelight.light.shade import light_layers

    flat = np.ones((*SIZE_HW, 3), np.float32)
    light_layers(flat, flat, flat, [PointLight(name="one", position_m=(0, 0, 0), specular=0.1)])


def _evidence() -> None:
    from stereorelight.stereo.proxy import Proxy
    from stereorelight.stereo.refine import Effort, photometric_surface

    grey, known = np.zeros(SIZE_HW, np.float32), np.ones(SIZE_HW, np.bool_)
    flat = np.zeros((*SIZE_HW, 3), np.uint8)
    proxy = Proxy(left=flat, right=flat, left_grey=grey, right_grey=grey, left_known=known, right_known=known)
    photometric_surface(proxy, grey, grey + 1, effort=Effort(passes=0, rounds=2, steps=1, last=1))


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Kernels of one module of the engine, and what they call.  make : calls them;  kernels : their names, the last to be compiled last."""

    make: Callable[[], None]
    module: str
    kernels: tuple[str, ...]


# Those first that a run needs last: it does without help what it comes to first.
STAGES = {
    "bends": Stage(make=_bends, module="bending", kernels=("_correct",)),
    "normals": Stage(make=_normals, module="planes", kernels=("_fit", "_choose", "_without_spikes", "_disagreement", "_risk", "_blend")),
    "lights": Stage(make=_lights, module="plain_lights", kernels=("plain_lights",)),
    "evidence": Stage(make=_evidence, module="evidence", kernels=("_left_over", "_held_evidence")),
}


def kernels_of(stage: Stage) -> list[Any]:
    """The kernels themselves."""
    module = importlib.import_module(f"stereorelight.engine.{stage.module}")
    return [getattr(module, name) for name in stage.kernels]


def compiled(kernel: Any) -> bool:
    """Whether numba's cache on disk holds `kernel` as its source stands; True also where there is no cache to put it in."""
    folder = kernel.stats.cache_path
    if folder is None:
        return True
    source = Path(kernel.py_func.__code__.co_filename)
    found = [file.stat().st_mtime for file in Path(folder).glob(f"{source.stem}.{kernel.py_func.__name__}-*.nbi")]
    return bool(found) and max(found) >= source.stat().st_mtime


def shares_of(stages: Sequence[str], cores: int) -> list[list[str]]:
    """The stages dealt out to other processes: one for each core but the run's own, as long as there are stages."""
    count = min(cores - 1, len(stages))
    return [list(stages[k::count]) for k in range(count)]


def helper(share: Sequence[str]) -> subprocess.Popen[bytes]:
    """A process that goes through these stages, with the very modules of this one: a folder of the same name where it runs is none of them."""
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    return subprocess.Popen([sys.executable, "-P", "-m", __name__, *share], env=paths, **quiet)  # type: ignore[call-overload]


@contextlib.contextmanager
def compiling_ahead() -> Iterator[None]:
    """Other processes compile what is not yet compiled, until the block ends."""
    missing = [name for name, stage in STAGES.items() if not compiled(kernels_of(stage)[-1])]
    helpers: list[subprocess.Popen[bytes]] = []
    try:
        with contextlib.suppress(OSError):  # no such help, no harm
            for share in shares_of(missing, usable_cores()):
                helpers.append(helper(share))
        yield
    finally:
        for process in helpers:
            process.terminate()
            process.wait()


if __name__ == "__main__":
    from stereorelight.threads import set_threads

    set_threads(1)
    for asked in sys.argv[1:]:
        STAGES[asked].make()
