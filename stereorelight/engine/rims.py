"""Where the rims of plain ground lie, row by row: what matching by support cannot say, since there a rim goes with the ground beside it.

In: grey pictures (H, W) float32, rows agreeing, a disparity (H, W) px to look about, and which pixels are rims.
Out: (H, W) float32, the disparity of each rim, NaN elsewhere and where no one disparity is clearly the best."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32
ALONG, DOWN = 4, 1  # px to either side that are compared
REACH = 4  # whole px beyond what is said about a rim that are looked at
MOST_AWAY = 6.0  # px from what is said at the rim itself
MEAN_SHARE = 0.8  # of what an even difference of brightness explains: a rim is a step, and must not be explained away
CLEAR, NOISE2 = 1.3, 2.0  # how much more the disparities beside the best must cost; what a pixel costs anyhow, grey levels squared


@njit(cache=True, nogil=True, error_model="numpy")
def _cost(left, right, y, x, q):
    """What a disparity of q costs at a pixel: squares of the differences about it, less most of what an even difference explains."""
    s, ss = f4(0), f4(0)
    for j in range(y - DOWN, y + DOWN + 1):
        for i in range(x - ALONG, x + ALONG + 1):
            e = left[j, i] - right[j, i - q]
            s += e
            ss += e * e
    return ss - f4(MEAN_SHARE) * s * s / f4((2 * ALONG + 1) * (2 * DOWN + 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _rim_rows(first, end, left, right, rim, about, out):
    H, W = left.shape
    count = f4((2 * ALONG + 1) * (2 * DOWN + 1))
    for y in range(max(first, DOWN), min(end, H - DOWN)):
        for x in range(ALONG, W - ALONG):
            if not rim[y, x]:
                continue
            low, high = about[y, x], about[y, x]
            for i in range(x - ALONG, x + ALONG + 1):
                low, high = min(low, about[y, i]), max(high, about[y, i])
            start = int(np.floor(max(low, about[y, x] - f4(MOST_AWAY)))) - REACH
            stop = int(np.ceil(min(high, about[y, x] + f4(MOST_AWAY)))) + REACH
            start, stop = max(start, x + ALONG - W + 1), min(stop, x - ALONG)  # what lies in the other picture
            best, at, before, after, last = f4(np.inf), start, f4(np.inf), f4(np.inf), f4(np.inf)
            for q in range(start, stop + 1):
                c = _cost(left, right, y, x, q)
                if q == at + 1:
                    after = c
                if c < best:
                    best, at, before, after = c, q, last, f4(np.inf)
                last = c
            if start < at < stop and min(before, after) > f4(CLEAR) * (best + f4(NOISE2) * count):
                out[y, x] = f4(at) + f4(0.5) * (before - after) / (before - f4(2) * best + after)


def rim_disparity(left: Float32, right: Float32, rim: Bool, about: Float32) -> Float32:
    """Disparity of the pixels that are `rim`, found anew over a few pixels of their own row and those beside it; NaN where it is not clear.

    about : (H, W) px, finite; looked at are whole disparities near those that it has within a few pixels of the rim.
    """
    out = np.full(left.shape, np.nan, np.float32)
    in_row_blocks(lambda first, end: _rim_rows(first, end, left, right, rim, about, out), left.shape[0])
    return out
