"""`stereorelight compare`: a result against the truth, as figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stereorelight.cli.common import FILE, json_option

if TYPE_CHECKING:
    from stereorelight.shot.judge import What


@click.command("compare")
@click.argument("result", type=FILE)
@click.argument("truth", type=FILE)
@click.option("--what", required=True, type=click.Choice(["depth", "disparity", "normals"]), help="Which pass to compare.")
@click.option("--rig", "rig_path", type=FILE, metavar="rig.json", help="The rig of rectified plates: adds figures in pixels of disparity.")
@json_option
def command(result: Path, truth: Path, what: What, rig_path: Path | None, as_json: bool) -> None:
    """Error and cover of RESULT.exr against TRUTH.exr.

    Where TRUTH holds flags, pixels that the other eye cannot see are reported apart.  A pixel without an answer
    counts as bad.
    """
    from stereorelight.compare.report import comparison_json, comparison_text
    from stereorelight.shot.judge import compared

    figures: dict[str, Any] = {what: compared(result, truth, what, rig_path=rig_path)}
    make = comparison_json if as_json else comparison_text
    click.echo(make(figures, result=str(result), truth=str(truth)))
