"""How far to believe each disparity, and why some are only guesses.

In: the match, the refined disparity and the flow's second opinion.  Out: confidence (H, W), the share of such pixels
within 1 px of truth, and reason flags.  The evidence: the right eye confirms the match, here and round about; the flow confirms
it, here and round about; no edge is near; the refinement's own standard deviation, which knows noise and texture; what is left
between the eyes there, beside the plates' grain; whether they share anything but grain; whether there is texture to match by; how uneven
the surface is; whether semi-global matching by itself says the same nearby; how much of what both eyes see was matched at all:
where matching is lost on much of a picture, its guesses are less sure; and plain ground that took the plane of the rims about it, or was put on
one of its own.  Deviations are beside what is usual in the picture, where that is more than grain.
A logistic regression weighs it.  Its coefficients were fitted on synthetic shots; docs/depth.md shows the check on
footage that had no part in the fit.  The same evidence gives the standard deviation of the disparity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt16
from stereorelight.engine.belief import believed, deviation
from stereorelight.engine.occlusion import lands_on_plate
from stereorelight.engine.photometric import brightness_residual
from stereorelight.engine.rows import at_once
from stereorelight.passes import Flag
from stereorelight.stereo.match import Match
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
    "log texture",
    "log uneven",
    "log lost",
    "on rims",
    "log led",
    "on walls",
    "confirmed nearby x log led",
)
COEFFICIENTS = np.array(
    [2.8, 0.973, 0.0, -0.62, -1.36, 0.761, 0.245, -1.034, -0.756, -0.271, -0.6, 0.15, -0.308, 0.0, 2.35, 1.478, -1.177, 0.706], dtype=np.float32
)
# Of half-size pictures without a second opinion or SGBM, their lengths in pixels of the plate; none of their ground lies on rims or planes.
DRAFT_COEFFICIENTS = np.array(
    [0.062, 0.421, 0.421, -0.928, -1.274, 0.99, 1.388, -0.215, -0.575, -0.257, -0.883, 0.498, -0.379, -0.069, 0.0, 0.0, 0.0, 0.0], dtype=np.float32
)
# By which ground of which nothing is known but what lies beside it is told right; where the eyes share nothing; and the share that is lost by
# which both are less by a factor of e.
FLOORS, DRAFT_FLOORS = (0.52, 0.18, 0.5), (0.7, 0.22, 0.4)
# log(standard deviation / 0.03 px) as always, log of the refinement's own, log of doubt, log of how far errors hang together, and what is missing
# of `SURE` where the eyes share nothing: a match that is wrong there is wrong by any amount.
SIGMA_COEFFICIENTS = (0.917, 0.847, 0.705, 0.267, 2.954)
SURE = 0.8
MOST_SIGMA_PX = 16.0
WINDOW = (7, 7)
CONFIRMED_NEARBY, FLOW_NEARBY = (9, 9), (15, 15)
MISFIT = (5, 5)
LEAST_GRAIN = 0.5  # grey levels
SHARED = (5, 5)  # half-size px
LEAST_SHOWN = 0.2  # of the grain's variance: less is as good as nothing to share
ENOUGH_SHARED = 0.5  # correlation from which eyes count as showing the same
USUAL_SIGMA_PX, USUAL_DOUBT = 0.03, 0.02
USUALLY_CLUMPED, LEAST_CLUMPED = 0.5, 0.05
TEXTURE = (5, 5)
LED, FEW_LED = (31, 31), 0.1  # and the share of it by which nothing else is told where less than that speaks
UNEVEN = 5  # quarter-size px, odd
LEAST_LOST = 0.05  # of what both eyes see: outlines are lost in every pair
USUAL_SHARE = 0.125  # of the logarithm of the usual misfit; a fourth is what it makes sigma wider by, were it all noise
IGNORED_SIGMA_PX = 1.0  # of ground whose brightness may not speak: no texture there makes it surer


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What speaks for and against each pixel of a refined disparity; every array (H, W) float32.

    confirmed, flow_agrees               : 1 where the right eye, the flow say the same, else 0.
    confirmed_nearby, flow_agrees_nearby : the share of the pixels about it where they do.
    misfit  : variance of what is left between the eyes over 5 x 5, over that of the plates' grain; an even difference counts nothing.
    alone   : 1 where the eyes share nothing of what they show round about, 0 where their correlation is `ENOUGH_SHARED` or more.
    spread  : range of disparity nearby, px.   sigma : the refinement's own, px.   clumped : `Refined`'s.
    texture : change of grey along the row, root mean square over 5 x 5, over the grain.
    uneven  : standard deviation of the disparity about a plane, over 20 x 20, px.
    lost    : one number, the share of what both eyes see where the right eye does not confirm the match.
    on_rims : 1 on plain ground that took the plane of the rims about it, else 0; None: there is none.
    led     : the share of what both eyes see over `LED` on which semi-global matching by itself says the same; None: it was not asked.
    on_walls: 1 on plain ground that was put on a plane, else 0; None: none was.
    usual   : one number, at least 1: the misfit in the middle of those that are confirmed.
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
    texture: Float32
    uneven: Float32
    lost: float
    on_rims: Float32 | None = None
    led: Float32 | None = None
    on_walls: Float32 | None = None
    usual: float = 1.0

    def in_pixels(self, px: float) -> Evidence:
        """The same with lengths in pixels of which `px` make one of these: half the size is judged as what it is on the plate."""
        scale = np.float32(px)
        # Where all of a picture differs by more than grain, a draft errs all over: there nothing is usual.
        return replace(self, spread=scale * self.spread, sigma=scale * self.sigma, uneven=scale * self.uneven, usual=1.0)


def texture(grey: Float32, grain: float) -> Float32:
    """(H, W): what there is to match by along the row, root mean square change of grey per pixel over `grain`."""
    steep = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8)
    square = cv2.blur(cv2.multiply(steep, steep, dst=steep, scale=1 / grain**2), TEXTURE)
    return cv2.sqrt(np.maximum(square, np.float32(0), out=square), square)


def uneven(disparity: Float32) -> Float32:
    """(H, W) px: standard deviation of the disparity about the plane that fits it best, over `UNEVEN` quarter-size pixels.

    Squares that each lie flat on a board that does not, and ground filled from here and from there, are less even than what was seen.
    """
    height, width = disparity.shape
    small = cv2.resize(disparity, ((width + 3) // 4, (height + 3) // 4), interpolation=cv2.INTER_AREA)
    small = small - np.float32(small.mean())  # squares of small numbers are exact enough
    window = (UNEVEN, UNEVEN)
    mean = cv2.blur(small, window)
    left_over = cv2.blur(small * small, window) - mean * mean
    steps, even = np.arange(UNEVEN, dtype=np.float32) - UNEVEN // 2, np.full(UNEVEN, 1 / UNEVEN, np.float32)
    for across, down in ((steps / UNEVEN, even), (even, steps / UNEVEN)):
        moment = cv2.sepFilter2D(small, cv2.CV_32F, across, down)
        left_over -= moment * moment / np.float32(np.mean(steps * steps))
    return cv2.resize(np.sqrt(np.maximum(left_over, 0)), (width, height), interpolation=cv2.INTER_LINEAR)


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


def led_share(led: Float32, disparity: Float32, speaks: Bool) -> Float32:
    """(H, W): the share of what `speaks` (H, W) over `LED` on which another matcher's `led`, NaN where it says nothing, is the same to 1 px.

    On ground with nothing to match by one matcher finds this and another that, and each may be as smooth and as well confirmed as a right one.
    """
    with np.errstate(invalid="ignore"):
        agrees = (np.abs(led - disparity) <= 1) & speaks
    same, all_of = (cv2.blur(a.astype(np.float32), LED) for a in (agrees, speaks))
    return np.divide(same + np.float32(FEW_LED), all_of + np.float32(FEW_LED), out=same)


def evidence(
    proxy: Proxy, refined: Refined, confirmed: Bool, flow: Float32 | None, found: Match | None = None, ignore: Bool | None = None
) -> Evidence:
    """Gather the evidence; `flow` None counts as a second opinion that agrees wherever the right eye does.

    found  : what the matching said, where it was ours.   ignore: (H, W), ground that no match was asked of, and that none is missed on.
    """
    d = refined.disparity
    residual = brightness_residual(proxy.left_grey, proxy.right_grey, d)[0]
    near = np.ones(WINDOW, np.uint8)
    sure = confirmed.astype(np.float32)

    def said() -> tuple[Float32, Float32, Float32, Float32, Float32]:
        with np.errstate(invalid="ignore"):
            agrees = sure if flow is None else (np.abs(flow - d) <= 1).astype(np.float32)
        return agrees, cv2.blur(sure, CONFIRMED_NEARBY), cv2.blur(agrees, FLOW_NEARBY), cv2.dilate(d, near) - cv2.erode(d, near), uneven(d)

    def seen() -> tuple[Float32, Float32, Float32, float, float, Float32 | None]:
        mean = cv2.blur(residual, MISFIT)
        left_over = np.maximum(cv2.blur(residual * residual, MISFIT) - mean * mean, np.float32(0))
        grain = max(proxy.grains[0], LEAST_GRAIN)
        speaks = lands_on_plate(d, proxy.right_known) & proxy.left_known & ~refined.unseen
        other = np.where(speaks, proxy.left_grey - residual, proxy.left_grey)  # what one eye alone can see speaks neither way
        asked = speaks if ignore is None else speaks & ~ignore
        lost = 1 - float(np.count_nonzero(asked & confirmed)) / max(float(np.count_nonzero(asked)), 1.0)
        misfit = left_over / np.float32(2 * grain * grain)
        some = misfit[::4, ::4][(asked & confirmed)[::4, ::4]]
        usual = max(float(np.median(some)), 1.0) if some.size else 1.0
        led = None if found is None or found.led is None else led_share(found.led, d, speaks)
        return misfit, alone(proxy.left_grey, other, grain), texture(proxy.left_grey, grain), lost, usual, led

    (agrees, confirmed_nearby, agrees_nearby, spread, rough), (misfit, lonely, shown, lost, usual, led) = at_once(said, seen)
    return Evidence(
        confirmed=sure,
        flow_agrees=agrees,
        confirmed_nearby=confirmed_nearby,
        flow_agrees_nearby=agrees_nearby,
        misfit=misfit,
        alone=lonely,
        spread=spread,
        sigma=refined.sigma_px if ignore is None else np.where(ignore, np.maximum(refined.sigma_px, np.float32(IGNORED_SIGMA_PX)), refined.sigma_px),
        clumped=refined.clumped,
        texture=shown,
        uneven=rough,
        lost=lost,
        on_rims=None if found is None or found.on_rims is None else found.on_rims.astype(np.float32),
        on_walls=None if found is None or found.on_walls is None else found.on_walls.astype(np.float32),
        led=led,
        usual=usual,
    )


def confidence_from_evidence(e: Evidence, coefficients: Float32 = COEFFICIENTS, least: tuple[float, float, float] = FLOORS) -> Float32:
    """(H, W) float32, 0..1: among pixels of confidence c a share of about c is within 1 px of truth.

    Where eyes differ by more than grain all over (compression, sharpening, rows that do not quite agree), that they do tells no pixel from
    another: misfit counts in what is usual, and the refinement's sigma, which took it for noise, is made less.
    """
    always = (
        coefficients[0] + coefficients[13] * np.log(np.float32(LEAST_LOST + e.lost)) - coefficients[4] * np.float32(USUAL_SHARE * np.log(e.usual))
    )
    weights = np.concatenate([[always], coefficients[1:13], coefficients[14:]]).astype(np.float32)
    nearby = (e.confirmed_nearby, e.flow_agrees_nearby)
    on_rims, on_walls = (np.zeros_like(e.sigma) if a is None else a for a in (e.on_rims, e.on_walls))
    led = np.ones_like(e.sigma) if e.led is None else e.led
    misfit = e.misfit if e.usual == 1 else e.misfit / np.float32(e.usual)
    given = (e.confirmed, e.flow_agrees, *nearby, e.spread, e.sigma, misfit, e.alone, e.texture, e.uneven, on_rims, led, on_walls)
    return believed(weights, *given, floors=floors(e.lost, least))


def of_drafts(e: Evidence) -> tuple[Float32, tuple[float, float, float]]:
    """The coefficients and floors of half-size pictures: their own, and those of all others where they were matched as all others are."""
    return (DRAFT_COEFFICIENTS, DRAFT_FLOORS) if e.led is None else (COEFFICIENTS, FLOORS)


def floors(lost: float, least: tuple[float, float, float] = FLOORS) -> tuple[float, float]:
    """What confidence is at least where nothing is known of a pixel but what lies beside it, and where the eyes share nothing."""
    floor = least[0] * float(np.exp(-lost / least[2]))
    return floor, min(least[1], floor)


def sigma_from_evidence(e: Evidence, confidence: Float32, coefficients: tuple[float, float, float, float, float] = SIGMA_COEFFICIENTS) -> Float32:
    """(H, W) px: the standard deviation of the disparity; 68 % of such pixels are within it, as the synthetic shots were.

    The refinement's own sigma knows noise and bend, and takes pixels for independent; this adds what it cannot know: a wrong surface, and
    errors that hang together.
    """
    return deviation(
        (*coefficients, SURE), e.sigma, confidence, e.clumped, e.alone,
        sigma_px=USUAL_SIGMA_PX, doubt=USUAL_DOUBT, clumps=USUALLY_CLUMPED, least_clumped=LEAST_CLUMPED, most_px=MOST_SIGMA_PX,
    )  # fmt: skip


def reasons(refined: Refined, confirmed: Bool, left_known: Bool, right_known: Bool) -> UInt16:
    """(H, W) uint16 of `Flag` bits: why a value is only a guess."""
    seen = lands_on_plate(refined.disparity, right_known)
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
