"""Light from all around: a map, what it does to a surface, and its layers.

In: P, N, albedo (H, W, 3), an `Environment` made from a picture, `EnvironmentSettings`.  Out: layers (H, W, 3) float32, linear.
Frames: P and N in the scene frame of the camera (x right, y up, it looks down -z); the map's in light/environment_maps.py.
Where P or N is missing every layer is exactly 0; no layer ever holds NaN.
Source: the paper's section 6; its equations 12-15 with the axes put right."""

from __future__ import annotations

import functools
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from stereorelight import lens
from stereorelight.arrays import Float32, Float64, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError, nearest_hint
from stereorelight.light import environment_filter as filters
from stereorelight.light import spherical_harmonics
from stereorelight.light.environment_ball import find_ball
from stereorelight.light.environment_maps import MapKind, directions, latlong_from, latlong_place, sampled
from stereorelight.light.environment_settings import EnvironmentSettings, turn

if TYPE_CHECKING:
    from stereorelight.engine.environment import Table


@dataclass(frozen=True, eq=False)
class Environment:
    """A canonical lat-long map, and what is worked out from it once, when it is first asked for.

    latlong : (H, 2H, 3) float32, scene-linear, finite, >= 0.  Make it with `from_picture`.
    """

    latlong: Float32
    _made: dict[str, Table] = field(default_factory=dict, init=False, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False)

    def __post_init__(self) -> None:
        light = as_float32(self.latlong, "environment map", channels=3)
        if light.shape[1] != 2 * light.shape[0] or light.shape[0] < 2:
            raise PassError(f"environment map must be (H, 2H, 3), got {light.shape}; Environment.from_picture takes other kinds")
        if not np.isfinite(light).all() or light.min() < 0:
            raise PassError("environment map must be finite and not negative; Environment.from_picture says what to do about it")
        object.__setattr__(self, "latlong", light)

    @classmethod
    def from_picture(
        cls,
        picture: npt.ArrayLike,
        *,
        kind: MapKind = "latlong",
        circle_px: tuple[float, float, float] | None = None,
        find_circle: bool = False,
        ball_angle_deg: float = 0.0,
        height: int | None = None,
        bad_values: Literal["refuse", "clamp"] = "refuse",
        name: str = "environment map",
    ) -> Environment:
        """The environment of a lat-long, angular or mirror-ball picture; see `environment_maps.latlong_from` and `EnvironmentSettings`."""
        circle = find_ball(picture) if find_circle else circle_px
        return cls(latlong_from(picture, kind=kind, circle=circle, angle_deg=ball_angle_deg, height=height, bad_values=bad_values, name=name))

    @functools.cached_property
    def harmonics(self) -> Float64:
        """(9, 3) coefficients, `spherical_harmonics.coefficients`."""
        return spherical_harmonics.coefficients(self.latlong)

    @functools.cached_property
    def irradiance(self) -> Float32:
        """(h, 2h, 3) what a white card that faces each direction reads."""
        return filters.irradiance(self.latlong)

    def table(self, name: str) -> Table:
        """The map for the kernel: "exact" and "harmonics" irradiance, or the number of a roughness level.  Safe from several threads."""
        from stereorelight.engine.environment import padded

        with self._lock:
            if name not in self._made:
                if name == "exact":
                    picture = self.irradiance
                elif name == "harmonics":
                    smooth = spherical_harmonics.irradiance(self.harmonics, directions(filters.IRRADIANCE_HEIGHT))
                    picture = np.ascontiguousarray(np.maximum(smooth, 0), dtype=np.float32)
                else:
                    picture = filters.level(self.latlong, int(name))
                self._made[name] = padded(picture)
            return self._made[name]

    def seen(self, d: npt.ArrayLike, *, rotation_deg: tuple[float, float, float] = (0, 0, 0)) -> Float64:
        """(..., 3) the light that comes from directions d (..., 3), of any length."""
        found = np.asarray(d, dtype=np.float64) @ turn(rotation_deg)  # the inverse turn, for rows
        return sampled(self.latlong, latlong_place(found, self.latlong.shape[0]), wraps=True)


def environment_for(settings: EnvironmentSettings, picture: npt.ArrayLike) -> Environment:
    """The environment that `settings` make of their file's `picture` (H, W, 3), scene-linear; complaints name the file."""
    return Environment.from_picture(
        picture,
        kind=settings.kind,
        circle_px=settings.circle_px,
        find_circle=settings.find_circle,
        ball_angle_deg=settings.ball_angle_deg,
        bad_values=settings.bad_values,
        name=settings.file or "environment map",
    )


