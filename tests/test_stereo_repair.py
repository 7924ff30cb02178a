"""Repairs of a depth: known geometry in, held exactly; nothing outside a matte moves; carried in time and to the other eye."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError
from stereorelight.passes import Flag, Frame
from stereorelight.stereo.carry import carried_matte, carry, flow_picture, nothing_carried, white_of
from stereorelight.stereo.repair import Fix, Pin, fix_in_other_eye, pin_shifts, repaired
from stereorelight.synth.rigs import parallel_rig, toed_in_rig

SIZE = (120, 80)
CAMERA = Camera(size=SIZE, K=np.array([[110.0, 0, 59], [0, 112.0, 40], [0, 0, 1]]), distortion=(-0.12, 0.03, 0.001, 0))
PLANE = np.array([0.1, -0.06, 0.4])  # 1/Z = a x/z + b y/z + c


def slanted() -> np.ndarray:
    return (1 / (CAMERA.ray_grid()[..., :2].astype(np.float64) @ PLANE[:2] + PLANE[2])).astype(np.float32)


def frame(Z: np.ndarray) -> Frame:
    h, w = Z.shape
    return Frame(
        passes={"Z": Z, "confidence": np.full((h, w), 0.4, np.float32), "flags": np.full((h, w), Flag.FILLED | Flag.UNMATCHED, np.uint16)},
        camera=CAMERA,
    )


@pytest.fixture
def matte() -> np.ndarray:
    m = np.zeros(SIZE[::-1], np.float32)
    m[20:60, 30:90] = 1
    return m


def test_constant_holds_inside_its_matte_and_touches_nothing_else(matte) -> None:
    Z = slanted()
    got, done = repaired(frame(Z), [Fix(name="card", kind="constant", matte=matte, distance_m=1.7)])
    inside = matte > 0.5
    assert (got["Z"][inside] == np.float32(1.7)).all()
    np.testing.assert_array_equal(got["Z"][~inside], Z[~inside])
    assert (got["flags"][inside] == Flag.REPAIRED).all()
    assert (got["flags"][~inside] == Flag.FILLED | Flag.UNMATCHED).all()
    assert (got["confidence"][inside] > 0.9).all()
    assert done[0]["pixels"] == inside.sum()


def test_a_plane_is_fitted_through_noise_and_wrong_matches_and_lens(matte) -> None:
    rng = np.random.default_rng(1)
    Z = slanted()
    bad = (1 / (1 / Z + 0.004 * rng.standard_normal(Z.shape))).astype(np.float32)
    wrong = (rng.random(Z.shape) < 0.15) & (matte > 0.5)
    bad[wrong] = 0.9
    bad[30:40, 40:60] = np.nan
    got, _ = repaired(frame(bad), [Fix(name="wall", kind="plane", matte=matte)])
    inside = matte > 0.5
    assert np.abs(1 / got["Z"][inside] - 1 / Z[inside]).max() < 0.002, "half of one pixel's own noise, over the whole plane"


def test_a_plane_through_three_pins_is_exact(matte) -> None:
    Z = slanted()
    pins = tuple(Pin(x=x, y=y, distance_m=float(Z[y, x])) for x, y in ((10, 10), (100, 15), (50, 70)))
    got, _ = repaired(frame(np.full_like(Z, np.nan)), [Fix(name="wall", kind="plane", matte=matte, pins=pins)])
    np.testing.assert_allclose(got["Z"][matte > 0.5], Z[matte > 0.5], rtol=2e-5)
    assert np.isnan(got["Z"][matte <= 0.5]).all()


def test_pins_hold_and_relief_stays(matte) -> None:
    Z = slanted()
    off = (1 / (1 / Z - 0.03)).astype(np.float32)
    pins = (Pin(x=40, y=30, distance_m=float(Z[30, 40])), Pin(x=80, y=50, distance_m=float(Z[50, 80])))
    got, _ = repaired(frame(off), [Fix(name="tape", kind="pins", matte=matte, pins=pins)])
    inside = matte > 0.5
    np.testing.assert_allclose(1 / got["Z"][inside], 1 / Z[inside], atol=2e-3)
    for pin in pins:
        assert got["Z"][round(pin.y), round(pin.x)] == pytest.approx(pin.distance_m, rel=2e-3)
    np.testing.assert_array_equal(got["Z"][~inside], off[~inside])


def test_the_clean_plate_stands_behind_the_actor() -> None:
    clean = np.full(SIZE[::-1], 3.0, np.float32)
    Z = clean + np.float32(0.02) * np.random.default_rng(2).standard_normal(clean.shape).astype(np.float32)
    Z[:, :40] = 1.2  # the actor
    Z[30:, 40:60] = 2.2  # a skirt of guesses behind her
    Z[:10, 100:] = 4.5  # a wrong match behind the set
    known = frame(Z)
    flags = np.zeros(Z.shape, np.uint16)
    flags[30:, 40:60] = Flag.OCCLUDED | Flag.FILLED
    got, _ = repaired(Frame(passes={**known.passes, "flags": flags}, camera=CAMERA), [Fix(name="set", kind="clean_plate", clean_Z=clean)])
    assert (got["Z"][:, :40] == np.float32(1.2)).all()
    assert (got["flags"][:, :40] == 0).all()
    assert (got["Z"][:, 40:] == 3.0).mean() > 0.99


def test_fixes_follow_each_other_in_order(matte) -> None:
    smaller = np.zeros_like(matte)
    smaller[30:40, 40:50] = 1
    fixes = [Fix(name="a", kind="constant", matte=matte, distance_m=2.0), Fix(name="b", kind="constant", matte=smaller, distance_m=1.5)]
    got, done = repaired(frame(slanted()), fixes)
    assert got["Z"][35, 45] == np.float32(1.5)
    assert got["Z"][22, 32] == np.float32(2.0)
    assert [d["name"] for d in done] == ["a", "b"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "constant"}, "needs distance_m > 0"),
        ({"kind": "constant", "distance_m": -1.0}, "needs distance_m > 0"),
        ({"kind": "constant", "distance_m": 1.0, "matte": None}, "needs a matte"),
        ({"kind": "pins"}, "at least one pin"),
        ({"kind": "plane", "pins": (Pin(x=1, y=1, distance_m=1.0),)}, "three or more"),
        ({"kind": "clean_plate"}, "empty set"),
        ({"kind": "pins", "pins": (Pin(x=1, y=1, distance_m=0.0),)}, "must be > 0 metres"),
    ],
)
def test_a_fix_that_cannot_be_is_refused(matte, change, words) -> None:
    with pytest.raises(ShotError, match=words):
        Fix(**{"name": "x", "matte": matte, **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "constant", "distance_m": 1.0, "matte": np.ones((5, 5), np.float32)}, "matte is 5x5, the plate 120x80"),
        ({"kind": "constant", "distance_m": 1.0, "matte": np.zeros((80, 120), np.float32)}, "matte is empty"),
        ({"kind": "pins", "pins": (Pin(x=500, y=1, distance_m=1.0),)}, "outside the plate"),
        ({"kind": "pins", "pins": (Pin(x=5, y=5, distance_m=1.0),)}, "no depth inside the matte at pin"),
        ({"kind": "pins", "pins": (Pin(x=40, y=40, shift_per_m=-5.0),)}, "beyond infinity"),
        ({"kind": "plane", "pins": tuple(Pin(x=10.0 * k, y=40, distance_m=1.0) for k in range(3))}, "one line"),
        ({"kind": "clean_plate", "clean_Z": np.ones((4, 4), np.float32)}, "depth is 4x4"),
    ],
)
def test_a_fix_that_does_not_fit_the_frame_is_told(matte, change, words) -> None:
    straight = Camera(size=CAMERA.size, K=CAMERA.K)
    plain = Frame(passes=frame(slanted()).passes, camera=straight)
    with pytest.raises(PassError, match=words):
        repaired(plain, [Fix(**{"name": "x", "matte": matte, **change})])


def moving(steps: int, *, size=(160, 100)) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Plates of a disc that moves by (3, 1) px a frame over a still wall, and its true mattes."""
    rng = np.random.default_rng(7)
    w, h = size
    wall = cv2.GaussianBlur(rng.random((h, w)).astype(np.float32), (0, 0), 1.5)
    skin = cv2.GaussianBlur(rng.random((h, w)).astype(np.float32), (0, 0), 1.5)
    y, x = np.mgrid[:h, :w].astype(np.float32)
    plates, mattes = [], []
    for t in range(steps):
        dx, dy = 3.0 * t, 1.0 * t
        disc = ((x - 50 - dx) ** 2 + (y - 45 - dy) ** 2 < 24**2).astype(np.float32)
        moved = cv2.warpAffine(skin, np.float32([[1, 0, dx], [0, 1, dy]]), size, borderMode=cv2.BORDER_WRAP)
        picture = np.where(disc > 0.5, 0.3 + 0.5 * moved, 0.05 + 0.5 * wall)
        plates.append(np.repeat(picture[..., None], 3, axis=2).astype(np.float32))
        mattes.append(disc)
    return plates, mattes


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float(((a > 0.5) & (b > 0.5)).sum() / ((a > 0.5) | (b > 0.5)).sum())


