"""Colour spaces by OpenColorIO: what a plate is recorded in to the working space, and on to a display.

In, out: RGB (..., 3) float32.  Working values are scene-linear, unclipped; "linear" always means already in the working space.
Names: those of `space_names`, and every space, alias and role of the config (footage/colour_config.py).  Conversions are
optimised without loss.
sRGB, rec709, rec2020 and gammas are our own formulas (footage/curves.py); OpenColorIO does what primaries are left to change.
Spaces that OpenColorIO holds as tables (Canon Log, Apple Log, LUT files) end where their table ends: values outside are clipped."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float32, UInt8
from stereorelight.errors import PassError, ShotError
from stereorelight.footage import curves
from stereorelight.footage.colour_config import DEFAULT as DEFAULT
from stereorelight.footage.colour_config import STUDIO_CONFIG as STUDIO_CONFIG
from stereorelight.footage.colour_config import ColourSettings as ColourSettings
from stereorelight.footage.colour_config import checked_space as checked_space
from stereorelight.footage.colour_config import config_digest as config_digest
from stereorelight.footage.colour_config import config_key, config_of, config_place, loaded, located, ocio_library, one_line
from stereorelight.footage.colour_config import working_space as working_space
from stereorelight.footage.curves import decode as decode
from stereorelight.footage.curves import encode as encode
from stereorelight.footage.curves import known_spaces as known_spaces
from stereorelight.footage.primaries import PRIMARIES, Chromaticities, matrix_between
from stereorelight.footage.space_names import ALIASES, FORMULAS, REC709, formula_named, hint, plain

LINEAR_SUFFIXES = frozenset({".exr"})
BLOCK_PIXELS = 1 << 15  # fixed, so that the bits do not depend on the number of threads
SAME_MATRIX = 2e-4
TABLE_LOW, TABLE_HIGH = -1.25, 2.25  # every code value of 8 to 12 bit video, through every matrix, lies within
TABLE_ERROR, TABLE_FLOOR = 1e-5, 1e-3


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


def _wrapped(make: Callable[[], Any], what: str, settings: ColourSettings) -> Any:
    ocio = ocio_library()
    try:
        return make().getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS)
    except (ocio.Exception, ocio.ExceptionMissingFile) as error:
        remedy = "; give the config that role, or take colour_space and working both from it" if "aces_interchange" in str(error) else ""
        raise ShotError(f"{config_place(settings)}: {what} cannot be converted: {one_line(error).rstrip('.')}{remedy}") from None


@functools.lru_cache(maxsize=64)
def _processor(source: str, target: str, settings: ColourSettings, _state: object) -> Any:
    (a, name_a), (b, name_b) = located(source, settings), located(target, settings)
    both = ocio_library().Config.GetProcessorFromConfigs
    return _wrapped(lambda: a.getProcessor(name_a, name_b) if a is b else both(a, name_a, b, name_b), f"{source} to {target}", settings)


def _between(source: str, target: str, settings: ColourSettings) -> Any:
    """The lossless processor; kept for as long as the config is the same one."""
    return _processor(source, target, settings, config_key(settings))


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
    config = config_of(settings)
    displays = list(config.getDisplays())
    display = settings.display or config.getDefaultDisplay()
    found = next((d for d in displays if plain(d) == plain(display)), None) or next(
        (d for d in displays if plain(d) == plain(display) + "display"), None
    )
    if found is None:
        raise ShotError(f"display {display!r} is unknown{hint(display, displays, place=config_place(settings))}")
    views = list(config.getViews(found))
    view = settings.view or config.getDefaultView(found)
    seen = next((v for v in views if plain(v) == plain(view)), None)
    if seen is None:
        raise ShotError(f"view {view!r} is unknown for display {found!r}{hint(view, views, place=config_place(settings))}")
    return found, seen


def _display_processor(settings: ColourSettings) -> Any:
    ocio, (display, view), hers = ocio_library(), checked_display(settings), config_of(settings)
    config, name = located(working_space(settings), settings)

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
            studio = loaded("", (0, 0))
            config, own = located(working, settings)
            make = ocio_library().Config.GetProcessorFromConfigs
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


def transfer_table(space: str, settings: ColourSettings = DEFAULT) -> TransferTable | None:
    """The conversion of `space` as curve and matrix, held against `to_working` on samples; None where it is neither.

    Error: 1e-5 of the pixel's largest channel or of 1e-3, by interpolation in full precision.  Raises ShotError.
    """
    return _table(checked_space(space, settings), settings, config_key(settings))


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
