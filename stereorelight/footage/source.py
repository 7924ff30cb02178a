"""What every reader does before and around a decoder: is there a file, and keep the decoder's own printing off the terminal."""

from __future__ import annotations

import contextlib
import difflib
import io
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

from stereorelight.errors import PlateError

# What OpenEXR, OpenCV and libpng, libjpeg and libtiff print of a damaged file; our own error says it once and better.
NOISE = re.compile(r"\(EXR_ERR_|^Warning: Exception raised reading|^\[ ?(WARN|ERROR):|^libpng |^TIFF|^Corrupt JPEG|^Premature end")
MOST_NAMED = 3  # files of a folder in a message
_one_reader = threading.Lock()  # stdout and stderr are the whole process's


def not_there(path: Path) -> str:
    """What to say of a file that is not there: its folder, or what stands there of its kind, the nearest names first."""
    if not path.parent.is_dir():
        return f"there is no such file; there is no folder {path.parent} either, check the name"
    kind = path.suffix.lower()
    names = [entry.name for entry in path.parent.iterdir() if entry.suffix.lower() == kind and not entry.name.startswith(".")]
    if not names or not kind:
        return "there is no such file; check the name"
    near = difflib.get_close_matches(path.name, names, n=MOST_NAMED, cutoff=0)
    more = f" and {len(names) - len(near)} more {kind}" if len(names) > len(near) else ""
    return f"there is no such file; check the name: its folder has {', '.join(near)}{more}"


def check_file(path: Path) -> None:
    """Raise PlateError unless `path` is a file with something in it."""
    if path.is_dir():
        raise PlateError(f"{path}: is a folder; give a picture in it, or a pattern such as {path.name}/name.####.exr")
    if not path.exists():
        raise PlateError(f"{path}: {not_there(path)}")
    try:
        with path.open("rb") as file:
            if not file.read(1):
                raise PlateError(f"{path}: the file is empty; copy or render it again")
    except OSError as error:
        raise PlateError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from error


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep the library's own printing off stdout and stderr; what anybody else prints meanwhile is passed on."""
    with _one_reader, contextlib.ExitStack() as undo:
        spool = undo.enter_context(tempfile.TemporaryFile())
        saved: list[tuple[int, int]] = []
        for fd in (1, 2):
            with contextlib.suppress(OSError):  # a process without standard streams
                saved.append((fd, os.dup(fd)))
                os.dup2(spool.fileno(), fd)
        printed = io.StringIO()
        try:
            with contextlib.redirect_stdout(printed):
                yield
        finally:
            for fd, copy in saved:
                os.dup2(copy, fd)
                os.close(copy)
            spool.seek(0)
            for line in spool.read().decode(errors="replace").splitlines():
                if not NOISE.search(line):
                    print(line, file=sys.stderr)
            for line in printed.getvalue().splitlines():
                if not NOISE.search(line):
                    print(line)
