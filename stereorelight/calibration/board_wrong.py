"""What is wrong with a board in a picture, in words: another count, other markers, other sizes, a second board.

In: a picture as shot and the `Board` that was told.  Out: words for an error, "" or None where nothing is wrong."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64, UInt8
from stereorelight.calibration.board import APRILGRID_BORDER_BITS, Board
from stereorelight.calibration.board_search import FEWEST_CORNERS, found_corners, marker_detector, searches
from stereorelight.calibration.corners import Detection, grey_levels
from stereorelight.calibration.refine_corners import grid_map

CREDIBLE_SIDE = 4  # corners: grids of three rows are found in mere noise


def second_board(picture: npt.ArrayLike, board: Board, first: Detection) -> bool:
    """Whether another such board is in the picture besides `first`."""
    import cv2

    grey = grey_levels(picture)
    hull = grid_map(board.points_m[first.ids, :2], first.px, _outline(board))
    hull = first.px if not np.isfinite(hull).all() else hull
    rest = grey.copy()
    cv2.fillConvexPoly(rest, cv2.convexHull(np.rint(hull).astype(np.int32)), float(np.median(grey)))
    return found_corners(np.ascontiguousarray(rest[:, ::-1]) if first.mirrored else rest, board, thorough=False) is not None


def larger_grid(picture: npt.ArrayLike, board: Board) -> tuple[int, int] | None:
    """(columns, rows) of a chessboard in sight that has more corners than `board` says, or None.

    A smaller count is found inside the true board; the growing search that finds the whole of it may stop early, so only more
    corners than told are believed.
    """
    seen = _grid_seen(next(searches(grey_levels(picture), thorough=False))[0])
    told = sorted((board.columns, board.rows))
    if seen is None or sorted(seen) == told or any(a < b for a, b in zip(sorted(seen), told)):
        return None
    return seen


def what_else(picture: npt.ArrayLike, board: Board) -> str:
    """Why `board` was not found, in words: another count of corners, other markers, or "" where nothing like a board is seen."""
    grey = grey_levels(picture)
    search = next(searches(grey, thorough=False))[0]
    seen = _grid_seen(search)
    if board.kind == "chessboard":
        for name in _dictionaries():
            _, ids, _ = marker_detector(name, 1).detectMarkers(search)
            if ids is not None and len(ids) >= 4:
                return f"{len(ids)} markers of {name} are seen: this is a ChArUco board; give its own spec, it is printed below the board"
        if seen is not None and sorted(seen) != sorted((board.columns, board.rows)):
            wanted = f"{board.columns}x{board.rows}"
            return f"a chessboard of {seen[0]}x{seen[1]} inner corners is seen, not {wanted}; count the corners where four squares meet"
        return ""
    for flip in (False, True):
        image = np.ascontiguousarray(search[:, ::-1]) if flip else search
        for name in dict.fromkeys([str(board.dictionary), *_dictionaries()]):
            for border in (1, APRILGRID_BORDER_BITS):
                _, ids, _ = marker_detector(name, border).detectMarkers(image)
                if ids is None or len(ids) < 4:
                    continue
                most = int(np.max(ids))
                where = "in the flipped picture: this eye or the print is mirrored; " if flip else ""
                if name != board.dictionary:
                    return f"{len(ids)} markers of {name} are seen {where}not of {board.dictionary}"
                if most >= board.markers:
                    wanted = f"{board.columns}x{board.rows}"
                    return f"{where}marker {most} is seen, this board has only 0 to {board.markers - 1}: its rows and columns are not {wanted}"
                if border != (APRILGRID_BORDER_BITS if board.kind == "aprilgrid" else 1):
                    return f"{len(ids)} markers with a border of {border} bits are seen: this is another kind of board than {board.kind}"
                return f"{where}{len(ids)} of its markers are seen, but no {FEWEST_CORNERS} corners between them: rows, columns or sizes differ"
    if seen is not None:
        return f"a plain chessboard of {seen[0]}x{seen[1]} inner corners is seen, without {board.kind} markers"
    return ""


def marker_share(picture: npt.ArrayLike, board: Board, first: Detection) -> float | None:
    """Side of a ChArUco's markers as a share of their squares', as seen; None where fewer than four markers are."""
    import cv2

    if board.kind != "charuco":
        return None
    grey = grey_levels(picture)
    search, scale = next(searches(np.ascontiguousarray(grey[:, ::-1]) if first.mirrored else grey, thorough=False))
    corners, ids, _ = marker_detector(str(board.dictionary), 1).detectMarkers(search)
    if ids is None or len(ids) < 4:
        return None
    seen = first.flipped() if first.mirrored else first
    H, _ = cv2.findHomography(seen.px, board.points_m[seen.ids, :2], 0)
    if H is None:
        return None
    px = (np.asarray(corners, np.float64).reshape(-1, 4, 2) + 0.5) / scale - 0.5
    at = cv2.perspectiveTransform(px, H)
    return float(np.median(np.linalg.norm(at - np.roll(at, 1, axis=1), axis=-1))) / board.square_m


def _outline(board: Board) -> Float64:
    x0, y0, x1, y1 = board.extent_m
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _dictionaries() -> list[str]:
    return ["DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_APRILTAG_36h11", "DICT_ARUCO_ORIGINAL"]


def _grid_seen(image: UInt8) -> tuple[int, int] | None:
    """(columns, rows) of the largest plain grid of corners in sight."""
    import cv2

    ok, _, meta = cv2.findChessboardCornersSBWithMeta(image, (4, 3), cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE)
    if not ok or meta is None:
        return None
    rows, columns = meta.shape[:2]
    if min(rows, columns) < CREDIBLE_SIDE:
        return None
    return (columns, rows) if columns >= rows else (rows, columns)
