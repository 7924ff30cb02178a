"""Corners where two edges cross, each fitted to the pixels around it.

In: a grey picture (H, W) float32, as encoded, and for each corner a start, its edges and its window.  Out: one row a corner.
Model: engine/corner_model.py.  Gauss-Newton with Levenberg's damping, all parameters at once."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.corner_model import ERRORS, NO_TONE, PARAMETERS, SHARED, looked_up, normal_equations, product
from stereorelight.engine.rows import in_row_blocks

STEPS = 40
COLUMNS = 20  # x y sigma_x sigma_y cov_xy t1 t2 s1 s2 A B C hx hy mx my rms pixels cost steps
SETTLED_PX = 1e-4
NODES, WEIGHTS = np.polynomial.legendre.leggauss(9)
NODES, WEIGHTS = NODES / 2, WEIGHTS / 2  # over -1/2 .. 1/2
FEWEST_PIXELS = 28
BLOCK_CORNERS = 4
LEFT_OUT = 1e30  # on the diagonal: a parameter that stays
LACKING = 0.05  # what the model lacks of an edge, of its contrast


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(A):
    """Cholesky's factor of A in place (lower); False where A is not positive."""
    n = A.shape[0]
    for j in range(n):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        if not s > 1e-14:
            return False
        A[j, j] = math.sqrt(s)
        for i in range(j + 1, n):
            t = A[i, j]
            for k in range(j):
                t -= A[i, k] * A[j, k]
            A[i, j] = t / A[j, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(L, b, x):
    n = L.shape[0]
    for i in range(n):
        t = b[i]
        for k in range(i):
            t -= L[i, k] * x[k]
        x[i] = t / L[i, i]
    for i in range(n - 1, -1, -1):
        t = x[i]
        for k in range(i + 1, n):
            t -= L[k, i] * x[k]
        x[i] = t / L[i, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _window(picture, ix, iy, x0, y0, shape, depth, margin, reach, radius, px, py, level):
    """Pixels of one corner's window into px, py (from the middle pixel) and level; how many."""
    H, W = picture.shape
    r = int(np.ceil(radius))
    m1 = margin * math.hypot(shape[0, 0], shape[0, 1])
    m2 = margin * math.hypot(shape[1, 0], shape[1, 1])
    n = 0
    for j in range(-r, r + 1):
        y = iy + j
        if y < 0 or y >= H:
            continue
        for i in range(-r, r + 1):
            dx, dy = ix + i - x0, iy + j - y0
            a = shape[0, 0] * dx + shape[0, 1] * dy
            b = shape[1, 0] * dx + shape[1, 1] * dy
            if dx * dx + dy * dy > radius * radius or a * a + b * b > reach * reach:
                continue
            d = depth[(1 if a > 0 else 0) + (2 if b > 0 else 0)]
            if abs(a) > max(d - m1, 0.5 * d) and abs(b) > max(d - m2, 0.5 * d):
                continue
            x = ix + i
            if x < 0 or x >= W:
                continue
            px[n], py[n], level[n] = i, j, picture[y, x]
            n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    first,
    end,
    picture,
    starts,
    shapes,
    bends,
    depths,
    blur,
    motion,
    margin,
    reach,
    most_radius,
    furthest,
    low,
    high,
    nodes,
    weights,
    errors,
    tone,
    tail,
    noise,
    own_bend,
    shared,
    out,
):
    P, K = PARAMETERS, SHARED
    moving = motion[0] != 0.0 or motion[1] != 0.0
    most = (2 * int(np.ceil(most_radius)) + 3) ** 2
    px, py, level, trust = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    J, JJ, Jr = np.empty(P + K), np.empty((P, P)), np.empty(P)
    wideJJ, wideJr, cross = np.empty((P + K, P + K)), np.empty(P + K), np.empty((K, P))
    nextJJ, nextJr, L = np.empty((P, P)), np.empty(P), np.empty((P, P))
    q, trial, step, unit = np.empty(P), np.empty(P), np.empty(P), np.empty(P)
    for c in range(first, end):
        out[c, :] = np.nan
        x0, y0 = starts[c, 0], starts[c, 1]
        if not (math.isfinite(x0) and math.isfinite(y0)):
            continue
        ix, iy = int(np.floor(x0 + 0.5)), int(np.floor(y0 + 0.5))
        S = shapes[c]
        # The window's own half width in pixels: the longest semi-axis of the ellipse |S d| < reach.
        det = abs(S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0])
        tr = S[0, 0] ** 2 + S[0, 1] ** 2 + S[1, 0] ** 2 + S[1, 1] ** 2
        least = math.sqrt(max(0.5 * (tr - math.sqrt(max(tr * tr - 4 * det * det, 0.0))), 1e-12))
        radius = min(reach / least, most_radius)
        n = _window(picture, ix, iy, x0, y0, S, depths[c], margin, reach, radius, px, py, level)
        if n < 28:
            continue
        bright, dark, mean = -1e30, 1e30, 0.0
        for i in range(n):
            bright, dark, mean = max(bright, level[i]), min(dark, level[i]), mean + level[i]
        mean /= n
        q[:] = 0.0
        q[0], q[1] = x0 - ix, y0 - iy
        q[2], q[3] = math.atan2(S[0, 1], S[0, 0]), math.atan2(S[1, 1], S[1, 0])
        q[4], q[5] = math.log(blur[0]), math.log(blur[1])
        q[6] = 0.5 * (bright + dark)
        same = 0.0
        for i in range(n):
            dx, dy = px[i] - q[0], py[i] - q[1]
            side = (S[0, 0] * dx + S[0, 1] * dy) * (S[1, 0] * dx + S[1, 1] * dy)
            same += (level[i] - mean) * (1.0 if side > 0 else -1.0)
        sign = 1.0 if same > 0 else -1.0
        q[7] = 0.45 * (bright - dark)
        if moving:
            q[11], q[12] = motion[0], motion[1]
        trust[:n] = 1.0
        if noise > 0.0:  # what the model lacks grows with the tone's slope: where noise does not cover it, steep parts weigh less
            c1, n1, c2, n2 = math.cos(q[2]), math.sin(q[2]), math.cos(q[3]), math.sin(q[3])
            for i in range(n):
                dx, dy = px[i] - q[0], py[i] - q[1]
                p = sign * product(q, dx, dy, 1 / blur[0], 1 / blur[1], c1, n1, c2, n2, 0.0, 0.0, moving, tail, errors, J, nodes, weights)
                lacking = LACKING * q[7] * looked_up(tone, p)[1] / noise
                trust[i] = 1.0 / math.sqrt(1.0 + lacking * lacking)
        cost = normal_equations(
            q, n, px, py, level, trust, sign, tone, tail, bends[c, 0], bends[c, 1], moving, low, high, errors, P, J, JJ, Jr, nodes, weights
        )
        damping = 1e-3
        steps = quiet = 0
        settled = False
        for steps in range(40):  # noqa: B007
            L[:, :] = JJ
            for a in range(P):
                L[a, a] += damping * JJ[a, a] + 1e-9
            if not moving:
                L[11, 11], L[12, 12] = 1.0, 1.0
            else:
                L[5, 5] = 1.0
            L[8, 8] += 1e-3 * n if own_bend else LEFT_OUT  # the curve's bend and the shading stay small where nothing shows them
            L[9, 9] += 1e-3 * n
            L[10, 10] += 1e-3 * n
            if not _factor(L):
                damping *= 10.0
                if damping > 1e9:
                    break
                continue
            _solve(L, Jr, step)
            for a in range(P):
                trial[a] = q[a] + step[a]
            trial[4] = min(max(trial[4], -1.1), 2.7)
            trial[5] = min(max(trial[5], -1.1), 2.7)
            next_cost = normal_equations(
                trial,
                n,
                px,
                py,
                level,
                trust,
                sign,
                tone,
                tail,
                bends[c, 0],
                bends[c, 1],
                moving,
                low,
                high,
                errors,
                P,
                J,
                nextJJ,
                nextJr,
                nodes,
                weights,
            )
            if next_cost <= cost:
                moved = math.hypot(trial[0] - q[0], trial[1] - q[1])
                drop = cost - next_cost
                q[:], JJ[:, :], Jr[:] = trial, nextJJ, nextJr
                cost = next_cost
                damping = max(damping * 0.2, 1e-9)
                # Where whites clip, their level drifts for ever; the corner itself has long come to rest.
                quiet = quiet + 1 if moved < 3e-4 else 0
                if (moved < 1e-4 and drop < 1e-4 * cost + 1e-12) or quiet == 3:
                    settled = True
                    break
            else:
                damping *= 6.0
                if damping > 1e7:  # no smaller step helps: this is the bottom
                    settled = True
                    break
        if not settled or q[7] <= 0.0 or math.hypot(q[0] + ix - x0, q[1] + iy - y0) > furthest:
            continue
        L[:, :] = JJ
        for a in range(P):
            L[a, a] += 1e-9 + 1e-9 * JJ[a, a]
        if not moving:
            L[11, 11], L[12, 12] = 1.0, 1.0
        else:
            L[5, 5] = 1.0
        if not own_bend:
            L[8, 8] += LEFT_OUT
        if not _factor(L):
            continue
        variance = cost / max(n - 11, 1)
        unit[:] = 0.0
        unit[0] = 1.0
        _solve(L, unit, step)
        out[c, 2], out[c, 4] = math.sqrt(max(step[0] * variance, 0.0)), step[1] * variance
        unit[0], unit[1] = 0.0, 1.0
        _solve(L, unit, step)
        out[c, 3] = math.sqrt(max(step[1] * variance, 0.0))
        out[c, 0], out[c, 1] = ix + q[0], iy + q[1]
        out[c, 5], out[c, 6] = q[2], q[3]
        out[c, 7], out[c, 8] = math.exp(q[4]), math.exp(q[4] if moving else q[5])
        for a in range(5):
            out[c, 9 + a] = q[6 + a]
        out[c, 10] *= sign
        out[c, 14], out[c, 15] = q[11], q[12]
        out[c, 16], out[c, 17], out[c, 18], out[c, 19] = math.sqrt(cost / n), n, cost, steps
        if not shared.shape[0]:
            continue
        normal_equations(
            q,
            n,
            px,
            py,
            level,
            trust,
            sign,
            tone,
            tail,
            bends[c, 0],
            bends[c, 1],
            moving,
            low,
            high,
            errors,
            P + K,
            J,
            wideJJ,
            wideJr,
            nodes,
            weights,
        )
        # What this corner says of the shared factors, once its own parameters have followed them: Schur's complement.
        for a in range(K):
            cross[a] = wideJJ[P + a, :P]
            _solve(L, cross[a], step)
            for b in range(K):
                t = wideJJ[P + max(a, b), P + min(a, b)]
                for k in range(P):
                    t -= step[k] * wideJJ[P + b, k]
                shared[c, a, b] = t / variance
            t = wideJr[P + a]
            for k in range(P):
                t -= step[k] * wideJr[k]
            shared[c, a, K] = t / variance


