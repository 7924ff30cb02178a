"""Depth and normals in time against the same frame by frame: flicker along the true motion, and the error of each frame.

Run:  python tests/benchmarks/bench_time.py [--shots head head-ride ball ball-ride] [--frames 10] [--window 2] [--quality standard] [--cache DIR]
A head that turns (480 x 270) and a ball that comes nearer by 3 cm a frame before a slanted wall (320 x 180), seen by a camera that stands, or
pans and rides; 1 % of sensor noise of its own in every frame and eye, 8 bit.  Normals are those that a run makes.
Flicker: change of the error from frame to frame, over
everything that is seen in both and lies off depth edges, guesses included; Z as px of disparity."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.camera import Rig
from stereorelight.compare.edges import grown, near_edges
from stereorelight.compare.flicker import residual
from stereorelight.compare.normals import angle_deg
from stereorelight.passes import Frame
from stereorelight.shot.depths import surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import DepthSettings
from stereorelight.stereo.temporal import glimpse, motion_between, steadied
from stereorelight.synth.render import FLIP, render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scene import Material, Object, Scene, rotation
from stereorelight.synth.scenes import AMBIENT, KEY, scene_named
from stereorelight.threads import set_threads
from tests.benchmarks.bench_depth_scenes import coded

SIZES = {"head": (480, 270), "ball": (320, 180)}
NOISE = 0.01
Arrays = dict[str, np.ndarray]


def _card(red: float, green: float, blue: float, frequency: float) -> Material:
    return Material(color=(red, green, blue), contrast=0.5, frequency=frequency, octaves=6, gain=0.7)


def scene_at(shot: str, frame: int) -> Scene:
    if shot.startswith("head"):
        return scene_named("bust", frame=frame, motion=True)
    wall = Object(name="wall", kind="plane", material=_card(0.4, 0.42, 0.45, 14.0), origin_m=(0, 0, -2.5), R_world_object=rotation(y_deg=25.0))
    at = (-0.08 + 0.012 * frame, 0.0, -1.6 + 0.03 * frame)
    ball = Object(name="ball", kind="sphere", material=_card(0.55, 0.4, 0.3, 20.0), origin_m=at, size=(0.25,))
    return Scene(name="ball", objects=(wall, ball), lights=(KEY,), ambient=AMBIENT)


def pose_at(shot: str, frame: int) -> np.ndarray:
    pose = np.eye(4)
    if shot.endswith("ride"):
        pose[:3, :3], pose[:3, 3] = rotation(y_deg=0.3 * frame - 1.5), (0.010 * frame - 0.05, 0.003 * frame, -0.008 * frame)
    return pose


def rendered(shot: str, frame: int, plain: Rig, cache: Path | None) -> Arrays:
    path = None if cache is None else cache / f"time_{shot}.{frame:04d}.npz"
    if path is not None and path.exists():
        return dict(np.load(path))
    rig = replace(plain, left=replace(plain.left, world_from_camera=pose_at(shot, frame)))
    made = render(scene_at(shot, frame), rig, samples=2, shadows=False, noise_sigma=NOISE, frame=frame)
    out = {"left": coded(made.left["plate"]), "right": coded(made.right["plate"]), "Z": made.left["Z"], "N": made.left["N"]}
    out["objects"] = made.objects["left"]
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **out)
    return out


def true_motion(shot: str, frame: int, plain: Rig, here: Arrays, there: Arrays) -> np.ndarray:
    """(H, W, 2) px from a frame to the next; NaN beside depth edges and where a pixel is not found again."""
    now, then = pose_at(shot, frame), pose_at(shot, frame + 1)
    grid = plain.left.pixel_grid()
    world = plain.left.unproject(grid, here["Z"]) @ FLIP @ now[:3, :3].T + now[:3, 3]
    for k, (a, b) in enumerate(zip(scene_at(shot, frame).objects, scene_at(shot, frame + 1).objects, strict=True)):
        own = here["objects"] == k
        world[own] = (world[own] - a.origin_m) @ a.R_world_object @ b.R_world_object.T + b.origin_m
    seen = (world - then[:3, 3]) @ then[:3, :3] @ FLIP
    at = plain.left.project(seen)
    way = (at - grid).astype(np.float32)
    x, y = (np.rint(at[..., k]).astype(int) for k in (0, 1))
    w, h = plain.left.size
    inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    x, y = np.clip(x, 0, w - 1), np.clip(y, 0, h - 1)
    px_m = plain.left.fx * plain.baseline_m
    edges = [grown(near_edges(px_m / f["Z"], jump=1.0, band_px=3), 1) for f in (here, there)]
    found = inside & (np.abs(there["Z"][y, x] - seen[..., 2]) < 0.01 * seen[..., 2]) & ~edges[0] & ~edges[1][y, x]
    way[~found] = np.nan
    return way


def in_time(pairs: list[Arrays], alone: list[Frame], px_m: float, window: int) -> list[Frame]:
    told = [glimpse(pair["left"], depth, px_m=px_m) for pair, depth in zip(pairs, alone, strict=True)]
    motions = {(t, k): motion_between(told[t], told[t + k]) for k in range(1, window + 1) for t in range(len(told) - k)}
    out = []
    for t in range(len(told)):
        near = {k: (told[t + k], motions[t, k][0]) for k in range(1, window + 1) if (t, k) in motions}
        near |= {-k: (told[t - k], motions[t - k, k][1]) for k in range(1, window + 1) if (t - k, k) in motions}
        out.append(steadied(told[t], near, window=window).frame)
    return out


def figures(pairs: list[Arrays], motions: list[np.ndarray], frames: list[Frame], px_m: float) -> dict[str, float]:
    N = [surface_of(f, noise_per_m=MATCH_NOISE_PX / px_m)["N"] for f in frames]
    d, true = [px_m / f["Z"] for f in frames], [px_m / p["Z"] for p in pairs]
    Z_flicker, N_flicker = [], []
    for t, way in enumerate(motions):
        here, there = ((frames[k]["Z"], N[k]) for k in (t, t + 1))
        Z_percent, degrees = residual(here, there, way, truth=tuple((pairs[k]["Z"], pairs[k]["N"]) for k in (t, t + 1)))
        assert degrees is not None
        px = Z_percent / 100 * d[t]
        Z_flicker.append(px[np.isfinite(px)])
        N_flicker.append(degrees[np.isfinite(degrees)])
    z, n = np.concatenate(Z_flicker), np.concatenate(N_flicker)
    e = np.abs(np.stack(d) - np.stack(true))
    edges = np.stack([near_edges(a, jump=1.0, band_px=3) for a in true])
    angle = np.stack([angle_deg(a, p["N"]) for a, p in zip(N, pairs, strict=True)])
    return {
        "Z flicker": float(np.median(z)),
        "mean": float(z.mean()),
        "N flicker": float(np.median(n)),
        "N mean": float(n.mean()),
        "Z error": float(np.median(e)),
        "N error": float(np.nanmedian(angle)),
        "bad1 at edges": 100 * float((e[edges] > 1).mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shots", nargs="+", default=["head", "head-ride", "ball", "ball-ride"])
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--window", type=int, nargs="+", default=[2])
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--cache", type=Path)
    asked = parser.parse_args()
    set_threads()
    for shot in asked.shots:
        rig = parallel_rig(SIZES[shot.partition("-")[0]])
        px_m, rectified = rig.left.fx * rig.baseline_m, rectification(rig)
        pairs = [rendered(shot, t, rig, asked.cache) for t in range(asked.frames)]
        motions = [true_motion(shot, t, rig, pairs[t], pairs[t + 1]) for t in range(asked.frames - 1)]
        settings = DepthSettings(quality=asked.quality)
        alone = [recover(p["left"], p["right"], rectified, settings=settings).frame for p in pairs]
        before = figures(pairs, motions, alone, px_m)
        for window in asked.window:
            after = figures(pairs, motions, in_time(pairs, alone, px_m, window), px_m)
            words = [f"{name} {before[name]:.3f} -> {after[name]:.3f} ({before[name] / max(after[name], 1e-9):.1f} x)" for name in before]
            print(f"{shot:9s} window {window}  " + "  ".join(words), flush=True)


if __name__ == "__main__":
    main()
