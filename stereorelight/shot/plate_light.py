"""The plate's own light over a shot: estimated once on one frame, divided out of every frame, and what a new light must be to sit beside it.

In: [relight] albedo and its keys; a frame's plate, passes and mattes.  Out: the albedo that lights fall on, and what lights are multiplied by.
The light is kept in the world, so that it stays on the set while the camera moves; what a frame gets does not depend on which part of
the shot is run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from stereorelight.arrays import Float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, PlateError, ShotError
from stereorelight.footage.plates import read_plate
from stereorelight.light.albedo import albedo_of, exposure_of
from stereorelight.light.checks import Vector
from stereorelight.light.edges import mixed
from stereorelight.light.estimate import estimate_lighting
from stereorelight.light.plate_lighting import PlateLighting
from stereorelight.passes import Flag
from stereorelight.surface.emitters import Emitter
from stereorelight.surface.visibility import ShadowScene

Passes = Mapping[str, npt.NDArray[Any]]
ENOUGH_PX = 320  # width at which light is estimated
BODY_M = 0.25  # how far things go on behind what is seen of them: a head does
WORDS = ("plate", "estimated")


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """A frame: its number, plate, passes, posed camera, and its mattes where they are known already."""

    number: int | None
    plate: Float32
    passes: Passes
    camera: Camera | None
    mattes: Mapping[str, Float32] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Colour:
    """What lights fall on: albedo (H, W, 3), the strength that lights are multiplied by, and the light that was divided out, if any."""

    albedo: Float32
    exposure: float = 1.0
    light: PlateLighting | None = None


def shadow_of(Z: Float32, N: Float32, camera: Camera, Z_sigma: Float32 | None = None) -> Callable[[Vector, Vector | None], Float32]:
    """What `estimate_lighting` asks: the share of a lamp that arrives, by a march through the depth."""
    scene = ShadowScene(Z=Z, N=N, camera=camera, Z_sigma=Z_sigma, thickness_m=BODY_M)

    def visible(towards: Vector, place: Vector | None) -> Float32:
        lamp = Emitter(name="plate", shape="direction", towards=towards) if place is None else Emitter(name="plate", shape="place", position_m=place)
        return scene.shadow(lamp, method="march").lit

    return visible


def _believed(passes: Passes, matte: Float32 | None, size_hw: tuple[int, int]) -> Float32:
    """(H, W) how far to believe a frame: its subject's matte, less what is guessed."""
    weight = np.ones(size_hw, np.float32) if matte is None else matte.copy()
    if "confidence" in passes:
        weight *= np.nan_to_num(passes["confidence"], nan=0.0)
    if "flags" in passes:
        weight[(np.asarray(passes["flags"]).astype(np.int64) & int(Flag.FILLED)) != 0] = 0
    # Normals beside a depth edge, and what a matte mixes, say little.
    return np.asarray(weight * (ndimage.minimum_filter(weight, 3) > 0.25), np.float32)


