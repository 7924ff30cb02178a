"""What the dialects of rig files share: numbers out of tables, lenses by OpenCV's coefficients, rotations as vectors.

Frames: camera frames (x right, y down, z forward), as in every dialect here.  Pixels: (0, 0) is the centre of the top-left pixel.
Errors: RigError; the reader of the file puts its name before it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.camera import Camera, LensModel, Rig
from stereorelight.errors import RigError

BELIEVED_M = (0.001, 10.0)  # baselines that a rig for pictures has; beyond them the unit is not the metre


def table_of(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise RigError(f"{where} must be a table of keys, got {type(value).__name__}")
    return value


def required(table: Mapping[str, Any], key: str, where: str) -> Any:
    if table.get(key) is None:
        raise RigError(f"{where}: key {key!r} is missing; is the file whole?")
    return table[key]


def numbers(value: Any, where: str, count: int | tuple[int, ...] | None = None) -> list[float]:
    """`value` as a flat list of finite floats, nested lists and texts of numbers included.  Raises RigError."""
    try:
        flat = [float(x) for x in np.ravel(np.asarray([] if value is None or (isinstance(value, str) and not value) else value, dtype=object))]
    except (TypeError, ValueError, OverflowError):
        raise RigError(f"{where} must be numbers, got {str(value)[:60]!r}") from None
    if not all(math.isfinite(x) for x in flat):
        raise RigError(f"{where} holds a value that is not finite")
    wanted = (count,) if isinstance(count, int) else count
    if wanted is not None and len(flat) not in wanted:
        raise RigError(f"{where} must be {' or '.join(str(n) for n in wanted)} numbers, got {len(flat)}")
    return flat


def whole(value: Any, where: str) -> int:
    (x,) = numbers([value], where, 1)
    if x != int(x) or x < 1:
        raise RigError(f"{where} must be a whole number of pixels, got {value!r}")
    return int(x)


def intrinsic(fx: float, fy: float, cx: float, cy: float) -> Float64:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)


def opencv_lens(coefficients: Sequence[float], where: str) -> tuple[LensModel, tuple[float, ...]]:
    """Model and parameters of OpenCV's 0, 4, 5, 8, 12 or 14 coefficients; thin prism and tilted sensor must be zero."""
    c = tuple(float(x) for x in coefficients)
    if len(c) not in (0, 4, 5, 8, 12, 14):
        raise RigError(f"{where}: OpenCV knows 4, 5, 8, 12 or 14 distortion coefficients, got {len(c)}")
    if any(c[8:]):
        what = "tilted sensor" if any(c[12:]) else "thin prism"
        raise RigError(f"{where}: the {what} terms cannot be said in a rig; calibrate without them, with 8 coefficients at most")
    if len(c) > 5 and not any(c[5:]):
        return "brown", c[:5]
    return ("rational", c[:8]) if len(c) > 5 else ("brown", c)


def opencv_coefficients(camera: Camera, counts: Sequence[int], dialect: str, remedy: str) -> list[float]:
    """The first `counts` of OpenCV's coefficients that say the lens exactly.  Raises RigError where none does."""
    refuse = RigError(f"{dialect} cannot say a {camera.model} lens with parameters {list(camera.distortion)}; {remedy}")
    if camera.model == "fisheye":
        raise refuse
    c = list(camera.distortion)
    for n in counts:
        if n >= len(c) or not any(c[n:]):
            return (c + [0.0] * n)[:n]
    raise refuse


def fisheye_coefficients(camera: Camera) -> list[float]:
    return list(camera.distortion or (0.0,) * 4)


def rotation_from_vector(r: Sequence[float]) -> Float64:
    """(3, 3) rotation by |r| radians about r (Rodrigues)."""
    v = np.asarray(r, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle == 0:
        return np.eye(3)
    x, y, z = v
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    half = angle / 2
    # sin(a)/a and (1 - cos(a))/a^2 without loss at small angles
    return np.eye(3) + math.sin(angle) / angle * cross + 0.5 * (math.sin(half) / half) ** 2 * (cross @ cross)


def vector_from_rotation(R: Float64) -> Float64:
    """The inverse of `rotation_from_vector`, through the quaternion's largest part, so that half turns stay exact."""
    d = np.diag(R)
    four = 1 + np.array([d.sum(), d[0] - d[1] - d[2], d[1] - d[0] - d[2], d[2] - d[0] - d[1]])
    i = int(np.argmax(four))
    anti = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if i == 0:
        w, xyz = four[0], anti
    else:
        xyz = R[:, i - 1] + R[i - 1]
        xyz[i - 1] = four[i]
        w = anti[i - 1]
    length = float(np.linalg.norm(xyz))
    if length == 0:
        return np.zeros(3)
    angle = 2 * math.atan2(length, w)
    out: Float64 = xyz / length * (angle - 2 * math.pi if angle > math.pi else angle)
    return out


def rig_of(left: Camera, right: Camera, R: Any, t: Any, *, unit_m: float | None, any_order: bool = False) -> Rig:
    """The rig of two cameras and x_right = R x_left + t in the file's unit.

    unit_m    : metres in one unit of the file; None takes metres, where the baseline can be believed.
    any_order : the file does not say which eye is which: the one that stands to the left is the left one.
    """
    R, t = np.array(numbers(R, "rotation", 9)).reshape(3, 3), np.array(numbers(t, "translation", 3))
    length = float(np.linalg.norm(t))
    if unit_m is None and length > 0 and not BELIEVED_M[0] <= length <= BELIEVED_M[1]:
        raise RigError(
            f"the eyes stand {length:g} apart, which cannot be metres; say what one unit of the file is, export --unit: "
            "0.001 for millimetres, or the size of the board's square"
        )
    if unit_m is not None and not (math.isfinite(unit_m) and unit_m > 0):
        raise RigError(f"the unit of the file must be > 0 metres, got {unit_m}")
    t = t * (1.0 if unit_m is None else unit_m)
    if any_order and (-R.T @ t)[0] < 0:
        return Rig(left=right, right=left, R_right_left=R.T, t_right_left_m=-R.T @ t)
    return Rig(left=left, right=right, R_right_left=R, t_right_left_m=t)
