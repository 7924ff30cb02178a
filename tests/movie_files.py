"""Movies for tests, written from planes with PyAV alone, so that reading is not judged by our own writer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

# codec, pixel format, options: without loss where the codec can.
LOSSLESS: dict[str, tuple[str, str, dict[str, str]]] = {
    "h264-8": ("libx264", "yuv420p", {"qp": "0", "bf": "2", "g": "12"}),
    "h264-10": ("libx264", "yuv420p10le", {"qp": "0", "bf": "2", "g": "12"}),
    "h264-422-10": ("libx264", "yuv422p10le", {"qp": "0"}),
    "h265-8": ("libx265", "yuv420p", {"x265-params": "lossless=1:log-level=none:keyint=12:pools=none:frame-threads=1"}),
    "h265-10": ("libx265", "yuv420p10le", {"x265-params": "lossless=1:log-level=none:keyint=12:pools=none:frame-threads=1"}),
    "h265-444-12": ("libx265", "yuv444p12le", {"x265-params": "lossless=1:log-level=none:pools=none:frame-threads=1"}),
    "ffv1-8": ("ffv1", "yuv420p", {}),
    "ffv1-422-10": ("ffv1", "yuv422p10le", {}),
    "ffv1-444-12": ("ffv1", "yuv444p12le", {}),
    "ffv1-444-16": ("ffv1", "yuv444p16le", {}),
    "ffv1-rgb-8": ("ffv1", "bgr0", {}),
    "ffv1-rgb-10": ("ffv1", "gbrp10le", {}),
}
LOSSY: dict[str, tuple[str, str, dict[str, str]]] = {
    "prores422": ("prores_ks", "yuv422p10le", {"profile": "hq", "qscale": "1"}),
    "prores4444": ("prores_ks", "yuva444p10le", {"profile": "4444", "qscale": "1"}),
    "dnxhr-8": ("dnxhd", "yuv422p", {"profile": "dnxhr_hq"}),
    "dnxhr-10": ("dnxhd", "yuv422p10le", {"profile": "dnxhr_hqx"}),
    "dnxhr-444": ("dnxhd", "yuv444p10le", {"profile": "dnxhr_444"}),
}
SPC = {"bt709": 1, "bt601": 6, "bt2020": 9}


def fill(frame: Any, planes: Sequence[np.ndarray]) -> None:
    """Copy planes into a PyAV frame, packed ones already interleaved."""
    for plane, values in zip(frame.planes, planes):
        row = np.frombuffer(plane, values.dtype).reshape(-1, plane.line_size // values.itemsize)
        row[: values.shape[0], : values.shape[1]] = values
    if len(frame.planes) > len(planes):  # alpha: opaque
        alpha = frame.planes[len(planes)]
        np.frombuffer(alpha, np.uint16)[:] = 1023


def write_movie(
    path: Path,
    frames: Iterable[Sequence[np.ndarray]],
    size: tuple[int, int],
    kind: tuple[str, str, dict[str, str]] = LOSSLESS["h264-8"],
    *,
    rate: Fraction = Fraction(25),
    tags: tuple[str, bool] | None = None,
    timecode: str | None = None,
    steps: Sequence[int] | None = None,
    second: Iterable[Sequence[np.ndarray]] | None = None,
    options: dict[str, str] | None = None,
    container: str | None = None,
) -> Path:
    """A movie of planes as the pixel format has them.

    tags  : (matrix, full range), on the codec and on every frame; None leaves them out.
    steps : presentation times of the frames in frames; None for 0, 1, 2 ...
    second: frames of a second video track.         options, container : of the file; None for the container of its suffix.
    """
    codec, pixel_format, wishes = kind
    tracks = [frames] if second is None else [frames, second]
    with av.open(str(path), "w", format=container, options=options or {}) as file:
        made = []
        for _ in tracks:
            stream = file.add_stream(codec, rate=rate, options=dict(wishes))
            stream.width, stream.height, stream.pix_fmt = *size, pixel_format
            stream.codec_context.time_base = 1 / rate
            if tags:
                stream.codec_context.colorspace, stream.codec_context.color_range = SPC[tags[0]], 2 if tags[1] else 1
            if timecode:
                stream.metadata["timecode"] = timecode
            made.append(stream)
        for number, pictures in enumerate(zip(*tracks, strict=True)):
            for stream, planes in zip(made, pictures, strict=True):
                frame = av.VideoFrame(*size, pixel_format)
                fill(frame, planes)
                if tags:
                    frame.colorspace, frame.color_range = SPC[tags[0]], 2 if tags[1] else 1
                frame.pts, frame.time_base = (steps[number] if steps else number), 1 / rate
                for packet in stream.encode(frame):
                    file.mux(packet)
        for stream in made:
            for packet in stream.encode(None):
                file.mux(packet)
    return path
