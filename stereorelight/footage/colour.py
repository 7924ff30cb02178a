"""Colour spaces by OpenColorIO: what a plate is recorded in to the working space, and on to a display; the only home of PyOpenColorIO.

In, out: RGB (..., 3) float32.  Working values are scene-linear, unclipped; "linear" always means already in the working space.
Names: those of `space_names`, and every space, alias and role of the config.  The config is OpenColorIO's built-in studio
config, pinned by name so that a newer library changes nothing: v2.2.0 is the newest that OpenColorIO 2.4 carries.  A config of
the user's own is a file, an "ocio://" address, or "$OCIO"; the environment variable alone is not obeyed, since a receipt
could not tell.  Her names go before ours, except for "linear".  Conversions are optimised without loss.
sRGB, rec709, rec2020 and gammas are our own formulas (footage/curves.py); OpenColorIO does what primaries are left to change.
Spaces that OpenColorIO holds as tables (Canon Log, Apple Log, LUT files) end where their table ends: values outside are clipped."""

from __future__ import annotations

import functools
import hashlib
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, UInt8
from stereorelight.errors import PassError, ShotError
from stereorelight.footage import curves
from stereorelight.footage.curves import decode as decode
from stereorelight.footage.curves import encode as encode
from stereorelight.footage.curves import known_spaces as known_spaces
from stereorelight.footage.primaries import PRIMARIES, Chromaticities, matrix_between
from stereorelight.footage.space_names import ALIASES, FORMULA_ALIASES, FORMULAS, REC709, config_names, formula_named, hint, plain

STUDIO_CONFIG = "studio-config-v2.2.0_aces-v1.3_ocio-v2.4"
LINEAR_SUFFIXES = frozenset({".exr"})
BLOCK_PIXELS = 1 << 15  # fixed, so that the bits do not depend on the number of threads
SAME_MATRIX = 2e-4
TABLE_LOW, TABLE_HIGH = -1.25, 2.25  # every code value of 8 to 12 bit video, through every matrix, lies within
TABLE_ERROR, TABLE_FLOOR = 1e-5, 1e-3


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


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferTable:
    """A conversion as one curve for every channel and a matrix after it.

    table  : (n,) float32, the curve at even steps from `low` to `high`, good to 1e-5 by linear interpolation.
    matrix : (3, 3) float32, working = matrix @ curve(encoded), or None where it is the identity.
    """

    low: float
    high: float
    table: Float32
    matrix: Float32 | None


DEFAULT = ColourSettings()


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@functools.cache
def _ocio() -> Any:
    import PyOpenColorIO as ocio

    ocio.SetLoggingLevel(ocio.LOGGING_LEVEL_NONE)  # what it says it also raises
    return ocio


@functools.lru_cache(maxsize=8)
def _loaded(source: str, stamp: tuple[int, int]) -> Any:
    ocio = _ocio()
    try:
        return ocio.Config.CreateFromBuiltinConfig(STUDIO_CONFIG) if not source else ocio.Config.CreateFromFile(source)
    except (ocio.Exception, ocio.ExceptionMissingFile, RuntimeError) as error:
        why = re.sub(r"^Error: Loading the OCIO profile .* failed\. |yaml-cpp: error at ", "", _one_line(error)).rstrip(".")
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


def _key(settings: ColourSettings) -> tuple[str, tuple[int, int]]:
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


def _config(settings: ColourSettings) -> Any:
    return _loaded(*_key(settings))


def _place(settings: ColourSettings) -> str:
    return config_source(settings) or STUDIO_CONFIG


def _all_names(config: Any) -> Iterator[str]:
    ocio = _ocio()
    for space in config.getColorSpaces(ocio.SEARCH_REFERENCE_SPACE_ALL, ocio.COLORSPACE_ALL):
        yield space.getName()
        yield from space.getAliases()
    yield from config.getRoleNames()


def _in_config(name: str, config: Any) -> str | None:
    """The config's own spelling of a space, alias or role, or of the first friendly name's space that it has."""
    for tried in (name, *config_names(name)):
        space = config.getColorSpace(tried)
        if space is not None:
            return str(space.getName())
    wanted = plain(name)
    return next((str(config.getColorSpace(n).getName()) for n in _all_names(config) if plain(n) == wanted), None)


