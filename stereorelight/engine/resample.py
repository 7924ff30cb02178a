"""Exact picture look-ups at real-valued pixels (OpenCV's `remap` rounds its maps to 1/32 px, which shows in disparity).

In: pictures (H, W, C) float32 and maps (h, w, 2) float32 of source pixels (u, v).  Out: (h, w, C) float32."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from stereorelight.arrays import Float32
from stereorelight.engine.locks import KERNEL_LOCK

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cubic(t):
    """Catmull-Rom weights at fraction t."""
    a = f4(0.5) * t * (f4(-1) + t * (f4(2) - t))
    b = f4(1) + f4(0.5) * t * t * (f4(-5) + f4(3) * t)
    c = f4(0.5) * t * (f4(1) + t * (f4(4) - f4(3) * t))
    d = f4(0.5) * t * t * (t - f4(1))
    return a, b, c, d


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _bicubic(picture, pixels, out):
    H, W, C = picture.shape
    h, w = pixels.shape[:2]
    for y in prange(h):
        for x in range(w):
            u, v = pixels[y, x, 0], pixels[y, x, 1]
            # NaN and everything outside the outer pixel edges is unknown.
            if not (u >= f4(-0.5) and v >= f4(-0.5) and u <= f4(W - 0.5) and v <= f4(H - 0.5)):
                for c in range(C):
                    out[y, x, c] = np.nan
                continue
            x0, y0 = int(np.floor(u)), int(np.floor(v))
            wx, wy = _cubic(u - f4(x0)), _cubic(v - f4(y0))
            for c in range(C):
                total = f4(0)
                for j in range(4):
                    yy = min(max(y0 - 1 + j, 0), H - 1)
                    row = f4(0)
                    for i in range(4):
                        row += wx[i] * picture[yy, min(max(x0 - 1 + i, 0), W - 1), c]
                    total += wy[j] * row
                out[y, x, c] = total


def bicubic(picture: Float32, pixels: Float32) -> Float32:
    """`picture` at `pixels` by Catmull-Rom; the border is repeated, and beyond the frame is NaN."""
    out = np.empty((*pixels.shape[:2], picture.shape[2]), np.float32)
    with KERNEL_LOCK:
        _bicubic(picture, pixels, out)
    return out
