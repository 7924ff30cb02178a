"""Plates with one known fault each: found, sized, and nothing said of a clean shot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from stereorelight.calibration.alignment import behind_rig, handedness, relative_alignment
from stereorelight.calibration.drift import apply, solve_drift, vertical_error
from stereorelight.calibration.features import Matches, match_points
from stereorelight.camera import Rig
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.engine.resample import resample
from stereorelight.errors import PlateError
from stereorelight.health.alignment import Strips, occlusion_votes
from stereorelight.health.eyes import (
    judge_matches,
    judge_mirrored,
    judge_rig_stale,
    judge_roll,
    judge_swapped,
    judge_upside_down,
    judge_vertical,
    judge_zoom,
)
from stereorelight.health.finding import Finding, worst
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named

SIZE = (640, 360)
TENTH = 0.1  # the bound on the size of each fault
STALE_DEG = 0.3


@dataclass(frozen=True)
class Plates:
    rig: Rig
    left: np.ndarray
    right: np.ndarray


def shot(scene: str, rig_name: str) -> Plates:
    rig = rig_named(rig_name, SIZE)
    made = render(scene_named(scene), rig, samples=2, noise_sigma=0.004, shadows=False)
    return Plates(rig, made.left["plate"], made.right["plate"])


@pytest.fixture(scope="module")
def clean() -> Plates:
    return shot("box", "parallel")


@pytest.fixture(scope="module")
def converged() -> Plates:
    return shot("sphere", "toed-in")


def moved(picture: np.ndarray, *, down_px: float = 0, clockwise_deg: float = 0, zoom: float = 1) -> np.ndarray:
    """The picture shifted, turned and enlarged about its middle (Lanczos)."""
    h, w = picture.shape[:2]
    middle, a = np.array([(w - 1) / 2, (h - 1) / 2]), math.radians(clockwise_deg)
    A = zoom * np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    pixels = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1)
    source = (pixels - middle - (0, down_px)) @ np.linalg.inv(A).T + middle
    return np.nan_to_num(resample(picture, source.astype(np.float32)))


def findings(plates: Plates, right: np.ndarray | None = None) -> dict[str, Finding]:
    """Everything that is judged here, as the check puts it together."""
    right = plates.right if right is None else right
    rig = plates.rig
    matches = match_points(plates.left, right, rig=rig)
    drift = solve_drift(rig, matches)
    assert drift.before is not None
    hand = handedness(plates.left, right, rig=rig, as_is=matches)
    exchanged = Matches(left=matches.right, right=matches.left, sigma_px=matches.sigma_px, size=matches.size)
    found = [
        judge_matches([(None, len(matches))]),
        judge_mirrored(hand.as_is, hand.mirrored),
        judge_upside_down(hand.upside_down),
        judge_swapped(
            occlusion_votes(plates.left, right, matches.left, matches.right),
            behind=float(behind_rig(rig, matches, tolerance_deg=STALE_DEG).mean()),
            behind_exchanged=float(behind_rig(rig, exchanged, tolerance_deg=STALE_DEG).mean()),
        ),
        judge_vertical([(None, drift.before.median)], p95_px=drift.before.p95, grid=drift.before.map, after_rig=True),
        judge_roll(-drift.roll_deg, drift.sigmas["roll_deg"], after_rig=True),
        judge_zoom(100 * (drift.zoom - 1), 100 * drift.sigmas["zoom"], after_rig=True),
        judge_rig_stale(
            drift.angles_deg,
            100 * (drift.zoom - 1),
            drift.sigmas,
            held=drift.held,
            before_px=drift.before.median,
            held_out_before_px=drift.held_out_before,
            held_out_after_px=drift.held_out_after,
        ),
    ]
    for finding in found:
        assert "\n" not in finding.words
        assert (finding.level in ("good", "unknown")) or finding.remedy, finding
        assert "nan" not in finding.words
    return {finding.name: finding for finding in found}


def test_a_clean_shot_raises_nothing(clean: Plates) -> None:
    told = findings(clean)
    assert worst(told.values()) == "good", [f for f in told.values() if f.level != "good"]
    assert "rows agree to 0.0" in told["rig_stale"].words


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "rig"), [("bust", "hard"), ("box", "distorted"), ("sphere", "offset")])
def test_clean_shots_of_rigs_that_are_no_rectified_pair_raise_nothing(scene: str, rig: str) -> None:
    plates = shot(scene, rig)
    brighter = (plates.right * 2**0.7).astype(np.float32)
    told = findings(plates, brighter)
    assert worst(told.values()) == "good", [f for f in told.values() if f.level != "good"]
    assert findings(Plates(plates.rig, brighter, plates.left))["swapped"].level == "bad"


def test_three_pixels_of_vertical_shift(clean: Plates) -> None:
    right = moved(clean.right, down_px=3)
    told = findings(clean, right)
    assert told["vertical"].level == "bad"
    assert told["vertical"].value == pytest.approx(3, rel=TENTH)
    np.testing.assert_allclose(np.array(told["vertical"].details["map_px"], float), 3, rtol=TENTH)
    assert told["rig_stale"].level == "bad"
    assert 'drift = "shot"' in told["rig_stale"].remedy
    assert told["roll"].level == told["zoom"].level == "good"
    matches = match_points(clean.left, right, rig=clean.rig)
    assert relative_alignment(matches).vertical_px == pytest.approx(3, rel=TENTH)
    assert mended_px(clean.rig, matches) <= 0.1


def mended_px(rig: Rig, matches: Matches) -> float:
    """Mean |dy| of all matches after the mending."""
    return vertical_error(apply(rig, solve_drift(rig, matches)), matches).mean


def test_four_thousandths_of_zoom(clean: Plates) -> None:
    right = moved(clean.right, zoom=1.004)
    told = findings(clean, right)
    assert told["zoom"].level == "warn"
    assert told["zoom"].value == pytest.approx(0.4, rel=TENTH)
    assert "larger by 0.40" in told["zoom"].words
    assert told["rig_stale"].level == "warn"
    assert "zoom +0.40" in told["rig_stale"].words
    assert told["rig_stale"].details["zoom_percent"] == pytest.approx(0.4, rel=TENTH)
    assert told["roll"].level == "good"
    raw = relative_alignment(match_points(clean.left, right))
    assert 100 * (raw.zoom - 1) == pytest.approx(0.4, rel=TENTH)
    assert abs(raw.roll_deg) < 0.02
    assert judge_zoom(100 * (raw.zoom - 1), 100 * raw.zoom_sigma, after_rig=False).level == "warn"
    assert mended_px(clean.rig, match_points(clean.left, right, rig=clean.rig)) <= 0.1


@pytest.mark.parametrize("roll", [0.5, -0.5])
def test_half_a_degree_of_roll(clean: Plates, roll: float) -> None:
    right = moved(clean.right, clockwise_deg=roll)
    told = findings(clean, right)
    assert told["roll"].level == "bad"
    assert told["roll"].value == pytest.approx(roll, rel=TENTH)
    assert ("anticlockwise" in told["roll"].words) == (roll < 0)
    assert told["rig_stale"].details["roll_deg"] == pytest.approx(-roll, rel=TENTH)  # the eye turned the other way
    assert told["zoom"].level == "good"
    raw = relative_alignment(match_points(clean.left, right))
    assert raw.roll_deg == pytest.approx(roll, rel=TENTH)
    assert abs(raw.vertical_px) < 0.05
    assert mended_px(clean.rig, match_points(clean.left, right, rig=clean.rig)) <= 0.1


def swapped(left: np.ndarray, right: np.ndarray) -> Strips:
    matches = match_points(left, right)
    return occlusion_votes(left, right, matches.left, matches.right)


def test_swapped_is_told_by_strips_and_by_the_rig(clean: Plates) -> None:
    told = findings(Plates(clean.rig, clean.right, clean.left))["swapped"]
    assert told.level == "bad"
    assert "behind the rig" in told.words
    assert "half-hidden strips" in told.words


def test_strips_alone_tell_a_converged_pair(converged: Plates) -> None:
    """A converged rig may put no point behind itself when the eyes are swapped: the strips need no rig."""
    right_way, wrong_way = swapped(converged.left, converged.right), swapped(converged.right, converged.left)
    assert judge_swapped(right_way).level == "good"
    assert judge_swapped(wrong_way).level == "bad"
    assert right_way.swapped_share < 0.2
    assert wrong_way.swapped_share > 0.8


def test_strips_tell_a_real_pair() -> None:
    pair = motorcycle()
    left, right = (((eye / 255.0) ** 2.2).astype(np.float32) for eye in (pair.left, pair.right))
    assert swapped(left, right).swapped_share < 0.25
    assert swapped(right, left).swapped_share > 0.75


def test_a_wall_has_no_strips_and_nothing_is_claimed() -> None:
    plates = shot("plane", "parallel")
    strips = swapped(plates.left, plates.right)
    assert strips.verdict == "unclear"
    told = judge_swapped(strips)
    assert told.level == "unknown"
    assert told.remedy


def test_rig_against_strips_is_a_warning() -> None:
    told = judge_swapped(Strips(behind=200, before=10), behind=0.9, behind_exchanged=0.0)
    assert told.level == "warn"
    assert "disagree" in told.words


@pytest.mark.parametrize("eye", ["left", "right"])
def test_mirrored(clean: Plates, eye: str) -> None:
    flip: Callable[[np.ndarray], np.ndarray] = lambda picture: np.ascontiguousarray(picture[:, ::-1])  # noqa: E731
    left, right = (flip(clean.left), clean.right) if eye == "left" else (clean.left, flip(clean.right))
    blind = handedness(left, right)
    told = judge_mirrored(blind.as_is, blind.mirrored, in_front=blind.in_front)
    assert told.level == "bad"
    assert "pictures cannot tell" in told.words
    with_rig = handedness(left, right, rig=clean.rig)
    told = judge_mirrored(with_rig.as_is, with_rig.mirrored, in_front=with_rig.in_front)
    assert told.details["eye"] == eye
    assert f'"mirrored": "{eye}"' in told.remedy
    declared = judge_mirrored(with_rig.as_is, with_rig.mirrored, declared="right")
    assert "although the rig's right eye has been flipped back" in declared.words


def test_upside_down(clean: Plates) -> None:
    told = handedness(clean.left, np.ascontiguousarray(clean.right[::-1, ::-1]))
    assert judge_upside_down(told.upside_down).level == "bad"
    assert judge_mirrored(told.as_is, told.mirrored).level == "good"
    both = handedness(clean.left, np.ascontiguousarray(clean.right[::-1]))
    assert both.upside_down
    assert judge_mirrored(both.as_is, both.mirrored).level == "bad"


def test_few_matches_are_said_and_refused() -> None:
    assert judge_matches([(1, 500), (2, 40)]).level == "bad"
    assert judge_matches([(1, 500), (2, 40)]).words.startswith("Frame 2 has 40 points")
    assert judge_matches([(None, 100)]).level == "warn"
    few = Matches(left=np.zeros((59, 2)), right=np.zeros((59, 2)), sigma_px=np.ones(59), size=SIZE)
    with pytest.raises(PlateError, match=r"only 59 matches .* needs 60"):
        relative_alignment(few)
    assert judge_mirrored(10, 12).level == "unknown"
    assert judge_vertical([(1, math.nan)], after_rig=True).level == "unknown"


def test_what_no_turn_explains_is_not_called_stale() -> None:
    sigmas = dict.fromkeys(("pitch_deg", "yaw_deg", "roll_deg", "zoom"), 1e-3)
    told = judge_rig_stale((0.2, 0, 0), 0.0, sigmas, before_px=0.9, held_out_before_px=0.9, held_out_after_px=0.85)
    assert told.level == "unknown"
    assert "no turn or zoom" in told.words
