"""Both eyes of a shot: two clips, and which picture of the right one belongs to which of the left.

In: the names of the plates as the shot file has them.  Out: an `Eyes`.  Whatever the eyes do not have in common (rate, frames,
time code) is told, with what there is and what would do; nothing is paired in silence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from stereorelight.errors import PlateError, ShotError, nearest_hint
from stereorelight.footage.clip import PACKED, PICTURE_SUFFIXES, Clip, checked_layout, is_movie, open_clip
from stereorelight.footage.exr import read_exr, read_header
from stereorelight.footage.sequence import Sequence, common_frames, frame_range, frames_text

Sync = Literal["auto", "frames", "timecode"]
SYNCS: tuple[Sync, ...] = ("auto", "frames", "timecode")
# How Matroska and FFmpeg call the way in which one picture holds both eyes.
STEREO_TAGS: Mapping[str, tuple[str, bool]] = MappingProxyType(
    {
        "left_right": ("side-by-side", False),
        "right_left": ("side-by-side", True),
        "side by side": ("side-by-side", False),
        "top_bottom": ("top-bottom", False),
        "bottom_top": ("top-bottom", True),
        "top and bottom": ("top-bottom", False),
    }
)


@dataclass(frozen=True, kw_only=True)
class Eyes:
    """The two clips of a shot.

    frames : numbers of the frames that both eyes have, by the left eye's count; empty for two single pictures.
    shift  : the right clip's frame is the left one's plus this.
    notes  : what was decided on the way, in words, for the receipt.
    """

    left: Clip
    right: Clip
    frames: tuple[int, ...] = ()
    shift: int = 0
    notes: tuple[str, ...] = ()

    def right_frame(self, number: int | None) -> int | None:
        return None if number is None else number + self.shift


def _tagged_layout(clip: Clip) -> tuple[str, bool] | None:
    tag = next((v for k, v in clip.words if k.lower() in ("stereo_mode", "stereo3d", "stereo3d_type")), "")
    return STEREO_TAGS.get(tag.lower().strip())


def _one_file(path: str | Path, *, layout: str, settings: Mapping[str, Any]) -> tuple[Clip, Clip, list[str]]:
    """Both eyes out of one file or pattern."""
    if layout in PACKED:
        left, right = (open_clip(path, eye=eye, layout=layout, **settings) for eye in ("left", "right"))
        return left, right, []
    if is_movie(path):
        left = open_clip(path, eye="left", **settings)
        if (tagged := _tagged_layout(left)) is not None:
            found, turned = tagged
            clips = [open_clip(path, eye=eye, layout=found, **settings) for eye in ("left", "right")]
            clips = clips[::-1] if turned else clips
            return clips[0], clips[1], [f"{path} is tagged as {found}{', right eye first' if turned else ''}"]
        try:
            right = open_clip(path, eye="right", track=1, **settings)
        except PlateError:
            remedy = 'say how it holds both eyes, such as layout = "side-by-side", or name the movie of the right eye'
            raise PlateError(f"{path}: is given for both eyes, but has one video track and no stereo tag; {remedy}") from None
        return left, right, [f"{path} holds the left eye in track 0 and the right eye in track 1"]
    left, right = (open_clip(path, eye=eye, view=eye, **settings) for eye in ("left", "right"))
    first = left.file(left.frames[0] if left.frames else None)
    if first.suffix.lower() != ".exr" or not _has_views(first):
        one = ", but has one view" if first.suffix.lower() == ".exr" else ""
        raise PlateError(f'{first}: is given for both eyes{one}; name the right plate, or say how it holds both, such as layout = "side-by-side"')
    return left, right, []


def _has_views(path: Path) -> bool:
    header = read_header(path).header
    if header.get("view") or header.get("multiView"):
        return True
    return any(part.view for part in read_exr(path))  # parts that belong to every eye may come first


def _start(clip: Clip, sync: str) -> str | None:
    """Time code of a clip's first frame; that of a sequence only where asked for, since its frames have numbers to go by."""
    if clip.is_movie:
        return clip.start_timecode
    return clip.timecode(clip.frames[0]) if sync == "timecode" else None


