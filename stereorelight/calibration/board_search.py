"""Where a board roughly is in a picture: detectors of its corners, before any is fitted.

In: (H, W) float32 in 8-bit levels and a `Board`.  Out: ids (rows of board.points_m) and pixels of the picture as given.
Chessboards by the sector-based detector (Duda and Frese 2018), ChArUco and AprilGrid by their markers.  Large pictures are
searched small."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, UInt8
from stereorelight.calibration.board import APRILGRID_BORDER_BITS, Board, dictionary

SEARCH_SIDE_PX = 1280  # boards are searched for in a picture no longer than this, then at full size
SEARCH_FULL_PX = 2600
FEWEST_CORNERS = 6
HOMOGRAPHY_SHARE = 0.25  # of a square: markers further off their board's plane belong to another one


def found_corners(grey: Float32, board: Board, *, thorough: bool) -> tuple[npt.NDArray[np.int64], Float64] | None:
    search_one = {"chessboard": _chessboard, "charuco": _charuco, "aprilgrid": _aprilgrid}[board.kind]
    best: tuple[npt.NDArray[np.int64], Float64] | None = None
    for number, (image, scale) in enumerate(searches(grey, thorough=thorough)):
        found = search_one(image, board, hard=thorough and number > 0)
        if found is None or len(found[0]) < FEWEST_CORNERS:
            continue
        ids, px = found
        if best is None or len(ids) > len(best[0]):
            best = ids, (px + 0.5) / scale - 0.5
        if len(best[0]) >= 0.7 * len(board.points_m):
            break
    return best


def searches(grey: Float32, *, thorough: bool) -> Iterator[tuple[UInt8, float]]:
    """Pictures to search and how many of their pixels make one of `grey`; the likeliest first."""
    import cv2

    long_side = max(grey.shape)
    small = min(1.0, SEARCH_SIDE_PX / long_side)

    def sized(scale: float) -> Float32:
        if scale == 1:
            return grey
        size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
        return cv2.resize(grey, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)

    first = sized(small)
    yield _stretched(first), small
    if not thorough:
        return
    yield _local_contrast(first), small
    if long_side <= SEARCH_FULL_PX and small < 1:
        yield _stretched(grey), 1.0
    if long_side < 900:
        yield _stretched(sized(2.0)), 2.0
    yield _stretched(cv2.GaussianBlur(sized(small / 2), (0, 0), 1.0)), small / 2


def _stretched(grey: Float32) -> UInt8:
    """8 bits over the range that the picture uses."""
    low, high = np.percentile(grey[::4, ::4], (0.5, 99.5))
    scale = 255 / max(float(high - low), 16.0)
    out: UInt8 = np.clip((grey - low) * scale, 0, 255).astype(np.uint8)
    return out


def _local_contrast(grey: Float32) -> UInt8:
    import cv2

    calm = cv2.GaussianBlur(grey, (0, 0), 1.2)
    mean = cv2.boxFilter(calm, -1, (61, 61))
    spread = np.sqrt(np.maximum(cv2.boxFilter(calm * calm, -1, (61, 61)) - mean * mean, 4.0))
    out: UInt8 = np.clip(128 + 60 * (calm - mean) / spread, 0, 255).astype(np.uint8)
    return out


def _chessboard(image: UInt8, board: Board, *, hard: bool) -> tuple[npt.NDArray[np.int64], Float64] | None:
    import cv2

    pattern = (board.columns, board.rows)
    flags = (cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE) if hard else 0
    ok, corners = cv2.findChessboardCornersSB(image, pattern, flags=flags | cv2.CALIB_CB_ACCURACY)
    if not ok and hard:
        ok, corners = cv2.findChessboardCorners(
            image, pattern, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        )
    if not ok or corners is None or len(corners) != board.columns * board.rows:
        return None
    grid = corners.reshape(board.rows, board.columns, 2).astype(np.float64)
    across, down = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    if across[0] * down[1] - across[1] * down[0] < 0:  # seen from the front, x right and y down stay so
        grid = grid[:, ::-1]
    return np.arange(board.columns * board.rows), grid.reshape(-1, 2)


def _charuco(image: UInt8, board: Board, *, hard: bool) -> tuple[npt.NDArray[np.int64], Float64] | None:
    import cv2

    layout = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary(str(board.dictionary)))
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 0.01
    if hard:
        parameters.adaptiveThreshWinSizeMax, parameters.adaptiveThreshConstant = 45, 3
    corners, ids, _, _ = cv2.aruco.CharucoDetector(layout, cv2.aruco.CharucoParameters(), parameters).detectBoard(image)
    if ids is None or len(ids) < 4:
        return None
    named, px = np.asarray(ids).ravel().astype(np.int64), np.asarray(corners, np.float64).reshape(-1, 2)
    order = np.argsort(named)
    return _on_plane(board, named[order], px[order])


def marker_detector(name: str, border: int) -> Any:
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    parameters.minMarkerPerimeterRate = 0.01
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    return cv2.aruco.ArucoDetector(dictionary(name), parameters)


def _aprilgrid(image: UInt8, board: Board, *, hard: bool) -> tuple[npt.NDArray[np.int64], Float64] | None:
    import cv2

    corners, ids, _ = marker_detector(str(board.dictionary), APRILGRID_BORDER_BITS).detectMarkers(image)
    if ids is None or len(ids) < 2:
        return None
    tags, quads = np.asarray(ids).ravel(), np.asarray(corners, np.float64).reshape(-1, 4, 2)
    known = tags < board.markers
    tags, quads = tags[known], quads[known]
    if len(tags) < 2:
        return None
    # Prints differ in which way up a tag stands: the one that makes all tags lie on one plane is this print's.
    best: tuple[float, npt.NDArray[np.int64], Float64] | None = None
    for shift in (2, 0, 1, 3):
        px = np.roll(quads, -shift, axis=1).reshape(-1, 2)
        named = (4 * tags[:, None] + np.arange(4)).ravel().astype(np.int64)
        H, _ = cv2.findHomography(board.points_m[named, :2], px, cv2.LMEDS)
        if H is None:
            continue
        off = float(np.median(_off_plane(H, board, named, px)))
        if best is None or off < 0.5 * best[0]:
            best = off, named, px
    if best is None:
        return None
    order = np.argsort(best[1])
    return _on_plane(board, best[1][order], best[2][order])


def _off_plane(H: Float64, board: Board, ids: npt.NDArray[np.int64], px: Float64) -> Float64:
    q = np.concatenate([board.points_m[ids, :2], np.ones((len(ids), 1))], axis=1) @ H.T
    off: Float64 = np.linalg.norm(q[:, :2] / q[:, 2:] - px, axis=1)
    return off


def _on_plane(board: Board, ids: npt.NDArray[np.int64], px: Float64) -> tuple[npt.NDArray[np.int64], Float64] | None:
    """Without what cannot lie on the same board; None where too little is left or it is seen from behind."""
    import cv2

    if len(ids) < FEWEST_CORNERS:
        return None
    xy = board.points_m[ids, :2]
    H, _ = cv2.findHomography(xy, px, cv2.LMEDS)
    if H is None or np.linalg.det(H) <= 0:
        return None
    pitch = math.sqrt(abs(float(np.linalg.det(np.cov(px.T)) / max(np.linalg.det(np.cov(xy.T)), 1e-18))) ** 0.5) * board.square_m
    keep = _off_plane(H, board, ids, px) < HOMOGRAPHY_SHARE * pitch
    if keep.sum() < FEWEST_CORNERS or np.linalg.matrix_rank(xy[keep] - xy[keep].mean(axis=0), tol=1e-9) < 2:
        return None
    return ids[keep], px[keep]
