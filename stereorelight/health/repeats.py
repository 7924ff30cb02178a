"""Repeated, dropped and corrupt frames, from a small signature of each frame, so that no shot is too long.

In: scene-linear plates (H, W, 3) of one eye, one at a time, NaN = unknown.  Out: a `FrameSignature` each (about 30 kB), judged
over the shot.  A thumbnail's pixel is the mean of a hundred and more: grain is all but gone from it, motion is not.  So a frame
that comes again with fresh grain or another compression stands out among moving ones, and a locked-off shot, whose frames all
differ by grain alone, is not called frozen: there only equal bits are a repeat."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.health.finding import Finding
from stereorelight.health.picture import as_plate, flow_proxy, frames_named, grey

THUMBNAIL = (160, 90)  # w, h
BLOCK_PX = 16
SAME_RATIO = 0.25  # a repeat's step over the steps beside it
GOES_ON = 0.8  # motion over the three steps about a repeat, over one step: less is a swing that turns round
STILL_SLOPE = 0.1  # motion of a repeat's step over that of the steps beside it: more is a hand that pauses
LEAST_STEP = 1e-3  # of the tone range, rms over the thumbnail: the least that is called motion
LONGEST_NEAR_REPEAT = 3  # frames; longer stillness with fresh grain is a pause, not a fault
DROP_SLOPE = (1.75, 6.0)  # motion of a step over that of the steps beside it: one frame lost doubles it
ALIKE = 0.7  # correlation of the flow beside and across a lost frame
STEADY = 1.3  # flow before over flow after: more is an acceleration of its own
LEAST_MOTION = 0.12  # px of the thumbnail, rms
STRANGE = 0.06  # of the tone range, that a pixel leaves both its neighbours by
STRANGE_SHARE = 0.01  # of the frame ...
STRANGE_TIMES = 4.0  # ... and so many times as much as in the frames around
BLANK_SHARE = 0.004  # of the frame in blocks without any change from pixel to pixel, more than is usual in the shot
LOST_SHARE = 0.0005  # of the frame not finite, more than is usual
BLACK_SHARE, FLASH_TIMES = 0.05, 1.3  # of the neighbours' light


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameSignature:
    """digest: of the plate's bits.  thumbnail: (90, 160) float16, square root of grey.  light: mean of grey.

    lost  : share of pixels not finite;  blank: share of 16 px blocks in which no pixel differs from the next.
    thumbnail_noise : what grain alone makes a thumbnail's pixel vary by (standard deviation), at the least.
    """

    digest: bytes
    thumbnail: np.ndarray[tuple[int, ...], np.dtype[np.float16]]
    light: float
    lost: float
    blank: float
    thumbnail_noise: float


def signature(plate: Float32) -> FrameSignature:
    """What is kept of one frame (H, W, 3).  Raises PassError where it is no plate."""
    import cv2

    plate = as_plate(plate, "plate")
    digest = hashlib.blake2b(plate.data, digest_size=16).digest()
    light = grey(plate)
    finite = np.isfinite(light)
    known = np.where(finite, light, np.float32(0))
    share = cv2.resize(finite.astype(np.float32), THUMBNAIL, interpolation=cv2.INTER_AREA)
    small = cv2.resize(known, THUMBNAIL, interpolation=cv2.INTER_AREA) / np.maximum(share, 1e-6)
    tone = np.where(share > 0.5, np.sqrt(np.maximum(small, 0)), np.float32(np.nan))
    rows, columns = plate.shape[0] // BLOCK_PX, plate.shape[1] // BLOCK_PX
    cut = known[: rows * BLOCK_PX, : columns * BLOCK_PX]
    whole = finite[: rows * BLOCK_PX, : columns * BLOCK_PX]
    step = (np.abs(np.diff(cut, axis=1, prepend=cut[:, :1])) > 0) | (np.abs(np.diff(cut, axis=0, prepend=cut[:1])) > 0)
    step[::BLOCK_PX] = False  # the block's own border may step
    step[:, ::BLOCK_PX] = False
    busy = cv2.resize((step | ~whole).astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    root = np.sqrt(np.maximum(known[::2, ::2], 0))
    fine = np.abs(root[:-2:3, :-2:3] + root[2::3, 2::3] - root[:-2:3, 2::3] - root[2::3, :-2:3]) / 2
    noise = float(np.quantile(fine, 0.25)) / 0.3186  # quarter of the residuals of pure grain lie under 0.32 sigma
    pixels = plate.shape[0] * plate.shape[1] / (THUMBNAIL[0] * THUMBNAIL[1])
    return FrameSignature(
        digest=digest,
        thumbnail=tone.astype(np.float16),
        light=float(known.sum(dtype=np.float64) / max(int(finite.sum()), 1)),
        lost=1 - float(finite.mean()),
        blank=float((busy == 0).mean()),
        thumbnail_noise=noise / float(np.sqrt(max(pixels, 1.0))),
    )


Signed = Sequence[tuple[int | None, FrameSignature]]


def _white(shot: Signed) -> float:
    thumbnails = [s.thumbnail.astype(np.float32) for _, s in shot]
    whites = [float(np.nanquantile(t, 0.99)) for t in thumbnails if np.isfinite(t).any()]
    return max(float(np.median(whites)), 1e-6) if whites else 1.0


def _tones(shot: Signed) -> list[Float32]:
    """Thumbnails on one scale: 1 is the shot's usual white."""
    white = np.float32(_white(shot))
    return [np.nan_to_num(s.thumbnail.astype(np.float32), nan=0.0) / white for _, s in shot]


