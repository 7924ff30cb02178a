"""What a decoder's pixel formats and colour numbers mean: planes as arrays, names for tags.

In: PyAV frames.  Out: views of their planes, never copies, never through swscale (it is off by 0.4 % in 10 bits).
Source of the numbers: ITU-T H.273 (09/2023) tables 2 to 4."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

# Matrix coefficients that are read; others (YCgCo, ICtCp, constant luminance ...) are refused by name.
MATRICES: Mapping[int, str] = MappingProxyType({0: "rgb", 1: "bt709", 5: "bt601", 6: "bt601", 9: "bt2020"})
OTHER_MATRICES: Mapping[int, str] = MappingProxyType(
    {
        4: "FCC",
        7: "SMPTE 240M",
        8: "YCgCo",
        10: "BT.2020 constant luminance",
        11: "YDzDx",
        12: "chromaticity-derived",
        13: "chromaticity-derived",
        14: "ICtCp",
    }
)
PRIMARIES: Mapping[int, str] = MappingProxyType(
    {
        1: "bt709",
        4: "bt470m",
        5: "bt470bg",
        6: "smpte170m",
        7: "smpte240m",
        8: "film",
        9: "bt2020",
        10: "smpte428",
        11: "smpte431",
        12: "smpte432",
        22: "ebu3213",
    }
)
TRANSFERS: Mapping[int, str] = MappingProxyType(
    {
        1: "bt709",
        4: "gamma2.2",
        5: "gamma2.8",
        6: "smpte170m",
        7: "smpte240m",
        8: "linear",
        9: "log100",
        10: "log316",
        11: "iec61966-2-4",
        12: "bt1361e",
        13: "iec61966-2-1",
        14: "bt2020-10",
        15: "bt2020-12",
        16: "smpte2084",
        17: "smpte428",
        18: "arib-std-b67",
    }
)

_PLANAR = re.compile(r"(?:yuv(?P<full>j?)a?(?P<chroma>444|422|420|440)p|(?P<grey>gray)|(?P<rgb>gbra?p))(?P<bits>9|10|12|14|16)?(?:le)?")
# Packed RGB by name: where R, G, B stand in a pixel, samples a pixel, bits.
_PACKED: Mapping[str, tuple[tuple[int, int, int], int, int]] = MappingProxyType(
    {
        "rgb24": ((0, 1, 2), 3, 8),
        "bgr24": ((2, 1, 0), 3, 8),
        "rgb0": ((0, 1, 2), 4, 8),
        "bgr0": ((2, 1, 0), 4, 8),
        "rgba": ((0, 1, 2), 4, 8),
        "bgra": ((2, 1, 0), 4, 8),
        "0rgb": ((1, 2, 3), 4, 8),
        "0bgr": ((3, 2, 1), 4, 8),
        "argb": ((1, 2, 3), 4, 8),
        "abgr": ((3, 2, 1), 4, 8),
        "rgb48le": ((0, 1, 2), 3, 16),
        "bgr48le": ((2, 1, 0), 3, 16),
        "rgba64le": ((0, 1, 2), 4, 16),
        "bgra64le": ((2, 1, 0), 4, 16),
    }
)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How a pixel format lays out its colour; alpha is left out.

    bits       : of a sample.
    is_rgb     : whether the planes are R, G, B rather than Y, Cb, Cr.
    always_full: whether the format itself says full range ("yuvj...").
    order      : planes of R, G, B or Y, Cb, Cr; one for grey.
    halved     : whether chroma has half the rows, half the columns.
    packed     : samples a pixel where colour is interleaved, else 0; `order` then counts samples.
    """

    bits: int
    is_rgb: bool
    order: tuple[int, ...]
    halved: tuple[bool, bool] = (False, False)
    always_full: bool = False
    packed: int = 0


def layout_of(name: str) -> Layout | None:
    """The layout of a pixel format by ffmpeg's name; None for those not read (paletted, Bayer, float, big-endian, half-packed)."""
    if name in _PACKED:
        order, samples, bits = _PACKED[name]
        return Layout(bits=bits, is_rgb=True, order=order, packed=samples)
    match = _PLANAR.fullmatch(name)
    if match is None:
        return None
    bits = int(match["bits"] or 8)
    if match["rgb"]:
        return Layout(bits=bits, is_rgb=True, order=(2, 0, 1))
    if match["grey"]:
        return Layout(bits=bits, is_rgb=False, order=(0,))
    chroma = match["chroma"]
    return Layout(
        bits=bits, is_rgb=False, order=(0, 1, 2), halved=(chroma in ("420", "440"), chroma in ("422", "420")), always_full=bool(match["full"])
    )


def planes_of(frame: Any, layout: Layout) -> list[npt.NDArray[Any]]:
    """A PyAV frame's planes as (H, W) arrays over the decoder's own memory, in the order of `layout`; padding of rows is left out."""
    dtype = np.dtype(np.uint8 if layout.bits == 8 else "<u2")
    H, W = frame.height, frame.width

    def rows(plane: Any, h: int, w: int) -> npt.NDArray[Any]:
        stride = plane.line_size // dtype.itemsize
        return np.frombuffer(plane, dtype, count=stride * h).reshape(h, stride)[:, :w]

    if layout.packed:
        whole = rows(frame.planes[0], H, W * layout.packed)
        return [np.ascontiguousarray(whole[:, k :: layout.packed]) for k in layout.order]
    h, w = (-(-n // 2) if half else n for n, half in zip((H, W), layout.halved))
    sizes = [(H, W)] + [(H, W) if layout.is_rgb else (h, w)] * 2
    if layout.is_rgb:
        return [rows(frame.planes[k], H, W) for k in layout.order]
    return [rows(frame.planes[k], *sizes[k]) for k in layout.order]
