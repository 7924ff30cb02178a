"""Files of relit pictures: against the truth, and one eye against the other.

In: EXRs as `run` and `relight` write them (the picture in R G B, lights in their layers), of one frame or of a sequence.  Out: a `Judged`
as of every comparison.  One frame is in memory at a time; maps are those of the worst frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.camera import Rig
from stereorelight.compare.figures import Curve, Figure, FrameFigures, Measured
from stereorelight.compare.picture import picture_measured
from stereorelight.compare.stereo import stereo_measured
from stereorelight.errors import PassError, PlateError, StereoRelightError
from stereorelight.footage.frames import read_frame
from stereorelight.footage.plates import read_plate
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.passes import Frame
from stereorelight.shot.judge import NAMED, Judged, Told, frames_of
from stereorelight.shot.matte_files import matte_channel

VIEWED = "specular"  # layers of that name look different from each eye
RANKED = {"picture": "relative_rms", "stereo": "eyes_rms"}


@dataclass(frozen=True, kw_only=True)
class AskedPicture:
    """What is to be compared.

    plate      : file or pattern of the plate that was relit; adds the light alone.   plate_gain : what it was multiplied by.
    mattes     : name to file or pattern; figures inside each, too.                    peak : what counts as white.
    depth      : (left, right) files or patterns with each eye's Z, where the pictures do not hold it; for two eyes.
    """

    plate: str | None = None
    plate_gain: float = 1.0
    mattes: Mapping[str, str] = field(default_factory=dict)
    peak: float = 1.0
    rig: Rig | None = None
    depth: tuple[str, str] | None = None


def _picture(frame: Frame, path: Path) -> Float32:
    for name in ("beauty", "plate"):
        if name in frame:
            found: Float32 = frame[name]
            return found
    raise PassError(f"{path}: has no picture in R, G and B; there are: {', '.join(frame)}")


def _lights(frame: Frame, *, matte_only: bool = False) -> dict[str, Float32]:
    """What each light adds, by its name: its layers summed, without those that each eye sees its own way where asked."""
    out: dict[str, Float32] = {}
    for name in frame:
        if not name.startswith("light_") or name == "light_indirect":
            continue
        base, _, part = name.removeprefix("light_").rpartition("_")
        if part not in ("diffuse", "specular") or (matte_only and part == VIEWED):
            continue
        out[base] = out[base] + frame[name] if base in out else frame[name]
    return out


def _picture_frame(result: Path, truth: Path, asked: AskedPicture, number: int | None) -> Measured:
    found, true = read_frame(result), read_frame(truth)
    plate = None if asked.plate is None else read_plate(Pattern.parse(asked.plate).path(number))
    mine, theirs = _lights(found), _lights(true)
    both = {name: (mine[name], theirs[name]) for name in mine if name in theirs}
    mattes = {name: matte_channel(Pattern.parse(file).path(number), None) for name, file in asked.mattes.items()}
    told = picture_measured(
        _picture(found, result), _picture(true, truth), plate=plate, plate_gain=asked.plate_gain, lights=both, mattes=mattes, peak=asked.peak
    )
    apart = sorted(set(mine) ^ set(theirs))
    return told.with_notes([f"lights of one file alone are left out: {', '.join(apart)}"] if apart and both else [])


def _depth_of(frame: Frame, path: Path, file: str | None, number: int | None) -> Float32:
    if file is not None:
        path = Pattern.parse(file).path(number)
        frame = read_frame(path)
    if "Z" not in frame:
        raise PassError(f"{path}: has no pass Z, by which one eye is carried to the other; name each eye's depth with --depth LEFT RIGHT")
    found: Float32 = frame["Z"]
    return found


def _stereo_frame(left: Path, right: Path, asked: AskedPicture, number: int | None) -> Measured:
    if asked.rig is None:
        raise PassError("two eyes are compared through their rig: give --rig rig.json")
    a, b = read_frame(left), read_frame(right)
    files = asked.depth or (None, None)
    depths = _depth_of(a, left, files[0], number), _depth_of(b, right, files[1], number)
    pictures: list[Float32] = []
    notes: list[str] = []
    for frame, path in ((a, left), (b, right)):
        beauty = _picture(frame, path).copy()
        shiny = [name for name in frame if name.startswith("light_") and name.endswith(f"_{VIEWED}")]
        for name in shiny:
            beauty -= frame[name]
        pictures.append(beauty)
        notes = [f"left out, since each eye sees its own: {', '.join(shiny)}"] if shiny else notes
    mine, theirs = (_lights(frame, matte_only=True) for frame in (a, b))
    lights = {name: (mine[name], theirs[name]) for name in mine if name in theirs}
    return stereo_measured(pictures[0], pictures[1], *depths, asked.rig, lights=lights).with_notes(notes)


def judge_pictures(
    what: str, result: str | Path, truth: str | Path, asked: AskedPicture, *, frames: str | None = None, told: Told = lambda *_: None
) -> Judged:
    """`what` "picture": file or pattern `result` against `truth`; "stereo": the left eye's against the right eye's.

    Raises : PlateError for frames and files that are not there, PassError for passes that are not there or do not fit.
    """
    files = Pattern.parse(str(result)), Pattern.parse(str(truth))
    numbers, notes = frames_of(*files, frames)
    each: list[tuple[int | None, Measured]] = []
    worst, most = None, -1.0
    for done, number in enumerate(numbers):
        paths = files[0].path(number), files[1].path(number)
        told(paths[0].name, done, len(numbers))
        try:
            made = (_picture_frame if what == "picture" else _stereo_frame)(*paths, asked, number)
        except StereoRelightError as error:
            if isinstance(error, PlateError) or str(error).startswith(tuple(str(p) for p in paths)):
                raise
            raise type(error)(f"{paths[0]} against {paths[1]}: {error}") from None
        bad = next(f.value for f in made.figures if f.name == RANKED[what])
        each.append((number, replace(made, maps=(), blinks=())))
        if worst is None or bad > most:
            worst, most = made, bad
    if worst is None:
        raise PlateError(f"{result} and {truth} have no frame in common")
    measured = worst.with_notes(notes) if len(each) == 1 else _over(each, worst, what).with_notes(notes)
    return Judged(measured=measured, nested=measured.to_dict())


def _over(each: list[tuple[int | None, Measured]], worst: Measured, what: str) -> Measured:
    """The frames' figures averaged, the worst ones named, the worst one's maps."""
    values: dict[tuple[str, str, str], list[float]] = {}
    for _, made in each:
        for f in made.figures:
            values.setdefault((f.table, f.region, f.name), []).append(f.value)
    mean: list[Figure] = []
    for f in worst.figures:
        known = [v for v in values[f.table, f.region, f.name] if np.isfinite(v)]
        mean.append(replace(f, value=float(np.mean(known)) if known else f.value))
    rank = RANKED[what]
    curve = [(number or 0, next(f.value for f in made.figures if f.name == rank)) for number, made in each]
    ranked = sorted(curve, key=lambda pair: -pair[1])[:NAMED]
    steps = tuple(FrameFigures(number=number, values={f.name: f.value for f in made.figures if f.region == "all"}) for number, made in each)
    line = ([float(n) for n, _ in curve], [v for _, v in curve])
    return replace(
        worst,
        figures=tuple(mean),
        frames=steps,
        curves=(*worst.curves, Curve(title=f"{rank} over the frames", lines={rank: line}, x_label="frame", y_label="%")),
        notes=(*worst.notes, f"means of {len(each)} frames; worst: {', '.join(f'{n} ({v:.2f})' for n, v in ranked)}"),
    )
