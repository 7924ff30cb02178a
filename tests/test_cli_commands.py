"""The commands: what they write, what they print, and that each step by hand gives what a run gives."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import click.testing
import numpy as np
import pytest
import rich.console

from stereorelight import __version__
from stereorelight.cli import main, progress
from stereorelight.cli.group import COMMANDS
from stereorelight.footage.exr import write_exr
from stereorelight.footage.frames import read_frame
from stereorelight.footage.stills import read_still
from stereorelight.interchange.rigs import read_rig
from stereorelight.shot.demo import LIGHTS, write_demo
from stereorelight.shot.synthetic import write_shot
from stereorelight.stereo.rectify import rectification

SIZE = (160, 90)
PROGRAM = [sys.executable, "-c", "import sys; sys.argv[0] = 'stereorelight'; from stereorelight.cli import main; main()"]

LISTED = """
import sys
before = set(sys.modules)
from stereorelight.cli import main
try:
    main(["--help"], prog_name="stereorelight")
finally:
    ours = {name.partition(".")[0] for name in set(sys.modules) - before}
    print("\\nread:", *(ours - set(sys.stdlib_module_names)))
"""


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "a [b] shot"
    write_shot(folder, "sphere", size=SIZE, samples=1)
    assert call("run", folder / "shot.toml").exit_code == 0
    return folder


def call(*arguments: object) -> click.testing.Result:
    return click.testing.CliRunner().invoke(main, [str(a) for a in arguments])


def answer(*arguments: object) -> dict[str, object]:
    """The JSON object that a command prints, which must be all that it prints."""
    result = call(*arguments, "--json")
    assert result.exit_code == 0, result.output
    assert len(result.stdout.splitlines()) == 1 or arguments[0] == "compare"
    found: dict[str, object] = json.loads(result.stdout)
    return found


def depth(shot: Path, out: Path, *extra: object) -> tuple[object, ...]:
    plates = shot / "plates"
    return ("depth", plates / "left.png", plates / "right.png", "--rig", shot / "rig.json", "--out", out, *extra)


def test_help_is_quick() -> None:
    """Nothing but click and Python's own library is read for it: a tenth of a second, whatever else the machine does."""
    result = subprocess.run([*PROGRAM[:-1], LISTED], check=True, capture_output=True, text=True)
    out, _, read = result.stdout.partition("\nread: ")
    assert [line.split()[0] for line in out.partition("Commands:\n")[2].splitlines()] == list(COMMANDS)
    # What a virtual environment reads at its start, before anything of ours, does not count.
    assert set(read.split()) - {"stereorelight", "click"} == set()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str) -> None:
    result = call(name, "--help")
    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) > 5


def test_version() -> None:
    assert call("--version").stdout == f"stereorelight, version {__version__}\n"


def test_by_hand_gives_what_a_run_gives(shot: Path, tmp_path: Path) -> None:
    z, p, lit, png = (tmp_path / name for name in ("z.exr", "p.exr", "lit.exr", "lit.png"))
    lights = tmp_path / "lights.toml"
    text = (shot / "shot.toml").read_text()
    lights.write_text(text[text.index("[[lights]]") :])
    assert call(*depth(shot, z)).exit_code == 0
    assert call("passes", z, "--out", p).exit_code == 0
    made = ("relight", shot / "plates" / "left.png", p, "--lights", lights, "--plate-gain", 0.5, "--out", lit, "--preview", png)
    assert call(*made).exit_code == 0
    for kind, file in (("depth", z), ("passes", p), ("relit", lit)):
        by_run, by_hand = read_frame(shot / "out" / kind / "sphere.exr"), read_frame(file)
        assert set(by_run) == set(by_hand)
        if kind != "relit":
            assert all(np.array_equal(by_run[name], by_hand[name], equal_nan=True) for name in by_run)
    assert read_still(png).rgb.shape == (SIZE[1], SIZE[0], 3)


def test_a_fade_is_shown_beside_the_preview(shot: Path, tmp_path: Path) -> None:
    """Where depth is doubted the picture of trust is darker; without a fade there is none."""
    (tmp_path / "lights.toml").write_text('[[lights]]\nname = "a"\ntype = "point"\nposition_m = [0, 0, 0]\n')
    made = ("relight", shot / "plates" / "left.png", next((shot / "out" / "passes").iterdir()), "--lights", tmp_path / "lights.toml")
    for name, fade in (("plain", 0), ("faded", 1)):
        result = call(*made, "--fade", fade, "--out", tmp_path / f"{name}.exr", "--preview", tmp_path / f"{name}.png")
        assert result.exit_code == 0, result.output
    assert not (tmp_path / "plain.trust.png").exists()
    shown, kept = read_still(tmp_path / "faded.trust.png").rgb, read_frame(tmp_path / "faded.exr")["matte_trust"]
    assert shown.shape[:2] == kept.shape
    assert kept.min() < 0.5 < kept.max()
    assert np.corrcoef(shown.mean(axis=-1).ravel(), kept.ravel())[0, 1] > 0.7


