"""The time offset from one rigid body seen by both eyes: its shape, its motion and the offset, solved together.

In: the tracks of one body in both eyes, working pixels, and what is known of the optics.  Out: an `OffsetFit` of that body.

A thing that turns shows the left eye a moment later much what the right eye shows now.  Told from two moments alone, an
offset and a deeper shape are the same picture; over many moments they are not: how far the thing turned is seen in the left eye
by itself, and speed that changes moves the right eye's picture and not the shape.  So everything is one model:
    left eye at t:              f (X, Y) / Z + c                P = (X, Y, Z) = C + T(t) + R(t) p
    right eye at t + shift:     f (X - 1, Y) / Z + c + r        P at t + shift - offset, the motion taken between frames by a cubic
with the baseline as the unit of length, a point p for each track, a motion (R, T) for each frame, and the offset.  What is not
sure is unknown as well, held by what is known of it: the focal length, the eyes' horizontal error, the row error (affine).
Gauss and Newton with the points eliminated, Geman and McClure's weights; the sigma is of scores summed by cells of
the frame (what errs together counts once)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float64

STEPS = 40
REACH = 0.75  # frames: how far the offset may go before the frames that count are chosen anew
OFF, FOCAL, SIDE, ROW = 0, 1, 2, 3  # the shared unknowns; ROW takes three
SHARED = 6
SLIDE_PX = 0.05  # a frame: by how much a followed point wanders over its surface as that turns and its light changes


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Focal length and principal point of the left eye, working pixels; cx_right - cx_left; and how sure they are.

    focal_sigma : of the logarithm.   side_sigma, row_sigma : px.
    """

    focal: float
    cx: float
    cy: float
    doffs: float = 0.0
    focal_sigma: float = 0.005
    side_sigma: float = 0.5
    row_sigma: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidFit:
    """offset_frames; sigma_frames (inf where it does not converge); residual scale, px; weight of each observation's track (n,)."""

    offset_frames: float
    sigma_frames: float
    scale_px: float
    weight: Float64
    turn_deg: float


