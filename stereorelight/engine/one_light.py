"""One light on its own plate in one loop, from Z, N and plate to the picture: nothing in between is written and read again.

In: rows of rays, Z, N, plate.  Out: the relit row, and the light's strengths for its layers.  Frame: scene frame of the camera, metres.
What light_rows.py does in five loops, for what is most frequent: a place or a direction, Lambert or Phong with a whole exponent, at most a matte."""

from __future__ import annotations

from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.light_rows import FARTHEST2, NEAREST2, per_root

# As in light_rows.py: this file must change whenever it does.
LEAVES = "98543cc027d8cdb4"


@kernel(forceinline=True)
def raised(x, up5, up4, up3, up2, up1, up0, bit5, bit4, bit3, bit2, bit1, bit0):
    """x to a whole exponent, 1..127.   up5 ... up0 : whether it has a bit higher than this one;  bit5 ... bit0 : and this one as well.

    The bits are asked one by one, since a loop over those that are there would leave vector code; what is the same for all pixels becomes a jump,
    and costs next to nothing."""
    q = x
    p = q * q
    q = p if up5 else q
    p = q * x
    q = p if bit5 else q
    p = q * q
    q = p if up4 else q
    p = q * x
    q = p if bit4 else q
    p = q * q
    q = p if up3 else q
    p = q * x
    q = p if bit3 else q
    p = q * q
    q = p if up2 else q
    p = q * x
    q = p if bit2 else q
    p = q * q
    q = p if up1 else q
    p = q * x
    q = p if bit1 else q
    p = q * q
    q = p if up0 else q
    p = q * x
    return p if bit0 else q


@kernel(noalias=True)
def one_light(
    n, x, y, lit, Z, N, plate, gain_r, gain_g, gain_b, lx, ly, lz, w, ws, wo, a0, a1, a2, least,
    up5, up4, up3, up2, up1, up0, bit5, bit4, bit3, bit2, bit1, bit0, dr, dg, db, sr, sg, sb, e, s, out,
):  # fmt: skip
    """up5 ... bit0 : as in `raised`.   least : as in `lobe_whole`.   lit : what the matte lets through."""
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
        a *= r
        b *= r
        c *= r
        nl = nx * a + ny * b + nz * c
        k = nl * ws + wo
        k = k if k > f4(0) else f4(0)
        strength = (a0 + r * (a1 + r * a2)) * lit[i]
        diffuse = k * strength if good else f4(0)
        front = strength if good & (nl > f4(0)) else f4(0)
        r = per_root(p2)  # V = -P r
        k = nl + nl
        a = k * nx - a + px * r
        b = k * ny - b + py * r
        c = k * nz - c - d * r
        h = f4(1) - f4(0.5) * (a * a + b * b + c * c)
        h = h if h > least else f4(0)
        specular = raised(h, up5, up4, up3, up2, up1, up0, bit5, bit4, bit3, bit2, bit1, bit0) * front
        e[i] = diffuse
        s[i] = specular
        r = plate[3 * i]
        a = plate[3 * i + 1]
        b = plate[3 * i + 2]
        lit_r = r * (diffuse * dr) if abs(r) < f4(1e30) else f4(0)
        lit_g = a * (diffuse * dg) if abs(a) < f4(1e30) else f4(0)
        lit_b = b * (diffuse * db) if abs(b) < f4(1e30) else f4(0)
        out[3 * i] = r * gain_r + (lit_r + specular * sr)
        out[3 * i + 1] = a * gain_g + (lit_g + specular * sg)
        out[3 * i + 2] = b * gain_b + (lit_b + specular * sb)
