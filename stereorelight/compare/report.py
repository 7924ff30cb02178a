"""Figures as JSON and plain text, and errors as a picture.

In: figures of compare/depth.py and compare/normals.py, or (H, W) arrays.  Out: text, or (H, W, 3) uint8, display-coded."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import UInt8, as_float32
from stereorelight.errors import PassError

ZERO = np.array([235.0, 235.0, 235.0])
ABOVE = np.array([178.0, 24.0, 43.0])  # the result is larger than the truth
BELOW = np.array([33.0, 102.0, 172.0])
NO_ANSWER = (0, 0, 0)
NO_TRUTH = (90, 90, 90)


class Figures(Protocol):
    """What every kind of figures can do."""

    def to_dict(self) -> dict[str, object]: ...

    def text(self) -> str: ...


def comparison_json(figures: Mapping[str, Figures], *, result: str = "", truth: str = "") -> str:
    """One JSON object: {"result", "truth", and each kind of figures by its name}; figures that do not exist are null."""
    return json.dumps({"result": result, "truth": truth} | {name: f.to_dict() for name, f in figures.items()}, indent=2, allow_nan=False)


def comparison_text(figures: Mapping[str, Figures], *, result: str = "", truth: str = "") -> str:
    """The same for people: what was compared with what, then a table of each kind."""
    head = [f"{result} against {truth}"] if result or truth else []
    return "\n\n".join(head + [f.text() for f in figures.values()])


def error_map(result: npt.ArrayLike, truth: npt.ArrayLike, *, scale: float) -> UInt8:
    """(H, W, 3) uint8: signed error on a fixed scale, so that two pictures can be compared.

    Light grey is no error, full red +`scale` or more (result larger), full blue -`scale` or less; black is no answer, mid grey no truth.
    result, truth : (H, W) float, NaN where unknown; `scale` in their unit.
    """
    if not scale > 0:
        raise PassError(f"scale must be > 0, got {scale!r}")
    t = as_float32(truth, "truth")
    r = as_float32(result, "result", size_hw=(t.shape[0], t.shape[1]))
    with np.errstate(invalid="ignore"):
        share = np.clip((r.astype(np.float64) - t) / scale, -1, 1)
    known = np.isfinite(share)
    share = np.where(known, share, 0)[..., None]
    colour = ZERO + np.abs(share) * (np.where(share > 0, ABOVE, BELOW) - ZERO)
    picture: UInt8 = np.rint(colour).astype(np.uint8)
    picture[~np.isfinite(r)] = NO_ANSWER
    picture[~np.isfinite(t)] = NO_TRUTH
    return picture
