"""`calibrate` and `board` from files to a rig and a page: rendered boards in, the true rig out, and one clear line for what cannot be."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import click.testing
import cv2
import numpy as np
import pytest

from stereorelight.calibration.board import Board, parse_board
from stereorelight.camera import Camera, Rig
from stereorelight.cli import main
from stereorelight.footage.movie.writer import MovieWriter
from stereorelight.interchange.rigs import read_rig
from stereorelight.shot import calibrate_look as look
from tests.boards import board_pose, render_board
from tests.calibration_views import turned_by_deg
from tests.made_once import made_once

pytestmark = pytest.mark.slow

BOARD = parse_board("charuco:9x7:0.03:0.022:DICT_4X4_50")
CHESS = parse_board("chessboard:9x6:0.025")
SIZE = (480, 360)
SAMPLES = (34, 21)  # rays a pixel: with noise of a grey level no more are needed


def _turned(degrees: tuple[float, float, float]) -> np.ndarray:
    return cv2.Rodrigues(np.radians(degrees))[0]


def _rig(size: tuple[int, int], focal: float) -> Rig:
    """Toed in, focal lengths that differ, lenses that bend."""
    w, h = size
    left = Camera(size=size, K=np.array([[focal, 0, w / 2 + 3.1], [0, focal, h / 2 - 4.2], [0, 0, 1]]), model="brown", distortion=(-0.12, 0.05, 0, 0))
    f = 1.01 * focal
    right = Camera(size=size, K=np.array([[f, 0, w / 2 - 5.3], [0, f, h / 2 + 2.4], [0, 0, 1]]), model="brown", distortion=(-0.1, 0.04, 0, 0))
    R = _turned((0.3, 3.0, -0.4))
    return Rig(left=left, right=right, R_right_left=R, t_right_left_m=-R @ np.array([0.065, 0.001, -0.002]))


TRUTH = _rig(SIZE, 540.0)
# Where the board's middle stands in a left picture of 640 x 480, how far, and how it is turned: all over the frame, four ways of tilt.
VIEWS: tuple[tuple[tuple[float, float], float, tuple[float, float], float], ...] = (
    ((380, 240), 0.36, (5, -5), 0),
    ((250, 150), 0.46, (32, 8), 6),
    ((460, 150), 0.46, (-30, -12), -5),
    ((240, 330), 0.46, (-8, 34), 4),
    ((470, 330), 0.46, (10, -36), -8),
    ((230, 240), 0.44, (-34, 18), 85),
    ((440, 240), 0.42, (28, 26), 12),
    ((340, 130), 0.48, (38, -22), -12),
    ((340, 350), 0.48, (-36, -24), 20),
    ((360, 240), 0.40, (-26, 30), -25),
)


def pictures(board: Board, rig: Rig, views: tuple = VIEWS, *, noise: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Both eyes' pictures of each view."""
    out = []
    for number, (at, distance, tilt, roll) in enumerate(views):
        R, t = board_pose(board, rig.left, at_px=(0.75 * at[0], 0.75 * at[1]), distance_m=distance, tilt_deg=tilt, roll_deg=roll)
        left, _ = render_board(board, rig.left, R, t, seed=2 * number, samples=SAMPLES, noise=noise)
        right, _ = render_board(
            board, rig.right, rig.R_right_left @ R, rig.R_right_left @ t + rig.t_right_left_m, seed=2 * number + 1, samples=SAMPLES, noise=noise
        )
        out.append((left, right))
    return out


