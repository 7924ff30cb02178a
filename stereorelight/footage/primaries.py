"""Primaries of RGB spaces, and the matrix from one set to another.

In, out: eight CIE 1931 numbers, (red x, y, green x, y, blue x, y, white x, y), as EXR headers have them.
Where the whites differ, colours are adapted by Bradford (K. Lam 1985; ICC.1:2022 annex E), so that white stays white."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from stereorelight.arrays import Float64

D65, ACES_WHITE = (0.3127, 0.3290), (0.32168, 0.33767)
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
SAME = 1e-3  # files round to two to four digits; the nearest two spaces here, S-Gamut3 and Linear Rec.2020 apart, differ by more
Chromaticities = tuple[float, ...]

# Scene-linear spaces by their name in the studio config.  ITU-R BT.709, BT.2020; SMPTE RP 431-2, ST 2065-1; Academy S-2014-004;
# makers' white papers: ARRI LogC 2017 and LogC4 2022, Sony S-Gamut3 2014, Panasonic V-Log 2014, RED IPP2 2017, Blackmagic 2020-21.
PRIMARIES: Mapping[str, Chromaticities] = MappingProxyType(
    {
        "Linear Rec.709 (sRGB)": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *D65),
        "Linear Rec.2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65),
        "Linear P3-D65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65),
        "Linear AdobeRGB": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65),
        "ACEScg": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *ACES_WHITE),
        "ACES2065-1": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, *ACES_WHITE),
        "Linear ARRI Wide Gamut 3": (0.684, 0.313, 0.221, 0.848, 0.0861, -0.1020, *D65),
        "Linear ARRI Wide Gamut 4": (0.7347, 0.2653, 0.1424, 0.8576, 0.0991, -0.0308, *D65),
        "Linear S-Gamut3": (0.730, 0.280, 0.140, 0.855, 0.100, -0.050, *D65),
        "Linear S-Gamut3.Cine": (0.766, 0.275, 0.225, 0.800, 0.089, -0.087, *D65),
        "Linear V-Gamut": (0.730, 0.280, 0.165, 0.840, 0.100, -0.030, *D65),
        "Linear REDWideGamutRGB": (0.780308, 0.304253, 0.121595, 1.493994, 0.095612, -0.084589, *D65),
        "Linear DaVinci WideGamut": (0.8000, 0.3130, 0.1682, 0.9877, 0.0790, -0.1155, *D65),
    }
)


def same_primaries(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two sets are one, written with more or fewer digits."""
    return len(a) == len(b) == 8 and bool(np.max(np.abs(np.subtract(a, b))) <= SAME)


def _xyz(x: float, y: float) -> Float64:
    return np.array([x / y, 1.0, (1 - x - y) / y])


def _xyz_from_rgb(c: Sequence[float]) -> Float64:
    # (x, y, 1 - x - y) without the division by y, which may be 0 for blue.
    corners = np.array([[c[i], c[i + 1], 1 - c[i] - c[i + 1]] for i in (0, 2, 4)]).T
    return np.asarray(corners * np.linalg.solve(corners, _xyz(c[6], c[7])))


def are_primaries(c: Sequence[float]) -> bool:
    """Whether eight numbers span colours at all."""
    if len(c) != 8 or not np.isfinite(c).all() or min(c[6], c[7]) <= 0.05 or c[6] + c[7] >= 1:
        return False
    return abs((c[2] - c[0]) * (c[5] - c[1]) - (c[4] - c[0]) * (c[3] - c[1])) > 1e-4


def matrix_between(source: Sequence[float], target: Sequence[float]) -> Float64:
    """(3, 3) that takes linear RGB of `source` primaries to `target` primaries; equal values stay equal."""
    white_s, white_t = (_xyz(c[6], c[7]) for c in (source, target))
    adapted = np.linalg.solve(BRADFORD, np.diag(BRADFORD @ white_t / (BRADFORD @ white_s)) @ BRADFORD)
    return np.asarray(np.linalg.solve(_xyz_from_rgb(target), adapted @ _xyz_from_rgb(source)))
