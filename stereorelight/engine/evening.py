"""Means over neighbours on one surface: the 4 x 4 kinds of pixel, which each took their own samples, evened out; and how rough it is.

In: values (C, H, W), P and N (H, W, 3) float32.  Out: (C, H, W) float32; (H, W) metres.
Over 5 x 5 pixels whose outer rows and columns count half, every kind counts the same: sixteen times as many samples, for nothing.
Source: Keller and Heidrich, Interleaved sampling, Rendering Techniques 2001.

Rows are taken apart once, in strips with a border, and the five about a row are kept; each neighbour is then a leaf loop over a strip."""

from __future__ import annotations

import math

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import f4, kernel
from stereorelight.engine.rows import in_row_blocks

REACH = 2
SIDE = 2 * REACH + 1
STRIP = 256
FLAT = 0.15  # a neighbour may stand off the pixel's own plane by this share of its distance along it, and of a pixel
ALIKE = 0.8  # least cosine between their normals
STEP = 0.5  # the same share for what is rough and still one surface


@kernel(noalias=True)
def _apart(n, P, N, px, py, pz, nx, ny, nz):
    for i in range(n):
        px[i] = P[3 * i]
        py[i] = P[3 * i + 1]
        pz[i] = P[3 * i + 2]
        nx[i] = N[3 * i]
        ny[i] = N[3 * i + 1]
        nz[i] = N[3 * i + 2]