def test_depth_of_the_right_eye(shot: Path, tmp_path: Path) -> None:
    """The right eye's depth lies on the right plate: it agrees with the left eye's one where that lands."""
    found = answer(*depth(shot, tmp_path / "z.exr", "--eye", "right"))
    frame = read_frame(tmp_path / "z.exr")
    assert frame.eye == "right"
    assert found["frames"][0]["cover_percent"] > 99  # type: ignore[index]
    left = read_frame(shot / "truth" / "sphere.exr")["Z"]
    assert abs(np.nanmedian(frame["Z"]) / np.nanmedian(left) - 1) < 0.05


def test_depth_of_both_eyes_is_what_each_alone_gives(shot: Path, tmp_path: Path) -> None:
    found = answer(*depth(shot, tmp_path / "z.%V.exr", "--eye", "both"))
    assert [one["eye"] for one in found["frames"]] == ["left", "right"]  # type: ignore[union-attr, index]
    for eye in ("left", "right"):
        answer(*depth(shot, tmp_path / f"alone.{eye}.exr", "--eye", eye))
        both, alone = read_frame(tmp_path / f"z.{eye}.exr"), read_frame(tmp_path / f"alone.{eye}.exr")
        assert both.eye == eye
        assert all(np.array_equal(both[name], alone[name], equal_nan=True) for name in alone)
    refused = call(*depth(shot, tmp_path / "one.exr", "--eye", "both"))
    assert refused.exit_code == 1
    assert "give %V for the eye" in refused.stderr


def test_passes_of_a_renderers_depth(shot: Path, tmp_path: Path) -> None:
    """A distance along the ray, in centimetres, in a channel of another name, with 1e10 for nothing, gives the true P."""
    truth = read_frame(shot / "truth" / "sphere.exr")
    assert truth.camera is not None
    slopes = truth.camera.ray_grid().astype(np.float64)
    distance = truth["Z"] * np.sqrt(1 + (slopes**2).sum(axis=-1)) * 100
    distance[:10] = 1e10
    write_exr(tmp_path / "render.exr", {"depth.V": distance})
    made = ("passes", tmp_path / "render.exr", "--layer", "depth.V", "--unit", "cm", "--ray-length", "--rig", shot / "rig.json")
    found = answer(*made, "--out", tmp_path / "p.exr")
    frame = read_frame(tmp_path / "p.exr")
    assert np.isnan(frame["P"][:10]).all()
    np.testing.assert_allclose(frame["P"][10:], truth["P"][10:], atol=1e-5)
    assert found["frames"][0]["P_cover_percent"] == pytest.approx(100 * 80 / 90, abs=0.01)  # type: ignore[index]
    assert call("passes", tmp_path / "render.exr", "--fov-deg", 40, "--unit", "cm", "--out", tmp_path / "q.exr").exit_code == 0


def test_rectified_plates_need_no_rectification(tmp_path: Path) -> None:
    folder = tmp_path / "hard"
    write_shot(folder, "sphere", size=SIZE, samples=1, rig="hard")
    plates = folder / "plates"
    made = ("rectify", plates / "left.png", plates / "right.png", "--rig", folder / "rig.json", "--out", tmp_path / "flat")
    found = answer(*made)
    rig = read_rig(tmp_path / "flat" / "rig.json")
    again = rectification(rig)
    assert list(rig.left.size) == found["size"]
    np.testing.assert_allclose(again.original_from_rectified("left"), rig.left.pixel_grid(), atol=1e-3)
    pictures = [read_frame(tmp_path / "flat" / f"{eye}.exr")["plate"] for eye in ("left", "right")]
    assert pictures[0].shape == (rig.left.size[1], rig.left.size[0], 3)
    assert np.isfinite(pictures[0]).mean() > 0.8
    assert call(*made).exit_code == 1


@pytest.mark.parametrize("what", ["depth", "normals"])
def test_compare_with_itself_is_perfect(shot: Path, what: str) -> None:
    truth = shot / "truth" / "sphere.exr"
    found = answer("compare", truth, truth, "--what", what)
    figures = found[what]
    assert isinstance(figures, dict)
    if what == "depth":
        assert figures["metres"]["all"]["average_m"] == 0
        assert "nonoccluded" in figures["metres"]
    else:
        assert figures["median_deg"] < 1e-3


def test_compare_prints_a_table(shot: Path) -> None:
    result = call("compare", shot / "out" / "depth" / "sphere.exr", shot / "truth" / "sphere.exr", "--what", "depth", "--rig", shot / "rig.json")
    assert result.exit_code == 0
    assert "bad2" in result.stdout
    assert "cover" in result.stdout


