"""Sixteen disparities at a time: the inner loops of engine/support.py, as LLVM vectors.

In, out: flat arrays inside numba kernels and a place in each.  Compilers make single numbers of loops this short, which take four to six
times as long."""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 16
FLOAT, INT, LONG = ir.FloatType(), ir.IntType(32), ir.IntType(64)
FLOATS, INTS, LONGS = (ir.VectorType(t, LANES) for t in (FLOAT, INT, LONG))
VECTOR = {FLOAT: FLOATS, INT: INTS, LONG: LONGS}


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
def back(typingctx, cost, i, share, inverse, front, k, ahead, j):
    """cost[i:] = inverse (front[k:] + ahead[j:]), and ahead[j:] = share (ahead[j:] + what cost was)."""

    def body(context, builder, signature, args):
        cost, i, share, inverse, front, k, ahead, j = args
        kinds = signature.args
        own = _load(context, builder, kinds[0], cost, i, FLOAT)
        beyond = _load(context, builder, kinds[6], ahead, j, FLOAT)
        total = builder.fadd(_load(context, builder, kinds[4], front, k, FLOAT), beyond)
        _store(context, builder, builder.fmul(total, _splat(builder, inverse)), kinds[0], cost, i, FLOAT)
        _store(context, builder, builder.fmul(builder.fadd(beyond, own), _splat(builder, share)), kinds[6], ahead, j, FLOAT)
        return context.get_dummy_value()

    n, f = types.int64, types.float32
    return types.void(cost, n, f, f, front, n, ahead, n), body


def _keys(context, builder, kind, cost, i, keep, index):
    """The bits of positive costs, which order as they do, their lowest ones taken for index + k."""
    bits = builder.bitcast(_load(context, builder, kind, cost, i, FLOAT), INTS)
    number = builder.add(_splat(builder, index), ir.Constant(INTS, list(range(LANES))))
    return builder.or_(builder.and_(bits, _splat(builder, keep)), number)


def _less(builder, a, b):
    return builder.select(builder.icmp_signed("<", a, b), a, b)


@intrinsic
def least(typingctx, cost, i, keep, index):
    """The least of cost[i : i + 16] as an int32 whose lowest bits, those not in `keep`, are its index + k."""

    def body(context, builder, signature, args):
        cost, i, keep, index = args
        keys = _keys(context, builder, signature.args[0], cost, i, keep, index)
        return _call(builder, f"llvm.vector.reduce.smin.v{LANES}i32", INT, keys)

    return types.int32(cost, types.int64, types.int32, types.int32), body


@intrinsic
def take_less(typingctx, cost, i, keep, index, out, o):
    """out[o:] = the lesser of out[o:] and the keys of cost[i:]."""

    def body(context, builder, signature, args):
        cost, i, keep, index, out, o = args
        keys = _keys(context, builder, signature.args[0], cost, i, keep, index)
        before = _load(context, builder, signature.args[4], out, o, INT)
        _store(context, builder, _less(builder, keys, before), signature.args[4], out, o, INT)
        return context.get_dummy_value()

    n, i4 = types.int64, types.int32
    return types.void(cost, n, i4, i4, out, n), body
