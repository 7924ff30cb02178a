"""Shadow rays marched through a depth: for every pixel, the share of a light that reaches it, and the share that nobody can know.

In: the seen surface as a grid of inverse depth (1 / metres) of a pinhole camera, with one cell of border; P, N (H, W, 3) and two
offsets (H, W); a light as a row of numbers.  Out: lit and unknown, (H, W) float32, 0..1, written into the arrays given.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres.

A straight ray is straight in the picture, and its inverse depth is affine along it: a step is two additions, one look-up and a
comparison.  A ray ends where it meets the light, leaves the frame, or is nearer than anything seen.  It is stopped where it goes
through a surface that hangs together, or lies behind one by less than the thickness; farther behind, where no camera saw, its answer is
unknown.
A row goes through in strips; each step is a leaf loop over separate rows, which the compiler turns into vector code."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import f4, i4, kernel
from stereorelight.engine.rows import in_row_blocks

# A light's row, float32.
PLACE, IS_PLACE, SIDE_U, SIDE_V, AXIS = 0, 3, 4, 7, 10  # position or unit vector towards it; half its extent each way; its shining side
BALL, RECTANGLE = 13, 14  # radius, 0 for none; 1 for a rectangle
COLUMNS = 15
STRIP = 256
OPEN, UNSEEN = 0.0, -1.0  # in the grid: nothing there however far; nobody knows


@kernel()
def _targets(n, oa, ob, q, px, py, pz, nx, ny, nz, lift, sx, sy, sz, lx, ly, lz, far, weight):
    """Where the rays start, the unit way to the light's sample, how far it is, and how much it counts for."""
    for i in range(n):
        a = oa[i]
        b = ob[i]
        ox = px[i] + nx[i] * lift[i]
        oy = py[i] + ny[i] * lift[i]
        oz = pz[i] + nz[i] * lift[i]
        tx = q[0] - q[3] * ox
        ty = q[1] - q[3] * oy
        tz = q[2] - q[3] * oz
        d2 = tx * tx + ty * ty + tz * tz
        # A ball shows the disc on which its tangents touch it, square to the way to it.
        r = f4(1) / math.sqrt(d2 + f4(1e-12))
        sine = q[13] * r
        inside = sine >= f4(1)
        sine = f4(0) if inside else sine
        size = f4(0) if inside else q[13] * math.sqrt(f4(1) - sine * sine)
        wx = tx * r
        wy = ty * r
        wz = tz * r
        sign = f4(1) if wz >= f4(0) else f4(-1)
        k = f4(-1) / (sign + wz)
        m = wx * wy * k
        back = q[13] * sine
        a_ = a * size
        b_ = b * size
        tx += a * q[4] + b * q[7] + a_ * (f4(1) + sign * wx * wx * k) + b_ * m - back * wx
        ty += a * q[5] + b * q[8] + a_ * (sign * m) + b_ * (sign + wy * wy * k) - back * wy
        tz += a * q[6] + b * q[9] - a_ * (sign * wx) - b_ * wy - back * wz
        d2 = tx * tx + ty * ty + tz * tz
        r = f4(1) / math.sqrt(d2 + f4(1e-12))
        tx *= r
        ty *= r
        tz *= r
        front = nx[i] * tx + ny[i] * ty + nz[i] * tz
        shining = -(tx * q[10] + ty * q[11] + tz * q[12]) * r * r
        shining = shining if shining > f4(0) else f4(0)
        w = front * (shining if q[14] > f4(0) else f4(1))
        sx[i] = ox
        sy[i] = -oy
        sz[i] = -oz if oz < f4(-1e-6) else f4(1e-6)
        lx[i] = tx
        ly[i] = -ty
        lz[i] = -tz
        far[i] = f4(1) / r if q[3] > f4(0) else f4(1e9)
        weight[i] = w if w > f4(0) else f4(0)