def test_synth_makes_what_run_takes(tmp_path: Path) -> None:
    found = answer("synth", "plane", "--out", tmp_path / "s", "--size", "96x64", "--rig", "mirrored", "--samples", 1, "--frames", 2)
    assert Path(str(found["shot"])).exists()
    done = answer("run", tmp_path / "s" / "shot.toml")
    assert done["frames"] == ["1001", "1002"]
    assert done["steps_stood"] == 0
    compared = answer("compare", tmp_path / "s/out/depth/plane.1002.exr", tmp_path / "s/truth/plane.1002.exr", "--what", "depth")
    assert compared["depth"]["metres"]["flat"]["A50_m"] < 0.1  # type: ignore[index]


def test_a_sequence_by_hand(tmp_path: Path) -> None:
    write_shot(tmp_path, "plane", size=(96, 64), samples=1, frames=3)
    plates = tmp_path / "plates"
    found = answer(
        *("depth", plates / "left.%04d.png", plates / "right.####.png", "--rig", tmp_path / "rig.json"),
        *("--frames", "1002-1003", "--out", tmp_path / "z" / "z.####.exr"),
    )
    assert [frame["frame"] for frame in found["frames"]] == [1002, 1003]  # type: ignore[attr-defined]
    assert sorted(p.name for p in (tmp_path / "z").iterdir()) == ["z.1002.exr", "z.1003.exr"]
    assert answer("passes", tmp_path / "z" / "z.####.exr", "--out", tmp_path / "p.####.exr")["frames"]


def test_a_demo_keeps_what_the_user_edited(tmp_path: Path) -> None:
    files = write_demo(tmp_path / "demo")
    assert files.new
    files.shot.write_text(files.shot.read_text().replace("intensity = 0.3", "intensity = 0.35"))
    again = write_demo(tmp_path / "demo")
    assert not again.new
    assert "intensity = 0.35" in files.shot.read_text()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "letter.txt").write_text("mine")
    result = call("demo", "--out", tmp_path / "other")
    assert result.exit_code == 1
    assert "something else than a demo" in result.stderr
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["letter.txt"]


def test_a_bar_shows_file_names_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """rich takes [brackets] for markup; a file name may hold them.  Nothing is shown of what is over in a second."""
    shown = io.StringIO()
    real = rich.console.Console
    monkeypatch.setattr(rich.console, "Console", lambda **_: real(file=shown, force_terminal=True, width=100))
    with progress.Bar("[red]a[/nope].toml", total=2) as bar:
        bar.note("1001", advance=1)
    assert shown.getvalue() == ""
    monkeypatch.setattr(progress, "PATIENCE_S", 0.0)
    with progress.Bar("[red]a[/nope].toml", total=2) as bar:
        bar._timer.join()
        bar.note("[b]1001", advance=1)
    assert "[red]a[/nope].toml" in shown.getvalue()
    assert "[b]1001" in shown.getvalue()


@pytest.mark.slow
def test_the_demo_from_end_to_end(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    found = answer("demo", "--out", folder)
    figures = found["figures"]
    assert isinstance(figures, dict)
    assert figures["cover_percent"] == 100
    assert figures["bad2_percent"] <= 3.5
    assert figures["bad0.5_percent"] <= 12
    assert figures["normals_median_deg"] <= 11
    out = folder / "out"
    relit, surface = read_frame(out / "relit" / "motorcycle.exr"), read_frame(out / "passes" / "motorcycle.exr")
    names = [f"light_{light['name']}_diffuse" for light in LIGHTS] + [f"light_{light['name']}_specular" for light in LIGHTS if "specular" in light]
    assert set(relit) == {"beauty", *names}
    assert all(np.isfinite(relit[name]).all() for name in relit)
    assert all(np.isfinite(surface[name]).all() for name in ("Z", "P", "N"))
    pictures = [
        "plate",
        "depth",
        "confidence",
        "flags",
        "P",
        "N",
        *(f"light_{light['name']}" for light in LIGHTS),
        "relit",
        "before_after",
        "contact",
    ]
    assert {p.name for p in (out / "previews").iterdir()} == {f"motorcycle.{name}.png" for name in pictures}
    # Again: nothing is done, and no result is touched.
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.*") if p.name != "figures.json"}
    assert answer("demo", "--out", folder)["run"]["steps_done"] == 0  # type: ignore[index]
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*.*") if p.name != "figures.json"} == before
    # A light moves: light alone is done.
    text = (folder / "shot.toml").read_text()
    (folder / "shot.toml").write_text(text.replace("azimuth_deg = 100.0", "azimuth_deg = 90.0"))
    assert answer("run", folder / "shot.toml")["steps_done"] == 2
    # The figures can be had from the files alone.
    compared = answer(
        "compare", out / "depth" / "motorcycle.exr", folder / "truth" / "motorcycle.exr", "--what", "depth", "--rig", folder / "rig.json"
    )
    bad = compared["depth"]["disparity"]["nonoccluded"]["bad2_percent"]  # type: ignore[index]
    assert bad == pytest.approx(figures["bad2_percent"], abs=0.05)
