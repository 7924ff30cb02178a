"""Depth on the Motorcycle pair against truth, and its time against SGBM_3WAY bs3 + WLS in the same process.

Run:  python tests/benchmarks/bench_depth.py [runs]
Prints a row per quality: cover, bad2 (non-occluded and all), bad0.5, N5 median and share under 11.25 degrees, and how many times the
yardstick's time, everything included (tone match, range search, both eyes, flow, refinement, confidence, flags).  Each round runs every
job once, and the ratio is the median of the rounds' own: what slows a round down slows all of its jobs.  CPU time beside it tells how
much of both cores a job used, and hardly depends on who else uses them."""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from stereorelight.compare.depth import disparity_figures
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.compare.normals import disparity_normal_figures
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import Rectification, rectification
from stereorelight.stereo.settings import QUALITIES, DepthSettings
from stereorelight.threads import set_threads

DISPARITIES = 80


def yardstick(left: np.ndarray, right: np.ndarray, wls_lambda: float = 8000.0) -> np.ndarray:
    """SGBM_3WAY, block 3, left edge padded, filtered by WLS: what a careful engineer takes from OpenCV."""
    matcher = cv2.StereoSGBM_create(0, DISPARITIES, 3, 4 * 27, 24 * 27, 1, 63, 0, 0, 0, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    a, b = (cv2.copyMakeBorder(p, 0, 0, DISPARITIES, 0, cv2.BORDER_REPLICATE) for p in (left, right))
    raw, back = matcher.compute(a, b), cv2.ximgproc.createRightMatcher(matcher).compute(b, a)
    wls = cv2.ximgproc.createDisparityWLSFilter(matcher)
    wls.setLambda(wls_lambda)
    wls.setSigmaColor(1.5)
    return wls.filter(raw, a, None, back)[:, DISPARITIES:].astype(np.float32) / 16


def figures(disparity: np.ndarray) -> str:
    """One line of the figures of docs/figures.md."""
    pair = motorcycle()
    depth = disparity_figures(disparity, pair.disparity, nonoccluded=pair.nonoccluded)
    normals = disparity_normal_figures(disparity, pair.disparity, pair.rig, nonoccluded=pair.nonoccluded)
    seen, everywhere = depth.regions["nonoccluded"], depth.regions["all"]
    return (
        f"cover {seen.cover_percent:5.1f}  "
        f"bad2 {seen.bad_percent[2.0]:5.2f}  all {everywhere.bad_percent[2.0]:5.2f}  bad0.5 {seen.bad_percent[0.5]:5.2f}  "
        f"N5 {normals.median_deg:5.2f} deg, {normals.under_percent[11.25]:4.1f} % under 11.25"
    )


def linear(picture: np.ndarray) -> np.ndarray:
    x = picture.astype(np.float32) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


def pair_of_plates() -> tuple[np.ndarray, np.ndarray, Rectification]:
    from stereorelight.camera import Rig

    pair = motorcycle()
    rig = Rig(left=pair.rig.left, right=pair.rig.right, R_right_left=np.eye(3), t_right_left_m=np.array([-pair.rig.baseline_m, 0, 0]))
    return linear(pair.left), linear(pair.right), rectification(rig)


def main(runs: int = 15) -> None:
    set_threads()
    pair = motorcycle()
    left8, right8 = (np.ascontiguousarray(p[..., ::-1]) for p in (pair.left, pair.right))
    left, right, rectified = pair_of_plates()
    jobs = {"3WAY bs3 + WLS": lambda: yardstick(left8, right8), "3WAY bs3 + WLS 200": lambda: yardstick(left8, right8, 200.0)}
    for quality in QUALITIES:
        jobs[quality] = lambda quality=quality: recover(left, right, rectified, settings=DepthSettings(quality=quality)).rectified["disparity"]
    results = {name: job() for name, job in jobs.items()}
    for job in jobs.values():  # once more: caches, memory and the threads of either library are warm then
        job()
    times = np.empty((runs, len(jobs), 2))
    for round_ in times:
        for i, job in enumerate(jobs.values()):
            wall, cpu = time.perf_counter(), time.process_time()
            job()
            round_[i] = time.perf_counter() - wall, time.process_time() - cpu
    ratios = times / times[:, :1]
    for i, (name, disparity) in enumerate(results.items()):
        (low, high), (wall, cpu) = np.quantile(ratios[:, i, 0], (0.25, 0.75)), np.median(ratios[:, i], axis=0)
        print(f"{name:20s} {figures(disparity)}  time {wall:.2f} x (half of the rounds {low:.2f} to {high:.2f}), CPU {cpu:.2f} x", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 15)
