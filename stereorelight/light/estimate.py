"""The light that the plate was shot in, told from the plate and its normals; or that the plate does not tell.

In: the plate (scene-linear), N and where known P, how far to believe each pixel.  Out: a `PlateLighting`: light from all around to the
second order, and one lamp where there is evidence of one, with how much of the plate it explains and how sure its direction is.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres.
What a plate alone cannot tell is agreed upon: the main light is white, and the median albedo is `albedo_level`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.light.checks import Vector
from stereorelight.light.plate_fit import Fit, Pixels, fit, gain_by_blocks, left_over, materials_of
from stereorelight.light.plate_lighting import PlateLighting, as_vector, lamp_term
from stereorelight.light.spherical_harmonics import TERMS, basis

WORK_WIDTH = 160  # light is smooth over normals: a small picture holds all there is to know
SEARCHED = 1200  # pixels that the search for a lamp looks at
DIRECTIONS = 60  # looked at for a lamp, over all that can shine on what the camera sees
BEHIND = -0.6  # z of the farthest of them: a lamp behind the set lights rims alone
NEARNESS = (0.0, 0.35, 0.7, 1.1, 1.6)  # 1 / metres from the lit ground's centre to the lamp
FOLDS = 4
BLOCKS = 14  # across the frame
SURE = 3.0  # standard errors: less is chance
LEAST = 0.01  # share of the variance explained: less is of no use to anybody
ABOUT_DEG = 16.0  # how far about a lamp's direction parts of the plate are asked for another
UNSURE_DEG = 35.0  # spread of the direction over parts of the plate: more is no direction
ALBEDO_LEVEL = 0.36
DARKEST = 1e-6  # grey of a plate that is black all over
MODELS = ("auto", "harmonics", "lamp")

Model = Literal["auto", "harmonics", "lamp"]
Visible = Callable[[Vector, "Vector | None"], npt.ArrayLike]  # towards, place or None for far away -> (H, W) share that arrives


def _blocks(a: npt.NDArray[Any], by: int) -> Float64:
    h, w = a.shape[0] // by * by, a.shape[1] // by * by
    total = np.zeros((h // by, w // by, *a.shape[2:]))
    for i in range(by):
        for j in range(by):
            total += a[i:h:by, j:w:by]
    return total / (by * by)


def pixels_of(plate: Float32, N: Float32, P: Float32 | None, weight: Float32) -> tuple[list[Pixels], int]:
    """The believed pixels of a small picture, by fine and by coarse materials, none where there are too few; and how many pixels a side one is."""
    by = max(1, round(plate.shape[1] / WORK_WIDTH))
    good = weight * np.isfinite(N).all(axis=-1) * np.isfinite(plate).all(axis=-1)
    if P is not None:
        good = good * np.isfinite(P).all(axis=-1)
    grey = np.nan_to_num(plate, nan=0.0, posinf=0.0, neginf=0.0).mean(axis=-1)
    bright = grey[good > 0]
    if bright.size < 100:
        return [], by
    high = float(np.percentile(bright, 98))
    top = np.nan_to_num(plate, nan=0.0, posinf=0.0).max(axis=(0, 1))
    flat = [float((plate[..., c] >= 0.995 * top[c]).mean()) > 5e-4 for c in range(3)]  # many pixels at the very top: clipped
    clipped = np.any([flat[c] & (plate[..., c] >= 0.98 * top[c]) for c in range(3)], axis=0)
    good = good * ~clipped * (grey > 1e-3 * high) * (np.nan_to_num(plate, nan=0.0).min(axis=-1) > 1e-4 * high)
    share = _blocks(good, by)
    scale = np.maximum(share, 1e-9)
    colours = _blocks(np.nan_to_num(plate, posinf=0.0, neginf=0.0) * good[..., None], by) / scale[..., None]
    n = _blocks(np.nan_to_num(N) * good[..., None], by) / scale[..., None]
    length = np.linalg.norm(n, axis=-1)
    p = None if P is None else _blocks(np.nan_to_num(P) * good[..., None], by) / scale[..., None]
    kept = (share > 0.5 * float(np.median(share[share > 0])) if (share > 0).any() else share > 0) & (length > 0.9)
    if p is not None:  # a small pixel across a depth edge is of no surface
        far = -p[..., 2]
        kept &= (ndimage.maximum_filter(far, 3) - ndimage.minimum_filter(np.where(kept, far, np.inf), 3)) < 0.08 * far
    surface, _ = ndimage.label(kept)
    w = kept.shape[1]
    at = np.flatnonzero(kept)
    if len(at) < 200:
        return [], by
    rgb = np.maximum(colours.reshape(-1, 3)[at], 1e-9)
    logs = np.log(np.column_stack([rgb, rgb.mean(axis=1)]))
    weights = share.reshape(-1)[at] / float(share.max())
    fine, coarse = materials_of(logs[:, [0, 2]] - logs[:, [1]], weights, surface.reshape(-1)[at].astype(np.int64), at, (kept.shape[0], kept.shape[1]))
    side = max(w // BLOCKS, 4)
    block = (at // w) // side * (w // side + 1) + (at % w) // side
    normals = n.reshape(-1, 3)[at] / length.reshape(-1)[at, None]
    places = None if p is None else p.reshape(-1, 3)[at]
    whole = Pixels(logs=logs, N=normals, P=places, weight=weights, label=fine, block=block, at=at)
    found = [whole.part(fine >= 0)]
    if fine.max(initial=-1) != coarse.max(initial=-1):
        found.append(replace(whole, label=coarse).part(coarse >= 0))
    return [pixels for pixels in found if len(pixels.at) >= 200], by


def _directions() -> Float64:
    """Unit vectors, evenly over the sphere down to BEHIND."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1 - (1 - BEHIND) * k / DIRECTIONS
    phi = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(np.maximum(1 - z * z, 0))
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])


