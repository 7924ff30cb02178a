"""ST-maps: the half pixel, the lens to float precision, overscan that holds the plate, and pictures through them and back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click.testing
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereorelight.camera import Camera
from stereorelight.cli import main
from stereorelight.engine.resample import resample
from stereorelight.errors import OutputError, RigError
from stereorelight.footage.exr import read_exr
from stereorelight.interchange.rig_files import read_any_rig, write_rig_as
from stereorelight.interchange.rigs import read_rig, write_rig
from stereorelight.interchange.stmap import NOWHERE, pixels_from_st, st_from_pixels, st_map, undistortion
from stereorelight.shot.stmaps import write_stmaps
from stereorelight.stereo.rectify import rectification
from stereorelight.synth.rigs import rig_named

SIZE = (160, 90)
LENSES = {
    "barrel": ("brown", (-0.25, 0.06, 0.001, -0.0008)),
    "pincushion": ("brown", (0.2, 0.05, -0.001, 0.0008, 0.01)),
    "rational": ("rational", (0.2, -0.1, 1e-4, -2e-4, 0.02, 0.3, -0.05, 0.01)),
    "fisheye": ("fisheye", (0.02, -0.003, 0.001, -0.0002)),
}


def float32_px(size: tuple[int, int]) -> float:
    """Half the step of a float32 below 1, in pixels: what a 32-bit map can be off by."""
    return max(size) * 2.0**-24


def camera(lens: str, size: tuple[int, int] = SIZE) -> Camera:
    model, c = LENSES[lens]
    w, h = size
    return Camera(size=size, K=[[w, 0, 0.51 * w], [0, 1.01 * w, 0.48 * h], [0, 0, 1]], model=model, distortion=c)  # type: ignore[arg-type]


def sampled(picture: np.ndarray, stmap: np.ndarray) -> np.ndarray:
    """What an STMap node makes, by the definition: v up from the bottom, 0..1 over the source's outer edges."""
    h, w = picture.shape[:2]
    u, v = stmap[..., 0] * w - 0.5, (1 - stmap[..., 1]) * h - 0.5
    return resample(picture, np.ascontiguousarray(np.stack([u, v], axis=-1), dtype=np.float32))


def smooth(size: tuple[int, int]) -> np.ndarray:
    w, h = size
    y, x = np.mgrid[0:h, 0:w].astype(np.float64)
    return np.stack([np.sin(x / 7) + np.cos(y / 9), np.sin((x + y) / 11), np.cos((x - 2 * y) / 13)], axis=-1).astype(np.float32)


@pytest.mark.parametrize("size", [(160, 90), (1, 1), (7, 5)])
def test_a_perfect_lens_gives_the_node_its_own_pixel_centres(size: tuple[int, int]) -> None:
    w, h = size
    lens = undistortion(Camera(size=size, K=[[200, 0, 3.3], [0, 190, 1.7], [0, 0, 1]]))
    assert lens.margin == (0, 0)
    x, y_up = np.meshgrid(np.arange(w), np.arange(h)[::-1])  # Nuke's rows count from the bottom
    for made in (lens.undistort_map(), lens.redistort_map()):
        assert made.dtype == np.float32
        assert made.flags.c_contiguous
        np.testing.assert_allclose(made[..., 0], (x + 0.5) / w, rtol=0, atol=2.0**-23)
        np.testing.assert_allclose(made[..., 1], (y_up + 0.5) / h, rtol=0, atol=2.0**-23)
        assert (made[..., 2] == 0).all()
        assert (made[..., 3] == 1).all()
    exact = st_from_pixels(np.stack([x, np.arange(h)[:, None] + 0 * x], axis=-1), size)
    assert np.array_equal(exact[..., 0], ((x + 0.5) / w).astype(np.float32))


