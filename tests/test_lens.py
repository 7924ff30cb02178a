"""Lens distortion: OpenCV's numbers forwards, its own inverse backwards, and NaN where the model says nothing."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stereorelight.errors import RigError
from stereorelight.lens import checked_parameters, distort, fold_radius, undistort

SAME = 1e-9  # normalised units: 2e-6 px at a focal length of 2000 px
# Largest coefficients tried: stronger than any lens on sale, in OpenCV's order.
BROWN = (0.4, 0.3, 0.003, 0.003, 0.2)
RATIONAL = (0.4, 0.2, 0.003, 0.003, 0.1, 0.3, 0.15, 0.1)
FISHEYE = (0.3, 0.1, 0.05, 0.02)
KINDS = {"brown4": ("brown", BROWN[:4]), "brown5": ("brown", BROWN), "rational": ("rational", RATIONAL), "fisheye": ("fisheye", FISHEYE)}


@st.composite
def lenses(draw: st.DrawFn, kind: str) -> tuple[str, tuple[float, ...]]:
    model, bounds = KINDS[kind]
    return model, tuple(draw(st.floats(-b, b)) for b in bounds)


def disc(radius: float, count: int = 200) -> npt.NDArray[np.float64]:
    """Points (count, 2) spread over a disc, the centre and the rim included (a sunflower)."""
    r, a = radius * np.sqrt(np.linspace(0, 1, count)), np.arange(count) * 2.399963
    return np.stack([r * np.cos(a), r * np.sin(a)], axis=-1)


def one_to_one_radius(model: str, distortion: tuple[float, ...]) -> float:
    """A radius safely inside the fold, the field of any lens at most (67 degrees off axis for a fisheye, 45 otherwise)."""
    return min(0.9 * fold_radius(model, distortion), 2.4 if model == "fisheye" else 1.0)


def opencv(points: npt.NDArray[np.float64], model: str, distortion: tuple[float, ...]) -> npt.NDArray[np.float64]:
    solid = np.concatenate([points, np.ones_like(points[:, :1])], axis=-1)[:, None]
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    return project(solid, np.zeros(3), np.zeros(3), np.eye(3), np.array(distortion))[0].reshape(-1, 2)


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_distort_is_opencv(kind: str, data: st.DataObject) -> None:
    model, distortion = data.draw(lenses(kind))
    points = disc(one_to_one_radius(model, distortion))
    assert np.abs(distort(points, model, distortion) - opencv(points, model, distortion)).max() < SAME


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_undistort_inverts_distort(kind: str, data: st.DataObject) -> None:
    model, distortion = data.draw(lenses(kind))
    radius = one_to_one_radius(model, distortion)
    if model != "fisheye":
        # Tangential terms shift the fold: keep to lenses whose area grows everywhere on the disc.
        h, p = 1e-6, disc(radius, 500)
        dx = (distort(p + (h, 0), model, distortion) - distort(p - (h, 0), model, distortion)) / (2 * h)
        dy = (distort(p + (0, h), model, distortion) - distort(p - (0, h), model, distortion)) / (2 * h)
        assume((dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0] > 0.02).all())
    points = disc(radius)
    back = undistort(distort(points, model, distortion), model, distortion)
    # A fisheye's angle is what is exact; its tangent grows with 1 + tan^2.
    assert (np.abs(back - points).max(axis=-1) < SAME * (1 + (points**2).sum(axis=-1))).all()


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_undistort_never_invents(kind: str, data: st.DataObject) -> None:
    """Whatever comes back, the lens puts it where it was asked about; everything else is NaN."""
    model, distortion = data.draw(lenses(kind))
    bent = disc(data.draw(st.floats(0.1, 5)))
    straight = undistort(bent, model, distortion)
    known = np.isfinite(straight).all(axis=-1)
    again = distort(straight[known], model, distortion)
    assert np.array_equal(np.isnan(straight[:, 0]), np.isnan(straight[:, 1]))
    assert known[0]  # the centre
    # At the rim itself (a right angle off axis, the fold) the tangent rounds over: leave a hair.
    inside = (straight[known] ** 2).sum(axis=-1) < min(0.999 * fold_radius(model, distortion), 1e3) ** 2
    assert np.abs(again - bent[known])[inside].max(initial=0) < 1e-6


BARREL = (-0.3, 0.0, 0.0, 0.0)  # folds where 1 - 0.9 r^2 = 0
BARREL_FOLD = 1 / math.sqrt(0.9)


def test_fold_of_a_barrel() -> None:
    assert fold_radius("brown", BARREL) == pytest.approx(BARREL_FOLD, abs=1e-3)
    assert fold_radius("brown", (0.1, 0.0, 0.0, 0.0)) == math.inf
    assert fold_radius("brown", ()) == math.inf


def test_fold_of_a_rational_lens_is_its_pole() -> None:
    # 1 - 0.5 r^2 in the denominator: the lens shoots off to infinity at r = sqrt(2).
    assert fold_radius("rational", (0, 0, 0, 0, 0, -0.5, 0, 0)) == pytest.approx(math.sqrt(2), abs=1e-3)


def test_fold_of_a_fisheye() -> None:
    # theta (1 - 0.2 theta^2) stops growing at theta = sqrt(1 / 0.6).
    assert math.atan(fold_radius("fisheye", (-0.2, 0, 0, 0))) == pytest.approx(math.sqrt(1 / 0.6), abs=1e-3)
    assert fold_radius("fisheye", ()) == math.inf


@pytest.mark.parametrize(("model", "distortion"), [("brown", BARREL), ("rational", (0, 0, 0, 0, 0, -0.5, 0, 0)), ("fisheye", (-0.3, 0, 0, 0))])
def test_nan_beyond_the_fold_and_nowhere_else(model: str, distortion: tuple[float, ...]) -> None:
    fold = fold_radius(model, distortion)
    around = np.stack([np.cos(np.arange(12)), np.sin(np.arange(12))], axis=-1)
    assert np.isfinite(distort(around * fold * 0.999, model, distortion)).all()
    assert np.isnan(distort(around * fold * 1.002, model, distortion)).all()


def test_no_straight_point_beyond_the_farthest_bent_one() -> None:
    farthest = BARREL_FOLD * (1 - 0.3 * BARREL_FOLD**2)
    around = np.stack([np.cos(np.arange(12)), np.sin(np.arange(12))], axis=-1)
    assert np.isfinite(undistort(around * farthest * 0.999, "brown", BARREL)).all()
    assert np.isnan(undistort(around * farthest * 1.001, "brown", BARREL)).all()


def test_the_branch_beyond_the_fold_is_never_the_answer() -> None:
    """This lens grows again beyond its fold, so that every bent point has a straight one there: a wrong one."""
    lens = (-0.9, 0.35, 0.0, 0.0)
    r = np.linspace(0, fold_radius("brown", lens), 2000)
    farthest = float((r * (1 - 0.9 * r**2 + 0.35 * r**4)).max())
    bent = np.stack([np.linspace(1.001, 8, 400) * farthest, np.zeros(400)], axis=-1)
    assert np.isnan(undistort(bent, "brown", lens)).all()
    assert np.isfinite(undistort(bent / 8.02, "brown", lens)).all()


def test_strong_fisheye_of_both_signs_comes_back() -> None:
    """Plain Newton steps left the model's reach for lenses like this one."""
    distortion = (0.15122403579353258, 0.0692021991391786, -0.04361378504047178, -0.013179840588786088)
    points = disc(3.9)
    assert np.abs(undistort(distort(points, "fisheye", distortion), "fisheye", distortion) - points).max() < 1e-7


