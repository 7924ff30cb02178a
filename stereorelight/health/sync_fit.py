"""The fraction of a frame by which the eyes are apart, from points followed in both: a robust joint regression.

In: `Tracks` of one or more runs.  Out: the offset in frames, positive where the right camera is late, and its sigma.

The right eye shows at frame t + shift what the left one shows at t + g, with g = shift - offset.  So on a rectified pair
    y_right(t) = y(t + g) + m            m: what the rig leaves of row error, a smooth function of the place that stands still
    x_right(t) = x(t + g) - d(t)         d: the true disparity
A point that stands still says nothing of g, and m and d are unknown.  Rows speak wherever points move up or down other than m
varies.  Columns need the law by which d may change: between two moments a rigid body's inverse depth changes by an affine function
of the place (Z' = T + w_x Y - w_y X), so d(t) is a constant of each point plus an affine function per body and frame; a
velocity field that changes with time beyond that (a head that speeds up or turns back) is the evidence.  Constant motion
is swallowed whole by these unknowns, and then the sigma says that nothing is known.  Where nothing rises or sinks as a whole, a head
that turns before a camera that stands, shape and motion are solved with the offset instead (`sync_rigid`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.health.sync_rigid import Optics, fit_rigid
from stereorelight.health.sync_tracks import Tracks

ROUNDS = 8
LEAST_SIGNAL = 0.3  # of the velocity's power must be left when its noise is taken off
TUKEY = 4.0  # sigmas at which an observation has no weight
LEAST_FRAMES = 5  # a shorter track has no velocity worth the name
LEAST_BODY = 12  # tracks
LEAST_ROWS = 60
NEAR = 0.09  # of the width: points nearer than this, of like disparity and speed, are of one body
NEAR_DISPARITY_PX, NEAR_SPEED_PX = 4.0, 0.8
OUTLINE, OUTLINE_PX = 0.02, 14.0  # of the width, and pixels: a point's window must not see an outline
LEAST_LIFT_PX = 0.15  # working pixels a frame
MOVES_PX = 0.12  # pixels a frame of the working picture: slower points are taken to stand
CELLS = (8, 6)  # errors within a cell of the frame are taken to be of one piece
LEAST_RIGID, MOST_RIGID = 20, 160  # tracks of a rigid body
LEAST_RIGID_SHARE = 0.25  # mean weight of its tracks
TYPICAL_FOCAL, FOCAL_SIGMA = 1.2, 0.3  # of the width, and of the logarithm: what is known where no rig is given
SIDE_SIGMA = 0.05  # of the width: how the eyes may be shifted against each other
RIGID_CAUTION = 1.5  # its sigma against the errors on rendered heads, where points wander alike
SIGMA_FLOOR = 0.01  # frames; what the model itself may be wrong by


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetFit:
    """offset_frames and sigma_frames (NaN and inf where nothing is known), and what stood behind them.

    row_share : share of the evidence that came from rows; the rest is from columns.
    speed_px  : 90th percentile of the moving points' speed, working pixels a frame; 0 where nothing moves.
    """

    offset_frames: float
    sigma_frames: float
    row_share: float
    speed_px: float
    tracks: int
    moving: int


@dataclass(frozen=True, kw_only=True, eq=False)
class _Block:
    """Rows that share an unknown part: residual of the sight, velocity, columns of what is unknown, and who is who."""

    sight: Float64
    speed: Float64
    unknown: Float64
    track: np.ndarray | None  # a constant of its own for each
    cell: np.ndarray
    speed_noise: Float64
    rows: bool


def _at(p: Float64, g: float) -> Float64:
    """Positions (n, F) at t + g by Catmull and Rom's cubic; NaN where the track does not reach."""
    whole = int(np.floor(g))
    u = g - whole
    n, count = p.shape
    padded = np.full((n, count + 2 * (abs(whole) + 3)), np.nan)
    start = abs(whole) + 3
    padded[:, start : start + count] = p
    a, b, c, d = (padded[:, start + whole + k : start + whole + k + count] for k in (-1, 0, 1, 2))
    if u == 0:
        return b.copy()
    # Beyond the ends the track goes on straight.
    a, d = np.where(np.isfinite(a), a, 2 * b - c), np.where(np.isfinite(d), d, 2 * c - b)
    found: Float64 = b + 0.5 * u * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    return found


def _speed(p: Float64) -> Float64:
    """Velocity (n, F): the slope of a straight line through five frames, three beside a track's end."""
    n, count = p.shape
    padded = np.full((n, count + 4), np.nan)
    padded[:, 2:-2] = p
    five = (2 * (padded[:, 4:] - padded[:, :-4]) + padded[:, 3:-1] - padded[:, 1:-3]) / 10
    three = (padded[:, 3:-1] - padded[:, 1:-3]) / 2
    return np.where(np.isfinite(five), five, three)


