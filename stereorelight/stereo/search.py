"""Which disparities to search, from the pictures themselves, and whether the eyes are swapped.

In: a `Proxy` and its rectified rig.  Out: a `DisparityRange`; the rough disparity of a small copy."""

from __future__ import annotations

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.camera import RectifiedRig
from stereorelight.engine.occlusion import consistent
from stereorelight.engine.strips import LEAST_PX
from stereorelight.errors import PlateError
from stereorelight.stereo.order import BEHIND_LIMIT, BEHIND_PX, RIG_TELLS, behind_rig, votes
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.semi_global import DisparityRange, both_eyes

COARSE_WIDTH = 160  # pixels of the picture in which the range is looked for
BARE_WIDTH = 240  # and of that in which ground is looked at that shows nothing in the first
STRIPS_WIDTH = 320  # and of that in which half-hidden strips are, where the range does not tell which eye is which
COARSE_REACH = 0.6  # of the frame's width: no disparity beyond it is looked for without a near_m
STRIPS_MARGIN_PX = 2.0  # beyond what the coarse matches hold, px of the finer copy
CONFIRMS_PX = 0.75  # of a copy
TAIL = 0.002  # share of believed matches at either end that does not widen the range
TEXTURE = 1.0  # grey levels a pixel: ground plainer than this proves nothing
FEWEST_MATCHES = 0.2  # share of textured ground that both eyes must confirm; noise against noise gives less than a tenth
BARE_PX, LEAST_BARE = 9, 0.03  # ground without a say: farther than half of this from all that has one, and this share of the picture
HELD = 0.75  # share of such ground that a finer copy must match: grain against grain gives half, at most 0.7
BARE_TAIL = 0.02  # as `TAIL`, of bare ground


