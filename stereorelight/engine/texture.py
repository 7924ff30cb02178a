"""Procedural grain and the patterns of materials, for the ray caster, in float64.

In: a point of an object's own frame, metres, and a material as one row of numbers (columns below).  Out: its albedo, 0..1.
A pattern is a pure function of the point: both eyes see one colour at one surface point, and a moved object takes it along."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Material row: pattern, colour (3), second colour (3), contrast, frequency, octaves, gain, specular, exponent, stretch (3).
MATTE, SKIN, HAIR, CLOTH, WOOD, EYE, PAPER, TILES, MARBLE = 0, 1, 2, 3, 4, 5, 6, 7, 8
MATERIAL_COLUMNS = 16


@njit(cache=True, nogil=True)
def _lattice(x, y, z, seed):
    """Hash of a lattice point to 64 bits (the finaliser of SplitMix64)."""
    h = np.uint64(x * 73856093) ^ np.uint64(y * 19349663) ^ np.uint64(z * 83492791) ^ np.uint64(seed * 2654435761)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@njit(cache=True, nogil=True)
def _slope(h, x, y, z):
    """Dot product of (x, y, z) with one of Perlin's twelve directions."""
    k = int(h & np.uint64(15))
    u = x if k < 8 else y
    v = y if k < 4 else (x if k == 12 or k == 14 else z)
    return (-u if k & 1 else u) + (-v if k & 2 else v)


