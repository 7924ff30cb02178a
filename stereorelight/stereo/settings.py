"""The dials of depth recovery: one trade-off, the range, and the rest under `advanced` names."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stereorelight.errors import ShotError, nearest_hint

QUALITIES = ("draft", "standard", "fine")
TIMES = ("on", "off")
WIDEST_WINDOW = 4  # frames before and after


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """How depth is recovered.

    quality            : draft, standard or fine.
    near_m, far_m      : nearest and farthest distance to search; None finds them from the pictures.
    consistency_px     : left-right difference above which a match is not believed.
    fill               : give every pixel a value, flagged FILLED where it is a guess.
    time               : "on" steadies a frame of a shot by its neighbours, "off" takes each alone.
    time_window        : how many frames before and after may speak, 0 to 4.
    matcher            : "sgbm", the toolkit's own; "onnx:FILE"; or a registered name (stereo/matchers.py).
    """

    quality: str = "standard"
    near_m: float | None = None
    far_m: float | None = None
    consistency_px: float = 1.0
    fill: bool = True
    matcher: str = "sgbm"
    time: str = "on"
    time_window: int = 2

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise ShotError(f"depth quality {self.quality!r} is unknown{nearest_hint(str(self.quality), QUALITIES)}")
        for name in ("near_m", "far_m"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ShotError(f"depth {name} must be > 0 metres, got {value!r}")
        if self.near_m is not None and self.far_m is not None and self.near_m >= self.far_m:
            raise ShotError(f"depth near_m must be less than far_m, got {self.near_m:g} and {self.far_m:g}")
        if self.time not in TIMES:
            raise ShotError(f"depth time {self.time!r} is unknown{nearest_hint(str(self.time), TIMES)}")
        if not 0 <= self.time_window <= WIDEST_WINDOW:
            raise ShotError(f"depth time_window must be 0 to {WIDEST_WINDOW} frames before and after, got {self.time_window!r}")
        if not self.matcher:
            raise ShotError("depth matcher must be a name; leave it out for the toolkit's own")
        if not self.consistency_px > 0:
            raise ShotError(f"depth consistency_px must be > 0, got {self.consistency_px!r}")
