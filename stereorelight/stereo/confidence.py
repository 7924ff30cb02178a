"""How far to believe each disparity, and why some are only guesses.

In: the match, the refined disparity and the flow's second opinion.  Out: confidence (H, W), the share of such pixels
within 1 px of truth, and reason flags.  The evidence: the right eye confirms the match; the flow confirms it; the refined
value stays near the matched one; the picture has texture there; the plates look alike along the match; no edge is near.
A logistic regression weighs it.  Its coefficients were fitted on synthetic shots; docs/depth.md shows the check on
footage that had no part in the fit.  The same evidence gives the standard deviation of the disparity."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt16
from stereorelight.engine.photometric import believed, brightness_residual
from stereorelight.passes import Flag
from stereorelight.stereo.match import Match
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.refine import Refined

EVIDENCE = ("always", "confirmed", "flow agrees", "moved, px", "no match", "log texture", "log unlike", "edge nearby", "unseen")
COEFFICIENTS = np.array([2.95, 1.39, 0.77, -0.50, -0.37, 0.31, -0.66, -1.75, 0.71], dtype=np.float32)
# log(standard deviation / 0.03 px) as always, log of the refinement's own, log of doubt, log texture, edge nearby.
SIGMA_COEFFICIENTS = (0.213, 1.024, 0.377, 0.094, 2.117)
MOST_SIGMA_PX = 8.0
LOWEST, HIGHEST = 0.01, 0.995
WINDOW = (7, 7)


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What speaks for and against each pixel of a refined disparity; every array (H, W).

    matched, flow : disparities by the two methods, NaN where they have none.   unlike : mean brightness residual, grey levels.
    texture       : mean horizontal slope, grey levels per px.                  spread : range of disparity nearby, px.
    """

    disparity: Float32
    confirmed: Bool
    unseen: Bool
    matched: Float32
    flow: Float32
    texture: Float32
    unlike: Float32
    spread: Float32
    sigma: Float32


def evidence(proxy: Proxy, found: Match, refined: Refined, confirmed: Bool, flow: Float32 | None) -> Evidence:
    """Gather the evidence; `flow` None counts as a second opinion that says nothing."""
    d = refined.disparity
    residual, rate = brightness_residual(proxy.left_grey, proxy.right_grey, d)
    near = np.ones(WINDOW, np.uint8)
    return Evidence(
        disparity=d,
        confirmed=confirmed,
        unseen=refined.unseen,
        matched=found.left,
        flow=np.full_like(d, np.nan) if flow is None else flow,
        texture=cv2.blur(np.abs(rate), WINDOW),
        unlike=cv2.blur(np.abs(residual), WINDOW),
        spread=cv2.dilate(d, near) - cv2.erode(d, near),
        sigma=refined.sigma_px,
    )


def confidence_from_evidence(e: Evidence, coefficients: Float32 = COEFFICIENTS) -> Float32:
    """(H, W) float32, 0..1: among pixels of confidence c a share of about c is within 1 px of truth."""
    given = (e.confirmed, e.unseen, e.matched, e.flow, e.disparity, e.texture, e.unlike, e.spread)
    return believed(coefficients, *given, low=LOWEST, high=HIGHEST)


def sigma_from_evidence(e: Evidence, confidence: Float32) -> Float32:
    """(H, W) px: the standard deviation of the disparity; 68 % of such pixels are within it, as the synthetic shots were.

    The refinement's own sigma knows noise and bend; this adds what it cannot know: a wrong surface, and edges.
    """
    always, own, doubt, texture, edge = (np.float32(c) for c in SIGMA_COEFFICIENTS)
    log = always + own * np.log(np.maximum(e.sigma, np.float32(1e-3)) / np.float32(0.03))
    log += doubt * np.log((np.float32(1.005) - confidence) / np.float32(0.02)) + texture * np.log1p(e.texture)
    log += edge * np.minimum(e.spread, np.float32(6)) / np.float32(6)
    return np.minimum(np.float32(0.03) * np.exp(log), np.float32(MOST_SIGMA_PX)).astype(np.float32)


def reasons(refined: Refined, confirmed: Bool, left_known: Bool, right_known: Bool) -> UInt16:
    """(H, W) uint16 of `Flag` bits: why a value is only a guess."""
    height, width = refined.disparity.shape
    lands = np.floor(np.arange(width, dtype=np.float32) - refined.disparity + 0.5)
    seen = (lands >= 0) & (lands < width)
    if not right_known.all():
        seen &= np.take_along_axis(right_known, np.where(seen, lands, 0).astype(np.intp), axis=1)
    flags = np.zeros((height, width), np.uint16)
    for reason, where in (
        (Flag.FILLED, ~confirmed),
        (Flag.OUT_OF_VIEW, ~seen),
        (Flag.OCCLUDED, seen & refined.unseen),
        (Flag.UNMATCHED, ~confirmed & seen & ~refined.unseen),
        (Flag.BAD_PLATE, ~left_known),
    ):
        flags |= where.view(np.uint8) * np.uint16(reason)
    return flags
