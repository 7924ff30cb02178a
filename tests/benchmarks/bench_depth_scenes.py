"""Depth and normals on synthetic scenes against truth, Motorcycle under bad plates, and peak memory.

Run:  python tests/benchmarks/bench_depth_scenes.py [--scenes bust weak ...] [--sizes 960x540 ...] [--qualities standard ...] [--cache DIR]
      python tests/benchmarks/bench_depth_scenes.py --robust
      python tests/benchmarks/bench_depth_scenes.py --memory
Rendering takes minutes a pair; --cache keeps pairs.  Plates are 8-bit sRGB, `weak` with 1 % of noise before that.  Depth error is told as
disparity of the pair, px; normals are those of Z as a run makes them.  Seen: what the right eye sees too.  Face: seen skin that faces the
camera (N.V > 0.3), 3 px and more away from depth edges; body: the shirt likewise; edges: seen, within 3 px of depth edges."""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from stereorelight.compare.edges import grown, near_edges
from stereorelight.compare.normals import angle_deg
from stereorelight.shot.depths import shaded, surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import DepthSettings
from stereorelight.synth.render import render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named
from stereorelight.threads import set_threads

SCENES = ("bust", "weak", "thin", "table", "repeat")
NOISE = {"weak": 0.01}
Pair = dict[str, np.ndarray]


def coded(linear: np.ndarray) -> np.ndarray:
    """Scene-linear to 8-bit sRGB codes and back, as from a file."""
    x = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    x = np.rint(np.clip(x, 0, 1) * 255) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


def grained(linear: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """An 8-bit plate with grain of this share of full range on its gamma-coded channels, each its own."""
    code = np.clip(linear, 0, 1) ** (1 / 2.2) + share * rng.standard_normal(linear.shape)
    return coded((np.clip(code, 0, 1) ** 2.2).astype(np.float32))


def rendered(scene: str, size: tuple[int, int], cache: Path | None) -> Pair:
    """Plates, Z, N, flags and the names of what stands at each pixel; from the cache where it holds them."""
    path = None if cache is None else cache / f"{scene}_{size[0]}x{size[1]}_pair.npz"
    if path is not None and path.exists():
        return dict(np.load(path))
    shot = render(scene_named(scene), parallel_rig(size))
    names = np.array([*shot.object_names, "none"])[shot.objects["left"]]
    pair = {"left": shot.left["plate"], "right": shot.right["plate"], "names": names, **{k: shot.left[k] for k in ("Z", "N", "P", "flags")}}
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **pair)
    return pair


