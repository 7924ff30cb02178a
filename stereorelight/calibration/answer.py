"""What is known before a solve, and what comes out of it.

`Known` goes in beside the views; `Calibration` comes out, with every corner's error and everything that was left out.
Frames: camera frames (x right, y down, z forward).  Pixels: (0, 0) is the centre of the top-left pixel.  Metres, degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.calibration import start
from stereorelight.calibration.bundle import Fit
from stereorelight.calibration.sightings import StereoViews
from stereorelight.camera import Eye, Rig
from stereorelight.errors import RigError

EYES: tuple[Eye, Eye] = ("left", "right")


@dataclass(frozen=True, kw_only=True, eq=False)
class Known:
    """What is known before the solve; everything is optional.

    baseline_m : (metres, one sigma) measured between the lenses' entrance pupils.
    focal_px   : (left, right), each (pixels, one sigma) or None; `focal_from_lens` makes one from a lens and a sensor.
    rig        : the same rig from another day: its lenses are kept as they are and only the pose is solved.
    """

    baseline_m: tuple[float, float] | None = None
    focal_px: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)
    rig: Rig | None = None

    def __post_init__(self) -> None:
        for name, pair in (("baseline_m", self.baseline_m), ("focal_px", self.focal_px[0]), ("focal_px", self.focal_px[1])):
            if pair is not None and not (pair[0] > 0 and pair[1] > 0 and np.isfinite(pair).all()):
                raise RigError(f"{name} must be a value and its sigma, both > 0, got {pair}")


NOTHING_KNOWN = Known()


def focal_from_lens(focal_mm: float, sensor_width_mm: float, size: tuple[int, int], *, sigma: float = 0.02) -> tuple[float, float]:
    """Focal length in pixels and its one sigma; printed focal lengths are true to about two per cent at infinity."""
    if not (focal_mm > 0 and sensor_width_mm > 0):
        raise RigError(f"focal length and sensor width must be > 0 mm, got {focal_mm:g} and {sensor_width_mm:g}")
    focal = size[0] * focal_mm / sensor_width_mm
    return focal, sigma * focal


@dataclass(frozen=True, kw_only=True)
class Outlier:
    """Corners that the solve left out.  `ids` () means the whole picture of that eye.  `error_px` is their RMS."""

    view: int
    name: str
    eye: Eye
    ids: tuple[int, ...]
    error_px: float
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """A solved rig and what is known about how good it is.

    rig              : the rig; `quality` is filled in by `validate`.
    lenses           : names of the lens models, left and right (`projection.LENSES`).
    fit              : the solution, with the solver's own matrices.
    residual_px      : (2, V, n, 2) projected minus seen for every corner that was given, also those left out; NaN where unseen.
    kept             : (2, V, n) which corners the solve used.
    outliers         : what was left out, and why.
    rms_px           : length of the error over the kept corners, as OpenCV counts it: sqrt(mean(dx^2 + dy^2)).
    rms_all_px       : the same over all corners that were given, with the same rig.
    rms_before_px    : over all corners, for the plain solve in which every corner counts.
    view_rms_px      : (2, V) of all corners; view_rms_before_px the same before anything was left out.
    sigma_px         : one sigma of a corner along one axis, in pixels at the median corner.
    view_excess      : by how much the views scatter more than their corners' noise explains; 1 where they do not.
    covariance       : of the rig's unknowns `names`, scaled by both; 0 for what was held fixed.
    board_m          : (n, 3) the corners as the board has them; its plan where the board was taken as true.
    """

    rig: Rig
    lenses: tuple[str, str]
    views: StereoViews
    known: Known
    fit: Fit
    residual_px: Float64
    kept: Bool
    outliers: tuple[Outlier, ...]
    rms_px: float
    rms_all_px: float
    rms_before_px: float
    view_rms_px: Float64
    view_rms_before_px: Float64
    sigma_px: float
    view_excess: float
    covariance: Float64
    board_m: Float64
    names: tuple[str, ...]

    @property
    def board_poses(self) -> Float64:
        """(V, 4, 4) left camera from board, metres."""
        out = np.tile(np.eye(4), (len(self.views), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = self.fit.state.R, self.fit.state.t_m
        return out

    @property
    def paired(self) -> Bool:
        """(V,) views of which both eyes' pictures were used."""
        return (self.kept.sum(axis=2) >= start.FEWEST_CORNERS).all(axis=0)


def rms(residual_px: Float64, used: Bool | None = None) -> float:
    """sqrt(mean(dx^2 + dy^2)) over the corners that are known and `used`; NaN where there are none."""
    squared = (residual_px**2).sum(axis=-1)
    known = np.isfinite(squared) if used is None else np.isfinite(squared) & used
    return float(np.sqrt(squared[known].mean())) if known.any() else float("nan")
