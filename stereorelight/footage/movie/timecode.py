"""Time code: hours, minutes, seconds and frames of a day, at whole and at NTSC rates, with and without drop-frame.

In, out: text "01:00:00:00" ("01:00:00;00" where frames are dropped), and frames counted from midnight.
Source: SMPTE ST 12-1:2014.  Drop-frame leaves out numbers, never pictures: at 30000/1001 the first two numbers of every minute
but each tenth, four at 60000/1001, so that the clock keeps step with the day to 86 ms."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from fractions import Fraction

from stereorelight.errors import PlateError

TEXT = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})([:;.,])(\d{2,3})")
DROPPED = {Fraction(30000, 1001): 2, Fraction(60000, 1001): 4, Fraction(120000, 1001): 8}


@dataclass(frozen=True, kw_only=True)
class Timecode:
    """A frame's time code.

    frames : frames since 00:00:00:00, held within one day.
    rate   : frames a second, exactly: Fraction(24000, 1001) and the like.
    drop   : whether numbers are left out; only at 29.97, 59.94 and 119.88.
    """

    frames: int
    rate: Fraction
    drop: bool = False

    def __post_init__(self) -> None:
        rate = Fraction(self.rate)
        if rate <= 0 or self.nominal_of(rate) < 1:
            raise PlateError(f"a frame rate must be at least one frame a second, got {rate}")
        if self.drop and rate not in DROPPED:
            raise PlateError(
                f"drop-frame time code is for 30000/1001 and 60000/1001 frames a second, not {rate}; write it with ':' before the frames"
            )
        object.__setattr__(self, "rate", rate)
        object.__setattr__(self, "frames", int(self.frames) % self._day())

    @staticmethod
    def nominal_of(rate: Fraction) -> int:
        """The frames that a second of the clock counts: 24 at 24000/1001."""
        return int(rate + Fraction(1, 2))

    @property
    def nominal(self) -> int:
        return self.nominal_of(self.rate)

    def _day(self) -> int:
        return 144 * self._ten_minutes()

    def _ten_minutes(self) -> int:
        return 600 * self.nominal - (9 * DROPPED[self.rate] if self.drop else 0)

    @classmethod
    def parse(cls, text: str, rate: Fraction) -> Timecode:
        """`text` at `rate`; ';', '.' or ',' before the frames means drop-frame.

        Raises : PlateError for what is no time code, for a number that does not exist, and for drop-frame at a rate without it.
        """
        match = TEXT.fullmatch(str(text).strip())
        if match is None:
            raise PlateError(f"time code {text!r} is not hours:minutes:seconds:frames, such as 01:00:00:00")
        hours, minutes, seconds, count = (int(match[k]) for k in (1, 2, 3, 5))
        whole = cls(frames=0, rate=rate, drop=match[4] != ":")
        if hours > 23 or minutes > 59 or seconds > 59 or count >= whole.nominal:
            raise PlateError(f"time code {text!r} does not exist at {whole.nominal} frames a second of the clock")
        total = ((hours * 60 + minutes) * 60 + seconds) * whole.nominal + count
        if whole.drop:
            lost = DROPPED[whole.rate]
            if minutes % 10 and seconds == 0 and count < lost:
                raise PlateError(f"time code {text!r} does not exist: drop-frame leaves out the first {lost} numbers of this minute")
            total -= lost * (hours * 54 + minutes - minutes // 10)
        return replace(whole, frames=total)

    def __str__(self) -> str:
        number = self.frames
        if self.drop:
            lost = DROPPED[self.rate]
            tens, rest = divmod(number, self._ten_minutes())
            # The first minute of each ten is whole, the other nine are short.
            number += lost * (9 * tens + max(0, (rest - lost) // (60 * self.nominal - lost)))
        seconds, count = divmod(number, self.nominal)
        digits = 2 if self.nominal <= 100 else 3
        return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}{';' if self.drop else ':'}{count:0{digits}d}"

    def __add__(self, frames: int) -> Timecode:
        """The time code so many frames later; after the day's last frame comes 00:00:00:00."""
        return replace(self, frames=self.frames + frames)

    def __sub__(self, other: Timecode) -> int:
        """Frames from `other` to this.  Raises PlateError where the two count differently."""
        if (self.rate, self.drop) != (other.rate, other.drop):
            raise PlateError(
                f"time codes {self} at {self.rate} and {other} at {other.rate} frames a second cannot be compared; conform them to one rate"
            )
        return self.frames - other.frames

    @property
    def seconds(self) -> Fraction:
        """Time since 00:00:00:00 as a wall clock shows it."""
        return self.frames / self.rate
