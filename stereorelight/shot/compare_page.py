"""A comparison as one self-contained HTML page: figures, signed error maps, truth blinked against result, curves, history.

In: a `Measured`.  Out: the page's text.  Pictures are inside it, drawings are SVG made here from numbers, nothing is fetched from
anywhere."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from stereorelight import __version__
from stereorelight.arrays import UInt8
from stereorelight.compare.figures import Curve, ErrorMap, Measured, reduced, tables_of
from stereorelight.compare.gate import Verdict
from stereorelight.compare.report import error_picture
from stereorelight.footage.stills import png_bytes
from stereorelight.shot.check_page import page_template
from stereorelight.shot.compare_history import Run, history_curves, history_rows

MAP_PX, BLINK_PX = 1280, 1280  # widest map and picture on the page
W, H, LEFT, RIGHT, TOP, BOTTOM = 600, 240, 46, 20, 10, 30  # of a drawing, px
COLOURS = ("#7db4e6", "#e8b64c", "#6cc08b", "#ee7465", "#a9a3c4", "#e4e6e8")


def compare_page(
    measured: Measured, *, result: str, truth: str = "", verdicts: Sequence[Verdict] = (), history: Sequence[Run] = (), made: str = ""
) -> str:
    """The page of `measured`.

    result, truth : what was compared, as the user named it.   verdicts : of the gates.   history : earlier runs and this one, the oldest first.
    made          : when, in words.
    """
    return page_template("compare.html.j2").render(
        what=measured.what,
        result=result,
        truth=truth,
        made=made,
        notes=measured.notes,
        verdicts=verdicts,
        tables=tables_of(measured.figures),
        blinks=[(b.title, _source(_smaller(b.truth)), _source(_smaller(b.result))) for b in measured.blinks],
        maps=[_map(m) for m in measured.maps],
        pictures=[(p.title, _source(_smaller(p.picture))) for p in measured.pictures],
        curves=[(c.title, curve_svg(c)) for c in measured.curves],
        history=history_rows(history),
        history_curves=[(c.title, curve_svg(c)) for c in history_curves(history)],
        version=__version__,
    )


def _source(picture: UInt8) -> str:
    return "data:image/png;base64," + base64.b64encode(png_bytes(picture)).decode()


def _smaller(picture: UInt8) -> UInt8:
    """Every k-th pixel, so that it is at most BLINK_PX wide: a picture to look at, with its values as they are."""
    k = -(-picture.shape[1] // BLINK_PX)
    return np.ascontiguousarray(picture[k // 2 :: k, k // 2 :: k]) if k > 1 else picture


def _map(m: ErrorMap) -> dict[str, Any]:
    error = reduced(m.error, widest=MAP_PX)
    known = m.known
    if known is not None and error.shape != known.shape:
        known = np.isfinite(reduced(np.where(known, 0.0, np.nan), widest=MAP_PX))
    picture = error_picture(error, known=known, scale=m.scale, sequential=m.sequential)
    low, high = ("0", f"{m.scale:g}") if m.sequential else (f"-{m.scale:g}", f"+{m.scale:g}")
    return {"title": m.title, "source": _source(picture), "low": low, "high": high, "unit": m.unit, "sequential": m.sequential}


def _ticks(low: float, high: float, *, log: bool) -> list[float]:
    if log:
        powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        ticks = [10.0**p for p in powers] if len(powers) > 3 else [m * 10.0**p for p in powers for m in (1, 2, 5)]
    else:
        raw = (high - low) / 4
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw)
        ticks = [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
    return [t for t in ticks if low * (1 - 1e-9) <= t <= high * (1 + 1e-9) or low <= t <= high]


def _range(values: list[float], *, log: bool) -> tuple[float, float]:
    known = [v for v in values if math.isfinite(v) and (v > 0 or not log)]
    if not known:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = min(known), max(known)
    if log:
        return low, max(high, low * 2)
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def curve_svg(curve: Curve) -> str:
    """The lines of `curve` with axes and a legend, as SVG."""
    xs = [float(x) for line in curve.lines.values() for x in line[0]]
    ys = [float(y) for line in curve.lines.values() for y in line[1]]
    limits = [] if curve.limit is None else [curve.limit]
    x0, x1 = _range(xs, log=curve.log_x)
    y0, y1 = curve.y_range or _range([0.0, *ys, *limits], log=False)

    def place(x: float, y: float) -> tuple[float, float]:
        across = math.log(x / x0) / math.log(x1 / x0) if curve.log_x else (x - x0) / (x1 - x0)
        return LEFT + across * (W - LEFT - RIGHT), H - BOTTOM - (y - y0) / (y1 - y0) * (H - TOP - BOTTOM)

    parts: list[str] = []
    for t in _ticks(y0, y1, log=False):
        _, y = place(x0, t)
        parts.append(f'<line x1="{LEFT}" y1="{y:.1f}" x2="{W - RIGHT}" y2="{y:.1f}" class="grid"></line>')
        parts.append(f'<text x="{LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{t:g}</text>')
    for t in _ticks(x0, x1, log=curve.log_x):
        x, _ = place(t, y0)
        parts.append(f'<line x1="{x:.1f}" y1="{TOP}" x2="{x:.1f}" y2="{H - BOTTOM}" class="grid"></line>')
        parts.append(f'<text x="{x:.1f}" y="{H - BOTTOM + 14}" text-anchor="middle">{t:g}</text>')
    parts.append(f'<text x="{W - RIGHT}" y="{H - 3}" text-anchor="end">{escape(curve.x_label)}</text>')
    parts.append(f'<text x="{LEFT}" y="{H - 3}">{escape(curve.y_label)}</text>')
    if curve.diagonal:
        (ax, ay), (bx, by) = place(max(x0, y0), max(x0, y0)), place(min(x1, y1), min(x1, y1))
        parts.append(f'<line x1="{ax:.1f}" y1="{ay:.1f}" x2="{bx:.1f}" y2="{by:.1f}" class="limit"></line>')
    if curve.limit is not None:
        _, y = place(x0, curve.limit)
        parts.append(f'<line x1="{LEFT}" y1="{y:.1f}" x2="{W - RIGHT}" y2="{y:.1f}" class="limit"></line>')
    for k, (name, (line_x, line_y)) in enumerate(curve.lines.items()):
        colour = COLOURS[k % len(COLOURS)]
        parts += [_polyline(run, colour) for run in _runs(curve, line_x, line_y, place)]
        if len(curve.lines) > 1:
            y = TOP + 14 + 15 * k
            parts.append(f'<line x1="{LEFT + 10}" y1="{y - 4}" x2="{LEFT + 26}" y2="{y - 4}" stroke="{colour}" stroke-width="2"></line>')
            parts.append(f'<text x="{LEFT + 32}" y="{y}">{escape(name)}</text>')
    return f'<svg viewBox="0 0 {W} {H}" role="img" aria-label="{escape(curve.title)}">{"".join(parts)}</svg>'


def _runs(curve: Curve, xs: Sequence[float], ys: Sequence[float], place: Any) -> list[list[tuple[float, float]]]:
    """The points of a line, broken where a value is missing."""
    runs: list[list[tuple[float, float]]] = [[]]
    for x, y in zip(xs, ys):
        if math.isfinite(x) and math.isfinite(y) and (x > 0 or not curve.log_x):
            runs[-1].append(place(float(x), float(y)))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def _polyline(run: Sequence[tuple[float, float]], colour: str) -> str:
    if len(run) == 1:
        return f'<circle cx="{run[0][0]:.1f}" cy="{run[0][1]:.1f}" r="2.5" fill="{colour}"></circle>'
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in run)
    return f'<polyline fill="none" stroke="{colour}" stroke-width="1.6" points="{points}"></polyline>'
