"""Light that goes into a surface and comes out beside it: skin, wax, marble.

In: what a white surface reads of each light (H, W, 3), P and N.  Out: the same, scattered by a diffusion profile in millimetres.
Frame: scene frame of the camera, metres.  The profile is that of light/diffusion.py.  Light is scattered before albedo is
multiplied in, so texture stays as sharp as the plate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.errors import PassError, ShotError
from stereorelight.light.checks import Vector
from stereorelight.light.diffusion import scatter_shape
from stereorelight.light.lights import Light
from stereorelight.light.materials import Material, covers

REACH = 16.0  # shapes d: 99.7 % of the light comes out nearer
GRAZING = 0.1  # N.V below which a pixel's area is taken as that; its own N is not to be believed there


def scattered(irradiance: npt.ArrayLike, P: npt.ArrayLike, N: npt.ArrayLike, d_mm: Sequence[float], *, share: npt.ArrayLike | None = None) -> Float32:
    """`irradiance` after it went through the stuff under the surface.

    irradiance : (H, W, 3) or (L, H, W, 3): what a white surface reads, of one light or several; not finite counts as 0.
    P, N       : (H, W, 3), metres and unit.  Distances are those between the places P, in a straight line.
    d_mm       : three lengths, mm, as of `scatter_shape`; 0 leaves that channel as it is.
    share      : (H, W), 0..1, how far each pixel is of this stuff: light goes in and out there alone.  None: everywhere.
    Returns    : of the same shape; where P, N or share is missing, unchanged.  Weights are made to sum to 1 over what the camera
                 sees of the surface, so even light stays even, also beside a depth edge, which nothing crosses.
    Raises     : PassError for arrays that do not fit, ShotError for lengths that are negative.
    """
    lengths = np.asarray(d_mm, np.float64)
    if lengths.shape != (3,) or not np.isfinite(lengths).all() or (lengths < 0).any():
        raise ShotError(f"d_mm must be three lengths of at least 0 mm, got {d_mm!r}")
    N_ = as_float32(N, "N", channels=3)
    size_hw = (N_.shape[0], N_.shape[1])
    P_ = as_float32(P, "P", channels=3, size_hw=size_hw)
    given = np.asarray(irradiance)
    if given.ndim not in (3, 4) or given.shape[-3:] != (*size_hw, 3):
        raise PassError(f"irradiance must be (H, W, 3) or (L, H, W, 3) with {size_hw[0]} x {size_hw[1]} pixels, got {given.shape}")
    light = np.ascontiguousarray(given, np.float32).reshape(-1, *size_hw, 3)
    if lengths.max() == 0:
        return light.reshape(given.shape).copy()
    held = np.ones(size_hw, np.float32) if share is None else np.nan_to_num(as_float32(share, "share", size_hw=size_hw), nan=0.0)
    if held.size and (held.min() < 0 or held.max() > 1):
        raise PassError(f"share must lie in 0 ... 1, got {float(held.min()):.4g} ... {float(held.max()):.4g}")
    known = np.isfinite(P_).all(axis=-1) & np.isfinite(N_).all(axis=-1) & (P_[..., 2] < 0) & (held > 0)
    if not known.any():
        return light.reshape(given.shape).copy()
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    out = light.copy()
    inside = np.moveaxis(np.nan_to_num(light[(slice(None), *box)], nan=0.0, posinf=0.0, neginf=0.0), 0, 2)
    flat = np.ascontiguousarray(inside.reshape(*inside.shape[:2], -1))
    made, _ = _through(flat, np.where(known[..., None], P_, np.nan)[box], N_[box], np.where(known, held, 0)[box], lengths)
    made = made.reshape(inside.shape)
    part = known[box][..., None] & (lengths > 0)
    for k in range(len(out)):
        out[k][box] = np.where(part, made[:, :, k], out[k][box])
    return out.reshape(given.shape)


def _through(light: Float32, P: Float32, N: Float32, share: Float32, d_mm: Float64) -> tuple[Float32, Float32]:
    """`engine.scatter.scatter` with pixels' sizes found from P and N."""
    from stereorelight.engine import scatter as engine

    far = np.linalg.norm(P, axis=-1)
    with np.errstate(invalid="ignore"):
        facing = np.maximum(np.abs((P * N).sum(axis=-1)) / far / np.maximum(np.linalg.norm(N, axis=-1), 1e-6), GRAZING)
        cosine = -P[..., 2] / far
    # A pixel spans the same on the image plane all over, so cos^3 less as an angle; how much, P says itself.
    across, down = np.diff(P, axis=1)[:-1], np.diff(P, axis=0)[:, :-1]
    spanned = np.linalg.norm(np.cross(across, down), axis=-1) * facing[:-1, :-1] / (far**2 * cosine**3)[:-1, :-1]
    spanned = spanned[np.isfinite(spanned) & (spanned > 0)]
    per_px = float(np.median(spanned)) if spanned.size else 1e-6
    area = (per_px * far**2 * cosine**3 / facing).astype(np.float32)
    pitch = (math.sqrt(per_px) * far * cosine).astype(np.float32)  # along the image plane, where taps are counted
    reach_m = REACH * float(d_mm.max()) / 1000
    most_px = reach_m / float(np.nanmin(pitch))
    levels = 1
    while engine.HALF * 3 ** (levels - 1) < min(most_px, max(P.shape[:2])) and levels < 6:
        levels += 1
    return engine.scatter(
        np.ascontiguousarray(P), pitch, area, np.ascontiguousarray(share, np.float32), light, shape_m=d_mm / 1000, reach_m=reach_m, levels=levels
    )


