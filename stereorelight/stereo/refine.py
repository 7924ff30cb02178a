"""From a dense disparity to one worth lighting: occluded ground, depth edges, and the smoothest surface that both pictures agree with.

In: a `Proxy` and its dense disparity.  Out: a `Refined` disparity with slopes and its standard deviation.  Each step is against one fault:
- ground that the other eye cannot see takes the disparity of the background beside it, and every pixel on a depth edge
  that of the side it looks like: never a blend of actor and wall;
- a robust local plane takes out the whole-pixel steps of the matcher, and strays;
- every pixel's brightness then says where it would rather be (Lucas and Kanade 1981), and a thin plate per surface, cut at
  depth edges, averages that over as many pixels as the evidence needs (engine/bending.py).  How far the surface may bend is
  found from the pair itself, region by region (MacKay 1992): a face keeps its nose while the wall behind it lies flat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.bending import plate_correction
from stereorelight.engine.bends import bend_energies, slopes
from stereorelight.engine.edges import joined_to_sides, outlined, weighed_sides
from stereorelight.engine.evidence import held_evidence, left_over
from stereorelight.engine.locking import locking_tables
from stereorelight.engine.occlusion import background, continued, unseen
from stereorelight.engine.photometric import row_splines
from stereorelight.engine.pyramid import doubled, halved
from stereorelight.engine.refine import blended, robust_planes
from stereorelight.engine.rows import at_once
from stereorelight.engine.windows import Seen
from stereorelight.stereo.beyond import ISLAND_PX, without_islands
from stereorelight.stereo.hints import on_matte_edge
from stereorelight.stereo.median import median_5
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.speckles import without_speckles


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """What is known of each pixel of the left eye; every array (H, W).

    disparity        : px.   slope_x, slope_y : its change per pixel.   unseen : ground that the right eye cannot see.
    sigma_px         : standard deviation of the disparity: noise of the pictures and expected bend of the surface together.
    slope_sigma      : standard deviation of either slope, px per px.
    clumped          : how far what the pictures still ask for hangs together from pixel to pixel: the variance of its sums over 8 x 8 px, over
                       what independent pixels would give.  About a half where noise is all that is left.
    """

    disparity: Float32
    slope_x: Float32
    slope_y: Float32
    unseen: Bool
    sigma_px: Float32
    slope_sigma: Float32
    clumped: Float32

    def flipped(self) -> Refined:
        """The same of the mirrored pair, turned back."""

        def turn(a: Float32) -> Float32:
            return np.ascontiguousarray(a[:, ::-1])

        return Refined(
            disparity=turn(self.disparity),
            slope_x=-turn(self.slope_x),
            slope_y=turn(self.slope_y),
            unseen=np.ascontiguousarray(self.unseen[:, ::-1]),
            sigma_px=turn(self.sigma_px),
            slope_sigma=turn(self.slope_sigma),
            clumped=turn(self.clumped),
        )


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much refinement a quality buys.

    passes : of the first plane fit, which looks at every `stride`-th pixel of those within `radius` and is blended with its neighbours'
             `blends` times.
    tau_px : how far off a plane a neighbour may lie and still belong to the surface; the first pass takes twice that.
    rounds : of looking at the pictures again from the better surface.
    steps  : of the solver on each level of a round; last: of the last round.
    finest : the level that rounds before the last stop at, 0 the full size, 1 half of it: they only bring the surface near enough for
             the last to look at the pictures from.
    tail   : of bends, as `plate_correction` takes it, in all rounds but the first, where steps of matching look like bends.
    mixed  : trust in pixels that show both sides of a step: what they match is neither.
    island_px : confirmed ground smaller than this is no ground to go on from beside it; where what lies about it would be hidden, it is, too.
    """

    passes: int
    rounds: int
    steps: int
    last: int
    finest: int = 0
    radius: int = 2
    stride: int = 1
    tau_px: float = 0.25
    blends: int = 1
    tail: float = 0.0
    mixed: float = 1.0
    island_px: int = 40


