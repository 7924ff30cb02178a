"""The leaf loops of the march: rays of one strip of a row from the surface to a light, and in the picture.

Rows are separate float32 arrays; P, N flat (three values a pixel).  Frame: scene frame of the camera (x right, y up, the camera looks
down -z), metres; pictures in pixels of the grid, inverse depth in 1 / metres."""

from __future__ import annotations

import math

from stereorelight.engine.fastmath import f4, kernel

# As `march.LEAVES`, of fastmath.py.
FASTMATH = "66c93d0f0531acee"
FAINT = 1e-6  # what a sample counts for that N turns away from, by less than N is known


@kernel(noalias=True)
def targets(n, oa, ob, q, px, py, pz, nx, ny, nz, lift, sx, sy, sz, lx, ly, lz, far, weight):
    """Where the rays start, the unit way to the light's sample, how far it is, and how much it counts for.

    By its cosine; and by next to nothing where that is between q[15] and 0."""
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
        shown = shining if q[14] > f4(0) else f4(1)
        w = front * shown
        least = f4(FAINT) * shown if front > q[15] else f4(0)
        sx[i] = ox
        sy[i] = -oy
        sz[i] = -oz if oz < f4(-1e-6) else f4(1e-6)
        lx[i] = tx
        ly[i] = -ty
        lz[i] = -tz
        far[i] = f4(1) / r if q[3] > f4(0) else f4(1e9)
        weight[i] = w if w > least else least


@kernel(noalias=True)
def straight(n, lx_, ly_, lz_, w, turned, px, py, pz, nx, ny, nz, lift, sx, sy, sz, lx, ly, lz, far, weight):
    """`targets` of a light without a size."""
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
        least = f4(FAINT) if front > turned else f4(0)
        weight[i] = front if front > least else least


@kernel(noalias=True)
def rays(n, fx, fy, cx, cy, width, height, near, sx, sy, sz, lx, ly, lz, far, half, weight, u, v, k, du, dv, dk, pixels, lost, lit):
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
        pixels[i] = abs(a) + abs(b)
        lost[i] = f4(1) if (share < f4(1)) & good else f4(0)
        lit[i] = f4(1) if good else f4(0)


@kernel(noalias=True)
def idle(n, end, u, v, k, du, dv, dk, lit):
    """Rays n..end, which fill a block up, go nowhere."""
    for i in range(n, end):
        u[i] = f4(1.5)
        v[i] = f4(1.5)
        k[i] = f4(1)
        du[i] = f4(0)
        dv[i] = f4(0)
        dk[i] = f4(0)
        lit[i] = f4(0)


@kernel(noalias=True)
def gather(n, nearest, k, dk, lost, lit, hidden, weight, shone, doubt, total):
    """Add a sample up.  A ray that left the frame before it was nearer than the nearest things may have met something outside it."""
    for i in range(n):
        outside = lost[i] if k[i] + dk[i] < nearest else f4(0)
        unknown = hidden[i] if hidden[i] > outside else outside
        w = weight[i]
        shone[i] += w * lit[i]
        doubt[i] += w * lit[i] * unknown
        total[i] += w


@kernel(noalias=True)
def shares(n, shone, doubt, total, lit, unknown):
    for i in range(n):
        per = f4(1) / total[i] if total[i] > f4(0) else f4(0)
        lit[i] = shone[i] * per
        unknown[i] = doubt[i] * per


@kernel(noalias=True)
def split(n, P, N, lift, px, py, pz, nx, ny, nz):
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
