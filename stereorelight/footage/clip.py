"""A clip: one eye's pictures, whatever they are stored as.

In: a picture, a sequence, a movie, one track of a movie, one view of an EXR, or one half of a packed picture.  Out: plates by
frame number, scene-linear (H, W, 3) float32, with the name, time code and words that belong to them.
Frames: a picture has none; a sequence has its files' numbers; a movie counts from `first_frame`, 1 unless told otherwise.
A `Clip` is plain values and goes to other processes; decoders are opened where they are first needed, and shared."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.camera import Eye
from stereorelight.errors import PlateError, ShotError, nearest_hint
from stereorelight.footage.colour import ColourSettings, encode
from stereorelight.footage.exr import read_header
from stereorelight.footage.plates import linear_plate, read_plate
from stereorelight.footage.sequence import COUNTER, Sequence
from stereorelight.footage.stills import SUFFIXES, read_still

if TYPE_CHECKING:
    from stereorelight.footage.movie.reader import Movie, MovieInfo

MOVIE_SUFFIXES = frozenset((".mov", ".mp4", ".m4v", ".mkv", ".mxf", ".avi", ".webm", ".mts", ".m2ts", ".ts", ".mpg"))
Layout = Literal["auto", "separate", "side-by-side", "side-by-side-half", "top-bottom", "top-bottom-half"]
LAYOUTS: tuple[Layout, ...] = ("auto", "separate", "side-by-side", "side-by-side-half", "top-bottom", "top-bottom-half")
PACKED = LAYOUTS[2:]
# What a movie's transfer tag means for the plate; a log curve is hardly ever tagged as such, so the user names it.
SPACE_OF_TRANSFER = {"bt709": "rec709", "smpte170m": "rec709", "bt470bg": "rec709", "iec61966-2-1": "sRGB", "linear": "linear"}
PICTURE_SUFFIXES = frozenset((".exr", ".dpx", *SUFFIXES))
OPEN_MOVIES = 4
# Words that travel from a source into the results; what only its container or its own space concerns does not.
HEADER_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_./-]*")
OURS, OUR_WORDS = "stereorelight/", frozenset(("software", "shot", "step", "colorInteropID", "capDate"))
CONTAINER_WORDS = frozenset(
    ("major_brand", "minor_version", "compatible_brands", "encoder", "handler_name", "vendor_id", "language", "timecode", "duration")
)


def is_movie(path: str | Path) -> bool:
    """Whether the name is one of a movie file."""
    return Path(path).suffix.lower() in MOVIE_SUFFIXES and COUNTER.search(Path(path).name) is None


@dataclass(frozen=True, kw_only=True)
class Clip:
    """One eye's pictures.

    pictures   : the files, or the movie file as a single one.
    eye        : whose they are.               layout : how the eyes share a picture; "separate" where they do not.
    frames     : frame numbers; empty for a single picture.
    track      : of a movie with several.      view   : of a multi-view EXR.
    first_frame: number of a movie's first picture.
    matrix, levels : of a movie, where its own tags are wrong: "bt601", "bt709", "bt2020"; "video", "full".
    rate       : pictures a second, or None where the files do not say.
    start_timecode : of the first picture of a movie.    words : what a movie says of itself, (key, text).
    fault      : what is known to be damaged in a movie, or "".
    """

    pictures: Sequence
    eye: Eye = "left"
    layout: Layout = "separate"
    frames: tuple[int, ...] = ()
    track: int = 0
    view: str | None = None
    first_frame: int = 1
    matrix: str = "auto"
    levels: str = "auto"
    colour_space: str = "auto"
    rate: Fraction | None = None
    start_timecode: str | None = None
    words: tuple[tuple[str, str], ...] = ()
    fault: str = ""

    @property
    def is_movie(self) -> bool:
        return is_movie(self.pictures.pattern)

    @property
    def is_single(self) -> bool:
        """Whether this is one picture without a number."""
        return self.pictures.is_single and not self.is_movie

    def file(self, frame: int | None = None) -> Path:
        """The file that holds `frame`."""
        return Path(self.pictures.pattern) if self.is_movie else self.pictures.path(frame)

    def name(self, frame: int | None = None) -> str:
        """What to call a picture in a message: its file, with the frame where the file is a movie, and the part of it."""
        part = "" if self.layout == "separate" else f", {self.eye} half"
        if self.is_movie:
            track = f", track {self.track}" if self.track else ""
            return f"{self.file()} frame {frame}{track}{part}"
        return f"{self.file(frame)}{part}"

    def check_frame(self, frame: int | None) -> None:
        """Raise PlateError where the clip does not hold `frame`."""
        if not self.is_single and frame not in self.frames:
            cut = f" ({self.fault})" if self.fault else ""
            raise PlateError(f"{self.pictures.pattern}: has no frame {frame}; it has {self.frames[0]}-{self.frames[-1]}{cut}")

    def read(self, frame: int | None = None, *, colour: ColourSettings | None = None) -> Float32:
        """The plate of `frame`, scene-linear (H, W, 3) float32 in the working space.

        Raises : PlateError for a frame that is missing, damaged or cut short; ShotError for an unknown colour space.
        """
        self.check_frame(frame)
        colour = colour or ColourSettings()
        if self.is_movie:
            whole = self._movie_plate(int(frame or 0), colour)
        else:
            whole = read_plate(self.file(frame), colour_space=self.colour_space, view=self.view, colour=colour)
        return part_of(whole, self.eye, self.layout, self.name(frame))

    def encoded(self, frame: int | None = None) -> Float32:
        """The picture of `frame` as recorded, (H, W, 3) R'G'B' with black 0 and white 1: what a person would see, for finding boards.

        An EXR, which is linear, is coded as sRGB.  Raises : PlateError as `read`.
        """
        self.check_frame(frame)
        if self.is_movie:
            movie, lock = self._opened()
            with lock:
                whole = movie.read(int(frame or 0) - self.first_frame)
        elif self.file(frame).suffix.lower() in (".exr", ".dpx"):
            whole = encode(read_plate(self.file(frame), colour_space=self.colour_space, view=self.view), "sRGB")
        else:
            still = read_still(self.file(frame))
            whole = encode(still.rgb, "sRGB") if still.is_float else still.rgb
        return part_of(whole, self.eye, self.layout, self.name(frame))

    def _opened(self) -> tuple[Movie, threading.Lock]:
        return _movie(str(self.file()), _stamp(self.file()), self.track, self.matrix, self.levels, self.first_frame)

    def _movie_plate(self, frame: int, colour: ColourSettings) -> Float32:
        from stereorelight.footage.colour import transfer_table

        movie, lock = self._opened()
        space = self._movie_space(movie.info)
        with lock:
            table = None if space == "linear" else transfer_table(space, colour)
            picture = movie.read(frame - self.first_frame, table)
        if table is not None:
            return picture
        return linear_plate(picture, self.name(frame), colour_space=space, is_float=True, colour=colour)

    def _movie_space(self, info: MovieInfo) -> str:
        if self.colour_space.lower() != "auto":
            return self.colour_space
        tag = info.transfer or "bt709"
        if tag in ("unknown", "unspecified", "reserved"):
            tag = "bt709"
        if tag.startswith("bt2020"):
            return "rec2020"
        if tag not in SPACE_OF_TRANSFER:
            raise ShotError(f'{info.path}: is tagged with the transfer {tag!r}; name what the camera recorded, such as colour_space = "S-Log3"')
        if info.primaries == "bt2020" and SPACE_OF_TRANSFER[tag] == "rec709":
            return "rec2020"
        return SPACE_OF_TRANSFER[tag]

    def timecode(self, frame: int | None) -> str | None:
        """Time code of `frame`, "01:00:00:05" or with ";" for drop frame; None where the files carry none."""
        if not self.is_movie:
            return _told_by_file(str(self.file(frame)), *_stamp(self.file(frame))).timecode
        if frame is None or self.start_timecode is None or self.rate is None:
            return None
        from stereorelight.footage.movie.timecode import Timecode

        return str(Timecode.parse(self.start_timecode, self.rate) + (frame - self.first_frame))

    def source_words(self, frame: int | None) -> dict[str, str]:
        """What the source says of camera, reel and lens, for the header of what is made from it."""
        if self.is_movie:
            return {k: v for k, v in self.words if HEADER_WORD.fullmatch(k) and k.lower() not in CONTAINER_WORDS}
        return dict(_told_by_file(str(self.file(frame)), *_stamp(self.file(frame))).words)

    def digest(self, frame: int | None = None) -> str:
        """sha256 of what the plate of `frame` is read from: the file's bytes, and for a movie the place in it."""
        file = self.file(frame)
        whole = _file_digest(str(file), *_stamp(file))
        if not self.is_movie and self.layout == "separate":
            return whole
        parts: list[Any] = [whole, self.layout, self.eye if self.layout != "separate" else "", self.track, self.matrix, self.levels]
        parts += [frame - self.first_frame if self.is_movie and frame is not None else ""]
        return hashlib.sha256(repr(parts).encode()).hexdigest()


