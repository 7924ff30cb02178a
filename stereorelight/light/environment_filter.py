"""A map as rough mirrors and white cards see it: convolutions round the sphere.

In: a lat-long map (H, 2H, 3).  Out: smaller lat-long maps, float32.
The kernel depends on the angle alone, so along a pair of rows it is a circular convolution in azimuth, done by Fourier transform:
exact but for the grid.  Light is first handed to a coarser grid by tents, which keep its amount and its place; weights are divided by
their own sum, so an even map stays even.  Source of the lobe: Walter et al. 2007 (GGX), seen head on (N = V = R)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from stereorelight.arrays import Float32, Float64
from stereorelight.light.environment_maps import directions, latlong_place, sampled, solid_angles

Kernel = Callable[[Float64], Float64]  # weight by the cosine of the angle
ROUGHNESS = (0.0, 1 / 16, 1 / 8, 3 / 16, 1 / 4, 3 / 8, 1 / 2, 3 / 4, 1.0)  # of the levels; the lobe's alpha is its square
HEIGHTS = (0, 512, 256, 256, 128, 128, 128, 128, 128)  # of the levels; 0 is the map's own
IRRADIANCE_HEIGHT = 128
PEAK = 0.15  # radians to which a sharp lobe counts as its peak, fading until twice that
TAIL_HEIGHT = 128  # rows of the grid for what is further off


def _shares(n: int, m: int) -> tuple[np.ndarray, Float64]:
    """For n fine cells over m coarse ones: the lower coarse centre below each fine centre, and the share of the next one."""
    at = (np.arange(n) + 0.5) / n * m - 0.5
    low = np.floor(at)
    return low.astype(np.int64), at - low


def gathered(latlong: Float32, height: int) -> tuple[Float64, Float64]:
    """Light times solid angle (h, 2h, 3), and solid angle (h,), on a grid of at most `height` rows."""
    H, W = latlong.shape[:2]
    weights = solid_angles(H)
    if height >= H:
        return latlong * weights[:, None, None], weights
    low, share = _shares(H, height)
    up, down = np.clip(low, 0, height - 1), np.clip(low + 1, 0, height - 1)
    rows = np.zeros((height, W, 3))
    solid = np.zeros(height)
    for y in range(H):  # row by row: a float64 copy of the whole map would be large
        line = latlong[y] * weights[y]
        rows[up[y]] += line * (1 - share[y])
        rows[down[y]] += line * share[y]
        solid[up[y]] += weights[y] * (1 - share[y])
        solid[down[y]] += weights[y] * share[y]
    low, share = _shares(W, 2 * height)
    out = np.zeros((height, 2 * height, 3))
    for shift, part in ((low, 1 - share), (low + 1, share)):
        for x, column in enumerate(shift % (2 * height)):
            out[:, column] += rows[:, x] * part[x]
    return out, solid * W / (2 * height)


def _sums(energy: Float64, solid: Float64, kernel: Kernel, height: int, reach: float = math.pi) -> tuple[Float64, Float64]:
    """At each of (h, 2h) directions the sum of the light by kernel(cos angle), (h, 2h, 3), and for each row that of the kernel alone.

    reach : angle, radians, beyond which the kernel is 0.
    """
    rows = energy.shape[0]
    step = rows // height
    spectrum = np.fft.rfft(energy, axis=1)
    polar_in = (np.arange(rows) + 0.5) / rows * math.pi
    polar_out = (np.arange(height) + 0.5) / height * math.pi
    # Output columns lie `(step - 1) / 2` fine columns off the input's: the kernel is sampled at that shift.
    turn = np.cos((np.arange(2 * rows) + (step - 1) / 2) / rows * math.pi)
    out, totals = np.empty((height, 2 * height, 3)), np.empty(height)
    for y in range((height + 1) // 2):
        near = slice(*np.searchsorted(polar_in, (polar_out[y] - reach, polar_out[y] + reach)))
        mirrored = slice(rows - near.stop, rows - near.start)
        sines, cosines = np.sin(polar_in[near, None]) * math.sin(polar_out[y]), np.cos(polar_in[near, None]) * math.cos(polar_out[y])
        weights = kernel(sines * turn + cosines)
        bent = np.fft.rfft(weights, axis=1)
        # Rows above the equator and their mirror images share the kernel, turned upside down.
        for row, one, band in ((y, bent, near), (height - 1 - y, bent[::-1], mirrored)):
            summed = np.einsum("hf,hfc->fc", one, spectrum[band])
            out[row] = np.fft.irfft(summed, n=2 * rows, axis=0)[::step]
            totals[row] = (weights.sum(axis=1) * solid[near]).sum()
    return out, totals


def convolved(latlong: Float32, kernel: Kernel, *, height: int, fine: int) -> Float32:
    """(h, 2h, 3): at each direction the mean of the light by kernel(cos angle), h = `height`; the light gathered on `fine` rows.

    fine : a multiple of `height`.
    """
    energy, solid = gathered(latlong, fine)
    sums, totals = _sums(energy, solid, kernel, min(height, energy.shape[0]))
    return np.ascontiguousarray(np.maximum(sums / totals[:, None, None], 0), dtype=np.float32)


def _convolved_narrow(latlong: Float32, kernel: Kernel, *, height: int, fine: int) -> Float32:
    """`convolved` for a sharp peak with long tails: the peak on the fine grid, the tails, which are smooth, on a coarse one."""

    def peak(cosine: Float64) -> Float64:
        t = np.clip(2 - np.arccos(np.clip(cosine, -1, 1)) / PEAK, 0, 1)
        return t * t * (3 - 2 * t)

    sums, totals = _sums(*gathered(latlong, fine), lambda c: kernel(c) * peak(c), height, 2 * PEAK)
    far, far_totals = _sums(*gathered(latlong, TAIL_HEIGHT), lambda c: kernel(c) * (1 - peak(c)), TAIL_HEIGHT)
    place = latlong_place(directions(height), TAIL_HEIGHT)
    sums += sampled(far, place, wraps=True)
    totals += np.interp(place[:, 0, 1], np.arange(TAIL_HEIGHT), far_totals)
    return np.ascontiguousarray(np.maximum(sums / totals[:, None, None], 0), dtype=np.float32)


def lambert(cosine: Float64) -> Float64:
    return np.maximum(cosine, 0)


def ggx(roughness: float) -> Kernel:
    """D(h) (N.L) of GGX with alpha = roughness^2, where N = V: h lies half way to L."""
    a2 = roughness**4

    def kernel(cosine: Float64) -> Float64:
        c2 = (1 + cosine) / 2  # of the half angle
        return np.maximum(cosine, 0) / (1 - c2 + a2 * c2) ** 2

    return kernel


def irradiance(latlong: Float32) -> Float32:
    """(h, 2h, 3): what a white Lambert card reads that faces each direction; irradiance / pi."""
    height = min(IRRADIANCE_HEIGHT, latlong.shape[0])
    return convolved(_at_least(latlong, 32), lambert, height=max(height, 32), fine=max(height, 32))


def _at_least(latlong: Float32, height: int) -> Float32:
    """Small maps are repeated, so that the kernel is not coarser than the answer."""
    times = -(-height // latlong.shape[0])
    return latlong if times <= 1 else np.repeat(np.repeat(latlong, times, axis=0), times, axis=1)


def level(latlong: Float32, index: int) -> Float32:
    """Level `index` of the chain: the map as a mirror of roughness ROUGHNESS[index] shows it, at its own size for 0."""
    if index == 0:
        return latlong
    roughness, height = ROUGHNESS[index], HEIGHTS[index]
    light = _at_least(latlong, 32)
    if light.shape[0] < height:
        height = 1 << (light.shape[0].bit_length() - 1)
    fine = height
    # The grid must be finer than the lobe, or its sums would depend on where the texels lie.
    while fine < 512 and math.pi / fine > 0.8 * roughness**2:
        fine *= 2
    times = -(-fine // light.shape[0])
    light = light if times <= 1 else np.repeat(np.repeat(light, times, axis=0), times, axis=1)
    convolve = _convolved_narrow if fine > TAIL_HEIGHT and roughness < 0.15 else convolved
    return convolve(light, ggx(roughness), height=height, fine=fine)
