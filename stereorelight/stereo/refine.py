"""From a dense disparity to one worth lighting: sub-pixel photometry, occluded ground, and local planes.

In: a `Proxy` and its dense disparity.  Out: a `Refined` disparity with slopes.  Each step is against one fault:
- variational refinement (Brox et al. 2004, OpenCV's) takes out the whole-pixel steps of the matcher;
- ground that the other eye cannot see takes the disparity of the background beside it, and every pixel on a depth edge
  that of the side it looks like: never a blend of actor and wall;
- a robust local plane takes out the noise that would turn normals, and leaves a slope per pixel;
- photometric planes (Lucas and Kanade 1981, over each pixel's own surface) take out what the first steps leave on plain
  ground: a bias of 0.1-0.3 px that follows the fraction of the disparity.  Wide windows first, since bias is wide."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.edges import joined_to_sides
from stereorelight.engine.occlusion import background, unseen
from stereorelight.engine.photometric import brightness_residual, measured_disparity
from stereorelight.engine.refine import Planes, blended, robust_planes
from stereorelight.stereo.proxy import Proxy


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """disparity and its slopes along x and y, each (H, W) float32; unseen: ground that the right eye cannot see."""

    disparity: Float32
    slope_x: Float32
    slope_y: Float32
    unseen: Bool


def sub_pixel(proxy: Proxy, disparity: Float32, *, smoothness: float = 10.0, gradient: float = 10.0, iterations: int = 2) -> Float32:
    """Variational refinement of `disparity` on the grey proxies; `smoothness` against brightness and `gradient` constancy."""
    left, right = (cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) for p in (proxy.left, proxy.right))
    refinement = cv2.VariationalRefinement_create()
    refinement.setAlpha(smoothness)
    refinement.setGamma(gradient)
    refinement.setFixedPointIterations(iterations)
    u, _ = refinement.calcUV(left, right, -disparity, np.zeros_like(disparity))
    return -u


@dataclass(frozen=True, kw_only=True)
class Round:
    """One round of photometric planes: half window, sampling step, weight of the disparity so far (1/px^2)."""

    radius: int
    stride: int
    prior: float


WIDE, WIDER = Round(radius=15, stride=5, prior=0.1), Round(radius=20, stride=5, prior=0.05)
NARROW, CLOSE = Round(radius=8, stride=2, prior=2.0), Round(radius=5, stride=1, prior=2.0)


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much refinement a quality buys.

    variational : steps of variational refinement; none where photometric planes do that work.
    passes      : of the first plane fit.   rounds : of photometric planes.
    """

    variational: int
    passes: int
    rounds: tuple[Round, ...]


EFFORTS = {
    "draft": Effort(variational=1, passes=2, rounds=()),
    "standard": Effort(variational=0, passes=1, rounds=(WIDE, NARROW)),
    "fine": Effort(variational=5, passes=2, rounds=(WIDER, NARROW, CLOSE)),
}
JUMP_PX = 1.5  # a step between neighbours that no surface worth lighting makes
FATTENING_PX = 3  # how far matching carries a near surface past its outline
LOCAL = (9, 9)  # window over which a difference of brightness between the eyes is exposure, not disparity
NOISE_FLOOR = 1.0  # grey levels: quantisation and resampling leave no less
UNSEEN_TRUST, UNSURE_TRUST = 0.02, 0.3


def photometric_planes(proxy: Proxy, planes: Planes, trust: Float32, this: Round, *, tau_px: float) -> Planes:
    """The local planes that make the two pictures agree best, each over its own surface within the round's window."""
    residual, rate = brightness_residual(proxy.left_grey, proxy.right_grey, planes[0])
    rate[trust <= UNSEEN_TRUST] = 0  # what the right eye does not see says nothing about it
    local = cv2.blur(residual, LOCAL)
    noise = max(NOISE_FLOOR, 1.4826 * float(np.median(np.abs(residual - local)[::4, ::4])))
    target, weight = measured_disparity(planes[0], residual, local, rate, trust, noise=noise, outlier=noise + 2, prior=this.prior)
    return robust_planes(planes[0], weight, radius=this.radius, stride=this.stride, tau_px=tau_px, slopes=planes[1:], target=target, passes=1)


