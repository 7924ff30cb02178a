"""The solve: a made-up rig goes in as corners, the same rig comes out, and its stated uncertainty is honest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereorelight.arrays import Float64
from stereorelight.calibration.answer import Calibration, Known, focal_from_lens
from stereorelight.calibration.bundle import fit, moved
from stereorelight.calibration.lens_choice import choose, eye_candidates, simplest
from stereorelight.calibration.projection import LENSES, camera_of, intrinsics_of, lens_of, project
from stereorelight.calibration.sightings import Corners, StereoViews, flipped_back
from stereorelight.calibration.solve import solve_rig
from stereorelight.calibration.start import first_guess
from stereorelight.calibration.uncertainty import answer_at, coverage, depth_rows, depth_sigma_mm, frame_grid, projection_sigma, standard_errors
from stereorelight.calibration.validate import corners_in_space, rectifying, validate, with_quality
from stereorelight.camera import Camera, Rig
from stereorelight.errors import RigError
from tests.calibration_views import LENS, PLAIN, RIGS, SIZE, board, camera, rig, turned_by_deg, views_of

SIZES = (SIZE, SIZE)
FOCAL, BASELINE, ROTATION_DEG = 0.0002, 0.0005, 0.005  # what 20 tilted views must give


def solved(name: str, **kw: object) -> Calibration:
    return solve_rig(views_of(RIGS[name], **kw), SIZES, (LENS[name], LENS[name]))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def toed_in() -> Calibration:
    return solved("toed-in")


def assert_same_rig(got: Rig, truth: Rig, *, focal: float = FOCAL, baseline: float = BASELINE, rotation_deg: float = ROTATION_DEG) -> None:
    for one, true in ((got.left, truth.left), (got.right, truth.right)):
        assert one.fx == pytest.approx(true.fx, rel=focal)
        assert one.fy == pytest.approx(true.fy, rel=focal)
    assert got.baseline_m == pytest.approx(truth.baseline_m, rel=baseline)
    assert turned_by_deg(got.R_right_left, truth.R_right_left) < rotation_deg


@pytest.mark.parametrize("lens", LENSES)
def test_derivatives_are_those_of_the_ground_lens(lens: str) -> None:
    lenses = {"pinhole": (), "brown4": (-0.2, 0.1, 0.001, -0.002), "brown5": (-0.2, 0.1, 0.001, -0.002, 0.02)}
    k = lenses.get(lens, (-0.2, 0.1, 0.001, -0.002, 0.02, 0.1, 0.02, 0.03) if lens == "rational" else (0.1, -0.02, 0.01, 0.003))
    intrinsics = np.array([500.0, 510, 320, 240, *k])
    points = np.random.default_rng(0).normal(size=(40, 3)) * (0.4, 0.3, 0.1) + (0, 0, 1.2)
    points[0] = (0, 0, 1)
    px, by_point, by_lens = project(points, intrinsics, lens)
    ground = camera_of(intrinsics, lens, (640, 480))
    assert np.abs(px - ground.project(points)).max() < 1e-9
    assert lens_of(ground) == lens
    assert np.array_equal(intrinsics_of(ground), intrinsics)
    h = 1e-6
    for j, axis in enumerate(np.eye(3) * h):
        assert np.allclose(
            (project(points + axis, intrinsics, lens)[0] - project(points - axis, intrinsics, lens)[0]) / (2 * h), by_point[..., j], atol=1e-3
        )
    for j, axis in enumerate(np.eye(len(intrinsics)) * h):
        assert np.allclose(
            (project(points, intrinsics + axis, lens)[0] - project(points, intrinsics - axis, lens)[0]) / (2 * h), by_lens[..., j], atol=1e-4
        )


@pytest.mark.parametrize("name", RIGS)
def test_twenty_tilted_views_give_the_rig_back(name: str) -> None:
    result = solved(name)
    assert_same_rig(result.rig, RIGS[name])
    assert not result.outliers
    assert result.sigma_px == pytest.approx(0.02, rel=0.1)
    assert result.rms_px == pytest.approx(0.02 * np.sqrt(2), rel=0.1)


@pytest.mark.parametrize(("name", "wide"), [("fisheye", True), ("toed-in", False)])
def test_a_solve_starts_from_the_kind_of_lens_that_it_is(name: str, wide: bool) -> None:
    """Bent as no lens of its own family would be at the start, it begins as the other one; and one view in eight may be nonsense."""
    seen = views_of(RIGS[name]).px[0].copy()
    seen[3] = seen[3][::-1] * (0.3, 1.4)
    for lens, bend in (("fisheye", 0.0 if wide else 1 / 3), ("brown5", -0.2 if wide else 0.0)):
        guess, _, _, placed = first_guess(board(), seen, SIZE, lens)
        assert guess[0] == pytest.approx(RIGS[name].left.fx, rel=0.15)
        assert guess[4] == pytest.approx(bend)
        assert placed.sum() >= 19


def test_without_noise_the_rig_comes_back_exactly() -> None:
    result = solved("unequal", noise_px=0.0)
    assert_same_rig(result.rig, RIGS["unequal"], focal=1e-7, baseline=1e-7, rotation_deg=1e-5)
    assert np.allclose(result.rig.left.distortion, RIGS["unequal"].left.distortion, atol=1e-6)


def test_a_mirrored_eye_is_flipped_back() -> None:
    truth = rig(camera(1400, 645, 470, *PLAIN), camera(1405, 631, 484, *PLAIN), (0.3, 2.0, 0.5), mirrored="right")
    seen = views_of(truth)
    raw = [flipped_back(c, SIZE[0]) for c in seen.right if c is not None]  # what the mirror gives; flipping is its own inverse
    back = [flipped_back(c, SIZE[0]) for c in raw]
    result = solve_rig(StereoViews(points_m=seen.points_m, left=seen.left, right=back, mirrored="right"), SIZES, ("brown4", "brown4"))
    assert result.rig.mirrored == "right"
    assert_same_rig(result.rig, truth)


def test_a_board_twice_as_large_is_a_baseline_twice_as_long(toed_in: Calibration) -> None:
    seen = toed_in.views
    twice = solve_rig(StereoViews(points_m=seen.points_m * 2, left=seen.left, right=seen.right), SIZES, toed_in.lenses)
    assert twice.rig.baseline_m == pytest.approx(2 * toed_in.rig.baseline_m, rel=1e-7)
    assert twice.rig.left.fx == pytest.approx(toed_in.rig.left.fx, rel=1e-7)


def test_the_order_of_views_changes_nothing(toed_in: Calibration) -> None:
    seen, order = toed_in.views, np.random.default_rng(1).permutation(len(toed_in.views))
    mixed = StereoViews(points_m=seen.points_m, left=[seen.left[i] for i in order], right=[seen.right[i] for i in order])
    again = solve_rig(mixed, SIZES, toed_in.lenses)
    assert np.allclose(again.rig.left.K, toed_in.rig.left.K, rtol=1e-6)
    assert np.allclose(again.rig.t_right_left_m, toed_in.rig.t_right_left_m, atol=1e-8)
    assert np.allclose(again.view_rms_px, toed_in.view_rms_px[:, order], atol=1e-6)


def test_swapped_eyes_invert_the_pose(toed_in: Calibration) -> None:
    problem, state = toed_in.fit.problem, toed_in.fit.state
    R, t = state.R_right_left, state.t_right_left_m
    other = replace(problem, px=problem.px[::-1].copy(), weight=problem.weight[::-1].copy())
    wrong = t * 1.01  # so that there is something to solve
    start = replace(
        state,
        intrinsics=(state.intrinsics[1], state.intrinsics[0]),
        R_right_left=R.T,
        t_right_left_m=-R.T @ wrong,
        R=R @ state.R,
        t_m=state.t_m @ R.T + t,
    )
    swapped = fit(other, start).state
    assert np.allclose(swapped.R_right_left, R.T, atol=1e-7)
    assert np.allclose(swapped.t_right_left_m, -R.T @ t, atol=1e-7)
    with pytest.raises(RigError, match="left and right swapped"):
        solve_rig(StereoViews(points_m=problem.points_m, left=toed_in.views.right, right=toed_in.views.left), SIZES, toed_in.lenses)


def spoilt(seen: StereoViews, *, share: float, bad_view: int | None, unsynchronised: int | None) -> tuple[StereoViews, Float64]:
    rng = np.random.default_rng(5)
    px = seen.px.copy()
    bad = rng.random(px.shape[:3]) < share
    px[bad] += rng.uniform(2, 30, size=(int(bad.sum()), 1)) * rng.choice([-1, 1], size=(int(bad.sum()), 2))
    if bad_view is not None:
        px[0, bad_view] += rng.normal(size=px[0, 0].shape) * 8
    if unsynchronised is not None:
        px[1, unsynchronised] += (6, 3)
    eyes = [[Corners(ids=np.arange(px.shape[2]), px=p) for p in eye] for eye in px]
    return StereoViews(points_m=seen.points_m, left=eyes[0], right=eyes[1]), bad


def test_bad_corners_and_bad_views_are_marked_with_reasons_and_do_not_count() -> None:
    seen, bad = spoilt(views_of(RIGS["unequal"]), share=0.05, bad_view=3, unsynchronised=7)
    result = solve_rig(seen, SIZES, ("brown4", "brown4"))
    assert_same_rig(result.rig, RIGS["unequal"])
    whole = {(o.view, o.eye): o.reason for o in result.outliers if not o.ids}
    assert set(whole) == {(3, "left"), (7, "left"), (7, "right")}
    assert "left eye" in whole[3, "left"]
    assert "not of the same moment" in whole[7, "right"] or "same moment" in whole[7, "right"]
    good_views = [v for v in range(len(seen)) if v not in (3, 7)]
    assert not (result.kept & bad).any()
    assert result.kept[:, good_views][~bad[:, good_views]].mean() > 0.999  # bad corners alone are left out
    assert result.rms_px < 0.04 < 1 < result.rms_all_px
    assert result.rms_before_px > 1
    assert np.isfinite(result.view_rms_px).all()


def test_views_of_one_eye_alone_still_help_that_eye() -> None:
    seen = views_of(RIGS["toed-in"], count=16)
    fewer = StereoViews(points_m=seen.points_m, left=seen.left, right=[c if i < 6 else None for i, c in enumerate(seen.right)])
    six = StereoViews(points_m=seen.points_m, left=seen.left[:6], right=seen.right[:6])
    alone, helped = (standard_errors(solve_rig(v, SIZES, ("brown4", "brown4"))) for v in (six, fewer))
    assert helped["left.fx"] < 0.8 * alone["left.fx"]


def test_the_same_rig_another_day_keeps_its_lenses() -> None:
    truth = RIGS["distorted"]
    today = Rig(left=truth.left, right=truth.right, R_right_left=RIGS["fisheye"].R_right_left, t_right_left_m=truth.t_right_left_m * 1.02)
    result = solve_rig(views_of(today, count=3), SIZES, ("brown4", "brown4"), Known(rig=truth))
    assert result.rig.left is truth.left  # to the bit, every parameter of the lens
    assert result.lenses == ("brown5", "brown5")
    assert turned_by_deg(result.rig.R_right_left, today.R_right_left) < ROTATION_DEG
    assert np.allclose(result.rig.t_right_left_m, today.t_right_left_m, atol=2e-5)
    assert standard_errors(result)["left.fx"] == 0
    with pytest.raises(RigError, match="calibrated at"):
        solve_rig(views_of(today, count=3), ((640, 480), SIZE), ("brown4", "brown4"), Known(rig=truth))


def test_what_is_known_pulls_as_hard_as_it_is_sure() -> None:
    seen = views_of(RIGS["toed-in"], count=6, noise_px=0.2)
    free = solve_rig(seen, SIZES, ("brown4", "brown4"))
    held = solve_rig(seen, SIZES, ("brown4", "brown4"), Known(baseline_m=(0.13, 1e-7)))
    loose = solve_rig(seen, SIZES, ("brown4", "brown4"), Known(baseline_m=(0.13, 10.0), focal_px=((1000.0, 1e6), None)))
    assert held.rig.baseline_m == pytest.approx(0.13, abs=1e-6)
    assert loose.rig.baseline_m == pytest.approx(free.rig.baseline_m, rel=1e-6)
    focal = focal_from_lens(35.0, 32.0, SIZE)
    assert focal == pytest.approx((1400, 28))


@pytest.mark.slow
def test_a_board_that_is_not_true_is_found_out_and_solved() -> None:
    plan = board(7, 5, 0.04)
    own = plan + np.random.default_rng(3).normal(size=plan.shape) * 1e-4
    seen = views_of(RIGS["toed-in"], points_m=own, plan_m=plan, noise_px=0.05)
    choice, result = choose(seen, SIZES, candidates=("brown4",))
    taken_true = solve_rig(seen, SIZES, ("brown4", "brown4"))
    assert choice.board == "free"
    assert result.rms_px < 0.08 < 0.15 < taken_true.rms_px
    solved_shape, true_shape = (np.linalg.norm(b[:, None] - b[None], axis=-1) for b in (result.board_m, own))
    assert np.std(solved_shape - true_shape) < 0.4 * np.std(np.linalg.norm(plan[:, None] - plan[None], axis=-1) - true_shape)
    error = abs(result.rig.left.cx - RIGS["toed-in"].left.cx)
    assert error < 3 * standard_errors(result)["left.cx"]


@pytest.mark.slow
def test_the_lens_is_chosen_by_views_left_out() -> None:
    fisheye = simplest(eye_candidates(views_of(RIGS["fisheye"], count=12, noise_px=0.05), "left", SIZE))
    assert fisheye.name in ("fisheye", "rational")
    tried = eye_candidates(views_of(RIGS["toed-in"], count=12, noise_px=0.05), "left", SIZE, candidates=("brown4", "brown5", "rational"))
    assert simplest(tried).name == "brown4"  # the one that made them, although
    assert min(tried, key=lambda c: c.rms_px).parameters >= simplest(tried).parameters


def test_frontal_views_are_flagged_with_what_to_shoot() -> None:
    result = solved("toed-in", tilt_deg=(0, 4), noise_px=0.05)
    quality = validate(result)
    focal = next(a for a in quality.advice if a.name == "focal")
    assert focal.level == "bad"
    assert "30 to 45 degrees" in focal.remedy
    assert quality.verdict == "bad"


def test_good_views_are_called_good(toed_in: Calibration) -> None:
    quality = validate(toed_in, distances_m=(1.0, 2.0))
    levels = {a.name: a.level for a in quality.advice}
    assert levels["focal"] == levels["views"] == levels["held-out"] == levels["depth"] == "good"
    assert quality.held_out_mean_px == pytest.approx(0.02 * np.sqrt(2) * np.sqrt(2 / np.pi), rel=0.15)  # the corners' noise and no more
    assert quality.halves_px is not None
    assert max(np.nanmax(h) for h in quality.halves_px) < 1
    assert quality.square_mean == pytest.approx(1, abs=0.001)
    carried = with_quality(toed_in.rig, quality).quality
    assert carried["verdict"] == quality.verdict
    assert carried["depth"][0]["depth_mm"] > 0


@pytest.mark.parametrize(("pairs", "words"), [(0, "0 of 8"), (2, "2 of 8")])
def test_too_few_pairs_are_refused(pairs: int, words: str) -> None:
    seen = views_of(RIGS["unequal"], count=8)
    right = [c if i < pairs else None for i, c in enumerate(seen.right)]
    with pytest.raises(RigError, match=words):
        solve_rig(StereoViews(points_m=seen.points_m, left=seen.left, right=right), SIZES, ("brown4", "brown4"))


def test_corners_that_fit_no_rig_are_refused_not_solved() -> None:
    rng = np.random.default_rng(0)
    left, right = ([Corners(ids=np.arange(88), px=rng.uniform(0, 900, (88, 2))) for _ in range(8)] for _ in range(2))
    with pytest.raises(RigError):
        solve_rig(StereoViews(points_m=board(), left=left, right=right), SIZES, ("brown4", "brown4"))


def test_nonsense_is_refused() -> None:
    one = Corners(ids=[0, 99], px=[[0, 0], [1, 1]])
    with pytest.raises(RigError, match="do not fit a board"):
        StereoViews(points_m=board(3, 3), left=[one], right=[None])
    with pytest.raises(RigError, match="same views"):
        StereoViews(points_m=board(), left=[None], right=[])
    with pytest.raises(RigError, match="did you mean 'brown5'"):
        solve_rig(views_of(RIGS["unequal"], count=3), SIZES, ("brown6", "brown4"))
    with pytest.raises(RigError, match="baseline_m"):
        Known(baseline_m=(-0.1, 0.01))


def test_depth_derivatives_are_those_of_triangulation(toed_in: Calibration) -> None:
    found, names = toed_in.fit, toed_in.names
    q = frame_grid(SIZE, (5, 5))
    rows, _ = depth_rows(toed_in, 1.0, (5, 5))
    points = toed_in.rig.left.unproject(q, 1.0)
    q_right = toed_in.rig.right.project(points @ toed_in.rig.R_right_left.T + toed_in.rig.t_right_left_m)

    def depth(change: Float64) -> Float64:
        """Z on the left ray whose picture in the right eye is nearest to the right pixel, by Gauss and Newton."""
        state = moved(found.state, toed_in.lenses, change, np.zeros((len(toed_in.views), 6)))
        ray = camera_of(state.intrinsics[0], "brown4", SIZE).rays(q) @ state.R_right_left.T
        Z = np.ones(ray.shape[:-1])
        for _ in range(8):
            px, by_point, _ = project(Z[..., None] * ray + state.t_right_left_m, state.intrinsics[1], "brown4")
            along = (by_point @ ray[..., None])[..., 0]
            Z = Z - (along * (px - q_right)).sum(axis=-1) / (along**2).sum(axis=-1)
        return Z

    for j, name in enumerate(names):
        step = np.zeros(len(names))
        step[j] = 1e-2 * np.sqrt(toed_in.covariance[j, j])
        by_hand = (depth(step) - depth(-step)) / (2 * step[j])
        assert np.nanmax(np.abs(by_hand - rows[..., j])) < 1e-4 * np.nanmax(np.abs(rows[..., j])), name


def test_uncertainty_is_least_where_the_corners_are(toed_in: Calibration) -> None:
    for eye in ("left", "right"):
        sigma = projection_sigma(toed_in, eye)
        assert sigma[12, 16] < sigma[0, 0]
        assert (sigma > 0).all()
        assert coverage(toed_in, eye).sum() == toed_in.kept[("left", "right").index(eye)].sum()
    near, far = (answer_at(toed_in, d) for d in (1.0, 4.0))
    assert far.depth_match_mm == pytest.approx(16 * near.depth_match_mm)
    assert far.depth_rig_mm > 4 * near.depth_rig_mm


def test_corners_in_space_are_a_board(toed_in: Calibration) -> None:
    points = corners_in_space(toed_in)
    side = np.linalg.norm(points[:, 1] - points[:, 0], axis=-1)
    assert np.allclose(side, 0.03, rtol=0.01)


@pytest.mark.slow
def test_the_truth_lies_within_two_stated_sigma_nine_times_in_ten() -> None:
    truth, plan = RIGS["toed-in"], board(6, 5, 0.05)
    inside: list[Float64] = []
    for seed in range(100):
        result = solve_rig(views_of(truth, count=12, noise_px=0.1, seed=seed, points_m=plan), SIZES, ("brown4", "brown4"))
        errors = standard_errors(result)
        sigma = np.array([errors[n] for n in result.names] + [errors["baseline"]])
        off = result.rig.R_right_left @ truth.R_right_left.T
        turn = np.degrees(np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2)
        lenses = [intrinsics_of(getattr(result.rig, e)) - intrinsics_of(getattr(truth, e)) for e in ("left", "right")]
        shift = result.rig.t_right_left_m - truth.t_right_left_m
        error = np.concatenate([*lenses, turn, shift, [result.rig.baseline_m - truth.baseline_m]])
        inside.append(np.append(np.abs(error) < 2 * sigma, depth_inside(result, truth)))
    share = np.mean(inside, axis=0)
    assert share.min() >= 0.90, dict(zip((*result.names, "baseline", "depth"), share))
    assert share.mean() <= 0.985, "the stated sigma is far too wide to be of use"


def depth_inside(result: Calibration, truth: Rig) -> bool:
    """Whether the depth of a point 1 m before the middle of the frame comes out within two stated sigma."""
    q = frame_grid(SIZE, (5, 5))[2:3, 2:3]
    point = truth.left.unproject(q, 1.0)
    q_right = truth.right.project(point @ truth.R_right_left.T + truth.t_right_left_m)
    cameras: tuple[Camera, Camera] = (result.rig.left, result.rig.right)
    rays = [c.rays(p) @ T.T for c, p, T in zip(cameras, (q, q_right), rectifying(result.rig.R_right_left, result.rig.t_right_left_m))]
    Z = result.rig.baseline_m / (rays[0][..., 0] / rays[0][..., 2] - rays[1][..., 0] / rays[1][..., 2]) / rays[0][..., 2]
    return bool(abs(Z[0, 0] - 1) * 1000 < 2 * depth_sigma_mm(result, 1.0, (5, 5))[2, 2])
