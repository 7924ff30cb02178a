"""Time: what neighbouring frames saw of a frame's surfaces, carried along the motion, steadies its depth.

In: the plate of one eye and the depth found for each frame alone (`Glimpse`), on the ORIGINAL plate of that eye.
Out: Z, confidence and flags of one frame, made of its own and of those of up to four frames before and after it.
A frame's result is a function of those frames alone, so that a shot may be cut into pieces anywhere.  Motion: pixels,
(x, y), from one frame to another.  Depth is weighed as fx b / Z, px: that is what matching errs in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.refine import robust_planes
from stereorelight.engine.temporal import BELIEVED, FIRM, carry_into, combined, rates, there_and_back
from stereorelight.engine.tone import LEVELS, levels
from stereorelight.passes import Flag, Frame
from stereorelight.stereo.proxy import HEADROOM, WHITE_QUANTILE

MOTION_WIDTH = 1280  # px; motion of a larger plate is found on a smaller copy
LIMIT_PX = 1.0  # of the motion's own grid: there and back must agree
UNLIKE_LEVELS = 16.0  # of 255: what a surface may change its tone by on the way, over `LIKE`
LIKE = (5, 5)
BEND, BEND_PX = np.ones((9, 9), np.uint8), 1.0  # motions that differ by more within such a window are those of two surfaces
CUT_SHARE = 0.3  # of the frame must be found again: over a cut it is 2 to 8 %, over fast motion 70 and more
APART_PX = 0.7  # disparities farther apart are not mixed when one is read between pixels
OWN_VOTE = 2.0  # a frame's own value counts twice in the vote: it alone cannot have been carried wrongly
ALIKE = 0.5  # correlation of two frames' errors, measured on synthetic shots (docs/time.md)
NEAR_PX, WIDE_PX, WILD_PX = 1.0, 2.0, 4.0  # gates, see engine/temporal.combined
SURFACE_TAU_PX = 0.5  # as in refinement: farther off a pixel's plane is another surface
RATE_RADIUS, RATE_STRIDE = 36, 9  # a surface moves as a whole: its rate is that of a region
RATE_DOUBT = 0.6  # of the rate's standard deviation were it one pixel's: slower ones are a region's noise
TOLD = ("Z", "confidence", "flags", "disparity_sigma", "Z_sigma")  # passes that neighbours ask for, and a frame that is steadied again
REASONS = np.uint16(Flag.FILLED | Flag.OCCLUDED | Flag.OUT_OF_VIEW | Flag.UNMATCHED)
LEAST_SIGMA_PX = 1e-3
LEAST_STRAY_PX = np.float32(0.03)  # a frame: rates of one surface differ by less
SIGMA_SURE_PX, SIGMA_UNSURE_PX = 0.06, 0.9  # of disparity at confidence 1, and added at 0, where matching does not say its own


@dataclass(frozen=True, kw_only=True, eq=False)
class Glimpse:
    """One frame by itself.

    grey  : (H, W) the plate's tone, 8 bit.
    depth : Z, confidence, flags, and disparity_sigma where matching says it.
    px_m  : fx b of the rectified pair, px m.
    """

    grey: UInt8
    depth: Frame
    px_m: float

    @property
    def disparity(self) -> Float32:
        """(H, W) fx b / Z, px, NaN where unknown: what matching errs in."""
        return np.asarray(np.float32(self.px_m) / self.depth["Z"], np.float32)

    @property
    def sigma(self) -> Float32:
        """(H, W) its standard deviation, px; where matching does not say it, by the confidence."""
        told = self.depth.passes.get("disparity_sigma")
        if told is None:
            told = SIGMA_SURE_PX + SIGMA_UNSURE_PX * (1 - self.depth["confidence"])
        return np.where(np.isfinite(told), np.maximum(told, LEAST_SIGMA_PX), SIGMA_SURE_PX + SIGMA_UNSURE_PX).astype(np.float32)

    @property
    def guessed(self) -> Bool:
        """(H, W) where depth is a guess."""
        return np.asarray((self.depth["flags"] & np.uint16(Flag.FILLED)) != 0)

    def to_tell(self) -> Glimpse:
        """The same with nothing but what neighbours ask for."""
        return replace(self, depth=replace(self.depth, passes={k: v for k, v in self.depth.items() if k in TOLD}))


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Where each pixel of one frame is in another; (h, w) may be a whole fraction of the frame.

    there  : (h, w, 2) px of this grid.   astray : (h, w) px by which there and back misses, infinite where the pixel is not found again.
    bent   : (h, w), another motion is near.
    """

    there: Float32
    astray: Float32
    bent: Bool

    @property
    def found(self) -> float:
        """Share of the frame that is found again."""
        return float((self.astray <= LIMIT_PX).mean())

    @property
    def is_cut(self) -> bool:
        """Whether the two frames show different things."""
        return self.found < CUT_SHARE


