"""Which eye is which: whether a pair's left plate is its right one.

In: disparities that both eyes confirm, px of a small copy, x_left - x_right.  Out: a verdict in words, or None.

The rig says it first.  Nothing lies behind infinity; with the eyes exchanged all disparities change their signs, and where much would lie
behind it then, the eyes are the right way round.  A pair that converges, by its cameras or by a crop, may lie before infinity either way: then
half-hidden strips tell, which look like the surface behind them (`engine.strips`).  How much the eyes confirm of each other, and where the
strips lie, is the same either way (docs/decisions/0060-which-eye-is-which.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.occlusion import consistent
from stereorelight.engine.rows import at_once
from stereorelight.engine.strips import strip_votes
from stereorelight.errors import PlateError
from stereorelight.stereo.proxy import Proxy

BEHIND_LIMIT = 0.6  # share of believed matches behind the rig at which the eyes must be swapped, whatever else is seen
BEHIND_PX = 1.5  # behind infinity by more than a match's own error
RIG_TELLS = 0.1  # more of the matches behind the rig with the eyes exchanged than as they are: left is left
SETTLED, DOUBT = 0.8, 1.0  # of strips that vote (`engine.strips.strip_votes`)
STRIPS_SURE, STRIPS_OF_AN_EYE = 60, 15  # that must speak, together and in either eye, before eyes are called swapped
SHARE, SHARE_OF_AN_EYE = 0.7, 0.6  # of them that speak for it; a shadow beside a thing may mislead one eye, not both
STRIPS_FEW = 10  # of which most must speak against it, and no more are looked for
SMOOTH_PX = 0.7


@dataclass(frozen=True, kw_only=True)
class Votes:
    """Half-hidden strips of the left and of the right eye: those like the side which matching puts behind, and like that in front."""

    behind: tuple[int, int]
    before: tuple[int, int]

    @property
    def swapped(self) -> bool:
        """Whether they say so: many, nearly all, in either eye."""
        counts = [a + b for a, b in zip(self.behind, self.before, strict=True)]
        if sum(counts) < STRIPS_SURE or min(counts) < STRIPS_OF_AN_EYE:
            return False
        return sum(self.before) > SHARE * sum(counts) and all(b > SHARE_OF_AN_EYE * n for b, n in zip(self.before, counts, strict=True))

    @property
    def right(self) -> bool:
        """Whether most speak for left being left.  A few are enough: nothing is refused by it."""
        return sum(self.behind) > sum(self.before) and sum(self.behind) + sum(self.before) >= STRIPS_FEW


def one_picture(left: Float32, right: Float32) -> bool:
    """Whether both plates (H, W, 3) are one picture, as it is or as a mirror's: one eye's file given twice.

    Two eyes never see the same to the last bit.  Plates without any picture are no answer: False.
    """
    if left.shape != right.shape:
        return False
    some = np.s_[::16, ::16]
    for other in (right, right[:, ::-1]):
        if np.array_equal(left[some], other[some], equal_nan=True) and np.array_equal(left, other, equal_nan=True):
            seen = left[np.isfinite(left)]
            return bool(seen.size and np.ptp(seen) > 0)
    return False


def refuse_one_picture(left: Float32, right: Float32) -> None:
    """Raise PlateError for `one_picture`: its depth would be a plane."""
    if one_picture(left, right):
        raise PlateError("left and right plates are one picture, bit for bit; give each eye its own")


def behind_rig(disparity: npt.NDArray[np.floating], infinity_px: float) -> tuple[float, float]:
    """Shares of matches (n,) behind the rig, as the plates are and with the eyes exchanged."""
    return float(np.mean(disparity < infinity_px - BEHIND_PX)), float(np.mean(disparity > -infinity_px + BEHIND_PX))


def votes(proxy: Proxy, small: Proxy, left_px: Float32, right_px: Float32) -> Votes:
    """What the half-hidden strips of either eye look like: in the colours of `proxy`, by each eye's own disparity (H, W) on a `small` grey copy."""

    def turned(a: npt.NDArray[Any], mirrored: bool) -> npt.NDArray[Any]:
        return np.ascontiguousarray(a[:, ::-1]) if mirrored else a

    def of_eye(picture: UInt8, own: Float32, other: Float32, known: Bool, mirrored: bool) -> tuple[int, int]:
        colours = cv2.resize(picture, known.shape[::-1], interpolation=cv2.INTER_AREA)
        colours = turned(np.atleast_3d(cv2.GaussianBlur(colours, (0, 0), SMOOTH_PX)), mirrored)
        own, other = turned(own, mirrored), turned(other, mirrored)
        confirmed = np.where(consistent(own, other), own, np.float32(np.nan))
        return strip_votes(colours, confirmed, turned(known, mirrored), settled=SETTLED, doubt=DOUBT)

    # The right eye's strips, seen in a mirror, lie as the left one's do.
    (left_behind, left_before), (right_behind, right_before) = at_once(
        lambda: of_eye(proxy.left, left_px, right_px, small.left_known, False),
        lambda: of_eye(proxy.right, right_px, left_px, small.right_known, True),
    )
    return Votes(behind=(left_behind, right_behind), before=(left_before, right_before))
