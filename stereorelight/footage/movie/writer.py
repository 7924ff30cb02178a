"""Review movies: encoded pictures to H.264, H.265, ProRes, DNxHR and FFV1 files, in colour that every player can know.

In: RGB (H, W, 3), encoded (not scene-linear), uint8, uint16 or floats in 0..1.  Out: one movie file, whole or not at all.
The planes are Rec.709 Y'CbCr in video range by footage/ycbcr.py, never by swscale; the chroma of 4:2:0 and 4:2:2 sits as
that module says.  Primaries, matrix, range and transfer are written into the file, on the codec and on every frame: ProRes
takes its own from the frames.  The same frames give the same bytes, on any number of cores.

Transfer.  Our pictures are made for an sRGB screen, and the movie says so (IEC 61966-2-1, "1-13-1" in QuickTime's words),
as the Academy Software Foundation's encoding guidelines advise: browsers, QuickTime and mpv then show what the PNG shows.
Tagged Rec.709 ("1-1-1") the same values look washed out in QuickTime and Safari, which take that for a gamma of 1.96; take
transfer="bt709" for pictures made for a Rec.1886 monitor or where a delivery asks for 1-1-1.  Players without colour
management ignore the tag and show the values as they are, which on an sRGB screen is right too."""

from __future__ import annotations

import contextlib
import errno
import os
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import OutputError, nearest_hint
from stereorelight.files import refuse_overwrite, write_whole
from stereorelight.footage.movie.dpx import exact_rate
from stereorelight.footage.movie.timecode import Timecode
from stereorelight.footage.ycbcr import planes_from_rgb

Subsampling = Literal["444", "422", "420"]
MATRIX = "bt709"
PRIMARIES, SPACE, VIDEO_RANGE, PROGRESSIVE = 1, 1, 1, 1  # ITU-T H.273 code points, and FFmpeg's own of range and field order
TRANSFERS: Mapping[str, int] = MappingProxyType({"sRGB": 13, "bt709": 1})  # H.273 code points
THREADS = 4  # x264's bytes depend on this number, so that it is not the machine's
KEY_FRAMES_S = 0.5  # at most so far apart, so that a review movie can be scrubbed
UNTIMED = 2  # x265 times decoding by the third frame; of fewer, it leaves what memory held (its issue 781)


@dataclass(frozen=True, kw_only=True)
class Codec:
    """How one kind of movie is made.

    encoder  : FFmpeg's name.                       suffixes : containers that keep tags and time code, the usual one first.
    bits     : of the planes.                       smallest : (w, h) below which the encoder refuses.
    tag      : QuickTime's four letters where FFmpeg's own choice does not play everywhere.
    """

    encoder: str
    suffixes: tuple[str, ...]
    bits: int
    subsampling: Subsampling
    options: Mapping[str, str] = field(default_factory=dict)
    smallest: tuple[int, int] = (2, 2)
    tag: str | None = None
    inter: bool = False

    @property
    def pixel_format(self) -> str:
        """FFmpeg's name of the planes."""
        return f"yuv{self.subsampling}p" + (f"{self.bits}le" if self.bits > 8 else "")

    @property
    def step_px(self) -> tuple[int, int]:
        """(w, h) of the pixels that share one chroma sample: pictures are padded to whole ones."""
        return {"444": (1, 1), "422": (2, 1), "420": (2, 2)}[self.subsampling]


