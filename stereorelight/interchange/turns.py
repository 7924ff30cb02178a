"""Rotations as three angles or a quaternion.

In, out: (3, 3) rotations for column vectors; degrees, right-handed.  An order such as "ZXY" is read as packages write it: the
first letter turns first, about the fixed axes, so that R = Ry Rx Rz."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.errors import RigError, nearest_hint

ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")


def checked_order(order: object) -> str:
    """`order` as three capitals.  Raises RigError with the nearest known one."""
    word = str(order).upper()
    if word not in ORDERS:
        raise RigError(f"rotation order {order!r} is unknown{nearest_hint(word, ORDERS)}")
    return word


def _about(axis: str, degrees: float) -> Float64:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = np.eye(3)
    i, j = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = -s, s
    return turn


def rotation_of(angles_deg: Sequence[float], order: str) -> Float64:
    """(3, 3) of angles (about x, about y, about z), turned in `order`."""
    R = np.eye(3)
    for axis in checked_order(order):
        R = _about(axis, angles_deg["XYZ".index(axis)]) @ R
    return R


def angles_of(R: Float64, order: str) -> tuple[float, float, float]:
    """(about x, about y, about z) in degrees: the inverse of `rotation_of`; where two axes fall together, the first turn is 0."""
    first, second, third = ("XYZ".index(axis) for axis in checked_order(order))
    sign = 1.0 if (second - first) % 3 == 1 else -1.0  # whether first, second, third is a cyclic order
    # R = third second first: its entry (third, first) is -sign sin(second).
    middle = math.asin(min(1.0, max(-1.0, -sign * float(R[third, first]))))
    found = [0.0, 0.0, 0.0]
    found[second] = middle
    if abs(math.cos(middle)) > 1e-9:
        found[first] = math.atan2(sign * R[third, second], R[third, third])
        found[third] = math.atan2(sign * R[second, first], R[first, first])
    else:
        found[third] = math.atan2(-sign * R[first, second], R[second, second])
    return math.degrees(found[0]), math.degrees(found[1]), math.degrees(found[2])


def rotation_of_quaternion(wxyz: Sequence[float]) -> Float64:
    """(3, 3) of a quaternion (w, x, y, z) of any length but 0.  Raises RigError."""
    length = math.sqrt(sum(v * v for v in wxyz))
    if length < 1e-9:
        raise RigError("a quaternion of zeros is no rotation; it is [w, x, y, z], [1, 0, 0, 0] for none")
    w, x, y, z = (v / length for v in wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