def estimated(reference: Reference, *, matte: Float32 | None, albedo_level: float) -> PlateLighting:
    """The light of a frame, in the frame of its camera.

    matte  : (H, W) of the ground that is asked, or None.     Raises : PassError, ShotError.
    """
    plate, passes = reference.plate, reference.passes
    h, w = plate.shape[:2]
    by = max(1, round(w / ENOUGH_PX))
    size = (w // by, h // by)

    def picked(a: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.ascontiguousarray(a[by // 2 :: by, by // 2 :: by][: size[1], : size[0]])

    whole = plate[: size[1] * by, : size[0] * by]
    small = np.ascontiguousarray(whole.reshape(size[1], by, size[0], by, 3).mean(axis=(1, 3)), np.float32)
    N, P = picked(passes["N"]), picked(passes["P"])
    visible = None
    if reference.camera is not None and np.isfinite(P[..., 2]).any():
        sigma = picked(passes["Z_sigma"]) if "Z_sigma" in passes else None
        camera = reference.camera.cropped(0, 0, (size[0] * by, size[1] * by)).scaled(size)
        visible = shadow_of(-P[..., 2], N, camera, sigma)
    weight = picked(_believed(passes, matte, (h, w)))
    return estimate_lighting(small, N, P=P, weight=weight, visible=visible, albedo_level=albedo_level)


def divided(
    light: PlateLighting, plate: Float32, passes: Passes, camera: Camera | None, *, most_gain: float, matte: Float32 | None = None
) -> Float32:
    """The albedo of a frame under `light`, which is in the frame of its camera.

    matte : (H, W) of the ground that told the light.  Elsewhere other lamps may shine, so light is taken to be even there, at its level.
    """
    visible = None
    if light.lamp.max() > 0 and light.towards is not None and camera is not None:
        visible = shadow_of(-passes["P"][..., 2], passes["N"], camera, passes.get("Z_sigma"))(light.towards, light.place_m)
    more = {name: passes[name] for name in ("N_sigma", "confidence") if name in passes}
    if matte is None:
        return albedo_of(plate, light, passes["N"], passes["P"], visible=visible, most_gain=most_gain, **more)
    more["confidence"] = matte * np.nan_to_num(more.get("confidence", np.ones_like(matte)), nan=0.0)
    own = albedo_of(plate, light, passes["N"], passes["P"], visible=visible, most_gain=most_gain, **more)
    return mixed(own, plate / np.float32(light.level), matte)


class PlateLights:
    """The plate's own light for the frames of a shot; it is found when it is first asked for, and kept."""

    def __init__(
        self,
        knobs: Any,
        *,
        path: Any,
        file: Callable[[str, int | None], Any],
        colour: Any,
        reference: Callable[[], Reference] | None,
        mattes: Callable[[Reference], Mapping[str, Float32]],
    ) -> None:
        """knobs : the [relight] table.   path : of the file that holds it.   file : a pattern's path on a frame.   mattes : of a frame, by name."""
        self.knobs, self.path, self.file, self.colour, self.reference, self.mattes = knobs, path, file, colour, reference, mattes
        self._found: tuple[PlateLighting, float] | None = None

    @property
    def asked(self) -> bool:
        """Whether lights fall on anything but the plate itself."""
        return bool(self.knobs.albedo != "plate") and self.knobs.mode != "multiply"

    def of_shot(self, frame: Reference) -> tuple[PlateLighting, float]:
        """The light in the world, and the exposure; of the shot's reference, or where there is none of `frame`, the first that is asked."""
        if self._found is None:
            reference = frame if self.reference is None else self.reference()
            if self.knobs.albedo == "estimated":
                held = self._matte(reference)
                light = estimated(reference, matte=held, albedo_level=self.knobs.albedo_level)
                pose = np.eye(4) if reference.camera is None else reference.camera.world_from_camera
                self._found = light.moved(pose), light.level
            else:
                albedo = self._read(reference.number, reference.plate)
                light = PlateLighting(around=np.zeros((9, 3)), lamp=np.zeros(3), level=1.0)
                self._found = light, exposure_of(reference.plate, albedo, self._matte(reference))
        return self._found

    def _matte(self, frame: Reference) -> Float32 | None:
        name = self.knobs.albedo_matte
        if name is None:
            return None
        mattes = self.mattes(frame) if frame.mattes is None else frame.mattes
        if name not in mattes:
            raise ShotError(f"{self.path}: relight: albedo_matte {name!r} is missing; there are: {', '.join(mattes) or 'none'}")
        return mattes[name]

    def _read(self, number: int | None, plate: Float32) -> Float32:
        path = self.file(self.knobs.albedo, number)
        albedo = read_plate(path, colour=self.colour)
        if albedo.shape != plate.shape:
            size = f"{albedo.shape[1]}x{albedo.shape[0]}"
            raise PlateError(f"{path}: albedo is {size} pixels, the plate {plate.shape[1]}x{plate.shape[0]}; make it on the upright plate")
        return np.maximum(albedo, 0)

    def colour_of(self, frame: Reference) -> Colour:
        """What lights fall on in a frame.  Raises ShotError, PassError, PlateError."""
        knobs, plate = self.knobs, frame.plate
        if knobs.mode == "multiply":
            return Colour(albedo=np.ones_like(plate))
        if knobs.albedo == "plate":
            return Colour(albedo=plate)  # a light of 1 on the plate as albedo is in its range already
        try:
            light, exposure = self.of_shot(frame)
            gain = exposure if knobs.match_exposure else 1.0
            if knobs.albedo != "estimated":
                return Colour(albedo=self._read(frame.number, plate), exposure=gain)
            if frame.camera is not None:
                light = light.moved(np.linalg.inv(frame.camera.world_from_camera))
            matte = self._matte(frame)
            albedo = divided(light, plate, frame.passes, frame.camera, most_gain=knobs.albedo_gain, matte=matte)
            return Colour(albedo=albedo, exposure=gain, light=light)
        except (PassError, ShotError) as error:
            told = str(error)
            raise type(error)(told if told.startswith(str(self.path)) else f"{self.path}: {told}") from None
