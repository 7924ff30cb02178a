"""Corners of rendered boards against truth, under everything that spoils pictures; and views: picked, paired, mirrored, late.

The renderer (tests/boards.py) samples areas through the real camera with disc and box blurs: it is not the fitted model."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stereorelight.calibration import views
from stereorelight.calibration.board import Board, parse_board
from stereorelight.calibration.board_wrong import second_board, what_else
from stereorelight.calibration.corners import Detection, detect, turned, turns
from stereorelight.calibration.refine_corners import refine_corners
from stereorelight.calibration.timing import movement_px, time_offset
from stereorelight.camera import Camera
from stereorelight.errors import PlateError
from tests.boards import board_pose, render_board, seen, true_corners
from tests.test_calibration_real import BOARD, DATA, detected

CAMERA = replace(Camera.from_fov(50, (640, 480)), distortion=(-0.15, 0.03, 0.0008, -0.0006))
CHESS, CHARUCO, APRIL = (parse_board(s) for s in ("chessboard:9x6:0.025", "charuco:8x6:0.03:0.022:DICT_5X5_100", "aprilgrid:4x3:0.05:0.3"))
BOARDS = pytest.mark.parametrize("board", [CHESS, CHARUCO, APRIL], ids=lambda b: b.kind)
DISTANCE = {"chessboard": 0.45, "charuco": 0.42, "aprilgrid": 0.45}
CASES = {
    "typical": ({"noise": 1.0, "jpeg": 95}, 0.012),
    "soft and noisy": ({"defocus_px": 2.5, "noise": 4.0}, 0.035),
    "7 px of motion aslant": ({"motion_px": (6.2, 3.3), "noise": 1.0}, 0.03),
    "7 px of motion along": ({"motion_px": (7.0, 0.0), "noise": 1.0}, 0.03),
    "low contrast": ({"white": 0.25, "black": 0.19, "noise": 2.0}, 0.11),
    "over-exposed": ({"exposure": 2.5, "noise": 1.0}, 0.03),
    "hard JPEG": ({"jpeg": 70, "noise": 1.0}, 0.03),
    "dark": ({"exposure": 0.03, "noise": 1.0}, 0.03),
}


def pose(board: Board, seed: int, camera: Camera = CAMERA, *, nearer: float = 1.0, roll_deg: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    w, h = camera.size
    return board_pose(
        board,
        camera,
        at_px=(0.49 * w + 20 * seed, 0.49 * h),
        distance_m=DISTANCE[board.kind] * nearer * (1 + 0.1 * seed),
        tilt_deg=(float(rng.uniform(-35, 35)), float(rng.uniform(-35, 35))),
        roll_deg=float(rng.uniform(-20, 20)) if roll_deg is None else roll_deg,
    )


def rms(found: Detection, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((found.px - truth[found.ids]) ** 2, axis=1))))


@BOARDS
@pytest.mark.parametrize("case", CASES)
def test_corners_are_true(board: Board, case: str) -> None:
    """From a start a tenth of a pixel off; the fit alone, so that blur which no marker's code survives is tested on every board."""
    how, bound = CASES[case]
    off = []
    for seed in range(2):
        picture, truth = render_board(board, CAMERA, *pose(board, seed), seed=seed, **how)  # type: ignore[arg-type]
        ids = np.flatnonzero(np.isfinite(truth[:, 0]))
        start = truth[ids] + np.random.default_rng(seed).normal(0, 0.15, (len(ids), 2))
        fit = refine_corners(picture.astype(np.float32), board, ids, start)
        assert fit.refined.mean() > 0.97
        off.append(((fit.px - truth[ids])[fit.refined] ** 2).sum(axis=1))
    assert np.sqrt(np.concatenate(off).mean()) <= bound


TONES = {
    "linear": (0.012, lambda x: x),
    "Rec.709": (0.012, lambda x: np.where(x < 0.018, 4.5 * x, 1.099 * np.maximum(x, 1e-9) ** 0.45 - 0.099)),
    "LogC3": (0.02, lambda x: 0.24719 * np.log10(5.555556 * x + 0.052272) + 0.385537),
    "S-shaped": (0.012, lambda x: (lambda s: s * s * (3 - 2 * s))(np.maximum(x, 0) ** (1 / 2.2))),
}


