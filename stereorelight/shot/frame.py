"""One frame of a run: every step of it that does not stand from an earlier run.

Every step has a key: a hash over its inputs, the settings that it reads and the code that does it.  A step whose key and
files are as the receipt says is not done again, so that a run that stopped goes on where it was."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from stereorelight.arrays import Float32
from stereorelight.errors import OutputError, ShotError
from stereorelight.footage.eyes import Eyes
from stereorelight.footage.preview import depth_range
from stereorelight.interchange.rigs import files_of, read_rig, rig_to_dict
from stereorelight.shot.hints import check_hints, hints_key
from stereorelight.shot.job import FrameJob
from stereorelight.shot.lighting import Lighting, lighting_of
from stereorelight.shot.materials import MaterialsOfShot, spread_over
from stereorelight.shot.mend import MendedRectification, Mends
from stereorelight.shot.neighbours import Neighbours
from stereorelight.shot.pairs import EYES, Pair, eyes_of_shot, pairs_of
from stereorelight.shot.plate_light import Reference
from stereorelight.shot.receipt import Receipt, code_digest, digest, file_digest, versions
from stereorelight.shot.repairs import Repairs
from stereorelight.shot.schema import Shot, read_shot
from stereorelight.shot.steps import STEPS, Step, colour_key, matcher_key
from stereorelight.stereo.rectify import Rectification, rectification
from stereorelight.surface.shading_trust import Judged

Note = Callable[[dict[str, Any]], object]
State = Literal["begins", "done", "stands"]


@dataclass(frozen=True, kw_only=True)
class Event:
    """What a run of so many `frames`, each of so many `steps`, is doing: `step` of `frame` begins, is done, or stands."""

    frames: int
    steps: int
    frame: str
    step: str
    state: State
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """A shot that is ready to run: everything read and checked that all frames share.

    rig_key   : hash of the rig's numbers.     range_key : hash of what the preview range depends on.
    """

    shot: Shot
    rig_path: Path
    rectification: Rectification
    eyes: Eyes
    pairs: tuple[Pair, ...]
    rig_key: str
    range_key: str
    mends: Mends = field(default_factory=Mends)

    @functools.cached_property
    def rigs(self) -> MendedRectification:
        """The rectification of every frame."""
        return MendedRectification(self.rectification, self.mends)

    @functools.cached_property
    def near(self) -> Neighbours:
        """The frames about each frame, and what is kept of them."""
        rig = self.rectification.rig
        return Neighbours(self.shot, self.eyes, self.rigs.of, rig.left.fx * rig.baseline_m)

    @functools.cached_property
    def materials(self) -> MaterialsOfShot | None:
        """What shading knows of the whole shot; None where it has no say, and where each picture judges for itself.

        The frames that judge do it each by itself: matched, not steadied, and without repairs, which costs a fifth and comes to the same.
        """
        if not self.shot.shades:
            return None
        tables, numbers = self.shot.tables, spread_over(self.shot, self.eyes)
        settings = [tables.depth.model_dump(), tables.surface.model_dump(), tables.plates.match_colour, matcher_key(self.shot), colour_key(self.shot)]

        def judge(pair: Pair) -> Judged:
            return FrameJob(shot=self.shot, rectification=self.rigs.of(pair), pair=pair).judged()

        def depends(pair: Pair) -> Any:
            return [_rig_key(self, pair), settings, hints_key(self.shot, [pair])]

        return MaterialsOfShot(numbers, judge, depends=depends, path=self.shot.folder / "materials.json") if numbers else None

    @functools.cached_property
    def whole(self) -> tuple[Pair, ...]:
        """Every pair of the shot, not only those that are run."""
        return self.pairs if self.pairs[0].number is None else pairs_of(eyes_of_shot(self.shot))

    @functools.cached_property
    def lighting(self) -> Lighting:
        """What lights every frame; it keeps the points that it has tracked so far."""
        tracked = any(track.moving.stuck for track in self.shot.setup.lights)
        pairs = {pair.number: pair for pair in (self.whole if tracked else self.pairs) if pair.number is not None}

        def plate(number: int) -> Float32:
            pair = pairs[number]
            return FrameJob(shot=self.shot, rectification=self.rigs.of(pair), pair=pair).plate

        return lighting_of(
            self.shot.setup,
            numbers=list(pairs),
            plate=plate,
            digest=lambda number: pairs[number].digest("left"),
            colour=self.shot.colour,
            rig=self.rectification.original,
            reference=self._reference(),
        )

    def _reference(self) -> tuple[Callable[[], Reference], Callable[[], Any]] | None:
        """The frame that speaks for the plate's own light: the one asked for, else the middle of the whole shot; and what it depends on."""
        knobs = self.shot.setup.relight
        if knobs.albedo == "plate":
            return None
        at = {pair.number: pair for pair in self.whole}
        if knobs.albedo_frame is not None and knobs.albedo_frame not in at:
            have = f"{self.whole[0].number}-{self.whole[-1].number}" if self.whole[0].number is not None else "a single picture: leave it out"
            raise ShotError(f"{self.shot.path}: relight: albedo_frame {knobs.albedo_frame} is not in the shot, which has {have}")
        pair = self.whole[len(self.whole) // 2] if knobs.albedo_frame is None else at[knobs.albedo_frame]

        def made() -> Reference:
            # Made anew from its plates, whether its files are there or not: a part of the shot gives what the whole gives.
            job = FrameJob(
                shot=self.shot, rectification=self.rigs.of(pair), pair=pair, repairs=self.repairs, near=self.near, lighting=self.lighting,
                materials=self.materials,
            )  # fmt: skip
            job.recovered()
            job.made_surface()
            return Reference(number=pair.number, plate=job.plate, passes=job.lit_passes(), camera=job.posed_camera)

        def key() -> Any:
            near = [[k, *digests, self.mends.values.get(other.name)] for k, (other, digests) in self.near.inputs_about(pair).items()]
            repaired = None if self.repairs is None else self.repairs.key(pair)
            files = [file_digest(self.lighting._path(name, pair.number)) for name in self.shot.setup.files_at(pair.number)]
            shaded = None if self.materials is None else self.materials.key
            hints = hints_key(self.shot, [pair, *self.near.pairs_about(pair).values()])
            return [pair.digest("left"), pair.digest("right"), near, repaired, self.mends.values.get(pair.name), files, shaded, hints]

        return made, key

    @functools.cached_property
    def repairs(self) -> Repairs | None:
        """What the shot file repairs, for every frame; it keeps what it has carried so far."""
        if not self.shot.tables.repairs:
            return None

        def job(pair: Pair) -> FrameJob:
            return FrameJob(shot=self.shot, rectification=self.rigs.of(pair), pair=pair)

        return Repairs(shot=self.shot, whole=self.whole, plate=lambda pair: job(pair).plate, depth=lambda pair: job(pair).recovered()["Z"])


@dataclass(frozen=True, kw_only=True)
class FrameResult:
    """What was done for one frame; figures and seconds by step, no seconds for one that stood."""

    frame: str
    done: int
    stood: int
    figures: dict[str, Any]
    seconds: dict[str, float]


def prepare(path: str | Path, frames: str | None = None) -> Prepared:
    """Read shot file and rig, and find the frames.  Raises ShotError, RigError, PlateError."""
    shot = read_shot(path)
    eyes = eyes_of_shot(shot, frames)
    rig_path = shot.resolved(shot.tables.rig.file)
    rig = read_rig(rig_path)
    rig_key = digest(rig_to_dict(rig) | {"quality": None})
    ready = Prepared(
        shot=shot,
        rig_path=rig_path,
        rectification=rectification(rig),
        eyes=eyes,
        pairs=pairs_of(eyes),
        rig_key=rig_key,
        range_key=digest(rig_key, shot.tables.depth.model_dump()),
    )
    if ready.repairs is not None:
        ready.repairs.check()
    check_hints(shot, ready.pairs)
    ready.lighting.check([pair.number for pair in ready.pairs])
    return ready


def _key(step: Step, job: FrameJob, keys: dict[str, str], sources: dict[str, Any]) -> str:
    """What `step` of this frame depends on, as one hash."""
    upstream = {name: keys[name] for name in step.after}
    inputs = sources if step.sources else {}
    look = [job.preview_range_m, job.path("previews").name] if step.ranged else None
    own = step.inputs(job)
    return digest(step.name, upstream, inputs, step.settings(job.shot), code_digest(*step.rooms), dict(versions()), look, own)


def _preview_range(job: FrameJob, noted: dict[str, Any], range_key: str, note: Note) -> tuple[float, float]:
    """The distances that the depth previews span: as set, else as measured on the first frame ever run with these settings."""
    output = job.shot.tables.output
    if noted.get("key") != range_key:
        near, far = depth_range(job.depth["Z"])
        noted.update(key=range_key, near_m=near, far_m=far, frame=job.pair.name)
        note(dict(noted))
    near, far = output.preview_near_m or noted["near_m"], output.preview_far_m or noted["far_m"]
    return float(near), float(max(far, near * 1.02))


def _do(step: Step, job: FrameJob, receipt: Receipt, key: str, *, force: bool) -> float:
    """Do one step and note it in the receipt.  Returns the seconds it took."""
    files = step.files(job)
    for file in files:
        if file.exists() and not force and not receipt.owns(file):
            raise OutputError(f"{file}: exists and was not written by a run of this shot; move it away, or give --force to replace it")
    before = time.monotonic()
    made = step.make(job)
    receipt.begin(step.name, key, files)
    made.write()
    seconds = time.monotonic() - before
    receipt.finish(step.name, files, made.figures, seconds)
    return seconds


def _rig_key(ready: Prepared, pair: Pair) -> str:
    """Hash of the rig as it stood at this frame."""
    told = ready.mends.values.get(pair.name)
    return ready.rig_key if told is None else digest(ready.rig_key, told)


def run_frame(
    ready: Prepared, pair: Pair, *, noted: dict[str, Any], note: Note, force: bool = False, on_event: Callable[[Event], None] = lambda event: None
) -> FrameResult:
    """Every step of one frame that does not stand.

    noted : the preview range of run.json, {} where none is known; `note` is told when it is measured.
    """
    shot = ready.shot
    job = FrameJob(
        shot=shot, rectification=ready.rigs.of(pair), pair=pair, repairs=ready.repairs, near=ready.near, lighting=ready.lighting,
        materials=ready.materials,
    )  # fmt: skip
    receipt = Receipt(job.receipt_path, shot.folder)
    sources: dict[str, Any] = {"left": pair.digest("left"), "right": pair.digest("right"), "rig": _rig_key(ready, pair)}
    if about := ready.near.inputs_about(pair):
        sources["near"] = [[k, *digests, _rig_key(ready, other)] for k, (other, digests) in about.items()]
    if (mattes := hints_key(shot, [pair, *ready.near.pairs_about(pair).values()])) is not None:
        sources["hints"] = mattes
    if ready.repairs is not None and (painted := ready.repairs.key(pair)) is not None:
        sources["repairs"] = painted
    receipt.head = _head(ready, pair, sources)
    keys: dict[str, str] = {}
    figures: dict[str, Any] = {}
    spent: dict[str, float] = {}
    done = stood = 0
    wanted = [step for step in STEPS if step.wanted(shot)]

    def tell(step: Step, state: State, seconds: float = 0.0) -> None:
        on_event(Event(frames=len(ready.pairs), steps=len(wanted), frame=pair.name, step=step.name, state=state, seconds=seconds))

    for step in wanted:
        if step.ranged:
            job.preview_range_m = _preview_range(job, noted, ready.range_key, note)
        key = keys[step.name] = _key(step, job, keys, sources)
        if not force and receipt.stands(step.name, key):
            stood += 1
            spent[step.name] = 0.0
            tell(step, "stands")
        else:
            tell(step, "begins")
            seconds = _do(step, job, receipt, key, force=force)
            done += 1
            spent[step.name] = seconds
            tell(step, "done", seconds)
        figures[step.name] = receipt.steps[step.name]["figures"]
    return FrameResult(frame=pair.name, done=done, stood=stood, figures=figures, seconds=spent)


def _head(ready: Prepared, pair: Pair, sources: dict[str, Any]) -> dict[str, Any]:
    """What a receipt says of the frame as a whole."""
    return {
        "frame": pair.number,
        "inputs": {
            **{eye: {"file": pair.file(eye).as_posix(), "frame": pair.clip(eye)[1], "sha256": sources[eye]} for eye in EYES},
            "rig": {"file": ready.rig_path.as_posix(), "sha256": " ".join(map(file_digest, files_of(ready.rig_path)))},
        },
        "plates": list(ready.eyes.notes),
        "rig_mended": ready.mends.words.get(pair.name),
        "settings": ready.shot.tables.model_dump(mode="json"),
        "versions": dict(versions()),
    }
