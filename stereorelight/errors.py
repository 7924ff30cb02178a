"""The one family of errors: each says what was wanted, what came, and the remedy, in one line.

The command line turns any of these into exit code 1; nothing else may reach a user for bad input."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class StereoRelightError(Exception):
    """Base of every error that the toolkit raises on purpose."""


class RigError(StereoRelightError):
    """A camera or rig that cannot exist, or a rig file that cannot be read."""


class PlateError(StereoRelightError):
    """A picture, sequence or movie that is missing, damaged, or does not fit the others."""


class PassError(StereoRelightError):
    """An array or pass of the wrong shape, type, range or name."""


class ShotError(StereoRelightError):
    """A shot file, light or setting that is unknown, misspelt or out of range."""


class OutputError(StereoRelightError):
    """A result that cannot be written: it exists, the folder is read-only, the disk is full."""


class GateError(StereoRelightError):
    """A figure that a gate does not let through: the work was done, and is not good enough."""


def nearest_hint(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'x'?` for the nearest of `known`, or the list of them where none is near."""
    names = sorted(known)
    plain = {name.lower(): name for name in names}
    near = difflib.get_close_matches(word.lower(), plain, n=1, cutoff=0.55)
    if near:
        return f"; did you mean {plain[near[0]]!r}?"
    return f"; known: {', '.join(names)}" if names else ""