@pytest.mark.parametrize("tone", TONES)
@pytest.mark.parametrize("roll", [0.0, 1.0])
def test_edges_along_the_pixel_rows_are_true_whatever_curve_was_recorded(tone: str, roll: float) -> None:
    """There every sample of an edge has the same phase: what the model lacks of tone or blur would show in full."""
    R, t = board_pose(CHESS, CAMERA, at_px=(313.6, 235.2), distance_m=DISTANCE["chessboard"], tilt_deg=(20, 0), roll_deg=roll)
    light, truth = render_board(CHESS, CAMERA, R, t, linear=True, deep=True)
    bound, curve = TONES[tone]
    level = 255 * curve(light / 65535)
    picture = np.clip(np.rint(level + np.random.default_rng(0).normal(0, 1, level.shape)), 0, 255).astype(np.float32)
    start = truth + np.random.default_rng(0).normal(0, 0.15, truth.shape)
    fit = refine_corners(picture, CHESS, np.arange(54), start)
    assert np.sqrt(np.mean(np.sum((fit.px - truth) ** 2, axis=1))) <= bound


def test_corners_between_unread_markers_join_by_the_grid() -> None:
    """Four markers are painted over inside; the corners beside them stay and are as true as the rest."""
    R, t = pose(CHARUCO, 0)
    picture, truth = render_board(CHARUCO, CAMERA, R, t, noise=1)
    for i, j in ((2, 3), (3, 2), (3, 4), (4, 3)):
        middle = CAMERA.project(R @ np.array([(i + 0.5) * 0.03, (j + 0.5) * 0.03, 0]) + t)
        cv2.circle(picture, (round(middle[0]), round(middle[1])), 6, 205, -1)
    found = detect(picture, CHARUCO)
    assert found is not None
    assert len(found) == len(truth)
    assert rms(found, truth) <= 0.012


@pytest.mark.parametrize("case", CASES)
def test_a_chessboard_is_found_whatever_spoils_it(case: str) -> None:
    how, bound = CASES[case]
    picture, truth = render_board(CHESS, CAMERA, *pose(CHESS, 1), seed=1, **how)  # type: ignore[arg-type]
    found = detect(picture, CHESS)
    assert found is not None
    assert np.array_equal(found.ids, np.arange(54))
    assert rms(found, truth) <= bound
    along = np.hypot(*found.motion_px)
    assert (along == pytest.approx(7.0, abs=1.2)) if "motion" in case else found.blur_px[0] < 2.2


@BOARDS
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32", "RGB"])
def test_any_picture_type(board: Board, kind: str) -> None:
    picture, truth = render_board(board, CAMERA, *pose(board, 0), noise=1)
    given = {
        "uint8": picture,
        "uint16": picture.astype(np.uint16) * 257,
        "float32": picture.astype(np.float32) / 255,
        "RGB": np.repeat(picture[..., None], 3, axis=2),
    }
    found = detect(given[kind], board)
    assert found is not None
    assert len(found) >= 0.95 * len(truth)
    assert rms(found, truth) <= 0.012


def test_the_stated_sigma_is_the_error() -> None:
    z = []
    for seed in range(3):
        picture, truth = render_board(CHESS, CAMERA, *pose(CHESS, seed), defocus_px=1.5, noise=5, seed=seed)
        found = detect(picture, CHESS)
        assert found is not None
        z.append((found.px - truth) / found.sigma_px[:, None])
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4


@pytest.mark.parametrize("roll", [0, 95, 180, 250])
def test_a_turned_chessboard_keeps_its_order(roll: float) -> None:
    """9x6: the colours of its corners tell which way up it is, whatever way it is held."""
    picture, truth = render_board(CHESS, CAMERA, *pose(CHESS, 1, roll_deg=roll, nearer=1.3), noise=1)
    found = detect(picture, CHESS)
    assert found is not None
    assert rms(found, truth) < 0.03


