"""A run does what changed and nothing else, goes on where it stopped, and leaves whole files and a receipt."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stereorelight.errors import OutputError, PlateError
from stereorelight.footage.frames import read_frame
from stereorelight.footage.plates import read_plate
from stereorelight.footage.stills import read_still, write_still
from stereorelight.interchange.rigs import read_rig, write_rig
from stereorelight.shot import frame, job, steps
from stereorelight.shot.frame import Event
from stereorelight.shot.run import run_shot
from stereorelight.shot.synthetic import write_shot

SIZE = (160, 90)
ALL = ["depth", "passes", "relight", "previews", "relit previews"]
HALF = 2**-11  # relative, what a half may be off by


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A shot that has been run once; tests copy it."""
    folder = tmp_path_factory.mktemp("still") / "shot"
    write_shot(folder, "sphere", size=SIZE, samples=1)
    run_shot(folder / "shot.toml")
    return folder


@pytest.fixture
def shot(still: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(still, tmp_path / "shot"))


def done(path: Path, **settings: object) -> list[str]:
    """The steps that a run does."""
    events: list[Event] = []
    run_shot(path, on_event=events.append, **settings)  # type: ignore[arg-type]
    return [event.step for event in events if event.state == "done"]


def contents(folder: Path) -> dict[str, bytes]:
    """Every result by name; receipts hold seconds, and are left out."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix != ".json"}


def times(folder: Path) -> dict[Path, int]:
    return {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_run_leaves_every_layer(still: Path) -> None:
    out = still / "out"
    depth, surface, relit = (read_frame(out / kind / "sphere.exr") for kind in ("depth", "passes", "relit"))
    assert set(depth) == {"Z", "confidence", "flags", "disparity_sigma", "Z_sigma"}
    assert set(surface) == {"Z", "P", "N", "N_sigma", "Z_sigma"}
    assert set(relit) == {"beauty", "light_key_diffuse", "light_key_specular", "light_fill_diffuse"}
    assert np.array_equal(depth["Z"], surface["Z"], equal_nan=True)
    assert depth.camera is not None
    assert depth.camera.size == SIZE
    pictures = {p.name for p in (out / "previews").iterdir()}
    names = ["plate", "depth", "confidence", "flags", "P", "N", "light_key", "light_fill", "relit", "before_after", "contact"]
    assert pictures == {f"sphere.{name}.png" for name in names}


def test_beauty_is_plate_and_layers(still: Path) -> None:
    relit = read_frame(still / "out" / "relit" / "sphere.exr")
    plate = read_plate(still / "plates" / "left.png")
    total = 0.15 * plate + sum(relit[name] for name in relit if name != "beauty")
    # Every layer and the beauty are halves on disk.
    np.testing.assert_allclose(relit["beauty"], total, rtol=4 * HALF, atol=1e-5)


def test_depth_is_near_the_truth(still: Path) -> None:
    Z, true = read_frame(still / "out" / "depth" / "sphere.exr")["Z"], read_frame(still / "truth" / "sphere.exr")["Z"]
    assert np.isfinite(Z).mean() > 0.99
    assert np.nanmedian(np.abs(Z - true) / true) < 0.06  # a third of a pixel of disparity at 160 pixels


def test_running_again_does_nothing(shot: Path) -> None:
    assert done(shot / "shot.toml") == []
    before = times(shot)
    assert done(shot / "shot.toml") == []
    assert times(shot) == before


def test_a_light_redoes_light_alone(shot: Path) -> None:
    before = contents(shot / "out")
    edit(shot / "shot.toml", "intensity = 5.0", "intensity = 3.0")
    assert done(shot / "shot.toml") == ["relight", "relit previews"]
    after = contents(shot / "out")
    same = {name for name in before if before[name] == after[name]}
    assert "relit/sphere.exr" not in same
    assert {"depth/sphere.exr", "passes/sphere.exr", "previews/sphere.depth.png", "previews/sphere.light_fill.png"} <= same


@pytest.mark.parametrize(
    ("old", "new", "steps_done"),
    [
        ('method = "plane"', 'method = "difference"', ["passes", "relight", "previews", "relit previews"]),
        ("plate_gain = 0.15", "plate_gain = 0.25", ["relight", "relit previews"]),
        ('quality = "standard"', 'quality = "draft"', ALL),
        ('colour = "half"', 'colour = "float"', ["relight", "relit previews"]),
        ("# preview_near_m = 1.0", "preview_near_m = 1.0", ["previews", "relit previews"]),
        ("previews = true", "previews = false", []),
        ("# As many lights", "# So many lights", []),
    ],
)
def test_what_changed_is_done(shot: Path, old: str, new: str, steps_done: list[str]) -> None:
    edit(shot / "shot.toml", old, new)
    assert done(shot / "shot.toml") == steps_done
    assert done(shot / "shot.toml") == []


@pytest.mark.parametrize("eye", ["left", "right"])
def test_another_plate_redoes_everything(shot: Path, eye: str) -> None:
    path = shot / "plates" / f"{eye}.png"
    write_still(path, read_still(path).rgb * 0.9, bits=16, force=True)
    assert done(shot / "shot.toml") == ALL


def test_another_rig_redoes_everything_but_its_quality_does_not(shot: Path) -> None:
    rig = read_rig(shot / "rig.json")
    write_rig(shot / "rig.json", replace(rig, quality={"note": "as before"}), force=True)
    assert done(shot / "shot.toml") == []
    write_rig(shot / "rig.json", replace(rig, t_right_left_m=rig.t_right_left_m * 1.01), force=True)
    assert done(shot / "shot.toml") == ALL


def test_a_lost_or_cut_result_is_made_again(shot: Path) -> None:
    before = contents(shot / "out")
    (shot / "out" / "passes" / "sphere.exr").unlink()
    (shot / "out" / "previews" / "sphere.relit.png").write_bytes(b"cut")
    assert done(shot / "shot.toml") == ["passes", "relit previews"]
    assert contents(shot / "out") == before


def test_a_damaged_receipt_counts_as_none(shot: Path) -> None:
    (shot / "out" / "receipts" / "sphere.json").write_text("{")
    with pytest.raises(OutputError, match="was not written by a run of this shot"):
        done(shot / "shot.toml")
    assert done(shot / "shot.toml", force=True) == ALL


def test_force_redoes_all_to_the_same_bits(shot: Path) -> None:
    before = contents(shot / "out")
    assert done(shot / "shot.toml", force=True) == ALL
    assert contents(shot / "out") == before


def test_a_renamed_light_takes_its_preview_along(shot: Path) -> None:
    edit(shot / "shot.toml", 'name = "fill"', 'name = "sky"')
    done(shot / "shot.toml")
    assert not (shot / "out" / "previews" / "sphere.light_fill.png").exists()
    assert (shot / "out" / "previews" / "sphere.light_sky.png").exists()


@pytest.mark.parametrize("broken", ["write_frame", "write_still", "relight_figures", "relit_pictures"])
def test_a_stopped_run_goes_on_to_the_same_files(shot: Path, monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    whole = contents(shot / "out")
    shutil.rmtree(shot / "out")
    home = job if broken == "write_frame" else steps
    real, calls = getattr(home, broken), []

    def stops(*args: object, **settings: object) -> object:
        calls.append(args)
        if len(calls) == (1 if broken.startswith("rel") else 2):
            raise KeyboardInterrupt
        return real(*args, **settings)

    with monkeypatch.context() as patch:
        patch.setattr(home, broken, stops)
        with pytest.raises(KeyboardInterrupt):
            run_shot(shot / "shot.toml")
    partial = contents(shot / "out")
    assert set(partial) < set(whole)
    assert all(whole[name] == data for name, data in partial.items())
    again = done(shot / "shot.toml")
    assert 0 < len(again) < len(ALL)
    assert contents(shot / "out") == whole


def test_what_somebody_else_wrote_is_not_replaced(shot: Path) -> None:
    shutil.rmtree(shot / "out")
    foreign = shot / "out" / "passes" / "sphere.exr"
    foreign.parent.mkdir(parents=True)
    foreign.write_bytes(b"mine")
    with pytest.raises(OutputError, match="was not written by a run"):
        run_shot(shot / "shot.toml")
    assert foreign.read_bytes() == b"mine"
    assert done(shot / "shot.toml", force=True) == ALL


def test_the_receipt_says_what_was_done(still: Path) -> None:
    receipt = json.loads((still / "out" / "receipts" / "sphere.json").read_text())
    assert set(receipt["inputs"]) == {"left", "right", "rig"}
    assert all(len(entry["sha256"]) == 64 for entry in receipt["inputs"].values())
    assert receipt["settings"]["depth"]["quality"] == "standard"
    assert receipt["versions"]["stereorelight"]
    assert list(receipt["steps"]) == ALL
    assert receipt["steps"]["depth"]["figures"]["cover_percent"] > 99
    for entry in receipt["steps"].values():
        assert all((still / "out" / name).stat().st_size == size for name, size in entry["files"].items())


def test_code_is_part_of_the_key(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = frame.code_digest
    monkeypatch.setattr(frame, "code_digest", lambda *rooms: real(*rooms) + ("new" if "light" in rooms else ""))
    assert done(shot / "shot.toml") == ["relight", "relit previews"]


def test_a_sequence_runs_by_frame_and_does_not_pump(tmp_path: Path) -> None:
    write_shot(tmp_path, "sphere", size=SIZE, samples=1, frames=3)
    shot = tmp_path / "shot.toml"
    first = run_shot(shot, frames="1002-1002")
    assert first.frames == ("1002",)
    noted = json.loads((tmp_path / "out" / "run.json").read_text())["preview_range"]
    whole = run_shot(shot)
    assert (whole.done, whole.stood) == (2 * len(ALL), len(ALL))
    assert json.loads((tmp_path / "out" / "run.json").read_text())["preview_range"] == noted
    assert {p.name for p in (tmp_path / "out" / "depth").iterdir()} == {f"sphere.{n}.exr" for n in (1001, 1002, 1003)}
    assert (tmp_path / "out" / "previews" / "sphere.relit.1003.png").exists()
    before = contents(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    shared = run_shot(shot, workers=2)
    assert shared.frames == whole.frames
    assert shared.figures.keys() == whole.figures.keys()
    assert contents(tmp_path / "out")["depth/sphere.1003.exr"] == before["depth/sphere.1003.exr"]
    shutil.rmtree(tmp_path / "out")
    run_shot(shot, frames="1002-1002")
    run_shot(shot)
    assert contents(tmp_path / "out") == before
    (tmp_path / "plates" / "right.1003.png").unlink()
    with pytest.raises(PlateError, match=r"right\.1003\.png: frame missing"):
        run_shot(shot)
    assert run_shot(shot, frames="1001-1002").done == 2 * len(ALL)  # 1003 no longer speaks for them
    assert run_shot(shot, frames="1001-1002").done == 0


def test_a_mirrored_left_eye_is_relit_on_the_upright_plate(tmp_path: Path) -> None:
    """The same scene through a mirror gives the same result as without: everything lies on the flipped-back plate."""
    write_shot(tmp_path, "sphere", size=SIZE, samples=1)
    run_shot(tmp_path / "shot.toml")
    plain = read_frame(tmp_path / "out" / "relit" / "sphere.exr")["beauty"]
    left = tmp_path / "plates" / "left.png"
    write_still(left, read_still(left).rgb[:, ::-1], bits=16, force=True)
    write_rig(tmp_path / "rig.json", replace(read_rig(tmp_path / "rig.json"), mirrored="left"), force=True)
    run_shot(tmp_path / "shot.toml")
    assert np.array_equal(read_frame(tmp_path / "out" / "relit" / "sphere.exr")["beauty"], plain)
    assert read_frame(tmp_path / "out" / "passes" / "sphere.exr").metadata["plate_flipped_back"] == "yes"
