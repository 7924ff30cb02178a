"""`stereorelight compare`: a result against the truth, as figures, a page and gates; or two rigs against each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option

if TYPE_CHECKING:
    from stereorelight.compare.figures import Measured
    from stereorelight.shot.truths import Stated

PASSES = ("depth", "disparity", "normals")
SHAPES = "z, ray, inverse, inverse-ray, normalised, reversed, normalised-ray, reversed-ray, buffer, reversed-buffer"


class Place(click.ParamType[tuple[int, int]]):
    """X,Y in pixels."""

    name = "X,Y"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        try:
            x, y = (int(n) for n in str(value).replace(" ", "").split(","))
        except ValueError:
            self.fail(f"{value!r} is no place; write for example 480,270", param, ctx)
        return x, y


@click.command("compare")
@click.argument("result")
@click.argument("truth", required=False)
@click.option(
    "--what",
    type=click.Choice([*PASSES, "picture", "stereo", "flicker", "rig"]),
    help="What to compare; two rig files are known as such when it is left out.",
)
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The rig of rectified plates: adds figures in pixels of disparity.")
@click.option("--fov-deg", type=float, metavar="DEG", help="The camera, where no file says it: a centred pinhole of this horizontal field of view.")
@click.option("--at", "distances", multiple=True, type=float, metavar="M", help="Rigs: distances to answer for; 1, 2 and 5 m when left out.")
@click.option("--out", "page", type=FILE, metavar="report.html", help="Also write one page with maps, curves and the runs before.")
@click.option("--gate", metavar="CONDITIONS", help="Such as 'bad2<3,normal_median<6,bad2@near_edges<20': exit code 1 where one does not hold.")
@click.option("--truth-is", metavar="KIND", help=f"What TRUTH's depth is; found out when left out. One of {SHAPES}.")
@click.option("--unit", metavar="UNIT", help="What one unit of TRUTH is: m, cm, mm, ft, in, km, or a number of metres (of pixels, for disparity).")
@click.option("--near", "near_m", type=float, metavar="M", help="The near end of a normalised TRUTH, metres ...")
@click.option("--far", "far_m", type=float, metavar="M", help="... and its far end.")
@click.option("--axes", metavar="AXES", help="Where x, y and z of TRUTH's P and N point, such as right,down,forward.")
@click.option("--poses", "poses_path", type=FILE, metavar="FILE", help="The camera's poses, where TRUTH's P and N are of the world.")
@click.option("--layer", metavar="NAME", help="The channel or layer of TRUTH that holds it.")
@click.option("--crop", type=Place(), help="The pixel of RESULT on which TRUTH's first one lies; below 0 for overscan.")
@click.option("--result-is", metavar="KIND", help="What RESULT's depth is, where it is not ours; Z along the axis when left out.")
@click.option("--result-unit", metavar="UNIT", help="What one unit of RESULT is, where it is not ours; metres, or pixels, when left out.")
@click.option("--plate", metavar="PLATE", help="Flicker: the plates whose motion is followed.  Picture: the plate to take away, for the light alone.")
@click.option("--plate-gain", type=float, metavar="G", help="Picture: what the plate was multiplied by; 1 when left out.")
@click.option("--matte", "mattes", multiple=True, metavar="NAME=FILE", help="Picture: figures inside this matte too.")
@click.option("--peak", type=float, metavar="V", help="Picture: what counts as white; 1 when left out.")
@click.option("--depth", "depths", nargs=2, metavar="LEFT RIGHT", help="Stereo: each eye's Z, where the pictures do not hold it.")
@frames_option
@force_option
@json_option
def command(
    result: str,
    truth: str | None,
    what: str | None,
    rig_path: Path | None,
    fov_deg: float | None,
    distances: tuple[float, ...],
    page: Path | None,
    gate: str | None,
    frames: str | None,
    plate: str | None,
    plate_gain: float | None,
    mattes: tuple[str, ...],
    peak: float | None,
    depths: tuple[str, str] | None,
    force: bool,
    as_json: bool,
    **said: Any,
) -> None:
    """Error and cover of RESULT against TRUTH, two EXRs or sequences; flicker of a RESULT; how far apart two rigs are.

    Of pictures: relative RMS, PSNR, SSIM, CIEDE2000, and each light alone.  Stereo: the left eye's relit picture against
    the right eye's, carried over by depth and --rig, highlights left out.

    TRUTH may be any renderer's or benchmark's: EXR, PFM or 16-bit PNG, of Z, 1/Z, ray length, normalised depth, P or N,
    in any unit, axes, size or crop.  What it is is found from its values and said; what cannot be told is asked for.
    Where TRUTH holds flags, pixels that the other eye cannot see are reported apart.  A pixel without an answer counts
    as bad.  Of two rigs, RESULT is judged on what the plates of TRUTH show it.
    """
    if what is None:
        if any(Path(file).suffix.lower() in (".exr", ".pfm", ".png", ".tif", ".tiff") for file in (result, truth) if file):
            raise click.UsageError(f"Missing option '--what'. Choose from: {', '.join(PASSES)}, picture, stereo, flicker")
        what = "rig"
    if truth is None and what != "flicker":
        raise click.UsageError("Missing argument 'TRUTH'.")
    if plate and what not in ("flicker", "picture"):
        raise click.UsageError("--plate belongs to flicker and picture")
    if what != "picture" and (plate_gain is not None or mattes or peak is not None):
        raise click.UsageError("--plate-gain, --matte and --peak belong to picture")
    if depths and what != "stereo":
        raise click.UsageError("--depth belongs to stereo")
    if what == "rig":
        if rig_path is not None or gate or frames or fov_deg is not None or any(v is not None for v in said.values()):
            raise click.UsageError("only --at, --out, --force and --json belong to two rigs; they are compared by naming both")
        _rigs(Path(result), Path(str(truth)), distances, page, force=force, as_json=as_json)
        return
    if distances:
        raise click.UsageError("--at belongs to two rigs")
    if what in ("picture", "stereo"):
        if fov_deg is not None or any(v is not None for v in said.values()) or (rig_path is not None and what == "picture"):
            raise click.UsageError("what a truth is (--truth-is, --unit, --rig and so on) belongs to depth, disparity and normals")
        asked = {"plate": plate, "plate_gain": plate_gain, "mattes": mattes, "peak": peak, "depth": depths or None}
        _pictures(what, result, str(truth), rig_path, page, gate, frames, asked, force=force, as_json=as_json)
        return
    _passes(what, result, truth, rig_path, fov_deg, page, gate, frames, plate, said, force=force, as_json=as_json)


def _passes(
    what: str,
    result: str,
    truth: str | None,
    rig_path: Path | None,
    fov_deg: float | None,
    page: Path | None,
    gate: str | None,
    frames: str | None,
    plate: str | None,
    said: dict[str, Any],
    *,
    force: bool,
    as_json: bool,
) -> None:
    from stereorelight.cli.progress import Bar
    from stereorelight.compare.gate import parse_gate
    from stereorelight.interchange.poses import read_poses
    from stereorelight.shot.compare_files import check_page

    check_page(page, force=force)
    if gate is not None:
        parse_gate(gate)
    with Bar("compare", total=1) as bar:

        def told(name: str, done: int, total: int) -> None:
            bar.note(name, advance=int(done > 0), total=total)

        if what == "flicker":
            from stereorelight.shot.flicker import flicker

            judged: Any = flicker(result, truth, plate=plate, frames=frames, pictures=page is not None, told=told)
        else:
            from stereorelight.shot.judge import Asked, asked_rig, judge

            asked = Asked(
                what=what,  # type: ignore[arg-type]
                rig=None if rig_path is None else asked_rig(rig_path),
                fov_deg=fov_deg,
                truth=_stated(said["truth_is"], said["unit"], said),
                result=_stated(said["result_is"], said["result_unit"], {}),
                poses=None if said["poses_path"] is None else read_poses(said["poses_path"]),
            )
            judged = judge(result, str(truth), asked, frames=frames, pictures=page is not None, told=told)
    finish(judged.measured, judged.to_dict(), result=result, truth=truth or "", page=page, gate=gate, force=force, as_json=as_json)


def _pictures(
    what: str,
    result: str,
    truth: str,
    rig_path: Path | None,
    page: Path | None,
    gate: str | None,
    frames: str | None,
    said: dict[str, Any],
    *,
    force: bool,
    as_json: bool,
) -> None:
    from stereorelight.cli.progress import Bar
    from stereorelight.compare.gate import parse_gate
    from stereorelight.interchange.rigs import read_rig
    from stereorelight.shot.compare_files import check_page
    from stereorelight.shot.judge_picture import AskedPicture, judge_pictures

    check_page(page, force=force)
    if gate is not None:
        parse_gate(gate)
    named = dict(word.partition("=")[::2] for word in said.pop("mattes"))
    if lost := [name for name, file in named.items() if not name or not file]:
        raise click.UsageError(f"--matte {lost[0]!r} is not NAME=FILE; write for example face=mattes/face.png")
    asked = AskedPicture(
        rig=None if rig_path is None else read_rig(rig_path), mattes=named, **{key: value for key, value in said.items() if value is not None}
    )
    with Bar("compare", total=1) as bar:
        judged = judge_pictures(
            what, result, truth, asked, frames=frames, told=lambda name, done, total: bar.note(name, advance=int(done > 0), total=total)
        )
    finish(judged.measured, judged.to_dict(), result=result, truth=truth, page=page, gate=gate, force=force, as_json=as_json)


def finish(
    measured: Measured, nested: dict[str, Any], *, result: str, truth: str, page: Path | None, gate: str | None, force: bool, as_json: bool
) -> None:
    """The end of every comparison: figures on stdout, the page, and exit code 1 where a gate does not hold."""
    import json

    from stereorelight.compare.gate import hold
    from stereorelight.shot.compare_files import gate_verdicts, write_page

    found = gate_verdicts(gate, measured)
    if as_json:
        gates = [{"gate": v.condition.text, "value": v.figure.value if v.figure.value == v.figure.value else None, "holds": v.holds} for v in found]
        values = {"result": result, "truth": truth, measured.what: nested} | ({"gates": gates} if gate is not None else {})
        click.echo(json.dumps(_finite(values), indent=2, allow_nan=False))
    else:
        head = f"{result} against {truth}" if truth else result
        held = "\n".join(("holds: " if v.holds else "FAILS: ") + v.words() for v in found)
        click.echo("\n\n".join(filter(None, [head, measured.text(), held])))
    if page is not None:
        write_page(page, measured, result=result, truth=truth, found=found, force=force)
        click.echo(f"report -> {page}", err=True)
    hold(found)


def _finite(value: Any) -> Any:
    """JSON has no infinity."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and value - value != 0 else value


