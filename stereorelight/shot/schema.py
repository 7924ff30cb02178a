"""The tables of a shot file and of a light file, checked key by key.

In: a TOML file.  Out: a frozen `Shot` whose paths are absolute, or one ShotError that names the file, the line, the key
and the nearest known one.  Lengths in metres, angles in degrees.  What each key means stands in shot/template.py, too,
where the user reads it."""

from __future__ import annotations

import re
import tomllib
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from stereorelight.errors import ShotError, StereoRelightError, nearest_hint
from stereorelight.footage.clip import PACKED, is_movie
from stereorelight.footage.colour import ColourSettings, check_colour, checked_display, working_space
from stereorelight.footage.sequence import frame_range
from stereorelight.light.lights import Light
from stereorelight.shot.setup import CameraTable, OcclusionTable, RelightTable, Setup, ShadowsTable, checked_setup
from stereorelight.stereo.matchers import check_matcher, from_folder
from stereorelight.stereo.settings import DepthSettings

HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
KEY = re.compile(r"^\s*[\"']?([A-Za-z0-9_-]+)[\"']?\s*(?:=|\.)")
NAME = r"^[A-Za-z][A-Za-z0-9_-]*$"
T = TypeVar("T", bound=BaseModel)


class Table(BaseModel):
    """One table of a shot file: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class PlatesTable(Table):
    left: str = Field(min_length=1)
    right: str | None = Field(default=None, min_length=1)
    frames: str | None = None
    layout: Literal["auto", "separate", "side-by-side", "side-by-side-half", "top-bottom", "top-bottom-half"] = "auto"
    swap_eyes: bool = False
    sync: Literal["auto", "frames", "timecode"] = "auto"
    right_late_frames: int = 0
    first_frame: int = 1
    rate: float | None = Field(default=None, gt=0)
    matrix: Literal["auto", "bt601", "bt709", "bt2020"] = "auto"
    levels: Literal["auto", "video", "full"] = "auto"
    colour_space: str = "auto"
    right_colour_space: str | None = None
    match_colour: Literal["off", "global", "local"] = "off"


class ColourTable(Table):
    working: str = "linear Rec.709"
    config: str | None = None
    display: str | None = None
    view: str | None = None


class RigTable(Table):
    file: str = Field(default="rig.json", min_length=1)
    drift: Literal["off", "shot", "frame"] = "off"
    drift_frames: str | None = None
    drift_window: int = Field(default=9, ge=1)


class DepthTable(Table):
    quality: Literal["draft", "standard", "fine"] = "standard"
    near_m: float | None = None
    far_m: float | None = None
    consistency_px: float = 1.0
    fill: bool = True
    matcher: str = Field(default="sgbm", min_length=1)
    time: Literal["on", "off"] = "on"
    time_window: int = 2
    subject: str | None = Field(default=None, min_length=1)
    ignore: str | None = Field(default=None, min_length=1)


class SurfaceTable(Table):
    method: Literal["plane", "difference"] = "plane"
    shading: Literal["auto", "off", "on"] = "auto"
    shading_strength: float = Field(default=1.0, gt=0, le=4)

    @model_validator(mode="before")
    @classmethod
    def _strength_as_shading(cls, told: Any) -> Any:
        """`shading = 0.5` is on, at that strength; 0 is off."""
        value = told.get("shading") if isinstance(told, dict) else None
        if isinstance(value, bool) or not isinstance(value, int | float):
            return told
        return told | ({"shading": "off"} if value == 0 else {"shading": "on", "shading_strength": value})


class RepairTable(Table):
    name: str = Field(pattern=NAME)
    kind: Literal["constant", "plane", "pins", "clean_plate"]
    frame: int | None = None
    frames: str | None = None
    matte: str | None = Field(default=None, min_length=1)
    polygon: list[Annotated[list[float], Field(min_length=2, max_length=2)]] = []
    distance_m: float | None = Field(default=None, gt=0)
    pins: list[Annotated[list[float], Field(min_length=3, max_length=3)]] = []
    depth: str | None = Field(default=None, min_length=1)


class OutputTable(Table):
    folder: str = Field(default="out", min_length=1)
    name: str | None = Field(default=None, pattern=NAME)
    colour: Literal["half", "float"] = "half"
    previews: bool = True
    movies: list[Literal["relit", "wipe", "plate", "depth", "normals", "anaglyph"]] = []
    movie_codec: Literal["h264", "h265", "prores", "prores4444", "dnxhr", "ffv1"] = "h264"
    preview_near_m: float | None = Field(default=None, gt=0)
    preview_far_m: float | None = Field(default=None, gt=0)


class ShotTables(Table):
    version: Literal[1] = 1
    plates: PlatesTable
    colour: ColourTable = ColourTable()
    rig: RigTable = RigTable()
    depth: DepthTable = DepthTable()
    repairs: list[RepairTable] = []
    surface: SurfaceTable = SurfaceTable()
    camera: CameraTable | None = None
    relight: RelightTable = RelightTable()
    shadows: ShadowsTable = ShadowsTable()
    occlusion: OcclusionTable | None = None
    lights: list[dict[str, Any]] = []
    mattes: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    environment: dict[str, Any] | None = None
    painted: list[dict[str, Any]] = []
    output: OutputTable = OutputTable()


class LightTables(Table):
    lights: list[dict[str, Any]] = []
    mattes: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    environment: dict[str, Any] | None = None
    painted: list[dict[str, Any]] = []
    camera: CameraTable | None = None
    relight: RelightTable = RelightTable()
    shadows: ShadowsTable = ShadowsTable()
    occlusion: OcclusionTable | None = None


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A shot file that has been read and checked.

    path   : the shot file; every path in it is relative to its folder.
    tables : the file's tables with defaults filled in.
    depth  : the settings of depth recovery.
    colour : the working space, the OpenColorIO config, and the view of the previews.
    setup  : the lights, in the file's order, those that are off included; their mattes, the camera's poses, the comp.
    """

    path: Path
    tables: ShotTables
    depth: DepthSettings
    colour: ColourSettings
    setup: Setup

    @property
    def lights(self) -> tuple[Light, ...]:
        """The lights at their first keys."""
        return tuple(track.first for track in self.setup.lights)

    def resolved(self, text: str) -> Path:
        """`text` as a path from the shot file's folder."""
        return self.path.parent / text

    @property
    def shades(self) -> bool:
        """Whether the plate's shading has a say in normals: as the file says; "auto" where depth is `fine`."""
        told = self.tables.surface
        return told.method == "plane" and (told.shading == "on" or (told.shading == "auto" and self.depth.quality == "fine"))

    @property
    def folder(self) -> Path:
        """Where results go."""
        return self.resolved(self.tables.output.folder)

    @property
    def name(self) -> str:
        """First part of every result's file name: [output] name, or the shot file's folder where that is a word."""
        if self.tables.output.name:
            return self.tables.output.name
        folder = re.sub(r"[^A-Za-z0-9_-]+", "_", self.path.resolve().parent.name).strip("_")
        return folder if re.match(NAME, folder) else "shot"


