"""Shading as evidence: normals and a depth on which disparity and the plate's own shading agree.

In: the plate (scene-linear), Z on it with its standard deviation, and the camera.  Out: a `ShadedSurface` on the same plate.
Frames: N in the scene frame.  The unknown is v = -log Z on the pixel grid.

Skin and plain cloth give a matcher little to hold on to, while one degree of turn changes a Lambertian pixel by one to two percent.
Four terms share v, each weighed by its own variance: disparity (robust, one vote for every patch over which its error is one and the
same), relative shading (robust; whatever varies slowly is albedo's or a near light's), second-order smoothness (robust, so creases
stay), and nothing across a depth edge.  Gauss-Newton from coarse to fine, conjugate gradients inside, so that wide shapes are found
where they are cheap and fine detail is never drowned by a noisy start.

Shape or paint?  Grain, patterns and noise raise the variance that shading is given.  What changes chromaticity is paint.  What fits
no shape is left to disparity.  And every material has to pass a test, by normals that shading had no part in; see `_judged`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.engine import shading as engine
from stereorelight.errors import PassError, nearest_hint
from stereorelight.surface.normals import normals_and_sigma
from stereorelight.surface.plate_light import Labels, PlateLight, light_of, log_chroma
from stereorelight.surface.position import checked_depth, ray_slopes
from stereorelight.surface.shading_levels import Level, around, cells_of, levels_of, twice, typical

Quality = Literal["standard", "fine"]
f4 = np.float32

# Texture, too, is wrong in the same way over several pixels, and a normal's error over as many: each of them has one vote a pixel, and ...
CORRELATED_PX2 = 5.0  # ... disparity, which is wrong over wider ground, one for so many
BEND = 80.0  # change of slope over the width of the frame that is nothing special
WIDEST_BEND = 0.3  # the same over one pixel of any level
SLOW_SHARE = 1 / 48  # of the width: what varies over more is not shading's to tell
GRAIN = 0.035  # of log brightness: pores, threads and what no light model says
TRUST = 6.0  # standard deviations of shading beyond which it is something else
LEAST_SIGMA = 1e-5  # of Z, relative
SIGMA_COEFFICIENTS = (2.684, 0.369, 0.175, -0.452)  # of N_sigma: see `_doubt` and docs/shading.md
CLIPPED, BLACK = 0.98, 2e-3
PAINT = 0.03  # change of log chromaticity that is beyond any mix of lights
LEAST_EXPLAINED = (0.0, 0.1)  # by the light of one size: below it shading is left out there, above it it has its full weight
JUDGED_WIDTH = 480  # of the level at which materials are tested against disparity
LEAST_SHARE = (0.38, 0.5)  # of the variance of brightness, explained by normals that shading had no part in: where disparity ...
MUCH_GAIN = (8.0, 2.5)  # ... knows so much less than shading would
HALF_SURE = 0.08  # of that share, to either side of the least: in between a material is shaded in part, so that frames do not jump
LEAST_TURN_DEG = (15.0, 20.0)  # median angle of normals to their mean: flat but for noise, and surely not flat
LEAST_GAIN = (0.5, 0.7)  # error of the given normals over that of shading's: of no use, and of use
MOST_SENSITIVE = 0.9  # change of log brightness per radian: more than light on matter does


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


@dataclass(frozen=True, kw_only=True, eq=False)
class ShadedSurface:
    """Z (H, W) and N (H, W, 3) on which disparity and shading agree; where shading says nothing, Z and N as they were given.

    N_sigma : (H, W) degrees: about two thirds of such normals are within it.
    weight  : (H, W) 0..1, how much of a normal is shading's.
    light   : what the plate was lit by, and how it explains each material.
    trust   : (M,) 0..1, how well each material passed the test; shares: how much of its brightness normals from disparity explain.
    figures : the same in numbers for a receipt.
    """

    Z: Float32
    N: Float32
    N_sigma: Float32
    weight: Float32
    light: PlateLight
    trust: Float64
    shares: Float64
    figures: dict[str, Any] = field(default_factory=dict)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    """v of a level, and what shading had to say: weight of each cell, log shading, its derivatives by pixels, what is left over."""

    v: Float32
    weight: Float32
    gu: Float32
    gv: Float32
    left: Float32
    N: Float32
    light: PlateLight


def _started(level: Level, coarser: Level, v: Float32) -> Float32:
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


def _lit(level: Level, cells: Labels, L: Float32, v: Float32, only: Bool | None = None) -> PlateLight:
    nothing = np.full(cells.shape, -1, np.int16)
    N = engine.shade(v, level.rays, nothing, np.zeros((1, 9), np.float32), np.ones(1, np.float32))[3]
    inside = cells >= 0
    labels = np.where(inside, level.labels, -1).astype(np.int16)
    found = light_of(labels, L, np.moveaxis(N, 0, -1), inside.astype(np.float32), count=level.count, only=only)
    return replace(found, labels=level.labels)


def _solved(
    level: Level, v: Float32, *, rounds: int, steps: int, light: PlateLight | None, trust: Float64 | None, strength: float, lit: bool
) -> _State:
    """Gauss-Newton on one level from `v`.  light None is found from v itself; trust None is not known yet; `lit` off leaves shading out."""
    shape = v.shape
    slow_px = max(SLOW_SHARE * shape[1], 2.0)
    correlated = min(1.0, level.scale**2 / CORRELATED_PX2)
    precision = (f4(correlated) / level.variance).astype(np.float32)
    free = min(BEND / shape[1], WIDEST_BEND) / level.focal
    cells = level.cells
    L = cells_of(level.grey)
    if lit and light is None:
        light = _lit(level, cells, L, v, None if trust is None else trust > 0)
    if light is None:
        light = _unlit(level)
    sure = _rising(light.explained, *LEAST_EXPLAINED) * (1 if trust is None else trust)
    believed_in = np.append(sure, 0.0).astype(np.float32)[cells]
    cells = np.where((cells >= 0) & (believed_in > 0), cells, -1).astype(np.int16) if lit else np.full(shape, -1, np.int16)
    inside = (cells >= 0).astype(np.float32)
    shines = bool(inside.any())
    zero = np.zeros(shape, np.float32)
    variance, same = _grain(level, cells, L, slow_px) if shines else (np.ones(shape, np.float32), zero)
    table = light.coefficients.astype(np.float32) if light.coefficients.size else np.zeros((1, 9), np.float32)
    floor = light.floor.astype(np.float32) if light.floor.size else np.ones(1, np.float32)
    weight, left, gu, gv, one = inside, zero, zero, zero, np.ones(shape, np.float32)
    slopes = (free * level.focal) ** 2
    believed = level.okc * f4(slopes) / np.maximum(level.turned, f4(1e-9))
    for _ in range(rounds):
        ws = zero
        if shines:
            logS, gu, gv, _ = engine.shade(v, level.rays, cells, table, floor)
            e = (L - logS) * inside
            left = (e - around(e, weight, slow_px)) * inside
            weight = inside * same / (1 + left * left / (f4(TRUST**2) * variance)) ** 2
            ws = weight * believed_in * (f4(strength * strength * free * free) / variance)
        wx, wy, wc = engine.bend_weights(v, level.okx, level.oky, level.okc, free=2 * free)
        off = v - level.v
        data: Float32 = (precision * f4(free * free) / (1 + off * off / (9 * level.variance))).astype(np.float32)
        away = (_along(v, one, zero) - level.du) ** 2 + (_along(v, zero, one) - level.dv) ** 2
        turn = believed / (1 + away * f4(level.focal**2) / (9 * level.turned + f4(1e-12)))
        A, rhs = engine.assemble(
            data=data, pull=level.v, shading=ws, left=left + _along(v, gu, gv), gu=gu, gv=gv, turn=turn, du=level.du, dv=level.dv, bends=(wx, wy, wc)
        )
        v = v + engine.solve(A, engine.rest(A, rhs, v), steps=steps)
    _, gu, gv, N = engine.shade(v, level.rays, cells, table, floor)
    return _State(v=v, weight=weight, gu=gu, gv=gv, left=left, N=N, light=light)


def _along(v: Float32, gu: Float32, gv: Float32) -> Float32:
    out = np.zeros_like(v)
    a, b, c, d = v[:-1, :-1], v[:-1, 1:], v[1:, :-1], v[1:, 1:]
    out[:-1, :-1] = f4(0.5) * ((b - a + d - c) * gu[:-1, :-1] + (c - a + d - b) * gv[:-1, :-1])
    return out


def _chain(levels: list[Level], last: int, effort: Effort, *, strength: float, lit: bool) -> _State:
    """From the coarsest level down to `last`, each material lit wherever its light explains anything."""
    plain: dict[str, Any] = {"steps": effort.steps, "light": None, "trust": None, "strength": strength}
    v = _solved(levels[-1], levels[-1].v, rounds=effort.rounds, lit=False, **plain).v
    state = _solved(levels[-1], v, rounds=effort.rounds, lit=lit, **plain)
    for k in range(len(levels) - 2, last - 1, -1):
        state = _solved(levels[k], _started(levels[k], levels[k + 1], state.v), rounds=effort.rounds, lit=lit, **plain)
    return state


def _rising(a: Float64, low: npt.ArrayLike, high: npt.ArrayLike) -> Float64:
    """0 up to `low`, 1 from `high`, smooth between."""
    t = np.clip((a - np.asarray(low)) / (np.asarray(high) - np.asarray(low)), 0, 1)
    smooth: Float64 = t * t * (3 - 2 * t)
    return smooth


def _judged(level: Level, lit: _State, plain: _State) -> tuple[Float64, Float64, Float64, Float64]:
    """How far each material's shading is trusted (0..1), the share it explains by normals it had no part in, its gain, how normals turn.

    Three questions: do normals from disparity alone explain the brightness (else it is paint); do they turn at all (else the material
    is flat, and all its brightness is paint); does shading, as far as its light fits, know normals better than disparity does?
    """
    count = len(lit.light.explained)
    cells = level.cells
    explained = _lit(level, cells, cells_of(level.grey), plain.v).explained
    gain, turns = np.zeros(count), np.zeros(count)
    sensitivity = np.hypot(lit.gu, lit.gv) / f4(level.focal)
    for k in range(count):
        here = cells == k
        if here.sum() < 50 or explained[k] <= 0:
            continue
        N = plain.N[:, here].astype(np.float64)
        turns[k] = np.degrees(np.median(np.arccos(np.clip(N.mean(axis=1) @ N / max(float(np.linalg.norm(N.mean(axis=1))), 1e-9), -1, 1))))
        sense = min(float(np.median(sensitivity[here])), MOST_SENSITIVE)
        gain[k] = math.sqrt(float(np.median(level.turned[here]))) * sense / max(float(lit.light.residual[k]), GRAIN)
    least = np.minimum(explained, lit.light.explained)
    needed = np.interp(gain, MUCH_GAIN[::-1], LEAST_SHARE[::-1])
    trust = _rising(least, needed - HALF_SURE, needed + HALF_SURE) * _rising(turns, *LEAST_TURN_DEG) * _rising(gain, *LEAST_GAIN)
    return trust, explained, gain, turns


def _doubt(level: Level, state: _State, N: Float32, given: Float32, share: Float32) -> Float32:
    """(H, W) degrees within which two thirds of the normals made by shading lie, as 23 faces and shirts with known normals have it.

    It grows with what shading does not explain nearby and with how far normals were moved, and falls with the size of the frame: the
    same feature has more pixels there.
    """
    k = level.v.shape[1] / 960
    inside = (share > 0).astype(np.float32)
    with np.errstate(invalid="ignore"):
        moved = np.degrees(np.arccos(np.clip((N * given).sum(axis=-1), -1, 1)))
    doubted = np.log(around(1 - state.weight, inside, 4 * k) + f4(0.05))
    pushed = np.log(around(np.nan_to_num(moved, nan=0.0).astype(np.float32), inside, 4 * k) + f4(0.5))
    c = SIGMA_COEFFICIENTS
    sigma: Float32 = np.exp(c[0] + c[1] * doubted + c[2] * pushed + c[3] * math.log(k)).astype(np.float32)
    return np.clip(sigma, 0.5, 90)


def _at_pixels(level: Level, state: _State, trust: Float64) -> tuple[Float32, Float32]:
    """N (H, W, 3) of pixels from the cells around them that are of one surface, and 0..1 how much of it is shading's."""
    cells = level.cells
    inside = np.where(cells >= 0, np.append(trust, 0.0)[cells], 0).astype(np.float32)
    total, sums, share = (np.zeros(s, np.float32) for s in (level.v.shape, (*level.v.shape, 3), level.v.shape))
    h, w = level.v.shape
    N = np.moveaxis(state.N, 0, -1)
    for dy in (0, 1):
        for dx in (0, 1):
            to, of = np.s_[dy:h, dx:w], np.s_[: h - dy, : w - dx]
            ok = level.okc[of]
            total[to] += ok
            share[to] += ok * inside[of]
            sums[to] += ok[..., None] * N[of]
    with np.errstate(invalid="ignore", divide="ignore"):
        N = sums / np.linalg.norm(sums, axis=-1, keepdims=True)
        share = np.where(total > 0, share / total, 0).astype(np.float32)
    # Islands inside a shaded surface go with it; what hangs on to torn ground at a depth edge does not.
    near = ndimage.uniform_filter(share, 11, mode="nearest") * np.isfinite(N[..., 0])
    whole = ndimage.uniform_filter(level.okc, 5, mode="nearest")
    t = np.clip((near - f4(0.15)) / f4(0.4), 0, 1) * np.clip((whole - f4(0.4)) / f4(0.3), 0, 1)
    return N, t * t * (3 - 2 * t)


