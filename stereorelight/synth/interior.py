"""`interior`: a furnished room with two lamps, 2 to 5 m from the camera.

World: x right, y up, the camera at the origin looks down -z; metres.  The room has its own frame: origin on the floor
at the back wall, x along that wall, y up, z out of it towards the camera, which stands about 1.5 m high."""

from __future__ import annotations

import math

from stereorelight.synth.lights import Light
from stereorelight.synth.scene import Material, Object, Scene, Vector, ball, ellipsoid, limb, ring, rod, rotation

EYE_M: Vector = (0.02, 1.42, 5.45)  # where the camera stands, room frame turned by TURN_DEG
TURN_DEG, TILT_DEG = 17.0, 6.0  # the camera looks to the left corner, and down
SWAY_M = 0.03  # how far the pendant lamp swings to each side in motion
SWAY_FRAMES = 48
TABLE_M: Vector = (-0.10, 0.0, 1.80)  # foot of the round table, room frame
PENDANT_M: Vector = (-0.10, 1.62, 1.75)  # middle of the pendant's rim, room frame
R = rotation(x_deg=TILT_DEG) @ rotation(y_deg=TURN_DEG)


def placed(x: float, y: float, z: float) -> Vector:
    """A point of the room, in world."""
    p = rotation(x_deg=TILT_DEG) @ (rotation(y_deg=TURN_DEG) @ (x, y, z) - EYE_M)
    return (float(p[0]), float(p[1]), float(p[2]))


def _plain(
    red: float, green: float, blue: float, contrast: float, *, frequency: float = 30.0, specular: float = 0.0, exponent: float = 30.0
) -> Material:
    return Material(color=(red, green, blue), contrast=contrast, frequency=frequency, octaves=6, gain=0.72, specular=specular, exponent=exponent)


def _wood(light: Vector, dark: Vector, texture: float, *, specular: float = 0.0) -> Material:
    return Material(
        color=light, color2=dark, pattern="wood", contrast=0.25 * texture, frequency=18.0, octaves=6, gain=0.72, specular=specular, exponent=25.0
    )


def _box(name: str, material: Material, centre: Vector, half: Vector, *, turn_deg: float = 0.0) -> Object:
    return Object(name=name, kind="box", material=material, origin_m=placed(*centre), R_world_object=R @ rotation(y_deg=turn_deg), size=half)


def _walls(texture: float) -> list[Object]:
    paper = Material(
        color=(0.36, 0.44, 0.40), color2=(0.30, 0.38, 0.355), pattern="paper", contrast=0.18 * texture, frequency=9.0, octaves=7, gain=0.74
    )
    plaster = _plain(0.62, 0.58, 0.50, 0.20 * texture, frequency=8.0)
    oak = Material(
        color=(0.42, 0.29, 0.17),
        color2=(0.31, 0.20, 0.11),
        pattern="wood",
        contrast=0.3 * texture,
        frequency=12.0,
        octaves=7,
        gain=0.74,
        specular=0.04,
        exponent=18.0,
    )
    white = _plain(0.70, 0.68, 0.62, 0.10 * texture, frequency=25.0)
    carpet = Material(
        color=(0.33, 0.10, 0.085),
        color2=(0.16, 0.12, 0.17),
        pattern="cloth",
        contrast=0.32 * texture,
        frequency=40.0,
        octaves=5,
        gain=0.76,
        stretch=(1.0, 1.0, 1.0),
    )
    flat = R @ rotation(x_deg=-90)
    return [
        Object(name="back_wall", kind="plane", material=paper, origin_m=placed(0, 0, 0), R_world_object=R),
        Object(name="left_wall", kind="plane", material=plaster, origin_m=placed(-1.75, 0, 0), R_world_object=R @ rotation(y_deg=90)),
        Object(name="right_wall", kind="plane", material=plaster, origin_m=placed(2.6, 0, 0), R_world_object=R @ rotation(y_deg=-90)),
        Object(name="floor", kind="plane", material=oak, origin_m=placed(0, 0, 0), R_world_object=flat),
        Object(name="ceiling", kind="plane", material=white, origin_m=placed(0, 2.75, 0), R_world_object=R @ rotation(x_deg=90)),
        Object(name="rug", kind="plane", material=carpet, origin_m=placed(-0.15, 0.006, 1.75), R_world_object=flat, size=(1.05, 0.80)),
        _box("skirting_back", white, (0.4, 0.06, 0.009), (2.2, 0.06, 0.009)),
        _box("skirting_left", white, (-1.741, 0.06, 2.0), (0.009, 0.06, 2.0)),
    ]


