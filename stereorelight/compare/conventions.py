"""What a renderer's depth pass holds: along the axis or along the ray, inverse, normalised, in which unit; found from the values, with the
evidence in words.

In: the values of a pass (H, W), and another depth of the same plate in metres, which may be noisy.  Out: a `Reading`: the form that
fits, how well it fits beside the next best, and whether that is sure.  A doubt is said, never settled by taste.

Two forms are told apart by what they disagree on: with a and b the logarithms of the depth by either, the part of the other depth
that goes along with a - b is 1/2 where a is right and -1/2 where b is.  Medians over groups of pixels of like a - b keep noise and mistakes
of the other depth out, so that one which is off by several per cent still tells the ray from the axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float64
from stereorelight.errors import PassError

Kind = Literal["z", "ray", "inverse", "inverse-ray", "normalised", "reversed", "normalised-ray", "reversed-ray", "buffer", "reversed-buffer"]
KINDS: tuple[Kind, ...] = get_args(Kind)
SCALED: tuple[Kind, ...] = ("z", "ray", "inverse", "inverse-ray")  # one number, the unit, makes them metres
WORDS: Mapping[Kind, str] = {
    "z": "Z along the axis",
    "ray": "ray length",
    "inverse": "1 / Z",
    "inverse-ray": "1 / ray length",
    "normalised": "normalised Z, 0 near and 1 far",
    "reversed": "normalised Z, 1 near and 0 far",
    "normalised-ray": "normalised ray length, 0 near and 1 far",
    "reversed-ray": "normalised ray length, 1 near and 0 far",
    "buffer": "a depth buffer, 0 near and 1 far",
    "reversed-buffer": "a depth buffer, 1 near and 0 far",
}
UNITS: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254, "km": 1000.0}
CODE_UNITS: Mapping[str, float] = {**UNITS, "1/256 m": 1 / 256, "1/5000 m": 1 / 5000}  # of whole numbers: KITTI's and TUM's depths too
SNAP, SNAP_OTHER = 1.25, 1.1  # metres, and any other unit, are believed where the depths agree to this factor
SAMPLES = 40_000  # pixels looked at
FIT_PERCENT = (0.1, 0.3, 1.0, 3.0, 10.0)  # evidence is given within the first of these that half of the pixels keep
LEAST_FIT = 0.5  # share of the pixels that must fit within the last of them
SAME = 1e-3  # forms that differ by less than this on nearly every pixel are one
GROUPS = 32  # of pixels of like disagreement
LEAN, LEAN_SIGMA = 0.2, 4.0  # of 1/2: how clearly the other depth must take a side
CAP = 0.2
SIMPLER = 1.2  # a form of one number is kept where one of two numbers fits no better than by this factor


@dataclass(frozen=True, kw_only=True)
class DepthForm:
    """What the values v of a depth pass mean.

    kind    : see WORDS.   metres : what one unit of length is, of the kinds in SCALED.
    near_m, far_m : the depths at both ends, of the others.   top : the value that means 1 of those: 65535 of 16-bit codes.
    """

    kind: Kind = "z"
    metres: float = 1.0
    near_m: float | None = None
    far_m: float | None = None
    top: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise PassError(f"depth is no {self.kind!r}; known: {', '.join(KINDS)}")
        if not (np.isfinite(self.metres) and self.metres > 0):
            raise PassError(f"a unit must be > 0 metres, got {self.metres!r}")
        if self.kind not in SCALED:
            if self.near_m is None or self.far_m is None:
                raise PassError(f"depth that is {self.kind!r} needs its ends in metres: give --near and --far")
            if not 0 < self.near_m < self.far_m < np.inf:
                raise PassError(f"depth that is {self.kind!r} needs 0 < near < far, got near {self.near_m:g}, far {self.far_m:g} m")

    def words(self) -> str:
        """`ray length in cm`."""
        if self.kind in SCALED:
            return f"{WORDS[self.kind]} in {unit_name(self.metres)}"
        return f"{WORDS[self.kind]} ({self.near_m:.4g} to {self.far_m:.4g} m)"

    def options(self) -> str:
        """What a user writes to state it."""
        if self.kind in SCALED:
            return f"--truth-is {self.kind} --unit {unit_name(self.metres, code=True)}"
        return f"--truth-is {self.kind} --near {self.near_m:.4g} --far {self.far_m:.4g}"


def unit_name(metres: float, *, code: bool = False) -> str:
    """`cm` of 0.01; the number itself where it has no name."""
    for name, value in (UNITS if code else CODE_UNITS).items():
        if abs(metres / value - 1) < 1e-9:
            return name
    return f"{metres:.6g}" if code else f"units of {metres:.4g} m"


def ray_factor(rays: npt.NDArray[np.floating] | None, shape: tuple[int, ...]) -> Float64:
    """(H, W) length of a ray over its depth along the axis, sqrt(1 + x^2 + y^2); ones where no camera is known."""
    if rays is None:
        return np.ones(shape)
    return np.sqrt(1 + np.einsum("...c,...c->...", rays, rays, dtype=np.float64))


def depth_from(values: npt.ArrayLike, form: DepthForm, rays: npt.NDArray[np.floating] | None = None) -> Float64:
    """(H, W) Z in metres along the axis of `values` of a form; NaN where a value means nothing.

    rays : (H, W, 2) of the camera, needed by the forms of the ray.   At and beyond the ends of a normalised depth nothing is known.
    """
    if "ray" in form.kind and rays is None:
        raise PassError(f"depth that is {form.kind!r} needs the camera that saw it: give --rig or --fov-deg")
    v = np.asarray(values, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if form.kind in SCALED:
            length = form.metres / v if form.kind.startswith("inverse") else form.metres * v
        else:
            near, far = form.near_m or 0.0, form.far_m or np.inf  # given, or the form would not be
            t = np.where((v > 0) & (v < form.top), v / form.top, np.nan)
            t = 1 - t if form.kind.startswith("reversed") else t
            length = 1 / (1 / near + t * (1 / far - 1 / near)) if form.kind.endswith("buffer") else near + t * (far - near)
        if "ray" in form.kind:
            length = length / ray_factor(rays, v.shape)
        depth: Float64 = np.where((length > 0) & np.isfinite(length), length, np.nan)
    return depth


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What a depth pass was found to be.

    form   : the form that fits best.   sure : whether nothing else does, and no number of it had to be taken from what is judged.
    words  : the evidence in one line.   doubt : why it is not sure, and what to state; empty where it is.
    within_percent, share, next_share : so many of the pixels fit within so much, by this form and by the next best.
    """

    form: DepthForm
    sure: bool
    words: str
    doubt: str = ""
    within_percent: float = np.nan
    share: float = np.nan
    next_share: float = np.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    form: DepthForm
    log: Float64  # logarithm of the depth by it
    apart: Float64  # of the other depth's, by size
    free: float  # mean of the same with the scale left free, each at most CAP: a wall may fill half the frame, and mistakes are mistakes

    def share(self, percent: float) -> float:
        return float((self.apart <= np.log1p(percent / 100)).mean())


