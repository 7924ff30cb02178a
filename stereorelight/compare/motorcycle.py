"""The real Motorcycle pair that scikit-image's wheel carries, with its rig and its truth, offline.

Out: 8-bit display-coded pictures (H, W, 3), the true disparity of the LEFT picture (x_left - x_right, NaN where unknown), and
which of its pixels the right eye sees.  Middlebury 2014 (Scharstein et al.), a quarter of its size: 741x500."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, UInt8, as_float32
from stereorelight.camera import Camera, RectifiedRig
from stereorelight.errors import PlateError

FX, CX, CY, DOFFS_PX, BASELINE_M = 994.978, 311.193, 254.877, 31.086, 0.193001
SAME_PLACE_PX = 0.5  # two points of the left picture this near in the right one compete for it
IN_FRONT_PX = 1.0  # and the nearer one hides the other; less is two neighbours on one slanted surface


@dataclass(frozen=True, kw_only=True, eq=False)
class TruePair:
    """left, right: (H, W, 3) uint8; disparity: (H, W) float32 on the left picture; nonoccluded: (H, W) bool, known and seen by both."""

    left: UInt8
    right: UInt8
    disparity: Float32
    nonoccluded: Bool
    rig: RectifiedRig


def seen_by_both(disparity: npt.ArrayLike, *, width_right: int | None = None) -> Bool:
    """(H, W) which known pixels of the left view the right eye sees, from the left disparity alone.

    Not those that land outside the right picture, nor those where another known pixel of the row lands within half a pixel with
    a disparity that is larger by more than a pixel.  A hider whose own disparity is unknown cannot be seen here.
    """
    d = as_float32(disparity, "disparity").astype(np.float64)
    width = d.shape[1] if width_right is None else width_right
    known = np.isfinite(d)
    x = np.where(known, np.arange(d.shape[1]) - np.where(known, d, 0), np.inf)
    order = np.argsort(x, axis=1, kind="stable")
    place, ranked = np.take_along_axis(x, order, 1), np.take_along_axis(np.where(known, d, -np.inf), order, 1)
    hidden = np.zeros(d.shape, dtype=bool)
    for k in range(1, d.shape[1]):
        with np.errstate(invalid="ignore"):
            rival = place[:, k:] - place[:, :-k] <= SAME_PLACE_PX
            if not rival.any():
                break
            hidden[:, :-k] |= rival & (ranked[:, k:] > ranked[:, :-k] + IN_FRONT_PX)
            hidden[:, k:] |= rival & (ranked[:, :-k] > ranked[:, k:] + IN_FRONT_PX)
    seen = np.zeros(d.shape, dtype=bool)
    np.put_along_axis(seen, order, ~hidden, axis=1)
    return seen & known & (x >= -0.5) & (x <= width - 0.5)


def motorcycle_rig() -> RectifiedRig:
    """The pair's calibration, as scikit-image documents it."""
    left, right = (Camera(size=(741, 500), K=np.array([[FX, 0, cx], [0, FX, CY], [0, 0, 1]])) for cx in (CX, CX + DOFFS_PX))
    return RectifiedRig(left=left, right=right, baseline_m=BASELINE_M)


def motorcycle() -> TruePair:
    """The pair, its truth and its rig.  Raises PlateError where this scikit-image does not carry it.

    scikit-image's documentation has the direction the wrong way round: the right picture sampled at x - d looks like the left
    one at x (tests/test_compare_motorcycle.py), so the truth is that of the left eye, positive, inf where unknown.
    """
    try:
        from skimage import data

        left, right, truth = data.stereo_motorcycle()
    except Exception as error:  # pooch, urllib and the file system each raise their own kind
        raise PlateError(
            f"the Motorcycle pair cannot be read from scikit-image ({error}); install scikit-image 0.25 or later from its wheel"
        ) from None
    disparity = np.where(np.isfinite(truth), truth, np.nan).astype(np.float32)
    return TruePair(
        left=np.ascontiguousarray(left),
        right=np.ascontiguousarray(right),
        disparity=disparity,
        nonoccluded=seen_by_both(disparity),
        rig=motorcycle_rig(),
    )
