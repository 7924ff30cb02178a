"""The steps of a run in their order, each a table row: what it reads, what it writes, what does it.

In: a `FrameJob`, one frame of one shot.  Out: files, and figures for the receipt.  Values go from step to step in
memory; a step that is done again while those before it stood reads their files, which hold the same bits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.footage.colour import config_digest
from stereorelight.footage.stills import write_still
from stereorelight.passes import Flag, Frame
from stereorelight.shot.job import FrameJob
from stereorelight.shot.lit import Lit
from stereorelight.shot.pictures import relit_names, relit_pictures, scene_names, scene_pictures
from stereorelight.shot.receipt import file_digest
from stereorelight.shot.schema import Shot
from stereorelight.stereo.matchers import matcher_file


def colour_key(shot: Shot) -> list[str | None]:
    """What the plates' colours depend on."""
    plates = shot.tables.plates
    spaces = [plates.colour_space, plates.right_colour_space or plates.colour_space]
    return [*spaces, config_digest(shot.colour, *spaces)]


def view_key(shot: Shot) -> list[str | None]:
    """What the previews' colours depend on beyond the plates."""
    return [shot.colour.display, shot.colour.view]


def shading_key(shot: Shot) -> list[Any] | None:
    """What shading reads beyond the depth; None where it is off."""
    return [colour_key(shot), shot.depth.quality] if shot.shades else None


def matcher_key(shot: Shot) -> str | None:
    """What a matcher's own file holds, where it has one."""
    file = matcher_file(shot.depth.matcher)
    return None if file is None or not file.is_file() else file_digest(file)


Figures = dict[str, Any]


@dataclass(frozen=True)
class Made:
    """A result in memory: its figures, and what writes it.  Nothing is on disk before `write`."""

    figures: Figures
    write: Callable[[], object]


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of a run.

    after    : the steps whose results it reads.      sources  : whether it reads the plates and the rig itself.
    rooms    : the code that makes its result.        settings : the plain values of the shot file that it reads.
    files    : what it writes for a frame.            make     : makes the result, and what writes it.
    wanted   : whether the shot asks for it.          ranged   : whether it reads the shot's preview range.
    inputs   : plain values of the frame that it reads beyond the plates, such as digests of files.
    """

    name: str
    after: tuple[str, ...] = ()
    sources: bool = False
    rooms: tuple[str, ...]
    settings: Callable[[Shot], Any]
    files: Callable[[FrameJob], list[Path]]
    make: Callable[[FrameJob], Made]
    wanted: Callable[[Shot], bool] = lambda shot: True
    inputs: Callable[[FrameJob], Any] = lambda job: None
    ranged: bool = False


def _percent(share: float) -> float:
    return round(100 * float(share), 2)


def depth_figures(frame: Frame) -> Figures:
    """Cover, guesses, distances (m) and mean confidence of a depth."""
    Z, known = frame["Z"], np.isfinite(frame["Z"])
    figures: Figures = {"cover_percent": _percent(known.mean())}
    if "flags" in frame:
        figures["filled_percent"] = _percent(((frame["flags"] & Flag.FILLED) != 0).mean())
    if known.any():
        near, middle, far = np.percentile(Z[known], (2, 50, 98))
        figures |= {"near_m": round(float(near), 4), "median_m": round(float(middle), 4), "far_m": round(float(far), 4)}
    if "confidence" in frame and np.isfinite(frame["confidence"]).any():
        figures["mean_confidence"] = round(float(np.nanmean(frame["confidence"])), 4)
    return figures


def surface_figures(frame: Frame) -> Figures:
    """Cover of P and N."""
    return {f"{name}_cover_percent": _percent(np.isfinite(frame[name]).all(axis=-1).mean()) for name in ("P", "N")}


def relight_figures(layers: Mapping[str, Float32], beauty: Float32) -> Figures:
    """Largest value, pixels without one, and each layer's mean and the share of the picture that it reaches."""
    known = np.isfinite(beauty).all(axis=-1)
    figures: Figures = {
        "largest": round(float(beauty[known].max()), 4) if known.any() else None,
        "unknown_percent": _percent(1 - known.mean()),
    }
    for name, layer in layers.items():
        figures[name] = {"mean": round(float(layer.mean()), 6), "reaches_percent": _percent((layer.max(axis=-1) > 1e-4).mean())}
    return figures


