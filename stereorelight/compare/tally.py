"""Errors counted: figures of one frame exactly, of a shot in flat memory, and cumulative curves.

In: absolute errors (n,), NaN where there is no answer.  Out: a `Tally` of counts and sums; tallies of frames add up.
A pixel without an answer counts as bad and as infinitely wrong in the quantiles, so that matching less never looks better; average
and RMS are over the answered pixels, and `cover_percent` says how many those are.

Of one frame, quantiles are exact.  Of several they come from a histogram of `BINS` logarithmic bins between 1e-7 and 1e5, and are off by
less than one bin, 0.7 % of the error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool
from stereorelight.compare.figures import Figure, Points, plain

QUANTILES = (50, 90, 95, 99)
BINS, LOW, HIGH = 4096, 1e-7, 1e5
STEP = np.log(HIGH / LOW) / BINS
NO_VALUE = float("nan")
Groups = dict[str, dict[str, "Tally"]]  # what is measured to region to its tally


@dataclass(frozen=True, kw_only=True)
class RegionFigures:
    """Figures of one region.

    unit          : px, m, % (of the true Z) or deg.
    pixels        : how many pixels of the region have known truth.
    cover_percent : share of those that have an answer.
    bad_percent   : threshold to share of those that are off by more, or have no answer.
    average, rms  : of the absolute error, over answered pixels; NaN where there is none.
    quantiles     : q to the error that q % of the pixels stay within; inf where so many have no answer.
    """

    unit: str
    pixels: int
    cover_percent: float
    bad_percent: Mapping[float, float]
    average: float
    rms: float
    quantiles: Mapping[int, float]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, None where there is none; keys such as bad2_percent, average_px, A90_px."""
        unit = {"%": "percent"}.get(self.unit, self.unit)
        out: dict[str, Any] = {"pixels": self.pixels, "cover_percent": self.cover_percent}
        out |= {f"bad{threshold:g}{'' if unit == 'px' else unit}_percent": share for threshold, share in self.bad_percent.items()}
        out |= {f"average_{unit}": self.average, f"rms_{unit}": self.rms}
        out |= {f"A{q}_{unit}": value for q, value in self.quantiles.items()}
        return {key: plain(value) if isinstance(value, float) else value for key, value in out.items()}

    def figures(self, table: str, region: str, *, prefix: str = "") -> list[Figure]:
        """The same as figures of a row; names as gates take them: bad2, bad0.05m, average_m, A90_px, cover."""
        bad = {f"{prefix}bad{t:g}{'' if self.unit == 'px' else self.unit}": share for t, share in self.bad_percent.items()}
        out = [
            Figure(name="pixels", value=float(self.pixels), table=table, region=region, digits=0),
            Figure(
                name=f"{prefix}cover", value=self.cover_percent, unit="%", table=table, region=region, digits=2, column="cover", high_is_good=True
            ),
        ]
        for name, share in bad.items():
            column = name.removeprefix(prefix)
            out.append(Figure(name=name, value=share, unit="%", table=table, region=region, digits=2, column=column))
        rest = {"average": (self.average, f"avg {self.unit}"), "rms": (self.rms, "rms")} | {f"A{q}": (v, f"A{q}") for q, v in self.quantiles.items()}
        for name, (value, column) in rest.items():
            out.append(Figure(name=f"{prefix}{name}_{self.unit}", value=value, unit=self.unit, table=table, region=region, column=column))
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Tally:
    """Counts and sums of the errors of one region; `a + b` are both.

    bad : pixels off by more than each of `thresholds`, or without an answer.   counts : (BINS,) answered pixels by error.
    ranked : the error at each of QUANTILES over all pixels, then the median of the answered; exact, and None where frames were added.
    """

    unit: str
    thresholds: tuple[float, ...]
    pixels: int
    answered: int
    total: float
    squares: float
    bad: tuple[int, ...]
    counts: npt.NDArray[np.int64]
    ranked: tuple[float, ...] | None = None

    @classmethod
    def of(cls, error: npt.NDArray[Any], *, unit: str, thresholds: tuple[float, ...]) -> Tally:
        """The tally of absolute errors (n,), NaN where there is no answer."""
        e = np.asarray(error[np.isfinite(error)], np.float32)  # twice as quick to sort, and the errors of float32 passes are no finer
        n = int(error.size)
        e.sort()
        ranked = [_at(e, rank(q, n)) for q in QUANTILES] + [float(np.median(e)) if e.size else NO_VALUE]
        return cls(
            unit=unit,
            thresholds=thresholds,
            pixels=n,
            answered=e.size,
            total=float(e.sum(dtype=np.float64)),
            squares=float(np.einsum("i,i->", e, e, dtype=np.float64)),
            bad=tuple(n - int(np.searchsorted(e, np.float32(t), side="right")) for t in thresholds),
            counts=np.diff(np.searchsorted(e, EDGES.astype(np.float32), side="right")).astype(np.int64),
            ranked=tuple(ranked),
        )

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            unit=self.unit,
            thresholds=self.thresholds,
            pixels=self.pixels + other.pixels,
            answered=self.answered + other.answered,
            total=self.total + other.total,
            squares=self.squares + other.squares,
            bad=tuple(a + b for a, b in zip(self.bad, other.bad)),
            counts=self.counts + other.counts,
        )

    def _counted(self, at: int) -> float:
        """The error of the pixel of rank `at` by the histogram; inf where it has no answer."""
        if at >= self.answered:
            return np.inf
        return float(CENTRES[int(np.searchsorted(np.cumsum(self.counts), at, side="right"))])

    @property
    def median(self) -> float:
        """Over the answered pixels alone."""
        if self.ranked is not None:
            return self.ranked[-1]
        return self._counted(rank(50, self.answered)) if self.answered else NO_VALUE

    def figures(self) -> RegionFigures:
        """What is said of the region."""
        n, exact = self.pixels, self.ranked
        quantiles = {q: exact[i] if exact else self._counted(rank(q, n)) if n else NO_VALUE for i, q in enumerate(QUANTILES)}
        return RegionFigures(
            unit=self.unit,
            pixels=n,
            cover_percent=100 * self.answered / n if n else NO_VALUE,
            bad_percent={t: 100 * b / n if n else NO_VALUE for t, b in zip(self.thresholds, self.bad)},
            average=self.total / self.answered if self.answered else NO_VALUE,
            rms=float(np.sqrt(self.squares / self.answered)) if self.answered else NO_VALUE,
            quantiles=quantiles,
        )

    def curve(self) -> Points:
        """(error, share of the pixels within it, %), thinned to a hundred points between the 1 % that are nearest and the last answered."""
        shares = 100 * np.cumsum(self.counts) / max(self.pixels, 1)
        top = int(np.searchsorted(shares, shares[-1], side="left"))
        # Not lower than a thousandth of what nearly all keep: how often exactly nothing is off is told by where the line begins.
        least = int(np.searchsorted(EDGES, 1e-3 * EDGES[min(int(np.searchsorted(shares, 0.98 * shares[-1])) + 1, BINS - 1)]))
        low = min(max(int(np.searchsorted(shares, 1.0)), least), top)
        at = np.unique(np.linspace(low, top, 100).round().astype(int))
        return [float(x) for x in EDGES[1:][at]], [float(y) for y in shares[at]]


