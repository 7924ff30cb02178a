"""Any renderer's passes in the terms of ours: Z in metres along the axis, N in the scene frame; found out with evidence, or as stated.

In: `RawPasses`, the camera that saw them, and another depth and normals of the same plate to hold them against.  Out: `Understood`: Z and N at
the file's own pixels, and what was found, in words.  What cannot be told is a PassError with what to state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera
from stereorelight.compare.axes import Axes, AxesReading, axes_named, axis_words, coding_of, detect_normals, detect_positions
from stereorelight.compare.conventions import CODE_UNITS, KINDS, SCALED, UNITS, WORDS, DepthForm, Kind, Reading, depth_from, detect_depth
from stereorelight.compare.normals import depth_normals
from stereorelight.compare.placing import Placement, nearest
from stereorelight.errors import PassError, nearest_hint
from stereorelight.footage.foreign import RawPasses

UNLIKE = 3.0  # so many times more pixels must fit another reading than the stated one before it is said


@dataclass(frozen=True, kw_only=True, eq=False)
class Stated:
    """What the user says of a file; None is to be found out.

    kind, metres, near_m, far_m : of its depth.   axes : such as "right,down,forward", of P and N.
    crop  : (x, y) of the result's pixel on which its first one lies.   pose : world_from_camera (4, 4) of a world's P and N.
    """

    kind: Kind | None = None
    metres: float | None = None
    near_m: float | None = None
    far_m: float | None = None
    axes: str | None = None
    layer: str | None = None
    crop: tuple[int, int] | None = None
    pose: Float64 | None = None

    @property
    def of_values(self) -> bool:
        """Whether anything is said of what the values mean."""
        return any(v is not None for v in (self.kind, self.metres, self.near_m, self.axes, self.pose))


@dataclass(frozen=True, kw_only=True, eq=False)
class Understood:
    """Z (H, W) metres and N (H, W, 3), scene frame, at the file's own pixels, each None where it has none; the notes; and what was found, to be
    stated for the frames that follow."""

    Z: Float64 | None
    N: Float64 | None
    notes: tuple[str, ...]
    stated: Stated


def unit_of(text: str) -> float:
    """Metres of one unit: m, cm, mm, ft, in, km, or a number of metres.  Raises PassError."""
    if text in UNITS:
        return UNITS[text]
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and value > 0):
        raise PassError(f"unit {text!r} is none{nearest_hint(text, UNITS)}; or give the metres of one unit as a number")
    return value


def kind_of(text: str) -> Kind:
    """The kind of depth that a user names.  Raises PassError."""
    for kind in KINDS:
        if text.lower() == kind:
            return kind
    if text.lower() in ("1/z", "depth"):
        return "inverse" if text == "1/z" else "z"
    raise PassError(f"depth is no {text!r}{nearest_hint(text, KINDS)}")


def understood(
    raw: RawPasses,
    *,
    camera: Camera | None,
    size_hw: tuple[int, int],
    placement: Placement,
    stated: Stated,
    Z: Any = None,
    N: Any = None,
    wanted: tuple[str, ...] = ("Z", "N"),
    role: str = "truth",
    source: str = "the result",
) -> Understood:
    """What the passes of a file are.

    camera    : of the file's own pixels.   size_hw, placement : of the plate on which Z and N lie, and where the file lies on it.
    Z, N      : (H, W) metres and (H, W, 3), scene frame, of that plate, or None: what the file is held against where it holds nothing better.
    wanted    : passes without which there is no use going on.
    Raises    : PassError with what to state, where something wanted cannot be told.
    """
    rays = None if camera is None else camera.ray_grid()
    notes: list[str] = []

    def on_plate(values: Any) -> Any:
        return nearest(values, size_hw, placement)

    plate_rays = None if rays is None else on_plate(rays)
    points, turn = _points(raw, rays, stated, role, notes, needed="Z" in wanted and raw.depth is None)
    depth, found = None, stated
    if points is not None:
        along = -points[..., 2]
        held = stated.metres or _unit_of_points(on_plate(along), Z, stated, source, role, notes)
        depth = np.where(along > 0, along * held, np.nan)
        found = replace(found, metres=held)
    exact = depth is not None
    if raw.depth is not None and (not exact or "Z" in wanted):
        held_against, own = (depth, f"{role}'s P") if exact else (None if Z is None else Z, source)
        values = raw.depth if exact else on_plate(raw.depth)
        form = _form(values, held_against, rays if exact else plate_rays, raw, stated, own, role, notes, exact=exact, N=raw.N)
        depth = depth_from(raw.depth, form, rays)
        found = replace(stated, kind=form.kind, metres=form.metres if form.kind in SCALED else None, near_m=form.near_m, far_m=form.far_m)
    if "Z" in wanted and depth is None:
        there = ", ".join(raw.names) or "nothing of the kind"
        raise PassError(f"{raw.path}: has no depth that could be Z, only {there}; name the channel with --layer")
    normals = None
    if raw.N is not None and "N" in wanted:
        reading = _axes_of_normals(raw, depth, rays, stated, turn, N, on_plate, source, role)
        _settle(raw, reading, notes)
        normals = reading.axes.normals(raw.N)
        if axis_words(reading.axes.matrix) is not None:
            found = replace(found, axes=",".join(axis_words(reading.axes.matrix) or ()))
    if "N" in wanted and normals is None:
        raise PassError(f"{raw.path}: has no pass N, only {', '.join(raw.names)}; name its channels with --layer")
    return Understood(Z=depth, N=normals, notes=tuple(f"{raw.path.name}: {note}" for note in notes), stated=found)


def _settle(raw: RawPasses, reading: Reading | AxesReading, notes: list[str]) -> None:
    if not reading.sure:
        raise PassError(f"{raw.path}: {reading.doubt}")
    notes.append(reading.words)


def _points(raw: RawPasses, rays: Any, stated: Stated, role: str, notes: list[str], *, needed: bool) -> tuple[Float64 | None, Float64 | None]:
    """P in the scene frame of the camera, in its own unit, and the turn from its world, where there is one."""
    if raw.P is None:
        return None, None
    if stated.pose is not None:
        inverse: Float64 = np.linalg.inv(stated.pose).astype(np.float64)
        notes.append(f"{role}'s P is of the world of the pose, as stated")
        return Axes(matrix=inverse[:3, :3], shift=inverse[:3, 3] / (stated.metres or 1.0)).points(raw.P), inverse[:3, :3]
    if rays is None:
        if needed:
            raise PassError(f"{raw.path}: P needs the camera that saw it: give --rig or --fov-deg")
        return None, None
    reading = detect_positions(raw.P, rays, stated=None if stated.axes is None else axes_named(stated.axes), role=role)
    if not reading.sure and not needed:
        notes.append(f"P is left out: {reading.doubt}")
        return None, None
    _settle(raw, reading, notes)
    return reading.axes.points(raw.P), reading.axes.matrix


def _unit_of_points(along: Any, Z: Any, stated: Stated, source: str, role: str, notes: list[str]) -> float:
    if Z is None:
        notes.append(f"{role}'s P is taken in metres: nothing here tells its unit; state it with --unit where it has another")
        return 1.0
    reading = detect_depth(along, Z, kinds=("z",), reference=source, role=f"{role}'s P")
    if not reading.sure:
        raise PassError(f"{reading.doubt}")
    notes.append(reading.words.replace(f"{WORDS['z']} in ", "in "))
    return reading.form.metres


def _form(
    values: Any, held_against: Any, rays: Any, raw: RawPasses, stated: Stated, source: str, role: str, notes: list[str], *, exact: bool, N: Any
) -> DepthForm:
    """The form of a depth: as stated, and held against what there is, or found."""
    top = raw.top
    told: DepthForm | None = None
    if stated.kind is not None and stated.kind not in SCALED:
        told = DepthForm(kind=stated.kind, near_m=stated.near_m, far_m=stated.far_m, top=top)
    elif stated.near_m is not None or stated.far_m is not None:
        raise PassError(f"{raw.path}: --near and --far belong to a normalised depth: state which with --truth-is normalised, reversed or buffer")
    elif stated.kind is not None and stated.metres is not None:
        told = DepthForm(kind=stated.kind, metres=stated.metres, top=top)
    units = {"stated": stated.metres} if stated.metres is not None else CODE_UNITS if top > 1 else UNITS
    if held_against is None:
        return told or _alone(values, rays, raw, stated, role, notes, N=N)
    kinds = KINDS if stated.kind is None else (stated.kind,)
    if told is None:
        reading = detect_depth(values, held_against, rays=rays, kinds=kinds, units=units, top=top, exact=exact, reference=source, role=role)
        _settle(raw, reading, notes)
        return reading.form
    reading = detect_depth(values, held_against, rays=rays, top=top, units=CODE_UNITS if top > 1 else UNITS, exact=True, reference=source, role=role)
    depth = depth_from(values, told, rays)
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(np.log(depth / held_against))
    known = np.isfinite(held_against) & np.isfinite(values)
    share = float((off[known] <= np.log1p(reading.within_percent / 100)).mean())
    notes.append(f"{role} is {told.words()}, as stated: {100 * share:.0f} % of pixels fit {source} within {reading.within_percent:g} %")
    if reading.share > UNLIKE * share and (reading.form.kind != told.kind or abs(np.log(reading.form.metres / told.metres)) > 0.2):
        notes.append(f"that does not look right: as {reading.form.words()} {100 * reading.share:.0f} % would fit")
    return told


def _alone(values: Any, rays: Any, raw: RawPasses, stated: Stated, role: str, notes: list[str], *, N: Any) -> DepthForm:
    """A depth with nothing to hold it against but perhaps the file's own N: which kind has slopes that N agrees with."""
    form = DepthForm(kind=stated.kind or "z", metres=stated.metres or 1.0, top=raw.top)
    if raw.top > 1 and stated.metres is None:
        raise PassError(f"{raw.path}: holds whole numbers, and nothing tells their unit: state it with --unit, such as mm, or with --near and --far")
    if N is None or rays is None or stated.kind is not None or coding_of(N) is None:
        if not raw.ours and stated.kind is None:
            notes.append(f"{role} is taken as {form.words()}: nothing in the file tells otherwise")
        return form
    shares: dict[Kind, float] = {}
    for kind in SCALED:
        normals = scene_normals(depth_from(values, DepthForm(kind=kind), rays), rays)
        reading = detect_normals(N, normals, exact=True, source="the slopes of its depth", role=role)
        shares[kind] = reading.share
    order = sorted(SCALED, key=lambda k: -shares[k])
    best, second = order[0], order[1]
    told = f"{role} is {WORDS[best]}: {100 * shares[best]:.0f} % of its N fit its slopes, against {100 * shares[second]:.0f} % as {WORDS[second]}"
    if shares[best] < 0.5 or shares[best] < 1.1 * shares[second]:
        if shares["z"] < 0.9 * shares[best]:
            raise PassError(f"{raw.path}: {told}. That is too little to tell: state --depth-is z, ray or inverse")
        best = "z"
    notes.append(told + f"; the unit is taken as {form.words().rpartition(' in ')[2]}")
    return replace(form, kind=best)


