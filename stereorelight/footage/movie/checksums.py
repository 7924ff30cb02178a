"""FFV1's own checksums, one a slice: FFmpeg computes them, and where one does not fit paints the slice over with old pixels and says nothing.

In: the bytes of a packet.  Out: which of its slices are as they were written (RFC 9043, 4.9: three bytes of length, one of status,
and a CRC-32 over the slice that leaves 0 when it is itself taken in).  Versions 3 and later, with the checksums that encoders
write by default; a movie without them is not checked.  About 1 % of the decoder's own time."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterable
from typing import Any

FOOTER = 8  # bytes
FIRST_PACKETS = 4  # of which one whole slice tells that a movie carries checksums
# FFV1 takes bits from the top, zlib from the bottom: the same sum, of bytes turned end for end.
TURNED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
ALL_ONES = 0xFFFFFFFF  # what zlib turns over on the way in and out, which FFV1 does not


def slices_sound(data: bytes) -> tuple[bool, ...]:
    """Whether each slice of a packet fits its checksum, the last one first; empty where the packet is no chain of such slices."""
    found: list[bool] = []
    end = len(data)
    while end > 0:
        begin = end - FOOTER - int.from_bytes(data[end - FOOTER : end - FOOTER + 3], "big")
        if end < FOOTER or begin < 0:
            return ()
        found.append(zlib.crc32(data[begin:end].translate(TURNED), ALL_ONES) == ALL_ONES)
        end = begin
    return tuple(found)


def carries_checksums(packets: Iterable[Any]) -> bool:
    """Whether the movie that begins with `packets` is FFV1 with a checksum a slice."""
    return any(any(slices_sound(bytes(packet))) for packet in itertools.islice((p for p in packets if p.size), FIRST_PACKETS))


def is_sound(packet: Any) -> bool:
    """Whether a packet of a movie that carries checksums is as it was written."""
    sound = slices_sound(bytes(packet))
    return bool(sound) and all(sound)
