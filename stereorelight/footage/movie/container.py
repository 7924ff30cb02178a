"""A movie file opened, and the video stream in it that is asked for.

In: a path.  Out: PyAV's container and stream.  A cover picture is no video stream here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stereorelight.errors import PlateError
from stereorelight.footage.source import check_file

MOST_BOXES = 1000  # at the top of a file; there are a handful


def opened(path: Path) -> Any:
    """The container.  Raises PlateError where it is no movie."""
    check_file(path)
    import av

    av.logging.set_level(None)
    av.logging.set_libav_level(av.logging.PANIC)
    try:
        return av.open(str(path), "r", metadata_errors="replace")
    except (av.error.FFmpegError, ValueError, OSError, UnicodeError) as error:
        if _lacks_index(path):
            cut = "its index (moov) is missing, so the recording or the copy was stopped before its end"
            raise PlateError(f"{path}: is no movie that can be read: {cut}; copy or export it again") from None
        reason = getattr(error, "strerror", None) or str(error)
        raise PlateError(f"{path}: is no movie that can be read ({reason.lower()}); it may be cut short: copy or export it again") from None


def _lacks_index(path: Path) -> bool:
    """Whether the file is QuickTime or MP4 whose boxes (ISO/IEC 14496-12, 4.2) end before a moov."""
    with path.open("rb") as file:
        size = path.stat().st_size
        kinds: list[bytes] = []
        at = 0
        while at + 8 <= size and len(kinds) < MOST_BOXES:
            file.seek(at)
            head = file.read(16)
            length, kind = int.from_bytes(head[:4], "big"), head[4:8]
            if length == 1:
                length = int.from_bytes(head[8:16], "big")
            kinds.append(kind)
            at = at + length if length >= 8 else size
    return kinds[:1] == [b"ftyp"] and b"mdat" in kinds and b"moov" not in kinds


def video_streams(container: Any) -> list[Any]:
    """Video streams that are movies: cover pictures are none."""
    from av.stream import Disposition

    return [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]


def chosen_stream(container: Any, path: Path, stream: int) -> Any:
    """Video stream `stream`, from 0.  Raises PlateError where there is none, saying which there are."""
    streams = video_streams(container)
    if not streams:
        kinds = ", ".join(sorted({s.type for s in container.streams})) or "none"
        raise PlateError(f"{path}: has no video stream (streams: {kinds}); give a movie with pictures")
    if not 0 <= stream < len(streams):
        there = ", ".join(f"{k} ({s.codec_context.name} {s.codec_context.width} x {s.codec_context.height})" for k, s in enumerate(streams))
        raise PlateError(f"{path}: has no video stream {stream}; there is {there}")
    return streams[stream]
