"""Review movies and the sheet of a shot, from its preview pictures, one picture in memory at a time.

In: pictures in order, as arrays, files or functions that make one.  Out: movie files, each whole or not at all, and what a
receipt says of them.  Nothing here knows of steps or folders of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import UInt8
from stereorelight.errors import OutputError
from stereorelight.files import refuse_overwrite
from stereorelight.footage import preview
from stereorelight.footage.movie.writer import MovieWriter, check_movie, movie_suffix
from stereorelight.footage.stills import read_still

Picture: TypeAlias = "UInt8 | Path | str | Callable[[], UInt8]"
SHEET_FRAMES = 20  # pictures on the sheet of a shot, at most


@dataclass(frozen=True, kw_only=True)
class MovieReport:
    """What was written: (w, h) of the pictures, and (columns, rows) repeated at their far edges where the codec needs even sizes."""

    path: Path
    frames: int
    size: tuple[int, int]
    padded: tuple[int, int]
    codec: str
    rate: Fraction
    timecode: str | None
    transfer: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a receipt."""
        return {
            "file": self.path.name,
            "frames": self.frames,
            "size": list(self.size),
            "padded": list(self.padded),
            "codec": self.codec,
            "rate": str(self.rate),
            "timecode": self.timecode,
            "transfer": self.transfer,
        }


def shown(picture: Picture) -> UInt8:
    """The (H, W, 3) uint8 picture itself, read or made where it is a file or a function.  Raises PlateError."""
    if isinstance(picture, (str, Path)):
        return np.rint(np.clip(read_still(picture).rgb, 0, 1) * 255).astype(np.uint8)
    return picture() if callable(picture) else picture


def write_movie(
    path: str | Path,
    pictures: Iterable[Picture],
    *,
    rate: Fraction | int,
    codec: str = "h264",
    timecode: str | None = None,
    transfer: str = "sRGB",
    force: bool = False,
) -> MovieReport:
    """Write `pictures` in order as a movie of the first one's size; each is asked for when its turn comes, and let go.

    rate, codec, timecode, transfer, force : as `MovieWriter` takes them.
    Raises : OutputError for no picture, pictures of two sizes, or what cannot be written; PlateError for a picture that cannot
             be read; then no movie is left.
    """
    path = Path(path)
    check_movie(path, codec=codec)
    refuse_overwrite(path, force=force)
    left = iter(pictures)
    first: npt.NDArray[Any] | None = next((np.asarray(shown(picture)) for picture in left), None)
    if first is None:
        raise OutputError(f"{path}: there are no pictures for this movie; run the frames with previews on")
    if first.ndim != 3:
        raise OutputError(f"{path}: a movie is made of (H, W, 3) pictures, got {first.shape}")
    size = (first.shape[1], first.shape[0])
    writer = MovieWriter(path, size=size, rate=rate, codec=codec, timecode=timecode, transfer=transfer, force=force)
    with writer as movie:
        movie.write(first)
        del first
        for picture in left:
            movie.write(shown(picture))
    return MovieReport(
        path=path,
        frames=writer.frames,
        size=size,
        padded=writer.padded,
        codec=codec,
        rate=writer.rate,
        timecode=writer.timecode,
        transfer=transfer,
    )


def write_movies(
    folder: str | Path,
    movies: Mapping[str, Iterable[Picture]],
    *,
    rate: Fraction | int,
    codec: str = "h264",
    timecode: str | None = None,
    transfer: str = "sRGB",
    force: bool = False,
) -> tuple[MovieReport, ...]:
    """Write several movies, such as {"relit": ..., "wipe": ..., "depth": ...}, one after the other, as `folder`/<name><suffix of the codec>.

    Raises : as `write_movie`; that a file exists is told before any movie is begun.
    """
    targets = {name: Path(folder) / f"{name}{movie_suffix(codec)}" for name in movies}
    for target in targets.values():
        refuse_overwrite(target, force=force)
    how: dict[str, Any] = {"rate": rate, "codec": codec, "timecode": timecode, "transfer": transfer, "force": force}
    return tuple(write_movie(targets[name], pictures, **how) for name, pictures in movies.items())


def _pairs(first: Iterable[Picture], second: Iterable[Picture], what: str) -> Iterator[tuple[UInt8, UInt8]]:
    try:
        for a, b in zip(first, second, strict=True):
            yield shown(a), shown(b)
    except ValueError as error:
        if "argument" not in str(error):
            raise
        raise OutputError(f"{what} need as many pictures on either side; run the frames that lack one") from None


def wiped(before: Iterable[Picture], after: Iterable[Picture], *, frames: int) -> Iterator[UInt8]:
    """Before and after with a line between them that travels once across the shot of `frames` pictures, from right to left, evenly.

    The first picture is wholly before, the last wholly after; a single one is cut in the middle.
    Raises : OutputError where one side has more pictures; PassError where their sizes differ.
    """
    for i, (a, b) in enumerate(_pairs(before, after, "before and after")):
        yield preview.before_after(a, b, wipe=1 - i / (frames - 1) if frames > 1 else 0.5)


def anaglyphs(left: Iterable[Picture], right: Iterable[Picture], *, method: preview.Anaglyph = "dubois") -> Iterator[UInt8]:
    """Rectified left and right pictures as red-cyan ones.  Raises OutputError and PassError as `wiped`."""
    for a, b in _pairs(left, right, "anaglyphs"):
        yield preview.anaglyph(a, b, method=method)


def labelled(pictures: Iterable[Picture], texts: Iterable[str]) -> Iterator[UInt8]:
    """Each picture with its line of text burnt in.  Raises OutputError where there are not as many texts as pictures."""
    try:
        for picture, text in zip(pictures, texts, strict=True):
            yield preview.labelled(shown(picture), text)
    except ValueError as error:
        if "argument" not in str(error):
            raise
        raise OutputError("labels: there must be one line of text for each picture") from None


def sheet_places(count: int, *, most: int = SHEET_FRAMES) -> tuple[int, ...]:
    """Which of `count` frames go on the sheet: all, or `most` spread evenly with the first and the last."""
    return tuple(range(count)) if count <= most else tuple(round(i * (count - 1) / (most - 1)) for i in range(most))


def shot_sheet(names: Sequence[str], pictures: Sequence[Picture], *, most: int = SHEET_FRAMES, width: int = 320) -> UInt8:
    """Frames of the shot, evenly spread and labelled with their names, on one sheet; only these are read.

    Raises : PassError for no pictures.
    """
    cells = [(names[i], shown(pictures[i])) for i in sheet_places(len(pictures), most=most)]
    return preview.contact_sheet(cells, width=width)
