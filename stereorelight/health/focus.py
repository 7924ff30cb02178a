"""Focus of one eye against the other: how much the softer eye is blurred, in pixels, and whether it tilts across the frame.

In: scene-linear plates (H, W, 3), NaN = unknown, and matched points where there are any.  Out: the sigma in px of the Gaussian
that would make the sharper eye as soft as the other.  Blur of sigma s multiplies a power spectrum by exp(-(2 pi f s)^2), whatever
the picture, so the logarithm of the ratio of the eyes' spectra over the same content is a line in f^2 whose slope is the answer.
A shift between the eyes does not touch a power spectrum, a gain moves only the line's foot, and grain's own power is taken off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.errors import PassError
from stereorelight.health.clipping import clipped_mask
from stereorelight.health.finding import Finding, Level
from stereorelight.health.grain import Grain, grain
from stereorelight.health.picture import GREY, as_plate, grey, on_frame

TILE_PX = 64
MAP_CELLS = (3, 4)  # rows, columns
MOST_TILES = 300
LEAST_TILES = 12
CELL_TILES = 6
OVER_GRAIN = 3.0  # a band of the spectrum is read where both eyes' signal stands so many times over their grain
LOWEST_BAND, HIGHEST_BAND = 3, 28  # of 32: below, the window's own width blurs the bands; above, lenses and codecs end
LEAST_BANDS = 4
DEEPEST = 4.0  # natural logs of the ratio from the line's foot: further down a window's leakage is read, not the picture

SOFT_NOTE, SOFT_WARN, SOFT_BAD = 0.5, 0.8, 2.5  # px: what a matcher's window forgives; what it loses; another picture
TILT_WARN = 1.0  # px^2 of sigma^2 either way between two sides of the frame
SURE = 3.0  # standard errors


@dataclass(frozen=True, kw_only=True, eq=False)
class FocusDifference:
    """variance_px2: sigma_right^2 - sigma_left^2 of the extra blur; error_px2: its standard error.

    local_px : (rows, columns) float32, signed sigma in px as `sigma_px`; NaN where too little is to be seen.
    tiles    : pairs of tiles that had a say.
    """

    variance_px2: float
    error_px2: float
    local_px: Float32
    tiles: int

    @property
    def sigma_px(self) -> float:
        """Sigma of the extra Gaussian blur: positive where the right eye is softer, negative where the left is."""
        return float(np.sign(self.variance_px2) * np.sqrt(abs(self.variance_px2)))


def _centres(height: int, width: int) -> Float64:
    """(n, 2) centres of tiles that overlap by half."""
    half = TILE_PX // 2
    x, y = np.meshgrid(np.arange(half, width - half + 1, half), np.arange(half, height - half + 1, half))
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)


def _tiles(light: Float32, good: Bool, centres: Float64) -> tuple[Float32, Bool]:
    """(n, T, T) tiles about `centres` (n, 2), and which of them are whole; the others are zero."""
    half = TILE_PX // 2
    corner = np.round(centres).astype(int) - half
    height, width = light.shape
    inside = (corner >= 0).all(axis=1) & (corner[:, 0] + TILE_PX <= width) & (corner[:, 1] + TILE_PX <= height)
    out = np.zeros((len(centres), TILE_PX, TILE_PX), np.float32)
    for n in np.flatnonzero(inside):
        x, y = corner[n]
        if good[y : y + TILE_PX, x : x + TILE_PX].all():
            out[n] = light[y : y + TILE_PX, x : x + TILE_PX]
        else:
            inside[n] = False
    return out, inside


def _spectra(tiles: Float32) -> Float64:
    """(n, bands) mean power a pixel in rings of frequency; white noise of variance v gives v in every ring."""
    import scipy.fft

    window = np.hanning(TILE_PX + 2)[1:-1].astype(np.float32)
    window2 = window[:, None] * window[None, :]
    weight = window2 / window2.sum()
    level = np.einsum("nij,ij->n", tiles, weight)
    power = np.square(np.abs(scipy.fft.rfft2((tiles - level[:, None, None]) * window2))) / float(np.square(window2).sum())
    fy, fx = np.fft.fftfreq(TILE_PX)[:, None], np.fft.rfftfreq(TILE_PX)[None, :]
    ring = np.round(np.hypot(fx, fy) * TILE_PX).astype(int).ravel()
    bands = TILE_PX // 2 + 1
    use = ring < bands
    sums = np.zeros((TILE_PX * (TILE_PX // 2 + 1), bands), np.float32)
    sums[np.flatnonzero(use), ring[use]] = 1
    sums /= np.maximum(sums.sum(axis=0), 1)
    mean: Float64 = (power.reshape(len(tiles), -1).astype(np.float32) @ sums).astype(np.float64)
    return mean


def _slope(left: Float64, right: Float64, left_noise: Float64, right_noise: Float64) -> float:
    """sigma_right^2 - sigma_left^2 in px^2 from spectra (n, bands) of the same content; NaN where too little stands over the grain."""
    # Each tile is brought to one strength, so that one hard edge does not speak for all.
    strength = np.sqrt(left[:, 2:6].sum(axis=1) * right[:, 2:6].sum(axis=1))
    trust = 1 / np.maximum(strength, 1e-20)
    a, b = (trust[:, None] * left).sum(axis=0), (trust[:, None] * right).sum(axis=0)
    na, nb = float((trust * left_noise).sum()), float((trust * right_noise).sum())
    f2 = np.square(np.arange(left.shape[1]) / TILE_PX)
    fine = (a > (1 + OVER_GRAIN) * na) & (b > (1 + OVER_GRAIN) * nb)
    fine[:LOWEST_BAND] = False
    fine[HIGHEST_BAND:] = False
    stop = np.flatnonzero(~fine[LOWEST_BAND:])
    if stop.size:  # above the first band that drowns, the rest is chance
        fine[LOWEST_BAND + int(stop[0]) :] = False
    if fine.sum() < LEAST_BANDS:
        return float("nan")
    x, y = f2[fine], np.log((b[fine] - nb) / (a[fine] - na))
    weight = np.flatnonzero(fine).astype(np.float64)  # a ring holds pixels as it is long
    value = float("nan")
    for _ in range(4):
        keep = np.abs(y - y[:LEAST_BANDS].mean()) <= DEEPEST
        if keep.sum() < LEAST_BANDS:
            keep[:LEAST_BANDS] = True
        w, u, v = weight[keep], x[keep], y[keep]
        mean_u, mean_v = np.average(u, weights=w), np.average(v, weights=w)
        value = -float((w * (u - mean_u) * (v - mean_v)).sum() / (w * np.square(u - mean_u)).sum()) / (4 * np.pi**2)
        if keep.all():
            break
        x, y, weight = x[keep], y[keep], weight[keep]
    return value


def _prepared(plate: Float32, measured: Grain | None) -> tuple[Float32, Bool, Float64, Float64]:
    """Grey, usable pixels, and grain's variance of grey: (floor, shot) each summed over the channels' weights."""
    clipped, _ = clipped_mask(plate)
    good: Bool = np.asarray(np.isfinite(plate).all(axis=2)) & ~clipped
    light = np.where(good, grey(plate), np.float32(0)).astype(np.float32)
    found = grain(plate) if measured is None else measured
    # Texture that is everywhere passes for grain below what the finest band holds: the caller caps it there.
    weight = np.square(np.array(GREY))
    return light, good, np.array(float(weight @ found.floor)), np.array(float(weight @ found.shot))


def focus_difference(
    left: Float32,
    right: Float32,
    *,
    points_left: Float64 | None = None,
    points_right: Float64 | None = None,
    left_grain: Grain | None = None,
    right_grain: Grain | None = None,
) -> FocusDifference:
    """How much softer the right eye is than the left.

    left, right : (H, W, 3) scene-linear.
    points_left, points_right : (n, 2) pixels (x, y) of the same surface points; without them tiles at the same place are
                  compared, whose content is nearly the same as a whole but not tile by tile.
    left_grain, right_grain : of each plate, where it was measured already (half the time).
    Raises      : PassError where fewer than 12 pairs of tiles of 64 px are known, unclipped and textured.
    """
    left, right = as_plate(left, "left plate"), as_plate(right, "right plate")
    if min(*left.shape[:2], *right.shape[:2]) < 2 * TILE_PX:
        raise PassError(f"focus wants plates of at least {2 * TILE_PX} px a side, got {left.shape[1]}x{left.shape[0]}")
    if points_left is not None and points_right is not None:
        at_left, at_right = np.asarray(points_left, np.float64), np.asarray(points_right, np.float64)
        if at_left.shape != at_right.shape or at_left.ndim != 2 or at_left.shape[1] != 2:
            raise PassError(f"points_left and points_right must both have shape (n, 2), got {at_left.shape} and {at_right.shape}")
    else:
        at_left = at_right = _centres(min(left.shape[0], right.shape[0]), min(left.shape[1], right.shape[1]))
    if len(at_left) > 2 * MOST_TILES:
        chosen = np.linspace(0, len(at_left) - 1, 2 * MOST_TILES).round().astype(int)
        at_left, at_right = at_left[chosen], at_right[chosen]
    spectra, noises, usable = [], [], np.ones(len(at_left), dtype=bool)
    for plate, at, measured in ((left, at_left, left_grain), (right, at_right, right_grain)):
        light, good, floor, shot = _prepared(plate, measured)
        tiles, whole = _tiles(light, good, at)
        usable &= whole
        power = _spectra(tiles)
        finest = power[:, HIGHEST_BAND:].mean(axis=1)
        noises.append(np.minimum(floor + shot * np.maximum(tiles.mean(axis=(1, 2)), 0), finest))
        spectra.append(power)
    contrast = np.sqrt(spectra[0][:, 2:6].mean(axis=1) * spectra[1][:, 2:6].mean(axis=1))
    usable &= contrast > 4 * np.maximum(noises[0], noises[1])
    if usable.sum() < LEAST_TILES:
        raise PassError(f"only {int(usable.sum())} pairs of textured, unclipped tiles to compare focus by, want {LEAST_TILES}")
    if usable.sum() > MOST_TILES:  # the richest, in both eyes together
        usable &= contrast >= np.sort(contrast[usable])[-MOST_TILES]
    a, b, na, nb = (s[usable] for s in (*spectra, *noises))
    variance = _slope(a, b, na, nb)
    if not np.isfinite(variance):
        raise PassError("too little detail stands over the grain to compare focus; denoise the plates for this measurement")
    quarters = [_slope(a[k::4], b[k::4], na[k::4], nb[k::4]) for k in range(4)]
    error = float(np.nanstd(quarters, ddof=1) / 2) if np.isfinite(quarters).sum() > 2 else float("inf")
    rows, columns = MAP_CELLS
    row = np.clip(at_left[usable, 1] / left.shape[0] * rows, 0, rows - 1).astype(int)
    column = np.clip(at_left[usable, 0] / left.shape[1] * columns, 0, columns - 1).astype(int)
    local = np.full(MAP_CELLS, np.nan, np.float32)
    for r in range(rows):
        for c in range(columns):
            here = (row == r) & (column == c)
            if here.sum() >= CELL_TILES:
                v = _slope(a[here], b[here], na[here], nb[here])
                local[r, c] = np.sign(v) * np.sqrt(abs(v))
    return FocusDifference(variance_px2=variance, error_px2=error, local_px=local, tiles=int(usable.sum()))


def _tilt(field: Float32) -> tuple[float, str]:
    """(difference of sigma^2 between two opposite sides of the map, how to say it)."""
    squared = np.sign(field) * np.square(field)
    best, said = 0.0, ""
    for axis, names in ((1, ("left", "right")), (0, ("top", "bottom"))):
        ends = [np.take(squared, k, axis=axis) for k in (0, -1)]
        if all(np.isfinite(e).sum() >= 2 for e in ends):
            difference = float(np.nanmedian(ends[1]) - np.nanmedian(ends[0]))
            # a tilt goes the same way between the inner cells
            middle = float(np.nanmedian(np.take(squared, range(1, squared.shape[axis] - 1), axis=axis)))
            straight = min(np.nanmedian(ends[0]), np.nanmedian(ends[1])) <= middle <= max(np.nanmedian(ends[0]), np.nanmedian(ends[1]))
            if straight and abs(difference) > abs(best):
                best, said = difference, f"from the {names[0]} to the {names[1]} of the frame"
    return best, said


def judge_focus(measured: Sequence[tuple[int | None, FocusDifference]]) -> Finding:
    """One Finding "focus" over a shot: sigma in px of the softer eye's extra blur (positive: the right eye is softer)."""
    if not measured:
        return Finding(name="focus", level="unknown", unit="px", words="Focus was not compared: too little matched texture stands over the grain.")
    variance = float(np.median([m.variance_px2 for _, m in measured]))
    error = float(np.median([m.error_px2 for _, m in measured]))
    sigma = float(np.sign(variance) * np.sqrt(abs(variance)))
    sure = abs(variance) > SURE * error
    size = abs(sigma)
    level: Level = "good"
    if sure:
        level = "bad" if size >= SOFT_BAD else "warn" if size >= SOFT_WARN else "note" if size >= SOFT_NOTE else "good"
    side = "right" if sigma > 0 else "left"
    words = f"The {side} eye is softer, as by a blur of {size:.2f} px (sigma)"
    if level == "good":
        words = f"Both eyes are equally sharp, to {max(size, float(np.sqrt(error))):.2f} px of blur"
    frames = tuple((frame, m.sigma_px) for frame, m in measured)
    worst = max(frames, key=lambda pair: abs(pair[1]))
    if level != "good" and len(frames) > 1 and abs(worst[1]) > 1.3 * size:
        words += f", most{on_frame(worst[0])} {abs(worst[1]):.2f} px"
    maps = np.stack([m.local_px for _, m in measured])
    seen = np.isfinite(maps).any(axis=0)
    field = np.full(seen.shape, np.nan, np.float32)
    field[seen] = np.nanmedian(maps[:, seen], axis=0)
    tilt, across = _tilt(field)
    remedy = f"Refocus the {side} camera to match the other; for this shot, blur the sharper eye's matching copy or trust depth less." if size else ""
    if abs(tilt) > max(TILT_WARN, 4 * SURE * error):
        words += f"; the plane of focus is tilted: the difference changes by {np.sqrt(abs(tilt)):.2f} px {across}"
        level = "warn" if level in ("good", "note") else level
        remedy = "Look at the softer eye's lens mount and mirror: its plane of focus is tilted. " + remedy
    return Finding(
        name="focus",
        level=level,
        value=sigma,
        unit="px",
        words=words + ".",
        remedy="" if level in ("good", "note") else remedy,
        frames=frames,
        details={"variance_px2": variance, "error_px2": error, "map_px": field.tolist(), "tilt_px2": tilt},
    )
