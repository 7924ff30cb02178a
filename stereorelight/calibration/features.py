"""Points of the scene that both eyes see, to a few hundredths of a pixel, from the plates alone.

In: two upright scene-linear plates (H, W, 3) of one moment.  Out: `Matches`: pixels of the original plates, (0, 0) at the
centre of the top-left pixel.  SIFT (Lowe 2004) finds and recognises, spread over the frame; a window search refines each
point both ways (engine/points.py: SIFT alone is off by a tenth of a pixel); MAGSAC (Barath et al. 2020) on the epipolar
geometry throws out what no pair of eyes could see.  The same plates give the same points, bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, UInt8, as_float32
from stereorelight.camera import Rig
from stereorelight.engine.points import search_points
from stereorelight.errors import PlateError

DETECT_SIDE_PX = 1280  # points are found on a picture no longer than this, and refined on the plate itself
CELL_PX = 64  # of that picture; no cell may give more than its share of the points
CONTRAST = 0.01  # SIFT's own default, 0.04, leaves dim and soft areas empty
RATIO = 0.8  # Lowe's: the best candidate must be this much nearer than the second best
SMOOTH_PX = 0.8  # before refinement: cubic look-ups are exact to a hundredth of a pixel on what is left
RADIUS_PX = 10
FURTHEST_PX = 3.0  # of the plate a refinement may move a point
CORRELATION = 0.8
AGREE_PX = 0.25  # there and back again
SIGMA_FLOOR_PX = 0.02  # no window is truer than this: interpolation, and surfaces that are no planes
EPIPOLAR_PX = 1.0
LEAST_FOR_GEOMETRY = 16
WHITE_QUANTILE, HEADROOM = 0.99, 1.25
QUANTILES = 256
SEED = 20170


@dataclass(frozen=True, kw_only=True, eq=False)
class Matches:
    """Points that both eyes see.

    left, right : (n, 2) float64 pixels (u, v) of the upright plates.
    sigma_px    : (n,) how far the vertical place may be off, from each window's own noise.
    size        : (width, height) of the plates.
    found       : how many candidates there were before geometry and refinement had their say.
    """

    left: Float64
    right: Float64
    sigma_px: Float64
    size: tuple[int, int]
    found: int = 0

    def __len__(self) -> int:
        return len(self.left)

    @property
    def weight(self) -> Float64:
        """(n,) 0..1: 1 for the surest point."""
        w: Float64 = 1 / np.square(np.maximum(self.sigma_px, SIGMA_FLOOR_PX))
        return w / w.max() if len(w) else w

    def __getitem__(self, keep: npt.NDArray[Any]) -> Matches:
        return Matches(left=self.left[keep], right=self.right[keep], sigma_px=self.sigma_px[keep], size=self.size, found=self.found)


def pooled(parts: Sequence[Matches], *, most: int = 20_000) -> Matches:
    """The matches of several frames as one set, evenly thinned to `most`.  Raises PlateError where sizes differ."""
    if not parts:
        raise PlateError("no frame gave matches; check that both plates show the scene")
    if len({part.size for part in parts}) > 1:
        raise PlateError(f"frames differ in size: {', '.join(sorted({f'{w}x{h}' for w, h in (part.size for part in parts)}))}; give one size a shot")
    whole = Matches(
        left=np.concatenate([part.left for part in parts]),
        right=np.concatenate([part.right for part in parts]),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        size=parts[0].size,
        found=sum(part.found for part in parts),
    )
    return whole if len(whole) <= most else whole[np.linspace(0, len(whole) - 1, most).astype(int)]


def grey_pair(left: Float32, right: Float32) -> tuple[Float32, Float32]:
    """Grey pictures 0..255 of one tone: square root of light, the right one given the left one's distribution."""
    codes = []
    for plate, eye in ((left, "left"), (right, "right")):
        light = plate @ np.array([0.2126, 0.7152, 0.0722], np.float32)
        known = light[::4, ::4][np.isfinite(light[::4, ::4])]
        white = float(np.quantile(known, WHITE_QUANTILE)) if known.size else 0.0
        if not white > 0:
            raise PlateError(f"{eye} plate has no light in it; check exposure, colour space and frame")
        codes.append(np.sqrt(np.clip(np.nan_to_num(light / (white * HEADROOM), posinf=1.0), 0, 1)))
    at = np.linspace(0, 1, QUANTILES)
    theirs, mine = (np.quantile(code[::4, ::4], at) for code in codes)
    rising = mine + np.arange(QUANTILES) * 1e-7  # clipped areas are one tone many times over
    matched = np.interp(codes[1], rising, theirs)
    return (codes[0] * 255).astype(np.float32), (matched * 255).astype(np.float32)


