"""What the measurements of the two eyes mean: a `Finding` for each property, in words with sizes.

In: plain numbers (of `calibration.drift`, `calibration.alignment`, `health.alignment`).  Right against left.  Pixels of the
left plate, degrees, per cent."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from stereorelight.health.alignment import Strips
from stereorelight.health.finding import Finding, Level

LEAST_MATCHES = 60  # under this no rows are compared and no rig is mended
FEW_MATCHES = 200  # fewer leave whole parts of the frame unseen
# Semi-global matching compares rows: from about half a pixel on it loses matches, from one on it makes false depth.
VERTICAL_WARN_PX, VERTICAL_BAD_PX = 0.4, 1.0
# Roll and zoom that put half a pixel of row at the edge of a 1080-line frame.
ROLL_WARN_DEG, ZOOM_WARN_PERCENT = 0.05, 0.1
TURN_WARN_DEG = 0.02  # pitch and yaw: 0.6 px at 1080 lines and 40 degrees
GRAVE = 6.0  # times the tolerance: no longer a nuisance
SURE_SIGMAS = 3.0
STALE_GAIN = 0.7  # a moved rig must explain three tenths of the error on parts of the frame that the solve did not see
STALE_PX = 0.15  # and rows must be off by this much at all
BEHIND_SHARE = 0.5
MIRROR_RATIO = 4.0  # times as many matches after the flip
MEND = 'mend it from the footage with [rig] drift = "shot" (or "frame" where it moves during the shot), or recalibrate'
Frames = Sequence[tuple[int | None, float]]


def judge_matches(counts: Frames) -> Finding:
    """Whether enough points are seen by both eyes.  counts : (frame, matches)."""
    frames = tuple((number, float(count)) for number, count in counts)
    least = min((count for _, count in frames), default=0.0)
    at = next((f"frame {number} has" for number, count in frames if count == least and number is not None), "the plates have")
    level: Level = "bad" if least < LEAST_MATCHES else "warn" if least < FEW_MATCHES else "good"
    few = level != "good"
    return Finding(
        name="matches",
        level=level,
        value=least,
        words=f"{at} {least:.0f} points that both eyes see" + (f"; under {LEAST_MATCHES} no rows can be compared" if level == "bad" else ""),
        remedy="check that both plates show the same scene at the same moment, lit and in focus; choose a frame with more texture" if few else "",
        frames=frames,
    )


def judge_one_picture(same: Frames) -> Finding:
    """Whether one eye was given twice.  same : (frame, 1 where both plates are one picture, bit for bit, else 0)."""
    frames = tuple((number, float(value)) for number, value in same)
    count = sum(value > 0 for _, value in frames)
    words = "the plates are two pictures"
    if count:
        words = "both plates are one picture, bit for bit" + (f", on {count} of {len(frames)} frames looked at" if len(frames) > 1 else "")
    remedy = "give each eye its own file; was one of them copied or exported under the other's name?" if count else ""
    return Finding(name="one_picture", level="bad" if count else "good", value=float(count), unit="frames", words=words, remedy=remedy, frames=frames)


def judge_mirrored(as_is: int, mirrored: int, *, in_front: float = math.nan, declared: str | None = None) -> Finding:
    """Whether one eye is flipped left-right against the other.

    as_is, mirrored : matches as the plates are (after the rig's own flip), and with the right one flipped.
    in_front        : with a rig: share of the flipped matches in front of it, NaN without.
    declared        : the eye that the rig calls mirrored.
    """
    details: dict[str, object] = {"matches_as_is": as_is, "matches_mirrored": mirrored}
    if max(as_is, mirrored) < LEAST_MATCHES:
        words = f"too few points match either way ({as_is} as they are, {mirrored} with one eye flipped) to say whether one eye is mirrored"
        return Finding(name="mirrored", level="unknown", words=words, remedy="choose a frame with more texture", details=details)
    if mirrored < MIRROR_RATIO * max(as_is, 1):
        return Finding(name="mirrored", level="good", value=0.0, words="neither eye is mirrored against the other", details=details)
    seen = f"{mirrored} points match once an eye is flipped left-right, {as_is} as they are"
    if declared in ("left", "right"):
        words = f"one eye is mirrored although the rig's {declared} eye has been flipped back: {seen}"
        remedy = f'take "mirrored": "{declared}" out of the rig if the plates were flipped on set or in the camera, or name the other eye there'
        return Finding(name="mirrored", level="bad", value=1.0, words=words, remedy=remedy, details=details)
    eye = "" if math.isnan(in_front) else "right" if in_front > 0.9 else "left" if in_front < 0.1 else ""
    which = (
        f"the {eye} eye, by the depths that the rig then gives, unless left and right are swapped too" if eye else "which one, pictures cannot tell"
    )
    remedy = f'say "mirrored": "{eye or "left"}" in the rig' + ("" if eye else ' (or "right": the eye that looked into the beam-splitter\'s mirror)')
    details |= {"eye": eye or None}
    return Finding(name="mirrored", level="bad", value=1.0, words=f"one eye is mirrored ({which}): {seen}", remedy=remedy, details=details)


def judge_upside_down(upside_down: bool) -> Finding:
    """Whether one eye stands on its head against the other."""
    if not upside_down:
        return Finding(name="upside_down", level="good", value=0.0, words="both eyes are the same way up")
    words = "one eye is upside down: rows of the left picture match rows of the right one in reverse order"
    return Finding(name="upside_down", level="bad", value=1.0, words=words, remedy="turn that eye's plates by 180 degrees before anything else")


def judge_swapped(strips: Strips, *, behind: float = math.nan, behind_exchanged: float = math.nan) -> Finding:
    """Whether the left plate is the right eye's.

    strips                   : votes of the half-occluded strips; they need no rig.
    behind, behind_exchanged : share of matches behind the rig, as the plates are and with the eyes exchanged; NaN without a rig.
    """
    rig_says = "unclear"
    if behind > BEHIND_SHARE and behind_exchanged < BEHIND_SHARE:
        rig_says = "swapped"
    elif behind < 0.1 and behind_exchanged > BEHIND_SHARE:
        rig_says = "right"
    total = strips.behind + strips.before
    votes = f"{strips.before} of {total} half-hidden strips look like what would be in front"
    placed = f"{100 * behind:.0f} % of the matches lie behind the rig"
    details = {"strips_behind": strips.behind, "strips_before": strips.before, "behind_share": behind, "behind_share_exchanged": behind_exchanged}
    said = {rig_says, strips.verdict} - {"unclear"}
    remedy = "exchange left and right in [plates]"
    share = strips.swapped_share if rig_says == "unclear" else behind
    if said == {"swapped"}:
        why = " and ".join(reason for reason, verdict in ((placed, rig_says), (votes, strips.verdict)) if verdict == "swapped")
        return Finding(name="swapped", level="bad", value=share, words=f"left and right are swapped: {why}", remedy=remedy, details=details)
    if said == {"right"}:
        return Finding(name="swapped", level="good", value=share, words="left is left and right is right", details=details)
    if not said:
        words = f"whether left and right are swapped cannot be seen: {total} half-hidden strips, and the rig does not tell"
        return Finding(
            name="swapped", level="unknown", words=words, remedy="look at the plates: near things lie further right in the left one", details=details
        )
    words = f"rig and pictures disagree on which eye is left: {placed}, yet {votes}"
    return Finding(
        name="swapped",
        level="warn",
        value=share,
        words=words,
        remedy=f"check that the rig belongs to these plates; if it does, {remedy}",
        details=details,
    )


def judge_vertical(
    frames: Frames, *, p95_px: float = math.nan, grid: npt.ArrayLike | None = None, matches: int | None = None, after_rig: bool
) -> Finding:
    """How far rows disagree.

    frames    : (frame, median |dy| px), NaN where it could not be measured.
    p95_px    : 95 % of points lie within.
    grid      : (rows, columns) signed median of dy over the left plate, NaN where nothing was seen.
    after_rig : measured after rectification by the rig, or on the plates as they are.
    """
    known = [value for _, value in frames if math.isfinite(value)]
    where = "after the rig" if after_rig else "on the plates as they are"
    details: dict[str, object] = {"p95_px": p95_px, "matches": matches, "map_px": None if grid is None else np.asarray(grid).tolist()}
    if not known:
        words = f"vertical misalignment {where} could not be measured: too few points match"
        return Finding(
            name="vertical", level="unknown", words=words, remedy="choose a frame with more texture", frames=tuple(frames), details=details
        )
    size = float(np.median(known))
    level: Level = "bad" if size >= VERTICAL_BAD_PX else "warn" if size >= VERTICAL_WARN_PX else "good"
    words = f"rows disagree by {size:.2f} px {where} (median" + (f"; 95 % of points within {p95_px:.2f} px)" if math.isfinite(p95_px) else ")")
    if not after_rig and level == "bad":
        level = "warn"  # a converged or tilted rig has this by nature; its calibration takes it out
    remedy = "" if level == "good" else MEND if after_rig else "give the rig's calibration; what is left after it is what counts"
    return Finding(name="vertical", level=level, value=size, unit="px", words=words, remedy=remedy, frames=tuple(frames), details=details)


def _sized(
    name: str, value: float, sigma: float, unit: str, tolerance: float, words: tuple[str, str], remedy: str, frames: Frames, after_rig: bool
) -> Finding:
    size = abs(value)
    over = size > tolerance and size > SURE_SIGMAS * sigma
    level: Level = "good" if not over else "bad" if size > GRAVE * tolerance and after_rig else "warn"  # without a rig it may be the rig's nature
    if not math.isfinite(value):
        return Finding(name=name, level="unknown", words=f"{name} could not be measured: too few points match", frames=tuple(frames))
    if not over and sigma > tolerance:
        level = "unknown"
    said = words[0] if value > 0 else words[1]
    text = (
        f"{said} by {size:.2f} ± {sigma:.2f} {unit}"
        if over
        else f"no {name} beyond {max(tolerance, SURE_SIGMAS * sigma):.2f} {unit} ({value:+.3f} {unit})"
    )
    return Finding(
        name=name, level=level, value=value, unit=unit, words=text, remedy=remedy if over else "", frames=tuple(frames), details={"sigma": sigma}
    )


def judge_roll(roll_deg: float, sigma_deg: float, *, after_rig: bool, frames: Frames = ()) -> Finding:
    """roll_deg : > 0 where the right picture is turned clockwise against the left one: `Alignment.roll_deg`, or with a rig
    `-Drift.roll_deg` (the eye itself turned the other way)."""
    words = ("the right picture is turned clockwise", "the right picture is turned anticlockwise")
    remedy = MEND if after_rig else "level the eyes on the rig, or give the rig's calibration"
    return _sized("roll", roll_deg, sigma_deg, "deg", ROLL_WARN_DEG, words, remedy, frames, after_rig)


def judge_zoom(percent: float, sigma_percent: float, *, after_rig: bool, frames: Frames = ()) -> Finding:
    """percent : > 0 where the right picture shows things larger: of `Alignment.zoom`, or with a rig of `Drift.zoom`."""
    words = ("the right picture is larger", "the right picture is smaller")
    remedy = MEND if after_rig else "match the focal lengths, or give the rig's calibration"
    return _sized("zoom", percent, sigma_percent, "%", ZOOM_WARN_PERCENT, words, remedy, frames, after_rig)


def judge_rig_stale(
    angles_deg: tuple[float, float, float],
    zoom_percent: float,
    sigmas: Mapping[str, float],
    *,
    held: Sequence[str] = (),
    before_px: float,
    held_out_before_px: float,
    held_out_after_px: float,
    frames: Frames = (),
) -> Finding:
    """Whether the right eye still stands as the rig says.

    angles_deg  : pitch, yaw, roll of the right eye against the rig.
    sigmas      : one standard deviation by "pitch_deg", "yaw_deg", "roll_deg", "zoom" (a factor, as calibration.drift has it).
    held        : names that the footage does not tell.
    before_px   : median |dy| with the rig as it is; the held-out pair is on parts of the frame that the solve did not see.
    frames      : (frame, median |dy| px).
    """
    size = {"pitch_deg": angles_deg[0], "yaw_deg": angles_deg[1], "roll_deg": angles_deg[2]}
    tolerance = {"pitch_deg": TURN_WARN_DEG, "yaw_deg": TURN_WARN_DEG, "roll_deg": ROLL_WARN_DEG}
    moved = [n for n in size if n not in held and abs(size[n]) > max(tolerance[n], SURE_SIGMAS * sigmas[n])]
    zoom_sigma = 100 * sigmas["zoom"]
    zoomed = abs(zoom_percent) > max(ZOOM_WARN_PERCENT, SURE_SIGMAS * zoom_sigma)
    explains = before_px > STALE_PX and held_out_after_px < STALE_GAIN * held_out_before_px
    details = {
        "pitch_deg": angles_deg[0],
        "yaw_deg": angles_deg[1],
        "roll_deg": angles_deg[2],
        "zoom_percent": zoom_percent,
        "sigmas": dict(sigmas),
        "held": list(held),
        "held_out_before_px": held_out_before_px,
        "held_out_after_px": held_out_after_px,
    }
    blind = "; yaw cannot be told from this footage" if "yaw_deg" in held else ""
    if explains and (moved or zoomed):
        parts = [f"{n.removesuffix('_deg')} {size[n]:+.2f} ± {max(sigmas[n], 0.005):.2f} deg" for n in moved]
        parts += [f"zoom {zoom_percent:+.2f} ± {max(zoom_sigma, 0.005):.2f} %"] if zoomed else []
        words = (
            f"the rig is stale: the right eye is off by {', '.join(parts)}; "
            f"rows disagree by {before_px:.2f} px, and by {held_out_after_px:.2f} px once that is mended{blind}"
        )
        level: Level = "bad" if before_px >= VERTICAL_BAD_PX else "warn"
        return Finding(name="rig_stale", level=level, value=before_px, unit="px", words=words, remedy=MEND, frames=tuple(frames), details=details)
    words = f"the rig fits the plates: rows agree to {before_px:.2f} px{blind}"
    if before_px >= VERTICAL_WARN_PX:
        words = f"rows disagree by {before_px:.2f} px, and no turn or zoom of the right eye explains it{blind}"
        remedy = "check the lens calibration, the plates' size and crop, and that both eyes show one moment"
        return Finding(
            name="rig_stale", level="unknown", value=before_px, unit="px", words=words, remedy=remedy, frames=tuple(frames), details=details
        )
    return Finding(name="rig_stale", level="good", value=before_px, unit="px", words=words, frames=tuple(frames), details=details)
