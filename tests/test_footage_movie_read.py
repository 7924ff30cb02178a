"""Movies that the test writes itself come back frame for frame: right frame, right values, right time code, in any order."""

from __future__ import annotations

import pickle
import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.errors import PlateError
from stereorelight.footage.movie.pixels import layout_of
from stereorelight.footage.movie.reader import Movie, movie_streams
from stereorelight.footage.movie.timecode import Timecode
from stereorelight.footage.ycbcr import planes_from_rgb, rgb_from_planes, weights
from tests.movie_files import LOSSLESS, LOSSY, fill, write_movie

SIZE = (64, 48)


def picture(number: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A smooth picture (H, W, 3) that no other number has, grey to the left."""
    w, h = size
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)
    ramp = 0.2 + 0.5 * x / w
    tint = np.where(x > w / 2, 0.15 * y / h, 0)
    return np.dstack([ramp + tint, ramp, ramp - tint]).astype(np.float32) + np.float32(0.01 * (number % 10))


def planes_for(pixel_format: str, number: int, *, matrix: str = "bt709", full: bool = False, size: tuple[int, int] = SIZE) -> list[np.ndarray]:
    """Planes as the pixel format wants them, in the decoder's order."""
    layout = layout_of(pixel_format)
    assert layout is not None
    rgb = picture(number, size)
    if layout.is_rgb:
        r, g, b = planes_from_rgb(rgb, bits=layout.bits, full_range=True, matrix="rgb", subsampling="444")
        if layout.packed:
            return [np.dstack([b, g, r, np.zeros_like(r)]).reshape(size[1], -1)]
        return [g, b, r]
    kind = {(False, False): "444", (False, True): "422", (True, True): "420"}[layout.halved]
    return list(planes_from_rgb(rgb, bits=layout.bits, full_range=full, matrix=matrix, subsampling=kind))


def expected(pixel_format: str, number: int, *, matrix: str = "bt709", full: bool = False) -> np.ndarray:
    """What reading must give, from the planes themselves."""
    layout = layout_of(pixel_format)
    assert layout is not None
    planes = planes_for(pixel_format, number, matrix=matrix, full=full)
    if layout.packed:
        planes = [planes[0][:, k :: layout.packed] for k in (2, 1, 0)]
    elif layout.is_rgb:
        planes = [planes[k] for k in (2, 0, 1)]
    return rgb_from_planes(planes, bits=layout.bits, full_range=full or layout.is_rgb, matrix="rgb" if layout.is_rgb else matrix)


@pytest.mark.parametrize("name", LOSSLESS)
def test_lossless_codecs_come_back_bit_for_bit(name: str, tmp_path: Path) -> None:
    kind = LOSSLESS[name]
    path = tmp_path / ("m.mkv" if name.startswith("ffv1") else "m.mov")
    write_movie(path, [planes_for(kind[1], k) for k in range(5)], SIZE, kind, tags=("bt709", False) if "yuv" in kind[1] else None)
    with Movie(path) as movie:
        assert (movie.info.frames, movie.info.size, movie.info.rate) == (5, SIZE, 25)
        for k in range(5):
            np.testing.assert_array_equal(movie.read(k), expected(kind[1], k))


# What the codec may change, in codes of the given planes: luma, chroma, and the median over all samples.
LOSS = {
    "prores422": (1, 1, 0),  # its finest quantiser steps by about a code: a sample moves to the next one at most, and most do not move
    "prores4444": (1.25, 1.5, 0.25),  # decoded to 12 bits, whose code is a quarter of ours
    "dnxhr-8": (1, 1, 0),
    "dnxhr-10": (1, 2, 0),  # a fixed number of bits a frame, so that chroma is quantised more coarsely at the step of tint
    "dnxhr-444": (1, 1, 0),
}


@pytest.mark.parametrize(("name", "suffix"), [*[(name, ".mov") for name in LOSSY], ("dnxhr-10", ".mxf"), ("prores422", ".mkv")])
def test_camera_codecs_come_back_within_a_code_or_two(name: str, suffix: str, tmp_path: Path) -> None:
    kind, size = LOSSY[name], (256, 128)
    given = [planes_for(kind[1], k, size=size) for k in range(3)]
    path = write_movie(tmp_path / f"m{suffix}", given, size, kind, tags=("bt709", False))
    layout = layout_of(kind[1])
    assert layout is not None
    kr, kb = weights("bt709")
    luma, chroma, middle = LOSS[name]
    code = 1 / (219 * 2 ** (layout.bits - 8))
    # A code of Cb or Cr is 219/224 of one of luma, and weighs 2 (1 - k) in its own channel; in green both weigh less.
    bound = np.array([luma + chroma * 2 * (1 - k) * 219 / 224 for k in (kr, kb, kb)])[[0, 2, 1]]
    with Movie(path) as movie:
        for k, planes in enumerate(given):
            wanted = rgb_from_planes(planes, bits=layout.bits, full_range=False, matrix="bt709")
            error = np.abs(movie.read(k) - wanted) / code
            assert (error.max(axis=(0, 1)) <= bound + 0.01).all()  # float32 at 10 bits: 1e-7 of 1, in codes 1e-4
            assert np.median(error) <= middle * (1 if middle == 0 else 1.01) + 1e-3


def test_dnxhd_at_a_camera_s_bit_rate(tmp_path: Path) -> None:
    """VC-3 knows only its own sizes and rates: 1080p25, 8 bit 4:2:2, 120 Mbit/s."""
    kind, size = ("dnxhd", "yuv422p", {"b": "120M"}), (1920, 1080)
    given = [planes_for(kind[1], k, size=size) for k in range(2)]
    path = write_movie(tmp_path / "m.mov", given, size, kind, tags=("bt709", False))
    with Movie(path) as movie:
        assert (movie.info.codec, movie.info.pixel_format, movie.info.frames, movie.info.interlaced) == ("dnxhd", "yuv422p", 2, False)
        for k, planes in enumerate(given):
            error = np.abs(movie.read(k) - rgb_from_planes(planes, bits=8, full_range=False, matrix="bt709")) * 219
            assert np.median(error) == 0
            assert error.max() <= 1 + 2 * 2 * (1 - weights("bt709")[1]) * 219 / 224 + 0.01  # one code of luma, two of chroma at the tint's edge


@pytest.mark.parametrize("name", ["h264-10", "ffv1-422-10", "prores422", "prores4444", "dnxhr-10"])
def test_white_and_black_are_exact(name: str, tmp_path: Path) -> None:
    kind = {**LOSSLESS, **LOSSY}[name]
    layout = layout_of(kind[1])
    assert layout is not None
    h, w = (-(-n // 2) if half else n for n, half in zip((128, 256), layout.halved))
    flat = [[np.full((128, 256), y, np.uint16), *[np.full((h, w), 512, np.uint16)] * 2] for y in (940, 64)]
    path = write_movie(tmp_path / ("m.mkv" if "ffv1" in name else "m.mov"), flat, (256, 128), kind, tags=("bt709", False))
    with Movie(path) as movie:
        # A 12 bit decoder of ProRes may land one of its own quanta beside.
        slack = 1 / 3504 if movie.info.bits == 12 else 0
        assert np.abs(movie.read(0) - 1).max() <= slack
        assert np.abs(movie.read(1)).max() <= slack


@pytest.mark.parametrize("matrix", ["bt601", "bt709", "bt2020"])
@pytest.mark.parametrize("full", [False, True])
def test_tags_decide_and_can_be_overruled(matrix: str, full: bool, tmp_path: Path) -> None:
    kind = LOSSLESS["h264-10"]
    path = write_movie(tmp_path / "m.mov", [planes_for(kind[1], 1, matrix=matrix, full=full)], SIZE, kind, tags=(matrix, full))
    with Movie(path) as movie:
        assert (movie.info.matrix, movie.info.full_range) == (matrix, full)
        np.testing.assert_array_equal(movie.read(0), expected(kind[1], 1, matrix=matrix, full=full))
    with Movie(path, matrix="bt709", levels="video") as movie:
        assert (movie.info.matrix, movie.info.full_range) == ("bt709", False)


def test_untagged_goes_by_size(tmp_path: Path) -> None:
    kind = LOSSLESS["ffv1-8"]
    for size, matrix in ((SIZE, "bt601"), ((1280, 720), "bt709")):
        path = write_movie(tmp_path / f"{matrix}.mkv", [planes_for(kind[1], 0, size=size)], size, kind)
        assert (Movie(path).info.matrix, Movie(path).info.full_range) == (matrix, False)


@pytest.fixture(scope="module")
def long_gop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kind = ("libx264", "yuv420p", {"qp": "12", "bf": "3", "g": "15", "x264-params": "open-gop=1:b-pyramid=normal:scenecut=0"})
    rng = np.random.default_rng(3)
    frames = [[np.roll(p, k, axis=1) for p in planes_for("yuv420p", 0)] for k in range(50)]
    for planes in frames:
        planes[0][10:20] = rng.integers(16, 235, planes[0][10:20].shape)
    return write_movie(tmp_path_factory.mktemp("gop") / "gop.mov", frames, SIZE, kind, tags=("bt709", False), timecode="00:59:59:20")


def test_any_order_gives_the_same_bits(long_gop: Path) -> None:
    with Movie(long_gop, threads=1) as movie:
        straight = [movie.read(k) for k in range(movie.info.frames)]
    assert len(straight) == 50
    assert len({frame.tobytes() for frame in straight}) == 50
    order = np.random.default_rng(1).permutation(50)
    for threads in (1, 4):
        with Movie(long_gop, threads=threads) as movie:
            for k in [*order, 49, 0, 0, 48, 14, 15, 16]:
                np.testing.assert_array_equal(movie.read(int(k)), straight[k], err_msg=f"frame {k}")


def test_reading_on_never_seeks(long_gop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Movie(long_gop) as movie:
        calls: list[int] = []
        packets = movie._packets_from
        movie.read(0)
        monkeypatch.setattr(movie, "_packets_from", lambda key: calls.append(key) or packets(key))
        for k in range(50):
            movie.read(k)
        assert calls == []


def test_time_code_rate_and_pickle(long_gop: Path) -> None:
    movie = Movie(long_gop)
    assert str(movie.info.timecode(0)) == "00:59:59:20"
    assert str(movie.info.timecode(5)) == "01:00:00:00"
    again = pickle.loads(pickle.dumps(movie))
    np.testing.assert_array_equal(again.read(7), movie.read(7))


@pytest.mark.parametrize("suffix", [".mov", ".mkv"])
@pytest.mark.parametrize("count", [24, 30, 48, 60, 120])
def test_ntsc_rates_are_exact_and_time_code_is_kept(count: int, suffix: str, tmp_path: Path) -> None:
    """Matroska's clock ticks a thousand times a second, its reader rounds the rate, and its keys are capitals."""
    rate, kind = Fraction(count * 1000, 1001), LOSSLESS["ffv1-8"] if suffix == ".mkv" else LOSSY["prores422"]
    code = "01:00:59;28" if count == 30 else "01:00:59:20"
    frames = [planes_for(kind[1], k) for k in range(12)]
    path = write_movie(tmp_path / f"m{suffix}", frames, SIZE, kind, rate=rate, timecode=code)
    info = Movie(path).info
    assert (info.rate, info.gaps, info.frames) == (rate, (), 12)
    assert info.timecode(0) == Timecode.parse(code, rate)
    if count == 30:
        assert str(info.timecode(2)) == "01:01:00;02"


def test_dropped_frames_are_told_and_a_variable_rate_refused(tmp_path: Path) -> None:
    kind = LOSSLESS["h264-8"]
    frames = [planes_for(kind[1], k) for k in range(30)]
    dropped = write_movie(tmp_path / "d.mov", frames, SIZE, kind, steps=[k + (k > 10) for k in range(30)])
    assert Movie(dropped).info.gaps == (10,)
    uneven = write_movie(tmp_path / "v.mov", frames, SIZE, kind, steps=np.cumsum([1 + k % 2 for k in range(30)]).tolist())
    with pytest.raises(PlateError, match=r"variable frame rate.*first frame \d"):
        Movie(uneven).read(0)


@pytest.mark.parametrize("name", ["ffv1-422-10", "h264-8"])
def test_two_tracks_are_two_movies(name: str, tmp_path: Path) -> None:
    kind = LOSSLESS[name]
    tracks = [[planes_for(kind[1], first + k) for k in range(4)] for first in (0, 5)]
    path = write_movie(tmp_path / "two.mkv", tracks[0], SIZE, kind, second=tracks[1], tags=("bt709", False))
    assert [info.stream for info in movie_streams(path)] == [0, 1]
    with Movie(path, stream=0) as left, Movie(path, stream=1) as right:
        for k in (3, 0, 1, 2):
            np.testing.assert_array_equal(left.read(k), expected(kind[1], k))
            np.testing.assert_array_equal(right.read(k), expected(kind[1], 5 + k))
    with pytest.raises(PlateError, match=r"no video stream 2; there is 0 \(\w+ 64 x 48\), 1"):
        Movie(path, stream=2).read(0)


def test_a_cover_picture_is_no_track(tmp_path: Path) -> None:
    cover = write_movie(tmp_path / "cover.jpg", [planes_for("yuvj420p", 0)], SIZE, ("mjpeg", "yuvj420p", {}), container="mjpeg")
    kind, path = LOSSLESS["ffv1-8"], tmp_path / "m.mkv"
    with av.open(str(path), "w") as container:
        container.add_attachment("cover.jpg", "image/jpeg", cover.read_bytes())
        stream = container.add_stream(kind[0], rate=25)
        stream.width, stream.height, stream.pix_fmt = *SIZE, kind[1]
        for k in range(3):
            frame = av.VideoFrame(*SIZE, kind[1])
            fill(frame, planes_for(kind[1], k))
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with av.open(str(path)) as container:
        assert len(container.streams.video) == 2
    (info,) = movie_streams(path)
    assert (info.codec, info.frames) == ("ffv1", 3)


@pytest.mark.parametrize("kind", [("libx264", "yuv420p", {"flags": "+ildct+ilme"}), ("prores_ks", "yuv422p10le", {"flags": "+ildct"})])
def test_interlaced_movies_are_read_woven_and_say_so(kind: tuple[str, str, dict[str, str]], tmp_path: Path) -> None:
    frames = [planes_for(kind[1], k) for k in range(3)]
    for woven in (True, False):
        path = write_movie(tmp_path / "m.mov", frames, SIZE, kind if woven else (*kind[:2], {}))
        info = Movie(path).info
        assert (info.interlaced, info.frames, info.size) == (woven, 3, SIZE)


def test_rotation_is_told_and_not_applied(tmp_path: Path) -> None:
    kind = LOSSLESS["h264-8"]
    path = write_movie(tmp_path / "m.mov", [planes_for(kind[1], 2)], SIZE, kind, tags=("bt709", False))
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 44  # ISO/IEC 14496-12 8.3.2: the matrix of the track header, a b u c d v x y w
    assert struct.unpack_from(">9i", data, at) == (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    struct.pack_into(">9i", data, at, 0, 1 << 16, 0, -(1 << 16), 0, 0, SIZE[1] << 16, 0, 1 << 30)  # a quarter turn clockwise
    path.write_bytes(data)
    with Movie(path) as movie:
        assert (movie.info.rotation_deg % 360, movie.info.size) == (270, SIZE)
        np.testing.assert_array_equal(movie.read(0), expected(kind[1], 2))


@pytest.mark.parametrize("suffix", [".mov", ".mp4"])
@pytest.mark.parametrize("name", ["h264-8", "prores422"])
def test_cut_behind_its_index_a_movie_keeps_what_came_before(name: str, suffix: str, tmp_path: Path) -> None:
    """The index stands in front, so the file says which frames there should be; those that are there are the same bits."""
    if (name, suffix) == ("prores422", ".mp4"):
        suffix = ".MOV"  # an .mp4 holds no ProRes
    kind = {**LOSSLESS, **LOSSY}[name]
    rng = np.random.default_rng(5)
    frames = [planes_for(kind[1], k) for k in range(24)]
    for planes in frames:
        planes[0][:] = rng.integers(100, 200, planes[0].shape)
    path = write_movie(tmp_path / f"whole{suffix}", frames, SIZE, kind, tags=("bt709", False), options={"movflags": "faststart"})
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(data[: int(0.6 * len(data))])
    good = frames_kept(cut, path)
    with Movie(cut) as movie:
        if name == "prores422":
            assert movie.info.frames == 24
            assert f"{24 - good} frames from frame {good} on cannot be read" in movie.info.fault
        else:  # the index does not tell in which order they are shown, so what is there is counted: the last one in part
            assert movie.info.frames == good + 1
            assert f"frame {good} cannot be read" in movie.info.fault
            assert f"{23 - good} frames missing after frame {good}" in movie.info.fault
        assert "cut short" in movie.info.fault


def frames_kept(cut: Path, whole: Path) -> int:
    """How many frames of a damaged movie are the same bits as those of the whole one, up to the first that is refused by name."""
    with Movie(cut) as part, Movie(whole) as sound:
        good, problem = 0, ""
        while good < sound.info.frames and not problem:
            try:
                found = part.read(good)
            except PlateError as error:
                problem = str(error)
            else:
                np.testing.assert_array_equal(found, sound.read(good))
                good += 1
        assert f"frame {good}" in problem
        assert "\n" not in problem
        assert 6 <= good < 24
        np.testing.assert_array_equal(part.read(3), sound.read(3))
        return good


@pytest.mark.parametrize(("name", "suffix"), [("h264-8", ".mkv"), ("prores422", ".mov"), ("ffv1-422-10", ".mkv"), ("h265-8", ".mkv")])
def test_a_truncated_movie_keeps_its_good_frames(name: str, suffix: str, tmp_path: Path) -> None:
    kind = {**LOSSLESS, **LOSSY}[name]
    rng = np.random.default_rng(5)
    frames = [planes_for(kind[1], k) for k in range(24)]
    for planes in frames:
        planes[0][:] = rng.integers(100, 200, planes[0].shape)
    path = write_movie(tmp_path / f"whole{suffix}", frames, SIZE, kind, tags=("bt709", False))
    data = path.read_bytes()
    if suffix == ".mov":  # the index stands behind the pictures: cut a hole instead, as a broken copy has one
        data = data[: len(data) // 2] + bytes(len(data) // 8) + data[len(data) // 2 + len(data) // 8 :]
    else:
        data = data[: int(0.6 * len(data))]
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(data)
    good = frames_kept(cut, path)
    if suffix == ".mkv":  # what is written as it comes holds no count of frames: the cut itself is told
        assert Movie(cut).info.frames in (good, good + 1)
        assert "cut short" in Movie(cut).info.fault
        assert Movie(path).info.fault == ""


@pytest.mark.parametrize(("every", "lost"), [("1", {13}), ("6", {13, 14, 15, 16, 17})])
def test_ffv1_that_decodes_but_is_not_what_was_written(every: str, lost: set[int], tmp_path: Path) -> None:
    """FFmpeg paints a slice that fails its checksum over and says nothing: the frame is refused, those that lean on it too, no other."""
    rng = np.random.default_rng(5)
    frames = [(rng.integers(0, 1023, (SIZE[1], SIZE[0])).astype(np.uint16),) * 3 for _ in range(24)]
    path = write_movie(tmp_path / "whole.mkv", frames, SIZE, ("ffv1", "yuv444p10le", {"level": "3", "g": every, "slices": "4"}))
    data = bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        packet = [bytes(packet) for packet in container.demux(video=0) if packet.size][13]
    at = data.index(packet) + len(packet) // 2
    data[at] ^= 1  # one bit
    (tmp_path / "hurt.mkv").write_bytes(data)
    with Movie(tmp_path / "hurt.mkv", first_frame=1001) as hurt, Movie(path) as whole:
        for number in (*range(24), 20, 13, 2):
            if number in lost:
                with pytest.raises(PlateError, match=f"frame {1001 + number} cannot be read: .* checksum; frames 1001-1013 before it are good"):
                    hurt.read(number)
            else:
                np.testing.assert_array_equal(hurt.read(number), whole.read(number))


def test_ffv1_without_checksums_is_read_as_it_is(tmp_path: Path) -> None:
    frames = [planes_for("yuv420p", k) for k in range(3)]
    for number, options in enumerate(({"level": "1"}, {"level": "3", "slices": "4", "slicecrc": "0"})):
        path = write_movie(tmp_path / f"{number}.mkv", frames, SIZE, ("ffv1", "yuv420p", options))
        with Movie(path) as movie:
            assert [movie.read(k).shape for k in range(3)] == [(SIZE[1], SIZE[0], 3)] * 3


def test_what_is_no_movie(tmp_path: Path) -> None:
    text = tmp_path / "a.mov"
    text.write_text("no movie " * 500)
    sound = tmp_path / "sound.wav"
    with av.open(str(sound), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.rate = 8000
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)
    for path, words in ((text, "is no movie"), (sound, "no video stream"), (tmp_path / "none.mov", "no such file"), (tmp_path, "folder")):
        with pytest.raises(PlateError, match=words) as caught:
            Movie(path).read(0)
        assert "\n" not in str(caught.value)
    with pytest.raises(PlateError, match="did you mean"):
        Movie(text, matrix="bt708")


@pytest.mark.parametrize("pixel_format", ["pal8", "bayer_rggb8", "gray16be", "gbrpf32le", "yuv411p"])
def test_odd_pixel_formats_have_no_layout(pixel_format: str) -> None:
    assert layout_of(pixel_format) is None


def test_a_frame_beyond_the_end(long_gop: Path) -> None:
    with pytest.raises(PlateError, match="has no frame 50; it has frames 0-49"):
        Movie(long_gop).read(50)


RATES = [Fraction(24), Fraction(25), Fraction(24000, 1001), Fraction(30000, 1001), Fraction(60000, 1001), Fraction(120)]


@given(st.sampled_from(RATES), st.integers(0, 5_000_000), st.booleans())
@settings(max_examples=50, deadline=None)
def test_time_code_text_is_the_frame(rate: Fraction, frames: int, drop: bool) -> None:
    drop = drop and rate.denominator == 1001 and rate > 29
    code = Timecode(frames=frames, rate=rate, drop=drop)
    assert Timecode.parse(str(code), rate) == code
    assert (code + 7) - code in (7, 7 - code._day())
    assert str(code + 1) != str(code)


def test_drop_frame_by_the_standard() -> None:
    rate = Fraction(30000, 1001)
    assert str(Timecode.parse("01:00:59;29", rate) + 1) == "01:01:00;02"
    assert str(Timecode.parse("01:09:59;29", rate) + 1) == "01:10:00;00"
    assert Timecode.parse("01:00:00;00", rate).frames == 107892
    assert abs(Timecode.parse("23:59:59;29", rate).seconds - 86400) < Fraction(1, 8)
    for wrong in ("01:01:00;00", "01:00:00:30", "25:00:00:00", "1:2", "ab"):
        with pytest.raises(PlateError):
            Timecode.parse(wrong, rate)
    with pytest.raises(PlateError, match="drop-frame"):
        Timecode.parse("01:00:00;00", Fraction(25))
