"""The plate's gain, checked once for both ways to a relit plate (comp.py and the fused kernel)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stereorelight.errors import ShotError


def checked_gain(plate_gain: float | Sequence[float]) -> tuple[float, float, float]:
    """`plate_gain` as three numbers, one a channel.  Raises ShotError."""
    try:
        values = tuple(float(v) for v in np.broadcast_to(np.asarray(plate_gain, dtype=np.float64), 3))
    except (TypeError, ValueError):
        raise ShotError(f"plate_gain must be one number or three, got {plate_gain!r}") from None
    if not all(math.isfinite(v) and v >= 0 for v in values):
        raise ShotError(f"plate_gain must be at least 0, got {plate_gain!r}; 1 keeps the plate's own light, 0 removes it")
    return values[0], values[1], values[2]
