"""Plain ground under grain goes on in the plane that most of it lies on, up to the edges that the picture has.

In: a grainy pair in grey, the left picture with its grain calmed, and the disparity of the left eye.  Out: patches of plain ground that
jump off their plane where no edge is, put on it.
On ground plainer than its grain a match is decided by what stands beside it, and beside an outline that is the wrong thing as often as
not: a tyre's disparity is carried over the floor next to it, and both eyes confirm it, since nothing there says otherwise.  But the step
at which it ends lies in the middle of plain ground, and no surface ends where the picture has no edge."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, Float64, UInt8
from stereorelight.engine.grounds import level
from stereorelight.engine.occlusion import unseen
from stereorelight.engine.photometric import brightness_residual
from stereorelight.engine.rows import at_once

PLAIN = 0.6  # of the noise, grey levels per px of the calmed picture, either way: what changes faster is an edge
CALM_PX = 1.0  # by which it is softened for that
SMALLEST_PX = 150  # plain ground that has a plane of its own
SAMPLES, TRIES = 400, 100  # pixels that speak for a piece of ground, and planes through three of them
LEAST_AREA2 = 20.0  # px^2: twice the area that three pixels must span to make a plane
STEEPEST = 0.6  # px per px
FITS = 3  # rounds of least squares over what lies on the best plane
ON_PX, OFF_PX = 1.0, 1.5  # how near its plane ground lies on it, and how far from it no longer
OWN_SHARE, OTHER_SHARE = 0.4, 0.25  # of a piece of ground that must lie on its own plane, and on one that goes on from ground beside it
SETTLED = 0.75  # of a piece that lies on its own plane: it leaves that only for one that half as much of it lies on
BESIDE_PX = (4, 8, 12)  # from one piece to the next
PATCH_PX = 15  # the smallest patch that is looked at
STEP_PX, STEP_WINDOW = 2.0, (5, 5)  # change of disparity that is a step
STEP_SHARE = 0.05  # of a patch's rim within its ground that must be a step: ground that bends leaves its plane without one
MOST_BENT = 0.3  # of a piece that leaves its plane without a step: a face has no plane to go on in
HIDDEN_WINDOW = (1, 5)  # beside hidden ground the other eye is not asked either
MEAN_PX = 3.0  # over which even differences of brightness are no evidence
OBJECTS, CHANCE = 0.05, 1.5  # of the grain's variance: what the pictures may say against the plane, and by chance over the root of their pixels
FEWEST = 8  # pixels, of which that is told
ALL, FIRST, LAST = slice(None), slice(None, -1), slice(1, None)
NEIGHBOURS = (((LAST, ALL), (FIRST, ALL)), ((FIRST, ALL), (LAST, ALL)), ((ALL, LAST), (ALL, FIRST)), ((ALL, FIRST), (ALL, LAST)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Pieces of plain ground.

    label  : (H, W) int32, of a piece; 0 elsewhere.   area: pixels of each label, (n,); its first means nothing.
    spots  : of each label, rows (x, y, d) of pixels spread over it, (3, m) each.
    planes : (n, 3), d = a x + b y + c; NaN where there is none.   share: (n,) of the pixels that lie on it.
    """

    label: np.ndarray
    area: np.ndarray
    spots: list[Float64]
    planes: Float64
    share: Float64


def plain_ground(calm: UInt8, noise: float) -> Bool:
    """(H, W) bool: no channel of the calmed picture (H, W, 3) has an edge there; `noise`: grey levels of the picture before."""
    return level(cv2.GaussianBlur(calm.astype(np.float32), (0, 0), CALM_PX), PLAIN * noise)


def off_planes(planes: Float64, spots: Float64) -> Float64:
    """(k, m) px: how far each spot lies from each plane."""
    x, y, d = spots
    return np.abs(planes[:, :1] * x + planes[:, 1:2] * y + planes[:, 2:] - d)


