"""Evidence weighed: how sure a disparity is, and how far off it may be.

In: what speaks for and against each pixel, (H, W) float32, as stereo/confidence.py names it.  Out: (H, W) float32."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Float32
from stereorelight.engine.fastmath import exp2, kernel, log2
from stereorelight.engine.rows import in_pieces

f4 = np.float32
LN2 = f4(np.log(2))
MOST_ODDS = f4(100)  # powers of two: surer is not told apart
EDGE_PX = 6  # of disparity nearby: more is as good as an edge
_leaf = kernel(fastmath=False, noalias=True)


@_leaf
def _believed_row(
    c, floors, flow_agrees, confirmed, flow_nearby, confirmed_nearby, spread, sigma, misfit, alone, texture, uneven, on_rims, led, on_walls, out
):
    floor, lower = floors
    for x in range(out.size):
        t = c[0] + c[1] * confirmed[x] + c[2] * flow_agrees[x]
        edge = min(spread[x], f4(EDGE_PX)) * f4(1 / EDGE_PX)
        t += edge * (c[3] + c[7] * confirmed_nearby[x] + c[8] * flow_nearby[x])
        t += c[5] * confirmed_nearby[x] + c[6] * flow_nearby[x] + c[10] * alone[x] + c[13] * on_rims[x] + c[15] * on_walls[x]
        logs = c[4] * log2(max(sigma[x], f4(1e-3)) * f4(1 / 0.03)) + c[9] * log2(f4(1) + misfit[x])
        logs += c[11] * log2(f4(0.1) + texture[x]) + c[12] * log2(f4(0.02) + uneven[x])
        logs += (c[14] + c[16] * confirmed_nearby[x]) * log2(f4(0.1) + led[x])
        p = f4(1) / (f4(1) + exp2(min(-logs - t / LN2, MOST_ODDS)))
        least = floor + alone[x] * (lower - floor)
        out[x] = np.sqrt((p * p + least * least) / (f4(1) + least * least))


@njit(cache=True, nogil=True, error_model="numpy")
def _believed(
    first,
    end,
    c,
    floors,
    flow_agrees,
    confirmed,
    flow_nearby,
    confirmed_nearby,
    spread,
    sigma,
    misfit,
    alone,
    texture,
    uneven,
    on_rims,
    led,
    on_walls,
    out,
):
    for y in range(first, end):
        _believed_row(
            c, floors, flow_agrees[y], confirmed[y], flow_nearby[y], confirmed_nearby[y], spread[y], sigma[y], misfit[y], alone[y], texture[y],
            uneven[y], on_rims[y], led[y], on_walls[y], out[y],
        )  # fmt: skip


def believed(
    coefficients: Float32,
    confirmed: Float32,
    flow_agrees: Float32,
    confirmed_nearby: Float32,
    flow_nearby: Float32,
    spread: Float32,
    sigma: Float32,
    misfit: Float32,
    alone: Float32,
    texture: Float32,
    uneven: Float32,
    on_rims: Float32,
    led: Float32,
    on_walls: Float32,
    *,
    floors: tuple[float, float],
) -> Float32:
    """The logistic weighing p of the evidence that stereo/confidence.py names, told as sqrt((p^2 + floor^2) / (1 + floor^2)); every array (H, W).

    floors : where `alone` is 0 and where it is 1.
    """
    out = np.empty_like(spread)
    of_pixels = (flow_agrees, confirmed, flow_nearby, confirmed_nearby, spread, sigma, misfit, alone, texture, uneven, on_rims, led, on_walls)
    given = (coefficients, (f4(floors[0]), f4(floors[1])), *of_pixels, out)
    in_pieces(lambda first, end: _believed(first, end, *given), spread.shape[0])
    return out


@_leaf
def _deviation_row(c, usual, least, sigma, confidence, clumped, alone, out):
    always, own, doubt, together, nothing, sure = c
    sigma_px, doubtful, clumps = usual
    for x in range(out.size):
        t = own * log2(max(sigma[x], f4(1e-3)) / sigma_px) + doubt * log2((f4(1.005) - confidence[x]) / doubtful)
        t += together * log2(max(clumped[x], least) / clumps)
        t += (always + nothing * alone[x] * max(sure - confidence[x], f4(0))) / LN2
        out[x] = exp2(min(t, MOST_ODDS))


@njit(cache=True, nogil=True, error_model="numpy")
def _deviation(first, end, c, usual, least, scale, most, sigma, confidence, clumped, alone, out):
    for y in range(first, end):
        _deviation_row(c, usual, least, sigma[y], confidence[y], clumped[y], alone[y], out[y])
        for x in range(out.shape[1]):
            out[y, x] = min(scale * out[y, x], most)


def deviation(
    coefficients: tuple[float, ...],
    sigma: Float32,
    confidence: Float32,
    clumped: Float32,
    alone: Float32,
    *,
    sigma_px: float,
    doubt: float,
    clumps: float,
    least_clumped: float,
    most_px: float,
) -> Float32:
    """`sigma_px` exp(c0 + c1 log(sigma / sigma_px) + c2 log((1.005 - confidence) / doubt) + c3 log(clumped / clumps) + c4 alone (c5 - confidence)),
    at most `most_px`; every array (H, W).

    clumped : not less than `least_clumped`.   c5 - confidence : not less than 0.
    """
    out = np.empty_like(confidence)
    c, usual = tuple(f4(a) for a in coefficients), (f4(sigma_px), f4(doubt), f4(clumps))
    given = (c, usual, f4(least_clumped), f4(sigma_px), f4(most_px), sigma, confidence, clumped, alone, out)
    in_pieces(lambda first, end: _deviation(first, end, *given), out.shape[0])
    return out
