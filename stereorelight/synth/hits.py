"""What rays meet in a scene, and what its lights do there; of one eye's pixels, or of anything else.

In: rays, as pixels of a camera at a pose, and a scene's tables.  Out: points, normals and materials in world coordinates, metres, and the
light on them with and without its ray-traced shadow, (n, 3) linear."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.camera import Camera
from stereorelight.engine import raycast
from stereorelight.synth.lights import Light, shade
from stereorelight.synth.scene import Tables

FLIP = np.diag([1.0, -1.0, -1.0])  # camera frame <-> scene frame
SELF_M = 2e-6  # a ray that ends on a surface must not find that surface; hits are exact to 1e-11 m


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """What a set of rays met, in world coordinates; rows of rays that met nothing are NaN, with object -1."""

    t: Float64
    object: npt.NDArray[np.int64]
    points: Float64
    normals: Float64
    albedo: Float64
    specular: Float64
    views: Float64

    def of(self, at: npt.NDArray[np.int64]) -> Hits:
        """Some of them."""
        return Hits(**{f.name: getattr(self, f.name)[at] for f in fields(self)})


def cast(tables: Tables, camera: Camera, pose: Float64, pixels: Float64) -> Hits:
    directions = camera.rays(pixels.reshape(-1, 2)) @ (pose[:3, :3] @ FLIP).T
    origin = pose[None, :3, 3]
    t, hit = raycast.first_hits(tables.objects, tables.primitives, origin, directions, empty=tables.empty)
    points = origin + t[:, None] * directions
    normals, albedo, specular = raycast.surface_at(tables.objects, tables.primitives, tables.materials, points, hit)
    views = -directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return Hits(t=t, object=hit, points=points, normals=normals, albedo=albedo, specular=specular, views=views)


def blocked(tables: Tables, starts: Float64, points: Float64, asked: Bool) -> Bool:
    """Whether something stands between `starts` (1 or n, 3) and each of `points`; False where not `asked`."""
    along = points - starts
    with np.errstate(invalid="ignore"):
        limits = np.where(asked, 1.0 - SELF_M / np.linalg.norm(along, axis=-1), 0.0)
    return raycast.blocked(tables.objects, tables.primitives, starts, along, limits, empty=tables.empty)


def shone(
    tables: Tables, hits: Hits, light: Light, *, shadows: bool = True, places: int = 1, turn: int = 0
) -> tuple[Float64, Float64, Float64, Float64]:
    """One light on what rays met: diffuse and specular (n, 3) without its shadow, and both again with it.

    places : from how many places an area light shines; `turn` picks others of them.
    """
    met = (hits.object >= 0)[:, None]
    total = [np.zeros_like(hits.points) for _ in range(4)]
    spread = light.places(places, turn=turn)
    for place in spread:
        one = light.at(place)
        layers = [np.where(met, a, 0.0) for a in shade(one, hits.points, hits.normals, hits.views, hits.albedo, hits.specular)]
        lit = layers
        if shadows:
            asked = (layers[0] + layers[1]).sum(axis=-1) > 0
            arrives = (asked & ~blocked(tables, one.ray_starts(hits.points), hits.points, asked))[:, None]
            lit = [layer * arrives for layer in layers]
        for sum_, layer in zip(total, (*layers, *lit)):
            sum_ += layer / len(spread)
    return total[0], total[1], total[2], total[3]


def share_lit(open_: Float64, lit: Float64) -> Float64:
    """(n,) the share 0..1 of a light that arrives, from what it is without and with its shadow (n, 3); 0 where there is no light."""
    whole = open_.sum(axis=-1)
    return np.divide(lit.sum(axis=-1), whole, out=np.zeros_like(whole), where=whole > 0)
