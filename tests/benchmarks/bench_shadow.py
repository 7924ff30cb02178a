"""What shadows cost: 1920x1080, CPU time, everything run in turn in one process; ratios of medians are what counts.

    python tests/benchmarks/bench_shadow.py [ROUNDS] [--rays]

C: shadow_yardstick.c, one point light with a march of 48 steps and its shading, built with -O3 -march=native -ffast-math -fopenmp.
Ours: the march alone, and with its light (`relight_fused`).  Bounds: march with its light at most 1.0 times C; a light with a size at 16 samples
at most 20 times the hard one.  --rays adds exact rays, which take their time."""

from __future__ import annotations

import ctypes
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.camera import Camera
from stereorelight.light.lights import PointLight
from stereorelight.light.shade import relight_fused
from stereorelight.surface.emitters import Emitter
from stereorelight.surface.occlusion import ambient_occlusion
from stereorelight.surface.visibility import ShadowScene

SIZE = (1920, 1080)
STEPS = 48
MOST_C, MOST_HARD = 1.0, 20.0
POINTER = ctypes.POINTER(ctypes.c_float)
LIGHT_M = (1.0, 1.0, 0.0)


def in_c(plate: np.ndarray, Z: np.ndarray, N: np.ndarray, camera: Camera) -> Callable[[], np.ndarray] | None:
    """The yardstick, which returns its shadow; None where no compiler is found."""
    compiler = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    if compiler is None:
        return None
    library = Path(tempfile.mkdtemp()) / "yardstick.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(Path(__file__).with_name("shadow_yardstick.c")), "-o", str(library), "-lm"], check=True)
    kernel = ctypes.CDLL(str(library)).march
    down = np.ascontiguousarray(N * np.float32([1, -1, -1]))
    out, shadow = np.empty_like(plate), np.empty_like(Z)
    x, y, z = LIGHT_M
    numbers = [ctypes.c_float(v) for v in (x, -y, -z, camera.fx, camera.fy, camera.cx, camera.cy, 0.3)]
    more = [ctypes.c_float(v) for v in (100.0, float(Z.min()), 0.005, 0.05)]
    pointers = [a.ctypes.data_as(POINTER) for a in (Z, down, plate, out, shadow)]

    def run() -> np.ndarray:
        kernel(*pointers, *Z.shape, *numbers, STEPS, *more)
        return shadow

    run.keep = (down, out)  # type: ignore[attr-defined]
    return run


def main(rounds: int, rays: bool) -> int:
    camera = Camera.from_fov(50, SIZE)
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    inverse = 1 / (3 + np.sin(x / 90) + 0.5 * np.cos(y / 70))
    Z = (1 / inverse).astype(np.float32)
    P = np.stack([(x - camera.cx) / camera.fx * Z, -(y - camera.cy) / camera.fy * Z, -Z], axis=-1)
    N = np.cross(np.gradient(P, axis=0), np.gradient(P, axis=1))
    N *= -np.sign((N * P).sum(axis=-1, keepdims=True)) / np.linalg.norm(N, axis=-1, keepdims=True)
    N = np.ascontiguousarray(N, dtype=np.float32)
    plate = rng.uniform(0, 1, N.shape).astype(np.float32)
    scene = ShadowScene(Z=Z, N=N, camera=camera)
    hard = Emitter(name="key", shape="place", position_m=LIGHT_M)
    ball = Emitter(name="key", shape="ball", position_m=LIGHT_M, radius_m=0.1)
    sheet = Emitter(name="key", shape="rectangle", position_m=LIGHT_M, towards=(0, 0, -1), side_u_m=(0.3, 0, 0), side_v_m=(0, 0.2, 0))
    light = PointLight(name="key", position_m=LIGHT_M, specular=0.3, exponent=32)
    for made in (scene.lift, scene.halves, scene.reach, scene.P, scene.grid):
        assert made is not None

    def with_light() -> np.ndarray:
        return relight_fused(plate, Z, N, camera, [light], shadows={"key": scene.shadow(hard, method="march", steps=STEPS).lit})

    runs: dict[str, Callable[[], object]] = {
        "march, 48 steps": lambda: scene.shadow(hard, method="march", steps=STEPS),
        "march, 48 steps, and its light": with_light,
        "march, as many as pixels": lambda: scene.shadow(hard, method="march"),
        "ball, 16 samples, 48 steps": lambda: scene.shadow(ball, method="march", steps=STEPS),
        "rectangle, 16 samples, 48 steps": lambda: scene.shadow(sheet, method="march", steps=STEPS),
    }
    by_c = in_c(plate, Z, N, camera)
    if by_c is not None:
        runs["C, 48 steps and its light"] = by_c
    if rays:
        scene.shadow(hard, method="rays")
        runs["rays, hard"] = lambda: scene.shadow(hard, method="rays")
        runs["rays, ball, 16 samples"] = lambda: scene.shadow(ball, method="rays")
        runs["ambient occlusion, 16 samples"] = lambda: ambient_occlusion(scene, radius_m=0.3)
    times: dict[str, list[float]] = {name: [] for name in runs}
    for turn in range(rounds + 1):
        for name, run in runs.items():
            if turn > 3 and ("16 samples" in name or "rays" in name):
                continue
            start = time.process_time()
            run()
            if turn:  # the first one compiles
                times[name].append(time.process_time() - start)
    medians = {name: statistics.median(found) for name, found in times.items()}
    print("1920x1080, CPU time, ms")
    for name, median in medians.items():
        print(f"{name:34s} {median * 1e3:9.1f}")
    bounds = []
    if by_c is not None:
        ratio = medians["march, 48 steps, and its light"] / medians["C, 48 steps and its light"]
        print(f"march with its light: {ratio:.2f} times C (at most {MOST_C:g})")
        bounds.append(ratio <= MOST_C)
        facing = (N * (np.array(LIGHT_M) - P)).sum(axis=-1) > 0
        ours = scene.shadow(hard, method="march", steps=STEPS).lit > 0.5
        print(f"shadow: C {1 - (by_c()[facing] > 0.5).mean():.3f} of what faces the light, ours {1 - ours[facing].mean():.3f}")
    for name in ("ball", "rectangle"):
        ratio = medians[f"{name}, 16 samples, 48 steps"] / medians["march, 48 steps"]
        print(f"{name} at 16 samples: {ratio:.1f} times the hard light (at most {MOST_HARD:g})")
        bounds.append(ratio <= MOST_HARD)
    return 0 if all(bounds) else 1


if __name__ == "__main__":
    numbers = [a for a in sys.argv[1:] if a.isdigit()]
    sys.exit(main(int(numbers[0]) if numbers else 7, "--rays" in sys.argv))
