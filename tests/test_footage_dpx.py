"""DPX: every depth, filling and byte order comes back code by code, against FFmpeg's encoder and a writer from the standard."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stereorelight.errors import PlateError
from stereorelight.footage.movie.dpx import exact_rate, read_dpx

ONE_FILE = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


def dpx_bytes(codes: np.ndarray, *, bits: int, order: str = ">", method: int = 1, descriptor: int = 50, aligned: bool = True, **fields: Any) -> bytes:
    """A DPX file by ST 268-1, tables 1 to 5; `codes` (H, W, C) in the file's channel order; `fields` are offset -> (kind, value) as at_<offset>."""
    h, w, _ = codes.shape
    flat = codes.reshape(h, -1).astype(np.uint32)
    if bits == 8:
        rows = [row.astype(np.uint8).tobytes() for row in flat]
    elif bits == 10:
        filled = np.pad(flat, ((0, 0), (0, -flat.shape[1] % 3))).reshape(h, -1, 3)
        words = (filled[..., 0] << 20 | filled[..., 1] << 10 | filled[..., 2]) << (2 if method == 1 else 0)
        rows = [row.astype(order + "u4").tobytes() for row in words]
    else:
        rows = [(row << (4 if bits == 12 and method == 1 else 0)).astype(order + "u2").tobytes() for row in flat]
    body = b"".join(row + bytes(-len(row) % 4 if aligned else 0) for row in rows)
    head = bytearray(b"\xff" * 2048)

    def put(offset: int, kind: str, value: Any) -> None:
        struct.pack_into(order + kind, head, offset, value)

    put(0, "I", 0x53445058)
    for offset, kind, value in (
        (4, "I", 2048),
        (16, "I", 2048 + len(body)),
        (768, "H", 0),
        (770, "H", 1),
        (772, "I", w),
        (776, "I", h),
        (780, "I", 0),
    ):
        put(offset, kind, value)
    for offset, kind, value in (
        (800, "B", descriptor),
        (801, "B", 1),
        (802, "B", 6),
        (803, "B", bits),
        (804, "H", method),
        (806, "H", 0),
        (808, "I", 2048),
        (812, "I", 0),
    ):
        put(offset, kind, value)
    for name, (kind, value) in fields.items():
        put(int(name.removeprefix("at_")), kind, value)
    return bytes(head) + body


def codes_of(values: np.ndarray, bits: int) -> np.ndarray:
    return np.rint(values.astype(np.float64) * (2**bits - 1)).astype(int)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("bits", "method"), [(8, 0), (10, 1), (10, 2), (12, 1), (12, 2), (16, 0)])
@ONE_FILE
@given(data=st.data())
def test_every_code_comes_back(tmp_path: Path, order: str, bits: int, method: int, data: st.DataObject) -> None:
    w, h = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 5))
    descriptor, channels = data.draw(st.sampled_from([(50, "RGB"), (51, "RGBA"), (52, "ABGR"), (6, "Y")]))
    codes = np.random.default_rng(data.draw(st.integers(0, 99))).integers(0, 2**bits, (h, w, len(channels)))
    codes.flat[0], codes.flat[-1] = 0, 2**bits - 1
    (tmp_path / "a.dpx").write_bytes(dpx_bytes(codes, bits=bits, order=order, method=method, descriptor=descriptor))
    got = read_dpx(tmp_path / "a.dpx")
    assert (got.bits, got.rgb.dtype, got.rgb.shape) == (bits, np.float32, (h, w, 3))
    for i, channel in enumerate("RGB"):
        assert np.array_equal(codes_of(got.rgb[..., i], bits), codes[..., channels.find(channel) if channel in channels else 0])
    if "A" in channels:
        assert got.alpha is not None
        assert np.array_equal(codes_of(got.alpha, bits), codes[..., channels.index("A")])
    else:
        assert got.alpha is None
    assert got.rgb.max() <= 1.0
    assert got.transfer == "printing density"
    assert got.is_log


