"""Find a board's corners in one picture.

In: a picture as shot, (H, W) or (H, W, 3), uint8, uint16 or float 0..1, encoded (not scene-linear), and a `Board`.
Out: a `Detection`: ids (rows of board.points_m) and pixels of the picture as given, (0, 0) the centre of the top-left pixel.
The board is searched for (board_search.py), and every corner is then fitted to the picture itself (refine_corners.py); corners
whose markers were not read are found by the grid of the others."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.calibration.board import Board
from stereorelight.calibration.board_search import FEWEST_CORNERS, found_corners
from stereorelight.calibration.refine_corners import Refined, bright_quadrants, grid_map, local_shapes, refine_corners
from stereorelight.errors import PlateError

DETECTOR_SIGMA_PX = 0.15  # a corner that no fit took up
SIGMA_FLOOR_PX = 0.006  # what the model's own shape is off on a perfect picture
FEWEST_TO_GROW, GROWTH_ROUNDS = 8, 4
GROWN_PX, GROWN_SHARE = 1.0, 0.05  # a corner that no marker names must lie so near its place on the grid, pixels or squares
GROWN_SIGMA = 3.0  # and be as well seen as its neighbours, within this factor


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
    found = found_corners(grey, board, thorough=thorough)
    if found is not None:
        return _refined(grey, board, *found)
    if try_mirrored and board.kind != "chessboard":
        flipped = np.ascontiguousarray(grey[:, ::-1])
        found = found_corners(flipped, board, thorough=False)
        if found is not None:
            return _refined(flipped, board, *found).flipped()
    return None


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
