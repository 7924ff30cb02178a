"""Which views of a board to calibrate from, and whether the two eyes' views belong together.

In: `Detection`s of each eye by frame number.  Out: pairs, chosen frames, measures of spread and tilt, and what is wrong in words.
Pixels of the pictures as given; angles in degrees.  Whether two eyes fit is asked of the epipolar geometry of all their corners
(eight points, Hartley 1997): no camera has to be known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.calibration.board import Board
from stereorelight.calibration.corners import Detection, row_angle, turned, turns
from stereorelight.errors import PlateError

COVERAGE_CELLS = (8, 6)
NOMINAL_FOCAL = 1.2  # of the picture's long side: tilts come out within a tenth for common lenses
NEAR_MIRROR = 0.5  # a reading of the eyes must leave this much less epipolar error than the other to be believed
LEAST_MIRROR_PX = 0.5  # and the worse one at least this
FEWEST_TOGETHER = 3


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Where a board stands in a picture: middle and size as shares of the frame, tilt about two axes and roll, degrees."""

    x: float
    y: float
    scale: float
    tilt_x_deg: float
    tilt_y_deg: float
    roll_deg: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the board's normal and the line of sight's axis."""
        return math.degrees(math.acos(min(1.0, math.cos(math.radians(self.tilt_x_deg)) * math.cos(math.radians(self.tilt_y_deg)))))


def board_pose(detection: Detection, board: Board, *, focal_px: float | None = None) -> Pose:
    """Where the board stands; `focal_px` is guessed from the picture's size where it is not known."""
    import cv2

    w, h = detection.size
    focal = NOMINAL_FOCAL * max(w, h) if focal_px is None else focal_px
    xy = board.points_m[detection.ids, :2]
    flat = (detection.px - ((w - 1) / 2, (h - 1) / 2)) / focal
    H, _ = cv2.findHomography(xy, flat, 0)
    middle = detection.px.mean(axis=0)
    spread = math.sqrt(max(float(np.linalg.det(np.cov(detection.px.T))), 0.0)) * 12 / (w * h)
    place = {"x": float(middle[0]) / w, "y": float(middle[1]) / h, "scale": math.sqrt(spread)}
    if H is None:
        return Pose(**place, tilt_x_deg=0.0, tilt_y_deg=0.0, roll_deg=0.0)
    r1, r2 = H[:, 0] / np.linalg.norm(H[:, 0]), H[:, 1] / np.linalg.norm(H[:, 1])
    normal = np.cross(r1, r2)
    normal = normal / np.linalg.norm(normal) * (np.sign(normal[2]) or 1.0)
    return Pose(
        **place,
        tilt_x_deg=math.degrees(math.atan2(-normal[1], normal[2])),
        tilt_y_deg=math.degrees(math.atan2(normal[0], math.hypot(normal[1], normal[2]))),
        roll_deg=math.degrees(row_angle(detection, board)),
    )


def coverage(detections: Sequence[Detection], *, cells: tuple[int, int] = COVERAGE_CELLS) -> Float64:
    """(rows, columns) how many views put a corner into each cell of the frame."""
    count = np.zeros((cells[1], cells[0]))
    for d in detections:
        count += _cells(d, cells)
    return count


def _cells(d: Detection, cells: tuple[int, int]) -> Float64:
    hit = np.zeros((cells[1], cells[0]))
    at = np.clip(((d.px + 0.5) / d.size * cells).astype(int), 0, np.array(cells) - 1)
    hit[at[:, 1], at[:, 0]] = 1
    return hit


