"""Normals of a moving head in time, with shading and without: error of each frame, and flicker along the true motion.

Run:  python tests/benchmarks/bench_shading_time.py [--scenes weak bust] [--frames 10] [--quality standard] [--cache DIR]
The head turns by up to 2.9 degrees a frame while the key light moves; 400 x 360 pixels, a long lens, so that the face is 180 px wide; 1 % of
sensor noise of its own in every frame and eye, 8 bit.  Depth is steadied as a run does it (`[depth] time`), then normals, then shading, its
materials judged once over frames spread over the shot (`shot`) or by each frame for itself (`frame`).  Flicker: change of the error along the true
motion, off depth edges; face: skin above the chin that faces the camera; body: the shirt likewise.  --cache keeps plates and depths."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.compare.edges import grown, near_edges
from stereorelight.compare.flicker import residual
from stereorelight.compare.normals import angle_deg
from stereorelight.passes import Frame
from stereorelight.shot.depths import material_test, shaded, surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import DepthSettings
from stereorelight.stereo.temporal import glimpse, motion_between, steadied
from stereorelight.surface.shading_trust import pooled
from stereorelight.synth.bust import HEAD_M
from stereorelight.synth.render import FLIP, render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named
from stereorelight.threads import set_threads
from tests.benchmarks.bench_depth_scenes import coded

SIZE, FOV_DEG, WINDOW, NOISE = (400, 360), 13.0, 2, 0.01
CHIN_M = -0.11  # in the head's own frame: below it skin stays with the body
RIG = parallel_rig(SIZE, fov_deg=FOV_DEG)
PX_M = RIG.left.fx * RIG.baseline_m
EFFORT = {"draft": "standard", "standard": "standard", "fine": "fine"}


@dataclass(frozen=True, eq=False)
class Take:
    """Frames in a row: plates, steadied depths, truth, and the true motion of head and still ground to the next frame."""

    plates: list[np.ndarray]
    depths: list[Frame]
    Z: list[np.ndarray]
    N: list[np.ndarray]
    face: list[np.ndarray]
    body: list[np.ndarray]
    motions: list[np.ndarray]


def _rendered(scene: str, frame: int, cache: Path | None) -> dict[str, np.ndarray]:
    path = None if cache is None else cache / f"{scene}_moving_{SIZE[0]}x{SIZE[1]}.{frame:04d}.npz"
    if path is not None and path.exists():
        return dict(np.load(path))
    shot = render(scene_named(scene, frame=frame, motion=True), RIG, samples=2, noise_sigma=NOISE, frame=frame)
    names = np.array([*shot.object_names, "none"])[shot.objects["left"]]
    out = {"left": coded(shot.left["plate"]), "right": coded(shot.right["plate"]), "names": names, "Z": shot.left["Z"], "N": shot.left["N"]}
    if path is not None:
        np.savez(path, **out)
    return out


def _depths(scene: str, quality: str, pairs: list[dict[str, np.ndarray]], cache: Path | None) -> list[Frame]:
    """Each frame's depth, steadied by its neighbours."""
    rectified, files = rectification(RIG), []
    alone = []
    for t, pair in enumerate(pairs):
        path = None if cache is None else cache / f"{scene}_moving_{SIZE[0]}x{SIZE[1]}_{quality}.{t:04d}.npz"
        files.append(path)
        if path is not None and path.exists():
            alone.append(Frame(passes=dict(np.load(path)), camera=RIG.left))
            continue
        found = recover(pair["left"], pair["right"], rectified, settings=DepthSettings(quality=quality)).frame
        if path is not None:
            np.savez(path, **{k: found[k] for k in found})
        alone.append(found)
    told = [glimpse(pair["left"], depth, px_m=PX_M) for pair, depth in zip(pairs, alone, strict=True)]
    motions = {(t, k): motion_between(told[t], told[t + k]) for k in range(1, WINDOW + 1) for t in range(len(told) - k)}
    out = []
    for t in range(len(told)):
        near = {k: (told[t + k], motions[t, k][0]) for k in range(1, WINDOW + 1) if (t, k) in motions}
        near |= {-k: (told[t - k], motions[t - k, k][1]) for k in range(1, WINDOW + 1) if (t - k, k) in motions}
        out.append(steadied(told[t], near, window=WINDOW).frame)
    return out


