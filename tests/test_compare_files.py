"""`compare`, `passes` and `relight` on files of renderers and benchmarks: understood, said, or asked for; pages, gates, history, sequences."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click.testing
import numpy as np
import pytest

from stereorelight.cli import main
from stereorelight.footage.exr import write_exr
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.footage.pfm import read_pfm, write_pfm
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Frame
from stereorelight.synth.render import render
from stereorelight.synth.rigs import rectified_rig, rig_named
from stereorelight.synth.scenes import scene_named

SIZE = (160, 90)
RIG = rig_named("parallel", SIZE)


def call(*arguments: object) -> click.testing.Result:
    return click.testing.CliRunner().invoke(main, [str(a) for a in arguments])


def answer(*arguments: object) -> dict[str, Any]:
    result = call(*arguments, "--json")
    assert result.exit_code == 0, result.output
    told: dict[str, Any] = json.loads(result.stdout)
    return told


def refused(*arguments: object, words: tuple[str, ...], kind: str = "PassError") -> None:
    result = call(*arguments)
    assert result.exit_code == 1, result.output
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith(f"{kind}: "), lines[0]
    for word in words:
        assert word in lines[0], lines[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rig.json, truth.exr and result.exr (ours: Z off by 1 % of noise, N by 6 degrees), and the true passes as `true.npz`."""
    out = tmp_path_factory.mktemp("files")
    left = render(scene_named("interior"), RIG, samples=1).left
    write_rig(out / "rig.json", RIG)
    write_frame(out / "truth.exr", replace(left, passes={k: left[k] for k in ("Z", "P", "N", "flags", "disparity")}))
    rng = np.random.default_rng(0)
    N = left["N"] + 0.07 * rng.standard_normal(left["N"].shape)
    result = {
        "Z": (left["Z"] * np.exp(0.01 * rng.standard_normal(left["Z"].shape))).astype(np.float32),
        "N": (N / np.linalg.norm(N, axis=-1, keepdims=True)).astype(np.float32),
        "confidence": np.full(left["Z"].shape, 0.9, np.float32),
    }
    write_frame(out / "result.exr", replace(left, passes=result))
    np.savez(out / "true.npz", Z=left["Z"], P=left["P"], N=left["N"], rays=RIG.left.ray_grid())
    return out


@pytest.fixture(scope="module")
def true(folder: Path) -> dict[str, Any]:
    return dict(np.load(folder / "true.npz"))


def length(true: dict[str, Any]) -> Any:
    return true["Z"] * np.sqrt(1 + (true["rays"].astype(np.float64) ** 2).sum(axis=-1))


def exr(channels: dict[str, Any]) -> Callable[[Path], str]:
    def write(folder: Path) -> str:
        write_exr(folder / "foreign.exr", {k: np.ascontiguousarray(v, np.float32) for k, v in channels.items()}, force=True)
        return "foreign.exr"

    return write


def layer(name: str, a: Any, letters: str) -> dict[str, Any]:
    return {f"{name}.{letter}": a[..., i] for i, letter in enumerate(letters)}


def pfm(a: Any) -> Callable[[Path], str]:
    def write(folder: Path) -> str:
        write_pfm(folder / "foreign.pfm", a, force=True)
        return "foreign.pfm"

    return write


def png(a: Any) -> Callable[[Path], str]:
    def write(folder: Path) -> str:
        write_still(folder / "foreign.png", np.asarray(a), bits=16, force=True)
        return "foreign.png"

    return write


