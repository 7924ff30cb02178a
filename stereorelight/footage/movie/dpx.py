"""DPX pictures: 8, 10, 12 and 16 bit RGB, of either byte order, and what the header says of colour, time code and rate.

In: a file by SMPTE ST 268.  Out: encoded RGB (H, W, 3) float32, 0..1 over all codes (code 1023 of 10 bits is 1), as the file
has it; footage/colour.py makes it scene-linear.  Pixels: (0, 0) is the top-left one, whatever the file's order of lines.
Read here, in NumPy, so that a picture needs no movie library and its alpha, order of lines and header are kept; the tests hold
it against FFmpeg, which reads the same codes.

Offsets are those of ST 268-1:2014, tables 1 to 5.  Components stand in 32-bit words (10 bits: three to a word, the first one
highest; method A leaves the two lowest bits empty, B the two highest) or in 16-bit words (12 bits: A leaves the four lowest
empty, B the four highest); every line begins a new 32-bit word."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError
from stereorelight.footage.source import check_file

MAGIC = {b"SDPX": ">", b"XPDS": "<"}
HEADER_BYTES, LEAST_BYTES = 2048, 1664  # all sections; those that every file has
MOST_PIXELS = 1 << 28
UNDEFINED_U32 = 0xFFFFFFFF
CHANNELS: Mapping[int, str] = MappingProxyType({6: "Y", 50: "RGB", 51: "RGBA", 52: "ABGR"})
YCBCR = range(100, 104)
WORDS: Mapping[int, str] = MappingProxyType(
    {
        0: "user-defined",
        1: "printing density",
        2: "linear",
        3: "logarithmic",
        4: "unspecified video",
        5: "SMPTE 274M",
        6: "Rec.709",
        7: "Rec.601 625",
        8: "Rec.601 525",
        9: "NTSC",
        10: "PAL",
        11: "Z linear",
        12: "Z homogeneous",
        13: "ADX",
    }
)
UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True, eq=False)
class Dpx:
    """A DPX picture as its file has it.

    rgb          : (H, W, 3) float32, code / largest code.      bits : of a component, 8, 10, 12 or 16.
    alpha        : (H, W) float32, or None.
    transfer     : the header's word for the curve, "printing density", "logarithmic", "linear", "Rec.709" ..., or "unknown".
    colorimetric : its word for the primaries, likewise.
    timecode     : "HH:MM:SS:FF" of the television header, or None.
    rate         : frames a second, of the television header or else the film one; None where neither says.
    """

    rgb: Float32
    bits: int
    alpha: Float32 | None = None
    transfer: str = UNKNOWN
    colorimetric: str = UNKNOWN
    timecode: str | None = None
    rate: Fraction | None = None

    @property
    def is_float(self) -> bool:
        return False

    @property
    def is_log(self) -> bool:
        """Whether the header says printing density, logarithmic or ADX: a film scan, not a picture for a screen."""
        return self.transfer in ("printing density", "logarithmic", "ADX")


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """Where and how the pixels lie."""

    order: str
    width: int
    height: int
    orientation: int
    channels: str
    bits: int
    method: int
    start: int
    line_padding: int


def _words_of(path: Path, data: bytes) -> tuple[str, Any]:
    order = MAGIC.get(data[:4])
    if order is None:
        raise PlateError(f"{path}: is not a DPX picture; export it as DPX, EXR, TIFF or PNG")
    if len(data) < LEAST_BYTES:
        raise PlateError(f"{path}: truncated DPX: {len(data)} bytes, and the header alone has {LEAST_BYTES}; copy or scan it again")

    def at(offset: int, kind: str) -> Any:
        size = struct.calcsize(kind)
        return struct.unpack(order + kind, data[offset : offset + size])[0] if offset + size <= len(data) else None

    return order, at


def _layout(path: Path, data: bytes) -> _Layout:
    order, at = _words_of(path, data)
    width, height, elements = at(772, "I"), at(776, "I"), at(770, "H")
    descriptor, bits, method, encoding = at(800, "B"), at(803, "B"), at(804, "H"), at(806, "H")
    if elements != 1:
        raise PlateError(f"{path}: holds {elements} picture elements, one RGB element is read here; export it as a single RGB DPX")
    if descriptor in YCBCR or descriptor == 7:
        raise PlateError(f"{path}: is a Y'CbCr DPX (descriptor {descriptor}); export it as RGB")
    if descriptor not in CHANNELS:
        raise PlateError(f"{path}: holds something other than RGB (descriptor {descriptor}); export it as RGB")
    if at(780, "I") == 1 or bits not in (8, 10, 12, 16):
        kind = "signed" if at(780, "I") == 1 else f"{bits} bit"
        raise PlateError(f"{path}: has {kind} components; export it with 8, 10, 12 or 16 bit unsigned ones")
    if encoding == 1:
        raise PlateError(f"{path}: is run-length encoded; export it uncompressed")
    if bits in (10, 12) and method not in (1, 2):
        raise PlateError(
            f"{path}: its {bits} bit components are packed across words, which programs write in several ways; export it filled, method A"
        )
    if not (width > 0 and height > 0 and width * height <= MOST_PIXELS):
        raise PlateError(f"{path}: the header says {width} x {height} pixels; the file is damaged, copy or scan it again")
    orientation = at(768, "H")
    if orientation in range(4, 8):
        raise PlateError(f"{path}: its lines are stored as columns (orientation {orientation}); export it upright")
    start = at(808, "I")
    if not LEAST_BYTES <= start < UNDEFINED_U32:
        start = at(4, "I")
    if not LEAST_BYTES <= start < UNDEFINED_U32:
        raise PlateError(f"{path}: the header says that the picture begins at byte {start}; the file is damaged, copy or scan it again")
    padding = at(812, "I")
    return _Layout(
        order=order,
        width=width,
        height=height,
        orientation=orientation if orientation < 4 else 0,
        channels=CHANNELS[descriptor],
        bits=bits,
        method=method,
        start=start,
        line_padding=padding if padding < width * 64 else 0,
    )


def _lines(path: Path, data: bytes, layout: _Layout) -> npt.NDArray[np.uint8]:
    """(H, bytes of a line), the padding of lines left out; raises PlateError where the file ends too soon."""
    datums = layout.width * len(layout.channels)
    if layout.bits == 10:
        tight = -(-datums // 3) * 4
    else:
        tight = datums * (1 if layout.bits == 8 else 2)
    there = len(data) - layout.start
    aligned = -(-tight // 4) * 4 + layout.line_padding
    said = struct.unpack(layout.order + "I", data[16:20])[0]
    cut = said != UNDEFINED_U32 and len(data) < said
    # Some programs do not begin a line with a new word: their files are whole and have no byte to spare.
    step = tight if there == tight * layout.height and not cut else aligned
    wanted = step * layout.height
    if there < wanted - (step - tight):
        whole = max(there, 0) // step
        raise PlateError(f"{path}: truncated DPX: {whole} of {layout.height} lines are there; copy or scan it again")
    body = np.frombuffer(data, np.uint8, count=min(there, wanted), offset=layout.start)
    return np.lib.stride_tricks.as_strided(body, (layout.height, tight), (step, 1), writeable=False)


def _components(lines: npt.NDArray[np.uint8], layout: _Layout) -> npt.NDArray[Any]:
    """(H, W, C) whole numbers of the lines' bytes."""
    h, datums = layout.height, layout.width * len(layout.channels)
    if layout.bits == 8:
        codes: npt.NDArray[Any] = lines
    elif layout.bits == 10:
        words = np.ascontiguousarray(lines).view(layout.order + "u4")
        lowest = 2 if layout.method == 1 else 0
        codes = np.stack([(words >> (lowest + shift)) & 1023 for shift in (20, 10, 0)], axis=-1).reshape(h, -1)[:, :datums]
    else:
        codes = np.ascontiguousarray(lines).view(layout.order + "u2")
        if layout.bits == 12:
            codes = codes >> 4 if layout.method == 1 else codes & 4095
    return codes.reshape(h, layout.width, len(layout.channels))