def plates_of(pair: Pair, noise: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return tuple(coded(pair[eye] + noise * rng.standard_normal(pair[eye].shape).astype(np.float32)) for eye in ("left", "right"))  # type: ignore[return-value]


def row(scene: str, size: tuple[int, int], quality: str, pair: Pair, shading: bool) -> str:
    rig = parallel_rig(size)
    plates = plates_of(pair, NOISE.get(scene, 0.0))
    start = time.perf_counter()
    found = recover(*plates, rectification(rig), settings=DepthSettings(quality=quality)).frame
    surface = surface_of(found, noise_per_m=MATCH_NOISE_PX / (rig.left.fx * rig.baseline_m))
    if shading:
        surface, _ = shaded(surface, found, plates[0], quality="fine" if quality == "fine" else "standard")
    seconds = time.perf_counter() - start
    seen, per = pair["flags"] == 0, rig.left.fx * rig.baseline_m
    error = np.abs(per / surface["Z"] - per / pair["Z"])
    angle = angle_deg(surface["N"], pair["N"])
    edges = near_edges(per / pair["Z"], jump=1.0, band_px=3)
    faces = (pair["N"] * -pair["P"]).sum(axis=-1) > 0.3 * np.linalg.norm(pair["P"], axis=-1)
    clear = seen & ~grown(edges, 1)

    def middle(mask: np.ndarray) -> str:
        known = mask & np.isfinite(angle)
        return f"{np.median(angle[known]):6.2f}" if known.sum() > 50 else "     -"

    regions = {
        "face": clear & faces & (pair["names"] == "skin"),
        "body": clear & faces & (pair["names"] == "shirt"),
        "flat": clear,
        "edges": seen & edges,
    }
    return (
        f"{scene:7s} {size[0]}x{size[1]:<5d} {quality + (' + shading' if shading else ''):20s} cover {100 * np.isfinite(error).mean():5.1f}  "
        f"bad1 {100 * (error[seen] > 1).mean():5.2f}  bad2 {100 * (error[seen] > 2).mean():5.2f}  "
        f"at edges {100 * (error[seen & edges] > 2).mean():5.2f}  "
        f"N all {middle(seen)}  " + "  ".join(f"{name} {middle(mask)}" for name, mask in regions.items()) + f"  {seconds:5.1f} s"
    )


def robust() -> None:
    """Motorcycle with the right eye's plate made worse, beside the clean pair."""
    from stereorelight.compare.depth import disparity_figures
    from stereorelight.compare.motorcycle import motorcycle
    from tests.benchmarks.bench_depth import pair_of_plates

    left, right, rectified = pair_of_plates()
    pair = motorcycle()
    rng = np.random.default_rng(3)

    down = cv2.warpAffine(right, np.float32([[1, 0, 0], [0, 1, 0.3]]), right.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    cases = {
        "clean": (left, right),
        "+0.7 stop and a cast": (left, coded(right * np.float32([1.75, 1.6, 1.4]))),
        "2 % grain": (grained(left, 0.02, rng), grained(right, 0.02, rng)),
        "0.3 px of row error": (left, down),
    }
    base = 0.0
    for name, plates in cases.items():
        d = recover(*plates, rectified).rectified["disparity"]
        bad = disparity_figures(d, pair.disparity, nonoccluded=pair.nonoccluded).regions["nonoccluded"].bad_percent[2.0]
        base = base or bad
        print(f"motorcycle {name:22s} bad2 {bad:5.2f}  {bad / base:.2f} x clean", flush=True)


def memory_of(quality: str, size: tuple[int, int]) -> None:
    """Peak memory of one recovery, MiB, by itself: a textured wall, slanted, with a card before it."""
    w, h = size
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur(rng.random((h, w + w // 10, 3)).astype(np.float32), (0, 0), 1.2)
    left, right = np.ascontiguousarray(wide[:, w // 10 - w // 32 : w + w // 10 - w // 32]), np.ascontiguousarray(wide[:, w // 10 :])
    recover(left, right, rectification(parallel_rig(size)), settings=DepthSettings(quality=quality, near_m=0.9, far_m=4.0))
    print(f"memory {w}x{h} {quality:9s} {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:6.0f} MiB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--sizes", nargs="+", default=["960x540", "1920x1080"])
    parser.add_argument("--qualities", nargs="+", default=["draft", "standard", "fine"])
    parser.add_argument("--shading", action="store_true")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--robust", action="store_true")
    parser.add_argument("--memory", nargs="*", metavar="QUALITY WxH")
    asked = parser.parse_args()
    set_threads()
    if asked.robust:
        robust()
        return
    if asked.memory is not None:
        if asked.memory:
            memory_of(asked.memory[0], tuple(int(n) for n in asked.memory[1].split("x")))  # type: ignore[arg-type]
            return
        for quality, size in (("standard", "1920x1080"), ("standard", "3840x2160"), ("fine", "3840x2160")):
            subprocess.run([sys.executable, __file__, "--memory", quality, size], check=True)
        return
    for text in asked.sizes:
        w, h = (int(n) for n in text.split("x"))
        for scene in asked.scenes:
            pair = rendered(scene, (w, h), asked.cache)
            for quality in asked.qualities:
                for shading in (False, True) if asked.shading and quality != "draft" else (False,):
                    print(row(scene, (w, h), quality, pair, shading), flush=True)


if __name__ == "__main__":
    main()
