"""A calibration from pictures or movies of a board to a rig and what it is worth.

In: both eyes' clips of one board.  Out: a `Session`: the rig with its quality, and everything the report shows.
Frames: of a long movie some are looked at, evenly spread, and the best of those that show the board are solved.  What was
found in each picture is kept beside the rig (NAME.detections.json), so that a second solve need not look again."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.calibration.board import Board
from stereorelight.calibration.corners import Detection, detect, larger_grid, what_else
from stereorelight.calibration.lens_choice import CANDIDATES, Choice, choose
from stereorelight.calibration.sightings import StereoViews
from stereorelight.calibration.solve import NOTHING_KNOWN, Calibration, Known
from stereorelight.calibration.validate import DISTANCES_M, Quality, validate, with_quality
from stereorelight.calibration.views import Pairs, movement_px, pair_eyes, pick_views, reflected, time_offset
from stereorelight.camera import Eye, Rig
from stereorelight.errors import PlateError, RigError
from stereorelight.files import write_text
from stereorelight.footage.clip import Clip, open_clip
from stereorelight.footage.sequence import frame_range
from stereorelight.shot.pairs import EYES
from stereorelight.shot.receipt import code_digest, digest
from stereorelight.threads import one_blas_thread, usable_cores

LOOKED_AT = 90  # frames of a movie: a second or so of hand movement lies between two
VIEWS = 30  # solved together; more hardly add, and each costs
STILL_PX = 1.0  # a frame: a board that moves more smears, and shows two moments to two eyes
LEAST_VIEWS = 3
CACHE_VERSION = 1
Told = Callable[[str, int, int], object]


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """What a calibration gave.

    names   : of the solved views, in their order.     looked_at : pictures looked at in each eye.
    words   : what was noticed on the way, one sentence each.
    example : both eyes' first solved picture, (H, W, 3) encoded and upright, for the report.
    """

    board: Board
    rig: Rig
    calibration: Calibration
    choice: Choice
    quality: Quality
    names: tuple[str, ...]
    looked_at: int
    words: tuple[str, ...]
    example: tuple[Any, Any]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "board": self.board.spec,
            "views": list(self.names),
            "looked_at": self.looked_at,
            "words": list(self.words),
            **(self.rig.quality or {}),
        }


def _frames(clip: Clip, wanted: str | None) -> list[int | None]:
    """Frames of one eye to look at; None stands for a single picture."""
    if clip.is_single:
        return [None]
    frames = [f for f in (frame_range(wanted) if wanted else clip.frames) if f in set(clip.frames)]
    return list(frames)


def _thinned(frames: Sequence[int | None]) -> list[int | None]:
    if len(frames) <= LOOKED_AT:
        return list(frames)
    return [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, LOOKED_AT).round().astype(int))]


def calibrate(
    left: str | Path,
    right: str | Path,
    board: Board,
    *,
    mirrored: Eye | None = None,
    frames: str | None = None,
    known: Known = NOTHING_KNOWN,
    lenses: Sequence[str] = CANDIDATES,
    views: int = VIEWS,
    distances_m: Sequence[float] = DISTANCES_M,
    cache: Path | None = None,
    on_picture: Told = lambda name, done, total: None,
) -> Session:
    """Calibrate the rig that filmed `board`.

    left, right : a pattern of pictures or a movie of each eye, frame by frame of the same moments.
    mirrored    : the eye behind a beam-splitter's mirror; found by itself where the board has markers.
    known       : baseline, focal lengths, or the same rig of another day.     lenses : models to choose from.
    cache       : file that keeps what was found in each picture.
    Raises      : PlateError for pictures that do not show the board, or not to both eyes; RigError where no rig can be told from
                  the views, with what to shoot.
    """
    clips = open_clip(left, eye="left"), open_clip(right, eye="right")
    moving = any(clip.is_movie for clip in clips)
    listed = [_frames(clip, frames) for clip in clips]
    both = [f for f in listed[0] if f in set(listed[1])]
    if not both:
        raise PlateError(f"{clips[1].pictures.pattern}: shares no frame with the left eye; number the pictures of one moment alike")
    looked = _thinned(both)
    found = _detections(clips, looked, board, thorough=not moving, cache=cache, on_picture=on_picture)
    _check_seen(clips, looked, found, board)
    _check_count(clips, found, board)
    words: list[str] = []
    if mirrored is not None and board.kind == "chessboard":
        e = EYES.index(mirrored)
        found[e] = {f: None if d is None else reflected(d, board) for f, d in found[e].items()}
    pairs = pair_eyes(_numbered(found[0]), _numbered(found[1]), board)
    words += pairs.words
    turned = mirrored or _eye(pairs.mirrored)
    if mirrored is not None and pairs.mirrored not in (None, mirrored):
        raise RigError(f"--mirrored {mirrored}, but the {pairs.mirrored} eye's pictures are the mirrored ones; leave it out or name that eye")
    chosen, more = _chosen(pairs, board, views, dense=moving and len(both) == len(looked))
    words += more
    used = StereoViews(
        points_m=board.points_m,
        left=[pairs.left.get(f) for f in chosen],
        right=[pairs.right.get(f) for f in chosen],
        names=[_name(clips[0], f) for f in chosen],
        mirrored=turned,
    )
    sizes = _size(pairs.left), _size(pairs.right)
    with one_blas_thread():
        choice, solved = choose(used, sizes, known, candidates=tuple(lenses))
        quality = validate(solved, distances_m=distances_m)
    first = chosen[0] if not clips[0].is_single else None
    example = tuple(_upright(clip.encoded(first), eye == turned) for clip, eye in zip(clips, EYES))
    return Session(
        board=board,
        rig=with_quality(solved.rig, quality),
        calibration=solved,
        choice=choice,
        quality=quality,
        names=tuple(used.names),
        looked_at=len(looked),
        words=tuple(words),
        example=(example[0], example[1]),
    )


def _upright(picture: Any, flip: bool) -> Any:
    return np.ascontiguousarray(picture[:, ::-1]) if flip else picture


def _eye(name: str | None) -> Eye | None:
    return "left" if name == "left" else "right" if name == "right" else None


def _size(detections: Mapping[int, Detection]) -> tuple[int, int]:
    return next(iter(detections.values())).size


def _numbered(found: Mapping[int | None, Detection | None]) -> dict[int, Detection | None]:
    return {0 if f is None else f: d for f, d in found.items()}


def _name(clip: Clip, frame: int) -> str:
    return clip.file(None if clip.is_single else frame).name if not clip.is_movie else f"frame {frame}"


def _chosen(pairs: Pairs, board: Board, views: int, *, dense: bool) -> tuple[list[int], list[str]]:
    """Frames to solve, in order of time, and what to say of it."""
    words: list[str] = []
    together = sorted(set(pairs.left) & set(pairs.right))
    offset, errors = time_offset(pairs.left, pairs.right) if dense else (0, {})
    if offset:
        better = f"{errors[offset]:.2f} px of epipolar error against {errors[0]:.2f}" if 0 in errors else "by the epipolar error"
        raise PlateError(
            f"the right eye runs {abs(offset)} frames {'late' if offset > 0 else 'early'} ({better}); "
            "trim the movies to one moment, or hold the board still at each view and give stills"
        )
    if dense:
        speed = movement_px({f: pairs.left[f] for f in together})
        still = [f for f in together if not speed[f] > STILL_PX]
        if len(still) >= max(views // 2, LEAST_VIEWS):
            together = still
    left, right = {f: pairs.left[f] for f in together}, {f: pairs.right[f] for f in together}
    chosen = sorted(pick_views(left, board, count=views, others=right))
    if len(chosen) < len(together):
        words.append(f"the best {len(chosen)} of {len(together)} views are solved: sharp ones that differ and fill the frame")
    single = sorted(set(pairs.left) ^ set(pairs.right))[: max(0, views - len(chosen))]
    return sorted({*chosen, *single}), words


def _check_seen(clips: tuple[Clip, Clip], looked: Sequence[int | None], found: Sequence[Mapping[int | None, Detection | None]], board: Board) -> None:
    """Where an eye never shows the board, say what it shows in its place."""
    for clip, seen in zip(clips, found):
        if any(d is not None for d in seen.values()):
            continue
        for frame in looked[:: max(1, len(looked) // 5)]:
            if other := what_else(clip.encoded(frame), board):
                raise PlateError(f"{clip.name(frame)}: the board {board.spec} is not there: {other}")
        raise PlateError(
            f"{clip.pictures.pattern}: none of {len(looked)} pictures of the {clip.eye} eye shows the board {board.spec}; "
            "check the spec, that the whole board is in the frame, focus and light"
        )


def _check_count(clips: tuple[Clip, Clip], found: Sequence[Mapping[int | None, Detection | None]], board: Board) -> None:
    """A chessboard with too few corners told is found inside the true one, and would calibrate to nonsense: look for more."""
    if board.kind != "chessboard":
        return
    for clip, seen in zip(clips, found):
        sharpest = max((f for f, d in seen.items() if d is not None), key=lambda f: seen[f].sharpness)  # type: ignore[union-attr]
        if (larger := larger_grid(clip.encoded(sharpest), board)) is not None:
            wanted = f"{larger[0]}x{larger[1]} inner corners are seen; count them where four squares meet"
            raise PlateError(f"{clip.name(sharpest)}: has a larger chessboard than {board.spec}: {wanted}")


def _detections(
    clips: tuple[Clip, Clip], frames: Sequence[int | None], board: Board, *, thorough: bool, cache: Path | None, on_picture: Told
) -> list[dict[int | None, Detection | None]]:
    """The board in every picture of both eyes; a movie's right eye is only looked at where the left one shows it."""
    kept = _Kept(cache, board)
    total, done = 2 * len(frames), 0
    out: list[dict[int | None, Detection | None]] = []
    for clip in clips:
        wanted = list(frames)
        if out and not thorough:
            wanted = [f for f in frames if out[0].get(f) is not None]
        seen: dict[int | None, Detection | None] = {}

        def one(frame: int | None, clip: Clip = clip) -> Detection | None:
            key = clip.digest(frame)
            if key in kept:
                return kept.get(key)
            found = detect(clip.encoded(frame), board, thorough=thorough)
            kept.put(key, found)
            return found

        with ThreadPoolExecutor(usable_cores()) as pool:
            for frame, detection in zip(wanted, pool.map(one, wanted)):
                seen[frame] = detection
                done += 1
                on_picture(clip.name(frame), done, total)
        out.append(seen)
    kept.write()
    return out


