"""Every fault at once in one shot, through the command: each is still found with its size; and none where there is none.

A textured wall and a card before it, filmed by a hand-held pair; grain grows with light, as a sensor's does."""

from __future__ import annotations

import json
from pathlib import Path

import click.testing
import cv2
import numpy as np
import pytest

from stereorelight.arrays import Float32
from stereorelight.cli import main
from stereorelight.footage.exr import write_exr
from stereorelight.interchange.rigs import write_rig
from stereorelight.synth.rigs import rig_named

SIZE, COUNT, FIRST = (480, 270), 12, 1001
LATE, DOWN_PX, ROLL_DEG, ZOOM, EXPOSURE, RED = 0.35, 3.0, 0.5, 1.004, 1.15, 1.08
REPEATED = 5
TENTH = 0.1


def _texture(seed: int, contrast: float) -> Float32:
    rng = np.random.default_rng(seed)
    octaves = sum(cv2.GaussianBlur(rng.standard_normal((420, 760, 1)).astype(np.float32), (0, 0), s) * s for s in (1.5, 4, 10))
    picture: Float32 = np.exp(contrast * octaves)
    return picture


WALL, CARD = _texture(7, 0.5), _texture(8, 0.5)


def _seen(t: float, eye: int) -> Float32:
    """(H, W, 3) at the moment t: the wall at 12 px of disparity, the card at 30; the hand sways both ways and unevenly."""
    x, y = 40 + 2.5 * t + 3 * np.sin(0.8 * t), 50 + 9 * np.sin(0.55 * t)

    def layer(texture: Float32, disparity: float) -> Float32:
        M = np.array([[1, 0, x + eye * disparity], [0, 1, y]], np.float64)
        moved: Float32 = cv2.warpAffine(texture, M, SIZE, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
        return moved

    inside = np.zeros(WALL.shape, np.float32)
    inside[120:230, 200:330] = 1
    card = layer(cv2.GaussianBlur(inside, (0, 0), 0.7), 30)
    grey = 0.15 * ((1 - card) * layer(WALL, 12) + card * layer(CARD, 30))
    return grey[..., None] * np.array([1.0, 0.9, 0.8], np.float32)


def _knocked(plate: Float32) -> Float32:
    turn = np.radians(ROLL_DEG)
    A = ZOOM * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = (np.array(SIZE) - 1) / 2
    M = np.column_stack([A, middle - A @ middle + (0, DOWN_PX)])
    moved = cv2.warpAffine(plate, M, SIZE, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)
    changed: Float32 = moved * np.array([EXPOSURE * RED, EXPOSURE, EXPOSURE], np.float32)
    return changed


def _shot(folder: Path, *, faults: bool) -> list[str]:
    for eye, name in enumerate(("left", "right")):
        for k in range(COUNT):
            late = LATE if eye and faults else 0.0
            plate = _seen((k - 1 if faults and eye == 0 and k == REPEATED else k) - late, eye)
            plate = _knocked(plate) if eye and faults else plate
            rng = np.random.default_rng((100 * eye) + (k - 1 if faults and eye == 0 and k == REPEATED else k))
            plate = plate + (np.sqrt(1e-6 + 5e-5 * np.abs(plate)) * rng.standard_normal(plate.shape)).astype(np.float32)
            write_exr(folder / f"{name}.{FIRST + k}.exr", {c: np.ascontiguousarray(plate[..., i], np.float32) for i, c in enumerate("RGB")})
    write_rig(folder / "rig.json", rig_named("parallel", SIZE))
    return [str(folder / "left.####.exr"), str(folder / "right.####.exr"), "--rig", str(folder / "rig.json"), "--json"]


def _checked(arguments: list[str]) -> dict[str, dict[str, object]]:
    ran = click.testing.CliRunner().invoke(main, ["check", *arguments])
    assert ran.exit_code == 0, ran.output
    return {found["name"]: found for found in json.loads(ran.stdout)["findings"]}


def test_every_fault_at_once(tmp_path: Path) -> None:
    found = _checked(_shot(tmp_path, faults=True))
    value = {name: f["value"] for name, f in found.items()}
    raised = {name for name, f in found.items() if f["level"] in ("warn", "bad")}
    assert {"vertical", "roll", "zoom", "rig_stale", "exposure", "colour", "sync", "repeated_frames"} <= raised
    assert not {"swapped", "mirrored", "upside_down", "focus", "corrupt_frames", "shading"} & raised
    assert value["sync"] == pytest.approx(LATE, abs=0.05)
    assert value["roll"] == pytest.approx(ROLL_DEG, rel=TENTH)
    assert value["zoom"] == pytest.approx(100 * (ZOOM - 1), rel=TENTH)
    assert value["exposure"] == pytest.approx(np.log2(EXPOSURE), rel=TENTH)
    assert value["colour"] == pytest.approx(100 * (RED - 1), rel=TENTH)
    assert value["repeated_frames"] == 1
    assert f"frame {FIRST + REPEATED}" in str(found["repeated_frames"]["words"])
    assert "right" not in str(found["repeated_frames"]["words"])  # where the hand pauses for a frame, nothing is repeated


def test_the_same_shot_without_faults_raises_nothing(tmp_path: Path) -> None:
    found = _checked(_shot(tmp_path, faults=False))
    raised = {name: f["words"] for name, f in found.items() if f["level"] in ("warn", "bad")}
    # The hand does move by 5 px a frame, and texture this fine at 480 px does not make much of depth.
    assert set(raised) <= {"prediction", "motion_blur"}, raised
