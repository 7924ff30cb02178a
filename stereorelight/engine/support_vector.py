"""Sixteen numbers at a time: the inner loops of engine/support.py, and a median of engine/edges.py, as LLVM vectors.

In, out: flat arrays inside numba kernels and a place in each.  Compilers make single numbers of loops this short, which take four to six
times as long."""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 16
PLACES = 2 * LANES  # of `weighted_median`
MOST_VALUES = 25  # of them that may be used
FLOAT, SHORT, INT, LONG = ir.FloatType(), ir.IntType(16), ir.IntType(32), ir.IntType(64)
FLOATS, SHORTS, INTS, LONGS = (ir.VectorType(t, LANES) for t in (FLOAT, SHORT, INT, LONG))
VECTOR = {FLOAT: FLOATS, SHORT: SHORTS, INT: INTS, LONG: LONGS}


def _at(context, builder, array_type, array, index, scalar):
    return builder.gep(context.make_array(array_type)(context, builder, array).data, [index], source_etype=scalar)


def _load(context, builder, array_type, array, index, scalar):
    place = _at(context, builder, array_type, array, index, scalar)
    return builder.load(builder.bitcast(place, VECTOR[scalar].as_pointer()), align=4, typ=VECTOR[scalar])


def _store(context, builder, value, array_type, array, index, scalar):
    place = _at(context, builder, array_type, array, index, scalar)
    builder.store(value, builder.bitcast(place, VECTOR[scalar].as_pointer()), align=4)


def _splat(builder, value):
    vector = VECTOR[value.type]
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(INT, 0))
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), ir.Constant(INTS, [0] * LANES))


def _call(builder, name, result, *args):
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, [a.type for a in args]), name)
    return builder.call(function, args)


def _capped(builder, value, cap):
    """The lesser of both; the cap where the value is NaN."""
    return builder.select(builder.fcmp_ordered("<", value, cap), value, cap)


def _whole(context, builder, kind, cost, i):
    """Sixteen whole numbers as float."""
    return builder.uitofp(builder.zext(_load(context, builder, kind, cost, i, SHORT), INTS), FLOATS)


def _mean(context, builder, signature, args):
    """inverse (front[k:] + ahead[j:]) of the arguments of `back`."""
    kinds = signature.args
    front, ahead = _load(context, builder, kinds[4], args[4], args[5], FLOAT), _load(context, builder, kinds[6], args[6], args[7], FLOAT)
    return builder.fmul(builder.fadd(front, ahead), _splat(builder, args[3]))


def _go_back(context, builder, signature, args, own):
    """ahead[j:] = share (ahead[j:] + own) of the arguments of `back`."""
    kind, ahead, j = signature.args[6], args[6], args[7]
    beyond = builder.fadd(_load(context, builder, kind, ahead, j, FLOAT), own)
    _store(context, builder, builder.fmul(beyond, _splat(builder, args[2])), kind, ahead, j, FLOAT)


@intrinsic
def costs(typingctx, words, greys, i, word, grey, step, cap, first, pull, limit, out, o):
    """out[o + k] = step (bits of words[i + k] that differ from word) + min(|greys[i + k] - grey|, cap) + min(pull |first - k|, limit)."""

    def body(context, builder, signature, args):
        words, greys, i, word, grey, step, cap, first, pull, limit, out, o = args
        kinds = signature.args
        differ = builder.xor(_load(context, builder, kinds[0], words, i, LONG), _splat(builder, word))
        bits = builder.trunc(_call(builder, f"llvm.ctpop.v{LANES}i64", LONGS, differ), INTS)
        cost = builder.fmul(builder.sitofp(bits, FLOATS), _splat(builder, step))
        apart = builder.fsub(_load(context, builder, kinds[1], greys, i, FLOAT), _splat(builder, grey))
        cost = builder.fadd(cost, _capped(builder, _call(builder, f"llvm.fabs.v{LANES}f32", FLOATS, apart), _splat(builder, cap)))
        off = builder.fsub(_splat(builder, first), ir.Constant(FLOATS, [float(k) for k in range(LANES)]))
        off = builder.fmul(_call(builder, f"llvm.fabs.v{LANES}f32", FLOATS, off), _splat(builder, pull))
        _store(context, builder, builder.fadd(cost, _capped(builder, off, _splat(builder, limit))), kinds[10], out, o, FLOAT)
        return context.get_dummy_value()

    f = types.float32
    return types.void(words, greys, types.int64, types.uint64, f, f, f, f, f, f, out, types.int64), body