@pytest.mark.parametrize(
    ("spec", "ways"), [("chessboard:9x6:1", 1), ("chessboard:8x6:1", 2), ("chessboard:7x5:1", 2), ("chessboard:6x6:1", 4), ("chessboard:7x7:1", 2)]
)
def test_a_board_that_looks_the_same_turned_is_agreed_between_the_eyes(spec: str, ways: int) -> None:
    board = parse_board(spec)
    assert turns(board) == ways
    R, t = board_pose(board, CAMERA, at_px=(300, 240), distance_m=17, tilt_deg=(20, 10), roll_deg=85)
    left = seen(board, CAMERA, R, t)
    assert left is not None
    for k in range(0, 4, 4 // ways) if ways > 1 else ():
        other = turned(left, board, k)
        again = turned(other, board, (4 - k) % 4)
        assert np.array_equal(again.px, left.px)
        assert np.array_equal(views.same_order(left, other, board).px, left.px)


@pytest.mark.parametrize("board", [CHARUCO, APRIL], ids=lambda b: b.kind)
def test_a_mirrored_eye_is_found_flipped(board: Board) -> None:
    picture, truth = render_board(board, CAMERA, *pose(board, 0), noise=1, mirrored=True)
    found = detect(picture, board)
    assert found is not None
    assert found.mirrored
    assert rms(found, truth) <= 0.012
    assert not found.flipped().mirrored
    assert detect(picture, board, try_mirrored=False) is None


@BOARDS
def test_no_board_is_none(board: Board) -> None:
    rng = np.random.default_rng(0)
    busy = cv2.GaussianBlur(rng.integers(0, 256, (480, 640)).astype(np.uint8), (0, 0), 4)
    for picture in (np.full((480, 640), 90, np.uint8), np.zeros((480, 640), np.uint8), cv2.normalize(busy, None, 0, 255, cv2.NORM_MINMAX)):
        assert detect(picture, board, thorough=False) is None
    with pytest.raises(PlateError, match="uint8"):
        detect(np.zeros((480, 640), np.int32), board)
    with pytest.raises(PlateError, match=r"\(H, W\)"):
        detect(np.zeros(640, np.uint8), board)


def test_the_wrong_board_is_named() -> None:
    picture, _ = render_board(parse_board("chessboard:8x6:0.025"), CAMERA, *pose(CHESS, 0), noise=1)
    assert detect(picture, CHESS, thorough=False) is None
    assert "8x6 inner corners is seen, not 9x6" in what_else(picture, CHESS)
    assert "without charuco markers" in what_else(picture, CHARUCO)
    picture, _ = render_board(CHARUCO, CAMERA, *pose(CHARUCO, 0), noise=1)
    assert "DICT_5X5" in what_else(picture, parse_board("charuco:8x6:0.03:0.022:DICT_6X6_100"))
    assert what_else(np.full((480, 640), 90, np.uint8), CHESS) == ""


def test_two_boards_are_seen() -> None:
    camera = Camera.from_fov(50, (960, 480))
    one, truth = render_board(CHESS, camera, *board_pose(CHESS, camera, at_px=(230, 240), distance_m=0.75), surround=0.3)
    both = one.copy()
    both[:, 480:] = one[:, :480]
    found = detect(one, CHESS)
    assert found is not None
    assert not second_board(one, CHESS, found)
    found = detect(both, CHESS)
    assert found is not None
    assert second_board(both, CHESS, found)
    assert np.isfinite(truth).all()


def poses(count: int, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [
        board_pose(
            CHESS,
            CAMERA,
            at_px=(float(rng.uniform(220, 420)), float(rng.uniform(180, 300))),
            distance_m=float(rng.uniform(0.5, 0.8)),
            tilt_deg=(float(rng.uniform(-35, 35)), float(rng.uniform(-35, 35))),
            roll_deg=float(rng.uniform(-15, 15)),
        )
        for _ in range(count)
    ]


def both_eyes(
    placed: list[tuple[np.ndarray, np.ndarray]], board: Board = CHESS, *, mirrored: bool = False
) -> tuple[dict[int, Detection], dict[int, Detection]]:
    left, right = {}, {}
    for f, (R, t) in enumerate(placed):
        a, b = seen(board, CAMERA, R, t, seed=f), seen(board, CAMERA, R, t - [0.065, 0.002, 0], mirrored=mirrored, seed=100 + f)
        if a and b:
            left[f], right[f] = a, b
    return left, right


@pytest.mark.parametrize("spec", ["chessboard:9x6:0.025", "chessboard:8x6:0.025", "chessboard:6x6:0.03", "chessboard:8x5:0.03"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mirrored_eye_is_told_from_plain_chessboards(spec: str, mirrored: bool) -> None:
    board = parse_board(spec)
    left, right = both_eyes(poses(8), board)
    if mirrored:  # what a detector makes of the mirrored picture: an upright board at other places, in its own order
        right = {f: views.reflected(d, board) for f, d in right.items()}
    pairs = views.pair_eyes(dict(left), dict(right), board)
    assert pairs.mirrored == ("right" if mirrored else None)
    assert views.epipolar_px(list(pairs.left.values()), [pairs.right[f] for f in pairs.left]) < 0.3


def test_a_mirrored_picture_of_a_chessboard_reflects_to_truth() -> None:
    for board in (CHESS, parse_board("chessboard:8x5:0.025"), parse_board("chessboard:8x6:0.025")):
        R, t = pose(board, 1, nearer=1.2)
        picture, _ = render_board(board, CAMERA, R, t, noise=1, mirrored=True)
        found = detect(picture, board)
        assert found is not None
        truth = true_corners(board, CAMERA, R, t)
        back = views.reflected(found, board)
        close = [rms(turned(back, board, k), truth) for k in range(0, 4, 4 // turns(board))]
        assert min(close) < 0.02


def test_eyes_are_paired() -> None:
    left, right = both_eyes(poses(5))
    pairs = views.pair_eyes({**left, 7: left[0]}, {**right, 9: right[0], 7: None}, CHESS)
    assert (pairs.only_left, pairs.only_right) == ((7,), (9,))
    assert "5 frames have the board in both eyes" in pairs.words[0]
    with pytest.raises(PlateError, match="none of the 1 pictures of the right eye"):
        views.pair_eyes(dict(left), {0: None}, CHESS)
    with pytest.raises(PlateError, match="no frame shows the board in both eyes"):
        views.pair_eyes({0: left[0]}, {1: right[1]}, CHESS)
    with pytest.raises(PlateError, match="frame 1: size 320x240, but 640x480 before"):
        views.pair_eyes({**left, 1: replace(left[1], size=(320, 240))}, dict(right), CHESS)


@pytest.mark.parametrize("late", [-2, 0, 3])
def test_a_late_eye_is_recognised(late: int) -> None:
    s = np.linspace(0, 2 * np.pi, 40)
    path = [
        board_pose(CHESS, CAMERA, at_px=(320 + 80 * np.sin(a), 240 + 60 * np.sin(2 * a)), distance_m=0.6, tilt_deg=(25 * np.cos(a), 25 * np.sin(a)))
        for a in s
    ]
    left, right = both_eyes(path)
    moved = {f + late: d for f, d in right.items()}
    assert time_offset(left, moved)[0] == late
    assert np.nanmax(list(movement_px(left).values())) > 5


def test_the_best_views_are_sharp_and_spread() -> None:
    placed = poses(60)
    every = {f: d for f, (R, t) in enumerate(placed) if (d := seen(CHESS, CAMERA, R, t)) is not None}
    every = {f: replace(d, sharpness=0.2) if f % 3 == 0 else d for f, d in every.items()}
    chosen = views.pick_views(every, CHESS, count=12)
    assert len(set(chosen)) == 12
    assert sum(f % 3 == 0 for f in chosen) <= 1
    filled = (views.coverage([every[f] for f in chosen]) > 0).sum()
    first = (views.coverage([every[f] for f in [f for f in sorted(every) if f % 3][:12]]) > 0).sum()
    assert filled >= first
    assert np.ptp([views.board_pose(every[f], CHESS).tilt_y_deg for f in chosen]) > 45
    assert views.pick_views(every, CHESS, count=100) == tuple(sorted(every))


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (30.0, 0.0), (0.0, -25.0)])
def test_tilt_is_what_was_set(tilt: tuple[float, float]) -> None:
    camera = Camera.from_fov(50, (640, 480))
    found = seen(CHESS, camera, *board_pose(CHESS, camera, at_px=(319.5, 239.5), distance_m=0.5, tilt_deg=tilt))
    assert found is not None
    told = views.board_pose(found, CHESS, focal_px=camera.fx)
    assert (abs(told.tilt_x_deg), abs(told.tilt_y_deg)) == pytest.approx((abs(tilt[0]), abs(tilt[1])), abs=0.3)
    assert told.tilt_deg == pytest.approx(max(abs(v) for v in tilt), abs=0.3)


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="STEREORELIGHT_DATA names no folder with opencv_chessboard: the 13 real pairs are not here")
def test_the_real_pictures_are_found_in_every_view(tmp_path_factory: pytest.TempPathFactory) -> None:
    found = detected(tmp_path_factory)
    assert all(len(f) == 13 and None not in f.values() for f in found.values())
    unsettled = sum(int((~d.refined).sum()) for f in found.values() for d in f.values() if d)
    assert unsettled <= 0.005 * 26 * 54
    left, right = ([d for d in found[eye].values() if d] for eye in ("left", "right"))
    assert not views.mirrored_eye(left, right, BOARD)
