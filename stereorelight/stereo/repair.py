"""Fixes that a person makes to a recovered depth: hold it to a constant or a plane, pin it to known distances, lay a clean
plate's depth behind the actor.

In: a `Frame` with Z (and confidence, flags) on the plate, and `Fix`es on the same plate.  Out: the frame with Z changed
inside the mattes, exactly there and nowhere else, REPAIRED set, and a confidence that is the person's word.  A matte's
0.5 line is where its surface ends: depth is never mixed with what lies outside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from stereorelight.arrays import Bool, Float32, Float64
from stereorelight.camera import Camera, Rig
from stereorelight.errors import PassError, ShotError
from stereorelight.passes import Flag, Frame

Kind = Literal["constant", "plane", "pins", "clean_plate"]
FEWEST = 12  # pixels with depth that a plane is fitted to, at least
PIN_RADIUS = 2  # px: a pin stands for the median of this square
SAID = 0.98  # confidence of what a person states
FITTED = 0.9  # of a plane fitted to the depth itself
ROUNDS = 8
SAME = 0.98  # from this share of the clean plate's distance on it is the set's own surface, and nothing stands behind that
GUESSED = Flag.FILLED | Flag.OCCLUDED | Flag.UNMATCHED | Flag.OUT_OF_VIEW


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A pixel (x, y) whose depth is known: `distance_m` along the optical axis, or `shift_per_m` to add to 1/Z there."""

    x: float
    y: float
    distance_m: float | None = None
    shift_per_m: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Fix:
    """One repair of one frame.

    kind       : "constant": Z = distance_m.  "plane": the plane in space through three or more pins, else the one that the
                 depth inside the matte fits best.  "pins": 1/Z is shifted, smoothly, until every pin holds.
                 "clean_plate": `clean_Z` wherever the depth is a guess, the same within 2 %, or behind it.
    matte      : (H, W) 0..1, where it holds; None is everywhere.
    """

    name: str
    kind: Kind
    matte: Float32 | None = None
    distance_m: float | None = None
    pins: tuple[Pin, ...] = ()
    clean_Z: Float32 | None = None

    def __post_init__(self) -> None:
        if self.kind == "constant" and not (self.distance_m is not None and np.isfinite(self.distance_m) and self.distance_m > 0):
            raise ShotError(f"repair {self.name}: constant needs distance_m > 0, got {self.distance_m!r}")
        if self.kind == "pins" and not self.pins:
            raise ShotError(f"repair {self.name}: pins needs at least one pin [x, y, metres]")
        if self.kind == "plane" and 0 < len(self.pins) < 3:
            raise ShotError(f"repair {self.name}: a plane through pins needs three or more, got {len(self.pins)}")
        if self.kind == "clean_plate" and self.clean_Z is None:
            raise ShotError(f"repair {self.name}: clean_plate needs the depth of the empty set")
        if self.kind in ("constant", "plane") and self.matte is None:
            raise ShotError(f"repair {self.name}: {self.kind} needs a matte, or it would flatten the whole picture")
        for pin in self.pins:
            if pin.shift_per_m is None and not (pin.distance_m is not None and np.isfinite(pin.distance_m) and pin.distance_m > 0):
                raise ShotError(f"repair {self.name}: pin at ({pin.x:g}, {pin.y:g}) must be > 0 metres away, got {pin.distance_m!r}")


def _inside(fix: Fix, shape: tuple[int, ...]) -> Bool:
    if fix.matte is None:
        return np.ones(shape, np.bool_)
    if fix.matte.shape != shape:
        raise PassError(f"repair {fix.name}: its matte is {fix.matte.shape[1]}x{fix.matte.shape[0]}, the plate {shape[1]}x{shape[0]} pixels")
    inside = fix.matte > 0.5
    if not inside.any():
        raise PassError(f"repair {fix.name}: its matte is empty on this frame; paint it where the repair belongs")
    return inside


def _median_at(inverse: Float64, inside: Bool, pin: Pin, name: str) -> float:
    """Median of 1/Z about a pin, of pixels inside the matte."""
    height, width = inverse.shape
    x, y = round(pin.x), round(pin.y)
    if not (0 <= x < width and 0 <= y < height):
        raise PassError(f"repair {name}: pin at ({pin.x:g}, {pin.y:g}) lies outside the plate of {width}x{height} pixels")
    rows, columns = slice(max(0, y - PIN_RADIUS), y + PIN_RADIUS + 1), slice(max(0, x - PIN_RADIUS), x + PIN_RADIUS + 1)
    values = inverse[rows, columns][inside[rows, columns]]
    values = values[np.isfinite(values)]
    if values.size == 0:
        raise PassError(f"repair {name}: there is no depth inside the matte at pin ({pin.x:g}, {pin.y:g}) to begin from")
    return float(np.median(values))