def level_of(roughness: float) -> tuple[int, float]:
    """The level of the prefiltered chain below `roughness`, and the share of the next one."""
    steps = filters.ROUGHNESS
    k = min(int(np.searchsorted(steps, roughness, side="right")) - 1, len(steps) - 2)
    share = (roughness - steps[k]) / (steps[k + 1] - steps[k])
    return (k + 1, 0.0) if share >= 1 else (k, share)


def environment_layers(
    P: npt.ArrayLike,
    N: npt.ArrayLike,
    albedo: npt.ArrayLike,
    environment: Environment | None,
    settings: EnvironmentSettings,
    *,
    camera: Camera | None = None,
    plate: npt.ArrayLike | None = None,
    mattes: Mapping[str, npt.ArrayLike] | None = None,
    ao: npt.ArrayLike | None = None,
    bent: npt.ArrayLike | None = None,
) -> dict[str, Float32]:
    """`env_diffuse`, `env_reflection` and `env_refraction`, each where its strength is above 0; their sum is the environment's whole effect.

    P, N        : (H, W, 3), scene frame of the camera; metres, unit (any length from 0.7 to 1.4 is made unit).  NaN where unknown.
    albedo      : (H, W, 3), linear; a channel that is NaN or infinite counts as 0.
    environment : may be None where no layer looks at it (`settings.needs_map`).
    camera      : its pose turns a map in world space; it is needed for the plate as backdrop.
    plate       : (H, W, 3), the backdrop; with settings.backdrop "plate".
    mattes      : (H, W) in 0..1 by name; NaN counts as 0.
    ao, bent    : (H, W) and (H, W, 3), as surface/occlusion.py makes them: diffuse is then ao albedo E diffuse irradiance(bent), and reflection
                  is taken times the share of its lobe that is open (Lagarde and de Rousiers 2014, listing 26).  Refraction looks inwards, and stays.
    Returns     : with E = tint 2^exposure, F Fresnel's share (1 for both where `fresnel` is off), R the mirrored and T the refracted eye ray:
                  diffuse = albedo E diffuse irradiance(N), reflection = E F tint map(R), refraction = E (1 - F) tint map(T).
                  A normal that looks away from the eye is turned round for R and T.  Rough maps are those of GGX seen head on.
                  With the plate as backdrop, refraction = (1 - F) tint plate(pixel of P + thickness T); exposure and tint of the map have no
                  part in it.  Under total reflection there is no refraction.
    Raises      : PassError for arrays that do not fit, ShotError for what is missing.
    """
    from stereorelight.engine import environment as engine

    N_ = as_float32(N, "N", channels=3)
    size_hw = (N_.shape[0], N_.shape[1])
    P_ = as_float32(P, "P", channels=3, size_hw=size_hw)
    albedo_ = as_float32(albedo, "albedo", channels=3, size_hw=size_hw)
    if not settings.enabled:
        return {}
    if environment is None and settings.needs_map:
        raise ShotError("environment: there is no map, but a layer looks at it; give file, or set diffuse and reflection to 0")
    on_plate = settings.refraction > 0 and settings.backdrop == "plate"
    if on_plate and (plate is None or camera is None):
        raise ShotError("environment: backdrop 'plate' needs the plate and its camera; give plate= and camera=, or set backdrop = \"environment\"")
    held = _matte(settings, mattes or {}, size_hw)
    numbers = _numbers(settings, camera)
    layers: dict[str, Float32] = {}
    tables: dict[str, Table] = {}
    if settings.diffuse > 0 and environment is not None:
        layers["env_diffuse"] = np.empty_like(N_)
        tables["soft"] = environment.table(settings.diffuse_method)
    if settings.reflection > 0:
        layers["env_reflection"] = np.empty_like(N_)
    if settings.refraction > 0 and not on_plate:
        layers["env_refraction"] = np.empty_like(N_)
    if environment is not None and ("env_reflection" in layers or "env_refraction" in layers):
        level, share = level_of(settings.roughness)
        tables["sharp"] = environment.table(str(level))
        if share > 0:
            tables["rough"] = environment.table(str(level + 1))
            numbers[engine.BLEND] = share
    behind = np.empty_like(N_) if on_plate else None
    if bent is not None and "env_diffuse" in layers:
        along = as_float32(bent, "bent", channels=3, size_hw=size_hw)
        engine.shade(P_, along, albedo_, held, numbers, soft=tables.pop("soft"), diffuse=layers["env_diffuse"])
    engine.shade(
        P_, N_, albedo_, held, numbers, **tables, diffuse=layers.get("env_diffuse") if "soft" in tables else None,
        reflection=layers.get("env_reflection"), refraction=layers.get("env_refraction"), behind=behind,
    )  # fmt: skip
    if behind is not None and camera is not None:
        picture = as_float32(plate, "plate", channels=3, size_hw=size_hw)
        if camera.size_hw != size_hw:
            raise PassError(f"P is {size_hw[1]}x{size_hw[0]}, but its camera {camera.size[0]}x{camera.size[1]}; scale the camera")
        _to_pixels(behind, camera)
        layers["env_refraction"] = np.empty_like(N_)
        engine.from_plate(behind, picture, settings.refraction * np.array(settings.refraction_tint), layers["env_refraction"])
    if ao is not None:
        arrives = np.nan_to_num(as_float32(ao, "ao", size_hw=size_hw))
        if "env_diffuse" in layers:
            layers["env_diffuse"] *= arrives[..., None]
        if "env_reflection" in layers:
            layers["env_reflection"] *= _open_lobe(arrives, P_, N_, settings.roughness)[..., None]
    return layers


