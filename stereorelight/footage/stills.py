"""PNG, TIFF and JPEG pictures, 8 and 16 bit and float TIFF, to arrays and back.

In, out: RGB (H, W, 3) in the file's own encoding, 0..1 for whole-number files; footage/colour.py makes it scene-linear.
OpenCV's BGR order ends here.  A file that is cut short is refused, never half shown: its end marks and checksums are read."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.errors import OutputError, PassError, PlateError
from stereorelight.files import refuse_overwrite, write_whole
from stereorelight.footage.source import check_file, quiet

PNG, JPEG, TIFF = (b"\x89PNG\r\n\x1a\n",), (b"\xff\xd8\xff",), (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
SUFFIXES = {".png": (8, 16), ".tif": (8, 16), ".tiff": (8, 16), ".jpg": (8,), ".jpeg": (8,)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Still:
    """A picture as its file has it.

    rgb   : (H, W, 3) float32; v / 255 or v / 65535 of whole-number files, the values themselves of float ones.
    bits  : 8 or 16, or 32 for float files.
    alpha : (H, W) float32, or None; never multiplied into rgb.
    """

    rgb: Float32
    bits: int
    alpha: Float32 | None = None

    @property
    def is_float(self) -> bool:
        return self.bits == 32


def _png_is_whole(data: bytes) -> bool:
    """Walk the chunks: every length fits, every checksum holds, IEND is there."""
    at = len(PNG[0])
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 12 + length
        if end > len(data) or zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end
    return False


def _tiff_is_whole(data: bytes) -> bool:
    """Whether every strip or tile of the first directory lies inside the file; classic TIFF, others are left to the decoder."""
    order: Any = "little" if data[:2] == b"II" else "big"

    def number(at: int, size: int) -> int:
        return int.from_bytes(data[at : at + size], order)

    if number(2, 2) != 42:
        return True
    at = number(4, 4)
    if at + 2 > len(data):
        return False
    found: dict[int, list[int]] = {}
    for i in range(number(at, 2)):
        entry = at + 2 + 12 * i
        if entry + 12 > len(data):
            return False
        tag, size, count = number(entry, 2), {3: 2, 4: 4}.get(number(entry + 2, 2), 0), number(entry + 4, 4)
        if tag in (273, 279, 324, 325) and size:  # strip and tile offsets and byte counts
            start = entry + 8 if size * count <= 4 else number(entry + 8, 4)
            if start + size * count > len(data):
                return False
            found[tag] = [number(start + size * k, size) for k in range(count)]
    offsets, counts = found.get(273) or found.get(324) or [], found.get(279) or found.get(325) or []
    return all(offset + count <= len(data) for offset, count in zip(offsets, counts))


def _is_whole(data: bytes) -> bool:
    if data.startswith(PNG):
        return _png_is_whole(data)
    if data.startswith(JPEG):
        return b"\xff\xd9" in data[-65536:]
    return _tiff_is_whole(data)


def read_still(path: str | Path) -> Still:
    """A PNG, TIFF or JPEG as RGB; gray is repeated, alpha is kept apart, camera rotation tags are not applied.

    Raises: PlateError when the file is missing, of another kind, truncated or damaged.
    """
    import cv2

    path = Path(path)
    check_file(path)
    data = path.read_bytes()
    if not data.startswith(PNG + JPEG + TIFF):
        raise PlateError(f"{path}: is not a PNG, TIFF, JPEG or EXR picture; export it as one of these")
    damaged = PlateError(f"{path}: truncated or damaged picture; copy or export it again")
    if not _is_whole(data):
        raise damaged
    with quiet():
        try:
            raw = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            raw = None
    if raw is None:
        raise damaged
    a = np.asarray(raw)
    if a.dtype == np.uint8:
        values, bits = a.astype(np.float32) / np.float32(255), 8
    elif a.dtype == np.uint16:
        values, bits = a.astype(np.float32) / np.float32(65535), 16
    elif np.issubdtype(a.dtype, np.floating):
        values, bits = a.astype(np.float32), 32
    else:
        raise PlateError(f"{path}: has {a.dtype} pixels; export it with 8 or 16 bit, or as float")
    if values.ndim == 2:
        values = values[..., None]
    alpha = np.ascontiguousarray(values[..., -1]) if values.shape[2] in (2, 4) else None
    rgb = values[..., 2::-1] if values.shape[2] >= 3 else values[..., :1].repeat(3, axis=2)
    return Still(rgb=np.ascontiguousarray(rgb), bits=bits, alpha=alpha)


def write_still(path: str | Path, encoded: npt.ArrayLike, *, bits: int = 8, force: bool = False) -> Path:
    """Write RGB (H, W, 3) or gray (H, W) as PNG, TIFF or JPEG by the path's suffix.

    encoded : uint8, or uint16 for 16 bits, as they are; or encoded floats, 0..1, clipped and rounded to `bits`.
    Raises  : PassError for anything else or for NaN; OutputError when the file exists or cannot be written.
    """
    import cv2

    path = Path(path)
    refuse_overwrite(path, force=force)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise OutputError(f"{path}: pictures are written as .png, .tif or .jpg, not {suffix or 'without a suffix'}")
    if bits not in SUFFIXES[suffix]:
        wanted = " or ".join(map(str, SUFFIXES[suffix]))
        raise OutputError(f"{path}: {suffix} holds {wanted} bits a channel here, not {bits}; use .png or .tif for 16")
    a = np.asarray(encoded)
    whole = np.uint8 if bits == 8 else np.uint16
    if a.ndim not in (2, 3) or 0 in a.shape or (a.ndim == 3 and a.shape[2] != 3):
        raise PassError(f"a picture must have shape (H, W, 3) or (H, W), got {a.shape}")
    if np.issubdtype(a.dtype, np.floating):
        if np.isnan(a).any():
            raise PassError(f"a picture to be written has {int(np.isnan(a).sum())} NaN values; paint them with footage.preview first")
        a = np.rint(np.clip(a.astype(np.float64), 0, 1) * np.iinfo(whole).max).astype(whole)
    elif a.dtype != whole:
        raise PassError(f"a {bits} bit picture must be {np.dtype(whole)} or floats in 0..1, got {a.dtype}")
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if suffix in (".jpg", ".jpeg") else []
    done, coded = cv2.imencode(suffix, np.ascontiguousarray(a[..., ::-1] if a.ndim == 3 else a), options)
    if not done:
        raise OutputError(f"{path}: OpenCV cannot encode this picture as {suffix}")
    return write_whole(path, lambda temporary: _put_bytes(temporary, coded.tobytes()), force=force)


def png_bytes(picture: npt.NDArray[np.uint8]) -> bytes:
    """RGB (H, W, 3) or gray (H, W) uint8 as a PNG in memory, for pages that carry their pictures."""
    import cv2

    done, coded = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1] if picture.ndim == 3 else picture))
    if not done:
        raise OutputError("OpenCV cannot encode this picture as PNG")
    return bytes(coded.tobytes())


def _put_bytes(path: Path, data: bytes) -> None:
    path.write_bytes(data)
