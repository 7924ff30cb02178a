"""Two plates and a rectification to Z, confidence and reasons on the ORIGINAL plate, lens distortion and all.

In: upright scene-linear plates (H, W, 3).  Out: a `Recovered`: the passes on the original plate of one eye, and the
disparity on its rectified view.  Z is the distance along the original camera's optical axis, metres."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.camera import Eye
from stereorelight.engine.distance import distances
from stereorelight.engine.occlusion import consistent
from stereorelight.engine.resample import on_planes
from stereorelight.engine.rows import at_once
from stereorelight.errors import PlateError
from stereorelight.passes import Flag, Frame
from stereorelight.stereo import confidence as belief
from stereorelight.stereo.colour_match import ColourMatch
from stereorelight.stereo.colour_match import match_colour as colour_matched
from stereorelight.stereo.draft import full_size
from stereorelight.stereo.flow import FlowMatch, flow_disparity
from stereorelight.stereo.halves import half_rig, half_view, nearest
from stereorelight.stereo.hints import Hinted, Hints, hinted
from stereorelight.stereo.match import Match, lost_on_bare_ground, match
from stereorelight.stereo.matchers import OWN, match_by, matcher_named
from stereorelight.stereo.order import refuse_one_picture
from stereorelight.stereo.proxy import Proxy, matching_proxy, picture_of
from stereorelight.stereo.rectify import Rectification
from stereorelight.stereo.refine import EFFORTS, Refined, refine
from stereorelight.stereo.search import coarse_disparity, search_range
from stereorelight.stereo.semi_global import DisparityRange
from stereorelight.stereo.settings import DepthSettings

SMALLEST_DISPARITY_PX = 0.25  # of d + doffs: beyond it, depth is anything up to infinity
MatchColour = Literal["off", "global", "local"]
DRAFT_CONSISTENCY_PX = 0.75  # half-size pixels: whole-pixel matches cannot agree better
DRAFT_LOST = 0.04  # share of a draft's picture that is bare and unconfirmed from which it is matched as other pictures are
DRAFT_SMALLEST_PX = 64  # of half a picture's side that a draft is made on
APART_PX = 1.0  # disparities farther apart belong to two surfaces when Z is carried to the plate


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovered:
    """What was found.

    frame      : Z, confidence, flags, disparity_sigma, Z_sigma on the original plate of the eye.
    rectified  : disparity, disparity_sigma, confidence, flags on that eye's rectified view.
    search     : the range searched.   vertical_px: the median row error that the flow saw.
    colour     : how the right eye's colours were matched, where they were.
    """

    frame: Frame
    rectified: Frame
    search: DisparityRange
    vertical_px: float
    colour: ColourMatch | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class RectifiedDepth:
    """The disparity of one rectified eye with what is known about it."""

    refined: Refined
    confidence: Float32
    flags: np.ndarray
    vertical_px: float


def matched(proxy: Proxy, search: DisparityRange, settings: DepthSettings) -> Match:
    """Both eyes of a rectified pair, by the matcher that is asked for.  A draft does without SGBM and smaller copies, unless much of its bare ground
    is lost so (docs/decisions/0070-drafts-of-bare-rooms.md)."""
    if settings.matcher != OWN:
        return match_by(matcher_named(settings.matcher), settings.matcher.partition(":")[0], proxy, search)
    if settings.quality == "draft":
        quick = match(proxy, search, led=False)
        if lost_on_bare_ground(proxy, quick, within_px=DRAFT_CONSISTENCY_PX) < DRAFT_LOST:
            return quick
    return match(proxy, search, exhaustive=settings.quality == "fine")


def half_settings(settings: DepthSettings) -> DepthSettings:
    """Those of a plate, for a draft's half-size pictures."""
    return replace(settings, consistency_px=max(settings.consistency_px / 2, DRAFT_CONSISTENCY_PX))


def _draft(proxy: Proxy, search: DisparityRange, settings: DepthSettings, plate: Float32, eye: Eye, hints: Hinted | None) -> RectifiedDepth:
    """From the half-size `proxy`, the disparity carried up with the edges of the full-size `plate`."""
    half = half_settings(settings)
    depth, picture = at_once(lambda: _of_pair(proxy, search, half, None, hints, px=2.0), lambda: picture_of(plate, eye))
    size = (picture.shape[0], picture.shape[1])
    refined, (confidence, flags) = at_once(
        lambda: full_size(depth.refined, picture), lambda: tuple(np.ascontiguousarray(nearest(a, size)) for a in (depth.confidence, depth.flags))
    )
    return RectifiedDepth(refined=refined, confidence=confidence, flags=flags, vertical_px=depth.vertical_px)


