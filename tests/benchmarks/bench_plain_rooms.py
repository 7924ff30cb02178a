"""Depth and normals before walls that have next to nothing to match by, as a camera's own processing leaves them.

Run:  python tests/benchmarks/bench_plain_rooms.py [--scenes bust ...] [--contrasts 0.02 0.04] [--quality standard] [--size 640x360] [--cache DIR]
          [--pictures DIR]
Our scenes with their large surfaces in one colour, textured by `contrast` of it; grain of 0.4 % of full range, softened as a camera softens it
and kept as JPEG, or 1 % as it falls.  Prints bad1, bad2 where both eyes see, bad2 of all, the median of the normals' error and how many are off
by more than 30 degrees, and confidence: told, right, the worst tenth of 1 % of the pixels and more.  --pictures writes plate, depth, confidence,
true depth, normals and true normals."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.compare.normals import angle_deg
from stereorelight.shot.depths import surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import Rectification, rectification
from stereorelight.stereo.settings import QUALITIES, DepthSettings
from stereorelight.synth.render import render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scene import Scene
from stereorelight.synth.scenes import scene_named
from stereorelight.threads import set_threads

BARE = {
    "bust": ("wall", "shirt"),
    "interior": ("wall", "ceiling"),
    "box": ("",),
    "two_planes": ("",),
    "sphere": ("",),
    "statue": ("wall", "floor"),
}  # words of the names of what is made bare
SIZE = (640, 360)
CONTRASTS = (0.02, 0.04)
GRAINS = ((0.004, 0.6), (0.01, 0.0))  # of full range, and softened by so many px
JPEG = 95


@dataclass(frozen=True, kw_only=True, eq=False)
class Room:
    """Plates (H, W, 3) scene-linear, true disparity (H, W) px, normals (H, W, 3), and where both eyes see."""

    name: str
    plates: tuple[np.ndarray, np.ndarray]
    truth: np.ndarray
    N: np.ndarray
    seen: np.ndarray


def bare(scene: Scene, words: Sequence[str], contrast: float) -> Scene:
    """`scene` with what is named by one of `words` in one colour."""
    things = []
    for thing in scene.objects:
        if any(word in thing.name for word in words):
            made = thing.material
            thing = replace(thing, material=replace(made, contrast=contrast, color2=made.color, pattern="matte"))
        things.append(thing)
    return replace(scene, objects=tuple(things))


def rendered(name: str, contrast: float, cache: Path | None, size: tuple[int, int] = SIZE) -> dict[str, np.ndarray]:
    path = None if cache is None else cache / f"room_{name}_{size[0]}_{contrast}.npz"
    if path is not None and path.exists():
        return dict(np.load(path))
    shot = render(bare(scene_named(name), BARE[name], contrast), parallel_rig(size))
    found = {"left": shot.left["plate"], "right": shot.right["plate"], **{k: shot.left[k] for k in ("Z", "N", "flags")}}
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **found)
    return found


def kept_by_camera(plate: np.ndarray, grain: float, soft_px: float, rng: np.random.Generator) -> np.ndarray:
    """The plate as 8-bit JPEG with grain, alike in all channels; softened grain keeps its strength."""
    noise = rng.standard_normal(plate.shape[:2]).astype(np.float32)
    if soft_px:
        noise = cv2.GaussianBlur(noise, (0, 0), soft_px) * 2 * np.sqrt(np.pi) * soft_px
    codes = np.clip(np.rint(255 * (np.clip(plate, 0, 1) ** (1 / 2.2) + grain * noise[..., None])), 0, 255).astype(np.uint8)
    kept = cv2.imdecode(cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, JPEG])[1], cv2.IMREAD_COLOR)
    return (kept / 255).astype(np.float32) ** np.float32(2.2)


def rooms(
    names: Sequence[str] = tuple(BARE),
    contrasts: Sequence[float] = CONTRASTS,
    grains: Sequence[tuple[float, float]] = GRAINS,
    cache: Path | None = None,
    size: tuple[int, int] = SIZE,
) -> Iterator[Room]:
    rig = rig_of(size).rig
    per = rig.left.fx * rig.baseline_m
    for name in names:
        for contrast in contrasts:
            made = rendered(name, contrast, cache, size)
            for grain, soft_px in grains:
                rng = np.random.default_rng(1)
                left, right = (kept_by_camera(made[eye], grain, soft_px, rng) for eye in ("left", "right"))
                told = f"{name} {100 * contrast:g} %, grain {100 * grain:g} %"
                yield Room(name=told, plates=(left, right), truth=per / made["Z"], N=made["N"], seen=made["flags"] == 0)


def rig_of(size: tuple[int, int] = SIZE) -> Rectification:
    return rectification(parallel_rig(size))


def pictured(room: Room, disparity: np.ndarray, confidence: np.ndarray, N: np.ndarray) -> np.ndarray:
    low, high = room.truth.min() - 2, room.truth.max() + 2

    def depth(d: np.ndarray) -> np.ndarray:
        return cv2.applyColorMap(np.uint8(255 * np.clip((d - low) / (high - low), 0, 1)), cv2.COLORMAP_TURBO)

    def normals(n: np.ndarray) -> np.ndarray:
        return np.uint8(np.clip(127.5 + 127.5 * np.nan_to_num(n), 0, 255))[..., ::-1]

    plate = np.uint8(255 * np.clip(room.plates[0], 0, 1) ** (1 / 2.2))[..., ::-1]
    sure = cv2.applyColorMap(np.uint8(255 * confidence), cv2.COLORMAP_VIRIDIS)
    return np.vstack([np.hstack([plate, depth(disparity), sure]), np.hstack([depth(room.truth), normals(N), normals(room.N)])])


def figures(room: Room, quality: str, pictures: Path | None) -> tuple[str, np.ndarray]:
    rig = rig_of((room.truth.shape[1], room.truth.shape[0]))
    found = recover(*room.plates, rig, settings=DepthSettings(quality=quality))
    disparity, sure = found.rectified["disparity"], found.rectified["confidence"]
    N = surface_of(found.frame, noise_per_m=MATCH_NOISE_PX / (rig.rig.left.fx * rig.rig.baseline_m))["N"]
    off, angle = np.abs(disparity - room.truth), angle_deg(N, room.N)
    right = off <= 1
    tenths = [one for low in np.arange(0, 1, 0.1) if (one := (sure >= low) & (sure < low + 0.1 + 0.01 * (low > 0.85))).mean() > 0.01]
    worst = max(abs(float(sure[one].mean()) - float(right[one].mean())) for one in tenths)
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(pictures / f"{room.name.replace(' ', '_')}.png"), pictured(room, disparity, sure, N))
    bad = [100 * np.mean(off[room.seen] > 1), 100 * np.mean(off[room.seen] > 2), 100 * np.mean(off > 2)]
    row = np.array([*bad, np.nanmedian(angle), 100 * np.nanmean(angle > 30), sure.mean(), right.mean(), worst])
    return told(room.name, row), row


def told(name: str, row: np.ndarray) -> str:
    return "{:28s} bad1 {:5.1f}  bad2 {:5.1f}  all {:5.1f}  N {:5.1f}  over 30 deg {:4.1f} %  told {:.2f}  right {:.2f}  off {:.2f}".format(
        name, *row
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=list(BARE), choices=list(BARE))
    parser.add_argument("--contrasts", nargs="+", type=float, default=list(CONTRASTS))
    parser.add_argument("--quality", default="standard", choices=QUALITIES)
    parser.add_argument("--size", default=f"{SIZE[0]}x{SIZE[1]}")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    set_threads()
    width, height = (int(n) for n in asked.size.split("x"))
    for grain in GRAINS:
        rows = []
        for room in rooms(asked.scenes, asked.contrasts, (grain,), asked.cache, (width, height)):
            text, row = figures(room, asked.quality, asked.pictures)
            print(text, flush=True)
            rows.append(row)
        print(told(f"mean, grain {100 * grain[0]:g} %", np.mean(rows, axis=0)), flush=True)


if __name__ == "__main__":
    main()
