"""Does the relit plate look as it would have, had the light been there?  From plates alone, against the exact render.

Run:  python tests/benchmarks/bench_relight_truth.py [--scenes bust] [--sizes 960x540 1920x1080] [--quality standard] [--shading] [--cache DIR]
The scene is lit by its own lights; depth and normals are recovered from its two plates (8 bit); then one further light is added and held
against what the renderer says that it adds, averaged over the pixel as the plate is.  Figures: relative RMS of light alone, per cent, on the
subject (head, hair, shirt), both pictures blurred by 2 px.  Albedo and highlights are the true ones; `plate` takes the plate for albedo.
found: depth, normals and shadow recovered.  -X: with X exact.  X alone: only X as found.  exact: everything exact.
The blur reaches 2 px beyond the subject: with our shadow it is told once more where nothing beside the subject is lit, in either picture.
Then where the squared error of the first light lies: within 4 px of depth edges, and away from them on skin, hair and shirt.
Rendering takes minutes; --cache keeps pairs (those of bench_depth_scenes.py) and truths."""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.compare.edges import grown, near_edges
from stereorelight.compare.picture import blurred, light_figures
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SpotLight
from stereorelight.light.materials import Material
from stereorelight.shot.depths import shaded, surface_of
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.shot.relight_truth import PARTS, Parts, added_light, cast_shares, error_split, true_light
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import DepthSettings
from stereorelight.synth.relit import relight_truth
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scenes import scene_named
from stereorelight.threads import set_threads
from tests.benchmarks.bench_depth_scenes import NOISE, Pair, plates_of, rendered

SUBJECTS = {"bust": ("skin", "hair", "shirt", "eye_left", "eye_right"), "weak": ("skin", "hair", "shirt", "eye_left", "eye_right")}
SUBJECTS["statue"] = ("head", "hair", "torso", "cloth", "eye_left", "eye_right")
LIGHTS: tuple[Light, ...] = (
    PointLight(name="point", position_m=(0.9, 0.5, -0.7), intensity=1.0),
    DirectionalLight(name="directional", azimuth_deg=55.0, elevation_deg=25.0, intensity=0.8),
    SpotLight(name="spot", position_m=(0.8, 0.9, -0.5), aim_m=(0.0, 0.03, -1.45), cone_deg=24.0, penumbra_deg=6.0, intensity=1.5),
    RectLight(name="area", position_m=(-0.8, 0.3, -0.7), aim_m=(0.0, 0.0, -1.5), size_m=(0.5, 0.5), intensity=1.0),
)
SPREAD = {"rect": "places by pixel"}  # how the truth was sampled, where that has changed since the caches were made
MARGIN_PX = 12  # of light about the subject that the blur may reach into


def subject_of(scene: str, pair: Pair) -> np.ndarray:
    return np.isin(pair["names"], SUBJECTS[scene])


def truth_of(scene: str, size: tuple[int, int], pair: Pair, cache: Path | None) -> dict[str, np.ndarray]:
    """albedo, and for each light NAME_open, NAME_lit, NAME_share; from the cache where it holds them, a file a light."""
    out: dict[str, np.ndarray] = {}
    near = grown(subject_of(scene, pair), MARGIN_PX)
    for light in LIGHTS:
        key = hashlib.sha256((repr(light) + SPREAD.get(light.kind, "")).encode()).hexdigest()[:8]
        path = None if cache is None else cache / f"{scene}_{size[0]}x{size[1]}_relight_{light.name}_{key}.npz"
        if path is not None and path.exists():
            out |= dict(np.load(path))
            continue
        made = relight_truth(scene_named(scene), parallel_rig(size), [true_light(light)], samples=3 if size[0] < 1500 else 2, where=near)
        told = made.lights[light.name]
        found = {"albedo": made.albedo, f"{light.name}_open": told.open, f"{light.name}_lit": told.lit, f"{light.name}_share": told.share}
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(path, **found)
        out |= found
    return out


def whereabouts(scene: str, pair: Pair, per: float) -> dict[str, np.ndarray]:
    """The parts of the subject that the error is told for."""
    subject, edges = subject_of(scene, pair), near_edges(per / pair["Z"], jump=1.0, band_px=4)
    parts = {name: subject & ~edges & (pair["names"] == name) for name in ("skin", "hair", "shirt", "marble")}
    return {"near edges": subject & edges} | {name: part for name, part in parts.items() if part.any()}


def materials_of(scene: str, pair: Pair) -> tuple[list[Material], dict[str, np.ndarray]]:
    """The scene's own highlights, each held by the matte of its thing."""
    shiny = [thing for thing in scene_named(scene).objects if thing.material.specular > 0]
    materials = [Material(name=t.name, matte=t.name, specular=t.material.specular, exponent=t.material.exponent) for t in shiny]
    return materials, {t.name: (pair["names"] == t.name).astype(np.float32) for t in shiny}


