"""The colour of a temperature.

In: kelvin.  Out: linear Rec.709 of luminance 1, white D65.  Up to 4000 K a black body, by the cubic fit of Kim et al. (2002) to
Planck's locus; from 5000 K daylight, the D series of CIE 15; between them, a straight mix of the two chromaticities.  What
lies outside Rec.709 is cut at 0.  6504 K is D65 and white exactly."""

from __future__ import annotations

import numpy as np

COLDEST_K, HOTTEST_K = 1700.0, 25000.0
D65_K = 6504.0
LUMINANCE = np.array([0.2126390059, 0.7151686788, 0.0721923154])
_TO_709 = np.array(
    [[3.2409699419, -1.5373831776, -0.4986107603], [-0.9692436363, 1.8759675015, 0.0415550574], [0.0556300797, -0.2039769589, 1.0569715142]]
)


def chromaticity(kelvin: float) -> tuple[float, float]:
    """CIE 1931 x, y."""
    share = min(max((kelvin - 4000) / 1000, 0.0), 1.0)
    found = np.zeros(2)
    if share < 1:
        found += (1 - share) * np.array(_black_body(kelvin))
    if share > 0:
        found += share * np.array(_daylight(kelvin))
    return float(found[0]), float(found[1])


def _black_body(kelvin: float) -> tuple[float, float]:
    t = 1000 / kelvin
    if kelvin <= 4000:
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910
    else:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390
    if kelvin <= 2222:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif kelvin <= 4000:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    return x, y


def _daylight(kelvin: float) -> tuple[float, float]:
    t = 1000 / kelvin
    if kelvin <= 7000:
        x = ((-4.6070 * t + 2.9678) * t + 0.09911) * t + 0.244063
    else:
        x = ((-2.0064 * t + 1.9018) * t + 0.24748) * t + 0.237040
    return x, (-3.000 * x + 2.870) * x - 0.275


def _linear(kelvin: float) -> np.ndarray:
    x, y = chromaticity(kelvin)
    found: np.ndarray = _TO_709 @ np.array([x / y, 1.0, (1 - x - y) / y])
    return found


def kelvin_color(kelvin: float) -> tuple[float, float, float]:
    """(r, g, b), >= 0, of luminance 1."""
    rgb = np.maximum(_linear(kelvin) / _linear(D65_K), 0.0)
    r, g, b = rgb / (LUMINANCE @ rgb)
    return float(r), float(g), float(b)