@pytest.mark.parametrize("overscan", [None, 0.0, 0.1])
@pytest.mark.parametrize("lens", LENSES)
def test_the_maps_are_the_lens(lens: str, overscan: float | None) -> None:
    made = undistortion(camera(lens), overscan=overscan)
    (mx, my), (w, h) = made.margin, SIZE
    flat, bent = made.undistort_map(), made.redistort_map()
    assert flat.shape == (h + 2 * my, w + 2 * mx, 4)
    assert bent.shape == (h, w, 4)
    # Undistort: a canvas pixel is the plate's pinhole pixel less the margin; its ray is where the plate's lens puts it.
    y, x = np.mgrid[0 : h + 2 * my, 0 : w + 2 * mx]
    K = made.plate.K
    rays = np.stack([(x - mx - K[0, 2]) / K[0, 0], (y - my - K[1, 2]) / K[1, 1], np.ones(x.shape)], axis=-1)
    seen = made.plate.project(rays)
    known = np.isfinite(seen).all(axis=-1)
    far = np.maximum(1, np.abs(flat[known][:, :2]).max())
    assert np.abs(pixels_from_st(flat, SIZE) - seen)[known].max() < 1e-5 + far * float32_px(SIZE)
    assert (flat[~known][:, :2] == NOWHERE).all()
    assert (flat[~known][:, 3] == 0).all()
    # Redistort: the other way.
    back = made.plate.rays(made.plate.pixel_grid())
    on_canvas = back[..., :2] * (K[0, 0], K[1, 1]) + (K[0, 2] + mx, K[1, 2] + my)
    assert np.abs(pixels_from_st(bent, made.canvas.size) - on_canvas).max() < 1e-5 + 2 * float32_px(made.canvas.size)
    assert np.isfinite(flat).all()
    assert np.isfinite(bent).all()


@given(k1=st.floats(-0.2, 0.25), k2=st.floats(-0.05, 0.05), p1=st.floats(-0.003, 0.003), cx=st.floats(0.4, 0.6), cy=st.floats(0.4, 0.6))
def test_overscan_holds_every_plate_pixel_and_no_more(k1: float, k2: float, p1: float, cx: float, cy: float) -> None:
    w, h = SIZE
    made = undistortion(Camera(size=SIZE, K=[[w, 0, cx * w], [0, w, cy * h], [0, 0, 1]], distortion=(k1, k2, p1, 0.0)))
    back = made.redistort_map()
    assert (back[..., 3] == 1).all()
    assert (back[..., :2] >= 0).all()
    assert (back[..., :2] <= 1).all()
    (mx, my), (cw, ch) = made.margin, made.canvas.size
    assert (cw, ch) == (w + 2 * mx, h + 2 * my)
    # The margin is needed: some outer pixel edge lies within a pixel of the canvas's own, where there is a margin at all.
    u, v = np.linspace(-0.5, w - 0.5, 200), np.linspace(-0.5, h - 0.5, 200)
    edge = np.concatenate([np.stack(s, -1) for s in [(u, 0 * u - 0.5), (u, 0 * u + h - 0.5), (0 * v - 0.5, v), (0 * v + w - 0.5, v)]])
    there = made.canvas.project(made.plate.rays(edge))
    gap_x = min(there[:, 0].min() + 0.5, cw - 0.5 - there[:, 0].max())
    gap_y = min(there[:, 1].min() + 0.5, ch - 0.5 - there[:, 1].max())
    assert gap_x > -1e-6
    assert gap_y > -1e-6
    assert mx == 0 or gap_x < 1 + 1e-2
    assert my == 0 or gap_y < 1 + 1e-2


@pytest.mark.parametrize("lens", LENSES)
def test_a_picture_through_both_maps_comes_back(lens: str) -> None:
    made = undistortion(camera(lens))
    picture = smooth(SIZE)
    flat = sampled(picture, made.undistort_map())
    assert flat.shape[:2] == made.canvas.size_hw
    again = sampled(np.nan_to_num(flat), made.redistort_map())
    inner = (slice(8, -8), slice(8, -8))  # the resampling's own reach from the black outside the plate
    assert np.abs(again - picture)[inner].max() < 0.01
    # Half a pixel of shift would show: it alone moves this picture by more.
    assert np.abs(picture[:, 1:] - picture[:, :-1]).max() / 2 > 0.05
    # And a centred crop of the canvas is the plate's own frame: straight in the middle, where the lens does nothing.
    mx, my = made.margin
    crop = flat[my : my + SIZE[1], mx : mx + SIZE[0]]
    cx, cy = round(made.plate.cx), round(made.plate.cy)
    assert np.abs(crop[cy, cx] - picture[cy, cx]).max() < 0.01


