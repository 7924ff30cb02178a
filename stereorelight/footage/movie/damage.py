"""The search for damage in one group of frames: decoded packet by packet, so that the first broken one is known.

In: the packets of a group, from a key packet on, and a decoder of one thread.  Out: which packets give no picture, and why."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from stereorelight.footage.movie.packets import PacketTable


def first_damage(table: PacketTable, packets: Iterable[tuple[int, Any]], decode: Callable[[Any], Iterable[Any]], key: int) -> tuple[int, str] | None:
    """(packet, reason) of the first damage among `packets`, or None where each gives a sound picture.

    packets : (place in the table, packet) from packet `key` on, in the order of decoding.
    decode  : pictures of a packet; of None, those that the decoder still holds.
    """
    import av

    place: dict[int, int] = {}  # of each presentation time sent to the decoder
    got: set[int] = set()
    last = key
    try:
        for at, packet in packets:
            last = at
            place[packet.pts] = at
            for picture in decode(packet):
                got.add(picture.pts)
                if picture.is_corrupt:
                    return place.get(picture.pts, at), "its data are damaged"
        for picture in decode(None):
            got.add(picture.pts)
            if picture.is_corrupt:
                return place.get(picture.pts, last), "its data are damaged"
    except av.error.FFmpegError as error:
        return last, f"its data are damaged ({(error.strerror or 'decoder error').lower()})"
    shown = set(table.shown.tolist())
    lost = [at for pts, at in place.items() if pts not in got and at in shown]
    return (min(lost), "the decoder gives no picture for it") if lost else None


def packets_spoilt(table: PacketTable, first: int, key: int) -> list[int]:
    """The packets whose pictures lean on packet `first` of the group that begins with packet `key`."""
    end = table.next_key(key)
    spoilt = list(range(first, end))
    if end < len(table.pts):  # what the next group shows before its key frame leans on this one
        spoilt += [at for at in range(end + 1, table.next_key(end)) if table.pts[at] < table.pts[end]]
    return spoilt
