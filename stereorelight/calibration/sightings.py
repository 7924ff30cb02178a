"""What a calibration starts from: which corners of the board each eye saw, view by view.

In: detections (anything with `ids`, `px` and `sigma_px`).  Out: a `StereoViews`, and the dense arrays that the solver works on.
Pixels: (0, 0) is the centre of the top-left pixel.  A mirrored eye's corners are those of its flipped-back picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Eye
from stereorelight.errors import RigError

SIGMA_FLOOR_PX = 0.03  # no corner counts as surer than this: the board, the lens model and the light are not


class Sighting(Protocol):
    """Corners of one picture: `ids` (n,) rows of the board's points, `px` (n, 2), `sigma_px` a number or (n,)."""

    @property
    def ids(self) -> Any: ...
    @property
    def px(self) -> Any: ...
    @property
    def sigma_px(self) -> Any: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Corners of one picture, made by hand; a `corners.Detection` serves as well."""

    ids: Any
    px: Any
    sigma_px: Any = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoViews:
    """Views of one board by two eyes at the same moments.

    points_m    : (n, 3) the board's corners, metres, z = 0.
    left, right : what each eye saw, view by view; None where it saw nothing.  A view of one eye alone still helps that eye.
    names       : what to call the views in reports; their numbers by default.
    mirrored    : the eye behind the beam-splitter's mirror, whose pictures were flipped back before detection.
    Raises      : RigError for views that do not fit the board or each other.
    """

    points_m: Float64
    left: Sequence[Sighting | None]
    right: Sequence[Sighting | None]
    names: Sequence[str] = ()
    mirrored: Eye | None = None
    px: Float64 = field(init=False)
    sigma_px: Float64 = field(init=False)

    def __post_init__(self) -> None:
        points = np.array(self.points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
            raise RigError(f"a board must be at least four corners (n, 3) in metres, got shape {points.shape}")
        if len(self.left) != len(self.right):
            raise RigError(f"both eyes need the same views, got {len(self.left)} and {len(self.right)}; write None where an eye saw nothing")
        names = tuple(self.names) or tuple(str(v + 1) for v in range(len(self.left)))
        if len(names) != len(self.left):
            raise RigError(f"{len(self.left)} views need as many names, got {len(names)}")
        px = np.full((2, len(self.left), len(points), 2), np.nan)
        sigma = np.full(px.shape[:3], np.nan)
        for eye, sightings in enumerate((self.left, self.right)):
            for v, seen in enumerate(sightings):
                if seen is None:
                    continue
                ids, at = np.asarray(seen.ids, dtype=np.int64), np.asarray(seen.px, dtype=np.float64)
                if ids.ndim != 1 or at.shape != (len(ids), 2) or (len(ids) and (ids.min() < 0 or ids.max() >= len(points))):
                    raise RigError(f"view {names[v]}: corners {at.shape} with ids {ids.shape} do not fit a board of {len(points)} corners")
                px[eye, v, ids] = at
                sigma[eye, v, ids] = np.broadcast_to(np.asarray(seen.sigma_px, dtype=np.float64), ids.shape)
        sigma = np.where(np.isfinite(px[..., 0]) & ~(sigma > 0), np.nanmedian(sigma) if np.isfinite(sigma).any() else 1.0, sigma)
        put = object.__setattr__
        for name, value in (("points_m", points), ("names", names), ("px", px), ("sigma_px", np.hypot(sigma, SIGMA_FLOOR_PX))):
            put(self, name, value)

    def __len__(self) -> int:
        return len(self.left)


def flipped_back(sighting: Sighting, width: int) -> Corners:
    """Corners found in a mirrored eye's raw picture of `width` pixels, as in the picture flipped back left-right."""
    px = np.array(sighting.px, dtype=np.float64)
    px[:, 0] = width - 1 - px[:, 0]
    return Corners(ids=sighting.ids, px=px, sigma_px=sighting.sigma_px)
