"""PLY out: points and triangles, binary, as MeshLab, CloudCompare, Blender and Houdini read them.

In: arrays in the scene frame (x right, y up, the camera looks down -z), metres; colours display-coded 0..1.
Out: a file in the format "binary_little_endian 1.0" (Turk 1994): x y z, and where given nx ny nz, red green blue (bytes), confidence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from stereorelight.errors import OutputError
from stereorelight.files import write_whole


def write_ply(
    path: str | Path,
    points_m: npt.ArrayLike,
    *,
    normals: npt.ArrayLike | None = None,
    colours: npt.ArrayLike | None = None,
    confidence: npt.ArrayLike | None = None,
    triangles: npt.ArrayLike | None = None,
    comments: tuple[str, ...] = (),
    force: bool = False,
) -> Path:
    """Write points (n, 3), and triangles (m, 3) of their indices where there are any.

    normals : (n, 3).   colours : (n, 3), 0..1, as a display shows them.   confidence : (n,), 0..1.
    Raises  : OutputError for an array that does not fit, a value that is not finite, or a file that exists without `force`.
    """
    path = Path(path)
    points = np.asarray(points_m, dtype="<f4")
    if points.ndim != 2 or points.shape[1] != 3:
        raise OutputError(f"{path}: points must be (n, 3), got {points.shape}")
    n = len(points)
    fields: list[tuple[str, str]] = [(name, "<f4") for name in "xyz"]
    columns: list[npt.NDArray[np.generic]] = [*points.T]
    if normals is not None:
        fields += [(name, "<f4") for name in ("nx", "ny", "nz")]
        columns += [*_fitting(path, normals, "normals", (n, 3)).T]
    if colours is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
        codes = np.clip(np.nan_to_num(_fitting(path, colours, "colours", (n, 3), finite=False)), 0, 1)
        columns += [*np.rint(codes * 255).astype(np.uint8).T]
    if confidence is not None:
        fields.append(("confidence", "<f4"))
        columns.append(_fitting(path, confidence, "confidence", (n,)))
    if not np.isfinite(points).all():
        raise OutputError(f"{path}: a point is NaN or infinite; a cloud holds known points alone")
    vertices = np.empty(n, dtype=fields)
    for (name, _), column in zip(fields, columns, strict=True):
        vertices[name] = column
    kinds = {"<f4": "float", "u1": "uchar"}
    head = ["ply", "format binary_little_endian 1.0", *(f"comment {' '.join(line.split())}" for line in comments), f"element vertex {n}"]
    head += [f"property {kinds[kind]} {name}" for name, kind in fields]
    faces = np.empty(0, dtype=[("count", "u1"), ("corner", "<i4", 3)])
    if triangles is not None:
        corners = np.asarray(triangles)
        if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
            raise OutputError(f"{path}: triangles must be whole numbers (m, 3), got {corners.dtype} {corners.shape}")
        if corners.size and (corners.min() < 0 or corners.max() >= n):
            raise OutputError(f"{path}: a triangle names point {int(corners.max())}, but there are {n}")
        faces = np.empty(len(corners), dtype=faces.dtype)
        faces["count"], faces["corner"] = 3, corners
        head += [f"element face {len(corners)}", "property list uchar int vertex_indices"]
    head.append("end_header")

    text = ("\n".join(head) + "\n").encode("ascii", "replace")

    def write(whole: Path) -> None:
        with open(whole, "wb") as file:
            file.write(text)
            file.write(vertices.tobytes())
            file.write(faces.tobytes())

    return write_whole(path, write, force=force)


def _fitting(path: Path, values: npt.ArrayLike, name: str, shape: tuple[int, ...], *, finite: bool = True) -> npt.NDArray[np.generic]:
    array = np.asarray(values, dtype="<f4")
    if array.shape != shape:
        raise OutputError(f"{path}: {name} must be {shape}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        raise OutputError(f"{path}: {name} holds a value that is not finite")
    return array
