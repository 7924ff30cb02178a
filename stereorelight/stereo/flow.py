"""The second opinion: dense inverse search optical flow (Kroeger et al. 2016, OpenCV's DIS) between the eyes.

In: a `Proxy`.  Out: disparity (H, W) float32 by a method that shares no step with semi-global matching, NaN where flow
there and back disagree.  It knows no rows, so its vertical part also tells how well the pair is rectified."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.engine.rows import at_once
from stereorelight.stereo.proxy import Proxy

VERTICAL_LIMIT_PX = 2.0  # a match that leaves its row by more is no stereo match


@dataclass(frozen=True, kw_only=True, eq=False)
class FlowMatch:
    """disparity (H, W) px, NaN where unconfirmed; vertical_px: median row error of the confirmed pixels."""

    disparity: Float32
    vertical_px: float


def _look_up(flow: Float32, at: Float32) -> Float32:
    grid = np.stack(np.meshgrid(np.arange(flow.shape[1], dtype=np.float32), np.arange(flow.shape[0], dtype=np.float32)), axis=-1)
    return cv2.remap(flow, grid + at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(1e6, 1e6))


def _flow(picture: UInt8, other: UInt8) -> Float32:
    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST).calc(picture, other, None)


def flow_disparity(proxy: Proxy, *, within_px: float = 1.0) -> FlowMatch:
    """Disparity by optical flow on half-size pictures, checked there and back to `within_px` of the full size."""
    height, width = proxy.left_grey.shape
    half = (max(width // 2, 16), max(height // 2, 16))
    left, right = (cv2.resize(p, half, interpolation=cv2.INTER_AREA).astype(np.uint8) for p in (proxy.left_grey, proxy.right_grey))
    there, back = at_once(lambda: _flow(left, right), lambda: _flow(right, left))
    size = np.array([width / half[0], height / half[1]], np.float32)
    residual = (there + _look_up(back, there)) * size
    there = there * size
    agrees = (np.abs(residual).max(axis=2) <= within_px) & (np.abs(there[..., 1]) <= VERTICAL_LIMIT_PX)
    vertical = float(np.median(there[..., 1][agrees])) if agrees.any() else float("nan")
    small = np.where(agrees, -there[..., 0], np.float32(np.nan))
    return FlowMatch(disparity=cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST), vertical_px=vertical)
