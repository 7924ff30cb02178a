"""Receipts: what a step was made from, so that a run does again only what changed.

A receipt is one JSON file a frame: the inputs' sha256, the resolved settings, the versions, and for each step its key,
its files, its figures and its seconds.  A step stands when its key is the same and its files are there, whole.
A step's key is a hash over the keys of the steps before it, the settings that it reads, and the code that does it."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from stereorelight import __version__
from stereorelight.errors import OutputError, PlateError
from stereorelight.files import write_text

VERSION = 1
PACKAGE = Path(__file__).parent.parent
GROUND = ("errors.py", "arrays.py", "lens.py", "camera.py", "passes.py")
BACKENDS = ("numpy", "opencv-contrib-python-headless", "OpenEXR", "numba", "scikit-image")


def digest(*parts: Any) -> str:
    """sha256 of plain values (numbers, words, lists, tables), as 64 hex digits."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """sha256 of a file's bytes.  Raises PlateError when it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise PlateError(f"{path}: file missing; check the name in the shot file, or restore the file") from None
    except OSError as error:
        raise PlateError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None


@functools.cache
def code_digest(*rooms: str) -> str:
    """sha256 over the sources of `rooms` (folders or files of this package) and of the ground they stand on."""
    total = hashlib.sha256()
    for room in sorted({*GROUND, *rooms}):
        place = PACKAGE / room
        for source in [place] if place.is_file() else sorted(place.rglob("*.py")):
            total.update(source.relative_to(PACKAGE).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return total.hexdigest()


@functools.cache
def versions() -> Mapping[str, str]:
    """Versions of this package, of Python and of the backends that a result depends on."""
    found = {"stereorelight": __version__, "python": platform.python_version()}
    for name in BACKENDS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


class Receipt:
    """The receipt of one frame, read from `path` where there is one; every change is written at once.

    A receipt that cannot be read counts as none: the frame is then done from the beginning."""

    def __init__(self, path: Path, root: Path) -> None:
        """root : the output folder, from which the files of the steps are named."""
        self.path, self.root = path, root
        self.head: dict[str, Any] = {}
        self.steps: dict[str, Any] = {}
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data.get("version") == VERSION and isinstance(data.get("steps"), dict):
                self.steps = data["steps"]
        except FileNotFoundError:
            pass
        except NotADirectoryError:
            raise OutputError(f"{path}: a file stands where a folder is needed; choose another output folder") from None
        except (OSError, ValueError, AttributeError):
            pass

    def stands(self, step: str, key: str) -> bool:
        """Whether `step` was finished with this key and its files are there with the sizes they had."""
        entry = self.steps.get(step)
        if not entry or entry.get("key") != key or not entry.get("done"):
            return False
        try:
            return all((self.root / name).stat().st_size == size for name, size in entry["files"].items())
        except OSError:
            return False

    def owns(self, path: Path) -> bool:
        """Whether a step of this receipt wrote `path`, or was about to."""
        name = path.relative_to(self.root).as_posix()
        return any(name in entry.get("files", {}) for entry in self.steps.values())

    def begin(self, step: str, key: str, files: Iterable[Path]) -> None:
        """Note that `step` is about to write `files`, so that a run that stops half way knows them as its own."""
        before = self.steps.get(step, {}).get("files", {})
        names = [f.relative_to(self.root).as_posix() for f in files]
        self.steps[step] = {"key": key, "done": False, "files": {**before, **dict.fromkeys(names)}}
        self._write()

    def finish(self, step: str, files: Iterable[Path], figures: Mapping[str, Any], seconds: float) -> None:
        """Note that `step` is done; files that it wrote in an earlier run and no longer writes are removed."""
        entry = self.steps[step]
        kept = {f.relative_to(self.root).as_posix(): f.stat().st_size for f in files}
        for old in set(entry["files"]) - set(kept):
            (self.root / old).unlink(missing_ok=True)
        self.steps[step] = {"key": entry["key"], "done": True, "files": kept, "figures": dict(figures), "seconds": round(seconds, 3)}
        self._write()

    def _write(self) -> None:
        data = {"version": VERSION, **self.head, "steps": self.steps}
        write_text(self.path, json.dumps(data, indent=2) + "\n", force=True)
