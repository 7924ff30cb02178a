"""Normals against truth: angles between unit vectors, and between the normals of two disparities.

In: N (H, W, 3) unit float, or disparities (H, W), NaN where unknown.  Out: frozen figures, degrees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.camera import RectifiedRig
from stereorelight.compare.edges import grown, near_edges
from stereorelight.compare.figures import Figure, plain
from stereorelight.compare.tally import Tally
from stereorelight.errors import PassError

UNDER_DEG = (11.25, 22.5, 30.0)
WINDOW_PX = 5
JUMP_PX = 1.0  # a step of true disparity between neighbours that is no longer one surface
JUMP_Z_SHARE = 0.03  # the same where Z is known and no rig says what a pixel is
CLEAR_PX = 4  # how far from such a step, or from unknown truth, normals are judged


@dataclass(frozen=True, kw_only=True)
class NormalFigures:
    """Angles between normals and true normals, degrees.

    pixels           : how many pixels have a known true normal (and lie in the mask).
    cover_percent    : share of those that have an answer.
    mean_deg, median_deg : over answered pixels; NaN where there is none.
    under_percent    : angle to share of all those pixels that are nearer; without an answer counts as not.
    """

    pixels: int
    cover_percent: float
    mean_deg: float
    median_deg: float
    under_percent: Mapping[float, float]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, None where there is none."""
        out: dict[str, Any] = {
            "pixels": self.pixels,
            "cover_percent": self.cover_percent,
            "mean_deg": self.mean_deg,
            "median_deg": self.median_deg,
            **{f"under{limit:g}_percent": share for limit, share in self.under_percent.items()},
        }
        return {key: plain(value) if isinstance(value, float) else value for key, value in out.items()}

    def figures(self, table: str, region: str = "all") -> list[Figure]:
        """The same as figures of a row: normal_median, normal_mean, normal_under11.25, normal_cover."""
        share: dict[str, Any] = {"unit": "%", "table": table, "region": region, "digits": 2, "high_is_good": True}
        angle: dict[str, Any] = {"unit": "deg", "table": table, "region": region}
        return [
            Figure(name="normal_pixels", value=float(self.pixels), table=table, region=region, digits=0, column="pixels"),
            Figure(name="normal_cover", value=self.cover_percent, column="cover", **share),
            Figure(name="normal_median", value=self.median_deg, column="median", **angle),
            Figure(name="normal_mean", value=self.mean_deg, column="mean", **angle),
            *(Figure(name=f"normal_under{limit:g}", value=v, column=f"under {limit:g} deg,", **share) for limit, v in self.under_percent.items()),
        ]

    def text(self) -> str:
        """One calm line."""
        if not self.pixels:
            return "normals: no pixel to compare"
        under = ", ".join(f"{share:.1f} % under {limit:g}" for limit, share in self.under_percent.items())
        return f"normals: median {self.median_deg:.2f} deg, mean {self.mean_deg:.2f}; {under}; cover {self.cover_percent:.1f} % of {self.pixels}"


