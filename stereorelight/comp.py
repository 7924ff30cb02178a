"""The comp: plate and light layers to the relit plate.

In: the plate (H, W, 3) and light layers (H, W, 3), scene-linear float32.  Out: the relit plate, the same shape; the alpha of
light alone; and how far the geometry is trusted, by which light may be faded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, as_float32
from stereorelight.engine.gain import checked_gain
from stereorelight.engine.rows import in_row_blocks
from stereorelight.errors import PassError, ShotError, nearest_hint

Mode = Literal["add", "multiply", "light_only"]
MODES = ("add", "multiply", "light_only")


def relight(plate: npt.ArrayLike, layers: Mapping[str, npt.ArrayLike], *, plate_gain: float | Sequence[float] = 1.0, mode: Mode = "add") -> Float32:
    """The relit plate.

    plate      : (H, W, 3), scene-linear; values below 0 and above 1 are kept, and NaN stays in its own pixel.
    layers     : name to (H, W, 3).  They are added in the order of their names, so the bits do not depend on the order of the mapping.
    plate_gain : one number or three, >= 0.
    mode       : "add": plate * plate_gain + the sum of the layers.
                 "multiply": plate * (plate_gain + the sum of the layers), for layers made on a white albedo: a gain on the plate,
                 highlights included.  For layers without a highlight it is what "add" makes of layers on the plate as albedo.
                 "light_only": the sum of the layers, to be added elsewhere; the plate gives no more than its size.
    Returns    : (H, W, 3) float32, a new array.  No layers and gain 1 return the plate bit for bit, but for "light_only".
    Raises     : PassError for arrays that do not fit, ShotError for the gain and the mode.
    """
    base = as_float32(plate, "plate", channels=3)
    gain = checked_gain(plate_gain)
    if mode not in MODES:
        raise ShotError(f"mode {mode!r} is unknown{nearest_hint(str(mode), MODES)}")
    size_hw = (base.shape[0], base.shape[1])
    if mode == "add":
        beauty = base.copy() if gain == (1.0, 1.0, 1.0) else base * np.array(gain, np.float32)
    else:
        beauty = np.zeros_like(base)
    added = [as_float32(layers[name], name, channels=3, size_hw=size_hw) for name in sorted(layers)]

    def run(first: int, end: int) -> None:
        """Block by block, so that the sum stays in the cache while the layers go by."""
        part = beauty[first:end]
        for layer in added:
            part += layer[first:end]
        if mode == "multiply":
            part += np.array(gain, np.float32)
            part *= base[first:end]

    in_row_blocks(run, size_hw[0])
    return beauty


def light_alpha(known: npt.ArrayLike, mattes: Sequence[npt.ArrayLike | None], *, trust: npt.ArrayLike | None = None) -> Float32:
    """The alpha of light alone: where any light may fall.

    known   : (H, W, 3) P or N, or (H, W) Z; nothing falls where it is NaN.
    mattes  : of each light, (H, W) in 0..1, or None for a light without one; several lights screen.  No lights at all: 0.
    trust   : (H, W), as of `trust`, multiplied in.
    Returns : (H, W) float32, 0..1.
    """
    where = np.asarray(known)
    finite = np.isfinite(where) if where.ndim == 2 else np.isfinite(where).all(axis=-1)
    size_hw = (finite.shape[0], finite.shape[1])
    left = np.ones(size_hw, np.float32)
    for matte in mattes:
        left *= 0 if matte is None else 1 - np.nan_to_num(as_float32(matte, "matte", size_hw=size_hw), nan=0.0)
    alpha = np.where(finite, 1 - left, np.float32(0))
    return alpha if trust is None else alpha * as_float32(trust, "trust", size_hw=size_hw)


def trust(
    confidence: npt.ArrayLike | None = None,
    N_sigma: npt.ArrayLike | None = None,
    *,
    fade: float = 1.0,
    full_confidence: float = 0.5,
    most_sigma_deg: float = 40.0,
) -> Float32:
    """How much of the light is kept where the geometry may be wrong, (H, W) float32 in 1 - fade ... 1.

    confidence      : (H, W), 0..1.  Trusted from `full_confidence` up, and by a smoothstep less below, to nothing at 0 and where NaN.
    N_sigma         : (H, W), degrees.  Trusted up to half of `most_sigma_deg`, and by a smoothstep less beyond, to nothing at it
                      and where NaN.
    fade            : 0 keeps all light everywhere, 1 takes all of it where nothing is trusted.
    Raises          : PassError where neither is given or they do not fit, ShotError for a knob out of range.
    """
    for key, value, low, high in (
        ("fade", fade, 0.0, 1.0),
        ("full_confidence", full_confidence, 1e-6, 1.0),
        ("most_sigma_deg", most_sigma_deg, 1e-3, 180.0),
    ):
        if not low <= value <= high:
            raise ShotError(f"{key} must be a number, {low:g} ... {high:g}, got {value!r}")
    shares: list[Float32] = []
    if confidence is not None:
        shares.append(_step(as_float32(confidence, "confidence") / np.float32(full_confidence)))
    if N_sigma is not None:
        size_hw = (shares[0].shape[0], shares[0].shape[1]) if shares else None
        shares.append(_step(2 - as_float32(N_sigma, "N_sigma", size_hw=size_hw) / np.float32(most_sigma_deg / 2)))
    if not shares:
        raise PassError("trust needs confidence or N_sigma; neither is there")
    share = shares[0] if len(shares) == 1 else shares[0] * shares[1]
    kept: Float32 = 1 - np.float32(fade) * (1 - share)
    return kept


def _step(t: Float32) -> Float32:
    """Smoothstep of t from 0 to 1; NaN is 0."""
    t = np.clip(np.nan_to_num(t, nan=0.0), 0, 1)
    return t * t * (3 - 2 * t)


def faded(layers: Mapping[str, Float32], factor: npt.ArrayLike) -> dict[str, Float32]:
    """Every layer times `factor`, (H, W) or (H, W, 3): new arrays."""
    f = np.asarray(factor, dtype=np.float32)
    f = f[..., None] if f.ndim == 2 else f
    return {name: np.ascontiguousarray(layer * f) for name, layer in layers.items()}