CASES: dict[str, tuple[Callable[[dict[str, Any]], Callable[[Path], str]], tuple[str, ...], str]] = {
    "blender: ray length in the depth layer": (lambda t: exr({"ViewLayer.Depth.V": length(t)}), (), "ray length in m"),
    "nuke: 1 / Z": (lambda t: exr({"depth.Z": 1 / t["Z"]}), (), "1 / Z in m"),
    "maya: centimetres": (lambda t: exr({"Z": 100 * t["Z"]}), (), "Z along the axis in cm"),
    "half float, 1e10 for nothing": (lambda t: exr({"Z": np.where(t["Z"] > 4, 1e10, t["Z"])}), (), "Z along the axis in m"),
    "pfm in millimetres": (lambda t: pfm(1000 * t["Z"]), (), "Z along the axis in mm"),
    "png in millimetres": (lambda t: png(np.rint(1000 * t["Z"]).astype(np.uint16)), (), "Z along the axis in mm"),
    "png of KITTI": (lambda t: png(np.rint(256 * t["Z"]).astype(np.uint16)), (), "Z along the axis in 1/256 m"),
    "png, normalised": (
        lambda t: png(np.rint(65535 * (t["Z"] - 0.1) / 9.9).astype(np.uint16)),
        ("--truth-is", "normalised", "--near", 0.1, "--far", 10),
        "as stated",
    ),
    "world P of another package": (
        lambda t: exr(layer("WorldPosition", 100 * (t["P"] @ np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]).T + (1, 2, 3)), "RGB")),
        (),
        "the camera stands at (100, 200, 300)",
    ),
    "camera P, y down and z forward": (lambda t: exr(layer("P", t["P"] * (1, -1, -1), "XYZ")), (), "x right, y down, z forward"),
    "at twice the size": (lambda t: pfm(np.kron(t["Z"], np.ones((2, 2)))), (), "2 times the size"),
    "a crop of 1 / Z": (lambda t: exr({"depth.Z": 1 / t["Z"][11:81, 20:140]}), (), "its first pixel lies on (20, 11)"),
    "stated against the evidence": (lambda t: exr({"Z": length(t)}), ("--truth-is", "z", "--unit", "m"), "does not look right"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_renderers_depth_is_understood_and_said(folder: Path, true: dict[str, Any], case: str) -> None:
    make, options, words = CASES[case]
    name = make(true)(folder)
    found = answer("compare", folder / "result.exr", folder / name, "--what", "depth", *options)["depth"]
    assert words in " ".join(found["notes"]), found["notes"]
    error = found["percent"]["flat"]["average_percent"]
    if "stated against" in case:
        assert error > 1.3  # it is what it was told to be
    else:  # 1 % of noise has a mean size of 0.8 %; KITTI's step of 4 mm and the doubled pixels add a little
        assert error == pytest.approx(0.8, abs=0.15)


def test_normals_of_others_are_understood_and_said(folder: Path, true: dict[str, Any]) -> None:
    turned = (true["N"] * (1, -1, -1) + 1) / 2
    for write in (exr(layer("Normals", turned, "RGB")), png(turned), pfm(turned)):
        found = answer("compare", folder / "result.exr", folder / write(folder), "--what", "normals")["normals"]
        assert "x right, y down, z forward, coded 0..1" in found["notes"][0]
        assert found["median_deg"] == pytest.approx(4.8, abs=0.6)
    world = true["N"] @ np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]).T
    name = exr({**layer("N", world, "XYZ"), "depth.Z": 1 / true["Z"]})(folder)
    found = answer("compare", folder / "result.exr", folder / name, "--what", "normals")["normals"]
    assert "axes of a world" in " ".join(found["notes"])
    assert "slopes of its own depth" in " ".join(found["notes"])
    assert found["median_deg"] == pytest.approx(4.8, abs=1.5)
    refused("compare", folder / "result.exr", folder / exr(layer("N", world, "XYZ"))(folder), "--what", "normals", words=("foreign.exr", "--poses"))


