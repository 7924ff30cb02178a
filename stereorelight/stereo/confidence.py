"""How far to believe each disparity, and why some are only guesses.

In: the match, the refined disparity and the flow's second opinion.  Out: confidence (H, W), the share of such pixels
within 1 px of truth, and reason flags.  The evidence: the right eye confirms the match, here and round about; the flow confirms
it, here and round about; no edge is near; the refinement's own standard deviation, which knows noise and texture; what is left
between the eyes there, beside the plates' grain; and whether they share anything but grain.
A logistic regression weighs it.  Its coefficients were fitted on synthetic shots; docs/depth.md shows the check on
footage that had no part in the fit.  The same evidence gives the standard deviation of the disparity."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt16
from stereorelight.engine.photometric import believed, brightness_residual
from stereorelight.engine.rows import at_once, in_row_blocks
from stereorelight.passes import Flag
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.refine import Refined

EVIDENCE = (
    "always",
    "confirmed",
    "flow agrees",
    "edge nearby",
    "log sigma",
    "confirmed nearby",
    "flow agrees nearby",
    "edge nearby x confirmed nearby",
    "edge nearby x flow agrees nearby",
    "log misfit",
    "eyes share nothing",
)
COEFFICIENTS = np.array([2.944, 1.359, -0.095, -0.838, -1.949, 1.441, 0.304, -1.394, -0.873, -0.415, -3.6], dtype=np.float32)
FLOOR, LOWER = 0.6, 0.3  # by which ground of which nothing is known but what lies beside it is told right; and where the eyes share nothing
# log(standard deviation / 0.03 px) as always, log of the refinement's own, log of doubt, log of how far errors hang together.
SIGMA_COEFFICIENTS = (0.933, 0.987, 0.531, 0.325)
MOST_SIGMA_PX = 8.0
WINDOW = (7, 7)
CONFIRMED_NEARBY, FLOW_NEARBY = (9, 9), (15, 15)
MISFIT = (5, 5)
LEAST_GRAIN = 0.5  # grey levels
SHARED = (5, 5)  # half-size px
LEAST_SHOWN = 0.2  # of the grain's variance: less is as good as nothing to share
ENOUGH_SHARED = 0.5  # correlation from which eyes count as showing the same
USUALLY_CLUMPED, LEAST_CLUMPED = 0.5, 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What speaks for and against each pixel of a refined disparity; every array (H, W) float32.

    confirmed, flow_agrees               : 1 where the right eye, the flow say the same, else 0.
    confirmed_nearby, flow_agrees_nearby : the share of the pixels about it where they do.
    misfit  : variance of what is left between the eyes over 5 x 5, over that of the plates' grain; an even difference counts nothing.
    alone   : 1 where the eyes share nothing of what they show round about, 0 where their correlation is `ENOUGH_SHARED` or more.
    spread  : range of disparity nearby, px.   sigma : the refinement's own, px.   clumped : `Refined`'s.
    """

    confirmed: Float32
    flow_agrees: Float32
    confirmed_nearby: Float32
    flow_agrees_nearby: Float32
    misfit: Float32
    alone: Float32
    spread: Float32
    sigma: Float32
    clumped: Float32


