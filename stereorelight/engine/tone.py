"""Scene-linear pictures to tone levels and on to 8 bits, one pass each.

In: (H, W, 3) float32 RGB.  Levels are 0..`LEVELS` - 1 as uint16, BGR, by the square root of light."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32, UInt8, UInt16
from stereorelight.engine.fastmath import kernel
from stereorelight.engine.rows import in_pieces

f4 = np.float32
LEVELS = 4096  # sixteen to an 8-bit grey level


_leaf = kernel(fastmath=False, noalias=True)


@_leaf
def _level_row(flat, scale, out):
    """Tone levels of a row, as it comes; `flat` (3 W,)."""
    for i in range(flat.size):
        v = flat[i] * scale
        v = v if v > f4(0) else f4(0)  # false for NaN
        v = v if v < f4(1) else f4(1)
        out[i] = np.int32(np.sqrt(v) * f4(LEVELS - 1) + f4(0.5))


@_leaf
def _known_row(flat, out):
    """Returns how many pixels of a row are known, finite in every channel."""
    n = 0
    for x in range(out.size):
        total = flat[3 * x] + flat[3 * x + 1] + flat[3 * x + 2]
        out[x] = total - total == f4(0)  # false for NaN and infinity
        n += out[x]
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _mend_row(known, out):
    """Unknown pixels take the nearest known one of their row, so that a frame's border has no step to match."""
    W = known.size
    last = -1
    for x in range(W):
        if known[x]:
            last = x
        elif last >= 0:
            for c in range(3):
                out[x, c] = out[last, c]
    last = -1
    for x in range(W - 1, -1, -1):
        if known[x]:
            last = x
            if x == 0 or known[x - 1]:
                continue
            left = x - 1
            while left >= 0 and not known[left]:
                left -= 1
            for k in range(left + 1, x):
                if left < 0 or x - k < k - left:
                    for c in range(3):
                        out[k, c] = out[x, c]


@njit(cache=True, nogil=True, error_model="numpy")
def _brightest(linear, step, out):
    n = 0
    for y in range(0, linear.shape[0], step):
        for x in range(0, linear.shape[1], step):
            r, g, b = linear[y, x, 0], linear[y, x, 1], linear[y, x, 2]
            total = r + g + b
            if total - total == f4(0):  # false for NaN and infinity
                out[n] = max(max(r, g), b)
                n += 1
    return n


def brightest(linear: Float32, *, step: int = 1) -> Float32:
    """The brightest channel of each known pixel, one after another, in every `step`-th row and column."""
    out = np.empty(-(-linear.shape[0] // step) * -(-linear.shape[1] // step), np.float32)
    return out[: _brightest(linear, step, out)]


@njit(cache=True, nogil=True, error_model="numpy")
def _levels(first, end, linear, scale, out, known):
    W = linear.shape[1]
    row = np.empty(3 * W, np.int32)
    for y in range(first, end):
        flat = linear[y].reshape(3 * W)
        _level_row(flat, scale, row)
        for x in range(W):
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = row[3 * x + 2], row[3 * x + 1], row[3 * x]
        if _known_row(flat, known[y]) < W:
            _mend_row(known[y], out[y])


@njit(cache=True, nogil=True, error_model="numpy")
def _codes(first, end, linear, scale, table, out):
    W = linear.shape[1]
    row, known = np.empty(3 * W, np.int32), np.empty(W, np.bool_)
    for y in range(first, end):
        flat = linear[y].reshape(3 * W)
        _level_row(flat, scale, row)
        for x in range(W):
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = table[row[3 * x + 2]], table[row[3 * x + 1]], table[row[3 * x]]
        if _known_row(flat, known) < W:
            _mend_row(known, out[y])


def levels(linear: Float32, *, white: float) -> tuple[UInt16, Bool]:
    """Tone levels (H, W, 3) BGR of scene-linear RGB, clipped at `white`, and (H, W) where the picture is known."""
    out, known = np.empty(linear.shape, np.uint16), np.empty(linear.shape[:2], np.bool_)
    in_pieces(lambda first, end: _levels(first, end, linear, f4(1 / white), out, known), linear.shape[0])
    return out, known


def codes(linear: Float32, *, white: float) -> UInt8:
    """8-bit BGR (H, W, 3) of scene-linear RGB in its own tones: `levels` and a straight table in one pass."""
    out = np.empty(linear.shape, np.uint8)
    table = (np.linspace(0, 255, LEVELS, dtype=np.float32) + f4(0.5)).astype(np.uint8)
    in_pieces(lambda first, end: _codes(first, end, linear, f4(1 / white), table, out), linear.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _through(first, end, level, tables, bgr, grey):
    W = level.shape[1]
    for y in range(first, end):
        for x in range(W):
            b, g, r = tables[0, level[y, x, 0]], tables[1, level[y, x, 1]], tables[2, level[y, x, 2]]
            bgr[y, x, 0], bgr[y, x, 1], bgr[y, x, 2] = np.uint8(b + f4(0.5)), np.uint8(g + f4(0.5)), np.uint8(r + f4(0.5))
            grey[y, x] = f4(0.114) * b + f4(0.587) * g + f4(0.299) * r


def through_tables(level: UInt16, tables: Float32) -> tuple[UInt8, Float32]:
    """8-bit BGR and float grey (0..255) of tone levels; `tables` (3, LEVELS) float32 holds 0..255 for each channel."""
    bgr, grey = np.empty(level.shape, np.uint8), np.empty(level.shape[:2], np.float32)
    in_pieces(lambda first, end: _through(first, end, level, tables, bgr, grey), level.shape[0])
    return bgr, grey


@njit(cache=True, nogil=True, error_model="numpy")
def _twists(picture, channel, counts):
    H, W = picture.shape[:2]
    for y in range(1, H - 1, 2):
        for x in range(1, W - 1, 2):
            total = 4 * np.int64(picture[y, x, channel])
            for d in (-1, 1):
                total -= 2 * (np.int64(picture[y + d, x, channel]) + np.int64(picture[y, x + d, channel]))
                total += np.int64(picture[y + d, x - 1, channel]) + np.int64(picture[y + d, x + 1, channel])
            counts[abs(total)] += 1


def median_twist(picture: UInt8, channel: int) -> float:
    """Median size of the mask 1 -2 1, -2 4 -2, 1 -2 1, which knows no ramps, over every other pixel of every other row of a channel."""
    counts = np.zeros(8 * 255 + 1, np.int64)
    _twists(picture, channel, counts)
    upto, n = np.cumsum(counts), int(counts.sum())
    return float(np.searchsorted(upto, (n - 1) // 2, "right") + np.searchsorted(upto, n // 2, "right")) / 2 if n else float("nan")