def _stated(kind: str | None, unit: str | None, said: dict[str, Any]) -> Stated:
    from stereorelight.shot.truths import Stated, kind_of, unit_of

    return Stated(
        kind=None if kind is None else kind_of(kind),
        metres=None if unit is None else unit_of(unit),
        near_m=said.get("near_m"),
        far_m=said.get("far_m"),
        axes=said.get("axes"),
        layer=said.get("layer"),
        crop=said.get("crop"),
    )


def _rigs(result: Path, truth: Path, distances: tuple[float, ...], page: Path | None, *, force: bool, as_json: bool) -> None:
    from stereorelight.compare.report import comparison_json, comparison_text
    from stereorelight.compare.rigs import DISTANCES_M, compare_rigs
    from stereorelight.errors import RigError
    from stereorelight.files import refuse_overwrite, write_text
    from stereorelight.interchange.rigs import read_rig

    if page is not None:
        refuse_overwrite(page, force=force)
    rigs = read_rig(result), read_rig(truth)
    try:
        difference = compare_rigs(*rigs, distances_m=distances or DISTANCES_M)
    except RigError as error:
        raise RigError(f"{result} against {truth}: {error}") from None
    if page is not None:
        from stereorelight.shot.compare_rigs_page import compare_rigs_page

        write_text(page, compare_rigs_page(difference, rigs[1], result=str(result), truth_name=str(truth)), force=force)
    make = comparison_json if as_json else comparison_text
    click.echo(make({"rig": difference}, result=str(result), truth=str(truth)))
    if page is not None:
        click.echo(f"maps over the frame -> {page}", err=True)