@intrinsic
def fetch(typingctx, cost, i):
    """Have cost[i] (uint16) at hand soon, to be written to."""

    def body(context, builder, signature, args):
        place = builder.bitcast(_at(context, builder, signature.args[0], args[0], args[1], SHORT), ir.IntType(8).as_pointer())
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(ir.VoidType(), [place.type, INT, INT, INT]), "llvm.prefetch.p0")
        builder.call(function, [place, ir.Constant(INT, 1), ir.Constant(INT, 3), ir.Constant(INT, 1)])
        return context.get_dummy_value()

    return types.void(cost, types.int64), body


@intrinsic
def forth(typingctx, cost, i, share, front, j, k):
    """front[k:] = cost[i:] + share front[j:]."""

    def body(context, builder, signature, args):
        cost, i, share, front, j, k = args
        kinds = signature.args
        last = builder.fmul(_load(context, builder, kinds[3], front, j, FLOAT), _splat(builder, share))
        _store(context, builder, builder.fadd(_load(context, builder, kinds[0], cost, i, FLOAT), last), kinds[3], front, k, FLOAT)
        return context.get_dummy_value()

    n = types.int64
    return types.void(cost, n, types.float32, front, n, n), body


@intrinsic
def back(typingctx, cost, i, share, inverse, front, k, ahead, j, out, o):
    """out[o:] = inverse (front[k:] + ahead[j:]) as whole numbers (uint16), and ahead[j:] = share (ahead[j:] + cost[i:])."""

    def body(context, builder, signature, args):
        (cost, i), (out, o) = args[:2], args[8:]
        kinds = signature.args
        own, total = _load(context, builder, kinds[0], cost, i, FLOAT), _mean(context, builder, signature, args)
        whole = builder.fptoui(builder.fadd(total, ir.Constant(FLOATS, [0.5] * LANES)), INTS)
        _store(context, builder, builder.trunc(whole, SHORTS), kinds[8], out, o, SHORT)
        _go_back(context, builder, signature, args, own)
        return context.get_dummy_value()

    n, f = types.int64, types.float32
    return types.void(cost, n, f, f, front, n, ahead, n, out, n), body


@intrinsic
def forth_whole(typingctx, cost, i, share, front, j, k):
    """`forth` of costs that are whole numbers (uint16)."""

    def body(context, builder, signature, args):
        cost, i, share, front, j, k = args
        kinds = signature.args
        last = builder.fmul(_load(context, builder, kinds[3], front, j, FLOAT), _splat(builder, share))
        _store(context, builder, builder.fadd(_whole(context, builder, kinds[0], cost, i), last), kinds[3], front, k, FLOAT)
        return context.get_dummy_value()

    n = types.int64
    return types.void(cost, n, types.float32, front, n, n), body


@intrinsic
def back_whole(typingctx, cost, i, share, inverse, front, k, ahead, j, out, o):
    """out[o:] = inverse (front[k:] + ahead[j:]), and ahead[j:] = share (ahead[j:] + cost[i:]), where costs are whole numbers (uint16)."""

    def body(context, builder, signature, args):
        (cost, i), (out, o) = args[:2], args[8:]
        kinds = signature.args
        own = _whole(context, builder, kinds[0], cost, i)
        _store(context, builder, _mean(context, builder, signature, args), kinds[8], out, o, FLOAT)
        _go_back(context, builder, signature, args, own)
        return context.get_dummy_value()

    n, f = types.int64, types.float32
    return types.void(cost, n, f, f, front, n, ahead, n, out, n), body


@intrinsic
def least(typingctx, cost, i, keep, index, out, o):
    """The least of cost[i : i + 16] as an int32 whose lowest bits, those not in `keep`, are its index + k; out[o:] = all of them so.

    The bits of positive costs order as they do.
    """

    def body(context, builder, signature, args):
        cost, i, keep, index, out, o = args
        bits = builder.bitcast(_load(context, builder, signature.args[0], cost, i, FLOAT), INTS)
        number = builder.add(_splat(builder, index), ir.Constant(INTS, list(range(LANES))))
        keys = builder.or_(builder.and_(bits, _splat(builder, keep)), number)
        _store(context, builder, keys, signature.args[4], out, o, INT)
        return _call(builder, f"llvm.vector.reduce.smin.v{LANES}i32", INT, keys)

    n, i4 = types.int64, types.int32
    return types.int32(cost, n, i4, i4, out, n), body


