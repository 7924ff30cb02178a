"""Two rigs against each other: how many pixels apart they are, over the frame and at given distances.

In: two `Rig`s, a result and a truth.  Out: `RigDifference`, maps on a grid over the frame and their figures.
Frames: camera frames (x right, y down, z forward).  Pixels: of the truth's plates.  Everything is result minus truth.

An eye alone: where the result's lens puts the ray that the truth's lens has through a pixel; as they stand, and after turning
one against the other to fit best, since a principal point that moved and a camera that was turned look alike in most of a
picture (the difference of projections of mrcal, by a rotation alone: at infinity).
The pair: what the truth's plates would be to the result: points at a distance are seen by the truth's eyes, and read by the
result's: by how much its rows disagree (vertical), its disparity is off, and its depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, Eye, Rig
from stereorelight.errors import RigError

DISTANCES_M = (1.0, 2.0, 5.0)
COLUMNS = 33  # of the grid: lenses bend slowly
TURN_STEPS = 20
TURNED = 1e-12  # radians
NUDGE = 1e-6  # radians, for derivatives


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Sizes over the frame: mean, 95 % and largest of the absolute values, the middle with its sign, and the share with an answer."""

    mean: float
    p95: float
    largest: float
    middle: float
    cover_percent: float

    def to_dict(self, unit: str) -> dict[str, float | None]:
        """Plain numbers for JSON, None where there is none."""
        values = {f"{name}_{unit}": getattr(self, name) for name in ("mean", "p95", "largest", "middle")} | {"cover_percent": self.cover_percent}
        return {key: value if math.isfinite(value) else None for key, value in values.items()}


def spread(values: Float64) -> Spread:
    """Of a map, NaN where there is no answer; vectors (..., 2) count by their length, and have no middle with a sign."""
    lengths = np.hypot(values[..., 0], values[..., 1]) if values.ndim == 3 else np.abs(values)
    known = np.isfinite(lengths)
    cover = 100 * float(known.mean())
    if not known.any():
        return Spread(mean=math.nan, p95=math.nan, largest=math.nan, middle=math.nan, cover_percent=cover)
    sizes = lengths[known]
    middle = np.median(sizes if values.ndim == 3 else values[known])
    return Spread(
        mean=float(sizes.mean()), p95=float(np.quantile(sizes, 0.95)), largest=float(sizes.max()), middle=float(middle), cover_percent=cover
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class EyeDifference:
    """One eye's lens against the other rig's, at infinity.

    pixels    : (rows, columns, 2) where on the truth's plate.
    apart_px  : (rows, columns, 2) where the result sees the same ray, less `pixels`; NaN beyond either lens model's reach.
    turned_px : the same after the turn that fits best over the frame.
    turn_deg  : (3,) that turn, as a rotation vector: about x (down-up), y (left-right), z (roll).
    """

    pixels: Float64
    apart_px: Float64
    turned_px: Float64
    turn_deg: Float64

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "as_it_stands": spread(self.apart_px).to_dict("px"),
            "turned_to_fit": spread(self.turned_px).to_dict("px"),
            "turn_deg": self.turn_deg.tolist(),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class PairDifference:
    """What the result makes of the truth's plates of a plane `distance_m` along the left axis; maps on the left eye's grid.

    vertical_px  : by how much the point lies lower in the right picture than in the left one, rows as the result rectifies them.
    disparity_px : found less needed, pixels of the left plate.      depth_mm : Z found less true.
    NaN where the right eye does not see the point.
    """

    distance_m: float
    vertical_px: Float64
    disparity_px: Float64
    depth_mm: Float64

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "distance_m": self.distance_m,
            "vertical": spread(self.vertical_px).to_dict("px"),
            "disparity": spread(self.disparity_px).to_dict("px"),
            "depth": spread(self.depth_mm).to_dict("mm"),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class RigDifference:
    """Two rigs apart.

    baseline_mm : of the result and of the truth.
    turn_deg    : angle between the two poses of the right eye against the left.
    lean_deg    : angle between the two baselines, seen from the left eye.
    words       : what was noticed, one sentence each.
    """

    left: EyeDifference
    right: EyeDifference
    pairs: tuple[PairDifference, ...]
    baseline_mm: tuple[float, float]
    turn_deg: float
    lean_deg: float
    words: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "left": self.left.to_dict(),
            "right": self.right.to_dict(),
            "at": [pair.to_dict() for pair in self.pairs],
            "baseline_mm": list(self.baseline_mm),
            "turn_deg": self.turn_deg,
            "lean_deg": self.lean_deg,
            "words": list(self.words),
        }

    def text(self) -> str:
        """The same for people."""
        lines = [f"{'':24}{'mean':>9}{'95 %':>9}{'largest':>9}{'middle':>10}{'cover':>8}"]

        def row(name: str, values: Float64, unit: str) -> None:
            s = spread(values)
            middle = "" if values.ndim == 3 else f"{s.middle:+.3f}"
            lines.append(f"{name:24}{s.mean:9.3f}{s.p95:9.3f}{s.largest:9.3f}{middle:>10}{s.cover_percent:7.0f}% {unit}")

        for name, eye in (("left", self.left), ("right", self.right)):
            row(f"{name} lens, as it stands", eye.apart_px, "px")
            row(f"{name} lens, turned to fit", eye.turned_px, f"px, turned {np.linalg.norm(eye.turn_deg):.4f} degrees")
        for pair in self.pairs:
            row(f"rows at {pair.distance_m:g} m", pair.vertical_px, "px")
            row(f"disparity at {pair.distance_m:g} m", pair.disparity_px, "px")
            row(f"depth at {pair.distance_m:g} m", pair.depth_mm, "mm")
        a, b = self.baseline_mm
        baseline = f"baseline {a:.3f} mm against {b:.3f} mm ({round(a - b, 6) + 0.0:+.3f}), leaning {self.lean_deg:.4f} degrees"
        lines.append(f"pose: right eye turned {self.turn_deg:.4f} degrees, {baseline}")
        return "\n".join([*lines, *self.words])


