"""Which materials are shading's to tell: a test of each by normals that shading had no part in, on one frame or over a shot.

In: a level of a frame, solved with shading and without.  Out: a `Judged` for each frame, and `pooled` over frames a `ShotMaterials`.
A frame's own test comes out a little otherwise in each frame, and normals would breathe with it: frames spread over a shot are judged once,
and what they say of a colour holds for all its frames.  Whether a surface of that colour turns, each frame says for itself: a wall may be
painted like a face."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stereorelight.arrays import Float64
from stereorelight.surface.plate_light import APART, HELD_OUT_BLOCK, WORK_WIDTH, Labels
from stereorelight.surface.shading_fit import GRAIN, State, lit_by, rising
from stereorelight.surface.shading_levels import Level, cells_of

LEAST_SHARE = (0.38, 0.5)  # of the variance of brightness, explained by normals that shading had no part in: where disparity ...
MUCH_GAIN = (8.0, 2.5)  # ... knows so much less than shading would
HALF_SURE = 0.08  # of that share, to either side of the least: in between a material is shaded in part, so that frames do not jump
LEAST_TURN_DEG = (15.0, 20.0)  # median angle of normals to their mean: flat but for noise, and surely not flat
LEAST_GAIN = (0.9, 1.2)  # error of the given normals over that of shading's: of no use, and of use
LEAST_PATCHES = (6.0, 12.0)  # that differ by more than chance, about the nine numbers of a light that is to be told from them
MOST_SENSITIVE = 0.9  # change of log brightness per radian: more than light on matter does


@dataclass(frozen=True, kw_only=True, eq=False)
class ShotMaterials:
    """Materials of a shot, found once: log chromaticity (M, 2) of each, and how far its shading is trusted where it turns (M,) 0..1."""

    colours: Float64
    trust: Float64

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return {"colours": self.colours.round(4).tolist(), "trust": self.trust.round(3).tolist()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """What a frame says of each of its M materials; every array (M,), colours (M, 2).

    colours : log chromaticity.           size : share of the frame.
    share   : of its brightness that normals from disparity alone explain, or its own light where that explains less.
    gain    : error of the given normals over that of shading's.   turns : median angle of its normals to their mean, degrees.
    patches : of its ground that are each as wide as what noise and grain share.
    """

    colours: Float64
    size: Float64
    share: Float64
    gain: Float64
    turns: Float64
    patches: Float64

    @property
    def turning(self) -> Float64:
        """0 for a flat material, whose brightness is all paint, to 1."""
        return rising(self.turns, *LEAST_TURN_DEG)

    @property
    def trust(self) -> Float64:
        """How far each material's shading is trusted, by this frame alone."""
        return _trust(self.share, self.gain, self.patches) * self.turning

    def trust_by(self, shot: ShotMaterials) -> Float64:
        """The same by the whole shot; a colour that the shot does not know is left to disparity."""
        if len(shot.trust) == 0 or len(self.colours) == 0:
            return np.zeros(len(self.colours))
        apart = np.linalg.norm(self.colours[:, None] - shot.colours, axis=-1)
        known = apart.min(axis=1) < APART
        return np.where(known, shot.trust[apart.argmin(axis=1)], 0.0) * self.turning


def _trust(share: Float64, gain: Float64, patches: Float64) -> Float64:
    needed = np.interp(gain, MUCH_GAIN[::-1], LEAST_SHARE[::-1])
    trust: Float64 = rising(share - needed, -HALF_SURE, HALF_SURE) * rising(gain, *LEAST_GAIN) * rising(patches, *LEAST_PATCHES)
    return trust


def sizes_of(labels: Labels, count: int) -> Float64:
    """(M,) share of the picture that each material covers."""
    size: Float64 = np.bincount(labels[labels >= 0].ravel(), minlength=count)[:count] / max(labels.size, 1)
    return size


def judged(level: Level, lit: State, plain: State) -> Judged:
    """Three questions: do normals from disparity alone explain the brightness (else it is paint); do they turn at all (else the material
    is flat, and all its brightness is paint); does shading, as far as its light fits, know normals better than disparity does?
    And is there enough of it to tell a light by.

    lit, plain : the level solved with shading and without.
    """
    count = level.count
    cells = level.cells
    explained = lit_by(level, cells, cells_of(level.grey), plain.v).explained
    gain, turns = np.zeros(count), np.zeros(count)
    sensitivity = np.hypot(lit.gu, lit.gv) / np.float32(level.focal)
    for k in range(count):
        here = cells == k
        if here.sum() < 50 or explained[k] <= 0:
            continue
        N = plain.N[:, here].astype(np.float64)
        turns[k] = np.degrees(np.median(np.arccos(np.clip(N.mean(axis=1) @ N / max(float(np.linalg.norm(N.mean(axis=1))), 1e-9), -1, 1))))
        sense = min(float(np.median(sensitivity[here])), MOST_SENSITIVE)
        gain[k] = math.sqrt(float(np.median(level.turned[here]))) * sense / max(float(lit.light.residual[k]), GRAIN)
    share = np.minimum(explained, lit.light.explained)
    size = sizes_of(level.labels, count)
    patches = size * WORK_WIDTH**2 * (level.v.shape[0] / level.v.shape[1]) / HELD_OUT_BLOCK**2
    return Judged(colours=level.colours, size=size, share=share, gain=gain, turns=turns, patches=patches)


def pooled(frames: Sequence[Judged]) -> ShotMaterials:
    """What frames spread over a shot say together: share and gain of what is of one colour and turns, each frame's by its size there."""
    told = [(*f.colours[k], f.size[k], f.turning[k], f.share[k], f.gain[k], f.patches[k]) for f in frames for k in range(len(f.size))]
    rows = np.array(told).reshape(-1, 7)
    rows = rows[np.argsort(-rows[:, 2], kind="stable")]
    colours, trust = [], []
    while len(rows):
        alike = np.linalg.norm(rows[:, :2] - rows[0, :2], axis=1) < APART
        its = rows[alike]
        colours.append(np.average(its[:, :2], axis=0, weights=its[:, 2]))
        weight = its[:, 2] * its[:, 3]
        means = (weight @ its[:, 4:] / max(weight.sum(), 1e-12))[:, None]
        trust.append(float(_trust(*means)[0]) if weight.any() else 0.0)
        rows = rows[~alike]
    return ShotMaterials(colours=np.array(colours).reshape(-1, 2), trust=np.array(trust))