class _Lamps:
    """S of lamps at the believed pixels, shadows and all."""

    def __init__(self, pixels: Pixels, by: int, size_hw: tuple[int, int], visible: Visible | None) -> None:
        self.pixels, self.by, self.visible = pixels, by, visible
        self.columns = size_hw[1] // by
        self.centre: Vector = (0.0, 0.0, 0.0) if pixels.P is None else as_vector(np.average(pixels.P, axis=0, weights=pixels.weight))

    def place(self, towards: Float64, nearness: float) -> Vector | None:
        return None if nearness == 0 or self.pixels.P is None else as_vector(np.array(self.centre) + towards / nearness)

    def term(self, towards: Float64, nearness: float) -> Float64:
        place = self.place(towards, nearness)
        S = lamp_term(self.pixels.N, self.pixels.P, as_vector(towards), place, self.centre)
        if self.visible is None:
            return S
        lit = _blocks(np.asarray(self.visible(as_vector(towards), place), np.float64), self.by)
        arrives: Float64 = S * lit.reshape(-1)[self.pixels.at]
        return arrives


def _turned(towards: Float64, degrees: float) -> Float64:
    """(8, 3) directions that lie `degrees` off, all round."""
    other = np.eye(3)[int(np.abs(towards).argmin())]
    u = np.cross(towards, other)
    u /= np.linalg.norm(u)
    v = np.cross(towards, u)
    phi = np.arange(8) * np.pi / 4
    a = math.radians(degrees)
    return math.cos(a) * towards + math.sin(a) * (np.cos(phi)[:, None] * u + np.sin(phi)[:, None] * v)


def _lamp_search(pixels: Pixels, lamps: _Lamps) -> tuple[Float64, float]:
    """Direction and nearness of the lamp that explains the pixels best; an even part of them is asked."""
    some = np.arange(len(pixels.at)) % max(1, round(len(pixels.at) / SEARCHED)) == 0
    part = pixels.part(some)
    _, label = np.unique(part.label, return_inverse=True)
    part = replace(part, label=label.reshape(-1).astype(np.int64))

    def cost(towards: Float64, nearness: float) -> float:
        S = lamps.term(towards, nearness)[some]
        return fit(part, S, terms=4, rounds=4).cost if S.any() else math.inf

    tried = _directions()
    costs = [cost(d, 0.0) for d in tried]
    best, towards, nearness = min(costs), tried[int(np.argmin(costs))], 0.0
    for degrees in (10.0, 5.0, 2.5):
        for _ in range(3):
            around = _turned(towards, degrees)
            found = [cost(d, nearness) for d in around]
            if min(found) >= best:
                break
            best, towards = min(found), around[int(np.argmin(found))]
        if pixels.P is not None:
            found = [cost(towards, k) for k in NEARNESS]
            if min(found) < best:
                best, nearness = min(found), NEARNESS[int(np.argmin(found))]
    return towards, nearness


