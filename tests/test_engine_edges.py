"""Depth edges: a pixel on the wrong side of a step goes to the side that both pictures speak for, and nothing else moves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.engine.edges import outlined, weighed_sides

f4 = np.float32
H, W, EDGE, NEAR, FAR = 40, 120, 60, 12, 4  # a card over x < EDGE before a wall, px of disparity


def scene(*, alike: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left and right pictures and the truth.  The card and the wall are of one tone where `alike`: only the eyes tell them apart."""
    rng = np.random.default_rng(0)
    card, wall = (
        cv2.GaussianBlur(rng.normal(0, 60 if alike else 25, (H, W + 40, 3)).astype(f4), (0, 0), 1.0) + level for level in (110, 110 if alike else 180)
    )
    x = np.arange(W)
    left = np.where((x < EDGE)[None, :, None], card[:, 20 : 20 + W], wall[:, 20 : 20 + W])
    right = np.where((x < EDGE - NEAR)[None, :, None], card[:, 20 + NEAR : 20 + NEAR + W], wall[:, 20 + FAR : 20 + FAR + W])
    truth = np.broadcast_to(np.where(x < EDGE, f4(NEAR), f4(FAR)), (H, W)).copy()
    return *(np.clip(p, 0, 255).astype(np.uint8) for p in (left, right)), truth


def sided(d: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    near = np.ones((3, 3), np.uint8)
    step = (cv2.dilate(d, near) - cv2.erode(d, near) > 1.5).view(np.uint8)
    zone, ramp = cv2.dilate(step, np.ones((9, 9), np.uint8)) > 0, cv2.dilate(step, near) > 0
    around = np.ones((13, 13), np.uint8)
    low, high = cv2.erode(np.where(ramp, f4(1e9), d), around), cv2.dilate(np.where(ramp, f4(-1e9), d), around)
    steep = (cv2.Sobel(p.mean(axis=2).astype(f4), cv2.CV_32F, 1, 0, scale=1 / 8) for p in (left, right))
    return weighed_sides(d, zone, ramp, low, high, left, right, *steep)


def wrong(d: np.ndarray, truth: np.ndarray) -> float:
    return float((np.abs(d - truth) > 1).mean() * W)  # px a row


def test_fattening_goes_where_tone_tells() -> None:
    left, right, truth = scene(alike=False)
    fat = truth.copy()
    fat[:, EDGE : EDGE + 3] = NEAR
    assert wrong(fat, truth) == 3
    assert wrong(sided(fat, left, right), truth) <= 1


def test_fattening_goes_where_only_the_eyes_tell() -> None:
    left, right, truth = scene(alike=True)
    fat = truth.copy()
    fat[:, EDGE : EDGE + 3] = NEAR
    assert wrong(sided(fat, left, right), truth) < 0.4 * wrong(fat, truth)


def test_a_true_edge_stays_and_no_value_lies_between() -> None:
    left, right, truth = scene(alike=False)
    got = sided(truth, left, right)
    assert wrong(got, truth) < 0.1
    assert not ((got > FAR + 1) & (got < NEAR - 1)).any()
    assert np.array_equal(got[:, : EDGE - 8], truth[:, : EDGE - 8])


def test_one_surface_is_left_alone() -> None:
    left, right, _ = scene(alike=True)
    slope = np.broadcast_to(5 + 0.3 * np.arange(W, dtype=f4), (H, W)).copy()
    assert np.array_equal(sided(slope, left, right), slope)


@pytest.mark.parametrize("size", [(20, 31), (2, 3)])
def test_outlined_is_the_median_weighed_by_likeness(size: tuple[int, int]) -> None:
    """Against the sorted values written out, borders included; pixels outside `where` stay."""
    rng = np.random.default_rng(7)
    disparity, where = rng.integers(0, 6, size).astype(f4), rng.random(size) < 0.7
    picture = rng.integers(0, 60, (*size, 3)).astype(np.uint8)
    got = outlined(disparity, where, picture, tone_levels=12.0)
    for y, x in np.ndindex(size):
        window = (slice(max(y - 2, 0), y + 3), slice(max(x - 2, 0), x + 3))
        shares = np.exp(-np.abs(picture[window].astype(int) - picture[y, x].astype(int)).max(axis=2) / 12).ravel()
        values = disparity[window].ravel()
        upto = {v: shares[values <= v].sum() for v in values}
        least = min(v for v, share in upto.items() if share >= 0.5 * shares.sum())
        assert got[y, x] == (least if where[y, x] else disparity[y, x])
