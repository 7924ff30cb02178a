"""The light kernel: rows of Z or P, N and albedo under any mixture of lights, to a relit picture or to single layers.

In: Z (H, W) with rays, or P (H, W, 3); N, albedo and plate (H, W, 3) float32; lights as a table (columns below).
Out: the relit plate, or one (H, W, 3) layer for each slot asked for; written into the arrays given.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres.
A row goes through in strips that stay in the cache; each step is a leaf loop over separate rows, which the compiler
turns into vector code.  Strips are padded to whole vectors, so a pixel's bits do not depend on where its row was cut.
Pixels without P or N get exactly 0 light."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.engine import area_rows as area
from stereorelight.engine import ball_rows, lobe_rows
from stereorelight.engine import light_rows as leaf
from stereorelight.engine.fastmath import f4, floor, i4, kernel
from stereorelight.engine.rows import in_row_blocks
from stereorelight.engine.stream import STREAM_BYTES, stream, streamed

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
# From here on only rows whose SHAPE or MODEL is not 0, or with a rim.
RADIUS = 22  # of a ball
SIDE_U, SIDE_V, HALF_U, HALF_V = 23, 26, 29, 30  # of a rectangle: unit vectors along its sides, and half their lengths; it shines along AXIS
ALPHA2, F0, IOR = 31, 32, 33  # of GGX: alpha^2; reflectance head on; index for the exact Fresnel formula, 0 for Schlick's
RIM, RIM_POWER = 34, 37  # three channels of (1 - N.V)^power
COLUMNS = 38
# Columns of the integer table: which mattes, and which output layers, -1 for none; and what kind of row it is.
MATTE, DIFFUSE_SLOT, SPECULAR_SLOT, COVER, SHAPE, MODEL, ADDS, GLOW = range(8)
SLOTS = 8
POINT, BALL, RECTANGLE = 0, 1, 2  # SHAPE
PHONG, GGX = 0, 1  # MODEL
# COVER is a second matte, a material's; a row that ADDS goes on top of the layers of the row before it, which is the same light on
# another material; GLOW is its row of the GGX tables.

MOST_SQUARED = 128  # whole exponents up to here are raised by squaring; beyond, rounding would add up to 1e-5
# numba's disk cache knows a kernel by the text of its own file alone, so this file must change whenever light_rows.py does;
# tests/test_light_layers.py holds the two together.
LEAVES = "cb600e14bd7c5fd8"
LOBE_LEAVES = "ece0089b1381920f"
BALL_LEAVES = "c068e0fd0c4c72b2"
STREAM = "8a555a433ab59bd6"
AREA_LEAVES = "9aeaa7932469afd4"
STRIP = 2048  # its rows stay in the second-level cache
AREA_ROWS = 26  # of the strip, see _rows; then come those of a highlight of a light with a size
ROWS = AREA_ROWS + lobe_rows.ROOM
PADDING = 80  # rows a whole page apart would fall onto the same cache lines
VECTOR = 64  # whole vectors, unrolled, on any machine of today


@kernel()
def _rows(
    T, at, pane, streams, first, end, has_P, has_rays, P, Z, rays, N, fx, fy, cx, cy, albedo, lights, slots, mattes, glows, layers, plate, gain,
    beauty, to_beauty, own_albedo,
):  # fmt: skip
    """Rows first..end.  P, N, albedo, plate, beauty are (H, 3 W); rays (H, 2 W); layers (slots, H, 3 W); mattes (k, H, W).

    T : (ROWS, STRIP + PADDING), room for one strip's rows;  at : (STRIP + PADDING,) whole numbers;  pane : (3 STRIP,), where a layer's row is
    made before it is streamed, where `streams`."""
    W = N.shape[1] // 3
    h, front = T[19], T[20]
    ax_, ay_, az_, tx2, ty2 = T[21], T[22], T[23], T[24], T[25]
    alone = to_beauty and own_albedo and lights.shape[0] == 1 and lights[0, RIM] + lights[0, RIM + 1] + lights[0, RIM + 2] == f4(0)
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
                Ns = N[y, 3 * x : 3 * (x + m)] if part == 0 else leaf.padded(N[y, 3 * (x + i) : 3 * (x + m)], tail[0])
                ax, ay, az, bx, by, bz, cx_, cy_, cz, kn = px[i:], py[i:], pz[i:], nx[i:], ny[i:], nz[i:], vx[i:], vy[i:], vz[i:], known[i:]
                if has_P:
                    Ps = P[y, 3 * x : 3 * (x + m)] if part == 0 else leaf.padded(P[y, 3 * (x + i) : 3 * (x + m)], tail[1])
                    leaf.surface_by_position(count, Ps, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
                    continue
                Zs = Z[y, x : x + m] if part == 0 else leaf.padded(Z[y, x + i : x + m], tail[1])
                if has_rays:
                    rs = rays[y, 2 * x : 2 * (x + m)] if part == 0 else leaf.padded(rays[y, 2 * (x + i) : 2 * (x + m)], tail[2])
                    leaf.surface_by_rays(count, rs, Zs, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
                else:
                    leaf.surface_by_pinhole(count, i4(x + i), cx, f4(1) / fx, (f4(y) - cy) / fy, Zs, Ns, ax, ay, az, bx, by, bz, cx_, cy_, cz, kn)
            dark, dull = True, True  # nothing summed yet: diffuse, specular
            for k in range(lights.shape[0]):
                q = lights[k]
                adds = slots[k, ADDS] > 0
                cover = slots[k, COVER]
                if adds and not area.any_of(m, mattes[cover, y, x : x + m]):
                    continue
                if slots[k, MATTE] >= 0:
                    leaf.through_matte(m, known, mattes[slots[k, MATTE], y, x : x + m], lit)
                    lit[m:n] = f4(0)
                else:
                    leaf.copy(n, known, lit)
                if cover >= 0:
                    area.through_cover(m, mattes[cover, y, x : x + m], lit)
                if q[WINDOW] > f4(0):
                    leaf.through_window(n, q[0], q[1], q[2], q[WINDOW], px, py, pz, lit)
                if q[PER_ANGLE] > f4(0):
                    leaf.through_cone(n, q[0], q[1], q[2], q[4], q[5], q[6], q[EDGE], q[PER_ANGLE], px, py, pz, lit)
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
                    leaf.phong(
                        n, q[0], q[1], q[2], q[3], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                        px, py, pz, nx, ny, nz, vx, vy, vz, lit, e, h, front,
                    )  # fmt: skip
                    if q[EXPONENT] <= f4(MOST_SQUARED) and q[EXPONENT] == floor(q[EXPONENT]):
                        leaf.lobe_whole(n, int(q[EXPONENT]), f4(1e-30 ** (1 / q[EXPONENT])), h, front, s)
                    else:
                        leaf.lobe(n, q[EXPONENT], h, front, s)
                else:
                    leaf.lambert(
                        n, q[0], q[1], q[2], q[3], q[WRAP_SCALE], q[WRAP_OFFSET], q[FALL_NONE], q[FALL_LINEAR], q[FALL_SQUARE],
                        px, py, pz, nx, ny, nz, lit, e,
                    )  # fmt: skip
                if alone:
                    strip = slice(3 * x, 3 * (x + m))
                    if not shines:
                        s[:m] = f4(0)
                    leaf.write_one_light(
                        m, plate[y, strip], gain[0], gain[1], gain[2], e, q[DIFFUSE], q[DIFFUSE + 1], q[DIFFUSE + 2],
                        s, q[SPECULAR], q[SPECULAR + 1], q[SPECULAR + 2], beauty[y, strip],
                    )  # fmt: skip
                elif to_beauty:
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
            if to_beauty and not alone:
                if dark:
                    leaf.put(n, known, f4(0), f4(0), f4(0), dr, dg, db)
                if dull:
                    leaf.put(n, known, f4(0), f4(0), f4(0), sr, sg, sb)
                strip = slice(3 * x, 3 * (x + m))
                if own_albedo:
                    leaf.write_relit_plate(m, plate[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])
                else:
                    leaf.write_beauty(m, plate[y, strip], albedo[y, strip], gain[0], gain[1], gain[2], dr, dg, db, sr, sg, sb, beauty[y, strip])
    if streams:
        streamed()


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
    glows: Float32 | None = None,
    layers: Float32 | None = None,
    plate: Float32 | None = None,
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0),
    beauty: Float32 | None = None,
) -> None:
    """Write the layers that `slots` ask for, and the relit plate where `beauty` is given.

    lights : (n, COLUMNS) float32;  slots : (n, SLOTS) int32;  mattes : (k, H, W) float32, 0..1, NaN counts as 0.
    glows  : (j, area_rows.NODES), the tables of the GGX rows.
    layers : (slots, H, W, 3);  plate, beauty : (H, W, 3).  All C-contiguous and of one size: the caller has checked.
    """
    height, width = surface.N.shape[:2]
    flat_layers = np.empty((0, 1, 1), np.float32) if layers is None else layers.reshape(len(layers), height, 3 * width)
    Z = np.empty((1, 1), np.float32) if surface.Z is None else surface.Z
    fx, fy, cx, cy = (f4(v) for v in surface.pinhole)
    P, rays, N, flat_albedo = _flat(surface.P), _flat(surface.rays), _flat(surface.N), _flat(albedo)
    flat_plate, flat_beauty = _flat(plate), _flat(beauty)
    gains = np.array(gain, np.float32)
    tables = np.zeros((1, area.NODES), np.float32) if glows is None else glows

    streams = flat_layers.nbytes >= STREAM_BYTES and not slots[:, ADDS].any()  # what is added to is read again

    room = threading.local()  # fresh pages for every block would cost a tenth of one light

    def run(first: int, end: int) -> None:
        if not hasattr(room, "rows"):
            room.rows = np.empty((ROWS, STRIP + PADDING), np.float32)
            room.at = np.empty(STRIP + PADDING, np.int64)
            room.pane = np.empty(3 * STRIP, np.float32)
        _rows(
            room.rows, room.at, room.pane, streams, first, end, surface.P is not None, surface.rays is not None, P, Z, rays, N, fx, fy, cx, cy,
            flat_albedo, lights, slots, mattes, tables, flat_layers, flat_plate, gains, flat_beauty, beauty is not None, albedo is plate,
        )  # fmt: skip

    in_row_blocks(run, height)
