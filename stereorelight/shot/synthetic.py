"""A synthetic shot as a folder that `run` can take: plates, rig, shot file and truth.

Layout: plates/left.png, plates/right.png (or left.1001.png ...), rig.json, shot.toml, truth/NAME.exr (Z, P, N, albedo, flags, and
disparity where the plates are rectified as shot), all on the flipped-back left plate.  Where the rig was knocked since its calibration,
truth/rig.json says how it really stood; where the camera moves, camera.json says how.  A board session has plates and rig.json alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stereorelight.calibration.board import Board, parse_board
from stereorelight.camera import Eye, Rig
from stereorelight.errors import ShotError, nearest_hint
from stereorelight.files import refuse_overwrite, write_text
from stereorelight.footage.colour import encode
from stereorelight.footage.frames import write_frame
from stereorelight.footage.stills import write_still
from stereorelight.interchange.poses import Poses, write_poses
from stereorelight.interchange.rigs import write_rig
from stereorelight.shot.template import shot_text
from stereorelight.synth.board_view import board_picture, board_poses
from stereorelight.synth.dials import Dials, bent, knocked, recorded, swayed
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rig_named
from stereorelight.synth.scene import Scene
from stereorelight.synth.scenes import scene_named

FIRST_FRAME = 1001
Motion = Literal["actor", "camera", "both", "none"]
MOTIONS = ("actor", "camera", "both", "none")
AT_REST = Dials()
BOARD = "charuco:11x8:0.040:0.030:DICT_5X5_100"
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
    dials: Dials = AT_REST,
    motion: Motion = "actor",
    bounce: int = 0,
    force: bool = False,
    on_frame: Callable[[int], None] = lambda done: None,
) -> list[Path]:
    """Render `scene` and write it as a shot.  Returns the files, the shot file first.

    frames : 1 is a still; more are a sequence from 1001.
    motion : what moves in a sequence: "actor", the scene itself; "camera", which sways; "both"; or "none".
    dials  : what went wrong on set; `noise_sigma` is its grain.
    bounce : rays a pixel that gather the light between surfaces, two bounces; 0 leaves the scene's flat ambient light.
    Raises : ShotError, RigError for settings that cannot be; OutputError where a file exists, before anything is rendered.
    """
    check_size(size)
    if frames < 1:
        raise ShotError(f"frames must be at least 1, got {frames}")
    if not (math.isfinite(baseline_m) and baseline_m > 0):
        raise ShotError(f"the baseline must be > 0 metres, got {baseline_m:g}")
    if motion not in MOTIONS:
        raise ShotError(f"motion {motion!r} is unknown{nearest_hint(str(motion), MOTIONS)}")
    if noise_sigma:
        dials = replace(dials, grain=noise_sigma)
    numbers: list[int | None] = [None] if frames == 1 else list(range(FIRST_FRAME, FIRST_FRAME + frames))
    made_rig = bent(rig_named(rig, size, fov_deg=fov_deg, baseline_m=baseline_m), dials)
    stands = knocked(made_rig, dials)
    scene_named(scene, texture=texture)
    acts, sways = (frames > 1 and motion in (kind, "both") for kind in ("actor", "camera"))

    def plate_path(eye: Eye, number: int | None) -> Path:
        return folder / "plates" / (f"{eye}.png" if number is None else f"{eye}.{number}.png")

    def truth_path(number: int | None) -> Path:
        return folder / "truth" / (f"{scene}.exr" if number is None else f"{scene}.{number}.exr")

    def at(index: float) -> tuple[Scene, Rig]:
        return scene_named(scene, texture=texture, frame=index, motion=acts), swayed(stands, index) if sways else stands

    shot_path, rig_path, poses_path = folder / "shot.toml", folder / "rig.json", folder / "camera.json"
    files = [shot_path, rig_path, *(plate_path(eye, n) for n in numbers for eye in EYES), *(truth_path(n) for n in numbers)]
    files += [folder / "truth" / "rig.json"] * dials.knocks + [poses_path] * sways
    for file in files:
        refuse_overwrite(file, force=force)
    poses = {}
    for index, number in enumerate(numbers):
        built, rig_now = at(index)
        right = at(index - dials.right_late_frames) if dials.right_late_frames else None
        shot = render(built, rig_now, samples=samples, frame=index, right=right, bounce=bounce)
        for eye in EYES:
            flipped = shot.rig.mirrored == eye
            plate = recorded(shot.frame(eye)["plate"], eye, dials, frame=index)
            write_still(plate_path(eye, number), encode(plate[:, ::-1] if flipped else plate, "sRGB"), bits=bits, force=force)
        truth = {name: shot.left[name] for name in TRUTH if name in shot.left}
        write_frame(truth_path(number), replace(shot.left, passes=truth, number=number), half=False, force=force)
        poses[number or FIRST_FRAME] = rig_now.left.world_from_camera
        on_frame(index + 1)
    write_rig(rig_path, made_rig, force=force)
    if dials.knocks:
        write_rig(folder / "truth" / "rig.json", stands, force=force)
    if sways:
        write_poses(poses_path, Poses(frames=poses), force=force)
    pattern = "plates/{}.png" if frames == 1 else "plates/{}.####.png"
    camera = '\n[camera]\nfile = "camera.json"\n' if sways else ""
    text = shot_text(left=pattern.format("left"), right=pattern.format("right"), name=scene, lights=LIGHTS, plate_gain=0.15, command=str(shot_path))
    write_text(shot_path, text + camera, force=force)
    return files


def write_session(
    folder: Path,
    *,
    board: str = BOARD,
    views: int = 20,
    size: tuple[int, int] = (960, 540),
    rig: str = "parallel",
    fov_deg: float = 40.0,
    baseline_m: float = 0.065,
    noise_sigma: float = 0.0,
    bits: int = 16,
    dials: Dials = AT_REST,
    force: bool = False,
    on_frame: Callable[[int], None] = lambda done: None,
) -> list[Path]:
    """A calibration session: `views` pictures of a board by both eyes, and the rig that took them.  Returns the files, rig.json first.

    board  : a spec as `calibrate` takes it.   dials : knocks are part of the rig here, which rig.json then holds.
    Raises : ShotError, RigError for settings that cannot be; OutputError where a file exists, before anything is rendered.
    """
    check_size(size)
    if not 1 <= views <= 500:
        raise ShotError(f"a session has 1 to 500 views, got {views}")
    if dials.right_late_frames:
        raise ShotError("a board stands still while it is filmed: right_late_frames has no meaning in a session")
    printed: Board = parse_board(board)
    if noise_sigma:
        dials = replace(dials, grain=noise_sigma)
    stands = knocked(bent(rig_named(rig, size, fov_deg=fov_deg, baseline_m=baseline_m), dials), dials)
    rig_path = folder / "rig.json"
    paths = {(eye, n): folder / "plates" / f"{eye}.{FIRST_FRAME + n}.png" for n in range(views) for eye in EYES}
    for file in (rig_path, *paths.values()):
        refuse_overwrite(file, force=force)
    for n, (R, t) in enumerate(board_poses(printed.extent_m, stands.left, views, seed=dials.seed)):
        for eye in EYES:
            R_eye, t_eye = (R, t) if eye == "left" else (stands.R_right_left @ R, stands.R_right_left @ t + stands.t_right_left_m)
            grey = board_picture(printed.rectangles_m, printed.extent_m, 1.5 * printed.quiet_m, stands.camera(eye), R_eye, t_eye)
            plate = recorded(np.repeat(grey[..., None].astype(np.float32), 3, axis=-1), eye, dials, frame=n)
            write_still(paths[eye, n], encode(plate[:, ::-1] if stands.mirrored == eye else plate, "sRGB"), bits=bits, force=force)
        on_frame(n + 1)
    write_rig(rig_path, stands, force=force)
    return [rig_path, *paths.values()]
