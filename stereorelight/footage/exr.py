"""EXR files to arrays and back; the only home of OpenEXR.

In, out: channels as (H, W) arrays by full name ("Z", "light_key_diffuse.R"), always as large as the display window.
Pixels: (0, 0) is the top-left pixel of the display window.  Values pass through untouched; colour is not decoded here.

What the binding does silently is refused or mended at this door: it ignores strides, refuses float64, replaces the arrays
in the caller's dict, and drops a damaged part with no more than a line on stdout.  Data layers are ZIP, never DWA:
DWA takes "P.Y" and "N.Y" for luminance and loses bits."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import OutputError, PassError, PlateError, nearest_hint
from stereorelight.files import refuse_overwrite, write_whole
from stereorelight.footage.source import check_file, quiet

HALF_MAX = 65504.0  # the largest finite half
LARGEST_SIDE = 32768  # pixels; no camera makes more, a damaged header easily claims it
SUSPECT_BYTES, SUSPECT_RATIO = 1 << 30, 2000  # beyond what ZIP can shrink (1032) a large picture is a damaged header
MAGIC = b"\x76\x2f\x31\x01"
CHANNEL_NAME = re.compile(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*")
STANDARD = frozenset(("channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder", "multiView", "name"))
STANDARD |= {"pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "tiles", "type", "version", "view"}


# What is no text and yet written: eight floats, a Fraction, and "hh:mm:ss:ff" (";" before the frame for drop frame).
ATTRIBUTES = ("chromaticities", "framesPerSecond", "timeCode")
TIMECODE = re.compile(r"(\d\d):([0-5]\d):([0-5]\d)([:;.])(\d\d)")


@dataclass(frozen=True, kw_only=True, eq=False)
class ExrPart:
    """One part, or one view of a part, of an EXR file.

    name, view : as in the file; None where it has none.
    channels   : full channel name to (H, W) float32 of the display window's size; 0 where the file has no pixels.
    header     : every attribute by name; its words and ATTRIBUTES are written back by `write_exr_parts`.
    offset     : (x, y) of the file's data window inside the display window, pixels.
    """

    channels: Mapping[str, Float32]
    name: str | None = None
    view: str | None = None
    header: Mapping[str, Any] = field(default_factory=dict)
    offset: tuple[int, int] = (0, 0)

    @property
    def layers(self) -> tuple[str, ...]:
        """Layer names in the file's order; "" is the layer of bare channels such as R, G, B, Z."""
        return tuple(dict.fromkeys(name.rpartition(".")[0] for name in self.channels))

    @property
    def metadata(self) -> dict[str, str]:
        """The header's words: attributes that are text and not part of the format."""
        return {k: v for k, v in self.header.items() if isinstance(v, str) and k not in STANDARD}

    @property
    def attributes(self) -> dict[str, Any]:
        """What `write_exr` takes as attributes: the header's chromaticities, framesPerSecond and timeCode, where it has them."""
        found: dict[str, Any] = {}
        primaries, rate, code = (self.header.get(key) for key in ATTRIBUTES)
        if isinstance(primaries, tuple) and len(primaries) == 8:
            found["chromaticities"] = tuple(float(x) for x in primaries)
        if isinstance(rate, Fraction) and rate > 0:
            found["framesPerSecond"] = rate
        if code is not None and hasattr(code, "dropFrame") and code.hours < 24 and code.frame < 40:
            found["timeCode"] = f"{code.hours:02d}:{code.minutes:02d}:{code.seconds:02d}{';' if code.dropFrame else ':'}{code.frame:02d}"
        return found


def _window(header: Mapping[str, Any], which: str) -> tuple[int, int, int, int]:
    """x, y, width, height of a window attribute."""
    low, high = header[which]
    return int(low[0]), int(low[1]), int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1


