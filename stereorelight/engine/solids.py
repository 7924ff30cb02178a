"""Solids of the ray caster: the field of smooth unions and cuts, a ray's first hit on it, and tables of the empty space about it.

In: rows of a scene's tables (columns in engine/raycast.py), points and rays in a solid's own frame, metres, float64.
The field is the zero set of smooth unions and cuts: sphere tracing brackets the first sign change and the Illinois rule closes it to
1e-12 m, so the hit does not depend on the step length, nor on the tables.  Steps near the surface look only at the primitives that
can change the field there, which is exact: what is left out cannot move it by one bit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.locks import KERNEL_LOCK
from stereorelight.engine.texture import octaves

SOLID = 3  # the kind of an object's row
# Primitive row: shape, operation, blend width, centre (3), R (9), parameters (4), reach, stretch (two bounds used to skip it).
ELLIPSOID, ROUND_CONE, TORUS = 0, 1, 2
UNION, CUT = 0, 1
PRIMITIVE_COLUMNS = 21

CAUTION = 0.85  # share of the field's value that one step may take; blended ellipsoids overstate distance a little
SMALLEST_STEP_M = 2e-5
GRADIENT_STEP_M = 2e-5  # central differences: error of order step^2, below 1e-6 of a degree on these shapes
MOST_STEPS = 3000
NEAR_M = 0.01  # how near to zero the field is exact where only the primitives about a point are looked at
SHORTEST_SKIP_M = 1e-3
CELLS = 48  # of the table of empty space, along each side
# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever texture.py does;
# tests/test_synth_truth.py holds the two together.
TEXTURE = "8901d062635484d1"


@njit(cache=True, nogil=True)
def _shape(p, row, x, y, z):
    """Field of one primitive at a point of the object's frame: about the distance, exact in sign."""
    dx, dy, dz = x - p[row, 3], y - p[row, 4], z - p[row, 5]
    lx = p[row, 6] * dx + p[row, 7] * dy + p[row, 8] * dz
    ly = p[row, 9] * dx + p[row, 10] * dy + p[row, 11] * dz
    lz = p[row, 12] * dx + p[row, 13] * dy + p[row, 14] * dz
    shape = int(p[row, 0])
    if shape == ELLIPSOID:
        ax, ay, az = lx / p[row, 15], ly / p[row, 16], lz / p[row, 17]
        k0 = math.sqrt(ax * ax + ay * ay + az * az)
        bx, by, bz = ax / p[row, 15], ay / p[row, 16], az / p[row, 17]
        k1 = math.sqrt(bx * bx + by * by + bz * bz)
        return k0 * (k0 - 1.0) / k1 if k1 > 0.0 else -min(p[row, 15], p[row, 16], p[row, 17])
    if shape == ROUND_CONE:  # two balls, at the origin and at y = length, and their tangent cone
        r1, r2, length = p[row, 15], p[row, 16], p[row, 17]
        b = (r1 - r2) / length
        a = math.sqrt(1.0 - b * b)
        q = math.sqrt(lx * lx + lz * lz)
        k = -b * q + a * ly
        if k < 0.0:
            return math.sqrt(q * q + ly * ly) - r1
        if k > a * length:
            return math.sqrt(q * q + (ly - length) * (ly - length)) - r2
        return q * a + ly * b - r1
    q = math.sqrt(lx * lx + lz * lz) - p[row, 15]
    return math.sqrt(q * q + ly * ly) - p[row, 16]


@njit(cache=True, nogil=True)
def _blend(a, b, width):
    """Smooth minimum, cubic: twice differentiable, and exactly min(a, b) where they differ by more than `width`."""
    if width <= 0.0:
        return min(a, b)
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - h * h * h * width / 6.0


@njit(cache=True, nogil=True)
def field_near(objects, n, primitives, near, count, x, y, z):
    """Field of solid `n` at a point of its frame: negative inside, about the distance outside.

    near, count : the primitives to look at, the first `count` of `near`, in their order (`_near_ray`, `_near_point`).
    """
    d = 1e9
    for k in range(count):
        row = near[k]
        width = primitives[row, 2]
        dx, dy, dz = x - primitives[row, 3], y - primitives[row, 4], z - primitives[row, 5]
        away2 = dx * dx + dy * dy + dz * dz
        # Beyond this distance the primitive cannot change d by one bit, so leaving it out is exact.
        if primitives[row, 1] == UNION:
            far = primitives[row, 19] + primitives[row, 20] * max(d + width, 0.0)
            if away2 < far * far:
                d = _blend(d, _shape(primitives, row, x, y, z), width)
        else:
            far = primitives[row, 19] + primitives[row, 20] * max(width - d, 0.0)
            if d < width + primitives[row, 19] and away2 < far * far:
                d = -_blend(-d, _shape(primitives, row, x, y, z), width)
    wrinkle = objects[n, 20]
    if wrinkle > 0.0:
        if d > 4.0 * wrinkle:
            return d - 2.0 * wrinkle
        d -= wrinkle * octaves(x * objects[n, 21], y * objects[n, 22], z * objects[n, 23], 2, 0.45, 900)
    return d


@njit(cache=True, nogil=True)
def field(objects, n, primitives, x, y, z):
    """Field of solid `n` at a point of its frame: negative inside, about the distance outside."""
    first, count = int(objects[n, 2]), int(objects[n, 3])
    return field_near(objects, n, primitives, np.arange(first, first + count), count, x, y, z)


