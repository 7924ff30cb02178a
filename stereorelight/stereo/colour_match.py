"""Mending colour: the right eye's plate is given the left one's colour, where both see the same surface.

In: rectified scene-linear plates (H, W, 3) and what matches what (a disparity on the left view, or sparse matches).
Out: the right plate, and a `ColourMatch` that says what was done, can be written down, and can be applied to other frames.
Only surfaces that both eyes see are compared: plates compared as wholes take a strip of wall that only one eye sees for a cast.
The model is the plainest that holds on ground it was not fitted to: gains; gains and offsets; a 3x3 matrix.  `local` adds a gain
field on a coarse tensor B-spline (knots an eighth of the width apart), too smooth to follow texture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, as_float32
from stereorelight.engine.occlusion import consistent
from stereorelight.errors import PassError, PlateError, nearest_hint
from stereorelight.stereo.match import semi_global
from stereorelight.stereo.proxy import matching_proxy
from stereorelight.stereo.semi_global import DisparityRange

Mode = Literal["global", "local"]
MODES = ("global", "local")
SMALL_WIDTH = 480  # pixels of the copy that is compared: grain and a quarter pixel of error average out, an edge still is one
LEAST_PAIRS = 200
MOST_PAIRS = 20_000
DEEPEST = 0.004  # of the brightest 1 %: darker than this is black level and grain, and its ratio says nothing
CLIPPED_SHARE = 2e-4  # of the frame: so much ground at the very top is a ceiling and not a highlight
FLAT_PX = 1.0  # disparity that varies more than this over 3 pixels of the copy is an edge, where colours mix
HELD_OUT = 24  # pixels of the copy: side of the blocks that take turns in fitting and judging
PAYS = 0.93  # of the plainer model's error: what a richer one must come down to, on ground it has not seen
TUKEY = 4.0
KNOTS = 8  # spans of the field along the width
STIFFNESS = 0.3  # price of the field's bending against blocks of data
BLOCK = 12  # pixels of the copy: side of the blocks that the field is fitted to


@dataclass(frozen=True, kw_only=True, eq=False)
class ColourMatch:
    """What makes the right plate look like the left one.

    matrix, offsets : L = matrix R + offsets, scene-linear RGB; the matrix is diagonal unless "matrix" was chosen.
    field           : (ky, kx, 3) knots of a gain field in stops on the right plate, or None.
    chosen          : "gain", "gain and offset" or "matrix".
    residual_before_stops, residual_after_stops : median over channels and pairs of |log2(L / R)|, on pairs that both eyes see.
    cast_before, cast_after : (3,) median of L / R by channel.
    pairs           : how many pixels of the copy were compared;  share : of the frame.
    """

    mode: Mode
    chosen: str
    matrix: Float64
    offsets: Float64
    field: Float64 | None
    residual_before_stops: float
    residual_after_stops: float
    cast_before: tuple[float, float, float]
    cast_after: tuple[float, float, float]
    pairs: int
    share: float

    @property
    def gains(self) -> tuple[float, float, float]:
        """The diagonal of the matrix."""
        r, g, b = np.diag(self.matrix)
        return float(r), float(g), float(b)

    def apply(self, right: npt.ArrayLike) -> Float32:
        """A right plate (H, W, 3), any frame of the same shot, in the left one's colours; NaN stays NaN."""
        a = as_float32(right, "right plate", channels=3)
        if self.chosen == "matrix":
            out = a @ self.matrix.T.astype(np.float32)
        else:
            out = a * np.diag(self.matrix).astype(np.float32)
        if self.offsets.any():
            out += self.offsets.astype(np.float32)
        if self.field is not None:
            out *= np.exp2(field_stops(self.field, a.shape[1], a.shape[0]))
        return np.ascontiguousarray(out, dtype=np.float32)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a receipt."""
        return {
            "mode": self.mode,
            "chosen": self.chosen,
            "matrix": self.matrix.tolist(),
            "offsets": self.offsets.tolist(),
            "field_stops": None if self.field is None else self.field.tolist(),
            "residual_before_stops": self.residual_before_stops,
            "residual_after_stops": self.residual_after_stops,
            "cast_before": list(self.cast_before),
            "cast_after": list(self.cast_after),
            "pairs": self.pairs,
            "share": self.share,
        }


def _basis(at: Float64, spans: int) -> Float64:
    """(n, spans + 3) uniform cubic B-splines at `at` in 0..1."""
    t = np.clip(at, 0, 1) * spans
    first = np.minimum(t.astype(int), spans - 1)
    u = t - first
    values = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=1) / 6
    out = np.zeros((len(t), spans + 3))
    np.put_along_axis(out, first[:, None] + np.arange(4), values, axis=1)
    return out


def field_stops(field: Float64, width: int, height: int) -> Float32:
    """(height, width, 3) stops of the knots (ky, kx, 3) on a plate of this size."""
    across = _basis((np.arange(width) + 0.5) / width, field.shape[1] - 3).astype(np.float32)
    down = _basis((np.arange(height) + 0.5) / height, field.shape[0] - 3).astype(np.float32)
    return np.stack([down @ (field[..., c].astype(np.float32) @ across.T) for c in range(3)], axis=-1)


def _usable(plate: Float32) -> tuple[Float32, Bool]:
    """The plate with 0 for what is unknown, and where each pixel is neither unknown nor clipped."""
    known: Bool = np.isfinite(plate[..., 0] + plate[..., 1] + plate[..., 2])
    filled = np.where(known[..., None], plate, np.float32(0))
    open_ = known
    for c in range(3):
        channel = filled[..., c]
        ceiling = channel.max()
        if ceiling > 0:
            at_top = channel >= 0.998 * ceiling
            if at_top.mean() > CLIPPED_SHARE:
                open_ = open_ & ~at_top
    return filled, open_


def _small(plate: Float32, size: tuple[int, int]) -> tuple[Float32, Bool]:
    filled, open_ = _usable(plate)
    if size == (plate.shape[1], plate.shape[0]):
        return filled, open_
    share = cv2.resize(open_.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return cv2.resize(filled, size, interpolation=cv2.INTER_AREA), share > 0.999


def _own_disparity(left: Float32, right: Float32) -> Float32:
    """A disparity of the small copies that both eyes confirm, NaN elsewhere; the range is whatever the frame allows."""
    proxy = matching_proxy(left, right)
    width = left.shape[1]
    found = semi_global(proxy, DisparityRange.holding(-width / 6, width / 3))
    return np.where(consistent(found.left, found.right, within_px=1.0), found.left, np.float32(np.nan))


def _pairs_by_disparity(left: Float32, right: Float32, disparity: Float32, left_open: Bool, right_open: Bool) -> tuple[Float64, Float64, Float64]:
    """Colours L, R (n, 3) of surfaces that both eyes see, and where on the right copy (n, 2)."""
    h, w = disparity.shape
    known = np.isfinite(disparity)
    filled = np.where(known, disparity, np.float32(0))
    kernel = np.ones((3, 3), np.uint8)
    spread = cv2.dilate(np.where(known, filled, np.float32(-1e6)), kernel) - cv2.erode(np.where(known, filled, np.float32(1e6)), kernel)
    column, row = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    target = column - filled
    inner = cv2.erode(left_open.astype(np.uint8), kernel, borderValue=0) > 0
    here = known & inner & (spread <= FLAT_PX) & (target >= 1) & (target <= w - 2)
    # A nearer surface that lands on the same right pixel hides this one: the nearest there wins.
    nearest = np.full((h, w + 1), -np.inf, np.float32)
    landing = np.rint(np.clip(target, 0, w)).astype(int)
    rows = row.astype(int)
    np.maximum.at(nearest, (rows[known], landing[known]), filled[known])
    here &= filled >= nearest[rows, landing] - FLAT_PX
    seen = cv2.remap(right, target, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen_open = cv2.remap(right_open.astype(np.float32), target, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    here &= seen_open > 0.999
    return left[here].astype(np.float64), seen[here].astype(np.float64), np.stack([target[here], row[here]], axis=1).astype(np.float64)


def _pairs_by_matches(left: Float32, right: Float32, matches: Float64, left_open: Bool, right_open: Bool) -> tuple[Float64, Float64, Float64]:
    h, w = left_open.shape
    at = matches.astype(np.float32)
    inside = np.isfinite(at).all(axis=1) & (at >= 1).all(axis=1) & (at[:, 0::2] <= w - 2).all(axis=1) & (at[:, 1::2] <= h - 2).all(axis=1)
    at = at[inside]

    def look(picture: Float32, xy: Float32) -> Float32:
        found: Float32 = cv2.remap(picture, np.ascontiguousarray(xy[None, :, 0]), np.ascontiguousarray(xy[None, :, 1]), cv2.INTER_LINEAR)[0]
        return found

    blurred_left, blurred_right = cv2.blur(left, (3, 3)), cv2.blur(right, (3, 3))
    good = (look(left_open.astype(np.float32), at[:, :2]) > 0.999) & (look(right_open.astype(np.float32), at[:, 2:]) > 0.999)
    at = at[good]
    return look(blurred_left, at[:, :2]).astype(np.float64), look(blurred_right, at[:, 2:]).astype(np.float64), at[:, 2:].astype(np.float64)


def _weights(residual: Float64) -> Float64:
    """Tukey's weights of (n, 3) or (n,) residuals against their own spread."""
    worst = np.abs(residual) / np.maximum(1.4826 * np.median(np.abs(residual), axis=0), 1e-9)
    worst = worst.max(axis=1) if worst.ndim == 2 else worst
    return np.clip(1 - (worst / TUKEY) ** 2, 0, None) ** 2


