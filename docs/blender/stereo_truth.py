"""A stereo pair with exact answers from Blender, in the form that stereorelight reads.

    blender -b scene.blend --python stereo_truth.py -- --out DIR [--baseline 0.065] [--frames 1-10] [--size 1920x1080] [--samples 256]

The scene's own camera is the left eye; the right one stands beside it, parallel, so the plates are rectified as shot.  Written are

    DIR/plates/left.####.exr, right.####.exr    what each eye sees, scene-linear, half float
    DIR/truth/left.####.exr, right.####.exr     Blender's own layers: Combined, Depth, Normal, Position, diffuse colour; 32 bit
    DIR/rig.json, camera.json, shot.toml        lenses and eyes; where the left one stands on every frame; ready for `stereorelight run`
    DIR/lights.toml                             the scene's point, sun, spot and area lights in stereorelight's units

Nothing in the .blend is changed: save nothing after it ran.  Cycles and perspective cameras only.  Depth of field and motion blur are
switched off, since one value a pixel cannot tell of them."""

import argparse
import json
import math
import sys
from pathlib import Path

# What a white card at 1 m reads (Blender's pixels are radiance; a matte card sends back its irradiance over pi).
POINT_PER_WATT = 1 / (4 * math.pi * math.pi)  # watts go out evenly: irradiance W / 4 pi
AREA_PER_WATT = 1 / (math.pi * math.pi)  # from one side, by the cosine: irradiance W / pi on the axis, from afar
SUN_PER_STRENGTH = 1 / math.pi  # strength is irradiance


def camera_matrix(projection, width, height):
    """K, pixel centres at whole numbers, from an OpenGL projection matrix as Blender's calc_matrix_camera gives it."""
    fx, fy = projection[0][0] * width / 2, projection[1][1] * height / 2
    cx, cy = (1 - projection[0][2]) / 2 * width - 0.5, (1 + projection[1][2]) / 2 * height - 0.5
    return [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]


def rig_text(K, size, baseline_m):
    eye = {"size": list(size), "K": K, "model": "brown", "distortion": []}
    turn = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    return json.dumps({"version": 1, "left": eye, "right": eye, "R_right_left": turn, "t_right_left_m": [-baseline_m, 0.0, 0.0]}, indent=1) + "\n"


def poses_text(poses, unit_m):
    """poses: frame number to a 4 x 4 camera matrix of Blender's world, z up; its camera looks down -z, as stereorelight's does."""
    frames = {str(frame): {"world_from_camera": matrix} for frame, matrix in sorted(poses.items())}
    return json.dumps({"version": 1, "unit_m": unit_m, "axes": "scene", "up": "z", "frames": frames}, indent=1) + "\n"


def y_up(v, unit_m=1.0):
    """A point or direction of Blender's world in one with y up."""
    return [v[0] * unit_m, v[2] * unit_m, -v[1] * unit_m]


def unit(v):
    length = math.sqrt(sum(c * c for c in v))
    return [c / length for c in v]


def light_table(name, kind, *, watts, color, position, direction, up=(0.0, 0.0, 1.0), size=(1.0, 1.0), cone=0.0, blend=0.0, unit_m=1.0):
    """One light as a table of lights.toml; places and directions are of Blender's world.  None for a kind that has no counterpart."""
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    name = name if name[:1].isalpha() else f"light_{name}"
    table = {"name": name, "color": [float(c) for c in color], "space": "world"}
    at, way = y_up(position, unit_m), unit(y_up(direction))
    scale = unit_m * unit_m  # Blender's watts spread over square units
    if kind == "SUN":
        return table | {"type": "directional", "intensity": watts * SUN_PER_STRENGTH, "aim": way}
    if kind == "POINT":
        return table | {"type": "point", "intensity": watts * POINT_PER_WATT * scale, "position_m": at}
    if kind == "SPOT":  # Blender's blend lies inside the cone, our penumbra outside
        full = math.degrees(cone) * (1 - blend)
        soft = math.degrees(cone) * blend / 2
        reach = {"position_m": at, "direction": way, "cone_deg": max(full, 0.1), "penumbra_deg": soft}
        return table | {"type": "spot", "intensity": watts * POINT_PER_WATT * scale} | reach
    if kind == "AREA":
        sides = {"position_m": at, "direction": way, "up": unit(y_up(up)), "size_m": [size[0] * unit_m, size[1] * unit_m]}
        return table | {"type": "rect", "intensity": watts * AREA_PER_WATT * scale} | sides
    return None


