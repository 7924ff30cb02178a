"""Everything in a shot file or a light file that lights: lights and mattes over the shot, the camera's poses, the comp.

In: the tables as read.  Out: a `Setup`, or one ShotError that names file, line, table and key."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from stereorelight.errors import ShotError, StereoRelightError
from stereorelight.light.animate import LightTrack, Moving, light_tracks, moving_table
from stereorelight.light.lights import Light, SpotLight
from stereorelight.light.mattes import FileMatte, Matte, checked_mattes, known_mattes, matte_from_dict

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


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What lights.

    path   : the file that says so; the paths in it are from its folder.
    lights : in the file's order, those that are off included.     mattes : in the file's order.
    camera : None for a camera that stands at the origin of the world.
    """

    path: Path
    lights: tuple[LightTrack, ...] = ()
    mattes: tuple[Moving, ...] = ()
    camera: CameraTable | None = None
    relight: RelightTable = field(default_factory=RelightTable)

    def resolved(self, text: str) -> Path:
        """`text` as a path from the file's folder."""
        return self.path.parent / text

    def with_relight(self, **knobs: Any) -> Setup:
        """The same with these keys of [relight]."""
        return replace(self, relight=RelightTable(**(self.relight.model_dump() | knobs)))

    def layer_names(self) -> list[str]:
        """The light layers of every frame."""
        return [name for track in self.lights for name in track.layer_names()]

    def mattes_at(self, frame: float | None) -> list[Matte]:
        """The mattes of a frame, before anything is read."""
        return [matte_from_dict(moving.at(frame), moving.label) for moving in self.mattes]

    def lights_at_keys(self) -> list[Light]:
        """Every light at each of its keys: all that it may be."""
        return [track.at(frame) for track in self.lights for frame in track.moving.key_frames()]

    def tables(self) -> dict[str, Any]:
        """Plain values of all of it, for receipts."""
        return {
            "lights": [dict(track.moving.table) for track in self.lights],
            "mattes": [dict(moving.table) for moving in self.mattes],
            "camera": None if self.camera is None else self.camera.model_dump(),
            "relight": self.relight.model_dump(),
        }

    def files(self) -> list[str]:
        """The pictures that it names, without those of the camera: as written, patterns included."""
        found = [matte.file for frame in self._matte_frames() for matte in self.mattes_at(frame) if isinstance(matte, FileMatte)]
        found += [light.gobo for light in self.lights_at_keys() if isinstance(light, SpotLight) and light.gobo]
        return list(dict.fromkeys(found))

    def _matte_frames(self) -> list[float | None]:
        return [*sorted({f for m in self.mattes for f in m.key_frames() if f is not None})] or [None]


def _told(where: Where, title: str, index: int, table: Mapping[str, Any], make: Callable[[], T]) -> T:
    """`make()`; a complaint gets the line of the key that it speaks of, or of the table."""
    try:
        return make()
    except StereoRelightError as error:
        named = [k for k in table if isinstance(k, str) and re.search(rf"\b{re.escape(k)}\b", str(error))]
        loc = (title, index, named[0]) if named else (title, index)
        raise ShotError(f"{where(loc)}: {error}") from None


def checked_setup(
    path: Path,
    where: Where,
    *,
    lights: Sequence[Mapping[str, Any]],
    mattes: Sequence[Mapping[str, Any]] = (),
    camera: CameraTable | None = None,
    relight: RelightTable | None = None,
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
    try:
        setup = Setup(path=path, lights=light_tracks(lights), mattes=tuple(movings), camera=camera, relight=relight or RelightTable())
        if given is not None:
            checked_mattes(setup.mattes_at(None), given)
    except StereoRelightError as error:
        raise ShotError(f"{path}: {error}") from None
    if given is not None:
        known = [*given, *(str(moving.table["name"]) for moving in movings)]
        for index, track in enumerate(setup.lights):
            _told(where, "lights", index, track.moving.table, lambda track=track: _matte_known(track, known))  # type: ignore[misc]
    return setup


def _matte_over(table: Mapping[str, Any], index: int) -> Moving:
    label = f"matte {table['name']!r}" if "name" in table else f"matte number {index + 1}"
    moving = moving_table(table, label)
    if moving.stuck:
        raise ShotError(f"{label}: {next(iter(moving.stuck))} cannot go with a pixel; only places of lights can")
    for frame in moving.key_frames():
        matte_from_dict(moving.at(frame), label)
    return moving


def _matte_known(track: LightTrack, known: Sequence[str]) -> None:
    known_mattes([track.at(frame).matte for frame in track.moving.key_frames()], known, f"light {track.name!r}")
