"""From a dense disparity to one worth lighting: sub-pixel photometry, occluded ground, and local planes.

In: a `Proxy` and its `Match`.  Out: a `Refined` disparity with slopes.  Three steps, each against one fault:
variational refinement (Brox et al. 2004, OpenCV's) takes out the whole-pixel steps of the matcher; ground that the other
eye cannot see takes the disparity of the background beside it, never a blend of actor and wall; a robust local plane fit
takes out the noise that would turn normals, and leaves a slope per pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32
from stereorelight.engine.occlusion import background_fill, hidden
from stereorelight.engine.refine import robust_planes
from stereorelight.stereo.proxy import Proxy


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """disparity and its slopes along x and y, each (H, W) float32; hidden: ground the right eye cannot see."""

    disparity: Float32
    slope_x: Float32
    slope_y: Float32
    hidden: Bool


def sub_pixel(proxy: Proxy, disparity: Float32, *, smoothness: float = 10.0, gradient: float = 10.0, iterations: int = 3) -> Float32:
    """Variational refinement of `disparity` on the grey proxies; `smoothness` against brightness and `gradient` constancy."""
    left, right = (cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) for p in (proxy.left, proxy.right))
    refinement = cv2.VariationalRefinement_create()
    refinement.setAlpha(smoothness)
    refinement.setGamma(gradient)
    refinement.setFixedPointIterations(iterations)
    u, _ = refinement.calcUV(left, right, -disparity, np.zeros_like(disparity))
    return -u


def refine(proxy: Proxy, dense: Float32, trusted: Float32, *, radius: int = 6, stride: int = 3, tau_px: float = 0.5) -> Refined:
    """The refined disparity of the left eye.

    dense   : (H, W) disparity with a value everywhere.   trusted : (H, W) 0..1, how far to believe each pixel.
    radius, stride, tau_px : of the plane fit, see `engine.refine.robust_planes`.
    """
    fine = sub_pixel(proxy, dense)
    unseen = hidden(fine) & (trusted <= 0)
    filled = background_fill(fine, unseen)
    weight = np.maximum(trusted, np.float32(0.3))
    weight[unseen] = 0.02
    value, slope_x, slope_y = robust_planes(filled, weight, radius=radius, stride=stride, tau_px=tau_px)
    return Refined(disparity=value, slope_x=slope_x, slope_y=slope_y, hidden=unseen)
