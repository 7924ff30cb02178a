"""The PNG previews of a frame: what a person looks at to judge plate, depth, normals and light.

In: a `FrameJob`.  Out: name to (H, W, 3) uint8 sRGB.  Ranges are the shot's, not the frame's, so that nothing pumps."""

from __future__ import annotations

import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.camera import Camera
from stereorelight.footage import preview
from stereorelight.footage.colour import display_picture, rec709_from_working
from stereorelight.shot.job import FrameJob
from stereorelight.shot.pairs import EYES
from stereorelight.shot.schema import Shot

SCENE = ("plate", "depth", "confidence", "flags", "P", "N")
CELL_PX = 480  # width of one picture on the contact sheet
LIGHT, AROUND, PAINT = "light_", "env_", "paint_"


def scene_names(shot: Shot) -> list[str]:
    """The names of `scene_pictures`."""
    return [*SCENE, *(["anaglyph"] if "anaglyph" in shot.tables.output.movies else [])]


def shown(linear: Float32, shot: Shot) -> UInt8:
    """A plate or a layer as a person sees it: through the shot's display view, or as sRGB with a soft shoulder where it names none."""
    if shot.colour.display or shot.colour.view:
        return display_picture(linear, shot.colour)
    return preview.plate_picture(rec709_from_working(linear, shot.colour))


def _anaglyph(job: FrameJob) -> UInt8:
    """Both eyes rectified; what lies half way between the previews' near and far, in disparity, is in the plane of the screen."""
    views = [job.rectification.rectify(plate, eye) for plate, eye in zip(job.plates, EYES)]
    near, far = job.preview_range_m
    middle = float(job.rectification.rig.disparity_from_depth(2 / (1 / near + 1 / far)))
    width = views[0].shape[1]
    shift = round(min(max(middle, -width / 3), width / 3))
    return preview.anaglyph(shown(views[0], job.shot), shown(views[1], job.shot), shift_px=shift)


def scene_pictures(job: FrameJob) -> dict[str, UInt8]:
    """The plate and everything that was recovered from it; no light changes these."""
    near, far = job.preview_range_m
    more = {"anaglyph": _anaglyph(job)} if "anaglyph" in scene_names(job.shot) else {}
    return {
        "plate": shown(job.plate, job.shot),
        "depth": preview.depth_picture(job.depth["Z"], near=near, far=far),
        "confidence": preview.confidence_picture(job.depth["confidence"]),
        "flags": preview.flags_picture(job.depth["flags"]),
        "P": position_picture(job.surface["P"], job.camera, far_m=far),
        "N": preview.normals_picture(job.surface["N"]),
        **more,
    }


def position_picture(P: Float32, camera: Camera, *, far_m: float) -> UInt8:
    """P as colour over the box that the camera sees up to `far_m`: red to the right, green up, blue towards the camera."""
    corners = camera.unproject(camera.pixel_grid()[:: camera.size[1] - 1 or 1, :: camera.size[0] - 1 or 1].reshape(-1, 2), far_m)
    reach = np.nanmax(np.abs(corners), axis=0)
    low, high = np.array([-reach[0], -reach[1], -far_m]), np.array([reach[0], reach[1], 0.0])
    share = (P.astype(np.float64) - low) / (high - low)
    picture = np.rint(np.clip(np.nan_to_num(share), 0, 1) * 255).astype(np.uint8)
    picture[~np.isfinite(P).all(axis=-1)] = preview.MISSING
    return picture


def _lights(shot: Shot) -> list[str]:
    """`light_<name>` of every light that has layers."""
    return list(dict.fromkeys(name.rpartition("_")[0] for name in shot.setup.layer_names if name.startswith(LIGHT)))


def relit_names(shot: Shot) -> list[str]:
    """The names of `relit_pictures`."""
    around = ["environment"] if any(name.startswith(AROUND) for name in shot.setup.layer_names) else []
    around += [name for name in shot.setup.layer_names if name.startswith(PAINT)]
    trust = ["trust"] if shot.tables.relight.fade > 0 else []
    own = ["plate_light", "albedo"] if shot.setup.relight.albedo == "estimated" and shot.setup.relight.mode != "multiply" else []
    return [*_lights(shot), *around, *trust, *own, "relit", "before_after", "contact"]


def relit_pictures(job: FrameJob) -> dict[str, UInt8]:
    """Each light alone (diffuse and specular), the relit plate, before and after, and everything on one sheet."""
    made: dict[str, UInt8] = {}
    for light in _lights(job.shot):
        parts = [layer for name, layer in job.lit.layers.items() if name.rpartition("_")[0] == light]
        made[light] = shown(np.sum(parts, axis=0, dtype=np.float32), job.shot)
    if around := [layer for name, layer in job.lit.layers.items() if name.startswith(AROUND)]:
        made["environment"] = shown(np.sum(around, axis=0, dtype=np.float32), job.shot)
    made |= {name: shown(np.abs(layer), job.shot) for name, layer in job.lit.layers.items() if name.startswith(PAINT)}  # ink takes away
    if job.lit.trust is not None:
        made["trust"] = preview.confidence_picture(job.lit.trust)
    if job.lit.colour is not None and job.lit.colour.light is not None:
        made["plate_light"] = shown(job.lit.colour.light.ball(), job.shot)
        made["albedo"] = shown(job.lit.colour.albedo, job.shot)
    made["relit"] = shown(job.lit.beauty, job.shot)
    scene = scene_pictures(job)
    made["before_after"] = preview.before_after(scene["plate"], made["relit"])
    sheet = [("plate", scene["plate"]), ("relit", made["relit"]), *((n, p) for n, p in scene.items() if n != "plate")]
    sheet += [(n, p) for n, p in made.items() if n.startswith((LIGHT, PAINT)) or n in ("environment", "trust")]
    made["contact"] = preview.contact_sheet(sheet, columns=3, width=CELL_PX)
    return made
