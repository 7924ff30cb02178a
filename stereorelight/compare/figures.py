"""What a comparison says: named figures with their units and regions, and the maps, pictures and curves behind them.

In: numbers and arrays of one measurement.  Out: a `Measured`, which every comparison hands on: to tables and JSON here, to gates
(compare/gate.py) and to the page (shot/compare_page.py)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.errors import PassError

Points = tuple[Sequence[float], Sequence[float]]
UNIT_WORDS = {"%": "percent", "": ""}  # how a unit is written in a JSON key


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One number.

    name   : as a gate names it, such as bad2, average_m, normal_median; letters, digits, `.`, `_`, `%`.
    value  : NaN or inf where there is none.   unit : %, px, m, deg, dB or nothing.
    table, region : where it stands: its table's title and its row; a gate names the region as bad2@region.
    column : its heading; the name where left out.   digits : decimals shown.
    high_is_good : whether more is better, as of cover.
    """

    name: str
    value: float
    unit: str = ""
    table: str = ""
    region: str = "all"
    column: str = ""
    digits: int = 3
    high_is_good: bool = False

    @property
    def key(self) -> str:
        """Its key in JSON: bad2_percent, average_m, ssim."""
        word = UNIT_WORDS.get(self.unit, self.unit)
        name = self.name.replace("%", "percent")
        return name if not word or name.endswith(f"_{word}") else f"{name}_{word}"


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorMap:
    """A signed error over the frame on a fixed scale, so that two pages can be compared.

    error : (H, W) float32 result less truth, in `unit`; NaN where there is no answer.
    known : (H, W) bool where the truth is known, everywhere when None.
    scale : the error at which the colour is full, > 0.   sequential : the error has no sign (an angle): one colour from 0 up.
    """

    title: str
    error: Float32
    scale: float
    unit: str
    known: Bool | None = None
    sequential: bool = False

    def __post_init__(self) -> None:
        if not self.scale > 0:
            raise PassError(f"the scale of an error map must be > 0, got {self.scale!r}")
        if self.known is not None and self.known.shape != self.error.shape:
            raise PassError(f"an error map of shape {self.error.shape} needs its known pixels in the same shape, got {self.known.shape}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Blink:
    """Two pictures (H, W, 3) uint8 of one size that the page shows in turn: the truth and the result."""

    title: str
    truth: UInt8
    result: UInt8

    def __post_init__(self) -> None:
        if self.truth.shape != self.result.shape:
            raise PassError(f"pictures that blink must have one size, got {self.truth.shape} and {self.result.shape}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A picture (H, W, 3) uint8 with its caption."""

    title: str
    picture: UInt8


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Lines over one x axis, each by its name; `steps` names x values by words (frame numbers); NaN breaks a line.

    log_x : x on a logarithmic axis.   diagonal : also draw y = x, what a calibrated confidence would give.
    limit : a level to be drawn across, a gate's for instance.
    """

    title: str
    lines: Mapping[str, Points]
    x_label: str = ""
    y_label: str = ""
    log_x: bool = False
    diagonal: bool = False
    limit: float | None = None
    y_range: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class FrameFigures:
    """The figures of one frame of a sequence, by their names: those of region "all" that the page draws over time."""

    number: int | None
    values: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """All that one comparison says.

    what    : depth, disparity, normals, picture, flicker, stereo ...
    figures : in the order of the tables; one (table, region, name) once.
    notes   : what was found out about the files, and how sure that is; shown first.
    data    : more for JSON alone, merged into `to_dict`.
    """

    what: str
    figures: tuple[Figure, ...]
    maps: tuple[ErrorMap, ...] = ()
    blinks: tuple[Blink, ...] = ()
    pictures: tuple[Picture, ...] = ()
    curves: tuple[Curve, ...] = ()
    frames: tuple[FrameFigures, ...] = ()
    notes: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, None where there is none: {table: {region: {key: value}}}, one table without its name."""
        tables: dict[str, dict[str, dict[str, Any]]] = {}
        for f in self.figures:
            tables.setdefault(f.table, {}).setdefault(f.region, {})[f.key] = plain(f.value)
        out: dict[str, Any] = dict(next(iter(tables.values()))) if len(tables) == 1 else dict(tables)
        out |= self.data
        if self.frames:
            out["frames"] = [{"frame": f.number} | {name: plain(value) for name, value in f.values.items()} for f in self.frames]
        if self.notes:
            out["notes"] = list(self.notes)
        return out

    def text(self) -> str:
        """Calm tables for people; those by distance are for the page and JSON."""
        tables = [align(rows) for rows in tables_of(f for f in self.figures if not f.table.endswith("by distance"))]
        return "\n\n".join([*(["\n".join(self.notes)] if self.notes else []), *tables])

    def with_notes(self, notes: Iterable[str]) -> Measured:
        """The same with these notes before its own."""
        return replace(self, notes=(*notes, *self.notes))


def plain(value: float) -> float | None:
    """A number as JSON takes it: None for NaN and inf."""
    return float(value) if np.isfinite(value) else None


def number(value: float, digits: int) -> str:
    """`value` with `digits` decimals, or a dash where there is none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def align(rows: Sequence[Sequence[str]]) -> str:
    """Rows of words as a table: the first column to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(w.ljust(widths[i]) if i == 0 else w.rjust(widths[i]) for i, w in enumerate(row)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def tables_of(figures: Iterable[Figure]) -> list[list[list[str]]]:
    """Each table as rows of words, its headings first: a region a row, a figure a column."""
    tables: dict[str, dict[str, dict[str, Figure]]] = {}
    for f in figures:
        tables.setdefault(f.table, {}).setdefault(f.region, {})[f.name] = f
    out = []
    for title, regions in tables.items():
        columns = {name: f for row in regions.values() for name, f in row.items()}
        rows = [[title, *(heading(f) for f in columns.values())]]
        for region, row in regions.items():
            rows.append([region, *(number(row[name].value, row[name].digits) if name in row else "-" for name in columns)])
        out.append(rows)
    return out


def heading(figure: Figure) -> str:
    """The column's words with its unit."""
    words = figure.column or figure.name
    return words if not figure.unit or words.endswith(figure.unit) else f"{words} {figure.unit}"


def reduced(error: npt.NDArray[Any], *, widest: int) -> npt.NDArray[Any]:
    """`error` (H, W) made at most `widest` wide: each pixel is the largest error, by size, of the k x k that it stands for.

    NaN where half of them or more are NaN, so that thin errors stay seen and thin gaps do not grow."""
    h, w = error.shape
    k = -(-w // widest)
    if k <= 1:
        return error
    padded = np.pad(error, ((0, -h % k), (0, -w % k)), constant_values=np.nan)
    rows, columns = padded.shape[0] // k, padded.shape[1] // k
    blocks = padded.reshape(rows, k, columns, k).transpose(0, 2, 1, 3).reshape(rows, columns, k * k)
    known = np.isfinite(blocks)
    at = np.where(known, np.abs(blocks), -1).argmax(axis=-1)
    largest = np.take_along_axis(blocks, at[..., None], axis=-1)[..., 0]
    return np.where(known.mean(axis=-1) > 0.5, largest, np.nan).astype(error.dtype)
