"""Ray casting of small analytic scenes: first hits, surface normals and albedo, in float64.

In: rays (n, 3) in world coordinates and a scene as four tables of numbers (columns below).  Out: the ray parameter `t`
of the first hit (point = origin + t direction), the object hit, and the surface there.
Frames: world is right-handed, y up, metres; an object has its own frame, `p_object = R (p_world - origin)`.
Planes, spheres, boxes and rods are intersected in closed form.  Solids are the zero set of a field made of smooth unions and
cuts: sphere tracing brackets the first sign change and the Illinois rule closes it to 1e-12 m, so the hit does not
depend on the step length.  Every ray stands alone: the result is the same bits whatever the number of threads."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from stereorelight.arrays import Bool, Float64
from stereorelight.engine.locks import KERNEL_LOCK
from stereorelight.engine.texture import albedo_at, octaves

# Object row: kind, material, first primitive, primitive count, R (9), origin (3), parameters (4), wrinkles (amplitude, frequency xyz).
PLANE, SPHERE, BOX, SOLID, ROD = 0, 1, 2, 3, 4
OBJECT_COLUMNS = 24
# Primitive row: shape, operation, blend width, centre (3), R (9), parameters (4), reach, stretch (two bounds used to skip it).
ELLIPSOID, ROUND_CONE, TORUS = 0, 1, 2
UNION, CUT = 0, 1
PRIMITIVE_COLUMNS = 21

CAUTION = 0.85  # share of the field's value that one step may take; blended ellipsoids overstate distance a little
SMALLEST_STEP_M = 2e-5
GRADIENT_STEP_M = 2e-5  # central differences: error of order step^2, below 1e-6 of a degree on these shapes
MOST_STEPS = 3000
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
def field(objects, n, primitives, x, y, z):
    """Field of solid `n` at a point of its frame: negative inside, about the distance outside."""
    first, count = int(objects[n, 2]), int(objects[n, 3])
    d = 1e9
    for row in range(first, first + count):
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
def _trace_solid(objects, n, primitives, ox, oy, oz, dx, dy, dz, limit):
    """t of the first hit on solid `n` before `limit`, or `limit`; ray in the solid's frame."""
    speed2 = dx * dx + dy * dy + dz * dz
    cx, cy, cz = ox - objects[n, 17], oy - objects[n, 18], oz - objects[n, 19]
    half = (cx * dx + cy * dy + cz * dz) / speed2
    inside = half * half - (cx * cx + cy * cy + cz * cz - objects[n, 16] * objects[n, 16]) / speed2
    if inside <= 0.0:
        return limit
    t = max(-half - math.sqrt(inside), 0.0)
    end = min(-half + math.sqrt(inside), limit)
    speed = math.sqrt(speed2)
    before, f_before = t, field(objects, n, primitives, ox + t * dx, oy + t * dy, oz + t * dz)
    if f_before <= 0.0:
        return limit  # the ray starts inside: no outer surface lies ahead of it
    f = f_before
    for _ in range(MOST_STEPS):
        if t >= end:
            return limit
        before, f_before = t, f
        t = min(t + max(CAUTION * f, SMALLEST_STEP_M) / speed, end)
        f = field(objects, n, primitives, ox + t * dx, oy + t * dy, oz + t * dz)
        if f <= 0.0:
            break
    if f > 0.0:
        return limit
    low, high, f_low, f_high, side = before, t, f_before, f, 0
    for _ in range(60):
        if (high - low) * speed < 1e-12 or f_high == 0.0:
            break
        m = (f_low * high - f_high * low) / (f_low - f_high)
        f_m = field(objects, n, primitives, ox + m * dx, oy + m * dy, oz + m * dz)
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
def _hit(objects, n, primitives, origin, direction, limit):
    """t of the first hit of one ray on object `n` before `limit`, or `limit`."""
    o = objects[n]
    wx, wy, wz = origin[0] - o[13], origin[1] - o[14], origin[2] - o[15]
    ox = o[4] * wx + o[5] * wy + o[6] * wz
    oy = o[7] * wx + o[8] * wy + o[9] * wz
    oz = o[10] * wx + o[11] * wy + o[12] * wz
    dx = o[4] * direction[0] + o[5] * direction[1] + o[6] * direction[2]
    dy = o[7] * direction[0] + o[8] * direction[1] + o[9] * direction[2]
    dz = o[10] * direction[0] + o[11] * direction[1] + o[12] * direction[2]
    kind = int(o[0])
    if kind == SOLID:
        return _trace_solid(objects, n, primitives, ox, oy, oz, dx, dy, dz, limit)
    t = limit
    if kind == PLANE:  # z = 0 of its frame, seen only from z > 0
        if dz < 0.0 < oz:
            s = -oz / dz
            if s < limit and abs(ox + s * dx) <= o[16] and abs(oy + s * dy) <= o[17]:
                t = s
    elif kind == SPHERE:
        t = _ball(ox, oy, oz, dx, dy, dz, o[16], limit)
    elif kind == ROD:
        t = _rod(ox, oy, oz, dx, dy, dz, o[16], o[17], limit)
    else:
        near, far = -1e30, 1e30
        for axis in range(3):
            p = ox if axis == 0 else (oy if axis == 1 else oz)
            d = dx if axis == 0 else (dy if axis == 1 else dz)
            h = o[16 + axis]
            if d == 0.0:
                if abs(p) > h:
                    return limit
            else:
                s1, s2 = (-h - p) / d, (h - p) / d
                near, far = max(near, min(s1, s2)), min(far, max(s1, s2))
        if near < far and 0.0 < near < limit:
            t = near
    return t