def _speed_noise(p: Float64) -> float:
    """Sigma of `_speed`, from the third differences of the tracks (each step has an error of its own)."""
    third = np.diff(p, n=3, axis=1)
    third = third[np.isfinite(third)]
    step = 1.4826 * float(np.median(np.abs(third))) / np.sqrt(6) if third.size else 0.0
    return 0.51 * step  # weights 2, 3, 3, 2 tenths of four steps


def _bodies(x: Float64, y: Float64, d: Float64, vx: Float64, vy: Float64, width: int) -> np.ndarray:
    """(n,) which body each point is of: single linkage in place, disparity and velocity."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    near = NEAR * width
    places = np.stack([x / near, y / near, d / NEAR_DISPARITY_PX, vx / NEAR_SPEED_PX, vy / NEAR_SPEED_PX], axis=1)
    pairs = cKDTree(places).query_pairs(1.0, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(x), len(x)))
    return np.asarray(connected_components(links, directed=False)[1])


def _on_outline(x: Float64, y: Float64, d: Float64, body: np.ndarray, width: int) -> Bool:
    """(n,) points beside one of another body or depth: an outline slides over a turning body, by time and by eye alike.

    Between the eyes an outline moves as it does when the body turns by the angle between them, which looks just like an offset.
    """
    from scipy.spatial import cKDTree

    a, b = cKDTree(np.stack([x, y], axis=1)).query_pairs(max(OUTLINE_PX, OUTLINE * width), output_type="ndarray").T
    other = ((body[a] >= 0) != (body[b] >= 0)) | (np.abs(d[a] - d[b]) > NEAR_DISPARITY_PX)
    out = np.zeros(len(x), bool)
    out[a[other]] = out[b[other]] = True
    return out


def _mean(p: Float64) -> Float64:
    count = np.isfinite(p).sum(axis=1)
    total: Float64 = np.nansum(p, axis=1) / np.maximum(count, 1)
    return total


@dataclass(frozen=True, kw_only=True, eq=False)
class _Run:
    """A run's tracks that are long enough, with what does not depend on the offset."""

    x: Float64
    y: Float64
    x_right: Float64
    y_right: Float64
    vx: Float64
    vy: Float64
    d: Float64
    body: np.ndarray  # -1 where it stands
    cell: np.ndarray
    shift: int
    width: int
    height: int


def _run(tracks: Tracks) -> _Run | None:
    usable = np.isfinite(tracks.x_right).sum(axis=1) >= LEAST_FRAMES
    if usable.sum() < LEAST_BODY:
        return None
    x, y, xr, yr = (p[usable] for p in (tracks.x, tracks.y, tracks.x_right, tracks.y_right))
    w, h = tracks.size
    vx, vy = _speed(x), _speed(y)
    speed = np.hypot(_mean(np.abs(vx)), _mean(np.abs(vy)))
    d, u, v = _mean(x - xr), _mean(x), _mean(y)
    body = np.full(len(x), -1)
    moving = speed > MOVES_PX
    if moving.any():
        body[moving] = _bodies(u[moving], v[moving], d[moving], _mean(vx)[moving], _mean(vy)[moving], w)
    outline = _on_outline(u, v, d, body, w)
    x, y, xr, yr, vx, vy, d, u, v, body = (p[~outline] for p in (x, y, xr, yr, vx, vy, d, u, v, body))
    cell = (u * CELLS[0] / w).astype(int) + CELLS[0] * (v * CELLS[1] / h).astype(int)
    return _Run(x=x, y=y, x_right=xr, y_right=yr, vx=vx, vy=vy, d=d, body=body, cell=cell, shift=tracks.shift, width=w, height=h)


def _rows_block(runs: Sequence[_Run], offset: float) -> _Block | None:
    sights, speeds, unknown, cells, noises = [], [], [], [], []
    for run in runs:
        g = run.shift - offset
        moves = (run.body >= 0)[:, None]  # what stands tells the rig's row error, and its jitter is no velocity
        sight, speed = run.y_right - np.where(moves, _at(run.y, g), run.y), np.where(moves, _at(run.vy, g), 0)
        known = np.isfinite(sight) & np.isfinite(speed)
        x, y = (2 * run.x / run.width - 1)[known], (2 * run.y - run.height)[known] / run.width
        d = np.broadcast_to(run.d[:, None], known.shape)[known] / 20
        sights.append(sight[known])
        speeds.append(speed[known])
        unknown.append(np.stack([np.ones_like(x), x, y, x * y, y * y, x * x, d, d * y], axis=1))
        cells.append(np.broadcast_to(run.cell[:, None], known.shape)[known])
        noises.append(np.where(moves & known, _speed_noise(run.y), 0.0)[known])
    if sum(map(len, sights)) < LEAST_ROWS:
        return None
    return _Block(
        sight=np.concatenate(sights),
        speed=np.concatenate(speeds),
        unknown=np.concatenate(unknown),
        track=None,
        cell=np.concatenate(cells),
        speed_noise=np.concatenate(noises),
        rows=True,
    )


