"""Which eye is which, from the pictures alone: the half-occluded strips beside near things.

In: two upright scene-linear plates and points that match.  Out: `Strips`.  What this and all else that is measured about the two
eyes means in words stands in eyes.py.  Pixels; disparity is x_left - x_right.

The occlusion cue needs no rig.  Where depth jumps, one eye sees a strip that the other does not, and that strip belongs to
what lies BEHIND.  Matching says which side of the strip has the larger disparity and so should be in front; the picture says
which side the strip looks like.  With the eyes swapped, strips look like the side that seems nearer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64
from stereorelight.engine.strips import strip_votes

LEAST_MATCHES = 60  # to put the rows of the two pictures in step
STRIP_WIDTH_PX = 480  # the occlusion cue works on plates of this width
STRIPS_SURE = 60  # strips that must speak
STRIPS_SHARE = 0.65


@dataclass(frozen=True, kw_only=True)
class Strips:
    """Votes of the half-occluded strips.

    behind : strips that look like the side which matching puts behind: as it must be.
    before : those that look like the side which matching puts in front: as it is with the eyes swapped.
    """

    behind: int
    before: int

    @property
    def swapped_share(self) -> float:
        """0..1, NaN without a vote."""
        total = self.behind + self.before
        return self.before / total if total else math.nan

    @property
    def verdict(self) -> str:
        """One of "swapped", "right" (the right way round), "unclear"."""
        if self.behind + self.before < STRIPS_SURE:
            return "unclear"
        if self.swapped_share > STRIPS_SHARE:
            return "swapped"
        return "right" if self.swapped_share < 1 - STRIPS_SHARE else "unclear"


def _small_pair(left: Float32, right: Float32, left_px: Float64, right_px: Float64) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], Float64]:
    """8-bit BGR pictures with the rows made to agree, and the disparities of the matches, in small pixels."""
    h, w = left.shape[:2]
    scale = min(1.0, STRIP_WIDTH_PX / w)
    size = (round(w * scale), round(h * scale))
    pictures = []
    for plate in (left, right):
        tone = np.sqrt(np.clip(np.nan_to_num(plate), 0, None))
        small = cv2.resize(tone, size, interpolation=cv2.INTER_AREA)
        top = float(np.quantile(small, 0.99)) * 1.1 or 1.0
        pictures.append(np.clip(small[..., ::-1] * (255 / top), 0, 255).astype(np.uint8))
    p, q = ((points + 0.5) * scale - 0.5 for points in (left_px, right_px))
    # Rows of the right picture as a plane over (x, y): shift, roll and zoom at once.
    terms = np.concatenate([q, np.ones((len(q), 1))], axis=1)
    row = np.linalg.lstsq(terms, p[:, 1], rcond=None)[0]
    apart = np.abs(terms @ row - p[:, 1])
    near = apart <= 3 * np.median(apart) + 1e-6
    row = np.linalg.lstsq(terms[near], p[near, 1], rcond=None)[0]
    straight = cv2.warpAffine(pictures[1], np.array([[1, 0, 0], row]), size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return pictures[0], straight, p[:, 0] - q[:, 0]


def _disparities(a: npt.NDArray[np.uint8], b: npt.NDArray[np.uint8], low: int, count: int) -> Float32:
    """(H, W) disparity of `a` where matching from `b` agrees, NaN elsewhere."""
    matcher = cv2.StereoSGBM_create(low, count, 3, 4 * 3 * 9, 24 * 3 * 9, 1, 31, 10, 0, 0, cv2.STEREO_SGBM_MODE_HH4)
    pad = max(low + count, -low, 0)

    def of(one: npt.NDArray[np.uint8], two: npt.NDArray[np.uint8]) -> Float32:
        wide = [cv2.copyMakeBorder(picture, 0, 0, pad, pad, cv2.BORDER_CONSTANT) for picture in (one, two)]
        raw = matcher.compute(*wide)[:, pad : pad + one.shape[1]]
        return np.where(raw >= 16 * low, raw.astype(np.float32) / 16, np.float32(np.nan))

    here = of(a, b)
    there = of(np.ascontiguousarray(b[:, ::-1]), np.ascontiguousarray(a[:, ::-1]))[:, ::-1]
    x = np.arange(a.shape[1])[None, :] - np.nan_to_num(here)
    column = np.clip(np.round(x), 0, a.shape[1] - 1).astype(int)
    with np.errstate(invalid="ignore"):
        agree = np.abs(np.take_along_axis(there, column, 1) - here) <= 1.0
    return np.where(agree & (x >= 0) & (x <= a.shape[1] - 1), here, np.float32(np.nan))


def _votes(picture: npt.NDArray[np.uint8], disparity: Float32) -> tuple[int, int]:
    """Strips of unmatched pixels between two surfaces that look like the lower disparity, and like the higher one."""
    return strip_votes(cv2.GaussianBlur(picture, (0, 0), 0.7), disparity, np.ones(disparity.shape, np.bool_))


def occlusion_votes(left: Float32, right: Float32, left_px: Float64, right_px: Float64) -> Strips:
    """What the half-occluded strips of both eyes say about which eye is which.

    left, right       : (H, W, 3) scene-linear upright plates, NaN where unknown.
    left_px, right_px : (n, 2) matches, for the range of disparity and for the rows.
    """
    if len(left_px) < LEAST_MATCHES:
        return Strips(behind=0, before=0)
    a, b, disparity = _small_pair(left, right, np.asarray(left_px), np.asarray(right_px))
    low = math.floor(float(np.quantile(disparity, 0.01))) - 4
    count = 16 * math.ceil((float(np.quantile(disparity, 0.99)) + 5 - low) / 16)
    votes = [_votes(a, _disparities(a, b, low, count))]
    mirror_a, mirror_b = np.ascontiguousarray(b[:, ::-1]), np.ascontiguousarray(a[:, ::-1])
    votes.append(_votes(mirror_a, _disparities(mirror_a, mirror_b, low, count)))
    return Strips(behind=sum(v[0] for v in votes), before=sum(v[1] for v in votes))