def key_lines(text: str) -> dict[tuple[str | int, ...], int]:
    """Line (from 1) of every table header and key of a TOML text: ("depth", "quality"), ("lights", 0, "name")."""
    lines: dict[tuple[str | int, ...], int] = {}
    counts: dict[str, int] = {}
    table: tuple[str | int, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := HEADER.match(line):
            name = header[2]
            if header[1] == "[[":
                counts[name] = counts.get(name, -1) + 1
                table = (name, counts[name])
                lines.setdefault((name,), number)
            else:
                table = tuple(part.strip().strip("\"'") for part in name.split("."))
            lines.setdefault(table, number)
        elif key := KEY.match(line):
            lines.setdefault((*table, key[1]), number)
    return lines


def _field_at(model: type[BaseModel], loc: tuple[str | int, ...]) -> tuple[type[BaseModel], Any]:
    """The innermost table that `loc` lies in, and the annotation of the key it names (None where unknown)."""
    here, annotation = model, None
    for part in loc:
        if isinstance(part, int) and typing.get_origin(annotation) is list:
            annotation = typing.get_args(annotation)[0]
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                here = annotation
            continue
        field = here.model_fields.get(str(part))
        annotation = field.annotation if field else None
        if typing.get_origin(annotation) is types.UnionType:  # a table that may be left out
            annotation = next((a for a in typing.get_args(annotation) if isinstance(a, type) and issubclass(a, BaseModel)), annotation)
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            here = annotation
    return here, annotation


def _choices(annotation: Any) -> list[str]:
    origin = typing.get_origin(annotation)
    if origin is Literal:
        return [str(a) for a in typing.get_args(annotation)]
    if origin in (typing.Union, types.UnionType):
        return [c for a in typing.get_args(annotation) for c in _choices(a)]
    return []


def _where(path: Path, lines: dict[tuple[str | int, ...], int], loc: tuple[str | int, ...]) -> str:
    for end in range(len(loc), 0, -1):
        if loc[:end] in lines:
            return f"{path}:{lines[loc[:end]]}"
    return str(path)


def _key_path(loc: tuple[str | int, ...]) -> str:
    words = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc]
    return "".join(words).lstrip(".")


