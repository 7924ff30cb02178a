"""Plate health: what is wrong with the plates of a shot, how much, and what to do, before an hour of processing.

In: a shot file, or two plates with or without a rig.  Out: a `Health`: findings with levels, the prediction, and pictures.
Every frame is read once and let go: signatures and time offset are taken of all, the rest of a few frames evenly spread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.calibration.alignment import handedness, relative_alignment
from stereorelight.calibration.drift import VerticalError, solve_drift
from stereorelight.calibration.features import pooled
from stereorelight.errors import PlateError, StereoRelightError
from stereorelight.footage.colour import ColourSettings
from stereorelight.footage.eyes import Eyes, open_eyes
from stereorelight.footage.plates import check_pair
from stereorelight.health.alignment import Strips
from stereorelight.health.blur import judge_blur
from stereorelight.health.clipping import judge_clipping, judge_crushing
from stereorelight.health.exposure_verdict import judge_colour, judge_exposure, judge_shading
from stereorelight.health.eyes import (
    judge_matches,
    judge_mirrored,
    judge_one_picture,
    judge_rig_stale,
    judge_roll,
    judge_swapped,
    judge_upside_down,
    judge_vertical,
    judge_zoom,
)
from stereorelight.health.finding import LEVELS, Finding, Level, worst
from stereorelight.health.focus import judge_focus
from stereorelight.health.grain import judge_grain
from stereorelight.health.predict import Prediction, judge_prediction, predict, verdict
from stereorelight.health.range import judge_range
from stereorelight.health.repeats import FrameSignature, judge_corrupt, judge_drops, judge_repeats, signature
from stereorelight.health.sync import SyncMeter, judge_sync
from stereorelight.interchange.rigs import files_of, read_rig
from stereorelight.shot.check_look import Look, look
from stereorelight.shot.check_pictures import pictures_of
from stereorelight.shot.check_runs import graver, judged_runs, runs_of
from stereorelight.shot.pairs import Pair, eyes_of_shot, pairs_of
from stereorelight.shot.schema import read_shot
from stereorelight.stereo.rectify import Rectification, rectification

CLOSE_FRAMES = 6  # looked at closely, evenly spread over the shot
SUBJECT_SHARE = 0.25
Told = Callable[[str, int, int], object]


@dataclass(frozen=True, kw_only=True, eq=False)
class Health:
    """What was found.

    findings   : gravest first.     prediction : a table of words, its titles first; empty without a rig.
    pictures   : (caption, (H, W, 3) uint8) for the page.
    """

    title: str
    plates: dict[str, str]
    facts: tuple[str, ...]
    findings: tuple[Finding, ...]
    prediction: tuple[tuple[str, ...], ...] = ()
    pictures: tuple[tuple[str, UInt8], ...] = ()

    @property
    def level(self) -> Level:
        """The gravest level among the findings.  What could not be measured does not count, nor what is foreseen: that is no fault."""
        return worst(finding for finding in self.findings if finding.level != "unknown" and finding.name != "prediction")

    @property
    def words(self) -> str:
        """The verdict in one line."""
        grave = [f.name.replace("_", " ") for f in self.findings if f.level in ("warn", "bad") and f.name != "prediction"]
        if not grave:
            return "nothing in these plates stands in the way"
        return f"look at {', '.join(grave)}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "verdict": self.level,
            "words": self.words,
            "plates": self.plates,
            "facts": list(self.facts),
            "findings": [finding.to_dict() for finding in self.findings],
            "prediction": [list(row) for row in self.prediction],
        }


@dataclass(kw_only=True, eq=False)
class _Seen:
    """What one passage over the frames leaves."""

    left: list[tuple[int | None, FrameSignature]] = field(default_factory=list)
    right: list[tuple[int | None, FrameSignature]] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)
    damaged: list[tuple[str, str]] = field(default_factory=list)
    sync: SyncMeter = field(default_factory=SyncMeter)
    sample: tuple[Float32, Float32] | None = None


def check_shot(
    path: str | Path,
    *,
    rig_path: str | Path | None = None,
    frames: str | None = None,
    subject_m: float | None = None,
    every: int = 1,
    on_frame: Told = lambda name, done, total: None,
) -> Health:
    """The health of a shot file's plates, with its rig where the file is there.  Raises ShotError, PlateError, RigError."""
    shot = read_shot(path)
    rig = Path(rig_path) if rig_path is not None else shot.resolved(shot.tables.rig.file)
    rectified = rectification(read_rig(rig)) if rig_path is not None or any(f.exists() for f in files_of(rig)) else None
    expected = (shot.tables.depth.near_m, shot.tables.depth.far_m)
    eyes = eyes_of_shot(shot, frames)
    return health_of(eyes, rectified, title=shot.name, colour=shot.colour, expected_m=expected, subject_m=subject_m, every=every, on_frame=on_frame)


