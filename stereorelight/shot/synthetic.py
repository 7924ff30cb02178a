"""A synthetic shot as a folder that `run` can take: plates, rig, shot file and truth.

Layout: plates/left.png, plates/right.png (or left.1001.png ...), rig.json, shot.toml, truth/NAME.exr (Z, P, N, albedo, flags, and
disparity where the plates are rectified as shot), all on the flipped-back left plate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from stereorelight.camera import Eye
from stereorelight.errors import ShotError
from stereorelight.files import refuse_overwrite, write_text
from stereorelight.footage.colour import encode
from stereorelight.footage.frames import write_frame
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.shot.template import shot_text
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scenes import scene_named

FIRST_FRAME = 1001
TRUTH = ("Z", "P", "N", "albedo", "flags", "disparity")
EYES: tuple[Eye, Eye] = ("left", "right")
LIGHTS: tuple[dict[str, Any], ...] = (
    {
        "comment": "warm, from the right and a little above",
        "name": "key",
        "type": "point",
        "position_m": [0.9, 0.5, -0.7],
        "intensity": 5.0,
        "color": [1.0, 0.72, 0.45],
        "specular": 0.05,
        "exponent": 24.0,
    },
    {
        "comment": "cool, from the left",
        "name": "fill",
        "type": "directional",
        "azimuth_deg": -60.0,
        "elevation_deg": 10.0,
        "intensity": 0.7,
        "color": [0.5, 0.7, 1.0],
    },
)


def check_size(size: tuple[int, int]) -> None:
    """Raise ShotError for a size that no stereo match can work on."""
    if min(size) < 32 or max(size) > 16384:
        raise ShotError(f"size must lie between 32x32 and 16384x16384 pixels, got {size[0]}x{size[1]}")


def write_shot(
    folder: Path,
    scene: str,
    *,
    size: tuple[int, int] = (640, 360),
    rig: str = "parallel",
    frames: int = 1,
    fov_deg: float = 40.0,
    baseline_m: float = 0.065,
    texture: float = 1.0,
    noise_sigma: float = 0.0,
    samples: int = 3,
    bits: int = 16,
    force: bool = False,
    on_frame: Callable[[int], None] = lambda done: None,
) -> list[Path]:
    """Render `scene` and write it as a shot.  Returns the files, the shot file first.

    frames : 1 is a still; more are a sequence from 1001 in which the scene moves.
    Raises : ShotError, RigError for settings that cannot be; OutputError where a file exists, before anything is rendered.
    """
    check_size(size)
    if frames < 1:
        raise ShotError(f"frames must be at least 1, got {frames}")
    if not (math.isfinite(baseline_m) and baseline_m > 0):
        raise ShotError(f"the baseline must be > 0 metres, got {baseline_m:g}")
    numbers: list[int | None] = [None] if frames == 1 else list(range(FIRST_FRAME, FIRST_FRAME + frames))
    made_rig = rig_named(rig, size, fov_deg=fov_deg, baseline_m=baseline_m)
    scene_named(scene, texture=texture)

    def plate_path(eye: Eye, number: int | None) -> Path:
        return folder / "plates" / (f"{eye}.png" if number is None else f"{eye}.{number}.png")

    def truth_path(number: int | None) -> Path:
        return folder / "truth" / (f"{scene}.exr" if number is None else f"{scene}.{number}.exr")

    shot_path, rig_path = folder / "shot.toml", folder / "rig.json"
    files = [shot_path, rig_path, *(plate_path(eye, n) for n in numbers for eye in EYES), *(truth_path(n) for n in numbers)]
    for file in files:
        refuse_overwrite(file, force=force)
    for index, number in enumerate(numbers):
        built = scene_named(scene, texture=texture, frame=index, motion=frames > 1)
        shot = render(built, made_rig, samples=samples, noise_sigma=noise_sigma, frame=index)
        for eye in EYES:
            write_still(plate_path(eye, number), encode(shot.recorded_plate(eye), "sRGB"), bits=bits, force=force)
        truth = {name: shot.left[name] for name in TRUTH if name in shot.left}
        write_frame(truth_path(number), replace(shot.left, passes=truth, number=number), half=False, force=force)
        on_frame(index + 1)
    write_rig(rig_path, made_rig, force=force)
    pattern = "plates/{}.png" if frames == 1 else "plates/{}.####.png"
    text = shot_text(left=pattern.format("left"), right=pattern.format("right"), name=scene, lights=LIGHTS, plate_gain=0.15, command=str(shot_path))
    write_text(shot_path, text, force=force)
    return files
