"""The range that is searched holds bare ground that a small copy of the pictures shows nothing of, and chance does not widen it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.stereo.depth import recover
from stereorelight.stereo.proxy import Proxy, matching_proxy
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.search import search_range
from stereorelight.stereo.settings import DepthSettings
from stereorelight.synth.rigs import parallel_rig

WIDTH, HEIGHT = 1920, 540
WALL_PX, CARD_PX, FAR_PX, NEAR_PX = 18.0, 48.0, 20.0, 120.0
Y, X = np.meshgrid(np.arange(HEIGHT, dtype=np.float32), np.arange(WIDTH, dtype=np.float32), indexing="ij")
RECTIFIED = rectification(parallel_rig((WIDTH, HEIGHT)))


def painted(rng: np.random.Generator, soft_px: float, contrast: float) -> np.ndarray:
    """(H, W + 256) of mean 1: marks of so many px, and light that falls off along it."""
    marks = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH + 256)).astype(np.float32), (0, 0), soft_px)
    return ((1 + contrast * marks / marks.std()) * np.linspace(0.85, 1.15, WIDTH + 256)).astype(np.float32)


def plates(bare: float, grain: float, *, desk: bool) -> tuple[list[np.ndarray], np.ndarray]:
    """A marked card before a bare wall that goes on beyond the frame, or a marked wall above a bare desk that comes nearer than anything else."""
    rng = np.random.default_rng(2)
    plain, marked = 0.45 * painted(rng, 1.2, bare), 0.3 * painted(rng, 5.0, 0.3)
    if desk:
        truth = np.where(Y < 0.4 * HEIGHT, FAR_PX, FAR_PX + (NEAR_PX - FAR_PX) * (Y / HEIGHT - 0.4) / 0.6)
    else:
        truth = np.where((np.abs(X - WIDTH / 2) < 300) & (Y > 100), CARD_PX, WALL_PX)
    eyes = []
    for share in (0.0, 1.0):

        def seen(what: np.ndarray, disparity: np.ndarray | float, share: float = share) -> np.ndarray:
            return cv2.remap(what, (X + share * disparity).astype(np.float32), Y, cv2.INTER_CUBIC)

        if desk:
            eye = np.where(Y < 0.4 * HEIGHT, seen(marked, truth), seen(plain, truth))
        else:
            card = (np.abs(X + share * CARD_PX - WIDTH / 2) < 300) & (Y > 100)
            eye = np.where(card, seen(marked, CARD_PX), seen(plain, WALL_PX))
        code = np.clip(np.rint(255 * (np.maximum(eye, 0) ** (1 / 2.2) + grain * rng.standard_normal(eye.shape))), 0, 255)
        eyes.append(np.repeat(((code / 255) ** 2.2).astype(np.float32)[..., None], 3, axis=2))
    return eyes, truth.astype(np.float32)


def small_copy_of(proxy: Proxy) -> np.ndarray:
    return cv2.resize(proxy.left_grey, (160, 45), interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("desk", [False, True], ids=["wall behind", "desk before"])
@pytest.mark.parametrize(("bare", "grain"), [(0.004, 0.0), (0.004, 0.004), (0.01, 0.01)])
def test_bare_ground_is_within_the_range(bare, grain, desk) -> None:
    eyes, truth = plates(bare, grain, desk=desk)
    proxy = matching_proxy(*eyes)
    ground = cv2.resize((truth != (FAR_PX if desk else CARD_PX)).astype(np.uint8), (160, 45), interpolation=cv2.INTER_AREA) > 0
    steps = np.abs(cv2.Scharr(small_copy_of(proxy), cv2.CV_32F, 1, 0)) / 32
    assert np.median(steps[ground]) < 0.5  # grey levels: the small copy shows nothing there
    found = search_range(proxy, RECTIFIED.rig)
    assert found.low <= truth.min() < truth.max() < found.high
    assert found.count <= 2.5 * (truth.max() - truth.min()) + 32


@pytest.mark.parametrize("shows", ["grain", "nothing"])
def test_chance_does_not_widen_the_range(shows) -> None:
    """Ground that shows its grain alone, another in either eye, and a band that is burnt out in both."""
    eyes, _ = plates(*((0.0, 0.01) if shows == "grain" else (0.1, 0.0)), desk=False)
    for eye in eyes:
        eye[:200] = 1.0
    found = search_range(matching_proxy(*eyes), RECTIFIED.rig)
    lowest, most = (CARD_PX - 12, 32) if shows == "grain" else (0, 64)
    assert found.low >= lowest
    assert found.high > CARD_PX
    assert found.count <= most


@pytest.mark.slow
def test_a_bare_wall_in_a_large_picture_is_found_where_it_is() -> None:
    eyes, truth = plates(0.01, 0.004, desk=False)
    found = recover(*eyes, RECTIFIED, settings=DepthSettings(quality="draft")).rectified
    wall = cv2.erode((truth == WALL_PX).astype(np.uint8), np.ones((31, 61), np.uint8)) > 0
    assert np.mean(np.abs(found["disparity"] - truth)[wall] > 1) < 0.05