@njit(cache=True, nogil=True, parallel=True)
def _first_hits(objects, primitives, origins, directions, limits, any_hit):
    count = directions.shape[0]
    t = np.full(count, np.nan)
    hit = np.full(count, -1, np.int64)
    block = 256
    for b in prange((count + block - 1) // block):
        for i in range(b * block, min((b + 1) * block, count)):
            best = limits[i if limits.shape[0] > 1 else 0]
            if not best > 0.0 or not math.isfinite(directions[i, 0]):
                continue
            origin = origins[i if origins.shape[0] > 1 else 0]
            for n in range(objects.shape[0]):
                s = _hit(objects, n, primitives, origin, directions[i], best)
                if s < best:
                    best = s
                    t[i] = s
                    hit[i] = n
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
                gx = field(objects, n, primitives, x + h, y, z) - field(objects, n, primitives, x - h, y, z)
                gy = field(objects, n, primitives, x, y + h, z) - field(objects, n, primitives, x, y - h, z)
                gz = field(objects, n, primitives, x, y, z + h) - field(objects, n, primitives, x, y, z - h)
            length = math.sqrt(gx * gx + gy * gy + gz * gz)
            gx, gy, gz = gx / length, gy / length, gz / length
            normals[i, 0] = o[4] * gx + o[7] * gy + o[10] * gz
            normals[i, 1] = o[5] * gx + o[8] * gy + o[11] * gz
            normals[i, 2] = o[6] * gx + o[9] * gy + o[12] * gz
            m = materials[int(o[1])]
            albedo_at(m, x, y, z, albedo[i])
            specular[i, 0], specular[i, 1] = m[11], m[12]
    return normals, albedo, specular


def first_hits(
    objects: Float64, primitives: Float64, origins: Float64, directions: Float64, *, limits: Float64 | None = None
) -> tuple[Float64, npt.NDArray[np.int64]]:
    """First hit of each ray: (t (n,), NaN for none; object (n,), -1 for none).

    origins : (n, 3), or (1, 3) where all rays start at one point; directions: (n, 3), any length, NaN for no ray.
    limits  : (n,) t beyond which nothing counts (default: none); a limit of 0 or NaN skips the ray.
    """
    reach = np.array([1e30]) if limits is None else limits
    with KERNEL_LOCK:
        t, hit = _first_hits(objects, primitives, *(np.ascontiguousarray(a) for a in (origins, directions, reach)), False)
    return t, hit


def blocked(objects: Float64, primitives: Float64, origins: Float64, directions: Float64, limits: Float64) -> Bool:
    """Whether each ray meets anything before its limit; as `first_hits`, but stops at the first object found."""
    with KERNEL_LOCK:
        _, hit = _first_hits(objects, primitives, *(np.ascontiguousarray(a) for a in (origins, directions, limits)), True)
    found: Bool = hit >= 0
    return found


def surface_at(
    objects: Float64, primitives: Float64, materials: Float64, points: Float64, hit: npt.NDArray[np.int64]
) -> tuple[Float64, Float64, Float64]:
    """(unit outward normal (n, 3), albedo (n, 3), specular strength and exponent (n, 2)) at world points on objects `hit`; NaN for -1."""
    with KERNEL_LOCK:
        normals, albedo, specular = _surface_at(objects, primitives, materials, np.ascontiguousarray(points), hit)
    return normals, albedo, specular