def _make_depth(job: FrameJob) -> Made:
    frame = job.recovered()
    return Made(depth_figures(frame) | job.search_figures, lambda: job.write(job.depth_path, frame))


def _make_passes(job: FrameJob) -> Made:
    frame = job.made_surface()
    figures = surface_figures(frame) | ({"shading": job.shading_figures} if job.shading_figures else {})
    return Made(figures, lambda: job.write(job.passes_path, frame))


def plate_light_figures(lit: Lit) -> Figures:
    """The light that was divided out of the plate, in numbers and in words; nothing where the plate itself was lit."""
    if lit.colour is None:
        return {}
    light = lit.colour.light
    return {"exposure": round(lit.colour.exposure, 5)} | ({} if light is None else {"plate_light": light.to_dict() | {"words": light.words}})


def _make_relit(job: FrameJob) -> Made:
    half = job.shot.tables.output.colour == "half"
    metadata = job.words("relight") | job.source_words
    frame = Frame(passes=job.lit.passes(), camera=job.posed_camera, number=job.pair.number, metadata=metadata)
    return Made(relight_figures(job.lit.layers, job.lit.beauty) | plate_light_figures(job.lit), lambda: job.write(job.relit_path, frame, half=half))


def _make_pictures(job: FrameJob, made: Mapping[str, UInt8]) -> Made:
    def write() -> None:
        for name, picture in made.items():
            write_still(job.preview_path(name), picture, force=True)

    return Made({}, write)


STEPS: tuple[Step, ...] = (
    Step(
        name="depth",
        sources=True,
        rooms=("stereo", "footage", "engine", "shot/job.py", "shot/neighbours.py", "shot/hints.py"),
        settings=lambda shot: [shot.tables.depth.model_dump(), matcher_key(shot), shot.tables.plates.match_colour, colour_key(shot)],
        files=lambda job: [job.depth_path],
        make=_make_depth,
    ),
    Step(
        name="passes",
        after=("depth",),
        rooms=("surface", "footage", "engine", "shot/job.py", "shot/materials.py"),
        settings=lambda shot: [shot.tables.surface.model_dump(), shading_key(shot)],
        inputs=lambda job: job.materials.key if job.shot.shades and job.materials is not None else None,
        files=lambda job: [job.passes_path],
        make=_make_passes,
    ),
    Step(
        name="relight",
        after=("passes",),
        rooms=(
            *("light", "surface", "comp.py", "footage", "engine", "interchange", "stereo/carry.py"),
            *("shot/job.py", "shot/lighting.py", "shot/shadows.py", "shot/points.py", "shot/plate_light.py", "shot/matte_files.py", "shot/lit.py"),
        ),
        settings=lambda shot: [shot.setup.tables(), shot.tables.output.colour],
        inputs=lambda job: job.lights.key(job.pair.number),
        files=lambda job: [job.relit_path],
        make=_make_relit,
    ),
    Step(
        name="previews",
        after=("depth", "passes"),
        rooms=("footage", "shot/pictures.py"),
        settings=lambda shot: [view_key(shot), scene_names(shot)],
        files=lambda job: [job.preview_path(name) for name in scene_names(job.shot)],
        make=lambda job: _make_pictures(job, scene_pictures(job)),
        wanted=lambda shot: shot.tables.output.previews,
        ranged=True,
    ),
    Step(
        name="relit previews",
        after=("previews", "relight"),
        rooms=("footage", "shot/pictures.py"),
        settings=view_key,
        files=lambda job: [job.preview_path(name) for name in relit_names(job.shot)],
        make=lambda job: _make_pictures(job, relit_pictures(job)),
        wanted=lambda shot: shot.tables.output.previews,
        ranged=True,
    ),
)
