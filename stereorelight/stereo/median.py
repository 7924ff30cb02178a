"""OpenCV's median, which runs on one core, on two.

In, out: (H, W) float32."""

from __future__ import annotations

import cv2
import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.rows import at_once

REACH = 2  # px
SMALLEST = 64  # rows that are worth parting


def median_5(a: Float32) -> Float32:
    """The median of the 5 x 5 about each pixel; beyond the frame the border is repeated."""
    height = a.shape[0]
    if height < SMALLEST:
        return cv2.medianBlur(a, 2 * REACH + 1)
    half, out = height // 2, np.empty_like(a)

    def upper() -> None:
        out[:half] = cv2.medianBlur(a[: half + REACH], 2 * REACH + 1)[:half]

    def lower() -> None:
        out[half:] = cv2.medianBlur(a[half - REACH :], 2 * REACH + 1)[REACH:]

    at_once(upper, lower)
    return out
