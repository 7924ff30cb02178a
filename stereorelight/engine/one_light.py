"""One light in one loop, from Z and N to its strength on the surface: neither P nor V is written and read again.

In: rows of rays, Z, N.  Out: rows of diffuse light, of 1 - R.V, and of the strength in front.  Frame: scene frame of the camera, metres.
What light_rows.py does in three loops, for what is most frequent: a place or a direction, Lambert or Phong with a whole exponent, at most a matte."""

from __future__ import annotations

from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.light_rows import FARTHEST2, NEAREST2, per_root

# As in light_rows.py: this file must change whenever it does.
LEAVES = "98543cc027d8cdb4"
MOST_DOTS = 64


@kernel(noalias=True)
def one_light(n, x, y, lit, Z, N, lx, ly, lz, w, ws, wo, a0, a1, a2, e, h, front):
    """Diffuse into e, and for the highlight 1 - R.V and the strength in front of the surface.   lit : what the matte lets through.

    All dot products come straight from what was read, none waits for a root: it is the wait that costs.  R.V is 3e-7 off that way, which
    exponents up to MOST_DOTS bear."""
    for i in range(n):
        d = Z[i] if Z[i] > f4(0) else f4(0)
        px = x[i] * d
        py = y[i] * d
        nx = N[3 * i]
        ny = N[3 * i + 1]
        nz = N[3 * i + 2]
        p2 = px * px + py * py + d * d
        n2 = nx * nx + ny * ny + nz * nz
        good = (p2 > f4(1e-20)) & (p2 < FARTHEST2) & (n2 > f4(0.25)) & (n2 < f4(4))
        a = lx - w * px
        b = ly - w * py
        c = lz + w * d
        d2 = a * a + b * b + c * c
        d2 = NEAREST2 if d2 < NEAREST2 else d2
        r = per_root(d2)
        nl = (nx * a + ny * b + nz * c) * r
        k = nl * ws + wo
        k = k if k > f4(0) else f4(0)
        strength = (a0 + r * (a1 + r * a2)) * lit[i]
        e[i] = k * strength if good else f4(0)
        front[i] = strength if good & (nl > f4(0)) else f4(0)
        n_p = nx * px + ny * py - nz * d  # V = -P / |P|
        l_p = (a * px + b * py - c * d) * r
        h[i] = f4(1) - (l_p - (nl + nl) * n_p) * per_root(p2)
