"""Shadows: which share of a light reaches the surface, by exact rays on its triangles or by a march through its depth.

In: Z and N (H, W, ...) with their camera, and an `Emitter`.  Out: `Shadow`, (H, W) float32: lit 0..1, and beside it the share of the
light that the camera cannot know of.
Frame: scene frame of the camera, metres.

A ray starts off the surface by what the surface itself may be off: along N by so many standard deviations of its depth, and by what
its neighbours stand above the plane of N, which is the grid's own relief.  Exact depth needs next to nothing, noisy depth more, and
no number has to be found by hand.  Every pixel's pattern of samples is its own and never changes, so that soft shadows do not crawl."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.surface.emitters import Emitter, on_disc, spread, towards_light
from stereorelight.surface.mesh import Links, Mesh, beside_nearer, half_steps, links_of, mesh_from_depth, solid, without
from stereorelight.surface.position import checked_depth, position_from_depth

if TYPE_CHECKING:
    from stereorelight.engine.march import Grid

Method = Literal["march", "rays"]
METHODS = ("march", "rays")
SIGMAS = 2.0  # standard deviations of the depth that a ray starts off it by at most, as far as its neighbours are that rough
REACH = 1.0  # tangent of a slope that any surface may have between two looks of the march
BESIDE_PX = 4  # of matched depth: how far beside a nearer thing the ground is not to be trusted
TURNED = 0.35  # least cosine, below 0, of a recovered N to the light at which rays still go out: some 20 degrees, three sigma of a face
LEAST = 2e-5  # of the distance: float32 itself
STEPS = 512
NEAREST = 0.995  # quantile of inverse depth: what stands alone in front of everything does not say how near things come
RAYS_AT_ONCE = 1 << 18
MOST_SAMPLES = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class Shadow:
    """lit : (H, W) float32, the share of the light that arrives, as far as seen; 0 where the surface turns away from it.
    unknown : (H, W) float32, the share that arrives only if nothing stands where no camera saw: outside the frame, or behind something."""

    lit: Float32
    unknown: Float32


@dataclass(frozen=True, kw_only=True, eq=False)
class ShadowScene:
    """A seen surface, ready to cast shadows and to receive them; what is worked out once is kept.

    Z, N        : (H, W), (H, W, 3) on the plate that `camera` describes; NaN where unknown.
    Z_sigma     : (H, W) metres, standard deviation of Z; None for exact depth.
    thickness_m : how far things go on behind what is seen of them; a number or (H, W).
    open        : (H, W) bool: Z is NaN there because nothing is there.
    outside_open : nothing stands outside the frame that could cast a shadow into it.
    Raises      : PassError where no pixel is known, and for arrays that do not fit.
    """

    Z: Float32
    N: Float32
    camera: Camera
    Z_sigma: Float32 | None = None
    thickness_m: float | Float32 = 0.0
    open: Bool | None = None
    outside_open: bool = False

    def __post_init__(self) -> None:
        put = object.__setattr__
        size_hw = self.camera.size_hw
        put(self, "Z", checked_depth(self.Z, self.camera))
        put(self, "N", as_float32(self.N, "N", channels=3, size_hw=size_hw))
        if self.Z_sigma is not None:
            put(self, "Z_sigma", as_float32(self.Z_sigma, "Z_sigma", size_hw=size_hw))
        if not np.isfinite(self.Z).any():
            raise PassError("the surface has no known pixel: Z is NaN everywhere; recover depth first, or check its layer")
        if not float(np.nanmin(self.thickness_m)) >= 0:
            raise PassError(f"thickness must be >= 0 metres, got {float(np.nanmin(self.thickness_m)):g}; 0 is a thin sheet")

    @cached_property
    def P(self) -> Float32:
        return position_from_depth(self.Z, self.camera)

    @cached_property
    def links(self) -> Links:
        return links_of(self.Z, self.camera, Z_sigma=self.Z_sigma)

    @cached_property
    def casts(self) -> Bool:
        """(H, W): the pixels that cast shadows; of a depth that was recovered, those that are no specks, and no ground bent up."""
        known: Bool = np.isfinite(self.Z)
        if self.Z_sigma is None or min(self.Z.shape) < 3:
            return known
        return known & solid(self.links) & ~beside_nearer(self.Z, self.links, within_px=BESIDE_PX)

    @cached_property
    def mesh(self) -> Mesh:
        Z = np.where(self.casts, self.Z, np.float32(np.nan))
        return mesh_from_depth(Z, self.camera, thickness_m=self.thickness_m, links=without(self.links, ~self.casts))

    @cached_property
    def halves(self) -> Float32:
        """(H, W), 1 / metres: half of what inverse depth changes over a pixel, along rows and columns together."""
        sides = half_steps(1 / self.Z.astype(np.float64), self.links)
        found = np.maximum(np.abs(sides[0]), np.abs(sides[1])) + np.maximum(np.abs(sides[2]), np.abs(sides[3]))
        return np.nan_to_num(found).astype(np.float32)

    @cached_property
    def relief(self) -> Float32:
        """(H, W) metres along N: what linked neighbours stand above the plane of N, a pixel's width at most; NaN where there is none."""
        P, N = self.P, self.N
        relief = np.zeros(self.Z.shape, np.float32)
        left, right, up, low = self.links.beside()
        for on, axis, shift in ((left, 1, 1), (right, 1, -1), (up, 0, 1), (low, 0, -1)):
            above = ((np.roll(P, shift, axis=axis) - P) * N).sum(axis=-1)
            relief = np.where(on & (above > relief), above, relief)
        pixel = self.Z / min(self.camera.fx, self.camera.fy)
        found: Float32 = (np.minimum(relief, pixel) + LEAST * self.Z).astype(np.float32)
        return found

    @cached_property
    def doubt(self) -> Float32:
        """(H, W) metres along N, standard deviation of the depth; 0 for exact depth."""
        if self.Z_sigma is None:
            return np.zeros(self.Z.shape, np.float32)
        towards = np.abs((self.P * self.N).sum(axis=-1)) / self.Z  # a metre of Z is so much along N
        found: Float32 = (np.nan_to_num(self.Z_sigma) * towards).astype(np.float32)
        return found

    @cached_property
    def lift(self) -> Float32:
        """(H, W) metres along N that shadow rays start off the surface; NaN where there is none.

        Matching errs by whole places, and smoothly: only as far as neighbours differ can its doubt throw a shadow on itself."""
        from stereorelight.engine.evening import roughness

        if self.Z_sigma is None:
            return self.relief
        rough = roughness(self.P, self.N, min(self.camera.fx, self.camera.fy))
        found: Float32 = (self.relief + SIGMAS * np.minimum(self.doubt, rough)).astype(np.float32)
        return found

    @cached_property
    def clear(self) -> Float32:
        """(H, W) metres along N that rays to all sides start off the surface: many of them graze it, and each bump under one would flicker."""
        found: Float32 = (self.relief + SIGMAS * self.doubt).astype(np.float32)
        return found

    @cached_property
    def turned(self) -> float:
        """The least cosine of N to the light at which the surface is asked for its shadow: below 0 where N may be off.

        N tells how much light a pixel takes, the surface what stops it: a found N that has turned away a degree too early is no shadow."""
        return 0.0 if self.Z_sigma is None else -TURNED

    @cached_property
    def _embree(self) -> Any:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        vertices = np.nan_to_num(self.mesh.vertices, nan=0.0)
        TriangleMesh(scene, np.ascontiguousarray(vertices), np.ascontiguousarray(self.mesh.triangles))
        return scene

    def blocked(self, starts: Float64, ways: Float64, distances: Float64) -> Bool:
        """Whether rays from (n, 3) along unit (n, 3) meet the surface before `distances` (n,)."""
        reach = np.minimum(distances, 1e6).astype(np.float32)
        found: Bool = self._embree.run(starts.astype(np.float32), ways.astype(np.float32), reach, query="OCCLUDED") >= 0
        return found & (reach > 0)

    def first_hits(self, starts: Float64, ways: Float64, distance: float) -> Float32:
        """(n,) float32 metres to what each ray meets first, `distance` where it meets nothing before that."""
        reach = np.full(len(starts), distance, np.float32)
        found: Float32 = self._embree.run(starts.astype(np.float32), ways.astype(np.float32), reach, query="DISTANCE")
        return np.minimum(found, np.float32(distance))

    @cached_property
    def reach(self) -> Float32:
        """(H, W), 1 / metres: the most that inverse depth changes by to a neighbour on the same surface."""
        w = 1 / self.Z
        found = REACH * w / np.float32(min(self.camera.fx, self.camera.fy))
        for on, axis, shift in zip(self.links.beside(), (1, 1, 0, 0), (1, -1, 1, -1)):
            step = np.abs(np.roll(w, shift, axis=axis) - w)
            found = np.where(on & (step > found), step, found)
        return np.nan_to_num(found * np.float32(1.5))

    @cached_property
    def grid(self) -> Grid:
        """The surface as the march reads it: on a pinhole's grid, the plate's own with its lens undone."""
        from stereorelight.engine.march import OPEN, UNSEEN, grid_of

        inverse = np.where(np.isfinite(self.Z), 1 / self.Z, np.float32(UNSEEN)).astype(np.float32)
        if self.open is not None:
            inverse[self.open & ~np.isfinite(self.Z)] = OPEN
        inverse[np.isfinite(self.Z) & ~self.casts] = OPEN
        camera = self.camera
        numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
        seen = inverse[inverse > 0]
        nearest = 0.0 if self.outside_open or not seen.size else float(np.quantile(seen, NEAREST))
        if not camera.distorts:
            return grid_of(inverse, self.reach, numbers, nearest=nearest, thickness_m=self.thickness_m)
        slopes = camera.ray_grid()
        low, high = np.nanmin(slopes, axis=(0, 1)), np.nanmax(slopes, axis=(0, 1))
        fx, fy = camera.fx, camera.fy
        x0, y0 = np.floor(low[0] * fx), np.floor(low[1] * fy)
        w, h = int(np.ceil(high[0] * fx) - x0) + 1, int(np.ceil(high[1] * fy) - y0) + 1
        v, u = np.mgrid[0:h, 0:w]
        rays = np.stack([(u + x0) / fx, (v + y0) / fy, np.ones((h, w))], axis=-1)
        at = np.rint(camera.project(rays))
        inside = (at[..., 0] >= 0) & (at[..., 1] >= 0) & (at[..., 0] < camera.size[0]) & (at[..., 1] < camera.size[1])
        at = np.where(inside[..., None], at, 0).astype(np.int64)
        straight = np.where(inside, inverse[at[..., 1], at[..., 0]], np.float32(UNSEEN)).astype(np.float32)
        reach = np.where(inside, self.reach[at[..., 1], at[..., 0]], np.float32(0)).astype(np.float32)
        thick = self.thickness_m
        if isinstance(thick, np.ndarray):
            thick = np.where(inside, thick[at[..., 1], at[..., 0]], np.float32(0)).astype(np.float32)
        return grid_of(straight, reach, (fx, fy, -float(x0), -float(y0)), nearest=nearest, thickness_m=thick)

    def shadow(
        self,
        emitter: Emitter,
        *,
        method: Method = "rays",
        samples: int = 16,
        bias_m: float = 0.0,
        steps: int = STEPS,
        asked: npt.ArrayLike | None = None,
    ) -> Shadow:
        """The shadow of one light.

        method  : "rays", exact on the triangles; "march", through the depth, faster.
        samples : rays to a light with a size; 4 x 4 neighbours take different ones, and are evened out together.
        bias_m  : metres added to what a ray starts off the surface by; may be negative.
        steps   : of the march, at most; one a pixel is enough.
        asked   : (H, W), 0 where no answer is wanted, such as outside a spot's cone.
        Raises  : ShotError for a setting out of range.
        """
        if method not in METHODS:
            raise ShotError(f"light {emitter.name!r}: shadow {method!r} is unknown{nearest_hint(str(method), METHODS)}")
        if not 1 <= samples <= MOST_SAMPLES:
            raise ShotError(f"light {emitter.name!r}: shadow_samples must lie in 1 ... {MOST_SAMPLES}, got {samples}")
        count = 1 if emitter.is_hard else samples
        where = None if asked is None else np.nan_to_num(as_float32(asked, "asked", size_hw=self.camera.size_hw))
        lift = np.maximum(self.lift + np.float32(bias_m), np.float32(0)) if bias_m else self.lift
        marched = self._marched(emitter, lift, where, count if method == "march" else min(count, 4), steps)
        lit = marched.lit if method == "march" else self._traced(emitter, lift, where, count)
        if count > 1:
            lit, unknown = self.evened(np.stack([lit, marched.unknown]))
        else:
            unknown = marched.unknown
        return Shadow(lit=lit, unknown=unknown if method == "march" else np.minimum(unknown, lit))

    def _marched(self, emitter: Emitter, lift: Float32, asked: Float32 | None, samples: int, steps: int) -> Shadow:
        from stereorelight.engine.march import march

        offsets = pattern(samples, disc=emitter.shape != "rectangle").astype(np.float32)
        if emitter.is_hard:
            offsets[:] = 0
        row = march_row(emitter, turned=self.turned)
        lit, unknown = march(self.P, self.N, lift, self.halves, asked, self.grid, row, offsets, steps=steps)
        return Shadow(lit=lit, unknown=unknown)

    def _traced(self, emitter: Emitter, lift: Float32, asked: Float32 | None, samples: int) -> Float32:
        from stereorelight.engine.march_rays import FAINT

        h, w = self.Z.shape
        lit = np.zeros(h * w, np.float32)
        offsets = spread_pattern(samples)
        N, P = self.N.reshape(-1, 3), self.P.reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            wanted = np.isfinite(P + N).all(axis=-1) & np.isfinite(lift).reshape(-1)
            pixels = np.flatnonzero(wanted if asked is None else wanted & (asked.reshape(-1) > 0))
        kind = kinds((h, w)).reshape(-1)
        axis = np.array(emitter.towards)
        for first in range(0, len(pixels), RAYS_AT_ONCE):
            at = pixels[first : first + RAYS_AT_ONCE]
            n = N[at].astype(np.float64)
            starts = P[at].astype(np.float64) + n * lift.reshape(-1)[at, None]
            shone, total = np.zeros(len(at)), np.zeros(len(at))
            for sample in range(samples):
                ways, distances = towards_light(emitter, starts, offsets[kind[at], sample])
                front = (n * ways).sum(axis=-1)
                weight = np.where(front > self.turned, np.maximum(front, FAINT), 0)
                if emitter.shape == "rectangle":
                    weight *= np.maximum(-(ways @ axis), 0) / np.maximum(distances, 1e-6) ** 2
                facing = weight > 0
                open_ = np.zeros(len(at), bool)
                open_[facing] = ~self.blocked(starts[facing], ways[facing], distances[facing] * (1 - 1e-6))
                shone += weight * open_
                total += weight
            lit[at] = np.divide(shone, total, out=np.zeros_like(shone), where=total > 0)
        return lit.reshape(h, w)

    def evened(self, values: Float32) -> Float32:
        """(C, H, W) with the 4 x 4 kinds of pixel taken together, over neighbours on one surface alone."""
        from stereorelight.engine.evening import evened

        return evened(np.ascontiguousarray(values, dtype=np.float32), self.P, self.N, min(self.camera.fx, self.camera.fy))


