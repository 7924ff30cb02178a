"""The joint fit of shading and disparity on one level of a pyramid, and from level to level.

In: a `Level` with its disparity and given normals.  Out: a `State`: v = -log Z on which they and shading agree, and what shading said.
Four terms share v; see `surface/shading.py`.  Gauss-Newton from coarse to fine, conjugate gradients inside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.engine import shading as engine
from stereorelight.surface.plate_light import LOCAL_SHARE, Labels, PlateLight, basis, light_of, log_chroma
from stereorelight.surface.shading_levels import Level, around, cells_of, twice, typical

f4 = np.float32

# Texture, too, is wrong in the same way over several pixels, and a normal's error over as many: each of them has one vote a pixel, and ...
CORRELATED_PX2 = 5.0  # ... disparity, which is wrong over wider ground, one for so many
DOUBT_WIDTH = 320  # of a picture that shows well enough what given normals leave of brightness, and ...
LEAST_CELLS = 50  # ... of a material there, to say so
UNSEEN = 2.0  # variance that given normals' errors cause over what is seen of it: light and local means take up half, on cloth that is told truly
LEAST_DOUBT = 1 / 16  # of what is told: no less is believed of the given normals' variance
BEND = 80.0  # change of slope over the width of the frame that is nothing special
WIDEST_BEND = 0.3  # the same over one pixel of any level
SLOW_SHARE = 1 / 48  # of the width: what varies over more is not shading's to tell
GRAIN = 0.035  # of log brightness: pores, threads and what no light model says
TRUST = 6.0  # standard deviations of shading beyond which it is something else
PAINT = 0.03  # change of log chromaticity that is beyond any mix of lights
LEAST_EXPLAINED = (0.0, 0.1)  # by the light of one size: below it shading is left out there, above it it has its full weight


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Gauss-Newton rounds and conjugate gradient steps a level; the finest level has its own."""

    rounds: int
    steps: int
    finest_rounds: int
    finest_steps: int


EFFORTS: dict[str, Effort] = {
    "standard": Effort(rounds=3, steps=25, finest_rounds=2, finest_steps=15),
    "fine": Effort(rounds=5, steps=40, finest_rounds=3, finest_steps=25),
}


def _grain(level: Level, cells: Labels, L: Float32, slow_px: float) -> tuple[Float32, Float32]:
    """Variance of log brightness that is no shading (noise and fine grain, as the picture shows it), and 0..1 where paint changes."""
    inside = (cells >= 0).astype(np.float32)
    fine = (L - ndimage.uniform_filter(L, 3, mode="nearest")) * ndimage.minimum_filter(inside, 3)
    spread = typical(fine, ndimage.minimum_filter(inside, 3), max(slow_px / 2, 2.0)) * f4(1.2533 * 1.06)
    variance = spread * spread + f4(GRAIN**2)
    same = np.ones_like(L)
    chroma = log_chroma(level.colour)
    for k in range(2):
        c = np.ascontiguousarray(chroma[..., k])
        near = ndimage.uniform_filter(c, 3, mode="nearest")
        noise = typical((c - near) * inside, inside, max(slow_px / 2, 2.0)) * f4(1.2533 / 3)
        off = near - around(near, inside, max(slow_px / 2, 2.0))
        same /= (1 + off * off / (9 * (noise * noise + f4(PAINT**2)))) ** 2
    return variance, same.astype(np.float32)


