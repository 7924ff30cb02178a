"""The leaf loops of the light kernel: one step over one strip of a row, each row its own argument, which the compiler turns
into vector code.

Rows are float32 of whole vectors; pictures are flat (three values a pixel).  Frame: scene frame of the camera, metres.
Pixels without P or N are marked 0 in `known` and made harmless."""

from __future__ import annotations

import math

import numpy as np

from stereorelight.engine.fastmath import angle_of_chord, f4, kernel, power_below_one

NEAREST_M = 0.01  # a surface nearer to the light than this is lit as from here, so that nothing is infinite
# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever fastmath.py does;
# tests/test_light_layers.py holds the two together.
FASTMATH = "66c93d0f0531acee"

NEAREST2 = f4(NEAREST_M**2)
FARTHEST2 = f4(1e30)  # square of what no scene reaches; beyond it, and NaN, is missing


@kernel(forceinline=True, fastmath=False)
def per_root(a):
    """1 / sqrt(a) as IEEE has it: the same bits on every processor, and exactly 1 for 1.  For loops that wait for memory anyway."""
    return f4(1) / math.sqrt(a)


@kernel(forceinline=True, fastmath={"contract"})
def once_more(a, r):
    """1 / sqrt(a) from r, what the processor guesses quickly, a bit or two off; Newton's step squares that, and a root of 1 is exactly 1.

    Without leave to reorder, or the compiler would know that there is nothing to correct."""
    return r - f4(0.5) * r * (a * r * r - f4(1))


