"""Solve: both lenses, the pose between the eyes and every board's pose, jointly, robust to bad corners and bad views.

In: `StereoViews`, picture sizes, a lens for each eye, what is known beforehand.  Out: a `Calibration`.
Frames: camera frames (x right, y down, z forward).  Pixels: (0, 0) is the centre of the top-left pixel.  Metres, degrees.
Nothing is dropped silently: what does not fit is marked with the reason, and the figures are given with and without it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration import start
from stereorelight.calibration.bundle import Fit, Problem, State, board_points, fit, shared_names, shared_slices, view_information
from stereorelight.calibration.projection import camera_of, checked_lens, intrinsics_of, lens_of
from stereorelight.calibration.sightings import StereoViews
from stereorelight.camera import Camera, Eye, Rig
from stereorelight.errors import RigError

FEWEST_PAIRS = 3  # views with the board in both eyes, below which nothing is solved
EYES: tuple[Eye, Eye] = ("left", "right")
RAYLEIGH_MEDIAN = 1.1774  # median length of a 2-D error with unit sigma along each axis
CAUCHY = 3.0  # sigmas at which a corner's pull is halved, while it is not yet known which corners are bad
BAD_CORNER = 5.0  # sigmas; of a million good corners four are farther off
BAD_VIEW = 5.0  # times the usual median error
BAD_VIEW_PX = 0.5  # and by no less than this: a board held in the hand flexes by less, and such views are kept
BAD_SHARE = 0.4  # of a view's corners: with more of them twice as far off as a bad corner the view is bad
NO_RIG = 0.004  # of the frame's width: corners that are farther off than that are of no board that was given
STRAY_START = 0.02  # of the pitch between corners: how far off its plan a board may be, to begin with
LEAST_STRAY = 1e-5
LEAST_SIGMA = 1e-12  # pixels: corners without any noise
RATIONAL_SIGMA = 1.0  # share of the radius: by how much each term of a rational lens is expected to bend the frame's corner


@dataclass(frozen=True, kw_only=True, eq=False)
class Known:
    """What is known before the solve; everything is optional.

    baseline_m : (metres, one sigma) measured between the lenses' entrance pupils.
    focal_px   : (left, right), each (pixels, one sigma) or None; `focal_from_lens` makes one from a lens and a sensor.
    rig        : the same rig from another day: its lenses are kept as they are and only the pose is solved.
    """

    baseline_m: tuple[float, float] | None = None
    focal_px: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)
    rig: Rig | None = None

    def __post_init__(self) -> None:
        for name, pair in (("baseline_m", self.baseline_m), ("focal_px", self.focal_px[0]), ("focal_px", self.focal_px[1])):
            if pair is not None and not (pair[0] > 0 and pair[1] > 0 and np.isfinite(pair).all()):
                raise RigError(f"{name} must be a value and its sigma, both > 0, got {pair}")


NOTHING_KNOWN = Known()


def focal_from_lens(focal_mm: float, sensor_width_mm: float, size: tuple[int, int], *, sigma: float = 0.02) -> tuple[float, float]:
    """Focal length in pixels and its one sigma; printed focal lengths are true to about two per cent at infinity."""
    if not (focal_mm > 0 and sensor_width_mm > 0):
        raise RigError(f"focal length and sensor width must be > 0 mm, got {focal_mm:g} and {sensor_width_mm:g}")
    focal = size[0] * focal_mm / sensor_width_mm
    return focal, sigma * focal


@dataclass(frozen=True, kw_only=True)
class Outlier:
    """Corners that the solve left out.  `ids` () means the whole picture of that eye.  `error_px` is their RMS."""

    view: int
    name: str
    eye: Eye
    ids: tuple[int, ...]
    error_px: float
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """A solved rig and what is known about how good it is.

    rig              : the rig; `quality` is filled in by `validate`.
    lenses           : names of the lens models, left and right (`projection.LENSES`).
    fit              : the solution, with the solver's own matrices.
    residual_px      : (2, V, n, 2) projected minus seen for every corner that was given, also those left out; NaN where unseen.
    kept             : (2, V, n) which corners the solve used.
    outliers         : what was left out, and why.
    rms_px           : length of the error over the kept corners, as OpenCV counts it: sqrt(mean(dx^2 + dy^2)).
    rms_all_px       : the same over all corners that were given, with the same rig.
    rms_before_px    : over all corners, for the plain solve in which every corner counts.
    view_rms_px      : (2, V) of all corners; view_rms_before_px the same before anything was left out.
    sigma_px         : one sigma of a corner along one axis, in pixels at the median corner.
    view_excess      : by how much the views scatter more than their corners' noise explains; 1 where they do not.
    covariance       : of the rig's unknowns `names`, scaled by both; 0 for what was held fixed.
    board_m          : (n, 3) the corners as the board has them; its plan where the board was taken as true.
    """

    rig: Rig
    lenses: tuple[str, str]
    views: StereoViews
    known: Known
    fit: Fit
    residual_px: Float64
    kept: Bool
    outliers: tuple[Outlier, ...]
    rms_px: float
    rms_all_px: float
    rms_before_px: float
    view_rms_px: Float64
    view_rms_before_px: Float64
    sigma_px: float
    view_excess: float
    covariance: Float64
    board_m: Float64
    names: tuple[str, ...]

    @property
    def board_poses(self) -> Float64:
        """(V, 4, 4) left camera from board, metres."""
        out = np.tile(np.eye(4), (len(self.views), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = self.fit.state.R, self.fit.state.t_m
        return out

    @property
    def paired(self) -> Bool:
        """(V,) views of which both eyes' pictures were used."""
        return (self.kept.sum(axis=2) >= start.FEWEST_CORNERS).all(axis=0)


