"""A shot of movies from plates to relit pictures: what travels along, what is mended, what is written again and what is not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stereorelight.calibration.drift import Drift, apply
from stereorelight.camera import Rig
from stereorelight.errors import OutputError, PlateError, ShotError
from stereorelight.footage.clip import open_clip
from stereorelight.footage.colour import encode
from stereorelight.footage.exr import read_exr
from stereorelight.footage.frames import read_frame
from stereorelight.interchange.rigs import write_rig
from stereorelight.shot.frame import Event
from stereorelight.shot.run import RunSummary, run_shot
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named
from tests.made_once import made_once
from tests.stereo_files import rgb_movie

SIZE, COUNT, FIRST = (320, 180), 4, 1001
NTSC = Fraction(24000, 1001)
NUMBERS = tuple(range(FIRST, FIRST + COUNT))
CAST = np.array([1.15 * 1.12, 1.15, 1.15 * 0.97], np.float32)
WRONG = Drift(pitch_deg=0, yaw_deg=0, roll_deg=0.5, zoom=1.004, rise_deg=0, forward_deg=0, sigmas={})
ALL_MOVIES = ("relit", "wipe", "plate", "depth", "normals", "anaglyph")
REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)


@dataclass(frozen=True)
class Filmed:
    """A scene in motion, in memory, and as a movie an eye."""

    folder: Path
    rig: Rig
    plates: Mapping[str, Sequence[np.ndarray]]
    truth: Sequence[np.ndarray]


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    return made_once(tmp_path_factory, "filmed", _filmed)


def _filmed(folder: Path) -> Filmed:
    rig = rig_named("parallel", SIZE)
    shots = [render(scene_named("sphere", frame=k, motion=True), rig, samples=2, frame=k) for k in range(COUNT)]
    plates = {eye: [np.minimum(0.6 * s.frame(eye)["plate"], 0.7) for s in shots] for eye in ("left", "right")}  # type: ignore[arg-type]
    plates["cast"] = [plate * CAST for plate in plates["right"]]
    words = {"timecode": "01:00:00:22", "REEL": "A003", "CAMERA": "B cam"}
    for eye, frames in plates.items():
        assert max(frame.max() for frame in frames) < 1
        rgb_movie(folder / f"{eye}.mkv", [[encode(frame, "sRGB") for frame in frames]], words=words, rate=NTSC)
    write_rig(folder / "rig.json", rig)
    write_rig(folder / "stale.json", apply(rig, WRONG))
    return Filmed(folder=folder, rig=rig, plates=plates, truth=[s.left["Z"] for s in shots])


def shot_file(folder: Path, filmed: Filmed, **tables: Mapping[str, Any]) -> Path:
    """A shot file whose plates are the filmed ones; `tables` change or add keys."""
    told: dict[str, dict[str, Any]] = {
        "plates": {"left": str(filmed.folder / "left.mkv"), "right": str(filmed.folder / "right.mkv"), "first_frame": FIRST, "colour_space": "sRGB"},
        "rig": {"file": str(filmed.folder / "rig.json")},
        "depth": {"quality": "draft"},
        "relight": {"plate_gain": 0.4},
        "output": {"name": "film"},
    }
    for name, table in tables.items():
        told.setdefault(name, {}).update(table)
    lines = ["version = 1"]
    for name, table in told.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    lines += ["[[lights]]", 'name = "key"', 'type = "point"', "position_m = [0.6, 0.4, -0.7]", "intensity = 2.0"]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "shot.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Every result by name; receipts hold seconds, and are left out."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix != ".json"}


def times(folder: Path) -> dict[str, int]:
    return {p.relative_to(folder).as_posix(): p.stat().st_mtime_ns for p in sorted(folder.rglob("*")) if p.is_file()}


def receipt(out: Path, number: int = FIRST) -> dict[str, Any]:
    return dict(json.loads((out / "receipts" / f"film.{number}.json").read_text()))


def error_of(out: Path, filmed: Filmed) -> float:
    """Median relative error of Z over the shot, against truth."""
    found = [read_frame(out / "depth" / f"film.{n}.exr")["Z"] for n in NUMBERS]
    return float(np.nanmedian([np.abs(Z / true - 1) for Z, true in zip(found, filmed.truth)]))


@pytest.fixture(scope="module")
def ran(filmed: Filmed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shot as it should be, run once with every movie; tests copy it."""
    folder = tmp_path_factory.mktemp("ran") / "shot"
    run_shot(shot_file(folder, filmed, output={"movies": list(ALL_MOVIES), "movie_codec": "h264"}))
    return folder


