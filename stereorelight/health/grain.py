"""Grain: the noise of a plate against its light, from one picture or from two successive ones.

In: scene-linear plates (H, W, 3), NaN = unknown.  Out: a noise curve per channel, sigma^2 = shot * light + floor.
From one picture the residual of Immerkaer's kernel (1996), which any plane passes unseen, is gathered in blocks; the blocks
without texture are those of the smallest spread at their brightness, found by fitting the curve from below.  From two frames
their difference takes the place of the residual: texture falls out, what moves is left out as texture was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.errors import PassError
from stereorelight.health.clipping import clipped_mask
from stereorelight.health.finding import Finding, Level
from stereorelight.health.picture import MID_GREY, as_plate, on_frame

BLOCK_PX = 16
KERNEL_DOF = 1 / 3.78  # independent values a pixel of the kernel's residual: 1 / sum of its squared autocorrelation
LOWEST_SHARE = 0.05  # of the blocks at a brightness: surely free of texture
KEEP_SIGMAS = 1.5  # blocks up to so many standard deviations above the curve are taken for grain alone
LEAST_BLOCKS = 40
STATIC_SHARE = 0.1  # of the blocks must stand still before frames are compared in time
CORRELATED = 0.8  # fine over coarse spread; white grain has 1, grain enlarged by 1.5 or smoothed by a codec under 0.7

SIGMA_WARN, SIGMA_BAD = 6.0, 15.0  # % of mid grey; a cinema camera at its base speed has 1-2, three stops pushed about 6
RATIO_WARN, RATIO_LEAST = 1.6, 1.0  # one eye's grain over the other's (a stop and a third of gain), where it is over 1 % of mid grey


@dataclass(frozen=True, kw_only=True)
class Grain:
    """sigma^2 = shot * light + floor per channel (scene-linear).

    fineness : spread at a pixel's distance over that at two; 1 for white grain, less where it is correlated (from one picture:
               or where texture is everywhere); NaN where unknown.
    blocks   : blocks that had a say;  method: "picture" or "frames".
    """

    floor: tuple[float, float, float]
    shot: tuple[float, float, float]
    fineness: float
    blocks: int
    method: Literal["picture", "frames"]

    def sigma(self, light: float) -> tuple[float, float, float]:
        """Standard deviation per channel at `light`, scene-linear."""
        r, g, b = (float(np.sqrt(max(f + s * max(light, 0.0), 0.0))) for f, s in zip(self.floor, self.shot))
        return (r, g, b)

    @property
    def percent(self) -> float:
        """Grain at 18 % grey, the root mean square of the channels, in % of 18 % grey."""
        return 100 * float(np.sqrt(np.mean(np.square(self.sigma(MID_GREY))))) / MID_GREY


def _blocks(values: Float32) -> Float32:
    """(rows, columns, ...) means of whole blocks of (H, W, 3)."""
    import cv2

    rows, columns = values.shape[0] // BLOCK_PX, values.shape[1] // BLOCK_PX
    means: Float32 = cv2.resize(np.ascontiguousarray(values[: rows * BLOCK_PX, : columns * BLOCK_PX]), (columns, rows), interpolation=cv2.INTER_AREA)
    return means


def _residual(plate: Float32, spacing: int) -> Float32:
    """Immerkaer's residual with taps `spacing` px apart, of the spread of the grain itself."""
    import cv2

    tap = np.zeros(2 * spacing + 1, np.float32)
    tap[[0, spacing, 2 * spacing]] = (1, -2, 1)
    tap /= np.sqrt(6)
    out: Float32 = cv2.sepFilter2D(plate, cv2.CV_32F, tap, tap, borderType=cv2.BORDER_REPLICATE)
    return out


