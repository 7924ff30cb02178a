"""Small mathematics for the row kernels: bit casts, powers and angles in float32 that vectorise.

In, out: float32 scalars inside numba kernels.  Each body is a polynomial without branches, since a call into the C
library stops a loop from being vectorised.  Sources: the exponent and mantissa split of Cephes' logf and exp2f, and the
coefficients of its asinf (Moshier 1989)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils
from numba.core.cpu import CPUTargetOptions
from numba.core.options import TargetOptions
from numba.extending import intrinsic

f4 = np.float32
i4 = np.int32

# numba knows how to mark the arrays of a kernel as separate, but not how to be asked for it.  Without the mark each call of a leaf
# with a dozen rows first compares them all with each other, a tenth of its time.
if not hasattr(CPUTargetOptions, "noalias"):
    CPUTargetOptions.noalias = TargetOptions.Mapping("noalias")

# Everything of -ffast-math but `nnan` and `ninf`: with those the compiler may drop the tests that keep NaN in its own pixel.
FAST = {"contract", "afn", "arcp", "nsz", "reassoc"}


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with this engine's flags and the disk cache; without the cache where no folder for it can be written.

    noalias=True : promises that no array that the kernel writes overlaps another of its arrays.  Such a leaf becomes part of whoever calls
                   it: handing over a dozen arrays, seven values each, costs as much as going through 256 pixels of them.
    """

    def compile_lazily(function: Callable[..., Any]) -> Any:
        flags = {"fastmath": FAST, "error_model": "numpy", "nogil": True, "forceinline": options.get("noalias", False), **options}
        try:
            return njit(cache=True, **flags)(function)
        except RuntimeError:  # numba: "no locator available"
            return njit(**flags)(function)

    return compile_lazily


@intrinsic
def bits_of(typingctx, x):
    """The 32 bits of a float32 as int32."""
    return types.int32(types.float32), lambda context, builder, signature, args: builder.bitcast(args[0], ir.IntType(32))


@intrinsic
def float_of(typingctx, i):
    """The float32 whose bits are an int32."""
    return types.float32(types.int32), lambda context, builder, signature, args: builder.bitcast(args[0], ir.FloatType())


@intrinsic
def floor(typingctx, x):
    """Round down, float32 to float32 (math.floor would go through int64)."""

    def body(context, builder, signature, args):
        called = cgutils.get_or_insert_function(builder.module, ir.FunctionType(ir.FloatType(), [ir.FloatType()]), "llvm.floor.f32")
        return builder.call(called, args)

    return types.float32(types.float32), body


@intrinsic
def look_up(typingctx, array, i):
    """array[i] of a flat float32 array for an int32 i >= 0: no wrapping round, and no 64-bit index, for which a vector fetches half as much."""

    def body(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.load(builder.gep(data, [builder.sext(args[1], ir.IntType(64))], inbounds=True))

    return types.float32(array, types.int32), body


@kernel(inline="always")
def exp2(y):
    """2^y for y <= 127; below -126 the smallest normal number."""
    y = f4(-126) if y < f4(-126) else y
    r = floor(y + f4(0.5))
    f = y - r
    p = f * (f4(0.00961812911) + f * (f4(0.00133335581) + f * f4(0.000154035304)))
    p = f4(1) + f * (f4(0.693147181) + f * (f4(0.240226507) + f * (f4(0.0555041087) + p)))
    return p * float_of((i4(r) + i4(127)) << i4(23))


@kernel(inline="always", fastmath=False)
def log2(x):
    """log2 of a positive, normal number."""
    i = bits_of(x)
    e = (i - i4(0x3F3504F3)) >> i4(23)
    m = float_of(i - (e << i4(23)))
    s = (m - f4(1)) / (m + f4(1))
    q = s * s
    return s * (f4(2.885390082) + q * (f4(0.961796694) + q * (f4(0.577078016) + q * (f4(0.412198583) + q * f4(0.320598898))))) + f4(e)


@kernel(inline="always")
def log2_below_one(h):
    """log2(1 - h) for h < 1, exact in the last bits for small h, where 1 - h has lost them."""
    x = f4(1) - h
    x = f4(1e-30) if x < f4(1e-30) else x
    i = bits_of(x)
    e = (i - i4(0x3F3504F3)) >> i4(23)
    m = float_of(i - (e << i4(23)))
    d = -h if e == i4(0) else m - f4(1)
    s = d / (m + f4(1))
    q = s * s
    return s * (f4(2.885390082) + q * (f4(0.961796694) + q * (f4(0.577078016) + q * (f4(0.412198583) + q * f4(0.320598898))))) + f4(e)


@kernel(inline="always")
def power_below_one(h, n):
    """max(0, 1 - h)^n for h >= 0 and n >= 1, relative error below 1e-6 where the result is not vanishing."""
    p = exp2(n * log2_below_one(h))
    return p if h < f4(1) else f4(0)


@kernel(inline="always")
def angle_of_chord(q):
    """The angle (radians, 0..pi) between two unit vectors whose difference has the squared length q: 2 asin(sqrt(q) / 2)."""
    quarter = q * f4(0.25)
    quarter = f4(1) if quarter > f4(1) else quarter
    s = math.sqrt(quarter)
    wide = s > f4(0.5)
    t = (f4(1) - s) * f4(0.5) if wide else quarter
    u = math.sqrt(t)
    p = t * (f4(7.4953002686e-2) + t * (f4(4.5470025998e-2) + t * (f4(2.4181311049e-2) + t * f4(4.2163199048e-2))))
    a = u + u * (t * f4(1.6666752422e-1) + t * p)
    return f4(3.14159265) - f4(4) * a if wide else f4(2) * a
