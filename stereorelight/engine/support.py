"""Matching by adaptive support: what each disparity costs a pixel, averaged over those neighbours that look like it.

In: two rectified pictures, rows agreeing, and a range of whole-pixel disparities.  Out: the best disparity of either eye, (H, W) float32.
The cost is a census transform of three answers (brighter, alike, darker; after Zabih and Woodfill 1994) with a truncated difference of
grey.  It is averaged by a recursive filter whose weights fall with every step of colour on the way (after Gastal and Oliveira 2011, Pham
and Jeon 2013), so a window of cost takes the shape of the thing that it lies on: gaps between slats stay gaps.
The costs of `CHUNK` disparities are held at a time, whatever the range.  Sums have a fixed order: the same bits whatever the threads."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.arrays import Float32, UInt8
from stereorelight.engine.fastmath import bits_of, float_of
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.support_vector import LANES, back, costs, forth, least, take_less

f4 = np.float32
i4 = np.int32
CHUNK = LANES  # disparities held at a time
COLUMNS = 16  # of a block of the filter along columns
REACH = 2  # px of the census window
FAR = np.int32(0x7F000000)  # above every cost


@njit(cache=True, nogil=True, error_model="numpy")
def _census_part(row, other, alike, out):
    """Two more bits of each word of a row: `other` is its neighbours' row, shifted."""
    for x in range(row.size):
        d = other[x] - row[x]
        out[x] = (out[x] << np.uint64(2)) | (np.uint64(d > alike) << np.uint64(1)) | np.uint64(d > -alike)


@njit(cache=True, nogil=True, error_model="numpy")
def _census(first, end, wide, alike, out):
    W = out.shape[1]
    for y in range(first, end):
        out[y] = np.uint64(0)
        for j in range(2 * REACH + 1):
            for i in range(2 * REACH + 1):
                if i != REACH or j != REACH:
                    _census_part(wide[y + REACH, REACH : REACH + W], wide[y + j, i : i + W], alike, out[y])