def _column_blocks(runs: Sequence[_Run], offset: float) -> list[_Block]:
    blocks = []
    for number, run in enumerate(runs):
        g = run.shift - offset
        sight, speed = run.x_right - _at(run.x, g), _at(run.vx, g)
        known = np.isfinite(sight) & np.isfinite(speed)
        noise = _speed_noise(run.x)
        for body in np.unique(run.body[run.body >= 0]):
            mine = known & (run.body == body)[:, None]
            mine &= (mine.sum(axis=1) >= LEAST_FRAMES - 2)[:, None]
            members, frames = np.nonzero(mine)
            if len(np.unique(members)) < LEAST_BODY:
                continue
            _, frame = np.unique(frames, return_inverse=True)
            unknown = np.zeros((len(frame), 3 * (frame.max() + 1)))
            row = np.arange(len(frame))
            unknown[row, 3 * frame] = 1
            unknown[row, 3 * frame + 1] = run.x[mine] / run.width - 0.5
            unknown[row, 3 * frame + 2] = run.y[mine] / run.width - 0.25
            cell = run.cell[members] + CELLS[0] * CELLS[1] * (number + 1)
            blocks.append(
                _Block(
                    sight=sight[mine],
                    speed=speed[mine],
                    unknown=unknown,
                    track=members,
                    cell=cell,
                    speed_noise=np.full(len(frame), noise),
                    rows=False,
                )
            )
    return blocks


def _without_unknown(block: _Block, weight: Float64) -> tuple[Float64, Float64]:
    """Sight and velocity less what the unknown parts can explain of them (weighted least squares)."""
    both = np.stack([block.sight, block.speed], axis=1)
    unknown = block.unknown
    if block.track is not None:
        total = np.maximum(np.bincount(block.track, weight), 1e-12)

        def centred(a: Float64) -> Float64:
            means = np.stack([np.bincount(block.track, weight * column) for column in a.T], axis=1) / total[:, None]  # type: ignore[arg-type]
            rest: Float64 = a - means[block.track]
            return rest

        both, unknown = centred(both), centred(unknown)
    heavy = unknown * weight[:, None]
    normal = unknown.T @ heavy
    normal[np.diag_indices_from(normal)] += 1e-9 * max(float(np.trace(normal)), 1e-9) / len(normal)
    both = both - unknown @ np.linalg.solve(normal, heavy.T @ both)
    return both[:, 0], both[:, 1]


def _scale(residual: Float64) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), 0.01)


def _common_lift(runs: Sequence[_Run]) -> float:
    """RMS of what the bodies rise or sink as wholes, working pixels a frame.

    A head that turns about its axis shows a frame later much what the other eye shows now, slides of its points included: that
    once passed for 0.7 frame on cameras in step.  So this fit is believed only where something also moves up or down as a whole;
    the rest is left to the rigid body.
    """
    lifts = []
    for run in runs:
        moving = run.body >= 0
        if moving.sum() >= LEAST_BODY:
            rise = np.abs(run.vy[moving])
            sign = np.sign(run.vy[moving])
            known = np.isfinite(rise)
            lifts += [
                float(np.quantile(rise[:, t][known[:, t]], 0.5) * abs(np.nanmean(sign[:, t])))
                for t in range(rise.shape[1])
                if known[:, t].sum() >= LEAST_BODY
            ]
    return float(np.sqrt(np.mean(np.square(lifts)))) if lifts else 0.0


