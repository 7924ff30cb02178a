"""What the environment kernel costs: 1920x1080, CPU time against the same layers in C, pairs run in turn in one process.

    python tests/benchmarks/bench_environment.py [ROUNDS]

The yardstick is environment_yardstick.c, built with -O3 -march=native -ffast-math -fopenmp where a compiler is there.
Bound of the project: at most 1.2 times its CPU time, by the ratio of medians.  The two answers are compared, too."""

from __future__ import annotations

import ctypes
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.engine import environment as engine

SIZE = (1920, 1080)
MOST_C = 1.2
POINTER = ctypes.POINTER(ctypes.c_float)
Array = np.ndarray


def compiled() -> ctypes.CDLL | None:
    """The yardstick, or None where no compiler is found."""
    compiler = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    if compiler is None:
        return None
    out = Path(tempfile.mkdtemp()) / "yardstick.so"
    source = Path(__file__).with_name("environment_yardstick.c")
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(source), "-o", str(out), "-lm"], check=True)
    return ctypes.CDLL(str(out))


def at(a: Array | None) -> ctypes._Pointer | None:  # type: ignore[type-arg]
    return None if a is None else a.ctypes.data_as(POINTER)


def main(rounds: int) -> int:
    w, h = SIZE
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)
    Z = 3 + np.sin(x / 90) + 0.5 * np.cos(y / 70)
    P = np.dstack([(x - w / 2) / w * Z, (h / 2 - y) / w * Z, -Z]).astype(np.float32)
    N = np.dstack([np.cos(x / 90) * 0.5, np.sin(y / 70) * 0.3, np.ones_like(x)])
    N = (N / np.linalg.norm(N, axis=-1, keepdims=True)).astype(np.float32)
    albedo = rng.uniform(0, 1, N.shape).astype(np.float32)
    maps = [rng.uniform(0, 2, (n, 2 * n, 3)).astype(np.float32) for n in (128, 512, 256)]
    soft, sharp, rough = (engine.padded(m) for m in maps)
    library = compiled()
    worst = 0.0
    print(f"{'1920x1080, CPU ms':44s} {'ours':>8s} {'C':>8s} {'ratio':>7s} {'apart':>9s}")
    for title, asked, blend in (
        ("irradiance", "d", 0.0),
        ("mirror", "r", 0.0),
        ("irradiance and mirror", "dr", 0.0),
        ("irradiance and rough reflection, two levels", "dr", 0.4),
        ("glass: reflection and refraction", "rt", 0.0),
        ("everything, two levels", "drt", 0.4),
    ):
        numbers = np.zeros(engine.NUMBERS, np.float32)
        numbers[[0, 4, 8]] = 1
        numbers[engine.IOR], numbers[engine.MIXED], numbers[engine.BLEND] = 1.5, 1, blend
        numbers[engine.DIFFUSE :] = 1
        ours, theirs = ({key: np.empty_like(P) for key in asked} for _ in range(2))

        def run_ours(numbers: Array = numbers, out: dict[str, Array] = ours) -> None:
            engine.shade(
                P,
                N,
                albedo,
                None,
                numbers,
                soft=soft,
                sharp=sharp,
                rough=rough,
                diffuse=out.get("d"),
                reflection=out.get("r"),
                refraction=out.get("t"),
            )

        def run_c(blend: float = blend, out: dict[str, Array] = theirs) -> None:
            tables = [v for m in maps for v in (at(m), m.shape[1], m.shape[0])]
            assert library is not None
            library.environment(
                at(P), at(N), at(albedo), h, w, ctypes.c_float(1.5), ctypes.c_float(blend), *tables, *(at(out.get(key)) for key in "drt")
            )

        runs = [run_ours] if library is None else [run_ours, run_c]
        times: list[list[float]] = [[] for _ in runs]
        for turn in range(rounds + 1):
            for run, found in zip(runs, times):
                start = time.process_time()
                run()
                if turn:  # the first one compiles
                    found.append(time.process_time() - start)
        medians = [statistics.median(found) * 1e3 for found in times]
        if library is None:
            print(f"{title:44s} {medians[0]:8.1f}")
            continue
        ratio, apart = medians[0] / medians[1], max(float(np.abs(ours[key] - theirs[key]).max()) for key in asked)
        worst = max(worst, ratio)
        print(f"{title:44s} {medians[0]:8.1f} {medians[1]:8.1f} {ratio:7.2f} {apart:9.1e}")
    if library is None:
        print("no C compiler here: nothing to compare with")
        return 0
    print(f"worst {worst:.2f} times C (at most {MOST_C:g})")
    return 0 if worst <= MOST_C else 1


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 15))
