"""Plain ground lies on the planes that most of it was matched on.

In: a pair and the disparity of its left eye.  Out: the disparity with plain ground put on planes.
A bare wall says nothing to match by: what is found there is what its grain happens to look like, patch by patch, and beside an outline what
stands before it.  But most patches are right, or nearly, and no surface jumps where the picture has no edge.  So each piece of plain ground
is offered the few planes that most of it, and of what lies beside it, was matched on; and a pixel takes the first of them that the two
pictures do not object to, as much of them as lies about it (after Tao, Sawhney and Kumar 2001; Bleyer and Gelautz 2005; for each pixel anew,
since a wall may have a corner).  Ground on which two ways of matching agree keeps what it has, and so does ground that bends: there a bowl is
nearer its matches than planes are, or planes leave more between the pictures."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.engine.grounds import planar, told_other
from stereorelight.engine.occlusion import consistent, unseen
from stereorelight.engine.photometric import brightness_residual
from stereorelight.stereo.plains import off_planes, pieces_beside, plane_through
from stereorelight.stereo.proxy import Proxy

AS_IF_NOISE = 2.5  # grey levels: what a picture of so much noise would count as plain
SMALLEST_SHARE, SMALLEST_PX, MOST_PIECES = 1 / 600, 300, 64  # of the picture: pieces of ground that are looked at
SPOTS, GRID, FEWEST = 400, 60_000, 30  # pixels that speak for a piece, out of so many of the picture; fewer say nothing
SURE_SHARE = 0.6  # of a piece on which two ways of matching agree
PLANES, LEAST_SHARE = 2, 0.12  # of a piece, and what share of it lies on each
OTHER_SHARE, OTHER_WORTH = 0.1, 0.3  # of a piece that lies on a plane from beside it, and what each pixel there adds
ON_PX = 1.0  # how near its plane ground lies on it
TRIES, FIRST_PX, THEN_PX = 12, 2.0, 1.0  # rounds of the robust fit of a bowl, and how far off counts a quarter in either half of them
BENDS, BENT_PX = 0.87, 0.3  # mean distance of a bowl over that of the planes by which ground bends, where that is so many px or more
MOST_PX = 2.0  # of that distance
OFFERED = 3  # planes to a piece
ALIKE_PX = 0.5  # mean distance of planes that are one
AROUND_PX = 12.0  # over which the pictures are asked
MEAN_PX = 3.0  # over which even differences of brightness are no evidence
OBJECTS = 0.25  # of what is usually left between the pictures: so much may a plane leave more than what was matched, which chose the least
GRAINY_OBJECTS = 0.04  # the same under grain, which is most of what is left: more would be the surface's own
LATER = 0.2  # of it, that each later plane must leave less
MATCHED = 0.4  # of it, that a plane may leave more where all that lies about a pixel was matched on it: so a wall has its corner
UNKNOWN = 0.6  # more than usual, where the eyes do not agree or do not both see: any plane that is liked better will do
FEW = 0.05  # share of the ground about a pixel that both eyes see, by which nothing is told
LEAST_GRAIN = 0.5  # grey levels
HIDDEN_WINDOW = (1, 5)  # beside hidden ground the other eye is not asked either


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Pieces of plain ground: label (H, W) int32, 0 elsewhere; area (n,) px; and of each, spots (3, m): rows x, y, d of confirmed pixels."""

    label: np.ndarray
    area: np.ndarray
    spots: list[Float64]