def _doubted(level: Level, cells: Labels, L: Float32, light: PlateLight, sensitive: Float32) -> Float64:
    """(M,) how much of the variance that each material's given normals are told with is seen in the brightness that they leave unexplained.

    What depth is off by as a whole tilts no normal, and how far its errors hang together is not passed on: its normals are told up to three
    times as far off as they are.  Were they, the plate would differ from what light makes of them by more than it does.
    L : (H, W) log brightness of cells.   sensitive : (H, W), the square of what log shading changes by with the slopes by rays.
    """
    by = max(1, round(L.shape[1] / DOUBT_WIDTH))
    few = np.s_[::by, ::by]
    x, y, pu, pv, qu, qv = (a[few] for a in level.rays)
    du, dv, clear, brightness = (a[few] for a in (level.du, level.dv, level.clear, L))
    of = cells[few]
    told = (level.turned * sensitive)[few]
    p, q = pu * du + pv * dv, qu * du + qv * dv
    N = np.stack([-p, q, 1 - x * p - y * q], axis=-1)
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    share = np.ones(level.count)
    for k in range(level.count):
        here = (of == k) & (clear >= 1)
        if here.sum() < LEAST_CELLS or light.explained[k] <= 0:
            continue
        left = np.zeros_like(brightness)
        S = np.einsum("nk,k->n", basis(N[here]), light.coefficients[k])
        left[here] = brightness[here] - np.log(np.maximum(S, light.floor[k]))
        left -= around(left, here.astype(np.float32), LOCAL_SHARE * left.shape[1])
        seen = (1.4826 * float(np.median(np.abs(left[here])))) ** 2
        share[k] = np.clip(UNSEEN * seen / max(float(np.median(told[here])), 1e-12), LEAST_DOUBT, 1.0)
    return share


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """v of a level, and what shading had to say: weight of each cell, log shading, its derivatives by pixels, what is left over."""

    v: Float32
    weight: Float32
    gu: Float32
    gv: Float32
    left: Float32
    N: Float32
    light: PlateLight


def started(level: Level, coarser: Level, v: Float32) -> Float32:
    """v of the next finer level: the coarser one's, but beside depth edges the finer depth moved by what the coarser one moved."""
    shape = (level.v.shape[0], level.v.shape[1])
    moved = level.v + twice(v - coarser.v, shape)
    edge = ndimage.maximum_filter((level.okc == 0).astype(np.uint8), 7) > 0
    edge |= twice(coarser.broken.astype(np.float32), shape) > 0
    return np.where(edge, moved, twice(v, shape)).astype(np.float32)


def _unlit(level: Level) -> PlateLight:
    count = level.count
    return PlateLight(
        labels=level.labels, coefficients=np.zeros((count, 9)), floor=np.ones(count), residual=np.ones(count), explained=np.zeros(count)
    )


def lit_by(level: Level, cells: Labels, L: Float32, v: Float32, only: Bool | None = None) -> PlateLight:
    nothing = np.full(cells.shape, -1, np.int16)
    N = engine.shade(v, level.rays, nothing, np.zeros((1, 9), np.float32), np.ones(1, np.float32))[3]
    inside = cells >= 0
    labels = np.where(inside, level.labels, -1).astype(np.int16)
    found = light_of(labels, L, np.moveaxis(N, 0, -1), inside.astype(np.float32), count=level.count, only=only)
    return replace(found, labels=level.labels)


