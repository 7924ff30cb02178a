"""Movies written are movies read: values within each codec's own steps, tags, rate and time code, and no half movie ever."""

from __future__ import annotations

import itertools
import os
import resource
import signal
import tracemalloc
import weakref
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from stereorelight.errors import OutputError, PassError, PlateError
from stereorelight.footage.movie.dpx import exact_rate
from stereorelight.footage.movie.writer import CODECS, MovieWriter, check_movie, movie_suffix
from stereorelight.footage.stills import write_still
from stereorelight.footage.ycbcr import planes_from_rgb, rgb_from_planes
from stereorelight.shot.movies import anaglyphs, labelled, sheet_places, shot_sheet, wiped, write_movie, write_movies

FILM = Fraction(24000, 1001)
STEP8 = 1 / 219  # one code of 8-bit video range luma
# What a codec may add to a ramp beyond rounding to its planes, in 8-bit codes: its own quantiser at these settings, measured.
RAMP_CODES = {"h264": 5.0, "h265": 4.0, "prores": 1.5, "prores4444": 0.8, "dnxhr": 1.7, "ffv1": 0.15}
EVERY_CODEC = pytest.mark.parametrize("codec", CODECS)


def ramp(w: int = 320, h: int = 180) -> np.ndarray:
    y, x = np.mgrid[:h, :w].astype(np.float32)
    return np.stack([x / (w - 1), y / (h - 1), np.full_like(x, 0.5)], axis=-1)


def patches() -> np.ndarray:
    """Black, white, greys, primaries and skin, each 64 pixels square: flat areas, as a chart has them."""
    colours = [
        (0, 0, 0),
        (1, 1, 1),
        (0.5, 0.5, 0.5),
        (0.1, 0.1, 0.1),
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, 1),
        (0.78, 0.57, 0.48),
        (0.2, 0.6, 0.9),
        (0.9, 0.8, 0.1),
    ]
    return np.kron(np.array(colours, np.float32).reshape(2, 5, 3), np.ones((64, 64, 1), np.float32))


def made(path: Path, frames: list[np.ndarray], codec: str, **how: object) -> Path:
    size = (frames[0].shape[1], frames[0].shape[0])
    with MovieWriter(path, **{"size": size, "rate": FILM, "codec": codec, **how}) as movie:  # type: ignore[arg-type]
        for frame in frames:
            movie.write(frame)
    return path


