"""Matching by adaptive support: what each disparity costs a pixel, averaged over those neighbours that look like it.

In: two rectified pictures, rows agreeing, and a range of whole-pixel disparities.  Out: the best disparity of either eye, (H, W) float32.
The cost is a census transform of three answers (brighter, alike, darker; after Zabih and Woodfill 1994) with a truncated difference of
grey.  It is averaged by a recursive filter whose weights fall with every step of colour on the way (after Gastal and Oliveira 2011, Pham
and Jeon 2013), so a window of cost takes the shape of the thing that it lies on: gaps between slats stay gaps.
The costs of `CHUNK` disparities are held at a time, two bytes each, whatever the range.  Sums have a fixed order: the same bits whatever the
threads."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from stereorelight.arrays import Float32, UInt8
from stereorelight.engine.fastmath import float_of
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.support_vector import LANES, back, back_whole, costs, forth, forth_whole, least, take_less

f4 = np.float32
i4 = np.int32
CHUNK = LANES  # disparities held at a time
REACH = 2  # px of the census window
FAR = np.int32(0x7F000000)  # above every cost
CENSUS_STEPS = 2 * ((2 * REACH + 1) ** 2 - 1)  # that two pixels can be apart
MOST = 65_000.0  # the largest cost between rows and columns, where costs are whole numbers of 16 bits: half the memory to fetch


@njit(cache=True, nogil=True, error_model="numpy")
def _census_part(row, other, alike, out):
    """Two more bits of each word of a row: `other` is its neighbours' row, shifted."""
    for x in range(row.size):
        d = other[x] - row[x]
        out[x] = (out[x] << np.uint64(2)) | (np.uint64(d > alike) << np.uint64(1)) | np.uint64(d > -alike)


@njit(cache=True, nogil=True, error_model="numpy")
def _census(first, end, grey, alike, out):
    H, W = out.shape
    wide = np.empty((2 * REACH + 1, W + 2 * REACH), np.float32)  # the rows about one, the border repeated
    for y in range(first, end):
        for j in range(2 * REACH + 1):
            row = grey[min(max(y + j - REACH, 0), H - 1)]
            wide[j, :REACH], wide[j, REACH : REACH + W], wide[j, REACH + W :] = row[0], row, row[W - 1]
        out[y] = np.uint64(0)
        for j in range(2 * REACH + 1):
            for i in range(2 * REACH + 1):
                if i != REACH or j != REACH:
                    _census_part(wide[REACH, REACH : REACH + W], wide[j, i : i + W], alike, out[y])