def _pictures(texture: float) -> list[Object]:
    """Two framed pictures on the back wall, a tall mirror's frame on the left one."""
    gilt, black = _plain(0.44, 0.32, 0.13, 0.3 * texture, frequency=60.0, specular=0.15), _plain(0.05, 0.05, 0.05, 0.3 * texture, frequency=50.0)
    sea = Material(color=(0.20, 0.32, 0.42), color2=(0.55, 0.50, 0.38), pattern="wood", contrast=0.5 * texture, frequency=9.0, octaves=6, gain=0.7)
    field = Material(color=(0.46, 0.40, 0.18), color2=(0.18, 0.26, 0.15), pattern="wood", contrast=0.6 * texture, frequency=7.0, octaves=6, gain=0.7)
    made: list[Object] = []
    for name, x, y, w, h, frame, inside in (("sea", -0.78, 1.62, 0.36, 0.25, gilt, sea), ("field", 0.12, 1.66, 0.22, 0.28, black, field)):
        made.append(_box(f"canvas_{name}", inside, (x, y, 0.006), (w - 0.03, h - 0.03, 0.006)))
        made += [_box(f"{name}_{side}", frame, (x + s * (w - 0.02), y, 0.018), (0.02, h, 0.018)) for side, s in (("l", -1), ("r", 1))]
        made += [_box(f"{name}_{side}", frame, (x, y + s * (h - 0.02), 0.018), (w, 0.02, 0.018)) for side, s in (("b", -1), ("t", 1))]
    return made


def _sideboard(texture: float) -> list[Object]:
    walnut, dark = _wood((0.30, 0.17, 0.09), (0.20, 0.105, 0.05), texture, specular=0.06), _wood((0.22, 0.12, 0.06), (0.15, 0.08, 0.04), texture)
    brass = _plain(0.55, 0.40, 0.16, 0.15 * texture, frequency=90.0, specular=0.3)
    glaze = _plain(0.12, 0.24, 0.34, 0.25 * texture, frequency=35.0, specular=0.2, exponent=60.0)
    clay = _plain(0.55, 0.27, 0.15, 0.25 * texture, frequency=40.0, specular=0.05)
    made = [
        _box("sideboard", walnut, (-0.62, 0.47, 0.25), (0.72, 0.30, 0.22)),
        _box("sideboard_top", dark, (-0.62, 0.785, 0.25), (0.75, 0.015, 0.24)),
        *(
            rod(f"leg_{n}", dark, placed(x, 0.0, z), placed(x, 0.18, z), 0.02)
            for n, (x, z) in enumerate(((-1.28, 0.42), (0.04, 0.42), (-1.28, 0.08), (0.04, 0.08)))
        ),
        *(_box(f"drawer_{n}", dark, (x, 0.47, 0.474), (0.222, 0.255, 0.008)) for n, x in enumerate((-1.09, -0.62, -0.15))),
        *(
            Object(name=f"knob_{n}", kind="sphere", material=brass, origin_m=placed(x, 0.60, 0.495), size=(0.016,))
            for n, x in enumerate((-1.09, -0.62, -0.15))
        ),
    ]
    vase = (
        limb((0, 0.09, 0), (0, 0.17, 0), 0.085, 0.075),
        limb((0, 0.17, 0), (0, 0.30, 0), 0.045, 0.036, blend_m=0.05),
        ring((0, 0.325, 0), 0.042, 0.012, blend_m=0.02),
    )
    made.append(
        Object(
            name="vase",
            kind="solid",
            material=glaze,
            origin_m=placed(-1.12, 0.80, 0.25),
            R_world_object=R,
            size=(0.22,),
            bound_m=(0, 0.17, 0),
            primitives=vase,
        )
    )
    jar = (ball((0, 0.075, 0), 0.075), limb((0, 0.15, 0), (0, 0.18, 0), 0.03, 0.035, blend_m=0.03), ball((0, 0.205, 0), 0.018, blend_m=0.01))
    made.append(
        Object(
            name="jar",
            kind="solid",
            material=clay,
            origin_m=placed(-0.86, 0.80, 0.30),
            R_world_object=R,
            size=(0.16,),
            bound_m=(0, 0.11, 0),
            primitives=jar,
        )
    )
    covers = ((0.42, 0.10, 0.08), (0.10, 0.20, 0.33), (0.50, 0.44, 0.28), (0.12, 0.26, 0.15), (0.36, 0.20, 0.32))
    for n, colour in enumerate(covers):
        half = (0.115 - 0.006 * n, 0.016 + 0.004 * (n % 3), 0.082 - 0.004 * n)
        y = 0.80 + sum(2 * (0.016 + 0.004 * (k % 3)) for k in range(n)) + half[1]
        made.append(_box(f"book_{n}", _plain(*colour, 0.3 * texture, frequency=40.0), (-0.26, y, 0.24), half, turn_deg=(-9, 4, -3, 12, 7)[n]))
    return made


