"""The kernel of most scenes: lights without size, Lambert and Phong, on one surface.

In, out, frame: as in light.py.  Everything else (lights with a size, GGX, materials, rims) is other_lights.py, which takes ten times as long to
compile and is not asked for where there is none of it.
Lights that bear dot products, which most are, go by dot_lights.py, where Z and the plate's own colours are given.  For the others a row goes
through in strips that stay in the cache; each step is a leaf loop over separate rows, which the compiler turns into vector code.  Strips are
padded to whole vectors, so a pixel's bits do not depend on where its row was cut."""

from __future__ import annotations

import numpy as np

from stereorelight.engine import light_rows as leaf
from stereorelight.engine.dot_lights import MOST_DOTS, PIXELS, dot_lights, glows
from stereorelight.engine.dot_lights import ROOM as ROOM_OF_DOTS
from stereorelight.engine.eights import GROUP
from stereorelight.engine.fastmath import f4, floor, kernel
from stereorelight.engine.light_table import (
    AXIS,
    DIFFUSE,
    DIFFUSE_SLOT,
    EDGE,
    EXPONENT,
    FALL_LINEAR,
    FALL_NONE,
    FALL_SQUARE,
    IS_PLACE,
    MATTE,
    MOST_SQUARED,
    PER_ANGLE,
    SPECULAR,
    SPECULAR_SLOT,
    STRIP,
    VECTOR,
    WINDOW,
    WRAP_OFFSET,
    WRAP_SCALE,
)
from stereorelight.engine.spread import ROOM, TONES, layer_row, paint
from stereorelight.engine.stream import streamed

# As in light_rows.py: this file must change whenever these do.
LEAVES = "5c7408416fe452bd"
EIGHTS = "6142f6448ebad24e"
DOTS = "78f82f7f7165cb35"
TABLE = "909ff10c55dd6268"
STREAM = "8a555a433ab59bd6"
SPREAD = "d0bacb6509a1ac6c"
SUMS = 13  # the first of six rows for sums
ROWS = 23  # of a strip, see below