@pytest.fixture
def shot(ran: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(ran, tmp_path / "shot"))


# What travels along


@pytest.mark.parametrize("kind", ["depth", "passes", "relit"])
def test_time_code_rate_and_space_go_with_every_result(ran: Path, kind: str) -> None:
    for k, number in enumerate(NUMBERS):
        header = read_exr(ran / "out" / kind / f"film.{number}.exr")[0]
        assert header.attributes["timeCode"] == f"01:00:0{(22 + k) // 24}:{(22 + k) % 24:02d}"
        assert header.attributes["framesPerSecond"] == NTSC
        np.testing.assert_allclose(header.attributes["chromaticities"], REC709, atol=1e-5)
    frame = read_frame(ran / "out" / kind / f"film.{FIRST}.exr")
    assert (frame.number, frame.metadata["timecode"], Fraction(frame.metadata["rate"])) == (FIRST, "01:00:00:22", NTSC)


def test_the_source_speaks_in_the_relit_picture(ran: Path) -> None:
    words = {k.lower(): v for k, v in read_frame(ran / "out" / "relit" / f"film.{FIRST}.exr").metadata.items()}
    assert (words["reel"], words["camera"]) == ("A003", "B cam")
    assert words["step"] == "relight"
    assert not {"duration", "encoder"} & set(words)


def test_depth_is_near_the_truth(ran: Path, filmed: Filmed) -> None:
    assert error_of(ran / "out", filmed) < 0.01


def test_the_receipt_names_the_place_in_the_movie(ran: Path) -> None:
    told = receipt(ran / "out", FIRST + 2)
    assert told["inputs"]["left"]["frame"] == told["inputs"]["right"]["frame"] == FIRST + 2
    assert told["inputs"]["left"]["file"].endswith("left.mkv")
    assert len({receipt(ran / "out", n)["inputs"]["left"]["sha256"] for n in NUMBERS}) == COUNT
    assert told["rig_mended"] is None


def test_another_working_space_changes_the_header_and_not_the_look(ran: Path, filmed: Filmed, tmp_path: Path) -> None:
    """Under a white light everything is linear: in other primaries the same picture."""
    path = shot_file(tmp_path, filmed, colour={"working": "ACEScg"}, output={"previews": False})
    run_shot(path, frames=str(FIRST))
    name = f"relit/film.{FIRST}.exr"
    wide = read_exr(tmp_path / "out" / name)[0]
    np.testing.assert_allclose(wide.attributes["chromaticities"][:6], (0.713, 0.293, 0.165, 0.83, 0.128, 0.044), atol=1e-4)
    assert np.abs(wide.channels["R"] - read_exr(ran / "out" / name)[0].channels["R"]).max() > 0.01
    plain, back = (read_frame(folder / "out" / name)["beauty"] for folder in (ran, tmp_path))
    apart = (np.abs(back - plain) / (plain.mean() + plain)).max(axis=-1)
    # The matcher sees another grey, which moves a normal here and there; where surfaces are the same, so is the picture.
    one, other = (read_frame(next((folder / "out" / "passes").glob(f"*{FIRST}.exr"))) for folder in (ran, tmp_path))
    turned = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(one["N"] - other["N"], axis=-1) / 2, 0, 1)))
    same = (np.abs(one["Z"] / other["Z"] - 1) < 0.002) & (turned < 0.25)
    assert same.sum() > 2000
    assert np.percentile(apart[same], 50) < 0.001  # halves, twice
    assert np.percentile(apart[same], 99) < 0.01
    assert np.median(turned) < 2
    assert np.percentile(apart, 50) < 0.01


