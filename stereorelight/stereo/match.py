"""Matching along rows: the disparity range, semi-global matching (Hirschmüller 2008, OpenCV's SGBM), and matching by adaptive support.

In: a `Proxy` (rectified, 8-bit, one tone).  Out: disparities (H, W) float32, x_left - x_right in pixels, NaN where
unmatched.  Disparities of both signs are normal: a converged rig has them on both sides of its convergence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.camera import RectifiedRig
from stereorelight.engine.occlusion import beside, completed, consistent
from stereorelight.engine.rows import at_once
from stereorelight.engine.sixteenths import as_pixels
from stereorelight.engine.strips import LEAST_PX
from stereorelight.engine.support import supported
from stereorelight.errors import PlateError
from stereorelight.stereo.halves import half_proxy, nearest
from stereorelight.stereo.median import median_5
from stereorelight.stereo.order import BEHIND_LIMIT, BEHIND_PX, RIG_TELLS, behind_rig, votes
from stereorelight.stereo.periods import moved
from stereorelight.stereo.plains import carried_on, plain_ground
from stereorelight.stereo.proxy import CALM, Proxy, grey_of
from stereorelight.stereo.rims import on_rims
from stereorelight.stereo.speckles import without_speckles
from stereorelight.stereo.walls import AS_IF_NOISE, matched_on_walls

COARSE_WIDTH = 160  # pixels of the picture in which the range is looked for
STRIPS_WIDTH = 320  # and of that in which half-hidden strips are, where the range does not tell which eye is which
COARSE_REACH = 0.6  # of the frame's width: no disparity beyond it is looked for without a near_m
STRIPS_MARGIN_PX = 2.0  # beyond what the coarse matches hold, px of the finer copy
TAIL = 0.002  # share of believed matches at either end that does not widen the range
TEXTURE = 1.0  # grey levels a pixel: ground plainer than this proves nothing
FEWEST_MATCHES = 0.2  # share of textured ground that both eyes must confirm; noise against noise gives less than a tenth
BLOCK = 3
MOST_CELLS = 400_000_000  # pixels times disparities that eight directions are kept for, at about 4 bytes each
SPECKLE_PX = 60  # an island of disparity smaller than this is a wrong match
SUPPORT_SPECKLE_PX = 40  # the same of adaptive support, in clean plates
NOISY = 3.2  # grey levels of noise from which matching is made stiffer with it
HALF_SMALLEST_PX = 64  # of half a picture's side that is worth matching
HALF_AGREES_PX = 1.5  # whole half-size pixels cannot agree better
BEYOND_PX = 9  # width of ground without a plate that is no dead pixel or row
PLAIN, PLAIN_WINDOW = 4.0, (5, 5)  # grey levels per px along the row, root mean square about a pixel: plainer ground proves nothing
PLAIN_LOST = 0.06  # share of the picture that is plain and unmatched from which a clean pair is matched at half the size, too
WALLS_LOST = 0.02  # share of the picture that is plain and unmatched from which plain ground is put on planes
ALIKE = 0.25  # of the noise: neighbours that differ by less are alike to the census
CLEAN_STEP, CALM_STEP = 2.0, 1.5  # cost of a step of the census; of calm plates less, where more of its answers are chance
AGAIN_PULL, AGAIN_LIMIT = 4.0, 16.0  # of grainy plates' second look, to what both eyes said at the first
PERIOD_ROUNDS = 3  # of moving what lies a period off, and matching again
P1, P2 = 2 * BLOCK**2, 30 * BLOCK**2  # penalties of a step by one and of a jump, per channel: low for steps, since planes smooth later; high for
# jumps, since adaptive support finds the outlines and wants one answer on a wall that repeats
CALM_P2 = 12 * BLOCK**2  # of a jump on plain ground in calmed pictures, whose contrast is less: more carries what is near over such ground beside it
CALM_PLAIN, CALM_PLAIN_WINDOW = 5.0, (9, 9)  # grey levels per px along the row


@dataclass(frozen=True, kw_only=True)
class DisparityRange:
    """Whole pixels searched: low <= d < low + count; count is a multiple of 16, as SGBM wants it."""

    low: int
    count: int

    @classmethod
    def holding(cls, low_px: float, high_px: float) -> DisparityRange:
        low = int(np.floor(low_px))
        return cls(low=low, count=16 * max(1, -(-(int(np.ceil(high_px)) + 1 - low) // 16)))

    @property
    def high(self) -> int:
        return self.low + self.count

    def halved(self) -> DisparityRange:
        """The range in pixels of half the size."""
        return DisparityRange.holding(self.low / 2, self.high / 2)

    def doubled(self) -> DisparityRange:
        """The range in pixels of twice the size."""
        return DisparityRange(low=2 * self.low, count=2 * self.count)


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """What matching says of a pair.

    left, right : each eye's own disparity, NaN where unmatched.
    calm        : the left picture with less grain, where there was too much of it.
    dense       : the left one with a value everywhere.
    on_rims     : pixels of the left one that took the plane of the rims about them; None where there are none.
    on_walls    : pixels of the left one that were put on the plane of plain ground; None where none were.
    led         : what semi-global matching alone says of the left eye, NaN where it says nothing; None where it was not asked.
    """

    left: Float32
    right: Float32
    dense: Float32
    calm: UInt8 | None = None
    on_rims: Bool | None = None
    on_walls: Bool | None = None
    led: Float32 | None = None


def _raw(matcher: Any, picture: UInt8, other: UInt8, *, before: int, after: int) -> npt.NDArray[np.int16]:
    """The matcher's sixteenths on `picture`, with so many columns repeated before and after the frame.

    SGBM drops the columns whose candidates leave the frame: room for them is needed on the side where they leave, and harms
    on the other, where repeated columns match repeated columns.
    """
    a, b = (cv2.copyMakeBorder(p, 0, 0, before, after, cv2.BORDER_REPLICATE) for p in (picture, other))
    raw: npt.NDArray[np.int16] = matcher.compute(a, b)[:, before : before + picture.shape[1]]
    return np.ascontiguousarray(raw)


def everywhere(disparity: Float32) -> Float32:
    """`disparity` with the background's value where it has none; a row that has none at all takes those of the nearest row that has."""
    known: Bool = np.isfinite(disparity)
    if known.all() or not known.any():
        return disparity
    ground, rows = beside(disparity), np.flatnonzero(known.any(axis=1))
    if rows.size < len(ground):
        ground = ground[rows[np.abs(np.arange(len(ground))[:, None] - rows).argmin(axis=1)]]
    return completed(disparity, median_5(ground))


