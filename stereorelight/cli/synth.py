"""`stereorelight synth`: a synthetic shot with exact answers, ready for `run`."""

from __future__ import annotations

from pathlib import Path

import click

from stereorelight.cli.common import force_option, json_option, report


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
    force: bool,
    as_json: bool,
) -> None:
    """Plates, rig.json, shot.toml and truth of a SCENE.

    Scenes: bust, weak, statue, interior, thin, table, repeat, plane, slanted, sphere, two_planes, box.
    """
    from stereorelight.cli.progress import Bar
    from stereorelight.shot.synthetic import write_shot

    with Bar(f"synth {scene}", total=frames) as bar:
        files = write_shot(
            folder,
            scene,
            size=size,
            rig=rig,
            frames=frames,
            fov_deg=fov_deg,
            baseline_m=baseline_m,
            texture=texture,
            noise_sigma=noise_sigma,
            samples=samples,
            force=force,
            on_frame=lambda done: bar.note(f"{done} of {frames}", advance=1),
        )
    report(
        {"folder": str(folder), "shot": str(files[0]), "files": [str(f) for f in files]},
        f"synth: {scene}, {size[0]}x{size[1]}, {rig} rig -> {folder}\nnext: stereorelight run {files[0]}",
        as_json=as_json,
    )
