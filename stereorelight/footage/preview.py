"""Pictures for people: plates and passes as (H, W, 3) uint8 sRGB, ready for `stills.write_still` and `movie.writer`.

In: scene-linear plates and layers, Z in metres, P and N in the scene frame.  Missing pixels show as a magenta checker in
pictures of colour and as dark gray in pictures of data.  Nothing here is meant to be measured."""

from __future__ import annotations

import functools
import math
import unicodedata
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.errors import PassError
from stereorelight.footage.colour import decode, encode
from stereorelight.passes import Flag

MISSING = (40, 40, 40)
CHECKER = ((200, 0, 200), (90, 0, 90))
CHECKER_PX = 8
KNEE = 0.8  # scene-linear; above it highlights bend towards white instead of clipping
Anaglyph = Literal["dubois", "half-colour"]
# Linear light of the red-cyan picture from the left and from the right eye's, by least squares over the spectra of screens and
# filters: E. Dubois, A projection method to generate anaglyph stereo images, ICASSP 2001.  White and greys stay as they are.
DUBOIS_LEFT = ((0.4561, 0.500484, 0.176381), (-0.0400822, -0.0378246, -0.0157589), (-0.0152161, -0.0205971, -0.00546856))
DUBOIS_RIGHT = ((-0.0434706, -0.0879388, -0.00155529), (0.378476, 0.73364, -0.0184503), (-0.0721527, -0.112961, 1.2264))
LUMA = (0.2126, 0.7152, 0.0722)  # Rec.709
ENCODE_STEPS = 1 << 14  # of linear light: an sRGB code near black is five of them
FLAG_COLOURS = {
    Flag.BAD_PLATE: (230, 0, 230),
    Flag.REPAIRED: (245, 245, 245),
    Flag.OUT_OF_VIEW: (60, 110, 230),
    Flag.OCCLUDED: (230, 90, 40),
    Flag.UNMATCHED: (235, 205, 50),
    Flag.TOO_FAR: (70, 200, 220),
    Flag.TOO_NEAR: (200, 60, 90),
    Flag.FILLED: (90, 180, 90),
}


def _u8(values: npt.ArrayLike) -> UInt8:
    """0..1 to 0..255, NaN to 0."""
    return np.rint(np.clip(np.nan_to_num(np.asarray(values, dtype=np.float32), nan=0.0), 0, 1) * 255).astype(np.uint8)


