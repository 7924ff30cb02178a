"""Motion blur, repeated, dropped and corrupt frames: each fault made, found where it is, and nothing raised on a clean shot."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32
from stereorelight.errors import PassError
from stereorelight.health.blur import judge_blur, motion_blur
from stereorelight.health.repeats import (
    corrupt_frames,
    dropped_frames,
    judge_corrupt,
    judge_drops,
    judge_repeats,
    repeated_frames,
    signature,
)

HEIGHT, WIDTH = 270, 480
SIZE = 0.10


def world(width: int = 1400) -> Float32:
    rng = np.random.default_rng(5)
    light = np.zeros((HEIGHT + 40, width), np.float32)
    for sigma, share in ((3.0, 0.3), (9.0, 0.5), (30.0, 1.0)):
        soft = cv2.GaussianBlur(rng.standard_normal(light.shape, dtype=np.float32), (0, 0), sigma)
        light += share * soft / soft.std()
    light = 0.2 * np.exp(0.4 * light)
    return np.ascontiguousarray(light[..., None] * np.array([1.0, 0.9, 0.8], np.float32))


WORLD = world()


def view(x: float, y: float = 20.0) -> Float32:
    """The world seen by a camera that has panned by x px."""
    M = np.array([[1, 0, x + 40], [0, 1, y]], np.float32)
    return cv2.warpAffine(WORLD, M, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def shot(at: Sequence[float], *, sigma: float = 0.005, change: Callable[[int, Float32], Float32] | None = None, seed: int = 0):
    signed = []
    for n, x in enumerate(at):
        grain = np.random.default_rng(seed * 1000 + n).standard_normal((HEIGHT, WIDTH, 3), dtype=np.float32)
        plate = view(x) + np.float32(sigma) * grain
        signed.append((1001 + n, signature(plate if change is None else change(n, plate))))
    return signed


def levels(signed) -> list[str]:
    return [judge(signed).level for judge in (judge_repeats, judge_drops, judge_corrupt)]


PAN = [6.0 * n for n in range(14)]


@pytest.mark.parametrize("sigma", [0.0, 0.005, 0.02])
@pytest.mark.parametrize(
    "at",
    [
        PAN,
        [0.7 * n for n in range(14)],
        [60 * np.sin(2 * np.pi * n / 16) for n in range(24)],  # swings and turns round
        [40 * np.cos(2 * np.pi * (n + 0.5) / 24) for n in range(24)],  # two frames at each turn see the same
        [0.4 * n * n for n in range(14)],  # speeds up
        [5.0 * min(n, 8) for n in range(18)],  # comes to rest
        [0, 0, 0, 0, 0, 0, 5, 10, 15, 20],  # starts
    ],
)
def test_clean_shots_raise_nothing(at: list[float], sigma: float) -> None:
    signed = shot(at, sigma=sigma)
    if sigma == 0 and len(set(at)) < len(at):
        return  # rest without grain is equal bits, and rightly called so
    assert levels(signed) == ["good"] * 3, [judge(signed).words for judge in (judge_repeats, judge_drops, judge_corrupt)]


def test_a_locked_off_shot_is_not_frozen() -> None:
    assert levels(shot([0.0] * 12, sigma=0.01)) == ["good"] * 3


def test_equal_bits_are_a_repeat_even_at_rest() -> None:
    plate = view(0) + np.float32(0.01) * np.random.default_rng(1).standard_normal((HEIGHT, WIDTH, 3), dtype=np.float32)
    signed = shot([0.0] * 8, sigma=0.01, change=lambda n, p: plate if n in (3, 4) else p)
    assert repeated_frames(signed) == [4]
    assert "1005" in judge_repeats(signed).words


@pytest.mark.parametrize("pace", [1.5, 6.0, 25.0])
@pytest.mark.parametrize("sigma", [0.003, 0.01])
def test_a_repeat_with_fresh_grain_is_found(pace: float, sigma: float) -> None:
    at = [pace * n for n in range(14)]
    at[6] = at[5]  # and the motion jumps after it
    assert repeated_frames(shot(at, sigma=sigma)) == [6]
    held = [pace * (n if n < 6 else n - 1) for n in range(14)]  # ... or goes on from there
    finding = judge_repeats(shot(held, sigma=sigma), eye="right")
    assert finding.details["frames"] == [1007]
    assert finding.level == "warn"
    assert "right eye" in finding.words


def test_a_repeat_that_was_compressed_again_is_found() -> None:
    def compressed(n: int, plate: Float32) -> Float32:
        coded = np.clip(np.sqrt(np.maximum(plate, 0)) * 200, 0, 255).astype(np.uint8)
        good, packed = cv2.imencode(".jpg", coded, [cv2.IMWRITE_JPEG_QUALITY, 70 if n == 6 else 90])
        assert good
        return np.square(cv2.imdecode(packed, cv2.IMREAD_COLOR).astype(np.float32) / 200)

    at = list(PAN)
    at[6] = at[5]
    assert repeated_frames(shot(at, change=compressed)) == [6]


def test_a_pulldown_is_named() -> None:
    at = [6.0 * (n - n // 5) for n in range(25)]
    finding = judge_repeats(shot(at))
    assert finding.value == 4
    assert "every 5. frame" in finding.words
    assert "pulldown" in finding.remedy


@pytest.mark.parametrize("pace", [3.0, 6.0, 12.0])
@pytest.mark.parametrize("lost", [1, 2])
def test_a_lost_frame_is_found_and_counted(pace: float, lost: int) -> None:
    at = [pace * (n if n < 7 else n + lost) for n in range(14)]
    found = dropped_frames(shot(at))
    assert [n for n, _ in found] == [7]
    assert found[0][1] == pytest.approx(lost, rel=SIZE)
    finding = judge_drops(shot(at))
    assert finding.value == lost
    assert "1008" in finding.words
    assert levels(shot(at))[0] == "good"


def damaged(kind: str) -> Callable[[int, Float32], Float32]:
    def change(n: int, plate: Float32) -> Float32:
        if n != 6:
            return plate
        plate = plate.copy()
        if kind == "nan":
            plate[40:60, 100:160] = np.nan
        elif kind == "infinite":
            plate[40:60, 100:160] = np.inf
        elif kind == "black":
            plate *= np.float32(0.001)
        elif kind == "flash":
            plate *= np.float32(2)
        elif kind == "blocks":
            for x in range(96, 320, 32):
                plate[128:160, x : x + 32] = plate[128, x]
        elif kind == "slipped":
            plate[120:200] = np.roll(plate[120:200], 90, axis=1)
        return plate

    return change


@pytest.mark.parametrize("kind", ["nan", "infinite", "black", "flash", "blocks", "slipped"])
@pytest.mark.parametrize("at", [PAN, [0.0] * 14])
def test_damage_is_found(kind: str, at: list[float]) -> None:
    signed = shot(at, change=damaged(kind))
    assert [n for n, _ in corrupt_frames(signed)] == [6]
    finding = judge_corrupt(signed, eye="left")
    assert finding.details["frames"] == [1007]
    assert finding.level == ("warn" if kind == "flash" else "bad")
    assert finding.remedy
    assert repeated_frames(signed) == []


def test_an_unknown_border_is_no_damage() -> None:
    def border(n: int, plate: Float32) -> Float32:
        plate = plate.copy()
        plate[:, :12] = np.nan
        plate[:10] = 0  # letterbox
        return plate

    assert levels(shot(PAN, change=border)) == ["good"] * 3


def test_too_few_frames_are_unknown() -> None:
    one = shot([0.0])
    assert [judge_repeats(one).level, judge_drops(one).level, judge_corrupt(one).level] == ["unknown", "unknown", "good"]


@pytest.mark.parametrize("pace", [4.0, 12.0])
def test_motion_blur_is_pace_times_shutter(pace: float) -> None:
    found = motion_blur(view(0), view(pace))
    assert found.median_px == pytest.approx(pace / 2, rel=SIZE)
    assert motion_blur(view(0), view(pace), shutter=0.25).median_px == pytest.approx(pace / 4, rel=SIZE)
    given = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    given[..., 1] = pace
    assert motion_blur(view(0), flow=given).fast_px == pytest.approx(pace / 2)


def test_motion_blur_is_judged_by_its_worst_frames() -> None:
    calm, fast = motion_blur(view(0), view(0.5)), motion_blur(view(0), view(12))
    assert judge_blur([(1, calm), (2, calm)]).level == "good"
    finding = judge_blur([(1, calm), (2, fast)])
    assert finding.level in ("warn", "bad")
    assert "frame 2" in finding.words
    assert finding.value == pytest.approx(6, rel=SIZE)
    assert judge_blur([]).level == "unknown"
    with pytest.raises(PassError, match="neither"):
        motion_blur(view(0))