def refined_with_evidence(
    proxy: Proxy, found: Match, settings: DepthSettings, flow: FlowMatch | None, hints: Hinted | None = None
) -> tuple[Refined, Bool, belief.Evidence]:
    """Check and refine what was found for the left eye of a rectified pair: its disparity, (H, W) where both eyes confirm the match, and what
    there is to judge it by.  `flow` is the second opinion, None in a draft."""
    confirmed = consistent(found.left, found.right, within_px=settings.consistency_px)
    dense, known = found.dense, np.isfinite(found.left)
    if flow is not None:
        # Where matching found nothing and flow, sure of itself, stays near the value beside it, flow fills.
        with np.errstate(invalid="ignore"):
            useful = ~known & (np.abs(flow.disparity - dense) <= 2 * settings.consistency_px)
        dense = np.where(useful, flow.disparity, dense)
        known |= useful
    if flow is not None:  # a draft does without: a tenth of its time, for detail that it does not have
        proxy = proxy.toned(found.dense, confirmed)
    subject = None if hints is None else hints.subject
    ignore = None if hints is None else hints.ignore
    if ignore is not None:
        confirmed, known = confirmed & ~ignore, known & ~ignore
        flow = None if flow is None else replace(flow, disparity=np.where(ignore, np.float32(np.nan), flow.disparity))
    refined = refine(
        proxy, dense, confirmed, known=known, ramps=settings.matcher != OWN, calm=found.calm, effort=EFFORTS[settings.quality],
        subject=subject, ignore=ignore,
    )  # fmt: skip
    confirmed &= ~refined.unseen  # what matched by chance where nothing is to be seen
    return refined, confirmed, belief.evidence(proxy, refined, confirmed, None if flow is None else flow.disparity, found, ignore)


def _of_pair(
    proxy: Proxy, search: DisparityRange, settings: DepthSettings, flow: FlowMatch | None, hints: Hinted | None, px: float = 1.0
) -> RectifiedDepth:
    """The left eye of a rectified pair, judged; `px`: pixels of the plate in one of the pair's, since confidence is about a pixel of the plate."""
    refined, confirmed, evidence = refined_with_evidence(proxy, matched(proxy, search, settings), settings, flow, hints)
    if px == 1:
        confidence = belief.confidence_from_evidence(evidence)
    else:
        confidence = belief.confidence_from_evidence(evidence.in_pixels(px), *belief.of_drafts(evidence))
    sigma, flags = at_once(
        lambda: belief.sigma_from_evidence(evidence, confidence),
        lambda: belief.reasons(refined, confirmed, proxy.left_known, proxy.right_known),
    )
    return RectifiedDepth(
        refined=replace(refined, sigma_px=sigma),
        confidence=confidence,
        flags=flags,
        vertical_px=float("nan") if flow is None else flow.vertical_px,
    )