# Mending


def test_a_cast_is_matched_away(filmed: Filmed, ran: Path, tmp_path: Path) -> None:
    plates = {"right": str(filmed.folder / "cast.mkv"), "match_colour": "global"}
    run_shot(shot_file(tmp_path, filmed, plates=plates, output={"previews": False}))
    assert error_of(tmp_path / "out", filmed) < 1.05 * error_of(ran / "out", filmed) + 1e-5
    cover = [np.isfinite(read_frame(folder / "out" / "depth" / f"film.{FIRST}.exr")["Z"]).mean() for folder in (tmp_path, ran)]
    assert cover[0] > cover[1] - 0.01
    told = receipt(tmp_path / "out")["steps"]["depth"]["figures"]["colour_match"]
    np.testing.assert_allclose(np.diag(told["matrix"]), 1 / CAST, rtol=0.01)
    assert told["residual_after_stops"] < 0.3 * told["residual_before_stops"]
    assert told["mode"] == "global"


@pytest.fixture(scope="module")
def mended(filmed: Filmed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mended") / "shot"
    run_shot(shot_file(folder, filmed, rig={"file": str(filmed.folder / "stale.json"), "drift": "shot"}, output={"previews": False}))
    return folder


def test_a_stale_rig_is_mended_from_the_shot(filmed: Filmed, ran: Path, mended: Path, tmp_path: Path) -> None:
    run_shot(shot_file(tmp_path, filmed, rig={"file": str(filmed.folder / "stale.json")}, plates={"frames": "1001"}, output={"previews": False}))
    stale = np.abs(read_frame(tmp_path / "out" / "depth" / "film.1001.exr")["Z"] / filmed.truth[0] - 1)
    clean = error_of(ran / "out", filmed)
    assert error_of(mended / "out", filmed) < clean + 0.003
    assert np.nanmedian(stale) > 3 * clean
    told = json.loads((mended / "out" / "drift.json").read_text())
    assert set(told["values"]) == {str(n) for n in NUMBERS}
    for values in told["values"].values():
        assert values == told["values"]["1001"]
        assert values[2] == pytest.approx(-0.5, abs=0.02)  # roll, degrees
        assert values[3] == pytest.approx(-0.4, abs=0.03)  # zoom, per cent
    assert "vertical error of the shot" in receipt(mended / "out")["rig_mended"]


def test_what_is_mended_stands(mended: Path) -> None:
    before = times(mended)
    summary = run_shot(mended / "shot.toml")
    assert (summary.done, summary.stood) == (0, 3 * COUNT)
    assert times(mended) == before


def test_every_part_of_a_mended_shot_is_the_same(filmed: Filmed, mended: Path, tmp_path: Path) -> None:
    path = shot_file(tmp_path, filmed, rig={"file": str(filmed.folder / "stale.json"), "drift": "shot"}, output={"previews": False})
    run_shot(path, frames="1003-1003")
    whole = contents(mended / "out")
    part = contents(tmp_path / "out")
    assert set(part) == {name for name in whole if "1003" in name}
    assert all(whole[name] == data for name, data in part.items())
    assert (tmp_path / "out" / "drift.json").read_bytes() == (mended / "out" / "drift.json").read_bytes()


def test_keys_speak_for_the_frames_between(filmed: Filmed, tmp_path: Path) -> None:
    rig = {"file": str(filmed.folder / "stale.json"), "drift": "frame", "drift_frames": "1001,1004"}
    path = shot_file(tmp_path, filmed, rig=rig, output={"previews": False})
    run_shot(path, frames="1002-1002")
    values = {int(k): np.array(v) for k, v in json.loads((tmp_path / "out" / "drift.json").read_text())["values"].items()}
    assert sorted(values) == list(NUMBERS)
    np.testing.assert_allclose(values[1002], (2 * values[1001] + values[1004]) / 3, atol=1e-6)
    assert values[1003][2] == pytest.approx(-0.5, abs=0.05)
    Z = read_frame(tmp_path / "out" / "depth" / "film.1002.exr")["Z"]
    assert np.nanmedian(np.abs(Z / filmed.truth[1] - 1)) < 0.015


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        ({"drift": "frame", "drift_frames": "1001,1009"}, r"shot\.toml.*drift_frames names frame 1009.*1001-1004"),
        ({"drift": "frame", "drift_window": 4}, r"shot\.toml.*drift_window must be an odd number of frames, got 4"),
        ({"drift": "frames"}, r"shot\.toml:\d+: rig\.drift = 'frames' is unknown.*'frame'"),
        ({"drift": "frame", "drift_frames": "a-b"}, r"shot\.toml:\d+: frames 'a-b' are not frame numbers"),
    ],
)
def test_what_cannot_be_mended(filmed: Filmed, tmp_path: Path, rig: dict[str, Any], words: str) -> None:
    path = shot_file(tmp_path, filmed, rig=rig)
    with pytest.raises(ShotError, match=words):
        run_shot(path)
    assert not list(tmp_path.rglob("*.exr"))


