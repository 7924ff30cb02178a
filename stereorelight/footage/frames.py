"""Frames of passes to EXR layers and back, and Z passes of any renderer.

Layers: Z; P.X P.Y P.Z; N.X N.Y N.Z; disparity.X; confidence.Y; flags.Y (the reason bits as float); flow.X flow.Y; beauty as
bare R G B, its alpha as A; plate.R ..; light_<name>_diffuse.R ..; matte_<name>.Y;
shadow_<name>.Y; ao.Y; bent.X bent.Y bent.Z.  Data is 32-bit float, colour half.  Z in metres along
the optical axis; P and N in the scene frame (x right, y up, the camera looks down -z), as the header says too.
Colour is scene-linear in the working space, which the header names with its primaries; a file of another one is converted when
read.  Time code and rate are the header's `timeCode` and `framesPerSecond`, and `metadata["timecode"]` and `["rate"]` of a Frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.camera import Camera, Eye
from stereorelight.errors import PassError, PlateError, RigError, nearest_hint
from stereorelight.footage.colour import DEFAULT, ColourSettings
from stereorelight.footage.exr import STANDARD, TIMECODE, ExrPart, find_channel, parts_of_view, read_exr, write_exr
from stereorelight.footage.file_colour import INTEROP_WORD, header_words, stated_to_working
from stereorelight.passes import UNIT_TOLERANCE, Frame, role_of

AXES = "scene frame of the camera: x right, y up, camera looks down -z; metres"
OURS = "stereorelight/"  # header words of ours begin with it
TIMECODE_KEY, RATE_KEY = "timecode", "rate"  # of Frame.metadata
EXR_FRAMES = 40  # the header's time code counts frames of a second up to here; beyond, it is kept as a word
LETTERS = {"Z": "", "disparity": "X", "P": "XYZ", "N": "XYZ", "bent": "XYZ", "flow": "XY"}
DEPTH_LAYERS, DEPTH_LETTERS = ("depth", "z"), ("Z", "V", "R", "Y", "X")  # how renderers call a Z pass
BACKGROUND_M = 1e9  # renderers write 1e10 and the like where nothing is
Array = npt.NDArray[Any]


def channel_names(name: str) -> tuple[str, ...]:
    """The EXR channels of pass `name`, in order.  Raises PassError for an unknown pass."""
    role = role_of(name)
    if name == "Z":
        return ("Z",)
    if name == "beauty":
        return ("R", "G", "B")
    if name == "alpha":
        return ("A",)
    return tuple(f"{name}.{letter}" for letter in LETTERS.get(name, "RGB" if role.colour else "Y"))


def camera_text(camera: Camera) -> str:
    """The camera as JSON, every digit kept."""
    numbers = {"size": list(camera.size), "K": camera.K.tolist(), "model": camera.model, "distortion": list(camera.distortion)}
    return json.dumps({**numbers, "world_from_camera": camera.world_from_camera.tolist()})


def camera_from_text(text: str) -> Camera:
    """The inverse of `camera_text`.  Raises RigError."""
    try:
        told = json.loads(text)
        return Camera(
            size=tuple(told["size"]),
            K=told["K"],
            model=told["model"],
            distortion=tuple(told["distortion"]),
            world_from_camera=told["world_from_camera"],
        )
    except (ValueError, KeyError, TypeError) as error:
        raise RigError(f"the header's camera cannot be read ({error}); write the file again") from None


def _time(frame: Frame, timecode: str | None, rate: Fraction | None) -> tuple[dict[str, str], dict[str, Any]]:
    """Words and attributes for time code and rate, as told or as the frame's own metadata has them."""
    words, attributes = {}, dict[str, Any]()
    code, told = timecode or frame.metadata.get(TIMECODE_KEY), rate or frame.metadata.get(RATE_KEY)
    if code:
        parts = TIMECODE.fullmatch(code)
        if parts and int(parts[5]) < EXR_FRAMES:
            attributes["timeCode"] = code
        else:
            words[f"{OURS}timecode"] = code
    if told:
        try:
            attributes["framesPerSecond"] = Fraction(told)
        except (ValueError, ZeroDivisionError):
            raise PassError(f"metadata {RATE_KEY!r} must be a rate such as '24000/1001', got {told!r}") from None
    return words, attributes


