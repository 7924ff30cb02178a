"""Mattes that help the matcher: what is to be ignored, and where the subject ends.

In: mattes (H, W) 0..1 on the original plate of the eye whose depth is asked for.  Out: the same on its rectified view, and a disparity
whose step at the subject's outline lies on the matte's edge.
Ignored ground (a reflection, a flare, a rig in the picture) proves nothing: its own match is dropped, and it goes on as what lies beside it.
At the subject's edge a matcher is a few pixels off, and where both sides look alike no picture can tell; a matte can."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.camera import Eye
from stereorelight.errors import PlateError
from stereorelight.stereo.rectify import Rectification

HALF = 0.5  # a pixel is the subject's from here
TOUCHED = 0.02  # and ignored from here: any part of a flare spoils a match
BAND_PX = 6  # how far from the matte's edge a match may be on the wrong side of it
JUMP_PX = 1.5  # a step between the two sides that is a depth edge


@dataclass(frozen=True, kw_only=True, eq=False)
class Hints:
    """Mattes (H, W) float32, 0..1, upright on the original plate; None where there is none.

    subject : 1 on what stands before the rest.     ignore : 1 on what no depth may be read from.
    """

    subject: Float32 | None = None
    ignore: Float32 | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Hinted:
    """Hints as the matcher wants them, (H, W) bool on the view that is matched."""

    subject: Bool | None = None
    ignore: Bool | None = None


def hinted(hints: Hints | None, rectification: Rectification, eye: Eye, *, size_hw: tuple[int, int]) -> Hinted | None:
    """`hints` on the view of `eye` that is matched as the left one: mirrored for the right eye, at the size it is matched at.

    Raises : PlateError for a matte of another size than the plate, or with a value that is not finite.
    """
    if hints is None or (hints.subject is None and hints.ignore is None):
        return None

    def on_view(matte: Float32 | None, name: str, above: float) -> Bool | None:
        if matte is None:
            return None
        wanted = rectification.original.camera(eye).size_hw
        if matte.shape != wanted:
            raise PlateError(f"the {name} matte is {matte.shape[1]}x{matte.shape[0]}, the plate {wanted[1]}x{wanted[0]}; paint it on the plate")
        if not np.isfinite(matte).all():
            raise PlateError(f"the {name} matte has values that are not finite; it holds 0 to 1")
        view = np.nan_to_num(rectification.rectify(np.repeat(matte[..., None], 3, axis=2).astype(np.float32), eye)[..., 0])
        view = view if eye == "left" else np.ascontiguousarray(view[:, ::-1])
        if view.shape != size_hw:
            view = cv2.resize(view, size_hw[::-1], interpolation=cv2.INTER_AREA)
        shown: Bool = view >= above
        return shown

    return Hinted(subject=on_view(hints.subject, "subject", HALF), ignore=on_view(hints.ignore, "ignore", TOUCHED))


def _from_nearest(disparity: Float32, anchors: Bool) -> tuple[Float32, Float32]:
    """The disparity of the nearest anchor of each pixel, and how far away it is, px."""
    away, label = cv2.distanceTransformWithLabels((~anchors).view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    value = np.zeros(int(label.max()) + 1, np.float32)
    value[label[anchors]] = disparity[anchors]
    return value[label], away


def _moved(disparity: Float32, sure: Bool, subject: Bool, inside_px: int) -> tuple[Float32, Bool]:
    """One pass of `on_matte_edge`: sides are told by what lies at least `inside_px` inside them."""
    around = np.ones((2 * inside_px + 1, 2 * inside_px + 1), np.uint8)
    inner = cv2.erode(subject.view(np.uint8), around).view(np.bool_) & sure
    outer = ~cv2.dilate(subject.view(np.uint8), around).view(np.bool_) & sure
    if not inner.any() or not outer.any():
        return disparity, np.zeros(disparity.shape, np.bool_)
    (near, near_px), (far, far_px) = _from_nearest(disparity, inner), _from_nearest(disparity, outer)
    reach = 2 * inside_px + BAND_PX
    step = (near - far > JUMP_PX) & (near_px < reach) & (far_px < reach)
    own, other = np.where(subject, near, far), np.where(subject, far, near)
    moved = step & (np.abs(disparity - other) < np.abs(disparity - own))
    return np.where(moved, own, disparity), moved


def on_matte_edge(disparity: Float32, sure: Bool, subject: Bool) -> tuple[Float32, Bool]:
    """`disparity` (H, W) px with its step at the subject's outline on the matte's edge, and (H, W) bool where that changed it.

    sure : (H, W), what both eyes confirm.  Each pixel near the edge that is nearer to the other side's disparity than to its own
    side's takes that of the nearest sure pixel well inside its own side: first by what lies deep inside, since near the edge both eyes
    may agree on the wrong side, then, for thin parts, by what lies less deep.  Where the sides are no step apart, nothing moves.
    """
    changed = np.zeros(disparity.shape, np.bool_)
    for inside_px in (3 * BAND_PX, BAND_PX):
        disparity, moved = _moved(disparity, sure, subject, inside_px)
        changed |= moved
    return disparity, changed
