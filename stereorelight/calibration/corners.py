"""Find a board's corners in one picture.

In: a picture as shot, (H, W) or (H, W, 3), uint8, uint16 or float 0..1, encoded (not scene-linear), and a `Board`.
Out: a `Detection`: ids (rows of board.points_m) and pixels of the picture as given, (0, 0) the centre of the top-left pixel.
Chessboards by the sector-based detector (Duda and Frese 2018), ChArUco and AprilGrid by their markers; every corner is then
fitted to the picture itself (refine_corners.py).  Large pictures are searched small and fitted at full size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, UInt8
from stereorelight.calibration.board import APRILGRID_BORDER_BITS, Board, dictionary
from stereorelight.calibration.refine_corners import Refined, bright_quadrants, grid_map, local_shapes, refine_corners
from stereorelight.errors import PlateError

SEARCH_SIDE_PX = 1280  # boards are searched for in a picture no longer than this, then at full size
SEARCH_FULL_PX = 2600
FEWEST_CORNERS = 6
DETECTOR_SIGMA_PX = 0.15  # a corner that no fit took up
SIGMA_FLOOR_PX = 0.006  # what the model's own shape is off on a perfect picture
FEWEST_TO_GROW, GROWTH_ROUNDS = 8, 4
GROWN_PX, GROWN_SHARE = 1.0, 0.05  # a corner that no marker names must lie so near its place on the grid, pixels or squares
GROWN_SIGMA = 3.0  # and be as well seen as its neighbours, within this factor
HOMOGRAPHY_SHARE = 0.25  # of a square: markers further off their board's plane belong to another one


@dataclass(frozen=True, kw_only=True, eq=False)
class Detection:
    """A board as one eye saw it.

    ids        : (n,) int, rows of board.points_m.  px: (n, 2) float64, pixels of the picture as given.
    sigma_px   : (n,) one sigma of a corner along one axis; refined: (n,) whether the fit to the picture settled.
    blur_px    : sigma of the picture's blur along and across its longest direction; motion_px: movement during the exposure.
    sharpness  : 1 for a pixel-sharp picture, towards 0 for a blurred one.  contrast: white less black, 8-bit levels.
    size       : (width, height).  mirrored: the board was found in the flipped picture: this eye (or the print) is mirrored.
    """

    ids: npt.NDArray[np.int64]
    px: Float64
    sigma_px: Float64
    refined: Bool
    blur_px: tuple[float, float]
    motion_px: tuple[float, float]
    sharpness: float
    contrast: float
    size: tuple[int, int]
    mirrored: bool = False

    def __len__(self) -> int:
        return len(self.ids)

    def where(self, keep: Bool) -> Detection:
        """Only the corners for which `keep` (n,) is true."""
        return replace(self, ids=self.ids[keep], px=self.px[keep], sigma_px=self.sigma_px[keep], refined=self.refined[keep])

    def flipped(self) -> Detection:
        """The same corners in the picture flipped left-right."""
        px = np.stack([self.size[0] - 1 - self.px[:, 0], self.px[:, 1]], axis=-1)
        return replace(self, px=px, motion_px=(-self.motion_px[0], self.motion_px[1]), mirrored=not self.mirrored)


def grey_levels(picture: npt.ArrayLike) -> Float32:
    """(H, W) float32 in 8-bit levels of any encoded picture; float pictures count 1.0 as white.  Raises PlateError for anything else."""
    a = np.asarray(picture)
    if a.ndim == 3 and a.shape[2] in (3, 4):
        # The same weights for RGB and BGR; green, which every sensor samples best, weighs most.
        wide = a[..., :3].astype(np.float32)
        a_grey = 0.25 * wide[..., 0] + 0.5 * wide[..., 1] + 0.25 * wide[..., 2]
    elif a.ndim == 2:
        a_grey = a.astype(np.float32)
    else:
        raise PlateError(f"a board picture must be (H, W) or (H, W, 3), got {a.shape}")
    if min(a_grey.shape) < 32:
        raise PlateError(f"a board picture must have at least 32x32 pixels, got {a_grey.shape[1]}x{a_grey.shape[0]}")
    if a.dtype == np.uint16:
        a_grey = a_grey / 257
    elif np.issubdtype(a.dtype, np.floating):
        a_grey = np.nan_to_num(a_grey, nan=0.0, posinf=1.0, neginf=0.0) * 255
    elif a.dtype != np.uint8:
        raise PlateError(f"a board picture must be uint8, uint16 or float, got {a.dtype}")
    return np.ascontiguousarray(a_grey, dtype=np.float32)


def detect(picture: npt.ArrayLike, board: Board, *, thorough: bool = True, try_mirrored: bool = True) -> Detection | None:
    """The board's corners in `picture`, or None where it is not seen.

    thorough     : try hard (contrast, blur, other sizes) before giving up; off for the many frames of a movie.
    try_mirrored : search the flipped picture too where a board with markers is not seen; a plain chessboard looks the same in both
                   (views.mirrored_eye tells from the pair).
    Raises       : PlateError for an array that is no picture.
    """
    grey = grey_levels(picture)
    found = _found(grey, board, thorough=thorough)
    if found is not None:
        return _refined(grey, board, *found)
    if try_mirrored and board.kind != "chessboard":
        flipped = np.ascontiguousarray(grey[:, ::-1])
        found = _found(flipped, board, thorough=False)
        if found is not None:
            return _refined(flipped, board, *found).flipped()
    return None


def second_board(picture: npt.ArrayLike, board: Board, first: Detection) -> bool:
    """Whether another such board is in the picture besides `first`."""
    import cv2

    grey = grey_levels(picture)
    hull = grid_map(board.points_m[first.ids, :2], first.px, _outline(board))
    hull = first.px if not np.isfinite(hull).all() else hull
    rest = grey.copy()
    cv2.fillConvexPoly(rest, cv2.convexHull(np.rint(hull).astype(np.int32)), float(np.median(grey)))
    return _found(np.ascontiguousarray(rest[:, ::-1]) if first.mirrored else rest, board, thorough=False) is not None


def larger_grid(picture: npt.ArrayLike, board: Board) -> tuple[int, int] | None:
    """(columns, rows) of a chessboard in sight that has more corners than `board` says, or None.

    A smaller count is found inside the true board; the growing search that finds the whole of it may stop early, so only more
    corners than told are believed.
    """
    seen = _grid_seen(next(_searches(grey_levels(picture), thorough=False))[0])
    told = sorted((board.columns, board.rows))
    if seen is None or sorted(seen) == told or any(a < b for a, b in zip(sorted(seen), told)):
        return None
    return seen


def what_else(picture: npt.ArrayLike, board: Board) -> str:
    """Why `board` was not found, in words: another count of corners, other markers, or "" where nothing like a board is seen."""
    grey = grey_levels(picture)
    search = next(_searches(grey, thorough=False))[0]
    seen = _grid_seen(search)
    if board.kind == "chessboard":
        if seen is not None and sorted(seen) != sorted((board.columns, board.rows)):
            wanted = f"{board.columns}x{board.rows}"
            return f"a chessboard of {seen[0]}x{seen[1]} inner corners is seen, not {wanted}; count the corners where four squares meet"
        return ""
    for flip in (False, True):
        image = np.ascontiguousarray(search[:, ::-1]) if flip else search
        for name in dict.fromkeys([str(board.dictionary), *_dictionaries()]):
            for border in (1, APRILGRID_BORDER_BITS):
                _, ids, _ = _marker_detector(name, border).detectMarkers(image)
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


def turns(board: Board) -> int:
    """In how many ways the board looks the same when turned in its plane: 1 where each corner can be told."""
    if board.kind != "chessboard":
        return 1
    if (board.columns + board.rows) % 2:
        return 1
    if board.columns == board.rows and board.columns % 2 == 0:
        return 4
    return 2


def turned(detection: Detection, board: Board, quarter_turns: int) -> Detection:
    """The same corners under the ids of the chessboard turned in its plane by `quarter_turns` (2, or 1 and 3 on a square one)."""
    nx, ny = board.grid
    order = np.rot90(np.arange(nx * ny).reshape(ny, nx), quarter_turns).ravel()
    name = np.empty_like(order)
    name[order] = np.arange(nx * ny)
    ids = name[detection.ids]
    rank = np.argsort(ids)
    return replace(detection, ids=ids[rank], px=detection.px[rank], sigma_px=detection.sigma_px[rank], refined=detection.refined[rank])


def _refined(grey: Float32, board: Board, ids: npt.NDArray[np.int64], px: Float64) -> Detection:
    fit = refine_corners(grey, board, ids, px)
    if board.kind != "chessboard":
        return _grown(grey, board, ids, fit)
    if board.kind == "chessboard":
        nx, _ = board.grid
        dark_first = -float(np.sum(fit.bright_first * np.where((ids % nx + ids // nx) % 2, -1, 1)))
        can_turn = 2 if (board.columns + board.rows) % 2 else 1 if turns(board) == 2 and board.columns == board.rows else 0
        if dark_first < 0 and can_turn:  # the square before the first corner is black
            swap = _detection(grey, ids, fit)
            return _upright(turned(swap, board, can_turn), board)
    return _upright(_detection(grey, ids, fit), board)


def _grown(grey: Float32, board: Board, ids: npt.NDArray[np.int64], fit: Refined) -> Detection:
    """Corners whose markers were not read, next to those that were: the grid says where, the picture whether they are there.

    Only fitted corners stay: a marker's own are pixels off, worth nothing beside them."""
    for _ in range(GROWTH_ROUNDS):
        keep = fit.refined & (fit.bright_first == bright_quadrants(board, ids))
        if keep.sum() < FEWEST_TO_GROW:
            break
        had, px, sigma = ids[keep], fit.px[keep], fit.sigma_px[keep]
        missing = np.setdiff1d(np.arange(len(board.points_m)), had)
        apart = np.linalg.norm(board.points_m[missing, None, :2] - board.points_m[None, had, :2], axis=2)
        missing = missing[apart.min(axis=1, initial=np.inf) < 1.5 * board.square_m] if len(missing) else missing
        there = grid_map(board.points_m[had, :2], px, board.points_m[missing, :2])
        inside = ((there > 3) & (there < np.array([grey.shape[1], grey.shape[0]]) - 4)).all(axis=1)
        missing, there = missing[inside], there[inside]
        if not len(missing):
            break
        every = np.concatenate([had, missing])
        order = np.argsort(every)
        wider = refine_corners(grey, board, every[order], np.concatenate([px, there])[order])
        pitch = math.sqrt(float(np.median(np.abs(np.linalg.det(np.linalg.inv(local_shapes(board, had, px)[0]))))))
        new = np.isin(every[order], missing)
        off = np.linalg.norm(wider.px - np.concatenate([px, there])[order], axis=1)
        right_sign = wider.bright_first == bright_quadrants(board, every[order])
        sure = wider.refined & right_sign & (wider.sigma_px < GROWN_SIGMA * float(np.median(sigma)) + SIGMA_FLOOR_PX)
        good = np.where(new, sure & (off < max(GROWN_PX, GROWN_SHARE * pitch)), wider.refined & right_sign)
        gained = int((good & new).sum())
        ids, fit = every[order], replace(wider, refined=good)
        if not gained:
            break
    keep = fit.refined & (fit.bright_first == bright_quadrants(board, ids))
    return _detection(grey, ids, fit).where(keep if keep.sum() >= FEWEST_CORNERS else np.ones(len(ids), bool))