def checked_space(space: str, settings: ColourSettings = DEFAULT) -> str:
    """`space` as its config spells it ("LogC3" is "ARRI LogC3 (EI800)"), whatever its case and punctuation.

    Our own names are known without loading a config.  Raises ShotError with the nearest name, or for a broken config.
    """
    name = str(space).strip()
    own = formula_named(name)
    if own == "linear" or (own and settings.config is None):
        return own
    config = _config(settings)
    found = _in_config(name, config) if name else None
    if found is None and own:
        return own
    if found is None:
        known = [*FORMULAS, "linear", "auto", *FORMULA_ALIASES, *(a for a in ALIASES if _in_config(a, config)), *_all_names(config)]
        raise ShotError(f"colour_space {space!r} is unknown{hint(name, known, place=_place(settings))}")
    if config.getColorSpace(found).isData():
        raise ShotError(f"colour_space {space!r} is data, not colour; use 'linear' for values that are in the working space already")
    return found


def _is_linear(config: Any, name: str) -> bool:
    ocio = _ocio()
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
    config = _config(settings)
    found = _in_config(settings.working, config)
    if found is None:
        if config_names(settings.working) and config.hasRole("aces_interchange"):
            studio = _loaded("", (0, 0))
            found, config = _in_config(settings.working, studio), studio
        if found is None:
            if formula_named(settings.working) not in (None, "linear"):
                raise _not_linear(settings.working)
            linear = [n for n in config.getColorSpaceNames() if _is_linear(config, n)]
            raise ShotError(f"working space {settings.working!r} is unknown in {_place(settings)}{hint(settings.working, linear, place='it')}")
    if config.getColorSpace(found).isData() or not _is_linear(config, found):
        raise _not_linear(settings.working)
    return REC709 if found == ALIASES[REC709][0] else found


def _located(name: str, settings: ColourSettings) -> tuple[Any, str]:
    """The config that holds a space, and its name there: the user's, or for linear spaces that hers lacks the pinned one."""
    config = _config(settings)
    found = _in_config(name, config)
    if found is None:
        config = _loaded("", (0, 0))
        found = _in_config(name, config)
    return config, found or name


def _wrapped(make: Callable[[], Any], what: str, settings: ColourSettings) -> Any:
    ocio = _ocio()
    try:
        return make().getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS)
    except (ocio.Exception, ocio.ExceptionMissingFile) as error:
        remedy = "; give the config that role, or take colour_space and working both from it" if "aces_interchange" in str(error) else ""
        raise ShotError(f"{_place(settings)}: {what} cannot be converted: {_one_line(error).rstrip('.')}{remedy}") from None


@functools.lru_cache(maxsize=64)
def _processor(source: str, target: str, settings: ColourSettings, _state: object) -> Any:
    (a, name_a), (b, name_b) = _located(source, settings), _located(target, settings)
    both = _ocio().Config.GetProcessorFromConfigs
    return _wrapped(lambda: a.getProcessor(name_a, name_b) if a is b else both(a, name_a, b, name_b), f"{source} to {target}", settings)


def _between(source: str, target: str, settings: ColourSettings) -> Any:
    """The lossless processor; kept for as long as the config is the same one."""
    return _processor(source, target, settings, _key(settings))


def _applied(processor: Any, picture: Float32) -> Float32:
    """A new array; rows of pixels are shared out to threads in fixed blocks.  A NaN makes its own pixel NaN, no other."""
    from stereorelight.engine.rows import in_row_blocks

    if picture.shape[-1:] != (3,):
        raise PassError(f"colour conversion takes RGB of shape (..., 3), got {picture.shape}")
    out = np.array(picture, dtype=np.float32, order="C").reshape(-1, 3)
    source = np.ascontiguousarray(picture, dtype=np.float32).reshape(-1, 3)

    def run(first: int, end: int) -> None:
        block = out[first:end]
        processor.applyRGB(block)
        if np.isnan(np.max(source[first:end])):  # tables take NaN for a number
            block[np.isnan(source[first:end]).any(axis=1)] = np.nan

    in_row_blocks(run, len(out), block_rows=BLOCK_PIXELS)
    return out.reshape(picture.shape)


def to_working(encoded: npt.ArrayLike, space: str, settings: ColourSettings = DEFAULT) -> Float32:
    """Scene-linear (..., 3) float32 in the working space; negative and super-white values kept.  Raises ShotError, PassError."""
    name, values = checked_space(space, settings), np.asarray(encoded, dtype=np.float32)
    working = working_space(settings)
    if name == "linear":
        return np.ascontiguousarray(values)
    if name in FORMULAS and formula_named(name) == name:
        curve, name = FORMULAS[name]
        values = curves.decode(values, curve)
    if name == working or (working == REC709 and name == ALIASES[REC709][0]):
        return np.ascontiguousarray(values)
    return _applied(_between(name, working, settings), values)


