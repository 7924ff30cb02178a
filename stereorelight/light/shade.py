"""Light layers from P and N, and the fused way from Z straight to the relit plate.

In: P, N (H, W, 3), albedo (H, W, 3), lights.  Out: one diffuse and one specular layer a light, (H, W, 3) float32, linear,
each with its tint, intensity, attenuation, cone and matte in it; or the relit plate.
Frame: scene frame of the camera (x right, y up, the camera looks down -z), metres; the eye is at the origin.
Where P or N is missing (NaN, infinite, or a renderer's zero normal) the light is exactly 0; a layer never holds NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, as_float32
from stereorelight.camera import Camera
from stereorelight.engine.gain import checked_gain
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.light.lights import DirectionalLight, Light, PointLight, RectLight, SphereLight, SpotLight, in_camera
from stereorelight.light.materials import Material, covers, ggx_alpha, glow_table, reflectance

HARD_EDGE = 1e-6  # radians over which a cone without penumbra falls


def light_layers(
    P: npt.ArrayLike,
    N: npt.ArrayLike,
    albedo: npt.ArrayLike,
    lights: Sequence[Light],
    *,
    mattes: Mapping[str, npt.ArrayLike] | None = None,
    materials: Sequence[Material] = (),
    camera: Camera | None = None,
    shadows: Mapping[str, npt.ArrayLike] | None = None,
) -> dict[str, Float32]:
    """Every enabled light's own layers: `light_<name>_diffuse` always, `light_<name>_specular` where it or a material has a highlight or a rim.

    P, N    : (H, W, 3), scene frame of the camera; metres, unit.  NaN where unknown.
    albedo  : (H, W, 3), linear; the plate where nothing better is known.  Where it is NaN the diffuse light is 0.
    mattes  : (H, W) in 0..1 by the name that a light's `matte` holds; NaN counts as 0.
    materials : surfaces by matte, which take the place of the lights' own settings there; later ones lie over earlier ones.
    camera  : its pose places lights in world space; without one, world = camera.
    shadows : (H, W) in 0..1 by the name of the light whose both layers it multiplies; NaN counts as 0.
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
    names, slots = _layers_of(shining, materials)
    layers = np.empty((len(names), *size_hw, 3), np.float32)
    if shining:
        rows = _rows(shining, materials, mattes or {}, size_hw, slots, shadows or {})
        engine.shade(engine.Surface(P=P_, N=N_), albedo_, rows.table, rows.slots, rows.mattes, glows=rows.glows, layers=layers)
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
    materials: Sequence[Material] = (),
    rays: npt.ArrayLike | None = None,
    shadows: Mapping[str, npt.ArrayLike] | None = None,
    out: Float32 | None = None,
) -> Float32:
    """The relit plate in one pass, without P or layers in memory: the same as `light_layers` and `comp.relight`, to float precision.

    plate      : (H, W, 3), linear.  Z : (H, W), metres along the optical axis, NaN where unknown.  N : as in `light_layers`.
    albedo     : (H, W, 3) linear, or None for the plate.
    plate_gain : one number or three, >= 0.
    rays       : (H, W, 2), `camera.ray_grid()`, for a lens that bends: give it where many frames share a camera; worked out where None.
    shadows    : as in `light_layers`.
    out        : (H, W, 3) float32, C-contiguous and none of the inputs, to write into and return: a fresh picture costs a third of a light.
    Returns    : (H, W, 3) float32: plate * plate_gain + light.  No lights and gain 1 return the plate bit for bit.
    """
    if out is not None:
        if out.dtype != np.float32 or not out.flags.c_contiguous or out.shape != (*camera.size_hw, 3):
            raise PassError(f"out must be C-contiguous float32 of shape {(*camera.size_hw, 3)}, got {out.dtype} {out.shape}")
        if any(np.may_share_memory(out, given) for given in (plate, Z, N, albedo, rays) if isinstance(given, np.ndarray)):
            raise PassError("out must not be one of the inputs; give an array of its own")
    beauty, _ = _fused(plate, Z, N, camera, lights, albedo, plate_gain, mattes, materials, rays, shadows, out=out, with_layers=False)
    return beauty


def relight_with_layers(
    plate: npt.ArrayLike,
    Z: npt.ArrayLike,
    N: npt.ArrayLike,
    camera: Camera,
    lights: Sequence[Light],
    *,
    albedo: npt.ArrayLike | None = None,
    plate_gain: float | Sequence[float] = 1.0,
    mattes: Mapping[str, npt.ArrayLike] | None = None,
    materials: Sequence[Material] = (),
    rays: npt.ArrayLike | None = None,
    shadows: Mapping[str, npt.ArrayLike] | None = None,
) -> tuple[Float32, dict[str, Float32]]:
    """The relit plate and every layer from one pass over the picture: what `relight_fused` and `light_layers` give, for the cost of the
    first and of writing the second.  Arguments as in `relight_fused`; the layers add up to the picture to float precision.
    """
    return _fused(plate, Z, N, camera, lights, albedo, plate_gain, mattes, materials, rays, shadows, out=None, with_layers=True)


