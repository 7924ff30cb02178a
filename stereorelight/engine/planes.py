"""Plane fits on inverse depth in row-blocked kernels, constant cost whatever the window.

In: inverse depth, ray slopes x and y, weights, all (H, W) float64.  Out: N (H, W, 3) float32, scene frame.
A window's plane w = a x + b y + c comes from running sums of moments.  At every scale each pixel blends the nine windows shifted by
-r, 0 or r that hold it, by how well their planes fit: beside a depth edge or a crease, only windows that do not straddle it count.
Then the scales are blended per pixel.  N_r - N_2r is the noise of scale r where noise rules (it falls by 16 in square from scale to
scale) and the bias of 2r where shape rules (it grows), so its local mean square is least near the best scale.  That needs no model of
the noise, holds for correlated noise as well, and lets the window follow the data: 3x3 for exact depth, 65x65 for bad.

Results do not depend on the number of threads: blocks of rows have a fixed height and every sum a fixed order."""

from __future__ import annotations

import numba
import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.locks import KERNEL_LOCK

BLOCK = 64  # rows a task: high enough that starting the running sums costs little
SUMS = 11
FAST = {"reassoc", "contract", "arcp", "nsz"}  # never nnan: NaN means unknown
BAD = 1e200  # its square overflows to a weight of nothing: residual variance of a window that cannot say
OWN_REACH = 9.0  # three sigma: beyond it the pixel is not of the window's plane
EXACT = 1e-18  # relative residual variance below which a fit is as exact as sums of doubles can tell
SHIFT_PRICE = 1.5  # a shifted window must fit this much better than the centred one
OWN_RISK = 0.5  # what the pixel's own disagreement counts beside its surroundings'
SPIKE = 10.0  # residual variances beyond which a pixel is of no plane around it
SPIKE_RADIUS = 4
BLAME = 64.0  # how many times the fine plane's misfit the coarse one may have before it is to blame
RISE = 4.0  # times the least disagreement of finer scales: more than chance
SMOOTH = 4  # least radius over which disagreement is averaged
ROUNDING = 1e-13  # float32 normals squared: less disagreement than this means nothing
UNJUDGED = 1e-9  # weight of a scale that no coarser one could judge: the last resort
UNJUDGED_RISK = 0.5  # its mean-square error, as good as none: 40 degrees
LAST = 4.0


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _add_row(cols, sign, w, x, y, q):
    """Add (sign 1) or take away (-1) one row's moments, (SUMS, W)."""
    for i in range(w.size):
        k = sign * q[i]
        kx = k * x[i]
        ky = k * y[i]
        kw = k * w[i]
        cols[0, i] += k
        cols[1, i] += kx
        cols[2, i] += ky
        cols[3, i] += kw
        cols[4, i] += kx * x[i]
        cols[5, i] += kx * y[i]
        cols[6, i] += ky * y[i]
        cols[7, i] += kx * w[i]
        cols[8, i] += ky * w[i]
        cols[9, i] += kw * w[i]
        cols[10, i] += sign if q[i] > 0 else 0.0


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _run_row(cols, r, rows):
    """Sums over 2 r + 1 columns of every moment; columns beyond the frame count nothing."""
    w = cols.shape[1]
    for k in range(cols.shape[0]):
        s = 0.0
        for i in range(min(r, w)):
            s += cols[k, i]
        for i in range(w):
            if i + r < w:
                s += cols[k, i + r]
            if i - r - 1 >= 0:
                s -= cols[k, i - r - 1]
            rows[k, i] = s


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _solve_row(s0, sx, sy, sw, sxx, sxy, syy, sxw, syw, sww, count, least, a, b, c, res):
    """Plane and residual variance of each window; res = BAD where the window cannot say."""
    for i in range(a.size):
        inv = 1.0 / s0[i] if s0[i] > 0 else 0.0
        mx = sx[i] * inv
        my = sy[i] * inv
        mw = sw[i] * inv
        xx = sxx[i] * inv - mx * mx
        xy = sxy[i] * inv - mx * my
        yy = syy[i] * inv - my * my
        xw = sxw[i] * inv - mx * mw
        yw = syw[i] * inv - my * mw
        ww = sww[i] * inv - mw * mw
        det = xx * yy - xy * xy
        n = count[i] + 0.5  # whole counts, kept from rounding
        good = n > least and det > 0.02 * xx * yy and det > 0
        inv = 1.0 / det if good else 0.0
        p = (xw * yy - yw * xy) * inv
        s = (yw * xx - xw * xy) * inv
        a[i] = p
        b[i] = s
        c[i] = mw - p * mx - s * my
        left = ww - p * xw - s * yw
        left = left if left > 0 else 0.0
        res[i] = left * n / (n - 3.0) if good else BAD


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _fit(w, x, y, q, r, least, a, b, c, res):
    h, wd = w.shape
    for block in numba.prange((h + BLOCK - 1) // BLOCK):
        y0 = block * BLOCK
        cols = np.zeros((SUMS, wd))
        rows = np.empty((SUMS, wd))
        for v in range(max(0, y0 - r), min(h, y0 + r)):
            _add_row(cols, 1.0, w[v], x[v], y[v], q[v])
        for v in range(y0, min(h, y0 + BLOCK)):
            if v + r < h:
                _add_row(cols, 1.0, w[v + r], x[v + r], y[v + r], q[v + r])
            if v - r - 1 >= 0 and v > y0:
                _add_row(cols, -1.0, w[v - r - 1], x[v - r - 1], y[v - r - 1], q[v - r - 1])
            _run_row(cols, r, rows)
            _solve_row(
                rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7], rows[8], rows[9], rows[10],
                least, a[v], b[v], c[v], res[v],
            )  # fmt: skip


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _take_row(shift, price, w, x, y, a, b, c, res, total, oa, ob, oc, oe):
    """Add the shifted window's plane, weighed by one over the square of its misfit's variance."""
    n = w.size
    for i in range(max(0, -shift), min(n, n - shift)):
        j = i + shift
        own = w[i] - (a[j] * x[i] + b[j] * y[i] + c[j])
        # Noise of the pixel itself must not choose the window; only a pixel that cannot be of the window's plane speaks.
        off = own * own - OWN_REACH * res[j]
        e = res[j] + (off if off > 0 else 0.0) + EXACT
        s = e * price
        k = 1.0 / (s * s)
        total[i] += k
        oa[i] += k * a[j]
        ob[i] += k * b[j]
        oc[i] += k * c[j]
        oe[i] += k * e if k > 0 else 0.0


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _choose(w, x, y, r, a, b, c, res, normals, misfit):
    """Unit scene-frame normals of the nine windows that hold each pixel, the best fitting ones first; NaN where none can say."""
    h, wd = w.shape
    for v in numba.prange(h):
        total = np.zeros(wd)
        oa = np.zeros(wd)
        ob = np.zeros(wd)
        oc = np.zeros(wd)
        oe = np.zeros(wd)
        for j in range(-1, 2):
            u = v + j * r
            if u >= 0 and u < h:
                for i in range(-1, 2):
                    price = SHIFT_PRICE if i != 0 or j != 0 else 1.0
                    _take_row(i * r, price, w[v], x[v], y[v], a[u], b[u], c[u], res[u], total, oa, ob, oc, oe)
        for i in range(wd):
            misfit[v, i] = oe[i] / total[i]
            k = oc[i] + total[i]
            # The plane's own value on this ray must be in front of the camera, or its normal faces away.
            if total[i] > 0 and oa[i] * x[v, i] + ob[i] * y[v, i] + k > 0:
                s = 1.0 / np.sqrt(oa[i] * oa[i] + ob[i] * ob[i] + k * k)
                normals[v, i, 0] = -oa[i] * s
                normals[v, i, 1] = ob[i] * s
                normals[v, i, 2] = k * s
            else:
                normals[v, i, 0] = np.nan
                normals[v, i, 1] = np.nan
                normals[v, i, 2] = np.nan