def _timecode(at: Any) -> str | None:
    """The television header's time code: eight BCD digits."""
    told = at(1920, "I")
    if told is None or told == UNDEFINED_U32:
        return None
    digits = f"{told:08x}"
    if not digits.isdecimal():
        return None
    hours, minutes, seconds, frames = (int(digits[i : i + 2]) for i in (0, 2, 4, 6))
    if hours > 23 or minutes > 59 or seconds > 59:
        return None
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}:{frames:02d}"


def exact_rate(rate: float) -> Fraction:
    """The rate that a float32 or a rounded figure stands for: 23.976 and 23.98 are 24000/1001."""
    for exact in (Fraction(round(rate)), Fraction(round(rate * 1.001) * 1000, 1001)):
        if exact > 0 and abs(float(exact) - rate) < 0.006:
            return exact
    return Fraction(rate).limit_denominator(1001)


def _rate(at: Any) -> Fraction | None:
    for offset in (1940, 1724):
        told = at(offset, "f")
        if told is not None and math.isfinite(told) and 1 <= told <= 1000:
            return exact_rate(told)
    return None


def read_dpx(path: str | Path) -> Dpx:
    """A DPX picture as encoded RGB; grey is repeated, alpha is kept apart.

    Raises : PlateError when the file is missing, cut short or damaged, or holds what is not read here: Y'CbCr, several
             elements, run-length encoding, 10 or 12 bits packed across words, signed or float components.
    """
    path = Path(path)
    check_file(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PlateError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from error
    layout = _layout(path, data)
    codes = _components(_lines(path, data, layout), layout)
    if layout.orientation & 1:
        codes = codes[:, ::-1]
    if layout.orientation & 2:
        codes = codes[::-1]
    values = codes.astype(np.float32) / np.float32(2**layout.bits - 1)
    where = {name: i for i, name in enumerate(layout.channels)}
    rgb = np.repeat(values, 3, axis=2) if layout.channels == "Y" else values[..., [where["R"], where["G"], where["B"]]]
    _, at = _words_of(path, data[:HEADER_BYTES] if layout.start >= HEADER_BYTES else data[: layout.start])
    return Dpx(
        rgb=np.ascontiguousarray(rgb),
        bits=layout.bits,
        alpha=np.ascontiguousarray(values[..., where["A"]]) if "A" in where else None,
        transfer=WORDS.get(at(801, "B"), UNKNOWN),
        colorimetric=WORDS.get(at(802, "B"), UNKNOWN),
        timecode=_timecode(at),
        rate=_rate(at),
    )