def check_plates(
    left: str | Path,
    right: str | Path | None,
    *,
    rig_path: str | Path | None = None,
    frames: str | None = None,
    subject_m: float | None = None,
    every: int = 1,
    on_frame: Told = lambda name, done, total: None,
    **pairing: Any,
) -> Health:
    """The health of two plates; `pairing` as `open_eyes` takes it.  Raises PlateError, RigError, ShotError."""
    rectified = None if rig_path is None else rectification(read_rig(rig_path))
    eyes = open_eyes(left, right, frames=frames, **pairing)
    return health_of(eyes, rectified, title=Path(left).name, subject_m=subject_m, every=every, on_frame=on_frame)


def health_of(
    eyes: Eyes,
    rectified: Rectification | None,
    *,
    title: str,
    colour: ColourSettings | None = None,
    expected_m: tuple[float | None, float | None] = (None, None),
    subject_m: float | None = None,
    every: int = 1,
    on_frame: Told = lambda name, done, total: None,
) -> Health:
    """Measure and judge.  A frame that cannot be read is a finding, unless none can.

    expected_m : near and far distance that the shot file names.
    subject_m  : distance for which the prediction is made; else the distance that a quarter of the matches lie before.
    """
    pairs = pairs_of(eyes)[::every]
    seen = _passage(pairs, rectified, colour=colour, expected_m=expected_m, on_frame=on_frame)
    if seen.sample is None:
        _, why = seen.damaged[0]
        raise PlateError(f"{why}; no frame of the shot can be checked" if len(pairs) > 1 else why)
    findings = [*_files(seen, pairs), *_eyes(seen, rectified), *_in_time(seen, pairs), *_pictures(seen)]
    prediction, foreseen = _foreseen(seen, rectified, subject_m)
    findings += foreseen
    if rectified is not None:
        ranges = [one.range for one in seen.looks if one.range is not None]
        findings.append(judge_range(ranges, near_m=expected_m[0], far_m=expected_m[1]))
    ordered = sorted(findings, key=lambda finding: -LEVELS.index(finding.level))
    h, w = seen.sample[0].shape[:2]
    rate = [] if eyes.left.rate is None else [f"{float(eyes.left.rate):.6g} frames a second"]
    facts = (f"{w} x {h} pixels", f"{len(pairs)} frame{'s' * (len(pairs) > 1)}", *rate, "with the rig" if rectified else "without a rig", *eyes.notes)
    names = {"left": str(eyes.left.pictures.pattern), "right": str(eyes.right.pictures.pattern)}
    pictures = pictures_of(seen.sample, seen.looks, ordered, rectified)
    return Health(title=title, plates=names, facts=facts, findings=tuple(ordered), prediction=prediction, pictures=pictures)


