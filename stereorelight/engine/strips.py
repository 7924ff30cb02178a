"""Votes of half-hidden strips: which of the two surfaces beside a strip it looks like.

In: a picture and its disparity, NaN where the eyes do not confirm each other.  Out: two counts.  Pixels; disparity is x_left - x_right.

Where disparity jumps up along a row of the left eye, a strip as wide as the jump is seen by that eye alone, and it belongs to what lies
BEHIND.  Where the strip lies says nothing of which eye is which: with the eyes exchanged all disparities change their signs, and strips still
lie where disparity jumps up.  What they look like does: the side of the smaller disparity, or, with the eyes exchanged, that of the larger."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.rows import in_pieces

LEAST_PX = 3  # of a strip, and of the jump beside it
NARROWEST, WIDEST = 0.6, 1.5  # times the jump, with a pixel or two for what matching misses
BESIDE_PX = 4  # on either side, whose median disparity is the surface's
SAME_PX = 1.5  # from that median: the same surface
ALIKE_TIMES, ALIKE_LEVELS = 2.0, 2.0  # a strip is like one side where it is farther from the other by so many times, and grey levels a channel


@njit(cache=True, nogil=True, error_model="numpy")
def _middle(row, first, end, kept):
    """Median of the numbers of row[first:end], NaN where there are none."""
    n = 0
    for x in range(first, end):
        d = row[x]
        if d == d:
            i = n
            while i > 0 and kept[i - 1] > d:
                kept[i] = kept[i - 1]
                i -= 1
            kept[i] = d
            n += 1
    return np.nan if n == 0 else 0.5 * (kept[(n - 1) // 2] + kept[n // 2])


@njit(cache=True, nogil=True, error_model="numpy")
def _same_surface(row, first, end, middle):
    """Share of row[first:end] that lies on the surface at `middle`."""
    n = 0
    for x in range(first, end):
        n += abs(row[x] - middle) < SAME_PX
    return n / (end - first)


@njit(cache=True, nogil=True, error_model="numpy")
def _colour(row, first, end, channel):
    """Mean and standard deviation of a channel of row[first:end]."""
    total = squares = 0.0
    for x in range(first, end):
        level = float(row[x, channel])
        total += level
        squares += level * level
    mean = total / (end - first)
    return mean, np.sqrt(max(squares / (end - first) - mean * mean, 0.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _votes(first_row, end_row, picture, disparity, known, settled, doubt, behind, before):
    W, channels = picture.shape[1], picture.shape[2]
    kept = np.empty(BESIDE_PX)
    for y in range(first_row, end_row):
        row, colours = disparity[y], picture[y]
        last = -1  # confirmed pixel before the strip
        for end in range(W):
            if row[end] != row[end]:
                continue
            first, n = last + 1, end - last - 1
            has_sides = last >= n + 1 and end <= W - n - 2
            last = end
            if n < LEAST_PX or not has_sides:
                continue
            low = _middle(row, max(first - BESIDE_PX, 0), first, kept)
            high = _middle(row, end, min(end + BESIDE_PX, W), kept)
            step = high - low
            if step < LEAST_PX or n < NARROWEST * step - 1 or n > WIDEST * step + 2 or not known[y, first - n : end + n].all():
                continue
            if _same_surface(row, first - n, first, low) < settled or _same_surface(row, end, end + n, high) < settled:
                continue
            to_low = to_high = spread = 0.0
            for c in range(channels):
                inside, a = _colour(colours, first + 1, end - 1, c)
                of_low, b = _colour(colours, first - n, first, c)
                of_high, e = _colour(colours, end, end + n, c)
                to_low += abs(inside - of_low)
                to_high += abs(inside - of_high)
                spread += (a + b + e) / 2
            least = ALIKE_LEVELS * channels + doubt * spread / np.sqrt(n)
            if max(to_low, to_high) >= ALIKE_TIMES * min(to_low, to_high) + least:
                behind[y] += to_low < to_high
                before[y] += to_high < to_low


def strip_votes(picture: UInt8, disparity: Float32, known: Bool, *, settled: float = 0.0, doubt: float = 0.0) -> tuple[int, int]:
    """Strips that look like the side which matching puts behind, and like the one which it puts in front.

    picture, known : (H, W, C) of the left eye, slightly smoothed, and where it is known.
    disparity      : (H, W) px on it, NaN where the eyes do not confirm each other.
    settled        : share of as many pixels as the strip has, on either side, that must lie on one surface.
    doubt          : how many standard errors of the mean colours a strip must be nearer to one side by.
    """
    behind, before = (np.zeros(disparity.shape[0], np.int64) for _ in range(2))
    in_pieces(lambda first, end: _votes(first, end, picture, disparity, known, settled, doubt, behind, before), disparity.shape[0])
    return int(behind.sum()), int(before.sum())
