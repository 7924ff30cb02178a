"""Figures beside OpenCV's and scikit-image's own, tallies that add up, the calibration of confidence, gates and tables."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from stereorelight.camera import Camera, RectifiedRig
from stereorelight.compare.calibrated import calibration
from stereorelight.compare.depth import bins_of, depth_figures, depth_tallies, disparity_figures
from stereorelight.compare.figures import Blink, ErrorMap, Figure, Measured, reduced
from stereorelight.compare.flicker import picture_residual
from stereorelight.compare.gate import hold, parse_gate, verdicts
from stereorelight.compare.normals import depth_normals
from stereorelight.compare.tally import STEP, Tally, added
from stereorelight.errors import GateError, PassError, ShotError
from stereorelight.shot.compare_history import Run, history_curves, history_rows
from stereorelight.shot.compare_page import compare_page

NAN = float("nan")


def f32(rows: npt.ArrayLike) -> npt.NDArray[np.float32]:
    return np.array(rows, dtype=np.float32)


def errors(seed: int, n: int = 4000) -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    e = np.abs(rng.standard_normal(n)) * rng.choice([0.1, 1, 10], n)
    e[rng.random(n) < 0.03] = NAN
    e[:5] = 0
    return np.asarray(e)


def test_bad_pixels_and_mse_are_opencvs_and_scikit_images() -> None:
    """On sixteenths of a pixel, all known and answered: what OpenCV's own evaluation of disparities gives."""
    import cv2
    from skimage.metrics import mean_squared_error, normalized_root_mse

    rng = np.random.default_rng(0)
    truth = rng.integers(16, 16 * 60, (60, 80)).astype(np.int16)
    result = (truth + rng.integers(-80, 80, truth.shape)).astype(np.int16)
    figures = disparity_figures(result / np.float32(16), truth / np.float32(16), thresholds=(0.5, 1, 2, 4)).regions["all"]
    whole = (0, 0, 80, 60)
    for limit in (0.5, 1, 2, 4):
        theirs = cv2.ximgproc.computeBadPixelPercent(truth, result, whole, int(16 * limit) + 1)  # bad from there on, ours beyond
        assert figures.bad_percent[limit] == pytest.approx(theirs, abs=1e-9)
    assert figures.rms**2 == pytest.approx(mean_squared_error(truth / 16, result / 16))
    assert figures.rms == pytest.approx(normalized_root_mse(truth / 16, result / 16, normalization="min-max") * np.ptp(truth / 16))
    assert figures.rms == pytest.approx(cv2.norm(truth / 16, result / 16, cv2.NORM_L2) / math.sqrt(truth.size))
    assert figures.average == pytest.approx(cv2.norm(truth / 16, result / 16, cv2.NORM_L1) / truth.size)


def test_tallies_add_up_to_the_figures_of_all_pixels_at_once() -> None:
    each = [errors(seed) for seed in range(5)]
    one = Tally.of(np.concatenate(each), unit="px", thresholds=(0.5, 2.0)).figures()
    summed = Tally.of(each[0], unit="px", thresholds=(0.5, 2.0))
    for e in each[1:]:
        summed = summed + Tally.of(e, unit="px", thresholds=(0.5, 2.0))
    got = summed.figures()
    assert (got.pixels, got.cover_percent, got.bad_percent) == (one.pixels, one.cover_percent, one.bad_percent)
    assert got.average == pytest.approx(one.average)
    assert got.rms == pytest.approx(one.rms)
    for q in (50, 90, 95):
        assert got.quantiles[q] == pytest.approx(one.quantiles[q], rel=STEP)
    assert got.quantiles[99] == one.quantiles[99] == math.inf
    assert summed.median == pytest.approx(float(np.nanmedian(np.concatenate(each))), rel=STEP)


def test_quantiles_are_numpys_without_interpolation() -> None:
    e = errors(3)
    got = Tally.of(e, unit="m", thresholds=()).figures().quantiles
    known = np.where(np.isfinite(e), e, np.inf).astype(np.float32)
    for q in (50, 90, 95):
        assert got[q] == np.percentile(known, q, method="inverted_cdf")
    assert Tally.of(e, unit="m", thresholds=()).median == pytest.approx(np.nanmedian(e), rel=1e-6)
    nothing = Tally.of(e[:0], unit="m", thresholds=(1.0,))
    assert math.isnan(nothing.figures().average)
    assert math.isnan(nothing.figures().bad_percent[1.0])
    assert math.isnan(nothing.median)


