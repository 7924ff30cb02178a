"""What a difference of exposure, colour or shading between the eyes means for a shot, in words with a level and a remedy.

In: (frame, `ExposureDifference`) of the frames that were measured.  Out: a `Finding` each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.health.exposure import ExposureDifference
from stereorelight.health.finding import Finding, Level
from stereorelight.health.picture import GREY, frames_named, on_frame

STOPS_NOTE, STOPS_WARN, STOPS_BAD = 0.05, 0.1, 1.0  # a tenth of a stop is an iris scale's own error; a stop halves the light of one eye
CAST_NOTE, CAST_WARN, CAST_BAD = 0.01, 0.02, 0.15  # of a channel against the others; 2 % is the least that shows in a grey card
SHADING_NOTE, SHADING_WARN, SHADING_BAD = 0.06, 0.12, 0.7  # stops from end to end; two lenses' own vignettes differ by 0.05
VEIL_WARN = 0.05  # of the median light: flare or a wrong black level
FLICKER_STOPS = 0.05  # between frames: an automatic iris or gain in one eye

Measured = Sequence[tuple[int | None, ExposureDifference]]
GLOBAL_REMEDY = 'Match the eyes: [plates] match_colour = "global" in the shot file.'
LOCAL_REMEDY = 'Match the eyes area by area: [plates] match_colour = "local" in the shot file; next time, turn both polarisers alike.'


def _graded(size: float, note: float, warn: float, bad: float) -> Level:
    return "bad" if size >= bad else "warn" if size >= warn else "note" if size >= note else "good"


def _nothing(name: str, unit: str) -> Finding:
    return Finding(name=name, level="unknown", unit=unit, words="The eyes could not be compared: no frame gave enough matched, unclipped patches.")


def judge_exposure(measured: Measured) -> Finding:
    """One Finding "exposure" over a shot: median stops (right against left), veil, and whether it changes from frame to frame."""
    if not measured:
        return _nothing("exposure", "stops")
    each = [(frame, m.stops) for frame, m in measured]
    values = np.array([v for _, v in each])
    stops = float(np.median(values))
    swing = float(values.max() - values.min())
    veil = float(np.median([max(abs(o) / max(m, 1e-9) for o, m in zip(d.offset, d.median)) for _, d in measured]))
    rough = all(d.method == "tones" for _, d in measured)
    doubt = 0.04 if rough else 0.0  # 3 % of gain by which parallax alone moves the tones of a frame
    level = _graded(max(abs(stops) - doubt, 0), STOPS_NOTE, STOPS_WARN, STOPS_BAD)
    side = "brighter" if stops > 0 else "darker"
    words = f"The right eye is {abs(stops):.2f} stops {side} than the left ({2**stops - 1:+.1%})"
    if level == "good":
        words = f"The eyes are exposed alike: the right is {stops:+.2f} stops ({2**stops - 1:+.1%}) from the left"
    remedy = "" if level in ("good", "note") else GLOBAL_REMEDY
    if veil > VEIL_WARN:
        words += f", with a veil or black level that differs by {veil:.1%} of the median light"
        level = "warn" if level in ("good", "note") else level
        remedy = GLOBAL_REMEDY + " Look for flare on one lens or a wrong black level."
    if swing > FLICKER_STOPS + 2 * doubt and len(measured) > 1:
        low, high = each[int(values.argmin())][0], each[int(values.argmax())][0]
        words += f"; it changes by {swing:.2f} stops over the shot (least{on_frame(low)}, most{on_frame(high)})"
        level = "warn" if level in ("good", "note") else level
        remedy = GLOBAL_REMEDY + " Lock the iris, gain and shutter of both cameras."
    details = {
        "stops": stops,
        "gain": np.median([d.gain for _, d in measured], axis=0).tolist(),
        "offset": np.median([d.offset for _, d in measured], axis=0).tolist(),
        "swing_stops": swing,
        "veil": veil,
        "method": "tones" if rough else "matches",
    }
    words += " (from the frames' tones; no matches)" if rough else ""
    return Finding(name="exposure", level=level, value=stops, unit="stops", words=words + ".", remedy=remedy, frames=tuple(each), details=details)


def judge_colour(measured: Measured) -> Finding:
    """One Finding "colour" over a shot: the cast of the right eye against the left; value is the largest channel's, in %."""
    if not measured:
        return _nothing("colour", "%")
    casts = np.array([d.cast for _, d in measured])
    cast = np.median(casts, axis=0)
    most = int(np.abs(cast).argmax())
    rough = all(d.method == "tones" for _, d in measured)
    level = _graded(max(abs(float(cast[most])) - (0.01 if rough else 0.0), 0), CAST_NOTE, CAST_WARN, CAST_BAD)
    listed = f"red {cast[0]:+.1%}, blue {cast[2]:+.1%}"
    words = (
        f"The right eye has a colour cast against the left: {listed} against green."
        if level != "good"
        else f"Both eyes see the same colours: {listed} against green."
    )
    return Finding(
        name="colour",
        level=level,
        value=100 * float(cast[most]),
        unit="%",
        words=words,
        remedy="" if level in ("good", "note") else GLOBAL_REMEDY,
        frames=tuple((frame, 100 * float(c[most])) for (frame, _), c in zip(measured, casts)),
        details={"cast_percent": (100 * cast).tolist(), "gain": np.median([d.gain for _, d in measured], axis=0).tolist()},
    )