def census(grey: Float32, *, alike: float) -> npt.NDArray[np.uint64]:
    """(H, W) uint64: of each of 24 neighbours whether it is brighter, alike (within `alike` grey levels) or darker, two bits each.

    The bits that differ between two such words are the steps that the answers are apart.
    """
    out = np.empty(grey.shape, np.uint64)
    in_row_blocks(lambda a, b: _census(a, b, grey, f4(alike), out), grey.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _row_forth(words, greys, first, word, grey, top, terms, given, weight, c, front):
    """Costs `c` of a row, and their running sums `front` from the left; flat."""
    cap, step, pull, limit = terms
    for x in range(weight.size):
        d = given[x]
        most = limit if d == d else f4(0)
        costs(words, greys, x - top + first, word[x], grey[x], step, cap, f4(top) - d, pull, most, c, x * CHUNK)
        forth(c, x * CHUNK, weight[x], front, x * CHUNK, (x + 1) * CHUNK)


@njit(cache=True, nogil=True, error_model="numpy")
def _rows_back(weight, inverse, c, front, ahead, out, weight2, inverse2, c2, front2, out2):
    """Each pixel's mean cost over its row, each other pixel weighed by the product of the weights on the way; two rows at a time, since
    one alone waits for itself at every pixel."""
    ahead[:] = f4(0)
    for x in range(weight.size - 1, -1, -1):
        back(c, x * CHUNK, weight[x], inverse[x], front, (x + 1) * CHUNK, ahead, 0, out, x * CHUNK)
        back(c2, x * CHUNK, weight2[x], inverse2[x], front2, (x + 1) * CHUNK, ahead, CHUNK, out2, x * CHUNK)


@njit(cache=True, nogil=True, error_model="numpy")
def _scaled(row, scale, out):
    for x in range(row.size):
        out[x] = scale * row[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _rows(first, end, word, grey, other_word, other_grey, scale, top, terms, given, weight, inverse, cost):
    """Costs of the disparities top, top - 1, ...: cost[y, x, k] is of top - k, which lies at column x - top + k of the other eye."""
    W = grey.shape[1]
    before = max(0, top)  # columns that are looked up before the frame, and after it
    after = max(0, CHUNK - 1 - top)
    words, greys, own = np.empty(before + W + after, np.uint64), np.empty(before + W + after, np.float32), np.empty(W, np.float32)
    c, front, ahead = np.empty((2, W * CHUNK), np.float32), np.empty((2, (W + 1) * CHUNK), np.float32), np.empty(2 * CHUNK, np.float32)
    front[:, :CHUNK] = f4(0)
    for y in range(first, end, 2):
        z = min(y + 1, end - 1)
        for i, row in enumerate((y, z)):
            words[:before], words[before : before + W], words[before + W :] = other_word[row, 0], other_word[row], other_word[row, W - 1]
            _scaled(grey[row], scale, own)
            _scaled(other_grey[row], scale, greys[before : before + W])
            greys[:before], greys[before + W :] = greys[before], greys[before + W - 1]
            _row_forth(words, greys, before, word[row], own, top, terms, given[row], weight[row], c[i], front[i])
        out, out2 = cost[y].reshape(W * CHUNK), cost[z].reshape(W * CHUNK)
        _rows_back(weight[y], inverse[y], c[0], front[0], ahead, out, weight[z], inverse[z], c[1], front[1], out2)


@njit(cache=True, nogil=True, error_model="numpy")
def _columns(begin, end, turn, weight, inverse, cost, top, index, keep, best, below, above, last, right):
    """The same along columns, and what they say: `best` and `right` are costs with the disparity's index in their lowest bits; `below` and
    `above` the costs of one disparity less and more.

    begin, end : of blocks of `CHUNK` columns, every other one, `turn` the first; what a block says of the other eye's columns reaches
                 into the block beside it, and no further.
    """
    H, W = cost.shape[:2]
    flat, front = cost.reshape(H * W * CHUNK), np.empty((H + 1) * CHUNK * CHUNK, np.float32)
    front[: CHUNK * CHUNK] = f4(0)
    ahead, c = np.empty(CHUNK * CHUNK, np.float32), np.empty(CHUNK, np.float32)
    # Row i is what the block's column i says of the other eye, laid over the columns that it says it of.
    said, least_said = np.full(CHUNK * 2 * CHUNK, FAR, np.int32), np.empty(2 * CHUNK, np.int32)
    for block in range(2 * begin + turn, 2 * end + turn, 2):
        first = block * CHUNK
        columns = min(CHUNK, W - first)
        part = slice(first, first + columns)
        for y in range(H):
            share, start, at = weight[y, part], (y * W + first) * CHUNK, y * CHUNK * CHUNK
            for i in range(columns):
                forth_whole(flat, start + i * CHUNK, share[i], front, at + i * CHUNK, at + (CHUNK + i) * CHUNK)
        ahead[:] = f4(0)
        for y in range(H - 1, -1, -1):
            share, worth, start, at = weight[y, part], inverse[y, part], (y * W + first) * CHUNK, (y + 1) * CHUNK * CHUNK
            mine, less, more, before = best[y, part], below[y, part], above[y, part], last[y, part]
            for i in range(columns):
                back_whole(flat, start + i * CHUNK, share[i], worth[i], front, at + i * CHUNK, ahead, i * CHUNK, c, 0)
                lowest = least(c, 0, keep, i4(index), said, i * (2 * CHUNK + 1))
                if mine[i] & ~keep == index - 1:  # the best of all so far was the last of the chunk before
                    less[i] = c[0]
                if lowest < mine[i]:
                    mine[i] = lowest
                    k = (lowest & ~keep) - index
                    more[i] = c[k - 1] if k > 0 else before[i]
                    less[i] = c[k + 1] if k < CHUNK - 1 else f4(np.inf)
                before[i] = c[CHUNK - 1]
            least_said[:] = FAR
            for i in range(columns):
                take_less(said, i * 2 * CHUNK, least_said, 0)
                take_less(said, i * 2 * CHUNK + CHUNK, least_said, CHUNK)
            u = first - top
            if u >= 0 and u + 2 * CHUNK <= W:
                take_less(least_said, 0, right[y], u)
                take_less(least_said, CHUNK, right[y], u + CHUNK)
            else:
                for k in range(max(0, -u), min(2 * CHUNK, W - u)):
                    right[y, u + k] = min(right[y, u + k], least_said[k])


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
def _apart(a, b, out):
    """The difference of the channel that differs most."""
    for x in range(out.size):
        d = max(abs(i4(a[x, 0]) - i4(b[x, 0])), abs(i4(a[x, 1]) - i4(b[x, 1])))
        out[x] = max(d, abs(i4(a[x, 2]) - i4(b[x, 2])))


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(first, end, picture, share, across, down):
    W = picture.shape[1]
    apart = np.zeros(W, np.int32)
    for y in range(first, end):
        _apart(picture[y, 1:], picture[y], apart[1:])
        apart[0] = 0
        for x in range(W):
            across[y, x] = share[apart[x]]
        _apart(picture[y], picture[max(y - 1, 0)], apart)
        for x in range(W):
            down[y, x] = share[apart[x]]


@njit(cache=True, nogil=True, error_model="numpy")
def _worth_across(first, end, weight, out):
    """One over the sum of the weights that a pixel's row has for it."""
    W = weight.shape[1]
    for y in range(first, end):
        n = f4(0)
        for x in range(W):
            n = f4(1) + weight[y, x] * n
            out[y, x] = n
        m = f4(0)
        for x in range(W - 1, -1, -1):
            out[y, x] = f4(1) / (out[y, x] + m)
            m = weight[y, x] * (m + f4(1))


@njit(cache=True, nogil=True, error_model="numpy")
def _worth_down(first, end, weight, out):
    """The same of its column, for the columns `first` to `end`."""
    H = weight.shape[0]
    n, m = np.zeros(end - first, np.float32), np.zeros(end - first, np.float32)
    for y in range(H):
        for x in range(first, end):
            n[x - first] = f4(1) + weight[y, x] * n[x - first]
            out[y, x] = n[x - first]
    for y in range(H - 1, -1, -1):
        for x in range(first, end):
            out[y, x] = f4(1) / (out[y, x] + m[x - first])
            m[x - first] = weight[y, x] * (m[x - first] + f4(1))


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
    across, down, across_worth, down_worth = (np.empty((H, W), np.float32) for _ in range(4))
    share = np.exp(-np.arange(256, dtype=np.float32) / f4(tones) - 1 / f4(reach_px))
    in_row_blocks(lambda a, b: _alike(a, b, left, share, across, down), H)
    in_row_blocks(lambda a, b: _worth_across(a, b, across, across_worth), H)
    in_row_blocks(lambda a, b: _worth_down(a, b, down, down_worth), W, block_rows=4 * CHUNK)
    given = np.full((H, W), np.nan, np.float32) if given is None else given
    chunks = -(-count // CHUNK)
    keep = i4(-(1 << int(chunks * CHUNK).bit_length()))
    cost = np.empty((H, W, CHUNK), np.uint16)
    scale = MOST / (CENSUS_STEPS * step + cap_levels + limit)  # of costs: as fine as whole numbers allow
    terms = tuple(f4(scale * a) for a in (cap_levels, step, pull, limit))
    best, other = np.full((H, W), FAR, np.int32), np.full((H, W), FAR, np.int32)
    below, above, last = (np.full((H, W), np.inf, np.float32) for _ in range(3))
    highest, blocks = low + count - 1, -(-W // CHUNK)
    for index in range(0, chunks * CHUNK, CHUNK):
        top = highest - index
        of_row = (words, left_grey, other_words, right_grey, f4(scale), top, terms, given, across, across_worth, cost)
        in_row_blocks(partial(_spread, _rows, of_row), H)
        for turn in (0, 1):
            of_column = (turn, down, down_worth, cost, top, index, keep, best, below, above, last, other)
            in_row_blocks(partial(_spread, _columns, of_column), (blocks + 1 - turn) // 2, block_rows=3)
    answer, answer_right = np.empty((H, W), np.float32), np.empty((H, W), np.float32)
    in_row_blocks(lambda a, b: _answers(a, b, best, below, above, other, keep, highest, answer, answer_right), H)
    return answer, answer_right


def _spread(kernel: Any, given: tuple[Any, ...], first: int, end: int) -> None:
    kernel(first, end, *given)