@pytest.mark.parametrize("factor", [1.0, -1.0, 256.0])
def test_disparity_of_a_benchmark(folder: Path, factor: float) -> None:
    rig = rectified_rig(RIG)
    truth = read_frame(folder / "truth.exr")["disparity"]
    name = pfm(truth * factor)(folder)
    options = ("--what", "disparity", "--rig", folder / "rig.json")
    found = answer("compare", folder / "result.exr", folder / name, *options)["disparity"]
    assert ("turned" in " ".join(found["notes"])) is (factor < 0)
    Z = read_frame(folder / "result.exr")["Z"]
    wanted = np.abs(rig.disparity_from_depth(Z) - truth).mean()
    assert found["all"]["average_px"] == pytest.approx(wanted, rel=1e-3)
    # Half the size has half the disparity: laid on the result it is doubled.
    half = pfm(truth[::2, ::2] * factor / 2)(folder)
    at_half = answer("compare", folder / "result.exr", folder / half, *options)["disparity"]
    assert at_half["flat"]["average_px"] == pytest.approx(found["flat"]["average_px"], abs=0.15)


def test_what_cannot_be_told_is_asked_for(folder: Path, true: dict[str, Any]) -> None:
    def doubted(write: Callable[[Path], str], *words: str, what: str = "depth", options: tuple[object, ...] = ()) -> None:
        refused("compare", folder / "result.exr", folder / write(folder), "--what", what, *options, words=words)

    doubted(exr({"Z": (true["Z"] - 0.1) / 9.9}), "normalised", "--truth-is normalised", "--near 0.1")
    doubted(exr({"Z": true["Z"] / 0.55}), "no unit", "--unit")
    doubted(exr({"Z": np.full_like(true["Z"], np.nan)}), "foreign.exr", "hardly a known pixel")
    doubted(exr({"Z": np.random.default_rng(0).uniform(1, 5, (90, 160))}), "foreign.exr", "State it")
    doubted(exr({"Z": true["Z"][:, ::-1][:50]}), "160 x 50", "160 x 90", "--crop X,Y")
    doubted(exr({"Z": true["Z"]}), "--near and --far", options=("--truth-is", "normalised"))
    doubted(exr({"Z": true["Z"]}), "did you mean 'inverse'", options=("--truth-is", "invers"))
    doubted(exr({"Z": true["Z"]}), "unit 'cmm'", options=("--unit", "cmm"))
    normals = exr(layer("N", true["N"], "XYZ"))
    doubted(normals, "no direction is called 'dwn'", "did you mean 'down'", what="normals", options=("--axes", "right,dwn,back"))
    doubted(exr(layer("P", 1.7 * true["P"] * (1.4, 1, 1), "XYZ")), "--rig or --fov-deg")


def test_files_that_hold_nothing_of_the_kind(folder: Path) -> None:
    result = folder / "result.exr"
    refused(
        "compare", result, folder / exr({"R": np.ones((90, 160))})(folder), "--what", "depth", words=("foreign.exr", "--layer"), kind="PlateError"
    )
    refused("compare", result, folder / "none.exr", "--what", "depth", words=("none.exr",), kind="PlateError")
    (folder / "cut.pfm").write_bytes(b"Pf\n160 90\n-1.0\n1234")
    refused("compare", result, folder / "cut.pfm", "--what", "depth", words=("cut.pfm", "truncated", "4 of 57600"), kind="PlateError")
    (folder / "no.pfm").write_bytes(b"P6\n160 90\n255\n")
    refused("compare", result, folder / "no.pfm", "--what", "depth", words=("no.pfm", "not a PFM"), kind="PlateError")
    refused("compare", result, folder / "x.####.exr", "--what", "depth", words=("x.####.exr",), kind="PlateError")
    refused("compare", result, folder / "truth.exr", "--what", "depth", "--frames", "1-3", words=("single file",), kind="PlateError")


def test_a_result_of_another_tool(folder: Path, true: dict[str, Any]) -> None:
    """Taken as ours are, and that is said; or as stated."""
    Z = read_frame(folder / "result.exr")["Z"]
    plain = folder / exr({"Z": Z})(folder)
    found = answer("compare", plain, folder / "truth.exr", "--what", "depth")["depth"]
    assert "foreign.exr: the result is taken as ours are" in found["notes"][0]
    assert found["percent"]["all"]["average_percent"] == pytest.approx(0.8, abs=0.05)
    for write, options in (
        (exr({"Z": 100 * Z}), ("--result-unit", "cm")),
        (pfm(1 / Z), ("--result-is", "inverse")),
        (png(np.rint(5000 * Z).astype(np.uint16)), ("--result-unit", 1 / 5000)),
    ):
        again = answer("compare", folder / write(folder), folder / "truth.exr", "--what", "depth", *options)["depth"]
        assert again["percent"]["all"]["average_percent"] == pytest.approx(found["percent"]["all"]["average_percent"], rel=0.01)
        assert "as stated" in again["notes"][0]
    refused("compare", folder / "foreign.png", folder / "truth.exr", "--what", "depth", words=("foreign.png", "--result-unit"))


