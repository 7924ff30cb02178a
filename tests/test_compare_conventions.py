"""What a renderer's pass is, found from its values: every kind of depth in every unit, every axes of P and N, worlds, sizes and crops; and doubt."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from stereorelight.camera import Camera
from stereorelight.compare.axes import all_axes, axes_named, axis_words, coding_of, detect_normals, detect_positions
from stereorelight.compare.conventions import (
    CODE_UNITS,
    KINDS,
    SCALED,
    UNITS,
    WORDS,
    DepthForm,
    Kind,
    depth_from,
    detect_depth,
    detect_disparity,
    ray_factor,
)
from stereorelight.compare.placing import Placement, nearest, place, placed
from stereorelight.errors import PassError
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named

SIZE = (160, 90)
NOISE = 0.04  # of Z: much worse than any stereo, with a tenth of the pixels wild besides


class View:
    """A rendered view: Z, P, N, rays, and a result as bad as results are."""

    def __init__(self, scene: str) -> None:
        shot = render(scene_named(scene), rig_named("parallel", SIZE), samples=1)
        assert shot.left.camera is not None
        self.camera: Camera = shot.left.camera
        self.rays = self.camera.ray_grid()
        self.Z, self.P, self.N = (shot.left[name].astype(np.float64) for name in ("Z", "P", "N"))
        rng = np.random.default_rng(1)
        self.result = self.Z * np.exp(NOISE * rng.standard_normal(self.Z.shape))
        wild = rng.random(self.Z.shape) < 0.1
        self.result[wild] *= rng.uniform(0.5, 2, int(wild.sum()))
        self.result[:, :9] = np.nan
        self.fair_result = np.where(rng.random(self.Z.shape) < 0.02, 1.4, 1) * self.Z * np.exp(0.01 * rng.standard_normal(self.Z.shape))
        N = self.N + 0.15 * rng.standard_normal(self.N.shape)
        self.noisy_N = N / np.linalg.norm(N, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def interior() -> View:
    return View("interior")


@pytest.fixture(scope="module", params=["bust", "interior"])
def view(request: pytest.FixtureRequest, interior: View) -> View:
    return interior if request.param == "interior" else View(request.param)


def written(view: View, kind: Kind, metres: float = 1.0, near: float = 0.4, far: float = 30.0) -> npt.NDArray[np.float32]:
    """What a renderer would write, from its definition."""
    length = view.Z * np.sqrt(1 + (view.rays.astype(np.float64) ** 2).sum(axis=-1)) if "ray" in kind else view.Z
    if kind in SCALED:
        return np.asarray(metres / length if kind.startswith("inverse") else length / metres, np.float32)
    t = (1 / length - 1 / near) / (1 / far - 1 / near) if kind.endswith("buffer") else (length - near) / (far - near)
    return np.asarray(1 - t if kind.startswith("reversed") else t, np.float32)


def test_every_kind_in_every_unit_against_a_bad_result(view: View) -> None:
    """24 combinations; at 40 degrees of view a ray is at most 8 % longer than its Z, against 4 % of noise."""
    for kind in SCALED:
        for metres in UNITS.values():
            values = written(view, kind, metres)
            found = detect_depth(values, view.result, rays=view.rays)
            assert found.sure, found.doubt
            assert (found.form.kind, found.form.metres) == (kind, metres), found.words
            assert found.share > found.next_share
            np.testing.assert_allclose(depth_from(values, found.form, view.rays), view.Z, rtol=1e-5)


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in SCALED])
def test_normalised_depth_is_known_and_its_ends_are_asked_for(view: View, kind: Kind) -> None:
    values = written(view, kind)
    found = detect_depth(values, view.result, rays=view.rays)
    assert found.form.kind == kind
    assert not found.sure
    assert "--near" in found.doubt
    assert f"--truth-is {kind}" in found.doubt
    exact = detect_depth(values, view.Z, rays=view.rays, exact=True)
    assert exact.sure
    assert exact.form.near_m == pytest.approx(0.4, rel=1e-3)
    assert exact.form.far_m == pytest.approx(30, rel=1e-3)
    told = depth_from(values, DepthForm(kind=kind, near_m=0.4, far_m=30.0), view.rays)
    np.testing.assert_allclose(told, view.Z, rtol=2e-3)


def test_the_evidence_is_said(view: View) -> None:
    found = detect_depth(written(view, "ray"), view.Z, rays=view.rays)
    assert found.words.startswith("truth is ray length in m: 100 % of pixels fit the result within 0.1 %, against ")
    assert found.words.endswith(f"as {WORDS['z']}")


def test_whole_numbers_know_the_units_of_the_datasets(view: View) -> None:
    for metres in (0.001, 1 / 256, 1 / 5000, 0.01):
        codes = np.rint(view.Z / metres).astype(np.float32)
        found = detect_depth(codes, view.result, rays=view.rays, units=CODE_UNITS, top=65535.0)
        assert found.sure, found.doubt
        assert (found.form.kind, found.form.metres) == ("z", pytest.approx(metres))


def test_doubt_is_said_as_doubt(view: View) -> None:
    odd = detect_depth(written(view, "z", 0.55), view.result, rays=view.rays)
    assert not odd.sure
    assert "no unit" in odd.doubt
    shuffled = np.random.default_rng(0).permutation(view.Z.ravel()).reshape(view.Z.shape)
    lost = detect_depth(shuffled, view.result, rays=view.rays)
    assert not lost.sure
    # A result that goes half the way from Z to the ray takes no side.
    between = detect_depth(view.Z, view.Z / np.sqrt(ray_factor(view.rays, view.Z.shape)), rays=view.rays)
    assert not between.sure
    assert "may as well be" in between.doubt
    blind = detect_depth(written(view, "ray"), view.Z, rays=None)
    assert not blind.sure
    assert "--rig" in blind.doubt
    assert detect_depth(written(view, "z"), view.result, rays=None).sure
    with pytest.raises(PassError, match="hardly a known pixel"):
        detect_depth(view.Z * np.nan, view.result, rays=view.rays)
    # Where a long lens makes ray and Z one, it does not matter, and is no doubt.
    assert detect_depth(view.Z, view.result, rays=view.rays * np.float32(0.01)).sure


def test_a_form_refuses_what_it_cannot_be() -> None:
    with pytest.raises(PassError, match="--near and --far"):
        DepthForm(kind="normalised")
    with pytest.raises(PassError, match="near < far"):
        DepthForm(kind="buffer", near_m=3, far_m=1)
    with pytest.raises(PassError, match="unit"):
        DepthForm(metres=0)
    with pytest.raises(PassError, match="camera"):
        depth_from(np.ones((2, 2)), DepthForm(kind="ray"))
    values = np.array([[0.0, 0.5, 1.0, np.nan]])
    told = depth_from(values, DepthForm(kind="normalised", near_m=1, far_m=3))
    assert np.isnan(told[0, [0, 2, 3]]).all()
    assert told[0, 1] == 2
    assert ray_factor(None, (2, 2)).tolist() == [[1, 1], [1, 1]]


def test_all_48_axes_of_points_in_any_unit(interior: View) -> None:
    view = interior
    for matrix in all_axes():
        found = detect_positions((view.P @ matrix * 100).astype(np.float16).astype(np.float32), view.rays)
        assert found.sure, found.doubt
        np.testing.assert_array_equal(found.axes.matrix, matrix)


def test_all_48_axes_of_normals_coded_either_way(interior: View) -> None:
    """48 combinations, against normals 12 degrees off."""
    view = interior
    known = np.isfinite(view.N).all(axis=-1)
    for i, matrix in enumerate(all_axes()):
        coded = i % 2 == 1
        raw = view.N @ matrix
        raw = ((raw + 1) / 2 if coded else raw).astype(np.float16).astype(np.float32)
        found = detect_normals(raw, view.noisy_N)
        assert found.sure, found.doubt
        assert found.axes.coded is coded
        np.testing.assert_allclose(found.axes.normals(raw)[known], view.N[known], atol=2e-3)


def turn(a: float, b: float, c: float) -> npt.NDArray[np.float64]:
    (sa, ca), (sb, cb), (sc, cc) = ((np.sin(t), np.cos(t)) for t in (a, b, c))
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return np.asarray(x @ y @ z)


@pytest.mark.parametrize("mirrored", [False, True])
def test_points_and_normals_of_a_world(view: View, mirrored: bool) -> None:
    world = turn(0.4, -0.7, 0.2) @ np.diag([1, 1, -1.0 if mirrored else 1.0])
    P = (view.P @ world.T + (3, 1.5, -2)).astype(np.float32)
    found = detect_positions(P, view.rays)
    assert found.sure, found.doubt
    assert ("left-handed" in found.words) is mirrored
    assert "the camera stands at (3, 1.5, -2)" in found.words
    np.testing.assert_allclose(found.axes.points(P), view.P, atol=2e-3)
    N = (view.N @ world.T).astype(np.float32)
    of_P = detect_normals(N, view.noisy_N, world=found.axes.matrix)
    assert of_P.sure, of_P.doubt
    np.testing.assert_allclose(of_P.axes.normals(N), view.N, atol=2e-3)
    # From what is judged alone, a turn is seen and not believed.
    doubted = detect_normals(N, view.noisy_N)
    assert not doubted.sure
    assert "world" in doubted.words
    assert "--poses" in doubted.doubt


def test_points_of_another_camera_are_refused(view: View) -> None:
    found = detect_positions(view.P.astype(np.float32), view.rays * np.float32(1.3))
    assert not found.sure
    assert "--rig" in found.doubt


def test_normals_that_all_point_one_way_tell_nothing_of_a_turn() -> None:
    n = np.array([0.3, -0.2, np.sqrt(1 - 0.13)])
    wall = np.broadcast_to(n, (40, 60, 3)).astype(np.float32)
    assert detect_normals(wall, wall).sure
    assert not detect_normals(wall @ turn(0, 0, np.pi / 2).T.astype(np.float32), wall).sure


def test_coding_of_nonsense() -> None:
    assert coding_of(np.full((20, 20, 3), 7.0, np.float32)) is None
    with pytest.raises(PassError, match="no unit vector"):
        detect_normals(np.full((20, 20, 3), 7.0, np.float32), np.ones((20, 20, 3), np.float32))


def test_axes_by_name() -> None:
    assert axes_named("right,up,back").tolist() == np.eye(3).tolist()
    assert axes_named("x right, y down, z forward").tolist() == np.diag([1, -1, -1]).tolist()
    assert axis_words(axes_named("forward left up")) == ("forward", "left", "up")
    with pytest.raises(PassError, match="did you mean 'forward'"):
        axes_named("right,down,forwards")
    with pytest.raises(PassError, match="where x, y and z point"):
        axes_named("right,right,up")


@pytest.mark.parametrize("factor", [1.0, -1.0, 1 / 256, -1 / 16, float(SIZE[0])])
def test_disparity_in_other_terms(factor: float) -> None:
    rng = np.random.default_rng(0)
    truth = rng.uniform(5, 60, (SIZE[1], SIZE[0]))
    found, words, doubt = detect_disparity(truth / factor, truth + rng.standard_normal(truth.shape), width=SIZE[0])
    assert found == pytest.approx(factor)
    assert not doubt
    assert ("turned" in words) is (factor < 0)
    assert "--unit" in detect_disparity(truth * 3.3, truth, width=SIZE[0])[2]


def test_a_resized_truth_lies_edge_on_edge() -> None:
    """A slope in 1 / Z, which is what a plane is: read at any size it is the same slope at the same edges."""

    def plane(w: int, h: int) -> npt.NDArray[np.float64]:
        x, y = (np.arange(w) + 0.5) / w, (np.arange(h) + 0.5) / h
        return 1 / (0.3 + 0.1 * x[None, :] + 0.05 * y[:, None])

    for w, h in ((96, 54), (384, 216), (288, 162)):
        where = place(plane(w, h), plane(192, 108))
        assert where.scale == (w / 192, h / 108)
        got = placed(plane(w, h), (108, 192), where, inverse=True)
        np.testing.assert_allclose(got[2:-2, 2:-2], plane(192, 108)[2:-2, 2:-2], rtol=1e-6)


def test_two_surfaces_are_never_mixed_between_pixels() -> None:
    Z = np.where(np.arange(64) < 31, 1.0, 4.0)[None, :].repeat(36, axis=0)
    got = placed(Z, (18, 32), Placement(scale=(2.0, 2.0)), inverse=True)
    assert set(np.unique(got)) <= {1.0, 4.0}
    vectors = np.where(np.arange(64) < 31, 0, 1)[None, :, None] * [1.0, 0, -1] + [0, 0, 1.0]
    assert set(np.unique(placed(np.broadcast_to(vectors, (36, 64, 3)), (18, 32), Placement(scale=(2.0, 2.0))))) <= {0.0, 1.0}


@pytest.mark.parametrize(("x", "y", "w", "h"), [(40, 12, 100, 70), (0, 0, 130, 90), (-16, -9, 192, 108), (-20, 10, 140, 70)])
def test_crop_and_overscan_are_found(view: View, x: int, y: int, w: int, h: int) -> None:
    wide = np.full((h, w), np.nan)
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + w, SIZE[0]), min(y + h, SIZE[1])
    wide[y0 - y : y1 - y, x0 - x : x1 - x] = 1 / view.Z[y0:y1, x0:x1]  # of another convention besides
    found = place(wide, view.fair_result)
    assert found.offset == (-x, -y), found
    laid = nearest(wide, view.Z.shape, found)
    np.testing.assert_array_equal(laid[y0:y1, x0:x1], 1 / view.Z[y0:y1, x0:x1])


def test_a_place_that_cannot_be_found_is_asked_for(view: View) -> None:
    with pytest.raises(PassError, match="--crop X,Y"):
        place(np.random.default_rng(0).uniform(1, 9, (70, 90)), view.Z)
