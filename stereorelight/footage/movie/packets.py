"""The table of a movie's packets: which frames there are, in the order in which they are shown, and from where each is decoded.

In: an open PyAV container and a video stream.  Out: a `PacketTable`.  A container's own count of frames is never believed.
Times are presentation times (pts) in the stream's time base.

Where every packet is a key frame and the container has an index (ProRes, DNx, FFV1 in .mov and .mxf), the index is taken and nothing
is read; elsewhere the packets are read once, undecoded, since an index knows the order of decoding alone.  Packets that an edit list
throws away are no frames, and neither are those shown before the first key frame, which nothing can decode."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.errors import PlateError

DURATION = re.compile(r"(\d+):(\d+):(\d+(?:\.\d+)?)")  # Matroska's word for where a track ends
# A container's clock may be as coarse as a millisecond (Matroska), or jitter by a few parts of a hundred (telephones).
JITTER = 0.05  # of a frame's duration, or two ticks of the clock if that is more
SAME_RATE = 1e-6  # relative; 24 and 24000/1001 are a thousand times further apart
MOST_UNEVEN = 0.05  # share of frames with another duration from which on the rate is variable rather than frames dropped


@dataclass(frozen=True, kw_only=True, eq=False)
class PacketTable:
    """Packets in the order of decoding, frames in the order of showing.

    pts, dts : of each packet; dts may repeat where the container has none.
    key      : whether decoding can begin with the packet.
    shown    : packet of each frame, sorted by presentation time.
    cut      : the first packet, in decoding order, that the file does not hold whole; None for a whole file.
    """

    pts: npt.NDArray[np.int64]
    dts: npt.NDArray[np.int64]
    key: npt.NDArray[np.bool_]
    shown: npt.NDArray[np.int64]
    cut: int | None = None

    def key_before(self, frame: int) -> int:
        """The packet from which frame `frame` is decoded: the last key packet decoded before it and shown no later."""
        packet = int(self.shown[frame])
        keys = np.flatnonzero(self.key[: packet + 1])
        keys = keys[self.pts[keys] <= self.pts[packet]]
        return int(keys[-1]) if len(keys) else 0

    def next_key(self, packet: int) -> int:
        """The first key packet after `packet`, or the number of packets."""
        later = np.flatnonzero(self.key[packet + 1 :])
        return packet + 1 + int(later[0]) if len(later) else len(self.key)


def _from_index(container: Any, stream: Any, file_bytes: int) -> list[tuple[int, int, bool, bool, bool]] | None:
    """(pts, dts, key, hidden, cut) of each packet by the container's index; None where the index cannot say."""
    if not {"mov", "mxf"} & set(container.format.name.split(",")):
        return None
    entries = list(stream.index_entries)
    if not entries or not all(entry.is_keyframe for entry in entries) or stream.codec_context.name in ("h264", "hevc"):
        return None
    if len({entry.pos for entry in entries}) != len(entries) or any(entry.size <= 0 for entry in entries):
        return None
    return [(e.timestamp, e.timestamp, True, e.is_discard, e.pos + e.size > file_bytes) for e in entries]


def _by_reading(container: Any, stream: Any, name: str) -> list[tuple[int, int, bool, bool, bool]]:
    import av

    found: list[tuple[int, int, bool, bool, bool]] = []
    try:
        for packet in container.demux(stream):
            if packet.size == 0:  # what ends the stream
                continue
            pts, dts = packet.pts, packet.dts
            if pts is None:
                raise PlateError(f"{name}: packet {len(found)} has no presentation time; rewrap the movie as .mov or .mkv")
            found.append((pts, pts if dts is None else dts, packet.is_keyframe, packet.is_discard, packet.is_corrupt))
    except av.error.FFmpegError:
        found.append((found[-1][0] + 1 if found else 0, found[-1][1] + 1 if found else 0, False, True, True))
    return found