def from_working(linear: npt.ArrayLike, space: str, settings: ColourSettings = DEFAULT) -> Float32:
    """The inverse of `to_working`, encoded and unclipped.  Raises ShotError, PassError."""
    name, values = checked_space(space, settings), np.asarray(linear, dtype=np.float32)
    working = working_space(settings)
    curve = "linear"
    if name in FORMULAS and formula_named(name) == name:
        curve, name = FORMULAS[name]
    if name not in ("linear", working) and not (working == REC709 and name == ALIASES[REC709][0]):
        values = _applied(_between(working, name, settings), values)
    return curves.encode(values, curve)


def space_of_file(path: str | Path, *, is_float: bool, space: str = "auto", settings: ColourSettings = DEFAULT) -> str:
    """The space of a file's values: `space` itself, or for "auto" linear for float files and sRGB for 8 and 16 bit ones."""
    if space.lower() != "auto":
        return checked_space(space, settings)
    return "linear" if is_float or Path(path).suffix.lower() in LINEAR_SUFFIXES else "sRGB"


def check_colour(settings: ColourSettings, *spaces: str) -> None:
    """Raise ShotError now for what would fail later: the config, the working space, display and view, every conversion of `spaces`."""
    working_space(settings)
    if settings.display or settings.view:
        _display_processor(settings)
    for space in spaces:
        if space.lower() != "auto":
            to_working(np.zeros((1, 3), np.float32), space, settings)


def checked_display(settings: ColourSettings) -> tuple[str, str]:
    """Display and view as the config spells them, its defaults for what is not given.  Raises ShotError with the nearest name."""
    config = _config(settings)
    displays = list(config.getDisplays())
    display = settings.display or config.getDefaultDisplay()
    found = next((d for d in displays if plain(d) == plain(display)), None) or next(
        (d for d in displays if plain(d) == plain(display) + "display"), None
    )
    if found is None:
        raise ShotError(f"display {display!r} is unknown{hint(display, displays, place=_place(settings))}")
    views = list(config.getViews(found))
    view = settings.view or config.getDefaultView(found)
    seen = next((v for v in views if plain(v) == plain(view)), None)
    if seen is None:
        raise ShotError(f"view {view!r} is unknown for display {found!r}{hint(view, views, place=_place(settings))}")
    return found, seen


def _display_processor(settings: ColourSettings) -> Any:
    ocio, (display, view), hers = _ocio(), checked_display(settings), _config(settings)
    config, name = _located(working_space(settings), settings)

    def make() -> Any:
        if config is hers:
            return hers.getProcessor(name, display, view, ocio.TRANSFORM_DIR_FORWARD)
        return ocio.Config.GetProcessorFromConfigs(config, name, hers, display, view, ocio.TRANSFORM_DIR_FORWARD)

    return _wrapped(make, f"{name} to display {display!r}, view {view!r}", settings)


def display_picture(linear: npt.ArrayLike, settings: ColourSettings) -> UInt8:
    """Working-space (H, W, 3) as `settings` show it, (H, W, 3) uint8; NaN is black.  Raises ShotError."""
    shown = _applied(_display_processor(settings), np.asarray(linear, dtype=np.float32))
    return np.rint(np.clip(np.nan_to_num(shown, nan=0.0), 0, 1) * np.float32(255)).astype(np.uint8)


def rec709_from_working(linear: npt.ArrayLike, settings: ColourSettings = DEFAULT) -> Float32:
    """Working-space (..., 3) as linear Rec.709, for pictures shown without a display view.  Raises ShotError."""
    values, working = np.ascontiguousarray(linear, dtype=np.float32), working_space(settings)
    return values if working == REC709 else _applied(_between(working, REC709, settings), values)


def matrix_to(source: str, target: str, settings: ColourSettings) -> npt.NDArray[np.float64]:
    """(3, 3) of the conversion between two linear spaces."""
    if source == target:
        return np.eye(3)
    return np.asarray(_applied(_between(source, target, settings), np.eye(3, dtype=np.float32)), dtype=np.float64).T


def chromaticities(settings: ColourSettings = DEFAULT) -> Chromaticities | None:
    """Primaries and white of the working space, as an EXR header has them; None where the config does not tell.

    A space of the user's own is known by its matrix, where it is one of those in `primaries.PRIMARIES`.
    """
    working = working_space(settings)
    if working == REC709:
        return PRIMARIES[ALIASES[REC709][0]]
    if working in PRIMARIES and settings.config is None:
        return PRIMARIES[working]
    try:
        for name, primaries in PRIMARIES.items():
            studio = _loaded("", (0, 0))
            config, own = _located(working, settings)
            make = _ocio().Config.GetProcessorFromConfigs
            to_known = _wrapped(functools.partial(make, config, own, studio, name), working, settings)
            if np.abs(_applied(to_known, np.eye(3, dtype=np.float32)) - np.eye(3)).max() < SAME_MATRIX:
                return primaries
    except ShotError:  # no interchange role: nothing is known of its primaries
        return None
    return None