def detect_depth(
    values: npt.NDArray[np.floating],
    reference_m: npt.NDArray[np.floating],
    *,
    rays: npt.NDArray[np.floating] | None = None,
    kinds: tuple[Kind, ...] = KINDS,
    units: Mapping[str, float] = UNITS,
    top: float = 1.0,
    exact: bool = False,
    reference: str = "the result",
    role: str = "truth",
) -> Reading:
    """What `values` are, from another depth of the same plate.

    values      : (H, W), NaN, 0 or inf where unknown.   reference_m : (H, W) Z in metres along the axis.
    rays        : (H, W, 2) of the camera, or None; forms of the ray are then only looked for by their pattern.
    kinds, units: what may be; one alone where the user has stated it.   top : the value that means 1 (65535 of codes).
    exact       : the other depth comes with the same file, so that numbers fitted to it (near, far, an odd unit) may be believed.
    Raises      : PassError where fewer than 100 pixels are known in both.
    """
    sample = _sample(values, reference_m, rays)
    if sample is None:
        raise PassError(f"{role} and {reference} have hardly a known pixel in common; do they belong to the same frame and eye?")
    v, ref, r = sample
    fits = _scaled_fits(v, ref, r, kinds if rays is not None else tuple(k for k in kinds if "ray" not in k or len(kinds) == 1), units, top)
    fits += _ended_fits(v, ref, r, tuple(k for k in kinds if k not in SCALED and (rays is not None or "ray" not in k)), top)
    if not fits:
        raise PassError(f"no reading of {role}'s depth is possible here; state another --truth-is, or give the camera by --rig")
    fits.sort(key=lambda f: f.free)
    simple = [f for f in fits if f.form.kind in SCALED and f.free <= max(SIMPLER * fits[0].free, SAME) and _has_unit(f.form.metres, units)]
    best = simple[0] if simple else fits[0]
    rivals = [f for f in fits if f is not best]
    # A form of two numbers holds those of one number as a special case: it is no rival of one that fits.
    if simple:
        rivals = [f for f in rivals if f.form.kind in SCALED]
    radial = None if rays is not None else _radial(values, reference_m)
    return _judged(best, rivals, ref, units=units, exact=exact, reference=reference, role=role, radial=radial)


