"""EXR: what goes in comes out, bit for bit, and every silent trap of the binding is one clear error or mended."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.errors import OutputError, PassError, PlateError
from stereorelight.footage.exr import HALF_MAX, ExrPart, read_exr, read_layer, write_exr, write_exr_parts

ONE_FILE = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
NAMES = st.from_regex(r"[A-Za-z0-9_]{1,12}(\.[A-Za-z0-9_]{1,12}){0,2}", fullmatch=True)
GRID = np.arange(40 * 64, dtype=np.float32).reshape(40, 64) / 7


def bits(a: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(a).view(f"u{a.dtype.itemsize}")


@ONE_FILE
@given(data=st.data())
def test_float_channels_return_bit_for_bit(tmp_path: Path, data: st.DataObject) -> None:
    shape = data.draw(st.tuples(st.integers(1, 40), st.integers(1, 20)))
    values = hnp.arrays(np.float32, shape, elements=st.floats(width=32, allow_nan=True, allow_infinity=True, allow_subnormal=True))
    channels = data.draw(st.dictionaries(NAMES, values, min_size=1, max_size=4))
    write_exr(tmp_path / "a.exr", channels, force=True)
    (part,) = read_exr(tmp_path / "a.exr")
    assert set(part.channels) == set(channels)
    for name, array in channels.items():
        assert np.array_equal(bits(part.channels[name]), bits(array))
        assert part.channels[name].dtype == np.float32
        assert part.channels[name].flags.c_contiguous


@ONE_FILE
@given(patterns=hnp.arrays(np.uint16, (7, 5)))
def test_half_values_are_exact(tmp_path: Path, patterns: np.ndarray) -> None:
    array = patterns.view(np.float16)
    array = np.where(np.isnan(array), np.float16(0), array)
    write_exr(tmp_path / "a.exr", {"R": array.astype(np.float32)}, half=["R"], force=True)
    (part,) = read_exr(tmp_path / "a.exr")
    assert np.array_equal(bits(part.channels["R"].astype(np.float16)), bits(array))


@ONE_FILE
@given(array=hnp.arrays(np.float64, (3, 4), elements=st.floats(allow_nan=True, allow_infinity=False)), half=st.booleans())
def test_finite_in_is_finite_out(tmp_path: Path, array: np.ndarray, half: bool) -> None:
    write_exr(tmp_path / "a.exr", {"R": array}, half=["R"] if half else [], force=True)
    back = read_exr(tmp_path / "a.exr")[0].channels["R"]
    assert np.array_equal(np.isnan(back), np.isnan(array))
    assert not np.isinf(back).any()
    if half:
        known = ~np.isnan(array)
        assert np.allclose(back[known], np.clip(array, -HALF_MAX, HALF_MAX)[known], rtol=2**-11, atol=2**-25)


STRIDES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "flipped": lambda a: a[::-1],
    "mirrored": lambda a: a[:, ::-1],
    "every second": lambda a: a[::2, ::2],
    "cropped": lambda a: a[3:20, 5:33],
    "transposed": lambda a: a.T,
    "Fortran": np.asfortranarray,
    "one of three": lambda a: np.stack([a, a + 1, a + 2], axis=-1)[..., 1],
    "broadcast": lambda a: np.broadcast_to(a[0], a.shape),
    "float64": lambda a: a.astype(np.float64),
    "big-endian": lambda a: a.astype(">f4"),
    "uint16": lambda a: a.astype(np.uint16),
    "read-only": lambda a: np.frombuffer(a.tobytes(), np.float32).reshape(a.shape),
}


@pytest.mark.parametrize("how", STRIDES)
def test_any_strides_and_type_are_written_right(tmp_path: Path, how: str) -> None:
    array = STRIDES[how](GRID)
    write_exr(tmp_path / "a.exr", {"Z": array})
    assert np.array_equal(read_exr(tmp_path / "a.exr")[0].channels["Z"], array.astype(np.float32))


def test_the_callers_dict_and_arrays_stay_as_they_were(tmp_path: Path) -> None:
    array = GRID.copy()
    channels = {"Z": array, "R": array}
    write_exr(tmp_path / "a.exr", channels, half=["R"])
    assert channels["Z"] is array
    assert channels["R"] is array
    assert np.array_equal(array, GRID)


@pytest.mark.parametrize("name", ["", "a b", "a/b", ".R", "R.", "a..R", "grün.R", "x" * 300])
def test_names_that_others_cannot_read_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PassError, match="letters, digits"):
        write_exr(tmp_path / "a.exr", {name: GRID})
    assert not list(tmp_path.iterdir())


def test_data_is_zip_and_never_dwa(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {"P.Y": GRID, "N.Y": GRID * 1e-3, "R": GRID}, half=["R"])
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    assert file.header()["compression"] == OpenEXR.ZIP_COMPRESSION
    assert {n: c.pixels.dtype for n, c in file.channels().items()} == {"P.Y": np.float32, "N.Y": np.float32, "R": np.float16}


def make(path: Path, header: dict[str, Any], channels: dict[str, Any]) -> Path:
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, channels).write(str(path))
    return path


def window(x: int, y: int, w: int, h: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x, y], np.int32), np.array([x + w - 1, y + h - 1], np.int32)


@pytest.mark.parametrize(("x", "y"), [(0, 0), (5, 7), (-5, -7), (-20, 30), (200, 0)])
@pytest.mark.parametrize("size", [(64, 40), (30, 20), (100, 80)])
@pytest.mark.parametrize("origin", [(0, 0), (11, -3)])
def test_data_windows_are_placed_on_the_display_window(tmp_path: Path, x: int, y: int, size: tuple[int, int], origin: tuple[int, int]) -> None:
    ox, oy = origin
    header = {"dataWindow": window(x + ox, y + oy, 64, 40), "displayWindow": window(ox, oy, *size)}
    (part,) = read_exr(make(tmp_path / "a.exr", header, {"Z": GRID.copy()}))
    canvas = np.zeros((400, 600), np.float32)
    canvas[100 + y : 140 + y, 100 + x : 164 + x] = GRID
    assert np.array_equal(part.channels["Z"], canvas[100 : 100 + size[1], 100 : 100 + size[0]])
    assert part.offset == (x, y)


def test_whole_numbers_and_tiles_are_read(tmp_path: Path) -> None:
    ids = np.arange(64 * 40, dtype=np.uint32).reshape(40, 64)
    path = make(tmp_path / "a.exr", {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}, {"id": ids, "Z": GRID.copy()})
    (part,) = read_exr(path)
    assert np.array_equal(part.channels["id"], ids.astype(np.float32))
    assert np.array_equal(part.channels["Z"], GRID)


@pytest.mark.parametrize("name", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
def test_lossless_compressions_of_others_are_read(tmp_path: Path, name: str) -> None:
    path = make(tmp_path / "a.exr", {"compression": getattr(OpenEXR, f"{name}_COMPRESSION")}, {"Z": GRID.copy()})
    assert np.array_equal(read_exr(path)[0].channels["Z"], GRID)


def test_two_parts_are_two_views(tmp_path: Path) -> None:
    parts = [
        ExrPart(name="eye_l", view="left", channels={"R": GRID, "key.R": GRID + 1}, header={"note": "häl"}),
        ExrPart(name="eye_r", view="right", channels={"R": (GRID + 2)[::-1], "key.R": GRID + 3}),
    ]
    write_exr_parts(tmp_path / "a.exr", parts)
    back = read_exr(tmp_path / "a.exr")
    assert [(p.name, p.view, p.layers) for p in back] == [("eye_l", "left", ("", "key")), ("eye_r", "right", ("", "key"))]
    assert back[0].metadata == {"note": "häl"}
    assert np.array_equal(read_layer(tmp_path / "a.exr", "", "R", view="right")[..., 0], (GRID + 2)[::-1])
    assert np.array_equal(read_layer(tmp_path / "a.exr", "key", "R")[..., 0], GRID + 1)
    with pytest.raises(PassError, match="different name"):
        write_exr_parts(tmp_path / "b.exr", [ExrPart(channels={"R": GRID}), ExrPart(channels={"R": GRID})])


def test_one_part_holds_two_views_by_prefix(tmp_path: Path) -> None:
    channels = {"R": GRID, "right.R": GRID + 1, "key.right.G": GRID + 2, "right.depth.Z": GRID + 3, "depth.Z": GRID + 4}
    write_exr(tmp_path / "a.exr", channels, views=("left", "right"))
    left, right = read_exr(tmp_path / "a.exr")
    assert (left.view, right.view) == ("left", "right")
    assert set(left.channels) == {"R", "depth.Z"}
    assert set(right.channels) == {"R", "key.G", "depth.Z"}
    assert np.array_equal(right.channels["R"], GRID + 1)
    assert np.array_equal(right.channels["depth.Z"], GRID + 3)
    with pytest.raises(PlateError, match="did you mean 'right'"):
        read_layer(tmp_path / "a.exr", "", "R", view="rigth")


def test_a_part_named_after_its_layer(tmp_path: Path) -> None:
    parts = [ExrPart(name="rgba", channels={"R": GRID}), ExrPart(name="depth", channels={"Z": GRID + 1})]
    write_exr_parts(tmp_path / "a.exr", parts)
    assert np.array_equal(read_layer(tmp_path / "a.exr", "depth", "Z")[..., 0], GRID + 1)
    with pytest.raises(PlateError, match=r"a\.exr: has no channel 'key.R'"):
        read_layer(tmp_path / "a.exr", "key", "R")


@pytest.mark.parametrize("share", [0.0, 0.002, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.9999])
@pytest.mark.parametrize("parts", [1, 2])
def test_truncated_files_are_refused_and_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str], share: float, parts: int) -> None:
    noise = np.random.default_rng(1).random((90, 50), dtype=np.float32)
    write_exr_parts(tmp_path / "a.exr", [ExrPart(name=f"p{i}", channels={"Z": noise, "Q": noise + i}) for i in range(parts)])
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(PlateError, match=r"cut\.exr: .*(truncated|empty|not an EXR)"):
        read_exr(tmp_path / "cut.exr")
    assert capfd.readouterr() == ("", "")


def test_what_others_print_while_a_file_is_read_is_kept(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {"Z": GRID})
    code = "from stereorelight.footage.source import quiet; import os\nwith quiet(): print('from python'); os.write(1, b'from c\\n')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "from python\n"
    assert done.stderr == "from c\n"


@ONE_FILE
@given(at=st.floats(0, 1), junk=st.binary(min_size=1, max_size=40))
def test_damaged_bytes_never_end_in_anything_but_our_error(tmp_path: Path, at: float, junk: bytes) -> None:
    write_exr(tmp_path / "a.exr", {"Z": GRID, "R": GRID}, half=["R"], force=True)
    whole = bytearray((tmp_path / "a.exr").read_bytes())
    start = int(at * (len(whole) - len(junk)))
    whole[start : start + len(junk)] = junk
    (tmp_path / "bad.exr").write_bytes(whole)
    told = "bad.exr"
    try:
        read_exr(tmp_path / "bad.exr")
    except PlateError as error:
        told = str(error)
    assert "bad.exr" in told


@pytest.mark.parametrize("box", [(0, 0, 20000, 20000), (0, 0, 2**31 - 2, 5), (-(2**31), 0, 2**31 - 1, 5), (9, 9, 3, 3), (0, 0, 32767, 32767)])
def test_an_impossible_window_is_refused_at_once(tmp_path: Path, box: tuple[int, int, int, int]) -> None:
    write_exr(tmp_path / "a.exr", {"Z": GRID})
    data = bytearray((tmp_path / "a.exr").read_bytes())
    for which in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(which) + len(which) + 4
        data[at : at + 16] = struct.pack("<4i", *box)
    (tmp_path / "a.exr").write_bytes(data)
    start = time.perf_counter()
    with pytest.raises(PlateError, match=r"a\.exr: .*damaged"):
        read_exr(tmp_path / "a.exr")
    assert time.perf_counter() - start < 5


@pytest.mark.parametrize(("side", "why"), [(30_000, "its header claims"), (40_000, "damaged")])
def test_one_tile_that_claims_gigabytes_is_refused_before_any_is_asked_for(tmp_path: Path, side: int, why: str) -> None:
    # The library checks rows against the file's length, but a single tile of any size passes.
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    data = bytearray(make(tmp_path / "a.exr", header, {"Z": GRID.copy()}).read_bytes())
    at = data.index(b"tiles\0tiledesc\0") + len(b"tiles\0tiledesc\0") + 4
    data[at : at + 8] = struct.pack("<2I", side, side)
    for which in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(which) + len(which) + 4
        data[at : at + 16] = struct.pack("<4i", 0, 0, side - 1, side - 1)
    (tmp_path / "a.exr").write_bytes(data)
    with pytest.raises(PlateError, match=rf"a\.exr: .*{why}"):
        read_exr(tmp_path / "a.exr")


def test_what_is_no_exr_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty.exr").touch()
    (tmp_path / "words.exr").write_bytes(b"these are words, not a picture" * 50)
    for name, why in {"empty.exr": "empty", "words.exr": "not an EXR", "nowhere.exr": "no such file", "": "folder"}.items():
        with pytest.raises(PlateError, match=why):
            read_exr(tmp_path / name)


def test_words_travel_and_nothing_is_overwritten(tmp_path: Path) -> None:
    words = {"stereorelight/camera": "{" + "x" * 5000 + "}", "note": "größer", "empty": ""}
    path = write_exr(tmp_path / "grün 1.exr", {"Z": GRID}, metadata=words, view="left")
    (part,) = read_exr(path)
    assert part.metadata == words
    assert part.view == "left"
    before = path.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        write_exr(path, {"Z": GRID + 1})
    assert path.read_bytes() == before
    write_exr(path, {"Z": GRID + 1}, force=True)
    assert np.array_equal(read_exr(path)[0].channels["Z"], GRID + 1)


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OutputError, match="disk is full"):
        write_exr(tmp_path / "a.exr", {"Z": GRID})
    monkeypatch.undo()
    assert not list(tmp_path.iterdir())


def test_shapes_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    for channels in ({"Z": GRID, "R": GRID[:5]}, {"Z": GRID[..., None]}, {"Z": GRID[:0]}, {}, {"Z": np.array([["a"]])}):
        with pytest.raises(PassError):
            write_exr(tmp_path / "a.exr", channels)
    assert not list(tmp_path.iterdir())


def test_what_is_no_ordinary_file_is_never_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.exr"
    os.mkfifo(pipe)  # stands for /dev/null and its like, which a rename would replace
    (tmp_path / "folder.exr").mkdir()
    for name, why in (("pipe.exr", "is a device"), ("folder.exr", "is a folder")):
        with pytest.raises(OutputError, match=why):
            write_exr(tmp_path / name, {"Z": GRID}, force=True)
    assert pipe.is_fifo()