def _eight_bit(grey: Float32, scale: float) -> UInt8:
    if scale < 1:
        h, w = grey.shape
        grey = cv2.resize(grey, (round(w * scale), round(h * scale)), interpolation=cv2.INTER_AREA)
    return np.clip(grey + 0.5, 0, 255).astype(np.uint8)


def _described(picture: UInt8, most: int) -> tuple[Float64, Float32]:
    """Points (n, 2) and descriptors (n, 128): the strongest of each cell, so that one rich corner cannot take them all."""
    sift = cv2.SIFT_create(nfeatures=0, contrastThreshold=CONTRAST)
    points = sift.detect(picture, None)
    h, w = picture.shape
    cells = -(-w // CELL_PX) * -(-h // CELL_PX)
    share = max(4, -(-2 * most // cells))
    taken: dict[tuple[int, int], int] = {}
    kept, seen = [], set()
    for point in sorted(points, key=lambda p: (-p.response, p.pt)):
        cell = int(point.pt[0]) // CELL_PX, int(point.pt[1]) // CELL_PX
        if taken.get(cell, 0) < share and point.pt not in seen:
            taken[cell] = taken.get(cell, 0) + 1
            seen.add(point.pt)  # one place with two orientations is one point
            kept.append(point)
        if len(kept) >= most:
            break
    if not kept:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    kept, descriptors = sift.compute(picture, kept)
    rooted = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))  # Arandjelovic and Zisserman 2012
    return np.array([p.pt for p in kept], dtype=np.float64), rooted.astype(np.float32)


def _recognised(a: Float32, b: Float32) -> npt.NDArray[np.intp]:
    """(n, 2) rows of a and b that are each other's nearest, and clearly nearer than the next."""
    if min(len(a), len(b)) < 2:
        return np.empty((0, 2), np.intp)
    alike = a @ b.T  # unit vectors: distance^2 = 2 - 2 alike
    best = alike.argmax(axis=1)
    rows = np.arange(len(a))
    first = alike[rows, best]
    nearest = alike.max(axis=0)[best] == first  # argmax down columns would take five times as long as all of this
    alike[rows, best] = -1
    second = alike.max(axis=1)
    clear = (1 - first) < RATIO**2 * (1 - second)
    # Where two rows of a are as near to one of b, the first of them has it.
    order = np.flatnonzero(nearest)
    once = np.zeros(len(a), bool)
    once[order[np.unique(best[order], return_index=True)[1]]] = True
    keep = clear & once
    return np.stack([rows[keep], best[keep]], axis=1)


def _refined(left: Float32, right: Float32, p: Float64, q: Float64) -> tuple[Float64, Float64, Float64, Bool]:
    """The points to sub-pixel, searched from left to right and back, and halfway between the two answers."""
    a, b = (cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX) for grey in (left, right))
    whole = np.floor(p + 0.5)
    there = search_points(a, b, whole, q + whole - p, radius=RADIUS_PX, furthest_px=FURTHEST_PX)
    found = np.isfinite(there[:, 0])
    q = np.where(found[:, None], there[:, :2], 0.0)
    back = search_points(b, a, q, whole, radius=RADIUS_PX, furthest_px=FURTHEST_PX)
    # `back` speaks of the whole pixel next to q: the window's own shape carries its answer the rest of the way.
    off = q - np.floor(q + 0.5)
    shape = back[:, 5:9].reshape(-1, 2, 2)
    home = back[:, :2] + np.einsum("nij,nj->ni", shape, off)
    apart = home - whole
    with np.errstate(invalid="ignore"):
        good = found & (np.abs(apart).max(axis=1) < AGREE_PX) & (np.minimum(there[:, 4], back[:, 4]) > CORRELATION)
    sigma = np.sqrt(0.5 * (there[:, 3] ** 2 + back[:, 3] ** 2) + 0.25 * apart[:, 1] ** 2)
    return whole, q - apart / 2, sigma, good


