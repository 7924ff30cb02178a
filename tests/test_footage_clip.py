"""However one eye's pictures are stored, the same plates come out, with names, time code and digests that can be relied on."""

from __future__ import annotations

import pickle
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.clip import Clip, close_movies, open_clip, part_of
from stereorelight.footage.colour import ColourSettings, encode, from_working, to_working
from stereorelight.footage.exr import write_exr
from stereorelight.footage.stills import write_still
from tests.stereo_files import FRAMES, H, W, above, beside, cut, exr, movie, picture, pictures, rgb_movie
from tests.test_footage_dpx import dpx_bytes

FFV1 = 1.5 / 3504  # 12 bit of video range, through the matrix: half a step of each of Y, Cb, Cr
EIGHT_BIT = 3 / 219
CROSSED = 2**-16


def shown(clip: Clip, frame: int | None = None) -> np.ndarray:
    """A plate as the sRGB picture that it was made from."""
    return encode(clip.read(frame), "sRGB")


def same(clip: Clip, frames: list[np.ndarray], within: float) -> None:
    for number, frame in zip(clip.frames, frames, strict=True):
        np.testing.assert_allclose(shown(clip, number), frame, atol=within)


@pytest.mark.parametrize(
    ("name", "codec", "mean", "most"), [("a.mkv", "ffv1", 2e-4, FFV1), ("a.mov", "prores", 1e-3, 0.03), ("a.mp4", "h264", 6e-3, 0.06)]
)
def test_a_movie_is_its_pictures(tmp_path: Path, name: str, codec: str, mean: float, most: float) -> None:
    frames = pictures("left")
    clip = open_clip(movie(tmp_path / name, frames, codec=codec))
    assert (clip.is_movie, clip.is_single) == (True, False)
    assert clip.frames == (1, 2, 3, 4, 5)
    assert clip.rate == 24
    for number in (3, 1, 5, 2, 4, 4):
        apart = np.abs(shown(clip, number) - frames[number - 1])
        assert apart.mean() < mean
        assert apart.max() < most


def test_planes_of_rgb_are_read_to_the_last_bit_that_they_have(tmp_path: Path) -> None:
    frames = pictures("left")
    clip = open_clip(rgb_movie(tmp_path / "a.mkv", [frames]), colour_space="sRGB")
    same(clip, frames, CROSSED)


@pytest.mark.parametrize("space", ["S-Log3", "ARRI LogC3", "V-Log"])
def test_a_log_movie_of_ten_bits_is_light(tmp_path: Path, space: str) -> None:
    """18 % grey and its neighbours, coded by OpenColorIO, written as ten bits, and read by the movie's own table."""
    light = np.repeat(np.geomspace(0.02, 4.0, W, dtype=np.float32)[None, :, None], H, axis=0) * np.array([1.0, 0.9, 1.1], np.float32)
    coded = from_working(light, space, ColourSettings())
    clip = open_clip(rgb_movie(tmp_path / "log.mkv", [[coded]], bits=10), colour_space=space)
    read = clip.read(1)
    step = np.abs(to_working(coded + 0.5 / 1023, space) - to_working(coded - 0.5 / 1023, space)).max(axis=-1, keepdims=True)
    assert (np.abs(read - light) <= 1.5 * step + 1e-5).all()
    assert np.abs(np.log2(read / light)).max() < 0.03


def test_the_working_space_is_obeyed(tmp_path: Path) -> None:
    path = movie(tmp_path / "a.mkv", pictures("left", 1))
    acescg = ColourSettings(working="ACEScg")
    plain, wide = open_clip(path).read(1), open_clip(path).read(1, colour=acescg)
    assert np.abs(plain - wide).max() > 0.02
    np.testing.assert_allclose(encode(to_working(wide, "ACEScg"), "sRGB"), encode(plain, "sRGB"), atol=1e-4)


def test_a_sequence_a_picture_and_a_view(tmp_path: Path) -> None:
    frames = pictures("left", 3)
    for number, frame in enumerate(frames, start=1001):
        write_still(tmp_path / f"a.{number}.png", frame, bits=16)
    clip = open_clip(tmp_path / "a.####.png")
    assert clip.frames == (1001, 1002, 1003)
    same(clip, frames, 2 / 65535)
    single = open_clip(tmp_path / "a.1002.png")
    assert (single.is_single, single.frames) == (True, ())
    np.testing.assert_array_equal(single.read(), clip.read(1002))
    plate = clip.read(1001)
    both = exr(tmp_path / "both.exr", {"left": plate, "right": 2 * plate})
    np.testing.assert_array_equal(open_clip(both, eye="right", view="right").read(), 2 * plate)
    with pytest.raises(PlateError, match=r"both\.exr.*middle"):
        open_clip(both, view="middle").read()


