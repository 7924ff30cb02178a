"""How sure the shared unknowns of a solve are, with what whole views err by counted in.

In: a `Fit` of good corners.  Out: their covariance, and the same fit with its weights in true sigmas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.calibration.bundle import Fit, Problem, State, fit, shared_slices, view_information

LEAST_SIGMA = 1e-12  # pixels: corners without any noise


def settled(problem: Problem, state: State) -> tuple[Fit, float, float]:
    """The plain solution with weights in true sigmas, one sigma of a median corner in pixels, and the views' excess scatter.

    The corners' sigma comes from the residuals and the degrees of freedom.  Errors that a whole view shares (a board that
    bends, a lens that no model fits) do not show there; they show in how far each view pulls the rig its own way, so the
    excess of those pulls over what the corners' noise explains widens the answer."""
    for _ in range(2):  # where there is prior knowledge its weight depends on the corners' sigma, and the other way round
        found = fit(problem, state)
        spent = float(np.trace(covariance_of(found) @ found.data_information))
        freedom = 2 * int(problem.seen.sum()) - spent - 6 * int(problem.seen.any(axis=(0, 2)).sum())
        weighted = np.where(problem.seen[..., None], found.residual_px * problem.weight[..., None], 0.0)
        sigma = max(float(np.sqrt((weighted**2).sum() / max(freedom, 1.0))), LEAST_SIGMA)
        problem, state = replace(problem, weight=problem.weight / sigma), found.state
    excess = view_excess(fit(problem, state))
    sigma_px = float(1 / np.median(problem.weight[problem.seen]))
    return fit(replace(problem, weight=problem.weight / excess), state), sigma_px, excess


def view_excess(found: Fit) -> float:
    """How much more the views' pulls at the rig scatter than their corners' noise says, as a factor on sigma; at least 1.

    Leaving view v out moves the unknowns by d_v = S^-1 g_v, to first order, where S = sum of the views' information S_v and g_v
    are the slopes at the solution.  E[sum d_v d_v'] = sum(S^-1 S_v S^-1 - S^-1 S_v S^-1 S_v S^-1) for noise of sigma 1 alone."""
    C = covariance_of(found)
    rig = np.flatnonzero(found.problem.free[: shared_slices(found.problem.lenses)["rig"].stop])
    moves = found.slope @ C[:, rig]
    back = view_information(found) @ C[:, rig]  # (V, shared, rig)
    expected = C[rig] @ back.sum(axis=0) - np.einsum("vsr,st,vtq->rq", back, C, back, optimize=True)
    measure = scaled_inverse(C[np.ix_(rig, rig)])
    plain = float(np.trace(measure @ expected))
    return max(1.0, float(np.sqrt(np.einsum("vi,ij,vj->", moves, measure, moves) / plain))) if plain > 0 else 1.0


def scaled_inverse(A: Float64) -> Float64:
    """Inverse of a symmetric positive matrix, its unknowns scaled to one size first."""
    d = 1 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A * d * d[:, None]
    try:
        inverse = np.linalg.inv(scaled)
        if (np.diag(inverse) <= 0).any():
            raise np.linalg.LinAlgError
    except np.linalg.LinAlgError:  # some unknowns are tied: their own sum is huge, and is said to be
        inverse = np.linalg.pinv(scaled + 1e-14 * np.eye(len(A)), rcond=1e-16, hermitian=True)
    out: Float64 = inverse * d * d[:, None]
    return out


def covariance_of(found: Fit) -> Float64:
    """(shared, shared) covariance of the shared unknowns; 0 for what was held fixed."""
    free = found.problem.free
    out = np.zeros((len(free), len(free)))
    out[np.ix_(free, free)] = scaled_inverse(found.information[np.ix_(free, free)])
    return out
