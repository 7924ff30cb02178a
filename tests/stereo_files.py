"""Stereo pairs of known pictures, in every way in which a shot comes: what is read must be what was put in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from stereorelight.footage.exr import ExrPart, write_exr_parts
from stereorelight.footage.movie.writer import MovieWriter
from tests.movie_files import fill

W, H, FRAMES = 64, 48, 5
RATE = Fraction(24)


def picture(eye: str, frame: int = 0, *, size: tuple[int, int] = (W, H)) -> np.ndarray:
    """(H, W, 3) float32 encoded 0..1, smooth, another one for each eye and frame; functions of the picture's edges, not of pixels."""
    w, h = size
    x, y = (np.arange(w) + 0.5)[None] / w, (np.arange(h) + 0.5)[:, None] / h
    turn = (2.0 if eye == "left" else 3.5) + 0.4 * frame
    red = 0.5 + 0.35 * np.sin(turn + 3.0 * x + 1.5 * y)
    green = 0.5 + 0.3 * np.cos(turn + 2.0 * x - 2.5 * y)
    blue = 0.45 + 0.3 * np.sin(1.3 * turn - 2.5 * x + y)
    return np.ascontiguousarray(np.stack([red, green, blue], axis=-1), dtype=np.float32)


def pictures(eye: str, count: int = FRAMES, *, size: tuple[int, int] = (W, H), first: int = 0) -> list[np.ndarray]:
    return [picture(eye, first + k, size=size) for k in range(count)]


def movie(path: Path, frames: Sequence[np.ndarray], *, codec: str = "ffv1", rate: Fraction = RATE, timecode: str | None = None) -> Path:
    size = (frames[0].shape[1], frames[0].shape[0])
    with MovieWriter(path, size=size, rate=rate, codec=codec, timecode=timecode) as made:
        for frame in frames:
            made.write(frame)
    return path


def beside(left: Sequence[np.ndarray], right: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.concatenate([a, b], axis=1) for a, b in zip(left, right, strict=True)]


def above(left: Sequence[np.ndarray], right: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.concatenate([a, b], axis=0) for a, b in zip(left, right, strict=True)]


def rgb_movie(
    path: Path, tracks: Sequence[Sequence[np.ndarray]], *, words: Mapping[str, str] | None = None, bits: int = 16, rate: Fraction = RATE
) -> Path:
    """FFV1 of R'G'B' planes without loss, by PyAV alone, with as many video tracks as asked; `words` go to the tracks."""
    h, w = tracks[0][0].shape[:2]
    name = f"gbrp{bits}le"
    with av.open(str(path), "w") as container:
        streams: list[Any] = []
        for _ in tracks:
            stream = container.add_stream("ffv1", rate=rate)
            stream.width, stream.height, stream.pix_fmt = w, h, name
            stream.metadata.update(words or {})
            streams.append(stream)
        for number in range(len(tracks[0])):
            for stream, frames in zip(streams, tracks, strict=True):
                frame = av.VideoFrame(w, h, name)
                coded = np.rint(np.asarray(frames[number], np.float64) * (2**bits - 1)).astype(np.uint16)
                fill(frame, [np.ascontiguousarray(coded[..., k]) for k in (1, 2, 0)])
                frame.pts, frame.time_base = number, 1 / rate
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode(None))
    return path


def exr(path: Path, eyes: Mapping[str, np.ndarray], *, metadata: Mapping[str, str] | None = None) -> Path:
    """A multi-view EXR of linear pictures, a part an eye."""
    parts = []
    for eye, plate in eyes.items():
        channels = {c: np.ascontiguousarray(plate[..., k]) for k, c in enumerate("RGB")}
        parts.append(ExrPart(channels=channels, name=eye, view=eye, header=dict(metadata or {})))
    return write_exr_parts(path, parts)


def cut(path: Path, share: float) -> Path:
    """Cut a file short."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path
