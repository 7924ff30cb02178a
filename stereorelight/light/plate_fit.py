"""The numbers behind light/estimate.py: light fitted to log brightness, materials' own brightness left free.

In: small pictures as lists of pixels.  Out: coefficients, costs.  Model: log I = a_m + log(B(N) c + s S), with a_m one number for each
material, B the nine quadratics of a normal (Ramamoorthi and Hanrahan 2001: what distant light makes of a Lambert surface, to a per cent),
and S what one lamp makes of it: its cosine, its distance, its shadow.  Solved by Gauss-Newton with weights that let go of what is
far off: highlights, shadows that the depth does not know, stains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float64
from stereorelight.light.spherical_harmonics import TERMS, basis

FLOOR = 0.02  # of the mean irradiance: darker than that is told by nothing
ALIKE = 4.0  # small pixels of one texture: so many say what one does
LOOSE = np.array([0.0, 1.0, 1.0, 1.0, 0.35, 0.35, 0.35, 0.35, 0.35])  # how far each term may be expected to go, of the first
APART = 0.25  # of log chromaticity: closer colours are one material
MOST_MATERIALS = 8
FINEST = 0.02  # of log brightness: no model of a real plate is nearer
FEWEST, PATCH = 40, 16  # pixels of a material, and of one patch of it: less says nothing

Whole = npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Pixels:
    """n believed pixels of a small picture.

    logs  : (n, 4) log of red, green, blue and of their mean.     N : (n, 3) unit.     P : (n, 3) metres, or None.
    weight: (n,).     label : (n,) material, from 0.     block : (n,) which block of the picture.     at : (n,) place in the small picture.
    """

    logs: Float64
    N: Float64
    P: Float64 | None
    weight: Float64
    label: Whole
    block: Whole
    at: Whole

    def part(self, kept: Bool) -> Pixels:
        return replace(
            self, logs=self.logs[kept], N=self.N[kept], P=None if self.P is None else self.P[kept], weight=self.weight[kept],
            label=self.label[kept], block=self.block[kept], at=self.at[kept],
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """c (9,) and s of the model; a (materials,); the robust spread of what is left over; and the cost, lower is better."""

    c: Float64
    s: float
    a: Float64
    spread: float
    cost: float


def spread_of(r: Float64) -> float:
    """Robust standard deviation about the median."""
    return 1.4826 * float(np.median(np.abs(r - np.median(r)))) + 1e-6 if r.size else 1e-6


def surprise(r: Float64, scale: float) -> Float64:
    """What each of r costs under a law with long tails (Cauchy's), up to a constant: costs of different scales compare."""
    found: Float64 = np.log(scale) + np.log1p((r / scale) ** 2)
    return found


def materials_of(chroma: Float64, weight: Float64, surface: Whole, at: Whole, shape: tuple[int, int]) -> tuple[Whole, Whole]:
    """(n,) labels by chromaticity (n, 2) on each surface (n,), finely and coarsely; -1 where too few pixels are alike.

    Finely, a patch of one colour, at `at` (n,) in a picture of `shape`, is a material of its own where it is large enough to tell
    shading by itself: two patches of a colour may still be of two brightnesses.  Coarsely they are one: where normals are noisy, what
    little a patch tells by itself is noise, and brightness from patch to patch tells more."""
    step = APART / 5
    low = np.percentile(chroma, 0.5, axis=0) - step
    cells = np.clip(np.floor((chroma - low) / step).astype(np.int64), 0, 199)
    size = cells.max(axis=0) + 1
    counts = np.bincount(cells[:, 0] * size[1] + cells[:, 1], weights=weight, minlength=int(size.prod())).reshape(size)
    counts = ndimage.gaussian_filter(counts, 1.0, mode="constant")
    y, x = np.mgrid[: size[0], : size[1]]
    centres: list[Float64] = []
    while len(centres) < MOST_MATERIALS and counts.max() > 0.5:
        i, j = divmod(int(counts.argmax()), int(size[1]))
        centres.append(low + (np.array([i, j]) + 0.5) * step)
        counts[np.hypot(y - i, x - j) * step < APART] = 0
    kind = ((chroma[:, None] - np.array(centres)) ** 2).sum(-1).argmin(-1)
    alike = surface * MOST_MATERIALS + kind
    picture = np.full(shape, -1, np.int64)
    picture.reshape(-1)[at] = alike
    patch = np.zeros(shape, np.int64)
    for value in np.unique(alike):
        found, _ = ndimage.label(picture == value)
        patch += np.where(found > 0, found + patch.max(), 0)
    own = patch.reshape(-1)[at]
    sizes = np.bincount(own)
    both = np.where(sizes[own] >= PATCH, own + int(alike.max()) + 1, alike)
    return _numbered(both, sizes[own] >= PATCH), _numbered(alike, np.zeros(len(alike), np.bool_))


def _numbered(names: Whole, patch: Bool) -> Whole:
    """(n,) labels from 0 for `names` (n,), -1 where there are too few of one; a `patch` (n,) may be smaller."""
    _, label, count = np.unique(names, return_inverse=True, return_counts=True)
    label = label.reshape(-1)
    kept = count >= np.where(np.bincount(label, weights=patch) > 0, PATCH, FEWEST)
    renamed: Whole = np.where(kept, np.cumsum(kept) - 1, -1)
    return renamed[label]


def _means(values: Float64, weight: Float64, label: Whole, count: int) -> Float64:
    """(count,) or (count, k) weighted means of the materials."""
    total = np.bincount(label, weights=weight, minlength=count) + 1e-12
    if values.ndim == 1:
        return np.asarray(np.bincount(label, weights=weight * values, minlength=count) / total)
    return np.stack([np.bincount(label, weights=weight * v, minlength=count) for v in values.T], axis=1) / total[:, None]


def fit(
    pixels: Pixels, lamp: Float64 | None, *, start: Fit | None = None, channel: int = 3, terms: int = TERMS, rounds: int = 8, hold: float = 1.0
) -> Fit:
    """The model on `pixels`, whose S is `lamp` (n,), None for none; `terms` of the quadratics take part.

    hold : how strongly the terms are held to what may be expected of them.
    """
    L, w, label = pixels.logs[:, channel], pixels.weight, pixels.label
    count = int(label.max()) + 1
    B = basis(pixels.N)[:, :terms] / basis(np.array([[0.0, 0.0, 1.0]]))[0, 0]
    X = B if lamp is None else np.column_stack([B, lamp])
    k = X.shape[1]
    theta = np.zeros(k)
    theta[0] = 1.0
    if lamp is not None:
        theta[terms] = 1.0
    if start is not None:
        theta[:terms] = start.c[:terms]
        if lamp is not None:
            theta[terms] = max(start.s, 1e-3)
    loose = np.concatenate([LOOSE[:terms], [np.inf]])[:k]
    n_eff = w.sum() / ALIKE

    def left(t: Float64, robust: Float64) -> tuple[Float64, Float64, Float64, Float64]:
        raw = X @ t
        E = np.maximum(raw, FLOOR * max(float(np.abs(raw).mean()), 1e-9))
        r = L - np.log(E)
        a = _means(r, w * robust, label, count)
        return r - a[label], E, a, raw

    def cost_of(r: Float64, scale: float, t: Float64) -> float:
        data = float((w * np.log1p((r / scale) ** 2)).sum()) / w.sum() * n_eff
        prior = float(((t[1:terms] / (max(abs(t[0]), 1e-6) * loose[1:terms])) ** 2).sum()) * hold
        return data + prior

    robust = np.ones(len(L))
    r, E, a, raw = left(theta, robust)
    scale = spread_of(r)
    for _ in range(rounds):
        robust = 1 / (1 + (r / (2 * scale)) ** 2) ** 2
        r, E, a, raw = left(theta, robust)
        q = w * robust
        J = X / E[:, None] * (raw >= E)[:, None]
        J = J - _means(J, q, label, count)[label]
        A = (J * q[:, None]).T @ J / ALIKE / scale**2
        g = (J * q[:, None]).T @ r / ALIKE / scale**2
        prior = np.zeros(k)
        prior[1:terms] = hold / (max(abs(theta[0]), 1e-6) * loose[1:terms]) ** 2
        # The strength of everything together is no part of the model: the materials take it.
        A += np.diag(prior) + 1e-6 * np.trace(A) / k * np.eye(k)
        step = np.linalg.solve(A, g - prior * theta)
        before = cost_of(r, scale, theta)
        for _ in range(5):
            t = theta + step
            t[0] = max(t[0], 1e-3)
            if lamp is not None:
                t[terms] = max(t[terms], 0.0)
            r_new, E, a, raw = left(t, robust)
            if cost_of(r_new, scale, t) < before:
                theta, r = t, r_new
                break
            step = step / 2
        else:
            break
        scale = max(spread_of(r), 0.3 * scale)
        theta = theta / max(float((X @ theta).mean()), 1e-9)
    r, E, a, raw = left(theta, robust)
    scale = max(spread_of(r), FINEST)
    prior_cost = float(((theta[1:terms] / (max(abs(theta[0]), 1e-6) * loose[1:terms])) ** 2).sum()) * hold
    cost = n_eff * float(np.average(surprise(r, scale), weights=w)) + prior_cost
    c = np.zeros(TERMS)
    c[:terms] = theta[:terms]
    return Fit(c=c, s=float(theta[terms]) if lamp is not None else 0.0, a=a, spread=spread_of(r), cost=cost)


def left_over(pixels: Pixels, lamp: Float64 | None, found: Fit, *, channel: int = 3) -> Float64:
    """(n,) log brightness less what the fit says of it."""
    X = basis(pixels.N) / basis(np.array([[0.0, 0.0, 1.0]]))[0, 0]
    raw = X @ found.c + (0.0 if lamp is None else found.s * lamp)
    E = np.maximum(raw, FLOOR * max(float(np.abs(raw).mean()), 1e-9))
    rest: Float64 = pixels.logs[:, channel] - np.log(E) - found.a[np.minimum(pixels.label, len(found.a) - 1)]
    return rest


def gain_by_blocks(pixels: Pixels, null: Float64, told: Float64) -> tuple[float, float]:
    """How much better `told` (n,) fits than `null` (n,), both on ground that had no part in them, and the standard error of that over blocks."""
    better = surprise(null, max(spread_of(null), FINEST)) - surprise(told, max(spread_of(told), FINEST))
    blocks, at = np.unique(pixels.block, return_inverse=True)
    share = np.bincount(at.reshape(-1), weights=pixels.weight)
    mean = np.bincount(at.reshape(-1), weights=pixels.weight * better) / np.maximum(share, 1e-9)
    whole = float((share * mean).sum() / share.sum())
    if len(blocks) < 3:
        return whole, float("inf")
    error = float(np.sqrt((share**2 * (mean - whole) ** 2).sum()) / share.sum())
    return whole, error
