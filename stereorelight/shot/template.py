"""A new shot file, with every key explained where the user reads it.

In: what to fill in.  Out: the text of a shot.toml.  A test reads it back through schema.py, so that the words here and
the checks there cannot part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Array, Item

COMMENT_COLUMN = 27
HEAD = """\
A shot of stereorelight.  Change what you like, then run it again; only what changed is done again:

    stereorelight run {command}

Paths are from this file's folder.  Lengths are metres, angles degrees.  Lights stand in the scene frame of the left
camera: x right, y up, the camera at (0, 0, 0) looking down -z; so z = -2 is two metres in front of the lens."""

PLATES = """\
Pictures, sequences (name.####.exr, name.%04d.exr, %V for the eye), or movies; left alone where one file holds both eyes"""
FRAMES = """\
frames = "1001-1010"       # part of a sequence; all of it when left out
layout = "side-by-side"    # how one file holds both eyes; also side-by-side-half, top-bottom, top-bottom-half
right_late_frames = 0      # the right eye is so many whole frames behind
match_colour = "global"    # give the right eye the left one's colours; "local" area by area"""
COLOUR = "auto: by the kind of file; or what the camera recorded, such as S-Log3"
DRIFT = 'drift = "shot"             # mend a rig that moved since its calibration, from the plates; "frame" for a zoom'
RIG = "The two cameras: lenses, and where the right one stands from the left one"
QUALITY = "draft, standard or fine: how much time a frame may take"
RANGE = """\
near_m = 0.5               # nearest distance to search; found from the pictures when left out
far_m = 20.0               # farthest one
time_window = 2            # frames before and after that steady a frame of a sequence; time = "off" takes each alone"""
METHOD = "normals: plane (edge-aware fit) or difference (as in the paper)"
GAIN = "the plate's own light is multiplied by this before the lights are added"
LIGHTS = """\
As many lights as you like; each gives its own layers in the relit EXR.  Kinds, and the keys of their own:

    point        position_m, attenuation ("inverse_square", "linear", "none", or "radius" with radius_m)
    directional  azimuth_deg (to the right) and elevation_deg (up) of where it comes from, or aim, the way it travels
    spot         as point, with aim_m (a point) or direction, cone_deg (full angle), penumbra_deg (the soft edge)

and for each of them: name, enabled, intensity (1 makes a white card that faces the light at 1 m read 1.0), exposure
(stops), color, diffuse and specular (strengths), exponent (10 is dull, 200 is glossy), wrap (0 to 1), matte (by name).
Any value may be keys on frames (intensity = { keys = [[1001, 1.0], [1020, 3.0]], ease = "smooth" }), and a place may go
with a picture point (position_m = { pixel = [962, 540], frame = 1012, offset_m = [0, 0.1, 0.4] }).
[[mattes]], [[materials]], [environment], [[painted]] looks, and [camera] for a camera that moves, are in docs/relight.md."""
OUTPUT = """\
preview_near_m = 1.0       # nearest and farthest distance in the depth previews;
preview_far_m = 8.0        # measured once on the first frame when left out
movies = ["relit", "wipe"] # of a sequence; also plate, depth, normals, anaglyph; movie_codec = "prores" for ProRes"""


def _inline(value: Any) -> Item:
    item = tomlkit.item(value)
    if isinstance(item, Array):
        item.multiline(False)
    return item


def _put(table: Any, key: str, value: Any, comment: str = "") -> None:
    item = _inline(value)
    if comment:
        item.comment(comment)
        item.trivia.comment_ws = " " * max(2, COMMENT_COLUMN - len(f"{key} = {item.as_string()}"))
    table.add(key, item)


def _say(table: Any, text: str) -> None:
    for line in text.splitlines():
        table.add(tomlkit.comment(line))


def shot_text(
    *,
    left: str,
    right: str,
    name: str,
    lights: Sequence[Mapping[str, Any]],
    rig: str = "rig.json",
    colour_space: str = "auto",
    plate_gain: float = 1.0,
    command: str = "shot.toml",
    depth: Mapping[str, Any] | None = None,
) -> str:
    """The text of a new shot file.

    left, right : plates or patterns, from the shot file's folder.
    lights      : tables as `light.lights.lights_from_dicts` takes them; a key "comment" becomes a comment.
    depth       : keys of [depth] to set beside quality.
    """
    document = tomlkit.document()
    _say(document, HEAD.format(command=command))
    document.add(tomlkit.nl())
    document.add("version", tomlkit.item(1))

    def section(title: str) -> Any:
        table = tomlkit.table()
        document.add(tomlkit.nl())
        document.add(title, table)
        return table

    plates = section("plates")
    _say(plates, PLATES)
    _put(plates, "left", left)
    _put(plates, "right", right)
    _say(plates, FRAMES)
    _put(plates, "colour_space", colour_space, COLOUR)
    rig_table = section("rig")
    _put(rig_table, "file", rig, RIG)
    _say(rig_table, DRIFT)
    depth_table = section("depth")
    _put(depth_table, "quality", "standard", QUALITY)
    for key, value in (depth or {}).items():
        _put(depth_table, key, value)
    _say(depth_table, RANGE)
    _put(section("surface"), "method", "plane", METHOD)
    _put(section("relight"), "plate_gain", plate_gain, GAIN)

    output = section("output")
    _put(output, "folder", "out")
    _put(output, "name", name, "first part of every file name")
    _put(output, "colour", "half", "half or float: precision of the colour layers; data is always float")
    _put(output, "previews", True, "PNG pictures beside the EXRs")
    _say(output, OUTPUT)
    document.add(tomlkit.nl())
    _say(document, LIGHTS)
    tables = tomlkit.aot()
    for light in lights:
        table = tomlkit.table()
        for key, value in light.items():
            if key != "comment":
                _put(table, key, value)
        if "comment" in light:
            table.comment(str(light["comment"]))
        tables.append(table)
    if lights:
        document.add("lights", tables)
    return tomlkit.dumps(document)
