"""Solve: both lenses, the pose between the eyes and every board's pose, jointly, robust to bad corners and bad views.

In: `StereoViews`, picture sizes, a lens for each eye, what is known beforehand.  Out: a `Calibration`.
Frames: camera frames (x right, y down, z forward).  Pixels: (0, 0) is the centre of the top-left pixel.  Metres, degrees.
Nothing is dropped silently: what does not fit is marked with the reason, and the figures are given with and without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration import start
from stereorelight.calibration.answer import EYES, NOTHING_KNOWN, Calibration, Known, Outlier, rms
from stereorelight.calibration.bundle import Fit, Problem, State, board_points, fit, shared_names, shared_slices
from stereorelight.calibration.covariance import LEAST_SIGMA, covariance_of, settled
from stereorelight.calibration.outliers import CAUCHY, boards_placed, marked, robust_sigma
from stereorelight.calibration.projection import camera_of, checked_lens, intrinsics_of, lens_of
from stereorelight.calibration.sightings import StereoViews
from stereorelight.camera import Camera, Eye, Rig
from stereorelight.errors import RigError

FEWEST_PAIRS = 3  # views with the board in both eyes, below which nothing is solved
NO_RIG = 0.004  # of the frame's width: corners that are farther off than that are of no board that was given
STRAY_START = 0.02  # of the pitch between corners: how far off its plan a board may be, to begin with
LEAST_STRAY = 1e-5
RATIONAL_SIGMA = 1.0  # share of the radius: by how much each term of a rational lens is expected to bend the frame's corner


def _robust_fit(problem: Problem, state: State, *, rounds: int = 6) -> tuple[Fit, float]:
    """A fit in which bad corners hardly count, and the sigma of the good ones."""
    found = fit(problem, state, steps=0)
    sigma = robust_sigma(found)
    for _ in range(rounds):
        found = fit(problem, found.state, scale=max(CAUCHY * sigma, 1e-9))
        before, sigma = sigma, robust_sigma(found)
        if abs(sigma - before) <= 0.05 * before:
            break
    return found, sigma


def _freed(found: Fit, sigma: float, *, rounds: int = 4) -> tuple[Fit, float]:
    """A robust fit in which the board need not be true, from one in which it was.

    How far corners stray from the plan is not known beforehand: the prior's sigma, one in the board's plane and one across
    it, is the one that the corners themselves then show (empirical Bayes), so that a true board stays true."""
    n = len(found.problem.points_m)
    pitch = _pitch(found.problem.points_m)
    stray = np.full((n, 3), STRAY_START * pitch)
    free, expected = np.append(found.problem.free, np.ones(3 * n, dtype=bool)), np.append(found.problem.expected, np.zeros(3 * n))
    problem, state = replace(found.problem, free_board=True, free=free, expected=expected), replace(found.state, stray_m=np.zeros((n, 3)))
    for _ in range(rounds):
        problem = replace(
            problem,
            weight=problem.weight / max(sigma, LEAST_SIGMA),
            expected_sigma=np.append(found.problem.expected_sigma, stray.ravel()),
        )
        freed = fit(problem, state, scale=CAUCHY, steps=12)  # the prior moves between rounds: no need to polish
        state, sigma = freed.state, robust_sigma(freed)
        spread = np.diag(covariance_of(freed))[-3 * n :].reshape(n, 3) + state.stray_m**2
        stray[:, :2], stray[:, 2] = (max(float(np.sqrt(s.mean())), LEAST_STRAY * pitch) for s in (spread[:, :2], spread[:, 2]))
    return freed, sigma


def _pitch(points_m: Float64) -> float:
    """Distance between neighbouring corners."""
    apart = np.linalg.norm(points_m[:, None] - points_m[None], axis=-1)
    return float(np.median(np.where(apart > 0, apart, np.inf).min(axis=1)))


def _problem(views: StereoViews, lenses: tuple[str, str], px: Float64, sigma: Float64, free: Bool, known: Known, state: State) -> Problem:
    at = shared_slices(lenses)
    expected, expected_sigma = np.zeros(len(free)), np.full(len(free), np.inf)
    for e, eye in enumerate(EYES):
        pair = known.focal_px[e]
        if pair is not None:
            expected[at[eye]][:2], expected_sigma[at[eye]][:2] = pair
        if lenses[e] == "rational" and free[at[eye]].any() and np.isfinite(px[e]).any():
            # Top and bottom of the fraction can grow together without end, and a pole comes with them: hold each term to what a lens can be.
            off = (px[e] - state.intrinsics[e][2:4]) / state.intrinsics[e][:2]
            r2 = float(np.nanmax((off * off).sum(axis=-1)))
            expected_sigma[at[eye]][[4, 5, 8, 9, 10, 11]] = RATIONAL_SIGMA / r2 ** np.array([1, 2, 3, 1, 2, 3])
    with np.errstate(invalid="ignore"):
        weight = np.where(np.isfinite(px[..., 0]), np.nanmedian(sigma) / sigma, 0.0)
    return Problem(
        points_m=views.points_m,
        px=px,
        weight=weight,
        lenses=lenses,
        free=free,
        expected=expected,
        expected_sigma=expected_sigma,
        baseline=known.baseline_m,
    )


def _free(lenses: tuple[str, str], *parts: str) -> Bool:
    at = shared_slices(lenses)
    free = np.zeros(at["rig"].stop, dtype=bool)
    for part in parts:
        free[at[part]] = True
    return free


def solve_eye(views: StereoViews, eye: Eye, size: tuple[int, int], lens: str, *, focal_px: tuple[float, float] | None = None) -> Fit:
    """One eye's lens and the boards' poses before it: a `Fit` whose left eye is this one, and whose right eye saw nothing.

    Raises : RigError where too few views show the board.
    """
    count = checked_lens(lens)[1]
    e = EYES.index(eye)
    enough = start.usable(views.px[e])
    if enough.sum() < FEWEST_PAIRS:
        raise RigError(
            f"the {eye} eye shows the board in {int(enough.sum())} of {len(views)} views; at least {FEWEST_PAIRS} are needed, 20 tilted ones are good"
        )
    guess, R, t, placed = start.first_guess(views.points_m, views.px[e], size, lens)
    if placed.sum() < FEWEST_PAIRS:
        raise RigError(f"the {eye} eye's corners fit no flat board in {int((~placed).sum())} of {len(views)} views; is the board's spec right?")
    if focal_px is not None:
        guess[:2] = focal_px[0]
    lenses = (lens, "pinhole")
    px = np.stack([views.px[e], np.full_like(views.px[e], np.nan)])
    px[0, ~(placed & enough)] = np.nan
    sigma = np.stack([views.sigma_px[e], np.full_like(views.sigma_px[e], np.nan)])
    state = State(intrinsics=(guess, np.array([1.0, 1.0, 0.0, 0.0])), R_right_left=np.eye(3), t_right_left_m=np.array([-1.0, 0, 0]), R=R, t_m=t)
    problem = _problem(views, lenses, px, sigma, _free(lenses, "left"), Known(focal_px=(focal_px, None)), state)
    if count:  # the focal length and the strongest bend first: a free centre strays while these are wrong
        first = _free(lenses)
        first[[0, 1, 4]] = True
        state = fit(replace(problem, free=first), state, scale=max(CAUCHY * robust_sigma(fit(problem, state, steps=0)), 1e-9), steps=20).state
    return _robust_fit(problem, state)[0]


def _joint_start(views: StereoViews, sizes: tuple[tuple[int, int], tuple[int, int]], lenses: tuple[str, str], known: Known) -> tuple[State, Bool]:
    """A state for both eyes, and which eye's pictures (2, V) have a board that could be placed."""
    intrinsics, poses, placed = [], [], []
    for e, eye in enumerate(EYES):
        if known.rig is not None:
            own = intrinsics_of(known.rig.camera(eye))
            R, t, ok = start.nearest_poses(views.points_m, views.px[e], own, lenses[e], sizes[e])
        else:
            found = solve_eye(views, eye, sizes[e], lenses[e], focal_px=known.focal_px[e])
            own, R, t = found.state.intrinsics[0], found.state.R, found.state.t_m
            ok = found.problem.seen[0].any(axis=1)
        intrinsics.append(own)
        poses.append((R, t))
        placed.append(ok)
    both = placed[0] & placed[1]
    fewest = 1 if known.rig is not None else FEWEST_PAIRS
    if both.sum() < fewest:
        alone = [f"{int(ok.sum())} in the {eye}" for eye, ok in zip(EYES, placed)]
        came = f"{int(both.sum())} of {len(views)} views ({', '.join(alone)})"
        raise RigError(f"the board is in both eyes in {came}; at least {fewest} are needed, 20 tilted ones are good")
    R_rl, t_rl = start.between_eyes(poses[0], poses[1], both)
    (R, t), (R_r, t_r) = poses
    from_right = placed[1] & ~placed[0]
    R = np.where(from_right[:, None, None], R_rl.T @ R_r, R)
    t = np.where(from_right[:, None], (t_r - t_rl) @ R_rl, t)
    return State(intrinsics=(intrinsics[0], intrinsics[1]), R_right_left=R_rl, t_right_left_m=t_rl, R=R, t_m=t), np.stack(placed)


