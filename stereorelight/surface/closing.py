"""The hidden side of a subject, closed by its matte.

In: Z (H, W) and the subject's matte on the same plate.  Out: how far the subject goes on behind what is seen of it, (H, W) metres.
The outline of a matte is where the surface turns away from the eye: a membrane is spanned over the outline's depths, and the back
is the front mirrored in it.  A ball becomes a lens a little thinner than the ball, a head a head.  Where the frame cuts
the subject off there is no outline, and the membrane runs on level."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError
from stereorelight.surface.position import checked_depth

INSIDE = 0.5  # of the matte
LEAST = 0.1  # of a subject's half width: what is flat in front is not paper behind
LIMB = 1.37  # a limb falls off as the root of the distance from the outline: from half a pixel inside, so many times its last step
ROUNDS = 24  # of relaxation on every level


def thickness_of_matte(Z: npt.ArrayLike, matte: npt.ArrayLike, camera: Camera) -> Float32:
    """(H, W) float32 metres along the optical axis: 0 outside the matte and where Z is unknown.

    matte  : (H, W) 0..1; inside where above a half.
    Raises : PassError where the matte holds no pixel of known depth, or does not fit.
    """
    depth = checked_depth(Z, camera)
    inside = np.nan_to_num(as_float32(matte, "matte of the subject", size_hw=camera.size_hw)) > INSIDE
    known = inside & np.isfinite(depth)
    if not known.any():
        raise PassError("the subject's matte holds no pixel of known depth; check that it is white on the subject, and on this plate")
    rim = known & _beside(~inside)
    if not rim.any():
        return np.zeros(depth.shape, np.float32)
    width = _half_width(inside) * depth / camera.fx
    fixed = np.where(rim, depth + np.minimum(LIMB * _rise(np.where(known, depth, np.nan)), width[known].max()), np.nan).astype(np.float64)
    spanned = _membrane(fixed, known)
    behind = np.maximum(2 * (spanned - depth), 2 * LEAST * width)
    return np.where(known, np.nan_to_num(behind), 0).astype(np.float32)


def _beside(mask: Bool) -> Bool:
    """Pixels with one of the mask's on one of their four sides; the frame's border is none."""
    found = np.zeros_like(mask)
    found[:, 1:] |= mask[:, :-1]
    found[:, :-1] |= mask[:, 1:]
    found[1:] |= mask[:-1]
    found[:-1] |= mask[1:]
    return found


def _rise(depth: Float32) -> Float32:
    """(H, W) how much nearer the nearest of a pixel's four neighbours is, at least 0."""
    room = np.pad(depth, 1, constant_values=np.nan)
    beside = np.stack([room[1:-1, :-2], room[1:-1, 2:], room[:-2, 1:-1], room[2:, 1:-1]])
    rise: Float32 = np.maximum(np.nan_to_num(depth - np.fmin.reduce(beside, axis=0)), 0)
    return rise


def _half_width(inside: Bool) -> Float64:
    """About the distance to the outline, pixels: how many rounds of taking the outline off a pixel outlives, by halving sizes."""
    depth = np.zeros(inside.shape)
    left, step = inside, 1
    while left.any() and step < max(inside.shape):
        for _ in range(4):
            depth += step * left
            shifted = left
            for axis in (0, 1):
                rolled = [np.roll(shifted, k, axis=axis) for k in (-step, step)]
                for k, r in zip((-step, step), rolled):
                    edge = slice(-step, None) if k < 0 else slice(0, step)
                    # What lies outside the frame is taken for the subject's own.
                    r[(slice(None), edge) if axis else edge] = True
                shifted = shifted & rolled[0] & rolled[1]
            left = shifted
        step *= 2
    return depth


def _membrane(fixed: Float64, within: Bool) -> Float64:
    """The harmonic surface over `within` that meets `fixed` where that is known: coarse levels first, then each one relaxed."""
    known = np.isfinite(fixed)
    if min(fixed.shape) > 8:
        h, w = (n + n % 2 for n in fixed.shape)
        padded = np.full((h, w), np.nan)
        padded[: fixed.shape[0], : fixed.shape[1]] = fixed
        room = np.zeros((h, w), bool)
        room[: fixed.shape[0], : fixed.shape[1]] = within
        blocks = padded.reshape(h // 2, 2, w // 2, 2)
        count = np.isfinite(blocks).sum(axis=(1, 3))
        coarse = np.divide(np.nansum(blocks, axis=(1, 3)), count, out=np.full(count.shape, np.nan), where=count > 0)
        some: Bool = np.asarray(room.reshape(h // 2, 2, w // 2, 2).any(axis=(1, 3)))
        small = _membrane(coarse, some)
        found = np.repeat(np.repeat(small, 2, axis=0), 2, axis=1)[: fixed.shape[0], : fixed.shape[1]]
    else:
        found = np.full(fixed.shape, fixed[known].mean() if known.any() else np.nan)
    found = np.where(known, fixed, found)
    for _ in range(ROUNDS):
        total, count = np.zeros_like(found), np.zeros_like(found)
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            there = np.roll(within, shift, axis=axis)
            edge = slice(0, 1) if shift > 0 else slice(-1, None)
            there[(slice(None), edge) if axis else edge] = False
            there &= np.isfinite(np.roll(found, shift, axis=axis))
            total += np.where(there, np.roll(found, shift, axis=axis), 0)
            count += there
        found = np.where(known | (count == 0), found, total / np.maximum(count, 1))
    return found