def packet_table(container: Any, stream: Any, name: str, file_bytes: int) -> PacketTable:
    """The table of `stream`.  Raises PlateError for a stream without frames or without presentation times."""
    rows = _from_index(container, stream, file_bytes) or _by_reading(container, stream, name)
    if not any(not hidden for _, _, _, hidden, _ in rows):
        raise PlateError(f"{name}: has a video stream but not one frame in it; copy or export it again")
    pts, dts = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
    key, hidden, broken = (np.array([row[k] for row in rows], np.bool_) for k in (2, 3, 4))
    keys = np.flatnonzero(key)
    if len(keys):
        hidden = hidden | (np.arange(len(pts)) < keys[0]) | (pts < pts[keys[0]])
    visible = np.flatnonzero(~hidden)
    if not len(visible):
        raise PlateError(f"{name}: has no frame that can be decoded: no key frame; copy or export it again")
    shown = visible[np.argsort(pts[visible], kind="stable")]
    twice = np.flatnonzero(np.diff(pts[shown]) <= 0)
    if len(twice):
        raise PlateError(f"{name}: frames {twice[0]} and {twice[0] + 1} have one presentation time; rewrap or export the movie again")
    cut = np.flatnonzero(broken)
    return PacketTable(pts=pts, dts=dts, key=key, shown=shown, cut=int(cut[0]) if len(cut) else None)


def standard_rate(rate: Fraction) -> Fraction:
    """The whole or NTSC rate that `rate` stands for: Matroska's reader has no room for 60000/1001 and says 19001/317."""
    for exact in (Fraction(round(rate)), Fraction(round(rate * Fraction(1001, 1000)) * 1000, 1001)):
        if exact and abs(rate / exact - 1) < SAME_RATE:
            return exact
    return rate


def rate_of(table: PacketTable, stream: Any, name: str) -> tuple[Fraction, tuple[int, ...]]:
    """Frames a second, and the frames after which time goes on unevenly (frames dropped by the camera).

    The stated rate is taken where the frames keep it, else the rate of their commonest step.
    Raises : PlateError where more than a twentieth of the steps differ: a variable rate cannot be paired with another camera.
    """
    tick = Fraction(stream.time_base)
    steps = np.diff(table.pts[table.shown])
    stated = [standard_rate(Fraction(rate)) for rate in (stream.average_rate, stream.base_rate, stream.guessed_rate) if rate]
    if not len(steps):
        return (stated[0] if stated else Fraction(24)), ()
    values, counts = np.unique(steps, return_counts=True)
    fallback = Fraction(1) / (int(values[np.argmax(counts)]) * tick)
    best: tuple[int, Fraction, npt.NDArray[np.int64]] | None = None
    for rate in [*stated, fallback]:
        expected = float(1 / (rate * tick))
        whole = abs(expected - round(expected)) < 1e-3
        # Times rounded to ticks make a step the tick below or above; on a coarse clock more than that is a frame dropped.
        ticks = 1.001 if expected > 20 else 0.501 if whole else 0.999
        odd = np.flatnonzero(np.abs(steps - expected) > max(ticks, JITTER * expected))
        if best is None or len(odd) < best[0]:
            best = (len(odd), rate, odd)
    assert best is not None  # the loop above ran at least once
    count, rate, odd = best
    if count > max(1, MOST_UNEVEN * len(steps)):
        first = int(odd[0])
        seconds = float(steps[first] * tick)
        raise PlateError(
            f"{name}: has a variable frame rate: {count} of {len(steps)} frames do not last 1/{rate} s, first frame {first} with {seconds:.4f} s; "
            "conform it to a constant rate first (ffmpeg -fps_mode cfr), and check that the eyes stay together"
        )
    return rate, tuple(int(k) for k in odd)


def frames_lost(table: PacketTable, container: Any, stream: Any, rate: Fraction) -> int:
    """How many frames at the end the container tells of and the file does not hold; 0 where it does not tell."""
    kinds = set(container.format.name.split(","))
    if "mov" in kinds:
        return max(0, int(stream.frames) - len(table.pts))
    if "matroska" not in kinds:
        return 0
    told = next((DURATION.fullmatch(str(v)) for k, v in stream.metadata.items() if k.upper() == "DURATION"), None)
    if told is None:
        return 0
    seconds = int(told[1]) * 3600 + int(told[2]) * 60 + Fraction(told[3])
    last = int(table.pts[table.shown[-1]]) * Fraction(stream.time_base)
    lost = round((seconds - last) * rate) - 1
    return lost if lost > 0 else 0
