"""Which materials of a shot shading may speak for: judged once on frames spread over the whole shot, so that every frame trusts them alike.

In: the shot's pairs, and what judges one of them.  Out: `ShotMaterials`, the same whatever part of the shot is run and by how many processes.
What was found is kept in materials.json beside the results, with a key over everything that it was found from."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stereorelight.errors import PlateError
from stereorelight.files import write_text
from stereorelight.footage.eyes import Eyes
from stereorelight.shot.neighbours import numbers_of_shot
from stereorelight.shot.pairs import EYES, Pair
from stereorelight.shot.receipt import code_digest, digest
from stereorelight.shot.schema import Shot
from stereorelight.surface.shading_trust import Judged, ShotMaterials, pooled

VERSION = 1
FRAMES = 3  # that judge: each costs a matching; with five, trust and flicker are the same
ROOMS = ("stereo", "surface", "engine", "footage", "shot/materials.py", "shot/job.py")


def spread_over(shot: Shot, eyes: Eyes) -> tuple[Pair, ...]:
    """The frames that judge: the middles of as many equal parts of the whole shot; none where the shot is a single picture."""
    numbers = numbers_of_shot(shot, eyes) if eyes.frames else ()
    count = min(FRAMES, len(numbers))
    asked = [numbers[(2 * k + 1) * len(numbers) // (2 * count)] for k in range(count)]
    return tuple(Pair(number=n, left=eyes.left, right=eyes.right, right_number=eyes.right_frame(n)) for n in asked)


class MaterialsOfShot:
    """The shot's materials, found when they are first asked for, and kept."""

    def __init__(self, pairs: Sequence[Pair], judge: Callable[[Pair], Judged], *, depends: Callable[[Pair], Any], path: Path) -> None:
        """pairs : the frames that judge.   judge : may raise PlateError.   depends : plain values that a frame's verdict depends on beyond
        its plates.   path : of materials.json."""
        self._pairs, self._judge, self._depends, self._path = tuple(pairs), judge, depends, path

    @functools.cached_property
    def key(self) -> str | None:
        """What the materials depend on; None where every frame judges for itself."""
        sources = {}
        for pair in self._pairs:
            try:
                sources[pair.name] = [*(pair.digest(eye) for eye in EYES), self._depends(pair)]
            except PlateError:  # the run tells of it when it comes to it
                continue
        return digest(sources, code_digest(*ROOMS)) if sources else None

    @functools.cached_property
    def found(self) -> ShotMaterials | None:
        """The materials; None where no frame of the shot can be judged, and each judges for itself."""
        if self.key is None:
            return None
        stood = self._read()
        if stood is not None:
            return stood
        verdicts = []
        for pair in self._pairs:
            try:
                verdicts.append(self._judge(pair))
            except PlateError:
                continue
        if not verdicts:
            return None
        made = pooled(verdicts)
        data = {"version": VERSION, "key": self.key, "colours": made.colours.tolist(), "trust": made.trust.tolist()}
        write_text(self._path, json.dumps(data, indent=1) + "\n", force=True)
        return made

    def _read(self) -> ShotMaterials | None:
        try:
            data = json.loads(self._path.read_text(encoding="utf-8"))
            if data["version"] != VERSION or data["key"] != self.key:
                return None
            return ShotMaterials(colours=np.array(data["colours"], np.float64).reshape(-1, 2), trust=np.array(data["trust"], np.float64))
        except (OSError, ValueError, KeyError, TypeError):
            return None