def _sample(
    values: npt.NDArray[np.floating], reference: npt.NDArray[np.floating], rays: npt.NDArray[np.floating] | None
) -> tuple[Float64, Float64, Float64] | None:
    with np.errstate(invalid="ignore"):
        known = np.isfinite(values) & (values > 0) & (np.abs(values) < 1e9) & np.isfinite(reference) & (reference > 0)
    at = np.flatnonzero(known)
    if at.size < 100:
        return None
    at = at[:: max(1, at.size // SAMPLES)]
    factor = ray_factor(None if rays is None else rays.reshape(-1, 2)[at], at.shape)
    return values.reshape(-1)[at].astype(np.float64), reference.reshape(-1)[at].astype(np.float64), factor


def _capped(off: Float64) -> float:
    return float(np.minimum(np.abs(off), CAP).mean())


def _nearest_unit(metres: float, units: Mapping[str, float]) -> float:
    return min(units.values(), key=lambda u: abs(np.log(metres / u)))


def _has_unit(metres: float, units: Mapping[str, float]) -> bool:
    """Whether a scale fitted to the other depth is that of a unit, but for what that depth may be off."""
    unit = _nearest_unit(metres, units)
    return bool(abs(np.log(metres / unit)) <= np.log(SNAP if unit == 1.0 or len(units) == 1 else SNAP_OTHER))


def _scaled_fits(v: Float64, ref: Float64, r: Float64, kinds: tuple[Kind, ...], units: Mapping[str, float], top: float) -> list[_Fit]:
    out = []
    for kind in kinds:
        if kind not in SCALED:
            continue
        log = (-1 if kind.startswith("inverse") else 1) * np.log(v) - (np.log(r) if "ray" in kind else 0)
        off = np.log(ref) - log
        scale = float(np.median(off))
        snapped = float(np.log(_nearest_unit(np.exp(scale), units))) if _has_unit(np.exp(scale), units) else scale
        form = DepthForm(kind=kind, metres=float(np.exp(scale)), top=top)
        out.append(_Fit(form=form, log=log + snapped, apart=np.abs(off - snapped), free=_capped(off - scale)))
    return out


def _ended_fits(v: Float64, ref: Float64, r: Float64, kinds: tuple[Kind, ...], top: float) -> list[_Fit]:
    """Fits of the forms with two ends: the length, or its inverse, is a + b t with t in 0..1."""
    if not kinds or v.max() > top * (1 + 1e-6):
        return []
    t = v / top
    inner = t < 1
    if inner.sum() < 100 or np.ptp(t[inner]) < 1e-3:
        return []
    out = []
    for kind in kinds:
        u = 1 - t if kind.startswith("reversed") else t
        length = ref * r if "ray" in kind else ref
        hyperbolic = kind.endswith("buffer")
        a, b = _line(u[inner], 1 / length[inner] if hyperbolic else length[inner])
        ends = (1 / a, 1 / (a + b)) if hyperbolic and a > 0 and a + b > 0 else (a, a + b)
        if not 0 < ends[0] < ends[1]:
            if hyperbolic or ends[1] <= ends[0] or ends[0] < -0.05 * ends[1]:
                continue  # runs the other way, which is another kind
            ends = (1e-3 * ends[1], ends[1])  # a near end of 0 but for noise
        form = DepthForm(kind=kind, near_m=float(ends[0]), far_m=float(ends[1]), top=top)
        depth = np.where(inner, np.maximum((1 / (a + b * u) if hyperbolic else a + b * u) / (r if "ray" in kind else 1), 1e-9), np.nan)
        apart = np.where(inner, np.abs(np.log(depth) - np.log(ref)), np.inf)
        out.append(_Fit(form=form, log=np.log(np.where(inner, depth, ref)), apart=apart, free=_capped(apart)))
    return out


def _line(x: Float64, y: Float64) -> tuple[float, float]:
    """a + b x through (x, y), errors relative to y, outliers weighed down (Cauchy weights at the residual's own median)."""
    w = 1 / y
    A = np.stack([np.ones_like(x), x], axis=-1)
    a = b = 0.0
    for _ in range(12):
        (a, b), *_ = np.linalg.lstsq(A * w[:, None], y * w, rcond=None)
        off = np.abs(a + b * x - y) / y
        w = 1 / y / np.sqrt(1 + (off / max(2 * float(np.median(off)), 1e-9)) ** 2)
    return float(a), float(b)


def _lean(a: Float64, b: Float64, ref: Float64) -> tuple[float, float]:
    """(lean, its standard deviation): 1 where `ref` goes along with `a` where they disagree, -1 where with `b`; all logarithms."""
    apart = a - b
    apart = apart - np.median(apart)
    other = ref - (a + b) / 2
    other = other - np.median(other)
    order = np.argsort(apart, kind="stable")
    x, y = (np.array([np.median(g) for g in np.array_split(values[order], GROUPS)]) for values in (apart, other))
    x, y = x - x.mean(), y - y.mean()
    energy = float((x * x).sum())
    if energy <= 0:
        return 0.0, np.inf
    slope = float((x * y).sum()) / energy
    sigma = float(np.sqrt(((y - slope * x) ** 2).sum() / (GROUPS - 2) / energy))
    return 2 * slope, 2 * sigma


def _radial(values: npt.NDArray[np.floating], reference: npt.NDArray[np.floating]) -> float:
    """How sure it is that the ratio of two depths grows towards the corners, in standard deviations; of a camera nobody knows."""
    h, w = values.shape
    y, x = np.mgrid[0:h, 0:w]
    rho2 = ((x - (w - 1) / 2) ** 2 + (y - (h - 1) / 2) ** 2) / (w / 2) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.log(np.abs(values) / reference)
    known = np.isfinite(ratio)
    if known.sum() < 100:
        return 0.0
    at = np.flatnonzero(known)[:: max(1, int(known.sum()) // SAMPLES)]
    order = np.argsort(rho2.reshape(-1)[at], kind="stable")
    gx, gy = (np.array([np.median(g) for g in np.array_split(a.reshape(-1)[at][order], GROUPS)]) for a in (rho2, ratio))
    gx, gy = gx - gx.mean(), gy - gy.mean()
    slope = float((gx * gy).sum() / (gx * gx).sum())
    sigma = float(np.sqrt(((gy - slope * gx) ** 2).sum() / (GROUPS - 2) / (gx * gx).sum()))
    return slope / max(sigma, 1e-6) if abs(slope) > 3e-3 else 0.0


def _judged(
    best: _Fit, rivals: list[_Fit], ref: Float64, *, units: Mapping[str, float], exact: bool, reference: str, role: str, radial: float | None
) -> Reading:
    form, doubts = best.form, []
    if form.kind in SCALED:
        if _has_unit(form.metres, units):
            form = replace(form, metres=_nearest_unit(form.metres, units))
        elif not exact:
            doubts.append(f"one unit would be {form.metres:.4g} m, which is no unit")
    elif not exact:
        doubts.append(f"its ends would have to be taken from {reference}")
    log_ref = np.log(ref)
    open_rivals: list[str] = []
    for rival in rivals:
        same: Bool = np.abs(rival.log - best.log - np.median(rival.log - best.log)) < SAME
        if same.mean() > 0.99 and (form.kind in SCALED) == (rival.form.kind in SCALED):
            continue
        lean, sigma = _lean(best.log, rival.log, log_ref)
        if not (lean > LEAN and lean > LEAN_SIGMA * sigma) and rival.free < 3 * best.free:
            open_rivals.append(WORDS[rival.form.kind])
    if open_rivals:
        doubts.append(f"it may as well be {' or '.join(dict.fromkeys(open_rivals[:2]))}")
    if radial is not None and form.kind == "z" and abs(radial) > 6:
        doubts.append("its ratio to the other depth changes towards the corners, as of ray lengths: give the camera by --rig or --fov-deg")
    within = next((p for p in FIT_PERCENT if best.share(p) >= 0.5), FIT_PERCENT[-1])
    share = best.share(within)
    if share < LEAST_FIT:
        doubts.insert(0, f"only {100 * share:.0f} % of the pixels lie within {within:g} % of {reference} by any reading")
    told, following = f"{role} is {form.words()}: {100 * share:.0f} % of pixels fit {reference} within {within:g} %", np.nan
    telling = [r for r in rivals if not np.all(np.abs(r.log - best.log) < SAME)]
    if telling:
        nearest = min(telling, key=lambda f: f.free)
        following = nearest.share(within)
        told += f", against {100 * following:.0f} % as {WORDS[nearest.form.kind]}"
    doubt = f"{role} looks like {form.words()}, but {'; '.join(doubts)}. State it: {form.options()}" if doubts else ""
    return Reading(form=form, sure=not doubts, words=told, doubt=doubt, within_percent=within, share=share, next_share=following)


DISPARITY_SCALES: Mapping[str, float] = {
    "pixels": 1.0,
    "256ths of a pixel": 1 / 256,
    "16ths of a pixel": 1 / 16,
    "8ths of a pixel": 1 / 8,
    "quarter pixels": 1 / 4,
}


def detect_disparity(
    values: npt.NDArray[np.floating], reference_px: npt.NDArray[np.floating], *, width: int, role: str = "truth"
) -> tuple[float, str, str]:
    """What makes `values` disparities in pixels, x_left - x_right: the factor, the evidence, and the doubt where it is no known one.

    values, reference_px : (H, W), NaN where unknown.   width : of the picture, px: some write shares of it.
    """
    with np.errstate(invalid="ignore"):
        known = np.isfinite(values) & np.isfinite(reference_px) & (values != 0) & (np.abs(reference_px) > 1)
    if known.sum() < 100:
        raise PassError(f"{role} and the result have hardly a known pixel of disparity in common; do they belong to the same frame and eye?")
    v, ref = values[known].astype(np.float64), reference_px[known].astype(np.float64)
    factor = float(np.median(ref / v))
    known_ones = {**DISPARITY_SCALES, "shares of the width": float(width)}
    name, size = min(known_ones.items(), key=lambda item: abs(np.log(abs(factor) / item[1])))
    signed = float(np.sign(factor)) * size
    share = float((np.abs(v * signed - ref) <= np.maximum(1.0, 0.02 * np.abs(ref))).mean())
    turned = ", with the sign turned" if factor < 0 else ""
    told = f"{role} is disparity in {name}{turned}: {100 * share:.0f} % of pixels fit the result within 1 px or 2 %"
    if abs(np.log(abs(factor) / size)) > np.log(1.15) or share < 0.3:
        return signed, told, f"{told}. That is too little to tell, one unit would be {factor:.4g} px: state it with --unit"
    return signed, told, ""
