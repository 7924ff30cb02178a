"""Means over neighbours on one surface: the 4 x 4 kinds of pixel, which each took their own samples, evened out; and how rough it is.

In: values (H, W, C), P and N (H, W, 3) float32.  Out: (H, W, C) float32; (H, W) metres.
Over 5 x 5 pixels whose outer rows and columns count half, every kind counts the same: sixteen times as many samples, for nothing.
Source: Keller and Heidrich, Interleaved sampling, Rendering Techniques 2001."""

from __future__ import annotations

import math

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.rows import in_row_blocks

REACH = 2
FLAT = 0.15  # a neighbour may stand off the pixel's own plane by this share of its distance along it, and of a pixel
ALIKE = 0.8  # least cosine between their normals
STEP = 0.5  # the same share for what is rough and still one surface


@kernel()
def _rows(first, end, values, P, N, pixel_per_m, out):
    height, width, channels = values.shape
    for y in range(first, end):
        for x in range(width):
            z = -P[y, x, 2]
            if not (z > f4(0) and N[y, x, 0] * N[y, x, 0] >= f4(0)):
                for c in range(channels):
                    out[y, x, c] = values[y, x, c]
                continue
            least = z * pixel_per_m
            total = f4(0)
            for c in range(channels):
                out[y, x, c] = f4(0)
            for dy in range(-REACH, REACH + 1):
                v = y + dy
                if v < 0 or v >= height:
                    continue
                for dx in range(-REACH, REACH + 1):
                    u = x + dx
                    if u < 0 or u >= width:
                        continue
                    a = P[v, u, 0] - P[y, x, 0]
                    b = P[v, u, 1] - P[y, x, 1]
                    c_ = P[v, u, 2] - P[y, x, 2]
                    off = abs(a * N[y, x, 0] + b * N[y, x, 1] + c_ * N[y, x, 2])
                    away = abs(a) + abs(b) + abs(c_)
                    same = N[y, x, 0] * N[v, u, 0] + N[y, x, 1] * N[v, u, 1] + N[y, x, 2] * N[v, u, 2]
                    if not (off <= f4(FLAT) * (away + least) and same >= f4(ALIKE)):
                        continue
                    w = f4(1)
                    if dy == REACH or dy == -REACH:
                        w *= f4(0.5)
                    if dx == REACH or dx == -REACH:
                        w *= f4(0.5)
                    total += w
                    for c in range(channels):
                        out[y, x, c] += w * values[v, u, c]
            for c in range(channels):
                out[y, x, c] = out[y, x, c] / total if total > f4(0) else values[y, x, c]


def evened(values: Float32, P: Float32, N: Float32, focal_px: float) -> Float32:
    """`values` (H, W, C) without the pattern of their kinds; NaN nowhere in them.  Pixels without P or N keep their own."""
    out = np.empty_like(values)
    in_row_blocks(lambda a, b: _rows(a, b, values, P, N, f4(1 / focal_px), out), values.shape[0])
    return out


@kernel()
def _rough_rows(first, end, P, N, pixel_per_m, out):
    height, width = P.shape[0], P.shape[1]
    for y in range(first, end):
        for x in range(width):
            z = -P[y, x, 2]
            total = f4(0)
            count = f4(0)
            if z > f4(0) and N[y, x, 0] * N[y, x, 0] >= f4(0):
                least = z * pixel_per_m
                for v in range(max(y - REACH, 0), min(y + REACH + 1, height)):
                    for u in range(max(x - REACH, 0), min(x + REACH + 1, width)):
                        a = P[v, u, 0] - P[y, x, 0]
                        b = P[v, u, 1] - P[y, x, 1]
                        c = P[v, u, 2] - P[y, x, 2]
                        off = a * N[y, x, 0] + b * N[y, x, 1] + c * N[y, x, 2]
                        if abs(off) <= f4(STEP) * (abs(a) + abs(b) + abs(c) + least):
                            total += off * off
                            count += f4(1)
            out[y, x] = math.sqrt(total / (count - f4(1))) if count > f4(1) else f4(0)


def roughness(P: Float32, N: Float32, focal_px: float) -> Float32:
    """(H, W) metres: root mean square of how far the 5 x 5 pixels about each one stand off the plane through it along N; 0 where unknown."""
    out = np.empty(P.shape[:2], np.float32)
    in_row_blocks(lambda a, b: _rough_rows(a, b, P, N, f4(1 / focal_px), out), P.shape[0])
    return out