def test_paint_is_carried_with_what_it_was_painted_on() -> None:
    plates, mattes = moving(8)
    white = white_of(plates[0])
    pictures = [flow_picture(p, white) for p in plates]
    carried = nothing_carried(mattes[0].shape, np.float32([[55, 40]]))
    np.testing.assert_array_equal(carried_matte(mattes[0], carried, pictures[0]) > 0.5, mattes[0] > 0.5)
    for then, now in pairwise(pictures):
        carried = carry(carried, then, now)
    assert overlap(carried_matte(mattes[0], carried, pictures[7]), mattes[7]) > 0.9
    assert overlap(mattes[0], mattes[7]) < 0.5, "or it would prove nothing"
    np.testing.assert_allclose(carried.points[0], (55 + 21, 40 + 7), atol=0.7)


def test_nothing_is_carried_over_a_cut() -> None:
    rng = np.random.default_rng(3)
    one, other = (
        flow_picture(np.repeat(cv2.GaussianBlur(rng.random((90, 120)).astype(np.float32), (0, 0), 1)[..., None], 3, axis=2), 1.0) for _ in "ab"
    )
    assert carry(nothing_carried((90, 120), np.zeros((0, 2), np.float32)), one, other) is None


def test_pins_travel_as_shifts(matte) -> None:
    Z = slanted()
    fix = Fix(name="tape", kind="pins", matte=matte, pins=(Pin(x=50, y=40, distance_m=1.5),))
    (pin,) = pin_shifts(Z, fix)
    assert pin.shift_per_m == pytest.approx(1 / 1.5 - 1 / float(Z[40, 50]), abs=2e-3)


@pytest.mark.parametrize("make", [parallel_rig, toed_in_rig])
def test_a_fix_lies_on_the_same_surface_in_the_other_eye(make) -> None:
    rig = make((160, 90))
    Z_left = np.full((90, 160), 2.5, np.float32)
    matte = np.zeros((90, 160), np.float32)
    matte[20:70, 50:120] = 1
    Z_left[matte > 0.5] = 1.5
    fix = Fix(name="card", kind="constant", matte=matte, distance_m=1.5)
    other = fix_in_other_eye(fix, Z_left, rig)
    right = Frame(passes={"Z": np.full((90, 160), 2.5, np.float32)}, camera=rig.right)
    got, _ = repaired(right, [other])
    inside = other.matte > 0.5
    points = rig.right.unproject(rig.right.pixel_grid().reshape(90, 160, 2)[inside], got["Z"][inside])
    in_left = (points - rig.t_right_left_m) @ rig.R_right_left
    np.testing.assert_allclose(in_left[:, 2], 1.5, rtol=1e-3)
    at = rig.left.project(in_left)
    assert (at[:, 0] > 48).all()
    assert (at[:, 0] < 122).all()
    assert inside.sum() == pytest.approx(matte.sum(), rel=0.05)
