"""Time: depth and normals stand still where the scene does and move where it moves; no ghosts; any split gives the same files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereorelight.camera import Rig
from stereorelight.compare.flicker import flicker_figures
from stereorelight.compare.normals import angle_deg
from stereorelight.footage.colour import decode, encode
from stereorelight.passes import Flag, Frame
from stereorelight.shot.run import run_shot
from stereorelight.shot.synthetic import write_shot
from stereorelight.stereo.depth import recover
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import DepthSettings
from stereorelight.stereo.temporal import Glimpse, Motion, Steadied, glimpse, motion_between, steadied
from stereorelight.surface.normals import normals_from_depth
from stereorelight.synth.render import FLIP, render
from stereorelight.synth.rigs import parallel_rig
from stereorelight.synth.scene import Material, Object, Scene, rotation
from stereorelight.synth.scenes import AMBIENT, KEY
from stereorelight.threads import set_threads, usable_cores

FRAMES, WINDOW = 10, 2
NOISE = 0.01  # of the sensor, scene-linear, another one in each frame


@dataclass(frozen=True, eq=False)
class Take:
    """Frames in a row: each by itself, its truth, and the true motion to the next."""

    rig: Rig
    plates: list[np.ndarray]
    alone: list[Frame]
    true_Z: list[np.ndarray]
    true_N: list[np.ndarray]
    motions: list[np.ndarray]

    @property
    def px_m(self) -> float:
        return self.rig.left.fx * self.rig.baseline_m

    def disparity(self, frames: list[Frame]) -> np.ndarray:
        return np.stack([self.px_m / f["Z"] for f in frames])

    def normals(self, frames: list[Frame]) -> list[np.ndarray]:
        return [normals_from_depth(f["Z"], self.rig.left, confidence=f["confidence"], noise_per_m=0.05 / self.px_m) for f in frames]


def card(red: float, green: float, blue: float, frequency: float) -> Material:
    return Material(color=(red, green, blue), contrast=0.5, frequency=frequency, octaves=6, gain=0.7)


def recorded(plate: np.ndarray) -> np.ndarray:
    """The plate as an 8-bit sRGB file holds it."""
    return decode((np.rint(255 * np.clip(encode(plate, "sRGB"), 0, 1)) / 255).astype(np.float32), "sRGB")


def ball_at(frame: int) -> np.ndarray:
    """It moves right, and nearer by 3 cm a frame."""
    return np.array([-0.08 + 0.012 * frame, 0.0, -1.6 + 0.03 * frame])


def take_scene() -> Take:
    """A ball that comes nearer before a slanted wall, seen by a camera that pans and rides."""
    size = (192, 108)
    plain = parallel_rig(size)
    rect = rectification(plain)
    take = Take(plain, [], [], [], [], [])
    poses, objects = [], []
    for f in range(FRAMES):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation(y_deg=0.3 * f - 1.5), (0.010 * f - 0.05, 0.003 * f, -0.008 * f)
        rig = replace(plain, left=replace(plain.left, world_from_camera=pose))
        x, y, z = (float(c) for c in ball_at(f))
        wall = Object(name="wall", kind="plane", material=card(0.4, 0.42, 0.45, 14.0), origin_m=(0, 0, -2.5), R_world_object=rotation(y_deg=25.0))
        ball = Object(name="ball", kind="sphere", material=card(0.55, 0.4, 0.3, 20.0), origin_m=(x, y, z), size=(0.25,))
        scene = Scene(name="take", objects=(wall, ball), lights=(KEY,), ambient=AMBIENT)
        shot = render(scene, rig, samples=2, shadows=False, noise_sigma=NOISE, frame=f)
        left, right = recorded(shot.left["plate"]), recorded(shot.right["plate"])
        take.plates.append(left)
        take.alone.append(recover(left, right, rect).frame)
        take.true_Z.append(shot.left["Z"])
        take.true_N.append(shot.left["N"])
        poses.append(pose)
        objects.append(shot.objects["left"])
    for f in range(FRAMES - 1):
        P = plain.left.unproject(plain.left.pixel_grid(), take.true_Z[f]) @ FLIP
        world = P @ poses[f][:3, :3].T + poses[f][:3, 3]
        world[objects[f] == 1] += ball_at(f + 1) - ball_at(f)
        seen = (world - poses[f + 1][:3, 3]) @ poses[f + 1][:3, :3] @ FLIP
        at = plain.left.project(seen).astype(np.float32)
        Z = cv2.remap(take.true_Z[f + 1], at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1)
        way = at - plain.left.pixel_grid().astype(np.float32)
        way[np.abs(Z - seen[..., 2]) > 0.004 * seen[..., 2]] = np.nan
        take.motions.append(np.ascontiguousarray(way, np.float32))
    return take


def steady(t: int, told: list[Glimpse], *, window: int = WINDOW, among: range | None = None) -> Steadied:
    frames = among or range(len(told))
    near = {k: (told[t + k], motion_between(told[t], told[t + k])[0]) for k in range(-window, window + 1) if k and t + k in frames}
    return steadied(told[t], near, window=window)


@pytest.fixture(scope="module")
def take() -> Take:
    return take_scene()


@pytest.fixture(scope="module")
def told(take: Take) -> list[Glimpse]:
    return [glimpse(plate, frame, px_m=take.px_m) for plate, frame in zip(take.plates, take.alone)]


@pytest.fixture(scope="module")
def calm(take: Take, told: list[Glimpse]) -> list[Frame]:
    return [steady(t, told).frame for t in range(FRAMES)]


def test_flicker_is_a_third_and_the_error_no_worse(take: Take, calm: list[Frame]) -> None:
    """Over all of the frame that is found again, moving camera and moving ball; the change of the truth is taken off."""
    before, after = (
        flicker_figures([f["Z"] for f in frames], take.motions, N=take.normals(frames), true_Z=take.true_Z, true_N=take.true_N)
        for frames in (take.alone, calm)
    )
    assert after.Z_percent.cover_percent > 99
    assert after.Z_percent.median < before.Z_percent.median / 3
    assert after.Z_percent.rms < before.Z_percent.rms
    assert before.N_deg is not None
    assert after.N_deg is not None
    assert after.N_deg.median < before.N_deg.median / 3
    assert after.N_deg.mean < before.N_deg.mean / 3
    true = take.px_m / np.stack(take.true_Z)
    e, s = np.abs(take.disparity(take.alone) - true), np.abs(take.disparity(calm) - true)
    assert np.median(s) < 0.85 * np.median(e)
    for t in range(FRAMES):
        # The first and the last frame have neighbours on one side alone: the rate takes what they would gain.
        assert np.median(s[t]) < (1.15 if t in (0, FRAMES - 1) else 0.95) * np.median(e[t])
        assert (s[t] > 1).mean() < (e[t] > 1).mean() + 0.001
    near = np.ones((7, 7), np.uint8)
    edges = np.stack([cv2.dilate(d, near) - cv2.erode(d, near) > 1 for d in true.astype(np.float32)])
    assert (s[edges] > 1).mean() < (e[edges] > 1).mean() + 0.005
    N, calm_N = (np.stack([angle_deg(n, t) for n, t in zip(take.normals(frames), take.true_N)]) for frames in (take.alone, calm))
    assert np.nanmedian(calm_N) < 0.8 * np.nanmedian(N)


def test_sigma_and_confidence_tell_what_they_say(take: Take, told: list[Glimpse], calm: list[Frame]) -> None:
    """Confidence stays the share of pixels within 1 px; the standard deviation shrinks, but not as if frames erred apart."""
    true = take.px_m / np.stack(take.true_Z)
    for low, high in ((0.3, 0.6), (0.6, 0.85), (0.85, 0.95), (0.95, 1.0)):
        sure = np.stack([f["confidence"] for f in calm])
        inside = (sure >= low) & (sure < high)
        if inside.mean() > 0.005:
            right = (np.abs(take.disparity(calm) - true)[inside] <= 1).mean()
            assert right > sure[inside].mean() - 0.1
    px = np.full(take.alone[0].size_hw, 0.1, np.float32)
    said = [replace(g, depth=g.depth.with_passes(disparity_sigma=px, Z_sigma=px * g.depth["Z"] ** 2 / take.px_m)) for g in told]
    got = steady(5, said).frame
    middle = float(np.nanmedian(got["disparity_sigma"]))
    assert 0.1 * np.sqrt(0.5) < middle < 0.1 * np.sqrt(0.75)
    np.testing.assert_allclose(got["Z_sigma"], got["disparity_sigma"] * got["Z"] ** 2 / take.px_m, rtol=1e-5)


def test_a_cut_leaves_no_ghost(take: Take, told: list[Glimpse]) -> None:
    """Five frames, then five of another scene: nothing crosses, bit for bit."""
    other = [glimpse(np.ascontiguousarray(p[::-1, ::-1]), turned(f), px_m=take.px_m) for p, f in zip(take.plates, take.alone)]
    mixed = told[:5] + other[5:]
    for t in (3, 4, 5, 6):
        side = range(5) if t < 5 else range(5, 10)
        got, wanted = steady(t, mixed), steady(t, mixed, among=side)
        assert set(got.frames) == {k for k in range(-2, 3) if k and t + k in side}
        for name in ("Z", "confidence", "flags"):
            assert np.array_equal(got.frame[name], wanted.frame[name], equal_nan=True)


def turned(frame: Frame) -> Frame:
    return Frame(passes={name: np.ascontiguousarray(a[::-1, ::-1]) for name, a in frame.items()}, camera=frame.camera)


def texture(seed: int, h: int, w: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    fine, coarse = rng.random((h, w)).astype(np.float32), rng.random((h // 6 + 1, w // 6 + 1)).astype(np.float32)
    return 0.5 * cv2.GaussianBlur(fine, (0, 0), 1.0) + 0.5 * cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC)


def card_over_wall(step: int, *, count: int = 5, sigma: float = 0.1) -> tuple[list[Glimpse], list[Frame], list[np.ndarray]]:
    """A card of 12 px disparity that moves right by `step` px a frame over a wall of 4 px: plates, noisy depths, true disparities."""
    h, w = 72, 128
    wall, front = texture(1, h, w), texture(2, 40, 40) * 0.8 + 0.3
    told, frames, true = [], [], []
    for k in range(count):
        grey, d = wall.copy(), np.full((h, w), 4, np.float32)
        x = 30 + step * k
        grey[16:56, x : x + 40], d[16:56, x : x + 40] = front, 12
        rng = np.random.default_rng(100 + k)
        plate = np.repeat((grey + 0.005 * rng.standard_normal(grey.shape))[..., None], 3, axis=2).astype(np.float32)
        noisy = (d + sigma * rng.standard_normal(d.shape)).astype(np.float32)
        frame = Frame(passes={"Z": 1 / noisy, "confidence": np.full((h, w), 0.97, np.float32), "flags": np.zeros((h, w), np.uint16)})
        told.append(glimpse(plate, frame, px_m=1.0))
        frames.append(frame)
        true.append(d)
    return told, frames, true


def about(told: list[Glimpse], t: int, window: int = 2) -> dict[int, tuple[Glimpse, Motion]]:
    return {k: (told[t + k], motion_between(told[t], told[t + k])[0]) for k in range(-window, window + 1) if k and 0 <= t + k < len(told)}


@pytest.mark.parametrize("step", [3, 8])
def test_what_passes_in_front_leaves_no_ghost(step: int) -> None:
    """No pixel takes the depth of what stood there a frame before, and noise goes down on both surfaces."""
    told, _, true = card_over_wall(step)
    for t in range(5):
        error = np.abs(1 / steadied(told[t], about(told, t), window=2).frame["Z"] - true[t])
        assert error.max() < 1  # a ghost is off by 8
        assert np.median(error) < (0.6 if t == 2 else 0.75) * np.median(np.abs(told[t].disparity - true[t]))


def test_guesses_give_way_to_what_neighbours_saw() -> None:
    """A patch of wall that this frame only guessed takes its neighbours' depth and loses its flag; one that nobody saw keeps both."""
    told, frames, true = card_over_wall(0)
    flags, Z = frames[2]["flags"].copy(), frames[2]["Z"].copy()
    flags[4:12, 90:120], Z[4:12, 90:120] = Flag.FILLED | Flag.OCCLUDED, 1 / 7.0
    hurt = Frame(passes={"Z": Z, "confidence": np.where(flags > 0, np.float32(0.3), np.float32(0.97)), "flags": flags})
    centre = replace(told[2], depth=hurt)
    got = steadied(centre, about(told, 2), window=2)
    patch = np.s_[5:11, 91:119]
    assert (got.frame["flags"][patch] == 0).mean() > 0.98
    assert np.median(np.abs(1 / got.frame["Z"] - true[2])[patch]) < 0.1
    assert got.regained == pytest.approx((flags > 0).mean(), rel=0.05)
    blind = [replace(g, depth=hurt) for g in told]
    kept = steadied(blind[2], about(blind, 2), window=2)
    assert (kept.frame["flags"][patch] == flags[patch]).all()
    assert kept.regained == 0


