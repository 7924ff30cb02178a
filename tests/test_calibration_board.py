"""Boards: the spec, the geometry against OpenCV's own drawing, and the page that is printed."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.calibration.board import Board, dictionary, parse_board
from stereorelight.calibration.board_pdf import PAGES_MM, POINTS_PER_MM, board_pdf, page_for
from stereorelight.errors import ShotError

SPECS = ["chessboard:9x6:0.025", "charuco:11x8:0.04:0.03:DICT_5X5_100", "aprilgrid:6x6:0.088:0.3"]


@pytest.mark.parametrize("spec", SPECS)
def test_a_spec_comes_back(spec: str) -> None:
    assert parse_board(spec).spec == spec
    assert parse_board(parse_board(spec).spec) == parse_board(spec)


@given(st.integers(3, 20), st.integers(3, 20), st.floats(0.001, 2, allow_nan=False))
def test_corners_are_a_grid(columns: int, rows: int, square: float) -> None:
    board = Board(kind="chessboard", columns=columns, rows=rows, square_m=square)
    points = board.points_m.reshape(rows, columns, 3)
    assert np.allclose(points[:, 1:] - points[:, :-1], [square, 0, 0])
    assert np.allclose(points[1:] - points[:-1], [0, square, 0])
    assert parse_board(board.spec).square_m == pytest.approx(square, rel=1e-11)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("chesboard:9x6:0.025", "did you mean 'chessboard'"),
        ("chessboard:9x6", "1 parts"),
        ("chessboard:9*6:0.02", "COLUMNSxROWS"),
        ("chessboard:9x6:25", "write 0.025 for 25 mm"),
        ("chessboard:2x6:0.025", "3x3"),
        ("chessboard:9x6:nan", "must be a number"),
        ("charuco:11x8:0.03:0.04:DICT_5X5_100", "smaller than its square"),
        ("charuco:11x8:0.04:0.03:DICT_5x5", "did you mean"),
        ("charuco:31x18:0.04:0.03:DICT_5X5_100", "279 markers"),
        ("aprilgrid:6x6:0.088:30", "share of a tag"),
        ("", "unknown"),
    ],
)
def test_a_wrong_spec_is_told_what_is_wrong(spec: str, words: str) -> None:
    with pytest.raises(ShotError, match=re.escape(words)) as problem:
        parse_board(spec)
    assert "\n" not in str(problem.value)


def drawn(board: Board, per_m: float) -> np.ndarray:
    x0, y0, x1, y1 = board.extent_m
    picture = np.full((round((y1 - y0) * per_m), round((x1 - x0) * per_m)), 255, np.uint8)
    for a, b, c, d in np.rint((board.rectangles_m - [x0, y0, x0, y0]) * per_m).astype(int):
        assert (picture[b:d, a:c] == 255).all(), "black rectangles overlap"
        picture[b:d, a:c] = 0
    return picture


@pytest.mark.parametrize("size", [(5, 4), (4, 5), (6, 6), (5, 7)])
def test_charuco_is_opencvs_own(size: tuple[int, int]) -> None:
    board = parse_board(f"charuco:{size[0]}x{size[1]}:0.04:0.028:DICT_5X5_100")
    theirs = cv2.aruco.CharucoBoard(size, 0.04, 0.028, dictionary("DICT_5X5_100"))
    assert np.allclose(board.points_m, theirs.getChessboardCorners(), atol=1e-8)
    picture = drawn(board, 1000)  # 40 px a square, 4 px a cell
    assert np.array_equal(picture, theirs.generateImage((40 * size[0], 40 * size[1])))


def test_aprilgrid_is_kalibrs() -> None:
    """Tag 0 at the bottom left, ids to the right and then up, each found by OpenCV's detector with a border of two bits."""
    board = parse_board("aprilgrid:3x2:0.08:0.3")
    picture = cv2.copyMakeBorder(drawn(board, 1000), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary(str(board.dictionary)), parameters).detectMarkers(picture)
    middle = {int(i): c.reshape(4, 2).mean(axis=0) for i, c in zip(ids.ravel(), corners)}
    assert sorted(middle) == [0, 1, 2, 3, 4, 5]
    x0, y0, _, _ = board.extent_m
    for tag, at in middle.items():
        mine = board.points_m[4 * tag : 4 * tag + 4, :2].mean(axis=0) - (x0, y0)
        assert np.allclose(at, mine * 1000 + 60, atol=2)
    assert middle[0][1] > middle[3][1]
    assert middle[1][0] > middle[0][0]


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("page", ["A0", "exact"])
def test_the_page_has_true_size(spec: str, page: str) -> None:
    board = parse_board(spec)
    data = board_pdf(board, page)
    assert data == board_pdf(board, page)
    assert data.startswith(b"%PDF-1.4")
    assert b"/PrintScaling /None" in data
    assert board.spec.encode() in data
    _, width, height = page_for(board, page)
    box = [float(v) for v in re.search(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data).groups()]  # type: ignore[union-attr]
    assert np.allclose(box, np.array([width, height]) * POINTS_PER_MM, atol=1e-3)
    filled = data.split(b"0 g\n")[1].split(b"\nf\n")
    black, ruler = (np.array([[float(v) for v in line.split()[:4]] for line in part.split(b"\n")]) for part in filled[:2])
    x0, _, x1, _ = board.extent_m
    sizes = 1000 * (board.rectangles_m[:, 2:] - board.rectangles_m[:, :2])
    assert np.allclose(black[:, 2:], sizes, atol=1e-3)
    assert np.ptp(np.concatenate([black[:, 0], black[:, 0] + black[:, 2]])) == pytest.approx(1000 * (x1 - x0), abs=1e-3)
    assert ruler[0, 2] == 100
    for part in (black, ruler):
        assert part[:, :2].min() >= 4
        assert (part[:, 0] + part[:, 2]).max() <= width - 4
        assert (part[:, 1] + part[:, 3]).max() <= height - 4
    # The table of places points at the objects.
    places = re.findall(rb"(\d{10}) 00000 n", data)
    assert all(data[int(p) :].startswith(b"%d 0 obj" % n) for n, p in enumerate(places, 1))


def test_a_page_too_small_names_the_one_that_would_do() -> None:
    with pytest.raises(ShotError, match="take page A2"):
        board_pdf(parse_board("chessboard:9x6:0.04"), "A4")
    with pytest.raises(ShotError, match="exact"):
        board_pdf(parse_board("chessboard:9x6:0.5"))
    with pytest.raises(ShotError, match="did you mean 'letter'"):
        board_pdf(parse_board("chessboard:9x6:0.02"), "leter")
    assert page_for(parse_board("chessboard:9x6:0.02"))[0] == "A4"
    assert set(PAGES_MM) >= {"A4", "A3", "A2", "A1", "A0", "letter"}