def test_gates_and_their_exit_code(folder: Path) -> None:
    files = ("compare", folder / "result.exr", folder / "truth.exr", "--what", "depth", "--rig", folder / "rig.json")
    held = call(*files, "--gate", "bad2<3, normal_median<90, cover>=100, bad2@flat<20, avg<1")
    assert held.exit_code == 0, held.output
    assert held.stdout.count("holds: ") == 5
    fallen = call(*files, "--gate", "bad2<3,average_%<0.5,A90_px<=0.001")
    assert fallen.exit_code == 1
    last = fallen.stderr.splitlines()[-1]
    assert last.startswith("GateError: average_%<0.5: found 0.7")
    assert "A90_px<=0.001: found " in last
    assert "bad2" not in last
    told = json.loads(call(*files, "--gate", "average_%<0.5", "--json").stdout)
    assert [g["holds"] for g in told["gates"]] == [False]
    for gate, words in (
        ("bda2<3", ("'bda2'", "did you mean 'bad2'")),
        ("bad2@nere_edges<3", ("'nere_edges'", "did you mean 'near_edges'")),
        ("bad2=3", ("'bad2=3'", "is no condition")),
    ):
        refused(*files, "--gate", gate, words=words, kind="ShotError")
    refused(*files[:5], "--gate", "bad2<3", words=("'bad2'", "--rig"), kind="ShotError")


