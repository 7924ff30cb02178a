"""The mattes under `[depth]` of a shot file that help the matcher: `subject` and `ignore`.

In: file names, or patterns with a frame number, of mattes on the upright left plate.  Out: the `Hints` of a frame, and what they depend on."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.shot.matte_files import matte_channel
from stereorelight.shot.pairs import Pair
from stereorelight.shot.receipt import file_digest
from stereorelight.shot.schema import Shot
from stereorelight.stereo.hints import Hints

NAMES = ("subject", "ignore")


def matte_file(text: str | Path, number: int | None) -> Path:
    """The file that a name or a pattern stands for on a frame.  Raises PlateError for a pattern where frames have no number."""
    pattern = Pattern.parse(str(text), must_exist=False)
    if pattern.is_single and "#" not in str(text) and "%0" not in str(text):
        return Path(pattern.pattern)
    if number is None:
        raise PlateError(f"{text}: is a pattern, but the plates are single pictures; name one matte")
    return pattern.path(number)


def read_hints(subject: str | Path | None, ignore: str | Path | None, number: int | None) -> Hints | None:
    """The mattes of a frame; None where none is named.  Raises PlateError naming the file that is missing or is no matte."""

    def read(text: str | Path | None) -> Float32 | None:
        if text is None:
            return None
        file = matte_file(text, number)
        if not file.is_file():
            raise PlateError(f"{file}: matte missing; paint it, or leave out the key that names it")
        return matte_channel(file, None)

    return None if subject is None and ignore is None else Hints(subject=read(subject), ignore=read(ignore))


def _named(shot: Shot) -> list[str | None]:
    return [None if text is None else str(shot.resolved(text)) for text in (getattr(shot.tables.depth, name) for name in NAMES)]


def hints_of(shot: Shot, pair: Pair) -> Hints | None:
    """The mattes of a frame of a shot.  Raises PlateError."""
    subject, ignore = _named(shot)
    return read_hints(subject, ignore, pair.number)


def hints_key(shot: Shot, pairs: Iterable[Pair]) -> list[list[str]] | None:
    """Hashes of the mattes that these frames read; None where the shot names none.  A matte that has gone is told when its frame is made."""
    named = [text for text in _named(shot) if text is not None]
    files = [[matte_file(text, pair.number) for text in named] for pair in pairs] if named else []
    return [[file_digest(file) if file.is_file() else "" for file in row] for row in files] if named else None


def check_hints(shot: Shot, pairs: Iterable[Pair]) -> None:
    """Raises PlateError for the first frame without its matte: before any work."""
    for pair in pairs:
        for name, text in zip(NAMES, _named(shot), strict=True):
            if text is not None and not (file := matte_file(text, pair.number)).is_file():
                raise PlateError(f"{file}: matte missing; depth.{name} of {shot.path} needs it on frame {pair.name}")