def write(folder: Path, pairs: list[tuple[np.ndarray, np.ndarray]]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, pair in enumerate(pairs, start=1):
        for eye, picture in zip(("left", "right"), pair):
            assert cv2.imwrite(str(folder / f"{eye}.{number:04d}.png"), picture)
    return folder


def eyes(folder: Path) -> tuple[str, str]:
    return str(folder / "left.####.png"), str(folder / "right.####.png")


def cli(*arguments: str | Path) -> click.testing.Result:
    return click.testing.CliRunner().invoke(main, [str(a) for a in arguments])


def calibrated(folder: Path, out: Path, *more: str | Path, board: Board = BOARD) -> dict:
    result = cli("calibrate", *eyes(folder), "--board", board.spec, "--out", out, "--json", *more)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def refused(folder: Path, out: Path, *more: str | Path, board: Board = BOARD) -> str:
    """The one line that is said; no rig is written."""
    result = cli("calibrate", *eyes(folder), "--board", board.spec, "--out", out, *more)
    assert result.exit_code == 1, result.output
    said = [line for line in result.stderr.splitlines() if line.strip()]
    assert len(said) == 1, result.output
    assert re.match(r"(Plate|Rig|Shot)Error: ", said[0]), result.output
    assert not out.exists()
    return said[0]


@dataclass(frozen=True)
class Filmed:
    folder: Path
    pairs: list[tuple[np.ndarray, np.ndarray]]
    rig_path: Path
    page: str
    answer: dict

    def take(self, folder: Path, pairs: list[tuple[np.ndarray, np.ndarray]]) -> tuple[Path, Path]:
        """Pictures of another session, and where its rig goes; what was found in pictures that are the same is known."""
        write(folder, pairs)
        shutil.copy(self.folder / "rig.detections.json", folder / "rig.detections.json")
        return folder, folder / "rig.json"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    """A session on a ChArUco board, in a folder with a name that a page must escape, and its calibration."""
    return made_once(tmp_path_factory, "board", _filmed)


def _filmed(shared: Path) -> Filmed:
    folder = shared / "take <b> & 'co'"
    pairs = pictures(BOARD, TRUTH, noise=1.0)
    write(folder, pairs)
    answer = calibrated(
        folder, folder / "rig.json", "--report", folder / "page.html", "--at", "1", "--at", "2", "--lens", "brown4", "--lens", "brown5"
    )
    return Filmed(folder, pairs, folder / "rig.json", (folder / "page.html").read_text(encoding="utf-8"), answer)


@pytest.fixture(scope="module")
def chess() -> list[tuple[np.ndarray, np.ndarray]]:
    """A view of a plain chessboard."""
    return pictures(CHESS, TRUTH, VIEWS[1:2], noise=1.0)


def assert_true(rig: Rig, *, share: float = 0.002, degrees: float = 0.03) -> None:
    assert abs(rig.baseline_m / TRUTH.baseline_m - 1) < share
    assert turned_by_deg(rig.R_right_left, TRUTH.R_right_left) < degrees
    for eye in ("left", "right"):
        assert abs(rig.camera(eye).fx / TRUTH.camera(eye).fx - 1) < share


def test_stills_give_the_true_rig(filmed: Filmed) -> None:
    rig = read_rig(filmed.rig_path)
    assert_true(rig)
    assert rig.mirrored is None
    assert filmed.answer["held_out_vertical_px"] < 0.05
    assert filmed.answer["views_paired"] == len(VIEWS)
    assert [d["distance_m"] for d in filmed.answer["depth"]] == [1, 2]
    assert filmed.answer["verdict"] == rig.quality["verdict"]


def test_the_page_has_every_picture_and_fetches_nothing(filmed: Filmed) -> None:
    page = filmed.page
    for words in ("Coverage, left", "Errors of the corners, right", "Uncertainty of the left eye", "RMS of each view", "From above", "rectified"):
        assert words in page
    assert page.count("<svg") == page.count("</svg>") >= 8
    assert page.count("data:image/png;base64,") == 1
    assert not re.search(r"(?:src|href)=\"(?!data:)", page)
    assert "http" not in page.split("</style>")[1]
    for advice in filmed.answer["advice"]:
        assert advice["level"] in ("good", "note", "warn", "bad")
        assert bool(advice["remedy"]) or advice["level"] in ("good", "note")
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page).lower().replace("nano", "")


