"""Plain ground under grain goes on in its plane: patches that jump off it where no edge is come back, and nothing else does."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from stereorelight.stereo import plains
from stereorelight.stereo.plains import carried_on, ground_of, plane_through, planes_of

HEIGHT, WIDTH = 160, 240
NOISE = 5.0  # grey levels
THING = slice(150, 190)  # columns
OFF_PX = 6.0  # of the thing before the floor
Y, X = np.meshgrid(np.arange(HEIGHT, dtype=np.float32), np.arange(WIDTH, dtype=np.float32), indexing="ij")
FLOOR = (12 + 0.03 * Y + 0.01 * X).astype(np.float32)
PATCH = np.s_[50:90, 190:220]  # to the right of the thing, where both eyes see the floor
BESIDE = np.s_[50:90, 135:150]  # to the left of it, where it hides the floor in the right eye


@dataclass(frozen=True, kw_only=True)
class Scene:
    left: np.ndarray
    right: np.ndarray
    calm: np.ndarray
    truth: np.ndarray

    def carried(self, disparity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return carried_on(self.left, self.right, self.calm, disparity, noise=NOISE, grain2=2 * NOISE**2)


def scene(*, ripple: float = 0.0) -> Scene:
    """A slanted, plain floor and a textured thing before it.  `ripple`: grey levels of a texture of the floor too soft to be an edge."""
    rng = np.random.default_rng(4)
    truth = FLOOR.copy()
    truth[:, THING] = FLOOR[:, THING] + OFF_PX
    marks = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH)).astype(np.float32), (0, 0), 1.5)

    def seen(x: np.ndarray, thing: np.ndarray) -> np.ndarray:
        return np.where(thing, 160 + 300 * cv2.remap(marks, x, Y, cv2.INTER_LINEAR), 60 + ripple * np.sin(x / 3) * np.sin(Y / 4)).astype(np.float32)

    inside = np.zeros((HEIGHT, WIDTH), np.bool_)
    inside[:, THING] = True
    picture = seen(X, inside)
    at_thing, at_floor = ((X + 12 + 0.03 * Y + off) / (1 - 0.01) for off in (OFF_PX, 0.0))  # where a column of the right eye is in the left
    shown = (at_thing >= THING.start) & (at_thing < THING.stop)
    other = seen(np.where(shown, at_thing, at_floor).astype(np.float32), shown)
    left, right = (p + NOISE * rng.standard_normal(p.shape).astype(np.float32) for p in (picture, other))
    calm = np.clip(np.repeat(picture[..., None], 3, axis=2), 0, 255).astype(np.uint8)
    return Scene(left=left.astype(np.float32), right=right.astype(np.float32), calm=calm, truth=truth)


@pytest.fixture(scope="module")
def plain() -> Scene:
    return scene()


def with_patch(truth: np.ndarray, where: tuple[slice, slice]) -> np.ndarray:
    """The thing's disparity carried over the floor beside it."""
    wrong = truth.copy()
    wrong[where] += np.float32(OFF_PX)
    return wrong


def test_a_plane_is_found_among_as_many_strays() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 300, (2, 500))
    d = 5 + 0.1 * x - 0.05 * y + 0.1 * rng.standard_normal(500)
    d[:250] += rng.uniform(2, 30, 250)
    a, b, c = plane_through(np.stack([x, y, d]))
    assert np.abs(a * x + b * y + c - (5 + 0.1 * x - 0.05 * y)).max() < 0.2
    assert plane_through(np.stack([x, 2 * x, d])) is None, "a line has no plane"


def test_a_patch_of_plain_floor_comes_back_to_the_floor(plain) -> None:
    got, changed = plain.carried(with_patch(plain.truth, PATCH))
    assert changed[PATCH].mean() > 0.85  # less the rim of the thing, which is an edge
    assert not changed[:40].any()
    assert not changed[100:].any()
    assert np.abs(got - plain.truth)[changed].max() < 0.2


