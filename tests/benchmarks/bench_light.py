"""What the light kernel costs: 1920x1080, CPU time, everything run in turn in one process; ratios of medians are what counts.

    python tests/benchmarks/bench_light.py [ROUNDS]

Memory floor: a kernel that reads Z and RGB and writes RGB.  NumPy: tests/reference_light.py in float32, as a compositor
would write it.  C: light_yardstick.c, built with -O3 -march=native -ffast-math -fopenmp where a compiler is there, and checked to
give the same picture.  A whole exponent is squared up by both; "any exponent" takes both through the same polynomial power.  Floor, C
and kernel write into one picture each; NumPy makes its own.  Layers: what they cost beside the picture, in units of a kernel that
does nothing but write as many pictures, all of it into memory that is there (fresh pages cost more than either, by the machine's mood);
and beside it in units of one that streams them past the caches, as large layers are.  Ratios are medians over rounds of what was run
in that round, with their least and most.
Bounds are those of the project: 1, 4 and 16 lights at most 1.1 times C, 4 lights at most 12 times the floor, 1 and 4 lights at least
40 times faster than NumPy.  Lights with a size, GGX and materials are measured, without a bound."""

from __future__ import annotations

import ctypes
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.camera import Camera
from stereorelight.comp import relight
from stereorelight.engine import light as engine
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.stream import stream, streamed
from stereorelight.light import shade
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SphereLight, SpotLight
from stereorelight.light.materials import Material
from stereorelight.light.shade import light_layers, relight_fused
from stereorelight.surface.position import position_from_depth
from tests.reference_light import reference_layers, reference_relight

SIZE = (1920, 1080)
MOST_C, MOST_FLOORS, LEAST_NUMPY = 1.1, 12.0, 40.0
MOST_NUMPY = 9  # rounds; each takes a second and a half
POINTER = ctypes.POINTER(ctypes.c_float)


@njit(nogil=True, fastmath=True)
def _floor(Z, plate, out):  # type: ignore[no-untyped-def]
    for y in range(Z.shape[0]):
        for x in range(Z.shape[1]):
            z = Z[y, x]
            out[y, x, 0] = plate[y, x, 0] + z
            out[y, x, 1] = plate[y, x, 1] + z
            out[y, x, 2] = plate[y, x, 2] + z


@njit(nogil=True, fastmath=True)
def _written(first, end, value, out):  # type: ignore[no-untyped-def]
    for y in range(first, end):
        for k in range(out.shape[0]):
            row = out[k, y]
            for x in range(row.shape[0]):
                row[x] = value


@njit(nogil=True, fastmath=True)
def _streamed(first, end, value, room, out):  # type: ignore[no-untyped-def]
    for y in range(first, end):
        for k in range(out.shape[0]):
            room[:] = value
            stream(out.shape[2], room, out[k, y])
    streamed()


def written_past(pictures: np.ndarray) -> None:
    """The same past the caches."""
    out = pictures.reshape(len(pictures), SIZE[1], 3 * SIZE[0])
    in_row_blocks(lambda first, end: _streamed(first, end, np.float32(0.5), np.empty(3 * SIZE[0], np.float32), out), SIZE[1])


def written(pictures: np.ndarray) -> None:
    """What layers cost at least: pictures (n, H, W, 3) filled row by row as the kernel goes."""
    out = pictures.reshape(len(pictures), SIZE[1], 3 * SIZE[0])
    in_row_blocks(lambda first, end: _written(first, end, np.float32(0.5), out), SIZE[1])


def both(plate: np.ndarray, Z: np.ndarray, N: np.ndarray, camera: Camera, lights: list[Light], picture: np.ndarray, layers: np.ndarray) -> None:
    """`relight_with_layers` into memory that is there."""
    names, slots = shade._layers_of(lights, ())
    rows = shade._rows(lights, (), {}, camera.size_hw, slots, {})
    surface = engine.Surface(Z=Z, N=N, pinhole=(camera.fx, camera.fy, camera.cx, camera.cy))
    engine.shade(surface, plate, rows.table, rows.slots, rows.mattes, glows=rows.glows, layers=layers[: len(names)], plate=plate, beauty=picture)


