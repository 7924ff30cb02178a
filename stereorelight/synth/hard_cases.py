"""Scenes that are hard to match: thin things, a table seen along its top, a wall that repeats.

World: x right, y up, the camera at the origin looks down -z; metres.  At 960x540 and 40 degrees, 1 mm is 0.88 px at 1.5 m."""

from __future__ import annotations

import math

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.synth.lights import Light
from stereorelight.synth.scene import Material, Object, Scene, Vector, limb, ring, rod, rotation

AMBIENT = (0.16, 0.16, 0.17)
KEY = Light(name="key", type="point", position_m=(-0.9, 1.0, 0.1), color=(1.0, 0.95, 0.88), intensity=2.4)
FILL = Light(name="fill", type="directional", direction=(-0.6, -0.4, -1.0), color=(0.8, 0.9, 1.0), intensity=0.15)

WHEEL_M: Vector = (-0.26, 0.03, -1.45)
WHEEL_R, SPOKES = 0.20, 12
SPIN_DEG = 1.5  # a frame, in motion
SLIDE_M = 0.004  # a frame, in motion
TABLE_M: Vector = (0.0, -0.20, -1.55)
TILT = rotation(x_deg=2.0, y_deg=24.0, z_deg=4.0)  # of the table: no edge runs along a row


def _card(red: float, green: float, blue: float, contrast: float, *, frequency: float = 12.0, specular: float = 0.0) -> Material:
    return Material(color=(red, green, blue), contrast=contrast, frequency=frequency, octaves=6, gain=0.72, specular=specular, exponent=30.0)


def _at(origin: Vector, R: Float64, x: float, y: float, z: float) -> Vector:
    """A point of a turned frame, in world."""
    p = R @ (x, y, z)
    return (origin[0] + float(p[0]), origin[1] + float(p[1]), origin[2] + float(p[2]))


def _wheel(spin_deg: float, texture: float) -> list[Object]:
    """A bicycle's wheel, turned by 25 degrees: a tyre of 14 mm, spokes of 2.4 mm that cross to both sides of a hub."""
    R = rotation(y_deg=25.0) @ rotation(z_deg=spin_deg)
    rubber, steel = _card(0.05, 0.05, 0.055, 0.4 * texture, frequency=60.0), _card(0.55, 0.56, 0.58, 0.15 * texture, frequency=90.0, specular=0.2)
    made = [
        Object(
            name="tyre",
            kind="solid",
            material=rubber,
            origin_m=WHEEL_M,
            R_world_object=R,
            size=(WHEEL_R + 0.01,),
            primitives=(ring((0, 0, 0), WHEEL_R, 0.007, x_deg=90),),
        ),
        rod("hub", steel, _at(WHEEL_M, R, 0, 0, -0.03), _at(WHEEL_M, R, 0, 0, 0.03), 0.012),
    ]
    for n in range(SPOKES):
        rim, side = 2 * math.pi * n / SPOKES, 0.02 if n % 2 else -0.02
        hub = rim + (0.9 if n % 4 < 2 else -0.9)
        inner = _at(WHEEL_M, R, 0.011 * math.cos(hub), 0.011 * math.sin(hub), side)
        outer = _at(WHEEL_M, R, 0.195 * math.cos(rim), 0.195 * math.sin(rim), 0.0)
        made.append(rod(f"spoke_{n}", steel, inner, outer, 0.0012))
    return made


def _net(texture: float) -> list[Object]:
    """Twine of 3.4 mm in squares of 60 mm, 1.7 m away, hung askew."""
    twine = _card(0.50, 0.40, 0.22, 0.3 * texture, frequency=80.0)
    origin, R = (0.34, 0.06, -1.7), rotation(x_deg=-8.0, y_deg=-20.0, z_deg=38.0)
    lines = [0.06 * (n - 2) for n in range(5)]
    made = [rod(f"net_{n}", twine, _at(origin, R, x, -0.15, 0.0), _at(origin, R, x, 0.15, 0.0), 0.0017) for n, x in enumerate(lines)]
    return made + [rod(f"net_{n + 5}", twine, _at(origin, R, -0.15, y, 0.002), _at(origin, R, 0.15, y, 0.002), 0.0017) for n, y in enumerate(lines)]