def _detection(grey: Float32, ids: npt.NDArray[np.int64], fit: Refined) -> Detection:
    sigma = np.where(fit.refined, np.hypot(np.nan_to_num(fit.sigma_px), SIGMA_FLOOR_PX), DETECTOR_SIGMA_PX)
    blur = fit.blur_px if math.isfinite(fit.blur_px[0]) else (math.nan, math.nan)
    sharp = 0.5 / max(blur[0], 0.5) if math.isfinite(blur[0]) else 0.0
    size = (grey.shape[1], grey.shape[0])
    return Detection(
        ids=ids,
        px=fit.px,
        sigma_px=sigma,
        refined=fit.refined,
        blur_px=blur,
        motion_px=fit.motion_px,
        sharpness=sharp,
        contrast=fit.contrast,
        size=size,
    )


def _upright(detection: Detection, board: Board) -> Detection:
    """Of the turns that look the same, the one whose rows run most nearly to the right."""
    if turns(board) == 1:
        return detection
    step = 4 // turns(board)
    return max((turned(detection, board, k) for k in range(0, 4, step)), key=lambda d: float(np.cos(row_angle(d, board))))


def row_angle(detection: Detection, board: Board) -> float:
    """Radians by which the board's rows are turned in the picture, clockwise."""
    xy = board.points_m[detection.ids, :2]
    slope, *_ = np.linalg.lstsq(np.concatenate([xy, np.ones((len(xy), 1))], axis=1), detection.px, rcond=None)
    return math.atan2(slope[0, 1], slope[0, 0])


