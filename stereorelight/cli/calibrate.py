"""`stereorelight calibrate`: pictures of a board to a rig, and how good it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stereorelight.cli.common import FILE, force_option, frames_option, json_option, report

if TYPE_CHECKING:
    from stereorelight.shot.calibrate import Session

STYLE = {"good": "green", "note": "blue", "warn": "yellow", "bad": "red"}


@click.command("calibrate")
@click.argument("left")
@click.argument("right")
@click.option("--board", "spec", required=True, metavar="SPEC", help="Such as charuco:11x8:0.040:0.030:DICT_5X5_100 or chessboard:9x6:0.025.")
@click.option("--out", "path", required=True, type=FILE, metavar="rig.json", help="Where the rig goes.")
@click.option("--report", "page", type=FILE, metavar="FILE.html", help="Also write one page with pictures.")
@click.option("--mirrored", type=click.Choice(["left", "right"]), help="The eye behind the beam-splitter's mirror.")
@click.option("--from", "before", type=FILE, metavar="rig.json", help="The same rig on another day: keep its lenses, solve where the eyes stand.")
@click.option("--baseline", type=float, metavar="M", help="Measured distance between the eyes, metres, true to 1 %.")
@click.option("--focal-mm", type=float, help="Printed focal length of both lenses; with --sensor-mm.")
@click.option("--sensor-mm", type=float, help="Width of the sensor area that was recorded.")
@click.option("--lens", "lenses", multiple=True, help="Lens model: brown4, brown5, rational, fisheye; chosen by held-out error when left out.")
@click.option("--at", "distances", multiple=True, type=float, metavar="M", help="Distances to answer for; 1, 2 and 5 m and so on when left out.")
@frames_option
@force_option
@json_option
def command(
    left: str,
    right: str,
    spec: str,
    path: Path,
    page: Path | None,
    mirrored: Any,
    before: Path | None,
    baseline: float | None,
    focal_mm: float | None,
    sensor_mm: float | None,
    lenses: tuple[str, ...],
    distances: tuple[float, ...],
    frames: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """The rig that filmed a board, from stills or movies LEFT and RIGHT.

    Says what the rig is good for in millimetres and in degrees of normal, and what to shoot again where it is not.
    """
    from stereorelight.calibration.answer import Known, focal_from_lens
    from stereorelight.calibration.board import parse_board
    from stereorelight.calibration.lens_choice import CANDIDATES
    from stereorelight.calibration.validate import DISTANCES_M
    from stereorelight.cli.progress import Bar
    from stereorelight.files import refuse_overwrite, write_text
    from stereorelight.footage.clip import open_clip
    from stereorelight.interchange.rigs import read_rig, write_rig
    from stereorelight.shot.calibrate import calibrate
    from stereorelight.shot.calibrate_page import calibrate_page

    board = parse_board(spec)
    for file in (path, page):
        if file is not None:
            refuse_overwrite(file, force=force)
    if (focal_mm is None) != (sensor_mm is None):
        raise click.UsageError("--focal-mm and --sensor-mm belong together")
    focal = None
    if focal_mm is not None and sensor_mm is not None:
        clip = open_clip(left)
        shape = clip.encoded(None if clip.is_single else clip.frames[0]).shape
        focal = focal_from_lens(focal_mm, sensor_mm, (shape[1], shape[0]))
    known = Known(
        baseline_m=None if baseline is None else (baseline, 0.01 * baseline),
        focal_px=(focal, focal),
        rig=None if before is None else read_rig(before),
    )
    with Bar("calibrate", total=1) as bar:
        session = calibrate(
            left,
            right,
            board,
            mirrored=mirrored,
            frames=frames,
            known=known,
            lenses=lenses or CANDIDATES,
            distances_m=distances or DISTANCES_M,
            cache=path.with_name(path.stem + ".detections.json"),
            on_picture=lambda name, done, total: bar.note(name, advance=1, total=total),
        )
    write_rig(path, session.rig, force=force)
    values = {"rig": str(path), **session.to_dict()}
    if page is not None:
        write_text(page, calibrate_page(session), force=force)
        values["report"] = str(page)
    if not as_json:
        _print(session)
    quality = session.quality
    text = (
        f"calibrate: {quality.verdict}: {len(session.names)} views, rows agree to {quality.held_out_mean_px:.3f} px held out, "
        f"baseline {1000 * session.rig.baseline_m:.2f} mm -> {path}"
    )
    report(values, text, as_json=as_json)


def _print(session: Session) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    for noticed in session.words:
        console.print(Text(noticed, style="dim"))
    table = Table(box=None, pad_edge=False, show_edge=False)
    for title in ("level", "looked at", "found, and what to shoot"):
        table.add_column(title, no_wrap=title != "found, and what to shoot")
    for advice in session.quality.advice:
        words = Text(advice.words)
        if advice.remedy:
            words.append(f"\n{advice.remedy}", style="dim")
        table.add_row(Text(advice.level, style=STYLE[advice.level]), advice.name.replace("_", " "), words)
    console.print(table)
    answers = Table(box=None, pad_edge=False, show_edge=False)
    for title in ("at", "depth error of the rig", "with matching", "normals of the rig", "with matching"):
        answers.add_column(title)
    for a in session.quality.answers:
        cells = (f"{a.depth_rig_mm:.2f} mm", f"{a.depth_mm:.2f} mm", f"{a.normal_rig_deg:.2f} deg", f"{a.normal_deg:.1f} deg")
        answers.add_row(f"{a.distance_m:g} m", *cells)
    console.print(answers)
