"""A shot from its plates to the relit picture, frame by frame, doing only what changed.

In: a shot file.  Out: the output folder with depth/, passes/, relit/, previews/, a receipt a frame and run.json.
Every step has a key: a hash over its inputs, the settings that it reads and the code that does it.  A step whose key and
files are as the receipt says is not done again, so that a run that stopped goes on where it was."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from stereorelight.errors import OutputError
from stereorelight.files import make_folder, write_text
from stereorelight.footage.preview import depth_range
from stereorelight.interchange.rigs import read_rig, rig_to_dict
from stereorelight.shot.job import FrameJob
from stereorelight.shot.pairs import Pair, pairs
from stereorelight.shot.receipt import Receipt, code_digest, digest, file_digest, versions
from stereorelight.shot.schema import Shot, read_shot
from stereorelight.shot.steps import STEPS, Step
from stereorelight.stereo.rectify import rectification

RUN_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Event:
    """What a run of so many `frames` is doing: `step` of `frame` begins, is done, or stands from an earlier run."""

    frames: int
    frame: str
    step: str
    state: Literal["begins", "done", "stands"]
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """What a run did.

    folder : the output folder.           frames : names of the frames, in order.
    done   : steps that were done.        stood  : steps that stood from an earlier run.
    figures: frame to step to figures, those that stood included.
    """

    folder: Path
    frames: tuple[str, ...]
    done: int
    stood: int
    seconds: float
    figures: dict[str, dict[str, Any]]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "folder": str(self.folder),
            "frames": list(self.frames),
            "steps_done": self.done,
            "steps_stood": self.stood,
            "seconds": round(self.seconds, 3),
            "figures": self.figures,
        }


class RunRecord:
    """run.json: what holds for the whole shot, such as the range of the depth previews, which must not pump."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data: dict[str, Any] = {"version": RUN_VERSION}
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(data, dict) and data.get("version") == RUN_VERSION:
                self.data = data
        except NotADirectoryError:
            raise OutputError(f"{path.parent}: a file stands where a folder is needed; choose another output folder") from None
        except (OSError, ValueError):
            pass

    def put(self, **values: Any) -> None:
        """Set keys, and write the file where that changed anything."""
        new = self.data | values
        if new != self.data or not self.path.exists():
            self.data = new
            write_text(self.path, json.dumps(self.data, indent=2) + "\n", force=True)


def _key(step: Step, job: FrameJob, keys: dict[str, str], sources: dict[str, str]) -> str:
    """What `step` of this frame depends on, as one hash."""
    upstream = {name: keys[name] for name in step.after}
    inputs = sources if step.sources else {}
    look = [job.preview_range_m, job.path("previews").name] if step.ranged else None
    return digest(step.name, upstream, inputs, step.settings(job.shot), code_digest(*step.rooms), dict(versions()), look)


def _preview_range(job: FrameJob, record: RunRecord, settings_key: str) -> tuple[float, float]:
    """The distances that the depth previews span: as set, else as measured on the first frame ever run with these settings."""
    output = job.shot.tables.output
    noted = record.data.get("preview_range") or {}
    if noted.get("key") != settings_key:
        near, far = depth_range(job.depth["Z"])
        noted = {"key": settings_key, "near_m": near, "far_m": far, "frame": job.pair.name}
        record.put(preview_range=noted)
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


def _writable(folder: Path) -> None:
    """Find out before any work whether results can be written; leaves nothing behind."""
    existed = folder.exists()
    make_folder(folder)
    try:
        write_text(folder / ".writable", "", force=True).unlink()
    finally:
        if not existed:
            folder.rmdir()


def run_shot(
    path: str | Path,
    *,
    frames: str | None = None,
    force: bool = False,
    on_event: Callable[[Event], None] = lambda event: None,
) -> RunSummary:
    """Run the shot in file `path`.

    frames   : "1001-1010" to run a part; the shot file's frames otherwise.
    force    : do every step again, and replace files that no run of this shot wrote.
    on_event : is told what begins and what is done.
    Raises   : ShotError, RigError, PlateError, OutputError; what is finished by then stays.
    """
    started = time.monotonic()
    shot = read_shot(path)
    rig_path = shot.resolved(shot.tables.rig.file)
    rig = read_rig(rig_path)
    plates = shot.tables.plates
    found = pairs(shot.resolved(plates.left), shot.resolved(plates.right), frames=frames or plates.frames)
    rectified = rectification(rig)
    _writable(shot.folder)
    record = RunRecord(shot.folder / "run.json")
    rig_key = digest(rig_to_dict(rig) | {"quality": None})
    range_key = digest(rig_key, shot.tables.depth.model_dump())
    done = stood = 0
    figures: dict[str, dict[str, Any]] = {}
    for pair in found:
        job = FrameJob(shot=shot, rectification=rectified, pair=pair)
        receipt = Receipt(job.receipt_path, shot.folder)
        sources = {"left": file_digest(pair.left), "right": file_digest(pair.right), "rig": rig_key}
        receipt.head = _head(shot, pair, rig_path, sources)
        keys: dict[str, str] = {}
        figures[pair.name] = {}
        for step in STEPS:
            if not step.wanted(shot):
                continue
            if step.ranged:
                job.preview_range_m = _preview_range(job, record, range_key)
            key = keys[step.name] = _key(step, job, keys, sources)
            if not force and receipt.stands(step.name, key):
                stood += 1
                on_event(Event(frames=len(found), frame=pair.name, step=step.name, state="stands"))
            else:
                on_event(Event(frames=len(found), frame=pair.name, step=step.name, state="begins"))
                seconds = _do(step, job, receipt, key, force=force)
                done += 1
                on_event(Event(frames=len(found), frame=pair.name, step=step.name, state="done", seconds=seconds))
            figures[pair.name][step.name] = receipt.steps[step.name]["figures"]
    record.put(shot=shot.path.name, name=shot.name, versions=dict(versions()))
    return RunSummary(
        folder=shot.folder,
        frames=tuple(p.name for p in found),
        done=done,
        stood=stood,
        seconds=time.monotonic() - started,
        figures=figures,
    )


def _head(shot: Shot, pair: Pair, rig_path: Path, sources: dict[str, str]) -> dict[str, Any]:
    """What a receipt says of the frame as a whole."""
    return {
        "frame": pair.number,
        "inputs": {
            "left": {"file": pair.left.as_posix(), "sha256": sources["left"]},
            "right": {"file": pair.right.as_posix(), "sha256": sources["right"]},
            "rig": {"file": rig_path.as_posix(), "sha256": file_digest(rig_path)},
        },
        "settings": shot.tables.model_dump(mode="json"),
        "versions": dict(versions()),
    }