def fit_corners(
    picture: Float32,
    starts: Float64,
    shapes: Float64,
    bends: Float64,
    depths: Float64,
    *,
    blur: tuple[float, float] = (1.0, 1.0),
    motion: tuple[float, float] = (0.0, 0.0),
    margin_px: float = 2.0,
    reach: float = 0.38,
    most_radius_px: float = 20.0,
    furthest_px: float = 2.0,
    low: float = -np.inf,
    high: float = np.inf,
    tone: Float64 = NO_TONE,
    tail: float = 0.0,
    noise: float = 0.0,
    own_bend: bool = True,
    shared: Float64 | None = None,
) -> Float64:
    """(n, COLUMNS) float64: x y sigma_x sigma_y cov_xy t1 t2 s1 s2 A B C hx hy mx my rms pixels cost steps; NaN where not settled.

    starts : (n, 2) pixels.  shapes: (n, 2, 2) squares per pixel; row 0 grows across edge 1, row 1 across edge 2.
    bends  : (n, 2) curvature of each edge, 1/px.  depths: (n, 4) squares of clean ground in the quadrants (- -, + -, - +, + +).
    blur   : start of s1, s2 in pixels (erf(e/s): s is sqrt 2 times a Gaussian's sigma).  motion: start of the path; zero: none is fitted.
    reach  : half the window in squares.  low, high: levels at which the picture clips.
    tone   : (TONE_STEPS + 1, 2) T(p) at p = -1..1, evenly, and its slope by the factor that bends it.
    tail   : the blur's excess of the fourth moment: 0 for a Gaussian.  noise: levels, one sigma; 0 where not known.
    own_bend : whether C is fitted.
    shared : (n, 2, 3), zeros, filled where given: of each corner that settled, normal matrix and right side of what all corners share,
             `tail` and the tone's factor, once its own parameters have followed; to be summed.
    """
    out = np.full((len(starts), COLUMNS), np.nan)
    args = (picture, starts, shapes, bends, depths, np.array(blur, float), np.array(motion, float), float(margin_px), float(reach))
    more = (float(most_radius_px), float(furthest_px), float(low), float(high), NODES, WEIGHTS, ERRORS, tone, float(tail))
    last = (float(noise), own_bend, np.zeros((0, SHARED, SHARED + 1)) if shared is None else shared, out)
    in_row_blocks(lambda first, end: _fit(first, end, *args, *more, *last), len(starts), block_rows=BLOCK_CORNERS)
    return out