def _open_lobe(ao: Float32, P: Float32, N: Float32, roughness: float) -> Float32:
    """(H, W) share of a mirror lobe of this roughness that is open where so much of the hemisphere is."""
    with np.errstate(invalid="ignore", divide="ignore"):
        facing = np.abs((P * N).sum(axis=-1)) / np.sqrt((P * P).sum(axis=-1) * (N * N).sum(axis=-1))
        lobe = (np.clip(np.nan_to_num(facing), 0, 1) + ao) ** np.exp2(-16 * roughness - 1) - 1 + ao
    return np.clip(lobe, 0, 1).astype(np.float32)


def _numbers(settings: EnvironmentSettings, camera: Camera | None) -> Float32:
    """The kernel's numbers; everything that is the same for all pixels is multiplied here, in float64."""
    from stereorelight.engine import environment as engine

    numbers = np.zeros(engine.NUMBERS, np.float64)
    world_from_camera = np.eye(3) if camera is None or settings.space == "camera" else camera.world_from_camera[:3, :3]
    numbers[:9] = (turn(settings.rotation_deg).T @ world_from_camera).reshape(-1)
    numbers[engine.IOR], numbers[engine.MIXED], numbers[engine.THICKNESS] = settings.ior, settings.fresnel, settings.thickness_m
    for at, strength, tint in (
        (engine.DIFFUSE, settings.diffuse, (1.0, 1.0, 1.0)),
        (engine.REFLECTION, settings.reflection, settings.reflection_tint),
        (engine.REFRACTION, settings.refraction, settings.refraction_tint),
    ):
        numbers[at : at + 3] = settings.strength * strength * np.array(tint)
    return numbers.astype(np.float32)


def _matte(settings: EnvironmentSettings, mattes: Mapping[str, npt.ArrayLike], size_hw: tuple[int, int]) -> Float32 | None:
    if settings.matte is None:
        return None
    if settings.matte not in mattes:
        raise ShotError(f"environment: matte {settings.matte!r} is missing{nearest_hint(settings.matte, mattes) or '; there are none'}")
    held = as_float32(mattes[settings.matte], f"matte {settings.matte!r}", size_hw=size_hw)
    low, high = float(np.fmin.reduce(held, axis=None)), float(np.fmax.reduce(held, axis=None))
    if low < 0 or high > 1:
        raise PassError(f"matte {settings.matte!r} must lie in 0 ... 1, got {low if low < 0 else high:.4g}; divide 8-bit values by 255")
    return held


def _to_pixels(behind: Float32, camera: Camera) -> None:
    """Slopes right and down in behind[..., :2] become pixels (u, v), through the lens; row by row where it bends."""
    if not camera.distorts:
        behind[..., :2] *= np.array([camera.fx, camera.fy], np.float32)
        behind[..., :2] += np.array([camera.cx, camera.cy], np.float32)
        return
    for row in behind:
        bent = lens.distort(row[:, :2].astype(np.float64), camera.model, camera.distortion)
        row[:, :2] = bent * (camera.fx, camera.fy) + (camera.cx, camera.cy)
