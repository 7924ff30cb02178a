"""Normals from noisy disparity at 1080p: degrees by region and estimator, and the CPU time in units of plain differences.

Run: python tests/benchmarks/bench_normals.py [--small].  Error is the median angle to the exact normal, on a slanted wall, on spheres
and in a band of 12 px round every depth edge, for white noise and for noise smoothed over 1.5 px, both of 0.25 px."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import cv2
import numpy as np

from stereorelight.camera import Camera
from stereorelight.surface.normals import normals_from_depth
from stereorelight.surface.position import scene_from_camera

SPHERES = (((-0.5, 0.0, 1.7), 0.4), ((-0.05, -0.25, 1.4), 0.1), ((0.45, 0.1, 1.5), 0.25))
FX_B = 192.0  # fx 1920 px, eyes 0.1 m apart


def scene(width: int, height: int) -> tuple[Camera, np.ndarray, np.ndarray, np.ndarray]:
    """Camera, exact Z, exact scene-frame N, and the part that each pixel shows (0 wall, 1 ... spheres)."""
    camera = Camera(size=(width, height), K=np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1]]))
    rays = camera.rays(camera.pixel_grid())
    wall = np.array([0.5, 0.2, 1.0]) / np.linalg.norm((0.5, 0.2, 1.0))
    Z = 3 * wall[2] / (rays @ wall)
    N = np.broadcast_to(-wall, rays.shape).copy()
    part = np.zeros(Z.shape, dtype=int)
    for index, (centre, radius) in enumerate(SPHERES, start=1):
        a, b, c = (rays * rays).sum(-1), rays @ centre, np.dot(centre, centre) - radius**2
        inside = b * b - a * c
        near = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        hit = near < Z
        Z[hit] = near[hit]
        N[hit] = (rays[hit] * near[hit, None] - centre) / radius
        part[hit] = index
    return camera, Z, scene_from_camera(N), part


def noise(shape: tuple[int, ...], correlation_px: float) -> np.ndarray:
    """White noise of unit variance, smoothed by a Gaussian and brought back to it."""
    values = np.random.default_rng(0).normal(size=shape)
    if correlation_px:
        values = cv2.GaussianBlur(values, (0, 0), correlation_px)
    return values / values.std()


def regions(part: np.ndarray) -> dict[str, np.ndarray]:
    """Masks: wall and spheres well away from depth edges, and the band round them."""
    edge = np.zeros(part.shape, np.uint8)
    edge[:, 1:] |= part[:, 1:] != part[:, :-1]
    edge[1:] |= part[1:] != part[:-1]
    band, wide = (cv2.dilate(edge, np.ones((2 * r + 1,) * 2, np.uint8)) > 0 for r in (12, 24))
    return {"wall": (part == 0) & ~wide, "spheres": (part > 0) & ~wide, "band": band}


def cpu_ms(call: Callable[[], object], runs: int = 5) -> float:
    """Median CPU time of a call, milliseconds, every thread counted."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        call()
        times.append(1000 * (time.process_time() - start))
    return statistics.median(times)


def main() -> None:
    width, height = (480, 270) if "--small" in sys.argv else (1920, 1080)
    camera, Z, N, part = scene(width, height)
    masks = regions(part)
    seen = {}
    for name, correlation_px, sigma_px in (("exact", 0.0, 0.0), ("white", 0.0, 0.25), ("correlated", 1.5, 0.25)):
        seen[name] = (FX_B / (FX_B / Z + sigma_px * noise(Z.shape, correlation_px))).astype(np.float32)
    print(f"{width}x{height}; median degrees ({' / '.join(masks)})")
    times = {}
    for method in ("difference", "plane"):
        cells = []
        for name, depth in seen.items():
            found = normals_from_depth(depth, camera, method=method).astype(np.float64)
            angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(found, N), axis=-1), (found * N).sum(-1)))
            cells.append(f"{name} " + " / ".join(f"{np.nanmedian(angle[mask]):.3g}" for mask in masks.values()))
        times[method] = cpu_ms(lambda method=method: normals_from_depth(seen["white"], camera, method=method))
        print(f"{method:>10}: {';  '.join(cells)};  {times[method]:.0f} ms CPU")
    print(f"plane / difference: {times['plane'] / times['difference']:.1f} x the CPU time")


if __name__ == "__main__":
    main()
