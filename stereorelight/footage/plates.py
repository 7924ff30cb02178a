"""Plates: any picture file as scene-linear RGB, and the checks that two plates and a rig fit each other.

Out: (H, W, 3) float32, scene-linear in the working space, unclipped; negative values and single NaN pixels are kept, for the steps to flag.
Pixels: (0, 0) is the centre of the top-left pixel."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.camera import Rig
from stereorelight.errors import PlateError
from stereorelight.footage.colour import DEFAULT, ColourSettings, check_colour, space_of_file, to_working
from stereorelight.footage.exr import find_channel, parts_of_view, read_exr
from stereorelight.footage.file_colour import stated_to_working
from stereorelight.footage.stills import read_still

PICTURE_LAYERS = ("rgba", "rgb", "combined", "beauty", "plate", "color", "colour")  # where a file has no bare R, G, B


def _exr_picture(path: Path, view: str | None) -> tuple[Float32, Mapping[str, Any]]:
    """The picture as the file has it, and the header of its part."""
    parts = parts_of_view(read_exr(path), view, path)
    names = [name for part in parts for name in part.channels]
    layers = ["", *(layer for part in parts for layer in part.layers if layer.rpartition(".")[2].lower() in PICTURE_LAYERS)]
    for layer in layers:
        planes = [find_channel(parts, f"{layer}.{c}" if layer else c) for c in "RGB"]
        got = [plane for plane in planes if plane is not None]
        if len(got) == 3 and len({plane.shape for plane in got}) == 1:
            home = next((part for part in parts if any(channel is got[0] for channel in part.channels.values())), parts[0])
            return np.ascontiguousarray(np.stack(got, axis=-1)), home.header
    if "RY" in names or "BY" in names:
        raise PlateError(f"{path}: is a luminance-chroma EXR; export it as RGB")
    gray = find_channel(parts, "Y")
    if gray is not None:
        return np.ascontiguousarray(np.repeat(gray[..., None], 3, axis=2)), {}
    raise PlateError(f"{path}: has no R, G, B to take as the plate, only {', '.join(names[:12])}; export the picture as RGB")


def linear_plate(picture: Float32, name: str | Path, *, colour_space: str = "auto", is_float: bool, colour: ColourSettings | None = None) -> Float32:
    """An encoded (H, W, 3) picture of any source as a plate; `name` is what errors call it.

    Raises : PlateError for a picture without a finite pixel; ShotError for an unknown colour_space.
    """
    settings = colour or DEFAULT
    plate = to_working(picture, space_of_file(name, is_float=is_float, space=colour_space, settings=settings), settings)
    if not np.isfinite(plate).any():
        raise PlateError(f"{name}: every pixel is NaN or infinite; render or export the plate again")
    return plate


def _dpx_plate(path: Path, colour_space: str, settings: ColourSettings) -> Float32:
    """A DPX says its curve in a few words at best: linear and Rec.709 are believed, a film scan must be named."""
    from stereorelight.footage.movie.dpx import read_dpx

    picture = read_dpx(path)
    if colour_space.lower() == "auto":
        if picture.is_log:
            raise PlateError(f'{path}: holds {picture.transfer} values; say which, such as colour_space = "ARRI LogC3" or "ADX10"')
        colour_space = "linear" if picture.transfer == "linear" else "rec709"
    return linear_plate(picture.rgb, path, colour_space=colour_space, is_float=False, colour=settings)


def read_plate(path: str | Path, *, colour_space: str = "auto", view: str | None = None, colour: ColourSettings | None = None) -> Float32:
    """A picture file as scene-linear (H, W, 3) float32 in the working space.

    colour_space : how the file is encoded, see colour.checked_space.  "auto" takes 8 and 16 bit files as sRGB and float files as
                   linear: an EXR that states its space or primaries is converted from these, others are in the working space.
    view         : the eye to take from a multi-view EXR; its first view where not given.
    colour       : working space and config.
    Raises       : PlateError for a file that cannot be read or has no finite pixel; ShotError for an unknown colour_space.
    """
    path, settings = Path(path), colour or DEFAULT
    # A misspelt space, or one whose table is missing, is told before a large file is read.
    check_colour(settings, colour_space)
    if path.suffix.lower() == ".exr":
        picture, header = _exr_picture(path, view)
        if colour_space.lower() == "auto":
            picture = stated_to_working(picture, header, path, settings)
        return linear_plate(picture, path, colour_space=colour_space, is_float=True, colour=settings)
    if path.suffix.lower() == ".dpx":
        return _dpx_plate(path, colour_space, settings)
    still = read_still(path)
    return linear_plate(still.rgb, path, colour_space=colour_space, is_float=still.is_float, colour=settings)


def read_pair(
    left_path: str | Path, right_path: str | Path, *, colour_space: str = "auto", rig: Rig | None = None, colour: ColourSettings | None = None
) -> tuple[Float32, Float32]:
    """Both plates, scene-linear and of one size; a single multi-view EXR may be given for both eyes.

    Raises: PlateError as `read_plate` and `check_pair`.
    """
    same = Path(left_path) == Path(right_path)
    left = read_plate(left_path, colour_space=colour_space, view="left" if same else None, colour=colour)
    right = read_plate(right_path, colour_space=colour_space, view="right" if same else None, colour=colour)
    check_pair(left, right, left_name=str(left_path), right_name=str(right_path), rig=rig)
    return left, right


def check_pair(left: Float32, right: Float32, *, left_name: str = "left", right_name: str = "right", rig: Rig | None = None) -> None:
    """Raise PlateError where a plate's size is not its camera's, or, with no rig, not the other eye's."""
    plates = ((left_name, left, "left"), (right_name, right, "right"))
    if rig is not None:
        cameras = (rig.left, rig.right)
        for (name, plate, eye), camera in zip(plates, cameras):
            if plate.shape[:2] != camera.size_hw:
                is_size, wanted = f"{plate.shape[1]} x {plate.shape[0]}", f"{camera.size[0]} x {camera.size[1]}"
                raise PlateError(f"{name}: is {is_size} pixels, but the rig's {eye} camera is {wanted}; give the plate or the rig of that size")
        return
    if left.shape[:2] != right.shape[:2]:
        sizes = f"{right.shape[1]} x {right.shape[0]} pixels, but {left_name} is {left.shape[1]} x {left.shape[0]}"
        raise PlateError(f"{right_name}: is {sizes}; export both eyes at one size")


def check_sizes(left: Float32, right: Float32, rig: Rig) -> None:
    """`check_pair` for plates that have no names."""
    check_pair(left, right, rig=rig)
