"""Figures of relit pictures: by hand on small arrays, and against scikit-image's own."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from stereorelight.compare.picture import blurred, displayed, light_figures, picture_figures, picture_measured
from stereorelight.errors import PassError

SIZE = (24, 32)


def pair(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.05, 0.9, (*SIZE, 3)).astype(np.float32)
    return (truth + 0.05 * rng.standard_normal(truth.shape)).astype(np.float32), truth


def test_figures_by_hand() -> None:
    truth = np.full((*SIZE, 3), 0.5, np.float32)
    result = truth.copy()
    result[:, :16] += 0.1  # half of the picture is off by 0.1
    found = picture_figures(result, truth)["all"]
    rms = 0.1 / np.sqrt(2)
    assert found.relative_rms_percent == pytest.approx(100 * rms / 0.5, rel=1e-5)
    assert found.psnr_db == pytest.approx(-20 * np.log10(rms), rel=1e-5)
    assert found.cover_percent == 100
    assert picture_figures(result, truth, peak=2.0)["all"].psnr_db == pytest.approx(-20 * np.log10(rms / 2), rel=1e-5)
    same = picture_figures(truth, truth)["all"]
    assert (same.relative_rms_percent, same.psnr_db, same.ssim, same.de2000) == (0.0, float("inf"), 1.0, 0.0)


def test_figures_are_scikit_images() -> None:
    result, truth = pair()
    found = picture_figures(result, truth)["all"]
    a, b = result.astype(np.float64), truth.astype(np.float64)
    assert found.psnr_db == pytest.approx(peak_signal_noise_ratio(b, a, data_range=1.0), rel=1e-9)
    assert found.ssim == pytest.approx(
        structural_similarity(b, a, data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False), rel=1e-6
    )
    apart = deltaE_ciede2000(rgb2lab(displayed(truth, 1.0)), rgb2lab(displayed(result, 1.0))).mean()
    assert found.de2000 == pytest.approx(float(apart), rel=1e-6)


def test_a_grey_step_of_display_code_has_the_colour_difference_of_the_formula() -> None:
    """Two greys have no chroma: CIEDE2000 is |dL| / (1 + 0.015 (L - 50)^2 / sqrt(20 + (L - 50)^2)), L the mean of both."""
    a, b = np.full((*SIZE, 3), 0.2, np.float32), np.full((*SIZE, 3), 0.25, np.float32)
    L = [116 * v ** (1 / 3) - 16 for v in (0.2, 0.25)]
    middle = sum(L) / 2 - 50
    wanted = (L[1] - L[0]) / (1 + 0.015 * middle**2 / np.sqrt(20 + middle**2))
    assert picture_figures(a, b)["all"].de2000 == pytest.approx(wanted, rel=2e-3)  # sRGB's own white is rounded


def test_a_matte_holds_its_own_figures() -> None:
    truth = np.full((*SIZE, 3), 0.5, np.float32)
    result = truth.copy()
    result[4:12, 4:20] = 0.6
    matte = np.zeros(SIZE, np.float32)
    matte[4:12, 4:20] = 1
    found = picture_figures(result, truth, mattes={"face": matte, "rest": matte == 0, "none": np.zeros(SIZE)})
    assert found["face"].relative_rms_percent == pytest.approx(20, rel=1e-4)
    assert found["rest"].relative_rms_percent == 0
    assert found["none"].pixels == 0
    assert found["face"].pixels + found["rest"].pixels == found["all"].pixels == SIZE[0] * SIZE[1]


def test_an_unknown_pixel_is_no_light_and_unknown_truth_does_not_count() -> None:
    result, truth = np.full((*SIZE, 3), 0.5, np.float32), np.full((*SIZE, 3), 0.5, np.float32)
    result[:6] = np.nan
    truth[6:12] = np.nan
    found = picture_figures(result, truth)["all"]
    assert found.pixels == 18 * 32
    assert found.cover_percent == pytest.approx(100 * 12 / 18)
    assert found.relative_rms_percent == pytest.approx(100 * np.sqrt(6 / 18), rel=1e-6)


def test_light_alone_by_hand() -> None:
    truth = np.zeros((*SIZE, 3), np.float32)
    truth[:, 16:] = 0.4
    found = light_figures(1.1 * truth, truth, blur_px=0)
    assert found.relative_rms_percent == pytest.approx(10, rel=1e-5)
    assert found.gain == pytest.approx(1.1, rel=1e-6)
    assert found.centred_percent == pytest.approx(0, abs=1e-4)
    turned = truth + np.float32(0.1) * np.where(np.arange(32)[None, :, None] % 2, 1, -1)  # at right angles to the truth, nearly
    off = light_figures(turned, truth, blur_px=0)
    assert off.relative_rms_percent == pytest.approx(100 * 0.1 / (0.4 / np.sqrt(2)), rel=1e-5)
    # The blur takes away what is fine and leaves what is broad.
    assert light_figures(turned, truth, blur_px=2).relative_rms_percent < 0.2 * off.relative_rms_percent
    assert light_figures(1.1 * truth, truth, blur_px=2).relative_rms_percent == pytest.approx(10, rel=1e-5)


def test_blur_keeps_light_and_is_a_gaussian() -> None:
    spot = np.zeros((41, 41, 3), np.float32)
    spot[20, 20] = 1
    out = blurred(spot, 2.0)[..., 0]
    assert out.sum() == pytest.approx(1, rel=1e-3)
    x = np.arange(41) - 20
    assert (out.sum(axis=0) * x**2).sum() == pytest.approx(4, rel=0.02)


def test_the_plate_is_taken_away_and_each_light_stands_alone() -> None:
    plate = np.full((*SIZE, 3), 0.3, np.float32)
    key = np.full((*SIZE, 3), 0.2, np.float32)
    told = picture_measured(plate * 0.5 + 0.9 * key, plate * 0.5 + key, plate=plate, plate_gain=0.5, lights={"key": (0.9 * key, key)})
    rows = {(f.region, f.name): f.value for f in told.figures}
    assert rows["all lights", "light_rms"] == pytest.approx(10, rel=1e-4)
    assert rows["key", "light_gain"] == pytest.approx(0.9, rel=1e-5)
    assert rows["all", "relative_rms"] == pytest.approx(100 * 0.02 / 0.35, rel=1e-4)
    assert "light alone" in told.to_dict()
    assert told.maps[0].error.dtype == np.float32


def test_nonsense_is_refused() -> None:
    result, truth = pair()
    with pytest.raises(PassError, match="picture to judge"):
        picture_figures(result[:20], truth)
    with pytest.raises(PassError, match="unknown at every pixel"):
        picture_figures(result, np.full_like(truth, np.nan))
    with pytest.raises(PassError, match="no known pixel in common"):
        picture_figures(np.full_like(result, np.nan), truth)
    with pytest.raises(PassError, match="peak"):
        picture_figures(result, truth, peak=0)
    with pytest.raises(PassError, match="no true light"):
        light_figures(result, np.zeros_like(truth))
    with pytest.raises(PassError, match="matte 'a'"):
        picture_figures(result, truth, mattes={"a": np.ones((3, 3))})
    with pytest.raises(PassError, match="SSIM needs"):
        picture_figures(result[:8, :8], truth[:8, :8])