def test_a_dpx_sequence(tmp_path: Path) -> None:
    frames = pictures("left", 2)
    for number, frame in enumerate(frames, start=7):
        codes = np.rint(frame.astype(np.float64) * 1023).astype(np.uint16)
        (tmp_path / f"a.{number:04d}.dpx").write_bytes(dpx_bytes(codes, bits=10))
    clip = open_clip(tmp_path / "a.####.dpx", colour_space="sRGB")
    same(clip, frames, 0.5 / 1023 + 1e-4)


@pytest.mark.parametrize("eye", ["left", "right"])
@pytest.mark.parametrize("layout", ["side-by-side", "top-bottom"])
def test_a_packed_movie_is_each_eye(tmp_path: Path, layout: str, eye: str) -> None:
    left, right = pictures("left"), pictures("right")
    packed = beside(left, right) if layout == "side-by-side" else above(left, right)
    clip = open_clip(movie(tmp_path / "a.mkv", packed), eye=eye, layout=layout)  # type: ignore[arg-type]
    same(clip, left if eye == "left" else right, FFV1)
    write_still(tmp_path / "a.png", packed[0], bits=16)
    still = open_clip(tmp_path / "a.png", eye=eye, layout=layout)  # type: ignore[arg-type]
    np.testing.assert_allclose(shown(still), picture(eye), atol=2 / 65535)


