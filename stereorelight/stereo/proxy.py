"""The matching proxy: 8-bit pictures of one tone for matchers that take nothing else.

In: rectified scene-linear plates (H, W, 3), NaN outside the plate.  Out: a `Proxy`, BGR 8-bit as OpenCV has it, the same
as float grey (0..255) for sub-pixel work, and where each plate is known.  Light is coded by its square root, which gives
photon noise equal strength in light and shade; where the plates' own grain is uneven so, by a curve that evens it (stereo/grain.py).
The right eye is given the left eye's tones, channel by channel: different exposure or colour turns 3 % of wrong matches into 16-35 %."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.locking import roughness
from stereorelight.engine.rows import at_once
from stereorelight.engine.tone import LEVELS, brightest, codes, levels, median_twist, through_tables
from stereorelight.errors import PlateError
from stereorelight.stereo.grain import even_tones, grain_by_tone
from stereorelight.stereo.tones import Tones, sample_step, tables_of_pairs, tone_tables

CALM = 2.0  # grey levels of noise that matching bears without a filter
CALM_WINDOW, CALM_RADIUS = 7, 2.0  # px
CALM_TONES = 4.6  # times the noise: what differs by more is an edge
AGAIN_WINDOW, AGAIN_RADIUS = 5, 1.2  # px, once edges are known: small, since what is averaged away no longer tells disparities apart
AGAIN_TONES = 0.5  # times the noise, of the grey that is calm already
WHITE_QUANTILE = 0.99
HEADROOM = 1.25  # white lies this much above that quantile


def grey_of(picture: UInt8) -> Float32:
    """(H, W) float32: the mean of the channels."""
    return cv2.transform(picture, np.full((1, 3), 1 / 3)).astype(np.float32) if picture.ndim == 3 else picture.astype(np.float32)


def grain_of(grey: Float32, step: float = 1.0) -> float:
    """Standard deviation of the noise of a grey picture, grey levels: the median of a mask that knows no ramps (Immerkaer 1996), on a
    sixteenth of the pixels.

    step : how far apart on the plate its pixels were taken; finer pixels hang together, and look calmer to the mask than they are.
    """
    h, w = grey.shape
    twist = np.zeros((len(range(0, h - 2, 4)), len(range(0, w - 2, 4))), np.float32)
    for y, row in enumerate(((1, -2, 1), (-2, 4, -2), (1, -2, 1))):
        for x, share in enumerate(row):
            twist += np.float32(share) * grey[y : h - 2 + y : 4, x : w - 2 + x : 4]
    return float(np.median(np.abs(twist))) / (0.6745 * 6 * roughness(step)) if twist.size else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Proxy:
    """Left and right as matchers want them: (H, W, 3) uint8 BGR, (H, W) float32 grey 0..255, and known pixels.

    steps : how far apart on its plate each eye's pixels were taken, in pixels of the plate.
    tones : what the greys were made of, where that is known.
    """

    left: UInt8
    right: UInt8
    left_grey: Float32
    right_grey: Float32
    left_known: Bool
    right_known: Bool
    steps: tuple[float, float] = (1.0, 1.0)
    tones: Tones | None = None

    def flipped(self) -> Proxy:
        """The pair as seen in a mirror, eyes exchanged: matching it gives the right eye's disparity."""
        return Proxy(
            left=np.ascontiguousarray(self.right[:, ::-1]),
            right=np.ascontiguousarray(self.left[:, ::-1]),
            left_grey=np.ascontiguousarray(self.right_grey[:, ::-1]),
            right_grey=np.ascontiguousarray(self.left_grey[:, ::-1]),
            left_known=np.ascontiguousarray(self.right_known[:, ::-1]),
            right_known=np.ascontiguousarray(self.left_known[:, ::-1]),
            steps=self.steps[::-1],
            tones=None if self.tones is None else self.tones.flipped(),
        )

    def toned(self, disparity: Float32, seen: Bool) -> Proxy:
        """The same with the right eye's tones by what both eyes see: where a disparity (H, W) px of the left eye is `seen` (H, W) to be right."""
        tables = None if self.tones is None else tables_of_pairs(self.tones, disparity, seen)
        if self.tones is None or tables is None:
            return self
        right, right_grey = through_tables(self.tones.levels[1], tables)
        made = replace(self, right=right, right_grey=right_grey, tones=replace(self.tones, tables=(self.tones.tables[0], tables)))
        if "_noise" in self.__dict__:  # of the left eye
            made.__dict__["_noise"] = self._noise
        return made

    def calmed(self) -> Proxy:
        """The same with its grain taken out of the 8-bit pictures, edges kept, where there is more of it than matching bears.

        Only for what chooses between surfaces; sub-pixel work wants every pixel as it was, so the grey pictures stay.
        Twice: a bilateral filter shows where edges are, and then the pixels as they were are averaged by what it shows, over less ground
        (joint bilateral, Petschnigg et al. 2004, with itself: rolling guidance).
        """
        sigma = self.noise()
        if sigma < CALM:
            return self

        def calm(picture: UInt8) -> UInt8:
            guide = grey_of(cv2.bilateralFilter(picture, CALM_WINDOW, CALM_TONES * sigma, CALM_RADIUS))
            mean = cv2.ximgproc.jointBilateralFilter(guide, picture.astype(np.float32), AGAIN_WINDOW, AGAIN_TONES * sigma, AGAIN_RADIUS)
            return np.clip(np.rint(mean), 0, 255).astype(np.uint8)

        return replace(self, left=calm(self.left), right=calm(self.right))

    def noise(self) -> float:
        """Standard deviation of the noise of a channel, grey levels: the median of a mask that knows no ramps (Immerkaer 1996)."""
        return self._noise

    @cached_property
    def grains(self) -> tuple[float, float]:
        """Standard deviation of the noise of either grey picture, grey levels (`grain_of`)."""
        return at_once(lambda: grain_of(self.left_grey, self.steps[0]), lambda: grain_of(self.right_grey, self.steps[1]))

    @cached_property
    def _noise(self) -> float:
        return median_twist(self.left, 1) / (0.6745 * 6 * roughness(self.steps[0]))


