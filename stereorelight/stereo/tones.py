"""One eye's tones given to the other, channel by channel: by all that either eye sees, and then by what both of them see.

In: tone levels (H, W, 3) uint16.  Out: tables (3, LEVELS) float32.
Curves come from equal shares: the level below which a tenth of one eye's pixels lie is that below which a tenth of the other's do.  That needs no
match, but what only one eye sees tilts a curve, here up and there down; a tilt of 5 % leaves 5 % of all texture between the eyes, where there is no
disparity.  Once there is a match, shares of points that both eyes see take its place: they have no such tilt, and noise, alike in both eyes,
gives them none, as it would give a regression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, UInt16
from stereorelight.engine.shares import counts_of, counts_of_pairs, equal_shares
from stereorelight.engine.tone import LEVELS

SAMPLES = 20_000  # pixels looked at for statistics: enough for a quantile to a fifth of a grey level
PAIRS = 240_000  # of points that both eyes see, at most
FEWEST_PAIRS = 4_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Tones:
    """Where the greys of a pair come from, left and right: levels (H, W, 3) uint16 BGR, and tables (3, LEVELS) float32 of grey levels 0..255."""

    levels: tuple[UInt16, UInt16]
    tables: tuple[Float32, Float32]

    def flipped(self) -> Tones:
        """Those of the pair as seen in a mirror."""
        left, right = (np.ascontiguousarray(a[:, ::-1]) for a in self.levels)
        return Tones(levels=(right, left), tables=self.tables[::-1])


def sample_step(picture: npt.NDArray[Any]) -> int:
    """Every how many rows and columns leave about `SAMPLES` of the pixels."""
    return max(1, int(np.sqrt(picture.shape[0] * picture.shape[1] / SAMPLES)))


def tone_tables(picture: UInt16, target: UInt16) -> Float32:
    """(3, LEVELS) tables that give `picture` the distribution of tones of `target`, both (H, W, 3): grey levels 0..255."""
    mine, theirs = (counts_of(one, step=sample_step(one)) for one in (picture, target))
    return (equal_shares(mine, theirs) * (255 / (LEVELS - 1))).astype(np.float32)


def tables_of_pairs(tones: Tones, disparity: Float32, seen: Bool) -> Float32 | None:
    """The right eye's tables by the points that both eyes see; None where those are too few.

    disparity : (H, W) px, of the left eye.   seen : (H, W), where it may be believed.
    """
    step = max(1, int(np.ceil(np.sqrt(np.count_nonzero(seen) / PAIRS))))
    left, right = counts_of_pairs(*tones.levels, disparity, seen, step=step)
    if left[0].sum() < FEWEST_PAIRS:
        return None
    curves = equal_shares(right, left)
    levels = np.arange(LEVELS)
    for c in range(3):
        # Tones that no pair has go on as the last ones do: brighter or darker by the same share.
        low, high = np.flatnonzero(right[c])[[0, -1]].tolist()
        curves[c, :low] = levels[:low] * (curves[c, low] / max(low, 1))
        curves[c, high:] = levels[high:] * (curves[c, high] / max(high, 1))
    return np.stack([np.interp(curve, levels, table) for curve, table in zip(curves, tones.tables[0], strict=True)]).astype(np.float32)
