"""The health of a pair of plates as one self-contained HTML page.

In: a `Health`.  Out: the page's text; pictures are inside it, and nothing is fetched from anywhere."""

from __future__ import annotations

import base64
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stereorelight import __version__
from stereorelight.footage.stills import png_bytes
from stereorelight.health.finding import Finding

if TYPE_CHECKING:
    from jinja2 import Template

    from stereorelight.shot.check import Health

PAGES = Path(__file__).parent / "pages"
CURVE_W, CURVE_H, CURVE_EDGE = 600, 120, 8


@functools.cache
def page_template(name: str) -> Template:
    """A page of this package; every value that it is given is escaped, since file names may hold anything."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(loader=FileSystemLoader(PAGES), autoescape=True, undefined=StrictUndefined).get_template(name)


def curve(finding: Finding) -> dict[str, Any]:
    """A finding's values frame by frame as SVG points; a frame without a value breaks the line."""
    values = [value for _, value in finding.frames]
    known = [v for v in values if math.isfinite(v)]
    low, high = min([0.0, *known]), max([0.0, *known])
    span = (high - low) or 1.0

    def y(value: float) -> float:
        return round(CURVE_H - CURVE_EDGE - (value - low) / span * (CURVE_H - 2 * CURVE_EDGE), 1)

    lines: list[list[str]] = [[]]
    for i, value in enumerate(values):
        if math.isfinite(value):
            lines[-1].append(f"{round(i / max(len(values) - 1, 1) * CURVE_W, 1)},{y(value)}")
        elif lines[-1]:
            lines.append([])
    numbers = [number for number, _ in finding.frames if number is not None]
    frames = f", frames {numbers[0]}-{numbers[-1]}" if numbers else ""
    caption = f"{finding.name.replace('_', ' ')}: {low:.3g} to {high:.3g} {finding.unit}".rstrip() + frames
    return {"caption": caption, "zero": y(0.0), "lines": [" ".join(line) for line in lines if line]}


def check_page(health: Health) -> str:
    """The page of `health`."""
    pictures = [(caption, base64.b64encode(png_bytes(picture)).decode()) for caption, picture in health.pictures]
    curves = [curve(finding) for finding in _curved(health.findings)]
    return page_template("check.html.j2").render(health=health, pictures=pictures, curves=curves, version=__version__)


def _curved(findings: Sequence[Finding]) -> list[Finding]:
    return [finding for finding in findings if sum(math.isfinite(value) for _, value in finding.frames) > 2]
