"""The comp: plate and light layers to the relit plate.

In: the plate (H, W, 3) and light layers (H, W, 3), scene-linear float32.  Out: the relit plate, the same shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, as_float32
from stereorelight.engine.gain import checked_gain


def relight(plate: npt.ArrayLike, layers: Mapping[str, npt.ArrayLike], *, plate_gain: float | Sequence[float] = 1.0) -> Float32:
    """plate * plate_gain + the sum of the layers.

    plate      : (H, W, 3), scene-linear; values below 0 and above 1 are kept, and NaN stays in its own pixel.
    layers     : name to (H, W, 3).  They are added in the order of their names, so the bits do not depend on the order of the mapping.
    plate_gain : one number or three, >= 0.
    Returns    : (H, W, 3) float32, a new array.  No layers and gain 1 return the plate bit for bit.
    Raises     : PassError for arrays that do not fit, ShotError for the gain.
    """
    base = as_float32(plate, "plate", channels=3)
    gain = checked_gain(plate_gain)
    beauty = base.copy() if gain == (1.0, 1.0, 1.0) else base * np.array(gain, np.float32)
    for name in sorted(layers):
        beauty += as_float32(layers[name], name, channels=3, size_hw=(base.shape[0], base.shape[1]))
    return beauty
