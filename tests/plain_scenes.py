"""Plain things between strong rims: boards of bare squares, stripes, tiles, doors and cards before photographs, as a cheap camera gives them.

In: a number.  Out: both plates, 640 x 400, scene-linear, the left eye's disparity, px, known exactly, and what both eyes see.
Each eye is blurred, lit unevenly and in its own way, given noise, and compressed as JPEG, grey or colour."""

from __future__ import annotations

import cv2
import numpy as np

from tests.benchmarks.bench_depth import linear
from tests.benchmarks.bench_grain import PHOTOGRAPHS, painted

W, H, FINER = 640, 400, 3
FILLED, LARGE = 100, 200
KINDS = ("squares", "squares", "stripes", "tiles", "frames", "bare")
Layer = tuple[tuple[float, ...], tuple[float, ...], tuple]  # disparity at the middle, slopes; where it lies (none: everywhere); what is on it


def pattern(kind: str, u: np.ndarray, v: np.ndarray, side: float, dark: float, light: float) -> np.ndarray:
    """Light at (u, v) px of the thing's own plane."""
    if kind == "squares":
        return np.where((np.floor(u / side) + np.floor(v / side)) % 2 > 0, light, dark)
    if kind == "stripes":
        return np.where(np.floor(u / side) % 2 > 0, light, dark)
    if kind == "tiles":
        return np.where((u % (2 * side) < 3) | (v % (2 * side) < 3), dark, light)
    if kind == "frames":
        a, b = u % (3.1 * side) - 1.5 * side, v % (2.3 * side) - 1.1 * side
        return np.where(np.maximum(np.abs(a) / 1.3, np.abs(b)) < 0.62 * side, dark, light)
    return np.full_like(u, light)


def _layers(number: int, rng: np.random.Generator) -> list[Layer]:
    """A wall with a photograph on it, and one to three plain things; odd ones have a board of squares; from `FILLED` on it fills the frame,
    from `LARGE` on with large squares."""
    wall = (4 + 12 * rng.random(), rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01))
    photograph = PHOTOGRAPHS[rng.integers(len(PHOTOGRAPHS))]
    layers: list[Layer] = [(wall, (), (photograph, rng.uniform(1.1, 2), rng.uniform(0.3, 1), rng.uniform(0.2, 1)))]
    for k in range(rng.integers(1, 4)):
        kind = KINDS[rng.integers(len(KINDS))] if k else ("squares" if number % 2 else KINDS[2 + rng.integers(4)])
        size = rng.uniform(50, 140) if k else rng.uniform(90, 260)
        at = (rng.uniform(60, W - 60), rng.uniform(60, H - 60)) if k else (rng.uniform(180, W - 180), rng.uniform(120, H - 120))
        place = (rng.uniform(20, 60), rng.uniform(-0.08, 0.08), rng.uniform(-0.06, 0.06))
        turn = rng.uniform(-0.35, 0.35) if rng.random() < 0.6 else rng.uniform(-0.03, 0.03)
        paint = (kind, rng.uniform(14, 45), rng.uniform(0.01, 0.12), rng.uniform(0.25, 0.75))
        if number >= FILLED and k == 0:
            size, at, turn = rng.uniform(240, 320), (W / 2 + rng.uniform(-40, 40), H / 2 + rng.uniform(-30, 30)), rng.uniform(-0.3, 0.3)
            large = number >= LARGE
            paint = ("squares" if number % 3 or large else "frames", rng.uniform(36, 64) if large else rng.uniform(26, 46), *paint[2:])
        layers.append((place, (*at, size, size * rng.uniform(0.5, 0.9), turn, rng.uniform(0, 14)), paint))
    return layers


def _seen_by(eyes: list[np.ndarray], rng: np.random.Generator) -> list[np.ndarray]:
    """Both eyes' light through a soft lens, uneven light, a noisy sensor and a compressor."""
    blur, uneven, noise = rng.uniform(0.3, 1.1), rng.uniform(0, 0.08), rng.uniform(0.001, 0.008)
    quality, gain, grey = int(rng.integers(70, 97)), rng.uniform(0.85, 1.15), rng.random() < 0.5
    plates = []
    for eye, light in enumerate(eyes):
        low = cv2.resize(rng.standard_normal((4, 6)), (W, H), interpolation=cv2.INTER_CUBIC)
        middle = cv2.GaussianBlur(rng.standard_normal((H, W)), (0, 0), 12)
        lit = 1 + uneven * low + 0.4 * uneven * middle / middle.std()
        picture = cv2.GaussianBlur(light, (0, 0), blur) * lit[..., None] * (gain if eye else 1)
        code = np.clip(picture, 0, 1) ** (1 / 2.2) + noise * rng.standard_normal(picture.shape)
        bgr = np.ascontiguousarray(np.rint(np.clip(code, 0, 1) * 255).astype(np.uint8)[..., ::-1])
        if grey:
            bgr = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
        written = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        plates.append(linear(cv2.imdecode(written, cv2.IMREAD_COLOR)))
    return plates


def plain_pair(number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Left and right plates, the left eye's disparity, and what both eyes see."""
    rng = np.random.default_rng(500 + number)
    w, h = W * FINER, H * FINER
    X, Y = np.meshgrid((np.arange(w) + 0.5) / FINER - 0.5, (np.arange(h) + 0.5) / FINER - 0.5)
    front = [np.full((h, w), -1.0) for _ in range(2)]
    eyes = [np.zeros((h, w, 3), np.float32) for _ in range(2)]
    for (a, b, c), box, paint in _layers(number, rng):
        middle_x, middle_y = box[:2] if box else (W / 2, H / 2)
        offset = a - b * middle_x + c * (Y - middle_y)
        for eye, x in enumerate((X, (X + offset) / (1 - b))):
            disparity = offset + b * x
            if box:
                _, _, wide, high, turn, rim = box
                u = np.cos(turn) * (x - middle_x) + np.sin(turn) * (Y - middle_y)
                v = -np.sin(turn) * (x - middle_x) + np.cos(turn) * (Y - middle_y)
                nearer = (np.abs(u) < wide) & (np.abs(v) < high) & (disparity > front[eye])
                grey = pattern(paint[0], u + 1000, v + 1000, *paint[1:])
                grey = np.where(np.maximum(np.abs(u) - wide, np.abs(v) - high) > -rim, paint[3], grey)
                eyes[eye][nearer] = grey[nearer][:, None]
            else:
                nearer = disparity > front[eye]
                eyes[eye][nearer] = painted(x + 700, Y, *paint)[nearer]
            front[eye][nearer] = disparity[nearer]
    left = front[0][FINER // 2 :: FINER, FINER // 2 :: FINER]
    lands = np.arange(W) - left
    there = np.clip(np.rint((lands + 0.5) * FINER - 0.5).astype(int), 0, w - 1)
    seen = (lands > 0) & (np.abs(front[1][np.arange(H)[:, None] * FINER + FINER // 2, there] - left) < 0.75)
    plates = _seen_by([cv2.resize(p, (W, H), interpolation=cv2.INTER_AREA) for p in eyes], rng)
    return plates[0], plates[1], left.astype(np.float32), seen