def coarse_copy(proxy: Proxy, wide_px: int = COARSE_WIDTH) -> tuple[Proxy, float]:
    """A small grey copy, and its scale."""
    height, width = proxy.left_grey.shape
    scale = min(1.0, wide_px / width)
    size = (max(16, round(width * scale)), max(16, round(height * scale)))

    def small(a: Float32) -> Float32:
        return cv2.resize(a, size, interpolation=cv2.INTER_AREA)

    def known(a: Bool) -> Bool:
        return np.ones(size[::-1], np.bool_) if a.all() else cv2.resize(a.view(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) == 255

    left, right = small(proxy.left_grey), small(proxy.right_grey)
    shrunk = Proxy(
        left=np.rint(left).astype(np.uint8),
        right=np.rint(right).astype(np.uint8),
        left_grey=left,
        right_grey=right,
        left_known=known(proxy.left_known),
        right_known=known(proxy.right_known),
    )
    return shrunk, size[0] / width


def coarse_disparity(proxy: Proxy, search: DisparityRange) -> Float32:
    """(H, W) px on the left view, good to a pixel or so, NaN where the eyes do not confirm each other: what both of them see.

    Matched on a small copy: a few milliseconds, for whoever must know which pixels belong together and not how far they are.
    """
    coarse, scale = coarse_copy(proxy)
    seen, other = both_eyes(coarse, DisparityRange.holding(search.low * scale, search.high * scale))
    seen = np.where(consistent(seen, other, within_px=CONFIRMS_PX), seen / np.float32(scale), np.float32(np.nan))
    height, width = proxy.left_grey.shape
    return cv2.resize(seen.astype(np.float32), (width, height), interpolation=cv2.INTER_NEAREST)


def _refuse_swapped(proxy: Proxy, coarse: Proxy, eyes: tuple[Float32, Float32], believed: Bool, infinity: float) -> None:
    """Raise PlateError where the left plate is the right eye's: by the matches of a coarse copy, and where they and its half-hidden strips leave
    it open by the strips of a finer one.

    eyes : each eye's own disparity on `coarse`, of which those of the left one are `believed`.     infinity : px of it.
    """
    remedy = "exchange them ([plates] swap_eyes in a shot file), or the eyes in the rig"
    d = eyes[0][believed]
    behind, exchanged = behind_rig(d, infinity)
    if behind > BEHIND_LIMIT:
        raise PlateError(f"{100 * behind:.0f} % of the matches lie behind the rig: left and right plates look swapped; {remedy}")
    if exchanged > behind + RIG_TELLS or votes(proxy, coarse, *eyes).right:
        return
    fine, _ = coarse_copy(proxy, STRIPS_WIDTH)
    finer = fine.left.shape[1] / coarse.left.shape[1]
    low, high = (float(q) * finer for q in np.quantile(d, (TAIL, 1 - TAIL)))
    if high - low < LEAST_PX:  # no room for a strip
        return
    told = votes(proxy, fine, *both_eyes(fine, DisparityRange.holding(low - STRIPS_MARGIN_PX, high + STRIPS_MARGIN_PX)))
    if told.swapped:
        before, total = sum(told.before), sum(told.before) + sum(told.behind)
        raise PlateError(
            f"left and right plates look swapped: {before} of {total} strips that one eye alone sees look like what stands before them; {remedy}; "
            "if they are right, give near_m and far_m"
        )


def _of_bare_ground(proxy: Proxy, coarse: Proxy, believed: Bool, infinity: float) -> list[tuple[float, float]]:
    """The least and the largest disparity, px of `coarse`, of each wide piece of ground that has no say there.

    A wall behind an actor may show nothing at a twelfth of its size and enough at an eighth.  What stands before such ground has outlines, which
    are believed; the ground itself has none, and its edges may be outside the frame.
    believed : what has a say.     infinity : px of `coarse`.
    """
    bare = coarse.left_known & (cv2.dilate(believed.view(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    inside = cv2.erode(bare.view(np.uint8), np.ones((BARE_PX, BARE_PX), np.uint8))
    count, pieces, about, _ = cv2.connectedComponentsWithStats(inside)
    wide = [k for k in range(1, count) if about[k, cv2.CC_STAT_AREA] >= LEAST_BARE * bare.size]
    if not wide:
        return []
    finer, _ = coarse_copy(proxy, BARE_WIDTH)
    times = finer.left.shape[1] / coarse.left.shape[1]
    left, right = both_eyes(finer, DisparityRange.holding(times * infinity - 0.5, times * infinity + COARSE_REACH * finer.left.shape[1]))
    sure = np.where(consistent(left, right, within_px=CONFIRMS_PX), left, np.float32(np.nan))
    pieces = cv2.resize(pieces.astype(np.float32), (left.shape[1], left.shape[0]), interpolation=cv2.INTER_NEAREST)
    found = []
    for k in wide:
        there = sure[pieces == k]
        if np.mean(np.isfinite(there)) >= HELD:
            low, high = np.nanquantile(there, (BARE_TAIL, 1 - BARE_TAIL)) / times
            found.append((float(low), float(high)))
    return found


def search_range(proxy: Proxy, rig: RectifiedRig, *, near_m: float | None = None, far_m: float | None = None) -> DisparityRange:
    """Which disparities to search: from near and far where given, else from the pictures themselves.

    A small copy is matched over everything that the frame allows; the range holds all but the last 0.2 % of the matches
    that both eyes confirm on textured ground, with a margin, and what a finer copy finds on wide ground without texture.
    With both near and far given nothing is judged.
    Raises : PlateError when the eyes look swapped or there is nothing to match.
    """
    low = None if far_m is None else float(rig.disparity_from_depth(far_m)) - 1
    high = None if near_m is None else float(rig.disparity_from_depth(near_m)) + 1
    if low is not None and high is not None:
        return DisparityRange.holding(low, high)
    coarse, scale = coarse_copy(proxy)
    width = coarse.left.shape[1]
    infinity = -rig.doffs_px * scale
    reach = COARSE_REACH * width
    wide = DisparityRange.holding(infinity - reach / 3, infinity + reach)
    found, other = both_eyes(coarse, wide)
    textured = coarse.left_known & (np.abs(cv2.Scharr(coarse.left_grey, cv2.CV_32F, 1, 0)) / 32 > TEXTURE)
    believed = consistent(found, other, within_px=CONFIRMS_PX) & textured
    d = found[believed]
    if d.size < max(FEWEST_MATCHES * textured.sum(), 50):
        raise PlateError("left and right plates hardly match anywhere; are they swapped, of another moment, or of another rig?")
    _refuse_swapped(proxy, coarse, (found, other), believed, infinity)
    d = d[d >= infinity - BEHIND_PX]
    lowest, highest = (float(q) for q in np.quantile(d, (TAIL, 1 - TAIL)))
    for low_there, high_there in _of_bare_ground(proxy, coarse, believed, infinity):
        lowest, highest = min(lowest, low_there), max(highest, high_there)
    margin = 0.75 + 0.03 * (highest - lowest)
    if low is None:
        low = max(lowest - margin, infinity - 0.5) / scale
    if high is None:
        high = (highest + margin) / scale
    if low >= high:
        raise PlateError(f"near_m/far_m leave no disparity to search (from {low:.1f} to {high:.1f} px); check them against the rig's baseline")
    return DisparityRange.holding(low, high)
