"""Half-size pictures and their rig, and half-size answers at full size.

In: a `Proxy`, a plate, a rectified rig; a map (H, W).  Out: the same at half and at full size."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32
from stereorelight.camera import Camera, RectifiedRig
from stereorelight.stereo.proxy import Proxy


def half_proxy(proxy: Proxy) -> Proxy:
    """The pair at half size, each pixel the mean of four; known where all four are."""
    height, width = proxy.left_grey.shape
    size = (width // 2, height // 2)

    def small(a: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.ascontiguousarray(cv2.resize(a[: 2 * size[1], : 2 * size[0]], size, interpolation=cv2.INTER_AREA))

    def known(a: Bool) -> Bool:
        return np.ones(size[::-1], np.bool_) if a.all() else small(a.view(np.uint8) * 255) == 255

    return Proxy(
        left=small(proxy.left),
        right=small(proxy.right),
        left_grey=small(proxy.left_grey),
        right_grey=small(proxy.right_grey),
        left_known=known(proxy.left_known),
        right_known=known(proxy.right_known),
    )


def half_view(view: Float32) -> Float32:
    """A plate (H, W, 3) at half size, each pixel the mean of four; NaN or infinite where one of the four is."""
    height, width = view.shape[0] // 2, view.shape[1] // 2
    return cv2.resize(view[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)


@lru_cache(maxsize=16)
def half_rig(rig: RectifiedRig) -> RectifiedRig:
    """The rig whose plates `half_view` makes."""

    def small(camera: Camera) -> Camera:
        width, height = camera.size[0] // 2, camera.size[1] // 2
        return camera.cropped(0, 0, (2 * width, 2 * height)).scaled((width, height))

    return replace(rig, left=small(rig.left), right=small(rig.right))


def nearest(a: npt.NDArray[Any], size_hw: tuple[int, int]) -> npt.NDArray[Any]:
    """A half-size map at full size, by the pixel that it was."""
    return cv2.resize(a, size_hw[::-1], interpolation=cv2.INTER_NEAREST)