def write_frame(
    path: str | Path,
    frame: Frame,
    *,
    half: bool = True,
    force: bool = False,
    colour: ColourSettings | None = None,
    timecode: str | None = None,
    rate: Fraction | None = None,
) -> Path:
    """Write every pass of `frame`, its camera, eye, number and words; `read_frame` returns them bit for bit.

    half     : store colour as half; False keeps 32-bit float.  Data passes are always 32-bit float.
    colour   : names the working space that colour passes are in.
    timecode : "hh:mm:ss:ff" or "hh:mm:ss;ff", and rate in frames a second; the frame's own metadata where not given.
    Raises   : OutputError when the file exists or cannot be written; PassError for a name that no layer can have.
    """
    channels: dict[str, Array] = {}
    halves: set[str] = set()
    for name, array in frame.items():
        names = channel_names(name)
        planes = array[..., None] if array.ndim == 2 else array
        channels |= {channel: planes[..., i] for i, channel in enumerate(names)}
        if half and role_of(name).colour:
            halves.update(names)
    space_words, primaries = header_words(colour or DEFAULT)
    time_words, times = _time(frame, timecode, rate)
    words = {f"{OURS}axes": AXES, f"{OURS}eye": frame.eye, **space_words, **time_words}
    if frame.camera is not None:
        words[f"{OURS}camera"] = camera_text(frame.camera)
    if frame.number is not None:
        words[f"{OURS}frame"] = str(frame.number)
    for key, text in frame.metadata.items():
        if key in STANDARD:
            raise PassError(f"metadata {key!r} is an attribute of the EXR format itself; give it another name")
        if key not in (TIMECODE_KEY, RATE_KEY, INTEROP_WORD):  # a source's colorInteropID speaks of its own space, not of ours
            words[key] = text
    return write_exr(path, channels, half=halves, metadata=words, attributes=primaries | times, view=frame.eye, force=force)


def _found(parts: list[ExrPart], names: tuple[str, ...]) -> tuple[str, ...] | None:
    return names if all(find_channel(parts, name) is not None for name in names) else None


def _named_by_user(parts: list[ExrPart], name: str, layer: str, path: Path) -> tuple[str, ...]:
    """The channels that the user's `layer` means for pass `name`: a channel itself, or a layer of XYZ or RGB."""
    count = len(channel_names(name))
    tries: list[tuple[str, ...]] = [(layer,)] if count == 1 else []
    sets = ["XYZ", "xyz", "RGB"] if count == 3 else [c[0] for c in DEPTH_LETTERS] if count == 1 else ["XY", "RG", "uv"]
    tries += [tuple(f"{layer}.{letter}" for letter in letters) for letters in sets]
    for names in tries:
        if _found(parts, names):
            return names
    known = {k for part in parts for k in (*part.channels, *filter(None, part.layers))}
    raise PlateError(f"{path}: has no channel or layer {layer!r} for {name}{nearest_hint(layer, known)}")


def _depth_of_renderer(parts: list[ExrPart]) -> tuple[str, ...] | None:
    for letter in DEPTH_LETTERS:
        for part in parts:
            for channel in part.channels:
                layer, _, last = channel.rpartition(".")
                if last.upper() == letter and layer.rpartition(".")[2].lower() in DEPTH_LAYERS:
                    return (channel,)
    return None


