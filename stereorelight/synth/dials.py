"""What goes wrong on set, as dials: grain, focus, exposure, colour, a rig that moved, lenses that bend, cameras out of step.

In: a rendered plate (H, W, 3), scene-linear, or a `Rig`.  Out: the plate as that camera would have recorded it, or the rig as it really
stood.  Same dials, seed, frame and eye: the same bits.  Turns and signs are those of docs/conventions.md (a rig that moved)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera, Eye, Rig
from stereorelight.errors import ShotError
from stereorelight.synth.rigs import turn

SWAY_FRAMES = 48  # of a moving camera: one sway to both sides
SWAY_M = (0.08, 0.025, 0.05)  # how far it goes: right, up, towards the scene
SWAY_DEG = (0.6, 1.5)  # and how far it tilts and pans


@dataclass(frozen=True, kw_only=True)
class Dials:
    """Everything at rest by default.

    grain, photon_grain : the sensor's noise, scene-linear: variance = grain^2 + photon_grain * light.
    blur_px             : sigma of soft focus of the left and of the right eye.
    exposure_stops      : of the right eye against the left.   cast : gains of its red, green and blue.
    pitch_deg, yaw_deg, roll_deg, zoom_percent, rise_mm : what the right eye was knocked by since calibration; rig.json does not know.
    bend                : k1 of both lenses (brown), which rig.json knows; negative is a barrel.
    right_late_frames   : the right camera shows what the left one showed so many frames before; fractions are good.
    seed                : another number, other grain.
    """

    grain: float = 0.0
    photon_grain: float = 0.0
    blur_px: tuple[float, float] = (0.0, 0.0)
    exposure_stops: float = 0.0
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0)
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    zoom_percent: float = 0.0
    rise_mm: float = 0.0
    bend: float = 0.0
    right_late_frames: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = np.asarray(getattr(self, f.name), dtype=np.float64)
            if not np.isfinite(value).all():
                raise ShotError(f"{f.name} must be finite, got {getattr(self, f.name)!r}")
        low = {"grain": 0.0, "photon_grain": 0.0}
        for name, least in low.items():
            if getattr(self, name) < least:
                raise ShotError(f"{name} must be at least {least:g}, got {getattr(self, name):g}")
        if min(self.blur_px) < 0 or max(self.blur_px) > 50:
            raise ShotError(f"blur_px must lie in 0..50, got {self.blur_px[0]:g} and {self.blur_px[1]:g}")
        if min(self.cast) <= 0:
            raise ShotError(f"cast must be three gains above 0, got {self.cast}")
        if abs(self.exposure_stops) > 10:
            raise ShotError(f"exposure_stops must lie in -10..10, got {self.exposure_stops:g}")
        if max(abs(self.pitch_deg), abs(self.yaw_deg), abs(self.roll_deg)) > 10 or abs(self.zoom_percent) > 20 or abs(self.rise_mm) > 100:
            raise ShotError("a knock is at most 10 degrees, 20 % of zoom and 100 mm; beyond it is another rig")
        if abs(self.bend) > 0.4:
            raise ShotError(f"bend, k1 of the lens, must lie in -0.4..0.4, got {self.bend:g}")

    @property
    def knocks(self) -> bool:
        """Whether the right eye stands elsewhere than rig.json says."""
        return any((self.pitch_deg, self.yaw_deg, self.roll_deg, self.zoom_percent, self.rise_mm))


def bent(rig: Rig, dials: Dials) -> Rig:
    """`rig` with both lenses bent by the dial, as calibration knows them.  Raises CameraError where a lens folds inside the frame."""
    if not dials.bend:
        return rig
    if rig.left.distorts or rig.right.distorts:
        raise ShotError("bend is for a rig of perfect lenses; this one bends by itself")

    def with_bend(camera: Camera) -> Camera:
        return replace(camera, model="brown", distortion=(dials.bend, 0.0, 0.0, 0.0))

    return replace(rig, left=with_bend(rig.left), right=with_bend(rig.right))


def knocked(rig: Rig, dials: Dials) -> Rig:
    """`rig` as it really stands: the right eye turned about its own centre, zoomed about its principal point, and raised."""
    if not dials.knocks:
        return rig
    R = turn(pitch_deg=dials.pitch_deg, yaw_deg=dials.yaw_deg, roll_deg=dials.roll_deg).T @ rig.R_right_left
    centre = rig.right_centre_m + np.array([0.0, -dials.rise_mm / 1000, 0.0])
    K = rig.right.K * np.array([[1 + dials.zoom_percent / 100], [1 + dials.zoom_percent / 100], [1.0]])
    K[:2, 2] = rig.right.K[:2, 2]
    return replace(rig, right=replace(rig.right, K=K), R_right_left=R, t_right_left_m=-R @ centre)


def swayed(rig: Rig, frame: float) -> Rig:
    """`rig` on a camera that sways: its pose at `frame`, which may lie between frames; at frame 0 it stands at the origin."""
    phase = 2 * math.pi * frame / SWAY_FRAMES
    pose = np.eye(4)
    a, b = math.radians(SWAY_DEG[0] * math.sin(2 * phase)), math.radians(-SWAY_DEG[1] * math.sin(phase))
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    pose[:3, :3] = about_y @ about_x
    pose[:3, 3] = SWAY_M[0] * math.sin(phase), SWAY_M[1] * math.sin(2 * phase), -SWAY_M[2] * (1 - math.cos(phase)) / 2
    return replace(rig, left=replace(rig.left, world_from_camera=pose))


def recorded(plate: npt.ArrayLike, eye: Eye, dials: Dials, *, frame: int = 0) -> Float32:
    """The plate (H, W, 3) as the camera records it, still scene-linear: out of focus, then by its exposure, then with its grain."""
    picture = as_float32(plate, "plate", channels=3).astype(np.float64)
    picture = softened(picture, dials.blur_px[0 if eye == "left" else 1])
    if eye == "right":
        picture *= np.array(dials.cast) * 2.0**dials.exposure_stops
    if dials.grain or dials.photon_grain:
        noise = np.random.Generator(np.random.Philox(key=[dials.seed * 1_000_003 + frame, int(eye == "right")])).standard_normal(picture.shape)
        picture += np.sqrt(dials.grain**2 + dials.photon_grain * np.maximum(picture, 0)) * noise
    return picture.astype(np.float32)


def softened(picture: Float64, sigma_px: float) -> Float64:
    """Through a Gaussian of `sigma_px`; the border goes on as it ends."""
    if sigma_px <= 0:
        return picture
    reach = max(1, math.ceil(4 * sigma_px))
    steps = np.arange(-reach, reach + 1)
    # The Gaussian's share of each pixel, so that a small sigma is right too.
    kernel = np.array([math.erf((s + 0.5) / (sigma_px * math.sqrt(2))) - math.erf((s - 0.5) / (sigma_px * math.sqrt(2))) for s in steps])
    kernel /= kernel.sum()
    for axis in (0, 1):
        pad = [(0, 0)] * picture.ndim
        pad[axis] = (reach, reach)
        wide, length = np.pad(picture, pad, mode="edge"), picture.shape[axis]
        picture = sum((k * np.take(wide, range(n, n + length), axis=axis) for n, k in enumerate(kernel)), start=np.zeros_like(picture))
    return picture
