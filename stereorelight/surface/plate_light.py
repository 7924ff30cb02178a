"""The light that the plate was shot in, as its own surfaces show it: second-order spherical harmonics for each material.

In: the plate (scene-linear), normals N (scene frame) known roughly, and how far to believe each pixel.
Out: a `PlateLight`: a material for each pixel, and for each material nine coefficients and how much of the plate they explain.

A Lambertian surface under any distant light has a radiance that is a quadratic in its normal to within a percent (Ramamoorthi and
Hanrahan 2001).  What a material's own colour does slowly across it, and what a near light does, is left out of the fit: only what
changes over less than some `local_share` of the frame counts, since that is what shading is asked about.
Blocks of the picture that had no part in the fit say how much is explained: callers judge by it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.surface.cast_light import least_of, uneven

TERMS = 9
WORK_WIDTH = 160  # the light is smooth over normals: a small picture holds all there is to know
MOST_MATERIALS = 8
APART = 0.25  # of log chromaticity: closer colours are one material
SMALLEST_SHARE = 0.002  # of the frame: less ground than that says nothing about light
QUIET_PX = 5  # over which colours are averaged
FEWEST = 120  # pixels of the small picture, likewise
FLOOR = 0.08  # of a material's median radiance: shading is not believed below
RIDGE = 0.1  # of the variance that is left: lights are even as far as the plate does not say otherwise
ROUNDS = 6
HELD_OUT_BLOCK = 6  # small pixels: wider than what noise and grain share
LOCAL_SHARE = 0.1  # of the frame's width
DARKEST = 1e-4  # radiance whose logarithm is still taken

Labels = npt.NDArray[np.int16]


def basis(N: npt.NDArray[np.floating]) -> Float64:
    """(..., 9): the quadratics of a unit normal, in the order 1, x, y, z, xy, yz, xz, x2 - y2, 3 z2 - 1."""
    x, y, z = (N[..., k].astype(np.float64) for k in range(3))
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateLight:
    """Light of the plate, times the albedo of each material.

    labels       : (H, W) int16, the material of each pixel; -1 for none.
    coefficients : (M, 9): grey radiance (mean of the channels) of material m at normal N is basis(N) @ coefficients[m].
    floor        : (M,) radiance below which the coefficients are not to be believed.
    residual     : (M,) robust spread of the log brightness that is left over, on blocks that had no part in the fit.
    explained    : (M,) share of the (median) variance of log brightness explained there; 0 or less: nothing.
    """

    labels: Labels
    coefficients: Float64
    floor: Float64
    residual: Float64
    explained: Float64


def shrunk(a: npt.NDArray[np.generic], by: int) -> Float64:
    """Means over `by` x `by` blocks; rows and columns that fill no block are left out."""
    h, w = a.shape[0] // by * by, a.shape[1] // by * by
    total = np.zeros((h // by, w // by, *a.shape[2:]))
    for i in range(by):
        for j in range(by):
            total += a[i:h:by, j:w:by]
    return total / (by * by)


def grey_log(plate: Float32) -> Float32:
    """(H, W) float32: log of the mean of the channels."""
    grey: Float32 = np.log(np.maximum(plate.mean(axis=-1, dtype=np.float32), np.float32(DARKEST)))
    return grey


def log_chroma(plate: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """(H, W, 2): log of red and of blue over green."""
    logs = np.log(np.maximum(plate, np.asarray(DARKEST, plate.dtype)))
    return np.stack([logs[..., 0] - logs[..., 1], logs[..., 2] - logs[..., 1]], axis=-1)


def _centres(chroma: npt.NDArray[np.floating]) -> Float64:
    """(M, 2) log chromaticities of the materials: peaks of the histogram of (n, 2), strongest first."""
    step = APART / 5
    low = np.percentile(chroma, 0.5, axis=0) - step
    cells = np.clip(np.floor((chroma - low) / step).astype(np.int64), 0, 199)
    size = cells.max(axis=0) + 1
    counts = np.bincount(cells[:, 0] * size[1] + cells[:, 1], minlength=int(size.prod())).reshape(size).astype(np.float64)
    counts = ndimage.gaussian_filter(counts, 1.0, mode="constant")
    y, x = np.mgrid[: size[0], : size[1]]
    centres: list[Float64] = []
    while len(centres) < MOST_MATERIALS:
        i, j = divmod(int(counts.argmax()), int(size[1]))
        if counts[i, j] < 1:
            break
        centres.append(low + (np.array([i, j]) + 0.5) * step)
        counts[np.hypot(y - i, x - j) * step < APART] = 0
    return np.array(centres).reshape(-1, 2)


def materials(plate: Float32, joined: Bool, colours: Float64 | None = None) -> tuple[Labels, Float64]:
    """(H, W) int16: pixels alike in chromaticity and on one surface, -1 where too few are alike to say anything; (M, 2) what colour each has.

    joined  : (H, W), False on depth edges and unknown ground, which part the surfaces.
    colours : (K, 2) log chromaticities to tell apart, and nothing is of any other colour; None finds them in the plate.
    """
    h, w = joined.shape
    by = max(1, w // (2 * WORK_WIDTH))
    small = shrunk(plate, by)
    # A colour is that of some ground: one pixel of a small or dark picture is noise.
    chroma = log_chroma(ndimage.uniform_filter(small, (*2 * (max(1, QUIET_PX // by),), 1), mode="nearest"))
    whole = shrunk(joined, by) > 0.75
    labels = np.full((h, w), -1, np.int16)
    none = np.zeros((0, 2))
    if whole.sum() < FEWEST:
        return labels, none
    surface, _ = ndimage.label(whole)
    # Ground on an edge is of the surface beside it that is nearest.
    nearest = ndimage.distance_transform_edt(~whole, return_distances=False, return_indices=True)
    surface = surface[tuple(nearest)]
    centres = _centres(chroma[whole]) if colours is None else colours
    if len(centres) == 0:
        return labels, none
    apart = ((chroma[..., None, :] - centres) ** 2).sum(-1)
    both = surface.astype(np.int64) * len(centres) + apart.argmin(-1)
    if colours is not None:
        both[apart.min(-1) >= APART**2] = -1
        whole &= both >= 0
    kinds, counts = np.unique(both[whole], return_counts=True)
    kept = kinds[counts >= max(SMALLEST_SHARE * whole.size, FEWEST)]
    kept = kept[np.argsort(-counts[np.isin(kinds, kept)], kind="stable")][:24]
    small_labels = np.full(both.shape, -1, np.int16)
    for k, one in enumerate(kept):
        small_labels[both == one] = k
    rows = np.minimum(np.arange(h) // by, small_labels.shape[0] - 1)
    columns = np.minimum(np.arange(w) // by, small_labels.shape[1] - 1)
    return np.ascontiguousarray(small_labels[rows[:, None], columns]), centres[kept % len(centres)]


def _bells(n: int, sigma: float) -> tuple[Float64, Float64]:
    """(m, n): Gaussians about m of n places, a third of sigma apart and cut off at three; (n, m): linear between them."""
    step = max(1, int(sigma / 3))
    knots = np.arange(0, n + step - 1, step)
    apart = np.subtract.outer(knots, np.arange(n))
    bells: Float64 = np.where(np.abs(apart) <= 3 * sigma, np.exp(-0.5 * (apart / sigma) ** 2), 0.0)
    between: Float64 = np.maximum(1 - np.abs(apart.T) / step, 0.0)
    return bells, between


class _Local:
    """Takes out what varies slowly within a material: a - (weighted mean of a around it); a (h, w) or (n, h, w)."""

    def __init__(self, weight: Float64, sigma: float) -> None:
        self.weight = weight
        self.down, self.back_down = _bells(weight.shape[0], sigma)
        across, back_across = _bells(weight.shape[1], sigma)
        self.across, self.back_across = np.ascontiguousarray(across.T), np.ascontiguousarray(back_across.T)
        self.norm: Float64 = self._blurred(weight) + 1e-9

    def _blurred(self, a: Float64) -> Float64:
        knots = self.down @ a @ self.across  # on purpose so few and small that no library runs them on threads
        blurred: Float64 = self.back_down @ knots @ self.back_across
        return blurred

    def __call__(self, a: Float64) -> Float64:
        rest: Float64 = a - self._blurred(a * self.weight) / self.norm
        return rest


def _spread(r: Float64) -> float:
    return 1.4826 * float(np.median(np.abs(r))) + 1e-6 if r.size else 1e-6


def fit_light(
    log_grey: Float64, N: Float64, weight: Float64, radius: float, start: Float64 | None = None, held_out: Bool | None = None
) -> tuple[Float64, float, float]:
    """Coefficients (9,), residual spread and explained share of one material on small pictures (h, w); weight 0 is not of it.

    radius   : of the surroundings whose mean counts for nothing, pixels.
    held_out : blocks that are judged by and not fitted; None judges by what was fitted.
    """
    B = np.ascontiguousarray(np.moveaxis(basis(N), -1, 0))
    L = log_grey
    train = weight if held_out is None else weight * ~held_out
    inside = train > 0
    middle = float(np.exp(np.median(L[weight > 0])))
    floor = FLOOR * middle
    c = middle * np.eye(TERMS)[0] if start is None else start
    robust = np.ones_like(L)
    spread = _spread(_Local(train, radius)(L)[inside])

    def shading(c: Float64) -> Float64:
        raw: Float64 = np.tensordot(c, B, 1)
        return raw

    for _ in range(ROUNDS):
        raw = shading(c)
        S = np.maximum(raw, floor)
        local = _Local(train * robust, radius)
        own = B / S * (raw > floor)
        J = local(own)[:, inside].T
        r = local(L - np.log(S))[inside]
        q = (train * robust)[inside] / (train * robust)[inside].sum()
        # A local fit cannot see the strength of the light: on average it stays what it is.
        level = (own[:, inside] * q).sum(axis=1)
        A = (J * q[:, None]).T @ J + np.outer(level, level) + RIDGE * (spread / middle) ** 2 * uneven()
        c = least_of(A, (J * q[:, None]).T @ (r + J @ c) + level * (level @ c))
        r_all = local(L - np.log(np.maximum(shading(c), floor)))
        spread = _spread(r_all[inside])
        robust = 1 / (1 + (r_all / (2 * spread)) ** 2) ** 2
    judged = weight > 0 if held_out is None else (weight > 0) & held_out
    S = np.maximum(shading(c), floor)
    local = _Local(weight * robust, radius)
    before, after = local(L)[judged], local(L - np.log(S))[judged]
    # By medians: a few pixels beside one corner must not speak for a whole wall.
    explained = 1 - (_spread(after) / _spread(before)) ** 2
    c = c * np.exp(np.average((L - np.log(S))[weight > 0], weights=(weight * robust)[weight > 0]))
    return c, _spread(after), explained


def plate_light(
    plate: npt.ArrayLike, N: npt.ArrayLike, weight: npt.ArrayLike, *, labels: Labels | None = None, local_share: float = LOCAL_SHARE
) -> PlateLight:
    """The light of the plate by its materials.

    plate  : (H, W, 3) scene-linear.   N : (H, W, 3) unit, scene frame; NaN where unknown.
    weight : (H, W) >= 0, how far to believe plate and N: 0 on clipped pixels, depth edges, guesses.
    labels : materials as known; None finds them by chromaticity and by the gaps that weight 0 leaves.
    Raises : PassError for wrong shapes and types.
    """
    p = as_float32(plate, "plate", channels=3)
    size = (p.shape[0], p.shape[1])
    n = as_float32(N, "N", channels=3, size_hw=size)
    believed = np.nan_to_num(as_float32(weight, "weight", size_hw=size), nan=0.0)
    believed = believed * np.isfinite(n).all(axis=-1) * np.isfinite(p).all(axis=-1)
    p, n = np.nan_to_num(p, nan=0.0, posinf=0.0, neginf=0.0), np.nan_to_num(n, nan=0.0)
    if labels is None:
        labels, _ = materials(p, believed > 0)
    return light_of(labels, grey_log(p), n, believed, count=int(labels.max()) + 1, local_share=local_share)


def light_of(
    labels: Labels, log_grey: Float32, N: Float32, weight: Float32, *, count: int, local_share: float = LOCAL_SHARE, only: Bool | None = None
) -> PlateLight:
    """`plate_light` on checked arrays: labels, log of the grey plate, normals, weight >= 0, nowhere NaN.

    count : M, of the materials.
    only  : (M,) the materials wanted, which are fitted as a whole and judged by what was fitted.
    """
    by = max(1, round(labels.shape[1] / WORK_WIDTH))
    radius = local_share * labels.shape[1] / by
    coefficients, floor = np.zeros((count, TERMS)), np.ones(count)
    residual, explained = np.ones(count), np.zeros(count)
    for k in range(count):
        if only is not None and not only[k]:
            continue
        part = weight * (labels == k)
        rows, columns = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
        if rows.size == 0:
            continue
        box = np.s_[rows[0] // by * by : rows[-1] + 1, columns[0] // by * by : columns[-1] + 1]
        part = part[box]
        share = shrunk(part, by)
        if share.size == 0:
            continue
        scale = np.maximum(share, 1e-9)
        L, n = shrunk(log_grey[box] * part, by) / scale, shrunk(N[box] * part[..., None], by)
        length = np.linalg.norm(n, axis=-1)
        w = np.where((share > 0.4 * np.median(share[share > 0])) & (length > 1e-6), share, 0.0) if (share > 0).any() else share
        n /= np.maximum(length, 1e-9)[..., None]
        yy, xx = np.indices(w.shape) // HELD_OUT_BLOCK
        held = (yy + xx) % 2 == 0
        if min((w[held] > 0).sum(), (w[~held] > 0).sum()) < FEWEST / 2:
            continue
        L = np.where(w > 0, L, np.median(L[w > 0]))
        coefficients[k], residual[k], explained[k] = fit_light(L, n, w, radius)
        if only is None:
            judged = [fit_light(L, n, w, radius, start=coefficients[k], held_out=blocks)[1:] for blocks in (held, ~held)]
            residual[k], explained[k] = (float(a) for a in np.mean(judged, axis=0))
        floor[k] = FLOOR * float(np.exp(np.median(L[w > 0])))
    return PlateLight(labels=labels, coefficients=coefficients, floor=floor, residual=residual, explained=explained)