def _matcher(proxy: Proxy, search: DisparityRange, *, exhaustive: bool = False, stiffness: float = 1.0, jump: int = P2) -> cv2.StereoSGBM:
    channels = proxy.left.shape[2] if proxy.left.ndim == 3 else 1
    cells = proxy.left.shape[0] * (proxy.left.shape[1] + search.count) * search.count
    mode = cv2.STEREO_SGBM_MODE_HH4 if exhaustive and cells <= MOST_CELLS else cv2.STEREO_SGBM_MODE_SGBM_3WAY
    step = round(P1 * channels * stiffness)
    return cv2.StereoSGBM_create(search.low, search.count, BLOCK, step, jump * channels, 1, 63, 0, SPECKLE_PX, 1, mode)


def _left_px(matcher: cv2.StereoSGBM, proxy: Proxy, search: DisparityRange) -> Float32:
    raw = _raw(matcher, proxy.left, proxy.right, before=max(0, search.high), after=max(0, -search.low))
    return as_pixels(raw, search.low)


def both_eyes(proxy: Proxy, search: DisparityRange) -> tuple[Float32, Float32]:
    """Each eye's own disparity by SGBM alone, three directions: quick, and stiff.  For small copies."""
    matcher = _matcher(proxy, search)
    return at_once(lambda: _left_px(matcher, proxy, search), lambda: _right_px(_matcher(proxy, search), proxy, search))


def semi_global(proxy: Proxy, search: DisparityRange) -> Match:
    """`both_eyes` as a `Match`."""
    left, right = both_eyes(proxy, search)
    return Match(left=left, right=right, dense=everywhere(left))


def on_plates(left: Float32, right: Float32, proxy: Proxy) -> tuple[Float32, Float32]:
    """Each eye's disparity, NaN beyond its rectified plate: what was matched there is chance, and no ground to fill from.

    Broken pixels and rows within the plate are matched by what stands about them, and keep it: beyond is what is as wide as `BEYOND_PX`, or
    near what is, the frame's own outside counting as beyond.
    """

    def of(disparity: Float32, known: Bool) -> Float32:
        if known.all():
            return disparity
        wide, near = np.ones((BEYOND_PX,) * 2, np.uint8), np.ones((2 * BEYOND_PX - 1,) * 2, np.uint8)
        gone = cv2.copyMakeBorder((~known).view(np.uint8), *(BEYOND_PX,) * 4, cv2.BORDER_CONSTANT, value=1)
        beyond = cv2.dilate(cv2.erode(gone, wide), near) & gone
        return np.where(beyond[BEYOND_PX:-BEYOND_PX, BEYOND_PX:-BEYOND_PX], np.float32(np.nan), disparity)

    return of(left, proxy.left_known), of(right, proxy.right_known)


