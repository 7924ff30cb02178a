"""Colour mending: a known cast goes in and comes out, whatever only one eye sees."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32
from stereorelight.errors import PassError, PlateError
from stereorelight.stereo.colour_match import match_colour

W, H, NEAR, FAR = 640, 360, 30.0, 8.0
CAST = np.array([1.15 * 1.10, 1.15, 1.15], np.float32)


def scene() -> tuple[Float32, Float32, Float32]:
    """Left, right and the left view's disparity (NaN where the right eye does not see): a red card before a grey wall."""
    rng = np.random.default_rng(3)

    def grain(w: int) -> Float32:
        coarse = cv2.GaussianBlur(rng.standard_normal((H, w, 3)).astype(np.float32), (0, 0), 4)
        return np.exp(0.35 * coarse / coarse.std())

    wall, card = 0.3 * grain(W + 64), np.array([0.5, 0.12, 0.08], np.float32) * grain(200)
    left, right = wall[:, 32 : 32 + W].copy(), wall[:, 32 + int(FAR) : 32 + int(FAR) + W].copy()
    left[80:300, 240:440] = card[80:300]
    right[80:300, 240 - int(NEAR) : 440 - int(NEAR)] = card[80:300]
    disparity = np.full((H, W), FAR, np.float32)
    disparity[80:300, 240:440] = NEAR
    disparity[80:300, 240 - int(NEAR - FAR) : 240] = np.nan
    disparity[:, : int(FAR)] = np.nan
    return left, right, disparity


LEFT, RIGHT, DISPARITY = scene()


@pytest.mark.parametrize("known", ["disparity", "nothing"])
def test_known_cast_comes_out(known: str) -> None:
    kept = LEFT.copy()
    matched, record = match_colour(LEFT, RIGHT / CAST, disparity=DISPARITY if known == "disparity" else None)
    np.testing.assert_allclose(record.gains, CAST, rtol=0.01)
    assert record.chosen == "gain"
    assert record.field is None
    assert np.median(np.abs(matched / RIGHT - 1)) <= 0.01
    assert record.residual_after_stops < record.residual_before_stops / 5
    assert np.array_equal(LEFT, kept)
    np.testing.assert_array_equal(record.apply(RIGHT / CAST), matched)


def test_sparse_matches_do_as_well() -> None:
    y, x = np.mgrid[10 : H - 10 : 9, 40 : W - 40 : 9].reshape(2, -1)
    d = DISPARITY[y, x]
    inner = np.isfinite(d) & (np.abs(x - 240) > 36) & (np.abs(x - 440) > 12) & (np.abs(y - 80) > 8) & (np.abs(y - 300) > 8)
    matches = np.stack([x, y, x - d, y], axis=1)[inner]
    _, record = match_colour(LEFT, RIGHT / CAST, matches=matches)
    np.testing.assert_allclose(record.gains, CAST, rtol=0.01)


def test_a_clean_pair_stays() -> None:
    _, record = match_colour(LEFT, RIGHT, disparity=DISPARITY)
    np.testing.assert_allclose(record.gains, 1, atol=2e-3)
    assert record.residual_before_stops < 0.01


def test_matrix_and_veil_are_found_where_they_pay() -> None:
    mix = np.array([[0.95, 0.08, 0.0], [0.02, 1.0, 0.05], [0.0, 0.1, 0.9]], np.float32)
    matched, record = match_colour(LEFT, RIGHT @ mix.T, disparity=DISPARITY)
    assert record.chosen == "matrix"
    assert np.median(np.abs(matched / RIGHT - 1)) <= 0.01
    matched, record = match_colour(LEFT, RIGHT / CAST + np.float32(0.03), disparity=DISPARITY)
    assert record.chosen == "gain and offset"
    assert np.median(np.abs(matched / RIGHT - 1)) <= 0.01


def test_local_cast_goes_and_texture_stays() -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    cast = np.exp2(np.stack([0.3 * x, -0.2 * x * y, 0.25 * (x * x + y * y)], axis=-1)).astype(np.float32)
    matched, _ = match_colour(LEFT, RIGHT / cast, mode="local", disparity=DISPARITY)
    ratio = np.abs(matched / RIGHT - 1)
    assert np.median(ratio) <= 0.01
    assert np.quantile(ratio, 0.95) <= 0.03
    rounded, _ = match_colour(LEFT, RIGHT / cast, disparity=DISPARITY)
    assert np.median(np.abs(rounded / RIGHT - 1)) > 0.04  # one gain for the frame cannot
    noise = np.random.default_rng(0).normal(1, 0.1, RIGHT.shape).astype(np.float32)
    noisy, _ = match_colour(LEFT, RIGHT * noise / cast, mode="local", disparity=DISPARITY)
    assert np.std(noisy / RIGHT) > 0.095  # the right eye's own grain is not painted over with the left eye's


def test_clipped_unknown_and_unseen_ground_has_no_vote() -> None:
    right = (RIGHT / CAST).copy()
    left = LEFT.copy()
    left[:90, 200:500], right[:90, 180:480] = 2.0, 2.0  # both eyes clip a window at the same number
    right[200:260, 500:560] = np.nan
    matched, record = match_colour(left, right, disparity=DISPARITY)
    np.testing.assert_allclose(record.gains, CAST, rtol=0.01)
    assert np.array_equal(np.isnan(matched), np.isnan(right))


def test_grain_does_not_bend_the_gain() -> None:
    rng = np.random.default_rng(5)
    left, right = (p + 0.01 * rng.standard_normal(p.shape).astype(np.float32) for p in (LEFT, RIGHT / CAST))
    _, record = match_colour(left, right, disparity=DISPARITY)
    np.testing.assert_allclose(record.gains, CAST, rtol=0.01)


def test_bad_input_is_said() -> None:
    with pytest.raises(PassError, match="did you mean 'global'"):
        match_colour(LEFT, RIGHT, mode="globall", disparity=DISPARITY)  # type: ignore[arg-type]
    with pytest.raises(PlateError, match="are the plates a pair"):
        match_colour(LEFT, RIGHT, disparity=np.full_like(DISPARITY, np.nan))
    with pytest.raises(PassError, match="matches must have shape"):
        match_colour(LEFT, RIGHT, matches=np.zeros((5, 3)))