@intrinsic
def take_less(typingctx, a, i, b, j):
    """b[j : j + 16] = the lesser of it and a[i : i + 16], int32."""

    def body(context, builder, signature, args):
        a, i, b, j = args
        new, old = _load(context, builder, signature.args[0], a, i, INT), _load(context, builder, signature.args[2], b, j, INT)
        _store(context, builder, builder.select(builder.icmp_signed("<", new, old), new, old), signature.args[2], b, j, INT)
        return context.get_dummy_value()

    n = types.int64
    return types.void(a, n, b, n), body


def _bits(builder, flags):
    """Sixteen flags as the bits of an int64, the first one lowest."""
    return builder.zext(builder.bitcast(flags, SHORT), LONG)


@intrinsic
def lesser(typingctx, a, i, b, j):
    """A bit k, the first one lowest, where a[i + k] < b[j + k], int32."""

    def body(context, builder, signature, args):
        a, i, b, j = args
        kinds = signature.args
        return _bits(builder, builder.icmp_signed("<", _load(context, builder, kinds[0], a, i, INT), _load(context, builder, kinds[2], b, j, INT)))

    n = types.int64
    return types.int64(a, n, b, n), body


@intrinsic
def having(typingctx, a, i, mask, value):
    """A bit k, the first one lowest, where a[i + k] & mask == value, int32."""

    def body(context, builder, signature, args):
        a, i, mask, value = args
        share = builder.and_(_load(context, builder, signature.args[0], a, i, INT), _splat(builder, mask))
        return _bits(builder, builder.icmp_signed("==", share, _splat(builder, value)))

    n, i4 = types.int64, types.int32
    return types.int64(a, n, i4, i4), body


@intrinsic
def first_bit(typingctx, bits):
    """The place of the lowest bit that is set."""

    def body(context, builder, signature, args):
        name = "llvm.cttz.i64"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(LONG, [LONG, ir.IntType(1)]), name)
        return builder.call(function, [args[0], ir.Constant(ir.IntType(1), 1)])

    return types.int64(types.int64), body


@intrinsic
def least_of_rows(typingctx, a, out):
    """out[k] = the least of a[32 i + k] over sixteen i, for 32 k, int32."""

    def body(context, builder, signature, args):
        a, out = args
        for half in (0, LANES):
            total = None
            for i in range(LANES):
                row = _load(context, builder, signature.args[0], a, ir.Constant(LONG, 2 * LANES * i + half), INT)
                total = row if total is None else builder.select(builder.icmp_signed("<", row, total), row, total)
            _store(context, builder, total, signature.args[1], out, ir.Constant(LONG, half), INT)
        return context.get_dummy_value()

    return types.void(a, out), body


@intrinsic
def weighted_median(typingctx, values, shares, half):
    """The least of `MOST_VALUES` values up to which shares of `half` or more lie; unused ones, and the places after them, hold infinity and 0.

    All are compared with all: quicker than sorting so few, since it needs no decision.
    """

    def body(context, builder, signature, args):
        values, shares, half = args
        kinds = signature.args
        wide = [_load(context, builder, kinds[0], values, ir.Constant(LONG, k), FLOAT) for k in (0, LANES)]
        upto = [ir.Constant(FLOATS, [0.0] * LANES)] * 2
        for k in range(MOST_VALUES):
            place = ir.Constant(LONG, k)
            value, share = (
                _splat(builder, builder.load(_at(context, builder, kind, a, place, FLOAT), typ=FLOAT)) for kind, a in zip(kinds, (values, shares))
            )
            for i in (0, 1):
                counts = builder.select(builder.fcmp_ordered("<=", value, wide[i]), share, ir.Constant(FLOATS, [0.0] * LANES))
                upto[i] = builder.fadd(upto[i], counts)
        far = ir.Constant(FLOATS, [float("inf")] * LANES)
        low, high = (builder.select(builder.fcmp_ordered(">=", u, _splat(builder, half)), w, far) for u, w in zip(upto, wide))
        both = builder.select(builder.fcmp_ordered("<", low, high), low, high)
        return _call(builder, f"llvm.vector.reduce.fmin.v{LANES}f32", FLOAT, both)

    return types.float32(values, shares, types.float32), body