def census(grey: Float32, *, alike: float) -> npt.NDArray[np.uint64]:
    """(H, W) uint64: of each of 24 neighbours whether it is brighter, alike (within `alike` grey levels) or darker, two bits each.

    The bits that differ between two such words are the steps that the answers are apart.
    """
    out = np.empty(grey.shape, np.uint64)
    wide = np.pad(grey, REACH, mode="edge")
    in_row_blocks(lambda a, b: _census(a, b, wide, f4(alike), out), grey.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _along_row(cost, weight, n, front, ahead):
    """Each pixel's mean cost over its row, each other pixel weighed by the product of the weights on the way; all flat."""
    W = weight.size
    n[0] = f4(1)
    front[:CHUNK], ahead[:] = cost[:CHUNK], f4(0)
    for x in range(1, W):
        forth(cost, x * CHUNK, weight[x], front, (x - 1) * CHUNK, x * CHUNK)
        n[x] = f4(1) + weight[x] * n[x - 1]
    m = f4(0)
    for x in range(W - 1, -1, -1):
        back(cost, x * CHUNK, weight[x], f4(1) / (n[x] + m), front, x * CHUNK, ahead, 0)
        m = weight[x] * (m + f4(1))


@njit(cache=True, nogil=True, error_model="numpy")
def _rows(first, end, word, grey, other_word, other_grey, top, cap, step, given, pull, limit, weight, cost):
    """Costs of the disparities top, top - 1, ...: cost[y, x, k] is of top - k, which lies at column x - top + k of the other eye."""
    W = grey.shape[1]
    before = max(0, top)  # columns that are looked up before the frame, and after it
    after = max(0, CHUNK - 1 - top)
    words, greys = np.empty(before + W + after, np.uint64), np.empty(before + W + after, np.float32)
    n, front, ahead = np.empty(W, np.float32), np.empty(W * CHUNK, np.float32), np.empty(CHUNK, np.float32)
    for y in range(first, end):
        words[:before], greys[:before] = other_word[y, 0], other_grey[y, 0]
        words[before : before + W], greys[before : before + W] = other_word[y], other_grey[y]
        words[before + W :], greys[before + W :] = other_word[y, W - 1], other_grey[y, W - 1]
        c = cost[y].reshape(W * CHUNK)
        for x in range(W):
            d = given[y, x]
            most = limit if d == d else f4(0)
            costs(words, greys, x - top + before, word[y, x], grey[y, x], step, cap, f4(top) - d, pull, most, c, x * CHUNK)
        _along_row(c, weight[y], n, front, ahead)


@njit(cache=True, nogil=True, error_model="numpy")
def _columns(first, end, weight, cost):
    """The same along columns, `first` to `end`."""
    H, W = cost.shape[:2]
    columns = end - first
    flat, front = cost.reshape(H * W * CHUNK), np.empty(H * columns * CHUNK, np.float32)
    ahead = np.zeros(columns * CHUNK, np.float32)
    norm, m = np.ones((H, columns), np.float32), np.zeros(columns, np.float32)
    front[: columns * CHUNK] = flat[first * CHUNK : end * CHUNK]
    for y in range(1, H):
        for x in range(columns):
            a = weight[y, first + x]
            at = (y * columns + x) * CHUNK
            forth(flat, (y * W + first + x) * CHUNK, a, front, at - columns * CHUNK, at)
            norm[y, x] = f4(1) + a * norm[y - 1, x]
    for y in range(H - 1, -1, -1):
        for x in range(columns):
            a = weight[y, first + x]
            inverse = f4(1) / (norm[y, x] + m[x])
            back(flat, (y * W + first + x) * CHUNK, a, inverse, front, (y * columns + x) * CHUNK, ahead, x * CHUNK)
            m[x] = a * (m[x] + f4(1))


@njit(cache=True, nogil=True, error_model="numpy")
def _best(first, end, cost, top, index, keep, best, below, above, last, right):
    """Take in a chunk: `best` and `right` are costs with the disparity's index in their lowest bits; `below` and `above` the costs of
    one disparity less and more."""
    W = best.shape[1]
    for y in range(first, end):
        mine, other, c = best[y], right[y], cost[y].reshape(W * CHUNK)
        for x in range(W):
            at = x * CHUNK
            if mine[x] & ~keep == index - 1:  # the best of all so far was the last of the chunk before
                below[y, x] = c[at]
            m = least(c, at, keep, i4(index))
            if m < mine[x]:
                mine[x] = m
                k = (m & ~keep) - index
                above[y, x] = c[at + k - 1] if k > 0 else last[y, x]
                below[y, x] = c[at + k + 1] if k < CHUNK - 1 else f4(np.inf)
            last[y, x] = c[at + CHUNK - 1]
            u = x - top
            if u >= 0 and u + CHUNK <= W:
                take_less(c, at, keep, i4(index), other, u)
            else:
                for k in range(max(0, -u), min(CHUNK, W - u)):
                    other[u + k] = min(other[u + k], (bits_of(c[at + k]) & keep) | i4(index + k))


@njit(cache=True, nogil=True, error_model="numpy")
def _answers(first, end, best, below, above, right, keep, highest, left_out, right_out):
    W = best.shape[1]
    for y in range(first, end):
        for x in range(W):
            d = f4(highest - (best[y, x] & ~keep))
            m = f4(0)
            low, high = below[y, x], above[y, x]
            here = np.int32(best[y, x] & keep)
            middle = float_of(here)
            curve = low - f4(2) * middle + high
            if curve > f4(0) and low < f4(np.inf) and high < f4(np.inf):
                m = min(max(f4(0.5) * (low - high) / curve, f4(-0.5)), f4(0.5))
            left_out[y, x] = d + m
            right_out[y, x] = f4(highest - (right[y, x] & ~keep)) if right[y, x] < FAR else f4(np.nan)


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(first, end, picture, tones, reach, across, down):
    W = picture.shape[1]
    for y in range(first, end):
        for x in range(W):
            i, j = max(x - 1, 0), max(y - 1, 0)
            a = b = f4(0)
            for c in range(3):
                a = max(a, abs(f4(picture[y, x, c]) - f4(picture[y, i, c])))
                b = max(b, abs(f4(picture[y, x, c]) - f4(picture[j, x, c])))
            across[y, x], down[y, x] = np.exp(-a / tones - f4(1) / reach), np.exp(-b / tones - f4(1) / reach)


def supported(
    left: UInt8,
    left_grey: Float32,
    right_grey: Float32,
    low: int,
    count: int,
    *,
    given: Float32 | None = None,
    alike: float = 1.0,
    cap_levels: float = 8.0,
    step: float = 2.0,
    pull: float = 2.0,
    limit: float = 8.0,
    tones: float = 20.0,
    reach_px: float = 20.0,
) -> tuple[Float32, Float32]:
    """Disparity of the left eye, to a part of a pixel, and of the right eye, whole pixels, NaN where nothing lands; (H, W) each.

    left        : (H, W, 3) uint8, whose colours part things.   left_grey, right_grey: (H, W) both eyes in grey, 0..255.
    low, count  : whole disparities low to low + count - 1 are looked at; count a multiple of 16.
    given       : (H, W) px, another matcher's answer, NaN where it has none; a disparity costs `pull` a pixel more off it, up to `limit`.
    alike       : grey levels within which two neighbours are alike to the census.   step: cost of each of its answers that is one off.
    cap_levels  : a difference of grey larger than this is a difference.
    tones, reach_px : a neighbour counts 1/e where colour has changed by `tones` grey levels in all on the way, or this many px away.
    """
    H, W = left_grey.shape
    words, other_words = census(left_grey, alike=alike), census(right_grey, alike=alike)
    across, down = np.empty((H, W), np.float32), np.empty((H, W), np.float32)
    in_row_blocks(lambda a, b: _alike(a, b, left, f4(tones), f4(reach_px), across, down), H)
    given = np.full((H, W), np.nan, np.float32) if given is None else given
    chunks = -(-count // CHUNK)
    keep = i4(-(1 << int(chunks * CHUNK).bit_length()))
    cost = np.empty((H, W, CHUNK), np.float32)
    best, other = np.full((H, W), FAR, np.int32), np.full((H, W), FAR, np.int32)
    below, above, last = (np.full((H, W), np.inf, np.float32) for _ in range(3))
    highest = low + count - 1
    for index in range(0, chunks * CHUNK, CHUNK):
        top = highest - index
        of_row = (words, left_grey, other_words, right_grey, top, f4(cap_levels), f4(step), given, f4(pull), f4(limit), across, cost)
        in_row_blocks(partial(_spread, _rows, of_row), H)
        in_row_blocks(partial(_spread, _columns, (down, cost)), W, block_rows=COLUMNS)
        in_row_blocks(partial(_spread, _best, (cost, top, index, keep, best, below, above, last, other)), H)
    answer, answer_right = np.empty((H, W), np.float32), np.empty((H, W), np.float32)
    in_row_blocks(lambda a, b: _answers(a, b, best, below, above, other, keep, highest, answer, answer_right), H)
    return answer, answer_right


def _spread(kernel: Any, given: tuple[Any, ...], first: int, end: int) -> None:
    kernel(first, end, *given)
