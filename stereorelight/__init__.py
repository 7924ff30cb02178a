"""stereorelight: relight live footage shot with two cameras.

The public names, in the order in which data flows; each is loaded when it is first used."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stereorelight.camera import Camera as Camera
    from stereorelight.camera import RectifiedRig as RectifiedRig
    from stereorelight.camera import Rig as Rig
    from stereorelight.comp import relight as relight
    from stereorelight.compare.depth import depth_figures as depth_figures
    from stereorelight.compare.depth import disparity_figures as disparity_figures
    from stereorelight.compare.normals import normal_figures as normal_figures
    from stereorelight.compare.picture import light_figures as light_figures
    from stereorelight.compare.picture import picture_figures as picture_figures
    from stereorelight.compare.stereo import stereo_figures as stereo_figures
    from stereorelight.errors import OutputError as OutputError
    from stereorelight.errors import PassError as PassError
    from stereorelight.errors import PlateError as PlateError
    from stereorelight.errors import RigError as RigError
    from stereorelight.errors import ShotError as ShotError
    from stereorelight.errors import StereoRelightError as StereoRelightError
    from stereorelight.footage.frames import read_frame as read_frame
    from stereorelight.footage.frames import write_frame as write_frame
    from stereorelight.footage.plates import read_pair as read_pair
    from stereorelight.footage.plates import read_plate as read_plate
    from stereorelight.interchange.rigs import read_rig as read_rig
    from stereorelight.interchange.rigs import write_rig as write_rig
    from stereorelight.light.albedo import albedo_of as albedo_of
    from stereorelight.light.edges import parted as parted
    from stereorelight.light.estimate import estimate_lighting as estimate_lighting
    from stereorelight.light.lights import DirectionalLight as DirectionalLight
    from stereorelight.light.lights import PointLight as PointLight
    from stereorelight.light.lights import SpotLight as SpotLight
    from stereorelight.light.lights import lights_from_dicts as lights_from_dicts
    from stereorelight.light.shade import light_layers as light_layers
    from stereorelight.light.shade import relight_fused as relight_fused
    from stereorelight.light.shade import relight_with_layers as relight_with_layers
    from stereorelight.light.subsurface import scattered as scattered
    from stereorelight.passes import Flag as Flag
    from stereorelight.passes import Frame as Frame
    from stereorelight.shot.run import run_shot as run_shot
    from stereorelight.shot.schema import read_lights as read_lights
    from stereorelight.shot.schema import read_shot as read_shot
    from stereorelight.stereo.depth import recover as recover
    from stereorelight.stereo.rectify import rectification as rectification
    from stereorelight.stereo.settings import DepthSettings as DepthSettings
    from stereorelight.surface.normals import normals_from_depth as normals_from_depth
    from stereorelight.surface.position import position_from_depth as position_from_depth
    from stereorelight.synth.render import render as render
    from stereorelight.synth.rigs import rig_named as rig_named
    from stereorelight.synth.scenes import scene_named as scene_named

__version__ = "0.1.0"

_HOMES = {
    "errors": ("StereoRelightError", "RigError", "PlateError", "PassError", "ShotError", "OutputError"),
    "camera": ("Camera", "Rig", "RectifiedRig"),
    "passes": ("Frame", "Flag"),
    "footage.plates": ("read_plate", "read_pair"),
    "footage.frames": ("read_frame", "write_frame"),
    "interchange.rigs": ("read_rig", "write_rig"),
    "stereo.settings": ("DepthSettings",),
    "stereo.rectify": ("rectification",),
    "stereo.depth": ("recover",),
    "surface.position": ("position_from_depth",),
    "surface.normals": ("normals_from_depth",),
    "light.lights": ("PointLight", "DirectionalLight", "SpotLight", "lights_from_dicts"),
    "light.shade": ("light_layers", "relight_fused", "relight_with_layers"),
    "light.subsurface": ("scattered",),
    "light.estimate": ("estimate_lighting",),
    "light.albedo": ("albedo_of",),
    "light.edges": ("parted",),
    "comp": ("relight",),
    "shot.schema": ("read_shot", "read_lights"),
    "shot.run": ("run_shot",),
    "compare.depth": ("depth_figures", "disparity_figures"),
    "compare.normals": ("normal_figures",),
    "compare.picture": ("light_figures", "picture_figures"),
    "compare.stereo": ("stereo_figures",),
    "synth.scenes": ("scene_named",),
    "synth.rigs": ("rig_named",),
    "synth.render": ("render",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'stereorelight' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"stereorelight.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
