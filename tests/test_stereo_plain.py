"""Plain ground between textured rims: a slanted board of bare squares, synthetic and real."""

from __future__ import annotations

import numpy as np
import pytest

import stereorelight.stereo.match as matching
from stereorelight.stereo.depth import recover
from stereorelight.stereo.proxy import matching_proxy
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.search import search_range
from stereorelight.synth.rigs import parallel_rig
from tests.test_calibration_real import DATA, calibrated

cv2 = pytest.importorskip("cv2")
WIDTH, HEIGHT, SIDE_PX, TURN = 480, 360, 60, 0.1
SLOPE_X, SLOPE_Y, MIDDLE_PX = 0.05, 0.03, 50.0


def squares(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    u, v = ((np.cos(TURN) * x + np.sin(TURN) * y) / SIDE_PX, (-np.sin(TURN) * x + np.cos(TURN) * y) / SIDE_PX)
    return np.where((np.floor(u) + np.floor(v)) % 2 > 0, 0.6, 0.02)


def bare_board() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both plates of a slanted board, lit a little differently in each eye, 8 bit, and its disparity."""
    X, Y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    eyes = [np.zeros_like(X), np.zeros_like(X)]
    for dx, dy in [((i + 0.5) / 4 - 0.5, (j + 0.5) / 4 - 0.5) for i in range(4) for j in range(4)]:
        x, y = X + dx, Y + dy
        eyes[0] += squares(x, y) / 16
        eyes[1] += squares((x + MIDDLE_PX + SLOPE_Y * (y - HEIGHT / 2) - SLOPE_X * WIDTH / 2) / (1 - SLOPE_X), y) / 16
    rng = np.random.default_rng(0)
    plates = []
    for picture in eyes:
        uneven = cv2.GaussianBlur(rng.standard_normal(picture.shape), (0, 0), 6)
        lit = picture * (1 + 0.06 * uneven / uneven.std())
        code = np.rint(np.clip(lit ** (1 / 2.2) + 0.003 * rng.standard_normal(lit.shape), 0, 1) * 255) / 255
        plates.append(np.repeat(code[..., None] ** 2.2, 3, axis=2).astype(np.float32))
    return plates[0], plates[1], MIDDLE_PX + SLOPE_X * (X - WIDTH / 2) + SLOPE_Y * (Y - HEIGHT / 2)


def off(plates: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    left, right, truth = plates
    found = recover(left, right, rectification(parallel_rig((WIDTH, HEIGHT)))).rectified["disparity"]
    return np.abs(found - truth)[20:-20, 90:-20]


def test_half_the_size_leads_where_the_full_size_is_lost(monkeypatch) -> None:
    plates = bare_board()
    led = off(plates)
    monkeypatch.setattr(matching, "PLAIN_LOST", 2.0)
    alone = off(plates)
    assert np.isfinite(led).all()
    assert np.mean(led > 1) < 0.8 * np.mean(alone > 1)
    assert np.median(led) < 0.6 * np.median(alone)


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="STEREORELIGHT_DATA does not name a folder that holds opencv_chessboard: the real pairs are not here")
def test_real_boards_lie_on_their_planes_and_are_believed(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Three of the thirteen real pairs: every pixel of the board, against the plane of its corners, beside SGBM filtered by WLS."""
    from tests.benchmarks.bench_depth import linear
    from tests.benchmarks.bench_real_boards import plane_of, yardstick

    _, calibration = calibrated(tmp_path_factory)
    rectified = rectification(calibration.rig)
    ours, theirs, told = [], [], []
    for name in ("01", "07", "13"):
        pose = calibration.board_poses[list(calibration.views.names).index(name)]
        left, right = (linear(cv2.imread(str(DATA / f"{eye}{name}.jpg"))) for eye in ("left", "right"))
        shown, plane = plane_of(pose, calibration.board_m, rectified)
        proxy = matching_proxy(rectified.rectify(left, "left"), rectified.rectify(right, "right"))
        theirs.append(np.abs(yardstick(proxy, search_range(proxy, rectified.rig)) - plane)[shown])
        found = recover(left, right, rectified).rectified
        ours.append(np.abs(found["disparity"] - plane)[shown])
        told.append(found["confidence"][shown])
    error, usual = np.concatenate(ours), np.concatenate(theirs)
    for name, off_px in (("ours", error), ("SGBM + WLS", usual)):
        print(f"{name}: off by more than 1 and 2 px {np.mean(~(off_px <= 1)):.3f} {np.mean(~(off_px <= 2)):.3f}")
    assert np.isfinite(error).all()
    assert np.mean(error > 1) < 0.28
    assert np.mean(error > 2) < 0.13
    assert np.mean(error > 2) < 0.5 * np.mean(~(usual <= 2))
    sure, right = np.concatenate(told), error <= 1
    tenths = [(sure >= low) & (sure < low + 0.1) for low in np.arange(0, 1, 0.1)]
    off = [float(sure[t].mean() - right[t].mean()) for t in tenths if t.mean() > 0.05]
    print(f"told {sure.mean():.3f}, right {right.mean():.3f}; by tenths {np.round(off, 3)}")
    assert sure.mean() == pytest.approx(right.mean(), abs=0.05)
    assert np.abs(off).max() < 0.15  # of tenths that hold a twentieth of the pixels and more
