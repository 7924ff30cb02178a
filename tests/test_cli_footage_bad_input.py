"""Bad footage: one line on stderr that names the file, what is there and the remedy, exit code 1, and every good frame before the fault."""

from __future__ import annotations

import json
import re
import shutil
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from stereorelight.footage.colour import encode
from stereorelight.footage.exr import write_exr
from stereorelight.footage.movie.writer import MovieWriter
from stereorelight.interchange.rigs import write_rig
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named
from tests.stereo_files import cut
from tests.test_cli_bad_input import call, refused, snapshot

SIZE, COUNT = (160, 90), 12


def movie(path: Path, frames: list[np.ndarray], *, rate: Fraction = Fraction(24), timecode: str | None = None) -> Path:
    codec = "ffv1" if path.suffix == ".mkv" else "h264"
    with MovieWriter(path, size=(frames[0].shape[1], frames[0].shape[0]), rate=rate, codec=codec, timecode=timecode, force=True) as made:
        for frame in frames:
            made.write(frame)
    return path


@pytest.fixture(scope="module")
def eyes() -> dict[str, np.ndarray]:
    pair = render(scene_named("sphere"), rig_named("parallel", SIZE), samples=1)
    return {eye: encode(np.minimum(pair.frame(eye)["plate"], 0.9), "sRGB") for eye in ("left", "right")}  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory, eyes: dict[str, np.ndarray]) -> Path:
    """A pair of movies of a still scene under fresh grain, and the shot file that names them."""
    folder = tmp_path_factory.mktemp("clean") / "shot"
    folder.mkdir()
    rng = np.random.default_rng(1)
    for eye, picture in eyes.items():
        frames = [np.clip(picture + rng.normal(0, 0.004, picture.shape), 0, 1).astype(np.float32) for _ in range(COUNT)]
        movie(folder / f"{eye}.mkv", frames)
    write_rig(folder / "rig.json", rig_named("parallel", SIZE))
    (folder / "shot.toml").write_text(
        '[plates]\nleft = "left.mkv"\nright = "right.mkv"\n[depth]\nquality = "draft"\n[output]\nname = "film"\npreviews = false\n'
        '[[lights]]\nname = "key"\ntype = "point"\nposition_m = [0.5, 0.5, -0.5]\n'
    )
    return folder


@pytest.fixture
def shot(clean: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(clean, tmp_path / "shot"))


def told(shot: Path, **plates: str) -> Path:
    """The shot file with keys of [plates] changed; values as TOML has them."""
    path = shot / "shot.toml"
    lines = path.read_text().splitlines()
    kept = [line for line in lines if line.split(" = ")[0] not in plates]
    kept[1:1] = [f"{key} = {value}" for key, value in plates.items()]
    path.write_text("\n".join(kept) + "\n")
    return path


def all_refuse(shot: Path, *, words: tuple[str, ...], kind: str = "PlateError", commands: tuple[str, ...] = ("run", "check")) -> None:
    """Every command refuses the shot in the same words, and leaves its folder as it was."""
    before = snapshot(shot)
    for command in commands:
        refused(command, shot / "shot.toml", words=words, kind=kind)
    assert snapshot(shot) == before
    assert not list(shot.rglob("*.part*"))


def stopped(*arguments: object, words: tuple[str, ...], kind: str) -> tuple[str, list[str]]:
    """The one line that a run ends with, and the lines of the frames that were done before it."""
    result = call(*arguments)
    assert result.exit_code == 1, (result.exit_code, result.output, result.exception)
    assert result.stdout == ""
    *done, line = result.stderr.splitlines()
    assert all(re.fullmatch(r"frame \d+: \d+\.\d s", told) for told in done), result.stderr
    assert line.startswith(f"{kind}: "), line
    for word in words:
        assert word in line, line
    return line, done