def _edges() -> npt.NDArray[np.float64]:
    edges = LOW * np.exp(STEP * np.arange(BINS + 1))
    edges[0], edges[-1] = -1.0, np.inf  # 0 and what is beyond belong to the outermost bins
    return edges


EDGES = _edges()
CENTRES = LOW * np.exp(STEP * (np.arange(BINS) + 0.5))
CENTRES[0] = 0.0


def rank(q: float, n: int) -> int:
    """The place among n sorted errors of the smallest that at least q % of them stay within; no interpolation, so that inf stays inf."""
    return max(int(np.ceil(q / 100 * n)) - 1, 0)


def _at(e: npt.NDArray[Any], place: int) -> float:
    return float(e[place]) if place < e.size else np.inf


def tallied(error: npt.NDArray[Any], regions: Mapping[str, Bool], *, unit: str, thresholds: tuple[float, ...]) -> dict[str, Tally]:
    """The tally of absolute `error` (H, W) over the pixels of each region."""
    return {name: Tally.of(error[region], unit=unit, thresholds=thresholds) for name, region in regions.items()}


def added(a: Groups, b: Groups) -> Groups:
    """Both together, group by group and region by region; what one of them lacks is the other's."""
    out: Groups = {}
    for name in dict.fromkeys((*a, *b)):
        one, two = a.get(name, {}), b.get(name, {})
        out[name] = {r: one[r] + two[r] if r in one and r in two else one.get(r) or two[r] for r in dict.fromkeys((*one, *two))}
    return out
