"""A movie file opened, and the video stream in it that is asked for.

In: a path.  Out: PyAV's container and stream.  A cover picture is no video stream here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stereorelight.errors import PlateError
from stereorelight.footage.source import check_file


def opened(path: Path) -> Any:
    """The container.  Raises PlateError where it is no movie."""
    check_file(path)
    import av

    av.logging.set_level(None)
    av.logging.set_libav_level(av.logging.PANIC)
    try:
        return av.open(str(path), "r", metadata_errors="replace")
    except (av.error.FFmpegError, ValueError, OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise PlateError(f"{path}: is no movie that can be read ({reason.lower()}); it may be cut short: copy or export it again") from None


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