def angle_deg(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> Float64:
    """(...) angle between vectors (..., 3) of any length, degrees; exact for small angles, where arccos is not."""
    p, q = a.astype(np.float64), b.astype(np.float64)
    angle: Float64 = np.degrees(np.arctan2(np.linalg.norm(np.cross(p, q), axis=-1), (p * q).sum(axis=-1)))
    return angle


def normal_tally(angle: npt.NDArray[Any], known: Bool) -> Tally:
    """The tally of angles (H, W), degrees, over the pixels whose true normal is known."""
    return Tally.of(angle[known], unit="deg", thresholds=UNDER_DEG)


def normal_figures_of(tally: Tally) -> NormalFigures:
    """The figures of a tally of angles, of one frame or of many."""
    told = tally.figures()
    return NormalFigures(
        pixels=tally.pixels,
        cover_percent=told.cover_percent,
        mean_deg=told.average,
        median_deg=tally.median,
        under_percent={limit: 100 - share for limit, share in told.bad_percent.items()},
    )


def normal_error(N: npt.ArrayLike, N_true: npt.ArrayLike, *, mask: npt.ArrayLike | None = None) -> tuple[Float64, Bool]:
    """(H, W) angles between N and the truth, degrees, and where the truth is known; as `normal_figures` takes them."""
    truth = as_float32(N_true, "true N", channels=3)
    size_hw = (truth.shape[0], truth.shape[1])
    result = as_float32(N, "N to judge", channels=3, size_hw=size_hw)
    known: Bool = np.asarray(np.isfinite(truth).all(axis=-1), dtype=bool)
    if mask is not None:
        where = np.asarray(mask)
        if where.dtype != np.bool_ or where.shape != size_hw:
            raise PassError(f"mask must be bool of shape {size_hw}, got {where.dtype} {where.shape}")
        known &= where
    for name, normals in (("true N", truth), ("N to judge", result)):
        if not np.isfinite(normals).all(axis=-1).any():
            raise PassError(f"{name} is unknown at every pixel, so that N and its truth have no known pixel in common")
    angle = angle_deg(result, truth)
    if not (known & np.isfinite(angle)).any():
        raise PassError("N and its truth have no known pixel in common; do they belong to the same frame and eye?")
    return angle, known


def normal_figures(N: npt.ArrayLike, N_true: npt.ArrayLike, *, mask: npt.ArrayLike | None = None) -> NormalFigures:
    """Angles between N and the truth.

    N, N_true : (H, W, 3) float, unit, one frame, NaN where unknown.
    mask      : (H, W) bool, where to look; everywhere when None.
    Raises    : PassError for sizes that differ, and where nothing overlaps.
    """
    return normal_figures_of(normal_tally(*normal_error(N, N_true, mask=mask)))


def _box(values: Float64, weights: Float64) -> Float64:
    """Sum over rows and then columns of a window with the given (k, 2) weights: [:, 0] down, [:, 1] across; edges are NaN."""
    r = len(weights) // 2
    h, w = values.shape
    padded = np.pad(values, r, constant_values=np.nan)
    down = np.zeros((h, w + 2 * r))
    out = np.zeros((h, w))
    for k, (weight, _) in enumerate(weights):
        down += weight * padded[k : k + h]
    for k, (_, weight) in enumerate(weights):
        out += weight * down[:, k : k + w]
    return out


def disparity_normals(disparity: npt.ArrayLike, rig: RectifiedRig, *, window_px: int = WINDOW_PX) -> Float64:
    """(H, W, 3) unit normals, camera frame, pointing away from the camera, of the least-squares plane d = a u + b v + c in each window.

    N ~ (a fx, b fy, q - a (u - cx) - b (v - cy)) with q = d + cx_right - cx_left: q is inverse depth times fx b, and a plane in
    space is a plane in it.  NaN where the window is not fully known or leaves the frame.
    """
    d = as_float32(disparity, "disparity", size_hw=rig.left.size_hw).astype(np.float64)
    b, a, q = _slopes(d, window_px)
    q += rig.doffs_px
    u, v = np.arange(d.shape[1]) - rig.left.cx, (np.arange(d.shape[0]) - rig.left.cy)[:, None]
    return _unit(np.stack([a * rig.left.fx, b * rig.left.fy, q - a * u - b * v], axis=-1))


def depth_normals(Z: npt.ArrayLike, rays: Float32, *, window_px: int = WINDOW_PX) -> Float64:
    """(H, W, 3) unit normals, camera frame, pointing away from the camera, of the least-squares plane of 1 / Z in each window.

    rays : (H, W, 2) x / z and y / z of each pixel, lens undone.  1 / Z of a plane is affine in them; the window's slopes in pixels are taken
    to the rays by the lens's own Jacobian, so that any lens is right to first order.  NaN as of `disparity_normals`.
    """
    inverse = 1 / np.asarray(Z, dtype=np.float64)
    down, across, q = _slopes(inverse, window_px)
    (x_v, x_u), (y_v, y_u) = (np.gradient(rays[..., i].astype(np.float64)) for i in (0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        turned = 1 / (x_u * y_v - x_v * y_u)
    a = (across * y_v - down * y_u) * turned
    b = (down * x_u - across * x_v) * turned
    return _unit(np.stack([a, b, q - a * rays[..., 0] - b * rays[..., 1]], axis=-1))


def _unit(normal: Float64) -> Float64:
    with np.errstate(invalid="ignore"):
        unit: Float64 = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return unit


def _slopes(values: Float64, window_px: int) -> tuple[Float64, Float64, Float64]:
    """Slope down, slope across and mean of the least-squares plane of each window."""
    if window_px < 3 or window_px % 2 == 0:
        raise PassError(f"window_px must be odd and at least 3, got {window_px}")
    step = np.arange(window_px) - window_px // 2
    flat = np.full(window_px, 1 / window_px)
    slope = step / (step**2).sum()
    return tuple(_box(values, np.stack(pair, axis=-1)) for pair in ((slope, flat), (flat, slope), (flat, flat)))  # type: ignore[return-value]


def away_from_jumps(truth: npt.ArrayLike, *, jump_px: float = JUMP_PX, clear_px: int = CLEAR_PX) -> Bool:
    """(H, W) pixels with no jump of more than `jump_px` between known neighbours, and no unknown pixel, within `clear_px`."""
    t = np.asarray(truth, dtype=np.float64)
    return ~(near_edges(t, jump=jump_px, band_px=clear_px) | grown(~np.isfinite(t), clear_px))


def disparity_normal_figures(
    result: npt.ArrayLike,
    truth: npt.ArrayLike,
    rig: RectifiedRig,
    *,
    nonoccluded: npt.ArrayLike | None = None,
    window_px: int = WINDOW_PX,
    jump_px: float = JUMP_PX,
    clear_px: int = CLEAR_PX,
) -> NormalFigures:
    """Angles between the normals of a disparity and of the true one, each from its own plane fit (`disparity_normals`).

    Counted are pixels away from depth jumps (`away_from_jumps`) whose truth window is fully known; `nonoccluded` (H, W) bool
    leaves out what the other eye cannot see.  A counted pixel whose result window is not known has no answer and counts as
    wrong.  All zeros where no such pixel exists.
    """
    return normal_figures_of(
        disparity_normal_tally(result, truth, rig, nonoccluded=nonoccluded, window_px=window_px, jump_px=jump_px, clear_px=clear_px)
    )


def disparity_normal_tally(
    result: npt.ArrayLike,
    truth: npt.ArrayLike,
    rig: RectifiedRig,
    *,
    nonoccluded: npt.ArrayLike | None = None,
    window_px: int = WINDOW_PX,
    jump_px: float = JUMP_PX,
    clear_px: int = CLEAR_PX,
) -> Tally:
    """The tally behind `disparity_normal_figures`."""
    true_normals = disparity_normals(truth, rig, window_px=window_px)
    normals = disparity_normals(result, rig, window_px=window_px)
    known = away_from_jumps(truth, jump_px=jump_px, clear_px=clear_px)
    if nonoccluded is not None:
        known &= np.asarray(nonoccluded, dtype=np.bool_)
    return normal_tally(angle_deg(normals, true_normals), known & np.isfinite(true_normals).all(axis=-1))


def depth_normal_tally(Z: Float64, Z_true: Float64, rays: Float32, *, nonoccluded: Bool | None = None) -> Tally:
    """As `disparity_normal_tally`, from Z and the rays of its plate; kept away from steps of more than JUMP_Z_SHARE of Z."""
    true_normals, normals = depth_normals(Z_true, rays), depth_normals(Z, rays)
    known = away_from_jumps(np.log(Z_true), jump_px=JUMP_Z_SHARE)
    if nonoccluded is not None:
        known &= nonoccluded
    return normal_tally(angle_deg(normals, true_normals), known & np.isfinite(true_normals).all(axis=-1))
