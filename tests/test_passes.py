"""The frame of passes: what comes in is checked once, and whatever cannot be is refused with the remedy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.arrays import as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError, nearest_hint
from stereorelight.passes import PREFIXED_ROLES, ROLES, UNIT_TOLERANCE, Flag, Frame, role_of

HW = (4, 6)
CAMERA = Camera(size=(6, 4), K=np.array([[5.0, 0, 2.5], [0, 5.0, 1.5], [0, 0, 1]]))


def plain(name: str, hw: tuple[int, int] = HW) -> npt.NDArray[Any]:
    """An array that pass `name` may be."""
    if name == "flags":
        return np.zeros(hw, np.uint16)
    channels = role_of(name).channels
    a = np.full(hw if channels is None else (*hw, channels), 0.5, np.float32)
    return a / np.linalg.norm(a, axis=-1, keepdims=True) if name == "N" else a


def with_value(name: str, value: Any) -> npt.NDArray[Any]:
    a = plain(name).copy()
    a[1, 2] = value
    return a


def refusal(**passes: Any) -> str:
    with pytest.raises(PassError) as caught:
        Frame(passes=passes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


EVERY = [*ROLES, "light_key_diffuse", "matte_actor"]


def test_every_pass_at_once() -> None:
    given = {name: plain(name) for name in EVERY}
    frame = Frame(passes=given, camera=CAMERA, eye="right", number=1001, metadata={"a": "b"})
    assert list(frame) == EVERY
    assert len(frame) == len(EVERY)
    assert frame.size_hw == HW
    for name, array in given.items():
        assert name in frame
        assert np.array_equal(frame[name], array)
        assert frame[name].dtype == (np.uint16 if name == "flags" else np.float32)
        assert frame[name].flags.c_contiguous
    assert "velocity" not in frame


@pytest.mark.parametrize("name", [n for n in EVERY if n != "flags"])
def test_missing_is_nan_in_every_pass(name: str) -> None:
    assert np.isnan(Frame(passes={name: with_value(name, np.nan)})[name][1, 2]).all()


@given(a=hnp.arrays(np.float32, HW, elements=st.floats(2.0**-100, 2.0**100, width=32) | st.just(float("nan"))))
def test_values_are_kept_bit_for_bit(a: npt.NDArray[np.float32]) -> None:
    assert np.array_equal(Frame(passes={"Z": a})["Z"].view(np.uint32), a.view(np.uint32))


def test_other_floats_and_strides_are_taken() -> None:
    wide = np.arange(1, 49, dtype=np.float64).reshape(8, 6)
    frame = Frame(passes={"Z": wide[::2], "P": np.asfortranarray(np.ones((4, 6, 3))), "confidence": np.ones(HW, np.float16)})
    assert np.array_equal(frame["Z"], wide[::2])
    assert all(a.dtype == np.float32 and a.flags.c_contiguous for a in frame.values())


@pytest.mark.parametrize("name", [n for n in EVERY if n != "flags"])
def test_wrong_shapes(name: str) -> None:
    channels = role_of(name).channels
    for wrong in ((4, 6, 4), (4, 6, 1), (6,), (1, 4, 6, 3), (4, 6) if channels else (4, 6, 3)):
        words = refusal(**{name: np.full(wrong, 0.5, np.float32)})
        assert words.startswith(f"{name} must have shape")
        assert str(wrong) in words


def test_empty() -> None:
    assert "at least one pass" in refusal()
    assert "Z is empty" in refusal(Z=np.ones((0, 5), np.float32))
    assert "Z is empty" in refusal(Z=np.ones((5, 0), np.float32))


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.int64, np.bool_, np.complex64])
def test_only_floats(dtype: Any) -> None:
    assert "Z must be float, got" in refusal(Z=np.ones(HW, dtype))


def test_int16_disparity_is_opencv_sixteenths() -> None:
    assert "divide by 16 first" in refusal(disparity=np.ones(HW, np.int16))


@pytest.mark.parametrize("name", [n for n in EVERY if n != "flags"])
@pytest.mark.parametrize("sign", [1, -1])
def test_infinity_only_in_colour(name: str, sign: int) -> None:
    a = with_value(name, sign * np.inf)
    if role_of(name).colour:
        assert np.isinf(Frame(passes={name: a})[name]).any()  # a plate's burnt-out pixel is the plate's own
    else:
        assert "missing is NaN" in refusal(**{name: a})


@pytest.mark.parametrize("Z", [0.0, -0.0, -1.0, -1e-30])
def test_depth_lies_in_front(Z: float) -> None:
    words = refusal(Z=with_value("Z", Z))
    assert "missing is NaN, never 0" in words
    assert "at 1 pixels" in words


@pytest.mark.parametrize("name", ["confidence", "occlusion", "matte_actor"])
@pytest.mark.parametrize("value", [-1e-3, 1.001, 255.0])
def test_shares_lie_between_none_and_all(name: str, value: float) -> None:
    assert f"{name} must lie in 0 ... 1, got {value:.4g}" in refusal(**{name: with_value(name, value)})


@pytest.mark.parametrize("name", ["confidence", "occlusion", "matte_actor"])
def test_both_ends_are_in(name: str) -> None:
    Frame(passes={name: np.linspace(0, 1, 24, dtype=np.float32).reshape(HW)})


@pytest.mark.parametrize("vector", [(0, 0, 0), (0.5, 0.5, 1.0), (0, 0, 2), (0, 0, 1 + 2 * UNIT_TOLERANCE)])
def test_normals_are_unit(vector: tuple[float, float, float]) -> None:
    words = refusal(N=with_value("N", vector))
    assert "must be unit vectors or NaN" in words
    assert "coded 0..1?" in words


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), z=st.floats(0.05, 1))
def test_normals_through_half_float_are_still_unit(x: float, y: float, z: float) -> None:
    n = np.array([x, y, z]) / np.linalg.norm([x, y, z])
    Frame(passes={"N": np.broadcast_to(n, (*HW, 3)).astype(np.float16)})


def test_negative_and_large_colour_is_kept() -> None:
    plate = with_value("plate", (-0.01, 60000.0, 0.0))
    assert np.array_equal(Frame(passes={"plate": plate})["plate"], plate)


def test_disparity_of_both_signs() -> None:
    Frame(passes={"disparity": np.linspace(-40, 40, 24, dtype=np.float32).reshape(HW)})


@pytest.mark.parametrize("flags", [np.zeros(HW, np.float32), np.zeros(HW, np.bool_), np.zeros((*HW, 1), np.uint16), np.zeros(6, np.uint16)])
def test_flags_are_whole_numbers(flags: npt.NDArray[Any]) -> None:
    assert refusal(flags=flags).startswith("flags must be whole numbers of shape (H, W)")


@pytest.mark.parametrize("value", [-1, 65536])
def test_flags_that_would_wrap_are_refused(value: int) -> None:
    assert "0 ... 65535" in refusal(flags=with_value("flags", 0).astype(np.int64) + value)


def test_flags_of_any_integer_type() -> None:
    flags = Frame(passes={"flags": np.full(HW, Flag.OCCLUDED | Flag.FILLED, np.int64)})["flags"]
    assert flags.dtype == np.uint16
    assert (flags == 10).all()


def test_flags_are_single_bits_that_files_rely_on() -> None:
    assert {flag.name: flag.value for flag in Flag} == {
        "OUT_OF_VIEW": 1,
        "OCCLUDED": 2,
        "UNMATCHED": 4,
        "FILLED": 8,
        "TOO_FAR": 16,
        "TOO_NEAR": 32,
        "BAD_PLATE": 64,
        "REPAIRED": 128,
    }


def test_one_size_for_all() -> None:
    assert "must have shape (4, 6), got (4, 7)" in refusal(Z=plain("Z"), confidence=plain("confidence", (4, 7)))
    assert "must have shape (4, 6, 3), got (6, 4, 3)" in refusal(Z=plain("Z"), P=plain("P", (6, 4)))
    assert "shape (4, 6)" in refusal(Z=plain("Z"), flags=plain("flags", (4, 7)))


def test_the_camera_says_the_size() -> None:
    with pytest.raises(PassError, match=r"Z must have shape \(4, 6\), got \(6, 4\)"):
        Frame(passes={"Z": plain("Z", (6, 4))}, camera=CAMERA)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("confidense", "'confidence'"),
        ("Normal", "known: "),
        ("normals", ""),
        ("beuty", "'beauty'"),
        ("z", ""),
        ("", ""),
        ("dispairty", "'disparity'"),
    ],
)
def test_unknown_pass(name: str, hint: str) -> None:
    words = refusal(**{name: plain("Z")})
    assert f"pass {name!r} is unknown" in words
    assert hint in words


@pytest.mark.parametrize("name", ["light_", "light_key.diffuse", "light_key-1", "matte_ä", "matte_a b", "light_key\n"])
def test_names_that_no_file_can_hold(name: str) -> None:
    assert "is unknown" in refusal(**{name: plain("plate")})


@pytest.mark.parametrize("prefix", PREFIXED_ROLES)
@given(rest=st.from_regex(r"[A-Za-z0-9_]{1,20}", fullmatch=True))
def test_prefixed_names(prefix: str, rest: str) -> None:
    assert role_of(prefix + rest) is PREFIXED_ROLES[prefix]


def test_missing_pass_says_which_there_are() -> None:
    with pytest.raises(PassError, match="pass 'N' is missing; there are: Z, confidence"):
        Frame(passes={"Z": plain("Z"), "confidence": plain("confidence")})["N"]


def test_with_passes_adds_and_replaces_and_leaves_the_old_alone() -> None:
    frame = Frame(passes={"Z": plain("Z"), "P": plain("P")}, camera=CAMERA, eye="right", number=7, metadata={"a": "b"})
    new = frame.with_passes(Z=2 * plain("Z"), N=plain("N"))
    assert list(new) == ["Z", "P", "N"]
    assert (new["Z"] == 1.0).all()
    assert (frame["Z"] == 0.5).all()
    assert "N" not in frame
    assert (new.camera, new.eye, new.number, dict(new.metadata)) == (CAMERA, "right", 7, {"a": "b"})
    with pytest.raises(PassError):
        frame.with_passes(N=plain("N", (3, 3)))


def test_a_frame_cannot_be_changed() -> None:
    frame = Frame(passes={"Z": plain("Z")})
    with pytest.raises(TypeError):
        frame.passes["Z"] = plain("Z")  # type: ignore[index]
    with pytest.raises(TypeError):
        frame.metadata["a"] = "b"  # type: ignore[index]
    with pytest.raises(AttributeError):
        frame.eye = "right"  # type: ignore[misc]


def test_as_float32_shares_what_is_already_right() -> None:
    a = np.ones(HW, np.float32)
    assert as_float32(a, "a") is a
    assert as_float32(np.ones((*HW, 2)), "flow", channels=2, size_hw=HW).shape == (*HW, 2)
    with pytest.raises(PassError, match=r"flow must have shape \(9, 9, 2\), got \(4, 6, 2\)"):
        as_float32(np.ones((*HW, 2)), "flow", channels=2, size_hw=(9, 9))


def test_nearest_hint() -> None:
    assert nearest_hint("colour_spase", ["colour_space", "frames"]) == "; did you mean 'colour_space'?"
    assert nearest_hint("qqq", ["b", "a"]) == "; known: a, b"
    assert nearest_hint("qqq", []) == ""


def test_get_gives_a_default_where_a_pass_is_missing() -> None:
    frame = Frame(passes={"Z": np.ones((2, 3), np.float32)})
    assert frame.get("confidence") is None
    assert frame.get("Z") is frame["Z"]
