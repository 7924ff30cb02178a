"""Leaf loops for the Phong highlight of a ball of light, beside lobe_rows.py, whose header says what is summed and how.

The ball fills a cone of half-angle sigma about a, the way to its centre; r is gamma away from a.  Its outline is a circle: at the angle t
about a, from where it is nearest to r, c = 1 - gap - rise sin(t / 2)^2 with gap = 1 - cos(sigma - gamma) and rise = 2 sin(sigma) sin(gamma).
Where the horizon of N cuts into it, an arc of the circle and a piece of the horizon are its outline."""

from __future__ import annotations

import math

from stereorelight.engine import lobe_rows as lobe
from stereorelight.engine.fastmath import f4, kernel, power_below_one
from stereorelight.engine.lobe_rows import W0, W1, W2, W3, X0, X1, X2, X3, angle_of, cosine_of, missing, sine_of

# As in light_rows.py: this file must change whenever lobe_rows.py does, and with it fastmath.py.
LOBES = "ece0089b1381920f"
_PI = f4(math.pi)
# INSIDE goes by three rings, and by four places on half of each, which stand for both halves.
RINGS = ((0.1127016653792583, 5 / 18), (0.5, 8 / 18), (0.8872983346207417, 5 / 18))
_C0, _C1 = math.cos(math.pi / 8), math.cos(3 * math.pi / 8)
COSINES = (_C0, _C1, -_C1, -_C0)
_AWAY = f4(0.5)  # gap m from where on the lobe is no more than a correction on the circle
_WIDTH, _WIDTH_AWAY = f4(12), f4(4)  # found by trial


@kernel(forceinline=True)
def _cone(lx, ly, lz, radius, px, py, pz, rx, ry, rz):
    """a; sin and cos of sigma; cos gamma, sin gamma, and 1 - cos gamma; squared distance, of the surface itself for a place inside the ball."""
    a = lx - px
    b = ly - py
    c = lz - pz
    d2 = a * a + b * b + c * c
    r = f4(1) / math.sqrt(d2 if d2 > f4(1e-12) else f4(1e-12))
    a *= r
    b *= r
    c *= r
    d2 = d2 if d2 > radius * radius else radius * radius
    ss = radius / math.sqrt(d2)
    ss = ss if ss < f4(1) else f4(1)
    cs = math.sqrt(f4(1) - ss * ss)
    x = rx - a
    y = ry - b
    z = rz - c
    far = f4(0.5) * (x * x + y * y + z * z)
    far = far if far < f4(2) else f4(2)
    return a, b, c, ss, cs, f4(1) - far, math.sqrt(far * (f4(2) - far)), far, d2


@kernel(noalias=True)
def add_ring(n, exponent, at, share, lx, ly, lz, radius, px, py, pz, rx, ry, rz, s):
    """What one ring inside the ball adds; `at` is where between its middle and its rim, by area."""
    for i in range(n):
        _, _, _, ss, cs, _, sg, far, d2 = _cone(lx, ly, lz, radius, px[i], py[i], pz[i], rx[i], ry[i], rz[i])
        low = at * ss * ss / (f4(1) + cs)  # 1 - the cosine of the ring
        side = math.sqrt(low * (f4(2) - low)) * sg
        base = far * (f4(1) - low) + low
        total = power_below_one(base - f4(COSINES[0]) * side, exponent) + power_below_one(base - f4(COSINES[1]) * side, exponent)
        total += power_below_one(base - f4(COSINES[2]) * side, exponent) + power_below_one(base - f4(COSINES[3]) * side, exponent)
        s[i] += total * (share * f4(0.5) / (d2 * (f4(1) + cs)))


@kernel(forceinline=True)
def _place(u, gap, rise, w2, m, first, more, away):
    """What is summed at one place of the circle; tan(t / 2) = w tan(u)."""
    cos_u, sin_u = cosine_of(u), sine_of(u)
    x = w2 * sin_u * sin_u
    q = cos_u * cos_u + x
    sv2 = x / q
    h = gap + rise * sv2
    h = h if h > f4(1e-9) else f4(1e-9)
    h = h if h < f4(1) else f4(1)
    lost = missing(h, m)
    return (first + more * sv2) * (lost - f4(1) if away else lost) / (h * (f4(2) - h) * q)


@kernel(forceinline=True)
def _pair(x, half, gap, rise, w2, m, first, more, away):
    return _place(half * (f4(1) - x), gap, rise, w2, m, first, more, away) + _place(half * (f4(1) + x), gap, rise, w2, m, first, more, away)


