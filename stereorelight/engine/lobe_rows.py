"""Leaf loops for Phong highlights of lights with a size: the lobe summed over all that is seen of the light, exactly.

In: rows of P, N and of the mirrored view r, float32 of whole vectors.  Out: s, the mean of max(0, r.L)^n over the light's places as each
of them shines, 0 below the horizon of N.  Frame: scene frame of the camera, metres.

Three ways, chosen pixel by pixel, that agree to some 1e-4 where they meet (`MODE` rows).  NOTHING: no light, or the lobe looks elsewhere.
INSIDE: the light stands whole above the horizon and is small against the lobe: a sum over Gauss's places inside it.  OUTLINE and CUT:
a sum along its outline (Stokes; Arvo, Applications of irradiance tensors to the simulation of non-Lambertian phenomena, 1995).  With
c = r.x for unit x on the outline and m = n + 1,

    integral of max(0, c)^n = 1 / m * sum along the outline of (1 - max(0, c)^m) / (1 - c^2) r.(x, dx)

for any exponent and any size.  A side of a rectangle is a piece of a great circle, with c = cos(d) cos(s) at s from where it is nearest to
r.  tan(s) = W tan(t), with W about the lobe's width or its distance, makes what is summed nearly a constant in t, and Gauss's eight
places are enough.  Beyond 90 degrees from r only the angle about r counts, which is known."""

from __future__ import annotations

import math

from stereorelight.engine.fastmath import exp2, f4, kernel, log2_below_one, power_below_one

# As in light_rows.py: this file must change whenever fastmath.py does.
FASTMATH = "66c93d0f0531acee"
VECTOR = 64  # whole vectors, as in light.py
ROOM = 22
NOTHING, INSIDE, OUTLINE, CUT = f4(0), f4(1), f4(2), f4(3)
# Gauss and Legendre's four places on -1..1, which INSIDE goes by along both sides of a rectangle, and their shares of a mean.
PLACES = (-0.8611363115940526, -0.3399810435848563, 0.3399810435848563, 0.8611363115940526)
SHARES = (0.1739274225687269, 0.3260725774312731, 0.3260725774312731, 0.1739274225687269)

_PI = f4(math.pi)
_LN2 = f4(math.log(2))
_WIDTH = f4(6)  # W^2 = sin(d)^2 + _WIDTH / m cos(d)^2; found by trial, 3 to 12 are as good
_NEAR = f4(2)  # half a side squared over the distance squared, times m, up to where INSIDE holds ...
_WIDE = f4(0.25)  # ... and half the diagonal squared over the distance squared
_NO_LOBE = f4(14)  # exp(-14): 1e-6 of the highlight's middle
# Gauss and Legendre's eight places, and what they count for.
X0, X1, X2, X3 = f4(0.1834346424956498), f4(0.5255324099163290), f4(0.7966664774136267), f4(0.9602898564975363)
W0, W1, W2, W3 = f4(0.3626837833783620), f4(0.3137066458778873), f4(0.2223810344533745), f4(0.1012285362903763)


@kernel(forceinline=True)
def angle_of(y, x):
    """atan2 for y >= 0, x >= 0, 0..pi/2, relative error 2e-7."""
    steep = y > x
    most = y if steep else x
    z = (x if steep else y) / (most if most > f4(1e-30) else f4(1e-30))
    z2 = z * z
    p = f4(-0.06241743456) + z2 * (f4(0.0358845727) + z2 * (f4(-0.01357253375) + z2 * f4(0.002415284299)))
    p = f4(0.3333332963) + z2 * (f4(-0.1999965095) + z2 * (f4(0.142775829) + z2 * (f4(-0.1102921773) + z2 * (f4(0.08647153599) + z2 * p))))
    a = z - z * z2 * p
    return f4(0.5) * _PI - a if steep else a


@kernel(forceinline=True)
def sine_of(y):
    """sin for -pi/2..pi/2."""
    y2 = y * y
    return y * (f4(1) + y2 * (f4(-1 / 6) + y2 * (f4(1 / 120) + y2 * (f4(-1 / 5040) + y2 * (f4(1 / 362880) + y2 * f4(-1 / 39916800))))))


