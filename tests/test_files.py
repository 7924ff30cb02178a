"""Files appear whole or not at all, nothing is replaced unasked, and every failure is one clear line."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stereorelight import files
from stereorelight.errors import OutputError
from stereorelight.files import make_folder, refuse_overwrite, write_text, write_whole


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(OutputError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def fails(number: int) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


def half_then(problem: BaseException) -> Callable[[Path], None]:
    """A writer that stops midway."""

    def write(path: Path) -> None:
        path.write_bytes(b"half")
        raise problem

    return write


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(st.characters(exclude_categories=["Cs"])))
def test_text_comes_back_byte_for_byte(tmp_path: Path, text: str) -> None:
    path = write_text(tmp_path / "a.txt", text, force=True)
    assert path.read_bytes() == text.encode("utf-8")  # no line endings of the machine's own
    assert os.listdir(tmp_path) == ["a.txt"]


def test_the_writer_gets_a_hidden_neighbour_of_the_same_kind(tmp_path: Path) -> None:
    seen: list[Path] = []

    def write(path: Path) -> None:
        seen.append(path)
        assert not (tmp_path / "deep" / "a.b.exr").exists()
        path.write_bytes(b"whole")

    assert write_whole(str(tmp_path / "deep" / "a.b.exr"), write) == tmp_path / "deep" / "a.b.exr"
    assert seen[0].parent == tmp_path / "deep"
    assert seen[0].suffix == ".exr"
    assert seen[0].name.startswith(".")
    assert os.listdir(tmp_path / "deep") == ["a.b.exr"]


@pytest.mark.parametrize("problem", [ValueError("no"), KeyboardInterrupt(), MemoryError(), OutputError("mine")])
@pytest.mark.parametrize("there", [False, True])
def test_a_writer_that_stops_midway_leaves_nothing(tmp_path: Path, problem: BaseException, there: bool) -> None:
    path = tmp_path / "a.exr"
    if there:
        path.write_bytes(b"before")
    with pytest.raises(type(problem)) as caught:
        write_whole(path, half_then(problem), force=True)
    assert caught.value is problem
    assert os.listdir(tmp_path) == (["a.exr"] if there else [])
    assert not there or path.read_bytes() == b"before"


DISK = {
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EACCES: "no permission to write here; choose another --out",
    errno.EPERM: "no permission to write here",
    errno.EROFS: "no permission to write here",
    errno.EIO: "input/output error",
}


@pytest.mark.parametrize("number", DISK)
def test_a_disk_that_fails_midway(tmp_path: Path, number: int) -> None:
    path = tmp_path / "a.exr"
    path.write_bytes(b"before")
    words = refusal(lambda: write_whole(path, half_then(OSError(number, os.strerror(number))), force=True))
    assert words.startswith(f"{path}: ")
    assert DISK[number] in words
    assert os.listdir(tmp_path) == ["a.exr"]
    assert path.read_bytes() == b"before"


@pytest.mark.parametrize("number", DISK)
def test_a_rename_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    monkeypatch.setattr(files.os, "replace", fails(number))
    assert DISK[number] in refusal(lambda: write_text(tmp_path / "a.txt", "whole"))
    monkeypatch.undo()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("number", DISK)
def test_a_folder_that_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    monkeypatch.setattr(Path, "mkdir", fails(number))
    words = refusal(lambda: write_text(tmp_path / "deep" / "a.txt", "whole"))
    assert words.startswith(f"{tmp_path / 'deep'}: ")
    assert DISK[number] in words


def test_a_folder_that_may_not_be_entered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "exists", fails(errno.EACCES))
    assert "no permission" in refusal(lambda: write_text(tmp_path / "a.txt", "whole"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        assert "no permission" in refusal(lambda: write_text(tmp_path / "a.txt", "whole"))
    finally:
        tmp_path.chmod(0o700)


def test_nothing_is_replaced_unasked(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "first")
    called: list[Path] = []
    words = refusal(lambda: write_whole(path, called.append))
    assert "exists already; give --force" in words
    assert str(path) in words
    assert not called  # refused before any work is done
    assert path.read_text() == "first"
    write_text(path, "second", force=True)
    assert path.read_text() == "second"
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_in_place_of_the_file(tmp_path: Path, force: bool) -> None:
    assert "is a folder, not a file" in refusal(lambda: write_text(tmp_path, "x", force=force))


@pytest.mark.parametrize("force", [False, True])
def test_a_device_is_never_renamed_away(force: bool) -> None:
    assert "is a device, not a file" in refusal(lambda: refuse_overwrite(Path(os.devnull), force=force))


@pytest.mark.parametrize("deeper", ["a.txt", "b/a.txt"])
def test_a_file_in_place_of_a_folder(tmp_path: Path, deeper: str) -> None:
    (tmp_path / "out").write_text("a file")
    assert "a file stands where a folder is needed" in refusal(lambda: write_text(tmp_path / "out" / deeper, "x"))
    assert "a file stands where a folder is needed" in refusal(lambda: make_folder(tmp_path / "out"))
    assert (tmp_path / "out").read_text() == "a file"


def test_a_name_too_long(tmp_path: Path) -> None:
    assert "name too long" in refusal(lambda: write_text(tmp_path / ("a" * 300), "x"))
    assert os.listdir(tmp_path) == []


def test_a_writer_that_writes_nothing(tmp_path: Path) -> None:
    assert "no such file" in refusal(lambda: write_whole(tmp_path / "a.txt", lambda _: None))


def test_make_folder_twice(tmp_path: Path) -> None:
    assert make_folder(tmp_path / "a" / "b") == make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()


def test_refuse_overwrite_lets_new_files_pass(tmp_path: Path) -> None:
    refuse_overwrite(tmp_path / "new", force=False)
    refuse_overwrite(tmp_path / "no" / "folder" / "yet", force=False)