def test_what_the_other_eye_does_not_see_is_said_of_nothing(plain) -> None:
    got, changed = plain.carried(with_patch(plain.truth, BESIDE))
    assert changed[BESIDE].mean() > 0.7
    hidden = changed & np.isnan(got)
    assert hidden[BESIDE][:, -int(OFF_PX) :].any(axis=1).all()
    assert np.abs(got - plain.truth)[changed & ~hidden].max() < 0.2


def test_what_is_right_stays(plain) -> None:
    got, changed = plain.carried(plain.truth)
    assert not changed.any()
    assert np.array_equal(got, plain.truth)


def test_pictures_that_object_are_heard() -> None:
    """Here the patch is what the pictures show: a plate of the floor's own texture, OFF_PX nearer."""
    rippled = scene(ripple=5.0)
    moved = with_patch(rippled.truth, PATCH)
    y, x = np.mgrid[PATCH]
    lands = np.rint(x - moved[PATCH]).astype(int)
    right = rippled.right.copy()
    right[y, lands] = rippled.left[PATCH] + NOISE * np.random.default_rng(1).standard_normal(y.shape)
    _, changed = Scene(left=rippled.left, right=right, calm=rippled.calm, truth=moved).carried(moved)
    assert not changed[PATCH].any()
    _, changed = rippled.carried(moved)
    assert changed[PATCH].mean() > 0.6, "and where they show the floor, it is the floor"


def test_ground_that_bends_has_no_step_and_stays(plain) -> None:
    bent = (plain.truth + np.where(X < 100, 0.003 * (X - 100) ** 2, 0)).astype(np.float32)
    _, changed = plain.carried(bent)
    assert not changed.any()


def test_a_step_on_ground_that_bends_stays_too(plain) -> None:
    """A chin before its neck: skin has no plane that could go on over the step."""
    step = (slice(70, 110), slice(90, 130))
    flat, bent = (plain.truth + np.float32(k) * np.where(X < 75, (X - 75) ** 2, 0).astype(np.float32) for k in (0.0, 0.004))
    for ground, goes in ((flat, True), (bent, False)):
        stepped = ground.copy()
        stepped[step] += np.float32(OFF_PX)
        _, changed = plain.carried(stepped)
        assert changed[step].any() == goes


def test_a_piece_that_is_mostly_wrong_takes_the_plane_that_goes_on_from_beside_it() -> None:
    """A shadow's edge cuts a strip off the floor; two thirds of the strip have jumped to another plane."""
    ground = np.ones((HEIGHT, WIDTH), np.bool_)
    ground[:, 96:104] = False
    ground[:, 120:] = False
    wrong = FLOOR.copy()
    wrong[50:, 104:120] += np.float32(OFF_PX)
    pieces = ground_of(ground, wrong)
    strip = pieces.label[80, 110]
    own = pieces.planes[strip] @ (110, 80, 1)
    taken = planes_of(pieces)[strip] @ (110, 80, 1)
    assert abs(own - FLOOR[80, 110]) > 3
    assert abs(taken - FLOOR[80, 110]) < 0.1


def test_it_says_the_same_each_time_and_whatever_the_threads(plain) -> None:
    wrong = with_patch(plain.truth, PATCH)
    threads = cv2.getNumThreads()
    first, _ = plain.carried(wrong)
    cv2.setNumThreads(1)
    try:
        again, _ = plain.carried(wrong)
    finally:
        cv2.setNumThreads(threads)
    assert np.array_equal(first, again, equal_nan=True)


def test_without_plain_ground_nothing_happens(plain) -> None:
    marked = (128 + 60 * np.stack([np.sin(X), np.cos(X), np.sin(X)], axis=-1)).astype(np.uint8)
    wrong = with_patch(plain.truth, PATCH)
    got, changed = carried_on(plain.left, plain.right, marked, wrong, noise=NOISE, grain2=2 * NOISE**2)
    assert not plains.plain_ground(marked, NOISE)[:, 2:-2].any()
    assert not changed.any()
    assert np.array_equal(got, wrong)
