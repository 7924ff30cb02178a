"""What the other eye does not see, against the plain loops that the kernels stand for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.engine.occlusion import FEWEST, STEEPEST, background, consistent, continued, unseen

f4 = np.float32
ROWS = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24)


def disparities(nan: bool = False) -> st.SearchStrategy[npt.NDArray[np.float32]]:
    values = st.integers(-40, 40).map(lambda n: n / 4) | st.floats(-30, 30, width=32)
    return ROWS.flatmap(lambda hw: hnp.arrays(f4, hw, elements=values | st.just(float("nan")) if nan else values))


def unseen_by_loops(d: npt.NDArray[np.float32], by_px: float) -> npt.NDArray[np.bool_]:
    out = np.zeros(d.shape, bool)
    w = d.shape[1]
    for y, x in np.ndindex(d.shape):
        lands = int(np.floor(f4(x) - d[y, x] + f4(0.5)))
        if not 0 <= lands < w:
            out[y, x] = True
            continue
        for other in range(w):
            foot = int(np.floor(f4(other) - d[y, other]))
            out[y, x] |= lands in (foot, foot + 1) and d[y, other] > d[y, x] + f4(by_px)
    return out


@given(d=disparities(), by_px=st.sampled_from([0.25, 1.0, 2.5]))
def test_unseen_is_its_definition(d: npt.NDArray[np.float32], by_px: float) -> None:
    assert np.array_equal(unseen(d, by_px=by_px), unseen_by_loops(d, by_px))


def test_a_card_before_a_wall() -> None:
    """A card 12 px nearer than the wall hides 12 px of the wall at its left, and the right eye's frame ends 4 px early."""
    d = np.full((3, 64), 4, f4)
    d[:, 30:45] = 16
    expected = np.zeros(64, bool)
    expected[:4] = True  # lands left of the right eye's frame
    expected[30 - 12 : 30] = True
    assert np.array_equal(unseen(d), np.tile(expected, (3, 1)))


def test_negative_disparity_leaves_at_the_right() -> None:
    expected = np.zeros(20, bool)
    expected[-5:] = True
    assert np.array_equal(unseen(np.full((2, 20), -5, f4)), np.tile(expected, (2, 1)))


def test_a_slanted_wall_hides_nothing_of_itself() -> None:
    d = np.tile(np.linspace(2, 10, 80, dtype=f4), (2, 1))
    assert not unseen(d)[:, 12:].any()