@dataclass(frozen=True, kw_only=True, eq=False)
class Steadied:
    """frame: the steadied depth.  frames: the neighbours that spoke, by distance in frames.  regained: share of the frame that was a
    guess and is none any more."""

    frame: Frame
    frames: tuple[int, ...]
    regained: float


def _grey(plate: Float32) -> UInt8:
    """(H, W) uint8: the plate's tone by the square root of light, up to its own white."""
    step = max(1, int(np.sqrt(plate.shape[0] * plate.shape[1] / 20_000)))
    light = plate[::step, ::step].max(axis=-1)
    light = light[np.isfinite(light)]
    white = float(np.quantile(light, WHITE_QUANTILE)) * HEADROOM if light.size else 0.0
    if not white > 0:
        return np.zeros(plate.shape[:2], np.uint8)
    bgr = (levels(plate, white=white)[0] // np.uint16((LEVELS + 255) // 256)).astype(np.uint8)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY))


def glimpse(plate: Float32, depth: Frame, *, px_m: float) -> Glimpse:
    """What a frame tells its neighbours.

    plate : (H, W, 3) scene-linear, upright, of the eye that `depth` (Z, confidence, flags, and disparity_sigma where known) lies on.
    px_m  : fx b of the rectified pair, px m.
    """
    return Glimpse(grey=_grey(plate), depth=depth, px_m=px_m)


def _with_checks(there: Float32, back: Float32, here: UInt8, other: UInt8) -> Motion:
    """A motion with what speaks against it: the way back, the tone of what it finds, other motions near."""
    astray = there_and_back(there, back)
    grid = np.stack(np.meshgrid(np.arange(here.shape[1], dtype=np.float32), np.arange(here.shape[0], dtype=np.float32)), axis=-1)
    found = cv2.remap(other, grid + there, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    mine, agrees = here.astype(np.float32), astray <= LIMIT_PX
    if agrees.any():  # the exposure may have changed
        mine *= np.clip((np.median(found[agrees]) + 1) / (np.median(mine[agrees]) + 1), 0.25, 4)
    astray[cv2.blur(np.abs(mine - found), LIKE) > UNLIKE_LEVELS] = np.inf
    spread = sum(cv2.dilate(c, BEND) - cv2.erode(c, BEND) for c in cv2.split(there))
    return Motion(there=there, astray=astray, bent=spread > BEND_PX)


def motion_between(a: Glimpse, b: Glimpse) -> tuple[Motion, Motion]:
    """The motion from a to b and from b to a, by dense inverse search optical flow (Kroeger et al. 2016, OpenCV's DIS)."""
    height, width = a.grey.shape
    shrink = -(-width // MOTION_WIDTH)
    size = (max(width // shrink, 16), max(height // shrink, 16))
    here, other = (g.grey if size == (width, height) else cv2.resize(g.grey, size, interpolation=cv2.INTER_AREA) for g in (a, b))
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there, back = dis.calc(here, other, None), dis.calc(other, here, None)
    return _with_checks(there, back, here, other), _with_checks(back, there, other, here)


def _regional(rate: Float32, weight: Float32, disparity: Float32, sigma: Float32, times: Float32) -> Float32:
    """The rate of each pixel's surface about it, none where noise alone may have made it."""
    known = np.isfinite(disparity)
    base = np.where(known, disparity, np.float32(0))
    slopes = robust_planes(base, known.astype(np.float32), radius=6, stride=3, tau_px=SURFACE_TAU_PX, passes=1)[1:]
    lever = float(((times - times.mean()) ** 2).sum())

    def fitted(weight: Float32, without: Float32) -> Float32:
        region = robust_planes(base, weight, radius=RATE_RADIUS, stride=RATE_STRIDE, tau_px=SURFACE_TAU_PX, passes=1, slopes=slopes, target=rate)[0]
        # Where a region has no rate, robust_planes answers with the disparity itself.
        return np.where(np.abs(region - base) < 1e-6, without, region)

    weight = np.where(known, weight * weight, np.float32(0))
    region = fitted(weight, np.zeros_like(base))
    # Once more without the pixels whose motion met another surface.
    stray = (rate - region) / np.maximum(4 * sigma / np.sqrt(np.maximum(weight, np.float32(0.05)) * np.float32(lever)), LEAST_STRAY_PX)
    region = fitted(weight * np.maximum(0, 1 - stray * stray) ** 2, region)
    doubt = np.float32(RATE_DOUBT**2 / lever) * sigma**2
    return np.asarray(region * np.maximum(0, 1 - doubt / np.maximum(region * region, np.float32(1e-12))), np.float32)


def _speaking(near: Mapping[int, tuple[Glimpse, Motion]]) -> tuple[int, ...]:
    """The neighbours on this side of any cut, by distance in frames."""
    out: list[int] = []
    for side in (-1, 1):
        for k in sorted((k for k in near if k * side > 0), key=abs):
            if near[k][1].is_cut:
                break
            out.append(k)
    return tuple(sorted(out))


def steadied(centre: Glimpse, near: Mapping[int, tuple[Glimpse, Motion]], *, window: int) -> Steadied:
    """The depth of a frame with the evidence of its neighbours.

    centre : the frame by itself.  Of its passes, Z, confidence, flags, disparity_sigma and Z_sigma change, others stay as they are.
    near   : the neighbours by their distance in frames, each with the motion to it.
    window : the farthest distance that may speak; what is farther is left out.
    """
    frames = _speaking({k: told for k, told in near.items() if 0 < abs(k) <= window})
    if not frames:
        return Steadied(frame=centre.depth, frames=(), regained=0.0)
    size = (1 + len(frames), *centre.grey.shape)
    values, sigmas, sures = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    kind = np.empty(size, np.uint8)
    values[0], sigmas[0], sures[0] = centre.disparity, centre.sigma, centre.depth["confidence"]
    kind[0] = np.where(centre.guessed, FIRM, BELIEVED | FIRM)
    for i, k in enumerate(frames, start=1):
        seen, way = near[k]
        scale = np.float32(centre.px_m / seen.px_m)
        given = (seen.disparity * scale, seen.sigma * scale, seen.depth["confidence"], ~seen.guessed)
        carry_into((values[i], sigmas[i], sures[i], kind[i]), *given, way.there, way.astray, way.bent, limit=LIMIT_PX, apart=APART_PX)
    times = np.array((0, *frames), np.float32)
    # A parabola: of all windows of this length the one whose result changes least from frame to frame.
    shares = (np.float32((window + 1) ** 2) - times**2) / np.float32((window + 1) ** 2)
    rate = _regional(*rates(values, kind, times), values[0], sigmas[0], times)
    disparity, sigma, sure, seen_by = combined(
        values, sigmas, sures, kind, times, shares, rate, own=OWN_VOTE, alike=ALIKE, near=NEAR_PX, wide=WIDE_PX, wild=WILD_PX
    )
    return _made(centre, disparity, sigma, sure, seen_by, frames)


def _made(centre: Glimpse, disparity: Float32, sigma: Float32, sure: Float32, seen: Bool, frames: tuple[int, ...]) -> Steadied:
    depth, before = centre.depth, centre.depth["flags"]
    with np.errstate(invalid="ignore", divide="ignore"):
        Z = np.where(disparity > 0, np.float32(centre.px_m) / disparity, np.float32(np.nan)).astype(np.float32)
    known = np.isfinite(Z)
    regained = centre.guessed & seen & known & ((before & np.uint16(Flag.BAD_PLATE)) == 0)
    flags = np.where(regained, before & ~REASONS, before)
    flags = np.where(known, flags & ~np.uint16(Flag.TOO_FAR), flags)
    new = {"Z": Z, "confidence": np.where(known, sure, np.float32(0)), "flags": flags}
    if "disparity_sigma" in depth:
        new["disparity_sigma"] = sigma
    if "Z_sigma" in depth:
        new["Z_sigma"] = (sigma * Z * Z / np.float32(centre.px_m)).astype(np.float32)
    return Steadied(frame=depth.with_passes(**new), frames=frames, regained=float(regained.mean()))
