"""Light layers from P and N, and the fused way from Z straight to the relit plate.

In: P, N (H, W, 3), albedo (H, W, 3), lights.  Out: one diffuse and one specular layer a light, (H, W, 3) float32, linear,
each with its tint, intensity, attenuation, cone and matte in it; or the relit plate.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres; the eye is at the origin.
Where P or N is missing (NaN, infinite, or a renderer's zero normal) the light is exactly 0; a layer never holds NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, as_float32
from stereorelight.camera import Camera
from stereorelight.engine.gain import checked_gain
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.light.lights import DirectionalLight, Light, PointLight, SpotLight, in_camera

HARD_EDGE = 1e-6  # radians over which a cone without penumbra falls


def light_layers(
    P: npt.ArrayLike,
    N: npt.ArrayLike,
    albedo: npt.ArrayLike,
    lights: Sequence[Light],
    *,
    mattes: Mapping[str, npt.ArrayLike] | None = None,
    camera: Camera | None = None,
) -> dict[str, Float32]:
    """Every enabled light's own layers: `light_<name>_diffuse` always, `light_<name>_specular` where `specular` > 0.

    P, N    : (H, W, 3), scene frame of the camera; metres, unit.  NaN where unknown.
    albedo  : (H, W, 3), linear; the plate where nothing better is known.  Where it is NaN the diffuse light is 0.
    mattes  : (H, W) in 0..1 by the name that a light's `matte` holds; NaN counts as 0.
    camera  : its pose places lights in world space; without one, world = camera.
    Returns : layers in the order of the lights.  diffuse = albedo * strength * max(0, N.L), specular = strength * max(0, R.V)^exponent,
              V = normalize(-P), R the mirror image of L; nothing where N.L <= 0 (but for `wrap`).  Their sum is the light's whole effect.
    Raises  : PassError for arrays that do not fit, ShotError for a matte that is not there.
    """
    from stereorelight.engine import light as engine

    N_ = as_float32(N, "N", channels=3)
    size_hw = (N_.shape[0], N_.shape[1])
    P_ = as_float32(P, "P", channels=3, size_hw=size_hw)
    albedo_ = as_float32(albedo, "albedo", channels=3, size_hw=size_hw)
    shining = _shining(lights, camera)
    names: list[str] = []
    slots = np.full((len(shining), 3), -1, np.int32)
    for row, light in zip(slots, shining):
        row[engine.DIFFUSE_SLOT] = len(names)
        names.append(f"light_{light.name}_diffuse")
        if light.specular > 0:
            row[engine.SPECULAR_SLOT] = len(names)
            names.append(f"light_{light.name}_specular")
    matte_stack = _assign_mattes(shining, mattes or {}, size_hw, slots[:, engine.MATTE])
    layers = np.empty((len(names), *size_hw, 3), np.float32)
    if shining:
        engine.shade(engine.Surface(P=P_, N=N_), albedo_, _table(shining), slots, matte_stack, layers=layers)
    return dict(zip(names, layers))


def relight_fused(
    plate: npt.ArrayLike,
    Z: npt.ArrayLike,
    N: npt.ArrayLike,
    camera: Camera,
    lights: Sequence[Light],
    *,
    albedo: npt.ArrayLike | None = None,
    plate_gain: float | Sequence[float] = 1.0,
    mattes: Mapping[str, npt.ArrayLike] | None = None,
    rays: npt.ArrayLike | None = None,
) -> Float32:
    """The relit plate in one pass, without P or layers in memory: the same as `light_layers` and `comp.relight`, to float precision.

    plate      : (H, W, 3), linear.  Z : (H, W), metres along the optical axis, NaN where unknown.  N : as in `light_layers`.
    albedo     : (H, W, 3) linear, or None for the plate.
    plate_gain : one number or three, >= 0.
    rays       : (H, W, 2), `camera.ray_grid()`, for a lens that bends: give it where many frames share a camera; worked out where None.
    Returns    : (H, W, 3) float32: plate * plate_gain + light.  No lights and gain 1 return the plate bit for bit.
    """
    from stereorelight.engine import light as engine

    plate_ = as_float32(plate, "plate", channels=3, size_hw=camera.size_hw)
    gain = checked_gain(plate_gain)
    shining = _shining(lights, camera)
    if not shining and gain == (1.0, 1.0, 1.0):
        return plate_.copy()
    Z_ = as_float32(Z, "Z", size_hw=camera.size_hw)
    N_ = as_float32(N, "N", channels=3, size_hw=camera.size_hw)
    albedo_ = plate_ if albedo is None else as_float32(albedo, "albedo", channels=3, size_hw=camera.size_hw)
    rays_ = None if rays is None else as_float32(rays, "rays", channels=2, size_hw=camera.size_hw)
    if camera.distorts and rays_ is None:
        rays_ = camera.ray_grid()
    slots = np.full((len(shining), 3), -1, np.int32)
    matte_stack = _assign_mattes(shining, mattes or {}, camera.size_hw, slots[:, engine.MATTE])
    surface = engine.Surface(Z=Z_, N=N_, rays=rays_, pinhole=(camera.fx, camera.fy, camera.cx, camera.cy))
    beauty = np.empty_like(plate_)
    engine.shade(surface, albedo_, _table(shining), slots, matte_stack, plate=plate_, gain=gain, beauty=beauty)
    return beauty


def _shining(lights: Sequence[Light], camera: Camera | None) -> list[Light]:
    """The enabled lights, in the scene frame of the camera."""
    seen: set[str] = set()
    for light in lights:
        if light.name in seen:
            raise ShotError(f"light {light.name!r}: name is taken by an earlier light; names must differ, since they name the layers")
        seen.add(light.name)
    pose = np.eye(4) if camera is None else camera.world_from_camera
    return [in_camera(light, pose) for light in lights if light.enabled]


def _assign_mattes(lights: Sequence[Light], mattes: Mapping[str, npt.ArrayLike], size_hw: tuple[int, int], column: npt.NDArray[np.int32]) -> Float32:
    """(k, H, W) of the mattes in use, each once; `column` gets every light's index into it."""
    used = list(dict.fromkeys(light.matte for light in lights if light.matte is not None))
    stack = np.empty((len(used), *size_hw), np.float32)
    for index, name in enumerate(used):
        holders = [k for k, light in enumerate(lights) if light.matte == name]
        if name not in mattes:
            raise ShotError(f"light {lights[holders[0]].name!r}: matte {name!r} is missing{nearest_hint(name, mattes) or '; there are none'}")
        stack[index] = as_float32(mattes[name], f"matte {name!r}", size_hw=size_hw)
        low, high = float(np.fmin.reduce(stack[index], axis=None)), float(np.fmax.reduce(stack[index], axis=None))
        if low < 0 or high > 1:
            raise PassError(f"matte {name!r} must lie in 0 ... 1, got {low if low < 0 else high:.4g}; divide 8-bit values by 255")
        column[holders] = index
    return stack


