"""Bare ground lies on the planes that most of it was matched on; ground that bends, that shows otherwise, or on which two ways of matching agree
is left alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stereorelight.stereo import match as matching
from stereorelight.stereo.depth import recover
from stereorelight.stereo.plains import plain_ground
from stereorelight.stereo.proxy import Proxy, matching_proxy
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.semi_global import DisparityRange
from stereorelight.stereo.walls import AS_IF_NOISE, matched_on_walls, on_walls
from stereorelight.synth.rigs import parallel_rig

HEIGHT, WIDTH = 160, 240
Y, X = np.meshgrid(np.arange(HEIGHT, dtype=np.float32), np.arange(WIDTH, dtype=np.float32), indexing="ij")
WALL = (8 + 0.01 * Y + 0.03 * X).astype(np.float32)
CORNER = (18 + 0.01 * Y - 0.08 * np.abs(X - 120)).astype(np.float32)
BOWL = (18 - 8 * ((X - 120) / 120) ** 2 - 5 * ((Y - 80) / 80) ** 2).astype(np.float32)
PATCHES = (np.s_[20:50, 40:80], np.s_[90:140, 60:100], np.s_[60:100, 150:190])
NOWHERE = np.full((HEIGHT, WIDTH), np.nan, np.float32)
ALL = np.ones((HEIGHT, WIDTH), np.bool_)


def pair(truth: np.ndarray, *, marks: float = 0.0, noise: float = 0.5) -> Proxy:
    """Grey on grey, with soft marks of so many grey levels on it."""
    rng = np.random.default_rng(3)
    drawn = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH + 80)).astype(np.float32), (0, 0), 3)
    drawn *= marks / drawn.std()
    left = 120 + drawn[:, 40:-40]
    there = X.copy()  # where a column of the right eye is in the left: x = there - d(there)
    for _ in range(60):
        there = X + cv2.remap(truth, there, Y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    right = 120 + cv2.remap(drawn, there + 40, Y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    greys = [(eye + noise * rng.standard_normal(eye.shape)).astype(np.float32) for eye in (left, right)]
    pictures = [np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2) for grey in greys]
    return Proxy(left=pictures[0], right=pictures[1], left_grey=greys[0], right_grey=greys[1], left_known=ALL, right_known=ALL)


def patchy(truth: np.ndarray) -> np.ndarray:
    """A match that is off by a part of a pixel all over, and patch by patch by pixels."""
    rough = cv2.GaussianBlur(np.random.default_rng(5).standard_normal(truth.shape).astype(np.float32), (0, 0), 6)
    out = truth + 0.3 * rough / rough.std()
    for patch, off in zip(PATCHES, (5, -4, 6), strict=True):
        out[patch] += off
    return out.astype(np.float32)


def put(proxy: Proxy, disparity: np.ndarray, *, led: np.ndarray = NOWHERE, confirmed: np.ndarray = ALL) -> tuple[np.ndarray, np.ndarray]:
    return on_walls(proxy, plain_ground(proxy.left, AS_IF_NOISE), led, disparity, confirmed, grainy=False)


@pytest.mark.parametrize(("truth", "most"), [(WALL, 0.02), (CORNER, 0.06)], ids=["wall", "corner"])  # a corner is found to a few px
def test_a_bare_wall_comes_back_to_its_planes(truth, most) -> None:
    had = patchy(truth)
    found, changed = put(pair(truth), had)
    off = np.abs(found - truth)
    assert changed.mean() > 0.95
    assert np.median(off) < 0.15
    assert np.mean(off > 1) < most < 0.1 < np.mean(np.abs(had - truth) > 1)


def test_ground_that_bends_keeps_what_it_has() -> None:
    had = (BOWL + 0.05 * np.sin(X)).astype(np.float32)
    found, changed = put(pair(BOWL), had)
    assert not changed.any()
    assert np.array_equal(found, had)


def test_what_the_pictures_show_is_not_put_on_a_plane() -> None:
    """A soft-edged thing before the wall, marked softly enough to be plain: its own marks say where it is."""
    truth = WALL.copy()
    truth[PATCHES[2]] += 6
    proxy = pair(truth, marks=2.5)
    assert plain_ground(proxy.left, AS_IF_NOISE)[PATCHES[2]].mean() > 0.9
    found, _ = put(proxy, truth)
    inside = np.s_[70:90, 160:180]
    assert np.abs(found - truth)[inside].max() < 0.5
    blank, _ = put(pair(truth), truth)  # with nothing to show it, it is a patch like any other
    assert np.abs(blank - WALL)[inside].max() < 0.5


def test_ground_on_which_two_ways_of_matching_agree_is_left_alone() -> None:
    had = patchy(WALL)
    found, changed = put(pair(WALL), had, led=had)
    assert not changed.any()
    assert np.array_equal(found, had)


def test_planes_come_from_what_both_eyes_confirm() -> None:
    """Most of the wall is carried off together; what is confirmed tells where it lies."""
    had, confirmed = WALL + 7, np.zeros((HEIGHT, WIDTH), np.bool_)
    confirmed[::2, 100:140] = True
    had[confirmed] = WALL[confirmed]
    found, _ = put(pair(WALL), had.astype(np.float32), confirmed=confirmed)
    assert np.abs(found - WALL)[:, 20:-20].max() < 0.5


def test_ground_that_the_plane_hides_is_left_open_and_both_eyes_agree_on_the_rest() -> None:
    had = patchy(WALL)
    near = np.s_[:, 200:230]
    had[near] = 30  # a thing that hides the wall to its left
    proxy = pair(WALL)
    plain = plain_ground(proxy.left, AS_IF_NOISE)
    plain[near] = False
    left, right, changed = matched_on_walls(proxy, plain, NOWHERE, had, (had, np.full_like(had, np.nan)), grainy=False)
    assert not changed.any()  # nothing is confirmed, so nothing speaks
    lands = np.rint(X - had).astype(int)
    told = np.full_like(had, np.nan)
    inside = (lands >= 0) & (lands < WIDTH)
    told[np.nonzero(inside)[0], lands[inside]] = had[inside]
    left, right, changed = matched_on_walls(proxy, plain, NOWHERE, had, (had, told), grainy=False)
    hidden = np.isnan(left) & changed
    assert hidden[:, 185:195].mean() > 0.8
    assert not hidden[:, 30:150].any()
    y, x = np.nonzero(changed & ~hidden & (X > 40))
    assert np.median(np.abs(right[y, np.floor(x - left[y, x] + 0.5).astype(int)] - left[y, x])) < 0.1


def test_chance_gives_way_where_the_plane_would_be_hidden() -> None:
    """Beside a thing that stands before the wall the other eye sees none of it: what both eyes agree on there is chance, however well it fits."""
    had, proxy = patchy(WALL), pair(WALL)
    near, strip = np.s_[:, 200:230], np.s_[20:140, 166:198]
    had[near] = 52
    had[strip] = 46
    left = proxy.left_grey.copy()
    left[strip] = proxy.right_grey[20:140, 166 - 46 : 198 - 46]
    plain = plain_ground(proxy.left, AS_IF_NOISE)
    plain[near] = False
    found, _ = on_walls(replace(proxy, left_grey=left), plain, NOWHERE, had, ALL, grainy=False)
    assert np.abs(found - WALL)[strip].max() < 0.5
    before = np.s_[30:120, 90:150]  # where the wall would be seen, it is not
    had[before] = 26
    left[before] = proxy.right_grey[30:120, 90 - 26 : 150 - 26]
    found, _ = on_walls(replace(proxy, left_grey=left), plain, NOWHERE, had, ALL, grainy=False)
    assert np.mean(found[before] == 26) > 0.6


def test_what_the_other_eye_does_not_confirm_is_not_held_to_how_well_it_fits() -> None:
    """A patch that fits to the last bit 18 px nearer: as a match it stays, and where the other eye says otherwise it goes to the wall."""
    had, proxy = patchy(WALL), pair(WALL)
    patch = np.s_[30:120, 90:150]
    had[patch] = 26
    left = proxy.left_grey.copy()
    left[patch] = proxy.right_grey[30:120, 90 - 26 : 150 - 26]
    proxy, plain = replace(proxy, left_grey=left), plain_ground(proxy.left, AS_IF_NOISE)
    kept, _ = on_walls(proxy, plain, NOWHERE, had, ALL, grainy=False)
    confirmed = ALL.copy()
    confirmed[patch] = False
    found, _ = on_walls(proxy, plain, NOWHERE, had, confirmed, grainy=False)
    assert np.mean(kept[patch] == 26) > 0.6
    assert np.abs(found - WALL)[patch].max() < 0.5


def test_where_grain_is_strong_another_plane_must_fit_that_much_better() -> None:
    """A patch with three times the grain, a part of which the other eye happens to repeat six pixels nearer: on the wall it stays."""
    rng = np.random.default_rng(9)
    had, proxy = WALL.copy(), pair(WALL)
    had[:26] += 6  # so that a second plane is offered
    plain = plain_ground(proxy.left, AS_IF_NOISE)
    left, right = proxy.left_grey.copy(), proxy.right_grey.copy()
    patch = np.s_[70:140, 110:190]
    left[patch] = 120 + 1.5 * rng.standard_normal((70, 80))
    lands = np.rint(X - WALL - 6).astype(int)[patch]
    right[Y[patch].astype(int), lands] = 120 + 0.25 * (left[patch] - 120) + 0.5 * rng.standard_normal((70, 80))
    found, _ = on_walls(replace(proxy, left_grey=left, right_grey=right), plain, NOWHERE, had, ALL, grainy=False)
    assert np.abs(found - WALL)[patch].max() < 0.5


def test_a_bare_wall_behind_a_card_is_found(monkeypatch) -> None:
    """Plates of 8 bit with hardly anything on the wall: it is found far better than without its planes."""
    rng = np.random.default_rng(8)
    height, width, wall_px, card_px = 240, 420, 8, 24
    soft = cv2.GaussianBlur(rng.standard_normal((height, width + 60)).astype(np.float32), (0, 0), 2.5)
    marks = rng.random((height, width + 60, 3)).astype(np.float32)
    plates = []
    card = np.s_[60:180, 160:280]
    truth = np.full((height, width), wall_px, np.float32)
    truth[card] = card_px
    for d_wall, d_card in ((0, 0), (wall_px, card_px)):
        picture = np.repeat((0.45 + 0.002 * soft / soft.std())[:, d_wall : d_wall + width, None], 3, axis=2)
        picture[60:180, 160 - d_card : 280 - d_card] = 0.2 + 0.5 * marks[60:180, 160:280]
        codes = np.rint(255 * (picture + 0.004 * rng.standard_normal((height, width, 1))))
        plates.append(((np.clip(codes, 0, 255) / 255) ** 2.2).astype(np.float32))
    off = []
    for least in (matching.WALLS_LOST, 2.0):
        monkeypatch.setattr(matching, "WALLS_LOST", least)
        off.append(np.abs(recover(*plates, rectification(parallel_rig((width, height)))).rectified["disparity"] - truth))
    with_planes, without = (100 * np.mean(a[:, 40:] > 1) for a in off)
    print(f"off by more than 1 px: {with_planes:.1f} % with planes, {without:.1f} % without")
    assert with_planes < 6
    assert with_planes < 0.5 * without


def test_black_beyond_the_plate_is_no_wall() -> None:
    """A dark wall that ends at the plate's edge: nothing beyond it is given a disparity."""
    rng = np.random.default_rng(2)
    height, width, edge = 200, 360, 280
    plates = [np.full((height, width, 3), 0.004, np.float32) + 0.0006 * rng.standard_normal((height, width, 1)).astype(np.float32) for _ in range(2)]
    marks = rng.random((60, width + 40, 3)).astype(np.float32)
    for plate, d in zip(plates, (0, 12), strict=True):
        plate[70:130] = marks[:, d : d + width]
        plate[:, edge:] = np.nan
    proxy = matching_proxy(*plates)
    found = matching.match(proxy, DisparityRange.holding(0, 30))
    assert not proxy.left_known[:, edge:].any()
    assert np.isnan(found.left[:, edge + 12 :]).all()
