"""Light that surfaces send each other: two bounces, gathered by rays.

In: points with normals and what the scene is lit by.  Out: (n, 3) what a white card there reads of light that comes from no light directly.
A ray that meets nothing brings the scene's flat ambient light; one that meets a surface brings what that sends on of the lights, with their
shadows, and of what itself gathers by one ray more, at whose end the ambient light stands for all that is left.  Surfaces pass light on as
matte ones do; highlights do not.  Rays are spread by the cosine; those of neighbouring pixels make one even set, and never change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.engine import raycast
from stereorelight.synth.hits import Hits, shone
from stereorelight.synth.lights import GOLDEN, Light
from stereorelight.synth.scene import Tables, Vector

BOUNCES = 2
OFF_M = 1e-5  # along the normal: a ray must not find the surface that it leaves
EVEN_PX = 4  # neighbours so far off on one surface are taken together: this light changes slowly
TILE_PX = 2 * EVEN_PX + 1  # side of the square of pixels whose rays make one even set, so that evening out hardly leaves grain
ONE_SURFACE_COS, ONE_SURFACE_Z = 0.97, 0.02


def gathered(
    tables: Tables,
    points: Float64,
    normals: Float64,
    lights: Sequence[Light],
    ambient: Vector,
    rays: int,
    *,
    order: npt.NDArray[np.int64] | None = None,
    seed: int = 0,
    bounces: int = BOUNCES,
) -> Float64:
    """(n, 3) of indirect light at `points` (n, 3) with unit `normals`; 0 where they are NaN.

    order : (n,) which part of one even set of rays each point takes (`tiled`); by chance where None.
    """
    met = np.isfinite(points).all(axis=-1) & np.isfinite(normals).all(axis=-1)
    out = np.zeros(points.shape)
    P, N = points[met] + OFF_M * normals[met], normals[met]
    if not len(P):
        return out
    if order is None:
        own = np.random.Generator(np.random.Philox(key=[seed, bounces])).random((len(points), 2))[met]
    else:
        own = 0.5 + rays * order[met][:, None] * np.array(GOLDEN)
    total = np.zeros(P.shape)
    u, v = _across(N)
    for k in range(rays):
        square = (own + (k + 1) * np.array(GOLDEN)) % 1.0
        radius, angle = np.sqrt(square[:, :1]), 2 * np.pi * square[:, 1:]
        ways = radius * np.cos(angle) * u + radius * np.sin(angle) * v + np.sqrt(1 - radius**2) * N
        t, hit = raycast.first_hits(tables.objects, tables.primitives, P, ways, empty=tables.empty)
        at = P + t[:, None] * ways
        normal, albedo, specular = raycast.surface_at(tables.objects, tables.primitives, tables.materials, at, hit)
        hits = Hits(t=t, object=hit, points=at, normals=normal, albedo=albedo, specular=np.zeros_like(specular), views=-ways)
        sent = np.where((hit >= 0)[:, None], 0.0, np.array(ambient))
        for light in lights:
            sent = sent + shone(tables, hits, light, turn=k)[2]
        if bounces > 1:
            further = gathered(tables, at, normal, lights, ambient, 1, seed=seed + 1 + k, bounces=bounces - 1)
        else:
            further = np.broadcast_to(np.array(ambient), at.shape)
        total += sent + np.where((hit >= 0)[:, None], np.nan_to_num(albedo) * further, 0.0)
    out[met] = total / rays
    return out


def tiled(size_hw: tuple[int, int]) -> npt.NDArray[np.int64]:
    """(H * W,) the number of each pixel in its tile."""
    y, x = np.mgrid[: size_hw[0], : size_hw[1]] % TILE_PX
    return (y * TILE_PX + x).astype(np.int64).ravel()


def _across(N: Float64) -> tuple[Float64, Float64]:
    """Two unit vectors (n, 3) at right angles to N and to each other (Duff et al. 2017)."""
    x, y, z = N[:, 0], N[:, 1], N[:, 2]
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1), np.stack([b, sign + y * y * a, -y], axis=-1)


def evened(light: Float64, objects: npt.NDArray[np.int64], normals: Float64, Z: Float64, *, reach_px: int = EVEN_PX) -> Float64:
    """(H, W, 3) light averaged over the neighbours of one object that face the same way and lie as deep."""
    h, w = objects.shape
    pad = [(reach_px, reach_px), (reach_px, reach_px)]
    wide = np.pad(light, [*pad, (0, 0)]), np.pad(objects, pad, constant_values=-2), np.pad(normals, [*pad, (0, 0)]), np.pad(Z, pad)
    total, weight = np.zeros_like(light), np.zeros((h, w))
    for j in range(2 * reach_px + 1):
        for i in range(2 * reach_px + 1):
            L, o, n, z = (a[j : j + h, i : i + w] for a in wide)
            with np.errstate(invalid="ignore"):
                one = (o == objects) & ((n * normals).sum(axis=-1) > ONE_SURFACE_COS) & (np.abs(z - Z) < ONE_SURFACE_Z * Z)
            total += np.where(one[..., None], L, 0)
            weight += one
    return np.where(weight[..., None] > 0, total / np.maximum(weight, 1)[..., None], light)