def _check_claims(path: Path, headers: Sequence[Mapping[str, Any]]) -> None:
    """Refuse what the binding cannot read, and a header that claims more pixels than the file can hold."""
    claimed = 0
    for header in headers:
        if str(header.get("type", "")).rpartition(".")[2] in ("deepscanline", "deeptile"):
            raise PlateError(f"{path}: is a deep EXR; flatten it to an ordinary one first")
        for which in ("dataWindow", "displayWindow"):
            _, _, w, h = _window(header, which)
            if not (1 <= w <= LARGEST_SIDE and 1 <= h <= LARGEST_SIDE):
                raise PlateError(f"{path}: damaged: its {which} claims {w} x {h} pixels; copy or render it again")
            claimed = max(claimed, w * h * 4 * len(header["channels"]))
    if claimed > SUSPECT_BYTES and claimed > SUSPECT_RATIO * path.stat().st_size:
        raise PlateError(f"{path}: damaged: its header claims {claimed >> 20} MiB of pixels in {path.stat().st_size} bytes; copy or render it again")


def _placed(pixels: npt.NDArray[Any], header: Mapping[str, Any]) -> Float32:
    """The channel on the display window: cropped, padded with 0, subsampled chroma repeated."""
    x, y, w, h = _window(header, "dataWindow")
    dx, dy, dw, dh = _window(header, "displayWindow")
    if pixels.shape != (h, w):
        step_y, step_x = -(-h // pixels.shape[0]), -(-w // pixels.shape[1])
        pixels = pixels.repeat(step_y, axis=0).repeat(step_x, axis=1)[:h, :w]
    if (x, y, w, h) == (dx, dy, dw, dh):
        return np.array(pixels, dtype=np.float32, order="C", copy=None)
    out = np.zeros((dh, dw), dtype=np.float32)
    x0, y0, x1, y1 = max(x, dx), max(y, dy), min(x + w, dx + dw), min(y + h, dy + dh)
    if x0 < x1 and y0 < y1:
        out[y0 - dy : y1 - dy, x0 - dx : x1 - dx] = pixels[y0 - y : y1 - y, x0 - x : x1 - x]
    return out


def _views(channels: Mapping[str, Float32], views: Sequence[str]) -> Iterator[tuple[str | None, dict[str, Float32]]]:
    """Sort a single part's channels by view: "right.R" and "key.right.R" are R and key.R of view right."""
    sorted_out: dict[str, dict[str, Float32]] = {view: {} for view in views}
    for name, pixels in channels.items():
        *layer, last = name.split(".")
        view = next((word for word in layer if word in views), views[0])
        if view in layer:
            layer.remove(view)
        sorted_out[view][".".join([*layer, last])] = pixels
    yield from sorted_out.items()


def read_exr(path: str | Path) -> list[ExrPart]:
    """Every part of an EXR file; a multi-view part becomes one ExrPart per view, without the view in its channel names.

    Half, float and whole-number channels all come as float32 (H, W) of the display window.
    Raises: PlateError when the file is missing, empty, no EXR, truncated, damaged or deep.
    """
    path = Path(path)
    check_file(path)
    with path.open("rb") as file:
        if file.read(4) != MAGIC:
            raise PlateError(f"{path}: is not an EXR file; check its suffix, or export it again")
    import OpenEXR

    with quiet():
        OpenEXR.setMaxImageSize(LARGEST_SIDE, LARGEST_SIDE)
        try:
            promised = [dict(part.header) for part in OpenEXR.File(str(path), header_only=True).parts]
            _check_claims(path, promised)
            parts = list(OpenEXR.File(str(path), separate_channels=True).parts)
        except (RuntimeError, ValueError, IndexError, KeyError, MemoryError, UnicodeDecodeError):
            raise PlateError(f"{path}: truncated or damaged EXR; copy or render it again") from None
    # The binding drops what it cannot decode without raising: hold what came against what the headers promised.
    if not promised or len(parts) != len(promised):
        raise PlateError(f"{path}: truncated or damaged EXR: {len(parts)} of {len(promised)} parts can be read; copy or render it again")
    out: list[ExrPart] = []
    for part, header in zip(parts, promised):
        raw = {str(name): channel.pixels for name, channel in part.channels.items()}
        lost = [channel.name for channel in header["channels"] if getattr(raw.get(channel.name), "size", 0) == 0]
        if lost:
            raise PlateError(f"{path}: truncated or damaged EXR: channel {lost[0]} cannot be read; copy or render it again")
        channels = {name: _placed(pixels, header) for name, pixels in raw.items()}
        x, y, _, _ = _window(header, "dataWindow")
        dx, dy, _, _ = _window(header, "displayWindow")
        name, view, views = header.get("name"), header.get("view"), header.get("multiView")
        found = _views(channels, list(views)) if views and not view else iter([(view, channels)])
        out += [ExrPart(name=name, view=v, channels=c, header=header, offset=(x - dx, y - dy)) for v, c in found]
    return out


def read_header(path: str | Path) -> ExrPart:
    """The first part's header without its pixels: words, time code, rate, primaries.

    Raises: PlateError when the file is missing, empty, no EXR or damaged at its beginning.
    """
    path = Path(path)
    check_file(path)
    import OpenEXR

    with quiet():
        OpenEXR.setMaxImageSize(LARGEST_SIDE, LARGEST_SIDE)
        try:
            headers = [dict(part.header) for part in OpenEXR.File(str(path), header_only=True).parts]
        except (RuntimeError, ValueError, IndexError, KeyError, MemoryError, UnicodeDecodeError):
            headers = []
    if not headers:
        raise PlateError(f"{path}: truncated or damaged EXR; copy or render it again")
    return ExrPart(channels={}, header=headers[0])


def parts_of_view(parts: Sequence[ExrPart], view: str | None, path: str | Path) -> list[ExrPart]:
    """The parts that belong to `view` (None: the file's first view); parts without a view belong to every one.

    Raises: PlateError when the file has views but not this one.
    """
    views = list(dict.fromkeys(part.view for part in parts if part.view))
    if not views:
        return list(parts)
    if view is None:
        view = views[0]
    elif view not in views:
        raise PlateError(f"{path}: has no view {view!r}{nearest_hint(view, views)}")
    return [part for part in parts if part.view in (None, view)]


def find_channel(parts: Sequence[ExrPart], name: str) -> Float32 | None:
    """Channel `name` in any of `parts`; "depth.Z" is also channel Z of a part named "depth"."""
    layer, _, last = name.rpartition(".")
    for part in parts:
        if name in part.channels:
            return part.channels[name]
    for part in parts:
        own = (part.name or "").removesuffix(f".{part.view}").removeprefix(f"{part.view}.")
        if layer and own == layer and last in part.channels:
            return part.channels[last]
    return None


def read_layer(path: str | Path, layer: str = "", channels: str = "RGB", *, view: str | None = None) -> Float32:
    """(H, W, C) float32: the named channels of one layer ("" for bare R, G, B), in the order given.

    Raises: PlateError when the file, the view or a channel is missing; it names the layers that there are.
    """
    parts = parts_of_view(read_exr(path), view, path)
    planes: list[Float32] = []
    for letter in channels:
        wanted = f"{layer}.{letter}" if layer else letter
        plane = find_channel(parts, wanted)
        if plane is None:
            known = [name for part in parts for name in part.channels]
            raise PlateError(f"{path}: has no channel {wanted!r}{nearest_hint(wanted, known)}")
        if planes and plane.shape != planes[0].shape:
            raise PlateError(
                f"{path}: channel {wanted!r} is {plane.shape[::-1]} pixels, others are {planes[0].shape[::-1]}; render the layers at one size"
            )
        planes.append(plane)
    return np.ascontiguousarray(np.stack(planes, axis=-1))


def _stored(name: str, values: Any, size_hw: tuple[int, int] | None, *, half: bool) -> npt.NDArray[Any]:
    """A fresh C-contiguous float32 or float16 copy of one channel; values beyond the type's reach are clipped, not made inf."""
    if not CHANNEL_NAME.fullmatch(name) or len(name) > 255:
        raise PassError(f"channel name {name!r} must be letters, digits and '_', with '.' between layer and channel, such as 'light_key.R'")
    a = np.asarray(values)
    if a.ndim != 2 or 0 in a.shape or (size_hw and a.shape != size_hw):
        raise PassError(f"channel {name!r} must have shape {size_hw or '(H, W)'}, got {a.shape}")
    if not (np.issubdtype(a.dtype, np.floating) or np.issubdtype(a.dtype, np.integer) or a.dtype == np.bool_):
        raise PassError(f"channel {name!r} must be numbers, got {a.dtype}")
    reach = HALF_MAX if half else float(np.finfo(np.float32).max)
    with np.errstate(over="ignore", invalid="ignore"):
        out: npt.NDArray[Any] = np.array(a, dtype=np.float16 if half else np.float32, order="C")
    if a.dtype != out.dtype:
        born = np.isinf(out) & ~np.isinf(a)
        if born.any():
            out[born] = np.copysign(reach, a[born])
    return out


def write_exr(
    path: str | Path,
    channels: Mapping[str, Any],
    *,
    half: Collection[str] = (),
    metadata: Mapping[str, str] | None = None,
    attributes: Mapping[str, Any] | None = None,
    view: str | None = None,
    views: Sequence[str] = (),
    force: bool = False,
) -> Path:
    """Write one part, ZIP, 32-bit float but for the channels in `half`.

    channels : full name to (H, W) numbers of any strides and type; they are copied, never changed.
    half     : channels to store as half; finite values beyond 65504 become 65504, never inf.
    attributes : those of ATTRIBUTES, as `ExrPart.attributes` gives them.
    view     : the eye that the file shows; views: all of them, first the default one, where the others' channels are
               named "right.R".  Never both.
    Raises   : PassError for a name or shape that no EXR can hold; OutputError when the file exists or cannot be written.
    """
    if view and views:
        raise PassError("view and views say the same thing twice; give one")
    part = ExrPart(channels=channels, view=view, header=dict(metadata or {}) | _coded(attributes or {}))
    return _write(path, [part], half=half, views=views, force=force)


def _coded(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """ATTRIBUTES as the library takes them.  Raises PassError."""
    import OpenEXR

    out: dict[str, Any] = {}
    for key, value in attributes.items():
        if key == "chromaticities" and len(value) == 8:
            out[key] = tuple(float(x) for x in value)  # it takes nothing but a tuple
        elif key == "framesPerSecond" and value > 0 and max(Fraction(value).as_integer_ratio()) < 2**31:
            out[key] = Fraction(value)  # it reads its own Rational, but writes only this
        elif key == "timeCode" and (parts := TIMECODE.fullmatch(str(value))) and int(parts[1]) < 24 and int(parts[5]) < 40:
            code = OpenEXR.TimeCode()
            code.hours, code.minutes, code.seconds, code.frame = (int(parts[i]) for i in (1, 2, 3, 5))
            code.dropFrame = int(parts[4] != ":")
            out[key] = code
        else:
            more = "; the format counts 40 frames a second at most" if key == "timeCode" else ""
            raise PassError(f"attribute {key!r} cannot be {value!r} in an EXR{more}; known: {', '.join(ATTRIBUTES)}")
    return out


def write_exr_parts(path: str | Path, parts: Sequence[ExrPart], *, half: Collection[str] = (), force: bool = False) -> Path:
    """Write several parts, one per view or layer group, each with its own name, view and words; else as `write_exr`."""
    names = [part.name or part.view for part in parts]
    if not parts or (len(parts) > 1 and (None in names or len(set(names)) != len(names))):
        raise PassError(f"an EXR of several parts needs a different name for each, got {names}")
    return _write(path, parts, half=half, views=(), force=force)


def _write(path: str | Path, parts: Sequence[ExrPart], *, half: Collection[str], views: Sequence[str], force: bool) -> Path:
    refuse_overwrite(Path(path), force=force)
    import OpenEXR

    out = []
    for part in parts:
        if not part.channels:
            raise PassError("an EXR part needs at least one channel")
        header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        for key, text in part.metadata.items():
            if not key or len(key) > 255 or "\0" in key + text:
                raise PassError(f"metadata {key!r} must be a word with a text without NUL")
            header[key] = text
        header |= _coded(part.attributes)
        if part.view:
            header["view"] = part.view
        if views:
            header["multiView"] = list(views)
        stored: dict[str, npt.NDArray[Any]] = {}
        for name, values in part.channels.items():
            size_hw = next(iter(stored.values())).shape if stored else None
            stored[name] = _stored(name, values, size_hw, half=name in half)
        out.append(OpenEXR.Part(header, stored, name=part.name or part.view or ""))

    def put(temporary: Path) -> None:
        # Through memory: the library's own file writing does not notice a full disk on small files.
        buffer = io.BytesIO()
        try:
            OpenEXR.File(out).write(buffer)
        except (RuntimeError, ValueError, TypeError) as error:
            raise OutputError(f"{path}: the EXR library refuses it: {str(error).splitlines()[0]}") from error
        with temporary.open("wb") as file:
            file.write(buffer.getbuffer())

    return write_whole(path, put, force=force)