def solve_rig(
    views: StereoViews,
    sizes: tuple[tuple[int, int], tuple[int, int]],
    lenses: tuple[str, str],
    known: Known = NOTHING_KNOWN,
    *,
    free_board: bool = False,
) -> Calibration:
    """The rig that explains all views best.

    sizes  : (width, height) of each eye's pictures.
    lenses : lens model of each eye, names in `projection.LENSES`; those of `known.rig` where its lenses are kept.
    free_board : find the board's own shape as well, corner by corner: no print is exact and no board flat.  Whether that pays
                 is for held-out error to say (`lens_choice.choose`).
    Raises : RigError where the views cannot give a rig, with what to shoot.
    """
    if known.rig is not None:
        lenses = (lens_of(known.rig.left), lens_of(known.rig.right))
        for eye, size in zip(EYES, sizes):
            if known.rig.camera(eye).size != tuple(size):
                raise RigError(f"the {eye} pictures are {size[0]}x{size[1]}, but the rig's lens was calibrated at {known.rig.camera(eye).size}")
    state, placed = _joint_start(views, sizes, lenses, known)
    px = np.where(placed[:, :, None, None], views.px, np.nan)
    parts = ["turn", "shift"] + ([] if known.rig is not None else ["left", "right"])
    problem = _problem(views, lenses, px, views.sigma_px, _free(lenses, *parts), known, state)
    everything = fit(problem, state)
    robust, sigma = _robust_fit(problem, state)
    if free_board:
        robust, sigma = _freed(robust, sigma)
    problem = robust.problem
    typical = sigma / float(np.median(problem.weight[problem.seen]))
    if typical > NO_RIG * max(sizes[0]):
        raise RigError(
            f"no rig fits the corners: they are typically {typical:.0f} px off; are these views of one board, of the spec given, by the same rig?"
        )
    kept, outliers = marked(problem, robust, sigma, tuple(views.names))
    trimmed = fit(replace(problem, weight=np.where(kept, problem.weight, 0.0)), robust.state)
    kept, outliers = marked(problem, trimmed, robust_sigma(trimmed), tuple(views.names))  # once more, by the better rig
    pairs = int((kept.sum(axis=2) >= start.FEWEST_CORNERS).all(axis=0).sum())
    if pairs < (1 if known.rig is not None else FEWEST_PAIRS):
        raise RigError(
            f"only {pairs} of {len(views)} views fit one rig; are the eyes of the same moments, is the board flat, and is its spec right? "
            f"view {outliers[0].name}: {outliers[0].reason}"
        )
    final, sigma, excess = settled(replace(problem, weight=np.where(kept, problem.weight, 0.0)), trimmed.state)
    shown = boards_placed(problem, final.state, robust_sigma(trimmed))
    for e, eye in enumerate(EYES):
        for v in map(int, np.flatnonzero(start.usable(views.px[e]) & ~placed[e])):
            outliers += (Outlier(view=v, name=views.names[v], eye=eye, ids=(), error_px=float("nan"), reason="its corners fit no flat board"),)
    state, names = final.state, shared_names(lenses)
    cameras: list[Camera] = [camera_of(i, lens, size) for i, lens, size in zip(state.intrinsics, lenses, sizes)]
    if known.rig is not None:
        cameras = [known.rig.left, known.rig.right]
    rig = Rig(left=cameras[0], right=cameras[1], R_right_left=state.R_right_left, t_right_left_m=state.t_right_left_m, mirrored=views.mirrored)
    return Calibration(
        rig=rig,
        lenses=lenses,
        views=views,
        known=known,
        fit=final,
        residual_px=np.where(kept[..., None], final.residual_px, shown.residual_px),
        kept=kept,
        outliers=outliers,
        rms_px=rms(final.residual_px, kept),
        rms_all_px=rms(np.where(kept[..., None], final.residual_px, shown.residual_px)),
        rms_before_px=rms(everything.residual_px),
        view_rms_px=_by_view(np.where(kept[..., None], final.residual_px, shown.residual_px)),
        view_rms_before_px=_by_view(everything.residual_px),
        sigma_px=sigma,
        view_excess=excess,
        covariance=covariance_of(final)[: len(names), : len(names)],
        board_m=board_points(final.problem, final.state),
        names=names,
    )


def _by_view(residual_px: Float64) -> Float64:
    return np.array([[rms(one) for one in eye] for eye in residual_px])