def from_primaries(linear: npt.ArrayLike, source: Chromaticities, settings: ColourSettings = DEFAULT) -> Float32:
    """Linear RGB of stated primaries to the working space; other whites are adapted by Bradford.  Raises ShotError."""
    target = chromaticities(settings)
    if target is None:
        raise ShotError(f"working space {settings.working!r} tells no primaries; give its config the role aces_interchange")
    return np.ascontiguousarray(np.asarray(linear, np.float32) @ matrix_between(source, target).T.astype(np.float32))


def config_digest(settings: ColourSettings = DEFAULT, *spaces: str) -> str:
    """sha256 hex over what conversions depend on: working space, the config's text and its LUT files' bytes, OpenColorIO's version.

    With `spaces` given that are all our own formulas in linear Rec.709, no config takes part.  Displays and views do not.
    """
    working = working_space(settings)
    told = hashlib.sha256(working.encode())
    plain_formulas = spaces and working == REC709 and settings.config is None
    if plain_formulas and all(s.lower() == "auto" or formula_named(s) not in (None, "rec2020") for s in spaces):
        return told.hexdigest()
    config = _config(settings)
    told.update(f"{_ocio().__version__}\n{config.serialize()}".encode())
    for file in sorted(_files_of(config)):
        told.update(file.encode())
        told.update(Path(file).read_bytes() if Path(file).is_file() else b"missing")
    archive = config_source(settings)
    if archive.endswith(".ocioz"):
        told.update(Path(archive).read_bytes())
    return told.hexdigest()


def _files_of(config: Any) -> set[str]:
    """Every LUT file that the config names, where it lies now."""
    ocio, context, found = _ocio(), config.getCurrentContext(), set[str]()

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


def transfer_table(space: str, settings: ColourSettings = DEFAULT) -> TransferTable | None:
    """The conversion of `space` as curve and matrix, held against `to_working` on samples; None where it is neither.

    Error: 1e-5 of the pixel's largest channel or of 1e-3, by interpolation in full precision.  Raises ShotError.
    """
    return _table(checked_space(space, settings), settings, _key(settings))


@functools.lru_cache(maxsize=16)
def _table(name: str, settings: ColourSettings, _state: object) -> TransferTable | None:
    if name == "linear":
        return None

    def run(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return to_working(values.astype(np.float32), name, settings).astype(np.float64)

    rng = np.random.default_rng(0)
    # Columns from pixels that differ in one channel only; the curve from greys, in the units of green.
    grey = run(np.linspace(0.1, 0.9, 9)[:, None].repeat(3, axis=1))
    if not np.isfinite(grey).all() or abs(grey[-1, 1]) < 1e-6:
        return None
    scale = grey[-1] / grey[-1, 1]
    dark, bright = np.full(3, 0.1), np.eye(3) * 0.8 + 0.1
    step = grey[-1, 1] - grey[0, 1]
    matrix = ((run(bright) - run(dark[None])) / step).T
    if step == 0 or np.abs(matrix.sum(axis=1) - scale).max() > 1e-4:
        return None
    identity = np.abs(matrix - np.eye(3)).max() < 2e-6
    samples = rng.uniform(-0.07, 1.1, (4096, 3))
    samples[:1024] = rng.uniform(TABLE_LOW, TABLE_HIGH, (1024, 1))
    samples = samples.astype(np.float32).astype(np.float64)
    wanted = run(samples)
    allowed = TABLE_ERROR * np.maximum(np.abs(wanted).max(axis=1, keepdims=True), TABLE_FLOOR)
    for size in (1 << 12, 1 << 14, 1 << 16, 1 << 18):
        at = np.linspace(TABLE_LOW, TABLE_HIGH, size + 1)
        table = run(at[:, None].repeat(3, axis=1))[:, 1].astype(np.float32)
        got = np.interp(samples, at, table)
        got = got if identity else got @ matrix.T
        if (np.abs(got - wanted) <= allowed).all():
            table.setflags(write=False)
            return TransferTable(low=TABLE_LOW, high=TABLE_HIGH, table=table, matrix=None if identity else matrix.astype(np.float32))
    return None
