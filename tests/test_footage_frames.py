"""Plates and frames: passes and cameras return as they went, a renderer's Z is found, sizes that differ are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from stereorelight.camera import Camera, Rig
from stereorelight.errors import OutputError, PassError, PlateError, ShotError
from stereorelight.footage.colour import decode
from stereorelight.footage.exr import read_exr, write_exr
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.footage.plates import check_pair, check_sizes, read_pair, read_plate
from stereorelight.footage.stills import write_still
from stereorelight.passes import Flag, Frame

H, W = 18, 24
RANDOM = np.random.default_rng(4)
POSE = np.eye(4)
POSE[:3, 3] = (0.1, 1 / 3, -2)
CAMERA = Camera(
    size=(W, H), K=[[31 / 3, 0, 11.7], [0, 10.4, 8.1]] + [[0, 0, 1]], model="brown", distortion=(0.01, -0.002, 1e-4, 2e-4), world_from_camera=POSE
)


def a_frame() -> Frame:
    Z = RANDOM.uniform(0.5, 9, (H, W)).astype(np.float32)
    Z[2, 3:9] = np.nan
    N = RANDOM.normal(size=(H, W, 3))
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    N[2, 3:9] = np.nan
    colour = RANDOM.normal(size=(H, W, 3)).astype(np.float16).astype(np.float32)
    flags = RANDOM.integers(0, 128, (H, W))
    passes = {"Z": Z, "P": RANDOM.normal(size=(H, W, 3)).astype(np.float32), "N": N.astype(np.float32), "flags": flags}
    passes |= {"disparity": -Z, "confidence": np.minimum(Z / 9, 1), "occlusion": np.minimum(Z / 9, 1), "flow": N[..., :2].astype(np.float32)}
    passes |= {"beauty": colour, "plate": colour * 2, "albedo": colour / 2, "light_key_diffuse": colour, "light_key_specular": colour * 4}
    passes |= {"matte_face": np.minimum(Z / 9, 1)}
    return Frame(passes=passes, camera=CAMERA, eye="right", number=1007, metadata={"software": "a test", "step": "größer"})


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True)


def test_a_frame_returns_bit_for_bit(tmp_path: Path) -> None:
    frame = a_frame()
    back = read_frame(write_frame(tmp_path / "a.exr", frame))
    assert set(back) == set(frame)
    for name in frame:
        assert same(back[name], frame[name]), name
    assert (back.eye, back.number, dict(back.metadata)) == ("right", 1007, dict(frame.metadata))
    assert back.camera is not None
    for word in ("size", "model", "distortion"):
        assert getattr(back.camera, word) == getattr(CAMERA, word)
    assert np.array_equal(back.camera.K, CAMERA.K)
    assert np.array_equal(back.camera.world_from_camera, CAMERA.world_from_camera)


def test_layers_are_named_as_the_documents_say(tmp_path: Path) -> None:
    (part,) = read_exr(write_frame(tmp_path / "a.exr", a_frame()))
    wanted = {"Z", "P.X", "P.Y", "P.Z", "N.X", "N.Y", "N.Z", "disparity.X", "confidence.Y", "flags.Y", "R", "G", "B", "plate.R"}
    assert wanted | {"light_key_diffuse.R", "matte_face.Y", "flow.X", "occlusion.Y"} <= set(part.channels)
    kinds = {name: c.pixels.dtype for name, c in OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels().items()}
    assert {name for name, kind in kinds.items() if kind == np.float16} == {name for name in kinds if name.rpartition(".")[2] in "RGB"}
    assert "y up" in part.metadata["stereorelight/axes"]


def test_full_precision_colour(tmp_path: Path) -> None:
    beauty = RANDOM.random((H, W, 3), dtype=np.float32) * 1e5
    back = read_frame(write_frame(tmp_path / "a.exr", Frame(passes={"beauty": beauty}), half=False))
    assert same(back["beauty"], beauty)
    with pytest.raises(OutputError, match="exists already"):
        write_frame(tmp_path / "a.exr", Frame(passes={"beauty": beauty}))
    with pytest.raises(PassError, match="another name"):
        write_frame(tmp_path / "b.exr", Frame(passes={"beauty": beauty}, metadata={"dataWindow": "x"}))


@pytest.mark.parametrize("channel", ["Z", "depth.Z", "Depth.R", "depth.V", "ViewLayer.Depth.Z", "z.Y"])
def test_a_renderers_depth_is_found(tmp_path: Path, channel: str) -> None:
    Z = RANDOM.uniform(1, 5, (H, W)).astype(np.float32)
    rendered = Z.copy()
    rendered[0, :3] = (0, 1e10, np.inf)
    Z[0, :3] = np.nan
    write_exr(tmp_path / "a.exr", {channel: rendered, "R": Z, "G": Z, "B": Z, "A": Z, "crypto00.r": Z, "P2.Z": Z * 2}, half="RGBA")
    frame = read_frame(tmp_path / "a.exr")
    assert same(frame["Z"], Z)
    assert set(frame) == {"Z", "beauty"}
    assert set(frame.metadata["ignored_layers"].split(", ")) == {"A", "crypto00", "P2"}


def test_layers_named_by_the_user(tmp_path: Path) -> None:
    Z = RANDOM.uniform(1, 5, (H, W)).astype(np.float32)
    normals = {f"normals.{c}": v for c, v in zip("RGB", (0 * Z, 0 * Z, 0 * Z + 2))}
    write_exr(tmp_path / "a.exr", {"mist.V": Z, "camera_z": Z + 1, **normals})
    frame = read_frame(tmp_path / "a.exr", layers={"Z": "mist.V", "N": "normals"})
    assert same(frame["Z"], Z)
    assert (frame["N"] == (0, 0, 1)).all()
    assert same(read_frame(tmp_path / "a.exr", layers={"Z": "camera_z"})["Z"], Z + 1)
    assert same(read_frame(tmp_path / "a.exr", layers={"Z": "mist"})["Z"], Z)
    with pytest.raises(PlateError, match=r"a\.exr: has no channel or layer 'mits' for Z; did you mean"):
        read_frame(tmp_path / "a.exr", layers={"Z": "mits"})
    with pytest.raises(PlateError, match="no pass that is known"):
        read_frame(tmp_path / "a.exr")


def test_a_file_whose_passes_are_not_what_they_say(tmp_path: Path) -> None:
    grid = np.ones((H, W), np.float32)
    write_exr(tmp_path / "a.exr", {"confidence.Y": grid * 3})
    with pytest.raises(PlateError, match=r"a\.exr: confidence must lie"):
        read_frame(tmp_path / "a.exr")
    write_exr(tmp_path / "b.exr", {"Z": grid}, metadata={"stereorelight/camera": "{}"})
    with pytest.raises(PlateError, match=r"b\.exr: the header's camera"):
        read_frame(tmp_path / "b.exr")


def test_plates_are_scene_linear(tmp_path: Path) -> None:
    codes = RANDOM.integers(0, 65536, (H, W, 3)).astype(np.uint16)
    linear = decode(codes / np.float32(65535), "sRGB")
    write_still(tmp_path / "a.png", codes, bits=16)
    assert same(read_plate(tmp_path / "a.png"), linear)
    assert same(read_plate(tmp_path / "a.png", colour_space="linear"), codes / np.float32(65535))
    for channels in ({c: linear[..., i] for i, c in enumerate("RGB")}, {f"rgba.{c}": linear[..., i] for i, c in enumerate("RGB")}):
        write_exr(tmp_path / "a.exr", channels, force=True)
        assert same(read_plate(tmp_path / "a.exr"), linear)
    with pytest.raises(ShotError, match="did you mean"):
        read_plate(tmp_path / "a.png", colour_space="sRGBB")


def test_missing_pixels_are_kept_but_a_plate_of_nothing_is_refused(tmp_path: Path) -> None:
    plate = RANDOM.normal(size=(H, W, 3)).astype(np.float32)
    plate[3, 4] = np.nan
    write_exr(tmp_path / "a.exr", {c: plate[..., i] for i, c in enumerate("RGB")})
    assert same(read_plate(tmp_path / "a.exr"), plate)
    write_exr(tmp_path / "nan.exr", dict.fromkeys("RGB", np.full((H, W), np.nan)))
    with pytest.raises(PlateError, match=r"nan\.exr: every pixel is NaN"):
        read_plate(tmp_path / "nan.exr")
    write_exr(tmp_path / "z.exr", {"Z": plate[..., 0]})
    with pytest.raises(PlateError, match=r"z\.exr: has no R, G, B"):
        read_plate(tmp_path / "z.exr")


def test_a_file_with_two_views_is_a_pair(tmp_path: Path) -> None:
    left = RANDOM.random((H, W, 3), dtype=np.float32)
    channels = {c: left[..., i] for i, c in enumerate("RGB")} | {f"right.{c}": left[..., i] + 1 for i, c in enumerate("RGB")}
    write_exr(tmp_path / "a.exr", channels, views=("left", "right"))
    a, b = read_pair(tmp_path / "a.exr", tmp_path / "a.exr")
    assert same(a, left)
    assert same(b, left + 1)


def test_sizes_that_differ_are_named(tmp_path: Path) -> None:
    grids = {name: np.ones((h, w, 3), np.float32) for name, h, w in (("l", H, W), ("r", H, W + 2))}
    with pytest.raises(PlateError, match=r"r\.exr: is 26 x 18 pixels, but l\.exr is 24 x 18"):
        check_pair(grids["l"], grids["r"], left_name="l.exr", right_name="r.exr")
    rig = Rig(left=CAMERA, right=CAMERA, R_right_left=np.eye(3), t_right_left_m=[-0.06, 0, 0])
    with pytest.raises(PlateError, match=r"r\.exr: is 26 x 18 pixels, but the rig's right camera is 24 x 18"):
        check_pair(grids["l"], grids["r"], left_name="l.exr", right_name="r.exr", rig=rig)
    check_sizes(grids["l"], grids["l"], rig)


def test_every_flag_survives(tmp_path: Path) -> None:
    flags = np.array([[int(f) for f in Flag], [sum(Flag)] * len(Flag)], np.uint16)
    assert same(read_frame(write_frame(tmp_path / "a.exr", Frame(passes={"flags": flags})))["flags"], flags)