EFFORTS = {
    "draft": Effort(passes=1, rounds=1, steps=4, last=4, radius=6, stride=4, tau_px=0.5, island_px=0),
    "standard": Effort(passes=1, rounds=4, steps=12, last=6, finest=1),
    "fine": Effort(passes=2, rounds=4, steps=20, last=20, blends=2, tail=4.0, mixed=0.1),
}
GRAINY = 1.5  # grey levels of noise from which matches scatter more about a plane
BLEND_TAU_PX = 0.5  # planes that differ by more are of two surfaces
JUMP_PX = 1.5  # a step between neighbours that no surface worth lighting makes
EDGE_PX = 4  # how far from a step a pixel may be on the wrong side of it
SIDE_PX = 6  # even; how far to look for the two sides of a step
FATTENING_PX = 3  # how far matching carries a near surface past its outline
NOISE_FLOOR = 0.7  # grey levels: quantisation and resampling leave no less
BESIDE_PX = 3  # of hidden ground: so far an outline reaches in an interpolated row
MIXED_STEP_PX = 1.0  # over 3 px, that is two surfaces
MIXED_PX = 2  # beside a step: so far lenses, samples and splines carry the other side of it
UNSEEN_TRUST, UNSURE_TRUST = 0.02, 0.1
PRIOR = 0.02  # weight of the matched disparity where the pictures say nothing, 1/px^2: its errors hang together over many pixels
UNSEEN_PRIOR = 0.0005  # and of background copied along a row: enough to hold the level, too little to print rows
CUT_PX = 0.065  # a second difference that no surface makes: a depth edge, over which nothing binds
LEVELS = 5
BEND = 0.006  # px per px^2: what a surface bends by before anything is known of it
BEND_DOUBT = 4.0  # worth of that guess, in independent measurements
BEND_LIMITS = (0.0008, 0.15)
BEND_RADIUS = 6.0  # px over which surfaces bend alike
WIDE_RADIUS = 40.0  # px over which the guess is made less, where all that is seen there bends less
WIDE_DOUBT = 1.0  # worth of BEND there: so much ground has a say of its own even where a bend is hardly seen
CLUMP_RADIUS = 8.0  # px over which errors hang together alike
GEOMETRIC = 1.5  # mean square of bends over the square of their geometric mean
BAND = 4 * np.pi  # of frequencies that pixels can hold, squared radians per pixel


def _shrunk(a: Float32, times: int) -> Float32:
    for _ in range(times):
        a = halved(a)
    return a


