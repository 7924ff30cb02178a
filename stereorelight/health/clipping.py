"""Clipped and crushed areas: where a plate holds no picture any more.

In: scene-linear plates (H, W, 3), NaN = unknown.  Out: levels in scene-linear units, shares 0..1 of the known pixels.
Decoded log footage clips wherever its camera's curve ends, so no fixed level is asked for: a plateau is a crowd of equal
values at the very top (or bottom) of a channel, far denser than the values next to it, that covers more than grain can."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32
from stereorelight.health.finding import Finding, Level
from stereorelight.health.picture import as_plate, on_frame

TOP_WIDTH = 0.02  # a plateau's relative width: two codes of 10-bit LogC near its top, which a codec may spread
BOTTOM_WIDTH = 0.0005  # the same at the bottom, as a share of the plate's white: a code of 10-bit video near black
EXACT_WIDTH = 5e-4  # the same where nothing was done to the plate since it clipped ...
EQUAL_SHARE = 0.8  # ... and the share of it that is equal to that width; grain that fell under the level is the rest
CROWD_EXACT, CROWD_WIDE = 5.0, 3.0  # times denser than the next levels; the top of a smooth bright ridge reaches 2.7
CALMER = 0.6  # grain left on a plateau that a codec has touched, over that of the calmest blocks elsewhere
CORE_PX = 3  # a side; nine equal neighbours are no accident of grain
LEAST_SHARE = 2e-5  # of the plate; a glint of fewer pixels harms nothing and proves no plateau
CLIPPED_NOTE, CLIPPED_WARN, CLIPPED_BAD = 0.002, 0.02, 0.10  # a lamp in shot; a window; the subject
CRUSHED_NOTE, CRUSHED_WARN, CRUSHED_BAD = 0.01, 0.05, 0.30  # black hides less than white: it needs no match to be dark


@dataclass(frozen=True, kw_only=True)
class Clipping:
    """clip_level, black_level: scene-linear, per channel, NaN where there is no plateau; *_share: of known pixels, per channel.

    clipped_any, crushed_any : share of pixels clipped in any channel, crushed in all of them.
    """

    clip_level: tuple[float, float, float]
    clipped_share: tuple[float, float, float]
    clipped_any: float
    black_level: tuple[float, float, float]
    crushed_share: tuple[float, float, float]
    crushed_any: float


def _solid(crowd: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    import cv2

    square = np.ones((CORE_PX, CORE_PX), np.uint8)
    return cv2.morphologyEx(crowd, cv2.MORPH_OPEN, square)


def _plateau(channel: Float32, *, end: Literal["top", "bottom"], white: float) -> tuple[float, npt.NDArray[np.uint8] | None]:
    """(level, (H, W) 0/1 where the plateau is) of one channel whose unknown pixels are NaN; (NaN, None) without one."""
    import cv2

    # A median of 3 x 3 takes away hot pixels and a codec's ringing, both of which lie beyond the plateau.
    inside = -3e38 if end == "top" else 3e38
    calm = cv2.medianBlur(np.nan_to_num(channel, nan=inside, posinf=inside, neginf=inside), 3)
    lowest, highest, _, _ = cv2.minMaxLoc(calm)
    extreme = highest if end == "top" else lowest
    if abs(extreme) > 1e37:
        return float("nan"), None
    exact, wide = (EXACT_WIDTH * abs(extreme), TOP_WIDTH * abs(extreme)) if end == "top" else (0.2 * BOTTOM_WIDTH * white, BOTTOM_WIDTH * white)
    for width, crowding, calmer in ((exact, CROWD_EXACT, False), (wide, CROWD_WIDE, True)):
        if not width > 0:
            continue
        low, high = (extreme - width, 3e38) if end == "top" else (-3e38, extreme + width)
        beside = (extreme - 3 * width, extreme - width) if end == "top" else (extreme + width, extreme + 3 * width)
        crowd = cv2.inRange(calm, low, high) // 255
        count = cv2.countNonZero(crowd)
        # The crowd's end is as wide as `width` on the inside, the band beside it twice as wide.
        if count < LEAST_SHARE * channel.size or count < crowding * cv2.countNonZero(cv2.inRange(calm, *beside)) / 2:
            continue
        solid = _solid(crowd)
        area = cv2.countNonZero(solid)
        if area < max(LEAST_SHARE * channel.size, CORE_PX**2) or area < count / 4:
            continue
        core = channel[solid > 0][:100_000]
        level = float(np.median(core))
        equal = float(np.mean(np.abs(core - level) <= width))  # the median above can make a ridge flat that is none
        if (calmer and not _calmer(channel, solid)) or (not calmer and equal < EQUAL_SHARE):
            continue
        # Grain frays a plateau's rim: pixels at the level beside the solid part belong to it.
        rim = cv2.dilate(solid, np.ones((5, 5), np.uint8))
        return level, rim & (cv2.inRange(channel, low, high) // 255)
    return float("nan"), None


def _calmer(channel: Float32, solid: npt.NDArray[np.uint8]) -> bool:
    """Whether the plateau holds far less grain than the calmest blocks elsewhere: a smooth bright wall keeps its grain."""
    import cv2

    tap = np.array([1, -2, 1], np.float32) / np.sqrt(np.float32(6))
    clean = np.nan_to_num(channel, nan=0.0, posinf=0.0, neginf=0.0)
    power = np.square(cv2.sepFilter2D(clean, cv2.CV_32F, tap, tap)) / np.square(np.maximum(np.abs(cv2.blur(clean, (5, 5))), 1e-9))
    size = (channel.shape[1] // 8, channel.shape[0] // 8)
    blocks, share, known = (
        cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (power, solid.astype(np.float32), np.isfinite(channel).astype(np.float32))
    )
    inside, outside = blocks[share > 0.99], blocks[(share == 0) & (known > 0.99)]
    if inside.size < 4 or outside.size < 20:
        return False
    return bool(np.median(inside) < CALMER**2 * np.quantile(outside, 0.1))


def clipped_mask(plate: Float32) -> tuple[Bool, tuple[float, float, float]]:
    """(H, W) where any channel of `plate` lies on its top plateau, and the three levels (NaN without a plateau)."""
    mask = np.zeros(plate.shape[:2], dtype=np.uint8)
    levels = []
    for c in range(3):
        level, solid = _plateau(np.ascontiguousarray(plate[..., c]), end="top", white=1.0)
        levels.append(level)
        if solid is not None:
            mask |= solid
    return mask > 0, (levels[0], levels[1], levels[2])


def clipping(plate: Float32) -> Clipping:
    """Plateaus at the top and at the bottom of `plate` (H, W, 3).  Raises PassError where it is no plate."""
    plate = as_plate(plate, "plate")
    known: Bool = np.asarray(np.isfinite(plate).all(axis=2))
    total = max(int(known.sum()), 1)
    tops, bottoms, top_share, bottom_share = [], [], [], []
    any_top = np.zeros(known.shape, dtype=np.uint8)
    all_bottom = np.ones(known.shape, dtype=np.uint8)
    for c in range(3):
        channel = np.ascontiguousarray(plate[..., c])
        sample = channel[::4, ::4][known[::4, ::4]]
        white = float(np.quantile(sample, 0.99)) if sample.size else 0.0
        level, solid = _plateau(channel, end="top", white=white)
        tops.append(level)
        top_share.append(0.0 if solid is None else int((solid > 0)[known].sum()) / total)
        any_top |= np.uint8(0) if solid is None else solid
        level, solid = _plateau(channel, end="bottom", white=white)
        bottoms.append(level)
        bottom_share.append(0.0 if solid is None else int((solid > 0)[known].sum()) / total)
        all_bottom &= np.uint8(0) if solid is None else solid
    return Clipping(
        clip_level=(tops[0], tops[1], tops[2]),
        clipped_share=(top_share[0], top_share[1], top_share[2]),
        clipped_any=int(any_top[known].sum()) / total,
        black_level=(bottoms[0], bottoms[1], bottoms[2]),
        crushed_share=(bottom_share[0], bottom_share[1], bottom_share[2]),
        crushed_any=int(all_bottom[known].sum()) / total,
    )


def _level_of(share: float, note: float, warn: float, bad: float) -> Level:
    return "bad" if share >= bad else "warn" if share >= warn else "note" if share >= note else "good"


def _judge(name: str, eyes: dict[str, Sequence[tuple[int | None, float]]], limits: tuple[float, float, float], words: str, remedy: str) -> Finding:
    worst = max(((share, eye, frame) for eye, shares in eyes.items() for frame, share in shares), key=lambda w: w[0], default=None)
    if worst is None:
        return Finding(name=name, level="unknown", words=f"No plate was measured for {words} areas.", unit="%")
    share, eye, frame = worst
    level = _level_of(share, *limits)
    medians = {who: float(np.median([s for _, s in shares])) if shares else float("nan") for who, shares in eyes.items()}
    if level == "good":
        said = f"Next to nothing is {words}: at most {share:.2%} of the {eye} eye."
    else:
        usual = ", ".join(f"{median:.1%} of the {who}" for who, median in medians.items())
        said = f"{share:.1%} of the {eye} eye is {words}{on_frame(frame)}; in the median {usual} eye."
    both = {f: s for shares in eyes.values() for f, s in sorted(shares, key=lambda p: p[1])}
    numbered = [(f, 100 * max(s for shares in eyes.values() for g, s in shares if g == f)) for f in both]
    numbered.sort(key=lambda p: -1 if p[0] is None else p[0])
    return Finding(
        name=name,
        level=level,
        value=100 * share,
        unit="%",
        words=said,
        remedy="" if level in ("good", "note") else remedy,
        frames=tuple(numbered),
        details={f"{who}_median_percent": 100 * m for who, m in medians.items()},
    )


def judge_clipping(left: Sequence[tuple[int | None, Clipping]], right: Sequence[tuple[int | None, Clipping]] = ()) -> Finding:
    """One Finding "clipping" over a shot, by the worst frame and eye; value in % of the plate."""
    eyes = {name: [(f, c.clipped_any) for f, c in eye] for name, eye in (("left", left), ("right", right)) if eye}
    remedy = (
        "Depth is guessed there and the highlight cannot be relit; go back to the camera original with its full range, "
        "check the colour space of the plates, or expose for the highlights."
    )
    finding = _judge("clipping", dict(eyes), (CLIPPED_NOTE, CLIPPED_WARN, CLIPPED_BAD), "clipped", remedy)
    levels = [list(c.clip_level) for eye in (left, right) for _, c in eye]
    usual = [float(np.median(v)) if (v := np.array(level)[np.isfinite(level)]).size else None for level in np.array(levels).T] if levels else []
    return _with(finding, clip_level=usual)


def judge_crushing(left: Sequence[tuple[int | None, Clipping]], right: Sequence[tuple[int | None, Clipping]] = ()) -> Finding:
    """One Finding "crushed" over a shot, by the worst frame and eye; value in % of the plate."""
    eyes = {name: [(f, c.crushed_any) for f, c in eye] for name, eye in (("left", left), ("right", right)) if eye}
    remedy = (
        "Nothing can be matched there and no light brings it back; go back to the camera original, "
        "check that video range is not read as full range, or light the shadows."
    )
    return _judge("crushed", dict(eyes), (CRUSHED_NOTE, CRUSHED_WARN, CRUSHED_BAD), "crushed to black", remedy)


def _with(finding: Finding, **more: object) -> Finding:
    from dataclasses import replace

    return replace(finding, details={**finding.details, **more})