def _table(texture: float) -> list[Object]:
    """A round table with a bowl of fruit, a cup and a candlestick."""
    beech = _wood((0.50, 0.34, 0.19), (0.40, 0.26, 0.14), texture, specular=0.05)
    bowl_glaze = _plain(0.60, 0.58, 0.52, 0.12 * texture, frequency=35.0, specular=0.12, exponent=50.0)
    x, _, z = TABLE_M
    top = 0.73

    def solid(name: str, material: Material, at: Vector, parts: tuple[object, ...], radius: float, middle: float) -> Object:
        return Object(
            name=name,
            kind="solid",
            material=material,
            origin_m=placed(*at),
            R_world_object=R,
            size=(radius,),
            bound_m=(0, middle, 0),
            primitives=parts,  # type: ignore[arg-type]
        )

    pedestal = (
        ring((0, top - 0.017, 0), 0.43, 0.016),
        ellipsoid((0, top - 0.012, 0), (0.44, 0.055, 0.44), blend_m=0.0),
        ellipsoid((0, top + 0.062, 0), (0.60, 0.062, 0.60), cut=True),
        limb((0, 0.16, 0), (0, top - 0.05, 0), 0.045, 0.035),
        ball((0, 0.34, 0), 0.065, blend_m=0.05),
        *(
            limb((0, 0.17, 0), (0.30 * math.cos(a), 0.025, 0.30 * math.sin(a)), 0.032, 0.022, blend_m=0.03)
            for a in (0.4, 0.4 + 2 * math.pi / 3, 0.4 + 4 * math.pi / 3)
        ),
    )
    bowl = (
        ellipsoid((0, 0.085, 0), (0.155, 0.085, 0.155)),
        ellipsoid((0, 0.125, 0), (0.145, 0.095, 0.145), cut=True),
        limb((0, 0.008, 0), (0, 0.02, 0), 0.05, blend_m=0.02),
    )
    cup = (
        limb((0, 0.035, 0), (0, 0.07, 0), 0.034, 0.038),
        limb((0, 0.075, 0), (0, 0.15, 0), 0.034, cut=True, blend_m=0.004),
        ring((0.045, 0.048, 0), 0.02, 0.005, blend_m=0.005, x_deg=90),
    )
    candle = (
        ellipsoid((0, 0.012, 0), (0.055, 0.014, 0.055)),
        limb((0, 0.01, 0), (0, 0.16, 0), 0.012, 0.010, blend_m=0.02),
        ring((0, 0.075, 0), 0.008, 0.012, blend_m=0.012),
        ellipsoid((0, 0.165, 0), (0.028, 0.010, 0.028), blend_m=0.008),
    )
    made = [
        solid("table", beech, (x, 0.0, z), pedestal, 0.60, 0.38),
        solid("bowl", bowl_glaze, (x - 0.02, top, z + 0.02), bowl, 0.20, 0.08),
        solid("cup", bowl_glaze, (x + 0.25, top, z + 0.16), cup, 0.09, 0.05),
        solid("candlestick", _plain(0.55, 0.40, 0.16, 0.15 * texture, frequency=90.0, specular=0.3), (x - 0.27, top, z - 0.10), candle, 0.13, 0.09),
        rod(
            "candle",
            _plain(0.78, 0.74, 0.62, 0.08 * texture, frequency=60.0),
            placed(x - 0.27, top + 0.17, z - 0.10),
            placed(x - 0.27, top + 0.33, z - 0.10),
            0.011,
        ),
    ]
    fruit = (
        ("apple_0", (0.50, 0.09, 0.06), -0.055, 0.100, 0.03, 0.040),
        ("apple_1", (0.42, 0.40, 0.10), 0.035, 0.102, 0.055, 0.041),
        ("orange_0", (0.66, 0.30, 0.05), 0.030, 0.105, -0.045, 0.043),
        ("orange_1", (0.66, 0.32, 0.06), -0.012, 0.155, 0.005, 0.042),
    )
    for name, colour, dx, dy, dz, radius in fruit:
        skin = _plain(*colour, 0.25 * texture, frequency=55.0, specular=0.1)
        made.append(Object(name=name, kind="sphere", material=skin, origin_m=placed(x - 0.02 + dx, top + dy, z + 0.02 + dz), size=(radius,)))
    return made