def in_c(plate: np.ndarray, Z: np.ndarray, N: np.ndarray, camera: Camera, out: np.ndarray) -> Callable[[list[Light]], Callable[[], object]] | None:
    """The yardstick for a list of point lights, or None where no compiler is found."""
    compiler = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    if compiler is None:
        return None
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # threads of C that wait in a loop would be counted to whoever runs next
    library = Path(tempfile.mkdtemp()) / "yardstick.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(Path(__file__).with_name("light_yardstick.c")), "-o", str(library), "-lm"], check=True)
    kernel = ctypes.CDLL(str(library)).relight
    numbers = [ctypes.c_float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy, 0.3)]

    def way(lights: list[Light]) -> Callable[[], object]:
        table = np.array([[*light.position_m, 1, 0, 0, 0, 0, 1, *light.color] for light in lights], np.float32)  # type: ignore[attr-defined]
        pointers = [a.ctypes.data_as(POINTER) for a in (Z, N, plate, out)]
        return lambda: (kernel(*pointers, *Z.shape, table.ctypes.data_as(POINTER), len(lights), *numbers, ctypes.c_float(lights[0].exponent)), table)

    return way


def some_lights(count: int, exponent: float = 32) -> list[Light]:
    """Point lights with diffuse and specular."""
    return [PointLight(name=f"p{k}", position_m=(1 - 0.1 * k, 1, 0.1 * k), specular=0.3, exponent=exponent) for k in range(count)]


def mixture() -> list[Light]:
    """One of each kind and more: 4 lights."""
    return [
        PointLight(name="key", position_m=(1, 1, 0), specular=0.3),
        SpotLight(name="spot", position_m=(-1, 1, 0), aim_m=(0, 0, -3), specular=0.3),
        DirectionalLight(name="sun", azimuth_deg=30, elevation_deg=40),
        PointLight(name="fill", position_m=(-1, 0, 0), attenuation="radius", radius_m=5),
    ]


