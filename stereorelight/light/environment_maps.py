"""Environment maps in, one canonical lat-long out; directions to places and back.

In: lat-long, angular (light probe) or mirror-ball pictures (H, W, 3), scene-linear.  Out: lat-long (H, 2H, 3) float32, finite, >= 0.
Frame of a map: x right, y up; -z is its **middle**, that is, what a camera that is not turned sees straight ahead.
  lat-long : column = width (1/2 + atan2(x, -z) / 2 pi) - 1/2, row = height acos(y) / pi - 1/2: the top row is +y, +x stands right of
             the middle, the seam is +z behind the camera.  As seen from inside.
  angular  : the way from the middle grows with the angle off -z, which is 180 degrees at the rim (Debevec's light probe).
  mirror ball : a photograph of a chrome ball by a camera that looks down -z: its middle shows +z, its rim -z.
The paper's equations 12-15 print S = acos(y) / pi times the *width*: the axes are swapped; column goes with the azimuth."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.errors import PassError, nearest_hint

MapKind = Literal["latlong", "angular", "mirror_ball"]
KINDS: tuple[str, ...] = get_args(MapKind)
WIDEST = 16384
ASPECT = 0.02  # what a side may be off: scaled maps are rounded
NEGATIVE = 0.01  # share of the light that sharpening's ringing may have made negative; beyond, this is no picture of light


def directions(height: int) -> Float64:
    """(H, 2H, 3) unit vectors through the pixel centres of a lat-long map."""
    azimuth = (np.arange(2 * height) + 0.5) / height * math.pi - math.pi
    polar = (np.arange(height) + 0.5) / height * math.pi
    s, c = np.sin(polar)[:, None], np.cos(polar)[:, None]
    return np.stack(np.broadcast_arrays(s * np.sin(azimuth), c, -s * np.cos(azimuth)), axis=-1)


def solid_angles(height: int) -> Float64:
    """(H,) steradians of a pixel in each row of a lat-long map; 2H of each sum to 4 pi."""
    edges = np.cos(np.arange(height + 1) / height * math.pi)
    return (edges[:-1] - edges[1:]) * math.pi / height


def latlong_place(d: npt.ArrayLike, height: int) -> Float64:
    """(..., 2) column and row (pixels, centres whole) of directions (..., 3) of any length."""
    x, y, z = np.moveaxis(np.asarray(d, dtype=np.float64), -1, 0)
    column = (np.arctan2(x, -z) / (2 * math.pi) + 0.5) * 2 * height - 0.5
    row = np.arctan2(np.hypot(x, z), y) / math.pi * height - 0.5
    return np.stack([column, row], axis=-1)


def angular_place(d: npt.ArrayLike, size: int) -> Float64:
    """(..., 2) column and row in a square light probe of directions (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(d, dtype=np.float64), -1, 0)
    across = np.hypot(x, y)
    r = np.arctan2(across, -z) / math.pi / np.maximum(across, 1e-300)
    return np.stack([(1 + r * x) * size / 2 - 0.5, (1 - r * y) * size / 2 - 0.5], axis=-1)


def ball_place(d: npt.ArrayLike, circle: tuple[float, float, float], *, angle_deg: float = 0.0) -> Float64:
    """(..., 2) column and row where the chrome ball within `circle` (x, y, radius; pixels) shows directions (..., 3).

    angle_deg : full angle under which the camera saw the ball, 0 from very far away; a ball of radius r at distance d has
                2 asin(r / d).  What hides behind the ball, a cone of that angle round -z, is taken from the rim.
    A ray at the angle t off the axis meets the ball where its normal is i - t off it, sin i = sin t / sin(a / 2), and leaves at 2 i - t.
    """
    x, y, z = np.moveaxis(np.asarray(d, dtype=np.float64), -1, 0)
    across = np.hypot(x, y)
    off = np.arctan2(across, z)  # from the camera's side
    half = math.radians(angle_deg) / 2
    if half < 1e-6:
        r = np.sin(off / 2)
    else:
        i = np.linspace(0, math.pi / 2, 4097)
        t = np.arcsin(np.sin(i) * math.sin(half))
        r = np.interp(off, 2 * i - t, np.tan(t) / math.tan(half))
    r = r / np.maximum(across, 1e-300)
    return np.stack([circle[0] + r * x * circle[2], circle[1] - r * y * circle[2]], axis=-1)


