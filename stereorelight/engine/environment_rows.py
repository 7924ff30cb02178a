"""The leaf loops of the environment kernel: one step over one strip of a row, each row its own argument.

Rows are float32 of whole vectors; pictures are flat (three values a pixel).  Frame: scene frame of the camera, metres.
Pixels without P or N are marked 0 in `known` and made harmless.
A lat-long table has a ghost texel on every side (engine/environment.py), so that seams and poles need no test."""

from __future__ import annotations

import math

from stereorelight.engine.environment_vector import look_up, look_up_between, write_on_albedo, write_tinted
from stereorelight.engine.fastmath import f4, floor, i4, kernel

# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever these two do;
# tests/test_light_environment.py holds them together.
FASTMATH = "66c93d0f0531acee"
VECTOR4 = "dcc64f8d6e04ddfd"

_FARTHEST2 = f4(1e30)  # square of what no scene reaches; beyond it, and NaN, is missing
_PER_TURN = f4(0.15915494309189535)


@kernel(inline="always")
def angle(y, x):
    """atan2(y, x), within 3e-7: Abramowitz and Stegun 4.4.49.  0 for (0, 0)."""
    ax, ay = abs(x), abs(y)
    most = ax if ax > ay else ay
    least = ay if ax > ay else ax
    a = least / (most + f4(1e-35))
    s = a * a
    p = s * (f4(-0.0161657367) + s * f4(0.0028662257))
    p = s * (f4(0.1065626393) + s * (f4(-0.0752896400) + s * f4(0.0429096138) + p * s))
    p = a + a * s * (f4(-0.3333314528) + s * (f4(0.1999355085) + s * f4(-0.1420889944) + p * s))
    p = f4(1.5707963267948966) - p if ay > ax else p
    p = f4(3.141592653589793) - p if x < f4(0) else p
    return -p if y < f4(0) else p


@kernel()
def surface(n, P, N, nx, ny, nz, vx, vy, vz, known):
    """Unit N and V = normalize(-P)."""
    for i in range(n):
        x = P[3 * i]
        y = P[3 * i + 1]
        z = P[3 * i + 2]
        a = N[3 * i]
        b = N[3 * i + 1]
        c = N[3 * i + 2]
        p2 = x * x + y * y + z * z
        n2 = a * a + b * b + c * c
        good = (p2 > f4(1e-20)) & (p2 < _FARTHEST2) & (n2 > f4(0.25)) & (n2 < f4(4))
        r = f4(-1) / math.sqrt(p2)
        s = f4(1) / math.sqrt(n2)
        nx[i] = a * s if good else f4(0)
        ny[i] = b * s if good else f4(0)
        nz[i] = c * s if good else f4(1)
        vx[i] = x * r if good else f4(0)
        vy[i] = y * r if good else f4(0)
        vz[i] = z * r if good else f4(1)
        known[i] = f4(1) if good else f4(0)


@kernel()
def through_matte(m, matte, known):
    for i in range(m):
        known[i] = known[i] * matte[i] if matte[i] > f4(0) else f4(0)


@kernel()
def fresnel(n, ior, mixed, nx, ny, nz, vx, vy, vz, known, cosine, g, back, through):
    """How much is sent back and let through, and what refraction needs: |N.V| with N's sign, and g = ior cos(refracted).

    Exact for a dielectric, both polarisations averaged (Cook and Torrance 1982, equation for F by c and g); g < 0 marks total reflection."""
    for i in range(n):
        nv = nx[i] * vx[i] + ny[i] * vy[i] + nz[i] * vz[i]
        c = abs(nv)
        c = c if c < f4(1) else f4(1)
        step = (ior - f4(1)) * (ior + f4(1))
        g2 = step + c * c
        total = g2 < f4(0)
        w = math.sqrt(f4(0) if total else g2)
        sum_ = w + c + f4(1e-12)
        a = step / (sum_ * sum_)  # (g - c) / (g + c), without its cancellation
        less = step / sum_
        b = (c * (w + c) - f4(1)) / (c * less + f4(1))
        F = f4(0.5) * a * a * (f4(1) + b * b)
        F = min(F, f4(1))
        F = f4(1) if total else F
        cosine[i] = nv
        g[i] = f4(-1) if total else w
        back[i] = known[i] * (F if mixed else f4(1))
        passed = f4(1) - F if mixed else f4(1)
        through[i] = f4(0) if total else known[i] * passed


@kernel()
def mirrored(n, nx, ny, nz, vx, vy, vz, cosine, x, y, z):
    """R = 2 (N.V) N - V, the same for N and -N."""
    for i in range(n):
        k = cosine[i] + cosine[i]
        x[i] = k * nx[i] - vx[i]
        y[i] = k * ny[i] - vy[i]
        z[i] = k * nz[i] - vz[i]