def pin_shifts(Z: Float32, fix: Fix) -> tuple[Pin, ...]:
    """The pins of `fix` as shifts of 1/Z, which is what can be carried to other frames, where distances change."""
    inverse = 1 / Z.astype(np.float64)
    inside = _inside(fix, Z.shape)
    return tuple(
        pin
        if pin.shift_per_m is not None
        else replace(pin, distance_m=None, shift_per_m=1 / (pin.distance_m or 1.0) - _median_at(inverse, inside, pin, fix.name))
        for pin in fix.pins
    )


def _shifted(Z: Float32, fix: Fix, inside: Bool) -> Float32:
    """1/Z plus the pins' shifts, weighed by one over distance squared: exact at each pin, their mean far away."""
    inverse = 1 / Z.astype(np.float64)
    y, x = np.nonzero(inside)
    total, weight = np.zeros(x.size), np.zeros(x.size)
    for pin in pin_shifts(Z, fix):
        w = 1 / ((x - pin.x) ** 2 + (y - pin.y) ** 2 + 1e-6)
        total += w * (pin.shift_per_m or 0.0)
        weight += w
    changed = inverse[y, x] + total / weight
    if (changed <= 0).any():
        raise PassError(f"repair {fix.name}: the pins would push {int((changed <= 0).sum())} pixels beyond infinity; check their distances and matte")
    out = Z.copy()
    out[y, x] = (1 / changed).astype(np.float32)
    return out


def _plane(inverse: Float64, rays: Float64, fix: Fix, inside: Bool, camera: Camera) -> tuple[Float64, float]:
    """(a, b, c) of 1/Z = a x/z + b y/z + c, through the pins or by a robust fit to the depth, and the fit's residual, 1/m."""
    if fix.pins:
        at = camera.rays(np.array([(pin.x, pin.y) for pin in fix.pins]))[:, :2]
        target = np.array([1 / pin.distance_m if pin.distance_m else np.nan for pin in fix.pins])
        if not np.isfinite(target).all():
            raise PassError(f"repair {fix.name}: a plane's pins need distances")
    else:
        use = inside & np.isfinite(inverse)
        at, target = rays[use], inverse[use]
        if target.size < FEWEST:
            raise PassError(f"repair {fix.name}: only {target.size} pixels inside the matte have a depth; give the plane three pins [x, y, metres]")
    A = np.column_stack([at, np.ones(len(at))])
    weight = np.ones(len(at))
    plane: Float64 = np.zeros(3)
    residual: Float64 = np.zeros(len(at))
    for _ in range(1 if fix.pins else ROUNDS):
        plane = np.asarray(np.linalg.lstsq(A * weight[:, None], target * weight, rcond=None)[0], dtype=np.float64)
        residual = np.asarray(target - A @ plane, dtype=np.float64)
        spread = 1.4826 * np.median(np.abs(residual)) + 1e-9
        weight = np.sqrt(1 / (1 + (residual / (2 * spread)) ** 2))
    if np.linalg.matrix_rank(A - A.mean(axis=0), tol=1e-6) < 2:
        raise PassError(f"repair {fix.name}: the pins lie on one line, which says no plane; move one off it")
    return plane, float(np.sqrt(np.mean(residual**2)))


def _flattened(Z: Float32, fix: Fix, inside: Bool, camera: Camera) -> Float32:
    inverse = 1 / Z.astype(np.float64)
    rays = camera.ray_grid().astype(np.float64)[..., :2]
    plane, _ = _plane(inverse, rays, fix, inside, camera)
    held = rays[inside] @ plane[:2] + plane[2]
    if not (held > 0).all():
        raise PassError(f"repair {fix.name}: its plane runs behind the camera inside the matte; check the pins and the matte")
    out = Z.copy()
    out[inside] = (1 / held).astype(np.float32)
    return out


def _behind(Z: Float32, flags: np.ndarray, fix: Fix, inside: Bool) -> tuple[Float32, Bool]:
    clean = fix.clean_Z
    if clean is None or clean.shape != Z.shape:
        size = "missing" if clean is None else f"{clean.shape[1]}x{clean.shape[0]}"
        raise PassError(f"repair {fix.name}: the clean plate's depth is {size}, the plate {Z.shape[1]}x{Z.shape[0]} pixels")
    with np.errstate(invalid="ignore"):
        guess = ((flags & np.uint16(GUESSED)) != 0) | np.isnan(Z)
        takes = inside & np.isfinite(clean) & (guess | (clean * SAME < Z))
    return np.where(takes, clean, Z).astype(np.float32), takes