@kernel(inline="always")
def put_surface(i, x, y, z, a, b, c, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    """P, N and V = normalize(-P) into their rows; a pixel without P or N is marked 0 in `known` and made harmless."""
    p2 = x * x + y * y + z * z
    n2 = a * a + b * b + c * c
    r = -per_root(p2)
    good = (p2 > f4(1e-20)) & (p2 < FARTHEST2) & (n2 > f4(0.25)) & (n2 < f4(4))
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
def pinhole_columns(n, fx, cx):
    """How far right of the axis the rays of a pinhole's columns go, a metre in front of it."""
    x = np.empty(n, np.float32)
    for i in range(n):
        x[i] = (f4(i) - cx) / fx
    return x


@kernel(noalias=True)
def taken_apart(n, rays, x, y):
    """Rays (x right, y down) as two rows, y up."""
    for i in range(n):
        x[i] = rays[2 * i]
        y[i] = -rays[2 * i + 1]


@kernel(noalias=True)
def surface_by_rays(n, x, y, Z, N, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    """P = (x Z, y Z, -Z); anything but a positive Z becomes the origin, which is no place for a surface."""
    for i in range(n):
        d = Z[i] if Z[i] > f4(0) else f4(0)
        put_surface(i, x[i] * d, y[i] * d, -d, N[3 * i], N[3 * i + 1], N[3 * i + 2], px, py, pz, nx, ny, nz, vx, vy, vz, known)


@kernel(noalias=True)
def surface_by_position(n, P, N, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    for i in range(n):
        put_surface(i, P[3 * i], P[3 * i + 1], P[3 * i + 2], N[3 * i], N[3 * i + 1], N[3 * i + 2], px, py, pz, nx, ny, nz, vx, vy, vz, known)


@kernel(noalias=True)
def fill(n, value, target):
    for i in range(n):
        target[i] = value


@kernel(noalias=True)
def copy(n, source, target):
    for i in range(n):
        target[i] = source[i]


@kernel(noalias=True)
def through_matte(m, known, matte, lit):
    for i in range(m):
        lit[i] = known[i] * matte[i] if matte[i] > f4(0) else f4(0)


@kernel(noalias=True)
def through_window(n, lx, ly, lz, per_radius4, px, py, pz, lit):
    """(1 - d^4 / radius^4)^2, 0 beyond the radius."""
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        t = f4(1) - d2 * d2 * per_radius4
        t = f4(0) if t < f4(0) else t
        lit[i] = lit[i] * (t * t)


@kernel(noalias=True)
def through_cone(n, lx, ly, lz, ex, ey, ez, edge, per_angle, px, py, pz, lit):
    """Smoothstep of the angle off the axis.  The angle comes from the chord |L + axis|, which keeps narrow cones exact."""
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        d2 = NEAREST2 if d2 < NEAREST2 else d2
        r = f4(1) / math.sqrt(d2)
        a = a * r + ex
        b = b * r + ey
        c = c * r + ez
        t = (edge - angle_of_chord(a * a + b * b + c * c)) * per_angle
        t = f4(0) if t < f4(0) else t
        t = f4(1) if t > f4(1) else t
        lit[i] = lit[i] * (t * t * (f4(3) - f4(2) * t))


@kernel(noalias=True)
def lambert(n, lx, ly, lz, w, ws, wo, a0, a1, a2, px, py, pz, nx, ny, nz, lit, e):
    for i in range(n):
        a = lx - w * px[i]
        b = ly - w * py[i]
        c = lz - w * pz[i]
        d2 = a * a + b * b + c * c
        d2 = NEAREST2 if d2 < NEAREST2 else d2
        r = once_more(d2, f4(1) / math.sqrt(d2))
        nl = (nx[i] * a + ny[i] * b + nz[i] * c) * r
        k = nl * ws + wo
        k = k if k > f4(0) else f4(0)
        e[i] = k * (a0 + r * (a1 + r * a2)) * lit[i]


@kernel(noalias=True)
def phong(n, lx, ly, lz, w, ws, wo, a0, a1, a2, px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front):
    """Lambert, and for the highlight 1 - R.V and the strength in front of the surface.

    1 - R.V comes from the chord |R - V|: near the highlight R.V itself has lost its last digits."""
    for i in range(n):
        a = lx - w * px[i]
        b = ly - w * py[i]
        c = lz - w * pz[i]
        d2 = a * a + b * b + c * c
        d2 = NEAREST2 if d2 < NEAREST2 else d2
        r = once_more(d2, f4(1) / math.sqrt(d2))
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


@kernel(noalias=True)
def lobe(n, exponent, h, front, s):
    """max(0, R.V)^exponent for any exponent."""
    for i in range(n):
        s[i] = power_below_one(h[i], exponent) * front[i]


@kernel(noalias=True)
def lobe_whole(n, exponent, least, h, front, s):
    """The same for a whole exponent by squaring, a third of the work; h is used up.

    Bases below `least` count as 0.  Two bits of the exponent at a time, the highest first."""
    place = 6
    while place > 0 and not exponent >> place:
        place -= 2
    digit = exponent >> place
    for i in range(n):
        x = f4(1) - h[i]
        x = x if x > least else f4(0)
        h[i] = x
        s[i] = x * x if digit > 1 else x
    if digit == 3:
        for i in range(n):
            s[i] *= h[i]
    while place > 0:
        place -= 2
        digit = (exponent >> place) & 3
        if digit == 0:
            for i in range(n):
                x = s[i] * s[i]
                s[i] = x * x
        elif digit == 1:
            for i in range(n):
                x = s[i] * s[i]
                s[i] = x * x * h[i]
        elif digit == 2:
            for i in range(n):
                x = s[i] * s[i] * h[i]
                s[i] = x * x
        else:
            for i in range(n):
                x = s[i] * s[i] * h[i]
                s[i] = x * x * h[i]
    for i in range(n):
        s[i] *= front[i]


@kernel(noalias=True)
def put(n, e, red, green, blue, r, g, b):
    for i in range(n):
        r[i] = e[i] * red
        g[i] = e[i] * green
        b[i] = e[i] * blue


@kernel(noalias=True)
def add(n, e, red, green, blue, r, g, b):
    for i in range(n):
        r[i] += e[i] * red
        g[i] += e[i] * green
        b[i] += e[i] * blue


@kernel(noalias=True)
def add_both(n, e, red, green, blue, s, glow_r, glow_g, glow_b, r, g, b, x, y, z):
    for i in range(n):
        r[i] += e[i] * red
        g[i] += e[i] * green
        b[i] += e[i] * blue
        x[i] += s[i] * glow_r
        y[i] += s[i] * glow_g
        z[i] += s[i] * glow_b


@kernel(noalias=True)
def write_diffuse(m, e, red, green, blue, albedo, out):
    for i in range(m):
        k = e[i]
        r = albedo[3 * i]
        g = albedo[3 * i + 1]
        b = albedo[3 * i + 2]
        # A layer never carries NaN or infinity, whatever the albedo holds.
        out[3 * i] = r * k * red if abs(r) < f4(1e30) else f4(0)
        out[3 * i + 1] = g * k * green if abs(g) < f4(1e30) else f4(0)
        out[3 * i + 2] = b * k * blue if abs(b) < f4(1e30) else f4(0)


@kernel(noalias=True)
def write_specular(m, s, red, green, blue, out):
    for i in range(m):
        out[3 * i] = s[i] * red
        out[3 * i + 1] = s[i] * green
        out[3 * i + 2] = s[i] * blue


@kernel(noalias=True)
def write_beauty(m, plate, albedo, gain_r, gain_g, gain_b, dr, dg, db, sr, sg, sb, out):
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


@kernel(noalias=True)
def write_relit_plate(m, plate, gain_r, gain_g, gain_b, dr, dg, db, sr, sg, sb, out):
    """`write_beauty` where the plate is its own albedo: one picture less to read."""
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


@kernel(noalias=True)
def add_to_picture(m, albedo, dr, dg, db, sr, sg, sb, out):
    for i in range(m):
        r = albedo[3 * i]
        g = albedo[3 * i + 1]
        b = albedo[3 * i + 2]
        r = r * dr[i] if abs(r) < f4(1e30) else f4(0)
        g = g * dg[i] if abs(g) < f4(1e30) else f4(0)
        b = b * db[i] if abs(b) < f4(1e30) else f4(0)
        out[3 * i] += r + sr[i]
        out[3 * i + 1] += g + sg[i]
        out[3 * i + 2] += b + sb[i]


@kernel(noalias=True)
def padded(source, room):
    """The last few values of a row at the head of `room`, which is longer; what stands behind them does not matter."""
    for i in range(source.shape[0]):
        room[i] = source[i]
    return room