@numba.njit(cache=True, fastmath=FAST, error_model="numpy")
def _belong_row(shift, w, x, y, a, b, c, res, least):
    """Lower each pixel's `least` squared misfit, in residual variances, to that of the shifted window's plane."""
    n = w.size
    for i in range(max(0, -shift), min(n, n - shift)):
        j = i + shift
        own = w[i] - (a[j] * x[i] + b[j] * y[i] + c[j])
        ratio = own * own / (res[j] + EXACT)
        least[i] = ratio if res[j] < BAD and ratio < least[i] else least[i]


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _without_spikes(w, x, y, q, r, a, b, c, res, out):
    """The weights, 0 where a pixel is of the plane of none of the nine windows that hold it: a spike, and no evidence for others.

    An eighth of a window is enough to be a surface of its own, since it widens the window's own residual: wires stay.
    """
    h, wd = w.shape
    for v in numba.prange(h):
        least = np.full(wd, BAD)
        for j in range(-1, 2):
            u = v + j * r
            if u >= 0 and u < h:
                for i in range(-1, 2):
                    _belong_row(i * r, w[v], x[v], y[v], a[u], b[u], c[u], res[u], least)
        for i in range(wd):
            out[v, i] = 0.0 if least[i] > SPIKE and least[i] < BAD else q[v, i]


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _disagreement(fine, coarse, fine_misfit, coarse_misfit, told, delta, count, blamed):
    """Squared distance of two unit normals, and 1 where both are known; 0 and 0 elsewhere."""
    h, w = delta.shape
    for v in numba.prange(h):
        for i in range(w):
            p = fine[v, i, 0] - coarse[v, i, 0]
            q = fine[v, i, 1] - coarse[v, i, 1]
            s = fine[v, i, 2] - coarse[v, i, 2]
            d = p * p + q * q + s * s
            good = d == d
            # Where the coarse plane fits far worse, it is to blame and not the fine one.
            share = min(1.0, BLAME * (fine_misfit[v, i] + told) / coarse_misfit[v, i])
            delta[v, i] = d * share if good else 0.0
            blamed[v, i] = d * (1.0 - share) if good else 0.0
            count[v, i] = 1.0 if good else 0.0


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _risk(delta, count, blamed, r, floor, least, shape, risk):
    """Local mean of `delta` over (2 r + 1)^2 where known, with the pixel's own beside it; NaN where that is not known.

    Beyond the size of a detail all windows agree again, that there is none.  So what once rose well above the `least` disagreement
    of the finer scales is kept as `shape`, with what a coarse scale is to blame
    for, and no coarser scale comes below it.
    """
    h, w = delta.shape
    for block in numba.prange((h + BLOCK - 1) // BLOCK):
        y0 = block * BLOCK
        cols = np.zeros((2, w))
        rows = np.empty((2, w))
        for v in range(max(0, y0 - r), min(h, y0 + r)):
            for i in range(w):
                cols[0, i] += delta[v, i]
                cols[1, i] += count[v, i]
        for v in range(y0, min(h, y0 + BLOCK)):
            if v + r < h:
                for i in range(w):
                    cols[0, i] += delta[v + r, i]
                    cols[1, i] += count[v + r, i]
            if v - r - 1 >= 0 and v > y0:
                for i in range(w):
                    cols[0, i] -= delta[v - r - 1, i]
                    cols[1, i] -= count[v - r - 1, i]
            _run_row(cols, r, rows)
            for i in range(w):
                mean = max(rows[0, i], 0.0) / max(rows[1, i], 1.0)
                if count[v, i] > 0:
                    d = mean + OWN_RISK * delta[v, i] + floor
                    risk[v, i] = max(d, shape[v, i])
                    shape[v, i] = max(shape[v, i], d - RISE * least[v, i], blamed[v, i])
                    least[v, i] = min(least[v, i], d)
                else:
                    risk[v, i] = np.nan


@numba.njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _blend(normals, risk, size, total, weight, expected, sizes):
    """Add a scale's normals, weighed by one over the risk squared, those weights, and the risks and the scale's `size` so weighed."""
    h, w = risk.shape
    for v in numba.prange(h):
        for i in range(w):
            if normals[v, i, 2] == normals[v, i, 2]:
                k = 1.0 / (risk[v, i] * risk[v, i]) if risk[v, i] == risk[v, i] else UNJUDGED
                total[v, i, 0] += k * normals[v, i, 0]
                total[v, i, 1] += k * normals[v, i, 1]
                total[v, i, 2] += k * normals[v, i, 2]
                weight[v, i] += k
                expected[v, i] += k * risk[v, i] if risk[v, i] == risk[v, i] else k * np.float64(UNJUDGED_RISK)
                sizes[v, i] += k * size


def _least_count(r: int) -> float:
    """Pixels that a window must hold to be believed: a quarter of it, as at a corner of the frame, and more than a plane needs."""
    return max(5.0, 0.25 * (2 * r + 1) ** 2)


def _noise_floor(r: int, noise: float, rays: Float64, inverse: Float64) -> float:
    """Mean-square angle that white noise of this size leaves in a window's normal, at the picture's median depth."""
    if noise == 0:
        return ROUNDING
    pitch = float(np.nanmedian(np.abs(np.diff(rays[..., 0], axis=1))))
    k = 2 * r + 1
    slope_variance = 12 * noise**2 / (k * k * (k * k - 1) * pitch**2)
    return ROUNDING + float(2 * slope_variance / np.nanmedian(inverse) ** 2)


def plane_normals(inverse: Float64, rays: Float64, weight: Float64, radii: tuple[int, ...], noise: float) -> tuple[Float32, Float32, Float32]:
    """N (H, W, 3) float32, scene frame, facing the camera, its expected error (H, W), radians, and the half-width (H, W) of the windows
    that it comes from, px; NaN where `inverse` is, or where no window can say.  The error is the root of the blended scales' risk: how far
    windows of one size disagree with the next.

    inverse : (H, W), 1/Z or anything proportional to it, NaN where unknown.   rays : (H, W, 2) x/z and y/z.
    weight  : (H, W) >= 0.   radii : growing half-widths, two or more.   noise : standard deviation that `inverse` has at least.
    """
    h, w = inverse.shape
    known = np.isfinite(inverse) & np.isfinite(rays).all(axis=-1)
    if not known.any():
        nothing = np.full((h, w), np.nan, dtype=np.float32)
        return np.full((h, w, 3), np.nan, dtype=np.float32), nothing, nothing.copy()
    q = np.where(known & (weight > 0), weight, 0.0)
    x, y = (np.where(known, rays[..., k], 0.0) for k in (0, 1))
    w0 = float(inverse[known].mean())
    centred = np.where(known, inverse / w0 - 1.0, 0.0)  # free of units, and small numbers keep the running sums exact
    a, b, c, res, delta, count, blamed, risk, misfit = (np.empty((h, w)) for _ in range(9))
    least, shape = np.full((h, w), np.inf), np.zeros((h, w))
    total, blended, expected, sizes = np.zeros((h, w, 3)), np.zeros((h, w)), np.zeros((h, w)), np.zeros((h, w))
    fine: Float32 | None = None
    with KERNEL_LOCK:
        _fit(centred, x, y, q, SPIKE_RADIUS, _least_count(SPIKE_RADIUS), a, b, c, res)
        clean = np.empty_like(q)
        _without_spikes(centred, x, y, q, SPIKE_RADIUS, a, b, c, res, clean)
        for k, r in enumerate(radii):
            _fit(centred, x, y, clean, r, _least_count(r), a, b, c, res)
            coarse = np.empty((h, w, 3), dtype=np.float32)
            coarse_misfit = np.empty((h, w))
            _choose(centred, x, y, r, a, b, c, res, coarse, coarse_misfit)
            if fine is not None:
                _disagreement(fine, coarse, misfit, coarse_misfit, (noise / w0) ** 2, delta, count, blamed)
                before = risk.copy()
                floor = _noise_floor(radii[k - 1], noise, rays, inverse)
                _risk(delta, count, blamed, max(radii[k - 1], SMOOTH), floor, least, shape, risk)
                _blend(fine, risk, np.log(radii[k - 1]), total, blended, expected, sizes)
            fine, misfit = coarse, coarse_misfit
        # Nothing coarser judges the last scale.  Noise falls by 16 from scale to scale; what fell less is shape, and weighs four times more there.
        excess = LAST * np.fmax(risk - before / 12 if len(radii) > 2 else risk, 0)
        last = np.fmax(excess, shape) + risk / 16 + _noise_floor(radii[-1], noise, rays, inverse)
        _blend(fine, last, np.log(radii[-1]), total, blended, expected, sizes)
    with np.errstate(invalid="ignore", divide="ignore"):
        total /= np.sqrt((total * total).sum(axis=-1, keepdims=True))
        error, radius = np.sqrt(expected / blended), np.exp(sizes / blended)
    total[~known] = np.nan
    error[np.isnan(total[..., 2])] = radius[np.isnan(total[..., 2])] = np.nan
    return np.ascontiguousarray(total, dtype=np.float32), error.astype(np.float32), radius.astype(np.float32)
