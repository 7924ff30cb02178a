"""Whole files or none: every file is written beside its target under another name and then renamed.

Nothing is overwritten unless `force` says so; a full disk or a read-only folder is one clear OutputError."""

from __future__ import annotations

import errno
import os
import uuid
from collections.abc import Callable
from pathlib import Path

from stereorelight.errors import OutputError


def refuse_overwrite(path: Path, *, force: bool) -> None:
    """Raise OutputError where `path` exists and `force` is off, or is no ordinary file.  Called before any work is done."""
    try:
        exists, is_file = path.exists(), path.is_file()
    except OSError as error:  # a folder that may not be entered, a name too long
        raise OutputError(f"{path}: {_reason(error)}") from error
    if exists and not is_file:
        # Renaming onto a device would replace the device itself, /dev/null included.
        raise OutputError(f"{path}: is a {'folder' if path.is_dir() else 'device'}, not a file; choose another --out")
    if exists and not force:
        raise OutputError(f"{path}: exists already; give --force to replace it, or another --out")


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "the disk is full; free some space and run again"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "no permission to write here; choose another --out or change the folder's permissions"
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return "a file stands where a folder is needed; choose another --out"
    return (error.strerror or str(error)).lower()


def make_folder(path: Path) -> Path:
    """Make folder `path` with its parents.  Raises OutputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: {_reason(error)}") from error
    return path


def write_whole(path: str | Path, write: Callable[[Path], None], *, force: bool = False) -> Path:
    """Call `write(temporary)` and rename the result to `path`: the file appears whole or not at all.

    write  : writes the complete file at the path that it is given (same folder, same suffix).
    Raises : OutputError when `path` exists and `force` is off, or when the writing fails; no rest is left behind.
    """
    path = Path(path)
    refuse_overwrite(path, force=force)
    make_folder(path.parent)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}.part{path.suffix}")
    try:
        write(temporary)
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"{path}: {_reason(error)}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_text(path: str | Path, text: str, *, force: bool = False) -> Path:
    """Write `text` as UTF-8, whole or not at all."""
    return write_whole(path, lambda temporary: _put_text(temporary, text), force=force)


def _put_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")