def test_a_shot_without_texture_is_not_mended(filmed: Filmed, tmp_path: Path) -> None:
    gray = [np.full((SIZE[1], SIZE[0], 3), 0.5, np.float32)] * COUNT
    for eye in ("left", "right"):
        rgb_movie(tmp_path / f"{eye}.mkv", [gray])
    plates = {eye: str(tmp_path / f"{eye}.mkv") for eye in ("left", "right")}
    with pytest.raises(PlateError, match=r"left\.mkv: the rig cannot be mended from this shot: only 0 matches.*60"):
        run_shot(shot_file(tmp_path, filmed, plates=plates, rig={"drift": "shot"}))


def test_a_damaged_frame_does_not_keep_the_others_from_being_mended(filmed: Filmed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stereorelight.footage.clip import Clip

    real = Clip.read

    def damaged(self: Clip, frame: int | None = None, **settings: Any) -> Any:
        if self.eye == "right" and frame == 1003:
            raise PlateError(f"{self.name(frame)}: cannot be read")
        return real(self, frame, **settings)

    monkeypatch.setattr(Clip, "read", damaged)
    path = shot_file(tmp_path, filmed, rig={"file": str(filmed.folder / "stale.json"), "drift": "frame"}, output={"previews": False})
    with pytest.raises(PlateError, match=r"right\.mkv frame 1003: cannot be read"):
        run_shot(path)
    assert {p.name for p in (tmp_path / "out" / "relit").iterdir()} == {"film.1001.exr", "film.1002.exr"}


# Review movies


def movies_of(out: Path) -> dict[str, int]:
    return {name: time for name, time in times(out).items() if name.startswith("movies/")}


def test_movies_hold_the_shot_at_its_rate(ran: Path) -> None:
    out = ran / "out"
    assert set(movies_of(out)) == {*(f"movies/film.{name}.mp4" for name in ALL_MOVIES), "movies/film.sheet.png"}
    for name in ALL_MOVIES:
        clip = open_clip(out / "movies" / f"film.{name}.mp4")
        assert (len(clip.frames), clip.rate, clip.start_timecode) == (COUNT, NTSC, "01:00:00:22")
    relit, wipe = (open_clip(out / "movies" / f"film.{name}.mp4") for name in ("relit", "wipe"))
    plate = open_clip(out / "movies" / "film.plate.mp4")
    first, last = encode(wipe.read(1), "sRGB"), encode(wipe.read(COUNT), "sRGB")
    assert np.abs(first - encode(plate.read(1), "sRGB")).mean() < 0.01
    assert np.abs(last - encode(relit.read(COUNT), "sRGB")).mean() < 0.01
    kept = json.loads((out / "run.json").read_text())["movies"]
    assert kept["film.relit.mp4"]["rate"] == "24000/1001"
    assert kept["film.relit.mp4"]["frames"] == COUNT


def test_movies_stand_and_lights_rewrite_what_shows_them(shot: Path) -> None:
    path, out = shot / "shot.toml", shot / "out"
    run_shot(path)  # the copy lies elsewhere, its files do not
    before = times(shot)
    assert run_shot(path).movies == 0
    assert times(shot) == before
    path.write_text(path.read_text().replace("intensity = 2.0", "intensity = 1.0"))
    summary = run_shot(path)
    changed = {name for name, time in movies_of(out).items() if time != before[f"out/{name}"]}
    assert changed == {"movies/film.relit.mp4", "movies/film.wipe.mp4", "movies/film.sheet.png"}
    assert summary.movies == 3


def test_a_part_of_the_shot_writes_no_movies_until_the_rest_is_there(filmed: Filmed, tmp_path: Path) -> None:
    path = shot_file(tmp_path, filmed, plates={"frames": "1001-1002"}, output={"movies": ["relit"]})
    assert run_shot(path, frames="1001").movies == 0
    assert not (tmp_path / "out" / "movies").exists()
    assert run_shot(path, frames="1002").movies == 2
    (tmp_path / "out" / "movies" / "film.relit.mp4").unlink()
    assert run_shot(path).movies == 1


def test_a_movie_asked_for_later_is_written_then(shot: Path) -> None:
    path = shot / "shot.toml"
    text = path.read_text()
    path.write_text(text.replace(', "anaglyph"', ""))
    run_shot(path)
    assert not list((shot / "out" / "previews").glob("*anaglyph*"))
    (shot / "out" / "movies" / "film.anaglyph.mp4").unlink()
    path.write_text(text)
    assert run_shot(path).movies == 1
    assert (shot / "out" / "movies" / "film.anaglyph.mp4").exists()
    path.write_text(text.replace('"h264"', '"ffv1"'))
    assert run_shot(path).movies == len(ALL_MOVIES)
    assert (shot / "out" / "movies" / "film.relit.mkv").exists()


def test_what_somebody_else_wrote_stays(filmed: Filmed, tmp_path: Path) -> None:
    path = shot_file(tmp_path, filmed, plates={"frames": "1001-1002"}, output={"movies": ["relit"]})
    foreign = tmp_path / "out" / "movies" / "film.relit.mp4"
    foreign.parent.mkdir(parents=True)
    foreign.write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"film\.relit\.mp4: exists and was not written by a run of this shot"):
        run_shot(path)
    assert foreign.read_bytes() == b"mine"
    run_shot(path, force=True)
    assert len(open_clip(foreign).frames) == 2


