"""Keys over a shot: they are met exactly, held at the ends, never overshot; every value of a light takes them."""

from __future__ import annotations

import tomllib
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereorelight.errors import ShotError
from stereorelight.light.animate import EASES, Curve, LightTrack, light_tracks
from stereorelight.light.lights import LIGHTS, PointLight, SpotLight, lights_from_dicts


def track(text: str) -> LightTrack:
    return light_tracks(tomllib.loads(text)["lights"])[0]


LAMP = '[[lights]]\nname = "lamp"\ntype = "point"\nposition_m = [0, 1, -1]\n'


def test_keys_are_met_and_the_ends_hold() -> None:
    for ease in EASES:
        lamp = track(LAMP + f'intensity = {{ keys = [[1001, 1.0], [1011, 3.0], [1031, 2.0]], ease = "{ease}" }}')
        got = {n: lamp.at(n).intensity for n in (None, 900, 1001, 1011, 1031, 2000)}
        assert got == {None: 1.0, 900: 1.0, 1001: 1.0, 1011: 3.0, 1031: 2.0, 2000: 2.0}
    linear = track(LAMP + "intensity = { keys = [[1001, 1.0], [1011, 3.0]] }")
    assert linear.at(1006).intensity == pytest.approx(2.0)
    step = track(LAMP + 'intensity = { keys = [[1001, 1.0], [1011, 3.0]], ease = "step" }')
    assert (step.at(1010).intensity, step.at(1011).intensity) == (1.0, 3.0)
    smooth = track(LAMP + 'intensity = { keys = [[0, 0.0], [10, 1.0]], ease = "smooth" }')
    assert [smooth.at(n).intensity for n in (1, 5, 9)] == pytest.approx([0.028, 0.5, 0.972])  # 3 t^2 - 2 t^3


@settings(max_examples=50, deadline=None)
@given(
    steps=st.lists(st.tuples(st.floats(0.5, 30), st.floats(-5, 5)), min_size=2, max_size=7),
    ease=st.sampled_from(EASES),
)
def test_a_curve_stays_between_its_keys_and_does_not_jump(steps: list[tuple[float, float]], ease: str) -> None:
    frames = tuple(np.cumsum([s for s, _ in steps]))
    values = tuple(v for _, v in steps)
    curve = Curve(frames=frames, values=values, ease=ease)
    for k in range(len(frames) - 1):
        t = np.linspace(frames[k], frames[k + 1], 41)
        got = np.array([curve.at(x) for x in t])
        low, high = sorted(values[k : k + 2])
        assert got.min() >= low - 1e-12
        assert got.max() <= high + 1e-12
        if ease != "step":
            assert (np.diff(got) * np.sign(values[k + 1] - values[k]) >= -1e-9).all(), "up and down between two keys"
            assert np.abs(np.diff(got)).max() <= 0.1 * (high - low) + 1e-9
    reverse = Curve(frames=tuple(-f for f in frames[::-1]), values=values[::-1], ease=ease)
    if ease != "step":
        middle = (frames[0] + frames[-1]) / 2
        assert curve.at(middle) == pytest.approx(reverse.at(-middle), abs=1e-9)


def test_smooth_runs_through_a_key_on_the_way() -> None:
    """At rest at the ends alone: three keys on a line are passed without a stop."""
    curve = Curve(frames=(0, 10, 20), values=(0.0, 1.0, 2.0), ease="smooth")
    assert curve.at(10.5) - curve.at(9.5) == pytest.approx(0.1, rel=0.1)
    assert curve.at(0.5) < 0.01


def test_vectors_and_colours() -> None:
    lamp = track(LAMP.replace("[0, 1, -1]", "{ keys = [[1, [0, 1, -1]], [3, [2, 1, -2]]] }") + "color = { keys = [[1, [1, 1, 1]], [3, [1, 0, 0]]] }")
    assert lamp.at(2) == PointLight(name="lamp", position_m=(1, 1, -1.5), color=(1, 0.5, 0.5))


def examples() -> list[tuple[str, str, dict[str, object]]]:
    """(type, key, a table that says it) for every key of every light, from the classes themselves."""
    base: dict[str, dict[str, object]] = {
        "point": {"position_m": [0.0, 1.0, -1.0]},
        "spot": {"position_m": [0.0, 1.0, -1.0], "aim_m": [0.0, 0.0, -2.0]},
        "directional": {"azimuth_deg": 30.0},
        "sphere": {"position_m": [0.0, 1.0, -1.0], "radius_m": 0.1},
        "rect": {"position_m": [0.0, 1.0, -1.0], "size_m": [0.2, 0.3], "aim_m": [0.0, 0.0, -2.0]},
    }
    assert set(base) == set(LIGHTS)
    found = []
    for kind, table in base.items():
        light = lights_from_dicts([{"name": "x", "type": kind, **table}])[0]
        for f in fields(light):
            value = getattr(light, f.name)
            if f.name != "name" and value is not None:
                found.append((kind, f.name, {"type": kind, "name": "x", **table, f.name: list(value) if isinstance(value, tuple) else value}))
    return found


