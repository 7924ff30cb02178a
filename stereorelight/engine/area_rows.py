"""Leaf loops for lights with a size, for GGX and for the rim: beside light_rows.py, and entered only where a light asks for them.

Rows are float32 of whole vectors.  Frame: scene frame of the camera, metres.  `front` is what a white card turned to the light
would read, 0 where the light does not reach the surface's front; `tx2, ty2` are the squared tangents of half the light's
half-angle in two directions, 0 for a point.
Sources: sphere over a horizon: Snyder, Area light sources for real-time graphics (1996); rectangle: Lambert's edge integral;
representative points of GGX: Karis, Real Shading in Unreal Engine 4 (2013), here with the energy of the lobe over the light's disc
in closed form; GGX: Walter et al. (2007) with height-correlated Smith (Heitz 2014)."""

from __future__ import annotations

import math

from stereorelight.engine.fastmath import angle_of_chord, f4, i4, kernel, power_below_one

# As in light_rows.py: this file must change whenever fastmath.py does.
FASTMATH = "66c93d0f0531acee"
NODES = 64  # of the table of a GGX lobe's own albedo, over the square root of N.V

_NEAREST2 = f4(1e-4)  # light_rows.NEAREST_M squared
_PI = f4(math.pi)
_PER_PI = f4(1 / math.pi)
_LEAST_NV = f4(1e-3)
_SMALL = f4(2e-6)  # squared size over squared distance from where on a rectangle is a point that faces its way


@kernel(inline="always")
def _over_atan(s, s2):
    """s - atan(s) for 0 <= s <= 1, relative error 2e-7 also where it is tiny."""
    p = f4(-0.06241743456) + s2 * (f4(0.0358845727) + s2 * (f4(-0.01357253375) + s2 * f4(0.002415284299)))
    p = f4(0.3333332963) + s2 * (f4(-0.1999965095) + s2 * (f4(0.142775829) + s2 * (f4(-0.1102921773) + s2 * (f4(0.08647153599) + s2 * p))))
    return s * s2 * p


@kernel(noalias=True)
def any_of(m, row):
    found = f4(0)
    for i in range(m):
        found += f4(1) if row[i] > f4(0) else f4(0)
    return found > f4(0)


@kernel(noalias=True)
def through_cover(m, cover, lit):
    for i in range(m):
        lit[i] = lit[i] * cover[i] if cover[i] > f4(0) else f4(0)


@kernel(noalias=True)
def towards(n, lx, ly, lz, w, ws, wo, a0, a1, a2, px, py, pz, nx, ny, nz, lit, ax, ay, az, e, front):
    """A light without size: the unit vector to it, Lambert, and the strength in front of the surface."""
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
        ax[i] = a
        ay[i] = b
        az[i] = c
        e[i] = k * strength
        front[i] = strength if nl > f4(0) else f4(0)


@kernel(noalias=True)
def sphere(n, lx, ly, lz, radius, px, py, pz, nx, ny, nz, lit, e):
    """A ball of light: the exact form factor, cut at the horizon."""
    radius2 = radius * radius
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        r = f4(1) / math.sqrt(d2 if d2 > f4(1e-12) else f4(1e-12))
        far2 = d2 if d2 > radius2 else radius2
        far2 = far2 if far2 > _NEAREST2 else _NEAREST2
        sin2 = radius2 / far2
        sin2 = sin2 if sin2 > f4(1e-12) else f4(1e-12)
        sin2 = sin2 if sin2 < f4(1) else f4(1)
        cos = (nx[i] * a + ny[i] * b + nz[i] * c) * r
        cos = cos if cos < f4(1) else f4(1)
        cos = cos if cos > f4(-1) else f4(-1)
        # y: how far the horizon cuts into the ball's disc, -1 not at all, 1 all of it.
        x = math.sqrt(f4(1) / sin2 - f4(1))
        up2 = f4(1) - cos * cos
        up = math.sqrt(up2 if up2 > f4(1e-12) else f4(1e-12))
        y = -x * cos / up
        y = y if y > f4(-1) else f4(-1)
        y = y if y < f4(1) else f4(1)
        w = up * math.sqrt(f4(1) - y * y)
        t = w / (x if x > f4(1e-6) else f4(1e-6))
        steep = t > f4(1)
        s = f4(1) / t if steep else t
        over = _over_atan(s, s * s)
        # atan(t) / sin^2 - x w, by whichever form does not cancel.
        rest = (f4(0.5) * _PI - (s - over)) / sin2 - x * w if steep else t - over / sin2
        g = (cos * angle_of_chord(f4(2) - f4(2) * y) + rest) * _PER_PI
        g = g if g > f4(0) else f4(0)
        e[i] = g * (lit[i] / far2)


