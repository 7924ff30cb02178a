"""Depth by tone under grain: photographs on slanted planes and balls, their disparity known exactly, against SGBM_3WAY bs3 + WLS.

Run:  python tests/benchmarks/bench_grain.py [--scenes 10 11 12 13] [--grain clean add photon both] [--exposures 1 0.25] [--quality standard]
The photographs are those of scikit-image's wheel; a wall, ground that is dark and plain, and five balls, 640 x 400, drawn by the scene's
number.  Grain of linear light, 1 at white of the photographs: `add` 0.4 %, `photon` 2 % at white, `both` 0.3 % and 2 %.  Prints, for all
of what both eyes see and by tone (0..255, the square root of light): its share, bad2 of ours and of the yardstick, confidence told and the
share within 1 px, and 68 % of the errors over the mean disparity_sigma; then the share within 1 px among those told 0-0.2, 0.2-0.4 ..."""

from __future__ import annotations

import argparse
from itertools import pairwise

import cv2
import numpy as np
import skimage.data

from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import QUALITIES, DepthSettings
from stereorelight.synth.rigs import parallel_rig
from stereorelight.threads import set_threads
from tests.benchmarks.bench_depth import linear, yardstick

W, H, FINER = 640, 400, 2
NEAREST_PX, FARTHEST_PX = 75.0, 2.0
PHOTOGRAPHS = (
    "coffee",
    "astronaut",
    "chelsea",
    "rocket",
    "gravel",
    "grass",
    "brick",
    "camera",
    "hubble_deep_field",
    "retina",
    "immunohistochemistry",
)
GRAIN = {"clean": (0.0, 0.0), "add": (0.004**2, 0.0), "photon": (0.0, 0.0004), "both": (0.003**2, 0.0004)}  # floor + shot * light
TONES = (0, 24, 48, 96, 256)
Layer = tuple[tuple[float, ...], tuple[str, float, float, float]]  # where it lies; photograph, zoom, gain and contrast


def layers(number: int) -> list[Layer]:
    """A wall and ground, (disparity at the middle, slopes, first row), and balls, (x, y, radius, disparity at the rim, bulge)."""
    rng = np.random.default_rng(100 + number)

    def photograph() -> str:
        return PHOTOGRAPHS[rng.integers(len(PHOTOGRAPHS))]

    wall = (8 + 6 * rng.random(), rng.uniform(-0.004, 0.01), rng.uniform(-0.004, 0.01), 0.0)
    out: list[Layer] = [(wall, (photograph(), rng.uniform(1.1, 2), rng.uniform(0.5, 1), 1.0))]
    ground = (16 + 4 * rng.random(), rng.uniform(-0.004, 0.004), 0.03 + 0.03 * rng.random(), H * 0.68)
    out.append((ground, (photograph(), rng.uniform(1.1, 2), rng.uniform(0.01, 0.06), rng.uniform(0.08, 0.3))))
    for _ in range(5):
        radius = rng.uniform(30, 80)
        ball = (rng.uniform(40, W - 40), rng.uniform(40, H - 40), radius, rng.uniform(25, 50), radius * rng.uniform(0.03, 0.1))
        out.append((ball, (photograph(), rng.uniform(0.7, 1.8), 10 ** rng.uniform(-1.7, 0), rng.uniform(0.3, 1))))
    return out


def painted(u: np.ndarray, v: np.ndarray, name: str, zoom: float, gain: float, contrast: float) -> np.ndarray:
    """Light of a photograph at (u, v), mirrored at its borders."""
    photograph = getattr(skimage.data, name)()
    photograph = linear(np.repeat(photograph[..., None], 3, axis=2) if photograph.ndim == 2 else photograph[..., :3])
    photograph = photograph.mean(axis=(0, 1)) * (1 - contrast) + contrast * photograph
    at = [np.abs((c / zoom) % (2 * n - 2)) for c, n in ((u, photograph.shape[1]), (v, photograph.shape[0]))]
    x, y = (np.minimum(c, 2 * n - 2 - c).astype(np.float32) for c, n in zip(at, photograph.shape[1::-1], strict=True))
    return gain * cv2.remap(photograph.astype(np.float32), x, y, cv2.INTER_CUBIC)


