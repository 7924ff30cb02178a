"""A movie pair to scene-linear float against ffmpeg's own decoding of the same files, in turn, in one run.

Run:  python tests/benchmarks/bench_movie.py [--frames 300] [--rounds 3] [--only NAME]
Movies: 1920 x 1080, moving texture with grain, at the bit rates of cameras.  Ours: both eyes read in turn through a log curve and a 3x3,
into float32.  Yardstick: `ffmpeg -i LEFT -f rawvideo -y /dev/null`, then the same for RIGHT.  Asked: at least half of ffmpeg's speed.
Also prints this process's peak memory after 30 frames and after all.  ffmpeg is the one on PATH, or imageio_ffmpeg's."""

from __future__ import annotations

import argparse
import importlib.util
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.footage.colour import transfer_table
from stereorelight.footage.movie.reader import Movie
from stereorelight.threads import set_threads
from tests.movie_files import write_movie

SIZE = (1920, 1080)
LEAST = 0.5
KINDS = {
    "H.264 8 bit 4:2:0": ("libx264", "yuv420p", {"preset": "ultrafast", "b": "50M", "bf": "2", "g": "15"}),
    "H.265 10 bit 4:2:0": ("libx265", "yuv420p10le", {"preset": "ultrafast", "b": "50M", "x265-params": "log-level=none:bitrate=50000"}),
    "ProRes 422 10 bit": ("prores_ks", "yuv422p10le", {"profile": "standard"}),
}


def ffmpeg() -> str | None:
    """The ffmpeg program, or None."""
    found = shutil.which("ffmpeg")
    if found is None and importlib.util.find_spec("imageio_ffmpeg"):
        import imageio_ffmpeg

        found = imageio_ffmpeg.get_ffmpeg_exe()
    return found


def texture(pixel_format: str) -> list[list[np.ndarray]]:
    """Sixteen frames of a moving picture with grain, as planes; a movie repeats them."""
    ten = "10" in pixel_format
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    base = 120 + 50 * np.sin(x / 37) * np.cos(y / 53) + 25 * np.sin(x * y / 9000)
    kind, scale, half = (np.uint16, 4, 512) if ten else (np.uint8, 1, 128)
    rows = 2 if "420" in pixel_format else 1
    frames = []
    for k in range(16):
        luma = np.clip(np.roll(base, 3 * k, axis=1) + rng.normal(0, 3, base.shape), 16, 235) * scale
        chroma = [half + scale * (20 * np.sin((x + 4 * k) / s) + rng.normal(0, 1, x.shape))[::rows, ::2] for s in (80, 60)]
        frames.append([p.astype(kind) for p in (luma, *chroma)])
    return frames


def peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def ours(paths: list[Path], frames: int) -> tuple[float, float]:
    """Wall and CPU seconds, all threads together."""
    table = transfer_table("LogC3")  # a camera's log curve and the matrix of its primaries
    start, busy = time.perf_counter(), time.process_time()
    with Movie(paths[0]) as left, Movie(paths[1]) as right:
        for k in range(frames):
            left.read(k, table)
            right.read(k, table)
    return time.perf_counter() - start, time.process_time() - busy


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def yardstick(program: str, paths: list[Path]) -> tuple[float, float]:
    start, busy = time.perf_counter(), _children_s()
    for path in paths:
        subprocess.run([program, "-v", "error", "-nostdin", "-i", str(path), "-f", "rawvideo", "-y", "/dev/null"], check=True)
    return time.perf_counter() - start, _children_s() - busy


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    program = ffmpeg()
    if program is None:
        print("skipped: no ffmpeg on PATH, and no imageio_ffmpeg (pip install imageio-ffmpeg)")
        return 0
    set_threads()
    worst = np.inf
    for name, kind in KINDS.items():
        if asked.only not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            pictures = texture(kind[1])
            left = Path(folder) / "left.mov"
            write_movie(left, (pictures[k % 16] for k in range(asked.frames)), SIZE, kind, rate=Fraction(24), tags=("bt709", False))
            paths = [left, Path(shutil.copy(left, Path(folder) / "right.mov"))]
            rate = left.stat().st_size * 8 * 24 / asked.frames / 1e6
            ours(paths, min(30, asked.frames))  # compiles
            early = peak_mib()
            times = [(ours(paths, asked.frames), yardstick(program, paths)) for _ in range(asked.rounds)]
            late = peak_mib()
        mine, theirs = (statistics.median(t[k][0] for t in times) for k in (0, 1))
        by_cpu = statistics.median(t[1][1] for t in times) / statistics.median(t[0][1] for t in times)
        worst = min(worst, theirs / mine)
        print(
            f"{name:20s} {rate:4.0f} Mbit/s  ours {2 * asked.frames / mine:6.1f} frames/s  ffmpeg {2 * asked.frames / theirs:6.1f}  "
            f"ratio {theirs / mine:.2f} (at least {LEAST}), by CPU time {by_cpu:.2f}  "
            f"peak memory {early:.0f} MiB at 30 frames, {late:.0f} at {asked.frames}",
            flush=True,
        )
    return 0 if worst >= LEAST else 1


if __name__ == "__main__":
    sys.exit(main())
