"""Mixed pixels: hair, blur and defocus, where one pixel shows the subject and what is behind it.

In: a plate, passes and the subject's matte.  Out: the two sides apart, each with colours and geometry of its own on every pixel that it
shows in, so that each can be lit by itself and both mixed by the matte: plate = alpha F + (1 - alpha) B holds for the colours.
Geometry of a side is that of its nearest pixels that show nothing else; depth at the edge itself is a mixture of the two, and goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Bool, Float32, as_float32
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.passes import Flag

SURE = 0.98  # cover from which a pixel shows one side alone
EDGE_PX, EXACT_PX = 8.0, 1.0  # windows of matching and of normals reach so far; a renderer's passes have none
NEAR_PX = 3.0  # colours of a side are those of its surroundings, so wide
ALIKE = 0.02  # of the plate's square: colours nearer than that say nothing of cover
REACH_PX = 20.0  # how far matching fattens
EVEN_FORE_PX, EVEN_BACK_PX = (1.5,), (4.0,)  # how widely normals are evened where they stand in for others ...
EVEN_UNSURE_BACK_PX = (4.0, 8.0, 16.0, 32.0)  # ... and of recovered ones, as far as it takes to find some that are sure
SURE_DEG = 2.0  # normals are not told apart below this standard deviation
UNSURE_DEG = 40.0  # standard deviation of a normal that is not taken for its surroundings
GUESSED = int(Flag.FILLED | Flag.OCCLUDED | Flag.UNMATCHED)
LEAN = (0.05, 0.25, 0.04)  # of a normal out of its outline: where roundness begins, over what it becomes whole, and how fast it must grow
STEP = 1.06  # ratio of depths that is an edge and no slope


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """plate : (H, W, 3), the side's own colours.   passes : as given, with this side's geometry."""

    plate: Float32
    passes: dict[str, npt.NDArray[Any]]


def _colours(plate: Float32, sure: Bool, nearest: npt.NDArray[np.int64]) -> Float32:
    """(H, W, 3): the plate where `sure`; elsewhere the mean of sure pixels about the nearest one."""
    weight = sure.astype(np.float32)
    share = ndimage.gaussian_filter(weight, NEAR_PX)
    clean = np.where(sure[..., None] & np.isfinite(plate), plate, np.float32(0))
    even = np.stack([ndimage.gaussian_filter(clean[..., c], NEAR_PX) for c in range(3)], axis=-1) / np.maximum(share, 1e-6)[..., None]
    found: Float32 = np.where(sure[..., None], plate, even[tuple(nearest)]).astype(np.float32)
    return found


def edge_reach(passes: Mapping[str, npt.NDArray[Any]]) -> float:
    """How near to an edge geometry is not believed, pixels."""
    return EDGE_PX if "N_sigma" in passes else EXACT_PX


def _not_its_own(passes: Mapping[str, npt.NDArray[Any]], own: Bool, inside: npt.NDArray[np.floating], sign: float) -> Bool:
    """Ground of a side, near the edge, whose depth is a guess or the other side's: matching fattens what is in front.

    inside : pixels from the edge, > 0 on this side.    sign : 1 for what is in front, -1 for what is behind.
    """
    near = own & (inside <= REACH_PX)
    far = own & ~near
    if not far.any():
        return np.zeros(own.shape, np.bool_)
    Z = -np.asarray(passes["P"], np.float64)[..., 2]
    at = ndimage.distance_transform_edt(~far, return_distances=False, return_indices=True)
    beyond = ndimage.median_filter(np.where(np.isfinite(Z), Z, 0.0), 3)[tuple(at)]
    with np.errstate(invalid="ignore"):
        wrong = near & ((STEP * beyond < Z) if sign > 0 else (beyond > Z * STEP))
        if "flags" in passes and sign < 0:
            wrong |= near & ((np.asarray(passes["flags"]).astype(np.int64) & GUESSED) != 0)
        if "N_sigma" in passes:
            wrong |= near & (np.asarray(passes["N_sigma"]) > UNSURE_DEG)
    # Normals come from windows, so ground beside it is touched too.
    found: Bool = ndimage.binary_dilation(wrong, iterations=2)
    return found


def _evened(N: Float32, held: Bool, sigma_deg: npt.NDArray[np.floating] | None, widths_px: tuple[float, ...]) -> Float32:
    """(H, W, 3) unit: the mean of `held` normals about each pixel, near ones first, and by the fourth power of how sure each is.

    Ground beside an outline is bent by matching and says so in its sigma; what is sure may stand some way off."""
    weight = held.astype(np.float32)
    if sigma_deg is not None:
        weight = weight / (np.nan_to_num(np.asarray(sigma_deg, np.float32), nan=90.0) ** 4 + np.float32(SURE_DEG**4))
    weighed = np.where(held[..., None], N * weight[..., None], np.float32(0))
    total = np.zeros_like(N)
    for width in widths_px:  # each wider one counts less, and reaches where the others do not
        total += np.stack([ndimage.gaussian_filter(weighed[..., c], width) for c in range(3)], axis=-1) / np.float32(width)
    found: Float32 = total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-20)
    return found


def _extended(passes: Mapping[str, npt.NDArray[Any]], held: Bool, shows: Bool, widths_px: tuple[float, ...]) -> dict[str, npt.NDArray[Any]]:
    """`passes` with the geometry of the nearest `held` pixel where the side shows and is not held; N is that of its surroundings, evened."""
    at = tuple(ndimage.distance_transform_edt(~held, return_distances=False, return_indices=True))
    taken = shows & ~held
    made: dict[str, npt.NDArray[Any]] = {}
    for name, values in passes.items():
        if values.shape[:2] == held.shape:
            made[name] = np.where(taken if values.ndim == 2 else taken[..., None], values[at], values)
    N, P = np.asarray(passes["N"], np.float32), np.asarray(passes["P"], np.float32)
    even = _evened(N, held, passes.get("N_sigma"), widths_px)
    made["N"] = np.where(taken[..., None], even[at], N).astype(np.float32)
    # The pixel keeps its own ray where it has one, and takes the distance alone.
    with np.errstate(invalid="ignore", divide="ignore"):
        own_ray = P * (P[at][..., 2:] / P[..., 2:])
    made["P"] = np.where(taken[..., None], np.where(np.isfinite(own_ray).all(axis=-1, keepdims=True), own_ray, P[at]), P).astype(np.float32)
    return made


def _rounded(N: Float32, cover: Float32, edge: npt.NDArray[np.floating], held: Bool, taken: Bool, edge_px: float) -> Float32:
    """N of the subject turned outwards towards its outline, as a round thing's is: at an outline a smooth surface is seen edge on.

    A thing whose normal does not lean outwards near its edge, and more than it does farther in, is flat there, a card, and stays."""
    deep = held & (edge > 3 * (edge_px + 1))
    if not deep.any():
        return N
    farther_in = N[tuple(ndimage.distance_transform_edt(~deep, return_distances=False, return_indices=True))]
    soft = ndimage.gaussian_filter(cover, 2.0)
    out = np.stack([-ndimage.sobel(soft, axis=1), ndimage.sobel(soft, axis=0)], axis=-1)  # y is up
    out = out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-9)
    leans = (N[..., :2] * out).sum(axis=-1)
    grows = leans - (farther_in[..., :2] * out).sum(axis=-1)
    t = np.clip((leans - LEAN[0]) / LEAN[1], 0, 1) * np.clip(grows / LEAN[2], 0, 1)
    share = t * t * (3 - 2 * t) * (taken & (edge < edge_px + 1))
    fall = np.sqrt(np.clip(edge / (edge_px + 1), 0.04, 1))  # of a sphere: the facing part grows with the root of the distance
    facing = np.maximum(N[..., 2], 0.05) * fall
    side = N[..., :2] / np.maximum(np.linalg.norm(N[..., :2], axis=-1, keepdims=True), 1e-6) * np.sqrt(1 - np.minimum(facing, 1) ** 2)[..., None]
    round_ = np.concatenate([side, facing[..., None]], axis=-1)
    mixed_ = N + share[..., None] * (round_ - N)
    found: Float32 = (mixed_ / np.maximum(np.linalg.norm(mixed_, axis=-1, keepdims=True), 1e-6)).astype(np.float32)
    return found


def parted(
    plate: npt.ArrayLike,
    alpha: npt.ArrayLike,
    passes: Mapping[str, npt.NDArray[Any]],
    *,
    edge_px: float | None = None,
    unsure: Bool | None = None,
) -> tuple[Side, Side] | None:
    """The subject and what is behind it, or None where the matte has no two sides.

    alpha   : (H, W), 0..1, the subject's cover; NaN counts as 0.
    passes  : P, N and what else lies on the plate, (H, W) or (H, W, C); each side gets them whole.
    edge_px : so near to the other side, geometry is not believed; None: 8 px where N was recovered (N_sigma is there), else 1.
    unsure  : (H, W), not believed just there.
    Raises  : PassError for arrays that do not fit or an alpha out of range, ShotError for edge_px.
    """
    edge_px = edge_reach(passes) if edge_px is None else edge_px
    if not 0 <= edge_px <= 100:
        raise ShotError(f"edge_px must be a number, 0 ... 100, got {edge_px!r}")
    picture = as_float32(plate, "plate", channels=3)
    size_hw = (picture.shape[0], picture.shape[1])
    cover = np.nan_to_num(as_float32(alpha, "alpha", size_hw=size_hw), nan=0.0)
    if cover.size and (cover.min() < 0 or cover.max() > 1):
        raise PassError(f"alpha must lie in 0 ... 1, got {float(cover.min()):.4g} ... {float(cover.max()):.4g}")
    fore, back = cover >= SURE, cover <= 1 - SURE
    if not fore.any() or not back.any():
        return None
    P = as_float32(passes["P"], "P", channels=3, size_hw=size_hw)
    known = np.isfinite(P).all(axis=-1) & np.isfinite(as_float32(passes["N"], "N", channels=3, size_hw=size_hw)).all(axis=-1)
    edge = ndimage.distance_transform_edt(cover >= 0.5) - ndimage.distance_transform_edt(cover < 0.5)  # > 0 inside
    colours: list[Float32] = []
    geometry: list[dict[str, npt.NDArray[Any]]] = []
    for own, sign in ((fore, 1.0), (back, -1.0)):
        nearest = ndimage.distance_transform_edt(~own, return_distances=False, return_indices=True)
        colours.append(_colours(picture, own, nearest))
        deep = ndimage.distance_transform_edt(own) > edge_px if unsure is None else own & ~unsure
        held = deep & known & ~_not_its_own(passes, own & known, sign * edge, sign)
        # Only where this side shows: elsewhere the picture's own geometry stays, which casts shadows.
        shows = ndimage.binary_dilation((cover if own is fore else 1 - cover) > 0)
        widths = EVEN_FORE_PX if own is fore else (EVEN_UNSURE_BACK_PX if "N_sigma" in passes else EVEN_BACK_PX)
        made = _extended(passes, held if held.any() else own & known, shows, widths)
        if own is fore and unsure is None:
            made["N"] = _rounded(made["N"], cover, edge, held, ~held & shows, edge_px)
        geometry.append(made)
    a = cover[..., None]
    F, B = colours
    # What the two guesses leave of the plate is shared out by how much each side shows: the mixture is the plate again.
    rest = np.nan_to_num(picture - a * F - (1 - a) * B) / (a * a + (1 - a) ** 2)
    F, B = F + a * rest, B + (1 - a) * rest
    # What is below nothing on one side is given to the other; never both are, where the plate itself is not.
    with np.errstate(invalid="ignore", divide="ignore"):
        dark_f, dark_b = (F < 0) & (picture >= 0) & (a < 1), (B < 0) & (picture >= 0) & (a > 0)
        F, B = np.where(dark_f, 0, np.where(dark_b, picture / a, F)), np.where(dark_b, 0, np.where(dark_f, picture / (1 - a), B))
    broken = ~np.isfinite(picture)
    sides = [Side(plate=np.where(broken, picture, c).astype(np.float32), passes=g) for c, g in zip((F, B), geometry)]
    return sides[0], sides[1]


def parting(
    plate: Float32, passes: Mapping[str, npt.NDArray[Any]], mattes: Mapping[str, Float32], *, edges: str | None, edge_px: float | None
) -> tuple[Float32 | None, Bool | None]:
    """The subject's cover and where geometry is not to be believed (None: beside the other side), by the matte that `edges` names, or by "depth".

    Raises : ShotError for a matte that is not there.
    """
    if edges is None:
        return None, None
    if edges == "depth":
        return cover_from_depth(plate, -np.asarray(passes["P"])[..., 2], edge_px=edge_reach(passes) if edge_px is None else edge_px)
    if edges not in mattes:
        raise ShotError(f"relight: edges {edges!r} is no matte{nearest_hint(edges, [*mattes, 'depth'])}")
    return mattes[edges], None


def mixed(fore: npt.ArrayLike, back: npt.ArrayLike, alpha: Float32) -> Float32:
    """alpha fore + (1 - alpha) back, (H, W) or (H, W, 3)."""
    f, b = np.asarray(fore, np.float32), np.asarray(back, np.float32)
    a = alpha if f.ndim == 2 else alpha[..., None]
    found: Float32 = np.where(a >= 1, f, np.where(a <= 0, b, a * f + (1 - a) * b)).astype(np.float32)
    return found


def cover_from_depth(plate: npt.ArrayLike, Z: npt.ArrayLike, *, edge_px: float = EDGE_PX) -> tuple[Float32, Bool]:
    """Cover of what is in front, (H, W) in 0..1, told at every depth edge by colour between both sides; and where geometry is not to be believed.

    Z : (H, W) metres.  Away from edges cover is 1 or 0, by the side of the edge that is nearest.  Where both sides look alike the edge of
    Z itself is taken, softened over a pixel.
    """
    picture = as_float32(plate, "plate", channels=3)
    depth = as_float32(Z, "Z", size_hw=(picture.shape[0], picture.shape[1]))
    if not np.isfinite(depth).any():
        return np.zeros(depth.shape, np.float32), np.zeros(depth.shape, np.bool_)
    far = np.nan_to_num(depth, nan=float(np.nanmax(depth)))
    side = round(edge_px) * 2 + 3
    low, high = ndimage.minimum_filter(far, side), ndimage.maximum_filter(far, side)
    band = high > STEP * low
    if not band.any():
        return np.zeros(depth.shape, np.float32), band
    here = far < np.sqrt(low * high)
    fore: Bool = here[tuple(ndimage.distance_transform_edt(~band, return_distances=False, return_indices=True))]
    inner, outer = fore & ~band, ~fore & ~band
    soft = ndimage.gaussian_filter(fore.astype(np.float32), 0.7)
    if not inner.any() or not outer.any():
        return soft, band
    F, B = (_colours(picture, own, ndimage.distance_transform_edt(~own, return_distances=False, return_indices=True)) for own in (inner, outer))
    apart = F - B
    strength = (apart * apart).sum(axis=-1)
    told = ((np.nan_to_num(picture) - B) * apart).sum(axis=-1) / np.maximum(strength, 1e-12)
    noise = ALIKE * np.nan_to_num(picture).mean(axis=-1) ** 2 + 1e-8
    trusted = strength / (strength + noise)
    alpha = np.where(inner, 1.0, np.where(outer, 0.0, trusted * np.clip(told, 0, 1) + (1 - trusted) * soft))
    return np.asarray(alpha, np.float32), band