def _apart(codes: tuple[str, str], clips: tuple[Clip, Clip], rate: Fraction) -> int:
    """By how many frames the second clip starts later than the first, the shorter way round the clock."""
    from stereorelight.footage.movie.timecode import Timecode

    clip = clips[0]
    try:
        first = Timecode.parse(codes[0], rate)
        clip = clips[1]
        second = Timecode.parse(codes[1], rate)
        later = second - first
    except PlateError as error:
        raise PlateError(f'{clip.pictures.pattern}: {error}; or use sync = "frames"') from None
    after, before = replace(first, frames=later).frames, replace(first, frames=-later).frames
    return after if after <= before else -before


def _timecode_shift(left: Clip, right: Clip, sync: str) -> tuple[int, list[str]]:
    """By how many frames the right clip counts ahead of the left one at the same time code."""
    if sync == "frames":
        return 0, []
    first, second = _start(left, sync), _start(right, sync)
    if first is None or second is None:
        if sync == "auto":
            return 0, []
        lacking = left if first is None else right
        raise PlateError(f'{lacking.pictures.pattern}: carries no time code; use sync = "frames", and right_late_frames where the eyes start apart')
    rate = left.rate or right.rate
    if rate is None:
        raise PlateError(f'{left.pictures.pattern}: carries time code, but neither eye says its frames a second; use sync = "frames"')
    apart = _apart((first, second), (left, right), rate)
    shift = right.frames[0] - left.frames[0] - apart
    if apart == 0:
        return shift, []
    if apart >= len(left.frames) or -apart >= len(right.frames):
        if sync == "auto":
            return 0, [f"time codes {first} and {second} do not overlap: the eyes are paired from their first frames"]
        told = f"time code runs from {second}, the left eye's from {first}, and they do not overlap"
        raise PlateError(f'{right.pictures.pattern}: {told}; use sync = "frames"')
    kind = "movie" if right.is_movie else "sequence"
    return shift, [f"paired by time code: the right {kind} starts {abs(apart)} frame{'s' * (abs(apart) > 1)} {'later' if apart > 0 else 'earlier'}"]


def _check_alike(left: Clip, right: Clip) -> None:
    if left.is_single != right.is_single:
        single = left if left.is_single else right
        other = "movie" if left.is_movie or right.is_movie else "sequence"
        what = "is a single picture" if single.file().suffix.lower() in PICTURE_SUFFIXES else "is neither a movie nor a picture by its name"
        raise PlateError(f"{single.file()}: {what}, but the other eye is a {other}; give both eyes alike")
    if left.rate is not None and right.rate is not None and left.rate != right.rate:
        rates = f"runs at {float(right.rate):.6g} frames a second, but {left.pictures.pattern} at {float(left.rate):.6g}"
        raise PlateError(f"{right.pictures.pattern}: {rates}; conform both eyes to one rate first")


def _paired(left: Clip, right: Clip, shift: int, wanted: str | None, *, cut: bool) -> tuple[int, ...]:
    """The frames to work on.  `cut`: the eyes were shifted against each other, so that their ends cannot both be used."""
    moved = tuple(n - shift for n in right.frames)
    numbers = frame_range(wanted) if wanted else None
    if not (left.is_movie or right.is_movie) and shift == 0:
        return common_frames(left.pictures, right.pictures, wanted)
    both = sorted(set(left.frames) & set(moved))
    if not both:
        raise PlateError(
            f"{right.pictures.pattern}: shares no frame with the left eye; left has {frames_text(left.frames)}, right {frames_text(moved)}"
        )
    if numbers is None:
        if not cut and left.frames != moved:
            held, faults = len(right.frames), "; ".join(f"{clip.pictures.pattern}: {clip.fault}" for clip in (left, right) if clip.fault)
            what = f"holds {held} frame{'s' * (held > 1)}, but {left.pictures.pattern} {len(left.frames)}{faults and f' ({faults})'}"
            raise PlateError(f"{right.pictures.pattern}: {what}. Give --frames {frames_text(both)}, or restore the missing ones")
        short = next((clip for clip in (left, right) if "cut short" in clip.fault), None)
        if short is not None:  # eyes that end alike, as in one file, are not whole for that
            raise PlateError(f"{short.pictures.pattern}: {short.fault}. Give --frames {frames_text(both)}, or copy or export it again")
        return tuple(both)
    for n in numbers:
        for clip, own in ((left, n), (right, n + shift)):
            if own not in set(clip.frames):
                inside = [f for f in numbers if f in set(both)]
                remedy = f"Give --frames {frames_text(inside)}" if inside else f"Both eyes have {frames_text(both)}"
                fault = f" ({clip.fault})" if clip.fault else ""
                beside = f" to go with {n} of the left eye" if own != n else ""
                raise PlateError(f"{clip.pictures.pattern}: has no frame {own}{beside}; it has {frames_text(clip.frames)}{fault}. {remedy}")
    return numbers