@kernel(forceinline=True)
def _azimuth(sv2, ss, cs, sg, cg):
    """Where on the circle, as an angle about r, 0..pi."""
    sin_t = f4(2) * math.sqrt(sv2 * (f4(1) - sv2))
    x = cg * ss * (f4(1) - f4(2) * sv2) - sg * cs
    angle = angle_of(ss * sin_t, abs(x))
    return _PI - angle if x < f4(0) else angle


@kernel(forceinline=True)
def _arc(cos_t, gap, rise, ss, cs, sg, cg, m):
    """The sum along the circle from t = 0 to where cos(t) is `cos_t`, t at most pi.

    Away from the lobe, (1 - c^m) / (1 - c^2) is summed as the angle about r, which is known, less what c^m adds."""
    sv2 = f4(0.5) * (f4(1) - cos_t)
    sv2 = sv2 if sv2 > f4(0) else f4(0)
    sv2 = sv2 if sv2 < f4(1) else f4(1)
    most = (f4(1) - gap) / (rise if rise > f4(1e-12) else f4(1e-12))
    most = most if most > f4(0) else f4(0)
    front = sv2 if sv2 < most else most
    away = gap * m > _AWAY
    wide = _WIDTH_AWAY / m if away else gap + _WIDTH / m
    w2 = wide / (wide + rise)
    w = math.sqrt(w2)
    half = f4(0.5) * angle_of(math.sqrt(front), w * math.sqrt(f4(1) - front))
    first = ss * (ss * cg - cs * sg)
    more = f4(2) * ss * cs * sg
    total = W0 * _pair(X0, half, gap, rise, w2, m, first, more, away) + W1 * _pair(X1, half, gap, rise, w2, m, first, more, away)
    total += W2 * _pair(X2, half, gap, rise, w2, m, first, more, away) + W3 * _pair(X3, half, gap, rise, w2, m, first, more, away)
    back = _azimuth(sv2, ss, cs, sg, cg) - _azimuth(f4(0) if away else front, ss, cs, sg, cg)
    return f4(2) * w * half * total + (back if away | (sv2 > front) else f4(0))


@kernel(noalias=True)
def add_whole(n, exponent, lx, ly, lz, radius, px, py, pz, rx, ry, rz, s):
    """The sum along the whole circle."""
    m = exponent + f4(1)
    for i in range(n):
        _, _, _, ss, cs, cg, sg, far, _ = _cone(lx, ly, lz, radius, px[i], py[i], pz[i], rx[i], ry[i], rz[i])
        rise = f4(2) * ss * sg
        gap = far * cs + ss * ss / (f4(1) + cs) - ss * sg
        gap = gap if gap > f4(0) else f4(0)
        s[i] += f4(2) * _arc(f4(-1), gap, rise, ss, cs, sg, cg, m)