def _from_rows_that_match(disparity: Float32, proxy: Proxy) -> Float32:
    """Where the right plate ends above or below (offset and rolled rigs), the nearest row that has something to match."""
    if proxy.right_known.all():
        return disparity
    height, width = disparity.shape
    lands = np.clip(np.rint(np.arange(width, dtype=np.float32) - disparity), 0, width - 1).astype(np.intp)
    known = np.take_along_axis(proxy.right_known, lands, axis=1)
    row = np.broadcast_to(np.arange(height)[:, None], disparity.shape)
    above = np.maximum.accumulate(np.where(known, row, -1), axis=0)
    below = np.minimum.accumulate(np.where(known, row, height)[::-1], axis=0)[::-1]
    take = np.where((above < 0) | ((below < height) & (below - row < row - above)), below, above)
    return np.take_along_axis(disparity, np.where((take < 0) | (take >= height), row, take), axis=0)


def _out_of_range(disparity: Float32, confirmed: Bool) -> Bool:
    """(H, W) bool: beyond everything that both eyes confirm; such a value is not even a guess."""
    sure = disparity[confirmed]
    if sure.size < 100:
        return np.zeros(disparity.shape, np.bool_)
    low, high = np.quantile(sure[:: max(1, sure.size // 50_000)], (0.001, 0.999))
    return (disparity < low - 0.5) | (disparity > high + 0.5)


def _ramps(disparity: Float32) -> UInt8:
    """(H, W) uint8, 1 where neighbours step by more than one surface would."""
    near = np.ones((3, 3), np.uint8)
    return (cv2.dilate(disparity, near) - cv2.erode(disparity, near) > JUMP_PX).view(np.uint8)


def _joined(disparity: Float32, proxy: Proxy) -> Float32:
    """`disparity` without the ramps and the fattening that matching leaves at depth edges: each pixel there joins the side it looks like."""
    zone = cv2.dilate(_ramps(disparity), np.ones((2 * FATTENING_PX + 1, 2 * FATTENING_PX + 1), np.uint8)) > 0
    joined = joined_to_sides(disparity, zone, proxy.left, jump_px=JUMP_PX)
    # Each pixel chose for itself; the median lets an outline be a line.
    outline = cv2.dilate(_ramps(joined), np.ones((3, 3), np.uint8)) > 0
    return np.where(outline, cv2.medianBlur(joined, 5), joined)


def _refilled(planes: Planes, lost: Bool, source: Bool) -> Planes:
    """Lost ground takes the refined background: filled from single raw matches, its rows would show as streaks."""
    behind = cv2.medianBlur(background(planes[0], source), 5)
    level = np.float32(0)
    return np.where(lost, behind, planes[0]), np.where(lost, level, planes[1]), np.where(lost, level, planes[2])


def refine(proxy: Proxy, dense: Float32, confirmed: Bool, *, effort: Effort = EFFORTS["standard"], tau_px: float = 0.5) -> Refined:
    """The refined disparity of the left eye.

    dense     : (H, W) disparity with a value everywhere.   confirmed : (H, W), the right eye says the same.
    tau_px    : how far off a plane a neighbour may lie and still belong to the surface.
    """
    fine = sub_pixel(proxy, dense, iterations=effort.variational) if effort.variational else dense
    fine = _from_rows_that_match(fine, proxy)
    lost = (unseen(fine) | _out_of_range(fine, confirmed)) & ~confirmed
    # The median takes out streaks: a row whose nearest match is wrong.
    filled = _joined(np.where(lost, cv2.medianBlur(background(fine, confirmed), 5), fine), proxy)
    trust = np.where(confirmed, np.float32(1), np.float32(UNSURE_TRUST))
    trust[lost] = UNSEEN_TRUST
    planes = robust_planes(filled, trust, radius=6, stride=3, tau_px=tau_px, passes=effort.passes)
    for this in effort.rounds:
        planes = photometric_planes(proxy, planes, trust, this, tau_px=tau_px)
    planes = blended(_refilled(planes, lost, confirmed), tau_px=tau_px)
    return Refined(disparity=planes[0], slope_x=planes[1], slope_y=planes[2], unseen=lost)
