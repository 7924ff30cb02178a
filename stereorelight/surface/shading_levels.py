"""The sizes at which shading and disparity are brought together: a pyramid that never mixes two surfaces.

In: the plate, v = -log Z with its standard deviation, and normals with theirs, on the pixels of a camera.  Out: a `Level` for each
size, finest first.  A cell lies between four pixels; arrays of cells have the size of their picture, with a last row and column that
count nothing.  Where a block of pixels holds a depth edge, the pixel made of it is broken and joined to nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.camera import Camera
from stereorelight.surface.plate_light import Labels, grey_log, materials
from stereorelight.surface.position import ray_slopes

f4 = np.float32

SMALLEST_SIZE = (16, 56)  # height and width below which there is no coarser level
STEEPEST = 5.0  # slope beyond which neighbouring pixels are of two surfaces (79 deg)
EDGE_SIGMAS = 3.0  # and what noise may add to it
CORRELATED_PX = 12.0  # distance over which errors of a disparity become others: measured, see docs/shading.md
LEAST_N_SIGMA = 0.5  # degrees
OUTLINE_SHARE = 1 / 320  # of the width: over so much to either side ...
OUTLINE_STEEP = 2.5  # ... no surface falls so steeply (68 deg): an outline, where shading is farther off than disparity


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One size of the picture, each half the one before; every array (H, W) of that size.

    scale, focal  : pixels of the plate to one of this level; focal length in pixels of this level.
    v, variance   : -log Z as measured, and its variance.
    du, dv, turned: slopes of v by pixels as the given normals have them, on cells; the variance of their slopes by rays.
    colour, grey  : the plate, and the log of the mean of its channels.   usable : 1 where plate and depth may be used.
    labels, count : material of each pixel, and how many materials there are at all.   colours : (count, 2) log chromaticity of each.
    rays          : (6, H, W), see engine/shading.py.
    okx, oky, okc : 1 where a pixel is joined to its right, to its lower neighbour, where a whole cell is joined; else 0.
    broken        : pixels that hold a depth edge.
    """

    scale: int
    focal: float
    v: Float32
    variance: Float32
    du: Float32
    dv: Float32
    turned: Float32
    grey: Float32
    colour: Float32
    usable: Float32
    labels: Labels
    count: int
    colours: Float64
    rays: Float32
    okx: Float32
    oky: Float32
    okc: Float32
    broken: Bool

    @cached_property
    def clear(self) -> Float32:
        """0 on depth edges to 1 well away from them: outlines are dark or rim-lit for reasons of their own, and mixed with what lies behind."""
        r = max(round(OUTLINE_SHARE * self.v.shape[1]), 1)
        fall = ndimage.maximum_filter(self.v, 2 * r + 1) - ndimage.minimum_filter(self.v, 2 * r + 1)
        edge = fall * f4(self.focal / (2 * r + 1)) > OUTLINE_STEEP
        far = ndimage.distance_transform_edt(~edge) if edge.any() else np.full(edge.shape, r)
        t = np.clip(far / r, 0, 1).astype(np.float32)
        return t * t * (3 - 2 * t)

    @property
    def cells(self) -> Labels:
        """Material of each cell, -1 where its four pixels differ, are not one surface, or may not be used."""
        a = self.labels
        out = np.full(a.shape, -1, np.int16)
        same = (a[:-1, :-1] == a[1:, :-1]) & (a[:-1, :-1] == a[:-1, 1:]) & (a[:-1, :-1] == a[1:, 1:]) & (self.okc[:-1, :-1] > 0)
        use = self.usable >= 1
        same &= use[:-1, :-1] & use[1:, :-1] & use[:-1, 1:] & use[1:, 1:]
        out[:-1, :-1] = np.where(same, a[:-1, :-1], -1)
        return out


def half(a: npt.NDArray[np.floating]) -> Float32:
    h, w = a.shape[0] // 2 * 2, a.shape[1] // 2 * 2
    mean: Float32 = (a[0:h:2, 0:w:2] + a[1:h:2, 0:w:2] + a[0:h:2, 1:w:2] + a[1:h:2, 1:w:2]) * f4(0.25)
    return np.ascontiguousarray(mean, dtype=np.float32)


