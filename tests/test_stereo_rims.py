"""Plain patches on the plane of their rims: a stair of squares becomes the board that it is, and nothing else moves."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.engine.rims import rim_disparity
from stereorelight.stereo.rims import on_rims
from tests.test_stereo_plain import HEIGHT, SIDE_PX, TURN, WIDTH, bare_board

INSIDE = (slice(20, -20), slice(110, -20))


@pytest.fixture(scope="module")
def board() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    left, right, truth = bare_board()
    return *(np.ascontiguousarray(255 * np.sqrt(p[..., 0])).astype(np.float32) for p in (left, right)), truth.astype(np.float32)


def stair(truth: np.ndarray) -> np.ndarray:
    """Each square level, at the disparity of its middle: what matching by support makes of the board."""
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    u, v = ((np.cos(TURN) * x + np.sin(TURN) * y) / SIDE_PX, (-np.sin(TURN) * x + np.cos(TURN) * y) / SIDE_PX)
    square = ((np.floor(u) + 50) * 1000 + np.floor(v) + 50).astype(int)
    _, label = np.unique(square, return_inverse=True)
    label = label.ravel()
    mean = np.bincount(label, truth.ravel()) / np.bincount(label)
    return mean[label].reshape(truth.shape).astype(np.float32)


def test_a_stair_of_squares_becomes_the_board(board) -> None:
    left, right, truth = board
    flat = stair(truth)
    before, after = (np.abs(d - truth)[INSIDE] for d in (flat, on_rims(left, right, flat)))
    assert np.median(before) > 0.7
    assert np.median(after) < 0.3 * np.median(before)
    assert np.mean(after > 1) < 0.5 * np.mean(before > 1)


def test_rims_are_found_whatever_the_patches_beside_them_say(board) -> None:
    left, right, truth = board
    rim = np.zeros(truth.shape, np.bool_)
    rim[INSIDE] = np.abs(np.gradient(left, axis=1))[INSIDE] > 12
    found = rim_disparity(left, right, rim, stair(truth))
    known = np.isfinite(found)
    assert not known[~rim].any()
    assert known.sum() > 0.5 * rim.sum()
    assert np.median(np.abs(found - truth)[known]) < 0.2


def test_what_is_right_and_what_has_no_rims_stays(board) -> None:
    left, right, truth = board
    assert np.abs(on_rims(left, right, truth) - truth)[INSIDE].max() < 0.6
    even = np.full_like(left, 100)
    assert np.array_equal(on_rims(even, even, truth), truth)


def test_pictures_that_object_are_heard(board, monkeypatch) -> None:
    import stereorelight.stereo.rims as module

    left, right, truth = board
    flat = stair(truth)
    monkeypatch.setattr(module, "OBJECTS", 0.0)
    monkeypatch.setattr(module, "SPEAKS", 0.0)
    assert np.array_equal(on_rims(left, right, flat), flat)
