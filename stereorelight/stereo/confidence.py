"""How far to believe each disparity: evidence in, the share of such pixels within 1 px of truth out.

The evidence: the right eye confirms the match; the flow confirms it; the refined value stays near the matched one; the
picture has texture there; the two plates look alike along the match; the surface is no edge.  A logistic regression
weighs it; its coefficients were fitted on synthetic shots and checked on others, see docs/confidence.md."""

from __future__ import annotations

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.passes import Flag
from stereorelight.stereo.match import Match
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.refine import Refined

EVIDENCE = ("one", "confirmed", "flow agrees", "moved from match", "no match", "log texture", "unlike", "edge nearby", "unseen")
COEFFICIENTS = np.array([0.4, 1.6, 0.8, -1.0, -0.6, 0.5, -0.9, -0.8, -2.0], dtype=np.float32)
LIMITS = (0.01, 0.995)
WINDOW = (7, 7)


def evidence(proxy: Proxy, found: Match, refined: Refined, confirmed: Bool, flow: Float32 | None) -> Float32:
    """(H, W, len(EVIDENCE)) float32: what speaks for and against each pixel of the refined disparity."""
    d = refined.disparity
    height, width = d.shape
    with np.errstate(invalid="ignore"):
        moved = np.abs(found.left - d)
        agrees = np.zeros(d.shape, np.float32) if flow is None else (np.abs(flow - d) <= 1).astype(np.float32)
    texture = cv2.boxFilter(np.abs(cv2.Scharr(proxy.left_grey, cv2.CV_32F, 1, 0)) / 32, -1, WINDOW)
    x = np.arange(width, dtype=np.float32) - d
    y = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], d.shape)
    seen = cv2.remap(proxy.right_grey, x, np.ascontiguousarray(y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    unlike = cv2.boxFilter(np.abs(seen - proxy.left_grey), -1, WINDOW)
    spread = cv2.dilate(d, np.ones(WINDOW)) - cv2.erode(d, np.ones(WINDOW))
    return np.stack(
        [
            np.ones_like(d),
            confirmed.astype(np.float32),
            agrees,
            np.minimum(np.nan_to_num(moved, nan=0.0), 3),
            (~np.isfinite(found.left)).astype(np.float32),
            np.log1p(texture),
            np.log1p(unlike),
            np.minimum(spread, 6) / 6,
            refined.hidden.astype(np.float32),
        ],
        axis=-1,
    )


def confidence_from_evidence(evidence: Float32, coefficients: Float32 = COEFFICIENTS) -> Float32:
    """(H, W) float32, 0..1: among pixels of confidence c a share of about c is within 1 px of truth."""
    p = 1 / (1 + np.exp(-(evidence @ coefficients)))
    return np.clip(p, *LIMITS).astype(np.float32)


def reasons(refined: Refined, found: Match, confirmed: Bool, right_known: Bool, left_known: Bool) -> np.ndarray:
    """(H, W) uint16 of `Flag` bits: why a value is only a guess."""
    height, width = refined.disparity.shape
    lands = np.floor(np.arange(width, dtype=np.float32) - refined.disparity + 0.5)
    inside = (lands >= 0) & (lands < width)
    seen = inside & np.take_along_axis(right_known, np.where(inside, lands, 0).astype(np.intp), axis=1)
    guessed = ~confirmed
    flags = np.zeros((height, width), np.uint16)
    for reason, where in (
        (Flag.FILLED, guessed),
        (Flag.OUT_OF_VIEW, ~seen),
        (Flag.OCCLUDED, seen & refined.hidden),
        (Flag.UNMATCHED, guessed & seen & ~refined.hidden),
        (Flag.BAD_PLATE, ~left_known),
    ):
        flags |= np.where(where, np.uint16(reason), np.uint16(0))
    return flags