def _rms(a: Float32, b: Float32) -> float:
    return float(np.sqrt(np.mean(np.square(a - b, dtype=np.float64))))


def repeated_frames(shot: Signed) -> list[int]:
    """Positions in `shot` of frames that are the frame before them once more."""
    tones = _tones(shot)
    count = len(shot)
    equal = [False] + [shot[n][1].digest == shot[n - 1][1].digest for n in range(1, count)]
    step = [0.0] + [_rms(tones[n], tones[n - 1]) for n in range(1, count)]
    # A step's own grain, in the shot's tones, is taken off it: slow motion would drown in it.
    white = _white(shot)
    noise = [float(np.sqrt(2)) * s.thumbnail_noise / white for _, s in shot]
    step = [float(np.sqrt(max(s * s - g * g, 0.0))) for s, g in zip(step, noise)]
    found = {n for n in range(1, count) if equal[n]}
    n = 1
    while n < count:
        if equal[n]:
            n += 1
            continue
        # The run of still steps that starts here, and the moving steps on both its sides.
        before = next((step[k] for k in range(n - 1, 0, -1) if not equal[k]), None)
        end = n
        while before is not None and end < count and end - n < LONGEST_NEAR_REPEAT and step[end] < max(SAME_RATIO * before, 0):
            end += 1
        after = step[end] if end < count else None
        if end > n and before is not None and after is not None:
            beside = min(before, after)
            grain_step = max(noise[n : end + 1])
            clear = beside > max(LEAST_STEP, grain_step)
            still = all(s < SAME_RATIO * beside for s in step[n:end])
            onwards = n >= 2 and _rms(tones[end], tones[n - 2]) >= GOES_ON * (before + after) / 2
            if clear and still and onwards and not _moves(tones, n, end):
                found |= set(range(n, end))
        n = max(end, n + 1)
    return sorted(found)


def _moves(tones: list[Float32], first: int, end: int) -> bool:
    """Whether the steps into positions first..end - 1 move along with the step before or after them: grain and compression do not."""
    flows = _flows(tones[first - 2 : end + 1], set())
    for beside in (flows[1], flows[end - first + 2]):
        power = float(np.mean(np.square(beside)))
        here = [abs(float(np.mean(flows[k] * beside))) for k in range(2, end - first + 2)]
        if max(here) > STILL_SLOPE * max(power, LEAST_MOTION**2):
            return True
    return False


def _flows(tones: list[Float32], skip: set[int]) -> dict[int, Float64]:
    """Flow of each step n - 1 to n, in px of the thumbnail, by position."""
    import cv2

    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(0)
    size = (2 * THUMBNAIL[0], 2 * THUMBNAIL[1])
    flows = {}
    pictures = [cv2.resize(flow_proxy(np.square(t), white=1.0, size=THUMBNAIL), size, interpolation=cv2.INTER_CUBIC) for t in tones]
    for n in range(1, len(tones)):
        if n not in skip:
            flows[n] = dis.calc(pictures[n - 1], pictures[n], None).astype(np.float64) / 2
    return flows


