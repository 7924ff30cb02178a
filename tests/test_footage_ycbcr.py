"""Planes and R'G'B': the published code values, the whole circle in every depth and range, chroma where the standard puts it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.errors import PassError, PlateError
from stereorelight.footage.ycbcr import planes_from_rgb, rgb_from_planes, weights

MATRICES = ("bt601", "bt709", "bt2020")
FLOAT = 4e-6  # float32, a few roundings of values up to 2


def planes(bits: int, *values: int, shape: tuple[int, int] = (4, 6)) -> list[np.ndarray]:
    return [np.full(shape, v, np.uint8 if bits == 8 else np.uint16) for v in values]


@pytest.mark.parametrize("matrix", MATRICES)
@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_white_black_and_grey_are_exact(matrix: str, bits: int) -> None:
    k = 2 ** (bits - 8)
    for full, black, white, neutral in ((False, 16 * k, 235 * k, 128 * k), (True, 0, 2**bits - 1, 2 ** (bits - 1))):
        for value, code in ((1, white), (0, black)):
            found = rgb_from_planes(planes(bits, code, neutral, neutral), bits=bits, full_range=full, matrix=matrix)
            assert (found == value).all()
        grey = rgb_from_planes(planes(bits, (white + black) // 3, neutral, neutral), bits=bits, full_range=full, matrix=matrix)
        assert (grey[..., 0] == grey[..., 1]).all()
        assert (grey[..., 1] == grey[..., 2]).all()


def test_published_colour_bars() -> None:
    """100 % bars of Rec.709 in 10 bits, video range: ITU-R BT.709's own equations rounded, as in SMPTE RP 219 tables."""
    bars = {(1, 1, 0): (877, 64, 553), (0, 1, 1): (754, 615, 64), (0, 1, 0): (691, 167, 105), (1, 0, 1): (313, 857, 919)}
    bars |= {(1, 0, 0): (250, 409, 960), (0, 0, 1): (127, 960, 471), (1, 1, 1): (940, 512, 512), (0, 0, 0): (64, 512, 512)}
    for rgb, codes in bars.items():
        picture = np.broadcast_to(np.float32(rgb), (2, 2, 3))
        found = planes_from_rgb(picture, bits=10, full_range=False, matrix="bt709", subsampling="444")
        assert tuple(int(p[0, 0]) for p in found) == codes


