"""Semi-global matching (Hirschmüller 2008, OpenCV's SGBM) of either eye, and the range that is searched.

In: a `Proxy` (rectified, 8-bit, one tone).  Out: disparities (H, W) float32, x_left - x_right in pixels, NaN where
unmatched.  Disparities of both signs are normal: a converged rig has them on both sides of its convergence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, UInt8
from stereorelight.engine.rows import at_once
from stereorelight.engine.sixteenths import as_pixels
from stereorelight.stereo.proxy import Proxy

BLOCK = 3
MOST_CELLS = 400_000_000  # pixels times disparities that eight directions are kept for, at about 4 bytes each
SPECKLE_PX = 60  # an island of disparity smaller than this is a wrong match
P1, P2 = 2 * BLOCK**2, 30 * BLOCK**2  # penalties of a step by one and of a jump, per channel: low for steps, since planes smooth later; high for
# jumps, since adaptive support finds the outlines and wants one answer on a wall that repeats


@dataclass(frozen=True, kw_only=True)
class DisparityRange:
    """Whole pixels searched: low <= d < low + count; count is a multiple of 16, as SGBM wants it."""

    low: int
    count: int

    @classmethod
    def holding(cls, low_px: float, high_px: float) -> DisparityRange:
        low = int(np.floor(low_px))
        return cls(low=low, count=16 * max(1, -(-(int(np.ceil(high_px)) + 1 - low) // 16)))

    @property
    def high(self) -> int:
        return self.low + self.count

    def halved(self) -> DisparityRange:
        """The range in pixels of half the size."""
        return DisparityRange.holding(self.low / 2, self.high / 2)

    def doubled(self) -> DisparityRange:
        """The range in pixels of twice the size."""
        return DisparityRange(low=2 * self.low, count=2 * self.count)


def _raw(matcher: Any, picture: UInt8, other: UInt8, *, before: int, after: int) -> npt.NDArray[np.int16]:
    """The matcher's sixteenths on `picture`, with so many columns repeated before and after the frame.

    SGBM drops the columns whose candidates leave the frame: room for them is needed on the side where they leave, and harms
    on the other, where repeated columns match repeated columns.
    """
    a, b = (cv2.copyMakeBorder(p, 0, 0, before, after, cv2.BORDER_REPLICATE) for p in (picture, other))
    raw: npt.NDArray[np.int16] = matcher.compute(a, b)[:, before : before + picture.shape[1]]
    return np.ascontiguousarray(raw)


def sgbm(proxy: Proxy, search: DisparityRange, *, exhaustive: bool = False, stiffness: float = 1.0, jump: int = P2) -> cv2.StereoSGBM:
    channels = proxy.left.shape[2] if proxy.left.ndim == 3 else 1
    cells = proxy.left.shape[0] * (proxy.left.shape[1] + search.count) * search.count
    mode = cv2.STEREO_SGBM_MODE_HH4 if exhaustive and cells <= MOST_CELLS else cv2.STEREO_SGBM_MODE_SGBM_3WAY
    step = round(P1 * channels * stiffness)
    return cv2.StereoSGBM_create(search.low, search.count, BLOCK, step, jump * channels, 1, 63, 0, SPECKLE_PX, 1, mode)


def left_px(matcher: cv2.StereoSGBM, proxy: Proxy, search: DisparityRange) -> Float32:
    raw = _raw(matcher, proxy.left, proxy.right, before=max(0, search.high), after=max(0, -search.low))
    return as_pixels(raw, search.low)


def both_eyes(proxy: Proxy, search: DisparityRange) -> tuple[Float32, Float32]:
    """Each eye's own disparity by SGBM alone, three directions: quick, and stiff.  For small copies."""
    matcher = sgbm(proxy, search)
    return at_once(lambda: left_px(matcher, proxy, search), lambda: right_px(sgbm(proxy, search), proxy, search))


def right_px(matcher: cv2.StereoSGBM, proxy: Proxy, search: DisparityRange) -> Float32:
    raw = _raw(cv2.ximgproc.createRightMatcher(matcher), proxy.right, proxy.left, before=max(0, -search.low), after=max(0, search.high))
    return as_pixels(raw, 1 - search.high, sign=-1)  # the right matcher counts x_right - x_left
