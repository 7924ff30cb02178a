"""Mending a stale rig from the shot's own footage, as the shot file asks: `[rig] drift = "shot"` or `"frame"`.

In: the shot's pairs and its rig.  Out: a `Mends`: what the right eye has moved by, for each frame.
The whole shot speaks, whatever part of it is run, so that every part gives the same pictures.  What was found is kept in
drift.json beside the results, with a key over everything that it was found from."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.calibration.drift import Drift, apply, keyed, smoothed, solve_drift
from stereorelight.calibration.features import Matches, match_points, pooled
from stereorelight.camera import Rig
from stereorelight.errors import PlateError, ShotError
from stereorelight.files import write_text
from stereorelight.footage.sequence import frame_range
from stereorelight.shot.pairs import EYES, Pair, eyes_of_shot, pairs_of, read_upright
from stereorelight.shot.receipt import code_digest, digest
from stereorelight.shot.schema import Shot
from stereorelight.shot.steps import colour_key
from stereorelight.stereo.rectify import Rectification, rectification

VERSION = 1
SHOT_FRAMES = 9  # of a shot are enough for one rig: some thousand matches
ROOMS = ("calibration/drift.py", "calibration/features.py", "calibration/robust.py", "engine/points.py", "shot/mend.py")
Told = Callable[[str, int, int], object]


@dataclass(frozen=True, kw_only=True)
class Mends:
    """By how much the right eye stands off its rig, frame by frame.

    values : frame name to the six numbers of `Drift.values`; empty where nothing is mended.
    words  : what was done, for the receipts, by frame name.
    """

    values: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)

    def rig(self, rig: Rig, pair: Pair) -> Rig:
        """The rig as it stood at this frame."""
        told = self.values.get(pair.name)
        return rig if told is None else apply(rig, _drift(told))


def _drift(values: Sequence[float]) -> Drift:
    pitch, yaw, roll, zoom, rise, forward = values
    return Drift(pitch_deg=pitch, yaw_deg=yaw, roll_deg=roll, zoom=1 + zoom / 100, rise_deg=rise, forward_deg=forward, sigmas={})


def _spread(pairs: Sequence[Pair], count: int) -> list[Pair]:
    """`count` of the pairs, evenly spread, ends included."""
    if len(pairs) <= count:
        return list(pairs)
    return [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, count).round().astype(int))]


def _keys(shot: Shot, pairs: Sequence[Pair]) -> list[Pair]:
    """The frames that [rig] drift_frames names."""
    wanted = frame_range(str(shot.tables.rig.drift_frames))
    have = {pair.number: pair for pair in pairs}
    for number in wanted:
        if number not in have:
            raise ShotError(
                f"{shot.path}: rig.drift_frames names frame {number}, which the shot does not have; it has {pairs[0].name}-{pairs[-1].name}"
            )
    return [have[number] for number in wanted]


def mends_of(shot: Shot, rectified: Rectification, *, told: Told = lambda name, done, total: None) -> Mends:
    """What the shot file asks to be mended, found from the footage or read from drift.json where that stands.

    told   : is called with a frame's name, frames done and frames in all.
    Raises : PlateError where the footage has too few matches; RigError where it belongs to another rig; ShotError for frames
             that are not there.
    """
    table = shot.tables.rig
    if table.drift == "off":
        return Mends()
    if table.drift_window % 2 == 0:
        raise ShotError(f"{shot.path}: rig.drift_window must be an odd number of frames, got {table.drift_window}")
    pairs = _whole(shot)
    speaking = _keys(shot, pairs) if table.drift_frames else list(pairs) if table.drift == "frame" else _spread(pairs, SHOT_FRAMES)
    sources = {pair.name: [pair.digest(eye) for eye in EYES] for pair in speaking}
    key = digest(sources, [pair.name for pair in pairs], table.model_dump(), colour_key(shot), _rig_numbers(rectified.original), code_digest(*ROOMS))
    path = shot.folder / "drift.json"
    if (stood := _read(path, key)) is not None:
        return stood
    mends = _found(shot, rectified, pairs, speaking, told)
    data = {"version": VERSION, "key": key, "values": {k: list(v) for k, v in mends.values.items()}, "words": dict(mends.words)}
    write_text(path, json.dumps(data, indent=1) + "\n", force=True)
    return mends


def _whole(shot: Shot) -> tuple[Pair, ...]:
    try:
        return pairs_of(eyes_of_shot(shot))
    except PlateError as error:
        wanted = f'rig.drift = "{shot.tables.rig.drift}" looks at the whole shot, not at --frames'
        raise PlateError(f"{error} ({wanted}: name the frames of the shot in [plates] frames)") from None


def _rig_numbers(rig: Rig) -> list[Any]:
    cameras = [[c.size, c.K.tolist(), c.model, list(c.distortion)] for c in (rig.left, rig.right)]
    return [*cameras, rig.R_right_left.tolist(), list(map(float, rig.t_right_left_m)), rig.mirrored]


def _read(path: Path, key: str) -> Mends | None:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["version"] != VERSION or data["key"] != key:
            return None
        return Mends(values={k: tuple(v) for k, v in data["values"].items()}, words=data["words"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _found(shot: Shot, rectified: Rectification, pairs: Sequence[Pair], speaking: Sequence[Pair], told: Told) -> Mends:
    table, rig = shot.tables.rig, rectified.original
    matches: dict[str, Matches] = {}
    damaged: list[PlateError] = []
    for done, pair in enumerate(speaking):
        told(pair.name, done, len(speaking))
        try:
            left, right = read_upright(pair, rectified, colour=shot.colour)
        except PlateError as error:
            if table.drift_frames:
                raise
            damaged.append(error)  # the run tells of it when it comes to it, and keeps what is good before it
            continue
        matches[pair.name] = match_points(left, right, rig=rig)
    if not matches:
        raise damaged[0]
    try:
        whole = solve_drift(rig, pooled(list(matches.values())))
    except PlateError as error:
        raise PlateError(f"{pairs[0].left.pictures.pattern}: the rig cannot be mended from this shot: {error}") from None
    if table.drift == "shot":
        return _mends(pairs, [whole] * len(pairs), whole)
    alone: dict[str, Drift | None] = {}
    for name, points in matches.items():
        try:
            alone[name] = solve_drift(rig, points, around=whole)
        except PlateError:  # too few matches in this frame: its neighbours speak for it
            alone[name] = None
    if table.drift_frames:
        keys = {int(pair.number or 0): drift for pair in speaking if (drift := alone[pair.name]) is not None}
        return _mends(pairs, [keyed(keys, int(pair.number or 0)) for pair in pairs], whole)
    return _mends(pairs, smoothed([alone.get(pair.name) for pair in pairs], window=table.drift_window), whole)


def _mends(pairs: Sequence[Pair], drifts: Sequence[Drift], whole: Drift) -> Mends:
    better = ""
    if whole.before is not None and whole.after is not None:
        better = f"; vertical error of the shot {whole.before.mean:.3f} px mean before, {whole.after.mean:.3f} px after, {whole.matches} matches"
    return Mends(
        values={pair.name: tuple(round(float(v), 9) for v in drift.values) for pair, drift in zip(pairs, drifts)},
        words={pair.name: drift.words() + better for pair, drift in zip(pairs, drifts)},
    )


class MendedRectification:
    """The rectification of each frame's rig; neighbours that share a rig share its maps."""

    def __init__(self, rectified: Rectification, mends: Mends) -> None:
        self._plain, self._mends = rectified, mends
        self._last: tuple[tuple[float, ...], Rectification] | None = None

    def of(self, pair: Pair) -> Rectification:
        told = self._mends.values.get(pair.name)
        if told is None:
            return self._plain
        if self._last is None or self._last[0] != told:
            self._last = (told, rectification(self._mends.rig(self._plain.original, pair)))
        return self._last[1]
