"""One frame of a result against its truth: both read, the truth understood and laid on the result's pixels, errors tallied.

In: two files and what is asked.  Out: a `Look`, with the tallies that add up over a shot and the arrays behind maps and pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stereorelight.arrays import Bool, Float64
from stereorelight.camera import Camera
from stereorelight.compare.calibrated import Calibration, calibration
from stereorelight.compare.conventions import DepthForm, depth_from, detect_disparity
from stereorelight.compare.depth import EDGE_BAND_PX, JUMP_Z, depth_tallies, disparity_tallies
from stereorelight.compare.edges import near_edges
from stereorelight.compare.motorcycle import seen_by_both
from stereorelight.compare.normals import normal_error, normal_tally
from stereorelight.compare.placing import Placement, nearest, place, placed
from stereorelight.compare.tally import Groups
from stereorelight.errors import PassError
from stereorelight.footage.foreign import PassName, RawPasses, read_raw
from stereorelight.footage.frames import read_frame
from stereorelight.passes import Flag
from stereorelight.shot.truths import Stated, understood

if TYPE_CHECKING:
    from stereorelight.shot.judge import Asked

PASS: dict[str, str] = {"depth": "Z", "disparity": "disparity", "normals": "N"}
RAW: dict[str, PassName] = {"depth": "depth", "disparity": "disparity", "normals": "N"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """groups, sure : what adds up over a shot.   result, truth : (H, W) or (H, W, 3) of the pass compared, on the result's pixels.
    angle : (H, W) degrees, of normals.   px : (H, W) signed error of disparity, where a rig is known.
    notes, stated : what was found of the truth, in words and to be stated for the next frame."""

    groups: Groups
    sure: Calibration
    result: Any
    truth: Any
    known: Bool
    angle: Any = None
    px: Any = None
    notes: tuple[str, ...] = ()
    stated: Stated


@dataclass(frozen=True, kw_only=True, eq=False)
class _Result:
    """A result's passes by our names, whoever wrote them."""

    passes: dict[str, Any]
    camera: Camera | None
    notes: tuple[str, ...] = ()
    number: int | None = None

    @property
    def size_hw(self) -> tuple[int, int]:
        first = next(iter(self.passes.values()))
        return int(first.shape[0]), int(first.shape[1])


def look_at(result_path: Path, truth_path: Path, *, asked: Asked) -> Look:
    """The frame of two files.  Raises PlateError, PassError."""
    result = _result(result_path, asked)
    h, w = result.size_hw
    camera = asked.camera or result.camera
    if camera is None and asked.fov_deg is not None:
        camera = Camera.from_fov(asked.fov_deg, (w, h))
    if camera is None and asked.rig is not None and asked.rig.left.size == (w, h):
        camera = asked.rig.left
    if camera is not None and camera.size != (w, h):
        raise PassError(
            f"{result_path}: is {w} x {h} pixels, but the camera is {camera.size[0]} x {camera.size[1]}; give the rig of this picture size"
        )
    passes = result.passes
    if asked.what == "disparity" and "disparity" not in passes and asked.rig is not None and "Z" in passes:
        passes["disparity"] = asked.rig.disparity_from_depth(passes["Z"])
    if asked.what == "depth" and "Z" not in passes and asked.rig is not None and "disparity" in passes:
        passes["Z"] = asked.rig.depth_from_disparity(passes["disparity"])
    name = PASS[asked.what]
    if name not in passes:
        raise PassError(f"{result_path}: has no pass {name!r}; there are: {', '.join(passes)}")
    truth = _truth(truth_path, _Result(passes=passes, camera=camera, number=result.number), asked)
    truth = replace(truth, notes=(*result.notes, *truth.notes))
    return {"depth": _depth, "disparity": _disparity, "normals": _normals}[asked.what](passes, truth, camera, asked)