def test_a_surface_that_comes_nearer_is_where_it_is() -> None:
    """Value and rate: half a pixel a frame nearer, seen from the first frame of a shot, where only later frames can speak."""
    h, w, rng = 72, 128, np.random.default_rng(5)
    plate = np.repeat(texture(3, h, w)[..., None], 3, axis=2)
    told, frames = [], []
    for k in range(3):
        d = (6 + 0.5 * k + 0.1 * rng.standard_normal((h, w))).astype(np.float32)
        frame = Frame(passes={"Z": 1 / d, "confidence": np.full((h, w), 0.97, np.float32), "flags": np.zeros((h, w), np.uint16)})
        told.append(glimpse(plate, frame, px_m=1.0))
        frames.append(frame)
    error = 1 / steadied(told[0], about(told, 0), window=2).frame["Z"] - 6
    assert abs(float(np.median(error))) < 0.02
    assert float(np.median(np.abs(error))) < 0.8 * float(np.median(np.abs(told[0].disparity - 6)))


def test_sigmas_that_differ_by_chance_hardly_flicker() -> None:
    """A still wall whose frames are equally good, told so or told by sigmas that scatter by half about that."""
    told, _, _ = card_over_wall(0, count=6)
    rng = np.random.default_rng(11)

    def flicker(scatter: float) -> float:
        said = []
        for g in told:
            px = (0.1 * np.exp(scatter * rng.standard_normal(g.grey.shape))).astype(np.float32)
            said.append(replace(g, depth=g.depth.with_passes(disparity_sigma=px)))
        a, b = (1 / steadied(said[t], about(said, t), window=2).frame["Z"] for t in (2, 3))
        return float(np.abs(a - b).mean())

    assert flicker(0.5) < 1.13 * flicker(0.0)  # 1.22 where they are believed to the full, by 1 / sigma^2