@pytest.mark.parametrize("kind", ["rgb24", "rgb48le", "rgb48be", "gbrp10le", "gbrp10be", "gbrp12le", "gbrp12be"])
def test_what_ffmpeg_writes(tmp_path: Path, kind: str) -> None:
    w, h, bits = 5, 3, 8 if kind == "rgb24" else 10 if "p10" in kind else 12 if "p12" in kind else 16
    codes = np.random.default_rng(3).integers(0, 2**bits, (h, w, 3))
    dtype = "u1" if bits == 8 else (">" if kind.endswith("be") else "<") + "u2"
    frame = av.VideoFrame(w, h, kind)
    planes = [codes.reshape(h, -1)] if kind.startswith("rgb") else [codes[..., i] for i in (1, 2, 0)]
    for target, plane in zip(frame.planes, planes, strict=True):
        np.frombuffer(target, dtype).reshape(h, -1)[:, : plane.shape[1]] = plane
    encoder = av.CodecContext.create("dpx", "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = w, h, kind, Fraction(1, 24)
    (tmp_path / "a.dpx").write_bytes(bytes(encoder.encode(frame)[0]))
    assert np.array_equal(codes_of(read_dpx(tmp_path / "a.dpx").rgb, bits), codes)


def test_what_the_header_says(tmp_path: Path) -> None:
    path, codes = tmp_path / "a.dpx", np.zeros((2, 3, 3), int)
    said = {"at_1920": ("I", 0x01020323), "at_1940": ("f", 23.976024), "at_1724": ("f", 24.0), "at_801": ("B", 3), "at_802": ("B", 1)}
    path.write_bytes(dpx_bytes(codes, bits=10, **said))
    got = read_dpx(path)
    assert (got.timecode, got.rate, got.transfer, got.colorimetric) == ("01:02:03:23", Fraction(24000, 1001), "logarithmic", "printing density")
    path.write_bytes(dpx_bytes(codes, bits=10, at_1724=("f", 25.0), at_801=("B", 6)))
    got = read_dpx(path)
    assert (got.timecode, got.rate, got.transfer, got.is_log) == (None, Fraction(25), "Rec.709", False)
    path.write_bytes(dpx_bytes(codes, bits=10, at_801=("B", 255), at_1920=("I", 0x99FF0000)))
    got = read_dpx(path)
    assert (got.timecode, got.rate, got.transfer) == (None, None, "unknown")


@pytest.mark.parametrize(
    ("told", "exact"),
    [(23.976, (24000, 1001)), (23.98, (24000, 1001)), (29.97, (30000, 1001)), (59.94, (60000, 1001)), (24, (24, 1)), (12.5, (25, 2))],
)
def test_rates_are_exact(told: float, exact: tuple[int, int]) -> None:
    assert exact_rate(float(np.float32(told))) == Fraction(*exact)


def test_lines_in_another_order(tmp_path: Path) -> None:
    codes = np.arange(2 * 3 * 3).reshape(2, 3, 3)
    for orientation, turned in ((0, codes), (1, codes[:, ::-1]), (2, codes[::-1]), (3, codes[::-1, ::-1])):
        (tmp_path / "a.dpx").write_bytes(dpx_bytes(codes, bits=8, at_768=("H", orientation)))
        assert np.array_equal(codes_of(read_dpx(tmp_path / "a.dpx").rgb, 8), turned)


def test_lines_without_words(tmp_path: Path) -> None:
    codes = np.arange(3 * 5 * 3).reshape(3, 5, 3)
    (tmp_path / "a.dpx").write_bytes(dpx_bytes(codes, bits=8, aligned=False))
    assert np.array_equal(codes_of(read_dpx(tmp_path / "a.dpx").rgb, 8), codes)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("keep", [4, 100, 1700, 2047, 2048, 2100, -64, -4])
def test_truncated_files_are_refused(tmp_path: Path, bits: int, keep: int) -> None:
    whole = dpx_bytes(np.zeros((8, 5, 3), int), bits=bits)
    (tmp_path / "cut.dpx").write_bytes(whole[:keep])
    with pytest.raises(PlateError, match=r"cut\.dpx: truncated DPX"):
        read_dpx(tmp_path / "cut.dpx")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"at_770": ("H", 3)}, "3 picture elements"),
        ({"at_800": ("B", 100)}, "Y'CbCr"),
        ({"at_800": ("B", 8)}, "other than RGB"),
        ({"at_803": ("B", 32)}, "32 bit"),
        ({"at_780": ("I", 1)}, "signed"),
        ({"at_806": ("H", 1)}, "run-length"),
        ({"at_804": ("H", 0)}, "packed across words"),
        ({"at_772": ("I", 0)}, "0 x 2"),
        ({"at_772": ("I", 0xFFFFFFFF)}, "damaged"),
        ({"at_768": ("H", 5)}, "columns"),
    ],
)
def test_what_is_not_read_says_so(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    (tmp_path / "odd.dpx").write_bytes(dpx_bytes(np.zeros((2, 3, 3), int), bits=10, **change))
    with pytest.raises(PlateError, match=rf"odd\.dpx: .*{words}.*"):
        read_dpx(tmp_path / "odd.dpx")


def test_no_dpx(tmp_path: Path) -> None:
    with pytest.raises(PlateError, match="no such file"):
        read_dpx(tmp_path / "none.dpx")
    (tmp_path / "a.dpx").write_bytes(b"\x89PNG")
    with pytest.raises(PlateError, match="is not a DPX"):
        read_dpx(tmp_path / "a.dpx")


@ONE_FILE
@given(at=st.integers(0, 2047), junk=st.binary(min_size=1, max_size=12))
def test_damaged_headers_end_in_our_error_or_a_picture(tmp_path: Path, at: int, junk: bytes) -> None:
    data = bytearray(dpx_bytes(np.zeros((4, 5, 3), int), bits=10))
    data[at : at + len(junk)] = junk
    (tmp_path / "a.dpx").write_bytes(data)
    told = "a.dpx"
    try:
        assert read_dpx(tmp_path / "a.dpx").rgb.ndim == 3
    except PlateError as error:
        told = str(error)
    assert "a.dpx" in told