def _error(L: Float64, R: Float64) -> Float64:
    """Relative difference (n, 3), symmetric in the eyes."""
    return (L - R) / np.maximum((L + R) / 2, 1e-9)


def _fit_gain(L: Float64, R: Float64) -> tuple[Float64, Float64]:
    gain = np.median(L / R, axis=0)
    for _ in range(8):
        weight = _weights(_error(L, gain * R))
        # Ratio of sums: noise of either eye does not bend it, as it bends a regression.
        light = (weight / np.maximum((L + gain * R).mean(axis=1), 1e-9))[:, None]
        gain = (light * L).sum(axis=0) / (light * R).sum(axis=0)
    return np.diag(gain), np.zeros(3)


def _fit_gain_offset(L: Float64, R: Float64) -> tuple[Float64, Float64]:
    """Orthogonal (Deming) regression by channel, relative errors, robust."""
    matrix, offset = _fit_gain(L, R)
    gain = np.diag(matrix).copy()
    for _ in range(8):
        now = gain * R + offset
        weight = _weights(_error(L, now))[:, None] / np.maximum((L + now) / 2, 1e-6) ** 2
        total = weight.sum(axis=0)
        ml, mr = (weight * L).sum(axis=0) / total, (weight * R).sum(axis=0) / total
        scaled = gain * (R - mr)
        sll, srr, slr = (weight * (L - ml) ** 2).sum(axis=0), (weight * scaled**2).sum(axis=0), (weight * (L - ml) * scaled).sum(axis=0)
        gain = gain * (sll - srr + np.sqrt((sll - srr) ** 2 + 4 * slr**2)) / np.maximum(2 * slr, 1e-12)
        offset = ml - gain * mr
    return np.diag(gain), offset