@kernel()
def _fetch(y, x, n, P, N, row):
    """P and N of row y from x - REACH to x + n + REACH into `row` (6, n); NaN outside the picture, which is no neighbour of anything."""
    left, right = max(x - REACH, 0), min(x + n + REACH, P.shape[1] // 3)
    inside = 0 <= y < P.shape[0]
    if not inside or right - left < n + 2 * REACH:
        row[:] = f4(np.nan)
    if inside:
        at = left - x + REACH
        px, py, pz, nx, ny, nz = row[0, at:], row[1, at:], row[2, at:], row[3, at:], row[4, at:], row[5, at:]
        _apart(right - left, P[y, 3 * left : 3 * right], N[y, 3 * left : 3 * right], px, py, pz, nx, ny, nz)


@kernel(inline="always")
def _weight(count, pixel_per_m, px, py, pz, nx, ny, nz, qx, qy, qz, mx, my, mz):
    """What the neighbour q with its normal m counts for: `count` where both are of one surface, else 0."""
    a = qx - px
    b = qy - py
    c = qz - pz
    off = abs(a * nx + b * ny + c * nz)
    away = abs(a) + abs(b) + abs(c) - pz * pixel_per_m
    same = nx * mx + ny * my + nz * mz
    return count if (off <= f4(FLAT) * away) & (same >= f4(ALIKE)) else f4(0)


@kernel(noalias=True)
def _weights(n, count, pixel_per_m, px, py, pz, nx, ny, nz, qx, qy, qz, mx, my, mz, first, second, third, fourth, fifth, total):
    """What the five neighbours in a row, the first of them q[i] with its normal m[i], count for."""
    half = f4(0.5) * count
    for i in range(n):
        x = px[i]
        y = py[i]
        z = pz[i]
        u = nx[i]
        v = ny[i]
        w = nz[i]
        one = _weight(half, pixel_per_m, x, y, z, u, v, w, qx[i], qy[i], qz[i], mx[i], my[i], mz[i])
        two = _weight(count, pixel_per_m, x, y, z, u, v, w, qx[i + 1], qy[i + 1], qz[i + 1], mx[i + 1], my[i + 1], mz[i + 1])
        three = _weight(count, pixel_per_m, x, y, z, u, v, w, qx[i + 2], qy[i + 2], qz[i + 2], mx[i + 2], my[i + 2], mz[i + 2])
        four = _weight(count, pixel_per_m, x, y, z, u, v, w, qx[i + 3], qy[i + 3], qz[i + 3], mx[i + 3], my[i + 3], mz[i + 3])
        five = _weight(half, pixel_per_m, x, y, z, u, v, w, qx[i + 4], qy[i + 4], qz[i + 4], mx[i + 4], my[i + 4], mz[i + 4])
        first[i] = one
        second[i] = two
        third[i] = three
        fourth[i] = four
        fifth[i] = five
        total[i] += one + two + three + four + five


@kernel(noalias=True)
def _add(n, first, second, third, fourth, fifth, value, out):
    for i in range(n):
        out[i] += first[i] * value[i] + second[i] * value[i + 1] + third[i] * value[i + 2] + fourth[i] * value[i + 3] + fifth[i] * value[i + 4]


@kernel(noalias=True)
def _share(n, pz, total, value, out):
    """The mean of what was added up; a pixel without neighbours, or without P or N, keeps its own value."""
    for i in range(n):
        known = (pz[i] < f4(0)) & (total[i] > f4(0))
        out[i] = out[i] / total[i] if known else value[i]


@kernel()
def _rows(first, end, values, P, N, pixel_per_m, out):
    """Rows first..end; values and out (C, H, W), P, N (H, 3 W)."""
    channels, height, width = values.shape
    ring = np.empty((SIDE, 6, STRIP + 2 * REACH), np.float32)
    w = np.empty((SIDE, STRIP), np.float32)
    value = np.zeros(STRIP + 2 * REACH, np.float32)
    total = np.empty(STRIP, np.float32)
    for x in range(0, width, STRIP):
        n = min(STRIP, width - x)
        left, right = max(x - REACH, 0), min(x + n + REACH, width)
        for y in range(first - REACH, first + REACH):
            _fetch(y, x, n, P, N, ring[(y + SIDE) % SIDE])
        for y in range(first, end):
            _fetch(y + REACH, x, n, P, N, ring[(y + REACH) % SIDE])
            own = ring[y % SIDE]
            px, py, pz, nx, ny, nz = own[0, REACH:], own[1, REACH:], own[2, REACH:], own[3, REACH:], own[4, REACH:], own[5, REACH:]
            total[:] = f4(0)
            for c in range(channels):
                out[c, y, x : x + n] = f4(0)
            for v in range(max(y - REACH, 0), min(y + REACH + 1, height)):
                row = ring[v % SIDE]
                count = f4(0.5) if abs(v - y) == REACH else f4(1)
                _weights(
                    n, count, pixel_per_m, px, py, pz, nx, ny, nz, row[0], row[1], row[2], row[3], row[4], row[5],
                    w[0], w[1], w[2], w[3], w[4], total,
                )  # fmt: skip
                for c in range(channels):
                    value[left - x + REACH : right - x + REACH] = values[c, v, left:right]
                    _add(n, w[0], w[1], w[2], w[3], w[4], value, out[c, y, x:])
            for c in range(channels):
                _share(n, pz, total, values[c, y, x:], out[c, y, x:])


def evened(values: Float32, P: Float32, N: Float32, focal_px: float) -> Float32:
    """`values` (C, H, W) without the pattern of their kinds; NaN nowhere in them.  Pixels without P or N keep their own."""
    out = np.empty_like(values)
    flat = [a.reshape(len(a), -1) for a in (P, N)]
    in_row_blocks(lambda a, b: _rows(a, b, values, *flat, f4(1 / focal_px), out), values.shape[1])
    return out


@kernel(noalias=True)
def _apart_from_plane(n, pixel_per_m, px, py, pz, nx, ny, nz, qx, qy, qz, total, count):
    """Add up how far neighbours q stand off the plane of each pixel, squared, and how many of them are of its surface."""
    for i in range(n):
        a = qx[i] - px[i]
        b = qy[i] - py[i]
        c = qz[i] - pz[i]
        off = a * nx[i] + b * ny[i] + c * nz[i]
        near = abs(off) <= f4(STEP) * (abs(a) + abs(b) + abs(c) - pz[i] * pixel_per_m)
        total[i] += off * off if near else f4(0)
        count[i] += f4(1) if near else f4(0)


@kernel(noalias=True)
def _root(n, pz, total, count, out):
    for i in range(n):
        known = (pz[i] < f4(0)) & (count[i] > f4(1))
        out[i] = math.sqrt(total[i] / (count[i] - f4(1))) if known else f4(0)


@kernel()
def _rough_rows(first, end, P, N, pixel_per_m, out):
    """Rows first..end; P, N (H, 3 W), out (H, W)."""
    height, width = out.shape
    ring = np.empty((SIDE, 6, STRIP + 2 * REACH), np.float32)
    total, count = np.empty(STRIP, np.float32), np.empty(STRIP, np.float32)
    for x in range(0, width, STRIP):
        n = min(STRIP, width - x)
        for y in range(first - REACH, first + REACH):
            _fetch(y, x, n, P, N, ring[(y + SIDE) % SIDE])
        for y in range(first, end):
            _fetch(y + REACH, x, n, P, N, ring[(y + REACH) % SIDE])
            own = ring[y % SIDE]
            px, py, pz, nx, ny, nz = own[0, REACH:], own[1, REACH:], own[2, REACH:], own[3, REACH:], own[4, REACH:], own[5, REACH:]
            total[:] = f4(0)
            count[:] = f4(0)
            for v in range(max(y - REACH, 0), min(y + REACH + 1, height)):
                row = ring[v % SIDE]
                for at in range(SIDE):
                    _apart_from_plane(n, pixel_per_m, px, py, pz, nx, ny, nz, row[0, at:], row[1, at:], row[2, at:], total, count)
            _root(n, pz, total, count, out[y, x:])


def roughness(P: Float32, N: Float32, focal_px: float) -> Float32:
    """(H, W) metres: root mean square of how far the 5 x 5 pixels about each one stand off the plane through it along N; 0 where unknown."""
    out = np.empty(P.shape[:2], np.float32)
    flat = [a.reshape(len(a), -1) for a in (P, N)]
    in_row_blocks(lambda a, b: _rough_rows(a, b, *flat, f4(1 / focal_px), out), len(out))
    return out
