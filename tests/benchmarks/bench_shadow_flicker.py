"""Are shadows and occlusion as steady as the depth under them?  A shot in which nothing moves but the grain.

Run:  python tests/benchmarks/bench_shadow_flicker.py [--size 480x270] [--frames 5] [--noise 0.01]
The bust, `synth bust --motion none`, is recovered with `time` off and on.  Figures: mean change to the next frame, of Z as a share of itself, of
ambient occlusion, of hard and soft shadows where the surface faces the lamp, and of the light that they let through (`lit`), in units of its mean:
what the lamp adds to a relit picture of even albedo, shadow and all.  Beside it how many times less each is with time, and how far off what exact
depth gives.  Where a thing moves, its shadow's edge moves too, and a shadow that is a pixel off would count as flicker."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.footage.frames import read_frame
from stereorelight.surface.emitters import Emitter
from stereorelight.surface.occlusion import ambient_occlusion
from stereorelight.surface.visibility import ShadowScene

LAMPS = {"side": (0.5, 0.2, -0.3), "key": (-0.8, 0.9, 0.2), "rake": (0.9, 0.15, -1.25)}


def stereorelight(*words: str) -> None:
    subprocess.run([sys.executable, "-c", "from stereorelight.cli import main; main()", *words], check=True, stdout=subprocess.DEVNULL)


def emitters() -> dict[str, Emitter]:
    hard = {f"hard {name}": Emitter(name="a", shape="place", position_m=place) for name, place in LAMPS.items()}
    return hard | {f"soft {name}": Emitter(name="a", shape="ball", position_m=place, radius_m=0.06) for name, place in LAMPS.items()}


def layers(scene: ShadowScene) -> dict[str, np.ndarray]:
    made = {name: scene.shadow(emitter).lit for name, emitter in emitters().items()}
    lit = {f"lit {name}": shadow * falls(scene, LAMPS[name[5:]]) for name, shadow in made.items()}
    return {"Z": scene.Z, "occlusion": ambient_occlusion(scene, radius_m=0.3).ao} | made | lit


def falls(scene: ShadowScene, place: tuple[float, float, float]) -> np.ndarray:
    """What a point light of intensity 1 sends to the surface, by its normal and by the inverse square."""
    way = np.array(place) - scene.P
    square = (way**2).sum(axis=-1)
    return np.maximum((way * scene.N).sum(axis=-1), 0) / square**1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--noise", type=float, default=0.01)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "shot"
        count, noise = str(asked.frames), str(asked.noise)
        stereorelight(
            "synth", "bust", "--out", str(folder), "--size", asked.size, "--frames", count, "--noise", noise, "--samples", "2", "--motion", "none"
        )
        text = (folder / "shot.toml").read_text()
        found: dict[str, list[dict[str, np.ndarray]]] = {}
        for time in ("off", "on"):
            changed = text.replace('folder = "out"', f'folder = "{time}"').replace("[depth]", f'[depth]\ntime = "{time}"')
            (folder / f"{time}.toml").write_text(changed)
            stereorelight("run", str(folder / f"{time}.toml"))
            found[time] = []
            for number in range(1001, 1001 + asked.frames):
                depth = read_frame(folder / time / "depth" / f"bust.{number}.exr")
                N = read_frame(folder / time / "passes" / f"bust.{number}.exr")["N"]
                assert depth.camera is not None
                found[time].append(layers(ShadowScene(Z=depth["Z"], N=N, Z_sigma=depth["Z_sigma"], camera=depth.camera, outside_open=True)))
        true = read_frame(folder / "truth" / "bust.1001.exr")
    assert true.camera is not None
    scene = ShadowScene(Z=true["Z"], N=true["N"], camera=true.camera, outside_open=True)
    truth = layers(scene)
    print(f"{'':>14s}  {'off':>8s}  {'on':>8s}  {'ratio':>6s}  error, on")
    for name, wanted in truth.items():
        where = np.isfinite(wanted)
        if name.split()[-1] in LAMPS:
            where &= ((np.array(LAMPS[name.split()[-1]]) - scene.P) * scene.N).sum(axis=-1) > 0
        per = wanted if name == "Z" else np.full_like(wanted, wanted[where].mean() if name.startswith("lit") else 1)
        off, on = (
            np.mean([np.nanmean((np.abs(b[name] - a[name]) / per)[where]) for a, b in zip(found[time], found[time][1:])]) for time in ("off", "on")
        )
        error = np.mean([np.nanmean((np.abs(a[name] - wanted) / per)[where]) for a in found["on"]])
        print(f"{name:>14s}  {off:8.4f}  {on:8.4f}  {off / on:6.2f}  {error:.4f}", flush=True)


if __name__ == "__main__":
    main()
