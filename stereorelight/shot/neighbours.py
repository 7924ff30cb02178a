"""The frames about a frame, whose depth steadies its own: `[depth] time` and `time_window` of the shot file.

In: the shot's plates.  Out: the depth of a frame alone, and steadied by its neighbours.  What a frame gives depends on the
plates of its window alone, whatever part of the shot is run; neighbours outside that part are recovered for it.
What the next frames need again is kept: a window's worth, however long the shot."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError
from stereorelight.footage.eyes import Eyes
from stereorelight.footage.sequence import frame_range
from stereorelight.shot.hints import hints_of
from stereorelight.shot.pairs import Pair, read_upright, recover_pair
from stereorelight.shot.schema import Shot
from stereorelight.stereo.depth import Recovered
from stereorelight.stereo.rectify import Rectification
from stereorelight.stereo.temporal import Glimpse, Motion, Steadied, glimpse, motion_between, steadied

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, eq=False)
class Alone:
    """The depth of one frame by itself, how it was found, and what its neighbours see of it."""

    figures: dict[str, Any]
    told: Glimpse


class _Kept(OrderedDict[Any, T]):
    """The last `most` values that were asked for."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    def of(self, key: Any, make: Callable[[], T]) -> T:
        if key not in self:
            self[key] = make()
        self.move_to_end(key)
        while len(self) > self.most:
            self.popitem(last=False)
        return self[key]


def search_figures(found: Recovered) -> dict[str, Any]:
    """Disparities searched, median row error, and how the colours were matched, for the receipt."""
    vertical = round(found.vertical_px, 3) if math.isfinite(found.vertical_px) else None
    figures: dict[str, Any] = {"searched_px": [found.search.low, found.search.high], "vertical_px": vertical}
    return figures if found.colour is None else figures | {"colour_match": found.colour.to_dict()}


def numbers_of_shot(shot: Shot, eyes: Eyes) -> tuple[int, ...]:
    """The frames of the shot file that both eyes have, whatever part of them is run."""
    wanted = frame_range(shot.tables.plates.frames) if shot.tables.plates.frames else eyes.left.frames
    left, right = set(eyes.left.frames), set(eyes.right.frames)
    return tuple(n for n in wanted if n in left and n + eyes.shift in right)


class Neighbours:
    """Depths of single frames, kept as long as frames near them may ask for them."""

    def __init__(self, shot: Shot, eyes: Eyes, rectified: Callable[[Pair], Rectification], px_m: float) -> None:
        """rectified : the rectification of a frame.   px_m : fx b of the rectified rig, px m."""
        self._shot, self._eyes, self._rectified, self._px_m = shot, eyes, rectified, px_m
        self.window = shot.depth.time_window if shot.depth.time == "on" and eyes.frames else 0
        self._numbers = numbers_of_shot(shot, eyes) if self.window else ()
        self._have = set(self._numbers)
        self._step = min((b - a for a, b in zip(self._numbers, self._numbers[1:])), default=1)
        self._alone: _Kept[Alone] = _Kept(2 * self.window + 1)
        self._motions: _Kept[tuple[Motion, Motion]] = _Kept(self.window * (self.window + 1))
        self._plates: _Kept[Float32] = _Kept(self.window + 1)

    def pairs_about(self, pair: Pair) -> dict[int, Pair]:
        """The neighbours that may speak for a frame, by their distance in frames of the shot; without the frame itself."""
        if pair.number is None:
            return {}
        out = {}
        for k in range(-self.window, self.window + 1):
            number = pair.number + k * self._step
            if k and number in self._have:
                out[k] = Pair(number=number, left=self._eyes.left, right=self._eyes.right, right_number=self._eyes.right_frame(number))
        return out

    def inputs_about(self, pair: Pair) -> dict[int, tuple[Pair, tuple[str, str]]]:
        """The neighbours with the hashes of their two plates; one whose files have gone is none."""
        out = {}
        for k, other in self.pairs_about(pair).items():
            try:
                out[k] = (other, (other.digest("left"), other.digest("right")))
            except PlateError:
                continue
        return out

    def forget(self) -> None:
        """Let go of everything that is kept."""
        for kept in (self._alone, self._motions, self._plates):
            kept.clear()

    def plate(self, pair: Pair) -> Float32 | None:
        """The left plate of a frame, upright, where it was read for an earlier frame's sake and is kept; it is then kept no longer."""
        return self._plates.pop(pair.number, None)

    def alone(self, pair: Pair, *, plates: tuple[Float32, Float32] | None = None, ahead: bool = False) -> Alone:
        """The depth of a frame by itself.

        plates : its upright plates, where they have been read.     ahead : its turn is yet to come, so keep its left plate.
        Raises : PlateError.
        """

        def make() -> Alone:
            rectified, match_colour = self._rectified(pair), self._shot.tables.plates.match_colour
            both = plates or read_upright(pair, rectified, colour=self._shot.colour)
            if ahead and self._eyes.left.is_movie:  # going back in a movie is dear
                self._plates.of(pair.number, lambda: both[0])
            found = recover_pair(pair, both, rectified, settings=self._shot.depth, match_colour=match_colour, hints=hints_of(self._shot, pair))
            return Alone(figures=search_figures(found), told=glimpse(both[0], found.frame, px_m=self._px_m))

        return self._alone.of(pair.number, make)

    def steadied(self, pair: Pair, read: Callable[[], tuple[Float32, Float32]]) -> tuple[Steadied, dict[str, Any]]:
        """The depth of a frame with its neighbours' evidence, and the figures of its own search.  Raises PlateError for the frame's own plates.

        read : reads the frame's plates, where they are needed.
        """
        seen: dict[int, Alone] = {}
        own: Alone | None = None
        for k, other in sorted({0: pair, **self.pairs_about(pair)}.items()):
            if k == 0:
                own = self._alone.get(pair.number) or self.alone(pair, plates=read())
                continue
            try:
                seen[k] = self.alone(other, ahead=k > 0)
            except PlateError:  # the run tells of it when it comes to it
                continue
        assert own is not None
        near = {k: (there.told, self._motion(pair, k, own.told, there.told)) for k, there in seen.items()}
        made = steadied(own.told, near, window=self.window)
        self._alone[pair.number] = replace(own, told=own.told.to_tell())
        return replace(made, frames=tuple(self.pairs_about(pair)[k].number or 0 for k in made.frames)), own.figures

    def _motion(self, pair: Pair, k: int, here: Glimpse, there: Glimpse) -> Motion:
        """The motion from a frame to its neighbour; both ways are found at once, from the earlier frame's side."""
        first, second = (here, there) if k > 0 else (there, here)
        start = (pair.number or 0) + min(k, 0) * self._step
        both = self._motions.of((start, abs(k)), lambda: motion_between(first, second))
        return both[0] if k > 0 else both[1]
