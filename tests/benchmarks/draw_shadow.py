"""Draw docs/img/shadow_face.jpg, shadow_rake.jpg and shading_raking.jpg: what shadows and a raking light make of matched depth, beside the truth.

Run:  python tests/benchmarks/draw_shadow.py [face rake shading] [--out docs/img] [--cache DIR]
--cache keeps rendered pairs, those of bench_depth_scenes.py."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.footage.curves import encode
from stereorelight.light.lights import PointLight
from stereorelight.light.shade import light_layers
from stereorelight.shot.depths import shaded, surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.shot.relight_truth import true_light
from stereorelight.shot.shadows import cast
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.surface.position import position_from_depth
from stereorelight.surface.visibility import ShadowScene
from stereorelight.synth.relit import relight_truth
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named
from tests.benchmarks.bench_depth_scenes import NOISE, plates_of, rendered

LAMPS = {"face": (-0.8, 0.9, 0.2), "rake": (0.9, 0.15, -1.25)}
BOXES = {"face": (slice(65, 345), slice(370, 610)), "rake": (slice(30, 510), slice(320, 680))}
PLATE_GAIN = 0.15
RAKING = np.float32([-0.89, 0.36, 0.27])


def shown(linear: np.ndarray) -> np.ndarray:
    return np.rint(255 * encode(np.clip(np.nan_to_num(linear), 0, 1), "sRGB")).astype(np.uint8)


def write(path: Path, parts: list[np.ndarray]) -> None:
    cv2.imwrite(str(path), np.ascontiguousarray(np.concatenate(parts, axis=1)[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 88])


def shadows(names: list[str], out: Path, cache: Path | None) -> None:
    """Matched depth without and with its shadow, exact depth with its own, and the trace."""
    size = (960, 540)
    rig, pair = parallel_rig(size), rendered("bust", size, cache)
    plates = plates_of(pair, 0.0)
    depth = recover(*plates, rectification(rig)).frame
    found = surface_of(depth, noise_per_m=MATCH_NOISE_PX / (rig.left.fx * rig.baseline_m))
    for name in names:
        lamp, box = PointLight(name="lamp", position_m=LAMPS[name], intensity=1.4), BOXES[name]
        where = np.zeros(pair["Z"].shape, bool)
        where[box] = True
        traced = relight_truth(scene_named("bust"), rig, [true_light(lamp)], samples=2, where=where).lights["lamp"].share
        scenes = [ShadowScene(Z=s["Z"], N=s["N"], camera=rig.left, Z_sigma=sigma) for s, sigma in ((found, depth["Z_sigma"]), (pair, None))]
        factors = [cast(lamp, scene).factor for scene in scenes]
        parts = []
        for s, factor in ((found, None), (found, factors[0]), (pair, factors[1]), (pair, np.nan_to_num(traced))):
            P = position_from_depth(s["Z"], rig.left)
            layers = light_layers(P, s["N"], plates[0], [lamp], camera=rig.left, shadows=None if factor is None else {"lamp": factor})
            parts.append(shown(PLATE_GAIN * plates[0] + sum(layers.values()))[box])
        write(out / f"shadow_{name}.jpg", parts)


def shading(out: Path, cache: Path | None) -> None:
    """A raking light over the normals of the weak head: from matching alone, with shading, true."""
    size = (1920, 1080)
    rig, pair = parallel_rig(size), rendered("weak", size, cache)
    plates = plates_of(pair, NOISE["weak"])
    depth = recover(*plates, rectification(rig)).frame
    found = surface_of(depth, noise_per_m=MATCH_NOISE_PX / (rig.left.fx * rig.baseline_m))
    better, _ = shaded(found, depth, plates[0])
    parts = [np.repeat(shown(0.8 * np.maximum(N @ RAKING, 0))[120:1016, 520:1390, None], 3, axis=-1) for N in (found["N"], better["N"], pair["N"])]
    write(out / "shading_raking.jpg", [cv2.resize(part, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for part in parts])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=["face", "rake", "shading"])
    parser.add_argument("--out", type=Path, default=Path("docs/img"))
    parser.add_argument("--cache", type=Path)
    asked = parser.parse_args()
    if names := [name for name in asked.names if name in LAMPS]:
        shadows(names, asked.out, asked.cache)
    if "shading" in asked.names:
        shading(asked.out, asked.cache)


if __name__ == "__main__":
    main()