def _as_rigid(runs: Sequence[_Run], start: float | None, nothing: OffsetFit) -> OffsetFit:
    """The offset from the largest rigid motion of each run; runs that contradict one another widen the sigma."""
    fits = []
    for run in runs:
        mine = np.flatnonzero(run.body >= 0)
        if len(mine) < LEAST_RIGID:
            continue
        mine = mine[:: -(-len(mine) // MOST_RIGID)]
        x, y, xr, yr = (p[mine] for p in (run.x, run.y, run.x_right, run.y_right))
        w, h = run.width, run.height
        optics = Optics(focal=TYPICAL_FOCAL * w, cx=(w - 1) / 2, cy=(h - 1) / 2, focal_sigma=FOCAL_SIGMA, side_sigma=SIDE_SIGMA * w)
        found = fit_rigid(x, y, xr, yr, run.cell[mine], shift=run.shift, optics=optics, start=start)
        if np.isfinite(found.sigma_frames) and found.weight.mean() >= LEAST_RIGID_SHARE:
            fits.append((found.offset_frames, found.sigma_frames * RIGID_CAUTION))
    if not fits:
        return nothing
    offsets, sigmas = np.array(fits).T
    weight = 1 / (sigmas**2 + SIGMA_FLOOR**2)
    offset = float(weight @ offsets / weight.sum())
    spread = float(weight @ (offsets - offset) ** 2 / weight.sum()) / max(len(fits) - 1, 1)
    sigma = float(np.sqrt(max(1 / weight.sum(), spread) + SIGMA_FLOOR**2))
    return replace(nothing, offset_frames=offset, sigma_frames=sigma)


def fit_offset(tracks: Sequence[Tracks], *, start: float | None = None) -> OffsetFit:
    """The offset that rows and columns of all runs agree on.

    start  : frames, near which to look; by default the first run's shift.
    Errors are held to be of one piece within a cell of the frame (cluster-robust sigma).
    """
    runs = [run for run in map(_run, tracks) if run is not None]
    count = sum(len(run.x) for run in runs)
    moving: list[Bool] = [run.body >= 0 for run in runs]
    speeds = np.concatenate([np.hypot(_mean(np.abs(r.vx)), _mean(np.abs(r.vy)))[m] for r, m in zip(runs, moving)]) if runs else np.empty(0)
    nothing = OffsetFit(
        offset_frames=float("nan"),
        sigma_frames=float("inf"),
        row_share=0.0,
        speed_px=float(np.quantile(speeds, 0.9)) if speeds.size else 0.0,
        tracks=count,
        moving=int(speeds.size),
    )
    if speeds.size < LEAST_BODY:
        return nothing
    if _common_lift(runs) < LEAST_LIFT_PX:
        return _as_rigid(runs, start, nothing)
    offset = float(tracks[0].shift if start is None else start)
    sigma, share = float("inf"), 0.0
    for _ in range(ROUNDS):
        rows = _rows_block(runs, offset)
        blocks = ([rows] if rows else []) + _column_blocks(runs, offset)
        pieces = [_evidence(block) for block in blocks]
        kept = [piece for piece in pieces if piece is not None]
        if not kept:
            return nothing
        bread = sum(piece.weight for piece in kept)
        step = sum(piece.push for piece in kept) / bread
        meat = sum(float((piece.by_cell - piece.by_cell_weight * step).__pow__(2).sum()) for piece in kept)
        # Pieces of evidence that contradict one another widen the sigma to what they disagree by.
        spread = sum(piece.weight * (piece.push / piece.weight - step) ** 2 for piece in kept) / bread
        sigma = float(np.sqrt(max(meat / bread**2, 1 / bread, spread / max(len(kept) - 1, 1)) + SIGMA_FLOOR**2))
        share = sum(piece.weight for piece in kept if piece.rows) / bread
        # g = shift - offset: what the velocity still explains is taken off the offset.
        offset -= float(np.clip(step, -2, 2))
        if abs(step) < 1e-4:
            break
    return OffsetFit(offset_frames=offset, sigma_frames=sigma, row_share=share, speed_px=nothing.speed_px, tracks=count, moving=nothing.moving)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Evidence:
    weight: float
    push: float
    by_cell: Float64
    by_cell_weight: Float64
    rows: bool


def _evidence(block: _Block) -> _Evidence | None:
    """Weight of the evidence on the offset and where it pushes, robustly; None where velocity is all unknown or all noise."""
    weight = np.ones(len(block.sight))
    for _ in range(4):
        sight, speed = _without_unknown(block, weight)
        power = float((weight * (speed * speed - block.speed_noise**2)).sum())
        if power < LEAST_SIGNAL * float((weight * speed * speed).sum()):
            return None
        residual = sight - speed * (float((weight * sight * speed).sum()) / power)
        scale = _scale(residual)
        weight = np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0, None) ** 2
    sight, speed = _without_unknown(block, weight)
    power = float((weight * (speed * speed - block.speed_noise**2)).sum())
    if power <= 0:
        return None
    # A matched point's error lives as long as its track: frames of one track are far from independent, which the cells account for.
    over = 1 / scale**2
    cells = np.unique(block.cell, return_inverse=True)[1]
    return _Evidence(
        weight=power * over,
        push=float((weight * sight * speed).sum()) * over,
        by_cell=np.asarray(np.bincount(cells, weight * sight * speed) * over, np.float64),
        by_cell_weight=np.asarray(np.bincount(cells, weight * speed * speed) * over, np.float64),
        rows=block.rows,
    )
