"""What a pair of plates will give, before anything is matched: depth step and normal noise at a distance.

In: the rectified rig, and grain and texture as plain numbers.  Out: millimetres and degrees.

Match.  Two windows of n = w^2 pixels with gradient g (rms along the row, light a pixel) and grain s (sigma, the same units, in
each eye) fix their shift to sigma_d = s sqrt(2 / n_eff) / g, with n_eff = w^2 (least squares; Lucas and Kanade 1981).  Neighbouring
windows share pixels: the disparity's noise is correlated over about w px.
Normal.  In a window of w x w pixels with white noise sigma_1 a pixel the slope of the best plane has the sigma
    sigma_a = sigma_1 sqrt(12) / w^2        (sum of (u - mean)^2 over the window is w^2 (w^2 - 1) / 12)
along each axis.  sigma_1 = s sqrt(2) / g is the noise of one pixel's own match: a plane fitted straight to the light of w x w
pixels (photometric planes) reaches this limit, whatever window came before it.  A plane square to the axis at q = d + doffs has the
normal ~ (fx a, fy b, q), so each slope tilts it by fx sigma_a / q, and
    sigma_N = fx sigma_a / q = Z sigma_a / b          (radians, each axis; q = fx b / Z)
so the angle to the true normal is Rayleigh distributed with median 1.1774 sigma_N.  What is not known of real matching (colour,
speckle, blur, a bias that grain does not explain) is a floor of `FLOOR_PX` in the disparity of a window."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stereorelight.camera import RectifiedRig
from stereorelight.errors import PassError
from stereorelight.health.finding import Finding, Level

RAYLEIGH_MEDIAN = math.sqrt(2 * math.log(2))
WINDOW_PX = 17  # the matcher's last photometric window at quality "standard" (radius 8)
FLOOR_PX = 0.03  # of a window: what is left on noiseless rendered plates
FACES_DEG, BROAD_DEG = 8.0, 20.0  # median error at which a lit face looks right; at which a light still comes from its side
WANTED_DEG = 5.0


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """What to expect at `distance_m`.

    disparity_px, sigma_px : the disparity there and its expected sigma.
    step_mm   : depth of one whole pixel of disparity;  sigma_mm : of the expected sigma.
    normal_deg: median angle between found and true normal, on a smooth surface that faces the camera.
    baseline_for_m, distance_for_m : what would give `wanted_deg`: this distance with another baseline (metres), or this rig
                nearer; NaN where no grain or texture would do.
    """

    distance_m: float
    disparity_px: float
    sigma_px: float
    step_mm: float
    sigma_mm: float
    normal_deg: float
    wanted_deg: float
    baseline_for_m: float
    distance_for_m: float


def slope_sigma(sigma_px: float, window_px: int) -> float:
    """Sigma of each slope of a plane fitted to w x w samples of white noise `sigma_px`: pixels a pixel."""
    n = window_px * window_px
    return sigma_px * math.sqrt(12 / (n * (n - 1)))


def single_match_sigma(grain: float, texture: float) -> float:
    """Sigma of one pixel's own match, px: grain sqrt(2) / texture.

    grain   : sigma of a pixel's noise in each eye.    texture : rms slope of the picture along the row, same units a pixel.
    """
    return math.inf if texture <= 0 else grain * math.sqrt(2) / texture


def _checked(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise PassError(f"{name} must be a number > 0, got {value!r}")


def predict(
    rig: RectifiedRig, distance_m: float, *, grain: float, texture: float, window_px: int = WINDOW_PX, wanted_deg: float = WANTED_DEG
) -> Prediction:
    """Depth step and normal noise at `distance_m` (metres along the axis).

    grain, texture : see `single_match_sigma`; grain 0 is a rendered plate.     window_px : side of the planes' window, rectified pixels.
    Raises         : PassError for a distance, texture or window that cannot be.
    """
    _checked(distance_m=distance_m, wanted_deg=wanted_deg)
    if not (grain >= 0 and texture >= 0 and window_px >= 3):
        raise PassError(f"grain and texture must be >= 0 and window_px >= 3, got {grain!r}, {texture!r} and {window_px!r}")
    fx, b = rig.left.fx, rig.baseline_m
    q = fx * b / distance_m
    window_sigma = math.hypot(single_match_sigma(grain, texture) / window_px, FLOOR_PX)
    a = slope_sigma(window_sigma * window_px, window_px)
    tilt = fx * a / q
    limit = math.tan(math.radians(wanted_deg)) / RAYLEIGH_MEDIAN
    return Prediction(
        distance_m=distance_m,
        disparity_px=float(rig.disparity_from_depth(distance_m)),
        sigma_px=window_sigma,
        step_mm=1000 * distance_m / (q - 0.5) * 0.5 + 1000 * distance_m / (q + 0.5) * 0.5 if q > 0.5 else math.inf,
        sigma_mm=1000 * distance_m * window_sigma / q,
        normal_deg=math.degrees(math.atan(RAYLEIGH_MEDIAN * tilt)) if math.isfinite(tilt) else 90.0,
        wanted_deg=wanted_deg,
        baseline_for_m=b * tilt / limit if math.isfinite(tilt) else math.nan,
        distance_for_m=distance_m * limit / tilt if math.isfinite(tilt) else math.nan,
    )


def verdict(normal_deg: float) -> str:
    """In words: what light such normals can carry."""
    if normal_deg <= FACES_DEG:
        return "good enough to light faces"
    return "only broad light" if normal_deg <= BROAD_DEG else "do not expect shape"


def judge_prediction(
    subject: Prediction, *, near: Prediction | None = None, middle: Prediction | None = None, far: Prediction | None = None
) -> Finding:
    """One finding "prediction": its value is the expected normal noise at the subject, degrees."""
    level: Level = "good" if subject.normal_deg <= FACES_DEG else "warn" if subject.normal_deg <= BROAD_DEG else "bad"
    words = (
        f"At the subject, {subject.distance_m:.2f} m: one pixel is {subject.step_mm:.0f} mm of depth, expected error {subject.sigma_mm:.1f} mm, "
        f"normals within about {subject.normal_deg:.0f} degrees: {verdict(subject.normal_deg)}."
    )
    remedy = ""
    if level != "good" and math.isfinite(subject.baseline_for_m):
        remedy = (
            f"For {subject.wanted_deg:g} degrees: eyes {1000 * subject.baseline_for_m:.0f} mm apart at this distance, "
            f"or the subject at {subject.distance_for_m:.2f} m; or more light on set, for less grain."
        )
    elif level != "good":
        remedy = "The subject has no texture to match; light it from the side, so that pores and cloth show."
    places = {"near": near, "middle": middle, "far": far, "subject": subject}
    details = {
        name: {"distance_m": p.distance_m, "step_mm": p.step_mm, "sigma_mm": p.sigma_mm, "normal_deg": p.normal_deg}
        for name, p in places.items()
        if p
    }
    return Finding(name="prediction", level=level, value=subject.normal_deg, unit="deg", words=words, remedy=remedy, details=details)
