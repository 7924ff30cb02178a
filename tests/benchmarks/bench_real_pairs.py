"""Depth on any rectified pair with a true disparity, beside SGBM_3WAY bs3 + WLS: how far the figures of Motorcycle carry.

Run:  python tests/benchmarks/bench_real_pairs.py LEFT RIGHT TRUTH [--half]
LEFT, RIGHT: pictures of 8 bit; TRUTH: the left eye's disparity, px, 0 or not finite where unknown; --half: all at half the size.
Of docs/figures.md: Aloe is aloeL.jpg, aloeR.jpg and aloeGT.png of OpenCV's samples/data (Middlebury 2006, Hirschmueller and Scharstein 2007;
whole pixels), Cones is left_rgb.tif, right_rgb.tif and Cones_LEFT_GT.tif of pandora's notebooks/data (Scharstein and Szeliski 2003; quarters).
Prints bad0.5, 1, 2, 4 where both eyes see, bad2 of all, and confidence: the worst tenth of 1 % of the pixels and more, told and right."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.compare.motorcycle import seen_by_both
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import QUALITIES, DepthSettings
from stereorelight.synth.rigs import parallel_rig
from stereorelight.threads import set_threads
from tests.benchmarks import bench_depth


def read(path: str, half: bool) -> np.ndarray:
    """An 8-bit RGB picture (H, W, 3)."""
    picture = np.clip(cv2.imread(path, cv2.IMREAD_UNCHANGED), 0, 255).astype(np.uint8)
    picture = np.repeat(picture[..., None], 3, axis=2) if picture.ndim == 2 else picture[..., ::-1]
    size = (picture.shape[1] // 2, picture.shape[0] // 2)
    return np.ascontiguousarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if half else picture)


def read_truth(path: str, half: bool) -> np.ndarray:
    truth = cv2.imread(path, cv2.IMREAD_UNCHANGED).astype(np.float32)
    truth[~np.isfinite(truth) | (truth == 0)] = np.nan
    height, width = truth.shape
    return truth[: height // 2 * 2 : 2, : width // 2 * 2 : 2] / 2 if half else truth


def figures(disparity: np.ndarray, truth: np.ndarray) -> str:
    off, known = np.abs(disparity - truth), np.isfinite(truth)
    seen = known & seen_by_both(truth)
    told = [f"bad{most:g} {100 * np.mean(~(off[seen] <= most)):5.2f}" for most in (0.5, 1, 2, 4)]
    return "  ".join([*told, f"all {100 * np.mean(~(off[known] <= 2)):5.2f}"])


def belief(confidence: np.ndarray, disparity: np.ndarray, truth: np.ndarray) -> str:
    known = np.isfinite(truth)
    sure, right = confidence[known], np.abs(disparity - truth)[known] <= 1
    tenths = [one for low in np.arange(0, 1, 0.1) if (one := (sure >= low) & (sure < low + 0.1 + 0.01 * (low > 0.85))).mean() > 0.01]
    worst = max(tenths, key=lambda one: abs(sure[one].mean() - right[one].mean()))
    return (
        f"told {sure.mean():.3f}, right {right.mean():.3f}; worst tenth, {100 * worst.mean():.0f} %: "
        f"{sure[worst].mean():.2f}, {right[worst].mean():.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("left")
    parser.add_argument("right")
    parser.add_argument("truth")
    parser.add_argument("--half", action="store_true")
    asked = parser.parse_args()
    set_threads()
    left, right = (read(path, asked.half) for path in (asked.left, asked.right))
    truth = read_truth(asked.truth, asked.half)
    bench_depth.DISPARITIES = 16 * int(np.ceil((np.nanmax(truth) + 1) / 16))
    for weight in (8000.0, 200.0):
        a, b = (np.ascontiguousarray(eye[..., ::-1]) for eye in (left, right))
        print(f"3WAY bs3 + WLS {weight:<5g}  {figures(bench_depth.yardstick(a, b, weight), truth)}", flush=True)
    rig = rectification(parallel_rig((truth.shape[1], truth.shape[0])))  # any: only disparity is judged
    for quality in QUALITIES:
        found = recover(bench_depth.linear(left), bench_depth.linear(right), rig, settings=DepthSettings(quality=quality)).rectified
        print(f"{quality:20s}  {figures(found['disparity'], truth)}  {belief(found['confidence'], found['disparity'], truth)}", flush=True)


if __name__ == "__main__":
    main()