@kernel(noalias=True)
def sphere_point(n, lx, ly, lz, radius, px, py, pz, nx, ny, nz, vx, vy, vz, lit, ax, ay, az, front, t2):
    """For GGX: the point of a ball of light that is nearest to the mirrored view."""
    radius2 = radius * radius
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        inside = d2 <= radius2
        far2 = d2 if d2 > radius2 else radius2
        far2 = far2 if far2 > _NEAREST2 else _NEAREST2
        sin2 = radius2 / far2
        sin2 = sin2 if sin2 > f4(1e-12) else f4(1e-12)
        sin2 = sin2 if sin2 < f4(1) else f4(1)
        nv = f4(2) * (nx[i] * vx[i] + ny[i] * vy[i] + nz[i] * vz[i])
        rx = nv * nx[i] - vx[i]
        ry = nv * ny[i] - vy[i]
        rz = nv * nz[i] - vz[i]
        along = a * rx + b * ry + c * rz
        ux = along * rx - a
        uy = along * ry - b
        uz = along * rz - c
        u2 = ux * ux + uy * uy + uz * uz
        k = radius / math.sqrt(u2 if u2 > f4(1e-20) else f4(1e-20))
        k = k if k < f4(1) else f4(1)
        a = rx if inside else a + k * ux
        b = ry if inside else b + k * uy
        c = rz if inside else c + k * uz
        q2 = a * a + b * b + c * c
        r = f4(1) / math.sqrt(q2 if q2 > f4(1e-12) else f4(1e-12))
        ax[i] = a * r
        ay[i] = b * r
        az[i] = c * r
        front[i] = lit[i] / far2 if nx[i] * a + ny[i] * b + nz[i] * c > f4(0) else f4(0)
        k = f4(1) + math.sqrt(f4(1) - sin2)
        t2[i] = sin2 / (k * k)


@kernel(inline="always")
def _edge(px, py, pz, qx, qy, qz, nx, ny, nz):
    """One term of Lambert's sum: the angle from p to q, times the cosine between N and the normal of their plane."""
    ex = qx - px
    ey = qy - py
    ez = qz - pz
    cx = py * ez - pz * ey
    cy = pz * ex - px * ez
    cz = px * ey - py * ex
    s = math.sqrt(cx * cx + cy * cy + cz * cz)
    c = px * qx + py * qy + pz * qz
    size = abs(c)
    steep = s > size
    most = s if steep else size
    most = most if most > f4(1e-30) else f4(1e-30)
    z = (size if steep else s) / most
    angle = z - _over_atan(z, z * z)
    angle = f4(0.5) * _PI - angle if steep else angle
    angle = _PI - angle if c < f4(0) else angle
    return angle * (cx * nx + cy * ny + cz * nz) / (s if s > f4(1e-30) else f4(1e30))