@kernel()
def _straight(n, lx_, ly_, lz_, w, px, py, pz, nx, ny, nz, lift, sx, sy, sz, lx, ly, lz, far, weight):
    """`_targets` of a light without a size."""
    for i in range(n):
        ox = px[i] + nx[i] * lift[i]
        oy = py[i] + ny[i] * lift[i]
        oz = pz[i] + nz[i] * lift[i]
        tx = lx_ - w * ox
        ty = ly_ - w * oy
        tz = lz_ - w * oz
        d2 = tx * tx + ty * ty + tz * tz + f4(1e-12)
        r = f4(1) / math.sqrt(d2)
        front = (nx[i] * tx + ny[i] * ty + nz[i] * tz) * r
        sx[i] = ox
        sy[i] = -oy
        sz[i] = -oz if oz < f4(-1e-6) else f4(1e-6)
        lx[i] = tx * r
        ly[i] = -ty * r
        lz[i] = -tz * r
        far[i] = d2 * r if w > f4(0) else f4(1e9)
        weight[i] = front if front > f4(0) else f4(0)


@kernel()
def _rays(n, fx, fy, cx, cy, width, height, near, sx, sy, sz, lx, ly, lz, far, half, weight, u, v, k, du, dv, dk, pixels, above, lost, lit):
    """The rays in the picture: start and whole extent in pixels and inverse depth, cut where they leave the frame or are nearer than `near`.

    pixels : how many the ray passes, along rows and columns together."""
    for i in range(n):
        z = sz[i]
        c = lz[i]
        t = far[i]
        towards = -c if -c > f4(1e-9) else f4(1e-9)
        most = (z - near) / towards
        most = most if most > f4(0) else f4(0)
        most = most if c < f4(0) else f4(1e9)
        t = most if most < t else t
        k0 = f4(1) / z
        u0 = sx[i] * k0 * fx + cx
        v0 = sy[i] * k0 * fy + cy
        # A start that was lifted over the border of the grid stays on it: nothing may be looked up beyond.
        u0 = u0 if u0 > f4(1.001) else f4(1.001)
        u0 = u0 if u0 < width else width
        v0 = v0 if v0 > f4(1.001) else f4(1.001)
        v0 = v0 if v0 < height else height
        k1 = f4(1) / (z + c * t)
        a = (sx[i] + lx[i] * t) * k1 * fx + cx - u0
        b = (sy[i] + ly[i] * t) * k1 * fy + cy - v0
        e = k1 - k0
        # The share of the ray that lies in the frame.
        room_u = (width - u0) if a > f4(0) else u0 - f4(1.001)
        room_v = (height - v0) if b > f4(0) else v0 - f4(1.001)
        room_u = room_u if room_u > f4(0) else f4(0)
        room_v = room_v if room_v > f4(0) else f4(0)
        abs_u = abs(a) + f4(1e-9)
        abs_v = abs(b) + f4(1e-9)
        share = room_u / abs_u
        other = room_v / abs_v
        share = other if other < share else share
        share = share if share < f4(1) else f4(1)
        a *= share
        b *= share
        e *= share
        good = weight[i] > f4(0)
        a = a if good else f4(0)
        b = b if good else f4(0)
        u[i] = u0 if good else f4(1.5)
        v[i] = v0 if good else f4(1.5)
        k[i] = k0 + half[i]
        du[i] = a
        dv[i] = b
        dk[i] = e if good else f4(0)
        above[i] = f4(-1)
        pixels[i] = abs(a) + abs(b)
        lost[i] = f4(1) if (share < f4(1)) & good else f4(0)
        lit[i] = f4(1) if good else f4(0)
    longest = i4(0)  # a whole number: the largest of floats is no vector code while NaN counts
    for i in range(n):
        whole = i4(abs(du[i])) if abs(du[i]) > abs(dv[i]) else i4(abs(dv[i]))
        longest = whole if whole > longest else longest
    return longest


@kernel()
def _step(n, at, columns, thick, grid, u, v, k, du, dv, dk, index, found, above, crossed, lit, hidden):
    """One look of every ray: stop those within the thickness of what is found, mark those that lie farther behind it, and those that
    changed sides.  Returns how many are left, and how many of them changed sides."""
    for i in range(n):
        index[i] = i4(v[i] + dv[i] * at) * columns + i4(u[i] + du[i] * at)
    for i in range(n):
        found[i] = grid[np.uint32(index[i])]
    left = f4(0)
    many = f4(0)
    for i in range(n):
        seen = found[i]
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
        left += still
        many += cross
    return left, many