def _right_px(matcher: cv2.StereoSGBM, proxy: Proxy, search: DisparityRange) -> Float32:
    raw = _raw(cv2.ximgproc.createRightMatcher(matcher), proxy.right, proxy.left, before=max(0, -search.low), after=max(0, search.high))
    return as_pixels(raw, 1 - search.high, sign=-1)  # the right matcher counts x_right - x_left


def _plain(grey: Float32, most: float, window: tuple[int, int]) -> Bool:
    """(H, W): ground that has nothing to hold a match by along its row."""
    steep = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8)
    return cv2.blur(steep * steep, window) < most**2


def _guide(left: Float32, matcher: cv2.StereoSGBM, loose: cv2.StereoSGBM, proxy: Proxy, calm: Proxy, search: DisparityRange) -> tuple[Float32, bool]:
    """What leads adaptive support: SGBM's left answer, and that of half the size under grain or where much of the picture is plain; and
    whether that is what it is, and the picture clean.

    Half the size has a quarter of the noise, and the rims of plain ground are nearer there; it is blind to what is thin.  Under grain it
    speaks where SGBM's right answer does not confirm the left one, which on plain ground is that of `loose`, to which a jump costs less.  In
    clean plates it speaks on plain ground, and only where SGBM is lost on a good part of the picture: elsewhere the full size knows better
    (docs/decisions/0028-plain-ground.md, 0040-grain-matched-twice.md).
    """
    if min(left.shape) < 2 * HALF_SMALLEST_PX:
        return left, False
    clean, lost = calm is proxy, np.isnan(left)
    if clean and np.mean(lost) < PLAIN_LOST:
        return left, False
    plain = _plain(proxy.left_grey, PLAIN, PLAIN_WINDOW) if clean else _plain(grey_of(calm.left), CALM_PLAIN, CALM_PLAIN_WINDOW)
    if clean and np.mean(plain & lost) < PLAIN_LOST:
        return left, False
    small = match(half_proxy(proxy), search.halved(), guided=clean)  # clean plates go on to a quarter of the size, as long as it is plain, too
    half = 2 * nearest(small.left, (left.shape[0], left.shape[1]))
    sure = nearest(consistent(small.left, small.right).view(np.uint8), (left.shape[0], left.shape[1])) > 0
    if clean:
        return np.where(plain & sure, half, left), True
    left = np.where(plain, _left_px(loose, calm, search), left)
    with np.errstate(invalid="ignore"):
        stands = consistent(left, _right_px(matcher, calm, search)) | (np.abs(left - half) <= HALF_AGREES_PX)
    return np.where(stands, left, np.where(sure, half, np.float32(np.nan))), False


def _on_rims(left_grey: Float32, right_grey: Float32, left: Float32, right: Float32) -> tuple[Float32, Float32]:
    """Both eyes' disparities with plain patches on the planes of their rims (docs/decisions/0048-rims-and-doubt.md)."""

    def flipped(a: Float32) -> Float32:
        return np.ascontiguousarray(a[:, ::-1])

    def of_right() -> Float32:
        mirrored = flipped(right)
        return flipped(np.where(np.isnan(mirrored), mirrored, on_rims(flipped(right_grey), flipped(left_grey), everywhere(mirrored))))

    mine, theirs = at_once(lambda: on_rims(left_grey, right_grey, everywhere(left)), of_right)
    return np.where(np.isnan(left), left, mine), theirs