@pytest.mark.slow
def test_workers_make_the_same_files(filmed: Filmed, tmp_path: Path) -> None:
    rig = {"file": str(filmed.folder / "stale.json"), "drift": "frame"}
    made: list[tuple[RunSummary, dict[str, bytes]]] = []
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        summary = run_shot(shot_file(folder, filmed, rig=rig, output={"movies": ["relit", "anaglyph"]}), workers=workers)
        made.append((summary, contents(folder / "out")))
    assert made[0][1].keys() == made[1][1].keys()
    different = [name for name in made[0][1] if made[0][1][name] != made[1][1][name]]
    assert different == []
    assert made[0][0].figures.keys() == made[1][0].figures.keys()


def test_events_tell_of_mending_and_movies(filmed: Filmed, tmp_path: Path) -> None:
    events: list[Event] = []
    path = shot_file(tmp_path, filmed, plates={"frames": "1001-1002"}, rig={"drift": "shot"}, output={"movies": ["plate"]})
    run_shot(path, on_event=events.append)
    said = [event.step for event in events]
    assert said.count("mend the rig") == 2
    assert said.count("write") == 1


def test_a_movie_of_another_size_than_the_rig(filmed: Filmed, tmp_path: Path) -> None:
    small = replace(rig_named("parallel", (160, 90)))
    write_rig(tmp_path / "small.json", small)
    path = shot_file(tmp_path, filmed, rig={"file": str(tmp_path / "small.json")})
    with pytest.raises(PlateError, match=r"left\.mkv frame 1001: is 320 x 180 pixels, but the rig's left camera is 160 x 90"):
        run_shot(path)
