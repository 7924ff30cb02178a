"""Camera movies to float pictures, frame by frame and exactly; the only home of PyAV besides the writer.

In: ProRes, DNxHD and DNxHR, H.264, H.265, FFV1 in .mov, .mp4, .mxf, .mkv and whatever else the decoder knows.
Out: (H, W, 3) float32, encoded R'G'B' or, with a transfer table, scene-linear, of the frame asked for.  Frames count from 0 in the order
in which they are shown.  Pixels: as coded; rotation tags and pixel aspect are told, never applied; alpha is left out.

Whatever the order of reading, a frame has the same bits: frames are known by their presentation time, reading on never seeks, and a
seek goes to a key frame no later than the frame.  Memory does not grow with the movie, apart from 25 bytes a frame for its times.

Colour tags come from the first frame, else the stream.  Untagged: matrix Rec.709 from 1280 x 720 or 576 rows on and Rec.601 below;
video range, but full range for RGB and for formats that say so.  Interlaced movies are read as woven frames and say so in their info.

A decoder hides damage by painting old pixels.  Here the first sign of damage has the group of frames decoded again packet by packet:
what comes before the damage is kept, and each frame from it to the next key frame is refused by name.
FFV1's checksums, which the decoder does not mind, are looked at first (checksums.py)."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError
from stereorelight.footage.movie.checksums import carries_checksums, is_sound
from stereorelight.footage.movie.container import chosen_stream, opened, video_streams
from stereorelight.footage.movie.damage import first_damage, packets_spoilt
from stereorelight.footage.movie.info import MovieInfo as MovieInfo
from stereorelight.footage.movie.info import described, picture_layout
from stereorelight.footage.movie.packets import PacketTable, frames_lost, packet_table, rate_of
from stereorelight.footage.movie.pixels import planes_of
from stereorelight.footage.ycbcr import Transfer, rgb_from_planes, weights
from stereorelight.threads import usable_cores

STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}
FRAMES_AHEAD = 2  # decoded beyond the cores at work, so that decoding goes on while a picture is converted


def movie_streams(path: str | Path, *, first_frame: int = 0) -> tuple[MovieInfo, ...]:
    """What each video stream of a movie is; `first_frame` as `Movie` takes it.  Raises PlateError for a file that is no movie or has no pictures."""
    path = Path(path)
    container = opened(path)
    try:
        chosen_stream(container, path, 0)
        count = len(video_streams(container))
    finally:
        container.close()
    infos = []
    for stream in range(count):
        with Movie(path, stream=stream, first_frame=first_frame) as movie:
            infos.append(movie.info)
    return tuple(infos)


class Movie:
    """One video stream of a movie, opened when first asked and read frame by frame in any order.

    stream : place among the file's video streams, from 0.
    matrix : "auto" (by tags, see above), "bt601", "bt709", "bt2020".
    levels : "auto", "video", "full".
    siting : where 4:2:2 and 4:2:0 chroma lies: "left", "topleft", "center" (see footage/ycbcr.py).
    threads: of the decoder; None for one a core and two ahead.
    first_frame: what its first frame is called in messages; frames are read from 0 whatever it is.
    Raises : PlateError for everything that can be wrong with a movie.
    It can be sent to another process, where it opens again.  One thread reads at a time; others wait."""

    def __init__(
        self,
        path: str | Path,
        *,
        stream: int = 0,
        matrix: str = "auto",
        levels: str = "auto",
        siting: str = "left",
        threads: int | None = None,
        first_frame: int = 0,
    ) -> None:
        if matrix != "auto":
            weights(matrix)
        if levels not in ("auto", "video", "full"):
            raise PlateError(f"levels {levels!r} are unknown; known: auto, video, full")
        self.path, self.stream = Path(path), stream
        self._options = {"matrix": matrix, "levels": levels, "siting": siting}
        self._threads, self._first = threads, first_frame
        self._forget()

    def _forget(self) -> None:
        self._lock = threading.RLock()
        self._container: Any = None
        self._video: Any = None
        self._info: MovieInfo | None = None
        self._frames: Iterator[tuple[int, Any]] | None = None
        self._fresh = False  # whether nothing was read since the container was opened
        self._next = 0  # the frame that reading on would give
        self._held: tuple[int, Any] | None = None
        self._bad: dict[int, str] = {}  # packet: why its picture cannot be had
        self._summed = False  # whether packets carry checksums

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "stream": self.stream, "_options": self._options, "_threads": self._threads, "_first": self._first}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def __enter__(self) -> Movie:
        self._opened()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; asking again opens it again."""
        with self._lock:
            container, bad = self._container, self._bad
            self._forget()
            self._bad = bad
            if container is not None:
                container.close()

    @property
    def info(self) -> MovieInfo:
        """What the movie is."""
        return self._opened()

    def _opened(self) -> MovieInfo:
        with self._lock:
            if self._info is None:
                try:
                    self._open_stream()
                    self._table: PacketTable = packet_table(self._container, self._video, str(self.path), self.path.stat().st_size)
                    self._place = {int(pts): k for k, pts in enumerate(self._table.pts)}
                    self._find_cut()
                    self._open_stream()
                    if self._video.codec_context.name == "ffv1":
                        self._summed = carries_checksums(self._container.demux(self._video))
                        self._open_stream()
                    self._info = self._described()
                except BaseException:
                    self.close()
                    raise
            return self._info

    def _open_stream(self, *, threads: int | None = None) -> None:
        if self._container is not None:
            self._container.close()
        self._container = opened(self.path)
        self._video = chosen_stream(self._container, self.path, self.stream)
        context = self._video.codec_context
        count = threads or self._threads or usable_cores() + FRAMES_AHEAD
        context.thread_type = "AUTO" if count > 1 else "NONE"
        context.thread_count = count
        context.options = dict(STRICT)
        self._frames = self._held = None
        self._fresh = True

    def _rewind(self) -> None:
        """Before the first packet: a new container, since not every format seeks back to its very beginning."""
        if not self._fresh:
            reading = self._frames
            self._open_stream(threads=self._now_threads)
            self._frames = reading
        self._fresh = False

    def _find_cut(self) -> None:
        table = self._table
        if table.cut is None:
            return
        for packet in range(table.cut, len(table.pts)):
            self._bad[packet] = "the file is cut short"

    def _described(self) -> MovieInfo:
        """Tags of the stream and of the first frame that can be decoded."""
        table = self._table
        rate, gaps = rate_of(table, self._video, str(self.path))
        first: Any = None
        try:
            first = self._picture(0)
        except PlateError:
            if not self._video.codec_context.pix_fmt:
                raise
        context = self._video.codec_context  # only now: reading may have opened the file again
        first = context if first is None else first
        self._layout = picture_layout(self.path, first, context)
        bad = [frame for frame, packet in enumerate(table.shown) if int(packet) in self._bad]
        which = f"frame {self._name(bad[0])}" if len(bad) == 1 else f"{len(bad)} frames from frame {self._name(bad[0])} on" if bad else ""
        faults = [f"{which} cannot be read: {self._bad[int(table.shown[bad[0]])]}"] if bad else []
        lost = frames_lost(table, self._container, self._video, rate)
        if lost:
            faults.append(f"the file is cut short: {lost} {'frames' if lost > 1 else 'frame'} missing after frame {self._name(len(table.shown) - 1)}")
        return described(
            self.path,
            self.stream,
            self._container,
            self._video,
            first,
            matrix=self._options["matrix"],
            levels=self._options["levels"],
            rate=rate,
            frames=len(table.shown),
            gaps=gaps,
            fault="; ".join(faults),
        )

    # Decoding

    def _packets_from(self, key: int) -> Iterator[tuple[int, Any]]:
        """(place in the table, packet) from packet `key` on, seeking there; what is shown before it but decoded after is left out."""
        import av

        table = self._table
        for whole in (False, True):
            if whole or key == 0:
                self._rewind()
            else:
                self._container.seek(int(table.dts[key]), stream=self._video, backward=True)
                self._fresh = False
            begun = False
            for packet in self._container.demux(self._video):
                if packet.size == 0:
                    continue
                if not begun:
                    if packet.pts == int(table.pts[key]):
                        begun = True
                    elif packet.dts is not None and packet.dts > int(table.dts[key]):
                        break  # the seek went too far: read from the beginning
                    else:
                        continue
                # Matroska makes up decoding times anew after a seek, so the presentation time alone tells which packet it is.
                at = self._place.get(packet.pts, -1)
                if at >= 0 and (key == 0 or packet.pts >= int(table.pts[key])):
                    yield at, packet
            if begun or whole or key == 0:
                return
        raise av.error.EOFError(0, "no key frame")

    def _decoded(self, key: int, end: int | None = None) -> Iterator[tuple[int, Any]]:
        """(presentation time, picture) in the order of showing, decoded from packet `key` on and before packet `end`."""
        for at, packet in self._packets_from(key):
            if end is not None and at >= end:
                break
            if at in self._bad:
                continue
            if self._summed and not is_sound(packet):
                self._mark(at, "its data do not fit their checksum")
                continue
            for picture in self._video.codec_context.decode(packet):
                yield picture.pts, picture
        for picture in self._video.codec_context.decode(None):
            yield picture.pts, picture

    def _mark(self, packet: int, why: str) -> None:
        """Note that a packet is damaged, and with it what leans on it."""
        key = int(np.flatnonzero(self._table.key[: packet + 1])[-1])
        for at in packets_spoilt(self._table, packet, key):
            self._bad.setdefault(at, why)

    _now_threads: int | None = None

    def _look_for_damage(self, key: int) -> bool:
        """Decode one group of frames packet by packet and note the damage in `_bad`; whether any was found."""
        table, end = self._table, self._table.next_key(key)
        self._now_threads = 1
        try:
            self._open_stream(threads=1)
            packets = itertools.takewhile(lambda item: item[0] < end and item[0] not in self._bad, self._packets_from(key))
            # The decoder is looked up anew each time, since reading from the beginning opens the file again.
            fault = first_damage(table, packets, lambda packet: self._video.codec_context.decode(packet), key)
            for at in packets_spoilt(table, fault[0], key) if fault else ():
                self._bad.setdefault(at, fault[1] if fault else "")
            return fault is not None
        finally:
            self._now_threads = None
            self._open_stream()

    def _name(self, index: int) -> int:
        """What frame `index` is called in messages."""
        return index + self._first

    def _refused(self, index: int) -> PlateError:
        table = self._table
        good = 0
        while good < len(table.shown) and int(table.shown[good]) not in self._bad:
            good += 1
        first, last = self._name(0), self._name(good - 1)
        rest = (
            "no frame before it is good"
            if not good
            else f"frame {first} before it is good"
            if good == 1
            else f"frames {first}-{last} before it are good"
        )
        why = self._bad[int(table.shown[index])]
        return PlateError(f"{self.path}: frame {self._name(index)} cannot be read: {why}; {rest}; copy or export the movie again")

    def _picture(self, index: int) -> Any:
        """The decoder's picture of frame `index`."""
        import av

        table = self._table
        if self._held is not None and self._held[0] == index:
            return self._held[1]
        wanted = int(table.pts[table.shown[index]])
        key = table.key_before(index)
        for _ in range(len(table.pts) + 1):  # each further turn has marked more damage
            if int(table.shown[index]) in self._bad:
                raise self._refused(index)
            if self._frames is None or index < self._next or table.pts[key] > table.pts[table.shown[min(self._next, len(table.shown) - 1)]]:
                self._frames, self._next = self._decoded(key), int(np.searchsorted(table.pts[table.shown], table.pts[key]))
            try:
                for pts, picture in self._frames:
                    if pts is None or pts < wanted:
                        if picture.is_corrupt:
                            break
                        self._next = int(np.searchsorted(table.pts[table.shown], pts, side="right")) if pts is not None else self._next
                        continue
                    if pts == wanted and not picture.is_corrupt:
                        self._next, self._held = index + 1, (index, picture)
                        return picture
                    break
            except av.error.FFmpegError:
                pass
            self._frames = None
            if int(table.shown[index]) not in self._bad and not self._damage_up_to(index):
                # Sound data, yet no picture from this key frame: a later recovery point was taken for one. Begin earlier.
                if key == 0:
                    self._bad[int(table.shown[index])] = "the decoder gives no picture for it"
                else:
                    key = max((int(k) for k in np.flatnonzero(table.key[:key])), default=0)
        raise self._refused(index)

    def _damage_up_to(self, index: int) -> bool:
        """Look for damage from the group where reading stood to that of frame `index`."""
        table = self._table
        first = table.key_before(min(self._next, index))
        last = table.key_before(index)
        found = False
        for key in [int(k) for k in np.flatnonzero(table.key[: last + 1]) if k >= first] or [first]:
            found = self._look_for_damage(key) or found
        return found

    def read(self, index: int, transfer: Transfer | None = None, *, out: Float32 | None = None) -> Float32:
        """Frame `index`, from 0, as (H, W, 3) float32: encoded R'G'B' with 0 black and 1 white, or what `transfer` makes of it.

        transfer : a curve and matrix applied in the same pass, such as `footage.colour.transfer_table` gives.
        out      : filled and returned in place of a new array.
        Raises   : PlateError for a frame that is not there or is damaged, saying which frames are good."""
        with self._lock:
            info = self._opened()
            if not 0 <= index < info.frames:
                there = f"frames {self._name(0)}-{self._name(info.frames - 1)}"
                raise PlateError(f"{self.path}: has no frame {self._name(index)}; it has {there}{info.fault and f' ({info.fault})'}")
            return self._converted(info, index, transfer, out)

    def _converted(self, info: MovieInfo, index: int, transfer: Transfer | None, out: Float32 | None) -> Float32:
        picture = self._picture(index)
        if (picture.width, picture.height) != info.size or picture.format.name != info.pixel_format:
            came = f"{picture.width} x {picture.height} {picture.format.name}"
            first = f"{info.size[0]} x {info.size[1]} {info.pixel_format}"
            raise PlateError(f"{self.path}: frame {self._name(index)} is {came}, the first is {first}; split the movie there")
        return rgb_from_planes(
            planes_of(picture, self._layout),
            bits=info.bits,
            full_range=info.full_range,
            matrix=info.matrix,
            transfer=transfer,
            siting=self._options["siting"],
            out=out,
        )
