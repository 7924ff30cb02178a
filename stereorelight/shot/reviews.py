"""The review movies of a shot, and the sheet of its frames, from the previews of a run.

In: a prepared shot whose frames are done.  Out: movies/NAME.WHAT.mp4 (or the codec's suffix), movies/NAME.sheet.png, and what
run.json keeps of them: a movie whose previews, rate and codec are as before is not written again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from stereorelight.errors import OutputError, PlateError
from stereorelight.footage.movie.dpx import exact_rate
from stereorelight.footage.movie.writer import movie_suffix
from stereorelight.footage.stills import write_still
from stereorelight.shot.frame import Prepared
from stereorelight.shot.job import FrameJob
from stereorelight.shot.movies import shot_sheet, wiped, write_movie
from stereorelight.shot.pairs import eyes_of_shot, pairs_of
from stereorelight.shot.receipt import code_digest, digest, file_digest

USUAL_RATE = Fraction(24)  # where neither the files nor the shot file say
ROOMS = ("shot/movies.py", "shot/reviews.py", "footage/movie/writer.py", "footage/ycbcr.py", "footage/preview.py")
NEEDS: Mapping[str, tuple[str, ...]] = {
    "relit": ("relit",),
    "wipe": ("plate", "relit"),
    "plate": ("plate",),
    "depth": ("depth",),
    "normals": ("N",),
    "anaglyph": ("anaglyph",),
}


def rate_of(ready: Prepared) -> Fraction:
    """Pictures a second: the shot file's, else the source's, else 24."""
    told = ready.shot.tables.plates.rate
    return exact_rate(told) if told else ready.eyes.left.rate or USUAL_RATE


def write_reviews(
    ready: Prepared, before: Mapping[str, Any], *, force: bool = False, note: Callable[[str], object] = lambda name: None
) -> tuple[dict[str, Any], int]:
    """Write what the shot file asks for and what is not as it was.  Returns what run.json keeps, and how many files were written.

    before : what run.json kept of an earlier run.
    Movies hold the whole shot: while a frame of it lacks its previews, nothing is written.
    Raises : OutputError where a file stands that no run of this shot wrote, or a movie cannot be written.
    """
    shot, output = ready.shot, ready.shot.tables.output
    if not output.movies or not output.previews:
        return dict(before), 0
    try:
        pairs = pairs_of(eyes_of_shot(shot))
    except PlateError:  # a frame of the shot is missing: this run was of a part of it
        return dict(before), 0
    jobs = [FrameJob(shot=shot, rectification=ready.rectification, pair=pair) for pair in pairs]
    if len(jobs) < 2:
        return dict(before), 0
    kept, written = dict(before), 0
    rate, timecode = rate_of(ready), jobs[0].timecode
    for name in output.movies:
        sources = [[job.preview_path(kind) for job in jobs] for kind in NEEDS[name]]
        if not all(path.exists() for kind in sources for path in kind):
            continue
        path = shot.folder / "movies" / f"{shot.name}.{name}{movie_suffix(output.movie_codec)}"
        key = digest([file_digest(p) for kind in sources for p in kind], output.movie_codec, str(rate), timecode, code_digest(*ROOMS))
        if not force and _stands(path, kept.get(path.name), key):
            continue
        _owned(path, kept, force=force)
        note(f"{name} movie")
        report = write_movie(path, _pictures(name, sources), rate=rate, codec=output.movie_codec, timecode=timecode, force=True)
        kept[path.name] = {**report.to_dict(), "key": key, "bytes": path.stat().st_size}
        written += 1
    return kept, written + _sheet(jobs, kept, force=force)


def _sheet(jobs: Sequence[FrameJob], kept: dict[str, Any], *, force: bool) -> int:
    """The relit frames of the shot on one sheet."""
    shot = jobs[0].shot
    pictures = [job.preview_path("relit") for job in jobs]
    if not all(picture.exists() for picture in pictures):
        return 0
    path = shot.folder / "movies" / f"{shot.name}.sheet.png"
    key = digest([file_digest(p) for p in pictures], code_digest(*ROOMS))
    if not force and _stands(path, kept.get(path.name), key):
        return 0
    _owned(path, kept, force=force)
    write_still(path, shot_sheet([job.pair.name for job in jobs], pictures), force=True)
    kept[path.name] = {"key": key, "bytes": path.stat().st_size}
    return 1


def _stands(path: Path, entry: Any, key: str) -> bool:
    return isinstance(entry, dict) and entry.get("key") == key and path.exists() and path.stat().st_size == entry.get("bytes")


def _owned(path: Path, kept: Mapping[str, Any], *, force: bool) -> None:
    if path.exists() and path.name not in kept and not force:
        raise OutputError(f"{path}: exists and was not written by a run of this shot; move it away, or give --force to replace it")


def _pictures(name: str, sources: Sequence[Sequence[Path]]) -> Iterable[Any]:
    if name == "wipe":
        return wiped(sources[0], sources[1], frames=len(sources[0]))
    return sources[0]
