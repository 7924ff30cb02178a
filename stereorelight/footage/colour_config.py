"""The OpenColorIO config that names colour spaces: loaded once, its names found whatever their case, what conversions depend on told.

The config is OpenColorIO's built-in studio config, pinned by name so that a newer library changes nothing: v2.2.0 is the newest
that OpenColorIO 2.4 carries.  A config of the user's own is a file, an "ocio://" address, or "$OCIO"; the environment variable
alone is not obeyed, since a receipt could not tell.  Her names go before ours, except for "linear".
This module and colour.py are the only homes of PyOpenColorIO; it is loaded here."""

from __future__ import annotations

import functools
import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereorelight.errors import ShotError
from stereorelight.footage.space_names import ALIASES, FORMULA_ALIASES, FORMULAS, REC709, config_names, formula_named, hint, plain

STUDIO_CONFIG = "studio-config-v2.2.0_aces-v1.3_ocio-v2.4"


@dataclass(frozen=True, kw_only=True)
class ColourSettings:
    """How plates are decoded and shown.

    working : the scene-linear space that everything is reckoned in.    config : None for the pinned studio config.
    display, view : of the config, for previews; None for the config's default where the other one is given.
    """

    working: str = REC709
    config: str | None = None
    display: str | None = None
    view: str | None = None


DEFAULT = ColourSettings()


def one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@functools.cache
def ocio_library() -> Any:
    import PyOpenColorIO as ocio

    ocio.SetLoggingLevel(ocio.LOGGING_LEVEL_NONE)  # what it says it also raises
    return ocio


@functools.lru_cache(maxsize=8)
def loaded(source: str, stamp: tuple[int, int]) -> Any:
    ocio = ocio_library()
    try:
        return ocio.Config.CreateFromBuiltinConfig(STUDIO_CONFIG) if not source else ocio.Config.CreateFromFile(source)
    except (ocio.Exception, ocio.ExceptionMissingFile, RuntimeError) as error:
        why = re.sub(r"^Error: Loading the OCIO profile .* failed\. |yaml-cpp: error at ", "", one_line(error)).rstrip(".")
        remedy = "mend the file, or leave config out for the studio config"
        raise ShotError(f"{source or STUDIO_CONFIG}: OpenColorIO cannot read this config: {why}; {remedy}") from None


def config_source(settings: ColourSettings) -> str:
    """The file or address of the user's own config, "$OCIO" resolved; empty for the pinned one.  Raises ShotError."""
    source = settings.config or ""
    if source == "$OCIO":
        source = os.environ.get("OCIO", "")
        if not source:
            raise ShotError('config = "$OCIO", but the environment variable OCIO is not set; set it, or name the config file')
    return source


def config_key(settings: ColourSettings) -> tuple[str, tuple[int, int]]:
    """What tells one state of the config from another: its address, and a file's time and size.  Raises ShotError."""
    source = config_source(settings)
    if not source or source.startswith("ocio://"):
        return source, (0, 0)
    path = Path(source)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "there is no such file"
        raise ShotError(f"{source}: {what}; give an OpenColorIO config, config.ocio or .ocioz, or leave it out for the studio config")
    stat = path.stat()
    return source, (stat.st_mtime_ns, stat.st_size)


def config_of(settings: ColourSettings) -> Any:
    return loaded(*config_key(settings))


def config_place(settings: ColourSettings) -> str:
    return config_source(settings) or STUDIO_CONFIG


def all_names(config: Any) -> Iterator[str]:
    ocio = ocio_library()
    for space in config.getColorSpaces(ocio.SEARCH_REFERENCE_SPACE_ALL, ocio.COLORSPACE_ALL):
        yield space.getName()
        yield from space.getAliases()
    yield from config.getRoleNames()


def in_config(name: str, config: Any) -> str | None:
    """The config's own spelling of a space, alias or role, or of the first friendly name's space that it has."""
    for tried in (name, *config_names(name)):
        space = config.getColorSpace(tried)
        if space is not None:
            return str(space.getName())
    wanted = plain(name)
    return next((str(config.getColorSpace(n).getName()) for n in all_names(config) if plain(n) == wanted), None)


