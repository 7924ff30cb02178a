"""A learned stereo network from an ONNX file as a matcher.

`onnx:model.onnx`, with options after a question mark: `onnx:model.onnx?range=1&sign=-1&device=cuda`.

What a network must be: inputs left and right, (1, C, H, W) float32 with C 3 (RGB) or 1 (grey), or one input of both stacked
on channels; output (1, 1, H, W), (1, H, W) or (H, W) disparity of the left picture in pixels of its input, or (1, 2, H, W)
flow, whose x is taken.  Several outputs: the last one of that form, which is the finest in the published networks.
A fixed input size is met by resizing, any other by padding to a multiple of 32.  Networks know disparities from 0 up:
the right picture is moved by the low end of the search range first, so that converged rigs work as well.

range  : what white is for the network, 255 or 1 (the default is 255).
sign   : 1 where the output counts x_left - x_right, -1 where it is flow to the right picture (the default: -1 for two
         channels, else 1).
mean, std : taken off and divided by, after `range`, such as mean=0.485,0.456,0.406.
device : cpu or cuda."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import cv2
import numpy as np

from stereorelight.arrays import Float32, UInt8
from stereorelight.errors import PlateError, ShotError, nearest_hint
from stereorelight.stereo.proxy import Proxy
from stereorelight.stereo.semi_global import DisparityRange
from stereorelight.threads import usable_cores

MULTIPLE = 32  # the strides of the published networks divide it
OPTIONS = ("range", "sign", "mean", "std", "device")
PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}


def _options(text: str) -> dict[str, str]:
    options = dict(parse_qsl(text, keep_blank_values=True))
    for name in options:
        if name not in OPTIONS:
            raise ShotError(f"onnx matcher option {name!r} is unknown{nearest_hint(name, OPTIONS)}")
    return options


def _numbers(options: dict[str, str], name: str, default: tuple[float, ...]) -> Float32:
    try:
        values = tuple(float(v) for v in options[name].split(",")) if name in options else default
    except ValueError:
        raise ShotError(f"onnx matcher option {name} = {options[name]!r} must be numbers with commas between them") from None
    return np.array(values, dtype=np.float32).reshape(-1, 1, 1)


@lru_cache(maxsize=2)
def _session(path: str, modified: float, device: str) -> Any:
    """The network, loaded once for a shot.  `modified` tells a changed file from the one that was loaded."""
    try:
        import onnxruntime
    except ImportError:
        raise ShotError("a matcher onnx:FILE needs onnxruntime; install it with: pip install 'stereorelight[onnx]'") from None
    provider = PROVIDERS[device]
    if provider not in onnxruntime.get_available_providers():
        raise ShotError(f"onnxruntime here has no {provider}; use device=cpu, or install onnxruntime-gpu")
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = usable_cores()
    settings.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(path, settings, providers=[provider])
    except Exception as error:  # onnxruntime raises a class of its own for every kind of bad file
        raise ShotError(f"{path}: no ONNX model that onnxruntime can load: {str(error).splitlines()[0]}") from None


def _sizes(session: Any, path: str) -> tuple[int, int | None, int | None]:
    """Channels of one picture, and the fixed height and width of the inputs, None where free.  Raises ShotError."""
    inputs = session.get_inputs()
    shapes = [i.shape for i in inputs]
    channels = [shape[1] for shape in shapes if len(shape) == 4 and isinstance(shape[1], int)]
    pictures = {(2, 3): 3, (2, 1): 1, (1, 6): 3, (1, 2): 1}
    picture = pictures.get((len(inputs), channels[0])) if len(channels) == len(inputs) and len(set(channels)) == 1 else None
    if picture is None:
        words = ", ".join(f"{i.name} {i.shape}" for i in inputs)
        raise ShotError(f"{path}: a stereo model takes left and right (1, 3 or 1, H, W), or both stacked on channels; this one takes {words}")
    h, w = (n if isinstance(n, int) and n > 0 else None for n in shapes[0][2:])
    return picture, h, w


def _moved(picture: UInt8, columns: int) -> UInt8:
    """`picture` moved right by so many columns, its border repeated: takes `columns` off every disparity of the right eye."""
    if columns == 0:
        return picture
    w = picture.shape[1]
    return np.ascontiguousarray(picture[:, np.clip(np.arange(w) - columns, 0, w - 1)])


def _disparity_of(outputs: list[Any], size_hw: tuple[int, int], sign: float | None, path: str) -> Float32:
    for out in reversed(outputs):
        a = np.asarray(out, dtype=np.float32)
        a = a.reshape(a.shape[-3:]) if a.ndim == 4 and a.shape[0] == 1 else a
        a = a[None] if a.ndim == 2 else a
        if a.ndim == 3 and a.shape[0] in (1, 2) and a.shape[1:] == size_hw:
            return a[0] * np.float32(sign if sign is not None else (-1 if a.shape[0] == 2 else 1))
    shapes = ", ".join(str(np.asarray(o).shape) for o in outputs)
    raise PlateError(f"{path}: no output is a disparity of the input's size {size_hw}; the model gave {shapes}")


def onnx_matcher(text: str) -> Any:
    """The matcher of "FILE" or "FILE?option=value&...".  Raises ShotError for a file, model or option that cannot be used."""
    file, _, query = text.partition("?")
    options = _options(query)
    path = Path(file)
    if not file:
        raise ShotError("matcher onnx needs a file: onnx:model.onnx")
    if not path.is_file():
        raise ShotError(f"{path}: ONNX model missing")
    device = options.get("device", "cpu")
    if device not in PROVIDERS:
        raise ShotError(f"onnx matcher option device = {device!r} is unknown{nearest_hint(device, PROVIDERS)}")
    white = float(_numbers(options, "range", (255.0,)).ravel()[0])
    mean, std = _numbers(options, "mean", (0.0,)), _numbers(options, "std", (1.0,))
    sign = float(_numbers(options, "sign", (1.0,)).ravel()[0]) if "sign" in options else None
    session = _session(str(path.resolve()), path.stat().st_mtime, device)
    channels, fixed_h, fixed_w = _sizes(session, str(path))
    names = [i.name for i in session.get_inputs()]

    def planes(picture: UInt8, size: tuple[int, int]) -> Float32:
        h, w = picture.shape[:2]
        a: UInt8 = picture
        if fixed_h or fixed_w:
            a = cv2.resize(a, size, interpolation=cv2.INTER_AREA if size[0] < w else cv2.INTER_LINEAR)
        else:
            a = cv2.copyMakeBorder(a, 0, size[1] - h, 0, size[0] - w, cv2.BORDER_REPLICATE)
        a = cv2.cvtColor(a, cv2.COLOR_BGR2RGB if channels == 3 else cv2.COLOR_BGR2GRAY)
        stacked = a.transpose(2, 0, 1) if channels == 3 else a[None]
        scaled: Float32 = (stacked.astype(np.float32) * np.float32(white / 255) - mean) / std
        return np.ascontiguousarray(scaled[None], dtype=np.float32)

    def disparity(proxy: Proxy, search: DisparityRange) -> Float32:
        h, w = proxy.left_grey.shape
        size = (fixed_w or -(-w // MULTIPLE) * MULTIPLE, fixed_h or -(-h // MULTIPLE) * MULTIPLE)
        pair = [planes(proxy.left, size), planes(_moved(proxy.right, search.low), size)]
        fed = dict(zip(names, pair)) if len(names) == 2 else {names[0]: np.concatenate(pair, axis=1)}
        found = _disparity_of(session.run(None, fed), (size[1], size[0]), sign, str(path))
        if fixed_h or fixed_w:
            found = cv2.resize(found, (w, h), interpolation=cv2.INTER_LINEAR) * np.float32(w / size[0])
        else:
            found = found[:h, :w]
        return np.ascontiguousarray(found + np.float32(search.low), dtype=np.float32)

    return disparity
