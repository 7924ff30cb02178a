"""Eight float32 at a time inside numba kernels, as LLVM vectors that are written down like numbers.

In, out: flat float32 rows of numba arrays, and places in them.  A loop that a compiler turns into vectors itself takes rows of three channels
apart by twice as many shuffles, and says nothing of the order of its steps; here both stand as they are written.  Products and sums may be
fused, and nothing else: roots and divisions are IEEE's, comparisons know of NaN."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils

GROUP = 8
FLOAT, INT, LONG = ir.FloatType(), ir.IntType(32), ir.IntType(64)
FLOATS = ir.VectorType(FLOAT, GROUP)
_INTS = ir.VectorType(INT, GROUP)
_FUSED = ("contract",)
_LEAST = -(1 << 31)


class Eight:
    """Eight numbers, or eight times yes or no."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def _by(self, step: Any, other: Eight, **flags: Any) -> Eight:
        return Eight(self.builder, step(self.value, other.value, **flags))

    def __add__(self, other: Eight) -> Eight:
        return self._by(self.builder.fadd, other, flags=_FUSED)

    def __sub__(self, other: Eight) -> Eight:
        return self._by(self.builder.fsub, other, flags=_FUSED)

    def __mul__(self, other: Eight) -> Eight:
        return self._by(self.builder.fmul, other, flags=_FUSED)

    def __truediv__(self, other: Eight) -> Eight:
        return self._by(self.builder.fdiv, other)

    def __and__(self, other: Eight) -> Eight:
        return self._by(self.builder.and_, other)

    def above(self, other: Eight) -> Eight:
        """Where it is larger; not where either is NaN."""
        return Eight(self.builder, self.builder.fcmp_ordered(">", self.value, other.value))

    def below(self, other: Eight) -> Eight:
        return other.above(self)

    def where(self, given: Eight, otherwise: Eight) -> Eight:
        """Itself where `given` says yes."""
        return Eight(self.builder, self.builder.select(given.value, self.value, otherwise.value))

    def at_least(self, least: Eight) -> Eight:
        """The larger of both; `least` where it is NaN."""
        return self.where(self.above(least), least)

    def _called(self, name: str) -> Eight:
        function = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(FLOATS, [FLOATS]), f"llvm.{name}.v{GROUP}f32")
        return Eight(self.builder, self.builder.call(function, [self.value]))

    def root(self) -> Eight:
        return self._called("sqrt")

    def size(self) -> Eight:
        return self._called("fabs")

    def between(self, low: float, high: float) -> Eight:
        """Where low <= it < high, both positive: two steps on its bits as whole numbers, where comparing twice and `and` take three."""
        first, end = (int.from_bytes(struct.pack("<f", value), "little") for value in (low, high))
        bits = self.builder.bitcast(self.value, _INTS)
        past = self.builder.sub(bits, ir.Constant(_INTS, [first + _LEAST] * GROUP))  # so that what is below comes out on top, as negative numbers do
        return Eight(self.builder, self.builder.icmp_signed("<", past, ir.Constant(_INTS, [end - first + _LEAST] * GROUP)))

    def picked(self, other: Eight, places: Sequence[int]) -> Eight:
        """The numbers at `places` of both, 0..7 its own, 8..15 those of the other."""
        mask = ir.Constant(_INTS, list(places))
        return Eight(self.builder, self.builder.shuffle_vector(self.value, other.value, mask))


class Rows:
    """The arguments of an intrinsic: rows to read and write, and single numbers."""

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.builder = builder
        self.data = [
            context.make_array(kind)(context, builder, array).data if isinstance(kind, types.Array) else array
            for kind, array in zip(signature.args, args)
        ]

    def place(self, row: int, index: Any, further: int = 0, count: int = GROUP) -> Any:
        at = self.builder.gep(self.data[row], [self.builder.add(index, ir.Constant(LONG, further))])
        return self.builder.bitcast(at, ir.VectorType(FLOAT, count).as_pointer())

    def read(self, row: int, index: Any, further: int = 0) -> Eight:
        return Eight(self.builder, self.builder.load(self.place(row, index, further), align=4))

    def read_halves(self, row: int, index: Any, first: int, second: int) -> Eight:
        """Four numbers from `first` on, and four from `second` on."""
        halves = [self.builder.load(self.place(row, index, further, GROUP // 2), align=4) for further in (first, second)]
        return Eight(self.builder, self.builder.shuffle_vector(*halves, ir.Constant(_INTS, list(range(GROUP)))))

    def write(self, row: int, index: Any, value: Eight, further: int = 0, past_caches: bool = False) -> None:
        store = self.builder.store(value.value, self.place(row, index, further), align=4 * GROUP if past_caches else 4)
        if past_caches:
            store.set_metadata("nontemporal", self.builder.module.add_metadata([ir.Constant(INT, 1)]))

    def every(self, argument: int) -> Eight:
        """A single number, eight times."""
        none = ir.Constant(FLOATS, ir.Undefined)
        one = self.builder.insert_element(none, self.data[argument], ir.Constant(INT, 0))
        return Eight(self.builder, self.builder.shuffle_vector(one, none, ir.Constant(_INTS, [0] * GROUP)))

    def number(self, value: float) -> Eight:
        return Eight(self.builder, ir.Constant(FLOATS, [value] * GROUP))

    def three_channels(self, row: int, index: Any) -> tuple[Eight, Eight, Eight]:
        """Eight pixels of a flat row of three channels, each channel for itself."""
        first, second, third = (self.read_halves(row, index, 4 * k, 4 * k + 12) for k in range(3))
        # first holds x0 y0 z0 x1 | x4 y4 z4 x5, second y1 z1 x2 y2 | ..., third z2 x3 y3 z3 | ...
        xy = _in_halves(second, third, (2, 3, 5, 6))  # x2 y2 x3 y3
        yz = _in_halves(first, second, (1, 2, 4, 5))  # y0 z0 y1 z1
        return _in_halves(first, xy, (0, 3, 4, 6)), _in_halves(yz, xy, (0, 2, 5, 7)), _in_halves(yz, third, (1, 3, 4, 7))


def _in_halves(one: Eight, other: Eight, places: Sequence[int]) -> Eight:
    """The same choice within both halves: places 0..3 of `one`, 4..7 of `other`."""
    half = [k if k < 4 else k + 4 for k in places]
    return one.picked(other, [*half, *(k + 4 for k in half)])
