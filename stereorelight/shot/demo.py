"""The demo: the real Motorcycle pair as a shot folder that a user can edit and run again, with its truth.

Layout: plates/left.png, plates/right.png, rig.json, shot.toml, truth/motorcycle.exr (disparity, Z, and flags that say which
pixels the right eye cannot see).  The pair comes with scikit-image; no network is asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.compare.depth import DisparityFigures, disparity_figures
from stereorelight.compare.motorcycle import TruePair, motorcycle
from stereorelight.errors import OutputError
from stereorelight.files import write_text
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Flag, Frame
from stereorelight.shot.judge import rig_of_rectified
from stereorelight.shot.schema import Shot
from stereorelight.shot.template import shot_text

NAME = "motorcycle"
# Chosen by eye on the P pass: the engine is at (0.3, -0.2, -2.4), the floor at y = -0.5, the shelves 4 m away.
LIGHTS: tuple[dict[str, Any], ...] = (
    {
        "comment": "a warm lamp close to the engine",
        "name": "engine",
        "type": "point",
        "position_m": [0.02, -0.12, -2.08],
        "intensity": 0.3,
        "color": [1.0, 0.56, 0.22],
        "specular": 0.06,
        "exponent": 40.0,
    },
    {
        "comment": "moonlight from the right and behind",
        "name": "moon",
        "type": "directional",
        "azimuth_deg": 100.0,
        "elevation_deg": 32.0,
        "intensity": 0.4,
        "color": [0.42, 0.62, 1.0],
        "specular": 0.05,
        "exponent": 20.0,
    },
    {
        "comment": "a work light over the shelves",
        "name": "shelf",
        "type": "spot",
        "position_m": [0.75, 1.5, -2.7],
        "aim_m": [0.75, 0.35, -3.9],
        "cone_deg": 35.0,
        "penumbra_deg": 20.0,
        "intensity": 0.9,
        "color": [0.75, 1.0, 0.9],
    },
)
PLATE_GAIN = 0.04  # what is left of the garage's own light


@dataclass(frozen=True, kw_only=True)
class DemoFiles:
    """Where the parts of the demo are; `new` is False where the folder held a demo already."""

    folder: Path
    shot: Path
    rig: Path
    truth: Path
    new: bool


def write_demo(folder: Path) -> DemoFiles:
    """Write the demo's shot into `folder`; what is there of an earlier demo, edited or not, is kept.

    Raises : OutputError where `folder` is a file or holds something else; PlateError where scikit-image lacks the pair.
    """
    files = DemoFiles(
        folder=folder,
        shot=folder / "shot.toml",
        rig=folder / "rig.json",
        truth=folder / "truth" / f"{NAME}.exr",
        new=not (folder / "truth" / f"{NAME}.exr").exists(),
    )
    plates = {eye: folder / "plates" / f"{eye}.png" for eye in ("left", "right")}
    parts = [files.shot, files.rig, *plates.values()]
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: a file stands where a folder is needed; choose another --out")
    if files.new and folder.is_dir() and any(folder.iterdir()) and not any(p.exists() for p in parts):
        raise OutputError(f"{folder}: holds something else than a demo; choose another --out")
    if not files.new and all(p.exists() for p in parts):
        return files
    pair = motorcycle()
    for eye, path in plates.items():
        if not path.exists():
            write_still(path, pair.left if eye == "left" else pair.right)
    if not files.rig.exists():
        write_rig(files.rig, rig_of_rectified(pair.rig))
    if not files.shot.exists():
        text = shot_text(left="plates/left.png", right="plates/right.png", name=NAME, lights=LIGHTS, plate_gain=PLATE_GAIN, command=str(files.shot))
        write_text(files.shot, text)
    if files.new:
        write_frame(files.truth, true_frame(pair), half=False)  # last: its presence says that the folder is whole
    return files


def true_frame(pair: TruePair) -> Frame:
    """Disparity and Z of the pair, NaN where unknown, and OCCLUDED where the right eye does not see a known pixel."""
    known = np.isfinite(pair.disparity)
    flags = np.where(known & ~pair.nonoccluded, np.uint16(Flag.OCCLUDED), np.uint16(0))
    Z = pair.rig.depth_from_disparity(pair.disparity).astype(np.float32)
    return Frame(passes={"disparity": pair.disparity, "Z": Z, "flags": flags}, camera=pair.rig.left)


def demo_figures(shot: Shot) -> DisparityFigures:
    """The depth that the demo's run wrote against the pair's truth, as disparity, pixels.

    The depth on disk is judged, after its way through Z to the original plate: what a user of the file gets.
    """
    pair = motorcycle()
    found = read_frame(shot.folder / "depth" / f"{shot.name}.exr")
    disparity = pair.rig.disparity_from_depth(found["Z"]).astype(np.float32)
    return disparity_figures(disparity, pair.disparity, nonoccluded=pair.nonoccluded, rig=pair.rig)


def headline(figures: DisparityFigures) -> Mapping[str, float]:
    """The figures of the Motorcycle pair that depth papers quote, in per cent and degrees."""
    seen, every = figures.regions["nonoccluded"], figures.regions["all"]
    line = {
        "cover_percent": every.cover_percent,
        "bad0.5_percent": seen.bad_percent[0.5],
        "bad2_percent": seen.bad_percent[2.0],
        "bad2_all_percent": every.bad_percent[2.0],
        "average_px": seen.average,
    }
    if figures.normals:
        line |= {"normals_median_deg": figures.normals.median_deg, "normals_under_11_percent": figures.normals.under_percent[11.25]}
    return {key: round(value, 3) for key, value in line.items()}
