"""A calibration from pictures or movies of a board to a rig and what it is worth.

In: both eyes' clips of one board.  Out: a `Session`: the rig with its quality, and everything the report shows.
Frames: of a long movie some are looked at, evenly spread, and the best of those that show the board are solved.  What was
found in each picture is kept beside the rig (NAME.detections.json), so that a second solve need not look again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.calibration.answer import NOTHING_KNOWN, Calibration, Known
from stereorelight.calibration.board import Board
from stereorelight.calibration.corners import Detection
from stereorelight.calibration.lens_choice import CANDIDATES, Choice, choose
from stereorelight.calibration.sightings import StereoViews
from stereorelight.calibration.solve import solve_rig
from stereorelight.calibration.timing import movement_px, right_late, time_offset, velocity_px
from stereorelight.calibration.validate import DISTANCES_M, Quality, validate, with_quality
from stereorelight.calibration.views import Pairs, pair_eyes, pick_views, reflected
from stereorelight.camera import Eye, Rig
from stereorelight.errors import PlateError, RigError
from stereorelight.footage.clip import Clip, open_clip
from stereorelight.shot.calibrate_look import Looker, Told, check_board, check_seen, frames_of, thinned
from stereorelight.shot.pairs import EYES
from stereorelight.threads import one_blas_thread

VIEWS = 30  # solved together; more hardly add, and each costs
STILL_PX = 1.0  # a frame: a board that moves more smears, and shows two moments to two eyes
LEAST_VIEWS = 3
CANDIDATES_FOR_TIME = 45  # frames of a long movie whose next frame is looked at too, to see how the board moves
LATE_FRAMES, LATE_LITTLE = 0.5, 0.1  # more is refused, less is not to be told from nothing
IN_STEP = "trim the movies to one moment, or hold the board still at each view and give stills"
BASELINE_SIGMAS = 5.0  # of what was measured by hand: a board of another size than told


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """What a calibration gave.

    names   : of the solved views, in their order.     looked_at : pictures looked at in each eye.
    words   : what was noticed on the way, one sentence each.
    example : both eyes' first picture of which both were used, (H, W, 3) encoded and upright, for the report.
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
            "names": list(self.names),
            "looked_at": self.looked_at,
            "words": list(self.words),
            **(self.rig.quality or {}),
        }


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
    both = frames_of(clips, frames)
    if not both:
        raise PlateError(f"{clips[1].pictures.pattern}: shares no frame with the left eye; number the pictures of one moment alike")
    looked = thinned(both)
    sparse = moving and len(looked) < len(both)
    looker = Looker(clips, board, cache=cache, on_picture=on_picture)
    looker.total = 2 * len(looked) + (CANDIDATES_FOR_TIME if sparse else 0) + 1
    found = [looker.look(0, looked, thorough=not moving)]
    # Where a movie's left eye does not show the board the right one's view would help its own lens alone.
    found.append(looker.look(1, [f for f in looked if not moving or found[0][f] is not None] or looked, thorough=not moving))
    looker.write()
    check_seen(clips, looked, found, board)
    check_board(clips, found, board)
    words: list[str] = []
    if mirrored is not None and board.kind == "chessboard":
        e = EYES.index(mirrored)
        found[e] = {f: None if d is None else reflected(d, board) for f, d in found[e].items()}
    pairs = pair_eyes(_numbered(found[0]), _numbered(found[1]), board)
    words += pairs.words
    turned = mirrored or _eye(pairs.mirrored)
    if mirrored is not None and pairs.mirrored not in (None, mirrored):
        raise RigError(f"--mirrored {mirrored}, but the {pairs.mirrored} eye's pictures are the mirrored ones; leave it out or name that eye")
    speed = None
    if sparse:
        speed, more = _together(pairs, looker, board)
        words += more
    chosen, more = _chosen(pairs, board, views, dense=moving and not sparse, speed=speed)
    words += more
    looker.write()
    looker.solving()
    used = StereoViews(
        points_m=board.points_m,
        left=[pairs.left.get(f) for f in chosen],
        right=[pairs.right.get(f) for f in chosen],
        names=[_name(clips[0], f) for f in chosen],
        mirrored=turned,
    )
    sizes = _size(pairs.left), _size(pairs.right)
    with one_blas_thread():
        if known.baseline_m is not None and known.rig is None:
            # First without it: told beside a board of another size it would be fought over by every corner.
            _check_baseline(solve_rig(used, sizes, (lenses[0], lenses[0]), replace(known, baseline_m=None)), known, board)
        choice, solved = choose(used, sizes, known, candidates=tuple(lenses))
        quality = validate(solved, distances_m=distances_m)
    shown = next((v for v in range(len(used)) if solved.paired[v]), 0)
    first = chosen[shown] if not clips[0].is_single else None
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


