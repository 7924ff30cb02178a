"""Shadow rays marched through a depth: for every pixel, the share of a light that reaches it, and the share that nobody can know.

In: the seen surface as a grid of inverse depth (1 / metres) of a pinhole camera, with one cell of border; P, N (H, W, 3) and two
offsets (H, W); a light as a row of numbers.  Out: lit and unknown, (H, W) float32, 0..1, written into the arrays given.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres.

A straight ray is straight in the picture, and its inverse depth is affine along it: a look is two additions, one look-up and a
comparison.  A ray ends where it meets the light, leaves the frame, or is nearer than anything seen.  It is stopped where it goes
through a surface that hangs together, or lies behind one by less than the thickness; farther behind, where no camera saw, its answer is
unknown.
Rays are set up in strips of a row and go in blocks of neighbours; each step is a leaf loop over separate rows, which the compiler turns
into vector code.  A block whose rays are all in front of everything about there passes over several looks at once, by the nearest cells of
`march_tops`; that changes no bit of the answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine import march_rays as leaf
from stereorelight.engine.fastmath import f4, i4, kernel, look_up
from stereorelight.engine.march_tops import CELL_BITS, WIDTHS, tops_of
from stereorelight.engine.rows import in_row_blocks

# A light's row, float32.
PLACE, IS_PLACE, SIDE_U, SIDE_V, AXIS = 0, 3, 4, 7, 10  # position or unit vector towards it; half its extent each way; its shining side
BALL, RECTANGLE, TURNED = 13, 14, 15  # radius, 0 for none; 1 for a rectangle; least cosine of N to the light that still gets an answer
COLUMNS = 16
STRIP = 256
BLOCK = 32  # rays that go together: fewer pass over more, more take fewer turns
CHUNK_PX = 32  # so far a block tries to go at once
LEAST_LOOKS, MOST_LOOKS = 4, 12  # and so many looks
ROUNDING = f4(1e-6)  # of inverse depth, for the ends of a way against the looks between them
# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever these do;
# tests/test_light_layers.py holds them together.
LEAVES = "b82021a1fc4c144b"  # march_rays.py
TOPS = "92031a7ea538403e"  # march_tops.py
OPEN, UNSEEN = 0.0, -1.0  # in the grid: nothing there however far; nobody knows


@kernel(noalias=True)
def _near_something(b, first, last, columns, top, u, v, k, du, dv, dk, above, lit):
    """How many of a block's rays may meet something from `first` to `last` of their way: those not nearer to the camera than all that is
    seen about there."""
    at = f4(0.5) * (first + last)
    many = f4(0)
    for j in range(BLOCK):
        i = b + np.uintp(j)
        seen = look_up(top, (i4(v[i] + dv[i] * at) >> i4(CELL_BITS)) * columns + (i4(u[i] + du[i] * at) >> i4(CELL_BITS)))
        one = k[i] + dk[i] * first
        two = k[i] + dk[i] * last
        low = one if one < two else two
        short = seen + ROUNDING * (k[i] + abs(dk[i])) - low
        short = short if short > above[i] else above[i]
        many += lit[i] if short >= f4(0) else f4(0)
    return many


@kernel(noalias=True)
def _look(b, at, columns, thick, grid, u, v, k, du, dv, dk, found, above, crossed, lit, hidden):
    """One look of a block's rays: stop those within the thickness of what is found, mark those that lie farther behind it, and those that
    changed sides.  Returns how many are left, and how many of them changed sides."""
    left = f4(0)
    many = f4(0)
    for j in range(BLOCK):
        i = b + np.uintp(j)
        seen = look_up(grid, i4(v[i] + dv[i] * at) * columns + i4(u[i] + du[i] * at))
        ray = k[i] + dk[i] * at
        behind = seen - ray
        after = behind > f4(0)
        hit = after & (behind < thick * seen * ray)
        unseen = (seen < f4(0)) | (after & (not hit))
        hidden[i] = f4(1) if unseen else hidden[i]
        still = f4(0) if hit else lit[i]
        cross = still if behind * above[i] < f4(0) else f4(0)
        above[i] = behind
        crossed[i] = cross
        lit[i] = still
        found[i] = seen
        left += still
        many += cross
    return left, many


@kernel(noalias=True)
def _look_deep(b, at, columns, backs, grid, u, v, k, du, dv, dk, found, above, crossed, lit, hidden):
    """`_look` where each cell has a back of its own, as inverse depth."""
    left = f4(0)
    many = f4(0)
    for j in range(BLOCK):
        i = b + np.uintp(j)
        here = i4(v[i] + dv[i] * at) * columns + i4(u[i] + du[i] * at)
        seen = look_up(grid, here)
        ray = k[i] + dk[i] * at
        behind = seen - ray
        after = behind > f4(0)
        hit = after & (ray > look_up(backs, here))
        unseen = (seen < f4(0)) | (after & (not hit))
        hidden[i] = f4(1) if unseen else hidden[i]
        still = f4(0) if hit else lit[i]
        cross = still if behind * above[i] < f4(0) else f4(0)
        above[i] = behind
        crossed[i] = cross
        lit[i] = still
        found[i] = seen
        left += still
        many += cross
    return left, many


@kernel(noalias=True)
def _through(b, at, step, columns, grid, reach, u, v, du, dv, pixels, found, crossed, lit):
    """Stop the rays that changed sides along a surface that hangs together: its depth changed no more than it does about there anyway.

    There are few: one by one.  Returns how many were stopped."""
    last = at - step
    stopped = f4(0)
    for j in range(BLOCK):
        i = b + np.uintp(j)
        if crossed[i] > f4(0):
            here = i4(v[i] + dv[i] * at) * columns + i4(u[i] + du[i] * at)
            there = i4(v[i] + dv[i] * last) * columns + i4(u[i] + du[i] * last)
            long = pixels[i] * step
            one = look_up(reach, here)
            two = look_up(reach, there)
            most = (one if one > two else two) * (long if long > f4(1) else f4(1))
            if abs(found[i] - look_up(grid, there)) < most:
                lit[i] = f4(0)
                stopped += f4(1)
    return stopped


@kernel(noalias=True)
def _start(b, du, dv, above, lit, hidden):
    """Returns the longest way of a block's rays in pixels, and how many there are."""
    longest = f4(0)
    left = f4(0)
    for j in range(BLOCK):
        i = b + np.uintp(j)
        above[i] = f4(-1)
        hidden[i] = f4(0)
        left += lit[i]
        one = abs(du[i])
        two = abs(dv[i])
        one = one if one > two else two
        longest = one if one > longest else longest
    return longest, left


