"""Depth of a real board against its own plane: OpenCV's thirteen chessboard pairs, 640 x 480, 8-bit JPEG, grey.

Run:  STEREORELIGHT_DATA=DIR python tests/benchmarks/bench_real_boards.py [--qualities standard ...]
The corners tell where the board is to a tenth of a pixel of disparity, so every pixel of it has a known answer; no other real pair
here has that over hands, monitors and bright walls.  It is the hardest ground there is for matching along rows: squares without
texture that repeat every 40 to 60 px, on slanted boards.  Prints, per quality and for SGBM_3WAY bs3 + WLS: pixels of the board off by
more than 0.5, 1 and 2 px, the median error, and for ours the mean confidence beside the share within 1 px."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import cv2
import numpy as np

from stereorelight.calibration.lens_choice import choose
from stereorelight.stereo.depth import recover
from stereorelight.stereo.proxy import Proxy, matching_proxy
from stereorelight.stereo.rectify import Rectification, rectification
from stereorelight.stereo.search import search_range
from stereorelight.stereo.semi_global import DisparityRange
from stereorelight.stereo.settings import QUALITIES, DepthSettings
from stereorelight.threads import set_threads
from tests.benchmarks.bench_depth import linear
from tests.test_calibration_real import real_views

RIM = 0.95  # squares about the outer corners that are still of the pattern
FOLDER = Path(os.environ.get("STEREORELIGHT_DATA", "nowhere")) / "opencv_chessboard"


def plane_of(pose: np.ndarray, board: np.ndarray, rectified: Rectification) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool, the pixels of the rectified left eye that show the pattern, and (H, W) px, the disparity of its plane."""
    R, camera = rectified.rig.R_rectified_left, rectified.rig.left
    (x0, y0), (x1, y1) = board[:, :2].min(axis=0) - RIM, board[:, :2].max(axis=0) + RIM
    rim = (np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]]) @ pose[:3, :3].T + pose[:3, 3]) @ R.T
    shown = np.zeros(camera.size_hw, np.uint8)
    cv2.fillConvexPoly(shown, np.rint(camera.project(rim)).astype(np.int32), 1)
    normal, middle = R @ pose[:3, 2], R @ pose[:3, 3]
    Z = (normal @ middle) / (camera.rays(camera.pixel_grid()) @ normal)
    return shown > 0, rectified.rig.disparity_from_depth(Z)


def yardstick(proxy: Proxy, search: DisparityRange) -> np.ndarray:
    """SGBM_3WAY, block 3, filtered by WLS, over the same range of the same 8-bit pictures."""
    matcher = cv2.StereoSGBM_create(search.low, search.count, 3, 4 * 27, 24 * 27, 1, 63, 0, 0, 0, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    left, right = (cv2.copyMakeBorder(p, 0, 0, search.high, 0, cv2.BORDER_REPLICATE) for p in (proxy.left, proxy.right))
    raw, back = matcher.compute(left, right), cv2.ximgproc.createRightMatcher(matcher).compute(right, left)
    wls = cv2.ximgproc.createDisparityWLSFilter(matcher)
    wls.setLambda(8000)
    wls.setSigmaColor(1.5)
    return wls.filter(raw, left, None, back)[:, search.high :].astype(np.float32) / 16


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--qualities", nargs="+", default=["standard"], choices=QUALITIES)
    asked = parser.parse_args()
    if not FOLDER.is_dir():
        raise SystemExit("STEREORELIGHT_DATA does not name a folder that holds opencv_chessboard: the real pairs are not here")
    set_threads()
    _, calibration = choose(real_views(), ((640, 480), (640, 480)))
    rectified = rectification(calibration.rig)
    errors: dict[str, list[np.ndarray]] = {name: [] for name in ("SGBM + WLS", *asked.qualities)}
    believed: dict[str, list[np.ndarray]] = {quality: [] for quality in asked.qualities}
    for pose, name in zip(calibration.board_poses, calibration.views.names, strict=True):
        left, right = (linear(cv2.imread(str(FOLDER / f"{eye}{name}.jpg"))) for eye in ("left", "right"))
        shown, plane = plane_of(pose, calibration.board_m, rectified)
        proxy = matching_proxy(rectified.rectify(left, "left"), rectified.rectify(right, "right"))
        errors["SGBM + WLS"].append(np.abs(yardstick(proxy, search_range(proxy, rectified.rig)) - plane)[shown])
        for quality in asked.qualities:
            found = recover(left, right, rectified, settings=DepthSettings(quality=quality)).rectified
            errors[quality].append(np.abs(found["disparity"] - plane)[shown])
            believed[quality].append(found["confidence"][shown])
    for name, parts in errors.items():
        error = np.concatenate(parts)
        bad = "  ".join(f"bad{t:g} {100 * np.mean(~(error <= t)):5.1f}" for t in (0.5, 1, 2))
        line = f"{name:12s} {bad} %  median {np.median(error):.2f} px"
        if name in believed:
            line += f"  confidence {np.concatenate(believed[name]).mean():.2f}, within 1 px {np.mean(error <= 1):.2f}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