def _pieces(plain: Bool, disparity: Float32, confirmed: Bool) -> Pieces:
    _, label, stats, _ = cv2.connectedComponentsWithStats(plain.view(np.uint8), connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA].copy()
    area[0] = 0
    large = np.argsort(-area, kind="stable")[:MOST_PIECES]
    large = large[area[large] >= max(SMALLEST_PX, SMALLEST_SHARE * plain.size)]
    names = np.zeros(area.size, np.int32)
    names[large] = np.arange(1, large.size + 1)
    label = names[label]
    step = max(1, round((plain.size / GRID) ** 0.5))
    y, x = np.nonzero(confirmed[::step, ::step] & (label[::step, ::step] > 0))
    x, y = step * x, step * y
    of = label[y, x]
    order = np.argsort(of, kind="stable")
    count = np.bincount(of, minlength=large.size + 1)
    start = np.cumsum(count) - count
    spots = []
    for first, n in zip(start, count, strict=True):
        some = order[first + np.arange(min(SPOTS, n)) * n // min(SPOTS, max(n, 1))]
        spots.append(np.stack([x[some], y[some], disparity[y[some], x[some]]]).astype(np.float64))
    return Pieces(label=label, area=np.concatenate([[0], area[large]]), spots=spots)


def _own_planes(spots: Float64) -> list[tuple[Float64, float]]:
    """The planes that spots lie on, one after the other, and the share that does."""
    found: list[tuple[Float64, float]] = []
    left = spots
    while len(found) < PLANES and left.shape[1] >= FEWEST:
        plane = plane_through(left)
        if plane is None:
            break
        on = off_planes(plane[None], left)[0] < ON_PX
        share = float(on.sum() / spots.shape[1])
        if share < LEAST_SHARE:
            break
        found.append((plane, share))
        left = left[:, ~on]
    return found


def _bends(spots: Float64, planes: list[Float64]) -> bool:
    """Whether a bowl says more of spots than their planes do: of a face or a sleeve, and not of a wall and its corner."""
    x, y, d = spots
    u, v = (x - x.mean()) / (x.std() + 1), (y - y.mean()) / (y.std() + 1)
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    weight, off = np.ones_like(d), d
    for k in range(TRIES):
        bowl = np.linalg.solve(terms * weight @ terms.T + 1e-6 * np.eye(6), terms * weight @ d)
        off = np.abs(bowl @ terms - d)
        weight = 1 / (1 + (off / (FIRST_PX if 2 * k < TRIES else THEN_PX)) ** 2) ** 2
    nearest = off_planes(np.array(planes), spots).min(axis=0)
    of_planes = np.minimum(nearest, MOST_PX).mean()
    return bool(of_planes > BENT_PX and np.minimum(off, MOST_PX).mean() < BENDS * of_planes)


def _offered(pieces: Pieces, lost: Bool) -> Float32:
    """(OFFERED, n, 3): to each piece that is `lost` (n,) its own planes and those of what lies beside it, by how much ground lies on them; NaN
    where there are fewer."""
    n = len(pieces.area)
    own = [_own_planes(spots) for spots in pieces.spots]
    flat = [bool(planes) and not _bends(spots, [plane for plane, _ in planes]) for planes, spots in zip(own, pieces.spots, strict=True)]
    own = [planes if level else [] for planes, level in zip(own, flat, strict=True)]
    beside = pieces_beside(pieces.label, n)
    offered = np.full((OFFERED, n, 3), np.nan, np.float32)
    for k in range(1, n):
        spots = pieces.spots[k]
        if not lost[k] or not flat[k]:
            continue
        planes, elsewhere = [], []
        for j in (k, *sorted(beside[k])):
            planes += [plane for plane, _ in own[j]]
            elsewhere += [share * pieces.area[j] for _, share in own[j]]
        if not planes:
            continue
        share = (off_planes(np.array(planes), spots) < ON_PX).mean(axis=1)
        worth = share * pieces.area[k] + np.where(share > OTHER_SHARE, OTHER_WORTH * np.array(elsewhere), 0)
        taken: list[Float64] = []
        for i in np.argsort(-worth, kind="stable"):
            if len(taken) == OFFERED or share[i] < OTHER_SHARE:
                break
            apart = [np.abs((planes[i] - other) @ np.stack([*spots[:2], np.ones(spots.shape[1])])).mean() for other in taken]
            if min(apart, default=np.inf) >= ALIKE_PX:
                offered[len(taken), k] = planes[i]
                taken.append(planes[i])
    return offered


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """Of a disparity: what it leaves between the pictures about each pixel, (H / 4, W / 4) variance of grey, less even differences; the share of
    the ground there that both eyes see; and (H, W) where they do not."""

    left_over: Float32
    told: Float32
    hidden: Bool


def _asked(left: Float32, right: Float32, ground: Bool, disparity: Float32) -> Asked:
    hidden = cv2.dilate(unseen(disparity).view(np.uint8), np.ones(HIDDEN_WINDOW, np.uint8)) > 0
    weight = (ground & ~hidden).astype(np.float32)
    residual = brightness_residual(left, right, disparity)[0]
    residual *= weight
    size = ((left.shape[1] + 3) // 4, (left.shape[0] + 3) // 4)
    square, mean, share = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (residual * residual, residual, weight))
    few = np.float32(1e-6)
    mean, near = (cv2.GaussianBlur(a, (0, 0), MEAN_PX / 4) for a in (mean, share))
    even = mean / (near + few)
    total, told = (cv2.GaussianBlur(a, (0, 0), AROUND_PX / 4) for a in (np.maximum(square - even * even * share, 0), share))
    return Asked(left_over=total / (told + few), told=told, hidden=hidden)


def on_walls(proxy: Proxy, plain: Bool, led: Float32, disparity: Float32, confirmed: Bool, *, grainy: bool) -> tuple[Float32, Bool]:
    """(H, W) px: the disparity of the left eye with plain ground on its planes; and where it was put on one.

    proxy     : the pair, with its grain.   plain: (H, W) where its left picture is.   disparity: (H, W) px, finite.
    led       : (H, W) px, what semi-global matching says by itself, NaN where it says nothing: ground on which both agree needs no plane.
    confirmed : (H, W), the right eye says the same: only there a match speaks for a plane.
    grainy    : there is more grain than matching bears.
    """
    grain2 = sum(max(grain, LEAST_GRAIN) ** 2 for grain in proxy.grains)
    pieces = _pieces(plain, disparity, confirmed)
    n = len(pieces.area)
    with np.errstate(invalid="ignore"):
        agrees = (np.abs(led - disparity) <= ON_PX) & confirmed
    lost = np.bincount(pieces.label[agrees], minlength=n) < SURE_SHARE * pieces.area
    offered = _offered(pieces, lost)
    out, changed = disparity.copy(), np.zeros(disparity.shape, np.bool_)
    if not np.isfinite(offered).any():
        return out, changed
    ground = pieces.label > 0
    size = (disparity.shape[1], disparity.shape[0])

    def asked(d: Float32) -> Asked:
        return _asked(proxy.left_grey, proxy.right_grey, ground, d)

    def grown(a: Float32) -> Float32:
        return cv2.resize(a, size, interpolation=cv2.INTER_LINEAR)

    was = asked(disparity)
    some = was.left_over[was.told > 0.5]
    usual = np.float32(max(float(np.median(some)) if some.size else 0.0, grain2))
    unit: Float32 = np.maximum(was.left_over, usual)  # where more is left than usually, chance counts for more
    least = grown(was.left_over / unit + np.float32(GRAINY_OBJECTS if grainy else OBJECTS))
    least[was.hidden | ~confirmed | (grown(was.told) < FEW)] = 1 + UNKNOWN
    best = np.full(disparity.shape, np.inf, np.float32)
    for k, planes in enumerate(offered):
        offers = np.isfinite(planes[:, 0])
        if not offers.any():
            break
        there = planar(pieces.label, planes, disparity)
        now = asked(there)
        with np.errstate(invalid="ignore"):
            lie = ground & confirmed & (np.abs(there - disparity) <= ON_PX)
        here = cv2.GaussianBlur(cv2.resize(lie.astype(np.float32), now.told.shape[::-1], interpolation=cv2.INTER_AREA), (0, 0), AROUND_PX / 4)
        worth = grown(np.where(now.told < FEW, np.float32(1), now.left_over / unit) - np.float32(MATCHED) * here) + np.float32(LATER * k)
        # On the plane the other eye would not see it, and what it has stands before: in such a strip any match is chance.
        behind = now.hidden & (there < disparity - np.float32(ON_PX))
        takes = offers[pieces.label] & (worth < np.where(behind, np.maximum(least, np.float32(1 + UNKNOWN)), least)) & (worth < best)
        np.copyto(best, worth, where=takes)
        np.copyto(out, there, where=takes)
        changed |= takes
    return out, changed


def matched_on_walls(
    proxy: Proxy, plain: Bool, led: Float32, dense: Float32, eyes: tuple[Float32, Float32], *, grainy: bool
) -> tuple[Float32, Float32, Bool]:
    """Both eyes' disparities, NaN where unmatched, with plain ground of the left one on its planes where the right eye sees it there, and NaN
    where it does not; and where it was put on one.

    eyes : the same as they were matched.   dense: the left one with a value everywhere.   The rest as `on_walls` takes it.
    """
    found, changed = on_walls(proxy, plain, led, dense, consistent(*eyes), grainy=grainy)
    seen = changed & ~unseen(found)
    left = np.where(changed, np.where(seen, found, np.float32(np.nan)), eyes[0])
    return left, told_other(eyes[1], found, seen), changed
