"""The median on two cores is that on one, to the borders."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.stereo.median import SMALLEST, median_5


@pytest.mark.parametrize("height", [1, 5, SMALLEST - 1, SMALLEST, SMALLEST + 1, 131])
def test_median_is_opencvs(height: int) -> None:
    a = np.random.default_rng(0).normal(size=(height, 37)).astype(np.float32)
    np.testing.assert_array_equal(median_5(a), cv2.medianBlur(a, 5))
