"""The surface as PLY from the command line: one eye's triangles, closed behind, both eyes brought together; and what passes files tell shadows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from stereorelight.cli import main
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Frame
from stereorelight.surface.position import position_from_depth
from stereorelight.synth.rigs import parallel_rig

SIZE = (48, 32)
RIG = parallel_rig(SIZE)
V, U = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]


def seen(eye: str, sigma: float | None = None) -> Frame:
    """A card of 16 x 12 pixels at 1 m before a wall at 2 m, as either eye sees it."""
    shift = 0.0 if eye == "left" else RIG.left.fx * RIG.baseline_m
    on = (abs(U + shift - 24) <= 8) & (abs(V - 16) <= 6)
    Z = np.where(on, np.float32(1), np.float32(2))
    N = np.zeros((*Z.shape, 3), np.float32)
    N[..., 2] = 1
    camera = RIG.camera(eye)  # type: ignore[arg-type]
    passes = {"Z": Z, "P": position_from_depth(Z, camera), "N": N}
    if sigma is not None:
        passes["Z_sigma"] = np.full_like(Z, sigma)
    return Frame(passes=passes, camera=camera, eye=eye)  # type: ignore[arg-type]


def called(*words: str) -> Result:
    return CliRunner().invoke(main, list(words))


def read_ply(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The points' properties by name, and the triangles (n, 3), of a binary file."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    kinds = {"float": "<f4", "uchar": "u1", "int": "<i4"}
    fields: list[tuple[str, str]] = []
    counts = {"vertex": 0, "face": 0}
    element = ""
    for words in (line.split() for line in head.decode().splitlines()):
        if words[0] == "element":
            element, counts[words[1]] = words[1], int(words[2])
        elif words[0] == "property" and element == "vertex":
            fields.append((words[2], kinds[words[1]]))
    points = np.frombuffer(body, np.dtype(fields), counts["vertex"])
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("at", "<i4", 3)]), counts["face"], offset=points.nbytes)
    assert (faces["n"] == 3).all()
    return {name: points[name] for name, _ in fields}, faces["at"]


@pytest.fixture
def files(tmp_path: Path) -> Path:
    for eye in ("left", "right"):
        write_frame(tmp_path / f"{eye}.exr", seen(eye, 0.002))
    write_rig(tmp_path / "rig.json", RIG)
    return tmp_path


def test_a_closed_surface_goes_on_behind(files: Path) -> None:
    told = {}
    for name, more in (("sheet", ()), ("closed", ("--thickness", "80"))):
        result = called("export", str(files / "left.exr"), "--to", "ply", "--out", str(files / f"{name}.ply"), *more, "--json")
        assert result.exit_code == 0, result.output
        told[name] = json.loads(result.output)["files"][0]
    sheet, faces = read_ply(files / "sheet.ply")
    closed, more_faces = read_ply(files / "closed.ply")
    assert told["sheet"]["triangles"] == len(faces)
    assert len(closed["x"]) == 2 * len(sheet["x"])
    assert len(more_faces) > 2 * len(faces), "front, back, and walls between them"
    assert set(np.round(1000 * -sheet["z"])) == {1000, 2000}
    assert set(np.round(1000 * -closed["z"])) == {1000, 1080, 2000, 2080}
    behind = np.isin(np.round(1000 * -closed["z"]), (1080, 2080))
    assert (closed["nz"][behind] == -1).all()
    assert (closed["nz"][~behind] == 1).all()
    corners = np.stack([closed[axis] for axis in "xyz"], axis=-1).astype(np.float64)[more_faces]
    corners = corners[(corners[..., 2] > -1.5).all(axis=1)]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    np.testing.assert_allclose(turned.sum(axis=0), 0, atol=1e-6)  # closed all round, and every triangle turns outwards
    face = 17 * 13 / RIG.left.fx**2
    assert (corners.mean(axis=1) * turned).sum() / 3 == pytest.approx(face * (1.08**3 - 1) / 3, rel=0.01)


def test_both_eyes_are_brought_together(files: Path) -> None:
    result = called(
        "export", str(files / "left.exr"), str(files / "right.exr"), "--to", "ply", "--rig", str(files / "rig.json"), "--out", str(files / "both.ply")
    )
    assert result.exit_code == 0, result.output
    points, faces = read_ply(files / "both.ply")
    assert len(faces) == 0
    depths = np.round(-points["z"], 3)
    assert set(depths) == {1.0, 2.0}
    left_alone = SIZE[0] * SIZE[1]
    assert left_alone < len(depths) < 1.5 * left_alone, "what one eye sees alone is added, what both see is one point"
    assert points["x"][depths == 2].max() > seen("left")["P"][..., 0].max(), "the right eye sees farther to the right"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("left.exr", "right.exr"), "need --rig"),
        (("left.exr", "right.exr", "--rig", "rig.json", "--thickness", "10"), "closes triangles"),
        (("left.exr", "--points", "--thickness", "10"), "closes triangles"),
        (("right.exr", "left.exr", "--rig", "rig.json"), "give the left eye's file"),
        (("left.exr", "--thickness", "-1"), "x>=0"),
    ],
)
def test_what_cannot_be_is_told(files: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str) -> None:
    monkeypatch.chdir(files)
    result = called("export", *words, "--to", "ply", "--out", "a.ply")
    assert result.exit_code != 0
    assert said in result.output
    assert not (files / "a.ply").exists()


LAMP = """
[[lights]]
name = "k"
type = "directional"
aim = [-0.966, 0, -0.259]
shadow = "rays"
[shadows]
outside = "open"
"""


def test_passes_files_say_how_far_depth_may_be_off(tmp_path: Path) -> None:
    """`passes` hands Z_sigma on from the depth; `relight` takes it, finds no acne on a rough wall, and still takes files without it."""
    rough = np.kron(np.random.default_rng(0).normal(0, 0.004, (SIZE[1] // 2, SIZE[0] // 2)), np.ones((2, 2))).astype(np.float32)
    depth = Frame(passes={"Z": 2 + rough, "Z_sigma": np.full_like(rough, 0.004)}, camera=RIG.left)
    write_frame(tmp_path / "depth.exr", depth)
    assert called("passes", str(tmp_path / "depth.exr"), "--out", str(tmp_path / "passes.exr")).exit_code == 0
    made = read_frame(tmp_path / "passes.exr")
    np.testing.assert_array_equal(made["Z_sigma"], depth["Z_sigma"])
    N = np.zeros((*rough.shape, 3), np.float32)
    N[..., 2] = 1
    told = made.with_passes(N=N)
    silent = replace(told, passes={name: a for name, a in told.passes.items() if name != "Z_sigma"})
    (tmp_path / "lamp.toml").write_text(LAMP)
    plate = tmp_path / "plate.exr"
    write_frame(plate, Frame(passes={"plate": np.full((*rough.shape, 3), 0.5, np.float32)}, camera=RIG.left))
    shares = {}
    for name, frame in (("told", told), ("silent", silent)):
        write_frame(tmp_path / f"{name}.exr", frame)
        words = (str(tmp_path / f"{name}.exr"), "--lights", str(tmp_path / "lamp.toml"), "--out", str(tmp_path / f"{name}_lit.exr"))
        result = called("relight", str(plate), *words)
        assert result.exit_code == 0, result.output
        shares[name] = float((read_frame(tmp_path / f"{name}_lit.exr")["shadow_k"] < 0.5).mean())
    assert shares["told"] < 0.02