def compare_rigs(result: Rig, truth: Rig, *, distances_m: Sequence[float] = DISTANCES_M, columns: int = COLUMNS) -> RigDifference:
    """How far apart `result` and `truth` are.

    distances_m : from the left eye along its axis, at which the pair is judged.      columns : of the grid of maps.
    Raises      : RigError where the pictures' shapes differ, or for a distance that is none.
    """
    for z in distances_m:
        if not (math.isfinite(z) and z > 0):
            raise RigError(f"a distance must be > 0 metres, got {z:g}")
    words = []
    if result.mirrored != truth.mirrored:
        words.append(f"mirrored differs ({result.mirrored or 'none'} against {truth.mirrored or 'none'}); the flipped-back pictures are compared")
    fitted: dict[Eye, Camera] = {}
    for eye in ("left", "right"):
        a, b = result.camera(eye), truth.camera(eye)
        if a.size[0] * b.size[1] != a.size[1] * b.size[0]:
            raise RigError(f"the {eye} eye's plates are {a.size[0]}x{a.size[1]} and {b.size[0]}x{b.size[1]}: of one rig they have one shape")
        if a.size != b.size:
            words.append(f"the {eye} eye was calibrated at {a.size[0]}x{a.size[1]}; it is compared at {b.size[0]}x{b.size[1]}")
        fitted[eye] = a.scaled(b.size) if a.size != b.size else a
    result = replace(result, left=fitted["left"], right=fitted["right"])
    across = (rig.right_centre_m / rig.baseline_m for rig in (result, truth))
    return RigDifference(
        left=eye_difference(result.left, truth.left, columns=columns),
        right=eye_difference(result.right, truth.right, columns=columns),
        pairs=tuple(pair_difference(result, truth, z, columns=columns) for z in distances_m),
        baseline_mm=(1000 * result.baseline_m, 1000 * truth.baseline_m),
        turn_deg=_angle_deg(result.R_right_left @ truth.R_right_left.T),
        lean_deg=_between_deg(*across),
        words=tuple(words),
    )


