"""A frame under its lights as a value, and two of them, of a subject and of what is behind it, as one.

In: layers by name.  Out: a `Lit`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.comp import relight
from stereorelight.light.edges import Side, mixed
from stereorelight.shot.plate_light import Colour


@dataclass(frozen=True, kw_only=True, eq=False)
class Lit:
    """A frame under its lights.

    layers : every light's own, the same names on every frame.     beauty : the relit plate, or light alone.
    alpha  : of light alone, else None.                            trust  : what light was faded by, else None.
    groups : sums of layers by the lights' `group`; part of no beauty.
    colour : what the lights fell on, where that is not the plate.
    shadows : of every light that casts one, apart: `shadow_<name>`, and `shadow_<name>_unknown`, (H, W); part of no beauty.
    surface : ao and bent, where they are asked for.
    """

    layers: dict[str, Float32]
    beauty: Float32
    alpha: Float32 | None = None
    trust: Float32 | None = None
    groups: dict[str, Float32] = field(default_factory=dict)
    colour: Colour | None = None
    shadows: dict[str, Float32] = field(default_factory=dict)
    surface: dict[str, Float32] = field(default_factory=dict)

    def passes(self) -> dict[str, Float32]:
        """All of it as passes of a file."""
        more = {"alpha": self.alpha, "matte_trust": self.trust, "albedo": None if self.colour is None else self.colour.albedo}
        told = {name: array for name, array in more.items() if array is not None}
        return {"beauty": self.beauty, **told, **self.layers, **self.groups, **self.shadows, **self.surface}


def both_sides(fore: Lit, back: Lit, sides: tuple[Side, Side], cover: Float32, plate: Float32, knobs: Any) -> Lit:
    """Subject and background, each lit by itself, as one frame: every layer mixed by `cover` (H, W), and the beauty made of them.

    plate : (H, W, 3), whole.     knobs : the [relight] table.
    """
    of_colour = knobs.mode == "multiply"  # layers are gains there, and each side's has its own colours to gain

    def layers(a: Mapping[str, Float32], b: Mapping[str, Float32], *, gains: bool) -> dict[str, Float32]:
        made = {}
        for name in a:
            made[name] = mixed(a[name], b[name], cover)
            if gains:
                whole = mixed(a[name] * sides[0].plate, b[name] * sides[1].plate, cover)
                with np.errstate(invalid="ignore", divide="ignore"):
                    made[name] = np.where(np.abs(plate) > 1e-6, whole / plate, made[name]).astype(np.float32)
        return made

    own = layers(fore.layers, back.layers, gains=of_colour)
    colour = fore.colour
    if fore.colour is not None and back.colour is not None:
        colour = replace(fore.colour, albedo=mixed(fore.colour.albedo, back.colour.albedo, cover))
    return Lit(
        layers=own,
        beauty=relight(plate, own, plate_gain=knobs.plate_gain, mode=knobs.mode),
        alpha=None if fore.alpha is None or back.alpha is None else mixed(fore.alpha, back.alpha, cover),
        trust=None if fore.trust is None or back.trust is None else mixed(fore.trust, back.trust, cover),
        groups=layers(fore.groups, back.groups, gains=of_colour),
        colour=colour,
        shadows=layers(fore.shadows, back.shadows, gains=False),
        surface=layers(fore.surface, back.surface, gains=False),
    )
