"""Sub-surface scattering: irradiance gathered over the surface by a diffusion profile, by true distances, never across a depth edge.

In: P (H, W, 3) metres, area of each pixel on its surface, irradiances stacked as channels; a list of taps.  Out: the same irradiances, scattered.
A pixel looks at its surroundings tap by tap, from the inside out.  A tap is reached only by way of the tap before it on the
way in, and only where depth goes on between the two: what lies behind a depth edge, seen from the pixel, is never reached,
whatever its distance.  Near taps are pixels; farther ones are cells of 3, 9, 27 ... pixels a side, means of what belongs
to their own centre's surface, and tile the plane exactly."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.fastmath import exp2, f4, kernel
from stereorelight.engine.rows import in_row_blocks

HALF = 10  # cells each way on every level
INNER = 3  # of them are the finer level's: 2 HALF + 1 = 3 (2 INNER + 1), so that levels tile
STEEPEST = 6.0  # rise over run on the screen: a surface seen at more than 80 degrees ends there
LOG2E = 1.4426950408889634

Taps = npt.NDArray[np.int32]  # (n, 4): dx, dy, level, index of the tap before it


@lru_cache(maxsize=16)
def taps(levels: int) -> Taps:
    """Offsets by distance from the centre, which comes first; `levels` >= 1."""
    found: list[tuple[int, int, int]] = []
    for level in range(levels):
        side = 3**level
        for j in range(-HALF, HALF + 1):
            for i in range(-HALF, HALF + 1):
                if level == 0 or max(abs(i), abs(j)) > INNER:
                    found.append((i * side, j * side, level))
    found.sort(key=lambda tap: (max(abs(tap[0]), abs(tap[1])), tap[1], tap[0]))
    table = np.array(found, np.int32)
    places, ring = table[:, :2].astype(np.float64), np.abs(table[:, :2]).max(axis=1)
    before = np.zeros(len(table), np.int32)
    for k in range(1, len(table)):
        side = 3 ** int(table[k, 2])
        wanted = places[k] * (1 - side / ring[k])
        nearer = int(np.searchsorted(ring, ring[k], side="left"))
        before[k] = int(((places[:nearer] - wanted) ** 2).sum(axis=1).argmin())
    return np.column_stack([table, before]).astype(np.int32)


@kernel()
def _joined(P, pitch, y, x, v, u):
    """Whether depth goes on from pixel (y, x) to (v, u), pixel by pixel along the line between them."""
    dy, dx = v - y, u - x
    steps = max(abs(dy), abs(dx))
    z = P[y, x, 2]
    slope = f4(STEEPEST) * np.sqrt(f4(dx * dx + dy * dy)) / f4(steps)
    for k in range(1, steps + 1):
        # Rounded to the nearest pixel, the same way from either end.
        i, j = y + (2 * dy * k + steps) // (2 * steps), x + (2 * dx * k + steps) // (2 * steps)
        if not abs(P[i, j, 2] - z) <= slope * pitch[i, j]:
            return False
        z = P[i, j, 2]
    return True


@kernel()
def _cuts(first, end, P, pitch, out):
    """1 where depth does not go on to any of the eight neighbours."""
    H, W = pitch.shape
    for y in range(first, end):
        for x in range(W):
            out[y, x] = 0
            for v in range(max(y - 1, 0), min(y + 2, H)):
                for u in range(max(x - 1, 0), min(x + 2, W)):
                    if (v != y or u != x) and not (_joined(P, pitch, y, x, v, u) and _joined(P, pitch, v, u, y, x)):
                        out[y, x] = 1


@kernel()
def _cells(first, end, P, pitch, cut, fine, side, out):
    """Means over 3 x 3 cells of `side` pixels of what belongs to the centre's surface; the rest counts as nothing."""
    H, W, C = fine.shape
    for y in range(first, end):
        for x in range(W):
            for c in range(C):
                out[y, x, c] = f4(0)
            if not P[y, x, 2] < f4(0):
                continue
            for j in range(-side, side + 1, side):
                for i in range(-side, side + 1, side):
                    v, u = y + j, x + i
                    if 0 <= v < H and 0 <= u < W and (cut[y, x] == 0 or (i == 0 and j == 0) or _joined(P, pitch, y, x, v, u)):
                        for c in range(C):
                            out[y, x, c] += fine[v, u, c] * f4(1 / 9)


