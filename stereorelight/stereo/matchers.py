"""Matchers by name: the toolkit's own, a learned one from an ONNX file, or any that somebody registers.

A matcher is a function of a `Proxy` and a `DisparityRange` that gives the left eye's disparity: (H, W) float32 px,
x_left - x_right, NaN where it has none.  The right eye's comes from the same function on the mirrored pair, so that both
eyes can be checked against each other whoever matched; refinement, confidence and everything after are the same for all.

    register_matcher("mine", lambda options: my_function)        # then DepthSettings(matcher="mine") or --matcher mine:options

A package may do the same with an entry point of the group `stereorelight.matchers`."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stereorelight.arrays import Float32
from stereorelight.errors import PlateError, ShotError, nearest_hint

if TYPE_CHECKING:
    from stereorelight.stereo.match import Match
    from stereorelight.stereo.proxy import Proxy
    from stereorelight.stereo.semi_global import DisparityRange

OWN = "sgbm"
GROUP = "stereorelight.matchers"
Matcher = Callable[["Proxy", "DisparityRange"], Float32]
Maker = Callable[[str], Matcher]


def _onnx(options: str) -> Matcher:
    from stereorelight.stereo.onnx_matcher import onnx_matcher

    return onnx_matcher(options)


_makers: dict[str, Maker] = {"onnx": _onnx}


def register_matcher(name: str, maker: Maker) -> None:
    """Make `name` a matcher.  maker : from what follows the colon of "name:options" ("" without one) to the matcher.

    Raises : ShotError for a name that is taken, or that is no plain word.
    """
    if not name.isidentifier():
        raise ShotError(f"matcher name {name!r} must be one word of letters, digits and _")
    if name == OWN or name in _makers:
        raise ShotError(f"matcher {name!r} is registered already; choose another name")
    _makers[name] = maker


def _offered() -> dict[str, Callable[[], Maker]]:
    """What installed packages offer: name to a loader."""
    return {point.name: point.load for point in entry_points(group=GROUP)}


def matcher_names() -> list[str]:
    """Every matcher that can be asked for."""
    return sorted({OWN, *_makers, *_offered()})


def check_matcher(text: str) -> None:
    """Raises ShotError where `text`, "name" or "name:options", names no matcher; does not load one."""
    name = text.partition(":")[0]
    if name not in matcher_names():
        raise ShotError(f"depth matcher {name!r} is unknown{nearest_hint(name, matcher_names())}")


def matcher_file(text: str) -> Path | None:
    """The file that "onnx:FILE?options" reads; None for every other matcher."""
    name, _, options = text.partition(":")
    return Path(options.partition("?")[0]) if name == "onnx" else None


def from_folder(text: str, folder: Path) -> str:
    """`text` with the file of an onnx matcher taken from `folder`, where it is not absolute."""
    file = matcher_file(text)
    if file is None or str(file) in ("", "."):
        return text
    query = text.partition("?")[2]
    return f"onnx:{folder / file}" + (f"?{query}" if query else "")


def matcher_named(text: str) -> Matcher:
    """The matcher that "name" or "name:options" asks for; not for the toolkit's own.  Raises ShotError, PlateError."""
    check_matcher(text)
    name, _, options = text.partition(":")
    maker = _makers[name] if name in _makers else _offered()[name]()
    return maker(options)


def _checked(disparity: Float32, proxy: Proxy, name: str) -> Float32:
    d = np.asarray(disparity)
    if d.shape != proxy.left_grey.shape or not np.issubdtype(d.dtype, np.floating):
        raise PlateError(f"matcher {name} must give a float disparity of shape {proxy.left_grey.shape}, gave {d.dtype} {d.shape}")
    return np.where(np.isfinite(d), d, np.nan).astype(np.float32)


def match_by(matcher: Matcher, name: str, proxy: Proxy, search: DisparityRange) -> Match:
    """Both eyes by `matcher`.  Raises PlateError where it gives something else than a disparity, or none at all."""
    from stereorelight.stereo.match import Match, everywhere, on_plates

    left = _checked(matcher(proxy, search), proxy, name)
    mirrored = proxy.flipped()
    right = np.ascontiguousarray(_checked(matcher(mirrored, search), mirrored, name)[:, ::-1])
    left, right = on_plates(left, right, proxy)
    for disparity, eye in ((left, "left"), (right, "right")):
        if not np.isfinite(disparity).any():
            raise PlateError(f"matcher {name} found no disparity at all for the {eye} eye between {search.low} and {search.high} px")
    dense = np.clip(everywhere(left), search.low, search.high)
    return Match(left=left, right=right, dense=np.where(np.isfinite(left), left, dense))
