"""The thin plate: planes are kept, bends are smoothed by what the evidence asks for, and nothing binds over an edge."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.engine.bending import plate_correction
from stereorelight.engine.bends import bend_energies, bend_energy, slopes
from stereorelight.engine.pyramid import SMALL, carry, doubled, halved
from stereorelight.threads import set_threads, usable_cores

f4 = np.float32
HW = (150, 131)
Y, X = np.mgrid[: HW[0], : HW[1]].astype(f4)


def full(value: float) -> np.ndarray:
    return np.full(HW, value, f4)


def fitted(start: np.ndarray, known: np.ndarray, weight: np.ndarray, bend: float, rounds: int = 3, steps: int = 20) -> np.ndarray:
    d = start.astype(f4)
    for _ in range(rounds):
        d = d + plate_correction(d, weight, weight * (known - d).astype(f4), full(bend), cut=0.15, steps=steps)
    return d


def test_a_plane_is_left_alone() -> None:
    plane = 20 + 0.3 * X - 0.2 * Y
    assert np.abs(plate_correction(plane, full(1e-3), full(0), full(0.01), cut=0.15)).max() < 2e-4


@pytest.mark.parametrize("tail", [0.0, 3000.0])
@pytest.mark.parametrize("hw", [(11, 13), (90, 7), (3, 40)])
def test_it_is_the_least_of_its_sum_of_squares(hw, tail) -> None:
    """Against the sum of squares written out and solved: weights and bends that change, edges, borders and corners."""
    h, w = hw
    rng = np.random.default_rng(4)
    d = (5 + np.cumsum(rng.normal(0, 0.02, hw), axis=1) + np.where(np.arange(w) < w // 2, 0, 3)).astype(f4)
    weight, bend, cut = rng.uniform(0.5, 2, hw).astype(f4), rng.uniform(0.5, 2, hw).astype(f4), 0.06
    known = d + rng.normal(0, 0.3, hw)
    rows, asked = [], []

    def ask(coefficients: dict[tuple[int, int], float], value: float, strength: float) -> None:
        row = np.zeros(hw)
        for at, c in coefficients.items():
            row[at] = c
        rows.append(row.ravel() * strength)
        asked.append(value * strength)

    def bends(y: int, x: int, coefficients: dict[tuple[int, int], float], times: float = 1) -> None:
        there = sum(c * float(d[at]) for at, c in coefficients.items())
        if abs(there) < cut:
            ask(coefficients, 0, np.sqrt(times / (1 + tail * (there / bend[y, x]) ** 2)) / bend[y, x])

    for y in range(h):
        for x in range(w):
            ask({(y, x): 1}, known[y, x], np.sqrt(weight[y, x]))
            if 0 < x < w - 1:
                bends(y, x, {(y, x - 1): 1, (y, x): -2, (y, x + 1): 1})
            if 0 < y < h - 1:
                bends(y, x, {(y - 1, x): 1, (y, x): -2, (y + 1, x): 1})
            if x < w - 1 and y < h - 1:
                bends(y, x, {(y, x): 1, (y, x + 1): -1, (y + 1, x): -1, (y + 1, x + 1): 1}, times=2)
    least = np.linalg.lstsq(np.array(rows), np.array(asked), rcond=None)[0].reshape(hw)
    got = d + plate_correction(d, weight, (weight * (known - d)).astype(f4), bend, cut=cut, tail=tail, levels=1, steps=200)
    assert np.abs(got - least).max() < 1e-4


def test_noise_falls_as_the_closed_form_says() -> None:
    """Variance bend / (8 sqrt(weight)) of a surface that bends not at all is a bound; half of it is what noise alone leaves."""
    noise = np.random.default_rng(0).normal(0, 0.5, HW).astype(f4)
    weight, bend = 1 / 0.25, 0.01
    d = fitted(full(10), 10 + noise, full(weight), bend, rounds=1, steps=60)
    inside = (d - 10)[20:-20, 20:-20]
    posterior = np.sqrt(0.125 * bend / np.sqrt(weight))
    assert 0.5 * posterior < inside.std() < posterior


def test_tilted_ground_without_evidence_is_a_plane_between_what_is_known() -> None:
    truth = 5 + 0.1 * X + 0.05 * Y
    weight = full(1e-7)
    weight[:, :30] = weight[:, 100:] = 4
    start = truth + np.where(weight > 1, 0, 0.4 * np.sin(X / 9))
    d = fitted(start, truth, weight, 0.002, rounds=6, steps=60)
    assert np.abs(d - truth).max() < 0.05


def test_a_tail_keeps_creases_and_leaves_flat_ground_calm() -> None:
    """A roof whose ridge bends ten times as much as is expected."""
    roof = 20 - 0.03 * np.abs(X - HW[1] // 2)
    known = roof + np.random.default_rng(1).normal(0, 0.03, HW).astype(f4)
    weight = full(1 / 0.03**2)
    start = fitted(known, known, weight, 0.03, rounds=1)  # a ridge that has begun to show
    errors = {}
    for tail in (0.0, 4.0):
        d = start
        for _ in range(3):
            d = d + plate_correction(d, weight, weight * (known - d), full(0.003), cut=0.15, tail=tail, steps=20)
        errors[tail] = np.sqrt(((d - roof) ** 2).mean(axis=0))
    ridge, flat = np.abs(np.arange(HW[1]) - HW[1] // 2) <= 1, np.abs(np.arange(HW[1]) - HW[1] // 4) < 15
    assert errors[4.0][ridge].mean() < 0.75 * errors[0.0][ridge].mean()
    assert errors[4.0][flat].mean() < 1.15 * errors[0.0][flat].mean()


def test_an_edge_binds_nothing() -> None:
    step = np.where(X < 60, f4(10), f4(14)) + 0.02 * Y
    noise = np.random.default_rng(1).normal(0, 0.02, HW)
    d = fitted(step, step + noise, full(100), 0.001)
    assert np.abs(d - step).max() < 0.05
    slope_x, slope_y = slopes(d, cut=0.15)
    assert np.abs(slope_x).max() < 0.05  # no skirt
    assert np.median(slope_y) == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize("step", [3, 6, 12, 40])
@pytest.mark.parametrize("finest", [0, 1])
def test_ground_that_nobody_sees_is_not_moved_by_what_hides_it(step: int, finest: int) -> None:
    """A disc in front is 0.3 px off, the wall is right, and of the ring of wall beside the disc hardly anything is known."""
    y, x = np.mgrid[:160, :240].astype(f4)
    from_disc = np.hypot(x - 120, y - 80) - 40
    disc, ring = from_disc < 0, (from_disc >= 0) & (from_disc < 12)
    d = np.where(disc, f4(20 + step), f4(20))
    weight = np.where(ring, f4(0.01), f4(100))
    bend = np.full_like(d, 0.004)
    moved = plate_correction(d, weight, weight * np.where(disc, f4(0.3), f4(0)), bend, cut=0.065, steps=4, finest=finest)
    assert np.abs(moved[ring]).mean() < 0.02
    assert np.abs(moved[~disc & ~ring]).max() < 0.03
    assert np.median(moved[disc]) == pytest.approx(0.3, abs=0.01)


def test_whose_correction_each_side_of_an_outline_starts_from() -> None:
    """A brow above, a cheek below it, a wall on the right.  Cheek under the brow keeps to its own; a rim before the wall takes the mean of
    the four cells, 9 : 3 : 3 : 1, under the brow, too: in the corner two of them are brow, one cheek, one wall."""
    brow, wall = slice(0, 4), slice(6, None)
    d = np.full((16, 12), 20, f4)
    d[:, wall], d[brow] = 10, 30
    coarse = halved(d)
    correction = np.where(coarse == 30, f4(1), np.where(coarse == 10, f4(-1), f4(0.5)))
    out = np.empty_like(d)
    carry(0, 16, coarse + correction, correction, d, f4(0.1), f4(2), out)
    np.testing.assert_allclose(out[4, :5], 0.5)
    np.testing.assert_allclose(out[4, 5], (9 * 0.5 + 3 * 1 + 3 * -1 + 1 * 1) / 16)
    np.testing.assert_allclose(out[6:, 5], (3 * 0.5 - 1) / 4)
    np.testing.assert_allclose(out[3, :5], (3 * 1 + 0.5) / 4)
    np.testing.assert_allclose(out[4:, 6], -1)


def test_slopes_of_a_plane_hold_to_the_border() -> None:
    slope_x, slope_y = slopes(3 + f4(0.25) * X - f4(0.5) * Y, cut=0.15)
    assert np.abs(slope_x - 0.25).max() < 1e-4
    assert np.abs(slope_y + 0.5).max() < 1e-4


def test_bend_energy_is_that_of_a_paraboloid_and_none_at_edges() -> None:
    d = 0.5 * (0.02 * X * X + 0.01 * Y * Y) + 0.005 * X * Y
    logs, counts = bend_energy(d.astype(f4), cut=0.15)
    inside = (slice(2, -2), slice(2, -2))
    assert counts[inside].all()
    assert np.median(np.exp(logs[inside])) == pytest.approx(0.02**2 + 2 * 0.005**2 + 0.01**2, rel=0.05)
    logs, counts = bend_energy(np.where(X < 60, f4(10), f4(14)), cut=0.15)
    assert not counts[:, 59:61].any()


def test_halved_and_doubled_keep_planes() -> None:
    plane = 2 + 0.5 * X - 0.25 * Y
    half = halved(plane, surface=True)
    assert np.abs(half - (2 + 0.5 * (X + 0.5) - 0.25 * (Y + 0.5))[::2, ::2]).max() < 1e-4
    assert np.abs(doubled(half, HW, surface=True) - plane).max() < 1e-4
    assert halved(full(3), times=1.0).max() == 12  # sums keep their size at an odd end
    assert np.array_equal(doubled(halved(full(3)), HW), full(3))


def test_same_bits_whatever_the_threads() -> None:
    rng = np.random.default_rng(2)
    size = (403, 157)  # enough to be shared out
    assert size[0] * size[1] > SMALL
    d, pull = (rng.normal(0, 0.1, size).astype(f4) for _ in range(2))
    weight, bend = np.ones(size, f4), np.full(size, 0.01, f4)
    both = []
    try:
        for threads in (1, 2):
            set_threads(threads)
            both.append(plate_correction(d, weight, pull, bend, cut=0.5))
    finally:
        set_threads(usable_cores())
    assert np.array_equal(*both)


def test_a_bend_at_a_quarter_of_the_size_is_that_bend_grown() -> None:
    rng = np.random.default_rng(3)
    size = (131, 90)
    d, pull = (rng.normal(0, 0.1, size).astype(f4) for _ in range(2))
    bend = rng.uniform(0.005, 0.02, (33, 23)).astype(f4)
    grown = doubled(doubled(bend, (66, 45)), size)
    few, all_ = (plate_correction(d, np.ones(size, f4), pull, b, cut=0.5) for b in (bend, grown))
    assert np.array_equal(few, all_)


def test_energies_of_all_sizes_are_those_of_each() -> None:
    d = np.random.default_rng(4).normal(0, 0.05, (131, 90)).astype(f4)
    logs, counts = bend_energies(d, cut=0.1, looser=4)
    small = d
    for k in range(4):
        energy = bend_energy(small, cut=0.1 * min(2**k, 4))
        for mine, theirs in zip((logs[k], counts[k]), energy, strict=True):
            for _ in range(2 - k):
                theirs = halved(theirs)
            assert np.array_equal(mine, theirs if k < 3 else doubled(theirs, mine.shape))
        small = halved(small, surface=True)