def checked_space(space: str, settings: ColourSettings = DEFAULT) -> str:
    """`space` as its config spells it ("LogC3" is "ARRI LogC3 (EI800)"), whatever its case and punctuation.

    Our own names are known without loading a config.  Raises ShotError with the nearest name, or for a broken config.
    """
    name = str(space).strip()
    own = formula_named(name)
    if own == "linear" or (own and settings.config is None):
        return own
    config = config_of(settings)
    found = in_config(name, config) if name else None
    if found is None and own:
        return own
    if found is None:
        known = [*FORMULAS, "linear", "auto", *FORMULA_ALIASES, *(a for a in ALIASES if in_config(a, config)), *all_names(config)]
        raise ShotError(f"colour_space {space!r} is unknown{hint(name, known, place=config_place(settings))}")
    if config.getColorSpace(found).isData():
        raise ShotError(f"colour_space {space!r} is data, not colour; use 'linear' for values that are in the working space already")
    return found


def is_linear(config: Any, name: str) -> bool:
    ocio = ocio_library()
    try:
        return bool(config.isColorSpaceLinear(name, ocio.REFERENCE_SPACE_SCENE))
    except (ocio.Exception, ocio.ExceptionMissingFile):  # its LUT file is missing
        return False


def _not_linear(name: str) -> ShotError:
    return ShotError(f"working space {name!r} is not scene-linear; use 'linear Rec.709', 'ACEScg' or another linear space")


def working_space(settings: ColourSettings = DEFAULT) -> str:
    """The working space's name: "linear Rec.709", or as the config spells it.  Raises ShotError where it is no linear space."""
    if plain(settings.working) == plain(REC709) and settings.config is None:
        return REC709
    config = config_of(settings)
    found = in_config(settings.working, config)
    if found is None:
        if config_names(settings.working) and config.hasRole("aces_interchange"):
            studio = loaded("", (0, 0))
            found, config = in_config(settings.working, studio), studio
        if found is None:
            if formula_named(settings.working) not in (None, "linear"):
                raise _not_linear(settings.working)
            linear = [n for n in config.getColorSpaceNames() if is_linear(config, n)]
            raise ShotError(f"working space {settings.working!r} is unknown in {config_place(settings)}{hint(settings.working, linear, place='it')}")
    if config.getColorSpace(found).isData() or not is_linear(config, found):
        raise _not_linear(settings.working)
    return REC709 if found == ALIASES[REC709][0] else found


def located(name: str, settings: ColourSettings) -> tuple[Any, str]:
    """The config that holds a space, and its name there: the user's, or for linear spaces that hers lacks the pinned one."""
    config = config_of(settings)
    found = in_config(name, config)
    if found is None:
        config = loaded("", (0, 0))
        found = in_config(name, config)
    return config, found or name


def config_digest(settings: ColourSettings = DEFAULT, *spaces: str) -> str:
    """sha256 hex over what conversions depend on: working space, the config's text and its LUT files' bytes, OpenColorIO's version.

    With `spaces` given that are all our own formulas in linear Rec.709, no config takes part.  Displays and views do not.
    """
    working = working_space(settings)
    told = hashlib.sha256(working.encode())
    plain_formulas = spaces and working == REC709 and settings.config is None
    if plain_formulas and all(s.lower() == "auto" or formula_named(s) not in (None, "rec2020") for s in spaces):
        return told.hexdigest()
    config = config_of(settings)
    told.update(f"{ocio_library().__version__}\n{config.serialize()}".encode())
    for file in sorted(_files_of(config)):
        told.update(file.encode())
        told.update(Path(file).read_bytes() if Path(file).is_file() else b"missing")
    archive = config_source(settings)
    if archive.endswith(".ocioz"):
        told.update(Path(archive).read_bytes())
    return told.hexdigest()


def _files_of(config: Any) -> set[str]:
    """Every LUT file that the config names, where it lies now."""
    ocio, context, found = ocio_library(), config.getCurrentContext(), set[str]()

    def walk(transform: Any) -> None:
        if isinstance(transform, ocio.GroupTransform):
            for one in transform:
                walk(one)
        elif isinstance(transform, ocio.FileTransform):
            # Looked for here: the library remembers what it once found or missed.
            name = context.resolveStringVar(transform.getSrc())
            places = [Path(context.getWorkingDir()) / context.resolveStringVar(place) for place in context.getSearchPaths()]
            tried = [place / name for place in (*places, Path(context.getWorkingDir()))]
            found.add(str(next((path for path in tried if path.is_file()), name)))

    for space in config.getColorSpaces(ocio.SEARCH_REFERENCE_SPACE_ALL, ocio.COLORSPACE_ALL):
        for way in (ocio.COLORSPACE_DIR_TO_REFERENCE, ocio.COLORSPACE_DIR_FROM_REFERENCE):
            walk(space.getTransform(way))
    return found