def refine_by_shading(
    plate: npt.ArrayLike,
    Z: npt.ArrayLike,
    camera: Camera,
    *,
    Z_sigma: npt.ArrayLike,
    N: npt.ArrayLike | None = None,
    N_sigma: npt.ArrayLike | None = None,
    confidence: npt.ArrayLike | None = None,
    strength: float = 1.0,
    quality: Quality = "standard",
) -> ShadedSurface:
    """Z and N of a plate on which disparity and shading agree.

    plate      : (H, W, 3) scene-linear, as shot.
    Z          : (H, W) metres, NaN where unknown; Z_sigma (H, W) its standard deviation, metres, as honest as can be: it
                 decides how far shading is believed.  NaN leaves a pixel's depth out.
    N          : (H, W, 3) normals from Z alone, N_sigma (H, W) their own error, degrees; kept where shading says nothing.  None fits them.
    confidence : (H, W) 0..1, 0 leaves a pixel's depth out.
    strength   : 1 weighs shading by its own variance, less than 1 believes it less; 0 returns Z and N as given.
    quality    : "standard" or "fine".
    Raises     : PassError for wrong shapes, types and values.
    """
    p = as_float32(plate, "plate", channels=3, size_hw=camera.size_hw)
    depth = checked_depth(Z, camera)
    if not (math.isfinite(strength) and 0 <= strength <= 4):
        raise PassError(f"shading strength must lie in 0 ... 4, got {strength!r}")
    if quality not in EFFORTS:
        raise PassError(f"shading quality {quality!r} is unknown{nearest_hint(str(quality), tuple(EFFORTS))}")
    if N is None or N_sigma is None:
        fitted, doubt = normals_and_sigma(depth, camera, confidence=confidence)
        N = fitted if N is None else N
        N_sigma = doubt if N_sigma is None else N_sigma
    given = as_float32(N, "N", channels=3, size_hw=camera.size_hw)
    given_sigma = as_float32(N_sigma, "N_sigma", size_hw=camera.size_hw)
    known = np.asarray(np.isfinite(depth) & np.isfinite(ray_slopes(camera)[..., 0]))
    fine = np.asarray(np.isfinite(p).all(axis=-1))
    p = np.where(fine[..., None], p, f4(0))
    told = as_float32(Z_sigma, "Z_sigma", size_hw=camera.size_hw) / np.where(known, depth, f4(1))
    known &= np.isfinite(told)
    sigma = np.where(known, np.maximum(told, f4(LEAST_SIGMA)), f4(1)).astype(np.float32)
    if confidence is not None:
        sure = np.nan_to_num(as_float32(confidence, "confidence", size_hw=camera.size_hw), nan=0.0)
        sigma = (sigma / np.sqrt(np.clip(sure, f4(1e-3), 1))).astype(np.float32)
    sigma[~known] = 1e3
    usable = known & fine & (p.max(axis=-1) < CLIPPED) & (p.mean(axis=-1) > BLACK)
    v = -np.log(np.where(known, depth, f4(1))).astype(np.float32)
    v[~known] = np.median(v[known]) if known.any() else 0
    return _refined(p, depth, given, given_sigma, v, sigma, usable, known, camera, strength, EFFORTS[quality])