def lights_text(tables):
    lines = ["# The lights that the plates were shot under.  stereorelight's intensity 1 makes a white card at 1 m read 1.0.", ""]
    for table in tables:
        lines.append("[[lights]]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
        lines.append("")
    return "\n".join([*lines, "[camera]", 'file = "camera.json"', ""])


def shot_text():
    return """version = 1

[plates]
left = "plates/left.####.exr"
right = "plates/right.####.exr"

[rig]
file = "rig.json"

[camera]
file = "camera.json"

[[lights]]
name = "key"                # one light more; those of the scene are in lights.toml
type = "point"
position_m = [0.9, 0.5, -0.7]
intensity = 1.0
"""


def frame_numbers(text, first):
    if text is None:
        return [first]
    start, _, end = text.partition("-")
    return list(range(int(start), int(end or start) + 1))


def scene_lights(bpy, unit_m):
    tables = []
    for thing in bpy.data.objects:
        if thing.type != "LIGHT" or thing.hide_render:
            continue
        world, lamp = thing.matrix_world, thing.data
        size = (lamp.size, lamp.size_y if lamp.shape in {"RECTANGLE", "ELLIPSE"} else lamp.size) if lamp.type == "AREA" else (1.0, 1.0)
        table = light_table(
            thing.name,
            lamp.type,
            watts=lamp.energy,
            color=lamp.color,
            position=world.translation,
            direction=[-world[row][2] for row in range(3)],
            up=[world[row][1] for row in range(3)],
            size=size,
            cone=getattr(lamp, "spot_size", 0.0),
            blend=getattr(lamp, "spot_blend", 0.0),
            unit_m=unit_m,
        )
        if table is not None:
            tables.append(table)
    return tables


def file_format(settings, kind, depth):
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE" if kind == "OPEN_EXR_MULTILAYER" else "IMAGE"
    settings.file_format, settings.color_depth = kind, depth


def main(words):
    import bpy
    from mathutils import Matrix

    parser = argparse.ArgumentParser(prog="stereo_truth.py")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--baseline", type=float, default=0.065, help="metres between the eyes")
    parser.add_argument("--frames", help="such as 1-10; the current one when left out")
    parser.add_argument("--size", help="such as 1920x1080; the scene's own when left out")
    parser.add_argument("--samples", type=int, default=256)
    asked = parser.parse_args(words)
    scene = bpy.context.scene
    if scene.camera is None or scene.camera.data.type != "PERSP":
        sys.exit("the scene needs a perspective camera: it is the left eye")
    out = asked.out.resolve()
    unit_m = scene.unit_settings.scale_length
    render = scene.render
    render.engine, scene.cycles.samples = "CYCLES", asked.samples
    render.use_motion_blur = False
    render.resolution_percentage = 100
    if asked.size:
        render.resolution_x, render.resolution_y = (int(n) for n in asked.size.split("x"))
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    view = bpy.context.view_layer
    view.use_pass_z = view.use_pass_normal = view.use_pass_position = view.use_pass_diffuse_color = True
    eyes = {"left": scene.camera}
    eyes["right"] = bpy.data.objects.new("right_eye", scene.camera.data.copy())
    scene.collection.objects.link(eyes["right"])
    for eye in eyes.values():
        eye.data.dof.use_dof = False
    poses = {}
    for frame in frame_numbers(asked.frames, scene.frame_current):
        scene.frame_set(frame)
        place, turn, _ = eyes["left"].matrix_world.decompose()  # a camera's scale is no part of its view
        rigid = Matrix.Translation(place) @ turn.to_matrix().to_4x4()
        poses[frame] = [list(row) for row in rigid]
        eyes["right"].matrix_world = rigid @ Matrix.Translation((asked.baseline / unit_m, 0.0, 0.0))
        for name, eye in eyes.items():
            scene.camera = eye
            file_format(render.image_settings, "OPEN_EXR_MULTILAYER", "32")
            render.filepath = str(out / "truth" / f"{name}.{frame:04d}.exr")
            bpy.ops.render.render(write_still=True)
            file_format(render.image_settings, "OPEN_EXR", "16")
            bpy.data.images["Render Result"].save_render(str(out / "plates" / f"{name}.{frame:04d}.exr"), scene=scene)
        scene.camera = eyes["left"]
    size = (render.resolution_x, render.resolution_y)
    projection = eyes["left"].calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1])
    texts = {
        "rig.json": rig_text(camera_matrix(projection, *size), size, asked.baseline),
        "camera.json": poses_text(poses, unit_m),
        "lights.toml": lights_text(scene_lights(bpy, unit_m)),
        "shot.toml": shot_text(),
    }
    out.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (out / name).write_text(text)
    print(f"stereo truth of {len(poses)} frames -> {out}")


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
