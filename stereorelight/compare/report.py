"""Figures as JSON and plain text, and errors as a picture.

In: what a comparison says (compare/figures.py), or (H, W) arrays.  Out: text, or (H, W, 3) uint8, display-coded."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, UInt8, as_float32
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


def comparison_json(figures: Mapping[str, Figures], *, result: str = "", truth: str = "", more: Mapping[str, Any] | None = None) -> str:
    """One JSON object: {"result", "truth", and each kind of figures by its name}; figures that do not exist are null."""
    return json.dumps(
        {"result": result, "truth": truth} | {name: f.to_dict() for name, f in figures.items()} | dict(more or {}), indent=2, allow_nan=False
    )


def comparison_text(figures: Mapping[str, Figures], *, result: str = "", truth: str = "") -> str:
    """The same for people: what was compared with what, then a table of each kind."""
    head = [f"{result} against {truth}" if truth else result] if result or truth else []
    return "\n\n".join(head + [f.text() for f in figures.values()])


def error_map(result: npt.ArrayLike, truth: npt.ArrayLike, *, scale: float) -> UInt8:
    """(H, W, 3) uint8: signed error on a fixed scale, so that two pictures can be compared; colours as of `error_picture`.

    result, truth : (H, W) float, NaN where unknown; `scale` in their unit.
    """
    t = as_float32(truth, "truth")
    r = as_float32(result, "result", size_hw=(t.shape[0], t.shape[1]))
    with np.errstate(invalid="ignore"):
        error = r.astype(np.float64) - t
    picture = error_picture(np.where(np.isfinite(r), error, np.nan), known=np.isfinite(t), scale=scale)
    picture[~np.isfinite(r)] = NO_ANSWER
    picture[~np.isfinite(t)] = NO_TRUTH
    return picture


def error_picture(error: npt.NDArray[Any], *, scale: float, known: Bool | None = None, sequential: bool = False) -> UInt8:
    """(H, W, 3) uint8 of a signed error (H, W).

    Light grey is no error, full red +`scale` or more (result larger), full blue -`scale` or less; black is no answer, mid grey no truth.
    known : (H, W) where the truth is known.   sequential : the error has no sign: its size from grey to red.
    """
    if not scale > 0:
        raise PassError(f"scale must be > 0, got {scale!r}")
    finite = np.isfinite(error)
    share = np.clip(np.where(finite, np.abs(error) if sequential else error, 0) / scale, -1, 1)
    table = _table()
    picture: UInt8 = table[np.rint((share + 1) * HALF).astype(np.intp)]
    picture[~finite] = NO_ANSWER
    if known is not None:
        picture[~known] = NO_TRUTH
    return picture


HALF = 1 << 12  # steps of the table on each side of 0


def _table() -> UInt8:
    share = np.arange(-HALF, HALF + 1)[:, None] / HALF
    return np.rint(ZERO + np.abs(share) * (np.where(share > 0, ABOVE, BELOW) - ZERO)).astype(np.uint8)
