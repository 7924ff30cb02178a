"""The draft: everything at half size, then carried up along local planes, each pixel on the side of an edge that it looks like.

In: a `Refined` of half the size, and the picture at full size.  Out: the `Refined` at full size.  A quarter of the pixels and half of the
disparities are an eighth of the matching."""

from __future__ import annotations

import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.bends import slopes
from stereorelight.engine.resample import doubled_planes
from stereorelight.engine.rows import at_once
from stereorelight.stereo.halves import nearest
from stereorelight.stereo.refine import CUT_PX, Refined, lined

HALF_SIZE_SIGMA_PX = 0.12  # what pictures of half the size are off by whatever their own noise says: aliasing and lost detail


def full_size(refined: Refined, picture: UInt8) -> Refined:
    """A half-size `Refined` on the full-size picture (H, W, 3)."""
    size = (picture.shape[0], picture.shape[1])

    def surface() -> tuple[Float32, Float32, Float32]:
        disparity = lined(doubled_planes(refined.disparity, (refined.slope_x, refined.slope_y), size), picture)
        return disparity, *slopes(disparity, cut=CUT_PX)

    def rest() -> tuple[Bool, Float32, Float32, Float32]:
        sigma = np.hypot(2 * refined.sigma_px, np.float32(HALF_SIZE_SIGMA_PX))
        unseen = nearest(refined.unseen.view(np.uint8), size).view(np.bool_)
        return unseen, nearest(sigma, size), nearest(refined.slope_sigma, size), nearest(refined.clumped, size)

    (disparity, slope_x, slope_y), (unseen, sigma, slope_sigma, clumped) = at_once(surface, rest)
    return Refined(
        disparity=disparity,
        slope_x=slope_x,
        slope_y=slope_y,
        unseen=unseen,
        sigma_px=sigma,
        slope_sigma=slope_sigma,
        clumped=clumped,
    )
