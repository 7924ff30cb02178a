"""`statue`: a marble bust on a fluted column, 1.7 m from the camera, before a wall with pilasters.

World: x right, y up, the camera at the origin looks down -z; metres.  The head is that of `bust`, in its own frame; the torso, cloth
and socle stand in the same frame, so that one block's veins run through all of them."""

from __future__ import annotations

import math
from dataclasses import replace

from stereorelight.synth.bust import EYE_R, EYE_X, EYE_Y, EYE_Z, hair_parts, skin_parts
from stereorelight.synth.lights import Light
from stereorelight.synth.scene import Material, Object, Primitive, Scene, Vector, ball, ellipsoid, limb, ring, rotation

HEAD_M: Vector = (0.02, 0.155, -1.70)
TURN_DEG = -26.0  # of the head: it looks to the picture's left
SWEEP_M = 0.35  # how far the key light moves to each side in motion
SWEEP_FRAMES = 48
COLUMN_TOP_M = -0.300  # below the eyes' height


def _torso() -> tuple[Primitive, ...]:
    """Chest and shoulders, cut off below as busts are; turned less than the head."""
    return (
        ellipsoid((0, -0.285, -0.035), (0.128, 0.130, 0.080)),
        limb((-0.040, -0.170, -0.045), (-0.145, -0.212, -0.040), 0.040, 0.052, blend_m=0.06),
        limb((0.040, -0.170, -0.045), (0.145, -0.212, -0.040), 0.040, 0.052, blend_m=0.06),
        ellipsoid((-0.062, -0.255, 0.025), (0.062, 0.052, 0.034), blend_m=0.05),
        ellipsoid((0.062, -0.255, 0.025), (0.062, 0.052, 0.034), blend_m=0.05),
        limb((0, -0.170, -0.035), (0, -0.080, -0.028), 0.060, 0.050, blend_m=0.05),
        limb((-0.30, -0.330, -0.03), (-0.17, -0.420, -0.03), 0.075, 0.100, blend_m=0.012, cut=True),
        limb((0.30, -0.330, -0.03), (0.17, -0.420, -0.03), 0.075, 0.100, blend_m=0.012, cut=True),
    )


def _cloth() -> tuple[Primitive, ...]:
    """A cloak over one shoulder: folds from there across the chest, each a bent rope that melts into the next."""
    parts: list[Primitive] = [
        ellipsoid((0.125, -0.205, -0.035), (0.075, 0.050, 0.076), z_deg=-24),
        ellipsoid((0.040, -0.330, 0.000), (0.115, 0.078, 0.070), blend_m=0.03, z_deg=38),
    ]
    for n in range(9):
        s = n / 8
        shoulder = (0.060 + 0.105 * s, -0.152 - 0.030 * s, 0.004 - 0.050 * s)
        chest = (0.000 + 0.130 * s, -0.232 - 0.062 * s, 0.074 - 0.045 * s)
        waist = (-0.078 + 0.125 * s, -0.285 - 0.110 * s, 0.030 - 0.002 * s)
        radius = 0.0085 if n % 2 else 0.0130
        parts += [limb(shoulder, chest, radius, radius, blend_m=0.007), limb(chest, waist, radius, radius * 0.7, blend_m=0.007)]
    for n in range(4):
        s = n / 3
        parts.append(
            limb((0.120 + 0.050 * s, -0.165 - 0.010 * s, -0.02 - 0.05 * s), (0.140 + 0.045 * s, -0.335, 0.0 - 0.06 * s), 0.018, 0.014, blend_m=0.008)
        )
    parts += [ring((0.092, -0.176, 0.030), 0.019, 0.0055, blend_m=0.003, x_deg=70), ball((0.092, -0.176, 0.030), 0.012, blend_m=0.003)]  # the clasp
    return tuple(parts)


def _socle() -> tuple[Primitive, ...]:
    y = COLUMN_TOP_M - 0.155
    return (
        ellipsoid((0, -0.375, -0.030), (0.075, 0.050, 0.062)),
        limb((0, -0.380, -0.030), (0, y + 0.055, -0.030), 0.046, 0.034, blend_m=0.03),
        ring((0, y + 0.042, -0.030), 0.040, 0.010, blend_m=0.006),
        ring((0, y + 0.018, -0.030), 0.058, 0.014, blend_m=0.008),
        ellipsoid((0, y + 0.012, -0.030), (0.072, 0.012, 0.072), blend_m=0.006),
    )


def _column(flutes: int = 18) -> tuple[Primitive, ...]:
    """A shaft with flutes, in a frame whose origin is the middle of its top."""
    parts = [limb((0, -0.14, 0), (0, -0.9, 0), 0.120, 0.130)]
    for n in range(flutes):
        a = 2 * math.pi * n / flutes
        x, z = math.cos(a), math.sin(a)
        parts.append(limb((0.127 * x, -0.118, 0.127 * z), (0.138 * x, -0.9, 0.138 * z), 0.0155, 0.0168, blend_m=0.002, cut=True))
    return (*parts, ring((0, -0.075, 0), 0.112, 0.018, blend_m=0.006), ellipsoid((0, -0.052, 0), (0.150, 0.032, 0.150), blend_m=0.01))


