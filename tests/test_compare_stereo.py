"""Both eyes of one world: a shift by hand, what is hidden, and relit pairs through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stereorelight.cli.group import main
from stereorelight.compare.stereo import carried, stereo_figures
from stereorelight.errors import PassError
from stereorelight.footage.frames import write_frame
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.light.lights import PointLight
from stereorelight.light.shade import light_layers
from stereorelight.passes import Frame
from stereorelight.synth.render import render
from stereorelight.synth.rigs import parallel_rig, rig_named
from stereorelight.synth.scenes import scene_named

SIZE = (160, 96)


def test_a_whole_shift_is_carried_bit_for_bit() -> None:
    rig = parallel_rig((64, 40))
    Z = np.full((40, 64), rig.left.fx * rig.baseline_m / 5.0, np.float32)  # five pixels of disparity
    right = np.random.default_rng(1).uniform(0, 1, (40, 64, 3)).astype(np.float32)
    found = carried(right, Z, Z, rig)
    np.testing.assert_allclose(found[:, 5:], right[:, :-5], atol=1e-5)
    assert np.isnan(found[:, :5]).all()
    left = np.nan_to_num(found)
    same = stereo_figures(left, right, Z, Z, rig)
    assert same.relative_rms_percent < 1e-3
    assert same.seen_percent == pytest.approx(100 * 59 / 64)
    brighter = stereo_figures(left, 1.1 * right, Z, Z, rig)
    assert brighter.gain == pytest.approx(1.1, rel=1e-4)
    assert brighter.relative_rms_percent == pytest.approx(10, rel=1e-3)


@pytest.mark.parametrize("kind", ["parallel", "hard"])
def test_what_the_right_eye_does_not_see_has_no_answer(kind: str) -> None:
    rig = rig_named(kind, SIZE)
    shot = render(scene_named("two_planes"), rig, samples=1)
    found = carried(shot.right["plate"], shot.left["Z"], shot.right["Z"], rig)
    unseen, hidden = np.isnan(found).any(axis=-1), shot.left["flags"] != 0
    assert (unseen != hidden).mean() < 0.01  # but for the outline itself
    assert 0.01 < hidden.mean() < 0.5


def test_matte_light_of_one_world_is_one_and_a_wrong_depth_shows() -> None:
    """Lights of the world on exact passes of each eye: on a plain scene nothing is left between the eyes."""
    rig = rig_named("toed-in", SIZE)
    shot = render(scene_named("box", texture=0), rig, samples=1)
    world = [PointLight(name="key", position_m=(0.6, 0.5, -0.4), space="world")]
    lit = {}
    for eye in ("left", "right"):
        frame = shot.frame(eye)
        pose = np.eye(4)
        if eye == "right":
            flip = np.diag([1.0, -1.0, -1.0])
            pose[:3, :3], pose[:3, 3] = flip @ rig.R_right_left.T @ flip, flip @ rig.right_centre_m
        camera = type(frame.camera)(**{**vars(frame.camera), "world_from_camera": pose}) if eye == "right" else frame.camera
        lit[eye] = light_layers(frame["P"], frame["N"], frame["albedo"], world, camera=camera)["light_key_diffuse"]
    exact = stereo_figures(lit["left"], lit["right"], shot.left["Z"], shot.right["Z"], rig)
    assert exact.p95_percent < 0.05  # the rest are the edges of the box, where two sides meet within a pixel
    assert exact.relative_rms_percent < 6
    assert exact.gain == pytest.approx(1, abs=2e-3)
    bent = stereo_figures(lit["left"], lit["right"], shot.left["Z"] * np.float32(1.015), shot.right["Z"], rig)
    assert bent.p95_percent > 10 * exact.p95_percent
    assert bent.median_percent > 10 * exact.median_percent


def relit(folder: Path, *, error: float = 1.0) -> dict[str, Path]:
    """Both eyes of a sphere relit by one light with a highlight, as files; `error` is a gain on the light."""
    rig = parallel_rig(SIZE)
    shot = render(scene_named("sphere"), rig, samples=1)
    files = {"rig": folder / "rig.json"}
    write_rig(files["rig"], rig)
    for eye, x in (("left", 0.0), ("right", -rig.baseline_m)):
        frame = shot.frame(eye)
        light = PointLight(name="key", position_m=(0.5 + x, 0.5, -0.3), specular=0.4, exponent=30)
        layers = {name: np.float32(error) * layer for name, layer in light_layers(frame["P"], frame["N"], frame["albedo"], [light]).items()}
        beauty = 0.3 * frame["plate"] + sum(layers.values())
        files[eye] = folder / f"{eye}.exr"
        write_frame(files[eye], Frame(passes={"beauty": beauty, "Z": frame["Z"], **layers}, camera=frame.camera, eye=eye), half=False)
        files[f"{eye}_plate"] = folder / f"{eye}_plate.exr"
        write_frame(files[f"{eye}_plate"], Frame(passes={"beauty": frame["plate"]}, camera=frame.camera, eye=eye), half=False)
    matte = (shot.objects["left"] == shot.object_names.index("ball")).astype(np.float32)
    files["matte"] = folder / "ball.png"
    write_still(files["matte"], np.repeat(matte[..., None], 3, axis=-1))
    return files


def command(*words: object, code: int = 0) -> dict:
    run = CliRunner().invoke(main, [str(w) for w in words])
    assert run.exit_code == code, run.output
    return json.loads(run.output[run.output.index("{") :]) if "--json" in [str(w) for w in words] else {"text": run.output}


def test_two_eyes_at_the_command_line(tmp_path: Path) -> None:
    files = relit(tmp_path)
    told = command("compare", files["left"], files["right"], "--what", "stereo", "--rig", files["rig"], "--json")["stereo"]
    assert told["key"]["eyes_rms_percent"] < 6  # the grain between the pixels
    assert any("light_key_specular" in note for note in told["notes"])
    page = tmp_path / "page.html"
    command("compare", files["left"], files["right"], "--what", "stereo", "--rig", files["rig"], "--out", page, "--gate", "eyes_rms<20")
    assert page.read_text().startswith("<!")
    text = command("compare", files["left"], files["right"], "--what", "stereo", code=1)["text"]
    assert "--rig" in text


def test_a_picture_at_the_command_line(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    truth, found = relit(tmp_path / "a"), relit(tmp_path / "b", error=0.9)
    words = ["compare", found["left"], truth["left"], "--what", "picture", "--plate", truth["left_plate"], "--plate-gain", 0.3]
    told = command(*words, "--matte", f"ball={truth['matte']}", "--json")["picture"]
    assert told["light alone"]["all lights"]["light_rms_percent"] == pytest.approx(10, rel=1e-3)
    assert told["light alone"]["key in ball"]["light_gain"] == pytest.approx(0.9, rel=1e-3)
    assert told["picture"]["ball"]["pixels"] > 500
    assert told["picture"]["all"]["cover_percent"] == 100
    failed = command(*words, "--gate", "relative_rms<0.1", code=1)["text"]
    assert "FAILS" in failed
    page = tmp_path / "page.html"
    command(*words, "--out", page)
    assert "picture" in page.read_text()


def test_a_sequence_names_its_worst_frame(tmp_path: Path) -> None:
    for name, gains in (("truth", (1, 1, 1)), ("result", (1.0, 0.8, 0.95))):
        (tmp_path / name).mkdir()
        for n, gain in enumerate(gains):
            picture = np.full((32, 48, 3), 0.4 * gain, np.float32)
            write_frame(tmp_path / name / f"x.{1001 + n}.exr", Frame(passes={"beauty": picture}), half=False)
    told = command("compare", tmp_path / "result" / "x.####.exr", tmp_path / "truth" / "x.####.exr", "--what", "picture", "--json")["picture"]
    assert "1002 (20.00)" in told["notes"][-1]
    assert told["all"]["relative_rms_percent"] == pytest.approx((0 + 20 + 5) / 3, rel=1e-3)
    assert [f["frame"] for f in told["frames"]] == [1001, 1002, 1003]


def test_nonsense_is_refused(tmp_path: Path) -> None:
    rig = parallel_rig((64, 40))
    Z, picture = np.full((40, 64), 2.0, np.float32), np.ones((40, 64, 3), np.float32)
    with pytest.raises(PassError, match="Z of the left eye"):
        carried(picture, Z[:20], Z, rig)
    with pytest.raises(PassError, match="right eye's picture must have shape"):
        carried(picture[:20], Z, Z, rig)
    with pytest.raises(PassError, match="no pixel in common"):
        stereo_figures(picture, picture, Z, 3 * Z, rig)
    files = relit(tmp_path)
    text = command("compare", files["left"], files["left_plate"], "--what", "picture", "--matte", "ball", code=2)["text"]
    assert "NAME=FILE" in text
    text = command("compare", files["left"], tmp_path / "no.exr", "--what", "picture", code=1)["text"]
    assert "no.exr" in text
    text = command("compare", files["left_plate"], files["right_plate"], "--what", "stereo", "--rig", files["rig"], code=1)["text"]
    assert "--depth" in text
