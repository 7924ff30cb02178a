"""`stereorelight demo`: the whole job on a real pair, with figures against its truth."""

from __future__ import annotations

from pathlib import Path

import click

from stereorelight.cli.common import json_option, report

MEANING = {
    "cover_percent": "pixels with a depth, %",
    "bad0.5_percent": "off by more than 0.5 px, %, where both eyes see",
    "bad2_percent": "off by more than 2 px, %, where both eyes see",
    "bad2_all_percent": "off by more than 2 px, %, everywhere",
    "average_px": "average error, px, where both eyes see",
    "normals_median_deg": "median error of the normals, degrees",
    "normals_under_11_percent": "normals within 11.25 degrees, %",
}


@click.command("demo")
@click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("stereorelight-demo"), show_default=True, metavar="DIR")
@click.option("--force", is_flag=True, help="Do every step again.")
@json_option
def command(folder: Path, force: bool, as_json: bool) -> None:
    """Relight the real Motorcycle pair: depth, P, N, lights, relit picture, figures.

    Writes a shot folder that you can edit and run again; an earlier demo in it is kept, and goes on where it was.
    """
    import json

    from stereorelight.cli.watch import watched_run
    from stereorelight.files import write_text
    from stereorelight.shot.demo import demo_figures, headline, write_demo
    from stereorelight.shot.schema import read_shot

    files = write_demo(folder)
    summary = watched_run(files.shot, force=force)
    shot = read_shot(files.shot)
    figures = headline(demo_figures(shot))
    write_text(shot.folder / "figures.json", json.dumps(figures, indent=2) + "\n", force=True)
    table = [f"  {figures[key]:8.2f}  {meaning}" for key, meaning in MEANING.items() if key in figures]
    previews = shot.folder / "previews"
    text = [
        f"demo: {summary.done} steps done, {summary.stood} stood unchanged, {summary.seconds:.1f} s",
        "",
        "against the pair's own ground truth:",
        *table,
        "",
        f"  look at         {previews / (shot.name + '.before_after.png')}",
        f"  all pictures    {previews}",
        f"  EXRs            {shot.folder / 'depth'}, {shot.folder / 'passes'}, {shot.folder / 'relit'}",
        f"  lights, to edit {files.shot}",
        "",
        f"next: move a light in {files.shot}, then: stereorelight run {files.shot}",
    ]
    report({"folder": str(folder), "shot": str(files.shot), "figures": dict(figures), "run": summary.to_dict()}, "\n".join(text), as_json=as_json)
