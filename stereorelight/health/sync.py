"""The time offset between the cameras, to a fraction of a frame.

In: successive frames of both eyes, rectified, scene-linear (H, W, 3), NaN where unknown, given one at a time; memory stays
flat.  Out: a `SyncMeasure`.  Sign: positive means that the RIGHT camera is late: its picture shows what the left one showed
`offset_frames` before.  Two steps: whole frames by correlating what changes from frame to frame in each row of the picture,
which both eyes see alike; the fraction by points followed in both (`sync_fit`).  Where the motion seen leaves the
offset open (nothing moves, or everything moves evenly along rows) it says so and never guesses.
A rolling shutter that is read in the other direction or at another speed in one eye looks like an offset that changes down the
frame; what is reported is its mean over what moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, Float64, UInt8, as_float32
from stereorelight.health.finding import Finding, Level
from stereorelight.health.sync_fit import OffsetFit, fit_offset
from stereorelight.health.sync_tracks import Tracks, follow, texture, tone

RUN = 16  # frames of a run whose points are followed; also what is held in memory
SHORTEST = 7  # frames, less than which no run is followed
REACH = 6  # whole frames of offset up to which points are followed
WHOLE_REACH = 24  # whole frames looked for in the row signals
LEAST_OVERLAP = 10
PROFILE_ROWS = 36
DECISIVE, CLEAR = 0.5, 0.12  # correlation of the row signals at the best shift, and its lead over shifts elsewhere
RUNS_KEPT = 6  # then every second one goes, and only every second run that comes is taken
KNOWN = 0.1  # frames of sigma above which nothing is claimed
FINE, GRAVE = 0.1, 0.5  # frames: what genlock and one's own error leave; what no mending of colour or rows will hide
SEEN_PX = 0.15  # working pixels of error at the moving points: below it even a real offset does no harm


@dataclass(frozen=True, kw_only=True)
class SyncMeasure:
    """What was found over the frames given.

    offset_frames, sigma_frames : NaN and inf where points tell nothing; positive: the right camera is late.
    whole_frames, whole_score   : the shift of the row signals and its correlation; None where they do not decide.
    speed_px  : 90th percentile of the moving points' speed, working pixels (at most 960 across) a frame.
    row_share : share of the evidence that came from vertical motion.
    """

    offset_frames: float
    sigma_frames: float
    whole_frames: int | None
    whole_score: float
    speed_px: float
    row_share: float
    tracks: int
    moving: int
    frames: int

    @property
    def known(self) -> bool:
        return self.sigma_frames <= KNOWN


def _profile(toned: Float32) -> Float32:
    """Coarse picture (PROFILE_ROWS, n): its rows are the same in both rectified eyes."""
    import cv2

    return cv2.resize(toned, (2 * PROFILE_ROWS, PROFILE_ROWS), interpolation=cv2.INTER_AREA)


class SyncMeter:
    """Takes pairs in the order of time and measures: `meter.add(number, left, right)` ..., then `meter.measure()`."""

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._left: list[UInt8] = []
        self._right: list[UInt8] = []
        self._before: tuple[Float32, Float32] | None = None
        self._signals: list[tuple[int, Float32, Float32]] = []
        self._runs: list[Tracks] = []
        self._stride, self._seen_runs = 1, 0
        self._last: int | None = None
        self._frames = 0

    def add(self, number: int, left: Float32, right: Float32) -> None:
        """One pair; a gap in `number` starts a new run.  Raises PassError when the shapes are not (H, W, 3) and equal."""
        a = as_float32(left, "left plate", channels=3)
        b = as_float32(right, "right plate", channels=3, size_hw=(a.shape[0], a.shape[1]))
        if self._last is not None and number != self._last + 1:
            self._end_run()
            self._before = None
        self._last = number
        self._frames += 1
        toned = tone(a), tone(b)
        now = _profile(toned[0]), _profile(toned[1])
        if self._before is not None:
            rows = [np.concatenate([d.mean(axis=1), np.abs(d).mean(axis=1)]) for d in (now[0] - self._before[0], now[1] - self._before[1])]
            self._signals.append((number, rows[0], rows[1]))
        self._before = now
        if self._seen_runs % self._stride == 0:
            self._left.append(texture(toned[0]))
            self._right.append(texture(toned[1]))
        self._numbers.append(number)
        if len(self._numbers) == RUN:
            self._end_run()

    def _end_run(self) -> None:
        left, right = self._left, self._right
        self._numbers, self._left, self._right = [], [], []
        self._seen_runs += 1
        if len(left) < SHORTEST:
            return
        self._runs.append(_followed(left, right, self._whole()[0] or 0))
        if len(self._runs) > RUNS_KEPT:
            self._runs = self._runs[::2]
            self._stride *= 2

    def _whole(self) -> tuple[int | None, float]:
        return whole_shift(self._signals)

    def measure(self) -> SyncMeasure:
        """The offset from everything given so far; more may be added afterwards."""
        if len(self._left) >= SHORTEST:
            runs = [*self._runs, _followed(self._left, self._right, self._whole()[0] or 0)]
        else:
            runs = self._runs
        fit = fit_offset(runs) if runs else _NOTHING
        whole, score = self._whole()
        offset, sigma = fit.offset_frames, fit.sigma_frames
        if whole is not None and math.isfinite(offset) and abs(whole - offset) > 1.5 and sigma > 0.02:
            sigma = math.inf  # points and row signals tell two stories: believe neither to a fraction
        return SyncMeasure(
            offset_frames=offset if math.isfinite(sigma) else math.nan,
            sigma_frames=sigma,
            whole_frames=whole,
            whole_score=score,
            speed_px=fit.speed_px,
            row_share=fit.row_share,
            tracks=fit.tracks,
            moving=fit.moving,
            frames=self._frames,
        )


_NOTHING = OffsetFit(offset_frames=math.nan, sigma_frames=math.inf, row_share=0.0, speed_px=0.0, tracks=0, moving=0)


def _followed(left: Sequence[UInt8], right: Sequence[UInt8], shift: int) -> Tracks:
    """Tracks at the whole shift that leaves the smallest fraction, found from `shift` on."""
    best: tuple[float, Tracks] | None = None
    tried: set[int] = set()
    for _ in range(3):
        shift = int(np.clip(shift, -REACH, REACH))
        if shift in tried or len(left) - abs(shift) < SHORTEST:
            break
        tried.add(shift)
        tracks = follow(left[max(0, -shift) :], right[max(0, shift) :], shift=shift)
        fit = fit_offset([tracks])
        rest = abs(fit.offset_frames - shift) if fit.sigma_frames < 0.5 else 9.0
        if best is None or rest < best[0]:
            best = (rest, tracks)
        if not 0.75 < rest < 9:
            break
        shift = round(fit.offset_frames)
    return best[1] if best else follow(left, right, shift=0)


def whole_shift(signals: Sequence[tuple[int, Float32, Float32]]) -> tuple[int | None, float]:
    """(shift, correlation): by how many frames the right eye's row signals come later; None where nothing stands out.

    signals : (frame number, left, right), what changed in each row since the frame before.
    """
    if len(signals) < LEAST_OVERLAP:
        return None, 0.0
    place = {number: n for n, (number, _, _) in enumerate(signals)}
    numbers = np.array([number for number, _, _ in signals])
    left, right = (_normalised(np.array([s[eye] for s in signals], np.float64)) for eye in (1, 2))
    scores: dict[int, float] = {}
    for shift in range(-WHOLE_REACH, WHOLE_REACH + 1):
        pairs = [(place[n], place[n + shift]) for n in numbers.tolist() if n + shift in place]
        if len(pairs) < max(LEAST_OVERLAP, len(signals) // 3):
            continue
        a, b = np.array(pairs).T
        power = float(np.sqrt((left[a] ** 2).sum() * (right[b] ** 2).sum()))
        scores[shift] = float((left[a] * right[b]).sum()) / power if power > 0 else 0.0
    if not scores:
        return None, 0.0
    best = max(scores, key=lambda k: (scores[k], -abs(k)))
    others = [score for k, score in scores.items() if abs(k - best) > 1]
    decides = scores[best] >= DECISIVE and others and scores[best] - max(others) >= CLEAR
    return (best if decides else None), scores[best]


def _normalised(rows: Float64) -> Float64:
    """Signals (n, rows) less their mean over time: what is always so tells no time."""
    out: Float64 = rows - rows.mean(axis=0)
    return out


def judge_sync(measure: SyncMeasure) -> Finding:
    """One finding "sync": its value is the offset in frames, positive where the right camera is late."""
    offset, sigma = measure.offset_frames, measure.sigma_frames
    details = {
        "sigma_frames": sigma, "whole_frames": measure.whole_frames, "whole_score": measure.whole_score, "speed_px": measure.speed_px,
        "row_share": measure.row_share, "tracks": measure.tracks, "moving": measure.moving, "frames": measure.frames,
    }  # fmt: skip
    if not measure.known:
        whole = measure.whole_frames
        if whole:
            side, other = ("late", "left") if whole > 0 else ("early", "right")
            words = f"The right camera is about {abs(whole)} frame{'s' * (abs(whole) > 1)} {side} (by what changes); the fraction cannot be known."
            remedy = f"Start the {'right' if whole > 0 else 'left'} eye {abs(whole)} frames later in its file, and check again; {other} stays."
            return Finding(name="sync", level="bad", value=float(whole), unit="frames", words=words, remedy=remedy, details=details)
        if measure.frames < SHORTEST:
            why = f"{measure.frames} successive frames are too few, {SHORTEST} are wanted"
        elif measure.moving == 0:
            why = "nothing moves"
        else:
            why = "what moves does so too evenly, too little, or on too few points"
        words = f"Whether the cameras are in step cannot be known from this footage: {why}."
        remedy = "Film a clap or a hand that waves up and down, or trust genlock and time code."
        return Finding(name="sync", level="unknown", unit="frames", words=words, remedy=remedy, details=details)
    harm = abs(offset) * measure.speed_px
    details["error_px"] = harm
    if abs(offset) < max(FINE, 2 * sigma):
        words = f"The cameras are in step: {offset:+.2f} frame (sigma {sigma:.2f})."
        return Finding(name="sync", level="good", value=offset, unit="frames", words=words, details=details)
    level: Level = "note" if harm < SEEN_PX else "bad" if abs(offset) >= GRAVE else "warn"
    words = (
        f"The right camera is {abs(offset):.2f} frame{'s' * (abs(offset) > 1)} {'late' if offset > 0 else 'early'} (sigma {sigma:.2f}): "
        f"what moves is matched {harm:.1f} px wrong."
    )
    slip = round(offset)
    rest = offset - slip
    parts = [f"Start the {'right' if slip > 0 else 'left'} eye {abs(slip)} frame{'s' * (abs(slip) > 1)} later in its file"] if slip else []
    if abs(rest) >= FINE:
        parts.append(f"{'the remaining ' if slip else ''}{abs(rest):.2f} frame can only be cured on set: genlock the cameras")
    remedy = "; ".join(parts)
    return Finding(
        name="sync",
        level=level,
        value=offset,
        unit="frames",
        words=words,
        remedy=remedy[:1].upper() + remedy[1:] + "." if remedy else "",
        details=details,
    )
