"""Matching by adaptive support: what each disparity costs a pixel, averaged over those neighbours that look like it.

In: two rectified pictures, rows agreeing, and a range of whole-pixel disparities.  Out: the best disparity of either eye, (H, W) float32.
The cost is a census transform of three answers (brighter, alike, darker; after Zabih and Woodfill 1994) with a truncated difference of
grey.  It is averaged by a recursive filter whose weights fall with every step of colour on the way (after Gastal and Oliveira 2011, Pham
and Jeon 2013), so a window of cost takes the shape of the thing that it lies on: gaps between slats stay gaps.
The costs of `CHUNK` disparities are held at a time, two bytes each, whatever the range.  Sums have a fixed order: the same bits whatever the
threads."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, UInt8
from stereorelight.engine.census import CENSUS_STEPS, census_rows
from stereorelight.engine.fastmath import float_of
from stereorelight.engine.rows import BLOCK_ROWS
from stereorelight.engine.support_vector import (
    LANES,
    back,
    back_whole,
    costs,
    fetch,
    first_bit,
    forth,
    forth_whole,
    having,
    least,
    least_of_rows,
    lesser,
    take_less,
)
from stereorelight.engine.turns import shared, together, turns_of

f4 = np.float32
i4 = np.int32
CHUNK = LANES  # disparities held at a time
PART = CHUNK * CHUNK  # costs of a row of a block of `CHUNK` columns
PLACE = 32  # costs that the processor fetches at a time
SEGMENT = 16  # rows of which all sums from above are at hand
FAR = np.int32(0x7F000000)  # above every cost
MOST = 65_000.0  # the largest cost between rows and columns, where costs are whole numbers of 16 bits: half the memory to fetch


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
def _rows_back(weight, inverse, c, front, ahead, out, place, weight2, inverse2, c2, front2, place2, column):
    """Each pixel's mean cost over its row, each other pixel weighed by the product of the weights on the way; two rows at a time, since
    one alone waits for itself at every pixel.

    place, place2 : of a row in the first block of `out`; column : from one block to the next.
    """
    ahead[:] = f4(0)
    W = weight.size
    for block in range((W - 1) // CHUNK, -1, -1):
        o = block * (column - PART)
        if block > 0:  # each block lies in a page of its own
            for k in range(0, PART, PLACE):
                fetch(out, place + (block - 1) * column + k)
                fetch(out, place2 + (block - 1) * column + k)
        for x in range(min(block * CHUNK + CHUNK, W) - 1, block * CHUNK - 1, -1):
            back(c, x * CHUNK, weight[x], inverse[x], front, (x + 1) * CHUNK, ahead, 0, out, place + o + x * CHUNK)
            back(c2, x * CHUNK, weight2[x], inverse2[x], front2, (x + 1) * CHUNK, ahead, CHUNK, out, place2 + o + x * CHUNK)


@njit(cache=True, nogil=True, error_model="numpy")
def _scaled(row, scale, out):
    for x in range(row.size):
        out[x] = scale * row[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _rows(first, end, word, grey, other_word, other_grey, scale, top, terms, given, weight, inverse, cost):
    """Costs of the disparities top, top - 1, ...: cost[b, y, i, k] is of top - k at column x = 16 b + i, which lies at column x - top + k
    of the other eye."""
    W, flat = grey.shape[1], cost.reshape(cost.size)
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
        place, place2 = y * PART, z * PART
        _rows_back(weight[y], inverse[y], c[0], front[0], ahead, flat, place, weight[z], inverse[z], c[1], front[1], place2, grey.shape[0] * PART)


@njit(cache=True, nogil=True, error_model="numpy")
def _columns(begin, end, turn, width, weight, inverse, cost, index, keep, best, below, above, last, right):
    """The same along columns, and what they say: `best` and `right` are costs with the disparity's index in their lowest bits; `below` and
    `above` the costs of one disparity less and more.

    begin, end : of blocks of `CHUNK` columns, every other one, `turn` the first; what a block says of the other eye's columns reaches
                 into the block after it, and no further.   width : of the picture.
    The sums from above are kept every `SEGMENT` rows, and made again from there a segment at a time: all that is looked at twice stays near.
    """
    H = cost.shape[1]
    flat, shares, worths = cost.reshape(cost.size), weight.reshape(weight.size), inverse.reshape(weight.size)
    bests, less, more, before = best.reshape(best.size), below.reshape(best.size), above.reshape(best.size), last.reshape(best.size)
    others = right.reshape(right.size)
    segments = -(-H // SEGMENT)
    marks, front = np.empty((segments + 2) * PART, np.float32), np.empty((SEGMENT + 1) * PART, np.float32)
    ahead, c, lowest = np.empty(PART, np.float32), np.empty(PART, np.float32), np.full(CHUNK, FAR, np.int32)
    # Row i is what the block's column i says of the other eye, laid over the columns that it says it of.
    said, least_said = np.full(CHUNK * 2 * CHUNK, FAR, np.int32), np.empty(2 * CHUNK, np.int32)
    for block in range(2 * begin + turn, 2 * end + turn, 2):
        columns = min(CHUNK, width - block * CHUNK)
        if columns < CHUNK:
            lowest[:], said[:] = FAR, FAR
        start = block * H
        marks[:PART] = f4(0)
        j = 0
        for y in range((segments - 1) * SEGMENT):
            p = (start + y) * CHUNK
            k = ((y + 1) // SEGMENT if (y + 1) % SEGMENT == 0 else segments + y % 2) * PART
            for i in range(columns):
                forth_whole(flat, (p + i) * CHUNK, shares[p + i], marks, j + i * CHUNK, k + i * CHUNK)
            j = k
        ahead[:] = f4(0)
        for segment in range(segments - 1, -1, -1):
            high, low = segment * SEGMENT, min(segment * SEGMENT + SEGMENT, H)
            front[:PART] = marks[segment * PART : segment * PART + PART]
            for y in range(high, low):
                p, at = (start + y) * CHUNK, (y - high) * PART
                for i in range(columns):
                    forth_whole(flat, (p + i) * CHUNK, shares[p + i], front, at + i * CHUNK, at + PART + i * CHUNK)
            for y in range(low - 1, high - 1, -1):
                p, at = (start + y) * CHUNK, (y - high + 1) * PART
                for i in range(columns):
                    back_whole(flat, (p + i) * CHUNK, shares[p + i], worths[p + i], front, at + i * CHUNK, ahead, i * CHUNK, c, i * CHUNK)
                    lowest[i] = least(c, i * CHUNK, keep, i4(index), said, i * (2 * CHUNK + 1))
                bits = having(bests, p, ~keep, i4(index - 1))  # the best of all so far was the last of the chunk before
                while bits:
                    i = first_bit(bits)
                    bits &= bits - 1
                    less[p + i] = c[i * CHUNK]
                bits = lesser(lowest, 0, bests, p)
                take_less(lowest, 0, bests, p)
                while bits:
                    i = first_bit(bits)
                    bits &= bits - 1
                    k = (lowest[i] & ~keep) - index
                    more[p + i] = c[i * CHUNK + k - 1] if k > 0 else before[p + i]
                    less[p + i] = c[i * CHUNK + k + 1] if k < CHUNK - 1 else f4(np.inf)
                for i in range(CHUNK):
                    before[p + i] = c[i * CHUNK + CHUNK - 1]
                least_of_rows(said, least_said)
                p += index * H
                take_less(least_said, 0, others, p)
                take_less(least_said, CHUNK, others, p + H * CHUNK)


@njit(cache=True, nogil=True, error_model="numpy")
def _answers(first, end, best, below, above, right, keep, highest, left_out, right_out):
    W = left_out.shape[1]
    for block in range(best.shape[0]):
        for y in range(first, end):
            for i in range(min(CHUNK, W - block * CHUNK)):
                key, low, high = best[block, y, i], below[block, y, i], above[block, y, i]
                m = f4(0)
                curve = low - f4(2) * float_of(np.int32(key & keep)) + high
                if curve > f4(0) and low < f4(np.inf) and high < f4(np.inf):
                    m = min(max(f4(0.5) * (low - high) / curve, f4(-0.5)), f4(0.5))
                left_out[y, block * CHUNK + i] = f4(highest - (key & ~keep)) + m
    right_out[first:end] = np.nan
    for block in range(right.shape[0]):
        start = block * CHUNK - highest  # the other eye's columns are kept from there on
        for y in range(first, end):
            for i in range(max(0, -start), min(CHUNK, W - start)):
                key = right[block, y, i]
                if key < FAR:
                    right_out[y, start + i] = f4(highest - (key & ~keep))


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
        for block in range(down.shape[0]):
            for i in range(min(CHUNK, W - block * CHUNK)):
                down[block, y, i] = share[apart[block * CHUNK + i]]


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
    """The same of its column, for the blocks `first` to `end`."""
    H = weight.shape[1]
    n, m = np.empty(CHUNK, np.float32), np.empty(CHUNK, np.float32)
    for b in range(first, end):
        n[:], m[:] = f4(0), f4(0)
        for y in range(H):
            for i in range(CHUNK):
                n[i] = f4(1) + weight[b, y, i] * n[i]
                out[b, y, i] = n[i]
        for y in range(H - 1, -1, -1):
            for i in range(CHUNK):
                out[b, y, i] = f4(1) / (out[b, y, i] + m[i])
                m[i] = weight[b, y, i] * (m[i] + f4(1))


@njit(cache=True, nogil=True, error_model="numpy")
def _started(first, end, best, below, above, last, other):
    """Nothing is known yet; `other` has more blocks than the rest."""
    for b in range(first, end):
        other[b] = FAR
        if b < best.shape[0]:
            best[b] = FAR
            below[b], above[b], last[b] = f4(np.inf), f4(np.inf), f4(np.inf)


@njit(cache=True, nogil=True, error_model="numpy")
def _support(turns, seen, found, highest, chunks, keep, alike, share, scale, terms):
    """`supported`, by all threads together."""
    left, left_grey, right_grey, words, other_words, given, across, across_worth, down, down_worth = seen
    cost, best, below, above, last, other, answer, answer_right = found
    H, W = left_grey.shape
    blocks = best.shape[0]
    step = np.int64(0)
    for first, end in shared(turns, step, H, BLOCK_ROWS):
        census_rows(first, end, left_grey, alike, words)
        census_rows(first, end, right_grey, alike, other_words)
        _alike(first, end, left, share, across, down)
        _worth_across(first, end, across, across_worth)
    step += 1
    for first, end in shared(turns, step, blocks + chunks, 1):
        _worth_down(first, min(end, blocks), down, down_worth)
        _started(first, end, best, below, above, last, other)
    step += 1
    for chunk in range(chunks):
        index = chunk * CHUNK
        for first, end in shared(turns, step, H, BLOCK_ROWS):
            _rows(first, end, words, left_grey, other_words, right_grey, scale, highest - index, terms, given, across, across_worth, cost)
        step += 1
        for turn in range(2):
            for first, end in shared(turns, step, (blocks + 1 - turn) // 2, 1):
                _columns(first, end, turn, W, down, down_worth, cost, index, keep, best, below, above, last, other)
            step += 1
    for first, end in shared(turns, step, H, BLOCK_ROWS):
        _answers(first, end, best, below, above, other, keep, highest, answer, answer_right)


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
    blocks, chunks = -(-W // CHUNK), -(-count // CHUNK)
    block = (blocks, H, CHUNK)  # where columns are gone along, 16 of them lie together: a column is read from end to end
    words, other_words = (np.empty((H, W), np.uint64) for _ in range(2))
    across, across_worth, down, down_worth = (np.zeros(shape, np.float32) for shape in ((H, W), (H, W), block, block))
    share = np.exp(-np.arange(256, dtype=np.float32) / f4(tones) - 1 / f4(reach_px))
    given = np.full((H, W), np.nan, np.float32) if given is None else given
    keep = i4(-(1 << int(chunks * CHUNK).bit_length()))  # all bits but those that hold a disparity's index
    scale = MOST / (CENSUS_STEPS * step + cap_levels + limit)  # of costs: as fine as whole numbers allow
    terms = tuple(f4(scale * a) for a in (cap_levels, step, pull, limit))
    best, other = np.empty(block, np.int32), np.empty((blocks + chunks, H, CHUNK), np.int32)
    below, above, last = (np.empty(block, np.float32) for _ in range(3))
    answer, answer_right = np.empty((H, W), np.float32), np.empty((H, W), np.float32)
    seen = (left, left_grey, right_grey, words, other_words, given, across, across_worth, down, down_worth)
    found = (np.empty((*block, CHUNK), np.uint16), best, below, above, last, other, answer, answer_right)
    together(_support, turns_of(3 + 3 * chunks), seen, found, low + count - 1, chunks, keep, f4(alike), share, f4(scale), terms)
    return answer, answer_right