def _passage(
    pairs: Sequence[Pair],
    rectified: Rectification | None,
    *,
    colour: ColourSettings | None,
    expected_m: tuple[float | None, float | None],
    on_frame: Told,
) -> _Seen:
    """Every frame once, in order; at most two frames are in memory."""
    seen = _Seen()
    close = {int(i) for i in np.unique(np.linspace(0, max(len(pairs) - 2, 0), min(len(pairs), CLOSE_FRAMES)).round())}
    waiting: tuple[Pair, tuple[Float32, Float32]] | None = None
    owed = 0  # of the frames to be looked at closely, those that could not be: the next good ones take their places

    def look_at(pair: Pair, plates: tuple[Float32, Float32], following: tuple[Float32, Float32] | None) -> None:
        nonlocal owed
        try:
            found = look(pair.number, plates, following=following, rectification=rectified, near_m=expected_m[0], far_m=expected_m[1])
        except PlateError as error:
            seen.damaged.append((pair.name, f"{pair.plate_name('left')} and {pair.plate_name('right')}: {error}"))
            owed += 1
            return
        seen.looks.append(found)
        seen.sample = seen.sample or plates

    for n, pair in enumerate(pairs):
        on_frame(pair.name, n, len(pairs))
        try:
            plates = _upright(pair, rectified, colour)
        except PlateError as error:
            seen.damaged.append((pair.name, str(error)))
            owed += n in close
            if waiting is not None:
                look_at(*waiting, None)
            waiting = None
            continue
        if waiting is not None:
            look_at(*waiting, plates)
            waiting = None
        if len(pairs) > 1:
            seen.left.append((pair.number, signature(plates[0])))
            seen.right.append((pair.number, signature(plates[1])))
            views = plates if rectified is None else (rectified.rectify(plates[0], "left"), rectified.rectify(plates[1], "right"))
            if views[0].shape == views[1].shape:
                seen.sync.add(int(pair.number or 0), *views)
        if n in close or owed:
            owed -= n not in close
            waiting = (pair, plates)
    if waiting is not None:
        look_at(*waiting, None)
    return seen


def _upright(pair: Pair, rectified: Rectification | None, colour: ColourSettings | None) -> tuple[Float32, Float32]:
    left, right = pair.plate("left", colour), pair.plate("right", colour)
    check_pair(left, right, left_name=pair.plate_name("left"), right_name=pair.plate_name("right"), rig=rectified.original if rectified else None)
    if rectified is None:
        return left, right
    return rectified.upright(left, "left"), rectified.upright(right, "right")


def _files(seen: _Seen, pairs: Sequence[Pair]) -> list[Finding]:
    """Frames that cannot be read."""
    if not seen.damaged:
        return [Finding(name="unreadable_frames", level="good", value=0.0, unit="frames", words="Every frame can be read.")]
    why = seen.damaged[0][1]
    more = f"; and {len(seen.damaged) - 1} more" if len(seen.damaged) > 1 else ""
    bad = {name for name, _ in seen.damaged}
    return [
        Finding(
            name="unreadable_frames",
            level="bad",
            value=float(len(seen.damaged)),
            unit="frames",
            words=f"{len(seen.damaged)} of {len(pairs)} frames cannot be read: {why}{more}.",
            remedy="Copy or export these frames again, or leave them out with --frames.",
            frames=tuple((pair.number, float(pair.name in bad)) for pair in pairs),
        )
    ]


def _eyes(seen: _Seen, rectified: Rectification | None) -> list[Finding]:
    """How the two eyes lie against each other."""
    looks = seen.looks
    found = [
        judge_matches([(one.number, len(one.matches)) for one in looks]),
        judge_one_picture([(one.number, float(one.one_picture)) for one in looks]),
    ]
    first, sample = looks[0], seen.sample
    assert sample is not None
    rig = None if rectified is None else rectified.original
    hand = handedness(*sample, rig=rig, as_is=first.matches)
    found += [
        judge_mirrored(hand.as_is, hand.mirrored, in_front=hand.in_front, declared=None if rig is None else rig.mirrored),
        judge_upside_down(hand.upside_down),
    ]
    strips = Strips(behind=sum(one.strips.behind for one in looks), before=sum(one.strips.before for one in looks))
    found.append(
        judge_swapped(strips, behind=_median([one.behind for one in looks]), behind_exchanged=_median([one.behind_exchanged for one in looks]))
    )
    try:
        together = pooled([one.matches for one in looks])
        if rig is None:
            raw = relative_alignment(together)
            return [
                *found,
                judge_vertical([(None, raw.before.median)], p95_px=raw.before.p95, grid=raw.before.map, matches=raw.matches, after_rig=False),
                judge_roll(raw.roll_deg, raw.roll_sigma, after_rig=False),
                judge_zoom(100 * (raw.zoom - 1), 100 * raw.zoom_sigma, after_rig=False),
            ]
        drift = solve_drift(rig, together)
    except StereoRelightError as error:
        words = f"How rows lie against each other could not be measured: {error}"
        return [*found, Finding(name="vertical", level="unknown", unit="px", words=words)]
    before = drift.before
    assert isinstance(before, VerticalError)
    frames = [(one.number, one.vertical.median if one.vertical else float("nan")) for one in looks]
    found.append(judge_vertical(frames, p95_px=before.p95, grid=before.map, matches=before.matches, after_rig=True))
    found.append(judge_roll(-drift.roll_deg, drift.sigmas["roll_deg"], after_rig=True))
    found.append(judge_zoom(100 * (drift.zoom - 1), 100 * drift.sigmas["zoom"], after_rig=True))
    stale = judge_rig_stale(
        drift.angles_deg,
        100 * (drift.zoom - 1),
        drift.sigmas,
        held=drift.held,
        before_px=before.median,
        held_out_before_px=drift.held_out_before,
        held_out_after_px=drift.held_out_after,
        frames=frames,
    )
    return [*found, stale]


