"""One number a pixel spread over its three channels: rows of light onto a plate, and into layers.

In: rows of strengths, a value a pixel, padded to whole groups; flat rows of pictures, three values a pixel; colours as patterns.
Out: flat rows of pictures.
A compiler left alone takes a flat row apart into three and puts it together again, three dozen shuffles for eight pixels, a fifth of one light's
time.  Here the row stays as it is, and eight strengths become 24 by three shuffles.  What does not fill a group of eight goes through the same
code in a small room, so a pixel's bits do not depend on where its row was cut."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from stereorelight.engine.fastmath import kernel

# As `light.LEAVES`, of fastmath.py.
FASTMATH = "66c93d0f0531acee"
GROUP = 8  # pixels
VALUES = 3 * GROUP
TONES = 3 * VALUES  # of gain, diffuse and specular
ROOM = 2 * VALUES
MOST = 1e30  # no colour is as bright: beyond it, infinite and NaN, a plate gives no light back
_FUSED = ("contract",)
_GROUP = ir.VectorType(ir.FloatType(), GROUP)
_PIXELS = [[0, 0, 0, 1, 1, 1, 2, 2], [2, 3, 3, 3, 4, 4, 4, 5], [5, 5, 6, 6, 6, 7, 7, 7]]  # of which each of the 24 values takes its strength


class _Rows:
    """Vectors from and to flat rows, inside an intrinsic."""

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.builder, self.context = builder, context
        self.data = [
            context.make_array(kind)(context, builder, array).data if isinstance(kind, types.Array) else array
            for kind, array in zip(signature.args, args)
        ]

    def place(self, row: int, index: Any, part: int = 0) -> Any:
        at = self.builder.add(index, ir.Constant(ir.IntType(64), GROUP * part))
        return self.builder.bitcast(self.builder.gep(self.data[row], [at]), _GROUP.as_pointer())

    def read(self, row: int, index: Any, part: int = 0) -> Any:
        return self.builder.load(self.place(row, index, part), align=4)

    def tone(self, row: int, which: int, part: int) -> Any:
        return self.read(row, ir.Constant(ir.IntType(64), VALUES * which), part)

    def spread(self, strengths: Any, part: int) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), GROUP), _PIXELS[part])
        return self.builder.shuffle_vector(strengths, ir.Constant(_GROUP, ir.Undefined), mask)

    def given_back(self, color: Any, light: Any) -> Any:
        """color * light, 0 where the colour is none."""
        size = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(_GROUP, [_GROUP]), "llvm.fabs.v8f32")
        is_one = self.builder.fcmp_ordered("<", self.builder.call(size, [color]), ir.Constant(_GROUP, [MOST] * GROUP))
        return self.builder.select(is_one, self.builder.fmul(color, light, flags=_FUSED), ir.Constant(_GROUP, [0.0] * GROUP))

    def write(self, row: int, index: Any, part: int, value: Any, past_caches: bool) -> None:
        store = self.builder.store(value, self.place(row, index, part), align=4 * GROUP if past_caches else 4)
        if past_caches:
            store.set_metadata("nontemporal", self.builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)]))


@intrinsic
def _relit(typingctx, e, s, i, plate, at, tones, out, to):
    """A group of the plate with light on it."""

    def body(context, builder, signature, args):
        rows = _Rows(context, builder, signature, args)
        diffuse, specular = rows.read(0, args[2]), rows.read(1, args[2])
        for part in range(3):
            color = rows.read(3, args[4], part)
            lit = rows.given_back(color, builder.fmul(rows.spread(diffuse, part), rows.tone(5, 1, part), flags=_FUSED))
            glow = builder.fmul(rows.spread(specular, part), rows.tone(5, 2, part), flags=_FUSED)
            held = builder.fmul(color, rows.tone(5, 0, part), flags=_FUSED)
            rows.write(6, args[7], part, builder.fadd(held, builder.fadd(lit, glow, flags=_FUSED), flags=_FUSED), past_caches=False)
        return context.get_dummy_value()

    return types.void(e, s, i, plate, at, tones, out, to), body


def _layer_of(past_caches: bool, diffuse: bool) -> Any:
    """The intrinsic that makes a group of a diffuse or a specular layer, to memory that begins with a vector where `past_caches`."""

    @intrinsic
    def group(typingctx, strengths, i, albedo, at, tones, out, to):
        def body(context, builder, signature, args):
            rows = _Rows(context, builder, signature, args)
            strength = rows.read(0, args[1])
            for part in range(3):
                light = rows.spread(strength, part)
                light = rows.given_back(rows.read(2, args[3], part), light) if diffuse else light
                light = builder.fmul(light, rows.tone(4, 1 if diffuse else 2, part), flags=_FUSED)
                rows.write(5, args[6], part, light, past_caches)
            return context.get_dummy_value()

        return types.void(strengths, i, albedo, at, tones, out, to), body

    return group


_diffuse, _diffuse_past, _specular, _specular_past = _layer_of(False, True), _layer_of(True, True), _layer_of(False, False), _layer_of(True, False)


@intrinsic
def _off_group(typingctx, row):
    """By how many values a row begins before a whole vector of memory."""

    def body(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.lshr(builder.ptrtoint(data, ir.IntType(64)), ir.Constant(ir.IntType(64), 2))
        return builder.and_(builder.neg(place), ir.Constant(ir.IntType(64), GROUP - 1))

    return types.int64(row), body


@kernel(noalias=True)
def paint(gain, diffuse_r, diffuse_g, diffuse_b, specular_r, specular_g, specular_b, tones):
    """The colours of the plate's gain, the diffuse light and the highlight as patterns of a group.   gain : (3,);  tones : (TONES,), written."""
    for i in range(0, VALUES, 3):
        for c in range(3):
            tones[i + c] = gain[c]
        tones[VALUES + i] = diffuse_r
        tones[VALUES + i + 1] = diffuse_g
        tones[VALUES + i + 2] = diffuse_b
        tones[2 * VALUES + i] = specular_r
        tones[2 * VALUES + i + 1] = specular_g
        tones[2 * VALUES + i + 2] = specular_b