def damaged(path: Path) -> None:
    """Twenty bytes in the middle are lost, as by a bad sector: the file is as long as it was."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 20] = bytes(20)
    path.write_bytes(bytes(data))


# Movies that are damaged, or none


def test_both_movies_cut_alike(shot: Path) -> None:
    """As long as each other is not whole: neither `run` nor `check` takes what is left for the shot."""
    for eye in ("left", "right"):
        cut(shot / f"{eye}.mkv", 0.6)
    sizes = {eye: (shot / f"{eye}.mkv").stat().st_size for eye in ("left", "right")}
    assert min(sizes.values()) > 0
    for command in ("run", "check"):
        refused(command, shot / "shot.toml", words=("the file is cut short", "missing after frame", "--frames 1-"), kind="PlateError")
    assert not (shot / "out").exists()


@pytest.mark.parametrize("eye", ["left", "right"])
def test_a_movie_cut_short(shot: Path, eye: str) -> None:
    """Both eyes would have to be as long: the frames that would do are named, and with them everything runs."""
    cut(shot / f"{eye}.mkv", 0.6)
    line = refused("run", shot / "shot.toml", words=(f"{eye}.mkv: the file is cut short", "--frames 1-"), kind="PlateError")
    good = line.rpartition("--frames ")[2].split(",")[0].split(" ")[0].rstrip(".")
    assert not (shot / "out").exists()
    result = call("run", shot / "shot.toml", "--frames", good)
    last = int(good.split("-")[1])
    made = sorted(p.name for p in (shot / "out" / "relit").iterdir())
    assert 4 <= len(made) <= last
    if result.exit_code:  # the last one that the file tells of may be cut within
        assert f"{eye}.mkv" in result.stderr
        assert "cut short" in result.stderr
        assert len(result.stderr.splitlines()) == 1
        assert len(made) >= last - 2


def test_every_frame_before_the_damage_is_kept(shot: Path) -> None:
    """Twenty bytes in the middle of the right movie: what comes before is done, and stands when the run is repeated."""
    damaged(shot / "right.mkv")
    line, done = stopped("run", shot / "shot.toml", words=("right.mkv: frame ", "do not fit their checksum", "before it are good"), kind="PlateError")
    bad = int(line.partition("right.mkv: frame ")[2].split()[0])
    assert f"frames 1-{bad - 1} before it are good" in line  # by the shot's own count, which begins with 1
    assert 5 <= bad < COUNT
    assert len(done) == bad - 1
    relit = shot / "out" / "relit"
    assert sorted(p.name for p in relit.iterdir()) == [f"film.{n:04d}.exr" for n in range(1, bad)]
    assert not list(shot.rglob("*.part*"))
    before = snapshot(relit)
    again, _ = stopped("run", shot / "shot.toml", words=(), kind="PlateError")
    assert again == line
    assert snapshot(relit) == before
    assert call("run", shot / "shot.toml", "--frames", f"{bad + 1}-{COUNT}").exit_code == 0  # one frame is lost, no more


def test_a_check_of_a_damaged_movie_tells_of_it_and_of_the_rest(shot: Path) -> None:
    damaged(shot / "right.mkv")
    result = call("check", shot / "shot.toml", "--json", "--fail-on", "bad")
    assert result.exit_code == 1, result.stderr
    findings = {one["name"]: one for one in json.loads(result.stdout)["findings"]}
    told = findings["unreadable_frames"]
    assert told["level"] == "bad"
    assert told["value"] == 1
    assert f"1 of {COUNT} frames cannot be read: " in told["words"]
    assert "right.mkv: frame " in told["words"]
    assert findings["vertical"]["level"] == "good"


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda p: p.unlink(), ("there is no such file", ".mkv")),
        (lambda p: p.write_bytes(b""), ("empty",)),
        (lambda p: p.write_text("hello"), ("is no movie that can be read",)),
        (lambda p: cut(p, 0.001), ("movie",)),
    ],
    ids=["missing", "empty", "text", "head only"],
)
@pytest.mark.parametrize("eye", ["left", "right"])
def test_a_movie_that_is_none(shot: Path, eye: str, damage: object, words: tuple[str, ...]) -> None:
    damage(shot / f"{eye}.mkv")  # type: ignore[operator]
    all_refuse(shot, words=(f"{eye}.mkv", *words))


def test_a_movie_without_pictures(shot: Path) -> None:
    with av.open(str(shot / "right.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=48000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 2 * 4800), np.int16), format="s16", layout="stereo")
        frame.sample_rate = 48000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    all_refuse(shot, words=("right.mkv", "no video stream", "audio"))


def test_a_movie_with_a_stream_that_is_no_picture(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    """Sound and data beside the pictures are nobody's trouble."""
    with av.open(str(shot / "right.mkv")) as source, av.open(str(shot / "sound.mkv"), "w") as container:
        video = container.add_stream_from_template(source.streams.video[0])
        sound = container.add_stream("pcm_s16le", rate=48000)
        for packet in source.demux(source.streams.video[0]):
            if packet.dts is not None:
                packet.stream = video
                container.mux(packet)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 2 * 4800), np.int16), format="s16", layout="stereo")
        frame.sample_rate, frame.pts = 48000, 0
        container.mux(sound.encode(frame))
        container.mux(sound.encode(None))
    told(shot, right='"sound.mkv"')
    assert call("run", shot / "shot.toml", "--frames", "1-1").exit_code == 0


