"""Picture look-ups: a band-limited picture is reproduced, plain stays plain, and two surfaces are never mixed."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.engine.resample import on_planes, resample

ROUNDING = 1e-6  # relative: thirty-six float32 products and their sum
# Of a wave's amplitude, by its period in px: what three lobes lose in both directions together (a cubic: 0.11 in one direction alone at 4 px).
RIPPLE = {4.0: 0.04, 8.0: 0.013, 24.0: 0.0075, 100.0: 0.002}
HW = (40, 60)


def grid(h: int, w: int) -> npt.NDArray[np.float32]:
    return np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float32)


def waves(u: npt.NDArray[np.float64], v: npt.NDArray[np.float64], period: float) -> npt.NDArray[np.float64]:
    k = 2 * np.pi / period
    return np.stack([np.sin(k * u + 0.3), np.cos(k * v), np.sin(k * (0.6 * u + 0.8 * v))], axis=-1)


def noise(seed: int = 0, hw: tuple[int, int] = HW) -> npt.NDArray[np.float32]:
    return np.random.default_rng(seed).normal(size=(*hw, 3)).astype(np.float32)


@pytest.mark.parametrize("period", RIPPLE)
@given(du=st.floats(-0.5, 0.5), dv=st.floats(-0.5, 0.5))
def test_a_band_limited_picture_is_reproduced(period: float, du: float, dv: float) -> None:
    u, v = np.meshgrid(np.arange(HW[1], dtype=np.float64), np.arange(HW[0], dtype=np.float64))
    at = grid(*HW)[4:-4, 4:-4] + np.array([du, dv], np.float32)
    out = resample(waves(u, v, period).astype(np.float32), at)
    assert np.abs(out - waves(at[..., 0].astype(np.float64), at[..., 1].astype(np.float64), period)).max() < RIPPLE[period]


@given(value=st.floats(2.0**-60, 2.0**60, width=32), seed=st.integers(0, 99))
def test_a_plain_picture_stays_plain(value: float, seed: int) -> None:
    at = np.random.default_rng(seed).uniform((-0.5, -0.5), (59.5, 39.5), (8, 9, 2)).astype(np.float32)
    out = resample(np.full((*HW, 1), value, np.float32), at)
    assert np.abs(out / value - 1).max() < ROUNDING
    assert not resample(np.zeros((*HW, 1), np.float32), at).any()  # black is exactly black


def test_whole_positions_give_their_pixel_exactly() -> None:
    picture = noise()
    picture[10, 10] = 3e4  # a lamp does not show in the pixel beside it
    picture[10, 11] = 0.0
    assert np.array_equal(resample(picture, grid(*HW)), picture)
    assert np.array_equal(resample(picture, grid(*HW)[::-1, 3:7]), picture[::-1, 3:7])


def test_each_channel_by_itself_and_linear() -> None:
    a, b = noise(1), noise(2)
    at = (grid(20, 20) * 1.37 + 0.21).astype(np.float32)
    whole = resample(a, at)
    for c in range(3):
        assert np.array_equal(resample(np.ascontiguousarray(a[..., c : c + 1]), at)[..., 0], whole[..., c])
    assert np.abs(resample(2 * a + b, at) - (2 * whole + resample(b, at))).max() < 1e-5


def test_turned_with_the_picture() -> None:
    picture, at = noise(3), (grid(20, 20) * 1.37 + 0.21).astype(np.float32)
    swapped = resample(np.ascontiguousarray(picture.transpose(1, 0, 2)), np.ascontiguousarray(at[..., ::-1]))
    assert np.abs(swapped - resample(picture, at)).max() < 1e-5


def test_unknown_outside_the_outer_edges_only() -> None:
    picture = noise()
    inside = [(-0.5, 0), (59.5, 0), (0, -0.5), (0, 39.5), (59.5, 39.5), (-0.5, -0.5)]
    outside = [(-0.51, 0), (59.51, 0), (0, -0.51), (0, 39.51), (np.nan, 0), (0, np.nan), (np.inf, 0), (0, -np.inf), (1e30, 1e30)]
    assert np.isfinite(resample(picture, np.array([inside], np.float32))).all()
    assert np.isnan(resample(picture, np.array([outside], np.float32))).all()


def test_the_border_is_repeated() -> None:
    picture = noise()
    padded = np.pad(picture, ((4, 4), (4, 4), (0, 0)), mode="edge")
    at = np.array([[(-0.4, 3.3), (59.3, 20.1), (12.2, -0.45), (30.7, 39.4), (1.25, 1.75)]], np.float32)
    assert np.abs(resample(picture, at) - resample(padded, at + 4)).max() < 1e-4  # the table's nearest fraction differs in float32


@pytest.mark.parametrize("hw", [(1, 1), (1, 5), (5, 1), (2, 2)])
def test_tiny_pictures(hw: tuple[int, int]) -> None:
    picture = noise(hw=hw)
    assert np.array_equal(resample(picture, grid(*hw)), picture)
    values, nearest = on_planes(picture[..., 0], (0 * picture[..., 0], 0 * picture[..., 0]), grid(*hw), apart=1.0)
    assert np.array_equal(values, picture[..., 0])
    assert np.array_equal(nearest, np.arange(hw[0] * hw[1]).reshape(hw))


def test_a_missing_pixel_stays_in_its_neighbourhood() -> None:
    picture = noise()
    picture[20, 30] = np.nan
    out = np.isnan(resample(picture, grid(*HW) + np.float32(0.25))).any(axis=-1)
    y, x = np.nonzero(out)
    assert out[20, 30]
    assert y.size
    assert (abs(y - 20) <= 3).all()
    assert (abs(x - 30) <= 3).all()


def test_same_bits_on_one_thread_and_two() -> None:
    picture, at = noise(), (grid(70, 50) * 0.53 + 0.21).astype(np.float32)
    value, slope = np.ascontiguousarray(picture[..., 0]), np.ascontiguousarray(picture[..., 1])
    before, results = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            results.append((resample(picture, at), *on_planes(value, (slope, slope), at, apart=2.0)))
    finally:
        numba.set_num_threads(before)
    for one, two in zip(*results):
        assert one.tobytes() == two.tobytes()


# ---- local planes


def plane(
    a: float, b: float, c: float, hw: tuple[int, int] = HW
) -> tuple[npt.NDArray[np.float32], tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]:
    g = grid(*hw).astype(np.float64)
    value = (c + a * g[..., 0] + b * g[..., 1]).astype(np.float32)
    return value, (np.full(hw, a, np.float32), np.full(hw, b, np.float32))


def somewhere(count: int, seed: int = 0) -> npt.NDArray[np.float32]:
    at = np.random.default_rng(seed).uniform((-0.5, -0.5), (59.4, 39.4), (count, 2)).astype(np.float32)
    return at[None]


@given(a=st.floats(-1, 1), b=st.floats(-1, 1), c=st.floats(-50, 50), seed=st.integers(0, 99))
def test_a_plane_is_exact_out_to_the_frames_edges(a: float, b: float, c: float, seed: int) -> None:
    value, slopes = plane(a, b, c)
    at = somewhere(100, seed)
    out, nearest = on_planes(value, slopes, at, apart=0.5)
    assert np.abs(out - (c + a * at[..., 0].astype(np.float64) + b * at[..., 1])).max() < 3e-5  # float32 at 150 px
    assert np.array_equal(nearest, np.floor(at[..., 1] + 0.5) * HW[1] + np.floor(at[..., 0] + 0.5))


@given(step=st.floats(2.1, 100), seed=st.integers(0, 99))
def test_two_surfaces_are_never_mixed(step: float, seed: int) -> None:
    """Actor before a wall, a jagged edge: every value is one of the two planes' own."""
    rng = np.random.default_rng(seed)
    actor = rng.random(HW) < 0.5
    (wall, slopes_wall), (front, slopes_front) = plane(0.01, -0.01, 5), plane(-0.01, 0.005, 5 + step)
    value = np.where(actor, front, wall)
    slopes = (np.where(actor, slopes_front[0], slopes_wall[0]), np.where(actor, slopes_front[1], slopes_wall[1]))
    at = somewhere(200, seed)
    out, nearest = on_planes(value, slopes, at, apart=0.6)
    u, v = at[..., 0].astype(np.float64), at[..., 1].astype(np.float64)
    mine = actor.ravel()[nearest]
    assert np.abs(out - np.where(mine, 5 + step - 0.01 * u + 0.005 * v, 5 + 0.01 * u - 0.01 * v)).max() < 3e-5