def main(rounds: int) -> int:
    camera = Camera.from_fov(50, SIZE)
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    Z = (3 + np.sin(x / 90) + 0.5 * np.cos(y / 70)).astype(np.float32)
    N = np.dstack([np.cos(x / 90) * 0.5, np.sin(y / 70) * 0.3, np.ones_like(x)])
    N = (N / np.linalg.norm(N, axis=-1, keepdims=True)).astype(np.float32)
    plate = rng.uniform(0, 1, N.shape).astype(np.float32)
    out, picture = np.empty_like(plate), np.empty_like(plate)
    room = np.empty((8, *plate.shape), np.float32)
    P = position_from_depth(Z, camera)

    def numpy_way(lights: list[Light]) -> Callable[[], object]:
        return lambda: reference_relight(plate, position_from_depth(Z, camera), N, lights)

    left = (x < SIZE[0] / 2).astype(np.float32)
    one, four, sixteen = some_lights(1), some_lights(4), some_lights(16)
    runs: dict[str, Callable[[], object]] = {
        "memory floor": lambda: _floor(Z, plate, out),
        "1 light": lambda: relight_fused(plate, Z, N, camera, one, out=picture),
        "1 light, diffuse alone": lambda: relight_fused(plate, Z, N, camera, [PointLight(name="a", position_m=(1, 1, 0))], out=picture),
        "4 lights": lambda: relight_fused(plate, Z, N, camera, four, out=picture),
        "4 lights, mixed kinds": lambda: relight_fused(plate, Z, N, camera, mixture(), out=picture),
        "16 lights": lambda: relight_fused(plate, Z, N, camera, sixteen, out=picture),
        "4 lights, any exponent": lambda: relight_fused(plate, Z, N, camera, some_lights(4, 32.5), out=picture),
        "1 light, picture and layers": lambda: both(plate, Z, N, camera, one, picture, room),
        "4 lights, picture and layers": lambda: both(plate, Z, N, camera, four, picture, room),
        "writing 2 pictures": lambda: written(room[:2]),
        "writing 8 pictures": lambda: written(room),
        "streaming 2 pictures": lambda: written_past(room[:2]),
        "streaming 8 pictures": lambda: written_past(room),
        "1 light, layers, then comp": lambda: relight(plate, light_layers(P, N, plate, one)),
        "4 lights, layers, then comp": lambda: relight(plate, light_layers(P, N, plate, four)),
        "1 ball": lambda: relight_fused(plate, Z, N, camera, [SphereLight(name="a", position_m=(1, 1, 0), radius_m=0.3, specular=0.3)]),
        "1 rectangle": lambda: relight_fused(
            plate, Z, N, camera, [RectLight(name="a", position_m=(1, 1, 0), size_m=(1, 0.5), aim_m=(0, 0, -3), specular=0.3)]
        ),
        "1 light, GGX": lambda: relight_fused(plate, Z, N, camera, [PointLight(name="a", position_m=(1, 1, 0), model="ggx", specular=0.3)]),
        "1 light, 2 materials": lambda: relight_fused(
            plate, Z, N, camera, one, mattes={"left": left}, materials=[Material(name="metal", matte="left", model="ggx")]
        ),
        "NumPy, 1 light": numpy_way(one),
        "NumPy, 4 lights": numpy_way(four),
    }
    by_c = in_c(plate, Z, N, camera, out)
    if by_c is not None:
        for name, lights in (("1 light", one), ("4 lights", four), ("16 lights", sixteen), ("4 lights, any exponent", some_lights(4, 32.5))):
            runs[f"C, {name}"] = by_c(lights)
            runs[f"C, {name}"]()
            apart = float(np.abs(out - relight_fused(plate, Z, N, camera, lights)).max())
            assert apart < 1e-3, f"the yardstick gives another picture, {apart:.1e} apart"
    times: dict[str, list[float]] = {name: [] for name in runs}
    for turn in range(rounds + 1):
        for name, run in runs.items():
            if name.startswith("NumPy") and turn > MOST_NUMPY:
                continue
            start = time.process_time()
            run()
            if turn:  # the first one compiles
                times[name].append(time.process_time() - start)
    medians = {name: statistics.median(found) for name, found in times.items()}
    floor = medians["memory floor"]
    print(f"{'1920x1080, CPU time':30s} {'ms':>8s} {'x floor':>8s}")
    for name, median in medians.items():
        print(f"{name:30s} {median * 1e3:8.1f} {median / floor:8.1f}")

    def of(name: str, other: str) -> tuple[float, float, float]:
        """Median, least and most over the rounds that both were run in."""
        found = sorted(a / b for a, b in zip(times[name], times[other]))
        return statistics.median(found), found[0], found[-1]

    ratios = {name[3:]: of(name[3:], name) for name in medians if name.startswith("C, ")}
    for name, (ratio, low, high) in ratios.items():
        print(f"{name}: {ratio:.2f} times C, {low:.2f} to {high:.2f} (at most {MOST_C:g})")
    for count, pictures in (("1 light", 2), ("4 lights", 8)):
        more = medians[f"{count}, picture and layers"] - medians[count]
        plain, past = (more / medians[f"{way} {pictures} pictures"] for way in ("writing", "streaming"))
        print(f"{count}: layers cost {plain:.2f} times their writing, {past:.2f} times their streaming")
    floors = medians["4 lights"] / floor
    print(f"4 lights: {floors:.1f} times the memory floor (at most {MOST_FLOORS:g})")
    faster = {name: of(f"NumPy, {name}", name) for name in ("1 light", "4 lights")}
    for name, (ratio, low, high) in faster.items():
        print(f"{name}: NumPy takes {ratio:.0f} times as long, {low:.0f} to {high:.0f} (at least {LEAST_NUMPY:g})")

    layers = light_layers(P, N, plate, mixture())
    reference = reference_layers(P.astype(np.float64), N.astype(np.float64), plate.astype(np.float64), mixture())
    worst = max(float(np.abs(layers[name] - want).max() / want.max()) for name, want in reference.items())
    print(f"against the float64 reference: {worst:.1e} of a layer's largest value (at most 5e-05)")
    return (
        0
        if all(r <= MOST_C for r, _, _ in ratios.values())
        and floors <= MOST_FLOORS
        and all(r >= LEAST_NUMPY for r, _, _ in faster.values())
        and worst <= 5e-5
        else 1
    )


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 15))
