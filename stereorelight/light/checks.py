"""What the values of a table must be: numbers in a span, vectors, flags, words; each refused with its owner's name and the remedy.

`Checked` is a base for frozen dataclasses: `_word_for_it` says who complains, such as "light 'key'"."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any, ClassVar

import numpy as np

from stereorelight.errors import ShotError, nearest_hint

Vector = tuple[float, float, float]


def is_number(value: object) -> bool:
    """Whether `value` is one number; true and false are none."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


class Checked:
    """Checks for the fields of a frozen dataclass; each puts the value back as plain floats."""

    what: ClassVar[str] = "table"  # such as "matte"
    name: str

    def _error(self, key: str, wanted: str, came: str, remedy: str = "") -> ShotError:
        return ShotError(f"{self.what} {self.name!r}: {key} {wanted}, got {came}" + (f"; {remedy}" if remedy else ""))

    def _number(self, key: str, *, low: float = -math.inf, high: float = math.inf, remedy: str = "") -> None:
        value = getattr(self, key)
        if not is_number(value) or not math.isfinite(value) or not low <= value <= high:
            span = f", {low:g} ... {high:g}" if math.isfinite(high) else (f", at least {low:g}" if math.isfinite(low) else ", finite")
            raise self._error(key, f"must be a number{span}", repr(value), remedy)
        object.__setattr__(self, key, float(value))

    def _vector(self, key: str, *, low: float = -1e6, high: float = 1e6, remedy: str = "") -> None:
        value = getattr(self, key)
        numbers = list(value) if isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, str) else []
        if len(numbers) != 3 or not all(is_number(v) for v in numbers):
            raise self._error(key, "must be three numbers, [x, y, z]", repr(value), remedy)
        if not all(math.isfinite(v) and low <= v <= high for v in numbers):
            raise self._error(key, f"must be three numbers in {low:g} ... {high:g}", repr(value), remedy)
        object.__setattr__(self, key, tuple(float(v) for v in numbers))

    def _direction(self, key: str, remedy: str = "") -> None:
        self._vector(key, remedy=remedy)
        if math.hypot(*getattr(self, key)) < 1e-6:
            raise self._error(key, "must not be zero", "no direction", remedy)

    def _flag(self, key: str) -> None:
        if not isinstance(getattr(self, key), (bool, np.bool_)):
            raise self._error(key, "must be true or false", repr(getattr(self, key)))

    def _word(self, key: str, known: Sequence[str]) -> None:
        value = getattr(self, key)
        if value not in known:
            raise ShotError(f"{self.what} {self.name!r}: {key} {value!r} is unknown{nearest_hint(str(value), known)}")


def checked_keys(table: Mapping[str, Any], cls: type, label: str) -> None:
    """Every key of `table` is a field of `cls` or `type`, and none that it needs is missing.  Raises ShotError."""
    known = {f.name: f for f in fields(cls)}
    for key in table:
        if key not in known and key != "type":
            raise ShotError(f"{label}: key {key!r} is unknown{nearest_hint(key, [*known, 'type'])}")
    for key, f in known.items():
        if f.default is MISSING and f.default_factory is MISSING and key not in table:
            raise ShotError(f"{label}: {key} is missing; add it")