@kernel(noalias=True)
def _passed(b, above):
    for j in range(BLOCK):
        above[b + np.uintp(j)] = f4(-1)


@kernel(noalias=True)
def _go(b, steps, grid, reach, columns, tops, wide, thick, backs, u, v, k, du, dv, dk, pixels, found, above, crossed, lit, hidden):
    """March the rays of one block to their ends."""
    longest, left = _start(b, du, dv, above, lit, hidden)
    count = min(steps, int(longest) + 1)
    step = f4(1) / f4(count)
    looks = min(max(int(f4(CHUNK_PX) / (step * longest + ROUNDING)), LEAST_LOOKS), MOST_LOOKS)
    half = f4(0.5) * f4(looks - 1) * step * longest + f4(0.01)  # pixels from the middle of a chunk to its ends
    level = 0
    while level < len(WIDTHS) and f4(WIDTHS[level] << CELL_BITS) < half:
        level += 1
    s = 1
    while s <= count and left > f4(0.5):
        end = min(s + looks - 1, count)
        if s > 1 and level < len(tops):  # the first looks are beside the surface that the rays start from
            top = tops[level]
            if _near_something(b, f4(s) * step, f4(end) * step, wide, top, u, v, k, du, dv, dk, above, lit) < f4(0.5):
                _passed(b, above)
                s = end + 1
                continue
        while s <= end and left > f4(0.5):
            at = f4(s) * step
            if len(backs) > 1:
                left, many = _look_deep(b, at, columns, backs, grid, u, v, k, du, dv, dk, found, above, crossed, lit, hidden)
            else:
                left, many = _look(b, at, columns, thick, grid, u, v, k, du, dv, dk, found, above, crossed, lit, hidden)
            if many > f4(0):
                left -= _through(b, at, step, columns, grid, reach, u, v, du, dv, pixels, found, crossed, lit)
            s += 1


