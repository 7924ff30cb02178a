"""Values that change over a shot: keys on frames, and places that go with a picture point.

In: a table of a shot file, any value of which may be `{ keys = [[1001, 1.0], [1020, 3.0]], ease = "smooth" }` instead of a
value, and any place `{ pixel = [x, y], frame = 1001, offset_m = [x, y, z] }` instead of three numbers.
Out: the plain table of one frame, and the light that it says.
Frames are the shot's own numbers; before the first key and after the last one the end keys hold.
Ease: "linear"; "smooth", at rest at the first and last key and never beyond what the keys say between them; "step", each key
holds until the next one.  Words, true and false can only step."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.checks import Vector, is_number
from stereorelight.light.lights import Light, lights_from_dicts

EASES = ("linear", "smooth", "step")
CURVE_KEYS, STUCK_KEYS = ("keys", "ease"), ("pixel", "frame", "offset_m")
FIXED = ("name", "type")  # what a table is called and what it is cannot change
MOST_KEYS = 100_000


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A value by keys.

    frames : of the keys, rising.      values : numbers, vectors of one length, or anything where ease is "step".
    """

    frames: tuple[float, ...]
    values: tuple[Any, ...]
    ease: str = "linear"

    def at(self, frame: float | None) -> Any:
        """The value on `frame`; None, a picture without a number, takes the first key's."""
        if frame is None or frame <= self.frames[0]:
            return self.values[0]
        if frame >= self.frames[-1]:
            return self.values[-1]
        k = bisect_right(self.frames, frame) - 1
        if self.ease == "step" or frame == self.frames[k]:
            return self.values[k]
        rows = np.array(self.values, dtype=np.float64).reshape(len(self.frames), -1)
        here, span = rows[k], self.frames[k + 1] - self.frames[k]
        t = (frame - self.frames[k]) / span
        if self.ease == "linear":
            found = here + t * (rows[k + 1] - here)
        else:
            slopes = _calm_slopes(np.array(self.frames), rows)
            found = (1 + 2 * t) * (1 - t) ** 2 * here + t * t * (3 - 2 * t) * rows[k + 1]
            found = found + span * t * (1 - t) * ((1 - t) * slopes[k] - t * slopes[k + 1])
            # Rounding alone could leave the span of the two keys.
            found = np.clip(found, np.minimum(here, rows[k + 1]), np.maximum(here, rows[k + 1]))
        return tuple(float(v) for v in found) if isinstance(self.values[0], tuple) else float(found[0])


def _calm_slopes(x: Any, y: Any) -> Any:
    """(n, c) slopes of a curve that never overshoots: Fritsch and Butland's harmonic means; 0 at both ends and at turns."""
    slopes = np.zeros_like(y)
    h, rise = np.diff(x)[:, None], np.diff(y, axis=0) / np.diff(x)[:, None]
    if len(x) > 2:
        before, after = rise[:-1], rise[1:]
        w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
        same = before * after > 0
        below = np.where(same, w1 * after + w2 * before, 1.0)
        slopes[1:-1] = np.where(same, (w1 + w2) * before * after / below, 0.0)
    return slopes


@dataclass(frozen=True, kw_only=True)
class Stuck:
    """A place that goes with a point of the picture.

    pixel    : (x, y) in pixels of the plate, (0, 0) the centre of the first one.
    frame    : the frame on which it was picked: optical flow tracks it to the others.  None: the same pixel on every frame.
    offset_m : from the surface there, metres, along the axes of the light's own space.
    """

    pixel: tuple[float, float]
    frame: int | None = None
    offset_m: Vector = (0.0, 0.0, 0.0)


Place = Callable[[Stuck, str], Vector]  # a stuck place, in the space "camera" or "world"


def _stand_in(stuck: Stuck, space: str) -> Vector:
    """Some place for a check without a picture: two points that differ give places that differ."""
    (x, y), (a, b, c) = stuck.pixel, stuck.offset_m
    return 1e-3 * x + a, -1e-3 * y + b, c - 1.0


