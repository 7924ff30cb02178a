"""`bust`: a head and shoulders, life size, 1.5 m from the camera, in a furnished room.

World: x right, y up, the camera at the origin looks down -z; metres.  The head's own frame: origin midway between the
eyes' height and the axis of the head, +z out of the face, +x to the viewer's right.  The head is about 0.23 m tall and
0.155 m wide; the proportions follow a drawing manual's (eyes at half height, nose base halfway from eyes to chin)."""

from __future__ import annotations

import math
from dataclasses import replace

from stereorelight.synth.lights import Light
from stereorelight.synth.scene import Material, Object, Primitive, Scene, Vector, ball, ellipsoid, limb, ring, rotation

HEAD_M: Vector = (0.0, 0.075, -1.5)
TURN_DEG = 14.0  # three quarters of a full face says more about a relit nose than a passport picture
SWING_DEG = 22.0  # how far the head turns to each side in motion
SWING_FRAMES = 48
EYE_X, EYE_Y, EYE_Z, EYE_R = 0.0315, 0.0, 0.0590, 0.0122


def _both(*parts: Primitive) -> list[Primitive]:
    """Each part and its mirror image in x = 0, in this order, so that left and right blend alike."""
    out: list[Primitive] = []
    for part in parts:
        r = list(part.row)
        r[3] = -r[3]
        # S R S with S = diag(-1, 1, 1): every shape here is symmetric in its own x.
        for k in (7, 8, 9, 12):
            r[k] = -r[k]
        out += [part, Primitive(tuple(r))]
    return out


def skin_parts(swing_deg: float) -> tuple[Primitive, ...]:
    """Head, neck and chest in the head's frame; the chest stays with the body while the head swings."""
    chest = rotation(y_deg=-swing_deg) @ (0.0, -0.275, -0.035)
    skull = [
        ellipsoid((0, 0.026, -0.020), (0.0745, 0.089, 0.094)),
        ellipsoid((0, -0.030, 0.014), (0.0605, 0.074, 0.066), blend_m=0.03),
        ellipsoid((0, -0.066, 0.018), (0.050, 0.044, 0.056), blend_m=0.025),
        ball((0, -0.0975, 0.0590), 0.0150, blend_m=0.03),
        limb((0, -0.07, -0.030), (0, -0.21, -0.040), 0.050, 0.058, blend_m=0.035),
        *_both(
            ellipsoid((0.040, -0.070, 0.000), (0.015, 0.024, 0.026), blend_m=0.035),  # jaw angle
            ellipsoid((0.044, -0.022, 0.047), (0.021, 0.015, 0.020), blend_m=0.03),  # cheek bone
            limb((0.008, 0.0190, 0.0755), (0.041, 0.0175, 0.0600), 0.0090, 0.0080, blend_m=0.022),  # brow
            limb((0.033, -0.085, -0.020), (0.012, -0.195, 0.018), 0.012, 0.010, blend_m=0.03),  # neck muscle
            limb((0.014, -0.188, 0.022), (0.056, -0.197, 0.000), 0.009, 0.008, blend_m=0.03),  # collar bone
        ),
        ellipsoid(
            (float(chest[0]), float(chest[1]), float(chest[2])), (0.150, 0.085, 0.070), blend_m=0.05, y_deg=-swing_deg
        ),  # chest under the shirt
        limb((0, -0.104, 0.010), (0, -0.125, 0.000), 0.016, 0.014, blend_m=0.03),  # under the chin
        ball((0, -0.140, 0.020), 0.010, blend_m=0.025),  # throat
    ]
    eyes = _both(
        ellipsoid((0.0325, 0.0000, 0.0860), (0.0200, 0.0125, 0.0170), blend_m=0.022, cut=True, y_deg=12),  # socket
        ball((EYE_X, EYE_Y, EYE_Z), EYE_R + 0.0013, blend_m=0.010),  # lids
        ellipsoid((EYE_X, EYE_Y - 0.0006, 0.0725), (0.0130, 0.0046, 0.0100), blend_m=0.0025, cut=True, y_deg=8),  # opening
    )
    nose = [
        limb((0, 0.014, 0.0745), (0, -0.031, 0.0925), 0.0064, 0.0088, blend_m=0.018),
        ball((0, -0.0360, 0.0945), 0.0096, blend_m=0.012),
        *_both(ellipsoid((0.0115, -0.0405, 0.0850), (0.0070, 0.0068, 0.0098), blend_m=0.008)),
        *_both(ellipsoid((0.0060, -0.0485, 0.0910), (0.0034, 0.0040, 0.0060), blend_m=0.003, cut=True, y_deg=18)),
    ]
    mouth = [
        ellipsoid((0, -0.067, 0.060), (0.032, 0.025, 0.0205), blend_m=0.022),
        *_both(ellipsoid((0.0085, -0.0640, 0.0770), (0.0150, 0.0046, 0.0066), blend_m=0.007, y_deg=20, z_deg=-11)),
        ellipsoid((0, -0.0745, 0.0765), (0.0185, 0.0058, 0.0076), blend_m=0.008),
        ellipsoid((0, -0.0690, 0.0900), (0.0260, 0.0009, 0.0110), blend_m=0.0035, cut=True),
        limb((0, -0.0500, 0.0915), (0, -0.0580, 0.0875), 0.0022, 0.0030, blend_m=0.005, cut=True),
    ]
    ears = _both(
        ellipsoid((0.0745, -0.008, -0.012), (0.0075, 0.0300, 0.0180), blend_m=0.008, x_deg=-12, y_deg=25),
        ellipsoid((0.0830, -0.006, -0.008), (0.0060, 0.0190, 0.0100), blend_m=0.006, cut=True, x_deg=-12, y_deg=25),
        ball((0.0715, -0.033, -0.006), 0.0055, blend_m=0.010),
    )
    return (*skull, *eyes, *nose, *mouth, *ears)


