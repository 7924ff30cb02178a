"""Left and right plates, frame by frame.

In: an `Eyes`, or the names of two plates.  Out: a `Pair` a frame; the first frame that one eye lacks is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereorelight.arrays import Float32
from stereorelight.camera import Eye
from stereorelight.errors import PlateError
from stereorelight.footage.clip import Clip
from stereorelight.footage.colour import ColourSettings
from stereorelight.footage.eyes import Eyes, open_eyes
from stereorelight.footage.plates import check_pair
from stereorelight.shot.depths import NOISE
from stereorelight.shot.schema import Shot
from stereorelight.stereo.depth import MatchColour, Recovered, recover
from stereorelight.stereo.hints import Hints
from stereorelight.stereo.rectify import Rectification
from stereorelight.stereo.settings import DepthSettings

EYES: tuple[Eye, Eye] = ("left", "right")
FLIPPED = "plate_flipped_back"
MATCH_NOISE_PX = 0.002  # what matched disparity is off by from pixel to pixel, after its own smoothing; 0.05 made relit faces too smooth


@dataclass(frozen=True, kw_only=True)
class Pair:
    """The two plates of one frame; `number` is None for single pictures, and is the left eye's count elsewhere."""

    number: int | None
    left: Clip
    right: Clip
    right_number: int | None = None

    @property
    def name(self) -> str:
        """What to call the frame: its number, or the left picture's name."""
        return self.left.file().name if self.number is None else f"{self.number:04d}"

    def clip(self, eye: Eye) -> tuple[Clip, int | None]:
        """An eye's clip and the frame of it that belongs here."""
        return (self.left, self.number) if eye == "left" else (self.right, self.right_number)

    def file(self, eye: Eye) -> Path:
        clip, frame = self.clip(eye)
        return clip.file(frame)

    def plate_name(self, eye: Eye) -> str:
        """What to call an eye's plate in a message."""
        clip, frame = self.clip(eye)
        return clip.name(frame)

    def digest(self, eye: Eye) -> str:
        """sha256 of what an eye's plate is read from."""
        clip, frame = self.clip(eye)
        return clip.digest(frame)

    def plate(self, eye: Eye, colour: ColourSettings | None = None) -> Float32:
        """An eye's plate as recorded, scene-linear.  Raises PlateError, ShotError."""
        clip, frame = self.clip(eye)
        return clip.read(frame, colour=colour)


def pairs_of(eyes: Eyes) -> tuple[Pair, ...]:
    """A `Pair` for every frame of `eyes`."""
    if not eyes.frames:
        return (Pair(number=None, left=eyes.left, right=eyes.right),)
    return tuple(Pair(number=n, left=eyes.left, right=eyes.right, right_number=eyes.right_frame(n)) for n in eyes.frames)


def eyes_of_shot(shot: Shot, frames: str | None = None) -> Eyes:
    """The plates of a shot file.  Raises PlateError, ShotError."""
    plates = shot.tables.plates
    return open_eyes(
        shot.resolved(plates.left),
        None if plates.right is None else shot.resolved(plates.right),
        frames=frames or plates.frames,
        layout=plates.layout,
        sync=plates.sync,
        right_late_frames=plates.right_late_frames,
        swap=plates.swap_eyes,
        colour_space=plates.colour_space,
        right_colour_space=plates.right_colour_space,
        first_frame=plates.first_frame,
        matrix=plates.matrix,
        levels=plates.levels,
    )


def pairs(left: str | Path, right: str | Path | None, *, frames: str | None = None, **settings: Any) -> tuple[Pair, ...]:
    """Every frame that both eyes have, or those of `frames`; settings as `open_eyes` takes them.

    Raises : PlateError naming the first frame that an eye lacks.
    """
    return pairs_of(open_eyes(left, right, frames=frames, **settings))


def read_upright(pair: Pair, rectification: Rectification, *, colour: ColourSettings | None = None) -> tuple[Float32, Float32]:
    """Both plates of a frame, scene-linear, a mirrored eye flipped back.

    Raises : PlateError for a picture that is missing or damaged, without a finite value, or not of the rig's size.
    """
    left, right = pair.plate("left", colour), pair.plate("right", colour)
    check_pair(left, right, left_name=pair.plate_name("left"), right_name=pair.plate_name("right"), rig=rectification.original)
    return rectification.upright(left, "left"), rectification.upright(right, "right")


def recover_pair(
    pair: Pair,
    plates: tuple[Float32, Float32],
    rectification: Rectification,
    *,
    settings: DepthSettings,
    eye: Eye = "left",
    match_colour: MatchColour = "off",
    hints: Hints | None = None,
) -> Recovered:
    """`stereo.depth.recover` of upright plates; its PlateErrors name the two files."""
    try:
        return recover(*plates, rectification, settings=settings, eye=eye, match_colour=match_colour, hints=hints)
    except PlateError as error:
        raise PlateError(f"{pair.plate_name('left')} and {pair.plate_name('right')}: {error}") from None


def flip_word(rectification: Rectification, eye: Eye) -> dict[str, str]:
    """A header word for passes that lie on the flipped-back plate of a mirrored eye; none for other plates."""
    return {FLIPPED: "yes"} if rectification.original.mirrored == eye else {}


def noise_word(rectification: Rectification) -> dict[str, str]:
    """A header word for matched depth: what 1/Z is at least off by from pixel to pixel, 1/metres, which normals from it go by."""
    rig = rectification.rig
    return {NOISE: f"{MATCH_NOISE_PX / (rig.left.fx * rig.baseline_m):.9g}"}
