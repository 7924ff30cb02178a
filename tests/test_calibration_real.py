"""The thirteen real pairs of OpenCV's chessboard: figures that OpenCV's own pipeline and mrcal do not reach.

The pictures are not part of this repository; STEREORELIGHT_DATA names the folder that holds `opencv_chessboard`."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from stereorelight.calibration.answer import Calibration
from stereorelight.calibration.board import parse_board
from stereorelight.calibration.corners import Detection, detect
from stereorelight.calibration.lens_choice import Choice, choose
from stereorelight.calibration.sightings import StereoViews
from stereorelight.calibration.validate import Quality, validate
from tests.made_once import made_once

cv2 = pytest.importorskip("cv2")
DATA = Path(os.environ.get("STEREORELIGHT_DATA", "nowhere")) / "opencv_chessboard"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not DATA.is_dir(), reason="STEREORELIGHT_DATA does not name a folder that holds opencv_chessboard: the real pairs are not here"
    ),
]
# What photometric corners and a joint solve gave before; a board taken as it is, not as it is drawn, does better.
LOO_PX, LOO_95_PX, RMS_PX, SQUARE_SPREAD = 0.077, 0.226, 0.191, 0.0058


BOARD = parse_board("chessboard:9x6:1.0")  # the squares are about 25 mm; one unit here, as the figures have it


def real_detections() -> dict[str, dict[str, Detection | None]]:
    """Of both eyes, what our own detector finds in each of the thirteen pictures."""
    names = sorted(p.stem[4:] for p in DATA.glob("left*.jpg"))
    return {eye: {n: detect(cv2.imread(str(DATA / f"{eye}{n}.jpg"), cv2.IMREAD_GRAYSCALE), BOARD) for n in names} for eye in ("left", "right")}


def real_views(found: dict[str, dict[str, Detection | None]] | None = None) -> StereoViews:
    """All thirteen pairs."""
    eyes = found or real_detections()
    return StereoViews(points_m=BOARD.points_m, left=list(eyes["left"].values()), right=list(eyes["right"].values()), names=list(eyes["left"]))


def detected(factory: pytest.TempPathFactory) -> dict[str, dict[str, Detection | None]]:
    """`real_detections`, for whoever needs them in this test run."""
    return made_once(factory, "real-detections", lambda _: real_detections())


def calibrated(factory: pytest.TempPathFactory) -> tuple[Choice, Calibration]:
    """The rig of the real pairs, for whoever needs it in this test run."""
    return made_once(factory, "real-boards", lambda _: choose(real_views(detected(factory)), ((640, 480), (640, 480))))


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> tuple[Choice, Calibration, Quality]:
    choice, calibration = calibrated(tmp_path_factory)
    return choice, calibration, validate(calibration)


def test_every_view_is_used(real: tuple[Choice, Calibration, Quality]) -> None:
    _, calibration, _ = real
    assert len(calibration.views) == 13
    assert np.isfinite(calibration.views.px).all()
    assert calibration.paired.all()
    assert calibration.kept.mean() > 0.94


def test_held_out_rows_agree_better_than_the_best_known(real: tuple[Choice, Calibration, Quality]) -> None:
    _, _, quality = real
    assert len(quality.held_out_all_px) == 13 * 54  # every corner of every view, none left out
    assert quality.held_out_all_px.mean() <= LOO_PX
    assert np.percentile(quality.held_out_all_px, 95) <= LOO_95_PX


def test_residuals_and_squares(real: tuple[Choice, Calibration, Quality]) -> None:
    _, calibration, quality = real
    assert calibration.rms_all_px <= RMS_PX  # all corners of all views
    assert calibration.rms_before_px <= RMS_PX  # and with the board taken as it is drawn
    assert quality.square_spread <= SQUARE_SPREAD
    assert quality.square_mean == pytest.approx(1, abs=0.002)


def test_the_board_is_found_to_be_off_its_plan(real: tuple[Choice, Calibration, Quality]) -> None:
    choice, calibration, quality = real
    true, free = choice.boards
    assert choice.board == "free"
    assert free.held_out_px < 0.6 * true.held_out_px
    assert 0.001 < np.sqrt(((calibration.board_m - calibration.views.points_m) ** 2).mean()) < 0.01  # of a square
    assert any("off its plan" in a.words for a in quality.advice)


def test_the_frame_s_empty_corner_is_named(real: tuple[Choice, Calibration, Quality]) -> None:
    _, _, quality = real
    left = next(a for a in quality.advice if a.name == "frame left")
    assert left.level in ("warn", "bad")
    assert "top left" in left.remedy
