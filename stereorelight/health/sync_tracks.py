"""Points followed through time in the left eye, and found again in the right eye at each frame.

In: successive rectified scene-linear plates (H, W, 3) of both eyes.  Out: `Tracks` on the working picture (at most
`WORK_WIDTH` wide): pixels (0, 0) at the centre of its top-left pixel, x right, y down, NaN where a point was lost.
Following is pyramidal Lucas-Kanade there and back (OpenCV's); what does not come home is dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, Float64, UInt8

WORK_WIDTH = 960  # a sub-pixel of this picture is what grain leaves of a sub-pixel of a larger one
POINTS = 700
CELLS = (12, 7)  # points are spread: no cell of this grid takes more than its share
WINDOW = (17, 17)
CONTRAST_SIGMA = 0.02  # of the width: light and colour that differ between the eyes are taken out at this scale
GREY_FLOOR = 0.012  # of the square root of light: contrast below it is grain and is not blown up
ROUND = 0.4  # lesser over greater eigenvalue of the gradients in the window
HOME_PX = 0.3  # a point that comes back farther from where it started was lost
HOME_EYE_PX = 0.5
MOVED = 0.5  # share of the points that is looked for where the picture changes
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """(n, F) positions of n points over F successive frames: left (x, y) and right (x_right, y_right), NaN where unknown.

    shift  : the right pictures are those of `shift` frames later by number.
    size   : (width, height) of the working picture.
    """

    x: Float64
    y: Float64
    x_right: Float64
    y_right: Float64
    shift: int
    size: tuple[int, int]


def tone(plate: Float32) -> Float32:
    """The square root of light of a plate (H, W, 3), at most `WORK_WIDTH` wide; 0 where it is unknown or below black."""
    height, width = plate.shape[:2]
    scale = min(1.0, WORK_WIDTH / width)
    grey = np.nan_to_num(plate @ np.array([0.25, 0.5, 0.25], np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    if scale < 1:
        grey = cv2.resize(grey, (round(width * scale), max(16, round(height * scale))), interpolation=cv2.INTER_AREA)
    return np.sqrt(np.maximum(grey, 0), dtype=np.float32)


def texture(toned: Float32) -> UInt8:
    """8-bit local contrast of a toned picture: what both eyes see alike whatever their exposure."""
    sigma = max(4.0, CONTRAST_SIGMA * toned.shape[1])
    mean = cv2.GaussianBlur(toned, (0, 0), sigma)
    detail = toned - mean
    spread = np.sqrt(cv2.GaussianBlur(detail * detail, (0, 0), sigma)) + GREY_FLOOR * max(float(np.median(toned)), 0.05)
    return np.rint(np.clip(128 + 45 * detail / spread, 0, 255)).astype(np.uint8)


def _points(picture: UInt8, others: Sequence[UInt8]) -> Float32:
    """Well-marked points (n, 2), spread over the frame, a good part of them where other moments differ from this one."""
    h, w = picture.shape
    change = cv2.GaussianBlur(np.sum([cv2.absdiff(picture, other) for other in others], axis=0, dtype=np.float32), (0, 0), 5)
    moves = change > np.median(change) * 1.5
    # A point on a slanted line slides along it, by time and by eye alike, which looks just like an offset: only round corners count.
    values = cv2.cornerEigenValsAndVecs(picture, WINDOW[0], 3)[..., :2]
    round_ = values.min(axis=2) > ROUND * values.max(axis=2)
    found: list[Float32] = []
    edge = WINDOW[0] // 2 + 2
    frame = np.zeros((h, w), np.uint8)
    frame[edge : h - edge, edge : w - edge] = 255
    for mask, count in ((frame, POINTS * (1 - MOVED)), (np.where(moves, frame, np.uint8(0)), POINTS * MOVED)):
        corners = cv2.goodFeaturesToTrack(picture, 3 * POINTS, 0.005, 4, mask=mask, blockSize=5)
        if corners is None:
            continue
        corners = corners.reshape(-1, 2)
        corners = corners[round_[corners[:, 1].astype(int), corners[:, 0].astype(int)]]
        cell = (corners[:, 0] * CELLS[0] / w).astype(int) + CELLS[0] * (corners[:, 1] * CELLS[1] / h).astype(int)
        order = np.argsort(cell, kind="stable")
        _, first, counts = np.unique(cell[order], return_index=True, return_counts=True)
        rank = np.empty(len(cell), int)
        rank[order] = np.arange(len(cell)) - np.repeat(first, counts)
        found.append(corners[np.argsort(rank, kind="stable")[: int(count)]])
    if not found:
        return np.empty((0, 2), np.float32)
    return np.unique(np.concatenate(found), axis=0)


def _follow(a: UInt8, b: UInt8, points: Float32, guess: Float32, levels: int, home_px: float) -> tuple[Float32, Bool]:
    """Where `points` of picture a are in b, and whether they come home again."""
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    there, seen, _ = cv2.calcOpticalFlowPyrLK(a, b, points, guess.copy(), winSize=WINDOW, maxLevel=levels, criteria=CRITERIA, flags=flags)
    start = there + (points - guess)
    back, seen_back, _ = cv2.calcOpticalFlowPyrLK(b, a, there, start, winSize=WINDOW, maxLevel=levels, criteria=CRITERIA, flags=flags)
    h, w = b.shape
    inside = (there >= 4).all(axis=1) & (there[:, 0] <= w - 5) & (there[:, 1] <= h - 5)
    home = np.abs(back - points).max(axis=1) <= home_px
    return there, seen.ravel().astype(bool) & seen_back.ravel().astype(bool) & inside & home


def follow(left: Sequence[UInt8], right: Sequence[UInt8], *, shift: int = 0) -> Tracks:
    """Tracks through a run of textures; right[i] is looked at together with left[i], whatever its number.

    They begin in the middle and go both ways: what a point slides over its surface grows with time.
    """
    count = min(len(left), len(right))
    h, w = left[0].shape
    middle = count // 2
    begun = _points(left[middle], (left[0], left[min(middle + 1, count - 1)], left[count - 1]))
    out = np.full((4, len(begun), count), np.nan)
    if len(begun) == 0:
        return Tracks(x=out[0], y=out[1], x_right=out[2], y_right=out[3], shift=shift, size=(w, h))
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    across = dis.calc(left[middle], right[middle], None)
    column, row = begun[:, 0].astype(int), begun[:, 1].astype(int)
    for way in (1, -1):
        points, apart, alive = begun, across[row, column], np.ones(len(begun), bool)
        speed = np.zeros_like(points)
        for t in range(middle, count if way > 0 else -1, way):
            if t != middle:
                at, kept = _follow(left[t - way], left[t], points, points + speed, 3, HOME_PX)
                alive = alive & kept
                speed, points = np.where(alive[:, None], at - points, 0), np.where(alive[:, None], at, points)
            elif way < 0:
                apart = np.where(np.isfinite(out[2:4, :, t].T), out[2:4, :, t].T - points, apart).astype(np.float32)
                continue
            seen, matched = _follow(left[t], right[t], points, points + apart, 1, HOME_EYE_PX)
            matched &= alive
            apart = np.where(matched[:, None], seen - points, apart)
            out[0:2, alive, t] = points[alive].T
            out[2:4, matched, t] = seen[matched].T
    return Tracks(x=out[0], y=out[1], x_right=out[2], y_right=out[3], shift=shift, size=(w, h))
