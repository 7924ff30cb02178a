"""Scenes as values: shapes, materials and objects, and the tables of numbers that the ray caster reads.

Frames: world is the scene frame of the left camera (x right, y up, the camera looks down -z), metres; each object has its
own frame, placed by `origin_m` and `R_world_object`.  Texture lives in the object's frame: both eyes see the same colour at
the same surface point, and a turning head takes its skin along.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.engine.solids import Emptiness, emptiness
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.synth.lights import Light

Vector = tuple[float, float, float]
PATTERNS = ("matte", "skin", "hair", "cloth", "wood", "eye", "paper", "tiles", "marble")  # in the order of engine/texture.py
KINDS = ("plane", "sphere", "box", "solid", "rod")  # in the order of engine/raycast.py


def rotation(*, x_deg: float = 0.0, y_deg: float = 0.0, z_deg: float = 0.0) -> Float64:
    """(3, 3): turn about z, then x, then y (roll, pitch, yaw of a head), right-handed degrees."""
    a, b, c = (math.radians(d) for d in (x_deg, y_deg, z_deg))
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    turned: Float64 = about_y @ about_x @ about_z
    return turned


@dataclass(frozen=True, kw_only=True)
class Material:
    """Albedo 0..1 by pattern and grain, and a Phong lobe.

    contrast  : share by which the grain moves the colour, per unit of noise (rms about 0.35 of it).
    frequency : cycles per metre of the coarsest grain; each octave doubles it.  Pattern "tiles": also tiles per metre.
    stretch   : factors on the frequency along the object's x, y, z.
    """

    color: Vector
    color2: Vector = (0.0, 0.0, 0.0)
    pattern: str = "matte"
    contrast: float = 0.0
    frequency: float = 30.0
    octaves: int = 5
    gain: float = 0.6
    specular: float = 0.0
    exponent: float = 20.0
    stretch: Vector = (1.0, 1.0, 1.0)

    def row(self) -> list[float]:
        if self.pattern not in PATTERNS:
            raise ShotError(f"pattern {self.pattern!r} is unknown{nearest_hint(self.pattern, PATTERNS)}")
        head = [float(PATTERNS.index(self.pattern)), *self.color, *self.color2, self.contrast, self.frequency, float(self.octaves), self.gain]
        return [*head, self.specular, self.exponent, *self.stretch]


@dataclass(frozen=True)
class Primitive:
    """One shape of a solid; `blend_m` is the width over which it melts into what came before it."""

    row: tuple[float, ...]


def _primitive(
    shape: int, centre: Sequence[float], R: Float64, size: Sequence[float], reach: float, stretch: float, blend_m: float, cut: bool
) -> Primitive:
    sizes = [*size, 0.0, 0.0, 0.0, 0.0][:4]
    return Primitive((float(shape), float(cut), blend_m, *centre, *R.ravel().tolist(), *sizes, reach, stretch))


def ellipsoid(
    centre: Vector, radii: Vector, *, blend_m: float = 0.0, cut: bool = False, x_deg: float = 0.0, y_deg: float = 0.0, z_deg: float = 0.0
) -> Primitive:
    """An ellipsoid, turned in its place."""
    R = rotation(x_deg=x_deg, y_deg=y_deg, z_deg=z_deg).T
    return _primitive(0, centre, R, radii, max(radii), max(radii) / min(radii), blend_m, cut)


def ball(centre: Vector, radius: float, *, blend_m: float = 0.0, cut: bool = False) -> Primitive:
    return ellipsoid(centre, (radius, radius, radius), blend_m=blend_m, cut=cut)


def _frame_along(start: Vector, end: Vector) -> Float64:
    """(3, 3): rows are three right-angled unit vectors, the middle one from `start` to `end`."""
    y = np.subtract(end, start) / math.dist(start, end)
    x = np.cross(y, (0.0, 0.0, 1.0) if abs(y[2]) < 0.9 else (1.0, 0.0, 0.0))
    x = x / np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)])


def limb(start: Vector, end: Vector, radius: float, end_radius: float | None = None, *, blend_m: float = 0.0, cut: bool = False) -> Primitive:
    """Two balls and the cone that touches both."""
    last = radius if end_radius is None else end_radius
    length = math.dist(start, end)
    return _primitive(1, start, _frame_along(start, end), (radius, last, length), max(radius, length + last), 1.0, blend_m, cut)


def ring(centre: Vector, radius: float, thickness: float, *, blend_m: float = 0.0, x_deg: float = 0.0, z_deg: float = 0.0) -> Primitive:
    """A torus about its y axis."""
    return _primitive(2, centre, rotation(x_deg=x_deg, z_deg=z_deg).T, (radius, thickness), radius + thickness, 1.0, blend_m, False)


@dataclass(frozen=True, kw_only=True, eq=False)
class Object:
    """One thing with one material.

    size : plane: half width and half height in its own x, y (it faces its +z and is seen from there only);
           sphere: radius; box: three half sizes; rod: radius and half length along its own y, round ends beyond it;
           solid: radius of a ball about `bound_m` that holds it all.
    wrinkles_m, wrinkles_per_m : amplitude and frequencies (x, y, z) of folds pressed into a solid.
    """

    name: str
    kind: Literal["plane", "sphere", "box", "solid", "rod"]
    material: Material
    origin_m: Vector = (0.0, 0.0, 0.0)
    R_world_object: Float64 = field(default_factory=lambda: np.eye(3))
    size: tuple[float, ...] = ()
    bound_m: Vector = (0.0, 0.0, 0.0)
    primitives: tuple[Primitive, ...] = ()
    wrinkles_m: float = 0.0
    wrinkles_per_m: Vector = (0.0, 0.0, 0.0)

    def row(self, material: int, first: int) -> list[float]:
        kind = KINDS.index(self.kind)
        if self.kind == "solid":
            size = [self.size[0], *self.bound_m]
        else:
            size = [*self.size, math.inf, math.inf, 0.0, 0.0][:4]
        head = [float(kind), float(material), float(first), float(len(self.primitives))]
        return [*head, *self.R_world_object.T.ravel().tolist(), *self.origin_m, *size, self.wrinkles_m, *self.wrinkles_per_m]


def rod(name: str, material: Material, start: Vector, end: Vector, radius_m: float) -> Object:
    """A straight wire with round ends, from `start` to `end`."""
    middle = np.add(start, end) / 2
    return Object(
        name=name,
        kind="rod",
        material=material,
        origin_m=(float(middle[0]), float(middle[1]), float(middle[2])),
        R_world_object=_frame_along(start, end).T,
        size=(radius_m, math.dist(start, end) / 2),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Tables:
    """The scene as the ray caster reads it; rows are float64."""

    objects: Float64
    primitives: Float64
    materials: Float64

    @functools.cached_property
    def empty(self) -> Emptiness:
        """Where a ray may step without asking."""
        return emptiness(self.objects, self.primitives)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Objects, the lights that belong to them, and the light that comes from everywhere (RGB: what a white card reads)."""

    name: str
    objects: tuple[Object, ...]
    lights: tuple[Light, ...] = ()
    ambient: Vector = (0.0, 0.0, 0.0)

    def tables(self) -> Tables:
        rows: list[list[float]] = []
        primitives: list[tuple[float, ...]] = []
        materials: list[list[float]] = []
        for n, thing in enumerate(self.objects):
            rows.append(thing.row(n, len(primitives)))
            materials.append(thing.material.row())
            primitives += [p.row for p in thing.primitives]
        return Tables(
            objects=np.array(rows, dtype=np.float64),
            primitives=np.array(primitives, dtype=np.float64).reshape(len(primitives), 21),
            materials=np.array(materials, dtype=np.float64),
        )