def plane_through(spots: Float64) -> Float64 | None:
    """The plane (a, b, c) that most of `spots` (3, m) lie on, rows x, y, d; None where there is none.

    Planes through three spots each, the one with the least sum of distances no larger than `ON_PX` taken (MSAC; Torr and Zisserman 2000),
    and fitted to all that lie on it.  The threes are spread by an additive recurrence, so the answer is the same each time.
    """
    m = spots.shape[1]
    steps = np.array([[0.8191725134], [0.6710436067], [0.5497004779]])  # powers of one over the root of x^4 = x + 1 (Roberts 2018)
    three = spots[:, (steps * np.arange(1, TRIES + 1) % 1 * m).astype(np.intp)]  # (3 rows, 3 spots, TRIES)
    (x1, x2, x3), (y1, y2, y3), (d1, d2, d3) = three
    u, v, p, q = x2 - x1, y2 - y1, x3 - x1, y3 - y1
    area2 = u * q - v * p
    wide = np.abs(area2) > LEAST_AREA2
    divisor = np.where(wide, area2, 1)
    a, b = ((d2 - d1) * q - (d3 - d1) * v) / divisor, ((d3 - d1) * u - (d2 - d1) * p) / divisor
    planes = np.stack([a, b, d1 - a * x1 - b * y1], axis=1)[wide & (np.abs(a) < STEEPEST) & (np.abs(b) < STEEPEST)]
    if not len(planes):
        return None
    best = planes[np.minimum(off_planes(planes, spots), ON_PX).sum(axis=1).argmin()]
    for _ in range(FITS):
        on = spots[:, off_planes(best[None], spots)[0] < ON_PX]
        if on.shape[1] < 3:
            return None
        middle = on.mean(axis=1, keepdims=True)
        x, y, d = on - middle
        xx, xy, yy, xd, yd = ((r * s).sum() for r, s in ((x, x), (x, y), (y, y), (x, d), (y, d)))
        spread = xx * yy - xy * xy
        if not spread > 1e-9 * xx * yy:
            return None
        a, b = (xd * yy - yd * xy) / spread, (yd * xx - xd * xy) / spread
        best = np.array([a, b, middle[2, 0] - a * middle[0, 0] - b * middle[1, 0]])
    return best


