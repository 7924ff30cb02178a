"""Matching along rows by adaptive support, led by semi-global matching (stereo/semi_global.py).

In: a `Proxy` (rectified, 8-bit, one tone).  Out: disparities (H, W) float32, x_left - x_right in pixels, NaN where
unmatched.  Disparities of both signs are normal: a converged rig has them on both sides of its convergence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.occlusion import beside, completed, consistent
from stereorelight.engine.rows import at_once
from stereorelight.engine.support import supported
from stereorelight.stereo.halves import half_proxy, nearest
from stereorelight.stereo.median import median_5
from stereorelight.stereo.periods import moved
from stereorelight.stereo.plains import carried_on, plain_ground
from stereorelight.stereo.proxy import CALM, Proxy, grey_of
from stereorelight.stereo.rims import on_rims
from stereorelight.stereo.semi_global import BLOCK, P2, DisparityRange, both_eyes, left_px, right_px, sgbm
from stereorelight.stereo.speckles import without_speckles
from stereorelight.stereo.walls import AS_IF_NOISE, matched_on_walls

SUPPORT_SPECKLE_PX = 40  # an island of disparity smaller than this is a wrong match, in clean plates
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
CALM_P2 = 12 * BLOCK**2  # of a jump on plain ground in calmed pictures, whose contrast is less: more carries what is near over such ground beside it
CALM_PLAIN, CALM_PLAIN_WINDOW = 5.0, (9, 9)  # grey levels per px along the row


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


def everywhere(disparity: Float32) -> Float32:
    """`disparity` with the background's value where it has none; a row that has none at all takes those of the nearest row that has."""
    known: Bool = np.isfinite(disparity)
    if known.all() or not known.any():
        return disparity
    ground, rows = beside(disparity), np.flatnonzero(known.any(axis=1))
    if rows.size < len(ground):
        ground = ground[rows[np.abs(np.arange(len(ground))[:, None] - rows).argmin(axis=1)]]
    return completed(disparity, median_5(ground))


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
    halved = half_proxy(proxy)
    # Clean ones go on to a quarter of the size, as long as much is plain there, too.
    small = match(halved, search.halved(), guided=halved.noise() < CALM)
    half = 2 * nearest(small.left, (left.shape[0], left.shape[1]))
    sure = nearest(consistent(small.left, small.right).view(np.uint8), (left.shape[0], left.shape[1])) > 0
    if clean:
        return np.where(plain & sure, half, left), True
    left = np.where(plain, left_px(loose, calm, search), left)
    with np.errstate(invalid="ignore"):
        stands = consistent(left, right_px(matcher, calm, search)) | (np.abs(left - half) <= HALF_AGREES_PX)
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
    stiff, loose = (sgbm(calm, search, exhaustive=exhaustive, stiffness=stiffness, jump=jump) for jump in (P2, CALM_P2))
    left_grey, right_grey = (proxy.left_grey, proxy.right_grey) if calm is proxy else (grey_of(calm.left), grey_of(calm.right))
    own = left_px(stiff if guided or calm is proxy else loose, calm, search) if led else None
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
        bare = bare_ground(proxy, calm.left)
        if np.mean(bare & np.isnan(own)) >= WALLS_LOST:
            left, right, walls = matched_on_walls(proxy, bare, own, everywhere(left), (left, right), grainy=calm is not proxy)
    return Match(left=left, right=right, dense=everywhere(left), calm=calm.left, on_rims=mended, on_walls=walls, led=own)


def bare_ground(proxy: Proxy, calm: UInt8) -> Bool:
    """(H, W): where the left picture shows nothing to match by; `calm`: with less grain, where there was too much of it.  Black beyond the plate is
    no wall."""
    return plain_ground(calm, max(AS_IF_NOISE, proxy.noise())) & proxy.left_known


def lost_on_bare_ground(proxy: Proxy, found: Match, *, within_px: float) -> float:
    """The share of the left picture that is bare and on which the eyes do not confirm each other `within_px`."""
    calm = proxy.left if found.calm is None else found.calm
    return float(np.mean(bare_ground(proxy, calm) & ~consistent(found.left, found.right, within_px=within_px)))
