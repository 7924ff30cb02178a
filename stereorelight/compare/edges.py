"""Where a true map steps: the split between pixels near depth edges and pixels of flat regions.

In: (H, W) float maps, NaN (or inf) where unknown.  Out: (H, W) bool."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool


def grown(mask: Bool, reach_px: int) -> Bool:
    """`mask` grown by `reach_px` pixels in every direction, a square."""
    padded = np.pad(mask, reach_px)
    h, w = mask.shape
    across: Bool = np.logical_or.reduce([padded[:, k : k + w] for k in range(2 * reach_px + 1)])
    return np.logical_or.reduce([across[k : k + h] for k in range(2 * reach_px + 1)])


def near_edges(truth: npt.NDArray[Any], *, jump: float, band_px: int) -> Bool:
    """Whether a step of `truth` larger than `jump` between neighbours lies within `band_px`; both sides of a step count as on it."""
    with np.errstate(invalid="ignore"):
        across = np.abs(np.diff(truth, axis=1)) > jump
        down = np.abs(np.diff(truth, axis=0)) > jump
    edge = np.zeros(truth.shape, dtype=bool)
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return grown(edge, band_px)
