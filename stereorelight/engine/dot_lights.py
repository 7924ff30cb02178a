"""Plain lights from Z and N to the relit plate, a few dozen pixels at a time.

In: rows of rays, Z, N and the plate.  Out: rows of strengths on the surface, for layers, and of the picture.
Frame: scene frame of the camera, metres.
What is most frequent: places and directions, Lambert or Phong with a whole exponent, at most a matte each, on the plate as its own albedo.
A processor looks one or two hundred steps ahead, and no step here waits long for the one before it: dot products, roots, powers and colours
go one after the other over a few pixels, whose numbers stay in a small room in between; and memory is read and written all the time, not by
turns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from stereorelight.engine.eights import GROUP, LONG, Eight, Rows
from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.light_rows import NEAREST2
from stereorelight.engine.light_table import (
    EXPONENT,
    FALL_LINEAR,
    FALL_NONE,
    FALL_SQUARE,
    IS_PLACE,
    MATTE,
    SPECULAR,
    WRAP_OFFSET,
    WRAP_SCALE,
)
from stereorelight.engine.spread import TONES, relit, relit_more

# As `light.LEAVES`, of what is in here of other files; this file must change whenever they do.
LEAVES = "5c7408416fe452bd"
EIGHTS = "6142f6448ebad24e"
TABLE = "909ff10c55dd6268"
SPREAD = "d0bacb6509a1ac6c"
MOST_DOTS = 64
PIXELS = 64  # that go through all steps together
D2, N_L, R_V = 0, PIXELS, 2 * PIXELS  # where they stand in the room
FRONT = D2  # the strength in front, once d^2 is used up
LIT = 3 * PIXELS  # what a matte lets through
ROOM = 4 * PIXELS
NEAREST_Z, FARTHEST_Z = 1e-10, 1e15  # metres; what lies beyond is missing, as in light_rows.py


def _dot(a: tuple[Eight, Eight, Eight], b: tuple[Eight, Eight, Eight]) -> Eight:
    return a[0] * b[0] + (a[1] * b[1] + a[2] * b[2])


def _faced_by(has_rays: bool) -> Any:
    """The intrinsic that takes all dot products of a group, into the room: d^2, N.L and R.V, the last two times d."""

    @intrinsic
    def group(typingctx, x, y, Z, N, i, lx, ly, lz, w, room, at):
        def body(context, builder, signature, args):
            rows = Rows(context, builder, signature, args)
            i, at = args[4], args[10]
            one, nothing = rows.number(1), rows.number(0)
            right = rows.read(0, i)
            up = rows.read(1, i) if has_rays else rows.every(1)
            depth = rows.read(2, i)
            normal = rows.three_channels(3, builder.mul(i, ir.Constant(LONG, 3)))
            known = depth.between(NEAREST_Z, FARTHEST_Z) & _dot(normal, normal).between(0.25, 4)
            # P = Z (x, y, -1);  to the light: L - w P.
            far = depth * rows.every(8)
            light = rows.every(5) - far * right, rows.every(6) - far * up, rows.every(7) + far
            # V = -(x, y, -1) / |(x, y, -1)|, whatever Z.
            ray2 = right * right + (up * up + one)
            n_ray = normal[0] * right + (normal[1] * up - normal[2])
            l_ray = light[0] * right + (light[1] * up - light[2])
            n_l = _dot(normal, light).where(known, rows.number(float("-inf")))  # where there is no surface, it faces away
            r_v = (l_ray - (n_l + n_l) * n_ray) * (one / ray2.root())
            rows.write(9, at, _dot(light, light).at_least(rows.number(float(NEAREST2))), D2)
            rows.write(9, at, n_l, N_L)
            rows.write(9, at, r_v.where(n_l.above(nothing), nothing), R_V)
            return context.get_dummy_value()

        return types.void(x, y, Z, N, i, lx, ly, lz, w, room, at), body

    return group


_faced_by_rays, _faced_by_pinhole = _faced_by(True), _faced_by(False)


def _shone_on(has_matte: bool) -> Any:
    """The intrinsic for the diffuse strength of a group, into e, and for R.V, 0 below `least`, and its strength, in the room."""

    @intrinsic
    def group(typingctx, room, at, ws, wo, a0, a1, a2, least, e, ei):
        def body(context, builder, signature, args):
            rows = Rows(context, builder, signature, args)
            at = args[1]
            per = rows.number(1) / rows.read(0, at, D2).root()
            facing = rows.read(0, at, N_L) * per * rows.every(2) + rows.every(3)
            r_v = rows.read(0, at, R_V) * per
            strength = rows.every(4) + per * (rows.every(5) + per * rows.every(6))
            strength = strength * rows.read(0, at, LIT) if has_matte else strength
            rows.write(8, args[9], facing.at_least(rows.number(0)) * strength)
            rows.write(0, at, r_v.where(r_v.above(rows.every(7)), rows.number(0)), R_V)
            rows.write(0, at, strength, FRONT)
            return context.get_dummy_value()

        return types.void(room, at, ws, wo, a0, a1, a2, least, e, ei), body

    return group


_shone_on_free, _shone_on_held = _shone_on(False), _shone_on(True)


@intrinsic
def _held(typingctx, mattes, i, room, at):
    """What a matte lets through of a group; nothing where it is NaN."""

    def body(context, builder, signature, args):
        rows = Rows(context, builder, signature, args)
        rows.write(2, args[3], rows.read(0, args[1]).at_least(rows.number(0)), LIT)
        return context.get_dummy_value()

    return types.void(mattes, i, room, at), body


@intrinsic
def _dark(typingctx, s, i):
    """No highlight on a group."""

    def body(context, builder, signature, args):
        rows = Rows(context, builder, signature, args)
        rows.write(0, args[1], rows.number(0))
        return context.get_dummy_value()

    return types.void(s, i), body


@intrinsic
def _raised(typingctx, exponent, bit, room, s, si):
    """s = R.V^exponent times its strength, for PIXELS pixels.   bit : the second highest of the exponent's places, as a number.

    All of them stand in registers meanwhile, and each place of the exponent is asked for once."""

    def body(context, builder, signature, args):
        rows = Rows(context, builder, signature, args)
        starts = range(0, PIXELS, GROUP)
        none = ir.Constant(LONG, 0)
        bases = [rows.read(2, none, R_V + start) for start in starts]
        powers = [cgutils.alloca_once_value(builder, base.value) for base in bases]
        place = cgutils.alloca_once_value(builder, args[1])

        def multiplied(factors: Sequence[Eight]) -> None:
            for power, factor in zip(powers, factors):
                builder.store((Eight(builder, builder.load(power)) * factor).value, power)

        asked, square, multiply, goes_on, done = (builder.append_basic_block(name) for name in ("asked", "square", "multiply", "goes_on", "done"))
        builder.branch(asked)
        builder.position_at_end(asked)
        now = builder.load(place)
        builder.cbranch(builder.icmp_signed(">", now, none), square, done)
        builder.position_at_end(square)
        multiplied([Eight(builder, builder.load(power)) for power in powers])
        builder.cbranch(builder.icmp_signed("!=", builder.and_(now, args[0]), none), multiply, goes_on)
        builder.position_at_end(multiply)
        multiplied([rows.read(2, none, R_V + start) for start in starts])
        builder.branch(goes_on)
        builder.position_at_end(goes_on)
        builder.store(builder.ashr(now, ir.Constant(LONG, 1)), place)
        builder.branch(asked)
        builder.position_at_end(done)
        multiplied([rows.read(2, none, FRONT + start) for start in starts])
        for power, start in zip(powers, starts):
            rows.write(3, args[4], Eight(builder, builder.load(power)), start)
        return context.get_dummy_value()

    return types.void(exponent, bit, room, s, si), body


@kernel(forceinline=True)
def glows(k, lights):
    """Whether light k has a highlight."""
    return lights[k, SPECULAR] + lights[k, SPECULAR + 1] + lights[k, SPECULAR + 2] > f4(0)


@kernel(noalias=True)
def second_bit(exponent):
    """Half of the largest power of two in a whole number >= 1."""
    bit = 1
    while 2 * bit <= exponent:
        bit *= 2
    return bit // 2


@kernel(noalias=True, fastmath=False)
def dot_lights(m, has_rays, keeps, lights, slots, mattes, row, column, least, x, y, up, Z, N, plate, tones, room, e, s, out):
    """m pixels of a row of a picture under one light or several.

    lights, slots : tables of light_table.py;  mattes : (k, H, W), of which the pixels begin at (row, column);  least : (lights,), below which
    R.V is dark;  x, y : rays, or x and the row's `up` for a pinhole;  Z, N, plate, out : PIXELS or more;  room : (ROOM,);
    e, s : (lights, PIXELS or more) strengths, of the whole row if it `keeps` them for layers, else written again and again."""
    # Arrays are taken here as they came: each slice of one would count its owners, which costs as much as a group of pixels.
    n = max(m, PIXELS)
    wide = e.shape[1]
    for start in range(0, n, PIXELS):
        first = min(start, n - PIXELS)  # the last ones overlap those before them
        for k in range(lights.shape[0]):
            at = k * wide + first if keeps else 0
            if has_rays:
                for i in range(0, PIXELS, GROUP):
                    _faced_by_rays(x, y, Z, N, first + i, lights[k, 0], lights[k, 1], lights[k, 2], lights[k, IS_PLACE], room, i)
            else:
                for i in range(0, PIXELS, GROUP):
                    _faced_by_pinhole(x, up, Z, N, first + i, lights[k, 0], lights[k, 1], lights[k, 2], lights[k, IS_PLACE], room, i)
            matte = slots[k, MATTE]
            if matte >= 0:
                if m < PIXELS:
                    for i in range(m):
                        share = mattes[matte, row, column + i]
                        room[LIT + i] = share if share > f4(0) else f4(0)
                else:
                    begins = (matte * mattes.shape[1] + row) * mattes.shape[2] + column + first
                    for i in range(0, PIXELS, GROUP):
                        _held(mattes, begins + i, room, i)
                for i in range(0, PIXELS, GROUP):
                    _shone_on_held(
                        room, i, lights[k, WRAP_SCALE], lights[k, WRAP_OFFSET], lights[k, FALL_NONE], lights[k, FALL_LINEAR],
                        lights[k, FALL_SQUARE], least[k], e, at + i,
                    )  # fmt: skip
            else:
                for i in range(0, PIXELS, GROUP):
                    _shone_on_free(
                        room, i, lights[k, WRAP_SCALE], lights[k, WRAP_OFFSET], lights[k, FALL_NONE], lights[k, FALL_LINEAR],
                        lights[k, FALL_SQUARE], least[k], e, at + i,
                    )  # fmt: skip
            if glows(k, lights):
                exponent = int(lights[k, EXPONENT])
                _raised(exponent, second_bit(exponent), room, s, at)
            else:
                for i in range(0, PIXELS, GROUP):
                    _dark(s, at + i)
            if k == 0:
                for i in range(0, PIXELS, GROUP):
                    relit(e, s, at + i, plate, 3 * (first + i), tones, 0, out, 3 * (first + i))
            else:
                for i in range(0, PIXELS, GROUP):
                    relit_more(e, s, at + i, plate, 3 * (first + i), tones, k * TONES, out, 3 * (first + i))