@kernel()
def refracted(n, per_ior, nx, ny, nz, vx, vy, vz, cosine, g, x, y, z):
    """T = (-V + (c - g) N) / ior, N turned towards the eye."""
    for i in range(n):
        c = cosine[i]
        k = abs(c) - (g[i] if g[i] > f4(0) else f4(0))
        k = k if c >= f4(0) else -k
        x[i] = (k * nx[i] - vx[i]) * per_ior
        y[i] = (k * ny[i] - vy[i]) * per_ior
        z[i] = (k * nz[i] - vz[i]) * per_ior


@kernel()
def latlong(n, a0, a1, a2, b0, b1, b2, c0, c1, c2, x, y, z, azimuth, polar):
    """Turned directions as fractions: azimuth 0..1 from left to right (-z in the middle, +x right of it), polar 0..1 from +y down."""
    for i in range(n):
        a = a0 * x[i] + a1 * y[i] + a2 * z[i]
        b = b0 * x[i] + b1 * y[i] + b2 * z[i]
        c = c0 * x[i] + c1 * y[i] + c2 * z[i]
        azimuth[i] = angle(a, -c) * _PER_TURN + f4(0.5)
        polar[i] = angle(math.sqrt(a * a + c * c), b) * (_PER_TURN + _PER_TURN)


@kernel()
def texels(n, w, h, azimuth, polar, j, p, q):
    """Upper left one of the four texels round each direction, in a table with ghosts, and the fractions between them."""
    wide, high, stride = f4(w), f4(h), w + i4(2)
    for i in range(n):
        u = azimuth[i] * wide + f4(0.5)
        v = polar[i] * high + f4(0.5)
        uf = floor(u)
        vf = floor(v)
        uf = uf if uf < wide else wide
        uf = uf if uf > f4(0) else f4(0)
        vf = vf if vf < high else high
        vf = vf if vf > f4(0) else f4(0)
        p[i] = u - uf
        q[i] = v - vf
        j[i] = i4(4) * (i4(vf) * stride + i4(uf))


@kernel()
def fetch(n, table, w, j, p, q, out):
    stride = i4(4) * (w + i4(2))
    for i in range(n):
        look_up(table, j[i], stride, p[i], q[i], out, 4 * i)


@kernel()
def fetch_between(n, table, w, t, j, p, q, out):
    stride = i4(4) * (w + i4(2))
    for i in range(n):
        look_up_between(table, j[i], stride, p[i], q[i], t, out, 4 * i)


@kernel()
def write(m, found, k, red, green, blue, out):
    for i in range(m - 1):
        write_tinted(found, 4 * i, k[i], red, green, blue, out, 3 * i, 0)
    write_tinted(found, 4 * (m - 1), k[m - 1], red, green, blue, out, 3 * (m - 1), 1)


@kernel()
def write_lit(m, found, k, red, green, blue, albedo, out):
    for i in range(m - 1):
        write_on_albedo(found, 4 * i, k[i], red, green, blue, albedo, out, 3 * i, 0)
    write_on_albedo(found, 4 * (m - 1), k[m - 1], red, green, blue, albedo, out, 3 * (m - 1), 1)


@kernel()
def behind(m, thickness, P, x, y, z, through, out):
    """Where the refracted ray is `thickness` metres on, as slopes right and down of the eye's axis; 0 weight behind the eye."""
    for i in range(m):
        px = P[3 * i] if through[i] > f4(0) else f4(0)
        py = P[3 * i + 1] if through[i] > f4(0) else f4(0)
        pz = P[3 * i + 2] if through[i] > f4(0) else f4(-1)
        depth = -(pz + thickness * z[i])
        seen = depth > f4(1e-6)
        r = f4(1) / (depth if seen else f4(1))
        out[3 * i] = (px + thickness * x[i]) * r if seen else f4(0)
        out[3 * i + 1] = -(py + thickness * y[i]) * r if seen else f4(0)
        out[3 * i + 2] = through[i] if seen else f4(0)


@kernel()
def plate_texels(m, wide, high, stride, at, j, p, q, k):
    """Pixels (u, v) and a weight, as `behind` laid them out, to texels of a picture; held to its edges; no number has no weight."""
    for i in range(m):
        u = at[3 * i]
        v = at[3 * i + 1]
        good = (abs(u) < f4(1e9)) & (abs(v) < f4(1e9))
        u = u if good else f4(0)
        v = v if good else f4(0)
        k[i] = at[3 * i + 2] if good else f4(0)
        u = u if u > f4(0) else f4(0)
        v = v if v > f4(0) else f4(0)
        u = u if u < wide else wide
        v = v if v < high else high
        uf = floor(u)
        vf = floor(v)
        p[i] = u - uf
        q[i] = v - vf
        j[i] = i4(4) * (i4(vf) * stride + i4(uf))


@kernel()
def copied(n, source, room):
    """A row's last pixels at the head of `room`, which is longer."""
    for i in range(n):
        room[i] = source[i]
    return room