@kernel()
def _gather(first, end, P, pitch, area, cuts, levels, share, table, shape_m, reach_m, out, total):
    """cuts (K, H, W): 1 where a cut may be near; levels (K, H, W, 3 L + 1): area times share times irradiance, and last area times share.

    out (H, W, 3 L); total (H, W, 3)."""
    H, W, C = out.shape
    n = table.shape[0]
    reached = np.zeros(n, np.uint8)
    sums = np.zeros(C, np.float32)
    weights = np.zeros(3, np.float32)
    rate = np.empty(3, np.float32)
    size = np.empty(3, np.float32)
    for c in range(3):
        rate[c] = f4(LOG2E / 3) / shape_m[c] if shape_m[c] > f4(0) else f4(0)
        size[c] = f4(1 / (8 * np.pi)) / shape_m[c] if shape_m[c] > f4(0) else f4(0)
    for y in range(first, end):
        for x in range(W):
            z = P[y, x, 2]
            own = levels[0, y, x, C]
            if not (z < f4(0)) or not share[y, x] > f4(0) or not own > f4(0):
                for c in range(C):
                    out[y, x, c] = f4(0)
                for c in range(3):
                    total[y, x, c] = f4(0)
                continue
            px, py, step = P[y, x, 0], P[y, x, 1], pitch[y, x]
            radius = np.sqrt(area[y, x] * f4(1 / np.pi))
            for c in range(3):
                u = exp2(-radius * rate[c])
                # A pixel's own share of itself: the profile's integral over its area.
                w = f4(1) - f4(0.25) * u * u * u - f4(0.75) * u if shape_m[c] > f4(0) else f4(1)
                w = w / area[y, x]
                weights[c] = w * own
                for k in range(c, C, 3):
                    sums[k] = w * levels[0, y, x, k]
            reached[0] = 1
            for t in range(1, n):
                dx, dy, level, before = table[t, 0], table[t, 1], table[t, 2], table[t, 3]
                if f4(max(abs(dx), abs(dy))) * step > reach_m:
                    break
                reached[t] = 0
                v, u_ = y + dy, x + dx
                if reached[before] == 0 or v < 0 or v >= H or u_ < 0 or u_ >= W:
                    continue
                if cuts[level, v, u_] and not _joined(P, pitch, y + table[before, 1], x + table[before, 0], v, u_):
                    continue
                reached[t] = 1
                a = levels[level, v, u_, C]
                if not a > f4(0):
                    continue
                ex, ey, ez = P[v, u_, 0] - px, P[v, u_, 1] - py, P[v, u_, 2] - z
                r = np.sqrt(ex * ex + ey * ey + ez * ez)
                if r > reach_m or r <= f4(0):
                    continue
                cell = f4(1)
                for _ in range(level):
                    cell *= f4(9)
                # The mean over a cell of side h is f + h^2/24 times f's Laplacian: e^(-k r)/r (k^2 + k/r + 1/r^2).
                inverse = f4(1) / r
                spread = area[v, u_] * cell * f4(1 / 24)
                round_ = f4(1) + spread * inverse * inverse
                for c in range(3):
                    if shape_m[c] > f4(0):
                        u = exp2(-r * rate[c])
                        k1 = f4(1) / shape_m[c]
                        k3 = k1 * f4(1 / 3)
                        wide = u * (round_ + spread * k3 * (k3 + inverse))
                        narrow = u * u * u * (round_ + spread * k1 * (k1 + inverse))
                        w = size[c] * (wide + narrow) * inverse * cell
                        weights[c] += w * a
                        for k in range(c, C, 3):
                            sums[k] += w * levels[level, v, u_, k]
            for c in range(3):
                total[y, x, c] = weights[c]
                for k in range(c, C, 3):
                    out[y, x, k] = sums[k] / weights[c]


def scatter(
    P: Float32, pitch: Float32, area: Float32, share: Float32, irradiance: Float32, *, shape_m: Float64, reach_m: float, levels: int
) -> tuple[Float32, Float32]:
    """Scattered irradiance (H, W, 3 L), 0 where nothing scatters, and the profile's integral over what each pixel saw, (H, W, 3).

    P, pitch, area : (H, W, 3) m, (H, W) m, (H, W) m2: place, width of a pixel square to the ray, and its area on the surface; NaN unknown.
    share          : (H, W), 0..1, how far a pixel is of the stuff; light goes in and out there alone.
    irradiance     : (H, W, 3 L) float32, channels of L lights one after the other, finite.
    shape_m        : (3,) of the profile of each channel, metres; 0 leaves the channel as it is.
    """
    H, W, C = irradiance.shape
    stack = np.empty((levels, H, W, C + 1), np.float32)
    held = np.where(np.isfinite(area), area * share, 0).astype(np.float32)
    stack[0, ..., :C] = irradiance * held[..., None]
    stack[0, ..., C] = held
    cuts = np.empty((levels, H, W), np.uint8)
    in_row_blocks(lambda first, end: _cuts(first, end, P, pitch, cuts[0]), H)
    for k in range(1, levels):  # none so near that a step between taps could meet it
        cuts[k] = ndimage.maximum_filter(cuts[0], 4 * 3**k + 1, mode="constant")
    for k in range(1, levels):
        in_row_blocks(lambda first, end, k=k: _cells(first, end, P, pitch, cuts[k], stack[k - 1], 3 ** (k - 1), stack[k]), H)  # type: ignore[misc]
    table = taps(levels)
    out, total = np.empty_like(irradiance), np.empty((H, W, 3), np.float32)
    lengths = np.asarray(shape_m, np.float32)
    in_row_blocks(lambda first, end: _gather(first, end, P, pitch, area, cuts, stack, share, table, lengths, f4(reach_m), out, total), H)
    return out, total
