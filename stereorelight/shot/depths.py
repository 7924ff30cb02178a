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
from stereorelight.errors import PassError, PlateError
from stereorelight.footage.frames import read_frame
from stereorelight.passes import Frame
from stereorelight.surface.normals import Method, normals_and_sigma
from stereorelight.surface.position import position_from_depth
from stereorelight.surface.shading import Quality, refine_by_shading

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
) -> Frame:
    """The passes of a file that holds a depth, with Z in metres along the axis and the camera that saw it.

    layer      : the channel or layer that holds the depth; None finds Z, depth.Z and their like.
    metres     : what one unit of it is.
    camera     : the camera; else a centred pinhole of `fov_deg`; else the one in the file's header.
    ray_length : it holds the distance from the camera, not along the optical axis.
    Values at or below 0, infinite, or beyond 100 km are "nothing there": NaN.
    Raises     : PlateError for a file or layer that is not there, without a distance, or of another size than the camera's.
    """
    path = Path(path)
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


def shaded(surface: Frame, depth: Frame, plate: Float32, *, strength: float = 1.0, quality: Quality = "standard") -> tuple[Frame, dict[str, Any]]:
    """`surface` of a `depth` with its Z_sigma, after the plate's own shading has had its say; and what it did, for a receipt.

    Raises : PassError where the depth does not say how far it may be off.
    """
    camera = surface.camera
    if camera is None or "Z_sigma" not in depth:
        raise PassError("shading weighs a depth by its own standard deviation: it needs the passes Z_sigma and N_sigma, as `depth` writes them")
    found = refine_by_shading(
        plate,
        surface["Z"],
        camera,
        Z_sigma=depth["Z_sigma"],
        N=surface["N"],
        N_sigma=surface.passes.get("N_sigma"),
        confidence=depth.passes.get("confidence"),
        strength=strength,
        quality=quality,
    )
    passes = {"Z": found.Z, "P": position_from_depth(found.Z, camera), "N": found.N, "N_sigma": found.N_sigma}
    return replace(surface, passes={**surface.passes, **passes}), found.figures


def surface_of(depth: Frame, *, method: Method = "plane", noise_per_m: float = 0.0) -> Frame:
    """Z, P and N of a frame that holds Z, with the standard deviation of N, degrees.  Raises PassError where it has no camera.

    noise_per_m : what 1/Z is at least off by, as `normals_from_depth` takes it.
    """
    camera = depth.camera
    if camera is None:
        raise PassError("Z needs the camera that saw it before it can be a position")
    Z, confidence = depth["Z"], depth.passes.get("confidence")
    N, sigma = normals_and_sigma(Z, camera, method=method, confidence=confidence, noise_per_m=noise_per_m, Z_sigma=depth.passes.get("Z_sigma"))
    passes = {"Z": Z, "P": position_from_depth(Z, camera), "N": N}
    return replace(depth, passes=passes if sigma is None else {**passes, "N_sigma": sigma})
