"""Matching by adaptive support: what it sums is what it says it sums, things keep their own outline, threads change nothing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereorelight.engine.census import census
from stereorelight.engine.support import CHUNK, supported
from stereorelight.threads import set_threads, usable_cores

f4 = np.float32


def textured(seed: int, h: int, w: int, *, tone: float = 120, contrast: float = 40) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(h, w, 3))
    return np.clip(cv2.GaussianBlur(noise, (0, 0), 0.8) * contrast + tone, 0, 255).astype(np.uint8)


def grey(picture: np.ndarray) -> np.ndarray:
    return picture.astype(f4).mean(axis=2).astype(f4)


def answers(left: np.ndarray, right: np.ndarray, low: int, count: int, **given) -> tuple[np.ndarray, np.ndarray]:
    return supported(left, grey(left), grey(right), low, count, **given)


def test_census_counts_the_steps_between_answers() -> None:
    rng = np.random.default_rng(0)
    a, b = (rng.integers(0, 6, (9, 11)).astype(f4) for _ in range(2))
    words = [census(p, alike=1.0) for p in (a, b)]

    def said(p: np.ndarray) -> np.ndarray:
        q = np.pad(p, 2, mode="edge")
        near = np.stack([q[2 + j : 2 + j + 9, 2 + i : 2 + i + 11] for j in range(-2, 3) for i in range(-2, 3) if (i, j) != (0, 0)])
        return (near - p > 1).astype(int) + (near - p > -1)

    steps = np.abs(said(a) - said(b)).sum(axis=0)
    assert [bin(int(w)).count("1") for w in (words[0] ^ words[1]).ravel()] == list(steps.ravel())


@pytest.mark.parametrize(("low", "h", "w"), [(-9, 10, 26), (0, 11, 26), (3, 10, 26), (-9, 5, 83), (2, 4, 83), (3, 35, 26), (0, 48, 33)])
def test_costs_are_averaged_as_told(low: int, h: int, w: int) -> None:
    """Against the sums written out, over two chunks, with disparities that leave the frame on both sides."""
    count = CHUNK + 4
    left, right = textured(1, h, w), textured(2, h, w)
    given = np.random.default_rng(3).uniform(low, low + count, (h, w)).astype(f4)
    given[0, :5] = np.nan
    got, got_right = answers(left, right, low, count, given=given)
    a, b = grey(left), grey(right)
    words = [census(p, alike=1.0) for p in (a, b)]
    chunks = 2 * CHUNK
    disparities = low + count - 1 - np.arange(chunks)  # whole chunks: those beyond the range's lower end are looked at too
    cost = np.empty((h, w, chunks))
    for y in range(h):
        for x in range(w):
            for k, d in enumerate(disparities):
                u = min(max(x - d, 0), w - 1)
                pull = 0 if np.isnan(given[y, x]) else min(2.0 * abs(d - given[y, x]), 8.0)
                cost[y, x, k] = 2.0 * bin(int(words[0][y, x] ^ words[1][y, u])).count("1") + min(abs(a[y, x] - b[y, u]), 8) + pull

    def averaged(c: np.ndarray, axis: int) -> np.ndarray:
        step = np.abs(np.diff(left.astype(int), axis=axis)).max(axis=2)
        logs = np.concatenate([np.zeros_like(np.take(step, [0], axis)), np.cumsum(step / 20 + 1 / 20, axis=axis)], axis=axis)
        c, logs = np.moveaxis(c, axis, 1), np.moveaxis(logs, axis, 1)
        share = np.exp(-np.abs(logs[:, :, None] - logs[:, None, :]))
        out = np.einsum("rij,rjk->rik", share / share.sum(axis=2, keepdims=True), c)
        return np.moveaxis(out, 1, axis)

    mean = averaged(averaged(cost, 1), 0)
    best = disparities[mean.argmin(axis=2)]
    assert np.abs(got - best).max() <= 0.5 + 1e-4
    for y in range(h):
        for u in range(w):
            seen = [(mean[y, u + d, k], d) for k, d in enumerate(disparities) if 0 <= u + d < w]
            assert got_right[y, u] == min(seen)[1]


def test_a_shifted_picture_is_found_to_a_part_of_a_pixel() -> None:
    wide = cv2.GaussianBlur(np.random.default_rng(5).normal(size=(60, 200, 3)).astype(f4), (0, 0), 1.5) * 90 + 128
    left = np.clip(wide[:, 20:180], 0, 255).astype(np.uint8)
    shift = 6.3
    x = np.arange(160, dtype=f4)[None].repeat(60, 0) + 20 + f4(shift)
    right = np.clip(cv2.remap(wide, x, np.arange(60, dtype=f4)[:, None].repeat(160, 1), cv2.INTER_CUBIC), 0, 255).astype(np.uint8)
    got, got_right = answers(left, right, 0, 16)
    assert np.abs(got[5:-5, 20:-10] - shift).max() < 0.35
    assert (np.abs(got_right[5:-5, 10:-20] - shift) < 0.5 + 1e-6).mean() > 0.99


def test_gaps_between_slats_stay_gaps() -> None:
    """Slats 4 px wide before a wall of another tone, 5 px apart: windows of any size see more slat than wall."""
    h, w, near, far = 60, 160, 12, 3
    slats, wall = textured(7, h, w + 40, tone=170, contrast=25), textured(8, h, w + 40, tone=80, contrast=25)
    x = np.arange(w + 40)
    is_slat = (x % 9 < 4) & (x > 50) & (x < 150)
    left = np.where(is_slat[None, 20 : 20 + w, None], slats[:, 20 : 20 + w], wall[:, 20 : 20 + w])
    right = np.where(is_slat[None, 20 + near : 20 + near + w, None], slats[:, 20 + near : 20 + near + w], wall[:, 20 + far : 20 + far + w])
    truth = np.where(is_slat[20 : 20 + w], near, far)
    got, _ = answers(left, right, 0, 16)
    hidden = np.array([is_slat[20 + u - far + near] if not s else False for u, s in zip(range(w), is_slat[20 : 20 + w], strict=True)])
    inside = slice(30, 130)
    wrong = (np.abs(got - truth) > 1)[:, inside]
    seen = ~hidden[inside]
    assert wrong[:, seen].mean() < 0.05
    block = cv2.StereoSGBM_create(0, 16, 3, 54, 810, 1, 63, 0, 0, 0, cv2.STEREO_SGBM_MODE_SGBM_3WAY).compute(left, right) / 16
    assert wrong[:, seen].mean() < 0.5 * (np.abs(block - truth) > 1)[:, inside][:, seen].mean()


def test_same_bits_whatever_the_threads() -> None:
    left, right = textured(1, 70, 90), textured(2, 70, 90)
    both = []
    try:
        for threads in (1, 2):
            set_threads(threads)
            both.append(answers(left, right, -5, 40))
    finally:
        set_threads(usable_cores())
    for a, b in zip(*both, strict=True):
        assert np.array_equal(a, b, equal_nan=True)
