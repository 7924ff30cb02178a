"""Pictures for people: known values show as known colours, and nothing missing passes for a value."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.errors import PassError
from stereorelight.footage import preview
from stereorelight.passes import Flag


def test_a_plate_keeps_middle_gray_and_rolls_off_highlights() -> None:
    ramp = np.linspace(0, 20, 2001, dtype=np.float32)[None, :, None].repeat(3, axis=2)
    shown = preview.plate_picture(ramp)[0, :, 0].astype(int)
    assert (np.diff(shown) >= 0).all()
    assert shown[0] == 0
    assert shown[-1] == 255
    assert preview.plate_picture(np.full((1, 1, 3), 0.2140411, np.float32))[0, 0, 0] in (127, 128)
    assert shown[np.searchsorted(ramp[0, :, 0], 1.0)] < 252  # white keeps room for what is brighter


def test_missing_is_never_shown_as_a_value() -> None:
    plate = np.full((40, 40, 3), 0.5, np.float32)
    plate[:20, :, 1] = np.nan
    plate[20, 0] = np.inf
    picture = preview.plate_picture(plate)
    assert {tuple(c) for c in picture[:20].reshape(-1, 3).tolist()} == set(preview.CHECKER)
    assert tuple(picture[20, 0].tolist()) in preview.CHECKER
    for show in (preview.depth_picture, preview.confidence_picture):
        assert tuple(show(np.array([[np.nan, 0.5]], np.float32))[0, 0].tolist()) == preview.MISSING
    for show in (preview.normals_picture, preview.position_picture):
        assert tuple(show(np.array([[[np.nan, 0, 1], [0, 0, 1]]], np.float32))[0, 0].tolist()) == preview.MISSING


def test_depth_colours_rise_in_lightness_and_hold_still_over_a_sequence() -> None:
    table = preview.colour_table().astype(float) @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(table) > -1.0).all()
    assert table[-1] - table[0] > 150
    Z = np.linspace(1, 10, 100, dtype=np.float32)[None]
    near_first = preview.depth_picture(Z, near=1, far=10).astype(float) @ (0.2126, 0.7152, 0.0722)
    assert near_first[0, 0] > near_first[0, -1] + 150
    assert np.array_equal(preview.depth_picture(Z[:, :50], near=1, far=10), preview.depth_picture(Z, near=1, far=10)[:, :50])
    near, far = preview.depth_range(Z)
    assert 1 <= near < far <= 10
    assert preview.depth_picture(np.full((2, 2), np.nan, np.float32)).shape == (2, 2, 3)
    assert preview.depth_picture(np.full((2, 2), 3, np.float32)).shape == (2, 2, 3)
    with pytest.raises(PassError, match="near < far"):
        preview.depth_picture(Z, near=5, far=2)


def test_normals_show_their_direction() -> None:
    N = np.array([[[1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32)
    assert preview.normals_picture(N)[0].tolist() == [[255, 128, 128], [128, 255, 128], [128, 128, 255]]


def test_each_flag_has_its_own_colour() -> None:
    shown = preview.flags_picture(np.array([[0, *(int(f) for f in Flag)]], np.uint16))[0]
    assert len({tuple(c) for c in shown.tolist()}) == len(Flag) + 1


def test_before_after_and_sheet() -> None:
    a, b = np.zeros((10, 20, 3), np.uint8), np.full((10, 20, 3), 100, np.uint8)
    assert preview.before_after(a, b).shape == (10, 41, 3)
    wiped = preview.before_after(a, b, wipe=0.5)
    assert (wiped[:, :9] == 0).all()
    assert (wiped[:, 12:] == 100).all()
    assert (wiped == 255).any()
    with pytest.raises(PassError, match="one size"):
        preview.before_after(a, b[:5])
    sheet = preview.contact_sheet([("a", a), ("b", b), ("c", a)], width=40)
    assert sheet.dtype == np.uint8
    assert sheet.shape[1] == 2 * 46 + 6


def test_an_anaglyph_keeps_greys_and_gives_each_eye_its_own_picture() -> None:
    grey = np.arange(256, dtype=np.uint8)[None, :, None].repeat(3, axis=2)
    same = preview.anaglyph(grey, grey)
    assert np.abs(same.astype(int) - grey).max() <= 1
    white, black = np.full((4, 4, 3), 255, np.uint8), np.zeros((4, 4, 3), np.uint8)
    left_only, right_only = preview.anaglyph(white, black)[0, 0].astype(int), preview.anaglyph(black, white)[0, 0].astype(int)
    assert left_only[0] > 250 > 50 > max(left_only[1:])  # through the red filter the left eye's white, through cyan nothing
    assert min(right_only[1:]) > 250 > 50 > right_only[0]
    half = preview.anaglyph(grey, 255 - grey, method="half-colour")
    assert np.array_equal(half[..., 0], grey[..., 0])
    assert np.array_equal(half[..., 1:], 255 - grey[..., 1:])
    # By hand, in linear light: Dubois' first row on a saturated colour of the left eye.
    orange = np.array([[[255, 128, 0]]], np.uint8)
    linear = 0.4561 + 0.500484 * ((128 / 255 + 0.055) / 1.055) ** 2.4
    assert preview.anaglyph(orange, np.zeros_like(orange))[0, 0, 0] == round(255 * (1.055 * linear ** (1 / 2.4) - 0.055))
    with pytest.raises(PassError, match="one size"):
        preview.anaglyph(grey, grey[:, :9])
    with pytest.raises(PassError, match="half-colour"):
        preview.anaglyph(grey, grey, method="colour")  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [(180, 320), (1080, 1920), (40, 60), (9, 16)])
def test_a_label_stays_in_its_strip(size: tuple[int, int]) -> None:
    picture = np.full((*size, 3), 120, np.uint8)
    before = picture.copy()
    marked = preview.labelled(picture, "shot_010  1001  01:00:00:05")
    assert np.array_equal(picture, before)
    changed = np.nonzero((marked != picture).any(axis=(1, 2)))[0]
    assert changed[0] > size[0] * (0.5 if size[0] < 100 else 0.9)
    if size[0] >= 180:
        assert marked[changed[0] :].max() > 200
        edge = marked[changed[0] :, -2:]
        assert (edge == 40).all()  # the line ends before the picture does
    assert np.array_equal(preview.labelled(picture, "  "), picture)
    assert np.array_equal(preview.labelled(picture, "\u00e9t\u00e9"), preview.labelled(picture, "ete"))
