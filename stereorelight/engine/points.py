"""Points of one picture found in another to a few hundredths of a pixel, each by its own window.

In: two grey pictures (H, W) float32 and points near their answers.  Out: sub-pixel places, one row a point.
Each window may shift, turn, stretch and shear (affine), and its brightness may change by a gain and an offset: the inverse
compositional search (Baker and Matthews 2004) on the enhanced correlation coefficient (Evangelidis and Psarakis 2008)."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.rows import in_row_blocks

STEPS = 20
SETTLED_PX = 2e-3  # a step shorter than this is the last
DAMPING = 1e-3  # of the mean curvature, on shape only: a window of one straight edge must not shear without end
BLOCK_POINTS = 64


@njit(cache=True, nogil=True, error_model="numpy")
def _cubic(t, out):
    """Weights of the four pixels about a fraction t (Keys 1981, a = -0.5)."""
    out[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    out[1] = (1.5 * t - 2.5) * t * t + 1.0
    out[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    out[3] = (0.5 * t - 0.5) * t * t


@njit(cache=True, nogil=True, error_model="numpy")
def _cholesky_solve(A, b, x):
    """x of A x = b for a symmetric positive A (6, 6), lower triangle of A overwritten; False where A is not positive."""
    n = A.shape[0]
    for j in range(n):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        if not s > 1e-12:
            return False
        A[j, j] = np.sqrt(s)
        for i in range(j + 1, n):
            t = A[i, j]
            for k in range(j):
                t -= A[i, k] * A[j, k]
            A[i, j] = t / A[j, j]
    _back_substitute(A, b, x)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _back_substitute(L, b, x):
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
def _search(first, end, picture, other, starts, guesses, window, furthest, out):
    """Rows of out: u, v, sigma_u, sigma_v, correlation, and the 2x2 shape; NaN where the search does not settle."""
    H, W = picture.shape
    OH, OW = other.shape
    size = window.shape[0]
    r = size // 2
    n = size * size
    template, seen, weight = np.empty(n), np.empty(n), np.empty(n)
    slopes = np.empty((6, n))
    A, L, b, step, wx, wy = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.empty(6), np.empty(4), np.empty(4)
    for p in range(first, end):
        out[p, :] = np.nan
        cx, cy = int(np.floor(starts[p, 0] + 0.5)), int(np.floor(starts[p, 1] + 0.5))
        if cx - r < 1 or cy - r < 1 or cx + r > W - 2 or cy + r > H - 2:
            continue
        mean, total = 0.0, 0.0
        k = 0
        for j in range(-r, r + 1):
            for i in range(-r, r + 1):
                template[k] = picture[cy + j, cx + i]
                weight[k] = window[j + r, i + r]
                gx = 0.5 * (picture[cy + j, cx + i + 1] - picture[cy + j, cx + i - 1])
                gy = 0.5 * (picture[cy + j + 1, cx + i] - picture[cy + j - 1, cx + i])
                slopes[0, k], slopes[1, k], slopes[2, k] = gx, gx * i, gx * j
                slopes[3, k], slopes[4, k], slopes[5, k] = gy, gy * i, gy * j
                mean += weight[k] * template[k]
                total += weight[k]
                k += 1
        mean /= total
        energy = 0.0
        for k in range(n):
            template[k] -= mean
            energy += weight[k] * template[k] * template[k]
        if not energy > 1e-9:  # nothing to see, or NaN
            continue
        # What a gain or an offset could explain is taken out of the slopes: they then see shape alone.
        for c in range(6):
            m, along = 0.0, 0.0
            for k in range(n):
                m += weight[k] * slopes[c, k]
                along += weight[k] * slopes[c, k] * template[k]
            m /= total
            along /= energy
            for k in range(n):
                slopes[c, k] -= m + along * template[k]
        for c in range(6):
            for d in range(c + 1):
                s = 0.0
                for k in range(n):
                    s += weight[k] * slopes[c, k] * slopes[d, k]
                A[c, d] = s
                A[d, c] = s
        shape_curvature = 0.25 * (A[1, 1] + A[2, 2] + A[4, 4] + A[5, 5])
        for c in (1, 2, 4, 5):
            A[c, c] += DAMPING * shape_curvature
        L[:] = A
        b[:] = 0.0
        if not _cholesky_solve(L, b, step):
            continue
        u, v = guesses[p, 0] + (cx - starts[p, 0]), guesses[p, 1] + (cy - starts[p, 1])
        u0, v0 = u, v
        a11, a12, a21, a22 = 1.0, 0.0, 0.0, 1.0
        settled, last, correlation, gain, rest = False, False, 0.0, 1.0, 0.0
        for turn in range(STEPS + 1):
            inside = True
            k = 0
            for j in range(-r, r + 1):
                for i in range(-r, r + 1):
                    x, y = u + a11 * i + a12 * j, v + a21 * i + a22 * j
                    if not (x >= 1.0 and y >= 1.0 and x < OW - 2 and y < OH - 2):
                        inside = False
                        break
                    x0, y0 = int(np.floor(x)), int(np.floor(y))
                    _cubic(x - x0, wx)
                    _cubic(y - y0, wy)
                    s = 0.0
                    for m in range(4):
                        row = other[y0 - 1 + m]
                        s += wy[m] * (wx[0] * row[x0 - 1] + wx[1] * row[x0] + wx[2] * row[x0 + 1] + wx[3] * row[x0 + 2])
                    seen[k] = s
                    k += 1
                if not inside:
                    break
            if not inside:
                break
            other_mean, cross, other_energy = 0.0, 0.0, 0.0
            for k in range(n):
                other_mean += weight[k] * seen[k]
            other_mean /= total
            for k in range(n):
                seen[k] -= other_mean
                cross += weight[k] * seen[k] * template[k]
                other_energy += weight[k] * seen[k] * seen[k]
            if not cross > 0.0:
                break
            correlation = cross / np.sqrt(energy * other_energy)
            gain = cross / energy
            if last:
                rest = other_energy / (gain * gain) - energy
                settled = True
                break
            for c in range(6):
                s = 0.0
                for k in range(n):
                    s += weight[k] * slopes[c, k] * seen[k]
                b[c] = s / gain
            _back_substitute(L, b, step)
            # The step moves the template; its inverse goes under the warp found so far.
            d11, d12, d21, d22 = 1.0 + step[1], step[2], step[4], 1.0 + step[5]
            det = d11 * d22 - d12 * d21
            if not abs(det) > 0.1:
                break
            i11, i12, i21, i22 = d22 / det, -d12 / det, -d21 / det, d11 / det
            tx, ty = -(i11 * step[0] + i12 * step[3]), -(i21 * step[0] + i22 * step[3])
            u, v = u + a11 * tx + a12 * ty, v + a21 * tx + a22 * ty
            a11, a12, a21, a22 = a11 * i11 + a12 * i21, a11 * i12 + a12 * i22, a21 * i11 + a22 * i21, a21 * i12 + a22 * i22
            if not (abs(u - u0) <= furthest and abs(v - v0) <= furthest):
                break
            last = step[0] * step[0] + step[3] * step[3] < SETTLED_PX * SETTLED_PX or turn == STEPS - 1
        if not settled:
            continue
        # The window's own noise and curvature say how far the answer may be off.
        noise = max(rest, 0.0) / total
        out[p, 0], out[p, 1], out[p, 4] = u, v, correlation
        for c in (0, 3):
            b[:] = 0.0
            b[c] = 1.0
            _back_substitute(L, b, step)
            out[p, 2 + c // 3] = np.sqrt(noise * step[c])
        out[p, 5], out[p, 6], out[p, 7], out[p, 8] = a11, a12, a21, a22


def gaussian_window(radius: int) -> Float64:
    """(2 radius + 1, same) weights that fall to a tenth at the rim."""
    x = np.arange(-radius, radius + 1) / (radius / 2.15)
    return np.exp(-0.5 * (x[:, None] ** 2 + x[None, :] ** 2))


def search_points(picture: Float32, other: Float32, starts: Float64, guesses: Float64, *, radius: int, furthest_px: float) -> Float64:
    """Where the windows about `starts` of `picture`, moved to whole pixels, lie in `other`, searched from `guesses`.

    starts, guesses : (n, 2) pixels (u, v).
    Returns (n, 9): u, v in `other` of the whole pixel next to each start, sigma_u, sigma_v (px, from each window's own noise), correlation,
    and the window's shape a11 a12 a21 a22; NaN where the search leaves the picture, strays beyond `furthest_px` or sees nothing.
    """
    out = np.full((len(starts), 9), np.nan)
    window = gaussian_window(radius)
    starts, guesses = np.ascontiguousarray(starts, np.float64), np.ascontiguousarray(guesses, np.float64)
    in_row_blocks(
        lambda first, end: _search(first, end, picture, other, starts, guesses, window, float(furthest_px), out), len(starts), block_rows=BLOCK_POINTS
    )
    return out
