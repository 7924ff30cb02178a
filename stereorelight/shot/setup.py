"""Everything in a shot file or a light file that lights: lights and mattes over the shot, the camera's poses, the comp.

In: the tables as read.  Out: a `Setup`, or one ShotError that names file, line, table and key."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from stereorelight.errors import ShotError, StereoRelightError, nearest_hint
from stereorelight.light.animate import LightTrack, Moving, light_tracks, moving_table
from stereorelight.light.environment_settings import EnvironmentSettings, environment_from_dict
from stereorelight.light.lights import Light, SpotLight
from stereorelight.light.materials import Material, materials_from_dicts
from stereorelight.light.mattes import FileMatte, Matte, checked_mattes, known_mattes, matte_from_dict
from stereorelight.light.painted import PREFIX, LitSphere, Paint, Toon, painted_from_dict, replaced

ENVIRONMENT_PARTS = ("diffuse", "reflection", "refraction")  # layers of it, each with a strength of its own
Where = Callable[[tuple[str | int, ...]], str]  # file and line of a key
T = TypeVar("T")


class CameraTable(BaseModel):
    """Where the camera stands: `file` of poses, of which eye, and what a .chan does not say itself."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    file: str = Field(min_length=1)
    eye: Literal["left", "right"] = "left"
    shift_frames: int = 0
    unit_m: float | None = Field(default=None, gt=0)
    rotation_order: str | None = None


class RelightTable(BaseModel):
    """How light and plate come together."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    plate_gain: float = Field(default=1.0, ge=0)
    mode: Literal["add", "multiply", "light_only"] = "add"
    fade: float = Field(default=0.0, ge=0, le=1)
    fade_confidence: float = Field(default=0.5, gt=0, le=1)
    fade_sigma_deg: float = Field(default=40.0, ge=1, le=180)
    albedo: str = Field(default="plate", min_length=1)
    albedo_matte: str | None = Field(default=None, min_length=1)
    albedo_frame: int | None = None
    albedo_level: float = Field(default=0.36, ge=0.01, le=1)
    albedo_gain: float = Field(default=8.0, ge=1, le=1000)
    match_exposure: bool = False
    edges: str | None = Field(default=None, min_length=1)
    edge_px: float | None = Field(default=None, ge=0, le=100)


class ShadowsTable(BaseModel):
    """What stands where no camera saw: `thickness` "thin", millimetres, or "matte", the subject's, which `matte` names; and outside the frame."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    thickness: Literal["thin", "matte"] | Annotated[float, Field(ge=0, le=1e6)] = "thin"
    matte: str | None = Field(default=None, min_length=1)
    outside: Literal["unknown", "open"] = "unknown"