def _figures(light: PlateLight, trust: Float64, shares: Float64, gain: Float64, turns: Float64) -> dict[str, Any]:
    size = light.labels.size
    return {
        "shaded_share": float(np.isin(light.labels, np.flatnonzero(trust > 0)).sum() / max(size, 1)),
        "materials": [
            {
                "share": round(float((light.labels == k).sum() / size), 4),
                "explained": round(float(shares[k]), 3),
                "gain": round(float(gain[k]), 2),
                "turns_deg": round(float(turns[k]), 1),
                "trust": round(float(trust[k]), 2),
            }
            for k in range(len(trust))
        ],
    }


def _refined(
    p: Float32,
    depth: Float32,
    given: Float32,
    given_sigma: Float32,
    v: Float32,
    sigma: Float32,
    usable: Bool,
    known: Bool,
    camera: Camera,
    strength: float,
    effort: Effort,
) -> ShadedSurface:
    levels = levels_of(p, v, sigma, given, given_sigma, usable, known, camera)
    judge = next((k for k, level in enumerate(levels) if level.v.shape[1] <= JUDGED_WIDTH), len(levels) - 1)
    lit = _chain(levels, judge, effort, strength=strength, lit=True)
    plain = _chain(levels, judge, effort, strength=strength, lit=False)
    trust, shares, gain, turns = _judged(levels[judge], lit, plain)
    labels = levels[0].labels
    light = replace(lit.light, labels=labels)
    nothing = ShadedSurface(
        Z=depth, N=given, N_sigma=given_sigma, weight=np.zeros(depth.shape, np.float32), light=light, trust=trust, shares=shares,
        figures=_figures(light, trust, shares, gain, turns),
    )  # fmt: skip
    if strength == 0 or not trust.any():
        return nothing
    mixed_in = np.append(trust, 0.0).astype(np.float32)[levels[judge].labels]
    state = replace(lit, v=plain.v + mixed_in * (lit.v - plain.v))
    for k in range(judge - 1, -1, -1):
        start = _started(levels[k], levels[k + 1], state.v)
        finest = k == 0
        state = _solved(
            levels[k], start, rounds=effort.finest_rounds if finest else effort.rounds, steps=effort.finest_steps if finest else effort.steps,
            light=replace(state.light, labels=labels) if finest and k + 1 < len(levels) else None, trust=trust, strength=strength, lit=True,
        )  # fmt: skip
    N, share = _at_pixels(levels[0], state, trust)
    share = np.where(known, share, f4(0))
    mixed = given + share[..., None] * (np.where(share[..., None] > 0, N, 0) - given)
    mixed = np.where(np.isfinite(given[..., :1]), mixed, np.where(share[..., None] > 0, N, np.nan))
    mixed = (mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)).astype(np.float32)
    Z_new = np.where(share > 0, depth * np.exp(share * (v - state.v)), depth).astype(np.float32)
    own = _doubt(levels[0], state, mixed, given, share)
    own = np.where(np.isfinite(given_sigma), given_sigma + share * (own - given_sigma), np.where(share > 0, own, np.nan)).astype(np.float32)
    return replace(nothing, N_sigma=own, Z=Z_new, N=np.ascontiguousarray(mixed), weight=share, light=replace(state.light, labels=labels))