def scatters(light: Light | None, materials: Sequence[Material] = ()) -> bool:
    """Whether `light`, None for light from all around, is scattered by its own settings or by any of the materials."""
    surfaces = materials if light is None else [light, *(material.under(light) for material in materials)]
    return any(_shape_of(surface) is not None for surface in surfaces)


def _shape_of(surface: Light | Material) -> Vector | None:
    return scatter_shape(surface.scatter, surface.scatter_mm, f"{type(surface).__name__} {surface.name!r}")


def scatter_layers(
    layers: Mapping[str, Float32],
    P: Float32,
    N: Float32,
    lights: Sequence[Light],
    *,
    materials: Sequence[Material] = (),
    mattes: Mapping[str, npt.ArrayLike] | None = None,
) -> dict[str, Float32]:
    """`layers` (name to (H, W, 3), made on white) with every `light_<name>_diffuse` of a light that scatters, and `env_diffuse`, scattered.

    A light's own `scatter` holds where no material lies; a material's within its matte, and there for light from all around too.
    What one stuff took in comes out of that stuff alone.
    """
    size_hw = (P.shape[0], P.shape[1])
    left: Any = np.ones(size_hw, np.float32)
    shares: list[Any] = []
    if materials:
        left, shares = covers(materials, {m.matte: (mattes or {})[m.matte] for m in materials})
    asked: dict[tuple[int, Vector], list[str]] = {}
    for light in lights:
        name = f"light_{light.name}_diffuse"
        for index, surface in enumerate([light, *(material.under(light) for material in materials)]):
            d = _shape_of(surface)
            if name in layers and d is not None:
                asked.setdefault((index, d), []).append(name)
    for index, material in enumerate(materials):
        d = _shape_of(material)
        if "env_diffuse" in layers and d is not None:
            asked.setdefault((index + 1, d), []).append("env_diffuse")
    out = dict(layers)
    for (index, d), names in asked.items():
        share = np.broadcast_to(left if index == 0 else shares[index - 1], size_hw)
        made = scattered(np.stack([layers[name] for name in names]), P, N, d, share=share)
        for name, soft in zip(names, made):
            out[name] = out[name] + share[..., None] * (soft - layers[name])
    return out