def _grown(a: Float32, shape: tuple[int, int]) -> Float32:
    """A quarter-size map at full size."""
    return doubled(doubled(a, ((shape[0] + 1) // 2, (shape[1] + 1) // 2)), shape)


def clumped(weight: Float32, pull: Float32) -> Float32:
    """How far the evidence's errors hang together, (H, W): mean square of the pulls' sums over 8 x 8 px, over the sums of their weights.

    Were pixels independent and their weights true, that would be one.  Where eyes differ by more than noise (rows that do not agree, gloss,
    surfaces that no plate follows), neighbours err alike, and sums grow faster (the sandwich of robust statistics; Huber 1967).
    """
    sums, sure = _shrunk(pull, 3), _shrunk(weight, 3)
    square, sure = (cv2.GaussianBlur(a, (0, 0), CLUMP_RADIUS / 8) for a in (64 * sums * sums, sure))
    small = square / np.maximum(sure, np.float32(1e-6))
    quarter = ((weight.shape[0] + 3) // 4, (weight.shape[1] + 3) // 4)
    return _grown(doubled(small, quarter), weight.shape)


def bends_seen(disparity: Float32) -> list[Float32]:
    """Mean squares of the bends about each pixel, px^2 per px^4, on the quarter-size grid, as seen on grids of the full size, a half, a quarter
    and an eighth."""
    logs, counts = bend_energies(disparity, cut=CUT_PX)
    seen = []
    for k in range(len(logs)):
        log, count = (cv2.GaussianBlur(a, (0, 0), BEND_RADIUS / 4) for a in (logs[k], counts[k]))
        seen.append(np.exp(log / np.maximum(count, np.float32(1e-3))) * np.float32(GEOMETRIC / 16**k))
    return seen


def expected_bend(energies: list[Float32], weight: Float32, bend: Float32) -> Float32:
    """What the surface about each pixel bends by (standard deviation, px per px^2), on the quarter-size grid.

    energies : what `bends_seen` says of a disparity.   weight : local mean weight; bend: what was expected when that disparity was solved
    for; both on that grid.
    The bends that are seen, over the share of them that the evidence could determine, 1/8 bend sqrt(weight) per pixel; each seen on the
    grid that matches the width it was averaged over, so that what is left of the noise counts little.  A small bend is determined by much
    ground only, so `BEND`, what is guessed before, is first made less by what the wide surroundings say: a wall lies flatter than a face.
    Never more: creases and rows that do not agree would make all about them rough.
    """
    reach = (bend * bend * np.maximum(weight, 1e-9)) ** np.float32(-0.25)  # px that the plate averages over
    level = np.clip(np.log2(1.25 * reach), 0, 3).astype(np.int8)
    seen = np.empty_like(bend)
    for k, energy in enumerate(energies):
        np.copyto(seen, energy, where=level == k)
    determined = np.minimum(0.125 * bend * np.sqrt(weight), 0.5)

    def judged(guess: Float32 | float, doubt: float, radius: float, bends: Float32, share: Float32) -> Float32:
        window = np.float32(4 * np.pi * radius**2)
        return (np.float32(doubt) * guess + window * bends) / (np.float32(doubt) + window * share)

    wide, share = (cv2.GaussianBlur(a, (0, 0), WIDE_RADIUS / 4) for a in (np.log(np.maximum(seen, np.float32(1e-12))), determined))
    guess = np.minimum(judged(BEND**2, WIDE_DOUBT, WIDE_RADIUS, np.exp(wide), share), np.float32(BEND**2))
    square = judged(guess, BEND_DOUBT, BEND_RADIUS, seen, determined)
    return np.clip(np.sqrt(square), *BEND_LIMITS).astype(np.float32)


def _mixed(disparity: Float32) -> Bool:
    """(H, W) bool: so near a step that both sides of it show in a pixel."""
    near, around = np.ones((3, 3), np.uint8), np.ones((2 * MIXED_PX - 1, 2 * MIXED_PX - 1), np.uint8)
    steps = cv2.dilate(disparity, near) - cv2.erode(disparity, near) > MIXED_STEP_PX
    return cv2.dilate(steps.view(np.uint8), around) > 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A disparity, the weight and bend that it rests on, both on the quarter-size grid, and how far its evidence is `clumped`, (H, W)."""

    disparity: Float32
    weight: Float32
    bend: Float32
    clumped: Float32

    def sigma(self) -> tuple[Float32, Float32]:
        """Standard deviation of the disparity, px, and of its slopes, px per px: of a plate with data, in closed form.

        With weight w and stiffness 1/bend^2 the variance at frequency k is 1/(w + k^4/bend^2): 1/8 bend / sqrt(w) in all, and
        bend^2/(16 pi) log(1 + BAND^2/(bend^2 w)) of either slope.
        """
        variance = 0.125 * self.bend / np.sqrt(self.weight)
        steep = self.bend**2 / (16 * np.pi) * np.log1p(BAND**2 / (self.bend**2 * self.weight))
        sigma, slope = (np.sqrt(a).astype(np.float32) for a in (variance, steep))
        return _grown(sigma, self.disparity.shape), _grown(slope, self.disparity.shape)


def photometric_surface(proxy: Proxy, disparity: Float32, trust: Float32, *, effort: Effort) -> Surface:
    """The smoothest surface near `disparity` that makes the two pictures agree.

    trust : (H, W) 0..1, weighs the evidence; nothing is asked of the right eye where it is `UNSEEN_TRUST` or less.
    """
    grain2 = 0.5 * sum(grain**2 for grain in proxy.grains)
    tables = locking_tables(sum(proxy.steps) / 2)
    left_spline, right_spline = row_splines(proxy.left_grey), row_splines(proxy.right_grey)
    both = (trust > UNSEEN_TRUST).view(np.uint8)
    # What hides ground stands to the right of it in the left eye, and right beside it in the other: there, its outline is what is looked at.
    seen = Seen.where(cv2.erode(both, np.ones((1, 1 + BESIDE_PX), np.uint8), anchor=(0, 0)) > 0)
    if effort.mixed < 1:
        trust = np.where(_mixed(disparity) & (trust > UNSEEN_TRUST), np.float32(effort.mixed) * trust, trust)

    def evidence(d: Float32) -> tuple[Float32, Float32, Float32]:
        residual, rate = left_over(proxy.left_grey, left_spline, right_spline, d, seen)
        few = residual[::4, ::4][seen.here[::4, ::4] > 0]
        usual = (2.2 * float(np.median(few * few)) if few.size else 0.0) + NOISE_FLOOR**2
        tuning = {"most2": 9 * usual, "floor2": NOISE_FLOOR**2, "grain2": grain2}
        weight, pull, mean = held_evidence(d, residual, rate, trust, seen, disparity, **tuning, tables=tables, priors=(UNSEEN_PRIOR, PRIOR))
        return weight, pull, cv2.GaussianBlur(mean, (0, 0), BEND_RADIUS / 4)

    d = disparity
    bend: Float32 | None = None
    for k in range(effort.rounds):
        bends: Callable[[], list[Float32]] = list if bend is None else partial(bends_seen, d)
        (weight, pull, mean), energies = at_once(partial(evidence, d), bends)
        bend = np.full_like(mean, BEND) if bend is None else expected_bend(energies, mean, bend)
        finest, steps = (effort.finest, effort.steps) if k < effort.rounds - 1 else (0, effort.last)
        tail = effort.tail if k else 0.0
        moved = plate_correction(d, weight, pull, bend, cut=CUT_PX, tail=tail, levels=LEVELS, steps=steps, finest=finest)
        d = np.add(d, np.clip(moved, -1, 1, out=moved), out=moved)
    assert bend is not None
    return Surface(disparity=d, weight=mean, bend=bend, clumped=clumped(weight, pull))


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


def joined(disparity: Float32, proxy: Proxy) -> Float32:
    """`disparity` without the ramps and the fattening that matching leaves at depth edges: each pixel there joins the side it looks like."""
    zone = cv2.dilate(_ramps(disparity), np.ones((2 * FATTENING_PX + 1, 2 * FATTENING_PX + 1), np.uint8)) > 0
    sides = joined_to_sides(disparity, zone, proxy.left, jump_px=JUMP_PX)
    # Each pixel chose for itself; the median lets an outline be a line.
    outline = cv2.dilate(_ramps(sides), np.ones((3, 3), np.uint8)) > 0
    return np.where(outline, cv2.medianBlur(sides, 5), sides)


def lined(disparity: Float32, picture: UInt8) -> Float32:
    """`disparity` with its outlines put on those of the picture."""
    return outlined(disparity, _ramps(disparity).view(np.bool_), picture)


def sided(disparity: Float32, proxy: Proxy) -> Float32:
    """`disparity` with its edges where both pictures speak for them."""
    ramps = _ramps(disparity)
    zone = cv2.dilate(ramps, np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8)) > 0
    ramp = cv2.dilate(ramps, np.ones((3, 3), np.uint8)) > 0
    around = np.ones((2 * SIDE_PX + 1, 2 * SIDE_PX + 1), np.uint8)
    low = cv2.erode(np.where(ramp, np.float32(1e9), disparity), around)
    high = cv2.dilate(np.where(ramp, np.float32(-1e9), disparity), around)
    steep = (cv2.Sobel(p, cv2.CV_32F, 1, 0, scale=1 / 8) for p in (proxy.left_grey, proxy.right_grey))
    return weighed_sides(disparity, zone, ramp, low, high, proxy.left, proxy.right, *steep, radius_px=SIDE_PX, jump_px=JUMP_PX)


def refine(
    proxy: Proxy,
    dense: Float32,
    confirmed: Bool,
    *,
    known: Bool | None = None,
    ramps: bool = False,
    calm: UInt8 | None = None,
    effort: Effort = EFFORTS["standard"],
    subject: Bool | None = None,
    ignore: Bool | None = None,
) -> Refined:
    """The refined disparity of the left eye.

    dense     : (H, W) disparity with a value everywhere.   confirmed : (H, W), the right eye says the same.
    known     : (H, W), the rest of `dense` is no answer: the background beside it is put there.
    ramps     : the matcher leaves ramps and fattened outlines at edges, which are then taken out first.
    calm      : the left picture with less grain, to tell things apart by.
    subject   : (H, W), what stands before the rest, where a matte tells: the step at its outline lies on the matte's edge.
    ignore    : (H, W), ground whose brightness says nothing of its depth.
    """
    calm = proxy.left if calm is None else calm
    fine = _from_rows_that_match(dense, proxy)
    sure = confirmed if known is None else confirmed & known
    firm = sure
    if effort.island_px:
        matches = np.where(sure, fine, np.float32(np.nan))
        firm, large = at_once(
            lambda: np.isfinite(without_speckles(matches, effort.island_px)), lambda: np.isfinite(without_speckles(matches, ISLAND_PX))
        )
        firm = without_islands(firm, large, fine, calm)
    behind = background(fine, firm)
    # Hidden: what would be hidden if it were the background, so that a thin thing before a wall keeps its own value.
    # The median takes out streaks: a row whose nearest match is wrong.
    hidden, (beyond, calm_behind) = at_once(
        lambda: unseen(np.where(firm, fine, behind)) | unseen(fine),
        lambda: (_out_of_range(fine, sure), continued(median_5(behind), fine, firm)),
    )
    lost = (hidden | beyond) & ~firm
    empty = lost if known is None else lost | ~known
    filled = np.where(empty, calm_behind, fine)
    sure &= ~lost
    trust = np.where(sure, np.float32(1), np.float32(UNSURE_TRUST))
    trust[lost] = UNSEEN_TRUST
    if ramps:
        filled = joined(filled, proxy)
    else:
        filled = lined(filled, calm)
    if subject is not None:
        filled, moved = on_matte_edge(filled, sure, subject)
        trust[moved] = np.minimum(trust[moved], np.float32(UNSURE_TRUST))
    if ignore is not None:
        trust[ignore] = UNSEEN_TRUST
    if effort.passes:
        tau_px = effort.tau_px * float(np.clip(proxy.noise() / GRAINY, 1, 2))
        planes = robust_planes(filled, trust, radius=effort.radius, stride=effort.stride, tau_px=tau_px, passes=effort.passes)
        for _ in range(effort.blends):
            planes = blended(planes, tau_px=BLEND_TAU_PX)
        filled = planes[0]
    if ramps:
        filled = sided(filled, proxy)
    surface = photometric_surface(proxy, filled, trust, effort=effort)
    disparity = surface.disparity
    (slope_x, slope_y), (sigma, slope_sigma) = at_once(lambda: slopes(disparity, cut=CUT_PX), surface.sigma)
    return Refined(
        disparity=disparity,
        slope_x=slope_x,
        slope_y=slope_y,
        unseen=lost,
        sigma_px=sigma,
        slope_sigma=slope_sigma,
        clumped=surface.clumped,
    )