def decoded(path: Path) -> list[np.ndarray]:
    """Every frame by FFmpeg's decoder and our own matrix: encoded R'G'B'."""
    pictures = []
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            bits = frame.format.components[0].bits
            dtype = np.dtype(np.uint8 if bits == 8 else np.uint16)
            planes = [np.frombuffer(p, dtype).reshape(-1, p.line_size // dtype.itemsize)[: p.height, : p.width] for p in frame.planes[:3]]
            pictures.append(rgb_from_planes(planes, bits=bits, full_range=False, matrix="bt709"))
    return pictures


@EVERY_CODEC
def test_flat_patches_come_back_within_the_codecs_own_step(tmp_path: Path, codec: str) -> None:
    kind, chart = CODECS[codec], patches()
    got = decoded(made(tmp_path / f"a{movie_suffix(codec)}", [chart] * 3, codec))
    assert len(got) == 3
    inside = np.zeros((128, 320), bool)  # the middle of each patch: chroma and transforms reach over its edges
    for y in (0, 64):
        for x in range(0, 320, 64):
            inside[y + 24 : y + 40, x + 24 : x + 40] = True
    planes = planes_from_rgb(chart, bits=kind.bits, full_range=False, matrix="bt709", subsampling="444")
    rounded = rgb_from_planes(planes, bits=kind.bits, full_range=False, matrix="bt709")
    quantum = STEP8 / 2 ** (kind.bits - 8)
    for picture in got:
        # Half a step of luma and of both chroma planes is what rounding costs; a codec may move each by one step more.
        assert np.abs(picture - chart)[inside].max() <= np.abs(rounded - chart).max() + 2 * quantum
        white = picture[24:40, 88:104]
        assert np.abs(white - 1).max() <= (0 if codec == "ffv1" else quantum)


@EVERY_CODEC
def test_ramps_come_back(tmp_path: Path, codec: str) -> None:
    for picture in decoded(made(tmp_path / f"a{movie_suffix(codec)}", [ramp()] * 2, codec)):
        error = (picture - ramp()) * 255
        assert np.abs(error).max() < RAMP_CODES[codec]
        assert np.abs(error.mean(axis=(0, 1))).max() < 0.25  # no channel drifts: matrix and range are right


def test_lossless_returns_every_8_bit_picture_exactly(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (33, 47, 3), dtype=np.uint8)
    (got,) = decoded(made(tmp_path / "a.mkv", [noise], "ffv1"))
    assert np.array_equal(np.rint(got * 255), noise)
    deep = np.random.default_rng(0).integers(0, 65536, (16, 16, 3), dtype=np.uint16)
    (got,) = decoded(made(tmp_path / "b.mkv", [deep], "ffv1"))
    assert np.abs(got - deep / 65535).max() < 1.5 * STEP8 / 16


@EVERY_CODEC
@pytest.mark.parametrize(("transfer", "number"), [("sRGB", 13), ("bt709", 1)])
def test_tags_rate_and_time_code_are_in_the_file(tmp_path: Path, codec: str, transfer: str, number: int) -> None:
    for suffix in CODECS[codec].suffixes:
        path = made(tmp_path / f"a{suffix}", [ramp()] * 5, codec, transfer=transfer, timecode="10:11:12:13")
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            context = stream.codec_context
            in_header = (context.color_primaries, context.color_trc, context.colorspace, context.color_range)
            words = {k.lower(): v for k, v in {**container.metadata, **stream.metadata}.items()}
            assert stream.average_rate == FILM
            frames = list(container.decode(video=0))
        assert in_header == (1, number, 1, 1)
        assert words["timecode"] == "10:11:12:13"
        assert len(frames) == 5
        for frame in frames:  # ProRes keeps its own in each frame
            assert (frame.color_primaries, frame.color_trc, frame.colorspace, frame.color_range) == (1, number, 1, 1)
            assert not frame.interlaced_frame
        assert [frame.time for frame in frames] == pytest.approx([float(i / FILM) for i in range(5)], abs=0.0006)  # Matroska counts ms


@pytest.mark.parametrize("rate", [Fraction(24), Fraction(25), Fraction(30000, 1001), Fraction(60000, 1001), Fraction(25, 2)])
@pytest.mark.parametrize("codec", ["h264", "prores", "ffv1"])
def test_rates_are_exact(tmp_path: Path, codec: str, rate: Fraction) -> None:
    path = made(tmp_path / f"a{movie_suffix(codec)}", [ramp(32, 32)] * 3, codec, rate=rate)
    with av.open(str(path)) as container:
        told = container.streams.video[0].average_rate
    # Matroska holds nanoseconds a frame, which FFmpeg reads back with a numerator of at most 30000.
    assert told == rate if codec != "ffv1" else exact_rate(float(told)) == rate


def test_drop_frame_time_code(tmp_path: Path) -> None:
    path = made(tmp_path / "a.mov", [ramp(32, 32)], "prores", rate=Fraction(30000, 1001), timecode="01:00:00;02")
    with av.open(str(path)) as container:
        assert container.streams.video[0].metadata["timecode"] == "01:00:00;02"
    with pytest.raises((OutputError, PlateError)):
        MovieWriter(tmp_path / "b.mov", size=(32, 32), rate=FILM, codec="prores", timecode="25:00:00")


def test_a_web_movie_starts_at_once_and_quicktime_takes_h265(tmp_path: Path) -> None:
    data = made(tmp_path / "a.mp4", [ramp()] * 2, "h264").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    assert b"hvc1" in made(tmp_path / "b.mp4", [ramp()], "h265").read_bytes()
    assert b"apch" in made(tmp_path / "c.mov", [ramp()], "prores").read_bytes()
    assert b"ap4h" in made(tmp_path / "d.mov", [ramp()], "prores4444").read_bytes()


@EVERY_CODEC
@pytest.mark.parametrize("odd", [(321, 180), (320, 181), (321, 181)])
def test_odd_sizes_are_made_even_at_the_far_edges(tmp_path: Path, codec: str, odd: tuple[int, int]) -> None:
    picture = ramp(*odd)
    with MovieWriter(tmp_path / f"a{movie_suffix(codec)}", size=odd, rate=24, codec=codec) as movie:
        movie.write(picture)
    (got,) = decoded(movie.path)
    h, w = got.shape[:2]
    assert movie.padded == (w - odd[0], h - odd[1])
    assert not any(size % step for size, step in zip((w, h), CODECS[codec].step_px))
    error = np.abs(got[: odd[1], : odd[0]] - picture) * 255
    assert error.max() < RAMP_CODES[codec]
    assert np.abs(got[-1, : odd[0]] - picture[-1]).max() * 255 < RAMP_CODES[codec] + 2


@EVERY_CODEC
def test_the_same_frames_give_the_same_bytes(tmp_path: Path, codec: str) -> None:
    noise = [np.random.default_rng(i).integers(0, 256, (144, 256, 3), dtype=np.uint8) for i in range(6)]
    first, second = (made(tmp_path / f"{n}{movie_suffix(codec)}", noise, codec, timecode="01:00:00:00").read_bytes() for n in "ab")
    assert first == second
    if hasattr(os, "sched_setaffinity"):  # as on a machine with a single core
        cores = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(cores)})
        try:
            assert made(tmp_path / f"c{movie_suffix(codec)}", noise, codec, timecode="01:00:00:00").read_bytes() == first
        finally:
            os.sched_setaffinity(0, cores)