@kernel(inline="always")
def _clipped(a, b, c, h0, ux, uy, uz, hu, wx, wy, wz, hw, half_w, half_h, su, sw, tu, tw, X, Y, Z):
    """Lambert's term of the side between the corners (su, sw) and (tu, tw), what lies below the horizon cut off; where it leaves
    the horizon, and where it enters, 0 where it does not."""
    sx = a + su * half_w * ux + sw * half_h * wx
    sy = b + su * half_w * uy + sw * half_h * wy
    sz = c + su * half_w * uz + sw * half_h * wz
    tx = a + tu * half_w * ux + tw * half_h * wx
    ty = b + tu * half_w * uy + tw * half_h * wy
    tz = c + tu * half_w * uz + tw * half_h * wz
    hs = h0 + su * hu + sw * hw
    ht = h0 + tu * hu + tw * hw
    above_s = hs > f4(0)
    above_t = ht > f4(0)
    leaves = above_s & (ht <= f4(0))
    enters = above_t & (hs <= f4(0))
    k = hs / (hs - ht if leaves | enters else f4(1))
    cx = sx + k * (tx - sx)
    cy = sy + k * (ty - sy)
    cz = sz + k * (tz - sz)
    sx = cx if enters else sx
    sy = cy if enters else sy
    sz = cz if enters else sz
    tx = cx if leaves else tx
    ty = cy if leaves else ty
    tz = cz if leaves else tz
    term = _edge(sx, sy, sz, tx, ty, tz, X, Y, Z)
    return (
        term if above_s | above_t else f4(0),
        cx if leaves else f4(0),
        cy if leaves else f4(0),
        cz if leaves else f4(0),
        cx if enters else f4(0),
        cy if enters else f4(0),
        cz if enters else f4(0),
    )


@kernel(noalias=True)
def rectangle(n, lx, ly, lz, mx, my, mz, ux, uy, uz, wx, wy, wz, half_w, half_h, px, py, pz, nx, ny, nz, lit, e):
    """A rectangle that shines along m: the exact form factor, cut at the horizon.

    u, w : unit vectors along its sides."""
    area = f4(4) * half_w * half_h
    size2 = f4(4) * (half_w * half_w + half_h * half_h)
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        X = nx[i]
        Y = ny[i]
        Z = nz[i]
        d2 = a * a + b * b + c * c
        d2 = d2 if d2 > _NEAREST2 else _NEAREST2
        ahead = -(a * mx + b * my + c * mz)  # metres in front of the rectangle
        # Corners from the surface, and their heights above its horizon.
        h0 = X * a + Y * b + Z * c
        hu = half_w * (X * ux + Y * uy + Z * uz)
        hw = half_h * (X * wx + Y * wy + Z * wz)
        e0, ox0, oy0, oz0, ix0, iy0, iz0 = _clipped(a, b, c, h0, ux, uy, uz, hu, wx, wy, wz, hw, half_w, half_h, f4(1), f4(1), f4(-1), f4(1), X, Y, Z)
        e1, ox1, oy1, oz1, ix1, iy1, iz1 = _clipped(
            a, b, c, h0, ux, uy, uz, hu, wx, wy, wz, hw, half_w, half_h, f4(-1), f4(1), f4(-1), f4(-1), X, Y, Z
        )
        e2, ox2, oy2, oz2, ix2, iy2, iz2 = _clipped(
            a, b, c, h0, ux, uy, uz, hu, wx, wy, wz, hw, half_w, half_h, f4(-1), f4(-1), f4(1), f4(-1), X, Y, Z
        )
        e3, ox3, oy3, oz3, ix3, iy3, iz3 = _clipped(a, b, c, h0, ux, uy, uz, hu, wx, wy, wz, hw, half_w, half_h, f4(1), f4(-1), f4(1), f4(1), X, Y, Z)
        # At most one side leaves the horizon and one enters it; between the two runs a side along the horizon.
        total = (e0 + e1) + (e2 + e3)
        out_x, out_y, out_z = ox0 + ox1 + ox2 + ox3, oy0 + oy1 + oy2 + oy3, oz0 + oz1 + oz2 + oz3
        in_x, in_y, in_z = ix0 + ix1 + ix2 + ix3, iy0 + iy1 + iy2 + iy3, iz0 + iz1 + iz2 + iz3
        total += _edge(out_x, out_y, out_z, in_x, in_y, in_z, X, Y, Z)
        r = f4(1) / math.sqrt(d2)
        cos = ahead * r
        cos = cos if cos > f4(0) else f4(0)
        nl = h0 * r
        point = (nl if nl > f4(0) else f4(0)) * cos / d2
        near = f4(0.5) * total / area
        near = near if near > f4(0) else f4(0)
        near = point if size2 < _SMALL * d2 else near
        e[i] = near * lit[i] if ahead > f4(0) else f4(0)


