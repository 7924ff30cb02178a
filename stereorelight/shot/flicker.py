"""Flicker of a shot: what depth, normals or the relit picture do from frame to frame that the scene does not.

In: a sequence of EXRs with Z, N or a picture, and plates whose motion is followed, or a truth that says the motion or how the scene itself
changes.  Out: a `Judged` as of every comparison.  Two frames are in memory at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.compare.figures import Curve, ErrorMap, Figure, FrameFigures, Measured
from stereorelight.compare.flicker import picture_residual, residual
from stereorelight.compare.tally import Tally
from stereorelight.errors import PassError, PlateError
from stereorelight.footage.clip import Clip, open_clip
from stereorelight.footage.frames import read_frame
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.passes import Frame
from stereorelight.shot.judge import NAMED, Judged, Told, frames_of
from stereorelight.stereo.temporal import LIMIT_PX, Glimpse, glimpse, motion_between

THRESHOLDS = {"Z": (1.0, 2.0, 5.0), "N": (2.0, 5.0, 10.0), "picture": (2.0, 5.0, 10.0), "plate": (2.0, 5.0, 10.0)}
UNITS = {"Z": "%", "N": "deg", "picture": "%", "plate": "%"}
SCALES = {"Z": 5.0, "N": 10.0, "picture": 10.0, "plate": 10.0}
WORDS = {
    "Z": "Z, per cent of it",
    "N": "N, degrees",
    "picture": "picture, per cent of its mean light",
    "plate": "plate itself, per cent of its mean light",
}
RANKED = ("Z", "picture", "N", "plate")  # what frames are ranked by: the first that there is


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """One frame: its passes, the truth's, its plate and what its motion is found from."""

    frame: Frame
    truth: Frame | None
    plate: Float32 | None
    glimpse: Glimpse | None


def flicker(
    result: str | Path,
    truth: str | Path | None = None,
    *,
    plate: str | Path | None = None,
    frames: str | None = None,
    pictures: bool = False,
    told: Told = lambda *_: None,
) -> Judged:
    """The flow-warped residuals of a sequence.

    truth : our EXRs whose Z and N change as the scene does: their own change is taken off; a pass `flow` in them is the motion.
    plate : the plates whose motion is followed, where the truth does not say it; the EXRs' own `plate` where left out.
    Raises: PlateError, PassError where there are fewer than two frames in a row, no motion, or nothing to judge.
    """
    files = Pattern.parse(result), None if truth is None else Pattern.parse(truth)
    if files[0].is_single:
        raise PlateError(f"{result}: is a single file, but flicker needs frames in a row; give a pattern such as name.####.exr")
    numbers, notes = frames_of(files[0], files[1] or files[0], frames)
    clip = None if plate is None else open_clip(str(plate))
    pairs = [(a, b) for a, b in pairwise(numbers) if a is not None and b is not None and b == a + 1]
    if not pairs:
        raise PlateError(f"{result}: no two frames in a row among {len(numbers)}; flicker is judged from each frame to the next")
    if len(pairs) < len(numbers) - 1:
        notes.append(f"{len(numbers) - 1 - len(pairs)} steps between frames that are not in a row are left out")
    total: dict[str, Tally] = {}
    each: list[tuple[int, dict[str, float]]] = []
    before: tuple[int, _Seen] | None = None
    for done, (a, b) in enumerate(pairs):
        told(files[0].path(b).name, done, len(pairs))
        first = before[1] if before is not None and before[0] == a else _seen(files, clip, a)
        second = _seen(files, clip, b)
        before = (b, second)
        maps, judged = _residuals(first, second, files[0].path(b))
        tallies = {k: Tally.of(m[judged], unit=UNITS[k], thresholds=THRESHOLDS[k]) for k, m in maps.items()}
        total = {k: total[k] + t if k in total else t for k, t in tallies.items()}
        each.append((b, {f"{k}_rms": t.figures().rms for k, t in tallies.items()} | {f"{k}_median": t.median for k, t in tallies.items()}))
    if not total:
        raise PassError(f"{result}: holds no Z, N or picture, so that there is nothing to flicker")
    key = next(k for k in RANKED if k in total)
    ranked = sorted(each, key=lambda item: -np.nan_to_num(item[1][f"{key}_rms"], nan=np.inf))
    worst = ", ".join(f"{n} ({v[f'{key}_rms']:.3g} {UNITS[key]})" for n, v in ranked[:NAMED])
    notes.append(f"{len(pairs)} steps from frame to frame; the worst, into frame, by {key}_rms: {worst}")
    figures = [f for k, t in total.items() for f in _figures(k, t)]
    worst_rms = ranked[0][1]
    figures += [Figure(name=f"{k}_rms", value=worst_rms[f"{k}_rms"], unit=UNITS[k], table="worst step", region="worst_frame") for k in total]
    error_maps: tuple[ErrorMap, ...] = ()
    if pictures:
        last = ranked[0][0]
        maps, judged = _residuals(_seen(files, clip, last - 1), _seen(files, clip, last), files[0].path(last))
        error_maps = tuple(
            ErrorMap(
                title=f"From frame {last - 1} to {last}, the worst: {WORDS[k]}; grey where nothing is found again",
                error=m,
                known=judged,
                scale=SCALES[k],
                unit=UNITS[k],
                sequential=True,
            )
            for k, m in maps.items()
        )
    curves = [_over_time(k, each) for k in total]
    curves += [
        Curve(title=f"{WORDS[k]}: share of the pixels within a residual", lines={k: t.curve()}, x_label=UNITS[k], y_label="% of pixels", log_x=True)
        for k, t in total.items()
    ]
    measured = Measured(
        what="flicker",
        figures=tuple(figures),
        maps=error_maps,
        curves=tuple(curves),
        frames=tuple(FrameFigures(number=n, values=v) for n, v in each),
        notes=tuple(notes),
    )
    nested = {k: {f.key.removeprefix(f"{k}_"): f.value for f in _figures(k, t)} for k, t in total.items()}
    return Judged(measured=measured, nested=nested | {"pairs": len(pairs), "worst_frames": [n for n, _ in ranked[:NAMED]]})


