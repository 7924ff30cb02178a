"""Chance islands in ground that the other eye's frame does not hold.

In: where a match is firm, and what it says.  Out: the same without small islands that lie farther than ground like them to their right.
The strip of one eye's picture that lies beyond the other's frame has nothing to match, and a few of its pixels match something all the same.
All of the strip would then be filled from them.  A true island of background beside something near looks like the background."""

from __future__ import annotations

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8

ISLAND_PX = 300  # smaller ones are asked
REACH_PX = 64  # to the right, where the ground is looked for that they would belong to
NEARER_PX = 2.0  # how much nearer that ground lies
BESIDE, ACROSS = 4, 12  # px into that ground from its edge, and of it, whose colour is compared
ALIKE = 25.0  # grey levels of the channel that differs most, by which colours are one


def without_islands(firm: Bool, large: Bool, disparity: Float32, picture: UInt8) -> Bool:
    """(H, W) bool: `firm` without chance islands.

    large     : the part of `firm` that is no island of fewer than `ISLAND_PX`.   disparity: (H, W) px.   picture: (H, W, 3) of the same eye.
    """
    farthest = float(disparity[large].max(initial=0))  # columns into the left picture that the other eye's frame may begin
    whole, width = firm, min(firm.shape[1], int(farthest) + 1 + REACH_PX + BESIDE + ACROSS)
    firm, large, disparity = firm[:, :width], large[:, :width], disparity[:, :width]
    small = firm & ~large
    if not small[:, : int(np.ceil(min(farthest, width)))].any():
        return whole
    n, island = cv2.connectedComponents(small.view(np.uint8))
    all_of = np.bincount(island.ravel(), minlength=n)
    y, x = np.nonzero(small & (np.arange(width) < farthest))
    columns = x[:, None] + np.arange(REACH_PX)
    there = np.minimum(columns, width - 1)
    d = disparity[y[:, None], there]
    # Ground that would land before the other eye's frame, were it to go on to here.
    nearer = large[y[:, None], there] & (columns < width) & (d > disparity[y, x][:, None] + np.float32(NEARER_PX)) & (d > x[:, None])
    found = nearer.any(axis=1)
    edge = x + nearer.argmax(axis=1)
    beside = np.minimum(edge[:, None] + BESIDE + np.arange(ACROSS), width - 1)
    ground = picture[y[:, None], beside].astype(np.float32).mean(axis=1)
    of = island[y, x]
    found_of = np.bincount(of, found, n)
    own = picture[y, x].astype(np.float32)
    off = np.stack([np.bincount(of, found * (own[:, c] - ground[:, c]), n) for c in range(own.shape[1])], axis=1)
    chance = (2 * found_of > all_of) & (np.abs(off).max(axis=1) < ALIKE * np.maximum(found_of, 1))
    out = whole.copy()
    out[:, :width] &= ~chance[island]
    return out
