"""Shading over a shot: materials are judged once, so that every frame trusts them alike, whatever part of the shot is run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from stereorelight.compare.flicker import residual
from stereorelight.compare.normals import angle_deg
from stereorelight.footage.frames import read_frame
from stereorelight.footage.stills import write_still
from stereorelight.passes import Flag
from stereorelight.shot.depths import surface_of
from stereorelight.shot.materials import FRAMES
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.shot.run import run_shot
from stereorelight.shot.synthetic import write_shot
from stereorelight.surface.shading_trust import Judged, ShotMaterials, pooled
from stereorelight.synth.rigs import parallel_rig
from tests.made_once import made_once

MATTE = '\n[[repairs]]\nname = "corner"\nkind = "constant"\nmatte = "corner.png"\ndistance_m = 2.4\n'
NUMBERS = range(1001, 1008)
SIZE, FOV_DEG = (192, 108), 36.0


@pytest.fixture(scope="module")
def plain_ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven frames of a plain ball that moves, a corner of its wall held by a matte, lit by its own light's albedo; run once as a whole."""
    return made_once(tmp_path_factory, "plain-ball", _run_ball)


def _run_ball(folder: Path) -> Path:
    write_shot(folder, "sphere", size=SIZE, fov_deg=FOV_DEG, samples=1, frames=7, noise_sigma=0.004, texture=0.1)
    text = (folder / "shot.toml").read_text().partition("[[lights]]")[0].replace("previews = true", "previews = false")
    matte = np.zeros((108, 192, 3), np.uint8)
    matte[:30, :30] = 255
    write_still(folder / "corner.png", matte)
    text = (
        text.replace('shading = "off"', "").replace("[surface]", '[surface]\nshading = "on"').replace("[relight]", '[relight]\nalbedo = "estimated"')
    )
    (folder / "shot.toml").write_text(text + MATTE)
    run_shot(folder / "shot.toml")
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.exr"))}


def told(folder: Path, number: int) -> dict[str, list[dict[str, float]]]:
    receipt = json.loads((folder / "out" / "receipts" / f"sphere.{number}.json").read_text())
    figures: dict[str, list[dict[str, float]]] = receipt["steps"]["passes"]["figures"]["shading"]
    return figures


def test_every_frame_trusts_the_ball_alike(plain_ball: Path) -> None:
    found = json.loads((plain_ball / "out" / "materials.json").read_text())
    assert max(found["trust"]) > 0.5
    trusts = [max(m["trust"] for m in told(plain_ball, n)["materials"]) for n in NUMBERS]
    assert trusts == pytest.approx([round(max(found["trust"]), 2)] * len(trusts), abs=1e-9)
    explained = [max(m["explained"] for m in told(plain_ball, n)["materials"]) for n in NUMBERS]
    assert np.ptp(explained) > 0.005  # by itself, each frame would have said something else


def test_sigma_of_shaded_normals_is_of_the_size_of_their_error(plain_ball: Path) -> None:
    """In each of five bins, on a ball that had no part in the fit."""
    errors, told = [], []
    for n in NUMBERS:
        truth, found = (read_frame(plain_ball / what / f"sphere.{n}.exr") for what in ("truth", "out/passes"))
        ball = ndimage.binary_erosion(truth["Z"] < 2, iterations=6)
        errors.append(angle_deg(found["N"], truth["N"])[ball])
        told.append(found["N_sigma"][ball])
    error, sigma = np.concatenate(errors), np.concatenate(told)
    bins = np.digitize(sigma, np.quantile(sigma, [0.2, 0.4, 0.6, 0.8]))
    ratios = [float(np.quantile(error[bins == k], 0.68) / np.median(sigma[bins == k])) for k in range(5)]
    assert min(ratios) > 0.4  # a smooth ball has none of a face's features, and is told up to twice too careful
    assert max(ratios) < 1.3