@kernel()
def _rows(
    first, end, P, N, lift, half, asked, partly, grid, reach, columns, tops, wide, fx, fy, cx, cy, near, nearest, thick, backs, q, offsets,
    steps, lit, unknown,
):  # fmt: skip
    """Rows first..end; P, N are (H, 3 W); grid is flat with a border of one cell, `columns` wide; cx, cy hold the border and half a pixel."""
    W = N.shape[1] // 3
    T = np.empty((29, STRIP + 16), np.float32)
    px, py, pz, nx, ny, nz, sx, sy, sz, lx, ly, lz = T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9], T[10], T[11]
    far, weight, u, v, k, du, dv, dk, pixels, lost, hidden = T[12], T[13], T[14], T[15], T[16], T[17], T[18], T[19], T[20], T[21], T[22]
    found, going, above, crossed, oa, ob = T[23], T[24], T[25], T[26], T[27], T[28]
    M = np.empty((9, STRIP + 16), np.float32)
    mx, my, mz, ax, ay, az, bx, by, bz = M[0], M[1], M[2], M[3], M[4], M[5], M[6], M[7], M[8]
    sums = np.empty((3, STRIP + 16), np.float32)
    shone, doubt, total = sums[0], sums[1], sums[2]
    samples = offsets.shape[1]
    straight = samples == 1 and q[BALL] == f4(0) and q[RECTANGLE] == f4(0) and offsets[0, 0, 0] == f4(0)
    width = f4(columns - 1) - f4(0.001)
    height = f4(grid.shape[0] // columns - 1) - f4(0.001)
    for y in range(first, end):
        kind = (y & 3) * 4  # a strip begins at a multiple of four
        for x in range(0, W, STRIP):
            n = min(STRIP, W - x)
            leaf.split(n, P[y, 3 * x : 3 * (x + n)], N[y, 3 * x : 3 * (x + n)], lift[y, x : x + n], px, py, pz, nx, ny, nz)
            leaf.starts(n, fx, fy, cx, cy, width, height, px, py, pz, nx, ny, nz, lift[y, x : x + n], half[y, x : x + n], sx, sy, sz, u, v, k)
            leaf.idle(n, (n + BLOCK - 1) // BLOCK * BLOCK, u, v, k, du, dv, dk, going)
            if not straight:
                leaf.shown(n, q, sx, sy, sz, mx, my, mz, ax, ay, az, bx, by, bz)
            sums[:] = f4(0)
            for sample in range(samples):
                if straight:
                    leaf.straight(n, q, nx, ny, nz, sx, sy, sz, lx, ly, lz, far, weight)
                else:
                    for i in range(0, n, 4):
                        for j in range(4):
                            oa[i + j] = offsets[kind + j, sample, 0]
                            ob[i + j] = offsets[kind + j, sample, 1]
                    leaf.targets(n, oa, ob, q, nx, ny, nz, mx, my, mz, ax, ay, az, bx, by, bz, lx, ly, lz, far, weight)
                if partly:
                    wanted = asked[y, x : x + n]
                    for i in range(n):
                        weight[i] = weight[i] if wanted[i] > f4(0) else f4(0)
                leaf.rays(n, fx, fy, cx, cy, width, height, near, sx, sy, sz, lx, ly, lz, far, weight, u, v, du, dv, dk, pixels, lost, going)
                for place in range(0, n, BLOCK):
                    b = np.uintp(place)
                    _go(
                        b, steps, grid, reach, columns, tops, wide, thick, backs, u, v, k, du, dv, dk, pixels, found, above, crossed, going, hidden,
                    )  # fmt: skip
                leaf.gather(n, nearest, k, dk, lost, going, hidden, weight, shone, doubt, total)
            leaf.shares(n, shone, doubt, total, lit[y, x : x + n], unknown[y, x : x + n])


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """The seen surface as the march reads it; make it with `grid_of`.

    cells, reach : flat, with a border of one cell, `columns` wide.     pinhole : fx, fy, cx, cy of the camera that it is seen by.
    near    : metres, just nearer than the nearest cell.     nearest : inverse depth beyond which nothing is expected outside the frame.
    tops, wide : of `march_tops.tops_of`.     thickness_m : of all that is seen.     backs : or of each cell, the inverse depth of its back.
    """

    cells: Float32
    reach: Float32
    columns: int
    pinhole: tuple[float, float, float, float]
    near: float
    nearest: float
    tops: Float32
    wide: int
    thickness_m: float
    backs: Float32


def grid_of(
    inverse: Float32, reach: Float32, pinhole: tuple[float, float, float, float], *, nearest: float, thickness_m: float | Float32 = 0.0
) -> Grid:
    """inverse : (h, w) inverse depth, 1 / metres; OPEN where nothing is, UNSEEN where nobody knows.
    reach   : (h, w) 1 / metres, what inverse depth changes by to a cell's neighbours on the same surface, at most.
    thickness_m : how far things go on behind what is seen of them; a number or (h, w)."""

    def bordered(values: Float32, beyond: float) -> Float32:
        room = np.full((values.shape[0] + 2, values.shape[1] + 2), beyond, np.float32)
        room[1:-1, 1:-1] = values
        return room.reshape(-1)

    near = 0.999 / max(float(inverse.max()), 1e-9)
    tops, wide = tops_of(inverse)
    backs = np.zeros(1, np.float32)
    if isinstance(thickness_m, np.ndarray):
        thick, thickness_m = np.nan_to_num(thickness_m), 0.0
        backs = bordered(np.where(inverse > 0, inverse / (1 + np.maximum(inverse, 0) * thick), inverse).astype(np.float32), UNSEEN)
    return Grid(
        cells=bordered(inverse, UNSEEN), reach=bordered(reach, 0.0), columns=inverse.shape[1] + 2, pinhole=pinhole, near=near, nearest=nearest,
        tops=tops, wide=wide, thickness_m=thickness_m, backs=backs,
    )  # fmt: skip


def march(
    P: Float32,
    N: Float32,
    lift: Float32,
    half: Float32,
    asked: Float32 | None,
    grid: Grid,
    light: Float32,
    offsets: Float32,
    *,
    steps: int,
) -> tuple[Float32, Float32]:
    """(lit, unknown), (H, W) float32 in 0..1; both 0 where the surface turns its back on the light, is not known, or not asked for.

    P, N    : (H, W, 3).   lift : (H, W) metres along N that a ray starts off the surface; NaN for no ray.
    half    : (H, W) 1 / metres that its start is brought nearer to the camera by, for the steps between the grid's cells.
    asked   : (H, W), 0 where no answer is wanted; None for everywhere.
    light   : (COLUMNS,);  offsets : (16, samples, 2), where on the light each of the 4 x 4 kinds of pixel looks, in units of its sides.
    steps   : at most so many a ray; a ray of fewer pixels takes one a pixel.
    """
    height, width = N.shape[:2]
    lit, unknown = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    fx, fy, cx, cy = grid.pinhole
    numbers = (f4(fx), f4(fy), f4(cx + 1.5), f4(cy + 1.5), f4(grid.near), f4(grid.nearest), f4(grid.thickness_m), grid.backs)
    flat = [a.reshape(height, -1) for a in (P, N)]
    where = np.empty((1, 1), np.float32) if asked is None else asked

    def run(first: int, end: int) -> None:
        _rows(
            first, end, *flat, lift, half, where, asked is not None, grid.cells, grid.reach, i4(grid.columns), grid.tops, i4(grid.wide),
            *numbers, light, offsets, steps, lit, unknown,
        )  # fmt: skip

    in_row_blocks(run, height)
    return lit, unknown