def _straight(rig: Rig | None, p: Float64, q: Float64) -> tuple[Float64, Float64]:
    """The points as pinholes would see them, in pixels of the left plate; as they are where there is no rig."""
    if rig is None:
        return p, q
    f = rig.left.fy
    return rig.left.rays(p)[:, :2] * f, rig.right.rays(q)[:, :2] * f


def epipolar_inliers(p: Float64, q: Float64, *, rig: Rig | None = None, threshold_px: float = EPIPOLAR_PX) -> Bool:
    """(n,) which pairs agree on one epipolar geometry, by MAGSAC on the fundamental matrix.

    With a rig the lenses' bend is undone first.  The matrix is left free, not held to the rig's focal lengths: a zoom ring
    that moved is among the things to be found.
    """
    a, b = _straight(rig, p, q)
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    inlier = np.zeros(len(p), dtype=bool)
    if known.sum() < LEAST_FOR_GEOMETRY:
        return inlier
    cv2.setRNGSeed(SEED)
    F, mask = cv2.findFundamentalMat(a[known], b[known], cv2.USAC_MAGSAC, threshold_px, 0.9999, 5000)
    if F is not None and mask is not None:
        inlier[np.flatnonzero(known)[mask.ravel() > 0]] = True
    return inlier


def match_points(left: Float32, right: Float32, *, rig: Rig | None = None, most: int = 4000) -> Matches:
    """Points that both plates show, refined to sub-pixel and free of outliers.

    left, right : upright plates (H, W, 3), scene-linear; exposure and colour may differ.  NaN is unknown.
    rig         : undoes the lenses before the geometry is asked for; the rig itself need not be true any more.
    most        : points looked for in each eye.
    Raises      : PlateError when the plates differ in size or hold no light.  Few or no matches are an answer, not an error.
    """
    left, right = as_float32(left, "left plate", channels=3), as_float32(right, "right plate", channels=3)
    h, w = left.shape[:2]
    if right.shape != left.shape:
        raise PlateError(f"plates differ in size: left {w}x{h}, right {right.shape[1]}x{right.shape[0]}; give plates of one size")
    grey = grey_pair(left, right)
    scale = min(1.0, DETECT_SIDE_PX / max(h, w))
    (p, a), (q, b) = (_described(_eight_bit(g, scale), most) for g in grey)
    rows = _recognised(a, b)
    # Edges of the picture stay where they are when it is scaled.
    p, q = (p[rows[:, 0]] + 0.5) / scale - 0.5, (q[rows[:, 1]] + 0.5) / scale - 0.5
    found = len(rows)
    inlier = epipolar_inliers(p, q, rig=rig, threshold_px=2 * EPIPOLAR_PX / scale)
    p, q, sigma, good = _refined(*grey, p[inlier], q[inlier])
    p, q, sigma = p[good], q[good], sigma[good]
    _, first = np.unique(p, axis=0, return_index=True)
    first.sort()
    p, q, sigma = p[first], q[first], sigma[first]
    inlier = epipolar_inliers(p, q, rig=rig)
    return Matches(left=p[inlier], right=q[inlier], sigma_px=sigma[inlier], size=(w, h), found=found)