@kernel(noalias=True)
def add_cut(n, exponent, lx, ly, lz, radius, px, py, pz, nx, ny, nz, rx, ry, rz, s, qx, qy, qz, fx, fy, fz):
    """The sum along the part of the circle above the horizon; q, f : the piece of the horizon that closes it, from q along f."""
    m = exponent + f4(1)
    for i in range(n):
        a, b, c, ss, cs, cg, sg, far, _ = _cone(lx, ly, lz, radius, px[i], py[i], pz[i], rx[i], ry[i], rz[i])
        rise = f4(2) * ss * sg
        gap = far * cs + ss * ss / (f4(1) + cs) - ss * sg
        gap = gap if gap > f4(0) else f4(0)
        X, Y, Z = nx[i], ny[i], nz[i]
        na = X * a + Y * b + Z * c
        # Across a, towards r; towards N where r is a.
        ex = rx[i] - cg * a
        ey = ry[i] - cg * b
        ez = rz[i] - cg * c
        along = sg > f4(1e-3)
        ex = ex if along else X - na * a
        ey = ey if along else Y - na * b
        ez = ez if along else Z - na * c
        e2 = ex * ex + ey * ey + ez * ez
        per = f4(1) / math.sqrt(e2 if e2 > f4(1e-20) else f4(1e-20))
        ex *= per
        ey *= per
        ez *= per
        gx = b * ez - c * ey
        gy = c * ex - a * ez
        gz = a * ey - b * ex
        x = X * ex + Y * ey + Z * ez
        y = X * gx + Y * gy + Z * gz
        turned = y < f4(0)  # seen in a mirror, so that the horizon's middle is at t in 0..pi
        y = abs(y)
        high = math.sqrt(x * x + y * y)
        per = f4(1) / (high if high > f4(1e-12) else f4(1e-12))
        cn = x * per if high > f4(1e-12) else f4(1)
        sn = y * per if high > f4(1e-12) else f4(0)
        cw = -cs * na / (ss * (high if high > f4(1e-12) else f4(1e-12)))
        cw = cw if cw < f4(1) else f4(1)
        cw = cw if cw > f4(-1) else f4(-1)
        sw = math.sqrt(f4(1) - cw * cw)
        cos_b = cn * cw - sn * sw
        sin_b = sn * cw + cn * sw
        cos_a = cn * cw + sn * sw
        sin_a = sn * cw - cn * sw
        whole = _arc(f4(-1), gap, rise, ss, cs, sg, cg, m)
        to = _arc(cos_b, gap, rise, ss, cs, sg, cg, m)
        since = _arc(cos_a, gap, rise, ss, cs, sg, cg, m)
        to = f4(2) * whole - to if sin_b < f4(0) else to
        since = -since if sin_a < f4(0) else since
        s[i] += to - since
        gx = -gx if turned else gx
        gy = -gy if turned else gy
        gz = -gz if turned else gz
        ux = cs * a + ss * (cos_b * ex + sin_b * gx)
        uy = cs * b + ss * (cos_b * ey + sin_b * gy)
        uz = cs * c + ss * (cos_b * ez + sin_b * gz)
        wx = cs * a + ss * (cos_a * ex + sin_a * gx)
        wy = cs * b + ss * (cos_a * ey + sin_a * gy)
        wz = cs * c + ss * (cos_a * ez + sin_a * gz)
        qx[i] = wx if turned else ux
        qy[i] = wy if turned else uy
        qz[i] = wz if turned else uz
        fx[i] = ux - wx if turned else wx - ux
        fy[i] = uy - wy if turned else wy - uy
        fz[i] = uz - wz if turned else wz - uz


@kernel()
def ball(n, exponent, lx, ly, lz, radius, px, py, pz, nx, ny, nz, vx, vy, vz, lit, rx, ry, rz, mode, s, at, room):
    """The highlight of a ball of light into s.     at : (n,) whole numbers.     room : lobe_rows.ROOM more rows."""
    PX, PY, PZ, NX, NY, NZ, RX, RY, RZ = room[0], room[1], room[2], room[3], room[4], room[5], room[6], room[7], room[8]
    qx, qy, qz, fx, fy, fz, total = room[15], room[16], room[17], room[18], room[19], room[20], room[21]
    lobe.mirrored(n, nx, ny, nz, vx, vy, vz, rx, ry, rz)
    lobe.modes(n, exponent, lx, ly, lz, radius, radius, f4(0), f4(0), f4(0), px, py, pz, nx, ny, nz, rx, ry, rz, lit, mode)
    lobe.clear(n, s)
    for way in range(3):
        asked = lobe.INSIDE if way == 0 else (lobe.OUTLINE if way == 1 else lobe.CUT)
        count = lobe.pack(n, mode, asked, asked, px, py, pz, nx, ny, nz, rx, ry, rz, at, PX, PY, PZ, NX, NY, NZ, RX, RY, RZ)
        if count == 0:
            continue
        whole = (count + lobe.VECTOR - 1) // lobe.VECTOR * lobe.VECTOR
        lobe.clear(whole, total)
        per = f4(1) / (_PI * radius * radius * (exponent + f4(1)))
        if way == 0:
            for ring in range(3):
                add_ring(whole, exponent, f4(RINGS[ring][0]), f4(RINGS[ring][1]), lx, ly, lz, radius, PX, PY, PZ, RX, RY, RZ, total)
            per = f4(1)
        elif way == 1:
            add_whole(whole, exponent, lx, ly, lz, radius, PX, PY, PZ, RX, RY, RZ, total)
        else:
            add_cut(whole, exponent, lx, ly, lz, radius, PX, PY, PZ, NX, NY, NZ, RX, RY, RZ, total, qx, qy, qz, fx, fy, fz)
            lobe.add_side(whole, exponent, qx, qy, qz, fx, fy, fz, RX, RY, RZ, total)
        lobe.unpack(count, at, total, per, lit, s)