def curve_from_dict(value: Mapping[str, Any], label: str) -> Curve:
    """The curve of `{ keys = [...], ease = "..." }`.  Raises ShotError that begins with `label`."""
    for key in value:
        if key not in CURVE_KEYS:
            raise ShotError(f"{label}: {key!r} is unknown beside keys{nearest_hint(key, CURVE_KEYS)}")
    ease, keys = value.get("ease", "linear"), value["keys"]
    if ease not in EASES:
        raise ShotError(f"{label}: ease {ease!r} is unknown{nearest_hint(str(ease), EASES)}")
    if not isinstance(keys, list) or not keys or not all(isinstance(pair, list) and len(pair) == 2 for pair in keys):
        raise ShotError(f"{label}: keys must be pairs of frame and value, [[1001, 1.0], [1020, 3.0]], got {str(keys)[:60]}")
    if len(keys) > MOST_KEYS:
        raise ShotError(f"{label}: {len(keys)} keys are beyond reading; at most {MOST_KEYS}")
    frames = [pair[0] for pair in keys]
    for before, frame in zip([-math.inf, *frames], frames):
        if not is_number(frame) or not math.isfinite(frame):
            raise ShotError(f"{label}: a key begins with its frame, a number, got {frame!r}")
        if frame <= before:
            raise ShotError(f"{label}: key frames must rise, got {before:g} before {frame:g}")
    values = tuple(tuple(v) if isinstance(v, list) else v for _, v in keys)
    numbers = [is_number(v) or (isinstance(v, tuple) and len(v) > 0 and all(is_number(x) for x in v)) for v in values]
    lengths = {len(v) if isinstance(v, tuple) else 0 for v in values}
    if len(lengths) > 1:
        raise ShotError(f"{label}: all keys must have values of one kind, numbers or vectors of one length")
    if ease != "step" and not all(numbers):
        odd = values[numbers.index(False)]
        raise ShotError(f'{label}: {odd!r} is no number that could change gradually; words, true and false take ease = "step"')
    return Curve(frames=tuple(float(f) for f in frames), values=values, ease=ease)


def stuck_from_dict(value: Mapping[str, Any], label: str) -> Stuck:
    """The place of `{ pixel = [x, y], frame = 1001, offset_m = [x, y, z] }`.  Raises ShotError that begins with `label`."""
    for key in value:
        if key not in STUCK_KEYS:
            raise ShotError(f"{label}: {key!r} is unknown beside pixel{nearest_hint(key, STUCK_KEYS)}")
    pixel, frame, offset = value["pixel"], value.get("frame"), value.get("offset_m", [0.0, 0.0, 0.0])
    for key, numbers, count in (("pixel", pixel, 2), ("offset_m", offset, 3)):
        if not isinstance(numbers, list) or len(numbers) != count or not all(is_number(v) and math.isfinite(v) for v in numbers):
            raise ShotError(f"{label}: {key} must be {count} numbers, got {numbers!r}")
    if frame is not None and (isinstance(frame, bool) or not isinstance(frame, int)):
        raise ShotError(f"{label}: frame must be the whole number of the frame on which the pixel was picked, got {frame!r}")
    return Stuck(pixel=(float(pixel[0]), float(pixel[1])), frame=frame, offset_m=(float(offset[0]), float(offset[1]), float(offset[2])))