def test_a_curve_rises_to_the_cover() -> None:
    e = errors(1)
    x, y = Tally.of(e, unit="px", thresholds=()).curve()
    assert len(x) <= 100
    assert all(a < b for a, b in pairwise(x))
    assert all(a <= b for a, b in pairwise(y))
    assert y[-1] == pytest.approx(100 * np.isfinite(e).mean())
    at = int(np.searchsorted(x, 1.0))
    assert y[at] == pytest.approx(100 * (e <= x[at]).mean(), abs=0.1)


def test_groups_of_frames_add_where_one_lacks_a_bin() -> None:
    near, far = f32([[1.5, 1.6]]), f32([[7, 8]])
    a, b = depth_tallies(near, near), depth_tallies(far * 1.1, far)
    both = added(a, b)
    assert set(both["metres_by_distance"]) == {"1-2m", "5-10m"}
    assert both["metres"]["all"].pixels == 4
    assert both["percent_by_distance"]["5-10m"].figures().average == pytest.approx(10, rel=1e-5)
    assert both["percent"]["all"].figures().average == pytest.approx(5, rel=1e-5)


def test_bins() -> None:
    got = bins_of(f32([[0.2, 0.5, 0.99, 1, 30, NAN]]), (0.5, 1.0, 20.0), "m")
    assert {k: v[0].tolist() for k, v in got.items()} == {
        "under0.5m": [True, False, False, False, False, False],
        "0.5-1m": [False, True, True, False, False, False],
        "1-20m": [False, False, False, True, False, False],
        "over20m": [False, False, False, False, True, False],
    }


def test_points_are_as_far_apart_as_their_rays_are_long() -> None:
    """A ray of (3/4, 0, 1) is 5/4 of its Z: 10 cm of Z are 12.5 cm of space."""
    rays = np.broadcast_to(f32([0.75, 0]), (1, 4, 2))
    got = depth_figures(f32([[2.1, 2, 1.9, NAN]]), f32([[2, 2, 2, 2]]), rays=rays)
    assert got.points["all"].average == pytest.approx((0.125 + 0 + 0.125) / 3, rel=1e-5)
    assert got.points["all"].bad_percent[0.1] == 75
    assert "points" in got.to_dict()
    names = {f.name for f in got.figures()}
    assert {"point_average_m", "average_m", "average_%", "bad5%", "bad0.05m", "cover", "A90_%"} <= names
    with pytest.raises(PassError, match="rays must have shape"):
        depth_figures(f32([[1]]), f32([[1]]), rays=rays)


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02, 0.001, 0.0, 0.0)])
def test_normals_of_a_depth_are_those_of_its_plane_through_any_lens(distortion: tuple[float, ...]) -> None:
    camera = Camera(size=(64, 48), K=np.array([[60.0, 0, 31], [0, 62.0, 25], [0, 0, 1]]), distortion=distortion)
    n = np.array([0.3, -0.4, 1.0])
    n /= np.linalg.norm(n)
    Z = 3 / (camera.rays(camera.pixel_grid()) @ n)
    got = depth_normals(Z, camera.ray_grid())[3:-3, 3:-3]
    off = np.degrees(np.arccos(np.clip(got @ n, -1, 1)))
    assert off.max() < (0.1 if not distortion else 0.3)


def test_calibration_by_hand() -> None:
    """100 pixels say 0.9 and 80 of them are right: 10 % off; 100 say 0.35 and 35 are right."""
    confidence = f32([0.9] * 100 + [0.35] * 100)[None]
    error = np.array([0.5] * 80 + [3.0] * 20 + [0.9] * 35 + [NAN] * 0 + [1.5] * 65)[None]
    got = calibration(error, np.ones((1, 200), bool), confidence=confidence)
    assert got.figures()[0].value == pytest.approx(100 * (100 * 0.1 + 100 * 0.0) / 200, abs=1e-4)
    (curve,) = got.curves()
    said, right = curve.lines["share"]
    assert said == pytest.approx([0.35, 0.9])
    assert right == pytest.approx([0.35, 0.8])
    twice = got + got
    assert twice.figures()[0].value == pytest.approx(got.figures()[0].value)
    sigma = calibration(error, np.ones((1, 200), bool), sigma=np.ones((1, 200)), sigma_error=error)
    shares = {f.name: f.value for f in sigma.figures()}
    assert shares == pytest.approx({"within1sigma": 57.5, "within2sigma": 90, "within3sigma": 100})
    assert not calibration(error, np.ones((1, 200), bool)).figures()


def figure(name: str, value: float, region: str = "all", unit: str = "%") -> Figure:
    return Figure(name=name, value=value, unit=unit, region=region, table="t")


