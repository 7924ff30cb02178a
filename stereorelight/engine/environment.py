"""The environment kernel: rows of P, N and albedo under lat-long tables, to diffuse, reflected and refracted layers.

In: P, N, albedo (H, W, 3) float32, tables made by `padded`, a turn, and numbers.  Out: layers (H, W, 3) written into arrays given.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres; the turn leads from it to the map's own frame.
A row goes through in strips that stay in the cache.  Strips are padded to whole vectors, so a pixel's bits do not depend on where
its row was cut.  Pixels without P or N get exactly 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.engine import environment_rows as leaf
from stereorelight.engine.fastmath import f4, i4, kernel
from stereorelight.engine.rows import in_row_blocks

# As in engine/light.py: this file must change whenever environment_rows.py does.
LEAVES = "bd0ee122d205b1d8"
STRIP = 1024
PADDING = 80  # rows a whole page apart would fall onto the same cache lines
VECTOR = 64
ROWS = 16
# What `numbers` holds, beside the turn in 0..8.
IOR, MIXED, BLEND, THICKNESS, DIFFUSE, REFLECTION, REFRACTION = 9, 10, 11, 12, 13, 16, 19
NUMBERS = 22


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """A lat-long map with a ghost texel on every side, four floats a texel, flat."""

    texels: Float32
    width: int
    height: int


def padded(picture: Float32) -> Table:
    """`picture` (h, w, 3) for the kernel: azimuth goes round, and beyond a pole comes its other side."""
    h, w = picture.shape[:2]
    room = np.zeros((h + 2, w + 2, 4), np.float32)
    room[1:-1, 1:-1, :3] = picture
    room[:, 0] = room[:, w]
    room[:, w + 1] = room[:, 1]
    across = (np.arange(w + 2) - 1 + w // 2) % w + 1
    room[0], room[-1] = room[1, across], room[-2, across]
    return Table(texels=room.reshape(-1), width=w, height=h)


@kernel()
def _rows(first, end, P, N, albedo, matte, has_matte, numbers, sizes, soft, sharp, rough, asked, diffuse, reflection, refraction, behind):
    """Rows first..end.  asked: diffuse, reflection, refraction from the map, the places of the plate behind; pictures are (H, 3 W)."""
    W = N.shape[1] // 3
    T = np.empty((16, STRIP + PADDING), np.float32)
    found = np.empty(4 * (STRIP + PADDING), np.float32)
    j = np.empty(STRIP + PADDING, np.int32)
    tail = np.zeros((2, 3 * VECTOR), np.float32)
    nx, ny, nz, vx, vy, vz, known, c, g, back, through, x_, y_, z_, p, q = (
        T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9], T[10], T[11], T[12], T[13], T[14], T[15],
    )  # fmt: skip
    azimuth, polar = np.empty(STRIP + PADDING, np.float32), np.empty(STRIP + PADDING, np.float32)
    a0, a1, a2, b0, b1, b2 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5]
    c0, c1, c2 = numbers[6], numbers[7], numbers[8]
    for y in range(first, end):
        for x in range(0, W, STRIP):
            m = min(STRIP, W - x)
            n = (m + VECTOR - 1) // VECTOR * VECTOR
            whole = m // VECTOR * VECTOR
            strip = slice(3 * x, 3 * (x + m))
            if whole:
                leaf.surface(whole, P[y, strip], N[y, strip], nx, ny, nz, vx, vy, vz, known)
            if whole < n:
                left = 3 * (m - whole)
                rest = slice(3 * (x + whole), 3 * (x + m))
                tail[:] = f4(0)
                Ps, Ns = leaf.copied(left, P[y, rest], tail[0]), leaf.copied(left, N[y, rest], tail[1])
                leaf.surface(n - whole, Ps, Ns, nx[whole:], ny[whole:], nz[whole:], vx[whole:], vy[whole:], vz[whole:], known[whole:])
            if has_matte:
                leaf.through_matte(m, matte[y, x : x + m], known)
            if asked[0]:
                leaf.latlong(n, a0, a1, a2, b0, b1, b2, c0, c1, c2, nx, ny, nz, azimuth, polar)
                leaf.texels(n, sizes[0, 0], sizes[0, 1], azimuth, polar, j, p, q)
                leaf.fetch(m, soft, sizes[0, 0], j, p, q, found)
                leaf.write_lit(m, found, known, numbers[DIFFUSE], numbers[DIFFUSE + 1], numbers[DIFFUSE + 2], albedo[y, strip], diffuse[y, strip])
            if asked[1] or asked[2] or asked[3]:
                leaf.fresnel(n, numbers[IOR], numbers[MIXED] > f4(0), nx, ny, nz, vx, vy, vz, known, c, g, back, through)
            for way in range(1, 3):
                if not asked[way]:
                    continue
                if way == 1:
                    leaf.mirrored(n, nx, ny, nz, vx, vy, vz, c, x_, y_, z_)
                else:
                    leaf.refracted(n, f4(1) / numbers[IOR], nx, ny, nz, vx, vy, vz, c, g, x_, y_, z_)
                leaf.latlong(n, a0, a1, a2, b0, b1, b2, c0, c1, c2, x_, y_, z_, azimuth, polar)
                leaf.texels(n, sizes[1, 0], sizes[1, 1], azimuth, polar, j, p, q)
                leaf.fetch(m, sharp, sizes[1, 0], j, p, q, found)
                if numbers[BLEND] > f4(0):
                    leaf.texels(n, sizes[2, 0], sizes[2, 1], azimuth, polar, j, p, q)
                    leaf.fetch_between(m, rough, sizes[2, 0], numbers[BLEND], j, p, q, found)
                if way == 1:
                    leaf.write(m, found, back, numbers[REFLECTION], numbers[REFLECTION + 1], numbers[REFLECTION + 2], reflection[y, strip])
                else:
                    leaf.write(m, found, through, numbers[REFRACTION], numbers[REFRACTION + 1], numbers[REFRACTION + 2], refraction[y, strip])
            if asked[3]:
                leaf.refracted(n, f4(1) / numbers[IOR], nx, ny, nz, vx, vy, vz, c, g, x_, y_, z_)
                leaf.behind(m, numbers[THICKNESS], P[y, strip], x_, y_, z_, through, behind[y, strip])


@kernel()
def _plate_rows(first, end, at, plate, width, height, red, green, blue, out):
    W = at.shape[1] // 3
    j = np.empty(W + PADDING, np.int32)
    T = np.empty((3, W + PADDING), np.float32)
    found = np.empty(4 * (W + PADDING), np.float32)
    for y in range(first, end):
        leaf.plate_texels(W, f4(width - 1), f4(height - 1), i4(width + 1), at[y], j, T[0], T[1], T[2])
        leaf.fetch(W, plate, i4(width - 1), j, T[0], T[1], found)
        for i in range(4 * W):
            found[i] = found[i] if abs(found[i]) < f4(1e30) else f4(0)
        leaf.write(W, found, T[2], red, green, blue, out[y])


def _flat(picture: Float32 | None) -> Float32:
    return np.empty((1, 1), np.float32) if picture is None else picture.reshape(picture.shape[0], -1)


def shade(
    P: Float32,
    N: Float32,
    albedo: Float32,
    matte: Float32 | None,
    numbers: Float32,
    *,
    soft: Table | None = None,
    sharp: Table | None = None,
    rough: Table | None = None,
    diffuse: Float32 | None = None,
    reflection: Float32 | None = None,
    refraction: Float32 | None = None,
    behind: Float32 | None = None,
) -> None:
    """Write the layers that are given: diffuse wants `soft`; reflection and refraction want `sharp`, and `rough` with numbers[BLEND] > 0.

    numbers : (NUMBERS,) the turn row by row, then by the names above; tints hold every strength.
    behind  : (H, W, 3), where on the plate the refracted ray ends, as slopes x, y and its weight.
    The caller has checked shapes; all arrays are C-contiguous float32.
    """
    none = Table(texels=np.zeros(36, np.float32), width=1, height=1)
    tables = [table or none for table in (soft, sharp, rough or sharp)]
    sizes = np.array([(table.width, table.height) for table in tables], np.int32)
    asked = np.array([picture is not None for picture in (diffuse, reflection, refraction, behind)])
    flats = [_flat(picture) for picture in (P, N, albedo)]
    held = np.empty((1, 1), np.float32) if matte is None else matte
    outs = [_flat(picture) for picture in (diffuse, reflection, refraction, behind)]

    def run(first: int, end: int) -> None:
        _rows(first, end, *flats, held, matte is not None, numbers, sizes, *(table.texels for table in tables), asked, *outs)

    in_row_blocks(run, N.shape[0], block_rows=ROWS)


def from_plate(at: Float32, plate: Float32, tint: Float64, out: Float32) -> None:
    """out (H, W, 3) = plate at the pixels (u, v) of at (H, W, 3) between its texels, times at's third number and the tint.

    Beyond the frame its edge goes on; a NaN or infinite value of the plate counts as 0 in the pixels that look at it."""
    h, w = plate.shape[:2]
    room = np.zeros((h + 1, w + 1, 4), np.float32)
    room[:h, :w, :3] = plate
    room[h], room[:, w] = room[h - 1], room[:, w - 1]
    texels = room.reshape(-1)
    red, green, blue = (f4(v) for v in tint)
    flat_at, flat_out = _flat(at), _flat(out)
    in_row_blocks(lambda a, b: _plate_rows(a, b, flat_at, texels, w, h, red, green, blue, flat_out), at.shape[0], block_rows=ROWS)