CODECS: Mapping[str, Codec] = MappingProxyType(
    {
        "h264": Codec(
            encoder="libx264",
            suffixes=(".mp4", ".mov", ".mkv"),
            bits=8,
            subsampling="420",
            options={"crf": "14", "preset": "medium", "profile": "high"},
            inter=True,
        ),
        "h265": Codec(
            encoder="libx265",
            suffixes=(".mp4", ".mov", ".mkv"),
            bits=10,
            subsampling="420",
            options={"crf": "14", "preset": "medium", "x265-params": "log-level=none:info=0:frame-threads=2"},
            smallest=(16, 16),
            tag="hvc1",
            inter=True,
        ),
        "prores": Codec(encoder="prores_ks", suffixes=(".mov",), bits=10, subsampling="422", options={"profile": "hq", "vendor": "apl0"}),
        "prores4444": Codec(encoder="prores_ks", suffixes=(".mov",), bits=10, subsampling="444", options={"profile": "4444", "vendor": "apl0"}),
        "dnxhr": Codec(encoder="dnxhd", suffixes=(".mov",), bits=10, subsampling="422", options={"profile": "dnxhr_hqx"}, smallest=(256, 120)),
        "ffv1": Codec(
            encoder="ffv1", suffixes=(".mkv",), bits=12, subsampling="444", options={"level": "3", "g": "1", "slices": "4", "slicecrc": "1"}
        ),
    }
)


def movie_suffix(codec: str) -> str:
    """The usual suffix of a movie of `codec`, ".mp4" for "h264".  Raises OutputError for an unknown codec."""
    return _known_codec(codec, "a movie").suffixes[0]


def check_movie(path: str | Path, *, codec: str) -> None:
    """Raise OutputError where `codec` is unknown or does not go into a file of that suffix; before any work is done."""
    path = Path(path)
    kind, suffix = _known_codec(codec, str(path)), path.suffix.lower()
    if suffix in kind.suffixes:
        return
    others = [name for name, other in CODECS.items() if suffix in other.suffixes]
    remedy = f"name it {path.stem or 'movie'}{kind.suffixes[0]}" + (f", or take codec {' or '.join(others)}" if others else "")
    raise OutputError(f"{path}: {codec} goes into {' or '.join(kind.suffixes)}, not {suffix or 'a name without a suffix'}; {remedy}")


def _known_codec(codec: str, what: str) -> Codec:
    if codec not in CODECS:
        raise OutputError(f"{what}: codec {codec!r} is unknown{nearest_hint(str(codec), CODECS)}")
    return CODECS[codec]


