"""A gobo: a picture in a spot, thrown through its cone like a slide.

In: P (H, W, 3) of the frame, the spot, and the picture.  Out: (H, W, 3) float32, what the picture lets through of the spot's
light at each pixel; the spot's layers are multiplied by it.
Frame: scene frame of the camera, metres; a spot in the world stands there whatever the camera does.
The longer side of the picture spans the whole cone, penumbra included; beyond the picture it is dark.  Its up is the up (+y) of
the light's own space, and seen from behind the spot it is the right way round; `gobo_turn_deg` turns it clockwise as seen
from there.  A spot that shines straight up or down has the picture's up towards -z."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError
from stereorelight.light.lights import SpotLight

WIDEST_DEG = 160.0  # of the cone and both penumbras; a slide has no wider throw


def gobo_axes(spot: SpotLight) -> tuple[Float64, Float64, Float64]:
    """Right, up and forward of the thrown picture, unit vectors in the spot's own space."""
    forward = spot.shines_to
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.999 else np.array([0.0, 0.0, -1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    turn = math.radians(spot.gobo_turn_deg)
    return math.cos(turn) * right - math.sin(turn) * up, math.cos(turn) * up + math.sin(turn) * right, forward


def gobo_factor(P: npt.ArrayLike, spot: SpotLight, picture: npt.ArrayLike, *, camera: Camera | None = None) -> Float32:
    """What `picture` lets through of the light of `spot`, (H, W, 3) float32; 0 beyond the picture and where P is not known.

    picture : (h, w) or (h, w, 3), linear, >= 0, such as a still read as linear light.  Looked up bilinearly.
    camera  : its pose places a spot in the world.
    Raises  : PassError for arrays that do not fit or a negative picture, ShotError for a cone too wide for a slide.
    """
    half = spot.cone_deg / 2 + spot.penumbra_deg
    if 2 * half > WIDEST_DEG:
        raise ShotError(
            f"light {spot.name!r}: a gobo needs cone_deg and twice penumbra_deg of at most {WIDEST_DEG:g} together, got {2 * half:g}; narrow the cone"
        )
    slide = np.asarray(picture)
    slide = as_float32(np.repeat(slide[..., None], 3, axis=2) if slide.ndim == 2 else slide, f"gobo of light {spot.name!r}", channels=3)
    if not (slide >= 0).all():
        raise PassError(f"gobo of light {spot.name!r} must hold values of at least 0, got {float(np.nanmin(slide)):.4g} or NaN")
    places = as_float32(P, "P", channels=3).astype(np.float64)
    if spot.space == "world" and camera is not None:
        pose = camera.world_from_camera
        places = places @ pose[:3, :3].T + pose[:3, 3]
    right, up, forward = gobo_axes(spot)
    way = places - spot.position_m
    with np.errstate(invalid="ignore", divide="ignore"):
        along = way @ forward
        scale = np.where(along > 0, 1 / (along * math.tan(math.radians(half))), np.nan)
        x, y = way @ right * scale, way @ up * scale
    h, w = slide.shape[:2]
    longest = max(h, w)
    # -1 ... 1 spans the longer side, edge to edge; (0, 0) is the centre of the first pixel.
    u, v = (x * longest + w) / 2 - 0.5, (h - y * longest) / 2 - 0.5
    return _looked_up(slide, u, v)


def _looked_up(slide: Float32, u: Float64, v: Float64) -> Float32:
    """Bilinear, edges held for half a pixel, dark beyond and where u or v is NaN."""
    h, w = slide.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = (u >= -0.5) & (u <= w - 0.5) & (v >= -0.5) & (v <= h - 0.5)
    u, v = (np.clip(np.where(inside, c, 0.0), 0, n - 1) for c, n in ((u, w), (v, h)))
    j, i = np.minimum(u.astype(np.intp), max(w - 2, 0)), np.minimum(v.astype(np.intp), max(h - 2, 0))
    a, b = (u - j)[..., None], (v - i)[..., None]
    j1, i1 = np.minimum(j + 1, w - 1), np.minimum(i + 1, h - 1)
    found = (1 - b) * ((1 - a) * slide[i, j] + a * slide[i, j1]) + b * ((1 - a) * slide[i1, j] + a * slide[i1, j1])
    return np.ascontiguousarray(np.where(inside[..., None], found, 0.0), dtype=np.float32)