def _regions(pair: dict[str, np.ndarray], turned: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    clear = ~grown(near_edges(PX_M / pair["Z"], jump=1.0, band_px=3), 1)
    faces = clear & ((pair["N"] * -P).sum(axis=-1) > 0.3 * np.linalg.norm(P, axis=-1))
    own = (P - HEAD_M) @ turned
    return faces & (pair["names"] == "skin") & (own[..., 1] > CHIN_M), faces & (pair["names"] == "shirt")


def take_of(scene: str, frames: int, quality: str, cache: Path | None) -> Take:
    pairs = [_rendered(scene, t, cache) for t in range(frames)]
    heads = [next(o for o in scene_named(scene, frame=t, motion=True).objects if o.name == "skin").R_world_object for t in range(frames)]
    places = [RIG.left.unproject(RIG.left.pixel_grid(), pair["Z"]) @ FLIP for pair in pairs]
    regions = [_regions(pair, turned, P) for pair, turned, P in zip(pairs, heads, places, strict=True)]
    motions = []
    for t in range(frames - 1):
        world = places[t].copy()
        face = regions[t][0]
        world[face] = (world[face] - HEAD_M) @ heads[t] @ heads[t + 1].T + HEAD_M
        at = RIG.left.project(world @ FLIP)
        way = (at - RIG.left.pixel_grid()).astype(np.float32)
        x, y = (np.clip(np.rint(at[..., k]).astype(int), 0, SIZE[k] - 1) for k in (0, 1))
        there = regions[t + 1][0][y, x] | regions[t + 1][1][y, x]
        seen = np.abs(pairs[t + 1]["Z"][y, x] + world[..., 2]) < 0.01
        way[~((regions[t][0] | regions[t][1]) & there & seen)] = np.nan
        motions.append(way)
    depths = _depths(scene, quality, pairs, cache)
    return Take([p["left"] for p in pairs], depths, [p["Z"] for p in pairs], [p["N"] for p in pairs], *map(list, zip(*regions, strict=True)), motions)


def told(name: str, take: Take, normals: list[np.ndarray], Z: list[np.ndarray]) -> str:
    """One line: error of N, flicker of N (median, mean) and of Z, on face and body."""
    words = []
    n = len(normals)
    for part, masks in (("face", take.face), ("body", take.body)):
        error = np.concatenate([angle_deg(normals[t], take.N[t])[masks[t]] for t in range(n)])
        found = [
            residual((Z[t], normals[t]), (Z[t + 1], normals[t + 1]), take.motions[t], truth=((take.Z[t], take.N[t]), (take.Z[t + 1], take.N[t + 1])))
            for t in range(n - 1)
        ]
        turn, away = (np.concatenate([f[k][masks[t]] for t, f in enumerate(found)]) for k in (1, 0))
        turn, away = turn[np.isfinite(turn)], away[np.isfinite(away)]
        words.append(
            f"{part}: N off by {np.nanmedian(error):5.2f}, flicker of N {np.median(turn):5.2f} (mean {turn.mean():5.2f}), "
            f"of Z {np.median(away):6.4f} % (mean {away.mean():.4f})"
        )
    return f"{name:14s} " + "   ".join(words)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["weak", "bust"])
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--cache", type=Path)
    asked = parser.parse_args()
    set_threads()
    for scene in asked.scenes:
        take = take_of(scene, asked.frames, asked.quality, asked.cache)
        given = [surface_of(depth, noise_per_m=MATCH_NOISE_PX / PX_M) for depth in take.depths]
        print(told(f"{scene} given", take, [s["N"] for s in given], [s["Z"] for s in given]), flush=True)
        by_frame = [shaded(s, d, p, quality=EFFORT[asked.quality])[0] for s, d, p in zip(given, take.depths, take.plates, strict=True)]
        print(told(f"{scene} frame", take, [s["N"] for s in by_frame], [s["Z"] for s in by_frame]), flush=True)
        asked_of = [round((k + 0.5) * asked.frames / 3 - 0.5) for k in range(3)]
        shot = pooled([material_test(given[t], take.depths[t], take.plates[t], quality=EFFORT[asked.quality]) for t in asked_of])
        made = [shaded(s, d, p, quality=EFFORT[asked.quality], materials=shot)[0] for s, d, p in zip(given, take.depths, take.plates, strict=True)]
        print(told(f"{scene} shot", take, [s["N"] for s in made], [s["Z"] for s in made]), shot.to_dict(), flush=True)


if __name__ == "__main__":
    main()
