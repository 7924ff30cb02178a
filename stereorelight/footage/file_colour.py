"""What an EXR says of its own colours, and taking it at its word.

In: a header as `exr.read_exr` gives it, and linear RGB (..., 3).  Out: the same colours in the working space.
Asked in this order: our own word, colorInteropID (OpenEXR 3.4), the ACES container's flag, chromaticities.  A file that says
nothing is in the working space already.  Primaries of a space that the config knows are converted as the config does; others
by their matrix, adapted by Bradford where the white differs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.colour import ColourSettings, checked_space, chromaticities, from_primaries, to_working, working_space
from stereorelight.footage.primaries import PRIMARIES, are_primaries, same_primaries

WORKING_WORD = "stereorelight/working_space"
INTEROP_WORD, ACES_FLAG = "colorInteropID", "acesImageContainerFlag"


def header_words(settings: ColourSettings) -> tuple[dict[str, str], dict[str, Any]]:
    """Words and attributes that tell the working space in a file's header.  Raises ShotError."""
    primaries = chromaticities(settings)
    return {WORKING_WORD: working_space(settings)}, {} if primaries is None else {"chromaticities": primaries}


def stated_to_working(linear: Float32, header: Mapping[str, Any], path: str | Path, settings: ColourSettings) -> Float32:
    """RGB of a file with this header, in the working space; the very array where it is there already.

    Raises : PlateError where the file states a space that neither the config nor its primaries explain.
    """
    told = header.get(WORKING_WORD)
    if told == working_space(settings):
        return linear
    for name in (told, header.get(INTEROP_WORD)):
        if not isinstance(name, str) or not name or name.lower() in ("unknown", "data"):
            continue
        try:
            return to_working(linear, checked_space(name, settings), settings)
        except ShotError:  # a name of another config; its primaries may still tell
            continue
    stated = header.get("chromaticities")
    if stated is None and header.get(ACES_FLAG) == 1:
        stated = PRIMARIES["ACES2065-1"]
    if isinstance(stated, tuple):
        return _from_stated(linear, tuple(float(x) for x in stated), path, settings)
    if told:
        remedy = "name it with colour_space, or give the config that knows it"
        raise PlateError(f"{path}: is in the working space {told!r}, which is unknown here; {remedy}")
    return linear


def _from_stated(linear: Float32, stated: tuple[float, ...], path: str | Path, settings: ColourSettings) -> Float32:
    if not are_primaries(stated):
        raise PlateError(f"{path}: its chromaticities {stated} are no primaries; name the space with colour_space, 'linear' to take it as it is")
    own = chromaticities(settings)
    if own is not None and same_primaries(stated, own):
        return linear
    try:
        known = next((name for name, primaries in PRIMARIES.items() if same_primaries(stated, primaries)), None)
        if known is not None and settings.config is None:
            return to_working(linear, known, settings)
        return from_primaries(linear, stated, settings)
    except ShotError as error:
        raise PlateError(f"{path}: states primaries that cannot be converted: {error}") from None
