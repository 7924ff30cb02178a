"""Video planes to R'G'B' and back, exactly: our own matrix, range and chroma code, for 8 to 16 bits.

In, out: planes (H, W) of whole numbers, and (H, W, 3) float32 encoded R'G'B' in which 0 is black and 1 is white; nothing is
clipped on the way in, so what is whiter than white or blacker than black stays.  Pixels: (0, 0) is the top-left one.

Sources: ITU-T H.273 (09/2023) 8.3 and tables 3 and 4, ITU-R BT.601-7, BT.709-6, BT.2020-2 (non-constant luminance).
With n bits and k = 2^(n - 8): video range has black at 16 k, white at 235 k and chroma 128 k +- 112 k; full range has 0,
2^n - 1 and 2^(n - 1) +- (2^n - 1) / 2.

Chroma siting: in 4:2:2 and 4:2:0 a chroma sample lies on the even luma column ("left", MPEG-2, H.264's and H.265's default);
in 4:2:0 it lies halfway between an even row and the next odd one.  Between samples chroma is interpolated linearly, at the border
the outer sample is repeated.  "topleft" (common for BT.2020 4:2:0) lies on the even row too, "center" (JPEG, MPEG-1) halfway both ways.
Down again, the mean of those pixels is taken over which that interpolation spreads a sample: 1 2 1 about a pixel, 1 1 between two,
so that flat areas and straight gradients come back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import PassError, PlateError, nearest_hint

Siting = Literal["left", "topleft", "center"]
Subsampling = Literal["444", "422", "420"]
# Kr and Kb of H.273 table 4: matrix coefficients 5 and 6, 1, and 9.
WEIGHTS: Mapping[str, tuple[float, float]] = MappingProxyType({"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)})
# Weights of a pixel's further chroma sample: of the row above in even rows and below in odd ones, of the column before and after.
SITINGS: Mapping[str, tuple[float, float, float, float]] = MappingProxyType(
    {"left": (0.25, 0.25, 0.0, 0.5), "topleft": (0.0, 0.5, 0.0, 0.5), "center": (0.25, 0.25, 0.25, 0.25)}
)
BITS = range(8, 17)


class Transfer(Protocol):
    """What `rgb_from_planes` reads of a `footage.colour.TransferTable`: a curve sampled evenly on low..high, and a 3x3 after it."""

    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...
    @property
    def table(self) -> Float32: ...
    @property
    def matrix(self) -> Float32 | None: ...


def weights(matrix: str) -> tuple[float, float]:
    """Kr and Kb of "bt601", "bt709" or "bt2020".  Raises PlateError for any other name."""
    if matrix not in WEIGHTS:
        raise PlateError(f"colour matrix {matrix!r} is unknown{nearest_hint(str(matrix), WEIGHTS)}")
    return WEIGHTS[matrix]


def levels(bits: int, full_range: bool) -> tuple[float, float, float, float]:
    """Code of black, codes from black to white, code of neutral chroma, codes from -0.5 to 0.5 of chroma.

    Raises : PlateError unless 8 <= bits <= 16.
    """
    if bits not in BITS:
        raise PlateError(f"planes of {bits} bits are not read or written here; 8 to 16 are")
    if full_range:
        return 0.0, 2.0**bits - 1, 2.0 ** (bits - 1), 2.0**bits - 1
    k = 2.0 ** (bits - 8)
    return 16 * k, 219 * k, 128 * k, 224 * k


def matrix_factors(matrix: str) -> tuple[float, float, float, float]:
    """Weight of Cr in R, of Cb and of Cr in G (to be taken away), of Cb in B; H.273 equations 41 to 43 turned round."""
    kr, kb = weights(matrix)
    kg = 1 - kr - kb
    return 2 * (1 - kr), 2 * kb * (1 - kb) / kg, 2 * kr * (1 - kr) / kg, 2 * (1 - kb)


def _rows(plane: Any, bits: int) -> npt.NDArray[Any]:
    """A plane as C-contiguous (rows, stride), padding of its rows included, for the kernel; no copy where the layout allows."""
    a = np.asarray(plane)
    if a.ndim != 2 or 0 in a.shape or a.dtype not in (np.uint8, np.uint16):
        raise PassError(f"a plane must be (H, W) uint8 or uint16, got {a.shape} {a.dtype}")
    if a.dtype == np.uint8 and bits > 8:
        raise PassError(f"planes of {bits} bits must be uint16, got uint8")
    step, item = a.strides
    if a.flags.c_contiguous or item != a.itemsize or step % item or step < a.shape[1] * item:
        return np.ascontiguousarray(a)
    return np.lib.stride_tricks.as_strided(a, (a.shape[0], step // item), a.strides)


def subsampling_of(luma_hw: tuple[int, int], chroma_hw: tuple[int, int]) -> tuple[bool, bool]:
    """Whether chroma has half the rows, half the columns (rounded up).  Raises PassError for anything else."""
    (H, W), (h, w) = luma_hw, chroma_hw
    rows, columns = h != H, w != W
    if h != (-(-H // 2) if rows else H) or w != (-(-W // 2) if columns else W):
        raise PassError(f"chroma planes of {w} x {h} do not belong to a luma plane of {W} x {H}; 4:4:4, 4:2:2 and 4:2:0 are read")
    return rows, columns


def rgb_from_planes(
    planes: Sequence[npt.ArrayLike],
    *,
    bits: int,
    full_range: bool,
    matrix: str,
    transfer: Transfer | None = None,
    siting: str = "left",
    out: Float32 | None = None,
) -> Float32:
    """(H, W, 3) float32 of one frame's planes: encoded R'G'B', 0..1 from black to white, unclipped; with `transfer` what it makes of it.

    planes   : Y, Cb, Cr, or Y alone for grey, or with matrix "rgb" R, G, B; (H, W) uint8 or uint16 with values of `bits` bits.
               Chroma is (H, W), (H, W / 2) or (H / 2, W / 2), halves rounded up.  Rows may be padded: no copy is made.
    matrix   : "bt601", "bt709", "bt2020", or "rgb".
    transfer : a curve and a 3x3 matrix, applied in the same pass; the curve by linear interpolation, going on straight beyond its ends.
    siting   : where chroma lies: "left", "topleft", "center".
    out      : filled and returned in place of a new array.
    Raises   : PlateError for an unknown matrix, siting or depth; PassError for arrays that do not fit.
    White is exactly 1, black exactly 0, and greys have three equal channels."""
    black, white, neutral, chroma = levels(bits, full_range)
    factors = None if matrix == "rgb" else matrix_factors(matrix)
    if siting not in SITINGS:
        raise PlateError(f"chroma siting {siting!r} is unknown{nearest_hint(str(siting), SITINGS)}")
    arrays = [np.asarray(plane) for plane in planes]
    if len(arrays) not in (1, 3):
        raise PassError(f"a frame has one plane or three here, got {len(arrays)}")
    if len(arrays) == 1:
        arrays, factors = arrays * 3, None
    shapes = [a.shape for a in arrays]
    padded = [_rows(a, bits) for a in arrays]
    H, W = shapes[0]
    if shapes[1] != shapes[2] or (factors is None and shapes[1] != shapes[0]):
        raise PassError(f"planes of one frame do not fit each other: {', '.join(f'{s[1]} x {s[0]}' for s in shapes)}")
    halved = (False, False) if factors is None else subsampling_of((H, W), shapes[1])
    if out is None:
        out = np.empty((H, W, 3), np.float32)
    elif out.shape != (H, W, 3) or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise PassError(f"out must be ({H}, {W}, 3) float32 and C-contiguous, got {out.shape} {out.dtype}")
    from stereorelight.engine.ycbcr import planes_to_rgb

    return planes_to_rgb(
        (padded[0], padded[1], padded[2]),
        out,
        levels=(black, white, neutral, chroma),
        weights=factors,
        halved=halved,
        siting=SITINGS[siting],
        curve=None if transfer is None else (transfer.low, transfer.high, transfer.table),
        matrix=None if transfer is None else transfer.matrix,
    )


def planes_from_rgb(
    rgb: npt.ArrayLike, *, bits: int, full_range: bool, matrix: str, subsampling: str, siting: str = "left"
) -> tuple[npt.NDArray[Any], ...]:
    """Y, Cb, Cr planes, uint8 for 8 bits and uint16 above, of encoded R'G'B' (H, W, 3); with matrix "rgb" R, G, B planes.

    rgb         : floats, 0..1 from black to white; what is beyond stays as far as the codes reach.
    subsampling : "444", "422", "420"; chroma lies as `siting` says.
    Raises      : PlateError for an unknown matrix, siting, subsampling or depth; PassError for a wrong shape, or NaN.
    Computed in float64 and rounded once, so every sample is the nearest code, and 4:4:4 planes come back from `rgb_from_planes` as they were.
    """
    a = np.asarray(rgb)
    if a.ndim != 3 or a.shape[2] != 3 or 0 in a.shape or not np.issubdtype(a.dtype, np.floating):
        raise PassError(f"a picture must be (H, W, 3) floats, got {a.shape} {a.dtype}")
    if subsampling not in ("444", "422", "420"):
        raise PlateError(f"chroma subsampling {subsampling!r} is unknown; 444, 422 and 420 are written")
    if siting not in SITINGS:
        raise PlateError(f"chroma siting {siting!r} is unknown{nearest_hint(str(siting), SITINGS)}")
    scale = levels(bits, full_range)
    if not np.isfinite(a).all():
        raise PassError("a picture to be stored in planes has NaN or infinite values; paint them first")
    if matrix == "rgb" and subsampling != "444":
        raise PlateError(f"R, G, B planes are never subsampled, so {subsampling!r} does not go with matrix 'rgb'; take '444'")
    from stereorelight.engine.ycbcr_codes import rgb_to_planes

    return rgb_to_planes(
        a if a.dtype in (np.float32, np.float64) else a.astype(np.float64),
        bits=bits,
        levels=scale,
        weights=None if matrix == "rgb" else weights(matrix),
        halved=(subsampling == "420", subsampling != "444"),
        cosited=(siting == "topleft", siting != "center"),
    )