def told(scene: str, size: tuple[int, int], quality: str, shading: bool, cache: Path | None) -> None:
    pair = rendered(scene, size, cache)
    truth = truth_of(scene, size, pair, cache)
    rig = parallel_rig(size)
    camera = rig.left
    plates = plates_of(pair, NOISE.get(scene, 0.0))
    depth = recover(*plates, rectification(rig), settings=DepthSettings(quality=quality)).frame
    surface = surface_of(depth, noise_per_m=MATCH_NOISE_PX / (rig.left.fx * rig.baseline_m))
    if shading:
        surface, _ = shaded(surface, depth, plates[0], quality="fine" if quality == "fine" else "standard")
    subject = subject_of(scene, pair)
    materials, mattes = materials_of(scene, pair)
    near = np.isfinite(truth["albedo"]).all(axis=-1)
    albedo = np.where(near[..., None], truth["albedo"], 0).astype(np.float32)
    print(f"\n{scene} {size[0]}x{size[1]} {quality}{' + shading' if shading else ''}: relative RMS of light alone on the subject, %")
    heads = ["light", "shadow", "found", *(f"-{p}" for p in PARTS[:3]), *(f"{p} alone" for p in PARTS[:3]), "exact", "plate"]
    print("  ".join(f"{h:>12s}" for h in heads))
    for light in LIGHTS:
        shares = cast_shares([light], surface["Z"], surface["N"], camera, Z_sigma=depth.passes.get("Z_sigma"))
        own = cast_shares([light], pair["Z"], pair["N"], camera)
        for shadow in ("no", "yes"):
            with_shadow = shadow == "yes"
            wanted = truth[f"{light.name}_{'lit' if with_shadow else 'open'}"]
            found = Parts(Z=surface["Z"], N=surface["N"], albedo=albedo, shadows=shares if with_shadow else {})
            exact = Parts(Z=pair["Z"], N=pair["N"], albedo=albedo, shadows={light.name: truth[f"{light.name}_share"]} if with_shadow else {})
            split = error_split(found, exact, wanted, light, camera, region=subject, materials=materials, mattes=mattes)
            by_plate = Parts(Z=found.Z, N=found.N, albedo=plates[0], shadows=found.shadows)
            added = added_light(by_plate, camera, [light], materials=materials, mattes=mattes)[light.name]
            plate = light_figures(added, wanted, region=subject).relative_rms_percent
            parts = list(PARTS[:3])
            numbers = [split.found, *(split.mended.get(p, np.nan) for p in parts), *(split.alone.get(p, np.nan) for p in parts), split.exact, plate]
            print("  ".join([f"{light.name:>12s}", f"{shadow:>12s}", *(f"{n:12.2f}" for n in numbers)]), flush=True)
        if light is LIGHTS[0]:
            added = added_light(found, camera, [light], materials=materials, mattes=mattes)[light.name]
            error, power = (((blurred(a, 2.0)) ** 2).sum(axis=-1) for a in (added - wanted, wanted))
            whole = error[subject].sum()
            for name, part in whereabouts(scene, pair, rig.left.fx * rig.baseline_m).items():
                share, its_own = 100 * error[part].sum() / whole, 100 * np.sqrt(error[part].sum() / power[part].sum())
                size_of = 100 * part.sum() / subject.sum()
                print(f"{name:>12s}  {size_of:5.1f} % of the subject, {share:5.1f} % of its squared error; its own {its_own:.1f} %")
        cast_exact = Parts(Z=pair["Z"], N=pair["N"], albedo=albedo, shadows=own)
        added = added_light(cast_exact, camera, [light], materials=materials, mattes=mattes)[light.name]
        lit = truth[f"{light.name}_lit"]
        error = light_figures(added, lit, region=subject).relative_rms_percent
        alone = [np.where(subject[..., None], np.nan_to_num(a), 0).astype(np.float32) for a in (added, lit)]
        own = light_figures(alone[0], alone[1], region=subject).relative_rms_percent
        print(f"{light.name:>12s}  exact depth and normals, our shadow from them: {error:.2f}; nothing lit beside the subject: {own:.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["bust"])
    parser.add_argument("--sizes", nargs="+", default=["960x540", "1920x1080"])
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--shading", action="store_true")
    parser.add_argument("--cache", type=Path)
    asked = parser.parse_args()
    set_threads()
    for text in asked.sizes:
        w, h = (int(n) for n in text.split("x"))
        for scene in asked.scenes:
            told(scene, (w, h), asked.quality, asked.shading, asked.cache)


if __name__ == "__main__":
    main()