def _fused(
    plate: npt.ArrayLike,
    Z: npt.ArrayLike,
    N: npt.ArrayLike,
    camera: Camera,
    lights: Sequence[Light],
    albedo: npt.ArrayLike | None,
    plate_gain: float | Sequence[float],
    mattes: Mapping[str, npt.ArrayLike] | None,
    materials: Sequence[Material],
    rays: npt.ArrayLike | None,
    shadows: Mapping[str, npt.ArrayLike] | None,
    *,
    out: Float32 | None,
    with_layers: bool,
) -> tuple[Float32, dict[str, Float32]]:
    from stereorelight.engine import light as engine

    plate_ = as_float32(plate, "plate", channels=3, size_hw=camera.size_hw)
    gain = checked_gain(plate_gain)
    shining = _shining(lights, camera)
    beauty = np.empty_like(plate_) if out is None else out
    if not shining and gain == (1.0, 1.0, 1.0):
        beauty[:] = plate_
        return beauty, {}
    Z_ = as_float32(Z, "Z", size_hw=camera.size_hw)
    N_ = as_float32(N, "N", channels=3, size_hw=camera.size_hw)
    albedo_ = plate_ if albedo is None else as_float32(albedo, "albedo", channels=3, size_hw=camera.size_hw)
    rays_ = None if rays is None else as_float32(rays, "rays", channels=2, size_hw=camera.size_hw)
    if camera.distorts and rays_ is None:
        rays_ = camera.ray_grid()
    names, slots = _layers_of(shining, materials) if with_layers else ([], [(-1, -1)] * len(shining))
    rows = _rows(shining, materials, mattes or {}, camera.size_hw, slots, shadows or {})
    surface = engine.Surface(Z=Z_, N=N_, rays=rays_, pinhole=(camera.fx, camera.fy, camera.cx, camera.cy))
    layers = np.empty((len(names), *plate_.shape), np.float32) if names else None
    engine.shade(surface, albedo_, rows.table, rows.slots, rows.mattes, glows=rows.glows, layers=layers, plate=plate_, gain=gain, beauty=beauty)
    return beauty, {} if layers is None else dict(zip(names, layers))


def _layers_of(shining: Sequence[Light], materials: Sequence[Material]) -> tuple[list[str], list[tuple[int, int]]]:
    """The names of the lights' layers, and for each light the places of its two among them, -1 for none."""
    names: list[str] = []
    slots: list[tuple[int, int]] = []
    for light in shining:
        specular = -1
        names.append(f"light_{light.name}_diffuse")
        if light.shines or any(material.under(light).shines for material in materials):
            specular = len(names)
            names.append(f"light_{light.name}_specular")
        slots.append((len(names) - 1 - (specular >= 0), specular))
    return names, slots


def _shining(lights: Sequence[Light], camera: Camera | None) -> list[Light]:
    """The enabled lights, in the scene frame of the camera."""
    seen: set[str] = set()
    for light in lights:
        if light.name in seen:
            raise ShotError(f"light {light.name!r}: name is taken by an earlier light; names must differ, since they name the layers")
        seen.add(light.name)
    pose = np.eye(4) if camera is None else camera.world_from_camera
    alone = any(light.solo for light in lights if light.enabled)
    return [in_camera(light, pose) for light in lights if light.enabled and (light.solo or not alone)]


def group_layers(layers: Mapping[str, Float32], lights: Sequence[Light]) -> dict[str, Float32]:
    """`group_<name>`, (H, W, 3), for every group that a light names: the sum of its lights' layers."""
    groups: dict[str, Float32] = {}
    for light in lights:
        for part in ("diffuse", "specular"):
            layer = layers.get(f"light_{light.name}_{part}")
            if light.group is not None and layer is not None:
                name = f"group_{light.group}"
                groups[name] = groups[name] + layer if name in groups else layer.copy()
    return groups


@dataclass(frozen=True, kw_only=True)
class _Rows:
    """What the engine wants: its table, the integer table, the mattes (k, H, W), and the tables of GGX."""

    table: Float32
    slots: npt.NDArray[np.int32]
    mattes: Float32
    glows: Float32


