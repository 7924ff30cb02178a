"""Plates given in the wrong order are refused, by the rig or by half-hidden strips; the right way round nothing is, whatever the rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereorelight.camera import Camera, RectifiedRig
from stereorelight.compare.motorcycle import motorcycle_rig
from stereorelight.engine.strips import strip_votes
from stereorelight.errors import PlateError
from stereorelight.stereo.depth import recover
from stereorelight.stereo.halves import half_rig, half_view
from stereorelight.stereo.order import Votes, behind_rig
from stereorelight.stereo.proxy import matching_proxy
from stereorelight.stereo.search import search_range
from tests.benchmarks.bench_depth import pair_of_plates
from tests.benchmarks.bench_depth_scenes import grained

FARTHEST_PX, NEAREST_PX = 5, 62  # all of Motorcycle lies between these disparities
HEIGHT, WIDTH = 12, 60


def cropped(plates: tuple[np.ndarray, np.ndarray], rig: RectifiedRig, px: int) -> tuple[tuple[np.ndarray, np.ndarray], RectifiedRig]:
    """The pair with its outer columns cut so that what had this disparity lies on the screen: as converging cameras or a conform give it."""
    left, right = (np.ascontiguousarray(plate) for plate in (plates[0][:, px:], plates[1][:, : plates[1].shape[1] - px]))

    def camera(of: Camera, shift: int) -> Camera:
        K = of.K.copy()
        K[0, 2] -= shift
        return replace(of, K=K, size=(of.size[0] - px, of.size[1]))

    return (left, right), replace(rig, left=camera(rig.left, px), right=camera(rig.right, 0))


def searched(left: np.ndarray, right: np.ndarray, rig: RectifiedRig, *, draft: bool = False, **distances: float) -> None:
    """What `recover` does before it matches."""
    if draft:
        left, right, rig = half_view(left), half_view(right), half_rig(rig)
    search_range(matching_proxy(left, right, even=not draft), rig, **distances)


@pytest.mark.parametrize("draft", [False, True], ids=["", "draft"])
@pytest.mark.parametrize("grain", [0.0, 0.02])
@pytest.mark.parametrize("screen_px", [0, 31, NEAREST_PX], ids=["as shot", "screen in the middle", "all behind the screen"])
def test_a_real_pair_the_wrong_way_round(screen_px: int, grain: float, draft: bool) -> None:
    left, right, _ = pair_of_plates()
    rng = np.random.default_rng(3)
    plates, rig = cropped((grained(left, grain, rng), grained(right, grain, rng)), motorcycle_rig(), screen_px)
    assert rig.doffs_px == pytest.approx(motorcycle_rig().doffs_px + screen_px)
    searched(*plates, rig, draft=draft)
    with pytest.raises(PlateError, match=r"look swapped.*exchange them"):
        searched(*reversed(plates), rig, draft=draft)


def test_a_run_says_it_before_it_matches() -> None:
    left, right, rectified = pair_of_plates()
    with pytest.raises(PlateError, match="strips that one eye alone sees"):
        recover(right, left, rectified)


def test_who_gives_both_distances_is_believed() -> None:
    """The way out for whoever is refused wrongly, as the message says."""
    left, right, _ = pair_of_plates()
    rig = motorcycle_rig()
    near_m, far_m = (float(rig.depth_from_disparity(d)) for d in (NEAREST_PX, FARTHEST_PX))
    with pytest.raises(PlateError, match="if they are right, give near_m and far_m"):
        searched(right, left, rig, near_m=near_m)
    searched(right, left, rig, near_m=near_m, far_m=far_m)


@pytest.mark.parametrize("screen_px", [10, 40], ids=["before the screen", "behind the screen"])
def test_a_wall_is_the_same_either_way(screen_px: int) -> None:
    """A flat wall has no strips.  A screen so far before it that its matches may be of either order: nothing is claimed."""
    left, _, _ = pair_of_plates()
    wall = (np.ascontiguousarray(left[:, :-20]), np.ascontiguousarray(left[:, 20:]))
    rig = motorcycle_rig()
    rig = replace(rig, left=replace(rig.left, size=(721, 500)), right=replace(rig.right, size=(721, 500)))
    plates, rig = cropped(wall, rig, screen_px)
    searched(*plates, rig)
    searched(*reversed(plates), rig)


def test_both_eyes_must_say_so() -> None:
    """A shadow beside each thing, on one side of it, makes one eye's strips look like the things."""
    assert Votes(behind=(5, 6), before=(70, 80)).swapped
    assert not Votes(behind=(5, 40), before=(150, 45)).swapped
    assert not Votes(behind=(0, 0), before=(500, 3)).swapped
    assert not Votes(behind=(3, 2), before=(25, 25)).swapped, "too few"
    assert not Votes(behind=(70, 80), before=(5, 6)).swapped
    assert not Votes(behind=(0, 0), before=(0, 0)).swapped


def test_shares_behind_the_rig() -> None:
    d = np.array([-40.0, -20.0, 0.0, 20.0, 40.0], np.float32)
    assert behind_rig(d, -30.0) == (0.2, 0.2)
    assert behind_rig(d, 0.0) == (0.4, 0.4)
    assert behind_rig(d + 25, -30.0) == (0.0, 0.4)
    assert behind_rig(-d - 25, -30.0) == (0.4, 0.0), "exchanged"


def strip(*, like: float, width: int = 8, step: float = 8.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dark ground at 2 px, a strip of this grey that nobody confirms, and a bright thing at `step` more."""
    picture = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    disparity = np.full((HEIGHT, WIDTH), 2, np.float32)
    picture[:, 30:], disparity[:, 30:] = 200, 2 + step
    picture[:, 30 - width : 30], disparity[:, 30 - width : 30] = like, np.nan
    return picture, disparity, np.ones((HEIGHT, WIDTH), np.bool_)


def test_strips_vote_for_what_they_look_like() -> None:
    sure = {"settled": 0.8, "doubt": 1.0}
    for settings in ({}, sure):
        assert strip_votes(*strip(like=45), **settings) == (HEIGHT, 0)
        assert strip_votes(*strip(like=190), **settings) == (0, HEIGHT)
        assert strip_votes(*strip(like=120), **settings) == (0, 0), "like neither"
        assert strip_votes(*strip(like=45, width=16), **settings) == (0, 0), "too wide for the jump beside it"
        assert strip_votes(*strip(like=45, step=-8), **settings) == (0, 0), "no ground is hidden there"
        assert strip_votes(*strip(like=45, width=2, step=2), **settings) == (0, 0), "too narrow"
    picture, disparity, known = strip(like=45)
    known[3, 24] = False
    assert strip_votes(picture, disparity, known) == (HEIGHT - 1, 0)
    disparity[:, 31:36:2] = np.nan  # of the thing, every second pixel: it may be anything
    assert strip_votes(picture, disparity, known) == (HEIGHT - 1, 0)
    assert strip_votes(picture, disparity, known, **sure) == (0, 0)


def test_doubt_asks_for_more_where_colours_vary() -> None:
    picture, disparity, known = strip(like=45)
    picture[:, 38:] = 200
    picture[:, 30:38:2], picture[:, 31:38:2] = 30, 90  # a thing that is as dark as the ground in the mean
    assert strip_votes(picture, disparity, known, doubt=1.0) == (0, 0)
    assert strip_votes(picture, disparity, known) == (HEIGHT, 0)