def _white(picture: Float32, eye: str) -> float:
    light = brightest(picture, step=sample_step(picture))
    if light.size == 0:  # hardly anything is known: look at every pixel
        light = brightest(picture)
        if light.size == 0:
            raise PlateError(f"{eye} plate has no known pixel (all NaN or infinite); check the render or the colour space")
    white = float(np.quantile(light, WHITE_QUANTILE))
    if not white > 0:
        raise PlateError(f"{eye} plate is black nearly everywhere; check exposure and colour space")
    return white * HEADROOM


def _of_three(curve: Float32) -> Float32:
    """(3, LEVELS) tables of one curve."""
    return np.ascontiguousarray(np.broadcast_to(curve, (3, LEVELS)))


def picture_of(plate: Float32, eye: str) -> UInt8:
    """(H, W, 3) BGR 8-bit of one rectified plate, in its own tones: for what tells things apart by their colours.  Raises PlateError as below."""
    return codes(np.ascontiguousarray(plate), white=_white(plate, eye))


def matching_proxy(left: Float32, right: Float32, *, steps: tuple[float, float] = (1.0, 1.0), even: bool = True) -> Proxy:
    """8-bit pictures of one tone from rectified scene-linear plates (H, W, 3); NaN marks what the plate lacks.

    steps  : how far apart on its plate each eye's pixels were taken, in pixels of the plate.
    even   : in tones in which their grain is as strong everywhere, where it is uneven.
    Raises : PlateError when a plate has no known pixel or no light at all.
    """
    (left_level, left_known), (right_level, right_known) = at_once(
        lambda: levels(left, white=_white(left, "left")), lambda: levels(right, white=_white(right, "right"))
    )
    grains = at_once(lambda: grain_by_tone(left_level, steps[0]), lambda: grain_by_tone(right_level, steps[1])) if even else ()
    curve = even_tones([one for one in grains if one is not None], left_level, calm=CALM)
    straight = np.linspace(0, 255, LEVELS, dtype=np.float32)

    own = _of_three(straight if curve is None else curve)

    def in_tones_of_left() -> tuple[UInt8, Float32, Float32]:
        tables = tone_tables(right_level, left_level)
        tables = tables if curve is None else np.interp(tables, straight, curve).astype(np.float32)
        return *through_tables(right_level, tables), tables

    (left_bgr, left_grey), (right_bgr, right_grey, tables) = at_once(lambda: through_tables(left_level, own), in_tones_of_left)
    return Proxy(
        left=left_bgr,
        right=right_bgr,
        left_grey=left_grey,
        right_grey=right_grey,
        left_known=left_known,
        right_known=right_known,
        steps=steps,
        tones=Tones(levels=(left_level, right_level), tables=(own, tables)),
    )
