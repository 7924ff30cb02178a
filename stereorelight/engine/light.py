"""The light kernel: rows of Z or P, N and albedo under any mixture of lights, to a relit picture or to single layers.

In: Z (H, W) with rays, or P (H, W, 3); N, albedo and plate (H, W, 3) float32; lights as a table (columns below).
Out: the relit plate, or one (H, W, 3) layer for each slot asked for; written into the arrays given.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres.
A row goes through in strips that stay in the cache; each step is a leaf loop over separate rows, which the compiler
turns into vector code.  Strips are padded to whole vectors, so a pixel's bits do not depend on where its row was cut.
Pixels without P or N get exactly 0 light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import angle_of_chord, f4, floor, i4, kernel, power_below_one
from stereorelight.engine.rows import in_row_blocks

# Columns of the light table, float32.
PLACE = 0  # 0..2: position, or the unit vector towards a directional light
IS_PLACE = 3  # 1 for a position, 0 for a direction
AXIS = 4  # 4..6: unit vector along which a spot shines
EDGE = 7  # angle off the axis at which a spot ends, radians
PER_ANGLE = 8  # 1 / penumbra in radians; 0 where the light is no spot
WRAP_SCALE, WRAP_OFFSET = 9, 10  # diffuse = max(0, scale N.L + offset)
FALL_NONE, FALL_LINEAR, FALL_SQUARE = 11, 12, 13  # strength = none + linear / d + square / d^2
WINDOW = 14  # 1 / radius^4 of the window (1 - d^4 / radius^4)^2; 0 for none
EXPONENT = 15
DIFFUSE, SPECULAR = 16, 19  # three channels each, everything that is the same for all pixels
COLUMNS = 22
# Columns of the integer table: which matte, and which output layers; -1 for none.
MATTE, DIFFUSE_SLOT, SPECULAR_SLOT = 0, 1, 2

MOST_SQUARED = 128  # whole exponents up to here are raised by squaring; beyond, rounding would add up to 1e-5
NEAREST_M = 0.01  # a surface nearer to the light than this is lit as from here, so that nothing is infinite
# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever fastmath.py does;
# tests/test_light_layers.py holds the two together.
FASTMATH = "5d949dad28e0aee8"
STRIP = 2048  # 21 rows of it stay in the second-level cache
PADDING = 80  # rows a whole page apart would fall onto the same cache lines
VECTOR = 64  # whole vectors, unrolled, on any machine of today

_NEAREST2 = f4(NEAREST_M**2)
_FARTHEST2 = f4(1e30)  # square of what no scene reaches; beyond it, and NaN, is missing


@kernel(inline="always")
def _put_surface(i, x, y, z, a, b, c, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    """P, N and V = normalize(-P) into their rows; a pixel without P or N is marked 0 in `known` and made harmless."""
    p2 = x * x + y * y + z * z
    n2 = a * a + b * b + c * c
    r = f4(-1) / math.sqrt(p2)
    good = (p2 > f4(1e-20)) & (p2 < _FARTHEST2) & (n2 > f4(0.25)) & (n2 < f4(4))
    px[i] = x if good else f4(0)
    py[i] = y if good else f4(0)
    pz[i] = z if good else f4(0)
    nx[i] = a if good else f4(0)
    ny[i] = b if good else f4(0)
    nz[i] = c if good else f4(0)
    vx[i] = x * r if good else f4(0)
    vy[i] = y * r if good else f4(0)
    vz[i] = z * r if good else f4(0)
    known[i] = f4(1) if good else f4(0)


@kernel()
def _surface_by_pinhole(n, first, cx, per_fx, slope_y, Z, N, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    """P = (x Z, -y Z, -Z); anything but a positive Z becomes the origin, which is no place for a surface."""
    for i in range(n):
        d = Z[i] if Z[i] > f4(0) else f4(0)
        x = (f4(first + i4(i)) - cx) * per_fx * d
        _put_surface(i, x, -slope_y * d, -d, N[3 * i], N[3 * i + 1], N[3 * i + 2], px, py, pz, nx, ny, nz, vx, vy, vz, known)


@kernel()
def _surface_by_rays(n, rays, Z, N, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    for i in range(n):
        d = Z[i] if Z[i] > f4(0) else f4(0)
        _put_surface(i, rays[2 * i] * d, -rays[2 * i + 1] * d, -d, N[3 * i], N[3 * i + 1], N[3 * i + 2], px, py, pz, nx, ny, nz, vx, vy, vz, known)


@kernel()
def _surface_by_position(n, P, N, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    for i in range(n):
        _put_surface(i, P[3 * i], P[3 * i + 1], P[3 * i + 2], N[3 * i], N[3 * i + 1], N[3 * i + 2], px, py, pz, nx, ny, nz, vx, vy, vz, known)


@kernel()
def _copy(n, source, target):
    for i in range(n):
        target[i] = source[i]


@kernel()
def _through_matte(m, known, matte, lit):
    for i in range(m):
        lit[i] = known[i] * matte[i] if matte[i] > f4(0) else f4(0)


@kernel()
def _through_window(n, lx, ly, lz, per_radius4, px, py, pz, lit):
    """(1 - d^4 / radius^4)^2, 0 beyond the radius."""
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        t = f4(1) - d2 * d2 * per_radius4
        t = f4(0) if t < f4(0) else t
        lit[i] = lit[i] * (t * t)


@kernel()
def _through_cone(n, lx, ly, lz, ex, ey, ez, edge, per_angle, px, py, pz, lit):
    """Smoothstep of the angle off the axis.  The angle comes from the chord |L + axis|, which keeps narrow cones exact."""
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        d2 = _NEAREST2 if d2 < _NEAREST2 else d2
        r = f4(1) / math.sqrt(d2)
        a = a * r + ex
        b = b * r + ey
        c = c * r + ez
        t = (edge - angle_of_chord(a * a + b * b + c * c)) * per_angle
        t = f4(0) if t < f4(0) else t
        t = f4(1) if t > f4(1) else t
        lit[i] = lit[i] * (t * t * (f4(3) - f4(2) * t))


@kernel()
def _lambert(n, lx, ly, lz, w, ws, wo, a0, a1, a2, px, py, pz, nx, ny, nz, lit, e):
    for i in range(n):
        a = lx - w * px[i]
        b = ly - w * py[i]
        c = lz - w * pz[i]
        d2 = a * a + b * b + c * c
        d2 = _NEAREST2 if d2 < _NEAREST2 else d2
        r = f4(1) / math.sqrt(d2)
        nl = (nx[i] * a + ny[i] * b + nz[i] * c) * r
        k = nl * ws + wo
        k = k if k > f4(0) else f4(0)
        e[i] = k * (a0 + r * (a1 + r * a2)) * lit[i]


@kernel()
def _phong(n, lx, ly, lz, w, ws, wo, a0, a1, a2, px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front):
    """Lambert, and for the highlight 1 - R.V and the strength in front of the surface.

    1 - R.V comes from the chord |R - V|: near the highlight R.V itself has lost its last digits."""
    for i in range(n):
        a = lx - w * px[i]
        b = ly - w * py[i]
        c = lz - w * pz[i]
        d2 = a * a + b * b + c * c
        d2 = _NEAREST2 if d2 < _NEAREST2 else d2
        r = f4(1) / math.sqrt(d2)
        a = a * r
        b = b * r
        c = c * r
        nl = nx[i] * a + ny[i] * b + nz[i] * c
        k = nl * ws + wo
        k = k if k > f4(0) else f4(0)
        strength = (a0 + r * (a1 + r * a2)) * lit[i]
        e[i] = k * strength
        front[i] = strength if nl > f4(0) else f4(0)
        nl2 = nl + nl
        a = nl2 * nx[i] - a - vx[i]
        b = nl2 * ny[i] - b - vy[i]
        c = nl2 * nz[i] - c - vz[i]
        h[i] = f4(0.5) * (a * a + b * b + c * c)


@kernel()
def _lobe(n, exponent, h, front, s):
    """max(0, R.V)^exponent for any exponent."""
    for i in range(n):
        s[i] = power_below_one(h[i], exponent) * front[i]


@kernel()
def _lobe_whole(n, exponent, least, h, front, s):
    """The same for a whole exponent by squaring, a third of the work; h is used up.

    Bases below `least` count as 0: their powers would leave float32's normal range, where some processors crawl."""
    for i in range(n):
        x = f4(1) - h[i]
        x = x if x > least else f4(0)
        h[i] = x
        s[i] = x
    bit = 1
    while 2 * bit <= exponent:
        bit *= 2
    while bit > 1:
        bit //= 2
        if exponent & bit:
            for i in range(n):
                s[i] = s[i] * s[i] * h[i]
        elif bit > 1 and not exponent & (bit // 2):
            bit //= 2
            for i in range(n):
                x = s[i] * s[i]
                s[i] = x * x
        else:
            for i in range(n):
                s[i] = s[i] * s[i]
    for i in range(n):
        s[i] = s[i] * front[i]


@kernel()
def _put(n, e, red, green, blue, r, g, b):
    for i in range(n):
        r[i] = e[i] * red
        g[i] = e[i] * green
        b[i] = e[i] * blue


@kernel()
def _add(n, e, red, green, blue, r, g, b):
    for i in range(n):
        r[i] += e[i] * red
        g[i] += e[i] * green
        b[i] += e[i] * blue


@kernel()
def _write_diffuse(m, e, red, green, blue, albedo, out):
    for i in range(m):
        k = e[i]
        r = albedo[3 * i]
        g = albedo[3 * i + 1]
        b = albedo[3 * i + 2]
        # A layer never carries NaN or infinity, whatever the albedo holds.
        out[3 * i] = r * k * red if abs(r) < f4(1e30) else f4(0)
        out[3 * i + 1] = g * k * green if abs(g) < f4(1e30) else f4(0)
        out[3 * i + 2] = b * k * blue if abs(b) < f4(1e30) else f4(0)


@kernel()
def _write_specular(m, s, red, green, blue, out):
    for i in range(m):
        out[3 * i] = s[i] * red
        out[3 * i + 1] = s[i] * green
        out[3 * i + 2] = s[i] * blue


@kernel()
def _write_beauty(m, plate, albedo, gain_r, gain_g, gain_b, dr, dg, db, sr, sg, sb, out):
    for i in range(m):
        r = albedo[3 * i]
        g = albedo[3 * i + 1]
        b = albedo[3 * i + 2]
        r = r * dr[i] if abs(r) < f4(1e30) else f4(0)
        g = g * dg[i] if abs(g) < f4(1e30) else f4(0)
        b = b * db[i] if abs(b) < f4(1e30) else f4(0)
        out[3 * i] = plate[3 * i] * gain_r + (r + sr[i])
        out[3 * i + 1] = plate[3 * i + 1] * gain_g + (g + sg[i])
        out[3 * i + 2] = plate[3 * i + 2] * gain_b + (b + sb[i])


@kernel()
def _write_relit_plate(m, plate, gain_r, gain_g, gain_b, dr, dg, db, sr, sg, sb, out):
    """`_write_beauty` where the plate is its own albedo: one picture less to read."""
    for i in range(m):
        r = plate[3 * i]
        g = plate[3 * i + 1]
        b = plate[3 * i + 2]
        lit_r = r * dr[i] if abs(r) < f4(1e30) else f4(0)
        lit_g = g * dg[i] if abs(g) < f4(1e30) else f4(0)
        lit_b = b * db[i] if abs(b) < f4(1e30) else f4(0)
        out[3 * i] = r * gain_r + (lit_r + sr[i])
        out[3 * i + 1] = g * gain_g + (lit_g + sg[i])
        out[3 * i + 2] = b * gain_b + (lit_b + sb[i])


@kernel()
def _padded(source, room):
    """The last few values of a row at the head of `room`, which is longer; what stands behind them does not matter."""
    for i in range(source.shape[0]):
        room[i] = source[i]
    return room


@kernel()
def _rows(
    first, end, has_P, has_rays, P, Z, rays, N, fx, fy, cx, cy, albedo, lights, slots, mattes, layers, plate, gain, beauty, to_beauty, own_albedo
):
    """Rows first..end.  P, N, albedo, plate, beauty are (H, 3 W); rays (H, 2 W); layers (slots, H, 3 W); mattes (k, H, W)."""
    W = N.shape[1] // 3
    T = np.empty((21, STRIP + PADDING), np.float32)
    h, front = T[19], T[20]
    tail = np.zeros((3, 3 * VECTOR), np.float32)
    px, py, pz, nx, ny, nz, vx, vy, vz, known = T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9]
    lit, e, s, dr, dg, db, sr, sg, sb = T[10], T[11], T[12], T[13], T[14], T[15], T[16], T[17], T[18]
    for y in range(first, end):
        for x in range(0, W, STRIP):
            m = min(STRIP, W - x)
            n = (m + VECTOR - 1) // VECTOR * VECTOR
            whole = m // VECTOR * VECTOR
            # Whole vectors straight from the picture, and what is left over from a padded copy, through the same code.
            for part in range(2):
                i = 0 if part == 0 else whole
                count = whole if part == 0 else n - whole
                if count == 0:
                    continue
                Ns = N[y, 3 * x : 3 * (x + m)] if part == 0 else _padded(N[y, 3 * (x + i) : 3 * (x + m)], tail[0])
                ax, ay, az, bx, by, bz, cx_, cy_, cz, kn = px[i:], py[i:], pz[i:], nx[i:], ny[i:], nz[i:], vx[i:], vy[i:], vz[i:], known[i:]
                if has_P:
                    Ps = P[y, 3 * x : 3 * (x + m)] if part == 0 else _padded(P[y, 3 * (x + i) : 3 * (x + m)], tail[1])
                    _surface_by_position(count, Ps, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
                    continue
                Zs = Z[y, x : x + m] if part == 0 else _padded(Z[y, x + i : x + m], tail[1])
                if has_rays:
                    rs = rays[y, 2 * x : 2 * (x + m)] if part == 0 else _padded(rays[y, 2 * (x + i) : 2 * (x + m)], tail[2])
                    _surface_by_rays(count, rs, Zs, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
                else:
                    _surface_by_pinhole(count, i4(x + i), cx, f4(1) / fx, (f4(y) - cy) / fy, Zs, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
            dark, dull = True, True  # nothing summed yet: diffuse, specular
            for k in range(lights.shape[0]):
                q = lights[k]
                if slots[k, MATTE] >= 0:
                    _through_matte(m, known, mattes[slots[k, MATTE], y, x : x + m], lit)
                    lit[m:n] = f4(0)
                else:
                    _copy(n, known, lit)
                if q[WINDOW] > f4(0):
                    _through_window(n, q[0], q[1], q[2], q[WINDOW], px, py, pz, lit)
                if q[PER_ANGLE] > f4(0):
                    _through_cone(n, q[0], q[1], q[2], q[4], q[5], q[6], q[EDGE], q[PER_ANGLE], px, py, pz, lit)
                shines = slots[k, SPECULAR_SLOT] >= 0 or q[SPECULAR] + q[SPECULAR + 1] + q[SPECULAR + 2] > f4(0)
                if shines:
                    _phong(
                        n, q[0], q[1], q[2], q[3], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                        px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front,
                    )  # fmt: skip
                    if q[EXPONENT] <= f4(MOST_SQUARED) and q[EXPONENT] == floor(q[EXPONENT]):
                        _lobe_whole(n, int(q[EXPONENT]), f4(1e-30 ** (1 / q[EXPONENT])), h, front, s)
                    else:
                        _lobe(n, q[EXPONENT], h, front, s)
                else:
                    _lambert(
                        n, q[0], q[1], q[2], q[3], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                        px, py, pz, nx, ny, nz, lit, e,
                    )  # fmt: skip
                if to_beauty:
                    if dark:
                        _put(n, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], dr, dg, db)
                    else:
                        _add(n, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], dr, dg, db)
                    dark = False
                    if shines and dull:
                        _put(n, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], sr, sg, sb)
                    elif shines:
                        _add(n, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], sr, sg, sb)
                    dull = dull and not shines
                if slots[k, DIFFUSE_SLOT] >= 0:
                    a = albedo[y, 3 * x : 3 * (x + m)]
                    _write_diffuse(m, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], a, layers[slots[k, DIFFUSE_SLOT], y, 3 * x : 3 * (x + m)])
                if slots[k, SPECULAR_SLOT] >= 0:
                    _write_specular(m, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], layers[slots[k, SPECULAR_SLOT], y, 3 * x : 3 * (x + m)])
            if to_beauty:
                if dark:
                    _put(n, known, f4(0), f4(0), f4(0), dr, dg, db)
                if dull:
                    _put(n, known, f4(0), f4(0), f4(0), sr, sg, sb)
                strip = slice(3 * x, 3 * (x + m))
                if own_albedo:
                    _write_relit_plate(m, plate[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])
                else:
                    _write_beauty(m, plate[y, strip], albedo[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Where the light falls: P (H, W, 3), or Z (H, W) with either pinhole numbers or rays (H, W, 2); and N (H, W, 3)."""

    N: Float32
    P: Float32 | None = None
    Z: Float32 | None = None
    rays: Float32 | None = None
    pinhole: tuple[float, float, float, float] = (1.0, 1.0, 0.0, 0.0)  # fx, fy, cx, cy


def _flat(picture: Float32 | None) -> Float32:
    """(H, W, C) as (H, W C): leaf loops want plain rows."""
    return np.empty((1, 1), np.float32) if picture is None else picture.reshape(picture.shape[0], -1)


def shade(
    surface: Surface,
    albedo: Float32,
    lights: Float32,
    slots: npt.NDArray[np.int32],
    mattes: Float32,
    *,
    layers: Float32 | None = None,
    plate: Float32 | None = None,
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0),
    beauty: Float32 | None = None,
) -> None:
    """Write the layers that `slots` ask for, and the relit plate where `beauty` is given.

    lights : (n, COLUMNS) float32;  slots : (n, 3) int32;  mattes : (k, H, W) float32, 0..1, NaN counts as 0.
    layers : (slots, H, W, 3);  plate, beauty : (H, W, 3).  All C-contiguous and of one size: the caller has checked.
    """
    height, width = surface.N.shape[:2]
    flat_layers = np.empty((0, 1, 1), np.float32) if layers is None else layers.reshape(len(layers), height, 3 * width)
    Z = np.empty((1, 1), np.float32) if surface.Z is None else surface.Z
    fx, fy, cx, cy = (f4(v) for v in surface.pinhole)
    P, rays, N, flat_albedo = _flat(surface.P), _flat(surface.rays), _flat(surface.N), _flat(albedo)
    flat_plate, flat_beauty = _flat(plate), _flat(beauty)
    gains = np.array(gain, np.float32)

    def run(first: int, end: int) -> None:
        _rows(
            first, end, surface.P is not None, surface.rays is not None, P, Z, rays, N, fx, fy, cx, cy, flat_albedo,
            lights, slots, mattes, flat_layers, flat_plate, gains, flat_beauty, beauty is not None, albedo is plate,
        )  # fmt: skip

    in_row_blocks(run, height)
