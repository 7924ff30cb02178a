"""What a board's corner looks like: two edges that cross, and how a picture's levels lean on where they lie.

Model: level = (A + B T(p) + C T(p)^2)(1 + h . x), B > 0, with p = +- the mean over the exposure's path m of E(e1 / s1) E(e2 / s2);
e1, e2 are the distances to the two edges, parabolas of given curvature; the sign makes p = 1 the bright quadrants.  E is erf
with a tail (a fourth moment) that all corners of a picture share, T the picture's tone from black to white, which they share
too; C stands in for T where there are few corners; h is the shading; levels clip where the picture does.  Everything but the
shading is even about the corner, so what the model lacks hardly moves it, but where an edge runs along pixel rows: there every
sample has the same phase, and what is lacking on the dark side, which the tone makes steep, shifts edges by up to 0.03 px.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stereorelight.arrays import Float64

PARAMETERS, SHARED = 13, 2  # cx cy t1 t2 log(s1) log(s2) A B C hx hy mx my; the tail, the tone's factor
TONE_STEPS = 1024
NO_TONE: Float64 = np.stack([np.linspace(-1.0, 1.0, TONE_STEPS + 1), np.zeros(TONE_STEPS + 1)], axis=-1)
ROOT = 2 / math.sqrt(math.pi)
ERF_STEPS = 64
_at = np.arange(-5 * ERF_STEPS, 5 * ERF_STEPS + 1) / ERF_STEPS
ERRORS: Float64 = np.array([(math.erf(u), math.exp(-u * u)) for u in _at])


@njit(cache=True, nogil=True, error_model="numpy")
def _blurred(u, errors):
    """erf(u) and exp(-u^2), to 1e-9, by a table and the next terms of Taylor's series."""
    if u >= 5.0:
        return 1.0, 0.0
    if u <= -5.0:
        return -1.0, 0.0
    k = int(u * ERF_STEPS + (5.0 * ERF_STEPS + 0.5))
    at = k / ERF_STEPS - 5.0
    h = u - at
    d = errors[k, 1]
    bend = (2.0 * at * at - 1.0) * h * h
    skew = at * (2.0 * at * at - 3.0) * h * h * h
    return errors[k, 0] + ROOT * d * h * (1.0 - at * h + bend / 3.0 - skew / 6.0), d * (1.0 - 2.0 * at * h + bend - 2.0 / 3.0 * skew)


@njit(cache=True, nogil=True, error_model="numpy")
def _edge(u, tail, errors):
    """A blurred edge at u, -1..1, its slopes by u and by `tail`: erf and the next even term of Gram and Charlier's series."""
    e, g = _blurred(u, errors)
    x2 = 2.0 * u * u
    x = math.sqrt(2.0) * u
    g *= math.sqrt(2.0 / math.pi)  # twice the normal density of x
    more = -g * x * (x2 - 3.0) / 24.0
    return e + tail * more, math.sqrt(2.0) * g * (1.0 + tail * (x2 * x2 - 6.0 * x2 + 3.0) / 24.0), more


@njit(cache=True, nogil=True, error_model="numpy")
def product(q, dx, dy, i1, i2, c1, n1, c2, n2, k1, k2, moving, tail, errors, J, nodes, weights):
    """The two edges' product at one pixel; J: its slopes by position, angles, log widths, path (11, 12) and the blur's tail (13)."""
    p = 0.0
    J[0:6] = 0.0
    J[11:] = 0.0
    for k in range(nodes.shape[0] if moving else 1):
        t = nodes[k] if moving else 0.0
        w = weights[k] if moving else 1.0
        x, y = dx - t * q[11], dy - t * q[12]
        a1, a2 = -x * n1 + y * c1, -x * n2 + y * c2  # along each edge
        u = (x * c1 + y * n1 + 0.5 * k1 * a1 * a1) * i1
        v = (x * c2 + y * n2 + 0.5 * k2 * a2 * a2) * i2
        eu, gu, tu = _edge(u, tail, errors)
        ev, gv, tv = _edge(v, tail, errors)
        p += w * eu * ev
        gu, gv = w * gu * ev, w * gv * eu
        ux, uy = (c1 - k1 * a1 * n1) * i1, (n1 + k1 * a1 * c1) * i1
        vx, vy = (c2 - k2 * a2 * n2) * i2, (n2 + k2 * a2 * c2) * i2
        px_, py_ = gu * ux + gv * vx, gu * uy + gv * vy
        J[0] -= px_
        J[1] -= py_
        J[2] += gu * a1 * i1
        J[3] += gv * a2 * i2
        J[4] -= gu * u
        if moving:
            J[4] -= gv * v
            J[11] -= t * px_
            J[12] -= t * py_
        else:
            J[5] -= gv * v
        J[13] += w * (tu * ev + tv * eu)
    return p


@njit(cache=True, nogil=True, error_model="numpy")
def looked_up(table, p):
    """A row of `table`, evenly over p = -1..1, by straight lines: value, slope, and the second column."""
    per = 0.5 * (table.shape[0] - 1)
    place = (p + 1.0) * per
    at = min(max(int(place), 0), table.shape[0] - 2)
    part = place - at
    rise = table[at + 1, 0] - table[at, 0]
    return table[at, 0] + part * rise, rise * per, table[at, 1] * (1.0 - part) + table[at + 1, 1] * part


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(q, n, px, py, level, trust, sign, tone, tail, k1, k2, moving, low, high, errors, P, J, JJ, Jr, nodes, weights):
    """Fill JJ = J'J and Jr = J'r by the first P parameters at q; the sum of squared residuals, each weighed by `trust`.

    P is 13, or 15 with what all corners share: the blur's tail and the tone's bend."""
    c1, n1, c2, n2 = math.cos(q[2]), math.sin(q[2]), math.cos(q[3]), math.sin(q[3])
    i1, i2 = math.exp(-q[4]), math.exp(-(q[4] if moving else q[5]))
    JJ[:, :] = 0.0
    Jr[:] = 0.0
    cost = 0.0
    for i in range(n):
        p = sign * product(q, px[i] - q[0], py[i] - q[1], i1, i2, c1, n1, c2, n2, k1, k2, moving, tail, errors, J, nodes, weights)
        T, rise, bend = looked_up(tone, p)
        shade = 1.0 + q[9] * px[i] + q[10] * py[i]
        base = q[6] + q[7] * T + q[8] * T * T
        model = base * shade
        if model >= high or model <= low:  # the picture clips too: nothing to learn of how far
            r = trust[i] * (level[i] - (high if model >= high else low))
            cost += r * r
            continue
        r = trust[i] * (level[i] - model)
        cost += r * r
        steep = (q[7] + 2.0 * q[8] * T) * shade * trust[i]
        slope = steep * sign * rise
        for a in range(6):
            J[a] *= slope
        for a in range(11, 14):
            J[a] *= slope
        J[14] = steep * bend
        shade *= trust[i]
        J[6], J[7], J[8] = shade, T * shade, T * T * shade
        J[9], J[10] = base * px[i] * trust[i], base * py[i] * trust[i]
        for a in range(P):
            ja = J[a]
            if ja != 0.0:
                Jr[a] += ja * r
                for b in range(a + 1):
                    JJ[a, b] += ja * J[b]
    return cost