def test_gates() -> None:
    figures = [figure("bad2", 3.0), figure("bad2", 9.0, "near_edges"), figure("average_px", 0.4, unit="px"), figure("A90_px", math.inf, unit="px")]
    found = verdicts(parse_gate("bad2<3, bad2<=3,bad2@near_edges<10,average<0.5,avg_px>0.1,bad2_percent>=3"), figures[:3] + [figure("avg_px", 0.4)])
    assert [v.holds for v in found] == [False, True, True, True, True, True]
    with pytest.raises(GateError, match=r"^bad2<3: found 3 %; A90<9: found no value$"):
        hold(verdicts(parse_gate("bad2<3,bad2<4,A90<9"), figures))
    hold(verdicts(parse_gate("bad2<4"), figures))
    for text, words in (("bad2", "no condition"), ("bad2<3,", "no condition"), ("bad2<.", "no condition"), ("bd2<3", "did you mean 'bad2'")):
        with pytest.raises(ShotError, match=words):
            verdicts(parse_gate(text), figures)
    with pytest.raises(ShotError, match="did you mean 'near_edges'"):
        verdicts(parse_gate("bad2@nearedges<3"), figures)


def test_a_measured_as_json_text_and_page() -> None:
    one = Measured(what="picture", figures=(figure("psnr", 31.5, unit="dB"), figure("rms", NAN)), notes=("said",))
    assert one.to_dict() == {"all": {"psnr_dB": 31.5, "rms_percent": None}, "notes": ["said"]}
    assert one.text() == "said\n\nt    psnr dB  rms %\nall   31.500      -"
    page = compare_page(one, result="<b>", truth="t")
    assert "&lt;b&gt;" in page
    assert "31.500" in page


def test_reduced_maps_keep_thin_errors_and_gaps() -> None:
    error = np.zeros((8, 8), np.float32)
    error[3, 5] = -7
    error[:, :1] = NAN
    error[4:, 4:] = NAN
    got = reduced(error, widest=4)
    assert got.shape == (4, 4)
    assert got[1, 2] == -7
    assert np.isnan(got[2:, 2:]).all()
    assert np.isnan(got[:, 0]).all()  # half of them
    assert np.count_nonzero(got[np.isfinite(got)]) == 1
    assert reduced(error, widest=8) is error


def test_shapes_that_cannot_be_shown_are_refused() -> None:
    with pytest.raises(PassError, match="scale"):
        ErrorMap(title="", error=f32([[1]]), scale=0, unit="m")
    with pytest.raises(PassError, match="same shape"):
        ErrorMap(title="", error=f32([[1]]), scale=1, unit="m", known=np.ones((2, 2), bool))
    with pytest.raises(PassError, match="one size"):
        Blink(title="", truth=np.zeros((1, 1, 3), np.uint8), result=np.zeros((1, 2, 3), np.uint8))


def test_history() -> None:
    runs = [Run(when=f"2026-01-0{i}", what="depth", result="r", truth="t", figures={"bad2": float(i), "cover": None}) for i in (1, 2, 3)]
    rows = history_rows(runs)
    assert rows[0] == ["when", "bad2", "cover", "result"]
    assert rows[1] == ["2026-01-03", "3.000", "-", "r"]
    assert history_curves(runs)[0].lines["bad2"] == ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert not history_rows(runs[:1])


def test_picture_residual_by_hand() -> None:
    """A picture that moves by one pixel and gets 0.1 brighter, its mean light 2: 5 %."""
    rng = np.random.default_rng(0)
    a = rng.uniform(1, 3, (20, 30, 3)).astype(np.float32)
    b = np.roll(a, 1, axis=1) + np.float32(0.1)
    motion = np.zeros((20, 30, 2), np.float32)
    motion[..., 0] = 1
    motion[:, -1] = NAN
    got = picture_residual(a, b, motion)
    assert np.isnan(got[:, -1]).all()
    np.testing.assert_allclose(got[:, :-1], 100 * 0.1 / np.abs(a).mean(), rtol=1e-3)


def test_a_rig_gives_bins_of_distance() -> None:
    left, right = (Camera(size=(4, 1), K=np.array([[100.0, 0, c], [0, 100.0, 0], [0, 0, 1]])) for c in (1.5, 1.5))
    rig = RectifiedRig(left=left, right=right, baseline_m=0.2)
    got = disparity_figures(f32([[14, 14, 5, 5]]), f32([[14, 13, 5, 4]]), rig=rig)
    assert set(got.by_distance) == {"1-2m", "3-5m", "5-10m"}  # Z = 20 / d: 1.43, 1.54, 4 and 5 m
    assert got.by_distance["1-2m"].average == 0.5
