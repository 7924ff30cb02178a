"""Where a chrome ball stands in a photograph.

In: a picture (H, W, 3), scene-linear.  Out: centre x, y and radius in pixels, (0, 0) the centre of the top-left pixel.
Edges vote, along their gradient, for the centres of circles of each radius (Hough 1962 with gradients); the best one is drawn
tighter by the outline's own edge along 360 rays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Float64, as_float32
from stereorelight.errors import PassError
from stereorelight.light.environment_maps import sampled

SEARCH_SIDE = 160  # pixels of the longer side of the picture that is searched
SMALLEST, LARGEST = 0.08, 0.52  # radius over the shorter side
RAYS = 360
SUPPORT = 0.5  # share of the outline whose strongest edge within 4 px must lie on the circle; chance alone gives a quarter


def _tones(picture: npt.ArrayLike) -> Float64:
    """Logarithmic grey: an outline counts the same in shade and in light."""
    grey = np.nan_to_num(as_float32(picture, "photograph of the ball", channels=3).astype(np.float64), nan=0, posinf=1e4, neginf=0).mean(axis=2)
    low = max(float(np.percentile(grey, 50)) * 0.02, 1e-6)
    return np.log(np.maximum(grey, 0) + low)


def _shrunk(tones: Float64, step: int) -> Float64:
    h, w = (n // step * step for n in tones.shape)
    return tones[:h, :w].reshape(h // step, step, w // step, step).mean(axis=(1, 3))


def _blurred(a: Float64) -> Float64:
    for axis in (0, 1):
        a = (np.roll(a, 1, axis) + 2 * a + np.roll(a, -1, axis)) / 4
    return a


def find_ball(picture: npt.ArrayLike) -> tuple[float, float, float]:
    """(x, y, radius) in pixels of the ball's outline.

    Raises : PassError where no circle stands out; give `circle_px` then.
    """
    tones = _tones(picture)
    if min(tones.shape) < 32:
        raise PassError(f"a ball is not looked for in a picture of {tones.shape[1]}x{tones.shape[0]}; give its circle_px = [x, y, radius]")
    step = max(1, max(tones.shape) // SEARCH_SIDE)
    small = _blurred(_shrunk(tones, step))
    gy, gx = (np.asarray(g, dtype=np.float64) for g in np.gradient(small))
    size: Float64 = np.hypot(gx, gy)
    strong = size > max(float(np.percentile(size, 75)), 1e-6)
    ys, xs = np.nonzero(strong)
    if len(ys) < 40:
        raise PassError("no ball was found: the picture is nearly even; give its circle_px = [x, y, radius]")
    steep = size[strong]
    weight: Float64 = np.minimum(steep, float(np.percentile(steep, 70)))
    ux, uy = gx[strong] / steep, gy[strong] / steep
    h, w = small.shape
    best = (-1.0, 0.0, 0.0, 0.0)
    for radius in np.arange(max(6.0, SMALLEST * min(h, w)), LARGEST * min(h, w), 1.0):
        for sign in (1, -1):
            cx, cy = np.rint(xs + sign * radius * ux).astype(int), np.rint(ys + sign * radius * uy).astype(int)
            inside = (cx >= 0) & (cy >= 0) & (cx < w) & (cy < h)
            votes = np.bincount(cy[inside] * w + cx[inside], weights=weight[inside], minlength=h * w).reshape(h, w)
            # A gradient's direction is off by a share of the radius; the larger of two equally whole circles is the outline.
            wide = 2 * round(0.04 * radius) + 3
            votes = ndimage.uniform_filter(votes.astype(np.float64), wide, mode="constant") * wide**2 / radius
            y, x = np.unravel_index(int(votes.argmax()), votes.shape)
            if votes[y, x] > best[0]:
                best = (float(votes[y, x]), float(x), float(y), float(radius))
    return _tightened(_blurred(tones), (best[1] + 0.5) * step - 0.5, (best[2] + 0.5) * step - 0.5, best[3] * step, step)


def _tightened(tones: Float64, x: float, y: float, radius: float, step: int) -> tuple[float, float, float]:
    """The circle through the strongest radial edges near the one given, those far from it having no say."""
    a = np.arange(RAYS) / RAYS * 2 * np.pi
    ca, sa = np.cos(a), np.sin(a)
    support = 0.0
    for reach in (max(3.0, 2.5 * step, 0.06 * radius), max(3.0, 1.5 * step), 4.0):
        r = np.arange(radius - reach - 1, radius + reach + 1.01, 0.25)
        place = np.stack([x + r[:, None] * ca, y + r[:, None] * sa], axis=-1)
        along = sampled(tones[..., None], place)[..., 0]
        inside = (place[..., 0] >= 0) & (place[..., 1] >= 0) & (place[..., 0] <= tones.shape[1] - 1) & (place[..., 1] <= tones.shape[0] - 1)
        edge = np.abs(along[4:] - along[:-4]) * (inside[4:] & inside[:-4])
        at = r[2:-2][edge.argmax(axis=0)]
        size = edge.max(axis=0)
        good = size > max(0.25 * float(np.median(size)), 1e-3)
        px, py = x + at * ca, y + at * sa
        for _ in range(8):
            off = np.abs(np.hypot(px - x, py - y) - radius)
            near = np.where(good, 1 / (1 + (off / max(float(np.median(off)), 0.1)) ** 2), 0)
            A = np.stack([2 * px, 2 * py, np.ones(RAYS)], axis=1) * near[:, None]
            (x, y, k), *_ = np.linalg.lstsq(A, (px * px + py * py) * near, rcond=None)
            radius = float(np.sqrt(max(k + x * x + y * y, 1.0)))
        support = float((good & (np.abs(np.hypot(px - x, py - y) - radius) < 1.0)).mean())
    if support < SUPPORT or not (-1 < x < tones.shape[1] and -1 < y < tones.shape[0]):
        raise PassError(f"no ball was found: the best circle shows an edge along {support:.0%} of its outline; give its circle_px = [x, y, radius]")
    return float(x), float(y), radius
