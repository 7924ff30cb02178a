"""A frame under the lights of its shot: lights by keys and by picture points, mattes, gobos, poses, and the comp.

In: a `Setup`, and a frame's plate, passes and camera.  Out: a `Lit`: every layer, the relit plate, alpha and trust.
Everything lies on the upright left plate; mattes from files are painted on that too."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32
from stereorelight.camera import Camera, Rig
from stereorelight.comp import faded, light_alpha, relight, trust
from stereorelight.errors import PassError, PlateError, ShotError
from stereorelight.footage.colour import ColourSettings
from stereorelight.footage.plates import read_plate
from stereorelight.footage.sequence import Sequence as Pattern
from stereorelight.interchange.poses import Poses, of_left_eye, read_poses
from stereorelight.light.animate import LightTrack, Stuck
from stereorelight.light.checks import Vector
from stereorelight.light.edges import parted, parting
from stereorelight.light.environment import Environment, environment_layers
from stereorelight.light.environment_settings import EnvironmentSettings
from stereorelight.light.gobo import gobo_factor
from stereorelight.light.lights import Light, SpotLight
from stereorelight.light.mattes import FileMatte, matte_arrays
from stereorelight.light.painted import LitSphere, Outline, Paint, Toon, inked, toned
from stereorelight.light.place import place_of
from stereorelight.light.shade import group_layers, light_layers
from stereorelight.light.subsurface import scatter_layers, scatters
from stereorelight.shot.lit import Lit, both_sides
from stereorelight.shot.matte_files import matte_channel
from stereorelight.shot.plate_light import PlateLights, Reference
from stereorelight.shot.points import Points
from stereorelight.shot.receipt import file_digest
from stereorelight.shot.setup import Setup
from stereorelight.shot.shadows import Casting, shadow_layers
from stereorelight.surface.occlusion import Occlusion

Array = npt.NDArray[Any]


@dataclass(kw_only=True, eq=False)
class Lighting:
    """What lights the frames of a shot.

    colour : of the plates; gobos are read into the same working space.      rig : for poses of the right eye.
    points : the picture points that lights go with; without it only those that are not tracked.
    digest : sha256 of a frame's left plate, for the keys of tracked points.
    reference : the frame that speaks for the plate's own light (the first that is lit where None), and plain values that stand for it.
    """

    setup: Setup
    colour: ColourSettings | None = None
    rig: Rig | None = None
    points: Points | None = None
    digest: Callable[[int], str] | None = None
    reference: tuple[Callable[[], Reference], Callable[[], Any]] | None = None
    _pictures: dict[Path, Float32] = field(default_factory=dict)
    _maps: dict[Any, Environment] = field(default_factory=dict)

    @cached_property
    def plate_lights(self) -> PlateLights:
        """The light that the plates were shot in, where it is asked for."""

        def mattes(frame: Reference) -> dict[str, Float32]:
            return self.mattes(frame.number, frame.passes, frame.camera)

        return PlateLights(
            self.setup.relight,
            path=self.setup.path,
            file=self._path,
            colour=self.colour,
            reference=None if self.reference is None else self.reference[0],
            mattes=mattes,
        )

    @cached_property
    def poses(self) -> Poses | None:
        """Where the camera stands; None at the origin of the world.  Raises RigError."""
        told = self.setup.camera
        if told is None:
            return None
        return read_poses(self.setup.resolved(told.file), unit_m=told.unit_m, order=told.rotation_order).shifted(told.shift_frames)

    def camera(self, camera: Camera, number: int | None) -> Camera:
        """`camera` where it stands on frame `number`.  Raises RigError."""
        if self.poses is None or self.setup.camera is None:
            return camera
        return replace(camera, world_from_camera=of_left_eye(self.poses.at(number), self.setup.camera.eye, self.rig))

    def check(self, numbers: Sequence[int | None]) -> None:
        """What would stop a run on any of these frames, before any work.  Raises ShotError, PlateError, RigError."""
        for number in numbers:
            for track in self.setup.lights:
                try:
                    track.at(number)
                except ShotError as error:
                    raise ShotError(f"{self.setup.path}: {error}") from None
            if self.poses is not None:
                self.poses.at(number)
            for file in self._files(number):
                if not file.is_file():
                    raise PlateError(f"{file}: file missing; {self.setup.path} names it as a matte, a gobo, a lit sphere or the environment")
        for track, stuck in self._stuck():
            known = None if self.points is None else self.points.numbers
            if stuck.frame is not None and known is not None and stuck.frame not in known:
                have = f"{known[0]}-{known[-1]}" if known else "a single picture, without numbers: leave frame out"
                raise ShotError(f"{self.setup.path}: light {track.name!r}: frame {stuck.frame} of its pixel is not in the shot, which has {have}")

    def _stuck(self) -> list[tuple[LightTrack, Stuck]]:
        return [(track, stuck) for track in self.setup.lights for stuck in track.moving.stuck.values()]

    def _path(self, text: str, number: int | None) -> Path:
        return Pattern.parse(self.setup.resolved(text), must_exist=False).path(number)

    def _files(self, number: int | None) -> list[Path]:
        """The mattes, gobos and environment of a frame."""
        return [self._path(name, number) for name in self.setup.files_at(number)]

    def key(self, number: int | None) -> Any:
        """Plain values that stand for all that the light of a frame depends on beyond the shot file; None where there is nothing."""
        files = [file_digest(file) for file in self._files(number)]
        pose = None if self.poses is None else self.poses.at(number).tolist()
        ways = []
        for track, stuck in self._stuck():
            if self.points is not None and self.digest is not None and not track.dark(number):
                ways.append([self.digest(n) for n in self.points.way(stuck, number)])
        asked = self.plate_lights.asked and self.reference is not None
        told = [self.reference[1]()] if asked and self.reference is not None else []
        return [files, pose, ways, *told] if files or pose or any(ways) or told else None

    def lights(self, number: int | None, P: Array, camera: Camera | None) -> list[Light]:
        """The lights of a frame.  Raises ShotError naming light and frame."""
        found = []
        for track in self.setup.lights:

            def place(stuck: Stuck, space: str, track: LightTrack = track) -> Vector:
                try:
                    pixel = stuck.pixel if self.points is None else self.points.at(stuck, number)
                    return place_of(stuck, P, pixel, space, np.eye(4) if camera is None else camera.world_from_camera)
                except ShotError as error:
                    where = "" if number is None else f" on frame {number}"
                    raise ShotError(f"{self.setup.path}: light {track.name!r}{where}: {error}") from None

            try:
                # A light that is dark here has no need of a place, so a point may leave the picture then.
                found.append(track.at(number, None if track.dark(number) else place))
            except ShotError as error:
                raise error if str(error).startswith(str(self.setup.path)) else ShotError(f"{self.setup.path}: {error}") from None
        return found

    def mattes(
        self,
        number: int | None,
        passes: Mapping[str, Array],
        camera: Camera | None,
        given: Mapping[str, npt.ArrayLike] | None = None,
        whole: Mapping[str, Float32] | None = None,
    ) -> dict[str, Float32]:
        """The mattes of a frame by name; `whole` takes the place of some that are given or of files.  Raises ShotError, PlateError, PassError."""
        size_hw, stead = passes["P"].shape[:2], whole or {}
        given = {name: stead.get(name, array) for name, array in (given or {}).items()}

        def read(matte: FileMatte) -> Float32:
            if matte.name in stead:
                return 1 - stead[matte.name] if matte.invert else stead[matte.name]
            path = self._path(matte.file, number)
            array = matte_channel(path, matte.channel)
            if array.shape != size_hw:
                size = f"{array.shape[1]}x{array.shape[0]}"
                raise PlateError(f"{path}: matte {matte.name!r} is {size} pixels, the plate {size_hw[1]}x{size_hw[0]}; make it on the plate")
            return array

        try:
            return matte_arrays(self.setup.mattes_at(number), passes, camera=camera, read=read, given=given)
        except (PassError, ShotError) as error:
            raise type(error)(f"{self.setup.path}: {error}") from None

    def _thrown(self, layers: dict[str, Float32], light: Light, number: int | None, P: Array, camera: Camera | None) -> dict[str, Float32]:
        """`layers` with a spot's own through its gobo."""
        own = {name: layer for name, layer in layers.items() if name.rpartition("_")[0] == f"light_{light.name}"}
        if not (isinstance(light, SpotLight) and light.gobo and light.enabled):
            return layers
        return layers | faded(own, gobo_factor(P, light, self._picture(light.gobo, number), camera=camera))

    def _picture(self, name: str, number: int | None) -> Float32:
        """A gobo or a lit sphere, read once, and kept while frames ask for it."""
        path = self._path(name, number)
        if path not in self._pictures:
            asked = set(self._files(number))
            self._pictures = {kept: picture for kept, picture in self._pictures.items() if kept in asked}
            self._pictures[path] = np.maximum(read_plate(path, colour=self.colour), 0)
        return self._pictures[path]

    def _painted(
        self,
        paints: Sequence[Paint],
        number: int | None,
        passes: Mapping[str, Array],
        plate: Float32,
        mattes: Mapping[str, Float32],
        shading: Callable[[Sequence[str]], Float32],
    ) -> dict[str, Float32]:
        """The layers of lit spheres and toon ramps.  shading : of lights by name, on white."""
        made: dict[str, Float32] = {}
        for paint in paints:
            if not isinstance(paint, (LitSphere, Toon)):
                continue
            seen = self._picture(paint.file, number) if isinstance(paint, LitSphere) else shading(paint.of)
            try:
                layer = toned(paint, seen, P=passes["P"], N=passes["N"], plate=plate)
            except PassError as error:
                raise PassError(f"{self._path(paint.file, number)}: {error}" if isinstance(paint, LitSphere) else str(error)) from None
            made[paint.layer] = layer if paint.matte is None else faded({"": layer}, np.nan_to_num(mattes[paint.matte]))[""]
        return made

    def _around(
        self,
        around: EnvironmentSettings,
        number: int | None,
        passes: Mapping[str, Array],
        albedo: Float32,
        plate: Float32,
        mattes: Mapping[str, Float32],
        camera: Camera | None,
        seen: Occlusion | None,
    ) -> dict[str, Float32]:
        """The layers of light from all around."""
        if self.setup.relight.mode == "multiply" and around.refraction > 0 and around.backdrop == "plate":
            raise ShotError(
                f'{self.setup.path}: environment: backdrop "plate" is the plate itself, which mode "multiply" cannot gain; use mode "add"'
            )
        try:
            found = self._map(around, number) if around.file is not None and around.needs_map else None
            open_ = {} if seen is None or not around.occlusion else {"ao": seen.ao, "bent": seen.bent}
            return environment_layers(passes["P"], passes["N"], albedo, found, around, camera=camera, plate=plate, mattes=mattes, **open_)
        except (PassError, ShotError) as error:
            raise type(error)(f"{self.setup.path}: {error}") from None

    def _map(self, around: EnvironmentSettings, number: int | None) -> Environment:
        """The map of a frame; the last one is kept, with what was convolved from it."""
        path = self._path(str(around.file), number)
        shape = {key: getattr(around, key) for key in ("kind", "circle_px", "find_circle", "ball_angle_deg", "bad_values")}
        key = (path, tuple(shape.values()))
        if key not in self._maps:
            self._maps.clear()
            self._maps[key] = Environment.from_picture(read_plate(path, colour=self.colour), name=str(path), **shape)
        return self._maps[key]

    def lit(
        self,
        number: int | None,
        *,
        plate: Float32,
        passes: Mapping[str, Array],
        camera: Camera | None,
        given: Mapping[str, npt.ArrayLike] | None = None,
    ) -> Lit:
        """The frame under its lights.

        plate  : (H, W, 3), upright.      passes : P, N; Z, confidence and N_sigma as far as there are any.
        camera : as posed by `camera`; None where nobody knows.    given  : mattes from elsewhere, by name.
        Raises : ShotError, PassError, PlateError, RigError.
        """
        knobs = self.setup.relight
        lights = self.lights(number, passes["P"], camera)
        mattes = self.mattes(number, passes, camera, given)
        try:
            cover, unsure = parting(plate, passes, mattes, edges=knobs.edges, edge_px=knobs.edge_px)
            sides = None if cover is None else parted(plate, cover, passes, edge_px=knobs.edge_px, unsure=unsure)
        except (PassError, ShotError) as error:
            raise type(error)(f"{self.setup.path}: {error}") from None
        if cover is None or sides is None:
            return self._lit(number, plate, passes, camera, lights, mattes)
        found = []
        for side, whole in zip(sides, (1.0, 0.0)):
            # The matte says which side a pixel is of: on its own side the subject is whole, on the other it is not there.
            own = {str(knobs.edges): np.full(cover.shape, whole, np.float32)} if knobs.edges != "depth" else {}
            held = self.mattes(number, side.passes, camera, given, whole=own)
            found.append(self._lit(number, side.plate, side.passes, camera, lights, held))
        return both_sides(found[0], found[1], sides, cover, plate, knobs)

    def _lit(
        self,
        number: int | None,
        plate: Float32,
        passes: Mapping[str, Array],
        camera: Camera | None,
        lights: Sequence[Light],
        mattes: Mapping[str, Float32],
    ) -> Lit:
        """The frame, or one side of it, under lights that have found their places."""
        knobs = self.setup.relight
        P, N = passes["P"], passes["N"]
        colour = self.plate_lights.colour_of(Reference(number=number, plate=plate, passes=passes, camera=camera, mattes=mattes))
        albedo, materials = colour.albedo, self.setup.materials_at(number)
        paints = self.setup.painted_at(number)
        casting = Casting(shadows=self.setup.shadows, passes=passes, camera=camera, mattes=mattes)
        own, shining = ({light.name for light in found(number)} for found in (self.setup.own_at, self.setup.shining_at))

        try:
            thrown = {light.name: casting.cast(light) for light in lights if light.name in shining and light.shadow != "off"}
            seen = casting.occlusion(self.setup.occlusion) if self.setup.occludes else None
        except (PassError, ShotError) as error:
            raise type(error)(f"{self.setup.path}: {error}") from None
        factors = {name: shadow.factor for name, shadow in thrown.items()}

        def lit_by(names: Collection[str], on: Float32) -> dict[str, Float32]:
            some = [light for light in lights if light.name in names]
            # Light that goes through a surface is reckoned on white, and meets the albedo where it comes out.
            soft = [light for light in some if scatters(light, materials)]
            layers = light_layers(
                P, N, on, [light for light in some if light not in soft], mattes=mattes, materials=materials, camera=camera, shadows=factors
            )
            if soft:
                layers |= light_layers(P, N, np.ones_like(on), soft, mattes=mattes, materials=materials, camera=camera, shadows=factors)
            for light in some:
                layers = self._thrown(layers, light, number, P, camera)
            if soft:
                layers = scatter_layers(layers, P, N, soft, materials=materials, mattes=mattes)
                layers |= {name: layers[name] * on for light in soft if (name := f"light_{light.name}_diffuse") in layers}
            return layers

        def shading(names: Sequence[str]) -> Float32:
            asked = shining & set(names) if names else shining
            white = [layer for name, layer in lit_by(asked, np.ones_like(plate)).items() if name.endswith("_diffuse")]
            return np.sum(white, axis=0, dtype=np.float32) if white else np.zeros_like(plate)

        layers = lit_by(own, albedo)
        around = self.setup.environment_at(number)
        if around is not None and around.enabled:
            soft_around = scatters(None, materials)
            made = self._around(around, number, passes, np.ones_like(plate) if soft_around else albedo, plate, mattes, camera, seen)
            if soft_around and "env_diffuse" in made:
                made = scatter_layers(made, P, N, (), materials=materials, mattes=mattes)
                made["env_diffuse"] *= albedo
            layers |= made
        layers |= self._painted(paints, number, passes, albedo, mattes, shading)
        if colour.exposure != 1:
            layers = {n: layer * np.float32(colour.exposure) if n.startswith(("light_", "env_")) else layer for n, layer in layers.items()}
        # The same layers on every frame, in one order: a light or a highlight that is off on this frame alone is black.
        layers = {name: layers[name] if name in layers else np.zeros_like(plate) for name in self.setup.layer_names}
        trusted = None
        if knobs.fade > 0:
            trusted = trust(
                passes.get("confidence"),
                passes.get("N_sigma"),
                fade=knobs.fade,
                full_confidence=knobs.fade_confidence,
                most_sigma_deg=knobs.fade_sigma_deg,
            )
            layers = faded(layers, trusted)
        for paint in paints:
            if isinstance(paint, Outline):
                white = {"add": plate, "multiply": albedo, "light_only": np.zeros_like(plate)}[knobs.mode]
                beneath = relight(white, layers, plate_gain=knobs.plate_gain)
                ink = inked(paint, beneath, P=P, N=N, matte=None if paint.matte is None else mattes[paint.matte])
                layers[paint.layer] = ink if trusted is None else faded({"": ink}, trusted)[""]
        alpha = None
        if knobs.mode == "light_only":
            held = [light.matte for light in lights if light.name in shining] + ([around.matte] if around is not None and around.enabled else [])
            held += [paint.matte for paint in paints]
            alpha = light_alpha(N, [None if name is None else mattes[name] for name in held], trust=trusted)
        beauty = relight(plate, layers, plate_gain=knobs.plate_gain, mode=knobs.mode)
        return Lit(
            layers=layers,
            beauty=beauty,
            alpha=alpha,
            trust=trusted,
            groups=group_layers(layers, lights),
            colour=colour if self.plate_lights.asked else None,
            shadows=shadow_layers(self.setup.shadow_names, thrown, (plate.shape[0], plate.shape[1])),
            surface={} if seen is None else {"ao": seen.ao, "bent": seen.bent},
        )


def lighting_of(
    setup: Setup,
    *,
    numbers: Sequence[int],
    plate: Callable[[int], Float32],
    digest: Callable[[int], str] | None = None,
    colour: ColourSettings | None = None,
    rig: Rig | None = None,
    reference: tuple[Callable[[], Reference], Callable[[], Any]] | None = None,
) -> Lighting:
    """The lighting of a shot whose frames are `numbers`, with their upright left plates for the points that lights go with.

    reference : as `Lighting` has it.
    """
    stuck = [stuck for track in setup.lights for stuck in track.moving.stuck.values()]
    points = Points(stuck=stuck, numbers=sorted(numbers), plate=plate) if stuck else None
    return Lighting(setup=setup, colour=colour, rig=rig, points=points, digest=digest, reference=reference)
