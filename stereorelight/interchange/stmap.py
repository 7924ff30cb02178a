"""ST-maps for Nuke and its like: for each pixel of the result, where in the source its colour comes from.

In: a `Camera`, or a map in our pixels.  Out: (h, w, 4) float32, channels R G B A.
Pixels: ours have (0, 0) at the centre of the top-left one and v down; an ST-map holds
    R = (u + 0.5) / width        G = 1 - (v + 0.5) / height        of the SOURCE's format,
0 and 1 at its outer pixel edges, from the bottom left; B = 0.  A is 1 where the source has a pixel, else 0.
Beyond the source's edge R and G go on below 0 and above 1; where the lens model can say nothing both are NOWHERE, never NaN.
The undistorted picture is a larger canvas about the plate, margins equal left and right and equal above and below, so that a
centred crop is the plate's own format.  A mirrored eye's maps are for the flipped-back plate, as its camera is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64
from stereorelight.camera import Camera
from stereorelight.errors import RigError

NOWHERE = -1.0  # outside every picture, and no NaN, which STMap nodes smear
LARGEST_MARGIN = 0.5  # of the plate, each side: a lens that needs more is too wide for one flat canvas
ROWS = 128  # worked at once: a 4K map whole would take gigabytes


def st_from_pixels(pixels: npt.ArrayLike, size: tuple[int, int]) -> Float32:
    """(h, w, 4) ST-map of source pixels (h, w, 2), our convention, NaN where there are none; `size` is the source's."""
    p = np.asarray(pixels, dtype=np.float64)
    out = np.zeros((*p.shape[:-1], 4), dtype=np.float32)
    s, t = (p[..., 0] + 0.5) / size[0], 1 - (p[..., 1] + 0.5) / size[1]
    known = np.isfinite(s) & np.isfinite(t)
    out[..., 0], out[..., 1] = np.where(known, s, NOWHERE), np.where(known, t, NOWHERE)
    with np.errstate(invalid="ignore"):
        out[..., 3] = known & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    return out


def pixels_from_st(st: npt.ArrayLike, size: tuple[int, int]) -> Float64:
    """(h, w, 2) source pixels, our convention, of an ST-map (h, w, 2 or more); NaN where both channels are NOWHERE."""
    m = np.asarray(st, dtype=np.float64)[..., :2]
    out = np.stack([m[..., 0] * size[0] - 0.5, (1 - m[..., 1]) * size[1] - 0.5], axis=-1)
    out[(m == NOWHERE).all(axis=-1)] = np.nan
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Undistortion:
    """A plate and the canvas that its undistorted picture lies on.

    plate  : the camera that shot it.     canvas : the same eye with a perfect lens, larger by the overscan.
    margin : (x, y) pixels by which the canvas exceeds the plate on each side.
    """

    plate: Camera
    canvas: Camera
    margin: tuple[int, int]

    def undistort_map(self) -> Float32:
        """(h, w, 4) of the canvas's size, to be fed with the plate."""
        return st_map(self.canvas, self.plate)

    def redistort_map(self) -> Float32:
        """(H, W, 4) of the plate's size, to be fed with a picture on the canvas."""
        return st_map(self.plate, self.canvas)


def undistortion(camera: Camera, *, overscan: float | None = None) -> Undistortion:
    """The canvas for undistorting the plates of `camera`.

    overscan : share of the plate's width and height to add on each side; None adds what holds every pixel of the plate.
    Raises   : RigError for a share that no canvas has, or where holding all would take more than LARGEST_MARGIN.
    """
    w, h = camera.size
    if overscan is None:
        margin = _margin_for_all(camera)
    elif math.isfinite(overscan) and 0 <= overscan <= LARGEST_MARGIN:
        margin = math.ceil(overscan * w - 1e-9), math.ceil(overscan * h - 1e-9)
    else:
        raise RigError(f"overscan must lie between 0 and {LARGEST_MARGIN:g} of the plate on each side, got {overscan:g}")
    canvas = camera.undistorted().cropped(-margin[0], -margin[1], (w + 2 * margin[0], h + 2 * margin[1]))
    return Undistortion(plate=camera, canvas=canvas, margin=margin)


def _margin_for_all(camera: Camera) -> tuple[int, int]:
    w, h = camera.size
    u, v = np.linspace(-0.5, w - 0.5, 2 * w + 1), np.linspace(-0.5, h - 0.5, 2 * h + 1)
    sides = [(u, 0 * u - 0.5), (u, 0 * u + h - 0.5), (0 * v - 0.5, v), (0 * v + w - 0.5, v)]
    straight = camera.undistorted().project(camera.rays(np.concatenate([np.stack(s, axis=-1) for s in sides])))
    # A pixel's outer edge may lie just beyond the fold that its centre, checked when the camera was made, does not reach.
    (u0, v0), (u1, v1) = np.nanmin(straight, axis=0), np.nanmax(straight, axis=0)
    x, y = max(-0.5 - u0, u1 - (w - 0.5), 0.0), max(-0.5 - v0, v1 - (h - 0.5), 0.0)
    if x > LARGEST_MARGIN * w or y > LARGEST_MARGIN * h:
        raise RigError(
            f"the lens is too wide for one flat picture: holding all of a {w}x{h} plate takes {x:.0f} px more on each side and {y:.0f} above and "
            f"below; give an overscan of at most {LARGEST_MARGIN:g} and lose the corners"
        )
    return math.ceil(x - 1e-9), math.ceil(y - 1e-9)


def _bands(camera: Camera) -> Iterator[tuple[slice, Float64]]:
    w, h = camera.size
    for top in range(0, h, ROWS):
        rows = np.arange(top, min(top + ROWS, h), dtype=np.float64)
        yield slice(top, top + len(rows)), np.stack(np.meshgrid(np.arange(w, dtype=np.float64), rows), axis=-1)


def st_map(target: Camera, source: Camera, R_source_target: Float64 | None = None) -> Float32:
    """(h, w, 4) of the size of `target`, to be fed with the picture of `source`, an eye at the same place.

    R_source_target : (3, 3), how the two are turned against each other, camera frames; None: not at all.
    """
    out = np.empty((*target.size_hw, 4), dtype=np.float32)
    for rows, pixels in _bands(target):
        rays = target.rays(pixels)
        out[rows] = st_from_pixels(source.project(rays if R_source_target is None else rays @ R_source_target.T), source.size)
    return out