class OcclusionTable(BaseModel):
    """Ambient occlusion and bent normals."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    enabled: bool = True
    radius_m: float = Field(default=0.5, gt=0, le=1e6)
    falloff: float = Field(default=1.0, ge=0, le=10)
    samples: int = Field(default=16, ge=1, le=1024)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What lights.

    path   : the file that says so; the paths in it are from its folder.
    lights : in the file's order, those that are off included.     mattes : in the file's order.
    materials   : surfaces by matte.     environment : light from all around, or None.     painted : lit spheres, toon ramps, ink.
    camera : None for a camera that stands at the origin of the world.
    """

    path: Path
    lights: tuple[LightTrack, ...] = ()
    mattes: tuple[Moving, ...] = ()
    materials: tuple[Moving, ...] = ()
    environment: Moving | None = None
    painted: tuple[Moving, ...] = ()
    camera: CameraTable | None = None
    relight: RelightTable = field(default_factory=RelightTable)
    shadows: ShadowsTable = field(default_factory=ShadowsTable)
    occlusion: OcclusionTable | None = None

    def resolved(self, text: str) -> Path:
        """`text` as a path from the file's folder."""
        return self.path.parent / text

    def with_relight(self, **knobs: Any) -> Setup:
        """The same with these keys of [relight]."""
        return replace(self, relight=RelightTable(**(self.relight.model_dump() | knobs)))

    @cached_property
    def shadow_names(self) -> list[str]:
        """The lights that cast a shadow on any frame, so that every frame has its layers."""
        made = []
        for track in self.lights:
            casting = [light for frame in track.moving.key_frames() if (light := track.at(frame)).enabled and light.shadow != "off"]
            made += [track.name] if casting else []
        return made

    @property
    def casts(self) -> bool:
        """Whether any frame needs the surface as what casts shadows."""
        return bool(self.shadow_names) or self.occludes

    @property
    def occludes(self) -> bool:
        """Whether ambient occlusion is asked for: by [occlusion], or by the environment on any frame, so that all frames have its passes."""
        if self.occlusion is not None and self.occlusion.enabled:
            return True
        return self.environment is not None and any(
            found.enabled and found.occlusion for at in self.environment.key_frames() if (found := self.environment_at(at))
        )

    @cached_property
    def layer_names(self) -> list[str]:
        """The light layers of every frame: all that any frame has."""
        movings = [*(track.moving for track in self.lights), *self.materials, *self.painted]
        frames: list[float | None] = [*sorted({f for moving in movings for f in moving.key_frames() if f is not None})]
        made = {name for frame in frames or [None] for light in self.own_at(frame) for name in self._layers_of(light, frame)}
        of_lights = [name for track in self.lights for part in ("diffuse", "specular") if (name := f"light_{track.name}_{part}") in made]
        around = [self.environment_at(frame) for frame in self.environment.key_frames()] if self.environment else []
        of_all = [f"env_{part}" for part in ENVIRONMENT_PARTS if any(found and found.enabled and getattr(found, part) > 0 for found in around)]
        shown = {paint.layer for frame in frames or [None] for paint in self.painted_at(frame)}
        return [*of_lights, *of_all, *(layer for moving in self.painted if (layer := f"{PREFIX}{moving.table['name']}") in shown)]

    def shining_at(self, frame: float | None) -> list[Light]:
        """The lights that have layers on a frame, their stuck places stood in for: those that are on, or the solo ones alone."""
        lights = [light for track in self.lights if (light := track.at(frame)).enabled]
        return [light for light in lights if light.solo] or lights

    def own_at(self, frame: float | None) -> list[Light]:
        """Those of them that have layers of their own: a toon ramp may stand for some."""
        shining = self.shining_at(frame)
        taken = replaced(self.painted_at(frame), [light.name for light in shining])
        return [light for light in shining if light.name not in taken]

    def _layers_of(self, light: Light, frame: float | None) -> list[str]:
        shines = light.shines or any(material.under(light).shines for material in self.materials_at(frame))
        return [f"light_{light.name}_{part}" for part in (("diffuse", "specular") if shines else ("diffuse",))]

    def materials_at(self, frame: float | None) -> tuple[Material, ...]:
        """The materials of a frame.  Raises ShotError."""
        return materials_from_dicts([moving.at(frame) for moving in self.materials])

    def environment_at(self, frame: float | None) -> EnvironmentSettings | None:
        """The light from all around on a frame.  Raises ShotError."""
        return None if self.environment is None else environment_from_dict(self.environment.at(frame))

    def painted_at(self, frame: float | None) -> list[Paint]:
        """The painted layers that are on, in the file's order.  Raises ShotError."""
        return [paint for moving in self.painted if (paint := painted_from_dict(moving.at(frame), moving.label)).enabled]

    def mattes_at(self, frame: float | None) -> list[Matte]:
        """The mattes of a frame, before anything is read."""
        return [matte_from_dict(moving.at(frame), moving.label) for moving in self.mattes]

    def files_at(self, frame: int | None) -> list[str]:
        """The pictures that a frame needs, as written, patterns included."""
        lights, around = [track.at(frame) for track in self.lights], self.environment_at(frame)
        names = [matte.file for matte in self.mattes_at(frame) if isinstance(matte, FileMatte)]
        names += [light.gobo for light in lights if isinstance(light, SpotLight) and light.enabled and light.gobo]
        names += [self.relight.albedo] if self.relight.albedo not in ("plate", "estimated") else []
        names += [around.file] if around is not None and around.file is not None and around.needs_map else []
        names += [paint.file for paint in self.painted_at(frame) if isinstance(paint, LitSphere)]
        return list(dict.fromkeys(names))

    def tables(self) -> dict[str, Any]:
        """Plain values of all of it, for receipts."""
        return {
            "lights": [dict(track.moving.table) for track in self.lights],
            "mattes": [dict(moving.table) for moving in self.mattes],
            "materials": [dict(moving.table) for moving in self.materials],
            "environment": None if self.environment is None else dict(self.environment.table),
            "painted": [dict(moving.table) for moving in self.painted],
            "camera": None if self.camera is None else self.camera.model_dump(),
            "relight": self.relight.model_dump(),
            "shadows": self.shadows.model_dump(),
            "occlusion": None if self.occlusion is None else self.occlusion.model_dump(),
        }


