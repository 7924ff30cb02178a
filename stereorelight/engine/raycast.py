"""Ray casting of small analytic scenes: first hits, surface normals and albedo, in float64.

In: rays (n, 3) in world coordinates and a scene as four tables of numbers (columns below).  Out: the ray parameter `t`
of the first hit (point = origin + t direction), the object hit, and the surface there.
Frames: world is right-handed, y up, metres; an object has its own frame, `p_object = R (p_world - origin)`.
Planes, spheres, boxes and rods are intersected in closed form, solids by engine/solids.py.  Every ray stands alone: the result is the
same bits whatever the number of threads."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from stereorelight.arrays import Bool, Float64
from stereorelight.engine.locks import KERNEL_LOCK
from stereorelight.engine.solids import GRADIENT_STEP_M, SOLID, Emptiness, field_near, near_primitives, trace_solid
from stereorelight.engine.texture import albedo_at

# Object row: kind, material, first primitive, primitive count, R (9), origin (3), parameters (4), wrinkles (amplitude, frequency xyz).
PLANE, SPHERE, BOX, ROD = 0, 1, 2, 4  # SOLID is 3
OBJECT_COLUMNS = 24
FARTHEST_M = 1e6  # radius of the ball about an endless plane
# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever those below it do;
# tests/test_synth_truth.py holds them together.
TEXTURE = "8901d062635484d1"
SOLIDS = "5ebb9e4e1989cd1b"


@njit(cache=True, nogil=True)
def _ball(ox, oy, oz, dx, dy, dz, radius, limit):
    """t of the first hit on a ball about the origin of its frame, or `limit`."""
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    # |offset from the closest point|^2 by a cross product: keeps its digits far from the sphere.
    ex, ey, ez = oy * dz - oz * dy, oz * dx - ox * dz, ox * dy - oy * dx
    q = radius * radius * a - (ex * ex + ey * ey + ez * ez)
    if q > 0.0:
        s = (-b - math.sqrt(q)) / a
        if 0.0 < s < limit:
            return s
    return limit


@njit(cache=True, nogil=True)
def _rod(ox, oy, oz, dx, dy, dz, radius, half, limit):
    """t of the first hit on a round-ended rod along y, or `limit`."""
    a = dx * dx + dz * dz
    e = oz * dx - ox * dz
    q = radius * radius * a - e * e
    if q <= 0.0:
        if a > 0.0 or ox * ox + oz * oz >= radius * radius:
            return limit  # never inside the endless cylinder, which holds the ends too
        return _ball(ox, oy + math.copysign(half, dy), oz, dx, dy, dz, radius, limit)
    s = (-(ox * dx + oz * dz) - math.sqrt(q)) / a
    y = oy + s * dy
    if abs(y) <= half:
        return s if 0.0 < s < limit else limit
    return _ball(ox, oy - math.copysign(half, y), oz, dx, dy, dz, radius, limit)


@njit(cache=True, nogil=True)
def _hit(objects, n, primitives, empty, table, ax, ay, az, bx, by, bz, limit, near):
    """t of the first hit of one ray on object `n` before `limit`, or `limit`."""
    wx, wy, wz = ax - objects[n, 13], ay - objects[n, 14], az - objects[n, 15]
    ox = objects[n, 4] * wx + objects[n, 5] * wy + objects[n, 6] * wz
    oy = objects[n, 7] * wx + objects[n, 8] * wy + objects[n, 9] * wz
    oz = objects[n, 10] * wx + objects[n, 11] * wy + objects[n, 12] * wz
    dx = objects[n, 4] * bx + objects[n, 5] * by + objects[n, 6] * bz
    dy = objects[n, 7] * bx + objects[n, 8] * by + objects[n, 9] * bz
    dz = objects[n, 10] * bx + objects[n, 11] * by + objects[n, 12] * bz
    kind = int(objects[n, 0])
    if kind == SOLID:
        return trace_solid(objects, n, primitives, empty, table, ox, oy, oz, dx, dy, dz, limit, near)
    t = limit
    if kind == PLANE:  # z = 0 of its frame, seen only from z > 0
        if dz < 0.0 < oz:
            s = -oz / dz
            if s < limit and abs(ox + s * dx) <= objects[n, 16] and abs(oy + s * dy) <= objects[n, 17]:
                t = s
    elif kind == SPHERE:
        t = _ball(ox, oy, oz, dx, dy, dz, objects[n, 16], limit)
    elif kind == ROD:
        t = _rod(ox, oy, oz, dx, dy, dz, objects[n, 16], objects[n, 17], limit)
    else:
        enter, leave = -1e30, 1e30
        for axis in range(3):
            p = ox if axis == 0 else (oy if axis == 1 else oz)
            d = dx if axis == 0 else (dy if axis == 1 else dz)
            h = objects[n, 16 + axis]
            if d == 0.0:
                if abs(p) > h:
                    return limit
            else:
                s1, s2 = (-h - p) / d, (h - p) / d
                enter, leave = max(enter, min(s1, s2)), min(leave, max(s1, s2))
        if enter < leave and 0.0 < enter < limit:
            t = enter
    return t


@njit(cache=True, nogil=True)
def _passes(balls, n, ox, oy, oz, dx, dy, dz, speed2, limit):
    """Whether a ray comes into ball `n` (centre, radius) before `limit`."""
    x, y, z = balls[n, 0] - ox, balls[n, 1] - oy, balls[n, 2] - oz
    along = x * dx + y * dy + z * dz
    off2 = x * x + y * y + z * z - balls[n, 3] * balls[n, 3]
    if off2 <= 0.0:
        return True
    return along > 0.0 and along * along >= off2 * speed2 and off2 < along * limit * 2.0


@njit(cache=True, nogil=True, parallel=True)
def _first_hits(objects, primitives, balls, empty, tables, origins, directions, limits, any_hit):
    count = directions.shape[0]
    t = np.full(count, np.nan)
    hit = np.full(count, -1, np.int64)
    block = 256
    for b in prange((count + block - 1) // block):
        near = np.empty(primitives.shape[0], np.int64)
        last = 0  # what the ray before met is asked first: it likely stands before the rest, or in the way again
        for i in range(b * block, min((b + 1) * block, count)):
            best = limits[i if limits.shape[0] > 1 else 0]
            if not best > 0.0 or not math.isfinite(directions[i, 0]):
                continue
            m = i if origins.shape[0] > 1 else 0
            ox, oy, oz, dx, dy, dz = origins[m, 0], origins[m, 1], origins[m, 2], directions[i, 0], directions[i, 1], directions[i, 2]
            speed2 = dx * dx + dy * dy + dz * dz
            first = last
            for k in range(-1, objects.shape[0]):
                n = first if k < 0 else k
                if k == first or not _passes(balls, n, ox, oy, oz, dx, dy, dz, speed2, best):
                    continue
                s = _hit(objects, n, primitives, empty, tables[n], ox, oy, oz, dx, dy, dz, best, near)
                if s < best:
                    best = s
                    t[i] = s
                    hit[i] = n
                    last = n
                    if any_hit:
                        break
    return t, hit


@njit(cache=True, nogil=True, parallel=True)
def _surface_at(objects, primitives, materials, points, hit):
    count = points.shape[0]
    normals = np.full((count, 3), np.nan)
    albedo = np.full((count, 3), np.nan)
    specular = np.full((count, 2), np.nan)
    h = GRADIENT_STEP_M
    block = 256
    for b in prange((count + block - 1) // block):
        near = np.empty(primitives.shape[0], np.int64)
        for i in range(b * block, min((b + 1) * block, count)):
            n = hit[i]
            if n < 0:
                continue
            o = objects[n]
            wx, wy, wz = points[i, 0] - o[13], points[i, 1] - o[14], points[i, 2] - o[15]
            x = o[4] * wx + o[5] * wy + o[6] * wz
            y = o[7] * wx + o[8] * wy + o[9] * wz
            z = o[10] * wx + o[11] * wy + o[12] * wz
            gx, gy, gz = x, y, z  # a sphere's own
            kind = int(o[0])
            if kind == PLANE:
                gx, gy, gz = 0.0, 0.0, 1.0
            elif kind == BOX:
                ax, ay, az = o[16] - abs(x), o[17] - abs(y), o[18] - abs(z)
                gx = math.copysign(1.0, x) if ax <= ay and ax <= az else 0.0
                gy = math.copysign(1.0, y) if gx == 0.0 and ay <= az else 0.0
                gz = math.copysign(1.0, z) if gx == 0.0 and gy == 0.0 else 0.0
            elif kind == ROD:
                gy = y - min(max(y, -o[17]), o[17])
            elif kind == SOLID:
                k = near_primitives(objects, n, primitives, x, y, z, near)
                gx = field_near(objects, n, primitives, near, k, x + h, y, z) - field_near(objects, n, primitives, near, k, x - h, y, z)
                gy = field_near(objects, n, primitives, near, k, x, y + h, z) - field_near(objects, n, primitives, near, k, x, y - h, z)
                gz = field_near(objects, n, primitives, near, k, x, y, z + h) - field_near(objects, n, primitives, near, k, x, y, z - h)
            length = math.sqrt(gx * gx + gy * gy + gz * gz)
            gx, gy, gz = gx / length, gy / length, gz / length
            normals[i, 0] = o[4] * gx + o[7] * gy + o[10] * gz
            normals[i, 1] = o[5] * gx + o[8] * gy + o[11] * gz
            normals[i, 2] = o[6] * gx + o[9] * gy + o[12] * gz
            m = materials[int(o[1])]
            albedo_at(m, x, y, z, albedo[i])
            specular[i, 0], specular[i, 1] = m[11], m[12]
    return normals, albedo, specular


def _balls(objects: Float64) -> Float64:
    """(n, 4) world centre and radius of a ball about each object, by its row."""
    out = np.empty((len(objects), 4))
    for ball, row in zip(out, objects):
        kind, size = int(row[0]), row[16:20]
        middle = row[4:13].reshape(3, 3).T @ size[1:] if kind == SOLID else np.zeros(3)
        radius = {PLANE: math.hypot(size[0], size[1]), BOX: float(np.linalg.norm(size[:3])), ROD: size[0] + size[1]}.get(kind, size[0])
        ball[:3], ball[3] = row[13:16] + middle, min(radius * (1 + 1e-9), FARTHEST_M)
    return out


def _cast(
    objects: Float64, primitives: Float64, rays: tuple[Float64, Float64, Float64], empty: Emptiness | None, any_hit: bool
) -> tuple[Float64, npt.NDArray[np.int64]]:
    known = empty or Emptiness(clear_m=np.zeros((1, 1, 1, 1), np.float32), tables=np.zeros(len(objects), np.int64))
    with KERNEL_LOCK:
        t, hit = _first_hits(objects, primitives, _balls(objects), known.clear_m, known.tables, *(np.ascontiguousarray(a) for a in rays), any_hit)
    return t, hit


def first_hits(
    objects: Float64,
    primitives: Float64,
    origins: Float64,
    directions: Float64,
    *,
    limits: Float64 | None = None,
    empty: Emptiness | None = None,
) -> tuple[Float64, npt.NDArray[np.int64]]:
    """First hit of each ray: (t (n,), NaN for none; object (n,), -1 for none).

    origins : (n, 3), or (1, 3) where all rays start at one point; directions: (n, 3), any length, NaN for no ray.
    limits  : (n,) t beyond which nothing counts (default: none); a limit of 0 or NaN skips the ray.
    empty   : the scene's own, for speed.
    """
    reach = np.array([1e30]) if limits is None else limits
    return _cast(objects, primitives, (origins, directions, reach), empty, False)


def blocked(objects: Float64, primitives: Float64, origins: Float64, directions: Float64, limits: Float64, *, empty: Emptiness | None = None) -> Bool:
    """Whether each ray meets anything before its limit; as `first_hits`, but stops at the first object found."""
    found: Bool = _cast(objects, primitives, (origins, directions, limits), empty, True)[1] >= 0
    return found


def surface_at(
    objects: Float64, primitives: Float64, materials: Float64, points: Float64, hit: npt.NDArray[np.int64]
) -> tuple[Float64, Float64, Float64]:
    """(unit outward normal (n, 3), albedo (n, 3), specular strength and exponent (n, 2)) at world points on objects `hit`; NaN for -1."""
    with KERNEL_LOCK:
        normals, albedo, specular = _surface_at(objects, primitives, materials, np.ascontiguousarray(points), hit)
    return normals, albedo, specular
