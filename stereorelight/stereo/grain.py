"""Grain by tone, and the tones in which there is as much of it everywhere.

In: tone levels of a plate (H, W, 3) uint16.  Out: its grain's variance, floor + shot * light; a tone curve, (LEVELS,) float32.
Photon noise is even after a square root, but what a camera adds when it is read is not: it is the same in the dark, where the root is
steep.  One strength of grain for a whole picture is then too little for its dark ground and too much for what is bright."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, Float64, UInt16
from stereorelight.engine.grain import BLOCK, flutter
from stereorelight.engine.locking import roughness
from stereorelight.engine.tone import LEVELS

BLOCKS = 4000  # looked at: enough for a tenth of the grain at every tone
FEWEST_BLOCKS = 200
GROUPS = 16  # of blocks alike in light
CALMEST = 0.3  # share of a group's blocks that speak: those without texture
CALMEST_OF_WHITE = 0.64  # their mean variance where all is white grain, of what it is
TEXTURE_GROWS = 4.0  # how much more of a picture's texture there is at two pixels' distance than at one, at least, as variance
LEAST = 0.3  # grey levels: less grain than the steps of 8 bits leave is not told
FITS = 12
DARKEST = 0.01  # share of the picture that may be darker than tones are evened for
EVEN = 1.1  # times the usual grain that is as good as even
LEAST_SLOPE = 0.5  # how much a grainy tone is pressed: further, what it shows falls under a grey level
MOST_SLOPE = 1.5  # how much a calm tone is stretched: beyond, small differences of gain between the eyes are, too


@dataclass(frozen=True, kw_only=True)
class Grain:
    """Variance of the grain of linear light, 1 at white: floor + shot * light."""

    floor: float
    shot: float

    def of_tones(self, tone: Float64) -> Float64:
        """Its standard deviation in tones (the square root of light, 1 at white), grey levels of 255.

        Where grain outweighs light, what is below black is cut off: the root is no steeper than at a light as large as the grain.
        """
        light = tone * tone
        sigma = np.sqrt(self.floor + self.shot * light)
        return 127.5 * sigma / np.sqrt(np.maximum(np.maximum(light, sigma), 1e-12))


def _fitted(light: Float64, variance: Float64, trust: Float64) -> Grain:
    """The lower edge of `variance` as floor + shot * light, neither below zero: groups that are above it have texture, and count less."""
    weight = trust / variance**2
    floor, shot = 0.0, 0.0
    for _ in range(FITS):
        w, wx, wy, wxx, wxy = (float((weight * a).sum()) for a in (np.ones_like(light), light, variance, light * light, light * variance))
        spread = w * wxx - wx * wx
        floor, shot = ((wxx * wy - wx * wxy) / spread, (w * wxy - wx * wy) / spread) if spread > 1e-9 * w * wxx else (wy / w, 0.0)
        if floor < 0:
            floor, shot = 0.0, wxy / wxx
        elif shot < 0:
            floor, shot = wy / w, 0.0
        told = floor + shot * light
        weight = trust / (told * np.maximum(1, variance / told)) ** 2
    return Grain(floor=floor, shot=shot)


def grain_by_tone(level: UInt16, step: float = 1.0) -> Grain | None:
    """The grain of a plate, from its calmest blocks at each tone; None where too little of it is neither black nor white.

    step : how far apart on the plate the pixels were taken.  Grain that was resampled hangs together as texture does: only every other pixel
           of it is looked at, which hardly do.
    Texture that is everywhere is told from grain by its growth: it flutters more from one pixel to the second than to the first.
    """
    if step != 1:
        level = np.ascontiguousarray(level[::2, ::2])
    apart = max(BLOCK, int(np.sqrt(level.shape[0] * level.shape[1] / BLOCKS)))
    blocks = [a.ravel() for a in flutter(level, step=apart)]
    usable = np.isfinite(blocks[0])
    if usable.sum() < FEWEST_BLOCKS:
        return None
    light, near, far = (a[usable].astype(np.float64) for a in blocks)
    order = np.argsort(light, kind="stable")
    at, variance, trust = [], [], []
    for group in np.array_split(order, min(GROUPS, order.size // 15)):
        calm = group[np.argsort(near[group], kind="stable")[: max(3, round(CALMEST * group.size))]]
        one, two, middle = (
            near[calm].mean() / (CALMEST_OF_WHITE * roughness(step, apart=1 if step == 1 else 2) ** 2),
            far[calm].mean(),
            light[calm].mean(),
        )
        least = (LEAST / 127.5) ** 2 * middle
        at.append(middle)
        grain = one - max(two - one, 0) / (TEXTURE_GROWS - 1)
        variance.append(max(grain, least))
        trust.append(max(grain / max(one, least), 0.05) ** 2)
    return _fitted(np.array(at), np.array(variance), np.array(trust))


def even_tones(grains: list[Grain], level: UInt16, *, calm: float) -> Float32 | None:
    """(LEVELS,) grey levels 0..255 in which the grain of all `grains` together is as strong everywhere; None where the root has it so already.

    calm : grey levels; so much grain and less is as good as none.
    A generalised Anscombe transform (Anscombe 1948), as strong as `calm` at least so that clean tones stay what they were; none is
    pressed to less than half, nor stretched by more than half.
    """
    if not grains:
        return None
    darkest, middle = np.quantile(level[::4, ::4, 1], (DARKEST, 0.5)).astype(int)
    tone = np.maximum(np.linspace(0, 1, LEVELS), darkest / (LEVELS - 1))  # of tones that are not there nothing is known
    sigma = np.maximum(np.sqrt(np.mean([one.of_tones(tone) ** 2 for one in grains], axis=0)), calm)
    sigma = np.maximum.accumulate(sigma[::-1])[::-1]  # where black cuts it off it is less, and no help
    wanted = sigma[middle] / sigma
    slope = np.where(wanted < 1, np.clip(EVEN * wanted, LEAST_SLOPE, 1), np.clip(wanted / EVEN, 1, MOST_SLOPE))
    if (slope == 1).all():
        return None
    curve = np.concatenate([[0.0], np.cumsum(slope[1:] + slope[:-1])]) * (255 / (2 * LEVELS - 2))
    return (curve * min(1.0, 255 / curve[-1])).astype(np.float32)
