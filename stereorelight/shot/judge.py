"""Files of results against files of truth: which frames and passes to take, what the truth means, and what is said of them.

In: two files or patterns.  Out: a `Judged`: a `Measured` for tables, gates and page, and the nested figures for JSON.  One frame is in memory
at a time; of a sequence the worst frame is read once more for its maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.camera import Camera, RectifiedRig, Rig
from stereorelight.compare.calibrated import Calibration
from stereorelight.compare.figures import Curve, Figure, FrameFigures, Measured
from stereorelight.compare.tally import Groups, added
from stereorelight.errors import PassError, PlateError, StereoRelightError
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.footage.sequence import frame_range, frames_text
from stereorelight.interchange.poses import Poses
from stereorelight.interchange.rigs import read_rig
from stereorelight.passes import Flag, Frame
from stereorelight.shot.judge_frame import Look, look_at
from stereorelight.shot.judge_words import curves_of, figures_of, maps_of
from stereorelight.shot.truths import Stated
from stereorelight.synth.rigs import rectified_rig

What = Literal["depth", "disparity", "normals"]
WORST = ("bad2", "bad5%", "normal_median", "average_px", "average_%")  # what frames are ranked by: the first that there is
OVER_TIME = ("bad2", "bad5%", "average_px", "average_%", "cover", "normal_median", "normal_cover")
NAMED = 5  # worst frames named
Told = Callable[[str, int, int], object]


def rig_of_rectified(rig: RectifiedRig) -> Rig:
    """A rectified rig as the ordinary rig that it is: no rotation, the right eye along x."""
    return Rig(left=rig.left, right=rig.right, R_right_left=np.eye(3), t_right_left_m=np.array([-rig.baseline_m, 0.0, 0.0]))


def nonoccluded(truth: Frame) -> Bool | None:
    """(H, W) which pixels the other eye sees, or None where the truth does not say."""
    if "flags" not in truth:
        return None
    seen: Bool = (truth["flags"] & (Flag.OCCLUDED | Flag.OUT_OF_VIEW)) == 0
    return seen


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """What is to be compared, and what the user says of it.

    rig    : a rig whose plates are rectified as shot.   camera : of the plate, where a field of view was given.
    result : of the result's own convention; only kind, metres and layer are heard.   poses : of a world truth, frame by frame.
    """

    what: What
    rig: RectifiedRig | None = None
    camera: Camera | None = None
    fov_deg: float | None = None
    truth: Stated = field(default_factory=Stated)
    result: Stated = field(default_factory=Stated)
    poses: Poses | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """measured: for tables, gates and the page.   nested: the figures as JSON has them, {"metres": {"all": {...}}}."""

    measured: Measured
    nested: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """The nested figures, with the notes and the frames."""
        told = self.measured.to_dict()
        return self.nested | {key: told[key] for key in ("notes", "frames", "worst_frames") if key in told}

    def text(self) -> str:
        return self.measured.text()


def frames_of(result: Pattern, truth: Pattern, wanted: str | None) -> tuple[list[int | None], list[str]]:
    """The frames to compare, those of both or the `wanted`, and what to say of those left out.

    Raises : PlateError where a wanted frame is missing, or the two have none in common.
    """
    if result.is_single and truth.is_single:
        if wanted:
            raise PlateError(f"{result.pattern}: is a single file and has no frames; leave --frames out, or give patterns such as name.####.exr")
        return [None], []
    if result.is_single != truth.is_single:
        one, many = (result, truth) if result.is_single else (truth, result)
        raise PlateError(f"{one.pattern}: is a single file, but {many.pattern} is a sequence; give both alike")
    have = set(result.frames), set(truth.frames)
    if wanted:
        frames = list(frame_range(wanted))
        for pattern, there in zip((result, truth), have):
            if lost := [f for f in frames if f not in there]:
                raise PlateError(f"{pattern.path(lost[0])}: frame missing; there are {frames_text(pattern.frames)}")
        return list(frames), []
    both = sorted(have[0] & have[1])
    if not both:
        told = f"{frames_text(result.frames)} against {frames_text(truth.frames)}"
        raise PlateError(f"{result.pattern} and {truth.pattern} have no frame in common: {told}; are they of one shot, counted alike?")
    notes = []
    for name, mine, others in (("result", *have), ("truth", have[1], have[0])):
        if left_out := sorted(mine - others):
            notes.append(f"frames {frames_text(left_out)} are in the {name} alone, and left out")
    return list(both), notes


def judge(
    result: str | Path, truth: str | Path, asked: Asked, *, frames: str | None = None, pictures: bool = False, told: Told = lambda *_: None
) -> Judged:
    """All that is said of `result` against `truth`, two files or two patterns.

    pictures : whether maps and pictures for the page are wanted too.
    Raises   : PlateError for files that cannot be read, PassError for passes that are not there, do not fit or cannot be understood, RigError.
    """
    files = Pattern.parse(result), Pattern.parse(truth)
    numbers, notes = frames_of(*files, frames)
    total: Groups = {}
    sure: Calibration | None = None
    each: list[tuple[int | None, list[Figure]]] = []
    stated = asked.truth
    look: Look | None = None
    for done, number in enumerate(numbers):
        paths = files[0].path(number), files[1].path(number)
        told(paths[0].name, done, len(numbers))
        look = _looked(paths, asked, stated, number)
        stated = look.stated
        notes += [note for note in look.notes if done == 0]
        total = look.groups if not total else added(total, look.groups)
        sure = look.sure if sure is None else sure + look.sure
        each.append((number, [f for f in figures_of(asked.what, look.groups)[0] if f.region == "all"]))
        if len(numbers) > 1:
            look = None  # one frame at a time
    figures, nested = figures_of(asked.what, total)
    figures += [] if sure is None else sure.figures()
    curves = curves_of(asked.what, total) + ([] if sure is None else sure.curves())
    over_time: tuple[FrameFigures, ...] = ()
    data = dict[str, Any]()
    if len(numbers) > 1:
        over_time, time_curves, worst, extra = _over_time(each)
        curves, notes, data = [*time_curves, *curves], notes + extra, {"worst_frames": [n for n, _ in worst]}
        figures += [replace(f, region="worst_frame") for f in dict(each)[worst[0][0]] if f.region == "all"]
        nested["worst_frame"] = {f.key: f.value if np.isfinite(f.value) else None for f in figures if f.region == "worst_frame"}
        if pictures:
            number = worst[0][0]
            look = _looked((files[0].path(number), files[1].path(number)), asked, stated, number)
    maps, blinks = maps_of(asked.what, look) if pictures and look is not None else ((), ())
    measured = Measured(
        what=asked.what,
        figures=tuple(figures),
        curves=tuple(curves),
        maps=maps,
        blinks=blinks,
        frames=over_time,
        notes=tuple(dict.fromkeys(notes)),
        data=data,
    )
    return Judged(measured=measured, nested=nested)


def _looked(paths: tuple[Path, Path], asked: Asked, stated: Stated, number: int | None) -> Look:
    pose = None if asked.poses is None else asked.poses.at(number)
    try:
        return look_at(*paths, asked=replace(asked, truth=stated if pose is None else replace(stated, pose=pose)))
    except StereoRelightError as error:
        if str(error).startswith((str(paths[0]), str(paths[1]))):
            raise
        raise type(error)(f"{paths[0]} against {paths[1]}: {error}") from None


def _over_time(
    each: Sequence[tuple[int | None, list[Figure]]],
) -> tuple[tuple[FrameFigures, ...], list[Curve], list[tuple[int | None, float]], list[str]]:
    """Figures frame by frame, their curves, and the worst frames with what they were ranked by."""
    values = [(number, {f.name: f for f in figures if f.region == "all"}) for number, figures in each]
    names = [name for name in OVER_TIME if all(name in v for _, v in values)]
    frames = tuple(FrameFigures(number=number, values={name: v[name].value for name in names}) for number, v in values)
    key = next((k for k in WORST if k in names), names[0])
    ranked = sorted(((n, v[key].value) for n, v in values), key=lambda item: -(item[1] if np.isfinite(item[1]) else np.inf))
    unit = values[0][1][key].unit
    told = ", ".join(f"{n} ({value:.3g} {unit})" for n, value in ranked[: min(NAMED, len(ranked))])
    curves = [
        Curve(
            title=f"{name}, frame by frame",
            lines={name: ([float(f.number or 0) for f in frames], [f.values[name] for f in frames])},
            x_label="frame",
            y_label=f"{name} {values[0][1][name].unit}".strip(),
        )
        for name in names[:6]
    ]
    return frames, curves, ranked, [f"{len(each)} frames; the worst by {key}: {told}"]


def asked_rig(path: str | Path) -> RectifiedRig:
    """The rig of plates that are rectified as shot.  Raises RigError."""
    return rectified_rig(read_rig(path))


def checked_pass(frame: Frame, name: str, path: Path) -> Float32:
    """A pass of a file.  Raises PassError naming the file and what there is."""
    if name not in frame:
        raise PassError(f"{path}: has no pass {name!r}; there are: {', '.join(frame)}")
    return np.asarray(frame[name], np.float32)