@pytest.mark.parametrize("layout", ["side-by-side-half", "top-bottom-half"])
def test_a_squeezed_picture_is_stretched_about_its_edges(layout: str) -> None:
    """A picture that is a function of place, not of pixels, squeezed and stretched is where it was: half a pixel off would show."""
    across = layout.startswith("side-by-side")
    squeezed = (W // 2, H) if across else (W, H // 2)
    eyes = [picture(eye, size=squeezed) for eye in ("left", "right")]
    packed = np.ascontiguousarray(np.concatenate(eyes, axis=1 if across else 0))
    assert packed.shape == (H, W, 3)
    for eye in ("left", "right"):
        whole = picture(eye)
        found = part_of(packed, eye, layout, "a")  # type: ignore[arg-type]
        assert found.shape == whole.shape
        slope = np.abs(np.diff(whole, axis=1 if across else 0)).max()  # one pixel off
        inside = (slice(None), slice(4, -4)) if across else (slice(4, -4), slice(None))
        assert np.abs(found - whole)[inside].max() < 0.02 * slope
        assert np.abs(found - whole).max() < 0.6 * slope  # at the very edge the cubic has nothing beyond it
        np.testing.assert_allclose(found.mean(axis=(0, 1)), whole.mean(axis=(0, 1)), atol=2e-3)


def test_what_cannot_be_halved(tmp_path: Path) -> None:
    write_still(tmp_path / "odd.png", np.full((32, 33, 3), 0.5, np.float32))
    with pytest.raises(PlateError, match=r"odd\.png, left half: is 33 pixels wide, which cannot be halved for side-by-side"):
        open_clip(tmp_path / "odd.png", layout="side-by-side").read()
    with pytest.raises(PlateError, match=r"33 pixels high.*top-bottom"):
        part_of(np.zeros((33, 32, 3), np.float32), "right", "top-bottom", "a.png")
    with pytest.raises(ShotError, match=r"layout 'side-by-sid' is unknown.*'side-by-side'"):
        open_clip(tmp_path / "odd.png", layout="side-by-sid")


def test_names_say_file_frame_track_and_half(tmp_path: Path) -> None:
    both = [pictures("left", 2), pictures("right", 2)]
    path = rgb_movie(tmp_path / "a.mkv", both)
    assert open_clip(path, eye="right", track=1).name(2) == f"{path} frame 2, track 1"
    assert open_clip(path, eye="right", layout="top-bottom").name(1) == f"{path} frame 1, right half"
    with pytest.raises(PlateError, match=r"a\.mkv: has 2 video tracks, no track 2"):
        open_clip(path, track=2)
    with pytest.raises(PlateError, match=r"a\.mkv: has no frame 9; it has 1-2"):
        open_clip(path).read(9)
    with pytest.raises(PlateError, match=r"a\.mkv: has no frame 0; it has 1-2"):
        open_clip(path).read(0)
    with pytest.raises(PlateError, match=r"gone\.mov"):
        open_clip(tmp_path / "gone.mov")


def test_frames_are_counted_from_where_the_shot_says(tmp_path: Path) -> None:
    frames = pictures("left", 3)
    clip = open_clip(movie(tmp_path / "a.mkv", frames, timecode="01:00:00:22"), first_frame=1001)
    assert clip.frames == (1001, 1002, 1003)
    same(clip, frames, FFV1)
    assert [clip.timecode(n) for n in clip.frames] == ["01:00:00:22", "01:00:00:23", "01:00:01:00"]


@pytest.mark.parametrize(("name", "codec"), [("a.mkv", "ffv1"), ("a.mov", "prores"), ("a.mp4", "h264"), ("a.mkv", "h264")])
def test_time_code_is_read_from_every_container(tmp_path: Path, name: str, codec: str) -> None:
    clip = open_clip(movie(tmp_path / name, pictures("left", 2), codec=codec, timecode="10:11:12:13"))
    assert clip.start_timecode == "10:11:12:13"
    assert clip.timecode(2) == "10:11:12:14"
    assert open_clip(movie(tmp_path / f"without_{name}", pictures("left", 2), codec=codec)).timecode(1) is None


def test_time_code_rate_and_words_of_a_sequence(tmp_path: Path) -> None:
    plate = pictures("left", 1)[0]
    channels = {c: plate[..., k] for k, c in enumerate("RGB")}
    words = {"camera": "B", "reel": "A003", "software": "a grader", "colorInteropID": "lin_ap1_scene", "stereorelight/eye": "right"}
    write_exr(tmp_path / "a.1001.exr", channels, metadata=words, attributes={"timeCode": "01:00:00:05", "framesPerSecond": Fraction(24000, 1001)})
    clip = open_clip(tmp_path / "a.####.exr")
    assert clip.rate == Fraction(24000, 1001)
    assert clip.timecode(1001) == "01:00:00:05"
    assert clip.source_words(1001) == {"camera": "B", "reel": "A003"}


def test_a_clip_goes_to_other_processes(tmp_path: Path) -> None:
    clip = open_clip(movie(tmp_path / "a.mkv", pictures("left")), colour_space="sRGB")
    before = clip.read(3)
    again = pickle.loads(pickle.dumps(clip))
    assert again == clip
    np.testing.assert_array_equal(again.read(3), before)


def test_a_movie_that_is_replaced_is_read_anew(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    clip = open_clip(movie(path, pictures("left", 2)))
    assert np.abs(shown(clip, 1) - picture("left")).max() < FFV1
    path.unlink()
    movie(path, pictures("right", 2))
    assert np.abs(shown(clip, 1) - picture("right")).max() < FFV1


def test_a_digest_follows_file_place_and_part_and_nothing_else(tmp_path: Path) -> None:
    path = movie(tmp_path / "a.mkv", beside(pictures("left"), pictures("right")))
    plain = open_clip(path)
    kinds = [
        plain.digest(1),
        plain.digest(2),
        open_clip(path, layout="side-by-side").digest(1),
        open_clip(path, eye="right", layout="side-by-side").digest(1),
        open_clip(path, layout="side-by-side-half").digest(1),
        open_clip(path, matrix="bt601").digest(1),
        open_clip(path, levels="full").digest(1),
    ]
    assert len(set(kinds)) == len(kinds)
    assert open_clip(path, first_frame=1001).digest(1001) == plain.digest(1)  # the number is not the picture
    assert open_clip(path, eye="right").digest(1) == plain.digest(1)
    moved = path.rename(tmp_path / "b.mkv")
    assert open_clip(moved).digest(1) == kinds[0]
    for k, name in enumerate(("c.png", "d.png")):
        write_still(tmp_path / name, picture("left", k))
    a, b = (open_clip(tmp_path / name).digest() for name in ("c.png", "d.png"))
    assert a != b
    assert open_clip(tmp_path / "c.png", layout="side-by-side").digest() != a
    data = bytearray(moved.read_bytes())
    data[-9] ^= 1
    moved.write_bytes(bytes(data))
    assert open_clip(moved).digest(1) != kinds[0]


@pytest.mark.parametrize(("name", "codec"), [("a.mkv", "ffv1"), ("a.mp4", "h264")])
def test_a_movie_cut_short_gives_every_frame_before_the_cut(tmp_path: Path, name: str, codec: str) -> None:
    rng = np.random.default_rng(3)
    frames = [np.clip(picture("left", k, size=(160, 90)) + rng.normal(0, 0.03, (90, 160, 3)), 0, 1).astype(np.float32) for k in range(24)]
    whole = open_clip(movie(tmp_path / f"whole_{name}", frames, codec=codec))
    clip = open_clip(cut(movie(tmp_path / name, frames, codec=codec), 0.6))
    good, why = [], ""
    for number in clip.frames:
        try:
            np.testing.assert_array_equal(clip.read(number), whole.read(number))
        except PlateError as error:
            why = str(error)
            break
        good.append(number)
    assert not why or (name in why and "cut short" in why)
    assert 8 <= len(good) < 24
    assert good == list(range(1, len(good) + 1))
    close_movies()


def test_every_frame_count(tmp_path: Path) -> None:
    assert len(open_clip(movie(tmp_path / "one.mkv", pictures("left", 1))).frames) == 1
    assert len(open_clip(movie(tmp_path / "many.mkv", pictures("left"))).frames) == FRAMES
