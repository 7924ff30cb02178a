"""Exposure, colour and shading between the eyes, clipped and crushed areas: a known fault goes in, its size comes out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.errors import PassError
from stereorelight.health.clipping import clipping, judge_clipping, judge_crushing
from stereorelight.health.exposure import exposure_difference
from stereorelight.health.exposure_verdict import judge_colour, judge_exposure, judge_shading
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named

SIZE = 0.10  # every fault's size is found to a tenth of it
RED_CAST = np.float32(1.15) * np.array([1.06, 1.0, 0.97], np.float32)  # +15 %, with a red cast


@dataclass(frozen=True)
class Pair:
    left: Float32
    right: Float32
    disparity: Float32


def grainy(plate: Float32, sigma: float, seed: int) -> Float32:
    return (plate + np.float32(sigma) * np.random.default_rng(seed).standard_normal(plate.shape, dtype=np.float32)).astype(np.float32)


@pytest.fixture(scope="module")
def bust() -> Pair:
    shot = render(scene_named("bust"), rig_named("parallel", (320, 180)), samples=2)
    disparity = np.where(shot.left["flags"] == 0, shot.left["disparity"], np.float32(np.nan))
    return Pair(left=shot.left["plate"], right=shot.right["plate"], disparity=disparity)


@pytest.fixture(scope="module")
def street() -> Pair:
    pair = motorcycle()

    def linear(picture: np.ndarray) -> Float32:
        v = picture.astype(np.float32) / 255
        return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)

    return Pair(left=linear(pair.left), right=linear(pair.right), disparity=np.where(pair.nonoccluded, pair.disparity, np.float32(np.nan)))


# 0.17 clips half of the brighter eye
@pytest.mark.parametrize(
    ("sigma", "clip"), [(0.0, 9.0), (0.005, 9.0), (0.02, 9.0), (0.0, 0.3), (0.005, 0.3), (0.02, 0.3), (0.0, 0.17), (0.005, 0.17)]
)
def test_a_red_cast_and_15_per_cent_are_found(bust: Pair, sigma: float, clip: float) -> None:
    left = np.minimum(grainy(bust.left, sigma, 1), np.float32(clip))
    right = np.minimum(grainy(bust.right * RED_CAST, sigma, 2), np.float32(clip))
    found = exposure_difference(left, right, disparity=bust.disparity)
    assert found.method == "matches"
    assert found.gain == pytest.approx(RED_CAST, rel=0.003)
    assert found.stops == pytest.approx(np.log2(1.15), rel=SIZE)
    assert found.cast == pytest.approx((0.06, 0.0, -0.03), rel=SIZE)
    assert found.offset == (0.0, 0.0, 0.0)
    finding = judge_exposure([(1, found)])
    assert (finding.level, finding.unit) == ("warn", "stops")
    assert "brighter" in finding.words
    assert 'match_colour = "global"' in finding.remedy
    assert judge_colour([(1, found)]).value == pytest.approx(6.0, rel=SIZE)
    assert judge_colour([(1, found)]).level == "warn"
    assert judge_shading([(1, found)]).level == "good"


def test_matched_points_do_as_well_as_a_disparity(bust: Pair) -> None:
    y, x = np.nonzero(np.isfinite(bust.disparity))
    chosen = np.random.default_rng(3).choice(len(x), 800, replace=False)
    points = np.stack([x[chosen], y[chosen]], axis=1).astype(np.float64)
    over = points - np.stack([bust.disparity[y[chosen], x[chosen]], np.zeros(800)], axis=1)
    over[::5] = over[::5][::-1]  # a fifth of the matches are wrong
    found = exposure_difference(grainy(bust.left, 0.005, 1), grainy(bust.right * RED_CAST, 0.005, 2), points_left=points, points_right=over)
    assert found.gain == pytest.approx(RED_CAST, rel=0.01)


def test_tones_do_where_there_are_no_matches(bust: Pair) -> None:
    found = exposure_difference(grainy(bust.left, 0.005, 1), grainy(bust.right * RED_CAST, 0.005, 2))
    assert found.method == "tones"
    assert found.gain == pytest.approx(RED_CAST, rel=0.03)
    clean = exposure_difference(bust.left, bust.right)
    assert judge_exposure([(1, clean)]).level == "good"
    assert judge_colour([(1, clean)]).level in ("good", "note")
    assert judge_shading([(1, clean)]).level == "unknown"


def test_on_a_real_pair_the_fault_adds_to_what_is_there(street: Pair) -> None:
    before = exposure_difference(street.left, street.right, disparity=street.disparity)
    after = exposure_difference(street.left, np.minimum(street.right * RED_CAST, np.float32(1)), disparity=street.disparity)
    assert np.array(after.gain) / before.gain == pytest.approx(RED_CAST, rel=0.01)
    for judge in (judge_exposure, judge_colour, judge_shading):
        assert judge([(None, before)]).level in ("good", "note"), judge([(None, before)]).words


def test_a_veil_is_an_offset(bust: Pair) -> None:
    found = exposure_difference(bust.left, bust.right + np.float32(0.01), disparity=bust.disparity)
    assert found.offset == pytest.approx((0.01, 0.01, 0.01), rel=SIZE)
    assert found.gain == pytest.approx((1, 1, 1), rel=0.01)
    assert "veil" in judge_exposure([(1, found)]).words


@pytest.mark.parametrize("stops", [0.3, -0.6])
def test_shading_across_the_frame_is_mapped(bust: Pair, stops: float) -> None:
    across = np.linspace(-0.5, 0.5, bust.left.shape[1], dtype=np.float32)
    found = exposure_difference(
        grainy(bust.left, 0.003, 1), grainy(bust.right * 2 ** (stops * across)[None, :, None], 0.003, 2), disparity=bust.disparity
    )
    columns = np.nanmedian(found.local_stops[..., 1], axis=0)
    assert columns[-1] - columns[0] == pytest.approx(stops * 7 / 8, rel=SIZE)  # between the centres of the outer cells
    assert found.shading_stops == pytest.approx(abs(stops) * 7 / 8, rel=SIZE)
    finding = judge_shading([(1, found)])
    assert finding.level == "warn"
    assert 'match_colour = "local"' in finding.remedy
    brightest = finding.words.split("brightest")[1].split(",")[0]
    assert ("right" if stops > 0 else "left") in brightest


def test_a_clean_pair_raises_nothing(bust: Pair) -> None:
    for sigma in (0.0, 0.01):
        found = exposure_difference(grainy(bust.left, sigma, 1), grainy(bust.right, sigma, 2), disparity=bust.disparity)
        assert [judge([(1, found)]).level for judge in (judge_exposure, judge_colour, judge_shading)] == ["good"] * 3
        left, right = clipping(grainy(bust.left, sigma, 1)), clipping(grainy(bust.right, sigma, 2))
        assert [judge([(1, left)], [(1, right)]).level for judge in (judge_clipping, judge_crushing)] == ["good", "good"]


def test_an_iris_that_moves_is_told(bust: Pair) -> None:
    shot = [(1000 + n, exposure_difference(bust.left, bust.right * np.float32(2 ** (0.03 * n)), disparity=bust.disparity)) for n in range(4)]
    finding = judge_exposure(shot)
    assert finding.details["swing_stops"] == pytest.approx(0.09, rel=SIZE)
    assert "frame 1003" in finding.words
    assert "Lock" in finding.remedy


def test_too_few_matches_are_refused(bust: Pair) -> None:
    points = np.full((20, 2), 50.0)
    with pytest.raises(PassError, match="want 60"):
        exposure_difference(bust.left, bust.right, points_left=points, points_right=points)
    assert judge_exposure([]).level == "unknown"


@pytest.mark.parametrize("level", [0.25, 0.3, 12.0])
@pytest.mark.parametrize("sigma", [0.0, 0.01])
def test_clipping_is_found_wherever_the_curve_ends(bust: Pair, level: float, sigma: float) -> None:
    light = grainy(bust.left, sigma, 1) * np.float32(max(level, 0.3) / 0.3)
    found = clipping(np.minimum(light, np.float32(level)))
    truth = (light >= level).mean(axis=(0, 1))
    assert found.clip_level[0] == pytest.approx(level, rel=1e-3)
    assert found.clipped_share[0] == pytest.approx(truth[0], rel=0.15)  # lone pixels of grain are left out, islands closed
    assert found.clipped_any == pytest.approx((light >= level).any(axis=2).mean(), rel=0.15)
    assert judge_clipping([(1, found)]).level in ("warn", "bad")


def test_a_codecs_tremor_does_not_hide_a_plateau(bust: Pair) -> None:
    light = grainy(bust.left, 0.01, 1)
    clipped = np.minimum(light, np.float32(0.2))
    tremor = grainy(np.ones_like(clipped), 0.003, 5)
    assert clipping(clipped * tremor).clipped_any == pytest.approx((light >= 0.2).any(axis=2).mean(), rel=0.2)


def test_crushed_blacks_are_found(bust: Pair) -> None:
    light = grainy(bust.left, 0.003, 1)
    found = clipping(np.maximum(light, np.float32(0.07)))
    truth = (light <= 0.07).all(axis=2).mean()
    assert found.black_level == pytest.approx((0.07, 0.07, 0.07), abs=1e-3)
    assert found.crushed_any == pytest.approx(truth, rel=0.2)
    assert judge_crushing([(1, found)]).level in ("note", "warn", "bad")


def test_smooth_light_is_not_clipped() -> None:
    y, x = np.mgrid[0:200, 0:300].astype(np.float32)
    ramp = np.repeat((0.1 + x / 300)[..., None], 3, axis=2)
    lamp = np.repeat(np.exp(-((x - 150) ** 2 + (y - 100) ** 2) / 2000)[..., None] + 0.05, 3, axis=2).astype(np.float32)
    tube = np.repeat(np.exp(-((y - 100) ** 2) / 800)[..., None] + 0.05, 3, axis=2).astype(np.float32)
    wall = grainy(np.full((200, 300, 3), 0.8, np.float32), 0.004, 1)
    for picture in (ramp, lamp, tube, wall):
        assert clipping(picture).clipped_any == 0
        if picture is ramp or picture is wall:  # far from the lamp it is one even black
            assert clipping(picture).crushed_any == 0
    hot = wall.copy()
    hot[::50, ::50] = 30
    assert clipping(hot).clipped_any == 0


def test_the_pair_of_a_real_camera_clips_where_it_says_255(street: Pair) -> None:
    found = clipping(street.left)
    assert found.clipped_any == pytest.approx((street.left >= 1).any(axis=2).mean(), rel=0.1)
    assert cv2.countNonZero((street.left[..., 0] >= 1).astype(np.uint8)) / street.left[..., 0].size == pytest.approx(found.clipped_share[0], rel=0.1)
    assert judge_clipping([(None, found)]).level == "note"
