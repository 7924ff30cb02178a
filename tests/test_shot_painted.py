"""Painted light of a shot file: lit spheres, toon ramps and ink, from file to picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.errors import PassError, PlateError, ShotError
from stereorelight.footage.exr import write_exr
from stereorelight.light.matcap import lit_sphere, outline, toon
from stereorelight.light.painted import painted_from_dict
from stereorelight.passes import Frame
from stereorelight.shot.lighting import Lighting, lighting_of
from stereorelight.shot.schema import read_light_file

SIZE = (64, 48)
CAMERA = Camera.from_fov(50, SIZE)
PLATE = np.random.default_rng(0).uniform(0.1, 0.9, (*SIZE[::-1], 3)).astype(np.float32)
LAMP = '[[lights]]\nname = "lamp"\ntype = "point"\nposition_m = [0.5, 0.4, -0.8]\nspecular = 0.2\n'


def ball() -> dict[str, np.ndarray]:
    """A ball of 0.4 m at 1.5 m that fills the middle; nothing is known round it."""
    rays = CAMERA.rays(CAMERA.pixel_grid().reshape(-1, 2)) * (1, -1, -1)
    b, a = rays @ np.array([0, 0, -1.5]), (rays**2).sum(axis=-1)
    inside = b * b - a * (1.5**2 - 0.4**2)
    t = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, np.nan)
    P = (t[:, None] * rays).reshape(*SIZE[::-1], 3)
    return {"P": P.astype(np.float32), "N": ((P - (0, 0, -1.5)) / 0.4).astype(np.float32), "Z": (-P[..., 2]).astype(np.float32)}


PASSES = ball()
KNOWN = np.isfinite(PASSES["Z"])


def lighting(folder: Path, text: str) -> Lighting:
    (folder / "lights.toml").write_text(text)
    return lighting_of(read_light_file(folder / "lights.toml"), numbers=[], plate=lambda n: PLATE)


def sphere(folder: Path, name: str = "clay.exr") -> np.ndarray:
    """A sphere that is red to the right and green to the top."""
    y, x = np.mgrid[0:32, 0:32].astype(np.float32)
    painted = np.dstack([x / 31, 1 - y / 31, np.full_like(x, 0.2)])
    write_exr(folder / name, {c: np.ascontiguousarray(painted[..., k]) for k, c in enumerate("RGB")})
    return painted


def test_a_lit_sphere_is_a_layer_that_adds_to_the_beauty(tmp_path: Path) -> None:
    painted = sphere(tmp_path)
    text = LAMP + '[relight]\nplate_gain = 0.25\n[[painted]]\nname = "clay"\ntype = "lit_sphere"\nfile = "clay.exr"\nfacing = "ray"\n'
    lit = lighting(tmp_path, text).lit(1, plate=PLATE, passes=PASSES, camera=CAMERA)
    assert list(lit.layers) == ["light_lamp_diffuse", "light_lamp_specular", "paint_clay"]
    np.testing.assert_allclose(lit.layers["paint_clay"], lit_sphere(PASSES["N"], painted, P=PASSES["P"], facing="ray"), atol=1e-6)
    assert (lit.layers["paint_clay"][~KNOWN] == 0).all()
    np.testing.assert_allclose(lit.beauty, 0.25 * PLATE + sum(lit.layers.values()), rtol=1e-5)
    Frame(passes=lit.passes(), camera=CAMERA)


def test_values_of_paint_go_by_keys_and_by_matte(tmp_path: Path) -> None:
    sphere(tmp_path)
    text = (
        '[[mattes]]\nname = "left"\ntype = "plane"\npoint_m = [0, 0, 0]\nnormal = [-1, 0, 0]\n'
        '[[painted]]\nname = "clay"\nfile = "clay.exr"\nmatte = "left"\non_plate = true\nexposure = { keys = [[1, 0.0], [3, 2.0]] }\n'
    )
    made = lighting(tmp_path, text)
    first, last = (made.lit(n, plate=PLATE, passes=PASSES, camera=CAMERA).layers["paint_clay"] for n in (1, 3))
    assert first[:, : SIZE[0] // 2][KNOWN[:, : SIZE[0] // 2]].max() > 0
    assert (first[:, SIZE[0] // 2 :] == 0).all()
    np.testing.assert_allclose(last, 4 * first, rtol=1e-6)
    assert (first <= PLATE + 1e-6).all()


def test_a_toon_ramp_stands_for_its_lights(tmp_path: Path) -> None:
    text = LAMP + LAMP.replace("lamp", "other").replace("0.5,", "-0.5,") + '[relight]\nplate_gain = 0.0\n[[painted]]\nname = "toon"\ntype = "toon"\n'
    plain = lighting(tmp_path, text.partition("[relight]")[0]).lit(1, plate=np.ones_like(PLATE), passes=PASSES, camera=CAMERA)
    shading = plain.layers["light_lamp_diffuse"] + plain.layers["light_other_diffuse"]
    lit = lighting(tmp_path, text).lit(1, plate=PLATE, passes=PASSES, camera=CAMERA)
    assert list(lit.layers) == ["paint_toon"]
    np.testing.assert_allclose(lit.beauty, np.where(KNOWN[..., None], toon(shading, albedo=PLATE), 0), atol=1e-5)
    assert (lit.beauty[~KNOWN] == 0).all()
    one = lighting(tmp_path, text + 'of = ["lamp"]\nreplaces = false\ntones = [0, [1, 0, 0], 1, 1]\n')
    found = one.lit(1, plate=PLATE, passes=PASSES, camera=CAMERA).layers
    assert list(found) == ["light_lamp_diffuse", "light_lamp_specular", "light_other_diffuse", "light_other_specular", "paint_toon"]
    again = toon(plain.layers["light_lamp_diffuse"], colours=(0, (1, 0, 0), 1, 1), albedo=PLATE)
    np.testing.assert_allclose(found["paint_toon"], np.where(KNOWN[..., None], again, 0), atol=1e-5)


@pytest.mark.parametrize("mode", ["add", "multiply", "light_only"])
def test_ink_covers_what_is_beneath_and_the_sum_still_holds(tmp_path: Path, mode: str) -> None:
    line = outline(PASSES["P"], PASSES["N"])[..., None]
    ink = '[[painted]]\nname = "ink"\ntype = "outline"\ncolor = [0.1, 0.0, 0.2]\n'
    knobs = f'[relight]\nmode = "{mode}"\nplate_gain = 0.5\n'
    without = lighting(tmp_path, LAMP + knobs).lit(1, plate=PLATE, passes=PASSES, camera=CAMERA)
    lit = lighting(tmp_path, LAMP + ink + knobs).lit(1, plate=PLATE, passes=PASSES, camera=CAMERA)
    color = np.array([0.1, 0.0, 0.2]) * (PLATE if mode == "multiply" else 1)
    np.testing.assert_allclose(lit.beauty, without.beauty * (1 - line) + line * color, atol=2e-6)
    np.testing.assert_array_equal(lit.layers["light_lamp_diffuse"], without.layers["light_lamp_diffuse"])
    assert np.isfinite(lit.layers["paint_ink"]).all()
    assert line.max() > 0.9


def test_a_sphere_a_frame_is_not_kept_for_ever(tmp_path: Path) -> None:
    """A picture a frame: each frame has its own, and only the last one stays in memory beside what every frame asks for."""
    for n in (1, 2, 3):
        write_exr(tmp_path / f"s.{n:04d}.exr", dict.fromkeys("RGB", np.full((8, 8), n, np.float32)))
    sphere(tmp_path)
    text = '[[painted]]\nname = "a"\nfile = "s.####.exr"\n[[painted]]\nname = "b"\nfile = "clay.exr"\n'
    made = lighting(tmp_path, text)
    for n in (1, 2, 3):
        layer = made.lit(n, plate=PLATE, passes=PASSES, camera=CAMERA).layers["paint_a"]
        np.testing.assert_allclose(layer[KNOWN], n)
        assert {path.name for path in made._pictures} == {f"s.{n:04d}.exr", "clay.exr"}


def test_a_fade_reaches_paint(tmp_path: Path) -> None:
    sphere(tmp_path)
    text = '[[painted]]\nname = "clay"\nfile = "clay.exr"\n[relight]\nfade = 1.0\n'
    doubted = PASSES | {"confidence": np.full(SIZE[::-1], 0.25, np.float32)}
    faded = lighting(tmp_path, text).lit(1, plate=PLATE, passes=doubted, camera=CAMERA).layers["paint_clay"]
    whole = lighting(tmp_path, text.replace("1.0", "0.0")).lit(1, plate=PLATE, passes=doubted, camera=CAMERA).layers["paint_clay"]
    np.testing.assert_allclose(faded, 0.5 * whole, rtol=1e-5)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ('type = "lit_spere"\n', r"lights.toml:.*'lit_spere' is unknown; did you mean 'lit_sphere'"),
        ('type = "toon"\nsteps = [0.5, 0.2]\n', "rising steps"),
        ('type = "toon"\n', "made of lights, and there are none"),
        ('type = "lit_sphere"\n', "file is missing"),
        ('file = "clay.exr"\nfacing = "eye"\n', "facing 'eye' is unknown"),
        ('file = "clay.exr"\nexposur = 1\n', "did you mean 'exposure'"),
        ('type = "outline"\nwidth = 2\n', "width must be a number, 0 ... 1"),
        ('type = "outline"\njump = -1\n', "jump must be a number"),
        ('type = "outline"\nname = 3\n', "TOML"),
    ],
)
def test_what_cannot_be_is_told(tmp_path: Path, table: str, told: str) -> None:
    with pytest.raises(ShotError, match=told):
        lighting(tmp_path, f'[[painted]]\nname = "ink"\n{table}')


def test_of_must_name_lights_and_files_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(ShotError, match="'lmap', which is unknown; did you mean 'lamp'"):
        lighting(tmp_path, LAMP + '[[painted]]\nname = "t"\ntype = "toon"\nof = ["lmap"]\n')
    with pytest.raises(ShotError, match="taken by an earlier one"):
        lighting(tmp_path, LAMP + '[[painted]]\nname = "t"\ntype = "toon"\n[[painted]]\nname = "t"\ntype = "outline"\n')
    gone = lighting(tmp_path, '[[painted]]\nname = "clay"\nfile = "clay.exr"\n')
    with pytest.raises(PlateError, match=r"clay.exr: file missing"):
        gone.check([1])
    holes = np.full((8, 8), np.nan, np.float32)
    holes[4] = 1
    write_exr(tmp_path / "clay.exr", dict.fromkeys("RGB", holes))
    with pytest.raises(PassError, match=r"clay.exr: sphere holds NaN"):
        gone.lit(1, plate=PLATE, passes=PASSES, camera=CAMERA)
    assert painted_from_dict({"name": "a", "file": "b.png"}, "painted 'a'").layer == "paint_a"