def _result(path: Path, asked: Asked) -> _Result:
    stated = asked.result
    if path.suffix.lower() == ".exr" and stated.layer is None and not stated.of_values:
        frame = read_frame(path)
        taken = "" if read_raw_header(path) else f"{path.name}: the result is taken as ours are: Z along the axis in m, N in the scene frame"
        return _Result(passes=dict(frame.passes), camera=frame.camera, number=frame.number, notes=(taken,) if taken else ())
    raw = read_raw(path, layer=stated.layer, wanted=RAW[asked.what])
    notes, passes = [], dict[str, Any]()
    if raw.depth is not None:
        if raw.top > 1 and stated.metres is None:
            raise PassError(f"{path}: holds whole numbers; state their unit with --result-unit, such as mm")
        form = DepthForm(kind=stated.kind or "z", metres=stated.metres or 1.0, top=raw.top)
        rays = None if raw.camera is None and asked.camera is None else (asked.camera or raw.camera).ray_grid()  # type: ignore[union-attr]
        passes["Z"] = depth_from(raw.depth, form, rays).astype(np.float32)
        notes.append(f"{path.name}: the result is taken as {form.words()}{', as stated' if stated.of_values else ''}")
    if raw.disparity is not None:
        factor = stated.metres or 1.0
        if raw.top > 1 and stated.metres is None:
            raise PassError(f"{path}: holds whole numbers; state how many pixels one is with --result-unit, such as 0.00390625 for 256ths")
        passes["disparity"] = raw.disparity * np.float32(factor)
    if raw.N is not None:
        known = understood(raw, camera=None, size_hw=raw.size_hw, placement=Placement(), stated=stated, wanted=("N",), role="the result")
        passes["N"], notes = known.N, notes + list(known.notes)
    return _Result(passes=passes, camera=raw.camera, notes=tuple(notes))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Truth:
    """The truth on the result's pixels.   Z : where the truth of normals holds it too, for the regions."""

    values: Any
    seen: Bool | None
    notes: tuple[str, ...]
    stated: Stated
    Z: Any = None


def _truth(path: Path, result: _Result, asked: Asked) -> _Truth:
    stated, what = asked.truth, asked.what
    raw = read_raw(path, layer=stated.layer, wanted=RAW[what]) if _is_foreign(path, stated) else None
    if raw is None:
        return _own_truth(path, result, asked)
    size_hw = result.size_hw
    placement, notes = _placement(raw, result, asked, size_hw)
    if what == "disparity" or (raw.disparity is not None and raw.depth is None and raw.P is None and what == "depth"):
        return _disparity_truth(raw, result, asked, placement, notes)
    camera = None if result.camera is None else _camera_of(result.camera, placement, raw.size_hw)
    known = understood(
        raw,
        camera=camera,
        size_hw=size_hw,
        placement=placement,
        stated=stated,
        Z=result.passes.get("Z"),
        N=result.passes.get("N"),
        wanted=(PASS[what],),
    )
    values = known.Z if what == "depth" else known.N
    assert values is not None
    laid = placed(values, size_hw, placement, inverse=what == "depth")
    if what == "normals":
        with np.errstate(invalid="ignore"):
            laid = laid / np.linalg.norm(laid, axis=-1, keepdims=True)
    Z = nearest(known.Z, size_hw, placement) if what == "normals" and known.Z is not None else None
    seen = _seen(laid, asked) if what == "depth" else None
    return _Truth(values=laid, seen=seen, notes=(*notes, *known.notes), stated=known.stated, Z=Z)


def _is_foreign(path: Path, stated: Stated) -> bool:
    if path.suffix.lower() != ".exr" or stated.layer is not None or stated.of_values or stated.crop is not None:
        return True
    return not read_raw_header(path)


def read_raw_header(path: Path) -> bool:
    """Whether an EXR says in its header that it means what ours do."""
    from stereorelight.footage.exr import read_header
    from stereorelight.footage.frames import OURS

    return f"{OURS}axes" in read_header(path).metadata