def _fit_matrix(L: Float64, R: Float64) -> tuple[Float64, Float64]:
    matrix, offset = _fit_gain(L, R)
    for _ in range(8):
        now = R @ matrix.T
        weight = _weights(_error(L, now)) / np.maximum(((L + now) / 2).mean(axis=1), 1e-6) ** 2
        heavy = R * weight[:, None]
        normal = R.T @ heavy
        pull = 1e-4 * np.trace(normal) / 3 * np.eye(3)
        matrix = np.linalg.solve(normal + pull, heavy.T @ L + pull @ np.diag(np.diag(matrix))).T
    return matrix, offset


FITS = {"gain": _fit_gain, "gain and offset": _fit_gain_offset, "matrix": _fit_matrix}


def _chosen(L: Float64, R: Float64, places: Float64) -> str:
    """The plainest model that no richer one beats by much on blocks that it has not seen."""
    turn = ((places // HELD_OUT).astype(int).sum(axis=1) % 2).astype(bool)
    best, name = np.inf, "gain"
    if min(turn.sum(), (~turn).sum()) < LEAST_PAIRS // 2:
        return name
    for model, fit in FITS.items():
        errors = []
        for fitted in (turn, ~turn):
            matrix, offset = fit(L[fitted], R[fitted])
            errors.append(np.abs(_error(L[~fitted], R[~fitted] @ matrix.T + offset)).mean(axis=1))
        error = float(np.median(np.concatenate(errors)))
        if error < PAYS * best and error < best - 2e-4:
            best, name = error, model
    return name


def _fit_field(L: Float64, R: Float64, places: Float64, size: tuple[int, int]) -> Float64:
    """Knots (ky, kx, 3) in stops: blocks' robust ratios, joined by a bending plate."""
    w, h = size
    stops = np.log2(L / R)
    columns = -(-w // BLOCK)
    block = (places[:, 1] // BLOCK).astype(int) * columns + (places[:, 0] // BLOCK).astype(int)
    order = np.argsort(block, kind="stable")
    names, first, counts = np.unique(block[order], return_index=True, return_counts=True)
    kept = counts >= 8
    middle = np.array([np.median(stops[order[f : f + n]], axis=0) for f, n in zip(first[kept], counts[kept])]).reshape(-1, 3)
    u = ((names[kept] % columns) + 0.5) * BLOCK / w
    v = ((names[kept] // columns) + 0.5) * BLOCK / h
    across, down = KNOTS, max(3, round(KNOTS * h / w))
    bx, by = _basis(u, across), _basis(v, down)
    design = (by[:, :, None] * bx[:, None, :]).reshape(len(bx), -1)
    nx, ny = across + 3, down + 3
    dx, dy = np.diff(np.eye(nx), n=2, axis=0), np.diff(np.eye(ny), n=2, axis=0)
    twist = np.kron(np.diff(np.eye(ny), axis=0), np.diff(np.eye(nx), axis=0))
    bending = np.kron(np.eye(ny), dx.T @ dx) + np.kron(dy.T @ dy, np.eye(nx)) + 2 * twist.T @ twist
    weight = np.ones(len(bx))
    for _ in range(5):
        heavy = design * weight[:, None]
        normal = design.T @ heavy + STIFFNESS * max(weight.mean(), 1e-3) * bending
        normal[np.diag_indices_from(normal)] += 1e-6
        knots = np.linalg.solve(normal, heavy.T @ middle)
        weight = np.maximum(_weights(middle - design @ knots), 1e-3) if len(bx) > 8 else weight
    return knots.reshape(ny, nx, 3)


def _pairs(left: Float32, right: Float32, disparity: Any, matches: Any) -> tuple[Float64, Float64, Float64, tuple[int, int]]:
    h, w = left.shape[:2]
    scale = min(1.0, SMALL_WIDTH / w)
    size = (max(16, round(w * scale)), max(16, round(h * scale)))
    left_small, left_open = _small(left, size)
    right_small, right_open = _small(right, size)
    sx, sy = size[0] / w, size[1] / h
    if matches is not None:
        at = np.asarray(matches, np.float64)
        if at.ndim != 2 or at.shape[1] != 4:
            raise PassError(f"matches must have shape (n, 4): x, y in the left plate and x, y in the right one; got {at.shape}")
        at = (at + 0.5) * (sx, sy, sx, sy) - 0.5
        L, R, places = _pairs_by_matches(left_small, right_small, at, left_open, right_open)
    else:
        if disparity is None:
            unknown = np.float32(np.nan)
            d = _own_disparity(np.where(left_open[..., None], left_small, unknown), np.where(right_open[..., None], right_small, unknown))
        else:
            d = as_float32(disparity, "disparity", size_hw=(h, w))
            row = np.minimum(((np.arange(size[1]) + 0.5) / sy).astype(int), h - 1)
            column = np.minimum(((np.arange(size[0]) + 0.5) / sx).astype(int), w - 1)
            d = d[row][:, column] * np.float32(sx)
        L, R, places = _pairs_by_disparity(left_small, right_small, d, left_open, right_open)
    bright = np.quantile(L.max(axis=1), 0.99) if len(L) else 0.0
    ceiling = np.quantile(R.max(axis=1), 0.99) if len(R) else 0.0
    lit = (DEEPEST * bright < L).all(axis=1) & (DEEPEST * ceiling < R).all(axis=1) if len(L) else np.zeros(0, bool)
    step = max(1, int(lit.sum()) // MOST_PAIRS)  # an even sample fits as well as all of them
    return L[lit][::step], R[lit][::step], places[lit][::step], size


def match_colour(
    left: npt.ArrayLike, right: npt.ArrayLike, *, mode: Mode = "global", disparity: npt.ArrayLike | None = None, matches: npt.ArrayLike | None = None
) -> tuple[Float32, ColourMatch]:
    """The right plate in the left one's colours, and what was done.  The left plate is not touched.

    left, right : (H, W, 3) float, rectified, scene-linear, NaN where unknown.
    mode        : "global", one transform for the frame; "local", and a smooth gain field (vignetting, a veil, a mirror's tint).
    disparity   : (H, W) on the left view, px, NaN where the right eye does not see the point (left-right checked).
    matches     : (n, 4) x, y left and x, y right, px, in its place.  With neither, a small copy of the pair is matched.
    Raises      : PassError for wrong shapes; PlateError where too little is seen by both eyes.
    """
    if mode not in MODES:
        raise PassError(f"colour match mode {mode!r} is unknown{nearest_hint(str(mode), MODES)}")
    a = as_float32(left, "left plate", channels=3)
    b = as_float32(right, "right plate", channels=3, size_hw=(a.shape[0], a.shape[1]))
    L, R, places, size = _pairs(a, b, disparity, matches)
    if len(L) < LEAST_PAIRS:
        raise PlateError(
            f"colour match: only {len(L)} points are seen and well exposed in both plates, {LEAST_PAIRS} are wanted; are the plates a pair?"
        )
    chosen = _chosen(L, R, places)
    matrix, offsets = FITS[chosen](L, R)
    matched = np.maximum(R @ matrix.T + offsets, 1e-9)
    field = None
    if mode == "local":
        field = _fit_field(L, matched, places, size)
        across, down = _basis((places[:, 0] + 0.5) / size[0], field.shape[1] - 3), _basis((places[:, 1] + 0.5) / size[1], field.shape[0] - 3)
        matched = matched * np.exp2(np.einsum("nj,ni,jic->nc", down, across, field, optimize=True))

    def cast(of: Float64) -> tuple[float, float, float]:
        r, g, b = np.median(L / of, axis=0)
        return float(r), float(g), float(b)

    record = ColourMatch(
        mode=mode,
        chosen=chosen,
        matrix=matrix,
        offsets=offsets,
        field=field,
        residual_before_stops=float(np.median(np.abs(np.log2(L / R)))),
        residual_after_stops=float(np.median(np.abs(np.log2(L / matched)))),
        cast_before=cast(R),
        cast_after=cast(matched),
        pairs=len(L),
        share=len(L) / (size[0] * size[1]),
    )
    return record.apply(b), record
