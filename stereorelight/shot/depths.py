"""Any Z pass, ours or a renderer's, to Z, P and N.

In: one channel of an EXR, in any unit, along the axis or along the ray.  Out: a `Frame` with Z in metres along the
optical axis, P and N in the scene frame of the camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.camera import Camera, Eye
from stereorelight.compare.axes import coding_of
from stereorelight.compare.placing import Placement
from stereorelight.errors import PassError, PlateError
from stereorelight.footage.exr import read_header
from stereorelight.footage.foreign import RawPasses, read_raw
from stereorelight.footage.frames import OURS, read_frame
from stereorelight.passes import Frame
from stereorelight.shot.truths import Stated, understood
from stereorelight.surface.normals import Method, normals_and_sigma
from stereorelight.surface.outlines import SURER, normals_to_the_rim
from stereorelight.surface.position import position_from_depth
from stereorelight.surface.shading import Quality, judge_by_shading, refine_by_shading
from stereorelight.surface.shading_trust import Judged, ShotMaterials

NOISE = "noise_per_m"  # header word: what 1/Z is at least off by from pixel to pixel (standard deviation), 1/metres
# Of a matched depth's Z_sigma: by what shading holds to it.  Its errors are a surface's, smooth over many pixels, and so are those of a light that
# is told a little wrong: held by less, a plain ball is bent by such a light (docs/shading.md).
HELD_BY = 0.7
FARTHEST_M = 1e5  # renderers write some huge number where there is nothing; no plate sees 100 km


def read_depth(
    path: str | Path,
    *,
    layer: str | None = None,
    metres: float = 1.0,
    camera: Camera | None = None,
    fov_deg: float | None = None,
    ray_length: bool = False,
    eye: Eye | None = None,
    stated: Stated | None = None,
) -> Frame:
    """The passes of a file that holds a depth, with Z in metres along the axis and the camera that saw it.

    layer      : the channel or layer that holds the depth; None finds Z, depth.Z and their like.
    metres     : what one unit of it is.
    camera     : the camera; else a centred pinhole of `fov_deg`; else the one in the file's header.
    ray_length : it holds the distance from the camera, not along the optical axis.
    stated     : what the user says of a renderer's file; what is not said is found from its own P and N, where it has them, and else taken
                 as Z in metres.  What was found is in `metadata["depth_is"]`.
    Values at or below 0, infinite, or beyond 100 km are "nothing there": NaN.
    Raises     : PlateError for a file or layer that is not there, without a distance, or of another size than the camera's.
    """
    path = Path(path)
    said = stated or Stated()
    if said.kind is None and ray_length:
        said = replace(said, kind="ray")
    if is_foreign(path):
        return _foreign_depth(path, layer=layer, camera=camera, fov_deg=fov_deg, stated=said, eye=eye)
    if said.kind not in (None, "z", "ray"):
        raise PlateError(f"{path}: is a depth of ours, which is Z in metres, and cannot be {said.kind!r}")
    metres, ray_length = said.metres or metres, said.kind == "ray"
    found = read_frame(path, layers={"Z": layer} if layer else None, view=eye)
    if "Z" not in found:
        raise PlateError(f"{path}: has no pass Z, only {', '.join(found)}; name the channel that holds the depth with --layer")
    if fov_deg is not None:
        camera = Camera.from_fov(fov_deg, (found.size_hw[1], found.size_hw[0]))
    seen_by = camera or found.camera
    if seen_by is None:
        raise PlateError(f"{path}: does not say which camera saw it; give --rig rig.json or --fov-deg")
    if seen_by.size_hw != found.size_hw:
        h, w = found.size_hw
        raise PlateError(f"{path}: is {w} x {h} pixels, but its camera is {seen_by.size[0]} x {seen_by.size[1]}; give the rig of this picture size")
    Z = found["Z"].astype(np.float64) * metres
    if ray_length:
        Z /= np.sqrt(1 + (seen_by.ray_grid().astype(np.float64) ** 2).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        Z = np.where((Z > 0) & (Z < FARTHEST_M), Z, np.nan)
    if np.isnan(Z).all():
        raise PlateError(f"{path}: Z holds no distance between 0 and {FARTHEST_M / 1000:g} km; name the channel with --layer, and its --unit")
    return replace(found, passes={**found.passes, "Z": Z.astype(np.float32)}, camera=seen_by, eye=eye or found.eye)


def is_foreign(path: Path) -> bool:
    """Whether a file is not written by this toolkit, so that what its passes mean is to be found out or stated."""
    return path.suffix.lower() != ".exr" or f"{OURS}axes" not in read_header(path).metadata


def _seen_by(path: Path, size_hw: tuple[int, int], camera: Camera | None, fov_deg: float | None) -> Camera | None:
    h, w = size_hw
    if fov_deg is not None:
        camera = Camera.from_fov(fov_deg, (w, h))
    if camera is not None and camera.size_hw != size_hw:
        raise PlateError(f"{path}: is {w} x {h} pixels, but its camera is {camera.size[0]} x {camera.size[1]}; give the rig of this picture size")
    return camera


def _foreign_depth(path: Path, *, layer: str | None, camera: Camera | None, fov_deg: float | None, stated: Stated, eye: Eye | None) -> Frame:
    raw = read_raw(path, layer=layer, view=eye)
    if raw.depth is None and raw.P is None:
        raise PlateError(f"{path}: has no pass Z, only {', '.join(raw.names)}; name the channel that holds the depth with --layer")
    camera = _seen_by(path, raw.size_hw, camera or raw.camera, fov_deg)
    if camera is None:
        raise PlateError(f"{path}: does not say which camera saw it; give --rig rig.json or --fov-deg")
    try:
        told = understood(raw, camera=camera, size_hw=raw.size_hw, placement=Placement(), stated=stated, wanted=("Z",), role="the depth")
    except PassError as error:
        raise PassError(str(error).replace("--truth-is", "--depth-is")) from None
    Z = _on_earth(told.Z, path)
    return Frame(passes={"Z": Z}, camera=camera, eye=eye or "left", metadata={"depth_is": "; ".join(told.notes)} if told.notes else {})


def _on_earth(Z: Any, path: Path) -> Float32:
    with np.errstate(invalid="ignore"):
        Z = np.where((Z > 0) & (Z < FARTHEST_M), Z, np.nan)
    if np.isnan(Z).all():
        raise PlateError(f"{path}: Z holds no distance between 0 and {FARTHEST_M / 1000:g} km; name the channel with --layer, and its --unit")
    return np.asarray(Z, np.float32)


def read_surface(path: str | Path, *, camera: Camera | None = None, fov_deg: float | None = None, stated: Stated | None = None) -> Frame:
    """P and N of a file, ours or a renderer's, in the scene frame of the camera, metres.

    camera, fov_deg : of a renderer's file: its axes, world or camera, are then found from the rays and said in `metadata["passes_are"]`.
    stated          : what the user says of them.
    Raises          : PassError where they cannot be told, and where no camera is known and they are not in the scene frame.
    """
    path, said = Path(path), stated or Stated()
    if not is_foreign(path):
        return read_frame(path)
    raw = read_raw(path)
    if raw.P is None or raw.N is None:
        return read_frame(path)
    camera = _seen_by(path, raw.size_hw, camera or raw.camera, fov_deg)
    if camera is None and not said.of_values:
        _check_scene_frame(path, raw)
        return read_frame(path)
    told = understood(
        replace(raw, depth=None), camera=camera, size_hw=raw.size_hw, placement=Placement(), stated=said, wanted=("Z", "N"), role="the file"
    )
    if camera is None or told.Z is None or told.N is None:
        raise PassError(f"{path}: P and N need the camera that saw them: give --rig or --fov-deg")
    Z = _on_earth(told.Z, path)
    passes = {"Z": Z, "P": position_from_depth(Z, camera), "N": told.N.astype(np.float32)}
    try:
        beside = {name: a for name, a in read_frame(path).items() if name not in ("Z", "P", "N")}
    except PlateError:  # its N as it stands may be no N of ours
        beside = {}
    return Frame(passes={**beside, **passes}, camera=camera, metadata={"passes_are": "; ".join(told.notes)})


def _check_scene_frame(path: Path, raw: RawPasses) -> None:
    """Raise PassError unless P lies before the camera and N faces it, as they do in the scene frame."""
    assert raw.P is not None
    assert raw.N is not None
    known = np.isfinite(raw.P).all(axis=-1) & np.isfinite(raw.N).all(axis=-1) & (raw.P != 0).any(axis=-1) & (np.abs(raw.N).sum(axis=-1) > 0.5)
    if not known.any():
        return
    before = float((raw.P[known][:, 2] < 0).mean())
    facing = float(((raw.P[known] * raw.N[known]).sum(axis=-1) < 0).mean())
    if before < 0.95 or facing < 0.9 or coding_of(raw.N):
        coded = ", and N is coded 0..1" if coding_of(raw.N) else ""
        raise PassError(
            f"{path}: P and N are not in the scene frame of the camera: {100 * before:.0f} % of P lies before it, {100 * facing:.0f} % of N "
            f"faces it{coded}. Give --fov-deg or --rig, so that their axes can be found, or make them with `stereorelight passes`"
        )


def _evidence(surface: Frame, depth: Frame) -> tuple[Camera, dict[str, Any]]:
    camera = surface.camera
    if camera is None or "Z_sigma" not in depth:
        raise PassError("shading weighs a depth by its own standard deviation: it needs the passes Z_sigma and N_sigma, as `depth` writes them")
    held = np.float32(HELD_BY) * depth["Z_sigma"]
    passes = {"Z_sigma": held, "N": surface["N"], "N_sigma": surface.passes.get("N_sigma"), "confidence": depth.passes.get("confidence")}
    return camera, passes


def material_test(surface: Frame, depth: Frame, plate: Float32, *, strength: float = 1.0, quality: Quality = "standard") -> Judged:
    """What a frame of a shot says of its materials; a shot's frames are `pooled`.  Raises as `shaded`."""
    camera, passes = _evidence(surface, depth)
    return judge_by_shading(plate, surface["Z"], camera, **passes, strength=strength, quality=quality)


