"""Least squares that a few wrong points cannot move, with priors, and sigmas that know about neighbours.

In: a function from parameters (k,) to residuals (n,), a sigma for each residual, and a prior for each parameter.
Out: a `Fit`.  The first pass is soft-L1 (scipy); what then lies beyond `OUTLIER_SIGMAS` is left out of the second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from stereorelight.arrays import Bool, Float64

OUTLIER_SIGMAS = 4.0
ROUNDS = 3  # of leaving out and fitting again
LEAST_SCALE_PX = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """values, sigmas: (k,); inlier: (n,); scale: robust standard deviation of the residuals, in their own unit."""

    values: Float64
    sigmas: Float64
    inlier: Bool
    scale: float


def spread(residuals: Float64) -> float:
    """Standard deviation as the median sees it."""
    return max(float(1.4826 * np.median(np.abs(residuals - np.median(residuals)))), LEAST_SCALE_PX)


def _slopes(residuals: Callable[[Float64], Float64], at: Float64, steps: Float64) -> Float64:
    return np.stack([(residuals(at + h) - residuals(at - h)) / (2 * h.sum()) for h in np.diag(steps)], axis=1)


def fitted(
    residuals: Callable[[Float64], Float64],
    *,
    sigma: Float64,
    prior: Float64,
    prior_sigma: Float64,
    cluster: npt.NDArray[np.intp],
    keep: Bool | None = None,
) -> Fit:
    """The parameters that explain the residuals best, held to `prior` within `prior_sigma`.

    sigma   : (n,) what each residual's own measurement is worth; what all of them share is found from their spread.
    cluster : (n,) residuals of one cluster err together (one part of the frame, one object), so they count as one witness when
              the sigmas are worked out (the "sandwich" of Liang and Zeger 1986).  Independent noise alone would promise too much.
    keep    : (n,) which residuals may speak at all.
    """
    inlier = np.ones(len(sigma), dtype=bool) if keep is None else keep.copy()
    allowed = inlier.copy()
    x, steps = prior.copy(), prior_sigma * 1e-3
    noise = sigma.copy()
    scale = LEAST_SCALE_PX
    for turn in range(ROUNDS):

        def whole(values: Float64, chosen: Bool = inlier, noise: Float64 = noise) -> Float64:
            return np.concatenate([residuals(values)[chosen] / noise[chosen], (values - prior) / prior_sigma])

        if turn == 0:
            noise = np.hypot(sigma, spread(residuals(x)[inlier]))
        x = least_squares(lambda v, n=noise, c=inlier: whole(v, c, n), x, loss="soft_l1" if turn == 0 else "linear", x_scale=prior_sigma).x
        left = residuals(x)
        scale = spread(left[inlier])
        noise = np.hypot(sigma, scale)
        inlier = allowed & (np.abs(left) < OUTLIER_SIGMAS * noise)
    left = residuals(x)
    J = (_slopes(residuals, x, steps) / noise[:, None])[inlier]
    r = (left / noise)[inlier]
    _, of = np.unique(cluster[inlier], return_inverse=True)
    scores = np.zeros((of.max() + 1 if len(of) else 0, len(x)))
    np.add.at(scores, of, J * r[:, None])
    precision = np.diag(1 / prior_sigma**2)
    inverse = np.linalg.inv(J.T @ J + precision)
    grouped = inverse @ (scores.T @ scores * len(scores) / max(len(scores) - len(x), 1) + precision) @ inverse
    sigmas = np.sqrt(np.maximum(np.diag(grouped), np.diag(inverse)))
    return Fit(values=x, sigmas=sigmas, inlier=inlier, scale=scale)
