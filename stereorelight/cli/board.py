"""`stereorelight board`: a calibration board as a PDF at true size."""

from __future__ import annotations

from pathlib import Path

import click

from stereorelight.cli.common import FILE, force_option, json_option, report


@click.command("board")
@click.argument("spec")
@click.option("--out", "path", required=True, type=FILE, metavar="board.pdf", help="Where the page goes.")
@click.option("--page", default="fit", show_default=True, help="A4 to A0, letter, tabloid; fit: the smallest that holds it; exact: made for it.")
@force_option
@json_option
def command(spec: str, path: Path, page: str, force: bool, as_json: bool) -> None:
    """A board to print and film, with a ruler to check the printer.

    \b
    SPEC is one of
      chessboard:9x6:0.025                         inner corners, side of a square in metres
      charuco:11x8:0.040:0.030:DICT_5X5_100        squares, square and marker in metres, dictionary
      aprilgrid:6x6:0.088:0.3                      tags, tag in metres, gap as a share of the tag
    """
    from stereorelight.calibration.board import parse_board
    from stereorelight.calibration.board_pdf import board_pdf, page_for
    from stereorelight.files import write_whole

    board = parse_board(spec)
    name, width, height = page_for(board, page)
    data = board_pdf(board, page)

    def put(temporary: Path) -> None:
        temporary.write_bytes(data)

    write_whole(path, put, force=force)
    values = {"file": str(path), "spec": board.spec, "page": name, "size_mm": [width, height]}
    report(values, f"board: {board.spec} on {name} -> {path}; print at 100 %, measure the ruler, mount it flat", as_json=as_json)