@kernel()
def _through(n, at, step, columns, grid, reach, u, v, du, dv, pixels, index, found, crossed, words, lit):
    """Stop the rays that changed sides along a surface that hangs together: its depth changed no more than it does about there anyway.

    There are few: one by one, two looked for at a time in `words`, the bits of `crossed`.  Returns how many were stopped."""
    last = at - step
    stopped = f4(0)
    for word in range((n + 1) // 2):
        if words[word] == 0:
            continue
        for i in range(2 * word, min(2 * word + 2, n)):
            if not crossed[i] > f4(0):
                continue
            here = index[i]
            there = i4(v[i] + dv[i] * last) * columns + i4(u[i] + du[i] * last)
            long = pixels[i] * step
            most = max(reach[here], reach[there]) * max(long, f4(1))
            if abs(found[i] - grid[there]) < most:
                lit[i] = f4(0)
                stopped += f4(1)
    return stopped


@kernel()
def _gather(n, nearest, k, dk, lost, lit, hidden, weight, shone, doubt, total):
    """Add a sample up.  A ray that left the frame before it was nearer than the nearest things may have met something outside it."""
    for i in range(n):
        outside = lost[i] if k[i] + dk[i] < nearest else f4(0)
        unknown = hidden[i] if hidden[i] > outside else outside
        w = weight[i]
        shone[i] += w * lit[i]
        doubt[i] += w * lit[i] * unknown
        total[i] += w


@kernel()
def _split(n, P, N, lift, px, py, pz, nx, ny, nz):
    """Rows of P and N apart; a pixel without them, or without an offset, faces nothing."""
    for i in range(n):
        x = P[3 * i]
        y = P[3 * i + 1]
        z = P[3 * i + 2]
        a = N[3 * i]
        b = N[3 * i + 1]
        c = N[3 * i + 2]
        n2 = a * a + b * b + c * c
        good = (z < f4(-1e-6)) & (x * x + y * y + z * z < f4(1e30)) & (n2 > f4(0.25)) & (n2 < f4(4)) & (lift[i] >= f4(0))
        px[i] = x if good else f4(0)
        py[i] = y if good else f4(0)
        pz[i] = z if good else f4(-1)
        nx[i] = a if good else f4(0)
        ny[i] = b if good else f4(0)
        nz[i] = c if good else f4(0)


@kernel()
def _rows(first, end, P, N, lift, half, asked, partly, grid, reach, columns, fx, fy, cx, cy, near, nearest, thick, q, offsets, steps, lit, unknown):
    """Rows first..end; P, N are (H, 3 W); grid is flat with a border of one cell, `columns` wide; cx, cy hold the border and half a pixel."""
    W = N.shape[1] // 3
    T = np.empty((31, STRIP + 16), np.float32)
    oa, ob = T[29], T[30]
    px, py, pz, nx, ny, nz, sx, sy, sz, lx, ly, lz = T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9], T[10], T[11]
    far, weight, u, v, k, du, dv, dk, pixels, lost, hidden = T[12], T[13], T[14], T[15], T[16], T[17], T[18], T[19], T[20], T[21], T[22]
    found, going, shone, doubt, total, above = T[23], T[24], T[25], T[26], T[27], T[28]
    index = np.empty(STRIP + 16, np.int32)
    words = np.zeros(STRIP // 2, np.uint64)
    crossed = words.view(np.float32)
    samples = offsets.shape[1]
    width = f4(columns - 1) - f4(0.001)
    height = f4(grid.shape[0] // columns - 1) - f4(0.001)
    for y in range(first, end):
        for x in range(0, W, STRIP):
            n = min(STRIP, W - x)
            _split(n, P[y, 3 * x : 3 * (x + n)], N[y, 3 * x : 3 * (x + n)], lift[y, x : x + n], px, py, pz, nx, ny, nz)
            shone[:] = f4(0)
            doubt[:] = f4(0)
            total[:] = f4(0)
            halves = half[y, x : x + n]
            for sample in range(samples):
                if samples == 1 and q[BALL] == f4(0) and q[RECTANGLE] == f4(0) and offsets[0, 0, 0] == f4(0):
                    _straight(n, q[0], q[1], q[2], q[3], px, py, pz, nx, ny, nz, lift[y, x : x + n], sx, sy, sz, lx, ly, lz, far, weight)
                else:
                    first_kind = (y & 3) * 4  # a strip begins at a multiple of four
                    for i in range(n):
                        oa[i] = offsets[first_kind + (i & 3), sample, 0]
                        ob[i] = offsets[first_kind + (i & 3), sample, 1]
                    _targets(n, oa, ob, q, px, py, pz, nx, ny, nz, lift[y, x : x + n], sx, sy, sz, lx, ly, lz, far, weight)
                if partly:
                    wanted = asked[y, x : x + n]
                    for i in range(n):
                        weight[i] = weight[i] if wanted[i] > f4(0) else f4(0)
                longest = _rays(
                    n, fx, fy, cx, cy, width, height, near, sx, sy, sz, lx, ly, lz, far, halves, weight, u, v, k, du, dv, dk, pixels,
                    above, lost, going,
                )  # fmt: skip
                hidden[:] = f4(0)
                count = min(steps, longest + 1)
                step = f4(1) / f4(count)
                for s in range(1, count + 1):
                    at = f4(s) * step
                    left, many = _step(n, at, columns, thick, grid, u, v, k, du, dv, dk, index, found, above, crossed, going, hidden)
                    if many > f4(0):
                        left -= _through(n, at, step, columns, grid, reach, u, v, du, dv, pixels, index, found, crossed, words, going)
                    if left < f4(0.5):
                        break
                _gather(n, nearest, k, dk, lost, going, hidden, weight, shone, doubt, total)
            for i in range(n):
                some = total[i] > f4(0)
                per = f4(1) / total[i] if some else f4(0)
                lit[y, x + i] = shone[i] * per
                unknown[y, x + i] = doubt[i] * per


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """The seen surface as the march reads it; make it with `grid_of`.

    cells, reach : flat, with a border of one cell, `columns` wide.     pinhole : fx, fy, cx, cy of the camera that it is seen by.
    near    : metres, just nearer than the nearest cell.     nearest : inverse depth beyond which nothing is expected outside the frame.
    """

    cells: Float32
    reach: Float32
    columns: int
    pinhole: tuple[float, float, float, float]
    near: float
    nearest: float


def grid_of(inverse: Float32, reach: Float32, pinhole: tuple[float, float, float, float], *, nearest: float) -> Grid:
    """inverse : (h, w) inverse depth, 1 / metres; OPEN where nothing is, UNSEEN where nobody knows.
    reach   : (h, w) 1 / metres, what inverse depth changes by to a cell's neighbours on the same surface, at most."""

    def bordered(values: Float32, beyond: float) -> Float32:
        room = np.full((values.shape[0] + 2, values.shape[1] + 2), beyond, np.float32)
        room[1:-1, 1:-1] = values
        return room.reshape(-1)

    near = 0.999 / max(float(inverse.max()), 1e-9)
    return Grid(
        cells=bordered(inverse, UNSEEN), reach=bordered(reach, 0.0), columns=inverse.shape[1] + 2, pinhole=pinhole, near=near, nearest=nearest
    )


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
    thickness_m: float,
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
    numbers = (f4(fx), f4(fy), f4(cx + 1.5), f4(cy + 1.5), f4(grid.near), f4(grid.nearest), f4(thickness_m))
    flat = [a.reshape(height, -1) for a in (P, N)]
    where = np.empty((1, 1), np.float32) if asked is None else asked

    def run(first: int, end: int) -> None:
        _rows(
            first, end, *flat, lift, half, where, asked is not None, grid.cells, grid.reach, i4(grid.columns), *numbers, light, offsets, steps,
            lit, unknown,
        )  # fmt: skip

    in_row_blocks(run, height)
    return lit, unknown