def _grid(size: tuple[int, int], columns: int) -> Float64:
    w, h = size
    rows = max(3, round(columns * h / w))
    return np.stack(np.meshgrid(np.linspace(0, w - 1, columns), np.linspace(0, h - 1, rows)), axis=-1)


def _angle_deg(R: Float64) -> float:
    """Angle of a rotation; by its sine where it is small, for the cosine loses half the digits there."""
    sine = math.sqrt((R[2, 1] - R[1, 2]) ** 2 + (R[0, 2] - R[2, 0]) ** 2 + (R[1, 0] - R[0, 1]) ** 2) / 2
    return math.degrees(math.atan2(sine, (float(np.trace(R)) - 1) / 2))


def _between_deg(a: Float64, b: Float64) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


def _rotation(v: Float64) -> Float64:
    """(3, 3) rotation by |v| radians about v (Rodrigues)."""
    angle = float(np.linalg.norm(v))
    W = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    R: Float64 = np.eye(3) + np.sinc(angle / math.pi) * W + np.sinc(angle / (2 * math.pi)) ** 2 / 2 * (W @ W)
    return R


def eye_difference(result: Camera, truth: Camera, *, columns: int = COLUMNS) -> EyeDifference:
    """One eye's lens in two calibrations of one picture size."""
    pixels = _grid(truth.size, columns)
    rays = truth.rays(pixels)

    def turned(turn: Float64) -> Float64:
        return result.project(rays @ _rotation(turn).T) - pixels

    turn = np.zeros(3)
    apart = best = turned(turn)
    for _ in range(TURN_STEPS):
        slopes = np.stack([(turned(turn + nudge) - turned(turn - nudge)) / (2 * NUDGE) for nudge in NUDGE * np.eye(3)])
        known = np.isfinite(best).all(axis=-1) & np.isfinite(slopes).all(axis=(0, -1))
        if known.sum() < 3:
            break
        step = np.linalg.lstsq(slopes[:, known].reshape(3, -1).T, -best[known].ravel(), rcond=None)[0]
        turn = turn + step
        best = turned(turn)
        if np.abs(step).max() < TURNED:
            break
    return EyeDifference(pixels=pixels, apart_px=apart, turned_px=best, turn_deg=np.degrees(turn))


def _rows(rig: Rig) -> tuple[Float64, Float64]:
    """Rotations of the left and the right eye to a frame with x along the baseline, looking where both look on average."""
    x = rig.right_centre_m / rig.baseline_m
    forward = np.array([0.0, 0.0, 1.0]) + rig.R_right_left[2]
    y = np.cross(forward, x)
    y /= np.linalg.norm(y)
    R_left = np.stack([x, y, np.cross(x, y)])
    return R_left, R_left @ rig.R_right_left.T


def pair_difference(result: Rig, truth: Rig, distance_m: float, *, columns: int = COLUMNS) -> PairDifference:
    """What `result` reads where `truth` sees a plane `distance_m` along the left axis; sizes as in `compare_rigs`."""
    pixels = _grid(truth.left.size, columns)
    points = truth.left.unproject(pixels, np.full(pixels.shape[:2], distance_m))
    right = truth.right.project(points @ truth.R_right_left.T + truth.t_right_left_m)
    w, h = truth.right.size
    with np.errstate(invalid="ignore"):
        outside = ~((right >= -0.5) & (right <= (w - 0.5, h - 0.5))).all(axis=-1)
    right[outside] = np.nan
    R_left, R_right = _rows(result)
    a, b = result.left.rays(pixels) @ R_left.T, result.right.rays(right) @ R_right.T
    f = result.left.fx
    across = f * (a[..., 0] / a[..., 2] - b[..., 0] / b[..., 2])
    needed = f * result.baseline_m / (distance_m * a[..., 2])
    with np.errstate(invalid="ignore", divide="ignore"):
        Z = np.where(across > 0, f * result.baseline_m / (across * a[..., 2]), np.nan)
    return PairDifference(
        distance_m=float(distance_m),
        vertical_px=f * (b[..., 1] / b[..., 2] - a[..., 1] / a[..., 2]),
        disparity_px=across - needed,
        depth_mm=1000 * (Z - distance_m),
    )
