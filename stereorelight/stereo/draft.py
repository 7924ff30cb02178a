"""The draft: everything at half size, then carried up along local planes, each pixel on the side of an edge that it looks like.

In: a `Proxy`; a `Refined` of half its size.  Out: the half-size `Proxy`; the `Refined` at full size.  A quarter of the pixels and half
of the disparities are an eighth of the matching."""

from __future__ import annotations

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.bending import slopes
from stereorelight.stereo.halves import nearest
from stereorelight.stereo.match import DisparityRange
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.refine import CUT_PX, Refined, lined

HALF_SIZE_SIGMA_PX = 0.12  # what pictures of half the size are off by whatever their own noise says: aliasing and lost detail


def half_range(search: DisparityRange) -> DisparityRange:
    """The range in pixels of half the size."""
    return search.halved()


def _along_planes(refined: Refined, size_hw: tuple[int, int]) -> Float32:
    """Disparity, full-size px: each half-size pixel's plane at the four pixels that it was."""
    h, w = (n + n % 2 for n in size_hw)
    out = np.empty((h, w), np.float32)
    rows, columns = refined.disparity.shape
    across, down = 0.5 * refined.slope_x, 0.5 * refined.slope_y
    middle = 2 * refined.disparity
    for y, dy in ((0, -down), (1, down)):
        for x, dx in ((0, -across), (1, across)):
            out[y : 2 * rows : 2, x : 2 * columns : 2] = middle + dx + dy
    out[2 * rows :] = out[2 * rows - 1]  # an odd last row or column repeats the one before
    out[:, 2 * columns :] = out[:, 2 * columns - 1 : 2 * columns]
    return np.ascontiguousarray(out[: size_hw[0], : size_hw[1]])


def full_size(refined: Refined, proxy: Proxy) -> Refined:
    """A half-size `Refined` on the full-size `proxy`."""
    size = proxy.left_grey.shape
    disparity = lined(_along_planes(refined, size), proxy.left)
    slope_x, slope_y = slopes(disparity, cut=CUT_PX)
    return Refined(
        disparity=disparity,
        slope_x=slope_x,
        slope_y=slope_y,
        unseen=nearest(refined.unseen.view(np.uint8), size).view(np.bool_),
        sigma_px=np.hypot(2 * nearest(refined.sigma_px, size), np.float32(HALF_SIZE_SIGMA_PX)),
        slope_sigma=nearest(refined.slope_sigma, size),
    )
