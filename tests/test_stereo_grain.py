"""Grain is told by tone under texture, evened by the tone curve, and ground that both eyes show nothing of in common is doubted."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.engine.grain import flutter
from stereorelight.engine.tone import LEVELS, levels, through_tables
from stereorelight.stereo.confidence import alone
from stereorelight.stereo.grain import Grain, even_tones, grain_by_tone
from stereorelight.stereo.proxy import CALM, matching_proxy

f4 = np.float32
TONES = np.array([20, 40, 80, 160]) / 255


def scene(size: tuple[int, int] = (480, 640), textured: float = 0.5) -> np.ndarray:
    """(H, W, 3) light from 0.003 to 1, a part of it with texture of its own light's size."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[: size[0], : size[1]]
    light = 10 ** (-2.5 * (x / size[1]) ** 0.7)
    rough = cv2.GaussianBlur(rng.standard_normal(size), (0, 0), 1.5)
    rough *= 0.4 / rough.std()
    return np.repeat((light * np.where(y < textured * size[0], np.exp(rough), 1))[..., None], 3, axis=2).astype(f4)


def grainy(light: np.ndarray, floor: float, shot: float, seed: int = 1) -> np.ndarray:
    return (light + np.sqrt(floor + shot * light) * np.random.default_rng(seed).standard_normal(light.shape)).astype(f4)


@pytest.mark.parametrize(("floor", "shot"), [(0.004**2, 0.0), (0.0, 6e-4), (0.003**2, 4e-4), (0.01**2, 0.0)])
def test_grain_is_told_by_tone_under_texture(floor, shot) -> None:
    found = grain_by_tone(levels(grainy(scene(), floor, shot), white=1.0)[0])
    assert found is not None
    assert found.of_tones(TONES) == pytest.approx(Grain(floor=floor, shot=shot).of_tones(TONES), rel=0.2)


def test_no_grain_is_told_of_clean_plates_and_none_of_black_ones() -> None:
    clean = levels(scene(), white=1.0)[0]
    found = grain_by_tone(clean)
    assert found is not None
    assert found.of_tones(TONES).max() < 1
    assert even_tones([found], clean, calm=CALM) is None
    assert grain_by_tone(np.zeros((480, 640, 3), np.uint16)) is None
    assert even_tones([], clean, calm=CALM) is None
    assert grain_by_tone(clean[:9, :9]) is None
    assert even_tones([Grain(floor=0.0005**2, shot=0.0)], np.maximum(clean, 1200), calm=CALM) is None, (
        "no tone is there that grain would be strong in"
    )


@pytest.mark.parametrize("sigma_px", [0.8, 1.0])
def test_texture_that_is_everywhere_is_no_grain(sigma_px: float) -> None:
    """It flutters more over two pixels than over one, as white grain does not."""
    texture = cv2.GaussianBlur(np.random.default_rng(4).random((400, 600), dtype=np.float32), (0, 0), sigma_px)
    light = np.clip(0.3 + 0.08 * (texture - texture.mean()) / texture.std(), 0.01, 0.95).astype(np.float32)
    grain = grain_by_tone(levels(np.repeat(light[..., None], 3, axis=-1), white=1.0)[0])
    assert grain is not None
    assert grain.floor + 0.3 * grain.shot < 0.002**2


def test_flutter_is_the_variance_of_white_grain_whatever_the_ramp() -> None:
    y, x = np.mgrid[:200, :300]
    ramp = np.repeat((0.3 + 0.001 * x + 0.0005 * y)[..., None], 3, axis=2).astype(f4)
    light, near, far = flutter(levels(grainy(ramp, 0.01**2, 0.0), white=1.0)[0], step=8)
    assert light.mean() == pytest.approx(ramp.mean(), rel=0.03)
    assert near.mean() == pytest.approx(0.01**2, rel=0.05)
    assert far.mean() == pytest.approx(0.01**2, rel=0.05)
    assert np.isnan(flutter(levels(ramp * 10, white=1.0)[0], step=8)[0]).all()


def test_tones_make_grain_even_and_leave_photon_noise_alone() -> None:
    flat = scene(textured=0)
    plates = [levels(grainy(flat, 0.004**2, 0.0, seed), white=1.0)[0] for seed in (1, 2)]
    grains = [grain_by_tone(p) for p in plates]
    curve = even_tones([g for g in grains if g is not None], plates[0], calm=CALM)
    assert curve is not None
    assert curve[0] == 0
    assert curve[-1] <= 255
    assert (np.diff(curve) > 0).all()
    straight = np.linspace(0, 255, LEVELS, dtype=f4)

    def spread(table: np.ndarray) -> np.ndarray:
        greys = [through_tables(p, np.ascontiguousarray(np.broadcast_to(table, (3, LEVELS))))[0][..., 1].astype(f4) for p in plates]
        return np.array([(greys[0] - greys[1])[:, c : c + 40].std() for c in range(0, 560, 80)])

    assert spread(straight).max() > 2.5 * np.median(spread(straight))
    assert spread(curve).max() < 1.5 * np.median(spread(curve))
    photons = levels(grainy(flat, 0.0, 6e-4), white=1.0)[0]
    found = grain_by_tone(photons)
    assert found is not None
    assert even_tones([found], photons, calm=CALM) is None


def test_both_eyes_go_through_the_curve() -> None:
    flat = scene()
    pair = matching_proxy(*(grainy(flat, 0.006**2, 0.0, seed) for seed in (1, 2)))
    assert np.abs(cv2.blur(pair.left_grey - pair.right_grey, (41, 41))).max() < 3
    dark, bright = (slice(300, None), slice(500, 600)), (slice(300, None), slice(40, 140))
    noise = [(pair.left_grey - pair.right_grey)[part].std() for part in (dark, bright)]
    assert noise[0] < 2.5 * noise[1]


def test_eyes_that_share_nothing_are_told_from_eyes_that_share_texture_under_grain() -> None:
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.standard_normal((120, 160)).astype(f4), (0, 0), 3)
    texture *= 3 / texture.std()
    left, right = (100 + 3 * rng.standard_normal(texture.shape).astype(f4) for _ in range(2))
    assert alone(left + texture, right + texture, 3.0).mean() < 0.2
    assert alone(left + texture, right + texture[::-1], 3.0).mean() > 0.7
    assert alone(left, right, 3.0).mean() > 0.7
    flat = np.full((119, 161), 90, f4)
    assert alone(flat, flat, 0.5).max() == 0
    assert alone(flat, flat, 0.5).shape == flat.shape