def statue(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """The statue in its room, under a key and a rim.  In motion the key light moves, one cycle in `SWEEP_FRAMES` frames."""
    sweep = SWEEP_M * math.sin(2 * math.pi * frame / SWEEP_FRAMES) if motion else 0.0
    head, body = rotation(y_deg=TURN_DEG), rotation(y_deg=TURN_DEG / 2)
    marble = Material(
        color=(0.70, 0.68, 0.63),
        color2=(0.44, 0.42, 0.40),
        pattern="marble",
        contrast=0.14 * texture,
        frequency=42.0,
        octaves=6,
        gain=0.74,
        specular=0.08,
        exponent=24.0,
    )
    stone = Material(
        color=(0.34, 0.38, 0.36),
        color2=(0.20, 0.24, 0.23),
        pattern="marble",
        contrast=0.25 * texture,
        frequency=25.0,
        octaves=6,
        gain=0.74,
        specular=0.05,
        exponent=24.0,
    )
    plaster = Material(color=(0.40, 0.17, 0.12), contrast=0.25 * texture, frequency=9.0, octaves=7, gain=0.74)
    lime = Material(color=(0.50, 0.45, 0.36), contrast=0.22 * texture, frequency=14.0, octaves=7, gain=0.74)
    x, y, z = HEAD_M
    foot_z = z - 0.030

    def in_head(ex: float, ey: float, ez: float) -> Vector:
        offset = head @ (ex, ey, ez)
        return (x + float(offset[0]), y + float(offset[1]), z + float(offset[2]))

    def solid(name: str, material: Material, R: object, parts: tuple[Primitive, ...], radius: float, bound: Vector, at: Vector = HEAD_M) -> Object:
        return Object(name=name, kind="solid", material=material, origin_m=at, R_world_object=R, size=(radius,), bound_m=bound, primitives=parts)  # type: ignore[arg-type]

    wall_z = -2.75
    things = [
        Object(name="wall", kind="plane", material=plaster, origin_m=(0, 0, wall_z)),
        Object(name="floor", kind="plane", material=lime, origin_m=(0, -1.3, 0), R_world_object=rotation(x_deg=-90)),
        Object(name="dado", kind="box", material=lime, origin_m=(0, -0.43, wall_z + 0.03), size=(3.0, 0.035, 0.03)),
        Object(name="dado_low", kind="box", material=lime, origin_m=(0, -0.485, wall_z + 0.018), size=(3.0, 0.02, 0.018)),
        solid("head", marble, head, skin_parts(0.0), 0.27, (0, -0.12, 0)),
        replace(solid("hair", marble, head, hair_parts(), 0.165, (0, 0.02, -0.02)), wrinkles_m=0.0034, wrinkles_per_m=(62.0, 38.0, 62.0)),
        *(
            Object(name=f"eye_{side}", kind="sphere", material=marble, origin_m=eye, size=(EYE_R,))
            for side, eye in (("left", in_head(-EYE_X, EYE_Y, EYE_Z)), ("right", in_head(EYE_X, EYE_Y, EYE_Z)))
        ),
        solid("torso", marble, body, _torso(), 0.30, (0, -0.26, -0.03)),
        solid("cloth", marble, body, _cloth(), 0.30, (0.05, -0.26, 0)),
        solid("socle", marble, body, _socle(), 0.20, (0, -0.40, -0.03)),
        Object(
            name="abacus",
            kind="box",
            material=stone,
            origin_m=(x, y + COLUMN_TOP_M - 0.155 - 0.018, foot_z),
            R_world_object=rotation(y_deg=18),
            size=(0.145, 0.018, 0.145),
        ),
        solid("column", stone, rotation(y_deg=5), _column(), 1.1, (0, -0.5, 0), (x, y + COLUMN_TOP_M - 0.155 - 0.036 + 0.02, foot_z)),
    ]
    for n, px in enumerate((-0.78, 0.66)):
        things.append(Object(name=f"pilaster_{n}", kind="box", material=lime, origin_m=(px, 0.3, wall_z + 0.05), size=(0.13, 1.6, 0.05)))
        things.append(Object(name=f"panel_{n}", kind="box", material=stone, origin_m=(px, 0.3, wall_z + 0.054), size=(0.085, 0.66, 0.05)))
    lights = (
        Light(name="key", type="point", position_m=(-0.85 + sweep, 0.85, -0.75), color=(1.0, 0.93, 0.82), intensity=1.6),
        Light(
            name="rim",
            type="spot",
            position_m=(0.85, 0.75, -2.35),
            direction=(-0.80, -0.60, 0.62),
            cone_deg=45,
            penumbra_deg=14,
            color=(0.75, 0.86, 1.0),
            intensity=1.2,
        ),
    )
    return Scene(name="statue", objects=tuple(things), lights=lights, ambient=(0.07, 0.07, 0.08))
