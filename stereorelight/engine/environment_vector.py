"""Four floats at a time: lookups in a padded table and tinted writing, as LLVM vectors.

In, out: float32 rows inside numba kernels.  A table is flat, four floats a texel (red, green, blue, unused), and has a ghost texel
on every side, so that a bilinear lookup needs no test for seams and poles: one index, two loads of neighbours a row.
Gathers of single floats, which compilers make of such loops, cost about three times as much."""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

FLOAT = ir.FloatType()
FOUR = ir.VectorType(FLOAT, 4)
LANE = ir.IntType(32)
FUSED = ("contract",)
BAD = 1e30  # what no plate holds; beyond it, and NaN, counts as 0


def _pointer(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [builder.sext(index, ir.IntType(64)) if index.type.width < 64 else index], source_etype=FLOAT)


def _load(builder, pointer, offset=None):
    if offset is not None:
        pointer = builder.gep(pointer, [offset], source_etype=FLOAT)
    return builder.load(builder.bitcast(pointer, FOUR.as_pointer()), align=4, typ=FOUR)


def _store(builder, value, pointer):
    builder.store(value, builder.bitcast(pointer, FOUR.as_pointer()), align=4)


def _splat(builder, scalar):
    one = builder.insert_element(ir.Constant(FOUR, ir.Undefined), scalar, ir.Constant(LANE, 0))
    return builder.shuffle_vector(one, ir.Constant(FOUR, ir.Undefined), ir.Constant(ir.VectorType(LANE, 4), [0, 0, 0, 0]))


def _between(builder, a, b, t):
    """a + t (b - a): exact where a = b, so that an even map stays even."""
    return builder.fadd(a, builder.fmul(builder.fsub(b, a, flags=FUSED), t, flags=FUSED), flags=FUSED)


def _lookup(context, builder, table_type, table, j, stride, p, q):
    at = _pointer(context, builder, table_type, table, j)
    across, down = _splat(builder, p), _splat(builder, q)
    four = ir.Constant(ir.IntType(64), 4)
    below = builder.gep(at, [builder.sext(stride, ir.IntType(64))], source_etype=FLOAT)
    top = _between(builder, _load(builder, at), _load(builder, at, four), across)
    bottom = _between(builder, _load(builder, below), _load(builder, below, four), across)
    return _between(builder, top, bottom, down)


@intrinsic
def look_up(typingctx, table, j, stride, p, q, out, i):
    """out[i : i + 4] = the table between texel j, its right neighbour and the two below, at the fractions p and q."""

    def body(context, builder, signature, args):
        table, j, stride, p, q, out, i = args
        value = _lookup(context, builder, signature.args[0], table, j, stride, p, q)
        _store(builder, value, _pointer(context, builder, signature.args[5], out, i))
        return context.get_dummy_value()

    return types.void(table, types.int32, types.int32, types.float32, types.float32, out, types.int64), body


@intrinsic
def look_up_between(typingctx, table, j, stride, p, q, t, out, i):
    """out[i : i + 4] goes the share t of the way to what the table holds."""

    def body(context, builder, signature, args):
        table, j, stride, p, q, t, out, i = args
        value = _lookup(context, builder, signature.args[0], table, j, stride, p, q)
        at = _pointer(context, builder, signature.args[6], out, i)
        _store(builder, _between(builder, _load(builder, at), value, _splat(builder, t)), at)
        return context.get_dummy_value()

    return types.void(table, types.int32, types.int32, types.float32, types.float32, types.float32, out, types.int64), body


def _tint(builder, red, green, blue):
    value = ir.Constant(FOUR, ir.Undefined)
    for lane, scalar in enumerate((red, green, blue, red)):
        value = builder.insert_element(value, scalar, ir.Constant(LANE, lane))
    return value


def _write(builder, value, pointer, last):
    """Three floats; four where another pixel follows, which is written next and mends the fourth."""
    with builder.if_else(builder.icmp_signed("!=", last, ir.Constant(last.type, 0))) as (then, otherwise):
        with then:
            for lane in range(3):
                place = builder.gep(pointer, [ir.Constant(ir.IntType(64), lane)], source_etype=FLOAT)
                builder.store(builder.extract_element(value, ir.Constant(LANE, lane)), place, align=4)
        with otherwise:
            _store(builder, value, pointer)


@intrinsic
def write_tinted(typingctx, source, i, k, red, green, blue, out, o, last):
    """out[o : o + 3] = source[i : i + 3] k (red, green, blue).  `last` (int64): 1 where out ends there."""

    def body(context, builder, signature, args):
        source, i, k, red, green, blue, out, o, last = args
        value = _load(builder, _pointer(context, builder, signature.args[0], source, i))
        value = builder.fmul(builder.fmul(value, _splat(builder, k)), _tint(builder, red, green, blue))
        _write(builder, value, _pointer(context, builder, signature.args[6], out, o), last)
        return context.get_dummy_value()

    f = types.float32
    return types.void(source, types.int64, f, f, f, f, out, types.int64, types.int64), body


@intrinsic
def write_on_albedo(typingctx, source, i, k, red, green, blue, albedo, out, o, last):
    """The same times albedo[o : o + 3], each channel of which counts as 0 where it is NaN or infinite."""

    def body(context, builder, signature, args):
        source, i, k, red, green, blue, albedo, out, o, last = args
        value = _load(builder, _pointer(context, builder, signature.args[0], source, i))
        value = builder.fmul(builder.fmul(value, _splat(builder, k)), _tint(builder, red, green, blue))
        at = _pointer(context, builder, signature.args[6], albedo, o)
        is_last = builder.icmp_signed("!=", last, ir.Constant(last.type, 0))
        with builder.if_else(is_last) as (then, otherwise):
            with then:
                lanes = [builder.load(builder.gep(at, [ir.Constant(ir.IntType(64), n)], source_etype=FLOAT), align=4, typ=FLOAT) for n in range(3)]
                alone = _tint(builder, *lanes)
                from_then = builder.block
            with otherwise:
                whole = _load(builder, at)
                from_otherwise = builder.block
        colour = builder.phi(FOUR)
        colour.add_incoming(alone, from_then)
        colour.add_incoming(whole, from_otherwise)
        size = builder.call(cgutils.get_or_insert_function(builder.module, ir.FunctionType(FOUR, [FOUR]), "llvm.fabs.v4f32"), [colour])
        good = builder.fcmp_ordered("<", size, ir.Constant(FOUR, [BAD] * 4))
        colour = builder.select(good, colour, ir.Constant(FOUR, [0.0] * 4))
        _write(builder, builder.fmul(value, colour), _pointer(context, builder, signature.args[7], out, o), last)
        return context.get_dummy_value()

    f = types.float32
    return types.void(source, types.int64, f, f, f, f, albedo, out, types.int64, types.int64), body