@pytest.mark.parametrize(("kind", "key", "table"), examples())
def test_every_value_takes_keys(kind: str, key: str, table: dict[str, object]) -> None:
    keyed = table | {key: {"keys": [[1, table[key]], [9, table[key]]], "ease": "step"}}
    light = light_tracks([keyed])[0].at(5)
    assert light == lights_from_dicts([table])[0]
    assert type(light) is LIGHTS[kind]


def test_a_light_that_is_switched_keeps_its_layers() -> None:
    lamp = track(LAMP + 'specular = { keys = [[1, 0.0], [9, 0.5]] }\nenabled = { keys = [[1, false], [5, true]], ease = "step" }')
    assert lamp.enabled
    assert lamp.dark(1)
    assert not lamp.dark(5)
    assert lamp.at(1).enabled
    assert not track(LAMP + 'enabled = { keys = [[1, false]], ease = "step" }').at(1).enabled


def test_a_stuck_place_is_asked_for() -> None:
    lamp = track(LAMP.replace("[0, 1, -1]", "{ pixel = [10, 20.5], frame = 7, offset_m = [0, 0.1, 0] }"))
    light = lamp.at(8, lambda stuck, space: (stuck.pixel[0], stuck.pixel[1] + stuck.offset_m[1], float(stuck.frame or 0)))
    assert isinstance(light, PointLight)
    assert light.position_m == (10, 20.6, 7)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("intensity = { keys = [] }", "light 'lamp': intensity: keys must be pairs"),
        ("intensity = { keys = [[1, 2, 3]] }", "keys must be pairs of frame and value"),
        ("intensity = { keys = [[5, 1.0], [5, 2.0]] }", "key frames must rise, got 5 before 5"),
        ('intensity = { keys = [["a", 1.0]] }', "a key begins with its frame"),
        ("intensity = { keys = [[1, true], [2, 2.0]] }", "True is no number that could change gradually"),
        ('attenuation = { keys = [[1, "none"], [2, "linear"]] }', 'take ease = "step"'),
        ("intensity = { keys = [[1, 1.0]], eas = 1 }", "'eas' is unknown beside keys; did you mean 'ease'"),
        ('intensity = { keys = [[1, 1.0]], ease = "smoth" }', "did you mean 'smooth'"),
        ("intensity = { keys = [[1, 1.0], [2, [1, 2, 3]]] }", "values of one kind"),
        ("intensity = { keys = [[1, 1.0], [20, -2.0]] }", r"intensity must be .* at least 0.* \(on frame 20\)"),
        ("intensity = { key = [[1, 1.0]] }", "did you mean 'keys'"),
        ("wrap = { keys = [[1, 0.0], [9, 1.5]] }", r"wrap must be .* \(on frame 9\)"),
        ("color = { keys = [[1, [1, 1]], [2, [1, 1]]] }", "color must be three numbers"),
        ("radius = { keys = [[1, 1.0]] }", "key 'radius' is unknown"),
        ("color = { pixel = [1, 2] }", "color is no place"),
    ],
)
def test_keys_that_cannot_be_are_told(line: str, words: str) -> None:
    with pytest.raises(ShotError, match=words):
        track(LAMP + line)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("{ pixel = [1] }", "position_m: pixel must be 2 numbers"),
        ("{ pixel = [1, 2], frame = 1.5 }", "frame must be the whole number"),
        ("{ pixel = [1, 2], offset = [0, 0, 0] }", "did you mean 'offset_m'"),
        ("{ pixel = [1, 2], offset_m = [0, 0] }", "offset_m must be 3 numbers"),
    ],
)
def test_stuck_places_that_cannot_be_are_told(place: str, words: str) -> None:
    with pytest.raises(ShotError, match=words):
        track(LAMP.replace("[0, 1, -1]", place))


def test_what_a_light_is_cannot_change() -> None:
    with pytest.raises(ShotError, match="name cannot change over the shot"):
        light_tracks([{"name": {"keys": [[1, "a"]]}, "type": "point", "position_m": [0, 0, 0]}])
    with pytest.raises(ShotError, match="must be a table of keys"):
        light_tracks([3])  # type: ignore[list-item]
    with pytest.raises(ShotError, match="name is taken"):
        light_tracks([{"name": "a", "type": "point", "position_m": [0, 0, 0]}] * 2)


def test_a_curve_that_passes_through_what_cannot_be_is_told_with_its_frame() -> None:
    spot = SpotLight(name="s", position_m=(0, 0, 0), direction=(0, 0, -1))
    assert spot.cone_deg == 40
    turning = light_tracks([{"name": "s", "type": "spot", "position_m": [0, 0, 0], "direction": {"keys": [[1, [0, 0, -1]], [3, [0, 0, 1]]]}}])[0]
    with pytest.raises(ShotError, match=r"direction must not be zero.*\(on frame 2\)"):
        turning.at(2)