def rms(residual_px: Float64, used: Bool | None = None) -> float:
    """sqrt(mean(dx^2 + dy^2)) over the corners that are known and `used`; NaN where there are none."""
    squared = (residual_px**2).sum(axis=-1)
    known = np.isfinite(squared) if used is None else np.isfinite(squared) & used
    return float(np.sqrt(squared[known].mean())) if known.any() else float("nan")


def robust_sigma(fit: Fit) -> float:
    """One sigma of a weighted residual along one axis, from the median, so that bad corners do not count."""
    length = np.linalg.norm(fit.residual_px, axis=-1) * fit.problem.weight
    known = fit.problem.seen
    return float(np.median(length[known]) / RAYLEIGH_MEDIAN) if known.any() else 0.0


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


def boards_placed(problem: Problem, state: State, sigma: float) -> Fit:
    """The boards' poses with everything else held, robustly: where left-out views stand, and what their errors are."""
    held = replace(problem, free=np.zeros_like(problem.free), expected_sigma=np.full_like(problem.expected_sigma, np.inf), baseline=None)
    return fit(held, state, scale=max(CAUCHY * sigma, 1e-9), steps=30)


def _marked(problem: Problem, found: Fit, sigma: float, names: tuple[str, ...]) -> tuple[Bool, tuple[Outlier, ...]]:
    """Which corners to keep (2, V, n), and the others with their reasons, judged against a robust solution."""
    placed = boards_placed(problem, found.state, sigma)
    length = np.linalg.norm(placed.residual_px, axis=-1)
    seen = problem.seen
    bad = seen & (length * problem.weight > BAD_CORNER * sigma)
    kept, outliers = seen & ~bad, []
    for v in range(seen.shape[1]):
        wrong = [e for e in (0, 1) if seen[e, v].any() and _whole_view_bad(length[e, v], problem.weight[e, v], seen[e, v], sigma)]
        reason = ""
        if wrong and seen[:, v].any(axis=1).all():
            wrong, reason = _whose_fault(problem, placed.state, sigma, v)
        for e in (0, 1):
            if not seen[e, v].any():
                continue
            if e in wrong:
                kept[e, v] = False
                why = reason or "most of its corners do not fit the board"
                outliers.append(Outlier(view=v, name=names[v], eye=EYES[e], ids=(), error_px=_length_rms(length[e, v][seen[e, v]]), reason=why))
            elif bad[e, v].any():
                ids = tuple(int(i) for i in np.flatnonzero(bad[e, v]))
                why = f"farther than {BAD_CORNER:g} sigma from where the board has them"
                outliers.append(Outlier(view=v, name=names[v], eye=EYES[e], ids=ids, error_px=_length_rms(length[e, v][bad[e, v]]), reason=why))
    return kept, tuple(outliers)


def _length_rms(length: Float64) -> float:
    return float(np.sqrt((length**2).mean()))


def _whole_view_bad(length: Float64, weight: Float64, seen: Bool, sigma: float) -> bool:
    off = (length * weight)[seen]
    gross = (off > 2 * BAD_CORNER * sigma).mean() > BAD_SHARE or np.median(off) > BAD_VIEW * RAYLEIGH_MEDIAN * sigma
    return bool(gross and np.median(length[seen]) > BAD_VIEW_PX)


