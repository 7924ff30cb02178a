"""The plate's own light in a light file and over a shot: albedo by division or from a file, exposure, and the same bits in pieces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.exr import write_exr
from stereorelight.footage.frames import read_frame
from stereorelight.shot.lighting import Lighting
from stereorelight.shot.run import run_shot
from stereorelight.shot.schema import read_light_file
from stereorelight.shot.synthetic import write_shot
from tests.plate_lit import bust_under

LAMP = '[[lights]]\nname = "new"\ntype = "directional"\nazimuth_deg = 40\nspecular = 0.1\n'


def lit(folder: Path, text: str, name: str = "right"):  # type: ignore[no-untyped-def]
    (folder / "lights.toml").write_text(text)
    scene = bust_under(name)
    made = Lighting(setup=read_light_file(folder / "lights.toml"))
    made.check([None])
    subject = {"actor": scene.subject.astype(np.float32)}
    return made.lit(None, plate=scene.frame["plate"], passes=scene.frame, camera=scene.rig.left, given=subject)


def test_estimated_albedo_is_what_the_lights_fall_on(tmp_path: Path) -> None:
    """Layers are on the albedo, which is a pass of the file; with match_exposure they are stronger by the plate's own level."""
    scene = bust_under("right")
    own = '[relight]\nalbedo = "estimated"\nalbedo_matte = "actor"\nplate_gain = 0\n'
    apart = lit(tmp_path, LAMP + own)
    assert apart.colour is not None
    assert apart.colour.light is not None
    assert apart.colour.light.told
    np.testing.assert_array_equal(apart.passes()["albedo"], apart.colour.albedo)
    inside = scene.subject
    ratio = apart.colour.albedo[inside] / scene.frame["albedo"][inside]
    assert np.percentile(np.abs(np.log(ratio / np.median(ratio))), 80) < 0.25
    facing = lit(tmp_path, LAMP + own + "match_exposure = true\n")
    for key in ("light_new_diffuse", "light_new_specular"):
        np.testing.assert_allclose(facing.layers[key], apart.layers[key] * apart.colour.light.level, rtol=1e-5)
    sky = np.full((8, 16), 0.7, np.float32)
    write_exr(tmp_path / "sky.exr", dict.fromkeys("RGB", sky))
    under = lit(tmp_path, own + '[environment]\nfile = "sky.exr"\n')
    np.testing.assert_allclose(under.beauty, 0.7 * apart.colour.albedo, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(facing.beauty, sum(facing.layers.values()), rtol=1e-5, atol=1e-6)


def test_albedo_from_a_file_and_what_cannot_be(tmp_path: Path) -> None:
    scene = bust_under("right")
    write_exr(tmp_path / "albedo.exr", {c: np.ascontiguousarray(scene.frame["albedo"][..., k]) for k, c in enumerate("RGB")})
    plain = lit(tmp_path, LAMP + '[relight]\nalbedo = "albedo.exr"\n')
    assert plain.colour is not None
    np.testing.assert_allclose(plain.colour.albedo, scene.frame["albedo"], rtol=1e-3)
    assert lit(tmp_path, LAMP).colour is None
    matched = lit(tmp_path, LAMP + '[relight]\nalbedo = "albedo.exr"\nmatch_exposure = true\n')
    facing = float(np.percentile(scene.E.mean(axis=-1), 90))
    np.testing.assert_allclose(matched.layers["light_new_diffuse"], plain.layers["light_new_diffuse"] * matched.colour.exposure, rtol=1e-5)
    assert matched.colour.exposure == pytest.approx(facing, rel=0.1)
    write_exr(tmp_path / "small.exr", {c: np.ones((4, 6), np.float32) for c in "RGB"})
    for text, error, words in (
        ('albedo = "small.exr"\n', PlateError, r"small\.exr: albedo is 6x4 pixels, the plate 320x180"),
        ('albedo = "none.exr"\n', PlateError, r"none\.exr: file missing"),
        ('albedo = "estimated"\nmode = "multiply"\n', ShotError, r'lights\.toml:\d+: relight: albedo has no part in mode "multiply"'),
        ('albedo = "estimated"\nalbedo_matte = "actr"\n', ShotError, r"relight: albedo_matte 'actr' is missing"),
        ("albedo_gain = 0.5\n", ShotError, r"albedo_gain = 0\.5"),
    ):
        with pytest.raises(error, match=words):
            lit(tmp_path, LAMP + "[relight]\n" + text)


def test_a_shot_is_lit_alike_whole_and_in_pieces(tmp_path: Path) -> None:
    """The light of the shot is that of its middle frame, whichever frames are run; receipts hold it in numbers and words."""
    made = {}
    for where, parts in (("whole", ["1001-1003"]), ("parts", ["1003", "1001"])):
        folder = tmp_path / where
        write_shot(folder, "sphere", size=(96, 64), samples=1, frames=3)
        path = folder / "shot.toml"
        text = path.read_text().replace("[relight]", '[relight]\nalbedo = "estimated"\nmatch_exposure = true')
        path.write_text(text.replace("[depth]", '[depth]\ntime = "off"').replace("previews = true", "previews = false"))
        for part in parts:
            run_shot(path, frames=part)
        made[where] = {n: read_frame(folder / "out" / "relit" / f"sphere.{n}.exr") for n in (1001, 1003)}
        receipt = json.loads((folder / "out" / "receipts" / "sphere.1001.json").read_text())
        figures = receipt["steps"]["relight"]["figures"]
        assert "words" in figures["plate_light"]
        assert figures["exposure"] == pytest.approx(figures["plate_light"]["level"], rel=1e-3)
    for number, frame in made["whole"].items():
        for name in frame:
            np.testing.assert_array_equal(frame[name], made["parts"][number][name])
