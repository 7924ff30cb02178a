"""A truth of another resolution, or a crop or overscan of the plate: where its pixels lie on the result's, and its values there.

In: two maps (H, W) of one view.  Out: a `Placement`, and the values of one at the pixels of the other.  Pixel edges stay when a
picture is resized: u_truth = (u + 0.5) s + offset - 0.5.  Two surfaces are never mixed when a value is read between pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.errors import PassError

APART = 0.03  # of 1 / Z: pixels that differ by more are two surfaces
COARSE_PX = 320  # width at which a crop is looked for
OVERLAP = 0.4  # of the smaller picture that must lie on the larger
LEAST_MATCH = 0.7  # correlation of the two depths that a crop needs; results with 10 % of mistakes have 0.72 to 0.94
SAMPLES = 40_000
BETTER = 0.03  # by so much more a crop must correlate than the resized picture does


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Truth's pixel (u, v) of the result's pixel: (u + 0.5) scale + offset - 0.5, by axis (x, y)."""

    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    match: float = np.nan

    @property
    def is_same(self) -> bool:
        return self.scale == (1.0, 1.0) and self.offset == (0.0, 0.0)

    def words(self, truth_hw: tuple[int, int], size_hw: tuple[int, int]) -> str:
        """Where it lies, for people."""
        sizes = f"{truth_hw[1]} x {truth_hw[0]} pixels, the result {size_hw[1]} x {size_hw[0]}"
        if self.scale != (1.0, 1.0):
            return f"truth has {sizes}: taken as the same view at {self.scale[0]:g} times the size, edge on edge"
        x, y = (-round(o) for o in self.offset)
        found = f": the two depths correlate by {self.match:.3f} there" if np.isfinite(self.match) else ", as stated"
        return f"truth has {sizes}: its first pixel lies on ({x}, {y}) of the result{found}"


def at_pixels(size_hw: tuple[int, int], placement: Placement) -> tuple[Float64, Float64]:
    """Truth's columns (W,) and rows (H,), real-valued, of the result's pixels."""
    h, w = size_hw
    columns: Float64 = (np.arange(w, dtype=np.float64) + 0.5) * placement.scale[0] + placement.offset[0] - 0.5
    rows: Float64 = (np.arange(h, dtype=np.float64) + 0.5) * placement.scale[1] + placement.offset[1] - 0.5
    return columns, rows


def nearest(values: npt.NDArray[Any], size_hw: tuple[int, int], placement: Placement, *, outside: Any = np.nan) -> npt.NDArray[Any]:
    """(H, W) or (H, W, C) `values` of the truth at the pixel nearest to each of the result's; `outside` where there is none."""
    if placement.is_same and values.shape[:2] == size_hw:
        return values
    columns, rows = at_pixels(size_hw, placement)
    h, w = values.shape[:2]
    c, r = np.floor(columns + 0.5).astype(np.intp), np.floor(rows + 0.5).astype(np.intp)
    out = values[np.ix_(np.clip(r, 0, h - 1), np.clip(c, 0, w - 1))].copy()
    out[~(((r >= 0) & (r < h))[:, None] & ((c >= 0) & (c < w))[None, :])] = outside
    return out


def _corner(at: Float64, n: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Float64, npt.NDArray[np.bool_]]:
    low = np.floor(at + 1e-9).astype(np.intp)
    part = np.clip(at - low, 0, 1)
    return np.clip(low, 0, n - 1), np.clip(low + 1, 0, n - 1), part, (at >= -0.5 - 1e-9) & (at <= n - 0.5 + 1e-9)


def placed(values: npt.NDArray[Any], size_hw: tuple[int, int], placement: Placement, *, inverse: bool = False) -> Float64:
    """(H, W) or (H, W, C) `values` of the truth at the pixels of the result, NaN outside.

    Between pixels the mean by area of those that are of the surface of the nearest known one: within 3 % of its value (of a depth), or of
    like direction (of vectors).
    inverse : they are depths, and averaged as 1 / Z, in which a plane is flat.
    """
    if placement.is_same and values.shape[:2] == size_hw:
        return np.asarray(values, np.float64)
    columns, rows = at_pixels(size_hw, placement)
    c0, c1, cf, c_in = _corner(columns, values.shape[1])
    r0, r1, rf, r_in = _corner(rows, values.shape[0])
    v = values.astype(np.float64)
    if inverse:
        with np.errstate(divide="ignore", invalid="ignore"):
            v = 1 / v
    vector = v.ndim == 3
    corners, weights = [], []
    for r, wr in ((r0, 1 - rf), (r1, rf)):
        for c, wc in ((c0, 1 - cf), (c1, cf)):
            corners.append(v[np.ix_(r, c)])
            weights.append(wr[:, None] * wc[None, :])
    stack, weight = np.stack(corners), np.stack(weights)
    known = np.isfinite(stack).all(axis=-1) if vector else np.isfinite(stack)
    weight = np.where(known, weight, 0)
    heaviest = weight.argmax(axis=0)[None]
    near = np.take_along_axis(stack, heaviest[..., None] if vector else heaviest, axis=0)
    with np.errstate(invalid="ignore"):
        alike = (stack * near).sum(axis=-1) > 0.94 if vector else np.abs(stack - near) <= APART * np.abs(near)
    weight = np.where(alike, weight, 0)
    total = weight.sum(axis=0)
    inside = r_in[:, None] & c_in[None, :] & (total > 0)
    w = weight[..., None] if vector else weight
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(w > 0, w * stack, 0).sum(axis=0) / (total[..., None] if vector else total)
        out: Float64 = 1 / mean if inverse else mean
    out[~inside] = np.nan
    return out