def estimate_lighting(
    plate: npt.ArrayLike,
    N: npt.ArrayLike,
    *,
    P: npt.ArrayLike | None = None,
    weight: npt.ArrayLike | None = None,
    visible: Visible | None = None,
    model: Model = "auto",
    albedo_level: float = ALBEDO_LEVEL,
) -> PlateLighting:
    """The light that `plate` (H, W, 3), scene-linear, was shot in.

    N, P         : (H, W, 3), unit and metres; NaN where unknown.  Without P light is far away.
    weight       : (H, W), how far to believe each pixel, such as a subject's matte times confidence; None is 1.
    visible      : gives the share of a lamp (its direction, and its place or None) that arrives, (H, W), for cast shadows; None: all of it.
    model        : "harmonics", light from all around; "lamp", with one lamp besides; "auto" takes the lamp where the plate bears it out.
    albedo_level : median albedo of the believed ground.
    Returns      : `told` is False where no light explains ground that it was not fitted to better than even light does, by three
                   standard errors, or where its direction depends on which part of the plate is looked at.
    Raises       : PassError for arrays that do not fit, ShotError for settings out of range.
    """
    picture = as_float32(plate, "plate", channels=3)
    size_hw = (picture.shape[0], picture.shape[1])
    normals = as_float32(N, "N", channels=3, size_hw=size_hw)
    places = None if P is None else as_float32(P, "P", channels=3, size_hw=size_hw)
    believed = np.ones(size_hw, np.float32) if weight is None else np.nan_to_num(as_float32(weight, "weight", size_hw=size_hw), nan=0.0)
    if model not in MODELS:
        raise ShotError(f"model {model!r} is unknown{nearest_hint(str(model), MODELS)}")
    if not 0.01 <= albedo_level <= 1:
        raise ShotError(f"albedo_level must be a number, 0.01 ... 1, got {albedo_level!r}")
    if (believed < 0).any():
        raise ShotError("weight must be at least 0")
    asked, by = pixels_of(picture, normals, places, believed)
    if not asked:
        grey = picture.mean(axis=-1)[np.isfinite(picture).all(axis=-1) & (believed > 0)]
        return _even(float(np.median(grey)) if grey.size else albedo_level, albedo_level)
    shadows: dict[tuple[Vector, Vector | None], Float64] = {}

    def arrives(towards: Vector, place: Vector | None) -> Float64:
        if (towards, place) not in shadows and visible is not None:
            shadows[towards, place] = np.asarray(visible(towards, place), np.float64)
        return shadows[towards, place]

    told = [_told(pixels, _Lamps(pixels, by, size_hw, None if visible is None else arrives), model) for pixels in asked]
    # Brightness from patch to patch may look like light by chance; what patches show within themselves may not.
    sure = [one for one in told if one.verdict.sure] if told[0].verdict.shades else []
    if not sure:
        verdict = told[0].verdict
        even = _even(float(np.exp(np.median(asked[0].logs[:, 3]))), albedo_level)
        return replace(even, explained=max(verdict.explained, 0.0), residual=verdict.residual, sigma_deg=verdict.sigma_deg)
    return _settled(min(sure, key=lambda one: (one.S is None, one.verdict.sigma_deg)), albedo_level)  # a lamp says more than soft light does


def _told(pixels: Pixels, lamps: _Lamps, model: Model) -> _Told:
    """The model that explains the pixels best on ground that it was not fitted to, and how well."""
    null = fit(pixels, None, terms=1)
    choices: list[tuple[Fit, Float64 | None, Float64, float]] = [(fit(pixels, None), None, np.zeros(3), 0.0)]
    if model != "harmonics":
        towards, nearness = _lamp_search(pixels, lamps)
        S = lamps.term(towards, nearness)
        choices.append((fit(pixels, S), S, towards, nearness))
    judged = [_judged(pixels, null, found, S, towards, lamps, nearness) for found, S, towards, nearness in choices]
    pick = 1 if model == "lamp" or (len(choices) > 1 and judged[1].gain > judged[0].gain) else 0
    found, term, way, near = choices[pick]
    return _Told(pixels=pixels, lamps=lamps, found=found, S=term, towards=way, nearness=near, verdict=judged[pick])


def _even(grey: float, albedo_level: float) -> PlateLighting:
    """Even light, of which nothing more is known."""
    level = max(grey, DARKEST) / albedo_level
    around = np.zeros((TERMS, 3))
    around[0] = level / basis((0.0, 0.0, 1.0))[0]
    return PlateLighting(around=around, lamp=np.zeros(3), level=level)


@dataclass(frozen=True, kw_only=True)
class _Verdict:
    gain: float
    error: float
    explained: float
    residual: float
    sigma_deg: float

    @property
    def shades(self) -> bool:
        """Whether there is shading, and no chance."""
        return self.gain >= SURE * self.error and self.explained >= LEAST

    @property
    def sure(self) -> bool:
        """Whether the shading says where light comes from."""
        return self.shades and self.sigma_deg <= UNSURE_DEG


@dataclass(frozen=True, kw_only=True, eq=False)
class _Told:
    """Light that was found: of which pixels, the fit, the lamp's S, direction and nearness, and how good it is."""

    pixels: Pixels
    lamps: _Lamps
    found: Fit
    S: Float64 | None
    towards: Float64
    nearness: float
    verdict: _Verdict


