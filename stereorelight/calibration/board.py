"""Calibration boards: what is printed, and where its corners are.

In: a spec such as `charuco:11x8:0.040:0.030:DICT_5X5_100`.  Out: a `Board` whose corners and black shapes are exact.
Frame: the board's own, x right and y down as one looks at the print, z = 0 on its face and growing away from the viewer.
The origin is the first inner corner of a chessboard, the outer top-left corner of a ChArUco board (OpenCV's place, layout
since 4.6), and the outer corner of the top-left tag of an AprilGrid (Kalibr's layout: tag 0 at the bottom left, rows upwards,
a border two bits wide, small black squares between the tags).  Metres."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.errors import ShotError, nearest_hint

Kind = Literal["chessboard", "charuco", "aprilgrid"]
FORMS = {
    "chessboard": "chessboard:COLUMNSxROWS:SQUARE, e.g. chessboard:9x6:0.025 (inner corners, metres)",
    "charuco": "charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, e.g. charuco:11x8:0.040:0.030:DICT_5X5_100 (squares, metres)",
    "aprilgrid": "aprilgrid:COLUMNSxROWS:TAG:SPACING, e.g. aprilgrid:6x6:0.088:0.3 (tags, metres, gap as a share of the tag)",
}
APRILGRID_DICTIONARY = "DICT_APRILTAG_36h11"
APRILGRID_BORDER_BITS = 2
FEWEST = {"chessboard": 3, "charuco": 3, "aprilgrid": 1}
MOST = 200
LARGEST_M = 2.0  # a square of two metres: above it somebody wrote millimetres


@dataclass(frozen=True, kw_only=True)
class Board:
    """A board that can exist.  ids of its corners are row indices into `points_m`.

    columns, rows : inner corners (chessboard), squares (charuco), tags (aprilgrid).
    square_m      : side of a square; of a tag for an aprilgrid.
    marker_m      : side of a charuco marker; spacing: gap between tags as a share of a tag.
    Raises        : ShotError saying what a board of that kind needs.
    """

    kind: Kind
    columns: int
    rows: int
    square_m: float
    marker_m: float | None = None
    spacing: float | None = None
    dictionary: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in FORMS:
            raise ShotError(f"board {self.kind!r} is unknown{nearest_hint(str(self.kind), FORMS)}")
        if not all(FEWEST[self.kind] <= n <= MOST for n in (self.columns, self.rows)):
            fewest = f"{FEWEST[self.kind]}x{FEWEST[self.kind]}"
            raise ShotError(f"a {self.kind} must have {fewest} to {MOST}x{MOST} {self.unit}, got {self.columns}x{self.rows}")
        if not 0 < self.square_m <= LARGEST_M:
            hint = f"; lengths are in metres: write {self.square_m / 1000:g} for {self.square_m:g} mm" if self.square_m > LARGEST_M else ""
            raise ShotError(f"the board's square must be above 0 and at most {LARGEST_M:g} m, got {self.square_m:g}{hint}")
        if (self.kind == "charuco") != (self.marker_m is not None) or (self.kind == "aprilgrid") != (self.spacing is not None):
            raise ShotError(f"a {self.kind} is written {FORMS[self.kind]}")
        if self.marker_m is not None and not 0 < self.marker_m < self.square_m:
            raise ShotError(f"the marker must be smaller than its square ({self.square_m:g} m), got {self.marker_m:g}; the square comes first")
        if self.spacing is not None and not 0 < self.spacing <= 1:
            raise ShotError(f"the gap between tags is a share of a tag, above 0 and at most 1, got {self.spacing:g}; Kalibr's own is 0.3")
        if self.kind == "aprilgrid" and self.dictionary is None:
            object.__setattr__(self, "dictionary", APRILGRID_DICTIONARY)
        if self.kind == "charuco":
            put = _dictionary_name(str(self.dictionary))
            object.__setattr__(self, "dictionary", put)
        if self.kind != "chessboard":
            there, needed = len(dictionary(str(self.dictionary)).bytesList), self.markers
            if needed > there:
                raise ShotError(f"the board needs {needed} markers, {self.dictionary} has {there}; take a larger dictionary or fewer {self.unit}")

    @property
    def unit(self) -> str:
        """What `columns` and `rows` count."""
        return {"chessboard": "inner corners", "charuco": "squares", "aprilgrid": "tags"}[self.kind]

    @property
    def spec(self) -> str:
        """The words that `parse_board` reads back to this board."""
        parts = [self.kind, f"{self.columns}x{self.rows}", f"{self.square_m:.12g}"]
        if self.kind == "charuco":
            parts += [f"{self.marker_m:.12g}", str(self.dictionary)]
        if self.kind == "aprilgrid":
            parts += [f"{self.spacing:.12g}"]
        return ":".join(parts)

    @property
    def markers(self) -> int:
        """How many coded markers the board shows."""
        return {"chessboard": 0, "charuco": self.columns * self.rows // 2, "aprilgrid": self.columns * self.rows}[self.kind]

    @property
    def grid(self) -> tuple[int, int]:
        """(columns, rows) of the corners: inner corners, or two a tag each way."""
        less = {"chessboard": 0, "charuco": 1}.get(self.kind)
        return (self.columns - less, self.rows - less) if less is not None else (2 * self.columns, 2 * self.rows)

    @functools.cached_property
    def points_m(self) -> Float64:
        """(n, 3) float64 corners, z = 0.  Rows left to right then down; for an aprilgrid tag by tag, each clockwise from its top left."""
        s = self.square_m
        if self.kind == "aprilgrid":
            pitch = s * (1 + float(self.spacing or 0))
            tag = np.arange(self.columns * self.rows)
            at = np.stack([tag % self.columns * pitch, (self.rows - 1 - tag // self.columns) * pitch], axis=-1)
            xy: Float64 = (at[:, None] + s * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])).reshape(-1, 2)
        else:
            first = 1 if self.kind == "charuco" else 0
            nx, ny = self.grid
            x, y = np.meshgrid(np.arange(nx) + first, np.arange(ny) + first)
            xy = np.asarray(np.stack([x.ravel(), y.ravel()], axis=-1) * s)
        points: Float64 = np.concatenate([xy, np.zeros((len(xy), 1))], axis=1)
        points.setflags(write=False)
        return points

    @functools.cached_property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) around everything black, board frame."""
        r = self.rectangles_m
        return float(r[:, 0].min()), float(r[:, 1].min()), float(r[:, 2].max()), float(r[:, 3].max())

    @property
    def quiet_m(self) -> float:
        """White that must stay around the black for the board to be found."""
        return self.square_m * {"chessboard": 0.5, "charuco": 0.25, "aprilgrid": 0.25}[self.kind]

    @functools.cached_property
    def rectangles_m(self) -> Float64:
        """(n, 4) x0, y0, x1, y1 of every black rectangle, board frame; none overlaps another, all else is white."""
        s = self.square_m
        out: list[tuple[float, float, float, float]] = []
        if self.kind == "aprilgrid":
            gap = s * float(self.spacing or 0)
            pitch = s + gap
            for tag in range(self.markers):
                out += _marker(self, tag, tag % self.columns * pitch, (self.rows - 1 - tag // self.columns) * pitch, s, turned=True)
            corners = [(i * pitch - gap, j * pitch - gap) for j in range(self.rows + 1) for i in range(self.columns + 1)]
            out += [(x, y, x + gap, y + gap) for x, y in corners]
        else:
            first = -1 if self.kind == "chessboard" else 0
            nx, ny = (self.columns + 1, self.rows + 1) if self.kind == "chessboard" else (self.columns, self.rows)
            number = 0
            for j in range(ny):
                for i in range(nx):
                    x, y = (i + first) * s, (j + first) * s
                    if (i + j) % 2 == 0:
                        out.append((x, y, (i + first + 1) * s, (j + first + 1) * s))
                    elif self.marker_m is not None:
                        rim = (s - self.marker_m) / 2
                        out += _marker(self, number, x + rim, y + rim, self.marker_m, turned=False)
                        number += 1
        rectangles = np.array(out, dtype=np.float64)
        rectangles.setflags(write=False)
        return rectangles


def dictionary(name: str) -> Any:
    """OpenCV's marker dictionary of that name.  Raises ShotError with the nearest known name."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _dictionary_name(name)))


def _dictionary_name(name: str) -> str:
    import cv2

    known = {n.upper(): n for n in sorted(dir(cv2.aruco)) if n.startswith("DICT_")}
    if name.upper() not in known:
        raise ShotError(f"marker dictionary {name!r} is unknown{nearest_hint(name, known.values())}")
    return known[name.upper()]


def marker_bits(board: Board, number: int) -> Bool:
    """(n, n) whether each cell of marker `number` is black, border included, as OpenCV has it upright."""
    import cv2

    words = dictionary(str(board.dictionary))
    bits = cv2.aruco.Dictionary_getBitsFromByteList(words.bytesList[number : number + 1], words.markerSize)
    border = APRILGRID_BORDER_BITS if board.kind == "aprilgrid" else 1
    black: Bool = np.pad(np.asarray(bits) == 0, border, constant_values=True)
    return black


def _marker(board: Board, number: int, x: float, y: float, side: float, *, turned: bool) -> list[tuple[float, float, float, float]]:
    """Black runs of one marker.  `turned`: half a turn, as Kalibr prints what OpenCV calls upright."""
    black = marker_bits(board, number)
    black = black[::-1, ::-1] if turned else black
    cell = side / len(black)
    runs = []
    for j, row in enumerate(black):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        runs += [(x + a * cell, y + j * cell, x + b * cell, y + (j + 1) * cell) for a, b in edges.reshape(-1, 2)]
    return runs


def parse_board(spec: str) -> Board:
    """The board that `spec` names, see `FORMS`.  Raises ShotError: what is wrong, and how that kind is written."""
    kind, *parts = [part.strip() for part in str(spec).split(":")]
    kind = kind.lower()
    if kind not in FORMS:
        raise ShotError(f"board {spec!r}: kind {kind!r} is unknown{nearest_hint(kind, FORMS)}")
    form = FORMS[kind]
    wanted = {"chessboard": 2, "charuco": 4, "aprilgrid": 3}[kind]
    if len(parts) != wanted:
        raise ShotError(f"board {spec!r} has {len(parts)} parts after {kind!r}, not {wanted}; it is written {form}")
    counts = parts[0].lower().split("x")
    if len(counts) != 2 or not all(c.isascii() and c.isdigit() for c in counts):
        raise ShotError(f"board {spec!r}: {parts[0]!r} is not COLUMNSxROWS; it is written {form}")
    columns, rows = (int(c) for c in counts)
    names = {"chessboard": ["square"], "charuco": ["square", "marker"], "aprilgrid": ["tag", "gap"]}[kind]
    values = [_number(word, name, spec) for name, word in zip(names, parts[1:])]
    try:
        if kind == "chessboard":
            return Board(kind="chessboard", columns=columns, rows=rows, square_m=values[0])
        if kind == "charuco":
            return Board(kind="charuco", columns=columns, rows=rows, square_m=values[0], marker_m=values[1], dictionary=parts[3])
        return Board(kind="aprilgrid", columns=columns, rows=rows, square_m=values[0], spacing=values[1])
    except ShotError as problem:
        raise ShotError(f"board {spec!r}: {problem}") from None


def _number(word: str, name: str, spec: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ShotError(f"board {spec!r}: the {name} must be a number, got {word!r}; lengths are plain metres, e.g. 0.025")
    return value