def rendered(number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Left and right plates, the left eye's disparity, and what both eyes see."""
    w, h = W * FINER, H * FINER
    X, Y = np.meshgrid((np.arange(w) + 0.5) / FINER - 0.5, (np.arange(h) + 0.5) / FINER - 0.5)
    front = [np.full((h, w), -1.0) for _ in range(2)]
    light = [np.zeros((h, w, 3), np.float32) for _ in range(2)]
    for i, (place, paint) in enumerate(layers(number)):
        if len(place) == 4:
            a, b, c, row = place
            offset = a - b * W / 2 + c * (Y - (row or H / 2))
            left = offset + b * X
            from_right = (X + offset) / (1 - b)
            inside = [row <= Y if row else Y > -1.0] * 2
        else:
            rim, bulge = place[3:]

            def over(x: np.ndarray, at: tuple[float, ...] = place) -> np.ndarray:
                return 1 - ((x - at[0]) ** 2 + (Y - at[1]) ** 2) / at[2] ** 2

            left, from_right = rim + bulge * np.sqrt(np.maximum(over(X), 0)), X + rim
            for _ in range(60):
                from_right = 0.5 * (from_right + X + rim + bulge * np.sqrt(np.maximum(over(from_right), 0)))
            inside = [over(X) > 0, over(from_right) > 0]
        shift = 37.0 * i
        for eye, x, disparity in ((0, X, left), (1, from_right, from_right - X)):
            nearer = inside[eye] & (disparity > front[eye])
            front[eye][nearer] = disparity[nearer]
            light[eye][nearer] = painted(x + shift + 700, Y + shift, *paint)[nearer]
    small = [cv2.resize(p, (W, H), interpolation=cv2.INTER_AREA) for p in light]
    disparity = front[0][FINER // 2 :: FINER, FINER // 2 :: FINER]
    lands = np.arange(W) - disparity
    there = np.clip(np.rint((lands + 0.5) * FINER - 0.5).astype(int), 0, w - 1)
    seen = (lands > 0) & (np.abs(front[1][np.arange(H)[:, None] * FINER + FINER // 2, there] - disparity) < 0.75)
    return small[0], small[1], disparity.astype(np.float32), seen


def coded(light: np.ndarray) -> np.ndarray:
    """8-bit sRGB codes, BGR."""
    x = np.clip(light, 0, 1)
    code = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.ascontiguousarray(np.rint(255 * code).astype(np.uint8)[..., ::-1])


def told(name: str, rows: np.ndarray) -> None:
    """`rows` (5, n): tone, our error, the yardstick's, confidence and sigma of each pixel."""
    tone, error, other, sure, sigma = rows
    bins = [("all", tone >= 0), *((f"{low}-", (tone >= low) & (tone < high)) for low, high in pairwise(TONES))]
    for title, part in bins:
        if part.sum() > 200:
            e = error[part]
            print(
                f"{name:14s} {title:4s} {100 * part.mean():3.0f} %  bad2 {100 * (e > 2).mean():5.2f}, WLS {100 * (other[part] > 2).mean():5.2f}  "
                f"told {sure[part].mean():.2f}, right {(e <= 1).mean():.2f}  68 % over sigma {np.quantile(e, 0.683) / sigma[part].mean():.2f}",
                flush=True,
            )
    curve = [error[(sure >= low) & (sure < low + 0.2)] for low in (0, 0.2, 0.4, 0.6, 0.8)]
    print(f"{name:14s} right by told:  " + "  ".join(f"{(e <= 1).mean():.2f}" if e.size else "-" for e in curve), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, nargs="+", default=[10, 11, 12, 13])
    parser.add_argument("--grain", nargs="+", default=list(GRAIN), choices=GRAIN)
    parser.add_argument("--exposures", type=float, nargs="+", default=[1.0, 0.25])
    parser.add_argument("--quality", default="standard", choices=QUALITIES)
    asked = parser.parse_args()
    set_threads()
    rectified = rectification(parallel_rig((W, H)))
    per = rectified.rig.left.fx * rectified.rig.baseline_m
    settings = DepthSettings(quality=asked.quality, near_m=per / NEAREST_PX, far_m=per / FARTHEST_PX)
    pairs = {number: rendered(number) for number in asked.scenes}
    grainy = []
    for kind in asked.grain:
        floor, shot = GRAIN[kind]
        for exposure in asked.exposures if kind != "clean" else [1.0]:
            rows = []
            for number, (left, right, disparity, seen) in pairs.items():
                rng = np.random.default_rng(1000 * number + 7)
                plates = []
                for light in (exposure * left, exposure * right):
                    plates.append((light + np.sqrt(np.maximum(floor + shot * light, 0)) * rng.standard_normal(light.shape)).astype(np.float32))
                found = recover(*plates, rectified, settings=settings).rectified
                other = yardstick(*(coded(p / exposure) for p in plates))
                white = 1.25 * np.quantile(left.max(axis=-1), 0.99)
                tone = 255 * np.sqrt(np.clip(left.mean(axis=-1) / white, 0, 1))
                errors = (np.abs(d - disparity) for d in (found["disparity"], other))
                rows.append(np.stack([a[seen] for a in (tone, *errors, found["confidence"], found["disparity_sigma"])]))
            told(f"{kind} x {exposure:g}", np.concatenate(rows, axis=1))
            grainy += rows if kind != "clean" else []
    if grainy:
        told("all grain", np.concatenate(grainy, axis=1))


if __name__ == "__main__":
    main()