def hair_parts() -> tuple[Primitive, ...]:
    return (
        ellipsoid((0, 0.034, -0.026), (0.0800, 0.0885, 0.0965)),
        ellipsoid((0, -0.025, -0.060), (0.068, 0.060, 0.056), blend_m=0.03),
        ellipsoid((0.010, 0.088, 0.012), (0.056, 0.028, 0.046), blend_m=0.04, z_deg=-6),  # swept over the forehead
        ellipsoid((0, -0.036, 0.075), (0.0680, 0.0980, 0.0520), blend_m=0.015, cut=True),
        *_both(ellipsoid((0.082, -0.045, 0.014), (0.030, 0.058, 0.036), blend_m=0.012, cut=True)),
    )


def _shirt() -> tuple[Primitive, ...]:
    return (
        ellipsoid((0, -0.390, -0.035), (0.172, 0.200, 0.105)),
        ellipsoid((0, -0.240, -0.010), (0.115, 0.072, 0.078), blend_m=0.05),
        *_both(
            limb((0.040, -0.175, -0.045), (0.160, -0.218, -0.040), 0.036, 0.044, blend_m=0.06),
            limb((0.168, -0.236, -0.040), (0.222, -0.510, -0.030), 0.058, 0.050, blend_m=0.05),
            ellipsoid((0.075, -0.325, 0.030), (0.085, 0.070, 0.045), blend_m=0.06),
        ),
        limb((0, -0.060, -0.022), (0, -0.215, -0.022), 0.062, 0.064, blend_m=0.008, cut=True),
        ring((0, -0.172, -0.021), 0.0655, 0.0070, blend_m=0.006, x_deg=16),
    )


def _room(texture: float) -> tuple[Object, ...]:
    paper = Material(
        color=(0.42, 0.45, 0.43), color2=(0.34, 0.38, 0.39), pattern="paper", contrast=0.22 * texture, frequency=9.0, octaves=7, gain=0.72
    )
    side = Material(color=(0.50, 0.46, 0.40), contrast=0.25 * texture, frequency=10.0, octaves=7, gain=0.72)
    wood = Material(color=(0.34, 0.20, 0.11), color2=(0.22, 0.12, 0.06), pattern="wood", contrast=0.25 * texture, frequency=20.0, octaves=6, gain=0.7)
    oak = Material(color=(0.45, 0.33, 0.20), color2=(0.33, 0.23, 0.13), pattern="wood", contrast=0.25 * texture, frequency=15.0, octaves=6, gain=0.7)
    clay = Material(color=(0.50, 0.22, 0.13), contrast=0.25 * texture, frequency=40.0, octaves=5, gain=0.7, specular=0.08, exponent=30.0)
    spines = [(0.42, 0.10, 0.08), (0.10, 0.20, 0.33), (0.48, 0.42, 0.28), (0.12, 0.26, 0.15)]
    things = [
        Object(name="back_wall", kind="plane", material=paper, origin_m=(0, 0, -3.0)),
        Object(name="side_wall", kind="plane", material=side, origin_m=(-0.85, 0, 0), R_world_object=rotation(y_deg=90)),
        Object(name="floor", kind="plane", material=oak, origin_m=(0, -1.25, 0), R_world_object=rotation(x_deg=-90)),
        Object(name="sideboard", kind="box", material=wood, origin_m=(0.45, -0.77, -2.75), size=(0.75, 0.45, 0.24)),
        Object(name="vase", kind="sphere", material=clay, origin_m=(-0.12, -0.205, -2.70), size=(0.115,)),
    ]
    x = 0.40
    for n, colour in enumerate(spines):
        half = (0.022 + 0.006 * (n % 3), 0.115 + 0.012 * ((n * 2) % 3), 0.075)
        x += half[0]
        cover = Material(color=colour, contrast=0.3 * texture, frequency=40.0, octaves=5, gain=0.7)
        things.append(Object(name=f"book_{n}", kind="box", material=cover, origin_m=(x, -0.32 + half[1], -2.72), size=half))
        x += half[0] + 0.002
    return tuple(things)


