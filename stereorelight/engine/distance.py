"""From disparity to Z, with what goes along, in one pass.

In: disparity of either eye at the pixels of a plate, (H, W) px, its standard deviation, flags and confidence.  Out: Z in metres along
that plate's optical axis and its standard deviation, (H, W) float32, NaN where there is none."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, Float64, UInt16
from stereorelight.engine.rows import in_pieces

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def _distances(first, end, disparity, stretch, per, doffs, smallest, far_flag, dropped, flags, sure, sigma, Z, Z_sigma):
    W = disparity.shape[1]
    one = stretch.size == 1
    for y in range(first, end):
        for x in range(W):
            off = disparity[y, x] + f4(doffs)
            far = off < smallest
            if far:
                flags[y, x] |= far_flag
            q = np.float64(disparity[y, x]) + doffs
            z = f4(per / q * (stretch[0, 0] if one else stretch[y, x]))
            known = q > 0.0 and not far and flags[y, x] & dropped == 0 and np.isfinite(z)
            if not known:
                z, sure[y, x], sigma[y, x] = f4(np.nan), f4(0), f4(np.nan)
            Z[y, x], Z_sigma[y, x] = z, z * sigma[y, x] / off


def distances(
    disparity: Float32,
    flags: UInt16,
    sure: Float32,
    sigma: Float32,
    *,
    per: float,
    doffs: float,
    stretch: Float64,
    smallest: float,
    far_flag: int,
    dropped: int,
) -> tuple[Float32, Float32]:
    """Z = per / (disparity + doffs) stretch, and its standard deviation Z sigma / (disparity + doffs); `flags`, `sure` and `sigma` are written to.

    per      : focal length times baseline, px m.   doffs : px.   stretch : (1,) or (H, W), Z on the plate over Z on the rectified view.
    smallest : px of disparity + doffs below which a pixel is flagged `far_flag` and has no Z.   dropped : pixels with such a flag have none either.
    Where there is no Z, `sure` becomes 0 and `sigma` NaN.
    """
    Z, Z_sigma = np.empty(disparity.shape, np.float32), np.empty(disparity.shape, np.float32)
    given = (disparity, np.atleast_2d(stretch), per, doffs, f4(smallest), np.uint16(far_flag), np.uint16(dropped), flags, sure, sigma, Z, Z_sigma)
    in_pieces(lambda first, end: _distances(first, end, *given), disparity.shape[0])
    return Z, Z_sigma
