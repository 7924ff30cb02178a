"""What confidence knows of plain ground, of surfaces that are not even, and of pictures on which matching is lost."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stereorelight.stereo.confidence import (
    DRAFT_COEFFICIENTS,
    DRAFT_FLOORS,
    FEW_LED,
    Evidence,
    confidence_from_evidence,
    evidence,
    floors,
    led_share,
    of_drafts,
    sigma_from_evidence,
    texture,
    uneven,
)
from stereorelight.stereo.depth import matched, refined_with_evidence
from stereorelight.stereo.flow import flow_disparity
from stereorelight.stereo.proxy import Proxy, matching_proxy
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.refine import Refined
from stereorelight.stereo.search import search_range
from stereorelight.stereo.settings import DepthSettings
from stereorelight.synth.rigs import parallel_rig
from tests import plain_scenes

HW = (60, 84)
BOARDS = (plain_scenes.LARGE + 35, plain_scenes.LARGE + 39, plain_scenes.LARGE + 41)


def full(value: float) -> np.ndarray:
    return np.full(HW, value, np.float32)


def usual() -> Evidence:
    """Ground that all speaks for."""
    return Evidence(
        confirmed=full(1), flow_agrees=full(1), confirmed_nearby=full(1), flow_agrees_nearby=full(1), misfit=full(0.5), alone=full(0),
        spread=full(0.1), sigma=full(0.1), clumped=full(0.5), texture=full(3), uneven=full(0.02), lost=0.02,
    )  # fmt: skip


def test_texture_is_the_change_along_the_row_over_the_grain() -> None:
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    assert texture(3 * x + 40 * y, 2.0)[5:-5, 5:-5] == pytest.approx(1.5, abs=1e-3)
    assert texture(40 * y, 2.0).max() < 1e-3


def test_a_plane_is_even_and_a_stair_is_not() -> None:
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    plane = 400 + 0.11 * x - 0.07 * y
    inside = (slice(16, -16), slice(16, -16))
    assert uneven(plane)[inside].max() < 2e-3
    stair = 400 + 2 * np.floor(y / 16)
    assert 0.3 < np.median(uneven(stair.astype(np.float32))[inside]) < 0.6


@pytest.mark.parametrize(
    "worse", [{"texture": full(0.05)}, {"uneven": full(1)}, {"led": full(0.2)}, {"alone": full(1)}, {"misfit": full(30)}, {"on_walls": full(1)}]
)
def test_each_evidence_against_makes_less_sure(worse) -> None:
    sure, less = (float(confidence_from_evidence(e)[0, 0]) for e in (usual(), replace(usual(), **worse)))
    assert less < sure - 0.005


def test_two_ways_of_matching_that_agree_nearby_are_counted_where_both_eyes_see() -> None:
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    speaks = x < HW[1] // 2
    led = np.where(y % 2 == 0, np.float32(5.5), np.float32(8))
    led[y % 4 == 1] = np.nan
    share = led_share(led, full(5), speaks)
    assert share[20:-20, : HW[1] // 2 - 16] == pytest.approx((0.5 + FEW_LED) / (1 + FEW_LED), abs=0.04)
    assert share[:, HW[1] // 2 + 16 :] == pytest.approx(1)  # where nothing speaks nothing is told
    assert np.array_equal(confidence_from_evidence(replace(usual(), led=full(1))), confidence_from_evidence(usual()))


def test_where_matching_is_lost_a_guess_is_told_less() -> None:
    guess = {"confirmed": full(0), "flow_agrees": full(0), "confirmed_nearby": full(0), "flow_agrees_nearby": full(0), "sigma": full(3)}
    told = [float(confidence_from_evidence(replace(usual(), **guess, lost=lost)).min()) for lost in (0.0, 0.1, 0.3)]
    assert told[0] > 0.45 > told[2]  # in real scenes nearer to four in ten of them are right than to six
    assert told == sorted(told, reverse=True)
    for lost in (0.0, 0.3, 1.0):
        assert floors(lost)[1] <= floors(lost)[0]


def test_a_match_where_the_eyes_share_nothing_may_be_off_by_any_amount() -> None:
    e = usual()
    wide, wider = (float(sigma_from_evidence(replace(e, alone=full(a)), full(0.3))[0, 0]) for a in (0, 1))
    assert wider > 3 * wide
    assert float(sigma_from_evidence(replace(e, alone=full(1)), full(0.95))[0, 0]) == pytest.approx(float(sigma_from_evidence(e, full(0.95))[0, 0]))


def test_half_the_size_is_judged_in_pixels_of_the_plate() -> None:
    e = replace(usual(), sigma=full(0.3), spread=full(1), uneven=full(0.2))
    twice = replace(e, sigma=full(0.6), spread=full(2), uneven=full(0.4))
    np.testing.assert_array_equal(confidence_from_evidence(e.in_pixels(2)), confidence_from_evidence(twice))
    assert confidence_from_evidence(twice)[0, 0] < confidence_from_evidence(e)[0, 0]


def test_a_draft_that_was_matched_as_other_pictures_are_is_judged_as_they_are() -> None:
    """Whether SGBM says the same nearby is evidence where it was asked; a quick draft did not ask it."""
    asked = [replace(usual(), led=full(share)).in_pixels(2) for share in (0.1, 1.0)]
    told = [confidence_from_evidence(e, *of_drafts(e)) for e in asked]
    for e, sure in zip(asked, told, strict=True):
        np.testing.assert_array_equal(sure, confidence_from_evidence(e))
    assert told[0][0, 0] < told[1][0, 0] - 0.02
    quick = usual().in_pixels(2)
    np.testing.assert_array_equal(
        confidence_from_evidence(quick, *of_drafts(quick)), confidence_from_evidence(quick, DRAFT_COEFFICIENTS, DRAFT_FLOORS)
    )


def test_ground_on_the_plane_of_its_rims_is_surer_than_it_looks() -> None:
    bare = replace(usual(), texture=full(0.3), sigma=full(0.6), uneven=full(0.3), lost=0.2)
    told = [float(confidence_from_evidence(replace(bare, on_rims=on))[0, 0]) for on in (None, full(0), full(1))]
    assert told[0] == told[1]
    assert told[2] > told[0] + 0.05


def test_a_pixel_is_judged_beside_what_is_usual_in_its_picture() -> None:
    """Eyes that differ by thirty times their grain all over: a pixel of that misfit is as sure as one of grain alone in a picture of grain alone."""
    calm = replace(usual(), misfit=full(1), sigma=full(0.2))
    rough = replace(calm, misfit=full(30), sigma=full(0.2 * 30 ** (1 / 8)))
    told = [float(confidence_from_evidence(e)[0, 0]) for e in (calm, replace(rough, usual=30.0), rough)]
    assert told[1] == pytest.approx(told[0], abs=1e-5)
    assert told[2] < told[0] - 0.01
    np.testing.assert_array_equal(confidence_from_evidence(replace(rough, usual=30.0).in_pixels(1)), confidence_from_evidence(rough))  # a draft


def test_what_is_usual_is_more_than_grain_only_where_the_eyes_differ_all_over() -> None:
    texture_of = cv2.GaussianBlur(np.random.default_rng(3).standard_normal((120, 200)), (0, 0), 2)
    left = (110 + 90 * texture_of / np.abs(texture_of).max()).astype(np.float32)
    grain = np.random.default_rng(4).standard_normal((3, 120, 200)).astype(np.float32)
    rough = cv2.GaussianBlur(grain[2], (0, 0), 1.5) * 60

    def found(right: np.ndarray) -> float:
        greys, known = (left + 2 * grain[0], right), np.ones((120, 200), np.bool_)
        pictures = [np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2) for grey in greys]
        proxy = Proxy(left=pictures[0], right=pictures[1], left_grey=greys[0], right_grey=greys[1], left_known=known, right_known=known)
        flat = np.zeros((120, 200), np.float32)
        refined = Refined(disparity=flat, slope_x=flat, slope_y=flat, unseen=flat > 0, sigma_px=flat + 1, slope_sigma=flat, clumped=flat + 1)
        return evidence(proxy, refined, flat == 0, None).usual

    assert found(left + 2 * grain[1]) == 1
    assert found(left + 2 * grain[1] + rough) > 5


def test_boards_that_had_no_part_in_the_fit() -> None:
    """Plain squares that fill the frame: what lies on rims is right, and told so; all of it within 0.1 of what it is told, on average."""
    rectified = rectification(parallel_rig((plain_scenes.W, plain_scenes.H)))
    told, right, mended = [], [], []
    for number in BOARDS:
        left, right_plate, truth, _ = plain_scenes.plain_pair(number)
        proxy = matching_proxy(*(rectified.rectify(plate, eye, to_match=True) for plate, eye in ((left, "left"), (right_plate, "right"))))
        settings = DepthSettings()
        found = matched(proxy, search_range(proxy, rectified.rig), settings)
        refined, _, speaks = refined_with_evidence(proxy, found, settings, flow_disparity(proxy))
        known = np.isfinite(truth)
        told.append(confidence_from_evidence(speaks)[known])
        right.append((np.abs(refined.disparity - truth) <= 1)[known])
        mended.append(np.zeros(known.sum(), np.bool_) if speaks.on_rims is None else speaks.on_rims[known] > 0)
    sure, good, on = (np.concatenate(parts) for parts in (told, right, mended))
    assert on.mean() > 0.1
    assert good[on].mean() > 0.9
    assert sure[on].mean() == pytest.approx(good[on].mean(), abs=0.1)
    assert sure.mean() == pytest.approx(good.mean(), abs=0.1)