def test_what_lies_beyond_the_fold_is_nowhere() -> None:
    plate = Camera(size=SIZE, K=[[125, 0, 80], [0, 125, 45], [0, 0, 1]], distortion=(-0.25, 0.0, 0.0, 0.0))
    made = undistortion(plate, overscan=0.5)
    flat = made.undistort_map()
    nowhere = (flat[..., :2] == NOWHERE).all(axis=-1)
    assert nowhere.any()
    assert np.isfinite(flat).all()
    assert np.isnan(pixels_from_st(flat, SIZE)[nowhere]).all()
    assert (flat[nowhere][:, 3] == 0).all()
    assert (flat[..., 3] == 1).sum() > 0.7 * SIZE[0] * SIZE[1]
    # Beyond the plate's edge and within the model the map goes on smoothly: no jump where the plate ends.
    row = flat[flat.shape[0] // 2]
    steps = np.diff(row[~(row[:, 0] == NOWHERE), 0])
    assert (steps > 0).all()


def test_a_lens_too_wide_for_one_plane_says_what_would_do() -> None:
    wide = Camera(size=SIZE, K=[[70, 0, 79.5], [0, 70, 44.5], [0, 0, 1]], model="fisheye", distortion=())
    with pytest.raises(RigError, match=r"too wide for one flat picture: .*give an overscan of at most 0.5"):
        undistortion(wide)
    made = undistortion(wide, overscan=0.5)
    assert made.canvas.size == (320, 180)
    assert (made.redistort_map()[..., 3] == 0).any()
    for bad in (-0.1, 0.6, float("nan")):
        with pytest.raises(RigError, match=r"overscan must lie between 0 and 0\.5"):
            undistortion(wide, overscan=bad)


def test_files_hold_bare_float_channels_and_say_what_they_are(tmp_path: Path) -> None:
    rig = rig_named("hard", SIZE)
    files = write_stmaps(tmp_path / "lens.exr", rig, rectify=True)
    assert len(files) == 8
    names = {f.path.name for f in files}
    assert names == {f"lens_{eye}_{name}.exr" for eye in ("left", "right") for name in ("undistort", "redistort", "rectify", "unrectify")}
    flat = rectification(rig)
    for file in files:
        (part,) = read_exr(file.path)
        assert set(part.channels) == {"R", "G", "B", "A"}
        assert part.channels["R"].shape == (file.gives[1], file.gives[0])
        assert part.offset == (0, 0)
        assert part.metadata["stereorelight/stmap_source_size"] == f"{file.fed[0]} {file.fed[1]}"
        assert json.loads(part.metadata["stereorelight/camera"])["size"] == list(file.gives)
        assert ("stereorelight/plate_flipped_back" in part.metadata) == ("right" in file.path.name)
        assert all(np.isfinite(c).all() for c in part.channels.values())
    for eye, rectified in (("left", flat.rig.left), ("right", flat.rig.right)):
        made = {name: read_exr(tmp_path / f"lens_{eye}_{name}.exr")[0].channels for name in ("rectify", "unrectify")}
        there = pixels_from_st(np.stack([made["rectify"][c] for c in "RG"], -1), SIZE)
        assert np.nanmax(np.abs(there - flat.original_from_rectified(eye))) < 1e-4
        back = pixels_from_st(np.stack([made["unrectify"][c] for c in "RG"], -1), rectified.size)
        assert np.nanmax(np.abs(back - flat.rectified_from_original(eye))) < 1e-4
    with pytest.raises(OutputError, match="--force"):
        write_stmaps(tmp_path / "lens.exr", rig)
    with pytest.raises(RigError, match="ST-maps are EXR files"):
        write_stmaps(tmp_path / "lens.tif", rig)


def test_a_large_map_is_worked_in_bands_without_a_seam() -> None:
    tall = camera("barrel", (40, 300))
    whole = st_from_pixels(tall.project(tall.undistorted().rays(tall.pixel_grid())), tall.size)
    assert np.array_equal(st_map(tall.undistorted(), tall), whole)


def call(*arguments: object) -> click.testing.Result:
    return click.testing.CliRunner().invoke(main, [str(a) for a in arguments])


def test_export_and_compare_at_the_command_line(tmp_path: Path) -> None:
    rig = rig_named("distorted", SIZE)
    ours = write_rig(tmp_path / "rig.json", rig)
    for target, name in (("opencv", "cv.yml"), ("kalibr", "k.yaml"), ("mrcal", "m_%V.cameramodel"), ("ros", "r_%V.yaml"), ("meshroom", "m.sfm")):
        made = call("export", ours, "--to", target, "--out", tmp_path / name.replace("_%V", ""), "--json")
        assert made.exit_code == 0, made.output
        assert all(Path(f).exists() for f in json.loads(made.stdout)["files"])
        # The same file is a rig to whatever takes one.
        found = json.loads(call("compare", tmp_path / name, ours, "--json").stdout)["rig"]
        assert found["left"]["as_it_stands"]["largest_px"] < 1e-6
        assert found["at"][0]["depth"]["largest_mm"] < 1e-6
        back = call("export", tmp_path / name, "--to", "stereorelight", "--out", tmp_path / "back.json", "--force")
        assert back.exit_code == 0, back.output
        assert np.allclose(read_rig(tmp_path / "back.json").left.K, rig.left.K, rtol=1e-12)
    pair = call("export", tmp_path / "m_left.cameramodel", tmp_path / "m_right.cameramodel", "--to", "opencv", "--out", tmp_path / "pair.json")
    assert pair.exit_code == 0, pair.output
    (tmp_path / "shot.toml").write_text('[plates]\nleft = "l.png"\nright = "r.png"\n[rig]\nfile = "k.yaml"\n')
    maps = call("export", tmp_path / "shot.toml", "--to", "stmap", "--out", tmp_path / "lens.exr", "--overscan", 0.1, "--json")
    assert json.loads(maps.stdout)["files"][0]["margin_px"] == [16, 9]
    moved = write_rig(tmp_path / "moved.json", replace(rig, t_right_left_m=1.02 * rig.t_right_left_m))
    page = call("compare", moved, ours, "--at", 2, "--out", tmp_path / "apart.html")
    assert "depth at 2 m" in page.output
    assert "40.000" in page.output
    assert (tmp_path / "apart.html").read_text().count("<svg") == 7


def test_bad_input_is_one_line_with_the_file_and_the_remedy(tmp_path: Path) -> None:
    rig = rig_named("hard", SIZE)
    ours = write_rig(tmp_path / "rig.json", rig)
    write_rig_as(tmp_path / "m.txt", rig, "mrcal", flipped_back=True)
    assert read_any_rig(tmp_path / "m_%V.txt").mirrored is None
    (tmp_path / "words.yaml").write_text("hello: there\n")
    (tmp_path / "sizeless.yml").write_text(
        "%YAML:1.0\n---\n"
        + "".join(f"M{n}: [100, 0, 80, 0, 100, 45, 0, 0, 1]\nD{n}: [0, 0, 0, 0]\n" for n in (1, 2))
        + "R: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nT: [-65, 0, 0]\n"
    )
    cases: list[tuple[tuple[object, ...], tuple[str, ...]]] = [
        ((ours, "--to", "kalibr"), ("mirrored", "--flipped-back")),
        ((tmp_path / "m_left.txt", "--to", "ros"), ("m_left.txt", "one file for each eye", "%V")),
        ((tmp_path / "words.yaml", "--to", "ros"), ("words.yaml", "holds no rig", "kalibr")),
        ((tmp_path / "none.yaml", "--to", "ros"), ("none.yaml", "missing")),
        ((tmp_path / "sizeless.yml", "--to", "ros"), ("sizeless.yml", "size of the picture", "1920x1080")),
        ((tmp_path / "sizeless.yml", "--to", "ros", "--size", "160x90"), ("65 apart", "0.001 for millimetres")),
        ((ours, "--to", "stmap", "--overscan", 3), ("overscan", "0.5")),
    ]
    for arguments, words in cases:
        result = call("export", *arguments, "--out", tmp_path / "out.exr")
        assert result.exit_code == 1, result.output
        last = result.stderr.strip().splitlines()[-1]
        assert last.startswith("RigError: ")
        assert all(word in last for word in words), last
    right = call("export", tmp_path / "sizeless.yml", "--to", "ros", "--size", "160x90", "--unit", 0.001, "--out", tmp_path / "out.yaml")
    assert right.exit_code == 0, right.output
    for arguments in (("--to", "ros", "--rectify"), ("--to", "opencv", "--size", "wide"), ("--to", "usd")):
        assert call("export", ours, *arguments, "--out", tmp_path / "o.yaml").exit_code == 2
    refused = call("depth", "l.png", "r.png", "--rig", tmp_path / "words.yaml", "--out", tmp_path / "z.exr")
    assert (refused.exit_code, "words.yaml: holds no rig" in refused.stderr) == (1, True)
