"""What a movie is: its size, rate, time code and colour, as its stream and its first picture tell.

In: an open PyAV stream and a decoded picture of it.  Out: a `MovieInfo`.  Nothing is decoded here.
Colour tags come from the first picture, else the stream; what counts where there are none is told in reader.py."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from stereorelight.errors import PlateError
from stereorelight.footage.movie.pixels import MATRICES, OTHER_MATRICES, PRIMARIES, TRANSFERS, Layout, layout_of
from stereorelight.footage.movie.timecode import Timecode


@dataclass(frozen=True, kw_only=True)
class MovieInfo:
    """What a movie is, before any of its pictures.

    path, stream    : the file, and the place among its video streams, from 0.
    size            : (width, height) as coded, pixels.
    rate            : frames a second, exactly.
    frames          : how many frames the file's own tables hold; see `fault`.
    start_timecode  : time code of frame 0, as written; None where there is none.
    codec, pixel_format, bits : the decoder's names, bits of a sample.
    matrix          : "bt601", "bt709", "bt2020" or "rgb"; full_range: whether 0 is black.
    primaries, transfer : H.273 names such as "bt709", "smpte2084"; None where untagged.
    sample_aspect   : width of a pixel in heights; 1 where untagged.
    interlaced      : whether a frame is woven from two moments.
    rotation_deg    : what the display matrix asks for; never applied.
    stereo_mode     : the container's word for how two views are packed ("left_right" ...), or None.
    gaps            : frames that last longer or shorter than the rate says: frames were dropped there.
    fault           : what is known to be damaged, one sentence, or "".
    metadata        : the words of container and stream.
    """

    path: Path
    stream: int
    size: tuple[int, int]
    rate: Fraction
    frames: int
    start_timecode: str | None
    codec: str
    pixel_format: str
    bits: int
    matrix: str
    full_range: bool
    primaries: str | None
    transfer: str | None
    sample_aspect: Fraction
    interlaced: bool = False
    rotation_deg: int = 0
    stereo_mode: str | None = None
    gaps: tuple[int, ...] = ()
    fault: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)

    def timecode(self, frame: int) -> Timecode | None:
        """Time code of frame `frame`, or None where the movie has none that can be read."""
        if self.start_timecode is None:
            return None
        try:
            return Timecode.parse(self.start_timecode, self.rate) + frame
        except PlateError:
            return None


def picture_layout(path: Path, picture: Any, context: Any) -> Layout:
    """How the pixels of `picture` lie.  Raises PlateError for a format that is not read."""
    name = picture.format.name if picture.format else str(context.pix_fmt)
    layout = layout_of(name)
    if layout is None:
        raise PlateError(f"{path}: has {name} pixels, which are not read; export 8 to 16 bit Y'CbCr 4:4:4, 4:2:2, 4:2:0, or RGB")
    return layout


def timecode_of(container: Any, video: Any) -> str | None:
    """The words of a time code: of the container, of the pictures, or of another stream; Matroska writes its keys in capitals."""
    for words in (container.metadata, video.metadata, *(stream.metadata for stream in container.streams)):
        for key, value in words.items():
            if key.lower() == "timecode":
                return str(value)
    return None


def matrix_of(path: Path, picture: Any, context: Any, layout: Layout, size: tuple[int, int], asked: str) -> str:
    """The colour matrix: "rgb", the one asked for, the one tagged, or by size.  Raises PlateError for a tagged one that is not read."""
    if layout.is_rgb:
        return "rgb"
    if asked != "auto":
        return asked
    for source in (picture, context):
        tag = int(source.colorspace)
        if MATRICES.get(tag, "rgb") != "rgb":
            return MATRICES[tag]
        if tag in OTHER_MATRICES:
            raise PlateError(f"{path}: its colour matrix is {OTHER_MATRICES[tag]}, which is not read; export it as Rec.709, or name the matrix")
    return "bt709" if size[0] >= 1280 or size[1] > 576 else "bt601"


def is_full_range(picture: Any, context: Any, layout: Layout, asked: str) -> bool:
    """Whether 0 is black: as asked for, as tagged, or as the pixel format says."""
    if asked != "auto":
        return asked == "full"
    for source in (picture, context):
        if int(source.color_range) in (1, 2):
            return int(source.color_range) == 2
    return layout.always_full or layout.is_rgb


def described(
    path: Path,
    stream: int,
    container: Any,
    video: Any,
    picture: Any,
    *,
    matrix: str,
    levels: str,
    rate: Fraction,
    frames: int,
    gaps: tuple[int, ...],
    fault: str,
) -> MovieInfo:
    """The info of `video`, of which `picture` is the first picture, or the codec context where none can be decoded.

    matrix, levels : what was asked for, or "auto".
    Raises         : PlateError for pixels or a colour matrix that are not read.
    """
    context = video.codec_context
    layout = picture_layout(path, picture, context)
    size = (int(picture.width), int(picture.height))
    return MovieInfo(
        path=path,
        stream=stream,
        size=size,
        rate=rate,
        frames=frames,
        start_timecode=timecode_of(container, video),
        codec=context.name,
        pixel_format=picture.format.name if picture.format else str(context.pix_fmt),
        bits=layout.bits,
        matrix=matrix_of(path, picture, context, layout, size, matrix),
        full_range=is_full_range(picture, context, layout, levels),
        primaries=PRIMARIES.get(int(picture.color_primaries)) or PRIMARIES.get(int(context.color_primaries)),
        transfer=TRANSFERS.get(int(picture.color_trc)) or TRANSFERS.get(int(context.color_trc)),
        sample_aspect=Fraction(video.sample_aspect_ratio or 1),
        interlaced=bool(getattr(picture, "interlaced_frame", False)) or int(getattr(context, "field_order", 0) or 0) > 1,
        rotation_deg=int(getattr(picture, "rotation", 0) or 0),
        stereo_mode=next((str(v) for k, v in video.metadata.items() if k.lower() == "stereo_mode"), container.metadata.get("stereo_mode")),
        gaps=gaps,
        fault=fault,
        metadata={**container.metadata, **video.metadata},
    )
