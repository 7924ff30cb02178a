"""Left and right plates, frame by frame.

In: two pictures, or two patterns.  Out: a `Pair` a frame; the first frame that one eye lacks is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stereorelight.arrays import Float32
from stereorelight.camera import Eye
from stereorelight.errors import PlateError
from stereorelight.footage.plates import read_pair
from stereorelight.footage.sequence import Sequence, common_frames
from stereorelight.stereo.depth import Recovered, recover
from stereorelight.stereo.rectify import Rectification
from stereorelight.stereo.settings import DepthSettings

EYES: tuple[Eye, Eye] = ("left", "right")
FLIPPED = "plate_flipped_back"


@dataclass(frozen=True, kw_only=True)
class Pair:
    """The two plates of one frame; `number` is None for single pictures."""

    number: int | None
    left: Path
    right: Path

    @property
    def name(self) -> str:
        """What to call the frame: its number, or the left picture's name."""
        return self.left.name if self.number is None else f"{self.number:04d}"


def pairs(left: str | Path, right: str | Path, *, frames: str | None = None) -> tuple[Pair, ...]:
    """Every frame that both eyes have, or those of `frames`.  Raises PlateError naming the first one that an eye lacks."""
    a, b = Sequence.parse(left, view="left"), Sequence.parse(right, view="right")
    numbers = common_frames(a, b, frames)
    if not numbers:
        return (Pair(number=None, left=a.path(), right=b.path()),)
    return tuple(Pair(number=n, left=a.path(n), right=b.path(n)) for n in numbers)


def read_upright(pair: Pair, rectification: Rectification, *, colour_space: str = "auto") -> tuple[Float32, Float32]:
    """Both plates of a frame, scene-linear, a mirrored eye flipped back.

    Raises : PlateError for a picture that is missing or damaged, without a finite value, or not of the rig's size.
    """
    left, right = read_pair(pair.left, pair.right, colour_space=colour_space, rig=rectification.original)
    return rectification.upright(left, "left"), rectification.upright(right, "right")


def recover_pair(
    pair: Pair, plates: tuple[Float32, Float32], rectification: Rectification, *, settings: DepthSettings, eye: Eye = "left"
) -> Recovered:
    """`stereo.depth.recover` of upright plates; its PlateErrors name the two files."""
    try:
        return recover(*plates, rectification, settings=settings, eye=eye)
    except PlateError as error:
        raise PlateError(f"{pair.left} and {pair.right}: {error}") from None


def flip_word(rectification: Rectification, eye: Eye) -> dict[str, str]:
    """A header word for passes that lie on the flipped-back plate of a mirrored eye; none for other plates."""
    return {FLIPPED: "yes"} if rectification.original.mirrored == eye else {}