def shaded(
    surface: Frame, depth: Frame, plate: Float32, *, strength: float = 1.0, quality: Quality = "standard", materials: ShotMaterials | None = None
) -> tuple[Frame, dict[str, Any]]:
    """`surface` of a `depth` with its Z_sigma, after the plate's own shading has had its say; and what it did, for a receipt.

    materials : of the whole shot; None judges them by this frame alone.
    Raises    : PassError where the depth does not say how far it may be off.
    """
    camera, passes = _evidence(surface, depth)
    found = refine_by_shading(plate, surface["Z"], camera, **passes, strength=strength, quality=quality, materials=materials)
    passes = {"Z": found.Z, "P": position_from_depth(found.Z, camera), "N": found.N, "N_sigma": found.N_sigma}
    return replace(surface, passes={**surface.passes, **passes}), found.figures


def surface_of(depth: Frame, *, method: Method = "plane", noise_per_m: float | None = None) -> Frame:
    """Z, P and N of a frame that holds Z, with the standard deviation of N, degrees, and of Z, metres, where the frame holds it: shadows
    start off a surface by it.  Raises PassError where it has no camera.

    noise_per_m : what 1/Z is at least off by, as `normals_from_depth` takes it; None takes the frame's own word for it, and 0 without one.
    """
    camera = depth.camera
    if camera is None:
        raise PassError("Z needs the camera that saw it before it can be a position")
    Z, confidence = depth["Z"], depth.passes.get("confidence")
    Z_sigma = depth.passes.get("Z_sigma")
    if noise_per_m is None:
        noise_per_m = float(depth.metadata.get(NOISE, 0.0))
    N, sigma = normals_and_sigma(Z, camera, method=method, confidence=confidence, noise_per_m=noise_per_m, Z_sigma=Z_sigma)
    if method == "plane" and Z_sigma is not None:  # exact depth needs no such help
        N, rim = normals_to_the_rim(N, Z, camera, Z_sigma=Z_sigma)
        sigma = None if sigma is None else sigma * (1 - np.float32(SURER) * rim)
    passes = {"Z": Z, "P": position_from_depth(Z, camera), "N": N}
    more = {"N_sigma": sigma, "Z_sigma": depth.passes.get("Z_sigma")}
    return replace(depth, passes={**passes, **{name: a for name, a in more.items() if a is not None}})
