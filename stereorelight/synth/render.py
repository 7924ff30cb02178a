"""A stereo pair with exact answers: ray-cast plates, and the truth at every pixel centre.

In: a `Scene` and a `Rig`.  Out: a `Shot`: for each eye a `Frame` on that eye's (flipped-back, distorted) picture.
Frames: P and N in the scene frame of each eye's own camera (x right, y up, looks down -z); lights and objects in world,
which is the scene frame of the left camera unless that camera carries a pose.  Metres; pixels as everywhere.
Truth is point-sampled at pixel centres and never anti-aliased; the plate is averaged over `samples` x `samples` rays a
pixel, as a sensor does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.camera import Camera, Eye, Rig
from stereorelight.engine import raycast
from stereorelight.errors import ShotError
from stereorelight.passes import Flag, Frame
from stereorelight.synth.lights import Light, shade
from stereorelight.synth.rigs import is_rectified, rectified_rig
from stereorelight.synth.scene import Scene, Tables

FLIP = np.diag([1.0, -1.0, -1.0])  # camera frame <-> scene frame
AREA_RAYS = 16  # places of an area light that each ray of a plate looks at
SELF_M = 2e-6  # a ray that ends on a surface must not find that surface; hits are exact to 1e-11 m


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """One frame of a synthetic shot.

    left, right : plate, Z, P, N, albedo, flags, and for each light `light_<name>_diffuse`, `light_<name>_specular`
                  (without shadow) and `matte_lit_<name>` (0 in its shadow); left also `disparity` on a rectified rig.
                  Flags: OUT_OF_VIEW, OCCLUDED: what the other eye cannot see; TOO_FAR: no surface at all.
    objects     : which object stands at each pixel centre, by eye: (H, W) int16 into `object_names`, -1 for none.
    """

    scene: str
    rig: Rig
    lights: tuple[Light, ...]
    ambient: tuple[float, float, float]
    left: Frame
    right: Frame
    objects: dict[Eye, npt.NDArray[np.int16]]
    object_names: tuple[str, ...]

    def frame(self, eye: Eye) -> Frame:
        return self.left if eye == "left" else self.right

    def recorded_plate(self, eye: Eye) -> Float32:
        """The plate as the raw camera records it: flipped left-right for the mirrored eye.  This is what goes to a file.

        Everything else in the frame, its plate too, lies on the flipped-back picture, which the rig's camera describes.
        """
        plate: Float32 = self.frame(eye)["plate"]
        return np.ascontiguousarray(plate[:, ::-1]) if self.rig.mirrored == eye else plate


def world_from_eye(rig: Rig, eye: Eye) -> Float64:
    """(4, 4) world from the scene frame of one eye's camera."""
    pose = np.array(rig.left.world_from_camera)
    if eye == "right":
        right = np.eye(4)
        right[:3, :3] = FLIP @ rig.R_right_left.T @ FLIP
        right[:3, 3] = FLIP @ rig.right_centre_m
        pose = pose @ right
    return pose


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


def cast(tables: Tables, camera: Camera, pose: Float64, pixels: Float64) -> Hits:
    directions = camera.rays(pixels.reshape(-1, 2)) @ (pose[:3, :3] @ FLIP).T
    origin = pose[None, :3, 3]
    t, hit = raycast.first_hits(tables.objects, tables.primitives, origin, directions, empty=tables.empty)
    points = origin + t[:, None] * directions
    normals, albedo, specular = raycast.surface_at(tables.objects, tables.primitives, tables.materials, points, hit)
    views = -directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return Hits(t=t, object=hit, points=points, normals=normals, albedo=albedo, specular=specular, views=views)


def _blocked(tables: Tables, starts: Float64, points: Float64, asked: Bool) -> Bool:
    """Whether something stands between `starts` (1 or n, 3) and each of `points`; False where not `asked`."""
    along = points - starts
    with np.errstate(invalid="ignore"):
        limits = np.where(asked, 1.0 - SELF_M / np.linalg.norm(along, axis=-1), 0.0)
    return raycast.blocked(tables.objects, tables.primitives, starts, along, limits, empty=tables.empty)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Lit:
    picture: Float64
    layers: dict[str, Float64]


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
            arrives = (asked & ~_blocked(tables, one.ray_starts(hits.points), hits.points, asked))[:, None]
            lit = [layer * arrives for layer in layers]
        for sum_, layer in zip(total, (*layers, *lit)):
            sum_ += layer / len(spread)
    return total[0], total[1], total[2], total[3]


def share_lit(open_: Float64, lit: Float64) -> Float64:
    """(n,) the share 0..1 of a light that arrives, from what it is without and with its shadow (n, 3); 0 where there is no light."""
    whole = open_.sum(axis=-1)
    return np.divide(lit.sum(axis=-1), whole, out=np.zeros_like(whole), where=whole > 0)


def _light(tables: Tables, hits: Hits, lights: Sequence[Light], ambient: tuple[float, float, float], shadows: bool, turn: int = 0) -> _Lit:
    """The picture (n, 3), and each light's diffuse, specular and share of light that arrives."""
    met = hits.object >= 0
    picture = np.where(met[:, None], hits.albedo * ambient, 0.0)
    layers: dict[str, Float64] = {}
    for light in lights:
        diffuse, shine, lit_diffuse, lit_shine = shone(tables, hits, light, shadows=shadows, places=AREA_RAYS, turn=turn)
        picture = picture + lit_diffuse + lit_shine
        layers |= {f"light_{light.name}_diffuse": diffuse, f"light_{light.name}_specular": shine}
        layers[f"matte_lit_{light.name}"] = share_lit(diffuse + shine, lit_diffuse + lit_shine) if shadows else met.astype(np.float64)
    return _Lit(picture=picture, layers=layers)


