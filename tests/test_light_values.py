"""Lights as values: what can be made, what is refused and how, and the way to and from tables and worlds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stereorelight.errors import ShotError
from stereorelight.light.lights import DirectionalLight, PointLight, SpotLight, in_camera, lights_from_dicts, to_dict

EPSILON = 1e-12
LIGHTS = (
    PointLight(name="key", position_m=(1, 2, -3), intensity=4, exposure=-1, color=(1, 0.5, 0.2), attenuation="radius", radius_m=5),
    SpotLight(name="spot_1", position_m=(1, 2, -3), aim_m=(0, 0, -3), cone_deg=30, penumbra_deg=4, specular=0.5, normalised=True, matte="skin"),
    SpotLight(name="spot_2", position_m=(1, 2, -3), direction=(0, -1, 0), space="world", enabled=False),
    DirectionalLight(name="sun", azimuth_deg=30, elevation_deg=40, wrap=0.5),
    DirectionalLight(name="moon", aim=(0, -1, -1), space="world"),
)


def test_tables_come_back_as_they_went() -> None:
    assert lights_from_dicts([to_dict(light) for light in LIGHTS]) == LIGHTS
    assert to_dict(PointLight(name="a", position_m=(0, 0, 0))) == {"type": "point", "name": "a", "position_m": [0.0, 0.0, 0.0]}


def test_lights_are_values() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        LIGHTS[0].intensity = 2  # type: ignore[misc]
    assert PointLight(name="a", position_m=[0, 0, 0]) == PointLight(name="a", position_m=(0.0, 0.0, 0.0))  # type: ignore[arg-type]


def test_angles_follow_equations_7_to_9() -> None:
    def towards(**angles: float) -> list[float]:
        return [round(float(v), 12) + 0.0 for v in -DirectionalLight(name="a", **angles).shines_to]

    assert towards() == [0, 0, 1]  # at the camera, which looks down -z
    assert towards(azimuth_deg=90) == [1, 0, 0]
    assert towards(azimuth_deg=-90) == [-1, 0, 0]
    assert towards(elevation_deg=90) == [0, 1, 0]
    assert towards(azimuth_deg=180) == [0, 0, -1]


POINT = {"type": "point", "name": "key", "position_m": [0, 0, 0]}
SPOT = {"type": "spot", "name": "key", "position_m": [0, 0, 0], "aim_m": [0, 0, -1]}
SUN = {"type": "directional", "name": "key"}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({**POINT, "intensty": 2}, ["'key'", "'intensty'", "did you mean 'intensity'"]),
        ({**POINT, "intensity": -1}, ["'key'", "intensity", "at least 0", "-1", "gain"]),
        ({**POINT, "intensity": "2"}, ["intensity", "number", "'2'"]),
        ({**POINT, "intensity": True}, ["intensity", "number", "True"]),
        ({**POINT, "intensity": float("nan")}, ["intensity", "nan"]),
        ({**POINT, "exposure": 60}, ["intensity", "exposure"]),
        ({**POINT, "color": [1, 1]}, ["color", "three numbers"]),
        ({**POINT, "color": "red"}, ["color", "three numbers", "'red'"]),
        ({**POINT, "color": [1, -1, 1]}, ["color", "-1"]),
        ({**POINT, "enabled": 1}, ["enabled", "true or false"]),
        ({**POINT, "matte": ""}, ["matte"]),
        ({**POINT, "wrap": 1.5}, ["wrap", "1.5"]),
        ({**POINT, "exponent": 0}, ["exponent", "0"]),
        ({**POINT, "space": "wrld"}, ["space", "'wrld'", "did you mean 'world'"]),
        ({**POINT, "attenuation": "inverse-square"}, ["attenuation", "did you mean 'inverse_square'"]),
        ({**POINT, "attenuation": "radius"}, ["radius_m", "None"]),
        ({**POINT, "radius_m": 3}, ["radius_m", "attenuation"]),
        ({**POINT, "position_m": [0, float("inf"), 0]}, ["position_m", "inf"]),
        ({**POINT, "position_m": [0, 1e9, 0]}, ["position_m", "directional"]),
        ({**POINT, "cone_deg": 20}, ["cone_deg belongs to spot lights"]),
        ({**POINT, "name": "key light"}, ["'key light'", "letters"]),
        ({**POINT, "type": "pont"}, ["type 'pont'", "did you mean 'point'"]),
        ({"name": "key"}, ["'key'", "type is missing"]),
        ({"type": "point", "name": "key"}, ["'key'", "position_m is missing", "[x, y, z]"]),
        ({"type": "point", "position_m": [0, 0, 0]}, ["number 1", "name is missing"]),
        ({**SPOT, "cone_deg": 0}, ["cone_deg", "0"]),
        ({**SPOT, "cone_deg": -20}, ["cone_deg", "-20"]),
        ({**SPOT, "cone_deg": 200}, ["cone_deg", "200"]),
        ({**SPOT, "penumbra_deg": -1}, ["penumbra_deg", "-1"]),
        ({**SPOT, "direction": [0, 0, -1]}, ["aim_m or direction", "both"]),
        ({**SPOT, "aim_m": [0, 0, 0]}, ["aim_m", "where the light is"]),
        ({k: v for k, v in SPOT.items() if k != "aim_m"}, ["aim_m or direction", "neither"]),
        ({**SUN, "attenuation": "none"}, ["attenuation belongs to point and spot lights"]),
        ({**SUN, "aim": [0, 0, 0]}, ["aim", "zero"]),
        ({**SUN, "aim": [0, 0, -1], "azimuth_deg": 3}, ["aim", "azimuth_deg", "both"]),
        ({**SUN, "direction": [0, 0, -1]}, ["direction", "called aim"]),
        ({**SPOT, "aim": [0, 0, -1]}, ["aim", "called direction"]),
        ({**SUN, "elevation_deg": 91}, ["elevation_deg", "91"]),
    ],
)
def test_nonsense_is_refused_in_one_line(table: dict[str, object], words: list[str]) -> None:
    with pytest.raises(ShotError) as caught:
        lights_from_dicts([table])
    for word in words:
        assert word in str(caught.value), str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_lights_of_one_name_are_refused() -> None:
    with pytest.raises(ShotError, match=r"'key'.*taken"):
        lights_from_dicts([POINT, SUN])


def test_a_world_light_is_carried_into_the_camera() -> None:
    c, s = np.cos(0.3), np.sin(0.3)
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = (1, 2, 3)
    world = SpotLight(name="a", position_m=(4, 5, 6), aim_m=(4, 4, 6), space="world", cone_deg=12)
    light = in_camera(world, pose)
    assert isinstance(light, SpotLight)
    assert light.space == "camera"
    assert light.cone_deg == 12
    np.testing.assert_allclose(pose[:3, :3] @ light.position_m + pose[:3, 3], world.position_m, atol=EPSILON)
    np.testing.assert_allclose(pose[:3, :3] @ light.shines_to, (0, -1, 0), atol=EPSILON)
    sun = in_camera(DirectionalLight(name="b", azimuth_deg=20, space="world"), pose)
    np.testing.assert_allclose(pose[:3, :3] @ sun.shines_to, DirectionalLight(name="b", azimuth_deg=20).shines_to, atol=EPSILON)
    fixed = PointLight(name="c", position_m=(1, 1, 1))
    assert in_camera(fixed, pose) is fixed
    with pytest.raises(ShotError, match="rotation"):
        in_camera(world, 2 * pose)