def plate_frames(plates: Clip, passes: Sequence, wanted: str | None) -> list[int | None]:
    """The frames that plates and their passes share, or `wanted`; [None] for single pictures.  Raises PlateError."""
    if not plates.is_movie:
        return list(common_frames(plates.pictures, passes, wanted)) or [None]
    if passes.is_single:
        raise PlateError(f"{passes.pattern}: is a single file, but the plate is a movie; give the passes by a pattern such as passes.####.exr")
    if not wanted and not set(passes.frames) <= set(plates.frames):
        both, fault = sorted(set(plates.frames) & set(passes.frames)), f" ({plates.fault})" if plates.fault else ""
        remedy = f"Give --frames {frames_text(both)}, or restore the movie" if both else "Give passes of this movie"
        have = f"has frames {frames_text(plates.frames)}{fault}, but the passes {frames_text(passes.frames)}"
        raise PlateError(f"{plates.pictures.pattern}: {have}. {remedy}")
    numbers = frame_range(wanted) if wanted else passes.frames
    for n in numbers or (plates.frames[0],):
        plates.check_frame(n)
        if n not in passes.frames:
            have = f"the passes have {frames_text(passes.frames)}, the movie {frames_text(plates.frames)}"
            raise PlateError(f"{passes.path(n).name}: frame missing; {have}")
    return list(numbers)


def open_eyes(
    left: str | Path,
    right: str | Path | None = None,
    *,
    frames: str | None = None,
    layout: str = "auto",
    sync: str = "auto",
    right_late_frames: int = 0,
    swap: bool = False,
    colour_space: str = "auto",
    right_colour_space: str | None = None,
    **settings: Any,
) -> Eyes:
    """The clips that `left` and `right` name, and their common frames.

    right             : None, or the same as `left`, where one file holds both eyes: packed, as two tracks, or as two views.
    layout            : one of clip.LAYOUTS.        sync : "timecode", "frames", or "auto": by time code where both are movies that carry one.
    right_late_frames : the right camera is so many whole frames behind: its picture of a moment comes so much later.
    swap              : what is called left is the right eye's.
    settings          : first_frame, matrix, levels for movies.
    Raises            : PlateError for what is missing or differs between the eyes; ShotError for an unknown layout or sync.
    """
    checked_layout(layout)
    if sync not in SYNCS:
        raise ShotError(f"sync {sync!r} is unknown{nearest_hint(sync, SYNCS)}")
    spaces = {"left": colour_space, "right": right_colour_space or colour_space}
    same = right is None or str(left) == str(right)
    if same and not ("%V" in str(left) or "%v" in str(left)):
        a, b, notes = _one_file(left, layout=layout, settings=settings)
    else:
        if layout in PACKED:
            raise PlateError(
                f"{right or left}: is named for one eye, but the layout {layout} is of one file that holds both; leave one of the two out"
            )
        a = open_clip(left, eye="left", layout="separate" if layout == "auto" else layout, **settings)
        b = open_clip(left if right is None else right, eye="right", layout="separate" if layout == "auto" else layout, **settings)
        notes = []
    a, b = replace(a, colour_space=spaces["left"]), replace(b, colour_space=spaces["right"])
    if swap:
        a, b = b, a
        notes.append("the eyes are exchanged, as told")
    _check_alike(a, b)
    if a.is_single:
        if frames:
            a.pictures.with_frames(frames)
        if right_late_frames:
            raise ShotError(f"{b.file()}: is a single picture, which cannot be {right_late_frames} frames late; leave right_late_frames out")
        return Eyes(left=a, right=b, notes=tuple(notes))
    shift, words = _timecode_shift(a, b, sync)
    if right_late_frames:
        count = f"{abs(right_late_frames)} frame{'s' * (abs(right_late_frames) > 1)}"
        words.append(f"the right eye is taken {count} {'later' if right_late_frames > 0 else 'earlier'}, as the shot file asks")
    shift += right_late_frames
    cut = bool(words)
    numbers = _paired(a, b, shift, frames, cut=cut)
    return Eyes(left=a, right=b, frames=numbers, shift=shift, notes=(*notes, *words))