def _own_truth(path: Path, result: _Result, asked: Asked) -> _Truth:
    """A truth of ours: it means what its header says, and its flags tell what the other eye sees."""
    frame = read_frame(path)
    name, passes = PASS[asked.what], dict(frame.passes)
    rig = asked.rig
    if name not in passes and name == "disparity" and rig is not None and "Z" in passes:
        passes[name] = rig.disparity_from_depth(passes["Z"])
    if name not in passes and name == "Z" and rig is not None and "disparity" in passes:
        passes[name] = rig.depth_from_disparity(passes["disparity"])
    if name not in passes:
        raise PassError(f"{path}: has no pass {name!r}; there are: {', '.join(passes)}")
    size_hw = result.size_hw
    values = np.asarray(passes[name], np.float64)
    placement, notes = Placement(), list[str]()
    if None not in (result.number, frame.number) and result.number != frame.number:
        notes.append(f"by their headers the result is frame {result.number} and the truth frame {frame.number}: are they of one moment?")
    if values.shape[:2] != size_hw:
        level = passes.get("Z", passes.get("disparity"))
        other = result.passes.get("Z", result.passes.get("disparity"))
        if level is None or other is None:
            raise PassError(f"{path}: {name} to judge must have shape {values.shape[:2]}, got {size_hw}; render truth and result at one size")
        placement = place(level, np.asarray(other))
        notes.append(placement.words((values.shape[0], values.shape[1]), size_hw))
        if name == "disparity":
            values = values / placement.scale[0]
    laid = placed(values, size_hw, placement, inverse=name == "Z")
    seen: Bool | None = None
    if "flags" in passes:
        flags = nearest(passes["flags"], size_hw, placement, outside=0)
        seen = (flags & (Flag.OCCLUDED | Flag.OUT_OF_VIEW)) == 0
    elif asked.what != "normals":
        seen = _seen(laid, asked)
    Z = nearest(np.asarray(passes["Z"], np.float64), size_hw, placement) if "Z" in passes and asked.what == "normals" else None
    return _Truth(values=laid, seen=seen, notes=tuple(notes), stated=asked.truth, Z=Z)


def _seen(values: Any, asked: Asked) -> Bool | None:
    """What the other eye sees, from the truth itself, where the rig is known."""
    rig = asked.rig
    if rig is None or values.shape != rig.left.size_hw:
        return None
    disparity = rig.disparity_from_depth(values) if asked.what == "depth" else values
    return seen_by_both(np.asarray(disparity, np.float32), width_right=rig.right.size[0])


def _placement(raw: RawPasses, result: _Result, asked: Asked, size_hw: tuple[int, int]) -> tuple[Placement, list[str]]:
    if asked.truth.crop is not None:
        found = Placement(offset=(-float(asked.truth.crop[0]), -float(asked.truth.crop[1])))
    elif raw.size_hw == size_hw:
        return Placement(), []
    else:
        level = raw.depth if raw.depth is not None else raw.disparity
        if level is None and raw.P is not None:
            level = np.linalg.norm(raw.P, axis=-1)
        other = result.passes.get("disparity" if level is raw.disparity and "disparity" in result.passes else "Z", result.passes.get("disparity"))
        if level is None or other is None:
            (h, w), (th, tw) = size_hw, raw.size_hw
            if abs(tw / w * h - th) > 1 and abs(th / h * w - tw) > 1:
                raise PassError(
                    f"{raw.path}: has {tw} x {th} pixels and the result {w} x {h}, and nothing to tell where it lies: state it with --crop X,Y"
                )
            found = Placement(scale=(tw / w, th / h))
        else:
            try:
                found = place(level, np.asarray(other))
            except PassError as error:
                raise PassError(f"{raw.path}: {error}") from None
    return found, [found.words(raw.size_hw, size_hw)]


def _camera_of(camera: Camera, placement: Placement, size_hw: tuple[int, int]) -> Camera:
    """The camera of the truth's own pixels."""
    size = size_hw[1], size_hw[0]
    if placement.scale != (1.0, 1.0):
        return camera.scaled(size)
    x, y = (-round(o) for o in placement.offset)
    return camera if (x, y) == (0, 0) and size == camera.size else camera.cropped(x, y, size)


