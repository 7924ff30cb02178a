"""The truth of a relit picture: what further lights add to one eye's plate, exactly, averaged over the pixel as the plate is.

In: a `Scene`, a `Rig`, lights that need not be the scene's own.  Out: each light's layer with and without its ray-traced shadow, and the
albedo, on that eye's (flipped-back, distorted) picture.  Units and frames as in synth/render.py: the lights stand in world."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.camera import Eye, Rig
from stereorelight.errors import ShotError
from stereorelight.synth.hits import cast, share_lit, shone
from stereorelight.synth.lights import Light
from stereorelight.synth.render import world_from_eye
from stereorelight.synth.scene import Scene

PLACES = 8  # of an area light that each ray of a pixel looks at; every ray looks at others


@dataclass(frozen=True, kw_only=True, eq=False)
class LightTruth:
    """What one light adds: open (H, W, 3) without its shadow, lit (H, W, 3) with it, share (H, W) of it that arrives, 0..1."""

    open: Float32
    lit: Float32
    share: Float32


@dataclass(frozen=True, kw_only=True, eq=False)
class RelightTruth:
    """albedo (H, W, 3), averaged over the pixel; lights by name; NaN and 0 where nothing was asked."""

    albedo: Float32
    lights: dict[str, LightTruth]


def relight_truth(
    scene: Scene, rig: Rig, lights: Sequence[Light], *, eye: Eye = "left", samples: int = 3, where: Bool | None = None, places: int = PLACES
) -> RelightTruth:
    """What each of `lights` adds to the plate of `eye`.

    samples : rays a pixel along each side.   where : (H, W) bool, the pixels that are asked; all when None.
    places  : of an area light, by ray; every ray, and each of 4 x 4 neighbours, looks at others, so that what a few places miss is noise
              that a blur evens out, and no lean that it keeps.
    Raises  : ShotError for samples out of range, and two lights of one name.
    """
    if samples < 1 or samples > 16:
        raise ShotError(f"samples must lie in 1..16, got {samples}")
    names = [light.name for light in lights]
    if len(set(names)) < len(names):
        raise ShotError(f"two lights share a name: {', '.join(sorted(names))}; names make layers")
    camera, pose, tables = rig.camera(eye), world_from_eye(rig, eye), scene.tables()
    asked = np.ones(camera.size_hw, np.bool_) if where is None else where
    grid = camera.pixel_grid()[asked]
    albedo = np.zeros((len(grid), 3))
    sums: dict[str, tuple[Float64, Float64]] = {name: (np.zeros((len(grid), 3)), np.zeros((len(grid), 3))) for name in names}
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    kinds_of = (grid[:, 1].astype(np.int64) & 3) * 4 + (grid[:, 0].astype(np.int64) & 3)
    kinds: list[npt.NDArray[np.int64]] = [np.flatnonzero(kinds_of == k) for k in range(16)]
    together = [np.arange(len(grid))]
    for turn, (dv, du) in enumerate(itertools.product(steps, steps)):
        hits = cast(tables, camera, pose, grid + (du, dv))
        albedo += np.nan_to_num(hits.albedo) / samples**2
        for light in lights:
            for kind, at in enumerate(kinds if light.type == "area" else together):
                diffuse, shine, lit_diffuse, lit_shine = shone(tables, hits.of(at), light, places=places, turn=kind * samples**2 + turn)
                sums[light.name][0][at] += (diffuse + shine) / samples**2
                sums[light.name][1][at] += (lit_diffuse + lit_shine) / samples**2

    def laid_out(values: Float64, nothing: float = 0.0) -> Float32:
        out = np.full((*asked.shape, *values.shape[1:]), nothing, np.float32)
        out[asked] = values
        return out

    told = {name: LightTruth(open=laid_out(open_), lit=laid_out(lit), share=laid_out(share_lit(open_, lit))) for name, (open_, lit) in sums.items()}
    return RelightTruth(albedo=laid_out(albedo, float("nan")), lights=told)