def _searches(grey: Float32, *, thorough: bool) -> Iterator[tuple[UInt8, float]]:
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


def _found(grey: Float32, board: Board, *, thorough: bool) -> tuple[npt.NDArray[np.int64], Float64] | None:
    search_one = {"chessboard": _chessboard, "charuco": _charuco, "aprilgrid": _aprilgrid}[board.kind]
    best: tuple[npt.NDArray[np.int64], Float64] | None = None
    for number, (image, scale) in enumerate(_searches(grey, thorough=thorough)):
        found = search_one(image, board, hard=thorough and number > 0)
        if found is None or len(found[0]) < FEWEST_CORNERS:
            continue
        ids, px = found
        if best is None or len(ids) > len(best[0]):
            best = ids, (px + 0.5) / scale - 0.5
        if len(best[0]) >= 0.7 * len(board.points_m):
            break
    return best


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


def _marker_detector(name: str, border: int) -> Any:
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    parameters.minMarkerPerimeterRate = 0.01
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    return cv2.aruco.ArucoDetector(dictionary(name), parameters)


def _aprilgrid(image: UInt8, board: Board, *, hard: bool) -> tuple[npt.NDArray[np.int64], Float64] | None:
    import cv2

    corners, ids, _ = _marker_detector(str(board.dictionary), APRILGRID_BORDER_BITS).detectMarkers(image)
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


def _outline(board: Board) -> Float64:
    x0, y0, x1, y1 = board.extent_m
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _dictionaries() -> list[str]:
    return ["DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_APRILTAG_36h11", "DICT_ARUCO_ORIGINAL"]


def _grid_seen(image: UInt8) -> tuple[int, int] | None:
    """(columns, rows) of the largest plain grid of corners in sight."""
    import cv2

    for start in ((4, 3), (3, 3)):
        ok, _, meta = cv2.findChessboardCornersSBWithMeta(image, start, cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE)
        if ok and meta is not None:
            rows, columns = meta.shape[:2]
            return (columns, rows) if columns >= rows else (rows, columns)
    return None
