"""Rows written past the caches.

In: a row of float32 that was just made, in the first-level cache.  Out: the same row in a picture.
An ordinary store first fetches the line that it is going to overwrite; for pictures larger than the caches that is a third of all that
moves.  A streaming store does not, but wants whole lines: so a row is made in a small room first, and copied line by line."""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from stereorelight.engine.fastmath import kernel

# As `light.LEAVES`, of fastmath.py.
FASTMATH = "66c93d0f0531acee"
LINE = 16  # values of a cache line of 64 bytes
STREAM_BYTES = 1 << 25  # what is smaller than this may still be in the cache when it is read


@intrinsic
def _off_line(typingctx, array):
    """By how many bytes a row begins before a line."""

    def body(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.ptrtoint(data, ir.IntType(64))
        return builder.and_(builder.neg(place), ir.Constant(ir.IntType(64), 4 * LINE - 1))

    return types.int64(array), body


@intrinsic
def _stream_line(typingctx, source, target, i):
    """A line of values from source[i] on to target[i], which begins a line in memory."""

    def body(context, builder, signature, args):
        line = ir.VectorType(ir.FloatType(), LINE).as_pointer()
        rows = [context.make_array(kind)(context, builder, array).data for kind, array in zip(signature.args, args[:2])]
        read, written = (builder.bitcast(builder.gep(row, [args[2]], inbounds=True), line) for row in rows)
        store = builder.store(builder.load(read, align=4), written, align=4 * LINE)
        store.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)]))
        return context.get_dummy_value()

    return types.void(source, target, types.intp), body


@intrinsic
def streamed(typingctx):
    """Everything streamed so far is there for other threads to see."""

    def body(context, builder, signature, args):
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), body


@kernel(noalias=True)
def stream(n, source, target):
    """source[:n] to target[:n], past the caches; call `streamed` once all is written."""
    i = min(_off_line(target) >> 2, n)
    for k in range(i):
        target[k] = source[k]
    while i + LINE <= n:
        _stream_line(source, target, i)
        i += LINE
    for k in range(i, n):
        target[k] = source[k]