@kernel(forceinline=True)
def cosine_of(y):
    """cos for -pi/2..pi/2."""
    y2 = y * y
    p = f4(1 / 40320) + y2 * (f4(-1 / 3628800) + y2 * f4(1 / 479001600))
    return f4(1) + y2 * (f4(-0.5) + y2 * (f4(1 / 24) + y2 * (f4(-1 / 720) + y2 * p)))


@kernel(forceinline=True)
def missing(h, m):
    """1 - (1 - h)^m for 0 <= h <= 1, also where it is tiny."""
    z = _LN2 * m * log2_below_one(h)
    near = -z * (f4(1) + z * (f4(0.5) + z * (f4(1 / 6) + z * f4(1 / 24))))
    return near if z > f4(-0.1) else f4(1) - exp2(z * f4(1 / math.log(2)))


@kernel(forceinline=True)
def _at(c, s, sd2, w2, half_m):
    """What is summed at one place of a side, but for what is the same for all of them."""
    c = c if c > f4(1e-7) else f4(1e-7)
    c2 = c * c
    a = w2 * s * s
    q = c2 + a
    d = sd2 * c2 + a
    d = d if d > f4(1e-9) * q else f4(1e-9) * q
    return missing(d / q, half_m) / d  # d / q is the squared sine of the angle to r


@kernel(forceinline=True)
def _pair(x, half, cm, sm, sd2, w2, half_m):
    """Two places, x half to both sides of the middle (cm, sm)."""
    sk = sine_of(x * half)
    ck = cosine_of(x * half)
    return _at(cm * ck - sm * sk, sm * ck + cm * sk, sd2, w2, half_m) + _at(cm * ck + sm * sk, sm * ck - cm * sk, sd2, w2, half_m)


@kernel(noalias=True)
def mirrored(n, nx, ny, nz, vx, vy, vz, rx, ry, rz):
    """The unit way that a mirror would show the eye."""
    for i in range(n):
        nv = f4(2) * (nx[i] * vx[i] + ny[i] * vy[i] + nz[i] * vz[i])
        rx[i] = nv * nx[i] - vx[i]
        ry[i] = nv * ny[i] - vy[i]
        rz[i] = nv * nz[i] - vz[i]


@kernel(noalias=True)
def modes(n, exponent, lx, ly, lz, radius, half, mx, my, mz, px, py, pz, nx, ny, nz, rx, ry, rz, lit, mode):
    """Which way each pixel is summed.

    radius : of a ball about the light.   half : half of its longer side.   mx, my, mz : the way that it shines, 0 for all ways."""
    m = exponent + f4(1)
    for i in range(n):
        a = lx - px[i]
        b = ly - py[i]
        c = lz - pz[i]
        d2 = a * a + b * b + c * c
        d2 = d2 if d2 > f4(1e-12) else f4(1e-12)
        r = f4(1) / math.sqrt(d2)
        cos = (rx[i] * a + ry[i] * b + rz[i] * c) * r
        cos = cos if cos < f4(1) else f4(1)
        cos = cos if cos > f4(-1) else f4(-1)
        sine = radius * r
        around = sine >= f4(1)
        sine = f4(1) if around else sine
        beside = math.sqrt(f4(1) - sine * sine)
        most = cos * beside + math.sqrt(f4(1) - cos * cos) * sine  # the cosine of r with what is nearest to it
        most = f4(1) if around | (cos > beside) else most
        away = (most <= f4(0)) | (exponent * (f4(1) - most) > _NO_LOBE)
        height = nx[i] * a + ny[i] * b + nz[i] * c
        behind = (mx * mx + my * my + mz * mz > f4(0)) & (a * mx + b * my + c * mz >= f4(0))
        dark = away | behind | (height <= -radius) | (lit[i] <= f4(0))
        least = cos * beside - math.sqrt(f4(1) - cos * cos) * sine
        smooth = (least > f4(0)) | (exponent > f4(6))  # the lobe's end, 90 degrees off, is a kink
        inside = smooth & (half * half * m < _NEAR * d2) & (radius * radius < _WIDE * d2)
        way = INSIDE if inside else OUTLINE
        way = CUT if height < radius else way
        mode[i] = NOTHING if dark else way


