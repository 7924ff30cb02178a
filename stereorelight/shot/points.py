"""Picture points over a shot: where a pixel that was picked on one frame lies on the others, by optical flow.

In: the plates, frame by frame.  Out: (x, y) on a frame.  What comes out depends on the footage alone, not on the part of the
shot that is run: the way always leads from the picked frame, one frame at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.errors import ShotError
from stereorelight.light.animate import Stuck
from stereorelight.stereo.carry import Carried, carry, flow_picture, nothing_carried, white_of


@dataclass(kw_only=True, eq=False)
class _Way:
    """What is known of the points picked on one frame, going one way."""

    known: dict[int, Float32] = field(default_factory=dict)
    last: tuple[int, Carried, UInt8] | None = None
    white: float = 1.0


@dataclass(kw_only=True, eq=False)
class Points:
    """The points that a shot's lights go with.

    stuck   : all of them.             numbers : every frame of the shot, rising.
    plate   : the upright left plate of a frame.
    """

    stuck: Sequence[Stuck]
    numbers: Sequence[int]
    plate: Callable[[int], Float32]
    _ways: dict[tuple[int, int], _Way] = field(default_factory=dict)

    def way(self, stuck: Stuck, frame: int | None) -> list[int]:
        """The frames from the picked one to `frame`, both included; [] where nothing is tracked."""
        if stuck.frame is None or frame is None or stuck.frame == frame:
            return []
        low, high = sorted((stuck.frame, frame))
        between = [n for n in self.numbers if low <= n <= high]
        return between if stuck.frame < frame else between[::-1]

    def at(self, stuck: Stuck, frame: int | None) -> tuple[float, float]:
        """Where the point lies on `frame`, pixels.  Raises ShotError at a cut."""
        way = self.way(stuck, frame)
        if not way or frame is None or stuck.frame is None:
            return stuck.pixel
        together = [s.pixel for s in self.stuck if s.frame == stuck.frame]
        trail = self._ways.setdefault((stuck.frame, 1 if frame > stuck.frame else -1), _Way())
        if frame not in trail.known:
            begin = 1
            if trail.last is not None and trail.last[0] in way:
                last, carried, then = trail.last
                begin = way.index(last) + 1
            else:
                first = self.plate(way[0])
                trail.white = white_of(first)
                carried = nothing_carried((first.shape[0], first.shape[1]), np.array(together, np.float32))
                then = flow_picture(first, trail.white)
            for number in way[begin:]:
                now = flow_picture(self.plate(number), trail.white)
                onward = carry(carried, then, now)
                if onward is None:
                    x, y = stuck.pixel
                    raise ShotError(
                        f"the point ({x:g}, {y:g}) of frame {stuck.frame} cannot be tracked to frame {number}: it shows something else than the "
                        "frame before; end the light at the cut by keys of intensity, and pick a point for a second light there"
                    )
                carried, then = onward, now
                trail.known[number] = carried.points
                trail.last = (number, carried, then)
        x, y = trail.known[frame][together.index(stuck.pixel)]
        return float(x), float(y)
