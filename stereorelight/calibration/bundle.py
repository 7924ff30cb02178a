"""Bundle adjustment of two eyes and many views of one flat board: Levenberg and Marquardt, board poses eliminated.

In: a `Problem` (corners of every view in both eyes, NaN where unseen) and a `State` to start from.  Out: a `Fit`.
Frames: camera frames (x right, y down, z forward); the board's frame has z = 0 on the board.  Metres, pixels, radians.

The unknowns fall into those that all views share (two lenses, the pose between the eyes, the board's own shape) and six for
each view.  A view's six meet no other view's, so they are eliminated view by view (Schur complement), and what is left
to solve has some thirty unknowns whatever the number of views, and three more for each corner of a board that is not true.
Rotations are updated on the left, R <- exp(w) R, so that standard errors of w are angles about the camera's own axes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration.projection import checked_lens, project, rotation
from stereorelight.errors import RigError

LEAST_DAMPING = 1e-12  # of a pose's own information, so that corners on one line stop nothing
POSE = 6  # unknowns of a view, and of the pose between the eyes: turn, then shift
STEPS = 60
CONVERGED = 1e-8  # relative fall of the cost below which a solve has ended


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What was measured, and what is to be found.

    points_m  : (n, 3) corners in the board's frame.
    px        : (2, V, n, 2) where each eye saw them; NaN where it did not.
    weight    : (2, V, n) 1 / sigma in pixels; 0 leaves a corner out.
    lenses    : names in `projection.LENSES`, left and right.
    free      : (shared,) which shared unknowns may move; see `shared_slices`.
    expected  : (shared,) prior values of the shared unknowns, used where `expected_sigma` is finite.
    free_board: whether each corner may stray from `points_m`, held near it by a prior only; 3 n more shared unknowns then.
    baseline  : (metres, one sigma) that is known from elsewhere, or None.
    """

    points_m: Float64
    px: Float64
    weight: Float64
    lenses: tuple[str, str]
    free: Bool
    expected: Float64
    expected_sigma: Float64
    free_board: bool = False
    baseline: tuple[float, float] | None = None

    @property
    def seen(self) -> Bool:
        """(2, V, n) which corners count."""
        return np.isfinite(self.px[..., 0]) & (self.weight > 0)

    def without_views(self, out: Bool) -> Problem:
        """The same problem with the views of mask (V,) left out."""
        return replace(self, weight=np.where(out[None, :, None], 0.0, self.weight))


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """Values of all unknowns.  R, t: left camera from board, (V, 3, 3) and (V, 3).  stray: (n, 3) metres, the board's corners off their plan."""

    intrinsics: tuple[Float64, Float64]
    R_right_left: Float64
    t_right_left_m: Float64
    R: Float64
    t_m: Float64
    stray_m: Float64 = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A solution.

    residual_px : (2, V, n, 2) projected minus seen; NaN where unseen, also for corners left out by weight 0.
    information : (shared, shared) inverse covariance of the shared unknowns, board poses eliminated, for weights that are
                  1 / sigma; data_information is the same without prior knowledge.
    slope       : (V, shared) each view's part of the cost's gradient; they add up to the priors' at the optimum.
    cost        : half the sum of squares of weighted residuals, as the loss sees them.
    """

    problem: Problem
    state: State
    residual_px: Float64
    information: Float64
    data_information: Float64
    slope: Float64
    normal: Normal
    cost: float


def shared_slices(lenses: tuple[str, str]) -> dict[str, slice]:
    """Where the shared unknowns stand: left, right (fx fy cx cy lens...), turn, shift (right from left), and rig for all four.

    The corners of a free board are whatever follows the rig."""
    a, b = (4 + checked_lens(name)[1] for name in lenses)
    ends = [int(i) for i in np.cumsum([0, a, b, 3, 3])]
    at = {name: slice(i, j) for name, i, j in zip(("left", "right", "turn", "shift"), ends[:-1], ends[1:])}
    return {**at, "rig": slice(0, ends[-1])}


def shared_names(lenses: tuple[str, str]) -> tuple[str, ...]:
    """A name for each of the rig's unknowns: `left.fx`, `right.p1`, `turn.x` (radians), `shift.z` (metres)."""
    lens_names = {"brown": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")}
    names: list[str] = []
    for eye, lens in zip(("left", "right"), lenses):
        model, count = checked_lens(lens)
        own = lens_names.get(model, ("k1", "k2", "k3", "k4"))[:count]
        names += [f"{eye}.{name}" for name in ("fx", "fy", "cx", "cy", *own)]
    return (*names, *(f"{what}.{axis}" for what in ("turn", "shift") for axis in "xyz"))


def shared_values(state: State) -> Float64:
    """The shared unknowns of `state`; the turn between the eyes is counted from itself, so 0."""
    return np.concatenate([*state.intrinsics, np.zeros(3), state.t_right_left_m, state.stray_m.ravel()])


def moved(state: State, lenses: tuple[str, str], shared: Float64, poses: Float64) -> State:
    """`state` after steps of the shared unknowns (shared,) and of the poses (V, 6)."""
    at = shared_slices(lenses)
    return State(
        intrinsics=(state.intrinsics[0] + shared[at["left"]], state.intrinsics[1] + shared[at["right"]]),
        R_right_left=rotation(shared[at["turn"]]) @ state.R_right_left,
        t_right_left_m=state.t_right_left_m + shared[at["shift"]],
        R=rotation(poses[:, :3]) @ state.R,
        t_m=state.t_m + poses[:, 3:],
        stray_m=state.stray_m + shared[at["rig"].stop :].reshape(-1, 3),
    )


def board_points(problem: Problem, state: State) -> Float64:
    """(n, 3) the corners as the board has them, in its own frame."""
    return problem.points_m + state.stray_m if problem.free_board else problem.points_m


def _eye_points(problem: Problem, state: State) -> tuple[Float64, Float64]:
    """(V, n, 3) the corners in the left and in the right camera frame."""
    left = board_points(problem, state) @ state.R.transpose(0, 2, 1) + state.t_m[:, None]
    return left, left @ state.R_right_left.T + state.t_right_left_m


def residuals(problem: Problem, state: State) -> Float64:
    """(2, V, n, 2) projected minus seen, pixels; NaN where unseen."""
    points = _eye_points(problem, state)
    return np.stack([project(p, i, lens)[0] for p, i, lens in zip(points, state.intrinsics, problem.lenses)]) - problem.px


def _robust(normed2: Float64, scale: float | None) -> tuple[Float64, Float64]:
    """Cost and weight of squared weighted residuals (...): Cauchy's beyond `scale` sigma, plain squares for None."""
    if scale is None:
        return normed2 / 2, np.ones_like(normed2)
    u = normed2 / (scale * scale)
    return scale * scale / 2 * np.log1p(u), 1 / (1 + u)


def _priors(problem: Problem, state: State) -> tuple[Float64, Float64]:
    """Residuals (m,) in sigmas of the prior knowledge, and their derivatives (m, shared)."""
    known = np.flatnonzero(np.isfinite(problem.expected_sigma))
    rows = np.zeros((len(known), len(problem.free)))
    rows[np.arange(len(known)), known] = 1 / problem.expected_sigma[known]
    r = (shared_values(state)[known] - problem.expected[known]) / problem.expected_sigma[known]
    if problem.baseline is not None:
        metres, sigma = problem.baseline
        length = np.linalg.norm(state.t_right_left_m)
        row = np.zeros((1, len(problem.free)))
        row[0, shared_slices(problem.lenses)["shift"]] = state.t_right_left_m / length / sigma
        rows, r = np.vstack([rows, row]), np.append(r, (length - metres) / sigma)
    return r, rows


def _cost(problem: Problem, state: State, scale: float | None) -> float:
    r2 = (residuals(problem, state) ** 2).sum(axis=-1) * problem.weight**2
    return float(np.where(problem.seen, _robust(np.where(problem.seen, r2, 0.0), scale)[0], 0).sum() + (_priors(problem, state)[0] ** 2).sum() / 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """Normal equations by blocks, view by view.  S counts the shared unknowns.

    own    : (V, o, o) of the rig's unknowns.     corner : (V, n, 3, 3) of the board's corners, n = 0 for a true board.
    mixed  : (V, 3 n, o) of corners and rig.      sp     : (V, S, 6) of the shared unknowns and the view's pose.
    pp     : (V, 6, 6) of the view's pose.        s, p   : (V, S) and (V, 6), the slopes.
    """

    own: Float64
    corner: Float64
    mixed: Float64
    sp: Float64
    pp: Float64
    s: Float64
    p: Float64
    residual_px: Float64

    def shared(self) -> Float64:
        """(S, S) the shared unknowns' own part, summed over views."""
        return _assembled(self.own.sum(axis=0), self.mixed.sum(axis=0), self.corner.sum(axis=0))


def _assembled(own: Float64, mixed: Float64, corner: Float64) -> Float64:
    """(S, S) from the rig's part, the corners' part, block by block, and what lies between."""
    o, n = len(own), len(corner)
    out = np.zeros((o + 3 * n, o + 3 * n))
    out[:o, :o] = own
    out[o:, :o], out[:o, o:] = mixed, mixed.T
    i = np.arange(n)
    out[o:, o:].reshape(n, 3, n, 3)[i, :, i, :] = corner
    return out


def _normal(problem: Problem, state: State, scale: float | None) -> Normal:
    at, views, n = shared_slices(problem.lenses), problem.px.shape[1], len(problem.points_m)
    own = at["rig"].stop
    size = own + POSE + 1
    points = _eye_points(problem, state)
    residual = np.full(problem.px.shape, np.nan)
    H = np.zeros((views, size, size))
    free_corners = n if problem.free_board else 0
    mixed, corner = np.zeros((views, free_corners, 3, size)), np.zeros((views, free_corners, 3, 3))
    for eye, name in enumerate(("left", "right")):
        q, by_point, by_lens = project(points[eye], state.intrinsics[eye], problem.lenses[eye])
        residual[eye] = q - problem.px[eye]
        used = problem.seen[eye]
        if not used.any():
            continue
        r = np.where(used[..., None], residual[eye], 0.0)
        weight = np.where(used, problem.weight[eye], 0.0)
        weight = weight * np.sqrt(_robust((r * r).sum(axis=-1) * weight**2, scale)[1])
        by_left = by_point @ state.R_right_left if eye else by_point  # d pixel / d point in the left camera frame
        J = np.zeros((views, n, 2, size))
        J[..., at[name]] = by_lens
        if eye:
            J[..., at["turn"]] = np.cross((points[1] - state.t_right_left_m)[:, :, None], by_point)
            J[..., at["shift"]] = by_point
        J[..., own : own + 3] = np.cross((points[0] - state.t_m[:, None])[:, :, None], by_left)
        J[..., own + 3 : own + 6] = by_left
        J[..., :own] *= problem.free[:own]
        J[..., -1] = r
        J *= weight[..., None, None]
        rows = J.reshape(views, 2 * n, size)
        H += rows.transpose(0, 2, 1) @ rows
        if free_corners:
            by_corner = (by_left @ state.R[:, None]) * weight[..., None, None] * problem.free[own:].reshape(n, 1, 3)
            for row in (0, 1):
                mixed += by_corner[:, :, row, :, None] * J[:, :, row, None, :]
                corner += by_corner[:, :, row, :, None] * by_corner[:, :, row, None, :]
    p = slice(own, own + POSE)
    mixed = mixed.reshape(views, 3 * free_corners, size)
    return Normal(
        own=H[:, :own, :own],
        corner=corner,
        mixed=mixed[..., :own],
        sp=np.concatenate([H[:, :own, p], mixed[..., p]], axis=1),
        pp=H[:, p, p],
        s=np.concatenate([H[:, :own, -1], mixed[..., -1]], axis=1),
        p=H[:, p, -1],
        residual_px=residual,
    )


def _damped(H: Float64, damping: float) -> Float64:
    """H with its diagonal grown; unknowns that nothing says anything about get 1, and so stay where they are."""
    out = H.copy()
    i = np.arange(H.shape[-1])
    diagonal = H[..., i, i]
    out[..., i, i] = np.where(diagonal > 0, diagonal * (1 + damping), 1.0)
    return out


def _solved(A: Float64, b: Float64) -> Float64:
    """A^-1 b for symmetric positive A (S, S), its unknowns scaled to one size first: focal lengths meet radians here."""
    d = 1 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A * d * d[:, None]
    try:
        x = np.linalg.solve(scaled, d * b)
    except np.linalg.LinAlgError:
        x = np.linalg.lstsq(scaled, d * b, rcond=1e-14)[0]
    return d * x


def _without_poses(normal: Normal, damping: float) -> tuple[Float64, Float64, Float64, Float64]:
    """The equations of the shared unknowns with the poses eliminated, (S, S) and by view (V, S); and pp^-1 ps, pp^-1 p."""
    views, size = normal.s.shape
    sides = np.concatenate([normal.sp.transpose(0, 2, 1), normal.p[..., None]], axis=-1)
    try:
        back = np.linalg.solve(_damped(normal.pp, max(damping, LEAST_DAMPING)), sides)
    except np.linalg.LinAlgError:
        raise RigError("the corners of a view fit no flat board before any lens; is the board's spec right?") from None
    flat = normal.sp.transpose(1, 0, 2).reshape(size, views * POSE)
    slope = normal.s - np.einsum("vsp,vp->vs", normal.sp, back[..., size])
    return normal.shared() - flat @ back[..., :size].reshape(views * POSE, size), slope, back[..., :size], back[..., size]


def view_information(found: Fit) -> Float64:
    """(V, S, S) what each view says of the shared unknowns, its own pose eliminated; priors are not in it."""
    normal = found.normal
    back = np.linalg.solve(_damped(normal.pp, LEAST_DAMPING), normal.sp.transpose(0, 2, 1))
    return np.stack([_assembled(*blocks) - sp @ b for *blocks, sp, b in zip(normal.own, normal.mixed, normal.corner, normal.sp, back)])


def fit(problem: Problem, start: State, *, scale: float | None = None, steps: int = STEPS) -> Fit:
    """The least-squares solution nearest to `start`; with `scale`, Cauchy's robust one (in sigmas of the weights).

    J. Moré, "The Levenberg-Marquardt algorithm" (1978); B. Triggs et al., "Bundle adjustment, a modern synthesis" (2000)."""
    state, damping, growth = start, 1e-3, 4.0
    cost = _cost(problem, state, scale)
    small = 0
    for _ in range(steps):
        normal = _normal(problem, state, scale)
        prior, rows = _priors(problem, state)
        rows = rows * problem.free
        known, pull = rows.T @ rows, rows.T @ prior
        while True:
            A, slope, back, shift = _without_poses(normal, damping)
            shared = -_solved(_damped(A + known, damping), slope.sum(axis=0) + pull) * problem.free
            poses = -shift - back @ shared
            tried = moved(state, problem.lenses, shared, poses)
            new = _cost(problem, tried, scale)
            if np.isfinite(new) and new <= cost:
                break
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                break
        if not new <= cost:
            break
        small = small + 1 if cost - new <= CONVERGED * cost else 0
        state, cost, damping, growth = tried, new, max(damping / 10, 1e-12), 4.0
        if small >= 2 or cost == 0:
            break
    normal = _normal(problem, state, scale)
    information, slope, _, _ = _without_poses(normal, 0.0)
    rows = _priors(problem, state)[1] * problem.free
    return Fit(
        problem=problem,
        state=state,
        residual_px=normal.residual_px,
        information=information + rows.T @ rows,
        data_information=information,
        slope=slope,
        normal=normal,
        cost=cost,
    )