@dataclass(frozen=True, kw_only=True)
class Moving:
    """A table whose values may change over the shot: `at` gives the plain table of one frame.

    label  : who complains, such as "light 'key'".
    curves : the keys that are animated.     stuck : the keys that hold a picture point.
    """

    table: Mapping[str, Any]
    label: str
    curves: Mapping[str, Curve] = field(default_factory=dict)
    stuck: Mapping[str, Stuck] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether anything changes from frame to frame."""
        return bool(self.curves or self.stuck)

    def at(self, frame: float | None, place: Place | None = None) -> dict[str, Any]:
        """The plain table on `frame`.

        place : finds a stuck point; without one a stand-in serves, for checks.
        """
        plain = dict(self.table) | {key: _plain(curve.at(frame)) for key, curve in self.curves.items()}
        space = str(plain.get("space", "camera"))
        return plain | {key: list((place or _stand_in)(stuck, space)) for key, stuck in self.stuck.items()}

    def key_frames(self) -> list[float | None]:
        """Every frame on which a key stands; [None] where nothing is animated."""
        return [*sorted({f for curve in self.curves.values() for f in curve.frames})] or [None]


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def moving_table(table: Mapping[str, Any], label: str) -> Moving:
    """`table` with its curves and stuck places understood.  Raises ShotError that begins with `label`."""
    curves: dict[str, Curve] = {}
    stuck: dict[str, Stuck] = {}
    for key, value in table.items():
        if not isinstance(value, Mapping):
            continue
        if "keys" in value or "pixel" in value:
            if key in FIXED:
                raise ShotError(f"{label}: {key} cannot change over the shot; make a second one")
            if "keys" in value:
                curves[key] = curve_from_dict(value, f"{label}: {key}")
            else:
                stuck[key] = stuck_from_dict(value, f"{label}: {key}")
        elif key not in FIXED:
            known = nearest_hint(next(iter(value), ""), ["keys", "pixel"])
            raise ShotError(f"{label}: {key} must be a value, or {{ keys = [[frame, value], ...] }}, or {{ pixel = [x, y] }} for a place{known}")
    for key in stuck:
        if not key.endswith("_m") or key == "radius_m":
            raise ShotError(f"{label}: {key} is no place that could go with a pixel; position_m and aim_m are")
    return Moving(table=table, label=label, curves=curves, stuck=stuck)


@dataclass(frozen=True, kw_only=True)
class LightTrack:
    """One light over a shot.  Its layers are the same on every frame: switched off by a key it is dark, not gone."""

    moving: Moving

    @property
    def name(self) -> str:
        return str(self.moving.table.get("name"))

    @property
    def first(self) -> Light:
        """The light at its first keys, stuck places stood in for: what it is, and what it is called."""
        return self.at(None)

    @property
    def enabled(self) -> bool:
        """Whether it shines on any frame."""
        curve = self.moving.curves.get("enabled")
        return any(curve.values) if curve else self.first.enabled

    def at(self, frame: float | None, place: Place | None = None) -> Light:
        """The light on `frame`.  Raises ShotError naming light, key and frame."""
        plain = self.moving.at(frame, place)
        if "enabled" in self.moving.curves and plain["enabled"] is False and self.enabled:
            plain |= {"enabled": True, "intensity": 0.0, "solo": False}
        try:
            return lights_from_dicts([plain])[0]
        except ShotError as error:
            if not self.moving.moves or frame is None:
                raise
            raise ShotError(f"{error} (on frame {frame:g})") from None

    def dark(self, frame: float | None) -> bool:
        """Whether it gives no light on `frame`, so that nobody need ask where it stands."""
        light = self.at(frame)
        return not light.enabled or light.strength == 0


def light_tracks(tables: Sequence[Mapping[str, Any]]) -> tuple[LightTrack, ...]:
    """The lights of a file's `[[lights]]` tables over a shot, each checked at every one of its keys.

    Raises : ShotError as `lights_from_dicts` does, and for keys that cannot be.
    """
    tracks: list[LightTrack] = []
    for index, table in enumerate(tables):
        if not isinstance(table, Mapping):
            raise ShotError(f"light number {index + 1} must be a table of keys, got {table!r}; begin each light with [[lights]]")
        label = f"light {table['name']!r}" if "name" in table else f"light number {index + 1}"
        track = LightTrack(moving=moving_table(table, label))
        for frame in track.moving.key_frames():
            track.at(frame)
        if any(track.name == other.name for other in tracks):
            raise ShotError(f"light {track.name!r}: name is taken by an earlier light; names must differ, since they name the layers")
        tracks.append(track)
    return tuple(tracks)
