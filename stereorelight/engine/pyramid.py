"""Half the size and back: maps of disparity, weights and surfaces on grids each half the size of the one before.

In, out: (H, W) float32; at half size (H / 2, W / 2) rounded up.  Rows are shared out in fixed blocks: the same bits come whatever the
number of threads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.rows import in_pieces

f4 = np.float32
SMALL = 60_000  # pixels of a picture that is not worth sharing out to threads: a pass over it takes a tenth of a millisecond
ROWS = 40  # rows of a block


def block_rows(shape: tuple[int, int]) -> int:
    """Rows of a block of a map of this size: all of them where it is not worth sharing out."""
    return ROWS if shape[0] * shape[1] > SMALL else shape[0]


def in_blocks(run: Callable[[int, int], None], like: Float32) -> None:
    """Call `run(first, end)` for every block of the rows of `like`."""
    if like.size <= SMALL:
        run(0, like.shape[0])
    else:
        in_pieces(run, like.shape[0], block_rows=ROWS)


@njit(cache=True, nogil=True, error_model="numpy")
def _halve_row(a, b, times, lean, out):
    W = a.size
    for x in range(W // 2):
        out[x] = times * (a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1])
    if W % 2:
        end, inner = a[W - 1] + b[W - 1], a[max(W - 2, 0)] + b[max(W - 2, 0)]
        out[W // 2] = times * (f4(2) * end + lean * (end - inner))


@njit(cache=True, nogil=True, error_model="numpy")
def halve(begin, end, a, times, lean, out):
    """Rows of `halved`."""
    H, W = a.shape
    beyond = np.empty(W, np.float32)
    for y in range(begin, end):
        if 2 * y + 1 < H:
            _halve_row(a[2 * y], a[2 * y + 1], times, lean, out[y])
        else:
            for x in range(W):
                beyond[x] = a[H - 1, x] + lean * (a[H - 1, x] - a[max(H - 2, 0), x])
            _halve_row(a[H - 1], beyond, times, lean, out[y])


def halved(a: Float32, *, times: float = 0.25, surface: bool = False) -> Float32:
    """(H, W) at half the size, rounded up: the four pixels' sum times `times`.

    surface : an odd last row or column goes on as it leans; else it counts twice.
    """
    out = np.empty(((a.shape[0] + 1) // 2, (a.shape[1] + 1) // 2), np.float32)
    in_blocks(lambda begin, end: halve(begin, end, a, f4(times), f4(surface), out), out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _double_row(near, far, own, other, lean, out):
    """A row between two coarse rows, `own` of the nearer and `other` of the farther; beyond the ends as the row leans."""
    W, n = near.size, out.size
    for x in range(W):
        me = own * near[x] + other * far[x]
        inner = own * near[min(1, W - 1)] + other * far[min(1, W - 1)]
        left = own * near[x - 1] + other * far[x - 1] if x > 0 else me + lean * (me - inner)
        out[2 * x] = f4(0.75) * me + f4(0.25) * left
        if 2 * x + 1 < n:
            inner = own * near[max(W - 2, 0)] + other * far[max(W - 2, 0)]
            right = own * near[x + 1] + other * far[x + 1] if x < W - 1 else me + lean * (me - inner)
            out[2 * x + 1] = f4(0.75) * me + f4(0.25) * right


@njit(cache=True, nogil=True, error_model="numpy")
def _doubled_row(a, y, lean, out):
    """Row y of a map of twice the size."""
    h = a.shape[0]
    near = y // 2
    far = near + 1 if y % 2 else near - 1
    if 0 <= far < h:
        _double_row(a[near], a[far], f4(0.75), f4(0.25), lean, out)
    else:  # beyond the ends: 1.25 of the last row less 0.25 of the one before it
        inner = min(max(2 * near - far, 0), h - 1)
        _double_row(a[near], a[inner], f4(1) + f4(0.25) * lean, f4(-0.25) * lean, lean, out)


@njit(cache=True, nogil=True, error_model="numpy")
def double(begin, end, a, lean, out):
    """Rows of `doubled`."""
    for y in range(begin, end):
        _doubled_row(a, y, lean, out[y])


def doubled(a: Float32, shape: tuple[int, int], *, surface: bool = False) -> Float32:
    """The inverse of `halved`, linear between the cells' centres; beyond the outer ones constant, or a `surface` as it leans."""
    out = np.empty(shape, np.float32)
    in_blocks(lambda begin, end: double(begin, end, a, f4(surface), out), out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _ends(d, y, x):
    """The least and the most of the four pixels of a coarse cell."""
    bottom, right = min(2 * y + 1, d.shape[0] - 1), min(2 * x + 1, d.shape[1] - 1)
    a, b, c, e = d[2 * y, 2 * x], d[2 * y, right], d[bottom, 2 * x], d[bottom, right]
    return min(min(a, b), min(c, e)), max(max(a, b), max(c, e))


@njit(cache=True, nogil=True, error_model="numpy")
def _of_its_ground(correction, d, y, x, step, otherwise):
    """The correction at pixel (y, x) from those of the four coarse cells about it that hold its ground alone, where another holds
    something nearer by `step` px or more; `otherwise` where none does, none is its ground's, or it stands before something itself."""
    h, w = correction.shape
    here, hidden, total, share = d[y, x], False, f4(0), f4(0)
    i, j = y // 2, x // 2
    for cy, down in ((i, f4(3)), (i + 1 if y % 2 else i - 1, f4(1))):
        for cx, across in ((j, f4(3)), (j + 1 if x % 2 else j - 1, f4(1))):
            if not (0 <= cy < h and 0 <= cx < w):
                continue
            least, most = _ends(d, cy, cx)
            if least <= here - step:
                return otherwise
            if most >= here + step:
                hidden = True
            else:
                total += down * across * correction[cy, cx]
                share += down * across
    return total / share if hidden and share > f4(0) else otherwise


@njit(cache=True, nogil=True, error_model="numpy")
def _start_row(surface, correction, coarse, d, y, apart, step, out):
    for x in range(out.size):
        smooth = surface[x] - d[y, x]
        out[x] = smooth if abs(smooth - correction[x]) < apart else _of_its_ground(coarse, d, y, x, step, correction[x])


@njit(cache=True, nogil=True, error_model="numpy")
def carry(begin, end, surface, correction, d, apart, step, out):
    """Where to start on a finer grid: the coarse `surface` itself where it is this pixel's surface, else its `correction`.

    Ground beside what is nearer by `step` px or more takes its own ground's: what pulls at the near thing would bend it.  The near thing
    takes the mean of all: surfaces fall away towards their outlines, and it is nearer there than the plate would have it.  So does what is
    both, an ear between cheek and wall.
    """
    smooth, moved = np.empty(d.shape[1], np.float32), np.empty(d.shape[1], np.float32)
    for y in range(begin, end):
        _doubled_row(surface, y, f4(1), smooth)
        _doubled_row(correction, y, f4(0), moved)
        _start_row(smooth, moved, correction, d, y, apart, step, out[y])