def _rotations(r: Float64) -> Float64:
    """(F, 3, 3) from rotation vectors (F, 3)."""
    angle = np.sqrt((r * r).sum(axis=1) + 1e-24)[:, None, None]
    k = np.zeros((len(r), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -r[:, 2], r[:, 1], -r[:, 0]
    k -= k.transpose(0, 2, 1)
    out: Float64 = np.eye(3) + np.sin(angle) / angle * k + (1 - np.cos(angle)) / angle**2 * (k @ k)
    return out


def _between(g: float, count: int) -> tuple[Float64, Float64]:
    """Weights (F, F) of the frames' motion at t + g, and their slope by g; 0 where that moment lies out of reach."""
    whole = int(np.floor(g))
    u = g - whole
    cubic = 0.5 * np.array([-u + 2 * u**2 - u**3, 2 - 5 * u**2 + 3 * u**3, u + 4 * u**2 - 3 * u**3, -(u**2) + u**3])
    slope = 0.5 * np.array([-1 + 4 * u - 3 * u**2, -10 * u + 9 * u**2, 1 + 8 * u - 9 * u**2, -2 * u + 3 * u**2])
    weights, slopes = np.zeros((count, count)), np.zeros((count, count))
    for t in range(count):
        b = t + whole
        # Beyond the ends the motion goes on straight.
        for into, of in ((weights, cubic), (slopes, slope)):
            for k, value in zip(range(b - 1, b + 3), of, strict=True):
                inner = min(max(k, 0), count - 1)
                beyond, toward = k - inner, min(max(inner - np.sign(k - inner), 0), count - 1)
                into[t, inner] += value * (1 + abs(beyond))
                into[t, int(toward)] -= value * abs(beyond)
    return weights, slopes


def _start(x: Float64, y: Float64, xr: Float64, optics: Optics) -> tuple[Float64, Float64, Float64]:
    """(centre, points, motion (F, 6)) as if the eyes were in step: triangulated, and fitted frame to frame (Kabsch)."""
    q = x - xr + optics.doffs
    typical = np.nanmedian(q)
    q = np.clip(q, typical / 3 if typical > 0 else 1.0, None) if typical > 0 else np.abs(q) + 1
    Z = optics.focal / q
    P = np.stack([(x - optics.cx) * Z / optics.focal, (y - optics.cy) * Z / optics.focal, Z], axis=2)
    known = np.isfinite(P[..., 2])
    middle = int(np.argmax(known.sum(axis=0) - 0.01 * np.abs(np.arange(x.shape[1]) - x.shape[1] / 2)))
    centre: Float64 = np.nanmedian(P[:, middle], axis=0)
    points = P[:, middle] - centre
    motion = np.zeros((x.shape[1], 6))
    for sense in (-1, 1):
        # From the middle outwards, so that tracks that begin or end have points by then.
        for t in range(middle, x.shape[1] if sense > 0 else -1, sense):
            both = known[:, t] & np.isfinite(points[:, 2])
            if both.sum() < 4:
                motion[t] = motion[t - sense] if t != middle else 0
                continue
            a, b, w = points[both], P[both, t] - centre, np.ones(int(both.sum()))
            for _ in range(5):
                ma, mb = (w @ a) / w.sum(), (w @ b) / w.sum()
                u, _, vt = np.linalg.svd(((b - mb) * w[:, None]).T @ (a - ma))
                R = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
                e = np.linalg.norm(b - mb - (a - ma) @ R.T, axis=1)
                w = 1 / (1 + (e / (1.5 * np.median(e) + 1e-9)) ** 2) ** 2
            cosine = np.clip((np.trace(R) - 1) / 2, -1, 1)
            axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            angle = np.arccos(cosine)
            motion[t, :3] = axis * (0.5 if angle < 1e-6 else angle / (2 * np.sin(angle)))
            motion[t, 3:] = mb - R @ ma
            fresh = known[:, t] & ~np.isfinite(points[:, 2])
            points[fresh] = (P[fresh, t] - centre - motion[t, 3:]) @ R
    return centre, points, motion


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    points: Float64  # (n, 6): place in the body, and slide over it a frame
    motion: Float64
    shared: Float64


class _Body:
    def __init__(self, x: Float64, y: Float64, xr: Float64, yr: Float64, shift: int, optics: Optics) -> None:
        self.seen, self.optics, self.shift = (x, y, xr, yr), optics, shift
        self.count = x.shape[1]
        self.known = np.isfinite(x) & np.isfinite(y), np.isfinite(xr) & np.isfinite(yr)
        self.inside = np.ones(self.count, bool)
        self.centre, self.first, self.motion = _start(x, y, xr, optics)
        # Where on the picture a point lies, for the row error.
        u, v = (np.nan_to_num(p) for p in (x, y))
        self.rows = np.stack([np.ones_like(u), (u - optics.cx) / optics.cx, (v - optics.cy) / optics.cx], axis=2)

    def around(self, offset: float) -> None:
        """The right eye's frames whose moments lie within the left eye's, at `offset` and REACH to both sides."""
        at = np.arange(self.count) + self.shift - offset
        self.inside = (at - REACH >= -0.01) & (at + REACH <= self.count - 0.99)

    def look(self, state: _State, *, slopes: bool) -> tuple[Float64, Float64, Float64, Float64]:
        """Residuals (n, F, 4), NaN where unknown; and their slopes by the point (n, F, 4, 3), by all else (n, F, 4, G)."""
        o, count, n = self.optics, self.count, len(state.points)
        focal = o.focal * np.exp(state.shared[FOCAL])
        between, rate = _between(self.shift - state.shared[OFF], count)
        res = np.full((n, count, 4), np.nan)
        by_point = np.zeros((n, count, 4, 6))
        by_all = np.zeros((n, count, 4, 6 * count + SHARED))
        eye = np.eye(count)
        for k, (mix, at, known) in enumerate(((eye, 0.0, self.known[0]), (between, 1.0, self.known[1] & self.inside))):
            motion = mix @ state.motion
            R = _rotations(motion[:, :3])
            when = mix @ (np.arange(count) - (count - 1) / 2)
            at_body = state.points[:, None, :3] + when[:, None] * state.points[:, None, 3:]
            P = self.centre + motion[:, 3:] + np.einsum("tij,ntj->nti", R, at_body)
            Z = np.where(P[..., 2] > 0.05, P[..., 2], np.nan)
            u, v = focal * (P[..., 0] - at) / Z, focal * P[..., 1] / Z
            dx = self.seen[2 * k] - (u + o.cx + at * (o.doffs + state.shared[SIDE]))
            dy = self.seen[2 * k + 1] - (v + o.cy + at * self.rows @ state.shared[ROW : ROW + 3])
            res[..., 2 * k] = np.where(known, dx, np.nan)
            res[..., 2 * k + 1] = np.where(known, dy, np.nan)
            if not slopes:
                continue
            J = np.zeros((n, count, 2, 3))
            J[..., 0, 0] = J[..., 1, 1] = focal / Z
            J[..., 0, 2], J[..., 1, 2] = -u / Z, -v / Z
            J = np.where(known[..., None, None], J, 0)
            by_point[..., 2 * k : 2 * k + 2, :3] = J @ R
            by_point[..., 2 * k : 2 * k + 2, 3:] = (J @ R) * when[:, None, None]
            turned = np.empty((count, 3, 3, 3))
            for axis in range(3):
                step = np.zeros(3)
                step[axis] = 1e-6
                turned[:, axis] = (_rotations(motion[:, :3] + step) - _rotations(motion[:, :3] - step)) / 2e-6
            by_motion = np.empty((n, count, 2, 6))
            for axis in range(3):
                by_motion[..., axis] = (J @ np.einsum("tij,ntj->nti", turned[:, axis], at_body)[..., None])[..., 0]
            by_motion[..., 3:] = J
            part = by_all[..., 2 * k : 2 * k + 2, :]
            for t in range(count):
                for s in np.flatnonzero(mix[t]):
                    part[:, t, :, 6 * s : 6 * s + 6] += mix[t, s] * by_motion[:, t]
            own = part[..., 6 * count :]
            own[..., FOCAL] = np.where(known[..., None], np.stack([u, v], axis=2), 0)
            if k:
                own[..., OFF] = -np.einsum("ntkj,tj->ntk", by_motion, rate @ state.motion)
                own[..., 0, SIDE] = known
                own[..., 1, ROW : ROW + 3] = np.where(known[..., None], self.rows, 0)
        return res, by_point, by_all, focal


def _squares(res: Float64, scale: float) -> tuple[Float64, Float64]:
    """Mean square of each track's residuals, in units of three scales, and how many there are."""
    known = np.isfinite(res)
    count = known.sum(axis=(1, 2))
    square = np.where(known, res, 0) ** 2 / (3 * scale) ** 2
    return 2 * square.sum(axis=(1, 2)) / np.maximum(count, 1), count


def _weights(res: Float64, scale: float) -> Float64:
    """Geman and McClure's weight (n, F, 4), of whole tracks: one that slides over the surface does so all the time; 0 where unknown."""
    square, _ = _squares(res, scale)
    return np.where(np.isfinite(res), (1 / (1 + square) ** 2)[:, None, None], 0)


def _cost(res: Float64, scale: float, state: _State, loose: Float64, slide: float) -> float:
    square, count = _squares(res, scale)
    held = float((state.shared**2 / loose**2).sum()) + float((state.points[:, 3:] ** 2).sum()) / slide**2
    return 4.5 * float((count * square / (1 + square)).sum()) + held


def fit_rigid(
    x: Float64, y: Float64, x_right: Float64, y_right: Float64, cell: np.ndarray, *, shift: int, optics: Optics, start: float | None = None
) -> RigidFit:
    """The offset of one body.   x, y, x_right, y_right : (n, F), NaN where unknown.   cell : (n,) which errors are of one piece."""
    n, count = x.shape
    nothing = RigidFit(offset_frames=float("nan"), sigma_frames=float("inf"), scale_px=0.0, weight=np.zeros(n), turn_deg=0.0)
    body = _Body(x, y, x_right, y_right, shift, optics)
    first = np.concatenate([np.where(np.isfinite(body.first), body.first, 0), np.zeros((n, 3))], axis=1)
    slide = SLIDE_PX * float(body.centre[2]) / optics.focal
    shared = np.zeros(SHARED)
    shared[OFF] = shift if start is None else start
    loose = np.array([np.inf, optics.focal_sigma, optics.side_sigma, *(optics.row_sigma,) * 3])
    state = _State(points=first, motion=body.motion, shared=shared)
    damp, scale, settled, middle = 1e-3, 2.0, 0, float(shared[OFF])
    body.around(middle)
    res, by_point, by_all, _ = body.look(state, slopes=True)
    for _ in range(STEPS):
        known = np.isfinite(res)
        scale = max(0.03, min(scale, max(1.4826 * float(np.median(np.abs(res[known]))), scale / 1.5)))
        now = _cost(res, scale, state, loose, slide)
        w = _weights(res, scale) / scale**2
        r = np.where(known, res, 0)
        U, W, V, gp, ga = _normal(by_point, by_all, w, r, state.points, slide)
        prior = np.zeros(V.shape[0])
        prior[6 * count :] = 1 / loose**2
        better = False
        for _ in range(6):
            step_points, step_all = _solve(U, W, V, gp, ga, prior, state.shared, damp)
            trial = _State(
                points=state.points + step_points,
                motion=state.motion + step_all[: 6 * count].reshape(count, 6),
                shared=state.shared + np.clip(step_all[6 * count :], -0.5, 0.5),
            )
            seen = body.look(trial, slopes=False)[0]
            if _cost(seen, scale, trial, loose, slide) < now:
                better = True
                break
            damp *= 5
        if not better:
            break
        gain = abs(trial.shared[OFF] - state.shared[OFF])
        state, damp = trial, max(damp / 5, 1e-9)
        if abs(state.shared[OFF] - middle) > REACH:
            middle = float(state.shared[OFF])
            body.around(middle)
        res, by_point, by_all, _ = body.look(state, slopes=True)
        settled = settled + 1 if gain < 1e-3 else 0
        if settled >= 3:
            break
    known = np.isfinite(res)
    if known.sum() < 6 * count + 3 * n + SHARED + 30:
        return nothing
    w = _weights(res, scale) / scale**2
    r = np.where(known, res, 0)
    U, W, V, gp, ga = _normal(by_point, by_all, w, r, state.points, slide)
    V = V.copy()
    prior = np.zeros(len(V))
    prior[6 * count :] = 1 / loose**2
    V[np.diag_indices_from(V)] += prior
    inverse = np.linalg.inv(U + 1e-9 * np.eye(6))
    away = np.einsum("nij,njg->nig", inverse, W)
    H = V - np.einsum("nig,nih->gh", W, away)
    ridge = 1e-10 * np.diag(V).mean()
    asked = np.zeros(len(V))
    asked[6 * count + OFF] = 1
    pull = np.linalg.solve(H + ridge * np.eye(len(H)), asked)
    score = ga - np.einsum("nig,ni->ng", away, gp)
    each = score @ pull
    cells = np.unique(cell, return_inverse=True)[1]
    summed = np.bincount(cells, each)
    groups = max(len(summed), 2)
    meat = float((summed**2).sum()) * groups / (groups - 1)
    prior_part = float((pull[6 * count :] ** 2 / np.where(np.isfinite(loose), loose**2, np.inf)).sum())
    formal = float(pull[6 * count + OFF])
    sigma = float(np.sqrt(max(meat + prior_part, formal)))
    weight = np.where(known.any(axis=2), w.sum(axis=2) * scale**2, np.nan)
    motion = state.motion[:, :3]
    turn = float(np.degrees(np.linalg.norm(motion.max(axis=0) - motion.min(axis=0))))
    return RigidFit(offset_frames=float(state.shared[OFF]), sigma_frames=sigma, scale_px=scale, weight=np.nanmean(weight, axis=1) / 4, turn_deg=turn)


def _normal(by_point: Float64, by_all: Float64, w: Float64, r: Float64, points: Float64, slide: float) -> tuple[Float64, ...]:
    """Normal equations: by point (n, 3, 3), between (n, 3, G), of all else (G, G), and both right sides, (n, 3) and (n, G)."""
    n, count, _, _ = by_point.shape
    B, A = by_point.reshape(n, 4 * count, 6), by_all.reshape(n, 4 * count, -1)
    w, r = w.reshape(n, -1), r.reshape(n, -1)
    heavy = B * w[..., None]
    held = np.diag([0, 0, 0, *(1 / slide**2,) * 3])
    flat = A.reshape(n * 4 * count, -1)
    V = flat.T @ (flat * w.reshape(-1)[:, None])
    return (
        heavy.transpose(0, 2, 1) @ B + held,
        heavy.transpose(0, 2, 1) @ A,
        V,
        np.einsum("nki,nk->ni", heavy, r) - points @ held,
        np.einsum("nkg,nk->ng", A, w * r),
    )


def _solve(U: Float64, W: Float64, V: Float64, gp: Float64, ga: Float64, prior: Float64, shared: Float64, damp: float) -> tuple[Float64, Float64]:
    """One damped step of points (n, 3) and of all else (G,)."""
    U = U + damp * np.einsum("nii->ni", U)[:, :, None] * np.eye(6) + 1e-9 * np.eye(6)
    V = V + np.diag(damp * np.diag(V) + prior + 1e-9)
    right = ga.sum(axis=0)
    right[len(V) - SHARED :] -= prior[len(V) - SHARED :] * shared
    away = np.linalg.solve(U, np.concatenate([W, gp[..., None]], axis=2))
    H = V - np.einsum("nig,nih->gh", W, away[..., :-1], optimize=True)
    rest = right - np.einsum("nig,ni->g", W, away[..., -1])
    step = np.linalg.solve(H, rest)
    return away[..., -1] - away[..., :-1] @ step, step