def _explained(error: Any, model: type[BaseModel]) -> str:
    """One pydantic complaint in our words."""
    loc = tuple(error["loc"])
    table, annotation = _field_at(model, loc)
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        known = [n for n in table.model_fields if n != "version"]
        what = "table" if isinstance(value, (dict, list)) and len(loc) == 1 else "key"
        return f"unknown {what} {str(loc[-1])!r}{nearest_hint(str(loc[-1]), known)}"
    if kind == "missing":
        what = "table" if len(loc) == 1 else "key"
        return f"{what} {_key_path(loc)!r} is missing; add it, as in the shot file that `stereorelight demo` writes"
    if kind == "literal_error":
        return f"{_key_path(loc)} = {value!r} is unknown{nearest_hint(str(value), _choices(annotation))}"
    if kind == "string_pattern_mismatch":
        return f"{_key_path(loc)} = {value!r}: use letters, digits, _ and -, beginning with a letter"
    message = str(error["msg"]).replace("Input should be a valid", "must be a").replace("Input should be", "must be")
    return f"{_key_path(loc)} = {value!r}: {message[0].lower()}{message[1:]}"


def _read_toml(path: Path) -> tuple[dict[str, Any], str]:
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text), text
    except FileNotFoundError:
        raise ShotError(f"{path}: file missing; `stereorelight demo` and `stereorelight synth` write one to begin with") from None
    except OSError as error:
        raise ShotError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise ShotError(f"{path}: not a text file; a shot file is TOML") from None
    except tomllib.TOMLDecodeError as error:
        raise ShotError(f"{path}: not valid TOML: {str(error)[0].lower()}{str(error)[1:]}") from None


def _checked_tables(path: Path, model: type[T]) -> tuple[T, dict[tuple[str | int, ...], int]]:
    data, text = _read_toml(path)
    lines = key_lines(text)
    try:
        return model.model_validate(data), lines
    except ValidationError as problem:
        problems = problem.errors()
        # A misspelt key is told before the one that is missing for it.
        first = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
        raise ShotError(f"{_where(path, lines, tuple(first['loc']))}: {_explained(first, model)}") from None


