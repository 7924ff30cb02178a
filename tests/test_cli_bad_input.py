"""Bad input: one line on stderr that names the file and the remedy, exit code 1, and nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path

import click.testing
import numpy as np
import pytest

from stereorelight import files
from stereorelight.cli import main
from stereorelight.footage.exr import write_exr
from stereorelight.footage.stills import read_still, write_still
from stereorelight.shot.synthetic import write_shot

SIZE = (160, 90)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clean") / "shot"
    write_shot(folder, "sphere", size=SIZE, samples=1)
    return folder


@pytest.fixture
def shot(clean: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(clean, tmp_path / "shot"))


def call(*arguments: object) -> click.testing.Result:
    return click.testing.CliRunner().invoke(main, [str(a) for a in arguments])


def snapshot(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def refused(*arguments: object, words: tuple[str, ...], kind: str) -> str:
    """The one line that the command ends with, after checking that it is one, and that stdout is empty."""
    result = call(*arguments)
    assert result.exit_code == 1, (result.exit_code, result.output, result.exception)
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith(f"{kind}: "), lines[0]
    for word in words:
        assert word in lines[0], lines[0]
    return lines[0]


def depth_of(shot: Path, *extra: object) -> tuple[object, ...]:
    plates = shot / "plates"
    return ("depth", plates / "left.png", plates / "right.png", "--rig", shot / "rig.json", "--out", shot / "z.exr", *extra)


def both_refuse(shot: Path, *, words: tuple[str, ...], kind: str) -> None:
    """`run` and `depth` refuse the shot, and leave its folder as it was."""
    before = snapshot(shot)
    refused("run", shot / "shot.toml", words=words, kind=kind)
    refused(*depth_of(shot), words=words, kind=kind)
    assert snapshot(shot) == before
    assert not list(shot.rglob("*.part*"))


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def corrupt(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 40] = bytes(40)
    path.write_bytes(bytes(data))


@pytest.mark.parametrize("eye", ["left", "right"])
@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda p: p.unlink(), "there is no such file"),
        (truncated, "truncated or damaged"),
        (corrupt, "truncated or damaged"),
        (lambda p: p.write_bytes(b""), "empty"),
        (lambda p: p.write_text("hello"), "is not a PNG"),
    ],
    ids=["missing", "truncated", "corrupt", "empty", "text"],
)
def test_a_picture_that_is_none(shot: Path, eye: str, damage: object, word: str) -> None:
    damage(shot / "plates" / f"{eye}.png")  # type: ignore[operator]
    both_refuse(shot, words=(f"{eye}.png", word), kind="PlateError")


def test_eyes_of_two_sizes(shot: Path) -> None:
    path = shot / "plates" / "right.png"
    write_still(path, read_still(path).rgb[:80], bits=16, force=True)
    both_refuse(shot, words=("right.png", "160 x 80", "160 x 90"), kind="PlateError")


def test_plates_of_another_size_than_the_rig(shot: Path) -> None:
    for eye in ("left", "right"):
        path = shot / "plates" / f"{eye}.png"
        write_still(path, np.repeat(np.repeat(read_still(path).rgb, 2, axis=0), 2, axis=1), bits=16, force=True)
    both_refuse(shot, words=("left.png", "320 x 180", "160 x 90", "rig"), kind="PlateError")


def test_eyes_swapped(shot: Path) -> None:
    plates = shot / "plates"
    shutil.move(plates / "left.png", plates / "other.png")
    shutil.move(plates / "right.png", plates / "left.png")
    shutil.move(plates / "other.png", plates / "right.png")
    both_refuse(shot, words=("left.png", "swapped", "exchange"), kind="PlateError")


def test_the_rig_swapped(shot: Path) -> None:
    rig = json.loads((shot / "rig.json").read_text())
    rig["t_right_left_m"] = [-x for x in rig["t_right_left_m"]]
    (shot / "rig.json").write_text(json.dumps(rig))
    both_refuse(shot, words=("rig.json", "are left and right swapped?"), kind="RigError")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"R_right_left": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]}, ("not a rotation",)),
        ({"R_right_left": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}, ("reflection", "mirrored")),
        ({"left": {"size": SIZE, "K": [[-200, 0, 80], [0, 200, 45], [0, 0, 1]]}}, ("left", "focal lengths", "-200")),
        ({"left": {"size": SIZE, "K": [[200, 0, 80], [0, 200, 45], [0, 0, 1]], "modle": "brown"}}, ("'modle'", "'model'")),
        ({"mirrored": "up"}, ("mirrored", "'up'")),
        ({"t_right_left_m": [0, 0, 0]}, ("no depth",)),
    ],
)
def test_a_rig_that_cannot_be(shot: Path, change: dict[str, object], words: tuple[str, ...]) -> None:
    (shot / "rig.json").write_text(json.dumps(json.loads((shot / "rig.json").read_text()) | change))
    both_refuse(shot, words=("rig.json", *words), kind="RigError")


def test_a_rig_that_is_missing_or_no_json(shot: Path) -> None:
    (shot / "rig.json").write_text("{")
    both_refuse(shot, words=("rig.json", "JSON"), kind="RigError")
    (shot / "rig.json").unlink()
    both_refuse(shot, words=("rig.json", "missing"), kind="RigError")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("colour_space", "color_space", ("shot.toml:", "unknown key 'color_space'", "'colour_space'")),
        ('colour_space = "auto"', 'colour_space = "srbg"', ("colour_space", "'srbg'", "'sRGB'")),
        ('"standard"', '"standrad"', ("shot.toml:", "'standrad'", "'standard'")),
        ("[[lights]]", "[[light]]", ("shot.toml:", "unknown table 'light'", "'lights'")),
        ("azimuth_deg = ", "azimut_deg = ", ("shot.toml:", "azimut_deg", "'azimuth_deg'")),
        ("[output]", "[output", ("shot.toml", "TOML")),
    ],
)
def test_a_shot_file_with_a_slip(shot: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    text = (shot / "shot.toml").read_text()
    assert old in text
    (shot / "shot.toml").write_text(text.replace(old, new, 1))
    before = snapshot(shot)
    refused("run", shot / "shot.toml", words=words, kind="ShotError")
    assert snapshot(shot) == before


def test_a_frame_that_one_eye_lacks(shot: Path) -> None:
    plates = shot / "plates"
    for n in (1001, 1002, 1003):
        for eye in ("left", "right"):
            shutil.copy(plates / f"{eye}.png", plates / f"{eye}.{n}.png")
    (plates / "right.1002.png").unlink()
    call_depth = ["depth", plates / "left.####.png", plates / "right.####.png", "--rig", shot / "rig.json", "--out", shot / "z.####.exr"]
    refused(*call_depth, words=("right.1002.png", "frame missing", "left has 1001-1003", "--frames 1001"), kind="PlateError")
    refused(*call_depth, "--frames", "1001-1009", words=("1002", "frame missing"), kind="PlateError")
    refused(*call_depth, "--frames", "9-1", words=("backwards",), kind="ShotError")
    refused(*call_depth[:-1], shot / "z.exr", "--frames", "1001,1003", words=("z.exr", "pattern"), kind="ShotError")
    assert not list(shot.glob("z*"))


def test_a_plate_of_nan(shot: Path) -> None:
    nothing = np.full((SIZE[1], SIZE[0]), np.nan, dtype=np.float32)
    write_exr(shot / "plates" / "left.exr", dict.fromkeys("RGB", nothing))
    text = (shot / "shot.toml").read_text().replace("left.png", "left.exr")
    (shot / "shot.toml").write_text(text)
    before = snapshot(shot)
    refused("run", shot / "shot.toml", words=("left.exr", "every pixel is NaN"), kind="PlateError")
    assert snapshot(shot) == before


def test_a_plate_that_is_partly_nan_is_relit_elsewhere(shot: Path) -> None:
    """NaN stays where it is: no NaN in any layer, and the picture around it is relit."""
    from stereorelight.footage.frames import read_frame
    from stereorelight.footage.plates import read_plate

    plate = read_plate(shot / "plates" / "left.png")
    plate[20:30, 60:90] = np.nan
    write_exr(shot / "plates" / "left.exr", {c: plate[..., i] for i, c in enumerate("RGB")})
    (shot / "shot.toml").write_text((shot / "shot.toml").read_text().replace("left.png", "left.exr"))
    assert call("run", shot / "shot.toml").exit_code == 0
    relit = read_frame(shot / "out" / "relit" / "sphere.exr")
    assert np.array_equal(np.isnan(relit["beauty"]).any(axis=-1), np.isnan(plate).any(axis=-1))
    assert all(np.isfinite(relit[name]).all() for name in relit if name != "beauty")


def test_an_output_folder_that_is_a_file(shot: Path) -> None:
    (shot / "out").write_text("mine")
    refused("run", shot / "shot.toml", words=("out", "a file stands where a folder is needed"), kind="OutputError")
    refused(*depth_of(shot)[:-1], shot / "out" / "z.exr", words=("out", "file stands"), kind="OutputError")
    refused("synth", "sphere", "--out", shot / "out" / "s", "--size", "64x48", words=("out", "file stands"), kind="OutputError")
    refused("demo", "--out", shot / "out", words=("out", "file stands"), kind="OutputError")
    assert (shot / "out").read_text() == "mine"


@pytest.mark.skipif(not os.path.isdir("/proc/1"), reason="needs a place where no folder can be made, even by root")
def test_an_output_folder_that_cannot_be_made(shot: Path) -> None:
    text = (shot / "shot.toml").read_text().replace('folder = "out"', 'folder = "/proc/nowhere"')
    (shot / "shot.toml").write_text(text)
    refused("run", shot / "shot.toml", words=("/proc/nowhere",), kind="OutputError")


@pytest.mark.parametrize(("number", "word"), [(errno.ENOSPC, "disk is full"), (errno.EROFS, "no permission"), (errno.EACCES, "no permission")])
def test_a_disk_that_takes_nothing(shot: Path, monkeypatch: pytest.MonkeyPatch, number: int, word: str) -> None:
    def fails(source: object, target: object) -> None:
        raise OSError(number, os.strerror(number), str(target))

    before = snapshot(shot)
    with monkeypatch.context() as patch:
        patch.setattr(files.os, "replace", fails)
        refused("run", shot / "shot.toml", words=("out", word), kind="OutputError")
        refused(*depth_of(shot), words=("z.exr", word), kind="OutputError")
        refused("rectify", *depth_of(shot)[1:5], "--out", shot / "r", words=("left.exr", word), kind="OutputError")
    assert snapshot(shot) == before
    assert call("run", shot / "shot.toml").exit_code == 0


def test_a_disk_that_fills_up_half_way(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.replace

    def fills_up(source: Path, target: Path) -> None:
        if Path(target).parent.name == "relit":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "replace", fills_up)
        refused("run", shot / "shot.toml", words=("relit", "sphere.exr", "disk is full"), kind="OutputError")
    assert not list(shot.rglob("*.part*"))
    result = call("run", shot / "shot.toml", "--json")
    assert json.loads(result.stdout)["steps_done"] == 3  # depth and passes stand


def test_results_are_not_overwritten(shot: Path) -> None:
    (shot / "z.exr").write_bytes(b"mine")
    refused(*depth_of(shot), words=("z.exr", "exists", "--force"), kind="OutputError")
    assert (shot / "z.exr").read_bytes() == b"mine"
    assert call(*depth_of(shot), "--force").exit_code == 0
    refused("synth", "sphere", "--out", shot, "--size", "64x48", words=("exists", "--force"), kind="OutputError")


@pytest.mark.parametrize(
    ("arguments", "words", "kind"),
    [
        (("--near", "-1"), ("near_m", "> 0"), "ShotError"),
        (("--near", "5", "--far", "2"), ("near_m", "less than far_m"), "ShotError"),
        (("--quality", "fien"), ("'fien'", "'fine'"), "ShotError"),
        (("--colour-space", "srbg"), ("'srbg'", "'sRGB'"), "ShotError"),
        (("--frames", "1001-1002"), ("single picture",), "PlateError"),
    ],
)
def test_settings_that_cannot_be(shot: Path, arguments: tuple[str, ...], words: tuple[str, ...], kind: str) -> None:
    refused(*depth_of(shot, *arguments), words=words, kind=kind)


@pytest.mark.parametrize(
    ("arguments", "words", "kind"),
    [
        (("bsut",), ("'bsut'", "'bust'"), "ShotError"),
        (("bust", "--rig", "toad-in"), ("'toad-in'", "'toed-in'"), "RigError"),
        (("bust", "--size", "4x4"), ("4x4",), "ShotError"),
        (("bust", "--baseline", "-1"), ("baseline",), "ShotError"),
        (("bust", "--fov-deg", "181"), ("fov_deg",), "RigError"),
        (("bust", "--texture", "9"), ("texture",), "ShotError"),
    ],
)
def test_a_scene_that_cannot_be(tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...], kind: str) -> None:
    refused("synth", *arguments, "--out", tmp_path / "s", words=words, kind=kind)
    assert not (tmp_path / "s").exists()


def test_passes_and_relight_of_the_wrong_files(shot: Path) -> None:
    truth, plate, out = shot / "truth" / "sphere.exr", shot / "plates" / "left.png", shot / "x.exr"
    refused("passes", truth, "--layer", "depht.Z", "--out", out, words=("sphere.exr", "depht.Z"), kind="PlateError")
    small = shot / "small.exr"
    write_exr(small, {"Z": np.ones((4, 6), dtype=np.float32)})
    refused("passes", small, "--out", out, words=("small.exr", "--rig", "--fov-deg"), kind="PlateError")
    refused("passes", small, "--rig", shot / "rig.json", "--out", out, words=("6 x 4", "160 x 90"), kind="PlateError")
    write_exr(small, {"Z": np.zeros((4, 6), dtype=np.float32)}, force=True)
    refused("passes", small, "--fov-deg", 40, "--out", out, words=("small.exr", "no distance"), kind="PlateError")
    lights = shot / "lights.toml"
    lights.write_text('[[lights]]\nname = "a"\ntype = "point"\nposition_m = [0, 0, 0]\nintesity = 2\n')
    refused("relight", plate, truth, "--lights", lights, "--out", out, words=("lights.toml:5", "'intensity'"), kind="ShotError")
    lights.write_text('[[lights]]\nname = "a"\ntype = "point"\nposition_m = [0, 0, 0]\n')
    refused("relight", plate, plate, "--lights", lights, "--out", out, words=("left.png", "not an EXR"), kind="PlateError")
    write_exr(small, {"Z": np.ones((4, 6), dtype=np.float32)}, force=True)
    refused("relight", plate, small, "--lights", lights, "--out", out, words=("small.exr", "'P'", "passes"), kind="PassError")
    refused("compare", small, truth, "--what", "depth", words=("small.exr", "sphere.exr", "160 x 90", "6 x 4", "--crop"), kind="PassError")
    refused("compare", small, truth, "--what", "normals", words=("small.exr", "'N'"), kind="PassError")
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments", [("rnu",), ("depth",), ("compare", "a", "b", "--what", "taste"), ("synth", "bust", "--out", "x", "--size", "big")]
)
def test_wrong_usage_is_2(arguments: tuple[str, ...]) -> None:
    result = call(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""


def test_ctrl_c_is_130(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*args: object, **settings: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("stereorelight.shot.pairs.recover", stop)
    result = call("run", shot / "shot.toml")
    assert result.exit_code == 130
    assert "stopped" in result.stderr
    assert "Traceback" not in result.stderr