@kernel(noalias=True)
def relit_row(m, e, s, plate, tones, room, out):
    """plate * gain + (plate * e * diffuse + s * specular) for m pixels.   e, s : (m + GROUP or more,);  room : (ROOM,)."""
    whole = m // GROUP * GROUP
    for i in range(0, whole, GROUP):
        _relit(e, s, i, plate, 3 * i, tones, out, 3 * i)
    if whole < m:
        for k in range(3 * (m - whole)):
            room[k] = plate[3 * whole + k]
        _relit(e, s, whole, room, 0, tones, room, VALUES)
        for k in range(3 * (m - whole)):
            out[3 * whole + k] = room[VALUES + k]


@kernel(forceinline=True)
def _some(first, end, diffuse, strengths, albedo, tones, room, out):
    """Fewer pixels than a group of a layer, in a room."""
    if diffuse:
        for k in range(3 * (end - first)):
            room[k] = albedo[3 * first + k]
        _diffuse(strengths, first, room, 0, tones, room, VALUES)
    else:
        _specular(strengths, first, room, 0, tones, room, VALUES)
    for k in range(3 * (end - first)):
        out[3 * first + k] = room[VALUES + k]


@kernel(noalias=True)
def layer_row(m, streams, diffuse, strengths, albedo, tones, room, out):
    """albedo * strength * diffuse, or strength * specular, for m pixels of a layer.

    streams : past the caches; call `stream.streamed` once all is written.   strengths : (m + GROUP or more,)."""
    # A vector of memory begins 3 i values on: 3 is its own inverse among the eight.
    start = min(_off_group(out) * 3 % GROUP, m) if streams else 0
    if start > 0:
        _some(0, start, diffuse, strengths, albedo, tones, room, out)
    whole = start + (m - start) // GROUP * GROUP
    if streams and diffuse:
        for i in range(start, whole, GROUP):
            _diffuse_past(strengths, i, albedo, 3 * i, tones, out, 3 * i)
    elif streams:
        for i in range(start, whole, GROUP):
            _specular_past(strengths, i, albedo, 3 * i, tones, out, 3 * i)
    elif diffuse:
        for i in range(start, whole, GROUP):
            _diffuse(strengths, i, albedo, 3 * i, tones, out, 3 * i)
    else:
        for i in range(start, whole, GROUP):
            _specular(strengths, i, albedo, 3 * i, tones, out, 3 * i)
    if whole < m:
        _some(whole, m, diffuse, strengths, albedo, tones, room, out)