def _main(found: Fit, towards: Float64, lamp: bool) -> Float64:
    """(3,) unit vector to the main light; of soft light the way in which irradiance grows most."""
    way = towards if lamp and found.s > 0 else found.c[[3, 1, 2]]
    unit: Float64 = way / max(float(np.linalg.norm(way)), 1e-9)
    return unit


def _judged(pixels: Pixels, null: Fit, whole: Fit, S: Float64 | None, towards: Float64, lamps: _Lamps, nearness: float) -> _Verdict:
    """The fit on ground that it was not made from, fold by fold."""
    rest_null, rest_told = np.zeros(len(pixels.at)), np.zeros(len(pixels.at))
    ways: list[Float64] = []
    fold = pixels.block % FOLDS
    about = np.zeros((0, 3)) if S is None else np.concatenate([towards[None], _turned(towards, ABOUT_DEG / 2), _turned(towards, ABOUT_DEG)])
    terms = [lamps.term(way, nearness) for way in about]
    some = np.arange(len(pixels.at)) % max(1, round(len(pixels.at) / SEARCHED)) == 0
    for k in range(FOLDS):
        kept, out = fold != k, fold == k
        known = np.isin(pixels.label, np.unique(pixels.label[kept]))
        kept, out = kept & known, out & known
        if kept.sum() < 50 or not out.any():
            continue
        part, held = pixels.part(kept), pixels.part(out)
        plain = fit(part, None, terms=1)
        told = fit(part, None if S is None else S[kept], start=whole, rounds=5)
        rest_null[out] = left_over(held, None, plain)
        rest_told[out] = left_over(held, None if S is None else S[out], told)
        if S is None:
            ways.append(told.c[[3, 1, 2]])
            continue
        few = kept & some
        _, label = np.unique(pixels.label[few], return_inverse=True)
        asked = replace(pixels.part(few), label=label.reshape(-1).astype(np.int64))
        ways.append(about[int(np.argmin([fit(asked, term[few], terms=4, rounds=3).cost for term in terms]))])
    gain, error = gain_by_blocks(pixels, rest_null, rest_told)
    before, after = (1.4826 * float(np.median(np.abs(r))) + 1e-6 for r in (rest_null, rest_told))
    units = np.array([way / max(float(np.linalg.norm(way)), 1e-9) for way in ways]).reshape(-1, 3)
    mean = units.mean(axis=0) if len(units) else np.zeros(3)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    off = np.degrees(np.arccos(np.clip(units @ mean, -1, 1)))
    # Each fold leaves out a quarter: the whole is surer than the folds are alike, by the jackknife's factor.
    sigma = float(np.sqrt((off**2).sum() * (FOLDS - 1) / FOLDS)) if len(units) > 1 else 180.0
    if S is not None:  # looked at in steps
        sigma = math.hypot(sigma, ABOUT_DEG / 4)
    return _Verdict(gain=gain, error=error, explained=1 - (after / before) ** 2, residual=after, sigma_deg=min(sigma, 180.0))


def _settled(one: _Told, albedo_level: float) -> PlateLighting:
    """Each channel's own coefficients; the main light made white, and the median albedo what was agreed upon."""
    pixels, lamps, whole, S, towards, nearness, verdict = one.pixels, one.lamps, one.found, one.S, one.towards, one.nearness, one.verdict
    lamp = S is not None and whole.s > 0
    main = _main(whole, towards, lamp)
    around, strength = np.zeros((TERMS, 3)), np.zeros(3)
    unit = basis(np.array([[0.0, 0.0, 1.0]]))[0, 0]
    for channel in range(3):
        own = fit(pixels, S, start=whole, channel=channel, rounds=6)
        facing = float(basis(main[None])[0] @ own.c) / unit + (own.s if lamp else 0.0)
        around[:, channel], strength[channel] = own.c / unit / facing, own.s / facing if lamp else 0.0
    light = PlateLighting(
        around=around,
        lamp=strength,
        level=1.0,
        towards=as_vector(main),
        place_m=lamps.place(towards, nearness) if lamp else None,
        centre_m=lamps.centre,
        explained=verdict.explained,
        residual=verdict.residual,
        sigma_deg=verdict.sigma_deg,
        told=True,
    )
    E = basis(pixels.N) @ around + (0.0 if S is None else S[:, None] * strength)
    grey = np.exp(pixels.logs[:, :3]) / np.maximum(E, 0.02)
    level = float(np.median(grey.mean(axis=-1))) / albedo_level
    return replace(light, around=around * level, lamp=strength * level, level=level)