def _check_baseline(solved: Calibration, known: Known, board: Board) -> None:
    """A board of another size than told makes a rig of another size, and nothing else shows it."""
    measured, sigma = known.baseline_m or (solved.rig.baseline_m, 1.0)
    share = solved.rig.baseline_m / measured
    if abs(share - 1) * measured > BASELINE_SIGMAS * sigma:
        raise RigError(
            f"the eyes come out {1000 * solved.rig.baseline_m:.4g} mm apart, {1000 * measured:.4g} mm were measured: that needs squares of "
            f"{board.square_m / share:.3g} m, the board is told to have {board.square_m:g}; measure a square of the print, and between the lenses"
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


def _together(pairs: Pairs, looker: Looker, board: Board) -> tuple[dict[int, float], list[str]]:
    """Of a long movie: how fast the board moves in its likeliest frames, and words on whether the eyes run in step."""
    both = {f: pairs.left[f] for f in sorted(set(pairs.left) & set(pairs.right))}
    right = {f: pairs.right[f] for f in both}
    wanted = sorted(pick_views(both, board, count=CANDIDATES_FOR_TIME, others=right))
    had = set(looker.clips[1].frames)
    next_to = {f + 1: f for f in wanted if f + 1 in had}
    moves = {}
    for frame, later in looker.look(1, list(next_to), thorough=False).items():
        if frame is not None and later is not None:
            moves[next_to[frame]] = velocity_px(right[next_to[frame]], later, board, mirrored=pairs.mirrored == "right")
    speed = {f: float(np.linalg.norm(step, axis=1).mean()) for f, (_, step) in moves.items() if len(step)}
    late = right_late(both, right, moves)
    if abs(late.frames) < LATE_LITTLE:
        return speed, []
    gain = f"{late.error_px:.2f} px of epipolar error against {late.error_in_step_px:.2f}"
    how = f"{abs(late.frames):.2g} frames {'late' if late.frames > 0 else 'early'} ({gain})"
    if abs(late.frames) >= LATE_FRAMES:
        raise PlateError(f"the right eye runs {how}; {IN_STEP}")
    return speed, [f"the right eye runs {how}: the cameras are not genlocked; only where the board stands still do both eyes see it in one place"]


def _chosen(pairs: Pairs, board: Board, views: int, *, dense: bool, speed: Mapping[int, float] | None = None) -> tuple[list[int], list[str]]:
    """Frames to solve, in order of time, and what to say of it."""
    words: list[str] = []
    together = sorted(set(pairs.left) & set(pairs.right))
    offset, errors = time_offset(pairs.left, pairs.right) if dense else (0, {})
    if offset:
        better = f"{errors[offset]:.2f} px of epipolar error against {errors[0]:.2f}" if 0 in errors else "by the epipolar error"
        raise PlateError(f"the right eye runs {abs(offset)} frames {'late' if offset > 0 else 'early'} ({better}); {IN_STEP}")
    if dense:
        speed = movement_px({f: pairs.left[f] for f in together})
    if speed is not None:
        still = [f for f in together if f in speed and not speed[f] > STILL_PX]
        if len(still) >= max(views // 2, LEAST_VIEWS):
            together = still
    left, right = {f: pairs.left[f] for f in together}, {f: pairs.right[f] for f in together}
    chosen = sorted(pick_views(left, board, count=views, others=right))
    if len(chosen) < len(together):
        words.append(f"the best {len(chosen)} of {len(together)} views are solved: sharp ones that differ and fill the frame")
    single = sorted(set(pairs.left) ^ set(pairs.right))[: max(0, views - len(chosen))]
    return sorted({*chosen, *single}), words
