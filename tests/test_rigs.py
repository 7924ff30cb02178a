"""rig.json: the same rig back bit for bit, and whatever is no rig refused with file, key and remedy."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera, Rig
from stereorelight.errors import OutputError, RigError
from stereorelight.interchange.rigs import camera_to_dict, read_rig, rig_from_dict, rig_to_dict, write_rig

ONE_FILE = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
WEAK = {
    "brown": ((0,) * 0, (0.05, 0.02, 0.002, 0.002), (0.05, 0.02, 0.002, 0.002, 0.01)),
    "rational": ((), (0.03, 0.02, 0.002, 0.002, 0.01, 0.03, 0.02, 0.01)),
    "fisheye": ((), (0.03, 0.02, 0.01, 0.01)),
}


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    w, h = draw(st.integers(1, 5000)), draw(st.integers(1, 5000))
    fx = max(w, h) * draw(st.floats(0.8, 8))
    K = [[fx, 0, w * draw(st.floats(0.4, 0.6))], [0, fx * draw(st.floats(0.9, 1.1)), h * draw(st.floats(0.4, 0.6))], [0, 0, 1]]
    model = draw(st.sampled_from(sorted(WEAK)))
    bounds = draw(st.sampled_from(WEAK[model]))
    return Camera(size=(w, h), K=K, model=model, distortion=tuple(draw(st.floats(-b, b)) for b in bounds))  # type: ignore[arg-type]


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    axis = np.array([draw(st.floats(-1, 1)) for _ in range(3)])
    angle = np.linalg.norm(axis) * 0.5
    x, y, z = axis / max(np.linalg.norm(axis), 1e-300)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    R = np.round(R, draw(st.sampled_from([5, 8, 17])))  # as calibrations print them
    b = draw(st.floats(1e-3, 10))
    centre = np.array([b, b * draw(st.floats(-0.5, 0.5)), b * draw(st.floats(-0.5, 0.5))])
    words = st.dictionaries(
        st.text(max_size=8),
        st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8) | st.integers() | st.booleans() | st.none(),
        max_size=3,
    )
    return Rig(
        left=draw(cameras()),
        right=draw(cameras()),
        R_right_left=R,
        t_right_left_m=-R @ centre,
        mirrored=draw(st.sampled_from([None, "left", "right"])),
        quality=draw(words),
    )


def assert_same(a: Rig, b: Rig) -> None:
    assert a.R_right_left.tobytes() == b.R_right_left.tobytes()
    assert a.t_right_left_m.tobytes() == b.t_right_left_m.tobytes()
    assert (a.mirrored, a.quality) == (b.mirrored, b.quality)
    for one, other in ((a.left, b.left), (a.right, b.right)):
        assert (one.size, one.model, one.distortion) == (other.size, other.model, other.distortion)
        assert one.K.tobytes() == other.K.tobytes()


@ONE_FILE
@given(rig=rigs())
def test_round_trip_bit_for_bit(tmp_path: Path, rig: Rig) -> None:
    path = write_rig(tmp_path / "rig.json", rig, force=True)
    once = read_rig(path)
    assert_same(rig, once)
    text = path.read_bytes()
    write_rig(path, once, force=True)
    assert path.read_bytes() == text


def table() -> dict[str, Any]:
    eye = {"size": [160, 120], "K": [[300.0, 0, 79.5], [0, 300.0, 59.5], [0, 0, 1]], "model": "brown", "distortion": [-0.1, 0.01, 0, 0]}
    return {
        "version": 1,
        "left": eye,
        "right": dict(eye),
        "R_right_left": np.eye(3).tolist(),
        "t_right_left_m": [-0.065, 0, 0],
        "mirrored": None,
        "quality": {"rms_px": 0.2},
    }


def saved(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(RigError) as caught:
        read_rig(path)
    words = str(caught.value)
    assert words.startswith(f"{path}: ")
    assert "\n" not in words
    return words


def test_the_format_as_documented(tmp_path: Path) -> None:
    rig = read_rig(saved(tmp_path / "rig.json", table()))
    assert rig_to_dict(rig) == table()
    assert rig.left.size == (160, 120)
    assert rig.right_centre_m == pytest.approx((0.065, 0, 0))
    assert camera_to_dict(rig.left) == table()["left"]


def test_only_the_geometry_is_needed() -> None:
    t = table()
    for key in ("version", "mirrored", "quality"):
        del t[key]
    for key in ("model", "distortion"):
        del t["left"][key]
    rig = rig_from_dict(t)
    assert not rig.left.distorts
    assert (rig.mirrored, rig.quality) == (None, {})


def put(t: dict[str, Any], keys: str, value: Any) -> dict[str, Any]:
    *way, last = keys.split(".")
    inner = t
    for key in way:
        inner = inner[key]
    inner[last] = value
    return t


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        ("mirored", "left", "rig: unknown key 'mirored'; did you mean 'mirrored'?"),
        ("t_right_left", [1, 0, 0], "did you mean 't_right_left_m'?"),
        ("left.distorsion", [], "left: unknown key 'distorsion'; did you mean 'distortion'?"),
        ("right.k", [], "right: unknown key 'k'"),
        ("version", 2, "version must be 1, got 2; was it written by a newer stereorelight?"),
        ("version", "1", "version must be 1, got '1'"),
        ("version", None, "version must be 1"),
        ("quality", [1], "quality must be a table of keys, got list"),
        ("left", [1, 2], "left must be a table of keys, got list"),
        ("right", None, "right must be a table of keys, got NoneType"),
        ("left.K.0", [-300.0, 0, 79.5], "left: focal lengths must be > 0"),
        ("right.size", [160], "right: size must be [width, height]"),
        ("right.size", [1e999, 120], "right: size must be [width, height]"),
        ("right.size", [0, 120], "right: size must be two whole numbers"),
        ("left.model", "fish", "left: lens model 'fish' is unknown; did you mean 'fisheye'?"),
        ("left.model", ["brown"], "left: lens model ['brown'] is unknown"),
        ("left.distortion", [0.1, 0.2], "left: lens model 'brown' takes 0 or 4 or 5 parameters, got 2"),
        ("left.distortion", None, "left: distortion must be numbers"),
        ("left.distortion", [10**400, 0, 0, 0], "left: distortion must be numbers"),
        ("left.distortion", [-5.0, 0, 0, 0], "left: lens distortion [-5.0, 0.0, 0.0, 0.0] folds over inside the frame"),
        ("left.K", [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]], "left: K must be (3, 3) numbers"),
        ("R_right_left", [[1, 0, 0], [0, 1, 0], [0, 0, 2]], "R_right_left is not a rotation"),
        ("R_right_left", "R", "R_right_left must be (3, 3) numbers"),
        ("t_right_left_m", [0.065, 0, 0], "are left and right swapped?"),
        ("t_right_left_m", [math.nan, 0, 0], "not finite"),
        ("mirrored", "both", "mirrored must be null, 'left' or 'right'"),
    ],
)
def test_refused_by_key(tmp_path: Path, keys: str, value: Any, words: str) -> None:
    t = table()
    if keys == "left.K.0":
        t["left"]["K"][0] = value
    else:
        put(t, keys, value)
    assert words in refusal(saved(tmp_path / "rig.json", t))


@pytest.mark.parametrize("key", ["left", "right", "R_right_left", "t_right_left_m", "left.size", "left.K", "right.K"])
def test_missing_key(tmp_path: Path, key: str) -> None:
    t = table()
    *way, last = key.split(".")
    del (t[way[0]] if way else t)[last]
    assert f"{way[0] if way else 'rig'}: key {last!r} is missing" in refusal(saved(tmp_path / "rig.json", t))


@pytest.mark.parametrize("content", [[], 3, None, "rig", True])
def test_json_that_is_no_table(tmp_path: Path, content: Any) -> None:
    assert "rig must be a table of keys" in refusal(saved(tmp_path / "rig.json", content))


def test_missing_file(tmp_path: Path) -> None:
    words = refusal(tmp_path / "rig.json")
    assert "missing" in words
    assert "--rig" in words


def test_folder(tmp_path: Path) -> None:
    assert "cannot be read: is a directory" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not valid JSON at line 1, column 1"),
        (b'{"version": 1,\n "left": }', "not valid JSON at line 2, column 10"),
        (b"\xff\xfe\x00\x01", "not a text file; a rig file is JSON"),
        (b"\x89PNG\r\n\x1a\n", "not a text file"),
        (b"\x76\x2f\x31\x01\x02\x00\x00\x00", "not valid JSON"),
        (b"[" * 100_000, "beyond reading"),
        (b"1" * 5000, "beyond reading"),
    ],
)
def test_broken_files(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    assert words in refusal(path)


@ONE_FILE
@given(data=st.data())
def test_a_truncated_file_is_refused(tmp_path: Path, data: st.DataObject) -> None:
    whole = json.dumps(table()).encode()
    path = tmp_path / "rig.json"
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    refusal(path)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda x: st.lists(x, max_size=4) | st.dictionaries(st.text(max_size=5), x, max_size=3),
    max_leaves=8,
)
PLACES = ["version", "left", "right", "R_right_left", "t_right_left_m", "mirrored", "left.size", "left.K", "right.model", "right.distortion"]


@settings(ONE_FILE, max_examples=200)
@given(keys=st.sampled_from(PLACES), value=JSON)
def test_any_value_anywhere_is_a_rig_or_one_clear_error(tmp_path: Path, keys: str, value: Any) -> None:
    path = saved(tmp_path / "rig.json", put(table(), keys, value))
    with contextlib.suppress(RigError):  # anything else fails the test
        read_rig(path)


def test_written_whole_and_not_over_another(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    write_rig(path, rig_from_dict(table()))
    with pytest.raises(OutputError, match="--force"):
        write_rig(path, rig_from_dict(table()))
    assert [p.name for p in tmp_path.iterdir()] == ["rig.json"]
    assert path.read_text().endswith("}\n")