def part_of(picture: Float32, eye: Eye, layout: Layout, name: str) -> Float32:
    """One eye's part of a packed (H, W, 3) picture: left or upper half for the left eye.

    The "half" layouts hold each eye squeezed to half its width or height; it is stretched back.
    Raises : PlateError where the picture cannot be halved.
    """
    if layout in ("separate", "auto"):
        return picture
    across = layout.startswith("side-by-side")
    size = picture.shape[1 if across else 0]
    if size % 2:
        raise PlateError(f"{name}: is {size} pixels {'wide' if across else 'high'}, which cannot be halved for {layout}; check the layout")
    half = slice(0, size // 2) if eye == "left" else slice(size // 2, size)
    part = np.ascontiguousarray(picture[:, half] if across else picture[half])
    return stretched(part, across=across) if layout.endswith("-half") else part


def stretched(part: Float32, *, across: bool) -> Float32:
    """A (H, W, 3) picture at twice its width, or its height, its edges kept: new pixels stand a quarter of an old one from the old ones' middles.

    By Catmull-Rom, which keeps ramps straight; OpenCV's own cubic bends them by a tenth of a pixel, to and fro, which stereo sees.
    """
    import cv2

    before = np.array([-3, 29, 111, -9, 0], np.float32) / 128  # at k - 1/4, of old pixels k-2 .. k+2
    h, w = part.shape[:2]
    out = np.empty((h, 2 * w, 3) if across else (2 * h, w, 3), np.float32)
    one = np.ones(1, np.float32)
    for k, taps in enumerate((before, before[::-1].copy())):
        filtered = cv2.sepFilter2D(part, -1, *((taps, one) if across else (one, taps)), borderType=cv2.BORDER_REPLICATE)
        out[(slice(None), slice(k, None, 2)) if across else slice(k, None, 2)] = filtered
    return out


def _stamp(file: Path) -> tuple[int, int]:
    try:
        stat = file.stat()
    except FileNotFoundError:
        raise PlateError(f"{file}: file missing; check the name in the shot file, or restore the file") from None
    except OSError as error:
        raise PlateError(f"{file}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    return stat.st_size, stat.st_mtime_ns


@functools.lru_cache(maxsize=64)
def _file_digest(file: str, size: int, changed_ns: int) -> str:
    """sha256 of a file's bytes; read again only when its size or time has changed, so that a movie is hashed once a run."""
    try:
        with open(file, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise PlateError(f"{file}: cannot be read: {(error.strerror or str(error)).lower()}") from None


@dataclass(frozen=True, kw_only=True)
class _Told:
    """What a picture file says of itself."""

    timecode: str | None = None
    rate: Fraction | None = None
    words: Mapping[str, str] = field(default_factory=dict)


@functools.lru_cache(maxsize=8)
def _told_by_file(file: str, size: int, changed_ns: int) -> _Told:
    """Time code, rate and words of an EXR or DPX; of other pictures nothing."""
    suffix = Path(file).suffix.lower()
    if suffix == ".exr":
        header = read_header(file)
        own, told = header.metadata, header.attributes
        words = {k: v for k, v in own.items() if HEADER_WORD.fullmatch(k) and not k.startswith(OURS) and k not in OUR_WORDS}
        return _Told(timecode=told.get("timeCode") or own.get(f"{OURS}timecode"), rate=told.get("framesPerSecond"), words=words)
    if suffix == ".dpx":
        from stereorelight.footage.movie.dpx import read_dpx

        picture = read_dpx(file)
        return _Told(timecode=picture.timecode, rate=picture.rate)
    return _Told()


@functools.lru_cache(maxsize=OPEN_MOVIES)
def _movie(path: str, stamp: tuple[int, int], track: int, matrix: str, levels: str, first_frame: int) -> tuple[Movie, threading.Lock]:
    """A decoder that stays where it stopped, so that frames in order are read without seeking; another one once the file has changed."""
    from stereorelight.footage.movie.reader import Movie

    return Movie(path, stream=track, matrix=matrix, levels=levels, first_frame=first_frame), threading.Lock()


def close_movies() -> None:
    """Forget the decoders; files can then be replaced on systems that lock open ones."""
    _movie.cache_clear()


def checked_layout(layout: str) -> Layout:
    """`layout` itself where it is one of `LAYOUTS`.  Raises ShotError with the nearest name."""
    for known in LAYOUTS:
        if layout == known:
            return known
    raise ShotError(f"layout {layout!r} is unknown{nearest_hint(layout, LAYOUTS)}")


def open_clip(text: str | Path, *, eye: Eye = "left", layout: str = "separate", track: int = 0, view: str | None = None, **settings: Any) -> Clip:
    """The clip that `text` names.

    settings : further fields of `Clip`: first_frame, matrix, levels, colour_space.
    Raises   : PlateError when there is no such file, frame, track or view; ShotError for a layout that is unknown.
    """
    checked = checked_layout(layout)
    pictures = Sequence.parse(text, view=eye)
    clip = Clip(pictures=pictures, eye=eye, layout="separate" if checked == "auto" else checked, frames=pictures.frames, view=view, **settings)
    if not clip.is_movie:
        first = clip.file(clip.frames[0] if clip.frames else None)
        with contextlib.suppress(PlateError):  # a damaged picture is told of when it is read, and may not be the only one
            return replace(clip, rate=_told_by_file(str(first), *_stamp(first)).rate)
        return clip
    info = _info(clip.file(), track, clip.first_frame)
    numbers = tuple(range(clip.first_frame, clip.first_frame + info.frames))
    words = tuple(info.metadata.items())
    timecode = info.start_timecode or next((v for k, v in words if k.lower() == "timecode"), None)  # Matroska writes its keys in capitals
    return replace(clip, track=track, frames=numbers, rate=info.rate, start_timecode=timecode, words=words, fault=info.fault)


def _info(path: Path, track: int, first_frame: int) -> MovieInfo:
    from stereorelight.footage.movie.reader import movie_streams

    streams = movie_streams(path, first_frame=first_frame)
    if track >= len(streams):
        raise PlateError(f"{path}: has {len(streams)} video track{'s' if len(streams) > 1 else ''}, no track {track}; tracks count from 0")
    return streams[track]
