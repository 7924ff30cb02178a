"""Mattes by depth, place, normal and name: exact where geometry is exact, soft outside, 0 where nothing is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.camera import Camera
from stereorelight.errors import PassError, ShotError
from stereorelight.light.mattes import MATTES, Matte, SphereMatte, matte_arrays, matte_from_dict

H, W = 24, 32


def passes(seed: int = 0) -> dict[str, np.ndarray]:
    """A cloud that fills the box -1..1, -1..1, -3..-1, every normal there is, and a pixel of nothing."""
    rng = np.random.default_rng(seed)
    P = rng.uniform((-1, -1, -3), (1, 1, -1), (H, W, 3)).astype(np.float32)
    N = rng.standard_normal((H, W, 3))
    N = (N / np.linalg.norm(N, axis=-1, keepdims=True)).astype(np.float32)
    P[0, 0], N[0, 0] = np.nan, np.nan
    return {"P": P, "N": N, "Z": -P[..., 2]}


def one(table: dict, seed: int = 0, **more: object) -> np.ndarray:
    made = matte_from_dict({"name": "m", **table}, "matte 'm'")
    return matte_arrays([made], passes(seed), **more)["m"]  # type: ignore[arg-type]


HARD = [
    ({"type": "depth", "near_m": 1.5, "far_m": 2.0}, lambda P, N: (-P[..., 2] >= 1.5) & (-P[..., 2] <= 2.0)),
    ({"type": "depth", "far_m": 2.0}, lambda P, N: -P[..., 2] <= 2.0),
    ({"type": "sphere", "centre_m": [0.2, 0, -2], "radius_m": 0.8}, lambda P, N: np.linalg.norm(P - (0.2, 0, -2), axis=-1) <= 0.8),
    ({"type": "plane", "point_m": [0, 0.1, 0], "normal": [0, 2, 0]}, lambda P, N: P[..., 1] >= 0.1),
    ({"type": "box", "centre_m": [0, 0, -2], "size_m": [1, 0.6, 3]}, lambda P, N: (np.abs(P[..., 0]) <= 0.5) & (np.abs(P[..., 1]) <= 0.3)),
    (
        {"type": "box", "centre_m": [0, 0, -2], "size_m": [1, 9, 9], "turn_deg": [0, 0, 45]},
        lambda P, N: np.abs(P[..., 0] + P[..., 1]) <= 0.5 * np.sqrt(2),
    ),
    ({"type": "facing", "direction": [0, 3, 0], "angle_deg": 60}, lambda P, N: N[..., 1] >= 0.5),
]


@pytest.mark.parametrize(("table", "true"), HARD)
def test_hard_mattes_are_exact(table: dict, true: object) -> None:
    data = passes()
    with np.errstate(invalid="ignore"):
        wanted = true(data["P"].astype(np.float64), data["N"].astype(np.float64))  # type: ignore[operator]
    assert 0.1 < wanted.mean() < 0.95
    np.testing.assert_array_equal(one(table), wanted)
    inverted = one({**table, "invert": True})
    known = np.isfinite(data["Z"])
    np.testing.assert_array_equal(inverted[known], ~wanted[known])
    assert inverted[0, 0] == 0, "what is not known stays dark"


SOFT = [
    ({"type": "depth", "near_m": 1.5, "far_m": 2.0}, "softness_m"),
    ({"type": "sphere", "centre_m": [0, 0, -2], "radius_m": 0.5}, "softness_m"),
    ({"type": "plane", "point_m": [0, 0, 0], "normal": [1, 1, 0]}, "softness_m"),
    ({"type": "box", "centre_m": [0, 0, -2], "size_m": [0.5, 0.5, 0.5]}, "softness_m"),
    ({"type": "facing", "direction": [0, 0, 1], "angle_deg": 30}, "softness_deg"),
]


@pytest.mark.parametrize(("table", "softness"), SOFT)
def test_softness_lies_outside_and_is_a_smoothstep(table: dict, softness: str) -> None:
    width = 40.0 if softness == "softness_deg" else 0.4
    hard, soft = one(table), one({**table, softness: width})
    assert (soft[hard == 1] == 1).all()
    between = (soft > 0) & (soft < 1)
    assert between.sum() > 20
    # A smoothstep of how far outside a pixel lies.
    data = passes()
    with np.errstate(invalid="ignore"):
        t = np.clip(outside(table, data["P"].astype(np.float64), data["N"].astype(np.float64)) / width, 0, 1)
    known = np.isfinite(data["Z"])
    np.testing.assert_allclose(soft[known], (1 - t * t * (3 - 2 * t))[known], atol=1e-6)


def outside(table: dict, P: np.ndarray, N: np.ndarray) -> np.ndarray:
    """How far outside the hard matte of `table` each pixel lies; metres or degrees."""
    if table["type"] == "depth":
        return np.maximum(table["near_m"] + P[..., 2], -P[..., 2] - table["far_m"])
    if table["type"] == "sphere":
        return np.linalg.norm(P - table["centre_m"], axis=-1) - table["radius_m"]
    if table["type"] == "plane":
        return -(P[..., 0] + P[..., 1]) / np.sqrt(2)
    if table["type"] == "facing":
        return np.degrees(np.arccos(np.clip(N[..., 2], -1, 1))) - table["angle_deg"]
    return np.linalg.norm(P - np.clip(P, np.array(table["centre_m"]) - 0.25, np.array(table["centre_m"]) + 0.25), axis=-1)


def test_a_matte_in_the_world_stays_there() -> None:
    """What a camera that stands elsewhere sees of a matte in the world is what the same matte in its own space shows."""
    data = passes()
    angle = np.radians(35)
    pose = np.array([[np.cos(angle), 0, np.sin(angle), 1.0], [0, 1, 0, 0.3], [-np.sin(angle), 0, np.cos(angle), -2], [0, 0, 0, 1]])
    camera = replace(Camera.from_fov(50, (W, H)), world_from_camera=pose)
    centre = pose[:3, :3] @ (0.2, 0, -2) + pose[:3, 3]
    for table, world in (
        ({"type": "sphere", "centre_m": [0.2, 0, -2], "radius_m": 0.7, "softness_m": 0.2}, {"centre_m": list(centre)}),
        ({"type": "plane", "point_m": [0.2, 0, -2], "normal": [1, 0, 0.5]}, {"point_m": list(centre), "normal": list(pose[:3, :3] @ (1, 0, 0.5))}),
        ({"type": "facing", "direction": [1, 0, 0], "softness_deg": 20}, {"direction": list(pose[:3, :3] @ (1, 0, 0))}),
        ({"type": "box", "centre_m": [0.2, 0, -2], "size_m": [1, 1, 1]}, {"centre_m": list(centre), "turn_deg": [0, 35, 0]}),
    ):
        here = matte_arrays([matte_from_dict({"name": "m", **table}, "m")], data)["m"]
        there = matte_arrays([matte_from_dict({"name": "m", **table, **world, "space": "world"}, "m")], data, camera=camera)["m"]
        np.testing.assert_allclose(there, here, atol=1e-6)
        without = matte_arrays([matte_from_dict({"name": "m", **table, **world, "space": "world"}, "m")], data)["m"]
        assert np.abs(without - here).max() > 0.5, "or it would prove nothing"


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), names=st.lists(st.sampled_from("abc"), min_size=1, max_size=3))
def test_combining_is_the_algebra_of_shares(seed: int, names: list[str]) -> None:
    rng = np.random.default_rng(seed)
    given_ = {n: rng.uniform(0, 1, (H, W)).astype(np.float32) for n in "abc"}
    given_["a"][1, 1] = np.nan
    tables: list[Matte] = [
        matte_from_dict({"name": "all", "type": "multiply", "of": names}, "m"),
        matte_from_dict({"name": "any", "type": "screen", "of": names}, "m"),
        matte_from_dict({"name": "not_any", "type": "screen", "of": names, "invert": True}, "m"),
    ]
    made = matte_arrays(tables, {}, given=given_)
    parts = [made[n].astype(np.float64) for n in names]
    known = np.isfinite([given_[n] for n in names]).all(axis=0)
    np.testing.assert_allclose(made["all"][known], np.prod(parts, axis=0)[known], atol=1e-6)
    np.testing.assert_allclose(made["any"][known], (1 - np.prod([1 - p for p in parts], axis=0))[known], atol=1e-6)
    np.testing.assert_allclose((made["any"] + made["not_any"])[known], 1, atol=1e-6)
    assert all((m >= 0).all() and (m <= 1).all() for m in made.values())
    assert (made["not_any"][~known] == 0).all()


def test_a_file_is_read_by_whoever_knows_files() -> None:
    picture = np.full((H, W), 0.25, np.float32)
    assert (one({"file": "a.####.png", "channel": "A"}, read=lambda matte: picture if matte.channel == "A" else 0 * picture) == 0.25).all()
    with pytest.raises(ShotError, match="nobody reads files here"):
        one({"file": "a.png"})
    with pytest.raises(PassError, match=r"matte 'm' must lie in 0 ... 1, got 1.5"):
        one({"file": "a.png"}, read=lambda matte: picture * 6)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "type is missing"),
        ({"type": "spher"}, "did you mean 'sphere'"),
        ({"type": "sphere", "radius_m": 1}, "centre_m is missing"),
        ({"type": "sphere", "centre_m": [0, 0, 0], "radius_m": -1}, "radius_m must be a number"),
        ({"type": "sphere", "centre_m": [0, 0], "radius_m": 1}, "centre_m must be three numbers"),
        ({"type": "depth"}, "near_m or far_m must be given"),
        ({"type": "depth", "near_m": 3, "far_m": 2}, "near_m must not be beyond far_m"),
        ({"type": "depth", "near": 3}, "did you mean 'near_m'"),
        ({"type": "plane", "point_m": [0, 0, 0], "normal": [0, 0, 0]}, "normal must not be zero"),
        ({"type": "facing", "direction": [0, 1, 0], "angle_deg": 200}, "angle_deg must be a number"),
        ({"type": "sphere", "centre_m": [0, 0, 0], "radius_m": 1, "space": "wrld"}, "did you mean 'world'"),
        ({"type": "multiply", "of": []}, "of must be names"),
        ({"type": "multiply", "of": ["x"]}, "of 'x' is unknown"),
        ({"type": "file"}, "file is missing"),
        ({"type": "depth", "far_m": 1, "invert": 1}, "invert must be true or false"),
    ],
)
def test_mattes_that_cannot_be_are_told(table: dict, words: str) -> None:
    with pytest.raises(ShotError, match=words):
        one(table)


def test_a_missing_pass_and_another_size_are_told() -> None:
    sphere = SphereMatte(name="m", centre_m=(0, 0, 0), radius_m=1)
    with pytest.raises(PassError, match=r"matte 'm': needs the pass P, which is not there; there are: Z"):
        matte_arrays([sphere], {"Z": passes()["Z"]})
    with pytest.raises(PassError, match=r"P must have shape \(3, 3, 3\)"):
        matte_arrays([sphere], passes(), given={"g": np.ones((3, 3), np.float32)})
    with pytest.raises(ShotError, match="name is taken"):
        matte_arrays([sphere, sphere], passes())
    assert set(MATTES) == {"file", "depth", "sphere", "box", "plane", "facing", "multiply", "screen"}