def _rows(
    lights: Sequence[Light],
    materials: Sequence[Material],
    mattes: Mapping[str, npt.ArrayLike],
    size_hw: tuple[int, int],
    layers: Sequence[tuple[int, int]],
    shadows: Mapping[str, npt.ArrayLike],
) -> _Rows:
    """One row for every light on every material, the lights' own settings first."""
    from stereorelight.engine import light_table as engine
    from stereorelight.engine.area_rows import NODES

    stack: list[Float32] = []
    indices: dict[str, int] = {}
    askers = [(light.matte, f"light {light.name!r}") for light in lights] + [(m.matte, f"material {m.name!r}") for m in materials]
    for name, asker in askers:
        if name is not None and name not in indices:
            indices[name] = len(stack)
            stack.append(_matte(name, asker, mattes, size_hw))
    held = {light.name: -1 if light.matte is None else indices[light.matte] for light in lights}
    for light in lights:  # a shadow is one more matte, of one light
        if light.name in shadows:
            shadow = _matte(light.name, f"shadow of light {light.name!r}", shadows, size_hw)
            stack.append(shadow if held[light.name] < 0 else shadow * stack[held[light.name]])
            held[light.name] = len(stack) - 1
    own = -1
    first = len(stack)
    if materials:
        left, shares = covers(materials, {m.matte: stack[indices[m.matte]] for m in materials})
        stack += [left, *shares]
        own = first
    rows: list[Light] = []
    slots: list[list[int]] = []
    glows: dict[float, int] = {}
    for light, (diffuse, specular) in zip(lights, layers):
        for index, surface in enumerate([light, *(material.under(light) for material in materials)]):
            slot = [-1] * engine.SLOTS
            slot[engine.MATTE] = held[light.name]
            slot[engine.DIFFUSE_SLOT], slot[engine.SPECULAR_SLOT] = diffuse, specular
            slot[engine.COVER] = own if index == 0 else first + index
            slot[engine.SHAPE] = {SphereLight: engine.BALL, RectLight: engine.RECTANGLE}.get(type(light), engine.POINT)
            slot[engine.MODEL] = engine.GGX if surface.model == "ggx" else engine.PHONG
            slot[engine.ADDS] = int(index > 0)
            if surface.model == "ggx":
                slot[engine.GLOW] = glows.setdefault(ggx_alpha(surface), len(glows))
            rows.append(surface)
            slots.append(slot)
    return _Rows(
        table=_table(rows),
        slots=np.array(slots, np.int32).reshape(-1, engine.SLOTS),
        mattes=np.stack(stack) if stack else np.empty((0, *size_hw), np.float32),
        glows=np.array([glow_table(alpha, NODES) for alpha in glows], np.float32).reshape(-1, NODES),
    )


def _matte(name: str, asker: str, mattes: Mapping[str, npt.ArrayLike], size_hw: tuple[int, int]) -> Float32:
    if name not in mattes:
        raise ShotError(f"{asker}: matte {name!r} is missing{nearest_hint(name, mattes) or '; there are none'}")
    matte = as_float32(mattes[name], f"matte {name!r}", size_hw=size_hw)
    low, high = float(np.fmin.reduce(matte, axis=None)), float(np.fmax.reduce(matte, axis=None))
    if low < 0 or high > 1:
        raise PassError(f"matte {name!r} must lie in 0 ... 1, got {low if low < 0 else high:.4g}; divide 8-bit values by 255")
    return matte


def _table(lights: Sequence[Light]) -> Float32:
    """The lights as rows of the engine's table; everything that is the same for all pixels is multiplied here, in float64."""
    from stereorelight.engine import light_table as engine

    table = np.zeros((len(lights), engine.COLUMNS), np.float64)
    for row, light in zip(table, lights):
        tint = light.strength * np.array(light.tint)
        row[engine.DIFFUSE : engine.DIFFUSE + 3] = tint * light.diffuse
        if light.model != "lambert":
            lobe = (light.exponent + 2) / 2 if light.normalised and light.model == "phong" else 1.0
            row[engine.SPECULAR : engine.SPECULAR + 3] = tint * light.specular * lobe * np.array(light.specular_tint)
        if light.model == "ggx":
            row[engine.ALPHA2], row[engine.F0], row[engine.IOR] = ggx_alpha(light) ** 2, reflectance(light), light.ior or 0.0
        row[engine.RIM : engine.RIM + 3] = tint * light.rim * np.array(light.rim_color)
        row[engine.RIM_POWER] = light.rim_power
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
        elif isinstance(light, SphereLight):
            row[engine.PLACE : engine.PLACE + 3] = light.position_m
            row[engine.IS_PLACE], row[engine.RADIUS] = 1, light.radius_m
        elif isinstance(light, RectLight):
            row[engine.PLACE : engine.PLACE + 3] = light.position_m
            row[engine.AXIS : engine.AXIS + 3] = light.shines_to
            row[engine.SIDE_U : engine.SIDE_U + 3], row[engine.SIDE_V : engine.SIDE_V + 3] = light.sides
            row[engine.IS_PLACE], row[engine.HALF_U], row[engine.HALF_V] = 1, light.size_m[0] / 2, light.size_m[1] / 2
        else:
            raise ShotError(f"light {light.name!r}: a light of type {type(light).__name__} cannot be shaded")
        if isinstance(light, SpotLight):
            penumbra = max(math.radians(light.penumbra_deg), HARD_EDGE)
            row[engine.AXIS : engine.AXIS + 3] = light.shines_to
            row[engine.EDGE] = math.radians(light.cone_deg / 2) + penumbra
            row[engine.PER_ANGLE] = 1 / penumbra
    return table.astype(np.float32)