def _checkered(picture: UInt8, missing: Bool) -> UInt8:
    if missing.any():
        rows, columns = np.nonzero(missing)
        squares = np.array(CHECKER, dtype=np.uint8)
        picture[rows, columns] = squares[(rows // CHECKER_PX + columns // CHECKER_PX) % 2]
    return picture


@functools.lru_cache(maxsize=1)
def colour_table() -> UInt8:
    """(256, 3) from dark violet (far, low) to pale yellow (near, high): lightness rises evenly, hue turns the blue way.

    Computed in Oklab (B. Ottosson, 2020), so that equal steps look equal.
    """
    t = np.linspace(0, 1, 256)
    lightness, hue, chroma = 0.28 + 0.66 * t, np.radians(295 - 190 * t), np.full_like(t, 0.09)  # as strong as stays inside sRGB
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
    lms = np.stack([lightness + 0.3963377774 * a + 0.2158037573 * b, lightness - 0.1055613458 * a - 0.0638541728 * b])
    lms = np.concatenate([lms, (lightness - 0.0894841775 * a - 1.2914855480 * b)[None]]) ** 3
    to_rgb = [[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965], [-0.0041960863, -0.7034186147, 1.7076147010]]
    table = _u8(encode(np.clip(np.array(to_rgb) @ lms, 0, 1).T, "sRGB"))
    table.setflags(write=False)
    return table


def plate_picture(linear: Float32, *, exposure_stops: float = 0.0) -> UInt8:
    """A scene-linear (H, W, 3) plate as sRGB; highlights above 0.8 roll off smoothly; NaN and inf are checkered."""
    bad: Bool = np.logical_not(np.isfinite(linear).all(axis=-1))
    x = np.where(bad[..., None], np.float32(0), linear) * np.float32(2.0**exposure_stops)
    over = np.maximum(x - KNEE, 0)
    rolled = np.minimum(x, KNEE) + (1 - KNEE) * (1 - np.exp(-over / (1 - KNEE)))
    return _checkered(_u8(encode(np.maximum(rolled, 0), "sRGB")), bad)


def light_picture(layer: Float32, *, exposure_stops: float = 0.0) -> UInt8:
    """One light's layer alone, as `plate_picture` shows it."""
    return plate_picture(layer, exposure_stops=exposure_stops)


def depth_range(Z_m: Float32) -> tuple[float, float]:
    """(near, far) metres that hold all but the outermost percent at either end; give a sequence one range, or it pumps."""
    known = Z_m[np.isfinite(Z_m) & (Z_m > 0)]
    if known.size == 0:
        return 1.0, 10.0
    near, far = (float(v) for v in np.percentile(known, (1, 99)))
    return (near, far) if far > near * 1.001 else (near * 0.9, far * 1.1)


def depth_picture(Z_m: Float32, *, near: float | None = None, far: float | None = None) -> UInt8:
    """(H, W) Z in metres as colour, bright near and dark far, even in 1 / Z as a stereo pair sees it.

    near, far : metres at the ends of the colours; `depth_range(Z_m)` where not given.
    """
    low, high = depth_range(Z_m)
    near, far = low if near is None else near, high if far is None else far
    if not 0 < near < far:
        raise PassError(f"a depth picture needs 0 < near < far, got near {near:g}, far {far:g} m")
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (1 / Z_m - 1 / far) / (1 / near - 1 / far)
    picture = colour_table()[_u8(t)]
    picture[~(np.isfinite(Z_m) & (Z_m > 0))] = MISSING
    return picture


def confidence_picture(confidence: Float32) -> UInt8:
    """(H, W) confidence 0..1 on the colour table: bright is sure."""
    picture = colour_table()[_u8(confidence)]
    picture[np.isnan(confidence)] = MISSING
    return picture


def normals_picture(N: Float32) -> UInt8:
    """0.5 + 0.5 N: right is red, up is green, towards the camera is blue."""
    picture = _u8(0.5 + 0.5 * N)
    picture[~np.isfinite(N).all(axis=-1)] = MISSING
    return picture


def position_picture(P_m: Float32) -> UInt8:
    """(H, W, 3) P as colour, each axis stretched over its own 1..99 percent."""
    missing = ~np.isfinite(P_m).all(axis=-1)
    picture = np.zeros(P_m.shape, dtype=np.uint8)
    if not missing.all():
        low, high = np.percentile(P_m[~missing], (1, 99), axis=0)
        picture = _u8((P_m - low.astype(np.float32)) / np.maximum(high - low, 1e-6).astype(np.float32))
    picture[missing] = MISSING
    return picture


def flags_picture(flags: npt.NDArray[np.integer]) -> UInt8:
    """One colour per reason, see FLAG_COLOURS; where several hold, the graver one; trusted pixels are dark gray."""
    picture = np.full((*flags.shape, 3), 60, dtype=np.uint8)
    for flag, colour in reversed(FLAG_COLOURS.items()):
        picture[(flags & int(flag)) != 0] = colour
    return picture


def shrunk(picture: UInt8, width: int) -> UInt8:
    """The picture no wider than `width`, averaged down; smaller ones as they are."""
    import cv2

    h, w = picture.shape[:2]
    return picture if w <= width else cv2.resize(picture, (width, max(1, round(h * width / w))), interpolation=cv2.INTER_AREA)


def before_after(before: UInt8, after: UInt8, *, wipe: float | None = None) -> UInt8:
    """Two pictures of one size side by side, or with `wipe` in 0..1 as one picture cut there; a thin white line between."""
    if before.shape != after.shape:
        raise PassError(f"before and after must have one size, got {before.shape} and {after.shape}")
    line = max(1, before.shape[1] // 480)
    if wipe is None:
        return np.concatenate([before, np.full((before.shape[0], line, 3), 255, dtype=np.uint8), after], axis=1)
    at = round(min(max(wipe, 0.0), 1.0) * before.shape[1])
    picture = np.concatenate([before[:, :at], after[:, at:]], axis=1)
    picture[:, max(at - line // 2, 0) : at - line // 2 + line] = 255
    return picture


@functools.lru_cache(maxsize=1)
def _srgb_tables() -> tuple[Float32, UInt8]:
    """Linear light of the 256 sRGB codes, and the sRGB code of ENCODE_STEPS + 1 even steps of it."""
    return decode(np.arange(256) / 255, "sRGB"), _u8(encode(np.arange(ENCODE_STEPS + 1) / ENCODE_STEPS, "sRGB"))


def anaglyph(left: UInt8, right: UInt8, *, method: Anaglyph = "dubois", shift_px: int = 0) -> UInt8:
    """Both eyes' (H, W, 3) sRGB pictures as one for red-cyan glasses, red on the left eye.

    method : "dubois", colours by least squares with the least ghosting, or "half-colour", the left eye's luma in red and the
             right eye's own green and blue, which other programs know under that name.
    shift_px: disparity that comes to lie in the plane of the screen; the picture is that much narrower.
    Rows of the two should agree: take rectified pictures.
    Raises : PassError for pictures of two sizes or an unknown method.
    """
    if left.shape != right.shape:
        raise PassError(f"left and right must have one size for an anaglyph, got {left.shape} and {right.shape}")
    width = left.shape[1]
    if abs(shift_px) >= width:
        raise PassError(f"an anaglyph {width} px wide cannot be shifted by {shift_px} px")
    left = left[:, max(shift_px, 0) : width + min(shift_px, 0)]
    right = right[:, max(-shift_px, 0) : width - max(shift_px, 0)]
    if method == "half-colour":
        luma = left.astype(np.float32) @ np.array(LUMA, np.float32)
        return np.dstack([np.rint(luma).astype(np.uint8), right[..., 1:]])
    if method != "dubois":
        raise PassError(f"anaglyph method {method!r} is unknown; take 'dubois' or 'half-colour'")
    linear, codes = _srgb_tables()
    mixed = linear[left] @ np.array(DUBOIS_LEFT, np.float32).T + linear[right] @ np.array(DUBOIS_RIGHT, np.float32).T
    return codes[np.rint(np.clip(mixed, 0, 1) * ENCODE_STEPS).astype(np.int32)]


def labelled(picture: UInt8, text: str) -> UInt8:
    """A copy of `picture` with a line of text burnt in at the lower left: shot, frame and time code of a review movie.

    The letters are as high as a thirtieth of the picture, or smaller where the line would not fit, on a darkened strip;
    the picture above the strip is left as it is.  Letters outside ASCII lose their accents or become "?".
    """
    import cv2

    plain = unicodedata.normalize("NFKD", text)
    plain = "".join(c if c.isascii() else "?" for c in plain if not unicodedata.combining(c))
    made: UInt8 = np.ascontiguousarray(picture).copy()
    if not plain.strip():
        return made
    h, w = made.shape[:2]
    font, margin = cv2.FONT_HERSHEY_SIMPLEX, max(2, h // 90)
    (text_w, text_h), _ = cv2.getTextSize(plain, font, 1.0, 2)
    scale = min(h / 30 / text_h, (w - 2 * margin) / text_w)
    thick = max(1, round(2 * scale))
    (text_w, text_h), under = cv2.getTextSize(plain, font, scale, thick)
    top = max(0, h - text_h - under - 2 * margin)
    made[top:] = made[top:] // 3
    cv2.putText(made, plain, (margin, h - under - margin), font, scale, (235, 235, 235), thick, cv2.LINE_AA)
    return made


def contact_sheet(pictures: Sequence[tuple[str, UInt8]], *, columns: int | None = None, width: int = 480) -> UInt8:
    """Labelled pictures in rows, each `width` pixels wide, on dark gray."""
    import cv2

    if not pictures:
        raise PassError("a contact sheet needs at least one picture")
    columns = columns or math.ceil(math.sqrt(len(pictures)))
    bar, gap = 24, 6
    cells = []
    for label, picture in pictures:
        height = max(1, round(picture.shape[0] * width / picture.shape[1]))
        shrinks = width < picture.shape[1]
        small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        cell = np.full((height + bar, width, 3), 30, dtype=np.uint8)
        cell[bar:] = small
        cv2.putText(cell, label, (6, bar - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (225, 225, 225), 1, cv2.LINE_AA)
        cells.append(cell)
    rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    heights = [max(cell.shape[0] for cell in row) for row in rows]
    sheet = np.full((sum(heights) + gap * (len(rows) + 1), (width + gap) * min(columns, len(cells)) + gap, 3), 30, dtype=np.uint8)
    top = gap
    for row, height in zip(rows, heights):
        for i, cell in enumerate(row):
            left = gap + i * (width + gap)
            sheet[top : top + cell.shape[0], left : left + width] = cell
        top += height + gap
    return sheet