@pytest.fixture(scope="module")
def judged(plain_ball: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Over the ball, error against its truth and change along its true motion, degrees: shading and steadied depth, steadied depth alone."""
    truth = [read_frame(plain_ball / "truth" / f"sphere.{n}.exr") for n in NUMBERS]
    depths, shaded = ([read_frame(plain_ball / "out" / what / f"sphere.{n}.exr") for n in NUMBERS] for what in ("depth", "passes"))
    camera = parallel_rig(SIZE, fov_deg=FOV_DEG).left
    noise = MATCH_NOISE_PX / (camera.fx * 0.065)
    given = [surface_of(replace(depth, camera=camera), noise_per_m=noise)["N"] for depth in depths]
    balls = [ndimage.binary_erosion(frame["Z"] < 2, iterations=6) for frame in truth]
    errors: dict[str, float] = {}
    steps: dict[str, float] = {}
    for name, normals in (("given", given), ("shaded", [frame["N"] for frame in shaded])):
        errors[name] = float(np.median(np.concatenate([angle_deg(N, t["N"])[ball] for N, t, ball in zip(normals, truth, balls, strict=True)])))
        found = []
        for k in range(len(truth) - 1):
            motion = np.zeros((*SIZE[::-1], 2), np.float32)
            motion[..., 0] = camera.fx * 0.005 / truth[k]["Z"]  # it moves by 5 mm a frame
            motion[~balls[k]] = np.nan
            pairs = [(truth[i]["Z"], truth[i]["N"]) for i in (k, k + 1)]
            turned = residual((depths[k]["Z"], normals[k]), (depths[k + 1]["Z"], normals[k + 1]), motion, truth=(pairs[0], pairs[1]))[1]
            assert turned is not None
            found.append(turned[balls[k] & np.isfinite(turned)])
        steps[name] = float(np.concatenate(found).mean())
    return errors, steps


def test_normals_are_better(judged: tuple[dict[str, float], dict[str, float]]) -> None:
    errors, _ = judged
    assert errors["shaded"] < 0.95 * errors["given"]


def test_normals_are_about_as_steady(judged: tuple[dict[str, float], dict[str, float]]) -> None:
    _, steps = judged
    assert steps["shaded"] < 1.15 * steps["given"]  # 0.98 times, as turning heads do (docs/shading.md)


@pytest.mark.parametrize("length", [1, 3])
def test_pieces_give_the_same_files(plain_ball: Path, tmp_path: Path, length: int) -> None:
    """Seven frames in one piece, in pieces of 3 from the last to the first, and the last, middle and first each by itself; a repair and the
    plate's own light in it."""
    text = (plain_ball / "shot.toml").read_text()
    for name in ("plates/left.####.png", "plates/right.####.png", "rig.json", "corner.png"):
        text = text.replace(f'"{name}"', f'"{(plain_ball / name).as_posix()}"')
    (tmp_path / "shot.toml").write_text(text)
    for first in range(1001, 1008, 3)[::-1]:
        run_shot(tmp_path / "shot.toml", frames=f"{first}-{min(first + length - 1, 1007)}")
        if first == 1007:
            (tmp_path / "out" / "materials.json").unlink()  # whoever comes next finds the same
    whole, parts = files(plain_ball / "out"), files(tmp_path / "out")
    assert len(whole) == 3 * 7
    assert len(parts) == 3 * {1: 3, 3: 7}[length]
    assert parts == {name: whole[name] for name in parts}


def test_what_a_repair_holds_shading_leaves(plain_ball: Path) -> None:
    depth, surface = (read_frame(plain_ball / "out" / what / "sphere.1004.exr") for what in ("depth", "passes"))
    held = (depth["flags"] & Flag.REPAIRED) != 0
    assert held[:30, :30].all()
    np.testing.assert_allclose(surface["Z"][held], 2.4, rtol=1e-3)
    assert (surface["Z"] != depth["Z"]).mean() > 0.05  # while the ball was shaded


def test_a_frame_that_judges_is_an_input_of_all(plain_ball: Path, tmp_path: Path) -> None:
    import shutil

    folder = Path(shutil.copytree(plain_ball, tmp_path / "shot"))
    assert run_shot(folder / "shot.toml").done == 0
    judges = [1001 + (2 * k + 1) * 7 // (2 * FRAMES) for k in range(FRAMES)]
    plate = folder / "plates" / f"right.{judges[-1]}.png"
    good = plate.read_bytes()
    plate.write_bytes(good[: len(good) // 2])
    first = folder / "out" / "passes" / "sphere.1001.exr"
    assert run_shot(folder / "shot.toml", frames="1001").done >= 1  # far from the damaged one, and judged without it
    plate.write_bytes(good)
    run_shot(folder / "shot.toml", frames="1001")
    assert first.read_bytes() == (plain_ball / "out" / "passes" / "sphere.1001.exr").read_bytes()


def test_frames_are_pooled_by_colour_and_by_what_turns() -> None:
    def frame(share: float, wall_share: float) -> Judged:
        return Judged(
            colours=np.array([[0.4, -0.2], [0.42, -0.22], [-0.3, 0.3]]), size=np.array([0.2, 0.4, 0.1]), share=np.array([share, wall_share, 0.9]),
            gain=np.array([3.0, 3.0, 3.0]), turns=np.array([30.0, 5.0, 30.0]), patches=np.array([20.0, 20.0, 20.0]),
        )  # fmt: skip

    shot = pooled([frame(0.7, 0.0), frame(0.3, 0.0), frame(0.7, 0.0)])
    face, other = (int(np.linalg.norm(shot.colours - c, axis=1).argmin()) for c in ([0.4, -0.2], [-0.3, 0.3]))
    assert 0 < shot.trust[face] < 1  # between what its frames say, and a wall of its colour that does not turn says nothing
    assert shot.trust[other] == 1
    np.testing.assert_array_equal(frame(0.3, 0.9).trust_by(shot), [shot.trust[face], 0, 1])  # the wall stays as it was
    few = replace(frame(0.7, 0.7), patches=np.array([5.0, 9.0, 20.0]), turns=np.full(3, 30.0))
    assert few.trust[0] == 0 < few.trust[1] < few.trust[2]  # nine numbers of a light are not told by five patches
    far = ShotMaterials(colours=np.array([[3.0, 3.0]]), trust=np.ones(1))
    assert not frame(0.7, 0.7).trust_by(far).any()
    assert not frame(0.7, 0.7).trust_by(pooled([])).any()