class MovieWriter:
    """A movie that is written frame by frame; a context manager.

        with MovieWriter("relit.mov", size=(1920, 1080), rate=Fraction(24000, 1001), codec="prores", timecode="01:00:00:00") as movie:
            for picture in pictures:
                movie.write(picture)

    size     : (w, h) of every frame.            rate  : frames a second, a Fraction or whole number; 23.976 is Fraction(24000, 1001).
    codec    : a name of CODECS.                 timecode : of the first frame, "HH:MM:SS:FF", or "HH:MM:SS;FF" for drop-frame.
    transfer : what the pictures were made for, a name of TRANSFERS.
    frames   : written so far.                   padded : (columns, rows) added at the right and bottom, see below.

    The file appears, whole, when the block ends without an error; otherwise nothing is left.  One frame is held at a time,
    and what the encoder looks ahead (some forty frames of H.264 and H.265, none of the others).
    Where pixels share a chroma sample an odd width or height is made even by repeating the last column or row, as
    `padded` says, since neither 4:2:0 nor its players know odd pictures.
    Raises : OutputError for an unknown codec or transfer, a suffix that does not go with the codec, a size or rate that
             cannot be, a file that exists (without `force`) or cannot be written; PlateError for a time code that is none.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        size: tuple[int, int],
        rate: Fraction | int,
        codec: str = "h264",
        timecode: str | None = None,
        transfer: str = "sRGB",
        force: bool = False,
    ) -> None:
        self.path = Path(path)
        check_movie(self.path, codec=codec)
        refuse_overwrite(self.path, force=force)
        self.codec, self._kind, self._force = codec, CODECS[codec], force
        self.rate = self._checked_rate(rate)
        self.size = self._checked_size(size)
        self.timecode = None if timecode is None else str(Timecode.parse(timecode, self.rate))
        if transfer not in TRANSFERS:
            raise OutputError(f"{self.path}: transfer {transfer!r} is unknown{nearest_hint(str(transfer), TRANSFERS)}")
        self.transfer = transfer
        step_x, step_y = self._kind.step_px
        self.padded = (-self.size[0] % step_x, -self.size[1] % step_y)
        self.frames = 0
        self._part: Path | None = None
        self._container: Any = None
        self._stream: Any = None

    def _checked_rate(self, rate: Fraction | int) -> Fraction:
        if not isinstance(rate, (Fraction, int)) or isinstance(rate, bool):
            near = exact_rate(rate) if isinstance(rate, float) and 0.5 < rate <= 1000 else Fraction(24000, 1001)
            raise OutputError(
                f"{self.path}: the rate must be exact, got {rate!r}; give a Fraction such as Fraction({near.numerator}, {near.denominator})"
            )
        if not 0 < rate <= 1000:
            raise OutputError(f"{self.path}: the rate must be above 0 and at most 1000 frames a second, got {rate}")
        return Fraction(rate)

    def _checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        (w, h), (least_w, least_h) = (int(size[0]), int(size[1])), self._kind.smallest
        if w < least_w or h < least_h:
            raise OutputError(
                f"{self.path}: {self.codec} needs pictures of at least {least_w} x {least_h} pixels, got {w} x {h}; take codec h264 or ffv1"
            )
        return w, h

    def __enter__(self) -> MovieWriter:
        refuse_overwrite(self.path, force=self._force)
        part = self.path.with_name(f".{self.path.stem}.{uuid.uuid4().hex[:8]}.part{self.path.suffix}")
        try:
            write_whole(part, lambda temporary: temporary.touch())  # whatever is wrong with the folder is told here, in our words
        except OutputError as error:
            raise OutputError(str(error).replace(os.fspath(part), os.fspath(self.path))) from error
        self._part = part
        try:
            self._open(part)
        except BaseException as error:
            self._drop()
            raise self._told(error) from error
        return self

    def _open(self, part: Path) -> None:
        import av
        from av.codec.context import Flags

        quicktime = {"movflags": "+faststart", "write_tmcd": "1"} if part.suffix.lower() in (".mp4", ".mov") else {}
        self._container = av.open(os.fspath(part), "w", options={"fflags": "+bitexact", **quicktime})
        if self.timecode is not None:
            self._container.metadata["timecode"] = self.timecode
        stream = self._container.add_stream(self._kind.encoder, rate=self.rate, options=dict(self._kind.options))
        stream.width, stream.height = self.size[0] + self.padded[0], self.size[1] + self.padded[1]
        stream.pix_fmt = self._kind.pixel_format
        context = stream.codec_context
        context.time_base = 1 / self.rate
        context.sample_aspect_ratio = Fraction(1)
        context.thread_count = THREADS
        context.field_order = PROGRESSIVE
        context.flags |= int(Flags.bitexact)
        if self._kind.inter:
            context.gop_size = max(1, round(self.rate * Fraction(KEY_FRAMES_S)))
        if self._kind.tag and quicktime:
            context.codec_tag = self._kind.tag
        self._tag(context)
        self._stream = stream

    def _tag(self, target: Any) -> None:
        target.color_primaries, target.colorspace, target.color_range = PRIMARIES, SPACE, VIDEO_RANGE
        target.color_trc = TRANSFERS[self.transfer]

    def write(self, rgb: npt.ArrayLike) -> None:
        """Add one frame, (H, W, 3) encoded RGB: uint8, uint16, or floats, which are clipped to 0..1.

        Raises : OutputError for another shape or type, for NaN, or when the disk is full; the movie is then not written.
        """
        if self._container is None:
            raise OutputError(f"{self.path}: is not open for writing; write frames inside `with MovieWriter(...) as movie:`")
        encoded = self._checked_picture(np.asarray(rgb))
        columns, rows = self.padded
        if columns or rows:
            encoded = np.ascontiguousarray(np.pad(encoded, ((0, rows), (0, columns), (0, 0)), mode="edge"))
        planes = planes_from_rgb(encoded, bits=self._kind.bits, full_range=False, matrix=MATRIX, subsampling=self._kind.subsampling)
        try:
            self._encode(planes)
        except Exception as error:
            raise self._told(error) from error
        self.frames += 1

    def _checked_picture(self, a: npt.NDArray[Any]) -> Float32:
        where, (w, h) = f"{self.path}: frame {self.frames} of the movie", self.size
        if a.ndim != 3 or a.shape[2] != 3:
            raise OutputError(f"{where} must have shape ({h}, {w}, 3), got {a.shape}")
        if a.shape[:2] != (h, w):
            raise OutputError(f"{where} is {a.shape[1]} x {a.shape[0]} pixels, but the movie is {w} x {h}; a movie has one size")
        if a.dtype in (np.uint8, np.uint16):
            return a.astype(np.float32) / np.float32(np.iinfo(a.dtype).max)
        if not np.issubdtype(a.dtype, np.floating):
            raise OutputError(f"{where} must be uint8, uint16 or floats in 0..1, got {a.dtype}")
        unknown = int(np.isnan(a).sum())
        if unknown:
            raise OutputError(f"{where} has {unknown} NaN values; paint them with footage.preview first")
        return np.ascontiguousarray(np.clip(a, 0, 1), dtype=np.float32)

    def _encode(self, planes: tuple[npt.NDArray[Any], ...]) -> None:
        import av

        frame = av.VideoFrame(self._stream.width, self._stream.height, self._kind.pixel_format)
        for target, plane in zip(frame.planes, planes, strict=True):
            h, w = plane.shape
            np.frombuffer(target, plane.dtype).reshape(-1, target.line_size // plane.itemsize)[:h, :w] = plane
        frame.pts, frame.time_base = self.frames, 1 / self.rate
        self._tag(frame)
        self._container.mux(self._stream.encode(frame))

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        part = self._part
        try:
            if error is None and part is not None:
                self._finish(part)
        finally:
            self._drop()

    def _finish(self, part: Path) -> None:
        if self.frames == 0:
            raise OutputError(f"{self.path}: no frame was written, and a movie needs one; check the frame range")
        try:
            packets = self._stream.encode(None)
            if self._kind.encoder == "libx265" and self.frames <= UNTIMED:
                _time_decoding(packets)
            self._container.mux(packets)
            self._container.close()
        except Exception as error:
            raise self._told(error) from error
        write_whole(self.path, lambda temporary: os.replace(part, temporary), force=self._force)

    def _drop(self) -> None:
        """Let go of the encoder and of what is not a whole movie."""
        container, part, self._container, self._stream, self._part = self._container, self._part, None, None, None
        with contextlib.suppress(Exception):  # the movie is given up, and why has been told
            if container is not None:
                container.close()
        if part is not None:
            part.unlink(missing_ok=True)

    def _told(self, error: BaseException) -> BaseException:
        """FFmpeg's errors in our words; others as they are."""
        from av.error import FFmpegError

        if not isinstance(error, (FFmpegError, OSError, ValueError)):
            return error
        number = getattr(error, "errno", None)
        if number == errno.ENOSPC:
            return OutputError(f"{self.path}: the disk is full; free some space and run again")
        if isinstance(error, OSError) and number in errno.errorcode:
            return OutputError(f"{self.path}: {os.strerror(number or 0).lower()}; choose another --out")
        w, h = self.size
        reason = str(error.strerror if isinstance(error, FFmpegError) else error)
        return OutputError(
            f"{self.path}: FFmpeg's {self._kind.encoder} refuses {w} x {h} at {self.rate} frames a second ({reason}); take another codec or size"
        )


def _time_decoding(packets: list[Any]) -> None:
    """Decode `packets`, all of a movie, one after another, and each no later than it is shown."""
    times = sorted(packet.pts for packet in packets)
    late = max(time - packet.pts for time, packet in zip(times, packets, strict=True))
    for time, packet in zip(times, packets, strict=True):
        packet.dts = time - late
