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

from stereorelight.arrays import Float32, Float64
from stereorelight.camera import Camera, Eye, Rig
from stereorelight.errors import ShotError
from stereorelight.passes import Flag, Frame
from stereorelight.synth.bounce import evened, gathered, tiled
from stereorelight.synth.hits import FLIP as FLIP
from stereorelight.synth.hits import Hits, blocked, cast, share_lit, shone
from stereorelight.synth.lights import Light
from stereorelight.synth.rigs import is_rectified, rectified_rig
from stereorelight.synth.scene import Scene, Tables

AREA_RAYS = 16  # places of an area light that each ray of a plate looks at


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """One frame of a synthetic shot.

    left, right : plate, Z, P, N, albedo, flags, and for each light `light_<name>_diffuse`, `light_<name>_specular`
                  (without shadow) and `matte_lit_<name>` (0 in its shadow, a share where the light has a size); `light_indirect`
                  where bounces were asked for; left also `disparity` on a rectified rig.
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
class _Lit:
    picture: Float64
    layers: dict[str, Float64]


def _light(tables: Tables, hits: Hits, lights: Sequence[Light], around: Float64, shadows: bool, turn: int = 0) -> _Lit:
    """The picture (n, 3), and each light's diffuse, specular and share of light that arrives; `around` (3,) or (n, 3) comes from no light."""
    met = hits.object >= 0
    picture = np.where(met[:, None], hits.albedo * around, 0.0)
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
    hidden = blocked(tables, pose[None, :3, 3], hits.points, met)
    flags = np.where(met & ~inside, np.uint16(Flag.OUT_OF_VIEW), np.uint16(0)) | np.where(hidden, np.uint16(Flag.OCCLUDED), np.uint16(0))
    return np.where(met, flags, np.uint16(Flag.TOO_FAR)).astype(np.uint16)


def _render_eye(
    tables: Tables,
    rig: Rig,
    other_rig: Rig,
    eye: Eye,
    lights: Sequence[Light],
    ambient: tuple[float, float, float],
    samples: int,
    shadows: bool,
    bounce: int,
) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.int16]]:
    camera, pose = rig.camera(eye), world_from_eye(rig, eye)
    other: Eye = "right" if eye == "left" else "left"
    h, w = camera.size_hw
    grid = camera.pixel_grid()
    hits = cast(tables, camera, pose, grid)
    around = np.array(ambient)
    indirect = None
    if bounce:
        normals, Z = hits.normals.reshape(h, w, 3), hits.t.reshape(h, w)
        found = gathered(tables, hits.points, hits.normals, lights, ambient, bounce, order=tiled((h, w)), seed=int(eye == "right"))
        around = evened(found.reshape(h, w, 3), hits.object.reshape(h, w), normals, Z).reshape(-1, 3)
        around[hits.object < 0] = ambient
        indirect = np.where((hits.object >= 0)[:, None], hits.albedo * around, 0.0)
    truth = _light(tables, hits, lights, around, shadows)
    picture = truth.picture
    if samples > 1:
        picture = np.zeros_like(picture)
        steps = (np.arange(samples) + 0.5) / samples - 0.5
        for turn, (dv, du) in enumerate(itertools.product(steps, steps)):
            inner = cast(tables, camera, pose, grid + (du, dv))
            picture += _light(tables, inner, lights, around, shadows, turn).picture
        picture /= samples * samples

    def laid_out(values: Float64) -> Float32:
        return np.ascontiguousarray(values.reshape(h, w, *values.shape[1:]), dtype=np.float32)

    passes: dict[str, npt.NDArray[Any]] = {
        "plate": laid_out(picture),
        "Z": laid_out(hits.t),
        "P": laid_out((hits.points - pose[:3, 3]) @ pose[:3, :3]),
        "N": laid_out(hits.normals @ pose[:3, :3]),
        "albedo": laid_out(hits.albedo),
        "flags": _unseen(tables, hits, other_rig.camera(other), world_from_eye(other_rig, other)).reshape(h, w),
    }
    if indirect is not None:
        passes["light_indirect"] = laid_out(indirect)
    if eye == "left" and is_rectified(rig):
        passes["disparity"] = laid_out(rectified_rig(rig).disparity_from_depth(hits.t))
    return passes | {name: laid_out(layer) for name, layer in truth.layers.items()}, hits.object.reshape(h, w).astype(np.int16)


def render(
    scene: Scene,
    rig: Rig,
    *,
    lights: Sequence[Light] | None = None,
    samples: int = 3,
    noise_sigma: float = 0.0,
    frame: int = 0,
    shadows: bool = True,
    right: tuple[Scene, Rig] | None = None,
    bounce: int = 0,
) -> Shot:
    """Both eyes of `rig` on `scene`, plates and truth.

    lights      : instead of the scene's own; () leaves the ambient light.
    samples     : rays a pixel along each side, for the plate only.
    noise_sigma : standard deviation of Gaussian sensor noise on the plate, scene-linear; the same bits for the same frame and eye.
    frame       : number of the frame; a moving scene is built per frame, see `scene_named`.
    shadows     : whether lights cast them.
    right       : what the right eye sees instead, and the rig by which it stands: a camera that is late, or was knocked.
    bounce      : rays a pixel that gather the light between surfaces (synth/bounce.py), at pixel centres, for the plate and
                  `light_indirect`; 0 leaves the scene's flat ambient light.
    Raises      : ShotError where a setting is out of range.
    """
    if not 0 <= bounce <= 4096:
        raise ShotError(f"bounce must lie in 0..4096 rays a pixel, got {bounce}")
    if samples < 1 or samples > 16:
        raise ShotError(f"samples must lie in 1..16, got {samples}")
    if not noise_sigma >= 0:
        raise ShotError(f"noise_sigma must be at least 0, got {noise_sigma:g}")
    shining = tuple(scene.lights if lights is None else lights)
    names = [light.name for light in shining]
    if len(set(names)) < len(names):
        raise ShotError(f"two lights share a name: {', '.join(sorted(names))}; names make layers")
    seen = {"left": (scene, rig), "right": right or (scene, rig)}
    frames: dict[Eye, Frame] = {}
    objects: dict[Eye, npt.NDArray[np.int16]] = {}
    eyes: tuple[Eye, Eye] = ("left", "right")
    told_of: Scene | None = None  # both eyes see one moment, as a rule: what its tables know of empty space is slow to find
    for eye in eyes:
        stage, stand = seen[eye]
        if stage is not told_of:
            tables, told_of = stage.tables(), stage
        other = seen["right" if eye == "left" else "left"][1]
        lit_by = stage.lights if lights is None else shining
        passes, objects[eye] = _render_eye(tables, stand, other, eye, lit_by, stage.ambient, samples, shadows, bounce)
        if noise_sigma > 0:
            grain = np.random.Generator(np.random.Philox(key=[frame, int(eye == "right")])).standard_normal(passes["plate"].shape)
            passes["plate"] = (passes["plate"] + noise_sigma * grain).astype(np.float32)
        frames[eye] = Frame(passes=passes, camera=stand.camera(eye), eye=eye, number=frame, metadata={"scene": scene.name})
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
