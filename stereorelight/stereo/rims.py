"""Plain ground between strong rims takes the plane that its rims lie on.

In: grey pictures and the disparity of one eye.  Out: the disparity, changed on plain ground only.
Matching by support gives each plain patch one answer, since nothing in it says otherwise: a slanted board of squares becomes a stair.
Its rims know better, row by row, once they are looked at alone (engine/rims.py).  A patch takes their plane only where they agree with
each other and not with the patch, and where the two pictures do not object."""

from __future__ import annotations

import cv2
import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.photometric import brightness_residual
from stereorelight.engine.rims import rim_disparity
from stereorelight.engine.rows import at_once

RIM = 8.0  # grey levels per px along the row
UPRIGHT = 0.35  # of the change down the column that a rim must have along the row: a level rim tells nothing
PLAIN, PLAIN_WINDOW = 4.0, (3, 3)  # grey levels per px either way, root mean square
BESIDE = (3, 5, 7)  # px from a rim to the patches on either side of it
MOST_PX = 4.0  # that a rim is off the patch beside it; what is farther off is the rim of something else
FEWEST, SMALLEST_PX = 20, 30  # rims of a patch that agree, and its pixels
AGREE_PX, AGREE = 0.75, 0.8  # how near rims must lie to their plane, and what share of them
BETTER, CLIP_PX = 0.5, 2.0  # mean distance of the rims from their plane, over that from the patch as it was, at most; each no more than this
STEEPEST = 0.2  # px per px
WIDEST = 3.0  # px, standard deviation of where the rims lie: fewer make no plane
STIFF = 300.0  # px^2 by which few rims near each other are kept level
TRIES, FIRST_PX, THEN_PX = 6, 1.0, 0.5  # rounds of the robust fit, and how far off counts a quarter in the first and the second half
OBJECTS = 1.1  # times what was left between the pictures: more, and they object
SPEAKS = 0.1  # grey levels squared, of each pixel, that do not count as objecting


def _planes(patch: np.ndarray, x: np.ndarray, y: np.ndarray, d: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Robust planes through the rims of each of `n` patches: middles (n, 2), planes (n, 3), residuals and weights of the rims."""
    count = np.maximum(np.bincount(patch, minlength=n), 1)
    middle = np.stack([np.bincount(patch, a, n) / count for a in (x, y)], axis=1)
    u, v = x - middle[patch, 0], y - middle[patch, 1]
    terms = (np.ones_like(u), u, v)
    weight, off, planes = np.ones_like(d), np.zeros_like(d), np.zeros((n, 3))
    for k in range(TRIES):
        A = np.stack([np.bincount(patch, weight * a * b, n) for a in terms for b in terms], axis=1).reshape(n, 3, 3)
        A += np.diag([1e-6, STIFF, STIFF])
        b = np.stack([np.bincount(patch, weight * a * d, n) for a in terms], axis=1)
        planes = np.linalg.solve(A, b[..., None])[..., 0]
        off = d - (planes[patch, 0] + planes[patch, 1] * u + planes[patch, 2] * v)
        weight = 1 / (1 + (off / (FIRST_PX if 2 * k < TRIES else THEN_PX)) ** 2) ** 2
    return middle, planes, off, weight


def on_rims(left: Float32, right: Float32, disparity: Float32) -> Float32:
    """`disparity` of the left of two grey pictures, with each plain patch on the plane of its rims; finite, (H, W) px."""
    width = disparity.shape[1]
    across, down = (cv2.Sobel(left, cv2.CV_32F, *way, scale=1 / 8) for way in ((1, 0), (0, 1)))
    rim = (np.abs(across) > RIM) & (np.abs(across) > UPRIGHT * np.abs(down))
    found = rim_disparity(left, right, rim, disparity)
    plain = (cv2.blur(across * across, PLAIN_WINDOW) < PLAIN**2) & (cv2.blur(down * down, PLAIN_WINDOW) < PLAIN**2)
    n, patches = cv2.connectedComponents(plain.view(np.uint8), connectivity=4)
    rows, columns = np.nonzero(np.isfinite(found))
    parts = []
    for step in (*(-k for k in BESIDE), *BESIDE):
        there = np.clip(columns + step, 0, width - 1)
        had, d = disparity[rows, there], found[rows, columns]
        patch = patches[rows, there]
        take = (patch > 0) & (np.abs(d - had) <= MOST_PX)
        parts.append(np.stack([patch, columns, rows, d, had]).astype(np.float64)[:, take])
    patch, x, y, d, had = np.concatenate(parts, axis=1)
    if patch.size == 0:
        return disparity
    patch = patch.astype(np.intp)
    middle, planes, off, weight = _planes(patch, x, y, d, n)

    def total(a: np.ndarray) -> np.ndarray:
        return np.bincount(patch, a, n)

    count, sure = np.maximum(total(np.ones_like(d)), 1), np.maximum(total(weight), 1e-9)
    agree = total((np.abs(off) < AGREE_PX).astype(np.float64))
    wide = [np.sqrt(total(weight * (a - middle[patch, k]) ** 2) / sure) for k, a in enumerate((x, y))]
    area = np.bincount(patches.ravel(), minlength=n)
    takes = (agree >= FEWEST) & (agree >= AGREE * count) & (area >= SMALLEST_PX) & (np.minimum(*wide) > WIDEST)
    takes &= total(np.minimum(np.abs(off), CLIP_PX)) < BETTER * total(np.minimum(np.abs(d - had), CLIP_PX))
    takes &= (np.abs(planes[:, 1:]) < STEEPEST).all(axis=1)
    takes[0] = False
    if not takes.any():
        return disparity
    rows, columns = np.nonzero(takes[patches])
    patch = patches[rows, columns]
    u, v = columns - middle[patch, 0], rows - middle[patch, 1]
    plane = (planes[patch, 0] + planes[patch, 1] * u + planes[patch, 2] * v).astype(np.float32)
    near = (np.abs(u) < 2 * wide[0][patch] + BESIDE[0]) & (np.abs(v) < 2 * wide[1][patch] + BESIDE[0])
    near &= np.abs(plane - disparity[rows, columns]) <= MOST_PX + 1
    rows, columns, patch = rows[near], columns[near], patch[near]
    out = disparity.copy()
    out[rows, columns] = plane[near]

    def left_over(a: Float32) -> np.ndarray:
        """Squares of what is left between the pictures, less its local mean, of each patch."""
        residual = brightness_residual(left, right, a)[0]
        residual -= cv2.blur(residual, (9, 9))
        return np.bincount(patch, residual[rows, columns].astype(np.float64) ** 2, n)

    was, now = at_once(lambda: left_over(disparity), lambda: left_over(out))
    objects = (now > OBJECTS * was + SPEAKS * np.bincount(patch, minlength=n))[patch]
    out[rows[objects], columns[objects]] = disparity[rows[objects], columns[objects]]
    return out
