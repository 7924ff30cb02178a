"""Findings about the frames of a shot, put together: over stretches that could be read, and over both eyes.

In: what `health` judges of a stretch of frames, or of one eye.  Out: one `Finding` for the shot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from stereorelight.health.finding import LEVELS, Finding
from stereorelight.health.repeats import Signed


def runs_of(signed: Signed, order: Mapping[int | None, int]) -> list[Signed]:
    """The stretches between frames that cannot be read: across such a hole everything seems to jump."""
    cuts = [n for n in range(1, len(signed)) if order[signed[n][0]] != order[signed[n - 1][0]] + 1]
    return [signed[a:b] for a, b in zip([0, *cuts], [*cuts, len(signed)])]


def judged_runs(judge: Callable[..., Finding], runs: Sequence[Signed], eye: str) -> Finding:
    """The gravest of the stretches, with the values of all of them; a stretch too short to tell counts only where all are."""
    each = [judge(run, eye=eye) for run in runs]
    told = [finding for finding in each if finding.level != "unknown"] or each
    gravest = max(told, key=lambda finding: (LEVELS.index(finding.level), finding.value or 0.0))
    total = sum(finding.value or 0.0 for finding in told) if gravest.level != "unknown" else None
    grave = [finding for finding in told if finding.level == gravest.level]
    words = gravest.words if gravest.level == "good" else " ".join(finding.words for finding in grave)
    return replace(gravest, value=total, words=words, frames=tuple(frame for finding in each for frame in finding.frames))


def graver(left: Finding, right: Finding) -> Finding:
    """One finding for both eyes: the graver one; of two grave ones, the words of both."""
    first, other = sorted((left, right), key=lambda finding: -LEVELS.index(finding.level))
    if first.level == other.level == "good":
        return replace(first, words=first.words.replace("of the left eye", "of either eye"))
    if other.level in ("good", "unknown", "note"):
        return first
    details = {"left": left.to_dict(), "right": right.to_dict()}
    values = [f.value for f in (left, right) if f.value is not None]
    return Finding(
        name=first.name,
        level=first.level,
        value=max(values, default=None),
        unit=first.unit,
        words=f"{left.words} {right.words}",
        remedy=first.remedy,
        frames=first.frames,
        details=details,
    )
