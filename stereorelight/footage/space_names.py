"""What people call colour spaces, and what the studio config calls them.

`ALIASES` maps a friendly name to the names that configs give that space, the pinned studio config's first; case, spaces and
punctuation do not matter.  Where a curve's name leaves the gamut open, the field's usual one is taken:
S-Log3 is S-Gamut3.Cine (what FX and A7 cameras record and colourists expect), V-Log V-Gamut, Log3G10 REDWideGamutRGB,
Canon Log 2 and 3 Cinema Gamut (daylight), LogC3 ARRI Wide Gamut 3 at EI 800, BMDFilm Gen 5.  Full names say otherwise:
"S-Log3 S-Gamut3", "S-Log3 Venice S-Gamut3".

`FORMULAS` are spaces of our own exact curves, with the linear space that they decode to."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from stereorelight.errors import nearest_hint

REC709, REC2020 = "linear Rec.709", "Linear Rec.2020"
FORMULAS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "sRGB": ("sRGB", REC709),
        "rec709": ("rec709", REC709),
        "gamma2.2": ("gamma2.2", REC709),
        "gamma2.4": ("gamma2.4", REC709),
        "rec2020": ("rec709", REC2020),
    }
)
FORMULA_ALIASES: Mapping[str, str] = MappingProxyType({"Rec.709": "rec709", "BT.709": "rec709", "Rec.2020": "rec2020", "BT.2020": "rec2020"})
ALIASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "LogC": ("ARRI LogC3 (EI800)", "arri_logc3_ei800", "Input - ARRI - V3 LogC (EI800) - Wide Gamut"),
        "LogC3": ("ARRI LogC3 (EI800)", "arri_logc3_ei800", "Input - ARRI - V3 LogC (EI800) - Wide Gamut"),
        "ARRI LogC3": ("ARRI LogC3 (EI800)", "arri_logc3_ei800", "Input - ARRI - V3 LogC (EI800) - Wide Gamut"),
        "LogC4": ("ARRI LogC4", "arri_logc4"),
        "S-Log3": ("S-Log3 S-Gamut3.Cine", "slog3_sgamut3cine", "Input - Sony - S-Log3 - S-Gamut3.Cine"),
        "V-Log": ("V-Log V-Gamut", "vlog_vgamut", "Input - Panasonic - V-Log - V-Gamut"),
        "Log3G10": ("Log3G10 REDWideGamutRGB", "log3g10_redwidegamutrgb", "Input - RED - REDLog3G10 - REDWideGamutRGB"),
        "Canon Log 2": ("CanonLog2 CinemaGamut D55", "canonlog2_cinemagamut_d55"),
        "Canon Log 3": ("CanonLog3 CinemaGamut D55", "canonlog3_cinemagamut_d55"),
        "C-Log2": ("CanonLog2 CinemaGamut D55", "canonlog2_cinemagamut_d55"),
        "C-Log3": ("CanonLog3 CinemaGamut D55", "canonlog3_cinemagamut_d55"),
        "BMDFilm": ("BMDFilm WideGamut Gen5", "bmdfilm_widegamut_gen5"),
        "Blackmagic Film": ("BMDFilm WideGamut Gen5", "bmdfilm_widegamut_gen5"),
        "DaVinci Intermediate": ("DaVinci Intermediate WideGamut", "davinci_intermediate_widegamut"),
        "Apple Log": ("Apple Log", "apple_log"),
        "ACEScg": ("ACEScg", "lin_ap1", "ACES - ACEScg"),
        "AP1": ("ACEScg", "lin_ap1", "ACES - ACEScg"),
        "ACES2065-1": ("ACES2065-1", "lin_ap0", "ACES - ACES2065-1"),
        "ACES": ("ACES2065-1", "lin_ap0", "ACES - ACES2065-1"),
        "AP0": ("ACES2065-1", "lin_ap0", "ACES - ACES2065-1"),
        "Display P3": ("sRGB Encoded P3-D65", "srgb_p3d65", "srgb_displayp3"),
        "linear Rec.709": (
            "Linear Rec.709 (sRGB)",
            "lin_rec709_srgb",
            "lin_rec709",
            "lin_srgb",
            "Utility - Linear - Rec.709",
            "Utility - Linear - sRGB",
        ),
        "linear sRGB": (
            "Linear Rec.709 (sRGB)",
            "lin_rec709_srgb",
            "lin_rec709",
            "lin_srgb",
            "Utility - Linear - Rec.709",
            "Utility - Linear - sRGB",
        ),
        "linear Rec.2020": ("Linear Rec.2020", "lin_rec2020", "Utility - Linear - Rec.2020"),
        "linear P3": ("Linear P3-D65", "lin_p3d65", "Utility - Linear - P3-D65"),
    }
)


def plain(name: str) -> str:
    """A name without case, spaces and punctuation."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


_BY_PLAIN = {plain(name): spaces for name, spaces in ALIASES.items()}
_FORMULA_BY_PLAIN = {plain(name): name for name in FORMULAS} | {plain(name): space for name, space in FORMULA_ALIASES.items()}


def formula_named(name: str) -> str | None:
    """Our own space of that name: "linear", a key of `FORMULAS`, or None."""
    return "linear" if name.strip().lower() == "linear" else _FORMULA_BY_PLAIN.get(plain(name))


def config_names(name: str) -> tuple[str, ...]:
    """What configs call the space with the friendly `name`; empty where it is none of ours."""
    return _BY_PLAIN.get(plain(name), ())


def hint(word: str, names: Iterable[str], *, place: str) -> str:
    """The nearest name, else those that hold the word, else the friendly ones and where the others stand."""
    names = list(dict.fromkeys(names))
    near = nearest_hint(word, names)
    if near.startswith("; did you mean"):
        return near
    holding = [name for name in names if len(plain(word)) > 1 and plain(word) in plain(name)][:5]
    if holding:
        return f"; did you mean {', '.join(map(repr, holding[:-1]))}{' or ' if len(holding) > 1 else ''}{holding[-1]!r}?"
    few = names if len(names) <= 12 else [*FORMULAS, "linear", "LogC3", "LogC4", "S-Log3", "V-Log", "Log3G10", "ACEScg", "ACES2065-1"]
    return f"; known: {', '.join(few)}{'' if few is names else f' and every name of {place}'}"