def _cable(name: str, material: Material, start: Vector, end: Vector, sag_m: float, radius_m: float) -> list[Object]:
    """A hanging cable: a parabola in twelve straight pieces with round joints."""
    share = np.linspace(0.0, 1.0, 13)
    points = np.array(start) + share[:, None] * np.subtract(end, start) - (4 * sag_m * share * (1 - share))[:, None] * (0.0, 1.0, 0.0)
    places: list[Vector] = [(float(x), float(y), float(z)) for x, y, z in points]
    return [rod(f"{name}_{n}", material, places[n], places[n + 1], radius_m) for n in range(12)]


def thin(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """Wires, rods, spokes, a net and hanging cables, 2 to 8 px wide at 960x540, 1.2 to 1.8 m away, before a wall at 2.6 m.

    In motion the wheel turns."""
    paper = Material(
        color=(0.46, 0.44, 0.38), color2=(0.36, 0.38, 0.36), pattern="paper", contrast=0.3 * texture, frequency=9.0, octaves=7, gain=0.74
    )
    black, red, white, brass = (
        _card(0.06, 0.06, 0.07, 0.4 * texture, frequency=70.0),
        _card(0.45, 0.09, 0.07, 0.25 * texture, frequency=70.0),
        _card(0.75, 0.74, 0.70, 0.15 * texture, frequency=70.0),
        _card(0.50, 0.36, 0.14, 0.25 * texture, frequency=70.0, specular=0.15),
    )
    things = [
        Object(name="wall", kind="plane", material=paper, origin_m=(0.0, 0.0, -2.6), R_world_object=rotation(y_deg=6.0)),
        *_wheel(SPIN_DEG * frame if motion else 0.0, texture),
        *_net(texture),
        rod("post", brass, (0.02, -0.6, -1.50), (0.06, 0.6, -1.56), 0.0045),
        rod("rod_0", white, (0.105, -0.6, -1.35), (0.085, 0.6, -1.35), 0.0030),
        rod("rod_1", red, (0.12, -0.40, -1.3), (0.60, 0.10, -1.6), 0.0022),
        rod("rod_2", black, (0.16, -0.6, -1.6), (0.18, 0.6, -1.6), 0.0012),
        rod("level", white, (-0.60, -0.235, -1.45), (0.62, -0.225, -1.45), 0.0018),
        *_cable("cable_0", black, (-0.80, 0.27, -1.5), (0.20, 0.32, -1.8), 0.075, 0.0028),
        *_cable("cable_1", red, (-0.55, -0.10, -1.25), (0.60, -0.17, -1.35), 0.060, 0.0016),
    ]
    return Scene(name="thin", objects=tuple(things), lights=(KEY, FILL), ambient=AMBIENT)


def table(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A table top seen at 5 to 12 degrees, with a ball, a box, a mug, a bottle and pencils on it, before a wall at 3 m.  In motion the ball rolls."""
    oak = Material(color=(0.44, 0.31, 0.18), color2=(0.33, 0.22, 0.12), pattern="wood", contrast=0.3 * texture, frequency=15.0, octaves=7, gain=0.74)
    paper = Material(
        color=(0.40, 0.43, 0.45), color2=(0.33, 0.36, 0.40), pattern="paper", contrast=0.22 * texture, frequency=9.0, octaves=7, gain=0.72
    )
    glazed, card = _card(0.62, 0.60, 0.55, 0.12 * texture, frequency=40.0, specular=0.15), _card(0.30, 0.16, 0.12, 0.35 * texture, frequency=30.0)
    green, yellow = _card(0.08, 0.17, 0.10, 0.3 * texture, frequency=40.0, specular=0.2), _card(0.60, 0.42, 0.07, 0.2 * texture, frequency=80.0)
    cloth = Material(color=(0.34, 0.10, 0.09), color2=(0.42, 0.20, 0.16), pattern="cloth", contrast=0.3 * texture, frequency=45.0, gain=0.75)
    rolled = SLIDE_M * frame if motion else 0.0
    upright = TILT

    def on(x: float, y: float, z: float) -> Vector:
        """A point `y` above the top, in the table's own frame."""
        return _at(TABLE_M, upright, x, y, z)

    mug = (limb((0, 0.045, 0), (0, 0.075, 0), 0.043, 0.045, blend_m=0.004), limb((0, 0.075, 0), (0, 0.150, 0), 0.039, blend_m=0.004, cut=True))
    handle = (ring((0.052, 0.062, 0), 0.024, 0.0055, blend_m=0.006, x_deg=90),)
    bottle = (limb((0, 0.037, 0), (0, 0.150, 0), 0.037), limb((0, 0.150, 0), (0, 0.250, 0), 0.020, 0.013, blend_m=0.03))
    things = (
        Object(name="wall", kind="plane", material=paper, origin_m=(0.0, 0.0, -3.0)),
        Object(name="top", kind="box", material=oak, origin_m=on(0.0, -0.015, 0.0), R_world_object=upright, size=(0.72, 0.015, 0.66)),
        Object(
            name="ball",
            kind="sphere",
            material=cloth,
            origin_m=on(0.10 + rolled, 0.055, 0.22),
            R_world_object=upright @ rotation(z_deg=-math.degrees(rolled / 0.055)),
            size=(0.055,),
        ),
        Object(
            name="box",
            kind="box",
            material=card,
            origin_m=on(-0.24, 0.06, 0.10),
            R_world_object=upright @ rotation(y_deg=20.0),
            size=(0.09, 0.06, 0.06),
        ),
        Object(
            name="mug",
            kind="solid",
            material=glazed,
            origin_m=on(0.02, 0.0, -0.14),
            R_world_object=upright,
            size=(0.12,),
            bound_m=(0.02, 0.07, 0.0),
            primitives=mug + handle,
        ),
        Object(
            name="bottle",
            kind="solid",
            material=green,
            origin_m=on(0.32, 0.0, -0.12),
            R_world_object=upright,
            size=(0.15,),
            bound_m=(0.0, 0.13, 0.0),
            primitives=bottle,
        ),
        rod("pencil_0", yellow, on(-0.16, 0.0038, 0.40), on(0.01, 0.0038, 0.43), 0.0038),
        rod("pencil_1", yellow, on(0.14, 0.0038, 0.10), on(0.30, 0.0038, 0.16), 0.0038),
    )
    return Scene(name="table", objects=things, lights=(KEY, FILL), ambient=AMBIENT)


def repeat(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A tiled wall at about 2.2 m, turned by 8 degrees: tiles of 25 mm, all alike but for 2 % of grain; a ball and a box before it.

    At 960x540 a tile is 15 px wide and its disparity 39 px, so the wall matches as well one or two tiles off.  In motion the ball moves."""
    tiles = Material(
        color=(0.56, 0.55, 0.52),
        color2=(0.16, 0.24, 0.36),
        pattern="tiles",
        contrast=0.05 * texture,
        frequency=40.0,
        octaves=4,
        gain=0.7,
        specular=0.05,
    )
    x = 0.10 + (SLIDE_M * frame if motion else 0.0)
    things = (
        Object(name="wall", kind="plane", material=tiles, origin_m=(0.0, 0.0, -2.2), R_world_object=rotation(y_deg=8.0)),
        Object(name="ball", kind="sphere", material=_card(0.50, 0.36, 0.27, 0.35 * texture, frequency=30.0), origin_m=(x, 0.02, -1.5), size=(0.13,)),
        Object(
            name="box",
            kind="box",
            material=_card(0.30, 0.33, 0.24, 0.35 * texture, frequency=25.0),
            origin_m=(-0.33, -0.22, -1.75),
            R_world_object=rotation(x_deg=4.0, y_deg=28.0),
            size=(0.12, 0.20, 0.10),
        ),
    )
    return Scene(name="repeat", objects=things, lights=(KEY, FILL), ambient=AMBIENT)
