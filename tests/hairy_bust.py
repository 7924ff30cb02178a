"""A bust with strands of hair and 4 px of defocus before its room: two plates, the matte, and the same picture under another light.

The figure and the room are rendered apart; strands are drawn about the head's outline; the figure is put out of focus as a lens does,
colour times cover and cover alike, and laid over the room: plate = blurred(cover colour) + (1 - blurred(cover)) room."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import ndimage

from stereorelight.camera import Rig
from stereorelight.synth.render import Shot, render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scene import Scene
from stereorelight.synth.scenes import scene_named
from tests.plate_lit import BODY

EVEN, AMBIENT = 0.6, 0.15  # of the plate; and what of it stays under the new light
NEW = np.array([0.75, 0.35, 0.55]) / np.linalg.norm([0.75, 0.35, 0.55])  # towards the new light, of strength 1
DEFOCUS_PX = 4.0  # diameter of the circle of confusion
HAIR = np.array([0.085, 0.052, 0.033])
STRANDS = 70


@dataclass(frozen=True, kw_only=True, eq=False)
class Hairy:
    """left, right: plates under even light; alpha: cover; relit: the left plate under the new light; truth_N, P: of the sharp picture."""

    rig: Rig
    left: np.ndarray
    right: np.ndarray
    alpha: np.ndarray
    relit: np.ndarray
    P: np.ndarray
    N: np.ndarray


def _defocused(a: np.ndarray, diameter_px: float) -> np.ndarray:
    r = diameter_px / 2
    reach = int(np.ceil(r + 0.5))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.clip(r + 0.5 - np.hypot(x, y), 0, 1)
    disc /= disc.sum()
    return ndimage.convolve(a, disc) if a.ndim == 2 else np.stack([ndimage.convolve(a[..., c], disc) for c in range(a.shape[2])], axis=-1)


def _strands(size_hw: tuple[int, int], centre: np.ndarray, radius: float, shift_px: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Cover (H, W) of strands 1 px wide that stand off the head, and the way outwards (H, W, 2), x right, y up."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size_hw[0], : size_hw[1]].astype(float)
    cover = np.zeros(size_hw)
    for _ in range(STRANDS):
        angle, length, bend = rng.uniform(0.1, np.pi - 0.1), rng.uniform(0.1, 0.45) * radius, rng.uniform(-0.5, 0.5)
        for t in np.linspace(0, 1, 60):
            a = angle + bend * t * 0.4
            px = centre[0] + (radius * 0.9 + t * length) * np.cos(a) - shift_px
            py = centre[1] - (radius * 0.9 + t * length) * np.sin(a)
            i, j = int(py), int(px)
            near = np.s_[max(i - 2, 0) : i + 4, max(j - 2, 0) : j + 4]
            cover[near] = np.maximum(cover[near], np.clip(1.0 - np.hypot(x[near] - px, y[near] - py), 0, 1))
    out = np.stack([x - centre[0] + shift_px, centre[1] - y], axis=-1)
    return cover, out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-6)


STATUE = ("head", "hair", "torso", "cloth", "eye_left", "eye_right")


@lru_cache(maxsize=2)
def _sharp(name: str, width: int) -> tuple[Rig, list[Shot]]:
    """The figure in its room, and the room alone, sharp and evenly lit."""
    rig = parallel_rig((width, width * 9 // 16), fov_deg=26)
    whole = replace(scene_named(name), ambient=(EVEN,) * 3)
    figure = BODY if name == "bust" else STATUE
    room = Scene(name="room", objects=tuple(t for t in whole.objects if t.name not in figure), ambient=(EVEN,) * 3)
    return rig, [render(scene, rig, lights=(), samples=1) for scene in (whole, room)]


@lru_cache(maxsize=2)
def hairy_bust(width: int = 480, *, defocus_px: float = DEFOCUS_PX, seed: int = 7, scene: str = "bust") -> Hairy:
    """defocus_px : diameter of the circle of confusion.   seed : of the strands.   scene : "bust" or "statue"."""
    rig, shots = _sharp(scene, width)
    body = [k for k, name in enumerate(shots[0].object_names) if name in BODY + STATUE]
    top = shots[0].object_names.index("hair")
    at = np.argwhere(shots[0].objects["left"] == top)
    centre = np.array([at[:, 1].mean(), at[:, 0].max() * 0.55 + at[:, 0].min() * 0.45])
    radius = float(at[:, 1].max() - at[:, 1].min()) / 2
    depth = float(np.median(shots[0].left["Z"][shots[0].objects["left"] == top]))
    made: dict[str, np.ndarray] = {}
    for eye, shift in (("left", 0.0), ("right", rig.left.fx * rig.baseline_m / depth)):
        front, behind = shots[0].frame(eye), shots[1].frame(eye)  # type: ignore[arg-type]
        figure = np.isin(shots[0].objects[eye], body).astype(float)  # type: ignore[index]
        strand, out = _strands(figure.shape, centre, radius, shift, seed)
        strand = strand * (1 - figure)
        cover = figure + strand
        new = {k: AMBIENT + np.maximum(f["N"] @ NEW, 0)[..., None] for k, f in (("f", front), ("b", behind))}
        N_strand = np.concatenate([0.8 * out, np.full((*figure.shape, 1), 0.6)], axis=-1)
        lit_strand = HAIR * (AMBIENT + np.maximum(N_strand @ NEW, 0)[..., None])
        for key, on_figure, on_strand, on_room in (
            (eye, front["albedo"] * EVEN, HAIR * EVEN, behind["albedo"] * EVEN),
            (f"relit_{eye}", front["albedo"] * new["f"], lit_strand, behind["albedo"] * new["b"]),
        ):
            over = _defocused(figure[..., None] * on_figure + strand[..., None] * on_strand, defocus_px)
            made[key] = (over + (1 - _defocused(cover, defocus_px))[..., None] * on_room).astype(np.float32)
        made[f"alpha_{eye}"] = np.clip(_defocused(cover, defocus_px), 0, 1).astype(np.float32)
    left = shots[0].left
    return Hairy(
        rig=rig, left=made["left"], right=made["right"], alpha=made["alpha_left"], relit=made["relit_left"], P=left["P"], N=left["N"]
    )  # fmt: skip
