"""Passes as a renderer or a dataset wrote them, untouched: which channels are depth, P, N or disparity, by their names.

In: EXR, PFM, or PNG and TIFF of 8 and 16 bit or float.  Out: `RawPasses`, values as in the file: no unit, axis or coding is taken for granted.
What they mean is found out in compare/conventions.py and compare/axes.py, or stated by the user (shot/truths.py)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.camera import Camera
from stereorelight.errors import PlateError, nearest_hint
from stereorelight.footage.exr import ExrPart, find_channel, parts_of_view, read_exr
from stereorelight.footage.frames import OURS, camera_from_text
from stereorelight.footage.pfm import read_pfm
from stereorelight.footage.stills import read_still

PassName = Literal["depth", "P", "N", "disparity"]
NAMES: dict[PassName, re.Pattern[str]] = {
    "depth": re.compile(r"z|depth|zdepth|depthz|z_depth|mist|distance|raylength|ray_length|denoising_?depth", re.I),
    "P": re.compile(r"p|pos|position|point|points|pworld|pcamera|pref|world_?position|worldpos|position_?world|camera_?position", re.I),
    "N": re.compile(r"n|nn|normal|normals|world_?normals?|normals?_?world|camera_?normals?|normals?_?camera|denoising_?normal", re.I),
    "disparity": re.compile(r"disp|disparity|parallax", re.I),
}
LETTERS = ("XYZ", "RGB", "UVW")
SINGLE = ("Z", "V", "Y", "X", "R")
NOTHING = 1e9  # renderers write 1e10 and the like where nothing is


@dataclass(frozen=True, kw_only=True, eq=False)
class RawPasses:
    """What a file holds.

    depth, disparity : (H, W), P, N : (H, W, 3) float32, in whatever form; NaN where the file says infinity or 1e9 and more.
    top    : what means 1 in them: 65535 of 16-bit codes, else 1.
    camera : of our own header.   ours : the file is written by this toolkit, and means what its header says.
    names  : pass to the channels it came from.   channels : all there are.
    """

    path: Path
    depth: Float32 | None = None
    P: Float32 | None = None
    N: Float32 | None = None
    disparity: Float32 | None = None
    top: float = 1.0
    camera: Camera | None = None
    ours: bool = False
    names: dict[str, str]
    channels: tuple[str, ...] = ()

    @property
    def size_hw(self) -> tuple[int, int]:
        first = next(a for a in (self.depth, self.P, self.N, self.disparity) if a is not None)
        return int(first.shape[0]), int(first.shape[1])


def read_raw(path: str | Path, *, layer: str | None = None, wanted: PassName = "depth", view: str | None = None) -> RawPasses:
    """The passes of a file by the names of its channels; a picture or PFM, which has none, is what is `wanted`.

    layer  : the channel or layer that holds what is wanted, where its name does not say so.
    Raises : PlateError when the file cannot be read, holds nothing of the kind, or lacks the layer.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".pfm":
        return _of_picture(path, read_pfm(path), wanted, top=1.0)
    if suffix in (".png", ".tif", ".tiff", ".jpg", ".jpeg"):
        if suffix.startswith(".jp"):
            raise PlateError(f"{path}: is a JPEG, which keeps no data to the digit; export the pass as EXR, PFM or 16-bit PNG")
        still = read_still(path)
        top = 1.0 if still.is_float else float(2**still.bits - 1)
        grey = np.array_equal(still.rgb[..., 0], still.rgb[..., 1]) and np.array_equal(still.rgb[..., 0], still.rgb[..., 2])
        if grey:
            codes = still.rgb[..., 0] if still.is_float else np.rint(still.rgb[..., 0] * top).astype(np.float32)
            return _of_picture(path, codes, wanted, top=top)
        return _of_picture(path, still.rgb, wanted, top=1.0)
    return _of_exr(path, layer, wanted, view)


def _clean(a: Float32) -> Float32:
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(a) < NOTHING, a, np.float32(np.nan)).astype(np.float32)