def twice(a: Float32, shape: tuple[int, int]) -> Float32:
    """`a` at twice its size (bilinear, pixel edges kept), its last row and column repeated to `shape`."""
    h, w = a.shape
    p = np.pad(a, 1, mode="edge")
    rows = np.empty((2 * h, w + 2), np.float32)
    rows[0::2] = f4(0.75) * p[1:-1] + f4(0.25) * p[:-2]
    rows[1::2] = f4(0.75) * p[1:-1] + f4(0.25) * p[2:]
    out = np.empty((2 * h, 2 * w), np.float32)
    out[:, 0::2] = f4(0.75) * rows[:, 1:-1] + f4(0.25) * rows[:, :-2]
    out[:, 1::2] = f4(0.75) * rows[:, 1:-1] + f4(0.25) * rows[:, 2:]
    return np.pad(out, ((0, shape[0] - 2 * h), (0, shape[1] - 2 * w)), mode="edge")


def _blocks(a: Float32, k: int) -> Float32:
    """Means over k x k blocks, the last ones padded by zeros."""
    if k == 1:
        return a
    ph, pw = -a.shape[0] % k, -a.shape[1] % k
    p = np.pad(a, ((0, ph), (0, pw)))
    means: Float32 = p.reshape(p.shape[0] // k, k, p.shape[1] // k, k).mean(axis=(1, 3), dtype=np.float32)
    return means


def _stretched(a: Float32, k: int, shape: tuple[int, int]) -> Float32:
    """Block means back to `shape`, bilinear between the centres of blocks."""
    if k == 1:
        return a
    for axis in (0, 1):
        t = np.clip((np.arange(shape[axis]) + 0.5) / k - 0.5, 0, a.shape[axis] - 1)
        i = np.minimum(t.astype(np.int64), max(a.shape[axis] - 2, 0))
        f = (t - i).astype(np.float32)
        f = f[:, None] if axis == 0 else f[None, :]
        a = np.take(a, i, axis) * (1 - f) + np.take(a, np.minimum(i + 1, a.shape[axis] - 1), axis) * f
    return np.ascontiguousarray(a, dtype=np.float32)


def around(a: Float32, weight: Float32, sigma: float) -> Float32:
    """Weighted mean of `a` over its surroundings of `sigma` pixels."""
    k = max(1, int(sigma / 3))
    top, low = (ndimage.gaussian_filter(_blocks(x, k), sigma / k, mode="constant", truncate=3.0) for x in (a * weight, weight))
    return _stretched((top / (low + f4(1e-6))).astype(np.float32), k, (a.shape[0], a.shape[1]))


def typical(a: Float32, weight: Float32, sigma: float) -> Float32:
    """A mean of |a| around each pixel that a few large values do not move: clipped at twice itself, three times."""
    size = np.abs(a)
    mean = around(size, weight, sigma)
    for _ in range(2):
        mean = around(np.minimum(size, 2 * mean), weight, sigma)
    return mean


def cells_of(a: Float32) -> Float32:
    """Means of four pixels, on the grid of cells; the last row and column are 0."""
    out = np.zeros_like(a)
    out[:-1, :-1] = (a[:-1, :-1] + a[1:, :-1] + a[:-1, 1:] + a[1:, 1:]) * f4(0.25)
    return out


def _step(a: Float32, axis: int) -> Float32:
    """What `a` grows by from pixel to pixel along an axis."""
    step: Float32 = np.gradient(a.astype(np.float64), axis=axis).astype(np.float32)
    return step


def _cell_rays(x: Float32, y: Float32) -> Float32:
    """(6, H, W): ray slopes of each cell, and what turns derivatives by pixels into derivatives by ray slopes."""
    out = np.zeros((6, *x.shape), np.float32)
    X, Y = x.astype(np.float64), y.astype(np.float64)

    def across(a: Float64) -> Float64:
        d = np.diff(a, axis=1)
        return (d[1:] + d[:-1]) / 2

    def down(a: Float64) -> Float64:
        d = np.diff(a, axis=0)
        return (d[:, 1:] + d[:, :-1]) / 2

    xu, xv, yu, yv = across(X), down(X), across(Y), down(Y)
    det = xu * yv - xv * yu
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = np.where(np.abs(det) > 0, 1 / det, 0.0)
    for k, a in enumerate((X, Y)):
        out[k, :-1, :-1] = (a[:-1, :-1] + a[1:, :-1] + a[:-1, 1:] + a[1:, 1:]) / 4
    for k, a in enumerate((yv, -yu, -xv, xu), 2):
        out[k, :-1, :-1] = a * inverse
    return np.nan_to_num(out, nan=0.0)


def _links(v: Float32, sigma: Float32, focal: float, broken: Bool) -> tuple[Float32, Float32, Float32]:
    """Which neighbours are of one surface: neither steeper than any surface, nor farther apart than the noise explains."""
    okx, oky, okc = (np.zeros(v.shape, np.float32) for _ in range(3))
    limit = f4(STEEPEST / focal) + f4(EDGE_SIGMAS) * sigma
    okx[:, :-1] = (np.abs(v[:, 1:] - v[:, :-1]) < limit[:, :-1]) & ~broken[:, 1:] & ~broken[:, :-1]
    oky[:-1] = (np.abs(v[1:] - v[:-1]) < limit[:-1]) & ~broken[1:] & ~broken[:-1]
    okc[:-1, :-1] = okx[:-1, :-1] * okx[1:, :-1] * oky[:-1, :-1] * oky[:-1, 1:]
    return okx, oky, okc


def _slopes(N: Float32, N_sigma: Float32, sigma: Float32, focal: float, x: Float32, y: Float32) -> tuple[Float32, Float32, Float32]:
    """Slopes p, q of v along the ray slopes that normals say, and their variance; where they say nothing, 0, 0 and a large one."""
    facing = N[..., 2] - x * N[..., 0] + y * N[..., 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        s = 1 / np.maximum(facing, f4(1 / STEEPEST))
        p, q = -N[..., 0] * s, N[..., 1] * s
        steep = 1 + p * p + q * q
        own = np.radians(np.maximum(N_sigma, f4(LEAST_N_SIGMA))) * steep
        # What windows say of their own normals and what the depth's doubt says of slopes are each off by half, and not in the same places.
        variance = own * np.maximum(sigma * f4(math.sqrt(2) * focal / CORRELATED_PX), f4(1e-6))
    sure = np.isfinite(p) & np.isfinite(q) & np.isfinite(variance)

    def where_sure(a: Float32, other: float) -> Float32:
        return np.where(sure, a, f4(other)).astype(np.float32)

    return where_sure(p, 0.0), where_sure(q, 0.0), where_sure(variance, 1e4)


def levels_of(
    plate: Float32,
    v: Float32,
    sigma: Float32,
    N: Float32,
    N_sigma: Float32,
    usable: Bool,
    known: Bool,
    camera: Camera,
    colours: Float64 | None = None,
) -> list[Level]:
    """Every size, finest first.

    sigma : standard deviation of v; N_sigma: degrees.   usable, known : where the plate, where Z may be used.   colours : as `materials` takes them.
    """
    rays = np.nan_to_num(ray_slopes(camera)).astype(np.float32)
    x, y = np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])
    scale, broken = 1, ~known
    p, q, turned = _slopes(N, N_sigma, sigma, camera.fx, x, y)
    variance, use = (sigma * sigma).astype(np.float32), usable.astype(np.float32)
    colour = plate
    labels: Labels | None = None
    own: Float64 = np.zeros((0, 2))
    levels: list[Level] = []
    while True:
        focal = camera.fx / scale
        okx, oky, okc = _links(v, np.sqrt(variance), focal, broken)
        if labels is None:
            labels, own = materials(colour, ndimage.minimum_filter(okc, 3) > 0, colours)
        levels.append(
            Level(
                scale=scale,
                focal=focal,
                v=v,
                variance=variance,
                grey=grey_log(colour),
                colour=colour,
                usable=use,
                labels=labels,
                count=len(own),
                colours=own,
                rays=_cell_rays(x, y),
                du=cells_of(p * _step(x, 1) + q * _step(y, 1)),
                dv=cells_of(p * _step(x, 0) + q * _step(y, 0)),
                turned=cells_of(turned),
                okx=okx,
                oky=oky,
                okc=okc,
                broken=broken,
            )
        )
        h, w = v.shape
        if h // 2 < SMALLEST_SIZE[0] or w // 2 < SMALLEST_SIZE[1]:
            return levels
        broken = ~(okc[0 : h // 2 * 2 : 2, 0 : w // 2 * 2 : 2] > 0)
        v, variance, use, x, y, p, q, turned = (half(a) for a in (v, variance, use, x, y, p, q, turned))
        colour = half(colour)
        labels = np.ascontiguousarray(labels[1 : h // 2 * 2 : 2, 1 : w // 2 * 2 : 2])
        scale *= 2
