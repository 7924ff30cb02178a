"""Motion blur: how far the picture smears while the shutter is open, frame by frame.

In: two successive scene-linear plates (H, W, 3) of one eye, NaN = unknown, or their flow (H, W, 2) px.  Out: px of the plate.
Extent = motion a frame * shutter, a share of the frame time (180 degrees: 0.5): how long a point's streak is.  Flow comes from
OpenCV's DIS on 8-bit pictures; where there is no texture there is no blur to see either, and those pixels have no say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, as_float32
from stereorelight.errors import PassError
from stereorelight.health.finding import Finding, Level
from stereorelight.health.picture import as_plate, flow_proxy, frames_named, grey, white_of

SHUTTER = 0.5  # 180 degrees
FLOW_WIDTH = 640  # px that flow is found at: a tenth of a pixel there is 0.3 px of a 1080p plate
TEXTURED = 2.0  # 8-bit levels of change from pixel to pixel; less is no edge that could smear
BLUR_NOTE_PX, BLUR_WARN_PX, BLUR_BAD_PX = 3.0, 8.0, 24.0  # of a 1920 px wide plate: softens edges; wider than a matching window; a smear
REFERENCE_WIDTH = 1920
FAST_SHARE = 0.95  # the streak that all but 5 % of the textured pixels stay under


@dataclass(frozen=True, kw_only=True)
class MotionBlur:
    """median_px, fast_px: streak of half the textured pixels, and of all but 5 %; width: of the plate, px."""

    median_px: float
    fast_px: float
    width: int
    shutter: float


def flow_between(plate: Float32, following: Float32) -> tuple[Float32, Float32]:
    """(flow (h, w, 2) in px of the plate, weight (h, w) 0/1 where there is texture to tell it by), at about FLOW_WIDTH wide."""
    import cv2

    first, second = grey(plate), grey(following)
    height, width = first.shape
    size = (min(FLOW_WIDTH, width), max(16, round(height * min(FLOW_WIDTH, width) / width)))
    white = max(white_of(first), white_of(second))
    a, b = (flow_proxy(light, white=white, size=size) for light in (first, second))
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow: Float32 = dis.calc(a, b, None) * np.array([width / size[0], height / size[1]], np.float32)
    soft = cv2.GaussianBlur(a.astype(np.float32), (0, 0), 1.0)
    slope = np.hypot(cv2.Sobel(soft, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(soft, cv2.CV_32F, 0, 1, scale=1 / 8))
    seen = cv2.resize((np.isfinite(first) & np.isfinite(second)).astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
    return flow, ((slope > TEXTURED) & seen).astype(np.float32)


def motion_blur(plate: Float32, following: Float32 | None = None, *, flow: Float32 | None = None, shutter: float = SHUTTER) -> MotionBlur:
    """Streaks in `plate`, from its motion to the `following` frame or from a given `flow` (H, W, 2) px, NaN where unknown.

    shutter : share of the frame time for which the shutter is open.
    Raises  : PassError where neither is given, sizes differ, the shutter lies outside 0..1, or nothing textured is seen.
    """
    plate = as_plate(plate, "plate")
    if not 0 < shutter <= 1:
        raise PassError(f"shutter must lie in 0..1 of the frame time, got {shutter:g}; 180 degrees is 0.5")
    if flow is not None:
        motion = as_float32(flow, "flow", channels=2, size_hw=(plate.shape[0], plate.shape[1]))
        length = np.hypot(motion[..., 0], motion[..., 1])
        length = length[np.isfinite(length)]
    elif following is not None:
        other = as_float32(following, "following plate", channels=3, size_hw=(plate.shape[0], plate.shape[1]))
        motion, weight = flow_between(plate, other)
        length = np.hypot(motion[..., 0], motion[..., 1])[weight > 0]
    else:
        raise PassError("motion blur wants the following frame or the flow to it; got neither")
    if length.size < 100:
        raise PassError(f"only {length.size} textured pixels to tell motion by, want 100")
    median, fast = np.quantile(length, (0.5, FAST_SHARE)) * shutter
    return MotionBlur(median_px=float(median), fast_px=float(fast), width=plate.shape[1], shutter=shutter)


def judge_blur(measured: Sequence[tuple[int | None, MotionBlur]]) -> Finding:
    """One Finding "motion blur" over a shot, by the 5 % that move fastest in the worst frame; value in px of the plate."""
    if not measured:
        return Finding(name="motion_blur", level="unknown", unit="px", words="Motion blur was not measured: it needs two frames with texture.")
    scale = measured[0][1].width / REFERENCE_WIDTH
    frame, worst = max(measured, key=lambda pair: pair[1].fast_px)
    size = worst.fast_px / scale
    level: Level = "bad" if size >= BLUR_BAD_PX else "warn" if size >= BLUR_WARN_PX else "note" if size >= BLUR_NOTE_PX else "good"
    typical = float(np.median([m.median_px for _, m in measured]))
    fast = [f for f, m in sorted(measured, key=lambda pair: -pair[1].fast_px) if m.fast_px / scale >= BLUR_WARN_PX]
    where = "" if frame is None else f" on frame {frame}"
    degrees = 360 * worst.shutter
    words = f"What moves fastest smears over {worst.fast_px:.1f} px{where} (shutter taken as {degrees:.0f} degrees); usually {typical:.1f} px"
    if level == "good":
        words = f"Motion blur is small: at most {worst.fast_px:.1f} px{where}"
    if fast and frames_named(fast):
        words += f"; worst: {frames_named(fast)}"
    remedy = "Depth and normals are soft along these streaks; trust them less there, or shoot with a shorter shutter and more light."
    return Finding(
        name="motion_blur",
        level=level,
        value=worst.fast_px,
        unit="px",
        words=words + ".",
        remedy="" if level in ("good", "note") else remedy,
        frames=tuple((f, m.fast_px) for f, m in measured),
        details={"median_px": typical, "shutter": worst.shutter},
    )