def _checked_colour(path: Path, tables: ShotTables, lines: dict[tuple[str | int, ...], int]) -> ColourSettings:
    """The colour settings; every name in them and of the plates is known to the config."""
    told = tables.colour
    config = told.config
    if config and "://" not in config and not config.startswith("$"):
        config = str(path.parent / config)
    colour = ColourSettings(working=told.working, config=config, display=told.display, view=told.view)
    plates = tables.plates
    checks: list[tuple[tuple[str | int, ...], Callable[[], object]]] = [
        (("colour", "working"), lambda: working_space(colour)),
        (("plates", "colour_space"), lambda: check_colour(colour, plates.colour_space)),
        (("plates", "right_colour_space"), lambda: check_colour(colour, plates.right_colour_space or "auto")),
    ]
    if colour.display or colour.view:
        checks.append((("colour", "view"), lambda: checked_display(colour)))
    for key, check in checks:
        try:
            check()
        except StereoRelightError as error:
            raise ShotError(f"{_where(path, lines, key)}: {error}") from None
    return colour


def read_light_file(path: str | Path) -> Setup:
    """A file of [[lights]], [[mattes]], [[materials]], [environment], [[painted]], [camera], [relight], [shadows] and [occlusion].

    Raises : ShotError naming file and line."""
    path = Path(path)
    tables, lines = _checked_tables(path, LightTables)
    if "lights" not in tables.model_fields_set and tables.environment is None and not tables.painted:
        raise ShotError(f"{path}: table 'lights' is missing; add [[lights]], [environment] or [[painted]]")
    return _setup(path, tables, lines, given=None)


def _setup(path: Path, tables: LightTables | ShotTables, lines: dict[tuple[str | int, ...], int], given: Sequence[str] | None = ()) -> Setup:
    def where(loc: tuple[str | int, ...]) -> str:
        return _where(path, lines, loc)

    return checked_setup(
        path,
        where,
        lights=tables.lights,
        mattes=tables.mattes,
        materials=tables.materials,
        environment=tables.environment,
        painted=tables.painted,
        camera=tables.camera,
        relight=tables.relight,
        shadows=tables.shadows,
        occlusion=tables.occlusion,
        given=given,
    )


def read_lights(path: str | Path) -> tuple[Light, ...]:
    """The lights of a light file, at their first keys.  Raises ShotError naming file and line."""
    return tuple(track.first for track in read_light_file(path).lights)


def read_shot(path: str | Path) -> Shot:
    """The shot in file `path`, every key checked.  Raises ShotError naming file, line, key and the nearest known one."""
    path = Path(path)
    tables, lines = _checked_tables(path, ShotTables)
    try:
        depth = DepthSettings(**tables.depth.model_dump(exclude={"subject", "ignore"}) | {"matcher": from_folder(tables.depth.matcher, path.parent)})
        check_matcher(depth.matcher)
    except StereoRelightError as error:
        key = next((k for k in DepthTable.model_fields if k in str(error)), "quality")
        raise ShotError(f"{_where(path, lines, ('depth', key))}: {error}") from None
    plates = tables.plates
    if plates.right is None and not (plates.layout in PACKED or is_movie(plates.left) or "%" in plates.left or plates.left.lower().endswith(".exr")):
        raise ShotError(f"{_where(path, lines, ('plates',))}: key 'plates.right' is missing; name the right eye's plate, or say its layout")
    colour = _checked_colour(path, tables, lines)
    if tables.rig.drift_frames is not None:
        try:
            frame_range(tables.rig.drift_frames)
        except StereoRelightError as error:
            raise ShotError(f"{_where(path, lines, ('rig', 'drift_frames'))}: {error}") from None
    output = tables.output
    if output.preview_near_m and output.preview_far_m and output.preview_near_m >= output.preview_far_m:
        where = _where(path, lines, ("output", "preview_near_m"))
        raise ShotError(f"{where}: output.preview_near_m must be less than preview_far_m, got {output.preview_near_m:g} and {output.preview_far_m:g}")
    return Shot(path=path, tables=tables, depth=depth, colour=colour, setup=_setup(path, tables, lines))
