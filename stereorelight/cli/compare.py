"""`stereorelight compare`: a result against the truth, as figures; or two rigs against each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from stereorelight.cli.common import FILE, force_option, json_option

if TYPE_CHECKING:
    from stereorelight.shot.judge import What


@click.command("compare")
@click.argument("result", type=FILE)
@click.argument("truth", type=FILE)
@click.option(
    "--what",
    type=click.Choice(["depth", "disparity", "normals", "rig"]),
    help="Which pass to compare; two rig files are known as such when it is left out.",
)
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The rig of rectified plates: adds figures in pixels of disparity.")
@click.option("--at", "distances", multiple=True, type=float, metavar="M", help="Rigs: distances to answer for; 1, 2 and 5 m when left out.")
@click.option("--out", "page", type=FILE, metavar="report.html", help="Rigs: also write one page with maps over the frame.")
@force_option
@json_option
def command(
    result: Path,
    truth: Path,
    what: What | Literal["rig"] | None,
    rig_path: Path | None,
    distances: tuple[float, ...],
    page: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Error and cover of RESULT.exr against TRUTH.exr, or how far apart two rigs are.

    Where TRUTH holds flags, pixels that the other eye cannot see are reported apart.  A pixel without an answer
    counts as bad.  Of two rigs, RESULT is judged on what the plates of TRUTH show it: pixels over the frame for each
    lens, rows, disparity and depth for the pair.
    """
    from stereorelight.compare.report import comparison_json, comparison_text

    if what is None:
        if any(file.suffix.lower() == ".exr" for file in (result, truth)):
            raise click.UsageError("Missing option '--what'. Choose from: depth, disparity, normals")
        what = "rig"
    figures: dict[str, Any]
    if what == "rig":
        if rig_path is not None:
            raise click.UsageError("--rig belongs to depth, disparity and normals; rigs are compared by naming both")
        figures = {"rig": _rigs(result, truth, distances, page, force=force)}
    else:
        if page is not None or distances:
            raise click.UsageError("--out and --at belong to two rigs")
        from stereorelight.shot.judge import compared

        figures = {what: compared(result, truth, what, rig_path=rig_path)}
    make = comparison_json if as_json else comparison_text
    click.echo(make(figures, result=str(result), truth=str(truth)))
    if page is not None:
        click.echo(f"maps over the frame -> {page}", err=True)


def _rigs(result: Path, truth: Path, distances: tuple[float, ...], page: Path | None, *, force: bool) -> Any:
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
    return difference
