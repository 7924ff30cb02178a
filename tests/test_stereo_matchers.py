"""Matchers from outside: a tiny network built here and run by onnxruntime, and one registered by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stereorelight.camera import Rig
from stereorelight.cli import main
from stereorelight.errors import PlateError, ShotError
from stereorelight.footage.stills import write_still
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Flag
from stereorelight.stereo import matchers
from stereorelight.stereo.depth import recover
from stereorelight.stereo.matchers import from_folder, matcher_file, matcher_named, matcher_names, register_matcher
from stereorelight.stereo.proxy import matching_proxy
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.semi_global import DisparityRange
from stereorelight.stereo.settings import DepthSettings
from stereorelight.synth.rigs import parallel_rig

onnx = pytest.importorskip("onnx", reason="the test builds its network with the onnx package")
pytest.importorskip("onnxruntime", reason="onnx matchers run on onnxruntime")

SIZE = (160, 96)
STEPS = 24  # disparities that the tiny network knows
TRUE_PX = 9.0


def network(path: Path, *, size: tuple[int, int] | None = None, stacked: bool = False, flow: bool = False, white: float = 255.0) -> Path:
    """Absolute differences of the right picture moved by 0..STEPS-1 columns, box-filtered, and a soft minimum over them."""
    from onnx import TensorProto, helper

    h, w = (size[1], size[0]) if size else ("h", "w")
    shape = [1, 6 if stacked else 3, h, w]
    nodes, costs = [], []

    def constant(name: str, value: np.ndarray) -> str:
        nodes.append(helper.make_node("Constant", [], [name], value=onnx.numpy_helper.from_array(value)))
        return name

    if stacked:
        constant("three", np.array([3, 3], dtype=np.int64))
        nodes.append(helper.make_node("Split", ["both", "three"], ["left", "right"], axis=1))
    constant("axis", np.array([1], dtype=np.int64))
    constant("w_axis", np.array([3], dtype=np.int64))
    for d in range(STEPS):
        constant(f"pads{d}", np.array([0, 0, 0, d, 0, 0, 0, 0], dtype=np.int64))
        constant(f"ends{d}", np.array([-d if d else np.iinfo(np.int64).max], dtype=np.int64))
        constant(f"zero{d}", np.array([0], dtype=np.int64))
        nodes.append(helper.make_node("Slice", ["right", f"zero{d}", f"ends{d}", "w_axis"], [f"cut{d}"]))
        nodes.append(helper.make_node("Pad", [f"cut{d}", f"pads{d}"], [f"moved{d}"], mode="edge"))
        nodes.append(helper.make_node("Sub", ["left", f"moved{d}"], [f"sub{d}"]))
        nodes.append(helper.make_node("Abs", [f"sub{d}"], [f"abs{d}"]))
        nodes.append(helper.make_node("ReduceMean", [f"abs{d}", "axis"], [f"cost{d}"], keepdims=1))
        costs.append(f"cost{d}")
    nodes.append(helper.make_node("Concat", costs, ["volume"], axis=1))
    nodes.append(helper.make_node("AveragePool", ["volume"], ["pooled"], kernel_shape=[7, 7], pads=[3, 3, 3, 3], count_include_pad=0))
    nodes.append(helper.make_node("Mul", ["pooled", constant("sharp", np.float32(-255.0 / white))], ["score"]))
    nodes.append(helper.make_node("Softmax", ["score"], ["share"], axis=1))
    steps = np.arange(STEPS, dtype=np.float32).reshape(1, STEPS, 1, 1)
    nodes.append(helper.make_node("Mul", ["share", constant("steps", steps)], ["weighed"]))
    nodes.append(helper.make_node("ReduceSum", ["weighed", "axis"], ["disparity"], keepdims=1))
    if flow:
        nodes.append(helper.make_node("Neg", ["disparity"], ["u"]))
        nodes.append(helper.make_node("Sub", ["u", "u"], ["v"]))
        nodes.append(helper.make_node("Concat", ["u", "v"], ["flow"], axis=1))
    inputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, shape) for n in (("both",) if stacked else ("left", "right"))]
    output = helper.make_tensor_value_info("flow" if flow else "disparity", TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "tiny", inputs, [output])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    path.write_bytes(model.SerializeToString())
    return path


@pytest.fixture(scope="module")
def plates() -> tuple[np.ndarray, np.ndarray]:
    """A wall of noise TRUE_PX nearer than infinity, with columns that only the left eye sees at the left."""
    rng = np.random.default_rng(5)
    wide = np.repeat(np.repeat(rng.random((SIZE[1] // 2, (SIZE[0] + 40) // 2, 3)), 2, axis=0), 2, axis=1).astype(np.float32)
    return np.ascontiguousarray(wide[:, : SIZE[0]]), np.ascontiguousarray(wide[:, int(TRUE_PX) : SIZE[0] + int(TRUE_PX)])


@pytest.fixture(scope="module")
def rig() -> Rig:
    return parallel_rig(SIZE)


SEARCH = DisparityRange.holding(0, 16)


@pytest.mark.parametrize(
    ("made", "query"),
    [({}, ""), ({"stacked": True}, ""), ({"flow": True}, ""), ({"white": 1.0}, "?range=1"), ({"size": SIZE}, ""), ({"size": (320, 96)}, "")],
    ids=["two inputs", "stacked", "flow", "white is 1", "fixed size", "fixed, twice as wide"],
)
def test_every_form_of_network_gives_the_true_disparity(tmp_path, plates, made, query) -> None:
    matcher = matcher_named(f"onnx:{network(tmp_path / 'net.onnx', **made)}{query}")
    found = matcher(matching_proxy(*plates), SEARCH)
    seen = found[8:-8, 24:-8]
    assert found.shape == (SIZE[1], SIZE[0])
    assert found.dtype == np.float32
    assert np.median(np.abs(seen - TRUE_PX)) < 0.1
    assert (np.abs(seen - TRUE_PX) > 0.5).mean() < 0.01


def test_disparities_below_zero_are_moved_into_what_a_network_knows(tmp_path, plates) -> None:
    """A converged rig: the right picture ten columns on, so that the wall lies at -1 px, which the network alone cannot say."""
    left, right = plates
    moved = np.roll(right, 10, axis=1)
    matcher = matcher_named(f"onnx:{network(tmp_path / 'net.onnx')}")
    found = matcher(matching_proxy(left, moved), DisparityRange.holding(-14, 2))
    assert np.median(np.abs(found[8:-8, 30:-20] - (TRUE_PX - 10))) < 0.1


@pytest.mark.parametrize("eye", ["left", "right"])
def test_recover_by_a_network_is_refined_checked_and_flagged(tmp_path, plates, rig, eye) -> None:
    settings = DepthSettings(matcher=f"onnx:{network(tmp_path / 'net.onnx')}", near_m=0.9, far_m=3.0)
    got = recover(*plates, rectification(rig), settings=settings, eye=eye)
    d = got.rectified["disparity"]
    assert np.median(np.abs(d - TRUE_PX)[8:-8, 24:-24]) < 0.05
    edge = got.rectified["flags"][:, : int(TRUE_PX) - 2] if eye == "left" else got.rectified["flags"][:, -int(TRUE_PX) + 2 :]
    assert ((edge & Flag.OUT_OF_VIEW) != 0).mean() > 0.9


def test_depth_command_takes_a_network(tmp_path, plates, rig) -> None:
    for name, picture in zip(("left", "right"), plates, strict=True):
        write_still(tmp_path / f"{name}.png", np.rint(np.clip(picture, 0, 1) ** (1 / 2.4) * 255).astype(np.uint8))
    write_rig(tmp_path / "rig.json", rig)
    model = network(tmp_path / "net.onnx")
    arguments = ["depth", tmp_path / "left.png", tmp_path / "right.png", "--rig", tmp_path / "rig.json", "--out", tmp_path / "z.exr"]
    result = CliRunner().invoke(main, [*map(str, arguments), "--near", "0.9", "--far", "3", "--matcher", f"onnx:{model}"])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "z.exr").exists()


def test_a_registered_matcher_is_used_by_name(plates, rig, monkeypatch) -> None:
    monkeypatch.setattr(matchers, "_makers", dict(matchers._makers))
    asked = []

    def maker(options: str):
        def constant(proxy, search):
            asked.append((options, search.low))
            return np.full(proxy.left_grey.shape, TRUE_PX, dtype=np.float32)

        return constant

    register_matcher("flat", maker)
    assert "flat" in matcher_names()
    got = recover(*plates, rectification(rig), settings=DepthSettings(matcher="flat:so", near_m=0.9, far_m=3.0))
    assert {options for options, _ in asked} == {"so"}
    assert len(asked) == 2, "each eye is asked once"
    assert np.median(np.abs(got.rectified["disparity"] - TRUE_PX)) < 0.05
    with pytest.raises(ShotError, match="registered already"):
        register_matcher("flat", maker)


@pytest.mark.parametrize("gives", [lambda s: np.zeros((3, 3), np.float32), lambda s: np.zeros(s, np.int16), lambda s: np.full(s, np.nan, np.float32)])
def test_a_matcher_that_gives_no_disparity_is_named(plates, rig, monkeypatch, gives) -> None:
    monkeypatch.setattr(matchers, "_makers", {"odd": lambda options: lambda proxy, search: gives(proxy.left_grey.shape)})
    with pytest.raises(PlateError, match="matcher odd"):
        recover(*plates, rectification(rig), settings=DepthSettings(matcher="odd", near_m=0.9, far_m=3.0))


@pytest.mark.parametrize(
    ("matcher", "words"),
    [
        ("sgmb", "did you mean 'sgbm'"),
        ("onnx:", "needs a file"),
        ("onnx:nowhere.onnx", "nowhere.onnx: ONNX model missing"),
        ("onnx:text.onnx", "text.onnx: no ONNX model"),
        ("onnx:net.onnx?rang=1", "did you mean 'range'"),
        ("onnx:net.onnx?range=white", "must be numbers"),
        ("onnx:net.onnx?device=tpu", "device = 'tpu' is unknown"),
    ],
)
def test_what_cannot_be_used_is_said_with_its_name(tmp_path, monkeypatch, matcher, words) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.onnx").write_text("no model")
    network(tmp_path / "net.onnx")
    with pytest.raises(ShotError, match=words):
        matcher_named(matcher)


def test_a_model_that_is_no_stereo_network_is_told_by_its_inputs(tmp_path) -> None:
    from onnx import TensorProto, helper

    one = [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, 224, 224])]
    out = [helper.make_tensor_value_info("y", TensorProto.FLOAT, None)]
    model = helper.make_model(
        helper.make_graph([helper.make_node("Abs", ["image"], ["y"])], "one", one, out), opset_imports=[helper.make_opsetid("", 18)], ir_version=9
    )
    (tmp_path / "one.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ShotError, match=r"this one takes image \[1, 3, 224, 224\]"):
        matcher_named(f"onnx:{tmp_path / 'one.onnx'}")


def test_the_file_of_a_shot_file_lies_beside_it() -> None:
    assert from_folder("onnx:nets/a.onnx?range=1", Path("/shots")) == "onnx:/shots/nets/a.onnx?range=1"
    assert from_folder("onnx:/nets/a.onnx", Path("/shots")) == "onnx:/nets/a.onnx"
    assert from_folder("sgbm", Path("/shots")) == "sgbm"
    assert matcher_file("onnx:a.onnx?range=1") == Path("a.onnx")
    assert matcher_file("sgbm") is None