def _whose_fault(problem: Problem, state: State, sigma: float, v: int) -> tuple[list[int], str]:
    """Each eye's picture of view v against the board on its own: which eyes to leave out, and why."""
    alone = []
    for e in (0, 1):
        weight = np.zeros_like(problem.weight)
        weight[e, v] = problem.weight[e, v]
        own = boards_placed(replace(problem, weight=weight), state, sigma)
        length = np.linalg.norm(own.residual_px[e, v], axis=-1)
        alone.append(_whole_view_bad(length, weight[e, v], own.problem.seen[e, v], sigma))
    if alone[0] != alone[1]:
        return [alone.index(True)], f"the {EYES[alone.index(True)]} eye's corners do not fit the board, the other eye's do"
    if alone[0]:
        return [0, 1], "neither eye's corners fit the board"
    return [0, 1], "each eye's corners fit the board, but not together: the board or the rig moved, or the eyes are not of the same moment"


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
    kept, outliers = _marked(problem, robust, sigma, tuple(views.names))
    trimmed = fit(replace(problem, weight=np.where(kept, problem.weight, 0.0)), robust.state)
    kept, outliers = _marked(problem, trimmed, robust_sigma(trimmed), tuple(views.names))  # once more, by the better rig
    pairs = int((kept.sum(axis=2) >= start.FEWEST_CORNERS).all(axis=0).sum())
    if pairs < (1 if known.rig is not None else FEWEST_PAIRS):
        raise RigError(
            f"only {pairs} of {len(views)} views fit one rig; are the eyes of the same moments, is the board flat, and is its spec right? "
            f"view {outliers[0].name}: {outliers[0].reason}"
        )
    final, sigma, excess = _settled(replace(problem, weight=np.where(kept, problem.weight, 0.0)), trimmed.state)
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


def _settled(problem: Problem, state: State) -> tuple[Fit, float, float]:
    """The plain solution with weights in true sigmas, one sigma of a median corner in pixels, and the views' excess scatter.

    The corners' sigma comes from the residuals and the degrees of freedom.  Errors that a whole view shares (a board that
    bends, a lens that no model fits) do not show there; they show in how far each view pulls the rig its own way, so the
    excess of those pulls over what the corners' noise explains widens the answer."""
    for _ in range(2):  # where there is prior knowledge its weight depends on the corners' sigma, and the other way round
        found = fit(problem, state)
        spent = float(np.trace(covariance_of(found) @ found.data_information))
        freedom = 2 * int(problem.seen.sum()) - spent - 6 * int(problem.seen.any(axis=(0, 2)).sum())
        weighted = np.where(problem.seen[..., None], found.residual_px * problem.weight[..., None], 0.0)
        sigma = max(float(np.sqrt((weighted**2).sum() / max(freedom, 1.0))), LEAST_SIGMA)
        problem, state = replace(problem, weight=problem.weight / sigma), found.state
    excess = view_excess(fit(problem, state))
    sigma_px = float(1 / np.median(problem.weight[problem.seen]))
    return fit(replace(problem, weight=problem.weight / excess), state), sigma_px, excess


def view_excess(found: Fit) -> float:
    """How much more the views' pulls at the rig scatter than their corners' noise says, as a factor on sigma; at least 1.

    Leaving view v out moves the unknowns by d_v = S^-1 g_v, to first order, where S = sum of the views' information S_v and g_v
    are the slopes at the solution.  E[sum d_v d_v'] = sum(S^-1 S_v S^-1 - S^-1 S_v S^-1 S_v S^-1) for noise of sigma 1 alone."""
    C = covariance_of(found)
    rig = np.flatnonzero(found.problem.free[: shared_slices(found.problem.lenses)["rig"].stop])
    moves = found.slope @ C[:, rig]
    back = view_information(found) @ C[:, rig]  # (V, shared, rig)
    expected = C[rig] @ back.sum(axis=0) - np.einsum("vsr,st,vtq->rq", back, C, back, optimize=True)
    measure = scaled_inverse(C[np.ix_(rig, rig)])
    plain = float(np.trace(measure @ expected))
    return max(1.0, float(np.sqrt(np.einsum("vi,ij,vj->", moves, measure, moves) / plain))) if plain > 0 else 1.0


def scaled_inverse(A: Float64) -> Float64:
    """Inverse of a symmetric positive matrix, its unknowns scaled to one size first."""
    d = 1 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A * d * d[:, None]
    try:
        inverse = np.linalg.inv(scaled)
        if (np.diag(inverse) <= 0).any():
            raise np.linalg.LinAlgError
    except np.linalg.LinAlgError:  # some unknowns are tied: their own sum is huge, and is said to be
        inverse = np.linalg.pinv(scaled + 1e-14 * np.eye(len(A)), rcond=1e-16, hermitian=True)
    out: Float64 = inverse * d * d[:, None]
    return out


def covariance_of(found: Fit) -> Float64:
    """(shared, shared) covariance of the shared unknowns; 0 for what was held fixed."""
    free = found.problem.free
    out = np.zeros((len(free), len(free)))
    out[np.ix_(free, free)] = scaled_inverse(found.information[np.ix_(free, free)])
    return out
