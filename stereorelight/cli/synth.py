"""`stereorelight synth`: a synthetic shot with exact answers, ready for `run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stereorelight.cli.common import force_option, json_option, report

if TYPE_CHECKING:
    from stereorelight.shot.synthetic import Motion


class Size(click.ParamType[tuple[int, int]]):
    """WIDTHxHEIGHT in pixels."""

    name = "WxH"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        try:
            width, height = (int(n) for n in str(value).lower().split("x"))
        except ValueError:
            self.fail(f"{value!r} is no size; write for example 640x360", param, ctx)
        return width, height


class Numbers(click.ParamType[tuple[float, ...]]):
    """A few numbers with commas between them."""

    def __init__(self, counts: tuple[int, ...], example: str) -> None:
        self.counts, self.example, self.name = counts, example, example.upper()

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(word) for word in str(value).split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in self.counts:
            self.fail(f"{value!r} is not {' or '.join(str(n) for n in self.counts)} numbers; write for example {self.example}", param, ctx)
        return numbers


@click.command("synth")
@click.argument("scene")
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), metavar="DIR", help="Folder for the shot.")
@click.option("--size", type=Size(), default="640x360", show_default=True, help="Picture size in pixels.")
@click.option("--rig", default="parallel", show_default=True, help="parallel, toed-in, mirrored, distorted, offset or hard.")
@click.option("--frames", type=click.IntRange(min=1), default=1, show_default=True, help="More than one is a sequence in motion.")
@click.option("--fov-deg", type=float, default=40.0, show_default=True, help="Horizontal field of view.")
@click.option("--baseline", "baseline_m", type=float, default=0.065, show_default=True, metavar="M", help="Distance between the eyes, metres.")
@click.option("--texture", type=float, default=1.0, show_default=True, help="How much grain surfaces have, 0 to 2.")
@click.option("--noise", "noise_sigma", type=float, default=0.0, show_default=True, help="Sensor noise, scene-linear sigma.")
@click.option("--samples", type=click.IntRange(1, 16), default=3, show_default=True, help="Rays a pixel along each side.")
@click.option("--bounce", type=click.IntRange(0, 4096), default=0, metavar="RAYS", help="Gather the light between surfaces by so many rays a pixel.")
@click.option(
    "--motion", type=click.Choice(["actor", "camera", "both", "none"]), default="actor", show_default=True, help="What moves in a sequence."
)
@click.option("--board", "spec", metavar="SPEC", help="Scene board: what is printed; as `calibrate --board` takes it.")
@click.option("--photon-grain", type=float, default=0.0, help="Variance of grain per unit of light.")
@click.option("--blur", "blur_px", type=Numbers((1, 2), "0.8,1.5"), default="0", help="Soft focus, sigma in px; of both eyes, or of each.")
@click.option("--exposure", "exposure_stops", type=float, default=0.0, metavar="STOPS", help="Of the right eye against the left.")
@click.option("--cast", type=Numbers((3,), "1.08,1,0.97"), default="1,1,1", help="Gains of the right eye's red, green and blue.")
@click.option("--pitch", "pitch_deg", type=float, default=0.0, metavar="DEG", help="The right eye was knocked since calibration: up,")
@click.option("--yaw", "yaw_deg", type=float, default=0.0, metavar="DEG", help="to the right,")
@click.option("--roll", "roll_deg", type=float, default=0.0, metavar="DEG", help="turned clockwise as seen from behind it,")
@click.option("--zoom", "zoom_percent", type=float, default=0.0, metavar="%", help="zoomed in,")
@click.option("--rise", "rise_mm", type=float, default=0.0, metavar="MM", help="or raised.")
@click.option("--bend", type=float, default=0.0, metavar="K1", help="Distortion of both lenses, in rig.json; negative is a barrel.")
@click.option("--late", "right_late_frames", type=float, default=0.0, metavar="FRAMES", help="How late the right camera is; fractions are good.")
@click.option("--seed", type=click.IntRange(0, 2**40), default=0, help="Another number, other grain and other board poses.")
@force_option
@json_option
def command(
    scene: str,
    folder: Path,
    size: tuple[int, int],
    rig: str,
    frames: int,
    fov_deg: float,
    baseline_m: float,
    texture: float,
    noise_sigma: float,
    samples: int,
    bounce: int,
    motion: Motion,
    spec: str | None,
    blur_px: tuple[float, ...],
    force: bool,
    as_json: bool,
    **faults: Any,
) -> None:
    """Plates, rig.json, shot.toml and truth of a SCENE.

    Scenes: bust, weak, statue, interior, thin, table, repeat, plane, slanted, sphere, two_planes, box.
    Or board: a calibration session of --frames views (20 when left out), with rig.json as its truth.
    """
    from stereorelight.cli.progress import Bar
    from stereorelight.shot.synthetic import BOARD, write_session, write_shot
    from stereorelight.synth.dials import Dials

    dials = Dials(blur_px=(blur_px[0], blur_px[-1]), grain=noise_sigma, **faults)
    same: dict[str, Any] = {"size": size, "rig": rig, "fov_deg": fov_deg, "baseline_m": baseline_m, "dials": dials, "force": force}
    if scene == "board":
        views, spec = frames if frames > 1 else 20, spec or BOARD
        with Bar("synth board", total=views) as bar:
            files = write_session(folder, board=spec, views=views, on_frame=lambda done: bar.note(f"{done} of {views}", advance=1), **same)
        plates = [str(folder / "plates" / f"{eye}.####.png") for eye in ("left", "right")]
        report(
            {"folder": str(folder), "rig": str(files[0]), "board": spec, "files": [str(f) for f in files]},
            f"synth: {views} views of {spec}, {size[0]}x{size[1]}, {rig} rig -> {folder}\n"
            f"next: stereorelight calibrate {plates[0]} {plates[1]} --board {spec} --out found.json\n"
            f"then: stereorelight compare found.json {files[0]}",
            as_json=as_json,
        )
        return
    if spec is not None:
        raise click.UsageError("--board belongs to the scene board")
    with Bar(f"synth {scene}", total=frames) as bar:
        files = write_shot(
            folder,
            scene,
            frames=frames,
            texture=texture,
            samples=samples,
            bounce=bounce,
            motion=motion,
            on_frame=lambda done: bar.note(f"{done} of {frames}", advance=1),
            **same,
        )
    report(
        {"folder": str(folder), "shot": str(files[0]), "files": [str(f) for f in files]},
        f"synth: {scene}, {size[0]}x{size[1]}, {rig} rig -> {folder}\nnext: stereorelight run {files[0]}",
        as_json=as_json,
    )