def test_beside_a_pole_comes_back() -> None:
    distortion = (-0.0218, 0.18, 0.0, 0.0, 0.1479, -0.2421, -0.2376, -0.0425)
    points = disc(1.1)
    assert np.abs(undistort(distort(points, "rational", distortion), "rational", distortion) - points).max() < SAME


@pytest.mark.parametrize(
    ("model", "distortion"), [("brown", ()), ("brown", (0.0,) * 5), ("brown", BARREL), ("rational", RATIONAL), ("fisheye", FISHEYE)]
)
def test_nan_stays_nan_and_the_input_is_left_alone(model: str, distortion: tuple[float, ...]) -> None:
    points = np.array([[0.1, 0.2], [np.nan, 0.1], [0.0, 0.0]])
    before = points.copy()
    for way in (distort, undistort):
        out = way(points, model, distortion)
        assert np.isnan(out[1]).any()
        assert np.isfinite(out[[0, 2]]).all()
        assert out is not points
        assert np.array_equal(out[2], (0, 0))
    assert np.array_equal(points, before, equal_nan=True)


@pytest.mark.parametrize("shape", [(2,), (0, 2), (3, 4, 2)])
@pytest.mark.parametrize("kind", KINDS)
def test_any_shape(kind: str, shape: tuple[int, ...]) -> None:
    model, distortion = KINDS[kind]
    points = np.full(shape, 0.2)
    assert distort(points, model, distortion).shape == shape
    assert undistort(points, model, distortion).shape == shape


@pytest.mark.parametrize(
    ("model", "distortion", "words"),
    [
        ("brwn", (), "did you mean 'brown'"),
        (["brown"], (), "is unknown"),
        (None, (), "is unknown"),
        ("brown", (0.1,) * 3, "takes 0 or 4 or 5 parameters, got 3"),
        ("rational", (0.1,) * 5, "takes 0 or 8 parameters, got 5"),
        ("fisheye", (0.1,) * 5, "takes 0 or 4 parameters, got 5"),
        ("brown", (0.1, math.nan, 0, 0), "not finite"),
        ("brown", (0.1, math.inf, 0, 0), "not finite"),
        ("brown", ("a", 0, 0, 0), "must be numbers"),
        ("brown", None, "must be numbers"),
        ("brown", (10**400, 0, 0, 0), "must be numbers"),
    ],
)
def test_parameters_refused(model: object, distortion: object, words: str) -> None:
    with pytest.raises(RigError) as caught:
        checked_parameters(model, distortion)  # type: ignore[arg-type]
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_opencv_row_of_parameters_is_taken() -> None:
    assert checked_parameters("brown", np.array([[0.1, 0.2, 0.3, 0.4, 0.5]])) == (0.1, 0.2, 0.3, 0.4, 0.5)  # type: ignore[arg-type]
