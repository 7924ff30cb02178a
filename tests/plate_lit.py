"""Plates under known light for tests of the light that is already there: the bust and its truth, small, rendered once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from stereorelight.camera import Rig
from stereorelight.passes import Frame
from stereorelight.synth.lights import Light
from stereorelight.synth.render import render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named

AMBIENT = 0.15
LIGHTS = {
    "lamp": (
        Light(name="k", type="point", position_m=(-0.75, 0.75, -0.55), intensity=1.5),
        Light(name="f", type="directional", direction=(-0.6, -0.25, -1), intensity=0.2),
    ),
    "left": (Light(name="k", type="directional", direction=(0.5, -0.3, -1)),),
    "right": (Light(name="k", type="directional", direction=(-0.8, -0.5, -0.6)),),
    "even": (),
}
BODY = ("skin", "hair", "shirt", "eye_left", "eye_right")


@dataclass(frozen=True, kw_only=True, eq=False)
class Lit:
    """frame: truth; right: the other plate; subject (H, W) bool; E (H, W, 3) what a white surface reads; shine (H, W, 3) its highlights."""

    rig: Rig
    frame: Frame
    right: np.ndarray
    subject: np.ndarray
    E: np.ndarray
    shine: np.ndarray


@lru_cache(maxsize=8)
def bust_under(name: str, width: int = 320) -> Lit:
    rig = parallel_rig((width, width * 9 // 16), fov_deg=26)
    lights, ambient = LIGHTS[name], AMBIENT if LIGHTS[name] else 0.6
    shot = render(replace(scene_named("bust"), ambient=(ambient,) * 3), rig, lights=lights, samples=2 if width > 400 else 1)
    left = shot.left
    E, shine = np.full(left["P"].shape, ambient, np.float32), np.zeros(left["P"].shape, np.float32)
    for light in lights:
        arrives = left[f"matte_lit_{light.name}"][..., None]
        E = E + left[f"light_{light.name}_diffuse"] / np.maximum(left["albedo"], 1e-4) * arrives
        shine = shine + left[f"light_{light.name}_specular"] * arrives
    wanted = [k for k, thing in enumerate(shot.object_names) if thing in BODY]
    return Lit(rig=rig, frame=left, right=shot.right["plate"], subject=np.isin(shot.objects["left"], wanted), E=E, shine=shine)


def random_albedo(size_hw: tuple[int, int], seed: int, *, patches: int = 250) -> np.ndarray:
    """(H, W, 3) cells of any colour of 0.12 to 0.85."""
    rng = np.random.default_rng(seed)
    places = rng.random((patches, 2)) * size_hw
    y, x = np.mgrid[: size_hw[0], : size_hw[1]]
    nearest = cKDTree(places).query(np.stack([y, x], axis=-1).reshape(-1, 2))[1].reshape(size_hw)
    return rng.uniform(0.12, 0.85, (patches, 3))[nearest].astype(np.float32)


def towards_key(name: str, centre: tuple[float, float, float]) -> np.ndarray:
    """(3,) unit vector to the first light of `name`, from `centre`."""
    key = LIGHTS[name][0]
    way = -np.array(key.direction) if key.type == "directional" else np.array(key.position_m) - centre
    return way / np.linalg.norm(way)
