"""Two rigs apart, as one self-contained HTML page: the figures, and maps over the frame.

In: a `RigDifference`.  Out: the page's text.  Drawings are SVG made here from numbers; nothing is fetched from anywhere."""

from __future__ import annotations

import numpy as np

from stereorelight import __version__
from stereorelight.arrays import Float64
from stereorelight.camera import Rig
from stereorelight.compare.rigs import EyeDifference, RigDifference, spread
from stereorelight.shot.check_page import page_template

LEAST = 1e-3  # of the unit: rounding is not drawn as if it were something
LOW, MIDDLE, HIGH = (58, 128, 201), (30, 33, 38), (224, 112, 88)  # less than the truth, the same, more
ARROWS = 17  # columns of arrows


def _colour(share: float) -> str:
    end = HIGH if share > 0 else LOW
    t = min(abs(share), 1.0)
    return "#" + "".join(f"{round(a + (b - a) * t):02x}" for a, b in zip(MIDDLE, end))


def _cells(values: Float64, size: tuple[int, int], top: float) -> list[str]:
    rows, columns = values.shape
    w, h = size[0] / columns, size[1] / rows
    return [
        f'<rect x="{c * w:.1f}" y="{r * h:.1f}" width="{w + 0.5:.1f}" height="{h + 0.5:.1f}" fill="{_colour(float(values[r, c]) / top)}"></rect>'
        for r, c in np.ndindex(rows, columns)
        if np.isfinite(values[r, c])
    ]


def _svg(size: tuple[int, int], parts: list[str]) -> str:
    return f'<svg viewBox="0 0 {size[0]} {size[1]}" role="img">{"".join(parts)}</svg>'


def _top(values: Float64) -> float:
    p95 = spread(values).p95
    return max(p95, LEAST) if np.isfinite(p95) else LEAST


def _arrows(eye: EyeDifference, apart: Float64, size: tuple[int, int]) -> tuple[str, float]:
    """Length as a map and arrows, so many times longer than they are that the 95 % one spans a fourteenth of the frame."""
    times = size[0] / 14 / _top(apart)
    step = max(1, apart.shape[1] // ARROWS)
    stroke = size[0] / 450
    lines = [
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{x + times * dx:.1f}" y2="{y + times * dy:.1f}" stroke="#e4e6e8" stroke-width="{stroke:.2f}"></line>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{1.2 * stroke:.2f}" fill="#e4e6e8"></circle>'
        for (x, y), (dx, dy) in zip(eye.pixels[::step, ::step].reshape(-1, 2).tolist(), apart[::step, ::step].reshape(-1, 2).tolist())
        if np.isfinite(dx) and np.isfinite(dy)
    ]
    return _svg(size, _cells(np.hypot(apart[..., 0], apart[..., 1]), size, _top(apart)) + lines), times


def _drawings(difference: RigDifference, truth: Rig) -> list[tuple[str, str]]:
    made = []
    for name, eye, camera in (("left", difference.left, truth.left), ("right", difference.right, truth.right)):
        for words, apart in (("as it stands", eye.apart_px), ("turned to fit", eye.turned_px)):
            svg, times = _arrows(eye, apart, camera.size)
            made.append((f"{name} lens, {words}: brightest from {_top(apart):.3g} px; arrows {times:.3g} times longer than they are", svg))
    for pair in difference.pairs:
        for words, values, unit in (("rows", pair.vertical_px, "px"), ("disparity", pair.disparity_px, "px"), ("depth", pair.depth_mm, "mm")):
            top = _top(values)
            caption = f"{words} at {pair.distance_m:g} m: blue {-top:.3g}, dark 0, red {top:+.3g} {unit} and beyond; empty: not seen by both"
            made.append((caption, _svg(truth.left.size, _cells(values, truth.left.size, top))))
    return made


def compare_rigs_page(difference: RigDifference, truth: Rig, *, result: str, truth_name: str) -> str:
    """The page of `difference`; the names are those of the two files."""
    return page_template("compare_rigs.html.j2").render(
        result=result, truth=truth_name, text=difference.text(), drawings=_drawings(difference, truth), version=__version__
    )