def _told(where: Where, title: str, index: int | None, table: Mapping[str, Any], make: Callable[[], T]) -> T:
    """`make()`; a complaint gets the line of the key that it speaks of, or of the table."""
    try:
        return make()
    except StereoRelightError as error:
        named = [k for k in table if isinstance(k, str) and re.search(rf"\b{re.escape(k)}\b", str(error))]
        loc: tuple[str | int, ...] = (title,) if index is None else (title, index)
        raise ShotError(f"{where((*loc, named[0]) if named else loc)}: {error}") from None


def checked_setup(
    path: Path,
    where: Where,
    *,
    lights: Sequence[Mapping[str, Any]],
    mattes: Sequence[Mapping[str, Any]] = (),
    materials: Sequence[Mapping[str, Any]] = (),
    environment: Mapping[str, Any] | None = None,
    painted: Sequence[Mapping[str, Any]] = (),
    camera: CameraTable | None = None,
    relight: RelightTable | None = None,
    shadows: ShadowsTable | None = None,
    occlusion: OcclusionTable | None = None,
    given: Sequence[str] | None = (),
) -> Setup:
    """The setup that a file's tables say, each checked at every key.

    given  : names of mattes that come from elsewhere; None where they are not known yet, and are looked for with the frame.
    Raises : ShotError naming file, line, table and key.
    """
    for index, table in enumerate(lights):
        _told(where, "lights", index, table, lambda table=table: light_tracks([table]))  # type: ignore[misc]
    movings: list[Moving] = []
    for index, table in enumerate(mattes):
        movings.append(_told(where, "mattes", index, table, lambda table=table, index=index: _matte_over(table, index)))  # type: ignore[misc]
    surfaces: list[Moving] = []
    for index, table in enumerate(materials):
        surfaces.append(_told(where, "materials", index, table, lambda table=table, index=index: _material_over(table, index)))  # type: ignore[misc]
    around = None if environment is None else _told(where, "environment", None, environment, lambda: _environment_over(environment))
    paints: list[Moving] = []
    for index, table in enumerate(painted):
        paints.append(_told(where, "painted", index, table, lambda table=table, index=index: _paint_over(table, index, paints, lights)))  # type: ignore[misc]
    knobs = relight or RelightTable()
    if knobs.mode == "multiply" and (knobs.albedo != "plate" or knobs.match_exposure):
        key = "albedo" if knobs.albedo != "plate" else "match_exposure"
        raise ShotError(f'{where(("relight", key))}: relight: {key} has no part in mode "multiply", a gain on the plate; use mode "add"')
    try:
        setup = Setup(
            path=path,
            lights=light_tracks(lights),
            mattes=tuple(movings),
            materials=tuple(surfaces),
            environment=around,
            painted=tuple(paints),
            camera=camera,
            relight=knobs,
            shadows=shadows or ShadowsTable(),
            occlusion=occlusion,
        )
        setup.materials_at(None)
        check_shadow_names(setup.shadow_names)
        if given is not None:
            checked_mattes(setup.mattes_at(None), given)
    except StereoRelightError as error:
        raise ShotError(f"{path}: {error}") from None
    if given is not None:
        known = [*given, *(str(moving.table["name"]) for moving in movings)]
        asked = {"albedo_matte": knobs.albedo_matte, "edges": None if knobs.edges == "depth" else knobs.edges}
        for key, name in asked.items():
            _told(where, "relight", None, {key: name}, lambda key=key, name=name: known_mattes([name], known, f"relight: {key}"))  # type: ignore[misc]
        for index, track in enumerate(setup.lights):
            _told(where, "lights", index, track.moving.table, lambda track=track: _matte_known(track, known))  # type: ignore[misc]
        for index, moving in enumerate(surfaces):
            held = [str(moving.at(frame)["matte"]) for frame in moving.key_frames()]
            _told(where, "materials", index, moving.table, lambda held=held, moving=moving: known_mattes(held, known, moving.label))  # type: ignore[misc]
        for index, moving in enumerate(paints):
            worn = [painted_from_dict(moving.at(frame), moving.label).matte for frame in moving.key_frames()]
            _told(where, "painted", index, moving.table, lambda worn=worn, moving=moving: known_mattes(worn, known, moving.label))  # type: ignore[misc]
        if setup.shadows.matte is not None:
            told = setup.shadows.model_dump()
            _told(where, "shadows", None, told, lambda: known_mattes([setup.shadows.matte], known, "[shadows]"))
        if around is not None:
            names = [found.matte for frame in around.key_frames() if (found := setup.environment_at(frame))]
            _told(where, "environment", None, around.table, lambda: known_mattes(names, known, "environment"))
    return setup


