"""Shading as evidence: normals and a depth on which disparity and the plate's own shading agree.

In: the plate (scene-linear), Z on it with its standard deviation, and the camera.  Out: a `ShadedSurface` on the same plate.
Frames: N in the scene frame.  The unknown is v = -log Z on the pixel grid.

Skin and plain cloth give a matcher little to hold on to, while one degree of turn changes a Lambertian pixel by one to two percent.
Four terms share v, each weighed by its own variance: disparity (robust, one vote for every patch over which its error is one and the
same), relative shading (robust; whatever varies slowly is albedo's or a near light's), second-order smoothness (robust, so creases
stay), and nothing across a depth edge.  Gauss-Newton from coarse to fine, conjugate gradients inside, so that wide shapes are found
where they are cheap and fine detail is never drowned by a noisy start.

Shape or paint?  Grain, patterns and noise raise the variance that shading is given.  What changes chromaticity is paint.  What fits
no shape is left to disparity.  And every material has to pass a test, by normals that shading had no part in; see `surface/shading_trust.py`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, nearest_hint
from stereorelight.surface.normals import normals_and_sigma
from stereorelight.surface.plate_light import PlateLight
from stereorelight.surface.position import checked_depth, ray_slopes
from stereorelight.surface.shading_fit import EFFORTS, Effort, State, chain, solved, started
from stereorelight.surface.shading_levels import Level, around, levels_of
from stereorelight.surface.shading_trust import Judged, ShotMaterials, judged

Quality = Literal["standard", "fine"]
f4 = np.float32

LEAST_SIGMA = 1e-5  # of Z, relative
SIGMA_COEFFICIENTS = (2.753, 0.441, 0.230, -0.523)  # of N_sigma: see `_doubt` and docs/shading.md
PIXELS_PER_M = 880.0  # of a surface, where the first of them alone counts
CLIPPED, BLACK = 0.98, 2e-3
JUDGED_WIDTH = 480  # of the level at which materials are tested against disparity


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


def _doubt(level: Level, state: State, N: Float32, given: Float32, share: Float32) -> Float32:
    """(H, W) degrees within which two thirds of the normals made by shading lie, as 14 faces, shirts and statues with known normals have it.

    It grows with what shading does not explain nearby and with how far normals were moved, and falls with the pixels that a metre of
    the surface has: the same feature has more of them.
    """
    k = level.v.shape[1] / 960
    inside = (share > 0).astype(np.float32)
    with np.errstate(invalid="ignore"):
        moved = np.degrees(np.arccos(np.clip((N * given).sum(axis=-1), -1, 1)))
    doubted = np.log(around(1 - state.weight, inside, 4 * k) + f4(0.05))
    pushed = np.log(around(np.nan_to_num(moved, nan=0.0).astype(np.float32), inside, 4 * k) + f4(0.5))
    c = SIGMA_COEFFICIENTS
    sigma: Float32 = np.exp(c[0] + c[1] * doubted + c[2] * pushed + c[3] * (state.v + math.log(level.focal / PIXELS_PER_M))).astype(np.float32)
    return np.clip(sigma, 0.5, 90)


def _at_pixels(level: Level, state: State, trust: Float64) -> tuple[Float32, Float32]:
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
    return N, t * t * (3 - 2 * t) * level.clear


@dataclass(frozen=True, kw_only=True, eq=False)
class _Given:
    """Checked input of the fit: the plate, Z, normals and their sigma (degrees), and levels of all of them."""

    plate: Float32
    Z: Float32
    N: Float32
    N_sigma: Float32
    v: Float32
    known: Bool
    levels: list[Level]

    @property
    def judge(self) -> int:
        """The level at which materials are tested."""
        return next((k for k, level in enumerate(self.levels) if level.v.shape[1] <= JUDGED_WIDTH), len(self.levels) - 1)


def _given(
    plate: npt.ArrayLike,
    Z: npt.ArrayLike,
    camera: Camera,
    Z_sigma: npt.ArrayLike,
    N: npt.ArrayLike | None,
    N_sigma: npt.ArrayLike | None,
    confidence: npt.ArrayLike | None,
    colours: Float64 | None,
) -> _Given:
    p = as_float32(plate, "plate", channels=3, size_hw=camera.size_hw)
    depth = checked_depth(Z, camera)
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
    levels = levels_of(p, v, sigma, given, given_sigma, usable, known, camera, colours)
    return _Given(plate=p, Z=depth, N=given, N_sigma=given_sigma, v=v, known=known, levels=levels)


def _tested(given: _Given, effort: Effort, strength: float) -> tuple[State, State, Judged]:
    """The level at which materials are judged, solved with shading and without, and what is found."""
    lit = chain(given.levels, given.judge, effort, strength=strength, lit=True)
    plain = chain(given.levels, given.judge, effort, strength=strength, lit=False)
    return lit, plain, judged(given.levels[given.judge], lit, plain)


def judge_by_shading(
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
) -> Judged:
    """What one frame of a shot says of its materials, to be `pooled`; in and raised as `refine_by_shading`, at a third of its time."""
    _check(strength, quality)
    return _tested(_given(plate, Z, camera, Z_sigma, N, N_sigma, confidence, None), EFFORTS[quality], strength)[2]


def _check(strength: float, quality: str) -> None:
    if not (math.isfinite(strength) and 0 <= strength <= 4):
        raise PassError(f"shading strength must lie in 0 ... 4, got {strength!r}")
    if quality not in EFFORTS:
        raise PassError(f"shading quality {quality!r} is unknown{nearest_hint(str(quality), tuple(EFFORTS))}")


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
    materials: ShotMaterials | None = None,
) -> ShadedSurface:
    """Z and N of a plate on which disparity and shading agree.

    plate      : (H, W, 3) scene-linear, as shot.
    Z          : (H, W) metres, NaN where unknown; Z_sigma (H, W) its standard deviation, metres, as honest as can be: it
                 decides how far shading is believed.  NaN leaves a pixel's depth out.
    N          : (H, W, 3) normals from Z alone, N_sigma (H, W) their own error, degrees; kept where shading says nothing.  None fits them.
    confidence : (H, W) 0..1, 0 leaves a pixel's depth out.
    strength   : 1 weighs shading by its own variance, less than 1 believes it less; 0 returns Z and N as given.
    quality    : "standard" or "fine".
    materials  : of the whole shot, `pooled`, so that every frame trusts them alike; None judges them by this frame alone.
    Raises     : PassError for wrong shapes, types and values.
    """
    _check(strength, quality)
    given = _given(plate, Z, camera, Z_sigma, N, N_sigma, confidence, None if materials is None else materials.colours)
    return _refined(given, strength, EFFORTS[quality], materials)


def _figures(light: PlateLight, found: Judged, trust: Float64) -> dict[str, Any]:
    return {
        "shaded_share": float(found.size[trust > 0].sum()),
        "materials": [
            {
                "share": round(float(found.size[k]), 4),
                "explained": round(float(found.share[k]), 3),
                "gain": round(float(found.gain[k]), 2),
                "turns_deg": round(float(found.turns[k]), 1),
                "trust": round(float(trust[k]), 2),
            }
            for k in range(len(trust))
        ],
    }


def _refined(given: _Given, strength: float, effort: Effort, materials: ShotMaterials | None) -> ShadedSurface:
    levels, judge = given.levels, given.judge
    lit, plain, found = _tested(given, effort, strength)
    trust = found.trust if materials is None else found.trust_by(materials)
    labels = levels[0].labels
    light = replace(lit.light, labels=labels)
    nothing = ShadedSurface(
        Z=given.Z, N=given.N, N_sigma=given.N_sigma, weight=np.zeros(given.Z.shape, np.float32), light=light, trust=trust, shares=found.share,
        figures=_figures(light, found, trust),
    )  # fmt: skip
    if strength == 0 or not trust.any():
        return nothing
    mixed_in = np.append(trust, 0.0).astype(np.float32)[levels[judge].labels]
    state = replace(lit, v=plain.v + mixed_in * (lit.v - plain.v))
    for k in range(judge - 1, -1, -1):
        start = started(levels[k], levels[k + 1], state.v)
        finest = k == 0
        state = solved(
            levels[k], start, rounds=effort.finest_rounds if finest else effort.rounds, steps=effort.finest_steps if finest else effort.steps,
            light=replace(state.light, labels=labels) if finest and k + 1 < len(levels) else None, trust=trust, strength=strength, lit=True,
        )  # fmt: skip
    N, share = _at_pixels(levels[0], state, trust)
    share = np.where(given.known, share, f4(0))
    blend = given.N + share[..., None] * (np.where(share[..., None] > 0, N, 0) - given.N)
    blend = np.where(np.isfinite(given.N[..., :1]), blend, N)
    mixed: Float32 = np.where(share[..., None] > 0, blend / np.linalg.norm(blend, axis=-1, keepdims=True), given.N).astype(np.float32)
    Z_new = np.where(share > 0, given.Z * np.exp(share * (given.v - state.v)), given.Z).astype(np.float32)
    own = _doubt(levels[0], state, mixed, given.N, share)
    own = np.where(np.isfinite(given.N_sigma), given.N_sigma + share * (own - given.N_sigma), np.where(share > 0, own, np.nan)).astype(np.float32)
    return replace(nothing, N_sigma=own, Z=Z_new, N=np.ascontiguousarray(mixed), weight=share, light=replace(state.light, labels=labels))
