"""Islands of disparity that are too small to be anything."""

from __future__ import annotations

import cv2

from stereorelight.arrays import Float32
from stereorelight.engine.sixteenths import NOWHERE, coded, kept


def without_speckles(disparity: Float32, smallest_px: int) -> Float32:
    """`disparity`, NaN on islands of fewer pixels."""
    sixteenths = coded(disparity)
    cv2.filterSpeckles(sixteenths, NOWHERE, smallest_px, 16)
    return kept(disparity, sixteenths)
