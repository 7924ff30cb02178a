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
def starts(n, fx, fy, cx, cy, width, height, px, py, pz, nx, ny, nz, lift, half, sx, sy, sz, u, v, k):
    """Where the rays start, in the camera frame (y down, z forward), and in the picture."""
    for i in range(n):
        x = px[i] + nx[i] * lift[i]
        y = -(py[i] + ny[i] * lift[i])
        z = -(pz[i] + nz[i] * lift[i])
        z = z if z > f4(1e-6) else f4(1e-6)
        k0 = f4(1) / z
        u0 = x * k0 * fx + cx
        v0 = y * k0 * fy + cy
        # A start that was lifted over the border of the grid stays on it: nothing may be looked up beyond.
        u0 = u0 if u0 > f4(1.001) else f4(1.001)
        u0 = u0 if u0 < width else width
        v0 = v0 if v0 > f4(1.001) else f4(1.001)
        v0 = v0 if v0 < height else height
        sx[i] = x
        sy[i] = y
        sz[i] = z
        u[i] = u0
        v[i] = v0
        k[i] = k0 + half[i]


@kernel(noalias=True)
def shown(n, q, sx, sy, sz, mx, my, mz, ax, ay, az, bx, by, bz):
    """What each start sees of a light with a size, in the camera frame: its sample at (a, b) lies at m + a * (ax, ay, az) + b * (bx, by, bz)
    from there."""
    for i in range(n):
        x = q[0] - q[3] * sx[i]
        y = -q[1] - q[3] * sy[i]
        z = -q[2] - q[3] * sz[i]
        # A ball shows the disc on which its tangents touch it, square to the way to it.
        r = f4(1) / math.sqrt(x * x + y * y + z * z + f4(1e-12))
        sine = q[13] * r
        inside = sine >= f4(1)
        sine = f4(0) if inside else sine
        size = f4(0) if inside else q[13] * math.sqrt(f4(1) - sine * sine)
        wx = x * r
        wy = -y * r
        wz = -z * r
        sign = f4(1) if wz >= f4(0) else f4(-1)
        turn = f4(-1) / (sign + wz)
        both = wx * wy * turn
        back = q[13] * sine
        mx[i] = x - back * wx
        my[i] = y + back * wy
        mz[i] = z + back * wz
        ax[i] = q[4] + size * (f4(1) + sign * wx * wx * turn)
        ay[i] = -q[5] - size * (sign * both)
        az[i] = -q[6] + size * (sign * wx)
        bx[i] = q[7] + size * both
        by[i] = -q[8] - size * (sign + wy * wy * turn)
        bz[i] = -q[9] + size * wy


@kernel(noalias=True)
def targets(n, oa, ob, q, nx, ny, nz, mx, my, mz, ax, ay, az, bx, by, bz, lx, ly, lz, far, weight):
    """The unit way to the light's sample, how far it is, and how much it counts for.

    By its cosine; and by next to nothing where that is between q[15] and 0."""
    for i in range(n):
        a = oa[i]
        b = ob[i]
        x = mx[i] + a * ax[i] + b * bx[i]
        y = my[i] + a * ay[i] + b * by[i]
        z = mz[i] + a * az[i] + b * bz[i]
        d2 = x * x + y * y + z * z + f4(1e-12)
        r = f4(1) / math.sqrt(d2)
        x *= r
        y *= r
        z *= r
        front = nx[i] * x - ny[i] * y - nz[i] * z
        shining = (y * q[11] + z * q[12] - x * q[10]) * r * r
        shining = shining if shining > f4(0) else f4(0)
        shows = shining if q[14] > f4(0) else f4(1)
        w = front * shows
        least = f4(FAINT) * shows if front > q[15] else f4(0)
        lx[i] = x
        ly[i] = y
        lz[i] = z
        far[i] = d2 * r if q[3] > f4(0) else f4(1e9)
        weight[i] = w if w > least else least


@kernel(noalias=True)
def straight(n, q, nx, ny, nz, sx, sy, sz, lx, ly, lz, far, weight):
    """`targets` of a light without a size."""
    for i in range(n):
        x = q[0] - q[3] * sx[i]
        y = -q[1] - q[3] * sy[i]
        z = -q[2] - q[3] * sz[i]
        d2 = x * x + y * y + z * z + f4(1e-12)
        r = f4(1) / math.sqrt(d2)
        x *= r
        y *= r
        z *= r
        front = nx[i] * x - ny[i] * y - nz[i] * z
        least = f4(FAINT) if front > q[15] else f4(0)
        lx[i] = x
        ly[i] = y
        lz[i] = z
        far[i] = d2 * r if q[3] > f4(0) else f4(1e9)
        weight[i] = front if front > least else least


@kernel(noalias=True)
def rays(n, fx, fy, cx, cy, width, height, near, sx, sy, sz, lx, ly, lz, far, weight, u, v, du, dv, dk, pixels, lost, lit):
    """The rays in the picture: whole extent in pixels and inverse depth, cut where they leave the frame or are nearer than `near`.

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
        k1 = f4(1) / (z + c * t)
        a = (sx[i] + lx[i] * t) * k1 * fx + cx - u[i]
        b = (sy[i] + ly[i] * t) * k1 * fy + cy - v[i]
        e = k1 - f4(1) / z
        # The share of the ray that lies in the frame.
        room_u = (width - u[i]) if a > f4(0) else u[i] - f4(1.001)
        room_v = (height - v[i]) if b > f4(0) else v[i] - f4(1.001)
        room_u = room_u if room_u > f4(0) else f4(0)
        room_v = room_v if room_v > f4(0) else f4(0)
        abs_u = abs(a) + f4(1e-9)
        abs_v = abs(b) + f4(1e-9)
        share = room_u / abs_u
        other = room_v / abs_v
        share = other if other < share else share
        share = share if share < f4(1) else f4(1)
        good = weight[i] > f4(0)
        a = a * share if good else f4(0)
        b = b * share if good else f4(0)
        du[i] = a
        dv[i] = b
        dk[i] = e * share if good else f4(0)
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