def stopped(path: Path, codec: str, **how: object) -> None:
    """A movie whose second picture never comes."""
    with MovieWriter(path, size=(320, 180), rate=24, codec=codec, **how) as movie:  # type: ignore[arg-type]
        movie.write(ramp())
        raise RuntimeError("half way")


@EVERY_CODEC
def test_nothing_is_left_after_a_failure(tmp_path: Path, codec: str) -> None:
    path = tmp_path / f"a{movie_suffix(codec)}"
    with pytest.raises(RuntimeError, match="half way"):
        stopped(path, codec)
    with pytest.raises(OutputError, match="no frame"), MovieWriter(path, size=(320, 180), rate=24, codec=codec):
        pass
    for wrong, words in (
        (ramp(322, 180), "322 x 180 pixels, but the movie is 320 x 180"),
        (np.full((180, 320, 3), np.nan), "172800 NaN"),
        (np.zeros((180, 320, 3), np.int32), "int32"),
        (np.zeros((180, 320)), "shape"),
    ):
        with pytest.raises(OutputError, match=rf"a\{path.suffix}: frame 1 of the movie .*{words}"):
            made(path, [ramp(), wrong], codec)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("codec", ["h264", "prores", "ffv1"])
def test_a_full_disk_leaves_nothing(tmp_path: Path, codec: str) -> None:
    noise = [np.random.default_rng(i).integers(0, 256, (144, 256, 3), dtype=np.uint8) for i in range(6)]
    path = tmp_path / f"a{movie_suffix(codec)}"
    whole = made(path, noise, codec).stat().st_size
    path.unlink()
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    for limit in (1000, whole // 2, whole - 20):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            with pytest.raises(OutputError, match="too large"):
                made(path, noise, codec)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert list(tmp_path.iterdir()) == []
    signal.signal(signal.SIGXFSZ, handler)


def test_a_movie_is_replaced_only_when_told_and_only_by_a_whole_one(tmp_path: Path) -> None:
    path = made(tmp_path / "a.mp4", [ramp()], "h264")
    first = path.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        made(path, [ramp()], "h264")
    with pytest.raises(RuntimeError, match="half way"):
        stopped(path, "h264", force=True)
    assert path.read_bytes() == first
    made(path, [ramp()] * 2, "h264", force=True)
    assert path.read_bytes() != first
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_what_cannot_be_made_is_refused_before_any_work(tmp_path: Path) -> None:
    for name, codec, words in (
        ("a.mov", "proress", "codec 'proress' is unknown; did you mean 'prores'"),
        ("a.mp4", "prores", r"prores goes into \.mov, not \.mp4; name it a\.mov, or take codec h264 or h265"),
        ("a.avi", "h264", r"not \.avi; name it a\.mp4"),
        ("a", "h264", "without a suffix"),
    ):
        with pytest.raises(OutputError, match=words):
            check_movie(tmp_path / name, codec=codec)
        with pytest.raises(OutputError, match=words):
            MovieWriter(tmp_path / name, size=(32, 32), rate=24, codec=codec)
    with pytest.raises(OutputError, match="256 x 120"):
        MovieWriter(tmp_path / "a.mov", size=(128, 128), rate=24, codec="dnxhr")
    with pytest.raises(OutputError, match=r"Fraction\(24000, 1001\)"):
        MovieWriter(tmp_path / "a.mov", size=(128, 128), rate=23.976, codec="prores")  # type: ignore[arg-type]
    with pytest.raises(OutputError, match="above 0"):
        MovieWriter(tmp_path / "a.mov", size=(128, 128), rate=0, codec="prores")
    with pytest.raises(OutputError, match="did you mean 'sRGB'"):
        MovieWriter(tmp_path / "a.mov", size=(128, 128), rate=24, codec="prores", transfer="srgb ")
    with pytest.raises(OutputError, match="not open"):
        MovieWriter(tmp_path / "a.mov", size=(128, 128), rate=24, codec="prores").write(ramp(128, 128))
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file stands where a folder"), MovieWriter(tmp_path / "file" / "a.mp4", size=(32, 32), rate=24):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_frames_are_asked_for_one_at_a_time_and_let_go(tmp_path: Path) -> None:
    size, given, alive = (128, 72), [], []

    def pictures(count: int) -> Iterator[np.ndarray]:
        for _ in range(count):
            alive.append(sum(picture() is not None for picture in given))
            frame = ramp(*size)
            given.append(weakref.ref(frame))
            yield frame
            del frame

    def peak(count: int) -> int:
        given.clear()
        tracemalloc.start()
        write_movie(tmp_path / "a.mov", pictures(count), rate=FILM, codec="prores", force=True)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    few, many = peak(60), peak(240)
    assert max(alive) <= 1  # the one that was written last
    # And no copy of them is kept. Encoding goes on in threads of its own, so a few frames more or fewer are under way at the peak.
    assert many - few < 0.05 * 180 * ramp(*size).nbytes


@pytest.mark.parametrize("count", [1, 2])
def test_a_still_or_two_make_one_and_the_same_h265_movie(tmp_path: Path, count: int) -> None:
    """x265 itself times the decoding of so few by chance: one movie in fifty was refused, others began late."""
    frames = [ramp(), ramp()[:, ::-1]][:count]
    movies = [made(tmp_path / f"{k}.mp4", frames, "h265") for k in range(15)]
    assert len({movie.read_bytes() for movie in movies}) == 1
    with av.open(os.fspath(movies[0])) as container:
        times = [(packet.dts, packet.pts) for packet in container.demux(video=0) if packet.size]
        stream = container.streams.video[0]
        step = int(1 / FILM / stream.time_base)
    assert sorted(shown for _, shown in times) == [k * step for k in range(count)]
    assert all(decode <= shown for decode, shown in times)
    assert [later[0] - first[0] for first, later in itertools.pairwise(times)] == [step] * (count - 1)
    for got, frame in zip(decoded(movies[0]), frames, strict=True):
        assert np.abs(got - frame).max() * 255 < RAMP_CODES["h265"]


def flat(value: int, w: int = 64, h: int = 36) -> np.ndarray:
    return np.full((h, w, 3), value, np.uint8)


def test_the_wipe_crosses_once_at_one_speed() -> None:
    pictures = list(wiped((flat(10) for _ in range(9)), (flat(200) for _ in range(9)), frames=9))
    shares = [float((picture == 10).mean()) for picture in pictures]
    assert (pictures[0][:, :-1] == 10).all()
    assert (pictures[-1][:, 1:] == 200).all()
    assert np.diff(shares) == pytest.approx(-1 / 8, abs=1 / 64)
    (single,) = wiped([flat(10)], [flat(200)], frames=1)
    assert {10, 200} <= set(np.unique(single))
    with pytest.raises(OutputError, match="either side"):
        list(wiped([flat(1)] * 3, [flat(2)] * 2, frames=3))
    with pytest.raises(PassError, match="one size"):
        list(wiped([flat(1)], [flat(2, 32)], frames=1))


def test_movies_of_a_shot_from_arrays_files_and_functions(tmp_path: Path) -> None:
    stills = [write_still(tmp_path / f"relit.{i}.png", flat(60 + 50 * i)) for i in range(3)]
    asked: list[int] = []

    def depth(i: int) -> np.ndarray:
        asked.append(i)
        return flat(30 * i)

    movies = {
        "relit": stills,
        "depth": [lambda i=i: depth(i) for i in range(3)],
        "wipe": wiped([flat(0)] * 3, stills, frames=3),
        "anaglyph": anaglyphs([flat(90)] * 3, [flat(90)] * 3),
    }
    reports = write_movies(tmp_path / "movies", movies, rate=FILM, codec="prores", timecode="01:00:00:00")
    assert [report.path.name for report in reports] == ["relit.mov", "depth.mov", "wipe.mov", "anaglyph.mov"]
    assert asked == [0, 1, 2]
    assert reports[0].to_dict() == {
        "file": "relit.mov",
        "frames": 3,
        "size": [64, 36],
        "padded": [0, 0],
        "codec": "prores",
        "rate": "24000/1001",
        "timecode": "01:00:00:00",
        "transfer": "sRGB",
    }
    for i, picture in enumerate(decoded(tmp_path / "movies" / "relit.mov")):
        assert np.abs(picture * 255 - (60 + 50 * i)).max() < 0.6
    before = {p: p.read_bytes() for p in (tmp_path / "movies").iterdir()}
    with pytest.raises(OutputError, match=r"depth\.mov: exists already"):
        write_movies(tmp_path / "movies", {"normals": stills, "depth": stills}, rate=FILM, codec="prores")
    assert {p: p.read_bytes() for p in (tmp_path / "movies").iterdir()} == before
    with pytest.raises(OutputError, match="no pictures"):
        write_movie(tmp_path / "none.mp4", [], rate=24)
    with pytest.raises(PlateError, match=r"gone\.png"):
        write_movie(tmp_path / "gone.mp4", [stills[0], tmp_path / "gone.png"], rate=24)
    with pytest.raises(OutputError, match="32 x 36 pixels, but the movie is 64 x 36"):
        write_movie(tmp_path / "two.mp4", [flat(1), flat(1, 32)], rate=24)
    assert not [p for p in tmp_path.iterdir() if p.suffix == ".mp4"]


def test_labels_and_the_sheet() -> None:
    marked = list(labelled([flat(200, 320, 180)] * 2, ["shot 1001", "shot 1002"]))
    assert not np.array_equal(marked[0], marked[1])
    with pytest.raises(OutputError, match="one line of text"):
        list(labelled([flat(1)] * 2, ["one"]))
    assert sheet_places(5) == (0, 1, 2, 3, 4)
    assert sheet_places(300, most=4) == (0, 100, 199, 299)
    asked: list[int] = []

    def picture(i: int) -> np.ndarray:
        asked.append(i)
        return flat(i % 256)

    sheet = shot_sheet([f"{i:04d}" for i in range(100)], [lambda i=i: picture(i) for i in range(100)], most=6, width=64)
    assert len(asked) == 6
    assert (asked[0], asked[-1]) == (0, 99)
    assert sheet.shape[1] == 3 * 70 + 6
