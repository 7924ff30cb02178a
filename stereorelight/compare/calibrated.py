"""Whether a result is as sure as it says: confidence against how often it was right, and errors against the standard deviation stated.

In: confidence, errors and sigmas of pixels.  Out: counts that add up over frames, figures and the curve that should be a diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.compare.figures import Curve, Figure

BINS = 20
LEAST = 50  # pixels that a bin of the curve needs
SIGMAS = (1.0, 2.0, 3.0)
EXPECTED = {1.0: 68.3, 2.0: 95.4, 3.0: 99.7}


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Pixels by confidence: how many, the sum of their confidence, how many were right; and by sigma: how many, and within 1, 2, 3."""

    pixels: Float64
    said: Float64
    right: Float64
    with_sigma: int
    within: Float64

    def __add__(self, other: Calibration) -> Calibration:
        return Calibration(
            pixels=self.pixels + other.pixels,
            said=self.said + other.said,
            right=self.right + other.right,
            with_sigma=self.with_sigma + other.with_sigma,
            within=self.within + other.within,
        )

    def figures(self) -> list[Figure]:
        """confidence_off: the mean of |share right - confidence|, weighed by pixels; within1sigma ... of those that state one."""
        out = []
        n = self.pixels.sum()
        if n:
            off = float(np.abs(self.right - self.said).sum() / n)
            out.append(Figure(name="confidence_off", value=100 * off, unit="%", table="calibration", digits=2, column="confidence off by"))
        for k, share in zip(SIGMAS, self.within):
            if self.with_sigma:
                column = f"within {k:g} sigma ({EXPECTED[k]:g} wanted)"
                value = 100 * float(share) / self.with_sigma
                out.append(Figure(name=f"within{k:g}sigma", value=value, unit="%", table="calibration", digits=1, column=column, high_is_good=True))
        return out

    def curves(self) -> list[Curve]:
        """Share right over confidence, beside the diagonal; none where there is no confidence."""
        filled = self.pixels >= LEAST
        if not filled.any():
            return []
        said, right = (a[filled] / self.pixels[filled] for a in (self.said, self.right))
        line = ([float(v) for v in said], [float(v) for v in right])
        title = "Confidence against the share of its pixels that are within 1 px of the truth; dashed: what it should be"
        return [Curve(title=title, lines={"share": line}, x_label="confidence", y_label="share", diagonal=True, y_range=(0.0, 1.0))]


def calibration(
    error: npt.NDArray[np.floating],
    known: npt.NDArray[np.bool_],
    *,
    confidence: npt.NDArray[np.floating] | None = None,
    right_within: float = 1.0,
    sigma: npt.NDArray[np.floating] | None = None,
    sigma_error: npt.NDArray[np.floating] | None = None,
) -> Calibration:
    """The calibration of one frame.

    error       : (H, W) absolute, NaN where there is no answer, in the unit of `right_within`; what confidence speaks of.
    known       : (H, W) where the truth is.   confidence : (H, W) 0..1.
    sigma       : (H, W) the standard deviation that the result states of `sigma_error` (H, W), signed or not.
    """
    pixels: Float64 = np.zeros(BINS)
    said, right = pixels, pixels
    if confidence is not None:
        use = known & np.isfinite(confidence) & np.isfinite(error)
        c = confidence[use].astype(np.float64)
        at = np.minimum((c * BINS).astype(np.intp), BINS - 1)
        pixels = np.bincount(at, minlength=BINS).astype(np.float64)
        said = np.bincount(at, c, minlength=BINS).astype(np.float64)
        right = np.bincount(at, error[use] <= right_within, minlength=BINS).astype(np.float64)
    count, within = 0, np.zeros(len(SIGMAS))
    if sigma is not None and sigma_error is not None:
        use = known & np.isfinite(sigma) & (sigma > 0) & np.isfinite(sigma_error)
        ratio = np.abs(sigma_error[use]) / sigma[use]
        count, within = int(ratio.size), np.array([float((ratio <= k).sum()) for k in SIGMAS])
    return Calibration(pixels=pixels, said=said, right=right, with_sigma=count, within=within)