def test_a_movie_in_a_curve_that_must_be_named(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    with av.open(str(shot / "right.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=24)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.codec_context.color_trc = 16  # PQ
        for number in range(COUNT):
            frame = av.VideoFrame(*SIZE, "yuv420p")
            for plane in frame.planes:
                np.frombuffer(plane, np.uint8)[:] = 120
            frame.pts, frame.color_trc = number, 16
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    refused("run", shot / "shot.toml", words=("right.mkv", "smpte2084", "colour_space"), kind="ShotError")


def test_a_recording_that_was_stopped_before_its_index(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    """A camera writes the index of an .mp4 last: without it nothing can be had, and the line says what is missing."""
    with av.open(str(movie(shot / "whole.mp4", [eyes["right"]] * 3))) as source, av.open(str(shot / "late.mp4"), "w") as container:
        video = container.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(source.streams.video[0]):
            if packet.dts is not None:
                packet.stream = video
                container.mux(packet)
    data = (shot / "late.mp4").read_bytes()
    (shot / "late.mp4").write_bytes(data[: data.index(b"moov") - 4])
    told(shot, right='"late.mp4"')
    all_refuse(shot, words=("late.mp4", "its index (moov) is missing", "stopped before its end", "copy or export it again"))


def test_relighting_a_movie_that_is_shorter_than_its_passes(shot: Path) -> None:
    """What is there can be relit by saying so; a part of the shot is never taken for the whole in silence."""
    for number in range(1, 5):
        write_exr(shot / f"passes.{number:04d}.exr", render_passes())
    (shot / "lights.toml").write_text('[[lights]]\nname = "key"\ntype = "point"\nposition_m = [0.5, 0.5, -0.5]\n')
    with MovieWriter(shot / "short.mkv", size=SIZE, rate=Fraction(24), codec="ffv1") as made:
        for _ in range(3):
            made.write(np.full((SIZE[1], SIZE[0], 3), 0.5, np.float32))
    asked = ("relight", shot / "short.mkv", shot / "passes.####.exr", "--lights", shot / "lights.toml", "--out", shot / "lit.####.exr")
    refused(*asked, words=("short.mkv: has frames 1-3", "passes 1-4", "--frames 1-3"), kind="PlateError")
    assert not list(shot.glob("lit*"))
    assert call(*asked, "--frames", "1-3").exit_code == 0
    assert len(list(shot.glob("lit*"))) == 3


def render_passes() -> dict[str, np.ndarray]:
    h, w = SIZE[1], SIZE[0]
    flat = {"P.X": 0.0, "P.Y": 0.0, "P.Z": -2.0, "N.X": 0.0, "N.Y": 0.0, "N.Z": 1.0}
    return {name: np.full((h, w), value, np.float32) for name, value in flat.items()}


# A missing view, and files that hold one eye


def test_a_missing_view(shot: Path) -> None:
    plate = np.full((SIZE[1], SIZE[0]), 0.2, np.float32)
    write_exr(shot / "one.exr", dict.fromkeys("RGB", plate), view="left")
    told(shot, left='"one.exr"', right='"one.exr"')
    all_refuse(shot, words=("one.exr", "no view 'right'"))
    write_exr(shot / "one.exr", dict.fromkeys("RGB", plate), force=True)
    all_refuse(shot, words=("one.exr", "has one view", "name the right plate"))


def test_one_movie_for_both_eyes_that_holds_one(shot: Path) -> None:
    path = shot / "shot.toml"
    path.write_text(path.read_text().replace('right = "right.mkv"\n', ""))
    all_refuse(shot, words=("left.mkv", "one video track", 'layout = "side-by-side"'))
    refused(
        "depth", shot / "left.mkv", "--rig", shot / "rig.json", "--out", shot / "z.####.exr", words=("left.mkv", "side-by-side"), kind="PlateError"
    )


def test_a_layout_that_does_not_halve(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    from stereorelight.footage.stills import write_still

    write_still(shot / "odd.png", np.full((90, 321, 3), 0.5, np.float32))
    arguments = ("depth", shot / "odd.png", "--layout", "side-by-side", "--rig", shot / "rig.json", "--out", shot / "z.exr")
    refused(*arguments, words=("odd.png", "321 pixels wide", "side-by-side"), kind="PlateError")
    refused(*arguments[:2], "--layout", "side-by-sied", *arguments[4:], words=("'side-by-sied'", "'side-by-side'"), kind="ShotError")
    refused("depth", shot / "left.mkv", shot / "right.mkv", "--sync", "tc", *arguments[4:], words=("sync 'tc' is unknown",), kind="ShotError")


# What differs between the eyes


def test_frame_counts_that_differ(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    movie(shot / "right.mkv", [eyes["right"]] * 3)
    all_refuse(shot, words=("right.mkv: holds 3 frames", "left.mkv 12", "--frames 1-3"))
    refused("run", shot / "shot.toml", "--frames", "2-5", words=("right.mkv: has no frame 4", "it has 1-3", "--frames 2-3"), kind="PlateError")


def test_sizes_that_differ(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    movie(shot / "right.mkv", [np.ascontiguousarray(eyes["right"][:80])] * COUNT)
    words = ("right.mkv frame 1: is 160 x 80 pixels", "right camera is 160 x 90")
    refused("run", shot / "shot.toml", words=words, kind="PlateError")
    refused("check", shot / "shot.toml", words=words, kind="PlateError")
    line = refused(
        "check", shot / "left.mkv", shot / "right.mkv", words=("right.mkv frame 1: is 160 x 80", "left.mkv frame 1 is 160 x 90"), kind="PlateError"
    )
    assert "export both eyes at one size" in line


def test_rates_that_differ(shot: Path, eyes: dict[str, np.ndarray]) -> None:
    movie(shot / "right.mkv", [eyes["right"]] * COUNT, rate=Fraction(25))
    all_refuse(shot, words=("right.mkv: runs at 25 frames a second", "left.mkv at 24", "conform"))


def test_time_code_that_is_wanted_and_missing(shot: Path) -> None:
    told(shot, sync='"timecode"')
    all_refuse(shot, words=("left.mkv: carries no time code", 'sync = "frames"', "right_late_frames"))


def test_an_eye_that_is_too_late(shot: Path) -> None:
    told(shot, right_late_frames="40")
    all_refuse(shot, words=("right.mkv: shares no frame with the left eye", "left has 1-12"))


# Colour


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("colour_space", '"S-Log33"', ("shot.toml:", "S-Log33", "S-Log3")),
        ("right_colour_space", '"AcesCGG"', ("shot.toml:", "AcesCGG", "ACEScg")),
        ("matrix", '"bt2021"', ("shot.toml:", "'bt2021'", "'bt2020'")),
        ("levels", '"ful"', ("shot.toml:", "'ful'", "'full'")),
        ("sync", '"timecod"', ("shot.toml:", "'timecod'", "'timecode'")),
        ("layout", '"side-by-side-haf"', ("shot.toml:", "side-by-side-half")),
        ("match_colour", '"globl"', ("shot.toml:", "'globl'", "'global'")),
        ("rate", "0.0", ("shot.toml:", "rate")),
        ("right_late_frames", '"two"', ("shot.toml:", "right_late_frames")),
    ],
)
def test_keys_with_a_slip(shot: Path, key: str, value: str, words: tuple[str, ...]) -> None:
    told(shot, **{key: value})
    all_refuse(shot, words=words, kind="ShotError")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('working = "ACESgc"', ("shot.toml:", "ACESgc")),
        ('working = "sRGB"', ("shot.toml:", "sRGB", "linear")),
        ('config = "gone.ocio"', ("gone.ocio", "there is no such file", "config")),
        ('config = "broken.ocio"', ("shot.toml:", "broken.ocio", "OpenColorIO cannot read this config", "line 3", "mend the file")),
        ('config = "poor.ocio"', ("shot.toml:", "working space 'linear Rec.709' is unknown in ", "poor.ocio", "known: lin")),
        ('config = "poor.ocio"\nworking = "lin"', ("poor.ocio", "aces_interchange", "colour_space")),
        ('display = "sRBG - Display"', ("shot.toml:", "sRBG")),
        ('dispaly = "x"', ("shot.toml:", "'dispaly'", "'display'")),
    ],
)
def test_colour_that_cannot_be(shot: Path, table: str, words: tuple[str, ...]) -> None:
    (shot / "broken.ocio").write_text("ocio_profile_version: 2\ncolorspaces: [broken\n")
    (shot / "poor.ocio").write_text(
        "ocio_profile_version: 2\nroles: {default: raw, scene_linear: lin}\ndisplays: {sRGB: [!<View> {name: Raw, colorspace: raw}]}\n"
        "colorspaces:\n  - !<ColorSpace> {name: raw, isdata: true}\n  - !<ColorSpace> {name: lin}\n"
    )
    path = shot / "shot.toml"
    path.write_text(path.read_text() + f"[colour]\n{table}\n")
    all_refuse(shot, words=words, kind="ShotError")


def test_movies_that_cannot_be_asked_for(shot: Path) -> None:
    path = shot / "shot.toml"
    text = path.read_text()
    for old, new, words in (
        ("previews = false", 'movies = ["relt"]', ("shot.toml:", "'relt'", "'relit'")),
        ("previews = false", 'movie_codec = "h263"', ("shot.toml:", "'h263'")),
        ("[depth]", '[rig]\ndrift = "on"\n[depth]', ("shot.toml:", "rig.drift", "'on'")),
        ("[depth]", "[rig]\ndrift_window = 0\n[depth]", ("shot.toml:", "drift_window")),
    ):
        path.write_text(text.replace(old, new))
        all_refuse(shot, words=words, kind="ShotError")


def test_a_disk_that_is_full_at_the_movie(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno
    import os

    from stereorelight import files

    path = shot / "shot.toml"
    path.write_text(path.read_text().replace("previews = false", 'movies = ["plate"]').replace("[depth]", 'frames = "1-2"\n[depth]', 1))
    real = os.replace

    def fills_up(source: Path, target: Path) -> None:
        if Path(target).parent.name == "movies":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "replace", fills_up)
        _, done = stopped("run", path, words=("/film.plate.mp4: the disk is full",), kind="OutputError")
        assert len(done) == 2
    assert not list(shot.rglob("*.part*"))
    assert call("run", path).exit_code == 0
    assert (shot / "out" / "movies" / "film.plate.mp4").exists()