def _table(lights: Sequence[Light]) -> Float32:
    """The lights as rows of the engine's table; everything that is the same for all pixels is multiplied here, in float64."""
    from stereorelight.engine import light as engine

    table = np.zeros((len(lights), engine.COLUMNS), np.float64)
    for row, light in zip(table, lights):
        tint = light.strength * np.array(light.color)
        row[engine.DIFFUSE : engine.DIFFUSE + 3] = tint * light.diffuse
        lobe = (light.exponent + 2) / 2 if light.normalised else 1.0
        row[engine.SPECULAR : engine.SPECULAR + 3] = tint * light.specular * lobe * np.array(light.specular_tint)
        row[engine.EXPONENT] = light.exponent
        row[engine.WRAP_SCALE], row[engine.WRAP_OFFSET] = 1 / (1 + light.wrap), light.wrap / (1 + light.wrap)
        if isinstance(light, DirectionalLight):
            row[engine.PLACE : engine.PLACE + 3] = -light.shines_to
            row[engine.FALL_NONE] = 1
        elif isinstance(light, PointLight):
            row[engine.PLACE : engine.PLACE + 3] = light.position_m
            row[engine.IS_PLACE] = 1
            fall = {"none": engine.FALL_NONE, "linear": engine.FALL_LINEAR}.get(light.attenuation, engine.FALL_SQUARE)
            row[fall] = 1
            if light.radius_m is not None:
                row[engine.WINDOW] = light.radius_m**-4.0
        else:
            raise ShotError(f"light {light.name!r}: a light of type {type(light).__name__} cannot be shaded")
        if isinstance(light, SpotLight):
            penumbra = max(math.radians(light.penumbra_deg), HARD_EDGE)
            row[engine.AXIS : engine.AXIS + 3] = light.shines_to
            row[engine.EDGE] = math.radians(light.cone_deg / 2) + penumbra
            row[engine.PER_ANGLE] = 1 / penumbra
    return table.astype(np.float32)