def test_what_was_found_is_kept(filmed: Filmed, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder, out = filmed.take(tmp_path / "again", filmed.pairs)
    monkeypatch.setattr(look, "detect", lambda *a, **k: pytest.fail("looked again"))
    same = calibrated(folder, out, "--lens", "brown4")
    assert_true(read_rig(out))
    assert same["lenses"] == ["brown4", "brown4"]
    assert cli("calibrate", *eyes(folder), "--board", BOARD.spec, "--out", out).exit_code == 1  # not overwritten without --force


def test_the_same_rig_another_day(filmed: Filmed, tmp_path: Path) -> None:
    folder, out = filmed.take(tmp_path / "day", filmed.pairs[1:4])
    calibrated(folder, out, "--from", filmed.rig_path)
    before, now = read_rig(filmed.rig_path), read_rig(out)
    assert (now.left.K == before.left.K).all()
    assert now.right.distortion == before.right.distortion
    assert turned_by_deg(now.R_right_left, TRUTH.R_right_left) < 0.03


def movies(folder: Path, pairs: list[tuple[np.ndarray, np.ndarray]], *, late: int = 0, hold: int = 3) -> tuple[str, str]:
    """A movie of each eye: every view held for some frames, the right one begun `late` frames early, so that it runs late."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for e, eye in enumerate(("left", "right")):
        shown = [pair[e] for pair in pairs for _ in range(hold)]
        names.append(str(folder / f"{eye}.mov"))
        with MovieWriter(names[-1], size=SIZE, rate=25, codec="prores") as movie:
            for picture in [shown[0]] * (late if e else 0) + shown:
                movie.write(np.repeat(picture[..., None] / np.float32(255), 3, axis=2).astype(np.float32))
    return names[0], names[1]


def test_a_movie_gives_the_true_rig(filmed: Filmed, tmp_path: Path) -> None:
    left, right = movies(tmp_path, filmed.pairs[1:8])
    result = cli("calibrate", left, right, "--board", BOARD.spec, "--out", tmp_path / "rig.json", "--lens", "brown4", "--json")
    assert result.exit_code == 0, result.output
    assert_true(read_rig(tmp_path / "rig.json"), share=0.003, degrees=0.05)
    assert json.loads(result.stdout)["names"][0].startswith("frame ")


def test_a_movie_out_of_step_is_refused(filmed: Filmed, tmp_path: Path) -> None:
    left, right = movies(tmp_path, filmed.pairs[:5], late=2)
    said = cli("calibrate", left, right, "--board", BOARD.spec, "--out", tmp_path / "rig.json")
    assert said.exit_code == 1
    assert "the right eye runs 2 frames late" in said.stderr
    assert "trim the movies" in said.stderr


def test_no_board(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(60, 120, (120, 160)).astype(np.uint8)
    said = refused(write(tmp_path, [(cv2.resize(grey, SIZE), grey)] * 3), tmp_path / "rig.json")
    assert "none of 3 pictures of the left eye shows the board" in said
    assert "check the spec" in said


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("chessboard:8x5:0.025", "9x6 inner corners"),
        ("chessboard:11x8:0.025", "a chessboard of 9x6 inner corners is seen, not 11x8"),
        (BOARD.spec, "a plain chessboard of 9x6 inner corners is seen, without charuco markers"),
    ],
)
def test_another_chessboard(chess: list[tuple[np.ndarray, np.ndarray]], tmp_path: Path, spec: str, words: str) -> None:
    assert words in refused(write(tmp_path, chess[:1]), tmp_path / "rig.json", board=parse_board(spec))


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("charuco:6x5:0.03:0.022:DICT_4X4_50", "this board has only 0 to 14"),
        ("charuco:9x7:0.03:0.022:DICT_6X6_50", "markers of DICT_4X4_250 are seen not of DICT_6X6_50"),
        ("charuco:9x7:0.03:0.016:DICT_4X4_50", "of their squares' side, but"),
        ("chessboard:9x6:0.03", "this is a ChArUco board; give its own spec"),
    ],
)
def test_another_charuco(filmed: Filmed, tmp_path: Path, spec: str, words: str) -> None:
    assert words in refused(write(tmp_path, filmed.pairs[1:2]), tmp_path / "rig.json", board=parse_board(spec))


def test_squares_of_another_size_show_in_the_baseline(filmed: Filmed, tmp_path: Path) -> None:
    folder, out = filmed.take(tmp_path / "twice", filmed.pairs)
    said = refused(folder, out, "--baseline", "0.13", "--lens", "brown4")
    assert "needs squares of 0.06 m, the board is told to have 0.03" in said
    calibrated(folder, out, "--baseline", "0.0652", "--lens", "brown4")
    assert_true(read_rig(out))


def test_boards_in_one_eye_only(filmed: Filmed, tmp_path: Path) -> None:
    nothing = np.full((360, 480), 90, np.uint8)
    folder, out = filmed.take(tmp_path / "one", [(a, nothing) for a, _ in filmed.pairs[:3]])
    said = refused(folder, out)
    assert "none of 3 pictures of the right eye shows the board" in said
    assert "though 3 of the other eye do" in said
    folder, out = filmed.take(tmp_path / "apart", [(a, nothing) if k % 2 else (nothing, b) for k, (a, b) in enumerate(filmed.pairs[:4])])
    assert "no frame shows the board in both eyes (2 left, 2 right)" in refused(folder, out)


def test_too_few_views(filmed: Filmed, tmp_path: Path) -> None:
    folder, out = filmed.take(tmp_path / "three", filmed.pairs[1:4])
    answer = calibrated(folder, out, "--lens", "brown4")
    assert answer["verdict"] == "bad"
    views = next(a for a in answer["advice"] if a["name"] == "views")
    assert views["level"] == "bad"
    assert "shoot 17 more" in views["remedy"]
    folder, out = filmed.take(tmp_path / "two", filmed.pairs[1:3])
    assert "in 2 of 2 views" in refused(folder, out)


def test_a_mirrored_print_and_a_mirrored_eye(filmed: Filmed, tmp_path: Path) -> None:
    flipped = [(np.ascontiguousarray(a[:, ::-1]), np.ascontiguousarray(b[:, ::-1])) for a, b in filmed.pairs]
    said = refused(write(tmp_path / "print", flipped[:3]), tmp_path / "rig.json")
    assert "print it again without mirroring" in said
    folder, out = filmed.take(tmp_path / "eye", [(a, b) for (a, _), (_, b) in zip(filmed.pairs, flipped)])
    answer = calibrated(folder, out, "--lens", "brown4")
    assert any("the right eye is mirrored" in words for words in answer["words"])
    rig = read_rig(out)
    assert rig.mirrored == "right"
    assert_true(rig)
    assert "--mirrored left, but the right eye's pictures" in refused(folder, tmp_path / "no.json", "--mirrored", "left")


def test_two_boards(chess: list[tuple[np.ndarray, np.ndarray]], tmp_path: Path) -> None:
    both = [tuple(np.concatenate([p, p[:, ::-1] if k else p], axis=1) for k, p in enumerate(pair)) for pair in chess[:1]]
    assert "shows two boards chessboard:9x6:0.025; cover one" in refused(write(tmp_path, both), tmp_path / "rig.json", board=CHESS)  # type: ignore[arg-type]


def test_eyes_of_other_moments(filmed: Filmed, tmp_path: Path) -> None:
    right = [b for _, b in filmed.pairs]
    folder, out = filmed.take(tmp_path, [(a, b) for (a, _), b in zip(filmed.pairs, right[1:] + right[:1])])
    said = refused(folder, out, "--lens", "brown4")
    assert re.search("of the same moments?|no rig fits", said)


def test_a_size_that_changes(filmed: Filmed, tmp_path: Path) -> None:
    small = [cv2.resize(p, (400, 300), interpolation=cv2.INTER_AREA) for p in filmed.pairs[3]]
    folder, out = filmed.take(tmp_path, [*filmed.pairs[:3], (small[0], small[1])])
    said = refused(folder, out)
    assert "left eye, frame 4: size 400x300, but 480x360 before" in said
    assert "calibrate each size by itself" in said


def test_frontal_boards_are_flagged(tmp_path: Path) -> None:
    frontal = tuple(((x, y), 0.5, (3.0 * k - 4, 3.0 - 2 * k), 4.0 * k) for k, (x, y) in enumerate(((240, 160), (420, 160), (240, 320), (420, 320))))
    answer = calibrated(write(tmp_path, pictures(BOARD, TRUTH, frontal, noise=1.0)), tmp_path / "rig.json", "--lens", "brown4")
    focal = next(a for a in answer["advice"] if a["name"] == "focal")
    assert focal["level"] in ("warn", "bad")
    assert "30 to 45 degrees" in focal["remedy"]


def test_the_ready_boards_are_what_the_command_writes(tmp_path: Path) -> None:
    ready = sorted((Path(__file__).parent.parent / "calib").glob("*.pdf"))
    assert len(ready) >= 6
    for file in ready:
        text = file.read_bytes()
        assert len(text) < 200_000
        spec = re.search(rb"stereorelight --board (\S+)   \\\((\w+)\\\)", text)
        assert spec is not None
        result = cli("board", spec[1].decode(), "--page", spec[2].decode(), "--out", tmp_path / file.name)
        assert result.exit_code == 0, result.output
        assert (tmp_path / file.name).read_bytes() == text
