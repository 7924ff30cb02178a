"""What the measurements of one picture share: grey, known pixels, the 8-bit proxy for flow, and how frames are named in words.

In: scene-linear plates (H, W, 3) float32, NaN = unknown.  Pixels: (0, 0) is the centre of the top-left pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8, as_float32
from stereorelight.errors import PassError

MID_GREY = 0.18
GREY = (0.25, 0.5, 0.25)  # any working space: green carries half, as half of a sensor's sites do
NAMED_FRAMES = 6  # a sentence names so many frames, and counts the rest


def as_plate(plate: Float32, name: str) -> Float32:
    """`plate` checked: (H, W, 3) float, at least 32 pixels a side."""
    checked = as_float32(plate, name, channels=3)
    if min(checked.shape[:2]) < 32:
        raise PassError(f"{name} must be at least 32 pixels a side, got {checked.shape[1]}x{checked.shape[0]}")
    return checked


def grey(plate: Float32) -> Float32:
    """(H, W) the weighted mean of the channels; NaN where any of them is unknown."""
    import cv2

    light: Float32 = cv2.transform(plate, np.array([GREY], np.float32))
    return light


def known(plate: Float32) -> Bool:
    """(H, W) where every channel is finite."""
    return np.isfinite(grey(plate))


def white_of(light: Float32) -> float:
    """A white that hot pixels do not move: the 99th percentile of the finite part of a sample; 0 where there is none."""
    step = max(1, int(np.sqrt(light.size / 40_000)))
    sample = light[::step, ::step]
    sample = sample[np.isfinite(sample)]
    return max(float(np.quantile(sample, 0.99)), 0.0) if sample.size else 0.0


def flow_proxy(light: Float32, *, white: float, size: tuple[int, int]) -> UInt8:
    """Grey as 8 bits at `size` (w, h), coded by its square root so that grain is equally strong in light and shade."""
    import cv2

    small = cv2.resize(np.nan_to_num(light, nan=0.0, posinf=white, neginf=0.0), size, interpolation=cv2.INTER_AREA)
    coded: UInt8 = np.clip(np.sqrt(np.maximum(small, 0) / max(white * 1.25, 1e-9)) * 255 + 0.5, 0, 255).astype(np.uint8)
    return coded


def frames_named(frames: Sequence[int | None]) -> str:
    """`frame 1003`, `frames 1003, 1004 and 9 more`; "" where the frames have no numbers."""
    numbers = [str(frame) for frame in frames if frame is not None]
    if not numbers:
        return ""
    shown = ", ".join(numbers[:NAMED_FRAMES])
    more = f" and {len(numbers) - NAMED_FRAMES} more" if len(numbers) > NAMED_FRAMES else ""
    return f"frame{'s' if len(numbers) > 1 else ''} {shown}{more}"


def on_frame(frame: int | None) -> str:
    """` (frame 1003)`, or "" for a still."""
    return "" if frame is None else f" (frame {frame})"
