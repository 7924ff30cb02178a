"""The `[[repairs]]` of a shot file, frame by frame.

In: the tables, and the shot's pairs.  Out: the `Fix`es of a frame.  A fix painted on one frame (`frame`) goes with what it
was painted on, by optical flow from frame to frame; one without `frame` stays where it is; a matte that is a sequence is
taken frame by frame.  What comes out depends on the footage alone, not on the part of the shot that is run."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.frames import read_frame
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.footage.sequence import frame_range
from stereorelight.footage.stills import read_still
from stereorelight.shot.pairs import Pair
from stereorelight.shot.receipt import digest, file_digest
from stereorelight.shot.schema import RepairTable, Shot
from stereorelight.stereo.carry import Carried, carried_matte, carry, flow_picture, nothing_carried, polygon_matte, white_of
from stereorelight.stereo.repair import Fix, Pin, pin_shifts

Plate = Callable[[Pair], Float32]
Depth = Callable[[Pair], Float32]


@dataclass(kw_only=True, eq=False)
class _Trail:
    """What has been carried so far from one painted frame, one way: frame number to packed matte and points."""

    known: dict[int, tuple[bytes, tuple[int, int], Float32]] = field(default_factory=dict)
    last: tuple[int, Carried, UInt8] | None = None


def _packed(matte: Float32, points: Float32) -> tuple[bytes, tuple[int, int], Float32]:
    return zlib.compress(np.rint(255 * matte).astype(np.uint8).tobytes(), 1), (matte.shape[0], matte.shape[1]), points


def _unpacked(kept: tuple[bytes, tuple[int, int], Float32]) -> tuple[Float32, Float32]:
    data, shape, points = kept
    return np.frombuffer(zlib.decompress(data), np.uint8).reshape(shape).astype(np.float32) / np.float32(255), points


@dataclass(kw_only=True, eq=False)
class Repairs:
    """What the shot file repairs.

    whole : every pair of the shot, not only those that are run.
    plate : the upright left plate of a pair.
    depth : Z of a pair before any repair: what the pins of another frame are measured against.
    """

    shot: Shot
    whole: Sequence[Pair]
    plate: Plate
    depth: Depth
    _trails: dict[tuple[str, int], _Trail] = field(default_factory=dict)
    _pins: dict[str, tuple[Pin, ...]] = field(default_factory=dict)

    def _complain(self, table: RepairTable, words: str) -> ShotError:
        return ShotError(f"{self.shot.path}: repair {table.name!r}: {words}")

    def check(self) -> None:
        """Raises ShotError or PlateError for a repair that can hold on no frame: before any work."""
        numbers = {pair.number for pair in self.whole}
        names = [table.name for table in self.shot.tables.repairs]
        for table in self.shot.tables.repairs:
            if names.count(table.name) > 1:
                raise self._complain(table, "two repairs share this name; receipts need one each")
            if table.matte and table.polygon:
                raise self._complain(table, "give matte or polygon, not both")
            if table.polygon and len(table.polygon) < 3:
                raise self._complain(table, f"a polygon has three corners or more, got {len(table.polygon)}")
            if table.frame is not None and table.frame not in numbers:
                raise self._complain(table, f"frame {table.frame} is not in the shot, which has {self.whole[0].name}-{self.whole[-1].name}")
            if table.frames is not None:
                frame_range(table.frames)
            for file in self._files(table, None):
                if not file.is_file():
                    raise PlateError(f"{file}: file missing; repair {table.name!r} of {self.shot.path} needs it")
            matte = np.ones((1, 1), np.float32) if table.matte or table.polygon else None
            Fix(name=table.name, kind=table.kind, matte=matte, distance_m=table.distance_m, pins=_pins_of(table), clean_Z=_dummy(table))

    def _files(self, table: RepairTable, number: int | None) -> list[Path]:
        """The files that a table names, those of a pattern for this frame alone, and none of them without one."""
        files = []
        for text in (table.matte, table.depth):
            if text is None:
                continue
            pattern = Pattern.parse(self.shot.resolved(text), must_exist=False)
            if pattern.is_single and "#" not in text and "%0" not in text:
                files.append(Path(pattern.pattern))
            elif number is not None:
                files.append(pattern.path(number))
        return files

    def tables(self, pair: Pair) -> list[RepairTable]:
        """The repairs that hold on this frame."""
        return [t for t in self.shot.tables.repairs if t.frames is None or pair.number is None or pair.number in frame_range(t.frames)]

    def key(self, pair: Pair) -> str | None:
        """A hash over all that the fixes of this frame depend on; None where there are none."""
        tables = self.tables(pair)
        if not tables:
            return None
        parts: list[Any] = []
        for table in tables:
            files = [file_digest(file) for file in self._files(table, pair.number)]
            way = [p.digest("left") for p in self._way(table, pair)]
            parts.append([table.model_dump(), files, way])
        return digest(parts)

    def _way(self, table: RepairTable, pair: Pair) -> list[Pair]:
        """The pairs from the painted frame to this one, both included; this one alone where nothing is carried."""
        if table.frame is None or pair.number is None or table.frame == pair.number or _moves_itself(table):
            return [pair]
        low, high = sorted((table.frame, pair.number))
        way = [p for p in self.whole if p.number is not None and low <= p.number <= high]
        return way if table.frame < pair.number else way[::-1]

    def fixes(self, pair: Pair, size_hw: tuple[int, int]) -> list[Fix]:
        """The fixes of this frame.  Raises ShotError, PlateError naming repair and file."""
        return [self._fix(table, pair, size_hw) for table in self.tables(pair)]

    def _fix(self, table: RepairTable, pair: Pair, size_hw: tuple[int, int]) -> Fix:
        matte = self._matte(table, pair.number, size_hw)
        pins = _pins_of(table)
        way = self._way(table, pair)
        if len(way) > 1:
            if table.kind == "pins":
                pins = self._shifts(table, way[0], size_hw)
            matte, points = self._carried(table, way, matte, np.array([(p.x, p.y) for p in pins], np.float32).reshape(-1, 2))
            pins = tuple(Pin(x=float(x), y=float(y), distance_m=p.distance_m, shift_per_m=p.shift_per_m) for (x, y), p in zip(points, pins))
        return Fix(name=table.name, kind=table.kind, matte=matte, distance_m=table.distance_m, pins=pins, clean_Z=self._clean(table, pair.number))

    def _shifts(self, table: RepairTable, painted: Pair, size_hw: tuple[int, int]) -> tuple[Pin, ...]:
        """The pins as what they add to 1/Z on the frame that they were measured on."""
        if table.name not in self._pins:
            fix = Fix(name=table.name, kind="pins", matte=self._matte(table, painted.number, size_hw), pins=_pins_of(table))
            self._pins[table.name] = pin_shifts(self.depth(painted), fix)
        return self._pins[table.name]

    def _matte(self, table: RepairTable, number: int | None, size_hw: tuple[int, int]) -> Float32 | None:
        if table.polygon:
            return polygon_matte(table.polygon, size_hw)
        if table.matte is None:
            return None
        file = self._files(table, number)[0]
        if file.suffix.lower() == ".exr":
            found = read_frame(file)
            names = [n for n in found if n.startswith("matte_")] or [n for n in found if found[n].ndim == 2 and n != "flags"]
            picture = found[names[0]] if names else found["plate"].mean(axis=-1)
        else:
            picture = read_still(file).rgb.mean(axis=-1)
        if picture.shape != size_hw:
            size = f"{picture.shape[1]}x{picture.shape[0]}"
            raise PlateError(f"{file}: matte of repair {table.name!r} is {size} pixels, the plate {size_hw[1]}x{size_hw[0]}; paint it on the plate")
        return np.ascontiguousarray(np.nan_to_num(picture), dtype=np.float32)

    def _clean(self, table: RepairTable, number: int | None) -> Float32 | None:
        if table.depth is None:
            return None
        file = self._files(table, number)[-1]
        found = read_frame(file)
        if "Z" not in found:
            raise PlateError(f"{file}: has no pass Z, only {', '.join(found)}; repair {table.name!r} needs the depth of the empty set")
        return found["Z"]

    def _carried(self, table: RepairTable, way: list[Pair], matte: Float32 | None, points: Float32) -> tuple[Float32 | None, Float32]:
        """Matte and points at the end of the way, from what is known of it; what is passed on the way is kept."""
        trail = self._trails.setdefault((table.name, 1 if (way[-1].number or 0) > (way[0].number or 0) else -1), _Trail())
        end = int(way[-1].number or 0)
        if end not in trail.known:
            plates = (self.plate(p) for p in way)
            first = next(plates)
            white = white_of(first)
            painted = matte if matte is not None else np.ones(first.shape[:2], np.float32)
            carried, then = nothing_carried(painted.shape, points), flow_picture(first, white)
            begin = 1
            if trail.last is not None and trail.last[0] in [p.number for p in way]:
                last, carried, then = trail.last
                begin = [p.number for p in way].index(last) + 1
            for pair in way[begin:]:
                now = flow_picture(self.plate(pair), white)
                onward = carry(carried, then, now)
                if onward is None:
                    words = f"cannot be carried to frame {pair.name}: it shows something else than the frame before; end its `frames` at the cut"
                    raise self._complain(table, words)
                carried, then = onward, now
                trail.known[int(pair.number or 0)] = _packed(carried_matte(painted, carried, now), carried.points)
                trail.last = (int(pair.number or 0), carried, then)
        found, points = _unpacked(trail.known[end])
        return (None if matte is None else found), points


def _moves_itself(table: RepairTable) -> bool:
    """Whether the matte is a sequence, which says itself where it is."""
    return table.matte is not None and ("#" in table.matte or "%0" in table.matte)


def _pins_of(table: RepairTable) -> tuple[Pin, ...]:
    return tuple(Pin(x=x, y=y, distance_m=m) for x, y, m in table.pins)


def _dummy(table: RepairTable) -> Float32 | None:
    return None if table.depth is None else np.ones((1, 1), np.float32)
