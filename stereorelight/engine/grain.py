"""How much light flutters from pixel to pixel, block by block: what grain is measured from.

In: tone levels (H, W, 3) uint16, as `engine.tone.levels` gives them.  Out: per block its light and two variances, linear light, 1 at white."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, UInt16
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.tone import LEVELS

f4 = np.float32
BLOCK = 8  # px
MARGIN = 2  # px that the wide mask reaches beyond a block


@njit(cache=True, nogil=True, error_model="numpy")
def _twist2(light, y, x, k):
    """Square of the mask 1 -2 1, -2 4 -2, 1 -2 1 with its taps k px apart, over that of its weights (36)."""
    t = f4(4) * light[y, x] - f4(2) * (light[y - k, x] + light[y + k, x] + light[y, x - k] + light[y, x + k])
    t += light[y - k, x - k] + light[y - k, x + k] + light[y + k, x - k] + light[y + k, x + k]
    return t * t * f4(1 / 36)


@njit(cache=True, nogil=True, error_model="numpy")
def _flutter(first, end, level, step, squares, light, near, far):
    reach = BLOCK + 2 * MARGIN
    patch = np.empty((reach, reach), np.float32)
    for row in range(first, end):
        for column in range(light.shape[1]):
            top, left = row * step, column * step
            bad = False
            for y in range(reach):
                for x in range(reach):
                    v = level[top + y, left + x, 1]
                    bad |= (v == 0) | (v == LEVELS - 1)
                    patch[y, x] = squares[v]
            total, one, two = f4(0), f4(0), f4(0)
            for y in range(MARGIN, MARGIN + BLOCK, 2):
                for x in range(MARGIN, MARGIN + BLOCK):
                    total += patch[y, x]
                    one += _twist2(patch, y, x, 1)
                    two += _twist2(patch, y, x, 2)
            n = f4(BLOCK * BLOCK // 2)
            light[row, column] = np.nan if bad else total / n
            near[row, column], far[row, column] = one / n, two / n


def flutter(level: UInt16, *, step: int) -> tuple[Float32, Float32, Float32]:
    """Light of blocks `step` px apart, and the variance of white grain that would flutter as they do at one pixel's distance and at two.

    Of green; light is NaN where a pixel is black or white, since grain is cut off there.  No ramp of light flutters (Immerkaer 1996).
    """
    size = tuple(max(0, (n - BLOCK - 2 * MARGIN) // step + 1) for n in level.shape[:2])
    squares = (np.arange(LEVELS, dtype=np.float32) / f4(LEVELS - 1)) ** 2
    light, near, far = (np.empty(size, np.float32) for _ in range(3))
    in_row_blocks(lambda first, end: _flutter(first, end, level, step, squares, light, near, far), size[0], block_rows=4)
    return light, near, far