@kernel(noalias=True)
def pack(n, mode, low, high, px, py, pz, nx, ny, nz, rx, ry, rz, at, PX, PY, PZ, NX, NY, NZ, RX, RY, RZ):
    """The pixels that go one of the ways low..high, close together, filled up to whole vectors; where they stood, and how many they are."""
    count = 0
    for i in range(n):
        if low <= mode[i] <= high:
            at[count] = i
            PX[count], PY[count], PZ[count] = px[i], py[i], pz[i]
            NX[count], NY[count], NZ[count] = nx[i], ny[i], nz[i]
            RX[count], RY[count], RZ[count] = rx[i], ry[i], rz[i]
            count += 1
    for k in range(count, (count + VECTOR - 1) // VECTOR * VECTOR):
        PX[k], PY[k], PZ[k] = f4(0), f4(0), f4(-1)
        NX[k], NY[k], NZ[k] = f4(0), f4(0), f4(1)
        RX[k], RY[k], RZ[k] = f4(0), f4(0), f4(1)
    return count


@kernel(noalias=True)
def add_place(n, exponent, x, y, z, share, mx, my, mz, px, py, pz, rx, ry, rz, s):
    """What one place of a flat light that shines along m adds."""
    for i in range(n):
        a = x - px[i]
        b = y - py[i]
        c = z - pz[i]
        d2 = a * a + b * b + c * c
        d2 = d2 if d2 > f4(1e-12) else f4(1e-12)
        r = f4(1) / math.sqrt(d2)
        cos = -(a * mx + b * my + c * mz) * r
        a = rx[i] - a * r
        b = ry[i] - b * r
        c = rz[i] - c * r
        s[i] += power_below_one(f4(0.5) * (a * a + b * b + c * c), exponent) * (share * cos / d2)


@kernel(noalias=True)
def start_side(n, ax, ay, az, ex, ey, ez, px, py, pz, nx, ny, nz, qx, qy, qz, fx, fy, fz, ox, oy, oz, ix, iy, iz):
    """A rectangle's side from the corner a along e as seen from the surface: its piece above the horizon, from q along f, and on top of
    what is there, where it leaves the horizon (o) and where it enters it (i)."""
    for i in range(n):
        sx = ax - px[i]
        sy = ay - py[i]
        sz = az - pz[i]
        hs = nx[i] * sx + ny[i] * sy + nz[i] * sz
        he = nx[i] * ex + ny[i] * ey + nz[i] * ez
        ht = hs + he
        above_s = hs > f4(0)
        above_t = ht > f4(0)
        leaves = above_s & (ht <= f4(0))
        enters = above_t & (hs <= f4(0))
        k = hs / (-he if leaves | enters else f4(1))
        cx = sx + k * ex
        cy = sy + k * ey
        cz = sz + k * ez
        share = k if leaves else (f4(1) - k if enters else f4(1))
        share = share if above_s | above_t else f4(0)
        qx[i] = cx if enters else sx
        qy[i] = cy if enters else sy
        qz[i] = cz if enters else sz
        fx[i] = share * ex
        fy[i] = share * ey
        fz[i] = share * ez
        ox[i] += cx if leaves else f4(0)
        oy[i] += cy if leaves else f4(0)
        oz[i] += cz if leaves else f4(0)
        ix[i] += cx if enters else f4(0)
        iy[i] += cy if enters else f4(0)
        iz[i] += cz if enters else f4(0)


@kernel(noalias=True)
def start_horizon(n, qx, qy, qz, fx, fy, fz, ox, oy, oz, ix, iy, iz):
    """The side along the horizon, from where an outline leaves it to where it enters it again."""
    for i in range(n):
        qx[i] = ox[i]
        qy[i] = oy[i]
        qz[i] = oz[i]
        fx[i] = ix[i] - ox[i]
        fy[i] = iy[i] - oy[i]
        fz[i] = iz[i] - oz[i]


@kernel(noalias=True)
def add_side(n, exponent, qx, qy, qz, fx, fy, fz, rx_, ry_, rz_, s):
    """The sum along the piece of a great circle from q to q + f, as seen from 0."""
    m = exponent + f4(1)
    for i in range(n):
        px, py, pz, ex, ey, ez, rx, ry, rz = qx[i], qy[i], qz[i], fx[i], fy[i], fz[i], rx_[i], ry_[i], rz_[i]
        mx = py * ez - pz * ey
        my = pz * ex - px * ez
        mz = px * ey - py * ex
        long = math.sqrt(mx * mx + my * my + mz * mz)
        per = f4(1) / (long if long > f4(1e-18) else f4(1e-18))
        mx *= per
        my *= per
        mz *= per
        sd = rx * mx + ry * my + rz * mz
        left = sd < f4(0)
        sd = -sd if left else sd
        sd2 = sd * sd
        sd2 = sd2 if sd2 < f4(1) else f4(1)
        cd2 = f4(1) - sd2
        w2 = sd2 + _WIDTH / m * cd2
        w2 = w2 if w2 < f4(1) else f4(1)
        w = math.sqrt(w2)
        # Along the side, and towards r: at both ends, times their distance.
        ax = my * rz - mz * ry
        ay = mz * rx - mx * rz
        az = mx * ry - my * rx
        s1 = ax * px + ay * py + az * pz
        c1 = rx * px + ry * py + rz * pz
        s2 = s1 + (ax * ex + ay * ey + az * ez)
        c2 = c1 + (rx * ex + ry * ey + rz * ez)
        back1 = c1 < f4(0)
        back2 = c2 < f4(0)
        # The part beyond 90 degrees: how far along the back half each end lies, as an angle about r.
        b1 = angle_of(-sd * c1 if back1 else f4(0), abs(s1))
        b2 = angle_of(-sd * c2 if back2 else f4(0), abs(s2))
        b1 = b1 if s1 > f4(0) else _PI - b1
        b2 = b2 if s2 > f4(0) else _PI - b2
        whole = _PI if back1 else f4(0)
        back = (b2 if back2 else whole) - (b1 if back1 else f4(0))
        # The rest, in t.
        n1 = f4(1) / math.sqrt(w2 * c1 * c1 + s1 * s1 + f4(1e-36))
        n2 = f4(1) / math.sqrt(w2 * c2 * c2 + s2 * s2 + f4(1e-36))
        cos1 = f4(0) if back1 else w * c1 * n1
        sin1 = f4(-1) if back1 else s1 * n1
        cos2 = f4(0) if back2 else w * c2 * n2
        sin2 = f4(1) if back2 else s2 * n2
        turn = cos1 * sin2 - sin1 * cos2
        turn = turn if back1 | back2 else w * long * cd2 * n1 * n2  # the same, without a difference
        turn = turn if turn > f4(0) else f4(0)
        same = f4(1) + cos1 * cos2 + sin1 * sin2
        half = angle_of(turn, same if same > f4(0) else f4(0))
        half = f4(0) if back1 & back2 else half
        cm = cos1 + cos2
        sm = sin1 + sin2
        per = f4(1) / math.sqrt(cm * cm + sm * sm + f4(1e-12))
        cm *= per
        sm *= per
        half_m = f4(0.5) * m
        total = _pair(X0, half, cm, sm, sd2, w2, half_m) * W0
        total += _pair(X1, half, cm, sm, sd2, w2, half_m) * W1
        total += _pair(X2, half, cm, sm, sd2, w2, half_m) * W2
        total += _pair(X3, half, cm, sm, sd2, w2, half_m) * W3
        total = sd * w * half * total + back
        total = total if long > f4(1e-18) else f4(0)
        s[i] += -total if left else total


@kernel(noalias=True)
def clear(n, a):
    for i in range(n):
        a[i] = f4(0)


@kernel(noalias=True)
def unpack(count, at, packed, per, lit, s):
    """Sums back to where their pixels stand, as light."""
    for k in range(count):
        i = at[k]
        found = packed[k] * per
        s[i] = found * lit[i] if found > f4(0) else f4(0)


@kernel()
def rectangle(
    n, exponent, lx, ly, lz, mx, my, mz, ux, uy, uz, wx, wy, wz, half_w, half_h, px, py, pz, nx, ny, nz, vx, vy, vz, lit, rx, ry, rz, mode, s, at,
    room,
):  # fmt: skip
    """The highlight of a rectangle that shines along m, into s.

    u, w : unit vectors along its sides.     at : (n,) whole numbers.     room : ROOM more rows."""
    ux, uy, uz, wx, wy, wz = ux * half_w, uy * half_w, uz * half_w, wx * half_h, wy * half_h, wz * half_h
    PX, PY, PZ, NX, NY, NZ, RX, RY, RZ = room[0], room[1], room[2], room[3], room[4], room[5], room[6], room[7], room[8]
    ox, oy, oz, ix, iy, iz = room[9], room[10], room[11], room[12], room[13], room[14]
    qx, qy, qz, fx, fy, fz, total = room[15], room[16], room[17], room[18], room[19], room[20], room[21]
    mirrored(n, nx, ny, nz, vx, vy, vz, rx, ry, rz)
    radius = math.sqrt(half_w * half_w + half_h * half_h)
    modes(n, exponent, lx, ly, lz, radius, max(half_w, half_h), mx, my, mz, px, py, pz, nx, ny, nz, rx, ry, rz, lit, mode)
    clear(n, s)
    count = pack(n, mode, INSIDE, INSIDE, px, py, pz, nx, ny, nz, rx, ry, rz, at, PX, PY, PZ, NX, NY, NZ, RX, RY, RZ)
    if count > 0:
        whole = (count + VECTOR - 1) // VECTOR * VECTOR
        clear(whole, total)
        for one in range(4):
            for other in range(4):
                a, b, share = f4(PLACES[one]), f4(PLACES[other]), f4(SHARES[one] * SHARES[other])
                add_place(
                    whole, exponent, lx + a * ux + b * wx, ly + a * uy + b * wy, lz + a * uz + b * wz, share, mx, my, mz,
                    PX, PY, PZ, RX, RY, RZ, total,
                )  # fmt: skip
        unpack(count, at, total, f4(1), lit, s)
    for way in range(2):
        asked = CUT if way else OUTLINE
        count = pack(n, mode, asked, asked, px, py, pz, nx, ny, nz, rx, ry, rz, at, PX, PY, PZ, NX, NY, NZ, RX, RY, RZ)
        if count == 0:
            continue
        whole = (count + VECTOR - 1) // VECTOR * VECTOR
        clear(whole, total)
        for row in range(9, 15):
            clear(whole, room[row])
        for corner in range(4):
            a = f4(1) if (corner == 0) | (corner == 3) else f4(-1)
            b = f4(1) if corner < 2 else f4(-1)
            along = f4(-2) if corner == 0 else (f4(2) if corner == 2 else f4(0))
            up = f4(-2) if corner == 1 else (f4(2) if corner == 3 else f4(0))
            start_side(
                whole, lx + a * ux + b * wx, ly + a * uy + b * wy, lz + a * uz + b * wz, along * ux + up * wx, along * uy + up * wy,
                along * uz + up * wz, PX, PY, PZ, NX, NY, NZ, qx, qy, qz, fx, fy, fz, ox, oy, oz, ix, iy, iz,
            )  # fmt: skip
            add_side(whole, exponent, qx, qy, qz, fx, fy, fz, RX, RY, RZ, total)
        if way == 1:
            start_horizon(whole, qx, qy, qz, fx, fy, fz, ox, oy, oz, ix, iy, iz)
            add_side(whole, exponent, qx, qy, qz, fx, fy, fz, RX, RY, RZ, total)
        unpack(count, at, total, f4(0.25) / (half_w * half_h * (exponent + f4(1))), lit, s)