class _Kept:
    """Detections kept in a file; one made by other code or for another board is not believed."""

    FIELDS = ("blur_px", "motion_px", "sharpness", "contrast", "size", "mirrored")

    def __init__(self, path: Path | None, board: Board) -> None:
        self.path = path
        self.key = digest(CACHE_VERSION, board.spec, code_digest("calibration/board.py", "calibration/corners.py", "calibration/refine_corners.py"))
        self.data: dict[str, Any] = {}
        self.changed = False
        if path is not None:
            try:
                told = json.loads(path.read_text(encoding="utf-8"))
                if told.get("key") == self.key:
                    self.data = told["pictures"]
            except (OSError, ValueError, KeyError, AttributeError):
                pass

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def get(self, key: str) -> Detection | None:
        """The detection of a picture that was looked at, None where the board was not seen."""
        told = self.data[key]
        if told is None:
            return None
        return Detection(
            ids=np.array(told["ids"], dtype=np.int64),
            px=np.array(told["px"], dtype=np.float64),
            sigma_px=np.array(told["sigma_px"], dtype=np.float64),
            refined=np.array(told["refined"], dtype=bool),
            blur_px=(float(told["blur_px"][0]), float(told["blur_px"][1])),
            motion_px=(float(told["motion_px"][0]), float(told["motion_px"][1])),
            sharpness=float(told["sharpness"]),
            contrast=float(told["contrast"]),
            size=(int(told["size"][0]), int(told["size"][1])),
            mirrored=bool(told["mirrored"]),
        )

    def put(self, key: str, found: Detection | None) -> None:
        self.changed = True
        if found is None:
            self.data[key] = None
            return
        lists = {n: np.asarray(getattr(found, n)).tolist() for n in ("ids", "px", "sigma_px", "refined")}
        self.data[key] = lists | {n: np.asarray(getattr(found, n)).tolist() for n in self.FIELDS}

    def write(self) -> None:
        if self.path is not None and self.changed:
            write_text(self.path, json.dumps({"key": self.key, "pictures": self.data}), force=True)