@given(st.sampled_from([8, 10, 12, 16]), st.booleans(), st.sampled_from(MATRICES), st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_planes_come_back_as_they_were(bits: int, full: bool, matrix: str, width: int, height: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    given_planes = [rng.integers(0, 2**bits, (height, width)).astype(np.uint8 if bits == 8 else np.uint16) for _ in range(3)]
    rgb = rgb_from_planes(given_planes, bits=bits, full_range=full, matrix=matrix)
    found = planes_from_rgb(rgb, bits=bits, full_range=full, matrix=matrix, subsampling="444")
    for a, b in zip(given_planes, found):
        np.testing.assert_array_equal(a, b)


@given(st.sampled_from([8, 10, 12, 16]), st.booleans(), st.sampled_from(MATRICES), st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_pictures_come_back_within_the_quantum(bits: int, full: bool, matrix: str, seed: int) -> None:
    rgb = np.random.default_rng(seed).uniform(0, 1, (5, 7, 3)).astype(np.float32)
    found = rgb_from_planes(
        planes_from_rgb(rgb, bits=bits, full_range=full, matrix=matrix, subsampling="444"), bits=bits, full_range=full, matrix=matrix
    )
    # Half a code of each of Y, Cb, Cr, weighed as the matrix weighs them.
    kr, kb = weights(matrix)
    span, chroma = (2**bits - 1, 2**bits - 1) if full else (219 * 2 ** (bits - 8), 224 * 2 ** (bits - 8))
    bound = 0.5 / span + 0.5 / chroma * 2 * max(1 - kr, 1 - kb)
    assert np.abs(found - rgb).max() <= bound + FLOAT


@pytest.mark.parametrize("siting", ["left", "topleft", "center"])
@pytest.mark.parametrize("kind", ["422", "420"])
@pytest.mark.parametrize("size", [(12, 16), (11, 15), (1, 1), (2, 3)])
def test_flat_colour_and_straight_gradients_pass_subsampling(siting: str, kind: str, size: tuple[int, int]) -> None:
    options = {"bits": 16, "full_range": False, "matrix": "bt709", "siting": siting}
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(np.float32)
    ramp = np.dstack([0.3 + 0.02 * x, 0.5 - 0.01 * x + 0.01 * y, 0.2 + 0.02 * y]).astype(np.float32)
    for rgb, margin in ((np.broadcast_to(np.float32([0.7, 0.2, 0.4]), (*size, 3)), 0), (ramp, 3)):
        found = rgb_from_planes(planes_from_rgb(rgb, subsampling=kind, **options), **options)
        inside = np.s_[margin : size[0] - margin, margin : size[1] - margin]
        assert found.shape == rgb.shape
        assert np.abs(found - rgb)[inside].max(initial=0) < 4e-5  # a 16 bit code, and half a one of chroma


def test_chroma_lies_where_it_is_said_to() -> None:
    luma = np.full((4, 8), 500, np.uint16)
    step = np.tile(np.array([512, 512, 812, 812], np.uint16), (4, 1))
    flat = np.full((4, 4), 512, np.uint16)
    red = rgb_from_planes([luma, flat, step], bits=10, full_range=False, matrix="bt709")[0, :, 0]
    share = (red - red[0]) / (red[-1] - red[0])
    np.testing.assert_allclose(share, [0, 0, 0, 0.5, 1, 1, 1, 1], atol=1e-6)
    red = rgb_from_planes([luma, flat, step], bits=10, full_range=False, matrix="bt709", siting="center")[0, :, 0]
    np.testing.assert_allclose((red - red[0]) / (red[-1] - red[0]), [0, 0, 0, 0.25, 0.75, 1, 1, 1], atol=1e-6)
    rows = np.array([[512] * 4, [812] * 4], np.uint16)
    red = rgb_from_planes([luma, np.full((2, 4), 512, np.uint16), rows], bits=10, full_range=False, matrix="bt709")[:, 0, 0]
    np.testing.assert_allclose((red - red[0]) / (red[-1] - red[0]), [0, 0.25, 0.75, 1], atol=1e-6)


def test_beyond_black_and_white_is_kept_and_padding_ignored() -> None:
    wide = np.full((4, 32), 9, np.uint16)
    wide[:, :6] = 1019
    found = rgb_from_planes([wide[:, :6], *planes(10, 512, 512)], bits=10, full_range=False, matrix="bt709")
    np.testing.assert_allclose(found, (1019 - 64) / 876, rtol=1e-6)
    assert (rgb_from_planes(planes(10, 4, 512, 512), bits=10, full_range=False, matrix="bt709") < 0).all()


@pytest.mark.parametrize("with_matrix", [False, True])
def test_the_fused_curve_is_the_curve_after(with_matrix: bool) -> None:
    rng = np.random.default_rng(2)
    p = [rng.integers(0, 1024, s).astype(np.uint16) for s in ((9, 14), (9, 7), (9, 7))]
    matrix = rng.normal(size=(3, 3)).astype(np.float32) if with_matrix else None
    table = np.exp(np.linspace(-0.5, 1.5, 4097)).astype(np.float32)
    plain = rgb_from_planes(p, bits=10, full_range=False, matrix="bt709").astype(np.float64)
    found = rgb_from_planes(p, bits=10, full_range=False, matrix="bt709", transfer=SimpleNamespace(low=-0.5, high=1.5, table=table, matrix=matrix))
    step = 2 / 4096
    wanted = np.exp(plain)
    first, last = (float(table[k + 1] - table[k]) / step for k in (0, -2))
    below, above = table[0] + first * (plain + 0.5), table[-1] + last * (plain - 1.5)
    wanted = np.where(plain < -0.5, below, np.where(plain > 1.5, above, wanted))
    if matrix is not None:
        wanted = wanted @ matrix.astype(np.float64).T
    np.testing.assert_allclose(found, wanted, atol=2e-5, rtol=1e-5)


def test_rgb_and_grey_planes() -> None:
    r, g, b = (np.full((3, 5), v, np.uint16) for v in (1023, 512, 0))
    np.testing.assert_array_equal(rgb_from_planes([r, g, b], bits=10, full_range=True, matrix="rgb")[0, 0], np.float32([1, 512 / 1023, 0]))
    assert (rgb_from_planes([r], bits=10, full_range=True, matrix="bt709") == 1).all()


def thinned(a: np.ndarray, axis: int, *, cosited: bool) -> np.ndarray:
    """Half the samples along `axis`: 1 2 1 about every even one, or the mean of an even one and the next."""
    a = np.moveaxis(a, axis, 0)
    if cosited:
        padded = np.concatenate([a[:1], a, a[-1:]])
        thin = 0.25 * padded[0:-2:2] + 0.5 * padded[1:-1:2] + 0.25 * padded[2::2]
    else:
        padded = a if len(a) % 2 == 0 else np.concatenate([a, a[-1:]])
        thin = 0.5 * (padded[0::2] + padded[1::2])
    return np.moveaxis(thin, 0, axis)


@given(
    st.sampled_from([8, 10, 12, 16]),
    st.booleans(),
    st.sampled_from([*MATRICES, "rgb"]),
    st.sampled_from(["444", "422", "420"]),
    st.sampled_from(["left", "topleft", "center"]),
    st.sampled_from([np.float32, np.float64]),
    st.integers(1, 60),
    st.integers(1, 21),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=50, deadline=None)
def test_codes_are_those_of_the_formula_written_out(
    bits: int, full: bool, matrix: str, kind: str, siting: str, dtype: type, height: int, width: int, seed: int
) -> None:
    """ITU-T H.273 8.3 in whole-picture float64 arithmetic, in the same order of operations: equal to the last code."""
    kind = "444" if matrix == "rgb" else kind
    rgb = np.random.default_rng(seed).uniform(-0.4, 1.4, (height, width, 3)).astype(dtype)
    found = planes_from_rgb(rgb, bits=bits, full_range=full, matrix=matrix, subsampling=kind, siting=siting)
    k, top = 2.0 ** (bits - 8), 2.0**bits - 1
    black, white, neutral, chroma = (0.0, top, 2.0 ** (bits - 1), top) if full else (16 * k, 219 * k, 128 * k, 224 * k)
    r, g, b = (rgb[..., c].astype(np.float64) for c in range(3))
    samples = [(r, black, white), (g, black, white), (b, black, white)]
    if matrix != "rgb":
        kr, kb = weights(matrix)
        y = kr * r + (1 - kr - kb) * g + kb * b
        parts = [(b - y) / (2 * (1 - kb)), (r - y) / (2 * (1 - kr))]
        if kind != "444":
            parts = [thinned(p, 1, cosited=siting != "center") for p in parts]
        if kind == "420":
            parts = [thinned(p, 0, cosited=siting == "topleft") for p in parts]
        samples = [(y, black, white), *[(p, neutral, chroma) for p in parts]]
    for plane, (values, zero, span) in zip(found, samples, strict=True):
        assert plane.dtype == (np.uint8 if bits == 8 else np.uint16)
        np.testing.assert_array_equal(plane, np.clip(np.floor(values * span + (zero + 0.5)), 0, top))


def test_refusals() -> None:
    good = planes(10, 64, 512, 512)
    with pytest.raises(PlateError, match="did you mean 'bt709'"):
        rgb_from_planes(good, bits=10, full_range=False, matrix="bt710")
    with pytest.raises(PlateError, match="7 bits"):
        rgb_from_planes(good, bits=7, full_range=False, matrix="bt709")
    with pytest.raises(PassError, match="must be uint16"):
        rgb_from_planes([p.astype(np.uint8) for p in good], bits=10, full_range=False, matrix="bt709")
    with pytest.raises(PassError, match="do not belong"):
        rgb_from_planes([good[0], good[1][:, :2], good[2][:, :2]], bits=10, full_range=False, matrix="bt709")
    with pytest.raises(PassError, match="NaN"):
        planes_from_rgb(np.full((2, 2, 3), np.nan), bits=8, full_range=False, matrix="bt709", subsampling="444")