def repaired(frame: Frame, fixes: Sequence[Fix]) -> tuple[Frame, list[Mapping[str, Any]]]:
    """`frame` with every fix made, in order, and for each what it did: pixels, share of them that moved by over 1 %.

    Raises : PassError where a fix does not fit this frame: size, empty matte, pins outside it, no depth to begin from.
    """
    Z = frame["Z"]
    camera = frame.camera
    if camera is None:
        raise PassError("a depth needs the camera that saw it before it can be repaired")
    flags = frame["flags"].copy() if "flags" in frame else np.zeros(Z.shape, np.uint16)
    confidence = frame["confidence"].copy() if "confidence" in frame else None
    done: list[Mapping[str, Any]] = []
    for fix in fixes:
        inside, before = _inside(fix, Z.shape), Z
        if fix.kind == "constant":
            Z = np.where(inside, np.float32(fix.distance_m or 0.0), Z).astype(np.float32)
        elif fix.kind == "plane":
            Z = _flattened(Z, fix, inside, camera)
        elif fix.kind == "pins":
            Z = _shifted(Z, fix, inside)
        else:
            Z, inside = _behind(Z, flags, fix, inside)
        flags[inside] = (flags[inside] & ~np.uint16(GUESSED | Flag.TOO_FAR)) | np.uint16(Flag.REPAIRED)
        if confidence is not None and fix.kind != "pins":
            confidence[inside] = FITTED if fix.kind == "plane" and not fix.pins else SAID
        with np.errstate(invalid="ignore"):
            moved = ~(np.abs(Z[inside] - before[inside]) <= 0.01 * Z[inside])
        done.append(
            {
                "name": fix.name,
                "kind": fix.kind,
                "pixels": int(inside.sum()),
                "moved_percent": round(100 * float(moved.mean()), 1) if moved.size else 0.0,
            }
        )
    passes = {**frame.passes, "Z": Z, "flags": flags}
    if confidence is not None:
        passes["confidence"] = confidence
    return replace(frame, passes=passes), done


def fix_in_other_eye(fix: Fix, Z_left: Float32, rig: Rig) -> Fix:
    """`fix`, made on the left plate, on the right one: its matte carried by the repaired depth of the left eye.

    Z_left : (H, W), repaired already: what the matte covers lies where the person said.
    """
    import cv2

    if fix.matte is None:
        return replace(fix, pins=())
    height, width = rig.right.size_hw
    inside = (fix.matte > 0.5) & np.isfinite(Z_left)
    points = rig.left.unproject(rig.left.pixel_grid().reshape(*Z_left.shape, 2)[inside], Z_left[inside])
    in_right = points @ rig.R_right_left.T + rig.t_right_left_m
    ahead = in_right[:, 2] > 0
    at = np.rint(rig.right.project(in_right[ahead]))
    seen = np.isfinite(at).all(axis=-1) & (at >= 0).all(axis=-1) & (at[:, 0] < width) & (at[:, 1] < height)
    matte = np.zeros((height, width), np.uint8)
    columns, rows = at[seen].astype(np.intp).T
    matte[rows, columns] = 1
    # A stretched surface leaves seams of a pixel between its columns.
    closed = cv2.morphologyEx(cv2.copyMakeBorder(matte, 2, 2, 2, 2, cv2.BORDER_CONSTANT), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[2:-2, 2:-2]
    pins = []
    for pin in fix.pins:
        x, y = round(pin.x), round(pin.y)
        distance = float(Z_left[y, x])
        point = rig.left.unproject(np.array([[pin.x, pin.y]]), np.array([distance]))[0] @ rig.R_right_left.T + rig.t_right_left_m
        u, v = rig.right.project(point[None])[0]
        if 0 <= u <= width - 1 and 0 <= v <= height - 1:
            pins.append(Pin(x=float(u), y=float(v), distance_m=float(point[2])))
    turned = replace(fix, matte=closed.astype(np.float32), pins=tuple(pins))
    if fix.kind == "constant" and at.size:
        # The same surface, not the same number: a converged eye sees a flat card at other depths.
        sample = in_right[ahead][:: max(1, len(in_right) // 4096)]
        corners = rig.right.project(sample)
        keep = np.isfinite(corners).all(axis=-1)
        corner_pins = tuple(Pin(x=float(u), y=float(v), distance_m=float(z)) for (u, v), z in zip(corners[keep], sample[keep][:, 2]))
        return replace(turned, kind="plane", distance_m=None, pins=corner_pins) if len(corner_pins) >= 3 else turned
    return turned