@kernel(noalias=True)
def rectangle_point(
    n, lx, ly, lz, mx, my, mz, ux, uy, uz, wx, wy, wz, half_w, half_h, px, py, pz, nx, ny, nz, vx, vy, vz, lit, ax, ay, az, front, tx2, ty2
):
    """For GGX: the point of a rectangle that is nearest to the mirrored view."""
    area = f4(4) * half_w * half_h
    wide = half_w / half_h
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        X = nx[i]
        Y = ny[i]
        Z = nz[i]
        d2 = a * a + b * b + c * c
        d2 = d2 if d2 > _NEAREST2 else _NEAREST2
        ahead = -(a * mx + b * my + c * mz)
        cos = ahead / math.sqrt(d2)
        cos = cos if cos > f4(0) else f4(0)
        nv = f4(2) * (X * vx[i] + Y * vy[i] + Z * vz[i])
        rx = nv * X - vx[i]
        ry = nv * Y - vy[i]
        rz = nv * Z - vz[i]
        down = -(rx * mx + ry * my + rz * mz)
        k = ahead / (down if down > f4(0.02) else f4(0.02))  # a view that misses the plane looks far along it
        rx = k * rx - a
        ry = k * ry - b
        rz = k * rz - c
        gu = rx * ux + ry * uy + rz * uz
        gu = gu if gu < half_w else half_w
        gu = gu if gu > -half_w else -half_w
        gw = rx * wx + ry * wy + rz * wz
        gw = gw if gw < half_h else half_h
        gw = gw if gw > -half_h else -half_h
        a = a + gu * ux + gw * wx
        b = b + gu * uy + gw * wy
        c = c + gu * uz + gw * wz
        q2 = a * a + b * b + c * c
        r = f4(1) / math.sqrt(q2 if q2 > f4(1e-12) else f4(1e-12))
        ax[i] = a * r
        ay[i] = b * r
        az[i] = c * r
        # Its share of all directions, rounded where the rectangle is near; exact within 3 % head on.
        share = area * cos / (d2 + f4(0.24) * area) * (f4(0.25) * _PER_PI)
        t2 = share / (f4(1) - share)
        tx2[i] = t2 * wide
        ty2[i] = t2 / wide
        reaches = (X * a + Y * b + Z * c > f4(0)) & (ahead > f4(0))
        front[i] = f4(4) * _PI * share / area / (f4(1) + t2) * lit[i] if reaches else f4(0)