def _disparity_truth(raw: RawPasses, result: _Result, asked: Asked, placement: Placement, notes: list[str]) -> _Truth:
    values = raw.disparity if raw.disparity is not None else None
    if values is None:
        raise PassError(f"{raw.path}: has no disparity, only {', '.join(raw.names)}; name the channel with --layer")
    reference, rig = result.passes.get("disparity"), asked.rig
    if reference is None and rig is not None and "Z" in result.passes:
        reference = rig.disparity_from_depth(result.passes["Z"])
    scaled = values.astype(np.float64)
    if asked.truth.metres is not None:
        factor = asked.truth.metres
    elif reference is None:
        raise PassError(f"{raw.path}: holds disparity; comparing depth with it needs the rig: give --rig")
    else:
        width = raw.size_hw[1]
        factor, told, doubt = detect_disparity(nearest(scaled, result.size_hw, placement) / placement.scale[0], reference, width=width)
        if doubt:
            raise PassError(f"{raw.path}: {doubt}")
        notes = [*notes, f"{raw.path.name}: {told}"]
    laid = placed(scaled * factor, result.size_hw, placement) / placement.scale[0]
    if asked.what == "depth":
        if rig is None:
            raise PassError(f"{raw.path}: holds disparity; comparing depth with it needs the rig: give --rig")
        laid = rig.depth_from_disparity(laid)
    return _Truth(values=laid, seen=_seen(laid, asked), notes=tuple(notes), stated=replace(asked.truth, metres=factor))


def _depth(passes: dict[str, Any], truth: _Truth, camera: Camera | None, asked: Asked) -> Look:
    Z, Z_true = np.asarray(passes["Z"], np.float64), truth.values
    rays = None if camera is None else camera.ray_grid()
    groups = depth_tallies(Z, Z_true, rig=asked.rig, nonoccluded=truth.seen, rays=rays)
    px = None
    if asked.rig is not None:
        px = asked.rig.disparity_from_depth(Z) - asked.rig.disparity_from_depth(Z_true)
    known = np.isfinite(Z_true)
    sure = _sure(passes, known, px, Z - Z_true, "Z_sigma")
    return Look(groups=groups, sure=sure, result=Z, truth=Z_true, known=known, px=px, notes=truth.notes, stated=truth.stated)


def _disparity(passes: dict[str, Any], truth: _Truth, camera: Camera | None, asked: Asked) -> Look:
    d, d_true = np.asarray(passes["disparity"], np.float64), truth.values
    rig = asked.rig if asked.rig is not None and d_true.shape == asked.rig.left.size_hw else None
    groups = disparity_tallies(d, d_true, nonoccluded=truth.seen, rig=rig)
    known = np.isfinite(d_true)
    sure = _sure(passes, known, d - d_true, d - d_true, "disparity_sigma")
    return Look(groups=groups, sure=sure, result=d, truth=d_true, known=known, px=d - d_true, notes=truth.notes, stated=truth.stated)


def _normals(passes: dict[str, Any], truth: _Truth, camera: Camera | None, asked: Asked) -> Look:
    N, N_true = np.asarray(passes["N"], np.float64), truth.values
    angle, known = normal_error(N, N_true)
    seen = known if truth.seen is None else known & truth.seen
    regions = {"all": known} | ({} if truth.seen is None else {"nonoccluded": seen})
    if truth.Z is not None:
        edges = near_edges(np.log(truth.Z), jump=JUMP_Z, band_px=EDGE_BAND_PX)
        regions |= {"near_edges": seen & edges, "flat": seen & ~edges}
    sure = _sure({k: v for k, v in passes.items() if k != "confidence"}, known, None, angle, "N_sigma")
    return Look(
        groups={"normals": {name: normal_tally(angle, mask) for name, mask in regions.items()}},
        sure=sure,
        result=N,
        truth=N_true,
        known=known,
        angle=angle,
        notes=truth.notes,
        stated=truth.stated,
    )


def _sure(passes: dict[str, Any], known: Bool, px: Any, error: Float64, sigma: str) -> Calibration:
    confidence = passes.get("confidence") if px is not None else None
    apart = np.abs(px) if px is not None else np.full(known.shape, np.nan)
    return calibration(apart, known, confidence=confidence, sigma=passes.get(sigma), sigma_error=error)