def _armchair(texture: float) -> Object:
    """Upholstered, in the right half of the picture, turned towards the table."""
    cloth = Material(
        color=(0.16, 0.24, 0.30), color2=(0.20, 0.29, 0.345), pattern="cloth", contrast=0.34 * texture, frequency=45.0, octaves=5, gain=0.76
    )
    parts = (
        ellipsoid((0, 0.33, 0.05), (0.33, 0.13, 0.36)),
        limb((-0.24, 0.25, -0.22), (0.24, 0.25, -0.22), 0.14, blend_m=0.06),
        limb((-0.24, 0.25, 0.20), (0.24, 0.25, 0.20), 0.12, blend_m=0.06),
        ellipsoid((0, 0.44, 0.06), (0.29, 0.085, 0.32), blend_m=0.02),
        limb((-0.36, 0.24, 0.25), (-0.36, 0.26, -0.20), 0.10, blend_m=0.04),
        limb((0.36, 0.24, 0.25), (0.36, 0.26, -0.20), 0.10, blend_m=0.04),
        limb((-0.37, 0.56, 0.28), (-0.37, 0.58, -0.18), 0.085, 0.095, blend_m=0.12),
        limb((0.37, 0.56, 0.28), (0.37, 0.58, -0.18), 0.085, 0.095, blend_m=0.12),
        ellipsoid((0, 0.70, -0.28), (0.40, 0.36, 0.13), blend_m=0.08, x_deg=-10),
        limb((-0.24, 0.99, -0.34), (0.24, 0.99, -0.34), 0.10, blend_m=0.10),
    )
    return Object(
        name="armchair",
        kind="solid",
        material=cloth,
        origin_m=placed(1.02, 0.06, 1.25),
        R_world_object=R @ rotation(y_deg=-34.0),
        size=(0.72,),
        bound_m=(0, 0.55, 0),
        primitives=parts,
        wrinkles_m=0.0016,
        wrinkles_per_m=(14, 11, 14),
    )