def _lights(frame: float, motion: bool) -> tuple[Light, ...]:
    sweep = 0.35 * math.sin(2 * math.pi * frame / SWING_FRAMES) if motion else 0.0
    return (
        Light(name="key", type="point", position_m=(-0.75 + sweep, 0.75, -0.55), color=(1.0, 0.93, 0.84), intensity=1.5),
        Light(name="fill", type="directional", direction=(-0.6, -0.25, -1.0), color=(0.75, 0.87, 1.0), intensity=0.20),
        Light(
            name="rim",
            type="spot",
            position_m=(0.75, 0.80, -2.35),
            direction=(-0.75, -0.80, 0.85),
            cone_deg=50,
            penumbra_deg=12,
            color=(1.0, 0.97, 0.9),
            intensity=1.3,
        ),
    )


def bust(*, texture: float = 1.0, face_texture: float | None = None, frame: float = 0, motion: bool = False) -> Scene:
    """The figure in its room.

    texture      : scales the grain of every surface; 1 is well textured, 0 flat colour.
    face_texture : the same for the skin alone, where a weakly textured face is wanted (0.3 leaves 2.4 % rms).
    motion       : the head turns about its vertical axis and the key light moves, one cycle in `SWING_FRAMES` frames.
    """
    face = texture if face_texture is None else face_texture
    swing = SWING_DEG * math.sin(2 * math.pi * frame / SWING_FRAMES) if motion else 0.0
    turned = rotation(y_deg=TURN_DEG + swing)
    body = rotation(y_deg=6.0)
    skin = Material(
        color=(0.60, 0.40, 0.31),
        color2=(0.50, 0.20, 0.17),
        pattern="skin",
        contrast=0.20 * face,
        frequency=70,
        octaves=5,
        gain=0.75,
        specular=0.06,
        exponent=14,
    )
    hair = Material(
        color=(0.085, 0.052, 0.033),
        pattern="hair",
        contrast=0.6 * texture,
        frequency=180,
        octaves=4,
        gain=0.75,
        specular=0.03,
        exponent=12,
        stretch=(1.0, 0.25, 0.6),
    )
    shirt = Material(
        color=(0.13, 0.21, 0.30), color2=(0.24, 0.31, 0.37), pattern="cloth", contrast=0.36 * texture, frequency=45, octaves=5, gain=0.75
    )
    eye = Material(
        color=(0.72, 0.70, 0.67),
        color2=(0.16, 0.20, 0.16),
        pattern="eye",
        contrast=0.1 * texture,
        frequency=200,
        octaves=3,
        specular=0.5,
        exponent=150,
    )

    def placed(x: float, y: float, z: float) -> Vector:
        offset = turned @ (x, y, z)
        return (HEAD_M[0] + float(offset[0]), HEAD_M[1] + float(offset[1]), HEAD_M[2] + float(offset[2]))

    figure = (
        Object(
            name="skin",
            kind="solid",
            material=skin,
            origin_m=HEAD_M,
            R_world_object=turned,
            size=(0.27,),
            bound_m=(0, -0.12, 0),
            primitives=skin_parts(swing),
        ),
        Object(
            name="hair",
            kind="solid",
            material=hair,
            origin_m=HEAD_M,
            R_world_object=turned,
            size=(0.165,),
            bound_m=(0, 0.02, -0.02),
            primitives=hair_parts(),
            wrinkles_m=0.0016,
            wrinkles_per_m=(110, 35, 60),
        ),
        Object(
            name="shirt",
            kind="solid",
            material=shirt,
            origin_m=HEAD_M,
            R_world_object=body,
            size=(0.42,),
            bound_m=(0, -0.42, 0),
            primitives=_shirt(),
            wrinkles_m=0.0045,
            wrinkles_per_m=(16, 9, 14),
        ),
        *(
            Object(name=f"eye_{side}", kind="sphere", material=eye, origin_m=placed(x, EYE_Y, EYE_Z), R_world_object=turned, size=(EYE_R,))
            for side, x in (("left", -EYE_X), ("right", EYE_X))
        ),
    )
    return Scene(name="bust", objects=(*_room(texture), *figure), lights=_lights(frame, motion), ambient=(0.10, 0.105, 0.12))


def weak(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """The same figure as skin and cloth really are: pores of 2.4 % rms and lips little redder than the cheeks, a plain shirt of 2 %."""
    scene = bust(texture=texture, frame=frame, motion=motion)

    def worn(thing: Object) -> Object:
        made = thing.material
        if thing.name == "skin":
            paler = [0.8 * a + 0.2 * b for a, b in zip(made.color, made.color2, strict=True)]
            return replace(thing, material=replace(made, color2=(paler[0], paler[1], paler[2]), contrast=0.06 * texture))
        if thing.name == "shirt":
            return replace(thing, material=replace(made, color2=made.color, contrast=0.05 * texture))
        return thing

    return replace(scene, name="weak", objects=tuple(worn(thing) for thing in scene.objects))
