"""Plate health of synthetic shots with known faults: each is found, with its size and its remedy, and a clean shot raises none."""

from __future__ import annotations

import base64
import html
import json
import re
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import click.testing
import cv2
import numpy as np
import pytest

from stereorelight.camera import Eye, Rig
from stereorelight.cli import main
from stereorelight.errors import PlateError
from stereorelight.footage.exr import write_exr
from stereorelight.footage.eyes import open_eyes
from stereorelight.footage.stills import read_still
from stereorelight.health.finding import LEVELS, Finding
from stereorelight.interchange.rigs import read_rig, write_rig
from stereorelight.shot.check import Health, _passage, check_plates
from stereorelight.shot.check_page import check_page
from stereorelight.shot.pairs import pairs_of
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named
from tests.made_once import made_once

SIZE, COUNT, FIRST = (400, 224), 6, 1001
NOISE = 0.002
TENTH = 0.1  # the issue asks for sizes within a tenth
Change = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Filmed:
    rig: Rig
    left: list[np.ndarray]
    right: list[np.ndarray]


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    return made_once(tmp_path_factory, "checked", lambda _: _filmed())


def _filmed() -> Filmed:
    rig = rig_named("parallel", SIZE)
    shots = [render(scene_named("sphere", frame=k, motion=True), rig, samples=2, noise_sigma=NOISE, frame=k, shadows=False) for k in range(COUNT)]
    return Filmed(rig=rig, left=[s.left["plate"] for s in shots], right=[s.right["plate"] for s in shots])