def alone(left: Float32, right: Float32, grain: float) -> Float32:
    """(H, W), 0..1: how far two pictures that should be one share nothing, grain averaged away: 1 - r / `ENOUGH_SHARED`, r their correlation.

    Where grain outweighs texture, any surface is left with grain alone, and a wrong one is as smooth and as well confirmed as a right one; but
    the little that is not grain is then not the same.
    """
    size = ((left.shape[1] + 1) // 2, (left.shape[0] + 1) // 2)
    a, b = (cv2.blur(cv2.resize(eye, size, interpolation=cv2.INTER_AREA), (3, 3)) for eye in (left, right))
    mean_a, mean_b = cv2.blur(a, SHARED), cv2.blur(b, SHARED)
    both = cv2.blur(a * b, SHARED) - mean_a * mean_b + np.float32(LEAST_SHOWN * LEAST_GRAIN**2)  # clean ground with nothing to show is no doubt
    least = np.float32(LEAST_SHOWN * grain * grain)
    shown = [np.maximum(cv2.blur(eye * eye, SHARED) - mean * mean, 0) + least for eye, mean in ((a, mean_a), (b, mean_b))]
    less = np.clip(1 - both / (np.float32(ENOUGH_SHARED) * np.sqrt(shown[0] * shown[1])), 0, 1)
    return cv2.resize(less, (left.shape[1], left.shape[0]), interpolation=cv2.INTER_LINEAR)


def _lands_on_plate(disparity: Float32, right_known: Bool) -> Bool:
    """(H, W): what is seen there lies within the right eye's plate, where that is known."""
    width = disparity.shape[1]
    lands = np.floor(np.arange(width, dtype=np.float32) - disparity + 0.5)
    within: Bool = (lands >= 0) & (lands < width)
    if not right_known.all():
        within &= np.take_along_axis(right_known, np.where(within, lands, 0).astype(np.intp), axis=1)
    return within


def evidence(proxy: Proxy, refined: Refined, confirmed: Bool, flow: Float32 | None) -> Evidence:
    """Gather the evidence; `flow` None counts as a second opinion that agrees wherever the right eye does."""
    d = refined.disparity
    residual = brightness_residual(proxy.left_grey, proxy.right_grey, d)[0]
    near = np.ones(WINDOW, np.uint8)
    sure = confirmed.astype(np.float32)

    def said() -> tuple[Float32, Float32, Float32, Float32]:
        with np.errstate(invalid="ignore"):
            agrees = sure if flow is None else (np.abs(flow - d) <= 1).astype(np.float32)
        return agrees, cv2.blur(sure, CONFIRMED_NEARBY), cv2.blur(agrees, FLOW_NEARBY), cv2.dilate(d, near) - cv2.erode(d, near)

    def seen() -> tuple[Float32, Float32]:
        mean = cv2.blur(residual, MISFIT)
        left_over = np.maximum(cv2.blur(residual * residual, MISFIT) - mean * mean, np.float32(0))
        grain = max(proxy.grains[0], LEAST_GRAIN)
        speaks = _lands_on_plate(d, proxy.right_known) & proxy.left_known & ~refined.unseen
        other = np.where(speaks, proxy.left_grey - residual, proxy.left_grey)  # what one eye alone can see speaks neither way
        return left_over / np.float32(2 * grain * grain), alone(proxy.left_grey, other, grain)

    (agrees, confirmed_nearby, agrees_nearby, spread), (misfit, lonely) = at_once(said, seen)
    return Evidence(
        confirmed=sure,
        flow_agrees=agrees,
        confirmed_nearby=confirmed_nearby,
        flow_agrees_nearby=agrees_nearby,
        misfit=misfit,
        alone=lonely,
        spread=spread,
        sigma=refined.sigma_px,
        clumped=refined.clumped,
    )


def confidence_from_evidence(e: Evidence, coefficients: Float32 = COEFFICIENTS) -> Float32:
    """(H, W) float32, 0..1: among pixels of confidence c a share of about c is within 1 px of truth."""
    nearby = (e.confirmed_nearby, e.flow_agrees_nearby)
    return believed(coefficients, e.confirmed, e.flow_agrees, *nearby, e.spread, e.sigma, e.misfit, e.alone, floors=(FLOOR, LOWER))


def sigma_from_evidence(e: Evidence, confidence: Float32, coefficients: tuple[float, float, float, float] = SIGMA_COEFFICIENTS) -> Float32:
    """(H, W) px: the standard deviation of the disparity; 68 % of such pixels are within it, as the synthetic shots were.

    The refinement's own sigma knows noise and bend, and takes pixels for independent; this adds what it cannot know: a wrong surface, and
    errors that hang together.
    """
    always, own, doubt, together = (np.float32(c) for c in coefficients)
    out = np.empty_like(confidence)

    def run(first: int, end: int) -> None:
        rows = slice(first, end)
        log = always + own * np.log(np.maximum(e.sigma[rows], np.float32(1e-3)) / np.float32(0.03))
        log += doubt * np.log((np.float32(1.005) - confidence[rows]) / np.float32(0.02))
        log += together * np.log(np.maximum(e.clumped[rows], np.float32(LEAST_CLUMPED)) / np.float32(USUALLY_CLUMPED))
        out[rows] = np.minimum(np.float32(0.03) * np.exp(log), np.float32(MOST_SIGMA_PX))

    in_row_blocks(run, out.shape[0], block_rows=64)
    return out


def reasons(refined: Refined, confirmed: Bool, left_known: Bool, right_known: Bool) -> UInt16:
    """(H, W) uint16 of `Flag` bits: why a value is only a guess."""
    seen = _lands_on_plate(refined.disparity, right_known)
    flags = np.zeros(seen.shape, np.uint16)
    for reason, where in (
        (Flag.FILLED, ~confirmed),
        (Flag.OUT_OF_VIEW, ~seen),
        (Flag.OCCLUDED, seen & refined.unseen),
        (Flag.UNMATCHED, ~confirmed & seen & ~refined.unseen),
        (Flag.BAD_PLATE, ~left_known),
    ):
        flags |= where.view(np.uint8) * np.uint16(reason)
    return flags
