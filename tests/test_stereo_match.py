"""What matching fills, and from where."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.stereo import match as matching
from stereorelight.stereo.match import everywhere, match, on_plates
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.semi_global import DisparityRange

NAN = np.float32(np.nan)
H, W, D = 60, 160, 6


def beyond_the_plate() -> Proxy:
    """A wall at `D` px with a textured plate; a triangle of its lower right is beyond both rectified plates, black."""
    rng = np.random.default_rng(3)
    wall = np.kron(rng.uniform(40, 220, (H // 2, (W + 40) // 2)), np.ones((2, 2))).astype(np.float32)
    y, x = np.mgrid[:H, :W]
    known = x + y < W + H // 2
    left, right = (np.where(known, wall[:, k : k + W], 0).astype(np.float32) for k in (0, D))
    coded = [np.ascontiguousarray(np.repeat(np.rint(p)[..., None], 3, axis=2)).astype(np.uint8) for p in (left, right)]
    return Proxy(left=coded[0], right=coded[1], left_grey=left, right_grey=right, left_known=known, right_known=known)


def test_what_lies_beyond_the_plate_is_ground_of_what_it_shows() -> None:
    proxy = beyond_the_plate()
    made = match(proxy, DisparityRange(low=-16, count=48))
    assert np.isnan(made.left[~proxy.left_known]).all()
    assert np.isnan(made.right[~proxy.right_known]).all()
    inside = np.isfinite(made.left)
    assert inside[proxy.left_known].mean() > 0.9
    assert np.abs(made.dense - D).max() < 1


def test_a_row_without_any_match_is_filled_from_the_nearest_that_has_one() -> None:
    disparity = np.full((9, 12), NAN)
    disparity[3, 4:8], disparity[6, 2:5] = 10, 20
    filled = everywhere(disparity)
    assert (filled[:4] == 10).all()
    assert (filled[6:] == 20).all()
    assert set(np.unique(filled)) == {10, 20}


def test_whole_plates_stay_as_they_are() -> None:
    proxy = beyond_the_plate()
    whole = np.ones((H, W), np.bool_)
    known = Proxy(left=proxy.left, right=proxy.right, left_grey=proxy.left_grey, right_grey=proxy.right_grey, left_known=whole, right_known=whole)
    disparity = np.random.default_rng(0).normal(size=(2, H, W)).astype(np.float32)
    left, right = on_plates(*disparity, known)
    np.testing.assert_array_equal(np.stack([left, right]), disparity)


def test_dead_pixels_and_rows_within_the_plate_keep_what_was_matched_about_them() -> None:
    proxy = beyond_the_plate()
    known = proxy.left_known.copy()
    known[20, 40], known[30], known[:, 70] = False, False, False
    hurt = Proxy(left=proxy.left, right=proxy.right, left_grey=proxy.left_grey, right_grey=proxy.right_grey, left_known=known, right_known=known)
    left, _ = on_plates(np.full((H, W), D, np.float32), np.full((H, W), D, np.float32), hurt)
    assert np.isnan(left[~proxy.left_known]).all()
    assert np.isfinite(left[10:-10, 10:110]).all()


@pytest.mark.parametrize(("noise", "sizes"), [(2.8, [64, 128, 256, 512]), (6.0, [256, 512, 512])])
def test_half_a_grainy_pair_is_led_by_a_quarter_where_it_is_clean_and_bare(monkeypatch, noise, sizes) -> None:
    """Bare walls are found at the size at which they show something; what is grainy at half the size, too, is left at that."""
    rng = np.random.default_rng(4)
    pictures = [np.clip(np.rint(128 + noise * rng.standard_normal((512, 640, 3))), 0, 255).astype(np.uint8) for _ in range(2)]
    for picture, d in zip(pictures, (0, 12), strict=True):
        picture[:, 300 - d : 380 - d] = rng.integers(0, 255, (512, 80, 3)) if d == 0 else pictures[0][:, 300:380]
    known = np.ones((512, 640), np.bool_)
    proxy = Proxy(
        left=pictures[0],
        right=pictures[1],
        left_grey=pictures[0].mean(axis=2).astype(np.float32),
        right_grey=pictures[1].mean(axis=2).astype(np.float32),
        left_known=known,
        right_known=known,
    )
    seen, held = [], matching.supported

    def spied(left, *rest, **more):
        seen.append(left.shape[0])
        return held(left, *rest, **more)

    monkeypatch.setattr(matching, "supported", spied)
    match(proxy, DisparityRange.holding(0, 30))
    assert seen[: len(sizes)] == sizes
