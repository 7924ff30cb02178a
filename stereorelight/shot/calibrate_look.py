"""Looking for a board in both eyes' clips, and saying what else is there where it is not.

In: both eyes' clips, frame numbers, a `Board`.  Out: what each eye saw, by frame; None where the board is not seen.
Pictures are read in their order, which is what movies are quick at, and looked at on all cores.  What was found is kept in a
file, so that a second solve need not look again."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.calibration.board import Board
from stereorelight.calibration.board_wrong import larger_grid, marker_share, second_board, what_else
from stereorelight.calibration.corners import Detection, detect
from stereorelight.errors import PlateError
from stereorelight.files import write_text
from stereorelight.footage.clip import Clip
from stereorelight.footage.sequence import frame_range
from stereorelight.shot.receipt import code_digest, digest
from stereorelight.threads import usable_cores

LOOKED_AT = 90  # frames of a movie: a second or so of hand movement lies between two
CACHE_VERSION = 1
ASKED_TWICE = 3  # pictures of each eye that are searched for what should not be there
MARKER_OFF = 0.15  # of the marker's share of its square: blur and bright light make small markers a tenth smaller
Told = Callable[[str, int, int], object]
Seen = dict[int | None, Detection | None]


def frames_of(clips: tuple[Clip, Clip], wanted: str | None) -> list[int | None]:
    """Frames that both eyes have, of those asked for; [None] for two single pictures."""
    listed = []
    for clip in clips:
        had = set(clip.frames)
        listed.append([None] if clip.is_single else [f for f in (frame_range(wanted) if wanted else clip.frames) if f in had])
    return [f for f in listed[0] if f in set(listed[1])]


def thinned(frames: Sequence[int | None]) -> list[int | None]:
    """At most `LOOKED_AT` of them, evenly spread."""
    if len(frames) <= LOOKED_AT:
        return list(frames)
    return [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, LOOKED_AT).round().astype(int))]


class Looker:
    """Finds the board in frames of either eye, keeps what it found, and tells how far it is.  `expect` says how much is to come."""

    def __init__(self, clips: tuple[Clip, Clip], board: Board, *, cache: Path | None, on_picture: Told) -> None:
        self.clips, self.board = clips, board
        self._kept = _Kept(cache, board)
        self._told = on_picture
        self.done, self.total = 0, 1

    def look(self, eye: int, frames: Sequence[int | None], *, thorough: bool) -> Seen:
        """What eye 0 or 1 saw in `frames`."""
        clip, cores = self.clips[eye], usable_cores()
        out: Seen = dict.fromkeys(frames)
        waiting: deque[tuple[int | None, str, Future[Detection | None]]] = deque()

        def take() -> None:
            frame, key, future = waiting.popleft()
            out[frame] = future.result()
            self._kept.put(key, out[frame])
            self._step(clip.name(frame))

        with ThreadPoolExecutor(cores) as pool:
            for frame in frames:
                key = clip.digest(frame)
                if key in self._kept:
                    out[frame] = self._kept.get(key)
                    self._step(clip.name(frame))
                    continue
                waiting.append((frame, key, pool.submit(detect, clip.encoded(frame), self.board, thorough=thorough)))
                if len(waiting) > cores:  # a picture waits in memory for each core, and no more
                    take()
            while waiting:
                take()
        return out

    def write(self) -> None:
        """Keep what was found."""
        self._kept.write()

    def solving(self) -> None:
        """Say that the looking is over."""
        self._told("solving", self.done, self.done + 1)

    def _step(self, name: str) -> None:
        self.done += 1
        self._told(name, self.done, max(self.total, self.done + 1))


def check_seen(clips: tuple[Clip, Clip], looked: Sequence[int | None], found: Sequence[Mapping[int | None, Detection | None]], board: Board) -> None:
    """Where an eye never shows the board, say what it shows in its place."""
    for clip, seen, other in zip(clips, found, reversed(found)):
        if any(d is not None for d in seen.values()):
            continue
        for frame in looked[:: max(1, len(looked) // ASKED_TWICE)][:ASKED_TWICE]:
            if instead := what_else(clip.encoded(frame), board):
                raise PlateError(f"{clip.name(frame)}: the board {board.spec} is not there: {instead}")
        count = sum(d is not None for d in other.values())
        alone = f", though {count} of the other eye do; hold it where both eyes see it" if count else ""
        raise PlateError(
            f"{clip.pictures.pattern}: none of {len(looked)} pictures of the {clip.eye} eye shows the board {board.spec}{alone}; "
            "check the spec, that the whole board is in the frame, focus and light"
        )


def check_board(clips: tuple[Clip, Clip], found: Sequence[Mapping[int | None, Detection | None]], board: Board) -> None:
    """Raise PlateError where the board in sight is another one than was told, or not alone.

    A chessboard with too few corners told is found inside the true one, and would calibrate to nonsense; so would two boards."""
    for clip, seen in zip(clips, found):
        sharp = sorted(((f, d) for f, d in seen.items() if d is not None), key=lambda one: -one[1].sharpness)
        for frame, detection in sharp[:ASKED_TWICE]:
            picture = clip.encoded(frame)
            if board.kind == "chessboard" and (larger := larger_grid(picture, board)) is not None:
                wanted = f"{larger[0]}x{larger[1]} inner corners are seen; count them where four squares meet"
                raise PlateError(f"{clip.name(frame)}: has a larger chessboard than {board.spec}: {wanted}")
            if second_board(picture, board, detection):
                raise PlateError(f"{clip.name(frame)}: shows two boards {board.spec}; cover one of them, or leave such pictures out")
            share = marker_share(picture, board, detection)
            if board.marker_m is not None and share is not None and abs(share / (told := board.marker_m / board.square_m) - 1) > MARKER_OFF:
                raise PlateError(
                    f"{clip.name(frame)}: the markers fill {share:.0%} of their squares' side, but {board.spec} says {told:.0%}; "
                    "measure a square and a marker on the print"
                )


class _Kept:
    """Detections kept in a file; one made by other code or for another board is not believed."""

    FIELDS = ("blur_px", "motion_px", "sharpness", "contrast", "size", "mirrored")
    CODE = tuple(f"calibration/{name}.py" for name in ("board", "board_search", "corners", "refine_corners"))

    def __init__(self, path: Path | None, board: Board) -> None:
        self.path = path
        self.key = digest(CACHE_VERSION, board.spec, code_digest(*self.CODE))
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
