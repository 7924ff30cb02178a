"""The scenes by name: the bust, hard cases, and small ones whose answers can be worked out by hand.

World: x right, y up, the camera at the origin looks down -z; metres.  `texture` scales the grain of every surface."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from stereorelight.errors import ShotError, nearest_hint
from stereorelight.synth.bust import bust, weak
from stereorelight.synth.hard_cases import repeat, table, thin
from stereorelight.synth.interior import interior
from stereorelight.synth.lights import Light
from stereorelight.synth.scene import Material, Object, Scene, rotation
from stereorelight.synth.statue import statue

KEY = Light(name="key", type="point", position_m=(-0.8, 0.9, 0.2), intensity=1.6)
AMBIENT = (0.15, 0.15, 0.15)


class Builder(Protocol):
    """Makes a scene; `frame` counts from 0, may lie between frames, and moves things only where `motion` is on."""

    def __call__(self, *, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene: ...


def _card(red: float, green: float, blue: float, texture: float, *, frequency: float = 12.0) -> Material:
    return Material(color=(red, green, blue), contrast=0.5 * texture, frequency=frequency, octaves=6, gain=0.7)


def plane(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A wall 2 m away, square to the left camera."""
    wall = Object(name="wall", kind="plane", material=_card(0.5, 0.45, 0.4, texture), origin_m=(0.0, 0.0, -2.0))
    return Scene(name="plane", objects=(wall,), lights=(KEY,), ambient=AMBIENT)


def slanted(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A wall through (0, 0, -1.5), turned by 35 degrees and leaning back by 15."""
    turned = rotation(x_deg=-15.0, y_deg=35.0)
    wall = Object(name="wall", kind="plane", material=_card(0.5, 0.5, 0.45, texture), origin_m=(0.0, 0.0, -1.5), R_world_object=turned)
    return Scene(name="slanted", objects=(wall,), lights=(KEY,), ambient=AMBIENT)


def sphere(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A ball of radius 0.25 m at 1.5 m, before a wall at 2.5 m.  In motion it moves right by 5 mm a frame."""
    x = 0.005 * frame if motion else 0.0
    things = (
        Object(name="wall", kind="plane", material=_card(0.4, 0.42, 0.45, texture), origin_m=(0.0, 0.0, -2.5)),
        Object(name="ball", kind="sphere", material=_card(0.55, 0.4, 0.3, texture, frequency=20.0), origin_m=(x, 0.0, -1.5), size=(0.25,)),
    )
    return Scene(name="sphere", objects=things, lights=(KEY,), ambient=AMBIENT)


def two_planes(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A card 0.5 m wide and 0.3 m high at 1.2 m, before a wall at 2 m."""
    things = (
        Object(name="wall", kind="plane", material=_card(0.4, 0.42, 0.45, texture), origin_m=(0.0, 0.0, -2.0)),
        Object(name="card", kind="plane", material=_card(0.55, 0.4, 0.3, texture, frequency=20.0), origin_m=(0.0, 0.0, -1.2), size=(0.25, 0.15)),
    )
    return Scene(name="two_planes", objects=things, lights=(KEY,), ambient=AMBIENT)


def box(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A box of 0.4 x 0.3 x 0.3 m at 1.6 m, turned by 30 degrees, before a wall at 2.5 m."""
    things = (
        Object(name="wall", kind="plane", material=_card(0.4, 0.42, 0.45, texture), origin_m=(0.0, 0.0, -2.5)),
        Object(
            name="box",
            kind="box",
            material=_card(0.55, 0.4, 0.3, texture, frequency=20.0),
            origin_m=(0.0, 0.0, -1.6),
            R_world_object=rotation(x_deg=12.0, y_deg=30.0),
            size=(0.2, 0.15, 0.15),
        ),
    )
    return Scene(name="box", objects=things, lights=(KEY,), ambient=AMBIENT)


_SCENES: Mapping[str, Builder] = MappingProxyType(
    {
        "bust": bust,
        "weak": weak,
        "thin": thin,
        "table": table,
        "repeat": repeat,
        "interior": interior,
        "statue": statue,
        "plane": plane,
        "slanted": slanted,
        "sphere": sphere,
        "two_planes": two_planes,
        "box": box,
    }
)


def scenes() -> Mapping[str, Builder]:
    """Every scene by name."""
    return _SCENES


def scene_named(name: str, *, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """The scene `name` at `frame`, which may lie between whole frames.  Raises ShotError with the nearest known name."""
    if name not in _SCENES:
        raise ShotError(f"scene {name!r} is unknown{nearest_hint(name, _SCENES)}")
    if not 0 <= texture <= 2:
        raise ShotError(f"texture must lie in 0..2, got {texture:g}")
    return _SCENES[name](texture=texture, frame=frame, motion=motion)