def check_shadow_names(names: Sequence[str]) -> None:
    """Raises ShotError where two lights' shadow layers would share a name."""
    for name in names:
        if f"{name}_unknown" in names:
            raise ShotError(f"lights {name!r} and {name}_unknown: both would write the layer shadow_{name}_unknown; rename one of them")


def _matte_over(table: Mapping[str, Any], index: int) -> Moving:
    label = f"matte {table['name']!r}" if "name" in table else f"matte number {index + 1}"
    moving = moving_table(table, label)
    if moving.stuck:
        raise ShotError(f"{label}: {next(iter(moving.stuck))} cannot go with a pixel; only places of lights can")
    for frame in moving.key_frames():
        matte_from_dict(moving.at(frame), label)
    return moving


def _material_over(table: Mapping[str, Any], index: int) -> Moving:
    moving = moving_table(table, f"material {table['name']!r}" if "name" in table else f"material number {index + 1}")
    if moving.stuck:
        raise ShotError(f"{moving.label}: {next(iter(moving.stuck))} cannot go with a pixel; only places of lights can")
    for frame in moving.key_frames():
        materials_from_dicts([moving.at(frame)])
    return moving


def _paint_over(table: Mapping[str, Any], index: int, earlier: Sequence[Moving], lights: Sequence[Mapping[str, Any]]) -> Moving:
    moving = moving_table(table, f"painted {table['name']!r}" if "name" in table else f"painted number {index + 1}")
    if moving.stuck:
        raise ShotError(f"{moving.label}: {next(iter(moving.stuck))} cannot go with a pixel; only places of lights can")
    if any(other.table["name"] == table.get("name") for other in earlier):
        raise ShotError(f"{moving.label}: name is taken by an earlier one; names must differ, since they name the layers")
    names = [str(light.get("name")) for light in lights]
    for frame in moving.key_frames():
        paint = painted_from_dict(moving.at(frame), moving.label)
        if isinstance(paint, Toon):
            if not names:
                raise ShotError(f"{moving.label}: a toon ramp is made of lights, and there are none; add [[lights]]")
            for name in paint.of:
                if name not in names:
                    raise ShotError(f"{moving.label}: of names light {name!r}, which is unknown{nearest_hint(name, names)}")
    return moving


def _environment_over(table: Mapping[str, Any]) -> Moving:
    moving = moving_table(table, "environment")
    if moving.stuck:
        raise ShotError(f"environment: {next(iter(moving.stuck))} cannot go with a pixel; only places of lights can")
    for frame in moving.key_frames():
        found = environment_from_dict(moving.at(frame))
        if found.file is None and found.needs_map:
            raise ShotError("environment: file is missing; name the picture of the map, or set diffuse and reflection to 0")
    return moving


def _matte_known(track: LightTrack, known: Sequence[str]) -> None:
    known_mattes([track.at(frame).matte for frame in track.moving.key_frames()], known, f"light {track.name!r}")
