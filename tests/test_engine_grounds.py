"""Kernels of plain ground against what they mean, written out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.engine.grounds import level, planar, told_other


@given(seed=st.integers(0, 99), most=st.floats(0.5, 5))
def test_level_is_where_sobel_finds_no_channel_steep(seed: int, most: float) -> None:
    picture = cv2.GaussianBlur(np.random.default_rng(seed).normal(100, 20, (17, 23, 3)).astype(np.float32), (0, 0), 1.5)
    across, down = (cv2.Sobel(picture, cv2.CV_32F, *way, scale=1 / 8, borderType=cv2.BORDER_REPLICATE) for way in ((1, 0), (0, 1)))
    steep = np.sqrt((across**2 + down**2).max(axis=2))
    sure = np.abs(steep - most) > 1e-3
    np.testing.assert_array_equal(level(picture, most)[sure], (steep < most)[sure])


def test_planar_is_the_plane_of_the_label_and_the_disparity_elsewhere() -> None:
    rng = np.random.default_rng(1)
    label = rng.integers(0, 4, (12, 15)).astype(np.int32)
    planes = rng.normal(size=(4, 3)).astype(np.float32)
    planes[[0, 2]] = np.nan
    disparity = rng.normal(10, 3, (12, 15)).astype(np.float32)
    out = planar(label, planes, disparity)
    for y in range(12):
        for x in range(15):
            k = label[y, x]
            want = disparity[y, x] if k in (0, 2) else planes[k] @ np.array([x, y, 1], np.float32)
            assert out[y, x] == pytest.approx(want, abs=1e-4)


def test_the_other_eye_is_told_the_nearest_of_what_lands_on_a_pixel() -> None:
    right = np.full((3, 12), 7, np.float32)
    disparity = np.full((3, 12), 2, np.float32)
    disparity[1, 8], disparity[1, 7] = 4.4, 3  # both land on column 4
    disparity[1, 1], disparity[1, 11] = 5, np.nan  # before the frame, and nothing
    where = np.zeros((3, 12), np.bool_)
    where[1] = True
    out = told_other(right, disparity, where)
    assert np.array_equal(out[[0, 2]], right[[0, 2]])
    assert out[1, 4] == pytest.approx(4.4)
    assert np.array_equal(np.flatnonzero(out[1] == 7), [5, 6, 9, 10, 11])  # where nothing lands it keeps what it had