def match(proxy: Proxy, search: DisparityRange, *, exhaustive: bool = False, guided: bool = True, led: bool = True) -> Match:
    """Match both eyes by adaptive support, led by what SGBM says of the left one.

    The one holds plain ground together, the other keeps each thing's own outline (docs/decisions/0018-adaptive-support.md).
    exhaustive : eight directions of SGBM in place of three; slower, and much more memory: three where that would be more than about 2 GB.
    guided     : grainy and plain plates are matched at half the size, too, for where the full size finds nothing sure.
    led        : by SGBM at all; without it a quarter of the time is saved, and more of a wall that repeats is found a period off.
    What repeats and was found a period off is moved (docs/decisions/0062-walls-that-repeat.md).  Plain ground on which SGBM is
    lost is put on planes (docs/decisions/0065-plain-walls.md).
    """
    noise = proxy.noise()
    calm = proxy.calmed()
    step = CLEAN_STEP if calm is proxy and guided else CALM_STEP
    stiffness = float(np.clip(noise / NOISY, 1, 2))
    stiff, loose = (_matcher(calm, search, exhaustive=exhaustive, stiffness=stiffness, jump=jump) for jump in (P2, CALM_P2))
    left_grey, right_grey = (proxy.left_grey, proxy.right_grey) if calm is proxy else (grey_of(calm.left), grey_of(calm.right))
    own = _left_px(stiff if guided or calm is proxy else loose, calm, search) if led else None
    given, plain = own, False
    if own is not None and guided:
        given, plain = _guide(own, stiff, loose, proxy, calm, search)
    alike = max(1.0, ALIKE * noise)
    look = partial(supported, calm.left, left_grey, right_grey, search.low, search.count, alike=alike, step=step)
    left, right = look(given=given)
    speckle_px = SUPPORT_SPECKLE_PX * float(np.clip(noise / CALM, 1, 3))
    if calm is not proxy and guided and led:
        speckle_px = SUPPORT_SPECKLE_PX
        carried, changed = carried_on(proxy.left_grey, proxy.right_grey, calm.left, left, noise=noise, grain2=sum(grain**2 for grain in proxy.grains))
        given = np.where(changed | consistent(left, right), carried, np.float32(np.nan))
        look = partial(look, pull=AGAIN_PULL, limit=AGAIN_LIMIT)
        again, right = look(given=given)
        left = np.where(np.abs(again - left) <= 0.5, left, again)  # the pull draws parts of a pixel to whole ones
    for _ in range(0 if plain else PERIOD_ROUNDS):  # bare ground repeats, too, and has nothing to tell by
        there = moved(left_grey, right_grey, left, search.low, search.count)
        if there is None:
            break
        given = there if given is None else np.where(np.isnan(there), given, there)
        left, right = look(given=given)
    left, right = on_plates(left, right, proxy)
    left = without_speckles(left, round(speckle_px))
    mended = None
    if plain:
        as_matched = left
        left, right = _on_rims(left_grey, right_grey, left, right)
        mended = np.isfinite(left) & (left != as_matched)
    walls = None
    if own is not None:
        bare = plain_ground(calm.left, max(AS_IF_NOISE, noise)) & proxy.left_known  # black beyond the plate is no wall
        if np.mean(bare & np.isnan(own)) >= WALLS_LOST:
            left, right, walls = matched_on_walls(proxy, bare, own, everywhere(left), (left, right), grainy=calm is not proxy)
    return Match(left=left, right=right, dense=everywhere(left), calm=calm.left, on_rims=mended, on_walls=walls, led=own)


def _coarse(proxy: Proxy, wide_px: int = COARSE_WIDTH) -> tuple[Proxy, float]:
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
    coarse, scale = _coarse(proxy)
    seen, other = both_eyes(coarse, DisparityRange.holding(search.low * scale, search.high * scale))
    seen = np.where(consistent(seen, other, within_px=0.75), seen / np.float32(scale), np.float32(np.nan))
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
    fine, _ = _coarse(proxy, STRIPS_WIDTH)
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


def search_range(proxy: Proxy, rig: RectifiedRig, *, near_m: float | None = None, far_m: float | None = None) -> DisparityRange:
    """Which disparities to search: from near and far where given, else from the pictures themselves.

    A small copy is matched over everything that the frame allows; the range holds all but the last 0.2 % of the matches
    that both eyes confirm on textured ground, with a margin.
    With both near and far given nothing is judged.
    Raises : PlateError when the eyes look swapped or there is nothing to match.
    """
    low = None if far_m is None else float(rig.disparity_from_depth(far_m)) - 1
    high = None if near_m is None else float(rig.disparity_from_depth(near_m)) + 1
    if low is not None and high is not None:
        return DisparityRange.holding(low, high)
    coarse, scale = _coarse(proxy)
    width = coarse.left.shape[1]
    infinity = -rig.doffs_px * scale
    reach = COARSE_REACH * width
    wide = DisparityRange.holding(infinity - reach / 3, infinity + reach)
    found, other = both_eyes(coarse, wide)
    textured = coarse.left_known & (np.abs(cv2.Scharr(coarse.left_grey, cv2.CV_32F, 1, 0)) / 32 > TEXTURE)
    believed = consistent(found, other, within_px=0.75) & textured
    d = found[believed]
    if d.size < max(FEWEST_MATCHES * textured.sum(), 50):
        raise PlateError("left and right plates hardly match anywhere; are they swapped, of another moment, or of another rig?")
    _refuse_swapped(proxy, coarse, (found, other), believed, infinity)
    d = d[d >= infinity - BEHIND_PX]
    lowest, highest = np.quantile(d, (TAIL, 1 - TAIL))
    margin = 0.75 + 0.03 * (highest - lowest)
    if low is None:
        low = max(float(lowest - margin), infinity - 0.5) / scale
    if high is None:
        high = float(highest + margin) / scale
    if low >= high:
        raise PlateError(f"near_m/far_m leave no disparity to search (from {low:.1f} to {high:.1f} px); check them against the rig's baseline")
    return DisparityRange.holding(low, high)