def test_the_page_holds_all_and_fetches_nothing(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    files = ("compare", folder / "result.exr", folder / "truth.exr", "--what", "depth", "--rig", folder / "rig.json", "--out", page)
    assert call(*files, "--gate", "average_%<0.0001").exit_code == 1
    text = page.read_text()
    assert not re.search(r"(src|href)=\"(?!data:)|url\(|https?://", text.replace("http://www.w3.org", ""))
    assert text.count('class="blink"') == 1
    assert text.count("data:image/png;base64,") == 4  # two that blink, two maps
    for words in ("nonoccluded", "near_edges", "does not hold", "confidence", "share of the pixels within an error", "3-5m"):
        assert words in text, words
    assert "Run by run" not in text
    assert "exists already" in call(*files).stderr
    assert call(*files, "--force").exit_code == 0
    assert "Run by run" in page.read_text()
    runs = json.loads(page.with_suffix(".history.json").read_text())["runs"]
    assert len(runs) == 2
    assert runs[0]["figures"]["bad2"] == runs[1]["figures"]["bad2"]
    page.with_suffix(".history.json").write_text("{}")
    refused(*files, "--force", words=("report.history.json", "no history"), kind="OutputError")


@pytest.fixture(scope="module")
def shots(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """r.1001-1005.exr against t.1001-1004.exr and 1006; frame 1003 is off by 20 %."""
    out = tmp_path_factory.mktemp("shots")
    result = read_frame(folder / "result.exr")
    for number in range(1001, 1006):
        off = np.float32(1.2 if number == 1003 else 1)
        write_frame(out / f"r.{number}.exr", replace(result, passes={**result.passes, "Z": result["Z"] * off}, number=number))
    for number in (1001, 1002, 1003, 1004, 1006):
        shutil.copy(folder / "truth.exr", out / f"t.{number}.exr")
    return out


def test_a_sequence_names_its_worst_frames(folder: Path, shots: Path, tmp_path: Path) -> None:
    files = ("compare", shots / "r.####.exr", shots / "t.####.exr", "--what", "depth")
    found = answer(*files, "--out", tmp_path / "r.html")["depth"]
    assert found["worst_frames"][0] == 1003
    assert [f["frame"] for f in found["frames"]] == [1001, 1002, 1003, 1004]
    notes = " ".join(found["notes"])
    assert "frames 1005 are in the result alone" in notes
    assert "the worst by bad5%: 1003 (" in notes
    one = answer("compare", folder / "result.exr", folder / "truth.exr", "--what", "depth")["depth"]["percent"]["all"]
    frames = {f["frame"]: f["average_%"] for f in found["frames"]}
    assert frames[1001] == pytest.approx(one["average_percent"])
    assert found["percent"]["all"]["average_percent"] == pytest.approx(np.mean(list(frames.values())))
    assert found["percent"]["all"]["pixels"] == 4 * one["pixels"]
    assert "frame by frame" in (tmp_path / "r.html").read_text()
    assert call(*files, "--frames", "1001-1002", "--gate", "bad5%@worst_frame<5").exit_code == 0
    assert call(*files, "--gate", "bad5%@worst_frame<5").exit_code == 1
    refused(*files, "--frames", "1003-1005", words=("t.1005.exr", "frame missing"), kind="PlateError")
    (shots / "u.0001.exr").write_bytes((folder / "truth.exr").read_bytes())
    refused("compare", shots / "r.####.exr", shots / "u.####.exr", "--what", "depth", words=("no frame in common", "1001-1005"), kind="PlateError")
    refused("compare", shots / "r.####.exr", folder / "truth.exr", "--what", "depth", words=("single file",), kind="PlateError")
    other = answer("compare", shots / "r.1002.exr", folder / "truth.exr", "--what", "depth")["depth"]
    assert other["notes"] == ["by their headers the result is frame 1002 and the truth frame 0: are they of one moment?"]


def test_flicker_of_a_shot(shots: Path, folder: Path, tmp_path: Path) -> None:
    """A still scene: 1003 jumps by 20 % and back, and the plate alone says that nothing moves."""
    plate = render(scene_named("interior"), RIG, samples=1).left["plate"]
    for number in range(1001, 1006):
        write_frame(tmp_path / f"p.{number}.exr", Frame(passes={"plate": plate}))
    files = ("compare", shots / "r.####.exr", "--what", "flicker", "--plate", tmp_path / "p.####.exr")
    found = answer(*files, "--out", tmp_path / "f.html")["flicker"]
    assert found["pairs"] == 4
    assert set(found["worst_frames"][:2]) == {1003, 1004}
    steps = {f["frame"]: f for f in found["frames"]}
    assert steps[1002]["Z_rms"] == 0
    assert steps[1003]["Z_median"] == pytest.approx(20, abs=0.1)
    assert steps[1004]["Z_median"] == pytest.approx(100 / 6, abs=0.1)
    assert found["N"]["rms_deg"] == pytest.approx(0, abs=1e-3)
    assert call(*files, "--frames", "1001-1002", "--gate", "Z_rms<0.1,N_median<0.1").exit_code == 0
    assert call(*files, "--gate", "Z_rms<0.1").exit_code == 1
    assert "From frame" in (tmp_path / "f.html").read_text()
    refused(*files[:4], words=("nothing tells the motion", "--plate"))
    for number in range(1001, 1004):
        write_frame(tmp_path / f"b.{number}.exr", Frame(passes={"beauty": plate * np.float32(1.1 if number == 1002 else 1)}), half=False)
    relit = answer("compare", tmp_path / "b.####.exr", "--what", "flicker", "--plate", tmp_path / "p.####.exr", "--frames", "1001-1003")["flicker"]
    assert [f["picture_rms"] > 5 for f in relit["frames"]] == [True, True]
    assert relit["plate"]["rms_percent"] == pytest.approx(0, abs=1e-3)
    refused("compare", folder / "result.exr", "--what", "flicker", words=("single file", "pattern"), kind="PlateError")
    refused(*files, "--frames", "1001,1003", words=("no two frames in a row",), kind="PlateError")


def test_passes_of_a_renderers_file(folder: Path, true: dict[str, Any], tmp_path: Path) -> None:
    """P beside the depth tells what the depth is; N beside it tells the ray from the axis; alone, it is asked or taken as Z, and said."""
    out = ("--out", tmp_path / "o.exr", "--force", "--rig", folder / "rig.json")

    def made(write: Callable[[Path], str], *options: object) -> tuple[Any, str]:
        told = answer("passes", folder / write(folder), *out, *options)["frames"][0]
        return read_frame(tmp_path / "o.exr")["Z"], told.get("depth_is", "")

    Z, words = made(exr({"Z": length(true), **layer("P", true["P"] * (1, -1, -1), "XYZ")}))
    assert "ray length in m" in words
    np.testing.assert_allclose(Z, true["Z"], rtol=1e-4)
    Z, words = made(exr({"Z": length(true), **layer("N", (true["N"] + 1) / 2, "RGB")}))
    assert "the depth is ray length: " in words
    np.testing.assert_allclose(Z, true["Z"], rtol=1e-4)
    Z, words = made(exr({"Z": 100 * true["Z"]}), "--unit", "cm")
    np.testing.assert_allclose(Z, true["Z"], rtol=1e-4)
    Z, words = made(pfm(true["Z"]))
    assert "nothing in the file tells otherwise" in words
    Z, words = made(png(np.rint(65535 * (true["Z"] - 0.1) / 9.9).astype(np.uint16)), "--depth-is", "normalised", "--near", 0.1, "--far", 10)
    np.testing.assert_allclose(Z, true["Z"], rtol=2e-3)
    refused("passes", folder / png(np.rint(1000 * true["Z"]).astype(np.uint16))(folder), *out, words=("foreign.png", "--unit"))


def test_relight_takes_a_renderers_passes(folder: Path, true: dict[str, Any], tmp_path: Path) -> None:
    plate = np.full((SIZE[1], SIZE[0], 3), 0.2, np.float32)
    write_frame(tmp_path / "plate.exr", Frame(passes={"plate": plate}))
    lights = tmp_path / "lights.toml"
    lights.write_text('[[lights]]\nname = "a"\ntype = "point"\nposition_m = [0.5, 0.5, -0.5]\nintensity = 2\n')

    def lit(passes: Path, *options: object) -> Any:
        answer("relight", tmp_path / "plate.exr", passes, "--lights", lights, "--out", tmp_path / "o.exr", "--force", "--colour", "float", *options)
        return read_frame(tmp_path / "o.exr")["beauty"]

    wanted = lit(folder / "truth.exr")
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    channels = {**layer("P", 100 * (true["P"] @ turn.T + (1, 2, 3)), "XYZ"), **layer("N", (true["N"] @ turn.T + 1) / 2, "RGB")}
    found = lit(folder / exr(channels)(folder), "--rig", folder / "rig.json", "--unit", "cm")
    known = np.isfinite(wanted)
    np.testing.assert_allclose(found[known], wanted[known], atol=2e-3)
    arguments = ("relight", tmp_path / "plate.exr", folder / "foreign.exr", "--lights", lights, "--out", tmp_path / "x.exr")
    refused(*arguments, words=("foreign.exr", "not in the scene frame", "coded 0..1", "--fov-deg or --rig"))
    assert not (tmp_path / "x.exr").exists()


def test_pfm_there_and_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for shape in ((3, 5), (4, 2, 3)):
        a = rng.standard_normal(shape).astype(np.float32)
        a[0, 0] = np.inf
        write_pfm(tmp_path / "a.pfm", a, force=True)
        np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), a)
    big = b"Pf\n2 2\n1.0\n" + np.array([3, 4, 1, 2], ">f4").tobytes()
    (tmp_path / "b.pfm").write_bytes(big)
    np.testing.assert_array_equal(read_pfm(tmp_path / "b.pfm"), [[1, 2], [3, 4]])  # the bottom row comes first