def _of_picture(path: Path, values: Float32, wanted: PassName, *, top: float) -> RawPasses:
    vector = values.ndim == 3
    if vector and wanted in ("depth", "disparity"):
        wanted = "P" if wanted == "depth" else wanted
        if wanted == "disparity":
            raise PlateError(f"{path}: has three channels, but a disparity has one; export it as grey")
    if not vector and wanted in ("P", "N"):
        raise PlateError(f"{path}: has one channel, but {wanted} has three; export it as colour")
    values = _clean(values)
    if wanted in ("depth", "disparity"):
        values = np.where(values == 0, np.float32(np.nan), values) if top > 1 else values
    return RawPasses(path=path, top=top, names={wanted: "the picture"}, **{wanted: values})  # type: ignore[arg-type]


def _triples(parts: list[ExrPart], layer: str) -> tuple[str, ...] | None:
    channels = {c for part in parts for c in part.channels}
    prefix = f"{layer}." if layer else ""
    for letters in LETTERS:
        for cased in (letters, letters.lower()):
            names = tuple(prefix + letter for letter in cased)
            if channels.issuperset(names):
                return names
    return None


def _of_exr(path: Path, layer: str | None, wanted: PassName, view: str | None) -> RawPasses:
    parts = parts_of_view(read_exr(path), view, path)
    words = {k: v for part in reversed(parts) for k, v in part.metadata.items()}
    channels = tuple(dict.fromkeys(c for part in parts for c in part.channels))
    layers = list(dict.fromkeys(c.rpartition(".")[0] for c in channels))
    chosen: dict[PassName, tuple[str, ...]] = {}
    for name, pattern in NAMES.items():
        for candidate in layers:
            last = candidate.rpartition(".")[2]
            if name in ("P", "N"):
                if pattern.fullmatch(last) and (triple := _triples(parts, candidate)):
                    chosen.setdefault(name, triple)
                continue
            of_layer = [c for c in channels if c.rpartition(".")[0] == candidate]
            single = [c for c in of_layer if c.rpartition(".")[2].upper() in SINGLE] if pattern.fullmatch(last) else []
            bare = [c for c in of_layer if pattern.fullmatch(c.rpartition(".")[2]) and not _triples(parts, candidate)]
            if found := ([c for letter in SINGLE for c in single if c.upper().endswith(letter)] or bare):
                chosen.setdefault(name, (found[0],))
    if layer is not None:
        chosen[wanted] = _by_user(path, parts, layer, wanted, channels)
    if not chosen:
        raise PlateError(
            f"{path}: holds no depth, P, N or disparity that is known by its name, only {', '.join(channels[:12])}; name it with --layer"
        )
    values: dict[str, Float32] = {}
    for name, names in chosen.items():
        planes = [_clean(plane) for c in names if (plane := find_channel(parts, c)) is not None]
        values[name] = planes[0] if len(planes) == 1 else np.ascontiguousarray(np.stack(planes, axis=-1))
    camera = camera_from_text(words[f"{OURS}camera"]) if f"{OURS}camera" in words else None
    told = {name: names[0] if len(names) == 1 else names[0].rpartition(".")[0] or "".join(names) for name, names in chosen.items()}
    return RawPasses(path=path, camera=camera, ours=f"{OURS}axes" in words, names=told, channels=channels, **values)  # type: ignore[arg-type]


def _by_user(path: Path, parts: list[ExrPart], layer: str, wanted: PassName, channels: tuple[str, ...]) -> tuple[str, ...]:
    if wanted in ("P", "N"):
        triple = _triples(parts, "" if layer.upper() == "RGB" else layer)
        if triple is not None:
            return triple
    elif layer in channels:
        return (layer,)
    elif one := [c for letter in SINGLE for c in channels if c.upper() == f"{layer.upper()}.{letter}"]:
        return (one[0],)
    known = {k for c in channels for k in (c, c.rpartition(".")[0]) if k}
    raise PlateError(f"{path}: has no channel or layer {layer!r} for {wanted}{nearest_hint(layer, known)}")