def write(folder: Path, left: list[np.ndarray], right: list[np.ndarray], *, rig: Rig | None = None) -> tuple[str, str]:
    """The two patterns of sequences of linear plates."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, plates in (("left", left), ("right", right)):
        for number, plate in enumerate(plates, start=FIRST):
            write_exr(folder / f"{name}.{number}.exr", {c: plate[..., k] for k, c in enumerate("RGB")}, force=True)
    if rig is not None:
        write_rig(folder / "rig.json", rig, force=True)
    return str(folder / "left.####.exr"), str(folder / "right.####.exr")


def checked(folder: Path, filmed: Filmed, change: Change = lambda plate: plate, *, count: int = 2, rig: bool = True) -> Health:
    """The health of the first frames with every right plate changed."""
    names = write(folder, filmed.left[:count], [change(plate) for plate in filmed.right[:count]], rig=filmed.rig)
    return check_plates(*names, rig_path=folder / "rig.json" if rig else None)


def finding(health: Health, name: str) -> Finding:
    return next(found for found in health.findings if found.name == name)


def raised(health: Health) -> set[str]:
    return {found.name for found in health.findings if found.level in ("warn", "bad") and found.name != "prediction"}


def warped(*, down_px: float = 0.0, zoom: float = 1.0, clockwise_deg: float = 0.0) -> Change:
    """A plate turned, zoomed and moved about its middle."""
    turn = np.radians(clockwise_deg)
    A = zoom * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = (np.array(SIZE) - 1) / 2

    def change(plate: np.ndarray) -> np.ndarray:
        matrix = np.column_stack([A, middle - A @ middle + (0, down_px)])
        return cv2.warpAffine(plate, matrix, SIZE, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)

    return change


def flipped(plate: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(plate[:, ::-1])


# Clean shots


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
def test_a_clean_shot_raises_nothing(tmp_path: Path, filmed: Filmed, with_rig: bool) -> None:
    health = checked(tmp_path, filmed, count=COUNT, rig=with_rig)
    assert raised(health) == set(), [found.words for found in health.findings]
    assert health.level in ("good", "note")
    assert health.words == "nothing in these plates stands in the way"
    assert bool(health.prediction) is with_rig
    assert any(found.name == "range" for found in health.findings) is with_rig
    names = [found.name for found in health.findings]
    assert len(names) == len(set(names))
    order = [LEVELS.index(found.level) for found in health.findings]
    assert order == sorted(order, reverse=True)


def test_single_pictures(tmp_path: Path, filmed: Filmed) -> None:
    write(tmp_path, filmed.left[:1], filmed.right[:1], rig=filmed.rig)
    health = check_plates(tmp_path / "left.1001.exr", tmp_path / "right.1001.exr", rig_path=tmp_path / "rig.json")
    assert raised(health) == set()
    assert "1 frame" in health.facts
    assert not {"sync", "repeated_frames", "dropped_frames"} & {found.name for found in health.findings}
    assert "data:image/png" in check_page(health)


def test_a_mirrored_rig_is_clean_when_it_says_so(tmp_path: Path, filmed: Filmed) -> None:
    names = write(tmp_path, filmed.left[:1], [flipped(filmed.right[0])], rig=replace(filmed.rig, mirrored="right"))
    assert raised(check_plates(*names, rig_path=tmp_path / "rig.json")) == set()


# Known faults


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
def test_three_pixels_down(tmp_path: Path, filmed: Filmed, with_rig: bool) -> None:
    health = checked(tmp_path, filmed, warped(down_px=3.0), rig=with_rig)
    found = finding(health, "vertical")
    assert found.level == ("bad" if with_rig else "warn")
    assert found.value == pytest.approx(3.0, rel=TENTH)
    assert "3.0" in found.words
    assert ('drift = "shot"' if with_rig else "calibration") in found.remedy
    if with_rig:
        stale = finding(health, "rig_stale")
        assert (stale.level, stale.details["zoom_percent"]) == ("bad", pytest.approx(0, abs=0.02))
        assert stale.details["held_out_after_px"] < 0.1
        assert "pitch" in stale.words
        assert raised(health) == {"vertical", "rig_stale"}
    else:
        assert raised(health) == {"vertical"}


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
@pytest.mark.parametrize(("zoom", "word"), [(1.004, "larger"), (0.996, "smaller")])
def test_a_zoom(tmp_path: Path, filmed: Filmed, zoom: float, word: str, with_rig: bool) -> None:
    health = checked(tmp_path, filmed, warped(zoom=zoom), rig=with_rig)
    found = finding(health, "zoom")
    assert found.level in ("warn", "bad")
    assert found.value == pytest.approx(100 * (zoom - 1), rel=TENTH)
    assert word in found.words
    assert found.remedy
    assert finding(health, "roll").level == "good"
    assert raised(health) <= {"zoom", "rig_stale"}


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
@pytest.mark.parametrize(("degrees", "word"), [(0.5, "turned clockwise"), (-0.5, "turned anticlockwise")])
def test_a_roll(tmp_path: Path, filmed: Filmed, degrees: float, word: str, with_rig: bool) -> None:
    health = checked(tmp_path, filmed, warped(clockwise_deg=degrees), rig=with_rig)
    found = finding(health, "roll")
    assert found.level in ("warn", "bad")
    assert found.value == pytest.approx(degrees, rel=TENTH)
    assert word in found.words
    assert ('drift = "shot"' if with_rig else "level the eyes") in found.remedy.replace("Level", "level")
    assert finding(health, "zoom").level == "good"
    assert raised(health) <= {"roll", "rig_stale", "vertical"}


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
def test_brighter_with_a_red_cast(tmp_path: Path, filmed: Filmed, with_rig: bool) -> None:
    gains = 1.15 * np.array([1.1, 1.0, 1.0], np.float32)
    health = checked(tmp_path, filmed, lambda plate: plate * gains, rig=with_rig)
    exposure, colour = finding(health, "exposure"), finding(health, "colour")
    assert exposure.value == pytest.approx(np.log2(1.15), rel=TENTH)
    assert "brighter" in exposure.words
    assert colour.value == pytest.approx(10.0, rel=TENTH)
    assert re.search(r"red \+(9|10)\.\d%", colour.words)
    for found in (exposure, colour):
        assert found.level in ("warn", "bad")
        assert "match_colour" in found.remedy
    assert raised(health) == {"exposure", "colour"}


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
def test_eyes_swapped(tmp_path: Path, filmed: Filmed, with_rig: bool) -> None:
    names = write(tmp_path, filmed.right[:2], filmed.left[:2], rig=filmed.rig)
    found = finding(check_plates(*names, rig_path=tmp_path / "rig.json" if with_rig else None), "swapped")
    assert found.level == "bad"
    assert "left and right are swapped" in found.words.lower()
    assert "exchange left and right" in found.remedy.lower()


@pytest.mark.parametrize("with_rig", [True, False], ids=["rig", "no rig"])
@pytest.mark.parametrize("eye", ["left", "right"])
def test_an_eye_mirrored(tmp_path: Path, filmed: Filmed, eye: Eye, with_rig: bool) -> None:
    left, right = filmed.left[:1], filmed.right[:1]
    left, right = ([flipped(left[0])], right) if eye == "left" else (left, [flipped(right[0])])
    names = write(tmp_path, left, right, rig=filmed.rig)
    found = finding(check_plates(*names, rig_path=tmp_path / "rig.json" if with_rig else None), "mirrored")
    assert found.level == "bad"
    assert "mirrored" in found.words
    assert f'"mirrored": "{eye}"' in found.remedy or (not with_rig and '"mirrored"' in found.remedy)


def test_a_repeated_frame(tmp_path: Path, filmed: Filmed) -> None:
    right = list(filmed.right)
    right[3] = right[2]
    names = write(tmp_path, filmed.left, right)
    health = check_plates(*names)
    found = finding(health, "repeated_frames")
    assert (found.level, found.value) == ("warn", 1.0)
    assert "of the right eye" in found.words
    assert "1004" in found.words
    assert dict(found.frames)[1004] == 1.0
    assert sum(value for _, value in found.frames) == 1.0
    assert "original" in found.remedy


@pytest.mark.parametrize("mirrored", [False, True])
def test_one_eye_given_twice(tmp_path: Path, filmed: Filmed, mirrored: bool) -> None:
    twice = [plate[:, ::-1] if mirrored else plate for plate in filmed.left]
    health = check_plates(*write(tmp_path, filmed.left, [*filmed.right[:1], *twice[1:]]))
    found = finding(health, "one_picture")
    assert (found.level, found.value) == ("bad", 4.0)
    assert "on 4 of 5 frames looked at" in found.words
    assert [value for _, value in found.frames] == [0, 1, 1, 1, 1]  # the last frame is only what comes after the one before
    assert "own file" in found.remedy


def test_a_truncated_file_among_the_frames(tmp_path: Path, filmed: Filmed) -> None:
    names = write(tmp_path, filmed.left, filmed.right, rig=filmed.rig)
    bad = tmp_path / "right.1003.exr"
    bad.write_bytes(bad.read_bytes()[: bad.stat().st_size // 2])
    health = check_plates(*names, rig_path=tmp_path / "rig.json")
    found = finding(health, "unreadable_frames")
    assert (found.level, found.value) == ("bad", 1.0)
    assert "right.1003.exr" in found.words
    assert dict(found.frames)[1003] == 1.0
    assert "--frames" in found.remedy
    assert raised(health) == {"unreadable_frames"}
    assert health.level == "bad"


def test_nothing_to_read_is_an_error(tmp_path: Path, filmed: Filmed) -> None:
    names = write(tmp_path, filmed.left[:2], filmed.right[:2])
    for number in (1001, 1002):
        (tmp_path / f"right.{number}.exr").write_bytes(b"")
    with pytest.raises(PlateError, match=r"right\.1001\.exr: the file is empty.*no frame of the shot can be checked"):
        check_plates(*names)


def test_the_wrong_rig_is_told(tmp_path: Path, filmed: Filmed) -> None:
    names = write(tmp_path, filmed.left[:1], filmed.right[:1])
    write_rig(tmp_path / "rig.json", rig_named("parallel", (200, 112)))
    with pytest.raises(PlateError, match=r"left\.1001\.exr: is 400 x 224 pixels, but the rig's left camera is 200 x 112"):
        check_plates(*names, rig_path=tmp_path / "rig.json")


def test_plates_without_anything_to_see(tmp_path: Path, filmed: Filmed) -> None:
    """Gray cards: nothing matches, and the report says so instead of failing."""
    gray = [np.full((SIZE[1], SIZE[0], 3), 0.18, np.float32)] * 2
    for with_rig in (True, False):
        names = write(tmp_path, gray, gray, rig=filmed.rig)
        health = check_plates(*names, rig_path=tmp_path / "rig.json" if with_rig else None)
        assert finding(health, "matches").level == "bad"
        assert finding(health, "vertical").level == "unknown"
        assert finding(health, "mirrored").level == "unknown"
        assert "data:image/png" in check_page(health)
        json.dumps(health.to_dict(), allow_nan=False)


def test_black_plates(tmp_path: Path, filmed: Filmed) -> None:
    black = [np.zeros((SIZE[1], SIZE[0], 3), np.float32)] * 2
    names = write(tmp_path, black, filmed.right[:2])
    with pytest.raises(PlateError, match=r"left\.1001\.exr and .*right\.1001\.exr: left plate has no light in it"):
        check_plates(*names)
    write(tmp_path, [black[0], filmed.left[1]], filmed.right[:2])
    found = finding(check_plates(*names), "unreadable_frames")
    assert (found.level, found.value) == ("bad", 1.0)
    assert "left.1001.exr" in found.words


# The command


def call(*arguments: object) -> click.testing.Result:
    return click.testing.CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory, filmed: Filmed) -> tuple[str, str, Path]:
    """Two frames that are a little out of line, in a folder with a name that must be escaped."""
    folder = tmp_path_factory.mktemp("faulty") / "take <b> [1] & 'co'"
    names = write(folder, filmed.left[:2], [warped(clockwise_deg=0.15)(plate) for plate in filmed.right[:2]], rig=filmed.rig)
    return *names, folder


def test_json_is_one_object(faulty: tuple[str, str, Path]) -> None:
    result = call("check", faulty[0], faulty[1], "--rig", faulty[2] / "rig.json", "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert set(told) == {"verdict", "words", "plates", "facts", "findings", "prediction"}
    assert told["verdict"] in LEVELS
    assert told["plates"]["left"] == faulty[0]
    for found in told["findings"]:
        assert set(found) == {"name", "level", "value", "unit", "words", "remedy", "frames", "details"}
        assert found["level"] in LEVELS
        assert found["words"].endswith((".", "!", "?"))
        assert (found["level"] in ("warn", "bad")) <= bool(found["remedy"]), found
    assert any(found["name"] == "roll" and found["value"] == pytest.approx(0.15, rel=TENTH) for found in told["findings"])
    assert told["prediction"][0][1] == "distance"


def test_the_table_says_everything(faulty: tuple[str, str, Path]) -> None:
    result = call("check", faulty[0], faulty[1], "--rig", faulty[2] / "rig.json")
    assert result.exit_code == 0
    text = " ".join(result.stdout.split())
    assert "roll" in text
    assert "look at roll" in text
    assert re.search(r"warn\s+roll\s+0\.1[45]\d? deg", text)


def test_the_page_stands_alone(faulty: tuple[str, str, Path], tmp_path: Path) -> None:
    page = tmp_path / "health.html"
    result = call("check", faulty[0], faulty[1], "--rig", faulty[2] / "rig.json", "--report", page, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["report"] == str(page)
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"https?://|//[a-z]|@import|<script|<link|url\(", re.sub(r'base64,[^"]*', "", text))
    assert "take <b>" not in text
    assert html.escape(faulty[0]) in text.replace("&#39;", "&#x27;")
    sources = re.findall(r'src="([^"]*)"', text)
    assert len(sources) >= 4
    for k, source in enumerate(sources):
        head, data = source.split(",", 1)
        assert head == "data:image/png;base64"
        (tmp_path / f"{k}.png").write_bytes(base64.b64decode(data, validate=True))
        picture = read_still(tmp_path / f"{k}.png").rgb
        assert picture.shape[1] >= 300
    for found in ("rig stale", "roll", "exposure", "range"):
        assert f"<td>{found}</td>" in text
    again = call("check", faulty[0], faulty[1], "--report", page)
    assert again.exit_code == 1
    assert "health.html" in again.stderr
    assert "--force" in again.stderr
    assert page.read_text(encoding="utf-8") == text


@pytest.mark.parametrize(("extra", "code"), [((), 0), (("--fail-on", "warn"), 1), (("--fail-on", "bad"), 0)])
def test_exit_codes_for_scripts(faulty: tuple[str, str, Path], extra: tuple[str, ...], code: int) -> None:
    result = call("check", faulty[0], faulty[1], "--frames", "1001", *extra, "--json")
    assert json.loads(result.stdout)["verdict"] == "warn"
    assert result.exit_code == code


def test_wrong_usage_is_two(tmp_path: Path, faulty: tuple[str, str, Path]) -> None:
    assert call("check").exit_code == 2
    assert call("check", faulty[0], faulty[1], "--fail-on", "note").exit_code == 2
    assert call("check", faulty[0], faulty[1], "--subject", "-1").exit_code == 2
    assert call("check", tmp_path / "a.toml", faulty[0]).exit_code == 2


def test_a_shot_file_is_checked_with_its_rig_where_there_is_one(tmp_path: Path, filmed: Filmed) -> None:
    write(tmp_path, filmed.left[:1], filmed.right[:1], rig=filmed.rig)
    shot = tmp_path / "shot.toml"
    shot.write_text('[plates]\nleft = "left.1001.exr"\nright = "right.1001.exr"\n[depth]\nnear_m = 2.0\n')
    told = json.loads(call("check", shot, "--json").stdout)
    range_found = next(found for found in told["findings"] if found["name"] == "range")
    assert range_found["level"] in ("warn", "bad")  # the ball is nearer than the shot file allows
    assert "near_m" in range_found["words"] + range_found["remedy"]
    (tmp_path / "rig.json").unlink()
    told = json.loads(call("check", shot, "--json").stdout)
    assert "without a rig" in told["facts"]


def test_the_subject_decides_what_is_foreseen(tmp_path: Path, filmed: Filmed) -> None:
    names = write(tmp_path, filmed.left[:1], filmed.right[:1], rig=filmed.rig)
    rows = {s: check_plates(*names, rig_path=tmp_path / "rig.json", subject_m=s).prediction[2] for s in (1.0, 2.0)}
    assert rows[1.0][:2] == ("subject", "1.00 m")
    step = [float(rows[s][2].split()[0]) for s in (1.0, 2.0)]
    assert step[1] == pytest.approx(4 * step[0], rel=0.05)  # distance squared
    camera = read_rig(tmp_path / "rig.json").left
    assert step[0] == pytest.approx(1000 / (camera.fx * 0.065), rel=0.05)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_shot(tmp_path: Path) -> None:
    """A hundred frames hold little more than twenty once they are seen: what stays of a frame is its signature."""
    rng = np.random.default_rng(5)
    w, h = 96, 64
    world = cv2.GaussianBlur(rng.random((h, 3 * w, 3), np.float32), (0, 0), 1.2)
    left = [world[:, k % w : k % w + w] for k in range(100)]
    right = [world[:, k % w + 3 : k % w + 3 + w] for k in range(100)]
    eyes = open_eyes(*write(tmp_path, left, right))
    pairs = pairs_of(eyes)
    signature_bytes = 90 * 160 * 2

    def peak(count: int) -> int:
        tracemalloc.start()
        _passage(pairs[:count], None, colour=None, expected_m=(None, None), on_frame=lambda name, done, total: None)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(12)
    few, many = peak(20), peak(100)
    assert many - few < 80 * 2 * 1.4 * signature_bytes