def judge_shading(measured: Measured) -> Finding:
    """One Finding "shading" over a shot: stops from end to end that no single gain takes out (polariser, beam-splitter, vignette)."""
    spans = [(frame, d.shading_stops) for frame, d in measured]
    sure = [(frame, d) for frame, d in measured if np.isfinite(d.shading_stops)]
    if not sure:
        return Finding(
            name="shading", level="unknown", unit="stops", words="Shading between the eyes was not measured: it needs matches all over the frame."
        )
    span = float(np.median([d.shading_stops for _, d in sure]))
    error = float(np.median([d.shading_error for _, d in sure]))
    level = _graded(max(span - 2 * error, 0), SHADING_NOTE, SHADING_WARN, SHADING_BAD)
    with np.errstate(invalid="ignore"):
        cells = np.stack([d.local_stops @ np.array(GREY, np.float32) for _, d in sure])
    seen = np.isfinite(cells).any(axis=0)
    field = np.full(seen.shape, np.nan)
    field[seen] = np.nanmedian(cells[:, seen], axis=0)
    words = f"After one gain for all, the eyes still differ by {span:.2f} stops from end to end of the frame{_where(field)}."
    if level == "good":
        words = f"One gain fits the whole frame: {span:.2f} stops are left from end to end."
    worst = [f for f, s in spans if np.isfinite(s) and s > 2 * span]
    words = words[:-1] + f"; worse on {frames_named(worst)}." if level != "good" and frames_named(worst) else words
    remedy = "" if level in ("good", "note") else LOCAL_REMEDY
    return Finding(
        name="shading",
        level=level,
        value=span,
        unit="stops",
        words=words,
        remedy=remedy,
        frames=tuple(spans),
        details={"map_stops": field.tolist(), "error_stops": error},
    )


def _where(field: Float64) -> str:
    """` (right eye brightest top left, darkest bottom right)` of a map (rows, columns)."""
    rows, columns = field.shape

    def place(flat: int) -> str:
        r, c = divmod(flat, columns)
        down = "top" if r < rows / 3 else "bottom" if r >= rows * 2 / 3 else ""
        across = "left" if c < columns / 3 else "right" if c >= columns * 2 / 3 else ""
        return f"{down} {across}".strip() or "in the middle"

    if not np.isfinite(field).any():
        return ""
    return f" (right eye brightest {place(int(np.nanargmax(field)))}, darkest {place(int(np.nanargmin(field)))})"