@njit(cache=True, nogil=True)
def noise(x, y, z, seed):
    """Gradient noise (Perlin 2002), about -1..1, twice differentiable."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    i, j, k = int(fx), int(fy), int(fz)
    x, y, z = x - fx, y - fy, z - fz
    u = x * x * x * (x * (x * 6 - 15) + 10)
    v = y * y * y * (y * (y * 6 - 15) + 10)
    w = z * z * z * (z * (z * 6 - 15) + 10)
    a = _slope(_lattice(i, j, k, seed), x, y, z)
    b = _slope(_lattice(i + 1, j, k, seed), x - 1, y, z)
    c = _slope(_lattice(i, j + 1, k, seed), x, y - 1, z)
    d = _slope(_lattice(i + 1, j + 1, k, seed), x - 1, y - 1, z)
    low = a + u * (b - a) + v * ((c + u * (d - c)) - (a + u * (b - a)))
    a = _slope(_lattice(i, j, k + 1, seed), x, y, z - 1)
    b = _slope(_lattice(i + 1, j, k + 1, seed), x - 1, y, z - 1)
    c = _slope(_lattice(i, j + 1, k + 1, seed), x, y - 1, z - 1)
    d = _slope(_lattice(i + 1, j + 1, k + 1, seed), x - 1, y - 1, z - 1)
    high = a + u * (b - a) + v * ((c + u * (d - c)) - (a + u * (b - a)))
    return low + w * (high - low)


@njit(cache=True, nogil=True)
def octaves(x, y, z, count, gain, seed):
    """Sum of `count` octaves of noise; each next one twice as fine and `gain` times as strong."""
    total, strength = 0.0, 1.0
    for n in range(count):
        total += strength * noise(x, y, z, seed + n)
        x, y, z, strength = 2.03 * x + 17.1, 2.03 * y + 5.3, 2.03 * z + 11.7, strength * gain
    return total


@njit(cache=True, nogil=True)
def _step(a, b, x):
    s = min(max((x - a) / (b - a), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@njit(cache=True, nogil=True)
def albedo_at(m, x, y, z, out):
    """Colour of material row `m` at a point of the object's frame."""
    pattern = int(m[0])
    f = m[8]
    grain = octaves(x * f * m[13], y * f * m[14], z * f * m[15], int(m[9]), m[10], 1)
    mix = 0.0
    gain = 1.0 + m[7] * grain
    if pattern == SKIN:  # second colour: lips and a flush on cheeks, nose and ears; brows darken
        side = abs(x)
        lips_y = -0.0685 + 0.0035 * math.cos(side * 150.0) * _step(0.016, 0.0, side)
        lips = _step(1.12, 0.88, math.sqrt((x / 0.0255) ** 2 + ((y - lips_y) / (0.0102 * math.sqrt(max(1.0 - (side / 0.030) ** 2, 0.05)))) ** 2))
        flush = _step(0.030, 0.0, math.sqrt((side - 0.045) ** 2 + (y + 0.030) ** 2)) + _step(0.020, 0.0, math.sqrt(x * x + (y + 0.036) ** 2))
        front = _step(0.03, 0.05, z)
        mix = front * min(0.85 * lips + 0.28 * flush, 1.0)
        along = (side - 0.012) / 0.040
        arch = 0.0205 + 0.0075 * math.sin(min(max(along, 0.0), 1.0) * 2.3) - 0.002 * along
        width = 0.0048 * (1.0 - 0.55 * min(max(along, 0.0), 1.0))
        brow = front * _step(1.5, 0.5, abs(y - arch) / width) * _step(-0.10, 0.10, along) * _step(1.12, 0.90, along)
        gain *= 1.0 - brow * (0.72 + 0.20 * noise(x * 700.0, y * 260.0, z * 260.0, 40))
    elif pattern == CLOTH:  # two threads, and broad stripes of the second colour
        weave = math.sin(x * 900.0) * math.sin(y * 900.0)
        mix = _step(0.55, 0.75, math.sin(y * 95.0 + 1.5 * noise(x * 6.0, y * 6.0, z * 6.0, 60)))
        gain *= 1.0 + 0.25 * m[7] * weave
    elif pattern == WOOD:
        rings = math.sin(60.0 * (y + 0.25 * noise(x * 1.5, y * 6.0, z * 6.0, 70)) + 4.0 * noise(x * 3.0, y * 9.0, z * 9.0, 71))
        mix = 0.5 + 0.5 * rings
    elif pattern == PAPER:  # wall: a faint repeated motif over plaster
        u, v = x * 5.0, y * 5.0
        motif = math.sin(math.pi * (u + v)) * math.sin(math.pi * (u - v))
        mix = _step(0.25, 0.55, motif)
    elif pattern == TILES:  # a dot in every square of side 1 / frequency, and a dark joint round it
        u, v = x * f * m[13], y * f * m[14]
        u, v = abs(u - math.floor(u) - 0.5), abs(v - math.floor(v) - 0.5)
        mix = _step(0.32, 0.22, math.sqrt(u * u + v * v))
        gain *= 1.0 - 0.35 * _step(0.40, 0.46, max(u, v))
    elif pattern == MARBLE:  # veins of the second colour: where a warped noise passes zero
        wx = 0.06 * noise(x * 9.0, y * 9.0, z * 9.0, 90)
        broad = abs(noise((x + wx) * 7.0, (y - wx) * 5.0 + 2.0 * x, (z + wx) * 7.0, 91))
        fine = abs(noise((x - wx) * 19.0, (y + wx) * 15.0, (z + wx) * 19.0, 92))
        mix = min(0.75 * _step(0.09, 0.0, broad) * (0.6 + 0.8 * fine) + 0.35 * _step(0.05, 0.0, fine), 1.0)
    elif pattern == EYE:  # iris and pupil about the object's +z
        angle = math.atan2(math.sqrt(x * x + y * y), z)
        ray = noise(math.atan2(y, x) * 8.0, angle * 6.0, 0.0, 80)
        mix = _step(0.47, 0.43, angle) * (1.0 + 0.25 * ray) - (0.55 * _step(0.38, 0.45, angle) * _step(0.50, 0.44, angle))
        gain *= 1.0 - 0.97 * _step(0.20, 0.17, angle)
        mix = min(max(mix, 0.0), 1.0)
    for c in range(3):
        out[c] = min(max((m[1 + c] + mix * (m[4 + c] - m[1 + c])) * gain, 0.0), 1.0)