def pick_views(
    detections: Mapping[int, Detection], board: Board, *, count: int = 25, others: Mapping[int, Detection] | None = None
) -> tuple[int, ...]:
    """Frames to calibrate from, best first: sharp ones that differ in place, size and tilt and fill the frame.

    others : the other eye's detections; its sharpness and corners count too where given.
    """
    frames = sorted(detections)
    if len(frames) <= count:
        return tuple(frames)
    poses = [board_pose(detections[f], board) for f in frames]
    # Half a frame, half its size, 30 degrees of tilt, 60 of roll: each is one step apart.
    features = np.array([(p.x * 2, p.y * 2, p.scale * 2, p.tilt_x_deg / 30, p.tilt_y_deg / 30, p.roll_deg / 60) for p in poses])
    sets = [detections, *([others] if others else [])]
    quality = np.array([_quality([s[f] for s in sets if f in s], len(board.points_m)) for f in frames])
    covered = [np.zeros((COVERAGE_CELLS[1], COVERAGE_CELLS[0])) for _ in sets]
    hits = [[_cells(s[f], COVERAGE_CELLS) if f in s else np.zeros_like(covered[0]) for f in frames] for s in sets]
    nearest = np.full(len(frames), 2.0)
    chosen: list[int] = []
    for _ in range(count):
        # A cell's first view tells much, its third little.
        new = np.array([np.mean([(h[i] / (1 + c) ** 2).sum() / c.size for h, c in zip(hits, covered)]) for i in range(len(frames))])
        score = quality * (np.minimum(nearest, 2.0) + 4 * new)
        score[chosen] = -np.inf
        best = int(np.argmax(score))
        chosen.append(best)
        nearest = np.minimum(nearest, np.linalg.norm(features - features[best], axis=1))
        for h, c in zip(hits, covered):
            c += h[best]
    return tuple(frames[i] for i in chosen)


def _quality(views: Sequence[Detection], corners: int) -> float:
    share = min(len(d) for d in views) / corners
    return min(d.sharpness for d in views) * share * min(float(d.refined.mean()) for d in views)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairs:
    """Frames that both eyes saw (corner order agreed), those that only one saw, and what to say about it."""

    left: Mapping[int, Detection]
    right: Mapping[int, Detection]
    only_left: tuple[int, ...]
    only_right: tuple[int, ...]
    mirrored: str | None
    words: tuple[str, ...]


def pair_eyes(left: Mapping[int, Detection | None], right: Mapping[int, Detection | None], board: Board) -> Pairs:
    """Both eyes' views put together: frames matched, a mirrored eye flipped back (its pixels too), corner order agreed.

    Returns : detections of upright pictures; `mirrored` is "left", "right" or None, and with a plain chessboard "right" also
              stands for "one of the two, which cannot be told".
    Raises  : PlateError where an eye changes size midway, no frame has the board in both eyes, or both eyes see it mirrored.
    """
    a = {f: d for f, d in left.items() if d is not None}
    b = {f: d for f, d in right.items() if d is not None}
    words: list[str] = []
    for name, seen, frames in (("left", a, left), ("right", b, right)):
        if not seen:
            raise PlateError(f"the board {board.spec} is in none of the {len(frames)} pictures of the {name} eye; check the spec, focus and light")
        sizes = {f: seen[f].size for f in sorted(seen)}
        first = next(iter(sizes.values()))
        other = next((f for f, size in sizes.items() if size != first), None)
        if other is not None:
            w, h = sizes[other]
            raise PlateError(f"{name} eye, frame {other}: size {w}x{h}, but {first[0]}x{first[1]} before; calibrate each size by itself")
    both = sorted(set(a) & set(b))
    only_left, only_right = tuple(sorted(set(a) - set(b))), tuple(sorted(set(b) - set(a)))
    if not both:
        raise PlateError(f"no frame shows the board in both eyes ({len(a)} left, {len(b)} right); hold it where both see it, at the same time")
    if only_left or only_right:
        words.append(f"{len(both)} frames have the board in both eyes, {len(only_left)} only in the left and {len(only_right)} only in the right")
    mirrored = None
    flags = [np.mean([d.mirrored for d in seen.values()]) > 0.5 for seen in (a, b)]
    a, b = ({f: d for f, d in seen.items() if d.mirrored == flag} for seen, flag in ((a, flags[0]), (b, flags[1])))
    both = sorted(set(a) & set(b))
    if board.kind == "chessboard":
        if mirrored_eye([a[f] for f in both], [b[f] for f in both], board):
            mirrored = "right"
            words.append(
                "one eye is mirrored; on a plain chessboard the two cannot be told apart: it is taken to be the right one, say 'left' where it is not"
            )
            b = {f: reflected(d, board) for f, d in b.items()}
    elif all(flags):
        raise PlateError("both eyes see the board mirrored: the print is mirrored; print it again without mirroring, or flip both eyes' pictures")
    elif any(flags):
        mirrored = "left" if flags[0] else "right"
        words.append(f"the {mirrored} eye is mirrored; its pictures are flipped back left-right")
        if flags[0]:
            a = {f: d.flipped() for f, d in a.items()}
        else:
            b = {f: d.flipped() for f, d in b.items()}
    b = {**b, **{f: same_order(a[f], b[f], board) for f in both}}
    return Pairs(left=a, right=b, only_left=only_left, only_right=only_right, mirrored=mirrored, words=tuple(words))