def sampled(picture: npt.NDArray[Any], place: Float64, *, wraps: bool = False) -> Float64:
    """(..., C) of `picture` at `place` (column, row), bilinear, held to its edges or going round in columns."""
    h, w = picture.shape[:2]
    u, v = place[..., 0], np.clip(place[..., 1], 0, h - 1)
    if not wraps:
        u = np.clip(u, 0, w - 1)
    u0, v0 = np.floor(u), np.floor(v)
    p, q = (u - u0)[..., None], (v - v0)[..., None]
    a = u0.astype(np.int64) % w if wraps else u0.astype(np.int64)
    b = (a + 1) % w if wraps else np.minimum(a + 1, w - 1)
    c = v0.astype(np.int64)
    e = np.minimum(c + 1, h - 1)
    top = picture[c, a] * (1 - p) + picture[c, b] * p
    return np.asarray(top * (1 - q) + (picture[e, a] * (1 - p) + picture[e, b] * p) * q, dtype=np.float64)


def cleaned(picture: Float32, name: str, *, bad_values: Literal["refuse", "clamp"] = "refuse") -> Float32:
    """`picture` with light that can be: finite and not negative.

    Negative values that hold less than a hundredth of the light are ringing, and become 0.  More of them, NaN and infinity are
    refused; with bad_values "clamp", negative and NaN become 0 and infinity the largest finite value of its channel.
    Raises : PassError with the counts and the remedy.
    """
    bad = ~np.isfinite(picture)
    below = picture < 0
    if bad_values == "refuse":
        if bad.any():
            which = "infinite" if np.isinf(picture).any() else "not numbers"
            raise PassError(f'{name}: {int(bad.any(axis=-1).sum())} pixels are {which}; clip its sun, or set bad_values = "clamp"')
        low, high = float(-picture[below].sum(dtype=np.float64)), float(picture[~below].sum(dtype=np.float64))
        if low > NEGATIVE * high:
            raise PassError(
                f'{name}: {int(below.any(axis=-1).sum())} pixels are negative, as no light is; is it scene-linear? bad_values = "clamp" makes them 0'
            )
    if not bad.any() and not below.any():
        return picture
    fine = np.where(bad | below, np.float32(0), picture)
    return np.ascontiguousarray(np.where(np.isposinf(picture), fine.max(axis=(0, 1)), fine), dtype=np.float32)


def _from_round(picture: Float32, kind: str, height: int, circle: tuple[float, float, float], angle_deg: float) -> Float32:
    """A light probe or ball as lat-long: four samples a pixel, in stripes so that big maps stay small in memory."""
    out = np.empty((height, 2 * height, 3), np.float32)
    fine = 2 * height
    d_all = np.arange(2 * fine)
    azimuth = (d_all + 0.5) / fine * math.pi - math.pi
    x0, y0, radius = circle
    for first in range(0, height, 64):
        end = min(first + 64, height)
        polar = (np.arange(2 * first, 2 * end) + 0.5) / fine * math.pi
        s, c = np.sin(polar)[:, None], np.cos(polar)[:, None]
        d = np.stack(np.broadcast_arrays(s * np.sin(azimuth), c, -s * np.cos(azimuth)), axis=-1)
        place = angular_place(d, picture.shape[0]) if kind == "angular" else ball_place(d, circle, angle_deg=angle_deg)
        # Nothing beyond the rim belongs to the map: hold samples half a pixel inside it.
        off = place - (x0, y0)
        far = np.maximum(np.hypot(off[..., 0], off[..., 1]) / max(radius - 0.75, 0.5), 1.0)[..., None]
        found = sampled(picture, (x0, y0) + off / far)
        out[first:end] = found.reshape(end - first, 2, 2 * height, 2, 3).mean(axis=(1, 3))
    return out


