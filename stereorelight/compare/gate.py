"""Gates: conditions on figures that a farm or CI stops at.

In: "bad2<3, normal_median<6, bad2@near_edges<20" and the figures of a comparison.  Out: what was asked, what was found, whether it holds.

A name alone speaks of region "all"; `@region` names another.  A figure without a value holds no gate."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from stereorelight.compare.figures import Figure
from stereorelight.errors import GateError, ShotError, nearest_hint

OPERATORS: dict[str, Callable[[float, float], bool]] = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}
CONDITION = re.compile(r"\s*([A-Za-z][\w.%]*)\s*(?:@\s*([\w.\-+]+))?\s*(<=|>=|<|>)\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([%A-Za-z]*)\s*")
UNITS = ("px", "m", "%", "deg")  # tried in this order behind a bare average, rms or A90
ALIASES = {"avg": "average"}


@dataclass(frozen=True, kw_only=True)
class Condition:
    """`name@region sign limit`, as it was written in `text`."""

    text: str
    name: str
    region: str
    sign: str
    limit: float


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A condition, the figure it was held against, and whether it holds."""

    condition: Condition
    figure: Figure
    holds: bool

    def words(self) -> str:
        """`bad2 < 3: found 4.71 %`."""
        f = self.figure
        found = f"{f.value:.4g} {f.unit}".rstrip() if np.isfinite(f.value) else "no value"
        return f"{self.condition.text}: found {found}"


def parse_gate(text: str) -> tuple[Condition, ...]:
    """The conditions of "bad2<3,normal_median<6".  Raises ShotError where one is no condition."""
    conditions = []
    for piece in text.split(","):
        found = CONDITION.fullmatch(piece)
        try:
            limit = float(found[4]) if found else np.nan
        except ValueError:
            limit = np.nan
        if not found or not np.isfinite(limit):
            raise ShotError(f"gate {piece.strip()!r} is no condition; write for example --gate 'bad2<3,normal_median<6' or 'bad2@near_edges<20'")
        conditions.append(Condition(text=piece.strip(), name=found[1], region=found[2] or "all", sign=found[3], limit=limit))
    return tuple(conditions)


def _figure(condition: Condition, figures: list[Figure]) -> Figure:
    name = condition.name.removesuffix("_percent") if not any(f.name == condition.name for f in figures) else condition.name
    name = ALIASES.get(name, name)
    tried = [name, *(f"{name}_{unit}" for unit in UNITS)]
    named = next((found for t in tried if (found := [f for f in figures if f.name == t])), [])
    if not named:
        known = dict.fromkeys(f.name for f in figures)
        pixels = "; figures in pixels of depth need --rig" if re.fullmatch(r"bad[\d.]+|.*_px", name) and "average_m" in known else ""
        raise ShotError(f"gate {condition.text!r}: there is no figure {condition.name!r} here{nearest_hint(condition.name, known)}{pixels}")
    for f in named:
        if f.region == condition.region:
            return f
    hint = nearest_hint(condition.region, (f.region for f in named))
    raise ShotError(f"gate {condition.text!r}: {named[0].name} has no region {condition.region!r}{hint}")


def verdicts(conditions: Iterable[Condition], figures: Iterable[Figure]) -> tuple[Verdict, ...]:
    """Each condition against its figure.  Raises ShotError where there is no such figure or region, with the nearest name."""
    listed = list(figures)
    out = []
    for condition in conditions:
        f = _figure(condition, listed)
        holds = bool(np.isfinite(f.value)) and OPERATORS[condition.sign](f.value, condition.limit)
        out.append(Verdict(condition=condition, figure=f, holds=holds))
    return tuple(out)


def hold(found: Iterable[Verdict]) -> None:
    """Raise GateError in one line that names every gate that does not hold, and what was found."""
    fallen = [v.words() for v in found if not v.holds]
    if fallen:
        raise GateError("; ".join(fallen))
