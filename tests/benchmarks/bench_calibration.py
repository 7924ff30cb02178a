"""Calibration figures on the thirteen real pairs: OpenCV's own pipelines and ours, in one table.

Run:  STEREORELIGHT_DATA=... python -m tests.benchmarks.bench_calibration
LOO is the vertical error on a pair left out of the solve, mean (95th percentile), pixels, over all corners of all views;
square sd is the spread of triangulated square sides.  Every row is judged by the same code."""

from __future__ import annotations

import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stereorelight.arrays import Float64
from stereorelight.calibration.board import parse_board
from stereorelight.calibration.lens_choice import choose
from stereorelight.calibration.sightings import Corners, StereoViews
from stereorelight.calibration.solve import solve_rig
from stereorelight.calibration.validate import neighbours, rectified_corners, validate
from stereorelight.camera import Camera
from stereorelight.errors import RigError
from stereorelight.footage.movie.writer import MovieWriter
from stereorelight.shot.calibrate import calibrate
from tests.boards import board_pose
from tests.calibration_views import RIGS, SIZE, board, camera, rig, views_of
from tests.test_calibration_real import DATA, real_views

FRAME = (640, 480)
MOVIE_BOARD = "charuco:9x7:0.03:0.022:DICT_4X4_50"
MOVIE_RIG = rig(camera(1700, 965, 535, size=(1920, 1080)), camera(1710, 951, 549, size=(1920, 1080)), (0.3, 2.0, 0.5))


def opencv_corners(how: str) -> Float64:
    """(2, 13, 54, 2) corners by OpenCV alone: "subpix 11" the tutorial's, "subpix 5", or "SB"."""
    eyes = []
    for eye in ("left", "right"):
        found = []
        for path in sorted(DATA.glob(f"{eye}*.jpg")):
            grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if how == "SB":
                flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
                ok, corners = cv2.findChessboardCornersSB(grey, (9, 6), flags=flags)
                ok, corners = (ok, corners) if ok else cv2.findChessboardCornersSB(grey, (9, 6))
            else:
                ok, corners = cv2.findChessboardCorners(grey, (9, 6))
                window = int(how.split()[1])
                criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
                corners = cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), criteria) if ok else None
            found.append(corners.reshape(-1, 2).astype(np.float64) if ok else np.full((54, 2), np.nan))
        eyes.append(found)
    px = np.array(eyes)
    flip = (px[..., -1, 0] < px[..., 0, 0])[..., None, None]  # a chessboard looks the same upside down
    return np.where(flip, px[..., ::-1, :], px)


def opencv_rig(px: Float64, flags: int) -> tuple[float, tuple[Camera, Camera], Float64, Float64]:
    points = board(9, 6, 1.0).astype(np.float32)
    views = np.isfinite(px).all(axis=(0, 2, 3))
    each = [[p.astype(np.float32) for p in eye[views]] for eye in px]
    plan = [points] * int(views.sum())
    eyes = [cv2.calibrateCamera(plan, e, FRAME, None, None, flags=flags)[1:3] for e in each]
    joint = flags | cv2.CALIB_USE_INTRINSIC_GUESS
    rms, K1, d1, K2, d2, R, t, *_ = cv2.stereoCalibrate(plan, *each, *eyes[0], *eyes[1], FRAME, flags=joint)
    cameras = [
        Camera(size=FRAME, K=K, model="rational" if flags & cv2.CALIB_RATIONAL_MODEL else "brown", distortion=tuple(d.ravel())[: 8 if flags else 5])
        for K, d in ((K1, d1), (K2, d2))
    ]
    return rms, (cameras[0], cameras[1]), R, t.ravel()


def judged(px: Float64, cameras: tuple[Camera, Camera], R: Float64, t: Float64) -> tuple[Float64, Float64]:
    """Vertical errors (V, n), pixels, and square sides (V, pairs)."""
    bent = rectified_corners(cameras, R, t, px)
    focal = np.mean([(c.fx + c.fy) / 2 for c in cameras])
    Z = np.linalg.norm(t) / (bent[0, ..., 0] - bent[1, ..., 0])
    points = np.stack([bent[0, ..., 0] * Z, bent[:, ..., 1].mean(axis=0) * Z, Z], axis=-1)
    i, j = neighbours(board(9, 6, 1.0))
    return np.abs(bent[0, ..., 1] - bent[1, ..., 1]) * focal, np.linalg.norm(points[:, i] - points[:, j], axis=-1)


def row(name: str, rms: float, errors: Float64, side: Float64) -> None:
    e, s = errors[~np.isnan(errors)], side[np.isfinite(side)]
    high = np.percentile(e, 95, method="higher")  # an infinite error is not to be interpolated
    print(f"| {name} | {rms:.3f} | {e.mean():.3f} ({high:.3f}) | {s.std():.4f} |", flush=True)


def opencv_row(name: str, px: Float64, flags: int = 0) -> None:
    rms, cameras, R, t = opencv_rig(px, flags)
    errors = np.full(px.shape[1:3], np.nan)
    for v in range(px.shape[1]):
        less = px.copy()
        less[:, v] = np.nan
        try:
            errors[v] = judged(px[:, v : v + 1], *opencv_rig(less, flags)[1:])[0]
        except RigError:
            errors[v] = np.inf  # the lens folds over inside the frame
    row(name, rms, errors, judged(px, cameras, R, t)[1])