def dropped_frames(shot: Signed) -> list[tuple[int, float]]:
    """(position, frames lost just before it, as a number) where the motion jumps for one step and goes on as before."""
    if len(shot) < 4:
        return []
    tones = _tones(shot)
    skip = set(repeated_frames(shot))
    flows = _flows(tones, skip)
    order = sorted(flows)
    found = []
    for k in range(1, len(order) - 1):
        before, here, after = (flows[order[j]] for j in (k - 1, k, k + 1))
        sizes = [float(np.sqrt(np.mean(np.square(f)))) for f in (before, after)]
        if min(sizes) < LEAST_MOTION or max(sizes) > STEADY * min(sizes):
            continue
        beside = (before + after) / 2
        power = float(np.mean(np.square(beside)))
        slope = float(np.mean(here * beside)) / max(power, 1e-12)
        across = slope * np.sqrt(power) / max(float(np.sqrt(np.mean(np.square(here)))), 1e-9)
        if DROP_SLOPE[0] <= slope <= DROP_SLOPE[1] and across >= ALIKE:
            found.append((order[k], slope - 1))
    return found


def _strange_share(before: Float32, here: Float32, after: Float32) -> float:
    """Share of `here` that neither neighbour explains once the camera's own movement is taken out.

    A camera that shakes shows a picture twice with another between: each neighbour is moved by the median flow, and a pixel
    is strange only when it leaves the range of a pixel's neighbourhood there.
    """
    import cv2

    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(0)
    codes = [flow_proxy(np.square(t), white=1.0, size=THUMBNAIL) for t in (before, here, after)]
    box = np.ones((3, 3), np.uint8)
    moved, beyond = [], []
    for other, code in ((before, codes[0]), (after, codes[2])):
        dx, dy = np.median(dis.calc(codes[1], code, None).reshape(-1, 2), axis=0)
        M = np.array([[1, 0, dx], [0, 1, dy]], np.float32)
        there = cv2.warpAffine(other, M, THUMBNAIL, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
        moved.append(there)
        beyond.append(np.maximum(np.maximum(here - cv2.dilate(there, box), cv2.erode(there, box) - here), 0))
    apart = np.minimum(beyond[0], beyond[1]) - np.abs(moved[1] - moved[0])
    edge = 8  # px that a shake brings in at the border
    return float((apart > STRANGE)[edge:-edge, edge:-edge].mean())


def corrupt_frames(shot: Signed) -> list[tuple[int, str]]:
    """(position, what is wrong): not finite, blank blocks, black, flash, or strange against neighbours that agree."""
    tones = _tones(shot)
    count = len(shot)
    found: dict[int, str] = {}
    usual_lost = float(np.median([s.lost for _, s in shot])) if shot else 0.0
    usual_blank = float(np.median([s.blank for _, s in shot])) if shot else 0.0
    strange = np.zeros(count)
    for n in range(count):
        s = shot[n][1]
        near = [shot[k][1].light for k in (n - 1, n + 1) if 0 <= k < count]
        if s.lost > usual_lost + LOST_SHARE:
            found[n] = f"{s.lost - usual_lost:.1%} of it is not a number"
        elif near and max(s.light, 0) < BLACK_SHARE * min(near):
            found[n] = "it is black"
        elif count > 2 and s.blank > usual_blank + BLANK_SHARE:
            found[n] = f"{s.blank - usual_blank:.1%} of it is blank blocks"
        if 0 < n < count - 1:
            apart = np.minimum(np.abs(tones[n] - tones[n - 1]), np.abs(tones[n] - tones[n + 1])) - np.abs(tones[n + 1] - tones[n - 1])
            strange[n] = float((apart > STRANGE).mean())
            low, high = sorted(near)
            if n not in found and high < 1.15 * low and s.light > FLASH_TIMES * high:
                found[n] = f"it flashes, {s.light / high:.1f} times as bright as its neighbours"
    for n in range(1, count - 1):
        around = [strange[k] for k in range(max(1, n - 4), min(count - 1, n + 5)) if k != n]
        usual = float(np.median(around)) if around else 0.0
        if n not in found and strange[n] > max(STRANGE_SHARE, STRANGE_TIMES * usual):
            share = _strange_share(tones[n - 1], tones[n], tones[n + 1])
            if share > STRANGE_SHARE:
                found[n] = f"{share:.1%} of it belongs to neither neighbour"
    return sorted(found.items())


def _of(eye: str) -> str:
    return f" of the {eye} eye" if eye else ""


def _too_few(name: str, shot: Signed, want: int) -> Finding | None:
    if len(shot) >= want:
        return None
    return Finding(name=name, level="unknown", unit="frames", words=f"{len(shot)} frame{'s are' if len(shot) != 1 else ' is'} too few; {want} tell.")


def judge_repeats(shot: Signed, *, eye: str = "") -> Finding:
    """One Finding "repeated frames" over one eye's shot; value: how many."""
    if (few := _too_few("repeated_frames", shot, 2)) is not None:
        return few
    at = repeated_frames(shot)
    frames = tuple((frame, float(n in set(at))) for n, (frame, _) in enumerate(shot))
    if not at:
        return Finding(name="repeated_frames", level="good", value=0.0, unit="frames", words=f"No frame{_of(eye)} is repeated.", frames=frames)
    words = f"{len(at)} frame{'s' if len(at) > 1 else ''}{_of(eye)} repeat{'' if len(at) > 1 else 's'} the one before"
    words += f": {named}" if (named := frames_named([shot[n][0] for n in at])) else ""
    gaps = set(np.diff(at).tolist())
    remedy = "Take the frame from the camera original, or leave it out of the range in both eyes."
    if len(at) == len(shot) - 1:
        words, remedy = f"Every frame{_of(eye)} is the same picture", "Check that the file pattern counts frames and that the movie is not a still."
    elif len(at) >= 3 and len(gaps) == 1 and (gap := gaps.pop()) > 1:
        words += f"; every {gap}. frame, as a pulldown makes"
        remedy = "Take the pulldown out, or conform the footage at the rate it was shot at."
    positions = [shot[n][0] for n in at]
    return Finding(
        name="repeated_frames",
        level="bad" if len(at) > len(shot) / 4 else "warn",
        value=float(len(at)),
        unit="frames",
        words=words + ".",
        remedy=remedy,
        frames=frames,
        details={"frames": positions, "eye": eye},
    )


def judge_drops(shot: Signed, *, eye: str = "") -> Finding:
    """One Finding "dropped frames" over one eye's shot; value: frames lost, as told by the motion."""
    if (few := _too_few("dropped_frames", shot, 4)) is not None:
        return few
    at = dropped_frames(shot)
    lost = dict(at)
    frames = tuple((frame, lost.get(n, 0.0)) for n, (frame, _) in enumerate(shot))
    if not at:
        return Finding(name="dropped_frames", level="good", value=0.0, unit="frames", words=f"No frame{_of(eye)} is missing.", frames=frames)
    total = sum(max(1, round(size)) for _, size in at)
    named = frames_named([shot[n][0] for n, _ in at])
    words = f"{total} frame{'s' if total > 1 else ''}{_of(eye)} seem{'' if total > 1 else 's'} lost: the motion jumps" + (
        f" before {named}" if named else ""
    )
    return Finding(
        name="dropped_frames",
        level="warn",
        value=float(total),
        unit="frames",
        words=words + ".",
        remedy="Copy the take from the card again, or drop the same frame from the other eye so that the eyes stay in step.",
        frames=frames,
        details={"before_frames": [shot[n][0] for n, _ in at], "jumps": [size + 1 for _, size in at], "eye": eye},
    )


def judge_corrupt(shot: Signed, *, eye: str = "") -> Finding:
    """One Finding "corrupt frames" over one eye's shot; value: how many."""
    if (few := _too_few("corrupt_frames", shot, 1)) is not None:
        return few
    at = corrupt_frames(shot)
    bad = {n for n, _ in at}
    frames = tuple((frame, float(n in bad)) for n, (frame, _) in enumerate(shot))
    if not at:
        return Finding(name="corrupt_frames", level="good", value=0.0, unit="frames", words=f"No frame{_of(eye)} looks damaged.", frames=frames)
    first = "; ".join((f"frame {shot[n][0]}: " if shot[n][0] is not None else "") + why for n, why in at[:3])
    more = f"; and {len(at) - 3} more" if len(at) > 3 else ""
    only_light = all("flashes" in why for _, why in at)
    return Finding(
        name="corrupt_frames",
        level="warn" if only_light else "bad",
        value=float(len(at)),
        unit="frames",
        words=f"{len(at)} frame{'s' if len(at) > 1 else ''}{_of(eye)} look{'' if len(at) > 1 else 's'} damaged: {first}{more}.",
        remedy="Read the frame again from the camera original; if it is damaged there too, leave it out of the range in both eyes.",
        frames=frames,
        details={"frames": [shot[n][0] for n, _ in at], "reasons": [why for _, why in at], "eye": eye},
    )
