"""The kernel of the lights that plain_lights.py leaves out: with a size, on GGX, on materials, with rims.

In, out, frame: as in light.py.  Strips and leaf loops as in plain_lights.py.  What it adds goes on top of the picture where plain lights have made
one, else it makes the picture itself: nothing goes over it twice."""

from __future__ import annotations

import numpy as np

from stereorelight.engine import area_rows as area
from stereorelight.engine import ball_rows, lobe_rows
from stereorelight.engine import light_rows as leaf
from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.light_table import (
    ADDS,
    ALPHA2,
    AXIS,
    BALL,
    COVER,
    DIFFUSE,
    DIFFUSE_SLOT,
    EXPONENT,
    F0,
    FALL_LINEAR,
    FALL_NONE,
    FALL_SQUARE,
    GGX,
    GLOW,
    HALF_U,
    HALF_V,
    IOR,
    MATTE,
    MODEL,
    POINT,
    RADIUS,
    RECTANGLE,
    RIM,
    RIM_POWER,
    SHAPE,
    SIDE_U,
    SIDE_V,
    SPECULAR,
    SPECULAR_SLOT,
    STRIP,
    VECTOR,
    WRAP_OFFSET,
    WRAP_SCALE,
)
from stereorelight.engine.plain_lights import least_base, phong_light, reach, surface
from stereorelight.engine.stream import stream, streamed

# As in light_rows.py: this file must change whenever these do.
LEAVES = "5c7408416fe452bd"
PLAIN = "fdb0837dc7b96846"
TABLE = "909ff10c55dd6268"
LOBE_LEAVES = "ece0089b1381920f"
BALL_LEAVES = "c068e0fd0c4c72b2"
STREAM = "8a555a433ab59bd6"
AREA_LEAVES = "9aeaa7932469afd4"
AREA_ROWS = 26  # of the strip, see `other_lights`; then come those of a highlight of a light with a size
ROWS = AREA_ROWS + lobe_rows.ROOM