def scene_normals(Z: Float64, rays: Any) -> Float64:
    """(H, W, 3) normals of a depth by its own slopes, scene frame, facing the camera."""
    away = depth_normals(Z, rays)
    return np.stack([-away[..., 0], away[..., 1], away[..., 2]], axis=-1)


def _axes_of_normals(raw: RawPasses, depth: Any, rays: Any, stated: Stated, turn: Any, N: Any, on_plate: Any, source: str, role: str) -> AxesReading:
    named = None if stated.axes is None else axes_named(stated.axes)
    if depth is not None and rays is not None:
        own, name = scene_normals(depth, rays), "the slopes of its own depth"
        return detect_normals(raw.N, own, stated=named, world=_of_world(turn), exact=True, source=name, role=role)  # type: ignore[arg-type]
    if N is None:
        coded = coding_of(raw.N) if raw.N is not None else None
        axes = Axes(matrix=np.eye(3) if named is None else named, coded=bool(coded))
        words = f"{role}'s N is taken with {axes.words()}"
        return AxesReading(axes=axes, sure=True, words=words)
    return detect_normals(on_plate(raw.N), N, stated=named, world=_of_world(turn), source=source, role=role)


def _of_world(turn: Any) -> Any:
    return turn if turn is not None and axis_words(turn) is None else None