@kernel(forceinline=True)
def surface(y, x, m, n, has_P, has_rays, P, Z, rays, N, columns, fy, cy, tail, rx, ry, px, py, pz, nx, ny, nz, vx, vy, vz, known):
    """P, N and V of the strip x..x+m of row y, filled up to n.   columns : x of the rays of a pinhole, a row longer by VECTOR.
    tail : (3, 3 VECTOR) of room.   rx, ry : rows for rays."""
    whole = m // VECTOR * VECTOR
    # Whole vectors straight from the picture, and what is left over from a padded copy, through the same code.
    for part in range(2):
        i = 0 if part == 0 else whole
        count = whole if part == 0 else n - whole
        if count == 0:
            continue
        Ns = N[y, 3 * x : 3 * (x + m)] if part == 0 else leaf.padded(N[y, 3 * (x + i) : 3 * (x + m)], tail[0])
        ax, ay, az, bx, by, bz, cx_, cy_, cz, kn = px[i:], py[i:], pz[i:], nx[i:], ny[i:], nz[i:], vx[i:], vy[i:], vz[i:], known[i:]
        if has_P:
            Ps = P[y, 3 * x : 3 * (x + m)] if part == 0 else leaf.padded(P[y, 3 * (x + i) : 3 * (x + m)], tail[1])
            leaf.surface_by_position(count, Ps, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
            continue
        Zs = Z[y, x : x + m] if part == 0 else leaf.padded(Z[y, x + i : x + m], tail[1])
        if has_rays:
            rs = rays[y, 2 * x : 2 * (x + m)] if part == 0 else leaf.padded(rays[y, 2 * (x + i) : 2 * (x + m)], tail[2])
            leaf.taken_apart(count, rs, rx, ry)
        else:
            leaf.fill(count, (cy - f4(y)) / fy, ry)
        xs = rx if has_rays else columns[x + i :]
        leaf.surface_by_rays(count, xs, ry, Zs, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)


@kernel(forceinline=True)
def reach(m, n, q, matte, row, px, py, pz, known, lit):
    """What a light's matte, window and cone let through.   matte : whether `row`, (m,), is one."""
    if matte:
        leaf.through_matte(m, known, row, lit)
        lit[m:n] = f4(0)
    else:
        leaf.copy(n, known, lit)
    if q[WINDOW] > f4(0):
        leaf.through_window(n, q[0], q[1], q[2], q[WINDOW], px, py, pz, lit)
    if q[PER_ANGLE] > f4(0):
        leaf.through_cone(n, q[0], q[1], q[2], q[AXIS], q[AXIS + 1], q[AXIS + 2], q[EDGE], q[PER_ANGLE], px, py, pz, lit)


@kernel(forceinline=True)
def squares(exponent):
    """Whether a lobe is raised by squaring."""
    return (exponent <= f4(MOST_SQUARED)) & (exponent == floor(exponent))


@kernel(forceinline=True)
def least_base(exponent):
    """What is below it is dark beside any highlight: 1e-19, whose square is still a normal number; with others some processors crawl."""
    return f4(1e-19 ** (1 / exponent))


@kernel(forceinline=True)
def phong_light(n, q, least, px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front, s):
    """Diffuse into e and the highlight into s."""
    leaf.phong(
        n, q[0], q[1], q[2], q[IS_PLACE], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
        px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front,
    )  # fmt: skip
    if squares(q[EXPONENT]):
        leaf.lobe_whole(n, int(q[EXPONENT]), least, h, front, s)
    else:
        leaf.lobe(n, q[EXPONENT], h, front, s)


@kernel()
def plain_lights(
    T, streams, first, end, has_P, has_rays, P, Z, rays, N, fx, fy, cx, cy, albedo, lights, slots, mattes, layers, plate, gain,
    beauty, to_beauty, own_albedo,
):  # fmt: skip
    """Rows first..end.  P, N, albedo, plate, beauty are (H, 3 W); rays (H, 2 W); layers (slots, H, 3 W); mattes (k, H, W).

    T : (ROWS, STRIP + PADDING), room for one strip's rows;  streams : whether layers go past the caches."""
    W = N.shape[1] // 3
    count = lights.shape[0]
    tail = np.zeros((4, 3 * VECTOR), np.float32)
    px, py, pz, nx, ny, nz, vx, vy, vz, known = T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9]
    lit, e, s, dr, dg, db, sr, sg, sb, h, front = T[10], T[11], T[12], T[13], T[14], T[15], T[16], T[17], T[18], T[19], T[20]
    rx, ry = T[21], T[22]
    dots = np.zeros(ROOM_OF_DOTS, np.float32)
    columns = leaf.pinhole_columns(W + VECTOR, fx, cx)
    least = np.empty(count, np.float32)
    tones, room = np.empty((count, TONES), np.float32), np.zeros(ROOM, np.float32)
    for k in range(count):
        q = lights[k]
        least[k] = least_base(q[EXPONENT])
        paint(gain, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], tones[k])
    # No dot product may be asked for too much by an exponent, and what a cone or a window lets through is not known to dot_lights.py.
    by_dots = count > 0 and to_beauty and own_albedo and not has_P
    keeps = False
    for k in range(count):
        q = lights[k]
        by_dots &= q[WINDOW] == f4(0) and q[PER_ANGLE] == f4(0) and (not glows(k, lights) or (squares(q[EXPONENT]) and q[EXPONENT] <= f4(MOST_DOTS)))
        keeps |= slots[k, DIFFUSE_SLOT] >= 0 or slots[k, SPECULAR_SLOT] >= 0
    kept = count if by_dots and keeps else 1
    es, ss = np.empty((kept, STRIP + GROUP), np.float32), np.empty((kept, STRIP + GROUP), np.float32)  # strengths by light, for layers
    for y in range(first, end):
        for x in range(0, W, STRIP):
            m = min(STRIP, W - x)
            n = (m + VECTOR - 1) // VECTOR * VECTOR
            strip = slice(3 * x, 3 * (x + m))
            if by_dots:
                if has_rays:
                    leaf.taken_apart(m, rays[y, 2 * x : 2 * (x + m)], rx, ry)
                Zs, Ns, plates, target = Z[y, x : x + m], N[y, strip], plate[y, strip], beauty[y, strip]
                if m < PIXELS:
                    Zs, Ns, plates, target = leaf.padded(Zs, tail[0]), leaf.padded(Ns, tail[1]), leaf.padded(plates, tail[2]), tail[3]
                dot_lights(
                    m, has_rays, keeps, lights, slots, mattes, y, x, least, rx if has_rays else columns[x:], ry, (cy - f4(y)) / fy, Zs, Ns,
                    plates, tones, dots, es, ss, target,
                )  # fmt: skip
                if m < PIXELS:
                    leaf.copy(3 * m, target, beauty[y, strip])
            else:
                surface(y, x, m, n, has_P, has_rays, P, Z, rays, N, columns, fy, cy, tail, rx, ry, px, py, pz, nx, ny, nz, vx, vy, vz, known)
            if to_beauty and not by_dots:
                for row in range(SUMS, SUMS + 6):
                    leaf.fill(n, f4(0), T[row])
            for k in range(count):
                q = lights[k]
                shines = slots[k, SPECULAR_SLOT] >= 0 or q[SPECULAR] + q[SPECULAR + 1] + q[SPECULAR + 2] > f4(0)
                if not by_dots:
                    matte = slots[k, MATTE]
                    reach(m, n, q, matte >= 0, mattes[matte, y, x : x + m] if matte >= 0 else known, px, py, pz, known, lit)
                    if shines:
                        phong_light(n, q, least[k], px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front, s)
                    else:
                        leaf.lambert(
                            n, q[0], q[1], q[2], q[IS_PLACE], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                            px, py, pz, nx, ny, nz, lit, e,
                        )  # fmt: skip
                    if to_beauty and shines:
                        leaf.add_both(
                            n, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2],
                            dr, dg, db, sr, sg, sb,
                        )  # fmt: skip
                    elif to_beauty:
                        leaf.add(n, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], dr, dg, db)
                light, glow = (es[min(k, kept - 1)], ss[min(k, kept - 1)]) if by_dots else (e, s)
                for part in range(2):
                    slot = slots[k, DIFFUSE_SLOT] if part == 0 else slots[k, SPECULAR_SLOT]
                    if slot < 0:
                        continue
                    layer_row(m, streams, part == 0, light if part == 0 else glow, albedo[y, strip], tones[k], room, layers[slot, y, strip])
            if to_beauty and not by_dots:
                if own_albedo:
                    leaf.write_relit_plate(m, plate[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])
                else:
                    leaf.write_beauty(m, plate[y, strip], albedo[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])
    if streams:
        streamed()
