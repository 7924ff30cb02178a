"""`compare` at 1920 x 1080: CPU and wall time of one comparison with its page, and memory over frames.

    python tests/benchmarks/bench_compare.py [--frames 100] [--size 480x270]

A slanted floor, a wall and a sphere with 0.3 px of noise stand for a result; the truth is ours, or a renderer's ray length in centimetres with
P and coded N beside it, so that everything has to be found out.  Memory is the peak of a fresh process, after 10 frames and after all."""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from stereorelight.camera import Rig
from stereorelight.footage.exr import write_exr
from stereorelight.footage.frames import write_frame
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Frame
from stereorelight.surface.position import position_from_depth
from stereorelight.synth.rigs import rectified_rig, rig_named

SIZE = (1920, 1080)


def scene(rig: Rig) -> dict[str, np.ndarray]:
    """Z, P, N of a wall at 4 m, a floor and a sphere, and their disparity."""
    rays = rig.left.ray_grid().astype(np.float64)
    wall = np.full(rays.shape[:2], 4.0)
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 1] > 0, 0.6 / rays[..., 1], np.inf)
    d = np.concatenate([rays, np.ones((*wall.shape, 1))], axis=-1)
    centre, radius = np.array([0.2, 0.0, 2.0]), 0.4
    a, b = (d**2).sum(-1), d @ centre
    inside = b**2 - a * (centre @ centre - radius**2)
    ball = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    Z = np.minimum(np.minimum(wall, floor), ball)
    P = position_from_depth(Z.astype(np.float32), rig.left)
    N = np.where((ball <= Z)[..., None], (P - centre * (1, -1, -1)) / radius, np.where((floor <= Z)[..., None], [0, 1.0, 0], [0, 0, 1.0]))
    return {"Z": Z.astype(np.float32), "P": P, "N": N.astype(np.float32)}


def files(folder: Path, size: tuple[int, int]) -> None:
    rig = rig_named("parallel", size)
    write_rig(folder / "rig.json", rig)
    true = scene(rig)
    rng = np.random.default_rng(0)
    flat = rectified_rig(rig)
    Z = flat.depth_from_disparity(flat.disparity_from_depth(true["Z"]) + 0.3 * rng.standard_normal(true["Z"].shape)).astype(np.float32)
    N = true["N"] + 0.1 * rng.standard_normal(true["N"].shape)
    result = {"Z": Z, "N": (N / np.linalg.norm(N, axis=-1, keepdims=True)).astype(np.float32), "confidence": rng.random(Z.shape).astype(np.float32)}
    write_frame(folder / "result.exr", Frame(passes=result, camera=rig.left))
    write_frame(folder / "ours.exr", Frame(passes={**true, "flags": np.zeros(Z.shape, np.uint16)}, camera=rig.left))
    ray = true["Z"] * np.sqrt(1 + (rig.left.ray_grid() ** 2).sum(-1))
    channels = {"depth.Z": 100 * ray} | {f"N.{c}": (true["N"][..., i] + 1) / 2 for i, c in enumerate("RGB")}
    write_exr(folder / "foreign.exr", {**channels, **{f"P.{c}": 100 * true["P"][..., i] for i, c in enumerate("XYZ")}})


def one(arguments: list[str]) -> dict[str, float]:
    """A comparison in a fresh process: wall and CPU seconds, MiB at its peak."""
    code = "import sys; from stereorelight.cli import main; main(sys.argv[1:], standalone_mode=False)"
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    # VmHWM, since ru_maxrss of a child begins at its parent's.
    peak = "print(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", f"{code}; {peak}", *arguments], capture_output=True, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": time.perf_counter() - start, "cpu_s": cpu, "peak_mib": int(done.stderr.split()[-1]) / 1024}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--size", default="480x270", help="Of the frames whose memory is looked at.")
    asked = parser.parse_args()
    frames, small = asked.frames, tuple(int(n) for n in asked.size.split("x"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files(folder, SIZE)
        result, rig = str(folder / "result.exr"), str(folder / "rig.json")
        for truth in ("ours.exr", "foreign.exr"):
            for what in ("depth", "normals"):
                options = ["--rig", rig] if what == "depth" else []
                page = ["--out", str(folder / "page.html"), "--force"]
                told = one(["compare", result, str(folder / truth), "--what", what, *options, *page])
                size = (folder / "page.html").stat().st_size / 1e6
                print(f"{what} against {truth}, with page ({size:.1f} MB): " + json.dumps({k: round(v, 1) for k, v in told.items()}), flush=True)
        folder = folder / "shot"
        folder.mkdir()
        files(folder, (small[0], small[1]))
        rig = str(folder / "rig.json")
        for k in range(frames):
            for source, link in (("result", "r"), ("ours", "t")):
                (folder / f"{link}.{1001 + k}.exr").symlink_to(folder / f"{source}.exr")
        for last in (10, frames):
            shots = [str(folder / f"{name}.####.exr") for name in "rt"]
            told = one(["compare", *shots, "--what", "depth", "--rig", rig, "--frames", f"1001-{1000 + last}"])
            print(f"{last} frames of {asked.size}: " + json.dumps({k: round(v, 1) for k, v in told.items()}), flush=True)


if __name__ == "__main__":
    main()