def latlong_from(
    picture: npt.ArrayLike,
    *,
    kind: MapKind = "latlong",
    circle: tuple[float, float, float] | None = None,
    angle_deg: float = 0.0,
    height: int | None = None,
    bad_values: Literal["refuse", "clamp"] = "refuse",
    name: str = "environment map",
) -> Float32:
    """The canonical lat-long map (H, 2H, 3) of a picture.

    picture   : (H, W, 3) scene-linear.  A lat-long must be twice as wide as high; an angular map and a ball without `circle` square.
    circle    : of a mirror ball or light probe in the picture: centre x, y and radius, pixels.  None: the picture's inscribed circle.
    angle_deg : see `ball_place`.
    height    : of the result; None keeps a lat-long's own and the pixels of the others.
    Raises    : PassError for a shape or values that no map has (`cleaned`).
    """
    if kind not in KINDS:
        raise PassError(f"{name}: kind {kind!r} is unknown{nearest_hint(str(kind), KINDS)}")
    light = as_float32(picture, name, channels=3)
    h, w = light.shape[:2]
    if max(h, w) > WIDEST:
        raise PassError(f"{name}: is {w}x{h}, more than {WIDEST} pixels; scale it down")
    if kind == "latlong":
        if h < 2 or abs(w / (2 * h) - 1) > ASPECT:
            raise PassError(f"{name}: is {w}x{h}, but a lat-long map is twice as wide as high; is it angular or a mirror ball?")
        light = cleaned(light, name, bad_values=bad_values)
        if w == 2 * h and height in (None, h):
            return light
        return _resized(light, height or h)
    if circle is None:
        if abs(w / h - 1) > ASPECT or min(h, w) < 8:
            wanted = "is square" if kind == "angular" else "must be cropped to its square, or its circle be given"
            raise PassError(f"{name}: is {w}x{h}, but a map of kind {kind!r} {wanted}; a lat-long map is twice as wide as high")
        circle = ((w - 1) / 2, (h - 1) / 2, min(h, w) / 2)
    x, y, radius = circle
    over = max(radius - x, x + radius - (w - 1), radius - y, y + radius - (h - 1))  # how far it reaches beyond the outer pixels' centres
    if radius < 4 or over > 1.5:
        words = f"the circle ({x:g}, {y:g}) of radius {radius:g} px"
        raise PassError(f"{name}: {words} does not lie in the picture of {w}x{h}; give [x, y, radius] in pixels")
    if not 0 <= angle_deg < 170:
        raise PassError(f"{name}: angle_deg must lie in 0 ... 170, got {angle_deg:g}; it is the angle under which the camera saw the ball")
    # Corners outside the circle may hold anything.
    rows, columns = np.mgrid[0:h, 0:w]
    outside = (np.hypot(columns - x, rows - y) > radius + 0.25)[..., None]
    light = cleaned(np.where(outside & ~((light >= 0) & np.isfinite(light)), np.float32(0), light), name, bad_values=bad_values)
    if kind == "angular" and (w != h or abs(2 * radius - h) > 1e-6 or abs(x - (w - 1) / 2) > 1e-6 or abs(y - (h - 1) / 2) > 1e-6):
        size = 2 * math.floor(radius)
        grid = (np.arange(size) + 0.5) / size * 2 - 1
        place = np.stack(np.meshgrid(x + radius * grid, y + radius * grid), axis=-1)
        light = sampled(light, place).astype(np.float32)
        circle = ((size - 1) / 2, (size - 1) / 2, size / 2)
    natural = circle[2] if kind == "angular" else circle[2] * math.pi / 2
    return _from_round(light, kind, height or max(8, round(natural)), circle, angle_deg)


def _resized(light: Float32, height: int) -> Float32:
    """A lat-long map of another height: averaged over four samples a pixel."""
    fine = 2 * height
    v = (np.arange(fine) + 0.5) / fine * light.shape[0] - 0.5
    u = (np.arange(2 * fine) + 0.5) / (2 * fine) * light.shape[1] - 0.5
    found = sampled(light, np.stack(np.meshgrid(u, v), axis=-1), wraps=True)
    return np.ascontiguousarray(found.reshape(height, 2, 2 * height, 2, 3).mean(axis=(1, 3)), dtype=np.float32)