def _median(values: Sequence[float]) -> float:
    known = [v for v in values if np.isfinite(v)]
    return float(np.median(known)) if known else float("nan")


def _in_time(seen: _Seen, pairs: Sequence[Pair]) -> list[Finding]:
    """What only a shot of several frames shows."""
    if len(pairs) < 2:
        return []
    found = [judge_sync(seen.sync.measure())]
    order = {pair.number: n for n, pair in enumerate(pairs)}
    for judge in (judge_repeats, judge_drops, judge_corrupt):
        left, right = (judged_runs(judge, runs_of(signed, order), eye) for signed, eye in ((seen.left, "left"), (seen.right, "right")))
        found.append(graver(left, right))
    return [*found, judge_blur([(one.number, one.blur) for one in seen.looks if one.blur is not None])]


def _pictures(seen: _Seen) -> list[Finding]:
    """Light, colour, grain, focus and clipping."""
    exposure = [(one.number, one.exposure) for one in seen.looks if one.exposure is not None]
    clipped = [[(one.number, one.clipping[eye]) for one in seen.looks] for eye in (0, 1)]
    grains = [[(one.number, g) for one in seen.looks if (g := one.grain[eye]) is not None] for eye in (0, 1)]
    return [
        judge_exposure(exposure),
        judge_colour(exposure),
        judge_shading(exposure),
        judge_clipping(*clipped),
        judge_crushing(*clipped),
        judge_grain(*grains),
        judge_focus([(one.number, one.focus) for one in seen.looks if one.focus is not None]),
    ]


def _foreseen(seen: _Seen, rectified: Rectification | None, subject_m: float | None) -> tuple[tuple[tuple[str, ...], ...], list[Finding]]:
    """What depth and normals to expect at the nearest distance, the subject's and the farthest."""
    if rectified is None:
        return (), []
    distances = np.concatenate([one.distances_m for one in seen.looks])
    # People stand before their surroundings: what is taken for the subject has a quarter of the matches before it.
    subject = subject_m or (float(np.quantile(distances, SUBJECT_SHARE)) if len(distances) else float("nan"))
    grains = [g.sigma(one.light)[1] for one in seen.looks if (g := one.grain[0]) is not None]
    texture = _median([one.texture for one in seen.looks])
    if not (np.isfinite(subject) and subject > 0 and grains and np.isfinite(texture) and texture > 0):
        words = "What the plates will give could not be foreseen: too little matches, or no texture to match by."
        return (), [Finding(name="prediction", level="unknown", unit="deg", words=words, remedy="Give the subject's distance with --subject.")]
    ends = (subject, subject) if not len(distances) else (float(q) for q in np.quantile(distances, (0.02, 0.98)))
    near, far = ends

    def at(distance_m: float) -> Prediction:
        return predict(rectified.rig, distance_m, grain=float(np.median(grains)), texture=texture)

    told = [("nearest", at(near)), ("subject", at(subject)), ("farthest", at(far))]
    titles = ("", "distance", "1 px of disparity is", "expected error of depth", "expected error of normals", "enough for")
    rows = [
        (name, f"{p.distance_m:.2f} m", f"{p.step_mm:.1f} mm", f"{p.sigma_mm:.2f} mm", f"{p.normal_deg:.1f} deg", verdict(p.normal_deg))
        for name, p in told
    ]
    return (titles, *rows), [judge_prediction(told[1][1], near=told[0][1], far=told[2][1])]