@kernel()
def other_lights(
    T, at, pane, streams, first, end, has_P, has_rays, P, Z, rays, N, fx, fy, cx, cy, albedo, lights, slots, mattes, glows, layers, plate, gain,
    beauty, to_beauty, on_top,
):  # fmt: skip
    """Rows first..end.  P, N, albedo, plate, beauty are (H, 3 W); rays (H, 2 W); layers (slots, H, 3 W); mattes (k, H, W).

    on_top : beauty holds the plate with other lights on it already.
    T : (ROWS, STRIP + PADDING), room for one strip's rows;  at : (STRIP + PADDING,) whole numbers;  pane : (3 STRIP,), where a layer's row is
    made before it is streamed, where `streams`."""
    W = N.shape[1] // 3
    h, front = T[19], T[20]
    ax_, ay_, az_, tx2, ty2 = T[21], T[22], T[23], T[24], T[25]
    tail = np.zeros((3, 3 * VECTOR), np.float32)
    columns = leaf.pinhole_columns(W + VECTOR, fx, cx)
    px, py, pz, nx, ny, nz, vx, vy, vz, known = T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9]
    lit, e, s, dr, dg, db, sr, sg, sb = T[10], T[11], T[12], T[13], T[14], T[15], T[16], T[17], T[18]
    for y in range(first, end):
        for x in range(0, W, STRIP):
            m = min(STRIP, W - x)
            n = (m + VECTOR - 1) // VECTOR * VECTOR
            surface(y, x, m, n, has_P, has_rays, P, Z, rays, N, columns, fy, cy, tail, ax_, ay_, px, py, pz, nx, ny, nz, vx, vy, vz, known)
            dark, dull = True, True  # nothing summed yet: diffuse, specular
            for k in range(lights.shape[0]):
                q = lights[k]
                adds = slots[k, ADDS] > 0
                cover = slots[k, COVER]
                if adds and not area.any_of(m, mattes[cover, y, x : x + m]):
                    continue
                matte = slots[k, MATTE]
                reach(m, n, q, matte >= 0, mattes[matte, y, x : x + m] if matte >= 0 else known, px, py, pz, known, lit)
                if cover >= 0:
                    area.through_cover(m, mattes[cover, y, x : x + m], lit)
                shines = slots[k, SPECULAR_SLOT] >= 0 or q[SPECULAR] + q[SPECULAR + 1] + q[SPECULAR + 2] > f4(0)
                shape = slots[k, SHAPE]
                if shape != POINT or slots[k, MODEL] == GGX:
                    if shape == BALL:
                        area.sphere(n, q[0], q[1], q[2], q[RADIUS], px, py, pz, nx, ny, nz, lit, e)
                    elif shape == RECTANGLE:
                        area.rectangle(
                            n, q[0], q[1], q[2], q[AXIS], q[AXIS + 1], q[AXIS + 2], q[SIDE_U], q[SIDE_U + 1], q[SIDE_U + 2],
                            q[SIDE_V], q[SIDE_V + 1], q[SIDE_V + 2], q[HALF_U], q[HALF_V], px, py, pz, nx, ny, nz, lit, e,
                        )  # fmt: skip
                    else:
                        area.towards(
                            n, q[0], q[1], q[2], q[3], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                            px, py, pz, nx, ny, nz, lit, ax_, ay_, az_, e, front,
                        )  # fmt: skip
                    if shines and slots[k, MODEL] == GGX:
                        if shape == BALL:
                            area.sphere_point(n, q[0], q[1], q[2], q[RADIUS], px, py, pz, nx, ny, nz, vx, vy, vz, lit, ax_, ay_, az_, front, tx2)
                            leaf.copy(n, tx2, ty2)
                        elif shape == RECTANGLE:
                            area.rectangle_point(
                                n, q[0], q[1], q[2], q[AXIS], q[AXIS + 1], q[AXIS + 2], q[SIDE_U], q[SIDE_U + 1], q[SIDE_U + 2],
                                q[SIDE_V], q[SIDE_V + 1], q[SIDE_V + 2], q[HALF_U], q[HALF_V],
                                px, py, pz, nx, ny, nz, vx, vy, vz, lit, ax_, ay_, az_, front, tx2, ty2,
                            )  # fmt: skip
                        area.ggx_towards(
                            n, q[ALPHA2], q[F0], q[IOR], glows[slots[k, GLOW]], nx, ny, nz, vx, vy, vz, ax_, ay_, az_, front,
                            shape != POINT, tx2, ty2, s,
                        )  # fmt: skip
                    elif shines and shape == BALL:
                        ball_rows.ball(
                            n, q[EXPONENT], q[0], q[1], q[2], q[RADIUS], px, py, pz, nx, ny, nz, vx, vy, vz, lit, ax_, ay_, az_, tx2, s, at,
                            T[AREA_ROWS:],
                        )  # fmt: skip
                    elif shines:
                        lobe_rows.rectangle(
                            n, q[EXPONENT], q[0], q[1], q[2], q[AXIS], q[AXIS + 1], q[AXIS + 2], q[SIDE_U], q[SIDE_U + 1], q[SIDE_U + 2],
                            q[SIDE_V], q[SIDE_V + 1], q[SIDE_V + 2], q[HALF_U], q[HALF_V],
                            px, py, pz, nx, ny, nz, vx, vy, vz, lit, ax_, ay_, az_, tx2, s, at, T[AREA_ROWS:],
                        )  # fmt: skip
                elif shines:
                    phong_light(n, q, least_base(q[EXPONENT]), px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front, s)
                else:
                    leaf.lambert(
                        n, q[0], q[1], q[2], q[3], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                        px, py, pz, nx, ny, nz, lit, e,
                    )  # fmt: skip
                if to_beauty:
                    if dark:
                        leaf.put(n, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], dr, dg, db)
                    else:
                        leaf.add(n, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], dr, dg, db)
                    dark = False
                    if shines and dull:
                        leaf.put(n, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], sr, sg, sb)
                    elif shines:
                        leaf.add(n, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], sr, sg, sb)
                    dull = dull and not shines
                if slots[k, DIFFUSE_SLOT] >= 0:
                    a = albedo[y, 3 * x : 3 * (x + m)]
                    into = pane if streams else layers[slots[k, DIFFUSE_SLOT], y, 3 * x : 3 * (x + m)]
                    if adds:
                        area.add_diffuse(m, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], a, into)
                    else:
                        leaf.write_diffuse(m, e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2], a, into)
                    if streams:
                        stream(3 * m, pane, layers[slots[k, DIFFUSE_SLOT], y, 3 * x : 3 * (x + m)])
                if slots[k, SPECULAR_SLOT] >= 0:
                    into = pane if streams else layers[slots[k, SPECULAR_SLOT], y, 3 * x : 3 * (x + m)]
                    if adds:
                        area.add_specular(m, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], into)
                    else:
                        leaf.write_specular(m, s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], into)
                if q[RIM] + q[RIM + 1] + q[RIM + 2] > f4(0):
                    area.rim(n, q[RIM_POWER], nx, ny, nz, vx, vy, vz, e, s)
                    if slots[k, SPECULAR_SLOT] >= 0:
                        into = pane if streams else layers[slots[k, SPECULAR_SLOT], y, 3 * x : 3 * (x + m)]
                        area.add_specular(m, s, q[RIM], q[RIM + 1], q[RIM + 2], into)
                    if to_beauty and dull:
                        leaf.put(n, s, q[RIM], q[RIM + 1], q[RIM + 2], sr, sg, sb)
                        dull = False
                    elif to_beauty:
                        leaf.add(n, s, q[RIM], q[RIM + 1], q[RIM + 2], sr, sg, sb)
                if streams and slots[k, SPECULAR_SLOT] >= 0:
                    stream(3 * m, pane, layers[slots[k, SPECULAR_SLOT], y, 3 * x : 3 * (x + m)])
            if not to_beauty or (on_top and dark and dull):
                continue
            if dark:
                leaf.put(n, known, f4(0), f4(0), f4(0), dr, dg, db)
            if dull:
                leaf.put(n, known, f4(0), f4(0), f4(0), sr, sg, sb)
            strip = slice(3 * x, 3 * (x + m))
            if on_top:
                leaf.add_to_picture(m, albedo[y, strip], dr, dg, db, sr, sg, sb, beauty[y, strip])
            else:
                leaf.write_beauty(m, plate[y, strip], albedo[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])
    if streams:
        streamed()
