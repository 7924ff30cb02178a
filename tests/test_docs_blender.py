"""The recipe for Blender: it compiles, and what it writes is what we read.  Blender itself is not run here."""

from __future__ import annotations

import importlib.util
import math
import py_compile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.interchange.poses import read_poses
from stereorelight.interchange.rigs import read_rig
from stereorelight.light.lights import lights_from_dicts
from stereorelight.shot.relight_truth import true_light
from stereorelight.shot.schema import read_light_file, read_shot
from stereorelight.synth.lights import Light, incoming

SCRIPT = Path(__file__).parent.parent / "docs" / "blender" / "stereo_truth.py"


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    py_compile.compile(str(SCRIPT), cfile=str(tmp_path_factory.mktemp("pyc") / "x.pyc"), doraise=True)
    spec = importlib.util.spec_from_file_location("stereo_truth", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def projection(fov: float, w: int, h: int, shift: tuple[float, float] = (0.0, 0.0)) -> list[list[float]]:
    """OpenGL's, with the lens shifted by a share of the frame's width (glFrustum)."""
    near, half = 0.1, math.tan(fov / 2) * 0.1
    left, right = -half + 2 * half * shift[0], half + 2 * half * shift[0]
    low, high = (-half + 2 * half * shift[1]) * h / w, (half + 2 * half * shift[1]) * h / w
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2 * near / (right - left), (right + left) / (right - left)
    P[1, 1], P[1, 2] = 2 * near / (high - low), (high + low) / (high - low)
    P[3, 2] = -1
    return P.tolist()


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.1, -0.05)])
def test_the_lens_is_blenders(recipe: ModuleType, shift: tuple[float, float]) -> None:
    w, h = 640, 360
    P = np.array(projection(math.radians(40), w, h, shift))
    camera = Camera(size=(w, h), K=np.array(recipe.camera_matrix(P.tolist(), w, h)))
    if shift == (0.0, 0.0):
        np.testing.assert_allclose(camera.K, Camera.from_fov(40, (w, h)).K, atol=1e-9)
    for point in ((0.1, 0.2, -1.5), (-0.4, -0.1, -3.0)):
        clip = P @ (*point, 1.0)
        ndc = clip[:2] / clip[3]
        pixel = ((ndc[0] + 1) / 2 * w - 0.5, (1 - ndc[1]) / 2 * h - 0.5)
        np.testing.assert_allclose(camera.project(np.array([point[0], -point[1], -point[2]])), pixel, atol=1e-9)


def test_what_it_writes_is_what_we_read(recipe: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_text(recipe.rig_text(recipe.camera_matrix(projection(0.7, 64, 36), 64, 36), (64, 36), 0.065))
    rig = read_rig(tmp_path / "rig.json")
    assert rig.baseline_m == pytest.approx(0.065)
    # A camera at (1, -3, 2) of a z-up world that looks along +y, x to the right: y up, it stands at (1, 2, 3) and looks down -z.
    pose = [[1.0, 0, 0, 1], [0, 0, -1, -3], [0, 1, 0, 2], [0, 0, 0, 1]]
    (tmp_path / "camera.json").write_text(recipe.poses_text({3: pose}, 1.0))
    np.testing.assert_allclose(read_poses(tmp_path / "camera.json").at(3), [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-12)
    tables = [
        recipe.light_table("Lamp.001", "POINT", watts=100.0, color=(1, 0.5, 0.2), position=(1, -2, 3), direction=(0, 0, -1)),
        recipe.light_table("Sun", "SUN", watts=3.0, color=(1, 1, 1), position=(0, 0, 0), direction=(0, 0, -2)),
        recipe.light_table("1 spot", "SPOT", watts=50.0, color=(1, 1, 1), position=(0, 0, 1), direction=(0, 1, 0), cone=1.0, blend=0.2),
        recipe.light_table("Soft", "AREA", watts=50.0, color=(1, 1, 1), position=(0, 0, 1), direction=(0, 1, 0), size=(0.5, 0.3)),
    ]
    assert recipe.light_table("x", "VOLUME", watts=1.0, color=(1, 1, 1), position=(0, 0, 0), direction=(0, 0, -1)) is None
    (tmp_path / "lights.toml").write_text(recipe.lights_text(tables))
    (tmp_path / "shot.toml").write_text(recipe.shot_text())
    read_light_file(tmp_path / "lights.toml")
    lights = lights_from_dicts(tables)
    assert [light.name for light in lights] == ["Lamp_001", "Sun", "light_1_spot", "Soft"]
    assert lights[0].position_m == (1.0, 3.0, 2.0)  # type: ignore[attr-defined]
    np.testing.assert_allclose(lights[1].shines_to, (0, -1, 0), atol=1e-12)  # type: ignore[attr-defined]
    read_shot(tmp_path / "shot.toml")
    assert recipe.frame_numbers("3-5", 1) == [3, 4, 5]
    assert recipe.frame_numbers(None, 7) == [7]


def test_watts_are_what_a_white_card_reads(recipe: ModuleType) -> None:
    """A card at 1 m sends back its irradiance over pi: of a point light W / 4 pi, of the sun its strength, of a small area W / pi."""

    def card(table: dict) -> float:
        (light,) = lights_from_dicts([{**table, "space": "camera"}])
        way = np.array([0.0, 0.0, -1.0])
        made: Light = true_light(light)
        _, E = incoming(made, np.array(made.position_m)[None] + way)
        return float(E[0, 0])

    common = {"color": (1, 1, 1), "position": (0, 0, 0), "direction": (0, 1, 0)}  # Blender's +y is -z of a world with y up
    assert card(recipe.light_table("a", "POINT", watts=10.0, **common)) == pytest.approx(10 / (4 * math.pi) / math.pi)
    assert card(recipe.light_table("a", "SPOT", watts=10.0, cone=1.0, blend=0.1, **common)) == pytest.approx(10 / (4 * math.pi) / math.pi)
    assert card(recipe.light_table("a", "SUN", watts=10.0, **common)) == pytest.approx(10 / math.pi)
    assert card(recipe.light_table("a", "AREA", watts=10.0, size=(0.01, 0.01), **common)) == pytest.approx(10 / math.pi / math.pi)