def _flipped(depth: RectifiedDepth) -> RectifiedDepth:
    """The depth of the mirrored pair, turned back."""

    def turn(a: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(a[:, ::-1])

    return RectifiedDepth(refined=depth.refined.flipped(), confidence=turn(depth.confidence), flags=turn(depth.flags), vertical_px=depth.vertical_px)


def depth_on_plate(depth: RectifiedDepth, rectification: Rectification, *, eye: Eye = "left", fill: bool = True) -> Frame:
    """Z, confidence, flags and standard deviations carried to the original plate in one resampling; two surfaces are never mixed.

    fill : keep values that are only guesses (flagged FILLED); off, they are NaN.
    """
    rig = rectification.rig
    refined, camera = depth.refined, rectification.original.camera(eye)
    if rectification.identity:
        disparity, flags, sure, sigma = refined.disparity, depth.flags.copy(), depth.confidence.copy(), refined.sigma_px.copy()
        stretch = np.ones(1)
    else:
        disparity, nearest = on_planes(
            refined.disparity, (refined.slope_x, refined.slope_y), rectification.rectified_from_original(eye), apart=APART_PX
        )
        flags, sure, sigma = (a.ravel()[np.maximum(nearest, 0)] for a in (depth.flags, depth.confidence, refined.sigma_px))
        flags[nearest < 0], sure[nearest < 0] = np.uint16(Flag.OUT_OF_VIEW | Flag.UNMATCHED), 0
        stretch = rectification.original_over_rectified_depth(eye)
    Z, Z_sigma = distances(
        disparity,
        flags,
        sure,
        sigma,
        per=rig.left.fx * rig.baseline_m,
        doffs=rig.doffs_px,
        stretch=stretch,
        smallest=SMALLEST_DISPARITY_PX,
        far_flag=Flag.TOO_FAR,
        dropped=0 if fill else Flag.FILLED,
    )
    return Frame(passes={"Z": Z, "confidence": sure, "flags": flags, "disparity_sigma": sigma, "Z_sigma": Z_sigma}, camera=camera, eye=eye)


def recover(
    left: Float32,
    right: Float32,
    rectification: Rectification,
    *,
    settings: DepthSettings | None = None,
    eye: Eye = "left",
    match_colour: MatchColour = "off",
    hints: Hints | None = None,
) -> Recovered:
    """Depth of `eye` from upright scene-linear plates.

    left, right  : (H, W, 3) float32, NaN where a plate is broken.
    match_colour : give the right eye the left one's colours first, by what both see: "global", or "local" with a smooth field.
    hints        : mattes on the plate of `eye`: what to ignore, and where the subject ends.
    Raises       : PlateError when sizes do not fit the rig, nothing matches, the eyes look swapped, or both plates are one picture.
    """
    settings = settings or DepthSettings()
    refuse_one_picture(left, right)
    views = rectification.rectify(left, "left", to_match=True), rectification.rectify(right, "right", to_match=True)
    rig = rectification.rig
    draft = settings.quality == "draft" and min(views[0].shape[:2]) >= 2 * DRAFT_SMALLEST_PX
    shown = at_once(lambda: half_view(views[0]), lambda: half_view(views[1])) if draft else views
    steps = (1.0, 1.0) if draft else (rectification.step("left"), rectification.step("right"))
    proxy = matching_proxy(*shown, steps=steps, even=not draft)

    def opinion() -> FlowMatch | None:
        return None if settings.quality == "draft" else flow_disparity(proxy if eye == "left" else proxy.flipped())

    # Not beside the matching: OpenCV's threads serve one caller at a time, and SGBM would run on one core whenever flow comes first.
    search, flow = at_once(
        lambda: search_range(proxy, half_rig(rig) if draft else rig, near_m=settings.near_m, far_m=settings.far_m),
        lambda: opinion() if match_colour == "off" else None,
    )
    colour = None
    if match_colour != "off":
        mended, colour = colour_matched(*shown, mode=match_colour, disparity=coarse_disparity(proxy, search))
        proxy = matching_proxy(shown[0], mended, steps=steps, even=not draft)
        flow = opinion()
    if search.count > proxy.left.shape[1]:
        wide, reach = views[0].shape[1], search.doubled() if draft else search
        raise PlateError(f"disparities {reach.low} to {reach.high} px do not fit plates {wide} px wide; check near_m and far_m against the rig")
    pair = proxy if eye == "left" else proxy.flipped()
    mattes = hinted(hints, rectification, eye, size_hw=(pair.left_grey.shape[0], pair.left_grey.shape[1]))
    if draft:
        plate = views[0] if eye == "left" else np.ascontiguousarray(views[1][:, ::-1])
        depth, search = _draft(pair, search, settings, plate, eye, mattes), search.doubled()
    else:
        depth = _of_pair(pair, search, settings, flow, mattes)
    depth = depth if eye == "left" else _flipped(depth)

    def on_rectified() -> Frame:
        passes = {
            "disparity": depth.refined.disparity,
            "disparity_sigma": depth.refined.sigma_px,
            "confidence": depth.confidence,
            "flags": depth.flags,
        }
        return Frame(passes=passes, camera=rig.left if eye == "left" else rig.right, eye=eye)

    frame, rectified = at_once(lambda: depth_on_plate(depth, rectification, eye=eye, fill=settings.fill), on_rectified)
    return Recovered(frame=frame, rectified=rectified, search=search, vertical_px=depth.vertical_px, colour=colour)
