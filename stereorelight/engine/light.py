"""The light kernels' door: rows of Z or P, N and albedo under any mixture of lights, to a relit picture or to single layers.

In: Z (H, W) with rays, or P (H, W, 3); N, albedo and plate (H, W, 3) float32; lights as a table (light_table.py).
Out: the relit plate, or one (H, W, 3) layer for each slot asked for; written into the arrays given.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres.
Pixels without P or N get exactly 0 light."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import get_num_threads

from stereorelight.arrays import Float32
from stereorelight.engine import other_lights as other
from stereorelight.engine import plain_lights as plain
from stereorelight.engine.area_rows import NODES
from stereorelight.engine.fastmath import f4
from stereorelight.engine.light_table import ADDS, COVER, MODEL, PADDING, PHONG, POINT, RIM, SHAPE, STRIP
from stereorelight.engine.rows import BLOCK_ROWS, in_row_blocks
from stereorelight.engine.stream import STREAM_BYTES

MOST_ROWS = 64  # of a block


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Where the light falls: P (H, W, 3), or Z (H, W) with either pinhole numbers or rays (H, W, 2); and N (H, W, 3)."""

    N: Float32
    P: Float32 | None = None
    Z: Float32 | None = None
    rays: Float32 | None = None
    pinhole: tuple[float, float, float, float] = (1.0, 1.0, 0.0, 0.0)  # fx, fy, cx, cy


def _flat(picture: Float32 | None) -> Float32:
    """(H, W, C) as (H, W C): leaf loops want plain rows."""
    return np.empty((1, 1), np.float32) if picture is None else picture.reshape(picture.shape[0], -1)


def shade(
    surface: Surface,
    albedo: Float32,
    lights: Float32,
    slots: npt.NDArray[np.int32],
    mattes: Float32,
    *,
    glows: Float32 | None = None,
    layers: Float32 | None = None,
    plate: Float32 | None = None,
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0),
    beauty: Float32 | None = None,
) -> None:
    """Write the layers that `slots` ask for, and the relit plate where `beauty` is given.

    lights : (n, COLUMNS) float32;  slots : (n, SLOTS) int32;  mattes : (k, H, W) float32, 0..1, NaN counts as 0.
    glows  : (j, area_rows.NODES), the tables of the GGX rows.
    layers : (slots, H, W, 3);  plate, beauty : (H, W, 3).  All C-contiguous and of one size: the caller has checked.
    """
    height, width = surface.N.shape[:2]
    flat_layers = np.empty((0, 1, 1), np.float32) if layers is None else layers.reshape(len(layers), height, 3 * width)
    Z = np.empty((1, 1), np.float32) if surface.Z is None else surface.Z
    fx, fy, cx, cy = (f4(v) for v in surface.pinhole)
    P, rays, N, flat_albedo = _flat(surface.P), _flat(surface.rays), _flat(surface.N), _flat(albedo)
    flat_plate, flat_beauty = _flat(plate), _flat(beauty)
    gains = np.array(gain, np.float32)
    tables = np.zeros((1, NODES), np.float32) if glows is None else glows

    streams = flat_layers.nbytes >= STREAM_BYTES and not slots[:, ADDS].any()  # what is added to is read again
    is_plain = (slots[:, SHAPE] == POINT) & (slots[:, MODEL] == PHONG) & (slots[:, COVER] < 0) & (lights[:, RIM : RIM + 3] == 0).all(axis=1)
    plain_rows, plain_slots = lights[is_plain], slots[is_plain]
    other_rows, other_slots = lights[~is_plain], slots[~is_plain]
    where = surface.P is not None, surface.rays is not None, P, Z, rays, N, fx, fy, cx, cy, flat_albedo

    room = threading.local()  # fresh pages for every block would cost a tenth of one light

    def run(first: int, end: int) -> None:
        if not hasattr(room, "rows"):
            room.rows = np.empty((other.ROWS if len(other_rows) else plain.ROWS, STRIP + PADDING), np.float32)
            room.at = np.empty(STRIP + PADDING, np.int64)
            room.pane = np.empty(3 * STRIP, np.float32)
        if len(plain_rows) or not len(other_rows):
            plain.plain_lights(
                room.rows, streams, first, end, *where, plain_rows, plain_slots, mattes, flat_layers, flat_plate, gains, flat_beauty,
                beauty is not None, albedo is plate,
            )  # fmt: skip
        if len(other_rows):
            other.other_lights(
                room.rows, room.at, room.pane, streams, first, end, *where, other_rows, other_slots, mattes, tables, flat_layers, flat_plate, gains,
                flat_beauty, beauty is not None, len(plain_rows) > 0,
            )  # fmt: skip

    # No pixel knows of its block, so there may be fewer where fewer threads ask for them: each costs 20 microseconds.
    in_row_blocks(run, height, block_rows=min(max(height // (8 * get_num_threads()), BLOCK_ROWS), MOST_ROWS))
