"""Files of results against files of truth: which passes to take, and which pixels the other eye cannot see."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from stereorelight.arrays import Bool
from stereorelight.camera import RectifiedRig, Rig
from stereorelight.compare.depth import DepthFigures, DisparityFigures, depth_figures, disparity_figures
from stereorelight.compare.normals import NormalFigures, normal_figures
from stereorelight.errors import PassError, StereoRelightError
from stereorelight.footage.frames import read_frame
from stereorelight.interchange.rigs import read_rig
from stereorelight.passes import Flag, Frame
from stereorelight.synth.rigs import rectified_rig

What = Literal["depth", "disparity", "normals"]
PASS: dict[What, str] = {"depth": "Z", "disparity": "disparity", "normals": "N"}


def rig_of_rectified(rig: RectifiedRig) -> Rig:
    """A rectified rig as the ordinary rig that it is: no rotation, the right eye along x."""
    return Rig(left=rig.left, right=rig.right, R_right_left=np.eye(3), t_right_left_m=np.array([-rig.baseline_m, 0.0, 0.0]))


def nonoccluded(truth: Frame) -> Bool | None:
    """(H, W) which pixels the other eye sees, or None where the truth does not say."""
    if "flags" not in truth:
        return None
    seen: Bool = (truth["flags"] & (Flag.OCCLUDED | Flag.OUT_OF_VIEW)) == 0
    return seen


def compared(
    result: str | Path, truth: str | Path, what: What, *, rig_path: str | Path | None = None
) -> DepthFigures | DisparityFigures | NormalFigures:
    """Figures of one pass of file `result` against file `truth`.

    rig_path : a rig whose plates are rectified as shot; adds pixels of disparity, and the normals of the disparity.
    Raises   : PlateError for files that cannot be read, PassError for passes that are not there or do not fit, RigError.
    """
    name = PASS[what]
    frames = [read_frame(path) for path in (result, truth)]
    for frame, path in zip(frames, (result, truth)):
        if name not in frame:
            raise PassError(f"{path}: has no pass {name!r}; there are: {', '.join(frame)}")
    found, true = frames
    rig = None if rig_path is None else rectified_rig(read_rig(rig_path))
    try:
        if what == "normals":
            return normal_figures(found["N"], true["N"], mask=nonoccluded(true))
        if what == "disparity":
            return disparity_figures(found["disparity"], true["disparity"], nonoccluded=nonoccluded(true), rig=rig)
        return depth_figures(found["Z"], true["Z"], nonoccluded=nonoccluded(true), rig=rig)
    except StereoRelightError as error:
        raise type(error)(f"{result} against {truth}: {error}") from None