def _figures(name: str, tally: Tally) -> list[Figure]:
    told, table, unit = tally.figures(), f"flicker of {name}", UNITS[name]
    rows = [("median", tally.median), ("mean", told.average), ("rms", told.rms), ("A90", told.quantiles[90]), ("A99", told.quantiles[99])]
    out = [Figure(name=f"{name}_pixels", value=float(told.pixels), table=table, digits=0, column="pixels")]
    out.append(Figure(name=f"{name}_cover", value=told.cover_percent, unit="%", table=table, digits=2, column="cover", high_is_good=True))
    return out + [Figure(name=f"{name}_{key}", value=value, unit=unit, table=table, column=key) for key, value in rows]


def _over_time(name: str, each: Sequence[tuple[int, dict[str, float]]]) -> Curve:
    lines = {key: ([float(n) for n, _ in each], [v[f"{name}_{key}"] for _, v in each]) for key in ("rms", "median")}
    return Curve(title=f"{WORDS[name]}, into each frame", lines=lines, x_label="frame", y_label=UNITS[name])


def _seen(files: tuple[Pattern, Pattern | None], clip: Clip | None, number: int) -> _Seen:
    path = files[0].path(number)
    frame = read_frame(path)
    truth = None if files[1] is None else read_frame(files[1].path(number))
    plate = clip.read(number) if clip is not None else frame.passes.get("plate")
    if plate is None and truth is not None:
        plate = truth.passes.get("plate")
    if plate is not None and plate.shape[:2] != frame.size_hw:
        h, w = frame.size_hw
        raise PassError(f"{path}: is {w} x {h} pixels, but its plate {plate.shape[1]} x {plate.shape[0]}; give the plate of these passes")
    if truth is not None and truth.size_hw != frame.size_hw:
        h, w = frame.size_hw
        raise PassError(f"{path}: is {w} x {h} pixels, but its truth {truth.size_hw[1]} x {truth.size_hw[0]}; give both at one size")
    if truth is not None and "flow" in truth:
        return _Seen(frame=frame, truth=truth, plate=plate, glimpse=None)
    if plate is None:
        raise PassError(f"{path}: nothing tells the motion from frame to frame; give the plates with --plate, or a TRUTH with a pass flow")
    return _Seen(frame=frame, truth=truth, plate=plate, glimpse=glimpse(plate, frame, px_m=1.0))


def _motion(a: _Seen, b: _Seen) -> Float32:
    """(H, W, 2) px from a to b, NaN where a pixel is not found again or motions meet."""
    if a.truth is not None and "flow" in a.truth:
        return np.asarray(a.truth["flow"], np.float32)
    assert a.glimpse is not None
    assert b.glimpse is not None
    way, _ = motion_between(a.glimpse, b.glimpse)
    there = np.where(((way.astray <= LIMIT_PX) & ~way.bent)[..., None], way.there, np.float32(np.nan))
    h, w = a.frame.size_hw
    if there.shape[:2] == (h, w):
        return there
    rows = np.minimum((np.arange(h) * there.shape[0] // h), there.shape[0] - 1)
    columns = np.minimum((np.arange(w) * there.shape[1] // w), there.shape[1] - 1)
    scale = np.array([w / there.shape[1], h / there.shape[0]], np.float32)
    return np.asarray(there[np.ix_(rows, columns)] * scale, np.float32)


def _residuals(a: _Seen, b: _Seen, path: Path) -> tuple[dict[str, Float32], Any]:
    """The maps of residuals by what they are of, and which pixels are judged."""
    motion = _motion(a, b)
    judged = np.isfinite(motion).all(axis=-1)
    if not judged.any():
        raise PassError(f"{path}: no pixel of the frame before is found again; are the plates those of this shot?")
    maps: dict[str, Float32] = {}
    if "Z" in a.frame and "Z" in b.frame:
        truth = None
        if a.truth is not None and b.truth is not None and "Z" in a.truth and "Z" in b.truth:
            truth = (a.truth["Z"], a.truth.passes.get("N")), (b.truth["Z"], b.truth.passes.get("N"))
        Z, N = residual((a.frame["Z"], a.frame.passes.get("N")), (b.frame["Z"], b.frame.passes.get("N")), motion, truth=truth)
        maps["Z"] = Z
        if N is not None:
            maps["N"] = N
    for name, key in (("picture", "beauty"), ("plate", "plate")):
        pair = (a.frame.passes.get(key), b.frame.passes.get(key)) if key == "beauty" else (a.plate, b.plate)
        if pair[0] is not None and pair[1] is not None and (key == "beauty" or "picture" in maps):
            maps[name] = picture_residual(pair[0], pair[1], motion)
    return maps, judged
