"""The Motorcycle pair: offline, its truth in the right direction and on the right eye, and its occlusions."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from stereorelight.compare.motorcycle import TruePair, motorcycle, seen_by_both


@pytest.fixture(scope="module")
def pair() -> TruePair:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the pair must come from the wheel, not from the network")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", refuse)
        return motorcycle()


def warp_error(picture: np.ndarray, other: np.ndarray, shift_px: np.ndarray, where: np.ndarray) -> float:
    """Mean grey-level difference between `picture` at x and `other` at x + shift, linear in between."""
    grey, seen = picture.mean(axis=-1), other.mean(axis=-1)
    rows, cols = np.nonzero(where)
    x = cols + shift_px[where]
    inside = (x >= 0) & (x < grey.shape[1] - 1)
    rows, cols, x = rows[inside], cols[inside], x[inside]
    left = x.astype(int)
    there = seen[rows, left] + (x - left) * (seen[rows, left + 1] - seen[rows, left])
    return float(np.abs(there - grey[rows, cols]).mean())


def test_what_comes(pair: TruePair) -> None:
    assert pair.left.shape == pair.right.shape == (500, 741, 3)
    assert pair.left.dtype == np.uint8
    assert pair.disparity.shape == pair.rig.left.size_hw
    assert not np.isinf(pair.disparity).any()
    assert 0.92 < np.isfinite(pair.disparity).mean() < 0.93
    Z = pair.rig.depth_from_disparity(pair.disparity)
    assert 1.5 < np.nanmin(Z) < np.nanmax(Z) < 6  # a motorcycle in a workshop, metres


def test_truth_lies_on_the_left_eye_and_points_left(pair: TruePair) -> None:
    known = np.isfinite(pair.disparity)
    right_way = warp_error(pair.left, pair.right, -pair.disparity, pair.nonoccluded)
    assert right_way < 6
    for wrong in (
        warp_error(pair.left, pair.right, pair.disparity, known),
        warp_error(pair.right, pair.left, pair.disparity, known),
        warp_error(pair.right, pair.left, -pair.disparity, known),
    ):
        assert wrong > 2 * right_way


def test_occluded_pixels_look_different_in_the_right_eye(pair: TruePair) -> None:
    known = np.isfinite(pair.disparity)
    hidden = known & ~pair.nonoccluded
    assert 0.05 < hidden.sum() / known.sum() < 0.15
    assert warp_error(pair.left, pair.right, -pair.disparity, hidden) > 8 * warp_error(pair.left, pair.right, -pair.disparity, pair.nonoccluded)


def test_seen_by_both_by_hand() -> None:
    #                 lands at   -1  0  1  2  3  -1   0   1   2   8  9
    disparity = np.array([[1.0, 1, 1, 1, 1, 6, 6, 6, 6, 1, 1]], dtype=np.float32)
    # the first leaves the picture, as does the first of the near strip; the strip hides what lands on 0, 1 and 2
    assert seen_by_both(disparity)[0].tolist() == [False, False, False, False, True, False, True, True, True, True, True]
    gap = disparity.copy()
    gap[0, 6] = np.nan
    assert seen_by_both(gap)[0].tolist() == [False, True, False, False, True, False, False, True, True, True, True]
    slant = np.array([[0.0, 0.7, 1.4, 2.1]], dtype=np.float32)  # steep, but one surface: neighbours crowd without hiding each other
    assert seen_by_both(slant).all()
