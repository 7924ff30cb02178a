"""Figures against truth, each worked by hand on small arrays."""

from __future__ import annotations

import json
import math

import numpy as np
import numpy.typing as npt
import pytest

from stereorelight.camera import Camera, RectifiedRig
from stereorelight.compare.depth import depth_figures, disparity_figures
from stereorelight.compare.edges import near_edges
from stereorelight.compare.normals import disparity_normal_figures, disparity_normals, normal_figures
from stereorelight.compare.report import comparison_json, comparison_text, error_map
from stereorelight.errors import PassError

NAN = float("nan")


def f32(rows: npt.ArrayLike) -> npt.NDArray[np.float32]:
    return np.array(rows, dtype=np.float32)


def rig(size: tuple[int, int] = (12, 9), doffs_px: float = 4.0) -> RectifiedRig:
    left, right = (Camera(size=size, K=np.array([[100.0, 0, cx], [0, 100.0, 4], [0, 0, 1]])) for cx in (5.0, 5.0 + doffs_px))
    return RectifiedRig(left=left, right=right, baseline_m=0.2)


def test_disparity_figures_by_hand() -> None:
    """Ten pixels: truth unknown at one, no answer at one, errors 0 0 0.5 0.75 1.5 3 5 and -1 elsewhere."""
    truth = f32([[10, 10, 10, 10, 10], [10, 10, 10, 10, NAN]])
    result = f32([[10, 10, 10.5, 10.75, 11.5], [13, 15, 9, NAN, 10]])
    r = disparity_figures(result, truth).regions["all"]
    assert r.pixels == 9
    assert r.cover_percent == pytest.approx(100 * 8 / 9)
    # more than, not from: 0.5 is not bad at 0.5; the pixel without an answer is bad at every threshold
    assert r.bad_percent == pytest.approx({0.5: 100 * 6 / 9, 1.0: 100 * 4 / 9, 2.0: 100 * 3 / 9, 4.0: 100 * 2 / 9})
    errors = [0, 0, 0.5, 0.75, 1, 1.5, 3, 5]
    assert r.average == pytest.approx(sum(errors) / 8)
    assert r.rms == pytest.approx(math.sqrt(sum(e * e for e in errors) / 8))
    assert r.quantiles[50] == 1  # the fifth of nine
    assert r.quantiles[90] == math.inf  # the ninth has no answer
    assert disparity_figures(result, truth).to_dict()["all"]["A90_px"] is None


def test_no_answer_never_looks_better() -> None:
    truth = np.full((8, 8), 20, np.float32)
    result = truth + np.linspace(0, 6, 64, dtype=np.float32).reshape(8, 8)
    whole = disparity_figures(result, truth).regions["all"]
    for limit in (1, 2.5, 5):
        less = disparity_figures(np.where(np.abs(result - truth) > limit, np.nan, result), truth).regions["all"]
        assert less.cover_percent < 100
        assert all(less.bad_percent[t] >= whole.bad_percent[t] for t in whole.bad_percent)
        assert all(less.quantiles[q] >= whole.quantiles[q] for q in whole.quantiles)


def test_regions() -> None:
    truth = f32([[10] * 10 + [20] * 10] * 3)
    seen = np.ones((3, 20), dtype=bool)
    seen[:, 8:10] = False
    result = truth.copy()
    result[:, 8:10] += 5  # wrong where occluded
    result[:, 12] += 3  # and three pixels from the edge
    figures = disparity_figures(result, truth, nonoccluded=seen)
    bad = {name: r.bad_percent[2.0] for name, r in figures.regions.items()}
    counts = {name: r.pixels for name, r in figures.regions.items()}
    # the edge lies between columns 9 and 10, so 5 ... 14 are near it, 8 and 9 of them occluded
    assert counts == {"all": 60, "nonoccluded": 54, "near_edges": 24, "flat": 30}
    assert bad == pytest.approx({"all": 15, "nonoccluded": 100 * 3 / 54, "near_edges": 12.5, "flat": 0})
    edges = near_edges(truth, jump=2, band_px=4)
    assert edges[0].tolist() == [False] * 5 + [True] * 10 + [False] * 5


def test_depth_figures_in_metres_per_cent_and_pixels() -> None:
    r = rig((4, 1))
    true_Z, Z = f32([[2, 2, 4, 4]]), f32([[2, 2.1, 4.2, NAN]])
    figures = depth_figures(Z, true_Z, rig=r)
    assert figures.metres["all"].average == pytest.approx(0.1, rel=1e-5)
    assert figures.metres["all"].bad_percent == pytest.approx({0.01: 75, 0.05: 75, 0.1: 50})
    assert figures.percent["all"].average == pytest.approx((0 + 5 + 5) / 3, rel=1e-5)
    assert figures.disparity is not None
    # fx b = 20 px m; the principal points' offset falls out of the difference
    assert figures.disparity.regions["all"].average == pytest.approx((0 + 20 / 2 - 20 / 2.1 + 20 / 4 - 20 / 4.2) / 3, rel=1e-4)
    assert depth_figures(Z, true_Z).disparity is None
    assert figures.to_dict()["metres"]["all"]["cover_percent"] == 75