def place(truth: npt.NDArray[Any], result: npt.NDArray[Any]) -> Placement:
    """Where a truth (H, W) of another size lies on the result (H, W), from their depths, of whatever convention.

    A truth of like proportions is the same view resized, unless it lies clearly better as a crop; any other is a crop or has overscan, and
    found by correlation.
    Raises : PassError where neither can be made out, with what to state.
    """
    th, tw = truth.shape
    h, w = result.shape
    if (th, tw) == (h, w):
        return Placement()
    scaled = Placement(scale=(tw / w, th / h))
    alike = abs(tw / w * h - th) <= 1.0 or abs(th / h * w - tw) <= 1.0
    a, b = _level(result), _level(truth)
    crop = _crop(a, b)
    if alike:
        resized = _match(a, b, scaled)
        if crop is None or crop.match < max(resized + BETTER, LEAST_MATCH):
            return scaled
    if crop is None or crop.match < LEAST_MATCH:
        best = "" if crop is None else f"; as a crop they correlate by {crop.match:.2f} at best"
        raise PassError(
            f"truth has {tw} x {th} pixels and the result {w} x {h}: neither the same view resized nor a crop that can be found{best}. "
            "State where its first pixel lies with --crop X,Y, or render it at the plate's size"
        )
    return crop


def _level(values: npt.NDArray[Any]) -> Float64:
    """Logarithms, so that every convention of depth is the same picture but for sign and contrast; NaN where unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        v = np.log(np.abs(values.astype(np.float64)))
    v[~np.isfinite(v)] = np.nan
    return v


def _correlation(x: Float64, y: Float64) -> float:
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 100:
        return 0.0
    p, q = x[known] - x[known].mean(), y[known] - y[known].mean()
    power = float((p * p).sum() * (q * q).sum())
    return abs(float((p * q).sum())) / np.sqrt(power) if power > 0 else 0.0


def _match(a: Float64, b: Float64, placement: Placement) -> float:
    """Correlation of the result's level with the truth's nearest pixels."""
    columns, rows = at_pixels((a.shape[0], a.shape[1]), placement)
    step = max(1, int(np.sqrt(a.size / SAMPLES)))
    c, r = np.rint(columns[::step]).astype(int), np.rint(rows[::step]).astype(int)
    inside = ((r >= 0) & (r < b.shape[0]))[:, None] & ((c >= 0) & (c < b.shape[1]))[None, :]
    if inside.mean() * a.size < OVERLAP * min(a.size, b.size):
        return 0.0
    there = b[np.ix_(np.clip(r, 0, b.shape[0] - 1), np.clip(c, 0, b.shape[1] - 1))]
    return _correlation(a[::step, ::step], np.where(inside, there, np.nan))


def _crop(a: Float64, b: Float64) -> Placement | None:
    """The whole-pixel offset at which both correlate best: by FFT on small copies, then pixel by pixel about it."""
    k = max(1, -(-max(a.shape[1], b.shape[1]) // COARSE_PX))
    coarse = _best_shift(a[k // 2 :: k, k // 2 :: k], b[k // 2 :: k, k // 2 :: k])
    if coarse is None:
        return None
    tried: dict[tuple[int, int], float] = {}

    def match(x: int, y: int) -> float:
        if (x, y) not in tried:
            tried[x, y] = _match(a, b, Placement(offset=(x, y)))
        return tried[x, y]

    x, y = coarse[0] * k, coarse[1] * k
    reach = max(k, 1)
    while True:
        near = [(x + i * reach, y + j * reach) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        best = max(near, key=lambda at: match(*at))
        if best != (x, y):
            x, y = best
        elif reach > 1:
            reach //= 2
        else:
            return Placement(offset=(float(x), float(y)), match=match(x, y))


def _best_shift(a: Float64, b: Float64) -> tuple[int, int] | None:
    """(x, y) such that b[v + y, u + x] goes with a[v, u]: the highest masked correlation (Padfield 2012) over enough overlap."""
    shape = tuple(p + q - 1 for p, q in zip(a.shape, b.shape))

    def spectra(v: Float64) -> tuple[Any, Any, Any]:
        known = np.isfinite(v)
        centred = np.where(known, v - np.nanmean(v), 0) if known.any() else np.zeros_like(v)
        first, second, third = (np.fft.rfft2(x, shape) for x in (centred, centred**2, known.astype(np.float64)))
        return first, second, third

    (a1, a2, am), (b1, b2, bm) = spectra(a), spectra(b)

    def both(p: Any, q: Any) -> Float64:
        return np.fft.irfft2(np.conj(p) * q, shape)

    n = both(am, bm)
    least = OVERLAP * min(int(np.isfinite(a).sum()), int(np.isfinite(b).sum()))
    n[n < max(least, 1)] = np.nan  # where hardly a pixel overlaps, rounding divides by rounding
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = both(a1, b1) - both(a1, bm) * both(am, b1) / n
        power = (both(a2, bm) - both(a1, bm) ** 2 / n) * (both(am, b2) - both(am, b1) ** 2 / n)
        score = np.abs(cross) / np.sqrt(power)
        score[~np.isfinite(score) | (power < 1e-9 * np.nanmax(power))] = -1
    y, x = np.unravel_index(int(score.argmax()), score.shape)
    if score[y, x] < 0:
        return None
    return (int(x) if x < b.shape[1] else int(x) - shape[1]), (int(y) if y < b.shape[0] else int(y) - shape[0])