def _cleaned(name: str, a: Float32) -> Array:
    """What a file says, in the terms of a Frame: a renderer's "nothing here" is NaN, flags are whole numbers again."""
    if name == "flags":
        return np.nan_to_num(a, nan=0.0).astype(np.uint16)
    if role_of(name).colour:
        return a
    a = np.where(np.isinf(a), np.float32(np.nan), a)
    with np.errstate(invalid="ignore"):
        if name == "alpha":
            a = np.clip(a, 0, 1)
        elif name == "Z":
            a = np.where((a < np.finfo(np.float32).tiny) | (a >= BACKGROUND_M), np.float32(np.nan), a)
        elif name == "N":
            length = np.linalg.norm(a, axis=-1, keepdims=True)
            unit = np.divide(a, length, out=np.full_like(a, np.nan), where=length > 0.1)
            a = np.where(np.abs(length - 1) <= UNIT_TOLERANCE, a, unit)
    return np.ascontiguousarray(a, dtype=np.float32)


def read_frame(path: str | Path, *, layers: Mapping[str, str] | None = None, view: str | None = None, colour: ColourSettings | None = None) -> Frame:
    """The passes of an EXR: those of `write_frame` bit for bit, or a renderer's Z and picture.

    layers : pass to the file's own channel or layer name, such as {"Z": "depth.V", "N": "normals"}; without it Z is also
             found as depth.Z, Depth.R, ViewLayer.Depth.V and their like.  P and N must be in the scene frame of the camera.
    colour : the working space that colour passes come in; files that state another space or other primaries are converted.
    Returns: a Frame; time code and rate are in its metadata; layers that are no pass are named in `metadata["ignored_layers"]`.
    Raises : PlateError when the file cannot be read, holds no pass, or a pass is not what its name says.
    """
    path = Path(path)
    parts = parts_of_view(read_exr(path), view, path)
    own_words = {k: v for part in reversed(parts) for k, v in part.metadata.items()}
    wanted: dict[str, tuple[str, ...]] = {}
    for part in parts:
        for channel in part.channels:
            layer = channel.rpartition(".")[0]
            # A renderer's alpha is of its own picture; only ours says where light may fall.
            name = layer or {"Z": "Z", "A": "alpha" if f"{OURS}axes" in own_words else "beauty"}.get(channel, "beauty")
            try:
                names = _found(parts, channel_names(name))
            except PassError:
                continue
            if names and channel in names:
                wanted[name] = names
    if "Z" not in wanted and (depth := _depth_of_renderer(parts)):
        wanted["Z"] = depth
    for name, layer in (layers or {}).items():
        role_of(name)
        wanted[name] = _named_by_user(parts, name, layer, path)
    all_channels = [name for part in parts for name in part.channels]
    if not wanted:
        raise PlateError(f"{path}: holds no pass that is known, only {', '.join(all_channels[:12])}; say which channel is Z")
    used = {channel for names in wanted.values() for channel in names}
    ignored = list(dict.fromkeys(name.rpartition(".")[0] or name for name in all_channels if name not in used))
    words = {k: v for k, v in own_words.items() if not k.startswith(OURS)}
    attributes = {k: v for part in reversed(parts) for k, v in part.attributes.items()}
    if code := attributes.get("timeCode", own_words.get(f"{OURS}timecode")):
        words[TIMECODE_KEY] = code
    if "framesPerSecond" in attributes:
        words[RATE_KEY] = str(attributes["framesPerSecond"])
    if ignored:
        words["ignored_layers"] = ", ".join(ignored)
    eye: Eye = "right" if own_words.get(f"{OURS}eye", parts[0].view) == "right" else "left"
    number = own_words.get(f"{OURS}frame", "")
    header = {k: v for part in reversed(parts) for k, v in part.header.items()}
    try:
        passes = {}
        for name, names in wanted.items():
            planes = [plane for channel in names if (plane := find_channel(parts, channel)) is not None]
            passes[name] = _cleaned(name, planes[0] if len(planes) == 1 else np.stack(planes, axis=-1))
            if role_of(name).colour:
                passes[name] = stated_to_working(np.ascontiguousarray(passes[name]), header, path, colour or DEFAULT)
        camera = camera_from_text(own_words[f"{OURS}camera"]) if f"{OURS}camera" in own_words else None
        return Frame(passes=passes, camera=camera, eye=eye, number=int(number) if number.lstrip("-").isdigit() else None, metadata=words)
    except (PassError, RigError, ValueError) as error:
        raise PlateError(f"{path}: {error}") from error
