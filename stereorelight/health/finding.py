"""A finding: one property of the plates, measured, judged and put into words.

Measuring is apart from judging: the modules of this room measure (numbers with units), and their `judge_...` functions turn
the numbers into a `Finding` with a level, words for a person on set, and the remedy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Level = Literal["good", "note", "warn", "bad", "unknown"]
# In order of gravity.  "note" is worth knowing and harms nothing; "unknown" could not be measured, and the words say why.
LEVELS: tuple[Level, ...] = ("good", "unknown", "note", "warn", "bad")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of a health report.

    name    : what was looked at: "sync", "vertical", "exposure" ...; a word that scripts may rely on.
    level   : how grave.
    value   : the number that decided, in `unit` ("px", "frames", "%", "stops", "deg", ""); None where there is none.
    words   : what was found, one sentence, figures included.
    remedy  : what to do; "" where nothing is to be done.
    frames  : (frame number or None for a still, value) where it was measured frame by frame; NaN where it could not be.
    details : further numbers and words, plain values for JSON.
    """

    name: str
    level: Level
    words: str
    value: float | None = None
    unit: str = ""
    remedy: str = ""
    frames: tuple[tuple[int | None, float], ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "words", _sentence(self.words))
        object.__setattr__(self, "remedy", _sentence(self.remedy))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is not finite is None."""
        return {
            "name": self.name,
            "level": self.level,
            "value": _plain(self.value),
            "unit": self.unit,
            "words": self.words,
            "remedy": self.remedy,
            "frames": [{"frame": number, "value": _plain(value)} for number, value in self.frames],
            "details": _plain(dict(self.details)),
        }


def _sentence(text: str) -> str:
    """A capital at the beginning and a full stop at the end."""
    text = text.strip()
    return text and text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def worst(findings: Iterable[Finding]) -> Level:
    """The gravest level among `findings`; "good" where there are none."""
    return max((finding.level for finding in findings), key=LEVELS.index, default="good")