def background_by_loops(d: npt.NDArray[np.float32], source: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    out = d.copy()
    for y, x in np.ndindex(d.shape):
        left, right = np.flatnonzero(source[y, : x + 1]), x + np.flatnonzero(source[y, x:])
        beside = [d[y, k] for k in (*left[-1:], *right[:1])]
        if beside:
            out[y, x] = min(beside)
    return out


@given(data=st.data())
def test_background_is_its_definition(data: st.DataObject) -> None:
    d = data.draw(disparities())
    source = data.draw(hnp.arrays(np.bool_, d.shape))
    assert np.array_equal(background(d, source), background_by_loops(d, source))


@given(data=st.data())
def test_background_keeps_sources_and_never_blends(data: st.DataObject) -> None:
    d = data.draw(disparities())
    source = data.draw(hnp.arrays(np.bool_, d.shape))
    out = background(d, source)
    assert np.array_equal(out[source], d[source])
    for y in range(d.shape[0]):
        assert set(out[y]) <= set(d[y][source[y]] if source[y].any() else d[y])


def test_ground_beside_an_actor_belongs_to_the_wall() -> None:
    d = np.array([[4, 0, 0, 16, 16, 0, 5]], f4)
    source = np.array([[1, 0, 0, 1, 1, 0, 1]], bool)
    assert np.array_equal(background(d, source), np.array([[4, 4, 4, 16, 16, 5, 5]], f4))


@given(data=st.data(), within=st.sampled_from([0.25, 1.0, 3.0]))
def test_consistent_is_its_definition(data: st.DataObject, within: float) -> None:
    left = data.draw(disparities(nan=True))
    right = data.draw(hnp.arrays(f4, left.shape, elements=st.integers(-40, 40).map(lambda n: n / 4) | st.just(float("nan"))))
    expected = np.zeros(left.shape, bool)
    for y, x in np.ndindex(left.shape):
        if np.isfinite(left[y, x]):
            k = int(np.floor(f4(x) - left[y, x] + f4(0.5)))
            expected[y, x] = 0 <= k < left.shape[1] and abs(left[y, x] - right[y, k]) <= f4(within)
    assert np.array_equal(consistent(left, right, within_px=within), expected)


def test_both_eyes_of_a_wall_agree() -> None:
    left = right = np.full((2, 30), 6, f4)
    assert np.array_equal(consistent(left, right), ~unseen(left))
    assert not consistent(left, right + f4(1.01)).any()


def border(slope: float, rows: int = 40, first: int = 30) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """A slanted wall, itself with a sixth of a pixel of noise, and the columns that are its sources: all from `first` on."""
    x, y = np.arange(120, dtype=f4), np.arange(rows, dtype=f4)[:, None]
    wall = (24 - f4(slope) * (x - first) + f4(0.02) * y).astype(f4)
    noisy = (wall + 0.16 * np.random.default_rng(5).standard_normal(wall.shape)).astype(f4)
    return wall, noisy, np.broadcast_to(x >= first, wall.shape)


@given(slope=st.floats(-0.25, 0.25), first=st.integers(FEWEST + 5, 38))
def test_a_slanted_wall_goes_on_as_it_slopes(slope: float, first: int) -> None:
    """As far beyond the other eye's frame as it was seen before it: as well as the middle of so many rows of noise can tell."""
    wall, noisy, source = border(slope, first=first)
    level = np.broadcast_to(wall[:, first : first + 1], wall.shape)
    out = continued(level.astype(f4), noisy, source)
    assert np.array_equal(out[:, first:], level[:, first:].astype(f4))
    assert np.abs(out - wall)[:, :first].max() < 1.0
    assert np.sqrt(np.mean((out - wall)[:, :first] ** 2)) < 0.35


def test_without_noise_it_goes_on_exactly() -> None:
    wall, _, source = border(0.08)
    out = continued(np.zeros_like(wall), wall, source)
    assert np.abs(out - wall)[:, :30].max() < 1e-3


def test_nothing_goes_on_steeper_than_a_surface_worth_lighting() -> None:
    wall, _, source = border(0.8)
    out = continued(np.zeros_like(wall), wall, source)
    assert np.allclose(np.diff(out[:, :30], axis=1), -STEEPEST, atol=1e-4) or np.array_equal(out, np.zeros_like(wall))


def test_a_thing_beside_the_border_has_no_say_in_the_wall() -> None:
    """A card twelve px nearer, twenty columns in: the line is fitted before it; and a row of few sources keeps what it was given."""
    wall, _, source = border(0.08)
    before = wall.copy()
    before[:, 50:70] += 12
    assert np.array_equal(continued(np.zeros_like(wall), before, source), continued(np.zeros_like(wall), wall, source & (np.arange(120) < 50)))
    few = source & (np.arange(120) < 30 + FEWEST - 1)
    assert not continued(np.zeros_like(wall), wall, few).any()
    assert not continued(np.zeros_like(wall), wall, np.zeros_like(source)).any()


def test_two_surfaces_at_the_border_each_go_on_as_they_slope() -> None:
    wall, _, source = border(0.08)
    wall[20:] = 40 + 0.05 * np.arange(120, dtype=f4)
    out = continued(np.zeros_like(wall), wall, source)
    assert np.abs(out - wall)[:, :30].max() < 0.1  # where they meet, there are rows of one side only


def test_what_was_not_matched_far_into_the_frame_is_not_gone_on_to() -> None:
    """Of a wall 120 columns wide only what lies right of the 80th was matched: 50 columns within the other eye's frame, not where it begins."""
    wall, _, source = border(0.08, first=80)
    given = np.full_like(wall, 20)
    assert np.array_equal(continued(given, wall, source), given)