def our_row(name: str, views: StereoViews, **kw: Any) -> None:
    _, calibration = choose(views, (FRAME, FRAME), **kw)
    quality, state = validate(calibration), calibration.fit.state
    side = judged(views.px, (calibration.rig.left, calibration.rig.right), state.R_right_left, state.t_right_left_m)[1]
    row(name, calibration.rms_all_px, quality.held_out_all_px, side)


def as_views(px: Float64) -> StereoViews:
    eyes = [[Corners(ids=np.arange(54), px=p) for p in eye] for eye in px]
    return StereoViews(points_m=board(9, 6, 1.0), left=eyes[0], right=eyes[1])


def _minute(folder: Path, *, eye: int, seconds: int, size: tuple[int, int] = (1920, 1080)) -> Path:
    """A movie in which a board wanders through the frame and turns, with pauses, as a hand would move it: exact homographies of one large print."""
    plan = parse_board(MOVIE_BOARD)
    x0, y0, x1, y1 = plan.extent_m
    rim, per_m = 0.02, 3000.0  # a print of 3 px a millimetre, its pixels smaller than those of the frame
    print_ = np.full((round((y1 - y0 + 2 * rim) * per_m), round((x1 - x0 + 2 * rim) * per_m)), 190, np.uint8)
    for a, b, c, d in ((plan.rectangles_m - [x0 - rim, y0 - rim, x0 - rim, y0 - rim]) * per_m).round().astype(int):
        print_[b:d, a:c] = 30
    to_m = np.array([[1 / per_m, 0, x0 - rim + 0.5 / per_m], [0, 1 / per_m, y0 - rim + 0.5 / per_m], [0, 0, 1]])
    print_ = cv2.GaussianBlur(print_, (0, 0), 1.0)
    camera = (MOVIE_RIG.left, MOVIE_RIG.right)[eye]
    rng = np.random.default_rng(eye)
    grain = rng.normal(0, 1.5, (4, size[1], size[0], 1)).astype(np.float32)
    path = folder / f"{('left', 'right')[eye]}.mp4"
    with MovieWriter(path, size=size, rate=25, codec="h264") as movie:
        for frame in range(25 * seconds):
            s = frame / 25
            s = s - 0.6 * np.sin(2 * np.pi * s / 1.5) * 1.5 / (2 * np.pi)  # slow, fast, slow: hands pause
            at = (size[0] * (0.5 + 0.27 * np.sin(0.9 * s)), size[1] * (0.5 + 0.22 * np.sin(1.31 * s + 1)))
            tilt = (38 * np.sin(0.53 * s), 38 * np.sin(0.71 * s + 2))
            R, t = board_pose(plan, MOVIE_RIG.left, at_px=at, distance_m=0.62 + 0.1 * np.sin(0.4 * s), tilt_deg=tilt, roll_deg=20 * np.sin(0.3 * s))
            if eye:
                R, t = MOVIE_RIG.R_right_left @ R, MOVIE_RIG.R_right_left @ t + MOVIE_RIG.t_right_left_m
            H = camera.K @ np.column_stack([R[:, 0], R[:, 1], t]) @ to_m
            grey = cv2.warpPerspective(print_, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=100)
            movie.write(np.repeat(((grey[..., None] + grain[frame % 4]) / 255).astype(np.float32), 3, axis=2))
    return path


def movie_row(seconds: int = 60) -> None:
    """A minute of 1080p, both eyes, from files to the rig: wall time and CPU time against play time."""
    with tempfile.TemporaryDirectory() as name:
        with ProcessPoolExecutor(2) as pool:
            made = [pool.submit(_minute, Path(name), eye=eye, seconds=seconds) for eye in (0, 1)]
            left, right = (m.result() for m in made)
        told: list[str] = []
        wall, cpu = time.perf_counter(), time.process_time()
        session = calibrate(left, right, parse_board(MOVIE_BOARD), on_picture=lambda what, done, total: told.append(what))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    rig, focal = session.rig, session.rig.left.fx / MOVIE_RIG.left.fx - 1
    print(
        f"a movie of {seconds} s, 1920x1080, 25 frames a second, two eyes: calibrated in {wall:.1f} s ({wall / seconds:.2f} of its play time), "
        f"{cpu:.1f} s of CPU; {len(told)} steps of the progress bar, {len(session.names)} views, rows agree to "
        f"{session.quality.held_out_mean_px:.3f} px held out; focal length off by {100 * focal:.3f} %, "
        f"baseline by {100 * (rig.baseline_m / MOVIE_RIG.baseline_m - 1):.3f} %"
    )


def main() -> None:
    movie_row()
    if DATA.is_dir():
        print("| corners, solver | RMS | LOO | square sd |\n|---|---|---|---|")
        sets = {how: opencv_corners(how) for how in ("subpix 11", "subpix 5", "SB")}
        ours = real_views()
        for how, px in {**sets, "our corners": ours.px}.items():
            opencv_row(f"{how}, OpenCV 5 parameters", px)
        for how, px in sets.items():
            our_row(f"{how}, ours", as_views(px))
        our_row("our corners, ours, board taken as drawn", ours, boards=("true",))
        our_row("our corners, ours, board solved", ours)
    else:
        print("STEREORELIGHT_DATA does not name a folder that holds opencv_chessboard: no real figures")
    views = views_of(RIGS["toed-in"], count=60)
    for free in (False, True):
        began = time.perf_counter()
        solve_rig(views, (SIZE, SIZE), ("brown5", "brown5"), free_board=free)
        print(f"60 views x 88 corners x 2 eyes, board {'solved' if free else 'true'}: {time.perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
