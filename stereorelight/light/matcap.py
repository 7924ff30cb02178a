"""Light that is painted, not measured: a lit sphere looked up along N, a toon ramp, an outline.

In: N, P (H, W, 3) in the scene frame of the camera, a picture of a painted sphere, or shading (H, W) or (H, W, 3).
Out: (H, W, 3) float32, linear; exactly 0 where N (or P, where it has a part) is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.errors import PassError, ShotError
from stereorelight.light.environment_maps import sampled

STRIPE = 64  # rows that are worked at a time


def _units(N: npt.ArrayLike) -> Float32:
    n = as_float32(N, "N", channels=3)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        length = np.sqrt((n * n).sum(axis=-1, keepdims=True))
        good = (length > 0.7) & (length < 1.4)
        return np.where(good, n / np.where(good, length, 1), np.float32(np.nan))


def _seen(P: npt.ArrayLike, size_hw: tuple[int, int]) -> Float32:
    """V = normalize(-P), NaN where P is missing."""
    p = as_float32(P, "P", channels=3, size_hw=size_hw)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        length = np.sqrt((p * p).sum(axis=-1, keepdims=True))
        return np.where(np.isfinite(length) & (length > 0), -p / length, np.float32(np.nan))


def lit_sphere(
    N: npt.ArrayLike,
    sphere: npt.ArrayLike,
    *,
    P: npt.ArrayLike | None = None,
    facing: Literal["camera", "ray"] = "camera",
    albedo: npt.ArrayLike | None = None,
) -> Float32:
    """(H, W, 3): every surface takes the colour that the painted sphere has where it faces the same way (the paper's section 6).

    sphere  : (h, w, 3) linear; the sphere touches the picture's four edges.  Its middle faces the eye, its top is up.
    facing  : "camera", as the paper has it: the sphere's middle is N = +z, the camera's axis.  "ray": the middle is N towards the eye,
              wherever in the frame, so that the rim falls on silhouettes in wide shots, too; wants P.
    albedo  : (H, W, 3) to multiply with, or None.
    Raises  : PassError for arrays that do not fit.
    """
    n = _units(N)
    size_hw = (n.shape[0], n.shape[1])
    painted = as_float32(sphere, "sphere", channels=3)
    if not np.isfinite(painted).all():
        raise PassError("sphere holds NaN or infinity; paint its corners")
    if facing not in ("camera", "ray"):
        raise ShotError(f"facing {facing!r} is unknown; known: camera, ray")
    x, y = n[..., 0], n[..., 1]
    if facing == "ray":
        if P is None:
            raise PassError("facing 'ray' needs P; give P=, or facing = \"camera\"")
        v = _seen(P, size_hw)
        # Right and up as the eye's ray sees them: the camera's turned the shortest way that takes its axis to V.
        k = (n[..., 0] * v[..., 0] + n[..., 1] * v[..., 1]) / (1 + np.maximum(v[..., 2], -0.999))
        x, y = x - v[..., 0] * (n[..., 2] + k), y - v[..., 1] * (n[..., 2] + k)
        depth = (n * v).sum(axis=-1)
    else:
        depth = n[..., 2]
    out = np.zeros((*size_hw, 3), np.float32)
    half_w, half_h = painted.shape[1] / 2, painted.shape[0] / 2
    for first in range(0, size_hw[0], STRIPE):
        rows = slice(first, first + STRIPE)
        a, b = x[rows].astype(np.float64), y[rows].astype(np.float64)
        # What looks away from the eye is taken from the rim.
        far = np.maximum(np.where(depth[rows] < 0, 1, np.hypot(a, b)), 1e-12)
        stretch = np.where(depth[rows] < 0, 1 / np.maximum(np.hypot(a, b), 1e-12), np.minimum(1, 1 / far))
        known = np.isfinite(a) & np.isfinite(b)
        a, b = np.where(known, a * stretch, 0), np.where(known, b * stretch, 0)
        found = sampled(painted, np.stack([(1 + a) * half_w - 0.5, (1 - b) * half_h - 0.5], axis=-1))
        out[rows] = np.where(known[..., None], found, 0)
    if albedo is not None:
        colour = as_float32(albedo, "albedo", channels=3, size_hw=size_hw)
        out *= np.where(np.isfinite(colour), colour, 0)
    return out


def toon(
    shading: npt.ArrayLike,
    *,
    steps: Sequence[float] = (0.08, 0.35, 0.75),
    colours: Sequence[Sequence[float] | float] = (0.08, 0.35, 0.7, 1.0),
    softness: float = 0.04,
    albedo: npt.ArrayLike | None = None,
) -> Float32:
    """(H, W, 3): shading cut into flat tones.

    shading  : (H, W), or (H, W, 3), of which the mean of the channels counts: such as a diffuse layer divided by its albedo.
    steps    : rising levels at which the tone changes.
    colours  : one more than steps, numbers or linear RGB, from the darkest.
    softness : width of a step, over which a smoothstep goes from tone to tone; 0 is hard.
    Missing shading gives 0.  Raises ShotError for a ramp that is none.
    """
    levels: Float64 = np.asarray(steps, dtype=np.float64)
    tones = np.array([np.broadcast_to(np.asarray(c, dtype=np.float64), 3) for c in colours])
    if levels.ndim != 1 or len(tones) != len(levels) + 1 or (np.diff(levels) <= 0).any() or not np.isfinite(levels).all():
        raise ShotError(f"a toon ramp needs rising steps and one colour more, got {len(levels)} steps {list(steps)} and {len(tones)} colours")
    if not (np.isfinite(tones).all() and (tones >= 0).all()) or not 0 <= softness < 1e6:
        raise ShotError("a toon ramp's colours and softness must be finite and at least 0")
    given = np.asarray(shading)
    light = as_float32(given, "shading", channels=3 if given.ndim == 3 else None)
    grey = light.mean(axis=-1) if light.ndim == 3 else light
    out = np.empty((*grey.shape, 3), np.float32)
    out[:] = tones[0]
    for at, before, after in zip(levels, tones[:-1], tones[1:]):
        with np.errstate(invalid="ignore"):
            t = np.clip((grey - at) / softness + 0.5, 0, 1) if softness > 0 else (grey >= at).astype(np.float64)
        out += ((t * t * (3 - 2 * t))[..., None] * (after - before)).astype(np.float32)
    out[~np.isfinite(grey)] = 0
    if albedo is not None:
        colour = as_float32(albedo, "albedo", channels=3, size_hw=(grey.shape[0], grey.shape[1]))
        out *= np.where(np.isfinite(colour), colour, 0)
    return out


def outline(P: npt.ArrayLike, N: npt.ArrayLike, *, width: float = 0.25, softness: float = 0.1, jump: float = 0.0) -> Float32:
    """(H, W) in 0..1: where a drawn edge goes; 0 where unknown.

    width : 1 where the surface turns away from the eye, N.V < width.     softness : of that edge, as much N.V.
    jump  : above 0 also 1 on the nearer side of a jump in depth, in a line of two pixels: where a neighbour's distance is larger by this
            share than the surface's own slant says, or nothing is known behind an edge.
    """
    n = _units(N)
    size_hw = (n.shape[0], n.shape[1])
    v = _seen(P, size_hw)
    nv = (n * v).sum(axis=-1)
    t = np.clip((width - nv) / max(softness, 1e-6) + 0.5, 0, 1)
    line = t * t * (3 - 2 * t)
    if jump > 0:
        line = np.maximum(line, _jumps(as_float32(P, "P", channels=3), n, jump))
    return np.where(np.isfinite(nv), line, 0).astype(np.float32)


def _jumps(P: Float32, n: Float32, jump: float) -> Float32:
    """1 where a pixel's own plane, carried on to a neighbour one or two pixels away, lies before what is there by the share `jump`."""
    found = np.zeros(P.shape[:2], np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (P * n).sum(axis=-1)
        for step in (1, 2):
            for axis, way in ((0, step), (0, -step), (1, step), (1, -step)):
                there = np.roll(P, -way, axis=axis)
                edge = [slice(None), slice(None)]
                edge[axis] = slice(-way, None) if way > 0 else slice(None, -way)
                there[tuple(edge)] = P[tuple(edge)]  # nothing jumps over the frame's edge
                # How far along the neighbour's ray the plane is met; 1 where it goes through the neighbour itself.
                share = along / (there * n).sum(axis=-1)
                t = np.clip((1 / share - 1) / jump - 0.5, 0, 1)
                hit = np.where((share > 0) & (share < 1), t * t * (3 - 2 * t), 0)
                found = np.maximum(found, hit * (1.0 if step == 1 else 0.6)).astype(np.float32)
    return found