def _curve(light: Float64, variance: Float64, dof: float) -> tuple[float, float, Bool]:
    """(floor, shot, which blocks are grain alone): the lower edge of a cloud of blocks, each a chi-square of `dof`.

    Starts from the lowest blocks at each brightness, then keeps what lies within KEEP_SIGMAS above the curve, and fits it
    again with the cut tail made good.
    """
    import scipy.stats

    spread = float(np.sqrt(2 / dof))
    order = np.argsort(light)
    groups = np.array_split(order, max(2, min(12, len(order) // 60)))
    low = scipy.stats.chi2.ppf(LOWEST_SHARE / 2, dof) / dof
    start_x = np.array([light[g].mean() for g in groups])
    start_y = np.array([np.sort(variance[g])[: max(1, round(LOWEST_SHARE * len(g)))].mean() for g in groups]) / max(low, 0.1)
    floor, shot = _non_negative(start_x, start_y, np.ones(len(groups)))
    cut = 1 + KEEP_SIGMAS * spread
    # Mean of a chi-square cut at `cut`: the share of its mean that lies below, over the share of its values that does.
    tail = scipy.stats.chi2.cdf(cut * dof, dof + 2) / scipy.stats.chi2.cdf(cut * dof, dof)
    kept: Bool = np.ones(len(light), dtype=bool)
    for _ in range(20):
        at = floor + shot * light
        now = variance <= cut * at
        if now.sum() < LEAST_BLOCKS // 2:
            break
        kept = now
        before = floor, shot
        floor, shot = _non_negative(light[kept], variance[kept] / tail, 1 / np.maximum(at[kept], 1e-12) ** 2)
        if np.allclose(before, (floor, shot), rtol=1e-4, atol=1e-14):
            break
    return floor, shot, kept


def _non_negative(x: Float64, y: Float64, weight: Float64) -> tuple[float, float]:
    """(a, b) >= 0 of y = a + b x, weighted least squares."""
    sw, sx, sy = weight.sum(), (weight * x).sum(), (weight * y).sum()
    sxx, sxy = (weight * x * x).sum(), (weight * x * y).sum()
    determinant = sw * sxx - sx * sx
    if determinant > 1e-9 * sw * sxx:
        a, b = (sxx * sy - sx * sxy) / determinant, (sw * sxy - sx * sy) / determinant
        if a >= 0 and b >= 0:
            return float(a), float(b)
        if a < 0 and sxx > 0:
            return 0.0, float(max(sxy / sxx, 0))
    return float(max(sy / sw, 0)), 0.0


def _measured(light: Float32, square: Float32, usable: Bool, dof: float) -> tuple[list[tuple[float, float]], Bool]:
    """Curves of the three channels from block means, and the blocks that are grain alone in green."""
    curves = []
    alone: Bool = np.zeros(0, dtype=bool)
    for c in range(3):
        floor, shot, kept = _curve(light[..., c][usable].astype(np.float64), square[..., c][usable].astype(np.float64), dof)
        curves.append((floor, shot))
        if c == 1:
            alone = kept
    return curves, alone


def grain(plate: Float32, *, following: Float32 | None = None) -> Grain:
    """The noise curve of `plate` (H, W, 3).

    following : the next frame of the same eye.  Used where at least a tenth of the frame stands still, and the two differ at all.
    Raises    : PassError where fewer than 40 blocks of 16 x 16 are known and unclipped.
    """
    plate = as_plate(plate, "plate")
    clipped, _ = clipped_mask(plate)
    good: Bool = np.asarray(np.isfinite(plate).all(axis=2)) & ~clipped
    clean = np.where(good[..., None], plate, np.float32(0))
    usable = _blocks(good.astype(np.float32)) > 0.9999
    if usable.sum() < LEAST_BLOCKS:
        raise PassError(f"only {int(usable.sum())} known, unclipped blocks of {BLOCK_PX} px to measure grain in, want {LEAST_BLOCKS}")
    light = _blocks(clean)
    fine = _blocks(np.square(_residual(clean, 1)))
    curves, alone = _measured(light, fine, usable, BLOCK_PX**2 * KERNEL_DOF)
    coarse = _blocks(np.square(_residual(clean, 2)))[usable][alone]
    below = float(np.median(coarse))
    fineness = float(np.sqrt(np.median(fine[usable][alone]) / below)) if below > 0 else float("nan")
    (r, g, b) = curves
    found = Grain(floor=(r[0], g[0], b[0]), shot=(r[1], g[1], b[1]), fineness=min(fineness, 1.0), blocks=int(alone.sum()), method="picture")
    return found if following is None else _in_time(found, clean, good, as_plate(following, "following plate"), light)


def _in_time(found: Grain, plate: Float32, good: Bool, following: Float32, light: Float32) -> Grain:
    if following.shape != plate.shape:
        raise PassError(f"following plate must have shape {plate.shape}, got {following.shape}")
    good = good & np.asarray(np.isfinite(following).all(axis=2))
    usable = _blocks(good.astype(np.float32)) > 0.9999
    if usable.sum() < LEAST_BLOCKS:
        return found
    step = np.where(good[..., None], (following - plate) * np.float32(np.sqrt(0.5)), np.float32(0))
    square = _blocks(np.square(step)) - np.square(_blocks(step))  # a block that grew brighter as a whole is no grain
    curves, still = _measured(light, square * np.float32(BLOCK_PX**2 / (BLOCK_PX**2 - 1)), usable, BLOCK_PX**2 - 1)
    (r, g, b) = curves
    fine, coarse = (float(np.median(_blocks(np.square(_residual(step, spacing)))[usable][still])) for spacing in (1, 2))
    timed = Grain(
        floor=(r[0], g[0], b[0]),
        shot=(r[1], g[1], b[1]),
        fineness=min(float(np.sqrt(fine / coarse)), 1.0) if coarse > 0 else float("nan"),
        blocks=int(still.sum()),
        method="frames",
    )
    # Repeated frames differ by nothing, moving ones by more than grain: then the picture itself is the better witness.
    # White grain shows as much in the picture; correlated grain slips through the picture's kernel, in time it does not.
    stands = still.sum() / max(usable.sum(), 1)
    most = 1.3 if timed.fineness >= CORRELATED else 8.0 if stands >= 3 * STATIC_SHARE else 1.3
    believed = stands >= STATIC_SHARE and still.sum() >= LEAST_BLOCKS and 0.1 * found.percent < timed.percent < most * found.percent
    return timed if believed else found


def judge_grain(left: Sequence[tuple[int | None, Grain]], right: Sequence[tuple[int | None, Grain]] = ()) -> Finding:
    """One Finding "grain" over a shot: median of each eye in % of 18 % grey (value: the grainier eye's), and their difference."""
    eyes = {name: eye for name, eye in (("left", left), ("right", right)) if eye}
    if not eyes:
        return Finding(name="grain", level="unknown", unit="%", words="Grain was not measured: no frame had enough known, unclipped blocks.")
    percent = {name: float(np.median([g.percent for _, g in eye])) for name, eye in eyes.items()}
    fineness = {name: float(np.median([g.fineness for _, g in eye])) for name, eye in eyes.items()}
    most = max(percent, key=lambda name: percent[name])
    value = percent[most]
    level: Level = "bad" if value >= SIGMA_BAD else "warn" if value >= SIGMA_WARN else "good"
    listed = ", ".join(f"{p:.1f} % of mid grey in the {name} eye" for name, p in percent.items())
    words, remedy = f"Grain is {listed}", ""
    if level != "good":
        worst_frame = max(eyes[most], key=lambda pair: pair[1].percent)
        words += f", most{on_frame(worst_frame[0])} {worst_frame[1].percent:.1f} %" if worst_frame[0] is not None else ""
        remedy = "Normals will be rough; smooth over more frames and a larger normal window, denoise both eyes alike, or shoot at a lower gain."
    ratio = max(percent.values()) / max(min(percent.values()), 1e-9)
    if len(eyes) == 2 and value > RATIO_LEAST and ratio > RATIO_WARN:
        words += f"; the {most} eye has {min(ratio, 99):.1f} times the other's"
        level = "warn" if level == "good" else level
        remedy = remedy or "Set both cameras to one gain and one noise reduction, or denoise the grainier eye."
    # One picture's fine texture looks like enlarged grain: only frames tell them apart.
    timed = {name for name, eye in eyes.items() if 2 * sum(g.method == "frames" for _, g in eye) > len(eye)}
    lumpy = [name for name, f in fineness.items() if name in timed and f < CORRELATED and percent[name] > RATIO_LEAST]
    if lumpy:
        words += f"; in the {' and '.join(lumpy)} eye it is correlated (enlarged, denoised or compressed), which hides some of it"
        level = "note" if level == "good" else level
    frames = {f: max(g.percent for eye in eyes.values() for k, g in eye if k == f) for eye in eyes.values() for f, _ in eye}
    details = {f"{name}_percent": p for name, p in percent.items()} | {f"{name}_fineness": f for name, f in fineness.items()}
    details["ratio"] = ratio if len(eyes) == 2 else float("nan")
    return Finding(name="grain", level=level, value=value, unit="%", words=words + ".", remedy=remedy, frames=tuple(frames.items()), details=details)