@kernel(noalias=True)
def ggx_towards(n, alpha2, f0, ior, glow, nx, ny, nz, vx, vy, vz, ax, ay, az, front, sized, tx2, ty2, s):
    """pi D V F N.L, times what bounces between the facets add.

    ior  : 0 takes Schlick's Fresnel from f0, else the exact one of a dielectric.
    glow : (NODES,) (1 - E) / E, E the lobe's albedo without Fresnel, over sqrt(N.V)."""
    last = f4(NODES - 1)
    for i in range(n):
        nv = nx[i] * vx[i] + ny[i] * vy[i] + nz[i] * vz[i]
        nv = nv if nv > _LEAST_NV else _LEAST_NV
        nv = nv if nv < f4(1) else f4(1)
        nl = nx[i] * ax[i] + ny[i] * ay[i] + nz[i] * az[i]
        nl = nl if nl > f4(0) else f4(0)
        a = ax[i] + vx[i]
        b = ay[i] + vy[i]
        c = az[i] + vz[i]
        h2 = a * a + b * b + c * c
        h2 = h2 if h2 > f4(1e-12) else f4(1e-12)
        cx = ny[i] * c - nz[i] * b
        cy = nz[i] * a - nx[i] * c
        cz = nx[i] * b - ny[i] * a
        nh = nx[i] * a + ny[i] * b + nz[i] * c
        # cos^2 alpha^2 + sin^2: the sine from the cross product, since near the highlight 1 - cos^2 has lost its digits.
        den = (nh * nh * alpha2 + cx * cx + cy * cy + cz * cz) / h2
        den = den if den > f4(1e-12) else f4(1e-12)
        smith = nl * math.sqrt(nv * nv * (f4(1) - alpha2) + alpha2) + nv * math.sqrt(nl * nl * (f4(1) - alpha2) + alpha2)
        vh = f4(0.5) * math.sqrt(h2)
        vh = vh if vh < f4(1) else f4(1)
        u = f4(1) - vh
        u2 = u * u
        fresnel = f0 + (f4(1) - f0) * (u2 * u2 * u)
        g2 = ior * ior - f4(1) + vh * vh
        g = math.sqrt(g2 if g2 > f4(0) else f4(0))
        x = (g - vh) / (g + vh)
        y = (vh * (g + vh) - f4(1)) / (vh * (g - vh) + f4(1))
        exact = f4(0.5) * x * x * (f4(1) + y * y) if g2 > f4(0) else f4(1)
        fresnel = exact if ior > f4(0) else fresnel
        t = math.sqrt(nv) * last
        j = i4(t)
        j = j if j < i4(NODES - 2) else i4(NODES - 2)
        t = t - f4(j)
        more = glow[j] + t * (glow[j + 1] - glow[j])
        s[i] = front[i] * nl * (alpha2 / (den * den)) * (f4(0.5) / smith) * fresnel * (f4(1) + f0 * more)
    if sized:
        for i in range(n):
            k = f4(1) + math.sqrt(tx2[i] * ty2[i])
            s[i] = s[i] * (k * k) * alpha2 / math.sqrt((alpha2 + tx2[i]) * (alpha2 + ty2[i]))


@kernel(noalias=True)
def rim(n, power, nx, ny, nz, vx, vy, vz, e, s):
    """(1 - N.V)^power of the diffuse strength."""
    for i in range(n):
        nv = nx[i] * vx[i] + ny[i] * vy[i] + nz[i] * vz[i]
        s[i] = e[i] * power_below_one(nv if nv > f4(0) else f4(0), power)


@kernel(fastmath=False, noalias=True)  # fused multiply and add in whole vectors alone would give the last pixels of a row other bits
def add_diffuse(m, e, red, green, blue, albedo, out):
    """light_rows.write_diffuse on top of what is there."""
    for i in range(m):
        k = e[i]
        r = albedo[3 * i]
        g = albedo[3 * i + 1]
        b = albedo[3 * i + 2]
        out[3 * i] += r * k * red if abs(r) < f4(1e30) else f4(0)
        out[3 * i + 1] += g * k * green if abs(g) < f4(1e30) else f4(0)
        out[3 * i + 2] += b * k * blue if abs(b) < f4(1e30) else f4(0)


@kernel(fastmath=False, noalias=True)  # fused multiply and add in whole vectors alone would give the last pixels of a row other bits
def add_specular(m, s, red, green, blue, out):
    for i in range(m):
        out[3 * i] += s[i] * red
        out[3 * i + 1] += s[i] * green
        out[3 * i + 2] += s[i] * blue