@given(seed=st.integers(0, 199), apart=st.floats(0.1, 3))
def test_never_farther_than_apart_from_the_nearest_plane(seed: int, apart: float) -> None:
    value, at = 2 * noise(seed)[..., 0], somewhere(200, seed)
    value = np.ascontiguousarray(value)
    out, nearest = on_planes(value, (0 * value, 0 * value), at, apart=apart)
    assert np.abs(out - value.ravel()[nearest]).max() <= apart * (1 + 1e-6)


def test_missing_neighbours_are_left_out_and_missing_ground_stays_missing() -> None:
    value, slopes = plane(0.1, 0.2, 3)
    value[20, 30] = np.nan
    at = np.array([[(30.2, 20.2), (30.7, 20.2), (29.4, 19.4)]], np.float32)
    out, nearest = on_planes(value, slopes, at, apart=0.5)
    assert np.isnan(out[0, 0])
    assert nearest[0, 0] == 20 * HW[1] + 30
    assert out[0, 1:] == pytest.approx([3 + 3.07 + 4.04, 3 + 2.94 + 3.88], abs=1e-5)


def test_the_last_float_before_the_edge_is_inside() -> None:
    """0.49999997 + 0.5 rounds to 1 in float32: one pixel past a map of one."""
    last = np.nextafter(np.float32(0.5), np.float32(0))
    out, nearest = on_planes(np.full((1, 1), 7, np.float32), (np.zeros((1, 1), np.float32),) * 2, np.full((1, 1, 2), last), apart=1.0)
    assert out[0, 0] == 7
    assert nearest[0, 0] == 0


def test_outside_the_map() -> None:
    value, slopes = plane(0.1, 0.2, 3)
    out, nearest = on_planes(value, slopes, np.array([[(-0.6, 3), (59.5, 3), (3, 39.6), (np.nan, 3), (np.inf, 3)]], np.float32), apart=0.5)
    assert np.isnan(out).all()
    assert (nearest == -1).all()