def _plant(texture: float) -> list[Object]:
    """A pot with broad leaves in the left corner."""
    leaf = _plain(0.10, 0.23, 0.07, 0.4 * texture, frequency=35.0, specular=0.06)
    pot = _plain(0.50, 0.24, 0.14, 0.25 * texture, frequency=35.0)
    blades = []
    for n in range(17):
        a, lift, reach = 2.4 * n, 0.55 + 0.045 * n, 0.34 - 0.010 * n
        x, z = math.cos(a), math.sin(a)
        base, tip = (0.03 * x, 0.34 + 0.02 * n, 0.03 * z), (0.75 * reach * x, lift + 0.06, 0.75 * reach * z)
        blades.append(limb(base, tip, 0.008, 0.005))
        blades.append(
            ellipsoid(
                (1.10 * reach * x, lift + 0.03, 1.10 * reach * z), (0.155, 0.013, 0.062), blend_m=0.006, y_deg=-math.degrees(a), z_deg=-26 + 2.5 * n
            )
        )
    return [
        Object(
            name="pot",
            kind="solid",
            material=pot,
            origin_m=placed(-1.40, 0, 0.95),
            R_world_object=R,
            size=(0.30,),
            bound_m=(0, 0.17, 0),
            primitives=(
                limb((0, 0.13, 0), (0, 0.26, 0), 0.125, 0.155),
                ring((0, 0.335, 0), 0.140, 0.022, blend_m=0.02),
                ellipsoid((0, 0.40, 0), (0.13, 0.06, 0.13), cut=True),
            ),
        ),
        Object(
            name="leaves",
            kind="solid",
            material=leaf,
            origin_m=placed(-1.40, 0, 0.95),
            R_world_object=R,
            size=(0.72,),
            bound_m=(0, 0.85, 0),
            primitives=tuple(blades),
        ),
    ]


def _pendant(texture: float, sway_m: float) -> list[Object]:
    """A bell of enamelled metal on a cable; its light hangs a little below the rim."""
    enamel = _plain(0.52, 0.14, 0.08, 0.12 * texture, frequency=45.0, specular=0.2, exponent=45.0)
    x, y, z = PENDANT_M
    bell = (
        ellipsoid((0, 0.0, 0), (0.205, 0.175, 0.205)),
        limb((0, 0.15, 0), (0, 0.21, 0), 0.032, 0.022, blend_m=0.04),
        ellipsoid((0, -0.02, 0), (0.196, 0.175, 0.196), cut=True),
        limb((0, -0.30, 0), (0, -0.28, 0), 0.28, 0.28, cut=True),
    )
    return [
        Object(
            name="pendant",
            kind="solid",
            material=enamel,
            origin_m=placed(x + sway_m, y, z),
            R_world_object=R,
            size=(0.30,),
            bound_m=(0, 0.05, 0),
            primitives=bell,
        ),
        rod("cable", _plain(0.05, 0.05, 0.05, 0.2 * texture), placed(x + sway_m, y + 0.22, z), placed(x, 2.75, z), 0.006),
    ]


def interior(*, texture: float = 1.0, frame: float = 0, motion: bool = False) -> Scene:
    """A living room with two point lights: a warm pendant over the table, a cool one from a window to the left of the camera.

    In motion the pendant and its light swing, one cycle in `SWAY_FRAMES` frames."""
    sway = SWAY_M * math.sin(2 * math.pi * frame / SWAY_FRAMES) if motion else 0.0
    things = [
        *_walls(texture),
        *_pictures(texture),
        *_sideboard(texture),
        *_table(texture),
        _armchair(texture),
        *_plant(texture),
        *_pendant(texture, sway),
    ]
    x, y, z = PENDANT_M
    lights = (
        Light(name="pendant", type="point", position_m=placed(x + sway, y - 0.10, z), color=(1.0, 0.74, 0.45), intensity=1.5),
        Light(name="window", type="point", position_m=placed(-1.45, 1.95, 3.10), color=(0.55, 0.75, 1.0), intensity=2.6),
    )
    return Scene(name="interior", objects=tuple(things), lights=lights, ambient=(0.035, 0.035, 0.04))