def solved(
    level: Level, v: Float32, *, rounds: int, steps: int, light: PlateLight | None, trust: Float64 | None, strength: float, lit: bool
) -> State:
    """Gauss-Newton on one level from `v`.  light None is found from v itself; trust None is not known yet; `lit` off leaves shading out."""
    shape = v.shape
    slow_px = max(SLOW_SHARE * shape[1], 2.0)
    correlated = min(1.0, level.scale**2 / CORRELATED_PX2)
    precision = (f4(correlated) / level.variance).astype(np.float32)
    free = min(BEND / shape[1], WIDEST_BEND) / level.focal
    cells = level.cells
    L = cells_of(level.grey)
    if lit and light is None:
        light = lit_by(level, cells, L, v, None if trust is None else trust > 0)
    if light is None:
        light = _unlit(level)
    sure = rising(light.explained, *LEAST_EXPLAINED) * (1 if trust is None else trust)
    believed_in = np.append(sure, 0.0).astype(np.float32)[cells]
    cells = np.where((cells >= 0) & (believed_in > 0), cells, -1).astype(np.int16) if lit else np.full(shape, -1, np.int16)
    inside = (cells >= 0).astype(np.float32)
    shines = bool(inside.any())
    zero = np.zeros(shape, np.float32)
    variance, same = _grain(level, cells, L, slow_px) if shines else (np.ones(shape, np.float32), zero)
    table = light.coefficients.astype(np.float32) if light.coefficients.size else np.zeros((1, 9), np.float32)
    floor = light.floor.astype(np.float32) if light.floor.size else np.ones(1, np.float32)
    weight, left, gu, gv = inside, zero, zero, zero
    doubted = np.ones(shape, np.float32)
    if shines:
        _, gu, gv, _ = engine.shade(v, level.rays, cells, table, floor)
        sensitive: Float32 = ((gu * gu + gv * gv) / f4(level.focal**2)).astype(np.float32)
        doubted = np.append(_doubted(level, cells, L, light, sensitive), 1.0).astype(np.float32)[cells]
    slopes = (free * level.focal) ** 2
    believed: Float32 = (level.okc * f4(slopes) / np.maximum(level.turned * doubted, f4(1e-9))).astype(np.float32)
    for _ in range(rounds):
        ws = zero
        if shines:
            logS, gu, gv, _ = engine.shade(v, level.rays, cells, table, floor)
            e = (L - logS) * inside
            left = (e - around(e, weight, slow_px)) * inside
            weight = inside * same / (1 + left * left / (f4(TRUST**2) * variance)) ** 2
            ws = weight * level.clear * believed_in * (f4(strength * strength * free * free) / variance)
        wx, wy, wc = engine.bend_weights(v, level.okx, level.oky, level.okc, free=2 * free)
        off = v - level.v
        data: Float32 = (precision * f4(free * free) / (1 + off * off / (9 * level.variance))).astype(np.float32)
        A, rhs = engine.assemble(
            data=data,
            pull=level.v,
            shading=ws,
            left=left + _along(v, gu, gv),
            gu=gu,
            gv=gv,
            turn=believed,
            du=level.du,
            dv=level.dv,
            bends=(wx, wy, wc),
        )
        v = v + engine.solve(A, engine.rest(A, rhs, v), steps=steps)
    _, gu, gv, N = engine.shade(v, level.rays, cells, table, floor)
    return State(v=v, weight=weight, gu=gu, gv=gv, left=left, N=N, light=light)


def _along(v: Float32, gu: Float32, gv: Float32) -> Float32:
    out = np.zeros_like(v)
    a, b, c, d = v[:-1, :-1], v[:-1, 1:], v[1:, :-1], v[1:, 1:]
    out[:-1, :-1] = f4(0.5) * ((b - a + d - c) * gu[:-1, :-1] + (c - a + d - b) * gv[:-1, :-1])
    return out


def chain(levels: list[Level], last: int, effort: Effort, *, strength: float, lit: bool) -> State:
    """From the coarsest level down to `last`, each material lit wherever its light explains anything."""
    plain: dict[str, Any] = {"steps": effort.steps, "light": None, "trust": None, "strength": strength}
    v = solved(levels[-1], levels[-1].v, rounds=effort.rounds, lit=False, **plain).v
    state = solved(levels[-1], v, rounds=effort.rounds, lit=lit, **plain)
    for k in range(len(levels) - 2, last - 1, -1):
        state = solved(levels[k], started(levels[k], levels[k + 1], state.v), rounds=effort.rounds, lit=lit, **plain)
    return state


def rising(a: Float64, low: npt.ArrayLike, high: npt.ArrayLike) -> Float64:
    """0 up to `low`, 1 from `high`, smooth between."""
    t = np.clip((a - np.asarray(low)) / (np.asarray(high) - np.asarray(low)), 0, 1)
    smooth: Float64 = t * t * (3 - 2 * t)
    return smooth
