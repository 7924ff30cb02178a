"""Depth edges put on picture edges: each doubtful pixel joins the surface beside it that looks like it.

In: disparity (H, W) px, a zone of doubtful pixels about jumps, and the picture (H, W, 3) uint8.  Out: disparity (H, W)."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def _joined(first, end, disparity, zone, picture, radius, jump, decay, decisive, out):
    H, W = disparity.shape
    for y in range(first, end):
        for x in range(W):
            d = disparity[y, x]
            out[y, x] = d
            if not zone[y, x]:
                continue
            y0, y1, x0, x1 = y - radius, y + radius + 1, x - radius, x + radius + 1
            y0, x0 = y0 if y0 >= 0 else y & 1, x0 if x0 >= 0 else x & 1
            y1, x1 = min(y1, H), min(x1, W)
            low, high = f4(np.inf), f4(-np.inf)
            for j in range(y0, y1, 2):
                for i in range(x0, x1, 2):
                    if not zone[j, i]:
                        low, high = min(low, disparity[j, i]), max(high, disparity[j, i])
            if not high - low > jump:  # one surface, or nothing to join
                continue
            middle = f4(0.5) * (low + high)
            far_weight, far_sum, near_weight, near_sum = f4(0), f4(0), f4(0), f4(0)
            b, g, r = f4(picture[y, x, 0]), f4(picture[y, x, 1]), f4(picture[y, x, 2])
            for j in range(y0, y1, 2):
                for i in range(x0, x1, 2):
                    if zone[j, i]:
                        continue
                    other = (abs(f4(picture[j, i, 0]) - b) + abs(f4(picture[j, i, 1]) - g) + abs(f4(picture[j, i, 2]) - r)) * decay
                    apart = f4((j - y) * (j - y) + (i - x) * (i - x))
                    weight = f4(1) / ((f4(1) + other * other) * (f4(1) + apart))
                    if disparity[j, i] < middle:
                        far_weight += weight
                        far_sum += weight * disparity[j, i]
                    else:
                        near_weight += weight
                        near_sum += weight * disparity[j, i]
            to_near = d >= middle
            if near_weight > decisive * far_weight:
                to_near = True
            elif far_weight > decisive * near_weight:
                to_near = False
            side_weight, side_sum = (near_weight, near_sum) if to_near else (far_weight, far_sum)
            # A pixel that lies on its side already keeps its own value: only ramps and strays move.
            if side_weight > f4(0) and abs(d - side_sum / side_weight) > jump:
                out[y, x] = side_sum / side_weight


def joined_to_sides(
    disparity: Float32, zone: Bool, picture: UInt8, *, radius_px: int = 6, jump_px: float = 1.5, tone_levels: float = 16.0, decisive: float = 4.0
) -> Float32:
    """Every pixel of `zone` takes the disparity of the near or the far side about it, never one between.

    The side that looks like the pixel wins where it does so by `decisive`; else the pixel keeps the side that it leaned to.
    radius_px   : even; how far to look for the two sides, every other pixel.
    tone_levels : difference of tone, grey levels, at which likeness falls to a half.
    """
    out = np.empty_like(disparity)
    given = (disparity, zone, picture, radius_px, f4(jump_px), f4(1 / (3 * tone_levels)), f4(decisive), out)
    in_row_blocks(lambda first, end: _joined(first, end, *given), disparity.shape[0])
    return out
