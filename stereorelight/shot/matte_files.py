"""A matte from a picture's channel.

In: a file, and perhaps a channel's name.  Out: (H, W) float32, 0..1."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError, nearest_hint
from stereorelight.footage.exr import find_channel, read_exr
from stereorelight.footage.stills import read_still

NEARLY = 0.01  # filters in other packages leave mattes a hair beyond 0 and 1


def matte_channel(path: Path, channel: str | None) -> Float32:
    """(H, W) of a picture's channel, 0..1.  Raises PlateError naming file and channels.

    channel : None takes a layer `matte_*` or the alpha where there is one, else the mean of the picture.
    """
    if path.suffix.lower() == ".exr":
        parts = read_exr(path)
        names = list(dict.fromkeys(name for part in parts for name in part.channels))
        wanted = [channel, *(f"{channel}.{letter}" for letter in "YARVX")] if channel else [*(n for n in names if n.startswith("matte_")), "A", "Y"]
        found = next((plane for name in wanted if (plane := find_channel(parts, name)) is not None), None)
        if found is None and not channel and {"R", "G", "B"} <= set(names):
            colours = [plane for letter in "RGB" if (plane := find_channel(parts, letter)) is not None]
            found = np.stack(colours).mean(axis=0)
    else:
        still = read_still(path)
        planes = {**dict(zip("RGB", np.moveaxis(still.rgb, -1, 0))), **({} if still.alpha is None else {"A": still.alpha})}
        names = list(planes)
        found = planes.get(channel) if channel else planes.get("A", still.rgb.mean(axis=-1))
    if found is None:
        told = (
            f"has no channel {channel!r}{nearest_hint(channel, names)}"
            if channel
            else f"has no matte, only {', '.join(names[:12])}; name its channel"
        )
        raise PlateError(f"{path}: {told}")
    with np.errstate(invalid="ignore"):
        near = np.where((found > -NEARLY) & (found < 1 + NEARLY), np.clip(found, 0, 1), found)
    return np.ascontiguousarray(near, dtype=np.float32)