def same_order(left: Detection, right: Detection, board: Board) -> Detection:
    """`right` with its corners in `left`'s order: of the turns that look the same, the one that turns least between the eyes."""
    if turns(board) == 1:
        return right
    ahead = row_angle(left, board)
    step = 4 // turns(board)
    return max((turned(right, board, k) for k in range(0, 4, step)), key=lambda d: math.cos(row_angle(d, board) - ahead))


def reflected(detection: Detection, board: Board) -> Detection:
    """A plain chessboard's detection for the picture flipped left-right: other pixels, and the order that the board then has."""
    nx, ny = board.grid
    flip = np.arange(nx * ny).reshape(ny, nx)[:, ::-1].ravel()
    ids = flip[detection.ids]
    rank = np.argsort(ids)
    d = detection.flipped()
    d = replace(d, mirrored=False, ids=ids[rank], px=d.px[rank], sigma_px=d.sigma_px[rank], refined=d.refined[rank])
    # Mirrored, a board whose corner colours tell its order has them swapped: half a turn brings them back.
    if (board.columns + board.rows) % 2 and board.columns % 2:
        d = turned(d, board, 2)
    return d


def mirrored_eye(left: Sequence[Detection], right: Sequence[Detection], board: Board) -> bool:
    """Whether one of two eyes that see a plain chessboard is mirrored: the epipolar geometry fits only with one eye flipped.

    False also where the views cannot say (fewer than three, or all frontal)."""
    if len(left) < FEWEST_TOGETHER:
        return False
    straight = epipolar_px(left, [same_order(a, b, board) for a, b in zip(left, right)])
    flipped = epipolar_px(left, [same_order(a, reflected(b, board), board) for a, b in zip(left, right)])
    return bool(straight > LEAST_MIRROR_PX and flipped < NEAR_MIRROR * straight)


def epipolar_px(left: Sequence[Detection], right: Sequence[Detection]) -> float:
    """Median distance in pixels of both eyes' corners from each other's epipolar lines, one geometry for all views; NaN below 16 corners."""
    each = epipolar_by_view(left, right)
    return float(np.median(np.concatenate(each))) if each else math.nan


def epipolar_by_view(left: Sequence[Detection], right: Sequence[Detection]) -> list[Float64]:
    """The same, corner by corner of each view; [] where there are too few."""
    import cv2

    pairs = []
    for a, b in zip(left, right):
        _, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
        pairs.append((a.px[i], b.px[j]))
    if sum(len(p) for p, _ in pairs) < 16:
        return []
    p, q = np.concatenate([p for p, _ in pairs]), np.concatenate([q for _, q in pairs])
    keep = np.ones(len(p), bool)
    F = None
    for _ in range(4):  # refitted on the better half and what lies near it
        F, _ = cv2.findFundamentalMat(p[keep], q[keep], cv2.FM_8POINT)
        if F is None or F.shape != (3, 3):
            return []
        off = _sampson(F, p, q)
        keep = off <= max(3 * float(np.median(off)), 0.2)
    if F is None:
        return []
    ends = np.cumsum([len(a) for a, _ in pairs])[:-1]
    return [np.asarray(part) for part in np.split(_sampson(F, p, q), ends)]


def _sampson(F: Float64, p: Float64, q: Float64) -> Float64:
    a = np.concatenate([p, np.ones((len(p), 1))], axis=1) @ F.T
    b = np.concatenate([q, np.ones((len(q), 1))], axis=1) @ F
    along = np.abs(np.sum(np.concatenate([q, np.ones((len(q), 1))], axis=1) * a, axis=1))
    off: Float64 = along / np.sqrt(np.maximum(a[:, 0] ** 2 + a[:, 1] ** 2 + b[:, 0] ** 2 + b[:, 1] ** 2, 1e-30))
    return off