def kinds(size_hw: tuple[int, int]) -> npt.NDArray[np.int64]:
    """(H, W) which of the 16 patterns each pixel takes; the same in every frame."""
    h, w = size_hw
    found: npt.NDArray[np.int64] = (np.arange(h)[:, None] & 3) * 4 + (np.arange(w)[None] & 3)
    return found


def spread_pattern(samples: int) -> Float64:
    """(16, samples, 2) in the unit square: every kind of pixel its own even set, and all of them together one even set too."""
    return spread(16 * samples).reshape(16, samples, 2)


def pattern(samples: int, *, disc: bool) -> Float64:
    """`spread_pattern` on the unit disc, or on the square of -1 ... 1."""
    square = spread_pattern(samples)
    for points in square:  # the order of a kind's samples is free: what neighbours look at in one turn lies in one part of the light
        columns = np.array_split(np.argsort(points[:, 0]), round(np.sqrt(samples)))
        points[:] = points[np.concatenate([column[np.argsort(points[column, 1])] for column in columns])]
    return on_disc(square) if disc else 2 * square - 1


def march_row(emitter: Emitter, *, turned: float = 0.0) -> Float32:
    """An emitter as the march reads it.     turned : least cosine of N to it that still gets an answer."""
    from stereorelight.engine import march as engine
    from stereorelight.surface.emitters import across

    row = np.zeros(engine.COLUMNS, np.float64)
    row[engine.TURNED] = turned
    if emitter.shape == "direction":
        towards = np.array(emitter.towards)
        u, v = across(towards)
        size = np.tan(np.radians(emitter.angle_deg) / 2)
        row[engine.PLACE : engine.PLACE + 3] = towards
        row[engine.SIDE_U : engine.SIDE_U + 3], row[engine.SIDE_V : engine.SIDE_V + 3] = u * size, v * size
    else:
        row[engine.PLACE : engine.PLACE + 3], row[engine.IS_PLACE] = emitter.position_m, 1
        row[engine.BALL] = emitter.radius_m
        if emitter.shape == "rectangle":
            row[engine.SIDE_U : engine.SIDE_U + 3], row[engine.SIDE_V : engine.SIDE_V + 3] = emitter.side_u_m, emitter.side_v_m
            row[engine.AXIS : engine.AXIS + 3], row[engine.RECTANGLE] = emitter.towards, 1
    return row.astype(np.float32)