def test_normal_figures_by_hand() -> None:
    def tilted(deg: float) -> list[float]:
        return [math.sin(math.radians(deg)), 0, math.cos(math.radians(deg))]

    truth = f32([[tilted(0)] * 6])
    result = f32([[tilted(0), tilted(10), tilted(-20), tilted(29), tilted(90), [NAN] * 3]])
    r = normal_figures(result, truth)
    assert (r.pixels, r.cover_percent) == (6, pytest.approx(100 * 5 / 6))
    assert r.median_deg == pytest.approx(20, abs=1e-4)
    assert r.mean_deg == pytest.approx((0 + 10 + 20 + 29 + 90) / 5, abs=1e-4)
    assert r.under_percent == pytest.approx({11.25: 100 * 2 / 6, 22.5: 50, 30: 100 * 4 / 6})
    inside = np.array([[True, True, False, False, False, False]])
    assert normal_figures(result, truth, mask=inside).mean_deg == pytest.approx(5, abs=1e-4)


def test_small_angles_are_not_lost_to_rounding() -> None:
    a, b = f32([[[0, 0, 1]]]), f32([[[1e-4, 0, 1]]])
    assert normal_figures(a, b).median_deg == pytest.approx(math.degrees(1e-4), rel=1e-4)


def test_disparity_normals_are_those_of_the_plane_in_space() -> None:
    """Principal points apart: the plane n . X = 3 seen by the rig has its own normal, to float32 disparities."""
    r = rig()
    n = np.array([0.4, -0.2, 1.0])
    n /= np.linalg.norm(n)
    Z = 3 / (r.left.rays(r.left.pixel_grid()) @ n)
    normals = disparity_normals(r.disparity_from_depth(Z).astype(np.float32), r)
    assert np.isnan(normals[:2]).all()
    np.testing.assert_allclose(normals[2:-2, 2:-2], np.broadcast_to(n, (5, 8, 3)), atol=1e-4)


def test_disparity_normal_figures_leave_depth_jumps_out() -> None:
    r = rig((20, 9))
    truth = f32(np.broadcast_to(np.where(np.arange(20) < 10, 10.0, 20.0), (9, 20)))
    result = truth + f32(np.arange(20) * 0.3)
    figures = disparity_normal_figures(result, truth, r)
    # 5 rows have a whole 5x5 window; columns 2 ... 4 and 15 ... 17 lie more than 4 px from the two pixels of the jump
    assert (figures.pixels, figures.cover_percent) == (5 * 6, 100)
    u = np.array([2, 3, 4, 15, 16, 17])
    q = np.where(u < 10, 14, 24) + 0.3 * u - 0.3 * (u - 5)
    assert figures.median_deg == pytest.approx(np.median(np.degrees(np.arctan2(30, q))), abs=1e-3)
    result[4, 5] = np.nan
    assert disparity_normal_figures(result, truth, r).cover_percent == pytest.approx(100 * 20 / 30)


def test_error_map_has_a_fixed_signed_scale() -> None:
    truth = f32([[10, 10, 10, 10, NAN]])
    result = f32([[10, 12, 6, NAN, 10]])
    picture = error_map(result, truth, scale=2)
    assert picture.dtype == np.uint8
    assert picture[0].tolist() == [[235, 235, 235], [178, 24, 43], [33, 102, 172], [0, 0, 0], [90, 90, 90]]
    half = error_map(f32([[11]]), f32([[10]]), scale=2)[0, 0]
    assert half.tolist() == [round((235 + 178) / 2), round((235 + 24) / 2 + 0.1), round((235 + 43) / 2)]


def test_reports() -> None:
    figures = {"disparity": disparity_figures(f32([[NAN, 2]]), f32([[1, 2]]))}
    data = json.loads(comparison_json(figures, result="a.exr", truth="b.exr"))
    assert data["result"] == "a.exr"
    assert data["disparity"]["all"]["cover_percent"] == 50
    assert data["disparity"]["all"]["A90_px"] is None
    text = comparison_text(figures, result="a.exr", truth="b.exr")
    assert text.startswith("a.exr against b.exr\n")
    assert "nan" not in text
    assert "inf" not in text


@pytest.mark.parametrize(
    ("result", "truth", "words"),
    [
        (np.ones((2, 3)), np.ones((2, 4)), "shape"),
        (np.full((2, 3), np.nan), np.ones((2, 3)), "to judge is unknown at every pixel"),
        (np.ones((2, 3)), np.full((2, 3), np.nan), "true .* unknown at every pixel"),
        ([[1.0, NAN]], [[NAN, 1.0]], "no known pixel in common"),
        (np.ones((2, 3), int), np.ones((2, 3)), "must be float"),
    ],
)
def test_what_cannot_be_compared_is_named(result: npt.ArrayLike, truth: npt.ArrayLike, words: str) -> None:
    with pytest.raises(PassError, match=words):
        disparity_figures(result, truth)
    with pytest.raises(PassError, match=words):
        depth_figures(result, truth)


def test_other_nonsense_is_named() -> None:
    one = np.ones((2, 3), np.float32)
    with pytest.raises(PassError, match="nonoccluded must be bool"):
        disparity_figures(one, one, nonoccluded=one)
    with pytest.raises(PassError, match="> 0 metres"):
        depth_figures(one, 0 * one)
    N = np.zeros((2, 3, 3), np.float32)
    with pytest.raises(PassError, match="no known pixel"):
        normal_figures(N * np.nan, N)
    with pytest.raises(PassError, match="shape"):
        normal_figures(N, N[1:])
    with pytest.raises(PassError, match="mask must be bool"):
        normal_figures(N, N, mask=one)
    with pytest.raises(PassError, match="scale"):
        error_map(one, one, scale=0)
    with pytest.raises(PassError, match="shape"):
        error_map(one, one[1:], scale=1)
    with pytest.raises(PassError, match="window_px"):
        disparity_normals(np.ones((9, 12), np.float32), rig(), window_px=4)
