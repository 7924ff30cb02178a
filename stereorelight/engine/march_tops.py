"""The nearest things about each place of a depth, by which the march passes over many looks at once.

In: inverse depth (h, w), 1 / metres.  Out: for each cell of 8 x 8 pixels the most inverse depth within so many cells of it."""

from __future__ import annotations

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.rows import in_row_blocks

CELL_BITS = 3  # 8 pixels a side
WIDTHS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # cells to each side that a level looks at
NEARER_THAN_ALL = f4(1e30)


@kernel()
def _cells(first, end, inverse, top):
    """Rows first..end of cells: the most of each; where nobody knows, nothing may be passed over.  The grid has a border of one."""
    for row in range(first, end):
        for y in range(max((row << CELL_BITS) - 1, 0), min(((row + 1) << CELL_BITS) - 1, inverse.shape[0])):
            for x in range(inverse.shape[1]):
                seen = inverse[y, x] if inverse[y, x] >= f4(0) else NEARER_THAN_ALL
                cell = (x + 1) >> CELL_BITS
                top[row, cell] = seen if seen > top[row, cell] else top[row, cell]


def _widened(top: Float32, by: int) -> Float32:
    """The most within `by` cells along rows and columns."""
    for axis in (0, 1):
        line = np.moveaxis(top, axis, 0)
        most = line.copy()
        for shift in range(1, min(by, len(line) - 1) + 1):
            np.maximum(most[shift:], line[:-shift], out=most[shift:])
            np.maximum(most[:-shift], line[shift:], out=most[:-shift])
        top = np.moveaxis(most, 0, axis)
    return top


def tops_of(inverse: Float32) -> tuple[Float32, int]:
    """(levels, cells) float32, flat, one level for each of `WIDTHS`; and how many cells a row has.

    inverse : (h, w); negative where nobody knows.  The cells are those of the grid with a border of one pixel, which no ray looks at."""
    height, width = ((side + 2 + (1 << CELL_BITS) - 1) >> CELL_BITS for side in inverse.shape)
    top = np.zeros((height, width), np.float32)
    in_row_blocks(lambda first, end: _cells(first, end, inverse, top), height)
    levels = []
    done = 0
    for wanted in WIDTHS:
        top = _widened(top, wanted - done)
        done = wanted
        levels.append(top.reshape(-1))
    return np.stack(levels), width