def test_same_bits_whatever_the_threads(take: Take, told: list[Glimpse]) -> None:
    both = []
    try:
        for threads in (1, 2):
            set_threads(threads)
            both.append(steady(5, told).frame)
    finally:
        set_threads(usable_cores())
    for name in ("Z", "confidence", "flags"):
        assert np.array_equal(both[0][name], both[1][name], equal_nan=True)


def test_without_neighbours_nothing_changes(take: Take, told: list[Glimpse]) -> None:
    assert steadied(told[0], {}, window=2).frame is take.alone[0]
    assert steady(5, told, window=0).frame is take.alone[5]


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven frames of a ball that moves, as a shot; run once as a whole."""
    folder = tmp_path_factory.mktemp("moving")
    write_shot(folder, "sphere", size=(128, 72), samples=1, frames=7, noise_sigma=NOISE)
    text = (folder / "shot.toml").read_text().replace('quality = "standard"', 'quality = "draft"').replace("previews = true", "previews = false")
    (folder / "shot.toml").write_text(text.partition("[[lights]]")[0])
    run_shot(folder / "shot.toml")
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.exr"))}


@pytest.mark.parametrize("length", [1, 3])
def test_pieces_give_the_same_files(moving: Path, tmp_path: Path, length: int) -> None:
    """Seven frames in one piece, in pieces of 3, and frame by frame from the last one to the first."""
    text = (moving / "shot.toml").read_text()
    for name in ("plates/left.####.png", "plates/right.####.png", "rig.json"):
        text = text.replace(f'"{name}"', f'"{(moving / name).as_posix()}"')
    (tmp_path / "shot.toml").write_text(text.replace('name = "sphere"', 'name = "sphere"\n'))
    for first in range(1001, 1008, length)[::-1]:
        run_shot(tmp_path / "shot.toml", frames=f"{first}-{min(first + length - 1, 1007)}")
    whole = files(moving / "out")
    assert len(whole) == 3 * 7
    assert files(tmp_path / "out") == whole


def test_a_neighbours_plate_is_an_input_and_a_damaged_one_is_none(moving: Path, tmp_path: Path) -> None:
    import shutil

    folder = Path(shutil.copytree(moving, tmp_path / "shot"))
    shot, whole = folder / "shot.toml", files(folder / "out")
    plate = folder / "plates" / "right.1007.png"
    good = plate.read_bytes()
    plate.write_bytes(good[: len(good) // 2])
    assert run_shot(shot, frames="1001-1006").done == 2 * 3  # 1005 and 1006, which lose a neighbour
    changed = {name for name, data in files(folder / "out").items() if data != whole[name]}
    assert {name.split(".")[1] for name in changed} == {"1005", "1006"}
    plate.write_bytes(good)
    run_shot(shot)
    assert files(folder / "out") == whole
    shot.write_text(shot.read_text().replace("[surface]", 'time = "off"\n\n[surface]'))
    run_shot(shot, frames="1003")
    off = files(folder / "out")["depth/sphere.1003.exr"]
    shot.write_text(shot.read_text().replace('time = "off"', "time_window = 0"))
    run_shot(shot, frames="1003")
    assert files(folder / "out")["depth/sphere.1003.exr"] == off
    assert off != whole["depth/sphere.1003.exr"]


@pytest.mark.parametrize(("wrong", "words"), [({"time": "onn"}, "did you mean 'on'"), ({"time_window": 5}, "0 to 4 frames")])
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object], words: str) -> None:
    from stereorelight.errors import ShotError

    with pytest.raises(ShotError, match=words):
        DepthSettings(**wrong)  # type: ignore[arg-type]
