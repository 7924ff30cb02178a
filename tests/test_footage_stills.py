"""Stills: whole numbers come back exactly, in RGB order, and a file that is cut short is never half shown."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.errors import OutputError, PassError, PlateError
from stereorelight.footage.stills import read_still, write_still

ONE_FILE = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SHAPES = st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(3))
NOISE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("bits", [8, 16])
@ONE_FILE
@given(data=st.data())
def test_whole_numbers_return_exactly(tmp_path: Path, suffix: str, bits: int, data: st.DataObject) -> None:
    picture = data.draw(hnp.arrays(f"u{bits // 8}", SHAPES))
    path = write_still(tmp_path / f"a{suffix}", picture, bits=bits, force=True)
    still = read_still(path)
    assert still.bits == bits
    assert np.array_equal(np.rint(still.rgb.astype(np.float64) * (2**bits - 1)), picture)
    write_still(path, still.rgb, bits=bits, force=True)
    assert np.array_equal(read_still(path).rgb, still.rgb)


def test_red_is_red_and_strides_are_kept(tmp_path: Path) -> None:
    for view in (NOISE[::-1], NOISE[:, ::-1], NOISE.transpose(1, 0, 2), NOISE[::2, 1::3], np.asfortranarray(NOISE)):
        assert np.array_equal(np.rint(read_still(write_still(tmp_path / "a.png", view, force=True)).rgb * 255), view)
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 0] = 255
    write_still(tmp_path / "red.png", red)
    assert cv2.imread(str(tmp_path / "red.png"))[0, 0].tolist() == [0, 0, 255]


def test_jpeg_is_near(tmp_path: Path) -> None:
    ramp = np.linspace(0, 1, 64, dtype=np.float32)[None, :, None].repeat(48, 0).repeat(3, 2)
    still = read_still(write_still(tmp_path / "a.jpg", ramp))
    assert still.bits == 8
    assert np.abs(still.rgb - ramp).max() < 0.02


def test_alpha_is_kept_apart_and_gray_is_repeated(tmp_path: Path) -> None:
    rgba = np.dstack([NOISE, NOISE[..., 0]])
    cv2.imwrite(str(tmp_path / "a.png"), rgba)
    still = read_still(tmp_path / "a.png")
    assert still.alpha is not None
    assert np.array_equal(np.rint(still.alpha * 255), rgba[..., 3])
    assert np.array_equal(np.rint(still.rgb * 255), rgba[..., 2::-1])
    cv2.imwrite(str(tmp_path / "g.png"), NOISE[..., 0].astype(np.uint16) * 257)
    gray = read_still(tmp_path / "g.png")
    assert gray.bits == 16
    assert np.array_equal(np.rint(gray.rgb * 65535), (NOISE[..., :1].astype(np.uint16) * 257).repeat(3, axis=2))


def test_float_tiff_keeps_its_values(tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=(20, 30, 3)).astype(np.float32) * 9
    cv2.imwrite(str(tmp_path / "a.tif"), values[..., ::-1])
    still = read_still(tmp_path / "a.tif")
    assert still.is_float
    assert np.array_equal(still.rgb, values)


def plain_tiff(picture: np.ndarray) -> bytes:
    """An uncompressed TIFF whose directory stands first, as many cameras and compositors write it: the pixels end the file."""
    h, w, _ = picture.shape
    tags = [(256, 4, w), (257, 4, h), (258, 3, 8), (259, 3, 1), (262, 3, 2), (273, 4, 0), (277, 3, 3), (278, 4, h), (279, 4, picture.size)]
    start = 8 + 2 + 12 * len(tags) + 4
    rows = b"".join(struct.pack("<HHII", tag, kind, 1, start if tag == 273 else value) for tag, kind, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4) + picture.tobytes()


def coded(kind: str) -> bytes:
    if kind == "plain.tif":
        return plain_tiff(NOISE)
    return cv2.imencode("." + kind.split(".")[-1], NOISE.astype(np.uint16) * 257 if "16" in kind else NOISE)[1].tobytes()


@pytest.mark.parametrize("kind", ["8.png", "16.png", "8.jpg", "8.tif", "16.tif", "plain.tif"])
@pytest.mark.parametrize("keep", [0, 3, 0.01, 0.1, 0.5, 0.9, -20, -4, -1])
def test_truncated_pictures_are_refused_and_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str, keep: float) -> None:
    whole = coded(kind)
    path = tmp_path / f"cut{kind}"
    path.write_bytes(whole)
    read_still(path)
    path.write_bytes(whole[: int(keep) if isinstance(keep, int) else int(keep * len(whole))])
    with pytest.raises(PlateError, match=r"cut.*: .*(truncated|empty|is not a)"):
        read_still(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["8.png", "8.jpg", "16.tif"])
@ONE_FILE
@given(at=st.floats(0, 1), junk=st.binary(min_size=1, max_size=30))
def test_damaged_bytes_never_end_in_anything_but_our_error(tmp_path: Path, kind: str, at: float, junk: bytes) -> None:
    data = bytearray(coded(kind))
    start = int(at * (len(data) - len(junk)))
    changed = data[start : start + len(junk)] != junk
    data[start : start + len(junk)] = junk
    (tmp_path / kind).write_bytes(data)
    told = ""
    try:
        read_still(tmp_path / kind)
    except PlateError as error:
        told = str(error)
    # A PNG's checksums find every damage; a TIFF or JPEG with a few other pixels is a picture like any.
    assert kind in told or (told == "" and not (changed and kind.endswith("png")))


@given(junk=st.binary(max_size=200))
@ONE_FILE
def test_garbage_is_refused(tmp_path: Path, junk: bytes) -> None:
    (tmp_path / "a.png").write_bytes(junk)
    with pytest.raises(PlateError, match=r"a\.png"):
        read_still(tmp_path / "a.png")


def test_missing_and_folder(tmp_path: Path) -> None:
    with pytest.raises(PlateError, match="no such file"):
        read_still(tmp_path / "a.png")
    with pytest.raises(PlateError, match="folder"):
        read_still(tmp_path)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="written as"):
        write_still(tmp_path / "a.bmp", NOISE)
    with pytest.raises(OutputError, match="16"):
        write_still(tmp_path / "a.jpg", NOISE, bits=16)
    with pytest.raises(PassError, match="NaN"):
        write_still(tmp_path / "a.png", np.full((2, 2, 3), np.nan))
    with pytest.raises(PassError, match="uint16"):
        write_still(tmp_path / "a.png", NOISE, bits=16)
    with pytest.raises(PassError, match="shape"):
        write_still(tmp_path / "a.png", NOISE[..., :2])
    write_still(tmp_path / "a.png", NOISE)
    with pytest.raises(OutputError, match="exists already"):
        write_still(tmp_path / "a.png", NOISE)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