def ground_of(plain: Bool, disparity: Float32) -> Ground:
    """The pieces of `plain` ground that are large enough to have a plane, with it."""
    n, label, stats, _ = cv2.connectedComponentsWithStats(plain.view(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= SMALLEST_PX
    large[0] = False
    named = np.where(large, np.cumsum(large), 0).astype(np.int32)
    label, area, n = named[label], np.concatenate([[1], stats[large, cv2.CC_STAT_AREA]]), int(large.sum()) + 1
    at = np.flatnonzero(label)
    order = np.argsort(label.ravel()[at].astype(np.uint16 if n < 1 << 16 else np.int32), kind="stable")
    start = np.concatenate([[0, 0], np.cumsum(area[1:])])
    width, flat = disparity.shape[1], disparity.ravel()
    spots, planes, share = [np.empty((3, 0))], np.full((n, 3), np.nan), np.zeros(n)
    for k in range(1, n):
        count = min(SAMPLES, int(area[k]))
        some = at[order[start[k] + np.arange(count) * area[k] // count]]
        own = np.stack([some % width, some // width, flat[some]]).astype(np.float64)
        spots.append(own)
        plane = plane_through(own)
        if plane is not None:
            planes[k], share[k] = plane, np.mean(off_planes(plane[None], own)[0] < ON_PX)
    return Ground(label=label, area=area, spots=spots, planes=planes, share=share)


def pieces_beside(label: np.ndarray, n: int) -> list[set[int]]:
    """Of each piece, the pieces that lie a few px from it along a row or a column."""
    pairs = set()
    for step in BESIDE_PX:
        for one, other in ((label[:, step:], label[:, :-step]), (label[step:], label[:-step])):
            apart = (one != other) & (one > 0) & (other > 0)
            pairs.update(np.unique(one[apart].astype(np.int64) * n + other[apart]).tolist())
    beside: list[set[int]] = [set() for _ in range(n)]
    for pair in pairs:
        i, j = divmod(pair, n)
        beside[i].add(j)
        beside[j].add(i)
    return beside


def planes_of(ground: Ground) -> Float64:
    """(n, 3): the plane of each piece, its own or one that goes on from beside it, whichever most pixels of both lie on; NaN where none does.

    A floor that outlines and shadows cut to pieces has one plane, and it knows it better than a piece of which half is wrong.
    """
    n = len(ground.area)
    on = ground.share * ground.area
    firm = ground.share >= OWN_SHARE
    taken = np.full((n, 3), np.nan)
    beside = pieces_beside(ground.label, n)
    for k in range(1, n):
        from_where = np.array([k, *sorted(beside[k])])
        from_where = from_where[firm[from_where]]
        if not from_where.size:
            continue
        planes, own = ground.planes[from_where], from_where == k
        share = np.mean(off_planes(planes, ground.spots[k]) < ON_PX, axis=1)
        worth = share * ground.area[k] + np.where(own, 0, on[from_where])
        least = max(OTHER_SHARE, 0.5 * ground.share[k]) if ground.share[k] >= SETTLED else OTHER_SHARE
        worth[share < np.where(own, OWN_SHARE, least)] = 0
        if worth.max() > 0:
            taken[k] = planes[worth.argmax()]
    return taken


def _stepped(patch: np.ndarray, label: np.ndarray, disparity: Float32, n: int) -> Bool:
    """(n,) bool: patches that end in a step somewhere within their own ground."""
    window, plain = np.ones(STEP_WINDOW, np.uint8), label > 0  # at an outline nobody wonders at a step
    highest, lowest = (np.where(plain, disparity, np.float32(far)) for far in (-1e9, 1e9))
    step = cv2.dilate(highest, window) - cv2.erode(lowest, window) > STEP_PX
    rim, steps = np.zeros(n), np.zeros(n)
    for here, there in NEIGHBOURS:
        ends = (patch[here] > 0) & (patch[there] == 0) & (label[here] == label[there])
        of = patch[here][ends]
        rim += np.bincount(of, minlength=n)
        steps += np.bincount(of, step[there][ends], n)
    return (steps > 0) & (steps >= STEP_SHARE * rim)


def _bent(patch: np.ndarray, stepped: Bool, ground: Ground) -> Bool:
    """(n,) bool: patches of a piece that lies off its plane by bending, too."""
    off = patch > 0
    of_patch, of_piece = patch[off], ground.label[off]
    piece = np.zeros(stepped.size, np.intp)
    piece[of_patch] = of_piece
    bends = np.bincount(of_piece[~stepped[of_patch]], minlength=ground.area.size) > MOST_BENT * ground.area
    return bends[piece]


def carried_on(left: Float32, right: Float32, calm: UInt8, disparity: Float32, *, noise: float, grain2: float) -> tuple[Float32, Bool]:
    """(H, W) px: the disparity of the left eye with patches of plain ground on the plane of their ground; and where they are.

    left, right : (H, W) grey of the pair, grain and all.   calm: (H, W, 3) the left picture with less.   disparity: (H, W) px, finite.
    noise       : of the picture, grey levels.   grain2: variance of what grain alone leaves between the greys.
    NaN where the right eye does not see the ground: nothing speaks for a disparity there, but the one it had is wrong.
    A patch is what lies off the plane together.  It goes on it where it ends in a step, on ground that does not bend, and where the pictures
    do not object by more than chance: of what both eyes would see were it on the plane, what is left between them, less local means, against
    what was.
    """
    nothing = disparity, np.zeros(disparity.shape, np.bool_)
    ground = ground_of(plain_ground(calm, noise), disparity)
    planes = planes_of(ground).astype(np.float32)
    if not np.isfinite(planes).any():
        return nothing
    height, width = disparity.shape
    a, b, c = (planes[:, k][ground.label] for k in range(3))
    plane = a * np.arange(width, dtype=np.float32) + b * np.arange(height, dtype=np.float32)[:, None] + c
    with np.errstate(invalid="ignore"):
        away = np.abs(disparity - plane) > OFF_PX
    n, patch, stats, _ = cv2.connectedComponentsWithStats(away.view(np.uint8), connectivity=4)
    asked = (stats[:, cv2.CC_STAT_AREA] >= PATCH_PX) & _stepped(patch, ground.label, disparity, n)
    asked[0] = False
    asked &= ~_bent(patch, asked, ground)
    if not asked.any():
        return nothing
    changed = asked[patch]
    moved = np.where(changed, plane, disparity)
    hidden = cv2.dilate(unseen(moved).view(np.uint8), np.ones(HIDDEN_WINDOW, np.uint8)) > 0
    seen = changed & ~hidden
    weight = seen.astype(np.float32)
    count = cv2.GaussianBlur(weight, (0, 0), MEAN_PX) + np.float32(1e-6)

    def left_over(d: Float32) -> Float32:
        """Squares of what is left between the pictures where both see, less its local mean."""
        residual = brightness_residual(left, right, d)[0] * weight
        residual -= cv2.GaussianBlur(residual, (0, 0), MEAN_PX) / count
        return residual * residual

    was, now = at_once(lambda: left_over(disparity), lambda: left_over(moved))
    of = patch[seen]
    pixels = np.maximum(np.bincount(of, minlength=n), FEWEST)
    against = np.bincount(of, (now[seen] - was[seen]).astype(np.float64), n) / (pixels * grain2)
    changed = (asked & (against <= OBJECTS + CHANCE / np.sqrt(pixels)))[patch]
    return np.where(changed, np.where(hidden, np.float32(np.nan), moved), disparity), changed
