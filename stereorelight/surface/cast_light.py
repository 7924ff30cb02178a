"""Light that can be: what any lamps, however many, near no surface and nowhere negative, make of a matte one.

In: a quadratic form over the nine coefficients of `surface/plate_light.py`.  Out: the coefficients that make it least among those that lamps
all around can make.

Nine free numbers fit a surface that is known a little wrong better than its own light does: a ball that depth has flattened is as well explained
by a light that is stronger than it was, and darker than dark where no normal of it points.  Lamps narrow that: a matte surface turns each into
cos / 2 + (5 / 32) (3 cos^2 - 1) + 1 / 4 (Ramamoorthi and Hanrahan 2001), and there are no others than sums of these."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from stereorelight.arrays import Float64

LAMPS = 200  # all around, 14 degrees apart: a lamp between two is told by both to a hundredth
LEAST = 1e-9  # of the form's trace: so that it has an inverse


@cache
def lamps() -> Float64:
    """(9, LAMPS): the coefficients of lamps of radiance one (a surface that faces it reads 1 but for its order), evenly all around."""
    k = np.arange(LAMPS) + 0.5
    z, turn = 1 - 2 * k / LAMPS, k * math.pi * (3 - math.sqrt(5))
    x, y = np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn)
    second = 15 / 32
    of = [x * 0 + 1 / 4, x / 2, y / 2, z / 2, 2 * second * x * y, 2 * second * y * z, 2 * second * x * z]
    return np.stack([*of, second * (x * x - y * y) / 2, second * (3 * z * z - 1) / 6])


@cache
def uneven() -> Float64:
    """(9, 9) the form that grows with how uneven a light is: 1 for one that is the same all around and reads 1, several times that for a lamp."""
    every = lamps()
    form: Float64 = np.linalg.inv(every @ every.T / LAMPS) / 16
    return form


def least_of(A: Float64, g: Float64) -> Float64:
    """(9,) c that makes c A c - 2 g c least among the lights that lamps can make; A (9, 9) symmetric, not negative."""
    from scipy.optimize import nnls

    root = np.linalg.cholesky(A + np.eye(9) * (LEAST * np.trace(A)))
    strengths, _ = nnls(root.T @ lamps(), np.linalg.solve(root, g), maxiter=50 * LAMPS)
    c: Float64 = lamps() @ strengths
    return c