def _unseen(tables: Tables, hits: Hits, camera: Camera, pose: Float64) -> npt.NDArray[np.uint16]:
    """Flags (n,): why the eye `camera` at `pose` cannot see each point."""
    met = hits.object >= 0
    seen = camera.project((hits.points - pose[:3, 3]) @ pose[:3, :3] @ FLIP)
    w, h = camera.size
    with np.errstate(invalid="ignore"):
        inside = (np.abs(seen[:, 0] - (w - 1) / 2) <= w / 2) & (np.abs(seen[:, 1] - (h - 1) / 2) <= h / 2)
    hidden = _blocked(tables, pose[None, :3, 3], hits.points, met)
    flags = np.where(met & ~inside, np.uint16(Flag.OUT_OF_VIEW), np.uint16(0)) | np.where(hidden, np.uint16(Flag.OCCLUDED), np.uint16(0))
    return np.where(met, flags, np.uint16(Flag.TOO_FAR)).astype(np.uint16)


def _render_eye(
    tables: Tables, rig: Rig, eye: Eye, lights: Sequence[Light], ambient: tuple[float, float, float], samples: int, shadows: bool
) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.int16]]:
    camera, pose = rig.camera(eye), world_from_eye(rig, eye)
    other: Eye = "right" if eye == "left" else "left"
    h, w = camera.size_hw
    grid = camera.pixel_grid()
    hits = cast(tables, camera, pose, grid)
    truth = _light(tables, hits, lights, ambient, shadows)
    picture = truth.picture
    if samples > 1:
        picture = np.zeros_like(picture)
        steps = (np.arange(samples) + 0.5) / samples - 0.5
        for turn, (dv, du) in enumerate(itertools.product(steps, steps)):
            inner = cast(tables, camera, pose, grid + (du, dv))
            picture += _light(tables, inner, lights, ambient, shadows, turn).picture
        picture /= samples * samples

    def laid_out(values: Float64) -> Float32:
        return np.ascontiguousarray(values.reshape(h, w, *values.shape[1:]), dtype=np.float32)

    passes: dict[str, npt.NDArray[Any]] = {
        "plate": laid_out(picture),
        "Z": laid_out(hits.t),
        "P": laid_out((hits.points - pose[:3, 3]) @ pose[:3, :3]),
        "N": laid_out(hits.normals @ pose[:3, :3]),
        "albedo": laid_out(hits.albedo),
        "flags": _unseen(tables, hits, rig.camera(other), world_from_eye(rig, other)).reshape(h, w),
    }
    if eye == "left" and is_rectified(rig):
        passes["disparity"] = laid_out(rectified_rig(rig).disparity_from_depth(hits.t))
    return passes | {name: laid_out(layer) for name, layer in truth.layers.items()}, hits.object.reshape(h, w).astype(np.int16)


def render(
    scene: Scene, rig: Rig, *, lights: Sequence[Light] | None = None, samples: int = 3, noise_sigma: float = 0.0, frame: int = 0, shadows: bool = True
) -> Shot:
    """Both eyes of `rig` on `scene`, plates and truth.

    lights      : instead of the scene's own; () leaves the ambient light.
    samples     : rays a pixel along each side, for the plate only.
    noise_sigma : standard deviation of Gaussian sensor noise on the plate, scene-linear; the same bits for the same frame and eye.
    frame       : number of the frame; a moving scene is built per frame, see `scene_named`.
    shadows     : whether lights cast them.
    Raises      : ShotError where a setting is out of range.
    """
    if samples < 1 or samples > 16:
        raise ShotError(f"samples must lie in 1..16, got {samples}")
    if not noise_sigma >= 0:
        raise ShotError(f"noise_sigma must be at least 0, got {noise_sigma:g}")
    shining = tuple(scene.lights if lights is None else lights)
    names = [light.name for light in shining]
    if len(set(names)) < len(names):
        raise ShotError(f"two lights share a name: {', '.join(sorted(names))}; names make layers")
    tables = scene.tables()
    frames: dict[Eye, Frame] = {}
    objects: dict[Eye, npt.NDArray[np.int16]] = {}
    eyes: tuple[Eye, Eye] = ("left", "right")
    for eye in eyes:
        passes, objects[eye] = _render_eye(tables, rig, eye, shining, scene.ambient, samples, shadows)
        if noise_sigma > 0:
            grain = np.random.Generator(np.random.Philox(key=[frame, int(eye == "right")])).standard_normal(passes["plate"].shape)
            passes["plate"] = (passes["plate"] + noise_sigma * grain).astype(np.float32)
        frames[eye] = Frame(passes=passes, camera=rig.camera(eye), eye=eye, number=frame, metadata={"scene": scene.name})
    return Shot(
        scene=scene.name,
        rig=rig,
        lights=shining,
        ambient=scene.ambient,
        left=frames["left"],
        right=frames["right"],
        objects=objects,
        object_names=tuple(thing.name for thing in scene.objects),
    )
