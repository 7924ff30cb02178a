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
from numba.extending import intrinsic

from stereorelight.engine.eights import GROUP, Eight, Rows
from stereorelight.engine.fastmath import kernel

# As `light.LEAVES`, of fastmath.py and eights.py.
FASTMATH = "66c93d0f0531acee"
EIGHTS = "6142f6448ebad24e"
VALUES = 3 * GROUP
TONES = 3 * VALUES  # of gain, diffuse and specular
ROOM = 2 * VALUES
MOST = 1e30  # no colour is as bright: beyond it, infinite and NaN, a plate gives no light back
# Of which pixel each of the 24 values takes its strength, by eights: which two halves of the strengths are read, and which of these numbers.
_HALVES = (0, 0), (0, 4), (4, 4)
_PLACES = (0, 0, 0, 1, 5, 5, 6, 6), (2, 3, 3, 3, 4, 4, 4, 5), (1, 1, 2, 2, 6, 7, 7, 7)


class _Spread(Rows):
    def spread(self, row: int, index: Any, part: int) -> Eight:
        """Strengths of the `part`-th eight of a group's values."""
        strengths = self.read_halves(row, index, *_HALVES[part])
        return strengths.picked(strengths, _PLACES[part])

    def tone(self, row: int, which: int, part: int, first: Any = None) -> Eight:
        """The `part`-th eight of the pattern of gain, diffuse or specular light, of tones that begin at `first`."""
        return self.read(row, ir.Constant(ir.IntType(64), 0) if first is None else first, VALUES * which + GROUP * part)


def _relit_of(more: bool) -> Any:
    """The intrinsic that puts light on a group of the plate: plate * (gain + e * diffuse) + s * specular; or `more` of it on what is there.

    No test for colours that are none: infinite and NaN stay so, whatever light is on them."""

    @intrinsic
    def group(typingctx, e, s, i, plate, at, tones, first, out, to):
        def body(context, builder, signature, args):
            rows = _Spread(context, builder, signature, args)
            for part in range(3):
                diffuse, specular = (rows.spread(row, args[2], part) for row in range(2))
                gain, color, glow = (rows.tone(5, which, part, args[6]) for which in range(3))
                light = diffuse * color if more else diffuse * color + gain
                glow = specular * glow + rows.read(7, args[8], GROUP * part) if more else specular * glow
                rows.write(7, args[8], rows.read(3, args[4], GROUP * part) * light + glow, GROUP * part)
            return context.get_dummy_value()

        return types.void(e, s, i, plate, at, tones, first, out, to), body

    return group


relit, relit_more = _relit_of(False), _relit_of(True)


def _layer_of(past_caches: bool, diffuse: bool) -> Any:
    """The intrinsic that makes a group of a diffuse or a specular layer, to memory that begins with a vector where `past_caches`."""

    @intrinsic
    def group(typingctx, strengths, i, albedo, at, tones, out, to):
        def body(context, builder, signature, args):
            rows = _Spread(context, builder, signature, args)
            for part in range(3):
                light = rows.spread(0, args[1], part)
                if diffuse:
                    color = rows.read(2, args[3], GROUP * part)
                    light = (color * light).where(color.size().below(rows.number(MOST)), rows.number(0))
                rows.write(5, args[6], light * rows.tone(4, 1 if diffuse else 2, part), GROUP * part, past_caches)
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