@njit(cache=True, nogil=True)
def near_primitives(objects, n, primitives, x, y, z, near):
    """How many primitives, put into `near` in their order, can move the field by one bit where it is below NEAR_M, within NEAR_M of a point.

    Seen from the end of the chain: what a blend of width w makes of a field is below `most` only where the field is below
    most + 7/6 w, so that is asked of what came before it; what lies farther is cut off by the blend itself.
    """
    first, count = int(objects[n, 2]), int(objects[n, 3])
    most = NEAR_M + 4.0 * objects[n, 20]
    left = count
    for row in range(first + count - 1, first - 1, -1):
        width = primitives[row, 2]
        dx, dy, dz = x - primitives[row, 3], y - primitives[row, 4], z - primitives[row, 5]
        far = NEAR_M + primitives[row, 19] + primitives[row, 20] * (most + width)
        if dx * dx + dy * dy + dz * dz < far * far:
            left -= 1
            near[left] = row
            if primitives[row, 1] == UNION:
                most += 7.0 / 6.0 * width
    for k in range(count - left):
        near[k] = near[left + k]
    return count - left


@njit(cache=True, nogil=True, parallel=True)
def _emptiness(objects, primitives, solids, cells):
    out = np.zeros((solids.shape[0], cells, cells, cells), np.float32)
    for slice_ in prange(solids.shape[0] * cells):
        k, i = slice_ // cells, slice_ % cells
        n = solids[k]
        radius = objects[n, 16]
        cell = 2.0 * radius / cells
        for j in range(cells):
            for m in range(cells):
                x, y, z = (i + 0.5) * cell - radius, (j + 0.5) * cell - radius, (m + 0.5) * cell - radius
                if x * x + y * y + z * z > (radius + cell) ** 2:
                    continue
                f = field(objects, n, primitives, x + objects[n, 17], y + objects[n, 18], z + objects[n, 19])
                clear = CAUTION * f - 0.8661 * cell  # half the diagonal: it holds for the whole cell
                if clear > SHORTEST_SKIP_M:
                    out[k, i, j, m] = clear
    return out


@njit(cache=True, nogil=True)
def trace_solid(objects, n, primitives, empty, table, ox, oy, oz, dx, dy, dz, limit, near):
    """t of the first hit on solid `n` before `limit`, or `limit`; ray in the solid's frame; `near` is room for its primitives."""
    radius = objects[n, 16]
    speed2 = dx * dx + dy * dy + dz * dz
    cx, cy, cz = ox - objects[n, 17], oy - objects[n, 18], oz - objects[n, 19]
    half = (cx * dx + cy * dy + cz * dz) / speed2
    inside = half * half - (cx * cx + cy * cy + cz * cz - radius * radius) / speed2
    if inside <= 0.0:
        return limit
    t = max(-half - math.sqrt(inside), 0.0)
    end = min(-half + math.sqrt(inside), limit)
    speed = math.sqrt(speed2)
    cells = empty.shape[1]
    per_m = cells / (2.0 * radius)
    before, f_before, f, listed, count = t, -1.0, 0.0, -1e30, 0
    started = False
    for _ in range(MOST_STEPS):
        if t >= end:
            return limit
        i = min(max(int((cx + t * dx + radius) * per_m), 0), cells - 1)
        j = min(max(int((cy + t * dy + radius) * per_m), 0), cells - 1)
        k = min(max(int((cz + t * dz + radius) * per_m), 0), cells - 1)
        clear = empty[table, i, j, k]
        if clear > 0.0:
            started, before, f_before = True, t, -1.0
            t += clear / speed
            continue
        if (t - listed) * speed > NEAR_M:
            listed = t
            count = near_primitives(objects, n, primitives, ox + t * dx, oy + t * dy, oz + t * dz, near)
        f = field_near(objects, n, primitives, near, count, ox + t * dx, oy + t * dy, oz + t * dz)
        if f <= 0.0:
            break
        started, before, f_before = True, t, f
        # Beyond NEAR_M what was left out may be nearer than f says.
        t = min(t + max(CAUTION * min(f, NEAR_M), SMALLEST_STEP_M) / speed, end)
    if not started or f > 0.0:
        return limit  # a ray that starts inside has no outer surface ahead of it
    if f_before < 0.0:  # the step before came from the table
        f_before = field(objects, n, primitives, ox + before * dx, oy + before * dy, oz + before * dz)
        if f_before <= 0.0:
            return before
    low, high, f_low, f_high, side = before, t, f_before, f, 0
    for _ in range(60):
        if (high - low) * speed < 1e-12 or f_high == 0.0:
            break
        m = (f_low * high - f_high * low) / (f_low - f_high)
        f_m = field_near(objects, n, primitives, near, count, ox + m * dx, oy + m * dy, oz + m * dz)
        if abs(f_m) < 1e-14:
            return m
        if f_m < 0.0:
            high, f_high = m, f_m
            if side == 1:
                f_low *= 0.5
            side = 1
        else:
            low, f_low = m, f_m
            if side == -1:
                f_high *= 0.5
            side = -1
    return high


@dataclass(frozen=True, kw_only=True, eq=False)
class Emptiness:
    """How far it is at least from anywhere in a cell to each solid's surface: steps that need no look at the solid.

    clear_m : (solids, n, n, n) float32 over the cube about each solid's ball; 0 where the field must be asked.
    tables  : (objects,) which of them belongs to an object.
    """

    clear_m: Float32
    tables: npt.NDArray[np.int64]


def emptiness(objects: Float64, primitives: Float64, *, cells: int = CELLS) -> Emptiness:
    """The tables of all solids; a scene is traced faster with them, and the hits are the same to 1e-11 m."""
    solids = np.flatnonzero(objects[:, 0] == SOLID)
    tables = np.zeros(len(objects), np.int64)
    tables[solids] = np.arange(len(solids))
    if not len(solids):
        return Emptiness(clear_m=np.zeros((1, 1, 1, 1), np.float32), tables=tables)
    with KERNEL_LOCK:
        return Emptiness(clear_m=_emptiness(objects, primitives, solids, cells), tables=tables)
